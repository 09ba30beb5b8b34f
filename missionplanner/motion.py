"""How an autopilot's navigator flies a route: one piece of code for the planner's clock and for the simulator.

Three navigators, each after the code that flies the real vehicle:

* ArduCopter (AC_WPNav, SCurve): every leg is a jerk- and snap-limited motion from rest to rest, planned on its own; two
  neighbouring legs are added up from the moment the first one brakes, as long as the corner so cut stays inside the
  waypoint radius. So the vehicle looks exactly one leg ahead, and short legs cap its speed.
* PX4 multicopter (PositionSmoothing, VelocitySmoothing): the speed towards a waypoint is what still allows braking to
  the corner's speed; each axis follows it with limited jerk.
* Plane: constant airspeed, L1 guidance along the legs with a least turning radius, waypoints accepted on the way.

Routes are points of the local frame (x east, y north, z altitude AMSL). A leg's speed is horizontal, as autopilots
understand it; vertical rates have their own limits, and the slower of the two decides.

Sources: https://ardupilot.org/copter/docs/auto-mode.html,
https://docs.px4.io/main/en/config_mc/mc_jerk_limited_type_trajectory.html,
https://ardupilot.org/plane/docs/navigation-tuning.html.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from missionplanner.geodesy import FloatArray
from missionplanner.plan import Trajectory
from missionplanner.vehicle import MotionModel

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

TICK_S = 0.05
"""The step of simulated time."""


class Route(NamedTuple):
    """Legs to fly one after the other; ``Navigator.follow(i, *route)`` flies them.

    ``points_m`` (W, 3), ``speed_m_s`` (W,) horizontal speed of the leg *to* each point, ``hold_s`` (W,) time to stand
    still at each point, ``vertical_m_s`` (W,) upper bound on the climb and descent rate of each leg.
    """

    points_m: FloatArray
    speed_m_s: FloatArray
    hold_s: FloatArray
    vertical_m_s: FloatArray

    @classmethod
    def through(
        cls,
        points_m: npt.ArrayLike,
        speed_m_s: npt.ArrayLike,
        hold_s: npt.ArrayLike | None = None,
        vertical_m_s: npt.ArrayLike | None = None,
    ) -> Route:
        """Return a route through points (W, 3); scalars hold for every leg. No hold, no vertical bound by default."""
        points = np.array(points_m, dtype=float).reshape(-1, 3)

        def each(value: npt.ArrayLike | None, default: float) -> FloatArray:
            return np.array(np.broadcast_to(np.asarray(default if value is None else value, dtype=float), len(points)))

        return cls(points, each(speed_m_s, 0.0), each(hold_s, 0.0), each(vertical_m_s, math.inf))


# ---------------------------------------------------------------------------------------------------------------------
# The kernel's state: structs of arrays, one row per vehicle.

_COPTER, _PX4, _PLANE = 0, 1, 2  # navigators
_IDLE, _FLYING, _HOLDING = 0, 1, 2  # phases

# columns of limits: what never changes in flight
_ACCELERATION, _JERK, _SNAP, _VERTICAL_ACCELERATION, _CLIMB, _DESCENT, _RADIUS, _TURN_RADIUS, _LIMITS = range(9)
# columns of a route: the point, and the leg to it
_SPEED, _HOLD, _VERTICAL, _ROUTE = 3, 4, 5, 6
# columns of clocks: time since follow(), rest of a hold, share of a halt braked; and PX4's speed into a turn
_ELAPSED, _HOLD_LEFT, _BRAKED, _TURN_SPEED, _CLOCKS = range(5)


class _Fleet(NamedTuple):
    """N vehicles, routes padded to W points, three S-curve legs each (flown before, flown now, flown next)."""

    navigator: IntArray  # (N,)
    limits: FloatArray  # (N, _LIMITS)
    position_m: FloatArray  # (N, 3)
    velocity_m_s: FloatArray  # (N, 3)
    acceleration_m_s2: FloatArray  # (N, 3)
    routes: FloatArray  # (N, W, _ROUTE)
    count: IntArray  # (N,)
    waypoint: IntArray  # (N,)
    reached_s: FloatArray  # (N, W)
    phase: IntArray  # (N,)
    halted: BoolArray  # (N,)
    clocks: FloatArray  # (N, _CLOCKS)
    origin_m: FloatArray  # (N, 3) where the present leg began
    legs: FloatArray  # (N, 3, _SEGMENTS + 1, _COLUMNS)
    leg: FloatArray  # (N, 3, _LEG)
    slot: IntArray  # (N,) which of the three is flown now


# ---------------------------------------------------------------------------------------------------------------------
# S-curves. A leg's motion along its track is 22 segments: 7 to speed up, 7 to change the speed on the way, one at
# constant speed, 7 to brake. In each, jerk is h (1 - s cos(t / b)): constant for s = 0, else half a raised cosine.

_SEGMENTS = 22
_CHANGE, _CRUISE, _BRAKE = 7, 14, 15  # first segments of these parts
_DURATION, _H, _S, _T, _A, _V, _P, _COLUMNS = range(8)  # columns of a segment; _T.._P hold at its start
_UX, _UY, _UZ, _LENGTH, _TIME, _TOP, _ACC, _LEG = range(8)  # columns of a leg: unit vector, length, time flown, limits


@njit(cache=True)
def _ramp(speed_0, speed_1, acceleration, jerk, snap, length_m):
    """Return (rise of speed, peak jerk, its ramp time, time at peak jerk, time at peak acceleration).

    The rise from ``speed_0`` towards ``speed_1`` that is as large as fits into ``length_m``.
    """
    wanted = speed_1 - speed_0
    if wanted <= 0.0 or length_m <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    low = 0.0
    high = wanted
    rise = wanted
    for _ in range(60):
        peak, ramp_s, jerk_s, steady_s = _ramp_times(rise, speed_0, acceleration, jerk, snap)
        total_s = 4.0 * ramp_s + 2.0 * jerk_s + steady_s
        if total_s * (speed_0 + 0.5 * rise) <= length_m:
            low = rise
            if rise == wanted:
                break
        else:
            high = rise
        rise = 0.5 * (low + high)
    peak, ramp_s, jerk_s, steady_s = _ramp_times(low, speed_0, acceleration, jerk, snap)
    return low, peak, ramp_s, jerk_s, steady_s


@njit(cache=True)
def _ramp_times(rise, speed_0, acceleration, jerk, snap):
    """Return (peak jerk, its ramp time, time at peak jerk, time at peak acceleration) of the fastest rise of speed."""
    ramp_s = min(jerk * math.pi / (2.0 * snap), math.sqrt(acceleration * math.pi / (2.0 * snap)))
    peak = 2.0 * snap * ramp_s / math.pi
    if rise <= 2.0 * peak * ramp_s * ramp_s:
        if speed_0 == 0.0:
            ramp_s = (rise * math.pi / (4.0 * snap)) ** (1.0 / 3.0)
            return 2.0 * snap * ramp_s / math.pi, ramp_s, 0.0, 0.0
        return rise / (2.0 * ramp_s * ramp_s), ramp_s, 0.0, 0.0
    if rise <= acceleration * (acceleration / peak + ramp_s):
        top = 0.5 * peak * (math.sqrt(ramp_s * ramp_s + 4.0 * rise / peak) - ramp_s)
        return peak, ramp_s, max(0.0, top / peak - ramp_s), 0.0
    jerk_s = acceleration / peak - ramp_s
    return peak, ramp_s, jerk_s, rise / acceleration - (jerk_s + 2.0 * ramp_s)


@njit(cache=True)
def _put_ramp(segments, first, sign, peak, ramp_s, jerk_s, steady_s):
    """Write the 7 segments of a change of speed; ``sign`` is +1 to speed up."""
    for half in range(2):
        start = first + 4 * half
        h = sign * peak if half == 0 else -sign * peak
        segments[start, _DURATION] = ramp_s
        segments[start, _H] = 0.5 * h
        segments[start, _S] = 1.0
        segments[start + 1, _DURATION] = jerk_s
        segments[start + 1, _H] = h
        segments[start + 1, _S] = 0.0
        segments[start + 2, _DURATION] = ramp_s
        segments[start + 2, _H] = 0.5 * h
        segments[start + 2, _S] = -1.0
    segments[first + 3, _DURATION] = steady_s
    segments[first + 3, _H] = 0.0
    segments[first + 3, _S] = 0.0


@njit(cache=True)
def _clear(segments, first, last):
    """Make segments first..last-1 empty."""
    for k in range(first, last):
        segments[k, _DURATION] = 0.0
        segments[k, _H] = 0.0
        segments[k, _S] = 0.0


@njit(cache=True)
def _motion(segments, k, t):
    """Return acceleration, speed and distance along the track ``t`` seconds into segment ``k``."""
    h = segments[k, _H]
    s = segments[k, _S]
    a0 = segments[k, _A]
    v0 = segments[k, _V]
    a = a0 + h * t
    v = v0 + t * (a0 + 0.5 * h * t)
    p = segments[k, _P] + t * (v0 + t * (0.5 * a0 + h * t / 6.0))
    if s != 0.0:
        b = segments[k, _DURATION] / math.pi
        hsb = h * s * b
        sine = math.sin(t / b)
        a -= hsb * sine
        v -= hsb * b * (1.0 - math.cos(t / b))
        p -= hsb * b * (t - b * sine)
    return a, v, p


@njit(cache=True)
def _chain(segments, first):
    """Carry the state at the start of segment ``first`` through to the end."""
    for k in range(first, _SEGMENTS):
        duration = segments[k, _DURATION]
        segments[k + 1, _T] = segments[k, _T] + duration
        if duration > 0.0:
            a, v, p = _motion(segments, k, duration)
            segments[k + 1, _A] = a
            segments[k + 1, _V] = v
            segments[k + 1, _P] = p
        else:
            segments[k + 1, _A] = segments[k, _A]
            segments[k + 1, _V] = segments[k, _V]
            segments[k + 1, _P] = segments[k, _P]
        if k + 1 in (_CHANGE, _CRUISE, _BRAKE, _SEGMENTS):
            segments[k + 1, _A] = 0.0  # else rounding would stay for the whole leg


@njit(cache=True)
def _brake(segments, leg, limits):
    """Write the cruise and the braking to a stop at the leg's end; False where the leg is too short for it."""
    speed = segments[_CRUISE, _V]
    rise, peak, ramp_s, jerk_s, steady_s = _ramp(0.0, speed, leg[_ACC], limits[_JERK], limits[_SNAP], math.inf)
    brake_m = 0.5 * rise * (4.0 * ramp_s + 2.0 * jerk_s + steady_s)
    room_m = leg[_LENGTH] - segments[_CRUISE, _P] - brake_m
    fits = room_m >= -1e-6
    segments[_CRUISE, _DURATION] = max(room_m, 0.0) / speed if speed > 0.0 else 0.0
    segments[_CRUISE, _H] = 0.0
    segments[_CRUISE, _S] = 0.0
    _put_ramp(segments, _BRAKE, -1.0, peak, ramp_s, jerk_s, steady_s)
    _chain(segments, _CRUISE)
    segments[_SEGMENTS, _V] = 0.0
    segments[_SEGMENTS, _P] = leg[_LENGTH]
    return fits


