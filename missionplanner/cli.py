"""The command line: parse, call, report. The only place that knows every package.

Exit codes: 0 done; 2 wrong input; 3 infeasible or unsafe; 4 link trouble. Machines read ``--json`` on stdout; people
read tables there, and progress and logs on stderr. Bugs still show a traceback.
"""

from __future__ import annotations

import json
import logging
import math
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager
from dataclasses import asdict, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.progress import Progress, TaskID

from missionplanner import experiment_commands, import_commands, inspection_commands
from missionplanner.errors import InfeasibleError, LinkError, MissionError, MissionPlannerError
from missionplanner.terminal import Told, planning_bars, print_json, progress_bars, stderr, stdout

if TYPE_CHECKING:  # the planner takes a second to import: commands that do without it should not wait
    from adapters.certificates import Held
    from adapters.endpoint import Endpoint
    from adapters.export import ExportOptions
    from adapters.fleet_flight import Request
    from adapters.fleet_link import Clock, FleetLink
    from adapters.sitl import SitlFleet
    from missionplanner.certificate import Certificate
    from missionplanner.flight_check import FlightCheck
    from missionplanner.inspection import InspectionPlan
    from missionplanner.inspection_commands import FlownRound
    from missionplanner.mission import Mission
    from missionplanner.plan import FleetFlight, FleetPlan, Ordered
    from missionplanner.planner import Watch
    from missionplanner.scene import Scene
    from sim.fleet import SimVehicle

app = typer.Typer(
    help="Plan, check, export, upload and fly missions for fleets of UAVs.",
    epilog="Exit codes: 0 done, 2 wrong input, 3 infeasible or unsafe, 4 link trouble.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.add_typer(experiment_commands.app, name="experiment")
app.command("import")(import_commands.import_maps)
app.command()(inspection_commands.cameras)
app.command()(inspection_commands.coverage)
FILES, LOGS, SITL = "files", "logs", "sitl"
_BUSY = (
    "expected a plan folder that nobody else uses, got one in which another plan, upload or fly is at work: wait for "
    "its end, or copy the folder"
)

MissionFile = Annotated[Path, typer.Argument(metavar="MISSION", help="mission file (YAML)")]
PlanFolder = Annotated[Path, typer.Argument(metavar="FOLDER", help="plan folder")]
Target = Annotated[Path, typer.Argument(metavar="FOLDER|MISSION", help="plan folder, or mission file to plan first")]
AsJson = Annotated[bool, typer.Option("--json", help="print JSON on stdout instead of tables")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="seed of the search; default: the mission's")]
Output = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="default: out/NAME of the mission")
]
Backup = Annotated[
    Path | None,
    typer.Option(
        "--backup", metavar="FOLDER", help="first save there what the vehicles hold: missions, fences, rally points"
    ),
]
Unproven = Annotated[
    bool, typer.Option("--unproven", help="send missions although they are not proven; it is told and logged")
]
ConnectUrls = Annotated[str, typer.Option("--connect", metavar="URL[,URL...]", help="links to the vehicles")]
SigningKey = Annotated[
    Path | None,
    typer.Option(
        "--signing-key",
        metavar="FILE",
        help="sign messages (MAVLink 2), and obey only signed ones: 32 bytes, or 64 hexadecimal digits",
    ),
]


_INTERRUPTED = 130
_OVER_HOME_M = 1.0


def _interrupted(ended: SystemExit) -> bool:
    """Return whether Ctrl-C ended a command: typer has turned that into an exit, with a code of its own in old ones."""
    ending = ended.__context__
    return isinstance(ending, typer.Exit | typer.Abort) and isinstance(ending.__cause__, KeyboardInterrupt)


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
    except Told:
        raise
    except SystemExit as ended:
        if _interrupted(ended):
            print("missionplanner: interrupted", file=sys.stderr)
            sys.exit(_INTERRUPTED)
        if ended.code == MissionError.exit_code and "--json" in sys.argv:  # wrong usage, told on stderr
            message = "expected the arguments and options that --help tells"
            print(json.dumps({"error": {"message": message, "exit_code": ended.code}}))
        raise


