"""Table III of the paper: what an algorithm itself costs, by CEC 2005's method; ``missionplanner experiment table3``.

``CB = (T2 - T1) / T0`` (PAPER.md eq. 34): T0 is the time of 10^6 rounds of basic operations, T1 that of 200,000
evaluations of the function alone, T2 that of a search with as many, the mean of five (Suganthan et al., Problem
definitions and evaluation criteria for the CEC 2005 special session, 2005). T0 makes machines alike, not languages:
it is a plain loop here, as there, while our algorithms work on whole populations. So T1 is priced in the batches in
which each algorithm asks. Times are of the processor, means of several, in one process of its own with one thread.
"""

from __future__ import annotations

import math
import multiprocessing
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from missionplanner.experiments import campaign
from missionplanner.experiments.document import machine
from missionplanner.experiments.scene_figures import new_figure, save_png
from missionplanner.experiments.test_functions import BenchmarkFunction, find_function
from missionplanner.files import ensure_writable, write_atomic, write_csv
from missionplanner.search.registry import algorithms
from missionplanner.search.run import minimise

Progress = Callable[[str, float], None]
FloatArray = npt.NDArray[np.float64]

EVALUATIONS, RUNS = 200_000, 5
FUNCTION = "f7"
"""Griewank in 30 dimensions; the paper does not say which function it timed."""

_ROUNDS = 1_000_000
_QUICK = 5000, 2
_MARKED = ("pso-abc-sa", "pso-abc-sa-paper")


@dataclass(frozen=True, slots=True)
class Printed:
    """A row of the paper's table: what it prints, and what its own formula makes of its times."""

    algorithm: str
    printed: float
    by_formula: float
    words: str


PAPER_ROWS = (
    Printed("pso-abc-sa-paper", 12.782, (874.43 - 851.29) / 0.18103, "PSO-ABC-SA: (874.43 - 851.29) / 0.18103 = 127.8"),
    Printed("pso-ga", 14.898, 8e5, "PSO-GA: its times give about 800,000"),
)


@dataclass(frozen=True, slots=True)
class Complexity:
    """What one algorithm took: T1 and T2, s, and the batches in which it asks (median rows)."""

    algorithm: str
    rows: int
    t1_s: float
    t2_s: float
    t2_spread_s: float  # largest less smallest of the runs

    def value(self, t0_s: float) -> float:
        """Return CB (eq. 34)."""
        return (self.t2_s - self.t1_s) / t0_s


def main(output: Path, *, seed: int = 1, quick: bool = False, progress: Progress | None = None) -> dict[str, Any]:
    """Run the experiment and write its table and figure to a folder; return its figures as JSON values."""
    ensure_writable(output)
    evaluations, runs = _QUICK if quick else (EVALUATIONS, RUNS)
    names = [a.name for a in algorithms()]
    found: list[Complexity] = []
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=spawn, initializer=campaign.begin) as alone:
        t0_s = alone.submit(basic_operations_s).result()
        for k, name in enumerate(names, start=1):
            found.append(alone.submit(complexity, name, evaluations, runs, seed).result())
            if progress is not None:
                progress("algorithms", k / len(names))
    _write(output, t0_s, evaluations, runs, found)
    return {
        "function": FUNCTION,
        "evaluations": evaluations,
        "runs": runs,
        "t0_s": t0_s,
        "algorithms": [{**asdict(c), "complexity": c.value(t0_s)} for c in found],
        "paper": [asdict(row) for row in PAPER_ROWS],
    }


def basic_operations_s(rounds: int = _ROUNDS) -> float:
    """Return T0: the processor time of CEC 2005's loop, the mean of five."""
    took = []
    for _ in range(RUNS):
        begin_s = time.process_time()
        for _ in range(rounds):
            x = 5.55
            x = x + x
            x = x / 2.0
            x = x * x
            x = math.sqrt(x)
            x = math.log(x)
            x = math.exp(x)
            x = x / x
        took.append(time.process_time() - begin_s)
    return statistics.mean(took)


def complexity(algorithm: str, evaluations: int, runs: int, seed: int) -> Complexity:
    """Time an algorithm: T2 with so many evaluations, and T1 of the same batches without it."""
    function = find_function(FUNCTION)
    batches = _searched(function, algorithm, min(evaluations, 5000), seed)[1]  # compiled, imported, warm
    took = []
    for run in range(runs):
        seconds, batches = _searched(function, algorithm, evaluations, seed + run)
        took.append(seconds)
    alone = [_priced_s(function, batches) for _ in range(runs)]
    return Complexity(
        algorithm, int(statistics.median(batches)), statistics.mean(alone), statistics.mean(took), max(took) - min(took)
    )


