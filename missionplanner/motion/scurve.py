"""S-curve legs: from rest to rest along a straight line, limited in speed, acceleration, jerk and snap.

As ArduCopter plans its legs (https://ardupilot.org/copter/docs/parameters.html#wpnav-jerk). The motion along a leg is
22 segments: 7 to speed up, 7 to change the speed on the way, one at constant speed, 7 to brake. In each the jerk is
constant or half a raised cosine. A leg is one slice of LEG floats (see :mod:`.state`).
"""

from __future__ import annotations

import math

import numpy as np

from missionplanner.motion.curve import projected
from missionplanner.motion.state import (
    ACC,
    ACCELERATION,
    CLIMB,
    DESCENT,
    DURATION,
    JERK,
    LEG,
    LENGTH,
    SEGMENT,
    SEGMENT_0,
    SEGMENTS,
    SNAP,
    TIME,
    TOP,
    UX,
    VERTICAL_ACCELERATION,
    A,
    FloatArray,
    H,
    P,
    S,
    T,
    V,
    kernel,
)

SPEED_UP, CHANGE, CRUISE, BRAKE, END = np.array([0, 7, 14, 15, SEGMENTS])
"""First segments of these parts of a leg. Numpy's integers, for which numba does not compile a function anew."""


@kernel
def begins(leg: FloatArray, k: int) -> float:
    """Return when segment ``k`` begins; ``k = END`` is the leg's end."""
    return leg[SEGMENT_0 + k * SEGMENT + T]


@kernel
def along(leg: FloatArray, t: float) -> tuple[float, float, float]:
    """Return acceleration, speed and distance along the track ``t`` seconds after the leg began."""
    if t >= begins(leg, END):
        return 0.0, leg[SEGMENT_0 + END * SEGMENT + V], leg[LENGTH]
    k = 0
    if t >= begins(leg, BRAKE):
        k = BRAKE
    elif t >= begins(leg, CRUISE):
        k = CRUISE
    elif t >= begins(leg, CHANGE):
        k = CHANGE
    while k < SEGMENTS - 1 and t >= begins(leg, k + 1):
        k += 1
    return _within(leg, k, t - begins(leg, k))


@kernel
def clear(leg: FloatArray) -> None:
    """Make a leg without length: it takes no time."""
    for k in range(LEG):
        leg[k] = 0.0


@kernel
def plan(leg: FloatArray, s: FloatArray, speed_m_s: float, vertical_m_s: float) -> None:
    """Plan the motion from rest to rest within the limits of vehicle ``s``.

    The way is read from where the leg's unit vector goes; under a micrometre it takes no time.
    """
    length = math.sqrt(leg[UX] * leg[UX] + leg[UX + 1] * leg[UX + 1] + leg[UX + 2] * leg[UX + 2])
    for k in range(LENGTH, LEG):
        leg[k] = 0.0
    if length < 1e-6:
        return
    leg[LENGTH] = length
    for axis in range(3):
        leg[UX + axis] /= length
    leg[TOP] = projected(
        leg[UX], leg[UX + 1], leg[UX + 2], speed_m_s, min(s[CLIMB], vertical_m_s), min(s[DESCENT], vertical_m_s)
    )
    leg[ACC] = projected(
        leg[UX], leg[UX + 1], leg[UX + 2], s[ACCELERATION], s[VERTICAL_ACCELERATION], s[VERTICAL_ACCELERATION]
    )
    _put_rise(leg, s, SPEED_UP, 1.0, 0.0, leg[TOP], 0.5 * length)
    _chain(leg)
    _put_braking(leg, s, 0.0)


@kernel
def skip_to_braking(leg: FloatArray) -> float:
    """Begin a leg where it brakes; return the way that takes."""
    leg[TIME] = begins(leg, BRAKE)
    return leg[LENGTH] - leg[SEGMENT_0 + BRAKE * SEGMENT + P]


@kernel
def begin_at(leg: FloatArray, s: FloatArray, speed_m_s: float) -> float:
    """Begin a leg at a speed instead of from rest, if it may be as fast; return the speed that it begins at.

    Where speeding up does not fit into its first half, it begins in the middle of that.
    """
    o = SEGMENT_0 + CHANGE * SEGMENT
    speed = min(speed_m_s, leg[o + V])
    _put_rise(leg, s, SPEED_UP, 1.0, speed, leg[o + V], 0.5 * leg[LENGTH])
    _clear_segments(leg, CHANGE, CRUISE)
    leg[SEGMENT_0 + V] = speed
    _chain(leg)
    excess_m = leg[o + P] - 0.5 * leg[LENGTH]
    if excess_m > 0.0:
        leg[SEGMENT_0 + T] = -excess_m / leg[o + V]
        leg[SEGMENT_0 + P] = -excess_m
        _chain(leg)
    _put_braking(leg, s, 0.0)
    return speed


