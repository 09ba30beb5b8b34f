"""Soundness: what the checker claims of random legs and fleets, held against the oracle's samples.

A claim is a distance that is said to be kept. Each is compared to the least that was seen; where less was seen, the
claim is violated. Legs that are judged clear must also have been seen to keep all that they have to.
"""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from pyproj import Transformer

from adapters import sorties
from adapters.mission_items import (
    CHANGE_SPEED,
    FRAME_GLOBAL,
    FRAME_MISSION,
    FRAME_RELATIVE,
    LAND,
    LOITER_UNLIMITED,
    RETURN_TO_LAUNCH,
    TAKEOFF,
    WAYPOINT,
    MissionItem,
    degrees_to_wire,
)
from missionplanner import clearance, proof, returns
from missionplanner.certificate import Certificate, Finding
from missionplanner.errors import InfeasibleError
from missionplanner.experiments import proof_oracle as oracle
from missionplanner.experiments import proof_worlds as worlds
from missionplanner.experiments.proof_worlds import Land, World
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.mission import Mission
from missionplanner.obstacles import pack
from missionplanner.proof import Flight
from missionplanner.scene import Scene, VehicleTask, build_check_scene
from missionplanner.sortie import Sortie
from missionplanner.vehicle import Autopilot, Ending, VehicleLimits

ROOM_M = 1e-3
"""How far below a claim a sample may be: what the oracle's own arithmetic and the fit of a raster's grid come to."""

LEG_STEP_M = 0.01
FLEET_STEP_M = 0.1
TICK_S = 0.01
LEGS_PER_WORLD = 250

_SHIFTS = 4  # random ones, per fleet; and the two extreme ones
_TRIGGERS = 4  # instants at which a fleet is told to return
_PLACE_M = 0.02  # 1e-7 degrees are 11 mm
_NAMES = ("alpha", "bravo", "charlie", "delta", "echo", "foxtrot")
_KEEPS_M = 0.02  # ArduPilot takes less for "as high as now"
_AMSL_FRAMES, _HOME_FRAMES = (0, 5), (3, 6)


@dataclass(frozen=True, slots=True)
class Violation:
    """A claim that a sample contradicts."""

    trial: str  # legs or fleets
    of: str  # which check's claim
    claimed: float
    seen: float
    where: str


@dataclass(slots=True)
class Tally:
    """What came of trials."""

    made: Counter[str] = field(default_factory=Counter)  # legs, fleets, ...
    claims: Counter[str] = field(default_factory=Counter)  # by check
    samples: Counter[str] = field(default_factory=Counter)
    violations: list[Violation] = field(default_factory=list)
    room_m: list[float] = field(default_factory=list)  # of proven legs: the terrain's bound over what is asked for

    def add(self, other: Tally) -> None:
        """Add what came of other trials."""
        self.made += other.made
        self.claims += other.claims
        self.samples += other.samples
        self.violations += other.violations
        self.room_m += other.room_m

    def claim(self, trial: str, of: str, claimed: float, seen: float, where: str) -> None:
        """Hold one claim against what was seen."""
        self.claims[f"{trial}: {of}"] += 1
        if not seen >= claimed - ROOM_M:
            self.violations.append(Violation(trial, of, claimed, seen, where))


def _land(mission_path: Path | None, rng: np.random.Generator) -> Land:
    real = None if mission_path is None else worlds.real_land(mission_path)
    return worlds.random_land(rng) if real is None else real


# --- legs ------------------------------------------------------------------------------------------------------------


