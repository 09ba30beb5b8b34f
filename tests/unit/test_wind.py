"""Steady wind: what is measured of autopilots in it, its laws; nobody plans what cannot be flown against it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner import proof, wind
from missionplanner.energy import EnergyModel, energy_model, findings, return_share, used_share
from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.mission import VehicleSettings, Wind, parse_mission
from missionplanner.motion import Navigator, Route, predict, return_points
from missionplanner.path_search import PlannedPath
from missionplanner.plan import FleetPlan, Trajectory
from missionplanner.plan_folder import load_plan, save_plan
from missionplanner.planner import assemble, plan_fleet
from missionplanner.returns import stopping_m
from missionplanner.scene import Scene
from missionplanner.schedule import Schedule
from missionplanner.sortie import Leg, Sortie
from missionplanner.timing import predict_flight
from missionplanner.vehicle import MotionModel, motion_model
from tests.limits import limits
from tests.scenes import at, copter, question, scene_of

HOME = np.array([0.0, 0.0, 100.0])
COPTERS = [motion_model(VehicleSettings(autopilot=autopilot)) for autopilot in ("ardupilot", "px4")]
PLANE = motion_model(VehicleSettings.model_validate({"class": "plane"}))
ALPHA = copter("alpha", (0, 0), (300, 0), start=at(0, 0, amsl=140), goal=at(300, 0, amsl=140))

courses = st.floats(0.0, 2.0 * math.pi)
airs = st.tuples(st.floats(0.0, 6.0), courses).map(lambda p: (p[0] * math.cos(p[1]), p[0] * math.sin(p[1])))


def blown(model: MotionModel, east: float, north: float) -> MotionModel:
    return replace(model, wind_m_s=(east, north))


def battery(air_m_s: tuple[float, float] = (0.0, 0.0), /, **fields: Any) -> EnergyModel:
    found = energy_model(VehicleSettings.model_validate({"endurance_s": 1200.0} | fields), air_m_s)
    assert found is not None
    return found


def turned(points: Any, angle: float) -> Any:
    c, s = math.cos(angle), math.sin(angle)
    x, y = np.asarray(points)[..., 0], np.asarray(points)[..., 1]
    return np.concatenate([np.stack([c * x - s * y, s * x + c * y], axis=-1), np.asarray(points)[..., 2:]], axis=-1)


# --- the mission file


@pytest.mark.parametrize(("from_deg", "velocity"), [(0, (0, -5)), (90, (-5, 0)), (180, (0, 5)), (270, (5, 0))])
def test_wind_is_named_after_where_it_blows_from(from_deg: float, velocity: tuple[float, float]) -> None:
    assert Wind(speed_m_s=5.0, from_deg=from_deg).velocity_m_s == pytest.approx(velocity, abs=1e-9)
    assert wind.told(blown(COPTERS[0], *velocity)) == f"5 m/s of wind from {from_deg} degrees"


TEXT = """
name: windy
origin: {lat_deg: 34.4, lon_deg: -118.2}
terrain: {kind: flat, alt_amsl_m: 0}
wind: {speed_m_s: 5, from_deg: 270}
wind_max_m_s: 6
vehicles: [{name: alpha, start: {x_m: 0, y_m: 0, alt_amsl_m: 40}, goal: {x_m: 300, y_m: 0, alt_amsl_m: 40}}]
"""


def test_the_strongest_wind_is_the_known_one_where_no_other_is_stated() -> None:
    assert parse_mission(TEXT, "m").wind_strongest_m_s == 6.0
    assert parse_mission(TEXT.replace("wind_max_m_s: 6", ""), "m").wind_strongest_m_s == 5.0
    assert parse_mission(TEXT.replace("wind: {", "#"), "m").air_m_s == (0.0, 0.0)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("wind_max_m_s: 6", "wind_max_m_s: 4", "m:6: wind_max_m_s: expected at least wind.speed_m_s (5 m/s), got 4"),
        ("from_deg: 270", "from_deg: 400", "m:5: wind.from_deg: expected a number of at most 360, got 400"),
        (", from_deg: 270", "", "m:5: wind.from_deg: expected this field, got none"),
        ("speed_m_s: 5, f", "speed_m_s: -5, f", "m:5: wind.speed_m_s: expected a number of at least 0, got -5"),
        ("from_deg", "to_deg", "m:5: wind.to_deg: expected a known field, got 'to_deg'"),
    ],
)
def test_wrong_winds_are_refused_with_their_place(old: str, new: str, told: str) -> None:
    with pytest.raises(MissionError) as error:
        parse_mission(TEXT.replace(old, new), "m")
    assert told in str(error.value)


def test_every_vehicle_of_the_scene_knows_the_wind() -> None:
    data = question(wind={"speed_m_s": 4, "from_deg": 270})
    for task in scene_of(data).tasks:
        assert task.motion.wind_m_s == pytest.approx((4.0, 0.0))
        assert task.limits.wind_max_m_s == 4.0


# --- what can be flown


def test_a_copter_flies_as_fast_as_measured_at_its_lean_limit() -> None:
    """ArduCopter in SITL: 10.35 m/s in calm air; 5.7 m/s over the ground against air that moved at 4.62 m/s."""
    assert wind.airspeed_limit_m_s(COPTERS[0]) == pytest.approx(10.35, abs=0.05)
    against = blown(COPTERS[0], -4.62, 0.0)
    made = wind.along_m_s(against, wind.airspeed_limit_m_s(against), np.array([1.0, 0.0]))
    assert float(made) == pytest.approx(5.7, abs=0.05)
    flight, _ = predict(against, [0, 0, 50], [[1500, 0, 50]], 15.0)
    steady = (flight.t_s > 60.0) & (flight.position_m[:, 0] < 1300.0)
    flown = np.polyfit(flight.t_s[steady], flight.position_m[steady, 0], 1)[0]
    assert flown == pytest.approx(5.7, abs=0.1)


@given(air=airs, course=courses, airspeed=st.floats(7.0, 30.0))
def test_what_is_made_along_a_leg_is_the_airspeed_through_the_air(
    air: tuple[float, float], course: float, airspeed: float
) -> None:
    way = np.array([math.cos(course), math.sin(course)])
    made = float(wind.along_m_s(blown(PLANE, *air), airspeed, way))
    assert math.dist(made * way, air) == pytest.approx(airspeed)
    assert made >= airspeed - math.hypot(*air) - 1e-9
    assert float(wind.along_m_s(blown(PLANE, *air), airspeed, -way)) + made <= 2.0 * airspeed + 1e-9


def test_a_wind_from_the_side_as_fast_as_the_airspeed_carries_off() -> None:
    side = np.array([1.0, 0.0])
    assert float(wind.along_m_s(blown(PLANE, 0.0, 14.0), 14.0, side)) == pytest.approx(0.0)
    assert float(wind.along_m_s(blown(PLANE, 0.0, 14.1), 14.0, side)) == -math.inf


EAST, NORTH = np.array([300.0, 0.0, 5.0]), np.array([0.0, 300.0, 0.0])


@pytest.mark.parametrize(
    ("model", "stated", "way", "speed", "told"),
    [
        (blown(COPTERS[0], -5, 0), math.inf, EAST, 5.0, None),
        (blown(COPTERS[0], -5, 0), math.inf, EAST, 9.0, None),  # slower than commanded, and predicted so
        (blown(COPTERS[0], -8, 0), math.inf, EAST, 9.0, "makes 2.4 m/s over the ground in 8 m/s of wind from 90"),
        (blown(COPTERS[0], -8, 0), math.inf, -EAST, 9.0, None),
        (blown(COPTERS[0], -12, 0), math.inf, NORTH, 5.0, "is carried off in 12 m/s of wind"),
        (blown(COPTERS[0], -5, 0), 9.0, EAST, 5.0, "needs an airspeed of 10.0 m/s to fly 5 m/s"),
        (blown(COPTERS[0], -5, 0), 9.0, EAST, 4.0, None),
        (blown(COPTERS[0], -10.8, 0), math.inf, np.array([0, 0, 9.0]), 3.0, "cannot be flown"),
        (blown(PLANE, -12, 0), math.inf, EAST, 14.0, "at an airspeed of 14 m/s it makes 2.0 m/s over the ground"),
        (blown(PLANE, -12, 0), math.inf, EAST, 15.0, None),
        (blown(PLANE, 0, -14.5), math.inf, EAST, 14.0, "is carried off it in 14.5 m/s of wind from 0 degrees"),
    ],
)
def test_a_leg_that_cannot_be_flown_is_told(
    model: MotionModel, stated: float, way: np.ndarray, speed: float, told: str | None
) -> None:
    problem = wind.leg_problem(limits(airspeed_max_m_s=stated), model, way, speed)
    assert (problem is None) == (told is None)
    if told is not None:
        assert problem is not None
        assert told in problem


def test_wind_stronger_than_the_airspeed_is_one_clear_line_before_anything_is_planned() -> None:
    scene = scene_of(question(wind={"speed_m_s": 12, "from_deg": 200}))
    with pytest.raises(InfeasibleError) as error:
        plan_fleet(scene)
    assert str(error.value) == (
        "alpha: wind of 12 m/s against an airspeed of 10.4 m/s (at its lean limit), expected at least 1 m/s more "
        "airspeed than wind: fly in less wind, or with a faster vehicle"
    )
    with pytest.raises(InfeasibleError, match=r"alpha: wind of 20 m/s against an airspeed of 22\.0 m/s"):
        vehicle = {**ALPHA, "class": "plane"}
        wind.refuse_storm(scene_of(question(vehicle, wind={"speed_m_s": 20, "from_deg": 0})).tasks)
    stated = scene_of(question(ALPHA, wind_max_m_s=12, defaults={"airspeed_max_m_s": 16}))
    wind.refuse_storm(stated.tasks)


def test_a_leg_against_the_wind_is_told_while_planning() -> None:
    with pytest.raises(InfeasibleError, match=r"alpha: leg 1 of \d+ \(course 90 degrees\) cannot be flown: it makes"):
        plan_fleet(scene_of(question(ALPHA, wind={"speed_m_s": 8, "from_deg": 90})))
    with_it = question(
        ALPHA,
        wind={"speed_m_s": 8, "from_deg": 270},
        fleet={"direct_return": "waived"},
        defaults={"return_height_m": 60},
    )
    assert plan_fleet(scene_of(with_it)).certificate is not None


def test_speeds_are_those_of_the_mission_file_in_calm_air() -> None:
    (task,) = scene_of(question(ALPHA)).tasks
    assert wind.speed_range_m_s(task, task.route_m) == (3.0, 10.0)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("from_deg", [0, 45, 135, 200])
def test_a_copter_is_commanded_what_keeps_it_near_its_legs(autopilot: str, from_deg: float) -> None:
    vehicle = {**ALPHA, "speed_m_s": {"min": 2, "max": 12}, "autopilot": autopilot}
    (task,) = scene_of(question(vehicle, wind={"speed_m_s": 7, "from_deg": from_deg})).tasks
    line = np.array([[0.0, 0.0, 140.0], [300.0, 0.0, 140.0], [300.0, 200.0, 140.0]])
    low, high = wind.speed_range_m_s(task, line)
    assert low == 2.0 < high <= 12.0
    whole = np.concatenate([task.home_m[None], line])
    legs = np.stack([whole[:-1], whole[1:]], axis=1)

    def off_m(speed_m_s: float) -> float:
        return wind.off_legs_m(predict_flight(task.motion, task.home_m, line, speed_m_s)[0], legs)

    assert off_m(high) <= task.limits.deviation_m
    assert high == 12.0 or off_m(high + 0.5) > 0.9 * task.limits.deviation_m
    assert (off_m(12.0) <= 0.95 * task.limits.deviation_m) == (high == 12.0)


def test_a_plane_flies_as_fast_through_the_air_as_the_wind_asks() -> None:
    vehicle = {**ALPHA, "class": "plane"}
    (task,) = scene_of(question(vehicle, wind={"speed_m_s": 13, "from_deg": 90})).tasks
    east = np.array([[0.0, 0.0, 140.0], [900.0, 0.0, 140.0]])
    low, high = wind.speed_range_m_s(task, east)
    assert 16.0 <= low <= 16.0 + 0.4
    assert high == 22.0
    assert wind.speed_range_m_s(task, east[::-1]) == (14.0, 22.0)


def test_distances_from_legs_are_those_of_the_nearest() -> None:
    legs = np.array([[[0.0, 0, 0], [10, 0, 0]], [[10.0, 0, 0], [10, 10, 0]]])
    points = np.array([[5.0, 2, 0], [12, 5, 0], [-3, -4, 0], [10, 0, 0]])
    for k in range(4):
        flight = Trajectory(np.arange(k + 1.0), points[: k + 1])
        assert wind.off_legs_m(flight, legs) == pytest.approx([2.0, 2.0, 5.0, 5.0][k])


# --- laws of flights in the wind


@settings(max_examples=15, deadline=None)
@given(air=airs, angle=courses, plane=st.booleans())
def test_turning_mission_and_wind_together_changes_nothing(air: tuple[float, float], angle: float, plane: bool) -> None:
    """But for PX4's copters, that limit north and east each by itself; a plane may see a corner one look later."""
    line = np.array([[60.0, 0.0, 50.0], [100.0, 70.0, 60.0], [20.0, 110.0, 50.0]])
    if plane:
        line *= [10.0, 10.0, 1.0]
    speed = 15.0 if plane else 4.0
    known = battery(air, **{"class": "plane" if plane else "copter"})
    around = replace(known, motion=blown(known.motion, *turned(np.array(air), angle)))
    one, reached_s = predict(known.motion, np.array([0.0, 0.0, 50.0]), line, speed)
    other, turned_s = predict(around.motion, np.array([0.0, 0.0, 50.0]), turned(line, angle), speed)
    assert turned_s == pytest.approx(reached_s, abs=0.3 if plane else 0.1)
    assert used_share(around, other, 0.0)[-1] == pytest.approx(used_share(known, one, 0.0)[-1], rel=5e-3)
    assert np.abs(other.at(one.t_s) - turned(one.position_m, angle)).max() < (8.0 if plane else 0.5)


