"""Exact derivatives of the price: a mirror of the sums in :mod:`.kernels`, with the adjoint of every one of them.

One pass per path gives all 15 terms and the derivative of their weighted sum with respect to every sample (S, 3).
Whatever is linear in the samples (splines, handles) takes it from there: ``basis.T @ slope``.

The price has kinks: where a depth begins, where another solid, edge or piece becomes the nearest one, where a climb
becomes a descent, where two pieces lie exactly in line. There it is a subgradient, or the slope on one side. The price
also has small jumps, where a piece of path begins to be sampled more densely: those have no derivative.

For the augmented Lagrangian (Powell 1969; Rockafellar 1973) every depth ``x`` of a forbidden term may be replaced by
``max(0, x + shift)^2 / (2 scale)``: the multipliers are metres (radians) by which a margin is widened, one per kind and
sample. ``scale`` 0 is the price itself.
"""

from __future__ import annotations

import math

import numpy as np

from missionplanner import kernels
from missionplanner.compiled import njit
from missionplanner.kernels import FloatArray, ObstacleArrays, PriceSettings, SpaceArrays, TerrainArrays, kernel, leaf

# Rows of `shift`, `worst` and `scale`: kinds of limits with one multiplier per sample.
LOW, HIGH, SOLID, FENCE, STEEP, SHARP = range(6)
LIMIT_KINDS = 6

_FAR_M = 1e9
_ROUNDING_M = 1e-6


@leaf
def _hinge(x: float, shift: float, scale: float) -> tuple[float, float]:
    """Value and slope of what a depth ``x`` counts."""
    y = x + shift
    if y <= 0.0:
        return 0.0, 0.0
    if scale == 0.0:
        return y, 1.0
    return 0.5 * y * y / scale, y / scale


# --- where the ground is, and how it slopes --------------------------------------------------------------------------


@leaf
def _cell_slopes(t: TerrainArrays, x: float, y: float) -> tuple[float, float, float, float]:
    """How row and column change with x and y."""
    u = x * 1e-4
    v = y * 1e-4
    a = t.to_cell
    return (
        1e-4 * (a[0, 1] + u * (2.0 * a[0, 3] + 3.0 * u * a[0, 6] + 2.0 * v * a[0, 7]) + v * (a[0, 4] + v * a[0, 8])),
        1e-4 * (a[0, 2] + u * (a[0, 4] + u * a[0, 7]) + v * (2.0 * a[0, 5] + 2.0 * u * a[0, 8] + 3.0 * v * a[0, 9])),
        1e-4 * (a[1, 1] + u * (2.0 * a[1, 3] + 3.0 * u * a[1, 6] + 2.0 * v * a[1, 7]) + v * (a[1, 4] + v * a[1, 8])),
        1e-4 * (a[1, 2] + u * (a[1, 4] + u * a[1, 7]) + v * (2.0 * a[1, 5] + 2.0 * u * a[1, 8] + 3.0 * v * a[1, 9])),
    )


@leaf
def _keys_slopes(t: float) -> tuple[float, float, float, float]:
    """How the weights of cubic convolution change."""
    return (
        (2.0 - 1.5 * t) * t - 0.5,
        (4.5 * t - 5.0) * t,
        (4.0 - 4.5 * t) * t + 0.5,
        (1.5 * t - 1.0) * t,
    )


@leaf
def ground_slope(t: TerrainArrays, x: float, y: float) -> tuple[float, float, float]:
    """Return the ground's altitude AMSL and its derivatives eastward and northward; NaN where it is missing."""
    row, col = kernels.cell_position(t, x, y)
    h = t.height_amsl_m
    if not (1.0 <= row < h.shape[0] - 2 and 1.0 <= col < h.shape[1] - 2):
        return np.nan, np.nan, np.nan
    i = int(row)
    j = int(col)
    w0, w1, w2, w3 = kernels._keys(col - j)
    d0, d1, d2, d3 = _keys_slopes(col - j)
    r = kernels._keys(row - i)
    dr = _keys_slopes(row - i)
    height = by_row = by_col = 0.0
    for m in range(4):
        h0 = h[i - 1 + m, j - 1]
        h1 = h[i - 1 + m, j]
        h2 = h[i - 1 + m, j + 1]
        h3 = h[i - 1 + m, j + 2]
        along = w0 * h0 + w1 * h1 + w2 * h2 + w3 * h3
        height += r[m] * along
        by_row += dr[m] * along
        by_col += r[m] * (d0 * h0 + d1 * h1 + d2 * h2 + d3 * h3)
    row_x, row_y, col_x, col_y = _cell_slopes(t, x, y)
    return height, by_row * row_x + by_col * col_x, by_row * row_y + by_col * col_y


