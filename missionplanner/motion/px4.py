"""PX4 multicopter in AUTO: a velocity towards the waypoint, limited in jerk, that the vehicle follows.

FlightTaskAuto, PositionSmoothing and VelocitySmoothing of PX4 1.15. The speed is the one from which the vehicle can
still brake to the speed of the corner ahead (a circle tangent to both legs within the acceptance radius). In a turn it
aims at its leg 5 m ahead, but straight for the height of the waypoint: a steep leg is begun nearly on the spot. A
vehicle further from its leg than the acceptance radius first returns to the leg, and one before its beginning to that.
The trajectory waits, up to standing still, while the vehicle is up to MPC_XY_ERR_MAX behind.
Source: https://docs.px4.io/main/en/config_mc/mc_jerk_limited_type_trajectory.html.
"""

from __future__ import annotations

import math

from missionplanner.motion.px4_airframe import follow_target
from missionplanner.motion.state import (
    ACCELERATION,
    AFTER,
    AIM,
    ALTITUDE_RADIUS,
    BEFORE,
    BY_ALTITUDE,
    CLIMB,
    CLIMB_ACCELERATION,
    CORNER_GAIN,
    COUNT,
    CRAWL,
    CRAWL_BELOW,
    DESCENT,
    DESCENT_ACCELERATION,
    ELAPSED,
    FLYING,
    GROUND,
    HALTED,
    HOLD,
    HOLD_LEFT,
    HOLDING,
    HOVER,
    HOVER_GAIN,
    IDLE,
    INTEGRAL,
    JERK,
    LAG_MAX,
    LAND_BELOW,
    LAND_SPEED,
    LIFT,
    ORIGIN,
    PHASE,
    POSITION,
    RADIUS,
    RAMP,
    REACHED,
    SLOW_BELOW,
    SPEED,
    SPEED_MAX,
    STARTING,
    TAKEOFF_RAMP,
    TAKEOFF_SPEED,
    TARGET,
    TARGET_ACCELERATION,
    TARGET_VELOCITY,
    TRACK,
    TURN_SPEED,
    VELOCITY,
    VERTICAL,
    VERTICAL_ACCELERATION,
    VERTICAL_VELOCITY_GAIN,
    WANTED,
    WAYPOINT,
    FloatArray,
    IntArray,
    kernel,
)

_STEP_S = 0.025  # of the trajectory; the autopilot's is 20 ms
_CONTROLS = 2  # steps of the controllers per step of the trajectory, as the autopilot's
_CRAWL_M_S = 0.5
_LOOK_AHEAD_M = 5.0
_GRAVITY_M_S2 = 9.80665
_SINK_M_S = 0.7  # the velocity that the trajectory is reset to on the ground
_UNKNOWN, _ON_TRACK, _TARGET_BEHIND, _BEGINNING_AHEAD, _OFF_TRACK = range(5)


@kernel
def step(s: FloatArray, k: IntArray, route: FloatArray, dt: float) -> None:
    """Advance by ``dt``: the navigator looks at the vehicle once, trajectory and controllers run finer."""
    if k[PHASE] == STARTING:
        k[PHASE] = FLYING
        s[TURN_SPEED] = math.inf
        if not _is_at(s, s[ORIGIN], s[ORIGIN + 1], s[ORIGIN + 2]):  # else: where the last route has ended
            for axis in range(3):
                s[ORIGIN + axis] = s[TARGET + axis]
        _begin_leg(s, k, route)
    steps = round(dt / _STEP_S)
    h = dt / steps
    for _ in range(steps):
        _move_target(s, h * _share(s))
        for _ in range(_CONTROLS):
            follow_target(s, h / _CONTROLS, _rise_max(s, h / _CONTROLS))
        _want_velocity(s, k, route)
    s[ELAPSED] += dt
    if k[PHASE] != IDLE and k[HALTED] == 0:
        _accept_waypoint(s, k, route, dt)


