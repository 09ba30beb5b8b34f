"""The UAV path objective with which spherical-vector searches are compared, for whole populations.

A path is n spherical vectors (length, elevation, azimuth), added up from the start and clipped to the map and to its
band of heights above the ground. Its price is five times its length, a cost per leg near or in a cylinder, ten times
the distances from the middle of the band, all turns and changes of climb beyond 45 degrees, and a penalty where one of
twelve samples of a leg is below the ground. Phung & Ha, Applied Soft Computing 107 (2021) 107376; Shehadeh & Kudela,
arXiv 2501.14503; quirks of theirs (an azimuth box turned by the decoding, rounded cells) are kept, or none could be
compared.

The kernel takes many paths at once, and looks at what may matter only: the ground by the highest cell of squares
around a leg, angles by comparing products until they exceed what is free. It agrees with the definition to rounding,
also where that steps: what lies on a step is computed as the definition rounds
(an angle that is 45 degrees to the last bit may be free here and not there).
"""

from __future__ import annotations

import math
import os
import zipfile
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner.compiled import njit
from missionplanner.cost import THREADS
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray

VECTORS = 10
LOW_M, HIGH_M = 100.0, 200.0
"""Band of heights above the ground."""
PENALTY = 1e4
WEIGHTS = np.array([5.0, 1.0, 10.0, 1.0, 1.0])
"""Of length, threats, heights, angles and ground."""
TERMS = ("length", "threats", "heights", "angles", "ground")

OUTER_M, INNER_M = 11.0, 1.0
"""Beyond a cylinder's radius: nothing is paid further off than the outer, the penalty within the inner."""
FREE_DEG = 45.0
SAMPLES = 12  # of the ground, per leg
_BLOCK = 16  # cells
_LEVELS = 6  # squares of 1, 2, 4, ... blocks
_OCTANT = 0.7854  # just over pi / 4: how far the sine's series reaches
_GUARD = 1e-9
"""Relative; what is closer than this to a threshold is judged by the definition itself."""
_ROWS_PER_THREAD = 64

_KEYS = ("H", "threats", "start", "end")
_UNREADABLE = (  # what numpy lets through of files that are no archives, or cut or damaged ones
    OSError, ValueError, KeyError, EOFError, TypeError, AttributeError, NotImplementedError, zipfile.BadZipFile,
    zlib.error,
)  # fmt: skip

_kernel = njit(cache=True, error_model="numpy", nogil=True)
_inlined = njit(error_model="numpy", nogil=True, inline="always")


