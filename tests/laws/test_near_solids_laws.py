"""Law: what the index of solids finds is what asking every solid finds."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner import kernels
from missionplanner.clearance import Margins, legs_clear
from missionplanner.cost import Price
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import ObstacleArrays, ObstacleGrid, SpaceArrays, TerrainArrays
from missionplanner.mission import Weights
from missionplanner.obstacles import (
    CableSolid,
    ConeSolid,
    CurtainSolid,
    CylinderSolid,
    PrismSolid,
    Solid,
    SphereSolid,
    pack,
)
from tests.limits import limits

LIMITS = limits(terrain_margin_m=18.0, obstacle_margin_m=8.0, height_agl_max_m=400.0)


def solids(rng: np.random.Generator, count: int, size_m: float, *, bent: bool) -> ObstacleArrays:
    """Return solids of all kinds, some of them large or huge; ``bent``: prisms that are not convex among them."""
    found: list[Solid] = []
    huge = int(rng.integers(0, 74))
    for i, (x, y) in enumerate(rng.uniform(-size_m, size_m, (count, 2))):
        radius, top, name = (
            rng.uniform(1.0, 40.0) * (10.0 if rng.random() < 0.03 else 1.0) * (1e3 if i % 37 == huge else 1.0),
            rng.uniform(20, 250),
            f"o{i}",
        )
        match int(rng.integers(0, 6)):
            case 0:
                found.append(CylinderSolid(name, x, y, radius, top))
            case 1:
                found.append(ConeSolid(name, x, y, radius, 0.0, top))
            case 2:
                found.append(SphereSolid(name, x, y, top, radius, "radar", hard=bool(rng.random() < 0.5)))
            case 3:
                found.append(SphereSolid(name, x, y, top, radius, "marine"))
            case 4:
                angle = np.arange(5) * math.tau / 5
                reach = radius * np.where(np.arange(5) == 0, 0.2 if bent else 1.0, 1.0)
                found.append(
                    PrismSolid(name, np.stack([x + reach * np.cos(angle), y + reach * np.sin(angle)], 1), 0.0, top)
                )
            case _:
                start = np.array([x, y, top])
                hung = CableSolid if int(rng.integers(0, 2)) else CurtainSolid
                found.append(hung(name, start, start + rng.uniform(-150.0, 150.0, 3) * [1, 1, 0.1], 1.0))
    return pack(found).arrays


def every(o: ObstacleArrays) -> ObstacleArrays:
    """Return the same solids without index: one square of which all are."""
    count = len(o.kind)
    start, solid = np.array([[0, count]], dtype=np.int32), np.arange(count, dtype=np.int32)
    span, none = np.zeros((count, 4), dtype=np.int32), np.zeros(0, dtype=np.int32)
    return o._replace(grid=ObstacleGrid(0.0, 0.0, 1.0, start, solid, span, none))


def space(o: ObstacleArrays) -> SpaceArrays:
    to_cell = np.zeros((2, 10))
    to_cell[:, 0], to_cell[0, 2], to_cell[1, 1] = 60.0, -100.0, 100.0
    terrain = TerrainArrays(np.zeros((121, 121), dtype=np.float32), to_cell)
    return SpaceArrays(terrain, o, np.empty((0, 2)), math.inf, np.array([-5e3, -5e3, 5e3, 5e3]))


def legs(rng: np.random.Generator, size_m: float) -> FloatArray:
    """Return short and long legs, inside and beside the field, some of them along its squares or points."""
    a = np.column_stack([rng.uniform(-1.5 * size_m, 1.5 * size_m, (90, 2)), rng.uniform(0.0, 300.0, 90)])
    far = rng.uniform(-1.0, 1.0, (90, 3)) * np.where(np.arange(90) % 3 == 0, size_m, 50.0)[:, np.newaxis]
    far[::9, 0] = 0.0
    far[1::9, 1] = 0.0
    far[2::9] = 0.0
    return np.stack([a, a + far * [1.0, 1.0, 0.1]], axis=1)


worlds = settings(max_examples=25, deadline=None)
counts = st.sampled_from([0, 1, 15, 16, 40, 200])
sizes = st.sampled_from([5.0, 300.0, 2000.0])
seeds = st.integers(0, 2**32 - 1)


@worlds
@given(seeds, counts, sizes)
def test_the_nearest_solid_is_the_least_of_all_distances(seed: int, count: int, size_m: float) -> None:
    rng = np.random.default_rng(seed)
    o = solids(rng, count, size_m, bent=True)
    points = np.column_stack([rng.uniform(-2.0 * size_m, 2.0 * size_m, (60, 2)), rng.uniform(-50.0, 300.0, 60)])
    least = kernels.obstacle_distances(o, points)[:, o.hard].min(axis=1, initial=math.inf)
    for point, expected in zip(points, least, strict=True):
        for enough in (1e12, 30.0, -2.0):
            assert kernels.nearest_hard(o, *point, enough) == min(expected, enough)


@worlds
@given(seeds, counts, sizes)
def test_legs_keep_from_the_same_solids(seed: int, count: int, size_m: float) -> None:
    rng = np.random.default_rng(seed)
    for bent in (False, True):
        o = solids(rng, count, size_m, bent=bent)
        tested = legs(rng, size_m)
        near, all_ = (kernels.legs_clearance(space(p), tested, math.inf) for p in (o, every(o)))
        if bent:  # bounds of prisms that are not convex depend a little on what was found before them
            np.testing.assert_allclose(near[:, kernels.OBSTACLE], all_[:, kernels.OBSTACLE], rtol=0.02, atol=0.06)
        else:
            other = near[:, kernels.OBSTACLE_INDEX] != all_[:, kernels.OBSTACLE_INDEX]
            for row, leg in zip(near[other], tested[other], strict=True):  # only if both are as near, to the last bit
                only = o._replace(hard=np.arange(count) == row[kernels.OBSTACLE_INDEX])
                [alone] = kernels.legs_clearance(space(every(only)), leg[np.newaxis], math.inf)
                np.testing.assert_array_equal(row, alone)
            for column in (kernels.OBSTACLE_AT, kernels.OBSTACLE_INDEX):
                near[other, column] = all_[other, column]
            np.testing.assert_array_equal(near, all_)
        clear, expected = (legs_clear(space(p), Margins.of(LIMITS), tested, math.inf) for p in (o, every(o)))
        np.testing.assert_array_equal(clear, expected)


@worlds
@given(seeds, counts, sizes)
def test_paths_cost_the_same_bit_for_bit(seed: int, count: int, size_m: float) -> None:
    rng = np.random.default_rng(seed)
    o = solids(rng, count, size_m, bent=True)
    steps = rng.normal(0.0, size_m / 25.0, (12, 61, 3)) * [1.0, 1.0, 0.02]
    paths = rng.uniform(-size_m, size_m, (12, 1, 3)) * [1.0, 1.0, 0.0] + [0.0, 0.0, 80.0] + steps.cumsum(axis=1)
    near, all_ = (Price(space(p), LIMITS, size_m, Weights()).terms(paths) for p in (o, every(o)))
    for (name, got), (_, expected) in zip(near.items(), all_.items(), strict=True):
        np.testing.assert_array_equal(got, expected, err_msg=name)


@worlds
@given(seeds, counts, sizes)
def test_solids_near_boxes_are_listed_once_and_in_order(seed: int, count: int, size_m: float) -> None:
    rng = np.random.default_rng(seed)
    o = solids(rng, count, size_m, bent=True)
    low = rng.uniform(-size_m, size_m, (5, 3))
    boxes = np.concatenate([low, low + rng.uniform(0.0, 0.2 * size_m, (5, 3))], axis=1)
    listed = np.zeros((2, count), dtype=np.int64)
    found = listed[0, : kernels.solids_near(o, boxes, 10.0, listed)].tolist()
    assert found == sorted(set(found))
    assert not listed[1].any()
    middle = o.bound[:, np.newaxis, :2]
    apart = np.maximum(np.maximum(boxes[:, :2] - middle, middle - boxes[:, 3:5]), 0.0)
    needed = (np.hypot(*apart.transpose(2, 0, 1)) < o.bound[:, 2:3] + 10.0).any(axis=1)
    assert set(np.flatnonzero(needed).tolist()) <= set(found)
    assert len(o.grid.solid) <= max(count, 8 * count)


def test_squares_suit_the_many_beside_a_few_that_are_huge() -> None:
    trees = [CylinderSolid("tree", 10.0 * (i % 40), 10.0 * (i // 40), 1.0) for i in range(1000)]
    zones = [CylinderSolid("zone", x, 0.0, 5e4) for x in (6e4, -6e4)]
    plain, beside = pack(trees).arrays.grid, pack([zones[0], *trees, zones[1]]).arrays.grid
    assert beside.large.tolist() == [0, 1001]
    assert plain.large.size == 0
    assert (beside.cell_m, len(beside.solid)) == (plain.cell_m, len(plain.solid))


@worlds
@given(seeds, st.integers(1, 30))
def test_fellows_count_as_if_each_were_asked(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    o = pack([]).arrays
    s = np.linspace(0.0, 1.0, 61)[:, np.newaxis]
    way = np.array([-900.0, 0.0, 60.0]) + s * [1800.0, 0.0, 20.0]
    paths = way + rng.normal(0.0, 60.0, (6, 1, 3)) * np.sin(math.pi * s)
    fellows = (
        way[::2] + rng.normal(0.0, 80.0, (count, 1, 3)) * np.cos(math.pi * s[::2]) + rng.normal(0, 40, (count, 1, 3))
    )
    together = Price(space(o), LIMITS, 1800.0, Weights(), fellows=fellows, separation_m=40.0).terms(paths).fellows
    each = [
        Price(space(o), LIMITS, 1800.0, Weights(), fellows=one[np.newaxis], separation_m=40.0).terms(paths).fellows
        for one in fellows
    ]
    np.testing.assert_allclose(together, np.sum(each, axis=0), rtol=1e-12, atol=1e-15)
