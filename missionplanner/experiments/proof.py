"""The checker, measured: is it sound, how tight is it, how fast; ``missionplanner experiment proof``.

Soundness holds its claims about random legs and fleets against an independent oracle's samples, and knows of no
tolerable violation. Results do not depend on how many processes share the work.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missionplanner.experiments import proof_speed, proof_trials
from missionplanner.experiments.proof_samples import SampleOutcome, check_samples
from missionplanner.experiments.proof_speed import Timing, exponent
from missionplanner.experiments.proof_trials import LEGS_PER_WORLD, Tally
from missionplanner.experiments.proof_worlds import real_land
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv

Progress = Callable[[str, float], None]
Part = TypeVar("Part")

LEGS, FLEETS, TIGHT_LEGS = 100_000, 2_000, 10_000
_QUICK_LEGS, _QUICK_FLEETS, _QUICK_TIGHT_LEGS = 1_500, 12, 500

TIGHT_P99_M = 1.0
FIVE_VEHICLES_S, HUNDRED_VEHICLES_S = 0.3, 10.0
_SHOWN = 20  # violations in the table
_EXPONENTS = ("legs", "vehicles", "cells")


@dataclass(frozen=True, slots=True)
class Results:
    """All that was measured."""

    seed: int
    tally: Tally
    loose_m: tuple[float, ...]  # how far bounds are below the least height that was found
    timings: tuple[Timing, ...]
    samples: tuple[SampleOutcome, ...]

    def check_s(self, what: str, count: int) -> float | None:
        """Return how long a check took; None where that was not measured."""
        return next((t.check_s for t in self.timings if (t.what, t.count) == (what, count)), None)

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        tally = self.tally
        return {
            "seed": self.seed,
            "sound": not tally.violations,
            "made": dict(tally.made),
            "claims": dict(tally.claims),
            "samples": dict(tally.samples),
            "violations": [asdict(violation) for violation in tally.violations],
            "tightness_m": _quantiles(self.loose_m),
            "timings": [asdict(timing) for timing in self.timings],
            "exponents": {what: exponent(self.timings, what) for what in _EXPONENTS},
            "mission_files": [asdict(sample) for sample in self.samples],
        }


def main(
    output: Path, *, mission: Path, seed: int, quick: bool, samples: Path | None, progress: Progress
) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    results = run(output, seed, quick=quick, mission=mission, samples=samples, progress=progress)
    return results.as_json()


def run(
    folder: Path,
    seed: int,
    legs: int = LEGS,
    fleets: int = FLEETS,
    *,
    quick: bool = False,
    mission: Path,
    samples: Path | None = None,
    progress: Progress = lambda _what, _share: None,
    workers: int | None = None,
) -> Results:
    """Measure soundness, tightness and speed; write tables and figures to a folder.

    Parameters
    ----------
    mission : the mission whose terrain is the real one; its file need not be there, then all terrain is synthetic
    samples : a folder of other people's mission files, to be checked too
    workers : processes; default: one per core
    """
    ensure_writable(folder)
    tight = TIGHT_LEGS
    sizes: tuple[Sequence[int], Sequence[int], Sequence[int]] = (
        proof_speed.LEGS_EACH,
        proof_speed.VEHICLES,
        proof_speed.CELLS,
    )
    if quick:
        legs, fleets, tight = min(legs, _QUICK_LEGS), min(fleets, _QUICK_FLEETS), _QUICK_TIGHT_LEGS
        sizes = (10, 40), (5, 10), (10**6,)
    tally = soundness(seed, legs, fleets, mission=mission, progress=progress, workers=workers)
    loose_m = tightness(seed, tight, mission=mission, progress=progress, workers=workers)
    timings = proof_speed.measure(mission, *sizes, partial(progress, "speed"))
    outcomes = [] if samples is None else check_samples(samples, mission)
    results = Results(seed, tally, tuple(loose_m), tuple(timings), tuple(outcomes))
    _write(folder, results)
    return results


def soundness(
    seed: int,
    legs: int,
    fleets: int,
    *,
    mission: Path,
    progress: Progress = lambda _what, _share: None,
    workers: int | None = 1,
) -> Tally:
    """Return what came of random legs and fleets, half of them on a mission's terrain."""
    real = mission if real_land(mission) is not None else None
    worlds = max(1, math.ceil(legs / LEGS_PER_WORLD)) if legs else 0
    leg_jobs = [
        (seed, k, real if k % 2 else None, min(LEGS_PER_WORLD, legs - k * LEGS_PER_WORLD)) for k in range(worlds)
    ]
    fleet_jobs = [(seed, k, real if k % 2 else None) for k in range(fleets)]
    tally = Tally()
    for part in _shared(proof_trials.try_legs, leg_jobs, "legs", progress, workers):
        tally.add(part)
    for part in _shared(proof_trials.try_fleet, fleet_jobs, "fleets", progress, workers):
        tally.add(part)
    return tally


