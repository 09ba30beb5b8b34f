from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from missionplanner.geodesy import LocalFrame

ORIGINS = st.tuples(st.floats(-84, 84), st.floats(-180, 180))
METRES = st.floats(-50_000, 50_000)
ELLIPSOID = Geod(ellps="WGS84")


@given(ORIGINS, METRES, METRES, st.floats(-500, 9000))
def test_there_and_back_is_the_same_place(origin: tuple[float, float], x: float, y: float, alt: float) -> None:
    frame = LocalFrame(*origin)
    lat, lon, up = frame.to_geo([x, y, alt])
    assert np.abs(frame.to_local(lat, lon, up) - [x, y, alt]).max() < 1e-6
    assert -90 <= lat <= 90
    assert -180 <= lon <= 180


@given(ORIGINS, st.floats(0, 360), st.floats(1, 20_000))
def test_distance_from_the_origin_is_the_geodesic(origin: tuple[float, float], azimuth: float, distance: float) -> None:
    lon, lat, _ = ELLIPSOID.fwd(origin[1], origin[0], azimuth, distance)
    x, y, _ = LocalFrame(*origin).to_local(lat, lon, 0.0)
    # and a millimetre: PROJ is 0.6 mm off where the origin is nearly, but not quite, on the equator
    assert abs(np.hypot(x, y) - distance) < 2e-6 * distance + 1e-3


@given(ORIGINS, st.floats(-20_000, 20_000), st.floats(-20_000, 20_000), st.floats(0, 2 * np.pi))
def test_angles_are_kept(origin: tuple[float, float], x: float, y: float, turn: float) -> None:
    """The map is conformal: two short perpendicular steps of one length on earth stay so."""
    frame = LocalFrame(*origin)
    lat, lon, _ = frame.to_geo([x, y, 0.0])
    a, b = (ELLIPSOID.fwd(float(lon), float(lat), np.degrees(turn) + k, 100.0)[:2] for k in (0.0, 90.0))
    step = frame.to_local([a[1], b[1]], [a[0], b[0]], 0.0)[:, :2] - [x, y]
    lengths = np.linalg.norm(step, axis=1)
    assert abs(step[0] @ step[1]) / lengths.prod() < 2e-5
    assert np.abs(lengths / 100 - 1).max() < 2e-5
