"""One parameter: read, set, refused, unknown, lost, doubled; and its numbers on the wire."""

from __future__ import annotations

import math
import struct
from types import SimpleNamespace

import pytest
from pymavlink import mavparm
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_protocol import Party
from adapters.parameter_protocol import (
    Message,
    ParameterRead,
    ParameterSet,
    ParameterValue,
    from_wire,
    parameter_name,
    to_wire,
)
from missionplanner.errors import LinkError
from missionplanner.vehicle import Autopilot

PARTY = Party("uav3", 3)
INT8, INT16, INT32, REAL32 = (
    mavlink.MAV_PARAM_TYPE_INT8,
    mavlink.MAV_PARAM_TYPE_INT16,
    mavlink.MAV_PARAM_TYPE_INT32,
    mavlink.MAV_PARAM_TYPE_REAL32,
)
BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])


def sent(message: Message, sysid: int = 3, component: int = 1) -> Message:
    message.pack(mavlink.MAVLink(None, srcSystem=sysid, srcComponent=component))
    return message


def value(name: str, wire: float, kind: int = REAL32, sysid: int = 3, component: int = 1) -> Message:
    return sent(mavlink.MAVLink_param_value_message(name.encode(), wire, kind, 900, 65_535), sysid, component)


def failure(name: str, error: int, target: int = 255) -> Message:
    return sent(mavlink.MAVLink_param_error_message(target, 190, name.encode(), -1, error))


def names(messages: list[Message]) -> list[str]:
    return [f"{m.get_type()} {parameter_name(m)}" for m in messages]


# reading


def test_it_is_asked_for_by_name_until_it_is_answered() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT"])
    [first] = read.poll(10.0)
    assert (first.target_system, first.target_component, first.param_index) == (3, 1, -1)
    assert parameter_name(first) == "RTL_ALT"
    assert read.poll(10.6) == []
    assert names(read.poll(10.7)) == ["PARAM_REQUEST_READ RTL_ALT"]
    read.receive(value("RTL_ALT", 1500.0, INT32), 10.8)
    assert read.done
    assert read.held == ParameterValue("RTL_ALT", 1500.0, INT32)
    assert read.poll(99.0) == []
    read.receive(value("RTL_ALT", 7.0, INT32), 11.0)  # doubled, or set by somebody else: no longer ours
    assert read.held.value == 1500.0


@pytest.mark.parametrize(
    "stray",
    [
        value("RTL_ALT", 1.0, sysid=4),
        value("RTL_ALT", 1.0, component=190),
        value("RTL_ALT_TYPE", 1.0),
        value("RTL_AL", 1.0),
        failure("RTL_ALT", mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST, target=7),
        failure("OTHER", mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST),
    ],
)
def test_only_the_vehicles_word_on_it_counts(stray: Message) -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT"])
    read.poll(0.0)
    read.receive(stray, 0.1)
    assert not read.done
    assert read.held is None
    assert read.poll(0.1) == []


def test_nothing_counts_before_it_was_asked_for() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT"])
    read.receive(value("RTL_ALT", 1.0), 0.0)
    assert not read.done


def test_the_name_that_is_answered_is_the_one_that_the_firmware_has() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT", "RTL_ALT_M"])
    assert names(read.poll(0.0)) == ["PARAM_REQUEST_READ RTL_ALT", "PARAM_REQUEST_READ RTL_ALT_M"]
    read.receive(value("RTL_ALT_M", 15.0), 0.1)
    assert read.held == ParameterValue("RTL_ALT_M", 15.0, REAL32)


def test_a_name_of_16_characters_has_no_end_mark() -> None:
    name = "ABCDEFGHIJKLMNOP"
    read = ParameterRead(PARTY, "px4", [name])
    read.poll(0.0)
    codec = mavlink.MAVLink(None)
    [message] = codec.parse_buffer(value(name, 2.5).get_msgbuf())
    read.receive(message, 0.1)
    assert read.held == ParameterValue(name, 2.5, REAL32)


