"""A fleet that is to arrive together, flown many times in simulation; ``missionplanner experiment arrival``.

Each seed's plan is flown as planned and disturbed: in wind that it does not know of, with a late start, with a pause;
and a plan that knows the wind is flown in it. Every vehicle speaks MAVLink: missions are uploaded, positions and
arrivals are those of its telemetry.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missionplanner.errors import MissionError, MissionPlannerError
from missionplanner.experiments import campaign
from missionplanner.experiments.campaign import Job
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv
from missionplanner.mission import Mission, Wind, load_mission
from missionplanner.plan import Clearance, FleetPlan
from missionplanner.planner import plan_fleet
from missionplanner.scene import Scene, build_scene
from sim.rehearsal import Pause, Rehearsal, rehearse

Progress = Callable[[str, float], None]
Weather = Literal["calm", "known"]
"""What a plan is made for: calm air, or the wind that will blow."""

SEEDS = 20
WIND_M_S, LATE_S, PAUSE_S = 5.0, 10.0, 20.0

_QUICK_SEEDS = 1
_GOLDEN_DEG = 137.508  # from seed to seed: then any number of directions is spread evenly
_PAUSED_FROM, _PAUSED_STEP, _PAUSED_STEPS = 0.3, 0.1, 4  # when, as a share of the time to arrival
_PACKAGES = ("missionplanner", "adapters", "sim")
_WEATHERS: tuple[Weather, ...] = ("calm", "known")


@dataclass(frozen=True, slots=True)
class Condition:
    """How a plan is flown, and the arrival spread that is wanted."""

    name: str
    words: str
    planned: Weather
    spread_max_s: float
    correct: bool = False  # by speeds, and by stopping copters for a while (fleet.correction: speed_and_hold)


CONDITIONS = (
    Condition("calm", "as planned", "calm", 0.5),
    Condition("wind_known", f"{WIND_M_S:g} m/s wind, planned for", "known", 1.0),
    Condition("wind_unknown", f"{WIND_M_S:g} m/s wind, unknown, corrected", "calm", 3.0, correct=True),
    Condition("late", f"one starts {LATE_S:g} s late, corrected", "calm", 3.0, correct=True),
    Condition("paused", f"one pauses for {PAUSE_S:g} s, corrected", "calm", 3.0, correct=True),
)


@dataclass(frozen=True, slots=True)
class Run:
    """One plan flown under one condition; with an ``error`` nothing else is known."""

    condition: str
    seed: int
    disturbed: str = ""  # from where the wind blew, or who was late or paused
    error: str = ""
    spread_s: float | None = None
    late_s: float | None = None  # the last arrival less the planned one
    separation_m: float | None = None  # None: a single vehicle
    separation_required_m: float = 0.0
    margin_m: float | None = None  # worst clearance to ground, obstacles, ceiling and fence, beyond the required one
    margin_to: str = ""
    corrections: int = 0
    refused: int = 0
    planning_s: float = 0.0
    flying_s: float = 0.0

    def problems(self, wanted: Condition) -> Iterator[str]:
        """Say what was not kept."""
        if self.error:
            yield self.error
            return
        if self.spread_s is None:
            yield "somebody did not arrive"
        elif self.spread_s > wanted.spread_max_s:
            yield f"arrival spread {self.spread_s:.2f} s, wanted {wanted.spread_max_s:g} s"
        if self.separation_m is not None and self.separation_m < self.separation_required_m - 1e-6:
            yield f"separation {self.separation_m:.1f} m, asked {self.separation_required_m:g} m"
        if self.margin_m is None:
            yield "nobody took off"
        elif self.margin_m < -1e-6:
            yield f"{-self.margin_m:.1f} m too close to {self.margin_to}"


@dataclass(frozen=True, slots=True)
class Results:
    """All runs, by condition and seed."""

    mission: str
    runs: tuple[Run, ...]

    def of(self, condition: Condition) -> list[Run]:
        """Return the runs under a condition."""
        return [run for run in self.runs if run.condition == condition.name]

    def problems(self) -> list[str]:
        """Return what was not kept, run by run."""
        return [
            f"{c.name}, seed {run.seed}{f' ({run.disturbed})' if run.disturbed else ''}: {problem}"
            for c in CONDITIONS
            for run in self.of(c)
            for problem in run.problems(c)
        ]

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "mission": self.mission,
            "kept": not self.problems(),
            "conditions": [_summary(condition, self.of(condition)) for condition in CONDITIONS],
            "problems": self.problems(),
            "runs": [asdict(run) for run in self.runs],
        }


def main(
    output: Path,
    *,
    mission: Path,
    seed: int,
    seeds: int,
    quick: bool,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress,
) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    wanted = range(seed, seed + (_QUICK_SEEDS if quick else seeds))
    return run(output, mission, wanted, progress=progress, workers=workers, cluster=cluster).as_json()


def run(
    folder: Path,
    mission: Path,
    seeds: Sequence[int],
    *,
    progress: Progress | None = None,
    workers: int | None = None,
    cluster: str | None = None,
) -> Results:
    """Plan and fly a mission with many seeds, as a :mod:`.campaign`; write tables and figures to a folder.

    Raises
    ------
    MissionError
        The mission's fleet does not arrive together; what the campaign refuses.
    """
    ensure_writable(folder)
    loaded = load_mission(mission)
    if not loaded.fleet.arrive_together or len(loaded.vehicles) < 2:
        raise MissionError(f"{mission}: fleet.arrive_together: expected a fleet that arrives together")
    for weather in _WEATHERS:
        _scene(loaded, mission.parent, weather, 0)  # what is wrong with it is told before any work
    jobs = [
        Job(f"{weather}/{seed}", fly_job, {"mission": str(mission.resolve()), "weather": weather, "seed": seed})
        for seed in seeds
        for weather in _WEATHERS
    ]
    found = campaign.run(
        jobs,
        folder,
        experiment="arrival",
        version=campaign.version_of({"mission": mission.read_text(encoding="utf-8")}, _PACKAGES),
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    runs = [Run(**run) for job in jobs for run in found[job.key]["runs"]]
    order = [condition.name for condition in CONDITIONS]
    runs.sort(key=lambda r: order.index(r.condition))  # seeds stay in the order that was asked for
    results = Results(loaded.name, tuple(runs))
    _write(folder, results)
    return results


def fly_job(mission: str, weather: Weather, seed: int) -> dict[str, Any]:
    """Return what came of one plan of a seed, as plain values."""
    return {"runs": [asdict(run) for run in fly_seed(Path(mission), weather, seed)]}


# --- one seed --------------------------------------------------------------------------------------------------------


def wind_of(seed: int) -> Wind:
    """Return the wind of a seed: always as strong, from ever other directions."""
    return Wind(speed_m_s=WIND_M_S, from_deg=round(seed * _GOLDEN_DEG % 360.0, 1))


def fly_seed(mission: Path, weather: Weather, seed: int) -> list[Run]:
    """Plan a mission with a seed, for calm air or for its wind, and fly it under all conditions of that kind."""
    conditions = [c for c in CONDITIONS if c.planned == weather]
    scene = _scene(load_mission(mission), mission.parent, weather, seed)
    begin_s = time.perf_counter()
    try:
        plan = plan_fleet(scene, seed=seed)
    except MissionPlannerError as error:
        return [Run(c.name, seed, error=f"not planned: {error}") for c in conditions]
    planning_s = time.perf_counter() - begin_s
    return [_flown(scene, plan, condition, seed, planning_s) for condition in conditions]


def _scene(mission: Mission, folder: Path, weather: Weather, seed: int) -> Scene:
    wind = wind_of(seed) if weather == "known" else None
    return build_scene(mission.model_copy(update={"wind": wind}), folder)


def _flown(scene: Scene, plan: FleetPlan, condition: Condition, seed: int, planning_s: float) -> Run:
    """Fly a plan under a condition; who is disturbed, when, and from where the wind blows depends on the seed."""
    names = [vehicle.name for vehicle in plan.vehicles]
    wind_m_s: tuple[float, float] | None = None
    late_s: Mapping[str, float] = {}
    pauses: list[Pause] = []
    disturbed = ""
    match condition.name:
        case "wind_known":
            disturbed = f"from {wind_of(seed).from_deg:.0f} degrees"
        case "wind_unknown":
            wind_m_s = wind_of(seed).velocity_m_s
            disturbed = f"from {wind_of(seed).from_deg:.0f} degrees"
        case "late":
            disturbed = names[seed % len(names)]
            late_s = {disturbed: LATE_S}
        case "paused":
            disturbed = names[(seed + 1) % len(names)]
            share = _PAUSED_FROM + _PAUSED_STEP * (seed % _PAUSED_STEPS)
            pauses = [Pause(disturbed, round(share * (plan.arrival_s or 0.0), 1), PAUSE_S)]
    begin_s = time.perf_counter()
    try:
        flown = rehearse(
            scene,
            plan,
            correct=condition.correct,
            hold=condition.correct,
            wind_m_s=wind_m_s,
            late_s=late_s,
            pauses=pauses,
        )
    except MissionPlannerError as error:
        return Run(condition.name, seed, disturbed, f"not flown: {error}", planning_s=planning_s)
    return _told(flown, scene, plan, condition, seed, disturbed, planning_s, time.perf_counter() - begin_s)


def _told(
    flown: Rehearsal,
    scene: Scene,
    plan: FleetPlan,
    condition: Condition,
    seed: int,
    disturbed: str,
    planning_s: float,
    flying_s: float,
) -> Run:
    flight, check = flown.flight, flown.check
    every: list[Clearance] = [clearance for vehicle in check.clearances for clearance in vehicle]
    worst = min(every, key=lambda c: c.distance_m - c.required_m, default=None)
    arrivals = [v.arrival_s - v.due_after_s for v in flight.vehicles if v.arrival_s is not None]
    planned_s = plan.arrival_s or 0.0
    return Run(
        condition.name,
        seed,
        disturbed,
        spread_s=None if flight.arrival_spread_s is None else round(flight.arrival_spread_s, 3),
        late_s=round(max(arrivals) - planned_s, 3) if arrivals else None,
        separation_m=None if check.separation is None else round(check.separation.distance_m, 3),
        separation_required_m=scene.mission.fleet.separation_m,
        margin_m=None if worst is None else round(worst.distance_m - worst.required_m, 3),
        margin_to="" if worst is None else worst.what,
        corrections=len(flight.corrections),
        refused=sum(not correction.obeyed for correction in flight.corrections),
        planning_s=round(planning_s, 1),
        flying_s=round(flying_s, 1),
    )


# --- what is written -------------------------------------------------------------------------------------------------


def _summary(condition: Condition, runs: Sequence[Run]) -> dict[str, Any]:
    flown = [run for run in runs if not run.error]
    spreads = [run.spread_s for run in flown if run.spread_s is not None]
    apart = [run.separation_m for run in flown if run.separation_m is not None]
    return {
        "condition": condition.name,
        "words": condition.words,
        "seeds": len(runs),
        "flown": len(flown),
        "kept": sum(not any(True for _ in run.problems(condition)) for run in runs),
        "spread_wanted_s": condition.spread_max_s,
        "spread_kept": sum(s <= condition.spread_max_s for s in spreads),
        "spread_median_s": statistics.median(spreads) if spreads else None,
        "spread_worst_s": max(spreads, default=None),
        "late_worst_s": max((run.late_s for run in flown if run.late_s is not None), default=None),
        "separation_least_m": min(apart, default=None),
        "separation_asked_m": max((run.separation_required_m for run in flown), default=None),
        "margin_worst_m": min((run.margin_m for run in flown if run.margin_m is not None), default=None),
        "corrections_median": statistics.median([run.corrections for run in flown]) if flown else None,
        "corrections_most": max((run.corrections for run in flown), default=None),
        "corrections_refused": sum(run.refused for run in flown),
        "planning_median_s": statistics.median([run.planning_s for run in flown]) if flown else None,
        "flying_median_s": statistics.median([run.flying_s for run in flown]) if flown else None,
    }


def _write(folder: Path, results: Results) -> None:
    fields = list(Run.__dataclass_fields__)
    write_csv(folder / "runs.csv", fields, [[getattr(run, field) for field in fields] for run in results.runs])
    write_atomic(folder / "results.md", table(results))
    with replacing(folder / "spread.png") as draft:
        _drawn(results).savefig(draft, format="png", metadata={"Software": None})


def table(results: Results) -> str:
    """Return the figures as Markdown."""
    lines = [
        f"# Common arrival of {results.mission}, flown in simulation",
        "",
        "| flown | seeds | spread: wanted | median | worst | kept | arrival later by, most | least separation | asked "
        "| worst margin | corrections: median | most |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for condition in CONDITIONS:
        s = _summary(condition, results.of(condition))
        lines.append(
            f"| {s['words']} | {s['flown']} of {s['seeds']} | <= {s['spread_wanted_s']:g} s | "
            f"{_number(s['spread_median_s'], 2, ' s')} | {_number(s['spread_worst_s'], 2, ' s')} | "
            f"{s['spread_kept']} of {s['seeds']} | {_number(s['late_worst_s'], 1, ' s')} | "
            f"{_number(s['separation_least_m'], 1, ' m')} | {_number(s['separation_asked_m'], 0, ' m')} | "
            f"{_number(s['margin_worst_m'], 2, ' m')} | {_number(s['corrections_median'], 0)} | "
            f"{_number(s['corrections_most'], 0)} |"
        )
    timed = [_summary(condition, results.of(condition)) for condition in CONDITIONS]
    took = ", ".join(
        f"{s['condition']} {s['flying_median_s']:.1f} s" for s in timed if s["flying_median_s"] is not None
    )
    planned = [run.planning_s for run in results.runs if not run.error]
    if planned:
        lines += ["", f"Planning took {statistics.median(planned):.1f} s (median), flying: {took}."]
    problems = results.problems()
    lines += ["", "Not kept:", "", *(f"- {problem}" for problem in problems)] if problems else ["", "All was kept."]
    return "\n".join(lines) + "\n"


def _number(value: float | None, digits: int, unit: str = "") -> str:
    return "-" if value is None else f"{value:.{digits}f}{unit}"


def _drawn(results: Results) -> Figure:
    """Draw every run's spread, condition by condition, with what is wanted."""
    figure = Figure(figsize=(7.0, 3.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for row, condition in enumerate(CONDITIONS):
        spreads = [run.spread_s for run in results.of(condition) if run.spread_s is not None]
        good = [s for s in spreads if s <= condition.spread_max_s]
        bad = [s for s in spreads if s > condition.spread_max_s]
        axes.plot(good, [row] * len(good), "|", color="#0072b2", markersize=12)
        axes.plot(bad, [row] * len(bad), "|", color="#d55e00", markersize=12)
        axes.plot([condition.spread_max_s] * 2, [row - 0.4, row + 0.4], color="#66727d", linewidth=1.0)
    axes.set_yticks(range(len(CONDITIONS)), [condition.words for condition in CONDITIONS], fontsize=8)
    axes.set_ylim(len(CONDITIONS) - 0.5, -0.5)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.set_xlim(left=0.0)
    axes.set_xlabel("arrival spread, s (grey: wanted)", fontsize=8)
    axes.tick_params(labelsize=8, length=2)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return figure
