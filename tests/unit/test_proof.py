"""Missions made by hand that just keep a limit are proven, those that just break it are not, and the reason is told."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.sorties import plan_sortie
from missionplanner import kernels, proof, timing
from missionplanner.certificate import Certificate, Finding
from missionplanner.clearance import distance_to_legs_m, polyline_legs, tube_clearances
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Mission
from missionplanner.motion import climbing_as_stated
from missionplanner.motion.spline import spline_bezier
from missionplanner.path_search import PlannedPath
from missionplanner.plan import FleetPlan
from missionplanner.planner import assemble, returning_at
from missionplanner.scene import Scene, build_check_scene
from missionplanner.schedule import Schedule
from missionplanner.sortie import Gap, Leg, Sortie
from missionplanner.terrain_bounds import pyramid
from tests.scenes import at, copter, question, scene_of

# Level ground at 100 m. A copter's tube is 5 m wide (2 m tracking, 1 m position, 2 m corners): all of it keeps 20 m
# above the ground, 10 m from obstacles and fence. Predicted flights keep 20 + 3 + 3 m apart. Nobody returns on his way.
STRAIGHT = [(0.0, 0.0, 140.0), (300.0, 0.0, 140.0)]
ALPHA = copter("alpha", (0, 0), (300, 0), start=at(0, 0, amsl=140), goal=at(300, 0, amsl=140))
TO_ONE_SIDE = {"south_west": at(-100, -150), "north_east": at(400, 150)}
ROUNDING_M = 0.03
"""What the wire's 1e-7 degrees may move a waypoint, and room for it."""

Line = Sequence[tuple[float, float, float]]


def scene(*vehicles: dict[str, Any], **changes: Any) -> Scene:
    fleet = {"arrive_together": False, "direct_return": "waived"} | changes.pop("fleet", {})
    return scene_of(question(*(vehicles or (ALPHA,)), fleet=fleet, **changes))


def by_hand(
    scene: Scene,
    *lines: Line,
    speed_m_s: float = 5.0,
    delays_s: Sequence[float] = (0.0, 0.0),
    arrival_s: float | None = None,
) -> FleetPlan:
    """Return the checked plan of vehicles that fly these waypoints."""
    paths = [PlannedPath(np.array(line), np.array(line), 0.0, 0.0, {}, np.zeros(1), 0) for line in lines or (STRAIGHT,)]
    schedules = [
        Schedule(delay_s, (speed_m_s,) * legs, (0.0,) * legs, (0.0, 1e3))
        for delay_s, legs in zip(delays_s, (len(path.waypoints_m) - 1 for path in paths), strict=False)
    ]
    return proof.checked(scene, assemble(scene, paths, schedules, arrival_s, seed=1))


def certified(scene: Scene, *lines: Line, **changes: Any) -> Certificate:
    certificate = by_hand(scene, *lines, **changes).certificate
    assert certificate is not None
    return certificate


def sortie(scene: Scene, *legs: Leg, **changes: Any) -> Sortie:
    """Return alpha's straight sortie with other legs after the take-off, and other changes."""
    straight = proof.planned_sortie(scene, by_hand(scene).vehicles[0])
    return replace(straight, **({"legs": (straight.legs[0], *legs)} if legs else {}), **changes)


def leg(x_m: float, y_m: float, z_m: float = 140.0, *, seq: int = 3, **changes: Any) -> Leg:
    return Leg(**{"seq": seq, "kind": "straight", "end_m": np.array([x_m, y_m, z_m]), "speed_m_s": 5.0} | changes)


def problems(certificate: Certificate) -> list[str]:
    assert certificate.proven is (not certificate.problems)
    told = [str(finding) for finding in certificate.problems]
    assert all("\n" not in reason for reason in told)
    return told


def reasons(scene: Scene, *lines: Line, **changes: Any) -> list[str]:
    return problems(certified(scene, *lines, **changes))


def only_reason(scene: Scene, *lines: Line, **changes: Any) -> str:
    (reason,) = reasons(scene, *lines, **changes)
    return reason


def found(certificate: Certificate, check: str, vehicle: str = "alpha") -> Finding:
    (finding,) = [f for f in certificate.findings if f.check == check and f.vehicle == vehicle]
    return finding


def value(certificate: Certificate, check: str, vehicle: str = "alpha") -> float:
    finding = found(certificate, check, vehicle)
    assert finding.value is not None
    return finding.value


# --- obstacles: the just-clear place and, `nearer` metres further towards the path, the grazing one


def cylinder(nearer: float) -> dict[str, Any]:
    return {"kind": "cylinder", "name": "thing", "center": at(150, 20 + ROUNDING_M - nearer), "radius_m": 5}


def low_cylinder(nearer: float) -> dict[str, Any]:
    return {**cylinder(0.0), "center": at(150, 0), "top_alt_amsl_m": 125 - ROUNDING_M + nearer}


def cone(nearer: float) -> dict[str, Any]:
    # its mantle, 2 up for 1 in, stands 50 m wide on the ground; 40 m up, this far away is 15 m off at a right angle
    across = 50 - 40 / 2 + 15 * np.hypot(1, 0.5)
    return {
        "kind": "cone",
        "name": "thing",
        "center": at(150, across + ROUNDING_M - nearer),
        "base_radius_m": 50,
        "height_m": 100,
    }


def radar(nearer: float) -> dict[str, Any]:
    return {"kind": "radar", "name": "thing", "center": at(150, 55 + ROUNDING_M - nearer, amsl=140), "radius_m": 40}


def marine(nearer: float) -> dict[str, Any]:
    center = at(150, 0, amsl=140 - 55 - ROUNDING_M + nearer)
    return {"kind": "marine", "name": "thing", "center": center, "radius_m": 40}


def no_fly(nearer: float) -> dict[str, Any]:
    y = 15 + ROUNDING_M - nearer
    polygon = [at(150, y), at(190, y + 60), at(110, y + 60)]  # a corner points at the path
    return {"kind": "no_fly", "name": "thing", "polygon": polygon}


def airspace(nearer: float) -> dict[str, Any]:
    polygon = [at(100, -50), at(200, -50), at(200, 50), at(100, 50)]
    return {"kind": "no_fly", "name": "thing", "polygon": polygon, "floor_alt_amsl_m": 155 + ROUNDING_M - nearer}


def cable(nearer: float) -> dict[str, Any]:
    z = 140 - 15 - 0.5 - ROUNDING_M + nearer
    return {
        "kind": "cable",
        "name": "thing",
        "start": at(150, -80, amsl=z),
        "end": at(150, 80, amsl=z),
        "radius_m": 0.5,
    }


@pytest.mark.parametrize("thing", [cylinder, low_cylinder, cone, radar, marine, no_fly, airspace, cable])
def test_an_obstacle_may_be_passed_but_not_grazed(thing: Any) -> None:
    clear, grazed = (scene(obstacles=[thing(nearer)], area=TO_ONE_SIDE) for nearer in (0.0, 0.1))
    assert reasons(clear) == []
    finding = found(certified(clear), "obstacle")
    assert (finding.required, finding.to, finding.seq) == (10.0, "thing", 3)
    assert finding.value is not None
    assert 10.0 <= finding.value <= 10.05 + ROUNDING_M
    assert finding.position_m is not None
    assert clear.obstacles.distance_m(finding.position_m)[0] - 5.0 == pytest.approx(finding.value, abs=0.01)
    (clearance,) = [c for c in by_hand(clear).vehicles[0].clearances if c.what == "thing"]
    assert (clearance.distance_m, clearance.required_m, clearance.ok) == (finding.value, 10.0, True)
    reason = only_reason(grazed)
    assert reason.startswith("alpha: item 3: thing clearance is 9.9")
    assert reason.endswith("expected 10 m: move waypoint 3 or the one before it 0.1 m away")


@pytest.mark.parametrize("name", ["ridge", "terrain", "fence", "ceiling"])
def test_the_climb_from_home_is_held_against_obstacles_whatever_they_are_called(name: str) -> None:
    home = scene()
    pole = {"kind": "cable", "name": name, "start": at(0, -30, amsl=110), "end": at(0, -14, amsl=110), "radius_m": 0.5}
    further = scene({**ALPHA, "home": at(0, 3), "start": at(0, 3, amsl=140)}, obstacles=[pole])
    line: Line = [(0.0, 3.0, 140.0), (300.0, 0.0, 140.0)]
    assert reasons(further, line) == []
    plan = by_hand(further, line)
    tight = replace(plan, vehicles=(replace(plan.vehicles[0], home_m=home.tasks[0].home_m),))
    certificate = proof.checked(further, tight).certificate
    assert certificate is not None
    (problem,) = certificate.problems
    assert str(problem).startswith(f"alpha: item 1: {name} clearance is 9.")
    assert (problem.check, problem.to) == ("obstacle", name)
    assert problem.position_m is not None
    assert problem.position_m[2] == pytest.approx(109.5, abs=1.0)


