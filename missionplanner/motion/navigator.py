"""N vehicles that fly routes, and the prediction of one flight: the same kernel in the same steps."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from missionplanner.compiled import njit
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.motion import arducopter, plane, px4
from missionplanner.motion.routes import Route
from missionplanner.motion.state import (
    ARDUCOPTER,
    BRAKED,
    BY_ALTITUDE,
    CLIMB,
    COUNT,
    DESCENT,
    ELAPSED,
    FLOATS,
    HALTED,
    HOLD,
    IDLE,
    INTEGERS,
    NAVIGATOR,
    NEW_SPEED,
    PHASE,
    PLANE,
    POSITION,
    PX4,
    REACHED,
    ROUTE,
    SPEED,
    SPLINE,
    STARTING,
    VELOCITY,
    VERTICAL,
    WAYPOINT,
    WIND,
    IntArray,
    initial,
)
from missionplanner.plan import Trajectory
from missionplanner.vehicle import MotionModel

BoolArray = npt.NDArray[np.bool_]

TICK_S = 0.05
"""The step of simulated time."""

_NOWHERE = np.empty((0, 3))


class Navigator:
    """N vehicles that fly routes, advanced together by :data:`TICK_S` per step.

    Parameters
    ----------
    models : N motion models
    position_m : (N, 3), where they stand at rest
    """

    def __init__(self, models: Sequence[MotionModel], position_m: npt.ArrayLike) -> None:
        n = len(models)
        positions = np.asarray(position_m, dtype=float).reshape(n, 3)
        self._floats = np.zeros((n, FLOATS))
        self._integers = np.zeros((n, INTEGERS), dtype=np.int64)
        self._routes = np.zeros((n, 1, ROUTE))
        self._models = list(models)
        for i, model in enumerate(models):
            self._floats[i], self._integers[i] = initial(model, positions[i])

    @property
    def position_m(self) -> FloatArray:
        """Positions (N, 3) of this instant: a view that ``step`` changes."""
        return self._floats[:, POSITION : POSITION + 3]

    @property
    def velocity_m_s(self) -> FloatArray:
        """Velocities (N, 3) of this instant: a view that ``step`` changes."""
        return self._floats[:, VELOCITY : VELOCITY + 3]

    @property
    def waypoint(self) -> IntArray:
        """Index (N,) into the route of the point being flown to; the route's length once all are reached. A view."""
        return self._integers[:, WAYPOINT]

    @property
    def finished(self) -> BoolArray:
        """Whether (N,) the last point is reached and its hold over. A copter then stays there, a plane circles."""
        return np.asarray(self._integers[:, PHASE] == IDLE)

    @property
    def reached_s(self) -> FloatArray:
        """Times (N, W) since ``follow`` at which points were reached; NaN while they are not. A view."""
        return self._routes[:, :, REACHED]

    def follow(
        self,
        i: int,
        points_m: npt.ArrayLike,
        speed_m_s: npt.ArrayLike,
        hold_s: npt.ArrayLike | None = None,
        vertical_m_s: npt.ArrayLike | None = None,
        by_altitude: npt.ArrayLike | None = None,
        spline: npt.ArrayLike | None = None,
    ) -> None:
        """Fly vehicle ``i`` from where it is through points (W, 3), stopping at the last. See :class:`Route`."""
        new = Route.through(points_m, speed_m_s, hold_s, vertical_m_s, by_altitude, spline)
        count = len(new.points_m)
        n, room, _ = self._routes.shape
        if count > room:
            routes = np.zeros((n, 2 * count, ROUTE))
            routes[:, :room] = self._routes
            self._routes = routes
        rows = self._routes[i]
        rows[:, REACHED] = np.nan
        rows[:count, :3] = new.points_m
        rows[:count, SPEED] = new.speed_m_s
        rows[:count, HOLD] = new.hold_s
        rows[:count, VERTICAL] = new.vertical_m_s
        rows[:count, BY_ALTITUDE] = new.by_altitude
        rows[:count, SPLINE] = new.spline
        self._integers[i, COUNT] = count
        self._integers[i, [WAYPOINT, PHASE, HALTED]] = 0, STARTING, 0
        self._floats[i, [ELAPSED, BRAKED, NEW_SPEED]] = 0.0, 0.0, np.nan

    def retune(self, i: int, model: MotionModel) -> None:
        """Fly vehicle ``i`` by another model of its kind from now on."""
        before, after = (initial(tuned, np.zeros(3))[0] for tuned in (self._models[i], model))
        moved = (before != after) & ~(np.isnan(before) & np.isnan(after))
        self._floats[i, moved] = after[moved]
        self._models[i] = model

    def set_speed(self, i: int, speed_m_s: float, legs: int | None = None) -> None:
        """Fly so many legs, the present one first (None: all), at another speed, as soon as the navigator can."""
        count, waypoint = self._integers[i, [COUNT, WAYPOINT]]
        first = min(waypoint, max(count - 1, 0))
        until = count if legs is None else min(first + legs, count)
        self._routes[i, first:until, SPEED] = speed_m_s
        self._floats[i, NEW_SPEED] = speed_m_s

    def halt(self, i: int) -> None:
        """Brake and hold the position (a plane circles) until ``resume``."""
        self._integers[i, HALTED] = 1

    def resume(self, i: int) -> None:
        """Go on along the route."""
        self._integers[i, HALTED] = 0

    def rest(self, i: int) -> None:
        """Stand still at once, for a plane that has come down: it has no route until ``follow``."""
        self._integers[i, [COUNT, WAYPOINT, PHASE]] = 0, 0, IDLE
        self._floats[i, VELOCITY : VELOCITY + 3] = 0.0

    def step(self) -> None:
        """Advance all vehicles by :data:`TICK_S`."""
        _run(self._floats, self._integers, self._routes, 1, TICK_S, _NOWHERE)

    def linger(self, duration_s: float) -> Trajectory:
        """Stay with the only vehicle for whole ticks, at least ``duration_s``; return its motion, timed from now."""
        assert len(self._floats) == 1
        ticks = math.ceil(duration_s / TICK_S - 1e-9)
        stayed = np.empty((ticks + 1, 3))
        stayed[0] = self.position_m[0]
        for tick in range(1, ticks + 1):
            self.step()
            stayed[tick] = self.position_m[0]
        return Trajectory(TICK_S * np.arange(ticks + 1, dtype=float), stayed)

    def fly(self, route: Route) -> tuple[Trajectory, FloatArray]:
        """Fly the only vehicle along a route until it has finished; return its motion and the times (W,) of the points.

        Times count from now.
        """
        assert len(self._floats) == 1
        self.follow(0, *route)
        rates = self._floats[0, [CLIMB, DESCENT]]
        slowest = min(float(route.speed_m_s.min()), float(route.vertical_m_s.min()), *rates)
        if np.any(self._floats[0, WIND : WIND + 2]):  # against it, legs are flown if at least so much is left
            slowest = min(slowest, 1.0)
        length_m = float(np.linalg.norm(np.diff(np.vstack([self.position_m, route.points_m]), axis=0), axis=1).sum())
        wind_m_s = float(np.hypot(*self._floats[0, WIND : WIND + 2]))
        if self._integers[0, NAVIGATOR] == PLANE:  # against the wind, and somewhat slower than that at the worst
            slowest = max(slowest - wind_m_s, 0.1 * slowest)
        longest_s = 60.0 * (1 + len(route.points_m)) + float(route.hold_s.sum()) + 3.0 * length_m / slowest
        flown = np.empty((int(longest_s / TICK_S), 3))
        flown[0] = self.position_m[0]
        ticks = _run(self._floats, self._integers, self._routes, len(flown) - 1, TICK_S, flown)
        if not self.finished[0]:
            point, many = int(self.waypoint[0]) + 1, len(route.points_m)
            raise InfeasibleError(
                f"point {point} of {many} of a route: expected an arrival within {longest_s:.0f} s of its beginning, "
                f"got none in a wind of {wind_m_s:.1f} m/s: fly faster or in less wind"
            )
        t_s = TICK_S * np.arange(ticks + 1, dtype=float)
        return Trajectory(t_s, flown[: ticks + 1].copy()), self.reached_s[0, : len(route.points_m)].copy()