@pytest.mark.parametrize("model", [*COPTERS, PLANE])
def test_no_wind_is_no_wind_bit_for_bit(model: MotionModel) -> None:
    line, start = [[400.0, 0.0, 150.0], [400.0, 500.0, 150.0]], [0.0, 0.0, 150.0]
    one, _ = predict(model, start, line, 15.0)
    other, _ = predict(blown(model, 0.0, 0.0), start, line, 15.0)
    assert one.position_m.tobytes() == other.position_m.tobytes()
    known = battery(autopilot=model.autopilot, **{"class": model.vehicle_class})
    assert (
        used_share(known, one, 0.0).tobytes()
        == used_share(
            battery((0.0, 0.0), **{"class": model.vehicle_class}, autopilot=model.autopilot), one, 0.0
        ).tobytes()
    )


@given(speed=st.floats(6.5, 10.0), strength=st.floats(0.5, 5.0), vehicle_class=st.sampled_from(["copter", "plane"]))
def test_a_leg_takes_more_against_the_wind_and_less_with_it(speed: float, strength: float, vehicle_class: str) -> None:
    """At the same airspeed, over the same ground."""
    speed *= 1.0 if vehicle_class == "copter" else 2.0

    def share(tail_m_s: float) -> float:
        known = battery((tail_m_s, 0.0), **{"class": vehicle_class})
        over = Trajectory(np.array([0.0, 1000.0 / (speed + tail_m_s)]), np.array([[0.0, 0, 50], [1000.0, 0, 50]]))
        return float(used_share(known, over, 0.0)[-1])

    assert share(-strength) > share(0.0) > share(strength)
    assert share(-strength) == pytest.approx(share(0.0) * speed / (speed - strength))


