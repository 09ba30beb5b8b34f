"""The UAV path objective, searched blindly and from a graph search of itself; ``missionplanner experiment uav``.

The graph search is made for this experiment: it prices legs by the objective's own formulas, all over the map. The
planner's first guesses (:mod:`missionplanner.seeds`) are others; a search is begun with these, too. What the graph
search takes is told beside the evaluations, which do not include it: its legs, how many evaluations these would be, and
its CPU time.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LightSource, LinearSegmentedColormap
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from PIL import Image

from missionplanner.errors import MissionError
from missionplanner.experiments import campaign
from missionplanner.experiments.document import gathered, provenance
from missionplanner.experiments.scene_comparison import planning_modules
from missionplanner.experiments.scene_figures import INK, MUTED, RULE, new_figure, save_png
from missionplanner.experiments.uav_objective import Instance, load, make
from missionplanner.experiments.uav_weaving import METHODS, ROUTES, first_guesses, search
from missionplanner.files import write_atomic, write_csv
from missionplanner.geodesy import FloatArray

Progress = Callable[[str, float], None]

BUDGETS = (2_500, 10_000, 100_000)
SEEDS = 15
MEDIAN_ASKED = {2_500: 3.0, 10_000: 1.0, 100_000: 0.3}
WORST_ASKED = 10.0
"""Gaps of the grey box in %; all its paths are to be free of penalties from 10,000 evaluations on."""

BEST_KNOWN = {
    "1a5e2ba163591157": 5951.2089,  # the benchmark's inst01
    "d717ba716817cfcd": 5669.3395,  # the benchmark's inst04
    "9add93431710cf3c": 7401.0368,  # the benchmark's inst08
    "eb9e82a6fdf8e41d": 5664.2903,  # the benchmark's inst12
    "0ef601b10bb4d91e": 7652.719,  # the benchmark's inst28
    "6aee2077fcda703f": 7926.1323,  # the benchmark's inst40
}
"""By the digest of an instance: the cheapest path ever found, by long runs of the grey box."""


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
    made: str  # on what and when

    @property
    def graph_evaluations(self) -> float:
        """How many evaluations the graph search's legs would be: the median over all searches."""
        return _median([graph for graphs in self.graphs.values() for graph in graphs], "evaluations")

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
            "all": [self.figures(budget, method, self.names) for budget in self.budgets for method in METHODS],
            "instances": {
                name: [self.figures(budget, method, [name]) for budget in self.budgets for method in METHODS]
                for name in self.names
            },
            "graph": {
                name: {"legs": _median(graphs, "legs"), "evaluations": _median(graphs, "evaluations"),
                       "seconds": _median(graphs, "seconds")}
                for name, graphs in self.graphs.items()
            },
        }  # fmt: skip

    def figures(self, budget: int, method: str, names: Sequence[str]) -> dict[str, Any]:
        """Return the figures of all runs with a method and budget."""
        gaps = self.gaps(budget, method, names)
        return {
            "evaluations": budget,
            "method": method,
            "gap_median": float(np.median(gaps)),
            "gap_mean": float(gaps.mean()),
            "gap_worst": float(gaps.max()),
            "free": self.free(budget, method, names),
            "seconds": _median([run for name in names for run in self.runs[name, budget, method]], "seconds"),
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
        known[name] = min(known.get(name, math.inf), BEST_KNOWN.get(digests[name], math.inf))
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
        version=campaign.version_of({"results": 2}, _DEPENDS_ON),
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
        tuple(paths),
        budgets,
        seeds,
        {name: min(found[name], known[name]) for name in paths},
        news,
        runs,
        graphs,
        gathered(every.values())[0],
    )


