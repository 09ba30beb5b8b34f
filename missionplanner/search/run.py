"""One search, from a batched cost over a box to its best point."""

from __future__ import annotations

import math
import numbers
import time
from collections.abc import Callable

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
    population: int | None = None,
    initial: npt.ArrayLike | None = None,
    iterations: int | None = None,
    seconds: float | None = None,
    target: float | None = None,
    callback: Callback | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> SearchResult:
    """Minimise ``cost`` over the box; the same arguments give the same result, bit for bit, unless time ends it.

    Parameters
    ----------
    cost : takes points (P, D), returns their costs (P,). Called once per generation, never for more than
        ``evaluations`` rows in all. A cost of NaN is never the best; infinity marks a point out of the question.
    lower, upper : (D,) the box.
    algorithm : a name of :func:`~missionplanner.search.registry.algorithms`.
    population : size of the first population; None leaves it to the algorithm.
    initial : (P0, D) first guesses, clipped to the box; they replace random members of the first population, and at
        most ``population`` of them are used.
    iterations : stop after so many calls of ``cost``. An algorithm in phases (bees, sparrows) calls it more than once
        in what its paper counts as one iteration.
    seconds : stop at the end of the generation in which ``clock`` has advanced so far.
    target : stop when the best cost is at or below it.
    callback : called with (evaluations so far, best cost) after every call of ``cost``; stops the search by returning
        true.

    Raises
    ------
    MissionError
        An unknown algorithm, a box that is empty or not finite, a budget or population below one, first guesses or
        costs of the wrong shape, a cost that is NaN everywhere; anything of the wrong kind.
    """
    began = clock()
    chosen = find_algorithm(algorithm)
    _function("cost", cost)
    if callback is not None:
        _function("callback", callback)
    least = -math.inf if target is None else _number("target", target)
    if math.isnan(least):
        raise MissionError("target: expected a number, got nan")
    low, high = _box(lower, upper)
    _at_least("evaluations", evaluations, 1)
    _at_least("seed", seed, 0)
    if population is None:
        population = chosen.population(len(low), evaluations)
    _at_least("population", population, 1)
    if iterations is not None:
        _at_least("iterations", iterations, 1)
    if seconds is not None and not _number("seconds", seconds) > 0.0:
        raise MissionError(f"seconds: expected above 0, got {seconds:g}")
    rng = np.random.default_rng(seed)
    span = high - low
    try:
        first = rng.random((population, len(low)))
    except (MemoryError, ValueError) as error:  # numpy has two words for it
        raise MissionError(f"population: expected one that fits into memory, got {population}") from error
    if initial is not None:
        guesses = _guesses(initial, low, high)[:population]
        first[: len(guesses)] = (guesses - low) / np.where(span > 0.0, span, 1.0)
    planned = evaluations if iterations is None else min(evaluations, iterations * population)
    optimiser = chosen.make(first, planned, rng)

    history: list[float] = []
    history_evaluations: list[int] = []
    best, best_cost, used, priced = low, math.inf, 0, False
    while used < evaluations:
        with np.errstate(all="ignore"):  # costs near the largest float overflow to infinity, as they should
            points = np.clip(low + optimiser.ask() * span, low, high)[: evaluations - used]
        value = _checked(cost, points)
        used += len(points)
        number = ~np.isnan(value)
        priced = priced or bool(number.any())
        value = np.where(number, value, np.inf)
        leader = int(np.argmin(value))
        if value[leader] < best_cost or not history:
            best, best_cost = points[leader].copy(), float(value[leader])
        history.append(best_cost)
        history_evaluations.append(used)
        if callback is not None and callback(used, best_cost):
            break
        if best_cost <= least or len(history) == iterations or (seconds is not None and clock() - began >= seconds):
            break
        if used < evaluations:
            with np.errstate(all="ignore"):
                optimiser.tell(value)
    if not priced:
        raise MissionError(f"cost: expected numbers, got only NaN ({used} points)")
    return SearchResult(
        best, best_cost, np.array(history), np.array(history_evaluations, dtype=np.intp), used, int(seed)
    )


def _box(lower: npt.ArrayLike, upper: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    low, high = _numbers("lower", lower), _numbers("upper", upper)
    if low.ndim != 1 or low.shape != high.shape or not low.size:
        raise MissionError(f"lower, upper: expected two arrays of one shape (D,), got {low.shape} and {high.shape}")
    with np.errstate(over="ignore", invalid="ignore"):
        wrong = np.flatnonzero(~(np.isfinite(high - low) & (low <= high)))
    if wrong.size:
        d = int(wrong[0])
        raise MissionError(
            f"lower, upper: expected finite lower <= upper, got {low[d]:g} and {high[d]:g} in dimension {d}"
        )
    return low, high


def _at_least(name: str, value: int, least: int) -> None:
    if not isinstance(value, numbers.Integral) or isinstance(value, bool):
        raise MissionError(f"{name}: expected a whole number of at least {least}, got {value!r}")
    if value < least:
        raise MissionError(f"{name}: expected at least {least}, got {value}")


def _number(name: str, value: float) -> float:
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        raise MissionError(f"{name}: expected a number, got {value!r}")
    return float(value)


def _function(name: str, value: object) -> None:
    if not callable(value):
        raise MissionError(f"{name}: expected a function, got {value!r}")


def _guesses(initial: npt.ArrayLike, low: FloatArray, high: FloatArray) -> FloatArray:
    guesses = _numbers("initial", initial)
    if guesses.ndim != 2 or guesses.shape[1] != len(low):
        raise MissionError(f"initial: expected shape (P0, D) = (any, {len(low)}), got {guesses.shape}")
    if not np.isfinite(guesses).all():
        raise MissionError("initial: expected finite first guesses, got NaN or infinity")
    clipped: FloatArray = np.clip(guesses, low, high)
    return clipped


def _numbers(name: str, values: npt.ArrayLike) -> FloatArray:
    try:
        if np.iscomplexobj(values):
            raise TypeError("they are complex")  # numpy would drop half of them
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise MissionError(f"{name}: expected an array of numbers ({error})") from error


def _checked(cost: Cost, points: FloatArray) -> FloatArray:
    value = _numbers("cost", cost(points.copy()))
    if value.shape != (len(points),):
        raise MissionError(f"cost: expected shape (P,) = ({len(points)},), got {value.shape}")
    return value
