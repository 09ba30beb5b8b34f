"""Two real power lines inspected by six copters; ``missionplanner experiment inspection``.

The lines and the ground are Bayreuth's; their data are the user's (``--data``), and stay there. The fleet's rounds are
planned, proven, and flown in simulation over MAVLink; what they keep from conductors is taken from the flown tracks.
Beside the assignment stand two ways to share out towers without a solver, with the same costs and batteries.
"""

from __future__ import annotations

import json
import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from adapters.certificates import certify_plan
from missionplanner import coverage, views
from missionplanner.assignment import Assignment, assign, share_out
from missionplanner.certificate import Finding
from missionplanner.errors import MissionError, MissionPlannerError
from missionplanner.experiments import campaign
from missionplanner.experiments.campaign import Job
from missionplanner.experiments.document import gathered, joined, provenance
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.inspection import Round, open_scene, plan_inspection, round_mission
from missionplanner.inspection_folder import load_inspection, save_inspection
from missionplanner.mission import Mission
from missionplanner.plan import Trajectory
from missionplanner.plan_folder import save_certificate, save_plan
from missionplanner.planner import plan_fleet
from missionplanner.scene import Scene, build_check_scene, build_scene
from missionplanner.spans import conductor_distance_m
from missionplanner.terrain_bounds import steepest
from missionplanner.travel import TravelCosts, travel_costs
from sim.rehearsal import rehearse

Progress = Callable[[str, float], None]

TERRAIN, TOWERS, LINES = "bayreuth_srtm3_filled.tif", "bayreuth_power_towers.geojson", "bayreuth_power_lines.geojson"
INSPECTED = (31574335, 83593084)
"""The two lines of 110 kV, by their OpenStreetMap ways."""
VEHICLES, ENDURANCE_S, TOWER_M, OTHER_M, SAFETY_M = 6, 1500.0, 35.0, 12.0, 10.0
PRIORITY_SETS = 20
SIZES = (50, 200, 1000)

_QUICK_TOWERS, _QUICK_VEHICLES, _QUICK_SETS, _QUICK_SIZES, _QUICK_ITERATIONS = 3, 2, 2, (4,), 50
_ORIGIN = (50.0, 11.53)
_SITE_ASIDE_M, _SITE_FREE_M, _SITE_SLOPE_DEG = 100.0, 60.0, 12.0
_SPAN_M, _LINES_APART_M, _LINE_M, _FIELD_SOUTH_WEST_M = 250.0, 1000.0, 15_000.0, (-8000.0, -7500.0)
_TOWERS_PER_VEHICLE = 20
_WHOLE_MAX, _TOURS_MAX = 200, 12  # towers that are planned whole; of more, so many tours of the first round
_DAYS_MAX = 1500
_STEP_S = 0.1
_WAYS = {"split": "equal split", "nearest": "nearest first"}
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_PACKAGES = ("missionplanner", "adapters", "sim")


# --- the questions ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Drawn:
    """Lines in the local frame: of each to inspect its towers (K, 2), and the others."""

    names: tuple[str, ...]
    inspected: tuple[FloatArray, ...]
    others: dict[str, FloatArray]


def bayreuth(data: Path, *, quick: bool = False, **assignment: Any) -> Mission:
    """Return the open mission over Bayreuth's two 110 kV lines; ``quick``: over the first towers of one of them.

    Raises
    ------
    MissionError
        The data are not there.
    """
    for name in (TERRAIN, TOWERS, LINES):
        if not (data / name).is_file():
            raise MissionError(
                f"--data: expected a folder with {name} (elevations, towers and lines of Bayreuth), got {data}: say "
                "where they are"
            )
    frame = LocalFrame(*_ORIGIN)
    ways: dict[int, FloatArray] = {}
    for feature in json.loads((data / LINES).read_text(encoding="utf-8"))["features"]:
        if feature["properties"].get("position") != "underground":
            lon, lat = np.array(feature["geometry"]["coordinates"])[:, :2].T
            ways[feature["properties"]["osm_way"]] = frame.to_local(lat, lon, np.zeros(len(lat)))[:, :2]
    inspected = [ways.pop(way) for way in INSPECTED]
    if quick:
        inspected = [inspected[0][:_QUICK_TOWERS]]
    drawn = _Drawn(tuple("AB"[: len(inspected)]), tuple(inspected), {f"way-{way}": line for way, line in ways.items()})
    return _mission("bayreuth", data, drawn, _QUICK_VEHICLES if quick else VEHICLES, assignment)


