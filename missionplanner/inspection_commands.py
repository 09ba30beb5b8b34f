"""The command line's side of inspections: planned, flown and shown round after round, and what was seen of them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.terminal import planning_bars, print_json, stderr, stdout

if TYPE_CHECKING:  # the planner takes a second to import
    from missionplanner.certificate import Certificate
    from missionplanner.coverage import Coverage
    from missionplanner.flight_check import FlightCheck
    from missionplanner.inspection import InspectionPlan, Round
    from missionplanner.mission import Mission
    from missionplanner.plan import FleetFlight, FleetPlan, Trajectory
    from missionplanner.scene import Scene

_TOLD = 5
_SAME = 1e-9

WritePlan = Callable[[Path, "Scene", "FleetPlan"], "FleetPlan"]
"""Writes a plan folder and what goes with it, refuses a plan that is not proven, and returns it with its proof."""


def refuse_whole(folder: Path, command: str) -> None:
    """Refuse an inspection where only one round of it can be meant.

    Raises
    ------
    MissionError
        It is one.
    """
    from missionplanner.plan_folder import is_inspection

    if is_inspection(folder):
        raise MissionError(
            f"{folder}: expected one round at a time, got a whole inspection: {command} {folder / 'round-1'} first, "
            "and the next one when all have landed and have fresh batteries"
        )


# --- planning --------------------------------------------------------------------------------------------------------


def plan(
    question: Mission,
    path: Path,
    folder: Path,
    *,
    seed: int | None,
    flown: Sequence[Path],
    simulated: bool,
    busy: str,
    write: WritePlan,
    as_json: bool,
) -> None:
    """Plan an open mission into a folder: all its rounds; of what logs show as inspected, nothing.

    Rehearsals have inspected nothing, unless they are to count (``simulated``).
    """
    from missionplanner.files import ensure_writable

    logs = _logs(flown)
    if any(folder.resolve() in (read.resolve(), *read.resolve().parents) for read in (*flown, *logs)):
        raise MissionError(f"--output: expected another folder than {folder}, whose flights are read: choose one")
    logs = logs if simulated else _real(logs)
    done = _seen_before(question, path, logs) if logs else frozenset()
    ensure_writable(folder)
    with alone_in(folder, busy):
        planned = plan_into(question, path, folder, seed=seed, done=done, write=write)
    if planned.rounds:
        show(planned, folder, as_json)
        return
    left_out = [{"target": left.target, "why": left.why} for left in planned.left_out]
    if as_json:
        print_json({"mission": question.name, "done_before": sorted(done), "rounds": [], "left_out": left_out})
        return
    stdout.print(f"nothing is left to inspect, nothing was planned: {len(done)} targets were inspected before")
    for left in left_out:
        stdout.print("left out: {target}: {why}".format(**left), soft_wrap=True, highlight=False, markup=False)


def plan_into(
    question: Mission, path: Path, folder: Path, *, seed: int | None, done: frozenset[str], write: WritePlan
) -> InspectionPlan:
    """Plan, with progress bars, and write everything; where nothing is left to be done, no earlier plan stays."""
    from missionplanner.inspection import plan_inspection
    from missionplanner.inspection_folder import clear, save_inspection
    from missionplanner.warmup import begin

    compiling = begin()
    if compiling is not None:
        print("first run: compiling the kernels takes a minute, once", file=sys.stderr)
    with planning_bars() as show_bar:

        def watch(vehicle: str, done: float) -> None:
            show_bar(vehicle, done)
            if compiling is not None and vehicle.endswith("round 1"):
                compiling.wait()  # what the other process compiles would be compiled twice

        try:
            planned = plan_inspection(question, path.parent, seed=seed, watch=watch, done=done)
        except MissionError as error:
            raise MissionError(f"{path}: {error}") from error
        except InfeasibleError as error:
            raise InfeasibleError(f"{path}: {error}") from error
    if not planned.rounds:
        clear(folder)  # an earlier plan of the rest must not be flown again
        return planned
    proven: list[Round] = []

    def save(at: Path, this: Round) -> None:
        proven.append(replace(this, plan=write(at, this.scene, this.plan)))

    with stderr.status("writing"):
        save_inspection(folder, planned, save)
        write_towers(folder, planned)
    return replace(planned, rounds=tuple(proven))


def validate(question: Mission, path: Path, as_json: bool) -> None:
    """Tell what an open mission asks for: towers, spans, views, and what cannot be looked at."""
    from missionplanner.inspection import open_scene
    from missionplanner.views import visits

    try:
        scene = open_scene(question, path.parent)
        found, left_out = visits(scene)
    except MissionError as error:
        raise MissionError(f"{path}: {error}") from error
    targets = list(dict.fromkeys(visit.target for visit in found))
    if not targets:
        raise MissionError(
            f"{path}: expected something to inspect, got none: "
            + (_left_out_words(left_out) if left_out else "give towers views, or inspection.spans")
        )
    notes = [f"{visit.name}: {visit.note}" for visit in found if visit.note]
    if as_json:
        print_json(
            {
                "mission": scene.mission.name,
                "vehicles": [task.name for task in scene.tasks],
                "targets": targets,
                "visits": len(found),
                "viewpoints": sum(len(visit.viewpoints) for visit in found),
                "notes": notes,
                "left_out": [{"target": left.target, "why": left.why} for left in left_out],
                "valid": True,
            }
        )
        return
    spans = sum(target.startswith("span ") for target in targets)
    stdout.print(
        f"{path}: {scene.mission.name} is sound: {len(scene.tasks)} vehicles, {len(targets) - spans} towers and "
        f"{spans} spans to inspect in {len(found)} visits, {len(scene.obstacles.names)} obstacles, terrain "
        f"{scene.terrain.description}",
        soft_wrap=True,
    )
    for line in [*notes, *(f"left out: {left.target}: {left.why}" for left in left_out)]:
        stdout.print(line, soft_wrap=True, highlight=False, markup=False)


# --- the folder ------------------------------------------------------------------------------------------------------


def check(folder: Path, check_round: Callable[[Path], tuple[Certificate, dict[str, Path]]], as_json: bool) -> list[str]:
    """Prove every round as it lies there, edited files included; return what is not proven."""
    from missionplanner.inspection_folder import load_inspection, round_folder
    from missionplanner.summary import certificate_table

    planned = load_inspection(folder)
    rows = []
    for number in range(1, len(planned.rounds) + 1):
        certificate, paths = check_round(round_folder(folder, number))
        rows.append((round_folder(folder, number), certificate, paths))
    if as_json:
        rounds = [
            {"folder": str(at)} | certificate.as_json() | {name: str(path) for name, path in paths.items()}
            for at, certificate, paths in rows
        ]
        print_json({"proven": all(certificate.proven for _, certificate, _ in rows), "rounds": rounds})
    else:
        for at, certificate, paths in rows:
            stdout.print(f"{at}", soft_wrap=True, highlight=False)
            stdout.print(certificate_table(certificate))
            for name, path in paths.items():
                stdout.print(f"{name}: {path}", soft_wrap=True, highlight=False)
    return [f"{at}: {certificate.refusal}" for at, certificate, _ in rows if not certificate.proven]


def export(
    folder: Path, export_round: Callable[[Path, Path], tuple[Sequence[Path], Sequence[str]]], output: Path | None
) -> tuple[list[Path], list[str]]:
    """Write every round's files, by ``export_round``, to its own folder or below ``output``; return paths, remarks."""
    from missionplanner.inspection_folder import load_inspection, round_folder

    planned = load_inspection(folder)
    written: list[Path] = []
    told: dict[str, None] = {}
    for number in range(1, len(planned.rounds) + 1):
        at = round_folder(folder, number)
        paths, remarks = export_round(at, at / "files" if output is None else output / at.name)
        written += paths
        told |= dict.fromkeys(remarks)
    return written, list(told)