@kernel
def _share(s: FloatArray) -> float:
    """Return how fast the trajectory's clock runs: slower, the further the vehicle is behind."""
    dx = s[TARGET] - s[POSITION]
    dy = s[TARGET + 1] - s[POSITION + 1]
    if dx * s[TARGET_VELOCITY] + dy * s[TARGET_VELOCITY + 1] < 0.0:
        return 1.0
    return 1.0 - min(1.0, math.hypot(dx, dy) / s[LAG_MAX])


@kernel
def _rise_max(s: FloatArray, h: float) -> float:
    """Return the greatest rate of climb: on take-off a ramp from no thrust at all."""
    if s[RAMP] >= s[TAKEOFF_RAMP]:
        return s[CLIMB]
    s[RAMP] += h
    least = -_GRAVITY_M_S2 / s[VERTICAL_VELOCITY_GAIN]
    return least + min(1.0, s[RAMP] / s[TAKEOFF_RAMP]) * (s[CLIMB] - least)


@kernel
def _is_at(s: FloatArray, x: float, y: float, z: float) -> bool:
    """Return whether the vehicle is within its acceptance radius and height band of a point."""
    away_m = math.hypot(x - s[POSITION], y - s[POSITION + 1])
    return away_m <= s[RADIUS] and abs(z - s[POSITION + 2]) <= s[ALTITUDE_RADIUS]


@kernel
def _accept_waypoint(s: FloatArray, k: IntArray, route: FloatArray, dt: float) -> None:
    """Accept the waypoint, a take-off's by its height alone, a landing's on the ground; hold; go on."""
    w = k[WAYPOINT]
    if k[PHASE] == FLYING:
        if route[w, BY_ALTITUDE] == 0.0:
            if not _is_at(s, route[w, 0], route[w, 1], route[w, 2]):
                return
        elif s[GROUND] < route[w, 2]:
            if s[POSITION + 2] < route[w, 2] - s[ALTITUDE_RADIUS]:
                return
        elif s[POSITION + 2] > s[GROUND]:
            return
        else:
            _come_to_rest(s)
        route[w, REACHED] = s[ELAPSED]
        k[PHASE] = HOLDING
        s[HOLD_LEFT] = route[w, HOLD]
    else:
        s[HOLD_LEFT] -= dt
    if s[HOLD_LEFT] <= 1e-9:
        k[WAYPOINT] = w + 1
        k[PHASE] = FLYING
        for axis in range(3):
            s[ORIGIN + axis] = route[w, axis]
        if w + 1 == k[COUNT]:
            k[PHASE] = IDLE
        else:
            _begin_leg(s, k, route)


@kernel
def _come_to_rest(s: FloatArray) -> None:
    """Forget all vertical motion: the vehicle stands on the ground."""
    s[TARGET + 2] = s[POSITION + 2] = s[GROUND]
    s[TARGET_VELOCITY + 2] = s[TARGET_ACCELERATION + 2] = s[VELOCITY + 2] = 0.0
    s[LIFT] = s[INTEGRAL + 2] = 0.0


