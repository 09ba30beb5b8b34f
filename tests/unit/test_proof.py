"""Plans made by hand that just keep a limit are accepted, those that just break it are refused with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from missionplanner import kernels, proof
from missionplanner.clearance import Margins, polyline_legs
from missionplanner.geodesy import FloatArray
from missionplanner.path_search import PlannedPath
from missionplanner.plan import FleetFlight, FleetPlan, FlownVehicle, Trajectory
from missionplanner.planner import Schedule, assemble
from missionplanner.scene import Scene
from tests.scenes import at, copter, question, scene_of

# Level ground at 100 m; a vehicle keeps 20 + 2 m above it, 10 + 2 m from obstacles and fence, 20 + 2 + 2 m from others.
STRAIGHT = [(0.0, 0.0, 140.0), (300.0, 0.0, 140.0)]
ALPHA = copter("alpha", (0, 0), (300, 0), start=at(0, 0, amsl=140), goal=at(300, 0, amsl=140))
TO_ONE_SIDE = {"south_west": at(-100, -150), "north_east": at(400, 150)}

Line = Sequence[tuple[float, float, float]]


def scene(*vehicles: dict[str, Any], **changes: Any) -> Scene:
    return scene_of(question(*(vehicles or (ALPHA,)), **({"fleet": {"arrive_together": False}} | changes)))


def by_hand(
    scene: Scene,
    *lines: Line,
    speed_m_s: float = 5.0,
    delays_s: Sequence[float] = (0.0, 0.0),
    arrival_s: float | None = None,
) -> FleetPlan:
    """Return the checked plan of vehicles that fly these waypoints."""
    paths = [PlannedPath(np.array(line), np.array(line), 0.0, 0.0, {}, np.zeros(1), 0) for line in lines or (STRAIGHT,)]
    schedules = [Schedule(delay_s, speed_m_s, (0.0, 1e3)) for delay_s in delays_s[: len(paths)]]
    return proof.checked(scene, assemble(scene, paths, schedules, arrival_s, seed=1))


def reasons(scene: Scene, *lines: Line, **changes: Any) -> list[str]:
    return proof.unsafe(scene, by_hand(scene, *lines, **changes))


def only_reason(scene: Scene, *lines: Line, **changes: Any) -> str:
    (reason,) = reasons(scene, *lines, **changes)
    assert "\n" not in reason
    return reason


def at_least(plan: FleetPlan, what: str) -> float:
    (clearance,) = [c for c in plan.vehicles[0].clearances if c.what == what]
    return clearance.distance_m


# --- obstacles: the just-clear place and, `nearer` metres further towards the path, the grazing one


def cylinder(nearer: float) -> dict[str, Any]:
    return {"kind": "cylinder", "name": "thing", "center": at(150, 17.01 - nearer), "radius_m": 5}


def low_cylinder(nearer: float) -> dict[str, Any]:
    return {**cylinder(0.0), "center": at(150, 0), "top_alt_amsl_m": 127.99 + nearer}


def cone(nearer: float) -> dict[str, Any]:
    # its mantle, 2 up for 1 in, stands 50 m wide on the ground; 40 m up, this far away is 12 m off at a right angle
    across = 50 - 40 / 2 + 12 * np.hypot(1, 0.5)
    return {
        "kind": "cone",
        "name": "thing",
        "center": at(150, across + 0.02 - nearer),
        "base_radius_m": 50,
        "height_m": 100,
    }


def radar(nearer: float) -> dict[str, Any]:
    return {"kind": "radar", "name": "thing", "center": at(150, 52.01 - nearer, amsl=140), "radius_m": 40}


def marine(nearer: float) -> dict[str, Any]:
    return {"kind": "marine", "name": "thing", "center": at(150, 0, amsl=140 - 52.01 + nearer), "radius_m": 40}


def no_fly(nearer: float) -> dict[str, Any]:
    y = 12.01 - nearer
    polygon = [at(150, y), at(190, y + 60), at(110, y + 60)]  # a corner points at the path
    return {"kind": "no_fly", "name": "thing", "polygon": polygon}


def airspace(nearer: float) -> dict[str, Any]:
    polygon = [at(100, -50), at(200, -50), at(200, 50), at(100, 50)]
    return {"kind": "no_fly", "name": "thing", "polygon": polygon, "floor_alt_amsl_m": 152.01 - nearer}


def cable(nearer: float) -> dict[str, Any]:
    z = 140 - 12.51 + nearer
    return {"kind": "cable", "name": "thing", "start": at(150, -80, amsl=z), "end": at(150, 80, amsl=z)}


@pytest.mark.parametrize("thing", [cylinder, low_cylinder, cone, radar, marine, no_fly, airspace, cable])
def test_an_obstacle_may_be_passed_but_not_grazed(thing: Any) -> None:
    clear, grazed = (scene(obstacles=[thing(nearer)], area=TO_ONE_SIDE) for nearer in (0.0, 0.1))
    assert reasons(clear) == []
    assert 12.0 <= at_least(by_hand(clear), "thing") <= 12.05
    reason = only_reason(grazed)
    assert reason.startswith("alpha: thing clearance is 11.9")
    assert reason.endswith("expected 12 m")


@pytest.mark.parametrize("name", ["ridge", "terrain", "fence", "ceiling"])
def test_the_climb_from_home_is_held_against_obstacles_whatever_they_are_called(name: str) -> None:
    home = scene()
    pole = {"kind": "cable", "name": name, "start": at(0, -30, amsl=110), "end": at(0, -11, amsl=110), "radius_m": 0.5}
    further = scene({**ALPHA, "home": at(0, 3), "start": at(0, 3, amsl=140)}, obstacles=[pole])
    line: Line = [(0.0, 3.0, 140.0), (300.0, 0.0, 140.0)]
    assert reasons(further, line) == []
    plan = by_hand(further, line)
    tight = replace(plan, vehicles=(replace(plan.vehicles[0], home_m=home.tasks[0].home_m),))
    (reason,) = proof.unsafe(further, proof.checked(further, tight))
    assert reason.startswith(f"alpha: {name} clearance is 11.")
    assert reason.endswith("109 m AMSL, expected 12 m")


def test_a_zone_that_is_only_priced_may_be_flown_through() -> None:
    zone = {"kind": "radar", "name": "zone", "center": at(150, 0, amsl=140), "radius_m": 40, "hard": False}
    assert reasons(scene(obstacles=[zone])) == []


def test_a_thin_cable_right_between_two_samples_is_found() -> None:
    thin = {**cable(0.0), "radius_m": 0.01, "start": at(123.4567, -80, amsl=140), "end": at(123.4567, 80, amsl=140)}
    assert "thing clearance is -0.01 m" in only_reason(scene(obstacles=[thin]))


def test_corners_are_cut_and_the_curve_flown_is_what_counts() -> None:
    corner: Line = [(0.0, 0.0, 140.0), (150.0, 0.0, 140.0), (150.0, 150.0, 140.0)]
    goal = at(150, 150, amsl=140)
    vehicle = {**ALPHA, "goal": goal, "motion": {"waypoint_radius_m": 20}}
    # on the inner side, the legs keep 12 m and the flown curve does not
    inside = {"kind": "cylinder", "name": "mast", "center": at(150 - 17.1, 17.1), "radius_m": 5}
    plan = by_hand(scene(vehicle, obstacles=[inside]), corner, speed_m_s=10.0)
    legs = polyline_legs(np.array(corner))
    found = proof.least_clearances(
        scene(vehicle, obstacles=[inside]).space, ("mast",), Margins(0, 1e9, 1e9, 12, 0), legs
    )
    assert min(c.distance_m for c in found if c.what == "mast") >= 12.0
    assert at_least(plan, "mast") < 12.0
    assert "mast" in only_reason(scene(vehicle, obstacles=[inside]), corner, speed_m_s=10.0)


def test_the_way_home_counts_too() -> None:
    around: Line = [(0.0, 0.0, 140.0), (0.0, 100.0, 140.0), (300.0, 100.0, 140.0), (300.0, 0.0, 140.0)]
    mast = {"kind": "cylinder", "name": "mast", "center": at(150, 0), "radius_m": 5}
    lands = scene(obstacles=[mast])
    assert reasons(lands, around) == []
    returns = replace(lands, tasks=(replace(lands.tasks[0], end="rtl"),))  # which a scene would have refused
    assert "mast clearance is -4." in only_reason(returns, around)


# --- terrain


def hump(height_m: float, spread_m: float = 30.0) -> dict[str, Any]:
    peaks = [{**at(150, 0), "height_m": height_m, "spread_m": spread_m}]
    return {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": peaks}


def test_a_hill_between_two_good_waypoints() -> None:
    assert reasons(scene(terrain=hump(17.9))) == []
    low = only_reason(scene(terrain=hump(18.1)))
    assert low.startswith("alpha: terrain clearance is 21.90 m at ")
    assert low.endswith("expected 22 m")
    inside = only_reason(scene(terrain=hump(90)))
    assert inside.startswith("alpha: terrain clearance is -50.00 m at ")
    over: Line = [STRAIGHT[0], (75.0, 0.0, 215.0), (225.0, 0.0, 215.0), STRAIGHT[1]]
    assert reasons(scene(terrain=hump(90)), over) == []


def test_a_steep_rock_under_a_long_leg_is_not_stepped_over() -> None:
    rock = {**hump(60, spread_m=6), "cell_m": 2}
    rock["peaks"][0] |= at(123.4, 0)
    space = scene(terrain=rock, area={"south_west": at(-50, -50), "north_east": at(350, 50)}).space
    leg = np.array([[[0.0, 0.0, 200.0], [300.0, 0.0, 200.0]]])
    found = proof.least_clearances(space, (), Margins(22, np.inf, np.inf, 0, 0), leg)
    (terrain,) = [c for c in found if c.what == "terrain"]
    x = np.linspace(115, 132, 100_001)
    ground = kernels.terrain_heights(space.terrain, np.stack([x, np.zeros_like(x)], axis=-1))
    assert ground.max() > 150
    assert terrain.distance_m == pytest.approx(200 - ground.max(), abs=0.02)
    assert terrain.position_m[0] == pytest.approx(x[ground.argmax()], abs=0.1)


def test_where_it_is_too_low_is_told_in_degrees() -> None:
    hilly = scene(terrain=hump(90))
    (clearance, *_) = by_hand(hilly).vehicles[0].clearances
    assert clearance.position_m == pytest.approx((150, 0, 140), abs=0.2)
    point = hilly.frame.geo_point(clearance.position_m)
    assert f"{point.lat_deg:.6f}, {point.lon_deg:.6f}, 140 m AMSL" in only_reason(hilly)


def test_missing_terrain_is_no_clearance() -> None:
    known = scene()
    heights = known.space.terrain.height_amsl_m.copy()
    heights[:, heights.shape[1] // 2] = np.nan
    unknown = replace(known, space=known.space._replace(terrain=known.space.terrain._replace(height_amsl_m=heights)))
    assert "alpha: terrain clearance is -inf m" in reasons(unknown)[0]


def test_a_waypoint_under_the_ground_is_no_clearance_either() -> None:
    below: Line = [STRAIGHT[0], (150.0, 0.0, 90.0), STRAIGHT[1]]
    assert any("terrain clearance is -10.0" in reason for reason in reasons(scene(), below))


# --- ceilings, fence, area


@pytest.mark.parametrize("ceiling", [{"height_agl_max_m": 60}, {"alt_amsl_max_m": 160}])
def test_a_ceiling(ceiling: dict[str, float]) -> None:
    # of a wide arch only its top comes near the ceiling, which is 2 m of tracking error lower
    low, high = ([STRAIGHT[0], (150.0, 0.0, top), STRAIGHT[1]] for top in (157.99, 158.1))
    assert reasons(scene({**ALPHA, **ceiling}), low) == []
    reason = only_reason(scene({**ALPHA, **ceiling}), high)
    assert reason.startswith("alpha: ceiling clearance is -0.10 m at ")
    assert reason.endswith("158 m AMSL, expected 0 m")


def test_the_ceiling_above_ground_follows_the_ground_down() -> None:
    # between two plateaus the ground is 100 m, on them it is 140 m
    plateaus = [{**at(x, 0), "height_m": 40, "spread_m": 60} for x in (0, 300)]
    ground = {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": plateaus}
    level = [(0.0, 0.0, 180.0), (300.0, 0.0, 180.0)]
    vehicle = {**ALPHA, "start": at(0, 0, amsl=180), "goal": at(300, 0, amsl=180)}
    assert "ceiling" in only_reason(scene({**vehicle, "height_agl_max_m": 70}, terrain=ground), level)
    assert reasons(scene({**vehicle, "height_agl_max_m": 90}, terrain=ground), level) == []


def notched(depth_y: float) -> dict[str, Any]:
    corners = [(-50, -100), (140, -100), (150, depth_y), (160, -100), (350, -100), (350, 100), (-50, 100)]
    return {"polygon": [at(x, y) for x, y in corners]}


def test_a_fence() -> None:
    # distances to a fence are lower bounds, at most 0.03 m and 1 % too small
    assert reasons(scene(fence=notched(-12.2))) == []
    reason = only_reason(scene(fence=notched(-11.9)))
    assert reason.startswith("alpha: fence clearance is 11.8")


def test_the_top_of_the_fence() -> None:
    arch: Line = [STRAIGHT[0], (150.0, 0.0, 160.0), STRAIGHT[1]]
    fence = notched(-50.0)
    assert reasons(scene(fence={**fence, "top_alt_amsl_m": 172.2}), arch) == []
    assert "fence clearance is 11.8" in only_reason(scene(fence={**fence, "top_alt_amsl_m": 171.9}), arch)


def test_the_edge_of_the_area() -> None:
    out: Line = [STRAIGHT[0], (150.0, 140.0, 140.0), STRAIGHT[1]]
    assert "fence clearance is 10.0" in only_reason(scene(area=TO_ONE_SIDE), out)
    assert reasons(scene(area=TO_ONE_SIDE), [STRAIGHT[0], (150.0, 137.9, 140.0), STRAIGHT[1]]) == []


# --- what the vehicle can do


def test_a_leg_too_steep() -> None:
    vehicle = {**ALPHA, "climb": {"angle_max_deg": 20}, "descent": {"angle_max_deg": 30}}
    ok: Line = [STRAIGHT[0], (150.0, 0.0, 140.0 + 150 * np.tan(np.radians(19.9))), STRAIGHT[1]]
    up: Line = [STRAIGHT[0], (150.0, 0.0, 140.0 + 150 * np.tan(np.radians(20.1))), STRAIGHT[1]]
    down: Line = [STRAIGHT[0], (220.0, 0.0, 140.0 + 80 * np.tan(np.radians(30.1))), STRAIGHT[1]]
    assert reasons(scene(vehicle), ok) == []
    assert "the leg from waypoint 0 to 1 is steeper than it may climb (20 degrees)" in only_reason(scene(vehicle), up)
    assert "the leg from waypoint 1 to 2" in only_reason(scene(vehicle), down)
    assert reasons(scene({**vehicle, "descent": {"angle_max_deg": 31}}), down) == []


def test_endurance_is_time_in_the_air() -> None:
    flight = by_hand(scene(), delays_s=[100.0]).vehicles[0].trajectory
    airborne_s = float(flight.t_s[-1]) - 100.0
    assert 60 < airborne_s < 160
    enough, short = (scene({**ALPHA, "endurance_s": airborne_s + more}) for more in (0.01, -0.01))
    assert reasons(enough, delays_s=[100.0]) == []
    assert "alpha: flies" in only_reason(short, delays_s=[100.0])
    assert "endurance" in only_reason(short, delays_s=[100.0])


# --- the fleet


def beside(y_m: float) -> dict[str, Any]:
    return copter("bravo", (0, y_m), (300, y_m), start=at(0, y_m, amsl=140), goal=at(300, y_m, amsl=140))


def shifted(y_m: float) -> Line:
    return [(x, y + y_m, z) for x, y, z in STRAIGHT]


def test_two_side_by_side() -> None:
    assert reasons(scene(ALPHA, beside(24.01)), STRAIGHT, shifted(24.01)) == []
    reason = only_reason(scene(ALPHA, beside(24.5)), STRAIGHT, shifted(23.9))
    assert reason.startswith("alpha - bravo: 23.9 m apart at ")
    assert reason.endswith("expected 24 m")


def test_two_that_cross_at_the_same_time_and_one_after_the_other() -> None:
    bravo = copter("bravo", (150, -150), (150, 150), start=at(150, -150, amsl=140), goal=at(150, 150, amsl=140))
    crossing: Line = [(150.0, -150.0, 140.0), (150.0, 150.0, 140.0)]
    both = scene(ALPHA, bravo)
    together = only_reason(both, STRAIGHT, crossing)
    assert together.startswith("alpha - bravo: 0.0 m apart")
    conflict = proof.worst_conflict(both, by_hand(both, STRAIGHT, crossing))
    assert conflict is not None
    assert (conflict.first, conflict.second, conflict.required_m) == (0, 1, 24.0)
    assert "alpha and bravo come within 0.0 m of each other" in str(conflict)
    # 5 m/s: on perpendicular ways through one point, a delay d keeps them 5 d / sqrt 2 apart
    assert reasons(both, STRAIGHT, crossing, delays_s=[0.0, 24.1 * np.sqrt(2) / 5]) == []
    assert reasons(both, STRAIGHT, crossing, delays_s=[0.0, 23.9 * np.sqrt(2) / 5]) != []
    assert proof.worst_conflict(both, by_hand(both, STRAIGHT, crossing, delays_s=[0.0, 24.1 * np.sqrt(2) / 5])) is None


def test_each_pair_needs_its_own_tracking_errors() -> None:
    careful = {**beside(30.5), "tracking_error_m": 8.1}
    assert "30.0 m apart" in only_reason(scene(ALPHA, careful), STRAIGHT, shifted(30.0))
    assert reasons(scene(ALPHA, {**careful, "tracking_error_m": 7.9}), STRAIGHT, shifted(30.0)) == []


def test_the_pair_furthest_below_its_need_is_told_not_the_nearest() -> None:
    wide = {**copter("charlie", (0, -43), (300, -43), goal=at(300, -43, amsl=140)), "tracking_error_m": 20}
    fleet = scene(ALPHA, beside(25), {**wide, "start": at(0, -43, amsl=140)}, area=TO_ONE_SIDE)
    plan = by_hand(fleet, STRAIGHT, shifted(25), shifted(-30), delays_s=[0.0] * 3)
    assert plan.separation is not None
    assert plan.separation.what == "alpha - charlie"
    assert plan.separation.distance_m == pytest.approx(30.0, abs=0.1)


def test_a_vehicle_that_waits_for_its_start_is_kept_clear_of() -> None:
    # alpha descends to its goal 10 m beside the home of bravo, which has not started yet
    alpha = {**ALPHA, "goal": at(300, 0, amsl=140), "end": "land"}
    bravo = copter("bravo", (300, 21), (300, 200), start=at(300, 21, amsl=140), goal=at(300, 200, amsl=140))
    line: Line = [(300.0, 21.0, 140.0), (300.0, 200.0, 140.0)]
    assert "21.0 m apart" in only_reason(scene(alpha, bravo), STRAIGHT, line, delays_s=[0.0, 500.0])
    assert reasons(scene(alpha, bravo), STRAIGHT, line, delays_s=[100.0, 0.0]) == []


def test_the_common_arrival_is_kept() -> None:
    pair = scene(ALPHA, beside(60), fleet={})
    lines = (STRAIGHT, shifted(60.0))
    arrival_s = by_hand(pair, *lines).vehicles[0].arrival_s
    assert reasons(pair, *lines, arrival_s=arrival_s) == []
    assert reasons(pair, *lines, arrival_s=arrival_s + 0.4) == []
    late = reasons(pair, *lines, arrival_s=arrival_s + 0.6)
    assert [reason.partition(":")[0] for reason in late] == ["alpha", "bravo"]
    (one_late,) = reasons(pair, *lines, arrival_s=arrival_s, delays_s=[0.0, 1.0])
    assert one_late.startswith("bravo: arrives at")
    assert "no common arrival" in only_reason(pair, *lines)
    asked = scene(ALPHA, beside(60), fleet={"arrival_time_s": 200})
    assert "fleet.arrival_time_s 200" in only_reason(asked, *lines, arrival_s=arrival_s)
    assert reasons(scene(ALPHA, beside(60)), *lines, delays_s=[0.0, 9.0]) == []


def test_every_reason_is_told() -> None:
    mast = {"kind": "cylinder", "name": "mast", "center": at(150, 10), "radius_m": 5}
    crowded = scene({**ALPHA, "endurance_s": 30}, beside(25), obstacles=[mast], terrain=hump(50))
    told = " ".join(reasons(crowded, STRAIGHT, shifted(22)))
    for part in ("alpha: terrain", "alpha: mast", "bravo: terrain", "bravo: mast", "endurance", "alpha - bravo"):
        assert part in told


# --- inspection


def test_the_share_of_the_line_that_is_inspected() -> None:
    towers = [{"name": f"t{k}", **at(50 + 100 * k, 0), "height_m": 10, "weight": 1 + k} for k in range(3)]
    line = {"towers": towers, "standoff_m": 25, "range_m": 40, "tower_radius_m": 2, "conductor_radius_m": 2}
    past: Line = [STRAIGHT[0], (200.0, 0.0, 140.0), (200.0, 60.0, 140.0), (300.0, 60.0, 140.0), STRAIGHT[1]]
    assert reasons(scene(inspection=line)) == []
    assert "passes 50% of the towers' weight within 40 m, expected 100%" in only_reason(scene(inspection=line), past)
    assert reasons(scene(inspection=line | {"share_min": 0.5}), past) == []


# --- flights


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


def test_a_flight_may_use_up_the_tracking_error_but_not_the_margin() -> None:
    passed = scene(obstacles=[cylinder(0.0)])
    plan = by_hand(passed)
    for sideways, ok in [(0.0, True), (1.9, True), (2.1, False)]:
        check = proof.check_flight(passed, plan, flown(plan, moved(0, sideways, 0)))
        assert check.ok is ok, sideways
    (clearances,) = proof.check_flight(passed, plan, flown(plan, moved(0, 2.1, 0))).clearances
    (least,) = [c for c in clearances if c.what == "thing"]
    assert (least.required_m, least.ok) == (10.0, False)
    assert least.distance_m == pytest.approx(9.9, abs=0.05)


def test_a_flight_too_low_is_told() -> None:
    level = scene()
    plan = by_hand(level)
    assert proof.check_flight(level, plan, flown(plan, moved(0, 0, -19.9))).ok
    assert not proof.check_flight(level, plan, flown(plan, moved(0, 0, -20.1))).ok


def test_a_flight_that_never_got_to_its_height_is_too_low_all_the_way() -> None:
    level = scene()
    plan = by_hand(level)
    (v,) = plan.vehicles
    sunk = v.trajectory.position_m - np.maximum(0.0, v.trajectory.position_m[:, 2:] - 101.0) * [0, 0, 0.9]
    assert sunk[:, 2].max() < 106
    low = FleetFlight((FlownVehicle(v.name, v.sysid, replace(v.trajectory, position_m=sunk), v.arrival_s, 0.0),))
    check = proof.check_flight(level, plan, low)
    assert not check.ok
    assert min(c.distance_m for c in check.clearances[0]) < 6.0


def test_a_vehicle_that_stays_on_its_pad_keeps_clear() -> None:
    level = scene()
    plan = by_hand(level)
    (v,) = plan.vehicles
    waiting = Trajectory(np.array([0.0, 50.0]), np.array([v.home_m, v.home_m + np.array([1.5, 1.0, 0.5])]))
    check = proof.check_flight(level, plan, FleetFlight((FlownVehicle(v.name, v.sysid, waiting, None, None),)))
    assert (check.clearances, check.ok) == (((),), True)


def test_two_that_flew_too_close_are_told() -> None:
    pair = scene(ALPHA, beside(30))
    plan = by_hand(pair, STRAIGHT, shifted(30.0))
    near = flown(plan)
    for sideways, ok in [(9.9, True), (10.1, False)]:
        alpha, bravo = near.vehicles
        bumped = replace(
            alpha, trajectory=replace(alpha.trajectory, position_m=moved(0, sideways, 0)(alpha.trajectory.position_m))
        )
        check = proof.check_flight(pair, plan, FleetFlight((bumped, bravo)))
        assert check.ok is ok
        assert check.separation is not None
        assert check.separation.required_m == 20.0


def test_a_copter_may_sink_as_soon_as_it_is_within_the_goals_radius() -> None:
    # as PX4 does: it drifts to the middle of its landing place on the way down
    there = scene()
    vehicle = by_hand(there).vehicles[0]
    line = [*STRAIGHT[:1], (298.2, 0.0, 140.0), (298.2, 0.0, 115.0), (300.0, 0.0, 100.0)]
    flight = Trajectory(np.array([20.0, 80.0, 95.0, 110.0]), np.array(line))
    drifting = replace(vehicle, trajectory=flight, reached_s=np.array([20.0, 80.0]), arrival_s=80.0)
    assert all(c.ok for c in proof.clearances(there, there.tasks[0], drifting))


def test_what_stands_beside_a_drifting_descent_counts() -> None:
    post = {"kind": "cylinder", "name": "post", "center": at(312.5, 0), "radius_m": 0.4}
    vehicle = by_hand(scene()).vehicles[0]
    line = [*STRAIGHT[:1], (300.0, 0.0, 140.0), (301.8, 0.0, 115.0), (300.0, 0.0, 100.0)]
    flight = Trajectory(np.array([20.0, 80.0, 95.0, 110.0]), np.array(line))
    drifting = replace(vehicle, trajectory=flight, reached_s=np.array([20.0, 80.0]), arrival_s=80.0)
    there = scene(obstacles=[post])
    (bad,) = [c for c in proof.clearances(there, there.tasks[0], drifting) if not c.ok]
    assert (bad.what, round(bad.distance_m, 2)) == ("post", 10.3)
