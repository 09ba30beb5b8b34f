"""What every flight keeps, whatever the route."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from missionplanner.motion import TICK_S, Navigator, Route, predict, scurve, state
from missionplanner.vehicle import MotionModel

COPTER = MotionModel("ardupilot", "copter", 2.5, 1.0, 2.5, 1.5, 2.0, 0.0)
PX4 = MotionModel("px4", "copter", 3.0, 4.0, 3.0, 1.5, 2.0, 0.0)
PLANE = MotionModel("ardupilot", "plane", 1.5, 1.0, 5.0, 5.0, 50.0, 60.0)


@st.composite
def routes(draw: st.DrawFn, longest_m: float = 150.0) -> np.ndarray:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 8))
    spread_m = draw(st.floats(3.0, longest_m))
    steep = draw(st.floats(0.0, 0.6))
    return np.cumsum(rng.normal(0.0, spread_m, (count, 3)) * [1.0, 1.0, steep], axis=0)


@pytest.mark.parametrize("model", [COPTER, PX4], ids=["arducopter", "px4"])
@settings(deadline=None, max_examples=60)
@given(points=routes(), speed_m_s=st.floats(1.0, 10.0))
def test_copters_keep_their_limits(model: MotionModel, points: np.ndarray, speed_m_s: float) -> None:
    navigator = Navigator([model], [[0.0, 0.0, 0.0]])
    flight, reached_s = navigator.fly(Route.through(points, speed_m_s))
    velocity = np.diff(flight.position_m, axis=0) / TICK_S
    acceleration = np.diff(velocity, axis=0) / TICK_S
    assert np.all(np.isfinite(flight.position_m))
    # controllers overshoot, recorded up to 5 %; and ArduCopter 4.5 adds up two legs in a corner, where it looks at the
    # horizontal speed alone
    over = 2.0 if model is COPTER else 1.1
    assert np.hypot(velocity[:, 0], velocity[:, 1]).max() <= 1.1 * speed_m_s + 0.15
    assert velocity[:, 2].max() <= over * model.climb_rate_m_s
    assert velocity[:, 2].min() >= -over * model.descent_rate_m_s
    if len(acceleration):
        assert np.hypot(acceleration[:, 0], acceleration[:, 1]).max() <= 5.0  # twice WPNAV_ACCEL
    assert np.all(np.diff(reached_s) >= 0.0)
    assert -1e-6 <= flight.t_s[-1] - reached_s[-1] <= 2 * TICK_S
    assert np.linalg.norm(flight.position_m[-1] - points[-1]) <= model.waypoint_radius_m + 0.8
    for _ in range(300):
        navigator.step()
    assert np.linalg.norm(navigator.position_m[0] - points[-1]) <= 1.0
    if model is COPTER:  # PX4's integrator takes longer to forget
        assert np.linalg.norm(navigator.position_m[0] - points[-1]) <= 0.05


@settings(deadline=None, max_examples=40)
@given(points=routes(), slow_m_s=st.floats(1.0, 9.0), ratio=st.floats(1.03, 1.5))
def test_faster_is_never_later(points: np.ndarray, slow_m_s: float, ratio: float) -> None:
    _, slow_s = predict(COPTER, [0, 0, 0], points, slow_m_s)
    _, fast_s = predict(COPTER, [0, 0, 0], points, slow_m_s * ratio)
    assert fast_s[-1] <= slow_s[-1] + TICK_S


@settings(deadline=None, max_examples=30)
@given(points=routes(600.0), speed_m_s=st.floats(14.0, 25.0))
def test_planes_keep_speed_climb_and_bank(points: np.ndarray, speed_m_s: float) -> None:
    navigator = Navigator([PLANE], [[0.0, 0.0, 0.0]])
    navigator.velocity_m_s[0] = [speed_m_s, 0.0, 0.0]
    flight, reached_s = navigator.fly(Route.through(points, speed_m_s))
    velocity = np.diff(flight.position_m, axis=0) / TICK_S
    speed = np.linalg.norm(velocity, axis=1)
    thin_air = (1 - 2.25577e-5 * max(flight.position_m[:, 2].max(), 0.0)) ** -2.128
    assert np.all(np.isfinite(flight.position_m))
    assert speed.max() <= 1.35 * speed_m_s * thin_air + 2.0  # faster in turns and descents, never a dive
    assert speed.min() >= 0.7 * speed_m_s
    assert np.abs(velocity[:, 2]).max() <= 2.5 * PLANE.climb_rate_m_s  # lift swings it as it rolls into turns
    assert np.all(np.diff(reached_s) >= 0.0)
    level = np.hypot(velocity[:, 0], velocity[:, 1])
    turn = np.diff(np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))) / TICK_S
    second = round(1.0 / TICK_S)
    if len(turn) >= second:
        turned = np.convolve(turn, np.ones(second) / second, "valid") * level[: len(turn) - second + 1]
        assert np.abs(turned).max() <= 9.81 * np.tan(np.radians(PLANE.plane.roll_max_deg)) * 1.05


@settings(deadline=None, max_examples=30)
@given(points=routes(), speed_m_s=st.floats(2.0, 10.0), shift=st.tuples(*[st.integers(-64, 64)] * 3))
def test_flights_do_not_depend_on_where(points: np.ndarray, speed_m_s: float, shift: tuple[int, int, int]) -> None:
    here, here_s = predict(COPTER, [0, 0, 0], points, speed_m_s)
    there, there_s = predict(COPTER, shift, points + np.array(shift, dtype=float), speed_m_s)
    assert there_s == pytest.approx(here_s, abs=1e-6)
    count = min(len(here.t_s), len(there.t_s))
    assert np.abs(there.position_m[:count] - here.position_m[:count] - np.array(shift)).max() < 1e-6


@njit
def plan(leg: np.ndarray, row: np.ndarray, speed_m_s: float) -> None:
    scurve.plan(leg, row, speed_m_s, np.inf)


@njit
def change_speed(leg: np.ndarray, row: np.ndarray, speed_m_s: float) -> None:
    scurve.change_speed(leg, row, speed_m_s, np.inf)


@njit
def along(leg: np.ndarray, t: np.ndarray) -> np.ndarray:
    motion = np.empty((len(t), 3))
    for i in range(len(t)):
        motion[i, 0], motion[i, 1], motion[i, 2] = scurve.along(leg, t[i])
    return motion


def leg_of(length_m: float, climb: float, speed_m_s: float) -> tuple[np.ndarray, np.ndarray, float]:
    row, _ = state.initial(COPTER, [0.0, 0.0, 0.0])
    leg = np.zeros(state.LEG)
    leg[state.UX : state.UX + 3] = np.array([np.sqrt(1 - climb**2), 0.0, climb]) * length_m
    plan(leg, row, speed_m_s)
    return row, leg, end_s(leg)


def end_s(leg: np.ndarray) -> float:
    return float(leg[state.SEGMENT_0 + state.SEGMENTS * state.SEGMENT + state.T])


@settings(deadline=None, max_examples=15)
@given(length_m=st.floats(0.5, 120.0), climb=st.floats(-1.0, 1.0), speed_m_s=st.floats(0.5, 10.0))
def test_a_leg_is_smooth_and_ends_exactly(length_m: float, climb: float, speed_m_s: float) -> None:
    _, leg, end = leg_of(length_m, climb, speed_m_s)
    a, v, p = along(leg, np.arange(0.0, end + 1e-3, 1e-3)).T
    assert v.max() <= leg[state.TOP] * (1 + 1e-9)
    assert np.abs(a).max() <= leg[state.ACC] * (1 + 1e-9)
    assert np.all(np.diff(p) >= -1e-9)
    assert p[0] == 0.0
    assert p[-1] == leg[state.LENGTH]
    assert np.abs(np.diff(a)).max() <= 1.0 * 1e-3 + 1e-6  # jerk
    assert np.cumsum(a)[:-1] * 1e-3 == pytest.approx(v[:-1], abs=0.02)  # integrals agree
    assert np.cumsum(v)[:-1] * 1e-3 == pytest.approx(p[:-1], abs=0.02)


@settings(deadline=None, max_examples=15)
@given(
    length_m=st.floats(20.0, 200.0),
    first_m_s=st.floats(1.0, 10.0),
    second_m_s=st.floats(1.0, 10.0),
    share=st.floats(0.01, 0.99),
)
def test_a_speed_changed_on_the_way_stays_smooth(
    length_m: float, first_m_s: float, second_m_s: float, share: float
) -> None:
    row, leg, end = leg_of(length_m, 0.0, first_m_s)
    leg[state.TIME] = share * end
    before = along(leg, leg[state.TIME : state.TIME + 1].copy())
    change_speed(leg, row, second_m_s)
    assert along(leg, leg[state.TIME : state.TIME + 1].copy()) == pytest.approx(before, abs=1e-6)
    a, v, p = along(leg, np.arange(share * end, end_s(leg) + 2e-3, 2e-3)).T
    assert np.abs(np.diff(a)).max(initial=0.0) <= 1.0 * 2e-3 + 1e-6
    assert np.abs(np.diff(p) - v[:-1] * 2e-3).max(initial=0.0) < 1e-4
    assert v.max() <= max(first_m_s, second_m_s) * (1 + 1e-9)
    assert p[-1] == leg[state.LENGTH]
