"""Commands, parameters and telemetry as ground stations see them."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from missionplanner.vehicle import Autopilot
from tests.simulated import HOME, LAT, LON, NAN, Ground, mission, of_type

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
ACCEPTED = mavlink.MAV_RESULT_ACCEPTED


@BOTH
def test_a_vehicle_says_who_it_is(autopilot: Autopilot) -> None:
    heard = Ground(autopilot).run(3.0)
    beats = of_type(heard, "HEARTBEAT")
    assert len(beats) == pytest.approx(3, abs=1)
    expected = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA if autopilot == "ardupilot" else mavlink.MAV_AUTOPILOT_PX4
    assert {(b.autopilot, b.type, b.get_srcSystem(), b.get_srcComponent()) for b in beats} == {
        (expected, mavlink.MAV_TYPE_QUADROTOR, 1, 1)
    }


@BOTH
def test_positions_come_five_times_a_second_and_are_right(autopilot: Autopilot) -> None:
    positions = of_type(Ground(autopilot).run(4.0), "GLOBAL_POSITION_INT")
    assert len(positions) == pytest.approx(20, abs=1)
    last = positions[-1]
    assert (last.lat, last.lon, last.alt, last.relative_alt) == (LAT, LON, 584_000, 0)


@BOTH
def test_everything_that_a_ground_station_waits_for_is_sent(autopilot: Autopilot) -> None:
    heard = {m.get_type() for m in Ground(autopilot).run(6.0)}
    assert heard >= {
        "HEARTBEAT",
        "SYS_STATUS",
        "GPS_RAW_INT",
        "GLOBAL_POSITION_INT",
        "LOCAL_POSITION_NED",
        "ATTITUDE",
        "VFR_HUD",
        "MISSION_CURRENT",
        "EXTENDED_SYS_STATE",
        "BATTERY_STATUS",
        "EKF_STATUS_REPORT" if autopilot == "ardupilot" else "ESTIMATOR_STATUS",
    }


@BOTH
def test_health_turns_good_when_a_cold_vehicle_is_ready(autopilot: Autopilot) -> None:
    ground = Ground(autopilot, cold_start=True)
    early = of_type(ground.run(5.0), "SYS_STATUS")[-1]
    late = of_type(ground.run(45.0), "SYS_STATUS")[-1]
    prearm = mavlink.MAV_SYS_STATUS_PREARM_CHECK
    assert not early.onboard_control_sensors_health & prearm
    assert late.onboard_control_sensors_health & late.onboard_control_sensors_present & prearm


@BOTH
def test_a_heartbeat_comes_every_second_armed_or_not(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    ground.run(3.0)
    while not of_type(ground.run(0.05), "HEARTBEAT"):
        pass
    ground.arm()
    assert of_type(ground.run(0.5), "HEARTBEAT") == []
    [beat] = of_type(ground.run(0.6), "HEARTBEAT")
    assert beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_battery_drains_in_the_air_only() -> None:
    ground = Ground("ardupilot")
    ground.run(30.0)
    assert of_type(ground.heard, "SYS_STATUS")[-1].battery_remaining == 100
    ground.upload(mission("ardupilot", mavlink.MAV_CMD_NAV_LOITER_UNLIM))
    ground.mode("GUIDED")
    ground.arm()
    ground.start()
    heard = of_type(ground.run(400.0), "SYS_STATUS")
    assert heard[-1].battery_remaining == pytest.approx(100 - 400 / 36, abs=1)
    assert heard[-1].voltage_battery < heard[0].voltage_battery


@BOTH
def test_requested_messages_come(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    for number, name in ((148, "AUTOPILOT_VERSION"), (242, "HOME_POSITION"), (49, "GPS_GLOBAL_ORIGIN")):
        replies = ground.send(
            mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, number, 0, 0, 0, 0, 0, 0)
        )
        assert [m.get_type() for m in replies] == ["COMMAND_ACK", name]
    assert ground.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 9999.0) != ACCEPTED
    assert ground.command(mavlink.MAV_CMD_REQUEST_MESSAGE, NAN) != ACCEPTED


def test_capabilities_promise_integer_missions() -> None:
    for autopilot in ("ardupilot", "px4"):
        ground = Ground(autopilot)  # type: ignore[arg-type]
        ground.command(mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1)
        (version,) = of_type(ground.heard, "AUTOPILOT_VERSION")
        assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        assert bool(version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_FTP) is (autopilot == "ardupilot")


def test_message_intervals_are_obeyed_and_told() -> None:
    ground = Ground("px4")
    assert ground.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 100_000) == ACCEPTED
    assert len(of_type(ground.run(2.0), "ATTITUDE")) == pytest.approx(20, abs=1)
    ground.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, 30)
    assert of_type(ground.heard, "MESSAGE_INTERVAL")[-1].interval_us == 100_000
    ground.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, -1)
    assert not of_type(ground.run(3.0), "ATTITUDE")
    ground.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 0)
    assert len(of_type(ground.run(3.0), "ATTITUDE")) == pytest.approx(3, abs=1)
    assert ground.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 9999, 1) != ACCEPTED


def test_data_streams_are_ardupilots() -> None:
    for autopilot, expected in (("ardupilot", 20), ("px4", 2)):
        ground = Ground(autopilot)  # type: ignore[arg-type]
        ground.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_EXTRA1, 10, 1))
        assert len(of_type(ground.run(2.0), "ATTITUDE")) == pytest.approx(expected, abs=1)


def test_interval_shorter_than_a_tick_sends_once_a_tick() -> None:
    ground = Ground("px4")
    ground.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 30, 1)
    assert len(of_type(ground.run(1.0), "ATTITUDE")) == pytest.approx(20, abs=1)


@BOTH
def test_parameter_list_is_complete_and_numbered(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    first = ground.send(mavlink.MAVLink_param_request_list_message(1, 1))
    assert [(m.param_id, m.param_index) for m in first] == ([("_HASH_CHECK", 65_535)] if autopilot == "px4" else [])
    values = of_type(ground.run(1.0), "PARAM_VALUE")
    assert [v.param_index for v in values] == list(range(values[0].param_count))
    assert len({v.param_id for v in values}) == len(values)


@pytest.mark.parametrize(("autopilot", "name"), [("ardupilot", "WPNAV_SPEED"), ("px4", "MPC_XY_CRUISE")])
def test_speed_parameter_is_read_set_and_flown(autopilot: Autopilot, name: str) -> None:
    ground = Ground(autopilot)
    (value,) = ground.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    assert value.param_value == (1000.0 if autopilot == "ardupilot" else 5.0)
    ground.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), 3.0, mavlink.MAV_PARAM_TYPE_REAL32))
    assert ground.autopilot.default_speed_m_s == pytest.approx(0.03 if autopilot == "ardupilot" else 3.0)


def test_integers_are_cast_by_ardupilot_and_sent_by_their_bytes_by_px4() -> None:
    ardupilot, px4 = Ground("ardupilot"), Ground("px4")
    (value,) = ardupilot.send(mavlink.MAVLink_param_request_read_message(1, 1, b"DISARM_DELAY", -1))
    assert (value.param_value, value.param_type) == (10.0, mavlink.MAV_PARAM_TYPE_INT32)
    (value,) = px4.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NAV_RCL_ACT", -1))
    assert struct.unpack("<i", struct.pack("<f", value.param_value))[0] == 2
    seven = struct.unpack("<f", struct.pack("<i", 7))[0]
    px4.send(mavlink.MAVLink_param_set_message(1, 1, b"NAV_RCL_ACT", seven, mavlink.MAV_PARAM_TYPE_INT32))
    assert px4.autopilot.parameters["NAV_RCL_ACT"] == 7


def test_px4s_hash_changes_with_its_parameters() -> None:
    ground = Ground("px4")
    ask = mavlink.MAVLink_param_request_read_message(1, 1, b"_HASH_CHECK", -1)
    (before,), (same,) = ground.send(ask), ground.send(ask)
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"MPC_XY_CRUISE", 3.0, mavlink.MAV_PARAM_TYPE_REAL32))
    (after,) = ground.send(ask)
    assert before.get_payload() == same.get_payload() != after.get_payload()
    assert Ground("ardupilot").send(ask) == []


def test_unknown_parameters_and_nan_change_nothing() -> None:
    ground = Ground("ardupilot")
    before = dict(ground.autopilot.parameters)
    assert ground.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1)) == []
    assert ground.send(mavlink.MAVLink_param_set_message(1, 1, b"NO_SUCH", 1.0, 9)) == []
    for name in (b"WPNAV_SPEED", b"DISARM_DELAY"):
        ground.send(mavlink.MAVLink_param_set_message(1, 1, name, NAN, 9))
    assert dict(ground.autopilot.parameters) == before


def file_request(opcode: int, data: bytes = b"", size: int | None = None, offset: int = 0) -> Any:
    payload = struct.pack("<HBBBBBxI", 41, 0, opcode, len(data) if size is None else size, 0, 0, offset) + data
    return mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload.ljust(251, b"\0"))


@BOTH
def test_files_that_there_are_not_are_refused_at_once(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    wanted = b"no_such_file" if autopilot == "ardupilot" else b"@PARAM/param.pck"
    (reply,) = ground.send(file_request(4, wanted))
    payload = bytes(reply.payload)
    assert int.from_bytes(payload[:2], "little") == 42
    assert (payload[3], payload[5], payload[12]) == (129, 4, 10)
    (reply,) = ground.send(file_request(3, b"/"))
    assert (bytes(reply.payload)[3], bytes(reply.payload)[12]) == (129, 7)
    (reply,) = ground.send(file_request(15, size=80))  # of nothing opened
    assert (bytes(reply.payload)[3], bytes(reply.payload)[12]) == (129, 4)


@pytest.mark.parametrize("burst", [True, False])
@pytest.mark.parametrize("query", [b"", b"?withdefaults=1"])
def test_ardupilot_gives_its_parameters_as_a_file(burst: bool, query: bytes) -> None:
    """Decoded by a real client's decoder."""
    param_ftp = pytest.importorskip("MAVProxy.modules.lib.param_ftp", reason="MAVProxy is not installed")
    ground = Ground("ardupilot")
    before = dict(ground.autopilot.parameters)
    ground.send(mavlink.MAVLink_param_set_message(1, 1, b"RTL_ALT", 2500.0, mavlink.MAV_PARAM_TYPE_INT32))
    (opened,) = ground.send(file_request(4, b"@PARAM/param.pck" + query))
    total = int.from_bytes(bytes(opened.payload)[12:16], "little")
    data = b""
    while len(data) < total:
        replies = ground.send(file_request(15 if burst else 5, size=80, offset=len(data)))
        for k, reply in enumerate(replies):
            payload = bytes(reply.payload)
            assert int.from_bytes(payload[:2], "little") == 42 + k
            assert int.from_bytes(payload[8:12], "little") == len(data)
            data += payload[12 : 12 + payload[4]]
            assert bool(payload[6]) is (burst and len(data) == total)
    (end,) = ground.send(file_request(5, size=80, offset=total))
    assert (bytes(end.payload)[3], bytes(end.payload)[12]) == (129, 6)
    decoded = param_ftp.ftp_param_decode(data)
    read = {name.decode(): value for name, value, _ in decoded.params}
    assert read == pytest.approx(ground.autopilot.parameters)
    assert read["RTL_ALT"] == 2500
    if query:
        assert {name.decode(): value for name, value, _ in decoded.defaults} == pytest.approx(before)
    assert ground.send(file_request(1))