def with_plans(planned: InspectionPlan, folder: Path, change: WritePlan) -> InspectionPlan:
    """Return the inspection with ``change`` made to every round's plan."""
    from missionplanner.inspection_folder import round_folder

    rounds = [
        replace(r, plan=change(round_folder(folder, number), r.scene, r.plan))
        for number, r in enumerate(planned.rounds, start=1)
    ]
    return replace(planned, rounds=tuple(rounds))


# --- flying ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class FlownRound:
    """A round as it was flown."""

    flight: FleetFlight
    check: FlightCheck
    report: Path


def expect_vehicles(option: str, names: Iterable[str], planned: InspectionPlan) -> None:
    """Refuse names of no vehicle that flies in an inspection.

    Raises
    ------
    MissionError
        There is one.
    """
    flying = {vehicle.name for round_ in planned.rounds for vehicle in round_.plan.vehicles}
    if unknown := sorted(set(names) - flying):
        raise MissionError(f"{option}: expected names of vehicles ({', '.join(sorted(flying))}), got {unknown[0]}")


def fly(
    folder: Path,
    planned: InspectionPlan,
    fly_round: Callable[[Path, Scene, FleetPlan], FlownRound],
    as_json: bool,
) -> list[str]:
    """Fly all rounds one after the other, show what came of them, and return what is wrong with it."""
    from missionplanner.inspection_folder import round_folder

    flown: list[FlownRound] = []
    flights = Flights()
    problems: list[str] = []
    for number, round_ in enumerate(planned.rounds, start=1):
        at = round_folder(folder, number)
        done = fly_round(at, round_.scene, round_.plan)
        flown.append(done)
        flights += _latest(at, round_.plan)
        missing = [vehicle.name for vehicle in done.flight.vehicles if vehicle.arrival_s is None]
        if missing:
            problems.append(f"round {number}: {', '.join(missing)} never reached the goal: see {done.report}")
        if not done.check.ok:
            problems.append(f"round {number}: the flight did not keep every clearance: see {done.report}")
        if problems:
            break  # the next round begins when all have landed, and were flown as proven
    seen = flights.measured(planned.scene)
    with stderr.status("writing what was seen"):
        files = write_coverage(folder, planned.scene, seen, flights, planned)
    show(planned, folder, as_json, flown, seen, files, flights.simulated)
    missed = [target for target in planned.inspected if target not in seen.done]
    if missed:
        more = f" and {len(missed) - _TOLD} more" if len(missed) > _TOLD else ""
        problems.append(f"not seen from all sides: {', '.join(missed[:_TOLD])}{more}: see {files['coverage']}")
    return problems


