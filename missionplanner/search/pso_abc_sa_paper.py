"""PSO-ABC-SA: a particle swarm in groups of bees with annealing (PAPER.md section 4, eqs 25-33, sound reading).

Every iteration ranks the particles by their best costs and deals them into groups, best first. In each group

* the *leader* (the group's best) flies by (25): drawn to its own best point and to the best point that is not its own;
* *scouts* fly by (30, 31): drawn to the group's and to the swarm's best;
* *employed* bees search around their own best point, *onlookers* around one chosen by fitness (27), both by (24) with
  a pull towards one of the swarm's better points;
* a bee without success for ``patience`` iterations is exhausted and starts anew: a leader within its group's bounds
  (26), any other anywhere in the box (23). The swarm's best is never exhausted.

Then annealing (32, 33): a particle that got worse is kept with probability ``exp(-rise / (T * spread))``. The paper's
T = 10,000 accepts anything; here T falls from 1 and ``spread`` is the swarm's own median deviation of costs, so the
rule means the same for every cost function.

Learning factors (28, 29) without their unbounded growth: with f the cost above the swarm's best, divided by the median
and cut to [0, 1], ``C1 = c exp(1 / (1 + f) - 1)`` lies in [0.60 c, c] and ``C2 = c exp(|f_i - f_k| - 1)`` in
[0.36 c, c]; C2 shrinks as a group converges. With c = 1.5, C1 + C2 <= 3 is inside the swarm's stable range once
inertia is below 0.78; until then the velocity limit bounds the flight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missionplanner.search.base import BoolArray, FloatArray, IntArray
from missionplanner.search.pso import fly

_ELITE_SHARE = 8  # bees are pulled towards the best eighth of the swarm


@dataclass(frozen=True, slots=True)
class PsoAbcSaPaperSettings:
    """The paper's parameters where they are sound, ours where it gives none. Lengths are shares of the box."""

    groups: int = 3
    inertia: float = 0.9
    inertia_decay: float = 0.99
    inertia_min: float = 0.3
    learning: float = 1.5
    velocity_max: float = 0.1
    temperature: float = 1.0
    temperature_decay: float = 0.97
    patience: int = 30
    scout_share: float = 0.5
    bee_dimensions: float = 0.9  # share of coordinates that half of the bees move; the other half move about one


