"""The shortest path where all constraints are hard, beside OMPL's planners; ``missionplanner experiment lengths``.

Among a mission's cylinders with several margins, and over the ground and among the threats of the UAV objective's
instances. Ours is :func:`missionplanner.seeds.first_guesses`: it has no random numbers, so one path per scene. OMPL's
planners get the same space, the same ends and the same kernels as judge of every motion, one process and one core
each, and budgets of CPU time, so that what else the machine does changes nothing. What of theirs is Python is the call
of the judge for each motion; results.md says how long that takes, and how long the judge itself.
"""

from __future__ import annotations

import hashlib
import importlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from missionplanner import kernels
from missionplanner.clearance import Margins, legs_clear, polyline_legs
from missionplanner.errors import MissionError
from missionplanner.experiments import campaign
from missionplanner.experiments.document import gathered, provenance
from missionplanner.experiments.mountain import shortest_m
from missionplanner.experiments.scene_comparison import planning_modules
from missionplanner.experiments.uav_scene import THREAT_MARGIN_M, UavScene, free_flight, load_scene
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv
from missionplanner.geodesy import FloatArray
from missionplanner.mission import load_mission
from missionplanner.planner import plan_fleet
from missionplanner.scene import build_scene
from missionplanner.seeds import first_guesses

PLANNERS = ("InformedRRTstar", "BITstar", "ABITstar", "AITstar")
TITLES = {"InformedRRTstar": "Informed RRT*", "BITstar": "BIT*", "ABITstar": "ABIT*", "AITstar": "AIT*"}
OURS, THOROUGH = "ours", "ours, thorough"
MARGINS_M = (0.0, 5.0, 10.0, 20.0)
BUDGETS_S = (0.1, 1.0, 10.0)
SEEDS, REPEATS = 3, 51
_DRAWN_M = 10.0

_EXPERIMENTS = ("lengths", "uav_objective", "uav_scene")
"""What results depend on, besides all that plans."""
_PAUSES_S = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
_CLIMB_MARGINS_M = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Kept above the kernels' ground until a path is also clear of the bilinear one."""
_ROOM_M = 50.0  # above and below all that may matter: where OMPL samples
_BLUE, _RED, _INK, _MUTED = "#0072b2", "#d55e00", "#1d2730", "#66727d"
_COLOURS = ("#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#aa3377", "#332288", "#66727d")


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One problem: a space with its ends, and who judges legs (N, 2, 3) at samples so far apart."""

    name: str
    scene: UavScene
    clear: Callable[[FloatArray, float], npt.NDArray[np.bool_]]
    bound_m: float | None = None  # no path is shorter

    def judged(self, path: FloatArray) -> bool:
        """Return whether a path (K, 3) is clear: exactly of solids, by samples 0.25 m apart of the ground."""
        return bool(self.clear(polyline_legs(path), 0.25).all())


def main(
    output: Path,
    *,
    mission: Path,
    instances: Path | None = None,
    margins_m: Sequence[float] = MARGINS_M,
    budgets_s: Sequence[float] = BUDGETS_S,
    seeds: int = SEEDS,
    quick: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: campaign.Progress | None = None,
) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    if quick:
        margins_m, budgets_s, seeds = (0.0, 10.0), (0.1, 0.5), min(seeds, 2)
    ensure_writable(output)
    asked: list[dict[str, Any]] = [{"mission": str(mission), "margin_m": margin_m} for margin_m in margins_m]
    asked += [{"instance": str(path)} for path in _files(instances)]
    planners = _available()
    jobs = [
        campaign.Job(f"{_case(**which).name}: ours", _ours, {"which": which, "repeats": 5 if quick else REPEATS})
        for which in asked
    ]
    jobs += [
        campaign.Job(
            f"{_case(**which).name}: {planner}, {seed}",
            _sampled,
            {"which": which, "planner": planner, "seed": seed, "budgets_s": list(budgets_s)},
        )
        for which in asked
        for planner in planners
        for seed in range(1, seeds + 1)
    ]
    jobs.append(campaign.Job("flight", _flight, {"mission": str(mission)}))
    modules = [*planning_modules(), *(f"missionplanner.experiments.{name}" for name in _EXPERIMENTS)]
    settings = {
        "contents": _contents(mission, instances),
        "cases": asked,
        "budgets_s": list(budgets_s),
        "planners": list(planners),
        "quick": quick,
    }
    runs = campaign.run(
        jobs,
        output,
        experiment="lengths",
        version=campaign.version_of(settings, modules),
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    found = _gather(asked, planners, seeds, budgets_s, runs)
    _write_tables(output, found, planners, budgets_s, seeds, gathered(runs.values()), quick=quick)
    for which in asked:
        case = _case(**which)
        if "instance" in which or which["margin_m"] == _DRAWN_M:
            _draw_map(output, case, runs, planners, seeds)
    _draw_growth(output, found, runs, planners, seeds, budgets_s)
    return found


def _files(instances: Path | None) -> list[Path]:
    if instances is None:
        return []
    files = sorted(instances.glob("*.npz"))
    if not files:
        raise MissionError(f"--instances: expected a folder with instances (.npz files), got none in {instances}")
    return files


def _contents(mission: Path, instances: Path | None) -> dict[str, str]:
    """Return digests of all files that results depend on, by path."""
    loaded = load_mission(mission)
    named = [v.parameter_file for v in loaded.vehicles] + [getattr(loaded.terrain, "file", None)]
    paths = [mission, *(mission.parent / name for name in named if name is not None), *_files(instances)]
    try:
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
    except OSError as error:
        raise MissionError(f"{error.filename}: expected a file that can be read, got: {error.strerror}") from error


def _available() -> tuple[str, ...]:
    """Return which of OMPL's planners are here; none where OMPL is not."""
    if find_spec("ompl") is None:
        return ()
    geometric = importlib.import_module("ompl.geometric")
    return tuple(name for name in PLANNERS if hasattr(geometric, name))


