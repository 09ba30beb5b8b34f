"""The kernels' state: one row of floats, one row of integers and one padded route per vehicle.

Flat rows with named columns, not structs of arrays: they compile several times faster and sit in one cache line each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from missionplanner.compiled import njit
from missionplanner.vehicle import ArducopterTuning, MotionModel, Px4Tuning

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_OPTIONS: dict[str, Any] = {
    "error_model": "numpy",  # divisions by zero are guarded where they can occur
    "no_cpython_wrapper": True,  # only the outermost kernel is called from Python
    "no_cfunc_wrapper": True,
}
_Function = TypeVar("_Function", bound=Callable[..., object])


def kernel(function: _Function) -> _Function:
    """Compile a function that only other kernels call; what is compiled is kept with the outermost one."""
    compiled: _Function = njit(**_OPTIONS)(function)
    return compiled


STEP_S = 0.025
"""The step of ArduCopters."""

# Integer columns.
NAVIGATOR, PHASE, WAYPOINT, COUNT, HALTED, SLOT, STALE, TRACK, INTEGERS = range(9)
ARDUCOPTER, PX4, PLANE = range(3)  # navigators
IDLE, STARTING, FLYING, HOLDING = range(4)  # phases

# Columns of a route: the point, the leg to it, the hold there, how a plane reaches it, and when it was reached.
SPEED, HOLD, VERTICAL, BY_ALTITUDE, REACHED, SPLINE, ROUTE = 3, 4, 5, 6, 7, 8, 9
AT_ONCE = -1.0  # of BY_ALTITUDE: a plane turns and climbs to it at once, and has reached it once it circles there

# Float columns. First what the vehicle does ...
POSITION, VELOCITY, THRUST, INTEGRAL = 0, 3, 6, 9  # three each; thrust: acceleration by leaning; sum of velocity errors
# ... then where its navigator has got to ...
TARGET, TARGET_VELOCITY, TARGET_ACCELERATION, ORIGIN = 12, 15, 18, 21  # three each; origin: where the leg began
ELAPSED, HOLD_LEFT, BRAKED, PACE, TURN_SPEED = 24, 25, 26, 27, 28  # clocks; share of a halt braked; a turn's speed
# ... then its limits, which never change in flight ...
ACCELERATION, JERK, SNAP, VERTICAL_ACCELERATION, CLIMB, DESCENT, RADIUS, TURN_RADIUS = range(29, 37)
POSITION_GAIN, VELOCITY_GAIN, INTEGRAL_GAIN, LEAN, DRAG, DRAG_SQUARED, LOITER_RADIUS = range(37, 44)
NEW_SPEED = 44  # told by set_speed and not yet taken up; else NaN
WIND = 45  # two: velocity of the air, east and north
# ... then what a copter's controllers remember (two each, east and north) and their gains and lags (see airframe) ...
ERROR, DAMPING, LEAN_TARGET = 47, 49, 51
DAMPING_GAIN, ERROR_SHARE, LEAN_SHARE, RATE_SHARE = range(53, 57)  # shares: of its way that a lag goes in a step
ALTITUDE_GAIN, RISE_GAIN, LIFT_GAIN, LIFT_INTEGRAL_GAIN, DRAG_VERTICAL = range(57, 62)
RISE_JERK, TOUCHDOWN_RATE, TOUCHDOWN_HEIGHT = range(62, 65)  # how ArduCopter takes off and lands
CORNER_ACCELERATION, RUN = 65, 66  # of ArduCopter; its target's speed along a spline
# ... then ArduCopter's three legs (flown before, now, next; S-curves or splines), LEG columns each.
LEGS = 67

# Columns of a leg: unit vector, length, time flown, greatest speed and acceleration along it, whether it is a spline,
# how old it is when the next one begins; then its segments.
UX, LENGTH, TIME, TOP, ACC, CURVED, CORNER, SEGMENT_0 = 0, 3, 4, 5, 6, 7, 8, 9
# ... or, of a spline leg (CURVED), where segments would be: the polynomial's coefficients of t, t^2, t^3 and the
# derivative it was to arrive with (three each), its greatest speeds upwards, downwards, at its start and its end.
HERMITE, ARRIVAL, TOP_UP, TOP_DOWN, TOP_START, TOP_END = 9, 18, 21, 22, 23, 24
# Columns of a segment: jerk is H (1 - S cos(pi t / DURATION)); T, A, V, P hold at its start
DURATION, H, S, T, A, V, P, SEGMENT = range(8)
SEGMENTS = 22
LEG = SEGMENT_0 + (SEGMENTS + 1) * SEGMENT
FLOATS = LEGS + 3 * LEG

# Columns of PX4 multicopters, where ArduCopter has its legs. Points before, at and after the one it aims at, the
# velocity it wants, the acceleration it feels (three each); the rotors' pull beyond the weight, ...
BEFORE, AIM, AFTER, WANTED, FELT = (LEGS + 3 * i for i in range(5))
LIFT, HOVER, RAMP, GROUND = range(LEGS + 15, LEGS + 19)
# ... then its limits.
CORNER_GAIN, LAG_MAX, ALTITUDE_RADIUS, SPEED_MAX, CLIMB_ACCELERATION, DESCENT_ACCELERATION = range(LEGS + 19, LEGS + 25)
TAKEOFF_SPEED, TAKEOFF_RAMP, LAND_SPEED, CRAWL, SLOW_BELOW, LAND_BELOW, CRAWL_BELOW = range(LEGS + 25, LEGS + 32)
DERIVATIVE_GAIN, VERTICAL_POSITION_GAIN, VERTICAL_VELOCITY_GAIN, VERTICAL_INTEGRAL_GAIN = range(LEGS + 32, LEGS + 36)
LIFT_MAX, HOVER_GAIN = LEGS + 36, LEGS + 37

# Columns of planes, where copters have their legs. First their parameters (see vehicle.PlaneTuning), ...
L1_PERIOD, L1_DAMPING, L1_INTEGRAL, ROLL_MAX, PITCH_MAX, PITCH_MIN, ROLL_TIME, PITCH_TIME = range(LEGS, LEGS + 8)
AIRSPEED_MIN, AIRSPEED_MAX, CRUISE, CRUISE_THROTTLE, THROTTLE_SLEW, SINK_MIN = range(LEGS + 8, LEGS + 14)
ENERGY_TIME, TAKEOFF_PITCH, LEVEL_OFF_TIME, SLOPE_MIN, SENSOR_FACTOR, THRUST_MAX = range(LEGS + 14, LEGS + 20)
# ... then how they fly: Euler angles, turn rates about the body's axes (three), deflections of aileron and elevator,
# and what their controllers ask for and remember: all this is trimmed anew where a flight begins in the air, ...
ROLL, PITCH, YAW, SPIN, SERVO, SERVO_INTEGRAL, SPIN_WANTED = (LEGS + i for i in (20, 21, 22, 23, 26, 28, 30))
THROTTLE, THROTTLE_SENT, ROLL_WANTED, PITCH_WANTED, THROTTLE_WANTED, RUSH, RUSH_LAGGED = range(LEGS + 32, LEGS + 39)
HEIGHT_ASKED, HEIGHT_LIMITED, HEIGHT_LAGGED, HEIGHT_OFFSET, HEIGHT_WANTED = range(LEGS + 39, LEGS + 44)
CLIMB_SHARE, SINK_SHARE, SPEED_WANTED, SPEED_LAGGED, SPEED_INTEGRAL, FASTEST = range(LEGS + 44, LEGS + 50)
PITCH_INTEGRAL, PITCH_UNLIMITED, PITCH_RAW, PITCH_CLIPPED, CROSS_INTEGRAL, LAST_BEND = range(LEGS + 50, LEGS + 56)
THROTTLE_RAW, THROTTLE_INTEGRAL, THROTTLE_CLIPPED, ENERGY_RATE_ERROR = range(LEGS + 56, LEGS + 60)
# ... then where they have got to.
AIRBORNE, FAST_TIME, CLOCK, DIRECT, SLOPE, LEVEL_OFF, ON_CIRCLE, HEADING = range(LEGS + 60, LEGS + 68)
DENSITY, SENSOR = range(LEGS + 68, LEGS + 70)  # of the air here; true airspeed per one that is read

_GRAVITY_M_S2 = 9.80665


def initial(model: MotionModel, position_m: npt.ArrayLike) -> tuple[FloatArray, IntArray]:
    """Return the rows of a vehicle at rest.

    Gains and accelerations are the autopilots' defaults (ArduCopter 4.5: PSC_*, WPNAV_*, ANGLE_MAX, ATC_INPUT_TC;
    PX4 1.15: MPC_*). Drag is that of the airframes the autopilots simulate: it fixes how long the integrator takes to
    lean the vehicle into a new speed, and how fast it can fly at all.
    """
    row = np.zeros(FLOATS)
    number = np.zeros(INTEGERS, dtype=np.int64)
    row[POSITION : POSITION + 3] = row[TARGET : TARGET + 3] = row[ORIGIN : ORIGIN + 3] = position_m
    row[PACE] = 1.0
    row[NEW_SPEED] = math.nan
    row[ACCELERATION] = model.acceleration_m_s2
    row[JERK] = model.jerk_m_s3
    row[CLIMB] = model.climb_rate_m_s
    row[DESCENT] = model.descent_rate_m_s
    row[RADIUS] = model.waypoint_radius_m
    row[TURN_RADIUS] = model.turn_radius_m
    row[LOITER_RADIUS] = model.loiter_radius_m
    row[WIND : WIND + 2] = model.wind_m_s
    if model.vehicle_class == "plane":
        number[NAVIGATOR] = PLANE
        _tune_plane(row, model)
    elif model.autopilot == "ardupilot":
        number[NAVIGATOR] = ARDUCOPTER
        _tune_arducopter(row, model.arducopter)
    else:
        number[NAVIGATOR] = PX4
        _tune(row, model.px4)
    if model.vehicle_class == "copter":  # it leans into the wind as soon as it has lifted off
        trim = -(row[DRAG] + row[DRAG_SQUARED] * math.hypot(*model.wind_m_s)) * row[WIND : WIND + 2]
        row[LEAN_TARGET : LEAN_TARGET + 2] = row[THRUST : THRUST + 2] = row[INTEGRAL : INTEGRAL + 2] = trim
    return row, number


def _share(time_s: float) -> float:
    """Return how much of its way a first-order lag goes in a step of ArduCopter's."""
    return STEP_S / (STEP_S + time_s)


