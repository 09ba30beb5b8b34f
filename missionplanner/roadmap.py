"""Shortest ways along a roadmap: straight legs between points that stand close around the solids.

Where solids are tall the shortest path touches them, so rings of points around them, joined wherever a leg is clear,
hold a path nearly as short (a visibility graph, Lozano-Perez & Wesley 1979, doi:10.1145/359156.359164). What it passes
over is the ground: a leg that would hit it is priced, and drawn, as the string over it in its own vertical plane. A*
asks for a leg only when it would be the next to use (Bohlin & Kavraki 2000, doi:10.1109/ROBOT.2000.844107).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner import kernels
from missionplanner.compiled import njit
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import ObstacleArrays, SpaceArrays
from missionplanner.taut import INNER, LEAF, OUTER, Rules, leg_length, leg_ok

_EXCESS = 3e-4  # of the section's length: what one point's corner around a solid may cost, in the coarsest rings
_POINTS_MIN, _POINTS_MAX = 6, 64
_CLOSE_M = 3e-4  # beyond the margin: distances along legs are bounds within 1e-4 m
_STRING_PIECES = 48
_STRING_LEAST_M = 2.0  # spacing of the ground's samples below a leg
_STRING_SPARE = 0.25  # kept above them, as a share of their spacing
_APEXES = 6
_FREE = (0.0, 0.0, 1.0)  # of a point without a ring, and of the ends
_ROUNDING = 1e-9
_POINTS = 3000
_CIRCLES = 3000
_SAME_PLACE_M = 0.1
_BEND = 0.02  # rad: where curtains turn less, a leg past them costs next to nothing more than a string


class _Queue(NamedTuple):
    """A binary heap of legs that may be taken next."""

    key: FloatArray
    leg: npt.NDArray[np.int64]  # (N, 2)
    asked: npt.NDArray[np.bool_]  # whether the leg is known to be clear, its key exact


@njit(**INNER)
def _push(q: _Queue, n: int, key: float, a: int, b: int, asked: bool) -> None:
    """Add an entry to the heap of the first ``n``."""
    while n > 0:
        up = (n - 1) >> 1
        if q.key[up] <= key:
            break
        q.key[n] = q.key[up]
        q.leg[n] = q.leg[up]
        q.asked[n] = q.asked[up]
        n = up
    q.key[n] = key
    q.leg[n, 0] = a
    q.leg[n, 1] = b
    q.asked[n] = asked


@njit(**INNER)
def _pop(q: _Queue, n: int) -> None:
    """Drop the least entry of the heap of the first ``n + 1``."""
    key, a, b, asked = q.key[n], q.leg[n, 0], q.leg[n, 1], q.asked[n]
    at = 0
    while True:
        child = 2 * at + 1
        if child >= n:
            break
        if child + 1 < n and q.key[child + 1] < q.key[child]:
            child += 1
        if q.key[child] >= key:
            break
        q.key[at] = q.key[child]
        q.leg[at] = q.leg[child]
        q.asked[at] = q.asked[child]
        at = child
    q.key[at] = key
    q.leg[at, 0] = a
    q.leg[at, 1] = b
    q.asked[at] = asked


@njit(**INNER)
def _string(space: SpaceArrays, rules: Rules, a: FloatArray, b: FloatArray, out: FloatArray) -> int:
    """Write the string from a to b over the ground, in their vertical plane, to ``out``; return its points, 0: none."""
    ex, ey = b[0] - a[0], b[1] - a[1]
    across = math.sqrt(ex * ex + ey * ey)
    pieces = max(1, min(_STRING_PIECES, int(across / _STRING_LEAST_M)))
    spare = _STRING_SPARE * across / pieces
    out[0] = a
    size = 1
    for n in range(1, pieces + 1):
        s = n / pieces
        x, y = a[0] + s * ex, a[1] + s * ey
        z = b[2]
        if n == pieces:
            x, y = b[0], b[1]  # to the last bit
        else:
            z = kernels.terrain_height(space.terrain, x, y) + rules.height_min_m + spare
            if not z < np.inf:
                return 0
            if z <= a[2] + s * (b[2] - a[2]):
                continue
        # upper hull: points below the line from the one before to the new one go
        while size > 1:
            p, q = out[size - 2], out[size - 1]
            before = math.hypot(q[0] - p[0], q[1] - p[1])
            after = math.hypot(x - q[0], y - q[1])
            if (q[2] - p[2]) * after > (z - q[2]) * before:
                break
            size -= 1
        if size == out.shape[0]:
            return 0
        out[size, 0] = x
        out[size, 1] = y
        out[size, 2] = z
        size += 1
    return size


@njit(**INNER)
def _leg_cost(
    space: SpaceArrays, rules: Rules, walls: FloatArray, p: FloatArray, a: int, b: int, leg: FloatArray, out: FloatArray
) -> float:
    """Return the length of the clear string from point a to b; inf: there is none."""
    leg[0] = p[a]
    leg[1] = p[b]
    if not kernels.leg_is_clear(space, leg, np.inf, -np.inf, np.inf, rules.alt_max_m, rules.obstacle_m, rules.fence_m):
        return np.inf
    length: float = leg_length(leg)
    if leg_ok(space, rules, walls, leg, True):  # most legs: nothing below holds them
        return length
    size = _string(space, rules, p[a], p[b], out)
    length = 0.0 if size > 0 else np.inf
    for n in range(size - 1):
        leg[0] = out[n]
        leg[1] = out[n + 1]
        if not leg_ok(space, rules, walls, leg, False):
            return np.inf
        length += leg_length(leg)
    return length


@njit(**LEAF)
def _touches(held: FloatArray, leg: FloatArray) -> bool:
    """Return whether a leg passes a ring's point on the outside, seen from above: else no string that bends there."""
    ex, ey = leg[1, 0] - leg[0, 0], leg[1, 1] - leg[0, 1]
    inwards = ex * held[0] + ey * held[1]
    touches: bool = inwards * inwards <= held[2] * held[2] * (ex * ex + ey * ey)
    return touches