def tightness(
    seed: int,
    legs: int,
    *,
    mission: Path,
    progress: Progress = lambda _what, _share: None,
    workers: int | None = 1,
) -> list[float]:
    """Return how far bounds of legs over a mission's terrain are below the least height found; none without one."""
    if real_land(mission) is None:
        return []
    jobs = [(seed, k, mission, LEGS_PER_WORLD) for k in range(math.ceil(legs / LEGS_PER_WORLD))]
    return [
        loose for part in _shared(proof_trials.try_tightness, jobs, "tightness", progress, workers) for loose in part
    ]


def _shared(
    work: Callable[..., Part], jobs: Sequence[tuple[Any, ...]], what: str, progress: Progress, workers: int | None
) -> Iterator[Part]:
    """Yield what comes of jobs, in their order, worked on by several processes."""
    workers = min(workers or os.cpu_count() or 1, len(jobs))
    parts: Iterable[Part]
    if workers <= 1:
        parts = (work(*job) for job in jobs)
        yield from _told(parts, len(jobs), what, progress)
        return
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        parts = pool.map(work, *zip(*jobs, strict=True), chunksize=4)
        yield from _told(parts, len(jobs), what, progress)


def _told(parts: Iterable[Part], count: int, what: str, progress: Progress) -> Iterator[Part]:
    for done, part in enumerate(parts, start=1):
        progress(what, done / count)
        yield part


# --- what is written -------------------------------------------------------------------------------------------------


def _write(folder: Path, results: Results) -> None:
    tally = results.tally
    counts = [("made", *item) for item in tally.made.items()]
    counts += [("claims", *item) for item in tally.claims.items()] + [("samples", *s) for s in tally.samples.items()]
    write_csv(folder / "soundness.csv", ("what", "of", "count"), counts)
    write_csv(
        folder / "violations.csv",
        ("trial", "of", "claimed", "seen", "where"),
        [(v.trial, v.of, v.claimed, v.seen, v.where) for v in tally.violations],
    )
    write_csv(folder / "tightness.csv", ("below_the_least_found_m",), [(round(v, 4),) for v in results.loose_m])
    write_csv(
        folder / "speed.csv",
        ("what", "count", "check_s", "pyramid_s"),
        [(t.what, t.count, round(t.check_s, 4), t.pyramid_s) for t in results.timings],
    )
    write_csv(
        folder / "mission_files.csv",
        ("file", "over", "outcome", "reason"),
        [(s.file, s.over, s.outcome, s.reason) for s in results.samples],
    )
    write_atomic(folder / "results.md", table(results))
    _draw(folder / "tightness.png", partial(_draw_tightness, results))
    _draw(folder / "speed.png", partial(_draw_speed, results))


