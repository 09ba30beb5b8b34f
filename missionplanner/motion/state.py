"""The kernels' state: one row of floats, one row of integers and one padded route per vehicle.

Flat rows with named columns, not structs of arrays: they compile several times faster and sit in one cache line each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from numba import njit

from missionplanner.vehicle import MotionModel

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


# Integer columns.
NAVIGATOR, PHASE, WAYPOINT, COUNT, HALTED, SLOT, STALE, INTEGERS = range(8)
ARDUCOPTER, PX4, PLANE = range(3)  # navigators
IDLE, STARTING, FLYING, HOLDING = range(4)  # phases

# Columns of a route: the point, the leg to it, the hold there, how a plane reaches it, and when it was reached.
SPEED, HOLD, VERTICAL, BY_ALTITUDE, REACHED, ROUTE = 3, 4, 5, 6, 7, 8

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
# ... then ArduCopter's three S-curve legs (flown before, now, next), LEG columns each.
LEGS = 47

# Columns of a leg: unit vector, length, time flown, greatest speed and acceleration along it; then its segments.
UX, LENGTH, TIME, TOP, ACC, SEGMENT_0 = 0, 3, 4, 5, 6, 7
# Columns of a segment: jerk is H (1 - S cos(pi t / DURATION)); T, A, V, P hold at its start
DURATION, H, S, T, A, V, P, SEGMENT = range(8)
SEGMENTS = 22
LEG = SEGMENT_0 + (SEGMENTS + 1) * SEGMENT
FLOATS = LEGS + 3 * LEG

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
        row[VERTICAL_ACCELERATION] = 3.0  # TECS_VERT_ACC is 7; kept gentle as pitch limits do
    elif model.autopilot == "ardupilot":
        number[NAVIGATOR] = ARDUCOPTER
        row[VERTICAL_ACCELERATION] = 1.0  # WPNAV_ACCEL_Z
        row[SNAP] = 0.25 * math.pi * model.jerk_m_s3 / 0.15  # half of what ATC_INPUT_TC allows
        row[POSITION_GAIN], row[VELOCITY_GAIN], row[INTEGRAL_GAIN] = 1.0, 2.0, 1.0  # PSC_POSXY_P, PSC_VELXY_P, _I
        row[LEAN] = _GRAVITY_M_S2 * math.tan(math.radians(30.0))  # ANGLE_MAX
        row[DRAG], row[DRAG_SQUARED] = 0.31, 0.023  # 10.35 m/s at 30 deg, 15 m/s at 45 deg (measured)
    else:
        number[NAVIGATOR] = PX4
        row[VERTICAL_ACCELERATION] = 3.0  # MPC_ACC_DOWN_MAX
        row[POSITION_GAIN], row[VELOCITY_GAIN], row[INTEGRAL_GAIN] = 0.95, 1.8, 0.4  # MPC_XY_P, MPC_XY_VEL_*_ACC
        row[LEAN] = _GRAVITY_M_S2 * math.tan(math.radians(45.0))  # MPC_TILTMAX_AIR
        row[DRAG] = 1.0  # SIH_KDV / SIH_MASS
    if model.vehicle_class == "copter":  # it leans into the wind as soon as it has lifted off
        trim = -(row[DRAG] + row[DRAG_SQUARED] * math.hypot(*model.wind_m_s)) * row[WIND : WIND + 2]
        row[THRUST : THRUST + 2] = row[INTEGRAL : INTEGRAL + 2] = trim
    return row, number
