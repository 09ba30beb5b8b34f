"""Missions uploaded by MAVSDK over our own links, judged by our read-back."""

from __future__ import annotations

import builtins
import threading
import time
from typing import Any

import pytest

from adapters.endpoint import Endpoint, open_endpoint
from adapters.fleet_link import FleetLink, WallClock
from adapters.signing import Signing
from missionplanner.errors import MissionError
from missionplanner.vehicle import Autopilot
from sim.fleet import SimFleet, planned_vehicles, serve
from tests.plans import small_fleet
from tests.rig import Rig

KEY = bytes(range(32))


@pytest.mark.slow
@pytest.mark.parametrize(("autopilot", "signed"), [("ardupilot", False), ("px4", False), ("ardupilot", True)])
def test_mavsdk_uploads_what_reads_back_as_sent(autopilot: Autopilot, signed: bool) -> None:
    plan = small_fleet(autopilot, 3)
    ours, theirs = Signing(KEY, time.time), Signing(KEY, time.time)
    server = open_endpoint("tcpin:127.0.0.1:0")
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame)
    fleet.attach(theirs.sealed(server) if signed else server)
    client = open_endpoint(server.url.replace("tcpin", "tcpout"))
    endpoint: Endpoint = ours.sealed(client) if signed else client
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(fleet, 1.0, stop.is_set), daemon=True)
    thread.start()
    link = FleetLink(plan, [endpoint], WallClock([endpoint]))
    told: list[tuple[str, int, int]] = []
    try:
        link.connect()
        link.upload(lambda *row: told.append(row), via="mavsdk")
        link.verify()
        assert set(link.held) == {1, 2, 3}
        assert {name for name, done, total in told if done == total} == {"uav1", "uav2", "uav3"}
        link.upload()  # and ours goes on as before
        link.verify()
    finally:
        stop.set()
        thread.join(10.0)
        link.close()
        fleet.close()


def test_without_mavsdk_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    original = builtins.__import__

    def missing(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.partition(".")[0] == "mavsdk":
            raise ImportError("No module named 'mavsdk'")
        return original(name, *args, **kwargs)

    rig = Rig(small_fleet("px4", 1))
    rig.link.connect()
    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(
        MissionError, match=r"--via mavsdk: expected the package mavsdk, .*pip install 'missionplanner\[m"
    ):
        rig.link.upload(via="mavsdk")