def try_legs(seed: int, number: int, mission_path: Path | None, count: int) -> Tally:
    """Return what came of legs in one world, on a mission's terrain or on a random one."""
    rng = np.random.default_rng([seed, 1, number])
    world = worlds.random_world(rng, _land(mission_path, rng))
    limits = _random_limits(rng, calm=world.land.calm)
    need_m, tube_m = limits.terrain_margin_m, limits.tube_m
    legs = worlds.random_legs(
        rng, world, count, lambda n: need_m + tube_m * rng.uniform(1.0, 2.0, n) + rng.exponential(3.0, n)
    )
    radius_m = np.full(count, tube_m)
    first = clearance.tube_clearances(world.space, world.land.bounds, legs, radius_m)
    spare_m = first.height_min_m - need_m
    lowered = np.isfinite(spare_m) & (rng.random(count) < 0.8)  # just clear, or just not
    legs[lowered, :, 2] -= (spare_m - rng.uniform(-0.02, 0.12, count))[lowered, None]

    table = clearance.tube_clearances(world.space, world.land.bounds, legs, radius_m)
    clear = clearance.tubes_clear(world.space, world.land.bounds, limits, legs)
    asked = (
        (table.height_min_m >= need_m)
        & (table.height_max_m <= limits.height_agl_max_m)
        & (table.obstacle_m >= limits.obstacle_margin_m)
        & (table.fence_m >= limits.obstacle_margin_m)
    )
    chosen = np.flatnonzero(clear | asked)
    unit = oracle.strays(rng)
    seen = oracle.sample_legs(world.land.ground, world.seen, legs[chosen], radius_m[chosen], LEG_STEP_M, unit)
    tally = Tally()
    tally.made["legs"] += count
    tally.made["proven legs"] += len(chosen)
    tally.made[f"proven legs on {'real' if mission_path else 'synthetic'} terrain"] += len(chosen)
    tally.samples["legs"] += int(seen[:, oracle.COUNT].sum())
    for row, leg in zip(seen, chosen.tolist(), strict=True):
        where = f"{world.land.name}, seed {seed}, world {number}, leg {leg}: {np.round(legs[leg], 3).tolist()}"
        claims = (
            ("terrain", table.height_min_m[leg], need_m, row[oracle.LOWEST]),
            ("ceiling", -table.height_max_m[leg], -limits.height_agl_max_m, -row[oracle.HIGHEST]),
            ("obstacle", table.obstacle_m[leg], limits.obstacle_margin_m, row[oracle.OBSTACLE]),
            ("fence", table.fence_m[leg], limits.obstacle_margin_m, row[oracle.FENCE]),
        )
        for of, bound, required, least in claims:
            claimed = max(bound, required) if clear[leg] else bound
            if of == "obstacle" and math.isinf(bound):
                claimed = required
            tally.claim("legs", of, float(claimed), float(least), where)
        tally.room_m.append(float(table.height_min_m[leg]) - need_m)
    return tally


def _random_limits(rng: np.random.Generator, *, calm: bool) -> VehicleLimits:
    tracking, position, deviation = rng.uniform(0.3, 2.7, 3) if calm else rng.uniform(0.2, 0.6, 3)
    margin = rng.uniform(5.0, 30.0)
    return VehicleLimits(
        speed_min_m_s=3.0,
        speed_max_m_s=10.0,
        climb_angle_rad=1.0,
        descent_angle_rad=1.0,
        turn_radius_m=0.0,
        turn_angle_rad=math.pi,
        terrain_margin_m=margin,
        obstacle_margin_m=rng.uniform(1.0, 15.0),
        tracking_error_m=tracking,
        position_error_m=position,
        deviation_m=deviation,
        landing_slope_rad=1.5,
        height_agl_max_m=margin + rng.uniform(40.0, 200.0) if rng.random() < 0.5 else math.inf,
        alt_amsl_max_m=math.inf,
        endurance_s=math.inf,
    )


