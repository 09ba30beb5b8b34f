"""The hot loops, in numba on raw arrays; everything else in the core calls these.

Positions are local: x east, y north, z altitude AMSL, metres. Nothing is validated here. Solids are exact signed
distances (negative inside), so each changes by at most one metre per metre flown (1-Lipschitz); all that is said about
distances *between* samples rests on that.
"""

# ruff: noqa: PLR0917  (kernels take raw arrays: many arguments are their nature)
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

FloatArray = npt.NDArray[np.float64]

CYLINDER, CONE, RADAR, MARINE, PRISM, CABLE = range(6)

# Columns of `legs_clearance`; "AT" is the place on the leg, from 0 at its first to 1 at its second point.
HEIGHT_MIN, HEIGHT_MIN_AT, HEIGHT_MAX, OBSTACLE, OBSTACLE_AT, OBSTACLE_INDEX, FENCE, FENCE_AT = range(8)
CLEARANCE_COLUMNS = 8

_FAR_M = 1e12
_GOLDEN = 0.3819660112501051
_CLEARANCE_TOLERANCE_M = 1e-4


class TerrainArrays(NamedTuple):
    """An elevation grid in its own coordinate system, and the way there from the local frame.

    ``(row, col) = to_cell @ [1, u, v, u^2, uv, v^2, u^3, u^2 v, u v^2, v^3]`` with u = x_m / 1e4, v = y_m / 1e4;
    integer rows and columns are sample centres. No resampling: the surface is the file's own.
    """

    height_amsl_m: npt.NDArray[np.float32]  # (R, C), NaN = void
    to_cell: FloatArray  # (2, 10)


class ObstacleArrays(NamedTuple):
    """All solids, packed; a row of ``params`` reads according to its kind.

    cylinder: x, y, radius, top; cone: x, y, base radius, base z, height; radar and marine (spheres): x, y, z, radius;
    prism: floor, top, 1 if convex; cable (capsule): x, y, z of both ends, radius.
    """

    kind: npt.NDArray[np.int64]  # (O,)
    params: FloatArray  # (O, 8)
    bound: FloatArray  # (O, 3): x, y, radius of a horizontal circle around the solid
    hard: npt.NDArray[np.bool_]  # (O,)
    vertices: FloatArray  # (V, 2), of all prisms
    vertex_start: npt.NDArray[np.int64]  # (O + 1,): solid i owns vertices[vertex_start[i]:vertex_start[i + 1]]


class SpaceArrays(NamedTuple):
    """Everything that stands still and that a path must keep clear of."""

    terrain: TerrainArrays
    obstacles: ObstacleArrays
    fence: FloatArray  # (K, 2); K = 0: none
    fence_top_amsl_m: float  # inf: none
    area: FloatArray  # (4,): west, south, east, north


# --- terrain -------------------------------------------------------------------------------------------------------


@njit(cache=True)
def cell_position(t: TerrainArrays, x: float, y: float) -> tuple[float, float]:
    """Return the (fractional) row and column of a place."""
    u = x * 1e-4
    v = y * 1e-4
    a = t.to_cell
    row = (
        a[0, 0]
        + u * (a[0, 1] + u * (a[0, 3] + u * a[0, 6] + v * a[0, 7]))
        + v * (a[0, 2] + u * a[0, 4] + v * (a[0, 5] + u * a[0, 8] + v * a[0, 9]))
    )
    col = (
        a[1, 0]
        + u * (a[1, 1] + u * (a[1, 3] + u * a[1, 6] + v * a[1, 7]))
        + v * (a[1, 2] + u * a[1, 4] + v * (a[1, 5] + u * a[1, 8] + v * a[1, 9]))
    )
    return row, col