@app.command()
def validate(mission: MissionFile, as_json: AsJson = False) -> None:
    """Check a mission file, its terrain and places, without planning."""
    question = _question(mission)
    if question.is_open:
        inspection_commands.validate(question, mission, as_json)
        return
    scene = _scene_of(question, mission)
    if as_json:
        print_json({"mission": scene.mission.name, "vehicles": [t.name for t in scene.tasks], "valid": True})
    else:
        stdout.print(
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
    within: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", min=0.001, help="improve paths for so long; plans then differ from run to run"),
    ] = None,
    flown: Annotated[
        str | None,
        typer.Option(
            metavar="FOLDER|TLOG[,...]",
            help="of an inspection: plan only what the flights in these folders or logs did not see",
        ),
    ] = None,
    simulated: Annotated[
        bool, typer.Option("--simulated", help="with --flown: count rehearsals, too, as if they had inspected")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Plan a mission, prove it, and write plan.json, certificate.json and the files for ground stations.

    Of an inspection whose towers are to be shared out, every round of sorties is planned so, in a folder of its own.
    """
    from missionplanner.files import alone, ensure_writable

    question = _question(mission, algorithm)
    if simulated and flown is None:
        raise MissionError("--simulated: expected with --flown, whose rehearsals it counts")
    if question.is_open:
        if within is not None:
            raise MissionError("--within: expected with a mission whose vehicles have their stops, got an inspection")
        logs = [Path(part.strip()) for part in (flown or "").split(",") if part.strip()]
        if flown is not None and not logs:
            raise MissionError(f"--flown: expected folders or logs of flights, got {flown!r}")
        folder = output or _default_folder(question, "_rest" if logs else "")
        inspection_commands.plan(
            *(question, mission, folder),
            seed=seed,
            flown=logs,
            simulated=simulated,
            busy=_BUSY,
            write=_write,
            as_json=as_json,
        )
        return
    if flown is not None:
        raise MissionError(
            "--flown: expected with an inspection whose towers are to be shared out (inspection.assignment); a plan of "
            "one round goes on with the command resume"
        )
    scene = _scene_of(question, mission)
    folder = output or _default_folder(question)
    ensure_writable(folder)
    with alone(folder, _BUSY):
        fleet_plan = _plan(scene, folder, seed, within)
    _show(fleet_plan, folder, as_json)


@app.command()
def check(
    targets: Annotated[
        list[Path] | None,
        typer.Argument(metavar="FOLDER|FILE...", help="a plan folder; or, with --mission, .plan and .waypoints files"),
    ] = None,
    mission: Annotated[
        Path | None, typer.Option(metavar="MISSION", help="mission file that gives terrain, obstacles and vehicles")
    ] = None,
    connect: Annotated[
        str | None, typer.Option(metavar="URL[,URL...]", help="with --mission: check what the vehicles hold")
    ] = None,
    repair: Annotated[bool, typer.Option("--repair", help="move waypoints as little as a proof needs")] = False,
    output: Output = None,
    signing_key: SigningKey = None,
    as_json: AsJson = False,
) -> None:
    """Prove a plan, mission files of any origin, or what vehicles hold; exit code 3 where anything is not proven."""
    moves: list[dict[str, Any]] = []
    if mission is None:
        if not targets or len(targets) != 1 or not targets[0].is_dir():
            raise MissionError("check: expected one plan folder, or --mission MISSION and the files to check")
        if connect is not None or repair:
            raise MissionError(
                "--connect and --repair: expected with --mission; a plan folder is planned again instead"
            )
        if output is not None:
            raise MissionError("--output: expected with --mission; a plan folder's certificate and report stay in it")
        from missionplanner.plan_folder import is_inspection

        if is_inspection(targets[0]):
            problems = inspection_commands.check(targets[0], _check_folder, as_json)
            if problems:
                raise _verdict(f"not proven: {'; '.join(problems)}")
            return
        certificate, paths = _check_folder(targets[0])
    elif connect is not None:
        if targets or repair:
            raise MissionError("--connect: expected neither files nor --repair; download the missions first")
        certificate, paths = _check_vehicles(mission, connect, output, signing_key)
    elif targets:
        certificate, paths, moves = _check_files(mission, targets, output, repair=repair)
    else:
        raise MissionError("--mission: expected mission files (.plan, .waypoints) or --connect")
    if as_json:
        print_json(certificate.as_json() | {"moved": moves} | {name: str(path) for name, path in paths.items()})
    else:
        from missionplanner.summary import certificate_table, moves_table

        if repair:
            stdout.print(moves_table(moves))
        stdout.print(certificate_table(certificate))
        for name, path in paths.items():
            stdout.print(f"{name}: {path}", soft_wrap=True, highlight=False)
    if not certificate.proven:
        raise _verdict(f"not proven: {certificate.refusal}")


@app.command()
def export(
    folder: PlanFolder,
    output: Output = None,
    formats: Annotated[
        str,
        typer.Option(
            "--format", metavar="FORMAT[,FORMAT...]", help="of plan, waypoints, kml, geojson, dji (WPML), litchi (CSV)"
        ),
    ] = "plan,waypoints,kml,geojson",
    dji_aircraft: Annotated[
        str, typer.Option(metavar="NAME", help="that DJI routes are for, with its camera, e.g. m30t, m3e, m300-h20")
    ] = "m350-h20t",
    as_json: AsJson = False,
) -> None:
    """Write files of a plan that is proven, for ground stations, maps and other apps (default: FOLDER/files)."""
    from adapters.export import export_options
    from missionplanner.plan_folder import is_inspection

    options = export_options(formats, dji_aircraft)
    if is_inspection(folder):
        paths, remarks = inspection_commands.export(folder, lambda at, to: _export(at, to, options), output)
    else:
        paths, remarks = _export(folder, output or folder / FILES, options)
    if as_json:
        print_json({"files": [str(path) for path in paths], "remarks": remarks})
        return
    for path in paths:
        stdout.print(str(path), soft_wrap=True, highlight=False)
    for remark in remarks:
        _warn(remark)


@app.command()
def sim(
    home: Annotated[str, typer.Option(metavar="LAT,LON,ALT_AMSL_M", help="where the first vehicle stands")],
    vehicles: Annotated[int, typer.Option(min=1, max=250, help="how many; sysids from 1")] = 1,
    autopilot: Annotated[Literal["ardupilot", "px4"], typer.Option()] = "ardupilot",
    vehicle_class: Annotated[Literal["copter", "plane"], typer.Option("--class")] = "copter",
    spacing_m: Annotated[float, typer.Option(min=0.0, max=10_000.0, help="distance between homes, eastwards")] = 10.0,
    connect: Annotated[
        str | None, typer.Option(metavar="URL", help="all vehicles send there, e.g. udpout:127.0.0.1:14540")
    ] = None,
    listen: Annotated[
        str | None, typer.Option(metavar="URL", help="vehicle i listens on port + 10 (i - 1), e.g. tcp:127.0.0.1:5760")
    ] = None,
    speedup: Annotated[float, typer.Option(help="times real time")] = 1.0,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    loss: Annotated[float, typer.Option(min=0.0, max=1.0, help="share of frames lost, each way")] = 0.0,
    duplicate: Annotated[float, typer.Option(min=0.0, max=1.0, help="share of frames doubled")] = 0.0,
    reorder: Annotated[float, typer.Option(min=0.0, max=1.0, help="share of frames overtaken")] = 0.0,
    corrupt: Annotated[float, typer.Option(min=0.0, max=1.0, help="share of frames damaged")] = 0.0,
    delay_ms: Annotated[float, typer.Option(min=0.0, help="of every frame, in simulated time")] = 0.0,
    jitter_ms: Annotated[float, typer.Option(min=0.0, help="at most so much more delay, by chance")] = 0.0,
    baud: Annotated[int | None, typer.Option(min=1, help="rate of the radio, e.g. 57600; default: no limit")] = None,
    down: Annotated[
        list[str] | None, typer.Option(metavar="FROM_S,FOR_S", help="the link is down, in simulated time")
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(metavar="'vehicle N: FAULT'", help="a vehicle misbehaves, e.g. 'vehicle 2: reboot at item 5'"),
    ] = None,
    cold_start: Annotated[
        bool, typer.Option("--cold-start", help="vehicles get ready as slowly as after power-up")
    ] = False,
    signing_key: SigningKey = None,
) -> None:
    """Serve simulated vehicles to any ground station until interrupted."""
    from adapters.signing import signing_from
    from missionplanner.geodesy import GeoPoint
    from sim.faults import Faults, bad_links
    from sim.fleet import SimFleet, connect_fleet, listen_fleet, serve, sim_vehicles
    from sim.misbehaviour import faults_of

    if (connect is None) == (listen is None):
        raise MissionError("sim: expected exactly one of --connect and --listen")
    lat_deg, lon_deg, alt_amsl_m = _home(home)
    place = GeoPoint(lat_deg, lon_deg, alt_amsl_m)
    plain = sim_vehicles(vehicles, place, autopilot=autopilot, vehicle_class=vehicle_class, spacing_m=spacing_m)
    misbehaviour = faults_of(fault or [], [v.sysid for v in plain])
    fleet = SimFleet(
        [replace(v, faults=misbehaviour.get(v.sysid, ())) for v in plain], seed=seed, cold_start=cold_start
    )
    faults = Faults(
        loss, duplicate, reorder, corrupt, delay_ms / 1e3, jitter_ms / 1e3, baud, tuple(map(_down, down or []))
    )
    bad = bad_links(faults, lambda: fleet.now_s, seed) if faults != Faults() else lambda endpoint: endpoint
    signing = None if signing_key is None else signing_from(signing_key, time.time, _warn)

    def through(endpoint: Endpoint) -> Endpoint:
        return bad(endpoint) if signing is None else signing.sealed(bad(endpoint))

    try:
        connect_fleet(fleet, connect, through) if connect is not None else listen_fleet(fleet, str(listen), through)
        print(f"serving {vehicles} {autopilot} {vehicle_class}(s) on {connect or listen}; Ctrl-C ends", file=sys.stderr)
        serve(fleet, speedup)
    finally:
        fleet.close()
        if signing is not None:
            signing.save()


def _down(text: str) -> tuple[float, float]:
    """Return from when until when a link is down."""
    try:
        from_s, for_s = (float(part) for part in text.split(","))
    except ValueError:
        raise MissionError(f"--down: expected FROM_S,FOR_S, e.g. 30,10, got {text!r}") from None
    if not (0.0 <= from_s < math.inf and 0.0 <= for_s < math.inf):
        raise MissionError(f"--down: expected seconds from 0, got {text!r}")
    return from_s, from_s + for_s


def _home(text: str) -> tuple[float, float, float]:
    try:
        lat_deg, lon_deg, alt_amsl_m = (float(part) for part in text.split(","))
    except ValueError:
        raise MissionError(f"--home: expected LAT,LON,ALT_AMSL_M, e.g. 47.3977,8.5456,488, got {text!r}") from None
    if not (abs(lat_deg) <= 84 and abs(lon_deg) <= 180 and math.isfinite(alt_amsl_m)):
        raise MissionError(f"--home: expected latitude, longitude in degrees and altitude in metres, got {text!r}")
    return lat_deg, lon_deg, alt_amsl_m


@app.command()
def upload(
    target: Target,
    connect: ConnectUrls,
    output: Output = None,
    seed: Seed = None,
    unproven: Unproven = False,
    via: Annotated[
        Literal["pymavlink", "mavsdk"],
        typer.Option(help="whose protocol uploads missions, over the same links; what is held is read back by our own"),
    ] = "pymavlink",
    backup: Backup = None,
    signing_key: SigningKey = None,
    as_json: AsJson = False,
) -> None:
    """Upload a plan that is proven, read it back, prove what the vehicles hold; nothing is armed."""
    _expect_no_backup(backup)
    inspection_commands.refuse_whole(target, "upload")
    with (
        _proven_plan(target, output, seed, unproven=unproven) as (scene, fleet_plan, folder),
        _ground_station(scene, fleet_plan, folder, connect, None, signing_key, unproven=unproven) as link,
    ):
        _save_backup(link, backup)
        _transfer(link, scene, fleet_plan, unproven=unproven, via=via)
    if as_json:
        missions = [
            {
                "sysid": sysid,
                "items": len(items),
                "fence_items": len(link.guards[sysid].fence),
                "rally_points": len(link.guards[sysid].rally),
                "verified": True,
            }
            for sysid, items in link.items.items()
        ]
        print_json({"mission": fleet_plan.mission.name, "folder": str(folder), "vehicles": missions})
    else:
        for vehicle in fleet_plan.vehicles:
            stdout.print(f"{vehicle.name} (sysid {vehicle.sysid}): {len(link.items[vehicle.sysid])} items, verified")


@app.command()
def fly(
    target: Target,
    connect: Annotated[
        str | None, typer.Option(metavar="URL[,URL...]", help="links to the vehicles; default: built-in simulated ones")
    ] = None,
    speedup: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            help="simulated vehicles only: times real time; default: as fast as possible, with --sitl in real time",
        ),
    ] = None,
    sitl: Annotated[
        list[str] | None,
        typer.Option(
            metavar="AUTOPILOT=PROGRAM[,...]",
            help="real autopilot code in its makers' simulator, e.g. ardupilot=/path/to/arducopter,px4=/path/to/px4",
        ),
    ] = None,
    correct: Annotated[
        bool | None,
        typer.Option(
            "--correct/--no-correct",
            help="change speeds on the way so that all arrive together; default: the mission's fleet.correction",
        ),
    ] = None,
    sim_wind: Annotated[
        str | None,
        typer.Option(
            metavar="SPEED_M_S,FROM_DEG",
            help="rehearsal: simulated vehicles fly in wind that the plan does not know of",
        ),
    ] = None,
    sim_late: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=SECONDS", help="rehearsal: a simulated vehicle takes off so much later than told"),
    ] = None,
    output: Output = None,
    seed: Seed = None,
    unproven: Unproven = False,
    backup: Backup = None,
    signing_key: SigningKey = None,
    as_json: AsJson = False,
) -> None:
    """Plan if need be, upload, prove what the vehicles hold, start together, fly, keep together, and report.

    While they fly, keys pause (p), continue (c), return (R) or land (L) all; Ctrl-C asks what they shall do.
    """
    from adapters.sitl import SitlFleet
    from adapters.sitl_instances import sitl_programs
    from missionplanner.flight_check import check_flight
    from missionplanner.flight_console import fly_and_watch
    from missionplanner.pacing import pacer
    from missionplanner.plan_folder import save_flight
    from missionplanner.report import write_report
    from sim.fleet import planned_vehicles

    simulated_only = {
        "--speedup": speedup,
        "--sim-wind": sim_wind,
        "--sim-late": sim_late or None,
        "--sitl": sitl or None,
    }
    for option, value in simulated_only.items():
        if connect is not None and value is not None:
            raise MissionError(f"{option}: expected only with built-in simulated vehicles, not with --connect")
    if connect is None and signing_key is not None:
        raise MissionError("--signing-key: expected with --connect; built-in simulated vehicles are not on any link")
    if sitl and sim_late:
        raise MissionError("--sim-late: expected only with built-in simulated vehicles, not with --sitl")
    programs = sitl_programs(sitl) if sitl else None
    wind_m_s, late_s = _sim_wind(sim_wind), _sim_late(sim_late or [])
    _expect_no_backup(backup)

    def fly_round(folder: Path, scene: Scene, fleet_plan: FleetPlan, late_s: Mapping[str, float]) -> FlownRound:
        simulators = None
        if programs is not None:
            ground, pace = scene.terrain.height_amsl_m, 1.0 if speedup is None else speedup
            simulators = SitlFleet(
                fleet_plan, programs, folder / SITL, speedup=pace, ground=ground, wind_m_s=wind_m_s, tell=_warn
            )
        vehicles = planned_vehicles(fleet_plan, wind_m_s=wind_m_s, late_s=late_s)
        corrected = fleet_plan.mission.fleet.correction != "off" if correct is None else correct
        if connect is not None:
            _clock_start(fleet_plan, datetime.now(UTC))
        simulated = connect is None
        with _ground_station(
            *(scene, fleet_plan, folder, connect, speedup, signing_key),
            unproven=unproven,
            vehicles=vehicles,
            simulators=simulators,
        ) as link:
            _save_backup(link, backup)
            _transfer(link, scene, fleet_plan, unproven=unproven)
            try:
                keeps = pacer(scene, fleet_plan, correct=corrected)

                def start_s(tell: Callable[[str], None]) -> float | None:
                    return None if simulated else _start_on_clock(link, fleet_plan, tell)

                flight = fly_and_watch(link, fleet_plan, keeps, folder, simulated=simulated, start_s=start_s)
            finally:
                recorded = link.flight()
                if all(len(vehicle.trajectory.t_s) for vehicle in recorded.vehicles):
                    # also of a flight that ended badly: then it is wanted most
                    save_flight(folder, recorded, unproven=unproven, simulated=simulated)
        check = check_flight(scene, fleet_plan, flight)
        with stderr.status("writing the report"):
            report_path = write_report(folder, scene, fleet_plan, flight)
        return inspection_commands.FlownRound(flight, check, report_path)

    if _is_inspection(target):
        if connect is not None:
            inspection_commands.refuse_whole(target, "fly")
            raise MissionError(
                f"{target}: with --connect an inspection is flown a round at a time: plan it (missionplanner plan "
                f"{target}), then fly its folder's round-1 --connect {connect}, and so on"
            )
        with _proven_inspection(target, output, seed, unproven=unproven) as (planned, folder):
            inspection_commands.expect_vehicles("--sim-late", late_s, planned)

            def fly_on(at: Path, scene: Scene, fleet_plan: FleetPlan) -> FlownRound:
                own_s = {v.name: late_s[v.name] for v in fleet_plan.vehicles if v.name in late_s}
                return fly_round(at, scene, fleet_plan, own_s)

            problems = inspection_commands.fly(folder, planned, fly_on, as_json)
        if problems:
            raise _verdict(f"{folder}: {'; '.join(problems)}")
        return
    with _proven_plan(target, output, seed, unproven=unproven) as (scene, fleet_plan, folder):
        flown = fly_round(folder, scene, fleet_plan, late_s)
        flight, report_path = flown.flight, flown.report
        _show(fleet_plan, folder, as_json, flight, flown.check, report_path)
        told = {
            o.vehicle: f" (told to {o.order})" for o in flight.orders if o.result != "refused" and o.order != "resume"
        }
        missing = [v.name + told.get(v.name, "") for v in flight.vehicles if v.arrival_s is None]
        if missing:
            raise _verdict(f"{folder}: {', '.join(missing)} never reached the goal: see {report_path}")
        if not flown.check.ok:
            raise _verdict(f"{folder}: the flight did not keep every clearance: see {report_path}")


def _sim_wind(text: str | None) -> tuple[float, float] | None:
    """Return the velocity (east, north) of a wind given by its speed and where it comes from."""
    if text is None:
        return None
    try:
        speed_m_s, from_deg = (float(part) for part in text.split(","))
    except ValueError:
        raise MissionError(f"--sim-wind: expected SPEED_M_S,FROM_DEG, e.g. 5,270, got {text!r}") from None
    if not (0.0 <= speed_m_s <= 50.0 and math.isfinite(from_deg)):
        raise MissionError(f"--sim-wind: expected a speed from 0 to 50 m/s and a direction in degrees, got {text!r}")
    angle_rad = math.radians(from_deg)
    return -speed_m_s * math.sin(angle_rad), -speed_m_s * math.cos(angle_rad)


def _sim_late(texts: Sequence[str]) -> dict[str, float]:
    """Return by how much named vehicles take off late."""
    late_s: dict[str, float] = {}
    for text in texts:
        name, _, seconds = text.partition("=")
        try:
            late_s[name] = float(seconds)
        except ValueError:
            raise MissionError(f"--sim-late: expected NAME=SECONDS, e.g. uav1=10, got {text!r}") from None
        if not 0.0 <= late_s[name] <= 3600.0:
            raise MissionError(f"--sim-late: expected 0 to 3600 seconds, got {text!r}")
    return late_s


def _verdict(told: str) -> typer.Exit:
    """Return the exit that follows a bad verdict, told here; stdout has it already, as one document where asked for."""
    print(f"missionplanner: {told}", file=sys.stderr)
    return typer.Exit(InfeasibleError.exit_code)


@contextmanager
def _proven_plan(
    target: Path, output: Path | None, seed: int | None, *, unproven: bool
) -> Iterator[tuple[Scene, FleetPlan, Path]]:
    """Yield scene, plan and folder of a plan folder, or of a mission file, which is planned first; no other gets it.

    Two in one folder would write over each other's logs, and the orders for one would be taken by the other.
    """
    from missionplanner.files import alone, ensure_writable

    if target.is_dir():
        _expect_no_planning(target, output, seed)
    scene = None if target.is_dir() else _scene(target)
    folder = target if scene is None else output or _default_folder(scene.mission)
    if scene is not None:
        ensure_writable(folder)
    with alone(folder, _BUSY):
        if scene is None:
            yield *_load_proven(folder, unproven=unproven), folder
        else:
            yield scene, _plan(scene, folder, seed), folder


def _is_inspection(target: Path) -> bool:
    """Return whether a folder or mission file is an inspection of several rounds."""
    from missionplanner.plan_folder import is_inspection

    return is_inspection(target) if target.is_dir() else _question(target).is_open


@contextmanager
def _proven_inspection(
    target: Path, output: Path | None, seed: int | None, *, unproven: bool
) -> Iterator[tuple[InspectionPlan, Path]]:
    """Yield an inspection, of a folder or of a mission file, which is planned first; no other gets it, nor a round."""
    from missionplanner.files import ensure_writable
    from missionplanner.inspection_folder import load_inspection

    if target.is_dir():
        _expect_no_planning(target, output, seed)
        with inspection_commands.alone_in(target, _BUSY):
            planned = load_inspection(target)

            def certified(at: Path, scene: Scene, fleet_plan: FleetPlan) -> FleetPlan:
                return _certified(at, scene, fleet_plan, unproven=unproven)

            yield inspection_commands.with_plans(planned, target, certified), target
        return
    question = _question(target)
    folder = output or _default_folder(question)
    ensure_writable(folder)
    with inspection_commands.alone_in(folder, _BUSY):
        planned = inspection_commands.plan_into(question, target, folder, seed=seed, done=frozenset(), write=_write)
        yield planned, folder


def _expect_no_planning(folder: Path, output: Path | None, seed: int | None) -> None:
    if output is not None or seed is not None:
        raise MissionError(f"{folder}: is a plan already: --output and --seed go with a mission file")


@contextmanager
def _ground_station(
    scene: Scene,
    fleet_plan: FleetPlan,
    folder: Path,
    connect: str | None,
    speedup: float | None,
    signing_key: Path | None,
    *,
    unproven: bool,
    vehicles: Sequence[SimVehicle] = (),
    simulators: SitlFleet | None = None,
) -> Iterator[FleetLink]:
    """Connect to the fleet's vehicles, or to simulated ones that stand where the plan wants them; log what is said.

    Simulated are the built-in ``vehicles``, or those of the autopilots' own ``simulators``.
    """
    from adapters.endpoint import open_endpoint
    from adapters.fleet_link import FleetLink, WallClock
    from adapters.telemetry_log import SIMULATED, FleetLog
    from sim.fleet import LockstepClock, SimFleet, connect_fleet

    def ground(x_m: float, y_m: float) -> float:
        return scene.terrain.ground_amsl_m(x_m, y_m, "a simulated vehicle's landing place")

    with ExitStack() as stack:
        clock: Clock
        if connect is not None:
            endpoints = stack.enter_context(_links(connect, signing_key))
            clock = WallClock(endpoints)
        elif simulators is not None:
            stack.enter_context(simulators)
            with stderr.status("starting the autopilots") as status:
                simulators.start(lambda name, missing: status.update(f"{name}: {missing}"))
            fleet_plan, endpoints, clock = simulators.plan, simulators.endpoints, simulators.clock
        else:
            endpoints = [stack.enter_context(closing(open_endpoint("udpin:127.0.0.1:0")))]
            fleet = SimFleet(vehicles, frame=scene.frame, ground=ground, seed=fleet_plan.seed)
            stack.callback(fleet.close)
            connect_fleet(fleet, endpoints[0].url.replace("udpin", "udpout"))
            clock = LockstepClock(fleet, speedup)
        names = {vehicle.sysid: vehicle.name for vehicle in fleet_plan.vehicles}
        log = stack.enter_context(FleetLog(folder / LOGS, names, time.time() - clock.now_s()))
        if connect is None:
            log.note(clock.now_s(), SIMULATED)
        if unproven:
            log.note(clock.now_s(), "UNPROVEN mission sent by order of the operator")
        link = FleetLink(fleet_plan, endpoints, clock, log=log, home_tolerance_m=_home_tolerance_m(scene))
        with stderr.status("looking for the vehicles"):
            link.connect()
        yield link


def _home_tolerance_m(scene: Scene) -> float:
    """Return how far from its planned home a vehicle may stand: further off, its climb is not proven.

    Raises
    ------
    MissionError
        The mission allows for more than that.
    """
    proven_m = min(task.limits.tube_m for task in scene.tasks)
    asked_m = scene.mission.fleet.home_within_m
    if asked_m is not None and asked_m > proven_m:
        raise MissionError(
            f"fleet.home_within_m: expected at most {proven_m:g}, the radius of the tube that is proven, "
            f"got {asked_m:g}: raise position_error_m to prove more"
        )
    return proven_m if asked_m is None else asked_m


def _links(connect: str, signing_key: Path | None) -> AbstractContextManager[list[Endpoint]]:
    from adapters.signing import open_links

    return open_links(_urls(connect), signing_key, time.time, _warn)


def _warn(text: str) -> None:
    print(f"missionplanner: {text}", file=sys.stderr)


def _urls(connect: str) -> list[str]:
    urls = [url.strip() for url in connect.split(",") if url.strip()]
    if not urls:
        raise MissionError("--connect: expected at least one URL, e.g. udpin:0.0.0.0:14550, got none")
    return urls


def _expect_no_backup(folder: Path | None) -> None:
    """Refuse, before long work, a folder that a backup could not be written to."""
    from adapters.backup import expect_no_backup
    from missionplanner.files import ensure_writable

    if folder is not None:
        expect_no_backup(folder)
        ensure_writable(folder)


def _save_backup(link: FleetLink, folder: Path | None) -> None:
    from adapters.backup import write_backup

    if folder is None:
        return
    with progress_bars() as progress:
        saved = link.holdings(_transfer_bars(progress, "saving"))
    write_backup(folder, saved, datetime.now(UTC).isoformat(timespec="seconds"))
    _warn(f"what the vehicles held is in {folder}: restore it with missionplanner restore {folder} --connect URL")


def _transfer(
    link: FleetLink,
    scene: Scene,
    fleet_plan: FleetPlan,
    *,
    unproven: bool,
    via: Literal["pymavlink", "mavsdk"] = "pymavlink",
) -> None:
    """Compare parameters, upload all missions, read them back, prove what is held, and set the heights to return at."""
    from adapters.certificates import certify, held_by_vehicles

    _compare_parameters(link, unproven=unproven)
    with _said_when_interrupted(), progress_bars() as progress:
        link.upload(_transfer_bars(progress, "uploading"), via=via)
        link.verify(_transfer_bars(progress, "verifying"))
        certificate = certify(scene, held_by_vehicles(fleet_plan, link.held), arrival_s=fleet_plan.arrival_s)
        if not certificate.proven:
            problem = f"what the vehicles hold is not proven: {certificate.refusal}"
            if not unproven:
                raise InfeasibleError(f"{problem}; nothing was armed")
            _tell_unproven(problem)
        told = link.send_guards(_transfer_bars(progress, "fencing"))
        changes = link.set_returns(_transfer_bars(progress, "setting return of"))
    for remark in told:
        _warn(remark)
    for change in changes:
        _warn(f"{change}; it keeps that")


@contextmanager
def _said_when_interrupted() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        _warn("nothing was armed; vehicles may hold parts of missions: upload again before anybody flies them")
        raise


def _compare_parameters(link: FleetLink, *, unproven: bool) -> None:
    """Refuse vehicles that hold other parameters than their plans were made with: their flights would be others."""
    with stderr.status("reading the vehicles' parameters"):
        comparisons = link.compare_parameters()
    for comparison in comparisons:
        for told in comparison.absent:
            print(f"missionplanner: {told}", file=sys.stderr)
    problems = [comparison.problem for comparison in comparisons if comparison.problem is not None]
    if problems and unproven:
        _tell_unproven("; ".join(problems))
    elif problems:
        more = f" (and {len(problems) - 1} other vehicles: {'; '.join(problems[1:])})" if problems[1:] else ""
        raise LinkError(f"{problems[0]}{more}; nothing was uploaded")


def _transfer_bars(progress: Progress, what: str) -> Callable[[str, int, int], None]:
    bars: dict[str, TaskID] = {}

    def show(name: str, done: int, total: int) -> None:
        if name not in bars:
            bars[name] = progress.add_task(f"{what} {name}", total=total)
        progress.update(bars[name], completed=done)

    return show


def _start_on_clock(link: FleetLink, fleet_plan: FleetPlan, tell: Callable[[str], None]) -> float | None:
    """Return when, on the link's clock, the mission must start to arrive at ``fleet.arrival_utc``; None: at once."""
    start = _clock_start(fleet_plan, datetime.now(UTC))
    if start is None:
        return None
    tell(f"starts at {start:%H:%M:%S} UTC, as soon as all can be armed")
    return link.now_s + (start - datetime.now(UTC)).total_seconds()


def _clock_start(fleet_plan: FleetPlan, now: datetime) -> datetime | None:
    """Return when a mission with ``fleet.arrival_utc`` must start.

    Raises
    ------
    InfeasibleError
        That is past already: the message says the earliest arrival.
    """
    arrival, arrival_s = fleet_plan.mission.fleet.arrival_clock, fleet_plan.arrival_s
    if arrival is None or arrival_s is None:
        return None
    start = arrival - timedelta(seconds=arrival_s)
    if start < now:
        earliest = now + timedelta(seconds=math.ceil(arrival_s))
        what = "is past" if arrival <= now else f"is too soon: the fleet flies {arrival_s:.0f} s until then"
        raise InfeasibleError(
            f"fleet.arrival_utc: {arrival:%Y-%m-%d %H:%M:%S} UTC {what}; the earliest arrival, started now, is "
            f"{earliest:%Y-%m-%d %H:%M:%S} UTC, and preparing takes a minute or more"
        )
    return start


@app.command()
def command(
    order: Annotated[Literal["pause", "resume", "rtl", "land"], typer.Argument(help="what the vehicles shall do")],
    folder: PlanFolder,
    vehicle: Annotated[
        list[str] | None, typer.Option("--vehicle", metavar="NAME", help="only this one; may be repeated; default: all")
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(metavar="URL[,URL...]", help="straight to the vehicles; default: by the fly that watches them"),
    ] = None,
    unproven: Annotated[
        bool, typer.Option("--unproven", help="resume also who is off its way: the way back is not proven")
    ] = False,
    signing_key: SigningKey = None,
    as_json: AsJson = False,
) -> None:
    """Tell a flying fleet to pause, resume, return (rtl) or land; exit code 4 where one did not obey."""
    from adapters.fleet_flight import NOT_PROVEN, Request
    from adapters.order_box import give_order
    from missionplanner.flight_console import ORDERS_FOLDER
    from missionplanner.plan_folder import planned_names

    request = Request(order, frozenset(vehicle or ()), unproven)
    if request.vehicles:
        _expect_names(request.vehicles, planned_names(folder))
    if connect is None:
        outcomes = give_order(folder / ORDERS_FOLDER, request, time.sleep)
    else:
        outcomes = _command_vehicles(request, folder, connect, signing_key)
    _expect_names(request.vehicles, [outcome.vehicle for outcome in outcomes])
    if as_json:
        print_json({"orders": [asdict(outcome) for outcome in outcomes]})
    else:
        for outcome in outcomes:
            stdout.print(outcome.words, soft_wrap=True, highlight=False, markup=False)
    if any(outcome.result == "obeyed" for outcome in outcomes) and order == "pause":
        _warn(NOT_PROVEN)
    failed = [outcome.vehicle for outcome in outcomes if outcome.result in ("refused", "silent")]
    if failed:
        _warn(f"{order}: expected all to obey, {', '.join(failed)} did not: take over by hand")
        raise typer.Exit(LinkError.exit_code)


def _expect_names(names: Collection[str], known: Collection[str]) -> None:
    if unknown := [name for name in names if name not in known]:
        raise MissionError(f"--vehicle: expected vehicles of the plan, got {', '.join(sorted(unknown))}: none of them")


def _command_vehicles(request: Request, folder: Path, connect: str, signing_key: Path | None) -> tuple[Ordered, ...]:
    """Give an order as a ground station of our own; nobody is resumed who does not hold its mission."""
    from adapters.fleet_link import FleetLink, WallClock
    from missionplanner.plan_folder import load_plan

    scene, fleet_plan = load_plan(folder)
    with _links(connect, signing_key) as endpoints, stderr.status("looking for the vehicles"):
        link = FleetLink(fleet_plan, endpoints, WallClock(endpoints), home_tolerance_m=_home_tolerance_m(scene))
        return link.command(request)


@app.command()
def restore(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="backup, as upload and fly --backup write it")],
    connect: ConnectUrls,
    signing_key: SigningKey = None,
    as_json: AsJson = False,
) -> None:
    """Give vehicles back the missions, fences and rally points that a backup has of them, and read them back."""
    from adapters.backup import read_backup
    from adapters.backup import restore as give_back
    from adapters.fleet_link import WallClock

    vehicles = read_backup(folder)
    with _links(connect, signing_key) as endpoints, progress_bars() as progress:
        bars = _transfer_bars(progress, "restoring")
        try:
            sent = give_back(vehicles, endpoints, WallClock(endpoints), progress=bars)
        except KeyboardInterrupt as ended:
            _warn(str(ended) or "nothing was restored")
            raise
    if as_json:
        rows = [{"name": v.name, "sysid": v.sysid, "sent": sent[v.sysid], "verified": True} for v in vehicles]
        print_json({"backup": str(folder), "vehicles": rows})
        return
    for vehicle in vehicles:
        told = ", ".join(sent[vehicle.sysid]) or "nothing had changed"
        stdout.print(f"{vehicle.name} (sysid {vehicle.sysid}): {told}, verified", highlight=False)


