"""Elevation files for tests: one analytic hill, sampled on grids of any coordinate system."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio
from pyproj import Transformer
from rasterio.transform import Affine

from missionplanner.geodesy import LocalFrame
from missionplanner.terrain import Rectangle

FRAME = LocalFrame(34.35, -118.2)
AREA: Rectangle = (-1000.0, -800.0, 1200.0, 900.0)


def hill(x: npt.ArrayLike, y: npt.ArrayLike) -> npt.NDArray[np.float64]:
    x, y = np.asarray(x), np.asarray(y)
    return 800 + 0.1 * x + 100 * np.sin(x / 400) * np.cos(y / 500)


def write_tif(path: Path, heights: npt.NDArray[Any], transform: Affine, crs: str | None, **profile: Any) -> Path:
    units = profile.pop("units", None)
    tags = profile.pop("tags", {})
    scale = profile.pop("scale", None)
    data = heights if heights.ndim == 3 else heights[None]
    with rasterio.open(
        path, "w", driver="GTiff", count=data.shape[0], height=data.shape[1], width=data.shape[2], dtype=data.dtype,
        crs=crs, transform=transform, **profile,
    ) as dataset:  # fmt: skip
        dataset.write(data)
        dataset.update_tags(**tags)
        if units is not None:
            dataset.units = (units,)
        if scale is not None:
            dataset.scales, dataset.offsets = (scale[0],), (scale[1],)
    return path


def hill_in(path: Path, crs: str, cell: float, *, room: float = 400.0, rotation_deg: float = 0.0, **kw: Any) -> Path:
    """Sample the hill on a grid of another coordinate system and write it."""
    to_crs = Transformer.from_crs(4326, crs, always_xy=True)
    x, y = np.meshgrid([AREA[0] - room, AREA[2] + room], [AREA[1] - room, AREA[3] + room])
    lat, lon, _ = FRAME.to_geo(np.stack([x, y, np.zeros_like(x)], axis=-1))
    u, v = to_crs.transform(lon, lat)
    size = round(1.5 * max(np.ptp(u), np.ptp(v)) / cell)
    a, d = cell * math.cos(math.radians(rotation_deg)), cell * math.sin(math.radians(rotation_deg))
    transform = Affine(a, d, u.mean() - (a + d) * size / 2, d, -a, v.mean() - (d - a) * size / 2)
    lon, lat = to_crs.transform(*pixels(transform, size), direction="INVERSE")
    local = FRAME.to_local(lat, lon, 0.0)
    heights = hill(local[..., 0], local[..., 1]).astype(kw.pop("dtype", np.float32))
    heights = kw.pop("change", lambda h: h)(heights)
    return write_tif(path, heights, transform, kw.pop("write_crs", crs), **kw)


def pixels(transform: Affine, size: int) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the coordinates of all pixel centres of a square raster."""
    col, row = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    a, b, c, d, e, f = transform[:6]
    return a * col + b * row + c, d * col + e * row + f
