"""Grey wolf optimiser (Mirjalili, Mirjalili & Lewis 2014, doi:10.1016/j.advengsoft.2013.12.007)."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, Steps
from missionplanner.search.moves import centred, uncentred


def grey_wolves(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """GWO: every wolf moves to the mean of three places around the three best points found, ever nearer to them.

    As published: wolves always move; ``a`` falls from 2 to 0 over the budget. Distances are to a leader stretched by a
    random factor about the origin, which is the middle of the box here (:func:`centred`).
    """
    wolf, points = centred(initial), initial
    population = len(wolf)
    leader, leader_cost = wolf[:0], np.empty(0)
    spent = 0
    while True:
        cost = yield points
        spent += population
        known, known_cost = np.concatenate([leader, wolf]), np.concatenate([leader_cost, cost])
        best = np.argsort(known_cost, kind="stable")[:3]
        leader, leader_cost = known[best], known_cost[best]
        a = 2.0 * (1.0 - min(spent / evaluations, 1.0))
        near, stretch = rng.random((2, len(leader), *wolf.shape))
        lead = leader[:, None, :]
        wolf = (lead - a * (2.0 * near - 1.0) * np.abs(2.0 * stretch * lead - wolf)).mean(axis=0)
        points = uncentred(wolf)
        wolf = centred(points)
