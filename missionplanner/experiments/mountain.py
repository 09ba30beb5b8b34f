"""The paper's mountain scene: five vehicles, its six algorithms (Table IV); ``missionplanner experiment mountain``.

Two problems, side by side: the paper's own kind, a search on spline control points from random starts, and the same
mission planned by this software as it is shipped.
"""

from __future__ import annotations

import heapq
import itertools
import math
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from missionplanner import mission
from missionplanner.experiments import scene_figures as figures
from missionplanner.experiments.document import joined
from missionplanner.experiments.scene_comparison import (
    BEST,
    PAPER_FORM,
    PLANNER,
    QUICK_RUNS,
    RUNS,
    TITLES,
    Comparison,
    Problem,
    compare,
    forgiven,
    made,
    mission_text,
    table,
)
from missionplanner.experiments.scene_judge import xy
from missionplanner.experiments.scene_runs import GRID, resolved
from missionplanner.files import ensure_writable, write_atomic
from missionplanner.geodesy import FloatArray

Progress = Callable[[str, float], None]

ALGORITHMS = ("pso-sa", "abc-sa", "qpso", "pso", "avoa", PAPER_FORM, BEST)
"""The paper's six, its own in both forms."""

PAPER = {
    "pso-sa": ("182.1", "221.2", "182.9", "46.36 s", "1816", "85.9 %"),
    "abc-sa": ("189.2", "201.4", "190.9", "41.31 s", "1703", "83.1 %"),
    "qpso": ("183.3", "191.7", "185.4", "36.23 s", "1653", "93.3 %"),
    "pso": ("182.7", "193.9", "185.1", "32.18 s", "1875", "89.7 %"),
    "avoa": ("188.5", "209.8", "189.1", "32.87 s", "1723", "90.5 %"),
    PAPER_FORM: ("181.1", "190.6", "182.0", "40.32 s", "1624", "94.2 %"),
}
"""Table IV as printed: best, worst and average cost, time, best length ("km"), avoidance rate."""

CONTROLS = (10, 5)
"""Control points per vehicle. The paper does not say how many; lengths like its own come of ten."""

WANTED_EXCESS = 0.01

_PANELS = (*ALGORITHMS, PLANNER)