def many(data: Path, towers: int, **assignment: Any) -> Mission:
    """Return an open mission of so many towers: straight lines side by side on Bayreuth's ground, no others."""
    each = int(_LINE_M / _SPAN_M) + 1
    lines: list[FloatArray] = []
    left = towers
    while left > 0:
        count = min(each, left)
        north = _FIELD_SOUTH_WEST_M[1] + _SPAN_M * np.arange(count)
        east = np.full(count, _FIELD_SOUTH_WEST_M[0] + _LINES_APART_M * len(lines))
        lines.append(np.stack([east, north], axis=1))
        left -= count
    if len(lines) > 1 and len(lines[-1]) < 2:  # one tower is no line
        lines[-1], lines[-2] = np.concatenate([lines[-1], lines[-1] + [0.0, _SPAN_M]]), lines[-2][:-1]
    names = tuple(f"L{k + 1:02d}" for k in range(len(lines)))
    vehicles = max(2, len(lines), math.ceil(towers / _TOWERS_PER_VEHICLE))
    return _mission(f"lines-{towers}", data, _Drawn(names, tuple(lines), {}), vehicles, assignment)


def _mission(name: str, data: Path, drawn: _Drawn, vehicles: int, assignment: Mapping[str, Any]) -> Mission:
    towers: list[dict[str, Any]] = []
    lines: list[dict[str, Any]] = []
    for letter, line in zip(drawn.names, drawn.inspected, strict=True):
        of_line = [f"{letter}{number:02d}" for number in range(1, len(line) + 1)]
        towers += [
            {"name": tower, "x_m": x, "y_m": y, "height_m": TOWER_M, "assumed": ["height_m"]}
            for tower, (x, y) in zip(of_line, line.round(2).tolist(), strict=True)
        ]
        lines.append({"name": f"line-{letter}", "towers": of_line, "voltage_kv": 110})
    obstacles = [
        {
            "kind": "line",
            "name": way,
            "supports": [{"x_m": x, "y_m": y, "height_agl_m": OTHER_M} for x, y in line.round(2).tolist()],
            "assumed": ["height_agl_m"],
        }
        for way, line in drawn.others.items()
    ]

    def question(sites: Sequence[tuple[float, float]]) -> Mission:
        return Mission.model_validate(
            {
                "name": name,
                "origin": {"lat_deg": _ORIGIN[0], "lon_deg": _ORIGIN[1]},
                "terrain": {"kind": "raster", "file": TERRAIN},
                "obstacles": obstacles,
                "inspection": {
                    "towers": towers,
                    "lines": lines,
                    "safety_distance_m": SAFETY_M,
                    "views": {"kind": "two_sides"},
                    "assignment": dict(assignment),
                },
                "defaults": {"endurance_s": ENDURANCE_S},
                "vehicles": [
                    {"name": f"copter-{k + 1}", "home": {"x_m": round(x, 1), "y_m": round(y, 1)}}
                    for k, (x, y) in enumerate(sites)
                ],
            }
        )

    ground = build_check_scene(question([(float(x), float(y)) for x, y in drawn.inspected[0][:1]]), data, [])
    return question(_sites(ground, drawn, vehicles))


