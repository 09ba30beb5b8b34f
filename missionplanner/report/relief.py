"""The ground as pictures show it: sampled on a grid, shaded by a low sun in the north-west, with contours."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from matplotlib.colors import LinearSegmentedColormap

from missionplanner.geodesy import FloatArray
from missionplanner.terrain import Terrain

Box = tuple[float, float, float, float]  # west, south, east, north, metres

_TINT = LinearSegmentedColormap.from_list("tint", ["#e3ebdf", "#eef0e2", "#f6f0e0", "#efe3d2", "#f7f3ee"])
_SEA = np.array([0.83, 0.90, 0.94])
_VOID = np.array([0.90, 0.91, 0.92])
_FLAT_M = 2.0
HAIR = 2e-3
"""By how much of their interval contours lie above their altitude."""
_SEA_LEVEL_M = 2.0
_SUN = np.array([-1.0, 1.0, 1.35]) / math.sqrt(1.0 + 1.0 + 1.35**2)


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Heights (R, C) on a regular grid of the local frame; row 0 is the southernmost; NaN where nothing is known."""

    x_m: FloatArray  # (C,)
    y_m: FloatArray  # (R,)
    height_amsl_m: FloatArray

    @property
    def relief_m(self) -> float:
        """Highest minus lowest height."""
        known = self.height_amsl_m[np.isfinite(self.height_amsl_m)]
        return float(np.ptp(known)) if known.size else 0.0


def sample_ground(terrain: Terrain, box: Box, columns: int) -> Ground:
    """Sample the terrain over ``box`` with square cells."""
    west, south, east, north = box
    rows = max(2, round((north - south) / (east - west) * (columns - 1)) + 1)
    x, y = np.linspace(west, east, columns), np.linspace(south, north, rows)
    xx, yy = np.meshgrid(x, y)
    return Ground(x, y, np.asarray(terrain.height_amsl_m(xx, yy), dtype=float))


def relief_colours(ground: Ground, *, sea: bool) -> npt.NDArray[np.uint8]:
    """Return colours (R, C, 3), 0 to 255: tinted by height and shaded by slope; with ``sea``, water at sea level."""
    z = ground.height_amsl_m
    known = np.isfinite(z)
    if not known.any():
        return np.full((*z.shape, 3), np.round(255 * _VOID), dtype=np.uint8)
    low, high = np.percentile(z[known], [1, 99])
    filled = np.where(known, z, low)
    share = (filled - low) / (high - low) if high - low > _FLAT_M else np.full(z.shape, 0.4)
    colours = np.asarray(_TINT(share))[..., :3]
    if sea:
        colours[filled <= _SEA_LEVEL_M] = _SEA
    shade = _shade(filled, ground)
    colours = np.clip(colours * shade[..., None], 0.0, 1.0)
    colours[~known] = _VOID
    return np.round(255.0 * colours).astype(np.uint8)


def contour_interval_m(relief_m: float) -> float:
    """Return a round interval that makes about a dozen contours."""
    if relief_m <= 0.0:
        return 0.0
    rough = relief_m / 12.0
    decade = 10.0 ** math.floor(math.log10(rough))
    return next(step * decade for step in (1.0, 2.0, 5.0, 10.0) if rough <= step * decade)


def contour_levels_m(ground: Ground) -> FloatArray:
    """Return the altitudes of the contours: round, but for a hair, so that a plain at a round altitude has none."""
    interval = contour_interval_m(ground.relief_m)
    if ground.relief_m <= _FLAT_M:
        return np.empty(0)
    low, high = float(np.nanmin(ground.height_amsl_m)), float(np.nanmax(ground.height_amsl_m))
    nth = np.arange(math.ceil(low / interval), math.floor(high / interval) + 1, dtype=np.float64)
    return np.asarray((nth + HAIR) * interval)


def _shade(height: FloatArray, ground: Ground) -> npt.NDArray[np.float64]:
    dy, dx = np.gradient(height, ground.y_m, ground.x_m)
    steep = float(np.percentile(np.hypot(dx, dy), 95))
    exaggeration = float(np.clip(0.6 / max(steep, 1e-6), 0.15, 4.0)) if steep > 1e-3 else 1.0
    dx, dy = dx * exaggeration, dy * exaggeration
    light = (-dx * _SUN[0] - dy * _SUN[1] + _SUN[2]) / np.sqrt(1.0 + dx**2 + dy**2)
    level = _SUN[2]
    return np.asarray(np.clip(1.0 + 0.55 * (light - level), 0.5, 1.06))
