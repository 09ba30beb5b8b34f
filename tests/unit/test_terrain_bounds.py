from __future__ import annotations

import math

import numpy as np
import pytest

from missionplanner.kernels import TerrainArrays, terrain_height
from missionplanner.terrain_bounds import least_height, least_heights, pyramid, steepest

TO_CELL = np.zeros((2, 10))
TO_CELL[0, 0], TO_CELL[0, 2] = 100.0, -1e4 / 10.0
TO_CELL[1, 0], TO_CELL[1, 1] = 100.0, 1e4 / 10.0


def grid(heights: np.ndarray) -> TerrainArrays:
    return TerrainArrays(np.asarray(heights, dtype=np.float32), TO_CELL)


def bound(t: TerrainArrays, a: object, b: object, radius_m: float = 0.0, sign: float = 1.0) -> tuple[float, np.ndarray]:
    at = np.empty(3)
    corners = np.array([a, b, a], dtype=float)
    return least_height(t, pyramid(t, 1000.0), corners, radius_m, sign, math.inf, -math.inf, at), at


def slope(per_m: float) -> TerrainArrays:
    """Return a plane that rises eastwards."""
    return grid(np.broadcast_to(np.arange(201) * 10.0 * per_m, (201, 201)))


FLAT = grid(np.full((201, 201), 50.0))


def test_over_level_ground_the_bound_is_the_height_less_the_radius() -> None:
    height, _ = bound(FLAT, (-300, -300, 90), (300, 200, 80), 4.0)
    assert height == pytest.approx(80 - 50 - 4, abs=2e-3)


@pytest.mark.parametrize("per_m", [0.5, 1.0, 2.0])
def test_on_a_slope_it_is_the_distance_to_the_side_that_counts(per_m: float) -> None:
    # along a contour, h above the slope: the ball of radius r comes as near as h - r sqrt(1 + slope^2), vertically
    ground = 1000.0 * per_m
    height, at = bound(slope(per_m), (0, -300, ground + 60), (0, 300, ground + 60), 5.0)
    expected = 60.0 - 5.0 * math.sqrt(1.0 + per_m**2)
    assert expected - 0.12 <= height <= expected
    assert at[0] > 0.0  # uphill
    highest, at = bound(slope(per_m), (0, -300, ground + 60), (0, 300, ground + 60), 5.0, -1.0)
    assert 60.0 + 5.0 * math.sqrt(1.0 + per_m**2) <= -highest <= 60.0 + 5.0 * math.sqrt(1.0 + per_m**2) + 0.12
    assert at[0] < 0.0


def test_a_spike_between_two_good_waypoints_is_found_where_it_stands() -> None:
    heights = np.full((201, 201), 50.0)
    heights[100, 120] = 95.0  # at x 200, y 0
    height, at = bound(grid(heights), (-500, 0, 100), (500, 0, 100))
    assert height == pytest.approx(5.0, abs=0.1)
    assert at[:2] == pytest.approx([200.0, 0.0], abs=3.0)


def test_the_surface_overshoots_its_samples_and_the_bound_knows() -> None:
    heights = np.full((201, 201), 50.0)
    heights[:, 101:103] = 90.0  # a wall two samples wide bulges by an eighth of its height between them
    t = grid(heights)
    top = max(terrain_height(t, x, 0.0) for x in np.linspace(10, 20, 101))
    assert top > 94.9
    height, _ = bound(t, (-400, 0, 200), (400, 0, 200))
    assert height <= 200.0 - top
    assert height == pytest.approx(200.0 - top, abs=0.1)


@pytest.mark.parametrize("z", [100.0, 5000.0])
def test_missing_terrain_is_no_clearance_at_any_altitude(z: float) -> None:
    heights = np.full((201, 201), 50.0)
    heights[60, 60] = np.nan
    assert bound(grid(heights), (-400, 380, z), (-400, 420, z))[0] == -math.inf
    assert bound(grid(heights), (-400, 450, z), (-300, 500, z))[0] > 0.0
    assert bound(FLAT, (980, 0, z), (995, 0, z))[0] == -math.inf  # beyond the last patch
    assert bound(FLAT, (900, 0, z), (5000, 0, z))[0] == -math.inf


