"""Simulated annealing (Kirkpatrick, Gelatt & Vecchi 1983, doi:10.1126/science.220.4598.671)."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, Steps
from missionplanner.search.moves import accepted, spread

_HOTTEST = 0.3  # of the spread of the first costs
_COLDEST = 1e-8  # of the first temperature, at the end of the budget
_LIKELY = 0.44  # share of moves to be accepted; steps adapt to it


def simulated_annealing(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """Independent chains, each moving one coordinate at a time by steps that keep about half of its moves accepted.

    Moves and steps after Corana et al. 1987, doi:10.1145/29380.29864, with the steps adapted after every move. Chains
    run side by side, so that one generation is one call of the cost; the temperature falls geometrically over the
    budget, from the scale of the first costs.
    """
    chains, dimensions = initial.shape
    everyone = np.arange(chains)
    position = initial.copy()
    cost = (yield position).copy()
    hottest, spent = _HOTTEST * spread(cost), chains
    step = np.full(initial.shape, 0.5)
    while True:
        column = rng.integers(0, dimensions, chains)
        candidate = position.copy()
        moved = position[everyone, column] + step[everyone, column] * rng.uniform(-1.0, 1.0, chains)
        moved = np.where(moved < 0.0, -moved, moved)  # walls reflect
        candidate[everyone, column] = np.where(moved > 1.0, 2.0 - moved, moved)
        value = yield candidate
        spent += chains
        if hottest == 0.0:
            hottest = _HOTTEST * spread(value)
        kept = accepted(rng, value, cost, hottest * _COLDEST ** min(spent / evaluations, 1.0))
        position[kept], cost[kept] = candidate[kept], value[kept]
        step[everyone, column] *= np.exp(kept - _LIKELY)
        np.clip(step, 1e-12, 1.0, out=step)