def test_ping_and_timesync_are_answered() -> None:
    ground = Ground("px4")
    ground.run(1.0)
    (pong,) = ground.send(mavlink.MAVLink_ping_message(123, 7, 0, 0))
    assert (pong.time_usec, pong.seq, pong.target_system) == (123, 7, 255)
    (sync,) = ground.send(mavlink.MAVLink_timesync_message(0, 55))
    assert (sync.tc1, sync.ts1) == (1_000_000_000, 55)


def answer(ground: Ground, number: int, *params: float) -> int | None:
    """Return the result that a command is acknowledged with, None where it is not."""
    seven = (*params, *[0.0] * (7 - len(params)))
    replies = ground.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *seven))
    acks = [m.result for m in of_type(replies, "COMMAND_ACK")]
    assert len(acks) <= 1
    return int(acks[0]) if acks else None


DENIED, FAILED, UNSUPPORTED = (
    mavlink.MAV_RESULT_DENIED,
    mavlink.MAV_RESULT_FAILED,
    mavlink.MAV_RESULT_UNSUPPORTED,
)


@pytest.mark.parametrize(
    ("command", "ardupilot", "px4"),
    [  # without a camera; ArduPilot's: GCS_MAVLINK::handle_command_int_packet, AP_Camera; PX4's: Commander, Navigator
        ((mavlink.MAV_CMD_DO_SET_ROI,), ACCEPTED, ACCEPTED),
        ((mavlink.MAV_CMD_DO_SET_ROI_LOCATION,), ACCEPTED, ACCEPTED),
        ((mavlink.MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET,), UNSUPPORTED, ACCEPTED),
        ((mavlink.MAV_CMD_DO_SET_ROI_NONE,), ACCEPTED, ACCEPTED),
        ((mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST, 5.0), ACCEPTED, None),
        ((mavlink.MAV_CMD_DO_DIGICAM_CONTROL,), ACCEPTED, None),
        ((mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0.0, 0.0, 1.0), FAILED, UNSUPPORTED),
        ((mavlink.MAV_CMD_IMAGE_STOP_CAPTURE,), ACCEPTED, UNSUPPORTED),
        ((mavlink.MAV_CMD_DO_GO_AROUND,), UNSUPPORTED, None),
        ((mavlink.MAV_CMD_DO_LAND_START,), FAILED, UNSUPPORTED),
        ((mavlink.MAV_CMD_DO_SET_SERVO, 9.0, 1500.0), ACCEPTED, UNSUPPORTED),
        ((31_999,), UNSUPPORTED, UNSUPPORTED),
        ((mavlink.MAV_CMD_DO_SET_MODE,), UNSUPPORTED, UNSUPPORTED),
        ((mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, 5.0, -1.0), FAILED, ACCEPTED),  # Mode::set_speed_xy: not in STABILIZE
        ((mavlink.MAV_CMD_GET_HOME_POSITION,), ACCEPTED, ACCEPTED),
        ((mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, 1.0), FAILED, FAILED),  # there is none
        ((mavlink.MAV_CMD_MISSION_START,), FAILED, mavlink.MAV_RESULT_TEMPORARILY_REJECTED),
        ((mavlink.MAV_CMD_NAV_TAKEOFF,), FAILED, ACCEPTED),  # ArduCopter: disarmed, not in GUIDED
    ],
)
def test_commands_are_answered_as_real_vehicles_answer_them(
    command: tuple[float, ...], ardupilot: int | None, px4: int | None
) -> None:
    number, *params = command
    assert answer(Ground("ardupilot"), int(number), *params) == ardupilot
    assert answer(Ground("px4"), int(number), *params) == px4


