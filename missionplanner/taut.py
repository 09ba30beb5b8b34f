"""Polylines drawn taut: what a leg must keep, and the shortest path that keeps it on its way around everything.

First points slide and are pulled in while each leg stays clear, which brings any clear polyline near its taut string.
Then a barrier method converges to it (Nesterov & Nemirovskii 1994): length minus the logarithms of all that legs keep
beyond their margins, the weight of these falling, by Newton steps on the banded Hessian. Between its levels corners are
cut: around a round solid the path becomes an arc of as many legs as the tolerance asks for.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner import kernels
from missionplanner.clearance import STEP_M
from missionplanner.compiled import njit
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays

_ROUNDS = 30
_HALVINGS = 9
_LEAST = 0.5**8
_OVER_PULL = 1.5  # beyond the chord: over-relaxed, many points find their line in few rounds
_SLIDE_ON, _SLIDE_BACK, _PULL_UPRIGHT, _PULL_LEVEL, _CUT = range(5)
_CUT_ROUNDS = 3


class Rules(NamedTuple):
    """What a leg must keep, for the kernels."""

    height_min_m: float
    height_max_m: float
    alt_max_m: float
    obstacle_m: float
    fence_m: float
    slope_up: float
    slope_down: float
    ground_slope: float  # no ground near is steeper


# Wrappers that nobody calls cost a quarter of the compile time.
INNER: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True, "no_cpython_wrapper": True}
OUTER: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True, "nogil": True}  # several vehicles' at a time
LEAF: dict[str, Any] = {**INNER, "_nrt": False}  # as kernels.leaf: makes no array, calls only such

# --- kernels -------------------------------------------------------------------------------------------------------


@njit(**LEAF)
def _over_ground(space: SpaceArrays, rules: Rules, leg: FloatArray) -> bool:
    """Return whether a leg keeps its height above ground; strides as far as the ground's slope allows."""
    ex, ey, ez = leg[1, 0] - leg[0, 0], leg[1, 1] - leg[0, 1], leg[1, 2] - leg[0, 2]
    length = math.sqrt(ex * ex + ey * ey)
    closing = rules.ground_slope + (abs(ez) / length if length > 0.0 else 0.0)
    s = 0.0
    while True:
        f = s / length if length > 0.0 else 1.0
        height = leg[0, 2] + f * ez - kernels.terrain_height(space.terrain, leg[0, 0] + f * ex, leg[0, 1] + f * ey)
        if not rules.height_min_m <= height <= rules.height_max_m:
            return False
        if s >= length:
            return True
        slack = min(height - rules.height_min_m, rules.height_max_m - height)
        stride = STEP_M if slack <= STEP_M * closing else slack / closing if closing > 0.0 else length
        s = min(length, s + stride)


@njit(**LEAF)
def _crosses_wall(walls: FloatArray, leg: FloatArray) -> bool:
    """Return whether a leg passes through a wall: rows of centre, normal, open direction (3 each), depth, reach."""
    for n in range(walls.shape[0]):
        w = walls[n]
        before = after = 0.0
        for k in range(3):
            before += (leg[0, k] - w[k]) * w[3 + k]
            after += (leg[1, k] - w[k]) * w[3 + k]
        if (before < 0.0) == (after < 0.0):
            continue
        f = before / (before - after)
        away = square = 0.0
        for k in range(3):
            v = leg[0, k] + f * (leg[1, k] - leg[0, k]) - w[k]
            away += v * w[6 + k]
            square += v * v
        if away > -w[9] and square < w[10] * w[10]:
            return True
    return False


@njit(**OUTER)
def leg_ok(space: SpaceArrays, rules: Rules, walls: FloatArray, leg: FloatArray, open_air: bool) -> bool:
    """Return whether a leg keeps all rules and no wall; ``open_air`` says that obstacles and fence are known far."""
    ex, ey, ez = leg[1, 0] - leg[0, 0], leg[1, 1] - leg[0, 1], leg[1, 2] - leg[0, 2]
    across = math.sqrt(ex * ex + ey * ey)
    if ez > rules.slope_up * across or -ez > rules.slope_down * across:
        return False
    if _crosses_wall(walls, leg) or not _over_ground(space, rules, leg):
        return False
    if open_air:
        below: bool = leg[0, 2] <= rules.alt_max_m and leg[1, 2] <= rules.alt_max_m
        return below
    clear: bool = kernels.leg_is_clear(
        space, leg, np.inf, -np.inf, np.inf, rules.alt_max_m, rules.obstacle_m, rules.fence_m
    )
    return clear


