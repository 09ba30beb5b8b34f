"""ArduCopter in AUTO (AC_WPNav 4.5): legs from rest to rest, added up around corners.

Every leg is an S-curve from rest to rest, planned on its own. The next leg starts while the present one brakes, as soon
as the middle of the turn so made lies inside the waypoint radius, is no faster than both legs and needs no more than
twice WPNAV_ACCEL. So the vehicle looks exactly one leg ahead, and short legs cap its speed. A change of speed takes
effect at the waypoint, when the next leg has already been planned (and begun) at the old one: it comes late.
The legs' clock runs slower while the vehicle lags behind its target.
Source: https://ardupilot.org/copter/docs/auto-mode.html and the measurements of its SITL.
"""

from __future__ import annotations

import math

import numpy as np

from missionplanner.motion import scurve
from missionplanner.motion.airframe import follow_target
from missionplanner.motion.state import (
    ACCELERATION,
    ALTITUDE_GAIN,
    BRAKED,
    BY_ALTITUDE,
    CLIMB,
    CORNER_ACCELERATION,
    COUNT,
    DESCENT,
    ELAPSED,
    FLYING,
    HALTED,
    HOLD,
    HOLD_LEFT,
    HOLDING,
    IDLE,
    INTEGRAL,
    JERK,
    TOUCHDOWN_RATE,
    LEG,
    LEGS,
    LENGTH,
    NEW_SPEED,
    ORIGIN,
    PACE,
    PHASE,
    POSITION,
    POSITION_GAIN,
    RADIUS,
    REACHED,
    RISE_JERK,
    SLOT,
    TOUCHDOWN_HEIGHT,
    SPEED,
    STALE,
    STARTING,
    TARGET,
    TARGET_ACCELERATION,
    TARGET_VELOCITY,
    TIME,
    TOP,
    UX,
    VELOCITY,
    VERTICAL,
    VERTICAL_ACCELERATION,
    WAYPOINT,
    FloatArray,
    IntArray,
    kernel,
)

_BEFORE, _NOW, _NEXT = np.array([-1, 0, 1])  # roles of the three legs; as in scurve
_STEP_S = 0.025
_FAR_S = 1e4  # a leg so long that it reaches any speed
_STEADY_END = 4  # the segment after the steady acceleration
_LOOP_S = 0.0025  # the autopilot's main loop, at which it looks whether a corner may begin


@kernel
def step(s: FloatArray, k: IntArray, route: FloatArray, dt: float) -> None:
    """Advance by ``dt``; a halt brakes by slowing the legs' clock down."""
    if k[PHASE] == STARTING:
        k[PHASE] = FLYING
        k[SLOT] = 0
        k[STALE] = -1
        s[PACE] = 1.0
        if s[TARGET_VELOCITY] != 0.0 or s[TARGET_VELOCITY + 1] != 0.0:  # told anew on its way, it stops where it can
            for axis in range(2):
                s[TARGET + axis], s[TARGET_VELOCITY + axis] = s[POSITION + axis], s[VELOCITY + axis]
    steps = round(dt / _STEP_S)
    h = dt / steps
    for _ in range(steps):
        if k[PHASE] == FLYING and route[k[WAYPOINT], BY_ALTITUDE] > 0.0:
            _go_vertically(s, k, route, h)
            continue
        pace = 1.0
        if k[HALTED] != 0 or s[BRAKED] > 0.0:
            w = min(k[WAYPOINT], k[COUNT] - 1)
            ramp_s = 0.5 * math.pi * max(route[w, SPEED], 0.5) / s[ACCELERATION]
            s[BRAKED] = min(1.0, s[BRAKED] + h / ramp_s) if k[HALTED] != 0 else max(0.0, s[BRAKED] - h / ramp_s)
            pace = 0.5 + 0.5 * math.cos(math.pi * s[BRAKED])
        _wait_for_vehicle(s, h)
        share = pace * s[PACE]
        if share > 1e-9:
            _advance(s, k, route, h * share, share)
        else:
            s[ELAPSED] += h
        _write_target(s, k, pace)
        follow_target(s, h)


