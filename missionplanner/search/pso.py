"""Particle swarms: the classic one (PAPER.md eqs 21, 22) and the quantum-behaved one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from missionplanner.search.base import FloatArray, Steps


@dataclass(frozen=True, slots=True)
class PsoSettings:
    """The paper's parameters; ``inertia`` decays per iteration until ``inertia_min`` keeps the swarm alive."""

    inertia: float = 0.9
    inertia_decay: float = 0.99
    inertia_min: float = 0.4
    cognitive: float = 1.5
    social: float = 1.5
    velocity_max: float = 0.2  # of the box, per iteration: without it inertia 0.9 flings half the swarm to the walls


class Swarm:
    """Particles with velocities and memories, for the algorithms that build on PSO."""

    def __init__(self, initial: FloatArray, settings: PsoSettings | None = None) -> None:
        self.position = initial.copy()
        self.velocity = np.zeros_like(initial)
        self.best_position = initial.copy()
        self.best_cost = np.full(len(initial), np.inf)
        self._settings = settings or PsoSettings()
        self._inertia = self._settings.inertia

    @property
    def leader(self) -> FloatArray:
        """The best point (D,) any particle has seen."""
        best: FloatArray = self.best_position[np.argmin(self.best_cost)]
        return best

    def flown(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return positions and velocities (P, D) one step later: drawn to one's own best point and to the leader."""
        s, x = self._settings, self.position
        own, everyone = rng.random((2, *x.shape))
        velocity = (
            self._inertia * self.velocity
            + s.cognitive * own * (self.best_position - x)
            + s.social * everyone * (self.leader - x)
        )
        self._inertia = max(self._inertia * s.inertia_decay, s.inertia_min)
        return fly(x, velocity, s.velocity_max)

    def remember(self, position: FloatArray, cost: FloatArray) -> None:
        """Remember every particle's best point."""
        better = cost < self.best_cost
        self.best_cost[better] = cost[better]
        self.best_position[better] = position[better]


def fly(position: FloatArray, velocity: FloatArray, velocity_max: float) -> tuple[FloatArray, FloatArray]:
    """Return positions and velocities (P, D) one step later: inside the unit box, stopped at its walls."""
    velocity = np.clip(velocity, -velocity_max, velocity_max)
    free = position + velocity
    inside = np.clip(free, 0.0, 1.0)
    return inside, np.where(free == inside, velocity, 0.0)


def particle_swarm(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """PSO with the paper's parameters: its inertia decays per iteration, not over the budget."""
    del evaluations
    swarm = Swarm(initial)
    while True:
        swarm.remember(swarm.position, (yield swarm.position))
        swarm.position, swarm.velocity = swarm.flown(rng)


def quantum_swarm(initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Steps:
    """QPSO: positions are drawn around a point between one's own best and the leader, as far as the mean best is.

    Sun, Feng & Xu 2004, doi:10.1109/CEC.2004.1330875; the mean best: Sun, Xu & Feng 2004,
    doi:10.1109/ICCIS.2004.1460396. The contraction falls from 1.0 to 0.5 over the budget, as they advise.
    """
    swarm, spent = Swarm(initial), 0
    while True:
        swarm.remember(swarm.position, (yield swarm.position))
        spent += len(initial)
        contraction = 1.0 - 0.5 * min(spent / evaluations, 1.0)
        between, far, side = rng.random((3, *initial.shape))
        attractor = between * swarm.best_position + (1.0 - between) * swarm.leader
        reach = contraction * np.abs(swarm.best_position.mean(axis=0) - swarm.position) * -np.log1p(-far)
        swarm.position = np.clip(attractor + np.where(side < 0.5, reach, -reach), 0.0, 1.0)
