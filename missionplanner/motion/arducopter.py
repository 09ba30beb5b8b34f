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

from missionplanner.motion import curve, scurve
from missionplanner.motion.airframe import follow_target
from missionplanner.motion.state import (
    ACCELERATION,
    ALTITUDE_GAIN,
    ARRIVAL,
    BRAKED,
    BY_ALTITUDE,
    CLIMB,
    CORNER,
    CORNER_ACCELERATION,
    COUNT,
    CURVED,
    DESCENT,
    ELAPSED,
    FLYING,
    HALTED,
    HERMITE,
    HOLD,
    HOLD_LEFT,
    HOLDING,
    IDLE,
    INTEGRAL,
    JERK,
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
    RUN,
    SEGMENT,
    SEGMENT_0,
    SLOT,
    SPEED,
    SPLINE,
    STALE,
    STARTING,
    STEP_S,
    TARGET,
    TARGET_ACCELERATION,
    TARGET_VELOCITY,
    TIME,
    TOP,
    TOP_END,
    TOP_START,
    TOUCHDOWN_HEIGHT,
    TOUCHDOWN_RATE,
    UX,
    VELOCITY,
    VERTICAL,
    VERTICAL_ACCELERATION,
    WAYPOINT,
    FloatArray,
    IntArray,
    T,
    kernel,
)

_BEFORE, _NOW, _NEXT = np.array([-1, 0, 1])  # roles of the three legs; as in scurve
_ROLLING_M_S = 1e-6  # as slow as something can be that has not stopped
_STILL_M_S = 0.01
_UNSEEN_S = 0.12  # what is left of a leg so long before its end is too little for single precision
_HERE_M = 0.1
_SETTLE_S = 1.2  # what a first leg to where it already is takes: to the centimetre, it never is there
_FAR_S = 1e4  # a leg so long that it reaches any speed
_STEADY_END = 4  # the segment after the steady acceleration
_LOOP_S = 0.0025  # the autopilot's main loop, in which it looks whether a corner may begin


@kernel
def step(s: FloatArray, k: IntArray, route: FloatArray, dt: float) -> None:
    """Advance by ``dt``; a halt brakes by slowing the legs' clock down."""
    if k[PHASE] == STARTING:
        k[PHASE] = FLYING
        s[RUN] = 0.0
        k[SLOT] = 0
        k[STALE] = -1
        s[PACE] = 1.0
        # told anew on its way, it stops where it can
        if math.hypot(s[TARGET_VELOCITY], s[TARGET_VELOCITY + 1]) > _STILL_M_S:
            for axis in range(2):
                s[TARGET + axis], s[TARGET_VELOCITY + axis] = s[POSITION + axis], s[VELOCITY + axis]
    h = STEP_S
    for _ in range(round(dt / h)):
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
    if speed2 > _STILL_M_S * _STILL_M_S:
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
            if leg[CURVED] > 0.0:
                curve.limit(leg, s, route[w, SPEED], route[w, VERTICAL])
            elif leg[TIME] > 0.0 and leg[LENGTH] > 0.0:
                scurve.change_speed(leg, s, route[w, SPEED], route[w, VERTICAL])
            else:
                k[STALE] = min(k[STALE], role)
        s[NEW_SPEED] = math.nan
    starting = k[STALE] == -1
    if starting:
        _brake(s, k)
    for role in range(max(k[STALE], 0), 2):
        leg = _leg(s, k, role)
        v = w + role
        if v == k[COUNT] or route[v, BY_ALTITUDE] > 0.0 or (role == 1 and route[w, HOLD] > 0.0):
            scurve.clear(leg)
        elif route[v, SPLINE] > 0.0:
            _plan_curve(s, k, route, role)
        else:
            scurve.clear(leg)
            for axis in range(3):
                leg[UX + axis] = route[v, axis] - (s[ORIGIN + axis] if role == 0 else route[w, axis])
            scurve.plan(leg, s, route[w, SPEED], route[w, VERTICAL])
            if role == 0 and s[RUN] > _ROLLING_M_S and leg[LENGTH] > 0.0:
                scurve.begin_at(leg, s, s[RUN])
        if starting and role == 0 and route[v, HOLD] == 0.0 and _way_m(s, route, v) < _HERE_M:
            scurve.clear(leg)
            leg[SEGMENT_0 + scurve.END * SEGMENT + T] = _SETTLE_S
        if role == 1:
            _join(s, _leg(s, k, _NOW), leg)
        elif s[RUN] > 0.0:
            scurve.clear(_leg(s, k, _BEFORE))  # a spline is not added to what comes before or after it
    _plan_corner(s, _leg(s, k, _NOW), _leg(s, k, _NEXT))
    k[STALE] = 2