@njit(**LEAF)
def leg_length(leg: FloatArray) -> float:
    """Return the length of a leg (2, 3)."""
    return math.sqrt((leg[0, 0] - leg[1, 0]) ** 2 + (leg[0, 1] - leg[1, 1]) ** 2 + (leg[0, 2] - leg[1, 2]) ** 2)


@njit(**LEAF)
def _distance(p: FloatArray, i: int, j: int) -> float:
    return math.sqrt((p[i, 0] - p[j, 0]) ** 2 + (p[i, 1] - p[j, 1]) ** 2 + (p[i, 2] - p[j, 2]) ** 2)


@njit(**LEAF)
def _corner(p: FloatArray, b: int, step: int, f: float, out: FloatArray) -> None:
    """Write where a step of :func:`pull`, done to the share ``f``, puts the corner ``p[b]``: two rows after a cut."""
    ab, bc = max(_distance(p, b - 1, b), 1e-9), max(_distance(p, b, b + 1), 1e-9)
    cut_m = f * min(ab, bc)
    for k in range(3):
        to_a, to_c = p[b - 1, k] - p[b, k], p[b + 1, k] - p[b, k]
        out[0, k] = p[b, k]
        if step == _SLIDE_ON:
            out[0, k] += f * to_c
        elif step == _SLIDE_BACK:
            out[0, k] += f * to_a
        elif step == _CUT:
            out[0, k] += to_a * cut_m / ab
            out[1, k] = p[b, k] + to_c * cut_m / bc
        elif (step == _PULL_LEVEL) == (k < 2):
            out[0, k] += f * _OVER_PULL * (to_a * bc + to_c * ab) / (ab + bc)


@njit(**INNER)
def _corner_ok(
    space: SpaceArrays, rules: Rules, walls: FloatArray, p: FloatArray, b: int, step: int, spot: FloatArray
) -> bool:
    """Return whether the legs at a corner moved to ``spot`` are clear, and no longer than before."""
    leg = np.empty((2, 3))
    before = _distance(p, b - 1, b) + _distance(p, b, b + 1)
    length = 0.0
    for n in range(1 if step == _CUT else 2):
        for k in range(3):
            leg[0, k] = spot[0, k] if n == 1 or step == _CUT else p[b - 1, k]
            leg[1, k] = spot[1, k] if step == _CUT else spot[0, k] if n == 0 else p[b + 1, k]
        length += leg_length(leg)
        if length > before or not leg_ok(space, rules, walls, leg, False):
            return False
    return True


@njit(**OUTER)
def pull(space: SpaceArrays, rules: Rules, walls: FloatArray, p: FloatArray, size: int, tolerance_m: float) -> int:
    """Draw the path ``p[:size]`` taut in place, while a round saves the tolerance; return its new size.

    Each point slides along its two legs as far as the leg to its other neighbour stays clear (all the way: it is
    dropped), then is pulled towards its neighbours' chord, level and upright, because a point held by a mast or a
    cable moves along it only by that. When this saves no more, corners are cut too. No step lengthens the path. Rows
    beyond ``size`` are room for points that cuts add.
    """
    spot = np.empty((2, 3))
    cuts = 0
    for _ in range(_ROUNDS):
        gained = 0.0
        b = 1
        while b < size - 1:
            before = _distance(p, b - 1, b) + _distance(p, b, b + 1)
            bends = before - _distance(p, b - 1, b + 1) > 0.1 * tolerance_m
            after = before
            for step in range(_CUT + 1 if cuts > 0 and size < p.shape[0] else _CUT):
                good, bad = 0.0, 1.0
                for n in range(_HALVINGS if bends else 1):
                    # All the way, else the least, else halving: most points are stuck or free, few in between.
                    f = 1.0 if n == 0 else _LEAST if n == 1 else 0.5 * (good + bad)
                    _corner(p, b, step, f, spot)
                    if _corner_ok(space, rules, walls, p, b, step, spot):
                        good = f
                    else:
                        bad = f
                    if good == 1.0 or (n == 1 and good == 0.0):
                        break
                if good == 0.0:
                    continue
                _corner(p, b, step, good, spot)
                if step == _CUT:
                    cut_m = good * min(_distance(p, b - 1, b), _distance(p, b, b + 1))
                    saved = 2.0 * cut_m - leg_length(spot)
                    if saved < tolerance_m:
                        continue
                    for n in range(size, b, -1):
                        for k in range(3):
                            p[n, k] = p[n - 1, k]
                    size += 1
                    gained += saved
                    b += 1
                    for k in range(3):
                        p[b - 1, k] = spot[0, k]
                        p[b, k] = spot[1, k]
                    break
                for k in range(3):
                    p[b, k] = spot[0, k]
                after = _distance(p, b - 1, b) + _distance(p, b, b + 1)
                if min(_distance(p, b - 1, b), _distance(p, b, b + 1)) < 1e-6:
                    size -= 1
                    for n in range(b, size):
                        for k in range(3):
                            p[n, k] = p[n + 1, k]
                    b -= 1
                    break
            gained += before - after
            b += 1
        if cuts > 0 or gained < tolerance_m:
            cuts += 1
        if cuts > _CUT_ROUNDS:
            break
    return size