@given(air=airs, more=st.floats(0.0, 3.0), step=st.tuples(st.floats(-12.0, 12.0), st.floats(-12.0, 12.0)))
def test_the_strongest_wind_never_takes_less_than_the_known_one(
    air: tuple[float, float], more: float, step: tuple[float, float]
) -> None:
    known = battery(air)
    over = Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 50.0], [*step, 50.0]]))
    strongest_m_s = max(math.hypot(*air) + more, 1e-6)
    assert used_share(known, over, strongest_m_s)[-1] >= used_share(known, over, 0.0)[-1] * (1.0 - 1e-12)


@settings(max_examples=40, deadline=None)
@given(air=airs, from_=courses, away=st.floats(20.0, 1500.0), autopilot=st.sampled_from(["ardupilot", "px4"]))
def test_the_way_home_in_the_wind_takes_no_more_than_told(
    air: tuple[float, float], from_: float, away: float, autopilot: str
) -> None:
    known = battery(air, autopilot=autopilot)
    start = HOME + np.array([away * math.cos(from_), away * math.sin(from_), 40.0])
    homing = replace(known.motion, return_height_m=60.0)
    flown, _ = Navigator([homing], start[None]).fly(return_points(homing, start, HOME))
    there = Trajectory(np.array([0.0, 1.0]), np.array([start, start]))
    told = return_share(known, there, HOME, 60.0, 0.0)[0]
    assert used_share(known, flown, 0.0)[-1] <= told
    calm = return_share(battery(autopilot=autopilot), there, HOME, 60.0, 0.0)[0]
    assert told >= calm - away / 10.0 / 1200.0  # a wind from behind spares at most the way


