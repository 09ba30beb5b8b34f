"""Algorithms on a scene of the paper, many runs each, and the planner beside them: one campaign, one table."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from missionplanner.experiments import campaign
from missionplanner.experiments.contenders import find_contender
from missionplanner.experiments.document import gathered
from missionplanner.experiments.scene_runs import (
    CONTROLS,
    EVALUATIONS,
    ROUNDING_M,
    SOFT_M,
    path_of,
    plan_scene,
    quartiles,
    resolved,
    search_fleet,
)
from missionplanner.experiments.statistics import friedman, paired
from missionplanner.files import write_csv
from missionplanner.geodesy import FloatArray
from missionplanner.mission import load_mission

Progress = Callable[[str, float], None]

RUNS = 51
"""The paper's, per algorithm."""

QUICK_RUNS = 2
PLANNER = "planner"
BEST, PAPER_FORM = "pso-abc-sa", "pso-abc-sa-paper"
TITLES = {
    "pso": "PSO",
    "ga": "GA",
    "gwo": "GWO",
    "ssa": "SSA (sparrow)",
    "pso-sa": "PSO-SA",
    "abc-sa": "ABC-SA",
    "qpso": "QPSO",
    "avoa": "AVOA",
    PAPER_FORM: "PSO-ABC-SA, paper's form",
    BEST: "PSO-ABC-SA, best form",
    PLANNER: "this planner",
}

