"""Who searches: our optimisers and those of other libraries behind one function, each used as its documents say.

A :class:`Tally` stands between a search and the function: it prices points, counts them, keeps the best, and ends the
search at its budget exactly, whatever the library does with budgets. Libraries are optional (``pip install
'missionplanner[peers]'``); who is not installed is told to be absent.

How each is used: whole populations at once where the library can; what its documents leave open, a population or a box
of other units, as did best of a few tried on the UAV objective at 10,000 evaluations; schedules (generations,
evaluations) end where the budget ends; one thread.
"""

from __future__ import annotations

import ast
import atexit
import hashlib
import importlib
import inspect
import json
import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of_package
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from missionplanner.errors import MissionError
from missionplanner.experiments import campaign
from missionplanner.search.registry import algorithms, find_algorithm
from missionplanner.search.run import minimise

FloatArray = npt.NDArray[np.float64]
Price = Callable[[FloatArray], npt.ArrayLike]  # (P, D) -> (P,)

_STEP = 1.1  # a curve keeps one point per this factor of evaluations
_WORST = 1e100  # what others are told of a point without a price: some cannot compute with infinity, or NaN


class BudgetSpent(Exception):  # noqa: N818 - a signal, not a failure
    """Raised into a search that asks for more than its budget."""


class Tally:
    """Prices points of a box for one search: counts them, keeps the best, ends at the budget.

    Attributes
    ----------
    used : points priced; never above ``evaluations``.
    best, cost : the cheapest of them (D,), as it was priced, and its cost.
    spent : whether more was asked for than evaluations or seconds allow. Seconds are the processor's: others that
        are at work on the machine take none of them.
    """

    def __init__(
        self,
        price: Price,
        lower: FloatArray,
        upper: FloatArray,
        evaluations: int,
        seconds: float | None = None,
        clock: Callable[[], float] = time.process_time,
    ) -> None:
        self.lower, self.upper, self.evaluations = lower, upper, evaluations
        self.used, self.spent = 0, False
        self.best, self.cost = lower, math.inf
        self._price, self._clock = price, clock
        self._began, self._until = clock(), math.inf if seconds is None else clock() + seconds
        self._curve: dict[int, tuple[int, float, float]] = {}

    @property
    def dimensions(self) -> int:
        """The number of coordinates."""
        return len(self.lower)

    def batch(self, points: npt.ArrayLike, worst: float = _WORST) -> FloatArray:
        """Return the prices (P,) of points (P, D), those outside the box as where they leave it.

        What is NaN or infinite is told as ``worst``.

        Raises
        ------
        BudgetSpent
            More points than the budget allows; those it allows have been priced.
        """
        left = self._left()
        if not left:
            self._end()
        asked = np.minimum(np.maximum(points, self.lower), self.upper)
        rows = asked[:left]
        cost = np.asarray(self._price(rows), dtype=float)
        cost = np.where(np.isnan(cost), np.inf, cost)
        first = int(np.argmin(cost))
        if cost[first] < self.cost:
            self._keep(rows[first], float(cost[first]), self.used + first + 1)
        self.used += len(rows)
        if len(rows) < len(asked):
            self._end()
        return np.where(cost == np.inf, worst, cost)

    def single(self, point: npt.ArrayLike) -> float:
        """Return the price of one point (D,), as :meth:`batch` would, with less ado."""
        if not self._left():
            self._end()
        row = np.minimum(np.maximum(point, self.lower), self.upper)
        cost = float(np.asarray(self._price(row[None]))[0])
        self.used += 1
        if cost < self.cost:
            self._keep(row, cost, self.used)
        return cost if cost < math.inf else _WORST

    def unit(self, points: npt.ArrayLike) -> FloatArray:
        """Return the prices (P,) of points (P, D) of the unit box."""
        return self.batch(self.lower + np.asarray(points, dtype=float) * (self.upper - self.lower))

    @property
    def curve(self) -> list[tuple[int, float, float]]:
        """The best cost over the search: (evaluations, seconds, cost), falling costs, the last one as it ended."""
        return [*self._curve.values()]

    def _left(self) -> int:
        """Return how many points may still be priced."""
        if self._until < math.inf and self._clock() >= self._until:
            return 0
        return self.evaluations - self.used

    def _end(self) -> NoReturn:
        self.spent = True
        raise BudgetSpent

    def _keep(self, point: FloatArray, cost: float, at: int) -> None:
        self.best, self.cost = point.copy(), cost
        self._curve[int(math.log(at) / math.log(_STEP))] = (at, self._clock() - self._began, cost)


