"""The ground by the book: Keys' convolution kernel, point by point, in the raster's own coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rasterio
from pyproj import Transformer

from missionplanner.geodesy import LocalFrame


def keys_kernel(s: float) -> float:
    """Return Keys' cubic convolution kernel with a = -1/2 (IEEE TASSP 29(6), 1981, eq. 15)."""
    s = abs(s)
    if s <= 1:
        return 1.5 * s**3 - 2.5 * s**2 + 1
    if s <= 2:
        return -0.5 * s**3 + 2.5 * s**2 - 4 * s + 2
    return 0.0


def surface_amsl_m(path: Path, frame: LocalFrame, x_m: float, y_m: float) -> float:
    """Return the interpolated height of a raster file below one local place; NaN where a neighbour is missing."""
    with rasterio.open(path) as dataset:
        heights = dataset.read(1).astype(float)
        if dataset.nodata is not None:
            heights[heights == dataset.nodata] = np.nan
        lat, lon, _ = frame.to_geo(np.array([x_m, y_m, 0.0]))
        x, y = Transformer.from_crs(4326, dataset.crs.to_wkt(), always_xy=True).transform(float(lon), float(lat))
        a, b, c, d, e, f = (~dataset.transform)[:6]
    row, col = d * x + e * y + f - 0.5, a * x + b * y + c - 0.5  # from a pixel's corner to its centre
    top, left = int(np.floor(row)), int(np.floor(col))
    total = 0.0
    for i in range(top - 1, top + 3):
        for j in range(left - 1, left + 3):
            if not (0 <= i < heights.shape[0] and 0 <= j < heights.shape[1]):
                return float("nan")
            total += heights[i, j] * keys_kernel(row - i) * keys_kernel(col - j)
    return total


def bicubic(heights: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Return the heights (N,) at fractional rows and columns; NaN where any of 16 neighbours is missing."""
    kernel = np.vectorize(keys_kernel, otypes=[float])
    top, left = np.floor(row).astype(int), np.floor(column).astype(int)
    padded = np.pad(heights, 3, constant_values=np.nan)
    total = np.zeros(len(row))
    for i in range(-1, 3):
        for j in range(-1, 3):
            known = padded[np.clip(top + i + 3, 0, padded.shape[0] - 1), np.clip(left + j + 3, 0, padded.shape[1] - 1)]
            total += known * kernel(row - top - i) * kernel(column - left - j)
    return total
