"""How a copter follows its navigator's target: the position controller, the lean limit and the air's drag."""

from __future__ import annotations

import math

from missionplanner.motion.state import (
    ALTITUDE_GAIN,
    DAMPING,
    DAMPING_GAIN,
    DRAG,
    DRAG_SQUARED,
    DRAG_VERTICAL,
    ERROR,
    ERROR_SHARE,
    INTEGRAL,
    INTEGRAL_GAIN,
    LEAN,
    LEAN_SHARE,
    LEAN_TARGET,
    LIFT_GAIN,
    LIFT_INTEGRAL_GAIN,
    POSITION,
    POSITION_GAIN,
    RATE_SHARE,
    RISE_GAIN,
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


@kernel
def follow_target(s: FloatArray, h: float) -> None:
    """Move the vehicle by ``h`` seconds, which its lags were made for, after its target.

    P on the position, PID on the velocity, feed-forward of the target's velocity and acceleration; the sum is what the
    vehicle leans for, up to its lean limit, against a drag that grows with its speed through the air. At the limit,
    what keeps it on its way comes first (AC_PosControl, limit_accel_xy).
    """
    wish_x = _wish(s, 0, h)
    wish_y = _wish(s, 1, h)
    asked_x = asked_y = held = 0.0
    total2 = wish_x * wish_x + wish_y * wish_y
    limited = total2 > s[LEAN] * s[LEAN]
    if limited:
        asked_x, asked_y = wish_x, wish_y
        wish_x, wish_y = _within_lean(s, wish_x, wish_y)
        held = math.hypot(s[INTEGRAL], s[INTEGRAL + 1])
    air_x, air_y = s[VELOCITY] - s[WIND], s[VELOCITY + 1] - s[WIND + 1]
    drag = s[DRAG] + s[DRAG_SQUARED] * math.sqrt(air_x * air_x + air_y * air_y)
    s[INTEGRAL] += s[INTEGRAL_GAIN] * s[ERROR] * h
    s[INTEGRAL + 1] += s[INTEGRAL_GAIN] * s[ERROR + 1] * h
    if limited and s[ERROR] * asked_x + s[ERROR + 1] * asked_y > 0.0:  # no wind-up against the lean limit
        share = min(1.0, held / max(math.hypot(s[INTEGRAL], s[INTEGRAL + 1]), 1e-9))
        s[INTEGRAL] *= share
        s[INTEGRAL + 1] *= share
    for axis in range(2):
        wish = wish_x if axis == 0 else wish_y
        s[LEAN_TARGET + axis] += (wish - s[LEAN_TARGET + axis]) * s[LEAN_SHARE]
        s[THRUST + axis] += (s[LEAN_TARGET + axis] - s[THRUST + axis]) * s[RATE_SHARE]
        before = s[VELOCITY + axis]
        s[VELOCITY + axis] += (s[THRUST + axis] - drag * (before - s[WIND + axis])) * h
        s[POSITION + axis] += 0.5 * (before + s[VELOCITY + axis]) * h
    _rise(s, h)


@kernel
def _within_lean(s: FloatArray, wish_x: float, wish_y: float) -> tuple[float, float]:
    """Return an acceleration within the lean limit: what is left of that across its target's way goes along it."""
    lean = s[LEAN]
    wanted = math.hypot(s[TARGET_VELOCITY], s[TARGET_VELOCITY + 1])
    if wanted == 0.0:
        share = lean / math.hypot(wish_x, wish_y)
        return wish_x * share, wish_y * share
    ux, uy = s[TARGET_VELOCITY] / wanted, s[TARGET_VELOCITY + 1] / wanted
    along = wish_x * ux + wish_y * uy
    across = max(-lean, min(lean, wish_y * ux - wish_x * uy))
    most = math.sqrt(max(lean * lean - across * across, 0.0))
    along = max(-most, min(most, along))
    return along * ux - across * uy, along * uy + across * ux


@kernel
def _rise(s: FloatArray, h: float) -> None:
    """Move the vehicle vertically: P on the height, P on the rate, PI on the acceleration, which makes the lift."""
    rate = s[TARGET_VELOCITY + 2] + s[ALTITUDE_GAIN] * (s[TARGET + 2] - s[POSITION + 2])
    wish = s[TARGET_ACCELERATION + 2] + s[RISE_GAIN] * (rate - s[VELOCITY + 2])
    # the lift answers at once to LIFT_GAIN times what the acceleration lacks, and the rest is integrated
    flown = s[LIFT_GAIN] * wish + s[INTEGRAL + 2] - s[DRAG_VERTICAL] * s[VELOCITY + 2]
    flown /= 1.0 + s[LIFT_GAIN]
    s[INTEGRAL + 2] += s[LIFT_INTEGRAL_GAIN] * (wish - flown) * h
    before = s[VELOCITY + 2]
    s[VELOCITY + 2] += flown * h
    s[POSITION + 2] += 0.5 * (before + s[VELOCITY + 2]) * h


@kernel
def _wish(s: FloatArray, axis: int, h: float) -> float:
    """Return the acceleration that the controller asks for, having filtered the error of the velocity."""
    lag = s[TARGET + axis] - s[POSITION + axis]
    error = s[TARGET_VELOCITY + axis] + s[POSITION_GAIN] * lag - s[VELOCITY + axis]
    change = (error - s[ERROR + axis]) * s[ERROR_SHARE]
    s[ERROR + axis] += change
    s[DAMPING + axis] += (change / h - s[DAMPING + axis]) * s[ERROR_SHARE]
    return (
        s[TARGET_ACCELERATION + axis]
        + s[VELOCITY_GAIN] * s[ERROR + axis]
        + s[DAMPING_GAIN] * s[DAMPING + axis]
        + s[INTEGRAL + axis]
    )
