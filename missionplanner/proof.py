"""The certificate: what is proven of a fleet's missions before they may be flown.

The object of the proof is what the vehicles are to hold, as :class:`.Sortie`, read back from the exported missions.
Each flight stays within a tube: around its legs for copters, around the predicted flight for planes, whose radius is
stated (:class:`.VehicleLimits`). Every check is a bound for the whole continuous tube, never a sample of it. What
cannot be decided is not proven, and missing terrain is no clearance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from missionplanner import __version__, energy, returns, timing, wind
from missionplanner.autopilot_parameters import usual
from missionplanner.certificate import Certificate, Check, Finding, LegVerdict, Position
from missionplanner.clearance import TubeClearances, distance_to_legs_m, polyline_legs, tube_clearances
from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.flight_check import COLUMN_M, nearest_pair
from missionplanner.geodesy import FloatArray
from missionplanner.motion import TICK_S, climbing_as_stated
from missionplanner.motion.spline import spline_chords
from missionplanner.plan import Clearance, FleetPlan, Trajectory, VehiclePlan
from missionplanner.returns import Returning
from missionplanner.scene import RUNWAY_RISE_M, Scene, VehicleTask
from missionplanner.sortie import Gap, Leg, Sortie
from missionplanner.terrain_bounds import steepest
from missionplanner.vehicle import MotionModel
from missionplanner.waypoints import AT_STOP_M, passes

ARRIVAL_ERROR_MAX_S = 0.5
"""How far a predicted arrival may be from the common one."""

LATENESS_LIMIT_S = 60.0
"""Lateness up to which it is asked whether all still keep apart."""

_SPLINE_CHORD_M = 0.05
_CHORD_TICKS = 2  # planes pull 3 g, and 5 as they lift off
CHORD_ERROR_M = 0.04
"""Chords of 0.1 s of a predicted flight are at most so far off it at 32 m/s^2."""
_ANGLE_SLACK_RAD = 1e-5
_WIND_DIRECTIONS = 8  # from which the strongest wind blows where planes are held to their tubes in it
_WIND_TICKS = 4
_RECORDED_M_S = 10.5
_JOINED_M, _JOINED_S = 1.0, 10.0  # two climb-outs are one again once they have stayed so near for so long
_RUNG_M = 1.0
_SPEED_SLACK_M_S = 1e-3  # single precision on the wire
_LEVEL_M = 0.01
_MEETING_M = 0.1  # a waypoint is at a place of the route as far as its wire format tells


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """A sortie with its vehicle's limits and its predicted flight; not ``timed`` where the model does not know how."""

    task: VehicleTask
    sortie: Sortie
    trajectory: Trajectory
    reached_s: FloatArray  # (L,) at the ends of the legs
    timed: bool

    @property
    def descends_s(self) -> float:
        """When it begins to sink to its landing place; its flight's end where it stays in the air."""
        if self.sortie.ending == "land":
            return float(self.reached_s[-1])
        if self.sortie.ending == "loiter" or self.sortie.vehicle_class == "plane":
            return float(self.trajectory.t_s[-1])
        position_m = self.trajectory.position_m
        away = np.flatnonzero(np.hypot(*(position_m[:, :2] - position_m[-1, :2]).T) > COLUMN_M)
        above_home = min(int(away[-1]) + 1, len(position_m) - 1) if away.size else 0
        return max(float(self.reached_s[-1]), float(self.trajectory.t_s[above_home]))


def prove(
    scene: Scene,
    sorties: Sequence[Sortie],
    *,
    mission_sha256: Mapping[str, str] | None = None,
    arrival_s: float | None = None,
) -> Certificate:
    """Return what is proven of sorties, of vehicles that the scene knows by name.

    Parameters
    ----------
    mission_sha256 : hashes of the missions that the sorties were read from, by vehicle's name
    arrival_s : the planned common arrival; None: no arrival is asked about
    """
    return prove_flights(scene, predict(scene, sorties), mission_sha256=mission_sha256, arrival_s=arrival_s)


def predict(scene: Scene, sorties: Sequence[Sortie]) -> list[Flight]:
    """Return sorties with their predicted flights; planes circle until the last vehicle is down.

    Raises
    ------
    MissionError
        A sortie with a number that is not finite: no bound holds for it.
    InfeasibleError
        A leg that cannot be flown in the wind: no flight along it can be predicted.
    """
    tasks = {task.name: task for task in scene.tasks}
    wind.refuse_storm([tasks[sortie.name] for sortie in sorties])
    for sortie in sorties:
        _check_finite(sortie)
        _check_wind(tasks[sortie.name], sortie)
    flights = [_predicted(scene, tasks[sortie.name], sortie) for sortie in sorties]
    last_s = max(float(flight.trajectory.t_s[-1]) for flight in flights)
    return [_predicted(scene, f.task, f.sortie, last_s) if f.sortie.vehicle_class == "plane" else f for f in flights]


def _check_finite(sortie: Sortie) -> None:
    told = [(f"item {leg.seq}", [*leg.end_m.tolist(), leg.speed_m_s, leg.hold_s, leg.radius_m]) for leg in sortie.legs]
    told += [
        ("home", sortie.home_m.tolist()),
        ("start delay and return height", [sortie.start_delay_s, sortie.return_height_m]),
    ]
    for what, numbers in told:
        if not np.isfinite(numbers).all():
            raise MissionError(f"{sortie.name}: {what}: expected finite numbers, got {numbers}")


def _check_wind(task: VehicleTask, sortie: Sortie) -> None:
    for before, leg in pairwise(sortie.legs):
        problem = wind.leg_problem(task.limits, task.motion, leg.end_m - before.end_m, leg.speed_m_s)
        if problem is not None:
            raise InfeasibleError(f"{sortie.name}: item {leg.seq}: its leg {problem}")


def prove_flights(
    scene: Scene,
    flights: Sequence[Flight],
    *,
    mission_sha256: Mapping[str, str] | None = None,
    arrival_s: float | None = None,
) -> Certificate:
    """Return what is proven of predicted flights."""
    findings: list[Finding] = []
    legs: list[LegVerdict] = []
    for flight in flights:
        found, verdicts = _vehicle(scene, flight)
        findings += found
        legs += verdicts
    findings += _together(scene, flights)
    findings += _circling(scene, flights)
    findings += _returns(scene, flights)
    findings += _arrival(scene, flights, arrival_s)
    findings += _rendezvous(scene, flights)
    findings += _inspection(scene, flights)
    return Certificate(
        findings=tuple(findings),
        legs=tuple(legs),
        assumptions=tuple(_assumptions(scene, flights)),
        mission_sha256=dict(mission_sha256 or {}),
        return_height_m={f.sortie.name: f.sortie.return_height_m for f in flights},
        input_sha256=scene.input_sha256,
        software_version=__version__,
    )


# --- a fleet plan: the planner's own missions, rounded as they will be on the wire ----------------------------------


def planned_sortie(scene: Scene, vehicle: VehiclePlan) -> Sortie:
    """Return what a vehicle will hold of its plan: places to 1e-7 degrees, altitudes in single precision."""

    def held(position_m: FloatArray) -> FloatArray:
        point = scene.frame.geo_point(position_m)
        alt_amsl_m = float(np.float32(point.alt_amsl_m))
        return scene.frame.to_local(round(point.lat_deg, 7), round(point.lon_deg, 7), alt_amsl_m)

    speeds_m_s = np.float32(vehicle.speeds_m_s).astype(float).tolist()
    first = 1 if vehicle.autopilot == "ardupilot" else 0  # of the take-off; a new speed comes before its leg
    changes = np.concatenate([[True], np.diff(vehicle.speeds_m_s) != 0.0])
    steps = vehicle.steps()
    between = [len(at) + len(before) for (_, at), (before, _) in pairwise(steps)]
    seqs = [first, *(first + np.cumsum(1 + changes + np.array(between, dtype=int))).tolist()]
    legs = tuple(
        Leg(seqs[k + 1], "straight", held(waypoint_m), speeds_m_s[k], float(vehicle.hold_s[k]))
        for k, waypoint_m in enumerate(vehicle.waypoints_m[1:])
    )
    takeoff = Leg(seqs[0], "takeoff", held(vehicle.waypoints_m[0]), speeds_m_s[0])
    return Sortie(
        name=vehicle.name,
        sysid=vehicle.sysid,
        autopilot=vehicle.autopilot,
        vehicle_class=vehicle.vehicle_class,
        home_m=held(vehicle.home_m) if vehicle.autopilot == "ardupilot" else vehicle.home_m,
        legs=(takeoff, *legs),
        ending=vehicle.end,
        ending_seq=seqs[-1] + len(steps[-1][1]) + 1,
        start_delay_s=vehicle.start_delay_s,
        return_height_m=vehicle.motion.return_height_m,
    )


