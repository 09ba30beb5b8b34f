"""Upload and flight over real sockets: one UDP port for all vehicles, a TCP port for each."""

from __future__ import annotations

import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.endpoint import Address, Endpoint, open_endpoint, parse_url
from adapters.export import export_fleet
from adapters.fleet_link import FleetLink, WallClock
from adapters.plan_file import read_plan
from adapters.telemetry_log import FleetLog, read_log
from missionplanner.plan import FleetPlan
from missionplanner.vehicle import Autopilot
from sim.fleet import LockstepClock, SimFleet, SimVehicle, connect_fleet, listen_fleet, serve
from tests.plans import small_fleet


def _sim(plan: FleetPlan) -> SimFleet:
    vehicles = [
        SimVehicle(v.sysid, v.autopilot, v.vehicle_class, plan.frame.geo_point(v.home_m), v.motion)
        for v in plan.vehicles
    ]
    return SimFleet(vehicles, frame=plan.frame)


def _free_address() -> Address:
    with closing(open_endpoint("tcpin:127.0.0.1:0")) as server:
        return replace(parse_url(server.url), kind="tcpout")


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_five_vehicles_on_one_udp_port(tmp_path: Path, autopilot: Autopilot) -> None:
    plan = small_fleet(autopilot, 5)
    export_fleet(plan, tmp_path)
    ground = open_endpoint("udpin:127.0.0.1:0")
    with closing(_sim(plan)) as sim, closing(ground):
        connect_fleet(sim, ground.url.replace("udpin", "udpout"))
        with FleetLog(tmp_path, {v.sysid: v.name for v in plan.vehicles}, 1.7e9) as log:
            link = FleetLink(plan, [ground], LockstepClock(sim), log=log)
            link.connect()
            link.upload()
            link.verify()
            link.start()
            flight = link.watch()
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s <= 0.2
    for vehicle in plan.vehicles:
        assert link.items[vehicle.sysid] == read_plan(tmp_path / f"{vehicle.name}.plan").items
        assert read_log(tmp_path / f"{vehicle.name}.tlog").lost_bytes == 0


def test_a_tcp_port_for_each_vehicle() -> None:
    plan = small_fleet("ardupilot", 3)
    with closing(_sim(plan)) as sim:
        first = _free_address()
        listen_fleet(sim, str(first))
        endpoints: list[Endpoint] = [open_endpoint(first.with_port_offset(10 * k)) for k in range(3)]
        link = FleetLink(plan, endpoints, LockstepClock(sim))
        with closing(link):
            link.connect()
            link.upload()
            link.verify()
            link.start()
            flight = link.watch()
    assert all(v.arrival_s is not None and v.landed_s is not None for v in flight.vehicles)


@pytest.mark.slow
def test_in_accelerated_real_time_the_flight_is_told_in_the_vehicles_own_time() -> None:
    plan = small_fleet("ardupilot", 3)
    ground = open_endpoint("udpin:127.0.0.1:0")
    sim = _sim(plan)
    connect_fleet(sim, ground.url.replace("udpin", "udpout"))
    stop = threading.Event()
    server = threading.Thread(target=serve, args=(sim, 10.0, stop.is_set))
    server.start()
    try:
        link = FleetLink(plan, [ground], WallClock([ground]))
        link.connect()
        link.upload()
        link.verify()
        link.start()
        flight = link.watch()
        link.close()
    finally:
        stop.set()
        server.join()
        sim.close()
    lockstep = _flown_in_lockstep(plan)
    spread_s = flight.arrival_spread_s
    assert spread_s is not None
    assert spread_s <= 0.5
    for arrival_s, expected_s in zip((v.arrival_s for v in flight.vehicles), lockstep, strict=True):
        assert arrival_s == pytest.approx(expected_s, abs=1.5)


def _flown_in_lockstep(plan: FleetPlan) -> list[float]:
    ground = open_endpoint("udpin:127.0.0.1:0")
    with closing(_sim(plan)) as sim, closing(ground):
        connect_fleet(sim, ground.url.replace("udpin", "udpout"))
        link = FleetLink(plan, [ground], LockstepClock(sim))
        link.connect()
        link.upload()
        link.verify()
        link.start()
        arrivals = [v.arrival_s for v in link.watch().vehicles]
    return [float(a) if a is not None else np.nan for a in arrivals]
