"""Where cameras look, as headings and pitches, for formats that cannot name a place to look at; and for how long."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.plan import Action, VehiclePlan

_ACROSS_LEAST_M = 0.1  # nearer to straight up or down, no heading is better than another


@dataclass(frozen=True, slots=True)
class Aim:
    """A way to look: heading clockwise from true north (None: none is better than another), pitch above the horizon."""

    heading_deg: float | None
    pitch_deg: float


def aim(action: Action, position_m: FloatArray, frame: LocalFrame) -> Aim | None:
    """Return how a camera at ``position_m`` looks at what an action asks for; None: it asks for nothing."""
    if action.look_deg is not None:
        return Aim(action.look_deg[0] % 360.0, action.look_deg[1])
    if action.look_at_m is None:
        return None
    across_m = _across_m(position_m, action.look_at_m)
    pitch_deg = math.degrees(math.atan2(action.look_at_m[2] - float(position_m[2]), across_m))
    heading_deg = frame.heading_deg(position_m, action.look_at_m) if across_m >= _ACROSS_LEAST_M else None
    return Aim(heading_deg, pitch_deg)


def headings_deg(vehicle: VehiclePlan, frame: LocalFrame) -> list[float]:
    """Return which way a vehicle faces at each waypoint (W,): what it looks at there, else along its next leg."""
    points = vehicle.waypoints_m
    courses: list[float | None] = []
    for begin_m, end_m in itertools.pairwise(points):
        across = _across_m(begin_m, end_m) >= _ACROSS_LEAST_M
        courses.append(frame.heading_deg(begin_m, end_m) if across else None)
    courses.append(None)
    faced: list[float] = []
    for k, course in enumerate(courses):
        asked = None if k not in vehicle.actions else aim(vehicle.actions[k], points[k], frame)
        heading = course if asked is None or asked.heading_deg is None else asked.heading_deg
        if heading is None:  # nothing says which: as before
            heading = faced[-1] if faced else next((c for c in courses if c is not None), 0.0)
        faced.append(heading)
    return faced


def hold_s(vehicle: VehiclePlan, waypoint: int) -> float:
    """Return how long a vehicle stands still at a waypoint before it takes photos there: its waits, too."""
    action = vehicle.actions.get(waypoint, Action())
    stands_s = float(vehicle.hold_s[waypoint - 1]) if waypoint > 0 else 0.0
    return action.hold_s + max(0.0, stands_s - action.stand_s)


def turn_deg(from_deg: float, to_deg: float) -> float:
    """Return the shorter turn between two headings, clockwise above 0: in [-180, 180)."""
    return (to_deg - from_deg + 180.0) % 360.0 - 180.0


def _across_m(from_m: FloatArray, to_m: FloatArray | tuple[float, float, float]) -> float:
    return math.hypot(float(to_m[0] - from_m[0]), float(to_m[1] - from_m[1]))