@kernel
def end_at(leg: FloatArray, s: FloatArray, speed_m_s: float) -> None:
    """End a leg at a speed instead of at rest, if it is as fast."""
    _put_braking(leg, s, min(speed_m_s, leg[SEGMENT_0 + CRUISE * SEGMENT + V]))


@kernel
def change_speed(leg: FloatArray, s: FloatArray, speed_m_s: float, vertical_m_s: float) -> None:
    """Fly the rest of a leg that has begun at another speed, as far as a running S-curve can still be changed.

    As the autopilot does: while the leg speeds up, the steady acceleration is cut short; the rest of the change comes
    after that; braking for the leg's end is never touched.
    """
    top = projected(
        leg[UX], leg[UX + 1], leg[UX + 2], speed_m_s, min(s[CLIMB], vertical_m_s), min(s[DESCENT], vertical_m_s)
    )
    t = leg[TIME]
    if top == leg[TOP]:
        return
    leg[TOP] = top
    if t >= begins(leg, BRAKE):
        return
    end_m_s = min(top, leg[SEGMENT_0 + END * SEGMENT + V])
    _make_room(leg, t)
    _chain(leg)
    steady = SEGMENT_0 + 3 * SEGMENT
    change = SEGMENT_0 + CHANGE * SEGMENT
    if t <= begins(leg, 4) and leg[steady + DURATION] > 0.0 and leg[steady + A] > 0.0:
        cut_s = max(leg[change + V] - top, 0.0) / leg[steady + A]
        leg[steady + DURATION] -= min(cut_s, begins(leg, 4) - max(t, begins(leg, 3)))
    fits = True
    for attempt in range(3):  # no change yet, for the room there is; the change; without it again where it does not fit
        if attempt == 1:
            now = leg[change + V]
            room_m = leg[SEGMENT_0 + BRAKE * SEGMENT + P] - leg[change + P]
            ramp_s = s[JERK] * math.pi / (2.0 * s[SNAP])
            ramp_s = min((abs(top - now) * math.pi / (4.0 * s[SNAP])) ** (1.0 / 3.0), ramp_s)
            if 12.0 * ramp_s * now >= room_m:  # the autopilot's own idea of too short
                return
            faster = min(top, room_m / (12.0 * ramp_s)) if ramp_s > 0.0 else top
            sign = 1.0 if top > now else -1.0
            _put_rise(leg, s, CHANGE, sign, min(top, now), max(faster, now), 0.5 * room_m)
        elif attempt == 2:
            if fits:
                return
            _clear_segments(leg, CHANGE, CRUISE)
        _chain(leg)
        fits = _put_braking(leg, s, end_m_s)


@kernel
def _make_room(leg: FloatArray, t: float) -> None:
    """Free the segments that change the speed on the way: what of them is under way or past counts as speeding up."""
    if begins(leg, CHANGE) <= t <= begins(leg, CRUISE):
        for k in range(SEGMENT_0, SEGMENT_0 + (CHANGE + 1) * SEGMENT):
            leg[k] = leg[k + CHANGE * SEGMENT]
        _clear_segments(leg, CHANGE, CRUISE)
    elif t > begins(leg, CRUISE):
        _, speed, distance = _within(leg, CRUISE, t - begins(leg, CRUISE))
        _clear_segments(leg, SPEED_UP, CRUISE)
        leg[SEGMENT_0 + T] = t
        leg[SEGMENT_0 + A] = 0.0
        leg[SEGMENT_0 + V] = speed
        leg[SEGMENT_0 + P] = distance
    else:
        _clear_segments(leg, CHANGE, CRUISE)


@kernel
def _within(leg: FloatArray, k: int, t: float) -> tuple[float, float, float]:
    """Return acceleration, speed and distance along the track ``t`` seconds into segment ``k``."""
    o = SEGMENT_0 + k * SEGMENT
    h = leg[o + H]
    a0 = leg[o + A]
    v0 = leg[o + V]
    a = a0 + h * t
    v = v0 + t * (a0 + 0.5 * h * t)
    p = leg[o + P] + t * (v0 + t * (0.5 * a0 + h * t / 6.0))
    if leg[o + S] != 0.0:
        b = leg[o + DURATION] / math.pi
        hsb = h * leg[o + S] * b
        sine = math.sin(t / b)
        a -= hsb * sine
        v -= hsb * b * (1.0 - math.cos(t / b))
        p -= hsb * b * (t - b * sine)
    return a, v, p


