"""Splines as ArduCopter flies them: along the curve that is proven, within its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from scipy.spatial import cKDTree

from missionplanner.motion import TICK_S, Navigator, Route, curve, predict, state
from missionplanner.motion.spline import chords, hermite_bezier, spline_chords
from missionplanner.sortie import Leg, Sortie
from missionplanner.vehicle import MotionModel

COPTER = MotionModel("ardupilot", "copter", 2.5, 1.0, 2.5, 1.5, 2.0, 0.0)
HOME = np.array([0.0, 0.0, 80.0])
TOP = np.array([0.0, 0.0, 100.0])


@njit
def place(row: np.ndarray, leg: np.ndarray, t: np.ndarray) -> np.ndarray:
    curve.plan(leg, row, 5.0, np.inf)
    places = np.empty((len(t), 3))
    for i in range(len(t)):
        for axis in range(3):
            places[i, axis] = curve.along(leg, t[i], axis)[0]
    return places


@st.composite
def missions(draw: st.DrawFn, *, gentle: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Waypoints, which of them are flown to along splines, and holds."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 7))
    spread_m = draw(st.floats(8.0, 120.0))
    if gentle:  # no hairpins: a real vehicle leaves them, as it does not slow down before they begin
        course = np.cumsum(rng.uniform(-0.8, 0.8, count))
        steps = rng.uniform(40.0, 150.0, count)[:, None] * np.stack([np.cos(course), np.sin(course), 0.0 * course], 1)
        points = TOP + np.cumsum(steps + rng.normal(0.0, 3.0, (count, 3)), axis=0)
    else:
        points = TOP + np.cumsum(rng.normal(0.0, spread_m, (count, 3)) * [1.0, 1.0, 0.15], axis=0)
    share = draw(st.sampled_from([0.3, 0.7, 1.0]))
    return points, rng.random(count) < share, np.where(rng.random(count) < 0.2, 1.0, 0.0)


def sortie_of(points: np.ndarray, spline: np.ndarray, hold_s: np.ndarray, speed_m_s: float) -> Sortie:
    ends = zip(points, spline, hold_s, strict=True)
    legs = [Leg(2 + k, "spline" if s else "straight", p, speed_m_s, float(h)) for k, (p, s, h) in enumerate(ends)]
    return Sortie(
        name="alpha",
        sysid=1,
        autopilot="ardupilot",
        vehicle_class="copter",
        home_m=HOME,
        legs=(Leg(1, "takeoff", TOP, speed_m_s), *legs),
        start_delay_s=0.0,
        ending="loiter",
        ending_seq=len(legs) + 1,
        return_height_m=15.0,
    )


def proven_curve(sortie: Sortie) -> np.ndarray:
    lines = []
    for k in range(1, len(sortie.legs)):
        ends = np.array([sortie.legs[k - 1].end_m, sortie.legs[k].end_m])
        line = spline_chords(sortie, k, 0.01) if sortie.legs[k].kind == "spline" else ends
        parts = np.maximum(1, np.ceil(np.linalg.norm(np.diff(line, axis=0), axis=1) / 0.1)).astype(int)
        for a, b, n in zip(line[:-1], line[1:], parts, strict=True):
            lines.append(a + np.linspace(0.0, 1.0, n + 1)[:, None] * (b - a))
    return np.concatenate(lines)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), long=st.floats(0.0, 6.0))
def test_the_curve_is_the_one_that_is_proven(seed: int, long: float) -> None:
    rng = np.random.default_rng(seed)
    start, end = rng.normal(0.0, 80.0, (2, 3))
    departure, arrival = rng.normal(0.0, 30.0 * long, (2, 3))
    row, _ = state.initial(COPTER, start)
    leg = np.zeros(state.LEG)
    leg[state.HERMITE : state.HERMITE + 3] = end - start
    leg[state.HERMITE + 3 : state.HERMITE + 6] = departure
    leg[state.ARRIVAL : state.ARRIVAL + 3] = arrival
    bezier = hermite_bezier(start, end, departure, arrival)
    expected = chords(bezier, 1e-3)
    t = np.linspace(0.0, 1.0, len(expected))
    assert start + place(row, leg, t) == pytest.approx(expected, abs=1e-9)


@settings(deadline=None, max_examples=60)
@given(mission=missions(gentle=True), speed_m_s=st.floats(2.0, 10.0))
def test_flown_splines_stay_with_their_curve_and_their_limits(
    mission: tuple[np.ndarray, np.ndarray, np.ndarray], speed_m_s: float
) -> None:
    points, spline, hold_s = mission
    flight, _ = predict(COPTER, TOP, points, speed_m_s, hold_s, spline=spline)
    off_m, _ = cKDTree(proven_curve(sortie_of(points, spline, hold_s, speed_m_s))).query(flight.position_m)
    assert off_m.max() <= COPTER.waypoint_radius_m + 0.5
    velocity = np.diff(flight.position_m, axis=0) / TICK_S
    assert np.hypot(velocity[:, 0], velocity[:, 1]).max() <= 1.15 * speed_m_s + 0.2


@settings(deadline=None, max_examples=60)
@given(mission=missions(gentle=False), speed_m_s=st.floats(2.0, 10.0))
def test_every_spline_is_flown_to_its_end(mission: tuple[np.ndarray, np.ndarray, np.ndarray], speed_m_s: float) -> None:
    points, spline, hold_s = mission
    navigator = Navigator([COPTER], [TOP])
    flight, reached_s = navigator.fly(Route.through(points, speed_m_s, hold_s, spline=spline))
    assert np.all(np.diff(reached_s) > 0.0)
    for k, at_s in enumerate(reached_s):
        assert np.linalg.norm(flight.at(at_s) - points[k]) <= 15.0  # in hairpins it is far behind its target
    assert np.linalg.norm(navigator.linger(20.0).position_m[-1] - points[-1]) <= 0.3


@settings(deadline=None, max_examples=20)
@given(mission=missions(gentle=True), speed_m_s=st.floats(2.0, 10.0))
def test_prediction_of_splines_is_bitwise_the_navigator(
    mission: tuple[np.ndarray, np.ndarray, np.ndarray], speed_m_s: float
) -> None:
    points, spline, hold_s = mission
    flight, reached_s = predict(COPTER, TOP, points, speed_m_s, hold_s, spline=spline)
    navigator = Navigator([COPTER, COPTER], [HOME, TOP])
    navigator.follow(1, *Route.through(points, speed_m_s, hold_s, spline=spline))
    flown = []
    for _ in range(len(flight.t_s) - 1):
        navigator.step()
        flown.append(navigator.position_m[1].copy())
    assert np.array_equal(flown, flight.position_m[1:])
    assert np.array_equal(navigator.reached_s[1, : len(points)], reached_s)


@settings(deadline=None, max_examples=20)
@given(mission=missions(gentle=True), slower_m_s=st.floats(1.0, 4.0), after_s=st.floats(1.0, 60.0))
def test_a_speed_told_on_the_way_and_a_halt_keep_to_the_curve(
    mission: tuple[np.ndarray, np.ndarray, np.ndarray], slower_m_s: float, after_s: float
) -> None:
    points, spline, hold_s = mission
    navigator = Navigator([COPTER], [TOP])
    navigator.follow(0, *Route.through(points, 8.0, hold_s, spline=spline))
    flown = []
    for tick in range(60_000):
        if tick == int(after_s / TICK_S):
            navigator.set_speed(0, slower_m_s)
        if tick == int((after_s + 10.0) / TICK_S):
            navigator.halt(0)
        if tick == int((after_s + 25.0) / TICK_S):
            assert np.linalg.norm(navigator.velocity_m_s[0]) < 0.3
            navigator.resume(0)
        navigator.step()
        flown.append(navigator.position_m[0].copy())
        if navigator.finished[0]:
            break
    assert navigator.finished[0]
    off_m, _ = cKDTree(proven_curve(sortie_of(points, spline, hold_s, 8.0))).query(np.array(flown))
    assert off_m.max() <= COPTER.waypoint_radius_m + 1.0  # suddenly slower, it overshoots
