"""Gold rush optimiser (Zolfi 2023, doi:10.37190/ord230108)."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, Steps
from missionplanner.search.moves import HALF_WIDTH, centred, others, uncentred


def gold_rush(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """GRO: prospectors migrate to the best mine, dig where another digs, or follow the difference of two others.

    As in the paper and its author's code: each third of the time, greedy, coordinates that leave the box stay. The
    best mine is stretched about the origin: the middle of the box here (:func:`centred`).
    """
    population = len(initial)
    prospector = candidate = centred(initial)
    points = initial
    cost = np.full(population, np.inf)
    generations = max(-(-evaluations // population), 2)
    generation = 0
    while True:
        value = yield points
        better = value < cost
        prospector, cost = np.where(better[:, None], candidate, prospector), np.where(better, value, cost)
        generation += 1
        left = max((generations - generation) / (generations - 1), 0.0)
        final = 1.0 / generations
        migration, mining = left * (2.0 - final) + final, left**2 * (2.0 - final) + final
        first, second = others(rng, population, 2)
        r1, r2 = rng.random((2, *prospector.shape))
        best = prospector[np.argmin(cost)]
        migrated = prospector + (1.0 + migration * (r1 - 0.5)) * (2.0 * r2 * best - prospector)
        dug = prospector[first] + mining * (2.0 * r1 - 1.0) * (prospector - prospector[first])
        together = prospector + r1 * (prospector[second] - prospector[first])
        method = rng.random((population, 1))
        candidate = np.where(method < 1.0 / 3.0, together, np.where(method < 2.0 / 3.0, dug, migrated))
        candidate = np.where(np.abs(candidate) > HALF_WIDTH, prospector, candidate)
        points = uncentred(candidate)
