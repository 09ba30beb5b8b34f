"""Particle swarm optimisation (PAPER.md eqs 21, 22; Kennedy & Eberhart 1995, doi:10.1109/ICNN.1995.488968)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missionplanner.search.base import FloatArray


@dataclass(frozen=True, slots=True)
class PsoSettings:
    """The paper's parameters; ``inertia`` decays per iteration until ``inertia_min`` keeps the swarm alive."""

    inertia: float = 0.9
    inertia_decay: float = 0.99
    inertia_min: float = 0.4
    cognitive: float = 1.5
    social: float = 1.5
    velocity_max: float = 0.2  # of the box, per iteration: without it inertia 0.9 flings half the swarm to the walls


class Pso:
    """Every particle is drawn to its own best point and to the swarm's."""

    def __init__(
        self, initial: FloatArray, evaluations: int, rng: np.random.Generator, settings: PsoSettings | None = None
    ) -> None:
        del evaluations  # the schedule is per iteration, not per budget: as printed
        self._settings = settings or PsoSettings()
        self._rng = rng
        self._position = initial.copy()
        self._velocity = np.zeros_like(initial)
        self._best_position = initial.copy()
        self._best_cost = np.full(len(initial), np.inf)
        self._inertia = self._settings.inertia
        self._first = True

    def ask(self) -> FloatArray:
        """Return the swarm's next positions (P, D)."""
        if self._first:
            self._first = False
            return self._position
        s, x = self._settings, self._position
        own, everyone = self._rng.random((2, *x.shape))
        leader = self._best_position[np.argmin(self._best_cost)]
        velocity = (
            self._inertia * self._velocity
            + s.cognitive * own * (self._best_position - x)
            + s.social * everyone * (leader - x)
        )
        self._position, self._velocity = fly(x, velocity, s.velocity_max)
        self._inertia = max(self._inertia * s.inertia_decay, s.inertia_min)
        return self._position

    def tell(self, cost: FloatArray) -> None:
        """Remember every particle's best point."""
        better = cost < self._best_cost
        self._best_cost[better] = cost[better]
        self._best_position[better] = self._position[better]


def fly(position: FloatArray, velocity: FloatArray, velocity_max: float) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (P, D) one step later: inside the unit box, stopped at its walls."""
    velocity = np.clip(velocity, -velocity_max, velocity_max)
    free = position + velocity
    inside = np.clip(free, 0.0, 1.0)
    return inside, np.where(free == inside, velocity, 0.0)
