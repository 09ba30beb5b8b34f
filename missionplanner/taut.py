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
from numba import njit

from missionplanner import kernels
from missionplanner.clearance import STEP_M
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
OUTER: dict[str, Any] = {"cache": True, "no_cfunc_wrapper": True}
INNER: dict[str, Any] = {**OUTER, "no_cpython_wrapper": True}

# --- kernels -------------------------------------------------------------------------------------------------------


@njit(**INNER)
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


@njit(**INNER)
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


@njit(**INNER)
def leg_length(leg: FloatArray) -> float:
    """Return the length of a leg (2, 3)."""
    return math.sqrt((leg[0, 0] - leg[1, 0]) ** 2 + (leg[0, 1] - leg[1, 1]) ** 2 + (leg[0, 2] - leg[1, 2]) ** 2)


@njit(**INNER)
def _distance(p: FloatArray, i: int, j: int) -> float:
    return math.sqrt((p[i, 0] - p[j, 0]) ** 2 + (p[i, 1] - p[j, 1]) ** 2 + (p[i, 2] - p[j, 2]) ** 2)


@njit(**INNER)
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