def checked(scene: Scene, plan: FleetPlan) -> FleetPlan:
    """Return the plan with its certificate, and from it all least clearances and the least separation."""
    certificate = prove(scene, [planned_sortie(scene, v) for v in plan.vehicles], arrival_s=plan.arrival_s)
    vehicles = tuple(replace(v, clearances=clearances(certificate, v.name)) for v in plan.vehicles)
    pairs = [f for f in certificate.findings if f.check == "separation" and f.value is not None]
    nearest = min((_clearance(f) for f in pairs), key=lambda c: c.distance_m - c.required_m, default=None)
    return replace(plan, vehicles=vehicles, separation=nearest, certificate=certificate)


def clearances(certificate: Certificate, vehicle: str) -> tuple[Clearance, ...]:
    """Return one vehicle's proven least clearances: terrain, obstacle, ceiling and fence, where there are any."""
    wanted = ("terrain", "obstacle", "ceiling", "fence")
    found = [f for f in certificate.findings if f.vehicle == vehicle and f.check in wanted and f.value is not None]
    return tuple(_clearance(f) for f in sorted(found, key=lambda f: wanted.index(f.check)))


def _clearance(finding: Finding) -> Clearance:
    assert finding.value is not None
    assert finding.required is not None
    assert finding.position_m is not None
    what = finding.to or (finding.check if finding.check != "separation" else finding.vehicle)
    return Clearance(finding.value, finding.required, what, finding.position_m, finding.t_s)


# --- one vehicle ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Tube:
    """Pieces of one leg's tube: (N, 2, 3), how much wider than the vehicle's it is, and whether ground is asked for.

    ``weaker``: where a plane flies that climbs out no better than stated, or, if it is so, any between the two.
    """

    leg: Leg
    kind: str
    pieces: FloatArray
    wider_m: float
    over_terrain: bool
    weaker: Literal["", "flown", "between"] = ""


def _predicted(scene: Scene, task: VehicleTask, sortie: Sortie, until_s: float = 0.0) -> Flight:
    trajectory, reached_s = _flown(scene, task.motion, sortie, until_s)
    timed = not sortie.gaps and all(leg.kind in ("takeoff", "straight", "spline") for leg in sortie.legs)
    return Flight(task, sortie, trajectory, reached_s, timed)


def _flown(scene: Scene, motion: MotionModel, sortie: Sortie, until_s: float = 0.0) -> tuple[Trajectory, FloatArray]:
    """Return what a vehicle that moves so is predicted to fly of a sortie, and when it reaches the ends of its legs."""
    last = sortie.legs[-1].end_m
    ground_m = float(scene.terrain.height_amsl_m(last[0], last[1]))
    return timing.predict_flight(
        replace(motion, return_height_m=sortie.return_height_m),
        sortie.home_m,
        np.array([leg.end_m for leg in sortie.legs]),
        np.array([leg.speed_m_s for leg in sortie.legs[1:]] or [sortie.legs[0].speed_m_s]),
        hold_s=np.array([leg.hold_s for leg in sortie.legs[1:]] or [0.0]),
        spline=np.array([leg.kind == "spline" for leg in sortie.legs[1:]] or [False]),
        vertical_m_s=np.array([leg.vertical_m_s for leg in sortie.legs[1:]] or [math.inf]),
        end=sortie.ending,
        ground_amsl_m=ground_m if math.isfinite(ground_m) else float(sortie.home_m[2]),
        start_delay_s=sortie.start_delay_s,
        until_s=until_s,
    )


def _vehicle(scene: Scene, flight: Flight) -> tuple[list[Finding], list[LegVerdict]]:
    tubes = _tubes(scene, flight)
    radius_m = flight.task.limits.tube_m
    pieces = np.concatenate([tube.pieces for tube in tubes])
    wide = np.concatenate([np.full(len(tube.pieces), radius_m + tube.wider_m) for tube in tubes])
    owner = np.concatenate([np.full(len(tube.pieces), k) for k, tube in enumerate(tubes)])
    table = tube_clearances(scene.space, scene.terrain.bounds, pieces, wide)
    asked = np.array([tube.over_terrain for tube in tubes])[owner]
    findings = [
        _understood(flight),
        *_heights(flight, tubes, owner, table, asked, pieces, wide),
        *_distances(scene, flight, tubes, owner, table),
        *_takeoff(flight, tubes, owner, table),
        _angles(flight),
        _turns(flight),
        _speeds(flight),
        *_in_wind(scene, flight, tubes),
        *_landings(scene, flight),
        *_energy(scene, flight),
    ]
    return findings, _verdicts(scene, flight, tubes, owner, table, asked)


def _tubes(scene: Scene, flight: Flight) -> list[_Tube]:
    """Return the legs' tubes, take-off first, the ending last."""
    if flight.sortie.vehicle_class == "plane":
        return _predicted_tubes(flight) + _weaker_tubes(scene, flight)
    sortie, tubes = flight.sortie, []
    begins = sortie.home_m[np.newaxis]  # where the next leg may begin: anywhere on a circle
    wider_m = 0.0  # what lies between those places
    for index, leg in enumerate(sortie.legs):
        match leg.kind:
            case "takeoff" | "straight":
                way = _ways(begins, leg.end_m)
                tubes.append(_Tube(leg, leg.kind, way, wider_m, over_terrain=leg.kind == "straight"))
            case "spline":
                curve = spline_chords(sortie, index, _SPLINE_CHORD_M)
                tubes.append(_Tube(leg, leg.kind, polyline_legs(curve), _SPLINE_CHORD_M, over_terrain=True))
            case "circle":
                ring = _ring(leg.end_m, leg.radius_m)
                off_m = flight.task.limits.tube_m + wider_m
                way = np.concatenate([_ways_onto_circle(begins, leg, ring, off_m), polyline_legs(ring)])
                tubes.append(_Tube(leg, leg.kind, way, max(wider_m, _between_m(leg.radius_m)), over_terrain=True))
        begins, wider_m = leg.end_m[np.newaxis], 0.0
        if leg.kind == "circle":
            begins, wider_m = ring, _between_m(leg.radius_m)
    last = replace(sortie.legs[-1], seq=sortie.ending_seq)
    match sortie.ending:
        case "land":
            x, y, _ = sortie.legs[-1].end_m
            # as predicted it ends a few centimetres above the ground
            bottom_m = np.fmin(flight.trajectory.position_m[-1, 2], scene.terrain.height_amsl_m(x, y))
            tubes.append(_Tube(last, "land", _columns(begins, float(bottom_m)), wider_m, over_terrain=False))
        case "rtl":
            motion = replace(flight.task.motion, return_height_m=sortie.return_height_m)
            level_m = motion.return_alt_amsl_m(float(begins[0, 2]), float(sortie.home_m[2]))
            up, above = _columns(begins, level_m), np.array([*sortie.home_m[:2], level_m])
            way = np.concatenate([up, _ways(up[:, 1], above)])
            tubes.append(_Tube(last, "return", way, wider_m, over_terrain=True))
            tubes.append(_Tube(last, "land", _ways(above[np.newaxis], sortie.home_m), 0.0, over_terrain=False))
        case "loiter":
            tubes.append(_Tube(last, "loiter", np.stack([begins, begins], axis=1), wider_m, over_terrain=True))
    return tubes


_RING_SIDES = 64


def _ring(centre_m: FloatArray, radius_m: float) -> FloatArray:
    """Return a closed polygon (N, 3) on a level circle."""
    angle = np.linspace(0.0, 2.0 * math.pi, _RING_SIDES + 1)
    return centre_m + radius_m * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)


def _between_m(radius_m: float) -> float:
    """Return how far a place on a circle is at most from the nearest corner of its polygon."""
    return 2.0 * radius_m * math.sin(0.25 * 2.0 * math.pi / _RING_SIDES)