@kernel
def _wait_for_vehicle(s: FloatArray, h: float) -> None:
    """Slow the legs' clock down while the vehicle is behind its target, with the time constant WPNAV_ACCEL / JERK."""
    speed2 = 0.0
    lag = 0.0
    flown = 0.0
    for axis in range(3):
        wanted = s[TARGET_VELOCITY + axis]
        speed2 += wanted * wanted
        lag += wanted * (s[TARGET + axis] - s[POSITION + axis])
        flown += wanted * s[VELOCITY + axis]
    pace = 1.0
    if speed2 > 0.0:
        pace = min(1.0, max(0.0, 0.05 + (flown - s[POSITION_GAIN] * lag) / speed2))
    s[PACE] += (pace - s[PACE]) * h * s[JERK] / s[ACCELERATION]


@kernel
def _leg(s: FloatArray, k: IntArray, role: int) -> FloatArray:
    """Return the leg flown before (-1), now (0) or next (1)."""
    o = LEGS + (k[SLOT] + role + 3) % 3 * LEG
    return s[o : o + LEG]


@kernel
def _plan_legs(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Take up a new speed, and plan what is stale: legs from role ``k[STALE]`` on.

    The next leg gets the present leg's speed: the autopilot does not know yet that it will change. At the start, role
    -1 brakes from the target's velocity; the first leg is added, from rest, where that ends.
    """
    w = k[WAYPOINT]
    if s[NEW_SPEED] > 0.0:
        for role in range(2):
            leg = _leg(s, k, role)
            if leg[TIME] > 0.0 and leg[LENGTH] > 0.0:
                scurve.change_speed(leg, s, route[w, SPEED], route[w, VERTICAL])
            else:
                k[STALE] = min(k[STALE], role)
        s[NEW_SPEED] = math.nan
    for role in range(k[STALE], 2):
        leg = _leg(s, k, role)
        if role >= 0 and w + role < k[COUNT] and route[w + role, BY_ALTITUDE] > 0.0:
            scurve.clear(leg)
            continue
        speed = route[w, SPEED]
        vertical = route[w, VERTICAL]
        if role == -1:
            speed = math.hypot(s[TARGET_VELOCITY], s[TARGET_VELOCITY + 1])
            vertical = abs(s[TARGET_VELOCITY + 2])
        elif role == 1 and (w + 1 == k[COUNT] or route[w, HOLD] > 0.0):
            scurve.clear(leg)
            continue
        for axis in range(3):
            if role == -1:
                leg[UX + axis] = s[TARGET_VELOCITY + axis] * _FAR_S
            elif role == 0:
                leg[UX + axis] = route[w, axis] - s[ORIGIN + axis]
            else:
                leg[UX + axis] = route[w + 1, axis] - route[w, axis]
        scurve.plan(leg, s, speed, vertical)
        if role == -1:
            way_m = scurve.skip_to_braking(leg)
            for axis in range(3):
                s[ORIGIN + axis] = s[TARGET + axis] + leg[UX + axis] * way_m
    k[STALE] = 2


@kernel
def _advance(s: FloatArray, k: IntArray, route: FloatArray, duration_s: float, share: float) -> None:
    """Advance the legs' clock by ``duration_s``, which is ``share`` of the real time; events are met exactly."""
    left_s = duration_s
    while k[PHASE] != IDLE:
        if k[STALE] < 2 or s[NEW_SPEED] > 0.0:
            _plan_legs(s, k, route)
        before = _leg(s, k, _BEFORE)
        if k[PHASE] == HOLDING:
            step_s = min(left_s, s[HOLD_LEFT] * share)
            s[HOLD_LEFT] -= step_s / share
            s[ELAPSED] += step_s / share
            before[TIME] += step_s
            left_s -= step_s
            if s[HOLD_LEFT] > 1e-9:
                return
            k[PHASE] = FLYING
            k[WAYPOINT] += 1
            if k[WAYPOINT] == k[COUNT]:
                k[PHASE] = IDLE
            k[STALE] = 0
            continue
        if route[k[WAYPOINT], BY_ALTITUDE] > 0.0:
            break
        this = _leg(s, k, _NOW)
        following = _leg(s, k, _NEXT)
        end_s = scurve.begins(this, scurve.END)
        turning = following[TIME] > 0.0
        if turning:  # the waypoint counts as reached half way through the turn
            event_s = 0.5 * (end_s - this[TIME] - following[TIME])
        elif following[LENGTH] > 0.0:
            event_s = _corner_after(s, this, following, left_s)
        else:
            event_s = end_s - this[TIME]
        event_s = max(event_s, 0.0)
        step_s = min(left_s, event_s)
        before[TIME] += step_s
        this[TIME] += step_s
        if turning:
            following[TIME] += step_s
        s[ELAPSED] += step_s / share
        left_s -= step_s
        if step_s < event_s:
            return
        if turning or this[TIME] >= end_s - 1e-9:
            _pass_waypoint(s, k, route)
        elif following[LENGTH] > 0.0:
            following[TIME] = 1e-12  # it runs from here on
        if left_s <= 0.0:
            return
    _leg(s, k, _BEFORE)[TIME] += left_s
    s[ELAPSED] += left_s / share


@kernel
def _corner_after(s: FloatArray, this: FloatArray, following: FloatArray, within_s: float) -> float:
    """Return after how long the next leg begins, or the present one ends; more than ``within_s`` if later than that."""
    now = this[TIME]
    end_s = scurve.begins(this, scurve.END)
    first_s = max(
        scurve.begins(this, scurve.BRAKE) - scurve.begins(following, _STEADY_END),
        end_s - 0.5 * scurve.begins(following, scurve.END),
        now,
    )
    last_s = min(now + within_s, end_s)
    if first_s < last_s and _corner_fits(s, this, following, last_s):
        low, high = 0, math.ceil((last_s - first_s) / _LOOP_S)
        while low < high:  # the first of the main loop's turns at which it fits
            middle = (low + high) // 2
            if _corner_fits(s, this, following, min(first_s + middle * _LOOP_S, last_s)):
                high = middle
            else:
                low = middle + 1
        return min(first_s + high * _LOOP_S, last_s) - now
    return end_s - now


@kernel
def _corner_fits(s: FloatArray, this: FloatArray, following: FloatArray, t: float) -> bool:
    """Whether starting the next leg when this one is ``t`` old keeps the turn within radius, speed and acceleration.

    Judged in its middle, and no earlier than half way along the leg.
    """
    if scurve.along(this, t)[2] < 0.5 * this[LENGTH]:
        return False
    half_s = 0.5 * (scurve.begins(this, scurve.END) - t)
    a, v, p = scurve.along(this, t + half_s)
    next_a, next_v, next_p = scurve.along(following, half_s)
    p -= this[LENGTH]
    miss2 = 0.0
    speed2 = 0.0
    acceleration2 = 0.0
    for axis in range(3):
        u, w = this[UX + axis], following[UX + axis]
        miss2 += (u * p + w * next_p) ** 2
        if axis < 2:
            speed2 += (u * v + w * next_v) ** 2
            acceleration2 += (u * a + w * next_a) ** 2
    return (
        miss2 < s[RADIUS] ** 2
        and speed2 < min(this[TOP], following[TOP]) ** 2
        and acceleration2 < s[CORNER_ACCELERATION] ** 2
    )


@kernel
def _pass_waypoint(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Take note of a reached waypoint and turn to what comes next."""
    w = k[WAYPOINT]
    route[w, REACHED] = s[ELAPSED]
    for axis in range(3):
        s[ORIGIN + axis] = route[w, axis]
    k[SLOT] = (k[SLOT] + 1) % 3
    k[STALE] = 1
    if route[w, HOLD] > 0.0:
        k[PHASE] = HOLDING
        s[HOLD_LEFT] = route[w, HOLD]
        return
    k[WAYPOINT] = w + 1
    if w + 1 == k[COUNT]:
        k[PHASE] = IDLE
    elif route[w + 1, SPEED] != route[w, SPEED] or route[w + 1, VERTICAL] != route[w, VERTICAL]:
        s[NEW_SPEED] = route[w + 1, SPEED]


@kernel
def _go_vertically(s: FloatArray, k: IntArray, route: FloatArray, h: float) -> None:
    """Take off or land: straight up or down from where the target comes to rest, by the shaped rate of climb.

    A take-off is over when the target has slowed down to a tenth of the climb rate, the target then being its end; a
    landing, when the vehicle meets the ground.
    """
    if k[STALE] < 2:
        _plan_legs(s, k, route)
    w = k[WAYPOINT]
    rising = route[w, 2] > s[ORIGIN + 2]
    z, rate, acceleration = s[TARGET + 2], s[TARGET_VELOCITY + 2], s[TARGET_ACCELERATION + 2]
    limit = s[VERTICAL_ACCELERATION]
    error = route[w, 2] - z
    if k[HALTED] != 0:
        wanted = 0.0
    elif rising:
        wanted = min(_approach(error, 0.5 * s[RISE_JERK] / limit, 0.5 * limit), s[CLIMB], route[w, VERTICAL])
    else:
        low = _approach(error + s[TOUCHDOWN_HEIGHT], s[ALTITUDE_GAIN], limit)
        wanted = min(max(low, -s[DESCENT], -route[w, VERTICAL]), -s[TOUCHDOWN_RATE])
    wanted = _approach(wanted - rate, s[RISE_JERK] / limit, s[RISE_JERK])
    wanted = min(max(wanted, -limit), limit)
    before = acceleration
    acceleration += min(max(wanted - acceleration, -s[RISE_JERK] * h), s[RISE_JERK] * h)
    z += (rate + 0.5 * before * h) * h
    rate += before * h
    s[ELAPSED] += h
    _leg(s, k, _BEFORE)[TIME] += h
    _write_target(s, k, 1.0)
    s[TARGET + 2], s[TARGET_VELOCITY + 2], s[TARGET_ACCELERATION + 2] = z, rate, acceleration
    follow_target(s, h)
    if rising:
        if rate >= 0.1 * s[CLIMB] or z - s[ORIGIN + 2] < 0.9 * (route[w, 2] - s[ORIGIN + 2]):
            return
    elif s[POSITION + 2] > route[w, 2]:
        return
    else:
        s[POSITION + 2] = route[w, 2]
        s[VELOCITY + 2] = 0.0
        s[INTEGRAL + 2] = 0.0
    s[PACE] = 1.0
    _pass_waypoint(s, k, route)
    _plan_legs(s, k, route)
    _write_target(s, k, 1.0)


@kernel
def _approach(error: float, gain: float, acceleration: float) -> float:
    """Return the speed at which to close an error: in proportion to it, and no more than can be braked in time."""
    linear = acceleration / (gain * gain)
    if abs(error) <= linear:
        return gain * error
    return math.copysign(math.sqrt(2.0 * acceleration * (abs(error) - 0.5 * linear)), error)


@kernel
def _write_target(s: FloatArray, k: IntArray, pace: float) -> None:
    """Add up what is left of the leg before, the present leg and, in a turn, the next one."""
    for axis in range(3):
        s[TARGET + axis] = s[ORIGIN + axis]
        s[TARGET_VELOCITY + axis] = 0.0
        s[TARGET_ACCELERATION + axis] = 0.0
    for role in range(-1, 2):
        leg = _leg(s, k, role)
        if leg[LENGTH] == 0.0 or (role >= 0 and (k[PHASE] != FLYING or leg[TIME] == 0.0)):
            continue
        a, v, p = scurve.along(leg, leg[TIME])
        if role == -1:
            p -= leg[LENGTH]
        for axis in range(3):
            s[TARGET + axis] += leg[UX + axis] * p
            s[TARGET_VELOCITY + axis] += leg[UX + axis] * v * pace
            s[TARGET_ACCELERATION + axis] += leg[UX + axis] * a * pace * pace