def test_silence_is_an_error_that_names_it() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT", "RTL_ALT_M"], patience_s=3.0)
    tries = sum(1 for k in range(30) if read.poll(0.1 * k))
    assert tries == 5
    with pytest.raises(LinkError) as error:
        read.poll(9.0)
    assert str(error.value).startswith(
        "uav3 (sysid 3): expected parameter RTL_ALT or RTL_ALT_M, got no answer to 5 requests: its firmware does not"
    )


def test_newest_firmware_says_at_once_that_it_does_not_have_it() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT", "RTL_ALT_M"])
    read.poll(0.0)
    read.receive(failure("RTL_ALT", mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST), 0.1)
    assert not read.done
    assert read.poll(0.2) == []
    read.receive(failure("RTL_ALT_M", mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST), 0.2)
    with pytest.raises(LinkError, match="expected parameter RTL_ALT or RTL_ALT_M, its firmware does not have it"):
        read.poll(0.3)


def test_silence_alone_proves_no_absence() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT_TYPE"], witness="RTL_ALT", patience_s=5.0)
    for k in range(50):
        read.poll(0.1 * k)
        if k == 20:
            read.receive(value("RTL_ALT", 1500.0), 0.1 * k)
    assert not read.done
    with pytest.raises(LinkError, match="RTL_ALT_TYPE, got no answer"):
        read.poll(9.0)


def test_an_absence_is_proven_by_many_answers_about_another() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT_TYPE"], witness="RTL_ALT")
    asked = 0
    now_s = 0.0
    while not read.done:
        if messages := read.poll(now_s):
            asked += 1
            assert names(messages) == ["PARAM_REQUEST_READ RTL_ALT_TYPE", "PARAM_REQUEST_READ RTL_ALT"]
            for _ in range(5):  # however often it is doubled
                read.receive(value("RTL_ALT", 1500.0), now_s)
        now_s += 0.1
    assert asked == 12
    assert read.held is None


def test_an_optional_parameter_that_is_there_is_read() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT_TYPE"], witness="RTL_ALT")
    read.poll(0.0)
    read.receive(value("RTL_ALT", 1500.0), 0.1)
    read.receive(value("RTL_ALT_TYPE", 1.0, INT8), 0.2)
    assert read.held == ParameterValue("RTL_ALT_TYPE", 1.0, INT8)


def test_a_type_that_nobody_knows_is_an_error() -> None:
    read = ParameterRead(PARTY, "ardupilot", ["RTL_ALT"])
    read.poll(0.0)
    read.receive(value("RTL_ALT", 1.0, mavlink.MAV_PARAM_TYPE_REAL64), 0.1)
    with pytest.raises(LinkError, match="parameter RTL_ALT: unknown parameter type 10"):
        read.poll(0.2)


# setting


@BOTH
def test_it_is_set_with_the_type_that_the_vehicle_has(autopilot: Autopilot) -> None:
    change = ParameterSet(PARTY, autopilot, ParameterValue("RTL_X", 1500.0, INT32), 4200.0)
    [first] = change.poll(0.0)
    wire = 4200.0 if autopilot == "ardupilot" else struct.unpack("<f", struct.pack("<i", 4200))[0]
    assert (first.target_system, first.target_component, first.param_type) == (3, 1, INT32)
    assert (parameter_name(first), first.param_value) == ("RTL_X", wire)
    assert change.poll(0.6) == []
    assert names(change.poll(0.7)) == ["PARAM_SET RTL_X", "PARAM_REQUEST_READ RTL_X"]
    change.receive(value("RTL_X", wire, INT32), 0.8)
    assert change.done
    assert change.poll(9.0) == []


