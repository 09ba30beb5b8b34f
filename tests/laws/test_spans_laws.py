"""Catenaries against the differential equation that they solve, and distances from them against dense points."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from missionplanner.spans import CHORD_ERROR_M, Catenary, Conductor, catenary, conductor_distance_m

laws = settings(deadline=None, max_examples=60)

place = st.floats(-500.0, 500.0)


@st.composite
def hung(draw) -> Catenary:
    """Level and steep, tight and slack: as slack as any line may be."""
    start = np.array([draw(place), draw(place), draw(st.floats(-100.0, 2000.0))])
    heading, length_m = draw(st.floats(0.0, math.tau)), draw(st.floats(5.0, 3000.0))
    rise = draw(st.floats(-1.5, 1.5)) * length_m
    end = start + np.array([length_m * math.cos(heading), length_m * math.sin(heading), rise])
    found = Catenary(start, end, length_m * 10.0 ** draw(st.floats(-0.6, 4.0)))
    assert not found.is_slack
    return found


def integrated(curve: Catenary, u: np.ndarray) -> np.ndarray:
    """Return heights above the start: a z'' = sqrt(1 + z'^2), shot at the other end."""
    a, length_m, rise = curve.constant_m, curve.length_m, curve.end_m[2] - curve.start_m[2]

    def shot(slope: float, at: np.ndarray) -> np.ndarray:
        found = solve_ivp(
            lambda _, y: [y[1], math.hypot(1.0, y[1]) / a],
            (0.0, length_m),
            [0.0, slope],
            t_eval=at,
            rtol=1e-10,
            atol=1e-10 * length_m,
            method="DOP853",
        )
        return found.y[0]

    sag = rise / length_m
    slope = brentq(
        lambda s: shot(s, np.array([length_m]))[-1] - rise, sag - 10.0 - 0.6 * length_m / a, sag + 10.0, xtol=1e-12
    )
    return shot(slope, u)


@settings(deadline=None, max_examples=25)
@given(hung())
def test_it_is_what_a_hanging_rope_integrates_to(curve):
    share = np.linspace(0.0, 1.0, 9)
    expected = integrated(curve, share * curve.length_m)
    got = curve.at(share)[:, 2] - curve.start_m[2]
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6 * curve.length_m)


@laws
@given(hung())
def test_it_passes_both_ends_in_their_plane_and_below_their_chord(curve):
    points = curve.at(np.linspace(0.0, 1.0, 101))
    scale = 1e-9 * (1.0 + abs(curve.start_m).max() + curve.length_m)
    np.testing.assert_allclose(points[[0, -1]], [curve.start_m, curve.end_m], rtol=0, atol=10 * scale)
    straight = curve.start_m + np.linspace(0.0, 1.0, 101)[:, None] * (curve.end_m - curve.start_m)
    np.testing.assert_allclose(points[:, :2], straight[:, :2], rtol=0, atol=scale)
    assert (points[:, 2] <= straight[:, 2] + 10 * scale).all()


@laws
@given(hung(), st.floats(0.05, 5.0))
def test_chords_lie_above_it_by_no_more_than_asked_and_are_not_many(curve, error_m):
    chords = curve.chords_m(error_m)
    share = np.linspace(0.0, 1.0, 40 * (len(chords) - 1) + 1)
    over = np.interp(share, np.linspace(0.0, 1.0, len(chords)), chords[:, 2]) - curve.at(share)[:, 2]
    scale = 1e-8 * (1.0 + abs(curve.start_m[2]) + curve.length_m)
    assert over.min() >= -scale
    assert over.max() <= error_m + scale
    if len(chords) > 2:  # with three quarters of the pieces it would not do, where it is bent evenly
        gentle = curve.length_m < 0.2 * curve.constant_m and abs(curve.end_m[2] - curve.start_m[2]) < curve.length_m
        assert not gentle or over.max() > 0.2 * error_m


@laws
@given(hung(), st.integers(0, 2**32 - 1))
def test_distances_are_those_to_the_nearest_of_many_points(curve, seed):
    rng = np.random.default_rng(seed)
    reach_m = min(0.4 * curve.constant_m, 200.0)  # nearer than it is bent
    points = curve.at(rng.random(30)) + rng.normal(size=(30, 3)) * reach_m / 3.0
    dense = curve.at(np.linspace(0.0, 1.0, 20_001))
    expected = np.array([np.linalg.norm(dense - point, axis=1).min() for point in points])
    half_step = 0.5 * np.linalg.norm(np.diff(dense, axis=0), axis=1).max()
    got = curve.distance_m(points)
    assert (got <= expected + 1e-6 * (1.0 + curve.length_m)).all()
    assert (got >= np.sqrt(np.maximum(expected**2 - half_step**2, 0.0)) - half_step).all()


@laws
@given(st.lists(hung(), max_size=4), st.integers(0, 2**32 - 1))
def test_the_nearest_of_several_conductors_counts(curves, seed):
    rng = np.random.default_rng(seed)
    conductors = [Conductor("c", curve, rng.uniform(0.5, 8.0)) for curve in curves]
    points = rng.uniform([-600.0, -600.0, -100.0], [600.0, 600.0, 1000.0], (50, 3))
    expected = [c.catenary.distance_m(points) - c.radius_m for c in conductors]
    got = conductor_distance_m(conductors, points)
    np.testing.assert_allclose(got, np.min(expected, axis=0) if expected else np.inf, rtol=0, atol=1e-6)


def test_a_tight_one_is_straight_and_a_level_one_sags_by_the_textbook():
    start, end = np.array([10.0, 20.0, 500.0]), np.array([310.0, 420.0, 640.0])
    middle = Catenary(start, end, 1e9).at(np.array(0.5))
    np.testing.assert_allclose(middle, 0.5 * (start + end), atol=1e-4)
    level = Catenary(np.zeros(3), np.array([400.0, 0.0, 0.0]), 2000.0)
    assert level.at(np.array(0.5))[2] == pytest.approx(-2000.0 * (math.cosh(0.1) - 1.0), abs=1e-9)
    assert len(level.chords_m()) == 1 + math.ceil(400.0 / math.sqrt(8.0 * 2000.0 * CHORD_ERROR_M / math.cosh(0.1)))


def test_the_low_point_of_a_steep_span_lies_beyond_its_lower_end():
    steep = Catenary(np.zeros(3), np.array([300.0, 0.0, 200.0]), 2000.0)
    heights = steep.at(np.linspace(0.0, 1.0, 301))[:, 2]
    assert (np.diff(heights) > 0.0).all()
    assert heights[150] < 100.0 - 5.0


def test_what_nobody_measured_is_taken_to_be_tight():
    def sag_m(length_m: float, constant_m: float | None) -> float:
        hung = catenary(np.zeros(3), np.array([length_m, 0.0, 0.0]), constant_m)
        return -float(hung.at(np.array(0.5))[2])

    assert sag_m(300.0, None) == sag_m(300.0, 2000.0) == pytest.approx(5.6, abs=0.1)
    assert sag_m(2656.0, None) == pytest.approx(15.0, abs=0.1)
    assert sag_m(2656.0, 2000.0) > 400.0
