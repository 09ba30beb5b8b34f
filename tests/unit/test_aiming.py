from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from adapters.aiming import aim, headings_deg, hold_s, turn_deg
from missionplanner.geodesy import LocalFrame
from missionplanner.plan import Action
from tests.plans import vehicle_plan

FRAME = LocalFrame(46.5, 8.0)
places = st.tuples(st.floats(-9e3, 9e3), st.floats(-9e3, 9e3), st.floats(0.0, 4e3))
degrees = st.floats(0.0, 360.0)


@given(places, st.floats(-80.0, 80.0), st.floats(-80.0, 80.0), st.floats(-60.0, 60.0))
def test_who_looks_along_its_aim_sees_what_it_is_to_look_at(
    place: tuple[float, float, float], east: float, north: float, up: float
) -> None:
    target = (place[0] + east, place[1] + north, place[2] + up)
    across_m = math.hypot(east, north)
    found = aim(Action(look_at_m=target), np.array(place), FRAME)
    assert found is not None
    if found.heading_deg is None:
        assert across_m < 0.1
        return
    # walked along the ellipsoid from here, by heading and pitch, one is there
    here = FRAME.geo_point(place)
    lon_deg, lat_deg, _ = Geod(ellps="WGS84").fwd(here.lon_deg, here.lat_deg, found.heading_deg, across_m)
    alt_m = place[2] + across_m * math.tan(math.radians(found.pitch_deg))
    assert np.linalg.norm(FRAME.to_local(lat_deg, lon_deg, alt_m) - np.array(target)) < 0.01


def test_straight_down_has_no_heading() -> None:
    found = aim(Action(look_at_m=(0.0, 0.0, 10.0)), np.array([0.0, 0.0, 60.0]), FRAME)
    assert found is not None
    assert found.heading_deg is None
    assert found.pitch_deg == pytest.approx(-90.0)
    assert aim(Action(), np.zeros(3), FRAME) is None


@given(degrees, degrees)
def test_turns_are_the_shorter_way_and_lead_there(begin: float, end: float) -> None:
    turn = turn_deg(begin, end)
    assert -180.0 <= turn <= 180.0
    assert math.cos(math.radians(begin + turn - end)) == pytest.approx(1.0)


def test_a_vertical_leg_keeps_the_heading() -> None:
    points = ((0.0, 0.0, 1200.0), (0.0, 0.0, 1230.0), (100.0, 0.0, 1230.0), (100.0, 0.0, 1290.0))
    assert headings_deg(vehicle_plan(waypoints_m=points), FRAME) == pytest.approx([90.0] * 4, abs=0.01)


def test_a_vehicle_stands_for_its_hold_and_its_waits_but_not_for_its_photos() -> None:
    action = Action(hold_s=3.0, photos=2)
    plan = replace(vehicle_plan(), actions={1: action}, hold_s=np.array([action.stand_s + 4.0, 5.0]))
    assert action.stand_s > 3.0
    assert [hold_s(plan, k) for k in range(3)] == [0.0, 7.0, 5.0]
