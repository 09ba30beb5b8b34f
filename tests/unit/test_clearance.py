from __future__ import annotations

import math

import numpy as np
import pytest

from missionplanner.clearance import Margins, legs_clear, legs_within_angles, polyline_legs
from tests.limits import limits
from tests.scenes import at, copter, question, scene_of

LIMITS = limits(climb_angle_rad=math.radians(30), height_agl_max_m=120.0, alt_amsl_max_m=500.0)


def test_margins_are_safety_distance_and_tracking_error() -> None:
    assert Margins.of(LIMITS) == Margins(22.0, 118.0, 498.0, 12.0, 12.0)


def test_extra_room_tightens_every_margin() -> None:
    assert Margins.of(LIMITS, 3.0) == Margins(25.0, 115.0, 495.0, 15.0, 15.0)


def test_a_polyline_has_a_leg_between_neighbours() -> None:
    points = np.arange(12.0).reshape(4, 3)
    legs = polyline_legs(points)
    assert legs.shape == (3, 2, 3)
    np.testing.assert_array_equal(legs[:, 0], points[:-1])
    np.testing.assert_array_equal(legs[:, 1], points[1:])
    assert polyline_legs(points[:1]).shape == (0, 2, 3)


@pytest.mark.parametrize(
    ("rise_m", "within"), [(57.7, True), (57.8, False), (0.0, True), (-99.9, True), (-100.1, False)]
)
def test_climb_and_descent_have_their_own_angles(rise_m: float, within: bool) -> None:
    # over 100 m: 30 degrees are 57.74 m, 45 degrees 100 m
    legs = np.array([[[0.0, 0.0, 50.0], [60.0, 80.0, 50.0 + rise_m]]])
    assert legs_within_angles(LIMITS, legs).tolist() == [within]


def test_slack_loosens_angles() -> None:
    legs = np.array([[[0.0, 0.0, 0.0], [100.0, 0.0, 58.0]]])
    assert not legs_within_angles(LIMITS, legs)[0]
    assert legs_within_angles(LIMITS, legs, math.radians(0.5))[0]


def test_a_vertical_leg_is_too_steep() -> None:
    legs = np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 10.0]], [[0.0, 0.0, 10.0], [0.0, 0.0, 0.0]]])
    assert legs_within_angles(LIMITS, legs).tolist() == [False, False]


def test_each_margin_is_kept_by_legs_that_are_clear() -> None:
    mast = {"kind": "cylinder", "name": "mast", "center": at(150, 0), "radius_m": 5}
    area = {"south_west": at(-100, -100), "north_east": at(400, 100)}
    space = scene_of(question(copter("alpha", (0, 50), (300, 50)), obstacles=[mast], area=area)).space
    margins = Margins.of(LIMITS)
    # level ground at 100 m: from 122 to 218 m AMSL, 17 m from the mast's axis, within 88 m of the middle
    heights = {121.9: False, 122.1: True, 217.9: True, 218.1: False}
    sides = {16.9: False, 17.1: True, 87.9: True, 88.1: False}
    places = [(50.0, z, ok) for z, ok in heights.items()] + [(y, 150.0, ok) for y, ok in sides.items()]
    legs = np.array([[[0.0, y, z], [300.0, y, z]] for y, z, _ in places])
    assert legs_clear(space, margins, legs).tolist() == [ok for *_, ok in places]
