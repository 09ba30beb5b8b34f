"""The gradient polish: a clear curve is drawn to the nearest optimum of the price, with exact derivatives.

What is traded off (length, bending, zones, ...) is minimised by L-BFGS over all control points of the curve at once;
what is forbidden is kept out by an augmented Lagrangian, multipliers one per kind of limit and sample (Nocedal & Wright
2006, algorithms 7.4 and 17.4). The control points are scaled by the curvature of the length and of the bending energy,
which are all but quadratic: without that, ten points close together at a corner would hardly move. A polish never
makes a path dearer, and needs no chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from missionplanner import kernels
from missionplanner.compiled import njit
from missionplanner.cost import Price
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import PriceSettings, SpaceArrays
from missionplanner.price_gradient import FENCE, HIGH, LIMIT_KINDS, LOW, SHARP, SOLID, STEEP, price_slope

_SPARE_M = 0.05
"""How much wider than the limits a polish aims: what is left of a depth at its end is then within them."""
_CLOSE_ENOUGH = 1e-3
"""Depth, as a share of the margin, at which a round's multipliers are final."""
_RIDGE = 0.01
"""Of the mean curvature, added where neither length nor bending has any."""
_NEXT_TO_NOTHING = 1e-12
"""What control points do far away decays without end; denormal numbers would take a hundred times as long."""
_MEMORY = 8
_STRIDE_M = 30.0
"""No step moves any point further: the slope at a limit says nothing of what lies beyond the next obstacle."""
_ARMIJO = 1e-4
_HALVINGS = 12


class PolishSettings(NamedTuple):
    """How hard and how long a polish tries; ``rounds`` 1 is a penalty of fixed weight, without multipliers."""

    rounds: int = 5
    """Of new multipliers, at most."""
    steps: int = 60
    """Of descent in each round, at most."""
    penalty: float = 300.0
    """Of the squared depths, as shares of the margin: stiff enough that few rounds place the path at its margins."""
    settled: float = 1e-5
    """Share of the price that one of two steps must save for a descent to go on."""


FULL = PolishSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Polished:
    """A path (S, 3) no dearer than the one it was polished from, its price, and how often the price was asked for."""

    path_m: FloatArray
    cost: float
    evaluations: int


def polish(price: Price, path_m: FloatArray, freedom: FloatArray, settings: PolishSettings = FULL) -> Polished:
    """Return the path drawn to the optimum of the price that is nearest downhill; at worst the path itself.

    Parameters
    ----------
    path_m : (S, 3)
    freedom : (S, K), the basis in whose span the path may move: ``path_m + freedom @ offsets``.
    """
    path_m = np.ascontiguousarray(path_m)
    before = float(price.total(path_m[np.newaxis])[0])
    if freedom.shape[1] == 0 or not math.isfinite(before):
        return Polished(path_m, before, 1)
    per_metre, per_square = price.weights[[kernels.VOYAGE, kernels.SMOOTH]] / price.settings.route_length_m
    scaled = _scaled(path_m, np.ascontiguousarray(freedom), per_metre, per_square * kernels.BENDING_M**2)
    weights = price.weights.copy()
    weights[kernels.TERRAIN :] = settings.penalty
    weights[kernels.FELLOWS] = price.weights[kernels.FELLOWS]  # smooth already, as a mean over moving vehicles
    found = np.empty((settings.rounds + 1, *path_m.shape))
    found[0] = path_m
    used, made = _augmented(
        price.space, _with_spare(price.settings), price.tower_tops, price.tower_weights, price.fellows, weights,
        _scales(price.settings, len(path_m)), scaled, settings, found,
    )  # fmt: skip
    costs = price.total(found[: made + 1])
    best = int(np.argmin(costs))
    return Polished(found[best], float(costs[best]), used + made + 2)


def _with_spare(q: PriceSettings) -> PriceSettings:
    """Return limits a little tighter."""
    return q._replace(
        height_min_m=q.height_min_m + _SPARE_M,
        height_max_m=q.height_max_m - _SPARE_M,
        alt_max_m=q.alt_max_m - _SPARE_M,
        obstacle_m=q.obstacle_m + _SPARE_M,
        fence_m=q.fence_m + _SPARE_M,
    )