def _case(mission: str = "", margin_m: float = 0.0, instance: str = "") -> Case:
    """Return a problem from what JSON can say of it."""
    if instance:
        scene = load_scene(Path(instance), threat_margin_m=THREAT_MARGIN_M)
        return Case(Path(instance).stem, scene, scene.clear, _bound_m(scene))
    path = Path(mission)
    whole = build_scene(load_mission(path), path.parent)
    task = whole.tasks[0]
    limits = free_flight(margin_m, 0.0, math.inf)
    scene = UavScene(whole.space, limits, task.route_m[0], task.route_m[-1], np.empty((0, 0)))

    def clear(legs: FloatArray, step_m: float) -> npt.NDArray[np.bool_]:
        return legs_clear(scene.space, Margins.of(limits), legs, step_m)

    return Case(f"{whole.mission.name}, {margin_m:g} m", scene, clear, _bound_m(scene))


def _bound_m(scene: UavScene) -> float | None:
    """Return the shortest way around the cylinders without top, climbing evenly; the optimum if only they are there."""
    o = scene.space.obstacles
    upright = (o.kind == kernels.CYLINDER) & o.hard & np.isinf(o.params[:, 3])
    discs = o.params[upright, :3]
    level_m = shortest_m(
        scene.start_m[:2], scene.goal_m[:2], discs[:, :2], discs[:, 2] + scene.limits.obstacle_margin_m
    )
    return math.hypot(level_m, scene.goal_m[2] - scene.start_m[2]) if math.isfinite(level_m) else None


# --- ours ------------------------------------------------------------------------------------------------------------