@njit(**OUTER)
def _search(
    space: SpaceArrays,
    rules: Rules,
    walls: FloatArray,
    p: FloatArray,
    held: FloatArray,
    longest_m: float,
    parent: npt.NDArray[np.int64],
    key: FloatArray,
    legs: npt.NDArray[np.int64],
    asked: npt.NDArray[np.bool_],
) -> float:
    """Find the shortest way from point 0 to point 1 of ``p``; write each point's ``parent``, return the length.

    Only along legs that touch the rings of both ends: by ``held`` (N, 3), see :func:`_rings`. Gives up, returning inf,
    when nothing shorter than ``longest_m`` is left.
    """
    count = p.shape[0]
    queue = _Queue(key, legs, asked)
    cost = np.full(count, np.inf)
    closed = np.zeros(count, dtype=np.bool_)
    to_go = np.empty(count)
    leg = np.empty((2, 3))
    out = np.empty((_APEXES + 2, 3))
    for n in range(count):
        leg[0] = p[n]
        leg[1] = p[1]
        to_go[n] = leg_length(leg)
    queued = 0
    here = 0
    cost[0] = 0.0
    while True:
        closed[here] = True
        if here == 1:
            found: float = cost[1]
            return found
        leg[0] = p[here]
        for n in range(count):
            if closed[n]:
                continue
            leg[1] = p[n]
            if not (_touches(held[here], leg) and _touches(held[n], leg)):
                continue
            total = cost[here] + leg_length(leg)
            if total < cost[n] and total + to_go[n] < longest_m and queued < key.shape[0]:
                _push(queue, queued, total + to_go[n], here, n, False)
                queued += 1
        here = -1
        while queued > 0:
            least, a, b, known = key[0], legs[0, 0], legs[0, 1], asked[0]
            queued -= 1
            _pop(queue, queued)
            if closed[b]:
                continue
            if known:
                here = b
                break
            total = cost[a] + _leg_cost(space, rules, walls, p, a, b, leg, out)
            if total >= cost[b] or total + to_go[b] >= longest_m:
                continue
            cost[b] = total
            parent[b] = a
            if total + to_go[b] <= least + 1e-9:
                here = b
                break
            _push(queue, queued, total + to_go[b], a, b, True)
            queued += 1
        if here < 0:
            return np.inf


@njit(**OUTER)
def _draw(space: SpaceArrays, rules: Rules, walls: FloatArray, p: FloatArray, out: FloatArray) -> int:
    """Write the strings between consecutive points of ``p`` to ``out``; return how many points they have."""
    piece = np.empty((_APEXES + 2, 3))
    size = 1
    out[0] = p[0]
    for n in range(p.shape[0] - 1):
        more = 2
        piece[1] = p[n + 1]
        if not leg_ok(space, rules, walls, p[n : n + 2], True):
            more = _string(space, rules, p[n], p[n + 1], piece)
        for k in range(1, more):
            out[size] = piece[k]
            size += 1
    return size


