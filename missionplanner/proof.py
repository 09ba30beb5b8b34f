"""What is checked of a plan before it may be flown, and of a flight afterwards.

The legs that are uploaded and the curve that the autopilot is predicted to fly along them (corners cut) must both keep
every margin. Distances to obstacles and fence are lower bounds for the whole continuous path; heights above ground are
sampled every 0.1 m of the interpolated elevation model. Missing terrain counts as no clearance at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from missionplanner import kernels, timing
from missionplanner.clearance import Margins, distance_to_legs_m, legs_clear, legs_within_angles, polyline_legs
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.plan import Clearance, FleetFlight, FleetPlan, Trajectory, VehiclePlan
from missionplanner.scene import Scene, VehicleTask

TERRAIN_STEP_M = 0.1
_TICKS_PER_CHORD = 4
ARRIVAL_ERROR_MAX_S = 0.5
"""How far a predicted arrival may be from the common one."""

_ANGLE_SLACK_RAD = 1e-5
_COLUMN_M = 2.5
"""Horizontal distance from the pad within which a path counts as a vertical take-off or landing.

PX4 begins to sink as soon as it is within the goal's radius, 2 m by default, and drifts to its middle meanwhile.
"""


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two vehicles, by their place in the plan, that are predicted to come too close."""

    first: int
    second: int
    names: tuple[str, str]
    distance_m: float
    required_m: float
    t_s: float

    def __str__(self) -> str:
        return (
            f"{self.names[0]} and {self.names[1]} come within {self.distance_m:.1f} m of each other at "
            f"{self.t_s:.0f} s, closer than the {self.required_m:g} m of separation and tracking errors"
        )


def checked(scene: Scene, plan: FleetPlan) -> FleetPlan:
    """Return the plan with all least clearances and the least separation filled in."""
    vehicles = tuple(
        replace(vehicle, clearances=clearances(scene, task, vehicle))
        for task, vehicle in zip(scene.tasks, plan.vehicles, strict=True)
    )
    trajectories = [vehicle.trajectory for vehicle in plan.vehicles]
    nearest = _nearest_pair(scene, plan, trajectories, with_tracking_error=True)
    return replace(plan, vehicles=vehicles, separation=_separation(nearest, trajectories))


def unsafe(scene: Scene, plan: FleetPlan) -> list[str]:
    """Return why a checked plan must not be flown, one reason each; empty when every check holds."""
    reasons = [
        f"{vehicle.name}: {c.what} clearance is {c.distance_m:.2f} m at {_where(plan, c)}, expected {c.required_m:g} m"
        for vehicle in plan.vehicles
        for c in vehicle.clearances
        if not c.ok
    ]
    for task, vehicle in zip(scene.tasks, plan.vehicles, strict=True):
        airborne_s = float(vehicle.trajectory.t_s[-1]) - vehicle.start_delay_s
        if airborne_s > task.limits.endurance_s:
            reasons.append(
                f"{vehicle.name}: flies {airborne_s:.0f} s, longer than its endurance of "
                f"{task.limits.endurance_s:g} s: give it fewer stops, a higher speed or a later start"
            )
        steep = np.flatnonzero(~legs_within_angles(task.limits, polyline_legs(vehicle.waypoints_m), _ANGLE_SLACK_RAD))
        if steep.size:
            reasons.append(
                f"{vehicle.name}: the leg from waypoint {steep[0]} to {steep[0] + 1} is steeper than it may climb "
                f"({np.degrees(task.limits.climb_angle_rad):.0f} degrees) or descend "
                f"({np.degrees(task.limits.descent_angle_rad):.0f} degrees)"
            )
    reasons += _not_together(scene, plan)
    if scene.towers is not None:
        share = inspected_share(scene, [vehicle.waypoints_m for vehicle in plan.vehicles])
        if share < scene.towers.share_min:
            reasons.append(
                f"inspection: the fleet passes {share:.0%} of the towers' weight within {scene.towers.range_m:g} m, "
                f"expected {scene.towers.share_min:.0%}: let vehicles inspect the others, or lower inspection.share_min"
            )
    if plan.separation is not None and not plan.separation.ok:
        c = plan.separation
        reasons.append(f"{c.what}: {c.distance_m:.1f} m apart at {c.t_s:.0f} s, expected {c.required_m:g} m")
    return reasons