def _ways_onto_circle(starts_m: FloatArray, leg: Leg, ring: FloatArray, off_m: float) -> FloatArray:
    """Return legs (N, 2, 3) from places (N, 3), off by ``off_m`` at most, to where a copter may enter a circle.

    That is where its edge is nearest, at its altitude already (ArduCopter's circle_movetoedge_start). Who is outside
    by more than it may be off enters no further off than that; who is not may enter anywhere.
    """
    ways = []
    for start in starts_m:
        out = (start - leg.end_m) * (1.0, 1.0, 0.0)
        away_m = float(np.linalg.norm(out))
        ends = ring
        if away_m - off_m > leg.radius_m:
            edge = leg.end_m + (leg.radius_m / away_m) * out
            near = np.linalg.norm(ring - edge, axis=1) <= off_m + _between_m(leg.radius_m)
            ends = np.concatenate([edge[np.newaxis], ring[near]])
        ways.append(np.stack([np.broadcast_to(start, ends.shape), ends], axis=1))
    return np.concatenate(ways)


def _ways(starts_m: FloatArray, end_m: FloatArray) -> FloatArray:
    """Return legs (N, 2, 3) from places (N, 3) to one."""
    return np.stack([starts_m, np.broadcast_to(end_m, starts_m.shape)], axis=1)


def _columns(places_m: FloatArray, alt_amsl_m: float) -> FloatArray:
    """Return vertical legs (N, 2, 3) from places (N, 3) to one altitude."""
    ends = places_m.copy()
    ends[:, 2] = alt_amsl_m
    return np.stack([places_m, ends], axis=1)


def chords(trajectory: Trajectory, from_s: float) -> FloatArray:
    """Return a predicted flight from a time on as legs (N, 2, 3), no more than :data:`CHORD_ERROR_M` off it."""
    position = trajectory.position_m[np.searchsorted(trajectory.t_s, from_s) :]
    return polyline_legs(np.concatenate([position[:-1:_CHORD_TICKS], position[-1:]]))


def _predicted_tubes(flight: Flight) -> list[_Tube]:
    """Return a plane's predicted flight, leg by leg, the take-off first and what comes after the last leg last."""
    trajectory, sortie = flight.trajectory, flight.sortie
    ends = [int(np.searchsorted(trajectory.t_s, t)) for t in flight.reached_s]
    ends = [0, *ends, len(trajectory.t_s) - 1]
    legs = [*sortie.legs, replace(sortie.legs[-1], seq=sortie.ending_seq)]
    kinds = [*(leg.kind for leg in sortie.legs), sortie.ending]
    tubes = []
    for (first, last), leg, kind in zip(pairwise(ends), legs, kinds, strict=True):
        ticks = 1 if kind == "takeoff" else _CHORD_TICKS  # short pieces, of which it has climbed each as a whole
        chosen = np.unique([*range(first, last, ticks), last])
        flown = trajectory.position_m[chosen if len(chosen) > 1 else np.repeat(chosen, 2)]
        tubes.append(_Tube(leg, kind, polyline_legs(flown), CHORD_ERROR_M, over_terrain=kind != "takeoff"))
    return tubes


def _weaker_tubes(scene: Scene, flight: Flight) -> list[_Tube]:
    """Return where a plane flies that climbs out no better than stated, until it flies as predicted, and any between.

    What its climb rate says is all that is known of a real one; predicted is a strong one. The height of any other is
    between theirs as long as it climbs, and where they turn onto their way the weaker one turns last.
    """
    sortie, motion = flight.sortie, flight.task.motion
    stated = climbing_as_stated(motion, float(sortie.home_m[2]))
    if stated.plane == motion.plane:
        return []
    trajectory, reached_s = _flown(scene, stated, sortie)
    strong, weak = flight.trajectory.position_m, trajectory.position_m
    top = int(np.searchsorted(flight.trajectory.t_s, flight.reached_s[0]))
    weak_top = int(np.searchsorted(trajectory.t_s, reached_s[0]))
    end, weak_end = _joined(strong, top, weak, weak_top)
    takeoff = sortie.legs[0]
    after, kind = (sortie.legs[1], sortie.legs[1].kind) if len(sortie.legs) > 1 else (takeoff, sortie.ending)
    if len(sortie.legs) == 1:
        after = replace(takeoff, seq=sortie.ending_seq)
    return [
        _Tube(takeoff, "takeoff", polyline_legs(weak[: weak_top + 1]), CHORD_ERROR_M, False, "flown"),
        _Tube(takeoff, "takeoff", *_above(weak[: weak_top + 1], strong[: top + 1]), False, "between"),
        _Tube(after, kind, polyline_legs(weak[_every_chord(weak_top, weak_end)]), CHORD_ERROR_M, True, "flown"),
        _Tube(after, kind, *_rungs(strong[top : end + 1], weak[weak_top : weak_end + 1]), True, "between"),
    ]


def _every_chord(first: int, last: int) -> npt.NDArray[np.int64]:
    chosen = np.unique([*range(first, last, _CHORD_TICKS), last])
    return chosen if len(chosen) > 1 else np.repeat(chosen, 2)


def _joined(strong: FloatArray, top: int, weak: FloatArray, weak_top: int) -> tuple[int, int]:
    """Return from which samples on the weaker flight is where the other is; their last where it never is."""
    apart_m, _ = cKDTree(strong[top:]).query(weak[weak_top:])
    for_long = round(_JOINED_S / TICK_S)
    far = np.flatnonzero(apart_m > _JOINED_M)
    begins = np.concatenate([[0], far + 1])
    ends = np.concatenate([far, [len(apart_m)]])
    together = np.flatnonzero(ends - begins >= for_long)
    if not together.size:
        return len(strong) - 1, len(weak) - 1
    first = int(begins[together[0]])
    near = np.linalg.norm(strong[top:] - weak[weak_top + first], axis=1) <= _JOINED_M
    return top + int(np.argmax(near)), weak_top + first


def _above(low: FloatArray, high: FloatArray) -> tuple[FloatArray, float]:
    """Return upright legs (N, 2, 3) between two climbs on one course, and how far apart they are at most."""
    out_m = np.hypot(*(low[:, :2] - low[0, :2]).T)
    at_m = np.arange(0.0, out_m[-1], _RUNG_M)
    foot = np.stack([np.interp(at_m, out_m, low[:, axis]) for axis in range(3)], axis=1)
    head = foot.copy()
    head[:, 2] = np.interp(at_m, np.hypot(*(high[:, :2] - high[0, :2]).T), high[:, 2])
    apart = head[:, 2] - foot[:, 2] > _JOINED_M
    return np.stack([foot, head], axis=1)[apart if apart.any() else slice(1)], 0.5 * _RUNG_M


def _rungs(one: FloatArray, other: FloatArray) -> tuple[FloatArray, float]:
    """Return legs (N, 2, 3) between equal shares of two ways, and how far what lies between is from them at most."""
    run = [np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))]) for way in (one, other)]
    count = max(2, math.ceil(max(run[0][-1], run[1][-1]) / _RUNG_M) + 1)
    share = np.linspace(0.0, 1.0, count)
    ends = [
        np.stack([np.interp(share * r[-1], r, way[:, axis]) for axis in range(3)], axis=1)
        for r, way in zip(run, (one, other), strict=True)
    ]
    rungs = np.stack(ends, axis=1)
    apart = np.linalg.norm(rungs[:, 1] - rungs[:, 0], axis=1) > _JOINED_M
    return rungs[apart if apart.any() else slice(1)], 0.5 * _RUNG_M


def _understood(flight: Flight) -> Finding:
    sortie = flight.sortie
    gaps = list(sortie.gaps)
    if sortie.vehicle_class == "plane":
        gaps += [Gap(leg.seq, "how a plane flies this circle is not predicted") for leg in sortie.legs if leg.radius_m]
    if not gaps:
        return Finding("understood", sortie.name, True, "the path of every mission item is known")
    first, *others = gaps  # the finding names the first one's item itself
    told = "; ".join([first.what, *(f"item {gap.seq}: {gap.what}" for gap in others)])
    return Finding("understood", sortie.name, False, told, "replace it by waypoints with altitudes", seq=first.seq)


