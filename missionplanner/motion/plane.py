"""ArduPlane in AUTO: constant indicated airspeed, L1 guidance along the legs, waypoints accepted on the way.

Before a corner the waypoint is accepted at WP_RADIUS (or the L1 distance) times the turn over 90 degrees; in a straight
line it is flown over. Sources: https://ardupilot.org/plane/docs/navigation-tuning.html, S. Park, J. Deyst, J. P. How,
"A New Nonlinear Guidance Logic for Trajectory Tracking" (2004).
"""

from __future__ import annotations

import math

from missionplanner.motion.state import (
    ACCELERATION,
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
    ORIGIN,
    PHASE,
    POSITION,
    RADIUS,
    REACHED,
    SPEED,
    STARTING,
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

_STEP_S = 0.025
_L1_PERIOD_S = 17.0  # NAVL1_PERIOD
_L1_DAMPING = 0.75  # NAVL1_DAMPING
_ROLL_TIME_S = 0.5  # RLL2SRV_TCONST
_HEIGHT_TIME_S = 2.0  # how fast a height error is flown out


@kernel
def true_airspeed(alt_amsl_m: float) -> float:
    """Return true over indicated airspeed (the one that is commanded) in the standard atmosphere; 1 at sea level."""
    return max(1.0 - 2.25577e-5 * alt_amsl_m, 0.1) ** -2.128


@kernel
def step(s: FloatArray, k: IntArray, route: FloatArray, dt: float) -> None:
    """Advance by ``dt``; halted or done, it circles to the right."""
    if k[PHASE] == STARTING:
        k[PHASE] = FLYING
        for axis in range(3):
            s[ORIGIN + axis] = s[POSITION + axis]
    steps = round(dt / _STEP_S)
    h = dt / steps
    for _ in range(steps):
        w = min(k[WAYPOINT], k[COUNT] - 1)
        circling = k[HALTED] != 0 or k[PHASE] == IDLE
        lx = route[w, 0] - s[ORIGIN]
        ly = route[w, 1] - s[ORIGIN + 1]
        length_m = math.hypot(lx, ly)
        if length_m > 1e-6:
            lx, ly = lx / length_m, ly / length_m
        px = s[POSITION] - s[ORIGIN]
        py = s[POSITION + 1] - s[ORIGIN + 1]
        done_m = px * lx + py * ly
        speed = math.hypot(s[VELOCITY], s[VELOCITY + 1])
        reach_m = max(_L1_DAMPING * _L1_PERIOD_S * speed / math.pi, 1.0)

        course = math.atan2(s[VELOCITY + 1], s[VELOCITY]) if speed >= 1.0 else math.atan2(ly, lx)
        widest = speed * speed / max(s[TURN_RADIUS], 1.0)
        turn = -widest
        if not circling:
            right_m = px * ly - py * lx
            bend = math.asin(max(-0.7071, min(0.7071, right_m / reach_m)))
            eta = math.atan2(ly, lx) + bend - course
            eta = math.atan2(math.sin(eta), math.cos(eta))
            eta = max(-0.5 * math.pi, min(0.5 * math.pi, eta))
            turn = 4.0 * _L1_DAMPING * _L1_DAMPING * speed * speed / reach_m * math.sin(eta)
        turn = s[THRUST] + (turn - s[THRUST]) * min(1.0, h / _ROLL_TIME_S)
        s[THRUST] = max(-widest, min(widest, turn))
        if speed >= 1.0:
            course += s[THRUST] / speed * h
        wanted = route[w, SPEED] * true_airspeed(s[POSITION + 2])
        speed += max(-s[ACCELERATION] * h, min(s[ACCELERATION] * h, wanted - speed))
        s[VELOCITY] = speed * math.cos(course)
        s[VELOCITY + 1] = speed * math.sin(course)

        climb = (route[w, 2] - s[POSITION + 2]) / _HEIGHT_TIME_S
        if length_m > 1e-6 and not circling and done_m < length_m:
            slope = (route[w, 2] - s[ORIGIN + 2]) / length_m
            climb = slope * speed + (s[ORIGIN + 2] + slope * max(done_m, 0.0) - s[POSITION + 2]) / _HEIGHT_TIME_S
        climb = max(-min(s[DESCENT], route[w, VERTICAL]), min(s[CLIMB], route[w, VERTICAL], climb))
        change = s[VERTICAL_ACCELERATION] * h
        s[VELOCITY + 2] += max(-change, min(change, climb - s[VELOCITY + 2]))
        for axis in range(3):
            s[POSITION + axis] += s[VELOCITY + axis] * h
        s[ELAPSED] += h
        if not circling:
            _accept_waypoint(s, k, route, h, min(s[RADIUS], reach_m))


@kernel
def _accept_waypoint(s: FloatArray, k: IntArray, route: FloatArray, h: float, radius_m: float) -> None:
    """Accept the waypoint within its turn's distance, or once it is abeam; a hold is flown on along the leg."""
    w = k[WAYPOINT]
    if k[PHASE] == HOLDING:
        s[HOLD_LEFT] -= h
        if s[HOLD_LEFT] > 1e-9:
            return
    else:
        lx = route[w, 0] - s[ORIGIN]
        ly = route[w, 1] - s[ORIGIN + 1]
        if w + 1 < k[COUNT]:
            nx = route[w + 1, 0] - route[w, 0]
            ny = route[w + 1, 1] - route[w, 1]
            turn = abs(math.atan2(lx * ny - ly * nx, lx * nx + ly * ny))
            radius_m *= min(1.0, turn / (0.5 * math.pi))
        dx = route[w, 0] - s[POSITION]
        dy = route[w, 1] - s[POSITION + 1]
        if math.hypot(dx, dy) > radius_m and dx * lx + dy * ly > 0.0:
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