@njit(**OUTER)
def _clear_points(space: SpaceArrays, rules: Rules, p: FloatArray) -> npt.NDArray[np.bool_]:
    """Return which points (N, 3) keep the margins, raising those too low above the ground."""
    clear = np.ones(p.shape[0], dtype=np.bool_)
    for n in range(p.shape[0]):
        ground = kernels.terrain_height(space.terrain, p[n, 0], p[n, 1])
        p[n, 2] = min(max(p[n, 2], ground + rules.height_min_m + 1e-3), ground + rules.height_max_m - 1e-3)
        if not (p[n, 2] >= ground + rules.height_min_m and p[n, 2] <= rules.alt_max_m):
            clear[n] = False
            continue
        clear[n] = (
            kernels.inside_distance(space, p[n, 0], p[n, 1], p[n, 2]) >= rules.fence_m
            and kernels.nearest_hard(space.obstacles, p[n, 0], p[n, 1], p[n, 2], rules.obstacle_m) >= rules.obstacle_m
        )
    return clear


def _rings(
    o: ObstacleArrays, ends: FloatArray, margin_m: float, longest_m: float, excess_m: float
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]:
    """Return points (N, 2) around every hard solid in the way seen from above, and around every corner of a prism.

    On the corners of a polygon around the circle, so that the legs between neighbours just touch it; a corner costs at
    most about ``excess_m`` more than the arc. Where two circles leave a gap, a leg of either polygon leads through.
    Also returned: for each point the direction (N, 2) away from its circle and the sine of the greatest angle by which
    a leg that touches the polygon there leaves the tangent (1 in gaps: there one must take what there is); and the
    points (N, 2) next to it on the polygon.
    """
    owner, x, y, radius_m = _circles(o)
    reach_m = radius_m + margin_m + _CLOSE_M
    detour_m = np.hypot(x - ends[:, 0, np.newaxis], y - ends[:, 1, np.newaxis]).sum(axis=0) - 2.0 * reach_m
    least = np.argsort(detour_m, kind="stable")[:_CIRCLES]
    least = np.sort(least[detour_m[least] < longest_m])
    owner, x, y, reach_m = owner[least], x[least], y[least], reach_m[least]
    count = np.clip(np.ceil(math.tau / (12.0 * excess_m / reach_m) ** (1.0 / 3.0)), _POINTS_MIN, _POINTS_MAX)
    out_m = reach_m / np.cos(math.pi / count)
    rings, beside = [np.empty((0, 5))], [np.empty((0, 2), dtype=np.int64)]
    first = 0
    for n in range(len(x)):
        apart_m = np.hypot(x - x[n], y - y[n])
        gaps = np.flatnonzero((apart_m < out_m + out_m[n]) & (apart_m > reach_m + reach_m[n]))
        within = [m for m in gaps[owner[gaps] == owner[n]] if _is_filled(o, owner[n], x[[m, n]], y[[m, n]], margin_m)]
        gaps = np.setdiff1d(gaps, within)
        facing = np.arctan2(y[gaps] - y[n], x[gaps] - x[n])[:, np.newaxis] + (-math.pi / count[n], math.pi / count[n])
        angle = np.concatenate([math.tau * np.arange(int(count[n])) / count[n], facing.ravel()])
        east, north = np.cos(angle), np.sin(angle)
        leaves = np.ones(len(angle))
        leaves[: int(count[n])] = math.sin(math.pi / count[n]) + _ROUNDING
        rings.append(np.column_stack([x[n] + out_m[n] * east, y[n] + out_m[n] * north, east, north, leaves]))
        around = np.arange(len(angle))
        before, after = ((around + turn) % int(count[n]) for turn in (-1, 1))
        beside.append(first + np.column_stack([before, after]))
        first += len(angle)
    points = np.concatenate(rings)
    return points[:, :2], points[:, 2:], np.concatenate(beside)


def _circles(o: ObstacleArrays) -> tuple[npt.NDArray[np.intp], FloatArray, FloatArray, FloatArray]:
    """Return the solid, place and radius of circles that a taut string may touch.

    At a prism those of its corners, at curtains those of the ends and bends of their line.
    """
    prism = o.kind == kernels.PRISM
    round_ = np.flatnonzero(o.hard & ~prism & (o.kind != kernels.CURTAIN))
    bends, around_bends = _bends(o)
    owners, circles = [round_, bends], [o.bound[round_, :3], around_bends]
    for i in np.flatnonzero(o.hard & prism):
        at = o.vertices[o.vertex_start[i] : o.vertex_start[i + 1]]
        before, after = at - np.roll(at, 1, axis=0), np.roll(at, -1, axis=0) - at
        turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        around = np.sum(at[:, 0] * after[:, 1] - at[:, 1] * after[:, 0])
        at = at[turn * around > 0.0]  # no string reaches into a corner that points inwards
        owners.append(np.full(len(at), i))
        circles.append(np.column_stack([at, np.zeros(len(at))]))
    x, y, radius_m = np.concatenate(circles).T
    return np.concatenate(owners), x, y, radius_m