def try_tightness(seed: int, number: int, mission_path: Path, count: int) -> list[float]:
    """Return how far the terrain's bounds of legs are below the least height that could be found, in metres."""
    rng = np.random.default_rng([seed, 2, number])
    land = worlds.real_land(mission_path)
    assert land is not None
    world = worlds.random_world(rng, land)
    legs = worlds.random_legs(rng, world, count, lambda n: 20.0 + rng.exponential(10.0, n))
    radius_m = rng.uniform(1.0, 8.0, count)
    bound = clearance.tube_clearances(world.space, land.bounds, legs, radius_m).height_min_m
    known = np.isfinite(bound)
    loose: list[float] = (oracle.lowest(land.ground, legs[known], radius_m[known]) - bound[known]).tolist()
    return loose


# --- fleets ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Told:
    """What one vehicle was told to fly, as the oracle reads its items."""

    home_m: FloatArray
    corners_m: FloatArray  # (W, 3), the top of the take-off first
    ending: Ending
    kinds: tuple[str, ...]


def try_fleet(seed: int, number: int, mission_path: Path | None) -> Tally:
    """Return what came of one fleet of two to six copters, from the items of their missions on."""
    rng = np.random.default_rng([seed, 3, number])
    world = worlds.random_world(rng, _land(mission_path, rng), roomy=bool(rng.random() < 0.7))
    tally = Tally()
    tally.made["fleets"] += 1
    where = f"{world.land.name}, seed {seed}, fleet {number}"
    homes = _homes(rng, world)
    if homes is None:  # no ground to start from
        return tally
    scene = _scene(rng, world, homes)
    way = _common_way(rng, homes) if rng.random() < 0.75 else None
    items = [_items(rng, world, scene, task, way) for task in scene.tasks]
    delays = rng.choice([0.0, 0.0, 5.0, 15.0], len(items))
    read = [
        sorties.read_sortie(
            row,
            name=task.name,
            sysid=task.sysid,
            autopilot=task.motion.autopilot,
            vehicle_class="copter",
            frame=scene.frame,
            home_m=task.home_m,
            motion=replace(task.motion, return_height_m=float(rng.integers(15, 90))),
            start_delay_s=float(delay),
        )
        for task, row, delay in zip(scene.tasks, items, delays, strict=True)
    ]
    told = [_told(row, task, scene.frame) for task, row in zip(scene.tasks, items, strict=True)]
    read, chosen = _with_return_heights(rng, scene, read)
    flights = proof.predict(scene, read)
    certificate = proof.prove(scene, read)
    tally.made["vehicles"] += len(read)
    tally.made["proven fleets"] += certificate.proven
    for finding in certificate.findings:
        tally.made[f"{'holds' if finding.holds else 'fails'}: {finding.check}"] += 1
    unit = oracle.strays(rng)
    _judge_chosen(tally, certificate, chosen, where)
    for flight, one in zip(flights, told, strict=True):
        _judge_legs(tally, world, certificate, flight, one, unit, f"{where}, {flight.sortie.name}")
    _judge_times(tally, rng, scene, certificate, flights, unit, where)
    _judge_returns(tally, rng, world, scene, certificate, flights, unit, where)
    return tally


def _homes(rng: np.random.Generator, world: World) -> FloatArray | None:
    """Return homes (V, 3) on the ground, in a loose row."""
    count = int(rng.integers(2, len(_NAMES) + 1))
    turn = rng.uniform(0.0, 2.0 * math.pi)
    along = np.array([math.cos(turn), math.sin(turn)]) * rng.uniform(18.0, 50.0)
    first = world.middle + rng.uniform(-0.5, 0.5, 2) * world.half_m
    xy = first + np.arange(count)[:, None] * along + rng.uniform(-3.0, 3.0, (count, 2))
    z = world.land.ground.at(xy)
    return np.concatenate([xy, z[:, None]], axis=1) if np.isfinite(z).all() else None


def _common_way(rng: np.random.Generator, homes: FloatArray) -> FloatArray:
    """Return where all fly from their homes, more or less across the row that these form."""
    row = homes[-1, :2] - homes[0, :2]
    turn = math.atan2(row[1], row[0]) + 0.5 * math.pi + rng.uniform(-0.6, 0.6)
    return rng.uniform(40.0, 280.0) * np.array([math.cos(turn), math.sin(turn)])


