"""Crayfish optimisation (Jia, Rao, Wen & Mirjalili 2023, doi:10.1007/s10462-023-10567-4)."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, Steps
from missionplanner.search.moves import HALF_WIDTH, centred, inside, uncentred

_TOO_BIG = 2.0  # food to be torn up before it is eaten


def crayfish(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """COA: in the heat crayfish go to a cave or compete for it, else they forage, the more the nearer to 25 degrees.

    PAPER.md names no source for its "COA"; of the algorithms with this name (coyote 2018, coati 2023, crayfish 2023)
    it most likely means this one, of the year and journal of the SWO it names beside it. As in its paper and its
    authors' code: greedy; the best food's cost is remembered, not priced again for every crayfish. The size of food is
    the ratio of two costs, so it means what was meant only for positive costs. Foraging shrinks positions towards the
    origin: the middle of the box here (:func:`centred`).
    """
    population = len(initial)
    position = centred(initial)
    cost = (yield initial).copy()
    food, food_cost = position[np.argmin(cost)].copy(), cost.min()
    newest, spent = food, population
    while True:
        moved = _moved(position, cost, food, food_cost, newest, min(spent / evaluations, 1.0), rng)
        value = yield uncentred(moved)
        spent += population
        newest = moved[np.argmin(value)]
        better = value < cost
        position, cost = np.where(better[:, None], moved, position), np.where(better, value, cost)
        if cost.min() < food_cost:
            food, food_cost = position[np.argmin(cost)].copy(), cost.min()


def _moved(
    position: FloatArray,
    cost: FloatArray,
    food: FloatArray,
    food_cost: float,
    newest: FloatArray,
    t: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return where the crayfish go next (eqs 3-14)."""
    population = len(position)
    temperature = 20.0 + 15.0 * rng.random()
    random = rng.random(position.shape)
    if temperature > 30.0:
        cave = 0.5 * (food + newest)
        rival = np.take_along_axis(position, rng.integers(0, population, position.shape), axis=0)
        resting = position + (2.0 - t) * random * (cave - position)
        moved = np.where(rng.random((population, 1)) < 0.5, resting, position - rival + cave)
    else:
        appetite = 0.2 / (np.sqrt(2.0 * np.pi) * 3.0) * np.exp(-((temperature - 25.0) ** 2) / (2.0 * 3.0**2))
        size = 3.0 * rng.random((population, 1)) * (cost / food_cost)[:, None]
        torn = np.exp(-1.0 / size) * food
        turn = 2.0 * np.pi * rng.random((2, *position.shape))
        shredding = position + torn * appetite * (np.cos(turn[0]) - np.sin(turn[1]))
        eating = (position - food) * appetite + appetite * random * position
        moved = np.where(size > _TOO_BIG, shredding, eating)
    return inside(moved, position, HALF_WIDTH)
