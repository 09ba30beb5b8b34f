"""African vultures optimisation (Abdollahzadeh, Gharehchopogh & Mirjalili 2021, doi:10.1016/j.cie.2021.107408)."""

from __future__ import annotations

import numpy as np

from missionplanner.search.base import FloatArray, Steps
from missionplanner.search.moves import HALF_WIDTH, centred, inside, levy, uncentred

_EXPLORE, _SIEGE, _FIGHT = 0.6, 0.4, 0.6  # p1, p2, p3 of the paper
_FIRST = 0.8  # how often the best vulture leads; else the second
_GAMMA = 2.5


def vultures(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """AVOA: vultures sated explore, hungry ones circle and fight around the two best points found.

    As in the paper and its authors' code. Some of its equations multiply positions with each other: it depends on the
    origin and on the unit, and lives in [-100, 100]^D here (:func:`centred`). That flatters it where the optimum is in
    the middle of the box, as in its own tests.
    """
    vulture, points = centred(initial), initial
    population = len(vulture)
    leader, leader_cost = vulture[:0], np.empty(0)
    spent = 0
    while True:
        cost = yield points
        known, known_cost = np.concatenate([leader, vulture]), np.concatenate([leader_cost, cost])
        order = np.argsort(known_cost, kind="stable")
        second = order[np.argmax(known_cost[order] > known_cost[order[0]])]  # of the same cost: none; then the best
        leader, leader_cost = known[[order[0], second]], known_cost[[order[0], second]]

        t = min(spent / evaluations, 1.0)
        spent += population
        disturbed = rng.uniform(-2.0, 2.0) * (np.sin(0.5 * np.pi * t) ** _GAMMA + np.cos(0.5 * np.pi * t) - 1.0)
        hunger = (2.0 * rng.random() + 1.0) * (1.0 - t) + disturbed
        f = hunger * rng.uniform(-1.0, 1.0, (population, 1))
        choice, r1, r2 = rng.random((3, population, 1))
        lead = leader[(rng.random(population) >= _FIRST).astype(int)]
        distance = np.abs(2.0 * r1 * lead - vulture)

        explored = np.where(
            choice < _EXPLORE,
            lead - distance * f,
            lead - f + r1 * (2.0 * HALF_WIDTH * r2 - HALF_WIDTH),
        )
        turned = lead * r1 * vulture / (2.0 * np.pi) * np.cos(vulture)
        turned += lead * r2 * vulture / (2.0 * np.pi) * np.sin(vulture)
        fought = np.where(choice < _FIGHT, distance * (f + r2) - (lead - vulture), lead - turned)
        gathered = (leader[:, None] - leader[:, None] * vulture / (leader[:, None] - vulture**2) * f).mean(axis=0)
        besieged = np.where(choice < _SIEGE, gathered, lead - np.abs(lead - vulture) * f * levy(rng, vulture.shape))

        moved = np.where(np.abs(f) >= 1.0, explored, np.where(np.abs(f) >= 0.5, fought, besieged))
        vulture = inside(moved, lead, HALF_WIDTH)
        points = uncentred(vulture)