def show(
    planned: InspectionPlan,
    folder: Path,
    as_json: bool,
    flown: Sequence[FlownRound] = (),
    seen: Coverage | None = None,
    written: Mapping[str, Path] | None = None,
    simulated: Sequence[str] = (),
) -> None:
    """Show an inspection as planned and, where it was, as flown and seen."""
    from missionplanner.plan_folder import INSPECTION_NAME
    from missionplanner.summary import inspection_lines, inspection_table, summarise_inspection

    summary = summarise_inspection(planned, [(f.flight, f.check) for f in flown], seen)
    summary |= {"simulated": list(simulated)} if flown else {}
    files = {"folder": folder, "inspection": folder / INSPECTION_NAME, **(written or {})}
    if as_json:
        print_json(summary | {name: str(path) for name, path in files.items()})
        return
    stdout.print(inspection_table(summary))
    for line in [
        *inspection_lines(summary),
        *_simulated_lines(simulated),
        *(f"{what}: {path}" for what, path in files.items()),
    ]:
        stdout.print(line, soft_wrap=True, highlight=False, markup=False)


@contextmanager
def alone_in(folder: Path, expected: str) -> Iterator[None]:
    """Keep other programs out of an inspection and all its rounds meanwhile."""
    from missionplanner.files import alone

    with ExitStack() as stack:
        for at in [folder, *sorted(path for path in folder.glob("round-*") if path.is_dir())]:
            stack.enter_context(alone(at, expected))
        yield


# --- what was seen ---------------------------------------------------------------------------------------------------


def cameras(
    as_json: Annotated[bool, typer.Option("--json", help="print JSON on stdout instead of tables")] = False,
) -> None:
    """List the cameras that inspection.camera.preset takes, with what a pixel covers from 25 m."""
    from dataclasses import asdict

    from rich.table import Table

    from missionplanner.camera import PRESETS

    if as_json:
        rows = [{"preset": name, **asdict(model), "gsd_max_mm": None} for name, model in PRESETS.items()]
        print_json({"cameras": rows})
        return
    table = Table("preset", "camera", "mm", "pixels", "mm a pixel at 25 m", "photos every s", box=None)
    for name, model in PRESETS.items():
        pixels = f"{model.image_width_px} x {model.image_height_px}"
        table.add_row(
            name,
            model.name,
            f"{model.focal_length_mm:g}",
            pixels,
            f"{model.gsd_mm(25.0):.1f}",
            f"{model.interval_min_s:g}",
        )
    stdout.print(table)