def _heights(
    flight: Flight,
    tubes: Sequence[_Tube],
    owner: FloatArray,
    table: TubeClearances,
    asked: FloatArray,
    pieces: FloatArray,
    wide: FloatArray,
) -> list[Finding]:
    """Return what is proven of the height above ground, and of the ceilings."""
    limits, name = flight.task.limits, flight.sortie.name
    low = int(np.argmin(np.where(asked, table.height_min_m, np.inf)))
    height_m, need_m = float(table.height_min_m[low]), limits.terrain_margin_m
    leg = tubes[int(owner[low])].leg
    if math.isinf(height_m):
        detail, remedy = "the ground below is not known", "give a terrain that covers the way, without voids"
    elif height_m >= need_m:
        detail, remedy = f"its tube stays at least {height_m:.2f} m above the ground, expected {need_m:g} m", ""
    else:
        detail = f"terrain clearance is {height_m:.2f} m, expected {need_m:g} m"
        way_home = tubes[int(owner[low])].kind == "return"
        remedy = (
            f"raise return_height_m by {need_m - height_m:.1f} m"
            if way_home
            else f"raise waypoint {leg.seq} or the one before it by {need_m - height_m:.1f} m"
        )
    findings = [
        Finding(
            "terrain",
            name,
            height_m >= need_m,
            detail,
            remedy,
            height_m,
            need_m,
            seq=leg.seq,
            position_m=_position(table.height_min_at_m[low]),
        )
    ]
    tops = pieces[:, :, 2].max(axis=1) + wide
    for what, heights, at, most in (
        (
            "above the ground",
            np.where(asked, table.height_max_m, -np.inf),
            table.height_max_at_m,
            limits.height_agl_max_m,
        ),
        ("AMSL", tops, pieces[np.arange(len(pieces)), pieces[:, :, 2].argmax(axis=1)], limits.alt_amsl_max_m),
    ):
        if math.isinf(most):
            continue
        high = int(np.argmax(heights))
        excess_m, seq = float(heights[high]) - most, tubes[int(owner[high])].leg.seq
        findings.append(
            Finding(
                "ceiling",
                name,
                excess_m <= 0.0,
                f"its tube reaches {heights[high]:.2f} m {what}, allowed {most:g} m",
                "" if excess_m <= 0.0 else f"lower waypoint {seq} or the one before it by {excess_m:.1f} m",
                -excess_m,
                0.0,
                seq=seq,
                position_m=_position(at[high]),
            )
        )
    return findings


def _distances(
    scene: Scene, flight: Flight, tubes: Sequence[_Tube], owner: FloatArray, table: TubeClearances
) -> list[Finding]:
    """Return what is proven of the distances to obstacles, and inside the fence."""
    near, edge = int(np.argmin(table.obstacle_m)), int(np.argmin(table.fence_m))
    border = "fence" if scene.mission.fence is not None else "edge of the area"
    findings = []
    if math.isfinite(table.obstacle_m[near]):
        obstacle = scene.obstacles.names[int(table.obstacle[near])]
        findings.append(
            _distance(
                "obstacle",
                obstacle,
                flight,
                float(table.obstacle_m[near]),
                tubes[int(owner[near])],
                table.obstacle_at_m[near],
            )
        )
    else:
        findings.append(Finding("obstacle", flight.sortie.name, True, "there are no obstacles"))
    findings.append(
        _distance("fence", border, flight, float(table.fence_m[edge]), tubes[int(owner[edge])], table.fence_at_m[edge])
    )
    return findings


def _distance(check: Check, to: str, flight: Flight, distance_m: float, tube: _Tube, at_m: FloatArray) -> Finding:
    need_m = flight.task.limits.obstacle_margin_m
    proven = distance_m >= need_m
    return Finding(
        check,
        flight.sortie.name,
        proven,
        f"its tube stays at least {distance_m:.2f} m from {to}, expected {need_m:g} m"
        if proven
        else f"{to} clearance is {distance_m:.2f} m, expected {need_m:g} m",
        "" if proven else f"move waypoint {tube.leg.seq} or the one before it {need_m - distance_m:.1f} m away",
        distance_m,
        need_m,
        to=to if check == "obstacle" else "",
        seq=tube.leg.seq,
        position_m=_position(at_m),
    )


def _takeoff(flight: Flight, tubes: Sequence[_Tube], owner: FloatArray, table: TubeClearances) -> list[Finding]:
    """Return whether the ground falls behind while a plane climbs: its share of the climb, its share of the margin.

    So it must for one that climbs no better than stated. A copter climbs straight up from ground to land on.
    """
    sortie, limits = flight.sortie, flight.task.limits
    if sortie.vehicle_class != "plane":
        return []
    climbs = [k for k, tube in enumerate(tubes) if tube.kind == "takeoff" and tube.weaker != "between"]
    pieces = np.concatenate([tubes[k].pieces for k in climbs])
    height_min_m = np.concatenate([table.height_min_m[owner == k] for k in climbs])
    climbed_m = pieces[:, :, 2].max(axis=1) - sortie.home_m[2]
    share = np.clip(climbed_m / max(float(sortie.legs[0].end_m[2] - sortie.home_m[2]), _LEVEL_M), 0.0, 1.0)
    need_m = share * (limits.terrain_margin_m + limits.tube_m) - limits.tube_m - RUNWAY_RISE_M
    worst = int(np.argmin(height_min_m - need_m))
    lacks_m = float(need_m[worst] - height_min_m[worst])
    proven = lacks_m <= 0.0
    return [
        Finding(
            "takeoff",
            sortie.name,
            proven,
            "the ground falls behind while it climbs"
            if proven
            else f"its climb lacks {lacks_m:.1f} m of height above the ground"
            if math.isfinite(lacks_m)
            else "the ground below its climb is not known",
            "" if proven else "take off in another direction or from elsewhere, or state a better climb.rate_m_s",
            float(height_min_m[worst]),
            float(need_m[worst]),
            seq=sortie.legs[0].seq,
            position_m=_position(pieces[worst, 0]),
        )
    ]


def _angles(flight: Flight) -> Finding:
    """Return whether no leg is steeper than the vehicle may climb and descend (eq. 7)."""
    limits, sortie = flight.task.limits, flight.sortie
    worst, seq, text = -math.inf, sortie.legs[0].seq, "no leg"
    for index, (before, leg) in enumerate(pairwise(sortie.legs), start=1):
        line = np.stack([before.end_m, leg.end_m])
        if leg.kind == "spline":
            line = spline_chords(sortie, index, _SPLINE_CHORD_M)
        for step in np.diff(line, axis=0):
            angle_rad = math.atan2(step[2], _least_across_m(math.hypot(step[0], step[1]), before, leg))
            most_rad = limits.climb_angle_rad if angle_rad > 0.0 else limits.descent_angle_rad
            if abs(angle_rad) - most_rad > worst and np.any(step != 0.0):
                worst, seq = abs(angle_rad) - most_rad, leg.seq
                what = "climbs" if angle_rad > 0.0 else "descends"
                text = f"{what} at {math.degrees(abs(angle_rad)):.1f} degrees, allowed {math.degrees(most_rad):.1f}"
    proven = worst <= _ANGLE_SLACK_RAD
    remedy = "" if proven else "put a waypoint between, or move the two apart"
    return Finding("angle", sortie.name, proven, f"its steepest leg {text}", remedy, unit="", seq=seq)


def _least_across_m(across_m: float, before: Leg, leg: Leg) -> float:
    """Return how short a leg may be on the map: it begins and ends anywhere on circles around its ends."""
    if before.radius_m > 0.0 and leg.radius_m > 0.0:
        return max(0.0, across_m - before.radius_m - leg.radius_m)
    return abs(across_m - before.radius_m - leg.radius_m)