@app.command()
def download(
    connect: ConnectUrls,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="where to; nothing there is replaced")
    ] = Path("download"),
    sysid: Annotated[
        list[int] | None, typer.Option(min=1, max=255, help="only this vehicle; may be repeated; default: all heard")
    ] = None,
    mission: Annotated[
        Path | None, typer.Option(metavar="MISSION", help="only this mission file's vehicles, by their names")
    ] = None,
    signing_key: SigningKey = None,
    as_json: AsJson = False,
) -> None:
    """Save what vehicles hold, fences and rally points too, as .plan and .waypoints files, and for restore."""
    from adapters.backup import expect_no_backup, write_backup
    from adapters.downloads import download as find
    from adapters.fleet_link import WallClock
    from adapters.listener import by_sysid
    from missionplanner.files import ensure_writable

    asked = None if mission is None else by_sysid(_mission(mission).vehicles)
    expect_no_backup(output, [vehicle.name for vehicle in (asked or {}).values()])
    ensure_writable(output)
    wanted = sysid or (None if asked is None else list(asked))
    with _links(connect, signing_key) as endpoints, progress_bars() as progress:
        bars = _transfer_bars(progress, "reading")
        found = find(endpoints, WallClock(endpoints), asked=asked, expected=wanted, progress=bars)
    homes = {vehicle.saved.sysid: vehicle.home for vehicle in found if vehicle.home is not None}
    saved_at = datetime.now(UTC).isoformat(timespec="seconds")
    paths = write_backup(output, [vehicle.saved for vehicle in found], saved_at, homes)
    for vehicle in found:
        for remark in vehicle.remarks:
            _warn(remark)
    if as_json:
        rows = [
            {
                "name": v.saved.name,
                "sysid": v.saved.sysid,
                "autopilot": v.saved.autopilot,
                "class": v.saved.vehicle_class,
                "items": len(v.saved.mission),
                "fence_items": len(v.saved.fence),
                "rally_points": len(v.saved.rally),
                "remarks": v.remarks,
            }
            for v in found
        ]
        print_json({"vehicles": rows, "files": [str(path) for path in paths]})
        return
    for v in (vehicle.saved for vehicle in found):
        stdout.print(
            f"{v.name} (sysid {v.sysid}, {v.autopilot} {v.vehicle_class}): {len(v.mission)} items, "
            f"{len(v.fence)} of a fence, {len(v.rally)} rally points",
            highlight=False,
        )
    for path in paths:
        stdout.print(str(path), soft_wrap=True, highlight=False)


