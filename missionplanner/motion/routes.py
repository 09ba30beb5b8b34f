"""Routes, and those that autopilots fly on their own: take-off, landing, the way home."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner.geodesy import FloatArray
from missionplanner.vehicle import MotionModel

_ARDUCOPTER_SPOOL_S = 0.2  # from the command to the first movement, what a smoother start than measured leaves of it
_PX4_SPOOL_S = 3.7
_PX4_DISARM_S = 2.5  # from touch-down to motors off
_SLOW_BELOW_M = 10.0  # LAND_ALT_LOW, MPC_LAND_ALT1: the descent slows down this high above the ground
_PX4_RTL_SPEED_M_S = 10.0


class Route(NamedTuple):
    """Legs to fly one after the other; ``Navigator.follow(i, *route)`` flies them.

    ``points_m`` (W, 3), ``speed_m_s`` (W,) horizontal speed of the leg *to* each point, ``hold_s`` (W,) time to stand
    still at each point, ``vertical_m_s`` (W,) upper bound on the climb and descent rate of each leg, ``by_altitude``
    (W,) whether a plane has reached the point once it is as high or low as that, wherever: take-off and landing.
    """

    points_m: FloatArray
    speed_m_s: FloatArray
    hold_s: FloatArray
    vertical_m_s: FloatArray
    by_altitude: FloatArray

    @classmethod
    def through(
        cls,
        points_m: npt.ArrayLike,
        speed_m_s: npt.ArrayLike,
        hold_s: npt.ArrayLike | None = None,
        vertical_m_s: npt.ArrayLike | None = None,
        by_altitude: npt.ArrayLike | None = None,
    ) -> Route:
        """Return a route through points (W, 3); scalars hold for every leg. No hold, no vertical bound by default."""
        points = np.array(points_m, dtype=float).reshape(-1, 3)

        def each(value: npt.ArrayLike | None, default: float) -> FloatArray:
            return np.array(np.broadcast_to(np.asarray(default if value is None else value, dtype=float), len(points)))

        return cls(
            points, each(speed_m_s, 0.0), each(hold_s, 0.0), each(vertical_m_s, math.inf), each(by_altitude, 0.0)
        )


def takeoff_points(model: MotionModel, home_m: npt.ArrayLike, top_m: npt.ArrayLike) -> Route:
    """Return the take-off from rest at ``home_m`` (3,) to ``top_m`` (3,): a copter's is vertical.

    A plane rolls towards the top and climbs straight on until it is as high, at its cruise speed: the mission's comes
    after the take-off. A copter's route has one more point at its beginning: the wait for the motors.
    """
    home = np.asarray(home_m, dtype=float)
    top = np.asarray(top_m, dtype=float)
    if model.vehicle_class == "plane":
        return Route.through([top], model.cruise_speed_m_s, by_altitude=1.0)
    if model.autopilot == "ardupilot":
        return Route.through([home, top], model.climb_rate_m_s, [_ARDUCOPTER_SPOOL_S, 0.0])
    knee = np.array([home[0], home[1], min(home[2] + _SLOW_BELOW_M, top[2])])  # MPC_TKO_SPEED up to here
    return Route.through([home, knee, top], model.climb_rate_m_s, [_PX4_SPOOL_S, 0.0, 0.0], [math.inf, 1.5, math.inf])


def landing_points(model: MotionModel, from_m: npt.ArrayLike, ground_amsl_m: float, speed_m_s: float = 15.0) -> Route:
    """Return the landing straight below ``from_m`` (3,), up to the moment the motors stop.

    A plane glides towards that place at ``speed_m_s`` and straight on beyond it until it meets the ground.
    """
    start = np.asarray(from_m, dtype=float)
    if model.vehicle_class == "plane":
        return Route.through([[start[0], start[1], ground_amsl_m]], speed_m_s, by_altitude=1.0)
    slow = (
        [(_SLOW_BELOW_M, math.inf), (0.0, 0.5)]  # LAND_SPEED
        if model.autopilot == "ardupilot"
        else [(_SLOW_BELOW_M, math.inf), (5.0, 1.0), (0.0, 0.55)]  # MPC_LAND_SPEED, blended in below MPC_LAND_ALT1
    )
    legs = [(height, rate) for height, rate in slow if ground_amsl_m + height < start[2] or height == 0.0]
    points = np.array([[start[0], start[1], ground_amsl_m + height] for height, _ in legs])
    # ArduCopter slows down nearly to a stop before its slow descent; these ramps are as long as its wait on the ground
    hold_s = np.full(len(legs), 0.05 if model.autopilot == "ardupilot" else 0.0)
    hold_s[-1] = 0.0 if model.autopilot == "ardupilot" else _PX4_DISARM_S
    return Route.through(points, model.descent_rate_m_s, hold_s, [rate for _, rate in legs])


def return_points(model: MotionModel, from_m: npt.ArrayLike, home_m: npt.ArrayLike) -> Route:
    """Return the way home (RTL): up to the return height if below it, straight home, wait, land.

    A plane climbs or sinks on the way, at its cruise speed, and then circles above home: nobody lands it.
    """
    start = np.asarray(from_m, dtype=float)
    home = np.asarray(home_m, dtype=float)
    height = model.return_alt_amsl_m(float(start[2]), float(home[2]))
    above = np.array([home[0], home[1], height])
    if model.vehicle_class == "plane":
        return Route.through([above], model.cruise_speed_m_s)
    ardupilot = model.autopilot == "ardupilot"
    speed_m_s = model.arducopter.homing_m_s if ardupilot else _PX4_RTL_SPEED_M_S
    wait_s = model.arducopter.return_wait_s if ardupilot else 0.0  # RTL_LAND_DELAY
    way = Route.through(np.array([[start[0], start[1], height], above]), speed_m_s, [0.0, wait_s])
    down = landing_points(model, above, float(home[2]))
    return Route(*(np.concatenate(pair) for pair in zip(way, down, strict=True)))
