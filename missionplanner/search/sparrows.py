"""Sparrow search (Xue & Shen 2020, doi:10.1080/21642583.2019.1708830)."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, IntArray, Steps
from missionplanner.search.moves import HALF_WIDTH, centred, inside, uncentred

_SAFETY = 0.8
_PRODUCERS = 0.2  # share of the flock
_AWARE = 0.1  # share that perceives danger


def sparrows(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """SSA: the best fifth forages, the others follow it or starve and fly off, a tenth flees from danger.

    As in the paper and its authors' code, in three phases priced one after the other, each sparrow keeping its best
    point. Positions shrink towards the origin: the middle of the box here (:func:`centred`).
    """
    population, dimensions = initial.shape
    best = centred(initial)
    cost = (yield initial).copy()
    producers = max(round(_PRODUCERS * population), 1)
    aware = max(round(_AWARE * population), 1)
    generations = max(evaluations // (population + aware), 1)  # a generation prices the aware twice
    number = np.arange(1.0, population + 1.0)[:, None]
    while True:
        order = np.argsort(cost, kind="stable")
        best, cost = best[order], cost[order]
        worst, worst_cost = best[-1].copy(), cost[-1]

        forager = best[:producers]
        if rng.random() < _SAFETY:
            moved = forager * np.exp(
                -number[:producers] / (np.maximum(rng.random((producers, 1)), 1e-16) * generations)
            )
        else:
            moved = forager + rng.standard_normal((producers, 1))
        moved = inside(moved, forager, HALF_WIDTH)
        value = yield uncentred(moved)
        _keep(best, cost, np.arange(producers), moved, value)
        leader = moved[np.argmin(value)]

        follower, rank = best[producers:], number[producers:]
        if len(follower):
            signs = np.where(rng.random(follower.shape) < 0.5, -1.0, 1.0)
            near = leader + (np.abs(follower - leader) * signs).mean(axis=1, keepdims=True)
            away = rng.standard_normal((len(follower), 1)) * np.exp((worst - follower) / rank**2)
            moved = inside(np.where(rank > population / 2.0, away, near), follower, HALF_WIDTH)
            _keep(best, cost, np.arange(producers, population), moved, (yield uncentred(moved)))

        who = rng.permutation(population)[:aware]
        top = int(np.argmin(cost))
        scared = best[who]
        at_edge = (cost[who] > cost[top])[:, None]
        joining = best[top] + rng.standard_normal((aware, dimensions)) * np.abs(scared - best[top])
        fear = rng.uniform(-1.0, 1.0, (aware, 1)) / ((cost[who] - worst_cost)[:, None] + 1e-50)
        fleeing = scared + fear * np.abs(scared - worst)
        moved = inside(np.where(at_edge, joining, fleeing), scared, HALF_WIDTH)
        _keep(best, cost, who, moved, (yield uncentred(moved)))


def _keep(best: FloatArray, cost: FloatArray, who: IntArray, moved: FloatArray, value: FloatArray) -> None:
    better = value < cost[who]
    best[who[better]] = moved[better]
    cost[who[better]] = value[better]