def coverage(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="an inspection, or a plan folder of one round")],
    log: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="TLOG|FOLDER", help="what was flown; may be repeated; default: the latest flights in FOLDER"
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON on stdout instead of tables")] = False,
) -> None:
    """Tell what flown tracks and photos show of an inspection; exit code 3 below inspection.share_min (eq. 6).

    Tables and a map are written to FOLDER.
    """
    asked = _Asked.of(folder)
    seen = _recorded(asked.scene, _logs(log)) if log else asked.flights()
    if not seen.tracks:
        raise MissionError(f"{folder}: expected flights, got none: fly it first, or name logs with --log")
    found = seen.measured(asked.scene)
    with stderr.status("writing"):
        files = write_coverage(folder, asked.scene, found, seen, asked.planned)
    share = found.share if asked.planned is None else asked.planned.share_of(found.done | asked.planned.done)
    summary = {
        "mission": asked.scene.mission.name,
        **found.as_json(),
        "share": round(share, 4),
        "share_min": asked.share_min,
        "done_before": [] if asked.planned is None else sorted(asked.planned.done),
        "flights": list(seen.recorded),
        "simulated": list(seen.simulated),
    }
    if as_json:
        notes = [*found.notes, *seen.notes]
        print_json(summary | {"notes": notes, "files": {name: str(path) for name, path in files.items()}})
    else:
        from missionplanner.summary import coverage_lines, coverage_table

        stdout.print(coverage_table(summary))
        told = [*coverage_lines(summary), *seen.notes, f"flights: {', '.join(seen.recorded)}"]
        told += [*_simulated_lines(seen.simulated), *(f"{what}: {path}" for what, path in files.items())]
        for line in told:
            stdout.print(line, soft_wrap=True, highlight=False, markup=False)
    if share < asked.share_min - _SAME:
        print(
            f"missionplanner: {folder}: expected {asked.share_min:.0%} of the towers' weight to be seen (eq. 6), got "
            f"{share:.1%}",
            file=sys.stderr,
        )
        raise typer.Exit(InfeasibleError.exit_code)


@dataclass(frozen=True, slots=True, eq=False)
class Flights:
    """Recorded flights: where vehicles were, who, and where they took photos."""

    tracks: tuple[Trajectory, ...] = ()
    names: tuple[str, ...] = ()
    photos: tuple[Trajectory | None, ...] = ()  # None: no log tells
    targets: tuple[frozenset[str] | None, ...] = ()  # to be looked at, by the plan; None: it is not known
    notes: tuple[str, ...] = ()  # what of logs is lost
    recorded: tuple[str, ...] = ()  # the folders that hold them
    simulated: tuple[str, ...] = ()  # those of these that are of rehearsals

    def measured(self, scene: Scene) -> Coverage:
        """Return what they have seen."""
        from missionplanner.coverage import measure

        return measure(scene, self.tracks, names=self.names, photos=self.photos, targets=self.targets)

    def __add__(self, other: Flights) -> Flights:
        return Flights(
            self.tracks + other.tracks,
            self.names + other.names,
            self.photos + other.photos,
            self.targets + other.targets,
            self.notes + other.notes,
            self.recorded + other.recorded,
            self.simulated + other.simulated,
        )


def _simulated_lines(simulated: Sequence[str]) -> list[str]:
    return [f"SIMULATED: no vehicle was in the air, nothing is inspected by: {', '.join(simulated)}"] * bool(simulated)


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """What a folder's mission asks to be seen, and the plans that were made of it."""

    scene: Scene
    share_min: float
    plans: tuple[tuple[Path, FleetPlan], ...]
    planned: InspectionPlan | None

    @classmethod
    def of(cls, folder: Path) -> _Asked:
        from missionplanner.inspection_folder import load_inspection
        from missionplanner.plan_folder import is_inspection, load_plan

        if is_inspection(folder):
            planned = load_inspection(folder)
            return cls(planned.scene, planned.share_min, tuple(_plans(folder, planned)), planned)
        whole = folder.resolve().parent
        if is_inspection(whole):
            raise MissionError(f"{folder}: expected the whole inspection, got a round of it: name {whole}")
        scene, plan = load_plan(folder)
        if any(stop.inspects for vehicle in scene.mission.vehicles for stop in vehicle.stops):
            raise MissionError(  # passing by is not looking
                f"{folder}: expected the folder of the whole inspection, got a part of one, which does not tell all "
                f"that is to be seen: name the whole, and this with --log {folder}"
            )
        if scene.towers is None:
            raise MissionError(f"{folder}: expected a mission with inspection.towers, got none to be seen")
        return cls(scene, scene.towers.share_min, ((folder, plan),), None)

    def flights(self) -> Flights:
        """Return the latest flight of every plan that was flown."""
        return _latest_of(self.plans)


