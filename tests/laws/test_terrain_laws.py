from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from missionplanner.geodesy import LocalFrame
from missionplanner.kernels import TerrainArrays
from missionplanner.terrain import GridReference, Rectangle, Terrain, peaks_terrain, read_raster, write_raster
from missionplanner.terrain_bounds import pyramid
from tests.oracles.surface import surface_amsl_m

HEIGHTS = arrays(np.float32, (9, 11), elements=st.floats(0, 3000, width=32))
ROWS, COLS = st.floats(1, 6.999), st.floats(1, 8.999)


def grid(heights: np.ndarray) -> Terrain:
    """Return a terrain with one sample per 10 km, so that (x, y) is (col, row) in units of 10 km."""
    to_cell = np.zeros((2, 10))
    to_cell[0, 2] = to_cell[1, 1] = 1.0
    arrays = TerrainArrays(heights, to_cell)
    return Terrain(arrays, pyramid(arrays, 1e6), 1e4, "grid", GridReference("", (1e4, 0, 0, 0, 1e4, 0)))


def height(terrain: Terrain, row: float, col: float) -> float:
    return float(terrain.height_amsl_m(col * 1e4, row * 1e4))


@settings(deadline=None)  # the first call may compile
@given(HEIGHTS, st.integers(1, 6), st.integers(1, 8))
def test_samples_are_met(heights: np.ndarray, row: int, col: int) -> None:
    assert height(grid(heights), row, col) == pytest.approx(float(heights[row, col]), abs=1e-6)


@settings(deadline=None)  # the first call may compile
@given(HEIGHTS, ROWS, COLS)
def test_the_surface_overshoots_by_a_quarter_of_the_relief_at_most(heights: np.ndarray, row: float, col: float) -> None:
    """In one dimension the weights' absolute values sum to at most 1.25, in two to 1.5625: (1.5625 - 1) / 2 = 0.28."""
    low, high = float(heights.min()), float(heights.max())
    slack = 0.2813 * (high - low) + 1e-3
    assert low - slack <= height(grid(heights), row, col) <= high + slack


@settings(deadline=None)  # the first call may compile
@given(HEIGHTS, st.integers(1, 6), st.integers(1, 8), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_the_surface_is_continuous_across_cells(heights: np.ndarray, row: int, col: int, dr: float, dc: float) -> None:
    if not (1 <= row + dr < 7 and 1 <= col + dc < 9):
        return
    rise = abs(height(grid(heights), row + dr, col + dc) - height(grid(heights), row, col))
    assert rise <= 3 * 3000 * (abs(dr) + abs(dc)) + 1e-3


@settings(deadline=None)  # the first call may compile
@given(st.tuples(*[st.floats(-10, 10)] * 6), ROWS, COLS)
def test_quadratic_ground_is_exact(c: tuple[float, ...], row: float, col: float) -> None:
    """Keys' kernel with a = -1/2 reproduces polynomials of degree two."""
    r, k = np.meshgrid(np.arange(9.0), np.arange(11.0), indexing="ij")

    def ground(r: np.ndarray | float, k: np.ndarray | float) -> np.ndarray | float:
        return c[0] + c[1] * r + c[2] * k + c[3] * r * r + c[4] * r * k + c[5] * k * k

    heights = np.asarray(ground(r, k), dtype=np.float32)
    assert height(grid(heights), row, col) == pytest.approx(float(ground(row, col)), abs=2e-3)


@settings(deadline=None)  # the first call may compile
@given(HEIGHTS, ROWS, COLS, st.integers(0, 8), st.integers(0, 10))
def test_a_void_is_felt_by_its_neighbours_and_by_nobody_else(
    heights: np.ndarray, row: float, col: float, void_row: int, void_col: int
) -> None:
    whole, holed = height(grid(heights), row, col), heights.copy()
    holed[void_row, void_col] = np.nan
    touched = -1 <= void_row - math.floor(row) <= 2 and -1 <= void_col - math.floor(col) <= 2
    value = height(grid(holed), row, col)
    assert math.isnan(value) if touched else value == whole


@settings(deadline=None)  # the first call may compile
@given(HEIGHTS, st.floats(-5, 20), st.floats(-5, 20))
def test_known_heights_lie_where_the_grid_reaches(heights: np.ndarray, row: float, col: float) -> None:
    terrain = grid(heights)
    assert bool(terrain.reaches(col * 1e4, row * 1e4)) == (not math.isnan(height(terrain, row, col)))


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    lat=st.floats(-80, 80), lon=st.floats(-180, 180), east=st.floats(-30_000, 30_000), north=st.floats(-30_000, 30_000),
    size=st.floats(50, 8000), seed=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_files_written_anywhere_read_as_they_were(
    tmp_path: Path, lat: float, lon: float, east: float, north: float, size: float, seed: int
) -> None:
    frame = LocalFrame(lat, lon)
    area: Rectangle = (east, north, east + size, north + size)
    peaks = [(east + 0.3 * size, north + 0.6 * size, 400.0, size)]
    made = peaks_terrain(peaks, 50.0, max(5.0, size / 100), frame, area)
    path = tmp_path / "made.tif"
    write_raster(path, made)
    read = read_raster(path, frame, area)
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(area[0], area[2], 5), rng.uniform(area[1], area[3], 5)
    assert np.abs(read.height_amsl_m(x, y) - made.height_amsl_m(x, y)).max() < 1e-4
    assert read.height_amsl_m(x[0], y[0]) == pytest.approx(surface_amsl_m(path, frame, x[0], y[0]), abs=1e-3)
    write_raster(tmp_path / "crop.tif", read)
    again = read_raster(tmp_path / "crop.tif", frame, area)
    assert np.array_equal(again.height_amsl_m(x, y), read.height_amsl_m(x, y))
