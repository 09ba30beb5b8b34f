"""How a copter follows its navigator's target: the position controller, the lean limit and the air's drag."""

from __future__ import annotations

import math

from missionplanner.motion.state import (
    DRAG,
    DRAG_SQUARED,
    INTEGRAL,
    INTEGRAL_GAIN,
    LEAN,
    POSITION,
    POSITION_GAIN,
    TARGET,
    TARGET_ACCELERATION,
    TARGET_VELOCITY,
    THRUST,
    VELOCITY,
    VELOCITY_GAIN,
    WIND,
    FloatArray,
    kernel,
)

_LEAN_TIME_S = 0.15  # how fast the vehicle leans: ATC_INPUT_TC, MC_ROLL_P


@kernel
def follow_target(s: FloatArray, h: float) -> None:
    """Move the vehicle by ``h`` seconds: horizontally after its target, vertically with it.

    P on the position, PI on the velocity, feed-forward of the target's velocity and acceleration; the sum is what the
    vehicle leans for, up to its lean limit, against a drag that grows with its speed through the air.
    """
    wish_x = _wish(s, 0)
    wish_y = _wish(s, 1)
    total = math.hypot(wish_x, wish_y)
    limited = total > s[LEAN]
    if limited:
        wish_x *= s[LEAN] / total
        wish_y *= s[LEAN] / total
    speed = math.hypot(s[VELOCITY] - s[WIND], s[VELOCITY + 1] - s[WIND + 1])
    drag = s[DRAG] + s[DRAG_SQUARED] * speed
    share = min(1.0, h / _LEAN_TIME_S)
    for axis in range(2):
        error = _velocity_error(s, axis)
        if not limited or error * s[INTEGRAL + axis] < 0.0:  # no wind-up against the lean limit
            s[INTEGRAL + axis] += s[INTEGRAL_GAIN] * error * h
        s[THRUST + axis] += ((wish_x if axis == 0 else wish_y) - s[THRUST + axis]) * share
        before = s[VELOCITY + axis]
        s[VELOCITY + axis] += (s[THRUST + axis] - drag * (before - s[WIND + axis])) * h
        s[POSITION + axis] += 0.5 * (before + s[VELOCITY + axis]) * h
    s[VELOCITY + 2] = s[TARGET_VELOCITY + 2]
    s[POSITION + 2] = s[TARGET + 2]


@kernel
def _velocity_error(s: FloatArray, axis: int) -> float:
    """Return the velocity wanted less the one flown."""
    lag = s[TARGET + axis] - s[POSITION + axis]
    return s[TARGET_VELOCITY + axis] + s[POSITION_GAIN] * lag - s[VELOCITY + axis]


@kernel
def _wish(s: FloatArray, axis: int) -> float:
    """Return the acceleration that the controller asks for."""
    return s[TARGET_ACCELERATION + axis] + s[VELOCITY_GAIN] * _velocity_error(s, axis) + s[INTEGRAL + axis]
