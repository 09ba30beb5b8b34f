"""Uploads over bad links to simulated vehicles, ours and MAVSDK's, and what the vehicles then really hold."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np

from adapters.endpoint import in_process_pair, open_endpoint
from adapters.fleet_link import Clock, FleetLink, WallClock
from adapters.mission_items import CHANGE_SPEED, FRAME_MISSION, MissionItem, plan_items
from missionplanner.errors import LinkError
from missionplanner.experiments.document import provenance
from missionplanner.geodesy import LocalFrame
from missionplanner.mission import FlatTerrain, Mission, Origin, Point, Vehicle
from missionplanner.plan import FleetPlan, Trajectory, VehiclePlan
from missionplanner.vehicle import Autopilot, motion_model
from sim.faults import Faults, FaultyEndpoint, bad_links
from sim.fleet import LockstepClock, SimFleet, planned_vehicles, serve

Verdict = Literal["verified", "refused", "wrong", "unclear"]
"""Verified, and held as sent; a line naming the vehicle and saying why; accepted, and held otherwise; another error."""

Client = Literal["missionplanner", "mavsdk"]

_FRAME = LocalFrame(46.5, 8.0)
_GROUND_AMSL_M = 1_000.0
_APART_M = 60.0
_SPEED_M_S = 8.0
_FIND_S = 30.0
_ALT_TOLERANCE_M = 0.011
_FRAMES = {0: (0, 5), 3: (3, 6)}  # that mean the same


@dataclass(frozen=True, slots=True)
class Trial:
    """How one upload ended."""

    verdict: Verdict
    upload_s: float | None  # until the vehicle had accepted it
    verified_s: float | None  # until it was read back, too
    said: str = ""


def links() -> dict[str, Faults]:
    """Return the links that uploads are tried on: with every share of loss, frames are doubled and overtaken, too."""
    common = Faults(duplicate=0.05, reorder=0.05, delay_s=0.05)
    lossy = {f"{loss:.0%} loss": replace(common, loss=loss) for loss in (0.0, 0.05, 0.2, 0.4)}
    radio = replace(common, loss=0.4, corrupt=0.02, delay_s=0.1, jitter_s=0.2, baud=57_600)
    return lossy | {
        "radio": radio,
        "down for 10 s": replace(common, loss=0.05, down_s=((6.0, 16.0),)),
        "down for ever": replace(common, loss=0.05, down_s=((6.0, math.inf),)),
    }


def fleet_plan(count: int, items: int, autopilot: Autopilot, seed: int) -> FleetPlan:
    """Return copters side by side, each with a mission of so many items through places that the seed scatters."""
    rng = np.random.default_rng(seed)
    goal = Point(x_m=0.0, y_m=0.0, alt_amsl_m=_GROUND_AMSL_M + 50.0)
    fixed = 4 if autopilot == "ardupilot" else 3  # (home,) take-off, speed, ending
    vehicles = []
    for k in range(1, count + 1):
        settings = Vehicle(name=f"uav{k}", autopilot=autopilot, home=goal, goal=goal)
        home_m = np.array([_APART_M * k, 0.0, _GROUND_AMSL_M])
        points = home_m + np.column_stack(
            [
                rng.uniform(-200.0, 200.0, items - fixed + 1),
                20.0 * np.arange(items - fixed + 1),
                np.zeros(items - fixed + 1),
            ]
        )
        points[:, 2] += rng.uniform(30.0, 80.0, len(points))
        legs = len(points) - 1
        reached_s = 15.0 + 10.0 * np.arange(len(points), dtype=np.float64)
        vehicles.append(
            VehiclePlan(
                name=settings.name,
                sysid=k,
                autopilot=autopilot,
                vehicle_class="copter",
                motion=motion_model(settings),
                home_m=home_m,
                path_m=points,
                waypoints_m=points,
                end="land",
                length_m=float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum()),
                speeds_m_s=np.full(legs, _SPEED_M_S),
                hold_s=rng.integers(0, 3, legs).astype(float),
                start_delay_s=0.0,
                window_s=(0.0, math.inf),
                arrival_s=float(reached_s[-1]),
                reached_s=reached_s,
                trajectory=Trajectory(reached_s, points),
                cost=0.0,
                cost_terms={},
                history=np.zeros(1),
                evaluations=0,
                clearances=(),
            )
        )
    mission = Mission(
        name="links",
        origin=Origin(lat_deg=_FRAME.origin_lat_deg, lon_deg=_FRAME.origin_lon_deg),
        terrain=FlatTerrain(kind="flat", alt_amsl_m=_GROUND_AMSL_M),
        vehicles=tuple(Vehicle(name=v.name, autopilot=autopilot, home=goal, goal=goal) for v in vehicles),
    )
    return FleetPlan(mission, _FRAME, tuple(vehicles), None, None, seed, "0", "0" * 64)


def holds(sent: Sequence[MissionItem], stored: Sequence[MissionItem], autopilot: Autopilot) -> bool:
    """Return whether a vehicle would fly what was sent; judged apart from how the uploader compares it."""
    if len(sent) != len(stored):
        return False
    for a, b in zip(sent, stored, strict=True):
        if autopilot == "ardupilot" and a.seq == 0:  # its home, whatever was sent
            continue
        if (a.command, a.x, a.y) != (b.command, b.x, b.y):
            return False
        if a.command == CHANGE_SPEED and (a.param1, a.param2) != (b.param1, b.param2):
            return False
        if a.frame != FRAME_MISSION and (b.frame not in _FRAMES[a.frame] or abs(a.z - b.z) > _ALT_TOLERANCE_M):
            return False
        if a.param1 != b.param1:
            return False
    return True


# --- ours, in simulated time ------------------------------------------------------------------------------------------


def uploads(autopilot: Autopilot, link: str, items: int, seeds: Sequence[int]) -> dict[str, Any]:
    """Upload once per seed over the link of that name, to a vehicle that holds another mission of as many items."""
    return {"trials": [asdict(_uploaded(autopilot, links()[link], items, seed)) for seed in seeds]}


def _uploaded(autopilot: Autopilot, faults: Faults, items: int, seed: int) -> Trial:
    old, new = (fleet_plan(1, items, autopilot, s) for s in (seed + 1_000_000, seed))
    fleet = SimFleet(planned_vehicles(new), frame=new.frame, seed=seed)
    clock = LockstepClock(fleet)
    ground, air = in_process_pair("bench")
    fleet.attach(air)
    before = FleetLink(old, [ground], clock)
    before.connect()
    before.upload()
    ground, air = in_process_pair("radio")
    began_s = fleet.now_s
    fleet.attach(FaultyEndpoint(air, faults, lambda: fleet.now_s - began_s, np.random.default_rng(seed)))
    sent = plan_items(new.vehicles[0], new.frame)
    return _tried(
        FleetLink(new, [ground], clock),
        clock,
        new.vehicles[0],
        lambda: holds(sent, fleet.links[0].missions.items(), autopilot),
    )


def _tried(link: FleetLink, clock: Clock, vehicle: VehiclePlan, holds_now: Callable[[], bool]) -> Trial:
    """Connect, upload and verify; then look at what the vehicle really holds."""
    upload_s = None
    try:
        link.connect()
        begun_s = clock.now_s()
        link.upload()
        upload_s = clock.now_s() - begun_s
        link.verify()
    except LinkError as error:
        said = str(error)
        return Trial("refused" if vehicle.name in said and "\n" not in said else "unclear", upload_s, None, said)
    return Trial("verified" if holds_now() else "wrong", upload_s, clock.now_s() - begun_s)


# --- in real time, ours and MAVSDK's ----------------------------------------------------------------------------------


def mavsdk_version() -> str | None:
    """Return the version of MAVSDK's client, None where it is not installed."""
    return version("mavsdk") if find_spec("mavsdk") is not None else None


