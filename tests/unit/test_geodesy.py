from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from pyproj import CRS, Geod, Proj

from missionplanner.geodesy import GeoPoint, LocalFrame

FRAME = LocalFrame(34.35, -118.2)
ELLIPSOID = Geod(ellps="WGS84")


def test_the_origin_is_zero() -> None:
    assert FRAME.to_local(34.35, -118.2, 1500.0) == pytest.approx([0.0, 0.0, 1500.0], abs=1e-9)


def test_axes_point_east_north_and_up() -> None:
    east, north, up = FRAME.to_local([34.35, 34.36, 34.35], [-118.19, -118.2, -118.2], [0.0, 0.0, 10.0])
    assert east[0] > 900
    assert abs(east[1]) < 1
    assert north[1] > 1100
    assert abs(north[0]) < 1e-6
    assert up[2] == 10.0


@pytest.mark.parametrize("lat_deg", [-80.0, -33.0, 0.0, 46.5, 70.0])
@pytest.mark.parametrize("azimuth_deg", [0.0, 37.0, 90.0, 215.0])
def test_distances_and_bearings_from_the_origin_are_those_of_the_ellipsoid(lat_deg: float, azimuth_deg: float) -> None:
    frame = LocalFrame(lat_deg, 8.0)
    for distance_m in (10.0, 1000.0, 20_000.0):
        lon, lat, _ = ELLIPSOID.fwd(8.0, lat_deg, azimuth_deg, distance_m)
        x, y, _ = frame.to_local(lat, lon, 0.0)
        assert np.hypot(x, y) == pytest.approx(distance_m, rel=2e-6)
        assert np.degrees(np.arctan2(x, y)) % 360 == pytest.approx(azimuth_deg, abs=2e-4)


def test_distances_between_far_places_are_true_to_ten_parts_in_a_million() -> None:
    a, b = np.array([20_000.0, 0.0, 0.0]), np.array([20_000.0, 1000.0, 0.0])
    lat, lon, _ = FRAME.to_geo(np.stack([a, b]))
    _, _, distance_m = ELLIPSOID.inv(lon[0], lat[0], lon[1], lat[1])
    assert distance_m == pytest.approx(1000.0, rel=1e-5)
    assert distance_m < 999.998  # scale 1 at the origin grows to 1 + 5e-6 here, as the module says


def test_altitude_is_altitude_everywhere() -> None:
    _, _, alt = FRAME.to_geo([[30_000.0, -40_000.0, 812.5]])
    assert alt[0] == 812.5


@pytest.mark.parametrize("shape", [(), (1,), (4, 3), (0,)])
def test_shapes_are_kept(shape: tuple[int, ...]) -> None:
    position = FRAME.to_local(np.full(shape, 34.4), np.full(shape, -118.1), np.zeros(shape))
    assert position.shape == (*shape, 3)
    lat, lon, alt = FRAME.to_geo(position)
    assert lat.shape == lon.shape == alt.shape == shape


def test_one_altitude_may_serve_many_places() -> None:
    assert FRAME.to_local([34.3, 34.4], [-118.1, -118.2], 7.0)[:, 2].tolist() == [7.0, 7.0]


def test_inputs_are_left_alone() -> None:
    lat, lon = np.array([34.3]), np.array([-118.1])
    FRAME.to_local(lat, lon, 0.0)
    assert (lat[0], lon[0]) == (34.3, -118.1)


def test_the_antimeridian_is_crossed() -> None:
    x = LocalFrame(-17.0, 179.999).to_local(-17.0, [179.998, -179.999], 0.0)[:, 0]
    assert x == pytest.approx([-106.4, 212.9], abs=0.1)


def test_a_point_is_given_with_plain_numbers() -> None:
    point = FRAME.geo_point(np.array([0.0, 0.0, 5.0]))
    assert point == GeoPoint(pytest.approx(34.35), pytest.approx(-118.2), 5.0)
    assert type(point.lat_deg) is float


def test_frames_compare_by_origin_and_travel_to_other_processes_and_threads() -> None:
    other = pickle.loads(pickle.dumps(FRAME))
    assert other == FRAME
    assert LocalFrame(34.0, -118.2) != FRAME
    expected = FRAME.to_local(34.4, -118.1, 0.0)
    assert np.array_equal(other.to_local(34.4, -118.1, 0.0), expected)
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda _: FRAME.to_local(34.4, -118.1, 0.0), range(200)))
    assert all(np.array_equal(r, expected) for r in results)


def test_the_frames_crs_is_known_to_others() -> None:
    crs = CRS.from_wkt(FRAME.crs.to_wkt())
    assert crs.is_projected
    assert crs.datum is not None
    assert crs.datum.name.startswith("World Geodetic System 1984")


def test_courses_count_from_true_north() -> None:
    here = FRAME.to_local(34.4, -118.0, 900.0)
    for asked_deg in (0.0, 37.5, 180.0, 270.0, 359.9):
        lon_deg, lat_deg, _ = ELLIPSOID.fwd(-118.0, 34.4, asked_deg, 400.0)
        there = FRAME.to_local(lat_deg, lon_deg, 1200.0)
        assert FRAME.heading_deg(here, there) == pytest.approx(asked_deg, abs=1e-6)
    # the frame's own y axis is off by its convergence there, here a tenth of a degree
    turned_deg = Proj(FRAME.crs).get_factors(-118.0, 34.4).meridian_convergence
    assert abs(turned_deg) > 0.1
    assert FRAME.heading_deg(here, here + np.array([0.0, 100.0, 0.0])) == pytest.approx(turned_deg, abs=1e-4)
