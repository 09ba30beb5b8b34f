"""A recorded flight against its plan: how far beside, ahead or behind, and how late; per vehicle and for the fleet.

Each recorded position is taken to the place of the *planned flight* that it belongs to. Paths cross themselves, double
back and stand still, so "the nearest place" alone will not do: of all ways to go along the plan without ever going
back, that with the least sum of squared distances is taken (as map matching does), and where the plan stands still, the
time nearest the flown one.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from missionplanner.files import write_atomic, write_csv
from missionplanner.flight_check import nearest_pair
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Clearance, FleetPlan, FlownVehicle, Trajectory, VehiclePlan

_GRID_S = 0.25
_GRID_MAX = 4000  # places on the plan, and flown positions, that are weighed against each other
_STAND_M_S = 0.05  # a second off the plan's time weighs as much as these metres: it decides where the plan stands still
_TANGENT_S = 0.5
_TIMED_M_S = 0.5  # where the plan is slower, a metre off the path is seconds off the time: errors there tell nothing
_CHUNK = 2_000_000

HowReached = Literal["reported", "passed"]


@dataclass(frozen=True, slots=True)
class WaypointTime:
    """When a waypoint was to be reached and was: as the vehicle reported, or as it passed by; None: never."""

    index: int  # into the plan's waypoints; 0 is the top of the take-off
    planned_s: float
    flown_s: float | None
    how: HowReached | None

    @property
    def error_s(self) -> float | None:
        """How late it was; negative: early."""
        return None if self.flown_s is None else self.flown_s - self.planned_s


@dataclass(frozen=True, slots=True, eq=False)
class VehicleReplay:
    """One vehicle's flight beside its plan. Times count from the fleet's mission start."""

    plan: VehiclePlan
    flown: FlownVehicle
    t_s: FloatArray  # (S,) of its recorded positions
    planned_s: FloatArray  # (S,) when the plan has it at that place
    along_m: FloatArray  # (S,) how far that is along the planned flight
    cross_track_m: FloatArray  # (S,) horizontal distance from there, right of it positive
    above_m: FloatArray  # (S,)
    along_error_m: FloatArray  # (S,) how far ahead of where the plan has it at that time; negative: behind
    position_error_m: FloatArray  # (S,) distance from where the plan has it at that time
    timed: npt.NDArray[np.bool_]  # (S,) whether the plan moves there, so that the place tells the time
    waypoints: tuple[WaypointTime, ...]

    @property
    def time_error_s(self) -> FloatArray:
        """How late (S,) it was at its places; negative: early."""
        return self.t_s - self.planned_s

    @property
    def off_path_m(self) -> FloatArray:
        """Distance (S,) from the planned flight's path."""
        return np.hypot(self.cross_track_m, self.above_m)

    @property
    def arrival_error_s(self) -> float | None:
        """How late it arrived; None: it never did."""
        return None if self.flown.arrival_s is None else self.flown.arrival_s - self.plan.arrival_s

    @property
    def en_route(self) -> npt.NDArray[np.bool_]:
        """Which positions (S,) come before its arrival; what it does at its end is another matter."""
        end_s = math.inf if self.flown.arrival_s is None else self.flown.arrival_s
        kept = self.t_s <= end_s
        return kept if kept.any() else np.ones(len(self.t_s), dtype=bool)

    def as_json(self) -> dict[str, Any]:
        """Return its figures as plain JSON values; of the errors along the way, those before its arrival."""
        en_route = self.en_route
        timed = en_route & self.timed if (en_route & self.timed).any() else en_route
        return {
            "name": self.plan.name,
            "sysid": self.plan.sysid,
            "positions": len(self.t_s),
            "planned_arrival_s": round(self.plan.arrival_s, 3),
            "arrival_s": _rounded(self.flown.arrival_s),
            "arrival_error_s": _rounded(self.arrival_error_s),
            "landed_s": _rounded(self.flown.landed_s),
            "cross_track_m": _spread(self.cross_track_m[en_route]),
            "above_m": _spread(self.above_m[en_route]),
            "off_path_m": _spread(self.off_path_m[en_route]),
            "along_track_m": _spread(self.along_error_m[en_route]),
            "time_error_s": _spread(self.time_error_s[timed]),
            "position_error_m": _spread(self.position_error_m[en_route]),
            "waypoints": [
                {
                    "index": w.index,
                    "planned_s": round(w.planned_s, 3),
                    "flown_s": _rounded(w.flown_s),
                    "error_s": _rounded(w.error_s),
                    "how": w.how,
                }
                for w in self.waypoints
            ],
        }


