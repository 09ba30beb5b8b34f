"""PSO-ABC-SA as the paper has it: a swarm in groups of bees with annealing (PAPER.md section 4, eqs 25-33).

Every iteration ranks the particles by their best costs and deals them into three groups, best first. In each group

* the *leader* (the group's best) flies by (25): drawn to its own best point and to the best point that is not its own;
* *scouts* fly by (30, 31): drawn to the group's and to the swarm's best;
* *employed* bees search around where they are, *onlookers* around the best point of a particle chosen by fitness (27),
  both by (24); what an onlooker finds better becomes the best point of the particle it followed, as in a bee colony;
* a bee without success for ``patience`` iterations is exhausted and starts anew: a leader within its group's bounds
  (26), any other anywhere in the box (23). The swarm's best is never exhausted.

Then annealing (32, 33): a particle that got worse stays there or returns, by the Metropolis rule.

Parameters are the paper's: 50 particles, 3 groups, inertia 0.9 decaying by 0.99, c = 1.5, temperature decaying by 0.99.
What it leaves open, or what is broken as printed, is read like this:

* Temperature: 10,000 accepts anything. Here it is ``temperature`` times the median deviation of the swarm's costs from
  their median, so the rule means the same for every cost. Its 100 inner iterations are one, the swarm's own: 50
  particles times 200 iterations are the whole budget.
* Learning factors (28, 29) without their unbounded growth: with f the cost above the swarm's best, divided by the
  median and cut to [0, 1], ``C1 = c exp(1 / (1 + f) - 1)`` lies in [0.60 c, c] and ``C2 = c exp(|f_i - f_k| - 1)`` in
  [0.36 c, c]; C2 shrinks as a group converges. C1 + C2 <= 3 is inside the swarm's stable range once inertia is below
  0.78; until then, and after, a velocity limit bounds the flight.
* Inertia stops at 0.3: below, scouts stand still.
* Neighbours of (24): two particles' best points, whose difference is taken with phi in [-1, 1] drawn per coordinate,
  and one of the swarm's better eighth, which draws the bee by a random share of the way to it and beyond, up to
  ``employed_pull`` or ``onlooker_pull`` ("towards the group's and the swarm's best"). A tenth of the coordinates stay.
* Shares of the roles, and the patience.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missionplanner.search.base import BoolArray, FloatArray, IntArray, Steps
from missionplanner.search.moves import accepted, median, roulette, spread
from missionplanner.search.pso import fly

_ELITE_SHARE = 8  # bees are drawn to the best eighth of the swarm


@dataclass(frozen=True, slots=True)
class PaperSettings:
    """The paper's parameters where they are sound, ours where it gives none. Lengths are shares of the box."""

    groups: int = 3
    inertia: float = 0.9
    inertia_decay: float = 0.99
    inertia_min: float = 0.3
    learning: float = 1.5
    velocity_max: float = 0.1
    temperature: float = 0.1
    temperature_decay: float = 0.99
    patience: int = 30
    scout_share: float = 0.1
    onlooker_share: float = 0.6
    moved_share: float = 0.9
    employed_pull: float = 0.5
    onlooker_pull: float = 1.2


@dataclass(slots=True)
class _Swarm:
    """Where particles are and have been best, one row or number each."""

    position: FloatArray
    velocity: FloatArray
    cost: FloatArray
    best: FloatArray
    best_cost: FloatArray
    idle: IntArray


def grouped_bees(
    initial: FloatArray, evaluations: int, rng: np.random.Generator, settings: PaperSettings | None = None
) -> Steps:
    """PSO-ABC-SA, one candidate per particle and iteration; its schedules are per iteration, as printed."""
    del evaluations
    s = settings or PaperSettings()
    population = len(initial)
    cost = yield initial
    swarm = _Swarm(
        initial.copy(),
        np.zeros_like(initial),
        cost.copy(),
        initial.copy(),
        cost.copy(),
        np.zeros(population, dtype=np.intp),
    )
    everyone = np.arange(population)
    inertia, temperature = s.inertia, s.temperature
    while True:
        order = np.argsort(swarm.best_cost, kind="stable")
        rank = np.argsort(order, kind="stable")
        group = rank % min(s.groups, population)
        leads = rank < s.groups
        role = rng.random(population)
        flies = leads | (role < s.scout_share)
        onlooks = ~flies & (role < s.scout_share + s.onlooker_share)

        standing = _standing(swarm.best_cost, order)
        followed = np.where(onlooks, roulette(rng, 1.0 / (1.0 + standing), population), everyone)
        flown, velocity = _flight(swarm, order, group, leads, standing, inertia, s, rng)
        foraged = _foraging(swarm, order, onlooks, followed, s, rng)
        candidate = np.where(flies[:, None], flown, foraged)
        swarm.velocity = np.where(flies[:, None], velocity, swarm.velocity)
        exhausted = (swarm.idle > s.patience) & (rank > 0)
        _start_anew(swarm, candidate, exhausted, leads, group, rng)

        value = yield candidate
        kept = accepted(rng, value, swarm.cost, temperature * spread(swarm.cost))
        swarm.position[kept], swarm.cost[kept] = candidate[kept], value[kept]
        _remember(swarm, candidate, value, np.where(exhausted, everyone, followed))
        temperature *= s.temperature_decay
        inertia = max(inertia * s.inertia_decay, s.inertia_min)