# --- the barrier method --------------------------------------------------------------------------------------------

_WEIGHTS = (1e-5, 1e-6, 1e-7)
"""Of the barrier, as shares of the path's length: a path ends about so much longer per contact than the shortest."""
_NEWTON_STEPS = 20
_SETTLED = 3e-7  # of the path's length: steps that promise less change nothing
_ARMIJO = 0.05
_REACH = 1000.0  # barriers begin this many weights from the margin ...
_REACH_MIN_M, _REACH_MAX_M = 0.5, 20.0  # ... within these
_SLOPE_REACH = 0.03  # rad: barriers of the climb limits
_SHIFT = 0.5  # weights: barriers end so far below the margin, for paths that touch it; steps are judged by the margin
_HAIR_M = 1e-6  # what rounding may take from a path that touches it
_HOLD = 0.004  # keeps points from sliding off along their legs, where nothing else holds them
_BACKTRACKS = 12
_FARTHEST = 0.01  # of the path's length: a step moves no point further
_GOLDEN = 0.3819660112501051
_GOLDEN_STEPS = 26
_PLACES = 8
_APART = 1e-3  # of a leg: places that close are one
_SLOPE_M = 1e-3  # step of numerical gradients
_CUT_FIRST, _CUT_NEXT, _CUT_TRIALS = 0.3, 0.7, 9
_BAND = 6


class _Sum(NamedTuple):
    """Derivatives of a leg's terms by both its ends: what :func:`_barrier` adds to."""

    gradient: FloatArray  # (6,)
    hessian: FloatArray  # (6, 6)
    normal: FloatArray  # (3,) scratch
    box: FloatArray  # (1, 6) scratch: around a leg
    near: npt.NDArray[np.int64]  # (2, O) scratch: solids near it; the second row all 0
    shift_m: float  # how far below the margin barriers end


@njit(**LEAF)
def _barrier(room_m: float, reach_m: float, s: float, add: _Sum, derive: bool) -> float:
    """Return the barrier of a distance beyond its margin, 0 from ``reach_m`` on; inf a hair below the margin.

    ``add.normal`` is the gradient of the distance by the place ``s`` along the leg, or by its direction for s = -1.
    """
    if not room_m > -_HAIR_M:
        return np.inf
    if room_m >= reach_m:
        return 0.0
    near = (room_m + add.shift_m) / (reach_m + add.shift_m)
    if derive:
        slope = (1.0 - 1.0 / near) / (reach_m + add.shift_m)
        bend = 1.0 / (room_m + add.shift_m) ** 2
        for i in range(6):
            vi = add.normal[i % 3] * ((s if i >= 3 else 1.0 - s) if s >= 0.0 else (1.0 if i >= 3 else -1.0))
            add.gradient[i] += slope * vi
            for j in range(6):
                vj = add.normal[j % 3] * ((s if j >= 3 else 1.0 - s) if s >= 0.0 else (1.0 if j >= 3 else -1.0))
                add.hessian[i, j] += bend * vi * vj
    return near - 1.0 - math.log(near)


