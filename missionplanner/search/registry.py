"""The optimisers by name."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass

from missionplanner.errors import MissionError
from missionplanner.search.base import OptimiserClass
from missionplanner.search.pso import Pso
from missionplanner.search.pso_abc_sa import PsoAbcSa
from missionplanner.search.pso_abc_sa_paper import PsoAbcSaPaper

_PAPER = "Zhu et al., Multi-UAV Cooperative Power Inspection Base on Improved PSO (PAPER.md eqs 25-33)"


def fifty(dimensions: int, evaluations: int) -> int:
    """Return the paper's population."""
    del dimensions, evaluations
    return 50


@dataclass(frozen=True, slots=True)
class Algorithm:
    """One optimiser: the name users write, what it is, where it comes from.

    ``population`` takes the dimensions and the evaluations of a search and returns the size of its first population.
    """

    name: str
    title: str
    source: str
    make: OptimiserClass
    population: Callable[[int, int], int] = fifty


_ALGORITHMS = (
    Algorithm("pso-abc-sa", "particle swarm in groups of bees with annealing", f"{_PAPER}, best form", PsoAbcSa),
    Algorithm(
        "pso-abc-sa-paper", "the same with the paper's parameters", f"{_PAPER}, its sound reading", PsoAbcSaPaper
    ),
    Algorithm("pso", "particle swarm", "Kennedy & Eberhart 1995, doi:10.1109/ICNN.1995.488968", Pso),
)


def algorithms() -> tuple[Algorithm, ...]:
    """Return every optimiser, the default first."""
    return _ALGORITHMS


def find_algorithm(name: str) -> Algorithm:
    """Return the optimiser called ``name``.

    Raises
    ------
    MissionError
        There is none; the nearest names are suggested.
    """
    by_name = {algorithm.name: algorithm for algorithm in _ALGORITHMS}
    if name in by_name:
        return by_name[name]
    near = difflib.get_close_matches(name.lower().replace("_", "-"), by_name, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}?" if near else f"expected one of {', '.join(by_name)}"
    raise MissionError(f"algorithm: there is no '{name}'; {hint}")