def _standing(best_cost: FloatArray, order: IntArray) -> FloatArray:
    """Return every particle's cost above the swarm's best, 0 to 1 (the median and worse)."""
    known = np.isfinite(best_cost)
    if not known[order[0]]:
        return np.zeros(len(order))
    rise = np.where(known, best_cost - best_cost[order[0]], 0.0)
    middle = median(rise[known])
    scaled = np.minimum(rise / middle, 1.0) if middle > 0.0 else np.minimum(rise, 1.0)
    return np.where(known, scaled, 1.0)


def _flight(
    swarm: _Swarm,
    order: IntArray,
    group: IntArray,
    leads: BoolArray,
    standing: FloatArray,
    inertia: float,
    s: PaperSettings,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities of particles that fly: leaders by (25), scouts by (30, 31)."""
    x, best = swarm.position, swarm.best
    own_leader = order[group]
    first_c = s.learning * np.exp(1.0 / (1.0 + standing) - 1.0)
    second_c = s.learning * np.exp(np.abs(standing - standing[own_leader]) - 1.0)
    runner_up = order[min(1, len(order) - 1)]
    not_own = np.where(own_leader == order[0], runner_up, order[0])
    near = np.where(leads[:, None], best, best[own_leader])
    far = np.where(leads[:, None], best[not_own], best[order[0]])
    r1, r2 = rng.random((2, *x.shape))
    velocity = inertia * swarm.velocity + first_c[:, None] * r1 * (near - x) + second_c[:, None] * r2 * (far - x)
    return fly(x, velocity, s.velocity_max)


def _foraging(
    swarm: _Swarm, order: IntArray, onlooks: BoolArray, followed: IntArray, s: PaperSettings, rng: np.random.Generator
) -> FloatArray:
    """Return one candidate (P, D) per bee by (24)."""
    best = swarm.best
    population, dimensions = best.shape
    base = np.where(onlooks[:, None], best[followed], swarm.position)
    one = (followed + rng.integers(1, max(population, 2), population)) % population
    other = rng.integers(0, population, population)
    elite = order[rng.integers(0, min(population, max(2, population // _ELITE_SHARE)), population)]
    phi, pull = rng.uniform(-1.0, 1.0, best.shape), rng.random((population, 1))
    pull *= np.where(onlooks, s.onlooker_pull, s.employed_pull)[:, None]
    moved = base + phi * (best[one] - best[other]) + pull * (best[elite] - base)
    changes = rng.random(best.shape) < s.moved_share
    changes[np.arange(population), rng.integers(0, dimensions, population)] = True
    moved = np.where(changes, moved, base)
    inside = np.clip(moved, 0.0, 1.0)
    # Falling short of the wall instead of sticking to it keeps diversity there.
    return np.where(moved == inside, moved, base + (inside - base) * rng.random(moved.shape))


def _start_anew(
    swarm: _Swarm,
    candidate: FloatArray,
    exhausted: BoolArray,
    leads: BoolArray,
    group: IntArray,
    rng: np.random.Generator,
) -> None:
    if not exhausted.any():
        return
    candidate[exhausted] = rng.random((int(exhausted.sum()), candidate.shape[1]))
    for leader in np.flatnonzero(exhausted & leads):
        fellows = swarm.best[group == group[leader]]
        low, high = fellows.min(axis=0), fellows.max(axis=0)
        candidate[leader] = low + candidate[leader] * (high - low)
    swarm.velocity[exhausted] = 0.0
    swarm.cost[exhausted] = swarm.best_cost[exhausted] = np.inf
    swarm.idle[exhausted] = 0


def _remember(swarm: _Swarm, candidate: FloatArray, value: FloatArray, whose: IntArray) -> None:
    """Keep what is better as the best point of ``whose`` it is; of several the best comes last, and stays."""
    better = np.argsort(-value, kind="stable")
    better = better[value[better] < swarm.best_cost[whose[better]]]
    swarm.best[whose[better]] = candidate[better]
    swarm.best_cost[whose[better]] = value[better]
    swarm.idle += 1
    swarm.idle[whose[better]] = 0