@njit(**LEAF)
def _room(space: SpaceArrays, rules: Rules, i: int, x: float, y: float, z: float) -> float:
    """Return how far a place is beyond the margin of solid ``i``; for i = -1, of fence and area."""
    if i < 0:
        inside: float = kernels.inside_distance(space, x, y, z) - rules.fence_m
        return inside
    away: float = kernels.obstacle_distance(space.obstacles, i, x, y, z) - rules.obstacle_m
    return away


@njit(**LEAF)
def _beside_upright(o: kernels.ObstacleArrays, i: int, a: FloatArray, b: FloatArray) -> bool:
    """Return whether solid ``i`` is a cylinder that ends no lower than a leg."""
    beside: bool = o.kind[i] == kernels.CYLINDER and max(a[2], b[2]) <= o.params[i, 3]
    return beside


@njit(**LEAF)
def _nearest(space: SpaceArrays, rules: Rules, i: int, a: FloatArray, b: FloatArray) -> float:
    """Return where along a-b solid ``i`` (-1: fence and area) is nearest; exact for upright cylinders."""
    o = space.obstacles
    ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    if i >= 0 and _beside_upright(o, i, a, b):
        square = ex * ex + ey * ey
        along = (o.params[i, 0] - a[0]) * ex + (o.params[i, 1] - a[1]) * ey
        return min(1.0, max(0.0, along / square)) if square > 0.0 else 0.0
    best, at = np.inf, 0.0
    for k in range(_PLACES + 1):
        s = k / _PLACES
        d = _room(space, rules, i, a[0] + s * ex, a[1] + s * ey, a[2] + s * ez)
        if d < best:
            best, at = d, s
    low, high = max(0.0, at - 1.0 / _PLACES), min(1.0, at + 1.0 / _PLACES)
    left, right = low + _GOLDEN * (high - low), high - _GOLDEN * (high - low)
    d_left = _room(space, rules, i, a[0] + left * ex, a[1] + left * ey, a[2] + left * ez)
    d_right = _room(space, rules, i, a[0] + right * ex, a[1] + right * ey, a[2] + right * ez)
    for _ in range(_GOLDEN_STEPS):
        if d_left <= d_right:
            high, right, d_right = right, left, d_left
            left = low + _GOLDEN * (high - low)
            d_left = _room(space, rules, i, a[0] + left * ex, a[1] + left * ey, a[2] + left * ez)
        else:
            low, left, d_left = left, right, d_right
            right = high - _GOLDEN * (high - low)
            d_right = _room(space, rules, i, a[0] + right * ex, a[1] + right * ey, a[2] + right * ez)
    s = 0.5 * (low + high)
    return at if best <= min(d_left, d_right) else s


@njit(**LEAF)
def _solid_barrier(
    space: SpaceArrays, rules: Rules, i: int, a: FloatArray, b: FloatArray, reach_m: float, add: _Sum, derive: bool
) -> float:
    """Return the barriers of a leg beside solid ``i`` (-1: fence and area), at its nearest place.

    Where it may have flat sides, also at places all along: beside one, the nearest place jumps from end to end.
    """
    nearest = _nearest(space, rules, i, a, b)
    is_round = i >= 0 and (space.obstacles.kind[i] == kernels.RADAR or space.obstacles.kind[i] == kernels.MARINE)
    is_round = is_round or (i >= 0 and _beside_upright(space.obstacles, i, a, b))
    total: float = 0.0
    for n in range(1 if is_round else _PLACES + 2):
        s = nearest if n == 0 else (n - 1) / _PLACES
        if n > 0 and abs(s - nearest) < _APART:
            continue
        x, y, z = a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])
        room = _room(space, rules, i, x, y, z)
        if derive and room < reach_m:
            h = _SLOPE_M
            two = 2.0 * h
            add.normal[0] = (_room(space, rules, i, x + h, y, z) - _room(space, rules, i, x - h, y, z)) / two
            add.normal[1] = (_room(space, rules, i, x, y + h, z) - _room(space, rules, i, x, y - h, z)) / two
            add.normal[2] = (_room(space, rules, i, x, y, z + h) - _room(space, rules, i, x, y, z - h)) / two
        total += _barrier(room, reach_m, s, add, derive)
    return total


