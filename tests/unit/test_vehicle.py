from __future__ import annotations

import math
from dataclasses import replace

import pytest

from missionplanner.errors import MissionError
from missionplanner.mission import VehicleSettings
from missionplanner.vehicle import ending, motion_model, vehicle_limits
from tests.limits import limits as some_limits


def settings(**fields: object) -> VehicleSettings:
    return VehicleSettings.model_validate(fields)


@pytest.mark.parametrize(
    ("autopilot", "vehicle_class", "expected"),
    [
        ("ardupilot", "copter", (2.5, 1.0, 2.5, 1.5, 2.0, 0.0)),
        ("px4", "copter", (3.0, 4.0, 3.0, 1.5, 2.0, 0.0)),
        ("ardupilot", "plane", (1.5, 1.0, 5.0, 5.0, 50.0, 60.0)),
        ("px4", "plane", (1.5, 1.0, 5.0, 5.0, 50.0, 60.0)),
    ],
)
def test_without_a_word_the_autopilots_own_parameters_hold(
    autopilot: str, vehicle_class: str, expected: tuple[float, ...]
) -> None:
    model = motion_model(settings(autopilot=autopilot, **{"class": vehicle_class}))
    assert (model.autopilot, model.vehicle_class) == (autopilot, vehicle_class)
    assert (
        model.acceleration_m_s2,
        model.jerk_m_s3,
        model.climb_rate_m_s,
        model.descent_rate_m_s,
        model.waypoint_radius_m,
        model.turn_radius_m,
    ) == expected


def test_what_the_mission_says_of_motion_holds() -> None:
    model = motion_model(
        settings(
            motion={"acceleration_m_s2": 1.1, "jerk_m_s3": 2.2, "waypoint_radius_m": 3.3},
            climb={"rate_m_s": 4.4},
            descent={"rate_m_s": 5.5},
            turn_radius_m=6.6,
        )
    )
    assert (model.acceleration_m_s2, model.jerk_m_s3, model.waypoint_radius_m) == (1.1, 2.2, 3.3)
    assert (model.climb_rate_m_s, model.descent_rate_m_s, model.turn_radius_m) == (4.4, 5.5, 6.6)


def test_a_copter_is_unlimited_where_nothing_is_said() -> None:
    limits = vehicle_limits(settings(), vertical_error_m=0.0)
    assert (limits.speed_min_m_s, limits.speed_max_m_s) == (3.0, 10.0)
    assert limits.climb_angle_rad == limits.descent_angle_rad == pytest.approx(math.radians(60))
    assert (limits.turn_radius_m, limits.turn_angle_rad) == (0.0, math.pi)
    assert (limits.terrain_margin_m, limits.obstacle_margin_m, limits.tracking_error_m) == (20.0, 10.0, 2.0)
    assert (limits.position_error_m, math.degrees(limits.landing_slope_rad)) == (1.0, pytest.approx(15.0))
    assert limits.height_agl_max_m == limits.alt_amsl_max_m == limits.endurance_s == math.inf


@pytest.mark.parametrize(
    ("fields", "deviation_m"),
    [
        ({}, 2.0),  # ArduCopter stays inside its waypoint radius
        ({"motion": {"waypoint_radius_m": 5}}, 5.0),
        ({"autopilot": "px4"}, 2.5),  # PX4 overshoots it by a quarter
        ({"autopilot": "px4", "motion": {"waypoint_radius_m": 4}}, 5.0),
        ({"class": "plane"}, 10.0),  # of its predicted flight, whatever its radius
        ({"class": "plane", "autopilot": "px4", "motion": {"waypoint_radius_m": 90}}, 10.0),
    ],
)
def test_the_tube_is_all_that_a_vehicle_may_be_off(fields: dict[str, object], deviation_m: float) -> None:
    limits = vehicle_limits(settings(tracking_error_m=3, position_error_m=0.5, **fields), vertical_error_m=4.0)
    assert limits.deviation_m == pytest.approx(deviation_m)
    assert limits.stray_m == 3.5
    assert limits.tube_m == pytest.approx(3.5 + deviation_m)
    assert some_limits(tracking_error_m=1.0, position_error_m=2.0, deviation_m=4.0).tube_m == 7.0


