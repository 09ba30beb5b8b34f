"""Particle swarms crossed with annealing and with genes."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, Steps
from missionplanner.search.genetic import offspring
from missionplanner.search.moves import accepted, spread
from missionplanner.search.pso import Swarm


def annealed_swarm(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """PSO-SA: a particle that got worse flies on from its new place or returns, by the Metropolis rule.

    Shieh, Kuo & Chiang 2011, doi:10.1016/j.amc.2011.10.012. The temperature falls geometrically over the budget, from
    the spread of the first costs to a ten-thousandth of it; theirs is fixed, and means another thing for every cost.
    """
    swarm = Swarm(initial)
    cost = (yield initial).copy()
    swarm.remember(swarm.position, cost)
    hottest, spent = spread(cost), len(initial)
    while True:
        candidate, velocity = swarm.flown(rng)
        value = yield candidate
        spent += len(candidate)
        if hottest == 0.0:
            hottest = spread(value)
        kept = accepted(rng, value, cost, hottest * 1e-4 ** min(spent / evaluations, 1.0))
        swarm.position = np.where(kept[:, None], candidate, swarm.position)
        swarm.velocity = velocity
        cost = np.where(kept, value, cost)
        swarm.remember(candidate, value)


def genetic_swarm(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """PSO-GA: the better half flies as a swarm; then its offspring replace the worse half.

    Juang 2004 (HGAPSO), doi:10.1109/TSMCB.2003.818557, with the crossover and mutation of our genetic algorithm.
    Halves and parents go by the best points remembered, so the leader is never replaced.
    """
    del evaluations
    population = len(initial)
    swarm = Swarm(initial)
    swarm.remember(swarm.position, (yield initial))
    while True:
        order = np.argsort(swarm.best_cost, kind="stable")
        elite, rest = np.split(order, [(population + 1) // 2])
        flown, velocity = swarm.flown(rng)
        swarm.position[elite], swarm.velocity[elite] = flown[elite], velocity[elite]
        value = np.full(population, np.inf)
        value[elite] = yield swarm.position[elite]
        swarm.remember(swarm.position, value)
        if len(rest):
            children = offspring(swarm.best_position[elite], swarm.best_cost[elite], len(rest), rng)
            swarm.position[rest], swarm.velocity[rest] = children, 0.0
            swarm.best_position[rest], swarm.best_cost[rest] = children, (yield children)
