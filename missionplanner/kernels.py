"""The hot loops, in numba on raw arrays; everything else in the core calls these.

Positions are local: x east, y north, z altitude AMSL, metres. Nothing is validated here. Solids are exact signed
distances (negative inside), so each changes by at most one metre per metre flown (1-Lipschitz); all that is said about
distances *between* samples rests on that.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner.compiled import njit

FloatArray = npt.NDArray[np.float64]

# Divisions by zero are guarded where they can occur. Integer arguments are never literals: those
# would compile a function anew (hence 0 * n).
kernel = njit(cache=True, error_model="numpy")
if TYPE_CHECKING:
    leaf = kernel
else:
    # Of functions that make no array and call only such: to count who holds the arrays of a tuple takes longer than
    # most arithmetic.
    leaf = njit(cache=True, error_model="numpy", _nrt=False)

CYLINDER, CONE, RADAR, MARINE, PRISM, CABLE, CURTAIN = range(7)

# Columns of `legs_clearance`; "AT" is the place on the leg, from 0 at its first to 1 at its second point.
HEIGHT_MIN, HEIGHT_MIN_AT, HEIGHT_MAX, HEIGHT_MAX_AT, OBSTACLE, OBSTACLE_AT, OBSTACLE_INDEX, FENCE, FENCE_AT = range(9)
CLEARANCE_COLUMNS = 9

# Columns of `price_paths`: what is traded off, then what is forbidden.
VOYAGE, SMOOTH, INSPECTION, RADAR_ZONE, ATMOSPHERE, CLIMB = range(6)
TERRAIN, CEILING, OBSTACLES, COLLISION, OCEAN, FENCED, FELLOWS, CLIMB_ANGLE, TURN = range(6, 15)
PRICE_COLUMNS = 15
BLOCK = 8  # samples

BENDING_M = 20.0
"""Scale of the bending energy: a right angle flown on an arc of 25 m costs about as much as 40 m of way."""

_FAR_M = 1e12
_MISSING_TERRAIN_M = 100.0
"""Depth below the least height where terrain is missing; outside its coverage, the way back to it is added."""
_GOLDEN = 0.3819660112501051
_CLEARANCE_TOLERANCE_M = 1e-4
_ROUNDING_M = 1e-6
"""By which squares are asked further than what is asked about reaches."""


class TerrainArrays(NamedTuple):
    """An elevation grid in its own coordinate system, and the way there from the local frame.

    ``(row, col) = to_cell @ [1, u, v, u^2, uv, v^2, u^3, u^2 v, u v^2, v^3]`` with u = x_m / 1e4, v = y_m / 1e4;
    integer rows and columns are sample centres. No resampling: the surface is the file's own.
    """

    height_amsl_m: npt.NDArray[np.float32]  # (R, C), NaN = void
    to_cell: FloatArray  # (2, 10)


class ObstacleGrid(NamedTuple):
    """Which solids to ask about a place, however many there are: the squares that the circles around them touch.

    One square alone: too few solids to be worth it. Built by :func:`missionplanner.obstacles.indexed`.
    """

    west: float
    south: float
    cell_m: float
    start: npt.NDArray[np.int32]  # (R, C + 1): square r, c owns solid[start[r, c]:start[r, c + 1]]
    solid: npt.NDArray[np.int32]
    span: npt.NDArray[np.int32]  # (O, 4): first row and column, last row and column of each solid
    large: npt.NDArray[np.int32]  # the few that are asked about every place and stand in no square


class ObstacleArrays(NamedTuple):
    """All solids, packed; a row of ``params`` reads according to its kind.

    cylinder: x, y, radius, top; cone: x, y, base radius, base z, height; radar and marine (spheres): x, y, z, radius;
    prism: floor, top, 1 if convex; cable (capsule) and curtain (all below one): x, y, z of both ends, radius.
    """

    kind: npt.NDArray[np.int64]  # (O,)
    params: FloatArray  # (O, 8)
    bound: FloatArray  # (O, 5): x, y, radius of a horizontal circle around the solid; lowest and highest z
    hard: npt.NDArray[np.bool_]  # (O,)
    vertices: FloatArray  # (V, 2), of all prisms
    vertex_start: npt.NDArray[np.int64]  # (O + 1,): solid i owns vertices[vertex_start[i]:vertex_start[i + 1]]
    grid: ObstacleGrid


class SpaceArrays(NamedTuple):
    """Everything that stands still and that a path must keep clear of."""

    terrain: TerrainArrays
    obstacles: ObstacleArrays
    fence: FloatArray  # (K, 2); K = 0: none
    fence_top_amsl_m: float  # inf: none
    area: FloatArray  # (4,): west, south, east, north


# --- terrain -------------------------------------------------------------------------------------------------------


@leaf
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


@leaf
def _keys(t: float) -> tuple[float, float, float, float]:
    """Weights of the four neighbours in cubic convolution (Keys 1981, a = -1/2)."""
    return (
        ((1.0 - 0.5 * t) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((2.0 - 1.5 * t) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@leaf
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


@leaf
def terrain_height(t: TerrainArrays, x: float, y: float) -> float:
    """Return the ground's altitude AMSL by bicubic convolution; NaN where any of the 16 neighbours is missing."""
    row, col = cell_position(t, x, y)
    return _surface(t.height_amsl_m, row, col)


@kernel
def terrain_heights(t: TerrainArrays, xy: FloatArray) -> FloatArray:
    """Return the ground's altitudes (N,) at places (N, 2)."""
    out = np.empty(xy.shape[0])
    for n in range(xy.shape[0]):
        out[n] = terrain_height(t, xy[n, 0], xy[n, 1])
    return out