def clients(client: Client, autopilot: Autopilot, link: str, items: int, vehicles: int, seed: int) -> dict[str, Any]:
    """Upload to vehicles in real time over UDP, all at once, each by a client of its own over a link of its own."""
    _uploaded(autopilot, Faults(), items, seed)  # what is compiled first holds up all threads
    plan = fleet_plan(vehicles, items, autopilot, seed)
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame, seed=seed)
    through = bad_links(links()[link], lambda: fleet.now_s, seed)
    sockets = [open_endpoint("udpin:127.0.0.1:0") for _ in plan.vehicles]
    for i, endpoint in enumerate(sockets):
        fleet.attach(through(endpoint), [i])
    upload = _ours
    if client == "mavsdk":
        _silent_mavsdk()  # before there are threads
        upload = _mavsdks

    def one(i: int) -> Trial:
        vehicle = plan.vehicles[i]
        sent = plan_items(vehicle, plan.frame)
        alone = replace(plan, vehicles=(vehicle,))
        place = sockets[i].url.replace("udpin", "udpout")
        return upload(alone, place, lambda: holds(sent, fleet.links[i].missions.items(), autopilot))

    over = threading.Event()
    air = threading.Thread(target=serve, args=(fleet, 1.0, over.is_set), daemon=True)
    air.start()
    try:
        with ThreadPoolExecutor(vehicles) as pool:
            trials = list(pool.map(one, range(vehicles)))
    finally:
        over.set()
        air.join()
        fleet.close()
    return {"trials": [asdict(trial) for trial in trials], "provenance": provenance()}


