"""Our search beside those of other libraries; ``missionplanner experiment peers``.

On the UAV objective (:mod:`.uav_objective`, instances from a folder) and on the paper's scenes, posed as in
:mod:`.scene_runs` (its first vehicle, control points anywhere, the mission's price). Everybody gets the same
evaluations, counted by a :class:`~.contenders.Tally`, or the same processor time, a thread each: on an idle machine
that is wall time, on a busy one it is still the same work. Nobody gets first guesses: what those are worth is measured
by `uav`; sampling planners (OMPL), which search paths and not boxes, stand beside ours in `lengths`.

Runs are kept by what they depend on: the problem's values and the code that judges them, the library's version and how
it is called, and for our optimisers their source. A run of the same folder after a change of ours runs ours again and
nobody else. Every run says where and when it was made.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from missionplanner.errors import MissionError
from missionplanner.experiments import campaign, scene_runs, uav_objective, uav_search
from missionplanner.experiments.contenders import INSTALL, PEERS, Contender, Tally, code_of, find_contender, ours
from missionplanner.experiments.document import gathered, provenance
from missionplanner.experiments.scene_figures import COLOURS, new_figure, save_png
from missionplanner.experiments.statistics import friedman, holm, median_interval, stratified_rank_sum
from missionplanner.files import write_atomic, write_csv
from missionplanner.mission import load_mission

Progress = Callable[[str, float], None]
FloatArray = npt.NDArray[np.float64]

BUDGETS, SEEDS = (10_000, 100_000), 15
SCENE_BUDGET = 10_000
"""The paper's: 50 particles, 200 iterations."""

BEST, PAPER_FORM = "pso-abc-sa", "pso-abc-sa-paper"
OURS = (BEST, PAPER_FORM)

_SLOW_FROM = 10_001  # evaluations that slow libraries do only when asked to
_CALIBRATION = 2000  # evaluations by which the schedules of timed runs are set
_WARM = 200
_GRID = 60
_LEAST_PERCENT = 0.1  # that a figure shows
_QUICK = (1000,), 2, 1000


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A function to minimise over a box, and whether a point of it is free of penalties."""

    name: str
    price: Callable[[FloatArray], FloatArray]
    lower: FloatArray
    upper: FloatArray
    free: Callable[[FloatArray], bool]
    modules: tuple[str, ...]  # of this package, that say what its points cost and which are free

    def digest(self) -> str:
        """Return a digest of its code, of its box, and of its values at fixed points, to nine digits."""
        rng = np.random.default_rng(0)
        points = self.lower + rng.random((64, len(self.lower))) * (self.upper - self.lower)
        values = np.concatenate([self.lower, self.upper, self.price(points)])
        told = [*(f"{v:.8e}" for v in values), *(code_of(f"missionplanner.experiments.{m}") for m in self.modules)]
        return hashlib.sha256(" ".join(told).encode()).hexdigest()[:10]


@dataclass(frozen=True, slots=True)
class Run:
    """What came of one search."""

    cost: float
    free: bool
    evaluations: int
    cpu_s: float
    curve: tuple[tuple[int, float, float], ...]  # evaluations, seconds, best cost
    machine: str
    date: str


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All runs: by problem, contender and budget (evaluations; 0: by time)."""

    scenes: tuple[str, ...]
    instances: tuple[str, ...]
    contenders: tuple[Contender, ...]
    absent: tuple[Contender, ...]
    seconds: float | None
    known: Mapping[str, float]  # best costs of problems, from before
    runs: Mapping[tuple[str, str, int], tuple[Run, ...]]

    @property
    def budgets(self) -> list[int]:
        """The budgets of the UAV objective."""
        return sorted({budget for problem, _, budget in self.runs if problem in self.instances})

    @property
    def scene_budget(self) -> int:
        """The budget of the scenes."""
        return next((budget for problem, _, budget in self.runs if problem in self.scenes), SCENE_BUDGET)

    def best(self, problem: str) -> float:
        """Return the least cost known of a problem: before, or by any run here."""
        found = min(run.cost for (name, _, _), runs in self.runs.items() if name == problem for run in runs)
        return min(found, self.known.get(problem, np.inf))

    def who(self, problems: Sequence[str], budget: int) -> list[Contender]:
        """Return who ran all of some problems with a budget."""
        return [c for c in self.contenders if all((p, c.name, budget) in self.runs for p in problems)]

    def gaps(self, problems: Sequence[str], contender: str, budget: int) -> FloatArray:
        """Return by how many percent all runs (problems * seeds,) missed the best."""
        return np.array(
            [
                100.0 * (run.cost / self.best(problem) - 1.0)
                for problem in problems
                for run in self.runs[problem, contender, budget]
            ]
        )


