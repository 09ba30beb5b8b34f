"""The main job over many seeds: each example mission planned, exported, checked by the dense oracle, and flown.

Run ``python -m tests.benchmarks.main_job --seeds 20 --fly``. Exit code 1 if any run fails, is not clear, arrives with a
spread of a second or more, or leaves towers out.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from missionplanner.errors import MissionPlannerError
from missionplanner.plan_folder import save_flight
from missionplanner.scene import Scene
from tests.main_job import EXAMPLES, fly, load_scene, mission_path, plan_into
from tests.oracles.dense_check import Least, check_folder

SPREAD_MAX_S = 1.0


@dataclass(frozen=True)
class Run:
    """One mission with one seed. Vehicles count as clear as planned and, where flown, as flown."""

    mission: str
    seed: int
    vehicles: int
    planning_s: float
    error: str | None = None
    clear: tuple[str, ...] = ()
    worst_margin_m: float = -math.inf
    worst: str = ""
    arrival_s: float | None = None
    spread_s: float | None = None
    separation_m: float | None = None
    separation_required_m: float = 0.0
    inspected: float | None = None
    flying_s: float | None = None

    def problems(self, *, flown: bool) -> Iterator[str]:
        """Say what of this run is not as it must be."""
        if self.error is not None:
            yield self.error
            return
        if len(self.clear) < self.vehicles:
            yield f"only {', '.join(self.clear) or 'nobody'} clear; worst: {self.worst}"
        if self.inspected is not None and self.inspected < 1.0:
            yield f"inspected {100 * self.inspected:.0f} % of the towers"
        if not flown:
            return
        if self.spread_s is None or self.spread_s >= SPREAD_MAX_S:
            yield f"arrival spread {self.spread_s} s"
        if self.separation_m is not None and self.separation_m < self.separation_required_m:
            yield f"separation flown {self.separation_m:.1f} m, expected {self.separation_required_m:g} m"


@cache
def _scene(mission: str) -> Scene:
    return load_scene(mission_path(mission))


def run(mission: str, seed: int, flown: bool) -> Run:
    """Plan, export, fly and check one mission with one seed."""
    scene = _scene(mission)
    vehicles = len(scene.tasks)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        begin_s = time.perf_counter()
        try:
            plan = plan_into(folder, scene, seed)
            planning_s = time.perf_counter() - begin_s
            if flown:
                save_flight(folder, fly(scene, plan))
        except MissionPlannerError as error:
            planning_s = time.perf_counter() - begin_s
            return Run(mission, seed, vehicles, planning_s, f"{type(error).__name__}: {error}")
        flying_s = time.perf_counter() - begin_s - planning_s if flown else None
        report = check_folder(mission_path(mission), folder)
    every = [
        (least, f"{name} {kind}")
        for kind, found in (("planned", report.planned), ("flown", report.flown))
        for name, leasts in found.items()
        for least in leasts
    ]
    worst, whose = min(every, key=lambda pair: pair[0].margin_m)
    shares = [i.share for i in (report.inspected, report.inspected_flown) if i is not None]
    return Run(
        mission,
        seed,
        vehicles,
        planning_s,
        clear=tuple(name for name in report.planned if report.clear(name)),
        worst_margin_m=worst.margin_m,
        worst=f"{whose}: {_told(worst)}",
        arrival_s=plan.arrival_s,
        spread_s=report.arrival_spread_s,
        separation_m=report.separation and report.separation.distance_m,
        separation_required_m=report.separation.required_m if report.separation else 0.0,
        inspected=min(shares, default=None),
        flying_s=flying_s,
    )


def _told(least: Least) -> str:
    return f"{least.distance_m:.2f} m from {least.what}, expected {least.required_m:g} m"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run all, print the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20, help="seeds 1 to N of each mission")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--missions", nargs="+", choices=EXAMPLES, default=EXAMPLES)
    parser.add_argument("--fly", action="store_true", help="fly every plan in lock-step simulation too")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", action="store_true", help="print all runs as JSON on stdout")
    options = parser.parse_args(arguments)

    jobs = [(m, s) for m in options.missions for s in range(options.first, options.first + options.seeds)]
    runs: list[Run] = []
    errors = Console(stderr=True)
    with (
        ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool,
        Progress(console=errors, transient=True) as progress,
    ):
        bar = progress.add_task("runs", total=len(jobs))
        for future in as_completed([pool.submit(run, mission, seed, options.fly) for mission, seed in jobs]):
            runs.append(done := future.result())
            progress.advance(bar)
            for problem in done.problems(flown=options.fly):
                progress.console.print(f"{done.mission} seed {done.seed}: {problem}", soft_wrap=True, highlight=False)
    runs.sort(key=lambda r: jobs.index((r.mission, r.seed)))
    summaries = [_summary([r for r in runs if r.mission == m]) for m in options.missions]
    bad = sum(any(True for _ in r.problems(flown=options.fly)) for r in runs)
    if options.json:
        print(json.dumps({"missions": summaries, "runs": [asdict(r) for r in runs]}, indent=1))
    else:
        _print(summaries)
    return int(bad > 0)


def _summary(runs: Sequence[Run]) -> dict[str, Any]:
    planned = [r for r in runs if r.error is None]
    vehicles = sum(r.vehicles for r in runs)

    def worst(values: Sequence[float | None], pick: Any) -> float | None:
        return pick([v for v in values if v is not None], default=None)

    return {
        "mission": runs[0].mission,
        "seeds": len(runs),
        "planned": len(planned),
        "clear_share": sum(len(r.clear) for r in planned) / vehicles,
        "worst_margin_m": worst([r.worst_margin_m for r in planned], min),
        "spread_max_s": worst([r.spread_s for r in planned], max),
        "separation_min_m": worst([r.separation_m for r in planned], min),
        "inspected_min": worst([r.inspected for r in planned], min),
        "arrival_median_s": statistics.median([r.arrival_s for r in planned if r.arrival_s is not None] or [math.nan]),
        "arrival_max_s": worst([r.arrival_s for r in planned], max),
        "planning_median_s": statistics.median(r.planning_s for r in runs),
        "planning_max_s": max(r.planning_s for r in runs),
        "flying_median_s": statistics.median([r.flying_s for r in planned if r.flying_s is not None] or [math.nan]),
    }


def _print(summaries: Sequence[dict[str, Any]]) -> None:
    table = Table(title="the main job, seed by seed")
    columns = {
        "mission": lambda s: s["mission"],
        "seeds planned": lambda s: f"{s['planned']}/{s['seeds']}",
        "vehicles clear": lambda s: f"{100 * s['clear_share']:.1f} %",
        "worst margin m": lambda s: _number(s["worst_margin_m"], 2),
        "arrival spread max s": lambda s: _number(s["spread_max_s"], 2),
        "separation min m": lambda s: _number(s["separation_min_m"], 1),
        "towers inspected": lambda s: "-" if s["inspected_min"] is None else f"{100 * s['inspected_min']:.0f} %",
        "arrival median, max s": lambda s: f"{_number(s['arrival_median_s'], 0)}, {_number(s['arrival_max_s'], 0)}",
        "planning median, max s": lambda s: f"{s['planning_median_s']:.1f}, {s['planning_max_s']:.1f}",
        "flying median s": lambda s: _number(s["flying_median_s"], 1),
    }
    for heading in columns:
        table.add_column(heading, justify="left" if heading == "mission" else "right")
    for summary in summaries:
        table.add_row(*(told(summary) for told in columns.values()))
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.{digits}f}"


if __name__ == "__main__":
    sys.exit(main())