def _scene(rng: np.random.Generator, world: World, homes: FloatArray) -> Scene:
    """Return the scene of copters at these homes."""
    vehicles = [
        {
            "name": name,
            "autopilot": str(rng.choice(["ardupilot", "px4"])),
            "home": {"x_m": float(home[0]), "y_m": float(home[1])},
            "goal": {"x_m": float(home[0]), "y_m": float(home[1]), "height_agl_m": 50.0},
            "safety": {
                "terrain_m": float(rng.uniform(5.0, 25.0)),
                "obstacle_m": float(rng.uniform(2.0, 12.0)),
                "landing_slope_max_deg": 89.0,
            },
            "tracking_error_m": float(rng.uniform(0.5, 2.0)),
            "position_error_m": float(rng.uniform(0.2, 1.0)),
            "climb": {"angle_max_deg": 89.0},
            "descent": {"angle_max_deg": 89.0},
        }
        for name, home in zip(_NAMES, homes, strict=False)
    ]
    question = Mission.model_validate(
        {
            "name": "random",
            "origin": {"lat_deg": float(rng.uniform(-60.0, 60.0)), "lon_deg": float(rng.uniform(-179.0, 179.0))},
            "terrain": {"kind": "flat", "alt_amsl_m": 0.0},
            "vehicles": vehicles,
            "fleet": {"separation_m": float(rng.uniform(3.0, 12.0))},
        }
    )
    scene = build_check_scene(question, Path(), [])
    tasks = tuple(replace(task, home_m=home) for task, home in zip(scene.tasks, homes, strict=True))
    return replace(
        scene,
        terrain=worlds.terrain_of(world.land, scene.frame),
        obstacles=pack(world.solids),
        space=world.space,
        tasks=tasks,
    )


def _items(
    rng: np.random.Generator, world: World, scene: Scene, task: VehicleTask, way: FloatArray | None
) -> tuple[MissionItem, ...]:
    """Return a mission whose legs just keep clear of the ground, or just not, in altitude frames of all kinds."""
    home = task.home_m
    count = int(rng.integers(2, 6))
    goal = home[:2] + (rng.uniform(-250.0, 250.0, 2) if way is None else way + rng.uniform(-5.0, 5.0, 2))
    aside = 60.0 if way is None else 4.0
    share = np.sort(rng.random(count - 1))[:, None]
    xy = np.concatenate([home[None, :2], home[:2] + share * (goal - home[:2]), goal[None]])
    xy[1:-1] += rng.uniform(-aside, aside, (count - 1, 2))
    need_m, tube_m = task.limits.terrain_margin_m, task.limits.tube_m
    ground = world.land.ground.at(xy)
    z = np.where(np.isnan(ground), home[2], ground) + need_m + rng.uniform(5.0, 30.0, len(xy))
    corners = np.concatenate([xy, z[:, None]], axis=1)
    for _ in range(2):  # both ends of a leg that is too low are raised
        legs = clearance.polyline_legs(corners)
        lift = worlds.raised(world.land.ground, legs, np.full(count, need_m + tube_m))[:, 0, 2] - legs[:, 0, 2]
        corners[:-1, 2] += np.maximum(lift, 0.0)
        corners[1:, 2] += np.maximum(lift, 0.0)
    legs = clearance.polyline_legs(corners)
    bound = clearance.tube_clearances(world.space, world.land.bounds, legs, np.full(count, tube_m)).height_min_m.min()
    if math.isfinite(bound):
        corners[:, 2] -= bound - need_m - rng.uniform(-0.01, 0.3)
    corners[0, 2] = max(corners[0, 2], home[2] + 3.0)
    return _as_items(rng, scene.frame, task.motion.autopilot, home, corners)


