"""One search, from a batched cost over a box to its best point."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from missionplanner.errors import MissionError
from missionplanner.search.base import Callback, Cost, FloatArray, SearchResult
from missionplanner.search.registry import find_algorithm


def minimise(
    cost: Cost,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    *,
    algorithm: str = "pso-abc-sa",
    evaluations: int,
    seed: int,
    population: int = 50,
    initial: npt.ArrayLike | None = None,
    target: float | None = None,
    callback: Callback | None = None,
) -> SearchResult:
    """Minimise ``cost`` over the box; the same arguments give the same result, bit for bit.

    Parameters
    ----------
    cost : takes points (P, D), returns their costs (P,). Called once per generation, never for more than
        ``evaluations`` rows in all. A cost of NaN is never the best.
    lower, upper : (D,) the box.
    algorithm : a name of :func:`~missionplanner.search.registry.algorithms`.
    initial : (P0, D) first guesses, clipped to the box; they replace random members of the first population, and at
        most ``population`` of them are used.
    target : stop when the best cost is at or below it.
    callback : called with (evaluations so far, best cost) after every generation; stops the search by returning true.

    Raises
    ------
    MissionError
        An unknown algorithm, a box that is empty or not finite, a budget or population below one, first guesses or
        costs of the wrong shape, a cost that is NaN everywhere.
    """
    make = find_algorithm(algorithm).make
    low, high = _box(lower, upper)
    _at_least_one("evaluations", evaluations)
    _at_least_one("population", population)
    rng = np.random.default_rng(seed)
    span = high - low
    first = rng.random((population, len(low)))
    if initial is not None:
        guesses = _guesses(initial, low, high)[:population]
        first[: len(guesses)] = (guesses - low) / np.where(span > 0.0, span, 1.0)
    optimiser = make(first, math.ceil(evaluations / population), rng)

    history: list[float] = []
    best, best_cost, used, priced = low, math.inf, 0, False
    while used < evaluations:
        points = np.clip(low + optimiser.ask() * span, low, high)[: evaluations - used]
        value = _checked(cost, points)
        used += len(points)
        priced = priced or not np.isnan(value).all()
        value = np.where(np.isnan(value), np.inf, value)
        leader = int(np.argmin(value))
        if value[leader] < best_cost or not history:
            best, best_cost = points[leader].copy(), float(value[leader])
        history.append(best_cost)
        if callback is not None and callback(used, best_cost):
            break
        if target is not None and best_cost <= target:
            break
        if used < evaluations:
            optimiser.tell(value)
    if not priced:
        raise MissionError(f"cost: expected numbers, got only NaN ({used} points)")
    return SearchResult(best, best_cost, np.array(history), used, seed)


def _box(lower: npt.ArrayLike, upper: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    low, high = np.array(lower, dtype=float), np.array(upper, dtype=float)
    if low.ndim != 1 or low.shape != high.shape or not low.size:
        raise MissionError(f"lower, upper: expected two arrays of one shape (D,), got {low.shape} and {high.shape}")
    wrong = np.flatnonzero(~(np.isfinite(low) & np.isfinite(high) & (low <= high)))
    if wrong.size:
        d = int(wrong[0])
        raise MissionError(
            f"lower, upper: expected finite lower <= upper, got {low[d]:g} and {high[d]:g} in dimension {d}"
        )
    return low, high


def _at_least_one(name: str, value: int) -> None:
    if value < 1:
        raise MissionError(f"{name}: expected at least 1, got {value}")


def _guesses(initial: npt.ArrayLike, low: FloatArray, high: FloatArray) -> FloatArray:
    guesses = np.array(initial, dtype=float)
    if guesses.ndim != 2 or guesses.shape[1] != len(low):
        raise MissionError(f"initial: expected shape (P0, D) = (any, {len(low)}), got {guesses.shape}")
    if not np.isfinite(guesses).all():
        raise MissionError("initial: expected finite first guesses, got NaN or infinity")
    clipped: FloatArray = np.clip(guesses, low, high)
    return clipped


def _checked(cost: Cost, points: FloatArray) -> FloatArray:
    value: FloatArray = np.array(cost(points.copy()), dtype=np.float64)
    if value.shape != (len(points),):
        raise MissionError(f"cost: expected shape (P,) = ({len(points)},), got {value.shape}")
    return value