@kernel
def _way_m(s: FloatArray, route: FloatArray, w: int) -> float:
    """Return how far it is to a waypoint from where the leg begins."""
    return math.sqrt(
        (route[w, 0] - s[ORIGIN]) ** 2 + (route[w, 1] - s[ORIGIN + 1]) ** 2 + (route[w, 2] - s[ORIGIN + 2]) ** 2
    )


@kernel
def _brake(s: FloatArray, k: IntArray) -> None:
    """Plan the leg before the first one: it brakes from the target's velocity."""
    leg = _leg(s, k, _BEFORE)
    scurve.clear(leg)
    for axis in range(3):
        leg[UX + axis] = s[TARGET_VELOCITY + axis] * _FAR_S
    speed = math.hypot(s[TARGET_VELOCITY], s[TARGET_VELOCITY + 1])
    scurve.plan(leg, s, speed, abs(s[TARGET_VELOCITY + 2]))
    way_m = scurve.skip_to_braking(leg)
    for axis in range(3):
        s[ORIGIN + axis] = s[TARGET + axis] + leg[UX + axis] * way_m


@kernel
def _plan_curve(s: FloatArray, k: IntArray, route: FloatArray, role: int) -> None:
    """Plan the present or the next leg as a spline: it departs as the leg before it arrived."""
    w = k[WAYPOINT] + role
    leg = _leg(s, k, role)
    before = _leg(s, k, role - 1)
    moving = role == 1 or s[RUN] > 0.0
    turns = w + 1 < k[COUNT] and route[w, HOLD] == 0.0 and route[w + 1, BY_ALTITUDE] == 0.0
    for axis in range(3):
        start = s[ORIGIN + axis] if role == 0 else route[w - 1, axis]
        departure = before[ARRIVAL + axis] if before[CURVED] > 0.0 else before[UX + axis] * before[LENGTH]
        arrival = 0.0
        if turns:
            arrival = route[w + 1, axis] - (start if route[w + 1, SPLINE] > 0.0 else route[w, axis])
        leg[HERMITE + axis] = route[w, axis] - start
        leg[HERMITE + 3 + axis] = departure if moving else 0.0
        leg[ARRIVAL + axis] = arrival
    curve.plan(leg, s, route[k[WAYPOINT], SPEED], route[k[WAYPOINT], VERTICAL])


@kernel
def _join(s: FloatArray, this: FloatArray, following: FloatArray) -> None:
    """Where a leg of two is a spline: let the first end, and the second begin, as fast as both can."""
    if following[CURVED] > 0.0:
        if this[CURVED] > 0.0:
            this[TOP_END] = min(this[TOP_END], following[TOP_START])
        elif this[LENGTH] > 0.0:
            scurve.end_at(this, s, following[TOP_START])
    elif this[CURVED] > 0.0 and following[LENGTH] > 0.0:
        this[TOP_END] = min(this[TOP_END], scurve.begin_at(following, s, this[TOP_END]))


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
        if this[CURVED] > 0.0:
            if this[LENGTH] > 0.0:
                begun_s = left_s
                s[RUN], left_s = curve.advance(this, s, s[RUN], left_s)
                before[TIME] += begun_s - left_s
                s[ELAPSED] += (begun_s - left_s) / share
                if this[TIME] < 1.0:
                    return
            _pass_waypoint(s, k, route, s[RUN])
            continue
        end_s = scurve.begins(this, scurve.END)
        turning = following[TIME] > 0.0 and following[CURVED] == 0.0
        event_s = end_s - _UNSEEN_S - this[TIME]
        if turning:  # the waypoint counts as reached half way through the turn
            event_s = 0.5 * (end_s - this[TIME] - following[TIME])
        elif this[CORNER] < end_s - _UNSEEN_S:
            event_s = this[CORNER] - this[TIME]
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
        if turning or this[TIME] >= end_s - _UNSEEN_S - 1e-9:
            _pass_waypoint(s, k, route, scurve.along(this, math.inf)[1])
        else:
            following[TIME] = 1e-12  # it runs from here on
        if left_s <= 0.0:
            return
    _leg(s, k, _BEFORE)[TIME] += left_s
    s[ELAPSED] += left_s / share