@njit(**LEAF)
def _height_barrier(
    space: SpaceArrays,
    rules: Rules,
    a: FloatArray,
    b: FloatArray,
    sign: float,
    reach_m: float,
    add: _Sum,
    derive: bool,
) -> float:
    """Return the barriers of a leg near its least (sign 1) or greatest (-1) height, one at each local least of room."""
    margin = rules.height_min_m if sign > 0.0 else -rules.height_max_m
    if not math.isfinite(margin):
        return 0.0
    ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    length = math.sqrt(ex * ex + ey * ey)
    closing = rules.ground_slope + (abs(ez) / length if length > 0.0 else 0.0)
    total = 0.0
    s, before, at = 0.0, np.inf, np.inf  # rooms of the last two samples; the later one at ``here``
    here = 0.0
    while True:
        f = s / length if length > 0.0 else 1.0
        ground = kernels.terrain_height(space.terrain, a[0] + f * ex, a[1] + f * ey)
        room = sign * (a[2] + f * ez - ground) - margin
        if not room > -_HAIR_M:
            return np.inf
        last = s >= length
        for end in range(2 if last else 1):
            # the sample before, once it is known to be the least of its neighbourhood; the last one has no next
            least, place = (at, here) if end == 0 else (room, f)
            lowest = least <= before and least < room if end == 0 else least <= at
            if lowest and least < reach_m:
                if derive:
                    x, y = a[0] + place * ex, a[1] + place * ey
                    h = 0.05
                    t = space.terrain
                    east = kernels.terrain_height(t, x + h, y) - kernels.terrain_height(t, x - h, y)
                    north = kernels.terrain_height(t, x, y + h) - kernels.terrain_height(t, x, y - h)
                    add.normal[0] = -sign * east / (2.0 * h)
                    add.normal[1] = -sign * north / (2.0 * h)
                    add.normal[2] = sign
                    if not math.isfinite(east + north):
                        return np.inf
                total += _barrier(least, reach_m, place, add, derive)
        if last:
            return total
        before, at, here = at, room, f
        stride = STEP_M if room - reach_m <= STEP_M * closing else (room - reach_m) / closing if closing > 0 else length
        s = min(length, s + stride)


@njit(**LEAF)
def _leg_barrier(
    space: SpaceArrays, rules: Rules, a: FloatArray, b: FloatArray, reach_m: float, add: _Sum, derive: bool
) -> float:
    """Return all barriers of the leg a-b; inf if it breaks a rule."""
    ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    across = math.sqrt(ex * ex + ey * ey)
    length = math.sqrt(across * across + ez * ez)
    total: float = 0.0
    for up in range(2):
        slope, rise = (rules.slope_up, ez) if up == 0 else (rules.slope_down, -ez)
        norm = math.sqrt(1.0 + slope * slope)
        if derive and across > 0.0:
            add.normal[0] = slope * ex / (across * norm)
            add.normal[1] = slope * ey / (across * norm)
            add.normal[2] = (-1.0 if up == 0 else 1.0) / norm
        total += _barrier((slope * across - rise) / norm, _SLOPE_REACH * length, -1.0, add, derive)
    add.normal[0] = add.normal[1] = 0.0
    add.normal[2] = -1.0
    total += _barrier(rules.alt_max_m - b[2], reach_m, 1.0, add, derive)
    if not total < np.inf:
        return np.inf
    total += _height_barrier(space, rules, a, b, 1.0, reach_m, add, derive)
    total += _height_barrier(space, rules, a, b, -1.0, reach_m, add, derive)
    if not total < np.inf:
        return np.inf
    here = kernels.inside_distance(space, a[0], a[1], a[2]) - rules.fence_m
    if here - reach_m < length:
        total += _solid_barrier(space, rules, -1, a, b, reach_m, add, derive)
    o = space.obstacles
    low, high = min(a[2], b[2]), max(a[2], b[2])
    near = rules.obstacle_m + reach_m
    for k in range(3):
        add.box[0, k] = min(a[k], b[k])
        add.box[0, 3 + k] = max(a[k], b[k])
    for n in range(kernels.solids_near(o, add.box, near, add.near)):
        i = add.near[0, n]
        if not o.hard[i] or low - o.bound[i, 4] >= near or o.bound[i, 3] - high >= near:
            continue
        wx, wy = o.bound[i, 0] - a[0], o.bound[i, 1] - a[1]
        s = min(1.0, max(0.0, (wx * ex + wy * ey) / (across * across))) if across > 0.0 else 0.0
        wx -= s * ex
        wy -= s * ey
        if wx * wx + wy * wy < (near + o.bound[i, 2]) ** 2:
            total += _solid_barrier(space, rules, i, a, b, reach_m, add, derive)
    return total


