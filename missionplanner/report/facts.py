"""What the report says, as numbers: computed from the plan and the flight, before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from missionplanner import proof
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Clearance, FleetFlight, FleetPlan, FlownVehicle, Trajectory, VehiclePlan
from missionplanner.scene import Scene, VehicleTask

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
class VehicleFacts:
    """One vehicle: its place in the fleet, plan, task and flight."""

    index: int
    plan: VehiclePlan
    task: VehicleTask
    flown: FlownFacts | None

    @property
    def name(self) -> str:
        """The vehicle's name."""
        return self.plan.name


@dataclass(frozen=True, slots=True, eq=False)
class Distances:
    """Distances (L, T) at times (T,): a line per pair, or per vehicle its nearest fellow."""

    t_s: FloatArray
    distance_m: FloatArray
    pairs: tuple[tuple[int, int], ...] | None  # None: line i is vehicle i's


@dataclass(frozen=True, slots=True, eq=False)
class Facts:
    """Everything that the pictures and tables show."""

    scene: Scene
    plan: FleetPlan
    flight: FleetFlight | None
    vehicles: tuple[VehicleFacts, ...]
    flown_separation: Clearance | None
    troubles: tuple[str, ...]  # why the plan or the flight is not all clear
    remarks: tuple[str, ...]  # what is worth knowing though everything was kept

    @property
    def flown(self) -> bool:
        """Whether a flight was recorded."""
        return self.flight is not None


def collect(scene: Scene, plan: FleetPlan, flight: FleetFlight | None) -> Facts:
    """Compare plan and flight with the scene."""
    check = proof.check_flight(scene, plan, flight) if flight else None
    vehicles = []
    for index, (vehicle, task) in enumerate(zip(plan.vehicles, scene.tasks, strict=True)):
        flown = None
        if flight is not None and check is not None:
            flown = _flown_facts(vehicle, task, flight.vehicles[index], check.clearances[index])
        vehicles.append(VehicleFacts(index, vehicle, task, flown))
    flown_separation = check.separation if check else None
    return Facts(
        scene=scene,
        plan=plan,
        flight=flight,
        vehicles=tuple(vehicles),
        flown_separation=flown_separation,
        troubles=(*proof.unsafe(scene, plan), *_flight_troubles(vehicles, flown_separation)),
        remarks=tuple(_remarks(plan, flight, vehicles)),
    )


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
        last = int(np.searchsorted(run, run[segment] + window_m)) + 1
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
        deviation_allowed_m=task.limits.tracking_error_m,
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


def _remarks(plan: FleetPlan, flight: FleetFlight | None, vehicles: Sequence[VehicleFacts]) -> Iterator[str]:
    for v in vehicles:
        if v.flown and v.flown.deviation_m > v.flown.deviation_allowed_m:
            yield (
                f"{v.name} was {v.flown.deviation_m:.1f} m off its predicted flight; its margins allow for "
                f"{v.flown.deviation_allowed_m:g} m of tracking error"
            )
    spread_s = flight.arrival_spread_s if flight else None
    if plan.arrival_s is not None and spread_s is not None and spread_s > _SPREAD_REMARKED_S:
        yield f"arrivals were spread over {spread_s:.1f} s, though the fleet was to arrive together"