def _tune_arducopter(row: FloatArray, tuning: ArducopterTuning) -> None:
    """Write an ArduCopter's parameters."""
    row[VERTICAL_ACCELERATION] = tuning.vertical_acceleration_m_s2
    row[CORNER_ACCELERATION] = tuning.corner_acceleration_m_s2 or 2.0 * row[ACCELERATION]
    row[SNAP] = 0.25 * math.pi * row[JERK] / max(tuning.input_time_s, 0.1)  # half of what the attitude allows
    row[POSITION_GAIN] = tuning.position_gain
    row[VELOCITY_GAIN], row[INTEGRAL_GAIN], row[DAMPING_GAIN] = tuning.velocity_gains
    row[ERROR_SHARE] = _share(1.0 / (2.0 * math.pi * 5.0))  # PSC_VELXY_FLTE, _FLTD
    row[LEAN] = _GRAVITY_M_S2 * math.tan(math.radians(tuning.lean_deg))
    row[LEAN_SHARE] = _share(tuning.input_time_s)
    row[RATE_SHARE] = _share(0.14)  # the rate controller and the rotors
    row[DRAG], row[DRAG_SQUARED] = 0.48, 0.0064  # 10.35 m/s at 30 deg (measured)
    row[ALTITUDE_GAIN], row[RISE_GAIN] = tuning.vertical_gains
    throttle = _GRAVITY_M_S2 / 0.39  # acceleration per throttle: MOT_THST_HOVER
    row[LIFT_GAIN], row[LIFT_INTEGRAL_GAIN] = 0.05 * throttle, 0.1 * throttle  # PSC_ACCZ_P, _I
    row[DRAG_VERTICAL] = 0.5
    row[RISE_JERK] = tuning.vertical_jerk_m_s3
    row[TOUCHDOWN_RATE], row[TOUCHDOWN_HEIGHT] = tuning.land_speed_m_s, tuning.land_slow_below_m