Run = Callable[..., None]  # (library, tally, seed): searches until it ends or the tally ends it


@dataclass(frozen=True, slots=True)
class Contender:
    """One optimiser of a library, or one of ours (no library).

    Attributes
    ----------
    library : what is imported, and installed by the same name.
    how : settings worth knowing, in words.
    slow : takes so long that a long budget is only for those who ask for it.
    """

    name: str
    library: str
    search: Run = field(repr=False)
    how: str = ""
    slow: bool = False

    @property
    def ours(self) -> bool:
        """Whether it is of this software."""
        return not self.library

    @property
    def installed(self) -> bool:
        """Whether its library is there."""
        return self.ours or bool(_version(self.library))

    def digest(self) -> str:
        """Return what its results depend on, besides problem, budget and seed, as a short digest.

        All of this file counts but who is in :data:`PEERS`: others' runs stay valid when somebody is added.
        """
        call = self.search
        assert isinstance(call, partial)
        depends: dict[str, Any] = {
            "libraries": {name: _version(name) for name in (self.library, "numpy", "scipy") if name},
            "with": repr(sorted(call.keywords.items())),
            "source": _adapters(),
        }
        if self.ours:
            algorithm = find_algorithm(self.name)
            make = algorithm.make
            parts = [make.func, *make.args] if isinstance(make, partial) else [make]
            imported = (name for part in parts for name in _imported(inspect.getmodule(part)))
            depends["modules"] = campaign.version_of({}, sorted({"missionplanner.search.run", *imported}))
            depends["population"] = [algorithm.population(d, e) for d in (2, 4, 6, 30) for e in (2500, 10_000, 100_000)]
        return hashlib.sha256(json.dumps(depends, sort_keys=True).encode()).hexdigest()[:10]

    def run(
        self,
        price: Price,
        lower: FloatArray,
        upper: FloatArray,
        *,
        evaluations: int,
        seed: int,
        seconds: float | None = None,
        clock: Callable[[], float] = time.process_time,
    ) -> Tally:
        """Search once; return what was counted and found.

        Raises
        ------
        MissionError
            Its library is not installed.
        """
        if not self.installed:
            raise MissionError(f"{self.name}: expected {self.library}, which is not installed: {INSTALL}")
        library = _loaded(self.library) if self.library else None
        tally = Tally(price, lower, upper, evaluations, seconds, clock)
        try:
            self.search(library, tally, seed)
        except Exception:  # C++ libraries turn the tally's signal into errors of their own
            if not tally.spent:
                raise
        return tally


INSTALL = "pip install 'missionplanner[peers]'"


@cache
def _version(library: str) -> str:
    try:
        return version_of_package(library)
    except PackageNotFoundError:
        return ""


@cache
def code_of(module: str, without: str = "") -> str:
    """Return a module's code without comments and layout, and without one of its names."""
    path = Path(__file__).parents[2].joinpath(*module.split(".")).with_suffix(".py")
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            node.body = [part for part in node.body if not _says_nothing(part, without)] or [ast.Pass()]
    return ast.unparse(tree)


def _says_nothing(part: ast.stmt, without: str) -> bool:
    documents = isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant)
    left_out = isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name) and part.target.id == without
    return documents or left_out


def _adapters() -> str:
    return code_of(__name__, without="PEERS")


@cache
def _loaded(library: str) -> Any:
    """Import a library; pyswarms would open report.log wherever it is, and log to the terminal."""
    if library == "pyswarms":
        handle, path = tempfile.mkstemp(suffix=".yml")
        os.write(handle, b"{version: 1, incremental: true}")
        os.close(handle)
        atexit.register(os.unlink, path)
        os.environ["LOG_CFG"] = path
    try:
        return importlib.import_module(library)
    except ImportError as error:
        reason = " ".join(str(error).split())
        raise MissionError(f"{library}: expected a library that can be imported, got: {reason}: {INSTALL}") from error