@njit(cache=True)
def _track_speed(leg, horizontal_m_s, climb_m_s, descent_m_s):
    """Return the speed along a leg that keeps both the horizontal and the vertical limit."""
    level = math.sqrt(leg[_UX] * leg[_UX] + leg[_UY] * leg[_UY])
    vertical = climb_m_s if leg[_UZ] > 0.0 else descent_m_s
    speed = math.inf
    if level > 1e-9:
        speed = horizontal_m_s / level
    if abs(leg[_UZ]) > 1e-9:
        speed = min(speed, vertical / abs(leg[_UZ]))
    return speed


@njit(cache=True)
def _plan_leg(segments, leg, limits, start, end, speed_m_s, vertical_m_s):
    """Plan the motion from rest at ``start`` to rest at ``end``; a leg without length takes no time."""
    leg[:] = 0.0
    segments[:] = 0.0
    dx = end[0] - start[0]
    dy = end[1] - start[1]
    dz = end[2] - start[2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    if length < 1e-6:
        return
    leg[_UX] = dx / length
    leg[_UY] = dy / length
    leg[_UZ] = dz / length
    leg[_LENGTH] = length
    leg[_TOP] = _track_speed(leg, speed_m_s, min(limits[_CLIMB], vertical_m_s), min(limits[_DESCENT], vertical_m_s))
    vertical = limits[_VERTICAL_ACCELERATION]
    leg[_ACC] = _track_speed(leg, limits[_ACCELERATION], vertical, vertical)
    _, peak, ramp_s, jerk_s, steady_s = _ramp(0.0, leg[_TOP], leg[_ACC], limits[_JERK], limits[_SNAP], 0.5 * length)
    _put_ramp(segments, 0, 1.0, peak, ramp_s, jerk_s, steady_s)
    _chain(segments, 0)
    _brake(segments, leg, limits)


@njit(cache=True)
def _change_speed(segments, leg, limits, speed_m_s, vertical_m_s):
    """Fly the rest of a leg at another speed, as far as a running S-curve can still be changed.

    As the autopilot does: before the leg begins it is planned anew; while it speeds up, the steady acceleration is cut
    short; the rest of the change comes after that; braking for the leg's end is never touched.
    """
    if leg[_LENGTH] == 0.0:
        return
    top = _track_speed(leg, speed_m_s, min(limits[_CLIMB], vertical_m_s), min(limits[_DESCENT], vertical_m_s))
    t = leg[_TIME]
    if top == leg[_TOP]:
        return
    leg[_TOP] = top
    if t >= segments[_BRAKE, _T]:
        return
    jerk = limits[_JERK]
    snap = limits[_SNAP]
    if t == 0.0:
        _, peak, ramp_s, jerk_s, steady_s = _ramp(0.0, top, leg[_ACC], jerk, snap, 0.5 * leg[_LENGTH])
        _put_ramp(segments, 0, 1.0, peak, ramp_s, jerk_s, steady_s)
        _clear(segments, _CHANGE, _CRUISE)
        _chain(segments, 0)
        _brake(segments, leg, limits)
        return
    if segments[_CHANGE, _T] <= t <= segments[_CRUISE, _T]:  # the change under way becomes the first part
        for k in range(_CHANGE + 1):
            segments[k] = segments[k + 7]
        _clear(segments, _CHANGE, _CRUISE)
    elif t > segments[_CRUISE, _T]:
        a, v, p = _motion(segments, _CRUISE, t - segments[_CRUISE, _T])
        _clear(segments, 0, _CRUISE)
        segments[: _CRUISE + 1, _T] = t
        segments[: _CRUISE + 1, _A] = 0.0
        segments[: _CRUISE + 1, _V] = v
        segments[: _CRUISE + 1, _P] = p
    else:
        _clear(segments, _CHANGE, _CRUISE)
    _chain(segments, 0)
    if t <= segments[4, _T] and segments[3, _DURATION] > 0.0 and segments[3, _A] > 0.0 and top < segments[_CHANGE, _V]:
        excess_s = (segments[_CHANGE, _V] - top) / segments[3, _A]
        segments[3, _DURATION] -= min(excess_s, segments[4, _T] - max(t, segments[3, _T]))
        _chain(segments, 0)
    _brake(segments, leg, limits)
    now = segments[_CHANGE, _V]
    if top != now:
        room_m = segments[_BRAKE, _P] - segments[_CHANGE, _P]
        ramp_s = min((abs(top - now) * math.pi / (4.0 * snap)) ** (1.0 / 3.0), jerk * math.pi / (2.0 * snap))
        if top < now and 12.0 * ramp_s * now < room_m:
            rise, peak, ramp_s, jerk_s, steady_s = _ramp(top, now, leg[_ACC], jerk, snap, 0.5 * room_m)
            _put_ramp(segments, _CHANGE, -1.0, peak, ramp_s, jerk_s, steady_s)
        elif top > now and room_m > 12.0 * ramp_s * now:
            goal = min(top, room_m / (12.0 * ramp_s))
            rise, peak, ramp_s, jerk_s, steady_s = _ramp(now, goal, leg[_ACC], jerk, snap, 0.5 * room_m)
            _put_ramp(segments, _CHANGE, 1.0, peak, ramp_s, jerk_s, steady_s)
        _chain(segments, _CHANGE)
        if not _brake(segments, leg, limits):  # no room: the autopilot keeps its speed
            _clear(segments, _CHANGE, _CRUISE)
            _chain(segments, _CHANGE)
            _brake(segments, leg, limits)


@njit(cache=True)
def _along(segments, leg, t):
    """Return acceleration, speed and distance along the track, ``t`` seconds after the leg began."""
    if t >= segments[_SEGMENTS, _T]:
        return 0.0, 0.0, leg[_LENGTH]
    k = 0
    if t >= segments[_BRAKE, _T]:
        k = _BRAKE
    elif t >= segments[_CRUISE, _T]:
        k = _CRUISE
    elif t >= segments[_CHANGE, _T]:
        k = _CHANGE
    while k < _SEGMENTS - 1 and t >= segments[k + 1, _T]:
        k += 1
    return _motion(segments, k, t - segments[k, _T])


# ---------------------------------------------------------------------------------------------------------------------
# ArduCopter.

_LOOP_S = 0.0025  # the autopilot's main loop, at which it looks whether a corner may begin


@njit(cache=True)
def _corner_fits(fleet, i, this, following):
    """Whether starting the next leg now keeps the middle of the turn within radius, speed and acceleration."""
    segments = fleet.legs[i, this]
    leg = fleet.leg[i, this]
    next_segments = fleet.legs[i, following]
    next_leg = fleet.leg[i, following]
    half_s = 0.5 * (segments[_SEGMENTS, _T] - leg[_TIME])
    a, v, p = _along(segments, leg, leg[_TIME] + half_s)
    next_a, next_v, next_p = _along(next_segments, next_leg, half_s)
    p -= leg[_LENGTH]
    miss = 0.0
    speed = 0.0
    acceleration = 0.0
    for axis in range(3):
        miss += (leg[_UX + axis] * p + next_leg[_UX + axis] * next_p) ** 2
        if axis < 2:
            speed += (leg[_UX + axis] * v + next_leg[_UX + axis] * next_v) ** 2
            acceleration += (leg[_UX + axis] * a + next_leg[_UX + axis] * next_a) ** 2
    return (
        miss < fleet.limits[i, _RADIUS] ** 2
        and speed < min(leg[_TOP], next_leg[_TOP]) ** 2
        and acceleration < (2.0 * fleet.limits[i, _ACCELERATION]) ** 2
    )


@njit(cache=True)
def _begin_leg(fleet, i):
    """Plan the leg to the current waypoint from the origin, and the one after it."""
    w = fleet.waypoint[i]
    route = fleet.routes[i]
    this = fleet.slot[i]
    _plan_leg(
        fleet.legs[i, this],
        fleet.leg[i, this],
        fleet.limits[i],
        fleet.origin_m[i],
        route[w],
        route[w, _SPEED],
        route[w, _VERTICAL],
    )
    _plan_next(fleet, i)


@njit(cache=True)
def _plan_next(fleet, i):
    """Plan the leg after the present one, at the present speed: the autopilot does not know yet that it will change."""
    w = fleet.waypoint[i]
    route = fleet.routes[i]
    following = (fleet.slot[i] + 1) % 3
    if w + 1 < fleet.count[i] and route[w, _HOLD] == 0.0:
        _plan_leg(
            fleet.legs[i, following],
            fleet.leg[i, following],
            fleet.limits[i],
            route[w],
            route[w + 1],
            route[w, _SPEED],
            route[w, _VERTICAL],
        )
    else:
        fleet.leg[i, following, :] = 0.0
        fleet.legs[i, following, :, :] = 0.0


@njit(cache=True)
def _at_waypoint(fleet, i):
    """Take note of a reached waypoint and turn to what comes next."""
    w = fleet.waypoint[i]
    route = fleet.routes[i]
    fleet.reached_s[i, w] = fleet.clocks[i, _ELAPSED]
    fleet.origin_m[i] = route[w, :3]
    fleet.slot[i] = (fleet.slot[i] + 1) % 3
    this = fleet.slot[i]
    if route[w, _HOLD] > 0.0:
        fleet.phase[i] = _HOLDING
        fleet.clocks[i, _HOLD_LEFT] = route[w, _HOLD]
        fleet.leg[i, this, :] = 0.0
        fleet.legs[i, this, :, :] = 0.0
        fleet.leg[i, (this + 1) % 3, :] = 0.0
        fleet.legs[i, (this + 1) % 3, :, :] = 0.0
        return
    fleet.waypoint[i] = w + 1
    if w + 1 == fleet.count[i]:
        fleet.phase[i] = _IDLE
        return
    if route[w + 1, _SPEED] != route[w, _SPEED] or route[w + 1, _VERTICAL] != route[w, _VERTICAL]:
        _change_speed(
            fleet.legs[i, this], fleet.leg[i, this], fleet.limits[i], route[w + 1, _SPEED], route[w + 1, _VERTICAL]
        )
    _plan_next(fleet, i)


@njit(cache=True)
def _advance_copter(fleet, i, duration_s, pace):
    """Advance the leg clocks of vehicle ``i``; real time runs ``1 / pace`` times as fast."""
    left_s = duration_s
    while fleet.phase[i] != _IDLE:
        if fleet.phase[i] == _HOLDING:
            step_s = min(left_s, fleet.clocks[i, _HOLD_LEFT])
            fleet.clocks[i, _HOLD_LEFT] -= step_s
            fleet.clocks[i, _ELAPSED] += step_s / pace
            before = (fleet.slot[i] + 2) % 3
            fleet.leg[i, before, _TIME] += step_s
            left_s -= step_s
            if fleet.clocks[i, _HOLD_LEFT] > 0.0:
                return
            fleet.phase[i] = _FLYING
            fleet.waypoint[i] += 1
            if fleet.waypoint[i] == fleet.count[i]:
                fleet.phase[i] = _IDLE
                return
            _begin_leg(fleet, i)
            continue
        before = (fleet.slot[i] + 2) % 3
        this = fleet.slot[i]
        following = (this + 1) % 3
        leg = fleet.leg[i, this]
        end_s = fleet.legs[i, this, _SEGMENTS, _T]
        next_leg = fleet.leg[i, following]
        turning = next_leg[_TIME] > 0.0
        if turning:  # the waypoint counts as reached half way through the turn
            event_s = 0.5 * (end_s - leg[_TIME] - next_leg[_TIME])
        elif next_leg[_LENGTH] > 0.0:
            window = max(fleet.legs[i, this, _BRAKE, _T], end_s - fleet.legs[i, following, _CHANGE, _T])
            event_s = window - leg[_TIME]
            if event_s <= 0.0:
                event_s = min(_LOOP_S, end_s - leg[_TIME])
        else:
            event_s = end_s - leg[_TIME]
        event_s = max(event_s, 0.0)
        step_s = min(left_s, event_s)
        leg[_TIME] += step_s
        fleet.leg[i, before, _TIME] += step_s
        if turning:
            next_leg[_TIME] += step_s
        fleet.clocks[i, _ELAPSED] += step_s / pace
        left_s -= step_s
        if step_s < event_s:
            return
        if turning or leg[_TIME] >= end_s - 1e-9:
            _at_waypoint(fleet, i)
        elif next_leg[_LENGTH] > 0.0 and _corner_fits(fleet, i, this, following):
            next_leg[_TIME] = 1e-12  # it runs from here on
        if left_s <= 0.0:
            return
    fleet.leg[i, (fleet.slot[i] + 2) % 3, _TIME] += left_s
    fleet.clocks[i, _ELAPSED] += left_s / pace


@njit(cache=True)
def _step_copter(fleet, i, dt):
    """ArduCopter: legs added up around corners; a halt brakes by slowing the legs' clocks down."""
    pace = 1.0
    done_s = dt
    if fleet.halted[i] or fleet.clocks[i, _BRAKED] > 0.0:
        speed = math.sqrt(fleet.velocity_m_s[i, 0] ** 2 + fleet.velocity_m_s[i, 1] ** 2 + fleet.velocity_m_s[i, 2] ** 2)
        w = min(fleet.waypoint[i], fleet.count[i] - 1)
        speed = max(speed, fleet.routes[i, w, _SPEED], 0.5)
        ramp_s = 0.5 * math.pi * speed / fleet.limits[i, _ACCELERATION]
        before = min(fleet.clocks[i, _BRAKED], 1.0)
        after = min(1.0, before + dt / ramp_s) if fleet.halted[i] else max(0.0, before - dt / ramp_s)
        fleet.clocks[i, _BRAKED] = after
        pace = 0.5 + 0.5 * math.cos(math.pi * after)
        done_s = dt * 0.5 * (pace + 0.5 + 0.5 * math.cos(math.pi * before))
    if done_s > 0.0:
        _advance_copter(fleet, i, done_s, done_s / dt)
    else:
        fleet.clocks[i, _ELAPSED] += dt
    for axis in range(3):
        fleet.position_m[i, axis] = fleet.origin_m[i, axis]
        fleet.velocity_m_s[i, axis] = 0.0
        fleet.acceleration_m_s2[i, axis] = 0.0
    for role in range(-1, 2):
        which = (fleet.slot[i] + role + 3) % 3
        leg = fleet.leg[i, which]
        if leg[_LENGTH] == 0.0 or (role >= 0 and (fleet.phase[i] != _FLYING or leg[_TIME] == 0.0)):
            continue
        a, v, p = _along(fleet.legs[i, which], leg, leg[_TIME])
        if role == -1:
            p -= leg[_LENGTH]
        for axis in range(3):
            fleet.position_m[i, axis] += leg[_UX + axis] * p
            fleet.velocity_m_s[i, axis] += leg[_UX + axis] * v * pace
            fleet.acceleration_m_s2[i, axis] += leg[_UX + axis] * a * pace * pace


# ---------------------------------------------------------------------------------------------------------------------
# PX4 multicopter.

_PX4_STEP_S = 0.025
_TRAJECTORY_GAIN = 0.5  # MPC_XY_TRAJ_P: share of the acceleration that corners are planned with
_ALTITUDE_RADIUS_M = 0.8  # NAV_MC_ALT_RAD


@njit(cache=True)
def _speed_to_brake(jerk, acceleration, distance_m, final_m_s):
    """Return the speed from which ``final_m_s`` can still be reached within a distance."""
    b = 4.0 * acceleration * acceleration / jerk
    c = -2.0 * acceleration * distance_m - final_m_s * final_m_s
    return max(0.5 * (-b + math.sqrt(b * b - 4.0 * c)), final_m_s)


@njit(cache=True)
def _corner_speed(cosine, acceleration, radius_m):
    """Return the speed of a circle tangent to two legs within a radius; ``cosine`` of the angle between the legs."""
    angle = math.acos(min(1.0, max(-1.0, cosine)))
    half = 0.5 * min(angle, math.pi - 1e-7)
    return math.sqrt(acceleration * radius_m * math.tan(half))


@njit(cache=True)
def _axis_times(a0, dv, jerk, a_max, direction):
    """Return times at +jerk, zero jerk, -jerk that change the speed of one axis by ``dv`` in the least time."""
    j = direction * jerk
    if j == 0.0:
        return 0.0, 0.0, 0.0
    delta = 2.0 * a0 * a0 + 4.0 * j * dv
    t1 = 0.0
    if delta >= 0.0:
        root = 0.5 * math.sqrt(delta)
        plus = (-a0 + root) / j
        minus = (-a0 - root) / j
        if plus >= 0.0 and a0 / j + plus >= 0.0:
            t1 = plus
        elif minus >= 0.0 and a0 / j + minus >= 0.0:
            t1 = minus
    t1 = _cap_acceleration(a0, j, t1, a_max)
    t3 = max(a0 / j + t1, 0.0)
    top = a0 + j * t1
    t2 = 0.0
    if abs(top) > 1e-9:
        t2 = max((dv - t1 * (a0 + 0.5 * j * t1) - t3 * (top - 0.5 * j * t3)) / top, 0.0)
    return t1, t2, t3


@njit(cache=True)
def _axis_times_within(total_s, a0, dv, jerk, a_max, direction):
    """Return the times as :func:`_axis_times` does, stretched so that all axes change speed together."""
    j = direction * jerk
    if j == 0.0:
        return 0.0, 0.0, 0.0
    delta = (total_s * j) ** 2 + 2.0 * total_s * a0 * j - a0 * a0 - 4.0 * j * dv
    t1 = 0.0
    if delta >= 0.0:
        root = math.sqrt(delta)
        b = j * total_s - a0
        plus = max((-b + root) / (-2.0 * j), 0.0)
        minus = max((-b - root) / (-2.0 * j), 0.0)
        if a0 / j + plus >= 0.0 and a0 / j + 2.0 * plus <= total_s:
            t1 = plus
        elif a0 / j + minus >= 0.0 and a0 / j + 2.0 * minus <= total_s:
            t1 = minus
    t1 = _cap_acceleration(a0, j, t1, a_max)
    t3 = max(a0 / j + t1, 0.0)
    return t1, max(total_s - t1 - t3, 0.0), t3


@njit(cache=True)
def _cap_acceleration(a0, j, t1, a_max):
    """Shorten a jerk phase so that it ends at the largest acceleration."""
    top = a0 + j * t1
    if top > a_max:
        t1 = (a_max - a0) / j
    elif top < -a_max:
        t1 = (-a_max - a0) / j
    return max(t1, 0.0)


@njit(cache=True)
def _px4_setpoint(fleet, i, setpoint):
    """Write the velocity towards the present waypoint that corners and stops allow."""
    limits = fleet.limits[i]
    route = fleet.routes[i]
    last = fleet.count[i] - 1
    w = min(fleet.waypoint[i], last)
    target = route[w]
    stops = w == last or target[_HOLD] > 0.0
    following = target if stops else route[w + 1]
    position = fleet.position_m[i]
    origin = fleet.origin_m[i]
    dx = target[0] - position[0]
    dy = target[1] - position[1]
    dz = target[2] - position[2]
    level = math.hypot(dx, dy)
    nx = target[0] - following[0]
    ny = target[1] - following[1]
    next_level = math.hypot(nx, ny)
    radius = limits[_RADIUS]
    cruise = target[_SPEED]
    corner = 0.0
    if next_level > 1e-3 and next_level >= radius and level > 0.0:
        exit_m_s = min(cruise, _speed_to_brake(limits[_JERK], limits[_ACCELERATION], next_level, 0.0))
        cosine = (dx * nx + dy * ny) / (level * next_level)
        corner = min(_corner_speed(cosine, _TRAJECTORY_GAIN * limits[_ACCELERATION], radius), exit_m_s, cruise)
    speed_xy = min(cruise, _speed_to_brake(limits[_JERK], limits[_ACCELERATION], level, corner))

    rising = dz > 0.0
    top_z = min(limits[_CLIMB] if rising else limits[_DESCENT], target[_VERTICAL])
    arrive_z = 0.0
    if abs(target[2] - following[2]) > 1e-3:
        nz = target[2] - following[2]
        norm = math.hypot(level, dz) * math.hypot(next_level, nz)
        cosine = (-level * next_level + dz * nz) / norm if norm > 0.0 else 1.0
        arrive_z = min(_corner_speed(cosine, limits[_VERTICAL_ACCELERATION], _ALTITUDE_RADIUS_M), top_z)
    speed_z = min(top_z, _speed_to_brake(limits[_JERK], limits[_VERTICAL_ACCELERATION], abs(dz), arrive_z))

    aim_x = dx
    aim_y = dy
    aim_z = dz
    vx = fleet.velocity_m_s[i, 0]
    vy = fleet.velocity_m_s[i, 1]
    speed = math.hypot(vx, vy)
    if speed > 0.2 and level > radius and (vx * dx + vy * dy) < 0.98 * speed * level:  # turning: aim along the leg
        lx = target[0] - origin[0]
        ly = target[1] - origin[1]
        lz = target[2] - origin[2]
        length = math.sqrt(lx * lx + ly * ly + lz * lz)
        if length > 0.0:
            lx /= length
            ly /= length
            lz /= length
            px = position[0] - origin[0]
            py = position[1] - origin[1]
            pz = position[2] - origin[2]
            along = px * lx + py * ly + pz * lz
            off2 = (along * lx - px) ** 2 + (along * ly - py) ** 2 + (along * lz - pz) ** 2
            ahead = math.sqrt(max(max(radius, 5.0) ** 2 - off2, 0.0))
            aim_x = (along + ahead) * lx - px
            aim_y = (along + ahead) * ly - py
            aim_z = (along + ahead) * lz - pz
        speed_xy = min(speed_xy, fleet.clocks[i, _TURN_SPEED])
    else:
        fleet.clocks[i, _TURN_SPEED] = speed_xy
    norm = math.sqrt(aim_x * aim_x + aim_y * aim_y + aim_z * aim_z)
    setpoint[:] = 0.0
    if norm > 1e-9:
        scale = math.hypot(speed_xy, speed_z) / norm
        aim_level = math.hypot(aim_x, aim_y)
        if aim_level > 0.0:
            scale = min(scale, speed_xy / aim_level)
        if abs(aim_z) > 0.0:
            scale = min(scale, speed_z / abs(aim_z))
        setpoint[0] = aim_x * scale
        setpoint[1] = aim_y * scale
        setpoint[2] = aim_z * scale


@njit(cache=True)
def _step_px4(fleet, i, dt):
    """PX4: a velocity towards the waypoint, followed axis by axis with limited jerk."""
    limits = fleet.limits[i]
    setpoint = np.zeros(3)
    times = np.zeros((3, 3))
    direction = np.zeros(3)
    steps = int(round(dt / _PX4_STEP_S))
    h = dt / steps
    position = fleet.position_m[i]
    velocity = fleet.velocity_m_s[i]
    acceleration = fleet.acceleration_m_s2[i]
    for _ in range(steps):
        if fleet.halted[i]:
            setpoint[:] = 0.0
        else:
            _px4_setpoint(fleet, i, setpoint)
        longest = 0.0
        for axis in range(3):
            a_max = limits[_VERTICAL_ACCELERATION] if axis == 2 else limits[_ACCELERATION]
            a0 = acceleration[axis]
            coast = velocity[axis] + 0.5 * a0 * abs(a0) / limits[_JERK]
            direction[axis] = np.sign(setpoint[axis] - coast)
            if direction[axis] == 0.0:
                direction[axis] = np.sign(a0)
            t1, t2, t3 = _axis_times(a0, setpoint[axis] - velocity[axis], limits[_JERK], a_max, direction[axis])
            times[axis, 0] = t1
            times[axis, 1] = t2
            times[axis, 2] = t3
            longest = max(longest, t1 + t2 + t3)
        for axis in range(3):
            a_max = limits[_VERTICAL_ACCELERATION] if axis == 2 else limits[_ACCELERATION]
            if times[axis, 0] + times[axis, 1] + times[axis, 2] < longest:
                t1, t2, t3 = _axis_times_within(
                    longest,
                    acceleration[axis],
                    setpoint[axis] - velocity[axis],
                    limits[_JERK],
                    a_max,
                    direction[axis],
                )
                times[axis, 0] = t1
                times[axis, 1] = t2
                times[axis, 2] = t3
            left = h
            for part in range(3):
                t = min(left, times[axis, part])
                j = direction[axis] * limits[_JERK] * (1 - part)
                position[axis] += t * (velocity[axis] + t * (0.5 * acceleration[axis] + j * t / 6.0))
                velocity[axis] += t * (acceleration[axis] + 0.5 * j * t)
                acceleration[axis] += j * t
                left -= t
            if left > 0.0:
                acceleration[axis] = 0.0
                position[axis] += left * velocity[axis]
        fleet.clocks[i, _ELAPSED] += h
        _px4_waypoint(fleet, i, h)


@njit(cache=True)
def _px4_waypoint(fleet, i, h):
    """Accept the waypoint inside its radius (and height band), hold, go on."""
    if fleet.phase[i] == _IDLE or fleet.halted[i]:
        return
    w = fleet.waypoint[i]
    target = fleet.routes[i, w]
    if fleet.phase[i] == _FLYING:
        distance = math.hypot(target[0] - fleet.position_m[i, 0], target[1] - fleet.position_m[i, 1])
        if distance > fleet.limits[i, _RADIUS] or abs(target[2] - fleet.position_m[i, 2]) > _ALTITUDE_RADIUS_M:
            return
        fleet.reached_s[i, w] = fleet.clocks[i, _ELAPSED]
        fleet.phase[i] = _HOLDING
        fleet.clocks[i, _HOLD_LEFT] = target[_HOLD]
    else:
        fleet.clocks[i, _HOLD_LEFT] -= h
    if fleet.clocks[i, _HOLD_LEFT] <= 0.0:
        fleet.waypoint[i] = w + 1
        fleet.phase[i] = _FLYING
        if w + 1 == fleet.count[i]:
            fleet.phase[i] = _IDLE
        else:
            fleet.origin_m[i] = target[:3]


# ---------------------------------------------------------------------------------------------------------------------
# Plane.

_GRAVITY_M_S2 = 9.80665
_L1_PERIOD_S = 17.0  # NAVL1_PERIOD
_L1_DAMPING = 0.75  # NAVL1_DAMPING
_ROLL_TIME_S = 0.5  # RLL2SRV_TCONST
_PLANE_STEP_S = 0.025


@njit(cache=True)
def _step_plane(fleet, i, dt):
    """Plane: L1 guidance along the legs at constant speed; halted or done, it circles to the right."""
    limits = fleet.limits[i]
    route = fleet.routes[i]
    position = fleet.position_m[i]
    velocity = fleet.velocity_m_s[i]
    steps = int(round(dt / _PLANE_STEP_S))
    h = dt / steps
    for _ in range(steps):
        last = fleet.count[i] - 1
        w = min(fleet.waypoint[i], last)
        target = route[w]
        origin = fleet.origin_m[i]
        speed = math.hypot(velocity[0], velocity[1])
        lx = target[0] - origin[0]
        ly = target[1] - origin[1]
        length = math.hypot(lx, ly)
        if speed < 1.0:  # at rest: roll along the leg
            course = math.atan2(ly, lx)
            speed = max(speed, 1e-6)
        else:
            course = math.atan2(velocity[1], velocity[0])
        reach = max(_L1_DAMPING * _L1_PERIOD_S * speed / math.pi, 1.0)
        along = 0.0
        sideways = 0.0
        if length > 1e-6:
            lx /= length
            ly /= length
            px = position[0] - origin[0]
            py = position[1] - origin[1]
            along = px * lx + py * ly
            off = px * ly - py * lx  # to the right of the leg
            bend = math.asin(max(-math.sin(math.pi / 4), min(math.sin(math.pi / 4), off / reach)))
            eta = math.atan2(math.sin(math.atan2(ly, lx) + bend - course), math.cos(math.atan2(ly, lx) + bend - course))
            eta = max(-0.5 * math.pi, min(0.5 * math.pi, eta))
            sideways = 4.0 * _L1_DAMPING * _L1_DAMPING * speed * speed / reach * math.sin(eta)
        widest = speed * speed / max(limits[_TURN_RADIUS], 1.0)
        if fleet.halted[i] or fleet.phase[i] == _IDLE:
            sideways = -widest
        sideways = max(-widest, min(widest, sideways))
        rolled = fleet.acceleration_m_s2[i, 0]  # lateral acceleration flown: it lags by the roll
        rolled += (sideways - rolled) * min(1.0, h / _ROLL_TIME_S)
        rolled = max(-widest, min(widest, rolled))
        fleet.acceleration_m_s2[i, 0] = rolled
        course += rolled / speed * h if speed > 1.0 else 0.0
        change = limits[_ACCELERATION] * h
        speed += max(-change, min(change, target[_SPEED] - speed))
        velocity[0] = speed * math.cos(course)
        velocity[1] = speed * math.sin(course)

        slope = 0.0
        height = target[2]
        if length > 1e-6 and not fleet.halted[i] and fleet.phase[i] != _IDLE:
            share = min(1.0, max(0.0, along / length))
            height = origin[2] + share * (target[2] - origin[2])
            slope = (target[2] - origin[2]) / length * speed if share < 1.0 else 0.0
        climb = slope + (height - position[2]) / 2.0
        climb = max(-min(limits[_DESCENT], target[_VERTICAL]), min(min(limits[_CLIMB], target[_VERTICAL]), climb))
        change = limits[_VERTICAL_ACCELERATION] * h
        velocity[2] += max(-change, min(change, climb - velocity[2]))
        for axis in range(3):
            position[axis] += velocity[axis] * h
        fleet.clocks[i, _ELAPSED] += h
        if fleet.phase[i] == _IDLE or fleet.halted[i]:
            continue
        if fleet.phase[i] == _HOLDING:
            fleet.clocks[i, _HOLD_LEFT] -= h
            if fleet.clocks[i, _HOLD_LEFT] > 0.0:
                continue
        else:
            near = min(limits[_RADIUS], reach)
            if w < last:
                nx = route[w + 1, 0] - target[0]
                ny = route[w + 1, 1] - target[1]
                turn = abs(math.atan2(lx * ny - ly * nx, lx * nx + ly * ny))
                near *= min(1.0, turn / (0.5 * math.pi))
            left = math.hypot(target[0] - position[0], target[1] - position[1])
            ahead = (target[0] - position[0]) * lx + (target[1] - position[1]) * ly
            if left > near and ahead > 0.0:
                continue
            fleet.reached_s[i, w] = fleet.clocks[i, _ELAPSED]
            if target[_HOLD] > 0.0:
                fleet.phase[i] = _HOLDING
                fleet.clocks[i, _HOLD_LEFT] = target[_HOLD]
                continue
        fleet.phase[i] = _FLYING
        fleet.waypoint[i] = w + 1
        fleet.origin_m[i] = target[:3]
        if w == last:
            fleet.phase[i] = _IDLE


# ---------------------------------------------------------------------------------------------------------------------
# All vehicles.


@njit(cache=True)
def _step(fleet, first, last, dt):
    """Advance vehicles first..last-1 by ``dt``."""
    for i in range(first, last):
        if fleet.count[i] == 0:
            continue
        if fleet.navigator[i] == _COPTER:
            _step_copter(fleet, i, dt)
        elif fleet.navigator[i] == _PX4:
            _step_px4(fleet, i, dt)
        else:
            _step_plane(fleet, i, dt)


@njit(cache=True)
def _start_route(fleet, i):
    """Begin a route from the present position and velocity."""
    fleet.waypoint[i] = 0
    fleet.phase[i] = _FLYING
    fleet.halted[i] = False
    fleet.reached_s[i, :] = np.nan
    fleet.clocks[i, :] = 0.0
    fleet.origin_m[i] = fleet.position_m[i]
    if fleet.navigator[i] != _COPTER:
        fleet.clocks[i, _TURN_SPEED] = math.inf
        return
    velocity = fleet.velocity_m_s[i]
    speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    fleet.leg[i] = 0.0
    fleet.legs[i] = 0.0
    fleet.slot[i] = 0
    if speed > 1e-6:  # brake from here; the new leg begins, from rest, where that would end, and is added to it
        leg = fleet.leg[i, 2]
        segments = fleet.legs[i, 2]
        for axis in range(3):
            leg[_UX + axis] = velocity[axis] / speed
        vertical = fleet.limits[i, _VERTICAL_ACCELERATION]
        leg[_ACC] = _track_speed(leg, fleet.limits[i, _ACCELERATION], vertical, vertical)
        rise, _, ramp_s, jerk_s, steady_s = _ramp(
            0.0, speed, leg[_ACC], fleet.limits[i, _JERK], fleet.limits[i, _SNAP], math.inf
        )
        leg[_LENGTH] = 0.5 * rise * (4.0 * ramp_s + 2.0 * jerk_s + steady_s)
        segments[0, _V] = speed
        _chain(segments, 0)
        _brake(segments, leg, fleet.limits[i])
        for axis in range(3):
            fleet.origin_m[i, axis] += leg[_UX + axis] * leg[_LENGTH]
    _begin_leg(fleet, i)


@njit(cache=True)
def _set_speed(fleet, i, speed_m_s):
    """Fly the present leg, as far as it still can be changed, and all later ones at another speed."""
    w = min(fleet.waypoint[i], fleet.count[i] - 1)
    fleet.routes[i, w:, _SPEED] = speed_m_s
    if fleet.navigator[i] != _COPTER or fleet.phase[i] != _FLYING:
        return
    for role in range(2):
        which = (fleet.slot[i] + role) % 3
        _change_speed(
            fleet.legs[i, which], fleet.leg[i, which], fleet.limits[i], speed_m_s, fleet.routes[i, w, _VERTICAL]
        )


@njit(cache=True)
def _run(fleet, positions_m, dt):
    """Step the one vehicle of a fleet until it is done; return the number of ticks (-1: more than there is room)."""
    positions_m[0] = fleet.position_m[0]
    for tick in range(1, len(positions_m)):
        _step(fleet, 0, 1, dt)
        positions_m[tick] = fleet.position_m[0]
        if fleet.phase[0] == _IDLE:
            return tick
    return -1


class Navigator:
    """N vehicles that fly routes, advanced together by :data:`TICK_S` per step.

    Parameters
    ----------
    models : N motion models
    position_m : (N, 3), where they stand at rest

    Attributes
    ----------
    position_m, velocity_m_s : (N, 3), of this instant
    waypoint : (N,) index into the route of the point being flown to; its length once all are reached
    finished : (N,) whether the last point is reached (and its hold over). A copter then stays there, a plane circles
    reached_s : (N, W) time since ``follow`` at which each point was reached, NaN while it is not
    """

    def __init__(self, models: Sequence[MotionModel], position_m: npt.ArrayLike) -> None:
        n = len(models)
        position = np.array(position_m, dtype=float).reshape(n, 3)
        limits = np.zeros((n, _LIMITS))
        navigator = np.zeros(n, dtype=np.int64)
        for i, model in enumerate(models):
            navigator[i], limits[i] = _limits(model)
        self._fleet = _Fleet(
            navigator=navigator,
            limits=limits,
            position_m=position,
            velocity_m_s=np.zeros((n, 3)),
            acceleration_m_s2=np.zeros((n, 3)),
            routes=np.zeros((n, 1, _ROUTE)),
            count=np.zeros(n, dtype=np.int64),
            waypoint=np.zeros(n, dtype=np.int64),
            reached_s=np.full((n, 1), np.nan),
            phase=np.zeros(n, dtype=np.int64),
            halted=np.zeros(n, dtype=np.bool_),
            clocks=np.zeros((n, _CLOCKS)),
            origin_m=position.copy(),
            legs=np.zeros((n, 3, _SEGMENTS + 1, _COLUMNS)),
            leg=np.zeros((n, 3, _LEG)),
            slot=np.zeros(n, dtype=np.int64),
        )

    @property
    def position_m(self) -> FloatArray:
        """Positions (N, 3)."""
        return self._fleet.position_m

    @property
    def velocity_m_s(self) -> FloatArray:
        """Velocities (N, 3)."""
        return self._fleet.velocity_m_s

    @property
    def waypoint(self) -> IntArray:
        """Index (N,) of the point being flown to."""
        return self._fleet.waypoint

    @property
    def finished(self) -> BoolArray:
        """Whether (N,) the last point is reached."""
        return self._fleet.phase == _IDLE

    @property
    def reached_s(self) -> FloatArray:
        """Times (N, W) since ``follow`` at which points were reached."""
        return self._fleet.reached_s

    def follow(
        self,
        i: int,
        points_m: npt.ArrayLike,
        speed_m_s: npt.ArrayLike,
        hold_s: npt.ArrayLike | None = None,
        vertical_m_s: npt.ArrayLike | None = None,
    ) -> None:
        """Fly vehicle ``i`` from where it is through points (W, 3), stopping at the last. See :class:`Route`."""
        new = Route.through(points_m, speed_m_s, hold_s, vertical_m_s)
        count = len(new.points_m)
        room = self._fleet.routes.shape[1]
        if count > room:
            n = len(self._fleet.count)
            routes = np.zeros((n, 2 * count, _ROUTE))
            routes[:, :room] = self._fleet.routes
            reached_s = np.full((n, 2 * count), np.nan)
            reached_s[:, :room] = self._fleet.reached_s
            self._fleet = self._fleet._replace(routes=routes, reached_s=reached_s)
        rows = self._fleet.routes[i, :count]
        rows[:, :3] = new.points_m
        rows[:, _SPEED] = new.speed_m_s
        rows[:, _HOLD] = new.hold_s
        rows[:, _VERTICAL] = new.vertical_m_s
        self._fleet.count[i] = count
        _start_route(self._fleet, i)

    def set_speed(self, i: int, speed_m_s: float) -> None:
        """Fly the rest of the route at another speed, as soon as the autopilot's navigator can."""
        if self._fleet.count[i]:
            _set_speed(self._fleet, i, float(speed_m_s))

    def halt(self, i: int) -> None:
        """Brake and hold the position (a plane circles) until ``resume``."""
        self._fleet.halted[i] = True

    def resume(self, i: int) -> None:
        """Go on along the route."""
        self._fleet.halted[i] = False

    def step(self) -> None:
        """Advance all vehicles by :data:`TICK_S`."""
        _step(self._fleet, 0, len(self._fleet.count), TICK_S)


def _limits(model: MotionModel) -> tuple[int, FloatArray]:
    """Return which navigator flies a model, and its row of limits."""
    ardupilot = model.autopilot == "ardupilot"
    row = np.zeros(_LIMITS)
    row[_ACCELERATION] = model.acceleration_m_s2
    row[_JERK] = model.jerk_m_s3
    row[_CLIMB] = model.climb_rate_m_s
    row[_DESCENT] = model.descent_rate_m_s
    row[_RADIUS] = model.waypoint_radius_m
    row[_TURN_RADIUS] = model.turn_radius_m
    if model.vehicle_class == "plane":
        row[_VERTICAL_ACCELERATION] = 3.0
        return _PLANE, row
    if ardupilot:
        row[_VERTICAL_ACCELERATION] = 1.0  # WPNAV_ACCEL_Z
        row[_SNAP] = 0.25 * math.pi * model.jerk_m_s3 / 0.15  # half of what ATC_INPUT_TC allows
        return _COPTER, row
    row[_VERTICAL_ACCELERATION] = 3.0  # MPC_ACC_DOWN_MAX
    return _PX4, row


def predict(
    model: MotionModel,
    start_m: npt.ArrayLike,
    points_m: npt.ArrayLike,
    speed_m_s: npt.ArrayLike,
    hold_s: npt.ArrayLike | None = None,
    vertical_m_s: npt.ArrayLike | None = None,
) -> tuple[Trajectory, FloatArray]:
    """Return the flight from rest at ``start_m`` through points (W, 3), and the times (W,) at which they are reached.

    Times count from the start. The motion is bit for bit that of a :class:`Navigator` stepped by :data:`TICK_S`.
    """
    navigator = Navigator([model], np.asarray(start_m, dtype=float).reshape(1, 3))
    return fly(navigator, Route.through(points_m, speed_m_s, hold_s, vertical_m_s))


def fly(navigator: Navigator, route: Route) -> tuple[Trajectory, FloatArray]:
    """Step the only vehicle of a navigator along a route until it has finished; as :func:`predict`."""
    navigator.follow(0, *route)
    fleet = navigator._fleet
    length_m = float(np.linalg.norm(np.diff(np.vstack([fleet.position_m, route.points_m]), axis=0), axis=1).sum())
    slowest = min(float(route.speed_m_s.min()), float(route.vertical_m_s.min()), *fleet.limits[0, [_CLIMB, _DESCENT]])
    room = int((2.0 * length_m / slowest + route.hold_s.sum() + 20.0 * (1 + len(route.points_m))) / TICK_S)
    flown = np.empty((room + 2, 3))
    ticks = _run(fleet, flown, TICK_S)
    assert ticks >= 0, "a route is flown in bounded time"
    return Trajectory(np.arange(ticks + 1) * TICK_S, flown[: ticks + 1].copy()), fleet.reached_s[
        0, : len(route.points_m)
    ].copy()


# ---------------------------------------------------------------------------------------------------------------------
# What autopilots do on their own: take off, land, return.

_ARDUCOPTER_SPOOL_S = 0.2  # from the command to the first movement, what a smoother start than measured leaves of it
_ARDUCOPTER_DISARM_S = 2.5  # from touch-down to motors off
_PX4_SPOOL_S = 3.7
_PX4_DISARM_S = 2.5
_SLOW_BELOW_M = 10.0  # LAND_ALT_LOW, MPC_LAND_ALT1: the descent slows down this high above the ground
_RTL_SPEED_M_S = 10.0  # RTL_SPEED = 0: WPNAV_SPEED, whatever speed the mission has set
_RTL_HEIGHT_M = {"ardupilot": 15.0, "px4": 60.0}  # RTL_ALT, RTL_RETURN_ALT
_RTL_WAIT_S = {"ardupilot": 5.0, "px4": 0.0}  # RTL_LOIT_TIME, RTL_LAND_DELAY


def takeoff_points(model: MotionModel, home_m: npt.ArrayLike, top_m: npt.ArrayLike, speed_m_s: float = 15.0) -> Route:
    """Return the take-off from rest at ``home_m`` (3,) to ``top_m`` (3,): a copter's is vertical.

    ``speed_m_s`` is a plane's airspeed. A copter's route has one more point at its beginning: the wait for the motors.
    """
    home = np.asarray(home_m, dtype=float)
    top = np.asarray(top_m, dtype=float)
    if model.vehicle_class == "plane":
        return Route.through([top], speed_m_s)
    if model.autopilot == "ardupilot":
        return Route.through([home, top], model.climb_rate_m_s, [_ARDUCOPTER_SPOOL_S, 0.0])
    knee = home + [0.0, 0.0, min(_SLOW_BELOW_M, max(top[2] - home[2], 0.0))]  # MPC_TKO_SPEED up to here
    return Route.through([home, knee, top], model.climb_rate_m_s, [_PX4_SPOOL_S, 0.0, 0.0], [math.inf, 1.5, math.inf])


def landing_points(model: MotionModel, from_m: npt.ArrayLike, ground_amsl_m: float, speed_m_s: float = 15.0) -> Route:
    """Return the landing straight below ``from_m`` (3,), up to the moment the motors stop.

    A plane, which nobody should ask for this, circles down at ``speed_m_s``.
    """
    start = np.asarray(from_m, dtype=float)
    if model.vehicle_class == "plane":
        return Route.through([[start[0], start[1], ground_amsl_m]], speed_m_s)
    slow = (
        [(_SLOW_BELOW_M, math.inf), (0.0, 0.5)]  # LAND_SPEED
        if model.autopilot == "ardupilot"
        else [(_SLOW_BELOW_M, math.inf), (5.0, 1.0), (0.0, 0.55)]  # MPC_LAND_SPEED, blended in below MPC_LAND_ALT1
    )
    legs = [(height, rate) for height, rate in slow if ground_amsl_m + height < start[2] or height == 0.0]
    points = [[start[0], start[1], ground_amsl_m + height] for height, _ in legs]
    hold_s = np.full(len(legs), TICK_S if model.autopilot == "ardupilot" else 0.0)  # slows down nearly to a stop
    hold_s[-1] = _ARDUCOPTER_DISARM_S if model.autopilot == "ardupilot" else _PX4_DISARM_S
    return Route.through(points, model.descent_rate_m_s, hold_s, [rate for _, rate in legs])


def return_points(model: MotionModel, from_m: npt.ArrayLike, home_m: npt.ArrayLike, speed_m_s: float = 15.0) -> Route:
    """Return the way home (RTL): up to the return height if below it, straight home, wait, land.

    ``speed_m_s`` is a plane's airspeed; a plane stays above its home.
    """
    start = np.asarray(from_m, dtype=float)
    home = np.asarray(home_m, dtype=float)
    if model.vehicle_class == "plane":
        return Route.through([[home[0], home[1], max(start[2], home[2] + 100.0)]], speed_m_s)  # RTL_ALTITUDE
    height = max(start[2], home[2] + _RTL_HEIGHT_M[model.autopilot])
    above = np.array([home[0], home[1], height])
    way = Route.through([[start[0], start[1], height], above], _RTL_SPEED_M_S, [0.0, _RTL_WAIT_S[model.autopilot]])
    down = landing_points(model, above, float(home[2]))
    return Route(*(np.concatenate(pair) for pair in zip(way, down, strict=True)))
