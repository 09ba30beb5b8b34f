"""How cost grows with the number of vehicles: simulation, separation, schedules; ``missionplanner experiment scale``.

Each size is measured in a process of its own, once what numba compiles is there. What counts is the processor's time:
others may use the machine, too.
"""

from __future__ import annotations

import math
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from adapters.endpoint import Endpoint, in_process_pair
from adapters.ground_station import Peer, Station, Steps
from adapters.mission_items import (
    CHANGE_SPEED,
    FRAME_GLOBAL,
    FRAME_MISSION,
    FRAME_RELATIVE,
    TAKEOFF,
    WAYPOINT,
    MissionItem,
    degrees_to_wire,
)
from adapters.mission_protocol import MissionUpload, Party
from missionplanner import planner, timing
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv
from missionplanner.geodesy import FloatArray, GeoPoint, LocalFrame
from missionplanner.mission import VehicleSettings, parse_mission
from missionplanner.motion import TICK_S, Navigator
from missionplanner.path_search import PlannedPath
from missionplanner.plan import Trajectory
from missionplanner.scene import build_scene
from missionplanner.vehicle import MotionModel, motion_model
from sim.fleet import LockstepClock, SimFleet, SimVehicle

Progress = Callable[[str, float], None]

FLIGHT_S = 600.0
SIZES: dict[str, tuple[int, ...]] = {
    "simulator": (10, 30, 100, 250),  # there are no more sysids
    "motion": (10, 100, 1_000, 10_000),
    "separation": (5, 10, 20, 50, 100, 200),
    "schedule": (5, 10, 20, 50, 100),
}
_QUICK_S = 20.0
_QUICK_SIZES: dict[str, tuple[int, ...]] = {
    "simulator": (2, 8),
    "motion": (10, 100),
    "separation": (5, 10),
    "schedule": (3, 6),
}

GROWN = 0.1
"""A power of growth per vehicle below this is none: caches and noise make as much."""

_ORIGIN = GeoPoint(34.3, -118.1, 500.0)
_AREA_M = 500.0
"""Each vehicle has a square of this side to itself, and strays as far into its neighbours'."""
_LEG_M, _SPEED_M_S = 80.0, 8.0
_HEIGHTS_M = 50.0, 120.0
_APART_M, _LATE_S = 20.0, 60.0
_POSITION_HZ = 5.0
_DEPARTURE = (  # ArduCopter: MAV_CMD_DO_SET_MODE GUIDED, MAV_CMD_COMPONENT_ARM_DISARM, MAV_CMD_MISSION_START
    (176, 1.0, 4.0),
    (400, 1.0),
    (300,),
)
_REPEATS, _REPEATED_BELOW_S = 3, 2.0


@dataclass(frozen=True, slots=True)
class Measured:
    """What a number of vehicles cost."""

    what: str
    vehicles: int
    wall_s: float
    cpu_s: float
    simulated_s: float | None = None
    memory_mb: float | None = None  # what the process needed beyond what it had before
    pairs: int | None = None  # of vehicles, found near

    @property
    def times_real_time(self) -> float | None:
        """How many times faster than the simulated time it was, by the clock on the wall."""
        return None if self.simulated_s is None else self.simulated_s / self.wall_s

    @property
    def each_us(self) -> float | None:
        """Processor time per vehicle and simulated second, in microseconds."""
        return None if self.simulated_s is None else 1e6 * self.cpu_s / self.vehicles / self.simulated_s


@dataclass(frozen=True, slots=True)
class Results:
    """All that was measured."""

    seed: int
    flight_s: float
    measured: tuple[Measured, ...]

    def of(self, what: str) -> list[Measured]:
        """Return what was measured of one kind, by vehicles."""
        return [m for m in self.measured if m.what == what]

    def exponent(self, what: str) -> float | None:
        """Return the power of the number of vehicles with which processor time grows, over the upper sizes."""
        found = self.of(what)
        upper = found[len(found) // 2 - 1 :] if len(found) > 3 else found
        if len(upper) < 2:
            return None
        counts = np.log([m.vehicles for m in upper])
        return float(np.polyfit(counts, np.log([m.cpu_s for m in upper]), 1)[0])

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "seed": self.seed,
            "flight_s": self.flight_s,
            "measured": [
                asdict(m) | {"times_real_time": m.times_real_time, "us_per_vehicle_and_simulated_s": m.each_us}
                for m in self.measured
            ],
            "exponents": {what: self.exponent(what) for what in _kinds()},
            "cost_per_vehicle_grows": {
                what: None if (power := self.exponent(what)) is None else power > 1.0 + GROWN
                for what in ("simulator", "motion")
            },
        }


