"""Table II of the paper, and more: every algorithm on the test functions; ``missionplanner experiment table2``.

The paper reports one number per function and algorithm and does not say which statistic it is: medians are put beside
it. Ranks and tests are of the *excess* over the known minimum; what is within rounding of the minimum, which every
function says for itself, is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from missionplanner.experiments import campaign
from missionplanner.experiments.contenders import INSTALL, Contender, find_contender, ours
from missionplanner.experiments.document import gathered, provenance
from missionplanner.experiments.scene_figures import COLOURS, new_figure, save_png
from missionplanner.experiments.statistics import Comparison, Friedman, friedman, holm, paired, rank_sum
from missionplanner.experiments.test_functions import FUNCTIONS, BenchmarkFunction, find_function
from missionplanner.files import write_atomic, write_csv

Progress = Callable[[str, float], None]
FloatArray = npt.NDArray[np.float64]

EVALUATIONS, RUNS = 10_000, 51
"""The paper's: 50 particles, 200 iterations; 51 runs."""

BEST, PAPER_FORM = "pso-abc-sa", "pso-abc-sa-paper"
PEERS = ("minionpy ARRDE", "minionpy jSO", "minionpy LSHADE")

PAPER_ALGORITHMS = ("pso-sa", "abc-sa", "qpso", "pso", "avoa", PAPER_FORM)
PAPER: dict[str, tuple[str, ...]] = {
    "f1": ("0.4637", "0.3536", "1.623", "0.3387", "0.7828", "0.2928"),
    "f2": ("0.001336", "0.0005548", "0.003095", "0.00124", "0.01231", "0.0003075"),
    "f3": ("0.39286", "5.8706e-07", "0.0026845", "7.4979e-06", "2.7764e-05", "4.4917e-10"),
    "f4-goldstein": ("3.004", "3", "3.487", "3", "4.114", "3"),
    "f5": ("-3.102", "-0.4034", "-0.4034", "-3.203", "-0.5078", "-3.32"),
    "f6": ("-959.6403", "-959.5563", "-885.7882", "-959.6407", "-786.5241", "-959.6407"),
    "f7": ("5.3721", "2.4601", "79.7525", "5.4311", "1.2067", "0.0054575"),
    "f8": ("0.75412", "0.0020573", "0.00075313", "0.0014425", "5.0308e-06", "1.8316e-07"),
    "f9": ("18.6828", "2.51", "11.3647", "2.118", "0.50424", "0.0051871"),
}
"""Table II as printed, in the order of :data:`PAPER_ALGORITHMS`; f4's results are Goldstein-Price's."""

