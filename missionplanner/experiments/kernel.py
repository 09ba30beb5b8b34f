"""How fast costs are computed, and how far that is from the machine's pace; ``missionplanner experiment kernel``.

The UAV objective's kernel beside a yardstick (a module as `uavbench`: ``Inst(name, H, threats, start, end)`` with
``fb(points)``), and the price of paths on missions. All are timed in turn, many times, in one run; a ratio is the
median of the ratios of turns. On one core the processor's time counts, whatever else the machine does; how much faster
two are can only be told by the clock, of a machine that does nothing else. The least that the arithmetic needs is
counted by formula, and held against multiplications and additions on registers' worth of numbers.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missionplanner.compiled import njit
from missionplanner.cost import Price
from missionplanner.errors import MissionError
from missionplanner.experiments import uav_objective
from missionplanner.experiments.document import joined, machine
from missionplanner.experiments.uav_objective import Instance
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv
from missionplanner.geodesy import FloatArray
from missionplanner.mission import load_mission
from missionplanner.scene import Scene, build_scene
from missionplanner.search.run import minimise

Progress = Callable[[str, float], None]

_TURNS, _QUICK_TURNS = 41, 5
_POINTS = 8192
_PATHS = 512
_SAMPLES = 129
_SETTLED = 6000  # evaluations after which points are near a good path
_PACE_NUMBERS = 64
_PACE_ROUNDS = 20_000


@dataclass(frozen=True, slots=True)
class Measured:
    """One population, priced again and again: medians over the turns."""

    kernel: str
    case: str
    each_us: float  # on one core
    yardstick_us: float | None
    times_yardstick: float | None
    times_two_cores: float  # as fast as on one
    flops: float  # the least that the arithmetic needs, per evaluation
    samples: int  # of the ground, per evaluation, at least

    @property
    def gflops(self) -> float:
        """Return the pace of what is needed, 10^9 operations per second."""
        return self.flops / self.each_us * 1e-3


def main(
    folder: Path,
    *,
    instances: Path | None = None,
    yardstick: Path | None = None,
    missions: Sequence[Path] = (),
    seed: int = 1,
    quick: bool = False,
    progress: Progress = lambda _what, _share: None,
) -> dict[str, Any]:
    """Measure; write results.md, kernel.csv and kernel.png into ``folder``; return the figures.

    Raises
    ------
    MissionError
        No instances in ``instances``; no such yardstick or mission; the folder cannot be written to.
    """
    ensure_writable(folder)
    turns = _QUICK_TURNS if quick else _TURNS
    cases = _instances(instances, seed)
    other = None if yardstick is None else _yardstick(yardstick)
    scenes = [(path.stem, build_scene(load_mission(path), path.parent)) for path in missions]
    pace = _pace(turns)
    measured: list[Measured] = []
    for k, instance in enumerate(cases, start=1):
        measured += _objective(instance, other, turns, seed)
        progress("UAV objective", k / len(cases))
    for k, (name, scene) in enumerate(scenes, start=1):
        measured.append(_price(name, scene, turns, seed))
        progress("price of paths", k / len(scenes))
    _write(folder, measured, pace, quick=quick)
    return {
        "measured": [asdict(m) | {"gflops": m.gflops} for m in measured],
        "pace_gflops": pace,
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


# --- what is measured ------------------------------------------------------------------------------------------------


def _instances(folder: Path | None, seed: int) -> list[Instance]:
    if folder is None:
        return [made(seed, 15), made(seed + 1, 30)]
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise MissionError(f"{folder}: expected a folder with instances (*.npz), got none")
    return [uav_objective.load(path) for path in paths]


def made(seed: int, threats: int, size: int = 900) -> Instance:
    """Return an instance of the benchmark's kind: hills, and so many cylinders, on a map of ``size`` metres."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0.0:size, 0.0:size] / size
    heights = np.zeros((size, size))
    for wide in rng.uniform(0.05, 0.25, 24):
        cx, cy, up = *rng.random(2), rng.uniform(-400.0, 500.0)
        heights += up * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / wide**2)
    places = np.floor(rng.uniform(0.1 * size, 0.9 * size, (threats, 2)))
    cylinders = np.column_stack([places, np.zeros(threats), np.floor(rng.uniform(0.06, 0.09, threats) * size)])
    start, end = np.array([0.08 * size, 0.09 * size, 150.0]), np.array([0.92 * size, 0.9 * size, 150.0])
    return uav_objective.make(f"made-{threats}", heights, cylinders, start, end)