def test_nobody_comes_home_against_the_wind_that_carries_it_off() -> None:
    there = Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 500, 150], [0.0, 500, 150]]))
    assert np.all(np.isinf(return_share(battery((0.0, 11.0)), there, HOME, 30.0, 0.0)))
    assert np.all(np.isfinite(return_share(battery((0.0, 9.0)), there, HOME, 30.0, 0.0)))
    assert np.all(np.isinf(return_share(battery((0.0, 7.0), airspeed_max_m_s=6.5), there, HOME, 30.0, 0.0)))
    plane = battery((22.0, 0.0), **{"class": "plane"})
    assert np.all(np.isinf(return_share(plane, there, HOME, 30.0, 0.0)))


@settings(max_examples=60, deadline=None)
@given(
    which=st.sampled_from([0, 1]),
    strength=st.floats(0.0, 8.0),
    angle=courses,
    speed=st.floats(2.0, 10.0),
    back=st.booleans(),
)
def test_a_copter_comes_to_rest_where_its_braking_in_the_wind_says(
    which: int, strength: float, angle: float, speed: float, back: bool
) -> None:
    model = blown(COPTERS[which], strength * math.cos(angle), strength * math.sin(angle))
    navigator = Navigator([model], np.zeros((1, 3)))
    navigator.follow(0, *Route.through([[3000.0, 0.0, 0.0]], speed))
    for _ in range(500):
        navigator.step()
    told_at, velocity = navigator.position_m[0].copy(), navigator.velocity_m_s[0, :2].copy()
    flown = float(np.hypot(*velocity))
    if back:
        navigator.follow(0, *Route.through([told_at - [300.0, 0.0, 0.0]], 10.0))
    else:
        navigator.halt(0)
    farthest = 0.0
    for _ in range(500):
        navigator.step()
        farthest = max(farthest, float((navigator.position_m[0] - told_at)[:2] @ velocity) / flown)
    lag_s = max(1.0, 0.5 * model.acceleration_m_s2 / model.jerk_m_s3)
    allowed = float(stopping_m(np.array(flown), wind.braking_m_s2(model, strength), lag_s))
    if model.autopilot == "px4" or not back:  # who is halted runs its legs' clock down, as PX4 does its trajectory's
        allowed = max(allowed, float(stopping_m(np.array(speed), model.acceleration_m_s2, lag_s)))
    assert farthest <= allowed + wind.pushed_off_m(model) + 0.3


