"""Spline legs: a cubic Hermite curve, flown as fast as its curvature, the vehicle's limits and its end allow.

As ArduCopter 4.5 moves its target along a spline (AP_Math's SplineCurve): half of WPNAV_ACCEL is for speeding up and
slowing down, half for the curve. A leg is one slice of LEG floats (see :mod:`.state`), its TIME the curve's parameter.
Which curve a mission asks for: :mod:`.spline`.
"""

from __future__ import annotations

import math

from missionplanner.motion.state import (
    ACCELERATION,
    ARRIVAL,
    CLIMB,
    CURVED,
    DESCENT,
    HERMITE,
    LENGTH,
    TIME,
    TOP,
    TOP_DOWN,
    TOP_END,
    TOP_START,
    TOP_UP,
    VERTICAL_ACCELERATION,
    FloatArray,
    kernel,
)

_SHARE = 0.5  # TANGENTIAL_ACCEL_SCALER, LATERAL_ACCEL_SCALER
_LONGEST = 4.0  # SPLINE_FACTOR
_STEP_S = 0.005


@kernel
def plan(leg: FloatArray, s: FloatArray, speed_m_s: float, vertical_m_s: float) -> None:
    """Plan a curve; its way, departure and arrival (three each) are where HERMITE, HERMITE + 3 and ARRIVAL go.

    A curve without length takes no time and forgets how it was to arrive.
    """
    way2 = 0.0
    departure2 = 0.0
    arrival2 = 0.0
    for axis in range(3):
        way2 += leg[HERMITE + axis] ** 2
        departure2 += leg[HERMITE + 3 + axis] ** 2
        arrival2 += leg[ARRIVAL + axis] ** 2
    leg[CURVED] = 1.0
    leg[TIME] = 0.0
    leg[LENGTH] = math.sqrt(way2)
    limit(leg, s, speed_m_s, vertical_m_s)
    leg[TOP_START] = leg[TOP_END] = 0.0
    if leg[LENGTH] < 1e-6:
        leg[LENGTH] = 0.0
        for axis in range(3):
            leg[ARRIVAL + axis] = 0.0
        return
    tangents = math.sqrt(departure2) + math.sqrt(arrival2)
    longest = _LONGEST * leg[LENGTH]
    scale = longest / tangents if tangents > longest else 1.0
    for axis in range(3):
        way, departure = leg[HERMITE + axis], scale * leg[HERMITE + 3 + axis]
        arrival = scale * leg[ARRIVAL + axis]
        leg[HERMITE + axis] = departure
        leg[HERMITE + 3 + axis] = 3.0 * way - 2.0 * departure - arrival
        leg[HERMITE + 6 + axis] = departure - 2.0 * way + arrival
    leg[TOP_END] = math.inf
    if arrival2 == 0.0:
        leg[TOP_END] = 0.0
    end = leg[TOP_END]
    leg[TOP_START] = _limits(leg, s, 0.0)[2]
    if end > 0.0:
        leg[TOP_END] = _limits(leg, s, 1.0)[2]


@kernel
def limit(leg: FloatArray, s: FloatArray, speed_m_s: float, vertical_m_s: float) -> None:
    """Limit the speed along the curve anew."""
    leg[TOP] = speed_m_s
    leg[TOP_UP] = min(s[CLIMB], vertical_m_s)
    leg[TOP_DOWN] = min(s[DESCENT], vertical_m_s)


@kernel
def along(leg: FloatArray, t: float, axis: int) -> tuple[float, float]:
    """Return place, from the leg's origin, and its derivative by the parameter, along an axis."""
    a, b, c = leg[HERMITE + axis], leg[HERMITE + 3 + axis], leg[HERMITE + 6 + axis]
    return t * (a + t * (b + t * c)), a + t * (2.0 * b + 3.0 * t * c)