def _tune(row: FloatArray, px4: Px4Tuning) -> None:
    """Write a PX4 multicopter's parameters."""
    row[CORNER_GAIN], row[LAG_MAX], row[ALTITUDE_RADIUS] = px4.corner_gain, px4.lag_max_m, px4.altitude_radius_m
    row[SPEED_MAX] = px4.speed_max_m_s
    row[CLIMB_ACCELERATION] = px4.climb_acceleration_m_s2
    row[DESCENT_ACCELERATION] = px4.descent_acceleration_m_s2
    row[TAKEOFF_SPEED], row[TAKEOFF_RAMP] = px4.takeoff_speed_m_s, px4.takeoff_ramp_s
    row[LAND_SPEED], row[CRAWL] = px4.land_speed_m_s, px4.land_crawl_m_s
    row[SLOW_BELOW], row[LAND_BELOW], row[CRAWL_BELOW] = px4.slow_below_m, px4.land_below_m, px4.crawl_below_m
    row[POSITION_GAIN], row[VERTICAL_POSITION_GAIN] = px4.position_gain, px4.vertical_position_gain
    row[VELOCITY_GAIN], row[INTEGRAL_GAIN], row[DERIVATIVE_GAIN] = px4.velocity_gains
    row[VERTICAL_VELOCITY_GAIN], row[VERTICAL_INTEGRAL_GAIN] = px4.vertical_velocity_gains
    row[LEAN] = _GRAVITY_M_S2 * math.tan(math.radians(px4.tilt_max_deg))
    row[LIFT_MAX] = _GRAVITY_M_S2 * px4.thrust_max
    row[DRAG] = px4.drag_s
    row[HOVER], row[HOVER_GAIN] = 1.0, 0.07
    row[GROUND], row[RAMP] = -math.inf, math.inf


