"""How far a vehicle keeps from everything that stands still, and which straight legs keep that far.

A vehicle is anywhere in a tube around its legs. While a path is searched, the tube's radius is simply part of the
margins and heights are sampled straight below; the legs that are kept are judged by bounds for their whole tube.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from missionplanner import kernels
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.terrain_bounds import Pyramid, least_heights
from missionplanner.vehicle import VehicleLimits

STEP_M = 1.0
"""Spacing of the terrain samples along a leg while searching; the final check is finer."""


@dataclass(frozen=True, slots=True)
class Margins:
    """What the planned path itself must keep (PAPER.md eqs 3 and 4): safety distance plus the radius of its tube."""

    height_agl_min_m: float
    height_agl_max_m: float
    alt_amsl_max_m: float
    obstacle_m: float
    fence_m: float

    @classmethod
    def of(cls, limits: VehicleLimits, extra_m: float = 0.0) -> Margins:
        """Return the vehicle's margins, all of them tighter by ``extra_m``."""
        tube_m = limits.tube_m + extra_m
        return cls(
            height_agl_min_m=limits.terrain_margin_m + tube_m,
            height_agl_max_m=limits.height_agl_max_m - tube_m,
            alt_amsl_max_m=limits.alt_amsl_max_m - tube_m,
            obstacle_m=limits.obstacle_margin_m + tube_m,
            fence_m=limits.obstacle_margin_m + tube_m,
        )


def legs_clear(space: SpaceArrays, margins: Margins, legs: FloatArray, step_m: float = STEP_M) -> npt.NDArray[np.bool_]:
    """Return which legs (N, 2, 3) keep the margins: exactly for obstacles and fence, by samples for terrain."""
    return kernels.legs_are_clear(
        space,
        np.ascontiguousarray(legs),
        step_m,
        margins.height_agl_min_m,
        margins.height_agl_max_m,
        margins.alt_amsl_max_m,
        margins.obstacle_m,
        margins.fence_m,
    )


@dataclass(frozen=True, slots=True, eq=False)
class TubeClearances:
    """What tubes around N legs keep from everything, each a bound for the whole continuous tube, and where it is met.

    Places are on the legs, but for heights, whose places are in the tube, high or low above the ground.
    """

    height_min_m: FloatArray  # (N,) above ground; -inf where terrain is missing
    height_min_at_m: FloatArray  # (N, 3)
    height_max_m: FloatArray  # (N,)
    height_max_at_m: FloatArray  # (N, 3)
    obstacle_m: FloatArray  # (N,) from the nearest hard obstacle; inf: none
    obstacle_at_m: FloatArray  # (N, 3)
    obstacle: npt.NDArray[np.intp]  # (N,) its index; -1: none
    fence_m: FloatArray  # (N,) inside fence and area
    fence_at_m: FloatArray  # (N, 3)


def tube_clearances(space: SpaceArrays, bounds: Pyramid, legs: FloatArray, radius_m: FloatArray) -> TubeClearances:
    """Return the clearances of all within ``radius_m`` (N,) of legs (N, 2, 3)."""
    legs = np.ascontiguousarray(legs)
    pieces = _as_triangles(legs)
    never = np.full(len(legs), np.inf)
    low = least_heights(space.terrain, bounds, pieces, radius_m, 1.0, never)
    high = least_heights(space.terrain, bounds, pieces, radius_m, -1.0, never)
    table = kernels.legs_clearance(space, legs, math.inf)

    def on_leg(column: int) -> FloatArray:
        at: FloatArray = legs[:, 0] + table[:, column, np.newaxis] * (legs[:, 1] - legs[:, 0])
        return at

    return TubeClearances(
        height_min_m=low[:, 0],
        height_min_at_m=low[:, 1:],
        height_max_m=-high[:, 0],
        height_max_at_m=high[:, 1:],
        obstacle_m=table[:, kernels.OBSTACLE] - radius_m,
        obstacle_at_m=on_leg(kernels.OBSTACLE_AT),
        obstacle=table[:, kernels.OBSTACLE_INDEX].astype(np.intp),
        fence_m=table[:, kernels.FENCE] - radius_m,
        fence_at_m=on_leg(kernels.FENCE_AT),
    )


def tubes_clear(
    space: SpaceArrays, bounds: Pyramid, limits: VehicleLimits, legs: FloatArray, extra_m: float = 0.0
) -> npt.NDArray[np.bool_]:
    """Return which legs (N, 2, 3) are proven clear with their whole tube, ``extra_m`` wider than it is.

    The judge of all that is flown; see :func:`tube_clearances` for how clear.
    """
    margins = Margins.of(limits, extra_m)
    clear = legs_clear(space, replace(margins, height_agl_min_m=-math.inf, height_agl_max_m=math.inf), legs, math.inf)
    radius_m = np.full(len(legs), limits.tube_m + extra_m)
    pieces = _as_triangles(legs)
    need = np.full(len(legs), limits.terrain_margin_m)
    clear &= _high_enough(space, bounds, pieces, radius_m, 1.0, need)
    if math.isfinite(limits.height_agl_max_m):
        need = np.full(len(legs), -limits.height_agl_max_m)
        clear &= _high_enough(space, bounds, pieces, radius_m, -1.0, need)
    return clear


def _high_enough(
    space: SpaceArrays, bounds: Pyramid, pieces: FloatArray, radius_m: FloatArray, sign: float, need_m: FloatArray
) -> npt.NDArray[np.bool_]:
    """Return which tubes keep ``sign`` times their height at least ``need_m``."""
    found = least_heights(space.terrain, bounds, pieces, radius_m, sign, need_m)[:, 0]
    result: npt.NDArray[np.bool_] = found >= need_m
    return result


def _as_triangles(legs: FloatArray) -> FloatArray:
    """Return legs (N, 2, 3) as triangles (N, 3, 3) without area, as :mod:`.terrain_bounds` takes them."""
    return np.ascontiguousarray(np.concatenate([legs, legs[:, :1]], axis=1))


def legs_within_angles(limits: VehicleLimits, legs: FloatArray, slack_rad: float = 0.0) -> npt.NDArray[np.bool_]:
    """Return which legs (N, 2, 3) are no steeper than the vehicle may climb and descend (eq. 7)."""
    d = legs[:, 1] - legs[:, 0]
    slope = d[:, 2] / np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-9)
    up = math.tan(min(limits.climb_angle_rad + slack_rad, math.radians(89.9)))
    down = math.tan(min(limits.descent_angle_rad + slack_rad, math.radians(89.9)))
    within: npt.NDArray[np.bool_] = (slope <= up) & (slope >= -down)
    return within


def polyline_legs(points_m: FloatArray) -> FloatArray:
    """Return the legs (N - 1, 2, 3) of a polyline (N, 3)."""
    return np.stack([points_m[:-1], points_m[1:]], axis=1)


def distance_to_legs_m(point_m: FloatArray, legs: FloatArray) -> FloatArray:
    """Return the distances (N,) of a point (3,) to legs (N, 2, 3)."""
    along = legs[:, 1] - legs[:, 0]
    square = np.maximum(np.einsum("nk,nk->n", along, along), 1e-12)
    share = np.clip(np.einsum("nk,nk->n", point_m - legs[:, 0], along) / square, 0.0, 1.0)
    distance: FloatArray = np.linalg.norm(legs[:, 0] + share[:, np.newaxis] * along - point_m, axis=1)
    return distance