@app.command()
def resume(
    target: Annotated[
        Path, typer.Argument(metavar="FOLDER|FILE", help="plan folder; or a mission file, with --mission")
    ],
    vehicle: Annotated[str, typer.Option("--vehicle", metavar="NAME", help="whose mission goes on")],
    item: Annotated[
        int | None,
        typer.Option(
            "--from", metavar="N", min=0, help="mission item to fly back to, as vehicles and ground stations count"
        ),
    ] = None,
    mission: Annotated[
        Path | None,
        typer.Option(
            metavar="MISSION", help="of a .plan or .waypoints: mission file with terrain, obstacles, vehicles"
        ),
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(metavar="TLOG|FOLDER", help="from where the leg begins that this flight was broken off on"),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="default: FOLDER_NAME_resumed")
    ] = None,
    seed: Seed = None,
    as_json: AsJson = False,
) -> None:
    """Plan how a vehicle goes on from a waypoint, after a change of batteries: a proven plan of its own to fly."""
    if mission is not None:
        if item is None or log is not None:
            raise MissionError("resume: expected --from with --mission, and no --log: it is of a plan folder's flight")
        _resume_file(target, mission, vehicle, item, output, seed, as_json=as_json)
    else:
        _resume_plan(target, vehicle, item, log, output, seed, as_json=as_json)


