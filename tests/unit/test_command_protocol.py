"""One command: sent, repeated, answered, refused, not answered."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.command_protocol import Command, Message, command_name
from adapters.mission_protocol import OWN_COMPONENT
from missionplanner.errors import LinkError

ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM


def ack(result: int, command: int = ARM, sysid: int = 3, target: int = 255, component: int = 0) -> Message:
    message = mavlink.MAVLink_command_ack_message(command, result, 0, 0, target, component)
    message.pack(mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1))
    return message


def test_it_is_repeated_with_a_rising_confirmation_until_answered() -> None:
    command = Command("uav3", 3, ARM, 1.0)
    [first] = command.poll(10.0)
    assert (first.target_system, first.target_component, first.command) == (3, 1, ARM)
    assert (first.param1, first.param2, first.param7, first.confirmation) == (1.0, 0.0, 0.0, 0)
    assert command.poll(10.6) == []
    assert [m.confirmation for m in command.poll(10.7)] == [1]
    command.receive(ack(0), 10.8)
    assert command.result == 0
    assert command.poll(20.0) == []


@pytest.mark.parametrize("stray", [ack(0, sysid=4), ack(0, command=22), ack(0, target=7), ack(0, component=230)])
def test_only_the_answer_to_it_counts(stray: Message) -> None:
    command = Command("uav3", 3, ARM, 1.0)
    command.poll(0.0)
    command.receive(stray, 0.1)
    assert command.result is None


def test_an_answer_that_names_our_component_counts() -> None:
    command = Command("uav3", 3, ARM, 1.0)
    command.poll(0.0)
    command.receive(ack(0, component=OWN_COMPONENT), 0.1)
    assert command.result == 0


def test_an_answer_to_nobody_in_particular_counts() -> None:
    command = Command("uav3", 3, ARM, 1.0)
    command.poll(0.0)
    command.receive(ack(4, target=0), 0.1)
    assert command.result == 4
    command.receive(ack(0), 0.2)
    assert command.result == 4


def test_silence_is_an_error() -> None:
    command = Command("uav3", 3, ARM, 1.0, patience_s=2.0)
    with pytest.raises(LinkError, match=r"uav3 \(sysid 3\): expected an answer to COMPONENT_ARM_DISARM, got none"):
        for k in range(100):
            command.poll(0.1 * k)


def test_rejected_for_now_is_asked_again_until_patience_ends() -> None:
    command = Command("uav3", 3, ARM, 1.0, patience_s=5.0)
    command.poll(0.0)
    command.receive(ack(mavlink.MAV_RESULT_TEMPORARILY_REJECTED), 0.1)
    assert command.result is None
    assert command.poll(1.0) == []
    assert len(command.poll(1.2)) == 1
    command.receive(ack(mavlink.MAV_RESULT_TEMPORARILY_REJECTED), 4.9)
    assert command.result == mavlink.MAV_RESULT_TEMPORARILY_REJECTED


def test_in_progress_is_waited_for() -> None:
    command = Command("uav3", 3, ARM, 1.0, patience_s=2.0)
    command.poll(0.0)
    command.receive(ack(mavlink.MAV_RESULT_IN_PROGRESS), 1.9)
    assert command.poll(3.0) == []
    command.receive(ack(0), 6.0)
    assert command.result == 0


def test_names() -> None:
    assert command_name(16) == "NAV_WAYPOINT"
    assert command_name(65_000) == "command 65000"
