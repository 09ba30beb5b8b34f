from __future__ import annotations

import math

import numpy as np
import pytest

from missionplanner import kernels
from missionplanner.kernels import SpaceArrays, TerrainArrays
from missionplanner.obstacles import CableSolid, CylinderSolid, PrismSolid, Solid, SphereSolid, pack

AREA = np.array([-1000.0, -1000.0, 1000.0, 1000.0])


def grid(heights, cell_m=10.0):
    """Row 0 in the south at y = 0, column 0 at x = 0: height (R, C) at (x, y) = (col, row) * cell_m."""
    to_cell = np.zeros((2, 10))
    to_cell[0, 2] = to_cell[1, 1] = 1e4 / cell_m
    return TerrainArrays(np.asarray(heights, dtype=np.float32), to_cell)


def flat(height=0.0):
    terrain = grid(np.full((220, 220), height))
    terrain.to_cell[:, 0] = 110.0
    return terrain


def space(*solids: Solid, terrain=None, fence=None, top=math.inf):
    outline = np.empty((0, 2)) if fence is None else np.asarray(fence, dtype=float)
    return SpaceArrays(terrain if terrain is not None else flat(), pack(solids).arrays, outline, top, AREA)


def clearance(of, *leg, step_m=1.0):
    return kernels.legs_clearance(of, np.array([leg], dtype=float), step_m)[0]


class TestTerrain:
    def test_samples_are_reproduced_at_their_centres(self):
        heights = np.random.default_rng(0).uniform(0.0, 100.0, (6, 7)).astype(np.float32)
        assert kernels.terrain_height(grid(heights), 20.0, 30.0) == heights[3, 2]

    def test_half_way_the_weights_are_minus_one_nine_nine_minus_one_sixteenths(self):
        heights = np.zeros((4, 4))
        heights[1] = [16.0, 32.0, 48.0, 160.0]
        # (-16 + 9 * 32 + 9 * 48 - 160) / 16 = 34
        assert kernels.terrain_height(grid(heights), 15.0, 10.0) == pytest.approx(34.0, abs=1e-12)

    def test_both_directions_multiply(self):
        heights = np.zeros((4, 4))
        heights[1, 1] = 256.0
        assert kernels.terrain_height(grid(heights), 15.0, 15.0) == pytest.approx(81.0, abs=1e-12)
        assert kernels.terrain_height(grid(heights), 15.0, 10.0) == pytest.approx(144.0, abs=1e-12)

    def test_quadratic_surfaces_are_reproduced(self):
        y, x = np.mgrid[0:8, 0:8] * 10.0
        terrain = grid(0.01 * x * x - 0.02 * x * y + 3.0 * y)
        x, y = 33.7, 41.2
        assert kernels.terrain_height(terrain, x, y) == pytest.approx(0.01 * x * x - 0.02 * x * y + 3.0 * y, abs=1e-4)

    def test_rows_and_columns_follow_the_whole_cubic_map(self):
        terrain = TerrainArrays(np.zeros((4, 4), np.float32), np.arange(20.0).reshape(2, 10))
        u, v = 0.3, -0.2
        terms = np.array([1, u, v, u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3])
        assert kernels.cell_position(terrain, 3000.0, -2000.0) == pytest.approx(terrain.to_cell @ terms, abs=1e-12)

    @pytest.mark.parametrize("place", [(9.9, 20.0), (30.0, 20.0), (20.0, 9.9), (20.0, 40.0), (-50.0, 20.0), (1e9, 0.0)])
    def test_outside_the_stencil_there_is_no_height(self, place):
        assert math.isnan(kernels.terrain_height(grid(np.ones((6, 5))), *place))

    def test_nan_places_have_no_height(self):
        assert math.isnan(kernels.terrain_height(grid(np.ones((6, 5))), math.nan, 20.0))

    def test_a_void_among_the_sixteen_neighbours_leaves_no_height(self):
        heights = np.ones((8, 8))
        heights[6, 6] = np.nan
        assert math.isnan(kernels.terrain_height(grid(heights), 45.0, 45.0))
        assert kernels.terrain_height(grid(heights), 35.0, 45.0) == pytest.approx(1.0)

    def test_many_places_at_once(self):
        terrain = grid(np.arange(36.0).reshape(6, 6))
        xy = np.array([[20.0, 20.0], [0.0, 0.0], [21.5, 33.0]])
        one_by_one = [kernels.terrain_height(terrain, *place) for place in xy]
        np.testing.assert_array_equal(kernels.terrain_heights(terrain, xy), one_by_one)