def _scales(q: PriceSettings, samples: int) -> FloatArray:
    """Return the depths (LIMIT_KINDS,) that count as one."""
    scale = np.empty(LIMIT_KINDS)
    scale[LOW] = scale[HIGH] = max(1.0, q.height_min_m)
    scale[SOLID] = max(1.0, q.obstacle_m)
    scale[FENCE] = max(1.0, q.fence_m)
    scale[STEEP] = q.route_length_m / samples
    scale[SHARP] = 1.0
    return scale


@njit(cache=True, error_model="numpy", nogil=True)
def _scaled(path: FloatArray, freedom: FloatArray, per_metre: float, per_bending: float) -> FloatArray:
    """Return the basis (S, K) for which length and bending of the path have a Hessian of about one.

    That Hessian's Cholesky factor divides the basis. Plain loops: they take no threads, and the same way everywhere.
    """
    samples, count = freedom.shape
    basis = freedom.copy()
    hessian = np.zeros((count, count))
    slope, before, bend = np.zeros(count), np.zeros(count), np.zeros(count)
    hop_before = 0.0
    for k in range(samples):
        for n in range(count):
            if abs(basis[k, n]) < _NEXT_TO_NOTHING:
                basis[k, n] = 0.0
        if k == 0:
            continue
        hop = max(1e-3, math.sqrt(((path[k] - path[k - 1]) ** 2).sum()))
        slope[:] = (basis[k] - basis[k - 1]) / hop
        _add_square(hessian, slope, per_metre * hop)
        if k > 1:
            bend[:] = slope - before
            _add_square(hessian, bend, 4.0 * per_bending / (hop_before + hop))
        before[:] = slope
        hop_before = hop
    ridge = _RIDGE * np.trace(hessian) / count + _NEXT_TO_NOTHING
    for n in range(count):
        hessian[n, n] += ridge
        for m in range(n):  # the factor's row n, in place
            hessian[n, m] = (hessian[n, m] - (hessian[n, :m] * hessian[m, :m]).sum()) / hessian[m, m]
        hessian[n, n] = math.sqrt(hessian[n, n] - (hessian[n, :n] ** 2).sum())
    factor = np.ascontiguousarray(hessian.T)
    for k in range(samples):
        for n in range(count):
            basis[k, n] /= factor[n, n]
            if abs(basis[k, n]) < _NEXT_TO_NOTHING:
                basis[k, n] = 0.0
            else:
                for m in range(n + 1, count):
                    basis[k, m] -= factor[n, m] * basis[k, n]
    return basis


@njit(cache=True, error_model="numpy")
def _add_square(matrix: FloatArray, vector: FloatArray, weight: float) -> None:
    """Add the weighted outer product of a vector with itself to the lower half of a matrix."""
    for n in range(vector.shape[0]):
        if vector[n] != 0.0:
            by = weight * vector[n]
            for m in range(n + 1):
                matrix[n, m] += by * vector[m]


