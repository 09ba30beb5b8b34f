"""An independent, slow and obvious judge of what the checker claims: it looks at points, very many of them.

Nothing of the checker's geometry is used. The ground is Keys' convolution by the textbook over the grid as the file has
it, found through pyproj; distances are those to the closest point of a solid, found by hand for each kind. At every
point of a leg a vehicle may have strayed by its tube's radius: at random, straight down and up, up the slope and down
it, towards the nearest solid and towards the fence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import rasterio
from pyproj import CRS, Transformer

from missionplanner.compiled import njit
from missionplanner.geodesy import FloatArray
from missionplanner.obstacles import CableSolid, ConeSolid, CurtainSolid, CylinderSolid, PrismSolid, Solid, SphereSolid

_kernel = njit(cache=True, error_model="numpy")

ToCell = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Local x and y (...) to rows and columns (...)."""

_CYLINDER, _CONE, _SPHERE, _PRISM, _CABLE, _CURTAIN = range(6)

# Columns of a leg's samples.
LOWEST, HIGHEST, OBSTACLE, FENCE, COUNT = range(5)

WALK_STEP_M = 0.1
_STRIDE = 16
_STRAYS = 6  # per point: those that are looked at
_EXTREMES = 16
"""In each so many-th point of a leg strays up and down the slope are looked for with more care."""


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Heights AMSL (R, C) of a grid, NaN where there is none, and the way to its rows and columns."""

    height_m: FloatArray
    to_cell: ToCell

    @classmethod
    def read(cls, path: Path, lat_deg: float, lon_deg: float) -> Ground:
        """Read a raster file, for places east and north of an origin."""
        with rasterio.open(path) as dataset:
            heights = dataset.read(1).astype(np.float64)
            if dataset.nodata is not None:
                heights[heights == dataset.nodata] = np.nan
            (a, b, c, d, e, f), crs = (~dataset.transform)[:6], CRS.from_wkt(dataset.crs.to_wkt())
        local = CRS.from_proj4(f"+proj=tmerc +lat_0={lat_deg!r} +lon_0={lon_deg!r} +k=1 +ellps=WGS84 +units=m")
        way = Transformer.from_crs(local, crs, always_xy=True)

        def to_cell(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
            east, north = way.transform(x, y)
            return d * east + e * north + f - 0.5, a * east + b * north + c - 0.5  # a pixel's corner to its centre

        return cls(heights, to_cell)

    def at(self, xy: FloatArray) -> FloatArray:
        """Return the heights (N,) at places (N, 2)."""
        row, column = self.to_cell(xy[:, 0], xy[:, 1])
        heights: FloatArray = _surfaces(self.height_m, row, column)
        return heights

    def along(self, legs: FloatArray) -> FloatArray:
        """Return where legs (N, 2, 3) run on the grid (N, 7, 2): at start, middle and end.

        Then how many cells a metre east and north is at start and end. A parabola through the three is within a
        micrometre of the truth over a kilometre.
        """
        start, end = legs[:, 0], legs[:, 1]
        cells = [self._cells(p, 0.0, 0.0) for p in (start, 0.5 * (start + end), end)]
        for dx, dy in ((1.0, 0.0), (0.0, 1.0)):
            cells += [0.5 * (self._cells(p, dx, dy) - self._cells(p, -dx, -dy)) for p in (start, end)]
        return np.ascontiguousarray(np.stack(cells, axis=1))

    def _cells(self, places: FloatArray, dx: float, dy: float) -> FloatArray:
        return np.stack(self.to_cell(places[:, 0] + dx, places[:, 1] + dy), axis=-1)


class Solids(NamedTuple):
    """Hard solids by kind, their numbers, their corners; and fence and area."""

    kind: npt.NDArray[np.int64]  # (O,)
    numbers: FloatArray  # (O, 7)
    corners: FloatArray  # (V, 2), of prisms
    first: npt.NDArray[np.int64]  # (O + 1,)
    fence: FloatArray  # (K, 2); K = 0: none
    fence_top: float
    area: FloatArray  # (4,): west, south, east, north


def solids_of(solids: Sequence[Solid], fence: FloatArray, fence_top: float, area: FloatArray) -> Solids:
    """Return solids as the oracle takes them."""
    kinds, numbers, first, corners = [], [], [0], [np.zeros((0, 2))]
    row: tuple[float, ...]
    for solid in solids:
        outline = np.zeros((0, 2))
        match solid:
            case CylinderSolid(_, x, y, radius, top):
                kind, row = _CYLINDER, (x, y, radius, top)
            case ConeSolid(_, x, y, radius, base, height):
                kind, row = _CONE, (x, y, base, radius, height)
            case SphereSolid(_, x, y, z, radius):
                if not solid.hard:
                    continue
                kind, row = _SPHERE, (x, y, z, radius)
            case PrismSolid(_, xy, floor, top):
                kind, row, outline = _PRISM, (floor, top), np.asarray(xy, dtype=np.float64)
            case CableSolid(_, start, end, radius):
                kind, row = _CABLE, (*start, *end, radius)
            case CurtainSolid(_, start, end, radius):
                kind, row = _CURTAIN, (*start, *end, radius)
        kinds.append(kind)
        numbers.append((*row, *[0.0] * (7 - len(row))))
        corners.append(outline)
        first.append(first[-1] + len(outline))
    return Solids(
        np.array(kinds, dtype=np.int64),
        np.array(numbers, dtype=np.float64).reshape(-1, 7),
        np.concatenate(corners),
        np.array(first, dtype=np.int64),
        np.ascontiguousarray(fence, dtype=np.float64),
        fence_top,
        np.asarray(area, dtype=np.float64),
    )


def strays(rng: np.random.Generator, count: int = 4096) -> FloatArray:
    """Return places (N, 3) in the unit ball, half of them on its surface."""
    places = rng.normal(size=(count, 3))
    places /= np.linalg.norm(places, axis=1, keepdims=True)
    places[::2] *= np.cbrt(rng.random((len(places[::2]), 1)))
    return places


def sample_legs(
    ground: Ground, solids: Solids, legs: FloatArray, radius_m: FloatArray, step_m: float, unit: FloatArray
) -> FloatArray:
    """Return what legs (N, 2, 3), strayed from by radii (N,), were seen to keep: (N, 5).

    Least and greatest height above ground (-inf and inf where there is none), least distance to a solid (negative
    inside) and inside the fence, and how many strayed points were looked at, ``step_m`` apart.
    """
    legs = np.ascontiguousarray(legs, dtype=np.float64)
    table: FloatArray = _sample_legs(ground.height_m, ground.along(legs), solids, legs, radius_m, step_m, unit)
    return table


# --- the ground ------------------------------------------------------------------------------------------------------


@_kernel
def _weight(s: float) -> float:
    """Keys' cubic convolution kernel with a = -1/2 (IEEE TASSP 29(6), 1981, eq. 15)."""
    s = abs(s)
    if s < 1.0:
        return 1.5 * s * s * s - 2.5 * s * s + 1.0
    if s < 2.0:
        return -0.5 * s * s * s + 2.5 * s * s - 4.0 * s + 2.0
    return 0.0


