"""What a recorded flight kept clear of: it may use up its errors, never the safety distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from missionplanner import kernels
from missionplanner.clearance import Margins
from missionplanner.flight_check import airborne_part, check_flight, least_clearances, nearest_pair, worst_of_each
from missionplanner.geodesy import FloatArray
from missionplanner.path_search import PlannedPath
from missionplanner.plan import Clearance, FleetFlight, FleetPlan, FlownVehicle, Trajectory
from missionplanner.planner import assemble
from missionplanner.scene import Scene
from missionplanner.schedule import Schedule
from tests.scenes import at, copter, question, scene_of

# Level ground at 100 m; safety distances of 20 m above it, 10 m from obstacles and fence, 20 m between vehicles.
STRAIGHT = [(0.0, 0.0, 140.0), (300.0, 0.0, 140.0)]
ALPHA = copter("alpha", (0, 0), (300, 0), start=at(0, 0, amsl=140), goal=at(300, 0, amsl=140))
# just as near as the path may pass it: 10 m of safety, 2 m of tracking, 1 m of position, 2 m of corners
POST = {"kind": "cylinder", "name": "post", "center": at(150, 20.01), "radius_m": 5}

Line = Sequence[tuple[float, float, float]]


def scene(*vehicles: dict[str, Any], **changes: Any) -> Scene:
    return scene_of(question(*(vehicles or (ALPHA,)), **({"fleet": {"arrive_together": False}} | changes)))


def by_hand(scene: Scene, *lines: Line, speed_m_s: float = 5.0) -> FleetPlan:
    """Return the plan, unproven, of vehicles that fly these waypoints."""
    paths = [PlannedPath(np.array(line), np.array(line), 0.0, 0.0, {}, np.zeros(1), 0) for line in lines or (STRAIGHT,)]
    schedules = [
        Schedule(0.0, (speed_m_s,) * legs, (0.0,) * legs, (0.0, 1e3))
        for legs in (len(p.waypoints_m) - 1 for p in paths)
    ]
    return assemble(scene, paths, schedules, None, seed=1)


def flown(plan: FleetPlan, change: Any = lambda position: position) -> FleetFlight:
    """Return the flight as predicted, with its positions changed."""
    return FleetFlight(
        tuple(
            FlownVehicle(
                v.name, v.sysid, Trajectory(v.trajectory.t_s, change(v.trajectory.position_m)), v.arrival_s, 0.0
            )
            for v in plan.vehicles
        )
    )


def moved(dx: float, dy: float, dz: float) -> Any:
    def change(position: FloatArray) -> FloatArray:
        bump = np.exp(-(((position[:, 0] - 150) / 40) ** 2))
        return position + bump[:, None] * np.array([dx, dy, dz])

    return change


# --- flights against their plan


def test_a_flight_may_use_up_its_errors_but_not_the_margin() -> None:
    passed = scene(obstacles=[POST])
    plan = by_hand(passed)
    for sideways, ok in [(0.0, True), (4.9, True), (5.1, False)]:
        check = check_flight(passed, plan, flown(plan, moved(0, sideways, 0)))
        assert check.ok is ok, sideways
    (clearances,) = check_flight(passed, plan, flown(plan, moved(0, 5.1, 0))).clearances
    (least,) = [c for c in clearances if c.what == "post"]
    assert (least.required_m, least.ok) == (10.0, False)
    assert least.distance_m == pytest.approx(9.9, abs=0.05)


def test_the_tube_of_the_vehicle_is_not_asked_of_what_it_flew() -> None:
    # the same flight, whatever its errors were assumed to be
    for errors in ({}, {"tracking_error_m": 5, "position_error_m": 3, "motion": {"waypoint_radius_m": 6}}):
        there = scene({**ALPHA, **errors, "safety": {"terrain_m": 20}})
        plan = by_hand(there)
        (clearances,) = check_flight(there, plan, flown(plan)).clearances
        assert {c.what: c.required_m for c in clearances} == {"terrain": 20.0, "fence": 10.0}


def test_a_flight_too_low_is_told() -> None:
    level = scene()
    plan = by_hand(level)
    assert check_flight(level, plan, flown(plan, moved(0, 0, -19.9))).ok
    assert not check_flight(level, plan, flown(plan, moved(0, 0, -20.1))).ok


def test_a_flight_above_its_ceiling_is_told() -> None:
    for ceiling in ({"height_agl_max_m": 60}, {"alt_amsl_max_m": 160}):
        level = scene({**ALPHA, **ceiling})
        plan = by_hand(level)
        assert check_flight(level, plan, flown(plan, moved(0, 0, 19.9))).ok
        assert not check_flight(level, plan, flown(plan, moved(0, 0, 20.2))).ok


def test_a_flight_out_of_the_area_is_told() -> None:
    level = scene(area={"south_west": at(-100, -150), "north_east": at(400, 50)})
    plan = by_hand(level)
    # distances to the edge are lower bounds, at most 0.03 m and 1 % too small
    assert check_flight(level, plan, flown(plan, moved(0, 39.7, 0))).ok
    check = check_flight(level, plan, flown(plan, moved(0, 40.1, 0)))
    assert [c.what for c in check.clearances[0] if not c.ok] == ["fence"]


def test_a_flight_that_never_got_to_its_height_is_too_low_all_the_way() -> None:
    level = scene()
    plan = by_hand(level)
    (v,) = plan.vehicles
    sunk = v.trajectory.position_m - np.maximum(0.0, v.trajectory.position_m[:, 2:] - 101.0) * [0, 0, 0.9]
    assert sunk[:, 2].max() < 106
    low = FleetFlight((FlownVehicle(v.name, v.sysid, replace(v.trajectory, position_m=sunk), v.arrival_s, 0.0),))
    check = check_flight(level, plan, low)
    assert not check.ok
    assert min(c.distance_m for c in check.clearances[0]) < 6.0


def test_a_vehicle_that_stays_on_its_pad_keeps_clear() -> None:
    level = scene()
    plan = by_hand(level)
    (v,) = plan.vehicles
    waiting = Trajectory(np.array([0.0, 50.0]), np.array([v.home_m, v.home_m + np.array([1.5, 1.0, 0.5])]))
    check = check_flight(level, plan, FleetFlight((FlownVehicle(v.name, v.sysid, waiting, None, None),)))
    assert (check.clearances, check.separation, check.ok) == (((),), None, True)


def beside(y_m: float) -> dict[str, Any]:
    return copter("bravo", (0, y_m), (300, y_m), start=at(0, y_m, amsl=140), goal=at(300, y_m, amsl=140))


def shifted(y_m: float) -> Line:
    return [(x, y + y_m, z) for x, y, z in STRAIGHT]


def test_two_that_flew_too_close_are_told() -> None:
    pair = scene(ALPHA, beside(30))
    plan = by_hand(pair, STRAIGHT, shifted(30.0))
    near = flown(plan)
    for sideways, ok in [(9.9, True), (10.1, False)]:
        alpha, bravo = near.vehicles
        bumped = replace(
            alpha, trajectory=replace(alpha.trajectory, position_m=moved(0, sideways, 0)(alpha.trajectory.position_m))
        )
        check = check_flight(pair, plan, FleetFlight((bumped, bravo)))
        assert check.ok is ok
        assert check.separation is not None
        assert (check.separation.what, check.separation.required_m) == ("alpha - bravo", 20.0)


def drifting(plan: FleetPlan, *line: tuple[float, float, float]) -> FleetFlight:
    """Return a flight of the first vehicle that climbs from home and goes through these places."""
    (v,) = plan.vehicles
    points = np.array([v.home_m, *line])
    return FleetFlight((FlownVehicle(v.name, v.sysid, Trajectory(20.0 * np.arange(len(points)), points), None, None),))


def test_a_copter_may_sink_as_soon_as_it_is_within_the_goals_radius() -> None:
    # as PX4 does: it drifts to the middle of its landing place on the way down
    there = scene()
    plan = by_hand(there)
    sinks = [STRAIGHT[0], (298.2, 0.0, 140.0), (298.2, 0.0, 115.0), (300.0, 0.0, 100.0)]
    assert check_flight(there, plan, drifting(plan, *sinks)).ok
    early = [STRAIGHT[0], (290.0, 0.0, 140.0), (290.0, 0.0, 115.0), (300.0, 0.0, 100.0)]
    assert not check_flight(there, plan, drifting(plan, *early)).ok


def test_what_stands_near_the_landing_place_counts_until_the_descent() -> None:
    post = {"kind": "cylinder", "name": "post", "center": at(317, 0), "radius_m": 0.4}
    there = scene(obstacles=[post])
    plan = by_hand(there)
    past = [STRAIGHT[0], (308.0, 0.0, 140.0), (300.0, 0.0, 140.0), (300.0, 0.0, 100.0)]
    (bad,) = [c for c in check_flight(there, plan, drifting(plan, *past)).clearances[0] if not c.ok]
    assert (bad.what, round(bad.distance_m, 2)) == ("post", 8.6)


# --- the parts


def test_the_airborne_part_is_what_lies_between_climb_and_descent() -> None:
    z = np.array([0, 10, 20, 20, 20, 10, 0], dtype=float)
    x = np.array([0, 0, 0, 50, 100, 101, 100], dtype=float)
    whole = Trajectory(np.arange(7.0), np.stack([x, np.zeros(7), z], axis=-1))
    part = airborne_part(whole, 2.0)
    assert part.t_s.tolist() == [2.0, 3.0, 4.0]
    assert part.position_m[-1].tolist() == [100.0, 0.0, 20.0]
    # who lands where it took off from has no way: one step is left
    vertical = Trajectory(np.arange(4.0), np.array([[0.0, 0, 0], [0, 0, 20], [0, 0, 20], [0, 0, 0]]))
    assert airborne_part(vertical, 1.0).t_s.tolist() == [1.0, 2.0]


def test_a_steep_rock_under_a_long_leg_is_not_stepped_over() -> None:
    peaks = [{**at(123.4, 0), "height_m": 60, "spread_m": 6}]
    rock = {"kind": "peaks", "base_alt_amsl_m": 100, "cell_m": 2, "peaks": peaks}
    space = scene(terrain=rock, area={"south_west": at(-50, -50), "north_east": at(350, 50)}).space
    leg = np.array([[[0.0, 0.0, 200.0], [300.0, 0.0, 200.0]]])
    found = least_clearances(space, (), Margins(22, np.inf, np.inf, 0, 0), leg)
    (terrain,) = [c for c in found if c.what == "terrain"]
    x = np.linspace(115, 132, 100_001)
    ground = kernels.terrain_heights(space.terrain, np.stack([x, np.zeros_like(x)], axis=-1))
    assert ground.max() > 150
    assert terrain.distance_m == pytest.approx(200 - ground.max(), abs=0.02)
    assert terrain.position_m[0] == pytest.approx(x[ground.argmax()], abs=0.1)


def test_missing_terrain_is_no_clearance() -> None:
    space = scene().space
    heights = space.terrain.height_amsl_m.copy()
    heights[:, heights.shape[1] // 2] = np.nan
    unknown = space._replace(terrain=space.terrain._replace(height_amsl_m=heights))
    found = least_clearances(unknown, (), Margins(20, np.inf, np.inf, 10, 10), np.array([STRAIGHT]))
    (terrain,) = [c for c in found if c.what == "terrain"]
    assert (terrain.distance_m, terrain.ok) == (-np.inf, False)


def test_of_each_kind_the_tightest_is_kept() -> None:
    def clearance(what: str, distance_m: float, required_m: float) -> Clearance:
        return Clearance(distance_m, required_m, what, (0.0, 0.0, 0.0))

    near, far = clearance("mast", 12.0, 10.0), clearance("zone", 40.0, 10.0)
    low, high = clearance("terrain", 25.0, 20.0), clearance("terrain", 30.0, 20.0)
    assert worst_of_each([far, high, clearance("fence", 9.0, 10.0), near, low]) == (
        low,
        near,
        clearance("fence", 9.0, 10.0),
    )
    assert worst_of_each([]) == ()


def test_the_pair_furthest_below_its_need_is_the_nearest() -> None:
    t_s = np.array([0.0, 10.0])
    tracks = [Trajectory(t_s, np.array([[0.0, y, 0.0], [100.0, y, 0.0]])) for y in (0.0, 25.0, 55.0)]
    need_m = {(0, 1): 24.0, (0, 2): 60.0, (1, 2): 20.0}
    nearest = nearest_pair(["a", "b", "c"], tracks, lambda i, j: need_m[i, j])
    assert nearest is not None
    assert (nearest.what, nearest.required_m, nearest.ok) == ("a - c", 60.0, False)
    assert nearest.distance_m == pytest.approx(55.0)
    assert nearest_pair(["a"], tracks[:1], lambda i, j: 0.0) is None