def shortest(case: Case, *, thorough: bool) -> FloatArray:
    """Return our shortest path (K, 3) of a problem, clear by its judge.

    Raises
    ------
    InfeasibleError
        No clear path was found.
    """
    scene = case.scene
    path = np.empty((0, 3))
    for more_m in _CLIMB_MARGINS_M:
        limits = replace(scene.limits, terrain_margin_m=scene.limits.terrain_margin_m + more_m)
        [path] = first_guesses(scene.space, limits, scene.start_m, scene.goal_m, thorough=thorough)
        if case.judged(path):
            break
    return path


def _ours(which: dict[str, Any], repeats: int) -> dict[str, Any]:
    case = _case(**which)
    result: dict[str, Any] = provenance()
    for name, thorough in ((OURS, False), (THOROUGH, True)):
        path = shortest(case, thorough=thorough)  # compiles, or loads what was compiled
        spent_s, lengths_m = [], []
        for _ in range(repeats):
            began = time.thread_time()
            again = shortest(case, thorough=thorough)
            spent_s.append(time.thread_time() - began)
            lengths_m.append(_length_m(again))
        result[name] = {
            "length_m": lengths_m[0],
            "lengths_differ": len(set(lengths_m)) > 1,
            "runs": repeats,
            "cpu_s": median(spent_s),
            "cpu_worst_s": max(spent_s),
            "clear": case.judged(path),
            "path_m": path.tolist(),
        }
    return result


def _length_m(path: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _flight(mission: str) -> dict[str, Any]:
    """Plan the mission's first vehicle alone, and draw its taut string with the same margins and limits."""
    path = Path(mission)
    loaded = load_mission(path)
    scene = build_scene(loaded.model_copy(update={"vehicles": loaded.vehicles[:1]}), path.parent)
    task = scene.tasks[0]
    legs = list(pairwise(task.route_m))
    strings = [first_guesses(scene.space, task.limits, a, b, thorough=True)[0] for a, b in legs]
    free = replace(
        task.limits, climb_angle_rad=0.5 * math.pi, descent_angle_rad=0.5 * math.pi, position_error_m=0.0,
        tracking_error_m=0.0, deviation_m=0.0,
    )  # fmt: skip
    bare = [first_guesses(scene.space, free, a, b, thorough=True)[0] for a, b in legs]
    plan = plan_fleet(scene, seed=1)
    vehicle = plan.vehicles[0]
    return {
        **provenance(),
        "vehicle": vehicle.name,
        "string_m": sum(_length_m(string) for string in strings),
        "bare_string_m": sum(_length_m(string) for string in bare),
        "curve_m": _length_m(vehicle.path_m),
        "waypoints_m": _length_m(vehicle.waypoints_m),
        "margin_m": task.limits.obstacle_margin_m,
        "tube_m": task.limits.tube_m,
        "climb_deg": math.degrees(task.limits.climb_angle_rad),
    }


# --- OMPL ------------------------------------------------------------------------------------------------------------


def _sampled(which: dict[str, Any], planner: str, seed: int, budgets_s: list[float]) -> dict[str, Any]:
    """Run one of OMPL's planners once; return its length when each budget of CPU time was spent."""
    case = _case(**which)
    scene = case.scene
    base, geometric, util = (importlib.import_module(f"ompl.{name}") for name in ("base", "geometric", "util"))
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed)
    space = base.RealVectorStateSpace(3)
    bounds = base.RealVectorBounds(3)
    for axis, (low, high) in enumerate(_bounds(scene)):
        bounds.setLow(axis, low)
        bounds.setHigh(axis, high)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    legs = np.empty((1, 2, 3))
    judge = case.clear
    asked, judging_s = 0, 0.0

    class Validity(base.StateValidityChecker):  # type: ignore[misc, name-defined]
        def isValid(self, state: Any) -> bool:  # noqa: N802
            for k in range(3):
                legs[0, 0, k] = legs[0, 1, k] = state[k]
            return bool(judge(legs, 1.0)[0])

    class Motions(base.MotionValidator):  # type: ignore[misc, name-defined]
        def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802
            nonlocal asked, judging_s
            for k in range(3):
                legs[0, 0, k] = a[k]
                legs[0, 1, k] = b[k]
            began = time.thread_time()
            clear = bool(judge(legs, 1.0)[0])
            judging_s += time.thread_time() - began
            asked += 1
            return clear

    information.setStateValidityChecker(Validity(information))
    information.setMotionValidator(Motions(information))
    information.setup()
    problem = base.ProblemDefinition(information)
    ends = space.allocState(), space.allocState()
    for k in range(3):
        ends[0][k], ends[1][k] = float(scene.start_m[k]), float(scene.goal_m[k])
    problem.setStartAndGoalStates(ends[0], ends[1], 1e-9)
    problem.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
    search = getattr(geometric, planner)(information)
    search.setProblemDefinition(problem)
    search.setup()
    judge(np.array([[scene.start_m, scene.goal_m]]), 1.0)
    asked, judging_s = 0, 0.0
    history: list[tuple[float, float]] = []  # this interface tells lengths only when a search pauses
    began = time.thread_time()
    for pause_s in sorted({*budgets_s, *(s for s in _PAUSES_S if s < budgets_s[-1])}):
        search.solve(base.PlannerTerminationCondition(_spent(began + pause_s)))
        if problem.hasExactSolution():
            history.append((pause_s, float(problem.getSolutionPath().length())))
    spent_s = time.thread_time() - began
    result: dict[str, Any] = {
        **provenance(),
        "lengths_m": [min((m for s, m in history if s <= budget), default=None) for budget in budgets_s],
        "history": history,
        "motions": asked,
        "judging_share": judging_s / max(spent_s, 1e-9),
    }
    solution = problem.getSolutionPath() if problem.hasExactSolution() else None
    if solution is not None:
        result["clear"] = case.judged(_points(solution))
        geometric.PathSimplifier(information).simplifyMax(solution)
        result["simplified_m"] = float(solution.length())
        result["path_m"] = _points(solution).tolist()
    return result