@_kernel
def _surface(h: FloatArray, row: float, column: float) -> float:
    if not (math.isfinite(row) and math.isfinite(column)):
        return np.nan
    top = math.floor(row)
    left = math.floor(column)
    if top < 1 or top + 2 >= h.shape[0] or left < 1 or left + 2 >= h.shape[1]:
        return np.nan
    w0, w1, w2, w3 = (
        _weight(column - left + 1.0),
        _weight(column - left),
        _weight(column - left - 1.0),
        _weight(column - left - 2.0),
    )
    total = 0.0
    for i in range(top - 1, top + 3):
        line = w0 * h[i, left - 1] + w1 * h[i, left] + w2 * h[i, left + 1] + w3 * h[i, left + 2]
        total += _weight(row - i) * line
    return total


@_kernel
def _surfaces(h: FloatArray, row: FloatArray, column: FloatArray) -> FloatArray:
    out = np.empty(row.shape[0])
    for n in range(row.shape[0]):
        out[n] = _surface(h, row[n], column[n])
    return out


# --- solids ----------------------------------------------------------------------------------------------------------


@_kernel
def _within(corners: FloatArray, first: int, last: int, x: float, y: float) -> bool:
    """Whether a place is inside a polygon: how often the outline winds around it (Sunday 2001)."""
    winding = 0
    for k in range(first, last):
        n = k + 1 if k + 1 < last else first
        ax, ay = corners[k, 0] - x, corners[k, 1] - y
        bx, by = corners[n, 0] - x, corners[n, 1] - y
        left = ax * by - ay * bx
        if ay <= 0.0 < by and left > 0.0:
            winding += 1
        elif by <= 0.0 < ay and left < 0.0:
            winding -= 1
    return winding != 0


