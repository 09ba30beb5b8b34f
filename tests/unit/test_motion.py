"""The navigators: what was measured of real autopilots, and what a caller may rely on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from missionplanner.motion import (
    TICK_S,
    Navigator,
    Route,
    climbing_as_stated,
    landing_points,
    predict,
    return_points,
    takeoff_points,
)
from missionplanner.vehicle import ArducopterTuning, MotionModel

COPTER = MotionModel("ardupilot", "copter", 2.5, 1.0, 2.5, 1.5, 2.0, 0.0)
PX4 = MotionModel("px4", "copter", 3.0, 4.0, 3.0, 1.5, 2.0, 0.0, return_height_m=60.0)
PLANE = MotionModel("ardupilot", "plane", 1.5, 1.0, 5.0, 5.0, 50.0, 60.0, return_height_m=100.0)
ALL = [pytest.param(COPTER, id="arducopter"), pytest.param(PX4, id="px4"), pytest.param(PLANE, id="plane")]
COPTERS = ALL[:2]


def speed_of(model: MotionModel) -> float:
    return 18.0 if model.vehicle_class == "plane" else 8.0


def line(spacing_m: float, count: int = 14) -> np.ndarray:
    return np.array([[spacing_m * (k + 1), 0.0, 20.0] for k in range(count)])


def fly_steps(navigator: Navigator, steps: int) -> np.ndarray:
    flown = []
    for _ in range(steps):
        navigator.step()
        flown.append(navigator.position_m.copy())
    return np.array(flown)


@pytest.mark.parametrize(("spacing_m", "top_m_s"), [(5.0, 1.7), (10.0, 2.75), (20.0, 4.4), (40.0, 7.1), (80.0, 10.0)])
def test_arducopter_looks_one_leg_ahead(spacing_m: float, top_m_s: float) -> None:
    flight, reached_s = predict(COPTER, [0, 0, 20], line(spacing_m), 10.0)
    speed = np.linalg.norm(np.diff(flight.position_m, axis=0), axis=1) / TICK_S
    assert speed[: int(reached_s[-2] / TICK_S)].max() == pytest.approx(top_m_s, rel=0.02)
    if spacing_m < 60:
        assert np.diff(reached_s)[5] == pytest.approx(1.68 * spacing_m ** (1 / 3), rel=0.03)


@pytest.mark.parametrize(("speed_m_s", "hover_s", "last_s"), [(5.0, 3.0, 2.5), (10.0, 5.3, 4.7)])
def test_arducopter_extra_time_of_100_m_legs(speed_m_s: float, hover_s: float, last_s: float) -> None:
    corners = [[100, 0, 20], [100, 100, 20], [0, 100, 20]]
    _, reached_s = predict(COPTER, [0, 0, 20], corners, speed_m_s)
    first, _, last = np.diff(np.concatenate([[0.0], reached_s])) - 100.0 / speed_m_s
    assert first == pytest.approx(hover_s, abs=0.5)
    assert last == pytest.approx(last_s, abs=0.5)


@pytest.mark.parametrize(("turn_deg", "least_m_s"), [(90.0, 2.9), (135.0, 1.3), (180.0, 0.15)])
def test_arducopter_slows_down_in_corners(turn_deg: float, least_m_s: float) -> None:
    turn = math.radians(turn_deg)
    corner = np.array([100.0, 0.0, 20.0])
    after = corner + 100.0 * np.array([math.cos(turn), math.sin(turn), 0.0])
    flight, reached_s = predict(COPTER, [0, 0, 20], [corner, after], 10.0)
    near = np.abs(flight.t_s - reached_s[0]) < 3.0
    velocity = np.gradient(flight.position_m, TICK_S, axis=0)
    assert np.linalg.norm(velocity[near], axis=1).min() == pytest.approx(least_m_s, abs=0.35)
    assert np.linalg.norm(flight.position_m - corner, axis=1).min() < 2.0  # inside the waypoint radius


def test_arducopter_changes_speed_late() -> None:
    points = line(150.0, 3)
    _, steady_s = predict(COPTER, [0, 0, 20], points, 10.0)
    _, slowing_s = predict(COPTER, [0, 0, 20], points, [10.0, 3.0, 3.0])
    assert np.diff(slowing_s)[0] < 150.0 / 3.0 - 10.0  # 60 to 70 m are flown before 3 m/s is reached
    assert np.diff(slowing_s)[0] > np.diff(steady_s)[0] + 20.0
    assert np.diff(slowing_s)[1] == pytest.approx(150.0 / 3.0, abs=2.0)


def test_arducopter_holds_with_a_full_stop() -> None:
    points = line(100.0, 3)
    _, passing_s = predict(COPTER, [0, 0, 20], points, 5.0)
    _, holding_s = predict(COPTER, [0, 0, 20], points, 5.0, [0.0, 1.0, 0.0])
    assert holding_s[2] - holding_s[1] - 1.0 == pytest.approx(25.0, abs=1.0)
    assert holding_s[2] > passing_s[2] + 5.0


@pytest.mark.parametrize("model", COPTERS)
@pytest.mark.parametrize("height_m", [20.0, 30.0])
def test_takeoff_takes_as_long_as_measured(model: MotionModel, height_m: float) -> None:
    flight, reached_s = predict(model, [0, 0, 100], *takeoff_points(model, [0, 0, 100], [0, 0, 100 + height_m]))
    measured_s = {("ardupilot", 20.0): 12.0, ("ardupilot", 30.0): 16.1, ("px4", 20.0): 16.5, ("px4", 30.0): 20.0}
    assert reached_s[-1] == pytest.approx(measured_s[model.autopilot, height_m], abs=1.5)
    assert np.ptp(flight.position_m[:, :2]) == 0.0


@pytest.mark.parametrize(("model", "measured_s"), [(COPTER, 31.0), (PX4, 26.2)])
def test_landing_takes_as_long_as_measured(model: MotionModel, measured_s: float) -> None:
    flight, _ = predict(model, [5, 5, 120], *landing_points(model, [5, 5, 120], 100.0))
    assert flight.t_s[-1] == pytest.approx(measured_s, abs=1.5)
    assert flight.position_m[-1] == pytest.approx([5, 5, 100], abs=0.2)


def test_arducopter_lands_slowly_below_its_slow_height() -> None:
    for height_m, slow_m in ((7.0, 10.0), (20.0, 10.0), (40.0, 25.0)):
        tuned = replace(COPTER, arducopter=ArducopterTuning(land_slow_below_m=slow_m))
        flight, reached_s = predict(tuned, [0, 0, height_m], *landing_points(tuned, [0, 0, height_m], 0.0))
        rate = -np.gradient(flight.position_m[:, 2], flight.t_s)
        slow = (flight.position_m[:, 2] < slow_m - 1.0) & (flight.t_s < reached_s[0] - 0.2) & (flight.t_s > 2.0)
        assert rate[slow] == pytest.approx(0.5, abs=0.12)
        assert flight.t_s[-1] - reached_s[0] == pytest.approx(2.1, abs=0.1)


@pytest.mark.parametrize("model", COPTERS)
def test_return_climbs_first_and_ends_at_home(model: MotionModel) -> None:
    for climb_m in (model.return_height_m, 33.0):  # the autopilot's own, and one that is set
        set_so = replace(model, return_height_m=climb_m)
        flight, _ = predict(set_so, [80, 0, 105], *return_points(set_so, [80, 0, 105], [0, 0, 100]))
        assert flight.position_m[:, 2].max() == pytest.approx(100.0 + climb_m, abs=0.9)
        assert flight.position_m[-1] == pytest.approx([0, 0, 100], abs=0.7)


@pytest.mark.parametrize("model", ALL)
def test_prediction_is_bitwise_the_navigator(model: MotionModel) -> None:
    rng = np.random.default_rng(5)
    points = np.cumsum(rng.normal(0, 120, (8, 3)) * [1, 1, 0.1], axis=0) + np.array([0, 0, 50])
    speed = speed_of(model)
    flight, reached_s = predict(model, [0, 0, 50], points, speed, np.arange(8) % 3 * 0.7)
    # the second of three vehicles, started later, among others of every kind
    navigator = Navigator([PX4, model, PLANE], [[9, 9, 9], [0, 0, 50], [1, 1, 1]])
    navigator.follow(0, [[100, 0, 20], [0, 50, 20]], 5.0)
    fly_steps(navigator, 37)
    navigator.follow(2, line(300.0), 20.0)
    navigator.follow(1, points, speed, np.arange(8) % 3 * 0.7)
    flown = fly_steps(navigator, len(flight.t_s) - 1)[:, 1]
    assert navigator.finished.tolist()[1]
    assert np.array_equal(flown, flight.position_m[1:])
    assert np.array_equal(navigator.reached_s[1, :8], reached_s)


@pytest.mark.parametrize("model", ALL)
def test_waypoints_count_up(model: MotionModel) -> None:
    navigator = Navigator([model], [[0, 0, 50]])
    navigator.follow(0, [[200, 0, 50], [200, 200, 50], [0, 200, 50]], speed_of(model))
    seen = [0]
    while not navigator.finished[0]:
        navigator.step()
        seen.append(int(navigator.waypoint[0]))
    assert sorted(set(seen)) == [0, 1, 2, 3]
    assert seen == sorted(seen)
    assert np.all(np.diff(navigator.reached_s[0, :3]) > 0.0)


def test_a_vehicle_without_route_stands_still() -> None:
    navigator = Navigator([COPTER, PX4, PLANE], [[0, 0, 1], [2, 0, 1], [4, 0, 1]])
    assert navigator.finished.all()
    assert np.array_equal(fly_steps(navigator, 5)[-1], [[0, 0, 1], [2, 0, 1], [4, 0, 1]])


@pytest.mark.parametrize("model", COPTERS)
def test_halt_stops_and_resume_goes_on(model: MotionModel) -> None:
    navigator = Navigator([model], [[0, 0, 20]])
    navigator.follow(0, line(100.0, 3), 8.0)
    fly_steps(navigator, 200)
    before = navigator.position_m[0].copy()
    navigator.halt(0)
    stopping = fly_steps(navigator, 600)[:, 0]
    assert np.linalg.norm(navigator.velocity_m_s[0]) < 0.2
    assert 5.0 < stopping[-1, 0] - before[0] < 40.0
    assert np.all(np.abs(stopping[:, 1:] - [0, 20]) < 1e-6)
    navigator.resume(0)
    while not navigator.finished[0]:
        navigator.step()
    fly_steps(navigator, 400)
    assert navigator.position_m[0] == pytest.approx([300, 0, 20], abs=0.5)


def assert_a_circle_of(off_m: np.ndarray, radius_m: float) -> None:
    """A settled circle, somewhat wider than it should be: a plane slips outwards in its turns."""
    away_m = np.hypot(off_m[:, 0], off_m[:, 1])
    assert np.ptp(away_m) < 0.01 * radius_m
    assert radius_m < away_m.mean() < radius_m + 15.0


def test_a_halted_plane_circles() -> None:
    navigator = Navigator([PLANE], [[0, 0, 50]])
    navigator.follow(0, line(1000.0, 2), 18.0)
    fly_steps(navigator, 400)
    navigator.halt(0)
    place = navigator.position_m[0].copy()
    circle = fly_steps(navigator, 2000)[1200:, 0] - place
    assert_a_circle_of(circle, PLANE.loiter_radius_m)
    assert circle[:, 2] == pytest.approx(0.0, abs=0.1)
    assert np.linalg.norm(navigator.velocity_m_s[0, :2]) == pytest.approx(18.0 * 1.018, abs=0.1)


@pytest.mark.parametrize("radius_m", [60.0, 80.0, 150.0])
def test_a_plane_circles_to_the_right_around_its_last_waypoint(radius_m: float) -> None:
    navigator = Navigator([replace(PLANE, loiter_radius_m=radius_m)], [[0, 0, 50]])
    navigator.fly(Route.through([[800, 100, 70]], 20.0))
    stay = navigator.linger(120.0)
    off = stay.position_m[1200:] - [800, 100, 70]
    assert_a_circle_of(off, radius_m)
    assert off[:, 2] == pytest.approx(0.0, abs=0.1)
    assert np.all(np.diff(np.unwrap(np.arctan2(off[:, 1], off[:, 0]))) < 0.0)
    assert np.hypot(*(stay.position_m[:, :2] - [800, 100]).T).max() < radius_m + 55.0


def test_a_planes_takeoff_is_as_recorded() -> None:
    # ArduPlane in SITL, 60 m up: 28 m rolled after 3.3 s; it climbs twice as fast as its climb limit says
    flight, reached_s = predict(PLANE, [0, 0, 584], *takeoff_points(PLANE, [0, 0, 584], [0, 300, 644]))
    assert flight.at(3.3)[1] == pytest.approx(28.0, abs=2.0)
    assert flight.at(3.3)[2] == 584.0
    assert reached_s[-1] == pytest.approx(10.45, abs=0.3)
    assert flight.position_m[-1, 1] == pytest.approx(197.0, abs=5.0)
    assert flight.position_m[-1, 2] == pytest.approx(644.0, abs=0.5)


@pytest.mark.parametrize("home_amsl_m", [0.0, 2000.0])
@pytest.mark.parametrize("height_m", [25.0, 60.0])
def test_a_planes_takeoff_ends_where_the_scene_expects_it(home_amsl_m: float, height_m: float) -> None:
    home, top = [0.0, 0.0, home_amsl_m], [0.0, 900.0, home_amsl_m + height_m]
    flight, _ = predict(PLANE, home, *takeoff_points(PLANE, home, top))
    strong = replace(PLANE, climb_rate_m_s=12.0)  # all that it is: as steeply as its nose points
    assert flight.position_m[-1, 1] == pytest.approx(strong.takeoff_distance_m(height_m, home_amsl_m), abs=8.0)
    weak = climbing_as_stated(PLANE, home_amsl_m)
    flight, _ = predict(weak, home, *takeoff_points(weak, home, top))
    expected_m = PLANE.takeoff_distance_m(height_m, home_amsl_m)
    assert 0.85 * expected_m <= flight.position_m[-1, 1] <= expected_m


@pytest.mark.parametrize("rate_m_s", [3.0, 5.0])
@pytest.mark.parametrize("home_amsl_m", [0.0, 2000.0])
def test_a_plane_as_weak_as_stated_climbs_no_better(rate_m_s: float, home_amsl_m: float) -> None:
    weak = climbing_as_stated(replace(PLANE, climb_rate_m_s=rate_m_s), home_amsl_m)
    home, top = [0.0, 0.0, home_amsl_m], [0.0, 900.0, home_amsl_m + 250.0]
    flight, _ = predict(weak, home, *takeoff_points(weak, home, top))
    height_m = flight.position_m[:, 2] - home_amsl_m
    high, low = (int(np.argmax(height_m >= h)) for h in (200.0, 50.0))
    climbed_m_s = (height_m[high] - height_m[low]) / (flight.t_s[high] - flight.t_s[low])
    assert 0.85 * rate_m_s <= climbed_m_s <= rate_m_s
    assert climbing_as_stated(replace(PLANE, climb_rate_m_s=15.0), 0.0).plane == PLANE.plane


def test_a_plane_lands_where_its_glide_meets_the_ground_and_rests() -> None:
    start, place = [0.0, 0.0, 160.0], [900.0, 0.0, 100.0]
    navigator = Navigator([PLANE], [start])
    navigator.velocity_m_s[0] = [18.0, 0.0, 0.0]
    glide, _ = navigator.fly(landing_points(PLANE, [place[0], place[1], 160.0], place[2], 18.0))
    assert glide.position_m[-1] == pytest.approx(place, abs=60.0)
    assert glide.position_m[-1, 2] == pytest.approx(100.0, abs=0.5)
    navigator.rest(0)
    assert np.ptp(fly_steps(navigator, 50)[:, 0], axis=0) == pytest.approx(np.zeros(3))


def test_a_plane_returns_to_a_fixed_height_above_home() -> None:
    for height_m in (50.0, 300.0):
        navigator = Navigator([PLANE], [[1500, 0, height_m]])
        navigator.fly(return_points(PLANE, [1500, 0, height_m], [0, 0, 20]))
        assert navigator.linger(60.0).position_m[-1, 2] == pytest.approx(120.0, abs=0.5)


@pytest.mark.parametrize("model", ALL)
def test_a_new_route_in_flight_begins_without_a_jump(model: MotionModel) -> None:
    navigator = Navigator([model], [[0, 0, 50]])
    navigator.follow(0, [[400, 0, 60]], speed_of(model))
    fly_steps(navigator, 260)
    navigator.follow(0, [[100, 150, 50]], speed_of(model))
    flown = np.vstack([navigator.position_m.copy(), fly_steps(navigator, 300)[:, 0]])
    velocity = np.diff(flown, axis=0) / TICK_S
    assert np.linalg.norm(velocity, axis=1).max() < 1.25 * speed_of(model)
    most_m_s2 = 30.0 if model.vehicle_class == "plane" else 8.0  # a plane pulls 3 g as it rolls into a sharp turn
    assert np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() / TICK_S < most_m_s2
    while not navigator.finished[0]:
        navigator.step()
    if model.vehicle_class == "copter":
        fly_steps(navigator, 400)
        assert navigator.position_m[0] == pytest.approx([100, 150, 50], abs=0.7)


@pytest.mark.parametrize("model", ALL)
def test_set_speed_in_flight(model: MotionModel) -> None:
    slow = 14.0 if model.vehicle_class == "plane" else 3.0
    navigator = Navigator([model], [[0, 0, 50]])
    navigator.follow(0, line(600.0, 2), speed_of(model))
    fly_steps(navigator, 400)
    navigator.set_speed(0, slow)
    fly_steps(navigator, 300)
    assert np.hypot(*navigator.velocity_m_s[0, :2]) == pytest.approx(slow, abs=0.6)
    navigator.set_speed(0, speed_of(model))
    fly_steps(navigator, 300)
    assert np.hypot(*navigator.velocity_m_s[0, :2]) == pytest.approx(speed_of(model), abs=0.6)


def test_a_zero_length_leg_is_reached_at_once_on_the_way_and_takes_a_second_at_the_start() -> None:
    _, reached_s = predict(COPTER, [0, 0, 20], [[0, 0, 20], [50, 0, 20], [50, 0, 20]], 5.0)
    assert 1.0 <= reached_s[0] <= 1.8  # recorded: 1.1 to 1.7 s
    assert reached_s[2] == reached_s[1]


def test_route_shares_scalars() -> None:
    made = Route.through([[0, 0, 1], [1, 2, 3]], 5, hold_s=[0, 2])
    assert made.points_m.shape == (2, 3)
    assert made.speed_m_s.tolist() == [5.0, 5.0]
    assert made.hold_s.tolist() == [0.0, 2.0]
    assert np.isinf(made.vertical_m_s).all()


def test_vertical_bound_of_one_leg() -> None:
    _, free_s = predict(COPTER, [0, 0, 0], [[0, 0, 20], [0, 0, 40]], 5.0)
    _, bound_s = predict(COPTER, [0, 0, 0], [[0, 0, 20], [0, 0, 40]], 5.0, vertical_m_s=[math.inf, 0.5])
    assert bound_s[0] == pytest.approx(free_s[0], abs=0.01)
    assert bound_s[1] - bound_s[0] > 25.0


def test_plane_cuts_corners_by_its_acceptance_radius() -> None:
    flight, reached_s = predict(PLANE, [0, 0, 60], [[800, 0, 60], [800, 800, 60]], 22.0)
    at_corner = flight.at(reached_s[0])
    assert np.linalg.norm(at_corner[:2] - [800, 0]) == pytest.approx(PLANE.waypoint_radius_m, abs=2.0)
    off = flight.position_m[:, :2] - [800, 0]
    assert 10.0 < np.hypot(*off.T).min() < 25.0  # recorded: 15 to 19 m
    assert 20.0 < off[:, 0].max() < 35.0  # it overshoots; recorded: 25 m
