"""How low a tube passes above the ground: proven bounds for the continuous surface, not samples of it.

The ground is the bicubic surface of :mod:`.kernels`. Each of its patches is a Bezier patch, so it lies between the
least and the greatest of its sixteen control heights, and its slopes between those of their differences; cutting a
patch down to the piece in question makes these bounds as tight as wanted. Over large regions a pyramid of block bounds
decides at once, its overshoot included. Missing terrain is bounded by infinity: nothing is proven above it.

A tube is all within ``radius_m`` of a segment or triangle. Its least height above ground is the least of z - ground
over all its points, also to the sides and not only straight below the line.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner import kernels
from missionplanner.kernels import FloatArray, TerrainArrays, cell_position, kernel

TOLERANCE_M = 0.1
"""How close bounds are brought to a height that really occurs, where the terrain allows it."""

_BLOCK = 8  # cells per side of the pyramid's smallest blocks
_OVERSHOOT = 0.28125
"""A bicubic convolution exceeds the greatest of its samples by at most this share of their range (2 * 9/8 * 1/8)."""
_PATCHES = 2  # cells per side, beyond the radius, up to which patches themselves are looked at, not blocks
_FINEST_M = 2.0  # pieces of this size are not divided further
_STACK = 256
_ROUNDING_M = 1e-6
_TURN = 1.01
"""Room for how much the grid's scale changes within a piece of at most a few cells (far below 1 %)."""


class Pyramid(NamedTuple):
    """Bounds of the surface over blocks of 8 x 8 cells, then over ever larger ones; each level is a slice."""

    low_m: npt.NDArray[np.float32]
    high_m: npt.NDArray[np.float32]
    start: npt.NDArray[np.int64]  # (L + 1,)
    columns: npt.NDArray[np.int64]  # (L,)
    rows: npt.NDArray[np.int64]  # (L,)
    bend: FloatArray  # (2,): bound on the second derivatives of row and column, cells per square metre


