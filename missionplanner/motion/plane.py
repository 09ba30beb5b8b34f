"""ArduPlane in AUTO and RTL: L1 guidance over the ground, TECS for speed and height, and the plane that SITL simulates.

Every 0.1 s the navigator asks for a bank, a pitch and a throttle, as ArduPlane does; in between, rate controllers
move the surfaces of a plane with six degrees of freedom through air that may move itself. So it leads into corners,
overshoots its take-off, loses speed in turns and climbs, and crabs. A plane never stands: after its last waypoint it
circles there, and halted, where it was. PX4's planes are taken to fly alike.

Sources: ArduPilot Plane-4.5 (AP_L1_Control, AP_TECS, AP_RollController, AP_PitchController, ArduPlane/navigation.cpp,
altitude.cpp, takeoff.cpp; SITL/SIM_Plane with its default airframe); S. Park, J. Deyst, J. P. How, "A New Nonlinear
Guidance Logic for Trajectory Tracking" (2004). Recorded flights: the servos' lag, the greatest thrust, the time to
lift-off, and how low the airspeed sensor reads.
"""

from __future__ import annotations

import math
from dataclasses import replace

from missionplanner.motion.state import (
    AIRBORNE,
    AIRSPEED_MAX,
    AIRSPEED_MIN,
    AT_ONCE,
    BRAKED,
    BY_ALTITUDE,
    CLIMB,
    CLIMB_SHARE,
    CLOCK,
    COUNT,
    CROSS_INTEGRAL,
    CRUISE,
    CRUISE_THROTTLE,
    DENSITY,
    DESCENT,
    DIRECT,
    ELAPSED,
    ENERGY_RATE_ERROR,
    ENERGY_TIME,
    FAST_TIME,
    FASTEST,
    FLYING,
    HALTED,
    HEADING,
    HEIGHT_ASKED,
    HEIGHT_LAGGED,
    HEIGHT_LIMITED,
    HEIGHT_OFFSET,
    HEIGHT_WANTED,
    HOLD,
    HOLD_LEFT,
    HOLDING,
    IDLE,
    L1_DAMPING,
    L1_INTEGRAL,
    L1_PERIOD,
    LAST_BEND,
    LEVEL_OFF,
    LEVEL_OFF_TIME,
    LOITER_RADIUS,
    ON_CIRCLE,
    ORIGIN,
    PHASE,
    PITCH,
    PITCH_CLIPPED,
    PITCH_INTEGRAL,
    PITCH_MAX,
    PITCH_MIN,
    PITCH_RAW,
    PITCH_TIME,
    PITCH_UNLIMITED,
    PITCH_WANTED,
    POSITION,
    RADIUS,
    REACHED,
    ROLL,
    ROLL_MAX,
    ROLL_TIME,
    ROLL_WANTED,
    RUSH,
    RUSH_LAGGED,
    SENSOR,
    SENSOR_FACTOR,
    SERVO,
    SERVO_INTEGRAL,
    SINK_MIN,
    SINK_SHARE,
    SLOPE,
    SLOPE_MIN,
    SPEED,
    SPEED_INTEGRAL,
    SPEED_LAGGED,
    SPEED_WANTED,
    SPIN,
    SPIN_WANTED,
    STARTING,
    TAKEOFF_PITCH,
    TARGET,
    THROTTLE,
    THROTTLE_CLIPPED,
    THROTTLE_INTEGRAL,
    THROTTLE_RAW,
    THROTTLE_SENT,
    THROTTLE_SLEW,
    THROTTLE_WANTED,
    THRUST_MAX,
    VELOCITY,
    VERTICAL,
    WAYPOINT,
    WIND,
    YAW,
    FloatArray,
    IntArray,
    kernel,
)
from missionplanner.vehicle import MotionModel, true_airspeed

_STEP_S = 0.0167  # three per tick
_CONTROL_S = 0.1  # navigate() and update_alt() run at 10 Hz
_DELAY_S = 0.3  # from a command to what it changes: a take-off's throttle, a return's turn
_POINT_M = 1e-6  # a shorter leg has no direction
_STANDING_M_S = 3.0
_GRAVITY_M_S2 = 9.80665
_SEA_DENSITY = 1.225
_INDECISION_RAD = 0.9 * math.pi

# TECS
_HEIGHT_TIME_S = 3.0  # TECS_HDEM_TCONST
_THROTTLE_DAMPING = 0.5  # TECS_THR_DAMP
_PITCH_DAMPING = 0.3  # TECS_PTCH_DAMP
_INTEGRAL_GAIN = 0.3  # TECS_INTEG_GAIN
_VERTICAL_ACCELERATION_M_S2 = 7.0  # TECS_VERT_ACC
_TURN_THROTTLE = 10.0  # TECS_RLL2THR

# Rate controllers, as SITL's plane.parm tunes them
_ROLL_P, _ROLL_I, _ROLL_D, _ROLL_FF = 0.3, 0.25, 0.01743, 0.237212  # RLL_RATE_*
_PITCH_P, _PITCH_I, _PITCH_D, _PITCH_FF = 0.15, 0.11, 0.007265, 0.595723  # PTCH_RATE_*
_RATE_MAX_RAD_S = 0.5 * math.pi  # RLL2SRV_RMAX, PTCH2SRV_RMAX_UP, _DN
_INTEGRAL_MAX = 0.666  # *_RATE_IMAX
_TARGET_TIME_S = 1.0 / (2.0 * math.pi * 3.0)  # *_RATE_FLTT
_FULL_SERVO_RAD = math.radians(45.0)
_SCALING_SPEED_M_S = 15.0  # SCALING_SPEED
_RUDDER_MIX = 0.5  # KFF_RDDRMIX
_SERVO_TIME_S = 0.04  # measured

