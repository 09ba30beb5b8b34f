"""What several optimisers share: choices, acceptance, and coordinates."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import BoolArray, FloatArray, IntArray

HALF_WIDTH = 100.0
_LEVY_SIGMA = 0.6965745025576968  # Mantegna's for an exponent of 1.5


def centred(unit: FloatArray) -> FloatArray:
    """Return points of the unit box in [-100, 100]^D.

    Some algorithms multiply positions, so they depend on where the origin lies, and a few on the unit. Their papers
    test them on boxes around the origin, [-100, 100]^D more than any other: there they are what was published.
    """
    return (2.0 * unit - 1.0) * HALF_WIDTH


def uncentred(position: FloatArray) -> FloatArray:
    """Return points of [-100, 100]^D in the unit box; :func:`centred` undone."""
    inside: FloatArray = np.clip(0.5 * (position / HALF_WIDTH + 1.0), 0.0, 1.0)
    return inside


def inside(moved: FloatArray, home: FloatArray, half_width: float | None = None) -> FloatArray:
    """Return ``moved`` stopped at the walls of the unit box (or of the centred one); NaN becomes ``home``."""
    low, high = (0.0, 1.0) if half_width is None else (-half_width, half_width)
    stopped: FloatArray = np.clip(np.where(np.isnan(moved), home, moved), low, high)
    return stopped


def others(rng: np.random.Generator, population: int, count: int) -> IntArray:
    """Return ``count`` members (count, P) for each member: not itself and all different, if there are enough."""
    picked: list[IntArray] = []
    for k in range(count):
        step = rng.integers(1, max(population - k, 2), population)
        for earlier in np.sort(picked, axis=0):
            step += step >= earlier
        picked.append(step)
    chosen: IntArray = (np.arange(population) + np.array(picked)) % population
    return chosen


def fitness(cost: FloatArray) -> FloatArray:
    """Return the bees' fitness (PAPER.md eq. 27), more is better; 0 without a price."""
    value: FloatArray = np.where(cost >= 0.0, 1.0 / (1.0 + np.abs(cost)), 1.0 + np.abs(cost))
    return value


def roulette(rng: np.random.Generator, weight: FloatArray, count: int) -> IntArray:
    """Return ``count`` members, each chosen with a probability proportional to its weight."""
    heaviest = weight.max()
    share = np.cumsum(weight / heaviest if 0.0 < heaviest < np.inf else np.ones(len(weight)))
    chosen: IntArray = np.searchsorted(share, rng.random(count) * share[-1], side="right")
    return np.minimum(chosen, len(weight) - 1)


def tournament(rng: np.random.Generator, cost: FloatArray, count: int) -> IntArray:
    """Return the winners (count,) of tournaments of two."""
    one, other = rng.integers(0, len(cost), (2, count))
    winner: IntArray = np.where(cost[one] <= cost[other], one, other)
    return winner


def accepted(rng: np.random.Generator, new: FloatArray, old: FloatArray, temperature: float) -> BoolArray:
    """Return which new costs are kept: all that are no worse, others by the Metropolis rule (PAPER.md eqs 32, 33)."""
    rise = np.zeros(len(new))
    np.subtract(new, old, out=rise, where=new > old)
    draw = rng.random(len(new))
    if not temperature > 0.0:
        kept: BoolArray = rise == 0.0
    else:
        kept = draw < np.exp(-rise / temperature)
    return kept


def spread(cost: FloatArray) -> float:
    """Return the median deviation from the median of the costs that are finite: the scale of a temperature."""
    known = cost[np.isfinite(cost)]
    return median(np.abs(known - median(known))) if len(known) else 0.0


def median(values: FloatArray) -> float:
    """Return the median (numpy's takes ten times as long for a swarm's few numbers)."""
    ordered = np.sort(values)
    return float(0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]))


def levy(rng: np.random.Generator, shape: tuple[int, ...]) -> FloatArray:
    """Return Levy steps of exponent 1.5 (Mantegna 1994, doi:10.1103/PhysRevE.49.4677)."""
    length = np.abs(rng.standard_normal(shape)) ** (1.0 / 1.5)
    return rng.standard_normal(shape) * _LEVY_SIGMA / np.maximum(length, 1e-300)
