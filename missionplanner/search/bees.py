"""Artificial bee colony (Karaboga & Basturk 2007, doi:10.1007/s10898-007-9149-x), and with annealing."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, IntArray, Steps
from missionplanner.search.moves import accepted, fitness, roulette, spread


def bee_colony(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """ABC: an employed bee per food source changes one coordinate; as many onlookers follow by fitness (27).

    As published, a source without success in P D trials is left, one per cycle at most. Departures: all onlookers
    choose before any of them is priced (one call of the cost); a scout's new source is priced in the place of its
    employed bee.
    """
    del evaluations
    return _colony(initial, rng, None)


def annealed_bee_colony(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """ABC-SA: the colony with the Metropolis rule in the place of greed.

    The acceptance rule of Yurtkuran & Emel 2016, doi:10.1155/2016/8085953, without their three search equations. The
    temperature falls from a tenth of the spread of the sources' costs to nothing over the budget.
    """
    return _colony(initial, rng, evaluations)


_HOT = 0.1  # of the spread of costs


def _colony(source: FloatArray, rng: np.random.Generator, annealing: int | None) -> Steps:
    population, dimensions = source.shape
    source = source.copy()
    cost = (yield source).copy()
    spent = population
    trials = np.zeros(population, dtype=np.intp)
    limit = population * dimensions
    everyone = np.arange(population)
    while True:
        for employed in (True, False):
            bee = everyone if employed else roulette(rng, fitness(cost), population)
            candidate = _near(source, bee, rng)
            scout = int(np.argmax(trials)) if employed else -1
            scouting = employed and bool(trials[scout] > limit)
            if scouting:
                candidate[scout] = rng.random(dimensions)
            value = yield candidate
            spent += population
            temperature = _HOT * spread(cost) * max(1.0 - spent / annealing, 0.0) if annealing else 0.0
            kept = accepted(rng, value, cost[bee], temperature)
            improved = value < cost[bee]
            if scouting:
                kept[scout] = improved[scout] = True
            np.add.at(trials, bee, 1)
            trials[bee[improved]] = 0
            # Of several bees at one source the best comes last, and stays.
            last = np.argsort(-value, kind="stable")
            last = last[kept[last]]
            source[bee[last]] = candidate[last]
            cost[bee[last]] = value[last]


def _near(source: FloatArray, bee: IntArray, rng: np.random.Generator) -> FloatArray:
    """Return a candidate (P, D) per bee: its source with one coordinate moved along a neighbour's (24)."""
    population, dimensions = source.shape
    candidate = source[bee]
    column = rng.integers(0, dimensions, population)
    neighbour = (bee + rng.integers(1, max(population, 2), population)) % population
    here = source[bee, column]
    moved = here + rng.uniform(-1.0, 1.0, population) * (here - source[neighbour, column])
    candidate[np.arange(population), column] = np.clip(moved, 0.0, 1.0)
    return candidate
