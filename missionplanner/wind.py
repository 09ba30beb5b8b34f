"""What steady wind does to a flight: which speeds can be held, which legs cannot be flown, how far it is pushed off.

A copter leans against the wind; it makes the speed through the air at which drag takes all that its lean limit gives.
What is left of it against the wind is its greatest ground speed: it is commanded ground speeds, and flies slower where
it must. A plane is commanded its speed through the air; its nose points as far into the wind as keeps it on its leg.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from missionplanner import timing
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.motion import Navigator, Route, return_points
from missionplanner.motion.state import (
    DRAG,
    DRAG_SQUARED,
    INTEGRAL_GAIN,
    LEAN,
    POSITION_GAIN,
    VELOCITY_GAIN,
    initial,
)
from missionplanner.plan import Trajectory
from missionplanner.scene import VehicleTask
from missionplanner.vehicle import MotionModel, VehicleClass, VehicleLimits

LEAST_GROUND_M_S: dict[VehicleClass, float] = {"copter": 1.0, "plane": 3.0}
"""What is to be left of its airspeed against the wind: less is standing still as soon as the wind freshens."""

_SPEED_STEP_M_S = 0.25  # between speeds that are tried
_SPEEDS_MAX = 24
_HELD_SHARE = 0.95  # of what a tube allows: speeds between those that were tried may be a little worse
_SAME_M_S = 1e-6
_PX4_LEAN_TIME_S = 0.15  # MC_ROLL_P
_LEAN_IN_S, _LEAN_IN_STEP_S = 20.0, 0.01
_DIRECTIONS = 24
_WAY_M = 200.0  # long enough to show how far a straight flight is pushed aside


def calm(model: MotionModel) -> bool:
    """Return whether flights are predicted without wind."""
    return model.wind_m_s == (0.0, 0.0)


def told(model: MotionModel) -> str:
    """Return the wind that flights are predicted in, in words."""
    east, north = model.wind_m_s
    return f"{math.hypot(east, north):g} m/s of wind from {math.degrees(math.atan2(-east, -north)) % 360.0:.0f} degrees"


def _drag_m_s2(model: MotionModel, airspeed_m_s: float) -> float:
    row, _ = initial(model, np.zeros(3))
    return float((row[DRAG] + row[DRAG_SQUARED] * airspeed_m_s) * airspeed_m_s)


def airspeed_limit_m_s(model: MotionModel) -> float:
    """Return how fast a copter flies through the air at its lean limit; infinite for planes, that hold their airspeed.

    ArduCopter's default 30 degrees: 10.35 m/s, as measured in its SITL.
    """
    if model.vehicle_class == "plane":
        return math.inf
    row, _ = initial(model, np.zeros(3))
    lean, drag, squared = float(row[LEAN]), float(row[DRAG]), float(row[DRAG_SQUARED])
    return 2.0 * lean / (drag + math.sqrt(drag * drag + 4.0 * squared * lean))


def braking_m_s2(model: MotionModel, wind_m_s: float) -> float:
    """Return how hard a copter can brake at least while the wind pushes it on; never quite 0."""
    if wind_m_s == 0.0 or model.vehicle_class == "plane":
        return model.acceleration_m_s2
    row, _ = initial(model, np.zeros(3))
    return max(0.05, min(model.acceleration_m_s2, float(row[LEAN]) - _drag_m_s2(model, wind_m_s)))


def along_m_s(model: MotionModel, airspeed_m_s: float, way_m: FloatArray) -> FloatArray:
    """Return the ground speeds (...) along horizontal ways (..., 2) at an airspeed; -inf: it is carried off them.

    Of the two that may keep it on its way, the one forwards; where there is no way, the least of any direction.
    """
    wind = np.array(model.wind_m_s)
    length = np.hypot(way_m[..., 0], way_m[..., 1])
    course = way_m / np.where(length > 0.0, length, 1.0)[..., np.newaxis]
    tail = course @ wind
    across = course[..., 0] * wind[1] - course[..., 1] * wind[0]
    spare = airspeed_m_s**2 - across**2
    made = np.where(spare >= 0.0, tail + np.sqrt(np.maximum(spare, 0.0)), -math.inf)
    speeds: FloatArray = np.where(length > 0.0, made, airspeed_m_s - math.hypot(*model.wind_m_s))
    return speeds


def leg_problem(limits: VehicleLimits, model: MotionModel, way_m: FloatArray, speed_m_s: float) -> str | None:
    """Return why a leg (3,) cannot be flown in the wind when commanded a speed, and what helps; None: it can be."""
    if calm(model):
        return None
    plane = model.vehicle_class == "plane"
    lean_m_s = airspeed_limit_m_s(model)
    airspeed_m_s = speed_m_s if plane else min(lean_m_s, limits.airspeed_max_m_s)
    made_m_s = float(along_m_s(model, airspeed_m_s, way_m[:2]))
    least_m_s = LEAST_GROUND_M_S[model.vehicle_class]
    course = f"course {math.degrees(math.atan2(way_m[0], way_m[1])) % 360.0:.0f} degrees"
    if plane:
        if made_m_s >= least_m_s:
            return None
        makes = "is carried off it" if made_m_s == -math.inf else f"makes {made_m_s:.1f} m/s over the ground"
        return (
            f"({course}) cannot be flown: at an airspeed of {speed_m_s:g} m/s it {makes} in {told(model)}, expected at "
            f"least {least_m_s:g}: fly faster (speed_m_s), or in less wind"
        )
    length_m = math.hypot(way_m[0], way_m[1])
    need_m_s = math.hypot(*model.wind_m_s)
    if length_m > 0.0:
        need_m_s = max(need_m_s, math.dist(way_m[:2] / length_m * speed_m_s, model.wind_m_s))
    if need_m_s <= airspeed_m_s + _SAME_M_S:
        return None
    from_ = "airspeed_max_m_s" if limits.airspeed_max_m_s < lean_m_s else "at its lean limit"
    least_m_s = max(least_m_s, limits.speed_min_m_s)
    if length_m == 0.0 or made_m_s < least_m_s:
        makes = "is carried off" if made_m_s <= 0.0 else f"makes {made_m_s:.1f} m/s over the ground"
        slower = " its least speed (speed_m_s)" if least_m_s == limits.speed_min_m_s else ""
        return (
            f"({course}) cannot be flown: it makes {airspeed_m_s:.1f} m/s through the air ({from_}), and {makes} in "
            f"{told(model)}, expected at least{slower} {least_m_s:g}: fly in less wind, or another way"
        )
    if limits.airspeed_max_m_s < lean_m_s:  # the prediction knows the lean limit alone
        return (
            f"({course}) needs an airspeed of {need_m_s:.1f} m/s to fly {speed_m_s:g} m/s in {told(model)}, allowed "
            f"{airspeed_m_s:g} (airspeed_max_m_s): fly it at {math.floor(made_m_s * 10.0) / 10.0:g} m/s"
        )
    return None


def refuse_storm(tasks: Sequence[VehicleTask]) -> None:
    """Refuse wind that somebody cannot fly against at all.

    Raises
    ------
    InfeasibleError
        The strongest wind leaves somebody no ground speed against it.
    """
    for task in tasks:
        problem = storm_problem(task)
        if problem is not None:
            raise InfeasibleError(f"{task.name}: {problem}")


def storm_problem(task: VehicleTask) -> str | None:
    """Return why a vehicle cannot fly in the strongest wind allowed for, whatever its course; None: it can."""
    model, limits, wind_m_s = task.motion, task.limits, task.limits.wind_max_m_s
    if wind_m_s == 0.0:
        return None
    if model.vehicle_class == "plane":
        airspeed_m_s, from_ = max(limits.speed_max_m_s, model.cruise_speed_m_s), "the greatest of its speeds"
    elif math.isfinite(limits.airspeed_max_m_s) and calm(model):
        airspeed_m_s, from_ = limits.airspeed_max_m_s, "airspeed_max_m_s"
    else:
        lean_m_s = airspeed_limit_m_s(model)
        airspeed_m_s = min(lean_m_s, limits.airspeed_max_m_s)
        from_ = "at its lean limit" if airspeed_m_s == lean_m_s else "airspeed_max_m_s"
    least_m_s = LEAST_GROUND_M_S[model.vehicle_class]
    if airspeed_m_s - wind_m_s >= least_m_s - _SAME_M_S:
        return None
    return (
        f"wind of {wind_m_s:g} m/s against an airspeed of {airspeed_m_s:.1f} m/s ({from_}), expected at least "
        f"{least_m_s:g} m/s more airspeed than wind: fly in less wind, or with a faster vehicle"
    )


def legs_problem(task: VehicleTask, waypoints_m: FloatArray, speed_m_s: float) -> str | None:
    """Return why one of the legs between waypoints (W, 3) cannot be flown; None: all can."""
    for k, way_m in enumerate(np.diff(waypoints_m, axis=0), start=1):
        problem = leg_problem(task.limits, task.motion, way_m, speed_m_s)
        if problem is not None:
            return f"leg {k} of {len(waypoints_m) - 1} {problem}"
    return None


def speed_range_m_s(task: VehicleTask, waypoints_m: FloatArray) -> tuple[float, float]:
    """Return the least and the greatest commanded speed at which waypoints (W, 3) can be flown in the wind.

    A copter's is bounded by what keeps it within what its tube allows of its legs: who leans as far as it may has
    nothing left against a wind from the side. A plane's least speed is what still carries it against the wind.

    Raises
    ------
    InfeasibleError
        There is none: names the vehicle, the leg and the wind.
    """
    low, high = task.limits.speed_min_m_s, task.limits.speed_max_m_s
    if calm(task.motion):
        return low, high
    tries = np.linspace(low, high, min(_SPEEDS_MAX, 2 + int((high - low) / _SPEED_STEP_M_S))).tolist()
    plane = task.motion.vehicle_class == "plane"
    problem = legs_problem(task, waypoints_m, high if plane else low)
    if problem is not None:
        raise InfeasibleError(f"{task.name}: {problem}")
    if plane:
        return next(speed for speed in tries if legs_problem(task, waypoints_m, speed) is None), high
    off_m = 0.0
    for speed in reversed(tries):
        if legs_problem(task, waypoints_m, speed) is None:
            off_m = _outbound_off_m(task, waypoints_m, speed)
            if off_m <= _HELD_SHARE * task.limits.deviation_m:
                return low, speed
    raise InfeasibleError(
        f"{task.name}: {told(task.motion)} pushes it {off_m:.1f} m off its legs at {low:g} m/s, allowed "
        f"{task.limits.deviation_m:g} m: lower its least speed (speed_m_s), or fly in less wind"
    )


def _outbound_off_m(task: VehicleTask, waypoints_m: FloatArray, speed_m_s: float) -> float:
    trajectory, _ = timing.predict_flight(task.motion, task.home_m, waypoints_m, speed_m_s)
    line = np.concatenate([task.home_m[np.newaxis], waypoints_m])
    return off_legs_m(trajectory, np.stack([line[:-1], line[1:]], axis=1))


def off_legs_m(trajectory: Trajectory, legs: FloatArray) -> float:
    """Return how far a flight's samples are at most off the nearest of legs (N, 2, 3)."""
    return float(_distances_m(trajectory.position_m, legs).max(initial=0.0))


