"""The UAV path objective, searched blindly and with the planner's own first guesses; ``missionplanner experiment uav``.

Three ways to spend the same number of evaluations:

* *black box*: PSO-ABC-SA over the box of vectors, knowing nothing;
* *guessed*: the same, begun with the paths of a graph search over the map (:func:`.uav_graph.lattice_routes`);
* *grey box*: these paths improved by weaving. Places are drawn around all waypoints at once, and the cheapest of all
  paths through them is found by dynamic programming (:func:`.uav_graph.woven`). Places close in while nothing is
  better; a path that nothing near improves is kicked, a few waypoints off, and woven anew.

What counts: every call of the objective, and in weaving every n + 1 legs priced, rounded up, since a path has so many.
What the graph search takes is not counted but told: its legs, how many evaluations they would be, and its time.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from missionplanner.errors import MissionError
from missionplanner.experiments import campaign
from missionplanner.experiments.scene_figures import INK, MUTED, RULE, new_figure, save_png
from missionplanner.experiments.uav_graph import Routes, decoded, encoded, lattice_routes, woven
from missionplanner.experiments.uav_objective import HIGH_M, LOW_M, Instance, load
from missionplanner.files import write_atomic, write_csv
from missionplanner.geodesy import FloatArray
from missionplanner.search.run import minimise

Progress = Callable[[str, float], None]

METHODS = {"black": "black box", "guessed": "guessed", "grey": "grey box"}
BUDGETS = (2_500, 10_000, 100_000)
SEEDS = 15
MEDIAN_ASKED = {2_500: 3.0, 10_000: 1.0, 100_000: 0.3}
WORST_ASKED = 10.0
"""Gaps of the grey box in %; all its paths are to be free of penalties from 10,000 evaluations on."""

ROUTES = 10
_PLACES = 5  # per waypoint, the present one among them
_BEGIN_M, _SETTLED_M, _WIDEST_M = 8.0, 0.1, 40.0  # how far places are from waypoints
_WIDER, _CLOSER = 1.5, 0.8
_OTHER_HEIGHT = 0.15  # share of places at another height
_SLIDE_EVERY = 6  # rounds: waypoints move along the path, so that one more is where it is needed
_HAIR_M = 0.01
_KICK_M, _KICKED = 20.0, 4  # how far, and at most how many waypoints
_TOLERANCE = 5e-4  # of the price: how much worse a settled path may be, on average, to be kicked next
_CLIMBERS_EACH = 600  # evaluations, at least, per path that is woven at first

BEST_KNOWN: dict[str, float] = {}
"""By the digest of an instance: the cheapest path ever found, by long runs of the grey box."""


# --- one search ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    curve : evaluations, and the best price by then, whenever it fell.
    """

    point: FloatArray  # (D,)
    price: float
    curve: list[tuple[int, float]]
    evaluations: int


def search(instance: Instance, *, method: str, evaluations: int, seed: int, routes: Routes | None = None) -> Found:
    """Search an instance in one of :data:`METHODS`; the same arguments give the same path.

    ``routes`` are those of :func:`first_guesses` with the same seed, if known already.
    """
    if method == "black":
        return _swarmed(instance, evaluations, seed, None)
    guesses = (routes or first_guesses(instance, seed)).paths
    if method == "guessed":
        return _swarmed(instance, evaluations, seed, encoded(instance, guesses))
    ledger = _Ledger(instance, evaluations)
    _weave(ledger, guesses, np.random.default_rng(seed))
    point = encoded(instance, ledger.path[None])
    ledger.used += 1  # what is told is what the objective says
    return Found(point[0], float(instance.price(point, 1)[0]), ledger.curve, ledger.used)


def first_guesses(instance: Instance, seed: int) -> Routes:
    """Return the paths with which a seed's searches begin."""
    return lattice_routes(instance, routes=ROUTES, rng=np.random.default_rng(seed))


def _swarmed(instance: Instance, evaluations: int, seed: int, initial: FloatArray | None) -> Found:
    result = minimise(
        lambda x: instance.price(x, 1),
        instance.lower,
        instance.upper,
        evaluations=evaluations,
        seed=seed,
        initial=initial,
    )
    curve: list[tuple[int, float]] = []
    for k, price in zip(result.history_evaluations.tolist(), result.history.tolist(), strict=True):
        if not curve or price < curve[-1][1]:
            curve.append((k, price))
    return Found(result.best, result.cost, curve, result.evaluations)