_CEC_FLOOR = 1e-8  # competitions count smaller errors as 0
_LEVEL = 0.05
_GRID = 40
_QUICK_RUNS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Costs (runs,) of every function and algorithm, and the curves of excess by which they were reached."""

    evaluations: int
    runs: int
    functions: tuple[str, ...]
    algorithms: tuple[str, ...]
    absent: tuple[str, ...]  # not installed
    cost: Mapping[tuple[str, str], FloatArray]  # by function and algorithm
    curve: Mapping[tuple[str, str], FloatArray]  # (runs, G): best cost at _grid()
    made: str  # when, and on what

    def excess(self, function: str, algorithm: str) -> FloatArray:
        """Return by how much every run (runs,) missed the known minimum."""
        f = find_function(function)
        return excess(self.cost[function, algorithm], f.minimum, f.rounding)

    def table(self, statistic: Callable[[FloatArray], float], floor: float = 0.0) -> FloatArray:
        """Return a statistic of excesses (functions, algorithms); those up to ``floor`` count as 0."""
        found = [[statistic(self.excess(f, a)) for a in self.algorithms] for f in self.functions]
        return floored(np.array(found), floor)

    def blocks(self, floor: float = 0.0) -> FloatArray:
        """Return the excesses (functions * runs, algorithms): every run of every function ranks the algorithms."""
        found = [np.stack([self.excess(f, a) for a in self.algorithms], axis=1) for f in self.functions]
        return floored(np.concatenate(found), floor)


def excess(cost: FloatArray, minimum: float, rounding: float | None = None) -> FloatArray:
    """Return costs above a minimum; 0 within rounding of it: 1e-12 of it, unless told."""
    above = cost - minimum
    return np.where(above <= (1e-12 * abs(minimum) if rounding is None else rounding), 0.0, above)


def floored(values: FloatArray, floor: float) -> FloatArray:
    """Return values with those up to ``floor`` as 0."""
    return np.where(values <= floor, 0.0, values)


def main(
    output: Path,
    *,
    runs: int = RUNS,
    evaluations: int = EVALUATIONS,
    peers: bool = False,
    quick: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    wanted = [*ours(), *(find_contender(name) for name in PEERS if peers)]
    results = measure(
        output,
        wanted,
        FUNCTIONS,
        _QUICK_RUNS if quick else runs,
        evaluations,
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    _write(output, results)
    return as_json(results)


def measure(
    folder: Path,
    contenders: Sequence[Contender],
    functions: Sequence[BenchmarkFunction],
    runs: int,
    evaluations: int,
    *,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> Results:
    """Run every contender on every function, as often as asked; only what the folder does not hold is run."""
    present = [c for c in contenders if c.installed]
    digests = {c.name: c.digest() for c in present}
    jobs = {
        (f.name, c.name, seed): campaign.Job(
            f"{f.name}/{c.name}@{digests[c.name]}/{evaluations}/{seed}",
            search,
            {"function": f.name, "contender": c.name, "evaluations": evaluations, "seed": seed},
        )
        for f in functions
        for c in present
        for seed in range(runs)
    }
    version = campaign.version_of({"results": 2}, ("missionplanner.experiments.test_functions",))
    found = campaign.run(
        list(jobs.values()),
        folder,
        experiment="table2",
        version=version,
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    cost, curve = {}, {}
    made = gathered(found.values())[0]
    for f in functions:
        for c in present:
            every = [found[jobs[f.name, c.name, seed].key] for seed in range(runs)]
            cost[f.name, c.name] = np.array([one["cost"] for one in every])
            curve[f.name, c.name] = np.array([_at_grid(one["curve"], evaluations) for one in every])
    return Results(
        evaluations,
        runs,
        tuple(f.name for f in functions),
        tuple(c.name for c in present),
        tuple(c.name for c in contenders if not c.installed),
        cost,
        curve,
        made,
    )


def search(function: str, contender: str, evaluations: int, seed: int) -> dict[str, Any]:
    """Return what one run found, and how: pairs of evaluations and the best cost by then."""
    f = find_function(function)
    tally = find_contender(contender).run(f.cost, f.lower, f.upper, evaluations=evaluations, seed=seed)
    return {**provenance(), "cost": tally.cost, "curve": [[used, cost] for used, _, cost in tally.curve]}


def _grid(evaluations: int) -> npt.NDArray[np.int64]:
    return np.unique(np.geomspace(min(50, evaluations), evaluations, _GRID).astype(np.int64))


def _at_grid(curve: Sequence[tuple[int, float]], evaluations: int) -> FloatArray:
    used, cost = np.array(curve).T
    at = np.searchsorted(used, _grid(evaluations), side="right") - 1
    return np.where(at >= 0, cost[np.maximum(at, 0)], np.inf)


# --- what is made of it ----------------------------------------------------------------------------------------------


def ranked(results: Results) -> dict[str, Friedman]:
    """Return mean ranks over the functions by medians, and over all runs; as found, and as competitions count."""
    return {
        "median": friedman(results.table(np.median)),
        "median, errors below 1e-8 equal": friedman(results.table(np.median, _CEC_FLOOR)),
        "all runs": friedman(results.blocks()),
        "all runs, errors below 1e-8 equal": friedman(results.blocks(_CEC_FLOOR)),
    }


def compared(results: Results) -> list[Comparison]:
    """Compare the best form with everybody by the medians of the functions (signed ranks, Holm)."""
    return paired(results.table(np.median), results.algorithms, BEST)


def duels(results: Results) -> dict[str, tuple[int, int, int]]:
    """Return on how many functions the best form's runs are better, alike and worse than another's.

    Rank sums of the runs at 5 %, corrected by Holm over the functions.
    """
    found = {}
    for other in results.algorithms:
        if other == BEST:
            continue
        pairs = [(results.excess(f, BEST), results.excess(f, other)) for f in results.functions]
        sure = holm([rank_sum(own, theirs) for own, theirs in pairs]) < _LEVEL
        lower = np.array([_stochastically_lower(own, theirs) for own, theirs in pairs])
        found[other] = (int((sure & lower).sum()), int((~sure).sum()), int((sure & ~lower).sum()))
    return found


def _stochastically_lower(own: FloatArray, theirs: FloatArray) -> bool:
    return bool(np.sign(own[:, None] - theirs).sum() < 0)


def standing(results: Results) -> dict[str, dict[str, Any]]:
    """Return, for each kind of rank, who ranks before the best form, and who of them is told apart from it.

    Told apart: p below 5 % by signed ranks of the medians, corrected by Holm. That others are not says nothing.
    """
    sure = {c.other for c in compared(results) if c.p_holm < _LEVEL}
    own = results.algorithms.index(BEST)
    found = {}
    for how, f in ranked(results).items():
        order = np.argsort(f.ranks, kind="stable")
        before = [results.algorithms[k] for k in order if f.ranks[k] < f.ranks[own]]
        found[how] = {
            "rank": float(f.ranks[own]),
            "before": before,
            "best": not before,
            "told_apart": [name for name in before if name in sure],
        }
    return found


def matches(results: Results) -> dict[str, bool]:
    """Return for which functions the paper form's median is at least as low as the paper's PSO-ABC-SA, as printed."""
    tried = [function for function in PAPER if (function, PAPER_FORM) in results.cost]
    return {function: reaches(function, float(np.median(results.cost[function, PAPER_FORM]))) for function in tried}


def reaches(function: str, value: float) -> bool:
    """Return whether a value is at least as low as the paper's PSO-ABC-SA, to the finest digits of the table's row."""
    row = PAPER[function]
    printed = row[-1]
    if "e" in printed:
        digits = len(printed.partition("e")[0].replace(".", "").lstrip("-"))
        return float(f"{value:.{digits - 1}e}") <= float(printed)
    return round(value, max(len(other.partition(".")[2]) for other in row if "e" not in other)) <= float(printed)


def as_json(results: Results) -> dict[str, Any]:
    """Return plain JSON values."""
    matched = matches(results)
    return {
        "evaluations": results.evaluations,
        "runs": results.runs,
        "absent": list(results.absent),
        "functions": {f: {a: _statistics(results.cost[f, a]) for a in results.algorithms} for f in results.functions},
        "friedman": {
            how: {
                "statistic": found.statistic,
                "p": found.p,
                "ranks": dict(zip(results.algorithms, found.ranks.tolist(), strict=True)),
            }
            for how, found in ranked(results).items()
        },
        "wilcoxon": [
            {
                "one": c.one,
                "other": c.other,
                "better": c.better,
                "equal": c.equal,
                "worse": c.worse,
                "p": c.p,
                "p_holm": c.p_holm,
            }
            for c in compared(results)
        ],
        "standing": standing(results),
        "duels": {other: list(count) for other, count in duels(results).items()},
        "paper_form_matches": matched,
        "paper_form_matches_count": sum(matched.values()),
    }


def _statistics(cost: FloatArray) -> dict[str, float]:
    return {
        "best": float(cost.min()),
        "mean": float(cost.mean()),
        "worst": float(cost.max()),
        "std": float(cost.std(ddof=1)) if len(cost) > 1 else 0.0,
        "median": float(np.median(cost)),
    }


# --- what is written -------------------------------------------------------------------------------------------------


def _write(folder: Path, results: Results) -> None:
    write_csv(
        folder / "table2.csv",
        ["function", "algorithm", "seed", "cost", "excess"],
        [
            [f, a, seed, repr(float(cost)), repr(float(above))]
            for f in results.functions
            for a in results.algorithms
            for seed, (cost, above) in enumerate(zip(results.cost[f, a], results.excess(f, a), strict=True))
        ],
    )
    write_atomic(folder / "results.md", table(results))
    save_png(folder / "convergence.png", _convergence(results))
    save_png(folder / "ranks.png", _ranks(results))


def table(results: Results) -> str:
    """Return the figures as Markdown."""
    lines = [
        f"# Table II: test functions, {results.evaluations:,} evaluations, {results.runs} runs",
        "",
        results.made,
        "",
        *_beside_paper(results),
        *_rank_lines(results),
        "",
        "![mean ranks](ranks.png)",
        "",
        "![median excess over evaluations](convergence.png)",
        *_every_lines(results),
    ]
    if results.absent:
        lines += ["", f"Not installed, left out: {', '.join(results.absent)} ({INSTALL})."]
    return "\n".join(lines) + "\n"


def _beside_paper(results: Results) -> list[str]:
    known = [a for a in PAPER_ALGORITHMS if a in results.algorithms]
    matched = matches(results)
    lines = [
        "## Beside the paper",
        "",
        "Our median, and the paper's value (which statistic it is, the paper does not say). f4 is Goldstein-Price, as "
        "in the paper's results; its PSO-ABC-SA stands beside our paper form, the best form is the last column.",
        "",
        f"| | {' | '.join(known)} | {BEST} |",
        "|---" * (len(known) + 2) + "|",
    ]
    for function, row in PAPER.items():
        if function not in results.functions:
            continue
        cells = [f"{_short(np.median(results.cost[function, a]))} ({row[PAPER_ALGORITHMS.index(a)]})" for a in known]
        cells.append(_short(np.median(results.cost[function, BEST])))
        lines.append(f"| {find_function(function).label} | {' | '.join(cells)} |")
    if matched:
        missed = [function for function, kept in matched.items() if not kept]
        lines += [
            "",
            f"The paper form's median is at least as low as the paper's PSO-ABC-SA on {sum(matched.values())} of "
            f"{len(matched)} functions{f' (not on {chr(44).join(missed)})' if missed else ''}.",
        ]
    return lines


def _rank_lines(results: Results) -> list[str]:
    kinds = ranked(results)
    against = {c.other: c for c in compared(results)}
    fought = duels(results)
    order = np.argsort(kinds["median"].ranks, kind="stable")
    lines = [
        "",
        f"## Ranks over {len(results.functions)} functions",
        "",
        "Mean Friedman ranks of medians, and of single runs; in brackets with errors below 1e-8 as equal, as in the "
        "CEC competitions. Runs are ranked seed by seed: ours of one population share their first points, with others "
        f"they share nothing. Beside them {BEST} against each: p of Wilcoxon's signed ranks of the medians, corrected "
        "by Holm (those of 0.05 and more are not told apart), and on how many functions its runs are better, not told "
        "apart, worse (rank sums, 5 %, Holm).",
        "",
        "| | medians | all runs | signed ranks, p | better / not told apart / worse |",
        "|---|---|---|---|---|",
    ]
    for k in order:
        name = results.algorithms[k]
        ranks = [found.ranks[k] for found in kinds.values()]
        p = f"{against[name].p_holm:.2g}" if name in against else "-"
        fights = " / ".join(map(str, fought[name])) if name in fought else "-"
        lines.append(f"| {name} | {ranks[0]:.2f} ({ranks[1]:.2f}) | {ranks[2]:.2f} ({ranks[3]:.2f}) | {p} | {fights} |")
    for how, at in standing(results).items():
        before = "nobody ranks before it" if at["best"] else f"before it: {', '.join(at['before'])}"
        apart = "" if at["best"] else f"; told apart from it: {', '.join(at['told_apart']) or 'none of them'}"
        lines += ["", f"{BEST}, {how}: mean rank {at['rank']:.2f}; {before}{apart}."]
    lines += [
        "",
        "Friedman: " + "; ".join(f"{how}: {f.statistic:.1f}, p = {f.p:.1g}" for how, f in kinds.items()) + ".",
    ]
    return lines


def _every_lines(results: Results) -> list[str]:
    lines = ["", "## All values", ""]
    for f in results.functions:
        function = find_function(f)
        lines += [
            f"### {function.label} (D = {function.dimensions}, minimum {function.minimum:.8g})",
            "",
            "| | best | mean | worst | std | median |",
            "|---|---|---|---|---|---|",
        ]
        for a in results.algorithms:
            lines.append(f"| {a} | {' | '.join(_short(v) for v in _statistics(results.cost[f, a]).values())} |")
        lines.append("")
    return lines


def _short(value: float) -> str:
    return f"{value:.7g}" if 0.01 <= abs(value) < 1e5 else f"{value:.4g}"


_COLOURS = {
    **{name: COLOURS[name] for name in (BEST, *PAPER_ALGORITHMS)},
    **dict.fromkeys(PEERS, "#222222"),
}
_DASHES = {PEERS[0]: "-", PEERS[1]: "--", PEERS[2]: ":"}


def _convergence(results: Results) -> Figure:
    """Draw the median excess over evaluations, a panel per function."""
    columns = 5
    rows = -(-(len(results.functions) + 1) // columns)
    figure = new_figure(11.0, 2.1 * rows)
    panels = np.atleast_1d(figure.subplots(rows, columns, sharex=True)).ravel()
    grid = _grid(results.evaluations)
    for axes, f in zip(panels, results.functions, strict=False):
        function = find_function(f)
        for a in results.algorithms:
            middle = np.maximum(
                np.median(excess(results.curve[f, a], function.minimum, function.rounding), axis=0), 1e-16
            )
            known = a in _COLOURS
            axes.loglog(
                grid,
                middle,
                _DASHES.get(a, "-"),
                color=_COLOURS.get(a, "#c8ced3"),
                linewidth=2.0 if a == BEST else 1.1 if known else 0.7,
                zorder=3 if a == BEST else 2 if known else 1,
                label=a if known else None,
            )
        axes.set_title(function.label, fontsize=8)
        axes.tick_params(labelsize=7, length=2)
        axes.tick_params(which="minor", length=0)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    for axes in panels[len(results.functions) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    handles.append(panels[0].plot([], [], color="#c8ced3", linewidth=0.7)[0])
    panels[-1].legend(handles, [*labels, "others"], fontsize=7, frameon=False, loc="center", ncols=1)
    figure.supxlabel("evaluations", fontsize=8)
    figure.supylabel("excess over the minimum, median (1e-16: exact)", fontsize=8)
    return figure


def _ranks(results: Results) -> Figure:
    """Draw the mean ranks, best first."""
    ranks = friedman(results.table(np.median)).ranks
    runs = friedman(results.blocks()).ranks
    order = np.argsort(ranks, kind="stable")
    figure = new_figure(6.0, 0.24 * len(order) + 0.8)
    axes = figure.subplots()
    for row, k in enumerate(order):
        name = results.algorithms[k]
        axes.plot(ranks[k], row, "o", color=_COLOURS.get(name, "#66727d"), markersize=6)
        axes.plot(runs[k], row, "|", color=_COLOURS.get(name, "#66727d"), markersize=9)
    axes.set_yticks(range(len(order)), [results.algorithms[k] for k in order], fontsize=8)
    axes.set_ylim(len(order) - 0.5, -0.5)
    axes.set_xlim(left=0.5)
    axes.grid(axis="y", color="#e3e7ea", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel("mean rank over functions (circle: of medians, stroke: of single runs)", fontsize=8)
    axes.tick_params(labelsize=8, length=0)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    return figure