def _not_together(scene: Scene, plan: FleetPlan) -> list[str]:
    """Return who does not arrive with the fleet although the mission asks for it (eq. 10)."""
    fleet = scene.mission.fleet
    if not fleet.arrive_together:
        return []
    if plan.arrival_s is None:
        return ["the fleet has no common arrival, although the mission asks for one"]
    if fleet.arrival_time_s is not None and abs(plan.arrival_s - fleet.arrival_time_s) > ARRIVAL_ERROR_MAX_S:
        return [f"the fleet arrives at {plan.arrival_s:.1f} s, expected fleet.arrival_time_s {fleet.arrival_time_s:g}"]
    return [
        f"{vehicle.name}: arrives at {vehicle.arrival_s:.1f} s, expected with the fleet at {plan.arrival_s:.1f} s: ask "
        "for another fleet.arrival_time_s"
        for vehicle in plan.vehicles
        if abs(vehicle.arrival_s - plan.arrival_s) > ARRIVAL_ERROR_MAX_S
    ]


def inspected_share(scene: Scene, lines_m: Sequence[FloatArray]) -> float:
    """Return the share of the towers' weight that polylines (N, 3) pass within range (PAPER.md eqs 6 and 15)."""
    towers = scene.towers
    if towers is None or towers.weight.sum() == 0.0:
        return 1.0
    legs = np.concatenate([polyline_legs(line) for line in lines_m])
    nearest_m = np.array([distance_to_legs_m(top, legs).min() for top in towers.top_m])
    inspected = nearest_m <= towers.range_m
    return float(towers.weight[inspected].sum() / towers.weight.sum())


def worst_conflict(scene: Scene, plan: FleetPlan) -> Conflict | None:
    """Return the pair that undercuts its separation the most, if any does (PAPER.md eq. 9)."""
    nearest = _nearest_pair(scene, plan, [v.trajectory for v in plan.vehicles], with_tracking_error=True)
    return nearest if nearest is not None and nearest.distance_m < nearest.required_m else None


def _nearest_pair(
    scene: Scene, plan: FleetPlan, trajectories: list[Trajectory], *, with_tracking_error: bool
) -> Conflict | None:
    """Return the pair with the least separation relative to what it needs; None for a single vehicle."""
    pairs = []
    for pair in timing.least_separation(trajectories):
        required_m = scene.mission.fleet.separation_m
        if with_tracking_error:
            required_m += sum(scene.tasks[k].limits.tracking_error_m for k in (pair.first, pair.second))
        names = (plan.vehicles[pair.first].name, plan.vehicles[pair.second].name)
        pairs.append(Conflict(pair.first, pair.second, names, pair.distance_m, required_m, pair.t_s))
    return min(pairs, key=lambda c: c.distance_m - c.required_m, default=None)


def _separation(pair: Conflict | None, trajectories: list[Trajectory]) -> Clearance | None:
    if pair is None:
        return None
    x, y, z = trajectories[pair.first].at(pair.t_s)
    return Clearance(pair.distance_m, pair.required_m, " - ".join(pair.names), (float(x), float(y), float(z)), pair.t_s)


def _where(plan: FleetPlan, clearance: Clearance) -> str:
    point = plan.frame.geo_point(clearance.position_m)
    return f"{point.lat_deg:.6f}, {point.lon_deg:.6f}, {point.alt_amsl_m:.0f} m AMSL"


