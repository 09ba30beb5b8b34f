"""What each part of PSO-ABC-SA's best form is worth; ``missionplanner experiment ablation``.

Every variant is the algorithm without one of its parts. All search the same problems with the same seeds: the test
functions, and instances of the UAV path objective if a folder of them is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from missionplanner.errors import MissionError
from missionplanner.experiments import campaign, uav_objective
from missionplanner.experiments.document import machine
from missionplanner.experiments.scene_figures import new_figure, save_png
from missionplanner.experiments.statistics import Friedman, friedman, holm, signed_rank
from missionplanner.experiments.table2 import excess
from missionplanner.experiments.test_functions import FUNCTIONS, find_function
from missionplanner.files import write_atomic, write_csv
from missionplanner.search.base import FloatArray
from missionplanner.search.pso_abc_sa import PsoAbcSa, PsoAbcSaSettings, population_for

Progress = Callable[[str, float], None]

EVALUATIONS, RUNS = 10_000, 21
WHOLE = "whole"

_COLOURS = ("#0072B2", "#D55E00", "#000000")

VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    WHOLE: ("the algorithm", {}),
    "one group": ("bees together from the start", {"groups": False}),
    "no memory": ("factors and shares drawn around constants", {"memory": False}),
    "no archive": ("differences among present sources only", {"archive": False}),
    "no blocks": ("coordinates change one by one only", {"blocks": False}),
    "half way to walls": ("bees that would leave the box stop half way to its wall", {"walls": False}),
    "no shrinking": ("as many bees to the end", {"shrink": 0.0}),
    "no leader": ("no flight: bees alone", {"flight": False}),
    "no scouts": ("leaders that are behind are not recalled", {"scouts": False}),
    "no annealing": ("leaders that are behind are always recalled", {"annealing": False}),
}
"""Name, what is different, and the settings that make it so."""


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Excess (runs, variants) of every problem: over the known minimum, or over the best of all runs."""

    evaluations: int
    runs: int
    variants: tuple[str, ...]
    excess: Mapping[str, FloatArray]
    free: Mapping[str, npt.NDArray[np.bool_]]  # (runs, variants), UAV instances only

    def blocks(self, names: tuple[str, ...]) -> FloatArray:
        """Return the excesses of some problems (problems * runs, variants)."""
        return np.concatenate([self.excess[name] for name in names])

    def ranked(self, names: tuple[str, ...]) -> Friedman:
        """Rank the variants over every run of some problems."""
        return friedman(self.blocks(names))

    @property
    def functions(self) -> tuple[str, ...]:
        """The test functions among the problems."""
        return tuple(name for name in self.excess if name not in self.free)


