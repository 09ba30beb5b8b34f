"""Derivatives of the price against central differences: everywhere but at kinks, which random paths all but miss."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from missionplanner import kernels
from missionplanner.cost import TERMS, Price
from missionplanner.kernels import SpaceArrays, TerrainArrays, obstacle_distance
from missionplanner.mission import Weights
from missionplanner.obstacles import pack
from missionplanner.path import basis, evenly, leg_lengths_m, uniform_knots
from missionplanner.price_gradient import ground_slope, inside_slope, obstacle_slope
from missionplanner.scene import Towers
from tests.benchmarks.price_kernel import LIMITS, mountain_terrain
from tests.laws.test_kernels_laws import FLAT, point, solid, star

laws = settings(deadline=None, max_examples=60)

TIGHT = replace(
    LIMITS,
    terrain_margin_m=30.0,
    obstacle_margin_m=12.0,
    height_agl_max_m=90.0,
    climb_angle_rad=0.3,
    descent_angle_rad=0.2,
    turn_radius_m=60.0,
    turn_angle_rad=1.0,
)
_RNG = np.random.default_rng(5)
HILLS = mountain_terrain(_RNG, cells=64, cell_m=60.0)
HILLS = TerrainArrays(
    (HILLS.height_amsl_m - HILLS.height_amsl_m.mean()).astype(np.float32) * np.float32(0.3), HILLS.to_cell
)
HILLS.to_cell[0, 4] = 3.0  # the way to the cells is curved
STEP_M = 1e-4

curve = (
    st.lists(point, min_size=3, max_size=6)
    .map(lambda points: basis(uniform_knots(len(points)), np.linspace(0.0, 1.0, 30)) @ np.array(points) * [1, 1, 0.5])
    .filter(lambda path: leg_lengths_m(path).min() > 1.0)
)
direction = st.integers(0, 2**32 - 1)


def off_kinks(points, seed):
    """Hypothesis loves round numbers, and there the kinks are."""
    return np.array(points, dtype=float) + np.random.default_rng(seed).normal(0.0, 0.2, np.shape(points))


def turns_back(path):
    """Whether a path turns by nearly half a turn, or has a leg of nearly no level length: there the turn has a kink."""
    level = np.diff(path[:, :2], axis=0)
    length = np.linalg.norm(level, axis=1)
    along = (level[:-1] * level[1:]).sum(axis=1)
    return length.min() < 0.1 or bool((along < -0.9 * length[:-1] * length[1:]).any())


def price_of(solids, fence, hilly, seed):
    rng = np.random.default_rng(seed)
    outline = np.empty((0, 2)) if fence is None else fence
    space = SpaceArrays(
        HILLS if hilly else FLAT, pack(solids).arrays, outline, 70.0, np.array([-900.0, -900.0, 900.0, 900.0])
    )
    tops = rng.uniform(-300.0, 300.0, (3, 3))
    towers = Towers(("a", "b", "c"), tops, np.full(3, 35.0), np.array([1.0, 0.5, 2.0]), 40.0, 1.0)
    fellows = np.stack([evenly(np.cumsum(rng.normal(0.0, 60.0, (6, 3)), axis=0), 40) for _ in range(2)])
    return Price(space, TIGHT, 400.0, Weights(atmosphere=1.0), towers, fellows, 60.0)


def central(function, paths, move):
    return (function(paths + STEP_M * move) - function(paths - STEP_M * move)) / (2.0 * STEP_M)


@laws
@given(st.lists(solid, max_size=4), st.one_of(st.none(), star()), curve, st.booleans(), direction)
def test_the_price_is_the_kernels_and_its_slope_that_of_central_differences(solids, fence, path, hilly, seed):
    price = price_of(solids, fence, hilly, seed)
    rng = np.random.default_rng(seed)
    path = off_kinks(path, seed)
    assume(not turns_back(path))
    total, _ = price.slopes(path[np.newaxis])
    np.testing.assert_allclose(total, price.total(path[np.newaxis]), rtol=1e-12)
    moves = rng.normal(size=(8, *path.shape))
    for column, name in enumerate(TERMS):
        price.weights[:] = 0.0
        price.weights[column] = 1.0
        _, slope = price.slopes(path[np.newaxis])
        exact = (slope * moves).sum(axis=(1, 2))
        differences = np.array([central(price.total, path[np.newaxis], move)[0] for move in moves])
        # at a kink within the step, or a jump, a difference means nothing: most of eight directions must agree
        close = np.isclose(differences, exact, rtol=2e-4, atol=1e-6 * max(1.0, np.abs(slope).max()))
        assert close.sum() >= 6, (name, exact, differences)


@laws
@given(solid, point, direction)
def test_solids_slope_as_their_distances_do_by_one(one, at, seed):
    o = pack([one]).arrays
    at = off_kinks(at, seed)
    d, *slope = obstacle_slope(o, 0, *at)
    assert math.isclose(d, obstacle_distance(o, 0, *at), rel_tol=1e-12, abs_tol=1e-9)
    sides = [[obstacle_distance(o, 0, *(at + sign * STEP_M * axis)) for sign in (1.0, -1.0)] for axis in np.eye(3)]
    differences = np.array([(a - b) / (2.0 * STEP_M) for a, b in sides])
    assume(max(abs(a + b - 2.0 * d) for a, b in sides) < 1e-3 * STEP_M)  # no kink here
    np.testing.assert_allclose(slope, differences, atol=2e-3)
    assert math.isclose(math.hypot(*slope), 1.0, abs_tol=1e-9)


@laws
@given(star(), point, direction)
def test_the_fence_slopes_as_its_distance(fence, at, seed):
    space = SpaceArrays(FLAT, pack([]).arrays, fence, 60.0, np.array([-900.0, -900.0, 900.0, 900.0]))
    at = off_kinks(at, seed)
    d, *slope = inside_slope(space, *at)
    assert math.isclose(d, kernels.inside_distance(space, *at), rel_tol=1e-12, abs_tol=1e-9)
    sides = [
        [kernels.inside_distance(space, *(at + sign * STEP_M * axis)) for sign in (1.0, -1.0)] for axis in np.eye(3)
    ]
    assume(max(abs(a + b - 2.0 * d) for a, b in sides) < 1e-3 * STEP_M)
    np.testing.assert_allclose(slope, [(a - b) / (2.0 * STEP_M) for a, b in sides], atol=2e-3)


@laws
@given(st.floats(-1500.0, 1500.0), st.floats(-1500.0, 1500.0))
def test_the_ground_slopes_as_its_heights(x, y):
    height, *slope = ground_slope(HILLS, x, y)
    assert height == kernels.terrain_height(HILLS, x, y) or abs(height - kernels.terrain_height(HILLS, x, y)) < 1e-9
    for axis, value in enumerate(slope):
        e = np.eye(2)[axis] * 1e-3
        ahead, behind = (kernels.terrain_height(HILLS, x + s * e[0], y + s * e[1]) for s in (1.0, -1.0))
        assert math.isclose((ahead - behind) / 2e-3, value, rel_tol=1e-5, abs_tol=1e-6)


def test_where_terrain_is_missing_the_slope_leads_back_to_it():
    price = price_of([], None, True, 0)
    price.weights[:] = 0.0
    price.weights[TERMS.index("terrain")] = 1.0
    path = np.linspace((2500.0, 2600.0, 50.0), (2500.0, 2900.0, 50.0), 12)[np.newaxis]
    _, slope = price.slopes(path)
    move = np.random.default_rng(1).normal(size=path.shape)
    np.testing.assert_allclose(central(price.total, path, move)[0], (slope * move).sum(), rtol=1e-4)
    assert price.total(path - 1.0 * slope / np.abs(slope).max())[0] < price.total(path)[0]