def clearances(scene: Scene, task: VehicleTask, plan: VehiclePlan) -> tuple[Clearance, ...]:
    """Return the least clearances of a vehicle's legs and predicted flight: terrain, ceiling, obstacles, fence."""
    space, names = scene.space, scene.obstacles.names
    margins = Margins.of(task.limits)
    airborne = airborne_part(plan.trajectory, float(plan.reached_s[0]))
    columns = _columns(plan, float(airborne.t_s[-1]))
    anywhere = replace(margins, height_agl_min_m=-np.inf, height_agl_max_m=np.inf, alt_amsl_max_m=np.inf)
    found = [
        *least_clearances(space, names, margins, polyline_legs(plan.waypoints_m)),
        *least_clearances(space, names, margins, curve_legs(airborne)),
        *least_clearances(space, names, anywhere, columns),
    ]
    return worst_of_each(found)


@dataclass(frozen=True, slots=True, eq=False)
class FlightCheck:
    """What a recorded flight kept clear of: per vehicle, and between any two."""

    clearances: tuple[tuple[Clearance, ...], ...]
    separation: Clearance | None

    @property
    def ok(self) -> bool:
        """Whether every clearance was kept."""
        every = [c for vehicle in self.clearances for c in vehicle]
        return all(c.ok for c in (every if self.separation is None else [*every, self.separation]))


def check_flight(scene: Scene, plan: FleetPlan, flight: FleetFlight) -> FlightCheck:
    """Return the least clearances of flown tracks, which may use up the tracking error but not the margins."""
    found: list[tuple[Clearance, ...]] = []
    for task, vehicle, flown in zip(scene.tasks, plan.vehicles, flight.vehicles, strict=True):
        margins = Margins.of(replace(task.limits, tracking_error_m=0.0))
        drift_m = _COLUMN_M + 2.0 * task.limits.tracking_error_m  # a real climb or descent is not plumb
        position, top = flown.trajectory.position_m, vehicle.waypoints_m[0]
        high = position[:, 2] >= top[2] - task.limits.tracking_error_m
        column_m = np.hypot(*(top - vehicle.home_m)[:2]) + drift_m
        away = np.hypot(*(position - vehicle.home_m)[:, :2].T) > column_m  # however low: that is what is looked for
        up = np.flatnonzero(high | away)
        if up.size == 0:  # it never left its pad
            found.append(())
            continue
        track = airborne_part(flown.trajectory, float(flown.trajectory.t_s[up[0]]), drift_m)
        legs = polyline_legs(track.position_m)
        found.append(worst_of_each(least_clearances(scene.space, scene.obstacles.names, margins, legs)))
    tracks = [vehicle.trajectory for vehicle in flight.vehicles]
    nearest = _nearest_pair(scene, plan, tracks, with_tracking_error=False)
    return FlightCheck(tuple(found), _separation(nearest, tracks))


def curve_legs(predicted: Trajectory) -> FloatArray:
    """Return a predicted flight as legs (N, 2, 3) of 0.2 s: chords of its ticks, at most 2 cm off at 4 m/s^2."""
    position = predicted.position_m
    return polyline_legs(np.concatenate([position[:-1:_TICKS_PER_CHORD], position[-1:]]))


def airborne_part(trajectory: Trajectory, airborne_s: float, column_m: float = _COLUMN_M) -> Trajectory:
    """Return the part between the top of the take-off and the descent at the end, within ``column_m`` of its pad."""
    position = trajectory.position_m
    away = np.hypot(*(position[:, :2] - position[-1, :2]).T) > column_m
    last = int(np.flatnonzero(away)[-1]) + 1 if away.any() else 0
    first = int(np.searchsorted(trajectory.t_s, airborne_s))
    last = max(last, first + 1)
    return Trajectory(trajectory.t_s[first : last + 1], position[first : last + 1])


