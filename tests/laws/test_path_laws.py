from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner import path

laws = settings(deadline=None, max_examples=60)

seeds = st.integers(0, 2**32 - 1)
T = np.linspace(0.0, 1.0, 301)


def control(seed, points):
    rng = np.random.default_rng(seed)
    knots = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 1.0, points - 1))])
    return knots / knots[-1], rng.uniform(-500.0, 500.0, (points, 3))


@laws
@given(seeds, st.integers(2, 12))
def test_moving_and_turning_the_control_points_moves_and_turns_the_curve(seed, points):
    knots, at = control(seed, points)
    matrix = path.basis(knots, T)
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    np.testing.assert_allclose(matrix @ (at @ turn + [1.0, 2.0, 3.0]), matrix @ at @ turn + [1.0, 2.0, 3.0], atol=1e-8)


@laws
@given(seeds, st.integers(3, 10))
def test_of_all_curves_through_the_points_the_natural_spline_bends_least(seed, points):
    """Holladay's theorem, against the spline pulled aside between its control points."""
    knots, at = control(seed, points)

    def bending(curve):
        return np.sum(np.diff(curve, 2, axis=0) ** 2)

    fine = np.linspace(0.0, 1.0, 2001)
    curve = path.basis(knots, fine) @ at
    bump = np.prod([fine - knot for knot in knots], axis=0)[:, None]  # vanishes at every control point
    bump = bump / np.abs(bump).max() * np.random.default_rng(seed).normal(0.0, 20.0, 3)
    assert bending(curve) <= bending(curve + bump) * (1 + 1e-3)


@laws
@given(seeds, st.integers(2, 10), st.integers(2, 60))
def test_resampling_evenly_keeps_ends_and_never_lengthens(seed, points, count):
    _, at = control(seed, points)
    even = path.evenly(at, count)
    np.testing.assert_allclose(even[[0, -1]], at[[0, -1]], atol=1e-9)
    assert path.length_m(even) <= path.length_m(at) + 1e-9


@laws
@given(seeds, st.integers(3, 10))
def test_turns_and_climbs_are_the_same_flown_backwards(seed, points):
    _, at = control(seed, points)
    np.testing.assert_allclose(path.turn_angle_rad(at[::-1])[::-1], path.turn_angle_rad(at), atol=1e-9)
    np.testing.assert_allclose(path.climb_angle_rad(at[::-1])[::-1], -path.climb_angle_rad(at), atol=1e-9)
    radius = path.turn_radius_m(at)
    np.testing.assert_allclose(path.turn_radius_m(at * 3.0), radius * 3.0, rtol=1e-6)
    assert (radius > 0.0).all()
    assert (path.turn_angle_rad(at) <= math.pi).all()
