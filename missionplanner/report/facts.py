"""What the report says, as numbers: computed from the plan and the flight, before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from missionplanner import proof
from missionplanner.certificate import Certificate, Finding
from missionplanner.flight_check import check_flight
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Clearance, FleetFlight, FleetPlan, FlownVehicle, Trajectory, VehiclePlan
from missionplanner.report.verdicts import LegFacts, judged, leg_facts, waived_together
from missionplanner.scene import Scene, VehicleTask
from missionplanner.sortie import Sortie

_PAIRS_DRAWN = 6
_TIME_STEPS = 1600
_SPREAD_REMARKED_S = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class FlownFacts:
    """One vehicle's flight beside its plan. En route is from the top of the take-off to the goal."""

    record: FlownVehicle
    en_route: Trajectory
    clearances: tuple[Clearance, ...]
    deviation_m: float  # greatest distance en route from the predicted flight
    deviation_allowed_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What is drawn of one vehicle, whoever planned it: its place in the fleet, its way, what is proven of it."""

    index: int
    name: str
    task: VehicleTask
    home_m: FloatArray  # (3,)
    path_m: FloatArray  # (S, 3), from the top of the take-off to the last waypoint
    waypoints_m: FloatArray  # (W, 3)
    legs: tuple[LegFacts, ...]  # empty where nothing is proven
    clearances: tuple[Clearance, ...]
    flown: FlownFacts | None

    @property
    def way_m(self) -> FloatArray:
        """What is flown of the mission's legs (N, 3), as it was proven; where nothing was, the path."""
        lines = [leg.line_m for leg in self.legs if leg.kind != "takeoff" and not leg.ends]
        return np.concatenate(lines) if lines else self.path_m