@kernel
def _chain(leg: FloatArray) -> None:
    """Carry the state at the start of the first segment through to the end."""
    for k in range(SEGMENTS):
        o = SEGMENT_0 + k * SEGMENT
        duration = leg[o + DURATION]
        a, v, p = leg[o + A], leg[o + V], leg[o + P]
        if duration > 0.0:
            a, v, p = _within(leg, k, duration)
        after = k + 1
        if after in (CHANGE, CRUISE, BRAKE, SEGMENTS):
            a = 0.0  # else rounding would stay for the whole leg
        leg[o + SEGMENT + T] = leg[o + T] + duration
        leg[o + SEGMENT + A] = a
        leg[o + SEGMENT + V] = v
        leg[o + SEGMENT + P] = p


@kernel
def _clear_segments(leg: FloatArray, first: int, last: int) -> None:
    """Make segments first..last-1 take no time."""
    for k in range(first, last):
        leg[SEGMENT_0 + k * SEGMENT + DURATION] = 0.0


@kernel
def _put_braking(leg: FloatArray, s: FloatArray, end_m_s: float) -> bool:
    """Write the cruise and the braking to a speed at the leg's end; False where the leg is too short for it."""
    o = SEGMENT_0 + CRUISE * SEGMENT
    speed = leg[o + V]
    end = min(end_m_s, speed)
    room_m = leg[LENGTH] - leg[o + P]
    room_m -= _put_rise(leg, s, BRAKE, -1.0, end, speed, math.inf if end == 0.0 else max(room_m, 0.0))
    leg[o + DURATION] = max(room_m, 0.0) / speed if speed > 0.0 else 0.0
    leg[o + H] = 0.0
    leg[o + S] = 0.0
    _chain(leg)
    o = SEGMENT_0 + END * SEGMENT
    if end == 0.0:
        leg[o + V] = 0.0
    leg[o + P] = leg[LENGTH]
    return room_m >= -1e-6


@kernel
def _put_rise(
    leg: FloatArray, s: FloatArray, first: int, sign: float, slow: float, fast: float, length_m: float
) -> float:
    """Write 7 segments that change the speed between ``slow`` and ``fast``, as far as fits into a length.

    ``sign`` +1 speeds up from ``slow``, -1 brakes down from ``fast``. Returns the length used.
    """
    wanted = max(fast - slow, 0.0)
    low = 0.0
    high = wanted
    rise = wanted
    for attempt in range(60):  # bisection: the length used grows with the rise
        peak, ramp_s, jerk_s, steady_s = _rise_times(rise, slow, leg[ACC], s[JERK], s[SNAP])
        used_m = (4.0 * ramp_s + 2.0 * jerk_s + steady_s) * (slow + 0.5 * rise)
        if used_m > length_m:
            high = rise
        elif rise == wanted or attempt == 59:
            break
        else:
            low = rise
        rise = 0.5 * (low + high) if attempt < 58 else low
    for k in range(7):
        o = SEGMENT_0 + (first + k) * SEGMENT
        h = sign * peak if k < 3 else -sign * peak
        if k == 3:
            leg[o + DURATION], leg[o + H], leg[o + S] = steady_s, 0.0, 0.0
        elif k in (1, 5):
            leg[o + DURATION], leg[o + H], leg[o + S] = jerk_s, h, 0.0
        else:
            leg[o + DURATION], leg[o + H], leg[o + S] = ramp_s, 0.5 * h, (1.0 if k in (0, 4) else -1.0)
    if sign < 0.0 and rise < wanted:
        used_m += (4.0 * ramp_s + 2.0 * jerk_s + steady_s) * (wanted - rise)
    return used_m


@kernel
def _rise_times(
    rise: float, slow: float, acceleration: float, jerk: float, snap: float
) -> tuple[float, float, float, float]:
    """Return (peak jerk, its ramp time, time at peak jerk, time at peak acceleration) of the fastest rise of speed."""
    if rise <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    ramp_s = min(jerk * math.pi / (2.0 * snap), math.sqrt(acceleration * math.pi / (2.0 * snap)))
    peak = 2.0 * snap * ramp_s / math.pi
    if rise <= 2.0 * peak * ramp_s * ramp_s:
        if slow == 0.0:
            ramp_s = (rise * math.pi / (4.0 * snap)) ** (1.0 / 3.0)
            return 2.0 * snap * ramp_s / math.pi, ramp_s, 0.0, 0.0
        return rise / (2.0 * ramp_s * ramp_s), ramp_s, 0.0, 0.0  # between speeds the autopilot keeps the ramp time
    if rise <= acceleration * (acceleration / peak + ramp_s):
        top = 0.5 * peak * (math.sqrt(ramp_s * ramp_s + 4.0 * rise / peak) - ramp_s)
        return peak, ramp_s, max(0.0, top / peak - ramp_s), 0.0
    jerk_s = acceleration / peak - ramp_s
    return peak, ramp_s, jerk_s, rise / acceleration - (jerk_s + 2.0 * ramp_s)
