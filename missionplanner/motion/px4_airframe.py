"""How a PX4 multicopter follows its trajectory: the position controller, the tilt and thrust limits, the air's drag.

mc_pos_control of PX4 1.15 with the simulator (SIH) that it brings along. Drag is linear and so strong there that a
fast vehicle leans far over: the integrator needs seconds to find that lean, and the vehicle lags meanwhile.
"""

from __future__ import annotations

import math

from missionplanner.motion.state import (
    DERIVATIVE_GAIN,
    DESCENT,
    DRAG,
    DRAG_SQUARED,
    FELT,
    GROUND,
    HOVER,
    HOVER_GAIN,
    INTEGRAL,
    INTEGRAL_GAIN,
    LEAN,
    LIFT,
    LIFT_MAX,
    POSITION,
    POSITION_GAIN,
    SPEED_MAX,
    TARGET,
    TARGET_ACCELERATION,
    TARGET_VELOCITY,
    THRUST,
    VELOCITY,
    VELOCITY_GAIN,
    VERTICAL_INTEGRAL_GAIN,
    VERTICAL_POSITION_GAIN,
    VERTICAL_VELOCITY_GAIN,
    WIND,
    FloatArray,
    kernel,
)

_GRAVITY_M_S2 = 9.80665
_LEAN_TIME_S = 0.17  # 1 / MC_ROLL_P and the rate loop behind it
_MOTOR_TIME_S = 0.05  # SIH_T_TAU
_HOVER_NOISE_1_S = 0.072  # HTE_HT_NOISE * g / MPC_THR_HOVER per 1 m/s^2, the least noise that is assumed
_HOVER_RATE_M_S = 2.0  # HTE_VZ_THR
_NOISE = 0.02  # of the thrust that is asked for, as a share of the weight: what is cut off of it unwinds too
_DESCENT_STRETCH = 1.2  # what FlightTaskAuto leaves the controller to correct the height with


@kernel
def follow_target(s: FloatArray, h: float, rise_max: float) -> None:
    """Move the vehicle by ``h`` seconds after its target, rising at ``rise_max`` m/s at most.

    P on the position, PID on the velocity, feed-forward of the target's velocity and acceleration. The lean is found
    as if the rotors carried just the weight, so that a vehicle that climbs is pushed harder than it asked for.
    """
    lift = _lift_wanted(s, h, rise_max)
    weight = _GRAVITY_M_S2 + lift
    x = s[TARGET_VELOCITY] + s[POSITION_GAIN] * (s[TARGET] - s[POSITION])
    y = s[TARGET_VELOCITY + 1] + s[POSITION_GAIN] * (s[TARGET + 1] - s[POSITION + 1])
    over = math.hypot(x, y) / s[SPEED_MAX]
    if over > 1.0:
        x, y = x / over, y / over
    x -= s[VELOCITY]
    y -= s[VELOCITY + 1]
    wish_x = s[TARGET_ACCELERATION] + s[VELOCITY_GAIN] * x + s[INTEGRAL] - s[DERIVATIVE_GAIN] * s[FELT]
    wish_y = s[TARGET_ACCELERATION + 1] + s[VELOCITY_GAIN] * y + s[INTEGRAL + 1] - s[DERIVATIVE_GAIN] * s[FELT + 1]
    wish = math.hypot(wish_x, wish_y)
    lean = min(wish, s[LEAN])
    lean = min(lean, math.sqrt(max(s[LIFT_MAX] ** 2 - weight * weight, 0.0)) * _GRAVITY_M_S2 / weight)
    made = lean * weight / (_GRAVITY_M_S2 * s[HOVER])
    short = 1.0 - made / wish if wish > 0.0 else 0.0
    unwind = (short + math.sqrt(short * short + _NOISE**2)) / s[VELOCITY_GAIN]
    if s[POSITION + 2] > s[GROUND]:
        s[INTEGRAL] += s[INTEGRAL_GAIN] * (x - unwind * wish_x) * h
        s[INTEGRAL + 1] += s[INTEGRAL_GAIN] * (y - unwind * wish_y) * h

    share = lean / wish if wish > 0.0 else 0.0
    s[THRUST] += (wish_x * share - s[THRUST]) * min(1.0, h / _LEAN_TIME_S)
    s[THRUST + 1] += (wish_y * share - s[THRUST + 1]) * min(1.0, h / _LEAN_TIME_S)
    s[LIFT] += (lift - s[LIFT]) * min(1.0, h / _MOTOR_TIME_S)
    push = 1.0 + s[LIFT] / _GRAVITY_M_S2
    _learn_hover(s, h, push)
    air_x = s[VELOCITY] - s[WIND]
    air_y = s[VELOCITY + 1] - s[WIND + 1]
    drag = s[DRAG] + s[DRAG_SQUARED] * math.sqrt(air_x * air_x + air_y * air_y + s[VELOCITY + 2] ** 2)
    s[FELT] = s[THRUST] * push - drag * air_x
    s[FELT + 1] = s[THRUST + 1] * push - drag * air_y
    s[FELT + 2] = s[LIFT] - drag * s[VELOCITY + 2]
    standing = s[POSITION + 2] <= s[GROUND]
    for axis in range(3):
        if axis < 2 and standing:
            continue
        before = s[VELOCITY + axis]
        s[VELOCITY + axis] += s[FELT + axis] * h
        s[POSITION + axis] += 0.5 * (before + s[VELOCITY + axis]) * h
    if s[POSITION + 2] < s[GROUND]:
        s[POSITION + 2] = s[GROUND]
        s[VELOCITY + 2] = max(s[VELOCITY + 2], 0.0)
        s[VELOCITY] = s[VELOCITY + 1] = s[FELT + 2] = 0.0


@kernel
def _learn_hover(s: FloatArray, h: float, push: float) -> None:
    """Estimate the thrust that hovers, as a multiple of the true one (a Kalman filter of one state, MPC_USE_HTE).

    It takes drag for weight: after a climb it is too high for about 14 s, and the controller, which thinks that it gets
    less than it asked for, unwinds its integrators.
    """
    if s[POSITION + 2] - s[GROUND] < 1.0:
        return
    noise = max(abs(s[VELOCITY + 2]) - _HOVER_RATE_M_S + 1.0, 1.0) ** 2
    slope = push / s[HOVER] ** 2
    gain = s[HOVER_GAIN] * h * slope / noise
    spread = 1.0 + gain * slope
    s[HOVER] += gain / spread * (push / s[HOVER] - 1.0 - s[FELT + 2] / _GRAVITY_M_S2)
    s[HOVER_GAIN] = (s[HOVER_GAIN] + _HOVER_NOISE_1_S**2 * h) / spread


@kernel
def _lift_wanted(s: FloatArray, h: float, rise_max: float) -> float:
    """Return the upward acceleration, beyond what carries the weight, that the controller asks for."""
    rate = s[TARGET_VELOCITY + 2] + s[VERTICAL_POSITION_GAIN] * (s[TARGET + 2] - s[POSITION + 2])
    error = min(max(rate, -_DESCENT_STRETCH * s[DESCENT]), rise_max) - s[VELOCITY + 2]
    wish = s[TARGET_ACCELERATION + 2] + s[VERTICAL_VELOCITY_GAIN] * error + s[INTEGRAL + 2]
    lift = min(max(wish, -_GRAVITY_M_S2), s[LIFT_MAX] - _GRAVITY_M_S2)
    if lift == wish or error * wish < 0.0:  # no wind-up against the limits
        s[INTEGRAL + 2] += s[VERTICAL_INTEGRAL_GAIN] * error * h
    return lift