def _distances_m(points_m: FloatArray, legs: FloatArray) -> FloatArray:
    """Return the distances (P,) of points (P, 3) from the nearest of legs (N, 2, 3)."""
    nearest = np.full(len(points_m), math.inf)
    for begin, end in legs:
        along = end - begin
        share = np.clip((points_m - begin) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        np.minimum(nearest, np.linalg.norm(points_m - begin - share[:, np.newaxis] * along, axis=1), out=nearest)
    return nearest


def pushed_off_m(model: MotionModel) -> float:
    """Return how far a copter that returns is pushed off its straight way home at most, whatever its course."""
    if calm(model) or model.vehicle_class == "plane":
        return 0.0
    return _pushed_off_m(replace(model, return_height_m=0.0))


@lru_cache(maxsize=256)
def _pushed_off_m(model: MotionModel) -> float:
    speed_m_s = float(return_points(model, np.zeros(3), np.zeros(3)).speed_m_s[0])
    if airspeed_limit_m_s(model) - math.hypot(*model.wind_m_s) < LEAST_GROUND_M_S["copter"]:
        return math.inf
    return max(_off_straight_m(model, course, speed_m_s) for course in _courses())


def _courses() -> Iterator[FloatArray]:
    for turn in np.linspace(0.0, 2.0 * math.pi, _DIRECTIONS, endpoint=False).tolist():
        yield np.array([math.cos(turn), math.sin(turn), 0.0])


def _off_straight_m(model: MotionModel, course: FloatArray, speed_m_s: float) -> float:
    flown, _ = Navigator([model], np.zeros((1, 3))).fly(Route.through([_WAY_M * course], speed_m_s))
    return float(np.abs(flown.position_m[:, 0] * course[1] - flown.position_m[:, 1] * course[0]).max())


@lru_cache(maxsize=256)
def leaning_in_m(model: MotionModel, wind_m_s: float) -> float:
    """Return how far a copter drifts that lifts off upright, until it has leaned into the wind.

    The controller of :mod:`.motion.airframe`, along the wind; the predicted flight has leaned in before it lifts off.
    """
    row, _ = initial(model, np.zeros(3))
    gains = model.arducopter.velocity_gains if model.autopilot == "ardupilot" else model.px4.velocity_gains
    lean_time_s = model.arducopter.input_time_s if model.autopilot == "ardupilot" else _PX4_LEAN_TIME_S
    lean_share = _LEAN_IN_STEP_S / max(lean_time_s, _LEAN_IN_STEP_S)
    position = velocity = thrust = summed = farthest = before = 0.0
    for _ in range(round(_LEAN_IN_S / _LEAN_IN_STEP_S)):
        error = -float(row[POSITION_GAIN]) * position - velocity
        damping = gains[2] * (error - before) / _LEAN_IN_STEP_S
        wish, before = float(row[VELOCITY_GAIN]) * error + summed + damping, error
        limited = abs(wish) > row[LEAN]
        if not limited or error * summed < 0.0:
            summed += float(row[INTEGRAL_GAIN]) * error * _LEAN_IN_STEP_S
        wish = max(-float(row[LEAN]), min(float(row[LEAN]), wish))
        thrust += (wish - thrust) * lean_share
        air = abs(wind_m_s - velocity)
        push = float(row[DRAG] + row[DRAG_SQUARED] * air) * (wind_m_s - velocity)
        velocity += (thrust + push) * _LEAN_IN_STEP_S
        position += velocity * _LEAN_IN_STEP_S
        farthest = max(farthest, abs(position))
    return farthest