_ABOVE = (
    "__init__",
    "assignment",
    "camera",
    "cli",
    "coverage",
    "experiment_commands",
    "experiments",
    "flight_console",
    "import_commands",
    "inspection",
    "inspection_commands",
    "inspection_folder",
    "line_homes",
    "line_map",
    "line_mission",
    "map_tags",
    "plan_folder",
    "replay",
    "report",
    "resuming",
    "summary",
    "terminal",
    "tower_rows",
    "travel",
    "views",
    "warmup",
)
_PLANNER_ONLY = (  # finds paths, neither prices nor judges them; the algorithms compared have digests of their own
    "pacing", "path_search", "planner", "polish", "repair", "roadmap", "schedule", "search", "seeds",
    "taut",
)  # fmt: skip
_JUDGES = ("proof_oracle", "scene_judge", "scene_runs")


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What every algorithm found in every run, on one problem; the planner's runs may be among them."""

    text: str  # the mission
    controls: int
    planar: bool
    results: Mapping[str, list[dict[str, Any]]]  # by algorithm

    @property
    def found(self) -> list[str]:
        """The algorithms that found anything: the planner may have no plan in any run."""
        return [name for name in self.results if len(self.costs(name))]

    @property
    def searched(self) -> list[str]:
        """The algorithms without the planner."""
        return [name for name in self.results if name != PLANNER]

    def costs(self, name: str) -> FloatArray:
        """Return the cost of every run that found a plan (R,)."""
        return np.array([r["cost"] for r in self.results[name] if not r.get("error")])

    def typical(self, name: str) -> dict[str, Any]:
        """Return the run of median cost."""
        found = sorted((r for r in self.results[name] if not r.get("error")), key=lambda r: float(r["cost"]))
        return found[(len(found) - 1) // 2]

    def paths(self, name: str) -> list[FloatArray]:
        """Return the paths of the run of median cost."""
        run = self.typical(name)
        return [path_of(self.text, run, k, planar=self.planar) for k in range(len(run["vehicles"]))]

    def curves(self) -> dict[str, FloatArray]:
        """Return quartiles (3, G) of the curves of convergence."""
        return {name: quartiles([r["history"] for r in self.results[name]]) for name in self.searched}

    def ranks(self) -> dict[str, float]:
        """Return mean ranks of the searched algorithms over the runs, 1 the best."""
        table = np.stack([self.costs(name) for name in self.searched], axis=1)
        return dict(zip(self.searched, friedman(table).ranks.tolist(), strict=True))

    def beaten(self) -> list[str]:
        """Say how the best form compares with each rival, run by run."""
        table = np.stack([self.costs(name) for name in self.searched], axis=1)
        return [
            f"{TITLES[c.other]} {c.better}/{c.equal}/{c.worse} (p {c.p_holm:.1g})"
            for c in paired(table, self.searched, BEST)
        ]

    def summary(self, name: str) -> dict[str, Any]:
        """Return the figures of one algorithm."""
        runs, costs = self.results[name], self.costs(name)
        vehicles = [v for run in runs for v in run.get("vehicles", [])]
        each = len(self.results[self.searched[0]][0]["vehicles"])
        count = each * len(runs)  # a run without a plan has no clear path
        lengths = [run["length_m"] / each for run in runs if not run.get("error")]
        return {
            "algorithm": name,
            "runs": len(runs),
            "failed": len(runs) - len(costs),
            "cost_best": float(costs.min()) if len(costs) else None,
            "cost_worst": float(costs.max()) if len(costs) else None,
            "cost_mean": float(costs.mean()) if len(costs) else None,
            "cost_median": float(np.median(costs)) if len(costs) else None,
            "length_best_m": min(lengths, default=None),
            "length_mean_m": statistics.fmean(lengths) if lengths else None,
            "cpu_s": statistics.median(run["cpu_s"] for run in runs),
            "evaluations": max(run.get("evaluations", 0) for run in runs),
            "paths": count,
            **{verdict: sum(bool(v[verdict]) for v in vehicles) for verdict in ("avoids", "safe", "flyable")},
            "all": sum(v["avoids"] and v["safe"] and v["flyable"] for v in vehicles),
        }

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {"controls": self.controls, "algorithms": [self.summary(name) for name in self.results]}

    def write_runs(self, path: Path) -> None:
        """Write a row per run and vehicle."""
        fields = ("name", "cost", "length_m", "height_m", "obstacle_m", "apart_m", "climb_deg")
        verdicts = ("avoids", "safe", "flyable")
        rows = [
            [name, seed, *(v[f] for f in (*fields, *verdicts)), run["cpu_s"]]
            for name, runs in self.results.items()
            for seed, run in enumerate(runs)
            for v in run.get("vehicles", [])
        ]
        write_csv(path, ["algorithm", "run", "vehicle", *fields[1:], *verdicts, "run_cpu_s"], rows)


@dataclass(frozen=True, slots=True)
class Problem:
    """A mission's text, and how it is searched."""

    name: str
    text: str
    algorithms: tuple[str, ...]
    controls: int = CONTROLS
    planar: bool = False
    planner: bool = True


def compare(
    folder: Path,
    experiment: str,
    problems: Sequence[Problem],
    runs: int,
    *,
    workers: int | None,
    cluster: str | None,
    progress: Progress | None,
) -> list[Comparison]:
    """Run every algorithm on every problem with seeds 0, 1, ...; only what the folder does not hold is run."""
    jobs: dict[tuple[int, str, int], campaign.Job] = {}
    planned = campaign.version_of({}, [f"missionplanner.{name}" for name in _PLANNER_ONLY])[:10]
    for k, problem in enumerate(problems):
        resolved(problem.text)  # what is wrong with it is told before any work
        digests = {name: find_contender(name).digest() for name in problem.algorithms}
        for seed in range(runs):
            for name in problem.algorithms:
                arguments = {
                    "text": problem.text,
                    "algorithm": name,
                    "seed": seed,
                    "controls": problem.controls,
                    "planar": problem.planar,
                }
                key = f"{problem.name}/{problem.controls}/{name}@{digests[name]}/{seed}"
                jobs[k, name, seed] = campaign.Job(key, search_fleet, arguments)
            if problem.planner:
                key = f"{problem.name}/{PLANNER}@{planned}/{seed}"
                jobs[k, PLANNER, seed] = campaign.Job(key, plan_scene, {"text": problem.text, "seed": seed})
    version = campaign.version_of({"texts": [p.text for p in problems], "evaluations": EVALUATIONS}, core_modules())
    found = campaign.run(
        list(jobs.values()),
        folder,
        experiment=experiment,
        version=version,
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    return [
        Comparison(
            problem.text,
            problem.controls,
            problem.planar,
            {
                name: [found[jobs[k, name, seed].key] for seed in range(runs)]
                for name in (*problem.algorithms, *((PLANNER,) if problem.planner else ()))
            },
        )
        for k, problem in enumerate(problems)
    ]


def mission_text(path: Path) -> str:
    """Return the text of a mission file, once it has been read as one.

    Raises
    ------
    MissionError
        It cannot be.
    """
    load_mission(path)
    return path.read_text(encoding="utf-8")


def core_modules() -> list[str]:
    """Return what every run depends on: all of the package but what stands above the planner, or finds its paths."""
    root = Path(__file__).parents[1]
    names = {path.stem for path in root.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()}
    judges = [f"missionplanner.experiments.{name}" for name in _JUDGES]
    return [*(f"missionplanner.{name}" for name in sorted(names.difference(_ABOVE, _PLANNER_ONLY))), *judges]


def planning_modules() -> list[str]:
    """Return all of the package that a plan depends on."""
    return sorted(
        m for m in (*core_modules(), *(f"missionplanner.{n}" for n in _PLANNER_ONLY)) if ".experiments." not in m
    )


def made(comparisons: Sequence[Comparison]) -> str:
    """Return on what and when the runs were made, resumed ones too."""
    told, comparable = gathered(run for c in comparisons for runs in c.results.values() for run in runs)
    return told if comparable else f"{told} Times mix these machines: they do not compare."


def table(comparison: Comparison, paper: Mapping[str, Sequence[str]] | None = None) -> list[str]:
    """Return one row per algorithm as Markdown; ``paper`` has its costs, time, length and rate by algorithm."""
    ranks = comparison.ranks()
    head = "| | best cost | worst | mean | mean rank | time, s | least length, m | avoids | safe | flyable |"
    rows = [head + (" paper: best / worst / mean | time | length | avoids |" if paper else "")]
    rows.append("|---" * (rows[0].count("|") - 1) + "|")
    for name in comparison.results:
        s = comparison.summary(name)
        if s["failed"] == s["runs"]:
            rows.append(f"| {TITLES[name]} | found no plan: 0 of {s['runs']} runs" + " |" * (rows[0].count("|") - 2))
            continue
        rank = f"{ranks[name]:.2f}" if name in ranks else "-"
        row = (
            f"| {TITLES[name]} | {s['cost_best']:.3f} | {s['cost_worst']:.3f} | {s['cost_mean']:.3f} | {rank} | "
            f"{s['cpu_s']:.2f} | {s['length_best_m']:,.1f} | "
            + " | ".join(_rate(s[v], s["paths"]) for v in ("avoids", "safe", "flyable"))
            + " |"
        )
        if paper:
            best, worst, mean, time, length, rate = paper.get(name, ("",) * 6)
            row += f" {best} / {worst} / {mean} | {time} | {length} | {rate} |" if best else " | | | |"
        rows.append(row)
    return rows


def forgiven() -> str:
    """Return what *safe* forgives, to whom."""
    return (
        f"*Safe* forgives {SOFT_M:g} m to what was searched, whose price has soft limits, and {ROUNDING_M:g} m to what "
        "was proven, for what the judge's ground differs."
    )


def _rate(count: int, paths: int) -> str:
    return f"{100.0 * count / paths:.1f} %" if count < paths else "100 %"