# --- solids --------------------------------------------------------------------------------------------------------


@leaf
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


@leaf
def _extruded(across: float, along: float) -> float:
    """Signed distance to a prism from those to its outline and to its slab of heights."""
    if across <= 0.0:
        return along if along > 0.0 else max(across, along)
    return math.sqrt(across * across + along * along) if along > 0.0 else across


@leaf
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


@leaf
def curtain_frame(p: FloatArray, i: int, x: float, y: float) -> tuple[float, float, float]:
    """Return a place beside curtain ``i`` seen from above: along it from its start, to its right; and its length."""
    ex = p[i, 3] - p[i, 0]
    ey = p[i, 4] - p[i, 1]
    length = math.sqrt(ex * ex + ey * ey)
    dx = x - p[i, 0]
    dy = y - p[i, 1]
    return (dx * ex + dy * ey) / length, (dx * ey - dy * ex) / length, length


@leaf
def off_curtain(along: float, up: float, length: float, rise: float) -> tuple[float, float]:
    """Return how far, along and up, a place in the plane of a curtain is from it; both 0 in it.

    The curtain hangs from the origin and from ``length`` along and ``rise`` up, without end.
    """
    if 0.0 <= along <= length and up * length <= rise * along:
        return 0.0, 0.0
    s = min(1.0, max(0.0, (along * length + up * rise) / (length * length + rise * rise)))
    off_along = along - s * length
    off_up = up - s * rise
    if along < 0.0 or along > length:
        beyond = along if along < 0.0 else along - length
        above = max(0.0, up if along < 0.0 else up - rise)
        if beyond * beyond + above * above < off_along * off_along + off_up * off_up:
            return beyond, above
    return off_along, off_up


@leaf
def obstacle_distance(o: ObstacleArrays, i: int, x: float, y: float, z: float) -> float:
    """Return the exact signed distance from a point to solid ``i``, negative inside; 1-Lipschitz."""
    p = o.params
    kind = o.kind[i]
    if kind == PRISM:
        across = polygon_distance(o.vertices, o.vertex_start[i], o.vertex_start[i + 1], x, y)
        return _extruded(across, max(p[i, 0] - z, z - p[i, 1]))
    dx: float = x - p[i, 0]
    dy: float = y - p[i, 1]
    if kind == CURTAIN:
        along, aside, length = curtain_frame(p, i, x, y)
        off_along, off_up = off_curtain(along, z - p[i, 2], length, p[i, 5] - p[i, 2])
        curtain_radius: float = p[i, 6]
        return math.sqrt(aside * aside + off_along * off_along + off_up * off_up) - curtain_radius
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


@kernel
def obstacle_distances(o: ObstacleArrays, points: FloatArray) -> FloatArray:
    """Return signed distances (N, O) from points (N, 3) to every solid."""
    out = np.empty((points.shape[0], o.kind.shape[0]))
    for n in range(points.shape[0]):
        for i in range(o.kind.shape[0]):
            out[n, i] = obstacle_distance(o, i, points[n, 0], points[n, 1], points[n, 2])
    return out


@leaf
def grid_square(at: float, low: float, cell_m: float, count: int) -> int:
    """Return the row or column of a coordinate, the nearest of those that there are."""
    square = (at - low) / cell_m
    last = count - 1
    if not square > 0.0:  # NaN, too
        square = 0.0
    found: int = int(square) if square < last else last
    return found


@leaf
def _nearer_hard(o: ObstacleArrays, i: int, x: float, y: float, z: float, best: float) -> float:
    """Return the distance to a solid if it is hard and nearer than ``best``, else that."""
    dx = x - o.bound[i, 0]
    dy = y - o.bound[i, 1]
    reach = best + o.bound[i, 2]
    if o.hard[i] and reach > 0.0 and dx * dx + dy * dy < reach * reach:
        return min(best, obstacle_distance(o, i, x, y, z))
    return best


@leaf
def nearest_hard(o: ObstacleArrays, x: float, y: float, z: float, enough: float) -> float:
    """Return the signed distance from a point to the nearest hard solid, ``enough`` if none is nearer than that."""
    g = o.grid
    rows = g.start.shape[0]
    columns = g.start.shape[1] - 1
    row = grid_square(y, g.south, g.cell_m, rows)
    column = grid_square(x, g.west, g.cell_m, columns)
    best = enough
    for n in range(g.large.shape[0]):
        best = _nearer_hard(o, g.large[n], x, y, z, best)
    for ring in range(max(rows, columns)):
        if ring > 0 and (ring - 1) * g.cell_m > best:  # who is inside a solid is in one of its squares
            break
        for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
            step = 1 if abs(r - row) == ring or ring == 0 else 2 * ring  # all of the ring's ends, two of its sides
            for c in range(column - ring, column + ring + 1, step):
                if not 0 <= c < columns:
                    continue
                for n in range(g.start[r, c], g.start[r, c + 1]):
                    best = _nearer_hard(o, g.solid[n], x, y, z, best)
    return best


@leaf
def inside_distance(space: SpaceArrays, x: float, y: float, z: float) -> float:
    """Return how far a point is inside area and fence (polygon and top), negative outside; 1-Lipschitz."""
    area = space.area
    d: float = min(x - area[0], area[2] - x, y - area[1], area[3] - y)
    count = space.fence.shape[0]
    if count > 0:
        d = min(d, -polygon_distance(space.fence, 0 * count, count, x, y))
        d = min(d, space.fence_top_amsl_m - z)
    return d


