"""The command line: parse, call, report. The only place that knows every package.

Exit codes: 0 done; 2 wrong input; 3 infeasible or unsafe; 4 link trouble. Machines read ``--json`` on stdout; people
read tables there, and progress and logs on stderr. Bugs still show a traceback.
"""

from __future__ import annotations

import json
import logging
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from missionplanner.errors import InfeasibleError, MissionError, MissionPlannerError

if TYPE_CHECKING:  # the planner takes a second to import: commands that do without it should not wait
    from missionplanner.plan import FleetFlight, FleetPlan
    from missionplanner.proof import FlightCheck
    from missionplanner.scene import Scene

app = typer.Typer(
    help="Plan, check, export, upload and fly missions for fleets of UAVs.",
    epilog="Exit codes: 0 done, 2 wrong input, 3 infeasible or unsafe, 4 link trouble.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_stdout = Console()
_stderr = Console(stderr=True)

MissionFile = Annotated[Path, typer.Argument(metavar="MISSION", help="mission file (YAML)")]
PlanFolder = Annotated[Path, typer.Argument(metavar="FOLDER", help="plan folder")]
Target = Annotated[Path, typer.Argument(metavar="FOLDER|MISSION", help="plan folder, or mission file to plan first")]
AsJson = Annotated[bool, typer.Option("--json", help="print JSON on stdout instead of tables")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="seed of the search; default: the mission's")]
Output = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="default: out/NAME of the mission")
]
ConnectUrls = Annotated[str, typer.Option("--connect", metavar="URL[,URL...]", help="links to the vehicles")]