@kernel
def _begin_leg(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Forget the points of the leg before; know the ground of a take-off or landing."""
    w = k[WAYPOINT]
    k[TRACK] = _UNKNOWN
    s[GROUND] = -math.inf
    s[RAMP] = math.inf
    if route[w, BY_ALTITUDE] == 0.0:
        return
    s[GROUND] = min(s[ORIGIN + 2], route[w, 2])
    if s[GROUND] < route[w, 2] and s[POSITION + 2] <= s[GROUND]:
        s[RAMP] = 0.0
        s[LIFT] = -_GRAVITY_M_S2
        s[HOVER], s[HOVER_GAIN] = 1.02, 400.0
        s[TARGET_VELOCITY + 2] = -_SINK_M_S
        s[TARGET_ACCELERATION + 2] = s[INTEGRAL + 2] = 0.0


@kernel
def _choose_points(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Write the points before, at and after the one to aim at: the leg's, unless the vehicle has strayed from it."""
    last = k[COUNT] - 1
    w = min(k[WAYPOINT], last)
    after = w if w == last or route[w, HOLD] > 0.0 else w + 1
    lx = route[w, 0] - s[ORIGIN]
    ly = route[w, 1] - s[ORIGIN + 1]
    length = math.hypot(lx, ly)
    done, track = 0.0, _ON_TRACK
    if length > 1e-6:
        lx, ly = lx / length, ly / length
        px = s[POSITION] - s[ORIGIN]
        py = s[POSITION + 1] - s[ORIGIN + 1]
        done = px * lx + py * ly
        if done > length:
            track = _TARGET_BEHIND
        elif done < 0.0 and math.hypot(px, py) > s[RADIUS]:
            track = _BEGINNING_AHEAD
        elif abs(px * ly - py * lx) > s[RADIUS]:
            track = _OFF_TRACK
    if track == k[TRACK] and track != _OFF_TRACK:
        return
    k[TRACK] = track
    for axis in range(3):
        if track == _ON_TRACK:
            s[BEFORE + axis] = s[ORIGIN + axis]
        else:
            s[BEFORE + axis] = s[POSITION + axis]
        s[AIM + axis] = route[w, axis]
        s[AFTER + axis] = route[after, axis]
        if track == _BEGINNING_AHEAD:
            s[AIM + axis] = s[ORIGIN + axis]
            s[AFTER + axis] = route[w, axis]
    if track == _OFF_TRACK:
        s[AIM] = s[ORIGIN] + done * lx
        s[AIM + 1] = s[ORIGIN + 1] + done * ly
        for axis in range(3):
            s[AFTER + axis] = route[w, axis]


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
def _want_velocity(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Write the velocity (3,) towards the present waypoint that corners and stops allow."""
    for axis in range(3):
        s[WANTED + axis] = 0.0
    if k[HALTED] != 0:
        return
    _choose_points(s, k, route)
    w = min(k[WAYPOINT], k[COUNT] - 1)
    dx = s[AIM] - s[TARGET]
    dy = s[AIM + 1] - s[TARGET + 1]
    dz = s[AIM + 2] - s[TARGET + 2]
    nx = s[AIM] - s[AFTER]
    ny = s[AIM + 1] - s[AFTER + 1]
    level_m = math.hypot(dx, dy)
    after_m = math.hypot(nx, ny)
    cruise = min(route[w, SPEED], s[SPEED_MAX])
    corner = 0.0
    flat = max(abs(dz), abs(s[AIM + 2] - s[AFTER + 2])) < s[ALTITUDE_RADIUS]  # it stops where its height changes
    if flat and after_m > 1e-3 and after_m >= s[RADIUS] and level_m > 0.0:
        exit_m_s = _speed_to_brake(s[JERK], s[ACCELERATION], after_m, 0.0)
        cosine = (dx * nx + dy * ny) / (level_m * after_m)
        corner = min(_corner_speed(cosine, s[CORNER_GAIN] * s[ACCELERATION], s[RADIUS]), exit_m_s, cruise)
    speed_xy = min(cruise, _speed_to_brake(s[JERK], s[ACCELERATION], level_m, corner))

    top_z = s[CLIMB] if dz > 0.0 else s[DESCENT]
    s[VERTICAL_ACCELERATION] = s[CLIMB_ACCELERATION] if dz > 0.0 else s[DESCENT_ACCELERATION]
    if route[w, BY_ALTITUDE] != 0.0 and dz > 0.0 and s[POSITION + 2] - s[GROUND] < s[SLOW_BELOW]:
        top_z = min(top_z, s[TAKEOFF_SPEED])
        s[VERTICAL_ACCELERATION] = min(s[CLIMB_ACCELERATION], s[TAKEOFF_SPEED] / s[TAKEOFF_RAMP])
        s[TARGET + 2] = s[POSITION + 2]
        dz = s[AIM + 2] - s[TARGET + 2]
    top_z = min(top_z, route[w, VERTICAL])
    speed_z = min(top_z, _speed_to_brake(s[JERK], s[VERTICAL_ACCELERATION], abs(dz), 0.0))

    speed = math.hypot(s[TARGET_VELOCITY], s[TARGET_VELOCITY + 1])
    towards = s[TARGET_VELOCITY] * dx + s[TARGET_VELOCITY + 1] * dy
    if speed > 0.2 and level_m > s[RADIUS] and towards < 0.98 * speed * level_m:  # turning: aim along the leg
        lx = s[AIM] - s[BEFORE]
        ly = s[AIM + 1] - s[BEFORE + 1]
        lz = s[AIM + 2] - s[BEFORE + 2]
        length = math.sqrt(lx * lx + ly * ly + lz * lz)
        if length > 0.0:
            lx, ly, lz = lx / length, ly / length, lz / length
        px = s[TARGET] - s[BEFORE]
        py = s[TARGET + 1] - s[BEFORE + 1]
        pz = s[TARGET + 2] - s[BEFORE + 2]
        done = px * lx + py * ly + pz * lz
        off2 = (done * lx - px) ** 2 + (done * ly - py) ** 2 + (done * lz - pz) ** 2
        done += math.sqrt(max(max(s[RADIUS], _LOOK_AHEAD_M) ** 2 - off2, 0.0))
        dx, dy, dz = done * lx - px, done * ly - py, done * lz - pz
        speed_xy = min(speed_xy, s[TURN_SPEED])
    else:
        s[TURN_SPEED] = speed_xy
    if route[w, BY_ALTITUDE] != 0.0 and s[GROUND] >= route[w, 2]:  # landing: each for itself
        if k[PHASE] == FLYING:
            s[WANTED + 2] = -min(_landing_rate(s), route[w, VERTICAL])
        norm = math.hypot(dx, dy)
        scale = speed_xy / norm if norm > 1e-9 else 0.0
        s[WANTED], s[WANTED + 1] = dx * scale, dy * scale
        return
    norm = math.sqrt(dx * dx + dy * dy + dz * dz)
    scale = math.hypot(speed_xy, speed_z) / norm if norm > 1e-9 else 0.0
    dx, dy, dz = dx * scale, dy * scale, dz * scale
    level_m_s = math.hypot(dx, dy)
    if level_m_s > speed_xy:  # along the leg, except for the last crawl, where one axis must not stop the others
        scale = speed_xy / level_m_s
        dx, dy = dx * scale, dy * scale
        if level_m_s >= _CRAWL_M_S or speed_xy >= _CRAWL_M_S:
            dz *= scale
    rate_m_s = abs(dz)
    if rate_m_s > speed_z:
        scale = speed_z / rate_m_s
        dz *= scale
        if rate_m_s >= _CRAWL_M_S or speed_z >= _CRAWL_M_S:
            dx, dy = dx * scale, dy * scale
    s[WANTED], s[WANTED + 1], s[WANTED + 2] = dx, dy, dz


@kernel
def _landing_rate(s: FloatArray) -> float:
    """Return how fast a landing vehicle sinks at its height."""
    height = s[POSITION + 2] - s[GROUND]
    if height <= s[CRAWL_BELOW]:
        return s[CRAWL]
    share = (height - s[LAND_BELOW]) / max(s[SLOW_BELOW] - s[LAND_BELOW], 1e-9)
    return s[LAND_SPEED] + min(max(share, 0.0), 1.0) * (s[DESCENT] - s[LAND_SPEED])


@kernel
def _move_target(s: FloatArray, h: float) -> None:
    """Move the trajectory by ``h``: every axis towards its velocity with limited jerk, all in the same time."""
    longest_s = 0.0
    for axis in range(3):
        t1, t2, t3, _ = _axis_times(s, axis, s[WANTED + axis], 0.0)
        longest_s = max(longest_s, t1 + t2 + t3)
    for axis in range(3):
        t1, t2, t3, direction = _axis_times(s, axis, s[WANTED + axis], longest_s)
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