def _resume_plan(
    folder: Path,
    vehicle: str,
    item: int | None,
    log: Path | None,
    output: Path | None,
    seed: int | None,
    *,
    as_json: bool,
) -> None:
    from bisect import bisect_left

    import numpy as np

    from adapters.certificates import certify_plan
    from adapters.export import export_fleet
    from adapters.mission_items import plan_items
    from adapters.resuming import flown_items, item_left
    from adapters.telemetry_log import latest_flight
    from missionplanner.files import ensure_writable
    from missionplanner.plan_folder import PLAN_NAME, load_plan, save_certificate, save_plan
    from missionplanner.resuming import find_vehicle
    from missionplanner.resuming import resume as go_on

    if (item is None) == (log is None):
        raise MissionError("resume: expected exactly one of --from and --log")
    scene, fleet_plan = load_plan(folder)
    planned = find_vehicle(fleet_plan, vehicle)
    items = plan_items(planned, fleet_plan.frame)
    flown = flown_items(items, planned.autopilot)
    if log is not None and log.is_dir():  # a plan folder that was flown, or its logs
        flown_log = latest_flight(log / LOGS if (log / LOGS).is_dir() else log, [planned.sysid])
        if flown_log is None:
            raise MissionError(f"{log}: expected the log of a flight of {vehicle}, found none, nor of an earlier one")
        log = flown_log
    if log is not None:  # the leg that was being flown is flown again as a whole
        waypoint = bisect_left(flown, item_left(log, planned)) - 1
    else:
        assert item is not None
        waypoint = bisect_left(flown, item)
    if waypoint == len(flown) - 1 and np.hypot(*(planned.waypoints_m[-1] - planned.home_m)[:2]) < _OVER_HOME_M:
        waypoint = len(flown)  # from home to above home: no way
    if not 1 <= waypoint < len(flown):
        goal = f"its waypoints are items {flown[1]} to {flown[-1]}"
        early = "fly its own plan again" if waypoint < 1 else "nothing is left but its end"
        flown_to = "broken off before the first" if waypoint < 1 else "flown to the last"
        what = flown_to if log is not None else f"got {item}"
        raise MissionError(f"{vehicle}: {what}: {goal}: {early}")
    place = folder if folder.name else folder.resolve()
    target = output or place.with_name(f"{place.name}_{vehicle}_resumed")
    if (target / PLAN_NAME).exists():
        raise MissionError(f"{target}: expected a folder without a plan, got one: choose another with --output")
    ensure_writable(target)
    with _planning(f"planning the way to item {flown[waypoint]}") as watch:
        whole, rest = go_on(scene, fleet_plan, folder, vehicle, waypoint, seed=seed, watch=watch)
    certificate = certify_plan(whole, rest)
    if not certificate.proven:
        raise InfeasibleError(f"{vehicle}: not proven as sent: {certificate.refusal}; nothing was written")
    save_plan(target, whole, rest)
    save_certificate(target, certificate)
    export_fleet(rest, target / FILES)
    others = [v.name for v in fleet_plan.vehicles if v.name != vehicle]
    _warn(
        f"{vehicle} goes on from item {flown[waypoint]} of {folder}"
        + (f", broken off in {log}" if log is not None else "")
        + (f"; nothing is proven of {', '.join(others)}: they must not fly meanwhile" if others else "")
    )
    _show(replace(rest, certificate=certificate), target, as_json)