def predict(
    model: MotionModel,
    start_m: npt.ArrayLike,
    points_m: npt.ArrayLike,
    speed_m_s: npt.ArrayLike,
    hold_s: npt.ArrayLike | None = None,
    vertical_m_s: npt.ArrayLike | None = None,
    by_altitude: npt.ArrayLike | None = None,
    spline: npt.ArrayLike | None = None,
) -> tuple[Trajectory, FloatArray]:
    """Return the flight from rest at ``start_m`` through points (W, 3), and the times (W,) at which they are reached.

    Times count from the start. The motion is bit for bit that of a :class:`Navigator` stepped by :data:`TICK_S`.
    """
    navigator = Navigator([model], np.asarray(start_m, dtype=float).reshape(1, 3))
    return navigator.fly(Route.through(points_m, speed_m_s, hold_s, vertical_m_s, by_altitude, spline))


def _sources() -> int:
    """Return a number that changes with any source file of this package."""
    number = 0
    for path in sorted(Path(__file__).parent.glob("*.py")):
        number = zlib.crc32(path.read_bytes(), number)
    return number


def _compile(sources: int) -> Callable[[FloatArray, IntArray, FloatArray, int, float, FloatArray], int]:
    """Return the kernel; numba's cache knows this file and ``sources``, but no other file that it is made of."""

    @njit(cache=True, error_model="numpy")
    def run(
        floats: FloatArray, integers: IntArray, routes: FloatArray, ticks: int, dt: float, flown_m: FloatArray
    ) -> int:
        """Advance all vehicles by up to ``ticks`` steps; those that never had a route stand still.

        With room in ``flown_m`` (T, 3), write the first vehicle's positions there and stop once it is done. Returns
        the number of steps. This is the only kernel that Python calls: each further one would be compiled as a whole.
        """
        for tick in range(1, ticks + 1):
            for i in range(len(floats)):
                k = integers[i]
                if k[COUNT] == 0:
                    continue
                if k[NAVIGATOR] == ARDUCOPTER:
                    arducopter.step(floats[i], k, routes[i], dt)
                elif k[NAVIGATOR] == PX4:
                    px4.step(floats[i], k, routes[i], dt)
                else:
                    plane.step(floats[i], k, routes[i], dt)
            if len(flown_m) > 0:
                for axis in range(3):
                    flown_m[tick, axis] = floats[0, POSITION + axis]
                if integers[0, PHASE] == IDLE:
                    return tick
        return ticks if sources >= 0 else 0

    return run


_run = _compile(_sources())