@kernel
def _plan_corner(s: FloatArray, this: FloatArray, following: FloatArray) -> None:
    """Find out how old this leg is when the next one begins; where it does not before, at this one's end.

    The middle of the turn so made must lie inside the radius, be no faster than both legs, and need no more than the
    acceleration for corners. The later it begins, the nearer and slower that is.
    """
    end_s = scurve.begins(this, scurve.END)
    this[CORNER] = end_s
    if following[LENGTH] == 0.0 or following[TIME] > 0.0 or this[CURVED] > 0.0 or following[CURVED] > 0.0:
        return
    early = max(
        scurve.begins(this, scurve.BRAKE) - scurve.begins(following, _STEADY_END),
        end_s - 0.5 * scurve.begins(following, scurve.END),
        this[TIME],
    )
    late = end_s
    if not _near_and_slow(s, this, following, early):
        while late - early > _LOOP_S:
            middle = 0.5 * (early + late)
            if _near_and_slow(s, this, following, middle):
                late = middle
            else:
                early = middle
        early = late
    while early < end_s and not _turns_gently(s, this, following, early):
        early += _LOOP_S
    this[CORNER] = min(early, end_s)


@kernel
def _near_and_slow(s: FloatArray, this: FloatArray, following: FloatArray, t: float) -> bool:
    """Whether the middle of a turn that begins when this leg is ``t`` old is near enough and slow enough.

    No turn begins before half of the leg.
    """
    if t < scurve.begins(this, scurve.BRAKE) and scurve.along(this, t)[2] < 0.5 * this[LENGTH]:
        return False
    half_s = 0.5 * (scurve.begins(this, scurve.END) - t)
    _, v, p = scurve.along(this, t + half_s)
    _, next_v, next_p = scurve.along(following, half_s)
    p -= this[LENGTH]
    miss2 = 0.0
    speed2 = 0.0
    for axis in range(3):
        u, w = this[UX + axis], following[UX + axis]
        miss2 += (u * p + w * next_p) ** 2
        if axis < 2:
            speed2 += (u * v + w * next_v) ** 2
    return miss2 < s[RADIUS] ** 2 and speed2 < min(this[TOP], following[TOP]) ** 2


@kernel
def _turns_gently(s: FloatArray, this: FloatArray, following: FloatArray, t: float) -> bool:
    """Whether the middle of a turn that begins when this leg is ``t`` old needs no more than is allowed for corners."""
    half_s = 0.5 * (scurve.begins(this, scurve.END) - t)
    a, next_a = scurve.along(this, t + half_s)[0], scurve.along(following, half_s)[0]
    east, north = this[UX] * a + following[UX] * next_a, this[UX + 1] * a + following[UX + 1] * next_a
    return east * east + north * north < s[CORNER_ACCELERATION] ** 2


@kernel
def _pass_waypoint(s: FloatArray, k: IntArray, route: FloatArray, speed_m_s: float) -> None:
    """Take note of a waypoint that the target has reached with a speed, and turn to what comes next."""
    w = k[WAYPOINT]
    route[w, REACHED] = s[ELAPSED]
    for axis in range(3):
        s[ORIGIN + axis] = route[w, axis]
    k[SLOT] = (k[SLOT] + 1) % 3
    k[STALE] = 1
    s[RUN] = 0.0
    if route[w, HOLD] > 0.0:
        k[PHASE] = HOLDING
        s[HOLD_LEFT] = route[w, HOLD]
        return
    k[WAYPOINT] = w + 1
    flown = _leg(s, k, _BEFORE)
    if w + 1 == k[COUNT]:
        k[PHASE] = IDLE
    elif flown[CURVED] > 0.0 or route[w + 1, SPLINE] > 0.0:
        k[STALE] = 0  # planned anew from how it moves now
        s[RUN] = max(speed_m_s, _ROLLING_M_S)
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
    _pass_waypoint(s, k, route, 0.0)
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
        if leg[CURVED] > 0.0:
            if role == 0 and k[PHASE] == FLYING:
                direction = curve.direction(leg, leg[TIME])
                for axis in range(3):
                    s[TARGET + axis] += curve.along(leg, leg[TIME], axis)[0]
                    s[TARGET_VELOCITY + axis] += direction[axis] * s[RUN] * pace
            continue
        if leg[LENGTH] == 0.0 or (role >= 0 and (k[PHASE] != FLYING or leg[TIME] == 0.0)):
            continue
        a, v, p = scurve.along(leg, leg[TIME])
        if role == -1:
            p -= leg[LENGTH]
        for axis in range(3):
            s[TARGET + axis] += leg[UX + axis] * p
            s[TARGET_VELOCITY + axis] += leg[UX + axis] * v * pace
            s[TARGET_ACCELERATION + axis] += leg[UX + axis] * a * pace * pace
