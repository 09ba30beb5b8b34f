"""ArduPlane in AUTO: constant indicated airspeed, L1 guidance along legs and circles, waypoints accepted on the way.

Before a corner the waypoint is accepted at WP_RADIUS (or the L1 distance) times the turn over 90 degrees; in a straight
line it is flown over. A plane never stands: after its last waypoint it circles there, and halted, where it was.
Sources: https://ardupilot.org/plane/docs/navigation-tuning.html; S. Park, J. Deyst, J. P. How, "A New Nonlinear
Guidance Logic for Trajectory Tracking" (2004); AP_L1_Control of ArduPilot 4.5 for the circle; recorded flights for the
take-off.
"""

from __future__ import annotations

import math

from missionplanner.motion.state import (
    ACCELERATION,
    BRAKED,
    BY_ALTITUDE,
    CLIMB,
    COUNT,
    DESCENT,
    ELAPSED,
    FLYING,
    HALTED,
    HOLD,
    HOLD_LEFT,
    HOLDING,
    IDLE,
    LOITER_RADIUS,
    ORIGIN,
    PHASE,
    POSITION,
    RADIUS,
    REACHED,
    SPEED,
    STARTING,
    TARGET,
    THRUST,
    TURN_RADIUS,
    VELOCITY,
    VERTICAL,
    VERTICAL_ACCELERATION,
    WAYPOINT,
    FloatArray,
    IntArray,
    kernel,
)
from missionplanner.vehicle import LIFT_OFF_SHARE, TAKEOFF_ACCELERATION_M_S2, true_airspeed

_STEP_S = 0.025
_L1_PERIOD_S = 17.0  # NAVL1_PERIOD
_L1_DAMPING = 0.75  # NAVL1_DAMPING
_ROLL_TIME_S = 0.5  # RLL2SRV_TCONST
_HEIGHT_TIME_S = 2.0  # how fast a height error is flown out
_AT_ALTITUDE_M = 0.3
_POINT_M = 1e-6  # a shorter leg has no direction

_true_airspeed = kernel(true_airspeed)


@kernel
def step(s: FloatArray, k: IntArray, route: FloatArray, dt: float) -> None:
    """Advance by ``dt``; halted or done, it circles to the right."""
    if k[PHASE] == STARTING:
        k[PHASE] = FLYING
        for axis in range(3):
            s[ORIGIN + axis] = s[POSITION + axis]
    _note_centre(s, k, route)
    steps = round(dt / _STEP_S)
    h = dt / steps
    for _ in range(steps):
        w = min(k[WAYPOINT], k[COUNT] - 1)
        circling = k[HALTED] != 0 or k[PHASE] == IDLE
        speed = math.hypot(s[VELOCITY], s[VELOCITY + 1])
        reach_m = max(_L1_DAMPING * _L1_PERIOD_S * speed / math.pi, 1.0)
        wanted = route[w, SPEED] * _true_airspeed(s[POSITION + 2])
        rolling = not circling and route[w, BY_ALTITUDE] > 0.0 and speed < LIFT_OFF_SHARE * wanted

        course = math.atan2(s[VELOCITY + 1], s[VELOCITY])
        bearing = course
        if math.hypot(route[w, 0] - s[ORIGIN], route[w, 1] - s[ORIGIN + 1]) > _POINT_M:
            bearing = math.atan2(route[w, 1] - s[ORIGIN + 1], route[w, 0] - s[ORIGIN])
        course = course if speed >= 1.0 else bearing
        turn = _turn_to_circle(s, speed, reach_m) if circling else _turn_to_leg(s, bearing, course, speed, reach_m)
        turn = s[THRUST] + (turn - s[THRUST]) * min(1.0, h / _ROLL_TIME_S)
        widest = speed * speed / max(s[TURN_RADIUS], 1.0)
        s[THRUST] = max(-widest, min(widest, turn))
        if speed >= 1.0:
            course += s[THRUST] / speed * h
        acceleration = TAKEOFF_ACCELERATION_M_S2 if rolling else s[ACCELERATION]
        speed += max(-acceleration * h, min(acceleration * h, wanted - speed))
        s[VELOCITY] = speed * math.cos(course)
        s[VELOCITY + 1] = speed * math.sin(course)

        climb = 0.0
        if circling:
            climb = (s[TARGET + 2] - s[POSITION + 2]) / _HEIGHT_TIME_S
        elif not rolling:
            climb = _climb_along_leg(s, route, w, speed)
        climb = max(-min(s[DESCENT], route[w, VERTICAL]), min(s[CLIMB], route[w, VERTICAL], climb))
        change = s[VERTICAL_ACCELERATION] * h
        s[VELOCITY + 2] += max(-change, min(change, climb - s[VELOCITY + 2]))
        for axis in range(3):
            s[POSITION + axis] += s[VELOCITY + axis] * h
        s[ELAPSED] += h
        if not circling:
            _accept_waypoint(s, k, route, h, min(s[RADIUS], reach_m))