def test_ardupilot_takes_a_speed_where_it_flies_somewhere() -> None:
    """GCS_MAVLINK_Copter::handle_MAV_CMD_DO_CHANGE_SPEED: FAILED unless above 0 and of use in the mode."""
    ground = Ground("ardupilot")
    ground.mode("GUIDED")
    assert answer(ground, mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, 6.0) == ACCEPTED
    for useless in (0.0, -1.0, NAN):
        assert answer(ground, mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, useless) == FAILED
    assert ground.autopilot.speed_m_s == 6.0
    plane = Ground("ardupilot", "plane")
    plane.mode("GUIDED")
    assert answer(plane, mavlink.MAV_CMD_DO_CHANGE_SPEED, 0.0, 16.0) == ACCEPTED
    assert answer(plane, mavlink.MAV_CMD_DO_CHANGE_SPEED, 0.0, 90.0) == FAILED  # outside its airspeed limits


def test_a_start_at_an_item_is_px4s() -> None:
    """ArduPilot: "first-item/last item not supported"; PX4 begins at param1, -1 being where it is."""
    ardupilot, px4 = Ground("ardupilot"), Ground("px4")
    for ground in (ardupilot, px4):
        ground.upload(mission(ground.autopilot.personality.autopilot))
    assert answer(ardupilot, mavlink.MAV_CMD_MISSION_START, 0.0, 5.0) == DENIED
    assert answer(ardupilot, mavlink.MAV_CMD_MISSION_START, 1.0, 0.0) == DENIED
    for beyond in (5.0, -2.0, NAN):
        assert answer(px4, mavlink.MAV_CMD_MISSION_START, beyond) == DENIED
    assert answer(px4, mavlink.MAV_CMD_MISSION_START, 2.0, 4.0) == ACCEPTED
    assert px4.autopilot.current == 2
    assert answer(px4, mavlink.MAV_CMD_MISSION_START, -1.0) == ACCEPTED
    assert px4.autopilot.current == 2