def _spent(until_s: float) -> Callable[[], bool]:
    return lambda: time.thread_time() >= until_s


def _points(path: Any) -> FloatArray:
    return np.array([[path.getState(n)[k] for k in range(3)] for n in range(path.getStateCount())])


def _bounds(scene: UavScene) -> list[tuple[float, float]]:
    """Return where sampling can help: the area, and altitudes from the ends' to what is highest, with some room."""
    west, south, east, north = scene.space.area
    ends_m = (float(scene.start_m[2]), float(scene.goal_m[2]))
    x, y = np.meshgrid(np.linspace(west, east, 200)[1:-1], np.linspace(south, north, 200)[1:-1])
    ground = kernels.terrain_heights(scene.space.terrain, np.column_stack([x.ravel(), y.ravel()]))
    top_m = max(*ends_m, float(np.nanmax(ground)) + scene.limits.terrain_margin_m)
    return [(west, east), (south, north), (min(ends_m) - _ROOM_M, top_m + _ROOM_M)]


# --- results ---------------------------------------------------------------------------------------------------------


def _gather(
    asked: Sequence[dict[str, Any]],
    planners: Sequence[str],
    seeds: int,
    budgets_s: Sequence[float],
    runs: dict[str, dict[str, Any]],
) -> dict[str, Any]:
    cases: dict[str, Any] = {}
    for which in asked:
        case = _case(**which)
        run = runs[f"{case.name}: ours"]
        ours = {name: {k: v for k, v in run[name].items() if k != "path_m"} for name in (OURS, THOROUGH)}
        cases[case.name] = {
            "straight_m": float(np.linalg.norm(case.scene.goal_m - case.scene.start_m)),
            "bound_m": case.bound_m,
            "ours": ours,
            "ompl": {
                planner: _medians([runs[f"{case.name}: {planner}, {seed}"] for seed in range(1, seeds + 1)])
                for planner in planners
            },
        }
    return {"budgets_s": list(budgets_s), "seeds": seeds, "cases": cases, "flight": runs["flight"]}


