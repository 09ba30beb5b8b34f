"""Return heights that our link sets, read by pymavlink's own ground station on the same vehicles."""

from __future__ import annotations

import struct
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace

import pytest
from pymavlink import mavutil

from adapters.endpoint import open_endpoint
from adapters.fleet_link import FleetLink, WallClock
from missionplanner.vehicle import Autopilot
from sim.fleet import SimFleet, planned_vehicles, serve
from tests.plans import small_fleet

EXPECTED: dict[Autopilot, dict[str, float]] = {
    "ardupilot": {"RTL_ALT": 4250, "RTL_CONE_SLOPE": 0.0, "RTL_CLIMB_MIN": 0},
    "px4": {"RTL_RETURN_ALT": 42.5, "RTL_CONE_ANG": 0, "RTL_TYPE": 0},
}


@contextmanager
def served(fleet: SimFleet) -> Iterator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(fleet, 5.0, stop.is_set), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        fleet.close()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_pymavlink_reads_what_we_have_set(autopilot: Autopilot) -> None:
    plan = small_fleet(autopilot, 1)
    [vehicle] = plan.vehicles
    plan = replace(plan, vehicles=(replace(vehicle, motion=replace(vehicle.motion, return_height_m=42.5)),))
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame)
    listener = open_endpoint("tcpin:127.0.0.1:0")
    fleet.attach(listener)
    port = int(listener.url.rsplit(":", 1)[1])
    with served(fleet):
        with closing(open_endpoint(f"tcp:127.0.0.1:{port}")) as ground:
            link = FleetLink(plan, [ground], WallClock([ground]))
            link.connect()
            changes = link.set_returns()
        assert {change.name for change in changes} <= set(EXPECTED[autopilot])
        with closing(mavutil.mavlink_connection(f"tcp:127.0.0.1:{port}", source_system=254)) as peer:
            assert peer.wait_heartbeat(timeout=20) is not None
            for name, value in EXPECTED[autopilot].items():
                peer.param_fetch_one(name)
                answer = peer.recv_match(
                    type="PARAM_VALUE", condition=f"PARAM_VALUE.param_id=='{name}'", blocking=True, timeout=20
                )
                assert answer is not None
                read = answer.param_value
                if autopilot == "px4" and answer.param_type == mavutil.mavlink.MAV_PARAM_TYPE_INT32:
                    (read,) = struct.unpack("<i", struct.pack("<f", read))
                assert read == value