@njit(cache=True)
def _keys(t: float) -> tuple[float, float, float, float]:
    """Weights of the four neighbours in cubic convolution (Keys 1981, a = -1/2)."""
    return (
        ((1.0 - 0.5 * t) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((2.0 - 1.5 * t) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@njit(cache=True)
def _surface(h: npt.NDArray[np.float32], row: float, col: float) -> float:
    if not (1.0 <= row < h.shape[0] - 2 and 1.0 <= col < h.shape[1] - 2):
        return np.nan
    i = int(row)
    j = int(col)
    w0, w1, w2, w3 = _keys(col - j)
    r0, r1, r2, r3 = _keys(row - i)
    height: float = (
        r0 * (w0 * h[i - 1, j - 1] + w1 * h[i - 1, j] + w2 * h[i - 1, j + 1] + w3 * h[i - 1, j + 2])
        + r1 * (w0 * h[i, j - 1] + w1 * h[i, j] + w2 * h[i, j + 1] + w3 * h[i, j + 2])
        + r2 * (w0 * h[i + 1, j - 1] + w1 * h[i + 1, j] + w2 * h[i + 1, j + 1] + w3 * h[i + 1, j + 2])
        + r3 * (w0 * h[i + 2, j - 1] + w1 * h[i + 2, j] + w2 * h[i + 2, j + 1] + w3 * h[i + 2, j + 2])
    )
    return height


@njit(cache=True)
def terrain_height(t: TerrainArrays, x: float, y: float) -> float:
    """Return the ground's altitude AMSL by bicubic convolution; NaN where any of the 16 neighbours is missing."""
    row, col = cell_position(t, x, y)
    return _surface(t.height_amsl_m, row, col)


@njit(cache=True)
def terrain_heights(t: TerrainArrays, xy: FloatArray) -> FloatArray:
    """Return the ground's altitudes (N,) at places (N, 2)."""
    out = np.empty(xy.shape[0])
    for n in range(xy.shape[0]):
        out[n] = terrain_height(t, xy[n, 0], xy[n, 1])
    return out


# --- solids --------------------------------------------------------------------------------------------------------


@njit(cache=True)
def polygon_distance(vertices: FloatArray, start: int, stop: int, x: float, y: float) -> float:
    """Return the signed distance (negative inside) to the simple polygon ``vertices[start:stop]``."""
    least = _FAR_M * _FAR_M
    inside = False
    px = vertices[stop - 1, 0]
    py = vertices[stop - 1, 1]
    for k in range(start, stop):
        qx = vertices[k, 0]
        qy = vertices[k, 1]
        ex = qx - px
        ey = qy - py
        wx = x - px
        wy = y - py
        ee = ex * ex + ey * ey
        s = (wx * ex + wy * ey) / ee if ee > 0.0 else 0.0
        s = min(1.0, max(0.0, s))
        dx = wx - s * ex
        dy = wy - s * ey
        least = min(least, dx * dx + dy * dy)
        if (py > y) != (qy > y) and (ex * wy - ey * wx > 0.0) == (ey > 0.0):
            inside = not inside
        px = qx
        py = qy
    d = math.sqrt(least)
    return -d if inside else d


@njit(cache=True)
def _extruded(across: float, along: float) -> float:
    """Signed distance to a prism from those to its outline and to its slab of heights."""
    if across <= 0.0:
        return along if along > 0.0 else max(across, along)
    return math.sqrt(across * across + along * along) if along > 0.0 else across


@njit(cache=True)
def _cone(rho: float, up: float, radius: float, height: float) -> float:
    """Signed distance to a cone standing on up = 0, at ``rho`` from its axis."""
    s = ((rho - radius) * -radius + up * height) / (radius * radius + height * height)
    s = min(1.0, max(0.0, s))
    dr = rho - radius * (1.0 - s)
    du = up - height * s
    slant = math.sqrt(dr * dr + du * du)
    if up > 0.0 and rho * height + up * radius < radius * height:
        return -min(slant, up)
    over = max(0.0, rho - radius)
    return min(slant, math.sqrt(over * over + up * up))


@njit(cache=True)
def obstacle_distance(o: ObstacleArrays, i: int, x: float, y: float, z: float) -> float:
    """Return the exact signed distance from a point to solid ``i``, negative inside; 1-Lipschitz."""
    p = o.params
    kind = o.kind[i]
    if kind == PRISM:
        across = polygon_distance(o.vertices, o.vertex_start[i], o.vertex_start[i + 1], x, y)
        return _extruded(across, max(p[i, 0] - z, z - p[i, 1]))
    dx: float = x - p[i, 0]
    dy: float = y - p[i, 1]
    if kind == CABLE:
        dz = z - p[i, 2]
        ex = p[i, 3] - p[i, 0]
        ey = p[i, 4] - p[i, 1]
        ez = p[i, 5] - p[i, 2]
        ee = ex * ex + ey * ey + ez * ez
        s = (dx * ex + dy * ey + dz * ez) / ee if ee > 0.0 else 0.0
        s = min(1.0, max(0.0, s))
        dx -= s * ex
        dy -= s * ey
        dz -= s * ez
        cable_radius: float = p[i, 6]
        return math.sqrt(dx * dx + dy * dy + dz * dz) - cable_radius
    rho2 = dx * dx + dy * dy
    if kind == CYLINDER:
        return _extruded(math.sqrt(rho2) - p[i, 2], z - p[i, 3])
    if kind == CONE:
        return _cone(math.sqrt(rho2), z - p[i, 3], p[i, 2], p[i, 4])
    dz = z - p[i, 2]
    sphere_radius: float = p[i, 3]
    return math.sqrt(rho2 + dz * dz) - sphere_radius


@njit(cache=True)
def obstacle_distances(o: ObstacleArrays, points: FloatArray) -> FloatArray:
    """Return signed distances (N, O) from points (N, 3) to every solid."""
    out = np.empty((points.shape[0], o.kind.shape[0]))
    for n in range(points.shape[0]):
        for i in range(o.kind.shape[0]):
            out[n, i] = obstacle_distance(o, i, points[n, 0], points[n, 1], points[n, 2])
    return out


@njit(cache=True)
def inside_distance(space: SpaceArrays, x: float, y: float, z: float) -> float:
    """Return how far a point is inside area and fence (polygon and top), negative outside; 1-Lipschitz."""
    area = space.area
    d: float = min(x - area[0], area[2] - x, y - area[1], area[3] - y)
    if space.fence.shape[0] > 0:
        d = min(d, -polygon_distance(space.fence, 0, space.fence.shape[0], x, y))
        d = min(d, space.fence_top_amsl_m - z)
    return d


# --- straight legs -------------------------------------------------------------------------------------------------


@njit(cache=True)
def _on_leg(o: ObstacleArrays, i: int, leg: FloatArray, s: float) -> float:
    return obstacle_distance(
        o,
        i,
        leg[0, 0] + s * (leg[1, 0] - leg[0, 0]),
        leg[0, 1] + s * (leg[1, 1] - leg[0, 1]),
        leg[0, 2] + s * (leg[1, 2] - leg[0, 2]),
    )


@njit(cache=True)
def _least_convex(
    o: ObstacleArrays, i: int, leg: FloatArray, length: float, enough: float, refuse: float
) -> tuple[float, float]:
    """Lower bound of the distance to a convex solid along a leg, and where.

    Along a line the signed distance to a convex solid is convex: golden section brackets its least value, and secants
    bound it from below. Stops early when all is at least ``enough``, or anything below ``refuse``.
    """
    a = 0.0
    b = 1.0
    m = _GOLDEN
    fa = _on_leg(o, i, leg, a)
    fb = _on_leg(o, i, leg, b)
    least = min(fa, fb)
    lower = 0.5 * (fa + fb - length)
    at = a if fa <= fb else b
    if lower >= enough or least < refuse:
        return min(lower, least), at
    fm = _on_leg(o, i, leg, m)
    for _ in range(80):
        if fm < least:
            least = fm
            at = m
        if least < refuse:
            break
        left = fm - max(0.0, (fb - fm) / (b - m)) * (m - a)
        left = max(left, 0.5 * (fa + fm - (m - a) * length))
        right = fm - max(0.0, (fa - fm) / (m - a)) * (b - m)
        right = max(right, 0.5 * (fm + fb - (b - m) * length))
        lower = min(left, right)
        if lower >= enough or lower >= least - _CLEARANCE_TOLERANCE_M or (b - a) * length < _CLEARANCE_TOLERANCE_M:
            break
        if b - m > m - a:
            x = m + _GOLDEN * (b - m)
            fx = _on_leg(o, i, leg, x)
            if fx < fm:
                a, fa, m, fm = m, fm, x, fx
            else:
                b, fb = x, fx
        else:
            x = m - _GOLDEN * (m - a)
            fx = _on_leg(o, i, leg, x)
            if fx < fm:
                b, fb, m, fm = m, fm, x, fx
            else:
                a, fa = x, fx
    return min(lower, least), at


@njit(cache=True)
def _least_lipschitz(
    o: ObstacleArrays, i: int, leg: FloatArray, length: float, enough: float, refuse: float
) -> tuple[float, float]:
    """Lower bound of the distance to any solid along a leg, and where, by steps as long as the distance allows."""
    d = _on_leg(o, i, leg, 0.0)
    least = d
    lower = d
    at = 0.0
    s = 0.0
    while s < length and least >= refuse:
        step = min(length - s, max(d - min(least, enough), 0.05 + 0.01 * abs(d)))
        s += step
        ahead = _on_leg(o, i, leg, min(1.0, s / length))
        lower = min(lower, 0.5 * (d + ahead - step))
        if ahead < least:
            least = ahead
            at = min(1.0, s / length)
        d = ahead
    return min(lower, least), at


@njit(cache=True)
def _leg_obstacle(o: ObstacleArrays, leg: FloatArray, enough: float, refuse: float) -> tuple[float, float, int]:
    """Lower bound of the distance to the nearest hard solid (at most ``enough``), where on the leg, and which one."""
    ax = leg[0, 0]
    ay = leg[0, 1]
    ex = leg[1, 0] - ax
    ey = leg[1, 1] - ay
    ez = leg[1, 2] - leg[0, 2]
    ee = ex * ex + ey * ey
    length = math.sqrt(ee + ez * ez)
    best = enough
    best_at = 0.0
    best_index = -1
    for i in range(o.kind.shape[0]):
        if not o.hard[i]:
            continue
        wx = o.bound[i, 0] - ax
        wy = o.bound[i, 1] - ay
        s = min(1.0, max(0.0, (wx * ex + wy * ey) / ee)) if ee > 0.0 else 0.0
        wx -= s * ex
        wy -= s * ey
        reach = best + o.bound[i, 2]
        if reach < 0.0 or wx * wx + wy * wy >= reach * reach:
            continue
        if o.kind[i] == PRISM and o.params[i, 2] == 0.0:
            d, at = _least_lipschitz(o, i, leg, length, best, refuse)
        else:
            d, at = _least_convex(o, i, leg, length, best, refuse)
        if d < best:
            best, best_at, best_index = d, at, i
            if best < refuse:
                break
    return best, best_at, best_index


@njit(cache=True)
def _leg_inside(space: SpaceArrays, leg: FloatArray, enough: float, refuse: float) -> tuple[float, float]:
    """Lower bound of the distance inside area and fence along a leg (at most ``enough``), and where."""
    d0 = inside_distance(space, leg[0, 0], leg[0, 1], leg[0, 2])
    d1 = inside_distance(space, leg[1, 0], leg[1, 1], leg[1, 2])
    at = 0.0 if d0 <= d1 else 1.0
    if space.fence.shape[0] == 0:  # to a rectangle the distance inside is concave: least at an end
        return min(enough, d0, d1), at
    ex = leg[1, 0] - leg[0, 0]
    ey = leg[1, 1] - leg[0, 1]
    ez = leg[1, 2] - leg[0, 2]
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    least = min(d0, d1)
    lower = least
    d = d0
    s = 0.0
    while s < length and least >= refuse:
        step = min(length - s, max(d - min(least, enough), 0.05 + 0.01 * abs(d)))
        s += step
        f = min(1.0, s / length)
        ahead = inside_distance(space, leg[0, 0] + f * ex, leg[0, 1] + f * ey, leg[0, 2] + f * ez)
        lower = min(lower, 0.5 * (d + ahead - step))
        if ahead < least:
            least = ahead
            at = f
        d = ahead
    return min(enough, lower, least), at


@njit(cache=True)
def leg_clearance(space: SpaceArrays, leg: FloatArray, step_m: float, out: FloatArray) -> None:
    """Write one row of :func:`legs_clearance` for one leg (2, 3)."""
    ex = leg[1, 0] - leg[0, 0]
    ey = leg[1, 1] - leg[0, 1]
    ez = leg[1, 2] - leg[0, 2]
    pieces = max(1, math.ceil(math.sqrt(ex * ex + ey * ey) / step_m))
    out[HEIGHT_MIN] = np.inf
    out[HEIGHT_MIN_AT] = 0.0
    out[HEIGHT_MAX] = -np.inf
    for k in range(pieces + 1):
        s = k / pieces
        height = leg[0, 2] + s * ez - terrain_height(space.terrain, leg[0, 0] + s * ex, leg[0, 1] + s * ey)
        if math.isnan(height):
            out[HEIGHT_MIN] = -np.inf
            out[HEIGHT_MIN_AT] = s
            out[HEIGHT_MAX] = np.inf
            break
        out[HEIGHT_MAX] = max(out[HEIGHT_MAX], height)
        if height < out[HEIGHT_MIN]:
            out[HEIGHT_MIN] = height
            out[HEIGHT_MIN_AT] = s
    out[OBSTACLE], out[OBSTACLE_AT], out[OBSTACLE_INDEX] = _leg_obstacle(space.obstacles, leg, _FAR_M, -np.inf)
    if out[OBSTACLE_INDEX] < 0:
        out[OBSTACLE] = np.inf
    out[FENCE], out[FENCE_AT] = _leg_inside(space, leg, _FAR_M, -np.inf)


@njit(cache=True)
def legs_clearance(space: SpaceArrays, legs: FloatArray, step_m: float) -> FloatArray:
    """Return what each straight leg keeps clear of, (N, CLEARANCE_COLUMNS), for legs (N, 2, 3).

    Heights above ground are least and greatest of samples at most ``step_m`` apart (-inf and inf where terrain is
    missing). Distances to hard obstacles (inf and index -1: none) and inside area and fence are lower bounds for the
    whole leg: within 0.1 mm for convex solids, 0.03 m and 1 % for other prisms and the fence.
    """
    out = np.empty((legs.shape[0], CLEARANCE_COLUMNS))
    for n in range(legs.shape[0]):
        leg_clearance(space, legs[n], step_m, out[n])
    return out


@njit(cache=True)
def leg_is_clear(
    space: SpaceArrays,
    leg: FloatArray,
    step_m: float,
    height_min_m: float,
    height_max_m: float,
    alt_max_m: float,
    obstacle_min_m: float,
    fence_min_m: float,
) -> bool:
    """Return whether a leg (2, 3) keeps these heights and distances; stops at the first that it does not."""
    if max(leg[0, 2], leg[1, 2]) > alt_max_m:
        return False
    if _leg_inside(space, leg, fence_min_m, fence_min_m)[0] < fence_min_m:
        return False
    if _leg_obstacle(space.obstacles, leg, obstacle_min_m, obstacle_min_m)[2] >= 0:
        return False
    ex = leg[1, 0] - leg[0, 0]
    ey = leg[1, 1] - leg[0, 1]
    ez = leg[1, 2] - leg[0, 2]
    pieces = max(1, math.ceil(math.sqrt(ex * ex + ey * ey) / step_m))
    for k in range(pieces + 1):
        s = k / pieces
        height = leg[0, 2] + s * ez - terrain_height(space.terrain, leg[0, 0] + s * ex, leg[0, 1] + s * ey)
        if not height_min_m <= height <= height_max_m:
            return False
    return True


@njit(cache=True)
def legs_are_clear(
    space: SpaceArrays,
    legs: FloatArray,
    step_m: float,
    height_min_m: float,
    height_max_m: float,
    alt_max_m: float,
    obstacle_min_m: float,
    fence_min_m: float,
) -> npt.NDArray[np.bool_]:
    """Return :func:`leg_is_clear` (N,) of legs (N, 2, 3)."""
    out = np.empty(legs.shape[0], dtype=np.bool_)
    for n in range(legs.shape[0]):
        out[n] = leg_is_clear(
            space, legs[n], step_m, height_min_m, height_max_m, alt_max_m, obstacle_min_m, fence_min_m
        )
    return out
