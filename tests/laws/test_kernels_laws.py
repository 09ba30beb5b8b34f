from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner import kernels
from missionplanner.kernels import SpaceArrays, TerrainArrays
from missionplanner.obstacles import CableSolid, ConeSolid, CurtainSolid, CylinderSolid, PrismSolid, SphereSolid, pack
from tests.oracles.price import solid_distance, terrain_heights

laws = settings(deadline=None, max_examples=100)

place = st.floats(-200.0, 200.0)
size = st.floats(0.1, 150.0)
point = st.tuples(place, place, place).map(np.array)


@st.composite
def star(draw):
    """A simple polygon, convex or not: corners at rising angles around a middle."""
    count = draw(st.integers(3, 9))
    angle = 2.0 * math.pi * (np.arange(count) + np.array([draw(st.floats(0.0, 0.8)) for _ in range(count)])) / count
    radius = np.array([draw(st.floats(5.0, 100.0)) for _ in range(count)])
    return np.stack([radius * np.cos(angle) + draw(place), radius * np.sin(angle) + draw(place)], axis=-1)


solid = st.one_of(
    st.builds(CylinderSolid, st.just("c"), place, place, size, st.one_of(place, st.just(math.inf))),
    st.builds(ConeSolid, st.just("k"), place, place, size, place, size),
    st.builds(SphereSolid, st.just("s"), place, place, place, size, st.just("marine")),
    st.builds(
        lambda xy, floor, height: PrismSolid("p", xy, floor, floor + height),
        star(),
        st.one_of(place, st.just(-math.inf)),
        st.one_of(size, st.just(math.inf)),
    ).filter(lambda p: p.floor_amsl_m < p.top_amsl_m),
    st.builds(CableSolid, st.just("w"), point, point, st.floats(0.01, 20.0)).filter(
        lambda w: math.dist(w.start, w.end) > 0.5  # no mission has a shorter one
    ),
    st.builds(CurtainSolid, st.just("l"), point, point, st.floats(0.01, 20.0)).filter(
        lambda w: math.dist(w.start[:2], w.end[:2]) > 0.5
    ),
)

FLAT = TerrainArrays(np.zeros((50, 50), np.float32), np.array([[25.0, 0, 100.0] + [0] * 7, [25.0, 100.0, 0] + [0] * 7]))


def scene(solids, fence=None):
    outline = np.empty((0, 2)) if fence is None else fence
    return SpaceArrays(FLAT, pack(solids).arrays, outline, math.inf, np.array([-500.0, -450.0, 450.0, 500.0]))


@laws
@given(solid, point, point)
def test_distances_change_by_at_most_the_way_moved(body, a, b):
    distance = pack([body]).distance_m(np.stack([a, b]))[:, 0]
    assert abs(distance[0] - distance[1]) <= np.linalg.norm(a - b) + 1e-9


@laws
@given(solid, point)
def test_distances_agree_with_the_oracle(body, at):
    packed = pack([body])
    expected = solid_distance(packed.arrays, 0, at)
    np.testing.assert_allclose(packed.distance_m(at)[0], expected, rtol=1e-9, atol=1e-9)


@laws
@given(solid, point, st.floats(0.0, 2.0 * math.pi), st.floats(-1.0, 1.0))
def test_within_its_distance_nothing_changes_side(body, at, heading, rise):
    """The ball of radius |d| around a point lies wholly outside, or wholly inside, the solid."""
    packed = pack([body])
    distance = packed.distance_m(at)[0]
    level = math.sqrt(1.0 - rise * rise)
    direction = np.array([level * math.cos(heading), level * math.sin(heading), rise])
    moved = packed.distance_m(at + 0.999 * abs(distance) * direction)[0]
    assert moved * distance >= -1e-9