def main(output: Path, *, seed: int, quick: bool, progress: Progress) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    return run(output, seed, quick=quick, progress=progress).as_json()


def run(
    folder: Path,
    seed: int,
    *,
    quick: bool = False,
    progress: Progress = lambda _what, _share: None,
) -> Results:
    """Measure every kind of work with ever more vehicles; write tables and figures to a folder."""
    ensure_writable(folder)
    flight_s, sizes = (_QUICK_S, _QUICK_SIZES) if quick else (FLIGHT_S, SIZES)
    measured: list[Measured] = []
    for name, work in _WORKS.items():
        for k, vehicles in enumerate(sizes[name], start=1):
            measured += _apart(work, vehicles, seed, flight_s)
            progress(name, k / len(sizes[name]))
    results = Results(seed, flight_s, tuple(measured))
    _write(folder, results)
    return results


def _apart(work: Callable[[int, int, float], list[Measured]], *arguments: Any) -> list[Measured]:
    """Do work in a process of its own."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


class _Stopwatch:
    """Wall and processor time, and memory, from now on."""

    def __init__(self) -> None:
        self._memory_mb = _most_memory_mb()
        self._wall_s, self._cpu_s = time.perf_counter(), time.process_time()

    def read(self) -> tuple[float, float, float]:
        """Return seconds on the wall, of the processor, and megabytes."""
        wall_s, cpu_s = time.perf_counter() - self._wall_s, time.process_time() - self._cpu_s
        return wall_s, cpu_s, _most_memory_mb() - self._memory_mb


def _most_memory_mb() -> float:
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (1e6 if sys.platform == "darwin" else 1e6 / 1024)


def _least(action: Callable[[], object]) -> tuple[float, float]:
    """Return wall and processor time of work; the least of a few runs where it is short."""
    found: list[tuple[float, float]] = []
    while len(found) < _REPEATS and sum(cpu_s for _, cpu_s in found) < _REPEATED_BELOW_S:
        watch = _Stopwatch()
        action()
        found.append(watch.read()[:2])
    return min(found, key=lambda pair: pair[1])


# --- the vehicles ----------------------------------------------------------------------------------------------------


def homes(count: int) -> FloatArray:
    """Return homes (N, 3) in rows, each with an area of its own."""
    side = math.isqrt(count - 1) + 1
    place = np.arange(count)
    return np.stack([_AREA_M * (place % side), _AREA_M * (place // side), np.full(count, _ORIGIN.alt_amsl_m)], axis=-1)


def way(rng: np.random.Generator, home_m: FloatArray, flight_s: float) -> FloatArray:
    """Return waypoints (W, 3) that take longer than ``flight_s``: over a vehicle's area and into its neighbours'."""
    legs = math.ceil(1.5 * flight_s * _SPEED_M_S / _LEG_M) + 2
    points = np.empty((legs, 3))
    here = home_m + np.array([0.0, 0.0, _HEIGHTS_M[0]])
    course_rad = rng.uniform(0.0, 2.0 * math.pi)
    for k in range(legs):
        points[k] = here
        course_rad += rng.uniform(-1.0, 1.0)
        step_m = _LEG_M * np.array([math.cos(course_rad), math.sin(course_rad)])
        if np.abs(here[:2] + step_m - home_m[:2]).max() > _AREA_M:  # back towards home
            back = home_m[:2] - here[:2]
            course_rad = math.atan2(back[1], back[0])
            step_m = _LEG_M * np.array([math.cos(course_rad), math.sin(course_rad)])
        here = np.array([*(here[:2] + step_m), home_m[2] + rng.uniform(*_HEIGHTS_M)])
    return points


def _models() -> tuple[MotionModel, MotionModel]:
    return motion_model(VehicleSettings(autopilot="ardupilot")), motion_model(VehicleSettings(autopilot="px4"))


# --- what is measured ------------------------------------------------------------------------------------------------


def simulator(vehicles: int, seed: int, flight_s: float) -> list[Measured]:
    """Fly ArduCopters with MAVLink as fast as possible; what they send is taken in and not looked at."""
    _simulated(2, seed, 1.0)
    return [_simulated(vehicles, seed, flight_s)]


def _simulated(vehicles: int, seed: int, flight_s: float) -> Measured:
    rng = np.random.default_rng(seed)
    frame = LocalFrame(_ORIGIN.lat_deg, _ORIGIN.lon_deg)
    model = _models()[0]
    watch = _Stopwatch()
    places_m = homes(vehicles)
    fleet = SimFleet(
        [SimVehicle(i + 1, "ardupilot", "copter", frame.geo_point(home), model) for i, home in enumerate(places_m)],
        frame=frame,
        seed=seed,
        position_hz=_POSITION_HZ,
    )
    endpoints: list[Endpoint] = []
    for i in range(vehicles):
        there, air = in_process_pair()
        fleet.attach(air, [i])
        endpoints.append(there)
    peers = {v.sysid: Peer(Party(f"vehicle {v.sysid}", v.sysid)) for v in fleet.vehicles}
    station: Station[Peer] = Station(peers, endpoints, LockstepClock(fleet), None)
    station.wait_for(list(peers), {k: peer.party.vehicle for k, peer in peers.items()}, timeout_s=30.0)
    items = [_items(frame, way(rng, home, flight_s)) for home in places_m]
    station.together({k: _sent_off(station, peers[k], items[i]) for i, k in enumerate(peers)})
    memory_mb = watch.read()[2]
    watch = _Stopwatch()
    for _ in range(math.ceil(flight_s)):
        fleet.advance(1.0)
        for endpoint in endpoints:
            endpoint.receive()
    wall_s, cpu_s, more_mb = watch.read()
    fleet.close()
    return Measured("simulator", vehicles, wall_s, cpu_s, float(math.ceil(flight_s)), memory_mb + more_mb)


def _items(frame: LocalFrame, points_m: FloatArray) -> tuple[MissionItem, ...]:
    """Return the mission of an ArduCopter: its home, take-off, speed, waypoints."""
    lat_deg, lon_deg, _ = frame.to_geo(points_m)
    waypoints = enumerate(zip(lat_deg[1:], lon_deg[1:], points_m[1:, 2], strict=True), start=3)
    return (
        MissionItem(0, FRAME_GLOBAL, WAYPOINT, current=1),
        MissionItem(1, FRAME_RELATIVE, TAKEOFF, z=_HEIGHTS_M[0]),
        MissionItem(2, FRAME_MISSION, CHANGE_SPEED, param1=1.0, param2=_SPEED_M_S, param3=-1.0),
        *(
            MissionItem(seq, FRAME_GLOBAL, WAYPOINT, x=degrees_to_wire(lat), y=degrees_to_wire(lon), z=float(z))
            for seq, (lat, lon, z) in waypoints
        ),
    )


def _sent_off(station: Station[Peer], peer: Peer, items: Sequence[MissionItem]) -> Steps:
    """Upload a mission and start it."""
    upload = peer.uploads[0] = MissionUpload(peer.party, "ardupilot", items)
    while not upload.done:
        station.send(peer, upload.poll(station.clock.now_s()))
        yield
        peer.check_transfer()
    for number, *params in _DEPARTURE:
        result = yield from station.commanding(peer, number, *params)
        assert result == 0, f"{peer.party.vehicle} refused command {number}: {result}"


def motion(vehicles: int, seed: int, flight_s: float) -> list[Measured]:
    """Move vehicles, half of them ArduCopters and half PX4 multicopters, without MAVLink."""
    _moved(2, seed, 1.0)
    return [_moved(vehicles, seed, flight_s)]


def _moved(vehicles: int, seed: int, flight_s: float) -> Measured:
    rng = np.random.default_rng(seed)
    models = _models()
    places_m = homes(vehicles)
    ways = [way(rng, home, flight_s) for home in places_m]
    ticks = round(flight_s / TICK_S)
    memory = _Stopwatch()

    def fly() -> None:
        navigator = Navigator([models[i % len(models)] for i in range(vehicles)], places_m)
        for i, points_m in enumerate(ways):
            navigator.follow(i, points_m, _SPEED_M_S)
        for _ in range(ticks):
            navigator.step()

    wall_s, cpu_s = _least(fly)
    return Measured("motion", vehicles, wall_s, cpu_s, ticks * TICK_S, memory.read()[2])


def flights(vehicles: int, seed: int, flight_s: float) -> list[Trajectory]:
    """Return predicted flights of so many vehicles, cut at ``flight_s``."""
    rng = np.random.default_rng(seed)
    models = _models()
    found = []
    for i, home in enumerate(homes(vehicles)):
        flown, _ = timing.predict_flight(models[i % len(models)], home, way(rng, home, flight_s), _SPEED_M_S)
        last = int(np.searchsorted(flown.t_s, flight_s)) + 1
        found.append(Trajectory(flown.t_s[:last], flown.position_m[:last]))
    return found


def separation(vehicles: int, seed: int, flight_s: float) -> list[Measured]:
    """Find who comes near to whom, the pair with the least room, and how late any one may be."""
    warm = flights(3, seed, 10.0)
    timing.least_separation(warm)
    timing.least_slack(warm, lambda _i, _j: _APART_M, _LATE_S)
    tracks = flights(vehicles, seed, flight_s)
    near = len(timing.least_separation(tracks, _APART_M))
    works: dict[str, Callable[[], object]] = {
        "separation": lambda: timing.least_separation(tracks, _APART_M),
        "tightest": lambda: timing.tightest_pair(tracks, lambda _i, _j: _APART_M),
        "slack": lambda: timing.least_slack(tracks, lambda _i, _j: _APART_M, _LATE_S),
    }
    return [
        Measured(name, vehicles, *_least(work), pairs=near if name == "separation" else None)
        for name, work in works.items()
    ]


def schedule(vehicles: int, seed: int, flight_s: float) -> list[Measured]:
    """Time a fleet on straight legs so that it arrives together."""
    _scheduled(2, seed, 10.0)
    return [_scheduled(vehicles, seed, flight_s)]


def _scheduled(vehicles: int, seed: int, flight_s: float) -> Measured:
    rng = np.random.default_rng(seed)
    places_m = homes(vehicles)
    ways = []
    for home in places_m:  # of different lengths: the fleet waits for its slowest
        points = way(rng, home, flight_s)
        ways.append(points[: max(3, math.ceil(len(points) * rng.uniform(0.5, 0.65)))])
    lines = [
        "name: scale",
        f"origin: {{lat_deg: {_ORIGIN.lat_deg}, lon_deg: {_ORIGIN.lon_deg}}}",
        f"terrain: {{kind: flat, alt_amsl_m: {_ORIGIN.alt_amsl_m}}}",
        "defaults: {endurance_s: 7200, speed_m_s: {min: 2, max: 12}}",
        "vehicles:",
    ]
    for i, (home, points) in enumerate(zip(places_m, ways, strict=True)):
        goal = f"x_m: {points[-1, 0]}, y_m: {points[-1, 1]}, height_agl_m: {points[-1, 2] - home[2]}"
        lines.append(f"  - {{name: v{i}, home: {{x_m: {home[0]}, y_m: {home[1]}}}, goal: {{{goal}}}}}")
    scene = build_scene(parse_mission("\n".join(lines), "scale"), Path())
    paths = []
    for task, points in zip(scene.tasks, ways, strict=True):
        way_m = np.vstack([task.route_m[:1], points[1:-1], task.route_m[-1:]])
        paths.append(PlannedPath(way_m, way_m, 0.0, 0.0, {}, np.zeros(0), 0))
    watch = _Stopwatch()
    planner.schedule(scene, paths, [0.0] * vehicles)
    wall_s, cpu_s, _ = watch.read()
    return Measured("schedule", vehicles, wall_s, cpu_s)


_WORKS: dict[str, Callable[[int, int, float], list[Measured]]] = {
    "simulator": simulator,
    "motion": motion,
    "separation": separation,
    "schedule": schedule,
}


def _kinds() -> tuple[str, ...]:
    return tuple(_TITLES)


# --- what is written -------------------------------------------------------------------------------------------------

_TITLES = {
    "simulator": "simulator with MAVLink: ArduCopters, missions uploaded, positions at 5 Hz",
    "motion": "motion alone: ArduCopters and PX4 multicopters",
    "separation": f"pairs that come within {_APART_M:g} m, over all time",
    "tightest": "the pair with the least room, over all time",
    "slack": f"how late any one may be: all pairs, up to {_LATE_S:g} s",
    "schedule": "schedules: speeds for a common arrival, on straight legs",
}


def _write(folder: Path, results: Results) -> None:
    fields = list(Measured.__dataclass_fields__)
    write_csv(
        folder / "scale.csv",
        [*fields, "times_real_time", "us_per_vehicle_and_simulated_s"],
        [[*(getattr(m, field) for field in fields), m.times_real_time, m.each_us] for m in results.measured],
    )
    write_atomic(folder / "results.md", table(results))
    with replacing(folder / "scale.png") as draft:
        _drawn(results).savefig(draft, format="png", metadata={"Software": None})


def table(results: Results) -> str:
    """Return the figures as Markdown."""
    lines = [f"# Cost and the number of vehicles: flights of {results.flight_s:g} s (seed {results.seed})"]
    for what, title in _TITLES.items():
        found = results.of(what)
        if not found:
            continue
        simulated = found[0].simulated_s is not None
        near = any(m.pairs is not None for m in found)
        head = "| vehicles | processor, s | wall, s |"
        head += " times real time | µs per vehicle and simulated s | memory, MB |" * simulated + " near pairs |" * near
        lines += ["", f"## {title[0].upper()}{title[1:]}", "", head, "|---" * (head.count("|") - 1) + "|"]
        for m in found:
            row = f"| {m.vehicles:,} | {m.cpu_s:.3f} | {m.wall_s:.3f} |"
            if m.times_real_time is not None and m.each_us is not None:
                row += f" {m.times_real_time:,.1f} | {m.each_us:.1f} | {m.memory_mb:,.0f} |"
            lines.append(row + (f" {m.pairs} |" if m.pairs is not None else ""))
        power = results.exponent(what)
        if power is not None:
            grows = (
                "" if not simulated else f": the cost per vehicle {'grows' if power > 1.0 + GROWN else 'does not grow'}"
            )
            lines += ["", f"Processor time grows with vehicles^{power:.2f}{grows}."]
    return "\n".join(lines) + "\n"


def _drawn(results: Results) -> Figure:
    figure = Figure(figsize=(7.0, 3.2), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    each, whole = figure.subplots(1, 2)
    colours = dict(zip(_TITLES, ("#0072b2", "#d55e00", "#009e73", "#56b4e9", "#cc79a7", "#66727d"), strict=True))
    for what in _TITLES:
        found = results.of(what)
        counts = [m.vehicles for m in found]
        if found and found[0].simulated_s is not None:
            each.loglog(counts, [m.each_us for m in found], "o-", color=colours[what], label=what)
        elif found:
            whole.loglog(counts, [m.cpu_s for m in found], "o-", color=colours[what], label=what.replace("_", " "))
    each.set(xlabel="vehicles", ylabel="µs per vehicle and simulated s")
    each.set_ylim(bottom=1.0)
    whole.set(xlabel="vehicles", ylabel="processor, s")
    for axes in (each, whole):
        axes.legend(fontsize=7, frameon=False)
        axes.tick_params(labelsize=8)
    return figure
