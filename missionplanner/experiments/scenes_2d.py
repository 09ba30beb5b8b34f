"""The paper's 2D grids, sparse and dense, with grids of our own; ``missionplanner experiment scenes-2d``.

The paper draws its grids and does not list them. These are made from stated seeds, and written to the folder as mission
files that can be planned and flown: buildings without top on level ground, a flight at one altitude.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.lines import Line2D
from scipy import ndimage

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
    table,
)
from missionplanner.experiments.scene_runs import GRID, resolved
from missionplanner.files import ensure_writable, write_atomic

Progress = Callable[[str, float], None]
Cells = npt.NDArray[np.bool_]

ALGORITHMS = ("pso", "ga", "gwo", "ssa", PAPER_FORM, BEST)
"""The paper's, its own in both forms."""

CELLS, CELL_M = 20, 50.0
CONTROLS = 5


@dataclass(frozen=True, slots=True)
class GridScene:
    """A grid of which a share of the cells is built on, drawn from a seed."""

    name: str
    share: float
    seed: int


SCENES = (GridScene("sparse", 0.12, 3), GridScene("dense", 0.20, 3))

_FREE = 2  # cells at both ends that stay free
_ALT_M = 50.0


def built(scene: GridScene) -> Cells:
    """Return which cells (rows from south, columns from west) are built on: the first draw that leaves a way.

    A way leads from free cell to free cell across their sides, from the south-west corner to the north-east one.
    """
    rng = np.random.default_rng(scene.seed)
    while True:
        cells: Cells = np.zeros(CELLS * CELLS, dtype=np.bool_)
        cells[rng.permutation(cells.size)[: round(scene.share * cells.size)]] = True
        cells = cells.reshape(CELLS, CELLS)
        cells[:_FREE, :_FREE] = cells[-_FREE:, -_FREE:] = False
        parts, _ = ndimage.label(~cells)
        if parts[0, 0] == parts[-1, -1]:
            return cells


def mission_text(scene: GridScene) -> str:
    """Return a grid as a mission file; cells side by side in a row are one building."""
    cells = built(scene)
    side_m = CELLS * CELL_M
    lines = [
        f"# {CELLS} x {CELLS} cells of {CELL_M:g} m, {cells.mean():.0%} of them built on (seed {scene.seed}).",
        f"name: grid_{scene.name}",
        "origin: {lat_deg: 46.55, lon_deg: 7.98}",
        "area:",
        "  south_west: {x_m: 0, y_m: 0}",
        f"  north_east: {{x_m: {side_m:g}, y_m: {side_m:g}}}",
        "terrain: {kind: flat, alt_amsl_m: 0}",
        "obstacles:",
    ]
    for row in range(CELLS):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], cells[row], [False]]).astype(int)))
        for first, last in edges.reshape(-1, 2).tolist():
            (west, east), (south, north) = (CELL_M * np.array([[first, last], [row, row + 1]])).tolist()
            corners = ", ".join(f"{{x_m: {x:g}, y_m: {y:g}}}" for x, y in
                                ((west, south), (east, south), (east, north), (west, north)))  # fmt: skip
            lines.append(f"  - {{kind: no_fly, name: b{row}-{first}, polygon: [{corners}]}}")
    start, goal = 0.5 * _FREE * CELL_M, side_m - 0.5 * _FREE * CELL_M
    lines += [
        "defaults: {speed_m_s: {min: 1, max: 10}, safety: {obstacle_m: 5}, end: loiter}",
        "vehicles:",
        f"  - {{name: uav, start: {{x_m: {start:g}, y_m: {start:g}, alt_amsl_m: {_ALT_M:g}}}, "
        f"goal: {{x_m: {goal:g}, y_m: {goal:g}, alt_amsl_m: {_ALT_M:g}}}}}",
        "fleet: {direct_return: waived}",
    ]
    return "\n".join(lines) + "\n"


def main(
    output: Path,
    *,
    runs: int = RUNS,
    quick: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    ensure_writable(output)
    texts = {scene.name: mission_text(scene) for scene in SCENES}
    for name, text in texts.items():
        write_atomic(output / f"grid_{name}.yaml", text)
    problems = [Problem(name, text, ALGORITHMS, CONTROLS, planar=True) for name, text in texts.items()]
    found = compare(
        output,
        "scenes-2d",
        problems,
        QUICK_RUNS if quick else runs,
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    comparisons = dict(zip(texts, found, strict=True))
    for name, comparison in comparisons.items():
        comparison.write_runs(output / f"{name}.csv")
    figures.save_png(output / "paths.png", _paths(comparisons))
    figures.save_png(output / "fitness.png", _fitness(comparisons))
    write_atomic(output / "results.md", report(comparisons))
    return {name: comparison.as_json() for name, comparison in comparisons.items()}


def report(comparisons: dict[str, Comparison]) -> str:
    """Return the results as Markdown."""
    parts: list[str | list[str]] = ["# 2D grids, sparse and dense"]
    for scene in SCENES:
        comparison = comparisons[scene.name]
        runs = len(comparison.results[BEST])
        parts += [
            f"## {scene.name.capitalize()}: {built(scene).mean():.0%} of {CELLS} x {CELLS} cells",
            f"{runs} runs each of {GRID[-1]:,} evaluations, {comparison.controls} control points in the plane, random "
            "starts. The last row is this planner from its own first guesses.",
            table(comparison),
            f"Best form against each rival, runs better / equal / worse: {'; '.join(comparison.beaten())}.",
        ]
    return joined(
        *parts,
        "![Paths of the runs of median cost](paths.png)",
        "![Fitness curves: medians, shaded between quartiles](fitness.png)",
        forgiven(),
        made(list(comparisons.values())),
    )


def _paths(comparisons: dict[str, Comparison]) -> Any:
    figure = figures.new_figure(8.0, 4.7)
    for axes, (name, comparison) in zip(figure.subplots(1, len(comparisons)), comparisons.items(), strict=True):
        scene, judge = resolved(comparison.text)
        figures.from_above(axes, scene.mission, judge)
        for algorithm in comparison.found:
            figures.ways_from_above(
                axes,
                comparison.paths(algorithm),
                [figures.COLOURS[algorithm]],
                1.8 if algorithm in {BEST, PLANNER} else 1.1,
            )
        axes.set(xlabel="east, m", ylabel="north, m")
        figures.titled(axes, f"{name}: runs of median cost")
    figures.key(figure, _handles([*ALGORITHMS, PLANNER]))
    return figure


def _fitness(comparisons: dict[str, Comparison]) -> Any:
    figure = figures.new_figure(8.0, 3.4)
    for axes, (name, comparison) in zip(figure.subplots(1, len(comparisons)), comparisons.items(), strict=True):
        figures.convergence(axes, GRID, comparison.curves(), TITLES)
        figures.titled(axes, name)
    figures.key(figure, _handles(ALGORITHMS))
    return figure


def _handles(names: Any) -> list[Line2D]:
    return [Line2D([], [], color=figures.COLOURS[name], label=TITLES[name], linewidth=1.6) for name in names]
