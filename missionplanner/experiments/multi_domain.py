"""Land, sea and air after the paper's multi-domain scene (figures 8-11); ``missionplanner experiment multi-domain``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from missionplanner.experiments.document import joined
from missionplanner.experiments.mountain import ALGORITHMS, draw_all
from missionplanner.experiments.scene_comparison import (
    BEST,
    PLANNER,
    QUICK_RUNS,
    RUNS,
    Comparison,
    Problem,
    compare,
    forgiven,
    made,
    mission_text,
    table,
)
from missionplanner.experiments.scene_runs import GRID
from missionplanner.files import ensure_writable, write_atomic

Progress = Callable[[str, float], None]

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
    (found,) = compare(
        output,
        "multi-domain",
        [Problem("multi-domain", mission_text(mission), ALGORITHMS)],
        QUICK_RUNS if quick else runs,
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    found.write_runs(output / "runs.csv")
    draw_all(output, found, _PANELS, view=(38, -72))
    write_atomic(output / "results.md", report(found))
    return found.as_json()


def report(found: Comparison) -> str:
    """Return the results as Markdown."""
    vehicles, runs = len(found.typical(BEST)["vehicles"]), len(found.results[BEST])
    return joined(
        "# Multi-domain scene",
        f"{runs} runs each, {vehicles} vehicles: {runs * vehicles} paths per algorithm; {GRID[-1]:,} evaluations per "
        f"vehicle, {found.controls} control points, random starts. The last row is this planner. Time is the "
        f"processor's, of one run. {forgiven()}",
        table(found),
        f"Best form against each rival, runs better / equal / worse: {'; '.join(found.beaten())}.",
        "Brown: cones; purple: radar zones; blue: storms at sea; red: no-fly boxes, one at sea, one in the sky.",
        "![The scene and this planner's paths](scene.png)",
        "![Paths in space, runs of median cost](space.png)",
        "![Paths from above](above.png)",
        "![Climb angle along the paths of the first vehicle](pitch.png)",
        "![Fitness curves: medians, shaded between quartiles](fitness.png)",
        made([found]),
    )
