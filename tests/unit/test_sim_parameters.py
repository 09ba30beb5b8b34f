"""Simulated vehicles hold the parameters of their motion, and fly by what they are set to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem
from missionplanner.autopilot_parameters import Kind, Parameter, held, parameters, value_of, with_values
from missionplanner.geodesy import FloatArray
from missionplanner.motion import TICK_S
from sim.fleet import SimFleet, SimVehicle, sim_vehicles
from tests.simulated import HOME, LAT, LON, Ground, mission, of_type, renumbered

KINDS: list[Kind] = [("ardupilot", "copter"), ("ardupilot", "plane"), ("px4", "copter"), ("px4", "plane")]
EACH = pytest.mark.parametrize("kind", KINDS)
# no simulated flight shows these: what may be commanded, and what a plan never asks for
_UNSEEN = {"airspeed_limits_m_s.0", "airspeed_limits_m_s.1", "arducopter.return_final_height_m"}


# where three quarters of the usual value are out of range, or make no difference to a flight at 5 or 10 m/s
_OTHERS = {
    "arducopter.return_speed_m_s": 4.0,
    "arducopter.corner_acceleration_m_s2": 1.5,
    "arducopter.land_high_speed_m_s": 1.0,
    "arducopter.lean_auto_max_deg": 20.0,
    "plane.pitch_min_deg": -5.0,
    "plane.slope_min_m": 500.0,
    "plane.pitch_limits_deg.1": 10.0,
    "px4.return_wait_s": 3.0,
    "px4.takeoff_least_m": 25.0,
    "px4.speed_max_m_s": 3.0,
    "px4.tilt_max_deg": 20.0,
    "NAV_ACC_RAD": 5.0,
}


def other_value(parameter: Parameter) -> float:
    """Return another value within the range that single precision keeps."""
    for key in (parameter.field, parameter.name):
        if key in _OTHERS:
            return _OTHERS[key]
    value = 0.75 * parameter.default if parameter.low <= 0.75 * parameter.default else 1.5 * parameter.default
    spelling = parameter.spellings[0]
    return round(value * spelling.per_unit) / spelling.per_unit if spelling.whole else float(np.float32(value))


def returning(kind: Kind) -> list[MissionItem]:
    """Return a mission without a speed of its own: up, level corners, up and down, home."""
    amsl, relative = mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT
    far, top_m, rise_m = (20, 950.0, 80.0) if kind[1] == "plane" else (1, 629.0, 20.0)
    home = [MissionItem(0, 0, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT, y=LON, z=584.0)] if kind[0] == "ardupilot" else []
    north, east = 5_400 * far, 6_500 * far
    ends = [(north, 0, 604.0), (north, east, 604.0), (0, east, 604.0), (-north, east, top_m), (-north, 0, 604.0)]
    return renumbered(
        [
            *home,
            MissionItem(0, relative, mavlink.MAV_CMD_NAV_TAKEOFF, x=LAT + 4_000, y=LON, z=rise_m),
            *(MissionItem(0, amsl, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT + x, y=LON + y, z=z) for x, y, z in ends),
            MissionItem(0, mavlink.MAV_FRAME_MISSION, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH),
        ]
    )


def flown(vehicles: list[SimVehicle], sets: list[dict[str, int | float]], duration_s: float) -> FloatArray:
    """Return positions (N, T, 3) of vehicles, each set its own parameters on the ground, all sent off at once."""
    fleet = SimFleet([replace(vehicle, sysid=k) for k, vehicle in enumerate(vehicles, start=1)], seed=3)
    for link, values in zip(fleet.links, sets, strict=True):
        autopilot = link.autopilot
        autopilot.parameters.update(values)
        kind = autopilot.personality
        autopilot.set_mission(returning((kind.autopilot, kind.vehicle_class)), None, 0.0)
        if kind.autopilot == "ardupilot":
            autopilot.set_mode(kind.mode("GUIDED" if kind.vehicle_class == "copter" else "FBWA"), 0.0)
            assert autopilot.arm(0.0) == mavlink.MAV_RESULT_ACCEPTED
        assert autopilot.start_mission(0.0) == mavlink.MAV_RESULT_ACCEPTED
    track = []
    for _ in range(round(duration_s / TICK_S)):
        fleet.step()
        track.append(fleet.navigator.position_m.copy())
    return np.array(track).transpose(1, 0, 2)


@EACH
def test_what_is_set_flies_like_what_was_built_in(kind: Kind) -> None:
    autopilot, vehicle_class = kind
    [vehicle] = sim_vehicles(1, HOME, autopilot=autopilot, vehicle_class=vehicle_class)
    vehicles, sets, names = [vehicle], [{}], []
    for parameter in parameters(kind):
        if parameter.sent or parameter.field in _UNSEEN:
            continue
        model = with_values(vehicle.motion, {parameter.field: other_value(parameter)})
        value = held(kind, model)[parameter.name]
        assert value != held(kind, vehicle.motion)[parameter.name]
        vehicles += [vehicle, replace(vehicle, motion=model)]
        sets += [{parameter.name: value}, {}]
        names.append(parameter.name)
    usual, *others = flown(vehicles, sets, 600.0 if vehicle_class == "plane" else 240.0)
    for name, set_so, built_so in zip(names, others[::2], others[1::2], strict=True):
        np.testing.assert_allclose(set_so, built_so, atol=1e-6, err_msg=name)
        assert np.abs(set_so - usual).max() > 0.02, f"{name} changes nothing"


@EACH
def test_a_vehicle_holds_what_its_model_says(kind: Kind) -> None:
    autopilot, vehicle_class = kind
    [vehicle] = sim_vehicles(1, HOME, autopilot=autopilot, vehicle_class=vehicle_class)
    holds = SimFleet([vehicle]).links[0].autopilot.parameters
    for parameter in parameters(kind):
        spelling = parameter.spellings[0]
        if not parameter.sent:
            planned = value_of(vehicle.motion, parameter.field) * spelling.per_unit
            assert holds[parameter.name] == pytest.approx(planned, rel=1e-7)
        assert isinstance(holds[parameter.name], int) == spelling.whole or parameter.sent


def test_a_parameter_set_in_flight_counts_from_the_next_route_on() -> None:
    ground = Ground("ardupilot")
    ground.upload(mission("ardupilot", speed_m_s=8.0))
    ground.mode("GUIDED")
    ground.arm()
    ground.start()
    ground.run(25.0)
    name = b"WPNAV_SPEED"
    ground.send(mavlink.MAVLink_param_set_message(1, 1, name, 400.0, mavlink.MAV_PARAM_TYPE_REAL32))
    before = ground.run(3.0)
    ground.mode("RTL")
    after = ground.run(25.0)

    def fastest(messages: list[object]) -> float:
        positions = of_type(messages, "GLOBAL_POSITION_INT")
        return max(float(np.hypot(m.vx, m.vy)) / 100.0 for m in positions)

    assert fastest(before) > 6.0
    assert 3.5 < fastest(after[len(after) // 2 :]) < 4.5


def test_values_that_no_vehicle_could_fly_by_are_held_and_change_nothing() -> None:
    ground = Ground("ardupilot")
    before = ground.autopilot._by_parameters()
    real = mavlink.MAV_PARAM_TYPE_REAL32
    [answer] = ground.send(mavlink.MAVLink_param_set_message(1, 1, b"WPNAV_RADIUS", -3.0, real))
    assert answer.param_value == -3.0
    assert ground.autopilot._by_parameters() == before
