"""What many items, many vehicles and much telemetry cost on loopback; the simulator is a process of its own."""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from multiprocessing.connection import Connection
from statistics import median

from adapters.endpoint import Endpoint, open_endpoint
from adapters.fleet_link import FleetLink, WallClock
from adapters.mission_items import plan_items
from missionplanner.experiments.campaign import begin
from missionplanner.experiments.link_trials import Client, fleet_plan, holds, mavsdk_items, mavsdk_systems
from missionplanner.plan import FleetPlan
from missionplanner.vehicle import Autopilot
from sim.fleet import SimFleet, connect_fleet, planned_vehicles, serve

_SETTLE_S = 1.0


@dataclass(frozen=True, slots=True)
class Load:
    """Vehicles with missions of so many items; times are medians, by the clock."""

    client: str
    autopilot: Autopilot
    vehicles: int
    items: int
    runs: int
    upload_s: float
    verified_s: float  # read back, too
    client_cpu_s: float  # processor time of the client until then


@dataclass(frozen=True, slots=True)
class Telemetry:
    """What serving vehicles in real time took."""

    vehicles: int
    position_hz: float
    duration_s: float
    core_share: float
    memory_mb: float  # of the process, all in all
    vehicles_mb: float  # beyond what it held with one vehicle
    messages_per_s: float
    kilobytes_per_s: float
    behind_s: float  # how far simulated time fell behind the clock


def uploads(client: Client, autopilot: Autopilot, vehicles: int, items: int, runs: int, seed: int) -> Load:
    """Upload to so many vehicles at once, read back, and look at what they hold.

    Raises
    ------
    LinkError
        An upload failed.
    """
    plan = fleet_plan(vehicles, items, autopilot, seed)
    once = _ours_once if client == "missionplanner" else _mavsdk_once
    found = [once(plan) for _ in range(runs)]
    upload_s, verified_s, cpu_s = (median(column) for column in zip(*found, strict=True))
    return Load(client, autopilot, vehicles, items, runs, upload_s, verified_s, cpu_s)


def _ours_once(plan: FleetPlan) -> tuple[float, float, float]:
    endpoint = open_endpoint("udpin:127.0.0.1:0")
    with _simulated(plan, endpoint.url):
        link = FleetLink(plan, [endpoint], WallClock([endpoint]))
        try:
            link.connect()
            begun_s, cpu_s = time.monotonic(), time.process_time()
            link.upload()
            upload_s = time.monotonic() - begun_s
            link.verify()
            return upload_s, time.monotonic() - begun_s, time.process_time() - cpu_s
        finally:
            link.close()


def _mavsdk_once(plan: FleetPlan) -> tuple[float, float, float]:
    raw = import_module("mavsdk.plugins.mission_raw")
    endpoint = open_endpoint("udpin:127.0.0.1:0")
    url = endpoint.url
    endpoint.close()
    count = len(plan.vehicles)
    items = {v.sysid: mavsdk_items(plan_items(v, plan.frame)) for v in plan.vehicles}
    with _simulated(plan, url), mavsdk_systems(url, count) as systems, ThreadPoolExecutor(count) as pool:
        clients = {system.get_system_id(): raw.MissionRaw(system) for system in systems}
        time.sleep(_SETTLE_S)
        begun_s, cpu_s = time.monotonic(), time.process_time()
        list(pool.map(lambda sysid: clients[sysid].upload_mission(items[sysid]), clients))
        upload_s = time.monotonic() - begun_s
        list(pool.map(lambda sysid: clients[sysid].download_mission(), clients))
        return upload_s, time.monotonic() - begun_s, time.process_time() - cpu_s


def telemetry(vehicles: int, position_hz: float, duration_s: float, autopilot: Autopilot) -> Telemetry:
    """Serve vehicles in real time to a ground station that reads everything."""
    endpoint = open_endpoint("udpin:127.0.0.1:0")
    with _simulated(fleet_plan(1, 10, autopilot, 1), endpoint.url, position_hz) as one:
        _drained(endpoint, _SETTLE_S)
        alone = _asked(one, endpoint)
    with _simulated(fleet_plan(vehicles, 10, autopilot, 1), endpoint.url, position_hz) as simulator:
        _drained(endpoint, 2 * _SETTLE_S)
        before = _asked(simulator, endpoint)
        received, frames = _drained(endpoint, duration_s)
        after = _asked(simulator, endpoint)
    endpoint.close()
    wall_s = after["wall_s"] - before["wall_s"]
    return Telemetry(
        vehicles,
        position_hz,
        wall_s,
        (after["cpu_s"] - before["cpu_s"]) / wall_s,
        after["memory_mb"],
        after["memory_mb"] - alone["memory_mb"],
        frames / duration_s,
        received / duration_s / 1e3,
        wall_s - (after["now_s"] - before["now_s"]),
    )


def _drained(endpoint: Endpoint, duration_s: float) -> tuple[int, int]:
    """Read for a while; return bytes and frames."""
    clock = WallClock([endpoint])
    received = frames = 0
    while clock.now_s() < duration_s:
        clock.wait(0.1)
        for data, _ in endpoint.receive():
            received += len(data)
            here = 0
            while here < len(data):
                here += 12 + data[here + 1]
                frames += 1
    return received, frames


def _asked(simulator: Connection, endpoint: Endpoint) -> dict[str, float]:
    simulator.send("figures")
    while not simulator.poll(0.01):
        endpoint.receive()
    found: dict[str, float] = simulator.recv()
    return found


# --- the simulator's process ------------------------------------------------------------------------------------------


@contextmanager
def _simulated(plan: FleetPlan, url: str, position_hz: float = 5.0) -> Iterator[Connection]:
    """Run a plan's vehicles in a process that sends to ``url``; check what they hold when all is done."""
    spawning = multiprocessing.get_context("spawn")
    here, there = spawning.Pipe()
    process = spawning.Process(
        target=_simulate, args=(there, plan, url.replace("udpin", "udpout"), position_hz), daemon=True
    )
    process.start()
    try:
        assert here.recv() == "ready"
        yield here
        here.send("end")
        held_otherwise = here.recv()
        assert not held_otherwise, f"vehicles {held_otherwise} hold another mission than was sent"
    finally:
        here.close()
        process.join(10.0)
        process.terminate()


def _simulate(commands: Connection, plan: FleetPlan, url: str, position_hz: float) -> None:
    begin()
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame, position_hz=position_hz)
    fleet.advance(1.0)  # compiles what moves vehicles
    connect_fleet(fleet, url)
    commands.send("ready")

    def told_to_stop() -> bool:
        if not commands.poll():
            return False
        try:
            if commands.recv() == "end":
                return True
        except EOFError:
            return True
        usage = os.times()
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        commands.send(
            {
                "cpu_s": usage.user + usage.system,
                "wall_s": time.monotonic(),
                "now_s": fleet.now_s,
                "memory_mb": memory / (1e6 if sys.platform == "darwin" else 1e6 / 1024),
            }
        )
        return False

    serve(fleet, 1.0, told_to_stop)
    wrong = []
    for vehicle, link in zip(plan.vehicles, fleet.links, strict=True):
        stored = link.missions.items()
        if stored and not holds(plan_items(vehicle, plan.frame), stored, vehicle.autopilot):
            wrong.append(vehicle.name)
    commands.send(wrong)
    fleet.close()