def _as_items(
    rng: np.random.Generator, frame: LocalFrame, autopilot: Autopilot, home: FloatArray, corners: FloatArray
) -> tuple[MissionItem, ...]:
    speed_m_s = float(rng.uniform(3.0, 10.0))

    def at(command: int, place: FloatArray) -> MissionItem:
        point = frame.geo_point(place)
        datum = int(rng.choice([*_AMSL_FRAMES, *_HOME_FRAMES]))
        alt_m = place[2] if datum in _AMSL_FRAMES else place[2] - home[2]
        alt_m = alt_m if abs(alt_m) > _KEEPS_M else _KEEPS_M
        x, y = degrees_to_wire(point.lat_deg), degrees_to_wire(point.lon_deg)
        return MissionItem(0, datum, command, x=x, y=y, z=float(alt_m))

    ending: MissionItem = (
        at(LAND, corners[-1]),
        MissionItem(0, FRAME_MISSION, RETURN_TO_LAUNCH),
        at(LOITER_UNLIMITED, corners[-1]),
    )[int(rng.choice(3, p=[0.6, 0.2, 0.2]))]
    items = [
        *([replace(at(WAYPOINT, home), frame=FRAME_GLOBAL, z=float(home[2]))] if autopilot == "ardupilot" else []),
        replace(at(TAKEOFF, corners[0]), frame=FRAME_RELATIVE, z=float(corners[0, 2] - home[2])),
        MissionItem(0, FRAME_MISSION, CHANGE_SPEED, 1.0, speed_m_s, -1.0),
        *(at(WAYPOINT, corner) for corner in corners[1:]),
        ending,
    ]
    return tuple(replace(item, seq=seq, current=int(seq == 0)) for seq, item in enumerate(items))


@functools.lru_cache(maxsize=4)
def _from_degrees(lat_deg: float, lon_deg: float) -> Transformer:
    local = f"+proj=tmerc +lat_0={lat_deg!r} +lon_0={lon_deg!r} +k=1 +ellps=WGS84 +units=m"
    return Transformer.from_crs("EPSG:4326", local, always_xy=True)


def _told(items: Sequence[MissionItem], task: VehicleTask, frame: LocalFrame) -> _Told:
    """Return what items say, read without the reader's help."""
    way = _from_degrees(frame.origin_lat_deg, frame.origin_lon_deg)

    def place(item: MissionItem, home_z: float) -> FloatArray:
        x, y = way.transform(item.y / 1e7, item.x / 1e7)
        return np.array([x, y, item.z if item.frame in _AMSL_FRAMES else home_z + item.z])

    home = task.home_m
    if task.motion.autopilot == "ardupilot":
        home, items = place(items[0], 0.0), items[1:]
    corners = [place(item, float(home[2])) for item in items if item.command in (TAKEOFF, WAYPOINT)]
    corners[0][:2] = home[:2]
    endings: dict[int, Ending] = {LAND: "land", RETURN_TO_LAUNCH: "rtl", LOITER_UNLIMITED: "loiter"}
    kinds = ("takeoff", *["straight"] * (len(corners) - 1))
    return _Told(home, np.array(corners), endings[items[-1].command], kinds)


def _with_return_heights(rng: np.random.Generator, scene: Scene, read: list[Sortie]) -> tuple[list[Sortie], bool]:
    """Return sorties that return at heights chosen for them, in most fleets, and whether they do."""
    if rng.random() < 0.2 or any(sortie.ending == "rtl" for sortie in read):  # whose flight depends on its height
        return read, False
    flights = proof.predict(scene, read)

    def apart_m(i: int, j: int) -> float:
        return proof.required_apart_m(scene, flights[i].task, flights[j].task)

    try:
        heights_m = returns.choose_return_heights(
            scene.space,
            scene.terrain.bounds,
            scene.obstacles.names,
            [proof.returning(flight) for flight in flights],
            apart_m,
            [None] * len(read),
        )
    except InfeasibleError:
        return read, False
    return [replace(sortie, return_height_m=h) for sortie, h in zip(read, heights_m, strict=True)], True