def _imported(module: Any) -> Iterator[str]:
    """Yield the names of a module of ours and of all those of ours that it imports, directly or not."""
    seen, todo = set(), [module.__name__]
    while todo:
        name = todo.pop()
        path = Path(__file__).parents[2].joinpath(*name.split(".")).with_suffix(".py")
        if name in seen or not path.exists():
            continue
        seen.add(name)
        yield name
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("missionplanner."):
                todo += [node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)]


# --- ours ------------------------------------------------------------------------------------------------------------


def _our(_library: None, tally: Tally, seed: int, algorithm: str) -> None:
    price = partial(tally.batch, worst=math.inf)
    minimise(price, tally.lower, tally.upper, algorithm=algorithm, evaluations=tally.evaluations, seed=seed)


# --- theirs ----------------------------------------------------------------------------------------------------------

Sizes = tuple[int, int]
"""Of a population for a short budget and for a long one."""

_LONG = 30_000


def _size(sizes: Sizes, tally: Tally) -> int:
    return sizes[tally.evaluations >= _LONG]


def _minionpy(library: Any, tally: Tally, seed: int, algorithm: str) -> None:
    bounds = list(zip(tally.lower, tally.upper, strict=True))
    library.Minimizer(
        lambda points: tally.batch(points).tolist(), bounds, algo=algorithm, maxevals=tally.evaluations, seed=seed
    ).optimize()


def _pygmo(library: Any, tally: Tally, seed: int, algorithm: str, populations: Sizes, **settings: Any) -> None:
    class Problem:
        """What pygmo copies: functions are shared by copies, a tally would not be."""

        def __init__(self, price: Callable[[FloatArray], float]) -> None:
            self.price = price

        def fitness(self, x: FloatArray) -> list[float]:
            return [self.price(x)]

        def get_bounds(self) -> tuple[list[float], list[float]]:
            return tally.lower.tolist(), tally.upper.tolist()

    population = _size(populations, tally)
    each = 2 if algorithm == "bee_colony" else 1
    generations = math.ceil((tally.evaluations - population) / (each * population)) + 1
    price = lambda x: tally.single(x)  # noqa: E731, PLW0108 - a method would be copied with its tally
    swarm = library.population(library.problem(Problem(price)), population, seed=seed)
    chosen = getattr(library, algorithm)(gen=generations, seed=seed, **settings)
    library.algorithm(chosen).evolve(swarm)


def _cma(library: Any, tally: Tally, seed: int, bipop: bool = False) -> None:
    rng = np.random.default_rng(seed)
    library.fmin2(
        lambda x: float(tally.unit(np.asarray(x)[None])[0]),
        lambda: rng.random(tally.dimensions),  # a new start for every restart
        0.25,  # documents: the optimum within the start +- 2 sigma or so
        {
            "bounds": [0.0, 1.0],
            "maxfevals": tally.evaluations,
            "seed": seed + 1,  # 0 means the clock
            "verbose": -9,
            "verb_log": 0,
        },
        parallel_objective=lambda points: tally.unit(points).tolist(),
        restarts=99,
        incpopsize=2,
        bipop=bipop,
    )


def _mealpy(
    library: Any,
    tally: Tally,
    seed: int,
    module: str,
    variant: str,
    population: int,
    each: float = 1.0,
    unit: bool = False,
) -> None:
    np.random.seed(seed)  # noqa: NPY002 - its L_SHADE draws from the global one
    epochs = math.ceil((tally.evaluations - population) / (each * population))
    lower, upper = (np.zeros_like(tally.lower), np.ones_like(tally.upper)) if unit else (tally.lower, tally.upper)
    problem = {
        "obj_func": (lambda x: float(tally.unit(x[None])[0])) if unit else tally.single,
        "bounds": library.FloatVar(lb=lower, ub=upper),
        "minmax": "min",
        "log_to": None,
    }
    model = getattr(getattr(library, module), variant)(epoch=max(1, epochs), pop_size=population)
    model.solve(problem, seed=seed)


def _pyswarms(library: Any, tally: Tally, seed: int, populations: Sizes) -> None:
    population = _size(populations, tally)
    np.random.seed(seed)  # noqa: NPY002 - it has no other
    swarm = library.single.GlobalBestPSO(
        n_particles=population,
        dimensions=tally.dimensions,
        options={"c1": 0.5, "c2": 0.3, "w": 0.9},
        bounds=(tally.lower, tally.upper),
    )
    swarm.optimize(tally.batch, iters=math.ceil(tally.evaluations / population) + 1, verbose=False)