def main() -> None:
    """Run the command line and turn our errors into one line and an exit code."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    try:
        app()
    except MissionPlannerError as error:
        print(f"missionplanner: {error}", file=sys.stderr)
        if "--json" in sys.argv:
            print(json.dumps({"error": {"message": str(error), "exit_code": error.exit_code}}))
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        print("missionplanner: interrupted", file=sys.stderr)
        sys.exit(130)


@app.command()
def validate(mission: MissionFile, as_json: AsJson = False) -> None:
    """Check a mission file, its terrain and places, without planning."""
    scene = _scene(mission)
    if as_json:
        _print_json({"mission": scene.mission.name, "vehicles": [t.name for t in scene.tasks], "valid": True})
    else:
        _stdout.print(
            f"{mission}: {scene.mission.name} is sound: {len(scene.tasks)} vehicles, "
            f"{len(scene.obstacles.names)} obstacles, terrain {scene.terrain.description}",
            soft_wrap=True,
        )


@app.command()
def plan(
    mission: MissionFile,
    output: Output = None,
    seed: Seed = None,
    algorithm: Annotated[str | None, typer.Option(help="search algorithm; default: the mission's")] = None,
    as_json: AsJson = False,
) -> None:
    """Plan a mission: check it, and write plan.json and the files for ground stations."""
    scene = _scene(mission, algorithm)
    folder = output or _default_folder(scene)
    fleet_plan = _plan(scene, folder, seed)
    _show(fleet_plan, folder, as_json)


@app.command()
def export(folder: PlanFolder, output: Output = None, as_json: AsJson = False) -> None:
    """Write .plan, .waypoints, KML and GeoJSON of a plan that is safe (default: FOLDER/files)."""
    from adapters.export import export_fleet

    _, fleet_plan = _load_safe(folder)
    paths = export_fleet(fleet_plan, output or folder / FILES)
    if as_json:
        _print_json({"files": [str(path) for path in paths]})
    else:
        for path in paths:
            _stdout.print(str(path), soft_wrap=True, highlight=False)


@app.command()
def sim(
    home: Annotated[str, typer.Option(metavar="LAT,LON,ALT_AMSL_M", help="where the first vehicle stands")],
    vehicles: Annotated[int, typer.Option(min=1, max=250, help="how many; sysids from 1")] = 1,
    autopilot: Annotated[Literal["ardupilot", "px4"], typer.Option()] = "ardupilot",
    vehicle_class: Annotated[Literal["copter", "plane"], typer.Option("--class")] = "copter",
    spacing_m: Annotated[float, typer.Option(min=0.0, help="distance between homes, eastwards")] = 10.0,
    connect: Annotated[
        str | None, typer.Option(metavar="URL", help="all vehicles send there, e.g. udpout:127.0.0.1:14540")
    ] = None,
    listen: Annotated[
        str | None, typer.Option(metavar="URL", help="vehicle i listens on port + 10 (i - 1), e.g. tcp:127.0.0.1:5760")
    ] = None,
    speedup: Annotated[float, typer.Option(help="times real time")] = 1.0,
    seed: Annotated[int, typer.Option(min=0)] = 1,
) -> None:
    """Serve simulated vehicles to any ground station until interrupted."""
    from missionplanner.geodesy import GeoPoint
    from sim.fleet import SimFleet, connect_fleet, listen_fleet, serve, sim_vehicles

    if (connect is None) == (listen is None):
        raise MissionError("sim: expected exactly one of --connect and --listen")
    lat_deg, lon_deg, alt_amsl_m = _home(home)
    place = GeoPoint(lat_deg, lon_deg, alt_amsl_m)
    fleet = SimFleet(
        sim_vehicles(vehicles, place, autopilot=autopilot, vehicle_class=vehicle_class, spacing_m=spacing_m), seed=seed
    )
    try:
        connect_fleet(fleet, connect) if connect is not None else listen_fleet(fleet, str(listen))
        print(f"serving {vehicles} {autopilot} {vehicle_class}(s) on {connect or listen}; Ctrl-C ends", file=sys.stderr)
        serve(fleet, speedup)
    finally:
        fleet.close()


def _home(text: str) -> tuple[float, float, float]:
    try:
        lat_deg, lon_deg, alt_amsl_m = (float(part) for part in text.split(","))
    except ValueError:
        raise MissionError(f"--home: expected LAT,LON,ALT_AMSL_M, e.g. 47.3977,8.5456,488, got {text!r}") from None
    if not (abs(lat_deg) <= 84 and abs(lon_deg) <= 180 and math.isfinite(alt_amsl_m)):
        raise MissionError(f"--home: expected latitude, longitude in degrees and altitude in metres, got {text!r}")
    return lat_deg, lon_deg, alt_amsl_m


@app.command()
def report(folder: PlanFolder, as_json: AsJson = False) -> None:
    """Write FOLDER/report.html: maps, profiles, separation, arrival windows, convergence, and the flight if flown."""
    from missionplanner.plan_folder import load_flight, load_plan
    from missionplanner.report import write_report

    scene, fleet_plan = load_plan(folder)
    path = write_report(folder, scene, fleet_plan, load_flight(folder, fleet_plan))
    _print_json({"report": str(path)}) if as_json else _stdout.print(str(path), soft_wrap=True, highlight=False)


@app.command()
def schema() -> None:
    """Print the JSON Schema of the mission file."""
    from missionplanner.mission import mission_schema

    _print_json(mission_schema())


FILES = "files"


def _scene(path: Path, algorithm: str | None = None) -> Scene:
    from missionplanner.mission import load_mission
    from missionplanner.scene import build_scene

    mission = load_mission(path)
    if algorithm is not None:
        from missionplanner.search.registry import find_algorithm

        find_algorithm(algorithm)
        settings = mission.planner.model_copy(update={"algorithm": algorithm})
        mission = mission.model_copy(update={"planner": settings})
    return build_scene(mission, path.parent)


def _default_folder(scene: Scene) -> Path:
    return Path("out") / scene.mission.name


def _plan(scene: Scene, folder: Path, seed: int | None) -> FleetPlan:
    """Plan with progress bars, and write the plan and its files."""
    from adapters.export import export_fleet
    from missionplanner.files import ensure_writable
    from missionplanner.plan_folder import save_plan
    from missionplanner.planner import plan_fleet

    ensure_writable(folder)
    with _progress() as progress:
        bars: dict[str, Any] = {}

        def watch(vehicle: str, done: float) -> None:
            if vehicle not in bars:
                bars[vehicle] = progress.add_task(f"planning {vehicle}", total=1.0)
            progress.update(bars[vehicle], completed=done)

        fleet_plan = plan_fleet(scene, seed=seed, watch=watch)
    save_plan(folder, scene, fleet_plan)
    export_fleet(fleet_plan, folder / FILES)
    return fleet_plan


def _load_safe(folder: Path) -> tuple[Scene, FleetPlan]:
    """Load a plan folder and refuse a plan that does not pass every check."""
    from missionplanner.plan_folder import load_plan
    from missionplanner.proof import unsafe

    scene, fleet_plan = load_plan(folder)
    reasons = unsafe(scene, fleet_plan)
    if reasons:
        raise InfeasibleError(f"{folder}: not safe to fly: {'; '.join(reasons)}: plan the mission again")
    return scene, fleet_plan


def _show(
    fleet_plan: FleetPlan,
    folder: Path,
    as_json: bool,
    flight: FleetFlight | None = None,
    check: FlightCheck | None = None,
    report_path: Path | None = None,
) -> None:
    from missionplanner.summary import fleet_lines, summarise, vehicle_table

    summary = summarise(fleet_plan, flight, check)
    files = {"folder": str(folder), "plan": str(folder / "plan.json"), "files": str(folder / FILES)}
    if report_path is not None:
        files["report"] = str(report_path)
    if as_json:
        _print_json(summary | files)
        return
    _stdout.print(vehicle_table(summary))
    for line in [*fleet_lines(summary), *(f"{what}: {path}" for what, path in files.items())]:
        _stdout.print(line, soft_wrap=True, highlight=False)


def _progress() -> Progress:
    columns = (
        TextColumn("{task.description:<22}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=_stderr, transient=not _stderr.is_terminal)


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, allow_nan=False))