@dataclass(frozen=True, slots=True, eq=False)
class VehicleFacts(Course):
    """One vehicle of a plan."""

    plan: VehiclePlan


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances (L, T) at times (T,): a line per pair, or per vehicle its nearest fellow."""

    t_s: FloatArray
    distance_m: FloatArray
    pairs: tuple[tuple[int, int], ...] | None  # None: line i is vehicle i's


@dataclass(frozen=True, slots=True, eq=False)
class Sketch:
    """Everything that maps and height profiles show."""

    scene: Scene
    vehicles: Sequence[Course]
    findings: tuple[Finding, ...]

    @property
    def flown(self) -> bool:
        """Whether a flight was recorded."""
        return any(v.flown for v in self.vehicles)


@dataclass(frozen=True, slots=True, eq=False)
class Facts(Sketch):
    """Everything that the pictures and tables of a plan show."""

    vehicles: Sequence[VehicleFacts]
    plan: FleetPlan
    flight: FleetFlight | None
    flown_separation: Clearance | None
    troubles: tuple[str, ...]  # why the plan or the flight is not all clear
    remarks: tuple[str, ...]  # what is worth knowing though everything was kept


def collect(scene: Scene, plan: FleetPlan, flight: FleetFlight | None) -> Facts:
    """Compare plan and flight with the scene."""
    check = check_flight(scene, plan, flight) if flight else None
    certificate = plan.certificate
    findings = judged(certificate, [vehicle.name for vehicle in plan.vehicles], scene.input_sha256)
    vehicles = []
    for index, (vehicle, task) in enumerate(zip(plan.vehicles, scene.tasks, strict=True)):
        flown: FlownFacts | None = None
        legs: tuple[LegFacts, ...] = ()
        if flight is not None and check is not None:
            flown = _flown_facts(vehicle, task, flight.vehicles[index], check.clearances[index])
        if certificate is not None:
            sortie = proof.planned_sortie(scene, vehicle)
            legs = leg_facts(task, certificate.legs, findings, sortie, vehicle.trajectory, vehicle.reached_s)
        vehicles.append(
            VehicleFacts(
                index=index,
                name=vehicle.name,
                task=task,
                home_m=vehicle.home_m,
                path_m=vehicle.path_m,
                waypoints_m=vehicle.waypoints_m,
                legs=legs,
                clearances=vehicle.clearances,
                flown=flown,
                plan=vehicle,
            )
        )
    flown_separation = check.separation if check else None
    open_ = (str(finding) for finding in findings if not finding.holds)
    return Facts(
        scene=scene,
        vehicles=tuple(vehicles),
        findings=findings,
        plan=plan,
        flight=flight,
        flown_separation=flown_separation,
        troubles=(*open_, *_flight_troubles(vehicles, flown_separation)),
        remarks=tuple(_remarks(plan, flight, vehicles, findings)),
    )


def sketch_of(scene: Scene, certificate: Certificate, sorties: Sequence[Sortie]) -> Sketch:
    """Return what is drawn of missions that were checked, whoever planned them."""
    findings = judged(certificate, [sortie.name for sortie in sorties], scene.input_sha256)
    courses = []
    for index, flight in enumerate(proof.predict(scene, sorties)):
        sortie, task = flight.sortie, flight.task
        legs = leg_facts(task, certificate.legs, findings, sortie, flight.trajectory, flight.reached_s)
        way = [leg.line_m for leg in legs if leg.kind != "takeoff" and not leg.ends]
        courses.append(
            Course(
                index=index,
                name=sortie.name,
                task=task,
                home_m=sortie.home_m,
                path_m=np.concatenate(way or [np.stack([sortie.home_m, sortie.legs[0].end_m])]),
                waypoints_m=np.array([leg.end_m for leg in sortie.legs]),
                legs=legs,
                clearances=proof.clearances(certificate, sortie.name),
                flown=None,
            )
        )
    return Sketch(scene, tuple(courses), findings)


def along_m(positions_m: FloatArray) -> FloatArray:
    """Return the horizontal distance (S,) run at every one of positions (S, 3)."""
    legs = np.hypot(*np.diff(positions_m[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(legs)])


def along_path_m(path_m: FloatArray, positions_m: FloatArray, window_m: float = 150.0) -> FloatArray:
    """Return how far along the path (horizontally) each of positions (N, 3), flown in order, is nearest to it.

    The search goes forward from the place of the one before, so that a path that crosses itself is followed in order.
    """
    run = along_m(path_m)
    begins, steps = path_m[:-1], np.diff(path_m, axis=0)
    squares = np.maximum((steps**2).sum(axis=1), 1e-12)
    out = np.empty(len(positions_m))
    segment = 0
    for i, position in enumerate(positions_m):
        reached_m = out[i - 1] if i > 0 else 0.0
        last = int(np.searchsorted(run, reached_m + window_m)) + 1
        window = slice(segment, min(max(last, segment + 2), len(steps)))
        away = position - begins[window]
        share = np.clip((away * steps[window]).sum(axis=1) / squares[window], 0.0, 1.0)
        miss = ((away - share[:, None] * steps[window]) ** 2).sum(axis=1)
        best = int(np.argmin(miss))
        segment = min(segment + best, len(steps) - 1)
        out[i] = run[segment] + share[best] * (run[segment + 1] - run[segment])
    return out


def distances(trajectories: Sequence[Trajectory], instants_s: Sequence[float] = ()) -> Distances:
    """Return the distances between at least two vehicles over time; ``instants_s`` are sampled exactly."""
    end_s = max(float(t.t_s[-1]) for t in trajectories)
    t_s = np.union1d(np.linspace(0.0, end_s, _TIME_STEPS), np.asarray(instants_s, dtype=float))
    positions = [t.at(t_s) for t in trajectories]
    count = len(positions)
    if count * (count - 1) // 2 <= _PAIRS_DRAWN:
        pairs = tuple((i, j) for i in range(count) for j in range(i + 1, count))
        lines = [np.linalg.norm(positions[i] - positions[j], axis=-1) for i, j in pairs]
        return Distances(t_s, np.array(lines), pairs)
    nearest = np.full((count, t_s.size), np.inf)
    for i in range(count):
        for j in range(i + 1, count):
            distance = np.linalg.norm(positions[i] - positions[j], axis=-1)
            np.minimum(nearest[i], distance, out=nearest[i])
            np.minimum(nearest[j], distance, out=nearest[j])
    return Distances(t_s, nearest, None)


def _flown_facts(plan: VehiclePlan, task: VehicleTask, record: FlownVehicle, kept: tuple[Clearance, ...]) -> FlownFacts:
    en_route = _en_route(plan, record)
    return FlownFacts(
        record=record,
        en_route=en_route,
        clearances=kept,
        deviation_m=float(_distance_to_track(en_route.position_m, plan.trajectory.position_m).max()),
        deviation_allowed_m=task.off_prediction_m,
    )


def _en_route(plan: VehiclePlan, record: FlownVehicle) -> Trajectory:
    """Cut take-off and landing off: from where the track first comes close to the first waypoint, to the arrival."""
    t_s, position = record.trajectory.t_s, record.trajectory.position_m
    miss = np.linalg.norm(position - plan.waypoints_m[0], axis=-1)
    near = np.flatnonzero(miss <= max(2.0, float(miss.min())))
    first = int(near[0])
    last = len(t_s) if record.arrival_s is None else int(np.searchsorted(t_s, record.arrival_s, side="right"))
    keep = slice(first, max(last, first + 1))
    return Trajectory(t_s[keep], position[keep])


def _distance_to_track(positions_m: FloatArray, track_m: FloatArray) -> FloatArray:
    """Return the distance (N,) of positions (N, 3) to a densely sampled track (S, 3), between its samples too."""
    _, nearest = cKDTree(track_m).query(positions_m)
    least = np.full(len(positions_m), np.inf)
    for first in (nearest - 1, nearest):
        begin = track_m[np.clip(first, 0, len(track_m) - 1)]
        step = track_m[np.clip(first + 1, 0, len(track_m) - 1)] - begin
        away = positions_m - begin
        share = np.clip((away * step).sum(axis=1) / np.maximum((step**2).sum(axis=1), 1e-12), 0.0, 1.0)
        np.minimum(least, np.linalg.norm(away - share[:, None] * step, axis=-1), out=least)
    return least


def _flight_troubles(vehicles: Sequence[VehicleFacts], separation: Clearance | None) -> Iterator[str]:
    for v in vehicles:
        if v.flown is None:
            continue
        for c in v.flown.clearances:
            if not c.ok:
                thing = {"terrain": "above ground", "ceiling": "below the ceiling"}.get(c.what, f"from {c.what}")
                yield f"{v.name} flew {c.distance_m:.1f} m {thing}, {c.required_m:g} m is required"
        if v.flown.record.arrival_s is None:
            yield f"{v.name} never arrived at its goal"
    if separation is not None and not separation.ok:
        yield (
            f"{separation.what} flew {separation.distance_m:.1f} m from each other at {separation.t_s:.0f} s, "
            f"{separation.required_m:g} m is required"
        )


def _remarks(
    plan: FleetPlan, flight: FleetFlight | None, vehicles: Sequence[VehicleFacts], findings: Sequence[Finding]
) -> Iterator[str]:
    for waived, who in waived_together(findings):
        yield f"waived by the mission, of {who}: {waived.detail}"
    for v in vehicles:
        if v.flown and v.flown.deviation_m > v.flown.deviation_allowed_m:
            yield (
                f"{v.name} was {v.flown.deviation_m:.1f} m off its predicted flight; its proof allows for "
                f"{v.flown.deviation_allowed_m:g} m"
            )
    spread_s = flight.arrival_spread_s if flight else None
    if plan.arrival_s is not None and spread_s is not None and spread_s > _SPREAD_REMARKED_S:
        yield f"arrivals were spread over {spread_s:.1f} s, though the fleet was to arrive together"
