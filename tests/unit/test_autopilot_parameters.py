"""The tables of parameters: they fit the motion model, and what is wrong with a value is told in one line."""

from __future__ import annotations

import math
from typing import Any

import pytest

from missionplanner.autopilot_parameters import (
    Kind,
    ParameterError,
    changed,
    defaults,
    differences,
    fields,
    find,
    held,
    missing,
    parameters,
    usual,
    value_of,
    with_values,
)
from missionplanner.errors import MissionError
from missionplanner.mission import VehicleSettings, mission_schema, parse_mission
from missionplanner.vehicle import MotionModel, motion_model, vehicle_limits

COPTER: Kind = ("ardupilot", "copter")
PLANE: Kind = ("ardupilot", "plane")
KINDS: list[Kind] = [COPTER, PLANE, ("px4", "copter"), ("px4", "plane")]
EACH = pytest.mark.parametrize("kind", KINDS)


def model_of(kind: Kind, **changes: Any) -> MotionModel:
    autopilot, vehicle_class = kind
    return motion_model(VehicleSettings(autopilot=autopilot, vehicle_class=vehicle_class, **changes))


@EACH
def test_every_parameter_sets_a_field_of_its_own(kind: Kind) -> None:
    table = parameters(kind)
    assert len({p.field for p in table}) == len(table)
    names = [name for p in table for name in p.names]
    assert len(set(names)) == len(names)
    assert all(len(name) <= 16 for name in names)  # what MAVLink carries
    for parameter in table:
        other = with_values(model_of(kind), {parameter.field: 0.5 * parameter.default + 1.0})
        assert value_of(other, parameter.field) == 0.5 * parameter.default + 1.0
        for fellow in table:
            if fellow is not parameter:
                assert value_of(other, fellow.field) == value_of(model_of(kind), fellow.field)


@EACH
def test_what_is_set_otherwise_is_told_from_the_usual(kind: Kind) -> None:
    model = model_of(kind)
    assert usual(kind, model)
    assert usual(kind, with_values(model, {"return_height_m": 77.0}))
    for parameter in parameters(kind):
        if not parameter.sent:
            assert not usual(kind, with_values(model, {parameter.field: 1.01 * parameter.default + 0.01}))


@EACH
def test_the_tables_are_where_defaults_come_from(kind: Kind) -> None:
    model = model_of(kind)
    for parameter in parameters(kind):
        assert value_of(model, parameter.field) == parameter.default
        assert parameter.low <= parameter.default <= parameter.high


@pytest.mark.parametrize("kind", [COPTER, PLANE, ("px4", "copter")])
def test_what_tuning_says_by_itself_is_what_its_table_says(kind: Kind) -> None:
    """Defaults within the dataclasses are only there for models made by hand: they must be the same.

    A plane's are ArduPlane's: PX4's planes have theirs from the table alone.
    """
    autopilot, vehicle_class = kind
    bare = MotionModel(autopilot, vehicle_class, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0)
    for parameter in parameters(kind):
        if "." in parameter.field and not parameter.field.startswith("airspeed_limits"):
            assert value_of(bare, parameter.field) == parameter.default


def test_px4s_planes_turn_as_px4_turns_them() -> None:
    """Defaults of fw_path_navigation_params.c and fw_att_control_params.c, 1.15; nothing is left of ArduPlane's."""
    plane = model_of(("px4", "plane")).plane
    assert (plane.roll_max_deg, plane.roll_time_s) == (50.0, 0.4)
    assert (plane.l1_period_s, plane.l1_damping, plane.l1_integral) == (10.0, 0.7, 0.0)
    assert plane.pitch_range_deg == (-30.0, 30.0)
    assert plane.airspeed_reads_low == 0.0  # that is what ArduPlane's simulated sensor does
    told = model_of(("px4", "plane"), parameters={"FW_R_LIM": 40, "NPFG_PERIOD": 20, "FW_P_LIM_MAX": 25}).plane
    assert (told.roll_max_deg, told.l1_period_s, told.pitch_range_deg) == (40.0, 20.0, (-30.0, 25.0))
    found = differences(("px4", "plane"), model_of(("px4", "plane")), {"FW_R_LIM": 30.0, "NPFG_PERIOD": 12.0})
    assert [(d.name, d.planned, d.held, d.plannable) for d in found] == [
        ("NPFG_PERIOD", 10.0, 12.0, True),
        ("FW_R_LIM", 50.0, 30.0, False),
    ]