@pytest.mark.parametrize("model", COPTERS)
def test_drift_before_leaning_in_grows_with_the_wind(model: MotionModel) -> None:
    drifts = [wind.leaning_in_m(model, strength) for strength in (0.0, 2.0, 5.0, 8.0)]
    assert drifts[0] == 0.0
    assert all(a < b for a, b in pairwise(drifts))
    assert drifts[2] < 2.5


# --- the proof


def windy_scene(*vehicles: dict[str, Any], **changes: Any) -> Scene:
    fleet = {"arrive_together": False, "direct_return": "waived"} | changes.pop("fleet", {})
    return scene_of(question(*(vehicles or (ALPHA,)), fleet=fleet, **changes))


def by_hand(scene: Scene, line: Any, speed_m_s: float) -> FleetPlan:
    path = PlannedPath(np.array(line), np.array(line), 0.0, 0.0, {}, np.zeros(1), 0)
    legs = len(line) - 1
    return assemble(scene, [path], [Schedule(0.0, (speed_m_s,) * legs, (0.0,) * legs, (0.0, 1e3))], None, seed=1)


BENT = [(0.0, 0.0, 140.0), (300.0, 0.0, 140.0), (300.0, 200.0, 140.0)]
TO_CORNER = {**ALPHA, "goal": at(300, 200, amsl=140), "speed_m_s": {"min": 2, "max": 12}, "autopilot": "px4"}


def test_who_cannot_hold_its_legs_in_the_wind_is_not_proven() -> None:
    scene = windy_scene({**TO_CORNER, "tracking_error_m": 3}, wind={"speed_m_s": 7, "from_deg": 135})
    for speed_m_s, held in ((4.0, True), (11.0, False)):
        certificate = proof.checked(scene, by_hand(scene, BENT, speed_m_s)).certificate
        assert certificate is not None
        told = [f for f in certificate.findings if f.check == "speed" and "off its legs" in f.detail]
        assert [f.proven for f in told] == [held]
        assert certificate.proven is held, certificate.refusal
        slower = [f.detail for f in certificate.findings if "m/s commanded" in f.detail]
    assert slower == (
        [] if held else ["makes 3.5 of the 11 m/s commanded in 7 m/s of wind from 135 degrees; predicted so"]
    )