def least_clearances(
    space: SpaceArrays, names: tuple[str, ...], margins: Margins, legs: FloatArray, step_m: float = TERRAIN_STEP_M
) -> list[Clearance]:
    """Return the least clearance of legs (N, 2, 3) to the ground, the ceiling, the nearest obstacle and the fence."""
    table = kernels.legs_clearance(space, np.ascontiguousarray(legs), step_m)

    def place(leg: int, at: float) -> tuple[float, float, float]:
        x, y, z = legs[leg, 0] + at * (legs[leg, 1] - legs[leg, 0])
        return float(x), float(y), float(z)

    low = int(np.argmin(table[:, kernels.HEIGHT_MIN]))
    found = [
        Clearance(
            distance_m=float(table[low, kernels.HEIGHT_MIN]),
            required_m=margins.height_agl_min_m,
            what="terrain",
            position_m=place(low, table[low, kernels.HEIGHT_MIN_AT]),
        )
    ]
    found += _ceiling(table, margins, legs)
    if np.isfinite(table[:, kernels.OBSTACLE]).any():
        near = int(np.argmin(table[:, kernels.OBSTACLE]))
        found.append(
            Clearance(
                distance_m=float(table[near, kernels.OBSTACLE]),
                required_m=margins.obstacle_m,
                what=names[int(table[near, kernels.OBSTACLE_INDEX])],
                position_m=place(near, table[near, kernels.OBSTACLE_AT]),
            )
        )
    edge = int(np.argmin(table[:, kernels.FENCE]))
    found.append(
        Clearance(
            distance_m=float(table[edge, kernels.FENCE]),
            required_m=margins.fence_m,
            what="fence",
            position_m=place(edge, table[edge, kernels.FENCE_AT]),
        )
    )
    return found


def all_clear(space: SpaceArrays, margins: Margins, legs: FloatArray) -> bool:
    """Return whether all legs (N, 2, 3) keep every margin."""
    return bool(legs_clear(space, margins, legs, TERRAIN_STEP_M).all())


def worst_of_each(found: list[Clearance]) -> tuple[Clearance, ...]:
    """Return the tightest of each kind: terrain, ceiling, fence, and one for all obstacles together."""
    tightest: dict[str, Clearance] = {}
    for clearance in found:
        kind = clearance.what if clearance.what in {"terrain", "ceiling", "fence"} else "obstacle"
        known = tightest.get(kind)
        if known is None or clearance.distance_m - clearance.required_m < known.distance_m - known.required_m:
            tightest[kind] = clearance
    return tuple(tightest[kind] for kind in ("terrain", "obstacle", "ceiling", "fence") if kind in tightest)


def _ceiling(table: FloatArray, margins: Margins, legs: FloatArray) -> list[Clearance]:
    """Return the least room below the ceilings, where there are any."""
    rooms = []
    if np.isfinite(margins.height_agl_max_m):
        high = int(np.argmax(table[:, kernels.HEIGHT_MAX]))
        at = legs[high, 0] + table[high, kernels.HEIGHT_MAX_AT] * (legs[high, 1] - legs[high, 0])
        rooms.append((margins.height_agl_max_m - float(table[high, kernels.HEIGHT_MAX]), at))
    if np.isfinite(margins.alt_amsl_max_m):
        top = np.unravel_index(int(np.argmax(legs[..., 2])), legs.shape[:2])
        rooms.append((margins.alt_amsl_max_m - float(legs[top][2]), legs[top]))
    return [Clearance(room, 0.0, "ceiling", (float(at[0]), float(at[1]), float(at[2]))) for room, at in rooms]


def _columns(plan: VehiclePlan, sinks_s: float) -> FloatArray:
    """Return the take-off, straight and as flown, and the flight from ``sinks_s`` on to the ground, as legs."""
    climb = plan.trajectory.position_m[plan.trajectory.t_s <= plan.reached_s[0]]
    take_off = np.concatenate([np.stack([plan.home_m, plan.waypoints_m[0]])[np.newaxis], polyline_legs(climb)])
    after = plan.trajectory.position_m[plan.trajectory.t_s >= sinks_s]
    if len(after) < 2:
        return take_off
    return np.concatenate([take_off, polyline_legs(after)])