_DEPENDS_ON = (
    *planning_modules(),
    "missionplanner.experiments.uav_scene",
    "missionplanner.experiments.uav_weaving",
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
        known = {str(name): float(value) for name, value in found.items()}
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise MissionError(f"{best}: expected JSON of best values by instance, got: {error}") from error
    for name, value in known.items():
        if not 0.0 < value < math.inf:
            raise MissionError(f"{best}: {name}: expected a number above 0, got {value:g}: correct it or leave it out")
    return known


@lru_cache(maxsize=2)
def _loaded(path: str) -> Instance:
    return load(Path(path))


@cache
def _warm_up() -> None:
    """Compile all methods on a small plain, or read them from the cache: none of their time."""
    ends = np.array([[10.0, 10.0, 150.0], [110.0, 100.0, 150.0]])
    plain = make("plain", np.zeros((120, 120)), np.array([[60.0, 50.0, 0.0, 8.0]]), *ends)
    routes = first_guesses(plain, 0)
    for method in METHODS:
        search(plain, method=method, evaluations=300, seed=0, routes=routes)


def run(path: str, evaluations: int, seed: int) -> dict[str, Any]:
    """Search one instance in all methods with one seed."""
    instance = _loaded(path)
    _warm_up()
    began_s = time.thread_time()
    routes = first_guesses(instance, seed)
    legs_each = instance.dimensions // 3 + 1
    out: dict[str, Any] = {
        **provenance(),
        "graph": {
            "legs": routes.legs,
            "evaluations": -(-routes.legs // legs_each),
            "seconds": round(time.thread_time() - began_s, 3),
        },
    }
    for method in METHODS:
        began_s = time.thread_time()
        found = search(instance, method=method, evaluations=evaluations, seed=seed, routes=routes)
        out[method] = {
            "price": found.price,
            "free": bool(instance.free(found.point[None])[0]),
            "seconds": round(time.thread_time() - began_s, 3),
            "curve": _thinned(found.curve),
            "path": np.round(instance.waypoints_m(found.point[None])[0], 3).tolist(),
        }
    return out


def _thinned(curve: Sequence[tuple[int, float]]) -> list[tuple[int, float]]:
    """Return the last point of a curve in every step of evaluations by a twentieth of a decade."""
    last = {round(20.0 * math.log10(k)): (k, price) for k, price in curve}
    return list(last.values())


# --- what is written -------------------------------------------------------------------------------------------------

_GROUND = LinearSegmentedColormap.from_list("ground", ["#b9c4b1", "#e9e3d3", "#d9c7a8", "#b89c7c", "#f7f5f2"])
_COLOURS = {"black": MUTED, "planned": "#009e73", "guessed": "#0072b2", "grey": "#d55e00"}
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
        "# The UAV path objective, with and without a graph search of the objective itself",
        "",
        f"Gap: excess over the best known value in %, over {results.seeds} seeds: median / worst, and the share of "
        "paths without penalty. *Black box*: PSO-ABC-SA. *Planner's guesses*: the same, begun with the planner's "
        "own first guesses, which do not know the objective. *Guessed*: the same, begun with the paths of a graph "
        "search of the objective itself, made for this experiment. *Grey box*: "
        "the graph's paths, woven by dynamic programming; there is no PSO-ABC-SA in it. The graph search is not among "
        "the evaluations of guessed and grey box: it prices legs worth the evaluations that are told beside them.",
        "",
        results.made,
    ]
    for budget in results.budgets:
        more = f"guessed and grey box: + {results.graph_evaluations:,.0f} worth of legs of the graph"
        lines += [
            "",
            f"## {budget:,} evaluations ({more})",
            "",
            f"| instance | best known | {' | '.join(METHODS.values())} |",
        ]
        lines.append("|---" * (2 + len(METHODS)) + "|")
        for name in results.names:
            known = f"{results.best[name]:,.1f}{' (of these runs)' if name in results.news else ''}"
            cells = [_cell(results, budget, method, [name]) for method in METHODS]
            lines.append(f"| {name} | {known} | {' | '.join(cells)} |")
        cells = [_cell(results, budget, method, results.names) for method in METHODS]
        lines.append(f"| **all** | | {' | '.join(cells)} |")
    lines += [
        "",
        "## What a search takes, in CPU seconds (median)",
        "",
        f"| evaluations | {' | '.join(METHODS.values())} |",
    ]
    lines.append("|---" * (1 + len(METHODS)) + "|")
    for budget in results.budgets:
        seconds = [results.figures(budget, method, results.names)["seconds"] for method in METHODS]
        cells = [f"{value:.2f}" for value in seconds]
        lines.append(f"| {budget:,} | {' | '.join(cells)} |")
    lines += ["", "The graph search comes on top, once per seed, and is not among the evaluations:", ""]
    lines.append("| instance | legs priced | as evaluations | CPU seconds |")
    lines.append("|---|---|---|---|")
    for name, graphs in results.graphs.items():
        lines.append(
            f"| {name} | {_median(graphs, 'legs'):,.0f} | {_median(graphs, 'evaluations'):,.0f} | "
            f"{_median(graphs, 'seconds'):.2f} |"
        )
    for asked in results.asked():
        lines += [
            "",
            f"Asked of the grey box at {asked['evaluations']:,} evaluations (+ {results.graph_evaluations:,.0f} worth "
            f"of legs of the graph): median gap <= {asked['median_asked']:g} "
            f"%, worst <= {asked['worst_asked']:g} %{', all free' if asked['evaluations'] >= 10_000 else ''}: "
            f"{'kept' if asked['kept'] else 'not kept'}.",
        ]
    lines += ["", "![gap over evaluations](gaps.png)", "", "![paths from above](paths.png)"]
    return "\n".join(lines) + "\n"


def _cell(results: Results, budget: int, method: str, names: Sequence[str]) -> str:
    found = results.figures(budget, method, names)
    return f"{found['gap_median']:.2f} / {found['gap_worst']:.2f}, {100.0 * found['free']:.0f} %"


def _draw_gaps(path: Path, results: Results) -> None:
    """Draw the gap over evaluations, over all runs; then run by run at every budget."""
    figure = new_figure(9.0, 3.6)
    curves, dots = figure.subplots(1, 2)
    budget = results.budgets[-1]
    grid = np.geomspace(min(ROUTES, budget), budget, 200)
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
    curves.set_xlabel("evaluations (the graph search is not among them)")
    curves.set_title("median and quartiles of all runs", fontsize=9, color=INK)
    curves.legend(frameon=False, fontsize=8)
    rng = np.random.default_rng(0)  # jitter
    for i, b in enumerate(results.budgets):
        for j, (method, colour) in enumerate(_COLOURS.items()):
            gaps = np.maximum(results.gaps(b, method), floor)
            x = i + 0.2 * (j - 1.5) + rng.uniform(-0.06, 0.06, len(gaps))
            dots.plot(
                [i + 0.2 * (j - 1.5) - 0.08, i + 0.2 * (j - 1.5) + 0.08], [np.median(gaps)] * 2, color=INK, lw=1.5
            )
            dots.plot(x, gaps, "o", color=colour, markersize=2.5 if len(gaps) > 3 else 5.0,
                      alpha=0.45 if len(gaps) > 3 else 1.0, markeredgewidth=0.0, zorder=3)  # fmt: skip
    dots.set_xticks(range(len(results.budgets)), [f"{b:,}" for b in results.budgets])
    dots.set_xlabel("evaluations")
    dots.set_title("every run, and the median", fontsize=9, color=INK)
    for axes in (curves, dots):
        axes.set_yscale("log")
        axes.set_ylabel(f"gap, % (what is less is drawn at {floor:g})")
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
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    small = io.BytesIO()
    # The ground has most of the pixels; this keeps the colours of thin lines, too.
    few = Image.open(buffer).convert("RGB").quantize(255, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few.save(small, format="png", optimize=True)
    write_atomic(path, small.getvalue())


def _draw_map(axes: Axes, instance: Instance) -> None:
    arrays = instance.arrays
    rows, columns = arrays.height_m.shape
    height = arrays.height_m[::3, ::3].astype(float)
    ground = LightSource(315.0, 45.0).shade(height, _GROUND, blend_mode="soft", vert_exag=0.5, dx=3.0, dy=3.0)
    few = Image.fromarray((255.0 * ground[..., :3]).astype(np.uint8)).quantize(32, dither=Image.Dither.NONE)
    axes.imshow(few.convert("RGB"), extent=(1, columns, 1, rows), origin="lower", interpolation="nearest")
    for x, y, _, radius in arrays.threat:
        axes.add_patch(Circle((x, y), radius, facecolor="#b3261e", edgecolor="#7d1a15", linewidth=0.5, alpha=0.4))
    for place, mark in ((arrays.start, "o"), (arrays.end, "*")):
        axes.plot(*place[:2], mark, color=INK, markersize=8, zorder=5)
    axes.set(xlim=(1, columns), ylim=(1, rows), xticks=[], yticks=[], aspect="equal")
