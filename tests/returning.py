"""Flights that may be told to return, over ground made here; for tests."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from missionplanner.kernels import SpaceArrays, TerrainArrays
from missionplanner.obstacles import Solid, pack
from missionplanner.plan import Trajectory
from missionplanner.returns import Returning
from missionplanner.terrain_bounds import Pyramid, pyramid
from missionplanner.vehicle import MotionModel
from tests.limits import limits

CELL_M = 10.0
REACH_M = 800.0
TICK_S = 0.05
ROUND_S = 3.0


def ground(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64], ridge_m: float, ridge_x: float) -> Any:
    """Return a ridge from south to north over level ground at 100 m."""
    return 100.0 + ridge_m * np.exp(-(((x - ridge_x) / 40.0) ** 2)) + 0.0 * y


def space_of(
    solids: Sequence[Solid] = (), ridge_m: float = 0.0, ridge_x: float = 150.0, fence: Any = None
) -> tuple[SpaceArrays, Pyramid, tuple[str, ...]]:
    """Return a square of 1600 m around the origin, with what stands in it."""
    count = int(2 * REACH_M / CELL_M) + 8
    axis = (np.arange(count) - count / 2) * CELL_M
    heights = ground(axis[None, :], axis[:, None], ridge_m, ridge_x).astype(np.float32)
    to_cell = np.zeros((2, 10))
    to_cell[0, 0] = to_cell[1, 0] = count / 2
    to_cell[0, 2] = to_cell[1, 1] = 1e4 / CELL_M
    terrain = TerrainArrays(heights, to_cell)
    obstacles = pack(list(solids))
    outline = np.zeros((0, 2)) if fence is None else np.array(fence, dtype=float)
    area = np.array([-REACH_M, -REACH_M, REACH_M, REACH_M])
    space = SpaceArrays(terrain, obstacles.arrays, outline, float("inf"), area)
    return space, pyramid(terrain, 2 * REACH_M), obstacles.names


def model(**changes: Any) -> MotionModel:
    values: dict[str, Any] = {
        "autopilot": "ardupilot",
        "vehicle_class": "copter",
        "acceleration_m_s2": 2.5,
        "jerk_m_s3": 1.0,
        "climb_rate_m_s": 2.5,
        "descent_rate_m_s": 1.5,
        "waypoint_radius_m": 2.0,
        "turn_radius_m": 0.0,
        "return_height_m": 15.0,
    }
    return MotionModel(**(values | changes))


def flight(
    name: str, home: tuple[float, float], way: Sequence[tuple[float, float, float]], *,
    speed_m_s: float = 8.0, wait_s: float = 0.0, hold_s: float = 0.0, motion: MotionModel | None = None, **changes: Any,
) -> Returning:  # fmt: skip
    """Return a flight from 100 m AMSL straight up to the first point of the way, along it, and straight down.

    It waits on the ground first, holds at the end of the way, and takes 3 s for its corners.
    """
    first, last = way[0], way[-1]
    points = [(*home, 100.0), (*home, first[2]), *way, (last[0], last[1], 100.0)]
    rates = [2.0, *[speed_m_s] * len(way), 1.5]
    t, p = [0.0, wait_s], [points[0], points[0]]
    for k, (before, after, rate) in enumerate(zip(points, points[1:], rates, strict=False)):
        t.append(t[-1] + float(np.linalg.norm(np.subtract(after, before))) / rate)
        p.append(after)
        if k == 0 or k == len(way):  # holds at the top of the take-off and at the end of the way
            t.append(t[-1] + ROUND_S + (hold_s if k else 0.0))
            p.append(after)
    airborne_s, descends_s = t[2] + 0.5 * ROUND_S, t[-2] - 0.5 * ROUND_S
    kept = np.concatenate([[True], np.diff(t) > 1e-9])
    corners = Trajectory(np.array(t)[kept], np.array(p)[kept])
    ticks = np.arange(0.0, t[-1] + ROUND_S, TICK_S)
    smooth = np.mean([corners.at(ticks + s) for s in np.linspace(-0.5, 0.5, 31) * ROUND_S], axis=0)
    return Returning(
        name,
        np.array([*home, 100.0]),
        limits(**({"terrain_margin_m": 10.0} | changes)),
        motion or model(),
        Trajectory(ticks, smooth),
        airborne_s,
        descends_s,
    )