def test_a_zone_that_is_only_priced_may_be_flown_through() -> None:
    zone = {"kind": "radar", "name": "zone", "center": at(150, 0, amsl=140), "radius_m": 40, "hard": False}
    assert reasons(scene(obstacles=[zone])) == []


def test_a_thin_cable_right_between_two_samples_is_found() -> None:
    thin = {**cable(0.0), "radius_m": 0.01, "start": at(123.4567, -80, amsl=140), "end": at(123.4567, 80, amsl=140)}
    assert "thing clearance is -5.01 m" in only_reason(scene(obstacles=[thin]))


def test_corners_are_cut_and_what_is_flown_is_what_counts() -> None:
    corner: Line = [(0.0, 0.0, 160.0), (150.0, 0.0, 160.0), (150.0, 150.0, 160.0)]
    vehicle = {**ALPHA, "start": at(0, 0, amsl=160), "goal": at(150, 150, amsl=160)}
    vehicle["motion"] = {"waypoint_radius_m": 20}
    # on the inner side, the legs keep 12 m and the flown curve does not
    inside = {"kind": "cylinder", "name": "mast", "center": at(150 - 17.1, 17.1), "radius_m": 5}
    there = scene(vehicle, obstacles=[inside])
    plan = by_hand(there, corner, speed_m_s=10.0)
    level = np.array([150 - 17.1, 17.1, 160.0])
    legs_m = distance_to_legs_m(level, polyline_legs(np.array(corner))).min() - 5.0
    flight = plan.vehicles[0].trajectory.position_m
    flown_m = np.hypot(flight[:, 0] - level[0], flight[:, 1] - level[1]).min() - 5.0
    assert legs_m >= 12.0 > flown_m
    assert plan.certificate is not None
    # what is proven holds for the flown curve and for all that the vehicle strays from it
    assert value(plan.certificate, "obstacle") <= flown_m - there.tasks[0].limits.stray_m
    assert "mast" in only_reason(there, corner, speed_m_s=10.0)
    narrow = {**vehicle, "motion": {"waypoint_radius_m": 2}}
    near = {**inside, "center": at(150 - 20.1, 20.1)}
    assert reasons(scene(narrow, obstacles=[near]), corner) == []


def test_faster_than_was_recorded_the_predicted_flight_must_stay_near_its_legs() -> None:
    zigzag = [[0.0, 0.0, 140.0], [100.0, 0.0, 140.0], [60.0, 90.0, 150.0], [300.0, 0.0, 140.0]]
    quick = copter("alpha", (0, 0), (300, 0), autopilot="px4", speed_m_s={"min": 3, "max": 12})
    question = scene(quick)

    def off(speed_m_s: float) -> list[Finding]:
        findings = certified(question, zigzag, speed_m_s=speed_m_s).findings
        return [f for f in findings if "off its legs" in f.detail]

    assert off(8.0) == []
    (told,) = off(12.0)
    assert told.value is not None
    assert told.required is not None
    assert told.proven == (told.value <= told.required)
    assert told.required == question.tasks[0].limits.deviation_m


def test_the_way_home_of_a_mission_that_returns_counts_too() -> None:
    around: Line = [(0.0, 0.0, 140.0), (0.0, 100.0, 140.0), (300.0, 100.0, 140.0), (300.0, 0.0, 140.0)]
    mast = {"kind": "cylinder", "name": "mast", "center": at(150, 0), "radius_m": 5}
    assert reasons(scene(obstacles=[mast]), around) == []
    returns = scene({**ALPHA, "end": "rtl"}, obstacles=[mast])
    assert only_reason(returns, around).startswith("alpha: item 6: mast clearance is -10.")
    low = scene({**ALPHA, "end": "rtl"}, obstacles=[{**mast, "top_alt_amsl_m": 170}])
    assert "mast" in only_reason(low, around)
    assert reasons(returning_at(low, {"alpha": 85.1}), around) == []  # 15 m above its top
    assert "mast clearance is 9.9" in only_reason(returning_at(low, {"alpha": 84.9}), around)


def test_the_landing_at_the_end_counts_too() -> None:
    # beside the ground below the goal, not beside the goal itself
    post = {"kind": "cylinder", "name": "post", "center": at(317.9, 0), "radius_m": 3, "top_alt_amsl_m": 115}
    there = scene({**ALPHA, "end": "loiter"}, obstacles=[post])
    assert reasons(there) == []
    lands = replace(there, tasks=(replace(there.tasks[0], end="land"),))  # which a scene would have refused
    assert only_reason(lands).startswith("alpha: item 4: post clearance is 9.9")


# --- terrain