def _resume_file(
    path: Path, mission: Path, vehicle: str, item: int, output: Path | None, seed: int | None, *, as_json: bool
) -> None:
    from adapters.backup import expect_no_backup
    from adapters.certificates import certify
    from adapters.resuming import resume_file, write_files
    from missionplanner.files import ensure_writable

    folder = output or Path("out") / f"{path.stem}_resumed"
    expect_no_backup(folder, [vehicle])
    ensure_writable(folder)
    with _planning(f"planning the way to item {item}") as watch:
        scene, held = resume_file(_mission(mission), mission.parent, path, vehicle, item, seed=seed, watch=watch)
    certificate = certify(scene, [held])
    if not certificate.proven:
        raise InfeasibleError(f"{vehicle}: not proven: {certificate.refusal}; nothing was written")
    paths = write_files(scene, held, folder)
    paths += _write_check(folder, scene, [held], certificate).values()
    _warn(f"{vehicle} goes on from item {item} of {path}; nothing is proven of others: they must not fly meanwhile")
    _warn(f"{vehicle}: proven for a return at {held.return_height_m:.1f} m above home: set that on the vehicle")
    if as_json:
        print_json(certificate.as_json() | {"files": [str(written) for written in paths]})
        return
    for written in paths:
        stdout.print(str(written), soft_wrap=True, highlight=False)


