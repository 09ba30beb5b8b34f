"""Routes, and those that autopilots fly on their own: take-off, landing, the way home."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner.geodesy import FloatArray
from missionplanner.motion.state import AT_ONCE
from missionplanner.vehicle import MotionModel

_ARDUCOPTER_SPOOL_S = 0.8  # from the command to the lift-off: MOT_SPOOL_TIME, TKOFF_SLEW_TIME
_NO_CLIMB_M = 0.1
_LANDING_RAMPS_S = 4.0  # what gaining and losing speed takes
_STOP_S = 1e-3  # a hold so short that it only makes the vehicle stop
_ARDUCOPTER_DISARM_S = 2.1  # from touch-down to motors off
_PX4_SPOOL_S = 1.2  # COM_SPOOLUP_TIME, and the command on its way
_PX4_DISARM_S = 5.0  # from touch-down to motors off: three times LNDMC_TRIG_TIME, COM_DISARM_LAND


class Route(NamedTuple):
    """Legs to fly one after the other; ``Navigator.follow(i, *route)`` flies them.

    ``points_m`` (W, 3), ``speed_m_s`` (W,) horizontal speed of the leg *to* each point, ``hold_s`` (W,) time to stand
    still at each point, ``vertical_m_s`` (W,) upper bound on the climb and descent rate of each leg, ``by_altitude``
    (W,) whether a plane has reached the point once it is as high or low as that, wherever: take-off and landing; or, on
    its way home (-1), once it circles there; ``spline`` (W,) whether an ArduCopter flies a spline to the point.
    """

    points_m: FloatArray
    speed_m_s: FloatArray
    hold_s: FloatArray
    vertical_m_s: FloatArray
    by_altitude: FloatArray
    spline: FloatArray

    @classmethod
    def through(
        cls,
        points_m: npt.ArrayLike,
        speed_m_s: npt.ArrayLike,
        hold_s: npt.ArrayLike | None = None,
        vertical_m_s: npt.ArrayLike | None = None,
        by_altitude: npt.ArrayLike | None = None,
        spline: npt.ArrayLike | None = None,
    ) -> Route:
        """Return a route through points (W, 3); scalars hold for every leg. No hold, no vertical bound by default."""
        points = np.array(points_m, dtype=float).reshape(-1, 3)

        def each(value: npt.ArrayLike | None, default: float) -> FloatArray:
            return np.array(np.broadcast_to(np.asarray(default if value is None else value, dtype=float), len(points)))

        return cls(
            points,
            each(speed_m_s, 0.0),
            each(hold_s, 0.0),
            each(vertical_m_s, math.inf),
            each(by_altitude, 0.0),
            each(spline, 0.0),
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
    spool_s = _ARDUCOPTER_SPOOL_S if model.autopilot == "ardupilot" else _PX4_SPOOL_S
    return Route.through([home, top], model.climb_rate_m_s, [spool_s, 0.0], by_altitude=[0.0, 1.0])


def landing_points(model: MotionModel, from_m: npt.ArrayLike, ground_amsl_m: float, speed_m_s: float = 15.0) -> Route:
    """Return the landing straight below ``from_m`` (3,), up to the moment the motors stop.

    A plane glides towards that place at ``speed_m_s`` and straight on beyond it until it meets the ground.
    """
    start = np.asarray(from_m, dtype=float)
    if model.vehicle_class == "plane":
        return Route.through([[start[0], start[1], ground_amsl_m]], speed_m_s, by_altitude=1.0)
    disarm_s = _ARDUCOPTER_DISARM_S if model.autopilot == "ardupilot" else _PX4_DISARM_S
    ground = [[start[0], start[1], ground_amsl_m]]
    return Route.through(ground, model.descent_rate_m_s, disarm_s, _sinking_m_s(model), by_altitude=1.0)


def _sinking_m_s(model: MotionModel) -> float:
    """Return how fast a copter comes down to where it slows down to land."""
    high_m_s = model.arducopter.land_high_speed_m_s if model.autopilot == "ardupilot" else 0.0
    return min(high_m_s or model.descent_rate_m_s, model.descent_rate_m_s)


def landing_s(model: MotionModel, height_m: float) -> float:
    """Return an upper bound on the time in which a copter comes down from a height over the ground."""
    slow_m, slow_m_s = model.arducopter.land_slow_below_m, model.arducopter.land_speed_m_s
    if model.autopilot == "px4":
        slow_m, slow_m_s = model.px4.slow_below_m, model.px4.land_speed_m_s
    slow_m = min(slow_m, height_m)
    return (height_m - slow_m) / _sinking_m_s(model) + slow_m / slow_m_s + _LANDING_RAMPS_S


def return_points(model: MotionModel, from_m: npt.ArrayLike, home_m: npt.ArrayLike) -> Route:
    """Return the way home (RTL): up to the return height if below it, straight home, wait, land.

    A plane turns home and climbs at once, or sinks on the way, at its cruise speed; it circles there: nobody lands it.
    """
    start = np.asarray(from_m, dtype=float)
    home = np.asarray(home_m, dtype=float)
    height = model.return_alt_amsl_m(float(start[2]), float(home[2]))
    above = np.array([home[0], home[1], height])
    if model.vehicle_class == "plane":
        return Route.through([above], model.cruise_speed_m_s, by_altitude=AT_ONCE)
    ardupilot = model.autopilot == "ardupilot"
    speed_m_s = model.arducopter.homing_m_s if ardupilot else model.px4.return_speed_m_s
    wait_s = model.arducopter.return_wait_s if ardupilot else model.px4.return_wait_s
    top = np.array([start[0], start[1], height])
    stop_s = 0.0
    if ardupilot and height < start[2] + _NO_CLIMB_M:
        top = above  # no climb
    elif ardupilot:
        stop_s = _STOP_S  # it flies the climb and the way home as legs of their own
    landing = landing_points(model, above, float(home[2]))
    lower = np.array([home[0], home[1], home[2] + model.px4.return_descend_m])
    if ardupilot or lower[2] >= height:
        legs = [Route.through(np.array([top, above]), speed_m_s, [stop_s, wait_s]), landing]
    else:
        legs = [Route.through(np.array([top, above, lower]), speed_m_s, [0.0, 0.0, wait_s]), landing]
    return Route(*(np.concatenate(column) for column in zip(*legs, strict=True)))