def hump(height_m: float, spread_m: float = 30.0) -> dict[str, Any]:
    peaks = [{**at(150, 0), "height_m": height_m, "spread_m": spread_m}]
    return {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": peaks}


def test_a_hill_between_two_good_waypoints() -> None:
    assert reasons(scene(terrain=hump(14.85))) == []
    low = only_reason(scene(terrain=hump(15.1)))
    assert low.startswith("alpha: item 3: terrain clearance is 19.")
    assert "expected 20 m: raise waypoint 3 or the one before it by 0." in low
    inside = value(certified(scene(terrain=hump(90))), "terrain")
    assert -55.2 <= inside <= -55.0 + ROUNDING_M
    over: Line = [STRAIGHT[0], (75.0, 0.0, 216.0), (225.0, 0.0, 216.0), STRAIGHT[1]]
    assert reasons(scene(terrain=hump(90)), over) == []


def sampled_ball_m(scene: Scene, line: Line, radius_m: float) -> float:
    """Return the least height above ground of many points at most ``radius_m`` from a line."""
    rng = np.random.default_rng(1)
    start, end = np.array(line[0]), np.array(line[1])
    centers = start + rng.random((400_000, 1)) * (end - start)
    out = rng.normal(size=centers.shape)
    points = centers + radius_m * out / np.linalg.norm(out, axis=1)[:, np.newaxis]
    return float((points[:, 2] - scene.terrain.height_amsl_m(points[:, 0], points[:, 1])).min())


def test_beside_a_slope_the_tube_is_a_ball_not_a_plumb_line() -> None:
    # 40 degrees steep: what is nearest to the ground is uphill, not straight below
    beside = scene(terrain={**hump(100, spread_m=100), "peaks": [{**at(150, 75), "height_m": 100, "spread_m": 100}]})
    line: Line = [(60.0, 0.0, 200.0), (240.0, 0.0, 200.0)]
    legs = polyline_legs(np.array(line))
    bound_m = float(tube_clearances(beside.space, beside.terrain.bounds, legs, np.array([5.0])).height_min_m[0])
    sampled_m = sampled_ball_m(beside, line, 5.0)
    below_m = float(kernels.legs_clearance(beside.space, legs, 0.1)[0, kernels.HEIGHT_MIN]) - 5.0
    assert below_m > sampled_m + 0.5  # else this tests nothing
    assert sampled_m - 0.3 <= bound_m <= sampled_m
    # and the whole certificate says so of its least clearance
    vehicle = {**ALPHA, "start": at(0, 0, amsl=190), "goal": at(300, 0, amsl=190)}
    vehicle["safety"] = {"terrain_m": 20, "landing_slope_max_deg": 45}
    level: Line = [(0.0, 0.0, 190.0), (300.0, 0.0, 190.0)]
    slope = scene(vehicle, terrain=beside.mission.terrain.model_dump(exclude_none=True))
    proven_m = value(certified(slope, level), "terrain")
    assert proven_m <= sampled_ball_m(slope, level, 5.0)
    assert proven_m >= sampled_ball_m(slope, level, 5.0) - 0.3


def test_a_steep_rock_under_a_long_leg_is_not_stepped_over() -> None:
    rock = {**hump(60, spread_m=12), "cell_m": 6}
    rock["peaks"][0] |= at(123.4, 0)
    there = scene(terrain=rock, area={"south_west": at(-50, -50), "north_east": at(350, 50)})
    finding = found(certified(there), "terrain")
    x = np.linspace(115, 132, 100_001)
    ground = kernels.terrain_heights(there.space.terrain, np.stack([x, np.zeros_like(x)], axis=-1))
    assert ground.max() > 150
    assert finding.value is not None
    assert finding.value <= 140 - 5 - ground.max() + ROUNDING_M
    assert not finding.proven
    assert finding.position_m is not None
    assert finding.position_m[0] == pytest.approx(x[ground.argmax()], abs=2.0)


def test_where_it_is_too_low_is_told() -> None:
    certificate = certified(scene(terrain=hump(90)))
    finding = found(certificate, "terrain")
    assert finding.position_m == pytest.approx((150, 0, 135), abs=0.3)  # in the tube, not on the leg
    assert finding.seq == 3
    (low,) = [verdict for verdict in certificate.legs if not verdict.proven]
    assert (low.vehicle, low.seq, low.kind, low.terrain_m) == ("alpha", 3, "straight", finding.value)
    assert low.start_m == pytest.approx(STRAIGHT[0], abs=0.02)
    assert low.end_m == pytest.approx(STRAIGHT[1], abs=0.02)


def without_ground(known: Scene, columns: slice, rows: slice = slice(None)) -> Scene:
    heights = known.space.terrain.height_amsl_m.copy()
    heights[rows, columns] = np.nan
    arrays = known.space.terrain._replace(height_amsl_m=heights)
    ground = replace(known.terrain, arrays=arrays, bounds=pyramid(arrays, 2000.0))
    return replace(known, terrain=ground, space=known.space._replace(terrain=arrays))


def test_missing_terrain_is_no_clearance() -> None:
    known = scene()
    middle = known.space.terrain.height_amsl_m.shape[1] // 2
    finding = found(certified(without_ground(known, slice(middle, middle + 1))), "terrain")
    assert (finding.proven, finding.value) == (False, -math.inf)
    assert str(finding) == (
        "alpha: item 3: the ground below is not known: give a terrain that covers the way, without voids"
    )


def test_missing_terrain_beside_the_leg_but_within_its_tube_is_no_clearance_either() -> None:
    # samples are 30 m apart, one row of them at y = 0; the surface needs two to each side
    known = scene()
    row = round(kernels.cell_position(known.space.terrain, 0.0, 0.0)[0])
    north, beyond = (without_ground(known, slice(None), slice(row - off, row - off + 1)) for off in (2, 3))
    # the leg at y = -3 m knows its ground; its tube, 2 m north of that row, does not
    assert np.isfinite(north.terrain.height_amsl_m(np.linspace(0, 300, 50), np.full(50, -3.0))).all()
    assert not found(certified(north, shifted(-3.0)), "terrain").proven
    assert found(certified(beyond, shifted(-3.0)), "terrain").proven


def test_a_mission_beyond_the_terrain_is_not_proven() -> None:
    there = scene(area={"south_west": at(-50, -50), "north_east": at(350, 50)})
    away = sortie(there, leg(3000, 0), ending="loiter")
    told = problems(proof.prove(there, [away]))
    assert any("the ground below is not known" in reason for reason in told)
    assert any("fence" in reason or "edge of the area" in reason for reason in told)


def test_a_waypoint_under_the_ground_is_no_clearance_either() -> None:
    below: Line = [STRAIGHT[0], (150.0, 0.0, 90.0), STRAIGHT[1]]
    assert any("terrain clearance is -15.0" in reason for reason in reasons(scene(), below))


# --- ceilings, fence, area


@pytest.mark.parametrize("ceiling", [{"height_agl_max_m": 60}, {"alt_amsl_max_m": 160}])
def test_a_ceiling(ceiling: dict[str, float]) -> None:
    # of a wide arch only its top comes near the ceiling, its tube 5 m higher
    low, high = ([STRAIGHT[0], (150.0, 0.0, top), STRAIGHT[1]] for top in (154.99, 155.1))
    assert reasons(scene({**ALPHA, **ceiling}), low) == []
    finding = found(certified(scene({**ALPHA, **ceiling}), high), "ceiling")
    assert not finding.proven
    assert finding.value == pytest.approx(-0.1, abs=2e-3)
    assert finding.required == 0.0
    assert only_reason(scene({**ALPHA, **ceiling}), high).endswith("or the one before it by 0.1 m")
    (clearance,) = [c for c in by_hand(scene({**ALPHA, **ceiling}), high).vehicles[0].clearances if c.what == "ceiling"]
    assert (clearance.ok, clearance.distance_m) == (False, finding.value)


def test_the_ceiling_above_ground_follows_the_ground_down() -> None:
    # between two plateaus the ground is 100 m, on them it is 140 m
    plateaus = [{**at(x, 0), "height_m": 40, "spread_m": 60} for x in (0, 300)]
    ground = {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": plateaus}
    level = [(0.0, 0.0, 180.0), (300.0, 0.0, 180.0)]
    vehicle = {**ALPHA, "start": at(0, 0, amsl=180), "goal": at(300, 0, amsl=180)}
    assert "its tube reaches 84.8" in only_reason(scene({**vehicle, "height_agl_max_m": 70}, terrain=ground), level)
    assert reasons(scene({**vehicle, "height_agl_max_m": 90}, terrain=ground), level) == []


def notched(depth_y: float) -> dict[str, Any]:
    corners = [(-50, -100), (140, -100), (150, depth_y), (160, -100), (350, -100), (350, 100), (-50, 100)]
    return {"polygon": [at(x, y) for x, y in corners]}


def test_a_fence() -> None:
    # distances to a fence are lower bounds, at most 0.03 m and 1 % too small
    assert reasons(scene(fence=notched(-15.25))) == []
    reason = only_reason(scene(fence=notched(-14.9)))
    assert reason.startswith(("alpha: item 3: fence clearance is 9.7", "alpha: item 3: fence clearance is 9.8"))
    assert "expected 10 m" in reason


def test_the_top_of_the_fence() -> None:
    arch: Line = [STRAIGHT[0], (150.0, 0.0, 160.0), STRAIGHT[1]]
    fence = notched(-50.0)
    assert reasons(scene(fence={**fence, "top_alt_amsl_m": 175.25}), arch) == []
    assert "fence clearance is 9.8" in only_reason(scene(fence={**fence, "top_alt_amsl_m": 174.9}), arch)


def test_the_edge_of_the_area() -> None:
    out: Line = [STRAIGHT[0], (150.0, 140.0, 140.0), STRAIGHT[1]]
    assert "edge of the area clearance is 5.0" in only_reason(scene(area=TO_ONE_SIDE), out)
    assert reasons(scene(area=TO_ONE_SIDE), [STRAIGHT[0], (150.0, 134.9, 140.0), STRAIGHT[1]]) == []


# --- what the vehicle can do


def test_a_leg_too_steep() -> None:
    vehicle = {**ALPHA, "climb": {"angle_max_deg": 20}, "descent": {"angle_max_deg": 30}}
    ok: Line = [STRAIGHT[0], (150.0, 0.0, 140.0 + 150 * np.tan(np.radians(19.9))), STRAIGHT[1]]
    up: Line = [STRAIGHT[0], (150.0, 0.0, 140.0 + 150 * np.tan(np.radians(20.1))), STRAIGHT[1]]
    down: Line = [STRAIGHT[0], (220.0, 0.0, 140.0 + 80 * np.tan(np.radians(30.1))), STRAIGHT[1]]
    assert reasons(scene(vehicle), ok) == []
    assert only_reason(scene(vehicle), up).startswith(
        "alpha: item 3: its steepest leg climbs at 20.1 degrees, allowed 20.0"
    )
    assert only_reason(scene(vehicle), down).startswith("alpha: item 4: its steepest leg descends at 30.1 degrees")
    assert reasons(scene({**vehicle, "descent": {"angle_max_deg": 31}}), down) == []


CORNER: Line = [(0.0, 0.0, 140.0), (150.0, 0.0, 140.0), (150.0, 150.0, 140.0)]


def at_the_corner(**changes: Any) -> dict[str, Any]:
    return {**ALPHA, "goal": at(150, 150, amsl=140), **changes}


def test_a_turn_too_sharp() -> None:
    assert reasons(scene(at_the_corner(turn_angle_max_deg=90.1)), CORNER) == []
    reason = only_reason(scene(at_the_corner(turn_angle_max_deg=89)), CORNER)
    assert reason == "alpha: item 3: turns by 90 degrees, allowed 89: put waypoints around the corner"
    back: Line = [(0.0, 0.0, 140.0), (200.0, 0.0, 140.0), (100.0, 1.0, 140.0)]
    vehicle = {**ALPHA, "goal": at(100, 1, amsl=140), "turn_angle_max_deg": 170}
    assert only_reason(scene(vehicle), back).startswith("alpha: item 3: turns by 179 degrees, allowed 170")


def test_a_turn_too_tight() -> None:
    # an arc of radius r passes a right angle at r (sqrt 2 - 1): 2 m of corner cutting allow for 4.83 m
    assert reasons(scene(at_the_corner(turn_radius_m=4.82)), CORNER) == []
    reason = only_reason(scene(at_the_corner(turn_radius_m=4.84)), CORNER)
    assert reason.startswith("alpha: item 3: turns with a radius of 4.8 m, expected at least 4.84 m")
    wide = scene(at_the_corner(turn_radius_m=4.84, motion={"waypoint_radius_m": 3}))
    assert reasons(wide, CORNER) == []
    # who stops turns on the spot
    there = scene(at_the_corner(turn_radius_m=4.84))
    through, stops = (
        sortie(there, leg(150, 0, hold_s=hold_s), leg(150, 150, seq=4), ending_seq=5) for hold_s in (0.0, 1.0)
    )
    assert [p.check for p in proof.prove(there, [through]).problems] == ["turn"]
    assert problems(proof.prove(there, [stops])) == []


def test_what_the_planner_asks_of_corners_is_what_is_proven() -> None:
    for vehicle, allowed in (
        (at_the_corner(turn_radius_m=4.82), True),
        (at_the_corner(turn_radius_m=4.84), False),
        (at_the_corner(turn_angle_max_deg=89), False),
    ):
        there = scene(vehicle)
        assert proof.turns_allowed(there.tasks[0], np.array(CORNER)) is allowed
        assert found(certified(there, CORNER), "turn").proven is allowed


@pytest.mark.parametrize(("speed_m_s", "proven"), [(3.0, True), (10.0, True), (2.99, False), (10.01, False)])
def test_a_speed_out_of_range(speed_m_s: float, proven: bool) -> None:
    there = scene()
    two = sortie(there, leg(100, 0), leg(300, 0, seq=5, speed_m_s=speed_m_s), ending_seq=6)
    finding = found(proof.prove(there, [two]), "speed")
    assert finding.proven is proven
    if not proven:
        assert finding.seq == 5
        assert finding.value == speed_m_s
        assert "allowed 3 to 10 m/s" in finding.detail


def test_endurance_is_time_in_the_air_with_a_reserve() -> None:
    flight = by_hand(scene(), delays_s=[100.0]).vehicles[0].trajectory
    airborne_s = float(flight.t_s[-1]) - 100.0
    assert 60 < airborne_s < 160

    def energies(endurance_s: float) -> tuple[Finding, ...]:
        certificate = certified(scene({**ALPHA, "endurance_s": endurance_s}), delays_s=[100.0])
        return tuple(f for f in certificate.findings if f.check == "energy")

    total, home = energies(1000.0)
    assert total.value is not None
    assert total.required == pytest.approx(0.8)
    # hovering empties the battery in 1000 s, waiting on the ground takes nothing, climbing a little more
    assert airborne_s / 1000.0 < total.value < 1.2 * airborne_s / 1000.0
    assert home.waived
    just_s = 1000.0 * total.value / 0.8
    assert energies(just_s + 0.01)[0].proven
    short = energies(just_s - 0.01)[0]
    assert not short.proven
    assert "takes 80.0% of its battery, allowed 80%" in str(short)
    assert reasons(scene({**ALPHA, "endurance_s": just_s - 0.01}), delays_s=[100.0]) == [str(short)]


# --- where it lands


def slope(angle_deg: float, at_x: float) -> dict[str, Any]:
    """Return ground that is level at (0, 0), and ``angle_deg`` steep at its steepest around ``at_x``."""
    spread_m = 60.0
    height_m = math.tan(math.radians(angle_deg)) * spread_m * math.exp(0.5) / math.sqrt(2.0)
    peak = {**at(at_x + spread_m / math.sqrt(2.0), 0), "height_m": height_m, "spread_m": spread_m}
    return {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": [peak]}


@pytest.mark.parametrize(("angle_deg", "proven"), [(13.0, True), (15.5, False)])
def test_ground_too_steep_to_land_on(angle_deg: float, proven: bool) -> None:
    there = scene({**ALPHA, "end": "rtl"}, terrain=slope(angle_deg, 300.0))
    goal_m = float(there.terrain.height_amsl_m(300.0, 0.0))
    high = proof.planned_sortie(there, by_hand(there).vehicles[0])
    ends = leg(300, 0, 160, seq=3)
    lands = replace(high, legs=(high.legs[0], ends), ending="land", ending_seq=4)
    home, place = [f for f in proof.prove(there, [lands]).findings if f.check == "landing"]
    assert (home.proven, home.required) == (True, pytest.approx(15.0))
    assert (place.proven, place.seq) == (proven, 4)
    assert place.value is not None
    assert angle_deg - 0.2 <= place.value <= angle_deg + 1.5
    # returning, it does not land there; standing there, it would
    returns = proof.prove(there, [replace(lands, ending="rtl")])
    assert [f.proven for f in returns.findings if f.check == "landing"] == [True]
    starts = replace(lands, ending="loiter", home_m=np.array([300.0, 0.0, goal_m]))
    (home,) = [f for f in proof.prove(there, [starts]).findings if f.check == "landing"]
    assert home.proven is proven
    if not proven:
        assert "home lies on ground of at most" in str(home)
        assert "allowed 15: move it to level ground" in str(home)


def test_unknown_ground_is_none_to_land_on() -> None:
    known = scene()
    middle = round(kernels.cell_position(known.space.terrain, 0.0, 0.0)[1])
    finding = [f for f in certified(without_ground(known, slice(middle, middle + 1))).findings if f.check == "landing"]
    assert [f.proven for f in finding] == [False, True]
    assert "home: the ground is not known" in str(finding[0])


# --- missions of any origin


@pytest.mark.parametrize("hold_s", [0.0, 2.0])
def test_a_spline_leg_keeps_its_tube_around_the_curve(hold_s: float) -> None:
    there = scene(obstacles=[{"kind": "cylinder", "name": "mast", "center": at(160, -40), "radius_m": 3}])
    curved = sortie(
        there,
        leg(100, 0),
        leg(200, 0, kind="spline", seq=4, hold_s=hold_s),
        leg(200, 120, seq=5),
        leg(300, 0, seq=6),
        ending_seq=7,
    )
    certificate = proof.prove(there, [curved])
    t = np.linspace(0.0, 1.0, 20_001)[:, np.newaxis]
    b = spline_bezier(curved, 2)
    curve = (1 - t) ** 3 * b[0] + 3 * (1 - t) ** 2 * t * b[1] + 3 * (1 - t) * t**2 * b[2] + t**3 * b[3]
    off_m = np.hypot(curve[:, 0] - 160, curve[:, 1] + 40).min() - 3.0
    (verdict,) = [v for v in certificate.legs if v.kind == "spline"]
    assert verdict.seq == 4
    assert verdict.obstacle_m is not None
    assert off_m - 5.0 - 0.11 <= verdict.obstacle_m <= off_m - 5.0
    if hold_s == 0.0:  # it swings out, away from the leg after it, where a straight leg would have stayed 37 m off
        assert off_m < 36.0
    # and when it is where
    told = problems(certificate)
    assert told == []  # one vehicle, its return waived
    pair = scene(ALPHA, beside(60))
    other = replace(proof.planned_sortie(pair, by_hand(pair, STRAIGHT, shifted(60)).vehicles[1]))
    apart = [f for f in proof.prove(pair, [curved, other]).findings if f.check == "separation"]
    assert len(apart) == 1
    assert apart[0].value is not None
    asked = scene(fleet={"direct_return": "required"})
    assert all("not known" not in f.detail for f in proof.prove(asked, [curved]).findings if f.check == "return")
    limited = scene({**ALPHA, "endurance_s": 3600})
    assert "energy" not in [p.check for p in proof.prove(limited, [curved]).problems]


def test_a_spline_that_turns_back_faster_than_the_vehicle_can_is_told() -> None:
    there = scene()
    for speed_m_s, near in ((10.0, False), (2.5, True)):
        hairpin = [leg(300, 0, seq=3), leg(260, 10, kind="spline", seq=4), leg(100, 60, seq=5)]
        slow = [replace(part, speed_m_s=speed_m_s) for part in hairpin]
        certificate = proof.prove(there, [sortie(there, *slow, ending_seq=6)])
        (finding,) = [f for f in certificate.findings if "off its legs" in f.detail]
        assert finding.proven == near
        assert near or "fly slower" in str(finding)


def test_a_spline_too_steep_is_told() -> None:
    vehicle = {**ALPHA, "climb": {"angle_max_deg": 20}}
    there = scene(vehicle)
    # from rest to rest, a spline climbs as steeply as the straight leg; from a fast start it overshoots
    gentle = leg(200, 0, 160, kind="spline", seq=4)
    swings = sortie(there, leg(100, 0, 140), gentle, leg(205, 0, 240, seq=5), ending="loiter", ending_seq=5)
    finding = found(proof.prove(there, [swings]), "angle")
    assert not finding.proven


@pytest.mark.parametrize(
    ("x_m", "y_m", "seqs"), [(150, 60, {3, 4}), (110, -45, {3, 4}), (50, 20, {3}), (225, 35, {4}), (290, -20, {4})]
)
def test_around_a_circle_everything_counts(x_m: float, y_m: float, seqs: set[int]) -> None:
    # the way to where its edge is nearest, all around it, and from anywhere on it to the next waypoint
    post = {"kind": "cylinder", "name": "post", "center": at(x_m, y_m), "radius_m": 1}
    there = scene(obstacles=[post])
    legs = (leg(150, 0, kind="circle", radius_m=40.0, turns=2.0), leg(300, 0, seq=4))
    finding = found(proof.prove(there, [sortie(there, *legs, ending_seq=5)]), "obstacle")
    angle = np.linspace(0.0, 2.0 * np.pi, 5000)
    ring = np.stack([150 + 40 * np.cos(angle), 40 * np.sin(angle), np.full_like(angle, 140)], axis=-1)
    onwards = np.stack([ring, np.broadcast_to([300.0, 0.0, 140.0], ring.shape)], axis=1)
    edges = ring[np.abs(angle - np.pi) <= 5.0 / 150.0]  # its edge is nearest there, seen from 5 m around home
    onto = np.stack([np.broadcast_to([0.0, 0.0, 140.0], edges.shape), edges], axis=1)
    center = np.array([x_m, y_m, 140.0])
    exact_m = min(distance_to_legs_m(center, ways).min() for ways in (polyline_legs(ring), onwards, onto)) - 1 - 5
    assert finding.value is not None
    assert (
        exact_m - 4.0 <= finding.value <= exact_m + ROUNDING_M
    )  # a polygon of 64 sides, 2 m between middle and corner
    assert finding.seq in seqs  # on the circle begins the leg after it as well


WIDE = {"south_west": at(-200, -300), "north_east": at(500, 300)}


def test_a_circle_is_entered_from_its_middle_in_any_direction() -> None:
    def proven(x_m: float) -> bool:
        post = {"kind": "cylinder", "name": "post", "center": at(x_m, 50), "radius_m": 1}
        there = scene(obstacles=[post], area=WIDE)
        legs = (leg(150, 0), leg(150, 0, seq=4, kind="circle", radius_m=100.0, turns=1.0))
        return proof.prove(there, [sortie(there, *legs, ending="loiter", ending_seq=4)]).proven

    assert not proven(150)  # halfway between the middle and the edge
    assert proven(275)


def test_a_circle_is_entered_at_its_own_altitude() -> None:
    # down from 200 m to its edge, 130 m away; the straight way to its middle would pass 17 m above the block
    def proven(top_m: float) -> bool:
        block = {"kind": "cylinder", "name": "block", "center": at(75, 0), "radius_m": 5, "top_alt_amsl_m": top_m}
        there = scene(obstacles=[block], area=WIDE)
        circle = leg(250, 0, 140, seq=4, kind="circle", radius_m=120.0, turns=1.0)
        high = sortie(there, circle, ending="loiter", ending_seq=4)
        first = replace(high.legs[0], end_m=np.array([0.0, 0.0, 200.0]))
        return proof.prove(there, [replace(high, legs=(first, circle))]).proven

    assert not proven(158.0)
    assert proven(135.0)


def test_what_stands_in_a_circles_middle_is_not_in_the_way() -> None:
    mast = {"kind": "cylinder", "name": "mast", "center": at(150, 0), "radius_m": 2}
    there = scene(obstacles=[mast], area=WIDE)
    circle = leg(150, 0, seq=4, kind="circle", radius_m=30.0, turns=3.0)
    assert proof.prove(there, [sortie(there, circle, ending="loiter", ending_seq=4)]).proven


def test_landing_anywhere_on_a_circle_is_not_proven() -> None:
    there = scene(area=WIDE)
    circle = leg(150, 0, seq=4, kind="circle", radius_m=100.0, turns=1.0)
    (reason,) = problems(proof.prove(there, [sortie(there, circle, ending_seq=5)]))
    assert reason == "alpha: item 5: lands anywhere on its circle: put a waypoint above the landing place"


def test_steepness_counts_from_circle_to_circle() -> None:
    there = scene(area=WIDE)
    # 31 degrees from middle to middle, 63 from edge to edge: 60 are allowed
    first, second = (leg(x, 0, z, seq=s, kind="circle", radius_m=35.0) for s, x, z in ((3, 150, 140), (4, 250, 200)))
    assert found(proof.prove(there, [sortie(there, first, second, ending="loiter", ending_seq=4)]), "angle").seq == 4
    assert not found(proof.prove(there, [sortie(there, first, second, ending="loiter", ending_seq=4)]), "angle").proven


def test_circles_of_planes_on_their_way_are_not_proven() -> None:
    wing = {"name": "wing", "class": "plane", "home": at(0, 0), "goal": at(1000, 0, amsl=220)}
    there = scene(wing, area={"south_west": at(-900, -900), "north_east": at(2500, 900)})
    ends = [(1, "takeoff", 300, 180, {}), (4, "circle", 1000, 220, {"radius_m": 300.0}), (5, "straight", 1500, 220, {})]
    legs = tuple(leg(x, 0, z, seq=seq, kind=kind, **more) for seq, kind, x, z, more in ends)
    flown = Sortie("wing", 1, "ardupilot", "plane", np.array([0.0, 0.0, 100.0]), legs, "loiter", 5, 0.0, 100.0)
    finding = found(proof.prove(there, [flown]), "understood", "wing")
    assert (finding.holds, finding.seq) == (False, 4)


@pytest.mark.parametrize(("x_m", "clear"), [(600, False), (-600, True)])
def test_a_plane_climbs_over_nothing_that_it_cannot(x_m: float, clear: bool) -> None:
    # it passes 600 m at about 220 m; a hill there is 240 m high
    hill = {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": [{**at(x_m, 0), "height_m": 140, "spread_m": 80}]}
    wing = {"name": "wing", "class": "plane", "home": at(0, 0), "goal": at(2600, 0, amsl=300)}
    area = {"south_west": at(-900, -900), "north_east": at(4000, 900)}
    asked = Mission.model_validate(question(wing, area=area, terrain=hill, fleet={"direct_return": "waived"}))
    there = build_check_scene(asked, Path(), [])
    legs = (leg(1800, 0, 300, seq=1, kind="takeoff"), leg(2600, 0, 300, speed_m_s=18.0))
    flown = Sortie("wing", 1, "ardupilot", "plane", np.array([0.0, 0.0, 100.0]), legs, "loiter", 3, 0.0, 100.0)
    certificate = proof.prove(there, [flown])
    assert found(certificate, "takeoff", "wing").proven is certificate.proven is clear
    # the predicted one, which is strong, flies over the hill; one that climbs as stated meets it
    (task,) = there.tasks
    for motion, over in ((task.motion, True), (climbing_as_stated(task.motion, 100.0), clear)):
        trajectory, _ = timing.predict_flight(motion, flown.home_m, [leg.end_m for leg in legs], 18.0)
        climb_m = trajectory.position_m[trajectory.position_m[:, 0] > 200.0]
        through_m = climb_m[:, 2] - there.terrain.height_amsl_m(climb_m[:, 0], climb_m[:, 1])
        assert bool(through_m.min() > 0.0) is over


@pytest.mark.parametrize(("rate_m_s", "clear"), [(5.0, False), (12.0, True)])
def test_a_plane_that_is_stated_to_climb_well_may_fly_over_more(rate_m_s: float, clear: bool) -> None:
    hill = {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": [{**at(600, 0), "height_m": 130, "spread_m": 80}]}
    wing = {
        "name": "wing",
        "class": "plane",
        "home": at(0, 0),
        "goal": at(2600, 0, amsl=300),
        "climb": {"rate_m_s": rate_m_s},
    }
    area = {"south_west": at(-900, -900), "north_east": at(4000, 900)}
    asked = Mission.model_validate(question(wing, area=area, terrain=hill, fleet={"direct_return": "waived"}))
    there = build_check_scene(asked, Path(), [])
    legs = (leg(1800, 0, 300, seq=1, kind="takeoff"), leg(2600, 0, 300, speed_m_s=18.0))
    flown = Sortie("wing", 1, "ardupilot", "plane", np.array([0.0, 0.0, 100.0]), legs, "loiter", 3, 0.0, 100.0)
    certificate = proof.prove(there, [flown])
    assert found(certificate, "takeoff", "wing").proven is clear
    assert [verdict.kind for verdict in certificate.legs] == ["takeoff", "straight", "loiter"]
    assert [verdict.seq for verdict in certificate.legs] == [1, 3, 3]


@pytest.mark.parametrize("height_m", [30.0, 75.0, 110.0, 190.0])
def test_between_a_weak_and_a_strong_climb_no_cable_may_hang(height_m: float) -> None:
    # 400 m out the weak one is 80 m up, the strong one 140 m
    posts = {name: at(400, y, amsl=100 + height_m) for name, y in (("start", -400), ("end", 400))}
    cable = {"kind": "cable", "name": "line", **posts}
    wing = {"name": "wing", "class": "plane", "home": at(0, 0), "goal": at(2600, 0, amsl=300)}
    area = {"south_west": at(-900, -900), "north_east": at(4000, 900)}
    terrain = {"kind": "flat", "alt_amsl_m": 100}
    fleet = {"direct_return": "waived"}
    asked = Mission.model_validate(question(wing, area=area, terrain=terrain, fleet=fleet, obstacles=[cable]))
    there = build_check_scene(asked, Path(), [])
    legs = (leg(1800, 0, 300, seq=1, kind="takeoff"), leg(2600, 0, 300, speed_m_s=18.0))
    flown = Sortie("wing", 1, "ardupilot", "plane", np.array([0.0, 0.0, 100.0]), legs, "loiter", 3, 0.0, 100.0)
    certificate = proof.prove(there, [flown])
    assert found(certificate, "obstacle", "wing").proven is (height_m in (30.0, 190.0))
    assert certificate.legs[0].proven is (height_m in (30.0, 190.0))


@pytest.mark.parametrize("what", ["item 3", "home", "start delay and return height"])
def test_no_bound_holds_for_what_is_no_number(what: str) -> None:
    there = scene()
    good = sortie(there)
    bad = {
        "item 3": replace(good, legs=(good.legs[0], leg(300, 0, math.nan))),
        "home": replace(good, home_m=np.array([0.0, math.nan, 100.0])),
        "start delay and return height": replace(good, ending="rtl", return_height_m=math.nan),
    }[what]
    with pytest.raises(MissionError, match=f"alpha: {what}: expected finite numbers, got .*nan"):
        proof.prove(there, [bad])


def test_who_only_takes_off_and_lands_may_be_told_to_return_on_its_way_up() -> None:
    # alpha climbs while bravo, on its way out, would return above alpha's home; when alpha lands, bravo is past it
    bravo = copter("bravo", (-300, 0), (-150, 200))
    wide = {"south_west": at(-900, -900), "north_east": at(900, 900)}
    there = scene(ALPHA, bravo, area=wide, fleet={"direct_return": "required"})
    up = sortie(scene(ALPHA, area=wide))
    first = replace(up.legs[0], end_m=np.array([0.0, 0.0, 250.0]))
    alpha = replace(up, legs=(first,), ending_seq=2, return_height_m=300.0, start_delay_s=260.0)
    begin = replace(first, end_m=np.array([-300.0, 0.0, 400.0]))
    legs = (begin, leg(200, 0, 400), leg(200, 60, 400, seq=4), leg(-150, 0, 400, seq=5))
    home_m = np.array([-300.0, 0.0, 100.0])
    other = replace(up, name="bravo", home_m=home_m, legs=legs, ending_seq=6, return_height_m=60.0)
    assert not found(proof.prove(there, [alpha, other]), "return", "alpha - bravo").proven


def test_who_starts_when_and_who_does_not_fly_is_stated() -> None:
    bravo = copter("bravo", (0, 60), (300, 60))
    there = scene(ALPHA, bravo)
    alone = sortie(scene(ALPHA))
    assert "not judged, and taken not to fly: bravo" in proof.prove(there, [alone]).assumptions
    other = replace(alone, name="bravo", start_delay_s=12.0)
    told = "all missions are started together, and vehicles start: alpha after 0 s, bravo after 12 s"
    assert told in proof.prove(there, [alone, other]).assumptions


def test_what_is_not_understood_is_not_proven() -> None:
    there = scene()
    gap = Gap(7, "DO_JUMP: repeats items, its path is not followed")
    certificate = proof.prove(there, [sortie(there, gaps=(gap, Gap(9, "also this")))])
    finding = found(certificate, "understood")
    assert not finding.holds
    assert str(finding).startswith("alpha: item 7: DO_JUMP: repeats items, its path is not followed; item 9: also")
    assert not certificate.proven
    pair = scene(ALPHA, beside(60))
    other = proof.planned_sortie(pair, by_hand(pair, STRAIGHT, shifted(60)).vehicles[1])
    both = proof.prove(pair, [sortie(there, gaps=(gap,)), other])
    assert not found(both, "separation", "").proven
    assert found(proof.prove(there, [sortie(there)]), "understood").proven


def test_notes_and_figures_are_told() -> None:
    there = scene()
    certificate = proof.prove(there, [sortie(there, notes=("item 5: is odd",))], mission_sha256={"alpha": "ab" * 32})
    told = "\n".join(certificate.assumptions)
    assert (
        "alpha stays within 5 m of its legs: 2 m tracking, 1 m position, 2 m corners cut and look-ahead of ardupilot"
        in certificate.assumptions
    )
    assert "alpha: item 5: is odd" in certificate.assumptions
    assert "alpha 15 m" in told
    assert certificate.mission_sha256 == {"alpha": "ab" * 32}
    assert certificate.return_height_m == {"alpha": 15.0}
    assert certificate.input_sha256 == there.input_sha256


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("end", ["land", "rtl", "loiter"])
@pytest.mark.parametrize("kind", ["copter", "plane"])
def test_a_plan_is_proven_as_it_will_be_read_back_from_its_items(autopilot: str, end: str, kind: str) -> None:
    vehicle = {**ALPHA, "autopilot": autopilot, "end": end, "class": kind}
    line: Line = [(0.0, 0.0, 140.0), (123.456789, 7.654321, 147.123456), (300.0, 0.0, 140.0)]
    speed_m_s = 7.123456
    if kind == "plane":
        if end == "land":
            pytest.skip("our planes do not land by themselves")
        vehicle = {**vehicle, "home": at(-300, 0), "start": at(100, 0, amsl=170), "goal": at(900, 0, amsl=170)}
        line = [(0.0, 0.0, 150.0), (123.456789, 7.654321, 171.123456), (900.0, 0.0, 170.0)]
        speed_m_s = 17.123456
    ground = {"kind": "flat", "alt_amsl_m": 100.123456}
    there = scene(vehicle, area={"south_west": at(-700, -500), "north_east": at(1400, 500)}, terrain=ground)
    plan = by_hand(there, line, speed_m_s=speed_m_s, delays_s=[3.5])
    planned, read = proof.planned_sortie(there, plan.vehicles[0]), plan_sortie(plan.vehicles[0], there.frame)
    assert not read.gaps
    assert len(planned.legs) == len(read.legs)
    for one, other in zip(planned.legs, read.legs, strict=True):
        assert (one.seq, one.kind, one.hold_s, one.radius_m) == (other.seq, other.kind, other.hold_s, other.radius_m)
        np.testing.assert_allclose(one.end_m, other.end_m, rtol=0.0, atol=1e-6)
    assert [x.speed_m_s for x in planned.legs[1:]] == [x.speed_m_s for x in read.legs[1:]]
    np.testing.assert_allclose(planned.home_m, read.home_m, rtol=0.0, atol=1e-6)
    for field in ("name", "sysid", "autopilot", "vehicle_class", "ending", "ending_seq", "start_delay_s"):
        assert getattr(planned, field) == getattr(read, field), field
    assert planned.return_height_m == read.return_height_m


# --- the fleet


def beside(y_m: float) -> dict[str, Any]:
    return copter("bravo", (0, y_m), (300, y_m), start=at(0, y_m, amsl=140), goal=at(300, y_m, amsl=140))


def shifted(y_m: float) -> Line:
    return [(x, y + y_m, z) for x, y, z in STRAIGHT]


def test_two_side_by_side() -> None:
    near = 26 + ROUNDING_M
    assert reasons(scene(ALPHA, beside(near)), STRAIGHT, shifted(near)) == []
    reason = only_reason(scene(ALPHA, beside(26.5)), STRAIGHT, shifted(25.9))
    assert reason.startswith("alpha - bravo: 25.9 m apart at ")
    assert "expected 26 m" in reason


def test_two_that_cross_at_the_same_time_and_one_after_the_other() -> None:
    bravo = copter("bravo", (150, -150), (150, 150), start=at(150, -150, amsl=140), goal=at(150, 150, amsl=140))
    crossing: Line = [(150.0, -150.0, 140.0), (150.0, 150.0, 140.0)]
    both = scene(ALPHA, bravo)
    together = only_reason(both, STRAIGHT, crossing)
    assert together.startswith(("alpha - bravo: 0.0 m apart", "alpha - bravo: 0.1 m apart"))
    conflict = proof.worst_conflict(both, by_hand(both, STRAIGHT, crossing))
    assert conflict is not None
    assert (conflict.first, conflict.second, conflict.required_m) == (0, 1, 26.0)
    assert "alpha and bravo come within 0.0 m of each other" in str(conflict)
    # 5 m/s: on perpendicular ways through one point, a delay d keeps them 5 d / sqrt 2 apart
    assert reasons(both, STRAIGHT, crossing, delays_s=[0.0, 26.1 * np.sqrt(2) / 5]) == []
    assert reasons(both, STRAIGHT, crossing, delays_s=[0.0, 25.9 * np.sqrt(2) / 5]) != []
    assert proof.worst_conflict(both, by_hand(both, STRAIGHT, crossing, delays_s=[0.0, 26.1 * np.sqrt(2) / 5])) is None


def test_how_late_one_may_be_is_told_and_may_be_asked_for() -> None:
    bravo = copter("bravo", (150, -150), (150, 150), start=at(150, -150, amsl=140), goal=at(150, 150, amsl=140))
    crossing: Line = [(150.0, -150.0, 140.0), (150.0, 150.0, 140.0)]
    delay_s = 26 * math.sqrt(2) / 5 + 4.0  # as above: 4 s of it are to spare
    for asked_s, proven in ((0.0, True), (3.9, True), (4.1, False)):
        both = scene(ALPHA, bravo, fleet={"lateness_s": asked_s})
        certificate = certified(both, STRAIGHT, crossing, delays_s=[0.0, delay_s])
        late = found(certificate, "lateness", "alpha - bravo")
        assert late.value == pytest.approx(4.0, abs=0.05)
        assert (late.required, late.proven) == (asked_s, proven)
        assert certificate.proven is proven
    far = certified(scene(ALPHA, beside(100)), STRAIGHT, shifted(100))
    assert value(far, "lateness", "alpha - bravo") == proof.LATENESS_LIMIT_S  # no lateness makes them meet


def test_each_pair_needs_its_own_errors() -> None:
    careful = {**beside(30.5), "tracking_error_m": 6.1}
    assert "30.0 m apart" in only_reason(scene(ALPHA, careful), STRAIGHT, shifted(30.0))
    assert reasons(scene(ALPHA, {**careful, "tracking_error_m": 5.9}), STRAIGHT, shifted(30.0)) == []
    uncertain = {**beside(30.5), "position_error_m": 5.1}
    assert "30.0 m apart" in only_reason(scene(ALPHA, uncertain), STRAIGHT, shifted(30.0))
    # corners are cut as predicted: they do not count here
    assert reasons(scene(ALPHA, {**beside(30.5), "motion": {"waypoint_radius_m": 8}}), STRAIGHT, shifted(30.0)) == []


def test_the_pair_furthest_below_its_need_is_told_not_the_nearest() -> None:
    wide = {**copter("charlie", (0, -43), (300, -43), goal=at(300, -43, amsl=140)), "tracking_error_m": 16}
    fleet = scene(ALPHA, beside(26.5), {**wide, "start": at(0, -43, amsl=140)}, area=TO_ONE_SIDE)
    plan = by_hand(fleet, STRAIGHT, shifted(25), shifted(-30), delays_s=[0.0] * 3)
    assert plan.separation is not None
    assert plan.separation.what == "alpha - charlie"
    assert plan.separation.distance_m == pytest.approx(30.0, abs=0.1)
    assert (plan.separation.required_m, plan.separation.ok) == (20 + 3 + 17, False)


def test_a_vehicle_that_waits_for_its_start_is_kept_clear_of() -> None:
    # alpha descends to its goal 23 m beside the home of bravo, which has not started yet
    alpha = {**ALPHA, "goal": at(300, 0, amsl=140), "end": "land"}
    bravo = copter("bravo", (300, 23), (300, 200), start=at(300, 23, amsl=140), goal=at(300, 200, amsl=140))
    line: Line = [(300.0, 23.0, 140.0), (300.0, 200.0, 140.0)]
    assert "23.0 m apart" in only_reason(scene(alpha, bravo), STRAIGHT, line, delays_s=[0.0, 500.0])
    assert reasons(scene(alpha, bravo), STRAIGHT, line, delays_s=[100.0, 0.0]) == []


def test_the_common_arrival_is_kept() -> None:
    together = {"arrive_together": True}
    pair = scene(ALPHA, beside(60), fleet=together)
    lines = (STRAIGHT, shifted(60.0))
    arrival_s = by_hand(pair, *lines, arrival_s=0.0).vehicles[0].arrival_s
    assert reasons(pair, *lines, arrival_s=arrival_s) == []
    assert reasons(pair, *lines, arrival_s=arrival_s + 0.4) == []
    assert "arrives at" in only_reason(pair, *lines, arrival_s=arrival_s + 0.6)
    one_late = only_reason(pair, *lines, arrival_s=arrival_s, delays_s=[0.0, 1.0])
    assert one_late.startswith("bravo: arrives at")
    asked = scene(ALPHA, beside(60), fleet={**together, "arrival_time_s": 200})
    assert "fleet.arrival_time_s 200" in only_reason(asked, *lines, arrival_s=arrival_s)
    assert reasons(scene(ALPHA, beside(60)), *lines, delays_s=[0.0, 9.0]) == []


def test_every_reason_is_told() -> None:
    mast = {"kind": "cylinder", "name": "mast", "center": at(150, 10), "radius_m": 5}
    crowded = scene({**ALPHA, "endurance_s": 30}, beside(27), obstacles=[mast], terrain=hump(50))
    told = " ".join(reasons(crowded, STRAIGHT, shifted(22)))
    for part in ("alpha: item 3: terrain", "alpha: item 3: mast", "bravo: item 3: terrain", "bravo: item 3: mast"):
        assert part in told
    for part in ("of its battery", "alpha - bravo"):
        assert part in told


# --- the way home from everywhere


def test_returns_are_proven_or_waived_never_forgotten() -> None:
    around: Line = [(0.0, 0.0, 140.0), (0.0, 100.0, 140.0), (300.0, 100.0, 140.0), (300.0, 0.0, 140.0)]
    mast = {"kind": "cylinder", "name": "mast", "center": at(150, 0), "radius_m": 5}
    asked = scene(obstacles=[mast], fleet={"direct_return": "required"})
    problem = found(certified(asked, around), "return")
    assert (problem.holds, problem.to) == (False, "mast")
    waived = certified(scene(obstacles=[mast]), around)
    assert waived.proven
    finding = found(waived, "return")
    assert (finding.proven, finding.waived, finding.holds) == (False, True, True)
    # told to return while it lands, it climbs to its return height first: ArduCopter's own is lower than is safe
    free = scene(fleet={"direct_return": "required"})
    assert "m above the ground" in only_reason(returning_at(free, {"alpha": 22.9}), around)
    assert reasons(returning_at(free, {"alpha": 24.9}), around) == []
    low = scene(obstacles=[{**mast, "top_alt_amsl_m": 170}], fleet={"direct_return": "required"})
    assert found(certified(returning_at(low, {"alpha": 82.9}), around), "return").to == "mast"  # 13 m above its top
    assert reasons(returning_at(low, {"alpha": 84.9}), around) == []


def test_two_that_are_told_to_return_at_once_keep_apart() -> None:
    # their direct ways home cross, as their ways out do, 40 m above each other
    alpha = {**ALPHA, "goal": at(300, 100, amsl=140)}
    bravo = copter("bravo", (0, 60), (300, -40), start=at(0, 60, amsl=180), goal=at(300, -40, amsl=180))
    lines: list[Line] = [
        [(0.0, 0.0, 140.0), (300.0, 100.0, 140.0)],
        [(0.0, 60.0, 180.0), (300.0, -40.0, 180.0)],
    ]
    both = scene(alpha, bravo, fleet={"direct_return": "required"})
    level = found(certified(returning_at(both, {"alpha": 100.0, "bravo": 100.0}), *lines), "return", "alpha - bravo")
    assert (level.proven, level.required) == (False, 26.0)
    assert level.value is not None
    assert level.value < 5.0
    assert "told to return at" in level.detail
    staggered = certified(returning_at(both, {"alpha": 45.0, "bravo": 100.0}), *lines)
    assert problems(staggered) == []
    assert 26.0 <= value(staggered, "return", "alpha - bravo") <= 40.0
    assert staggered.return_height_m == {"alpha": 45.0, "bravo": 100.0}


# --- planes: held to their predicted flight, not to their legs


PLANE = {
    "name": "alpha",
    "class": "plane",
    "home": at(-300, 0),
    "start": at(100, 0, amsl=180),
    "goal": at(1200, 800, amsl=180),
}
WIDE = {"south_west": at(-800, -500), "north_east": at(1900, 1400)}
BENT: Line = [(0.0, 0.0, 160.0), (1200.0, 0.0, 180.0), (1200.0, 800.0, 180.0)]


def flown(scene: Scene, line: Line) -> FloatArray:
    return by_hand(scene, line, speed_m_s=18.0).vehicles[0].trajectory.position_m


def test_a_plane_keeps_its_tube_around_its_predicted_flight() -> None:
    free = scene(PLANE, area=WIDE)
    assert reasons(free, BENT, speed_m_s=18.0) == []
    flight = flown(free, BENT)
    # the corner itself is 20 m off its flight at least, which turns early
    off_m = np.hypot(flight[:, 0] - 1200, flight[:, 1]).min()
    assert off_m > 15.0
    post = {"kind": "cylinder", "name": "post", "center": at(1200, -30), "radius_m": 0.5}
    there = scene(PLANE, area=WIDE, obstacles=[post])
    certificate = certified(there, BENT, speed_m_s=18.0)
    exact_m = np.hypot(flight[:, 0] - 1200, flight[:, 1] + 30).min() - 0.5 - 13.0
    proven_m = value(certificate, "obstacle")
    assert exact_m - 0.1 <= proven_m <= exact_m + ROUNDING_M
    kinds = [(verdict.seq, verdict.kind) for verdict in certificate.legs]
    assert kinds == [(1, "takeoff"), (3, "straight"), (4, "straight"), (5, "loiter")]


def test_where_a_plane_turns_wide_counts_though_no_leg_goes_there() -> None:
    free = scene(PLANE, area=WIDE)
    flight = flown(free, BENT)
    legs = polyline_legs(np.array(BENT))
    aside = np.array([distance_to_legs_m(point, legs).min() for point in flight[::20]])
    widest = flight[::20][int(np.argmax(np.where(flight[::20, 0] > 600, aside, 0.0)))]
    assert aside.max() > 20.0
    post = {"kind": "cylinder", "name": "post", "center": at(float(widest[0]), float(widest[1])), "radius_m": 1}
    center = np.array([*widest[:2], 180.0])
    assert distance_to_legs_m(center, legs).min() > 15.0
    blocked = scene(PLANE, area=WIDE)
    blocked = scene_with(blocked, post)
    assert "post clearance is -14." in " ".join(reasons(blocked, BENT, speed_m_s=18.0))


def scene_with(known: Scene, obstacle: dict[str, Any]) -> Scene:
    """Return the scene with an obstacle that it may have refused beside a goal's circle."""
    elsewhere = {**PLANE, "goal": at(600, 1000, amsl=180)}
    other = scene(elsewhere, area=WIDE, obstacles=[obstacle])
    return replace(known, obstacles=other.obstacles, space=other.space)


def test_a_plane_that_turns_tighter_than_it_may_is_told() -> None:
    assert found(certified(scene(PLANE, area=WIDE), BENT, speed_m_s=18.0), "turn").proven
    there = scene(PLANE, area=WIDE)
    assert "flown with a radius of at least 2" in found(certified(there, BENT, speed_m_s=18.0), "turn").detail
    strict = scene({**PLANE, "turn_radius_m": 50}, area=WIDE)
    finding = found(certified(strict, BENT, speed_m_s=18.0), "turn")
    assert not finding.proven
    assert "expected at least 50 m" in finding.detail
    assert "lower ROLL_LIMIT_DEG" in finding.remedy
    gentle = {**PLANE, "turn_radius_m": 50, "parameters": {"ROLL_LIMIT_DEG": 30}}
    assert found(certified(scene(gentle, area=WIDE), BENT, speed_m_s=18.0), "turn").proven


@pytest.mark.parametrize(("apart_m", "clear"), [(180.0, False), (600.0, True)])
def test_planes_that_circle_for_ever_keep_apart_wherever_on_their_circles(apart_m: float, clear: bool) -> None:
    question = {"area": WIDE, "fleet": {"direct_return": "waived", "arrive_together": False}}
    vehicles = [{"class": "plane", "name": name, "home": at(-600, y), "goal": at(600, y, amsl=180)}
                for name, y in (("one", -400), ("two", 400))]  # fmt: skip
    there = scene(*vehicles, **question)
    plan = by_hand(there, *[task.route_m.tolist() for task in there.tasks], speed_m_s=18.0)
    sorties = [proof.planned_sortie(there, vehicle) for vehicle in plan.vehicles]
    last = sorties[1].legs[-1]
    moved = replace(last, end_m=sorties[0].legs[-1].end_m + np.array([0.0, apart_m, 0.0]))
    certificate = proof.prove(there, [sorties[0], replace(sorties[1], legs=(*sorties[1].legs[:-1], moved))])
    (told,) = [f for f in certificate.findings if "at their ends" in f.detail]
    assert told.proven is clear
    with pytest.raises(MissionError, match=r"circles of planes included"):
        scene(vehicles[0], {**vehicles[1], "goal": at(600, -220, amsl=180)}, **question)


# --- the certificate as data


def hopeless() -> Certificate:
    mast = {"kind": "cylinder", "name": "mast", "center": at(150, 10), "radius_m": 5}
    return certified(
        without_ground(scene({**ALPHA, "endurance_s": 30, "height_agl_max_m": 50}, beside(27), obstacles=[mast],
                             fleet={"direct_return": "required"}), slice(20, 22)),
        STRAIGHT,
        shifted(22),
    )  # fmt: skip


MADE: list[Callable[[], Certificate]] = [
    lambda: certified(scene()),
    lambda: certified(scene(obstacles=[cylinder(0.1)], area=TO_ONE_SIDE)),
    lambda: certified(scene(ALPHA, beside(60), fleet={"direct_return": "required"}), STRAIGHT, shifted(60)),
    lambda: certified(scene({**ALPHA, "height_agl_max_m": 90, "endurance_s": 900})),
    hopeless,
]


@pytest.mark.parametrize("made", MADE)
def test_a_certificate_is_strict_json_that_says_what_the_findings_say(made: Callable[[], Certificate]) -> None:
    certificate = made()
    document = json.loads(json.dumps(certificate.as_json(), allow_nan=False))
    assert document["proven"] is certificate.proven
    assert [f["check"] for f in document["findings"]] == [f.check for f in certificate.findings]
    for told, finding in zip(document["findings"], certificate.findings, strict=True):
        assert (told["proven"], told["waived"], told["detail"]) == (finding.proven, finding.waived, finding.detail)
        if finding.value is not None and math.isfinite(finding.value):
            assert told["value"] == pytest.approx(finding.value, abs=5.1e-4)
        else:
            assert told["value"] is None
    assert [leg["proven"] for leg in document["legs"]] == [verdict.proven for verdict in certificate.legs]


def test_what_is_proven_of_legs_is_what_is_proven_of_their_vehicle() -> None:
    certificate = hopeless()
    for name in ("alpha", "bravo"):
        legs = [verdict for verdict in certificate.legs if verdict.vehicle == name]
        assert min(v.terrain_m for v in legs if v.terrain_m is not None) == value(certificate, "terrain", name)
        assert min(v.obstacle_m for v in legs if v.obstacle_m is not None) == value(certificate, "obstacle", name)
        assert min(v.fence_m for v in legs) == value(certificate, "fence", name)
        assert not all(v.proven for v in legs)


# --- inspection


def test_the_share_of_the_line_that_is_inspected() -> None:
    towers = [{"name": f"t{k}", **at(50 + 100 * k, 0), "height_m": 10, "weight": 1 + k} for k in range(3)]
    line = {"towers": towers, "standoff_m": 25, "range_m": 40, "tower_radius_m": 2, "conductor_radius_m": 2}
    past: Line = [STRAIGHT[0], (200.0, 0.0, 140.0), (200.0, 60.0, 140.0), (300.0, 60.0, 140.0), STRAIGHT[1]]
    assert reasons(scene(inspection=line)) == []
    assert "passes 50% of the towers' weight within 40 m, expected 100%" in only_reason(scene(inspection=line), past)
    assert reasons(scene(inspection=line | {"share_min": 0.5}), past) == []