def _ours(plan: FleetPlan, url: str, holds_now: Callable[[], bool]) -> Trial:
    endpoint = open_endpoint(url)
    clock = WallClock([endpoint])
    link = FleetLink(plan, [endpoint], clock)
    try:
        return _tried(link, clock, plan.vehicles[0], holds_now)
    finally:
        link.close()


def _mavsdks(plan: FleetPlan, url: str, holds_now: Callable[[], bool]) -> Trial:
    """Upload and read back by MAVSDK, which compares nothing: what it calls a success is verified or wrong."""
    with mavsdk_systems(url, 1) as (system,):
        if system is None:
            return Trial("refused", None, None, "no vehicle found")
        raw = import_module("mavsdk.plugins.mission_raw")
        client = raw.MissionRaw(system)
        begun_s, upload_s = time.monotonic(), None
        try:
            client.upload_mission(mavsdk_items(plan_items(plan.vehicles[0], plan.frame)))
            upload_s = time.monotonic() - begun_s
            right = holds_now()
            client.download_mission()
        except raw.MissionRawError as error:
            said = str(error).partition(";")[0]
            return Trial("refused" if upload_s is None or right else "wrong", upload_s, None, said)
        return Trial("verified" if right else "wrong", upload_s, time.monotonic() - begun_s)


@cache
def _silent_mavsdk() -> Any:
    """Return MAVSDK, once told not to write to stdout: told again, it would forget whom its threads still tell."""
    mavsdk: Any = import_module("mavsdk")
    mavsdk.log_subscribe(lambda *_: True)
    return mavsdk


@contextmanager
def mavsdk_systems(url: str, count: int) -> Iterator[list[Any]]:
    """Yield the autopilots that MAVSDK finds at a URL as pymavlink writes it; None for those that do not come."""
    mavsdk = _silent_mavsdk()
    kind, host, port = url.split(":")
    instance = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION))
    try:
        instance.add_any_connection(f"{kind}://{host}:{port}")
        end_s = time.monotonic() + _FIND_S
        while len(found := instance.get_systems()) < count and time.monotonic() < end_s:
            time.sleep(0.05)
        yield [*found, *[None] * count][:count]
    finally:
        instance.destroy()


def mavsdk_items(items: Sequence[MissionItem]) -> list[Any]:
    """Return items as MAVSDK writes them."""
    kind = import_module("mavsdk.plugins.mission_raw").MissionItem
    return [
        kind(
            *(i.seq, i.frame, i.command, i.current, i.autocontinue),
            *(i.param1, i.param2, i.param3, i.param4, i.x, i.y, i.z, 0),
        )
        for i in items
    ]