# --- weaving ---------------------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class _Ledger:
    """Evaluations spent, and the best path so far."""

    instance: Instance
    evaluations: int
    used: int = 0
    price: float = math.inf
    path: FloatArray = field(default_factory=lambda: np.empty(0))
    curve: list[tuple[int, float]] = field(default_factory=list)

    @property
    def weaving(self) -> int:
        """Return what one round of weaving costs at most."""
        vectors = self.instance.dimensions // 3
        return -(-(_PLACES**2 * (vectors - 1) + 2 * _PLACES) // (vectors + 1))

    def see(self, price: float, path: FloatArray) -> None:
        if price < self.price:
            self.price, self.path = price, path.copy()
            self.curve.append((self.used, price))

    def priced(self, paths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the paths (P, n + 2, 3) nearest to some that the box can express, and their prices (P,)."""
        points = encoded(self.instance, paths)
        price, inside = self.instance.price(points, 1), decoded(self.instance, points)
        for one, path in zip(price, inside, strict=True):
            self.used += 1
            self.see(float(one), path)
        return inside, price

    def woven(self, places: FloatArray) -> tuple[FloatArray, float]:
        """Return the cheapest path through places (n, K, 3), and its price."""
        rows, columns = self.instance.arrays.height_m.shape
        inside = np.clip(places, (1.0, 1.0, LOW_M), (columns - 1.0, rows - 1.0, HIGH_M))
        path = np.empty((len(places) + 2, 3))
        price, legs = woven(inside, self.instance.arrays, self.instance.upper[0], path)
        self.used += -(-legs // (len(places) + 1))
        self.see(price, path)
        return path, price


class _Climber:
    """A path on its way down: woven through ever nearer places, kicked when that ends."""

    def __init__(self, path: FloatArray, price: float) -> None:
        self.home, self.home_price = path, price  # settled last
        self._path, self._price = path, price
        self._reach_m = _BEGIN_M
        self._round = 0

    @property
    def price(self) -> float:
        return min(self._price, self.home_price)

    def step(self, ledger: _Ledger, rng: np.random.Generator) -> None:
        """Spend one round of weaving, or one evaluation on a kick."""
        if self._reach_m < _SETTLED_M:
            self._kick(ledger, rng)
            return
        self._round += 1
        slides = self._round % _SLIDE_EVERY == 0
        path, price = ledger.woven(_slid(self._path, rng) if slides else _around(self._path, self._reach_m, rng))
        better = price < self._price - 1e-9
        if better:
            self._path, self._price = path, price
        if not slides:
            self._reach_m = min(self._reach_m * _WIDER, _WIDEST_M) if better else self._reach_m * _CLOSER

    def _kick(self, ledger: _Ledger, rng: np.random.Generator) -> None:
        if self._price < self.home_price * (1.0 + _TOLERANCE * rng.exponential()):
            self.home, self.home_price = self._path, self._price
        kicked = self.home.copy()
        moved = min(int(rng.integers(1, _KICKED + 1)), len(kicked) - 2)
        first = int(rng.integers(1, len(kicked) - moved))
        kicked[first : first + moved, :2] += _KICK_M * rng.normal(size=(moved, 2))
        paths, prices = ledger.priced(kicked[None])
        self._path, self._price = paths[0], float(prices[0])
        self._reach_m = _BEGIN_M


def _weave(ledger: _Ledger, guesses: FloatArray, rng: np.random.Generator) -> None:
    """Improve guesses: after each third of the time the cheaper half of them goes on."""
    paths, prices = ledger.priced(guesses[: max(1, ledger.evaluations - 1)])
    climbers = [_Climber(path, float(price)) for path, price in zip(paths, prices, strict=True)]
    number = min(len(climbers), max(4, ledger.evaluations // _CLIMBERS_EACH))
    for stages in (3, 2, 1):
        climbers = sorted(climbers, key=lambda climber: climber.price)[: max(1, number >> (3 - stages))]
        until = ledger.used + (ledger.evaluations - 1 - ledger.used) // stages
        turn = 0
        while ledger.used + ledger.weaving <= until:
            climbers[turn % len(climbers)].step(ledger, rng)
            turn += 1


def _around(path: FloatArray, reach_m: float, rng: np.random.Generator) -> FloatArray:
    """Return places (n, K, 3) around a path's waypoints, which come first."""
    places = np.repeat(path[1:-1, None], _PLACES, axis=1)
    shape = (len(places), _PLACES - 1)
    far = reach_m * np.exp(0.7 * rng.normal(size=shape))
    places[:, 1:, :2] += far[..., None] * rng.normal(size=(*shape, 2))
    kind, rise = rng.random(shape), far * rng.normal(size=shape)
    middle, other = kind < 0.5 * _OTHER_HEIGHT, kind < _OTHER_HEIGHT
    height = places[:, 1:, 2]
    height[:] = np.where(middle, 0.5 * (LOW_M + HIGH_M), np.where(other, height + rise, height))
    return places


def _slid(path: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return places (n, 5, 3) along a path: its waypoints, their neighbours, and places on the way to those."""
    here, before, after = path[1:-1], path[:-2].copy(), path[2:].copy()
    before[0], after[-1] = here[0], here[-1]  # a waypoint at an end would be a leg of no length
    share = rng.random((len(here), 1))
    on, back = here + share * (after - here), here + share * (before - here)
    places = np.stack([here, before, after, on, back], axis=1)
    places[:, 1:, :2] += _HAIR_M * rng.normal(size=(len(here), 4, 2))
    return places


# --- the experiment --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All runs: of every instance, method and number of evaluations one per seed."""

    names: tuple[str, ...]
    budgets: tuple[int, ...]
    seeds: int
    best: Mapping[str, float]  # by name: known before, or found here
    news: tuple[str, ...]  # instances whose best is of this run
    runs: Mapping[tuple[str, int, str], list[dict[str, Any]]]  # by name, evaluations and method
    graphs: Mapping[str, list[dict[str, Any]]]

    def gaps(self, budget: int, method: str, names: Sequence[str] | None = None) -> FloatArray:
        """Return gaps in % of all runs with a method and budget, instance by instance."""
        return np.array(
            [
                100.0 * (run["price"] / self.best[name] - 1.0)
                for name in names or self.names
                for run in self.runs[name, budget, method]
            ]
        )

    def free(self, budget: int, method: str, names: Sequence[str] | None = None) -> float:
        """Return the share of runs whose path pays no penalty."""
        return float(np.mean([r["free"] for name in names or self.names for r in self.runs[name, budget, method]]))

    def asked(self) -> list[dict[str, Any]]:
        """Return what is asked of the grey box, whether it is kept, budget by budget."""
        out = []
        for budget in self.budgets:
            if budget in MEDIAN_ASKED:
                gaps, free = self.gaps(budget, "grey"), self.free(budget, "grey")
                kept = np.median(gaps) <= MEDIAN_ASKED[budget] and gaps.max() <= WORST_ASKED
                out.append(
                    {
                        "evaluations": budget,
                        "median_asked": MEDIAN_ASKED[budget],
                        "worst_asked": WORST_ASKED,
                        "kept": bool(kept and (budget < 10_000 or free == 1.0)),
                    }
                )
        return out

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "seeds": self.seeds,
            "best_known": dict(self.best),
            "best_of_this_run": list(self.news),
            "asked": self.asked(),
            "all": [self._figures(budget, method, self.names) for budget in self.budgets for method in METHODS],
            "instances": {
                name: [self._figures(budget, method, [name]) for budget in self.budgets for method in METHODS]
                for name in self.names
            },
            "graph": {
                name: {"legs": _median(graphs, "legs"), "evaluations": _median(graphs, "evaluations"),
                       "seconds": _median(graphs, "seconds")}
                for name, graphs in self.graphs.items()
            },
        }  # fmt: skip

    def _figures(self, budget: int, method: str, names: Sequence[str]) -> dict[str, Any]:
        gaps = self.gaps(budget, method, names)
        return {
            "evaluations": budget,
            "method": method,
            "gap_median": float(np.median(gaps)),
            "gap_mean": float(gaps.mean()),
            "gap_worst": float(gaps.max()),
            "free": self.free(budget, method, names),
        }


def _median(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    return float(np.median([row[key] for row in rows]))


def main(
    output: Path,
    *,
    instances: Path,
    seeds: int = SEEDS,
    evaluations: Sequence[int] = BUDGETS,
    best: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    results = measure(
        output, instances, seeds, evaluations, best=best, workers=workers, cluster=cluster, progress=progress
    )
    _write(output, instances, results)
    return results.as_json()


def measure(
    folder: Path,
    instances: Path,
    seeds: int,
    evaluations: Sequence[int],
    *,
    best: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> Results:
    """Search all instances of a folder in all methods; only what the output folder does not hold is run.

    Raises
    ------
    MissionError
        No instances there, one that cannot be read, no sensible numbers of evaluations, or a file of best values that
        cannot be read.
    """
    paths = {path.stem: path for path in sorted(instances.glob("*.npz"))}
    if not paths:
        raise MissionError(f"{instances}: expected a folder of instances (.npz files with H, threats, start, end)")
    budgets = tuple(sorted(set(evaluations)))
    if not budgets or budgets[0] < 1:
        raise MissionError(f"evaluations: expected numbers of at least 1, got {list(evaluations)}")
    known = _known(best)
    digests = {}
    for name, path in paths.items():
        digests[name] = digest(load(path))  # also: what is wrong with it is told before any work
        known.setdefault(name, BEST_KNOWN.get(digests[name], math.inf))
    jobs = {
        (name, budget, seed): campaign.Job(
            f"{name}@{digests[name]}/{budget}/{seed}",
            run,
            {"path": str(path.resolve()), "evaluations": budget, "seed": seed},
        )
        for name, path in paths.items()
        for budget in budgets
        for seed in range(seeds)
    }
    done = campaign.run(
        list(jobs.values()),
        folder,
        experiment="uav",
        version=campaign.version_of({}, _DEPENDS_ON),
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    every = {key: done[job.key] for key, job in jobs.items()}
    runs = {
        (name, budget, method): [every[name, budget, seed][method] for seed in range(seeds)]
        for name in paths
        for budget in budgets
        for method in METHODS
    }
    graphs = {name: [every[name, budgets[0], seed]["graph"] for seed in range(seeds)] for name in paths}
    found = {name: min(run["price"] for key in runs if key[0] == name for run in runs[key]) for name in paths}
    news = tuple(name for name in paths if found[name] < known[name])
    return Results(
        tuple(paths), budgets, seeds, {name: min(found[name], known[name]) for name in paths}, news, runs, graphs
    )


_DEPENDS_ON = (
    "missionplanner.search",
    "missionplanner.experiments.uav_search",
    "missionplanner.experiments.uav_graph",
    "missionplanner.experiments.uav_objective",
)


def digest(instance: Instance) -> str:
    """Return what names an instance by its content."""
    arrays = instance.arrays
    content = [arrays.height_m, arrays.threat, arrays.start, arrays.end]
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in content)).hexdigest()[:16]


def _known(best: Path | None) -> dict[str, float]:
    if best is None:
        return {}
    try:
        found = json.loads(best.read_text(encoding="utf-8"))
        return {str(name): float(value) for name, value in found.items()}
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise MissionError(f"{best}: expected JSON of best values by instance, got: {error}") from error


@lru_cache(maxsize=2)
def _loaded(path: str) -> Instance:
    return load(Path(path))


def run(path: str, evaluations: int, seed: int) -> dict[str, Any]:
    """Search one instance in all methods with one seed."""
    instance = _loaded(path)
    began_s = time.perf_counter()
    routes = first_guesses(instance, seed)
    legs_each = instance.dimensions // 3 + 1
    out: dict[str, Any] = {
        "graph": {
            "legs": routes.legs,
            "evaluations": -(-routes.legs // legs_each),
            "seconds": round(time.perf_counter() - began_s, 3),
        }
    }
    for method in METHODS:
        began_s = time.perf_counter()
        found = search(instance, method=method, evaluations=evaluations, seed=seed, routes=routes)
        out[method] = {
            "price": found.price,
            "free": bool(instance.free(found.point[None])[0]),
            "seconds": round(time.perf_counter() - began_s, 3),
            "curve": _thinned(found.curve),
            "path": np.round(instance.waypoints_m(found.point[None])[0], 3).tolist(),
        }
    return out


def _thinned(curve: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    """Return the last point of a curve in every step of evaluations by a twentieth of a decade."""
    last = {round(20.0 * math.log10(k)): (k, price) for k, price in curve}
    return list(last.values())


# --- what is written -------------------------------------------------------------------------------------------------

_COLOURS = {"black": MUTED, "guessed": "#0072b2", "grey": "#d55e00"}
_FIELDS = ("instance", "method", "evaluations", "seed", "price", "gap_percent", "free", "seconds")


def _write(folder: Path, instances: Path, results: Results) -> None:
    rows = [
        [name, method, budget, seed, found["price"], 100.0 * (found["price"] / results.best[name] - 1.0), found["free"],
         found["seconds"]]
        for (name, budget, method), runs in results.runs.items()
        for seed, found in enumerate(runs)
    ]  # fmt: skip
    write_csv(folder / "runs.csv", _FIELDS, rows)
    _draw_gaps(folder / "gaps.png", results)
    _draw_paths(folder / "paths.png", instances, results)
    write_atomic(folder / "results.md", table(results))


def table(results: Results) -> str:
    """Return the figures as Markdown."""
    lines = [
        "# The UAV path objective, with and without the planner's own first guesses",
        "",
        f"Gap: excess over the best known value in %, over {results.seeds} seeds: median / worst, and the share of "
        "paths without penalty. *Black box*: PSO-ABC-SA. *Guessed*: the same, begun with the graph's paths. *Grey "
        "box*: the graph's paths, woven.",
    ]
    for budget in results.budgets:
        lines += ["", f"## {budget:,} evaluations", "", f"| instance | best known | {' | '.join(METHODS.values())} |"]
        lines.append("|---" * (2 + len(METHODS)) + "|")
        for name in results.names:
            known = f"{results.best[name]:,.1f}{' (new)' if name in results.news else ''}"
            cells = [_cell(results, budget, method, [name]) for method in METHODS]
            lines.append(f"| {name} | {known} | {' | '.join(cells)} |")
        cells = [_cell(results, budget, method, results.names) for method in METHODS]
        lines.append(f"| **all** | | {' | '.join(cells)} |")
    lines += ["", "## What the graph search takes, uncounted", "", "| instance | legs | as evaluations | seconds |"]
    lines.append("|---|---|---|---|")
    for name, graphs in results.graphs.items():
        lines.append(
            f"| {name} | {_median(graphs, 'legs'):,.0f} | {_median(graphs, 'evaluations'):,.0f} | "
            f"{_median(graphs, 'seconds'):.2f} |"
        )
    for asked in results.asked():
        lines += [
            "",
            f"Asked of the grey box at {asked['evaluations']:,} evaluations: median gap <= {asked['median_asked']:g} "
            f"%, worst <= {asked['worst_asked']:g} %{', all free' if asked['evaluations'] >= 10_000 else ''}: "
            f"{'kept' if asked['kept'] else 'not kept'}.",
        ]
    lines += ["", "![gap over evaluations](gaps.png)", "", "![paths from above](paths.png)"]
    return "\n".join(lines) + "\n"


def _cell(results: Results, budget: int, method: str, names: Sequence[str]) -> str:
    gaps = results.gaps(budget, method, names)
    free = results.free(budget, method, names)
    return f"{np.median(gaps):.2f} / {gaps.max():.2f}, {100.0 * free:.0f} %"


def _draw_gaps(path: Path, results: Results) -> None:
    """Draw the gap over evaluations, over all runs; then run by run at every budget."""
    figure = new_figure(9.0, 3.6)
    curves, dots = figure.subplots(1, 2)
    budget = results.budgets[-1]
    grid = np.geomspace(1.0, budget, 200)
    floor = 1e-3
    for method, colour in _COLOURS.items():
        rows = []
        for name in results.names:
            for found in results.runs[name, budget, method]:
                k, price = np.array(found["curve"]).T
                at = np.searchsorted(k, grid, side="right") - 1
                gap = 100.0 * (price[np.maximum(at, 0)] / results.best[name] - 1.0)
                rows.append(np.where(at < 0, np.nan, np.maximum(gap, floor)))
        known = np.isfinite(rows).all(axis=0)
        low, middle, high = np.quantile(np.array(rows)[:, known], (0.25, 0.5, 0.75), axis=0)
        curves.fill_between(grid[known], low, high, color=colour, alpha=0.18, linewidth=0.0)
        curves.plot(grid[known], middle, color=colour, label=METHODS[method])
    shown = [(k, gap) for k, gap in MEDIAN_ASKED.items() if k <= budget]
    curves.plot([k for k, _ in shown], [gap for _, gap in shown], "v", color=INK, markersize=5, label="asked: median")
    curves.set_xscale("log")
    curves.set_xlabel("evaluations")
    curves.set_title("median and quartiles of all runs", fontsize=9, color=INK)
    curves.legend(frameon=False, fontsize=8)
    rng = np.random.default_rng(0)  # jitter
    for i, b in enumerate(results.budgets):
        for j, (method, colour) in enumerate(_COLOURS.items()):
            gaps = np.maximum(results.gaps(b, method), floor)
            x = i + 0.27 * (j - 1) + rng.uniform(-0.09, 0.09, len(gaps))
            dots.plot(x, gaps, "o", color=colour, markersize=2.5, alpha=0.45, markeredgewidth=0.0)
            dots.plot([i + 0.27 * (j - 1) - 0.11, i + 0.27 * (j - 1) + 0.11], [np.median(gaps)] * 2, color=INK, lw=1.5)
    dots.set_xticks(range(len(results.budgets)), [f"{b:,}" for b in results.budgets])
    dots.set_xlabel("evaluations")
    dots.set_title("every run, and the median", fontsize=9, color=INK)
    for axes in (curves, dots):
        axes.set_yscale("log")
        axes.set_ylabel("gap, %")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.grid(axis="y", color=RULE, linewidth=0.6)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=8, length=2)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    save_png(path, figure)


def _draw_paths(path: Path, instances: Path, results: Results) -> None:
    """Draw the median run of every method at the most evaluations, over ground and threats."""
    columns = min(3, len(results.names))
    rows = -(-len(results.names) // columns)
    figure = new_figure(3.4 * columns, 3.6 * rows + 0.3)
    panels = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for panel in panels[len(results.names) :]:
        panel.set_axis_off()
    for panel, name in zip(panels, results.names, strict=False):
        _draw_map(panel, load(instances / f"{name}.npz"))
        for method, colour in _COLOURS.items():
            runs = sorted(results.runs[name, results.budgets[-1], method], key=lambda run: float(run["price"]))
            x, y, _ = np.array(runs[len(runs) // 2]["path"]).T
            panel.plot(x, y, color="white", linewidth=3.0)
            panel.plot(x, y, "-o", color=colour, linewidth=1.5, markersize=2.5)
        panel.set_title(name, fontsize=9, color=INK)
    handles = [Line2D([], [], color=colour, label=METHODS[method]) for method, colour in _COLOURS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    save_png(path, figure)


def _draw_map(axes: Axes, instance: Instance) -> None:
    arrays = instance.arrays
    rows, columns = arrays.height_m.shape
    shade = LightSource(315.0, 45.0).hillshade(arrays.height_m[::2, ::2], vert_exag=0.5, dx=2.0, dy=2.0)
    axes.imshow(0.55 + 0.4 * shade, extent=(1, columns, 1, rows), origin="lower", cmap="gray", vmin=0.0, vmax=1.0)
    for x, y, _, radius in arrays.threat:
        axes.add_patch(Circle((x, y), radius, facecolor="#b3261e", edgecolor="none", alpha=0.35))
    for place, mark in ((arrays.start, "o"), (arrays.end, "*")):
        axes.plot(*place[:2], mark, color=INK, markersize=8, zorder=5)
    axes.set(xlim=(1, columns), ylim=(1, rows), xticks=[], yticks=[], aspect="equal")