@contextmanager
def _planning(what: str) -> Iterator[Watch]:
    with progress_bars() as progress:
        bar = progress.add_task(what, total=1.0)

        def watch(vehicle: str, done: float) -> None:
            del vehicle
            progress.update(bar, completed=done)

        yield watch


@app.command()
def parameters(
    connect: ConnectUrls,
    sysid: Annotated[int | None, typer.Option(min=1, max=255, help="only this vehicle; default: all heard")] = None,
    mission: Annotated[
        Path | None, typer.Option(metavar="MISSION", help="say what differs from what this mission file assumes")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="save them: .param, .parm or .params (QGroundControl)"),
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="all there are, not only those that decide its flight")] = (
        False
    ),
    signing_key: SigningKey = None,
    as_json: AsJson = False,
) -> None:
    """Read the parameters that decide how vehicles fly; with --mission, exit code 3 where they differ from it."""
    from adapters.fleet_link import WallClock
    from adapters.listener import by_sysid
    from adapters.vehicle_parameters import check_parameters, read_parameters
    from missionplanner.parameter_files import expect_suffix, write_parameters
    from missionplanner.summary import parameter_table

    if output is not None:
        expect_suffix(output)
    question = None if mission is None else _resolved(mission)
    asked = None if question is None else by_sysid(question.vehicles)
    expected = [sysid] if sysid is not None else None if asked is None else list(asked)
    with ExitStack() as stack:
        endpoints = stack.enter_context(_links(connect, signing_key))
        progress = stack.enter_context(progress_bars())
        found = read_parameters(
            endpoints,
            WallClock(endpoints),
            expected=expected,
            asked=asked,
            everything=everything,
            progress=_transfer_bars(progress, "reading"),
        )
    if output is not None and len(found) != 1:
        heard = ", ".join(map(str, found))
        raise MissionError(f"--output: expected one vehicle, heard sysids {heard}: choose one with --sysid")
    checked = check_parameters(found.values(), question)
    for vehicle in checked:
        for told in vehicle.absent:
            print(f"missionplanner: {told}", file=sys.stderr)
    if output is not None:
        held = next(iter(found.values()))
        values = {name: parameter.value for name, parameter in held.values.items()}
        types = {name: parameter.kind for name, parameter in held.values.items()}
        write_parameters(
            output, values, held.sysid, types, f"{held.autopilot} {held.vehicle_class}, sysid {held.sysid}"
        )
    rows = [vehicle.as_json(held) for vehicle, held in zip(checked, found.values(), strict=True)]
    if as_json:
        print_json({"vehicles": rows} | ({} if output is None else {"file": str(output)}))
    else:
        for row in rows:
            stdout.print(parameter_table(row))
        if output is not None:
            stdout.print(f"file: {output}", soft_wrap=True, highlight=False)
    problems = [vehicle.problem for vehicle in checked if vehicle.problem is not None]
    if problems:
        raise _verdict("; ".join(problems))


@app.command()
def report(folder: PlanFolder, as_json: AsJson = False) -> None:
    """Write FOLDER/report.html (proof, maps, profiles, the flight if flown), and a page for each vehicle's crew."""
    from missionplanner.plan_folder import is_inspection

    if is_inspection(folder):
        path = inspection_commands.report(folder, lambda at, scene, fleet_plan: _report(at, scene, fleet_plan)[0])
    else:
        from missionplanner.plan_folder import load_plan

        _, path = _report(folder, *load_plan(folder))
    print_json({"report": str(path)}) if as_json else stdout.print(str(path), soft_wrap=True, highlight=False)


@app.command()
def replay(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="TLOG...", help="telemetry logs, one per vehicle or of all; default: FOLDER/logs"),
    ] = None,
    plan_folder: Annotated[
        Path, typer.Option("--plan", metavar="FOLDER", help="plan folder whose missions were flown")
    ] = Path(),
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="default: replay in the plan folder")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Hold recorded flights against their plan: cross-track, along-track and time errors, arrivals, separation."""
    from adapters.flown_logs import read_flown
    from missionplanner.files import ensure_writable
    from missionplanner.plan_folder import load_plan
    from missionplanner.replay import replay as hold_against
    from missionplanner.replay import save_replay
    from missionplanner.report import write_replay

    if plan_folder == Path() and not (plan_folder / "plan.json").exists():
        raise MissionError("--plan: expected the plan folder whose missions were flown")
    _, fleet_plan = load_plan(plan_folder)
    paths = logs or _logs_of_flight(plan_folder / LOGS, [vehicle.sysid for vehicle in fleet_plan.vehicles])
    folder = output or plan_folder / "replay"
    found = read_flown(paths, fleet_plan)
    ensure_writable(folder)
    fleet = hold_against(fleet_plan, found.flown, found.reached_s)
    document = {"mission": fleet_plan.mission.name} | fleet.as_json() | found.as_json()
    with stderr.status("writing the report"):
        files = save_replay(folder, fleet, document)
        page = write_replay(
            folder,
            fleet_plan.mission,
            fleet,
            start=found.start_words,
            troubles=found.problems,
            remarks=found.notes,
        )
    files = {"report": page, **files}
    if as_json:
        print_json(document | {"files": {name: str(path) for name, path in files.items()}})
    else:
        from missionplanner.summary import replay_lines, replay_table

        stdout.print(replay_table(document))
        for line in [*replay_lines(document), *(f"{what}: {path}" for what, path in files.items())]:
            stdout.print(line, soft_wrap=True, highlight=False, markup=False)
    if not logs and paths[0].parent != plan_folder / LOGS:
        _warn(f"the latest flight is in {paths[0]}: nothing was flown since")
    for problem in found.problems:
        print(f"missionplanner: {problem}", file=sys.stderr)
    if found.problems:
        raise Told(MissionError.exit_code)


def _logs_of_flight(folder: Path, sysids: Sequence[int]) -> list[Path]:
    """Return the log of all vehicles' latest flight, or the vehicles' own logs; nothing may have been flown since."""
    from adapters.telemetry_log import MERGED, latest_flight

    merged = latest_flight(folder, sysids)
    if merged is not None:
        return [merged]
    paths = sorted(path for path in folder.glob("*.tlog") if path.name != MERGED)
    if not paths:
        raise MissionError(f"replay: expected telemetry logs (.tlog), got none, and none are in {folder}")
    return paths


@app.command()
def algorithms(as_json: AsJson = False) -> None:
    """List the search algorithms that --algorithm and the mission file's planner.algorithm take, with their sources."""
    from rich.table import Table

    from missionplanner.search.registry import algorithms as registered

    listed = registered()
    if as_json:
        print_json({"algorithms": [{"name": a.name, "title": a.title, "source": a.source} for a in listed]})
        return
    table = Table("name", "what", "source", box=None)
    for algorithm in listed:
        table.add_row(algorithm.name, algorithm.title, algorithm.source)
    stdout.print(table)


@app.command()
def schema() -> None:
    """Print the JSON Schema of the mission file."""
    from missionplanner.mission import mission_schema

    print_json(mission_schema())


def _mission(path: Path) -> Mission:
    from missionplanner.mission import load_mission

    return load_mission(path)


def _resolved(path: Path) -> Mission:
    """Load a mission file, with what its parameter files say."""
    from missionplanner.mission import with_parameter_files

    try:
        return with_parameter_files(_mission(path), path.parent)
    except MissionError as error:
        raise MissionError(f"{path}: {error}") from error


def _scene(path: Path) -> Scene:
    return _scene_of(_question(path), path)


def _question(path: Path, algorithm: str | None = None) -> Mission:
    """Load a mission file to be planned, perhaps by another algorithm than it says."""
    from missionplanner.search.registry import find_algorithm

    mission = _mission(path)
    if algorithm is not None:
        find_algorithm(algorithm)
        settings = mission.planner.model_copy(update={"algorithm": algorithm})
        mission = mission.model_copy(update={"planner": settings})
    try:
        find_algorithm(mission.planner.algorithm)
    except MissionError as error:
        raise MissionError(f"{path}: {error}") from error
    return mission


