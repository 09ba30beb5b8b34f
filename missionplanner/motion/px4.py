"""PX4 multicopter in AUTO (PositionSmoothing, VelocitySmoothing): a velocity towards the waypoint, limited in jerk.

The speed is the one from which the vehicle can still brake to the speed of the corner ahead (a circle tangent to both
legs within the acceptance radius). The trajectory waits, up to standing still, while the vehicle is up to
MPC_XY_ERR_MAX behind. Source: https://docs.px4.io/main/en/config_mc/mc_jerk_limited_type_trajectory.html.
"""

from __future__ import annotations

import math

import numpy as np

from missionplanner.motion.airframe import follow_target
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
    JERK,
    ORIGIN,
    PHASE,
    POSITION,
    RADIUS,
    REACHED,
    SPEED,
    STARTING,
    TARGET,
    TARGET_ACCELERATION,
    TARGET_VELOCITY,
    TURN_SPEED,
    VERTICAL,
    VERTICAL_ACCELERATION,
    WAYPOINT,
    FloatArray,
    IntArray,
    kernel,
)

_STEP_S = 0.025
_CORNER_GAIN = 0.5  # MPC_XY_TRAJ_P: share of the acceleration that corners are planned with
_ALTITUDE_RADIUS_M = 0.8  # NAV_MC_ALT_RAD
_LAG_MAX_M = 2.0  # MPC_XY_ERR_MAX
_CRAWL_M_S = 0.5


@kernel
def step(s: FloatArray, k: IntArray, route: FloatArray, dt: float) -> None:
    """Advance by ``dt``."""
    if k[PHASE] == STARTING:
        k[PHASE] = FLYING
        s[TURN_SPEED] = math.inf
        for axis in range(3):
            s[ORIGIN + axis] = s[TARGET + axis]
    wanted = np.zeros(3)
    steps = round(dt / _STEP_S)
    h = dt / steps
    for _ in range(steps):
        if k[HALTED] == 0:
            _velocity_wanted(s, k, route, wanted)
        else:
            wanted[:] = 0.0
        _move_target(s, wanted, h * _share(s))
        follow_target(s, h)
        s[ELAPSED] += h
        if k[PHASE] != IDLE and k[HALTED] == 0:
            _accept_waypoint(s, k, route, h)


@kernel
def _share(s: FloatArray) -> float:
    """Return how fast the trajectory's clock runs: slower, the further the vehicle is behind."""
    dx = s[TARGET] - s[POSITION]
    dy = s[TARGET + 1] - s[POSITION + 1]
    if dx * s[TARGET_VELOCITY] + dy * s[TARGET_VELOCITY + 1] < 0.0:
        return 1.0
    return 1.0 - min(1.0, math.hypot(dx, dy) / _LAG_MAX_M)


@kernel
def _accept_waypoint(s: FloatArray, k: IntArray, route: FloatArray, h: float) -> None:
    """Accept the waypoint inside its radius and height band; hold; go on."""
    w = k[WAYPOINT]
    if k[PHASE] == FLYING:
        away_m = math.hypot(route[w, 0] - s[POSITION], route[w, 1] - s[POSITION + 1])
        if away_m > s[RADIUS] or abs(route[w, 2] - s[POSITION + 2]) > _ALTITUDE_RADIUS_M:
            return
        route[w, REACHED] = s[ELAPSED]
        k[PHASE] = HOLDING
        s[HOLD_LEFT] = route[w, HOLD]
    else:
        s[HOLD_LEFT] -= h
    if s[HOLD_LEFT] <= 1e-9:
        k[WAYPOINT] = w + 1
        k[PHASE] = FLYING
        if w + 1 == k[COUNT]:
            k[PHASE] = IDLE
        else:
            for axis in range(3):
                s[ORIGIN + axis] = route[w, axis]


@kernel
def _speed_to_brake(jerk: float, acceleration: float, distance_m: float, final_m_s: float) -> float:
    """Return the speed from which ``final_m_s`` can still be reached within a distance."""
    b = 4.0 * acceleration * acceleration / jerk
    c = -2.0 * acceleration * distance_m - final_m_s * final_m_s
    return max(0.5 * (-b + math.sqrt(b * b - 4.0 * c)), final_m_s)