def _judge_chosen(tally: Tally, certificate: Certificate, chosen: bool, where: str) -> None:
    """Heights chosen for the returns must be ones with which they are proven."""
    if not chosen:
        return
    for finding in _of(certificate, "return"):
        tally.claims["fleets: chosen return heights"] += 1
        if not finding.proven:
            value, required = finding.value or 0.0, finding.required or 0.0
            tally.violations.append(
                Violation("fleets", "chosen return heights", required, value, f"{where}: {finding}")
            )


def _of(certificate: Certificate, check: str, vehicle: str | None = None) -> Iterator[Finding]:
    for finding in certificate.findings:
        if finding.check == check and vehicle in (None, finding.vehicle):
            yield finding


def _judge_legs(
    tally: Tally,
    world: World,
    certificate: Certificate,
    flight: Flight,
    told: _Told,
    unit: FloatArray,
    where: str,
) -> None:
    """Hold a vehicle's clearances against samples of the legs it was told to fly."""
    name, limits = flight.sortie.name, flight.task.limits
    legs = [leg for leg in certificate.legs if leg.vehicle == name and leg.kind in ("takeoff", "straight")]
    off = max(float(np.linalg.norm(np.array(leg.end_m) - c)) for leg, c in zip(legs, told.corners_m, strict=False))
    read_well = off <= _PLACE_M and len(legs) == len(told.corners_m) and flight.sortie.ending == told.ending
    tally.claim("fleets", "items", 1.0, float(read_well), where)
    way = np.concatenate([told.home_m[None], told.corners_m])
    over_ground = [False] + [True] * (len(told.corners_m) - 1)
    if told.ending == "rtl":
        level = max(way[-1, 2], told.home_m[2] + flight.sortie.return_height_m)
        back = np.array([[*way[-1, :2], level], [*told.home_m[:2], level], told.home_m])
        way, over_ground = np.concatenate([way, back]), [*over_ground, True, True, False]
    elif told.ending == "land":
        ground_m = float(world.land.ground.at(way[-1:, :2])[0])
        if math.isnan(ground_m):
            return
        way, over_ground = np.concatenate([way, [[*way[-1, :2], ground_m]]]), [*over_ground, False]
    pieces = clearance.polyline_legs(way)
    seen = oracle.sample_legs(
        world.land.ground, world.seen, pieces, np.full(len(pieces), limits.tube_m), FLEET_STEP_M, unit
    )
    tally.samples["fleets' legs"] += int(seen[:, oracle.COUNT].sum())
    least = {
        "terrain": float(seen[over_ground, oracle.LOWEST].min()),
        "obstacle": float(seen[:, oracle.OBSTACLE].min()),
        "fence": float(seen[:, oracle.FENCE].min()),
    }
    for check, seen_m in least.items():
        for finding in _of(certificate, check, name):
            if finding.value is not None and math.isfinite(finding.value):
                claimed = max(finding.value, _required(limits, check)) if finding.proven else finding.value
                if check == "terrain" or claimed > 0.0:  # the oracle measures no depths
                    tally.claim("fleets", check, claimed, seen_m, where)


def _required(limits: VehicleLimits, check: str) -> float:
    return limits.terrain_margin_m if check == "terrain" else limits.obstacle_margin_m