def _searched(function: BenchmarkFunction, algorithm: str, evaluations: int, seed: int) -> tuple[float, list[int]]:
    """Return the processor time of a search, and how many rows it asked for at a time."""
    batches: list[int] = []

    def cost(points: FloatArray) -> FloatArray:
        batches.append(len(points))
        return function.cost(points)

    begin_s = time.process_time()
    minimise(cost, function.lower, function.upper, algorithm=algorithm, evaluations=evaluations, seed=seed)
    return time.process_time() - begin_s, batches


def _priced_s(function: BenchmarkFunction, batches: list[int]) -> float:
    points = np.random.default_rng(0).uniform(function.lower, function.upper, (max(batches), function.dimensions))
    begin_s = time.process_time()
    for rows in batches:
        function.cost(points[:rows])
    return time.process_time() - begin_s


# --- what is written -------------------------------------------------------------------------------------------------


def _write(folder: Path, t0_s: float, evaluations: int, runs: int, found: list[Complexity]) -> None:
    write_csv(
        folder / "table3.csv",
        ["algorithm", "rows", "t0_s", "t1_s", "t2_s", "t2_spread_s", "complexity"],
        [[c.algorithm, c.rows, t0_s, c.t1_s, c.t2_s, c.t2_spread_s, c.value(t0_s)] for c in found],
    )
    write_atomic(folder / "results.md", table(t0_s, evaluations, runs, found))
    save_png(folder / "complexity.png", _drawn(t0_s, found))


def table(t0_s: float, evaluations: int, runs: int, found: list[Complexity]) -> str:
    """Return the figures as Markdown."""
    printed = {row.algorithm: row for row in PAPER_ROWS}
    lines = [
        f"# Table III: what the algorithms themselves cost ({find_function(FUNCTION).label}, D = 30)",
        "",
        f"T0 = {t0_s:.4f} s (10^6 rounds in a plain loop); {evaluations:,} evaluations, mean of {runs} runs, processor "
        "time of one thread; T0 and T1 are means, too. CB = (T2 - T1) / T0.",
        "",
        machine(),
        "",
        "| | asks for rows at once | T1, s | T2, s | CB | the paper prints | by the paper's own formula |",
        "|---|---|---|---|---|---|---|",
    ]
    for c in sorted(found, key=lambda c: c.value(t0_s)):
        row = printed.get(c.algorithm)
        theirs = f"{row.printed:g} | {row.by_formula:,.4g}" if row else "- | -"
        lines.append(f"| {c.algorithm} | {c.rows} | {c.t1_s:.3f} | {c.t2_s:.3f} | {c.value(t0_s):.2f} | {theirs} |")
    wrong = "; ".join(f"{row.words}, {row.printed:g} is printed" for row in PAPER_ROWS)
    lines += [
        "",
        f"The paper's rows contradict its formula ({wrong}). Its T1 of 851 s is 4 ms for an evaluation, far more than "
        "any function of its Table I takes, and its T0 is of another language: the method is reproduced, its values "
        "cannot be.",
        "",
        "![complexity of the algorithms](complexity.png)",
    ]
    return "\n".join(lines) + "\n"


def _drawn(t0_s: float, found: list[Complexity]) -> Figure:
    """Draw CB, the cheapest algorithm first."""
    order = sorted(found, key=lambda c: c.value(t0_s))
    figure = new_figure(6.0, 0.24 * len(order) + 0.8)
    axes = figure.subplots()
    colours = ["#d55e00" if c.algorithm in _MARKED else "#8fa3b0" for c in order]
    bars = axes.barh(range(len(order)), [c.value(t0_s) for c in order], color=colours, height=0.7)
    axes.bar_label(bars, fmt="%.1f", fontsize=7, padding=2)
    axes.set_yticks(range(len(order)), [c.algorithm for c in order], fontsize=8)
    axes.set_ylim(len(order) - 0.4, -0.6)
    axes.set_xlabel("CB = (T2 - T1) / T0", fontsize=8)
    axes.tick_params(labelsize=8, length=0)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    return figure
