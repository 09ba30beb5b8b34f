"""Solids in the local frame, packed for the kernels.

Distances are signed (negative inside), exact, and so 1-Lipschitz: moving one metre changes them by at most one metre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from missionplanner import kernels
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import ObstacleArrays, ObstacleGrid


@dataclass(frozen=True, slots=True)
class CylinderSolid:
    """A vertical cylinder from far below the ground up to its top."""

    name: str
    x: float
    y: float
    radius_m: float
    top_amsl_m: float = math.inf


@dataclass(frozen=True, slots=True)
class ConeSolid:
    """A cone-shaped peak (PAPER.md eq. 16); below its base plane is free."""

    name: str
    x: float
    y: float
    base_radius_m: float
    base_amsl_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class SphereSolid:
    """A radar zone (PAPER.md eq. 17) or a marine hazard (eq. 19); one that is not hard is priced, not forbidden."""

    name: str
    x: float
    y: float
    z: float
    radius_m: float
    kind: Literal["radar", "marine"]
    hard: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class PrismSolid:
    """An upright prism over a simple polygon (K, 2), of either orientation."""

    name: str
    xy: FloatArray
    floor_amsl_m: float = -math.inf
    top_amsl_m: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class CableSolid:
    """A straight cable: all within ``radius_m`` of the segment from ``start`` (3,) to ``end`` (3,)."""

    name: str
    start: FloatArray
    end: FloatArray
    radius_m: float


@dataclass(frozen=True, slots=True, eq=False)
class CurtainSolid:
    """A sloping cable and all below it, without end: within ``radius_m`` of the plane from ``start`` to ``end`` (3,).

    Its top is round, as a cable.
    """

    name: str
    start: FloatArray
    end: FloatArray
    radius_m: float


Solid = CylinderSolid | ConeSolid | SphereSolid | PrismSolid | CableSolid | CurtainSolid


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    """All solids of a mission, in order."""

    names: tuple[str, ...]
    arrays: ObstacleArrays

    def distance_m(self, position_m: npt.ArrayLike) -> FloatArray:
        """Return signed distances (..., O) of positions (..., 3) to every solid, hard or not; negative inside."""
        position = np.asarray(position_m, dtype=np.float64)
        flat = np.ascontiguousarray(position.reshape(-1, 3))
        distance: FloatArray = kernels.obstacle_distances(self.arrays, flat)
        return distance.reshape(*position.shape[:-1], len(self.names))


def pack(solids: Sequence[Solid]) -> Obstacles:
    """Return solids packed for the kernels.

    Raises
    ------
    MissionError
        A size that is not positive, a number that is NaN, or a polygon that crosses itself or has no area.
    """
    count = len(solids)
    kind = np.zeros(count, dtype=np.int64)
    params = np.zeros((count, 8))
    bound = np.zeros((count, 5))
    hard = np.ones(count, dtype=np.bool_)
    vertices: list[FloatArray] = [np.zeros((0, 2))]
    vertex_start = np.zeros(count + 1, dtype=np.int64)
    for i, solid in enumerate(solids):
        kind[i], row, bound[i] = _row(solid)
        if not np.isfinite(bound[i, :3]).all() or np.isnan(row).any() or not bound[i, 3] < bound[i, 4]:
            raise MissionError(f"obstacle {solid.name}: expected numbers for its place and size, got {solid}")
        params[i, : len(row)] = row
        if isinstance(solid, SphereSolid):
            hard[i] = solid.hard
        outline = np.asarray(solid.xy, dtype=np.float64) if isinstance(solid, PrismSolid) else np.zeros((0, 2))
        vertices.append(outline)
        vertex_start[i + 1] = vertex_start[i] + len(outline)
    arrays = indexed(kind, params, bound, hard, np.concatenate(vertices), vertex_start)
    return Obstacles(tuple(solid.name for solid in solids), arrays)


_GRID_FROM = 16
"""Fewer solids than this are asked one by one as fast."""
_SQUARE_LEAST_M = 1e-3
"""Though all solids stand in one point."""
_LARGE_MOST = 8
_LARGE_SQUARES = 12
"""So many solids at most are in no square, if they are so many squares across."""
_GRID_COPIES = 8
"""In so many squares, on average, a solid may be."""


def indexed(
    kind: npt.NDArray[np.int64],
    params: FloatArray,
    bound: FloatArray,
    hard: npt.NDArray[np.bool_],
    vertices: FloatArray,
    vertex_start: npt.NDArray[np.int64],
) -> ObstacleArrays:
    """Return packed solids with the index by which the kernels find those that are near."""
    return ObstacleArrays(kind, params, bound, hard, np.ascontiguousarray(vertices), vertex_start, _grid(bound))


def _grid(bound: FloatArray) -> ObstacleGrid:
    """Return squares of the size of a solid's share of the plane, or larger if the solids are large."""
    count = len(bound)
    none = np.zeros(0, dtype=np.int32)
    if count < _GRID_FROM:
        start, solid = np.array([[0, count]], dtype=np.int32), np.arange(count, dtype=np.int32)
        return ObstacleGrid(0.0, 0.0, 1.0, start, solid, np.zeros((count, 4), dtype=np.int32), none)
    large = _large(bound)
    inside = np.delete(np.arange(count), large)
    low, high, cell_m = _squares(bound[inside])
    (west, south), size_m = low.min(axis=0), np.ptp(np.concatenate([low, high]), axis=0)
    while True:
        columns, rows = (int(size // cell_m) + 1 for size in size_m)
        span = np.zeros((count, 4), dtype=np.int32)
        for k, (at, origin, squares) in enumerate(
            (
                (low[:, 1], south, rows),
                (low[:, 0], west, columns),
                (high[:, 1], south, rows),
                (high[:, 0], west, columns),
            )
        ):
            span[inside, k] = np.clip((at - origin) / cell_m, 0, squares - 1)  # as kernels.grid_square
        wide = span[:, 3] - span[:, 1] + 1
        squares_of = (span[inside, 2] - span[inside, 0] + 1) * wide[inside]
        if squares_of.sum() <= _GRID_COPIES * len(inside):
            break
        cell_m *= 1.25
    solid = np.repeat(inside, squares_of)
    place = np.arange(len(solid)) - np.repeat(np.cumsum(squares_of) - squares_of, squares_of)
    square = (span[solid, 0] + place // wide[solid]) * columns + span[solid, 1] + place % wide[solid]
    order = np.argsort(square, kind="stable")
    ends = np.searchsorted(square[order], np.arange(rows * columns + 1)).astype(np.int32)
    start = np.column_stack([ends[:-1].reshape(rows, columns), ends[columns::columns]])
    return ObstacleGrid(float(west), float(south), cell_m, start, solid[order].astype(np.int32), span, large)


def _squares(bound: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return the boxes (O, 2) around solids, low and high, and the size of squares that suits them."""
    low, high = bound[:, :2] - bound[:, 2:3], bound[:, :2] + bound[:, 2:3]
    size_m = np.ptp(np.concatenate([low, high]), axis=0)
    return low, high, max(math.sqrt(size_m[0] * size_m[1] / len(bound)), size_m.max() / len(bound), _SQUARE_LEAST_M)


def _large(bound: FloatArray) -> npt.NDArray[np.int32]:
    """Return the few solids that are so large that squares which suit all others would be wasted on them."""
    by_size = np.argsort(-bound[:, 2], kind="stable")
    for few in range(min(_LARGE_MOST, len(bound) - 1), 0, -1):
        cell_m = _squares(bound[by_size[few:]])[2]
        if 2.0 * bound[by_size[few - 1], 2] > _LARGE_SQUARES * cell_m:
            return np.sort(by_size[:few]).astype(np.int32)
    return np.zeros(0, dtype=np.int32)


def _row(solid: Solid) -> tuple[int, tuple[float, ...], tuple[float, float, float, float, float]]:
    """Return the kind of a solid, its row of parameters, and its bounds: the circle around it, lowest and highest z."""
    match solid:
        case CylinderSolid(name, x, y, radius_m, top_amsl_m):
            _check(name, "radius_m", radius_m)
            return kernels.CYLINDER, (x, y, radius_m, top_amsl_m), (x, y, radius_m, -math.inf, top_amsl_m)
        case ConeSolid(name, x, y, radius_m, base_amsl_m, height_m):
            _check(name, "base_radius_m", radius_m)
            _check(name, "height_m", height_m)
            bounds = (x, y, radius_m, base_amsl_m, base_amsl_m + height_m)
            return kernels.CONE, (x, y, radius_m, base_amsl_m, height_m), bounds
        case SphereSolid(name, x, y, z, radius_m, sphere):
            _check(name, "radius_m", radius_m)
            kind = kernels.RADAR if sphere == "radar" else kernels.MARINE
            return kind, (x, y, z, radius_m), (x, y, radius_m, z - radius_m, z + radius_m)
        case PrismSolid(name, xy, floor_amsl_m, top_amsl_m):
            outline = np.asarray(xy, dtype=np.float64)
            check_polygon(outline, f"obstacle {name}")
            _check(name, "top above its floor", top_amsl_m - floor_amsl_m)
            x, y = (float(v) for v in 0.5 * (outline.min(axis=0) + outline.max(axis=0)))
            reach_m = float(np.hypot(outline[:, 0] - x, outline[:, 1] - y).max())
            row = (floor_amsl_m, top_amsl_m, float(_is_convex(outline)))
            return kernels.PRISM, row, (x, y, reach_m, floor_amsl_m, top_amsl_m)
        case CableSolid(name, start, end, radius_m) | CurtainSolid(name, start, end, radius_m):
            _check(name, "radius_m", radius_m)
            x, y = (0.5 * float(start[k] + end[k]) for k in (0, 1))
            across_m = math.hypot(end[0] - start[0], end[1] - start[1])
            low, high = sorted((float(start[2]), float(end[2])))
            kind, lowest = kernels.CABLE, low - radius_m
            if isinstance(solid, CurtainSolid):
                _check(name, "ends that are apart seen from above", across_m)
                kind, lowest = kernels.CURTAIN, -math.inf
            return kind, (*start, *end, radius_m), (x, y, 0.5 * across_m + radius_m, lowest, high + radius_m)


_PAIRS = 1 << 16
"""Of edges, looked at together."""


def check_polygon(xy: FloatArray, name: str) -> None:
    """Check that a polygon (K, 2) is simple and has an area.

    Raises
    ------
    MissionError
        Fewer than three corners, NaN or infinity, two edges that cross or touch, or no area.
    """
    if xy.ndim != 2 or xy.shape[1] != 2 or len(xy) < 3 or not np.isfinite(xy).all():
        raise MissionError(f"{name}: expected a polygon of at least 3 finite corners, got {xy.tolist()}")
    after = np.roll(xy, -1, axis=0)
    rows = max(1, _PAIRS // len(xy))
    for first in range(0, len(xy), rows):
        i, j = np.arange(first, min(first + rows, len(xy)))[:, np.newaxis], np.arange(len(xy))
        apart = (j > i + 1) & ((i > 0) | (j < len(xy) - 1))  # neighbours share a corner
        touching = np.argwhere(apart & _touch(xy[i], after[i], xy[j], after[j]))
        if len(touching):
            raise MissionError(
                f"{name}: expected a polygon whose edges do not cross, got edges {first + touching[0, 0] + 1} and "
                f"{touching[0, 1] + 1} crossing: list the corners in order around it"
            )
    if abs(float(np.sum(xy[:, 0] * after[:, 1] - xy[:, 1] * after[:, 0]))) < 1e-6:
        raise MissionError(f"{name}: expected a polygon with an area, got corners on one line")


def _check(name: str, field: str, value: float) -> None:
    if not value > 0.0:
        raise MissionError(f"obstacle {name}: expected {field} > 0, got {value}")


def _turn(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    turn: FloatArray = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (
        c[..., 0] - a[..., 0]
    )
    return turn


def _touch(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> npt.NDArray[np.bool_]:
    """Return which of the segments a-b and c-d, (..., 2) each, share a point."""
    turns = (_turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b))
    touch: npt.NDArray[np.bool_] = (turns[0] * turns[1] < 0.0) & (turns[2] * turns[3] < 0.0)
    ends = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    for turn, (p, q, r) in zip(turns, ends, strict=True):
        touch |= (turn == 0.0) & ((np.minimum(p, q) <= r) & (r <= np.maximum(p, q))).all(axis=-1)
    return touch


def _is_convex(xy: FloatArray) -> bool:
    turns = _turn(np.roll(xy, 2, axis=0), np.roll(xy, 1, axis=0), xy)
    return bool((turns >= 0.0).all() or (turns <= 0.0).all())


def beneath(obstacles: Obstacles) -> list[Solid]:
    """Return solids that fill the room below what hangs in the air: who climbs straight up must not start there.

    Below a sloping cable, up to its lower end piece by piece.
    """
    arrays = obstacles.arrays
    found: list[Solid] = []
    for i, (name, hard) in enumerate(zip(obstacles.names, arrays.hard.tolist(), strict=True)):
        row = arrays.params[i].tolist()
        match int(arrays.kind[i]) if hard else None:
            case kernels.RADAR | kernels.MARINE:
                found.append(CylinderSolid(name, row[0], row[1], row[3], row[2]))
            case kernels.PRISM if math.isfinite(row[0]):
                outline = arrays.vertices[arrays.vertex_start[i] : arrays.vertex_start[i + 1]]
                found.append(PrismSolid(name, outline, top_amsl_m=row[0]))
            case kernels.CABLE:
                found += _below_cable(name, np.array(row[:3]), np.array(row[3:6]), row[6])
    return found


_CABLE_PIECES = 4


def _below_cable(name: str, start: FloatArray, end: FloatArray, radius_m: float) -> list[Solid]:
    along = end - start
    across_m = math.hypot(along[0], along[1])
    if across_m < radius_m:
        return []
    side = np.array([-along[1], along[0]]) / across_m * radius_m
    ends = [start + along * (k / _CABLE_PIECES) for k in range(_CABLE_PIECES + 1)]
    return [
        PrismSolid(name, np.stack([a[:2] - side, b[:2] - side, b[:2] + side, a[:2] + side]), top_amsl_m=min(a[2], b[2]))
        for a, b in pairwise(ends)
    ]


def join(first: ObstacleArrays, second: ObstacleArrays) -> ObstacleArrays:
    """Return the solids of both, the first's before the second's."""
    return indexed(
        kind=np.concatenate([first.kind, second.kind]),
        params=np.concatenate([first.params, second.params]),
        bound=np.concatenate([first.bound, second.bound]),
        hard=np.concatenate([first.hard, second.hard]),
        vertices=np.concatenate([first.vertices, second.vertices]),
        vertex_start=np.concatenate([first.vertex_start, first.vertex_start[-1] + second.vertex_start[1:]]),
    )