class TestLegs:
    def test_height_above_ground_least_where_and_greatest(self):
        row = clearance(space(terrain=flat(100.0)), (0, 0, 150), (100, 0, 130))
        assert row[kernels.HEIGHT_MIN] == pytest.approx(30.0)
        assert row[kernels.HEIGHT_MIN_AT] == 1.0
        assert row[kernels.HEIGHT_MAX] == pytest.approx(50.0)

    def test_missing_terrain_is_no_height_at_all(self):
        terrain = flat()
        terrain.height_amsl_m[110, 115] = np.nan
        row = clearance(space(terrain=terrain), (0, 0, 50), (100, 0, 50))
        assert row[kernels.HEIGHT_MIN] == -np.inf
        assert row[kernels.HEIGHT_MAX] == np.inf

    def test_nearest_obstacle_its_distance_and_place(self):
        of = space(CylinderSolid("far", 50.0, 80.0, 5.0), CylinderSolid("near", 30.0, 20.0, 5.0))
        row = clearance(of, (0, 0, 50), (100, 0, 50))
        assert row[kernels.OBSTACLE] == pytest.approx(15.0, abs=2e-4)
        assert row[kernels.OBSTACLE] <= 15.0
        assert row[kernels.OBSTACLE_INDEX] == 1
        assert row[kernels.OBSTACLE_AT] == pytest.approx(0.3, abs=0.01)

    def test_without_obstacles_the_distance_is_infinite(self):
        row = clearance(space(), (0, 0, 50), (100, 0, 50))
        assert row[kernels.OBSTACLE] == np.inf
        assert row[kernels.OBSTACLE_INDEX] == -1

    def test_soft_zones_are_no_obstacles(self):
        of = space(SphereSolid("soft", 50.0, 0.0, 50.0, 20.0, "radar", hard=False))
        assert clearance(of, (0, 0, 50), (100, 0, 50))[kernels.OBSTACLE] == np.inf

    def test_a_thin_cable_is_found_between_far_samples(self):
        of = space(CableSolid("cable", np.array([503.7, -50.0, 60.0]), np.array([503.7, 50.0, 60.0]), 0.01))
        row = clearance(of, (-900, 0, 60), (900, 0, 60), step_m=1800.0)
        assert row[kernels.OBSTACLE] == pytest.approx(-0.01, abs=2e-4)
        assert row[kernels.OBSTACLE_AT] == pytest.approx((503.7 + 900) / 1800, abs=1e-4)

    def test_along_a_wall_of_a_bent_prism(self):
        notch = np.array([[0, 10], [100, 10], [100, 60], [50, 20], [0, 60]], dtype=float)
        row = clearance(space(PrismSolid("notch", notch)), (-50, 0, 50), (150, 0, 50))
        assert 9.8 < row[kernels.OBSTACLE] <= 10.0

    def test_inside_area_and_fence(self):
        row = clearance(space(), (-990, 0, 50), (0, 0, 50))
        assert row[kernels.FENCE] == pytest.approx(10.0)
        square = [[-100, -100], [100, -100], [100, 100], [-100, 100]]
        row = clearance(space(fence=square, top=120.0), (-80, 0, 50), (80, 0, 105))
        assert 14.9 < row[kernels.FENCE] <= 15.0
        assert clearance(space(fence=square), (0, 0, 50), (150, 0, 50))[kernels.FENCE] <= -50.0

    def test_a_leg_across_a_notch_of_the_fence_is_outside(self):
        notched = [[-100, -100], [100, -100], [100, 100], [0, -50], [-100, 100]]
        row = clearance(space(fence=notched), (-90, 20, 50), (90, 20, 50))
        assert row[kernels.FENCE] < -20.0

    def test_a_leg_without_length(self):
        row = clearance(space(CylinderSolid("mast", 10.0, 0.0, 2.0)), (0, 0, 50), (0, 0, 50))
        assert row[kernels.OBSTACLE] == pytest.approx(8.0)
        assert row[kernels.HEIGHT_MIN] == 50.0

    def test_no_legs(self):
        assert kernels.legs_clearance(space(), np.empty((0, 2, 3)), 1.0).shape == (0, kernels.CLEARANCE_COLUMNS)

    @pytest.mark.parametrize(
        ("limits", "expected"),
        [
            ((50.0, 50.0, 50.0, 15.0, 19.9), True),
            ((50.1, 90.0, 90.0, 15.0, 19.9), False),  # too low
            ((10.0, 49.9, 90.0, 15.0, 19.9), False),  # too high above ground
            ((10.0, 90.0, 49.9, 15.0, 19.9), False),  # too high above sea level
            ((10.0, 90.0, 90.0, 15.1, 19.9), False),  # too near the mast
            ((10.0, 90.0, 90.0, 15.0, 20.1), False),  # too near the fence
        ],
    )
    def test_judgement_of_each_limit(self, limits, expected):
        square = [[-100, -100], [120, -100], [120, 100], [-100, 100]]
        of = space(CylinderSolid("mast", 30.0, 20.0, 4.99), fence=square)
        leg = np.array([[[0, 0, 50], [100, 0, 50]]], dtype=float)
        assert kernels.legs_are_clear(of, leg, 1.0, *limits)[0] == expected


def test_what_hides_between_samples_is_shallow():
    for reach in (1.0, 5.0, 12.0, 50.0):
        half = kernels.hiding_step(reach) / 2.0
        assert reach - math.sqrt(reach**2 - half**2) <= 0.11