def _yardstick(path: Path) -> Any:
    """Return the module at ``path``."""
    spec = importlib.util.spec_from_file_location(path.stem, path) if path.suffix == ".py" and path.is_file() else None
    if spec is None or spec.loader is None:
        raise MissionError(f"--yardstick: expected a Python file, got {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # numba looks for what it has cached by this name
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # it may do anything
        raise _no_yardstick(error, path) from error
    if not hasattr(module, "Inst"):
        raise MissionError(f"--yardstick {path}: expected a class Inst(name, H, threats, start, end), got none")
    return module


def _no_yardstick(error: Exception, what: object) -> MissionError:
    reason = " ".join(f"{type(error).__name__}: {error}".split())
    return MissionError(f"--yardstick: expected an implementation as uavbench.py, got of {what}: {reason}")


def _beside(other: Any, instance: Instance) -> Callable[[FloatArray], Any]:
    """Return the yardstick's prices of an instance, once they are seen to be ours."""
    a = instance.arrays
    points = np.linspace(instance.lower, instance.upper, 5)
    try:
        made = other.Inst(instance.name, a.height_m, a.threat, a.start, a.end, instance.dimensions // 3)
        prices: Callable[[FloatArray], Any] = made.fb
        same = np.allclose(prices(points), instance.price(points), rtol=1e-9, atol=0.0)
    except Exception as error:  # it may do anything
        raise _no_yardstick(error, instance.name) from error
    if not same:
        raise MissionError(f"--yardstick: expected the prices of {instance.name}, got others")
    return prices


def _objective(instance: Instance, other: Any, turns: int, seed: int) -> list[Measured]:
    rng = np.random.default_rng(seed)
    lower, upper = instance.lower, instance.upper
    best = minimise(instance.price, lower, upper, algorithm="pso", evaluations=_SETTLED, seed=seed).best
    near = np.clip(best + rng.normal(0.0, 0.01, (_POINTS, len(lower))) * (upper - lower), lower, upper)
    arrays = instance.arrays
    theirs = None if other is None else _beside(other, instance)
    found = []
    for what, points in (("random", rng.uniform(lower, upper, near.shape)), ("settled", near)):
        works: list[Callable[[], object]] = [
            lambda points=points: instance.price(points, 1),  # type: ignore[misc]
            lambda points=points: instance.price(points, 2),  # type: ignore[misc]
        ]
        if theirs is not None:
            if not np.allclose(theirs(points), instance.price(points), rtol=1e-9, atol=0.0):
                raise MissionError(f"--yardstick: expected the prices of {instance.name}, got others")
            works.append(lambda points=points: theirs(points))  # type: ignore[misc]
        clock, took = _in_turn(works, turns)
        found.append(
            Measured(
                kernel="UAV objective",
                case=f"{instance.name} {what}",
                each_us=float(np.median(took[:, 0])) / len(points) * 1e6,
                yardstick_us=float(np.median(took[:, 2])) / len(points) * 1e6 if theirs is not None else None,
                times_yardstick=float(np.median(took[:, 2] / took[:, 0])) if theirs is not None else None,
                times_two_cores=float(np.median(clock[:, 0] / clock[:, 1])),
                flops=objective_flops(instance.dimensions // 3, len(arrays.threat)),
                samples=instance.dimensions // 3 + 2,
            )
        )
    return found


def objective_flops(vectors: int, threats: int) -> float:
    """Return the operations that one evaluation needs at least: every leg against every cylinder, no ground to check.

    An addition, multiplication, comparison, root or selection is one; sine and cosine by their shortest series.
    """
    legs = vectors + 1
    decoding = vectors * (2 * (14 + 16) + 10 + 9)
    each_leg = 15 + 8  # steps, lengths; the highest ground around it
    angles = vectors * 18
    return float(decoding + legs * (each_leg + 16 * threats) + angles + 12 * (vectors + 2) + 3 * vectors)


def price_flops(samples: int) -> float:
    """Return the operations that one path of so many samples needs at least, obstacles apart.

    Per sample: length, bending and climb; place in the grid and the surface there; its block's box; how far inside the
    area it is.
    """
    return float(samples * (48 + (36 + 2 * 14 + 35) + 6 + 6))


def _price(name: str, scene: Scene, turns: int, seed: int) -> Measured:
    task = scene.tasks[0]
    start, goal = task.route_m[0], task.route_m[-1]
    route_m = float(np.linalg.norm(np.diff(task.route_m, axis=0), axis=1).sum())
    price = Price(scene.space, task.limits, route_m, scene.mission.planner.weights)
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, _SAMPLES)[:, np.newaxis]
    waves = sum(
        rng.normal(0.0, 0.03 * route_m / k, (_PATHS, 1, 3)) * [1.0, 1.0, 0.2] * np.sin(k * np.pi * s)
        for k in range(1, 6)
    )
    paths = np.ascontiguousarray(start + s * (goal - start) + waves)
    clock, took = _in_turn([lambda: price.total(paths, threads=1), lambda: price.total(paths, threads=2)], turns)
    return Measured(
        kernel="price",
        case=name,
        each_us=float(np.median(took[:, 0])) / _PATHS * 1e6,
        yardstick_us=None,
        times_yardstick=None,
        times_two_cores=float(np.median(clock[:, 0] / clock[:, 1])),
        flops=price_flops(_SAMPLES),
        samples=_SAMPLES,
    )


def _in_turn(works: Sequence[Callable[[], object]], turns: int) -> tuple[FloatArray, FloatArray]:
    """Return seconds (turns, works) by the clock and of this thread, one work after the other, after one turn more."""
    took = np.empty((2, turns + 1, len(works)))
    for turn in range(turns + 1):
        for k, work in enumerate(works):
            begun, begun_here = time.perf_counter(), time.thread_time()
            work()
            took[0, turn, k] = time.perf_counter() - begun
            took[1, turn, k] = time.thread_time() - begun_here
    return took[0, 1:], took[1, 1:]


@njit(error_model="numpy", nogil=True)
def _multiply_and_add(a: FloatArray, rounds: int) -> None:
    for _ in range(rounds):
        for k in range(a.shape[0]):
            a[k] = a[k] * 0.999 + 0.001


def _pace(turns: int) -> float:
    """Return the pace of multiplications and additions on one core, on numbers that are at hand; 10^9 per second."""
    a = np.ones(_PACE_NUMBERS)
    _, took = _in_turn([lambda: _multiply_and_add(a, _PACE_ROUNDS)], turns)
    pace: float = 2.0 * _PACE_NUMBERS * _PACE_ROUNDS / float(np.median(took)) * 1e-9
    return pace


# --- what is written -------------------------------------------------------------------------------------------------


def _write(folder: Path, measured: Sequence[Measured], pace: float, *, quick: bool) -> None:
    fields = list(Measured.__dataclass_fields__)
    write_csv(
        folder / "kernel.csv",
        [*fields, "evaluations_per_s", "gflops", "of_the_pace"],
        [[*(getattr(m, f) for f in fields), 1e6 / m.each_us, m.gflops, m.gflops / pace] for m in measured],
    )
    write_atomic(folder / "results.md", report(measured, pace, quick=quick))
    with replacing(folder / "kernel.png") as draft:
        _drawn(measured).savefig(draft, format="png", metadata={"Software": None})


def report(measured: Sequence[Measured], pace: float, *, quick: bool = False) -> str:
    """Return the figures as Markdown."""
    beside = any(m.times_yardstick is not None for m in measured)
    head = "| kernel | case | evaluations/s, one core | µs each |" + " yardstick, µs | times as fast |" * beside
    head += " two cores, times | operations needed | 10^9/s | of the pace |"
    lines = [head, "|---" * (head.count("|") - 1) + "|"]
    for m in measured:
        row = f"| {m.kernel} | {m.case} | {1e6 / m.each_us:,.0f} | {m.each_us:.2f} |"
        if beside:
            row += (
                " | |" if m.yardstick_us is None or m.times_yardstick is None
                else f" {m.yardstick_us:.2f} | {m.times_yardstick:.1f} |"
            )  # fmt: skip
        lines.append(row + f" {m.times_two_cores:.2f} | {m.flops:,.0f} | {m.gflops:.2f} | {m.gflops / pace:.0%} |")
    load = f" Load when done: {os.getloadavg()[0]:.1f}." if hasattr(os, "getloadavg") else ""
    return joined(
        "# Evaluations per second",
        machine() + load,
        f"Quick: {_QUICK_TURNS} turns instead of {_TURNS}; a look, no measurement." if quick else "",
        "Medians over turns in which all are timed one after the other. Random points are drawn from the box; settled "
        "ones lie within about a hundredth of it around a point that a search found. Paths wave about the way. One "
        "core: time of the processor; two cores: by the clock, and true only of a machine that did nothing else.",
        lines,
        f"Operations needed are counted by formula: what no arrangement of the same arithmetic can leave out, as every "
        "leg against every cylinder. Samples of the ground, sharp angles and obstacles within reach come on top where "
        f"there are any. The pace is that of multiplications and additions on {_PACE_NUMBERS} numbers at hand: "
        f"{pace:.1f} x 10^9 per second on one core; roots, divisions and what is looked up take several times as long "
        "as one of these.",
        "![Evaluations per second](kernel.png)",
    )


def _drawn(measured: Sequence[Measured]) -> Figure:
    objective = [m for m in measured if m.kernel == "UAV objective"]
    prices = [m for m in measured if m.kernel == "price"]
    figure = Figure(
        figsize=(7.4, 0.9 + 0.36 * len(objective) + 0.4 * bool(prices) * (2 + len(prices))),
        dpi=150,
        layout="constrained",
    )
    FigureCanvasAgg(figure)
    panels = [p for p in (objective, prices) if p]
    axes = figure.subplots(len(panels), 1, squeeze=False, height_ratios=[len(p) + 1 for p in panels])[:, 0]
    for ax, panel in zip(axes, panels, strict=True):
        place = np.arange(len(panel))
        one = np.array([1e3 / m.each_us for m in panel])
        bars = [("two cores", one * [m.times_two_cores for m in panel], "#56b4e9"), ("one core", one, "#0072b2")]
        if any(m.yardstick_us for m in panel):
            theirs = np.array([1e3 / (m.yardstick_us or np.nan) for m in panel])
            bars.append(("yardstick, one core", theirs, "#d55e00"))
        for k, (label, values, colour) in enumerate(bars):
            ax.barh(place + 0.27 * (k - 1), values, 0.26, color=colour, label=label)
        ax.set_yticks(place, [m.case for m in panel])
        ax.invert_yaxis()
        ax.set_xlabel("thousands of evaluations per second")
        ax.set_title("UAV path objective" if panel is objective else "price of paths", loc="left", fontsize=9)
        ax.grid(True, axis="x")
        ax.set_axisbelow(True)
    axes[0].legend(fontsize=7.5, loc="lower right", frameon=True, edgecolor="none")
    return figure