@njit(**LEAF)
def _merit(
    space: SpaceArrays, rules: Rules, p: FloatArray, size: int, weight: float, reach_m: float, add: _Sum
) -> float:
    """Return the length of a path with its barriers; inf if it breaks a rule."""
    total = 0.0
    for n in range(size - 1):
        total += _distance(p, n, n + 1) + weight * _leg_barrier(space, rules, p[n], p[n + 1], reach_m, add, False)
        if not total < np.inf:
            break
    return total


@njit(**INNER)
def _derive(
    space: SpaceArrays,
    rules: Rules,
    p: FloatArray,
    size: int,
    weight: float,
    reach_m: float,
    add: _Sum,
    gradient: FloatArray,
    band: FloatArray,
) -> float:
    """Return the merit; write its gradient (3 (size - 2),) and the lower band of its Hessian (6, 3 (size - 2))."""
    count = 3 * (size - 2)
    gradient[:count] = 0.0
    band[:, :count] = 0.0
    total = 0.0
    t = np.empty(3)
    for n in range(size - 1):
        add.gradient[:] = 0.0
        add.hessian[:] = 0.0
        length = max(_distance(p, n, n + 1), 1e-9)
        total += length + weight * _leg_barrier(space, rules, p[n], p[n + 1], reach_m, add, True)
        for k in range(3):
            t[k] = (p[n + 1, k] - p[n, k]) / length
        for i in range(6):
            row = 3 * (n - 1) + i
            if row < 0 or row >= count:
                continue
            gradient[row] += weight * add.gradient[i] + (t[i % 3] if i >= 3 else -t[i % 3])
            for j in range(i + 1):
                col = 3 * (n - 1) + j
                if col < 0:
                    continue
                across = (1.0 if i % 3 == j % 3 else 0.0) - t[i % 3] * t[j % 3]
                same = (i >= 3) == (j >= 3)
                band[row - col, col] += weight * add.hessian[i, j] + (across if same else -across) / length
                if same:
                    band[row - col, col] += _HOLD / length * t[i % 3] * t[j % 3]
    return total


@njit(**LEAF)
def _solve(band: FloatArray, count: int, x: FloatArray) -> bool:
    """Solve in place a symmetric positive definite system of which ``band`` is the lower band; False if it is not."""
    for j in range(count):
        pivot = band[0, j]
        if not pivot > 0.0:
            return False
        pivot = math.sqrt(pivot)
        last = min(_BAND, count - j)
        for k in range(last):
            band[k, j] /= pivot
        for k in range(1, last):
            for m in range(k, last):
                band[m - k, j + k] -= band[m, j] * band[k, j]
    for j in range(count):
        x[j] /= band[0, j]
        for k in range(1, min(_BAND, count - j)):
            x[j + k] -= band[k, j] * x[j]
    for j in range(count - 1, -1, -1):
        for k in range(1, min(_BAND, count - j)):
            x[j] -= band[k, j] * x[j + k]
        x[j] /= band[0, j]
    return True


@njit(**INNER)
def _legs_ok(space: SpaceArrays, rules: Rules, walls: FloatArray, p: FloatArray, size: int) -> bool:
    ok = True
    for n in range(size - 1):
        ok = ok and leg_ok(space, rules, walls, p[n : n + 2], False)
    return ok