def _medians(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    def middle(values: Sequence[float | None]) -> float | None:
        value = median(math.inf if v is None else v for v in values)
        return value if math.isfinite(value) else None

    return {
        "lengths_m": [middle(values) for values in zip(*(run["lengths_m"] for run in runs), strict=True)],
        "simplified_m": middle([run.get("simplified_m") for run in runs]),
        "clear": sum(bool(run.get("clear")) for run in runs),
        "motions": median(run["motions"] for run in runs),
        "judging_share": median(run["judging_share"] for run in runs),
    }


def _write_tables(
    output: Path,
    found: dict[str, Any],
    planners: Sequence[str],
    budgets_s: Sequence[float],
    seeds: int,
    made: tuple[str, bool],
    *,
    quick: bool,
) -> None:
    heads = [TITLES[p] for p in planners]
    spans = " / ".join(f"{budget:g}" for budget in budgets_s)
    told, comparable = made
    lines = ["# The shortest path, all constraints hard", "", told, ""]
    if not comparable:
        lines += ["Times and budgets are of different machines: they do not compare.", ""]
    if quick:
        lines += ["Quick: fewer margins, seeds and repeats, shorter budgets; a look, no measurement.", ""]
    lines += [
        "Length in metres. Ours has no random numbers: every run gives the same path, bit for bit. Its times are CPU "
        f"milliseconds, warm, median (worst) of repeated runs. OMPL: medians of {seeds} seeds after {spans} s of CPU "
        "time (simplified at the end), one process and one core each. All are judged by the same kernels: solids "
        "exactly, the ground by samples 0.25 m apart (OMPL while it searches: 1 m), on instances both bicubic and "
        f"bilinear. Cylinders of instances are {THREAT_MARGIN_M:g} m wider, as the objective's penalty is. Bound: the "
        "shortest way around the cylinders without top alone, climbing evenly; nothing is shorter, and it is the "
        "optimum where nothing else is in the way.",
        "",
    ]
    lines += ["| scene | straight | bound | ours | ms | thorough | ms | " + " | ".join(heads) + " |"]
    lines += ["|---" * (7 + len(heads)) + "|"]
    rows: list[list[object]] = []
    for name, case in found["cases"].items():
        cells = [name, f"{case['straight_m']:.2f}", "-" if case["bound_m"] is None else f"{case['bound_m']:.3f}"]
        rows.append([name, "straight line", "", case["straight_m"], "", ""])
        for ours in (OURS, THOROUGH):
            run = case["ours"][ours]
            unclear = "" if run["clear"] else " (not clear)"
            cells += [f"{run['length_m']:.3f}{unclear}", f"{1e3 * run['cpu_s']:.1f} ({1e3 * run['cpu_worst_s']:.0f})"]
            rows.append([name, ours, run["cpu_s"], run["length_m"], "", run["clear"]])
        for planner in planners:
            run = case["ompl"][planner]
            values = " / ".join("-" if m is None else f"{m:.1f}" for m in run["lengths_m"])
            cells.append(f"{values} ({'-' if run['simplified_m'] is None else format(run['simplified_m'], '.1f')})")
            for budget, length in zip(budgets_s, run["lengths_m"], strict=True):
                rows.append([name, planner, budget, length, run["simplified_m"], f"{run['clear']} of {seeds}"])
        lines.append(f"| {' | '.join(cells)} |")
    lines.append("")
    lines += _notes(found, planners, seeds)
    flight = found["flight"]
    lines += [
        "",
        "## What smoothness and flight limits cost",
        "",
        f"{flight['vehicle']} of the mission alone, with its own margin ({flight['margin_m']:g} m from obstacles), the "
        f"tube it may stray in ({flight['tube_m']:.1f} m) and its climb limit ({flight['climb_deg']:.0f} deg):",
        "",
        "| | length, m | over the line above |",
        "|---|---|---|",
        f"| taut string with the margin alone | {flight['bare_string_m']:.2f} | |",
    ]
    steps = (("string_m", "taut string, tube and climb limit added"), ("curve_m", "the planner's smooth curve"))
    before = flight["bare_string_m"]
    for key, text in (*steps, ("waypoints_m", "the straight legs that are flown")):
        lines.append(f"| {text} | {flight[key]:.2f} | {100.0 * (flight[key] / before - 1.0):+.2f} % |")
        before = flight[key]
    lines += ["", "![Length over time](growth.png)", ""]
    lines += [f"![{name}]({_slug(name)}.png)\n" for name in found["cases"] if (output / f"{_slug(name)}.png").exists()]
    write_atomic(output / "results.md", "\n".join(lines))
    write_csv(output / "lengths.csv", ["scene", "planner", "cpu_s", "length_m", "simplified_m", "clear"], rows)


def _notes(found: dict[str, Any], planners: Sequence[str], seeds: int) -> list[str]:
    absent = [TITLES[name] for name in PLANNERS if name not in planners]
    if not planners:
        return ["OMPL is not installed (pip install 'missionplanner[peers]'): nothing of it was measured."]
    runs = [(case, p, case["ompl"][p]) for case in found["cases"].values() for p in planners]
    shares = [run["judging_share"] for _, _, run in runs]
    clear = sum(run["clear"] for _, _, run in runs)
    ahead = sum(
        case["ours"][OURS]["clear"]
        and case["ours"][OURS]["length_m"] <= min(m for m in (run["lengths_m"][-1], run["simplified_m"], math.inf) if m)
        for case, _, run in runs
    )
    lines = [
        f"Ours is clear and no longer than {ahead} of {len(runs)} medians, even after the longest time and simplified. "
        f"Of OMPL's {len(runs) * seeds} final paths {clear} are clear at 0.25 m. Of OMPL's time the judge, its call "
        f"from Python included, took {100.0 * min(shares):.0f} to {100.0 * max(shares):.0f} %."
    ]
    if absent:
        lines.append(f"Not in this build of OMPL, so not measured: {', '.join(absent)}.")
    return lines


def _slug(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name).strip("_")


# --- figures ---------------------------------------------------------------------------------------------------------


def _draw_map(
    output: Path,
    case: Case,
    runs: dict[str, dict[str, Any]],
    planners: Sequence[str],
    seeds: int,
) -> None:
    """Draw ours and one path of each planner from above, and their altitudes."""
    scene = case.scene
    figure = Figure(figsize=(11.0, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    above, side = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    ours = np.array(runs[f"{case.name}: ours"][THOROUGH]["path_m"])
    paths = [(f"ours, {_length_m(ours):.1f} m", ours, _RED, 2.2)]
    for planner, colour in zip(planners, _COLOURS, strict=False):
        done = [runs[f"{case.name}: {planner}, {seed}"] for seed in range(1, seeds + 1)]
        done = [run for run in done if run.get("path_m")]
        if done:
            best = min(done, key=lambda run: float(run["simplified_m"]))
            title = f"{TITLES[planner]}, simplified, {best['simplified_m']:.1f} m"
            paths.append((title, np.array(best["path_m"]), colour, 1.1))
    seen = np.concatenate([path for _, path, _, _ in paths])
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    rim = 0.12 * float((high - low).max())
    low, high = np.maximum(low - rim, scene.space.area[:2]), np.minimum(high + rim, scene.space.area[2:])
    x, y = np.meshgrid(np.linspace(low[0], high[0], 300), np.linspace(low[1], high[1], 300))
    ground = kernels.terrain_heights(scene.space.terrain, np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    shade = above.contourf(x, y, ground, levels=14, cmap="Greys", alpha=0.55)
    figure.colorbar(shade, ax=above, label="ground, m AMSL", shrink=0.8)
    o, margin = scene.space.obstacles, scene.limits.obstacle_margin_m
    for cx, cy, radius in o.bound[o.hard, :3]:
        above.add_patch(Circle((cx, cy), radius, facecolor="#7a4a3a", alpha=0.55, lw=0))
        if margin > 0.0:
            above.add_patch(Circle((cx, cy), radius + margin, fill=False, edgecolor="#7a4a3a", lw=0.7, ls=":"))
    for title, path, colour, width in paths[::-1]:
        above.plot(path[:, 0], path[:, 1], color=colour, lw=width, solid_capstyle="round")
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path[:, :2], axis=0).T))])
        side.plot(along, path[:, 2], color=colour, lw=width, label=title)
    dense = np.concatenate([np.linspace(a, b, 60) for a, b in pairwise(ours)])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(dense[:, :2], axis=0).T))])
    below = kernels.terrain_heights(scene.space.terrain, np.ascontiguousarray(dense[:, :2]))
    side.fill_between(along, below, min(below.min(), seen[:, 2].min()) - 20.0, color=_MUTED, alpha=0.35, lw=0)
    above.plot(*ours[0, :2], "o", color=_INK, ms=5)
    above.plot(*ours[-1, :2], "s", color=_INK, ms=5)
    above.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xlabel="x, m", ylabel="y, m")
    above.set_title(f"{case.name}: from above", loc="left", fontsize=10)
    side.set(xlabel="way over the ground, m", ylabel="altitude, m AMSL")
    side.set_title("altitude; shaded: the ground below ours", loc="left", fontsize=10)
    side.legend(frameon=False, fontsize=8, loc="best")
    for axes in (above, side):
        axes.spines[["top", "right"]].set_visible(False)
    with replacing(output / f"{_slug(case.name)}.png") as draft:
        figure.savefig(draft, dpi=130, format="png")