def _sites(ground: Scene, drawn: _Drawn, count: int) -> list[tuple[float, float]]:
    """Return crew sites beside the lines: at the middles of equal parts of each, the longest as short as can be.

    A site is moved along the line to where no line is near and the ground is level.
    """
    tube_m = ground.tasks[0].limits.tube_m
    level = math.tan(math.radians(_SITE_SLOPE_DEG))
    spans = [np.hypot(*np.diff(line, axis=0).T) for line in drawn.inspected]
    parts = [1] * len(spans)
    while sum(parts) < count:
        parts[max(range(len(spans)), key=lambda k: spans[k].sum() / parts[k])] += 1
    wires = shapely.MultiLineString([*drawn.inspected, *drawn.others.values()])
    sites: list[tuple[float, float]] = []
    for line, lengths, many_parts in zip(drawn.inspected, spans, parts, strict=True):
        middles = np.cumsum(lengths) - 0.5 * lengths
        way = np.diff(line, axis=0) / lengths[:, np.newaxis]
        left = _SITE_ASIDE_M * np.stack([-way[:, 1], way[:, 0]], axis=1)
        aside = np.stack([0.5 * (line[:-1] + line[1:]) + side * left for side in (1.0, -1.0)], axis=1)
        free = shapely.distance(wires, shapely.points(aside)) >= _SITE_FREE_M
        for part in range(many_parts):
            off = np.abs(middles - (part + 0.5) / many_parts * lengths.sum())[:, np.newaxis] + [0.0, 1e-3]
            for flat in np.argsort(np.where(free, off, np.inf), axis=None, kind="stable").tolist():
                x, y = aside.reshape(-1, 2)[flat].tolist()
                if (x, y) not in sites and steepest(ground.terrain.arrays, x, y, tube_m) <= level:
                    sites.append((x, y))
                    break
    return sites


# --- the runs --------------------------------------------------------------------------------------------------------


