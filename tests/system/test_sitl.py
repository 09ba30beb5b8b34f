"""``fly --sitl`` from end to end, with a stand-in that is started exactly as the autopilots' own simulators are."""

from __future__ import annotations

import fcntl
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from missionplanner.plan_folder import load_flight
from tests.command_line import Cli, expect_refusal
from tests.main_job import plan_into
from tests.scenes import copter, hilly, mission_file, question, scene_of

ROOT = Path(__file__).parents[2]
SPEEDUP = "8"
# what runs in a shell's background ignores Ctrl-C, and so would this
UNINTERRUPTED = """\
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from missionplanner.cli import main
main()
"""


@pytest.fixture
def ports() -> Iterator[None]:
    """Keep other tests from the simulators' ports, which are few and always the same."""
    with (Path(tempfile.gettempdir()) / "missionplanner-sitl-tests.lock").open("a") as lock:
        fcntl.lockf(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture
def programs(tmp_path: Path) -> dict[str, Path]:
    """The stand-in under the names of the real ones; PX4 in its build tree."""
    return {
        "arducopter": program(tmp_path / "bin" / "arducopter"),
        "px4": px4_build(tmp_path / "px4_sitl_default"),
    }


def program(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    stand_in = f'{sys.executable} {ROOT / "tests" / "sitl_stand_in.py"} {path.name} "$@"'
    path.write_text(f"#!/bin/sh\nPYTHONPATH={ROOT} exec {stand_in}\n")
    path.chmod(0o755)
    return path


def px4_build(tree: Path) -> Path:
    airframes = tree / "etc" / "init.d-posix" / "airframes"
    airframes.mkdir(parents=True)
    (tree / "etc" / "init.d-posix" / "rcS").touch()
    for name in ("10040_sihsim_quadx", "10041_sihsim_airplane"):
        (airframes / name).touch()
    return program(tree / "bin" / "px4")


def running(folder: Path) -> list[int]:
    """Return the processes that work in this folder or below it."""
    found = []
    for link in Path("/proc").glob("[0-9]*/cwd"):
        try:
            place = link.readlink()
        except OSError:  # gone, or nobody's business
            continue
        if place.is_relative_to(folder):
            found.append(int(link.parent.name))
    return found


def wait_for(condition: Callable[[], object], what: str) -> None:
    give_up_s = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < give_up_s, what
        time.sleep(0.02)


def fleet_of_three() -> dict[str, Any]:
    """Return a mission of an ArduCopter and two PX4 copters, on level ground."""
    px4 = {"autopilot": "px4"}
    return question(
        copter("alpha", (0, 0), (150, 0), sysid=3, uid="0123456789abcdef"),  # a real one's: no simulator has it
        copter("bravo", (0, 60), (150, 60), sysid=12, parameters={"MPC_XY_CRUISE": 6.0}, **px4),
        copter("charlie", (0, 120), (150, 120), sysid=2, **px4),
    )


@pytest.mark.slow
@pytest.mark.parametrize("older", [False, True])
def test_a_mixed_fleet_flies_as_planned(
    older: bool, cli: Cli, programs: dict[str, Path], tmp_path: Path, ports: None
) -> None:
    plan_into(tmp_path / "plan", scene_of(fleet_of_three()))
    if older:  # PX4 1.15's homes, and start-up scripts that take no parameters
        for name in ("whole_degrees", "no_environment"):
            (programs["px4"].parents[1] / "etc" / name).touch()
    sitl = f"ardupilot={programs['arducopter']},px4={programs['px4']}"
    done = cli("fly", tmp_path / "plan", "--sitl", sitl, "--speedup", SPEEDUP, "--json")
    assert done.code == 0, done.err
    assert done.json["fleet"]["flown_arrival_spread_s"] < 1.0
    for name in ("alpha", "bravo", "charlie"):
        assert (tmp_path / "plan" / "logs" / f"{name}.tlog").stat().st_size > 10_000
        assert (tmp_path / "plan" / "sitl" / name / "sitl.log").stat().st_size > 0
    assert "set " not in done.err  # all that could be was given to them before they began
    assert running(tmp_path / "plan") == []


@pytest.mark.slow
def test_one_that_does_not_keep_pace_is_waited_for_and_told(
    cli: Cli, programs: dict[str, Path], tmp_path: Path, ports: None
) -> None:
    plan_into(tmp_path / "plan", scene_of(question()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STAND_IN_PACE", "2:0.4")
        done = cli("fly", tmp_path / "plan", "--sitl", programs["arducopter"], "--speedup", "10", "--json")
    assert done.code == 0, done.err
    assert done.json["fleet"]["flown_arrival_spread_s"] < 1.0  # each by its own clock
    assert "times real time" in done.err


@pytest.mark.slow
def test_over_a_hill_it_lands_where_the_mission_has_the_ground(
    cli: Cli, programs: dict[str, Path], tmp_path: Path, ports: None
) -> None:
    scene = scene_of(hilly(tmp_path), tmp_path)
    plan = plan_into(tmp_path / "plan", scene)
    goal_m = plan.vehicles[0].waypoints_m[-1]
    ground_m = scene.terrain.ground_amsl_m(goal_m[0], goal_m[1], "goal")
    assert abs(ground_m - plan.vehicles[0].home_m[2]) > 20.0
    sitl = f"ardupilot={programs['arducopter']}"
    done = cli("fly", tmp_path / "plan", "--sitl", sitl, "--speedup", SPEEDUP, "--json")
    assert done.code == 0, done.err
    flown = load_flight(tmp_path / "plan", plan)
    assert flown is not None
    (vehicle,) = flown.vehicles
    assert vehicle.trajectory.position_m[-1] == pytest.approx([*goal_m[:2], ground_m], abs=2.0)
    assert "SIM_TERRAIN 1" in (tmp_path / "plan" / "sitl" / "alpha" / "defaults.parm").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("crash_s", [2.0, 75.0])
def test_when_one_crashes_it_is_told_and_nothing_is_left(
    crash_s: float, cli: Cli, programs: dict[str, Path], tmp_path: Path, ports: None
) -> None:
    plan_into(tmp_path / "plan", scene_of(question()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STAND_IN_CRASH", f"2:{crash_s}")
        done = cli("fly", tmp_path / "plan", "--sitl", programs["arducopter"], "--speedup", SPEEDUP, "--json")
    assert done.code == 4
    last = done.err.splitlines()[-1]  # of what was told of the flight
    assert last.startswith("missionplanner: bravo: its simulator ended with exit code 1")
    for part in ("Floating point exception", "bravo/sitl.log", "all others were stopped"):
        assert part in last
    assert done.json == {"error": {"message": last.removeprefix("missionplanner: "), "exit_code": 4}}
    assert running(tmp_path / "plan") == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_however_it_ends_no_simulator_is_left(
    number: int, code: int, programs: dict[str, Path], tmp_path: Path, ports: None
) -> None:
    plan_into(tmp_path / "plan", scene_of(question()))
    arguments = ["fly", str(tmp_path / "plan"), "--speedup", "2", "--sitl", str(programs["arducopter"])]
    log = tmp_path / "said.txt"
    with log.open("wb") as said_to:
        process = subprocess.Popen([sys.executable, "-c", UNINTERRUPTED, *arguments], cwd=ROOT, stderr=said_to)
    try:
        wait_for(lambda: len(running(tmp_path / "plan")) == 2, "two simulators")
        time.sleep(3.0)
        process.send_signal(number)
        process.wait(30.0)
    finally:
        process.kill()
        process.wait()
    said = log.read_bytes()
    assert process.returncode == code
    assert number == signal.SIGKILL or b"all 2 simulators were stopped" in said
    wait_for(lambda: running(tmp_path / "plan") == [], "none is left")


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--sitl", "ardupilot=/nowhere/arducopter"], "there is no such file"),
        (["--sitl", "arduhelicopter={program}"], "AUTOPILOT=PROGRAM"),
        (["--sitl", "ardupilot={program}", "--connect", "tcp:127.0.0.1:5760"], "not with --connect"),
        (["--sitl", "ardupilot={program}", "--sim-late", "alpha=3"], "not with --sitl"),
    ],
)
def test_wrong_options_are_told_before_anything_is_planned(
    options: list[str], expected: str, cli: Cli, programs: dict[str, Path], tmp_path: Path
) -> None:
    told = [option.format(program=programs["arducopter"]) for option in options]
    done = cli("fly", mission_file(tmp_path, question()), *told)
    expect_refusal(done, 2, expected)
    assert not (tmp_path / "out").exists()


def test_a_vehicle_without_a_program_is_told(cli: Cli, programs: dict[str, Path], tmp_path: Path) -> None:
    plan_into(tmp_path / "plan", scene_of(fleet_of_three()))
    done = cli("fly", tmp_path / "plan", "--sitl", f"ardupilot={programs['arducopter']}")
    expect_refusal(done, 2, "bravo (px4 copter)", "px4-copter=/path/to/px4")
    assert not (tmp_path / "plan" / "sitl").exists()