# The airframe: SIM_Plane's coefficients, per radian; its inertia is 1 kg m^2 about each axis
_MASS_KG, _WING_M2, _SPAN_M, _CHORD_M = 2.0, 0.45, 1.88, 0.24
_LIFT_0, _LIFT_ALPHA, _DRAG_0 = 0.56, 6.9, 0.1
_INDUCED = 1.0 / (math.pi * 0.9 * _SPAN_M * _SPAN_M / _WING_M2)
_PITCHING = 0.045
_CG_X_M, _CG_Z_M = -0.15, -0.05
_ALPHA_MAX_RAD, _BETA_MAX_RAD = 0.45, 0.8  # it stalls at 0.47
_TILT_MAX_RAD = math.radians(85.0)
_ROLLING_FRICTION = 0.3  # 1/s
_FAST_M_S, _LIFT_OFF_S = 5.0, 2.15  # it has flown so fast over the ground for so long when it lifts off (measured)

_NOSE_LOWER_DEG = 2.0  # it lifts off with more speed than it climbs with, which must not help it up

_true_airspeed = kernel(true_airspeed)


def climbing_as_stated(model: MotionModel, alt_amsl_m: float) -> MotionModel:
    """Return a plane that at full throttle and its cruise airspeed just climbs as stated (its climb rate), no better.

    The one that SITL simulates climbs out twice as fast, whatever is stated; a real one is somewhere in between.
    """
    plane = model.plane
    speed = model.true_speed_m_s(model.cruise_speed_m_s, alt_amsl_m)
    rise = min(model.climb_rate_m_s / speed, 1.0)
    pressure = 0.5 * _SEA_DENSITY * (speed / true_airspeed(alt_amsl_m)) ** 2 * _WING_M2
    weight = _MASS_KG * _GRAVITY_M_S2
    lift = weight * math.sqrt(1.0 - rise * rise) / pressure
    thrust = pressure * (_DRAG_0 + _INDUCED * lift * lift) / weight + rise
    pitch_deg = math.degrees(math.asin(rise) + (lift - _LIFT_0) / _LIFT_ALPHA) - _NOSE_LOWER_DEG
    weaker = replace(
        plane,
        thrust_to_weight=min(plane.thrust_to_weight, thrust),
        takeoff_pitch_deg=min(plane.takeoff_pitch_deg, max(pitch_deg, 0.0)),
    )
    return replace(model, plane=weaker)


@kernel
def _clip(value: float, low: float, high: float) -> float:
    return max(low, min(high, value))


@kernel
def step(s: FloatArray, k: IntArray, route: FloatArray, dt: float) -> None:
    """Advance by ``dt``; halted or done, it circles to the right."""
    if k[PHASE] == STARTING:
        _start(s, k, route)
    _note_centre(s, k, route)
    s[CLOCK] -= dt
    if s[CLOCK] <= 1e-9:
        s[CLOCK] += _CONTROL_S
        _control(s, k, route)
    steps = round(dt / _STEP_S)
    h = dt / steps
    for _ in range(steps):
        _move(s, h)
        s[ELAPSED] += h
        if k[HALTED] == 0 and k[PHASE] != IDLE:
            _accept_waypoint(s, k, route, h)