@EACH
def test_a_vehicle_with_the_defaults_differs_in_nothing(kind: Kind) -> None:
    model = model_of(kind)
    assert differences(kind, model, held(kind, model)) == ()
    assert missing(kind, held(kind, model)) == ()
    again = model_of(kind, parameters=held(kind, model))
    for parameter in parameters(kind):
        assert value_of(again, parameter.field) == pytest.approx(parameter.default, rel=1e-7)


def test_older_and_newer_names_count_in_their_own_units() -> None:
    assert fields(COPTER, {"WPNAV_SPEED_UP": 300})["climb_rate_m_s"] == ("WPNAV_SPEED_UP", 3.0)
    assert fields(COPTER, {"WP_SPD_UP": 3.0})["climb_rate_m_s"] == ("WP_SPD_UP", 3.0)
    assert fields(PLANE, {"TRIM_ARSPD_CM": 1850})["cruise_speed_m_s"] == ("TRIM_ARSPD_CM", 18.5)
    assert fields(PLANE, {"AIRSPEED_CRUISE": 18.5})["cruise_speed_m_s"] == ("AIRSPEED_CRUISE", 18.5)
    assert fields(COPTER, {"RTL_LOIT_TIME": 2500})["arducopter.return_wait_s"] == ("RTL_LOIT_TIME", 2.5)
    both = fields(COPTER, {"WPNAV_RADIUS": 250, "WP_RADIUS_M": 2.5})
    assert both == {"waypoint_radius_m": ("WPNAV_RADIUS", 2.5)}


@pytest.mark.parametrize(
    ("kind", "values", "problem"),
    [
        (COPTER, {"WPNAV_RADIUS": -3}, "expected WPNAV_RADIUS between 5 and 1000, got -3"),
        (COPTER, {"WP_RADIUS_M": -3}, "expected WP_RADIUS_M between 0.05 and 10, got -3"),
        (COPTER, {"WPNAV_ACCEL": math.nan}, "expected WPNAV_ACCEL between 50 and 1000, got nan"),
        (COPTER, {"WPNAV_ACCEL": math.inf}, "expected WPNAV_ACCEL between 50 and 1000, got inf"),
        (COPTER, {"RTL_LOIT_TIME": 0.5}, "expected a whole number for RTL_LOIT_TIME, got 0.5"),
        (COPTER, {"RTL_ALT_FINAL": 500}, "expected RTL_ALT_FINAL between 0 and 0, got 500"),
        (COPTER, {"WPNAV_SPED": 5}, "(ardupilot copter), got 'WPNAV_SPED': did you mean WPNAV_SPEED?"),
        (COPTER, {"wpnav_accel": 5}, "did you mean WPNAV_ACCEL?"),
        (COPTER, {"MPC_ACC_HOR": 5}, "got 'MPC_ACC_HOR': it is one of px4 copter"),
        (COPTER, {"FOO": 5}, "known are WPNAV_ACCEL, "),
        (COPTER, {"WPNAV_ACCEL": 250, "WP_ACC": 2.6}, "WP_ACC 2.6 contradicts WPNAV_ACCEL 250: leave one of them out"),
        (PLANE, {"AIRSPEED_CRUISE": 20, "TRIM_ARSPD_CM": 2200}, "TRIM_ARSPD_CM 2200 contradicts AIRSPEED_CRUISE 20"),
    ],
)
def test_what_is_wrong_is_told(kind: Kind, values: dict[str, float], problem: str) -> None:
    with pytest.raises(ParameterError) as error:
        fields(kind, values)
    assert problem in str(error.value)
    assert error.value.name in values


