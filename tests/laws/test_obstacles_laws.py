from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.errors import MissionError
from missionplanner.obstacles import PrismSolid, check_polygon, pack
from tests.laws.test_kernels_laws import point, star

shapely = pytest.importorskip("shapely")

laws = settings(deadline=None, max_examples=200)


@laws
@given(star(), point)
def test_the_outline_of_a_prism_is_the_polygon_of_shapely(xy, at):
    polygon = shapely.Polygon(xy)
    spot = shapely.Point(*at[:2])
    edge = polygon.exterior.distance(spot)
    expected = -edge if polygon.contains(spot) else edge
    assert pack([PrismSolid("p", xy)]).distance_m(at)[0] == pytest.approx(expected, abs=1e-9)


@laws
@given(star(), st.randoms(use_true_random=False))
def test_where_a_polygon_starts_and_which_way_it_runs_does_not_matter(xy, random):
    points = np.array([[random.uniform(-200, 200) for _ in range(3)] for _ in range(20)])
    turned = np.roll(xy, random.randrange(len(xy)), axis=0)[:: random.choice((1, -1))]
    expected = pack([PrismSolid("p", xy, -50.0, 50.0)]).distance_m(points)
    np.testing.assert_allclose(pack([PrismSolid("p", turned, -50.0, 50.0)]).distance_m(points), expected, atol=1e-9)


@laws
@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), min_size=3, max_size=7))
def test_polygons_that_cross_themselves_are_refused_as_shapely_does(corners):
    xy = np.array(corners, dtype=float)
    polygon = shapely.Polygon(xy)
    try:
        check_polygon(xy, "zone")
    except MissionError:
        # shapely tolerates corners that coincide and slivers; we ask for an area and for distinct corners
        assert not polygon.is_valid or polygon.area < 1e-6 or len(np.unique(xy, axis=0)) < len(xy)
    else:
        assert polygon.is_valid