def main(
    output: Path,
    *,
    mission: Path,
    runs: int = RUNS,
    quick: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    ensure_writable(output)
    text = mission_text(mission)
    problems = [Problem("mountain", text, ALGORITHMS, k, planner=k == CONTROLS[0]) for k in CONTROLS]
    found = compare(
        output,
        "mountain",
        problems,
        QUICK_RUNS if quick else runs,
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    for comparison in found:
        comparison.write_runs(output / f"runs_{comparison.controls}.csv")
    draw_all(output, found[0], _PANELS, view=(24, -62))
    write_atomic(output / "results.md", report(found))
    return {"problems": [c.as_json() for c in found], "planner": planned(found[0])}


def draw_all(folder: Path, comparison: Comparison, panels: Sequence[str], view: tuple[float, float]) -> None:
    """Draw a scene and the runs of median cost in it: in space, from above, pitch, fitness."""
    panels = [name for name in panels if name in comparison.found]
    figures.save_png(folder / "scene.png", _scene(comparison, panels[-1], view))
    figures.save_png(folder / "space.png", _space(comparison, panels, view))
    figures.save_png(folder / "above.png", _above(comparison, panels))
    figures.save_png(folder / "pitch.png", _pitch(comparison, panels))
    figures.save_png(folder / "fitness.png", _fitness(comparison))


# --- bounds ----------------------------------------------------------------------------------------------------------


def shortest_m(start: FloatArray, goal: FloatArray, centres: FloatArray, radii_m: FloatArray) -> float:
    """Return the length of the shortest way (2,) to (2,) around discs (N, 2): their tangent visibility graph."""
    middles = np.concatenate([[start, goal], centres])
    radii = np.concatenate([[0.0, 0.0], radii_m])

    def free(points: FloatArray, *but: int) -> bool:
        others = [k for k in range(2, len(radii)) if k not in but]
        if not others:
            return True
        a, move = points[:-1, None], np.diff(points, axis=0)[:, None]
        share = ((middles[others] - a) * move).sum(axis=-1) / np.maximum((move**2).sum(axis=-1), 1e-18)
        nearest = a + np.clip(share, 0.0, 1.0)[..., None] * move
        return bool((np.linalg.norm(nearest - middles[others], axis=-1) >= radii[others] - 1e-9).all())

    places: list[FloatArray] = [start, goal]
    on: dict[int, list[int]] = {}  # the places on a disc's rim
    edges: dict[int, list[tuple[int, float]]] = {0: [], 1: []}

    def join(a: int, b: int, length: float) -> None:
        edges.setdefault(a, []).append((b, length))
        edges.setdefault(b, []).append((a, length))

    def place(disc: int, point: FloatArray) -> int:
        if disc < 2:
            return disc
        places.append(point)
        on.setdefault(disc, []).append(len(places) - 1)
        return len(places) - 1

    for i, j in itertools.combinations(range(len(radii)), 2):
        between = middles[j] - middles[i]
        far, course = float(np.hypot(*between)), math.atan2(between[1], between[0])
        for one, other in {(a * radii[i], b * radii[j]) for a in (1, -1) for b in (1, -1)}:
            if abs(one - other) > far:
                continue
            turned = course + math.acos((one - other) / far)
            normal = np.array([math.cos(turned), math.sin(turned)])
            ends = np.stack([middles[i] + one * normal, middles[j] + other * normal])
            if free(ends, i, j):
                join(place(i, ends[0]), place(j, ends[1]), float(np.linalg.norm(ends[1] - ends[0])))
    for disc, rim in on.items():
        angle = {n: math.atan2(*(places[n] - middles[disc])[::-1]) for n in rim}
        order = sorted(rim, key=lambda n: angle[n])
        for a, b in zip(order, [*order[1:], order[0]], strict=True):
            sweep = (angle[b] - angle[a]) % (2.0 * math.pi)
            turn = angle[a] + np.linspace(0.0, sweep, 65)
            arc = middles[disc] + radii[disc] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            if free(arc, disc):
                join(a, b, radii[disc] * sweep)
    best, heap = {0: 0.0}, [(0.0, 0)]
    while heap:
        length, at = heapq.heappop(heap)
        if at == 1:
            return length
        if length > best[at]:
            continue
        for after, more in edges[at]:
            if length + more < best.get(after, math.inf):
                best[after] = length + more
                heapq.heappush(heap, (length + more, after))
    return math.inf


def bounds_m(text: str) -> list[float]:
    """Return for each vehicle a length that no path of its can be below: alone among the cylinders, tube included.

    The way around cylinders without top is as short as in the plane, climbing evenly; a climb limit may ask for more.
    """
    scene, _ = resolved(text)
    cylinders = [o for o in scene.mission.obstacles if isinstance(o, mission.Cylinder)]
    centres = np.array([xy(o.center) for o in cylinders])
    found = []
    for task in scene.tasks:
        keep_m = task.limits.obstacle_margin_m + task.limits.tube_m
        start, goal = task.route_m[0], task.route_m[-1]
        level_m = shortest_m(start[:2], goal[:2], centres, np.array([o.radius_m + keep_m for o in cylinders]))
        up_m = float(goal[2] - start[2])
        limit = task.limits.climb_angle_rad if up_m > 0.0 else task.limits.descent_angle_rad
        found.append(max(math.hypot(level_m, up_m), abs(up_m) / math.sin(limit)))
    return found


def planned(comparison: Comparison) -> dict[str, Any]:
    """Return what the planner's runs kept, and how long its paths are beside their bounds."""
    bounds = bounds_m(comparison.text)
    runs = [run for run in comparison.results[PLANNER] if not run["error"]]
    if not runs:
        failed = comparison.results[PLANNER]
        return {"runs": len(failed), "failed": len(failed), "error": failed[0]["error"]}
    sums = [run["length_m"] for run in runs]
    summary = comparison.summary(PLANNER)
    return {
        "runs": len(comparison.results[PLANNER]),
        "failed": summary["failed"],
        "paths": summary["paths"],
        "clear_and_separated": summary["all"],
        "bound_m": sum(bounds),
        "length_m": {"best": min(sums), "median": statistics.median(sums), "worst": max(sums)},
        "excess": {"median": statistics.median(sums) / sum(bounds) - 1.0, "worst": max(sums) / sum(bounds) - 1.0},
        "least_apart_m": min(v["apart_m"] for run in runs for v in run["vehicles"]),
        "search_ms": {
            "once": 1000.0 * statistics.median(s for run in runs for s in run["searches_s"]),
            "legs": 1000.0 * statistics.median(s for run in runs for s in run["legs_s"]),
            "per_vehicle": 1000.0
            * statistics.median(sum(run["searches_s"] + run["legs_s"]) / len(bounds) for run in runs),
        },
        "cpu_ms_per_vehicle": 1000.0 * summary["cpu_s"] / len(bounds),
    }


# --- what is written -------------------------------------------------------------------------------------------------


def report(found: Sequence[Comparison]) -> str:
    """Return the results as Markdown."""
    first, kept = found[0], planned(found[0])
    vehicles = len(first.typical(BEST)["vehicles"])
    runs = len(first.results[BEST])
    parts: list[str | list[str]] = [
        "# Mountain scene",
        f"{runs} runs each, {vehicles} vehicles: {runs * vehicles} paths per algorithm; {GRID[-1]:,} evaluations per "
        f"vehicle (the paper's 50 x 200). Time is the processor's, of one run. {forgiven()}",
    ]
    for comparison in found:
        parts += [
            f"## Searched from random starts: {comparison.controls} control points per vehicle",
            table(comparison, PAPER if comparison is first else None),
            f"Best form against each rival, runs better / equal / worse: {'; '.join(comparison.beaten())}.",
        ]
    rivals = [1000.0 * found[-1].summary(name)["cpu_s"] / vehicles for name in found[-1].searched]
    parts += [
        "## Planned by this software",
        _planned_lines(kept),
        f"The searches from random starts above take {min(rivals):,.0f} to {max(rivals):,.0f} ms per vehicle.",
        "![The scene and this planner's paths](scene.png)",
        "![Paths in space, runs of median cost](space.png)",
        "![Paths from above](above.png)",
        "![Climb angle along the paths of the first vehicle](pitch.png)",
        "![Fitness curves: medians, shaded between quartiles](fitness.png)",
        made(found),
    ]
    return joined(*parts)


def _planned_lines(kept: dict[str, Any]) -> list[str]:
    if kept["failed"] == kept["runs"]:
        return [f"Plans found: 0 of {kept['runs']}. {kept['error']}"]
    length, excess, search = kept["length_m"], kept["excess"], kept["search_ms"]
    return [
        "| | |",
        "|---|---|",
        f"| plans found | {kept['runs'] - kept['failed']} of {kept['runs']} |",
        f"| paths clear with their whole tube, separated and flyable | {kept['clear_and_separated']} of "
        f"{kept['paths']} (paper: 94.2 %) |",
        f"| least distance of two predicted flights | {kept['least_apart_m']:.1f} m |",
        f"| sum of lengths: best, median, worst | {length['best']:,.1f}, {length['median']:,.1f}, "
        f"{length['worst']:,.1f} m |",
        f"| bound: sum of shortest ways of each vehicle alone, straight and sharp | {kept['bound_m']:,.1f} m |",
        f"| above the bound: median, worst (wanted: {WANTED_EXCESS:.0%}) | {excess['median']:.2%}, "
        f"{excess['worst']:.2%} |",
        f"| processor time of one path's search; of fitting its legs and proving them | {search['once']:,.1f} ms; "
        f"{search['legs']:,.1f} ms |",
        f"| both per vehicle, with the searches of those who gave way to others | {search['per_vehicle']:,.1f} ms |",
        f"| processor time per vehicle with timing and proof | {kept['cpu_ms_per_vehicle']:,.0f} ms |",
    ]


def _space(comparison: Comparison, panels: Sequence[str], view: tuple[float, float]) -> Figure:
    rows = math.ceil(len(panels) / 4)
    figure = figures.new_figure(9.0, 2.5 * rows)
    for k, name in enumerate(panels):
        axes: Any = figure.add_subplot(rows, 4, k + 1, projection="3d")
        _draw_in_space(axes, comparison, name, view)
        figures.titled(axes, TITLES[name])
    return figure


def _scene(comparison: Comparison, name: str, view: tuple[float, float]) -> Figure:
    """Draw the scene larger, in space and from above, with one algorithm's paths."""
    scene, judge = resolved(comparison.text)
    figure = figures.new_figure(9.0, 4.2)
    _draw_in_space(figure.add_subplot(1, 2, 1, projection="3d"), comparison, name, view)
    axes = figure.add_subplot(1, 2, 2)
    figures.from_above(axes, scene.mission, judge)
    figures.ways_from_above(axes, comparison.paths(name), figures.vehicle_colours(len(scene.tasks)))
    axes.set(xlabel="east, m", ylabel="north, m")
    handles = [
        Line2D([], [], color=colour, label=task.name, linewidth=1.6)
        for task, colour in zip(scene.tasks, figures.vehicle_colours(len(scene.tasks)), strict=True)
    ]
    figures.key(figure, handles, min(len(handles), len(figures.VEHICLES)))
    return figure


def _draw_in_space(axes: Any, comparison: Comparison, name: str, view: tuple[float, float]) -> None:
    scene, judge = resolved(comparison.text)
    ends = np.concatenate([task.route_m for task in scene.tasks])
    top_m = max(float(ends[:, 2].max()), float(np.nanmax(scene.terrain.arrays.height_amsl_m))) + 100.0
    figures.in_space(axes, scene.mission, judge, top_m, view)
    figures.ways_in_space(axes, comparison.paths(name), figures.vehicle_colours(len(scene.tasks)))


def _above(comparison: Comparison, panels: Sequence[str]) -> Figure:
    scene, judge = resolved(comparison.text)
    rows = math.ceil(len(panels) / 4)
    figure = figures.new_figure(9.0, 2.15 * rows)
    grid = figure.subplots(rows, 4, sharex=True, sharey=True)
    for axes, name in zip(grid.flat, panels, strict=False):
        figures.from_above(axes, scene.mission, judge)
        figures.ways_from_above(axes, comparison.paths(name), figures.vehicle_colours(len(scene.tasks)), 1.0)
        figures.titled(axes, TITLES[name])
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    return figure


def _pitch(comparison: Comparison, panels: Sequence[str]) -> Figure:
    figure = figures.new_figure(8.0, 3.2)
    axes = figure.subplots()
    for name in panels:
        figures.pitch(axes, comparison.paths(name)[0], figures.COLOURS[name])
    _legend(figure, panels)
    return figure


def _fitness(comparison: Comparison) -> Figure:
    figure = figures.new_figure(6.4, 3.6)
    figures.convergence(figure.subplots(), GRID, comparison.curves(), TITLES)
    _legend(figure, comparison.searched)
    return figure


def _legend(figure: Figure, names: Sequence[str]) -> None:
    figures.key(figure, [Line2D([], [], color=figures.COLOURS[n], label=TITLES[n], linewidth=1.6) for n in names])
