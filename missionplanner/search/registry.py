"""The optimisers by name."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from missionplanner.errors import MissionError
from missionplanner.search.annealing import simulated_annealing
from missionplanner.search.base import OptimiserClass, Stepwise
from missionplanner.search.bees import annealed_bee_colony, bee_colony
from missionplanner.search.crayfish import crayfish
from missionplanner.search.genetic import genetic_algorithm
from missionplanner.search.gold_rush import gold_rush
from missionplanner.search.grey_wolves import grey_wolves
from missionplanner.search.hybrids import annealed_swarm, genetic_swarm
from missionplanner.search.pso import particle_swarm, quantum_swarm
from missionplanner.search.pso_abc_sa import PsoAbcSa, population_for
from missionplanner.search.pso_abc_sa_paper import grouped_bees
from missionplanner.search.sparrows import sparrows
from missionplanner.search.spider_wasps import spider_wasps
from missionplanner.search.vultures import vultures

_PAPER = "Zhu, Zhao, Li, Li, Zhao & Wang, Multi-UAV Cooperative Power Inspection Base on Improved PSO Algorithm"


def fifty(dimensions: int, evaluations: int) -> int:
    """Return the paper's population."""
    del dimensions, evaluations
    return 50


def bee_sources(dimensions: int, evaluations: int) -> int:
    """Return the food sources of a colony of fifty bees: half of them are employed."""
    del dimensions, evaluations
    return 25


def chains(dimensions: int, evaluations: int) -> int:
    """Return few chains: annealing needs long ones."""
    del dimensions, evaluations
    return 5


def wasps(dimensions: int, evaluations: int) -> int:
    """Return the population the spider wasps' authors begin with."""
    del dimensions, evaluations
    return 100


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
    Algorithm(
        "pso-abc-sa",
        "particle swarm in groups of bees with annealing",
        f"{_PAPER}, best form",
        PsoAbcSa,
        population_for,
    ),
    Algorithm(
        "pso-abc-sa-paper",
        "the same with the paper's parameters",
        f"{_PAPER}, its sound reading",
        partial(Stepwise, grouped_bees),
    ),
    Algorithm(
        "pso",
        "particle swarm",
        "Kennedy & Eberhart 1995, doi:10.1109/ICNN.1995.488968",
        partial(Stepwise, particle_swarm),
    ),
    Algorithm(
        "abc",
        "artificial bee colony",
        "Karaboga & Basturk 2007, doi:10.1007/s10898-007-9149-x",
        partial(Stepwise, bee_colony),
        bee_sources,
    ),
    Algorithm(
        "sa",
        "simulated annealing, chains side by side",
        "Kirkpatrick, Gelatt & Vecchi 1983, doi:10.1126/science.220.4598.671; "
        "Corana et al. 1987, doi:10.1145/29380.29864",
        partial(Stepwise, simulated_annealing),
        chains,
    ),
    Algorithm(
        "pso-sa",
        "particle swarm with annealing",
        "Shieh, Kuo & Chiang 2011, doi:10.1016/j.amc.2011.10.012",
        partial(Stepwise, annealed_swarm),
    ),
    Algorithm(
        "abc-sa",
        "artificial bee colony with annealing",
        "the Metropolis rule in ABC, an idea of Yurtkuran & Emel 2016, doi:10.1155/2016/8085953",
        partial(Stepwise, annealed_bee_colony),
        bee_sources,
    ),
    Algorithm(
        "qpso",
        "quantum-behaved particle swarm",
        "Sun, Feng & Xu 2004, doi:10.1109/CEC.2004.1330875",
        partial(Stepwise, quantum_swarm),
    ),
    Algorithm(
        "ga",
        "genetic algorithm for real numbers",
        "Deb & Agrawal 1995, Complex Systems 9, 115-148; Deb et al. 2002, doi:10.1109/4235.996017",
        partial(Stepwise, genetic_algorithm),
    ),
    Algorithm(
        "pso-ga",
        "particle swarm with genetic offspring",
        "Juang 2004, doi:10.1109/TSMCB.2003.818557",
        partial(Stepwise, genetic_swarm),
    ),
    Algorithm(
        "gwo",
        "grey wolf optimiser",
        "Mirjalili, Mirjalili & Lewis 2014, doi:10.1016/j.advengsoft.2013.12.007",
        partial(Stepwise, grey_wolves),
    ),
    Algorithm(
        "ssa", "sparrow search", "Xue & Shen 2020, doi:10.1080/21642583.2019.1708830", partial(Stepwise, sparrows)
    ),
    Algorithm(
        "avoa",
        "African vultures optimisation",
        "Abdollahzadeh, Gharehchopogh & Mirjalili 2021, doi:10.1016/j.cie.2021.107408",
        partial(Stepwise, vultures),
    ),
    Algorithm("gro", "gold rush optimiser", "Zolfi 2023, doi:10.37190/ord230108", partial(Stepwise, gold_rush)),
    Algorithm(
        "swo",
        "spider wasp optimiser",
        "Abdel-Basset et al. 2023, doi:10.1007/s10462-023-10446-y",
        partial(Stepwise, spider_wasps),
        wasps,
    ),
    Algorithm(
        "coa",
        "crayfish optimisation (the paper does not say which COA)",
        "Jia, Rao, Wen & Mirjalili 2023, doi:10.1007/s10462-023-10567-4",
        partial(Stepwise, crayfish),
    ),
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
    if not isinstance(name, str):
        raise MissionError(f"algorithm: expected a name, as '{_ALGORITHMS[0].name}', got {name!r}")
    by_name = {algorithm.name: algorithm for algorithm in _ALGORITHMS}
    if name in by_name:
        return by_name[name]
    near = difflib.get_close_matches(name.lower().replace("_", "-"), by_name, n=3, cutoff=0.4)
    hint = f"did you mean {' or '.join(near)}?" if near else f"expected one of {', '.join(by_name)}"
    raise MissionError(f"algorithm: there is no '{name}'; {hint}")
