"""Waypoints are moved until their legs hold, no further than they must, and only those that may be."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionplanner import proof
from missionplanner.clearance import polyline_legs, tubes_clear
from missionplanner.errors import InfeasibleError
from missionplanner.mission import Mission, load_mission
from missionplanner.repair import Repair, repair
from missionplanner.scene import Scene, build_check_scene
from missionplanner.sortie import Leg, LegKind, Sortie
from missionplanner.vehicle import Ending
from tests.scenes import at, copter, question

MISSIONS = Path(__file__).parents[2] / "missions"
AREA = {"south_west": at(-400, -400), "north_east": at(1000, 400)}
Points = Sequence[tuple[float, float, float]]
STRAIGHT: Points = [(0, 0, 140), (300, 0, 140), (600, 0, 140)]


def scene(vehicle: dict[str, Any] | None = None, **changes: Any) -> Scene:
    """Return level ground at 100 m, where a vehicle keeps 20 + 5 m above it and 10 + 5 m from all else."""
    data = question(vehicle or copter("alpha", (0, 0), (600, 0)), **({"area": AREA} | changes))
    return build_check_scene(Mission.model_validate(data), Path(), [])


def sortie(
    points: Points, ending: Ending = "loiter", kinds: dict[int, LegKind] | None = None, ending_seq: int | None = None
) -> Sortie:
    """Return a sortie of items 1 (take-off), 2 (speed), 3, ... through points."""
    kinds = kinds or {}
    legs = [Leg(1, "takeoff", np.array(points[0], dtype=float), 5.0)]
    legs += [Leg(3 + k, kinds.get(k, "straight"), np.array(p, dtype=float), 5.0) for k, p in enumerate(points[1:])]
    home, seq = np.array([0.0, 0.0, 100.0]), legs[-1].seq + 1 if ending_seq is None else ending_seq
    return Sortie("alpha", 1, "ardupilot", "copter", home, tuple(legs), ending, seq, 0.0, 15.0)


def moved(done: Repair) -> dict[int, list[float]]:
    """Return by how much each item was moved."""
    return {move.seq: np.round(np.subtract(move.to_m, move.from_m), 1).tolist() for move in done.moves}


def holds(space: Scene, flown: Sortie) -> bool:
    """Return whether the proof says that all legs hold, and that none is too steep."""
    certificate = proof.prove(space, [flown])
    legs = [leg.proven for leg in certificate.legs[: len(flown.legs)]]
    return all(legs) and all(f.proven for f in certificate.findings if f.check == "angle")


def straight_legs_hold(space: Scene, flown: Sortie) -> bool:
    """Return whether the planner's own judge takes the legs after the take-off."""
    legs = polyline_legs(np.array([leg.end_m for leg in flown.legs]))
    limits = space.tasks[0].limits
    return bool(tubes_clear(space.space, space.terrain.bounds, limits, legs).all())