@laws
@given(st.lists(solid, min_size=1, max_size=6), point, point)
def test_leg_distance_is_a_tight_lower_bound(solids, a, b):
    of = scene(solids)
    row = kernels.legs_clearance(of, np.stack([a, b])[np.newaxis], 50.0)[0]
    dense = a + np.linspace(0.0, 1.0, 4001)[:, None] * (b - a)
    least = kernels.obstacle_distances(of.obstacles, dense).min()
    spacing = np.linalg.norm(b - a) / 4000
    assert row[kernels.OBSTACLE] <= least + 1e-9
    assert row[kernels.OBSTACLE] >= least - spacing - 0.03 - 0.011 * abs(least)
    index = int(row[kernels.OBSTACLE_INDEX])
    at = a + row[kernels.OBSTACLE_AT] * (b - a)
    there = kernels.obstacle_distances(of.obstacles, at[np.newaxis])[0, index]
    assert row[kernels.OBSTACLE] - 1e-9 <= there <= row[kernels.OBSTACLE] + 0.06 + 0.022 * abs(least)


@laws
@given(star(), point, point)
def test_leg_inside_the_fence_is_a_tight_lower_bound(fence, a, b):
    of = scene([], fence)
    row = kernels.legs_clearance(of, np.stack([a, b])[np.newaxis], 50.0)[0]
    dense = a + np.linspace(0.0, 1.0, 1001)[:, None] * (b - a)
    least = min(kernels.inside_distance(of, *p) for p in dense)
    spacing = np.linalg.norm(b - a) / 1000
    assert row[kernels.FENCE] <= least + 1e-9
    assert row[kernels.FENCE] >= least - spacing - 0.03 - 0.011 * abs(least)


@laws
@given(
    st.lists(solid, max_size=4),
    st.one_of(st.none(), star()),
    point,
    point,
    st.floats(-50.0, 50.0),
    st.floats(0.0, 40.0),
    st.floats(-20.0, 20.0),
)
def test_judging_a_leg_agrees_with_measuring_it(solids, fence, a, b, height_min_m, obstacle_m, fence_m):
    of = scene(solids, fence)
    leg = np.stack([a, b])[np.newaxis]
    row = kernels.legs_clearance(of, leg, 3.0)[0]
    judged = kernels.legs_are_clear(of, leg, 3.0, height_min_m, 150.0, 180.0, obstacle_m, fence_m)[0]
    sure = 0.05 + 0.02 * max(abs(obstacle_m), abs(fence_m))
    rooms = (
        row[kernels.HEIGHT_MIN] - height_min_m,
        150.0 - row[kernels.HEIGHT_MAX],
        180.0 - max(a[2], b[2]),
        row[kernels.OBSTACLE] - obstacle_m,
        row[kernels.FENCE] - fence_m,
    )
    if min(rooms) > sure:
        assert judged
    if min(rooms) < -sure:
        assert not judged


@laws
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(place, place),
    st.floats(-1e-3, 1e-3),
)
def test_terrain_agrees_with_the_oracle_and_fills_planes_exactly(seed, at, tilt):
    rng = np.random.default_rng(seed)
    to_cell = np.concatenate([FLAT.to_cell[:, :3] + rng.normal(0.0, 0.5, (2, 3)), rng.normal(0.0, 5.0, (2, 7))], axis=1)
    heights = rng.uniform(0.0, 500.0, (50, 50)).astype(np.float32)
    heights[rng.integers(0, 50, 20), rng.integers(0, 50, 20)] = np.nan
    xy = np.array([at])
    rough = TerrainArrays(heights, to_cell)
    np.testing.assert_allclose(kernels.terrain_heights(rough, xy), terrain_heights(rough, xy), rtol=1e-9, atol=1e-9)
    row, col = np.mgrid[0:50, 0:50].astype(np.float32)
    plane = TerrainArrays((256.0 * row - 512.0 * col).astype(np.float32), to_cell)
    r, c = kernels.cell_position(plane, *at)
    np.testing.assert_allclose(kernels.terrain_heights(plane, xy), 256.0 * r - 512.0 * c, rtol=1e-9, atol=1e-6)