def _plans(folder: Path, planned: InspectionPlan) -> Iterator[tuple[Path, FleetPlan]]:
    """Yield the rounds' plans, and those beside them by which vehicles went on with a round (the command resume)."""
    from missionplanner.inspection_folder import round_folder
    from missionplanner.plan_folder import FLIGHT_NAME, PLAN_NAME, load_plan

    for number, round_ in enumerate(planned.rounds, start=1):
        at = round_folder(folder, number)
        yield at, round_.plan
        for rest in sorted(folder.glob(f"{at.name}_*")):
            if (rest / PLAN_NAME).exists() and (rest / FLIGHT_NAME).exists():
                yield rest, load_plan(rest)[1]


def _latest_of(plans: Iterable[tuple[Path, FleetPlan]]) -> Flights:
    return sum((_latest(folder, plan) for folder, plan in plans), Flights())


def _latest(folder: Path, plan: FleetPlan) -> Flights:
    from adapters.flown_logs import read_tracks
    from adapters.telemetry_log import latest_flight
    from missionplanner.plan_folder import load_flight, was_simulated

    flight = load_flight(folder, plan)
    if flight is None:
        return Flights()
    log = latest_flight(folder / "logs", [vehicle.sysid for vehicle in plan.vehicles])
    tracks, notes = ((), ()) if log is None else read_tracks([log], plan.frame)
    photos = {track.sysid: track.photos for track in tracks}
    targets = {v.sysid: frozenset(a.inspects for a in v.actions.values() if a.inspects) for v in plan.vehicles}
    return Flights(
        tuple(vehicle.trajectory for vehicle in flight.vehicles),
        tuple(vehicle.name for vehicle in flight.vehicles),
        tuple(photos.get(vehicle.sysid) for vehicle in flight.vehicles),
        tuple(targets.get(vehicle.sysid) for vehicle in flight.vehicles),
        notes,
        (folder.name,),
        (folder.name,) if was_simulated(folder) else (),
    )


def _logs(paths: Sequence[Path]) -> list[Path]:
    """Return the logs that are named, and all in the folders that are: of rounds, too, and of earlier flights."""
    found: dict[Path, None] = {}
    for path in paths:
        if not path.exists():
            raise MissionError(f"{path}: expected a telemetry log, or a folder with some, got nothing there")
        logs = sorted(path.rglob("*.tlog")) if path.is_dir() else [path]
        if not logs:
            raise MissionError(f"{path}: expected telemetry logs (.tlog), got a folder without any")
        found |= dict.fromkeys(logs)
    return list(found)


def _real(logs: Sequence[Path]) -> list[Path]:
    """Return the logs that are of no rehearsal, and tell of those left out.

    Raises
    ------
    MissionError
        All are of rehearsals.
    """
    from adapters.telemetry_log import is_simulated

    rehearsed = [log for log in logs if is_simulated(log)]
    real = [log for log in logs if log not in rehearsed]
    folders = list(dict.fromkeys(str(log.parent) for log in rehearsed))
    if rehearsed and not real:
        raise MissionError(
            f"--flown: expected flights of vehicles, got simulated ones only, which have inspected nothing (in "
            f"{', '.join(folders)}): plan without --flown, or count them with --simulated"
        )
    for at in folders:
        print(f"missionplanner: {at}: not counted: a simulated flight has inspected nothing", file=sys.stderr)
    return real