def _tune_plane(row: FloatArray, model: MotionModel) -> None:
    """Write a plane's parameters."""
    plane = model.plane
    row[L1_PERIOD], row[L1_DAMPING], row[L1_INTEGRAL] = plane.l1_period_s, plane.l1_damping, plane.l1_integral
    row[ROLL_MAX] = math.radians(plane.roll_max_deg)
    row[PITCH_MIN], row[PITCH_MAX] = map(math.radians, plane.pitch_range_deg)
    row[ROLL_TIME], row[PITCH_TIME] = plane.roll_time_s, plane.pitch_time_s
    slowest, fastest = model.airspeed_limits_m_s
    row[AIRSPEED_MIN], row[AIRSPEED_MAX] = slowest or 10.0, fastest if fastest < math.inf else 30.0
    row[CRUISE], row[CRUISE_THROTTLE] = model.cruise_speed_m_s, plane.cruise_throttle
    row[THROTTLE_SLEW], row[SINK_MIN], row[ENERGY_TIME] = plane.throttle_slew, plane.sink_min_m_s, plane.energy_time_s
    row[THRUST_MAX] = _GRAVITY_M_S2 * plane.thrust_to_weight
    row[TAKEOFF_PITCH], row[LEVEL_OFF_TIME] = math.radians(plane.takeoff_pitch_deg), plane.level_off_s
    row[SLOPE_MIN], row[SENSOR_FACTOR] = plane.slope_min_m, 1.0 + plane.airspeed_reads_low
