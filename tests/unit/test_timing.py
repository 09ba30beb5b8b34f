"""Predicted flights and arrivals, separation in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from missionplanner.plan import Trajectory
from missionplanner.timing import least_separation, predict_flight, reached_times
from missionplanner.vehicle import Ending, MotionModel

COPTER = MotionModel("ardupilot", "copter", 2.5, 1.0, 2.5, 1.5, 2.0, 0.0)
PX4 = MotionModel("px4", "copter", 3.0, 4.0, 3.0, 1.5, 2.0, 0.0, return_height_m=60.0)
PLANE = MotionModel("ardupilot", "plane", 1.5, 1.0, 5.0, 5.0, 50.0, 60.0, return_height_m=100.0)
HOME = [0.0, 0.0, 100.0]
WAYPOINTS = np.array([[0, 0, 130], [150, 20, 140], [250, 120, 150], [240, 300, 140], [400, 420, 135]], dtype=float)


@pytest.mark.parametrize("model", [COPTER, PX4], ids=["arducopter", "px4"])
def test_a_flight_begins_at_home_and_ends_on_the_ground(model: MotionModel) -> None:
    flight, reached_s = predict_flight(model, HOME, WAYPOINTS, 8.0, end="land", ground_amsl_m=95.0)
    assert flight.position_m[0] == pytest.approx(HOME)
    assert flight.position_m[-1] == pytest.approx([400, 420, 95], abs=1.0)
    assert len(reached_s) == len(WAYPOINTS)
    assert np.all(np.diff(reached_s) > 0.0)
    assert np.all(np.diff(flight.t_s) > 0.0)
    assert flight.t_s[-1] > reached_s[-1] + 20.0
    near = [np.linalg.norm(flight.at(t) - w) for t, w in zip(reached_s, WAYPOINTS, strict=True)]
    assert max(near) < 3.0


@pytest.mark.parametrize("end", ["loiter", "land", "rtl"])
def test_the_delay_shifts_everything(end: str) -> None:
    arguments = {"end": end, "ground_amsl_m": 100.0}
    now, now_s = predict_flight(COPTER, HOME, WAYPOINTS, 6.0, **arguments)  # type: ignore[arg-type]
    later, later_s = predict_flight(COPTER, HOME, WAYPOINTS, 6.0, start_delay_s=7.3, **arguments)  # type: ignore[arg-type]
    assert later_s == pytest.approx(now_s + 7.3)
    assert later.t_s[0] == 0.0
    assert later.at(7.3) == pytest.approx(HOME)
    assert later.at(now.t_s[::50] + 7.3) == pytest.approx(now.position_m[::50], abs=1e-6)


def test_return_ends_at_home() -> None:
    flight, _ = predict_flight(COPTER, HOME, WAYPOINTS, 6.0, end="rtl")
    assert flight.position_m[-1] == pytest.approx(HOME, abs=0.2)


def test_return_is_flown_at_the_height_that_is_set() -> None:
    for height_m in (45.0, 90.0):
        flight, reached_s = predict_flight(replace(COPTER, return_height_m=height_m), HOME, WAYPOINTS, 6.0, end="rtl")
        way_home = flight.position_m[flight.t_s > reached_s[-1]]
        midway = way_home[np.argmin(np.hypot(*(way_home[:, :2] - [200, 210]).T))]
        assert midway[2] == pytest.approx(100.0 + height_m, abs=0.5)


def test_a_plane_flies_its_legs() -> None:
    far = WAYPOINTS * [5, 5, 1] + [400, 0, 0]
    flight, reached_s = predict_flight(PLANE, HOME, far, 18.0)
    assert np.all(np.diff(reached_s) > 0.0)
    stays = flight.position_m[flight.t_s > reached_s[-1] + 35.0] - far[-1]
    assert len(stays) > 100  # once around at least
    away_m = np.hypot(stays[:, 0], stays[:, 1])
    assert away_m.min() > PLANE.loiter_radius_m  # it slips outwards
    assert away_m.max() < PLANE.loiter_radius_m + 20.0


def test_a_plane_that_returns_circles_above_home() -> None:
    flight, reached_s = predict_flight(PLANE, HOME, WAYPOINTS * [5, 5, 1] + [400, 0, 0], 18.0, end="rtl")
    assert flight.t_s[-1] > reached_s[-1] + 30.0
    away_m = np.hypot(*flight.position_m[-200:, :2].T)
    assert away_m.min() > PLANE.loiter_radius_m
    assert away_m.max() < PLANE.loiter_radius_m + 25.0
    assert flight.position_m[-1, 2] == pytest.approx(200.0, abs=0.5)


def test_a_plane_takes_off_at_its_cruise_speed() -> None:
    far = WAYPOINTS * [5, 5, 1] + [400, 0, 0]
    slow, fast = (predict_flight(PLANE, HOME, far, speed)[1] for speed in (14.0, 22.0))
    assert slow[0] == fast[0]
    slower = replace(PLANE, cruise_speed_m_s=15.0)
    assert predict_flight(slower, HOME, far, 22.0)[1][0] != fast[0]


@pytest.mark.parametrize("model", [COPTER, PX4], ids=["arducopter", "px4"])
def test_every_leg_may_have_its_own_speed(model: MotionModel) -> None:
    one, one_s = predict_flight(model, HOME, WAYPOINTS, 8.0, end="land", ground_amsl_m=95.0)
    same, same_s = predict_flight(model, HOME, WAYPOINTS, [8.0] * 4, end="land", ground_amsl_m=95.0)
    assert np.array_equal(one.position_m, same.position_m)
    assert np.array_equal(one_s, same_s)
    _, slower_s = predict_flight(model, HOME, WAYPOINTS, [8.0, 4.0, 8.0, 8.0])
    legs_m = np.linalg.norm(np.diff(WAYPOINTS, axis=0), axis=1)
    more_s = np.diff(slower_s) - np.diff(one_s)
    assert more_s[1] == pytest.approx(legs_m[1] / 4 - legs_m[1] / 8, abs=7.0)
    assert np.abs(more_s[[0, 3]]).max() < 3.0


@pytest.mark.parametrize("model", [COPTER, PX4], ids=["arducopter", "px4"])
def test_a_hold_is_a_stop_of_that_long_at_its_waypoint(model: MotionModel) -> None:
    flight, reached_s = predict_flight(model, HOME, WAYPOINTS, 8.0, hold_s=[0.0, 9.0, 0.0, 0.0])
    _, passing_s = predict_flight(model, HOME, WAYPOINTS, 8.0)
    near = np.linalg.norm(flight.position_m - WAYPOINTS[2], axis=1) < model.waypoint_radius_m
    assert np.count_nonzero(near) * np.diff(flight.t_s)[0] >= 9.0
    # PX4 counts from where it accepts the waypoint; who passes overshoots it meanwhile, and loses time with that
    assert reached_s[-1] - passing_s[-1] >= (9.0 if model is COPTER else 7.5)
    assert reached_s[1] == pytest.approx(passing_s[1], abs=0.2)


@pytest.mark.parametrize(("model", "end"), [(COPTER, "loiter"), (PLANE, "loiter"), (PLANE, "rtl")])
def test_who_stays_in_the_air_is_followed_as_long_as_asked(model: MotionModel, end: Ending) -> None:
    flight, _ = predict_flight(model, HOME, WAYPOINTS * [3, 3, 1], 15.0, end=end, start_delay_s=3.0, until_s=400.0)
    short, _ = predict_flight(model, HOME, WAYPOINTS * [3, 3, 1], 15.0, end=end, start_delay_s=3.0)
    assert flight.t_s[-1] == pytest.approx(400.0, abs=0.1)
    assert short.t_s[-1] < 300.0
    assert np.array_equal(flight.position_m[: len(short.t_s)], short.position_m)


def test_px4_settles_at_its_goal_though_it_accepts_it_from_afar() -> None:
    wide = replace(PX4, waypoint_radius_m=10.0)
    flight, reached_s = predict_flight(wide, HOME, WAYPOINTS, 8.0, end="loiter")
    assert np.linalg.norm(flight.at(reached_s[-1]) - WAYPOINTS[-1]) > 5.0
    assert flight.position_m[-1] == pytest.approx(WAYPOINTS[-1], abs=1.5)
    landed, _ = predict_flight(wide, HOME, WAYPOINTS, 8.0, end="land", ground_amsl_m=90.0)
    assert landed.position_m[-1] == pytest.approx([400, 420, 90], abs=0.3)


def arrival_s(model: MotionModel, waypoints: np.ndarray, speed_m_s: float) -> float:
    return float(reached_times(model, HOME, waypoints, speed_m_s)[-1])


def test_arrivals_are_what_the_model_flies() -> None:
    flight, reached_s = predict_flight(COPTER, HOME, WAYPOINTS, [10.0, 6.0, 3.0, 8.0], hold_s=[0.0, 3.0, 0.0, 0.0])
    alone_s = reached_times(COPTER, HOME, WAYPOINTS, [10.0, 6.0, 3.0, 8.0], [0.0, 3.0, 0.0, 0.0])
    np.testing.assert_array_equal(alone_s, reached_s)
    assert flight.t_s[-1] > alone_s[-1]
    length_m = np.linalg.norm(np.diff(WAYPOINTS, axis=0), axis=1).sum()
    assert arrival_s(COPTER, WAYPOINTS, 10.0) > length_m / 10.0 + 20.0  # take-off, hover, corners


def test_short_legs_cap_the_speed() -> None:
    line = np.array([[10.0 * k, 0.0, 130.0] for k in range(21)])
    assert arrival_s(COPTER, line, 2.0) / arrival_s(COPTER, line, 10.0) < 1.6  # length over speed would say 5
    assert arrival_s(COPTER, line, 5.0) == pytest.approx(arrival_s(COPTER, line, 10.0), abs=0.2)


def straight(start: list[float], velocity: list[float], begin_s: float, end_s: float) -> Trajectory:
    t = np.array([begin_s, end_s])
    return Trajectory(t, np.array(start) + np.outer(t - begin_s, velocity))


def test_crossing_flights_in_closed_form() -> None:
    east = straight([-50, 0, 100], [5, 0, 0], 0.0, 20.0)
    north = straight([0, -40, 103], [0, 5, 0], 0.0, 20.0)
    (pair,) = least_separation([east, north])
    # relative motion (5, -5): closest when 5 (t - 10) = 5 (8 - t), at t = 9, 5 m away in each of x and y
    assert pair.t_s == pytest.approx(9.0)
    assert pair.distance_m == pytest.approx(np.sqrt(25 + 25 + 9))
    assert np.linalg.norm(pair.first_m - pair.second_m) == pytest.approx(pair.distance_m)


def test_vehicles_wait_before_and_after() -> None:
    early = straight([0, 0, 0], [1, 0, 0], 0.0, 10.0)
    late = straight([10, 5, 0], [0, -1, 0], 30.0, 40.0)  # passes the other's end at 35 s
    (pair,) = least_separation([early, late])
    assert pair.distance_m == pytest.approx(0.0, abs=1e-9)
    assert pair.t_s == pytest.approx(35.0)


def test_every_pair_once() -> None:
    fleet = [straight([0, 30.0 * k, 0], [1, 0, 0], 0.0, 5.0 + k) for k in range(4)]
    pairs = least_separation(fleet)
    assert [(p.first, p.second) for p in pairs] == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    assert [round(p.distance_m) for p in pairs] == [30, 60, 90, 30, 60, 30]
    assert least_separation(fleet[:1]) == []