@BOTH
@pytest.mark.parametrize("value", [NAN, float("inf"), -1.0, 1e30])
def test_no_number_makes_a_command_fail_badly(autopilot: Autopilot, value: float) -> None:
    ground = Ground(autopilot)
    for number in ground.vehicle._commands:
        ground.command(number, *[value] * 7)
    ground.run(1.0)
    assert ground.autopilot.position_m[:2] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_home_can_be_asked_for_and_moved() -> None:
    ground = Ground("ardupilot")
    ground.command(mavlink.MAV_CMD_GET_HOME_POSITION)
    home = of_type(ground.heard, "HOME_POSITION")[-1]
    assert (home.latitude, home.longitude, home.altitude) == (LAT, LON, round(HOME.alt_amsl_m * 1e3))
    moved = mavlink.MAVLink_command_int_message(
        1, 1, 0, mavlink.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, 0, 0, LAT + 100, LON, 590.0
    )
    ground.send(moved)
    home = of_type(ground.run(0.1), "HOME_POSITION")[-1]
    assert (home.latitude, home.altitude) == (LAT + 100, 590_000)


def test_commands_to_others_are_not_ours() -> None:
    ground = Ground("ardupilot")
    other = mavlink.MAVLink_command_long_message(2, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    assert ground.send(other) == []
    everybody = mavlink.MAVLink_command_long_message(0, 0, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    assert [m.result for m in ground.send(everybody)] == [ACCEPTED]


def test_old_clients_set_modes_by_message() -> None:
    ground = Ground("ardupilot")
    ground.send(mavlink.MAVLink_set_mode_message(1, 1, 4))
    assert ground.autopilot.mode.name == "GUIDED"
    (ack,) = ground.send(mavlink.MAVLink_set_mode_message(1, 1, 77))
    assert ack.result == mavlink.MAV_RESULT_FAILED
    assert ground.autopilot.mode.name == "GUIDED"