class PsoAbcSaPaper:
    """Groups of leaders, scouts, employed bees and onlookers, annealed."""

    def __init__(
        self,
        initial: FloatArray,
        evaluations: int,
        rng: np.random.Generator,
        settings: PsoAbcSaPaperSettings | None = None,
    ) -> None:
        del evaluations  # the schedule is per iteration, as printed
        self._settings = settings or PsoAbcSaPaperSettings()
        self._rng = rng
        population = len(initial)
        self._position = initial.copy()
        self._velocity = np.zeros_like(initial)
        self._cost = np.full(population, np.inf)
        self._best_position = initial.copy()
        self._best_cost = np.full(population, np.inf)
        self._idle = np.zeros(population, dtype=np.intp)
        self._inertia = self._settings.inertia
        self._temperature = self._settings.temperature
        self._candidate = initial.copy()
        self._first = True

    def ask(self) -> FloatArray:
        """Return one candidate per particle (P, D)."""
        if self._first:
            self._first = False
            return self._candidate
        s, population = self._settings, len(self._position)
        order = np.argsort(self._best_cost, kind="stable")
        rank = np.argsort(order, kind="stable")
        groups = min(s.groups, population)
        group = rank % groups
        leads = rank < groups
        standing = self._standing(order)
        role = self._rng.random(population)
        flies = leads | (role < s.scout_share)
        onlooks = ~flies & (role < 0.5 * (1.0 + s.scout_share))

        flown, velocity = self._flight(order, group, leads, standing)
        self._velocity = np.where(flies[:, None], velocity, self._velocity)
        candidate = np.where(flies[:, None], flown, self._foraging(order, onlooks, standing))
        exhausted = (self._idle > s.patience) & (rank > 0)
        if exhausted.any():
            self._start_anew(candidate, exhausted, leads, group)
        self._candidate = candidate
        return candidate

    def tell(self, cost: FloatArray) -> None:
        """Keep what is better, and some of what is worse (32, 33)."""
        s = self._settings
        known = np.isfinite(self._cost)
        spread = _median(np.abs(self._cost[known] - _median(self._cost[known]))) if known.any() else 0.0
        worse = known & (cost > self._cost)
        likelihood = np.where(worse, 0.0, 1.0)
        if self._temperature * spread > 0.0:
            with np.errstate(over="ignore", under="ignore"):
                likelihood[worse] = np.exp(-(cost[worse] - self._cost[worse]) / (self._temperature * spread))
        kept = self._rng.random(len(cost)) < likelihood
        self._position[kept] = self._candidate[kept]
        self._cost[kept] = cost[kept]
        better = cost < self._best_cost
        self._best_position[better] = self._candidate[better]
        self._best_cost[better] = cost[better]
        self._idle = np.where(better, 0, self._idle + 1)
        self._temperature *= s.temperature_decay
        self._inertia = max(self._inertia * s.inertia_decay, s.inertia_min)

    def _standing(self, order: IntArray) -> FloatArray:
        """Return every particle's cost above the swarm's best, 0 to 1 (the median and worse)."""
        known = np.isfinite(self._best_cost)
        if not known[order[0]]:
            return np.zeros(len(order))
        rise = np.where(known, self._best_cost - self._best_cost[order[0]], 0.0)
        median = _median(rise[known])
        scaled = np.minimum(rise / median, 1.0) if median > 0.0 else np.minimum(rise, 1.0)
        return np.where(known, scaled, 1.0)

    def _flight(
        self, order: IntArray, group: IntArray, leads: BoolArray, standing: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities of particles that fly: leaders by (25), scouts by (30, 31)."""
        s, x, best = self._settings, self._position, self._best_position
        own_leader = order[group]
        first_c = s.learning * np.exp(1.0 / (1.0 + standing) - 1.0)
        second_c = s.learning * np.exp(np.abs(standing - standing[own_leader]) - 1.0)
        runner_up = order[min(1, len(order) - 1)]
        not_own = np.where(own_leader == order[0], runner_up, order[0])
        near = np.where(leads[:, None], best, best[own_leader])
        far = np.where(leads[:, None], best[not_own], best[order[0]])
        r1, r2 = self._rng.random((2, *x.shape))
        velocity = (
            self._inertia * self._velocity + first_c[:, None] * r1 * (near - x) + second_c[:, None] * r2 * (far - x)
        )
        return fly(x, velocity, s.velocity_max)

    def _foraging(self, order: IntArray, onlooks: BoolArray, standing: FloatArray) -> FloatArray:
        """Return one candidate (P, D) per bee: (24) around its source, pulled towards a point of the elite."""
        s, rng, best = self._settings, self._rng, self._best_position
        population, dimensions = best.shape
        share = np.cumsum(1.0 / (1.0 + standing))
        source = np.where(
            onlooks,
            np.minimum(np.searchsorted(share, rng.random(population) * share[-1]), population - 1),
            np.arange(population),
        )
        base = best[source]
        one, other = rng.integers(0, population, (2, population))
        elite = order[rng.integers(0, min(population, max(2, population // _ELITE_SHARE)), population)]
        phi, pull = rng.uniform(-1.0, 1.0, (population, 1)), rng.random((population, 1))
        moved = base + phi * (best[one] - best[other]) + pull * (best[elite] - base)
        likely = np.where(rng.random((population, 1)) < 0.5, s.bee_dimensions, 1.0 / dimensions)
        changes = rng.random((population, dimensions)) < likely
        changes[np.arange(population), rng.integers(0, dimensions, population)] = True
        moved = np.where(changes, moved, base)
        inside = np.clip(moved, 0.0, 1.0)
        # Falling short of the wall instead of sticking to it keeps diversity there.
        return np.where(moved == inside, moved, base + (inside - base) * rng.random(moved.shape))

    def _start_anew(self, candidate: FloatArray, exhausted: BoolArray, leads: BoolArray, group: IntArray) -> None:
        for i in np.flatnonzero(exhausted):
            low, high = np.zeros(candidate.shape[1]), np.ones(candidate.shape[1])
            if leads[i]:
                fellows = self._best_position[group == group[i]]
                low, high = fellows.min(axis=0), fellows.max(axis=0)
            candidate[i] = low + self._rng.random(candidate.shape[1]) * (high - low)
        self._velocity[exhausted] = 0.0
        self._cost[exhausted] = np.inf
        self._best_cost[exhausted] = np.inf
        self._idle[exhausted] = 0


def _median(values: FloatArray) -> float:
    """Return the median (numpy's takes ten times as long for a swarm's few numbers)."""
    ordered = np.sort(values)
    return float(0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2]))
