"""A plan on disk: ``plan.json`` and, where the terrain came from a file, the part of it that was used.

The folder holds all that checking and flying the plan needs, wherever it is taken. What ``plan.json`` says of flights
and clearances is for the reader: loading predicts and checks them again, so that an edited or damaged plan cannot
carry over a verdict that no longer holds. The format is described in docs/PLAN_FILE.md.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from missionplanner import planner, proof, wind
from missionplanner.autopilot_parameters import differences, held, shown
from missionplanner.certificate import Certificate
from missionplanner.errors import MissionError
from missionplanner.files import ensure_writable, write_atomic
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.mission import parse_mission
from missionplanner.path import length_m
from missionplanner.path_search import PlannedPath
from missionplanner.plan import (
    Action,
    Clearance,
    Correction,
    FleetFlight,
    FleetPlan,
    FlownMeeting,
    FlownVehicle,
    Lateness,
    Ordered,
    OrderResult,
    Resolution,
    Trajectory,
    VehiclePlan,
)
from missionplanner.scene import TERRAIN_NAME, Scene, VehicleTask, build_scene, portable_mission
from missionplanner.schedule import SPEED_STEP_M_S, Schedule
from missionplanner.terrain import write_raster
from missionplanner.waypoints import passes

PLAN_NAME = "plan.json"
FLIGHT_NAME = "flight.json"
CERTIFICATE_NAME = "certificate.json"
COVERAGE_NAME = "coverage.json"
OF_EARLIER = (
    *(FLIGHT_NAME, CERTIFICATE_NAME, COVERAGE_NAME, "coverage.png", "report.html", "report-*.html", "pictures/*.png"),
)
"""Of an earlier plan in a folder: would be taken for what is proven, flown and seen of a new one."""
INSPECTION_NAME = "inspection.json"
FORMAT = "missionplanner-plan"
FLIGHT_FORMAT = "missionplanner-flight"
CERTIFICATE_FORMAT = "missionplanner-certificate"
VERSION = 3
FLIGHT_VERSION = 1

Coordinate = Annotated[float, Field(ge=-2e5, le=2e5)]
"""Further from the origin, a number is a slip; and predicting a flight there would take days."""

Vector = tuple[Coordinate, Coordinate, Coordinate]


class Record(BaseModel):
    """What loading needs of a file that this program wrote; the rest is there for readers."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


class _WaypointRecord(Record):
    position_m: Vector
    speed_m_s: Annotated[float, Field(gt=0)] | None = None
    hold_s: Annotated[float, Field(ge=0, le=86_400)] = 0.0


class _VehicleRecord(Record):
    name: str
    path_m: tuple[Vector, ...] = Field(min_length=2)
    waypoints: tuple[_WaypointRecord, ...] = Field(min_length=2)
    start_delay_s: Annotated[float, Field(ge=0, le=86_400)]
    return_height_m: Annotated[float, Field(gt=0)]
    parameters: dict[str, float] = {}
    window_s: tuple[float, float]
    cost: float
    cost_terms: dict[str, float]
    history: tuple[float, ...]
    evaluations: int

    @model_validator(mode="after")
    def _a_speed_for_every_leg(self) -> _VehicleRecord:
        unknown = [k for k, waypoint in enumerate(self.waypoints[1:], start=1) if waypoint.speed_m_s is None]
        if unknown:
            raise ValueError(f"expected speed_m_s, of the leg to it, with waypoint {unknown[0]}, got none")
        return self

    @property
    def speeds_m_s(self) -> tuple[float, ...]:
        """Speed of the leg to each waypoint but the first."""
        return tuple(w.speed_m_s for w in self.waypoints[1:] if w.speed_m_s is not None)


class _ResolutionRecord(Record):
    vehicle: str
    other: str
    t_s: float
    how: Literal["speed", "start", "altitude", "way", "detour"]
    detail: str


class _LatenessRecord(Record):
    t_s: tuple[float, ...]
    lateness_s: tuple[float, ...]
    arrival_s: tuple[float, ...]

    @property
    def history(self) -> Lateness:
        """What was watched."""
        return Lateness(np.array(self.t_s), np.array(self.lateness_s), np.array(self.arrival_s))


