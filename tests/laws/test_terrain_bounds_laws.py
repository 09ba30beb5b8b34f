"""Bounds of the ground over tubes, against samples of an independent surface."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.kernels import TerrainArrays
from missionplanner.terrain_bounds import TOLERANCE_M, least_height, pyramid, steepest
from tests.oracles.surface import bicubic

ROWS, COLUMNS, CELL_M = 26, 31, 10.0


def terrain(seed: int, rough_m: float, shear: float) -> TerrainArrays:
    """Return rough ground whose grid is sheared, turned and slightly bent in the local frame."""
    heights = np.random.default_rng(seed).normal(0.0, rough_m, (ROWS, COLUMNS)).astype(np.float32)
    to_cell = np.zeros((2, 10))
    to_cell[0, :3] = ROWS / 2, shear * 1e4 / CELL_M, -1e4 / CELL_M
    to_cell[1, :3] = COLUMNS / 2, 1e4 / CELL_M, shear * 0.5e4 / CELL_M
    to_cell[:, 3] = shear * 400.0  # bent by 4 cm over 100 m
    return TerrainArrays(heights, to_cell)


def ground(t: TerrainArrays, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    u, v = x / 1e4, y / 1e4
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    row, column = np.moveaxis(terms @ t.to_cell[:, :6].T, -1, 0)
    return bicubic(t.height_amsl_m.astype(float), row, column)


def bound(t: TerrainArrays, corners: np.ndarray, radius_m: float, sign: float = 1.0, enough: float = math.inf) -> float:
    at = np.empty(3)
    return float(
        least_height(t, pyramid(t, 400.0), np.ascontiguousarray(corners), radius_m, sign, enough, -math.inf, at)
    )


def samples(corners: np.ndarray, radius_m: float, rng: np.random.Generator, count: int = 20_000) -> np.ndarray:
    """Return points of the tube around a triangle: in it, on its rim, and straight above and below."""
    weights = rng.dirichlet([0.6, 0.6, 0.6], count)
    ball = rng.normal(size=(count, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    ball[: count // 4] = [0.0, 0.0, -1.0]
    ball[count // 4 : count // 3] = [0.0, 0.0, 1.0]
    return weights @ corners + radius_m * ball


PLACES = st.tuples(st.floats(-95, 95), st.floats(-75, 75), st.floats(-20, 80))
TRIANGLES = st.tuples(PLACES, PLACES, PLACES)


@settings(deadline=None, max_examples=60)
@given(
    TRIANGLES, st.floats(0, 8), st.integers(0, 50), st.floats(0, 15), st.floats(-0.4, 0.4), st.sampled_from([1.0, -1.0])
)
def test_no_point_of_a_tube_is_beyond_its_bound(triangle, radius_m, seed, rough_m, shear, sign):
    t, corners = terrain(seed, rough_m, shear), np.array(triangle)
    points = samples(corners, radius_m, np.random.default_rng(seed))
    heights = sign * (points[:, 2] - ground(t, points[:, 0], points[:, 1]))
    assert bound(t, corners, radius_m, sign) <= heights.min() + 1e-6


@settings(deadline=None, max_examples=60)
@given(PLACES, PLACES, st.integers(0, 50), st.floats(0, 15), st.floats(-0.4, 0.4))
def test_the_bound_of_a_thin_leg_is_met_somewhere_on_it(start, end, seed, rough_m, shear):
    t, corners = terrain(seed, rough_m, shear), np.array([start, end, start])
    share = np.linspace(0.0, 1.0, 20_001)[:, None]
    line = corners[0] + share * (corners[1] - corners[0])
    least = (line[:, 2] - ground(t, line[:, 0], line[:, 1])).min()
    # pieces of 2 m are not divided further: over noise of 10 m cells, slopes change that much within one
    assert least - TOLERANCE_M - 0.2 * rough_m <= bound(t, corners, 0.0) <= least + 1e-6


@settings(deadline=None, max_examples=40)
@given(TRIANGLES, st.floats(0, 8), st.integers(0, 50), st.floats(0.1, 15), st.floats(-60, 60))
def test_enough_is_said_only_when_it_is(triangle, radius_m, seed, rough_m, enough):
    t, corners = terrain(seed, rough_m, 0.1), np.array(triangle)
    if bound(t, corners, radius_m, enough=enough) >= enough:
        points = samples(corners, radius_m, np.random.default_rng(seed))
        assert (points[:, 2] - ground(t, points[:, 0], points[:, 1])).min() >= enough - 1e-6


@settings(deadline=None, max_examples=40)
@given(PLACES, PLACES, st.floats(0, 5), st.integers(0, ROWS - 1), st.integers(0, COLUMNS - 1))
def test_nothing_is_proven_where_the_ground_may_be_missing(start, end, radius_m, row, column):
    t = terrain(3, 5.0, 0.0)
    t.height_amsl_m[row, column] = np.nan
    corners = np.array([start, end, start])
    points = samples(corners, radius_m, np.random.default_rng(1))
    missing = np.isnan(ground(t, points[:, 0], points[:, 1])).any()
    if missing:
        assert bound(t, corners, radius_m) == -math.inf


@settings(deadline=None, max_examples=60)
@given(PLACES, st.floats(0.1, 15), st.integers(0, 50), st.floats(0.1, 10), st.floats(-0.4, 0.4))
def test_no_ground_nearby_is_steeper_than_its_bound(place, radius_m, seed, rough_m, shear):
    t = terrain(seed, rough_m, shear)
    rng = np.random.default_rng(seed)
    away = rng.normal(size=(4000, 2))
    away *= (radius_m * np.sqrt(rng.random(4000)) / np.linalg.norm(away, axis=1))[:, None]
    x, y = place[0] + away[:, 0], place[1] + away[:, 1]
    e = 1e-3
    gx = (ground(t, x + e, y) - ground(t, x - e, y)) / (2 * e)
    gy = (ground(t, x, y + e) - ground(t, x, y - e)) / (2 * e)
    limit = steepest(t, place[0], place[1], radius_m)
    slopes = np.hypot(gx, gy)
    assert np.isinf(limit) or slopes.max() <= limit + 1e-4