@pytest.mark.parametrize(
    "stray",
    [
        value("RTL_ALT", 4200.0, INT32, sysid=9),
        value("RTL_ALT_M", 4200.0, INT32),
        value("RTL_ALT", 4200.0, REAL32),
        value("RTL_ALT", 1500.0, INT32),  # an answer to a request to read, late or doubled
    ],
)
def test_no_other_answer_confirms_it_and_none_refuses_it_at_once(stray: Message) -> None:
    change = ParameterSet(PARTY, "ardupilot", ParameterValue("RTL_ALT", 1500.0, INT32), 4200.0)
    change.poll(0.0)
    change.receive(stray, 0.1)
    assert not change.done
    assert names(change.poll(0.7))[0] == "PARAM_SET RTL_ALT"
    change.receive(value("RTL_ALT", 4200.0, INT32), 0.8)
    assert change.done


def test_a_value_that_stays_another_is_an_error_naming_sent_and_read() -> None:
    change = ParameterSet(PARTY, "px4", ParameterValue("RTL_RETURN_ALT", 60.0, REAL32), 200.0, patience_s=3.0)
    for k in range(30):
        if change.poll(0.1 * k):
            change.receive(value("RTL_RETURN_ALT", 150.0), 0.1 * k)
    with pytest.raises(LinkError) as error:
        change.poll(9.0)
    assert str(error.value) == "uav3 (sysid 3): parameter RTL_RETURN_ALT: sent 200, the vehicle holds 150"


def test_a_set_that_nobody_answers_is_an_error_that_says_what_it_may_hold() -> None:
    change = ParameterSet(PARTY, "px4", ParameterValue("RTL_RETURN_ALT", 60.0, REAL32), 45.0, patience_s=2.0)
    for k in range(20):
        change.poll(0.1 * k)
    with pytest.raises(LinkError, match=r"expected an answer to PARAM_SET, got none to 3; it may hold 60 or 45: check"):
        change.poll(9.0)


def test_a_refusal_is_told_with_its_reason() -> None:
    change = ParameterSet(PARTY, "px4", ParameterValue("RTL_RETURN_ALT", 60.0, REAL32), 900.0)
    change.poll(0.0)
    change.receive(failure("RTL_RETURN_ALT", mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE), 0.1)
    with pytest.raises(LinkError, match=r"RTL_RETURN_ALT: refused 900 \(out of its range\); it holds 60"):
        change.poll(0.2)


@BOTH
@pytest.mark.parametrize(
    ("kind", "number", "why"),
    [
        (INT16, 40_000.0, "beyond the range"),
        (INT8, -129.0, "beyond the range"),
        (INT32, 1.5, "not a whole number"),
        (INT32, math.nan, "not a whole number"),
        (INT32, math.inf, "not a whole number"),
        (11, 1.0, "unknown parameter type 11"),
    ],
)
def test_what_a_type_cannot_hold_is_not_sent(autopilot: Autopilot, kind: int, number: float, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        to_wire(number, kind, autopilot)


def test_what_the_field_cannot_carry_is_not_sent() -> None:
    with pytest.raises(ValueError, match="not exactly carried"):
        to_wire(16_777_217.0, INT32, "ardupilot")  # 2^24 + 1
    assert from_wire(to_wire(16_777_217.0, INT32, "px4"), INT32, "px4") == 16_777_217.0
    assert math.isnan(from_wire(0.5, INT32, "ardupilot"))
    assert math.isnan(from_wire(math.nan, INT32, "ardupilot"))


@pytest.mark.parametrize(
    ("kind", "number"),
    [
        *[(kind, n) for kind in (1, 3, 5) for n in (0, 1, 200)],
        *[(kind, n) for kind in (2, 4, 6) for n in (-128, -1, 0, 127)],
        *[(3, 65_535), (4, -32_768), (5, 2**31 + 5), (6, -(2**31)), (6, 4200)],
    ],
)
def test_pymavlink_sends_the_same_bytes(kind: int, number: int) -> None:
    taken: list[float] = []
    peer = SimpleNamespace(
        param_set_send=lambda name, wire, parm_type: taken.append(wire),
        recv_match=lambda **_: SimpleNamespace(param_id="X"),
    )
    assert mavparm.MAVParmDict().mavset(peer, "X", number, parm_type=kind)
    assert struct.pack("<f", to_wire(float(number), kind, "px4")) == struct.pack("<f", taken[0])