class _FlownRecord(Record):
    name: str
    sysid: int
    arrival_s: float | None
    landed_s: float | None
    lateness: _LatenessRecord | None = None
    t_s: tuple[float, ...] = Field(min_length=1)
    position_m: tuple[Vector, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _a_place_for_every_time(self) -> _FlownRecord:
        if len(self.t_s) != len(self.position_m) or any(b < a for a, b in pairwise(self.t_s)):
            raise ValueError("expected times in order with a position each")
        return self


class _CorrectionRecord(Record):
    vehicle: str
    t_s: float
    from_m_s: float
    to_m_s: float
    why: str
    obeyed: bool


class _MeetingRecord(Record):
    name: str
    times_s: dict[str, float | None]


class _OrderedRecord(Record):
    vehicle: str
    order: Literal["pause", "resume", "rtl", "land"]
    t_s: float | None
    result: OrderResult
    words: str


class _FlightRecord(Record):
    format: Literal["missionplanner-flight"]
    version: Literal[1]
    unproven: bool = False
    simulated: bool = False
    vehicles: tuple[_FlownRecord, ...]
    corrections: tuple[_CorrectionRecord, ...] = ()
    meetings: tuple[_MeetingRecord, ...] = ()
    orders: tuple[_OrderedRecord, ...] = ()


class _FlownHow(Record):
    format: Literal["missionplanner-flight"]
    version: Literal[1]
    simulated: bool = False


class _CertificateRecord(Record):
    format: Literal["missionplanner-certificate"]
    version: Literal[1]
    proven: bool
    input_sha256: str
    mission_sha256: dict[str, str]


class _PlanRecord(Record):
    format: Literal["missionplanner-plan"]
    version: Literal[3]
    software_version: str
    seed: Annotated[int, Field(ge=0)]
    input_sha256: str
    mission: dict[str, Any]
    arrival_s: float | None
    resolutions: tuple[_ResolutionRecord, ...]
    vehicles: tuple[_VehicleRecord, ...]


def save_plan(folder: Path, scene: Scene, plan: FleetPlan) -> Path:
    """Write the plan and return the path of its ``plan.json``; the same plan gives the same bytes.

    What tells of an earlier plan in this folder is removed: flight, certificate, reports, what was seen.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    mission = portable_mission(scene)
    if mission.terrain.kind == "raster":
        write_raster(folder / TERRAIN_NAME, scene.terrain)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "software_version": plan.software_version,
        "seed": plan.seed,
        "input_sha256": plan.input_sha256,
        "arrival_s": plan.arrival_s,
        "resolutions": [asdict(resolution) for resolution in plan.resolutions],
        "separation": plan.separation and _clearance(plan.separation, plan.frame),
        "vehicles": [_vehicle(vehicle, plan.frame) for vehicle in plan.vehicles],
        "mission": mission.model_dump(mode="json", by_alias=True, exclude_unset=True),
    }
    ensure_writable(folder)
    remove(folder, OF_EARLIER)
    path = folder / PLAN_NAME
    write_atomic(path, json.dumps(document, indent=1, allow_nan=False) + "\n")
    return path


def is_inspection(folder: Path) -> bool:
    """Return whether a folder holds a whole inspection: rounds, each a plan folder of its own."""
    return (folder / INSPECTION_NAME).exists()


def remove(folder: Path, patterns: Sequence[str]) -> None:
    """Remove files of a folder that match."""
    for path in [path for pattern in patterns for path in folder.glob(pattern)]:
        path.unlink(missing_ok=True)


def planned_names(folder: Path) -> tuple[str, ...]:
    """Return the names of a plan folder's vehicles: at once, nothing is predicted or checked.

    Raises
    ------
    MissionError
        There is no plan, it is damaged, or of another version.
    """
    record = read_record(folder / PLAN_NAME, _PlanRecord, "plan the mission again")
    return tuple(vehicle.name for vehicle in record.vehicles)


def planned_targets(folder: Path) -> dict[str, frozenset[str]]:
    """Return what each vehicle of a plan folder is to look at, by its name: at once, nothing is predicted or checked.

    Raises
    ------
    MissionError
        There is no plan, it is damaged, or of another version.
    """
    path = folder / PLAN_NAME
    record = read_record(path, _PlanRecord, "plan the mission again")
    question = parse_mission(json.dumps(record.mission), f"{path}: mission")
    return {v.name: frozenset(stop.inspects for stop in v.stops if stop.inspects) for v in question.vehicles}


def load_plan(folder: Path) -> tuple[Scene, FleetPlan]:
    """Read a plan folder; flights are predicted and clearances checked again.

    Raises
    ------
    MissionError
        There is no plan, it is damaged, of another version, or does not fit its own mission or terrain.
    """
    path = folder / PLAN_NAME
    record = read_record(path, _PlanRecord, "plan the mission again")
    mission = parse_mission(json.dumps(record.mission), f"{path}: mission")
    scene = build_scene(mission, folder)
    if scene.input_sha256 != record.input_sha256:
        raise MissionError(
            f"{path}: expected the mission and terrain it was planned for (sha256 {record.input_sha256[:12]}...), got "
            f"others ({scene.input_sha256[:12]}...): plan the mission again"
        )
    names = [task.name for task in scene.tasks]
    if [vehicle.name for vehicle in record.vehicles] != names:
        raise MissionError(f"{path}: expected plans for {', '.join(names)}, got others: plan the mission again")
    for index, (task, vehicle) in enumerate(zip(scene.tasks, record.vehicles, strict=True)):
        problem = _misfit(task, vehicle, index * mission.fleet.launch_interval_s)
        if problem is not None:
            raise MissionError(f"{path}: {task.name}: expected {problem}: plan the mission again")
    if record.arrival_s is None and mission.fleet.arrive_together:
        raise MissionError(
            f"{path}: expected a common arrival (fleet.arrive_together), got none: plan the mission again"
        )
    paths = [_path(vehicle) for vehicle in record.vehicles]
    scene = planner.returning_at(scene, {v.name: v.return_height_m for v in record.vehicles})
    schedules = [
        Schedule(v.start_delay_s, v.speeds_m_s, tuple(w.hold_s for w in v.waypoints[1:]), v.window_s)
        for v in record.vehicles
    ]
    plan = planner.assemble(scene, paths, schedules, record.arrival_s, record.seed)
    resolutions = tuple(Resolution(**r.model_dump()) for r in record.resolutions)
    plan = replace(plan, software_version=record.software_version, resolutions=resolutions)
    return scene, proof.checked(scene, plan)


def save_flight(folder: Path, flight: FleetFlight, *, unproven: bool = False, simulated: bool = False) -> Path:
    """Write the recorded flight beside the plan and return its path.

    Parameters
    ----------
    unproven : it was flown without a proof
    simulated : no vehicle was in the air
    """
    document = {
        "format": FLIGHT_FORMAT,
        "version": FLIGHT_VERSION,
        "unproven": unproven,
        "simulated": simulated,
        "vehicles": [
            {
                "name": vehicle.name,
                "sysid": vehicle.sysid,
                "arrival_s": vehicle.arrival_s,
                "landed_s": vehicle.landed_s,
                "lateness": _lateness(vehicle.lateness),
                "t_s": np.round(vehicle.trajectory.t_s, 3).tolist(),
                "position_m": np.round(vehicle.trajectory.position_m, 3).tolist(),
            }
            for vehicle in flight.vehicles
        ],
        "corrections": [asdict(correction) for correction in flight.corrections],
        "meetings": [asdict(meeting) for meeting in flight.meetings],
        "orders": [asdict(ordered) for ordered in flight.orders],
    }
    path = folder / FLIGHT_NAME
    write_atomic(path, json.dumps(document, allow_nan=False) + "\n")
    return path


def _lateness(lateness: Lateness | None) -> dict[str, list[float]] | None:
    if lateness is None:
        return None
    return {name: np.round(getattr(lateness, name), 2).tolist() for name in ("t_s", "lateness_s", "arrival_s")}


def load_flight(folder: Path, plan: FleetPlan) -> FleetFlight | None:
    """Read the recorded flight of a plan; None if it was not flown.

    Raises
    ------
    MissionError
        The record is damaged or of another fleet.
    """
    path = folder / FLIGHT_NAME
    if not path.exists():
        return None
    record = read_record(path, _FlightRecord, "fly the plan again, or delete the file")
    if [v.name for v in record.vehicles] != [v.name for v in plan.vehicles]:
        raise MissionError(
            f"{path}: expected a flight of {', '.join(v.name for v in plan.vehicles)}, got another fleet"
        )
    return FleetFlight(
        tuple(
            FlownVehicle(
                v.name,
                v.sysid,
                Trajectory(np.array(v.t_s), np.array(v.position_m)),
                v.arrival_s,
                v.landed_s,
                plan.mission.fleet.arrives_after_s(v.name),
                None if v.lateness is None else v.lateness.history,
            )
            for v in record.vehicles
        ),
        tuple(Correction(**correction.model_dump()) for correction in record.corrections),
        tuple(FlownMeeting(meeting.name, meeting.times_s) for meeting in record.meetings),
        tuple(Ordered(**ordered.model_dump()) for ordered in record.orders),
    )


def was_simulated(folder: Path) -> bool:
    """Return whether the recorded flight of a plan, which is there, was a rehearsal: no vehicle was in the air.

    Raises
    ------
    MissionError
        The record is damaged.
    """
    return read_record(folder / FLIGHT_NAME, _FlownHow, "fly the plan again, or delete the file").simulated


def save_certificate(folder: Path, certificate: Certificate) -> Path:
    """Write a certificate beside its plan and return its path.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    document = {"format": CERTIFICATE_FORMAT, "version": FLIGHT_VERSION, **certificate.as_json()}
    path = folder / CERTIFICATE_NAME
    write_atomic(path, json.dumps(document, indent=1, allow_nan=False) + "\n")
    return path


def uncertified(folder: Path, fresh: Certificate) -> str | None:
    """Return why a plan folder's certificate does not cover the missions that were ``fresh``-ly proven; None: it does.

    A certificate file is never believed alone: the same missions must have been proven again.
    """
    path = folder / CERTIFICATE_NAME
    if not path.exists():
        return f"there is no {path}: check the plan"
    try:
        stored = read_record(path, _CertificateRecord, "check the plan again")
    except MissionError as error:
        return str(error)
    if stored.input_sha256 != fresh.input_sha256:
        return f"{path} is of another mission file or terrain: check the plan again"
    if stored.mission_sha256 != dict(fresh.mission_sha256):
        return f"{path} is of other missions than those that would be sent: check the plan again"
    if not (stored.proven and fresh.proven):
        return f"not proven: {fresh.refusal or f'{path} says so: check the plan again'}"
    return None


_AnyRecord = TypeVar("_AnyRecord", bound=Record)


def read_record(path: Path, kind: type[_AnyRecord], remedy: str) -> _AnyRecord:
    """Read what this program wrote.

    Raises
    ------
    MissionError
        It is not there, damaged, or of another version.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        if is_inspection(path.parent):
            raise MissionError(
                f"{path.parent}: expected one plan, got an inspection of several rounds: name one of them, "
                f"e.g. {path.parent / 'round-1'}"
            ) from None
        raise MissionError(f"{path}: expected a plan folder, got none there: plan a mission first") from None
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(f"{path}: could not be read: {error}: {remedy}") from error
    try:
        return kind.model_validate(json.loads(text))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(step) for step in first["loc"]) or "the whole file"
        problem = f"{where}: {first['msg'][0].lower()}{first['msg'][1:]}"
    except (ValueError, RecursionError) as error:
        problem = f"not JSON: {error}"
    (version,) = get_args(kind.model_fields["version"].annotation)
    raise MissionError(
        f"{path}: expected what this program wrote (version {version}), got a damaged file or another's "
        f"({problem}): {remedy}"
    )


def _misfit(task: VehicleTask, record: _VehicleRecord, delay_min_s: float) -> str | None:
    """Return what the mission expects of a vehicle and its record does not keep; None if it keeps all."""
    low, high = task.limits.speed_min_m_s, task.limits.speed_max_m_s
    for speed_m_s in record.speeds_m_s:
        if not low - SPEED_STEP_M_S <= speed_m_s <= high + SPEED_STEP_M_S:
            return f"a speed of {low:g} to {high:g} m/s, got {speed_m_s:g}"
    moves_otherwise = differences((task.motion.autopilot, task.motion.vehicle_class), task.motion, record.parameters)
    if moves_otherwise:
        assumed = moves_otherwise[0]
        return f"a plan made with {assumed.name} {shown(assumed.planned)}, got one made with {shown(assumed.held)}"
    if record.start_delay_s < delay_min_s:
        return f"a start {delay_min_s:g} s after mission start (fleet.launch_interval_s), got {record.start_delay_s:g}"
    waypoints_m = np.array([w.position_m for w in record.waypoints])
    last = len(task.route_m) - 1
    names = ["the top of the take-off", *(f"stop {k}" for k in range(1, last)), "the goal"]
    found = passes(task.route_m, waypoints_m)
    if found[:1] != [0]:
        missed: int | None = 0
    elif len(found) <= last:
        missed = len(found)
    else:
        missed = None if found[-1] == len(waypoints_m) - 1 else last
    if missed is not None:
        return f"waypoints from the top of the take-off through every stop to the goal, got none at {names[missed]}"
    least_s = planner.stands_s(task, waypoints_m)
    for k, (waypoint, stand_s) in enumerate(zip(record.waypoints[1:], least_s, strict=True), start=1):
        if waypoint.hold_s < stand_s:
            return f"waypoint {k} to be held for at least {stand_s:g} s, got {waypoint.hold_s:g}"
    problem = wind.storm_problem(task)
    for way_m, speed_m_s in zip(np.diff(waypoints_m, axis=0), record.speeds_m_s, strict=True):
        problem = problem or wind.leg_problem(task.limits, task.motion, way_m, speed_m_s)
    return problem and f"a wind that it can be flown in, got {problem}"


def _path(record: _VehicleRecord) -> PlannedPath:
    path_m = np.array(record.path_m)
    return PlannedPath(
        path_m=path_m,
        waypoints_m=np.array([w.position_m for w in record.waypoints]),
        length_m=float(length_m(path_m)),
        cost=record.cost,
        cost_terms=record.cost_terms,
        history=np.array(record.history),
        evaluations=record.evaluations,
    )


def _vehicle(vehicle: VehiclePlan, frame: LocalFrame) -> dict[str, Any]:
    waypoints: list[dict[str, Any]] = [
        {**_place(point, frame), "reached_s": round(float(t), 3), "position_m": point.tolist()}
        for point, t in zip(vehicle.waypoints_m, vehicle.reached_s, strict=True)
    ]
    for waypoint, speed_m_s, hold_s in zip(
        waypoints[1:], vehicle.speeds_m_s.tolist(), vehicle.hold_s.tolist(), strict=True
    ):
        waypoint |= {"speed_m_s": speed_m_s, "hold_s": hold_s}
    for k, action in vehicle.actions.items():
        waypoints[k] |= _action(action, frame)
    return {
        "name": vehicle.name,
        "sysid": vehicle.sysid,
        "autopilot": vehicle.autopilot,
        "class": vehicle.vehicle_class,
        "home": _place(vehicle.home_m, frame),
        "end": vehicle.end,
        "start_delay_s": vehicle.start_delay_s,
        "return_height_m": vehicle.motion.return_height_m,
        "parameters": held((vehicle.autopilot, vehicle.vehicle_class), vehicle.motion),
        "window_s": list(vehicle.window_s),
        "arrival_s": vehicle.arrival_s,
        "landed_s": float(vehicle.trajectory.t_s[-1]),
        "length_m": vehicle.length_m,
        "cost": vehicle.cost,
        "cost_terms": vehicle.cost_terms,
        "evaluations": vehicle.evaluations,
        "clearances": [_clearance(c, frame) for c in vehicle.clearances],
        "waypoints": waypoints,
        "path_m": vehicle.path_m.tolist(),
        "history": vehicle.history.tolist(),
    }


def _action(action: Action, frame: LocalFrame) -> dict[str, Any]:
    """Return what is done at a waypoint, for readers: loading takes it from the mission."""
    done: dict[str, Any] = {
        "name": action.name,
        "inspects": action.inspects,
        "look_at": None if action.look_at_m is None else _place(action.look_at_m, frame),
        "look": None
        if action.look_deg is None
        else dict(zip(("heading_deg", "pitch_deg"), action.look_deg, strict=True)),
        "photos": action.photos,
        "photo_every_m": action.photo_every_m,
    }
    return {field: value for field, value in done.items() if value}


def _place(position_m: FloatArray | Vector, frame: LocalFrame) -> dict[str, float]:
    point = frame.geo_point(position_m)
    return {
        "lat_deg": round(point.lat_deg, 9),
        "lon_deg": round(point.lon_deg, 9),
        "alt_amsl_m": round(point.alt_amsl_m, 4),
    }


def _clearance(clearance: Clearance, frame: LocalFrame) -> dict[str, Any]:
    return {
        "to": clearance.what,
        "distance_m": clearance.distance_m,
        "required_m": clearance.required_m,
        "ok": clearance.ok,
        "at": _place(clearance.position_m, frame),
        "t_s": clearance.t_s,
    }