def test_differences_are_told_in_the_vehicles_units() -> None:
    model = model_of(COPTER)
    values = held(COPTER, model) | {"WPNAV_ACCEL": 100.0, "RTL_ALT": 9900, "ARMING_CHECK": 1, "RTL_ALT_FINAL": 500}
    found = differences(COPTER, model, values)
    assert [(d.name, d.planned, d.held, d.plannable) for d in found] == [
        ("WPNAV_ACCEL", 250.0, 100.0, True),
        ("RTL_ALT_FINAL", 0.0, 500, False),
    ]
    assert str(found[0]) == "WPNAV_ACCEL is 100, planned with 250"
    newer = {"WP_ACC": 2.5000002, "WP_RADIUS_M": 2.001}  # rounded to single precision; and not
    assert [d.name for d in differences(COPTER, model, newer)] == ["WP_RADIUS_M"]
    assert "WPNAV_ACCEL" not in [p.name for p in missing(COPTER, newer)]
    assert "WPNAV_JERK" in [p.name for p in missing(COPTER, newer)]


def test_only_what_has_changed_and_makes_sense_changes_a_model() -> None:
    before = held(COPTER, model_of(COPTER))
    after = before | {"WPNAV_ACCEL": 100.0, "WPNAV_RADIUS": -3.0, "WPNAV_JERK": math.nan, "ARMING_CHECK": 0}
    assert changed(COPTER, before, after) == {"acceleration_m_s2": 1.0}


# in the mission file

MISSION = """\
name: small
origin: {{lat_deg: 47.4, lon_deg: 8.5}}
terrain: {{kind: flat, alt_amsl_m: 488}}
defaults: {{{defaults}}}
vehicles:
  - {{name: alpha, home: {{x_m: 0, y_m: 0}}, goal: {{x_m: 0, y_m: 300, height_agl_m: 40}}, {alpha}}}
  - {{name: bravo, home: {{x_m: 50, y_m: 0}}, goal: {{x_m: 50, y_m: 300, height_agl_m: 40}}, {bravo}}}
"""


def mission(defaults: str = "", alpha: str = "", bravo: str = "") -> list[MotionModel]:
    parsed = parse_mission(MISSION.format(defaults=defaults, alpha=alpha, bravo=bravo), "m.yaml")
    return [motion_model(vehicle) for vehicle in parsed.vehicles]


def test_vehicles_share_parameters_and_have_their_own() -> None:
    shared = "parameters: {WPNAV_ACCEL: 200, WPNAV_RADIUS: 300}"
    alpha, bravo = mission(shared, "parameters: {WPNAV_RADIUS: 400}")
    assert (alpha.acceleration_m_s2, alpha.waypoint_radius_m) == (2.0, 4.0)
    assert (bravo.acceleration_m_s2, bravo.waypoint_radius_m) == (2.0, 3.0)


def test_shared_parameters_are_those_vehicles_that_know_them() -> None:
    shared = "parameters: {WPNAV_ACCEL: 200, MPC_ACC_HOR: 5}"
    alpha, bravo = mission(shared, bravo="autopilot: px4")
    assert (alpha.acceleration_m_s2, bravo.acceleration_m_s2) == (2.0, 5.0)