@pytest.mark.parametrize(
    ("autopilot", "vehicle_class", "height_m"),
    [("ardupilot", "copter", 15.0), ("px4", "copter", 30.0), ("ardupilot", "plane", 100.0), ("px4", "plane", 100.0)],
)
def test_who_is_not_told_how_high_to_return_returns_as_its_autopilot_does(
    autopilot: str, vehicle_class: str, height_m: float
) -> None:
    fields = {"autopilot": autopilot, "class": vehicle_class}
    assert motion_model(settings(**fields)).return_height_m == height_m
    assert motion_model(settings(return_height_m=77, **fields)).return_height_m == 77.0


def test_a_planes_defaults() -> None:
    limits = vehicle_limits(settings(**{"class": "plane"}), vertical_error_m=0.0)
    assert (limits.speed_min_m_s, limits.speed_max_m_s) == (14.0, 22.0)
    px4 = vehicle_limits(settings(autopilot="px4", **{"class": "plane"}), vertical_error_m=0.0)
    assert px4.speed_max_m_s == 20.0  # what PX4 would hold it to
    assert limits.climb_angle_rad == pytest.approx(math.radians(12))
    assert limits.turn_radius_m == 60.0


@pytest.mark.parametrize(("autopilot", "expected"), [("ardupilot", (22.0, 60.0)), ("px4", (15.0, 80.0))])
def test_a_planes_own_parameters(autopilot: str, expected: tuple[float, float]) -> None:
    model = motion_model(settings(autopilot=autopilot, **{"class": "plane"}))
    assert (model.cruise_speed_m_s, model.loiter_radius_m) == expected
    told = {"cruise_speed_m_s": 18, "loiter_radius_m": 50}
    model = motion_model(settings(autopilot=autopilot, turn_radius_m=55, motion=told, **{"class": "plane"}))
    assert (model.cruise_speed_m_s, model.loiter_radius_m) == (18.0, 55.0)  # no circle is tighter than its turns


def test_heights_of_the_way_home() -> None:
    copter, plane = (motion_model(settings(**{"class": kind})) for kind in ("copter", "plane"))
    assert [copter.return_alt_amsl_m(alt, 100.0) for alt in (105.0, 300.0)] == [115.0, 300.0]
    assert [plane.return_alt_amsl_m(alt, 100.0) for alt in (105.0, 300.0)] == [200.0, 200.0]
    strong = replace(plane, climb_rate_m_s=12.0)
    assert strong.takeoff_distance_m(60.0, 584.0) == pytest.approx(197.0, abs=6.0)  # recorded
    assert plane.takeoff_distance_m(60.0, 0.0) == pytest.approx(37.0 + 60.0 * 22.0 / 5.0, rel=0.02)
    assert plane.takeoff_distance_m(60.0, 2000.0) > plane.takeoff_distance_m(60.0, 584.0)