def _draw_growth(
    output: Path,
    found: dict[str, Any],
    runs: dict[str, dict[str, Any]],
    planners: Sequence[str],
    seeds: int,
    budgets_s: Sequence[float],
) -> None:
    """Draw how far above our length each planner's best is, over time, one panel per scene."""
    cases = found["cases"]
    columns = min(4, len(cases))
    rows = math.ceil(len(cases) / columns)
    figure = Figure(figsize=(3.1 * columns + 0.4, 2.6 * rows + 0.9), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for axes, (name, case) in zip(panels, cases.items(), strict=False):
        best = case["ours"][THOROUGH]["length_m"]
        for planner, colour in zip(planners, _COLOURS, strict=False):
            for seed in range(1, seeds + 1):
                history = runs[f"{name}: {planner}, {seed}"]["history"]
                if history:
                    when, length = np.array([*history, (budgets_s[-1], history[-1][1])]).T
                    least = np.minimum.accumulate(length)
                    label = TITLES[planner] if seed == 1 else None
                    excess = np.maximum(100.0 * (least / best - 1.0), 1e-3)
                    axes.step(when, excess, where="post", color=colour, lw=1.0, alpha=0.8, label=label)
        for key, marker in ((OURS, "o"), (THOROUGH, "D")):
            run = case["ours"][key]
            excess_pc = max(100.0 * (run["length_m"] / best - 1.0), 1e-3)
            axes.plot(run["cpu_s"], excess_pc, marker, color=_RED, ms=6, label=key, zorder=5)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_ylim(7e-4, 60.0)
        axes.set_title(name, loc="left", fontsize=9)
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#d9dfe4", lw=0.5)
    for axes in panels[len(cases) :]:
        axes.set_visible(False)
    figure.supxlabel("CPU time, s (at 0.001 %: no longer than ours, thorough)", fontsize=9)
    figure.supylabel("longer than ours, %", fontsize=9)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(6, len(labels)), frameon=False, fontsize=8)
    with replacing(output / "growth.png") as draft:
        figure.savefig(draft, dpi=130, format="png")