@njit(**INNER)
def _descend(
    space: SpaceArrays,
    rules: Rules,
    walls: FloatArray,
    p: FloatArray,
    size: int,
    weight: float,
    settled_m: float,
    add: _Sum,
    gradient: FloatArray,
    band: FloatArray,
    trial: FloatArray,
) -> None:
    """Move the path's inner points by Newton steps to the least length with barriers of this weight."""
    reach_m = min(max(_REACH * weight, _REACH_MIN_M), _REACH_MAX_M)
    count = 3 * (size - 2)
    step = np.empty(count)
    for _ in range(_NEWTON_STEPS):
        merit = _derive(space, rules, p, size, weight, reach_m, add, gradient, band)
        for k in range(count):
            step[k] = -gradient[k]
        if not merit < np.inf or not _solve(band, count, step):
            return
        promised = 0.0
        for k in range(count):
            promised -= gradient[k] * step[k]
        if promised < settled_m:
            return
        farthest = 0.0
        for k in range(count):
            farthest = max(farthest, abs(step[k]))
        share = min(1.0, _FARTHEST * merit / farthest)
        for _ in range(_BACKTRACKS):
            trial[0] = p[0]
            trial[size - 1] = p[size - 1]
            for k in range(count):
                trial[1 + k // 3, k % 3] = p[1 + k // 3, k % 3] + share * step[k]
            now = _merit(space, rules, trial, size, weight, reach_m, add)
            if now <= merit - _ARMIJO * share * promised and _legs_ok(space, rules, walls, trial, size):
                break
            share *= 0.5
        else:
            return
        p[:size] = trial[:size]


@njit(**INNER)
def _cut_corners(
    space: SpaceArrays, rules: Rules, walls: FloatArray, p: FloatArray, size: int, tolerance_m: float
) -> int:
    """Cut every corner where that saves the tolerance and there is room in ``p``; return the path's new size."""
    leg = np.empty((2, 3))
    b = 1
    while b < size - 1 and size < p.shape[0]:
        ab, bc = max(_distance(p, b - 1, b), 1e-9), max(_distance(p, b, b + 1), 1e-9)  # two points may be one
        share = _CUT_FIRST
        for _ in range(_CUT_TRIALS):
            cut_m = share * min(ab, bc)
            for k in range(3):
                leg[0, k] = p[b, k] + (p[b - 1, k] - p[b, k]) * cut_m / ab
                leg[1, k] = p[b, k] + (p[b + 1, k] - p[b, k]) * cut_m / bc
            if 2.0 * cut_m - leg_length(leg) < tolerance_m:
                break
            if leg_ok(space, rules, walls, leg, False):
                for n in range(size, b, -1):
                    p[n] = p[n - 1]
                p[b] = leg[0]
                p[b + 1] = leg[1]
                size += 1
                b += 1
                break
            share *= _CUT_NEXT
        b += 1
    return size


@njit(**INNER)
def _drop_points(space: SpaceArrays, rules: Rules, walls: FloatArray, p: FloatArray, size: int) -> int:
    """Drop every point that a clear leg can skip; return the path's new size."""
    leg = np.empty((2, 3))
    b = 1
    while b < size - 1:
        leg[0] = p[b - 1]
        leg[1] = p[b + 1]
        if leg_ok(space, rules, walls, leg, False):
            for n in range(b, size - 1):
                p[n] = p[n + 1]
            size -= 1
        else:
            b += 1
    return size


@njit(**OUTER)
def tighten(
    space: SpaceArrays,
    rules: Rules,
    walls: FloatArray,
    p: FloatArray,
    size: int,
    tolerance_m: float,
) -> int:
    """Bring the clear path ``p[:size]`` in place to its taut string, rounded until a cut saves less than the tolerance.

    Every leg stays judged by the rules. Rows beyond ``size`` are room for points. Returns the new size.
    """
    rows = 3 * p.shape[0]
    length_m = 0.0
    for n in range(size - 1):
        length_m += _distance(p, n, n + 1)
    gradient, band, trial = np.empty(rows), np.empty((_BAND, rows)), np.empty_like(p)
    box, near = np.empty((1, 6)), np.zeros((2, space.obstacles.kind.shape[0]), dtype=np.int64)
    for n in range(len(_WEIGHTS)):
        weight = _WEIGHTS[n] * length_m
        add = _Sum(np.empty(6), np.empty((6, 6)), np.empty(3), box, near, _SHIFT * weight)
        size = _drop_points(space, rules, walls, p, size)
        size = _cut_corners(space, rules, walls, p, size, tolerance_m)
        if size > 2:
            _descend(space, rules, walls, p, size, weight, _SETTLED * length_m, add, gradient, band, trial)
    final: int = _drop_points(space, rules, walls, p, size)
    return final
