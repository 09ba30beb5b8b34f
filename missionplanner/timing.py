"""When vehicles arrive: predicted flights, arrival windows, a common arrival and its speeds; how far apart they stay.

All times come from the motion model (:mod:`.motion`), never from length over speed: real vehicles accelerate, slow down
in corners and look only one leg ahead (PAPER.md eq. 10 with a motion model).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numba import njit

from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.motion import Navigator, Route, landing_points, return_points, takeoff_points
from missionplanner.plan import Trajectory
from missionplanner.vehicle import Ending, MotionModel

SPEED_STEP_M_S = 1e-4
"""Commanded speeds are whole multiples of this."""

ARRIVAL_TOLERANCE_S = 0.05
"""How close to the time asked for a solved speed brings the predicted arrival."""

_HOVER_S = 5.0


def predict_flight(
    model: MotionModel,
    home_m: npt.ArrayLike,
    waypoints_m: npt.ArrayLike,
    speed_m_s: float,
    *,
    end: Ending = "loiter",
    ground_amsl_m: float = 0.0,
    start_delay_s: float = 0.0,
    until_s: float = 0.0,
) -> tuple[Trajectory, FloatArray]:
    """Return the whole flight and the times (W,) at which ``waypoints_m`` (W, 3) are reached, both with the delay.

    From rest at ``home_m`` (3,) up to the first waypoint, along the legs at one speed, then the end. Arrival is the
    last waypoint's time. A vehicle that stays in the air at its end is followed until it has settled there (a plane:
    has circled twice), and at least until ``until_s``.

    Parameters
    ----------
    ground_amsl_m : the ground under the last waypoint, for ``end="land"``
    start_delay_s : time at home before the start
    until_s : time up to which the flight is of interest; one that has landed stays where it is anyway
    """
    home = np.asarray(home_m, dtype=float)
    waypoints = np.asarray(waypoints_m, dtype=float).reshape(-1, 3)
    navigator = Navigator([model], home[None])
    parts, reached_s = _outbound(navigator, model, home, waypoints, speed_m_s)
    match end:
        case "land":
            way = landing_points(model, waypoints[-1], ground_amsl_m, speed_m_s)
        case "rtl":
            way = return_points(model, navigator.position_m[0], home)
        case "loiter":
            way = Route.through(waypoints[-1:], speed_m_s)
    parts.append(navigator.fly(way)[0])
    if end == "loiter" or (end == "rtl" and model.vehicle_class == "plane"):
        flown_s = start_delay_s + sum(float(part.t_s[-1]) for part in parts)
        parts.append(navigator.linger(max(_settling_s(model, float(way.speed_m_s[-1])), until_s - flown_s)))
    t_s = [np.zeros(1)] if start_delay_s > 0.0 else []
    position_m = [home[None]] if start_delay_s > 0.0 else []
    begin_s = start_delay_s
    for k, part in enumerate(parts):
        first = 0 if k == 0 else 1  # a part begins where the last one ended
        t_s.append(begin_s + part.t_s[first:])
        position_m.append(part.position_m[first:])
        begin_s += float(part.t_s[-1])
    return Trajectory(np.concatenate(t_s), np.concatenate(position_m)), reached_s + start_delay_s


def _settling_s(model: MotionModel, speed_m_s: float) -> float:
    """Return how long a vehicle is followed that stays at its end."""
    return _HOVER_S if model.vehicle_class == "copter" else 2.0 * (2.0 * math.pi * model.loiter_radius_m / speed_m_s)


def _outbound(
    navigator: Navigator, model: MotionModel, home: FloatArray, waypoints: FloatArray, speed_m_s: float
) -> tuple[list[Trajectory], FloatArray]:
    """Fly take-off and legs; return their trajectories and when the waypoints were reached, without delay."""
    takeoff, times = navigator.fly(takeoff_points(model, home, waypoints[0]))
    parts = [takeoff]
    reached_s = times[-1:]
    if len(waypoints) > 1:
        legs, times = navigator.fly(Route.through(waypoints[1:], speed_m_s))
        parts.append(legs)
        reached_s = np.concatenate([reached_s, float(takeoff.t_s[-1]) + times])
    return parts, reached_s


def arrival_after(model: MotionModel, home_m: npt.ArrayLike, waypoints_m: npt.ArrayLike, speed_m_s: float) -> float:
    """Return how long after its start a vehicle reaches its last waypoint."""
    home = np.asarray(home_m, dtype=float)
    waypoints = np.asarray(waypoints_m, dtype=float).reshape(-1, 3)
    return float(_outbound(Navigator([model], home[None]), model, home, waypoints, speed_m_s)[1][-1])


def arrival_window(
    model: MotionModel, home_m: npt.ArrayLike, waypoints_m: npt.ArrayLike, speed_min_m_s: float, speed_max_m_s: float
) -> tuple[float, float]:
    """Return the earliest and latest arrival after the start (PAPER.md eq. 10, from the motion model).

    The latest is at the least speed. Where short legs cap the speed, a higher speed gains nothing and the window is
    narrower than length over speed would have it.
    """
    slowest = arrival_after(model, home_m, waypoints_m, speed_min_m_s)
    return min(arrival_after(model, home_m, waypoints_m, speed_max_m_s), slowest), slowest


def common_arrival(
    window_s: Mapping[str, tuple[float, float]],
    delay_s: Mapping[str, float] | None = None,
    requested_s: float | None = None,
) -> float:
    """Return the time since mission start at which all can arrive: the earliest, or the one requested.

    Parameters
    ----------
    window_s : per vehicle, earliest and latest arrival after its own start
    delay_s : per vehicle, its start after mission start; 0 where missing

    Raises
    ------
    InfeasibleError
        The windows do not meet, or not at the time requested: says who is too slow, who too fast, and what helps.
    """
    delay = delay_s or {}
    earliest = {name: fast + delay.get(name, 0.0) for name, (fast, _) in window_s.items()}
    latest = {name: slow + delay.get(name, 0.0) for name, (_, slow) in window_s.items()}
    slow = max(earliest, key=lambda name: earliest[name])
    fast = min(latest, key=lambda name: latest[name])
    if earliest[slow] > latest[fast]:
        raise InfeasibleError(
            f"no common arrival: {slow} needs at least {earliest[slow]:.1f} s but {fast} cannot take longer than "
            f"{latest[fast]:.1f} s: start {fast} {earliest[slow] - latest[fast]:.1f} s later, lower its least speed, "
            f"lengthen its path, or raise {slow}'s greatest speed"
        )
    if requested_s is None:
        return earliest[slow]
    if requested_s < earliest[slow]:
        raise InfeasibleError(
            f"fleet.arrival_time_s: {requested_s:g} s is too early: {slow} needs at least {earliest[slow]:.1f} s; "
            f"ask for {math.ceil(earliest[slow] * 10) / 10:.1f} to {latest[fast]:.1f} s"
        )
    if requested_s > latest[fast]:
        raise InfeasibleError(
            f"fleet.arrival_time_s: {requested_s:g} s is too late: {fast} takes at most {latest[fast]:.1f} s; "
            f"ask for {earliest[slow]:.1f} to {math.floor(latest[fast] * 10) / 10:.1f} s or lower its least speed"
        )
    return requested_s


def speed_for_arrival(
    model: MotionModel,
    home_m: npt.ArrayLike,
    waypoints_m: npt.ArrayLike,
    arrival_s: float,
    speed_min_m_s: float,
    speed_max_m_s: float,
) -> float:
    """Return the speed, a multiple of :data:`SPEED_STEP_M_S`, at which the last waypoint is reached at ``arrival_s``.

    ``arrival_s`` counts from the vehicle's own start. Of all speeds tried, the one closest in time: within
    :data:`ARRIVAL_TOLERANCE_S` inside the arrival window (bisection on the motion model; where the navigator's corners
    make a jump, the neighbourhood is searched).
    """

    def lateness(steps: int) -> float:
        return arrival_after(model, home_m, waypoints_m, steps * SPEED_STEP_M_S) - arrival_s

    low = math.ceil(speed_min_m_s / SPEED_STEP_M_S - 1e-6)
    high = max(low, math.floor(speed_max_m_s / SPEED_STEP_M_S + 1e-6))
    tried = {low: lateness(low), high: lateness(high)}
    if tried[low] > 0.0 > tried[high]:
        _bisect(lateness, low, high, tried)
        if min(map(abs, tried.values())) > ARRIVAL_TOLERANCE_S:  # a jump: perhaps the time is also met elsewhere
            grid = np.unique(np.linspace(low, high, 65).astype(int)).tolist()
            tried.update({steps: lateness(steps) for steps in grid})
            for a, b in pairwise(grid):
                if tried[a] > 0.0 > tried[b] or tried[a] < 0.0 < tried[b]:
                    _bisect(lateness, a, b, tried)
    best = min(tried, key=lambda steps: (abs(tried[steps]), steps))
    return round(best * SPEED_STEP_M_S, 4)


def _bisect(lateness: Callable[[int], float], low: int, high: int, tried: dict[int, float]) -> None:
    """Halve a bracket until a time is met well within the tolerance or no speed is left between its ends."""
    sign = math.copysign(1.0, tried[low])
    while high - low > 1:
        # the secant of time over pace, which is nearly straight, kept away from the ends
        share = min(0.95, max(0.05, tried[low] / (tried[low] - tried[high])))
        middle = round(1.0 / ((1.0 - share) / low + share / high))
        middle = min(high - 1, max(low + 1, middle))
        tried[middle] = lateness(middle)
        if abs(tried[middle]) < 0.1 * ARRIVAL_TOLERANCE_S:
            return
        if sign * tried[middle] > 0.0:
            low = middle
        else:
            high = middle


# ---------------------------------------------------------------------------------------------------------------------
# Separation in space and time.


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """The least distance between two vehicles ``first`` < ``second`` (indices), when it occurs, and where each is."""

    first: int
    second: int
    distance_m: float
    t_s: float
    first_m: FloatArray  # (3,)
    second_m: FloatArray  # (3,)


def least_separation(trajectories: Sequence[Trajectory]) -> list[Separation]:
    """Return for every pair its least distance over all time (PAPER.md eq. 9), in closed form per pair of segments.

    Nothing is sampled: between two neighbouring times of either vehicle both move linearly, so the distance there is
    that of a point to a segment. Before its start and after its end a vehicle stands still.
    """
    found = []
    for i, one in enumerate(trajectories):
        for j in range(i + 1, len(trajectories)):
            other = trajectories[j]
            distance_m, t_s = closest_approach(one.t_s, one.position_m, other.t_s, other.position_m)
            found.append(Separation(i, j, float(distance_m), float(t_s), one.at(t_s), other.at(t_s)))
    return found


@njit(cache=True)
def closest_approach(t_a: FloatArray, a: FloatArray, t_b: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Return the least distance of two piecewise linear motions, and when."""
    i = 0
    j = 0
    best = math.inf
    when = 0.0
    t = min(t_a[0], t_b[0])
    x, y, z = a[0, 0] - b[0, 0], a[0, 1] - b[0, 1], a[0, 2] - b[0, 2]
    while True:
        squared = x * x + y * y + z * z
        if squared < best:
            best = squared
            when = t
        while i < len(t_a) and t_a[i] <= t:
            i += 1
        while j < len(t_b) and t_b[j] <= t:
            j += 1
        if i == len(t_a) and j == len(t_b):
            return math.sqrt(best), when
        until = math.inf
        if i < len(t_a):
            until = t_a[i]
        if j < len(t_b):
            until = min(until, t_b[j])
        next_x = _at(t_a, a, i, until, 0) - _at(t_b, b, j, until, 0)
        next_y = _at(t_a, a, i, until, 1) - _at(t_b, b, j, until, 1)
        next_z = _at(t_a, a, i, until, 2) - _at(t_b, b, j, until, 2)
        dx, dy, dz = next_x - x, next_y - y, next_z - z
        length2 = dx * dx + dy * dy + dz * dz
        if length2 > 0.0:
            share = -(x * dx + y * dy + z * dz) / length2
            if 0.0 < share < 1.0:
                squared = (x + share * dx) ** 2 + (y + share * dy) ** 2 + (z + share * dz) ** 2
                if squared < best:
                    best = squared
                    when = t + share * (until - t)
        t = until
        x, y, z = next_x, next_y, next_z


@njit(cache=True)
def _at(times: FloatArray, positions: FloatArray, k: int, t: float, axis: int) -> float:
    """Return one coordinate at ``t``, in the segment that ends at sample ``k``."""
    after = float(positions[min(k, len(times) - 1), axis])
    before = float(positions[max(k - 1, 0), axis])
    if k in (0, len(times)):
        return after
    share = float((t - times[k - 1]) / (times[k] - times[k - 1]))
    return before + share * (after - before)