def _turns(flight: Flight) -> Finding:
    """Return whether every corner can be flown with the turn radius, and turns no more than allowed (eqs 5 and 8).

    A corner is rounded by an arc tangent to both its legs that stays within what the tube allows for. A plane rounds it
    as its autopilot banks, whatever the mission says; its predicted flight shows how, and its tube is around that. The
    radius is told, and held to what the mission file states, if it does.
    """
    limits, sortie = flight.task.limits, flight.sortie
    corners_m = np.array([leg.end_m for leg in sortie.legs])
    stops = np.array([leg.hold_s > 0.0 for leg in sortie.legs])
    turns, radii_m = _corners(flight.task, corners_m, stops)
    sharp, tight = int(np.argmax(turns)), int(np.argmin(radii_m))
    sharpest, tightest = float(turns[sharp]), float(radii_m[tight])
    sharp_seq, tight_seq = sortie.legs[sharp].seq, sortie.legs[tight].seq
    if sharpest > limits.turn_angle_rad + _ANGLE_SLACK_RAD:
        return Finding(
            "turn",
            sortie.name,
            False,
            f"turns by {math.degrees(sharpest):.0f} degrees, allowed {math.degrees(limits.turn_angle_rad):.0f}",
            "put waypoints around the corner",
            unit="",
            seq=sharp_seq,
        )
    if tightest < limits.turn_radius_m * (1.0 - 1e-6):
        return Finding(
            "turn",
            sortie.name,
            False,
            f"turns with a radius of {tightest:.1f} m, expected at least {limits.turn_radius_m:g} m",
            "put waypoints around the corner",
            tightest,
            limits.turn_radius_m,
            seq=tight_seq,
        )
    flown_m = _tightest_flown_m(flight) if sortie.vehicle_class == "plane" else math.inf
    if flown_m < limits.flown_radius_min_m:
        return Finding(
            "turn",
            sortie.name,
            False,
            f"flies turns with a radius of {flown_m:.1f} m, expected at least {limits.flown_radius_min_m:g} m",
            "lower ROLL_LIMIT_DEG on the vehicle and in its parameters, put waypoints around the corner, or state a "
            "smaller turn_radius_m",
            flown_m,
            limits.flown_radius_min_m,
        )
    return Finding(
        "turn",
        sortie.name,
        True,
        f"turns by at most {math.degrees(sharpest):.0f} degrees" + _radius_told(flight, flown_m),
        unit="",
    )


def _radius_told(flight: Flight, flown_m: float) -> str:
    if flight.sortie.vehicle_class == "plane":
        return f", flown with a radius of at least {flown_m:.0f} m" if math.isfinite(flown_m) else ""
    allowed_m = flight.task.limits.turn_radius_m
    return f", with a radius of at least {allowed_m:g} m" if allowed_m > 0.0 else ""


def turns_allowed(task: VehicleTask, waypoints_m: FloatArray) -> bool:
    """Return whether the corners of waypoints (W, 3) are ones that the vehicle may fly (eqs 5 and 8)."""
    held_m = [task.route_m[point] for point, action in task.actions.items() if action.stand_s > 0.0]
    stops = np.array([any(np.linalg.norm(at_m - point_m) <= AT_STOP_M for at_m in held_m) for point_m in waypoints_m])
    turns, radii_m = _corners(task, waypoints_m, stops)
    limits = task.limits
    allowed = (turns <= limits.turn_angle_rad + _ANGLE_SLACK_RAD) & (radii_m >= limits.turn_radius_m * (1.0 - 1e-6))
    return bool(allowed.all())