@njit(cache=True, error_model="numpy", nogil=True)
def _augmented(
    space: SpaceArrays,
    q: PriceSettings,
    tower_tops: FloatArray,
    tower_weights: FloatArray,
    fellows: FloatArray,
    weights: FloatArray,
    scale: FloatArray,
    basis: FloatArray,
    settings: PolishSettings,
    found: FloatArray,
) -> tuple[int, int]:
    """Write the path after every round to ``found[1:]``; return how often the price was asked for, and the rounds."""
    samples = basis.shape[0]
    across = np.ascontiguousarray(basis.T)
    count = basis.shape[1] * 3
    shift = np.zeros((LIMIT_KINDS, samples))
    worst = np.empty((LIMIT_KINDS, samples))
    terms = np.empty(kernels.PRICE_COLUMNS)
    g = np.empty((samples, 3))
    path = found[0].copy()
    moved = np.empty((3, samples))
    x, trial = np.zeros(count), np.zeros(count)
    slope, ahead = np.empty(count), np.empty(count)
    direction = np.empty(count)
    steps, yields = np.empty((_MEMORY, count)), np.empty((_MEMORY, count))
    rho, alpha = np.empty(_MEMORY), np.empty(_MEMORY)
    used = made = 0
    for round_ in range(settings.rounds):
        _move(found[0], across, x, moved, path)
        value = price_slope(path, space, q, tower_tops, tower_weights, fellows, weights, scale, shift, worst, terms, g)
        used += 1
        _pull(basis, g, slope)
        kept = 0
        stalls = 0
        for _ in range(settings.steps):
            # two loops: the direction that the remembered steps make of the slope
            direction[:] = slope
            for m in range(min(kept, _MEMORY)):
                n = (kept - 1 - m) % _MEMORY
                alpha[n] = rho[n] * np.dot(steps[n], direction)
                direction -= alpha[n] * yields[n]
            if kept > 0:
                n = (kept - 1) % _MEMORY
                direction *= 1.0 / (rho[n] * np.dot(yields[n], yields[n]))
            for m in range(min(kept, _MEMORY) - 1, -1, -1):
                n = (kept - 1 - m) % _MEMORY
                direction += (alpha[n] - rho[n] * np.dot(yields[n], direction)) * steps[n]
            descent = np.dot(direction, slope)
            if not descent > 0.0:
                break
            _move(found[0], across, direction, moved, path)
            share = min(1.0, _STRIDE_M / max(1e-9, np.abs(moved).max()))
            ahead_value = value
            better = False
            for _ in range(_HALVINGS):
                trial[:] = x - share * direction
                _move(found[0], across, trial, moved, path)
                ahead_value = price_slope(
                    path, space, q, tower_tops, tower_weights, fellows, weights, scale, shift, worst, terms, g
                )
                used += 1
                if ahead_value <= value - _ARMIJO * share * descent:
                    better = True
                    break
                share *= 0.5 if share > 0.1 else 0.2
            if not better:
                break
            _pull(basis, g, ahead)
            n = kept % _MEMORY
            steps[n] = trial - x
            yields[n] = ahead - slope
            curvature = np.dot(steps[n], yields[n])
            if curvature > 1e-10 * np.dot(steps[n], steps[n]):
                rho[n] = 1.0 / curvature
                kept += 1
            stalls = stalls + 1 if value - ahead_value < settings.settled * abs(value) else 0
            x[:] = trial
            slope[:] = ahead
            value = ahead_value
            if stalls >= 2:
                break
        _move(found[0], across, x, moved, path)
        price_slope(path, space, q, tower_tops, tower_weights, fellows, weights, scale, shift, worst, terms, g)
        used += 1
        made = round_ + 1
        found[made] = path
        deepest = 0.0
        for kind in range(LIMIT_KINDS):
            for k in range(samples):
                deepest = max(deepest, worst[kind, k] / scale[kind])
                shift[kind, k] = max(0.0, shift[kind, k] + worst[kind, k])
        if deepest <= _CLOSE_ENOUGH:
            break
    return used, made


@njit(cache=True, error_model="numpy")
def _move(start: FloatArray, across: FloatArray, x: FloatArray, moved: FloatArray, path: FloatArray) -> None:
    """Write the path whose offsets are ``x`` (3 K,): x of all control points, then y, then z."""
    count = across.shape[0]
    moved[:] = 0.0
    for n in range(count):
        for axis in range(3):
            by = x[axis * count + n]
            for k in range(path.shape[0]):
                moved[axis, k] += by * across[n, k]
    for k in range(path.shape[0]):
        for axis in range(3):
            path[k, axis] = start[k, axis] + moved[axis, k]


@njit(cache=True, error_model="numpy")
def _pull(basis: FloatArray, g: FloatArray, slope: FloatArray) -> None:
    """Write the derivatives (3 K,) by the offsets: the adjoint of :func:`_move`."""
    count = basis.shape[1]
    slope[:] = 0.0
    for k in range(basis.shape[0]):
        for axis in range(3):
            by = g[k, axis]
            for n in range(count):
                slope[axis * count + n] += by * basis[k, n]