@pytest.mark.parametrize(
    ("defaults", "alpha", "told"),
    [
        ("parameters: {MPC_ACC_HOR: 5}", "", "m.yaml:4: defaults.parameters.MPC_ACC_HOR: expected a parameter"),
        ("", "parameters: {MPC_ACC_HOR: 5}", "m.yaml:6: vehicles[0].parameters.MPC_ACC_HOR: expected a parameter"),
        ("", "parameters: {WPNAV_RADIUS: -3}", "m.yaml:6: vehicles[0].parameters.WPNAV_RADIUS: expected WPNAV_RADIUS"),
        ("", "parameters: {WPNAV_RADIUS: wide}", "m.yaml:6: vehicles[0].parameters.WPNAV_RADIUS: expected a number"),
        ("", "parameters: [WPNAV_RADIUS]", "m.yaml:6: vehicles[0].parameters: expected a mapping of fields"),
        (
            "motion: {acceleration_m_s2: 2.5}",
            "parameters: {WPNAV_ACCEL: 200}",
            "WPNAV_ACCEL 200 contradicts motion.acceleration_m_s2 2.5: leave one of them out",
        ),
        ("climb: {rate_m_s: 2}", "parameters: {WPNAV_SPEED_UP: 250}", "contradicts climb.rate_m_s 2"),
        ("descent: {rate_m_s: 2}", "parameters: {WPNAV_SPEED_DN: 150}", "contradicts descent.rate_m_s 2"),
        ("return_height_m: 40", "parameters: {RTL_ALT: 1500}", "RTL_ALT 1500 contradicts return_height_m 40"),
        ("class: plane, speed_m_s: {min: 12, max: 35}", "", "expected max of at most 30 (AIRSPEED_MAX), got 35"),
        ("class: plane, speed_m_s: {min: 5, max: 20}", "", "expected min of at least 9 (AIRSPEED_MIN), got 5"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(defaults: str, alpha: str, told: str) -> None:
    with pytest.raises(MissionError) as error:
        mission(defaults, alpha)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_what_is_said_twice_alike_is_no_contradiction() -> None:
    alpha, _ = mission("motion: {acceleration_m_s2: 2.3}", "parameters: {WPNAV_ACCEL: 230}")
    assert alpha.acceleration_m_s2 == 2.3


def test_a_typed_return_height_is_kept_to() -> None:
    parsed = parse_mission(MISSION.format(defaults="", alpha="parameters: {RTL_ALT: 4000}", bravo=""), "m.yaml")
    asked = [vehicle.asked_motion().get("return_height_m") for vehicle in parsed.vehicles]
    assert asked == [40.0, None]


def test_speeds_are_those_that_the_autopilot_flies() -> None:
    slow = VehicleSettings(parameters={"WPNAV_SPEED": 800.0})
    assert vehicle_limits(slow, 0.0).speed_max_m_s == 8.0
    plane = VehicleSettings(vehicle_class="plane", parameters={"AIRSPEED_MAX": 18.0, "AIRSPEED_CRUISE": 15.0})
    limits = vehicle_limits(plane, 0.0)
    assert (limits.speed_min_m_s, limits.speed_max_m_s) == (14.0, 18.0)
    fast = mission("class: plane, speed_m_s: {min: 12, max: 35}, parameters: {AIRSPEED_MAX: 40}")[0]
    assert fast.airspeed_limits_m_s == (9.0, 40.0)


def test_a_plane_that_circles_more_tightly_than_it_turns_is_refused() -> None:
    tight = {"vehicle_class": "plane", "parameters": {"WP_LOITER_RAD": 45.0}}
    with pytest.raises(MissionError, match=r"turn_radius_m: expected at most the 45 m of WP_LOITER_RAD, got 60 m"):
        motion_model(VehicleSettings.model_validate(tight))
    assert motion_model(VehicleSettings.model_validate(tight | {"turn_radius_m": 40.0})).loiter_radius_m == 45.0


def test_the_schema_tells_of_parameters() -> None:
    settings = mission_schema()["$defs"]["Vehicle"]["properties"]
    assert settings["parameters"]["additionalProperties"] == {"type": "number"}
    assert "WPNAV_SPEED" in settings["parameters"]["description"]
    assert "Mission Planner" in settings["parameter_file"]["description"]


def test_every_name_is_found_with_its_parameter() -> None:
    for kind in KINDS:
        assert set(defaults(kind)) == {p.field for p in parameters(kind)}
        for parameter in parameters(kind):
            for spelling in parameter.spellings:
                assert find(kind, spelling.name) == (parameter, spelling)
    assert find(COPTER, "NONE") is None