@_kernel
def _on_outline(corners: FloatArray, first: int, last: int, x: float, y: float) -> tuple[float, float]:
    """Return the closest place of a polygon's outline."""
    least = np.inf
    qx = qy = 0.0
    for k in range(first, last):
        n = k + 1 if k + 1 < last else first
        ex, ey = corners[n, 0] - corners[k, 0], corners[n, 1] - corners[k, 1]
        s = ((x - corners[k, 0]) * ex + (y - corners[k, 1]) * ey) / (ex * ex + ey * ey)
        s = max(0.0, min(1.0, s))
        px, py = corners[k, 0] + s * ex, corners[k, 1] + s * ey
        d = math.hypot(x - px, y - py)
        if d < least:
            least, qx, qy = d, px, py
    return qx, qy


@_kernel
def _off_plumb(v: FloatArray, s: float, x: float, y: float, z: float) -> float:
    """Return how far a point is from all that is straight below one place of a cable."""
    dx, dy = x - v[0] - s * (v[3] - v[0]), y - v[1] - s * (v[4] - v[1])
    dz = max(0.0, z - v[2] - s * (v[5] - v[2]))
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@_kernel
def _closest(w: Solids, i: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the distance to a solid, -1 inside, and its closest point."""
    v = w.numbers[i]
    kind = w.kind[i]
    qx, qy, qz = x, y, z
    if kind == _SPHERE:
        d = math.sqrt((x - v[0]) ** 2 + (y - v[1]) ** 2 + (z - v[2]) ** 2)
        if d <= v[3]:
            return -1.0, x, y, z
        share = v[3] / d
        qx, qy, qz = v[0] + share * (x - v[0]), v[1] + share * (y - v[1]), v[2] + share * (z - v[2])
    elif kind == _CABLE:
        ex, ey, ez = v[3] - v[0], v[4] - v[1], v[5] - v[2]
        s = ((x - v[0]) * ex + (y - v[1]) * ey + (z - v[2]) * ez) / (ex * ex + ey * ey + ez * ez)
        s = max(0.0, min(1.0, s))
        cx, cy, cz = v[0] + s * ex, v[1] + s * ey, v[2] + s * ez
        d = math.sqrt((x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2)
        if d <= v[6]:
            return -1.0, x, y, z
        share = v[6] / d
        qx, qy, qz = cx + share * (x - cx), cy + share * (y - cy), cz + share * (z - cz)
    elif kind == _CURTAIN:  # what hangs from one place of the cable: its distance is convex along the cable
        low, high = 0.0, 1.0
        for _ in range(100):
            one, other = low + (high - low) / 3.0, high - (high - low) / 3.0
            if _off_plumb(v, one, x, y, z) > _off_plumb(v, other, x, y, z):
                low = one
            else:
                high = other
        s = 0.5 * (low + high)
        d = _off_plumb(v, s, x, y, z)
        if d <= v[6]:
            return -1.0, x, y, z
        share = v[6] / d
        cx, cy, cz = v[0] + s * (v[3] - v[0]), v[1] + s * (v[4] - v[1]), min(z, v[2] + s * (v[5] - v[2]))
        qx, qy, qz = cx + share * (x - cx), cy + share * (y - cy), cz + share * (z - cz)
    elif kind == _PRISM:
        within = _within(w.corners, w.first[i], w.first[i + 1], x, y)
        if within and v[0] <= z <= v[1]:
            return -1.0, x, y, z
        if not within:
            qx, qy = _on_outline(w.corners, w.first[i], w.first[i + 1], x, y)
        qz = min(max(z, v[0]), v[1])
    else:
        rho = math.hypot(x - v[0], y - v[1])
        if kind == _CYLINDER:
            if rho <= v[2] and z <= v[3]:
                return -1.0, x, y, z
            out, qz = min(rho, v[2]), min(z, v[3])
        else:  # in the plane through the axis a cone is a triangle: its base, its flank
            up = z - v[2]
            if 0.0 <= up <= v[4] and rho <= v[3] * (1.0 - up / v[4]):
                return -1.0, x, y, z
            out, qz = min(rho, v[3]), v[2]
            s = ((rho - v[3]) * -v[3] + up * v[4]) / (v[3] * v[3] + v[4] * v[4])
            s = max(0.0, min(1.0, s))
            flank, high = v[3] * (1.0 - s), v[4] * s
            if math.hypot(rho - flank, up - high) < math.hypot(rho - out, up):
                out, qz = flank, v[2] + high
        if rho > 0.0:
            qx, qy = v[0] + out / rho * (x - v[0]), v[1] + out / rho * (y - v[1])
    return math.sqrt((x - qx) ** 2 + (y - qy) ** 2 + (z - qz) ** 2), qx, qy, qz


@_kernel
def nearest(w: Solids, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the distance to the nearest solid, and its closest point."""
    least = np.inf
    qx, qy, qz = x, y, z
    for i in range(w.kind.shape[0]):
        d, ax, ay, az = _closest(w, i, x, y, z)
        if d < least:
            least, qx, qy, qz = d, ax, ay, az
    return least, qx, qy, qz


@_kernel
def _edge(w: Solids, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return how far a place is inside fence and area, -1 outside, and their closest point."""
    west, south, east, north = w.area
    if not (west <= x <= east and south <= y <= north) or z > w.fence_top:
        return -1.0, x, y, z
    least, qx, qy, qz = x - west, west, y, z
    if east - x < least:
        least, qx, qy = east - x, east, y
    if y - south < least:
        least, qx, qy = y - south, x, south
    if north - y < least:
        least, qx, qy = north - y, x, north
    count = w.fence.shape[0]
    if count > 0:
        if not _within(w.fence, 0 * count, count, x, y):
            return -1.0, x, y, z
        px, py = _on_outline(w.fence, 0 * count, count, x, y)
        if math.hypot(x - px, y - py) < least:
            least, qx, qy = math.hypot(x - px, y - py), px, py
        if w.fence_top - z < least:
            least, qx, qy, qz = w.fence_top - z, x, y, w.fence_top
    return least, qx, qy, qz


# --- legs ------------------------------------------------------------------------------------------------------------


@_kernel
def _ground_near(h: FloatArray, cells: FloatArray, s: float, dx: float, dy: float) -> float:
    """Return the ground beside a leg, at a share of it and so far east and north."""
    row = cells[0, 0] + s * (4.0 * cells[1, 0] - 3.0 * cells[0, 0] - cells[2, 0])
    row += s * s * 2.0 * (cells[0, 0] + cells[2, 0] - 2.0 * cells[1, 0])
    column = cells[0, 1] + s * (4.0 * cells[1, 1] - 3.0 * cells[0, 1] - cells[2, 1])
    column += s * s * 2.0 * (cells[0, 1] + cells[2, 1] - 2.0 * cells[1, 1])
    r = 1.0 - s
    row += dx * (r * cells[3, 0] + s * cells[4, 0]) + dy * (r * cells[5, 0] + s * cells[6, 0])
    column += dx * (r * cells[3, 1] + s * cells[4, 1]) + dy * (r * cells[5, 1] + s * cells[6, 1])
    return _surface(h, row, column)


@_kernel
def _sample_legs(
    h: FloatArray,
    cells: FloatArray,
    w: Solids,
    legs: FloatArray,
    radius_m: FloatArray,
    step_m: float,
    unit: FloatArray,
) -> FloatArray:
    table = np.empty((legs.shape[0], 5))
    for n in range(legs.shape[0]):
        radius = radius_m[n]
        ax, ay, az = legs[n, 0]
        ex, ey, ez = legs[n, 1, 0] - ax, legs[n, 1, 1] - ay, legs[n, 1, 2] - az
        pieces = max(1, math.ceil(math.sqrt(ex * ex + ey * ey + ez * ez) / step_m))
        low = obstacle = fence = np.inf
        high = -np.inf
        missing = False
        gx = gy = 0.0
        for k in range(pieces + 1):
            s = k / pieces
            x, y, z = ax + s * ex, ay + s * ey, az + s * ez
            here = _ground_near(h, cells[n], s, 0.0, 0.0)
            low = min(low, z - radius - here)  # straight down
            high = max(high, z + radius - here)
            if k % _EXTREMES == 0:
                gx = 0.5 * (_ground_near(h, cells[n], s, 1.0, 0.0) - _ground_near(h, cells[n], s, -1.0, 0.0))
                gy = 0.5 * (_ground_near(h, cells[n], s, 0.0, 1.0) - _ground_near(h, cells[n], s, 0.0, -1.0))
            down = radius / math.sqrt(1.0 + gx * gx + gy * gy)
            up_slope = _ground_near(h, cells[n], s, down * gx, down * gy)
            low = min(low, z - down - up_slope)
            down_slope = _ground_near(h, cells[n], s, -down * gx, -down * gy)
            high = max(high, z + down - down_slope)
            any_way = unit[(k * 7 + n * 131) % unit.shape[0]]
            dx, dy, dz = radius * any_way[0], radius * any_way[1], radius * any_way[2]
            aside = _ground_near(h, cells[n], s, dx, dy)
            low = min(low, z + dz - aside)
            high = max(high, z + dz - aside)
            missing = missing or math.isnan(here + up_slope + down_slope + aside)
            for turn in range(2):  # towards the nearest solid, towards the nearest edge
                d, qx, qy, qz = nearest(w, x, y, z) if turn == 0 else _edge(w, x, y, z)
                if 0.0 < d < np.inf:
                    share = radius / d
                    px, py, pz = x + share * (qx - x), y + share * (qy - y), z + share * (qz - z)
                    d = (nearest(w, px, py, pz) if turn == 0 else _edge(w, px, py, pz))[0] if radius < d else -1.0
                if turn == 0:
                    obstacle = min(obstacle, d, nearest(w, x + dx, y + dy, z + dz)[0])
                else:
                    fence = min(fence, d, _edge(w, x + dx, y + dy, z + dz)[0])
        table[n, LOWEST] = -np.inf if missing else low
        table[n, HIGHEST] = np.inf if missing else high
        table[n, OBSTACLE] = obstacle
        table[n, FENCE] = fence
        table[n, COUNT] = (pieces + 1) * _STRAYS
    return table


def lowest(ground: Ground, legs: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Return the least height above ground (N,) that could be found within a radius of legs (N, 2, 3).

    First everywhere, 0.25 m apart in many directions, then ever more finely around the least of them.
    """
    legs = np.ascontiguousarray(legs, dtype=np.float64)
    around = [(0.0, 0.0, -1.0)]
    for lean_deg in (10.0, 20.0, 30.0, 45.0, 60.0, 80.0):
        lean = math.radians(lean_deg)
        for turn in np.arange(16) * (math.pi / 8.0):
            flat = math.sin(lean)
            around.append((flat * math.cos(turn), flat * math.sin(turn), -math.cos(lean)))
    least: FloatArray = _lowest(ground.height_m, ground.along(legs), legs, radius_m, np.array(around))
    return least


@_kernel
def _height(h: FloatArray, cells: FloatArray, leg: FloatArray, s: float, dx: float, dy: float, radius: float) -> float:
    """Return the height at the bottom of the ball, so far aside."""
    flat = dx * dx + dy * dy
    if flat > radius * radius or not 0.0 <= s <= 1.0:
        return np.inf
    z: float = leg[0, 2] + s * (leg[1, 2] - leg[0, 2]) - math.sqrt(radius * radius - flat)
    return z - _ground_near(h, cells, s, dx, dy)


@_kernel
def _lowest(h: FloatArray, cells: FloatArray, legs: FloatArray, radius_m: FloatArray, around: FloatArray) -> FloatArray:
    out = np.empty(legs.shape[0])
    for n in range(legs.shape[0]):
        leg, radius = legs[n], radius_m[n]
        length = math.sqrt(((leg[1] - leg[0]) ** 2).sum())
        pieces = max(4, math.ceil(length / 0.25))
        best = np.inf
        bs = bx = by = 0.0
        for k in range(pieces + 1):
            for a in range(around.shape[0]):
                dx, dy = radius * around[a, 0], radius * around[a, 1]
                found = _height(h, cells[n], leg, k / pieces, dx, dy, radius)
                if found < best:
                    best, bs, bx, by = found, k / pieces, dx, dy
        ds, step = 1.0 / pieces, 0.2 * radius
        while step > 1e-4 or ds * length > 1e-4:
            better = False
            for i in range(-1, 2):
                for j in range(-1, 2):
                    for m in range(-1, 2):
                        s, dx, dy = bs + i * ds, bx + j * step, by + m * step
                        flat = math.hypot(dx, dy)
                        if flat > radius:
                            dx, dy = dx * radius / flat * (1.0 - 1e-12), dy * radius / flat * (1.0 - 1e-12)
                        found = _height(h, cells[n], leg, s, dx, dy, radius)
                        if found < best:
                            best, cs, cx, cy = found, s, dx, dy
                            better = True
            if better:
                bs, bx, by = cs, cx, cy
            else:
                ds, step = 0.5 * ds, 0.5 * step
        out[n] = best
    return out


# --- fleets ----------------------------------------------------------------------------------------------------------


@_kernel
def least_strayed(a: FloatArray, b: FloatArray, stray_a: float, stray_b: float, unit: FloatArray, first: int) -> float:
    """Return the least distance of two motions (T, 3) at the same ticks, each strayed: towards the other, at random."""
    least = np.inf
    for k in range(a.shape[0]):
        x, y, z = b[k, 0] - a[k, 0], b[k, 1] - a[k, 1], b[k, 2] - a[k, 2]
        d = math.sqrt(x * x + y * y + z * z)
        least = min(least, d - stray_a - stray_b)
        m = unit[(first + 5 * k) % unit.shape[0]]
        n = unit[(first + 11 * k + 3) % unit.shape[0]]
        x += stray_b * n[0] - stray_a * m[0]
        y += stray_b * n[1] - stray_a * m[1]
        z += stray_b * n[2] - stray_a * m[2]
        least = min(least, math.sqrt(x * x + y * y + z * z))
    return least


@_kernel
def least_between(a: FloatArray, b: FloatArray) -> float:
    """Return the least distance between any point of one :func:`walk` (N, 3) and any of another (M, 3).

    First between every so many-th of them, then between all near those that are near each other.
    """
    least = np.inf
    reach = 2.0 * _STRIDE * WALK_STEP_M  # how much nearer their neighbours may be
    for close in range(2):
        for i in range(0, a.shape[0], _STRIDE):
            for j in range(0, b.shape[0], _STRIDE):
                d = math.sqrt((a[i, 0] - b[j, 0]) ** 2 + (a[i, 1] - b[j, 1]) ** 2 + (a[i, 2] - b[j, 2]) ** 2)
                if close == 0 or d - reach >= least:
                    least = min(least, d)
                    continue
                for k in range(i, min(i + _STRIDE, a.shape[0])):
                    for m in range(j, min(j + _STRIDE, b.shape[0])):
                        x, y, z = a[k, 0] - b[m, 0], a[k, 1] - b[m, 1], a[k, 2] - b[m, 2]
                        least = min(least, math.sqrt(x * x + y * y + z * z))
    return least


def walk(corners_m: FloatArray) -> FloatArray:
    """Return points (N, 3) along a polyline (K, 3), no more than :data:`WALK_STEP_M` apart, its corners among them."""
    parts = [corners_m[:1]]
    for a, b in pairwise(corners_m):
        count = max(1, math.ceil(float(np.linalg.norm(b - a)) / WALK_STEP_M))
        parts.append(a + (np.arange(1, count + 1) / count)[:, np.newaxis] * (b - a))
    return np.concatenate(parts)