class MapArrays(NamedTuple):
    """What the kernel reads of an instance."""

    height_m: npt.NDArray[np.float32]  # (R, C): of the cell around x = column + 1, y = row + 1
    highest_m: npt.NDArray[np.float32]  # (L, B, B'): over 2^level blocks of cells from this one on, and one cell more
    threat: FloatArray  # (T, 4): x, y, z, radius
    start: FloatArray  # (3,)
    end: FloatArray
    azimuth_rad: float  # the middle of the box


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """A map with its cylinders, start and end: a function to be minimised over a box."""

    name: str
    arrays: MapArrays
    lower: FloatArray  # (3 n,)
    upper: FloatArray

    @property
    def dimensions(self) -> int:
        """Return the number of variables."""
        return len(self.lower)

    def price(self, x: npt.ArrayLike, threads: int = THREADS) -> FloatArray:
        """Return the prices (P,) of points (P, D), the population shared by threads."""
        points = self._points(x)
        out = np.empty(len(points))

        def work(part: slice) -> None:
            _prices(points[part], self.arrays, out[part])

        _share(len(points), threads, work)
        return out

    def terms(self, x: npt.ArrayLike) -> FloatArray:
        """Return the unweighted terms (P, 5) of points (P, D), in the order of :data:`TERMS`."""
        points = self._points(x)
        out = np.empty((len(points), len(TERMS)))
        _term_table(points, self.arrays, out)
        return out

    def waypoints_m(self, x: npt.ArrayLike) -> FloatArray:
        """Return the decoded paths (P, n + 2, 3) of points (P, D), start and end included; z is an altitude."""
        points = self._points(x)
        out = np.empty((len(points), self.dimensions // 3 + 2, 3))
        _decoded(points, self.arrays, out)
        return out

    def free(self, x: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return which points (P,) of (P, D) pay no penalty: clear of cylinders and ground."""
        terms = self.terms(x)
        clear: npt.NDArray[np.bool_] = (terms[:, 1] < PENALTY) & (terms[:, 4] == 0.0)
        return clear

    def _points(self, x: npt.ArrayLike) -> FloatArray:
        points = np.ascontiguousarray(x, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != self.dimensions:
            raise MissionError(f"{self.name}: expected points (P, {self.dimensions}), got shape {points.shape}")
        if not np.isfinite(points).all():
            raise MissionError(f"{self.name}: expected numbers, got a point with NaN or infinity")
        return points


def load(path: Path, vectors: int = VECTORS) -> Instance:
    """Read an instance from an .npz file: heights H (R, C), threats (T, 4), start (3,), end (3,).

    Raises
    ------
    MissionError
        No such file, no instance, or an end outside its map.
    """
    return make(path.stem, *read_arrays(path), vectors=vectors)


def read_arrays(path: Path) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Read heights (R, C), threats (T, 4), start (3,) and end (3,) from an .npz file.

    Raises
    ------
    MissionError
        No such file, a damaged one, or no instance.
    """
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            height_m, threats, start, end = (np.asarray(file[key], dtype=np.float64) for key in _KEYS)
    except _UNREADABLE as error:
        reason = " ".join(str(error).split())
        raise MissionError(f"{path}: expected an .npz file with H, threats, start and end, got: {reason}") from error
    _check(path.stem, height_m, threats, start, end)
    return height_m, threats, start, end


def make(
    name: str,
    height_m: FloatArray,
    threats: FloatArray,
    start: FloatArray,
    end: FloatArray,
    *,
    vectors: int = VECTORS,
) -> Instance:
    """Return the instance of heights (R, C), cylinders (T, 4) of x, y, z and radius, start and end (3,).

    Raises
    ------
    MissionError
        Another shape, no numbers, an end outside the map, or both ends in one place.
    """
    _check(name, height_m, threats, start, end)
    if vectors < 1:
        raise MissionError(f"{name}: expected at least one vector, got {vectors}")
    azimuth_rad = math.atan2(end[1] - start[1], end[0] - start[0])
    reach_m = 2.0 * float(np.linalg.norm(end - start)) / vectors
    quarter = math.pi / 4
    heights = np.ascontiguousarray(height_m, dtype=np.float32)
    threat = np.ascontiguousarray(threats)
    arrays = MapArrays(heights, _highest(heights), threat, start.copy(), end.copy(), azimuth_rad)
    lower = np.tile([0.0, -quarter, azimuth_rad - quarter], vectors)
    upper = np.tile([reach_m, quarter, azimuth_rad + quarter], vectors)
    return Instance(name, arrays, lower, upper)


def _check(name: str, height_m: FloatArray, threats: FloatArray, start: FloatArray, end: FloatArray) -> None:
    for what, array, shape in (
        ("H", height_m, (-1, -1)),
        ("threats", threats, (-1, 4)),
        ("start", start, (3,)),
        ("end", end, (3,)),
    ):
        fits = array.ndim == len(shape) and all(b in (-1, a) for a, b in zip(array.shape, shape, strict=True))
        if not fits or not np.isfinite(array).all():
            got = f"shape {array.shape}" if not fits else "NaN or infinity"
            raise MissionError(f"{name}: expected {what} of shape {shape} (-1: any), all of it numbers, got {got}")
    rows, columns = height_m.shape
    if min(rows, columns) < 2:
        raise MissionError(f"{name}: expected at least 2 x 2 heights, got {rows} x {columns}")
    for what, place in (("start", start), ("end", end)):
        if not (1.0 <= place[0] <= columns and 1.0 <= place[1] <= rows):
            raise MissionError(
                f"{name}: expected {what} within x 1 to {columns} and y 1 to {rows}, got {place[0]:g}, {place[1]:g}"
            )
    if (start[:2] == end[:2]).all():
        raise MissionError(f"{name}: expected start and end in two places, got both at {start[0]:g}, {start[1]:g}")


def _highest(heights: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the highest cell of squares of 1, 2, 4, ... blocks, each with the next cells on."""
    rows, columns = (-(-n // _BLOCK) for n in heights.shape)
    low = np.full((rows * _BLOCK + 1, columns * _BLOCK + 1), -np.inf, dtype=np.float32)
    low[: heights.shape[0], : heights.shape[1]] = heights
    out = np.empty((_LEVELS, rows, columns), dtype=np.float32)
    for r in range(rows):
        band = low[r * _BLOCK : (r + 1) * _BLOCK + 1].max(axis=0)
        for c in range(columns):
            out[0, r, c] = band[c * _BLOCK : (c + 1) * _BLOCK + 1].max()
    for level in range(1, _LEVELS):
        step = 2 ** (level - 1)
        wide = np.full((rows + step, columns + step), -np.inf, dtype=np.float32)
        wide[:rows, :columns] = out[level - 1]
        below = np.maximum(wide[:rows], wide[step:])
        out[level] = np.maximum(below[:, :columns], below[:, step:])
    return out


def _share(rows: int, threads: int, work: Callable[[slice], None]) -> None:
    """Let threads share the rows of a population: the kernels release the interpreter's lock."""
    threads = min(threads, rows // _ROWS_PER_THREAD)
    if threads <= 1:
        work(slice(0, rows))
        return
    edges = np.linspace(0, rows, threads + 1).astype(int)
    others = [_pool(threads - 1).submit(work, slice(a, b)) for a, b in pairwise(edges[1:])]
    work(slice(0, edges[1]))
    for other in others:
        other.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="objective")


if hasattr(os, "register_at_fork"):  # a forked child has none of its parent's threads
    os.register_at_fork(after_in_child=_pool.cache_clear)


# --- the kernels ---------------------------------------------------------------------------------------------------
#
# So many paths at a time lie side by side, point by point and leg by leg, that the processor's vector units take them
# together; only what few legs have to look at (cylinders, ground, sharp angles) is looked at path by path.

_LANES = 32
_ROOT = 6755399441055744.0  # adding and taking this rounds to the nearest integer, halves to the even one


class _Lanes(NamedTuple):
    """Scratch: up to _LANES paths of n + 2 points and n + 1 legs."""

    x: FloatArray  # (n + 2, _LANES)
    y: FloatArray
    z: FloatArray  # above the ground
    alt: FloatArray
    ex: FloatArray  # (n + 1, _LANES): a leg's horizontal steps, their length's square, their length, and its climb
    ey: FloatArray
    ee: FloatArray
    level: FloatArray
    climb: FloatArray
    bend: FloatArray  # not below 0: an angle at the leg's end may not be free
    doubt: FloatArray  # (_LANES,): above 0: too near to a threshold for arithmetic that rounds otherwise
    length: FloatArray  # (_LANES,): terms
    heights: FloatArray
    threats: FloatArray
    angles: FloatArray
    inverse: FloatArray  # (_LANES,): of the squared length of a leg; squared distance of a cylinder
    square: FloatArray


@_kernel
def _lanes(points: int) -> _Lanes:
    return _Lanes(
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty((points, _LANES)),
        np.empty(_LANES),
        np.empty(_LANES),
        np.empty(_LANES),
        np.empty(_LANES),
        np.empty(_LANES),
        np.empty(_LANES),
        np.empty(_LANES),
    )


@_inlined
def _sine(u: float) -> float:
    """Sine within pi / 4 of 0 (fdlibm's series)."""
    uu = u * u
    s = 2.75573137070700676789e-06 + uu * (-2.50507602534068634195e-08 + uu * 1.58969099521155010221e-10)
    s = 8.33333333332248946124e-03 + uu * (-1.98412698298579493134e-04 + uu * s)
    return u + u * uu * (-1.66666666666666324348e-01 + uu * s)


@_inlined
def _cosine(u: float) -> float:
    """Cosine within pi / 4 of 0 (fdlibm's series)."""
    uu = u * u
    s = -2.75573143513906633035e-07 + uu * (2.08757232129817482790e-09 - uu * 1.13596475577881948265e-11)
    s = -1.38888888888741095749e-03 + uu * (2.48015872894767294178e-05 + uu * s)
    return 1.0 - (0.5 * uu - uu * uu * (4.16666666666666019037e-02 + uu * s))


@_kernel
def _steps(points: FloatArray, azimuth_rad: float, p: _Lanes) -> None:
    """Turn vectors into steps, for angles as they are in the box."""
    lanes = points.shape[0]
    middle_sin = math.sin(azimuth_rad)
    middle_cos = math.cos(azimuth_rad)
    doubt = p.doubt
    doubt[:lanes] = 0.0
    for i in range(points.shape[1] // 3):
        r, u, w = p.level[i], p.bend[i], p.ee[i]
        for k in range(lanes):
            r[k] = points[k, 3 * i]
            u[k] = points[k, 3 * i + 1]
            w[k] = points[k, 3 * i + 2] - azimuth_rad
        ex, ey, climb = p.ex[i], p.ey[i], p.climb[i]
        for k in range(lanes):
            across = r[k] * _cosine(u[k])
            s = _sine(w[k])
            c = _cosine(w[k])
            climb[k] = r[k] * _sine(u[k])
            ex[k] = across * (middle_sin * c + middle_cos * s)
            ey[k] = across * (middle_cos * c - middle_sin * s)
        for k in range(lanes):
            doubt[k] = max(doubt[k], abs(u[k]) - _OCTANT, abs(w[k]) - _OCTANT)


@_kernel
def _exact_steps(point: FloatArray, k: int, p: _Lanes) -> None:
    """Turn one path's vectors into steps as the definition does."""
    for i in range(point.shape[0] // 3):
        across = point[3 * i] * math.cos(point[3 * i + 1])
        p.ex[i, k] = across * math.sin(point[3 * i + 2])
        p.ey[i, k] = across * math.cos(point[3 * i + 2])
        p.climb[i, k] = point[3 * i] * math.sin(point[3 * i + 1])


@_kernel
def _walk(m: MapArrays, p: _Lanes, first: int, last: int) -> None:
    """Add up the steps of paths ``first`` to ``last`` and clip them; find altitudes, legs, and sums over them."""
    height = m.height_m
    rows = float(height.shape[0])
    columns = float(height.shape[1])
    points = p.x.shape[0]
    p.x[0, first:last] = m.start[0]
    p.y[0, first:last] = m.start[1]
    p.z[0, first:last] = m.start[2]
    for i in range(points - 2):
        x, y, z, ex, ey, climb = p.x[i], p.y[i], p.z[i], p.ex[i], p.ey[i], p.climb[i]
        nx, ny, nz = p.x[i + 1], p.y[i + 1], p.z[i + 1]
        for k in range(first, last):
            nx[k] = min(max(x[k] + ex[k], 1.0), columns)
            ny[k] = min(max(y[k] + ey[k], 1.0), rows)
            nz[k] = min(max(z[k] + climb[k], LOW_M), HIGH_M)
    p.x[points - 1, first:last] = m.end[0]
    p.y[points - 1, first:last] = m.end[1]
    p.z[points - 1, first:last] = m.end[2]
    doubt = p.doubt
    for i in range(points):
        x, y, z, alt = p.x[i], p.y[i], p.z[i], p.alt[i]
        for k in range(first, last):
            row = (y[k] + _ROOT) - _ROOT
            column = (x[k] + _ROOT) - _ROOT
            alt[k] = z[k] + height[np.uint32(row - 1.0), np.uint32(column - 1.0)]
            # halves, and the map's last sample
            halves = max(abs(row - y[k]), abs(column - x[k])) - (0.5 - _GUARD)
            border = _GUARD - min(abs(x[k] - (columns - 1.0)), abs(y[k] - (rows - 1.0)))
            doubt[k] = max(doubt[k], halves, border)
    length, heights = p.length, p.heights
    length[first:last] = 0.0
    heights[first:last] = 0.0
    middle = 0.5 * (LOW_M + HIGH_M)
    for i in range(points - 1):
        x, y, alt, nx, ny, nalt, z = p.x[i], p.y[i], p.alt[i], p.x[i + 1], p.y[i + 1], p.alt[i + 1], p.z[i]
        ex, ey, ee, level, climb = p.ex[i], p.ey[i], p.ee[i], p.level[i], p.climb[i]
        for k in range(first, last):
            ex[k] = nx[k] - x[k]
            ey[k] = ny[k] - y[k]
            climb[k] = nalt[k] - alt[k]
            ee[k] = ex[k] * ex[k] + ey[k] * ey[k]
            level[k] = math.sqrt(ee[k])
            length[k] += math.sqrt(ee[k] + climb[k] * climb[k])
        if i > 0:
            for k in range(first, last):
                heights[k] += abs(z[k] - middle)
    for i in range(points - 2):
        ax, ay, al, ac = p.ex[i], p.ey[i], p.level[i], p.climb[i]
        bx, by, bl, bc, bend = p.ex[i + 1], p.ey[i + 1], p.level[i + 1], p.climb[i + 1], p.bend[i]
        for k in range(first, last):  # beyond 45 degrees the sine exceeds the cosine
            dot = ax[k] * bx[k] + ay[k] * by[k]
            along = al[k] * bl[k] + ac[k] * bc[k]
            turn = abs(ax[k] * by[k] - ay[k] * bx[k]) - dot
            rise = abs(al[k] * bc[k] - ac[k] * bl[k]) - along
            turn_guard = _GUARD * abs(dot)
            rise_guard = _GUARD * abs(along)
            bend[k] = max(turn + turn_guard, rise + rise_guard)
            doubt[k] = max(doubt[k], turn_guard - abs(turn), rise_guard - abs(rise))


@_kernel
def _threats(m: MapArrays, p: _Lanes, lanes: int) -> None:
    """Find what the legs of all paths pay for passing near cylinders."""
    cost, inverse, square, doubt = p.threats, p.inverse, p.square, p.doubt
    cost[:lanes] = 0.0
    doubt[:lanes] = 0.0
    for j in range(p.x.shape[0] - 1):
        x, y, ex, ey, ee = p.x[j], p.y[j], p.ex[j], p.ey[j], p.ee[j]
        for k in range(lanes):
            inverse[k] = 1.0 / ee[k] if ee[k] > 0.0 else 0.0
        for t in range(m.threat.shape[0]):
            cx = m.threat[t, 0]
            cy = m.threat[t, 1]
            inner = m.threat[t, 3] + INNER_M
            outer = m.threat[t, 3] + OUTER_M
            near = 0
            for k in range(lanes):
                wx = cx - x[k]
                wy = cy - y[k]
                s = min(1.0, max(0.0, (wx * ex[k] + wy * ey[k]) * inverse[k]))
                wx -= s * ex[k]
                wy -= s * ey[k]
                square[k] = wx * wx + wy * wy
                near += 1 if square[k] < outer * outer else 0
            if near > 0:
                for k in range(lanes):
                    d = math.sqrt(square[k])
                    cost[k] += PENALTY if d < inner else max(0.0, outer - d)
                    doubt[k] = max(doubt[k], _GUARD - abs(d - inner))
    for k in range(lanes):
        if doubt[k] > 0.0:
            cost[k] = _exact_threats(m, p, k)


@_kernel
def _exact_threats(m: MapArrays, p: _Lanes, k: int) -> float:
    """Return what path ``k`` pays for cylinders, as the definition rounds."""
    cost = 0.0
    for j in range(p.x.shape[0] - 1):
        ex, ey, ee = p.ex[j, k], p.ey[j, k], p.ee[j, k]
        for t in range(m.threat.shape[0]):
            wx, wy, radius = m.threat[t, 0] - p.x[j, k], m.threat[t, 1] - p.y[j, k], m.threat[t, 3]
            along = wx * ex + wy * ey
            if ee > 0.0 and along >= 0.0 and ee - along >= 0.0:
                d = abs(ex * wy - ey * wx) / math.sqrt(ee)
            else:
                d = min(math.sqrt(wx * wx + wy * wy), math.sqrt((wx - ex) ** 2 + (wy - ey) ** 2))
            if d <= radius + OUTER_M:
                cost += PENALTY if d < radius + INNER_M else radius + OUTER_M - d
    return cost


@_kernel
def _angles(p: _Lanes, k: int) -> float:
    """Sum of the turns and changes of climb of path ``k`` that are not free."""
    total = 0.0
    legs = p.x.shape[0] - 1
    for i in range(legs - 1):
        if p.bend[i, k] < 0.0:
            continue
        a = i
        while a > 0 and p.ee[a, k] == 0.0:  # a leg without length turns as the one before it, or after it
            a -= 1
        b = i + 1
        while b < legs - 1 and p.ee[b, k] == 0.0:
            b += 1
        turn, turn_is_doubtful = _turn(p.ex[a, k], p.ey[a, k], p.ex[b, k], p.ey[b, k])
        rise, rise_is_doubtful = _rise(p.level[a, k], p.climb[i, k], p.level[b, k], p.climb[i + 1, k])
        total += (turn if turn > FREE_DEG else 0.0) + (rise if rise > FREE_DEG else 0.0)
        if turn_is_doubtful or rise_is_doubtful:
            p.doubt[k] = 1.0
    return total


@_kernel
def _turn(ax: float, ay: float, bx: float, by: float) -> tuple[float, bool]:
    """Angle between two directions, degrees, 0 where it is free; and whether rounding decides that."""
    side = abs(ax * by - ay * bx)
    ahead = ax * bx + ay * by
    turn = math.degrees(math.atan2(side, ahead)) if side >= ahead * (1.0 - _GUARD) else 0.0
    return turn, abs(side - ahead) < _GUARD * ahead


@_kernel
def _rise(a: float, a_up: float, b: float, b_up: float) -> tuple[float, bool]:
    """Change of climb between two legs, from their lengths and climbs, as :func:`_turn`."""
    side = abs(a * b_up - a_up * b)
    ahead = a * b + a_up * b_up
    if side < ahead * (1.0 - _GUARD):
        return 0.0, False
    if side > ahead * (1.0 + _GUARD):
        return math.degrees(math.atan2(side, ahead)), False
    rise = abs(math.degrees(math.atan2(b_up, b)) - math.degrees(math.atan2(a_up, a)))
    return rise, abs(side - ahead) < _GUARD * ahead


@_kernel
def _under_ground(m: MapArrays, p: _Lanes, k: int) -> bool:
    """Whether one of the samples of a leg of path ``k`` is not above the ground, or outside it."""
    h = m.height_m
    rows, columns = h.shape
    legs = p.x.shape[0] - 1
    for i in range(legs + 1):
        if p.x[i, k] > columns - 1 or p.y[i, k] > rows - 1:
            return True
    scale = 1.0 / _BLOCK
    for i in range(legs):
        x0, y0, x1, y1, z0, z1 = p.x[i, k], p.y[i, k], p.x[i + 1, k], p.y[i + 1, k], p.alt[i, k], p.alt[i + 1, k]
        top = int(min(y0, y1) * scale)
        left = int(min(x0, x1) * scale)
        wide = max(int(max(y0, y1) * scale) - top, int(max(x0, x1) * scale) - left)
        level = 0
        while level < _LEVELS and (1 << level) <= wide:
            level += 1
        if level < _LEVELS and min(z0, z1) > m.highest_m[np.uint32(level), np.uint32(top), np.uint32(left)]:
            continue
        for s in range(SAMPLES):
            t = s / (SAMPLES - 1.0)
            x = x0 + t * (x1 - x0)
            y = y0 + t * (y1 - y0)
            z = z0 + t * (z1 - z0)
            row = int(y)
            column = int(x)
            if z > m.highest_m[0, np.uint32(row // _BLOCK), np.uint32(column // _BLOCK)]:
                continue
            if x > columns - 1 or y > rows - 1:
                return True
            row = min(row, rows - 2)
            column = min(column, columns - 2)
            fx = x - column
            fy = y - row
            r, c = np.uint32(row), np.uint32(column)
            below = h[r + np.uint32(1)]
            ground = (h[r, c] * (1 - fx) + h[r, c + np.uint32(1)] * fx) * (1 - fy) + (
                below[c] * (1 - fx) + below[c + np.uint32(1)] * fx
            ) * fy
            if not z > ground:
                return True
    return False


@_kernel
def _fly(points: FloatArray, m: MapArrays, p: _Lanes) -> None:
    """Fill the lanes with the paths of up to _LANES points, and all of their terms but the ground's."""
    lanes = points.shape[0]
    _steps(points, m.azimuth_rad, p)
    for k in range(lanes):
        if p.doubt[k] > 0.0:
            _exact_steps(points[k], k, p)
    _walk(m, p, 0 * lanes, lanes)
    for k in range(lanes):
        if p.doubt[k] > 0.0:
            _exact_steps(points[k], k, p)
            _walk(m, p, k, k + 1)
        p.doubt[k] = 0.0
        p.angles[k] = _angles(p, k)
        if p.doubt[k] > 0.0:
            _exact_steps(points[k], k, p)
            _walk(m, p, k, k + 1)
            p.angles[k] = _angles(p, k)
    _threats(m, p, lanes)


@_kernel
def _term_table(points: FloatArray, m: MapArrays, out: FloatArray) -> None:
    """Write the terms (P, 5) of points (P, 3 n)."""
    p = _lanes(points.shape[1] // 3 + 2)
    for first in range(0, points.shape[0], _LANES):
        block = points[first : first + _LANES]
        _fly(block, m, p)
        for k in range(block.shape[0]):
            terms = out[first + k]
            terms[0] = p.length[k]
            terms[1] = p.threats[k]
            terms[2] = p.heights[k]
            terms[3] = p.angles[k]
            terms[4] = PENALTY if _under_ground(m, p, k) else 0.0


@_kernel
def _prices(points: FloatArray, m: MapArrays, out: FloatArray) -> None:
    """Write the prices (P,) of points (P, 3 n)."""
    p = _lanes(points.shape[1] // 3 + 2)
    for first in range(0, points.shape[0], _LANES):
        block = points[first : first + _LANES]
        _fly(block, m, p)
        for k in range(block.shape[0]):
            under = PENALTY if _under_ground(m, p, k) else 0.0
            out[first + k] = 5.0 * p.length[k] + p.threats[k] + 10.0 * p.heights[k] + p.angles[k] + under


@_kernel
def _decoded(points: FloatArray, m: MapArrays, out: FloatArray) -> None:
    """Write the paths (P, n + 2, 3) of points (P, 3 n)."""
    p = _lanes(points.shape[1] // 3 + 2)
    for first in range(0, points.shape[0], _LANES):
        block = points[first : first + _LANES]
        _fly(block, m, p)
        for k in range(block.shape[0]):
            out[first + k, :, 0] = p.x[:, k]
            out[first + k, :, 1] = p.y[:, k]
            out[first + k, :, 2] = p.alt[:, k]