def _recorded(scene: Scene, logs: Sequence[Path]) -> Flights:
    """Return what logs show."""
    from adapters.flown_logs import read_tracks
    from adapters.telemetry_log import is_simulated

    names = {task.sysid: task.name for task in scene.tasks}
    flights = Flights()
    for flight in _by_folder(logs):
        tracks, notes = read_tracks(flight, scene.frame)
        targets = _targets(flight[0])
        at = str(flight[0].parent)
        flights += Flights(
            tuple(track.trajectory for track in tracks),
            tuple(names.get(track.sysid, f"sysid {track.sysid}") for track in tracks),
            tuple(track.photos for track in tracks),
            tuple(targets.get(names.get(track.sysid, "")) for track in tracks),
            notes,
            (at,),
            (at,) if any(map(is_simulated, flight)) else (),
        )
    return flights


def _targets(log: Path) -> dict[str, frozenset[str]]:
    """Return what vehicles were to look at, by name, where a log is that of the flight which its plan folder holds."""
    from missionplanner.plan_folder import FLIGHT_NAME, PLAN_NAME, planned_targets

    folder = log.resolve().parent.parent
    flown = log.parent.name == "logs" and (folder / FLIGHT_NAME).exists() and (folder / PLAN_NAME).exists()
    return {name: found for name, found in planned_targets(folder).items() if found} if flown else {}


def _by_folder(logs: Sequence[Path]) -> list[list[Path]]:
    """Return the logs that lie together: those of one flight, which repeat each other."""
    together: dict[Path, list[Path]] = {}
    for log in logs:
        if log.stat().st_size:
            together.setdefault(log.parent, []).append(log)
    return list(together.values())


def _seen_before(question: Mission, path: Path, logs: Sequence[Path]) -> frozenset[str]:
    """Return the targets that flights have seen from all sides asked for."""
    from missionplanner.inspection import open_scene

    try:
        scene = open_scene(question, path.parent)
    except MissionError as error:
        raise MissionError(f"{path}: {error}") from error
    flights = _recorded(scene, logs)
    for note in flights.notes:
        print(f"missionplanner: {note}", file=sys.stderr)
    return flights.measured(scene).done


def write_coverage(
    folder: Path, scene: Scene, found: Coverage, flights: Flights, planned: InspectionPlan | None
) -> dict[str, Path]:
    """Write what was seen as JSON and as a map and, of an inspection, its tables and report; return their paths."""
    import json

    from missionplanner.files import write_atomic
    from missionplanner.plan_folder import COVERAGE_NAME
    from missionplanner.report import write_inspection_report
    from missionplanner.report.coverage import coverage_map
    from missionplanner.report.style import to_png

    path = folder / COVERAGE_NAME
    document = found.as_json() | {"flights": list(flights.recorded), "simulated": list(flights.simulated)}
    write_atomic(path, json.dumps(document, indent=1, allow_nan=False) + "\n")
    files = {"coverage": path, "map": folder / "coverage.png"}
    write_atomic(files["map"], to_png(coverage_map(scene, found, flights.tracks)))
    if planned is not None:
        files |= write_towers(folder, planned, None if flights.simulated else found)
        files["report"] = write_inspection_report(folder, planned, found, flights.tracks, flights.simulated)
    return files


def write_towers(folder: Path, planned: InspectionPlan, seen: Coverage | None = None) -> dict[str, Path]:
    """Write who inspects which tower, and what of it was seen, as CSV and GeoJSON; return their paths.

    These tables are handed on by themselves: what was seen in rehearsals is not for them.
    """
    from adapters.tower_table import tower_rows, write_tower_table

    table, places = write_tower_table(folder, planned.scene.mission.name, tower_rows(planned, seen))
    return {"towers": table, "towers_geojson": places}


def report(folder: Path, report_round: WritePlan) -> Path:
    """Write the report of a whole inspection, and by ``report_round`` those of its rounds; return the page's path."""
    from missionplanner.inspection_folder import load_inspection
    from missionplanner.report import write_inspection_report

    planned = with_plans(load_inspection(folder), folder, report_round)
    flights = _latest_of(_plans(folder, planned))
    seen = flights.measured(planned.scene) if flights.tracks else None
    write_towers(folder, planned, None if flights.simulated else seen)
    return write_inspection_report(folder, planned, seen, flights.tracks, flights.simulated)


def _left_out_words(left_out: Sequence[Any]) -> str:
    told = [f"{left.target}: {left.why}" for left in left_out[:_TOLD]]
    more = len(left_out) - _TOLD
    return "; ".join([*told, *([f"and {more} more"] if more > 0 else [])])
