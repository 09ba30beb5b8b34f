"""WGS84 and the local frame: x east and y north in metres, z altitude AMSL.

The local frame is a transverse Mercator with scale 1 at the mission's origin (scale error 5e-6 at 20 km). It is not a
tangent plane: there, 10 km from the origin, "up" is 7.8 m off altitude. pyproj's order, longitude first, stays here.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from pyproj import CRS, Geod, Transformer

FloatArray = npt.NDArray[np.float64]

_EARTH = Geod(ellps="WGS84")


@dataclass(frozen=True, slots=True)
class GeoPoint:
    """A point on or above the earth; the altitude is above mean sea level (geoid)."""

    lat_deg: float
    lon_deg: float
    alt_amsl_m: float


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """The mission's local frame, centred on ``(origin_lat_deg, origin_lon_deg)``."""

    origin_lat_deg: float
    origin_lon_deg: float
    _to_local: Transformer = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        transformer = Transformer.from_crs(CRS.from_epsg(4326), self.crs, always_xy=True)
        object.__setattr__(self, "_to_local", transformer)

    @property
    def crs(self) -> CRS:
        """The frame's horizontal coordinate system, for raster libraries."""
        return CRS.from_proj4(
            f"+proj=tmerc +lat_0={self.origin_lat_deg!r} +lon_0={self.origin_lon_deg!r} +k=1 +datum=WGS84 +units=m"
        )

    def to_local(self, lat_deg: npt.ArrayLike, lon_deg: npt.ArrayLike, alt_amsl_m: npt.ArrayLike) -> FloatArray:
        """Return positions (..., 3) in metres for degrees and altitudes of shape (...)."""
        lat, lon, alt = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (lat_deg, lon_deg, alt_amsl_m)))
        x_m, y_m = self._to_local.transform(lon, lat)
        return np.stack([np.asarray(x_m, dtype=float), np.asarray(y_m, dtype=float), alt], axis=-1)

    def to_geo(self, position_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return latitude, longitude (degrees) and altitude AMSL, each (...), of positions (..., 3)."""
        position = np.asarray(position_m, dtype=float)
        lon_deg, lat_deg = self._to_local.transform(position[..., 0], position[..., 1], direction="INVERSE")
        return np.asarray(lat_deg, dtype=float), np.asarray(lon_deg, dtype=float), position[..., 2]

    def geo_point(self, position_m: npt.ArrayLike) -> GeoPoint:
        """Return one position (3,) as a :class:`GeoPoint`."""
        lat_deg, lon_deg, alt_amsl_m = self.to_geo(position_m)
        return GeoPoint(float(lat_deg), float(lon_deg), float(alt_amsl_m))

    def heading_deg(self, from_m: npt.ArrayLike, to_m: npt.ArrayLike) -> float:
        """Return the course from one position (3,) to another, clockwise from true north, in [0, 360).

        The frame's y axis is true north on the meridian of its origin only.
        """
        begin, end = self.geo_point(from_m), self.geo_point(to_m)
        azimuth_deg, _, _ = _EARTH.inv(begin.lon_deg, begin.lat_deg, end.lon_deg, end.lat_deg)
        return float(azimuth_deg) % 360.0 % 360.0  # twice: -1e-17 would become 360
