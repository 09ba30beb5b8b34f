"""The command line's side of inspections: planned, flown and shown round after round, and what was seen of them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.terminal import print_json, progress_bars, stderr, stdout

if TYPE_CHECKING:  # the planner takes a second to import
    from rich.progress import TaskID

    from missionplanner.certificate import Certificate
    from missionplanner.flight_check import FlightCheck
    from missionplanner.inspection import InspectionPlan, Round
    from missionplanner.mission import Mission
    from missionplanner.plan import FleetFlight, FleetPlan
    from missionplanner.scene import Scene

INSPECTION_NAME = "inspection.json"
_TOLD = 5

WritePlan = Callable[[Path, "Scene", "FleetPlan"], "FleetPlan"]
"""Writes a plan folder and what goes with it, refuses a plan that is not proven, and returns it with its proof."""


def is_inspection(folder: Path) -> bool:
    """Return whether a folder holds a whole inspection: rounds, each a plan folder of its own."""
    return (folder / INSPECTION_NAME).exists()


def refuse_whole(folder: Path, command: str) -> None:
    """Refuse an inspection where only one round of it can be meant.

    Raises
    ------
    MissionError
        It is one.
    """
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
    busy: str,
    write: WritePlan,
    as_json: bool,
) -> None:
    """Plan an open mission into a folder: all its rounds; of what logs show as inspected, nothing."""
    from missionplanner.files import ensure_writable

    if any(folder.resolve() == other.resolve() for other in flown):
        raise MissionError(f"--output: expected another folder than {folder}, whose flights are read: choose one")
    done = _seen_before(question, path, flown) if flown else frozenset()
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
    """Plan, with progress bars, and write everything; nothing is written where nothing is left to be done."""
    from missionplanner.inspection import plan_inspection
    from missionplanner.inspection_folder import save_inspection
    from missionplanner.warmup import begin

    compiling = begin()
    if compiling is not None:
        print("first run: compiling the kernels takes a minute, once", file=sys.stderr)
    with progress_bars() as progress:
        bars: dict[str, TaskID] = {}

        def watch(vehicle: str, done: float) -> None:
            if vehicle not in bars:
                bars[vehicle] = progress.add_task(f"planning {vehicle}", total=1.0)
            progress.update(bars[vehicle], completed=done)
            if compiling is not None and vehicle.endswith("round 1"):
                compiling.wait()  # what the other process compiles would be compiled twice

        try:
            planned = plan_inspection(question, path.parent, seed=seed, watch=watch, done=done)
        except MissionError as error:
            raise MissionError(f"{path}: {error}") from error
        except InfeasibleError as error:
            raise InfeasibleError(f"{path}: {error}") from error
    if not planned.rounds:
        return planned
    proven: list[Round] = []

    def save(at: Path, this: Round) -> None:
        proven.append(replace(this, plan=write(at, this.scene, this.plan)))

    with stderr.status("writing"):
        save_inspection(folder, planned, save)
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
    problems: list[str] = []
    for number, round_ in enumerate(planned.rounds, start=1):
        at = round_folder(folder, number)
        done = fly_round(at, round_.scene, round_.plan)
        flown.append(done)
        missing = [vehicle.name for vehicle in done.flight.vehicles if vehicle.arrival_s is None]
        if missing:
            problems.append(f"round {number}: {', '.join(missing)} never reached the goal: see {done.report}")
        if not done.check.ok:
            problems.append(f"round {number}: the flight did not keep every clearance: see {done.report}")
        if problems:
            break  # the next round begins when all have landed, and were flown as proven
    show(planned, folder, as_json, flown)
    return problems


def show(planned: InspectionPlan, folder: Path, as_json: bool, flown: Sequence[FlownRound] = ()) -> None:
    """Show an inspection as planned and, where it was, as flown."""
    from missionplanner.summary import inspection_lines, inspection_table, summarise_inspection

    summary = summarise_inspection(planned, [(f.flight, f.check) for f in flown])
    files = {"folder": str(folder), "inspection": str(folder / INSPECTION_NAME)}
    if as_json:
        print_json(summary | files)
        return
    stdout.print(inspection_table(summary))
    for line in [*inspection_lines(summary), *(f"{what}: {path}" for what, path in files.items())]:
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


def _seen_before(question: Mission, path: Path, flown: Sequence[Path]) -> frozenset[str]:
    raise NotImplementedError


def _left_out_words(left_out: Sequence[Any]) -> str:
    told = [f"{left.target}: {left.why}" for left in left_out[:_TOLD]]
    more = len(left_out) - _TOLD
    return "; ".join([*told, *([f"and {more} more"] if more > 0 else [])])