# --- straight legs -------------------------------------------------------------------------------------------------


@leaf
def _on_leg(o: ObstacleArrays, i: int, leg: FloatArray, s: float) -> float:
    return obstacle_distance(
        o,
        i,
        leg[0, 0] + s * (leg[1, 0] - leg[0, 0]),
        leg[0, 1] + s * (leg[1, 1] - leg[0, 1]),
        leg[0, 2] + s * (leg[1, 2] - leg[0, 2]),
    )


@leaf
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


@leaf
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


@leaf
def _beside_curtain(o: ObstacleArrays, i: int, reach: float, a: FloatArray, b: FloatArray) -> bool:
    """Whether the leg a-b is seen to stay beyond ``reach`` of curtain ``i``: to one side, past an end or above it."""
    p = o.params
    far: float = reach + p[i, 6]
    along_a, aside_a, length = curtain_frame(p, i, a[0], a[1])
    along_b, aside_b, _ = curtain_frame(p, i, b[0], b[1])
    if min(aside_a, aside_b) >= far or max(aside_a, aside_b) <= -far:
        return True
    if min(along_a, along_b) >= length + far or max(along_a, along_b) <= -far:
        return True
    rise = p[i, 5] - p[i, 2]
    above_a = (a[2] - p[i, 2]) * length - along_a * rise
    above_b = (b[2] - p[i, 2]) * length - along_b * rise
    over: bool = min(above_a, above_b) >= far * math.sqrt(length * length + rise * rise)
    return over


@leaf
def _leg_solid(
    o: ObstacleArrays, i: int, leg: FloatArray, length: float, best: float, refuse: float
) -> tuple[float, float]:
    """Lower bound of the distance to hard solid ``i`` along a leg, and where; inf where it is ``best`` or more."""
    ex = leg[1, 0] - leg[0, 0]
    ey = leg[1, 1] - leg[0, 1]
    ee = ex * ex + ey * ey
    wx = o.bound[i, 0] - leg[0, 0]
    wy = o.bound[i, 1] - leg[0, 1]
    s = min(1.0, max(0.0, (wx * ex + wy * ey) / ee)) if ee > 0.0 else 0.0
    wx -= s * ex
    wy -= s * ey
    reach = best + o.bound[i, 2]
    if not o.hard[i] or reach < 0.0 or wx * wx + wy * wy >= reach * reach:
        return np.inf, s
    if min(leg[0, 2], leg[1, 2]) - o.bound[i, 4] >= best or o.bound[i, 3] - max(leg[0, 2], leg[1, 2]) >= best:
        return np.inf, s
    if o.kind[i] == CURTAIN and _beside_curtain(o, i, best, leg[0], leg[1]):  # its circle is much wider than it is
        return np.inf, s
    if o.kind[i] == PRISM and o.params[i, 2] == 0.0:
        return _least_lipschitz(o, i, leg, length, best, refuse)
    return _least_convex(o, i, leg, length, best, refuse)


@leaf
def _leg_columns(g: ObstacleGrid, leg: FloatArray, row: int, reach: float) -> tuple[int, int]:
    """First and last column of a row of squares that come within ``reach`` of a leg."""
    low = 0.0
    high = 1.0
    ex = leg[1, 0] - leg[0, 0]
    ey = leg[1, 1] - leg[0, 1]
    if ey != 0.0:
        one = (g.south + row * g.cell_m - reach - leg[0, 1]) / ey
        other = (g.south + (row + 1) * g.cell_m + reach - leg[0, 1]) / ey
        low = min(1.0, max(0.0, min(one, other)))
        high = min(1.0, max(0.0, one, other))
    west = leg[0, 0] + min(low * ex, high * ex) - reach
    east = leg[0, 0] + max(low * ex, high * ex) + reach
    columns = g.start.shape[1] - 1
    return grid_square(west, g.west, g.cell_m, columns), grid_square(east, g.west, g.cell_m, columns)


@leaf
def _leg_obstacle_within(o: ObstacleArrays, leg: FloatArray, enough: float, refuse: float) -> tuple[float, float, int]:
    """:func:`_leg_obstacle` by the squares within ``enough`` of the leg."""
    ex = leg[1, 0] - leg[0, 0]
    ey = leg[1, 1] - leg[0, 1]
    ez = leg[1, 2] - leg[0, 2]
    length = math.sqrt(ex * ex + ey * ey + ez * ez)
    best = enough
    best_at = 0.0
    best_index = -1
    g = o.grid
    rows = g.start.shape[0]
    for n in range(g.large.shape[0]):
        i = g.large[n]
        d, at = _leg_solid(o, i, leg, length, best, refuse)
        if d < best:
            best, best_at, best_index = d, at, i
            if best < refuse:
                return best, best_at, best_index
    reach = max(enough, 0.0) + _ROUNDING_M
    first_row = grid_square(min(leg[0, 1], leg[1, 1]) - reach, g.south, g.cell_m, rows)
    last_row = grid_square(max(leg[0, 1], leg[1, 1]) + reach, g.south, g.cell_m, rows)
    first_before = 0 * rows
    last_before = first_before - 1
    for r in range(first_row, last_row + 1):
        first, last = _leg_columns(g, leg, r, reach)
        for c in range(first, last + 1):
            for n in range(g.start[r, c], g.start[r, c + 1]):
                i = g.solid[n]
                # asked once: in its first square of the row, unless the row before had it
                if c > max(first, g.span[i, 1]):
                    continue
                if r > max(first_row, g.span[i, 0]) and g.span[i, 1] <= last_before and g.span[i, 3] >= first_before:
                    continue
                d, at = _leg_solid(o, i, leg, length, best, refuse)
                if d < best or (d == best and best_index > i):
                    best, best_at, best_index = d, at, i
                    if best < refuse:
                        return best, best_at, best_index
        first_before = first
        last_before = last
    return best, best_at, best_index