def test_only_the_radius_reaches_into_the_void() -> None:
    heights = np.full((201, 201), 50.0)
    heights[:, 150] = np.nan  # x 500; its patches begin at 480
    t = grid(heights)
    assert bound(t, (470, 0, 100), (470, 100, 100), 5.0)[0] > 0.0
    assert bound(t, (470, 0, 100), (470, 100, 100), 11.0)[0] == -math.inf


def test_a_triangle_is_bounded_over_its_whole_inside() -> None:
    heights = np.full((201, 201), 50.0)
    heights[95, 105] = 80.0  # at x 50, y 50
    t, at = grid(heights), np.empty(3)
    inside = np.array([(-100.0, -100.0, 100.0), (300.0, 0.0, 100.0), (0.0, 300.0, 100.0)])
    height = least_height(t, pyramid(t, 1000.0), inside, 2.0, 1.0, math.inf, -math.inf, at)
    assert 17.0 < height <= 18.0
    assert at[:2] == pytest.approx([50.0, 50.0], abs=4.0)
    outside = inside + np.array([0.0, -300.0, 0.0])
    assert least_height(t, pyramid(t, 1000.0), outside, 2.0, 1.0, math.inf, -math.inf, at) == pytest.approx(
        48.0, abs=0.01
    )


def test_enough_ends_the_search_early_and_many_are_judged_at_once() -> None:
    pieces = np.array([[(0, 0, 100), (50, 0, 100), (0, 0, 100)], [(0, 0, 60), (50, 0, 60), (0, 0, 60)]], dtype=float)
    out = least_heights(FLAT, pyramid(FLAT, 1000.0), pieces, np.array([1.0, 1.0]), 1.0, np.array([20.0, 20.0]))
    assert out[0, 0] == 20.0
    assert out[1, 0] == pytest.approx(9.0, abs=2e-3)


def test_the_steepest_ground_nearby() -> None:
    assert steepest(FLAT, 0.0, 0.0, 5.0) == pytest.approx(0.0, abs=1e-9)
    assert steepest(slope(0.4), 3.0, 0.0, 5.0) == pytest.approx(0.4, rel=0.02)
    assert steepest(FLAT, 1e4, 0.0, 5.0) == math.inf


@pytest.mark.parametrize("radius_m", [5.0, 13.0])
def test_a_tube_wider_than_many_cells_is_bounded_as_tightly(radius_m: float) -> None:
    # the same ridge on 10 m and on 1 m cells: a cosine hill along y, smooth enough for both
    x10, x1 = (np.arange(201) - 100) * 10.0, np.arange(-200.0, 201.0)
    ridge10, ridge1 = (40.0 * np.exp(-((x / 60.0) ** 2)) for x in (x10, x1))
    coarse = grid(np.broadcast_to(ridge10, (201, 201)))
    to_cell = np.zeros((2, 10))
    to_cell[:, 0] = 200.0
    to_cell[0, 2], to_cell[1, 1] = -1e4, 1e4
    fine = TerrainArrays(np.ascontiguousarray(np.broadcast_to(ridge1, (401, 401)), dtype=np.float32), to_cell)
    leg = (-100.0, 0.0, 80.0), (100.0, 20.0, 80.0)
    on_coarse, on_fine = bound(coarse, *leg, radius_m)[0], bound(fine, *leg, radius_m)[0]
    assert 40.0 - radius_m - 0.6 <= on_coarse <= 40.0 - radius_m + 0.1
    assert 40.0 - radius_m - 0.6 <= on_fine <= 40.0 - radius_m + 0.1