def table(results: Results) -> str:
    """Return the figures as Markdown."""
    tally = results.tally
    lines = [
        f"# The checker, measured (seed {results.seed})",
        "",
        "| soundness | made | proven | claims held against samples | strayed points looked at | violations |",
        "|---|---|---|---|---|---|",
    ]
    for trial in ("legs", "fleets"):
        claims = sum(count for of, count in tally.claims.items() if of.startswith(f"{trial}:"))
        looked = sum(count for of, count in tally.samples.items() if (of == "legs") == (trial == "legs"))
        bad = sum(violation.trial == trial for violation in tally.violations)
        made, proven = tally.made[trial], tally.made[f"proven {trial}"]
        lines.append(f"| {trial} | {made:,} | {proven:,} | {claims:,} | {looked:.3g} | {bad} |")
    lines += [
        f"\nVIOLATED: {v.of}: claimed {v.claimed:.3f}, seen {v.seen:.3f}: {v.where}" for v in tally.violations[:_SHOWN]
    ]
    if results.loose_m:
        q = _quantiles(results.loose_m)
        lines += [
            "",
            "| tightness: bound below the least height found | legs | median | 99 % | most | wanted |",
            "|---|---|---|---|---|---|",
            f"| m | {len(results.loose_m):,} | {q['median']:.2f} | {q['p99']:.2f} | {q['most']:.2f} | "
            f"99 % <= {TIGHT_P99_M:g} |",
        ]
    lines += ["", "| speed | count | check, s | pyramid, s | wanted |", "|---|---|---|---|---|"]
    wanted = {("vehicles", 5): FIVE_VEHICLES_S, ("vehicles", 100): HUNDRED_VEHICLES_S}
    for t in results.timings:
        pyramid = "" if t.pyramid_s is None else f"{t.pyramid_s:.3f}"
        most = wanted.get((t.what, t.count))
        lines.append(f"| {t.what} | {t.count:,} | {t.check_s:.3f} | {pyramid} | {f'<= {most:g}' if most else ''} |")
    for what in _EXPONENTS:
        power = exponent(results.timings, what)
        if power is not None:
            lines.append(f"\nGrows with {what}^{power:.2f}")
    if results.samples:
        lines += ["", "| mission file | over | outcome | reason |", "|---|---|---|---|"]
        lines += [f"| {s.file} | {s.over} | {s.outcome} | {s.reason.replace('|', '/')} |" for s in results.samples]
    return "\n".join(lines) + "\n"


def _quantiles(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return {}
    median, p99 = np.quantile(values, [0.5, 0.99])
    return {"least": min(values), "median": float(median), "p99": float(p99), "most": max(values)}


def _draw(path: Path, paint: Callable[[Figure], None]) -> None:
    figure = Figure(figsize=(7.0, 3.2), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    paint(figure)
    with replacing(path) as draft:
        figure.savefig(draft, format="png", metadata={"Software": None})


def _draw_tightness(results: Results, figure: Figure) -> None:
    axes = figure.subplots()
    axes.hist(results.loose_m, bins=60, color="#0072b2")
    axes.set(
        xlabel="bound below the least height found, m", ylabel="legs", yscale="log" if results.loose_m else "linear"
    )


def _draw_speed(results: Results, figure: Figure) -> None:
    for axes, what in zip(figure.subplots(1, len(_EXPONENTS)), _EXPONENTS, strict=True):
        found = [(t.count, t.check_s, t.pyramid_s) for t in results.timings if t.what == what]
        if not found:
            continue
        counts = [count for count, _, _ in found]
        axes.loglog(counts, [check for _, check, _ in found], "o-", color="#0072b2", label="check")
        if any(pyramid is not None for _, _, pyramid in found):
            axes.loglog(counts, [pyramid for _, _, pyramid in found], "s--", color="#d55e00", label="pyramid")
            axes.legend()
        axes.set(xlabel={"legs": "legs per vehicle", "vehicles": "vehicles", "cells": "cells"}[what])
        axes.set(ylabel="s" if what == _EXPONENTS[0] else "")