@leaf
def _leg_obstacle(o: ObstacleArrays, leg: FloatArray, enough: float, refuse: float) -> tuple[float, float, int]:
    """Lower bound of the distance to the nearest hard solid (at most ``enough``), where on the leg, and which one."""
    g = o.grid
    rows = g.start.shape[0]
    columns = g.start.shape[1] - 1
    reach = 2.0 * g.cell_m  # further only where nothing is found within it
    widest = g.cell_m * (rows + columns) + abs(leg[0, 0] - g.west) + abs(leg[0, 1] - g.south)
    while rows * columns > 1 and reach < min(enough, widest):
        best, at, index = _leg_obstacle_within(o, leg, reach, refuse)
        if index >= 0:
            return best, at, index
        reach *= 4.0
    return _leg_obstacle_within(o, leg, enough, refuse)


@leaf
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


@kernel
def legs_clearance(space: SpaceArrays, legs: FloatArray, step_m: float) -> FloatArray:
    """Return what each straight leg keeps clear of, (N, CLEARANCE_COLUMNS), for legs (N, 2, 3).

    Heights above ground are least and greatest of samples at most ``step_m`` apart (-inf and inf where terrain is
    missing). Distances to hard obstacles (inf and index -1: none) and inside area and fence are lower bounds for the
    whole leg: within 0.1 mm for convex solids, 0.03 m and 1 % for other prisms and the fence.
    """
    table = np.empty((legs.shape[0], CLEARANCE_COLUMNS))
    for n in range(legs.shape[0]):
        leg = legs[n]
        out = table[n]
        ex = leg[1, 0] - leg[0, 0]
        ey = leg[1, 1] - leg[0, 1]
        ez = leg[1, 2] - leg[0, 2]
        pieces = max(1, math.ceil(math.sqrt(ex * ex + ey * ey) / step_m))
        out[HEIGHT_MIN] = np.inf
        out[HEIGHT_MIN_AT] = 0.0
        out[HEIGHT_MAX] = -np.inf
        out[HEIGHT_MAX_AT] = 0.0
        for k in range(pieces + 1):
            s = k / pieces
            height = leg[0, 2] + s * ez - terrain_height(space.terrain, leg[0, 0] + s * ex, leg[0, 1] + s * ey)
            if math.isnan(height):
                out[HEIGHT_MIN] = -np.inf
                out[HEIGHT_MIN_AT] = s
                out[HEIGHT_MAX] = np.inf
                out[HEIGHT_MAX_AT] = s
                break
            if height > out[HEIGHT_MAX]:
                out[HEIGHT_MAX] = height
                out[HEIGHT_MAX_AT] = s
            if height < out[HEIGHT_MIN]:
                out[HEIGHT_MIN] = height
                out[HEIGHT_MIN_AT] = s
        out[OBSTACLE], out[OBSTACLE_AT], out[OBSTACLE_INDEX] = _leg_obstacle(space.obstacles, leg, _FAR_M, -np.inf)
        if out[OBSTACLE_INDEX] < 0:
            out[OBSTACLE] = np.inf
        out[FENCE], out[FENCE_AT] = _leg_inside(space, leg, _FAR_M, -np.inf)
    return table


@leaf
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


@kernel
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


# --- the price of paths --------------------------------------------------------------------------------------------


class PriceSettings(NamedTuple):
    """What the price measures against; all floats, so that one compiled kernel serves all."""

    route_length_m: float
    height_min_m: float
    height_max_m: float
    alt_max_m: float
    obstacle_m: float
    fence_m: float
    climb_slope: float
    descent_slope: float
    turn_radius_m: float
    turn_angle_rad: float
    separation_m: float
    tower_range_m: float
    cell_m: float  # of the terrain grid


@leaf
def _shape_terms(path: FloatArray, q: PriceSettings, hop: FloatArray, out: FloatArray) -> None:
    """Length, bending, climbing and turning; ``hop`` (S - 1,) receives the lengths between samples."""
    length = 0.0
    bending = 0.0
    squared_altitude = 0.0
    gained = 0.0
    steep = 0.0
    turned = 0.0
    turn_is_limited = q.turn_radius_m > 0.0 or q.turn_angle_rad < math.pi
    ux = uy = uz = before = level_before = 0.0
    for k in range(hop.shape[0]):
        dx = path[k + 1, 0] - path[k, 0]
        dy = path[k + 1, 1] - path[k, 1]
        dz = path[k + 1, 2] - path[k, 2]
        level2 = dx * dx + dy * dy
        h = math.sqrt(level2 + dz * dz)
        level = math.sqrt(level2)
        hop[k] = h
        length += h
        squared_altitude += 0.5 * h * (path[k, 2] * path[k, 2] + path[k + 1, 2] * path[k + 1, 2])
        gained += max(0.0, dz)
        steep += max(0.0, dz - q.climb_slope * level, -dz - q.descent_slope * level)
        if h == 0.0:
            continue
        vx = dx / h
        vy = dy / h
        vz = dz / h
        if before > 0.0:
            bx = vx - ux
            by = vy - uy
            bz = vz - uz
            bending += (bx * bx + by * by + bz * bz) / (0.5 * (before + h))
            if turn_is_limited:
                turn = math.atan2(abs(ux * vy - uy * vx), ux * vx + uy * vy)
                allowed = q.turn_angle_rad
                if q.turn_radius_m > 0.0:
                    allowed = min(allowed, 0.5 * (level_before + level) / q.turn_radius_m)
                turned += max(0.0, turn - allowed)
        ux = vx
        uy = vy
        uz = vz
        before = h
        level_before = level
    out[VOYAGE] = length / q.route_length_m
    out[SMOOTH] = bending * BENDING_M * BENDING_M / q.route_length_m
    out[ATMOSPHERE] = squared_altitude * 1e-6 / q.route_length_m
    out[CLIMB] = gained / q.route_length_m
    out[CLIMB_ANGLE] = steep / q.route_length_m
    out[TURN] = turned / math.pi