def test_a_leg_of_any_mission_that_cannot_be_flown_is_named() -> None:
    scene = windy_scene(ALPHA, wind={"speed_m_s": 9, "from_deg": 90})
    sortie = Sortie(
        name="alpha", sysid=1, autopilot="ardupilot", vehicle_class="copter", home_m=np.array([0.0, 0.0, 100.0]),
        legs=(
            Leg(1, "takeoff", np.array([0.0, 0.0, 140.0]), 5.0),
            Leg(3, "straight", np.array([300.0, 0.0, 140.0]), 5.0),
        ),
        ending="land", ending_seq=4, start_delay_s=0.0, return_height_m=15.0,
    )  # fmt: skip
    with pytest.raises(InfeasibleError, match=r"alpha: item 3: its leg \(course 90 degrees\) cannot be flown"):
        proof.predict(scene, [sortie])
    lee = replace(sortie, legs=(sortie.legs[0], replace(sortie.legs[1], end_m=np.array([-300.0, 0.0, 140.0]))))
    assert len(proof.predict(scene, [lee])) == 1


def test_the_certificate_states_the_wind_it_was_planned_with() -> None:
    def told(**changes: Any) -> list[str]:
        scene = windy_scene(**changes)
        certificate = proof.checked(scene, by_hand(scene, BENT[:2], 4.0)).certificate
        assert certificate is not None
        return [line for line in certificate.assumptions if "wind" in line]

    known = {"speed_m_s": 5, "from_deg": 270}
    assert told() == ["wind of at most 0 m/s"]
    assert told(wind=known) == ["flights are predicted in a steady wind of 5 m/s from 270 degrees"]
    (strongest,) = told(wind=known, wind_max_m_s=7)[1:]
    assert strongest.startswith("wind of at most 7 m/s: energy, braking and ways home")


def test_a_lift_off_that_drifts_further_than_it_may_stray_is_not_proven() -> None:
    for tracking_error_m, proven in ((2.0, True), (0.3, False)):
        scene = windy_scene({**ALPHA, "tracking_error_m": tracking_error_m}, wind={"speed_m_s": 5, "from_deg": 270})
        certificate = proof.checked(scene, by_hand(scene, BENT[:2], 4.0)).certificate
        assert certificate is not None
        assert [f.proven for f in certificate.findings if "until it leans in" in f.detail] == [proven]


def test_energy_is_told_in_the_known_wind() -> None:
    legs = (Leg(1, "takeoff", np.array([0.0, 0.0, 140.0]), 4.0), Leg(3, "straight", np.array([400.0, 0.0, 140.0]), 4.0))
    asked = Sortie("alpha", 1, "ardupilot", "copter", HOME, legs, "land", 4, 0.0, 15.0)
    for tail_m_s, more in ((-5.0, 1), (5.0, -1)):
        shares = []
        for air in ((tail_m_s, 0.0), (0.0, 0.0)):
            known = battery(air)
            flight, reached_s = predict_flight(
                known.motion, HOME, np.array([leg.end_m for leg in legs]), 10.0, end="land", ground_amsl_m=100.0
            )
            found = findings(known, asked, flight, reached_s, 0.0)
            assert all("m/s of wind from" in f.detail for f in found[:1]) == (air != (0.0, 0.0))
            shares.append(found[0].value or 0.0)
        assert (shares[0] - shares[1]) * more > 0.0


def test_the_wind_is_kept_with_the_plan(tmp_path: Path) -> None:
    scene = scene_of(question(ALPHA, wind={"speed_m_s": 4, "from_deg": 300}, wind_max_m_s=5))
    plan = plan_fleet(scene)
    save_plan(tmp_path, scene, plan)
    assert json.loads((tmp_path / "plan.json").read_text())["mission"]["wind"] == {"speed_m_s": 4, "from_deg": 300}
    again_scene, again = load_plan(tmp_path)
    assert again_scene.mission.wind == scene.mission.wind
    assert again.vehicles[0].motion.wind_m_s == plan.vehicles[0].motion.wind_m_s
    assert again.vehicles[0].trajectory.position_m.tobytes() == plan.vehicles[0].trajectory.position_m.tobytes()
