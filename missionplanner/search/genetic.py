"""A genetic algorithm for real numbers (Deb & Agrawal 1995, Complex Systems 9; Holland 1975 for the idea)."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, Steps
from missionplanner.search.moves import tournament

_CROSSING = 0.9  # share of pairs that cross, Deb's
_CROSSING_INDEX = 15.0  # larger: children nearer to their parents
_MUTATION_INDEX = 20.0


def genetic_algorithm(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """GA: tournaments of two, simulated binary crossover, polynomial mutation; the best of both generations live on.

    The (P + P) survival is Deb's too (NSGA-II, doi:10.1109/4235.996017).
    """
    del evaluations
    population = len(initial)
    position = initial.copy()
    cost = (yield position).copy()
    while True:
        children = offspring(position, cost, population, rng)
        value = yield children
        position, cost = np.concatenate([position, children]), np.concatenate([cost, value])
        best = np.argsort(cost, kind="stable")[:population]
        position, cost = position[best], cost[best]


def offspring(position: FloatArray, cost: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Return ``count`` children (count, D) of parents that won tournaments."""
    pairs = (count + 1) // 2
    mother, father = position[tournament(rng, cost, 2 * pairs)].reshape(2, pairs, -1)
    return _mutated(_crossed(mother, father, rng)[:count], rng)


def _crossed(mother: FloatArray, father: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return two children per pair, spread around their parents as bits crossed at one place would be."""
    u, coordinate, pair = rng.random(mother.shape), rng.random(mother.shape), rng.random((len(mother), 1))
    power = 1.0 / (_CROSSING_INDEX + 1.0)
    spread = np.where(u <= 0.5, (2.0 * u) ** power, (0.5 / np.maximum(1.0 - u, 1e-16)) ** power)
    spread = np.where((coordinate < 0.5) & (pair < _CROSSING), spread, 1.0)
    swapped = rng.random(mother.shape) < 0.5
    first, second = np.where(swapped, father, mother), np.where(swapped, mother, father)
    near = 0.5 * ((1.0 + spread) * first + (1.0 - spread) * second)
    far = 0.5 * ((1.0 - spread) * first + (1.0 + spread) * second)
    children: FloatArray = np.clip(np.concatenate([near, far]), 0.0, 1.0)
    return children


def _mutated(child: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the children with one coordinate in D moved, mostly by little."""
    u = rng.random(child.shape)
    power = 1.0 / (_MUTATION_INDEX + 1.0)
    shift = np.where(u < 0.5, (2.0 * u) ** power - 1.0, 1.0 - (2.0 * (1.0 - u)) ** power)
    moved = rng.random(child.shape) < 1.0 / child.shape[1]
    mutated: FloatArray = np.clip(np.where(moved, child + shift, child), 0.0, 1.0)
    return mutated