def _judge_times(
    tally: Tally,
    rng: np.random.Generator,
    scene: Scene,
    certificate: Certificate,
    flights: Sequence[Flight],
    unit: FloatArray,
    where: str,
) -> None:
    """Hold separation and lateness against positions at every tick, each strayed, any one vehicle early or late."""
    end_s = max(float(flight.trajectory.t_s[-1]) for flight in flights)
    [apart] = _of(certificate, "separation")
    [late] = _of(certificate, "lateness")
    separation_m = scene.mission.fleet.separation_m
    if apart.value is None or apart.required is None or late.value is None:
        return
    slack_s = late.value
    ticks = np.arange(-slack_s, end_s + slack_s + TICK_S, TICK_S)
    on_time = [_positions(flight, ticks) for flight in flights]
    strays = [flight.task.limits.tracking_error_m + flight.task.limits.position_error_m for flight in flights]

    def least(moved: int | None, places: FloatArray | None) -> float:
        found = math.inf
        for i in range(len(flights)):
            for j in range(i + 1, len(flights)):
                if moved is not None and moved not in (i, j):
                    continue
                a = places if places is not None and i == moved else on_time[i]
                b = places if places is not None and j == moved else on_time[j]
                first = int(rng.integers(0, len(unit)))
                found = min(found, float(oracle.least_strayed(a, b, strays[i], strays[j], unit, first)))
                tally.samples["fleets' instants"] += 2 * len(ticks)
        return found

    spare_m = apart.value - apart.required
    claimed = separation_m + (max(spare_m, 0.0) if apart.proven else spare_m)
    if claimed > 0.0:
        tally.claim("fleets", "separation", claimed, max(least(None, None), -1e9), where)
    if slack_s <= 0.0:
        return
    most = slack_s - 1e-6
    shifts = [-most, most, *rng.uniform(-most, most, _SHIFTS)]
    for moved, flight in enumerate(flights):
        for shift_s in shifts:
            seen = least(moved, _positions(flight, ticks - shift_s))
            tally.claim("fleets", "lateness", separation_m, seen, f"{where}, {flight.sortie.name} {shift_s:+.3f} s")


def _positions(flight: Flight, t_s: FloatArray) -> FloatArray:
    trajectory = flight.trajectory
    return np.stack([np.interp(t_s, trajectory.t_s, trajectory.position_m[:, k]) for k in range(3)], axis=-1)


# --- returns ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Return:
    """One return of one vehicle: its way, and which of its legs must keep above the ground."""

    way_m: FloatArray  # (K, 3)
    over_ground: npt.NDArray[np.bool_]  # (K - 1,)


def _judge_returns(
    tally: Tally,
    rng: np.random.Generator,
    world: World,
    scene: Scene,
    certificate: Certificate,
    flights: Sequence[Flight],
    unit: FloatArray,
    where: str,
) -> None:
    """Hold what is said of returns against returns from random instants, all vehicles told to at the same one."""
    names = [flight.sortie.name for flight in flights]
    alone = {name: next(_of(certificate, "return", name)) for name in names}
    if any(finding.value is None or finding.required is None for finding in alone.values()):
        return
    end_s = max(float(flight.trajectory.t_s[-1]) for flight in flights)
    critical = [f.t_s for f in _of(certificate, "return") if f.t_s is not None]
    instants = [*rng.uniform(0.0, end_s + 20.0, _TRIGGERS), *rng.choice(critical, min(3, len(critical)), replace=False)]
    apart_m = scene.mission.fleet.separation_m
    for t in instants:
        told = [_returns_at(rng, flight, float(t) + rng.uniform(-0.05, 0.05)) for flight in flights]
        for flight, one in zip(flights, told, strict=True):
            if one is None or len(one.over_ground) == 0:
                continue
            limits = flight.task.limits
            pieces = clearance.polyline_legs(one.way_m)
            stray = np.full(len(pieces), limits.stray_m)
            seen = oracle.sample_legs(world.land.ground, world.seen, pieces, stray, FLEET_STEP_M, unit)
            tally.samples["returns"] += int(seen[:, oracle.COUNT].sum())
            finding = alone[flight.sortie.name]
            assert finding.value is not None
            assert finding.required is not None
            spare_m = finding.value - finding.required
            at = f"{where}, {flight.sortie.name} returns at {t:.2f} s"
            low = float(seen[one.over_ground, oracle.LOWEST].min(initial=math.inf))
            for of, seen_m, need_m in (
                ("terrain", low, limits.terrain_margin_m),
                ("obstacle", float(seen[:, oracle.OBSTACLE].min()), limits.obstacle_margin_m),
                ("fence", float(seen[:, oracle.FENCE].min()), limits.obstacle_margin_m),
            ):
                claimed = need_m + spare_m
                if claimed > 0.0 or of == "terrain":
                    tally.claim("fleets", f"return, {of}", claimed, seen_m, at)
        walks = [None if one is None else oracle.walk(one.way_m) for one in told]
        for i in range(len(flights)):
            for j in range(i + 1, len(flights)):
                finding = next(_of(certificate, "return", f"{names[i]} - {names[j]}"))
                a, b = walks[i], walks[j]
                if a is None or b is None or finding.value is None or finding.required is None:
                    continue
                errors = sum(
                    f.task.limits.tracking_error_m + f.task.limits.position_error_m for f in (flights[i], flights[j])
                )
                seen_m = float(oracle.least_between(a, b)) - errors
                tally.samples["returning pairs"] += len(a) + len(b)
                claimed = apart_m + finding.value - finding.required
                both = f"{where}, {names[i]} - {names[j]} return at {t:.2f} s"
                if claimed + errors > 0.0:
                    tally.claim("fleets", "return, apart", claimed, seen_m, both)