@leaf
def _heights(t: TerrainArrays, q: PriceSettings, widest: float, x: float, y: float, z: float, out: FloatArray) -> float:
    """Write how far a point is below and above the height band with their slopes (2, 4); return the slack of heights.

    Both may be negative: that far from the limit. Slopes are looked up where that is no more than ``widest``.
    """
    height = z - kernels.terrain_height(t, x, y)
    slope_x = slope_y = 0.0
    if height <= q.height_min_m + widest or height >= q.height_max_m - widest:
        _, slope_x, slope_y = ground_slope(t, x, y)
    out[1, 0] = z - q.alt_max_m
    out[1, 1] = 0.0
    out[1, 2] = 0.0
    out[1, 3] = 1.0
    if math.isnan(height):
        row, col = kernels.cell_position(t, x, y)
        rows, cols = t.height_amsl_m.shape
        rows_out = max(0.0, 1.0 - row, row - (rows - 2))
        cols_out = max(0.0, 1.0 - col, col - (cols - 2))
        off = math.sqrt(rows_out * rows_out + cols_out * cols_out)
        by_row = by_col = 0.0
        if off > 0.0:
            by_row = q.cell_m * rows_out / off * (-1.0 if row < 1.0 else 1.0)
            by_col = q.cell_m * cols_out / off * (-1.0 if col < 1.0 else 1.0)
        row_x, row_y, col_x, col_y = _cell_slopes(t, x, y)
        out[0, 0] = kernels._MISSING_TERRAIN_M + q.cell_m * off
        out[0, 1] = by_row * row_x + by_col * col_x
        out[0, 2] = by_row * row_y + by_col * col_y
        out[0, 3] = 0.0
        return -np.inf
    out[0, 0] = q.height_min_m - height
    out[0, 1] = slope_x
    out[0, 2] = slope_y
    out[0, 3] = -1.0
    if height - q.height_max_m > out[1, 0]:
        out[1, 0] = height - q.height_max_m
        out[1, 1] = -slope_x
        out[1, 2] = -slope_y
    return min(height - q.height_min_m, q.height_max_m - height)


# --- solids ----------------------------------------------------------------------------------------------------------


@leaf
def _polygon_slope(vertices: FloatArray, start: int, stop: int, x: float, y: float) -> tuple[float, float, float]:
    """Signed distance to a polygon (negative inside) and its slope."""
    least = np.inf
    inside = False
    near_x = near_y = edge_x = edge_y = 0.0
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
        if dx * dx + dy * dy < least:
            least = dx * dx + dy * dy
            near_x = dx
            near_y = dy
            edge_x = ex
            edge_y = ey
        if (py > y) != (qy > y) and (ex * wy - ey * wx > 0.0) == (ey > 0.0):
            inside = not inside
        px = qx
        py = qy
    d = math.sqrt(least)
    if d == 0.0:  # on the outline: across it, whichever way
        edge = math.sqrt(edge_x * edge_x + edge_y * edge_y)
        return 0.0, edge_y / edge, -edge_x / edge
    sign = -1.0 if inside else 1.0
    return sign * d, sign * near_x / d, sign * near_y / d


@leaf
def _extruded_slope(across: float, along: float) -> tuple[float, float, float]:
    """Signed distance to a prism from those to its outline and its slab, and the derivatives by both."""
    if across <= 0.0:
        if along > across or along > 0.0:
            return along, 0.0, 1.0
        return across, 1.0, 0.0
    if along > 0.0:
        d = math.sqrt(across * across + along * along)
        return d, across / d, along / d
    return across, 1.0, 0.0


@leaf
def _cone_slope(rho: float, up: float, radius: float, height: float) -> tuple[float, float, float]:
    """Signed distance to a cone standing on up = 0, at ``rho`` from its axis, and the derivatives by rho and up."""
    s = ((rho - radius) * -radius + up * height) / (radius * radius + height * height)
    s = min(1.0, max(0.0, s))
    dr = rho - radius * (1.0 - s)
    du = up - height * s
    slant = math.sqrt(dr * dr + du * du)
    if up > 0.0 and rho * height + up * radius < radius * height:
        if slant < up and slant > 0.0:
            return -slant, -dr / slant, -du / slant
        return -up, 0.0, -1.0
    over = max(0.0, rho - radius)
    base = math.sqrt(over * over + up * up)
    if slant <= base:
        side = math.sqrt(radius * radius + height * height)
        return (slant, dr / slant, du / slant) if slant > 0.0 else (0.0, height / side, radius / side)
    return (base, over / base, up / base) if base > 0.0 else (0.0, 0.0, -1.0)