@kernel
def advance(leg: FloatArray, s: FloatArray, speed_m_s: float, duration_s: float) -> tuple[float, float]:
    """Move along the curve; return the speed then, and the time that is left over where its end was reached."""
    left_s = duration_s
    while left_s > 0.0:
        h = min(left_s, _STEP_S)
        derivative, bend, top, acceleration = _limits(leg, s, leg[TIME])
        leg[TIME] += _parameter(leg, derivative, bend, speed_m_s * h)
        speed_m_s = min(max(top, speed_m_s - acceleration * h), speed_m_s + acceleration * h)
        left_s -= h
        if leg[TIME] >= 1.0:
            leg[TIME] = 1.0
            break
    return speed_m_s, left_s


@kernel
def _parameter(leg: FloatArray, derivative: float, bend: float, way_m: float) -> float:
    """Return by how much the parameter grows on a short way, from where these are the derivatives along the curve."""
    if way_m == 0.0:
        return 0.0
    divisor = derivative + math.sqrt(max(derivative * derivative + 2.0 * bend * way_m, 0.0))
    if divisor > 1e-9:
        return 2.0 * way_m / divisor
    third2 = 0.0
    for axis in range(3):
        third2 += (6.0 * leg[HERMITE + 6 + axis]) ** 2
    third: float = (6.0 * way_m / math.sqrt(third2)) ** (1.0 / 3.0) if third2 > 0.0 else 1.0
    return third


@kernel
def direction(leg: FloatArray, t: float) -> tuple[float, float, float]:
    """Return the unit vector of the motion; where the curve begins or ends at rest, its bend tells."""
    x, y, z = along(leg, t, 0)[1], along(leg, t, 1)[1], along(leg, t, 2)[1]
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-9:
        x, y, z = _bend(leg, t, 0), _bend(leg, t, 1), _bend(leg, t, 2)
        length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-9:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@kernel
def _bend(leg: FloatArray, t: float, axis: int) -> float:
    """Return the second derivative by the parameter."""
    second: float = 2.0 * leg[HERMITE + 3 + axis] + 6.0 * t * leg[HERMITE + 6 + axis]
    return second


@kernel
def _limits(leg: FloatArray, s: FloatArray, t: float) -> tuple[float, float, float, float]:
    """Return first and second derivative along the curve, and the greatest speed and acceleration."""
    ux, uy, uz = direction(leg, t)
    bx, by, bz = _bend(leg, t, 0), _bend(leg, t, 1), _bend(leg, t, 2)
    derivative = 0.0
    left2 = 0.0
    for axis in range(3):
        place, first = along(leg, t, axis)
        derivative += first * first
        left2 += (along(leg, 1.0, axis)[0] - place) ** 2
    derivative = math.sqrt(derivative)
    tangential = bx * ux + by * uy + bz * uz
    nx, ny, nz = bx - tangential * ux, by - tangential * uy, bz - tangential * uz
    normal = math.sqrt(nx * nx + ny * ny + nz * nz)
    top = projected(ux, uy, uz, leg[TOP], leg[TOP_UP], leg[TOP_DOWN])
    if normal > 1e-9 and derivative > 1e-9:
        vertical = s[VERTICAL_ACCELERATION]
        turning = _SHARE * projected(nx / normal, ny / normal, nz / normal, s[ACCELERATION], vertical, vertical)
        top = min(top, derivative * math.sqrt(turning / normal))
    acceleration = _SHARE * projected(ux, uy, uz, s[ACCELERATION], s[VERTICAL_ACCELERATION], s[VERTICAL_ACCELERATION])
    braking = math.sqrt(2.0 * acceleration * math.sqrt(left2) + leg[TOP_END] ** 2)
    return derivative, tangential, min(top, braking), acceleration


@kernel
def projected(ux: float, uy: float, uz: float, horizontal: float, up: float, down: float) -> float:
    """Return the greatest speed (or acceleration) in a direction that keeps horizontal and vertical limits."""
    level = math.hypot(ux, uy)
    limit = math.inf
    if level > 1e-9:
        limit = horizontal / level
    if abs(uz) > 1e-9:
        limit = min(limit, (up if uz > 0.0 else down) / abs(uz))
    return limit