def pyramid(terrain: TerrainArrays, reach_m: float) -> Pyramid:
    """Return the pyramid of a terrain; ``reach_m`` is how far from the origin it is asked about at most."""
    rows, columns = (max(1, -(-count // _BLOCK)) for count in terrain.height_amsl_m.shape)
    low, high = np.empty((rows, columns), dtype=np.float32), np.empty((rows, columns), dtype=np.float32)
    _write_blocks(terrain.height_amsl_m, low, high)
    levels = [(low, high)]
    while max(levels[-1][0].shape) > 1:
        levels.append((_halved(levels[-1][0], np.minimum), _halved(levels[-1][1], np.maximum)))
    # second derivatives of the way from the local frame to rows and columns, u = x / 1e4
    a = np.abs(terrain.to_cell)
    second = 2.0 * (a[:, 3] + a[:, 4] + a[:, 5])
    third = 12.0 * 1e-4 * reach_m * a[:, 6:10].sum(axis=1)
    return Pyramid(
        low_m=np.concatenate([low.ravel() for low, _ in levels]),
        high_m=np.concatenate([high.ravel() for _, high in levels]),
        start=np.cumsum([0, *(low.size for low, _ in levels)]),
        columns=np.array([low.shape[1] for low, _ in levels]),
        rows=np.array([low.shape[0] for low, _ in levels]),
        bend=(second + third) * 1e-8,
    )


def _halved(values: npt.NDArray[np.float32], extreme: np.ufunc) -> npt.NDArray[np.float32]:
    for axis in (0, 1):
        values = extreme.reduceat(values, np.arange(0, values.shape[axis], 2), axis=axis)
    return values


@kernel
def _write_blocks(h: npt.NDArray[np.float32], low_m: npt.NDArray[np.float32], high_m: npt.NDArray[np.float32]) -> None:
    """Write bounds of the surface over blocks of cells, from all samples that their patches are made of."""
    for i in range(low_m.shape[0]):
        for j in range(low_m.shape[1]):
            low = np.inf
            high = -np.inf
            known = True
            for row in range(max(0, i * _BLOCK - 1), min(h.shape[0], i * _BLOCK + _BLOCK + 2)):
                for column in range(max(0, j * _BLOCK - 1), min(h.shape[1], j * _BLOCK + _BLOCK + 2)):
                    value = float(h[row, column])
                    known = known and not math.isnan(value)
                    low = min(low, value)
                    high = max(high, value)
            over = _OVERSHOOT * (high - low) + 1e-3  # and room for single precision
            low_m[i, j] = low - over if known else -np.inf
            high_m[i, j] = high + over if known else np.inf


@kernel
def _block_bounds(p: Pyramid, r0: float, r1: float, c0: float, c1: float) -> tuple[float, float]:
    """Return bounds of the surface over a rectangle of cells, from the finest level of which few blocks are needed."""
    level = 0
    size = _BLOCK
    while level + 1 < p.rows.shape[0] and max(r1 - r0, c1 - c0) > 2.0 * size:
        level += 1
        size *= 2
    low = np.inf
    high = -np.inf
    for i in range(max(0, int(r0) // size), min(p.rows[level] - 1, int(r1) // size) + 1):
        for j in range(max(0, int(c0) // size), min(p.columns[level] - 1, int(c1) // size) + 1):
            k = p.start[level] + i * p.columns[level] + j
            low = min(low, p.low_m[k])
            high = max(high, p.high_m[k])
    return low, high


@kernel
def _to_bezier(v: FloatArray) -> None:
    """Turn four samples into the control values of the cubic between the middle two (Keys 1981, a = -1/2)."""
    before = v[0]
    after = v[3]
    v[0] = v[1]
    v[3] = v[2]
    v[1] = v[0] + (v[3] - before) / 6.0
    v[2] = v[3] - (after - v[0]) / 6.0


@kernel
def _cut(v: FloatArray, a: float, b: float) -> None:
    """Cut a cubic's control values down to the piece from a to b of [0, 1] (its blossom)."""
    p0, p1, p2, p3 = v[0], v[1], v[2], v[3]
    for k in range(4):
        s = b if k > 2 else a
        t = b if k > 1 else a
        u = b if k > 0 else a
        q0, q1, q2 = p0 + s * (p1 - p0), p1 + s * (p2 - p1), p2 + s * (p3 - p2)
        q0, q1 = q0 + t * (q1 - q0), q1 + t * (q2 - q1)
        v[k] = q0 + u * (q1 - q0)


@kernel
def _patch_bounds(
    h: npt.NDArray[np.float32], r0: float, r1: float, c0: float, c1: float, net: FloatArray, out: FloatArray
) -> None:
    """Write bounds over a rectangle to ``out``: of the surface, of its slope per row, and per column (low, high each).

    ``net`` (4, 4) is scratch. All rows and columns must lie within the grid's surface.
    """
    out[0], out[2], out[4] = np.inf, np.inf, np.inf
    out[1], out[3], out[5] = -np.inf, -np.inf, -np.inf
    for i in range(int(r0), int(r1) + 1):
        a, b = max(0.0, r0 - i), min(1.0, r1 - i)
        for j in range(int(c0), int(c1) + 1):
            e, f = max(0.0, c0 - j), min(1.0, c1 - j)
            if i + 2 >= h.shape[0] or j + 2 >= h.shape[1]:
                continue  # the far edge itself, of the cell before
            for k in range(4):
                for m in range(4):
                    net[k, m] = h[i - 1 + k, j - 1 + m]
                _to_bezier(net[k])
                _cut(net[k], e, f)
            for m in range(4):
                _to_bezier(net[:, m])
                _cut(net[:, m], a, b)
            per_row = 3.0 / (b - a) if b > a else 0.0
            per_column = 3.0 / (f - e) if f > e else 0.0
            for k in range(4):
                for m in range(4):
                    value = net[k, m]
                    if math.isnan(value):
                        out[0], out[2], out[4] = -np.inf, -np.inf, -np.inf
                        out[1], out[3], out[5] = np.inf, np.inf, np.inf
                        return
                    out[0] = min(out[0], value)
                    out[1] = max(out[1], value)
                    if k < 3:
                        slope = per_row * (net[k + 1, m] - value)
                        out[2] = min(out[2], slope)
                        out[3] = max(out[3], slope)
                    if m < 3:
                        slope = per_column * (net[k, m + 1] - value)
                        out[4] = min(out[4], slope)
                        out[5] = max(out[5], slope)


@kernel
def _jacobian(t: TerrainArrays, x: float, y: float, j: FloatArray) -> None:
    """Write the derivatives of row and column by x and y (2, 2) at a place."""
    u = x * 1e-4
    v = y * 1e-4
    a = t.to_cell
    for k in range(2):
        du = a[k, 1] + u * (2.0 * a[k, 3] + 3.0 * u * a[k, 6] + 2.0 * v * a[k, 7]) + v * (a[k, 4] + v * a[k, 8])
        dv = a[k, 2] + v * (2.0 * a[k, 5] + 3.0 * v * a[k, 9] + 2.0 * u * a[k, 8]) + u * (a[k, 4] + u * a[k, 7])
        j[k, 0] = du * 1e-4
        j[k, 1] = dv * 1e-4


@kernel
def _low_point(
    t: TerrainArrays, j: FloatArray, x: float, y: float, z: float, radius: float, sign: float, at: FloatArray
) -> float:
    """Return the height at a point of the ball around a place, near the ball's lowest; write where it is."""
    h = kernels.terrain_height(t, x, y)
    if math.isnan(h):
        at[0], at[1], at[2] = x, y, z
        return -np.inf
    e = 1.0
    gx = 0.5 * (kernels.terrain_height(t, x + e, y) - kernels.terrain_height(t, x - e, y))
    gy = 0.5 * (kernels.terrain_height(t, x, y + e) - kernels.terrain_height(t, x, y - e))
    steep = math.sqrt(gx * gx + gy * gy)
    if not steep > 1e-9:
        at[0], at[1], at[2] = x, y, z - sign * radius
        return sign * (z - h) - radius
    down = radius / math.sqrt(1.0 + steep * steep)
    across = sign * down  # uphill for the least height, downhill for the greatest
    at[0] = x + across * gx
    at[1] = y + across * gy
    at[2] = z - sign * down
    height: float = sign * (at[2] - kernels.terrain_height(t, at[0], at[1]))
    return -np.inf if math.isnan(height) else height


@kernel
def _fine_bound(
    t: TerrainArrays,
    piece: FloatArray,
    cells: FloatArray,
    window: FloatArray,
    jacobian: FloatArray,
    radius: float,
    sign: float,
    lowest: float,
    net: FloatArray,
    bounds: FloatArray,
) -> float:
    """Return a lower bound of the height over a small triangle's tube from the patches it lies over.

    ``cells`` (3, 2) are its corners in rows and columns, ``window`` their rectangle, how far the radius reaches beyond
    it, and how far the triangle may bulge; ``net`` and ``bounds`` are scratch.
    """
    h = t.height_amsl_m
    r0, r1, c0, c1 = window[0], window[1], window[2], window[3]
    _patch_bounds(h, r0 - window[4], r1 + window[4], c0 - window[5], c1 + window[5], net, bounds)
    if not math.isfinite(bounds[1]):
        return -np.inf
    bound: float = lowest - radius - (bounds[1] if sign > 0.0 else -bounds[0])
    gr = max(-bounds[2], bounds[3])
    gc = max(-bounds[4], bounds[5])
    gx = abs(jacobian[0, 0]) * gr + abs(jacobian[1, 0]) * gc
    gy = abs(jacobian[0, 1]) * gr + abs(jacobian[1, 1]) * gc
    # whoever strays by the radius, partly uphill and partly down, loses no more height than this
    lost = radius * math.sqrt(1.0 + (_TURN * gx) ** 2 + (_TURN * gy) ** 2)
    _patch_bounds(h, r0, r1, c0, c1, net, bounds)
    bound = max(bound, lowest - (bounds[1] if sign > 0.0 else -bounds[0]) - lost)
    # the height in the middle, and how fast it may fall from there to the corners: nothing between falls faster
    x = (piece[0, 0] + piece[1, 0] + piece[2, 0]) / 3.0
    y = (piece[0, 1] + piece[1, 1] + piece[2, 1]) / 3.0
    z = (piece[0, 2] + piece[1, 2] + piece[2, 2]) / 3.0
    row, column = cell_position(t, x, y)
    drop = 0.0
    for k in range(3):
        dr = cells[k, 0] - row
        dc = cells[k, 1] - column
        change = sign * (piece[k, 2] - z)
        low_r, high_r = (bounds[2], bounds[3]) if sign > 0.0 else (-bounds[3], -bounds[2])
        low_c, high_c = (bounds[4], bounds[5]) if sign > 0.0 else (-bounds[5], -bounds[4])
        change -= max(low_r * dr, high_r * dr) + max(low_c * dc, high_c * dc)
        drop = min(drop, change)
    drop -= 2.0 * (window[6] * gr + window[7] * gc)
    middle: float = sign * (z - kernels.terrain_height(t, x, y))
    least: float = max(bound, middle + drop - lost)
    return least


@kernel
def least_height(
    t: TerrainArrays,
    p: Pyramid,
    corners: FloatArray,
    radius: float,
    sign: float,
    enough: float,
    refuse: float,
    at: FloatArray,
) -> float:
    """Return a lower bound of ``sign`` (z - ground) over all within ``radius`` of a triangle (3, 3); write where.

    With ``sign`` -1, minus the result is an upper bound of the height. A triangle may be a segment or a point (corners
    equal). Branch and bound: the region is halved until its bounds meet a height that occurs within
    :data:`TOLERANCE_M`, or all of it is at least ``enough`` (then that is returned), or some point is below ``refuse``.
    """
    stack = np.empty((_STACK, 3, 3))
    net = np.empty((4, 4))
    bounds = np.empty(6)
    jacobian = np.empty((2, 2))
    cells = np.empty((3, 2))
    window = np.empty(8)
    place = np.empty(3)
    rows, columns = t.height_amsl_m.shape
    stack[0] = corners
    depth = 1
    found = np.inf  # a height that occurs
    proven = np.inf
    at[:] = corners[0]
    while depth > 0:
        depth -= 1
        piece = stack[depth]
        x = (piece[0, 0] + piece[1, 0] + piece[2, 0]) / 3.0
        y = (piece[0, 1] + piece[1, 1] + piece[2, 1]) / 3.0
        z = (piece[0, 2] + piece[1, 2] + piece[2, 2]) / 3.0
        _jacobian(t, x, y, jacobian)
        longest = -1.0
        edge = 0
        size2 = 0.0
        for k in range(3):
            n = (k + 1) % 3
            dx = piece[n, 0] - piece[k, 0]
            dy = piece[n, 1] - piece[k, 1]
            dz = piece[n, 2] - piece[k, 2]
            across2 = dx * dx + dy * dy
            size2 = max(size2, across2)
            if across2 + dz * dz > longest:
                longest = across2 + dz * dz
                edge = k
        r0 = c0 = np.inf
        r1 = c1 = -np.inf
        for k in range(3):
            cells[k, 0], cells[k, 1] = cell_position(t, piece[k, 0], piece[k, 1])
            r0, r1 = min(r0, cells[k, 0]), max(r1, cells[k, 0])
            c0, c1 = min(c0, cells[k, 1]), max(c1, cells[k, 1])
        # the grid's lines may be bent in the local frame: the piece may bulge beyond its corners' rectangle
        bulge_r = 0.25 * p.bend[0] * size2 + 1e-9
        bulge_c = 0.25 * p.bend[1] * size2 + 1e-9
        r0, r1, c0, c1 = r0 - bulge_r, r1 + bulge_r, c0 - bulge_c, c1 + bulge_c
        per_row = math.sqrt(jacobian[0, 0] ** 2 + jacobian[0, 1] ** 2)
        per_column = math.sqrt(jacobian[1, 0] ** 2 + jacobian[1, 1] ** 2)
        reach_r = _TURN * (radius * per_row) + 0.1 * bulge_r
        reach_c = _TURN * (radius * per_column) + 0.1 * bulge_c
        lowest = np.inf
        for k in range(3):
            lowest = min(lowest, sign * piece[k, 2])

        bound = -np.inf
        inside = (
            r0 - reach_r >= 1.0 and c0 - reach_c >= 1.0 and r1 + reach_r < rows - 2.0 and c1 + reach_c < columns - 2.0
        )
        wide = max(r1 - r0 + 2.0 * reach_r, c1 - c0 + 2.0 * reach_c)
        if inside:
            low, high = _block_bounds(p, r0 - reach_r, r1 + reach_r, c0 - reach_c, c1 + reach_c)
            bound = lowest - radius - (high if sign > 0.0 else -low)
            if bound < min(enough, found) and wide <= _PATCHES + 2.0 * max(reach_r, reach_c):
                window[0], window[1], window[2], window[3] = r0, r1, c0, c1
                window[4], window[5], window[6], window[7] = reach_r, reach_c, bulge_r, bulge_c
                fine = _fine_bound(t, piece, cells, window, jacobian, radius, sign, lowest, net, bounds)
                bound = max(bound, fine)
            bound -= _ROUNDING_M
        if bound >= min(enough, found - TOLERANCE_M):
            proven = min(proven, bound)
            continue
        height = _low_point(t, jacobian, x, y, z, radius, sign, place)
        if height < found:
            found = height
            at[:] = place
            if found < refuse:
                return min(proven, bound, found)
        small = longest <= _FINEST_M * _FINEST_M or (not inside and longest <= 100.0 * _FINEST_M * _FINEST_M)
        if bound >= min(enough, found - TOLERANCE_M) or small or depth + 2 > _STACK:
            proven = min(proven, bound)
            continue
        n = (edge + 1) % 3
        o = (edge + 2) % 3
        for axis in range(3):  # the second half is put beyond the first, which takes the piece's own place
            a, b, c = piece[edge, axis], piece[n, axis], piece[o, axis]
            half = 0.5 * (a + b)
            stack[depth + 1, 0, axis], stack[depth + 1, 1, axis], stack[depth + 1, 2, axis] = half, b, c
            stack[depth, 0, axis], stack[depth, 1, axis], stack[depth, 2, axis] = a, half, c
        depth += 2
    return min(proven, enough)


@kernel
def least_heights(
    t: TerrainArrays, p: Pyramid, pieces: FloatArray, radius_m: FloatArray, sign: float, enough_m: FloatArray
) -> FloatArray:
    """Return :func:`least_height` of triangles (N, 3, 3), and where, as (N, 4): bound, x, y, z. Never refuses early."""
    out = np.empty((pieces.shape[0], 4))
    for n in range(pieces.shape[0]):
        out[n, 0] = least_height(t, p, pieces[n], radius_m[n], sign, enough_m[n], -np.inf, out[n, 1:])
    return out


@kernel
def steepest(t: TerrainArrays, x: float, y: float, radius: float) -> float:
    """Return an upper bound of the ground's slope (rise over run) within a radius; inf where terrain is missing."""
    jacobian = np.empty((2, 2))
    net = np.empty((4, 4))
    bounds = np.empty(6)
    _jacobian(t, x, y, jacobian)
    row, column = cell_position(t, x, y)
    reach_r = _TURN * radius * math.sqrt(jacobian[0, 0] ** 2 + jacobian[0, 1] ** 2)
    reach_c = _TURN * radius * math.sqrt(jacobian[1, 0] ** 2 + jacobian[1, 1] ** 2)
    rows, columns = t.height_amsl_m.shape
    if not (
        row - reach_r >= 1.0
        and column - reach_c >= 1.0
        and row + reach_r < rows - 2.0
        and column + reach_c < columns - 2.0
    ):
        return np.inf
    _patch_bounds(t.height_amsl_m, row - reach_r, row + reach_r, column - reach_c, column + reach_c, net, bounds)
    gr = max(-bounds[2], bounds[3])
    gc = max(-bounds[4], bounds[5])
    if math.isinf(gr) or math.isinf(gc):
        return np.inf
    gx = abs(jacobian[0, 0]) * gr + abs(jacobian[1, 0]) * gc
    gy = abs(jacobian[0, 1]) * gr + abs(jacobian[1, 1]) * gc
    return _TURN * math.sqrt(gx * gx + gy * gy)
