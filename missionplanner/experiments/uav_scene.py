"""An instance of the UAV path objective (PEERS.md) as a space with hard constraints, for the planner's own search.

Kept: threats as cylinders without top; the ground as the kernels' bicubic surface, whose samples are the nodes of the
objective's bilinear one; the map within which the objective accepts legs. Between nodes the two surfaces differ where
the ground bends: :meth:`UavScene.clear` asks both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from missionplanner.clearance import Margins, legs_clear
from missionplanner.compiled import njit
from missionplanner.errors import MissionError
from missionplanner.experiments.uav_objective import read_arrays
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays, TerrainArrays
from missionplanner.obstacles import CylinderSolid, pack
from missionplanner.vehicle import VehicleLimits

THREAT_MARGIN_M = 1.0
"""How far from a threat the objective's penalty begins."""
_PAD = 2  # samples repeated around the map: bicubic convolution asks for neighbours
_STEP_M = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class UavScene:
    """One instance: what must be kept, and between which ends."""

    space: SpaceArrays
    limits: VehicleLimits
    start_m: FloatArray  # (3,)
    goal_m: FloatArray  # (3,)
    heights_m: FloatArray  # (rows of y, columns of x): the instance's own ground

    def clear(self, legs: FloatArray, step_m: float = _STEP_M) -> npt.NDArray[np.bool_]:
        """Return which legs (N, 2, 3) keep the threats exactly, and by samples the ground, bicubic and bilinear."""
        clear = legs_clear(self.space, Margins.of(self.limits), legs, step_m)
        clear &= _over_bilinear(self.heights_m, legs, step_m, self.limits.terrain_margin_m)
        return clear


def uav_scene(
    heights_m: npt.ArrayLike,
    threats: npt.ArrayLike,
    start: npt.ArrayLike,
    end: npt.ArrayLike,
    *,
    threat_margin_m: float = 0.0,
    height_min_m: float = 0.0,
    height_max_m: float = math.inf,
) -> UavScene:
    """Return the space of an instance, whose ends are ``start`` and ``end``: x, y and height above the node below.

    Parameters
    ----------
    heights_m : (rows of y, columns of x), one sample per metre.
    threats : (T, 4) of x, y, an altitude that is not used, and the radius.
    threat_margin_m : kept from threats and from the map's edge; :data:`THREAT_MARGIN_M` avoids the objective's penalty.
    height_min_m, height_max_m : kept above the ground all along the way.

    Raises
    ------
    MissionError
        An array is not of this form.
    """
    heights, rows = np.array(heights_m, dtype=np.float64), np.array(threats, dtype=np.float64)
    places = [np.array(place, dtype=np.float64) for place in (start, end)]
    if any(place.shape != (3,) for place in places):
        got = ", ".join(str(place.tolist()) for place in places)
        raise MissionError(f"start, end: expected x, y and height of both, got {got}")
    ends = np.stack(places)
    if heights.ndim != 2 or min(heights.shape) < 4 or not np.isfinite(heights).all():
        raise MissionError(f"heights: expected a finite grid of at least 4 x 4, got one of shape {heights.shape}")
    if rows.ndim != 2 or rows.shape[1] != 4:
        raise MissionError(f"threats: expected rows of x, y, z and radius, got an array of shape {rows.shape}")
    north, east = heights.shape[0] - 1, heights.shape[1] - 1
    at = np.round(ends[:, :2]).astype(int)
    if not ((at >= 1) & (at <= (east, north))).all():
        raise MissionError(f"start, end: expected x, y and height on a map of {east} x {north} m, got {ends.tolist()}")
    ends[:, 2] += heights[at[:, 1] - 1, at[:, 0] - 1]  # the objective counts its nodes from one here
    to_cell = np.zeros((2, 10))
    to_cell[:, 0] = _PAD
    to_cell[0, 2] = to_cell[1, 1] = 1e4
    space = SpaceArrays(
        TerrainArrays(np.ascontiguousarray(np.pad(heights, _PAD, mode="edge"), dtype=np.float32), to_cell),
        pack([CylinderSolid(f"threat {n + 1}", x, y, radius) for n, (x, y, _, radius) in enumerate(rows)]).arrays,
        np.zeros((0, 2)),
        math.inf,
        # margins count from the map's edge, too, where the objective has none
        np.array([0.0, 0.0, east, north]) + np.array([-1.0, -1.0, 1.0, 1.0]) * threat_margin_m,
    )
    return UavScene(space, free_flight(threat_margin_m, height_min_m, height_max_m), ends[0], ends[1], heights)


def load_scene(
    path: Path, *, threat_margin_m: float = 0.0, height_min_m: float = 0.0, height_max_m: float = math.inf
) -> UavScene:
    """Read an instance from an .npz file: H (rows of y, columns of x), threats (T, 4), start (3,), end (3,).

    Raises
    ------
    MissionError
        No such file, or no instance.
    """
    return uav_scene(
        *read_arrays(path), threat_margin_m=threat_margin_m, height_min_m=height_min_m, height_max_m=height_max_m
    )


def free_flight(obstacle_margin_m: float, height_min_m: float, height_max_m: float) -> VehicleLimits:
    """Return the limits of a vehicle that turns and climbs as it likes and strays nowhere."""
    return VehicleLimits(
        speed_min_m_s=1.0,
        speed_max_m_s=10.0,
        climb_angle_rad=0.5 * math.pi,
        descent_angle_rad=0.5 * math.pi,
        turn_radius_m=0.0,
        turn_angle_rad=math.pi,
        terrain_margin_m=height_min_m,
        obstacle_margin_m=obstacle_margin_m,
        tracking_error_m=0.0,
        position_error_m=0.0,
        deviation_m=0.0,
        landing_slope_rad=0.5 * math.pi,
        height_agl_max_m=height_max_m,
        alt_amsl_max_m=math.inf,
        endurance_s=math.inf,
    )


@njit(cache=True, error_model="numpy")
def _over_bilinear(heights: FloatArray, legs: FloatArray, step_m: float, height_min_m: float) -> npt.NDArray[np.bool_]:
    """Return which legs (N, 2, 3) keep a height above the bilinear surface through ``heights``, by samples."""
    clear = np.ones(legs.shape[0], dtype=np.bool_)
    for n in range(legs.shape[0]):
        a, b = legs[n, 0], legs[n, 1]
        pieces = max(1, math.ceil(math.hypot(b[0] - a[0], b[1] - a[1]) / step_m))
        for k in range(pieces + 1):
            s = k / pieces
            x, y = a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])
            j = min(max(int(x), 0), heights.shape[1] - 2)
            i = min(max(int(y), 0), heights.shape[0] - 2)
            u, v = x - j, y - i
            ground = (heights[i, j] * (1.0 - u) + heights[i, j + 1] * u) * (1.0 - v)
            ground += (heights[i + 1, j] * (1.0 - u) + heights[i + 1, j + 1] * u) * v
            if not a[2] + s * (b[2] - a[2]) >= ground + height_min_m:
                clear[n] = False
                break
    return clear