def _scipy_de(library: Any, tally: Tally, seed: int, popsize: int) -> None:
    del library
    optimize = importlib.import_module("scipy.optimize")
    optimize.differential_evolution(
        lambda points: tally.batch(points.T),
        list(zip(tally.lower, tally.upper, strict=True)),
        popsize=popsize,
        maxiter=tally.evaluations,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        seed=seed,
    )


def _scipy_annealing(library: Any, tally: Tally, seed: int) -> None:
    del library
    optimize = importlib.import_module("scipy.optimize")
    optimize.dual_annealing(
        tally.single,
        list(zip(tally.lower, tally.upper, strict=True)),
        maxiter=tally.evaluations,
        maxfun=tally.evaluations + 1,
        seed=seed,
    )


def _peer(library: str, name: str, search: Run, how: str = "", *, slow: bool = False, **settings: Any) -> Contender:
    return Contender(f"{library} {name}", library, partial(search, **settings), how or "its defaults", slow)


_ENDLESS: dict[str, Any] = {"ftol": 0.0, "xtol": 0.0}

PEERS: tuple[Contender, ...] = (
    *(
        _peer("minionpy", name, _minionpy, algorithm=name)
        for name in (
            *("ARRDE", "jSO", "LSHADE", "AGSK", "j2020", "NLSHADE_RSP", "JADE", "RDEX", "LSRTDE", "LSHADE_cnEpSin"),
            *("IMODE", "SPSO2011"),
        )
    ),
    *(
        _peer("pygmo", name, _pygmo, how, algorithm=name, populations=populations, **settings)
        for name, how, populations, settings in (
            ("pso", "population 100", (100, 100), {}),
            ("cmaes", "population 50, kept in the box, no early end", (50, 50), {**_ENDLESS, "force_bounds": True}),
            ("bee_colony", "population 50, long budgets 100", (50, 100), {}),
            ("de1220", "population 50, no early end", (50, 50), _ENDLESS),
            ("sade", "population 20, long budgets 50, no early end", (20, 50), _ENDLESS),
        )
    ),
    _peer("cma", "IPOP", _cma, "unit box, sigma 0.25, restarts anywhere, populations doubled", slow=True),
    *(
        _peer("mealpy", name, _mealpy, "population 50", slow=True, population=50, **settings)
        for name, settings in (
            ("GWO", {"module": "GWO", "variant": "OriginalGWO", "unit": True}),
            ("L_SHADE", {"module": "SHADE", "variant": "L_SHADE"}),
            ("PSO", {"module": "PSO", "variant": "OriginalPSO"}),
            ("AVOA", {"module": "AVOA", "variant": "OriginalAVOA"}),
            ("ABC", {"module": "ABC", "variant": "OriginalABC", "each": 2}),
        )
    ),
    _peer(
        "mealpy",
        "SA",
        _mealpy,
        "GaussianSA (OriginalSA takes 70 s)",
        slow=True,
        module="SA",
        variant="GaussianSA",
        population=2,
        each=0.5,
        unit=True,
    ),
    _peer("scipy", "DE", _scipy_de, "popsize 2, no polish, no early end", popsize=2),
    _peer("scipy", "dual annealing", _scipy_annealing, "with its local search"),
    _peer(
        "pyswarms",
        "GlobalBestPSO",
        _pyswarms,
        "100 particles, long budgets 50, its documents' options",
        populations=(100, 50),
    ),
)
"""Optimisers of other libraries."""


def ours() -> tuple[Contender, ...]:
    """Return the registry's optimisers as contenders, the default first."""
    return tuple(Contender(a.name, "", partial(_our, algorithm=a.name), a.title) for a in algorithms())


def find_contender(name: str) -> Contender:
    """Return who is called ``name``, of ours or of other libraries.

    Raises
    ------
    MissionError
        Nobody; the nearest of our names are suggested.
    """
    for contender in PEERS:
        if contender.name == name:
            return contender
    return next(c for c in ours() if c.name == find_algorithm(name).name)
