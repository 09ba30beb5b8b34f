"""Adaptive against fixed weights of what is forbidden; ``missionplanner experiment weights``.

PAPER.md eq. 13 says "adaptive weight adjustment balances the sub-goals" and no more. Ours: what is traded off keeps the
weights that the mission gives; what is forbidden has, in the polish, one multiplier per kind of limit and sample, which
grows where the limit is violated and fades where it is not (the augmented Lagrangian of :mod:`missionplanner.polish`).
Against it: the same polish with one fixed weight for all, soft to stiff, and no polish at all. Whole fleets are
planned, everything else alike.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from missionplanner import path_search, planner
from missionplanner.errors import InfeasibleError
from missionplanner.experiments import campaign
from missionplanner.experiments.document import joined, machine
from missionplanner.files import ensure_writable, write_atomic, write_csv
from missionplanner.mission import load_mission
from missionplanner.polish import FULL, polish
from missionplanner.report import style
from missionplanner.scene import build_scene

Progress = Callable[[str, float], None]

ADAPTIVE = "adaptive"
SCHEMES = {
    ADAPTIVE: FULL,
    "fixed, 100": FULL._replace(rounds=1, steps=300, penalty=100.0),
    "fixed, 1,000": FULL._replace(rounds=1, steps=300, penalty=1_000.0),
    "fixed, 10,000": FULL._replace(rounds=1, steps=300, penalty=10_000.0),
    "no polish": FULL._replace(rounds=0),
}
EXAMPLES = ("quickstart", "mountain", "multi_domain", "ridge_line")
_QUICK_SEEDS = 2


def main(
    output: Path,
    *,
    missions: Sequence[Path],
    seed: int = 1,
    seeds: int = 5,
    quick: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and write its table and figure to a folder; return its figures as JSON values."""
    ensure_writable(output)
    chosen = range(seed, seed + (min(seeds, _QUICK_SEEDS) if quick else seeds))
    jobs = [
        campaign.Job(
            f"{mission.stem}-{scheme}-{s}", plan, {"mission": str(mission.resolve()), "scheme": scheme, "seed": s}
        )
        for mission in missions
        for s in chosen
        for scheme in SCHEMES
    ]
    version = campaign.version_of({"missions": [mission.read_text(encoding="utf-8") for mission in missions]})
    found = campaign.run(
        jobs, output, experiment="weights", version=version, workers=workers, cluster=cluster, progress=progress
    )
    rows = [
        {"mission": Path(job.arguments["mission"]).stem, "scheme": job.arguments["scheme"], **found[job.key]}
        for job in jobs
    ]
    table = [_summary(mission.stem, scheme, rows) for mission in missions for scheme in SCHEMES]
    _write(output, rows, table, len(chosen))
    return {"seeds": list(chosen), "rows": table}


def plan(mission: str, scheme: str, seed: int) -> dict[str, Any]:
    """Plan a fleet with the polish of a scheme; return what its paths cost, and the search of them."""
    path = Path(mission)
    scene = build_scene(load_mission(path), path.parent)
    begin_s = time.process_time()
    with patch.object(path_search, "polish", partial(polish, settings=SCHEMES[scheme])):
        try:
            fleet = planner.plan_fleet(scene, seed=seed)
        except InfeasibleError as error:
            return {"seed": seed, "proven": False, "error": str(error), "cpu_s": time.process_time() - begin_s}
    return {
        "seed": seed,
        "proven": True,
        "cost": float(np.mean([vehicle.cost for vehicle in fleet.vehicles])),
        "length_m": sum(vehicle.length_m for vehicle in fleet.vehicles),
        "evaluations": sum(vehicle.evaluations for vehicle in fleet.vehicles),
        "resolutions": len(fleet.resolutions),
        "cpu_s": time.process_time() - begin_s,
    }


def _summary(mission: str, scheme: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return one line of the table: medians over the seeds that are proven."""
    mine = [row for row in rows if (row["mission"], row["scheme"]) == (mission, scheme)]
    proven = [row for row in mine if row["proven"]]

    def median(name: str) -> float:
        return float(np.median([row[name] for row in proven])) if proven else float("nan")

    return {
        "mission": mission,
        "scheme": scheme,
        "proven": len(proven),
        "of": len(mine),
        "cost": median("cost"),
        "length_m": median("length_m"),
        "evaluations": median("evaluations"),
        "resolutions": median("resolutions"),
    }


def _write(output: Path, rows: Sequence[dict[str, Any]], table: Sequence[dict[str, Any]], seeds: int) -> None:
    columns = ["mission", "scheme", "seed", "proven", "cost", "length_m", "evaluations", "resolutions"]
    write_csv(output / "runs.csv", columns, [[row.get(name, "") for name in columns] for row in rows])
    lines = [
        f"| {row['mission']} | {row['scheme']} | {row['proven']} of {row['of']} | {row['cost']:.4f} "
        f"| {row['length_m']:,.0f} m | {row['evaluations']:,.0f} | {row['resolutions']:g} |"
        for row in table
    ]
    text = joined(
        "# Adaptive and fixed weights",
        f"Fleets planned with {seeds} seeds each; medians. The price is the mean of the vehicles', by the mission's "
        "weights: lower is better. Conflicts are those that a change of way or time had to resolve.",
        [
            "| mission | weights of what is forbidden | proven | price | length | evaluations | conflicts |",
            "|---|---|---|---|---|---|---|",
            *lines,
        ],
        _words(table),
        "![price by weights](weights.png)",
        machine(),
    )
    write_atomic(output / "results.md", text)
    write_atomic(output / "weights.png", _figure(table))


def _words(table: Sequence[dict[str, Any]]) -> str:
    """Return what the table says, in a sentence per rival."""
    own = {row["mission"]: row for row in table if row["scheme"] == ADAPTIVE}
    told = []
    for scheme in SCHEMES:
        rows = [row for row in table if row["scheme"] == scheme]
        if scheme == ADAPTIVE:
            continue
        gain = [100.0 * (row["cost"] / own[row["mission"]]["cost"] - 1.0) for row in rows]
        work = [row["evaluations"] / own[row["mission"]]["evaluations"] for row in rows]
        told.append(
            f"*{scheme}*: price {np.nanmean(gain):+.2f} % beside adaptive weights (mean over missions, from "
            f"{np.nanmin(gain):+.2f} to {np.nanmax(gain):+.2f} %), with {np.nanmean(work):.2f} times the evaluations."
        )
    return " ".join(told)


def _figure(table: Sequence[dict[str, Any]]) -> bytes:
    missions = list(dict.fromkeys(row["mission"] for row in table))
    with style.look():
        figure = style.new_figure(3.6)
        axes = figure.subplots()
        for k, scheme in enumerate(SCHEMES):
            costs = [row["cost"] for row in table if row["scheme"] == scheme]
            places = np.arange(len(missions)) + (k - 0.5 * (len(SCHEMES) - 1)) * 0.15
            axes.plot(places, costs, "o", color=style.vehicle_colour(k), markersize=6, label=scheme)
        axes.set_xticks(range(len(missions)), missions)
        axes.set_ylabel("price, mean of the vehicles'")
        axes.legend(title="weights of what is forbidden", fontsize=8, title_fontsize=8)
        style.quiet(axes)
        return style.to_png(figure)
