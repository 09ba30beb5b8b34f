"""Paths for the UAV objective by dynamic programming: a graph over the whole map, priced as the objective is; weaving.

The objective is a sum over legs (length, threats, ground) and over corners (turns and changes of climb), so the
cheapest path among given places is found exactly by dynamic programming, layer by layer of waypoints:

* :func:`lattice_routes` takes the nodes of a lattice over the whole map as places. It finds the cheapest path, and the
  cheapest through places far from those already found: one per way round things.
* :func:`woven` takes a few places around each waypoint of a path, and finds the cheapest of all paths through them.

A path here is (n + 2, 3): x, y and the height above the ground, start and end included.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from missionplanner.compiled import njit
from missionplanner.experiments.uav_objective import (
    FREE_DEG,
    HIGH_M,
    INNER_M,
    LOW_M,
    OUTER_M,
    PENALTY,
    SAMPLES,
    TERMS,
    WEIGHTS,
    Instance,
    MapArrays,
)
from missionplanner.geodesy import FloatArray

MIDDLE_M = 0.5 * (LOW_M + HIGH_M)
_ORDER = np.array([5, 2, 8, 10, 1, 6, 4, 3, 7, 9, 0, 11])  # of samples: what is under ground is so far from nodes
_LENGTH_WEIGHT, _HEIGHT_WEIGHT = (float(WEIGHTS[TERMS.index(term)]) for term in ("length", "heights"))
_BIN_DEG = 10.0
_BINS = 19  # of climb angles: -90, -80, ... 90 degrees
_LEVEL = 9  # the bin of level flight
_QUARTER = 0.25 * math.pi
_HAIR_M = 0.01
"""Length of a leg that only shares a corner between two; more than what encoding and decoding lose."""
_CELLS = 90  # of the lattice, along the longer side of the map
_APART = 6  # cells between two routes

_kernel = njit(cache=True, error_model="numpy", nogil=True)

FloatTable = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Routes:
    """Paths of a lattice, cheapest first, and what they cost to find."""

    paths: FloatArray  # (G, n + 2, 3)
    legs: int
    """Legs priced; no call of the objective."""


# --- the objective, leg by leg ---------------------------------------------------------------------------------------


@_kernel
def altitude_m(m: MapArrays, x: float, y: float, height_m: float) -> float:
    """Return the altitude of a waypoint: its height above the cell it is in."""
    return float(height_m + m.height_m[int(np.rint(y)) - 1, int(np.rint(x)) - 1])


@_kernel
def leg_price(m: MapArrays, ax: float, ay: float, aa: float, bx: float, by: float, ba: float) -> float:
    """Return what a leg between places (x, y, altitude) adds: length, threats, and the penalty of the ground."""
    ex, ey, ea = bx - ax, by - ay, ba - aa
    ee = ex * ex + ey * ey
    cost = _LENGTH_WEIGHT * math.sqrt(ee + ea * ea)
    half = 0.5 * math.sqrt(ee)
    per = 1.0 / ee if ee > 0.0 else 0.0
    for k in range(m.threat.shape[0]):
        radius = m.threat[k, 3]
        outer = radius + OUTER_M
        wx, wy = m.threat[k, 0] - ax, m.threat[k, 1] - ay
        mx, my = wx - 0.5 * ex, wy - 0.5 * ey
        if mx * mx + my * my > (outer + half) * (outer + half):
            continue
        t = min(max((wx * ex + wy * ey) * per, 0.0), 1.0)
        dx, dy = wx - t * ex, wy - t * ey
        dd = dx * dx + dy * dy
        if dd > outer * outer:
            continue
        d = math.sqrt(dd)
        cost += PENALTY if d < radius + INNER_M else outer - d
    h = m.height_m
    rows, columns = h.shape
    if max(ax, bx) > columns - 1 or max(ay, by) > rows - 1:
        return cost + PENALTY
    for s in _ORDER:
        t = s / (SAMPLES - 1.0)
        x, y = ax + t * ex, ay + t * ey
        i, j = min(int(y), rows - 2), min(int(x), columns - 2)
        u, v = x - j, y - i
        ground = (h[i, j] * (1.0 - u) + h[i, j + 1] * u) * (1.0 - v)
        ground += (h[i + 1, j] * (1.0 - u) + h[i + 1, j + 1] * u) * v
        if not aa + t * ea > ground:
            return cost + PENALTY
    return cost


@_kernel
def _fits(m: MapArrays, reach_m: float, ex: float, ey: float, ez: float) -> bool:
    """Whether a step is in the box of spherical vectors (a hair inside, so that rounding does not matter)."""
    level = math.sqrt(ex * ex + ey * ey)
    if level <= 0.0 or abs(ez) > level or level * level + ez * ez > reach_m * reach_m * (1.0 - 1e-9):
        return False
    along = ex * math.sin(m.azimuth_rad) + ey * math.cos(m.azimuth_rad)
    return along >= level * (math.cos(_QUARTER) + 1e-9)


# --- between vectors and waypoints -----------------------------------------------------------------------------------


def encoded(instance: Instance, paths: FloatArray) -> FloatArray:
    """Return the points (P, 3 n) of the box whose paths are nearest, waypoint by waypoint, to paths (P, n + 2, 3).

    Exact, up to rounding, for paths that the box can express.
    """
    out = np.empty((len(paths), instance.dimensions))
    _encode(np.ascontiguousarray(paths, dtype=float), instance.arrays, instance.lower, instance.upper, out)
    return out


def decoded(instance: Instance, points: FloatArray) -> FloatArray:
    """Return the paths (P, n + 2, 3) of points (P, 3 n)."""
    paths = instance.waypoints_m(points)
    cell = np.round(paths[..., :2]).astype(int) - 1
    paths[..., 2] -= instance.arrays.height_m[cell[..., 1], cell[..., 0]]
    return paths


@_kernel
def _encode(paths: FloatArray, m: MapArrays, lower: FloatArray, upper: FloatArray, out: FloatArray) -> None:
    rows, columns = m.height_m.shape
    middle = m.azimuth_rad
    for n in range(paths.shape[0]):
        x, y, z = m.start[0], m.start[1], m.start[2]
        for i in range(paths.shape[1] - 2):
            ex, ey, ez = paths[n, i + 1, 0] - x, paths[n, i + 1, 1] - y, paths[n, i + 1, 2] - z
            along = ex * math.sin(middle) + ey * math.cos(middle)
            across = ex * math.cos(middle) - ey * math.sin(middle)
            turn = min(max(math.atan2(across, along), -_QUARTER), _QUARTER)
            # Where the heading is cut, the nearest point of the ray is taken: the foot of the wanted one.
            level = max(along * math.cos(turn) + across * math.sin(turn), 0.0)
            climb = min(max(math.atan2(ez, level), -_QUARTER), _QUARTER)
            r = max(level * math.cos(climb) + ez * math.sin(climb), 0.0) if level > 0.0 else 0.0
            k = 3 * i
            out[n, k] = min(max(r, lower[k]), upper[k])
            out[n, k + 1] = min(max(climb, lower[k + 1]), upper[k + 1])
            out[n, k + 2] = min(max(middle + turn, lower[k + 2]), upper[k + 2])
            step = out[n, k] * math.cos(out[n, k + 1])
            x = min(max(x + step * math.sin(out[n, k + 2]), 1.0), float(columns))
            y = min(max(y + step * math.cos(out[n, k + 2]), 1.0), float(rows))
            z = min(max(z + out[n, k] * math.sin(out[n, k + 1]), LOW_M), HIGH_M)


# --- the cheapest of all paths through places near a path ------------------------------------------------------------


@_kernel
def woven(places: FloatArray, m: MapArrays, reach_m: float, out: FloatArray) -> tuple[float, int]:
    """Write the cheapest path (n + 2, 3) through one of places (n, K, 3) per waypoint; return price and legs used.

    Exact for paths without legs of no length, which are left out; infinite when no path is in the box.
    """
    layers, width = places.shape[0], places.shape[1]
    altitude = np.empty((layers, width))
    for i in range(layers):
        for k in range(width):
            altitude[i, k] = altitude_m(m, places[i, k, 0], places[i, k, 1], places[i, k, 2])
    start_a = altitude_m(m, m.start[0], m.start[1], m.start[2])
    end_a = altitude_m(m, m.end[0], m.end[1], m.end[2])
    # Of the legs into a layer and into the one before it, from each place to each: unit heading, climb, least price of
    # all paths that end so.
    unit = np.empty((2, width, width, 2))
    climb = np.empty((2, width, width))
    least = np.empty((2, width, width))
    came = np.zeros((layers + 1, width, width), dtype=np.int16)
    legs = 0
    for i in range(layers + 1):
        old, new = (i + 1) % 2, i % 2
        for b in range(1 if i == 0 else width):
            if i == 0:
                bx, by, bz, ba = m.start[0], m.start[1], m.start[2], start_a
            else:
                bx, by, bz, ba = places[i - 1, b, 0], places[i - 1, b, 1], places[i - 1, b, 2], altitude[i - 1, b]
            befores = 0 if i == 0 else 1 if i == 1 else width
            reached = i == 0
            for a in range(befores):
                reached |= least[old, a, b] < np.inf
            for c in range(1 if i == layers else width):
                least[new, b, c] = np.inf
                if not reached:
                    continue
                if i == layers:
                    cx, cy, cz, ca = m.end[0], m.end[1], MIDDLE_M, end_a
                else:
                    cx, cy, cz, ca = places[i, c, 0], places[i, c, 1], places[i, c, 2], altitude[i, c]
                ex, ey = cx - bx, cy - by
                level = math.sqrt(ex * ex + ey * ey)
                if not (level > 0.0 if i == layers else _fits(m, reach_m, ex, ey, cz - bz)):
                    continue
                hx, hy = ex / level, ey / level
                steep = math.degrees(math.atan2(ca - ba, level))
                unit[new, b, c, 0], unit[new, b, c, 1], climb[new, b, c] = hx, hy, steep
                cost = leg_price(m, bx, by, ba, cx, cy, ca) + _HEIGHT_WEIGHT * abs(cz - MIDDLE_M)
                legs += 1
                before = 0.0 if i == 0 else np.inf
                for a in range(befores):
                    total = least[old, a, b]
                    if total >= before:
                        continue
                    dot = unit[old, a, b, 0] * hx + unit[old, a, b, 1] * hy
                    cross = abs(unit[old, a, b, 0] * hy - unit[old, a, b, 1] * hx)
                    if cross > dot:
                        total += math.degrees(math.atan2(cross, dot))
                    rise = abs(steep - climb[old, a, b])
                    if rise > FREE_DEG:
                        total += rise
                    if total < before:
                        before = total
                        came[i, b, c] = a
                least[new, b, c] = before + cost
    last = layers % 2
    best = 0
    for b in range(width):
        if least[last, b, 0] < least[last, best, 0]:
            best = b
    price = least[last, best, 0]
    to = 0
    for k in range(3):
        out[0, k], out[layers + 1, k] = m.start[k], m.end[k]
    for i in range(layers, 0, -1):
        for k in range(3):
            out[i, k] = places[i - 1, best, k]
        before_best = came[i, best, to]
        to = best
        best = before_best
    return price, legs


# --- the cheapest paths over a lattice -------------------------------------------------------------------------------


def lattice_routes(instance: Instance, *, routes: int, rng: np.random.Generator) -> Routes:
    """Return up to ``routes`` paths through nodes of a lattice, each off the others somewhere by some of its cells.

    ``rng`` lays the lattice. All waypoints fly at the middle height. Turns are not seen, changes of climb in steps of
    ten degrees.
    """
    m, count, reach_m = instance.arrays, instance.dimensions // 3, float(instance.upper[0])
    spacing_m = max(m.height_m.shape) / _CELLS
    node, columns = _nodes(m, spacing_m, rng)
    steps = _steps(m, reach_m, spacing_m)
    jump = steps[:, 0] * columns + steps[:, 1]
    price = np.full((len(node), len(steps)), np.inf, dtype=np.float32)
    tilt = np.zeros(price.shape, dtype=np.int8)
    ends = np.full((2, len(node)), np.inf, dtype=np.float32)
    end_tilt = np.zeros((2, len(node)), dtype=np.int8)
    stay = np.zeros(len(node), dtype=np.float32)
    legs = int(_edges(m, reach_m, node, columns, steps, price, tilt, ends, end_tilt, stay))
    degrees = np.abs(np.subtract.outer(np.arange(_BINS), np.arange(_BINS))) * _BIN_DEG
    corner = np.where(degrees > FREE_DEG, degrees, 0.0).astype(np.float32)
    there, back = np.full((2, count, len(node), _BINS), np.inf, dtype=np.float32)
    _forwards(price, tilt, ends[0], end_tilt[0], stay, jump, corner, there)
    _backwards(price, tilt, ends[1], end_tilt[1], stay, jump, corner, back)
    through = there + back[::-1]
    cheapest = through.min(axis=(0, 2))
    free = np.isfinite(cheapest)
    found: list[FloatArray] = []
    chain = np.empty(count, dtype=np.int64)
    while len(found) < routes and free.any():
        via = int(np.argmin(np.where(free, cheapest, np.inf)))
        layer, tilted = divmod(int(np.argmin(through[:, via])), _BINS)
        _trace(price, tilt, stay, jump, corner, there, back, layer, via, tilted, chain)
        path = np.concatenate([[m.start], node[chain], [m.end]])
        for i in np.flatnonzero(chain[1:] == chain[:-1]) + 2:  # a leg of no length shares a corner between two
            path[i] = path[i - 1] + _HAIR_M * np.array([math.sin(m.azimuth_rad), math.cos(m.azimuth_rad), 0.0])
        found.append(path)
        free &= _distance(path[:, :2], node) > _APART * spacing_m
    if not found:
        found.append(np.linspace(m.start, m.end, count + 2))
    return Routes(np.array(found), legs)


def _nodes(m: MapArrays, spacing_m: float, rng: np.random.Generator) -> tuple[FloatArray, int]:
    """Return one node (N, 3) per cell of the lattice, row by row, and the number of columns.

    Every second one is the highest place of its cell, from where one sees over ridges.
    """
    south, east = m.height_m.shape[0] - 1.0, m.height_m.shape[1] - 1.0
    first = 1.0 + rng.random(2) * spacing_m
    x, y = np.arange(first[0], east, spacing_m), np.arange(first[1], south, spacing_m)
    node = np.empty((len(y), len(x), 3))
    node[..., 0], node[..., 1], node[..., 2] = x, y[:, None], MIDDLE_M
    half = max(int(0.5 * spacing_m), 1)
    for i in range(len(y)):
        for j in range(i % 2, len(x), 2):
            row, column = max(int(y[i]) - half, 0), max(int(x[j]) - half, 0)
            block = m.height_m[
                row : min(int(y[i]) + half, int(south) - 1), column : min(int(x[j]) + half, int(east) - 1)
            ]
            if block.size:
                highest = divmod(int(np.argmax(block)), block.shape[1])
                node[i, j, :2] = column + highest[1] + 1, row + highest[0] + 1
    return node.reshape(-1, 3), len(x)


def _steps(m: MapArrays, reach_m: float, spacing_m: float) -> npt.NDArray[np.int64]:
    """Return the steps (K, 2), in rows and columns, that are in the box."""
    most = int(reach_m // spacing_m) + 1
    di, dj = (a.ravel() for a in np.mgrid[-most : most + 1, -most : most + 1])
    fits = [_fits(m, reach_m, spacing_m * j, spacing_m * i, 0.0) for i, j in zip(di, dj, strict=True)]
    return np.column_stack([di, dj])[fits]


def _distance(line: FloatArray, place: FloatArray) -> FloatArray:
    """Return the horizontal distance (N,) of places (N, 3) from a line (S, 2)."""
    a, e = line[:-1], np.diff(line, axis=0)
    wx, wy = place[:, :1] - a[:, 0], place[:, 1:2] - a[:, 1]
    t = np.clip((wx * e[:, 0] + wy * e[:, 1]) / np.maximum((e**2).sum(axis=1), 1e-12), 0.0, 1.0)
    out: FloatArray = np.hypot(wx - t * e[:, 0], wy - t * e[:, 1]).min(axis=1)
    return out


@_kernel
def _bin(rise_m: float, level_m: float) -> int:
    return int(np.rint(math.degrees(math.atan2(rise_m, level_m)) / _BIN_DEG)) + _LEVEL


@_kernel
def _edges(
    m: MapArrays,
    reach_m: float,
    node: FloatArray,
    columns: int,
    steps: npt.NDArray[np.int64],
    price: FloatTable,
    tilt: npt.NDArray[np.int8],
    ends: FloatTable,
    end_tilt: npt.NDArray[np.int8],
    stay: FloatTable,
) -> int:
    """Price the legs into every node, from the start and to the end, and a leg of no length at the node."""
    nodes = price.shape[0]
    rows = nodes // columns
    start_a = altitude_m(m, m.start[0], m.start[1], m.start[2])
    end_a = altitude_m(m, m.end[0], m.end[1], m.end[2])
    legs = 0
    a = np.empty(nodes)
    for v in range(nodes):
        a[v] = altitude_m(m, node[v, 0], node[v, 1], node[v, 2])
        stay[v] = leg_price(m, node[v, 0], node[v, 1], a[v], node[v, 0], node[v, 1], a[v])
    for v in range(nodes):
        if stay[v] >= PENALTY:
            continue  # nothing leads to where nobody may be
        i, j = v // columns, v % columns
        x, y, z = node[v]
        for k in range(steps.shape[0]):
            ui, uj = i - steps[k, 0], j - steps[k, 1]
            if ui < 0 or uj < 0 or ui >= rows or uj >= columns:
                continue
            u = ui * columns + uj
            if stay[u] >= PENALTY or not _fits(m, reach_m, x - node[u, 0], y - node[u, 1], z - node[u, 2]):
                continue
            price[v, k] = leg_price(m, node[u, 0], node[u, 1], a[u], x, y, a[v])
            tilt[v, k] = _bin(a[v] - a[u], math.hypot(x - node[u, 0], y - node[u, 1]))
            legs += 1
        ex, ey = x - m.start[0], y - m.start[1]
        if _fits(m, reach_m, ex, ey, z - m.start[2]):
            ends[0, v] = leg_price(m, m.start[0], m.start[1], start_a, x, y, a[v])
            end_tilt[0, v] = _bin(a[v] - start_a, math.hypot(ex, ey))
            legs += 1
        ex, ey = m.end[0] - x, m.end[1] - y
        ends[1, v] = leg_price(m, x, y, a[v], m.end[0], m.end[1], end_a)
        end_tilt[1, v] = _bin(end_a - a[v], math.hypot(ex, ey))
        legs += 1
    return legs


@_kernel
def _cornered(least: FloatTable, corner: FloatTable, out: FloatTable) -> None:
    """Write for every node and next climb the least over last climbs, corner included."""
    for v in range(least.shape[0]):
        for b in range(_BINS):
            out[v, b] = np.inf
        for a in range(_BINS):
            if least[v, a] < np.inf:
                for b in range(_BINS):
                    out[v, b] = min(out[v, b], least[v, a] + corner[a, b])


@_kernel
def _forwards(
    price: FloatTable,
    tilt: npt.NDArray[np.int8],
    begin: FloatTable,
    begin_tilt: npt.NDArray[np.int8],
    stay: FloatTable,
    jump: npt.NDArray[np.int64],
    corner: FloatTable,
    out: FloatTable,
) -> None:
    """Write the least cost of being at a node as the k-th waypoint, having come by a climb."""
    for v in range(price.shape[0]):
        if begin[v] < np.inf:
            out[0, v, begin_tilt[v]] = begin[v]
    left = np.empty((price.shape[0], _BINS), dtype=np.float32)
    for layer in range(1, out.shape[0]):
        _cornered(out[layer - 1], corner, left)
        for v in range(price.shape[0]):
            for k in range(price.shape[1]):
                if price[v, k] < np.inf:
                    b = tilt[v, k]
                    out[layer, v, b] = min(out[layer, v, b], left[v - jump[k], b] + price[v, k])
            out[layer, v, _LEVEL] = min(out[layer, v, _LEVEL], left[v, _LEVEL] + stay[v])


@_kernel
def _backwards(
    price: FloatTable,
    tilt: npt.NDArray[np.int8],
    end: FloatTable,
    end_tilt: npt.NDArray[np.int8],
    stay: FloatTable,
    jump: npt.NDArray[np.int64],
    corner: FloatTable,
    out: FloatTable,
) -> None:
    """Write the least cost from a node, reached by a climb, to the end with k waypoints more."""
    nodes = price.shape[0]
    ahead = np.full((nodes, _BINS), np.inf, dtype=np.float32)
    for v in range(nodes):
        ahead[v, end_tilt[v]] = end[v]
    _cornered(ahead, corner, out[0])
    for layer in range(1, out.shape[0]):
        ahead[:] = np.inf
        for v in range(nodes):
            for k in range(price.shape[1]):
                if price[v, k] < np.inf:
                    u, b = v - jump[k], tilt[v, k]
                    ahead[u, b] = min(ahead[u, b], price[v, k] + out[layer - 1, v, b])
            ahead[v, _LEVEL] = min(ahead[v, _LEVEL], stay[v] + out[layer - 1, v, _LEVEL])
        _cornered(ahead, corner, out[layer])


@_kernel
def _trace(
    price: FloatTable,
    tilt: npt.NDArray[np.int8],
    stay: FloatTable,
    jump: npt.NDArray[np.int64],
    corner: FloatTable,
    there: FloatTable,
    back: FloatTable,
    layer: int,
    via: int,
    tilted: int,
    chain: npt.NDArray[np.int64],
) -> None:
    """Write the nodes of the cheapest path whose waypoint ``layer`` is ``via``, reached by the climb ``tilted``."""
    count = there.shape[0]
    chain[layer] = via
    v, b = via, tilted
    for i in range(layer, 0, -1):
        best, from_u, from_a = np.inf, v, b
        for k in range(-1, price.shape[1]):
            if k < 0:
                if b != _LEVEL:
                    continue
                u, step = v, stay[v]
            else:
                if not price[v, k] < np.inf or tilt[v, k] != b:
                    continue
                u, step = v - jump[k], price[v, k]
            for a in range(_BINS):
                total = there[i - 1, u, a] + corner[a, b] + step
                if total < best:
                    best, from_u, from_a = total, u, a
        v, b = from_u, from_a
        chain[i - 1] = v
    v, b = via, tilted
    nodes = price.shape[0]
    for i in range(layer + 1, count):
        ahead = back[count - 1 - i]
        best, to_v, to_b = stay[v] + corner[b, _LEVEL] + ahead[v, _LEVEL], v, _LEVEL
        for k in range(price.shape[1]):
            w = v + jump[k]
            if w < 0 or w >= nodes or not price[w, k] < np.inf:
                continue
            total = corner[b, tilt[w, k]] + price[w, k] + ahead[w, tilt[w, k]]
            if total < best:
                best, to_v, to_b = total, w, int(tilt[w, k])
        v, b = to_v, to_b
        chain[i] = v
