"""MAVSDK's importers of mission files, which want to see a vehicle first: one that does nothing but live."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from missionplanner.vehicle import Autopilot

_NUMBER = {"ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, "px4": mavlink.MAV_AUTOPILOT_PX4}


@contextmanager
def mavsdk_importer(autopilot: Autopilot) -> Iterator[Any]:
    """Yield a ``MissionRaw`` whose importers take the autopilot's files; skip the test where there is no MAVSDK."""
    mavsdk = pytest.importorskip("mavsdk", reason="MAVSDK is not installed")
    mission_raw = pytest.importorskip("mavsdk.plugins.mission_raw.mission_raw", reason="MAVSDK is not the native one")
    sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION))
    try:
        sdk.add_any_connection("raw://")  # no socket in between
        heart = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, _NUMBER[autopilot], 81, 0, 3, 3)
        deadline_s = time.monotonic() + 10.0
        while not sdk.get_systems() and time.monotonic() < deadline_s:
            sdk.pass_received_raw_bytes(beat.pack(heart))
            time.sleep(0.02)
        yield mission_raw.MissionRaw(sdk.get_systems()[0])
    finally:
        sdk.destroy()
