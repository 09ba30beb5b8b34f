"""``sim --fault``: words that mean something are served, others are refused in one line."""

from __future__ import annotations

import socket
import subprocess
import sys

import pytest
from pymavlink import mavutil

from tests.command_line import Cli, expect_line

SIM = ("sim", "--home", "34.3,-118.1,584", "--vehicles", "2")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("reboot", "vehicle N: FAULT"),
        ("vehicle 2: reboto", "'reboto' is none; faults are: reboot [at item N]"),
        ("vehicle 2: FailReadRequest", "FailReadRequest0NoResponse"),
        ("vehicle 3: reboot", "expected a vehicle from 1 to 2"),
        ("vehicle 1: no SUCH_MESSAGE", "'SUCH_MESSAGE'"),
    ],
)
def test_words_that_mean_no_fault_are_refused_in_one_line(cli: Cli, words: str, expected: str) -> None:
    expect_line(cli(*SIM, "--connect", "udpout:127.0.0.1:9", "--fault", words), 2, expected)


def test_a_fault_is_served_to_a_ground_station() -> None:
    """Vehicle 2 never tells how many items it has; vehicle 1 does."""
    link = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=255)
    port = link.port.getsockname()[1]
    assert link.port.type == socket.SOCK_DGRAM
    command = [
        sys.executable,
        "-c",
        "from missionplanner.cli import main; main()",
        *SIM,
        "--connect",
        f"udpout:127.0.0.1:{port}",
    ]
    served = subprocess.Popen([*command, "--fault", "vehicle 2: no MISSION_COUNT"], stderr=subprocess.PIPE)
    try:
        beats: set[int] = set()
        while beats != {1, 2}:
            message = link.recv_match(type="HEARTBEAT", blocking=True, timeout=60)
            assert message is not None, f"heard only {beats}"
            beats.add(message.get_srcSystem())
        counts = []
        for sysid in (2, 1):
            link.mav.mission_request_list_send(sysid, 1)
        for _ in range(3):
            message = link.recv_match(type="MISSION_COUNT", blocking=True, timeout=1.0)
            counts += [message.get_srcSystem()] if message is not None else []
        assert counts == [1]
    finally:
        served.terminate()
        served.communicate(timeout=30)
        link.close()