def hump(height_m: float, x_m: float, spread_m: float = 30.0) -> dict[str, Any]:
    peaks = [{**at(x_m, 0), "height_m": height_m, "spread_m": spread_m}]
    return {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": peaks}


def mast(x_m: float, y_m: float, **changes: Any) -> dict[str, Any]:
    return {"kind": "cylinder", "name": "mast", "center": at(x_m, y_m), "radius_m": 5} | changes


def zone(west: float, south: float, east: float, north: float, **changes: Any) -> dict[str, Any]:
    corners = [at(west, south), at(east, south), at(east, north), at(west, north)]
    return {"kind": "no_fly", "name": "zone", "polygon": corners} | changes


def test_what_holds_is_not_touched() -> None:
    flown = sortie(STRAIGHT)
    done = repair(scene(), [flown])
    assert done.sorties == (flown,)
    assert done.moves == ()


def test_waypoints_too_low_are_lifted_and_no_others() -> None:
    space = scene()
    done = repair(space, [sortie([(0, 0, 140), (200, 0, 115), (400, 0, 140), (600, 0, 140)])])
    assert moved(done) == {3: [0.0, 0.0, 10.0]}
    assert holds(space, done.sorties[0])


@pytest.mark.parametrize("ending", ["loiter", "land"])
def test_a_hill_between_two_waypoints_lifts_both_by_their_share(ending: Ending) -> None:
    space = scene(terrain=hump(40, 420))
    done = repair(space, [sortie(STRAIGHT, ending)])
    ups = moved(done)
    # the hill's top at 0.4 of the leg is 25 m too high: lifts are as 0.6 to 0.4
    assert ups[3] == pytest.approx([0, 0, 25 * 0.6 / 0.52], abs=0.5)
    assert ups[4] == pytest.approx([0, 0, 25 * 0.4 / 0.52], abs=0.5)
    assert set(ups) == ({3, 4, 5} if ending == "loiter" else {3, 4})  # it stays where its last waypoint went
    assert holds(space, done.sorties[0])


def test_a_way_home_as_high_as_the_last_waypoint_lifts_that() -> None:
    space = scene(terrain=hump(40, 420))
    done = repair(space, [sortie(STRAIGHT, "rtl")])
    assert moved(done)[4] == pytest.approx([0, 0, 25], abs=0.2)
    assert all(leg.proven for leg in proof.prove(space, done.sorties).legs)


def test_the_take_off_may_rise_but_not_go_aside() -> None:
    space = scene(terrain=hump(40, 150))
    assert moved(repair(space, [sortie(STRAIGHT)])) == {1: [0, 0, 25.0], 3: [0, 0, 25.0]}
    with pytest.raises(InfeasibleError, match=r"alpha: item 1 mast clearance is -5\.00 m, expected 10 m: cannot be"):
        repair(scene(obstacles=[mast(0, 5)]), [sortie(STRAIGHT)])


def test_where_it_lands_stays() -> None:
    assert moved(repair(scene(obstacles=[mast(610, 0)]), [sortie(STRAIGHT)]))[4] == pytest.approx([-10, 0, 0], abs=0.2)
    for ending_seq in (4, 5):
        with pytest.raises(InfeasibleError, match=r"alpha: item 4 mast clearance is"):
            repair(scene(obstacles=[mast(610, 0)]), [sortie(STRAIGHT, "land", ending_seq=ending_seq)])


def test_a_landing_item_of_its_own_is_as_high_as_the_waypoint_before() -> None:
    space = scene(terrain=hump(40, 420))
    done = repair(space, [sortie([(0, 0, 140), (300, 0, 140), (600, 0, 140)], "land", ending_seq=4)])
    assert moved(done)[3] == moved(done)[4] == pytest.approx([0, 0, 25.0], abs=0.5)
    assert holds(space, done.sorties[0])


def test_legs_beside_a_mast_go_the_rest_of_the_way() -> None:
    space = scene(obstacles=[mast(450, 10)])
    done = repair(space, [sortie(STRAIGHT)])
    assert moved(done)[3] == moved(done)[4] == pytest.approx([0, -10, 0], abs=0.1)
    assert holds(space, done.sorties[0])


def test_a_leg_right_through_a_mast_goes_left() -> None:
    space = scene(obstacles=[mast(450, 0)])
    done = repair(space, [sortie(STRAIGHT)])
    assert moved(done)[3] == moved(done)[4] == pytest.approx([0, 20, 0], abs=0.1)
    assert holds(space, done.sorties[0])


def test_a_low_mast_is_flown_over_and_a_zone_is_left_at_its_nearer_side() -> None:
    low = scene(obstacles=[mast(450, 0, top_height_agl_m=40)])
    done = repair(low, [sortie(STRAIGHT)])
    assert moved(done)[3] == pytest.approx([0, 0, 15], abs=0.5)
    assert holds(low, done.sorties[0])
    corner: Points = [(0, 0, 140), (100, 0, 140), (500, 0, 140), (600, 0, 140)]
    for south, north, y in ((-100, 120, -115), (-120, 100, 115)):
        wide = scene(obstacles=[zone(200, south, 400, north)])
        done = repair(wide, [sortie(corner)])
        assert moved(done)[3] == moved(done)[4] == pytest.approx([0, y, 0], abs=0.1)
        assert holds(wide, done.sorties[0])


def test_a_waypoint_inside_a_zone_comes_out_of_it_with_its_legs() -> None:
    space = scene(obstacles=[zone(200, -100, 400, 120)])
    assert holds(space, repair(space, [sortie(STRAIGHT)]).sorties[0])


def test_a_cable_just_above_the_least_height_is_passed_above_it() -> None:
    cable = {"kind": "cable", "name": "cable", "start": at(450, -380, amsl=130), "end": at(450, 380, amsl=130)}
    space = scene(obstacles=[cable])
    done = repair(space, [sortie([(0, 0, 126), (300, 0, 126), (600, 0, 126)])])
    assert moved(done)[3][2] == pytest.approx(130 + 15.5 - 126, abs=0.6)
    assert holds(space, done.sorties[0])


def test_a_fence_is_come_back_into_round_its_notches_too() -> None:
    fence = {"polygon": [at(-60, -60), at(500, -60), at(500, 60), at(-60, 60)]}
    space = scene(fence=fence, area=None)
    done = repair(space, [sortie([(0, 0, 140), (300, 55, 140), (495, 58, 140)])])
    assert holds(space, done.sorties[0])
    assert moved(done)[4] == pytest.approx([-10, -13, 0], abs=0.3)
    corners = [(-60, -60), (250, -60), (300, 30), (350, -60), (650, -60), (650, 160), (-60, 160)]
    space = scene(fence={"polygon": [at(*corner) for corner in corners]}, area=None)
    assert holds(space, repair(space, [sortie([(0, 0, 140), (100, 0, 140), (600, 0, 140)])]).sorties[0])


@pytest.mark.parametrize("ceiling", [{"height_agl_max_m": 60}, {"alt_amsl_max_m": 160}])
def test_what_is_too_high_comes_down(ceiling: dict[str, float]) -> None:
    space = scene(copter("alpha", (0, 0), (600, 0), **ceiling))
    done = repair(space, [sortie([(0, 0, 140), (300, 0, 175), (600, 0, 140)])])
    assert moved(done) == {3: pytest.approx([0, 0, -20], abs=0.2)}
    assert holds(space, done.sorties[0])


def test_a_leg_too_steep_is_made_shallower_from_both_ends() -> None:
    space = scene(copter("alpha", (0, 0), (600, 0), climb={"angle_max_deg": 20}))
    done = repair(space, [sortie([(0, 0, 140), (100, 0, 200), (600, 0, 140)])])
    assert holds(space, done.sorties[0])
    (up, down) = moved(done)[1], moved(done)[3]
    assert up[2] == pytest.approx(-down[2], abs=0.2)
    assert down[0] == pytest.approx(-down[2] * math.tan(math.radians(20)), abs=0.2)


def test_a_lift_over_a_hill_takes_the_climb_with_it() -> None:
    space = scene(copter("alpha", (0, 0), (600, 0), climb={"angle_max_deg": 20}), terrain=hump(80, 200))
    done = repair(space, [sortie([(0, 0, 140), (100, 0, 140), (600, 0, 140)])])
    assert holds(space, done.sorties[0])
    assert moved(done)[1][2] > 10.0


def test_two_limits_that_cannot_both_be_kept_are_named() -> None:
    space = scene(copter("alpha", (0, 0), (600, 0), alt_amsl_max_m=170), terrain=hump(80, 200))
    with pytest.raises(InfeasibleError) as error:
        repair(space, [sortie([(0, 0, 140), (100, 0, 140), (600, 0, 140)])])
    assert "item 4 terrain clearance is -45" in str(error.value)
    assert "altitude at item" in str(error.value)
    assert "\n" not in str(error.value)


def test_every_vehicle_that_cannot_be_repaired_is_named() -> None:
    one = copter("alpha", (0, 0), (600, 0))
    data = question(
        one, copter("bravo", (0, 100), (600, 100)), area=AREA, obstacles=[mast(0, 5), mast(0, 105, name="pole")]
    )
    space = build_check_scene(Mission.model_validate(data), Path(), [])
    legs = tuple(replace(leg, end_m=np.add(leg.end_m, [0, 100, 0])) for leg in sortie(STRAIGHT).legs)
    other = replace(sortie(STRAIGHT), name="bravo", home_m=np.array([0.0, 100.0, 100.0]), legs=legs)
    with pytest.raises(InfeasibleError, match=r"alpha: item 1 .*; bravo: item 1 "):
        repair(space, [sortie(STRAIGHT), other])


def test_splines_and_circles_are_lifted_too() -> None:
    space = scene(terrain=hump(40, 420))
    curved: Points = [(0, 0, 140), (300, 0, 140), (600, 0, 140), (700, 200, 140)]
    done = repair(space, [sortie(curved, kinds={0: "spline", 1: "spline"})])
    assert holds(space, done.sorties[0])
    round_it = sortie([(0, 0, 140), (300, 0, 140), (420, 0, 150), (700, 200, 140)], kinds={1: "circle"})
    legs = tuple(replace(leg, radius_m=20.0, turns=2.0) if leg.kind == "circle" else leg for leg in round_it.legs)
    done = repair(space, [replace(round_it, legs=legs)])
    assert holds(space, done.sorties[0])


def test_a_wait_moves_with_the_place_it_waits_at() -> None:
    space = scene(terrain=hump(40, 150))
    flown = sortie([(0, 0, 140), (0, 0, 140), (300, 0, 140), (600, 0, 140)])
    done = repair(space, [flown])
    assert moved(done)[1] == moved(done)[3] == [0, 0, 25.0]
    assert holds(space, done.sorties[0])


def test_one_item_that_climbs_and_flies_keeps_one_altitude() -> None:
    """PX4's first waypoint without a take-off item is two legs."""
    space = scene(terrain=hump(40, 150))
    first, *rest = sortie(STRAIGHT).legs
    done = repair(space, [replace(sortie(STRAIGHT), legs=(replace(first, seq=3), *rest))])
    assert moved(done) == {3: [0, 0, 25.0]}
    assert {float(leg.end_m[2]) for leg in done.sorties[0].legs[:2]} == {done.moves[0].to_m[2]}


def test_unknown_ground_is_left_to_the_proof() -> None:
    space = scene()
    heights = space.terrain.arrays.height_amsl_m.copy()
    heights[:] = np.nan
    arrays = space.terrain.arrays._replace(height_amsl_m=heights)
    unknown = replace(space, terrain=replace(space.terrain, arrays=arrays), space=space.space._replace(terrain=arrays))
    done = repair(unknown, [sortie(STRAIGHT)])
    assert done.moves == ()
    assert not proof.prove(unknown, done.sorties).proven


def test_a_plane_s_predicted_flight_is_repaired() -> None:
    plane = {**copter("alpha", (0, 0), (1500, 0)), "vehicle_class": "plane"}
    area = {"south_west": at(-800, -800), "north_east": at(3000, 1500)}
    space = scene(plane, area=area, terrain=hump(60, 1200, spread_m=100.0))
    points = [(600, 0, 160), (1200, 0, 160), (1800, 100, 160)]
    flown = replace(sortie(points), vehicle_class="plane")
    flown = replace(flown, legs=tuple(replace(leg, speed_m_s=18.0) for leg in flown.legs))
    done = repair(space, [flown])
    assert done.moves
    assert all(leg.proven for leg in proof.prove(space, done.sorties).legs[:3])


def test_waypoints_pushed_down_in_real_mountains_come_back_up() -> None:
    question_ = load_mission(MISSIONS / "ridge_line.yaml")
    space = build_check_scene(question_, MISSIONS, [])
    home = space.tasks[0].home_m
    offsets = [(0, 0), (-800, 300), (-1300, 600), (-1900, 900), (-2600, 300)]
    ends = [np.add(home, [x, y, 0.0]) for x, y in offsets]
    heights = [float(space.terrain.height_amsl_m(end[0], end[1])) + 60.0 for end in ends]
    points = [(float(end[0]), float(end[1]), z) for end, z in zip(ends, heights, strict=True)]
    rough = replace(sortie(points, "rtl"), name=space.tasks[0].name, home_m=home, return_height_m=60.0)
    (proven,) = repair(space, [rough]).sorties
    assert straight_legs_hold(space, proven)
    low = tuple(replace(leg, end_m=leg.end_m - [0, 0, 15.0 * (0 < k < 4)]) for k, leg in enumerate(proven.legs))
    pushed = replace(proven, legs=low)
    assert not straight_legs_hold(space, pushed)
    done = repair(space, [pushed])
    assert straight_legs_hold(space, done.sorties[0])
    by = [np.subtract(move.to_m, move.from_m) for move in done.moves]
    assert 5.0 < np.linalg.norm(by) <= math.sqrt(3 * 15.0**2) + 0.5  # undoing it is one repair