def _bends(o: ObstacleArrays) -> tuple[npt.NDArray[np.intp], FloatArray]:
    """Return the curtain and the circle (N, 3) of every end of a curtain that no other goes on from straight ahead."""
    owner = np.flatnonzero(o.hard & (o.kind == kernels.CURTAIN))
    if not len(owner):
        return owner, np.empty((0, 3))
    start, end, radius_m = o.params[owner, :2], o.params[owner, 3:5], o.params[owner, 6]
    course = (end - start) / np.maximum(np.linalg.norm(end - start, axis=1), 1e-9)[:, np.newaxis]
    owner, at, away = np.tile(owner, 2), np.concatenate([start, end]), np.concatenate([-course, course])
    _, first, place = np.unique(np.rint(at / _SAME_PLACE_M), axis=0, return_index=True, return_inverse=True)
    place = place.reshape(-1)
    count = np.bincount(place, minlength=len(first))
    turn = np.zeros((len(first), 2))
    np.add.at(turn, place, away)
    straight = (count == 2) & (np.linalg.norm(turn, axis=1) < _BEND)
    bends = first[~straight]
    return owner[bends], np.column_stack([at[bends], np.tile(radius_m, 2)[bends]])


def _is_filled(o: ObstacleArrays, i: int, x: FloatArray, y: FloatArray, margin_m: float) -> bool:
    """Return whether there is no way through between two corners of a prism, or ends of a curtain, of these x and y."""
    if o.kind[i] != kernels.PRISM or o.params[i, 2]:  # convex
        return True
    middle_m = kernels.polygon_distance(o.vertices, o.vertex_start[i], o.vertex_start[i + 1], x.mean(), y.mean())
    return bool(middle_m < margin_m)


def shortest_way(
    space: SpaceArrays,
    rules: Rules,
    start_m: FloatArray,
    goal_m: FloatArray,
    known: FloatArray,
    longest_m: float,
    *,
    fineness: float = 1.0,
    taut: bool = False,
) -> FloatArray | None:
    """Return the shortest path (K, 3) along the roadmap if it is shorter than ``longest_m``, else None.

    Parameters
    ----------
    known : (N, 3) points of paths known so far, to go along or to change over between them.
    fineness : of the rings: corners cost so many times less.
    taut : look only for ways that touch the rings they bend at, as a string would that nothing else holds.
    """
    ends = np.array([start_m, goal_m])
    excess_m = _EXCESS / fineness * float(np.linalg.norm(goal_m - start_m))
    ring, held, beside = _rings(space.obstacles, ends, rules.obstacle_m, longest_m, excess_m)
    away = np.linalg.norm(ring[:, np.newaxis] - ends[:, :2], axis=2)
    share = away[:, 0] / np.maximum(away.sum(axis=1), 1e-9)
    raised = [np.column_stack([ring, start_m[2] + share * (goal_m[2] - start_m[2])])]
    points = np.concatenate([*raised, known])
    near = np.flatnonzero(np.linalg.norm(points[:, np.newaxis] - ends, axis=2).sum(axis=1) < longest_m)
    points = points[near]
    clear = _clear_points(space, rules, points)
    if taut:
        blocked = np.zeros(len(ring) + len(known), dtype=np.bool_)
        blocked[near[~clear]] = True
        held[blocked[beside].any(axis=1)] = _FREE  # the leg along the ring is not there: one must take what there is
    else:
        held[:] = _FREE
    held = np.concatenate([held, np.tile(_FREE, (len(known), 1))])[near[clear]]
    points = points[clear]
    detour = np.linalg.norm(points[:, np.newaxis] - ends, axis=2).sum(axis=1)
    least = np.argsort(detour, kind="stable")[:_POINTS]
    points, held = np.concatenate([ends, points[least]]), np.concatenate([np.tile(_FREE, (2, 1)), held[least]])
    room, no_walls = 64 * len(points) + 1000, np.empty((0, 11))
    parent = np.full(len(points), -1)
    length = _search(
        space,
        rules,
        no_walls,
        points,
        held,
        longest_m,
        parent,
        np.empty(room),
        np.empty((room, 2), dtype=np.int64),
        np.empty(room, dtype=np.bool_),
    )
    if not math.isfinite(length):
        return None
    way = [1]
    while way[-1] != 0:
        way.append(int(parent[way[-1]]))
    path = np.empty((len(way) * (_APEXES + 2), 3))
    size = _draw(space, rules, no_walls, points[way[::-1]], path)
    return path[:size].copy()
