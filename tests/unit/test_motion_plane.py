"""Planes: what ArduPlane was recorded to do, and what holds in any wind."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.errors import InfeasibleError
from missionplanner.motion import TICK_S, Navigator, Route, predict, return_points, takeoff_points
from missionplanner.plan import Trajectory
from missionplanner.vehicle import MotionModel, true_airspeed

PLANE = MotionModel("ardupilot", "plane", 1.5, 1.0, 5.0, 5.0, 50.0, 60.0, return_height_m=100.0)
EXACT = replace(PLANE, plane=replace(PLANE.plane, airspeed_reads_low=0.0))
LOW_M = 100.0


def in_wind(east_m_s: float, north_m_s: float) -> MotionModel:
    return replace(EXACT, wind_m_s=(east_m_s, north_m_s))


def flown(
    model: MotionModel, points: np.ndarray, speed_m_s: float, course_rad: float = 0.0
) -> tuple[Trajectory, np.ndarray]:
    """Fly from the origin, already at speed through the air, on a course (counter-clockwise from east)."""
    navigator = Navigator([model], [[0.0, 0.0, LOW_M]])
    nose = np.array([math.cos(course_rad), math.sin(course_rad), 0.0])
    navigator.velocity_m_s[0] = speed_m_s * nose + [*model.wind_m_s, 0.0]
    return navigator.fly(Route.through(points, speed_m_s))


def velocity_of(flight: Trajectory) -> np.ndarray:
    return np.diff(flight.position_m, axis=0) / TICK_S


def test_level_flight_is_at_the_airspeed_that_is_read() -> None:
    flight, _ = flown(PLANE, np.array([[3000.0, 0.0, LOW_M]]), 20.0)
    speed = np.linalg.norm(velocity_of(flight)[-400:], axis=1)
    assert speed == pytest.approx(20.0 * true_airspeed(LOW_M) * 1.018, rel=1e-3)


def test_speed_dips_in_a_climb_and_rises_before_it_settles() -> None:
    flight, _ = flown(
        EXACT, np.array([[1500.0, 0.0, LOW_M], [2500.0, 0.0, LOW_M + 150.0], [5000, 0, LOW_M + 150]]), 20.0
    )
    climbing = (flight.position_m[1:, 0] > 1600.0) & (flight.position_m[1:, 0] < 2400.0)
    level = flight.position_m[1:, 0] > 4000.0
    velocity = velocity_of(flight)
    assert velocity[climbing, 2].mean() == pytest.approx(3.0, abs=0.4)  # as steep as the leg, as fast as it flies
    assert np.abs(flight.position_m[1:][level, 2] - LOW_M - 150.0).max() < 0.5
    assert np.linalg.norm(velocity[level], axis=1) == pytest.approx(20.0 * true_airspeed(LOW_M + 150.0), rel=2e-3)


def test_no_leg_climbs_faster_than_the_climb_limit_for_long() -> None:
    flight, _ = flown(EXACT, np.array([[300.0, 0.0, LOW_M + 300.0], [6000.0, 0.0, LOW_M + 300.0]]), 20.0)
    rose = flight.position_m[100:, 2] - flight.position_m[:-100, 2]  # in five seconds
    assert rose.max() < 5.0 * EXACT.climb_rate_m_s * 1.25
    assert flight.position_m[-1, 2] == pytest.approx(LOW_M + 300.0, abs=8.0)  # up to the leg's end


@pytest.mark.parametrize("asked_m_s", [5.0, 35.0, 60.0])
def test_speeds_outside_its_limits_are_not_flown(asked_m_s: float) -> None:
    model = replace(EXACT, airspeed_limits_m_s=(12.0, 28.0))
    flight, _ = flown(model, np.array([[4000.0, 0.0, LOW_M]]), asked_m_s)
    speed = np.linalg.norm(velocity_of(flight)[-200:], axis=1) / true_airspeed(LOW_M)
    assert speed == pytest.approx(min(max(asked_m_s, 12.0), 28.0), rel=0.02)


@pytest.mark.parametrize("turn_deg", [30.0, 60.0, 90.0, 120.0])
def test_the_slower_the_more_a_corner_is_cut_by_its_radius(turn_deg: float) -> None:
    turn = math.radians(turn_deg)
    points = np.array([[800.0, 0.0, LOW_M], [800 + 900 * math.cos(turn), 900 * math.sin(turn), LOW_M]])
    flight, reached_s = flown(EXACT, points, 20.0)
    ahead_m = 50.0 * true_airspeed(LOW_M) ** 2 * min(turn_deg / 90.0, 1.0)
    assert 800.0 - flight.at(reached_s[0])[0] == pytest.approx(ahead_m, abs=2.0)
    late = flight.at(reached_s[1] - 10.0)[:2] - [800, 0]
    across = late[0] * math.sin(turn) - late[1] * math.cos(turn)
    assert abs(across) < 6.0  # on its leg again


def test_a_return_turns_and_climbs_at_once() -> None:
    navigator = Navigator([PLANE], [[2000.0, 0.0, 160.0]])
    navigator.velocity_m_s[0] = [22.0, 0.0, 0.0]
    flight, _ = navigator.fly(return_points(PLANE, [2000.0, 0.0, 160.0], [0.0, 0.0, 100.0]))
    after = flight.at(20.0)
    assert after[0] < 1800.0
    assert after[2] == pytest.approx(200.0, abs=6.0)  # 4 m/s at least, far from home
    assert np.hypot(*flight.position_m[-1, :2]) < 3.0 * PLANE.loiter_radius_m  # where it turns onto the circle
    assert np.hypot(*navigator.linger(60.0).position_m[-1, :2]) < PLANE.loiter_radius_m + 20.0


@settings(deadline=None, max_examples=25)
@given(
    east=st.floats(-9.0, 9.0),
    north=st.floats(-9.0, 9.0),
    course=st.floats(-math.pi, math.pi),
    speed_m_s=st.floats(14.0, 25.0),
)
def test_ground_speed_closes_the_triangle_of_velocities(
    east: float, north: float, course: float, speed_m_s: float
) -> None:
    along = np.array([math.cos(course), math.sin(course)])
    for sign in (1.0, -1.0):  # the wind and its mirror image
        wind = sign * np.array([east, north])
        if wind @ along - speed_m_s > -3.0 and speed_m_s - np.linalg.norm(wind) < 3.0:
            continue
        points = np.array([[*(4000.0 * along), LOW_M]])
        flight, _ = flown(in_wind(*wind), points, speed_m_s, course)
        velocity = velocity_of(flight)[-200:, :2].mean(axis=0)
        across = wind @ [-along[1], along[0]]
        true_m_s = speed_m_s * true_airspeed(LOW_M)
        through_the_air = math.sqrt(true_m_s**2 - across**2)
        held_m_s = 5e-3 * true_m_s * true_m_s / through_the_air  # what half a per cent of airspeed is along the leg
        assert velocity @ along == pytest.approx(wind @ along + through_the_air, abs=held_m_s)
        assert velocity @ [-along[1], along[0]] == pytest.approx(0.0, abs=0.15)
        off_m = flight.position_m[-200:, :2] @ [-along[1], along[0]]
        assert np.abs(off_m).max() < 2.0  # the crosstrack integral takes what is left


def test_cross_track_settles_in_a_crosswind() -> None:
    points = np.array([[600.0, 0.0, LOW_M], [600.0, 3000.0, LOW_M]])
    flight, reached_s = flown(in_wind(8.0, 0.0), points, 20.0)
    off_m = np.abs(flight.position_m[:, 0] - 600.0)
    assert off_m[(flight.t_s > reached_s[0] + 20.0)].max() < 12.0
    assert off_m[(flight.t_s > reached_s[1] - 60.0)].max() < 3.0


def test_there_and_back_takes_longer_in_the_wind() -> None:
    length_m, speed_m_s, wind_m_s = 4000.0, 20.0, 8.0
    points = np.array([[length_m, 0.0, LOW_M], [0.0, 1.0, LOW_M]])
    calm_s = flown(EXACT, points, speed_m_s)[1][-1]
    true_m_s = speed_m_s * true_airspeed(LOW_M)
    for sign in (1.0, -1.0):
        windy_s = flown(in_wind(sign * wind_m_s, 0.0), points, speed_m_s)[1][-1]
        more_s = length_m / (true_m_s + wind_m_s) + length_m / (true_m_s - wind_m_s) - 2.0 * length_m / true_m_s
        assert windy_s - calm_s == pytest.approx(more_s, abs=15.0)  # but for the turn, which the wind carries along
        assert windy_s > calm_s


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), turn=st.floats(-math.pi, math.pi), speed_m_s=st.floats(14.0, 25.0))
def test_flights_turn_with_route_and_wind(seed: int, turn: float, speed_m_s: float) -> None:
    rng = np.random.default_rng(seed)
    angles = np.cumsum(rng.uniform(-1.2, 1.2, 4))
    points = np.cumsum(500.0 * np.stack([np.cos(angles), np.sin(angles), np.zeros(4)], axis=1), axis=0)
    points[:, 2] = LOW_M + rng.uniform(0.0, 10.0, 4)
    wind = rng.uniform(-5.0, 5.0, 2)
    rotation = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    here, here_s = flown(in_wind(*wind), points, speed_m_s)
    there, there_s = flown(in_wind(*(rotation[:2, :2] @ wind)), points @ rotation.T, speed_m_s, turn)
    assert there_s == pytest.approx(here_s, abs=0.05)
    count = min(len(here.t_s), len(there.t_s))
    assert np.abs(there.position_m[:count] - here.position_m[:count] @ rotation.T).max() < 0.5


@pytest.mark.parametrize("wind_m_s", [(0.0, 0.0), (8.0, 0.0), (-5.0, 6.0)])
def test_circles_keep_their_place_in_the_wind(wind_m_s: tuple[float, float]) -> None:
    model = in_wind(*wind_m_s)
    navigator = Navigator([model], [[0.0, 0.0, LOW_M]])
    navigator.velocity_m_s[0] = [20.0, 0.0, 0.0]
    navigator.fly(Route.through([[800.0, 0.0, LOW_M]], 20.0))
    navigator.linger(60.0)
    off = navigator.linger(120.0).position_m - [800.0, 0.0, LOW_M]
    away_m = np.hypot(off[:, 0], off[:, 1])
    blown = math.hypot(*wind_m_s)
    assert away_m.min() > model.loiter_radius_m - 3.0 * blown
    assert away_m.max() < model.loiter_radius_m + 15.0 + 4.0 * blown
    assert np.linalg.norm(off[:, :2].mean(axis=0)) < 5.0 * (1.0 + blown)
    assert np.abs(off[:, 2]).max() < 3.0


@pytest.mark.parametrize("wind_m_s", [(-30.0, 0.0), (-19.9, 0.0), (-20.0, 9.0)])
def test_a_wind_that_is_too_strong_is_told(wind_m_s: tuple[float, float]) -> None:
    with pytest.raises(InfeasibleError, match=r"point 1 of 1 .* got none in a wind of"):
        flown(in_wind(*wind_m_s), np.array([[2000.0, 0.0, LOW_M]]), 18.0)


@pytest.mark.parametrize("wind_m_s", [(-30.0, 0.0), (30.0, 0.0), (0.0, 40.0)])
def test_no_wind_makes_it_lose_its_senses(wind_m_s: tuple[float, float]) -> None:
    model = in_wind(*wind_m_s)
    navigator = Navigator([model], [[0.0, 0.0, LOW_M]])
    navigator.follow(0, [[2000.0, 0.0, LOW_M]], 18.0)
    for _ in range(2000):
        navigator.step()
    assert np.all(np.isfinite(navigator.position_m))
    assert abs(navigator.position_m[0, 2] - LOW_M) < 100.0


@pytest.mark.parametrize("tailwind_m_s", [-8.0, 0.0, 8.0])
@pytest.mark.parametrize("height_m", [25.0, 60.0])
def test_a_takeoff_in_the_wind_ends_where_the_scene_expects_it(tailwind_m_s: float, height_m: float) -> None:
    model = replace(PLANE, wind_m_s=(0.0, tailwind_m_s))
    flight, _ = predict(model, [0, 0, 0], *takeoff_points(model, [0, 0, 0], [0, 900, height_m]))
    expected = replace(model, climb_rate_m_s=12.0).takeoff_distance_m(height_m, 0.0, tailwind_m_s)
    assert flight.position_m[-1, 1] == pytest.approx(expected, abs=20.0)
    assert flight.position_m[:, 2].min() == 0.0
