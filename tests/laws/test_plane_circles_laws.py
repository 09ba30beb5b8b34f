"""How wide planes turn and circle, against flights: what ways home are proven with is never less than is flown."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.clearance import distance_to_legs_m, polyline_legs
from missionplanner.geodesy import FloatArray
from missionplanner.mission import VehicleSettings
from missionplanner.motion import Navigator, Route, return_points
from missionplanner.vehicle import MotionModel, motion_model

_BASE = motion_model(VehicleSettings.model_validate({"class": "plane"}))
_TICKS_PER_S = 20


@st.composite
def _planes(draw: st.DrawFn) -> MotionModel:
    wind_m_s = draw(st.floats(0.0, 10.0))
    course_rad = draw(st.floats(0.0, 2.0 * math.pi))
    tuning = replace(
        _BASE.plane,
        roll_max_deg=draw(st.floats(30.0, 65.0)),
        l1_period_s=draw(st.floats(10.0, 25.0)),
    )
    return replace(
        _BASE,
        loiter_radius_m=draw(st.floats(30.0, 150.0)),
        cruise_speed_m_s=draw(st.floats(15.0, 22.0)),
        wind_m_s=(wind_m_s * math.sin(course_rad), wind_m_s * math.cos(course_rad)),
        plane=tuning,
    )


def _flown(navigator: Navigator, seconds: float) -> FloatArray:
    places = []
    for _ in range(round(seconds * _TICKS_PER_S / 4)):
        for _ in range(4):
            navigator.step()
        places.append(navigator.position_m[0].copy())
    return np.array(places)


@settings(max_examples=40, deadline=None)
@given(
    model=_planes(),
    alt_amsl_m=st.floats(0.0, 3000.0),
    speed_m_s=st.floats(14.0, 28.0),
    away_m=st.floats(1.0, 1500.0),
    bearing_rad=st.floats(0.0, 2.0 * math.pi),
    before_s=st.floats(5.0, 30.0),
)
def test_a_plane_told_to_return_flies_no_further_aside(
    model: MotionModel, alt_amsl_m: float, speed_m_s: float, away_m: float, bearing_rad: float, before_s: float
) -> None:
    navigator = Navigator([model], [[0.0, 0.0, alt_amsl_m + 100.0]])
    navigator.follow(
        0, *Route.through([[0.0, 500.0, alt_amsl_m + 100.0], [400.0, 900.0, alt_amsl_m + 100.0]], speed_m_s)
    )
    told = _flown(navigator, before_s)[-1]
    home = told + away_m * np.array([math.sin(bearing_rad), math.cos(bearing_rad), 0.0]) - [0.0, 0.0, 100.0]
    navigator.follow(0, *return_points(model, told, home))
    flown = _flown(navigator, 200.0) * [1.0, 1.0, 0.0]
    way = polyline_legs(np.array([told, home]) * [1.0, 1.0, 0.0])
    aside_m = max(float(distance_to_legs_m(place, way).min()) for place in flown)
    wind_m_s = math.hypot(*model.wind_m_s)
    assert aside_m <= model.aside_m(max(speed_m_s, model.cruise_speed_m_s), alt_amsl_m + 100.0, wind_m_s)


@settings(max_examples=40, deadline=None)
@given(model=_planes(), alt_amsl_m=st.floats(0.0, 3000.0), speed_m_s=st.floats(14.0, 28.0))
def test_a_plane_that_has_settled_circles_no_wider(model: MotionModel, alt_amsl_m: float, speed_m_s: float) -> None:
    navigator = Navigator([model], [[0.0, -1000.0, alt_amsl_m]])
    navigator.follow(0, *Route.through([[0.0, -900.0, alt_amsl_m], [0.0, 0.0, alt_amsl_m]], speed_m_s))
    _flown(navigator, 250.0)
    away_m = np.hypot(*_flown(navigator, 100.0)[:, :2].T)
    assert away_m.max() <= model.circle_m(speed_m_s, alt_amsl_m, math.hypot(*model.wind_m_s))