@dataclass(frozen=True, slots=True, eq=False)
class FleetReplay:
    """Those vehicles of a plan whose flight was recorded."""

    vehicles: tuple[VehicleReplay, ...]
    planned_spread_s: float
    arrival_spread_s: float | None  # None: somebody never arrived
    separation: Clearance | None  # least flown; None for a single vehicle

    def as_json(self) -> dict[str, Any]:
        """Return the figures as plain JSON values."""
        near = self.separation
        return {
            "vehicles": [vehicle.as_json() for vehicle in self.vehicles],
            "fleet": {
                "planned_arrival_spread_s": round(self.planned_spread_s, 3),
                "arrival_spread_s": _rounded(self.arrival_spread_s),
                "separation": None
                if near is None
                else {
                    "distance_m": round(near.distance_m, 3),
                    "required_m": near.required_m,
                    "between": near.what,
                    "t_s": _rounded(near.t_s),
                    "ok": near.ok,
                },
            },
        }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _spread(values: FloatArray) -> dict[str, float]:
    """Return how far values spread: least, greatest, 95th percentile and greatest of their amounts."""
    amounts = np.abs(values)
    figures = {"least": values.min(), "most": values.max(), "p95": np.percentile(amounts, 95), "worst": amounts.max()}
    return {name: round(float(value), 3) for name, value in figures.items()}


def replay(
    plan: FleetPlan, flown: Mapping[str, FlownVehicle], reached_s: Mapping[str, Mapping[int, float]]
) -> FleetReplay:
    """Hold recorded flights against their plan.

    Parameters
    ----------
    flown : by vehicle's name, with at least one position each
    reached_s : by vehicle's name, when it reported the waypoints (by index) as reached
    """
    vehicles = [v for v in plan.vehicles if v.name in flown]
    rows = tuple(replay_vehicle(v, flown[v.name], reached_s.get(v.name, {})) for v in vehicles)
    arrivals = [row.flown.arrival_s for row in rows]
    known = [a for a in arrivals if a is not None]
    planned = [v.arrival_s for v in vehicles]
    return FleetReplay(
        vehicles=rows,
        planned_spread_s=max(planned) - min(planned),
        arrival_spread_s=max(known) - min(known) if len(known) == len(arrivals) else None,
        separation=nearest_pair(
            [v.name for v in vehicles],
            [row.flown.trajectory for row in rows],
            lambda _i, _j: plan.mission.fleet.separation_m,
        ),
    )


def replay_vehicle(plan: VehiclePlan, flown: FlownVehicle, reached_s: Mapping[int, float]) -> VehicleReplay:
    """Hold one vehicle's recorded flight against its plan; see :func:`replay`."""
    planned, track = plan.trajectory, _until_its_end(plan, flown)
    t_s, position_m = track.t_s, track.position_m
    planned_s = match(planned, track)
    off_m = position_m - planned.at(planned_s)
    ahead_m = planned.at(planned_s + _TANGENT_S) - planned.at(planned_s - _TANGENT_S)
    side = ahead_m[:, 1] * off_m[:, 0] - ahead_m[:, 0] * off_m[:, 1]
    along = _along_m(planned)
    at_m, due_m = np.interp(planned_s, planned.t_s, along), np.interp(t_s, planned.t_s, along)
    return VehicleReplay(
        plan=plan,
        flown=flown,
        t_s=t_s,
        planned_s=planned_s,
        along_m=at_m,
        cross_track_m=np.where(side < 0.0, -1.0, 1.0) * np.hypot(off_m[:, 0], off_m[:, 1]),
        above_m=off_m[:, 2],
        along_error_m=at_m - due_m,
        position_error_m=np.linalg.norm(position_m - planned.at(t_s), axis=1),
        timed=np.linalg.norm(ahead_m, axis=1) >= 2.0 * _TANGENT_S * _TIMED_M_S,
        waypoints=_waypoint_times(plan, t_s, planned_s, reached_s),
    )


