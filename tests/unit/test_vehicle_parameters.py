"""What vehicles hold against what they were planned with; many parameters read at once."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint, in_process_pair
from adapters.mission_protocol import Party
from adapters.parameter_protocol import ParameterList, ParametersRead, ParameterValue, parameter_name
from adapters.vehicle_parameters import HeldParameters, check_parameters, compared, read_parameters
from missionplanner.autopilot_parameters import Kind, held, parameters, with_values
from missionplanner.errors import LinkError
from missionplanner.geodesy import GeoPoint
from missionplanner.mission import Mission, VehicleSettings, parse_mission
from missionplanner.plan import FleetPlan
from missionplanner.vehicle import Autopilot, motion_model
from sim.fleet import LockstepClock, SimFleet, SimVehicle, sim_vehicles
from tests.plans import fleet_plan, small_fleet, vehicle_plan
from tests.rig import Rig
from tests.scenes import question

REAL32 = int(mavlink.MAV_PARAM_TYPE_REAL32)
PARTY = Party("uav3", 3)
HOME = GeoPoint(34.3, -118.1, 584.0)


def holding(rig: Rig, vehicle: int = 0) -> Any:
    """Return the parameters of a simulated vehicle, to be meddled with."""
    return rig.sim.links[vehicle].autopilot.parameters


def connected(plan: FleetPlan) -> Rig:
    rig = Rig(plan)
    rig.link.connect()
    return rig


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_vehicles_that_hold_what_they_were_planned_with(autopilot: Autopilot) -> None:
    rig = connected(small_fleet(autopilot))
    assert [(c.vehicle, c.differences, c.unheld, c.absent, c.problem) for c in rig.link.compare_parameters()] == [
        (name, (), (), (), None) for name in ("uav1", "uav2", "uav3")
    ]


def test_planes_that_hold_what_they_were_planned_with() -> None:
    plane = vehicle_plan(vehicle_class="plane", waypoints_m=((0, 300, 1290), (900, 300, 1300)), end="loiter")
    assert connected(fleet_plan(plane)).link.compare_parameters()[0].problem is None


def test_a_difference_is_told_with_both_remedies() -> None:
    rig = connected(small_fleet("ardupilot", 2))
    holding(rig, 1).update({"WPNAV_ACCEL": 100.0, "WPNAV_SPEED": 500.0})
    first, second = rig.link.compare_parameters()
    assert first.problem is None
    assert second.problem == (
        "uav2: holds WPNAV_ACCEL 100, planned with 250: set it to 250 on the vehicle, or put WPNAV_ACCEL: 100 into its "
        "parameters in the mission file and plan again (and 1 more: WPNAV_SPEED is 500, planned with 1000)"
    )


def test_what_no_plan_could_take_up_is_to_be_set_on_the_vehicle() -> None:
    rig = connected(small_fleet("ardupilot", 1))
    holding(rig)["RTL_ALT_FINAL"] = 500
    [comparison] = rig.link.compare_parameters()
    assert comparison.problem == "uav1: holds RTL_ALT_FINAL 500, planned with 0: set it to 0 on the vehicle"


def test_the_height_to_return_at_is_the_plans_to_set() -> None:
    rig = connected(small_fleet("ardupilot", 1))
    holding(rig)["RTL_ALT"] = 9900
    assert rig.link.compare_parameters()[0].problem is None


def test_newer_firmware_has_other_names_and_units() -> None:
    rig = connected(small_fleet("ardupilot", 2))
    for vehicle, value in enumerate((2.5, 2.4)):
        del holding(rig, vehicle)["WPNAV_ACCEL"]
        holding(rig, vehicle)["WP_ACC"] = value
    same, other = rig.link.compare_parameters()
    assert (same.problem, same.absent) == (None, ())
    assert other.problem is not None
    assert "holds WP_ACC 2.4, planned with 2.5: set it to 2.5 on the vehicle" in other.problem


def test_what_the_firmware_does_not_have_is_told_and_refused_only_if_planned_otherwise() -> None:
    usual, other = vehicle_plan("usual", 1), vehicle_plan("other", 2, home_m=(0, 60, 1200))
    other = replace(other, motion=replace(other.motion, jerk_m_s3=2.0))
    rig = connected(fleet_plan(usual, other))
    for vehicle in (0, 1):
        del holding(rig, vehicle)["WPNAV_JERK"]
    begun_s = rig.clock.now_s()
    first, second = rig.link.compare_parameters()
    assert rig.clock.now_s() - begun_s < 5.0  # a name in vain costs round trips, no time-outs
    assert first.problem is None
    assert first.absent == ("usual: its firmware has no WPNAV_JERK or WP_JERK: 1 m/s^3 is assumed",)
    assert second.problem == (
        "other: its firmware has no WPNAV_JERK or WP_JERK, planned with 2 m/s^3: leave it out of the mission file and "
        "plan again"
    )


def test_a_lossy_link_delays_but_does_not_deceive() -> None:
    rig = connected(small_fleet("ardupilot", 3))
    holding(rig, 2)["WPNAV_RADIUS"] = 300.0
    del holding(rig, 1)["WPNAV_JERK"]
    rig.lose(0.4, seed=11)
    assert [c.problem is None for c in rig.link.compare_parameters()] == [True, True, False]


def test_a_vehicle_that_falls_silent_is_an_error() -> None:
    rig = connected(small_fleet("ardupilot", 2))
    rig.pipes[1].down = lambda message: None
    with pytest.raises(LinkError) as error:
        rig.link.compare_parameters()
    assert str(error.value).startswith("uav2 (sysid 2): expected parameter ")
    assert str(error.value).endswith("got no answer any more: the link is bad; nothing was uploaded")


# any vehicle's, without a plan


def sim_of(*vehicles: SimVehicle) -> tuple[SimFleet, list[Endpoint], LockstepClock]:
    sim = SimFleet(vehicles)
    ground, air = in_process_pair("pipe")
    sim.attach(air)
    return sim, [ground], LockstepClock(sim)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_all_that_are_heard_are_read(autopilot: Autopilot) -> None:
    sim, ground, clock = sim_of(*sim_vehicles(3, HOME, autopilot=autopilot))
    found = read_parameters(ground, clock)
    assert list(found) == [1, 2, 3]
    kind: Kind = (autopilot, "copter")
    for parameter in parameters(kind):
        holds = sim.links[1].autopilot.parameters[parameter.name]
        assert found[2].values[parameter.name].value == pytest.approx(holds, rel=1e-7)
    assert set(found[2].values) == {parameter.name for parameter in parameters(kind)}


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_everything_can_be_read(autopilot: Autopilot) -> None:
    sim, ground, clock = sim_of(*sim_vehicles(2, HOME, autopilot=autopilot))
    told: list[tuple[str, int, int]] = []
    found = read_parameters(ground, clock, expected=[2], everything=True, progress=lambda *args: told.append(args))
    assert list(found) == [2]
    holds = sim.links[1].autopilot.parameters
    assert {name: held.value for name, held in found[2].values.items()} == pytest.approx(dict(holds))
    assert told[-1] == ("vehicle 2", len(holds), len(holds))


def mission(autopilot: Autopilot = "ardupilot", sysid: int = 1, more: str = "") -> Mission:
    return parse_mission(
        "name: m\norigin: {lat_deg: 34.3, lon_deg: -118.1}\nterrain: {kind: flat, alt_amsl_m: 584}\n"
        f"vehicles: [{{name: alpha, sysid: {sysid}, autopilot: {autopilot}, home: {{x_m: 0, y_m: 0}}, "
        f"goal: {{x_m: 0, y_m: 300, height_agl_m: 40}}, {more}}}]",
        "m.yaml",
    )


def test_vehicles_are_held_against_a_mission() -> None:
    _, ground, clock = sim_of(*sim_vehicles(1, HOME))
    found = read_parameters(ground, clock)
    [same] = check_parameters(found.values(), mission())
    assert same.problem is None
    [other] = check_parameters(found.values(), mission(more="parameters: {WPNAV_ACCEL: 200}"))
    assert other.problem is not None
    assert other.problem.startswith("alpha: holds WPNAV_ACCEL 250, planned with 200: ")
    row = other.as_json(found[1])
    assert row["differences"] == [{"name": "WPNAV_ACCEL", "planned": 200.0, "held": 250.0, "plannable": True}]
    assert row["sets"]["WPNAV_ACCEL"] == "acceleration_m_s2 = 2.5 m/s^2"
    assert row["parameters"]["WPNAV_ACCEL"] == 250.0
    [nothing] = check_parameters(found.values(), None)
    assert nothing.problem is None


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (mission(sysid=7), "vehicle 1: expected one of the mission's sysids (7)"),
        (mission("px4"), "alpha (sysid 1): expected px4 copter, got ardupilot copter: the wrong vehicle, or"),
    ],
)
def test_the_wrong_vehicle_is_told(asked: Mission, told: str) -> None:
    _, ground, clock = sim_of(*sim_vehicles(1, HOME))
    with pytest.raises(LinkError) as error:
        check_parameters(read_parameters(ground, clock).values(), asked)
    assert told in str(error.value)


@pytest.mark.parametrize("kind", [("ardupilot", "copter"), ("ardupilot", "plane"), ("px4", "copter"), ("px4", "plane")])
def test_no_parameter_is_left_out_of_the_comparison(kind: Kind) -> None:
    autopilot, vehicle_class = kind
    model = motion_model(VehicleSettings(autopilot=autopilot, vehicle_class=vehicle_class))
    for parameter in parameters(kind):
        if parameter.sent:
            continue
        other = with_values(model, {parameter.field: 1.25 * parameter.default + 1.0})
        values = {name: ParameterValue(name, float(value), REAL32) for name, value in held(kind, other).items()}
        comparison = compared("uav", model, values)
        assert [difference.name for difference in comparison.differences] == [parameter.name]


# the exchange, message by message


def value(name: str, wire: float, kind: int = REAL32, index: int = 65_535, count: int = 900) -> Any:
    message = mavlink.MAVLink_param_value_message(name.encode(), wire, kind, count, index)
    message.pack(mavlink.MAVLink(None, srcSystem=3, srcComponent=1))
    return message


def absent(name: str) -> Any:
    error = mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST
    message = mavlink.MAVLink_param_error_message(255, 190, name.encode(), -1, error)
    message.pack(mavlink.MAVLink(None, srcSystem=3, srcComponent=1))
    return message


def asked(messages: list[Any]) -> list[str]:
    return [parameter_name(message) for message in messages]


def test_the_next_are_asked_for_as_soon_as_those_asked_for_are_answered() -> None:
    read = ParametersRead(PARTY, "ardupilot", [[f"A{k}", f"B{k}"] for k in range(10)])
    first = asked(read.poll(0.0))
    assert first == [f"{letter}{k}" for k in range(7) for letter in "AB"]
    assert read.poll(0.1) == []
    for k in range(7):
        read.receive(value(f"B{k}", 1.0), 0.1)
    assert asked(read.poll(0.1)) == ["A7", "B7", "A8", "B8", "A9", "B9", "B0"]  # the last is the witness
    for k in range(7, 10):
        read.receive(value(f"A{k}", 2.0), 0.2)
    assert read.done
    assert [held.name for held in read.held if held] == [f"B{k}" for k in range(7)] + ["A7", "A8", "A9"]


def test_the_newest_firmware_says_what_it_does_not_have() -> None:
    read = ParametersRead(PARTY, "ardupilot", [["A"], ["B", "C"]])
    read.poll(0.0)
    read.receive(value("A", 1.0), 0.1)
    read.receive(absent("B"), 0.1)
    assert not read.done
    read.receive(absent("C"), 0.1)
    assert read.done
    assert read.held[1] is None


@pytest.mark.parametrize("stray", [value("X", 1.0), absent("X"), value("AB", 1.0), value("a", 1.0)])
def test_what_was_not_asked_for_does_not_count(stray: Any) -> None:
    read = ParametersRead(PARTY, "ardupilot", [["A"]])
    read.receive(value("A", 1.0), 0.0)  # before it was asked for
    read.poll(0.0)
    read.receive(stray, 0.1)
    assert not read.done


@pytest.mark.parametrize("make", [ParametersRead, ParameterList])
def test_an_unknown_type_is_told(make: Any) -> None:
    read = make(PARTY, "ardupilot", [["A"]]) if make is ParametersRead else make(PARTY, "ardupilot")
    read.poll(0.0)
    read.receive(value("A", 1.0, kind=77, index=0), 0.1)
    with pytest.raises(LinkError, match=r"uav3 \(sysid 3\): parameter A: unknown parameter type 77"):
        read.poll(0.2)


def test_a_stream_that_never_begins_is_asked_for_again_and_given_up() -> None:
    read = ParameterList(PARTY, "px4", patience_s=4.0)
    kinds = [message.get_type() for k in range(40) for message in read.poll(0.1 * k)]
    assert kinds == ["PARAM_REQUEST_LIST"] * 3
    with pytest.raises(LinkError, match="expected all its parameters, got none: the link is bad"):
        read.poll(4.5)


def test_what_is_lost_of_a_stream_is_asked_for_by_index() -> None:
    read = ParameterList(PARTY, "px4")
    read.poll(0.0)
    read.receive(value("_HASH_CHECK", 0.0, index=65_535, count=40), 0.1)
    for k in range(0, 40, 2):
        read.receive(value(f"P{k}", 1.0, index=k, count=40), 0.2)
    assert read.poll(1.0) == []
    assert [message.param_index for message in read.poll(2.0)] == list(range(1, 33, 2))
    for k in range(1, 33, 2):
        read.receive(value(f"P{k}", 1.0, index=k, count=40), 2.1)
    assert [message.param_index for message in read.poll(2.1)] == [33, 35, 37, 39]
    read.receive(value("P33", 1.0, index=33, count=40), 2.2)
    assert (read.read, read.total, read.done) == (37, 40, False)
    read.poll(4.0)
    with pytest.raises(LinkError, match="expected all its parameters, got 37 of 40: the link is bad"):
        read.poll(20.0)


def test_what_is_no_number_is_null_to_machines() -> None:
    asked = parse_mission(json.dumps(question()), "mission")
    values = {"WPNAV_ACCEL": math.nan, "WPNAV_SPEED": math.inf, "WPNAV_RADIUS": 200.0}
    held_now = HeldParameters(
        1, "ardupilot", "copter", {name: ParameterValue(name, value, REAL32) for name, value in values.items()}
    )
    [found] = check_parameters([held_now], asked)
    document = json.loads(json.dumps(found.as_json(held_now), allow_nan=False))
    assert document["parameters"] == {"WPNAV_ACCEL": None, "WPNAV_SPEED": None, "WPNAV_RADIUS": 200.0}
    assert {d["name"]: d["held"] for d in document["differences"]} == {"WPNAV_ACCEL": None, "WPNAV_SPEED": None}
