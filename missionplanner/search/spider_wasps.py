"""Spider wasp optimiser (Abdel-Basset, Mohamed, Jameel & Abouhawwash 2023, doi:10.1007/s10462-023-10446-y)."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, Steps
from missionplanner.search.moves import HALF_WIDTH, centred, levy, uncentred

_HUNTING = 0.3  # share of generations that hunt; the others mate
_CROSSOVER = 0.2
_FEWEST = 20  # wasps at the end of the budget


def spider_wasps(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """SWO: a generation hunts (searches, follows, flees, nests) or mates; the colony shrinks to twenty wasps.

    As in the paper and its authors' code: greedy, coordinates that leave the box are drawn anew. Departure: a whole
    generation is priced at once, so it sees the points of the one before. Prey is stretched about the origin: the
    middle of the box here (:func:`centred`).
    """
    most = len(initial)
    fewest = min(_FEWEST, most)
    wasp = centred(initial)
    cost = (yield initial).copy()
    best, best_cost = wasp[np.argmin(cost)].copy(), cost.min()
    spent = most
    while True:
        t = min(spent / evaluations, 1.0)
        moved = _hunted(wasp, best, t, rng) if rng.random() < _HUNTING else _mated(wasp, cost, t, rng)
        outside = ~(np.abs(moved) <= HALF_WIDTH)
        moved = np.where(outside, rng.uniform(-HALF_WIDTH, HALF_WIDTH, moved.shape), moved)
        value = yield uncentred(moved)
        spent += len(moved)
        better = value < cost
        wasp, cost = np.where(better[:, None], moved, wasp), np.where(better, value, cost)
        if cost.min() < best_cost:
            best, best_cost = wasp[np.argmin(cost)].copy(), cost.min()
        size = min(int(fewest + (most - fewest) * max(1.0 - spent / evaluations, 0.0)), len(wasp))
        wasp, cost = wasp[:size], cost[:size]


def _hunted(wasp: FloatArray, best: FloatArray, t: float, rng: np.random.Generator) -> FloatArray:
    """Return where the wasps hunt (eqs 4-17): the first of them explore, fewer and fewer, the others go to the best."""
    size = len(wasp)
    shuffled = rng.permutation(size)
    one, two, three = (wasp[shuffled[k % size]] for k in range(3))
    r1, r2, r3, p, normal = rng.random((5, size, 1))
    normal = rng.standard_normal((size, 1))
    angle = 1.0 - (2.0 + t) * rng.random((size, 1))
    cosine = np.cos(2.0 * np.pi * angle)
    free = rng.random(wasp.shape)

    searched = np.where(
        r1 < r2,
        wasp + np.abs(normal) * r1 * (one - two),
        wasp[shuffled] + cosine / (1.0 + np.exp(angle)) * (2.0 * free - 1.0) * HALF_WIDTH,
    )
    chased = np.where(
        r1 < r2,
        wasp + 2.0 * (1.0 - t) * (2.0 * r1 - 1.0) * np.abs(2.0 * free * three - wasp),
        wasp * (1.0 - t) * (2.0 * free - 1.0),
    )
    crossed = rng.random(wasp.shape) > rng.random(wasp.shape)
    nested = np.where(
        r1 < r2,
        best + cosine * (best - wasp),
        one + r3 * np.abs(0.05 * levy(rng, (size, 1))) * (one - wasp) + (1.0 - r3) * crossed * (three - two),
    )
    exploring = np.arange(1, size + 1)[:, None] < (1.0 - t) * size
    return np.where(exploring, np.where(p < 1.0 - t, searched, chased), nested)


def _mated(wasp: FloatArray, cost: FloatArray, t: float, rng: np.random.Generator) -> FloatArray:
    """Return the wasps' young (eqs 21-24): a coordinate in five from a male that steps along two descents."""
    size = len(wasp)
    shuffled = rng.permutation(size)
    one, two, three = (shuffled[k % size] for k in range(3))
    first = np.where((cost[one] < cost)[:, None], wasp[one] - wasp, wasp - wasp[one])
    second = wasp[two] - wasp[three] if cost[two] < cost[three] else wasp[three] - wasp[two]
    weight = np.exp(1.0 - (2.0 + t) * rng.random((size, 1)))
    normal = np.abs(rng.standard_normal((2, size, 1)))
    male = wasp + weight * normal[0] * first + (1.0 - weight) * normal[1] * second
    return np.where(rng.random(wasp.shape) < _CROSSOVER, male, wasp)