def _corners(task: VehicleTask, waypoints_m: FloatArray, stops: npt.NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Return at each waypoint (W,) the turn, and the widest radius that stays within the tube (planes: inf)."""
    turns, radii_m = np.zeros(len(waypoints_m)), np.full(len(waypoints_m), math.inf)
    steps = np.diff(waypoints_m[:, :2], axis=0)
    for k, (into, out) in enumerate(pairwise(steps), start=1):
        if not (np.any(into) and np.any(out)):
            continue
        turns[k] = math.atan2(abs(into[0] * out[1] - into[1] * out[0]), float(into @ out))
        if task.motion.vehicle_class == "copter" and turns[k] > 1e-3 and not stops[k]:
            radii_m[k] = task.limits.deviation_m / (1.0 / max(math.cos(0.5 * turns[k]), 1e-9) - 1.0)
    return turns, radii_m


def _tightest_flown_m(flight: Flight) -> float:
    """Return the least radius, over a second, of a plane's predicted flight once it has taken off."""
    airborne = np.flatnonzero(flight.trajectory.t_s >= flight.reached_s[0])[:: round(1.0 / TICK_S)]
    place_m = flight.trajectory.position_m[airborne, :2]
    if not wind.calm(flight.task.motion):  # as the air sees it, which is what its bank is for
        place_m = place_m - flight.trajectory.t_s[airborne, np.newaxis] * flight.task.motion.wind_m_s
    step = np.diff(place_m, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    turn = np.arctan2(step[:-1, 0] * step[1:, 1] - step[:-1, 1] * step[1:, 0], (step[:-1] * step[1:]).sum(axis=1))
    turning = np.abs(turn) > 1e-6
    if not turning.any():
        return math.inf
    return float((0.5 * (length[:-1] + length[1:])[turning] / np.abs(turn[turning])).min())


def _speeds(flight: Flight) -> Finding:
    limits, sortie = flight.task.limits, flight.sortie
    for leg in sortie.legs[1:]:
        slow = leg.speed_m_s < limits.speed_min_m_s - _SPEED_SLACK_M_S
        if slow or leg.speed_m_s > limits.speed_max_m_s + _SPEED_SLACK_M_S:
            return Finding(
                "speed",
                sortie.name,
                False,
                f"is to be flown at {leg.speed_m_s:g} m/s, allowed {limits.speed_min_m_s:g} to "
                f"{limits.speed_max_m_s:g} m/s",
                "change the DO_CHANGE_SPEED before it, or speed_m_s in the mission file",
                leg.speed_m_s,
                limits.speed_min_m_s if slow else limits.speed_max_m_s,
                "m/s",
                seq=leg.seq,
            )
    return Finding("speed", sortie.name, True, "every leg's speed is within the vehicle's range", unit="m/s")


def _in_wind(scene: Scene, flight: Flight, tubes: Sequence[_Tube]) -> list[Finding]:
    """Return whether it holds its legs in the wind, drifts little before it leans in, and gets home against it."""
    task, sortie, motion = flight.task, flight.sortie, flight.task.motion
    findings = []
    if task.limits.wind_max_m_s > 0.0 and motion.vehicle_class == "copter":
        drift_m, allowed_m = wind.leaning_in_m(motion, task.limits.wind_max_m_s), task.limits.tracking_error_m
        detail = (
            f"drifts {drift_m:.2f} m after its lift-off in {task.limits.wind_max_m_s:g} m/s of wind, until it leans in"
        )
        remedy = "" if drift_m <= allowed_m else "fly in less wind, or state a greater tracking_error_m"
        findings.append(Finding("takeoff", sortie.name, not remedy, detail, remedy, drift_m, allowed_m))
    if motion.vehicle_class == "plane" and task.limits.wind_max_m_s > math.hypot(*motion.wind_m_s):
        findings.append(_in_strongest_wind(scene, flight))
    circles = not flight.timed and not sortie.gaps  # what is not understood is refused for that
    if wind.calm(motion):
        curved = any(leg.kind == "spline" for leg in sortie.legs)
        ask = curved or (motion.vehicle_class == "copter" and not _recorded(flight))
        if ask and circles:
            findings.append(_unpredicted(flight, " with its splines" if curved else " with its speed and parameters"))
        elif flight.timed and curved:
            findings.append(_near(flight, tubes, "", "fly slower: it does not slow down ahead of a spline's bend"))
        elif flight.timed and ask:
            remedy = "fly slower, or with parameters nearer to the defaults, with which autopilots keep to their legs"
            findings.append(_near(flight, tubes, " with its speed and parameters", remedy))
        return findings
    if motion.vehicle_class == "copter" and circles:
        findings.append(_unpredicted(flight, f" in {wind.told(motion)}"))
    if motion.vehicle_class == "copter":
        findings += _held(flight, tubes)
    waived = scene.mission.fleet.direct_return == "waived" and sortie.ending != "rtl"
    findings.append(_home_against_the_wind(flight, waived=waived))
    return findings


def _in_strongest_wind(scene: Scene, flight: Flight) -> Finding:
    """Return whether a plane stays in its tube in more wind than it is predicted in: the strongest, from all around."""
    name, limits = flight.sortie.name, flight.task.limits
    strongest_m_s, until_s = limits.wind_max_m_s, float(flight.trajectory.t_s[-1])
    tree = cKDTree(flight.trajectory.position_m)  # a metre apart
    allowed_m = limits.tube_m - limits.position_error_m
    worst_m, worst_deg = 0.0, 0.0
    for from_deg in np.arange(0.0, 360.0, 360.0 / _WIND_DIRECTIONS).tolist():
        from_rad = math.radians(from_deg)
        air_m_s = (-strongest_m_s * math.sin(from_rad), -strongest_m_s * math.cos(from_rad))
        try:
            flown, _ = _flown(scene, replace(flight.task.motion, wind_m_s=air_m_s), flight.sortie, until_s)
        except InfeasibleError:
            detail = f"cannot fly its mission in {strongest_m_s:g} m/s of wind from {from_deg:g} degrees (wind_max_m_s)"
            return Finding("speed", name, False, detail, "fly in less wind, or faster")
        off_m = float(tree.query(flown.position_m[::_WIND_TICKS])[0].max())
        if off_m > worst_m:
            worst_m, worst_deg = off_m, from_deg
    near = worst_m <= allowed_m
    detail = (
        f"is up to {worst_m:.1f} m off its predicted flight in {strongest_m_s:g} m/s of wind (wind_max_m_s) from "
        f"{worst_deg:g} degrees, allowed {allowed_m:g} m"
    )
    remedy = "" if near else "state the wind (wind), or a greater tracking_error_m, or allow for less (wind_max_m_s)"
    return Finding("speed", name, near, detail, remedy, worst_m, allowed_m)


def _unpredicted(flight: Flight, air: str) -> Finding:
    """Return that nobody knows of a flight with circles whether it stays near its legs, where that is to be asked."""
    circle = next(leg for leg in flight.sortie.legs if leg.kind == "circle")
    detail = f"whether it stays near its legs{air} is not known: how it flies its circle is not predicted"
    return Finding("speed", flight.sortie.name, False, detail, "replace the circle by waypoints", seq=circle.seq)


def _recorded(flight: Flight) -> bool:
    """Whether it flies with parameters and at speeds with which recorded flights kept within the deviation."""
    motion = flight.task.motion
    fastest_m_s = max(leg.speed_m_s for leg in flight.sortie.legs[1:] or flight.sortie.legs)
    return usual((motion.autopilot, motion.vehicle_class), motion) and fastest_m_s <= _RECORDED_M_S


def _held(flight: Flight, tubes: Sequence[_Tube]) -> list[Finding]:
    """Return whether a copter's predicted flight stays near its legs, and which it flies slower than commanded."""
    sortie, motion = flight.sortie, flight.task.motion
    remedy = "fly slower: who leans as far as it may has nothing left against the wind"
    findings = [_near(flight, tubes, f" in {wind.told(motion)}", remedy)]
    airspeed_m_s = wind.airspeed_limit_m_s(motion)
    slow = []
    for before, leg in pairwise(sortie.legs):
        made_m_s = float(wind.along_m_s(motion, airspeed_m_s, (leg.end_m - before.end_m)[:2]))
        if made_m_s < leg.speed_m_s:
            slow.append((made_m_s - leg.speed_m_s, made_m_s, leg))
    if slow:
        _, made_m_s, leg = min(slow, key=lambda row: row[0])
        detail = f"makes {made_m_s:.1f} of the {leg.speed_m_s:g} m/s commanded in {wind.told(motion)}; predicted so"
        findings.append(Finding("speed", sortie.name, True, detail, "", made_m_s, leg.speed_m_s, "m/s", seq=leg.seq))
    return findings


def _near(flight: Flight, tubes: Sequence[_Tube], air: str, remedy: str) -> Finding:
    """Return whether a copter's predicted flight stays as near its legs as their tubes allow for."""
    pieces = np.concatenate([tube.pieces for tube in tubes])
    wider_m = max(tube.wider_m for tube in tubes)
    off_m, allowed_m = wind.off_legs_m(flight.trajectory, pieces), flight.task.limits.deviation_m + wider_m
    near = off_m <= allowed_m
    detail = f"is predicted at most {off_m:.2f} m off its legs{air}, allowed {allowed_m:g} m"
    return Finding("speed", flight.sortie.name, near, detail, "" if near else remedy, off_m, allowed_m)


def _home_against_the_wind(flight: Flight, *, waived: bool) -> Finding:
    motion, limits = flight.task.motion, flight.task.limits
    plane = motion.vehicle_class == "plane"
    airspeed_m_s = motion.cruise_speed_m_s if plane else min(wind.airspeed_limit_m_s(motion), limits.airspeed_max_m_s)
    left_m_s = airspeed_m_s - limits.wind_max_m_s
    least_m_s = wind.LEAST_GROUND_M_S[motion.vehicle_class]
    flies = left_m_s >= least_m_s
    return Finding(
        "return",
        flight.sortie.name,
        flies,
        f"has {left_m_s:.1f} m/s left against the wind when it is to return, expected {least_m_s:g} m/s",
        "" if flies else "fly in less wind, or return faster (cruise_speed_m_s)",
        left_m_s,
        least_m_s,
        "m/s",
        waived=waived,
    )


def _landings(scene: Scene, flight: Flight) -> list[Finding]:
    """Return whether home, and the goal where it lands there, lie on ground that one can land on."""
    sortie = flight.sortie
    places: list[tuple[str, FloatArray, int | None]] = [("home", sortie.home_m, None)]
    if sortie.ending == "land":
        places.append(("its landing place", sortie.legs[-1].end_m, sortie.ending_seq))
    findings = []
    if sortie.ending == "land" and sortie.legs[-1].kind == "circle":
        detail, remedy = "lands anywhere on its circle", "put a waypoint above the landing place"
        findings.append(Finding("landing", sortie.name, False, detail, remedy, unit="", seq=sortie.ending_seq))
    for what, place, seq in places:
        slope = float(steepest(scene.terrain.arrays, place[0], place[1], flight.task.limits.tube_m))
        angle_deg, most_deg = math.degrees(math.atan(slope)), math.degrees(flight.task.limits.landing_slope_rad)
        proven = angle_deg <= most_deg
        findings.append(
            Finding(
                "landing",
                sortie.name,
                proven,
                f"{what}: the ground is not known"
                if not math.isfinite(slope)
                else f"{what} lies on ground of at most {angle_deg:.1f} degrees, allowed {most_deg:g}",
                "" if proven else "move it to level ground, or raise safety.landing_slope_max_deg",
                angle_deg if math.isfinite(slope) else None,
                most_deg,
                "degrees",
                seq=seq,
                position_m=_position(place),
            )
        )
    return findings


def _energy(scene: Scene, flight: Flight) -> list[Finding]:
    """Return whether the energy lasts, with reserve and wind, to the end of the mission; and home from everywhere."""
    sortie = flight.sortie
    settings = next(v for v in scene.mission.vehicles if v.name == sortie.name)
    model = energy.energy_model(settings, scene.mission.air_m_s)
    if model is None:
        detail = "neither endurance_s nor energy is given: whether its battery lasts is not known"
        return [Finding("energy", sortie.name, False, detail, "give one of them", unit="", waived=True)]
    if not flight.timed:
        return [Finding("energy", sortie.name, False, "its times are not known", "use straight legs only")]
    return energy.findings(
        model,
        sortie,
        flight.trajectory,
        flight.reached_s,
        scene.mission.wind_max_m_s or 0.0,
        return_waived=scene.mission.fleet.direct_return == "waived",
    )


def _verdicts(
    scene: Scene,
    flight: Flight,
    tubes: Sequence[_Tube],
    owner: FloatArray,
    table: TubeClearances,
    asked: FloatArray,
) -> list[LegVerdict]:
    limits = flight.task.limits
    verdicts = []
    for tube in (tube for tube in tubes if not tube.weaker):
        same = [
            k
            for k, t in enumerate(tubes)
            if t is tube or (t.weaker and (t.leg.seq, t.kind) == (tube.leg.seq, tube.kind))
        ]
        own = np.flatnonzero(np.isin(owner, same))
        near = own[int(np.argmin(table.obstacle_m[own]))]
        terrain_m = float(table.height_min_m[own].min()) if asked[own[0]] else None
        obstacle_m = float(table.obstacle_m[near])
        highest_m = float(table.height_max_m[own].max())
        top_m = max(float(tubes[k].pieces[:, :, 2].max()) + tubes[k].wider_m for k in same) + limits.tube_m
        fence_m = float(table.fence_m[own].min())
        proven = (
            (terrain_m is None or (terrain_m >= limits.terrain_margin_m and highest_m <= limits.height_agl_max_m))
            and obstacle_m >= limits.obstacle_margin_m
            and fence_m >= limits.obstacle_margin_m
            and top_m <= limits.alt_amsl_max_m
        )
        verdicts.append(
            LegVerdict(
                vehicle=flight.sortie.name,
                seq=tube.leg.seq,
                kind=tube.kind,
                start_m=_position(tube.pieces[0, 0]),
                end_m=_position(tube.pieces[-1, 1]),
                terrain_m=terrain_m,
                obstacle_m=obstacle_m if math.isfinite(obstacle_m) else None,
                obstacle=scene.obstacles.names[int(table.obstacle[near])] if math.isfinite(obstacle_m) else "",
                fence_m=fence_m,
                proven=proven,
            )
        )
    return verdicts


# --- the fleet ------------------------------------------------------------------------------------------------------


def required_apart_m(scene: Scene, one: VehicleTask, other: VehicleTask) -> float:
    """Return how far apart two predicted flights must be for the vehicles to keep the fleet's separation."""
    return scene.mission.fleet.separation_m + one.off_prediction_m + other.off_prediction_m


def _apart(scene: Scene, flights: Sequence[Flight]) -> Callable[[int, int], float]:
    return lambda i, j: required_apart_m(scene, flights[i].task, flights[j].task)


def _together(scene: Scene, flights: Sequence[Flight]) -> list[Finding]:
    """Return whether all keep apart at every instant (eq. 9), and how early or late any one of them may be."""
    if len(flights) < 2:
        return []
    untimed = [f.sortie.name for f in flights if not f.timed]
    if untimed:
        detail = f"the times of {', '.join(untimed)} are not known"
        return [Finding("separation", "", False, detail, "use straight legs only, or fly one vehicle at a time")]
    names = [f.sortie.name for f in flights]
    trajectories = [f.trajectory for f in flights]
    required = _apart(scene, flights)
    nearest = nearest_pair(names, trajectories, required)
    assert nearest is not None
    at = f"{nearest.distance_m:.1f} m apart at {nearest.t_s:.0f} s, expected {nearest.required_m:g} m"
    apart = Finding(
        "separation",
        nearest.what,
        nearest.ok,
        at,
        "" if nearest.ok else "start one later, or move their ways apart",
        nearest.distance_m,
        nearest.required_m,
        position_m=nearest.position_m,
        t_s=nearest.t_s,
    )
    need_s = scene.mission.fleet.lateness_s
    limit_s = max(need_s, LATENESS_LIMIT_S)
    slack = timing.least_slack(trajectories, required, limit_s)[0]
    late = Finding(
        "lateness",
        f"{names[slack.first]} - {names[slack.second]}",
        slack.slack_s >= need_s,
        # rounded down; further than the limit nobody has looked
        f"all keep apart while none is more than {math.floor(slack.slack_s * 10.0) / 10.0:.1f} s early or late"
        f"{', perhaps further' if slack.slack_s >= limit_s else ''}, expected {need_s:g} s",
        "" if slack.slack_s >= need_s else "start one later, or lower fleet.lateness_s",
        slack.slack_s,
        need_s,
        "s",
    )
    return [apart, late]


def _circling(scene: Scene, flights: Sequence[Flight]) -> list[Finding]:
    """Return whether planes that circle at their ends keep apart from all who stay there, wherever on their circles.

    Their predicted flights end some time; who circles on drifts around its circle as its speed has it.
    """
    stays = [(flight, *stay) for flight in flights if (stay := _stay(flight)) is not None]
    worst: tuple[float, str] | None = None
    for (one, one_m, one_wide_m), (two, two_m, two_wide_m) in combinations(stays, 2):
        if one_wide_m == two_wide_m == 0.0:
            continue
        across_m = max(0.0, math.dist(one_m[:2], two_m[:2]) - one_wide_m - two_wide_m)
        apart_m = math.hypot(across_m, one_m[2] - two_m[2])
        room_m = apart_m - required_apart_m(scene, one.task, two.task)
        if worst is None or room_m < worst[0]:
            told = f"{one.sortie.name} and {two.sortie.name} stay {apart_m:.0f} m apart at their ends, circling"
            worst = room_m, f"{told}, expected {apart_m - room_m:g} m"
    if worst is None:
        return []
    ok = worst[0] >= -1e-6
    return [Finding("separation", "", ok, worst[1], "" if ok else "move their ends apart, or end elsewhere")]


def _stay(flight: Flight) -> tuple[FloatArray, float] | None:
    """Return around where, and on which circle, a vehicle stays in the air at its end; None where it does not."""
    sortie, motion, limits = flight.sortie, flight.task.motion, flight.task.limits
    if motion.vehicle_class == "copter":
        return (sortie.legs[-1].end_m, 0.0) if sortie.ending == "loiter" else None
    middle_m = _circles_at_m(sortie)
    if middle_m is None or sortie.ending == "land":
        return None
    top_m = float(flight.trajectory.position_m[-1, 2])
    wind_m_s = max(limits.wind_max_m_s, math.hypot(*motion.wind_m_s))
    speed_m_s = max(motion.cruise_speed_m_s, *(leg.speed_m_s for leg in sortie.legs))
    wide_m = max(sortie.legs[-1].radius_m - motion.loiter_radius_m, 0.0) + motion.circle_m(speed_m_s, top_m, wind_m_s)
    return np.array([middle_m[0], middle_m[1], top_m]), wide_m


def returning(flight: Flight) -> Returning:
    """Return what of a flight its return is judged by: all of it, even if it only takes off and lands."""
    return Returning(
        name=flight.sortie.name,
        home_m=flight.sortie.home_m,
        limits=flight.task.limits,
        motion=replace(flight.task.motion, return_height_m=flight.sortie.return_height_m),
        trajectory=flight.trajectory,
        airborne_s=min(float(flight.reached_s[0]), math.nextafter(flight.descends_s, -math.inf)),
        descends_s=flight.descends_s,
        commanded_m_s=max(leg.speed_m_s for leg in flight.sortie.legs[1:] or flight.sortie.legs),
        circles_at_m=_circles_at_m(flight.sortie),
    )


def _circles_at_m(sortie: Sortie) -> FloatArray | None:
    """Return the middle of the circle that a plane flies at its end."""
    if sortie.vehicle_class != "plane":
        return None
    return sortie.legs[-1].end_m if sortie.ending == "loiter" else sortie.home_m


def _returns(scene: Scene, flights: Sequence[Flight]) -> list[Finding]:
    waived = scene.mission.fleet.direct_return == "waived"
    unknown = [f for f in flights if not f.timed]
    if unknown:
        return [
            Finding(
                "return",
                f.sortie.name,
                False,
                "its flight is not predicted, so its way home is not known",
                "use straight legs only",
                waived=waived,
            )
            for f in unknown
        ]
    return returns.prove_returns(
        scene.space,
        scene.terrain.bounds,
        scene.obstacles.names,
        [returning(f) for f in flights],
        _apart(scene, flights),
        waived=waived,
    )


def _arrival(scene: Scene, flights: Sequence[Flight], arrival_s: float | None) -> list[Finding]:
    """Return whether all arrive with the fleet (eq. 10)."""
    if arrival_s is None:
        return []
    asked_s = scene.mission.fleet.arrival_time_s
    if asked_s is not None and abs(arrival_s - asked_s) > ARRIVAL_ERROR_MAX_S:
        detail = f"the fleet arrives at {arrival_s:.1f} s, expected fleet.arrival_time_s {asked_s:g}"
        return [Finding("arrival", "", False, detail, "plan the mission again", arrival_s, asked_s, "s")]
    fleet = scene.mission.fleet
    due = {f.sortie.name: arrival_s + fleet.arrives_after_s(f.sortie.name) for f in flights}
    off = [(abs(float(f.reached_s[-1]) - due[f.sortie.name]), f) for f in flights]
    worst_s, worst = max(off, key=lambda pair: pair[0])
    in_order = f", {fleet.arrival_spacing_s:g} s one after the other" if fleet.arrival_spacing_s > 0.0 else ""
    if worst_s > ARRIVAL_ERROR_MAX_S:
        due_s = due[worst.sortie.name]
        detail = f"arrives at {worst.reached_s[-1]:.1f} s, expected with the fleet{in_order} at {due_s:.1f} s"
        return [Finding("arrival", worst.sortie.name, False, detail, "ask for another fleet.arrival_time_s", unit="s")]
    detail = f"all are predicted to arrive at {arrival_s:.1f} s{in_order}, within {worst_s:.2f} s"
    return [Finding("arrival", "", True, detail, value=worst_s, required=ARRIVAL_ERROR_MAX_S, unit="s")]


def _rendezvous(scene: Scene, flights: Sequence[Flight]) -> list[Finding]:
    """Return whether those who are to meet on the way are predicted to be there at one time."""
    by_name = {flight.sortie.name: flight for flight in flights}
    found = []
    for meeting in scene.mission.fleet.rendezvous:
        times: dict[str, float] = {}
        missed = ""
        for name, place in meeting.at.items():
            flight = by_name.get(name)
            if flight is None or not flight.task.places:  # of missions of other origin, the file gives no routes
                continue
            stops = passes(flight.task.route_m, np.array([leg.end_m for leg in flight.sortie.legs]), _MEETING_M)
            number = flight.task.places.get(place, len(stops))
            if flight.timed and number < len(stops):
                times[name] = float(flight.reached_s[stops[number]])
            else:
                missed = missed or name
        if missed:
            detail = f"{meeting.name}: no waypoint of {missed} is there, or its times are not known"
            found.append(Finding("rendezvous", missed, False, detail, "plan the mission again"))
        elif len(times) > 1:
            first, last = min(times, key=lambda n: times[n]), max(times, key=lambda n: times[n])
            spread_s = times[last] - times[first]
            ok = spread_s <= 2.0 * ARRIVAL_ERROR_MAX_S
            detail = f"{meeting.name}: all are predicted there at {times[first]:.1f} s, within {spread_s:.2f} s"
            if not ok:
                detail = f"{meeting.name}: {first} is there at {times[first]:.1f} s, {last} at {times[last]:.1f} s"
            remedy = "" if ok else "plan the mission again"
            found.append(Finding("rendezvous", "", ok, detail, remedy, spread_s, 2.0 * ARRIVAL_ERROR_MAX_S, unit="s"))
    return found


def _inspection(scene: Scene, flights: Sequence[Flight]) -> list[Finding]:
    if scene.towers is None:
        return []
    share = inspected_share(scene, [np.array([leg.end_m for leg in f.sortie.legs]) for f in flights])
    passed = f"the fleet passes {share:.0%} of the towers' weight within {scene.towers.range_m:g} m"
    if scene.mission.is_open:  # these missions may be of one round of several
        return [Finding("inspection", "", False, f"{passed}; not judged of an open mission", unit="", waived=True)]
    need = scene.towers.share_min
    return [
        Finding(
            "inspection",
            "",
            share >= need,
            f"{passed}, expected {need:.0%}",
            "" if share >= need else "let vehicles inspect the others, or lower inspection.share_min",
            share,
            need,
            "",
        )
    ]


def inspected_share(scene: Scene, lines_m: Sequence[FloatArray]) -> float:
    """Return the share of the towers' weight that polylines (N, 3) pass within range (PAPER.md eqs 6 and 15)."""
    towers = scene.towers
    if towers is None or not len(towers.weight):
        return 1.0
    weight = towers.weight if towers.weight.sum() > 0.0 else np.ones(len(towers.weight))
    legs = np.concatenate([polyline_legs(line) for line in lines_m])
    nearest_m = np.array([distance_to_legs_m(top, legs).min() for top in towers.top_m])
    inspected = nearest_m <= towers.range_m
    return float(weight[inspected].sum() / weight.sum())


def _assumptions(scene: Scene, flights: Sequence[Flight]) -> list[str]:
    """Return the figures that the proof rests on."""
    lines = []
    for flight in flights:
        limits, motion = flight.task.limits, flight.task.motion
        around = "its predicted flight" if motion.vehicle_class == "plane" else "its legs"
        lines.append(
            f"{flight.sortie.name} stays within {limits.tube_m:g} m of {around}: "
            f"{limits.tracking_error_m:g} m tracking, {limits.position_error_m:g} m position, "
            f"{limits.deviation_m:g} m corners cut and look-ahead of {motion.autopilot}"
        )
        if (motion.autopilot, motion.vehicle_class) == ("px4", "plane"):
            lines.append(f"{flight.sortie.name} flies as predicted: not measured, no PX4 plane was ever recorded")
    lines += [
        f"{f.sortie.name} climbs out at {f.task.motion.climb_rate_m_s:g} m/s at least, at its cruise airspeed of "
        f"{f.task.motion.cruise_speed_m_s:g} m/s; its times, energy and way home are those of a strong one"
        for f in flights
        if f.sortie.vehicle_class == "plane"
    ]
    lines += _starts_told(scene, flights)
    lines += [f"{flight.sortie.name}: {note}" for flight in flights for note in flight.sortie.notes]
    lines += [
        f"terrain: {scene.terrain.description}, bicubic, at most {_vertical_error_m(scene):g} m too low anywhere",
        "distances to terrain, obstacles and fence: what the whole tube keeps; between vehicles: of predicted flights",
        *_winds_told(scene),
        f"each vehicle is set to return at its height above home ({_heights_told(flights)}); upload and fly set it",
        "altitudes are mean sea level; a vehicle whose altitude is wrong is refused before it is armed",
    ]
    return lines


def _winds_told(scene: Scene) -> list[str]:
    """Return which wind is allowed for, and which flights are predicted in."""
    known, strongest_m_s = scene.mission.wind, scene.mission.wind_max_m_s
    lines = []
    if known is not None:
        lines.append(
            f"flights are predicted in a steady wind of {known.speed_m_s:g} m/s from {known.from_deg:g} degrees"
        )
    if known is None or strongest_m_s is not None:
        covered = ": energy, braking and ways home allow for it, times do not" if strongest_m_s else ""
        lines.append(f"wind of at most {strongest_m_s or 0.0:g} m/s{covered}")
    return lines


def _starts_told(scene: Scene, flights: Sequence[Flight]) -> list[str]:
    """Return when who is taken to start, and who not at all, where there are several vehicles."""
    lines = []
    if len(flights) > 1:
        told = ", ".join(f"{f.sortie.name} after {f.sortie.start_delay_s:g} s" for f in flights)
        lines.append(f"all missions are started together, and vehicles start: {told}")
    flying = {flight.sortie.name for flight in flights}
    absent = [task.name for task in scene.tasks if task.name not in flying]
    if absent:
        lines.append(f"not judged, and taken not to fly: {', '.join(absent)}")
    return lines


def _vertical_error_m(scene: Scene) -> float:
    ground = scene.mission.terrain
    return ground.vertical_error_m if ground.kind == "raster" else 0.0


def _heights_told(flights: Sequence[Flight]) -> str:
    return ", ".join(f"{f.sortie.name} {f.sortie.return_height_m:g} m" for f in flights)


def worst_conflict(scene: Scene, plan: FleetPlan) -> Conflict | None:
    """Return the pair that undercuts its separation the most (eq. 9), or would if one were as late as allowed."""
    trajectories = [vehicle.trajectory for vehicle in plan.vehicles]

    def required_m(i: int, j: int) -> float:
        return required_apart_m(scene, scene.tasks[i], scene.tasks[j])

    def conflict(pair: timing.Separation, late_s: float = 0.0) -> Conflict:
        names = (plan.vehicles[pair.first].name, plan.vehicles[pair.second].name)
        need_m = required_m(pair.first, pair.second)
        return Conflict(pair.first, pair.second, names, pair.distance_m, need_m, pair.t_s, late_s)

    nearest = timing.tightest_pair(trajectories, required_m)
    if nearest is None:
        return None
    if nearest.distance_m < required_m(nearest.first, nearest.second):
        return conflict(nearest)
    late_s = scene.mission.fleet.lateness_s
    if late_s > 0.0:
        least = timing.least_slack(trajectories, required_m, max(late_s, LATENESS_LIMIT_S))[0]
        if least.slack_s < late_s:
            (pair,) = timing.least_separation([trajectories[least.first], trajectories[least.second]])
            return conflict(replace(pair, first=least.first, second=least.second), late_s)
    return None


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two vehicles, by their place in the plan, that are predicted to come too close."""

    first: int
    second: int
    names: tuple[str, str]
    distance_m: float
    required_m: float
    t_s: float
    late_s: float = 0.0  # only if one of them is this much early or late

    def __str__(self) -> str:
        if self.late_s > 0.0:
            return (
                f"{self.names[0]} and {self.names[1]} come closer than {self.required_m:g} m, of separation and errors,"
                f" if one of them is {self.late_s:g} s early or late (fleet.lateness_s)"
            )
        return (
            f"{self.names[0]} and {self.names[1]} come within {self.distance_m:.1f} m of each other at "
            f"{self.t_s:.0f} s, closer than the {self.required_m:g} m of separation and errors"
        )


def _position(point: FloatArray) -> Position:
    return float(point[0]), float(point[1]), float(point[2])