@leaf
def _heights(t: TerrainArrays, q: PriceSettings, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Depth below the least height, excess over the ceilings, and how far from the nearer of both (negative: past)."""
    row, col = cell_position(t, x, y)
    h = t.height_amsl_m
    height = z - _surface(h, row, col)
    over = max(0.0, z - q.alt_max_m)
    if height >= q.height_min_m:
        if height <= q.height_max_m:
            return 0.0, over, min(height - q.height_min_m, q.height_max_m - height)
        return 0.0, max(over, height - q.height_max_m), q.height_max_m - height
    if height < q.height_min_m:
        return q.height_min_m - height, max(over, height - q.height_max_m), height - q.height_min_m
    rows_out = max(0.0, 1.0 - row, row - (h.shape[0] - 2))
    cols_out = max(0.0, 1.0 - col, col - (h.shape[1] - 2))
    out_m = q.cell_m * math.sqrt(rows_out * rows_out + cols_out * cols_out)
    return _MISSING_TERRAIN_M + out_m, over, -np.inf


@leaf
def _height_terms(path: FloatArray, t: TerrainArrays, q: PriceSettings, hop: FloatArray, out: FloatArray) -> None:
    """Height band, integrated; pieces near its limits are sampled twice per terrain cell.

    "Near" means that ground steeper than two in one would be needed to cross a limit between the samples unseen.
    """
    under = 0.0
    over = 0.0
    low, high, slack = _heights(t, q, path[0, 0], path[0, 1], path[0, 2])
    for k in range(hop.shape[0]):
        next_low, next_high, next_slack = _heights(t, q, path[k + 1, 0], path[k + 1, 1], path[k + 1, 2])
        sum_low = 0.5 * (low + next_low)
        sum_high = 0.5 * (high + next_high)
        piece = hop[k]
        if slack + next_slack < 2.0 * hop[k]:
            pieces = max(1, math.ceil(2.0 * hop[k] / q.cell_m))
            for j in range(1, pieces):
                s = j / pieces
                below, above, _ = _heights(
                    t,
                    q,
                    path[k, 0] + s * (path[k + 1, 0] - path[k, 0]),
                    path[k, 1] + s * (path[k + 1, 1] - path[k, 1]),
                    path[k, 2] + s * (path[k + 1, 2] - path[k, 2]),
                )
                sum_low += below
                sum_high += above
            piece = hop[k] / pieces
        under += sum_low * piece
        over += sum_high * piece
        low = next_low
        high = next_high
        slack = next_slack
    scale = max(1.0, q.height_min_m) * q.route_length_m
    out[TERRAIN] = under / scale
    out[CEILING] = over / scale


@leaf
def hiding_step(reach: float) -> float:
    """Return the spacing of samples between which nothing deeper than 0.1 m can hide.

    Whatever is closer than ``reach`` to something is a union of balls of that radius; a chord c of a ball of radius r
    lies at most about c^2 / (8 r) deep.
    """
    return max(0.5, math.sqrt(0.8 * reach))


@leaf
def _slack(space: SpaceArrays, i: int, reach: float, step: float, x: float, y: float, z: float) -> float:
    """How far a point is beyond ``reach`` of solid ``i`` (far off: at least how far); of the fence for i = O."""
    o = space.obstacles
    if i == o.kind.shape[0]:
        return inside_distance(space, x, y, z) - reach
    dx = x - o.bound[i, 0]
    dy = y - o.bound[i, 1]
    outer: float = o.bound[i, 2] + reach
    rho2 = dx * dx + dy * dy
    if rho2 > (outer + step) * (outer + step):
        return math.sqrt(rho2) - outer
    return obstacle_distance(o, i, x, y, z) - reach


@leaf
def _beside_cable(o: ObstacleArrays, i: int, reach: float, a: FloatArray, b: FloatArray) -> bool:
    """Whether the piece a-b stays beyond ``reach`` of cable ``i``: closest points of two segments (Ericson 2005)."""
    p = o.params
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = p[i, 3] - p[i, 0], p[i, 4] - p[i, 1], p[i, 5] - p[i, 2]
    wx, wy, wz = a[0] - p[i, 0], a[1] - p[i, 1], a[2] - p[i, 2]
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    uw = ux * wx + uy * wy + uz * wz
    vw = vx * wx + vy * wy + vz * wz
    apart = uu * vv - uv * uv
    s = min(1.0, max(0.0, (uv * vw - uw * vv) / apart)) if apart > 1e-12 * uu * vv else 0.0
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    if t < 0.0 or t > 1.0:
        t = min(1.0, max(0.0, t))
        s = min(1.0, max(0.0, (uv * t - uw) / uu)) if uu > 0.0 else 0.0
    dx, dy, dz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    far: float = reach + p[i, 6]
    beside: bool = dx * dx + dy * dy + dz * dz >= far * far
    return beside


@leaf
def beside_line(o: ObstacleArrays, i: int, reach: float, a: FloatArray, b: FloatArray) -> bool:
    """Return whether the piece a-b stays beyond ``reach`` of a cable or curtain; False of other solids.

    Along a line one flies beside its conductors, or over them, just out of reach: this spares many short steps.
    """
    if o.kind[i] == CABLE:
        return _beside_cable(o, i, reach, a, b)
    beside: bool = o.kind[i] == CURTAIN and _beside_curtain(o, i, reach, a, b)
    return beside


@leaf
def _depth_integral(
    path: FloatArray, hop: FloatArray, first: int, last: int, space: SpaceArrays, i: int, reach: float, step: float
) -> float:
    """Integral from sample ``first`` to ``last`` of the depth within ``reach`` of solid ``i`` (soft: squared).

    The trapezoidal rule on pieces of at most ``step``, exactly, though most points are never looked at: a distance of
    d beyond reach means no depth for the next d metres of path. For i = O, depth into the margin of fence and area.
    """
    solid = i < space.obstacles.kind.shape[0]
    squared = solid and not space.obstacles.hard[i]
    total = 0.0
    skip = 0.0  # metres of path without depth, from sample k on
    before = 0.0  # length of the piece before the point
    for k in range(first, last + 1):
        ahead = hop[k] if k < last else 0.0
        if skip > 0.0 and skip >= ahead:
            skip -= ahead
            continue
        if solid and k < last and beside_line(space.obstacles, i, reach, path[k], path[k + 1]):
            skip = 0.0
            continue
        pieces = max(1, math.ceil(ahead / step))
        piece = ahead / pieces
        j = int(skip / piece) if skip > 0.0 else 0
        if j > 0:
            before = piece
        elif k > first:
            before = hop[k - 1] / max(1, math.ceil(hop[k - 1] / step))
        ex = path[k + 1, 0] - path[k, 0] if k < last else 0.0
        ey = path[k + 1, 1] - path[k, 1] if k < last else 0.0
        ez = path[k + 1, 2] - path[k, 2] if k < last else 0.0
        skip = 0.0
        while j < pieces:
            s = j / pieces
            slack = _slack(space, i, reach, step, path[k, 0] + s * ex, path[k, 1] + s * ey, path[k, 2] + s * ez)
            skip = max(0.0, slack - (pieces - j) * piece)
            if slack <= 0.0:
                total += 0.5 * (before + piece) * (slack * slack if squared else -slack)
                j += 1
            elif slack < ahead:
                j += 1 + int(slack / piece)
            else:
                j = pieces
            before = piece
    return total


@leaf
def _box_near(box: FloatArray, x: float, y: float, near: float, lowest: float, highest: float) -> bool:
    """Whether a box (6,) comes within ``near`` of a vertical axis, between two altitudes."""
    if box[2] >= highest or box[5] <= lowest:
        return False
    dx = max(0.0, box[0] - x, x - box[3])
    dy = max(0.0, box[1] - y, y - box[4])
    close: bool = dx * dx + dy * dy < near * near
    return close


@leaf
def solids_near(o: ObstacleArrays, boxes: FloatArray, reach: float, near: npt.NDArray[np.int64]) -> int:
    """Write which solids may come within ``reach`` of boxes (B, 6), ascending, into ``near`` (2, O); return how many.

    The second row of ``near`` is scratch: all 0 before and after.
    """
    g = o.grid
    count = o.kind.shape[0]
    rows = g.start.shape[0]
    columns = g.start.shape[1] - 1
    if rows * columns == 1:
        for i in range(count):
            near[0, i] = i
        return len(o.kind)
    found: int = 0
    for n in range(g.large.shape[0]):
        near[1, g.large[n]] = 1
        near[0, found] = g.large[n]
        found += 1
    for b in range(boxes.shape[0]):
        west = grid_square(boxes[b, 0] - reach, g.west, g.cell_m, columns)
        south = grid_square(boxes[b, 1] - reach, g.south, g.cell_m, rows)
        east = grid_square(boxes[b, 3] + reach, g.west, g.cell_m, columns)
        north = grid_square(boxes[b, 4] + reach, g.south, g.cell_m, rows)
        for r in range(south, north + 1):
            for n in range(g.start[r, west], g.start[r, east + 1]):
                i = g.solid[n]
                if near[1, i] == 0:
                    near[1, i] = 1
                    near[0, found] = i
                    found += 1
    for n in range(found):
        near[1, near[0, n]] = 0
        i = near[0, n]
        k = n
        while k > 0 and near[0, k - 1] > i:
            near[0, k] = near[0, k - 1]
            k -= 1
        near[0, k] = i
    return found


@leaf
def _space_terms(
    path: FloatArray,
    space: SpaceArrays,
    q: PriceSettings,
    hop: FloatArray,
    blocks: FloatArray,
    solids: npt.NDArray[np.int64],
    out: FloatArray,
) -> None:
    """Depth within reach of solids, of fence and area, integrated; ``blocks`` (B, 6) and ``solids`` (2, O): scratch."""
    last = hop.shape[0]
    count = (last + BLOCK - 1) // BLOCK
    for b in range(count):  # a box around every few samples, and one around every few boxes: most solids are far off
        first = b * BLOCK
        group = count + b // BLOCK
        for axis in range(3):
            low = high = path[first, axis]
            for k in range(first + 1, min(first + BLOCK, last) + 1):
                low = min(low, path[k, axis])
                high = max(high, path[k, axis])
            blocks[b, axis] = low
            blocks[b, 3 + axis] = high
            starts = b % BLOCK == 0
            blocks[group, axis] = low if starts else min(low, blocks[group, axis])
            blocks[group, 3 + axis] = high if starts else max(high, blocks[group, 3 + axis])
    scale = max(1.0, q.obstacle_m) * q.route_length_m
    out[OBSTACLES] = 0.0
    out[COLLISION] = 0.0
    out[OCEAN] = 0.0
    out[RADAR_ZONE] = 0.0
    o = space.obstacles
    for n in range(solids_near(o, blocks[:count], max(0.0, q.obstacle_m) + _ROUNDING_M, solids)):
        i = solids[0, n]
        hard = o.hard[i]
        radius = o.bound[i, 2]
        reach = q.obstacle_m if hard else 0.0
        step = hiding_step(reach if hard else radius)
        x = o.bound[i, 0]
        y = o.bound[i, 1]
        near = radius + reach
        lowest = o.bound[i, 3] - reach
        highest = o.bound[i, 4] + reach
        depth = 0.0
        for group in range(count, blocks.shape[0]):
            if not _box_near(blocks[group], x, y, near, lowest, highest):
                continue
            block = (group - count) * BLOCK
            for b in range(block, min(block + BLOCK, count)):
                if _box_near(blocks[b], x, y, near, lowest, highest):
                    first = b * BLOCK
                    depth += _depth_integral(path, hop, first, min(first + BLOCK, last), space, i, reach, step)
        if depth > 0.0:
            if not hard:
                out[RADAR_ZONE] += depth / (radius * radius * q.route_length_m)
            elif o.kind[i] == CONE:
                out[COLLISION] += depth / scale
            elif o.kind[i] == MARINE:
                out[OCEAN] += depth / scale
            else:
                out[OBSTACLES] += depth / scale
    scale = max(1.0, q.fence_m) * q.route_length_m
    fence = o.kind.shape[0]
    depth = _depth_integral(path, hop, 0 * last, last, space, fence, q.fence_m, hiding_step(q.fence_m))
    out[FENCED] = depth / scale


@leaf
def _ball_depth(u: float, miss2: float, miss: float, radius: float) -> float:
    """Antiderivative over u of ``radius - sqrt(miss^2 + u^2)``."""
    return radius * u - 0.5 * (u * math.sqrt(miss2 + u * u) + (miss2 * math.asinh(u / miss) if miss > 0.0 else 0.0))


@leaf
def _passing_depth(rx: float, ry: float, rz: float, vx: float, vy: float, vz: float, radius: float) -> float:
    """Mean over s in [0, 1] of the depth ``max(0, radius - |r + s v|)``: exact, nobody slips between samples."""
    vv = vx * vx + vy * vy + vz * vz
    rr = rx * rx + ry * ry + rz * rz
    rv = rx * vx + ry * vy + rz * vz
    speed = math.sqrt(vv)
    if speed <= 1e-9 * (1.0 + radius):
        return max(0.0, radius - math.sqrt(rr))
    closest = -rv / vv
    s = min(1.0, max(0.0, closest))
    if rr + s * (2.0 * rv + s * vv) >= radius * radius:
        return 0.0
    miss2 = max(0.0, rr + closest * rv)
    miss = math.sqrt(miss2)
    half = math.sqrt(radius * radius - miss2)
    first = max(-half, -closest * speed)
    then = min(half, (1.0 - closest) * speed)
    return max(0.0, _ball_depth(then, miss2, miss, radius) - _ball_depth(first, miss2, miss, radius)) / speed


@kernel
def _fellow_boxes(fellows: FloatArray) -> FloatArray:
    """Boxes (B, F, 6) around every few instants of fellows (F, N, 3)."""
    last = fellows.shape[1] - 1
    boxes = np.empty(((max(last, 0) + BLOCK - 1) // BLOCK, fellows.shape[0], 6))
    for b in range(boxes.shape[0]):
        for f in range(boxes.shape[1]):
            for axis in range(3):
                low = high = fellows[f, b * BLOCK, axis]
                for n in range(b * BLOCK + 1, min(b * BLOCK + BLOCK, last) + 1):
                    low = min(low, fellows[f, n, axis])
                    high = max(high, fellows[f, n, axis])
                boxes[b, f, axis] = low
                boxes[b, f, 3 + axis] = high
    return boxes


@leaf
def _fellow_term(
    path: FloatArray,
    fellows: FloatArray,
    boxes: FloatArray,
    radius: float,
    hop: FloatArray,
    length: float,
    at: FloatArray,
    box: FloatArray,
    near: npt.NDArray[np.int64],
) -> float:
    """Mean depth within ``radius`` of fellows (F, N, 3), who are as far along their way as this path along its own.

    ``at`` (BLOCK + 1, 3), ``box`` (6,) and ``near`` (F,) are scratch.
    """
    instants = fellows.shape[1]
    if fellows.shape[0] == 0 or instants < 2 or radius <= 0.0:
        return 0.0
    total: float = 0.0
    k = 0
    passed = 0.0
    last = hop.shape[0] - 1
    for axis in range(3):
        at[BLOCK, axis] = path[0, axis]
    for b in range(boxes.shape[0]):
        first = b * BLOCK
        count = min(BLOCK, instants - 1 - first)
        for axis in range(3):
            at[0, axis] = at[BLOCK, axis]
        for n in range(1, count + 1):
            along = length * (first + n) / (instants - 1)
            while k < last and passed + hop[k] < along:
                passed += hop[k]
                k += 1
            s = min(1.0, (along - passed) / hop[k]) if hop[k] > 0.0 else 0.0
            for axis in range(3):
                at[n, axis] = path[k, axis] + s * (path[k + 1, axis] - path[k, axis])
        many = 0
        for axis in range(3):
            box[axis] = box[3 + axis] = at[0, axis]
            for n in range(1, count + 1):
                box[axis] = min(box[axis], at[n, axis])
                box[3 + axis] = max(box[3 + axis], at[n, axis])
        for f in range(fellows.shape[0]):  # most are far off all the while
            apart = 0.0
            for axis in range(3):
                gap = max(0.0, boxes[b, f, axis] - box[3 + axis], box[axis] - boxes[b, f, 3 + axis])
                apart += gap * gap
            if apart <= radius * radius * (1.0 + 1e-9):
                near[many] = f
                many += 1
        for n in range(1, count + 1):
            for m in range(many):
                f = near[m]
                rx = at[n - 1, 0] - fellows[f, first + n - 1, 0]
                ry = at[n - 1, 1] - fellows[f, first + n - 1, 1]
                rz = at[n - 1, 2] - fellows[f, first + n - 1, 2]
                vx = at[n, 0] - fellows[f, first + n, 0] - rx
                vy = at[n, 1] - fellows[f, first + n, 1] - ry
                vz = at[n, 2] - fellows[f, first + n, 2] - rz
                # |r| >= radius + |v|: too far off to come near
                if rx * rx + ry * ry + rz * rz < 2.0 * (radius * radius + vx * vx + vy * vy + vz * vz):
                    total += _passing_depth(rx, ry, rz, vx, vy, vz, radius)
    mean: float = total / ((instants - 1) * radius)
    return mean


@leaf
def _path_distance(path: FloatArray, hop: FloatArray, x: float, y: float, z: float) -> float:
    """Least distance from a point to a path."""
    least2 = _FAR_M * _FAR_M
    for k in range(0, path.shape[0], 8):
        dx = path[k, 0] - x
        dy = path[k, 1] - y
        dz = path[k, 2] - z
        least2 = min(least2, dx * dx + dy * dy + dz * dz)
    least = math.sqrt(least2)
    k = 0
    while k < hop.shape[0]:
        dx = path[k, 0] - x
        dy = path[k, 1] - y
        dz = path[k, 2] - z
        spare = math.sqrt(dx * dx + dy * dy + dz * dz) - least  # so far along the path nothing is nearer than `least`
        if spare < hop[k]:
            ex = path[k + 1, 0] - path[k, 0]
            ey = path[k + 1, 1] - path[k, 1]
            ez = path[k + 1, 2] - path[k, 2]
            ee = ex * ex + ey * ey + ez * ez
            s = min(1.0, max(0.0, -(dx * ex + dy * ey + dz * ez) / ee)) if ee > 0.0 else 0.0
            dx += s * ex
            dy += s * ey
            dz += s * ez
            least = min(least, math.sqrt(dx * dx + dy * dy + dz * dz))
            k += 1
        else:
            while k < hop.shape[0] and spare >= hop[k]:
                spare -= hop[k]
                k += 1
    return least


@leaf
def _inspection_term(
    path: FloatArray, tower_tops: FloatArray, tower_weights: FloatArray, tower_range_m: float, hop: FloatArray
) -> float:
    """Share of the towers' weight not collected; a tower passed too far off counts the more, the further."""
    missed = 0.0
    whole = 0.0
    for n in range(tower_tops.shape[0]):
        whole += tower_weights[n]
        if tower_weights[n] > 0.0:
            d = _path_distance(path, hop, tower_tops[n, 0], tower_tops[n, 1], tower_tops[n, 2])
            too_far = max(0.0, d - tower_range_m) / tower_range_m
            missed += tower_weights[n] * too_far / (1.0 + too_far)
    return missed / whole if whole > 0.0 else 0.0


@njit(cache=True, error_model="numpy", nogil=True)
def price_paths(
    paths: FloatArray,
    space: SpaceArrays,
    q: PriceSettings,
    tower_tops: FloatArray,
    tower_weights: FloatArray,
    fellows: FloatArray,
    out: FloatArray,
) -> None:
    """Write the price of paths (P, S, 3), term by term, to ``out`` (P, PRICE_COLUMNS); see :mod:`missionplanner.cost`.

    Releases the interpreter's lock, so that threads may share a population. That is not left to numba's own parallel
    loops: those compile for seconds longer, cannot take tuples of tuples, and forbid callers to use threads or fork.
    """
    hop = np.empty(paths.shape[1] - 1)
    boxes = (hop.shape[0] + BLOCK - 1) // BLOCK
    blocks = np.empty((boxes + (boxes + BLOCK - 1) // BLOCK, 6))
    solids = np.zeros((2, space.obstacles.kind.shape[0]), dtype=np.int64)
    fellow_boxes = _fellow_boxes(fellows)
    at = np.empty((BLOCK + 1, 3))
    box = np.empty(6)
    near = np.empty(fellows.shape[0], dtype=np.int64)
    for p in range(paths.shape[0]):
        path = paths[p]
        terms = out[p]
        _shape_terms(path, q, hop, terms)
        if not math.isfinite(terms[VOYAGE]):  # NaN or overflow: never the best, and no walk along it would end
            terms[:] = np.inf
            continue
        _height_terms(path, space.terrain, q, hop, terms)
        _space_terms(path, space, q, hop, blocks, solids, terms)
        length = terms[VOYAGE] * q.route_length_m
        terms[FELLOWS] = _fellow_term(path, fellows, fellow_boxes, q.separation_m, hop, length, at, box, near)
        terms[INSPECTION] = _inspection_term(path, tower_tops, tower_weights, q.tower_range_m, hop)