def main(
    output: Path, *, data: Path, seed: int, quick: bool, workers: int | None, progress: Progress
) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values."""
    ensure_writable(output)
    bayreuth(data, quick=quick)  # what is missing is told before any work
    folder, shared = output.resolve(), {"data": str(data.resolve()), "seed": seed, "quick": quick}
    version = campaign.version_of(shared, _PACKAGES)

    def found(jobs: Sequence[Job]) -> dict[str, dict[str, Any]]:
        return campaign.run(jobs, output, experiment="inspection", version=version, workers=workers, progress=progress)

    fleet = Job("fleet", fleet_job, {**shared, "folder": str(folder / "plan")})
    sets = [
        Job(f"priority/{k}", priority_job, {**shared, "number": k})
        for k in range(1, (_QUICK_SETS if quick else PRIORITY_SETS) + 1)
    ]
    sizes = [Job(f"towers/{n}", size_job, {**shared, "towers": n}) for n in (_QUICK_SIZES if quick else SIZES)]
    first = found([fleet, *sets])
    planned = first["fleet"]
    flights = [
        Job(f"flight/{number}", flight_job, {**shared, "folder": str(folder / "plan"), "number": number})
        for number in range(1, len(planned["rounds"]) + 1)
    ]
    together = {**shared, "folder": str(folder / "plan"), "rounds": len(planned["rounds"])}
    found([fleet, *sets, *flights])
    measured = Job("coverage", coverage_job, together)
    every = found([fleet, *sets, *flights, measured, *sizes])
    results = Results(
        planned,
        tuple(every[job.key] for job in sets),
        tuple(every[job.key] for job in flights),
        every[measured.key],
        tuple(every[job.key] for job in sizes),
        tuple(result["made"] for result in every.values()),
    )
    _write(output, results)
    return results.as_json()


def _assignment(*, quick: bool) -> dict[str, Any]:
    return {"iterations": _QUICK_ITERATIONS} if quick else {}


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """Towers shared out in three ways, and what that took."""

    scene: Scene
    costs: TravelCosts
    ours: Assignment
    simple: dict[str, Assignment]
    travel_s: float
    solver_s: float

    @classmethod
    def of(cls, mission: Mission, data: Path, seed: int) -> _Shared:
        scene = open_scene(mission, data)
        visits, _ = views.visits(scene)
        begin_s = time.process_time()
        costs = travel_costs(scene, visits)
        middle_s = time.process_time()
        ours = assign(scene, visits, seed=seed, costs=costs)
        solver_s = time.process_time() - middle_s
        simple = {way: share_out(scene, visits, way, costs=costs) for way in ("split", "nearest")}
        return cls(scene, costs, ours, simple, middle_s - begin_s, solver_s)

    def told(self, assignment: Assignment) -> dict[str, Any]:
        towers = {visit.target for tour in assignment.tours for visit in tour.visits}
        assert self.scene.towers is not None
        weights = dict(zip(self.scene.towers.names, self.scene.towers.weight.tolist(), strict=True))
        return {
            "towers": len(towers),
            "left_out": len(assignment.left_out),
            "weight": sum(weights[tower] for tower in towers),
            "rounds": assignment.rounds,
            "makespan_s": round(assignment.makespan_s, 1),
            "flight_s": round(assignment.flight_s, 1),
            "bound_s": round(assignment.bound_s, 1),
        }

    def as_json(self) -> dict[str, Any]:
        return {
            "ours": self.told(self.ours),
            **{way: self.told(assignment) for way, assignment in self.simple.items()},
            "all": 0 if self.scene.towers is None else len(self.scene.towers.names),
            "weight_all": 0.0 if self.scene.towers is None else float(self.scene.towers.weight.sum()),
            "travel_cpu_s": round(self.travel_s, 2),
            "solver_cpu_s": round(self.solver_s, 2),
        }


def fleet_job(data: str, seed: int, quick: bool, folder: str) -> dict[str, Any]:
    """Share out, plan and prove the two lines; keep the plan in a folder."""
    mission = bayreuth(Path(data), quick=quick, **_assignment(quick=quick))
    shared = _Shared.of(mission, Path(data), seed)
    begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
    plan = plan_inspection(mission, Path(data), seed=seed)
    clock_s, cpu_s = time.perf_counter() - begin_s, time.process_time() - begin_cpu_s
    Path(folder).mkdir(parents=True, exist_ok=True)
    save_inspection(Path(folder), plan, _save_round)
    tours = []
    for number, round_ in enumerate(plan.rounds, start=1):
        for tour, vehicle in zip(round_.tours, round_.plan.vehicles, strict=True):
            taken = _energy(round_, vehicle.name)
            tours.append(
                {
                    "vehicle": vehicle.name,
                    "round": number,
                    "visits": len(tour.visits),
                    "reckoned_s": round(tour.time_s, 1),
                    "planned_s": round(float(vehicle.trajectory.t_s[-1]), 1),
                    "reckoned_share": round(tour.energy_share, 4),
                    "planned_share": round(max(f.value or 0.0 for f in taken), 4),
                    "way_m": vehicle.waypoints_m[:, :2].round(1).tolist(),
                }
            )
    assert plan.scene.towers is not None
    return {
        **shared.as_json(),
        "planned_towers": len(plan.inspected),
        "planned_left_out": [f"{left.target}: {left.why}" for left in plan.left_out],
        "planned_makespan_s": round(plan.makespan_s, 1),
        "planned_flight_s": round(sum(tour["planned_s"] for tour in tours), 1),
        "rounds": [round(round_.lasts_s, 1) for round_ in plan.rounds],
        "tours": tours,
        "lines": [
            plan.scene.towers.top_m[[plan.scene.towers.names.index(t) for t in line.towers], :2].round(1).tolist()
            for line in (mission.inspection.lines_or_one if mission.inspection else ())
        ],
        "homes": [task.home_m[:2].round(1).tolist() for task in plan.scene.tasks],
        "planning_s": round(clock_s, 1),
        "planning_cpu_s": round(cpu_s, 1),
        "made": provenance(),
    }


def _save_round(folder: Path, round_: Round) -> None:
    save_plan(folder, round_.scene, round_.plan)
    save_certificate(folder, certify_plan(round_.scene, round_.plan))


def _energy(round_: Round, vehicle: str) -> list[Finding]:
    assert round_.plan.certificate is not None
    return [f for f in round_.plan.certificate.findings if f.check == "energy" and f.vehicle == vehicle]


def flight_job(data: str, seed: int, quick: bool, folder: str, number: int) -> dict[str, Any]:
    """Fly a round in lock-step simulation; measure what its tracks keep from conductors, and what they have seen."""
    plan = load_inspection(Path(folder))
    round_ = plan.rounds[number - 1]
    flown = rehearse(round_.scene, round_.plan, correct=False, seed=seed)
    nearest = []
    for vehicle in flown.flight.vehicles:
        track = vehicle.trajectory
        t_s = np.arange(float(track.t_s[0]), float(track.t_s[-1]) + _STEP_S, _STEP_S)
        nearest.append(float(conductor_distance_m(round_.scene.conductors, track.at(t_s)).min()))
    worst = [c for clearances in flown.check.clearances for c in clearances]
    tracks = [vehicle.trajectory for vehicle in flown.flight.vehicles]
    _save_tracks(Path(folder), number, tracks)
    return {
        "round": number,
        "vehicles": len(flown.flight.vehicles),
        "landed": sum(vehicle.landed_s is not None for vehicle in flown.flight.vehicles),
        "lasts_s": round(max(float(vehicle.trajectory.t_s[-1]) for vehicle in flown.flight.vehicles), 1),
        "conductor_m": round(min(nearest), 3),
        "required_m": SAFETY_M,
        "separation_m": None if flown.check.separation is None else round(flown.check.separation.distance_m, 2),
        "margin_m": round(min(c.distance_m - c.required_m for c in worst), 3) if worst else None,
        "made": provenance(),
    }


def coverage_job(data: str, seed: int, quick: bool, folder: str, rounds: int) -> dict[str, Any]:
    """Measure what all rounds together have seen: sides of one tower may be seen in different ones."""
    plan = load_inspection(Path(folder))
    tracks = [track for number in range(1, rounds + 1) for track in _tracks(Path(folder), number)]
    seen = coverage.measure(plan.scene, tracks)
    return {"seen": sorted(seen.done), "missing": list(seen.missing), "made": provenance()}


def _tracks_path(folder: Path, number: int) -> Path:
    return folder.parent / f"tracks-{number}.npz"


def _save_tracks(folder: Path, number: int, tracks: Sequence[Trajectory]) -> None:
    arrays: dict[str, FloatArray] = {}
    for k, track in enumerate(tracks):
        arrays |= {f"t_{k}": track.t_s, f"at_{k}": track.position_m}
    with replacing(_tracks_path(folder, number)) as draft, draft.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # as its stubs write keywords


def _tracks(folder: Path, number: int) -> list[Trajectory]:
    with np.load(_tracks_path(folder, number)) as found:
        return [Trajectory(found[f"t_{k}"], found[f"at_{k}"]) for k in range(len(found.files) // 2)]


def priority_job(data: str, seed: int, quick: bool, number: int) -> dict[str, Any]:
    """Share out one sortie of every vehicle by random priorities: days since a tower was inspected."""
    mission = bayreuth(Path(data), quick=quick, objective="priority", **_assignment(quick=quick))
    assert mission.inspection is not None
    rng = np.random.default_rng([seed, number])
    days = rng.integers(1, _DAYS_MAX, len(mission.inspection.towers), endpoint=True).tolist()
    towers = tuple(
        tower.model_copy(update={"weight": float(day)})
        for tower, day in zip(mission.inspection.towers, days, strict=True)
    )
    weighed = mission.model_copy(update={"inspection": mission.inspection.model_copy(update={"towers": towers})})
    return {"set": number, **_Shared.of(weighed, Path(data), seed).as_json(), "made": provenance()}


def size_job(data: str, seed: int, quick: bool, towers: int) -> dict[str, Any]:
    """Share out so many towers; plan and prove them, or of many the first round only; what failed is told."""
    mission = many(Path(data), towers, **_assignment(quick=quick))
    shared = _Shared.of(mission, Path(data), seed)
    begin_s, begin_cpu_s = time.perf_counter(), time.process_time()
    told: dict[str, Any] = {"problem": None, "rounds": shared.ours.rounds}
    try:
        if towers <= _WHOLE_MAX:
            plan = plan_inspection(mission, Path(data), seed=seed)
            told |= {"planned_towers": len(plan.inspected), "rounds": len(plan.rounds), "planned_rounds": "all"}
        else:
            tours = [tour for tour in shared.ours.tours if tour.round == 0][:_TOURS_MAX]
            scene = build_scene(round_mission(shared.scene, tours, 1), Path(data))
            plan_fleet(scene, seed=seed)
            seen = {visit.target for tour in tours for visit in tour.visits}
            told |= {"planned_towers": len(seen), "planned_rounds": f"{len(tours)} tours of the first"}
    except MissionPlannerError as error:
        told["problem"] = str(error)
    return {
        "towers": towers,
        "vehicles": len(mission.vehicles),
        **told,
        "travel_cpu_s": round(shared.travel_s, 1),
        "solver_cpu_s": round(shared.solver_s, 1),
        "planning_s": round(time.perf_counter() - begin_s, 1),
        "planning_cpu_s": round(time.process_time() - begin_cpu_s, 1),
        "flight_s": round(shared.ours.flight_s, 1),
        "bound_s": round(shared.ours.bound_s, 1),
        "made": provenance(),
    }


# --- what is written -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Results:
    """What came of all runs."""

    fleet: dict[str, Any]
    priorities: tuple[dict[str, Any], ...]
    flights: tuple[dict[str, Any], ...]
    coverage: dict[str, Any]
    sizes: tuple[dict[str, Any], ...]
    made: tuple[dict[str, str], ...]

    def gains(self, way: str) -> list[float]:
        """Return by how much more weight ours collects than a simple way, set by set, as a share."""
        return [p["ours"]["weight"] / p[way]["weight"] - 1.0 for p in self.priorities if p[way]["weight"] > 0.0]

    def problems(self) -> list[str]:
        """Return what was not kept."""
        found = [
            f"priorities {p['set']}: {_WAYS[way]} collects {p[way]['weight']:g}, ours {p['ours']['weight']:g}"
            for p in self.priorities
            for way in _WAYS
            if p["ours"]["weight"] < p[way]["weight"]
        ]
        for flight in self.flights:
            what = f"round {flight['round']}"
            if flight["conductor_m"] < flight["required_m"]:
                found.append(f"{what}: {flight['conductor_m']} m from a conductor, asked {flight['required_m']:g} m")
            if flight["landed"] < flight["vehicles"]:
                found.append(f"{what}: {flight['landed']} of {flight['vehicles']} landed")
        planned = self.fleet["planned_towers"]
        if len(self.coverage["seen"]) < planned:
            missing = "; ".join(self.coverage["missing"][:3])
            found.append(f"{len(self.coverage['seen'])} of {planned} towers seen: {missing}")
        found += [f"{s['towers']} towers: {s['problem']}" for s in self.sizes if s["problem"]]
        return found + [f"left out: {why}" for why in self.fleet["planned_left_out"]]

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        found = asdict(self)
        found["problems"] = self.problems()
        return found


def _write(folder: Path, results: Results) -> None:
    write_atomic(folder / "results.md", table(results))
    tours = [[tour[field] for field in _TOUR_FIELDS] for tour in results.fleet["tours"]]
    write_csv(folder / "tours.csv", list(_TOUR_FIELDS), tours)
    write_csv(
        folder / "priorities.csv",
        ["set", "ours", *_WAYS, "all"],
        [
            [p["set"], p["ours"]["weight"], *(p[way]["weight"] for way in _WAYS), p["weight_all"]]
            for p in results.priorities
        ],
    )
    for name, drawn in (("map.png", _map(results)), ("bars.png", _bars(results))):
        with replacing(folder / name) as draft:
            drawn.savefig(draft, format="png", metadata={"Software": None})


_TOUR_FIELDS = (
    "round",
    "vehicle",
    "visits",
    "reckoned_s",
    "planned_s",
    "reckoned_share",
    "planned_share",
)


def table(results: Results) -> str:
    """Return the figures as Markdown."""
    fleet = results.fleet
    made, _ = gathered(results.made)
    rows = [("ours", "ours"), *_WAYS.items()]
    shared = [
        "| | towers | left out | rounds | makespan | flight time | lower bound |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {words} | {fleet[way]['towers']} of {fleet['all']} | {fleet[way]['left_out']} | {fleet[way]['rounds']} "
            f"| {fleet[way]['makespan_s']:.0f} s | {fleet[way]['flight_s']:.0f} s | {fleet[way]['bound_s']:.0f} s |"
            for way, words in rows
        ),
    ]
    above = fleet["ours"]["flight_s"] / fleet["ours"]["bound_s"] - 1.0
    off = [t["planned_s"] / t["reckoned_s"] - 1.0 for t in fleet["tours"]]
    off_share = [t["planned_share"] / t["reckoned_share"] - 1.0 for t in fleet["tours"] if t["reckoned_share"]]
    planned = (
        f"Our flight time is {above:.1%} above the bound, after {fleet['solver_cpu_s']:.1f} s of solver time; costs of "
        f"travel took {fleet['travel_cpu_s']:.1f} s. Planned and proven are {fleet['planned_towers']} towers in "
        f"{len(fleet['rounds'])} rounds, a makespan of {fleet['planned_makespan_s']:.0f} s with "
        f"{fleet['planned_flight_s']:.0f} s of flight; planning took {fleet['planning_s']:.0f} s "
        f"({fleet['planning_cpu_s']:.0f} s of the processor). Against what was reckoned when towers were shared "
        f"out, flights take {_spread(off)} of time and {_spread(off_share)} of a battery."
    )
    weights = [
        "| | mean weight | ours, mean gain | least | greatest | ours is as much or more |",
        "|---|---|---|---|---|---|",
        f"| ours | {statistics.mean(p['ours']['weight'] for p in results.priorities):.0f} | | | | |",
        *(
            f"| {words} | {statistics.mean(p[way]['weight'] for p in results.priorities):.0f} | "
            f"{statistics.mean(gains):+.1%} | {min(gains):+.1%} | {max(gains):+.1%} | "
            f"{sum(p['ours']['weight'] >= p[way]['weight'] for p in results.priorities)} of {len(results.priorities)} |"
            for way, words in _WAYS.items()
            if (gains := results.gains(way))
        ),
    ]
    flights = [
        "| round | vehicles | lasts | least distance to a conductor | asked | least separation | worst other margin |",
        "|---|---|---|---|---|---|---|",
        *(
            f"| {f['round']} | {f['vehicles']} | {f['lasts_s']:.0f} s | {f['conductor_m']:.1f} m | "
            f"{f['required_m']:g} m | {_or_dash(f['separation_m'])} | {_or_dash(f['margin_m'])} |"
            for f in results.flights
        ),
    ]
    sizes = [
        "| towers | vehicles | rounds | planned | towers in that | travel | solver | planning, processor | by clock "
        "| above bound |",
        "|---|---|---|---|---|---|---|---|---|---|",
        *(
            f"| {s['towers']} | {s['vehicles']} | {s['rounds']} | {s.get('planned_rounds', '-')} | "
            f"{s.get('planned_towers', '-')} | "
            f"{s['travel_cpu_s']:.1f} s | {s['solver_cpu_s']:.1f} s | {s['planning_cpu_s']:.0f} s | "
            f"{s['planning_s']:.0f} s | {s['flight_s'] / s['bound_s'] - 1.0:.1%} |"
            for s in results.sizes
        ),
    ]
    problems = results.problems()
    return joined(
        "# Two lines inspected",
        made,
        f"{fleet['all']} towers of {len(fleet['lines'])} lines of 110 kV near Bayreuth ({TOWER_M:g} m high, assumed), "
        f"seen from both sides; {len(fleet['homes'])} copters of {ENDURANCE_S / 60:.0f} minutes endurance beside "
        "the lines.",
        shared,
        planned,
        "Who flies where is drawn in map.png beside these results (it shows the data, which stay yours).",
        "![Flight time, and weight collected](bars.png)",
        "## Priorities",
        f"One sortie each, {len(results.priorities)} sets of random priorities (1 to {_DAYS_MAX} days).",
        weights,
        "## Flown in simulation",
        f"Distances every {_STEP_S:g} s along the tracks, to the conductors themselves.",
        flights,
        f"All rounds together have seen {len(results.coverage['seen'])} of {fleet['all']} towers from all sides asked "
        "for.",
        "## How planning grows",
        f"Straight lines side by side on the same ground. Of more than {_WHOLE_MAX} towers all are shared out, and "
        f"{_TOURS_MAX} tours of the first round planned and proven together, of that round's tours those of the first "
        "vehicles.",
        sizes,
        ["Not kept:", "", *(f"- {problem}" for problem in problems)] if problems else "All was kept.",
    )


def _spread(shares: Sequence[float]) -> str:
    return f"{statistics.mean(shares):+.1%} ({min(shares):+.1%} to {max(shares):+.1%})" if shares else "-"


def _or_dash(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} m"


def _map(results: Results) -> Figure:
    """Draw the lines, and everybody's ways; later rounds broken."""
    figure = Figure(figsize=(7.0, 7.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    for line in results.fleet["lines"]:
        axes.plot(*np.array(line).T / 1000.0, color="#333333", linewidth=0.8, marker="o", markersize=1.5, zorder=1)
    colours: dict[str, str] = {}
    for tour in results.fleet["tours"]:
        new = tour["vehicle"] not in colours
        colour = colours.setdefault(tour["vehicle"], _COLOURS[len(colours) % len(_COLOURS)])
        style = "-" if tour["round"] == 1 else "--" if tour["round"] == 2 else ":"
        way = np.array(tour["way_m"]) / 1000.0
        axes.plot(*way.T, style, color=colour, linewidth=1.0, label=tour["vehicle"] if new else None, zorder=2)
    homes = np.array(results.fleet["homes"]) / 1000.0
    axes.plot(*homes.T, "s", color="black", markersize=4, label="homes", zorder=3)
    axes.set_aspect("equal")
    axes.set_xlabel("east, km", fontsize=8)
    axes.set_ylabel("north, km", fontsize=8)
    axes.legend(fontsize=7, frameon=False)
    _plain(axes)
    return figure


def _bars(results: Results) -> Figure:
    """Draw flight times against the bound, and the weight that each way collects of all."""
    figure = Figure(figsize=(7.0, 2.6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    fleet, rows = results.fleet, [("ours", "ours"), *_WAYS.items()]
    names = [words for _, words in rows]
    left.barh(range(len(rows)), [fleet[way]["flight_s"] / 3600.0 for way, _ in rows], color="#0072b2", height=0.6)
    left.axvline(fleet["ours"]["bound_s"] / 3600.0, color="#d55e00", linewidth=1.0)
    left.set_yticks(range(len(rows)), [f"{name}\n{fleet[way]['towers']} towers" for way, name in rows], fontsize=7)
    left.set_xlabel("flight time, h (line: bound through all towers)", fontsize=7)
    shares = [[p[way]["weight"] / p["weight_all"] for p in results.priorities] for way, _ in rows]
    right.barh(range(len(rows)), [100.0 * statistics.mean(s) for s in shares], color="#56b4e9", height=0.6)
    for row, values in enumerate(shares):
        right.plot([100.0 * v for v in values], [row] * len(values), "|", color="#333333", markersize=8)
    right.set_yticks(range(len(rows)), names, fontsize=7)
    right.set_xlabel("weight by one sortie each, % of all (marks: sets)", fontsize=7)
    for axes in (left, right):
        axes.set_ylim(len(rows) - 0.5, -0.5)
        _plain(axes)
    return figure


def _plain(axes: Axes) -> None:
    axes.tick_params(labelsize=7, length=2)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