def main(
    output: Path,
    *,
    instances: Path | None = None,
    scenes: Sequence[Path] = (),
    budgets: Sequence[int] = BUDGETS,
    seeds: int = SEEDS,
    seconds: float | None = None,
    slow_peers: bool = False,
    quick: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and write its tables and figure to a folder; return its figures as JSON values."""
    scene_budget = SCENE_BUDGET
    if quick:
        budgets, seeds, scene_budget = _QUICK
    results = run(
        output,
        [c for c in ours() if c.name in OURS] + list(PEERS),
        instances=instances,
        scenes=scenes,
        budgets=budgets,
        seeds=seeds,
        scene_budget=scene_budget,
        seconds=seconds,
        slow_peers=slow_peers,
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    _write(output, results)
    return as_json(results)


def run(
    folder: Path,
    contenders: Sequence[Contender],
    *,
    instances: Path | None,
    scenes: Sequence[Path],
    budgets: Sequence[int],
    seeds: int,
    scene_budget: int = SCENE_BUDGET,
    seconds: float | None = None,
    slow_peers: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> Results:
    """Run every contender on every problem; only what the folder does not hold is run.

    A cluster's workers read the instances from the paths that they have here.

    Raises
    ------
    MissionError
        No instances where some were named, nothing to search, two problems of one name, or no time, or time to be
        shared on a cluster.
    """
    if seconds is not None:
        if not 0.0 < seconds < math.inf:
            raise MissionError(f"--seconds: expected a time above 0, got {seconds:g}")
        if cluster is not None:
            raise MissionError("--seconds: expected searches on this machine, got --cluster: times would not compare")
        workers = workers or 1  # two at once would take caches from each other
    found = sorted(instances.glob("*.npz")) if instances is not None else []
    if instances is not None and not found:
        raise MissionError(f"--instances {instances}: expected a folder with instances (*.npz), found none")
    if min(budgets, default=1) < 1:
        raise MissionError(f"--evaluations: expected numbers of at least 1, got {min(budgets)}")
    if not found and not scenes:
        raise MissionError("peers: expected something to search: name --instances FOLDER, or a --scene")
    named: dict[str, Path] = {}
    for path in (*found, *scenes):
        if path.stem in named:
            raise MissionError(
                f"peers: expected problems of different names, got {named[path.stem]} and {path}: rename one"
            )
        named[path.stem] = path
    sources = {path.stem: _instance(path) for path in found} | {path.stem: _scene(path) for path in scenes}
    digests = {path.stem: uav_search.digest(uav_objective.load(path)) for path in found}
    known = {name: uav_search.BEST_KNOWN.get(digest, np.inf) for name, digest in digests.items()}
    present = [c for c in contenders if c.installed]
    jobs: dict[tuple[str, str, int, int], campaign.Job] = {}
    for name, source in sources.items():
        digest = problem(**source).digest()
        wanted = [scene_budget] if source["kind"] == "scene" else budgets
        for c, own in ((c, c.digest()) for c in present):
            for budget in [0] if seconds is not None else wanted:
                if c.slow and budget >= _SLOW_FROM and not slow_peers:
                    continue
                arguments = {"source": source, "contender": c.name, "evaluations": budget, "seconds": seconds}
                for seed in range(seeds):
                    key = f"{name}@{digest}/{c.name}@{own}/{f'{seconds:g}s' if seconds else budget}/{seed}"
                    jobs[name, c.name, budget, seed] = campaign.Job(key, search, {**arguments, "seed": seed})
    kept = campaign.run(
        list(jobs.values()),
        folder,
        experiment="peers",
        version="2",  # all that a run depends on is in its key
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    runs: dict[tuple[str, str, int], tuple[Run, ...]] = {}
    for (name, contender, budget, _), job in jobs.items():
        told = kept[job.key]
        curve = tuple((int(e), float(s), float(cost)) for e, s, cost in told["curve"])
        one = Run(
            told["cost"],
            told["free"],
            told["evaluations"],
            told["cpu_s"],
            curve,
            told["machine"],
            told["date"],
        )
        runs[name, contender, budget] = (*runs.get((name, contender, budget), ()), one)
    return Results(
        tuple(path.stem for path in scenes),
        tuple(path.stem for path in found),
        tuple(present),
        tuple(c for c in contenders if not c.installed),
        seconds,
        known,
        runs,
    )


def _instance(path: Path) -> dict[str, str]:
    return {"kind": "uav", "text": str(path.resolve())}


def _scene(path: Path) -> dict[str, str]:
    load_mission(path)  # what is wrong with it is told before any work
    return {"kind": "scene", "text": path.read_text(encoding="utf-8")}


@lru_cache(maxsize=8)
def problem(kind: str, text: str) -> Problem:
    """Return the problem of an instance's file, or of a mission's text."""
    if kind == "uav":
        instance = uav_objective.load(Path(text))
        return Problem(
            instance.name,
            lambda points: instance.price(points, threads=1),
            instance.lower,
            instance.upper,
            lambda point: bool(instance.free(point[None])[0]),
            ("uav_objective",),
        )
    scene, judge = scene_runs.resolved(text)
    family, price = scene_runs.curves(scene, 0), scene_runs.price_of(scene, 0, [])

    def free(point: FloatArray) -> bool:
        kept = judge.kept(family.paths(point[None])[0])
        return bool(kept.height_m > 0.0 and kept.obstacle_m > 0.0)

    return Problem(
        scene.mission.name,
        lambda points: price.total(family.paths(points)),
        family.lower,
        family.upper,
        free,
        ("scene_runs", "scene_judge", "proof_oracle"),
    )


def search(
    source: Mapping[str, str],
    contender: str,
    evaluations: int,
    seconds: float | None,
    seed: int,
    clock: Callable[[], float] = time.process_time,
) -> dict[str, Any]:
    """Return what one search found: with so many evaluations, or in so many seconds of the processor.

    Raises
    ------
    MissionError
        The seconds were over before anything was priced.
    """
    asked, who = problem(**source), find_contender(contender)
    _warm(contender, source["kind"], source["text"])

    def searched(budget: int, limit_s: float | None) -> tuple[Tally, float]:
        begin_s = clock()
        tally = who.run(
            asked.price, asked.lower, asked.upper, evaluations=budget, seed=seed, seconds=limit_s, clock=clock
        )
        return tally, clock() - begin_s

    if seconds is not None:  # schedules need a budget: as many as a short run says there is time for
        evaluations = max(_CALIBRATION, int(_CALIBRATION * seconds / max(searched(_CALIBRATION, None)[1], 1e-6)))
    tally, cpu_s = searched(evaluations, seconds)
    if not tally.used:
        raise MissionError(f"--seconds: expected time for one evaluation at least, got {seconds:g}, too little here")
    return {
        **provenance(),
        "cost": tally.cost,
        "free": asked.free(tally.best),
        "evaluations": tally.used,
        "cpu_s": cpu_s,
        "curve": [[used, round(at_s, 5), cost] for used, at_s, cost in tally.curve],
        "best": tally.best.tolist(),
    }


@cache
def _warm(contender: str, kind: str, text: str) -> None:
    """Import and compile what a search needs: that is nobody's search time."""
    asked = problem(kind, text)
    find_contender(contender).run(asked.price, asked.lower, asked.upper, evaluations=_WARM, seed=0)
    asked.free(asked.lower)


# --- what is made of it ----------------------------------------------------------------------------------------------


def summary(results: Results, problems: Sequence[str], budget: int) -> list[dict[str, Any]]:
    """Return a row per contender who ran all of these problems with this budget, the lowest median gap first."""
    who = [c.name for c in results.who(problems, budget)]
    if not who:
        return []
    gaps = np.stack([results.gaps(problems, name, budget) for name in who], axis=1)
    ranks = friedman(gaps).ranks if len(who) > 1 else np.ones(1)
    against = _against(results, problems, budget, [name for name in who if name != BEST]) if BEST in who else {}
    rows = []
    for k, name in enumerate(who):
        runs = [run for problem in problems for run in results.runs[problem, name, budget]]
        rows.append(
            {
                "contender": name,
                "ours": find_contender(name).ours,
                "gap_median_percent": float(np.median(gaps[:, k])),
                "gap_median_interval_percent": list(median_interval(gaps[:, k], np.random.default_rng(0))),
                "gap_mean_percent": float(np.mean(gaps[:, k])),
                "gap_worst_percent": float(np.max(gaps[:, k])),
                "free": float(np.mean([run.free for run in runs])),
                "rank": float(ranks[k]),
                "p_holm": against.get(name),
                "cpu_s_per_10000": float(np.median([1e4 * run.cpu_s / run.evaluations for run in runs])),
                "evaluations_median": float(np.median([run.evaluations for run in runs])),
                "runs": len(runs),
            }
        )
    return sorted(rows, key=lambda row: row["gap_median_percent"])


def _against(results: Results, problems: Sequence[str], budget: int, others: Sequence[str]) -> dict[str, float]:
    """Return p of rank sums of the best form against others: problem by problem, together, corrected by Holm."""

    def costs(name: str, problem: str) -> list[float]:
        return [run.cost for run in results.runs[problem, name, budget]]

    found = [stratified_rank_sum([(costs(BEST, p), costs(name, p)) for p in problems]) for name in others]
    return dict(zip(others, holm(found).tolist(), strict=True))


def left_out(results: Results, problems: Sequence[str], budget: int) -> list[str]:
    """Return who is not in the table of these problems with this budget: too slow for it, or not installed."""
    there = results.who(problems, budget)
    return [c.name for c in (*results.contenders, *results.absent) if c not in there]


def verdict(rows: Sequence[Mapping[str, Any]], left_out: Sequence[str] = ()) -> dict[str, Any] | None:
    """Return how the best form stands against all others of a table: lower in the median gap, more often free."""
    own = next((row for row in rows if row["contender"] == BEST), None)
    others = [row for row in rows if row["contender"] not in OURS]
    if own is None or not others:
        return None
    nearest, freest = min(others, key=lambda row: row["gap_median_percent"]), max(others, key=lambda row: row["free"])
    gap, free = "gap_median_percent", "free"
    return {
        "lowest_gap": own[gap] < nearest[gap],
        "nearest": nearest["contender"],
        "most_free": own[free] > freest[free],
        "freest": freest["contender"],
        "left_out": list(left_out),
        "words": f"{BEST}: median gap {own[gap]:.2f} %, free {100.0 * own[free]:.0f} %; of the others run "
        f"{nearest['contender']} has the lowest gap, {nearest[gap]:.2f} %, and {freest['contender']} is most often "
        f"free, {100.0 * freest[free]:.0f} %." + (f" Not run: {', '.join(left_out)}." if left_out else ""),
    }


def as_json(results: Results) -> dict[str, Any]:
    """Return plain JSON values."""
    return {
        "seconds": results.seconds,
        "absent": [c.name for c in results.absent],
        "uav": [
            {"budget": b, "rows": rows, "verdict": verdict(rows, left_out(results, results.instances, b))}
            for b in results.budgets
            for rows in [summary(results, results.instances, b)]
        ],
        "instances": _per_problem(results, results.instances, results.budgets),
        "scenes": _per_problem(results, results.scenes, [0 if results.seconds is not None else results.scene_budget]),
        "scene_rows": {
            name: summary(results, [name], 0 if results.seconds is not None else results.scene_budget)
            for name in results.scenes
        },
    }


def _per_problem(results: Results, problems: Sequence[str], budgets: Sequence[int]) -> list[dict[str, Any]]:
    """Return, problem by problem, the medians of the best form and of the best of the others."""
    rows = []
    for name in problems:
        for budget in budgets:
            medians = {
                c.name: float(np.median([run.cost for run in results.runs[name, c.name, budget]]))
                for c in results.who([name], budget)
            }
            others = {who: cost for who, cost in medians.items() if who not in OURS}
            first = min(others, key=others.__getitem__) if others else None
            rows.append(
                {
                    "problem": name,
                    "budget": budget,
                    "best_known": results.best(name),
                    "ours_median": medians.get(BEST),
                    "best_peer": first,
                    "best_peer_median": None if first is None else others[first],
                }
            )
    return rows


# --- what is written -------------------------------------------------------------------------------------------------


def _write(folder: Path, results: Results) -> None:
    write_csv(
        folder / "peers.csv",
        ["problem", "contender", "budget", "seed", "cost", "free", "evaluations", "cpu_s"],
        [
            [*key, seed, one.cost, int(one.free), one.evaluations, round(one.cpu_s, 4)]
            for key, runs in results.runs.items()
            for seed, one in enumerate(runs)
        ],
    )
    write_atomic(folder / "results.md", table(results))
    save_png(folder / "gap.png", _drawn(results))


def table(results: Results) -> str:
    """Return the figures as Markdown."""
    lines = ["# Beside other libraries", ""]
    limit = "the evaluations" if results.seconds is None else f"{results.seconds:g} s of processor time"
    when, comparable = _made(results)
    lines += [
        f"For everybody the same: {limit}. Gap: excess over the best cost known, by any run here or before; in "
        "brackets the median's bootstrapped interval. Free: without penalty. Rank: Friedman's over all runs. "
        f"p: rank sums of runs on these instances, {BEST} against each, problem by problem and taken together (van "
        "Elteren), corrected by Holm; those of 0.05 and more are not told apart. Our optimisers of one population "
        "share their first points, seed by seed. "
        + (
            "Processor time includes the function's own."
            if comparable
            else "Times are left out: those of different machines do not compare."
        ),
        "",
        when,
    ]
    if results.instances:
        lines += ["", f"## UAV objective, {len(results.instances)} instances"]
        for budget in results.budgets:
            lines += _table_lines(results, results.instances, budget)
        lines += _problem_lines(results, results.instances, results.budgets)
    for name in results.scenes:
        lines += ["", f"## Scene {name}: its first vehicle, {scene_runs.CONTROLS} control points"]
        lines += _table_lines(results, [name], 0 if results.seconds is not None else results.scene_budget)
    lines += ["", "![median gap over evaluations](gap.png)", "", "How each was used:", ""]
    lines += [f"- {c.name}: {c.how}" for c in results.contenders]
    late = [
        c.name
        for c in results.contenders
        if c.slow and not any(b >= _SLOW_FROM for _, n, b in results.runs if n == c.name)
    ]
    if late and any(b >= _SLOW_FROM for b in results.budgets):
        lines += ["", f"Slow, and left out of the long budget (--slow-peers): {', '.join(late)}."]
    if results.absent:
        lines += ["", f"Not installed, left out: {', '.join(c.name for c in results.absent)} ({INSTALL})."]
    return "\n".join(lines) + "\n"


def _made(results: Results) -> tuple[str, bool]:
    return gathered({"machine": run.machine, "date": run.date} for runs in results.runs.values() for run in runs)


def _table_lines(results: Results, problems: Sequence[str], budget: int) -> list[str]:
    rows = summary(results, problems, budget)
    if not rows:
        return []
    seeds = rows[0]["runs"] // len(problems)
    what = f"{budget:,} evaluations" if budget else f"{results.seconds:g} s"
    comparable = _made(results)[1]
    head = ["", "gap: median (95 %)", "mean", "worst", "free", "rank", "p"]
    head += ["processor s per 10,000"] if comparable else []
    head += [] if budget else ["evaluations"]
    lines = [
        "",
        f"{what}, {seeds} seeds:",
        "",
        f"| {' | '.join(head)} |".replace("|  |", "| |"),
        "|---" * len(head) + "|",
    ]
    for r in rows:
        name = f"**{r['contender']}**" if r["ours"] else r["contender"]
        low, high = r["gap_median_interval_percent"]
        p = "-" if r["p_holm"] is None else f"{r['p_holm']:.1g}"
        lines.append(
            f"| {name} | {r['gap_median_percent']:.2f} % ({low:.1f} to {high:.1f}) | {r['gap_mean_percent']:.1f} % | "
            f"{r['gap_worst_percent']:.0f} % | {100.0 * r['free']:.0f} % | {r['rank']:.1f} | {p} |"
            + (f" {r['cpu_s_per_10000']:.3f} |" if comparable else "")
            + (f" {r['evaluations_median']:,.0f} |" if not budget else "")
        )
    return lines


def _problem_lines(results: Results, problems: Sequence[str], budgets: Sequence[int]) -> list[str]:
    lines = [
        "",
        f"Medians, instance by instance, of {BEST} and of whoever else is best there:",
        "",
        "| | best known |" + "".join(f" {'time' if not b else f'{b:,}'}: ours | best peer |" for b in budgets),
        "|---" * (2 + 2 * len(budgets)) + "|",
    ]
    for name in problems:
        cells = [name, f"{results.best(name):,.1f}"]
        for row in _per_problem(results, [name], budgets):
            own, other = row["ours_median"], row["best_peer_median"]
            cells.append("-" if own is None else f"{own:,.1f}")
            cells.append("-" if other is None else f"{other:,.1f} {row['best_peer']}")
        lines.append(f"| {' | '.join(cells)} |")
    return lines


_PEER_COLOURS = ("#0072b2", "#009e73", "#cc79a7", "#56b4e9", "#222222", "#8c6d31")


def _drawn(results: Results) -> Figure:
    """Draw the median gap over evaluations, or over time: a panel for each budget and each scene."""
    panels: list[tuple[Sequence[str], int, str]] = [
        (results.instances, b, f"UAV objective, {b:,} evaluations" if b else "UAV objective") for b in results.budgets
    ]
    panels += [([name], 0 if results.seconds is not None else results.scene_budget, name) for name in results.scenes]
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(4.6 * columns + 0.4, 3.4 * rows)
    every = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, (problems, budget, title) in zip(every, panels, strict=False):
        _panel(axes, results, problems, budget)
        axes.set_title(title, fontsize=9)
    for axes in every[len(panels) :]:
        axes.set_axis_off()
    figure.supylabel(f"median gap, % (down to {_LEAST_PERCENT:g})", fontsize=8)
    figure.supxlabel("evaluations" if results.seconds is None else "seconds of the processor", fontsize=8)
    return figure


def _panel(axes: Axes, results: Results, problems: Sequence[str], budget: int) -> None:
    rows = summary(results, problems, budget)
    strongest = [r["contender"] for r in rows if not r["ours"]][: len(_PEER_COLOURS)]
    colours = {**dict(zip(strongest, _PEER_COLOURS, strict=False)), **{name: COLOURS[name] for name in OURS}}
    longest = max(run.curve[-1][0] for p in problems for r in rows for run in results.runs[p, r["contender"], budget])
    timed = results.seconds is not None
    grid = (
        np.geomspace(1e-3, results.seconds, _GRID)
        if results.seconds is not None
        else np.geomspace(min(100, longest), budget or longest, _GRID)
    )
    for row in rows:
        name = row["contender"]
        gaps = [
            100.0 * (_stepped(run, grid, timed) / results.best(p) - 1.0)
            for p in problems
            for run in results.runs[p, name, budget]
        ]
        middle = np.median(np.array(gaps), axis=0)
        seen = np.isfinite(middle)
        known = name in colours
        axes.loglog(
            grid[seen],
            np.maximum(middle[seen], _LEAST_PERCENT),
            color=colours.get(name, "#c8ced3"),
            linewidth=2.2 if name == BEST else 1.2 if known else 0.7,
            zorder=3 if name == BEST else 2 if known else 1,
            label=name if known else None,
        )
    axes.legend(fontsize=6.5, frameon=False)
    axes.tick_params(labelsize=7, length=2)
    axes.tick_params(which="minor", length=0)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _stepped(run: Run, grid: FloatArray, timed: bool) -> FloatArray:
    used, at_s, cost = np.array(run.curve).T
    at = np.searchsorted(at_s if timed else used, grid, side="right") - 1
    return np.where(at >= 0, cost[np.maximum(at, 0)], np.inf)