def main(
    folder: Path,
    *,
    runs: int = RUNS,
    evaluations: int = EVALUATIONS,
    instances: Path | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and write its tables and its figure to a folder; return its figures as JSON values."""
    results = measure(folder, runs, evaluations, instances, workers=workers, cluster=cluster, progress=progress)
    write_csv(
        folder / "ablation.csv",
        ["problem", "variant", "seed", "excess"],
        [
            [name, variant, seed, repr(float(found[seed, k]))]
            for name, found in results.excess.items()
            for k, variant in enumerate(results.variants)
            for seed in range(results.runs)
        ],
    )
    write_atomic(folder / "results.md", table(results))
    save_png(folder / "ranks.png", _figure(results))
    return as_json(results)


def measure(
    folder: Path,
    runs: int,
    evaluations: int,
    instances: Path | None = None,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> Results:
    """Run every variant on every problem, as often as asked; only what the folder does not hold is run."""
    maps = _maps(instances) if instances is not None else {}
    problems: dict[str, str | None] = {f.name: None for f in FUNCTIONS} | {n: str(p) for n, p in maps.items()}
    jobs = {
        (name, variant, seed): campaign.Job(
            f"{name}/{variant}/{seed}",
            search,
            {"problem": name, "path": path, "variant": variant, "evaluations": evaluations, "seed": seed},
        )
        for name, path in problems.items()
        for variant in VARIANTS
        for seed in range(runs)
    }
    version = campaign.version_of(
        {"evaluations": evaluations, "variants": VARIANTS},
        ("missionplanner.search", "missionplanner.experiments.test_functions"),
    )
    found = campaign.run(
        list(jobs.values()),
        folder,
        experiment="ablation",
        version=version,
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    missed, free = {}, {}
    for name, path in problems.items():
        rows = [[found[jobs[name, variant, seed].key] for variant in VARIANTS] for seed in range(runs)]
        cost = np.array([[one["cost"] for one in row] for row in rows])
        missed[name] = excess(cost, find_function(name).minimum) if path is None else cost - cost.min()
        if path is not None:
            free[name] = np.array([[one["free"] for one in row] for row in rows])
    return Results(evaluations, runs, tuple(VARIANTS), missed, free)


def search(problem: str, path: str | None, variant: str, evaluations: int, seed: int) -> dict[str, Any]:
    """Return what one run of one variant found; ``free`` says whether a path pays no penalty."""
    settings = PsoAbcSaSettings(**VARIANTS[variant][1])
    if path is None:
        f = find_function(problem)
        return {"cost": _least(f.cost, f.lower, f.upper, settings, evaluations, seed)[0]}
    instance = _instance(path)
    cost, best = _least(
        lambda x: instance.price(x, threads=1), instance.lower, instance.upper, settings, evaluations, seed
    )
    return {"cost": cost, "free": bool(instance.free(best[np.newaxis])[0])}


@cache
def _instance(path: str) -> uav_objective.Instance:
    return uav_objective.load(Path(path))


def _maps(folder: Path) -> dict[str, Path]:
    paths = {path.stem: path.resolve() for path in sorted(folder.glob("*.npz"))}
    if not paths:
        raise MissionError(f"{folder}: expected a folder with instances of the UAV objective (*.npz), got none")
    return paths


def _least(
    cost: Callable[[FloatArray], FloatArray],
    lower: FloatArray,
    upper: FloatArray,
    settings: PsoAbcSaSettings,
    evaluations: int,
    seed: int,
) -> tuple[float, FloatArray]:
    """Return the least cost and where, as :func:`missionplanner.minimise` finds them with these settings."""
    rng = np.random.default_rng(seed)
    dimensions = len(lower)
    optimiser = PsoAbcSa(rng.random((population_for(dimensions, evaluations), dimensions)), evaluations, rng, settings)
    least, best, used = np.inf, lower, 0
    with np.errstate(all="ignore"):
        while True:
            points = np.clip(lower + optimiser.ask() * (upper - lower), lower, upper)[: evaluations - used]
            found = cost(points)
            used += len(points)
            if found.min() < least:
                least, best = float(found.min()), points[int(np.argmin(found))].copy()
            if used == evaluations:
                return least, best
            optimiser.tell(found)


# --- what is made of it ----------------------------------------------------------------------------------------------


def mean_ranks(results: Results) -> dict[str, FloatArray]:
    """Return every problem's mean rank of each variant (variants,): free of the problem's scale."""
    return {name: friedman(found).ranks for name, found in results.excess.items()}


def compared(results: Results) -> dict[str, dict[str, float]]:
    """Return how every variant does beside the whole: runs in which it is better, equal, worse; p over the problems.

    p: signed ranks of the problems' mean ranks, corrected by Holm.
    """
    blocks = results.blocks(tuple(results.excess))
    own = results.variants.index(WHOLE)
    others = [k for k in range(len(results.variants)) if k != own]
    ranks = np.array([*mean_ranks(results).values()])
    p = holm([signed_rank(ranks[:, own], ranks[:, k]) for k in others])
    return {
        results.variants[k]: {
            "better": int((blocks[:, k] < blocks[:, own]).sum()),
            "equal": int((blocks[:, k] == blocks[:, own]).sum()),
            "worse": int((blocks[:, k] > blocks[:, own]).sum()),
            "p_holm": float(corrected),
        }
        for k, corrected in zip(others, p, strict=True)
    }


def _ranks(results: Results) -> dict[str, Friedman]:
    """Return the ranks over the kinds of problems there are, and over all."""
    kinds = {"test functions": results.functions, "UAV objective": tuple(results.free)}
    if not results.free:
        return {"test functions": results.ranked(results.functions)}
    return {kind: results.ranked(names) for kind, names in kinds.items()} | {
        "all": results.ranked(tuple(results.excess))
    }


def as_json(results: Results) -> dict[str, Any]:
    """Return plain JSON values."""
    return {
        "evaluations": results.evaluations,
        "runs": results.runs,
        "friedman": {
            kind: {"p": found.p, "ranks": dict(zip(results.variants, found.ranks.tolist(), strict=True))}
            for kind, found in _ranks(results).items()
        },
        "beside_the_whole": compared(results),
        "median_excess": {
            name: dict(zip(results.variants, np.median(found, axis=0).tolist(), strict=True))
            for name, found in results.excess.items()
        },
        "free": dict(zip(results.variants, _free(results), strict=True)) if results.free else {},
    }


def _free(results: Results) -> list[float]:
    """Return every variant's share of runs without penalty."""
    shares: list[float] = np.concatenate([*results.free.values()]).mean(axis=0).tolist()
    return shares


# --- what is written -------------------------------------------------------------------------------------------------


def table(results: Results) -> str:
    """Return the figures as Markdown."""
    ranks, beside = _ranks(results), compared(results)
    free = [f"{share:.0%}" for share in _free(results)] if results.free else []
    head = ["variant", *(f"rank, {kind}" for kind in ranks), "better / equal / worse runs", "p (Holm)"]
    rows = []
    for k, variant in enumerate(results.variants):
        c = beside.get(variant)
        rows.append(
            [
                f"**{variant}**" if variant == WHOLE else f"{variant}: {VARIANTS[variant][0]}",
                *(f"{found.ranks[k]:.2f}" for found in ranks.values()),
                f"{c['better']} / {c['equal']} / {c['worse']}" if c else "",
                f"{c['p_holm']:.2g}" if c else "",
                *free[k : k + 1],
            ]
        )
    lines = [
        f"# Ablation of PSO-ABC-SA's best form: {results.evaluations:,} evaluations, {results.runs} runs",
        "",
        machine(),
        "",
        "Mean ranks over every run of every problem, 1 the best; runs are compared with the whole on the same problem "
        "and seed; p by signed ranks of the problems' mean ranks.",
        "",
        *_markdown([*head, *(["free of penalty"] if free else [])], rows),
        "",
        "Median excess over the known minimum (UAV instances: over the best run of all here):",
        "",
        *_markdown(
            ["problem", *results.variants],
            [[name, *(f"{value:.3g}" for value in np.median(found, axis=0))] for name, found in results.excess.items()],
        ),
        "",
        "![mean ranks](ranks.png)",
    ]
    return "\n".join(lines) + "\n"


def _markdown(head: list[str], rows: list[list[str]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows]]


def _figure(results: Results) -> Figure:
    ranks = _ranks(results)
    figure = new_figure(8.0, 0.42 * len(results.variants) + 1.3)
    axes = figure.add_subplot()
    for (kind, found), colour, marker in zip(ranks.items(), _COLOURS, "osD", strict=False):
        axes.plot(found.ranks, range(len(results.variants)), marker, color=colour, label=kind, markersize=7, ls="")
    axes.set_yticks(range(len(results.variants)), results.variants)
    axes.invert_yaxis()
    for found, colour in zip(ranks.values(), _COLOURS, strict=False):
        axes.axvline(found.ranks[results.variants.index(WHOLE)], color=colour, alpha=0.4, lw=1)
    axes.set_xlabel("mean rank (1 the best); lines: the whole algorithm")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return figure