def _until_its_end(plan: VehiclePlan, flown: FlownVehicle) -> Trajectory:
    """Return a track as far as there is a plan for it: who stays in the air at its end may do so for hours."""
    track = flown.trajectory
    if flown.arrival_s is None or flown.landed_s is not None or plan.end == "land":
        return track
    last_s = max(flown.arrival_s, float(plan.trajectory.t_s[-1])) if plan.end == "rtl" else flown.arrival_s
    count = max(int(np.searchsorted(track.t_s, last_s, side="right")), 2)
    return Trajectory(track.t_s[:count], track.position_m[:count])


def _along_m(track: Trajectory) -> FloatArray:
    steps = np.linalg.norm(np.diff(track.position_m, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _waypoint_times(
    plan: VehiclePlan, t_s: FloatArray, planned_s: FloatArray, reached_s: Mapping[int, float]
) -> tuple[WaypointTime, ...]:
    found = []
    for index, due_s in enumerate(map(float, plan.reached_s)):
        if index in reached_s:
            found.append(WaypointTime(index, due_s, reached_s[index], "reported"))
            continue
        past = np.flatnonzero(planned_s >= due_s)
        if not past.size:
            found.append(WaypointTime(index, due_s, None, None))
            continue
        k = int(past[0])
        if k == 0:
            at_s = float(t_s[0])
        else:
            share = (due_s - planned_s[k - 1]) / max(planned_s[k] - planned_s[k - 1], 1e-9)
            at_s = float(t_s[k - 1] + share * (t_s[k] - t_s[k - 1]))
        found.append(WaypointTime(index, due_s, at_s, "passed"))
    return tuple(found)


def match(planned: Trajectory, flown: Trajectory) -> FloatArray:
    """Return when (S,) the planned flight is at the places that the flown positions belong to."""
    begin_s, end_s = float(planned.t_s[0]), float(planned.t_s[-1])
    steps = min(max(int(np.ceil((end_s - begin_s) / _GRID_S)), 1), _GRID_MAX)
    grid_s = np.linspace(begin_s, end_s, steps + 1)
    grid_m = planned.at(grid_s)
    count = len(flown.t_s)
    asked = np.unique(np.linspace(0, count - 1, min(count, _GRID_MAX)).round().astype(np.intp))
    places = _forward(grid_s, grid_m, flown.t_s[asked], flown.position_m[asked])
    near = np.interp(np.arange(count), asked, places)
    return _refined(grid_s, grid_m, flown, near.round().astype(np.intp))


def _forward(grid_s: FloatArray, grid_m: FloatArray, t_s: FloatArray, position_m: FloatArray) -> npt.NDArray[np.intp]:
    """Return the indices (S,), never falling, of the grid's places with the least sum of squared distances."""
    here = np.arange(len(grid_s))
    came_from = np.empty((len(t_s), len(grid_s)), dtype=np.int16)
    price = np.zeros(len(grid_s))
    for k, (at_s, at_m) in enumerate(zip(t_s, position_m, strict=True)):
        best = np.minimum.accumulate(price)
        came_from[k] = np.maximum.accumulate(np.where(price <= best, here, 0))
        off = grid_m - at_m
        price = best + np.einsum("ij,ij->i", off, off) + (_STAND_M_S * (grid_s - at_s)) ** 2
    places = np.empty(len(t_s), dtype=np.intp)
    place = int(np.argmin(price))
    for k in range(len(t_s) - 1, -1, -1):
        places[k] = place
        place = int(came_from[k, place])
    return places


def _refined(grid_s: FloatArray, grid_m: FloatArray, flown: Trajectory, near: npt.NDArray[np.intp]) -> FloatArray:
    """Return the times (S,) of the places nearest to the flown positions on the grid's segments around ``near``."""
    best_s = np.empty(len(near))
    least = np.full(len(near), np.inf)
    for shift in (-1, 0):
        first = np.clip(near + shift, 0, len(grid_s) - 2)
        leg_m, leg_s = grid_m[first + 1] - grid_m[first], grid_s[first + 1] - grid_s[first]
        rate = (_STAND_M_S * leg_s) ** 2  # where it stands still, time alone decides
        ahead = np.einsum("ij,ij->i", flown.position_m - grid_m[first], leg_m)
        ahead += _STAND_M_S**2 * leg_s * (flown.t_s - grid_s[first])
        share = np.clip(ahead / (np.einsum("ij,ij->i", leg_m, leg_m) + rate), 0.0, 1.0)
        off_m = flown.position_m - grid_m[first] - share[:, None] * leg_m
        at_s = grid_s[first] + share * leg_s
        price = np.einsum("ij,ij->i", off_m, off_m) + (_STAND_M_S * (at_s - flown.t_s)) ** 2
        closer = price < least
        best_s[closer], least[closer] = at_s[closer], price[closer]
    return best_s


def path_distance_m(position_m: FloatArray, path_m: FloatArray) -> FloatArray:
    """Return the distances (S,) of positions (S, 3) from a polyline (P, 3)."""
    begins, legs = path_m[:-1], np.diff(path_m, axis=0)
    squared = np.maximum(np.einsum("ij,ij->i", legs, legs), 1e-12)
    rows = max(1, _CHUNK // len(legs))
    found = []
    for k in range(0, len(position_m), rows):
        off = position_m[k : k + rows, None, :] - begins
        share = np.clip(np.einsum("sij,ij->si", off, legs) / squared, 0.0, 1.0)
        off -= share[..., None] * legs
        found.append(np.sqrt(np.einsum("sij,sij->si", off, off).min(axis=1)))
    return np.concatenate(found) if found else np.empty(0)


def save_replay(folder: Path, fleet: FleetReplay, document: Mapping[str, Any]) -> dict[str, Path]:
    """Write every position's errors and every waypoint's times as CSV, the figures as JSON; return the paths.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    paths = {"errors": folder / "errors.csv", "waypoints": folder / "waypoints.csv", "figures": folder / "replay.json"}
    columns = ("planned_s", "along_m", "cross_track_m", "above_m", "along_track_m", "time_error_s", "position_error_m")
    write_csv(
        paths["errors"],
        ("vehicle", "t_s", *columns),
        [(v.plan.name, *row) for v in fleet.vehicles for row in np.round(_columns(v), 3).tolist()],
    )
    write_csv(
        paths["waypoints"],
        ("vehicle", "waypoint", "planned_s", "flown_s", "time_error_s", "how"),
        [
            (v.plan.name, w.index, round(w.planned_s, 3), _rounded(w.flown_s), _rounded(w.error_s), w.how)
            for v in fleet.vehicles
            for w in v.waypoints
        ],
    )
    write_atomic(paths["figures"], json.dumps(document, indent=1, allow_nan=False) + "\n")
    return paths


def _columns(v: VehicleReplay) -> FloatArray:
    errors = (v.along_error_m, v.time_error_s, v.position_error_m)
    return np.stack([v.t_s, v.planned_s, v.along_m, v.cross_track_m, v.above_m, *errors], axis=-1)