def _scene_of(question: Mission, path: Path) -> Scene:
    from missionplanner.scene import build_scene

    try:
        return build_scene(question, path.parent)
    except MissionError as error:
        raise MissionError(f"{path}: {error}") from error


def _default_folder(question: Mission, ending: str = "") -> Path:
    return Path("out") / f"{question.name}{ending}"


def _plan(scene: Scene, folder: Path, seed: int | None, within_s: float | None = None) -> FleetPlan:
    """Plan with progress bars, and write the plan, its certificate and its files."""
    from missionplanner.files import ensure_writable
    from missionplanner.plan_folder import is_inspection
    from missionplanner.planner import plan_fleet
    from missionplanner.warmup import begin

    ensure_writable(folder)
    compiling = begin()
    if compiling is not None:
        print("first run: compiling the kernels takes half a minute, once", file=sys.stderr)
    with planning_bars() as show_bar:

        def watch(vehicle: str, done: float) -> None:
            show_bar(vehicle, done)
            if compiling is not None and done >= 1.0:
                compiling.wait()  # flights come next: what the other process compiles would be compiled twice

        fleet_plan = plan_fleet(scene, seed=seed, watch=watch, seconds=within_s, clock=time.perf_counter)
    _clock_start(fleet_plan, datetime.now(UTC))
    if is_inspection(folder):  # an earlier one, of which this is not a round
        from missionplanner.inspection_folder import clear

        clear(folder)
    return _write(folder, scene, fleet_plan)


def _write(folder: Path, scene: Scene, fleet_plan: FleetPlan) -> FleetPlan:
    """Write a plan, its certificate and its files for ground stations; return it with what was proven of those."""
    from adapters.certificates import certify_plan
    from adapters.export import export_fleet, flyable
    from missionplanner.plan_folder import PLAN_NAME, save_certificate, save_plan

    again = (folder / PLAN_NAME).exists()
    save_plan(folder, scene, fleet_plan)
    certificate = certify_plan(scene, fleet_plan)
    save_certificate(folder, certificate)
    if not certificate.proven:  # the planner proved the same, rounded as on the wire: a bug, and never flown
        raise InfeasibleError(f"{folder}: not proven as exported: {certificate.refusal}")
    written = set(export_fleet(fleet_plan, folder / FILES))
    for path in (folder / FILES).iterdir():
        if again and flyable(path) and path not in written:
            path.unlink()  # of an earlier plan: nobody shall upload it by mistake
    return replace(fleet_plan, certificate=certificate)


def _export(folder: Path, target: Path, options: ExportOptions) -> tuple[list[Path], list[str]]:
    """Write a plan folder's files and return their paths, and what who flies them must know."""
    from adapters.certificates import certify_plan
    from adapters.export import export_fleet, export_remarks
    from missionplanner.plan_folder import load_plan

    scene, fleet_plan = load_plan(folder)
    certificate = certify_plan(scene, fleet_plan)
    if not certificate.proven:
        raise InfeasibleError(f"{folder}: not proven: {certificate.refusal}; nothing was written")
    return export_fleet(fleet_plan, target, options), export_remarks(fleet_plan, options)


def _report(folder: Path, scene: Scene, fleet_plan: FleetPlan) -> tuple[FleetPlan, Path]:
    """Write a plan's report, and a page for each vehicle's crew; return the plan with its proof, and the page."""
    from adapters.certificates import certify_plan
    from missionplanner.plan_folder import load_flight
    from missionplanner.report import write_report

    fleet_plan = replace(fleet_plan, certificate=certify_plan(scene, fleet_plan))
    flight = load_flight(folder, fleet_plan)
    return fleet_plan, write_report(folder, scene, fleet_plan, flight, vehicle_pages=True)


def _load_proven(folder: Path, *, unproven: bool) -> tuple[Scene, FleetPlan]:
    """Load a plan folder, prove its missions again, and refuse them unless its certificate covers just these.

    Nor may its files for ground stations say anything else. With ``unproven`` all is let through, in red.
    """
    from missionplanner.plan_folder import load_plan

    scene, fleet_plan = load_plan(folder)
    return scene, _certified(folder, scene, fleet_plan, unproven=unproven)


def _certified(folder: Path, scene: Scene, fleet_plan: FleetPlan, *, unproven: bool) -> FleetPlan:
    from adapters.certificates import certify_folder
    from missionplanner.plan_folder import uncertified

    certificate = certify_folder(scene, fleet_plan, folder / FILES)
    problem = uncertified(folder, certificate)
    if problem is not None and unproven:
        _tell_unproven(problem)
    elif problem is not None:
        raise InfeasibleError(f"{folder}: {problem}; nothing was sent")
    return replace(fleet_plan, certificate=certificate)


def _tell_unproven(problem: str) -> None:
    stderr.print(f"UNPROVEN: {problem}", style="bold red", soft_wrap=True, highlight=False, markup=False)


def _check_folder(folder: Path) -> tuple[Certificate, dict[str, Path]]:
    """Prove a plan folder as it lies there, edited files included, and write its certificate and report."""
    from adapters.certificates import certify_folder
    from missionplanner.plan_folder import load_flight, load_plan, save_certificate
    from missionplanner.report import write_report

    scene, fleet_plan = load_plan(folder)
    certificate = certify_folder(scene, fleet_plan, folder / FILES)
    path = save_certificate(folder, certificate)
    shown = replace(fleet_plan, certificate=certificate)
    report_path = write_report(folder, scene, shown, load_flight(folder, fleet_plan))
    return certificate, {"certificate": path, "report": report_path}


def _check_files(
    mission: Path, files: Sequence[Path], output: Path | None, *, repair: bool
) -> tuple[Certificate, dict[str, Path], list[dict[str, Any]]]:
    """Prove mission files of any origin over a mission's terrain and obstacles; repaired copies go to a folder."""
    from adapters.certificates import certify, read_files, with_return_heights
    from adapters.repaired_files import repaired

    scene, missions = read_files(_mission(mission), mission.parent, files)
    folder = output or Path("out") / f"check_{scene.mission.name}"
    moves: list[dict[str, Any]] = []
    if repair:
        missions, moved = repaired(scene, missions, folder)
        moves = [row.as_json() for row in moved]
    missions = with_return_heights(scene, missions)
    certificate = certify(scene, missions)
    return certificate, _write_check(folder, scene, missions, certificate), moves


def _check_vehicles(
    mission: Path, connect: str, output: Path | None, signing_key: Path | None
) -> tuple[Certificate, dict[str, Path]]:
    """Prove what vehicles hold."""
    from adapters.certificates import certify, read_vehicles
    from adapters.fleet_link import WallClock, download_missions
    from adapters.listener import by_sysid

    question = _mission(mission)
    with _links(connect, signing_key) as endpoints:
        asked = by_sysid(question.vehicles)
        with stderr.status("reading the vehicles' missions"):
            downloaded = download_missions(endpoints, WallClock(endpoints), expected=list(asked), asked=asked)
    scene, missions = read_vehicles(question, mission.parent, downloaded)
    certificate = certify(scene, missions)
    folder = output or Path("out") / f"check_{scene.mission.name}"
    return certificate, _write_check(folder, scene, missions, certificate)


def _write_check(folder: Path, scene: Scene, missions: Sequence[Held], certificate: Certificate) -> dict[str, Path]:
    from adapters.certificates import sortie
    from missionplanner.files import ensure_writable
    from missionplanner.plan_folder import save_certificate
    from missionplanner.report import write_check_report

    ensure_writable(folder)
    page = write_check_report(folder, scene, certificate, [sortie(scene, held) for held in missions])
    return {"certificate": save_certificate(folder, certificate), "report": page}


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
        print_json(summary | files)
        return
    stdout.print(vehicle_table(summary))
    for line in [*fleet_lines(summary), *(f"{what}: {path}" for what, path in files.items())]:
        stdout.print(line, soft_wrap=True, highlight=False, markup=False)