@kernel
def _corner_speed(cosine: float, acceleration: float, radius_m: float) -> float:
    """Return the speed of a circle tangent to two legs within a radius; ``cosine`` of the angle between the legs."""
    half = 0.5 * min(math.acos(min(1.0, max(-1.0, cosine))), math.pi - 1e-7)
    return math.sqrt(acceleration * radius_m * math.tan(half))


@kernel
def _velocity_wanted(s: FloatArray, k: IntArray, route: FloatArray, wanted: FloatArray) -> None:
    """Write the velocity (3,) towards the present waypoint that corners and stops allow."""
    last = k[COUNT] - 1
    w = min(k[WAYPOINT], last)
    after = w if w == last or route[w, HOLD] > 0.0 else w + 1
    dx = route[w, 0] - s[TARGET]
    dy = route[w, 1] - s[TARGET + 1]
    dz = route[w, 2] - s[TARGET + 2]
    nx = route[w, 0] - route[after, 0]
    ny = route[w, 1] - route[after, 1]
    nz = route[w, 2] - route[after, 2]
    level_m = math.hypot(dx, dy)
    after_m = math.hypot(nx, ny)
    cruise = route[w, SPEED]
    corner = 0.0
    if after_m > 1e-3 and after_m >= s[RADIUS] and level_m > 0.0:
        exit_m_s = _speed_to_brake(s[JERK], s[ACCELERATION], after_m, 0.0)
        cosine = (dx * nx + dy * ny) / (level_m * after_m)
        corner = min(_corner_speed(cosine, _CORNER_GAIN * s[ACCELERATION], s[RADIUS]), exit_m_s, cruise)
    speed_xy = min(cruise, _speed_to_brake(s[JERK], s[ACCELERATION], level_m, corner))

    top_z = min(s[CLIMB] if dz > 0.0 else s[DESCENT], route[w, VERTICAL])
    arrive_z = 0.0
    if abs(nz) > 1e-3:
        norm = math.hypot(level_m, dz) * math.hypot(after_m, nz)
        cosine = (dz * nz - level_m * after_m) / norm if norm > 0.0 else 1.0
        arrive_z = min(_corner_speed(cosine, s[VERTICAL_ACCELERATION], _ALTITUDE_RADIUS_M), top_z)
    speed_z = min(top_z, _speed_to_brake(s[JERK], s[VERTICAL_ACCELERATION], abs(dz), arrive_z))

    speed = math.hypot(s[TARGET_VELOCITY], s[TARGET_VELOCITY + 1])
    towards = s[TARGET_VELOCITY] * dx + s[TARGET_VELOCITY + 1] * dy
    if speed > 0.2 and level_m > s[RADIUS] and towards < 0.98 * speed * level_m:  # turning: aim along the leg
        lx = route[w, 0] - s[ORIGIN]
        ly = route[w, 1] - s[ORIGIN + 1]
        lz = route[w, 2] - s[ORIGIN + 2]
        length = math.sqrt(lx * lx + ly * ly + lz * lz)
        if length > 0.0:
            lx, ly, lz = lx / length, ly / length, lz / length
            px = s[TARGET] - s[ORIGIN]
            py = s[TARGET + 1] - s[ORIGIN + 1]
            pz = s[TARGET + 2] - s[ORIGIN + 2]
            done = px * lx + py * ly + pz * lz
            if done <= length:  # beyond, it has missed the waypoint and turns back to it
                off2 = (done * lx - px) ** 2 + (done * ly - py) ** 2 + (done * lz - pz) ** 2
                ahead = done + math.sqrt(max(max(s[RADIUS], 5.0) ** 2 - off2, 0.0))
                dx, dy, dz = ahead * lx - px, ahead * ly - py, ahead * lz - pz
        speed_xy = min(speed_xy, s[TURN_SPEED])
    else:
        s[TURN_SPEED] = speed_xy
    norm = math.sqrt(dx * dx + dy * dy + dz * dz)
    scale = math.hypot(speed_xy, speed_z) / norm if norm > 1e-9 else 0.0
    wanted[0], wanted[1], wanted[2] = dx * scale, dy * scale, dz * scale
    level_m_s = math.hypot(wanted[0], wanted[1])
    if level_m_s > speed_xy:  # along the leg, except for the last crawl, where one axis must not stop the others
        wanted[0] *= speed_xy / level_m_s
        wanted[1] *= speed_xy / level_m_s
        if level_m_s >= _CRAWL_M_S or speed_xy >= _CRAWL_M_S:
            wanted[2] *= speed_xy / level_m_s
    rate_m_s = abs(wanted[2])
    if rate_m_s > speed_z:
        wanted[2] *= speed_z / rate_m_s
        if rate_m_s >= _CRAWL_M_S or speed_z >= _CRAWL_M_S:
            wanted[0] *= speed_z / rate_m_s
            wanted[1] *= speed_z / rate_m_s


