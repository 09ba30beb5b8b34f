"""How far a vehicle keeps from everything that stands still, and which straight legs keep that far."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from missionplanner import kernels
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.vehicle import VehicleLimits

STEP_M = 1.0
"""Spacing of the terrain samples along a leg while searching; the final check is finer."""


@dataclass(frozen=True, slots=True)
class Margins:
    """What the planned path itself must keep (PAPER.md eqs 3 and 4): safety distance plus tracking error."""

    height_agl_min_m: float
    height_agl_max_m: float
    alt_amsl_max_m: float
    obstacle_m: float
    fence_m: float

    @classmethod
    def of(cls, limits: VehicleLimits, extra_m: float = 0.0) -> Margins:
        """Return the vehicle's margins, all of them tighter by ``extra_m``."""
        lateral_m = limits.obstacle_margin_m + limits.tracking_error_m + extra_m
        return cls(
            height_agl_min_m=limits.terrain_margin_m + limits.tracking_error_m + extra_m,
            height_agl_max_m=limits.height_agl_max_m - limits.tracking_error_m - extra_m,
            alt_amsl_max_m=limits.alt_amsl_max_m - limits.tracking_error_m - extra_m,
            obstacle_m=lateral_m,
            fence_m=lateral_m,
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
