"""What a recorded flight kept clear of: distances to obstacles and fence exact, the ground sampled every 0.1 m.

A flight may use up its tracking and position errors, but not the safety distances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from missionplanner import kernels, timing
from missionplanner.clearance import Margins, polyline_legs
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.plan import Clearance, FleetFlight, FleetPlan, Trajectory
from missionplanner.scene import Scene

TERRAIN_STEP_M = 0.1
COLUMN_M = 2.5
"""Horizontal distance from the pad within which a path counts as a vertical take-off or landing.

PX4 begins to sink as soon as it is within the goal's radius, 2 m by default, and drifts to its middle meanwhile.
"""


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
        margins = Margins.of(replace(task.limits, tracking_error_m=0.0, position_error_m=0.0, deviation_m=0.0))
        drift_m = COLUMN_M + 2.0 * task.limits.tracking_error_m  # a real climb or descent is not plumb
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
    names = [vehicle.name for vehicle in plan.vehicles]
    return FlightCheck(tuple(found), nearest_pair(names, tracks, lambda _i, _j: scene.mission.fleet.separation_m))


def nearest_pair(
    names: Sequence[str], trajectories: Sequence[Trajectory], required_m: Callable[[int, int], float]
) -> Clearance | None:
    """Return the pair with the least separation relative to what it needs (eq. 9); None for a single vehicle."""
    pair = timing.tightest_pair(trajectories, required_m)
    if pair is None:
        return None
    return Clearance(
        distance_m=pair.distance_m,
        required_m=required_m(pair.first, pair.second),
        what=f"{names[pair.first]} - {names[pair.second]}",
        position_m=(float(pair.first_m[0]), float(pair.first_m[1]), float(pair.first_m[2])),
        t_s=pair.t_s,
    )


def airborne_part(trajectory: Trajectory, airborne_s: float, column_m: float = COLUMN_M) -> Trajectory:
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