@kernel
def _start(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Begin a route: from the ground along its first leg, or in flight from where and how it flies."""
    k[PHASE] = FLYING
    speed = math.sqrt(s[VELOCITY] ** 2 + s[VELOCITY + 1] ** 2 + s[VELOCITY + 2] ** 2)
    s[CLOCK] = 0.0
    s[ON_CIRCLE] = 0.0
    s[LEVEL_OFF] = 0.0
    if speed < _STANDING_M_S:
        east, north = route[0, 0] - s[POSITION], route[0, 1] - s[POSITION + 1]
        if math.hypot(east, north) > _POINT_M:
            s[YAW] = math.atan2(east, north)
        _steady(s, speed)
        s[PITCH] = s[PITCH_WANTED] = s[PITCH_RAW] = 0.0
        s[THROTTLE] = s[THROTTLE_SENT] = s[THROTTLE_WANTED] = 0.0
        s[AIRBORNE] = s[FAST_TIME] = s[SERVO + 1] = s[SERVO_INTEGRAL + 1] = 0.0
        s[CLOCK] = _DELAY_S
    elif s[AIRBORNE] == 0.0:
        _steady(s, speed)
        s[SPEED_WANTED] = route[0, SPEED] * s[SENSOR]
        s[AIRBORNE] = 1.0
    elif route[0, BY_ALTITUDE] == AT_ONCE:
        s[CLOCK] = _DELAY_S
    _begin_leg(s, k, route)
    for axis in range(3):
        s[ORIGIN + axis] = s[POSITION + axis]
    s[DIRECT] = 0.0 if route[0, BY_ALTITUDE] > 0.0 else 1.0


@kernel
def _steady(s: FloatArray, speed: float) -> None:
    """Trim the plane, and its controllers, for the velocity that it has."""
    _feel_air(s)
    east, north, up = s[VELOCITY] - s[WIND], s[VELOCITY + 1] - s[WIND + 1], s[VELOCITY + 2]
    air = max(math.sqrt(east * east + north * north + up * up), _STANDING_M_S)
    pressure = 0.5 * s[DENSITY] * air * air * _WING_M2
    lift = _MASS_KG * _GRAVITY_M_S2 / pressure
    alpha = _clip((lift - _LIFT_0) / _LIFT_ALPHA, -_ALPHA_MAX_RAD, _ALPHA_MAX_RAD)
    climb = math.asin(_clip(up / air, -0.7, 0.7))
    for column in range(ROLL, AIRBORNE):
        s[column] = s[column] if column == YAW else 0.0
    if speed >= _STANDING_M_S and math.hypot(east, north) > _POINT_M:
        s[YAW] = math.atan2(east, north)
    s[PITCH] = s[PITCH_WANTED] = s[PITCH_RAW] = climb + alpha
    drag = pressure * (_DRAG_0 + _INDUCED * lift * lift) / _MASS_KG
    throttle = _clip((drag + _GRAVITY_M_S2 * math.sin(climb)) / s[THRUST_MAX], 0.0, 1.0)
    s[THROTTLE] = s[THROTTLE_SENT] = s[THROTTLE_WANTED] = throttle
    s[THROTTLE_RAW] = s[CRUISE_THROTTLE]
    s[THROTTLE_INTEGRAL] = throttle - s[CRUISE_THROTTLE]
    gain = _GRAVITY_M_S2 * air
    s[PITCH_INTEGRAL] = gain * alpha
    s[PITCH_UNLIMITED] = climb + alpha
    s[HEIGHT_ASKED] = s[HEIGHT_LIMITED] = s[HEIGHT_LAGGED] = s[HEIGHT_WANTED] = s[POSITION + 2]
    s[HEIGHT_OFFSET] = max(up, 0.0) * _HEIGHT_TIME_S
    s[CLIMB_SHARE] = s[SINK_SHARE] = 1.0
    s[SPEED_WANTED] = air
    s[FASTEST] = s[AIRSPEED_MAX] * s[SENSOR]
    # the elevator that balances the pitching moment
    force_x = pressure * (lift * math.sin(alpha) - (_DRAG_0 + _INDUCED * lift * lift) * math.cos(alpha))
    force_z = -pressure * (lift * math.cos(alpha) + (_DRAG_0 + _INDUCED * lift * lift) * math.sin(alpha))
    moment = _CG_Z_M * force_x - _CG_X_M * force_z
    elevator = _clip(0.7 * alpha - _PITCHING - moment / (pressure * _CHORD_M), -1.0, 1.0)
    s[SERVO + 1] = elevator
    s[SERVO_INTEGRAL + 1] = _clip(elevator * _FULL_SERVO_RAD, -_INTEGRAL_MAX, _INTEGRAL_MAX)


@kernel
def _begin_leg(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Begin the leg to the present waypoint: along a slope from the present height, or at once to the new one."""
    w = k[WAYPOINT]
    s[DIRECT] = 0.0
    for axis in range(3):
        s[ORIGIN + axis] = route[w - 1, axis] if w > 0 else s[POSITION + axis]
    lx, ly = route[w, 0] - s[ORIGIN], route[w, 1] - s[ORIGIN + 1]
    if (route[w, 0] - s[POSITION]) * lx + (route[w, 1] - s[POSITION + 1]) * ly <= 0.0:  # it is past it already
        for axis in range(3):
            s[ORIGIN + axis] = s[POSITION + axis]
    s[SLOPE] = route[w, 2] - s[POSITION + 2]
    short = abs(s[SLOPE]) < s[SLOPE_MIN] and not route[w, BY_ALTITUDE] > 0.0
    if short or (route[w, BY_ALTITUDE] == AT_ONCE and s[SLOPE] > 0.0):
        s[SLOPE] = 0.0


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
def _feel_air(s: FloatArray) -> None:
    """Note the density of the air here, and the true airspeed per one that the autopilot reads."""
    ratio = _true_airspeed(s[POSITION + 2])
    s[DENSITY] = _SEA_DENSITY / (ratio * ratio)
    s[SENSOR] = ratio * s[SENSOR_FACTOR]


@kernel
def _control(s: FloatArray, k: IntArray, route: FloatArray) -> None:
    """Choose bank, pitch and throttle: L1 for the way, TECS for height and speed."""
    _feel_air(s)
    w = min(k[WAYPOINT], k[COUNT] - 1)
    circling = k[HALTED] != 0 or k[PHASE] == IDLE
    climb = min(s[CLIMB], route[w, VERTICAL])
    sink = min(s[DESCENT], route[w, VERTICAL])
    taking_off = not circling and route[w, BY_ALTITUDE] > 0.0 and route[w, 2] > s[ORIGIN + 2]
    if taking_off:
        s[ROLL_WANTED] = _bank(s, _turn_to_heading(s))
        _manage_energy(s, s[POSITION + 2], route[w, SPEED], climb, sink, _least_takeoff_pitch(s, route[w, 2]))
        if s[AIRBORNE] == 0.0:
            s[PITCH_WANTED], s[THROTTLE_WANTED] = s[TAKEOFF_PITCH], 1.0
        return
    if circling or route[w, BY_ALTITUDE] == AT_ONCE:
        if not circling:
            for axis in range(3):
                s[TARGET + axis] = route[w, axis]
        turn = _turn_to_circle(s)
    else:
        turn = _turn_to_leg(s, route[w, 0], route[w, 1])
    s[ROLL_WANTED] = _bank(s, turn)
    height = s[TARGET + 2] if circling else _height_along_leg(s, route, w)
    _manage_energy(s, height, route[w, SPEED], climb, sink, math.inf)
    if s[AIRBORNE] == 0.0:
        s[PITCH_WANTED], s[THROTTLE_WANTED] = s[TAKEOFF_PITCH], 1.0


@kernel
def _bank(s: FloatArray, turn: float) -> float:
    """Return the bank for a lateral acceleration to the right, as far as limits and the load on the wings allow."""
    wanted = math.atan(turn / (_GRAVITY_M_S2 * math.cos(_clip(s[PITCH], -1.0472, 1.0472))))
    wanted = _clip(wanted, -s[ROLL_MAX], s[ROLL_MAX])
    load = _airspeed(s) / (s[SENSOR] * s[AIRSPEED_MIN])  # sustainable; its square is that of the lift
    most = 0.4363 if load <= 1.0 else max(math.acos(1.0 / (load * load)), 0.4363)
    return _clip(wanted, -most, most)


@kernel
def _airspeed(s: FloatArray) -> float:
    east, north = s[VELOCITY] - s[WIND], s[VELOCITY + 1] - s[WIND + 1]
    return math.sqrt(east * east + north * north + s[VELOCITY + 2] ** 2)


@kernel
def _turn_to_heading(s: FloatArray) -> float:
    """Return the lateral acceleration (to the right) that holds the take-off's heading, the course of its roll."""
    if s[AIRBORNE] == 0.0:
        s[HEADING] = s[YAW]
        return 0.0
    omega = math.sqrt(2.0) * math.pi / s[L1_PERIOD]
    off = s[HEADING] - s[YAW]
    off = math.atan2(math.sin(off), math.cos(off))
    speed = math.hypot(s[VELOCITY], s[VELOCITY + 1])
    return 2.0 * math.sin(_clip(off, -0.5 * math.pi, 0.5 * math.pi)) * speed * omega


@kernel
def _turn_to_leg(s: FloatArray, to_x: float, to_y: float) -> float:
    """Return the lateral acceleration (to the right) towards the point of the leg that lies one L1 length away."""
    ve, vn = s[VELOCITY], s[VELOCITY + 1]
    speed = math.hypot(ve, vn)
    if speed < 0.1 or ve * math.sin(s[YAW]) + vn * math.cos(s[YAW]) <= 0.0:  # blown backwards: trust the compass
        speed = 0.1
        ve, vn = speed * math.sin(s[YAW]), speed * math.cos(s[YAW])
    reach_m = s[L1_DAMPING] * s[L1_PERIOD] * speed / math.pi
    from_x, from_y = (s[POSITION], s[POSITION + 1]) if s[DIRECT] > 0.0 else (s[ORIGIN], s[ORIGIN + 1])
    le, ln = to_x - from_x, to_y - from_y
    length_m = math.hypot(le, ln)
    if length_m < _POINT_M:
        le, ln = math.sin(s[YAW]), math.cos(s[YAW])
    else:
        le, ln = le / length_m, ln / length_m
    pe, pn = s[POSITION] - from_x, s[POSITION + 1] - from_y
    across_m = pn * le - pe * ln
    along_m = pn * ln + pe * le
    away_m = math.hypot(pe, pn)
    before = away_m > reach_m and along_m < -0.7071 * max(away_m, 1.0)
    if before or along_m > length_m + 3.0 * speed:
        e, n = (-pe, -pn) if before else (to_x - s[POSITION], to_y - s[POSITION + 1])
        bend = math.atan2(vn * e - ve * n, vn * n + ve * e)
    else:
        aim = math.asin(_clip(across_m / max(reach_m, 0.1), -0.7071, 0.7071))
        if abs(aim) < 0.0873:
            s[CROSS_INTEGRAL] = _clip(s[CROSS_INTEGRAL] + aim * s[L1_INTEGRAL] * _CONTROL_S, -0.1, 0.1)
        bend = aim + s[CROSS_INTEGRAL] + math.atan2(vn * le - ve * ln, vn * ln + ve * le)
    bend = _decide(s, bend, to_x, to_y)
    return _l1_turn(s, speed, reach_m, bend)


@kernel
def _decide(s: FloatArray, bend: float, to_x: float, to_y: float) -> float:
    """Return the angle to turn by; flying away from its target, it goes on turning as it did."""
    if abs(bend) > _INDECISION_RAD and abs(s[LAST_BEND]) > _INDECISION_RAD and bend * s[LAST_BEND] < 0.0:
        e, n = to_x - s[POSITION], to_y - s[POSITION + 1]
        if e * math.sin(s[YAW]) + n * math.cos(s[YAW]) < -0.5 * math.hypot(e, n):
            bend = s[LAST_BEND]
    s[LAST_BEND] = bend
    return bend


@kernel
def _l1_turn(s: FloatArray, speed: float, reach_m: float, bend: float) -> float:
    gain = 4.0 * s[L1_DAMPING] * s[L1_DAMPING]
    return gain * speed * speed / reach_m * math.sin(_clip(bend, -0.5 * math.pi, 0.5 * math.pi))


@kernel
def _turn_to_circle(s: FloatArray) -> float:
    """Return the lateral acceleration (to the right) onto the circle to the right around the target, and along it."""
    ve, vn = s[VELOCITY], s[VELOCITY + 1]
    speed = max(math.hypot(ve, vn), 1.0)
    reach_m = s[L1_DAMPING] * s[L1_PERIOD] * speed / math.pi
    re, rn = s[POSITION] - s[TARGET], s[POSITION + 1] - s[TARGET + 1]
    away_m = math.hypot(re, rn)
    if away_m > 0.1:
        re, rn = re / away_m, rn / away_m
    else:
        re, rn = ve / speed, vn / speed
    around = rn * ve - re * vn  # clockwise
    outward = vn * rn + ve * re
    bend = _decide(s, math.atan2(around, -outward), s[TARGET], s[TARGET + 1])
    capture = _l1_turn(s, speed, reach_m, bend)

    radius_m = s[LOITER_RADIUS] * s[SENSOR] * s[SENSOR]  # as wide as the thin air asks for
    omega = 2.0 * math.pi / s[L1_PERIOD]
    back = (away_m - radius_m) * omega * omega + outward * 2.0 * s[L1_DAMPING] * omega
    if outward > 0.0 and around < 0.0:  # flying the wrong way: do not turn further into it
        back = max(back, 0.0)
    circle = back + around * around / max(0.5 * radius_m, away_m)
    if away_m > radius_m and capture < circle:
        return capture
    s[ON_CIRCLE] = 1.0
    return circle


@kernel
def _height_along_leg(s: FloatArray, route: FloatArray, w: int) -> float:
    """Return the height of the slope to the waypoint here; a landing's goes on beneath the ground."""
    lx, ly = route[w, 0] - s[ORIGIN], route[w, 1] - s[ORIGIN + 1]
    squared = lx * lx + ly * ly
    if s[SLOPE] == 0.0 or squared < _POINT_M:
        return route[w, 2]
    share = ((s[POSITION] - s[ORIGIN]) * lx + (s[POSITION + 1] - s[ORIGIN + 1]) * ly) / squared
    if route[w, BY_ALTITUDE] > 0.0:
        return route[w, 2] - s[SLOPE] * (1.0 - max(share, 0.0))
    return route[w, 2] - s[SLOPE] * (1.0 - _clip(share, 0.0, 1.0))


@kernel
def _least_takeoff_pitch(s: FloatArray, top_m: float) -> float:
    """Return how far it pitches up on take-off at least: ever less, a few seconds before its top."""
    left_m = top_m - s[POSITION + 2]
    if s[LEVEL_OFF] > 0.0:
        return s[TAKEOFF_PITCH] * left_m / s[LEVEL_OFF]
    rise = s[VELOCITY + 2]
    if rise > 0.1 and 0.0 < left_m <= rise * s[LEVEL_OFF_TIME] and s[POSITION + 2] - s[ORIGIN + 2] >= 10.0:
        s[LEVEL_OFF] = left_m
    return s[TAKEOFF_PITCH]


@kernel
def _manage_energy(
    s: FloatArray, height_m: float, speed_m_s: float, climb: float, sink: float, least_pitch: float
) -> None:
    """Choose pitch and throttle for a height and an airspeed (TECS); ``least_pitch`` is finite on take-off."""
    g, dt, patience = _GRAVITY_M_S2, _CONTROL_S, s[ENERGY_TIME]
    taking_off = least_pitch < math.inf
    blend = dt / (dt + patience)
    tas = max(_airspeed(s), _STANDING_M_S)
    height = s[POSITION + 2]
    rise = s[VELOCITY + 2]
    rush = s[RUSH] / dt
    s[RUSH] = 0.0
    s[RUSH_LAGGED] += (rush - s[RUSH_LAGGED]) * blend

    # how fast energy may be gained and lost, how fast it may fly
    gain_max = climb * s[CLIMB_SHARE] * g
    gain_min = -s[SINK_MIN] * g
    slowest = s[AIRSPEED_MIN] * s[SENSOR]
    change = gain_min if s[THROTTLE_CLIPPED] > 0.0 else gain_max
    s[FASTEST] += dt * 0.5 * change / max(tas, slowest)
    if s[THROTTLE_CLIPPED] > 0.0:
        s[FASTEST] = max(s[FASTEST], s[CRUISE] * s[SENSOR])
    s[FASTEST] = min(s[FASTEST], s[AIRSPEED_MAX] * s[SENSOR])
    slowest /= math.cos(min(abs(s[ROLL_WANTED]), 1.48)) ** 0.25
    fastest = max(s[FASTEST], slowest)

    # the height asked for, followed no faster than it can
    pitch_min, pitch_max = s[PITCH_MIN], s[PITCH_MAX]
    asked = height_m
    cannot_climb = (s[PITCH_UNLIMITED] > pitch_max or s[THROTTLE_CLIPPED] > 0.0) and not taking_off
    cannot_sink = s[PITCH_UNLIMITED] < pitch_min or s[THROTTLE_CLIPPED] < 0.0
    if (cannot_climb and asked > s[HEIGHT_ASKED]) or (cannot_sink and asked < s[HEIGHT_ASKED]):
        asked = s[HEIGHT_ASKED]
    if taking_off:
        pitch_min = least_pitch
        pitch_max = max(pitch_max, pitch_min)
        asked = height
        s[HEIGHT_ASKED] = s[HEIGHT_LIMITED] = s[HEIGHT_LAGGED] = s[HEIGHT_WANTED] = height
        s[HEIGHT_OFFSET] = rise * _HEIGHT_TIME_S
        s[CLIMB_SHARE] = s[SINK_SHARE] = 1.0
    mean = 0.5 * (asked + s[HEIGHT_ASKED])
    s[HEIGHT_ASKED] = asked
    s[HEIGHT_LIMITED] += _clip(mean - s[HEIGHT_LIMITED], -sink * s[SINK_SHARE] * dt, climb * s[CLIMB_SHARE] * dt)
    share = dt / (dt + _HEIGHT_TIME_S)
    rise_wanted = (s[HEIGHT_LIMITED] - s[HEIGHT_LAGGED]) / _HEIGHT_TIME_S
    s[HEIGHT_LAGGED] += (s[HEIGHT_LIMITED] - s[HEIGHT_LAGGED]) * share
    s[HEIGHT_OFFSET] *= 1.0 - share
    wanted = s[HEIGHT_LAGGED] + s[HEIGHT_OFFSET]
    throttled = s[THROTTLE_CLIPPED] > 0.0 and not taking_off
    if (s[PITCH_UNLIMITED] > pitch_max or s[PITCH_CLIPPED] > 0.0 or throttled) and wanted > s[HEIGHT_WANTED]:
        s[CLIMB_SHARE] *= 1.0 - share
    elif (cannot_sink or s[PITCH_CLIPPED] < 0.0) and wanted < s[HEIGHT_WANTED]:
        s[SINK_SHARE] *= 1.0 - share
    else:
        s[CLIMB_SHARE] += (1.0 - s[CLIMB_SHARE]) * share
        s[SINK_SHARE] += (1.0 - s[SINK_SHARE]) * share
    s[HEIGHT_WANTED] = wanted

    # the speed asked for, followed with half the energy there is
    target = _clip(speed_m_s * s[SENSOR], slowest, fastest)
    quicken = _clip((target - s[SPEED_WANTED]) / dt, 0.5 * gain_min / tas, 0.5 * gain_max / tas)
    s[SPEED_WANTED] = target if taking_off else _clip(s[SPEED_WANTED] + quicken * dt, slowest, fastest)
    s[SPEED_LAGGED] += (quicken - s[SPEED_LAGGED]) * blend

    # specific energies: of height, of speed
    high = g * (wanted - height)
    fast = 0.5 * (s[SPEED_WANTED] ** 2 - tas * tas)
    high_rate = g * rise
    fast_rate = tas * (rush - s[RUSH_LAGGED])
    _choose_pitch(s, high, fast, g * rise_wanted, high_rate, fast_rate, climb, sink, pitch_min, pitch_max, taking_off)

    # throttle: the whole energy
    room_up = max(0.5 * (tas * tas - slowest * slowest), 0.0)
    room_down = min(0.5 * (tas * tas - fastest * fastest), 0.0)
    error = _clip(high, room_down, room_up) + fast
    rate_wanted = _clip(high / patience + tas * (quicken - s[SPEED_LAGGED]), gain_min, gain_max)
    s[ENERGY_RATE_ERROR] += 2.0 * dt * (rate_wanted - high_rate - fast_rate - s[ENERGY_RATE_ERROR])
    level = math.cos(s[ROLL]) ** 2
    rate_wanted += _TURN_THROTTLE * (1.0 / max(level, 0.1) - 1.0)
    span = gain_max - gain_min
    raw = s[CRUISE_THROTTLE] + rate_wanted / span
    raw += (error + s[ENERGY_RATE_ERROR] * _THROTTLE_DAMPING) / (patience * span)
    most, least = _clip(1.1 - raw, -0.5, 0.5), _clip(-raw - 0.1, -0.5, 0.5)
    s[THROTTLE_INTEGRAL] += error * _INTEGRAL_GAIN * dt / (patience * span)
    s[THROTTLE_INTEGRAL] = most if taking_off else _clip(s[THROTTLE_INTEGRAL], least, most)
    s[THROTTLE_RAW] += _clip(raw - s[THROTTLE_RAW], -s[THROTTLE_SLEW] * dt, s[THROTTLE_SLEW] * dt)
    full = s[THROTTLE_RAW] + s[THROTTLE_INTEGRAL]
    s[THROTTLE_CLIPPED] = 1.0 if full > 1.0 else (-1.0 if full < 0.0 else 0.0)
    s[THROTTLE_WANTED] = _clip(full, 0.0, 1.0)


@kernel
def _choose_pitch(
    s: FloatArray,
    high: float,
    fast: float,
    rise_wanted: float,
    high_rate: float,
    fast_rate: float,
    climb: float,
    sink: float,
    pitch_min: float,
    pitch_max: float,
    taking_off: bool,
) -> None:
    """Choose the pitch that balances the energy of height against that of speed; a take-off heeds speed alone."""
    g, dt, patience = _GRAVITY_M_S2, _CONTROL_S, s[ENERGY_TIME]
    tas = max(_airspeed(s), _STANDING_M_S)
    weight = 0.0 if taking_off else 1.0
    wanted = rise_wanted * weight + (high * weight - fast) / patience
    s[PITCH_CLIPPED] = 1.0 if wanted > climb * g else (-1.0 if wanted < -sink * g else 0.0)
    wanted = _clip(wanted, -sink * g, climb * g)
    error = wanted - (high_rate * weight - fast_rate)
    total = wanted + error * _PITCH_DAMPING
    gain = tas * g
    if taking_off:
        total += pitch_min * gain
    low, most = gain * (pitch_min - 0.0873) - total, gain * (pitch_max + 0.0873) - total
    more = _clip(error * _INTEGRAL_GAIN * dt, -0.1 * (most - low), 0.1 * (most - low))
    ahead = (total + s[PITCH_INTEGRAL] + more + s[SPEED_INTEGRAL]) / gain
    if (ahead > pitch_max and more > 0.0) or (ahead < pitch_min and more < 0.0):
        s[PITCH_INTEGRAL] *= patience / (dt + patience)
        s[SPEED_INTEGRAL] *= patience / (dt + patience)
    else:
        s[PITCH_INTEGRAL] += more
        s[SPEED_INTEGRAL] -= fast * dt / patience
    s[PITCH_INTEGRAL] = _clip(s[PITCH_INTEGRAL], low, most)
    quarter = 0.25 * (pitch_max - pitch_min) * gain
    s[SPEED_INTEGRAL] = _clip(s[SPEED_INTEGRAL], -quarter, quarter)
    s[PITCH_UNLIMITED] = (total + s[PITCH_INTEGRAL] + s[SPEED_INTEGRAL]) / gain
    change = dt * _VERTICAL_ACCELERATION_M_S2 / tas
    pitch = _clip(s[PITCH_UNLIMITED], pitch_min, pitch_max)
    s[PITCH_RAW] = _clip(pitch, s[PITCH_RAW] - change, s[PITCH_RAW] + change)
    s[PITCH_WANTED] = max(s[PITCH_RAW], pitch_min) if taking_off else s[PITCH_RAW]


@kernel
def _move(s: FloatArray, h: float) -> None:
    """Advance the plane and its rate controllers by ``h`` seconds: on the ground along its nose, else freely."""
    sin_roll, cos_roll = math.sin(s[ROLL]), math.cos(s[ROLL])
    sin_pitch, cos_pitch = math.sin(s[PITCH]), math.cos(s[PITCH])
    sin_yaw, cos_yaw = math.sin(s[YAW]), math.cos(s[YAW])
    # body axes (forward, right, down) in north, east, down
    y_n = sin_roll * sin_pitch * cos_yaw - cos_roll * sin_yaw
    y_e = sin_roll * sin_pitch * sin_yaw + cos_roll * cos_yaw
    y_d = sin_roll * cos_pitch
    z_n = cos_roll * sin_pitch * cos_yaw + sin_roll * sin_yaw
    z_e = cos_roll * sin_pitch * sin_yaw - sin_roll * cos_yaw
    z_d = cos_roll * cos_pitch
    air_e, air_n, air_d = s[VELOCITY] - s[WIND], s[VELOCITY + 1] - s[WIND + 1], -s[VELOCITY + 2]
    u = cos_pitch * cos_yaw * air_n + cos_pitch * sin_yaw * air_e - sin_pitch * air_d
    v = y_n * air_n + y_e * air_e + y_d * air_d
    w = z_n * air_n + z_e * air_e + z_d * air_d
    speed = math.sqrt(u * u + v * v + w * w)
    alpha = _clip(math.atan2(w, u), -_ALPHA_MAX_RAD, _ALPHA_MAX_RAD)
    beta = _clip(math.atan2(v, u), -_BETA_MAX_RAD, _BETA_MAX_RAD)

    force = 0.5 * s[DENSITY] * speed * speed * _WING_M2
    aileron, elevator = s[SERVO], s[SERVO + 1]
    rudder = _RUDDER_MIX * aileron
    lift = _LIFT_0 + _LIFT_ALPHA * alpha
    drag = _DRAG_0 + _INDUCED * lift * lift
    fx = force * (lift * math.sin(alpha) - drag * math.cos(alpha))
    fy = force * (-0.98 * beta - 0.2 * rudder)
    fz = -force * (lift * math.cos(alpha) + drag * math.sin(alpha))
    p, q, r = s[SPIN], s[SPIN + 1], s[SPIN + 2]
    slow = 0.5 / max(speed, _STANDING_M_S)
    ps, rs = p * _SPAN_M * slow, r * _SPAN_M * slow
    about_x = force * _SPAN_M * (-0.12 * beta - ps + 0.14 * rs + 0.25 * aileron - 0.037 * rudder) - _CG_Z_M * fy
    about_y = force * _CHORD_M * (_PITCHING - 0.7 * alpha - 20.0 * q * _CHORD_M * slow + elevator)
    about_y += _CG_Z_M * fx - _CG_X_M * fz
    about_z = force * _SPAN_M * (0.25 * beta + 0.022 * ps - rs + 0.1 * rudder) + _CG_X_M * fy
    ax = s[THROTTLE] * s[THRUST_MAX] + fx / _MASS_KG

    # servos
    read = max(speed / s[SENSOR], _STANDING_M_S)
    scale = _clip(_SCALING_SPEED_M_S / read, 0.25, 2.0)
    turning = cos_pitch * _GRAVITY_M_S2 / max(speed, s[AIRSPEED_MIN]) * sin_roll * sin_roll / max(cos_roll, 0.17)
    roll_rate = _clip((s[ROLL_WANTED] - s[ROLL]) / s[ROLL_TIME], -_RATE_MAX_RAD_S, _RATE_MAX_RAD_S)
    pitch_rate = _clip((s[PITCH_WANTED] - s[PITCH]) / s[PITCH_TIME], -_RATE_MAX_RAD_S, _RATE_MAX_RAD_S) + turning
    awake = read > 0.5 * s[AIRSPEED_MIN]
    flying = awake and s[AIRBORNE] > 0.0
    _turn_servo(s, 0, roll_rate, p, about_x, _ROLL_FF, _ROLL_P, _ROLL_I, _ROLL_D, scale, flying, h)
    _turn_servo(s, 1, pitch_rate, q, about_y, _PITCH_FF, _PITCH_P, _PITCH_I, _PITCH_D, scale, awake, h)
    s[THROTTLE_SENT] += _clip(s[THROTTLE_WANTED] - s[THROTTLE_SENT], -s[THROTTLE_SLEW] * h, s[THROTTLE_SLEW] * h)
    s[THROTTLE] += (s[THROTTLE_SENT] - s[THROTTLE]) * (h / (h + _SERVO_TIME_S))

    if s[AIRBORNE] == 0.0:
        along = math.hypot(s[VELOCITY], s[VELOCITY + 1])
        ax -= _ROLLING_FRICTION * along
        s[RUSH] += ax * h
        along = max(along + ax * h, 0.0)
        s[VELOCITY], s[VELOCITY + 1], s[VELOCITY + 2] = along * sin_yaw, along * cos_yaw, 0.0
        s[SERVO] = 0.0
        if along > _FAST_M_S:
            s[FAST_TIME] += h
        if s[FAST_TIME] >= _LIFT_OFF_S and speed >= s[AIRSPEED_MIN] * s[SENSOR]:
            s[AIRBORNE] = 1.0
    else:
        ay, az = fy / _MASS_KG, fz / _MASS_KG
        s[RUSH] += (ax - sin_pitch * _GRAVITY_M_S2) * h
        s[VELOCITY] += (cos_pitch * sin_yaw * ax + y_e * ay + z_e * az) * h
        s[VELOCITY + 1] += (cos_pitch * cos_yaw * ax + y_n * ay + z_n * az) * h
        s[VELOCITY + 2] -= (-sin_pitch * ax + y_d * ay + z_d * az + _GRAVITY_M_S2) * h
        p, q, r = p + about_x * h, q + about_y * h, r + about_z * h
        s[SPIN], s[SPIN + 1], s[SPIN + 2] = p, q, r
        around = (q * sin_roll + r * cos_roll) / cos_pitch
        s[ROLL] = _clip(s[ROLL] + (p + sin_pitch * around) * h, -_TILT_MAX_RAD, _TILT_MAX_RAD)
        s[PITCH] = _clip(s[PITCH] + (q * cos_roll - r * sin_roll) * h, -_TILT_MAX_RAD, _TILT_MAX_RAD)
        s[YAW] += around * h
    for axis in range(3):
        s[POSITION + axis] += s[VELOCITY + axis] * h


@kernel
def _turn_servo(
    s: FloatArray,
    i: int,
    wanted: float,
    rate: float,
    acceleration: float,
    feed_forward: float,
    proportional: float,
    integral: float,
    derivative: float,
    scale: float,
    learns: bool,
    h: float,
) -> None:
    """Move aileron (0) or elevator (1) by what its rate controller asks for; their full deflection is 1."""
    squared = scale * scale
    s[SPIN_WANTED + i] += (wanted * squared - s[SPIN_WANTED + i]) * (h / (h + _TARGET_TIME_S))
    error = s[SPIN_WANTED + i] - rate * squared
    asked = feed_forward * s[SPIN_WANTED + i] / (scale * s[SENSOR]) + proportional * error
    asked = (asked - derivative * acceleration * squared + s[SERVO_INTEGRAL + i]) / _FULL_SERVO_RAD
    if learns and (abs(asked) < 1.0 or error * s[SERVO_INTEGRAL + i] < 0.0):
        more = s[SERVO_INTEGRAL + i] + integral * error * h
        s[SERVO_INTEGRAL + i] = _clip(more, -_INTEGRAL_MAX, _INTEGRAL_MAX)
    s[SERVO + i] += (_clip(asked, -1.0, 1.0) - s[SERVO + i]) * (h / (h + _SERVO_TIME_S))


@kernel
def _accept_waypoint(s: FloatArray, k: IntArray, route: FloatArray, h: float) -> None:
    """Accept the waypoint within its turn's distance, or once it is abeam; a hold is flown on along the leg."""
    w = k[WAYPOINT]
    if k[PHASE] == HOLDING:
        s[HOLD_LEFT] -= h
        if s[HOLD_LEFT] > 1e-9:
            return
    else:
        if not _reached(s, k, route):
            return
        route[w, REACHED] = s[ELAPSED]
        if route[w, HOLD] > 0.0:
            k[PHASE] = HOLDING
            s[HOLD_LEFT] = route[w, HOLD]
            return
    k[PHASE] = FLYING
    k[WAYPOINT] = w + 1
    s[CLOCK] = _CONTROL_S
    if w + 1 == k[COUNT]:
        k[PHASE] = IDLE
        _note_centre(s, k, route)
    else:
        _begin_leg(s, k, route)


@kernel
def _reached(s: FloatArray, k: IntArray, route: FloatArray) -> bool:
    """Whether the waypoint is reached: by altitude, where it asks for that, or else across the ground."""
    w = k[WAYPOINT]
    if route[w, BY_ALTITUDE] == AT_ONCE:
        return s[ON_CIRCLE] > 0.0
    if route[w, BY_ALTITUDE] > 0.0:
        return (route[w, 2] - s[POSITION + 2]) * math.copysign(1.0, route[w, 2] - s[ORIGIN + 2]) <= 0.0
    lx = route[w, 0] - s[ORIGIN]
    ly = route[w, 1] - s[ORIGIN + 1]
    dx = route[w, 0] - s[POSITION]
    dy = route[w, 1] - s[POSITION + 1]
    if dx * lx + dy * ly <= 0.0:
        return True
    radius_m = s[RADIUS] * s[SENSOR] * s[SENSOR]
    if dx * dx + dy * dy > radius_m * radius_m:
        return False
    speed = math.hypot(s[VELOCITY], s[VELOCITY + 1])
    radius_m = min(radius_m, s[L1_DAMPING] * s[L1_PERIOD] * speed / math.pi)
    if w + 1 < k[COUNT]:
        nx = route[w + 1, 0] - route[w, 0]
        ny = route[w + 1, 1] - route[w, 1]
        turn = abs(math.atan2(lx * ny - ly * nx, lx * nx + ly * ny))
        radius_m *= min(1.0, turn / (0.5 * math.pi))
    # it looks ten times a second: half a look late on average
    return math.hypot(dx, dy) <= radius_m - 0.5 * _CONTROL_S * speed