@kernel
def _move_target(s: FloatArray, wanted: FloatArray, h: float) -> None:
    """Move the trajectory by ``h``: every axis towards its velocity with limited jerk, all in the same time."""
    longest_s = 0.0
    for axis in range(3):
        t1, t2, t3, _ = _axis_times(s, axis, wanted[axis], 0.0)
        longest_s = max(longest_s, t1 + t2 + t3)
    for axis in range(3):
        t1, t2, t3, direction = _axis_times(s, axis, wanted[axis], longest_s)
        left = h
        for part in range(3):
            t = min(left, t1 if part == 0 else t2 if part == 1 else t3)
            j = direction * s[JERK] * (1 - part)
            a = s[TARGET_ACCELERATION + axis]
            v = s[TARGET_VELOCITY + axis]
            s[TARGET + axis] += t * (v + t * (0.5 * a + j * t / 6.0))
            s[TARGET_VELOCITY + axis] = v + t * (a + 0.5 * j * t)
            s[TARGET_ACCELERATION + axis] = a + j * t
            left -= t
        if left > 0.0:
            s[TARGET_ACCELERATION + axis] = 0.0
            s[TARGET + axis] += left * s[TARGET_VELOCITY + axis]


@kernel
def _axis_times(s: FloatArray, axis: int, wanted: float, total_s: float) -> tuple[float, float, float, float]:
    """Return times at full jerk, none and full opposite jerk that bring one axis to a velocity, and the first's sign.

    In the least time, or in ``total_s`` if that is longer.
    """
    a0 = s[TARGET_ACCELERATION + axis]
    dv = wanted - s[TARGET_VELOCITY + axis]
    a_max = s[VERTICAL_ACCELERATION] if axis == 2 else s[ACCELERATION]
    excess = dv - 0.5 * a0 * abs(a0) / s[JERK]
    direction = math.copysign(1.0, excess if excess != 0.0 else a0)
    if excess == 0.0 and a0 == 0.0:
        return 0.0, 0.0, 0.0, direction
    j = direction * s[JERK]
    root = 0.5 * math.sqrt(max(2.0 * a0 * a0 + 4.0 * j * dv, 0.0))
    t1 = _first_time((-a0 + root) / j, (-a0 - root) / j, a0, j, a_max, math.inf)
    t3 = max(a0 / j + t1, 0.0)
    top = a0 + j * t1
    t2 = 0.0
    if abs(top) > 1e-9:
        t2 = max((dv - t1 * (a0 + 0.5 * j * t1) - t3 * (top - 0.5 * j * t3)) / top, 0.0)
    if t1 + t2 + t3 >= total_s:
        return t1, t2, t3, direction
    delta = (total_s * j) ** 2 + 2.0 * total_s * a0 * j - a0 * a0 - 4.0 * j * dv
    if delta < 0.0:
        t1 = _first_time(0.0, 0.0, a0, j, a_max, total_s)
    else:
        b = j * total_s - a0
        root = math.sqrt(delta)
        t1 = _first_time(max((b - root) / (2.0 * j), 0.0), max((b + root) / (2.0 * j), 0.0), a0, j, a_max, total_s)
    t3 = max(a0 / j + t1, 0.0)
    return t1, max(total_s - t1 - t3, 0.0), t3, direction


@kernel
def _first_time(one: float, other: float, a0: float, j: float, a_max: float, total_s: float) -> float:
    """Return the first of two times at full jerk that is possible, cut where the greatest acceleration is reached."""
    t1 = 0.0
    if one >= 0.0 and a0 / j + one >= 0.0 and a0 / j + 2.0 * one <= total_s:
        t1 = one
    elif other >= 0.0 and a0 / j + other >= 0.0 and a0 / j + 2.0 * other <= total_s:
        t1 = other
    return max(min(t1, (math.copysign(a_max, j) - a0) / j), 0.0)