@kernel
def _note_centre(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Remember what to circle around: the last waypoint, or the place where it was halted."""
    if k[PHASE] == IDLE:
        for axis in range(3):
            s[TARGET + axis] = route[k[COUNT] - 1, axis]
    elif k[HALTED] != 0 and s[BRAKED] == 0.0:
        for axis in range(3):
            s[TARGET + axis] = s[POSITION + axis]
    s[BRAKED] = 1.0 if k[HALTED] != 0 else 0.0


@kernel
def _turn_to_leg(s: FloatArray, bearing: float, course: float, speed: float, reach_m: float) -> float:
    """Return the lateral acceleration (to the left) towards the point of the leg that lies ``reach_m`` away."""
    px = s[POSITION] - s[ORIGIN]
    py = s[POSITION + 1] - s[ORIGIN + 1]
    right_m = px * math.sin(bearing) - py * math.cos(bearing)
    bend = math.asin(max(-0.7071, min(0.7071, right_m / reach_m)))
    eta = bearing + bend - course
    eta = math.atan2(math.sin(eta), math.cos(eta))
    eta = max(-0.5 * math.pi, min(0.5 * math.pi, eta))
    return 4.0 * _L1_DAMPING * _L1_DAMPING * speed * speed / reach_m * math.sin(eta)


@kernel
def _turn_to_circle(s: FloatArray, speed: float, reach_m: float) -> float:
    """Return the lateral acceleration (to the left) onto the circle to the right around the target, and along it."""
    rx = s[POSITION] - s[TARGET]
    ry = s[POSITION + 1] - s[TARGET + 1]
    away_m = math.hypot(rx, ry)
    if away_m > 0.1:
        rx, ry = rx / away_m, ry / away_m
    elif speed > 0.0:
        rx, ry = s[VELOCITY] / speed, s[VELOCITY + 1] / speed
    outward = s[VELOCITY] * rx + s[VELOCITY + 1] * ry
    around = s[VELOCITY] * ry - s[VELOCITY + 1] * rx  # clockwise
    eta = max(-0.5 * math.pi, min(0.5 * math.pi, math.atan2(around, -outward)))
    capture = 4.0 * _L1_DAMPING * _L1_DAMPING * speed * speed / reach_m * math.sin(eta)

    radius_m = s[LOITER_RADIUS]
    omega = 2.0 * math.pi / _L1_PERIOD_S
    back = (away_m - radius_m) * omega * omega + outward * 2.0 * _L1_DAMPING * omega
    if outward > 0.0 and around < 0.0:  # flying the wrong way: do not turn further into it
        back = max(back, 0.0)
    circle = back + around * around / max(0.5 * radius_m, away_m)
    return -capture if away_m > radius_m and capture < circle else -circle


@kernel
def _climb_along_leg(s: FloatArray, route: FloatArray, w: int, speed: float) -> float:
    """Return the rate that holds the leg's slope; past its end, the one to its altitude; on take-off, the greatest."""
    lx = route[w, 0] - s[ORIGIN]
    ly = route[w, 1] - s[ORIGIN + 1]
    length_m = math.hypot(lx, ly)
    up_m = route[w, 2] - s[ORIGIN + 2]
    done_m = 0.0
    if route[w, BY_ALTITUDE] > 0.0 and up_m > 0.0:
        return s[CLIMB]
    if length_m > _POINT_M:
        done_m = ((s[POSITION] - s[ORIGIN]) * lx + (s[POSITION + 1] - s[ORIGIN + 1]) * ly) / length_m
    if length_m <= _POINT_M or done_m >= length_m:
        return (route[w, 2] - s[POSITION + 2]) / _HEIGHT_TIME_S
    slope = up_m / length_m
    return slope * speed + (s[ORIGIN + 2] + slope * max(done_m, 0.0) - s[POSITION + 2]) / _HEIGHT_TIME_S


@kernel
def _accept_waypoint(s: FloatArray, k: IntArray, route: FloatArray, h: float, radius_m: float) -> None:
    """Accept the waypoint within its turn's distance, or once it is abeam; a hold is flown on along the leg."""
    w = k[WAYPOINT]
    if k[PHASE] == HOLDING:
        s[HOLD_LEFT] -= h
        if s[HOLD_LEFT] > 1e-9:
            return
    else:
        if not _reached(s, k, route, radius_m):
            return
        route[w, REACHED] = s[ELAPSED]
        if route[w, HOLD] > 0.0:
            k[PHASE] = HOLDING
            s[HOLD_LEFT] = route[w, HOLD]
            return
    k[PHASE] = FLYING
    k[WAYPOINT] = w + 1
    for axis in range(3):
        s[ORIGIN + axis] = route[w, axis]
    if w + 1 == k[COUNT]:
        k[PHASE] = IDLE
        _note_centre(s, k, route)


@kernel
def _reached(s: FloatArray, k: IntArray, route: FloatArray, radius_m: float) -> bool:
    """Whether the waypoint is reached: by altitude, where it asks for that, or else across the ground."""
    w = k[WAYPOINT]
    if route[w, BY_ALTITUDE] > 0.0:
        left_m = route[w, 2] - s[POSITION + 2]
        return left_m * math.copysign(1.0, route[w, 2] - s[ORIGIN + 2]) <= _AT_ALTITUDE_M
    lx = route[w, 0] - s[ORIGIN]
    ly = route[w, 1] - s[ORIGIN + 1]
    if w + 1 < k[COUNT]:
        nx = route[w + 1, 0] - route[w, 0]
        ny = route[w + 1, 1] - route[w, 1]
        turn = abs(math.atan2(lx * ny - ly * nx, lx * nx + ly * ny))
        radius_m *= min(1.0, turn / (0.5 * math.pi))
    dx = route[w, 0] - s[POSITION]
    dy = route[w, 1] - s[POSITION + 1]
    return math.hypot(dx, dy) <= radius_m or dx * lx + dy * ly <= 0.0