def test_what_the_mission_says_of_limits_holds() -> None:
    limits = vehicle_limits(
        settings(
            speed_m_s={"min": 4, "max": 7},
            climb={"angle_max_deg": 20},
            descent={"angle_max_deg": 30},
            turn_radius_m=0,
            turn_angle_max_deg=90,
            safety={"terrain_m": 15, "obstacle_m": 0, "landing_slope_max_deg": 8},
            tracking_error_m=0,
            position_error_m=0,
            height_agl_max_m=120,
            alt_amsl_max_m=-3,
            endurance_s=600,
            **{"class": "plane"},
        ),
        vertical_error_m=4.0,
    )
    assert (limits.speed_min_m_s, limits.speed_max_m_s) == (4, 7)
    assert math.degrees(limits.climb_angle_rad) == pytest.approx(20)
    assert math.degrees(limits.descent_angle_rad) == pytest.approx(30)
    assert limits.turn_radius_m == 0  # said, so not the default of 60
    assert math.degrees(limits.turn_angle_rad) == pytest.approx(90)
    assert limits.terrain_margin_m == 19  # the terrain model's error comes on top
    assert (limits.obstacle_margin_m, limits.tracking_error_m, limits.position_error_m) == (0, 0, 0)
    assert math.degrees(limits.landing_slope_rad) == pytest.approx(8)
    assert (limits.height_agl_max_m, limits.alt_amsl_max_m, limits.endurance_s) == (120, -3, 600)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, "land"),
        ({"class": "plane"}, "loiter"),
        ({"end": "rtl"}, "rtl"),
        ({"class": "plane", "end": "land"}, "land"),
    ],
)
def test_where_a_flight_ends(fields: dict[str, str], expected: str) -> None:
    assert ending(settings(**fields)) == expected


@pytest.mark.parametrize(
    ("autopilot", "parameters", "told"),
    [
        ("ardupilot", {"AIRSPEED_MIN": 25}, r"AIRSPEED_MIN <= AIRSPEED_CRUISE <= AIRSPEED_MAX, got 25, 22 and 30 m/s"),
        ("ardupilot", {"AIRSPEED_MIN": 25, "AIRSPEED_MAX": 20}, "got 25, 22 and 20 m/s"),
        ("ardupilot", {"TRIM_ARSPD_CM": 5000}, "<= TRIM_ARSPD_CM <= AIRSPEED_MAX, got 9, 50 and 30 m/s"),
        ("ardupilot", {"AIRSPEED_CRUISE": 5}, "got 9, 5 and 30 m/s"),
        ("px4", {"FW_AIRSPD_MAX": 12}, "FW_AIRSPD_MIN <= FW_AIRSPD_TRIM <= FW_AIRSPD_MAX, got 10, 15 and 12 m/s"),
    ],
)
@pytest.mark.parametrize("speed", [None, {"min": 25, "max": 28}])
def test_airspeeds_out_of_order_are_refused(
    autopilot: str, parameters: dict[str, float], told: str, speed: dict[str, float] | None
) -> None:
    asked = settings(autopilot=autopilot, parameters=parameters, speed_m_s=speed, **{"class": "plane"})
    for use in (motion_model, lambda one: vehicle_limits(one, vertical_error_m=0.0)):
        with pytest.raises(MissionError, match=told):
            use(asked)


def test_a_plane_for_which_no_usual_speed_is_allowed_must_be_told_its_own() -> None:
    fast = {"AIRSPEED_MIN": 25, "AIRSPEED_CRUISE": 27}
    told = "its default, 14 to 22 m/s, lies outside AIRSPEED_MIN 25 to AIRSPEED_MAX 30 m/s"
    with pytest.raises(MissionError, match=told):
        vehicle_limits(settings(parameters=fast, **{"class": "plane"}), vertical_error_m=0.0)
    own = settings(parameters=fast, speed_m_s={"min": 25, "max": 29}, **{"class": "plane"})
    assert vehicle_limits(own, vertical_error_m=0.0).speed_max_m_s == 29.0
    slow = settings(parameters={"ARSPD_FBW_MAX": 12, "AIRSPEED_CRUISE": 11}, **{"class": "plane"})
    with pytest.raises(MissionError, match="outside AIRSPEED_MIN 9 to ARSPD_FBW_MAX 12 m/s"):
        vehicle_limits(slow, vertical_error_m=0.0)
    within = settings(parameters={"AIRSPEED_MIN": 16, "AIRSPEED_MAX": 22}, **{"class": "plane"})
    limits = vehicle_limits(within, vertical_error_m=0.0)
    assert (limits.speed_min_m_s, limits.speed_max_m_s) == (16.0, 22.0)