@leaf
def obstacle_slope(o: ObstacleArrays, i: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the signed distance to solid ``i`` and its derivatives by x, y and z: of length 1 but at kinks."""
    p = o.params
    kind = o.kind[i]
    if kind == kernels.PRISM:
        across, ax, ay = _polygon_slope(o.vertices, o.vertex_start[i], o.vertex_start[i + 1], x, y)
        below = p[i, 0] - z
        above = z - p[i, 1]
        d, by_across, by_along = _extruded_slope(across, max(below, above))
        return d, by_across * ax, by_across * ay, by_along if above >= below else -by_along
    if kind == kernels.CURTAIN:
        along, aside, length = kernels.curtain_frame(p, i, x, y)
        off_along, off_up = kernels.off_curtain(along, z - p[i, 2], length, p[i, 5] - p[i, 2])
        away = math.sqrt(aside * aside + off_along * off_along + off_up * off_up)
        ux = (p[i, 3] - p[i, 0]) / length
        uy = (p[i, 4] - p[i, 1]) / length
        if away == 0.0:  # in its middle: to either side
            return -p[i, 6], uy, -ux, 0.0
        gx, gy = off_along * ux + aside * uy, off_along * uy - aside * ux
        return away - p[i, 6], gx / away, gy / away, off_up / away
    dx = x - p[i, 0]
    dy = y - p[i, 1]
    dz = z - p[i, 2]
    if kind == kernels.CABLE:
        ex = p[i, 3] - p[i, 0]
        ey = p[i, 4] - p[i, 1]
        ez = p[i, 5] - p[i, 2]
        ee = ex * ex + ey * ey + ez * ez
        s = (dx * ex + dy * ey + dz * ez) / ee if ee > 0.0 else 0.0
        s = min(1.0, max(0.0, s))
        dx -= s * ex
        dy -= s * ey
        dz -= s * ez
    if kind in (kernels.CYLINDER, kernels.CONE):
        rho = math.sqrt(dx * dx + dy * dy)
        if kind == kernels.CYLINDER:
            d, by_rho, by_up = _extruded_slope(rho - p[i, 2], z - p[i, 3])
        else:
            d, by_rho, by_up = _cone_slope(rho, z - p[i, 3], p[i, 2], p[i, 4])
        if rho == 0.0:  # on the axis: any way out
            return d, by_rho, 0.0, by_up
        return d, by_rho * dx / rho, by_rho * dy / rho, by_up
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    d = r - p[i, 6] if kind == kernels.CABLE else r - p[i, 3]
    if r == 0.0:
        return d, 0.0, 0.0, 1.0
    return d, dx / r, dy / r, dz / r


@leaf
def inside_slope(space: SpaceArrays, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return how far a point is inside area and fence, negative outside, and the derivatives."""
    area = space.area
    d, gx, gy, gz = x - area[0], 1.0, 0.0, 0.0
    if area[2] - x < d:
        d, gx = area[2] - x, -1.0
    if y - area[1] < d:
        d, gx, gy = y - area[1], 0.0, 1.0
    if area[3] - y < d:
        d, gx, gy = area[3] - y, 0.0, -1.0
    count = space.fence.shape[0]
    if count > 0:
        outside, ox, oy = _polygon_slope(space.fence, 0 * count, count, x, y)
        if -outside < d:
            d, gx, gy = -outside, -ox, -oy
        if space.fence_top_amsl_m - z < d:
            d, gx, gy, gz = space.fence_top_amsl_m - z, 0.0, 0.0, -1.0
    return d, gx, gy, gz


# --- terms -----------------------------------------------------------------------------------------------------------
# `g` (S, 3) gathers derivatives by samples, `by_hop` (S - 1,) those by the lengths between them.


@leaf
def _add(g: FloatArray, k: int, s: float, by: float, gx: float, gy: float, gz: float) -> None:
    """Share a derivative at a point of piece ``k``, at its share ``s``, out to the samples at its ends."""
    g[k, 0] += (1.0 - s) * by * gx
    g[k, 1] += (1.0 - s) * by * gy
    g[k, 2] += (1.0 - s) * by * gz
    if s > 0.0:
        g[k + 1, 0] += s * by * gx
        g[k + 1, 1] += s * by * gy
        g[k + 1, 2] += s * by * gz


@leaf
def _add_direction(g: FloatArray, k: int, unit: FloatArray, hop: FloatArray, bx: float, by: float, bz: float) -> None:
    """Add the derivative by the direction of piece ``k``, a unit vector."""
    along = bx * unit[k, 0] + by * unit[k, 1] + bz * unit[k, 2]
    for axis in range(3):
        b = bx if axis == 0 else by if axis == 1 else bz
        across = (b - along * unit[k, axis]) / hop[k]
        g[k + 1, axis] += across
        g[k, axis] -= across


@leaf
def _add_course(g: FloatArray, k: int, path: FloatArray, level: float, by_course: float, by_level: float) -> None:
    """Add the derivatives by the course of piece ``k`` and by its length on the map, ``level``."""
    if level > 0.0:
        dx = (path[k + 1, 0] - path[k, 0]) / level
        dy = (path[k + 1, 1] - path[k, 1]) / level
        gx = -by_course * dy / level + by_level * dx
        gy = by_course * dx / level + by_level * dy
        g[k + 1, 0] += gx
        g[k + 1, 1] += gy
        g[k, 0] -= gx
        g[k, 1] -= gy


@leaf
def _shape(
    path: FloatArray,
    q: PriceSettings,
    weights: FloatArray,
    scale: FloatArray,
    shift: FloatArray,
    worst: FloatArray,
    hop: FloatArray,
    unit: FloatArray,
    by_hop: FloatArray,
    g: FloatArray,
    out: FloatArray,
) -> None:
    """Length, bending, climbing and turning; ``hop`` and ``unit`` receive the pieces' lengths and directions."""
    length = bending = squared_altitude = gained = steep = turned = 0.0
    turn_is_limited = q.turn_radius_m > 0.0 or q.turn_angle_rad < math.pi
    whole = q.route_length_m
    per_bending = weights[kernels.SMOOTH] * kernels.BENDING_M * kernels.BENDING_M / whole
    per_square = weights[kernels.ATMOSPHERE] * 1e-6 / whole
    before = -1
    level_before = 0.0
    for k in range(hop.shape[0]):
        dx = path[k + 1, 0] - path[k, 0]
        dy = path[k + 1, 1] - path[k, 1]
        dz = path[k + 1, 2] - path[k, 2]
        level2 = dx * dx + dy * dy
        h = math.sqrt(level2 + dz * dz)
        level = math.sqrt(level2)
        hop[k] = h
        length += h
        square = 0.5 * (path[k, 2] * path[k, 2] + path[k + 1, 2] * path[k + 1, 2])
        squared_altitude += h * square
        by_hop[k] = weights[kernels.VOYAGE] / whole + per_square * square
        g[k, 2] += per_square * h * path[k, 2]
        g[k + 1, 2] += per_square * h * path[k + 1, 2]
        if dz > 0.0:
            gained += dz
            g[k + 1, 2] += weights[kernels.CLIMB] / whole
            g[k, 2] -= weights[kernels.CLIMB] / whole
        over = dz - q.climb_slope * level
        under = -dz - q.descent_slope * level
        climbs = over >= under
        worst[STEEP, k] = max(over, under)
        value, slope = _hinge(worst[STEEP, k], shift[STEEP, k], scale[STEEP])
        if value > 0.0:
            steep += value
            by = weights[kernels.CLIMB_ANGLE] * slope / whole
            g[k + 1, 2] += by if climbs else -by
            g[k, 2] -= by if climbs else -by
            _add_course(g, k, path, level, 0.0, -by * (q.climb_slope if climbs else q.descent_slope))
        if h == 0.0:
            continue
        unit[k, 0] = dx / h
        unit[k, 1] = dy / h
        unit[k, 2] = dz / h
        if before >= 0:
            mean = 0.5 * (hop[before] + h)
            bx = unit[k, 0] - unit[before, 0]
            by_ = unit[k, 1] - unit[before, 1]
            bz = unit[k, 2] - unit[before, 2]
            bend = (bx * bx + by_ * by_ + bz * bz) / mean
            bending += bend
            by_hop[k] -= 0.5 * per_bending * bend / mean
            by_hop[before] -= 0.5 * per_bending * bend / mean
            twice = 2.0 * per_bending / mean
            _add_direction(g, k, unit, hop, twice * bx, twice * by_, twice * bz)
            _add_direction(g, before, unit, hop, -twice * bx, -twice * by_, -twice * bz)
            if turn_is_limited:
                cross = unit[before, 0] * unit[k, 1] - unit[before, 1] * unit[k, 0]
                turn = math.atan2(abs(cross), unit[before, 0] * unit[k, 0] + unit[before, 1] * unit[k, 1])
                allowed = q.turn_angle_rad
                by_radius = False
                if q.turn_radius_m > 0.0:
                    on_arc = 0.5 * (level_before + level) / q.turn_radius_m
                    by_radius = on_arc < allowed
                    allowed = min(allowed, on_arc)
                worst[SHARP, k] = turn - allowed
                value, slope = _hinge(turn - allowed, shift[SHARP, k], scale[SHARP])
                if value > 0.0:
                    turned += value
                    by = weights[kernels.TURN] * slope / math.pi
                    left = by if cross >= 0.0 else -by
                    by_level = -0.5 * by / q.turn_radius_m if by_radius else 0.0
                    _add_course(g, k, path, level, left, by_level)
                    _add_course(g, before, path, level_before, -left, by_level)
        before = k
        level_before = level
    out[kernels.VOYAGE] = length / whole
    out[kernels.SMOOTH] = bending * kernels.BENDING_M * kernels.BENDING_M / whole
    out[kernels.ATMOSPHERE] = squared_altitude * 1e-6 / whole
    out[kernels.CLIMB] = gained / whole
    out[kernels.CLIMB_ANGLE] = steep / whole
    out[kernels.TURN] = turned / math.pi


@kernel
def _height_terms(
    path: FloatArray,
    t: TerrainArrays,
    q: PriceSettings,
    weights: FloatArray,
    scale: FloatArray,
    shift: FloatArray,
    worst: FloatArray,
    hop: FloatArray,
    by_hop: FloatArray,
    g: FloatArray,
    out: FloatArray,
) -> None:
    """Height band, integrated over the same pieces as the price's."""
    total = np.zeros(2)
    here, ahead, between = np.empty((2, 4)), np.empty((2, 4)), np.empty((2, 4))
    norm = 1.0 / (max(1.0, q.height_min_m) * q.route_length_m)
    widest = max(shift[LOW].max(), shift[HIGH].max())
    slack = _heights(t, q, widest, path[0, 0], path[0, 1], path[0, 2], here)
    for k in range(hop.shape[0]):
        next_slack = _heights(t, q, widest, path[k + 1, 0], path[k + 1, 1], path[k + 1, 2], ahead)
        pieces = 1
        if slack + next_slack < 2.0 * hop[k]:
            pieces = max(1, math.ceil(2.0 * hop[k] / q.cell_m))
        piece = hop[k] / pieces
        for j in range(pieces + 1):
            s = j / pieces
            if 0 < j < pieces:
                _heights(
                    t,
                    q,
                    widest,
                    path[k, 0] + s * (path[k + 1, 0] - path[k, 0]),
                    path[k, 1] + s * (path[k + 1, 1] - path[k, 1]),
                    path[k, 2] + s * (path[k + 1, 2] - path[k, 2]),
                    between,
                )
            found = here if j == 0 else ahead if j == pieces else between
            share = 1.0 if 0 < j < pieces else 0.5
            for limit in range(2):  # LOW, HIGH
                x = found[limit, 0]
                worst[limit, k] = max(worst[limit, k], x)
                value, slope = _hinge(x, shift[limit, k], scale[limit])
                if value > 0.0:
                    weight = norm * weights[kernels.TERRAIN + limit]
                    total[limit] += share * piece * value
                    by_hop[k] += weight * share * value / pieces
                    by = weight * share * piece * slope
                    _add(g, k, s, by, found[limit, 1], found[limit, 2], found[limit, 3])
        slack = next_slack
        here, ahead = ahead, here
    out[kernels.TERRAIN] = total[0] * norm
    out[kernels.CEILING] = total[1] * norm


@leaf
def _depth(
    path: FloatArray,
    hop: FloatArray,
    first: int,
    last: int,
    space: SpaceArrays,
    i: int,
    reach: float,
    step: float,
    weight: float,
    scale: float,
    shift: FloatArray,
    widest: float,
    worst: FloatArray,
    by_hop: FloatArray,
    g: FloatArray,
) -> float:
    """Integral of the depth within ``reach`` of solid ``i`` (O: the fence), as the price has it, and its derivatives.

    ``widest`` is the greatest shift: nothing counts that is further off.
    """
    o = space.obstacles
    solid = i < o.kind.shape[0]
    squared = solid and not o.hard[i]
    total = 0.0
    skip = 0.0
    for k in range(first, last + 1):
        ahead = hop[k] if k < last else 0.0
        if skip > 0.0 and skip >= ahead:
            skip -= ahead
            continue
        if solid and k < last and kernels.beside_line(o, i, reach + widest, path[k], path[k + 1]):
            skip = 0.0
            continue
        pieces = max(1, math.ceil(ahead / step))
        piece = ahead / pieces
        j = int(skip / piece) if skip > 0.0 else 0
        pieces_before = 1
        before = 0.0
        if j == 0 and k > first:
            pieces_before = max(1, math.ceil(hop[k - 1] / step))
            before = hop[k - 1] / pieces_before
        ex = path[k + 1, 0] - path[k, 0] if k < last else 0.0
        ey = path[k + 1, 1] - path[k, 1] if k < last else 0.0
        ez = path[k + 1, 2] - path[k, 2] if k < last else 0.0
        skip = 0.0
        while j < pieces:
            s = j / pieces
            x = path[k, 0] + s * ex
            y = path[k, 1] + s * ey
            z = path[k, 2] + s * ez
            free = kernels._slack(space, i, reach + widest, step, x, y, z)
            skip = max(0.0, free - (pieces - j) * piece)
            if free <= 0.0:
                if solid:
                    d, gx, gy, gz = obstacle_slope(o, i, x, y, z)
                else:
                    d, gx, gy, gz = inside_slope(space, x, y, z)
                depth = reach - d
                inner = j > 0
                wide = piece if inner else 0.5 * (before + piece)
                value = slope = 0.0
                if squared:
                    value, slope = depth * depth, 2.0 * depth
                else:
                    worst[k] = max(worst[k], depth)
                    value, slope = _hinge(depth, shift[k], scale)
                if value > 0.0:
                    total += wide * value
                    if k < last:
                        by_hop[k] += weight * value * (1.0 if inner else 0.5) / pieces
                    if not inner and k > first:
                        by_hop[k - 1] += weight * value * 0.5 / pieces_before
                    _add(g, k, s, -weight * wide * slope, gx, gy, gz)
                j += 1
            elif free < ahead:
                j += 1 + int(free / piece)
            else:
                j = pieces
    return total


@kernel
def _space_terms(
    path: FloatArray,
    space: SpaceArrays,
    q: PriceSettings,
    weights: FloatArray,
    scale: FloatArray,
    shift: FloatArray,
    worst: FloatArray,
    hop: FloatArray,
    by_hop: FloatArray,
    g: FloatArray,
    out: FloatArray,
) -> None:
    """Depth within reach of solids, of fence and area, integrated over the same pieces as the price's."""
    last = hop.shape[0]
    out[kernels.OBSTACLES] = 0.0
    out[kernels.COLLISION] = 0.0
    out[kernels.OCEAN] = 0.0
    out[kernels.RADAR_ZONE] = 0.0
    count = (last + kernels.BLOCK - 1) // kernels.BLOCK
    boxes = np.empty((count + 1, 6))
    boxes[count, :3] = np.inf
    boxes[count, 3:] = -np.inf
    for b in range(count):  # a box around every few samples, and one around all: most solids are far off
        for axis in range(3):
            low = high = path[b * kernels.BLOCK, axis]
            for k in range(b * kernels.BLOCK + 1, min((b + 1) * kernels.BLOCK, last) + 1):
                low = min(low, path[k, axis])
                high = max(high, path[k, axis])
            boxes[b, axis] = low
            boxes[b, 3 + axis] = high
            boxes[count, axis] = min(boxes[count, axis], low)
            boxes[count, 3 + axis] = max(boxes[count, 3 + axis], high)
    o = space.obstacles
    norm = 1.0 / (max(1.0, q.obstacle_m) * q.route_length_m)
    widest = shift[SOLID].max()
    solids = np.zeros((2, o.kind.shape[0]), dtype=np.int64)
    for n in range(kernels.solids_near(o, boxes[:count], max(0.0, q.obstacle_m) + widest + _ROUNDING_M, solids)):
        i = solids[0, n]
        hard = o.hard[i]
        radius = o.bound[i, 2]
        reach = q.obstacle_m if hard else 0.0
        room = widest if hard else 0.0
        near = radius + reach + room
        lowest = o.bound[i, 3] - reach - room
        highest = o.bound[i, 4] + reach + room
        bx = o.bound[i, 0]
        by = o.bound[i, 1]
        if not kernels._box_near(boxes[count], bx, by, near, lowest, highest):
            continue
        column = kernels.OBSTACLES
        unit = norm
        if not hard:
            column = kernels.RADAR_ZONE
            unit = 1.0 / (radius * radius * q.route_length_m)
        elif o.kind[i] == kernels.CONE:
            column = kernels.COLLISION
        elif o.kind[i] == kernels.MARINE:
            column = kernels.OCEAN
        step = kernels.hiding_step(reach if hard else radius)
        total = 0.0
        for b in range(count):
            if not kernels._box_near(boxes[b], bx, by, near, lowest, highest):
                continue
            first = b * kernels.BLOCK
            end = min(first + kernels.BLOCK, last)
            total += _depth(
                path, hop, first, end, space, i, reach, step, weights[column] * unit,
                scale[SOLID], shift[SOLID], room, worst[SOLID], by_hop, g,
            )  # fmt: skip
        out[column] += total * unit
    norm = 1.0 / (max(1.0, q.fence_m) * q.route_length_m)
    fence = o.kind.shape[0]
    step = kernels.hiding_step(q.fence_m)
    total = _depth(
        path, hop, 0 * last, last, space, fence, q.fence_m, step, weights[kernels.FENCED] * norm,
        scale[FENCE], shift[FENCE], shift[FENCE].max(), worst[FENCE], by_hop, g,
    )  # fmt: skip
    out[kernels.FENCED] = total * norm


@kernel
def _passing(r: FloatArray, v: FloatArray, radius: float, by_r: FloatArray, by_v: FloatArray) -> float:
    """Mean over s in [0, 1] of the depth ``max(0, radius - |r + s v|)`` and its derivatives, in closed form."""
    by_r[:] = 0.0
    by_v[:] = 0.0
    vv = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    rr = r[0] * r[0] + r[1] * r[1] + r[2] * r[2]
    rv = r[0] * v[0] + r[1] * v[1] + r[2] * v[2]
    speed = math.sqrt(vv)
    if speed <= 1e-9 * (1.0 + radius):
        away = math.sqrt(rr)
        if away < radius and away > 0.0:
            for axis in range(3):
                by_r[axis] = -r[axis] / away
                by_v[axis] = -0.5 * r[axis] / away
        return max(0.0, radius - away)
    closest = -rv / vv
    s = min(1.0, max(0.0, closest))
    if rr + s * (2.0 * rv + s * vv) >= radius * radius:
        return 0.0
    miss2 = max(0.0, rr + closest * rv)
    miss = math.sqrt(miss2)
    half = math.sqrt(radius * radius - miss2)
    a = max(-half, -closest * speed)
    b = min(half, (1.0 - closest) * speed)
    if b <= a:
        return 0.0
    root_a = math.sqrt(miss2 + a * a)
    root_b = math.sqrt(miss2 + b * b)
    # integrals of 1, u and u^2 over the distance
    zeroth = math.asinh(b / miss) - math.asinh(a / miss) if miss > 0.0 else 0.0
    first = root_b - root_a
    second = 0.5 * (b * root_b - a * root_a - miss2 * zeroth)
    for axis in range(3):
        e = v[axis] / speed
        m = r[axis] + closest * v[axis]
        by_r[axis] = -(m * zeroth + e * first) / speed
        by_v[axis] = -(m * (first / speed + closest * zeroth) + e * (second / speed + closest * first)) / speed
    distances = 0.5 * (b * root_b - a * root_a + miss2 * zeroth)
    depth: float = (radius * (b - a) - distances) / speed
    return depth


@kernel
def _fellow_term(
    path: FloatArray, fellows: FloatArray, radius: float, hop: FloatArray, length: float, weight: float,
    by_hop: FloatArray, g: FloatArray,
) -> float:  # fmt: skip
    """Mean depth within ``radius`` of fellows (F, N, 3), who are as far along their way as this path along its own."""
    instants = fellows.shape[1]
    if fellows.shape[0] == 0 or instants < 2 or radius <= 0.0:
        return 0.0
    norm = 1.0 / ((instants - 1) * radius)
    by = weight * norm
    total: float = 0.0
    by_length = 0.0
    passed_before = np.zeros(hop.shape[0])  # derivatives by the length before each piece
    r, v, by_r, by_v = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    at = np.empty(3)
    by_at = np.zeros(3)
    by_ahead = np.empty(3)
    for axis in range(3):
        at[axis] = path[0, axis]
    ahead = at.copy()
    k = k_at = 0
    s = s_at = 0.0
    share_at = 0.0
    passed = 0.0
    last = hop.shape[0] - 1
    for n in range(1, instants + 1):
        share = n / (instants - 1)
        by_ahead[:] = 0.0
        if n < instants:
            along = length * n / (instants - 1)
            while k < last and passed + hop[k] < along:
                passed += hop[k]
                k += 1
            s = min(1.0, (along - passed) / hop[k]) if hop[k] > 0.0 else 0.0
            for axis in range(3):
                ahead[axis] = path[k, axis] + s * (path[k + 1, axis] - path[k, axis])
            for f in range(fellows.shape[0]):
                vv = rr = 0.0
                for axis in range(3):
                    r[axis] = at[axis] - fellows[f, n - 1, axis]
                    v[axis] = ahead[axis] - fellows[f, n, axis] - r[axis]
                    rr += r[axis] * r[axis]
                    vv += v[axis] * v[axis]
                if rr < 2.0 * (radius * radius + vv):
                    total += _passing(r, v, radius, by_r, by_v)
                    for axis in range(3):
                        by_at[axis] += by_r[axis] - by_v[axis]
                        by_ahead[axis] += by_v[axis]
        # what is known of the point behind by now goes to the samples around it, and to the lengths that place it
        _add(g, k_at, s_at, by, by_at[0], by_at[1], by_at[2])
        if hop[k_at] > 0.0 and 0.0 < s_at < 1.0:
            by_s = 0.0
            for axis in range(3):
                by_s += by * by_at[axis] * (path[k_at + 1, axis] - path[k_at, axis])
            by_hop[k_at] -= by_s * s_at / hop[k_at]
            passed_before[k_at] -= by_s / hop[k_at]
            by_length += by_s * share_at / hop[k_at]
        for axis in range(3):
            at[axis] = ahead[axis]
            by_at[axis] = by_ahead[axis]
        k_at = k
        s_at = s
        share_at = share
    later = 0.0
    for n in range(hop.shape[0] - 1, -1, -1):
        by_hop[n] += by_length + later
        later += passed_before[n]
    mean: float = total * norm
    return mean


@kernel
def _inspection_term(
    path: FloatArray, tower_tops: FloatArray, tower_weights: FloatArray, range_m: float, weight: float, g: FloatArray
) -> float:
    """Share of the towers' weight not collected, and its derivatives at the nearest points of the path."""
    missed: float = 0.0
    whole: float = tower_weights.sum()
    if whole <= 0.0:
        return 0.0
    for n in range(tower_tops.shape[0]):
        if tower_weights[n] <= 0.0:
            continue
        least2 = _FAR_M * _FAR_M
        at = 0
        at_s = 0.0
        for k in range(path.shape[0] - 1):
            dx = path[k, 0] - tower_tops[n, 0]
            dy = path[k, 1] - tower_tops[n, 1]
            dz = path[k, 2] - tower_tops[n, 2]
            ex = path[k + 1, 0] - path[k, 0]
            ey = path[k + 1, 1] - path[k, 1]
            ez = path[k + 1, 2] - path[k, 2]
            ee = ex * ex + ey * ey + ez * ez
            s = min(1.0, max(0.0, -(dx * ex + dy * ey + dz * ez) / ee)) if ee > 0.0 else 0.0
            dx += s * ex
            dy += s * ey
            dz += s * ez
            if dx * dx + dy * dy + dz * dz < least2:
                least2 = dx * dx + dy * dy + dz * dz
                at = k
                at_s = s
        least = math.sqrt(least2)
        too_far = max(0.0, least - range_m) / range_m
        missed += tower_weights[n] * too_far / (1.0 + too_far)
        if too_far > 0.0:
            by = weight * tower_weights[n] / (whole * range_m * (1.0 + too_far) ** 2 * least)
            x = path[at, 0] + at_s * (path[at + 1, 0] - path[at, 0]) - tower_tops[n, 0]
            y = path[at, 1] + at_s * (path[at + 1, 1] - path[at, 1]) - tower_tops[n, 1]
            z = path[at, 2] + at_s * (path[at + 1, 2] - path[at, 2]) - tower_tops[n, 2]
            _add(g, at, at_s, by, x, y, z)
    share: float = missed / whole
    return share


@kernel
def price_slope(
    path: FloatArray,
    space: SpaceArrays,
    q: PriceSettings,
    tower_tops: FloatArray,
    tower_weights: FloatArray,
    fellows: FloatArray,
    weights: FloatArray,
    scale: FloatArray,
    shift: FloatArray,
    worst: FloatArray,
    out: FloatArray,
    g: FloatArray,
) -> float:
    """Write one path's terms and the derivatives ``g`` (S, 3) of their weighted sum; return the sum.

    Parameters
    ----------
    path : (S, 3), finite.
    weights : (PRICE_COLUMNS,)
    scale : (LIMIT_KINDS,) 0: depths count as in the price; else as in the augmented Lagrangian.
    shift : (LIMIT_KINDS, S) its multipliers; 0 where ``scale`` is.
    worst : (LIMIT_KINDS, S) receives the greatest depths (negative: clear by so much; -inf: by much).
    out : (PRICE_COLUMNS,) receives the terms.
    """
    hop = np.empty(path.shape[0] - 1)
    unit = np.empty((path.shape[0] - 1, 3))
    by_hop = np.empty(path.shape[0] - 1)
    g[:] = 0.0
    worst[:] = -np.inf
    _shape(path, q, weights, scale, shift, worst, hop, unit, by_hop, g, out)
    _height_terms(path, space.terrain, q, weights, scale, shift, worst, hop, by_hop, g, out)
    _space_terms(path, space, q, weights, scale, shift, worst, hop, by_hop, g, out)
    length = out[kernels.VOYAGE] * q.route_length_m
    weight = weights[kernels.FELLOWS]
    out[kernels.FELLOWS] = _fellow_term(path, fellows, q.separation_m, hop, length, weight, by_hop, g)
    weight = weights[kernels.INSPECTION]
    out[kernels.INSPECTION] = _inspection_term(path, tower_tops, tower_weights, q.tower_range_m, weight, g)
    for k in range(hop.shape[0]):
        if hop[k] > 0.0:
            for axis in range(3):
                g[k + 1, axis] += by_hop[k] * unit[k, axis]
                g[k, axis] -= by_hop[k] * unit[k, axis]
    total: float = 0.0
    for column in range(kernels.PRICE_COLUMNS):
        if weights[column] != 0.0:
            total += weights[column] * out[column]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def price_slopes(
    paths: FloatArray,
    space: SpaceArrays,
    q: PriceSettings,
    tower_tops: FloatArray,
    tower_weights: FloatArray,
    fellows: FloatArray,
    weights: FloatArray,
    out: FloatArray,
    slopes: FloatArray,
) -> None:
    """Write the terms (P, PRICE_COLUMNS) of finite paths (P, S, 3) and the derivatives (P, S, 3) of their sums."""
    exact = np.zeros(LIMIT_KINDS)
    none = np.zeros((LIMIT_KINDS, paths.shape[1]))
    worst = np.empty((LIMIT_KINDS, paths.shape[1]))
    for p in range(paths.shape[0]):
        price_slope(
            paths[p], space, q, tower_tops, tower_weights, fellows, weights, exact, none, worst, out[p], slopes[p]
        )