def _returns_at(rng: np.random.Generator, flight: Flight, t_s: float) -> _Return | None:
    """Return one way in which a copter may come home when told to at an instant; None: not before its start."""
    trajectory, sortie, motion = flight.trajectory, flight.sortie, flight.task.motion
    home = sortie.home_m
    start_s = float(trajectory.t_s[0])
    places = _positions(flight, np.array([t_s - 0.05, t_s, t_s + 0.05]))
    end_s = float(trajectory.t_s[-1])
    here = places[1]
    if t_s > end_s and sortie.ending != "loiter":
        return _Return(here[None], np.zeros(0, dtype=bool))  # landed for good
    if t_s < start_s:
        return _Return(home[None], np.zeros(0, dtype=bool))
    velocity = (places[2] - places[0]) / 0.1
    speed, a, jerk = math.hypot(velocity[0], velocity[1]), motion.acceleration_m_s2, motion.jerk_m_s3
    if motion.autopilot == "px4":
        ahead = speed * speed / (2.0 * a) + speed * a / (2.0 * jerk)
    else:  # sqrt controller, P = 1 / s
        ahead = speed * speed / (2.0 * a) + 0.5 * a if speed > a else speed
    share = float(rng.choice([0.0, 1.0, rng.random()]))
    stop = here.copy()
    if speed > 0.3:
        stop[:2] += share * ahead * velocity[:2] / speed
    lowest, rate = float(home[2]) + sortie.return_height_m, abs(velocity[2])
    overrun = 0.5 * rate * rate + 0.5 if rate > 1.0 else rate  # sqrt controller, 1 m/s^2, P = 1 / s
    if velocity[2] > 0.0 and here[2] + overrun < lowest:  # it climbs on while it brakes
        stop[2] += rng.uniform(0.8, 1.0) * velocity[2] * share * ahead / max(speed, 0.3)
    else:
        stop[2] += float(rng.choice([0.0, 1.0, rng.random()])) * math.copysign(overrun, velocity[2])
    if t_s < flight.reached_s[0] or t_s > flight.reached_s[-1]:
        stop[2] = max(stop[2], min(here[2], home[2]))  # the ground is below
    level = max(stop[2], float(home[2]) + sortie.return_height_m)
    way = np.array([here, stop, [*stop[:2], level], [*home[:2], level], home])
    on_mission = bool(flight.reached_s[0] <= t_s <= flight.reached_s[-1])
    return _Return(way, np.array([on_mission, on_mission, t_s >= flight.reached_s[0], False]))
