"""Simulators of autopilots' makers: how they are started, whose time counts, and that none is left behind."""

from __future__ import annotations

import fcntl
import math
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters import sitl
from adapters.sitl import SitlClock, SitlError, SitlFleet, terrain_data
from adapters.sitl_instances import Instance, Programs, free_numbers, sitl_instances, sitl_programs
from missionplanner.autopilot_parameters import held
from missionplanner.errors import LinkError, MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.plan import FleetPlan
from tests.plans import FRAME, fleet_plan, vehicle_plan

COPTER, PLANE = ("ardupilot", "copter"), ("ardupilot", "plane")
HOME_M = (0.0, 0.0, 1190.0)
ABOVE_M = ((0.0, 0.0, 1230.0), (120.0, 40.0, 1251.25))


def level_plan(*kinds: tuple[Any, Any], sysids: tuple[int, ...] = (), **changes: Any) -> FleetPlan:
    """Return a plan of vehicles that fly over level ground at 1190 m."""
    return fleet_plan(
        *(
            vehicle_plan(
                f"uav{sysid}",
                sysid,
                autopilot=autopilot,
                vehicle_class=vehicle_class,
                end="land" if vehicle_class == "copter" else "rtl",
                **{"home_m": HOME_M, "waypoints_m": ABOVE_M} | changes,
            )
            for (autopilot, vehicle_class), sysid in zip(kinds, sysids or range(1, len(kinds) + 1), strict=True)
        )
    )


def script(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@pytest.fixture
def programs(tmp_path: Path) -> Programs:
    names = ("arducopter", "arduplane", "px4")
    paths = {name: script(tmp_path / "bin", name, "exit 0") for name in names}
    return sitl_programs([",".join(map(str, paths.values()))])


@pytest.fixture
def ports() -> Iterator[None]:
    """Keep other tests from the simulators' ports, which are few and always the same."""
    with (Path(tempfile.gettempdir()) / "missionplanner-sitl-tests.lock").open("a") as lock:
        fcntl.lockf(lock, fcntl.LOCK_EX)
        yield


def option(instance: Instance, name: str) -> str:
    return instance.command[instance.command.index(name) + 1]


# -- what --sitl says ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "name", "kinds"),
    [
        ("ardupilot=", "arducopter", [COPTER]),
        ("ardupilot=", "my-build", [COPTER]),
        ("ardupilot=", "arduplane", [PLANE]),
        ("ArduPlane=", "x", [PLANE]),
        ("ardupilot-plane=", "x", [PLANE]),
        ("", "arducopter.bin", [COPTER]),
        ("", "px4", [("px4", "copter"), ("px4", "plane")]),
        ("px4-plane=", "x", [("px4", "plane")]),
    ],
)
def test_a_program_is_for_the_vehicles_that_key_or_name_tell(
    key: str, name: str, kinds: list[Any], tmp_path: Path
) -> None:
    path = script(tmp_path, name, "")
    assert sitl_programs([f"{key}{path}"]) == dict.fromkeys(kinds, path)


def test_programs_are_found_relative_to_here_and_by_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = script(tmp_path, "build/arducopter", "")
    monkeypatch.chdir(tmp_path)
    assert sitl_programs(["ardupilot=build/arducopter"]) == {COPTER: path}
    monkeypatch.setenv("PATH", str(path.parent))
    assert sitl_programs(["arducopter"]) == {COPTER: path}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ardupilot=", "got none"),
        ("ardupilot=/nowhere/arducopter", "there is no such file"),
        ("ardupilot={folder}", "it is a folder"),
        ("px4={folder}/tree", "it is a folder: take {folder}/tree/build/px4_sitl_default/bin/px4"),
        ("ardupilot={folder}/plain", "chmod +x"),
        ("ardupilto={folder}/run", "ardupilto"),
        ("{folder}/run", "AUTOPILOT=PROGRAM"),
        ("ardupilot={folder}/run,arducopter={folder}/other", "one program for ardupilot copter"),
    ],
)
def test_programs_that_cannot_be_run_are_refused(text: str, expected: str, tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    for name in ("run", "other"):
        script(tmp_path, name, "")
    script(tmp_path, "tree/build/px4_sitl_default/bin/px4", "")
    with pytest.raises(MissionError, match="--sitl") as refused:
        sitl_programs([text.format(folder=tmp_path)])
    assert expected.format(folder=tmp_path) in str(refused.value)


# -- how they are started --------------------------------------------------------------------------------------------


def test_an_arducopter_is_started_as_its_command_line_wants_it(programs: Programs, tmp_path: Path) -> None:
    plan = level_plan(COPTER, PLANE, sysids=(7, 9))
    copter, plane = sitl_instances(plan, programs, tmp_path / "sitl", speedup=2.5)
    assert copter.command[0] == str(programs[COPTER])
    assert (option(copter, "--model"), option(plane, "--model")) == ("quad", "plane")
    assert (option(copter, "-I"), option(plane, "-I")) == ("0", "1")
    assert (option(copter, "--sysid"), option(plane, "--sysid")) == ("7", "9")
    assert option(copter, "--speedup") == "2.5"
    assert option(copter, "--defaults") == str((tmp_path / "sitl" / "uav7" / "defaults.parm").absolute())
    assert (copter.url, plane.url) == ("tcp:127.0.0.1:5760", "tcp:127.0.0.1:5770")
    assert plane.ports == (("tcp", 5770), ("tcp", 5772), ("tcp", 5773), ("udp", 5511))
    assert copter.folder != plane.folder
    assert copter.environment == {"SITL_PANIC_EXIT": "1"}


@given(x_m=st.floats(-5e3, 5e3), y_m=st.floats(-5e3, 5e3), alt_m=st.floats(-400, 5e3))
def test_homes_are_told_to_the_centimetre(x_m: float, y_m: float, alt_m: float) -> None:
    home_m = (x_m, y_m, alt_m)
    waypoints_m = ((x_m, y_m, alt_m + 30.0), (x_m + 50.0, y_m + 50.0, alt_m + 30.0))
    plan = level_plan(COPTER, ("px4", "copter"), home_m=home_m, waypoints_m=waypoints_m)
    programs = dict.fromkeys([COPTER, ("px4", "copter")], Path("/bin/true"))
    ardupilot, px4 = sitl_instances(plan, programs, Path("/tmp"))
    (whole,) = sitl_instances(plan, programs, Path("/tmp"), whole_degrees=True)[1:]
    lat, lon, alt, heading = map(float, option(ardupilot, "--home").split(","))
    for told in (
        (lat, lon, alt),
        tuple(float(px4.environment[f"PX4_HOME_{name}"]) for name in ("LAT", "LON", "ALT")),
        (
            int(whole.environment["PX4_HOME_LAT"]) * 1e-7,
            int(whole.environment["PX4_HOME_LON"]) * 1e-7,
            float(whole.environment["PX4_HOME_ALT"]),
        ),
    ):
        assert math.dist(FRAME.to_local(*told), home_m) < 0.02
    assert heading == 45.0  # towards the first waypoint that lies elsewhere


def test_vehicles_get_what_they_were_planned_with(programs: Programs, tmp_path: Path) -> None:
    plan = level_plan(COPTER, ("px4", "copter"))
    ardupilot, px4 = sitl_instances(plan, programs, tmp_path, wind_m_s=(3.0, -4.0))
    for vehicle, told in ((plan.vehicles[0], ardupilot.defaults), (plan.vehicles[1], px4.environment)):
        prefix = "" if vehicle.autopilot == "ardupilot" else "PX4_PARAM_"
        for name, value in held((vehicle.autopilot, "copter"), vehicle.motion).items():
            assert float(told[prefix + name]) == pytest.approx(value)
    assert ardupilot.defaults["RTL_ALT"] == pytest.approx(100.0 * plan.vehicles[0].motion.return_height_m)
    assert ardupilot.defaults["FRAME_CLASS"] == 1  # else it is never ready
    # it blows to the south-east: from the north-west
    assert ardupilot.defaults["SIM_WIND_SPD"] == 5.0
    assert ardupilot.defaults["SIM_WIND_DIR"] == pytest.approx(math.degrees(math.atan2(-3.0, 4.0)) % 360.0)
    assert (px4.environment["PX4_PARAM_SIH_WIND_E"], px4.environment["PX4_PARAM_SIH_WIND_N"]) == ("-3", "4")


def test_a_px4_has_the_number_that_makes_its_sysid(programs: Programs, tmp_path: Path) -> None:
    plan = level_plan(("px4", "copter"), ("px4", "plane"), sysids=(1, 12))
    first, other = sitl_instances(plan, programs, tmp_path, speedup=3.0)
    assert (option(first, "-i"), option(other, "-i")) == ("0", "11")
    assert (first.url, other.url) == ("udpin:127.0.0.1:14540", "udpin:127.0.0.1:14549")
    assert other.ports == (("udp", 14591), ("udp", 18581))
    assert other.environment["PX4_SIM_MODEL"] == "sihsim_airplane"
    assert other.environment["PX4_SIM_SPEED_FACTOR"] == "3"
    assert first.environment["PX4_SYS_AUTOSTART"] == "10040"  # by number: its files are not there to look


def test_a_px4_is_told_where_its_files_are(tmp_path: Path) -> None:
    px4 = script(tmp_path, "build/px4_sitl_default/bin/px4", "")
    etc = tmp_path / "build" / "px4_sitl_default" / "etc"
    (etc / "init.d-posix" / "airframes").mkdir(parents=True)
    (etc / "init.d-posix" / "rcS").touch()
    (etc / "init.d-posix" / "airframes" / "10040_sihsim_quadx").touch()
    plan = level_plan(("px4", "copter"))
    (instance,) = sitl_instances(plan, sitl_programs([f"px4={px4}"]), tmp_path)
    assert instance.command == (str(px4), "-d", "-i", "0", str(etc))
    assert "PX4_SYS_AUTOSTART" not in instance.environment
    assert "PX4_SIM_SPEED_FACTOR" not in instance.environment  # real time is its own


def test_an_installed_px4_is_called_where_its_commands_are(tmp_path: Path) -> None:
    px4 = script(tmp_path, "opt/px4/bin/px4", "")
    (px4.parent / "px4-alias.sh").touch()
    link = tmp_path / "usr" / "bin" / "px4"
    link.parent.mkdir(parents=True)
    link.symlink_to(px4)
    (instance,) = sitl_instances(level_plan(("px4", "copter")), sitl_programs([f"px4={link}"]), tmp_path)
    assert instance.command == (str(px4), "-d", "-i", "0")  # it knows its files itself
    assert instance.environment["XDG_DATA_HOME"] == str(tmp_path / "uav1")


def test_a_source_tree_says_what_its_airframe_needs(tmp_path: Path) -> None:
    program = script(tmp_path, "ardupilot/build/sitl/bin/arducopter", "")
    tree = tmp_path / "ardupilot" / "Tools" / "autotest" / "default_params"
    tree.mkdir(parents=True)
    (tree / "copter.parm").write_text("# x\nATC_RAT_YAW_P\t0.3 @READONLY\nSIM_SPEEDUP 300\nWPNAV_SPEED,500 # no\nodd\n")
    (instance,) = sitl_instances(level_plan(COPTER), sitl_programs([f"{program}"]), tmp_path / "sitl")
    assert instance.defaults["ATC_RAT_YAW_P"] == 0.3
    assert instance.defaults["SIM_SPEEDUP"] == 1.0
    assert instance.defaults["WPNAV_SPEED"] == 1000.0  # as planned


@pytest.mark.parametrize("speedup", [0.0, -1.0, math.nan, math.inf])
def test_speeds_of_time_that_are_none_are_refused(speedup: float, programs: Programs, tmp_path: Path) -> None:
    with pytest.raises(MissionError, match="--speedup"):
        sitl_instances(level_plan(COPTER), programs, tmp_path, speedup=speedup)


def test_every_vehicle_needs_a_program(programs: Programs, tmp_path: Path) -> None:
    some = {COPTER: programs[COPTER]}
    with pytest.raises(MissionError, match=r"uav2 \(ardupilot plane\): .*ardupilot-plane=/path/to/arduplane"):
        sitl_instances(level_plan(COPTER, PLANE), some, tmp_path)


def test_a_folder_that_ardupilot_would_take_for_two_is_refused(programs: Programs, tmp_path: Path) -> None:
    with pytest.raises(MissionError, match="without commas"):
        sitl_instances(level_plan(COPTER), programs, tmp_path / "a,b")


# -- ground ----------------------------------------------------------------------------------------------------------


def slope(x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Ground that rises eastwards by a fifth, and is not known west of -100 m."""
    return np.where(x_m < -100.0, np.nan, 1190.0 + 0.2 * x_m + 0.05 * y_m)


def test_uneven_ground_is_told_to_ardupilot_and_refused_to_px4(programs: Programs, tmp_path: Path) -> None:
    (level,) = sitl_instances(level_plan(COPTER), programs, tmp_path, ground=lambda x, y: 0.0 * x + 1190.0)
    (uneven,) = sitl_instances(level_plan(COPTER), programs, tmp_path, ground=slope)
    assert [i.defaults["SIM_TERRAIN"] for i in (level, uneven)] == [0, 1]
    assert [i.defaults["TERRAIN_ENABLE"] for i in (level, uneven)] == [0, 1]
    with pytest.raises(MissionError, match="level ground only"):
        sitl_instances(level_plan(("px4", "copter")), programs, tmp_path, ground=slope)


@given(east=st.integers(0, 7), north=st.integers(0, 6), more=st.integers(0, 55), spacing_m=st.sampled_from([30, 100]))
def test_terrain_is_told_place_by_place(east: int, north: int, more: int, spacing_m: int) -> None:
    corner = FRAME.geo_point((-150.0, 40.0, 0.0))
    lat, lon = round(corner.lat_deg * 1e7), round(corner.lon_deg * 1e7)
    bit = 8 * north + east
    request = mavlink.MAVLink_terrain_request_message(lat, lon, spacing_m, 1 << bit | 1 << more)
    answers = terrain_data(request, slope, FRAME, 1234.0)
    assert sorted({answer.gridbit for answer in answers}) == sorted({bit, more})
    (answer,) = (answer for answer in answers if answer.gridbit == bit)
    assert (answer.lat, answer.lon, answer.grid_spacing) == (lat, lon, spacing_m)
    for place, height in enumerate(answer.data):
        x_m = -150.0 + spacing_m * (4 * east + place % 4)
        y_m = 40.0 + spacing_m * (4 * north + place // 4)
        expected_m = 1234.0 if x_m < -100.0 else 1190.0 + 0.2 * x_m + 0.05 * y_m
        assert height == pytest.approx(expected_m, abs=0.51) or abs(x_m + 100.0) < 0.1


# -- time ------------------------------------------------------------------------------------------------------------


class Wall:
    """Real time, by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1000.0
        monkeypatch.setattr(sitl.time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(sitl.time, "sleep", self.pass_)

    def pass_(self, seconds: float) -> None:
        self.now_s += seconds


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    return Wall(monkeypatch)


def test_the_clock_runs_as_the_slowest_vehicle_does(wall: Wall) -> None:
    clock = SitlClock(10.0, lambda: None)
    wall.pass_(1.0)
    assert clock.now_s() == pytest.approx(1.0)  # real time, before anybody is heard
    for step in range(41):
        clock.heard(1, 0.1 * 10.0 * step)
        clock.heard(2, 0.1 * 4.0 * step)
        wall.pass_(0.1)
    before_s = clock.now_s()
    wall.pass_(1.0)
    assert clock.now_s() - before_s == pytest.approx(4.0)
    assert clock.paces() == pytest.approx({1: 10.0, 2: 4.0})


def test_one_that_hangs_does_not_stop_the_clock(wall: Wall) -> None:
    clock = SitlClock(10.0, lambda: None)
    for step in range(20):
        clock.heard(1, 10.0)
        clock.heard(2, 0.1 * 10.0 * step)
        wall.pass_(0.1)
    before_s = clock.now_s()
    wall.pass_(1.0)
    assert clock.now_s() > before_s
    wall.pass_(4.0)
    before_s = clock.now_s()  # nobody is heard any more: real time goes on
    wall.pass_(60.0)
    assert clock.now_s() - before_s == pytest.approx(60.0)


@given(st.lists(st.tuples(st.floats(0.0, 5.0), st.integers(1, 3), st.floats(0.0, 4e6)), max_size=40))
def test_the_clock_never_falls_and_never_runs_away(steps: list[tuple[float, int, float]]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        wall = Wall(patch)
        clock = SitlClock(5.0, lambda: None)
        last_s = clock.now_s()
        for passed_s, sysid, boot_s in steps:
            wall.pass_(passed_s)
            clock.heard(sysid, boot_s)
            now_s = clock.now_s()
            assert last_s <= now_s <= last_s + 10.0 * passed_s + 1e-6
            last_s = now_s


def test_waiting_takes_the_vehicles_time_and_looks_after_them(wall: Wall) -> None:
    looked: list[float] = []
    clock = SitlClock(10.0, lambda: looked.append(wall.now_s))
    clock.heard(1, 50.0)
    wall.pass_(1.0)
    clock.heard(1, 60.0)
    clock.wait(2.0)
    assert wall.now_s == pytest.approx(1001.2)
    clock.wait(1e9)
    assert wall.now_s < 1002.0  # the simulators are looked after all the same
    assert len(looked) == 2


# -- processes -------------------------------------------------------------------------------------------------------


def alive(pid: int) -> bool:
    """Return whether a process runs; one that waits to be buried does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def wait_for(condition: Callable[[], object]) -> None:
    give_up_s = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


def started(tmp_path: Path, text: str, *, kind: Any = COPTER, count: int = 1) -> SitlFleet:
    program = script(tmp_path, "arducopter", text)
    return SitlFleet(level_plan(*[kind] * count), {kind: program}, tmp_path / "sitl")


LISTENS = f"""echo $$ >> {{pids}}
exec {sys.executable} -c '
import socket, sys
server = socket.create_server(("127.0.0.1", 5760 + 10 * int(sys.argv[sys.argv.index("-I") + 1])))
server.accept()[0].recv(1)
import time
time.sleep({{seconds}})
' "$@"
"""


def test_a_program_that_ends_is_told_with_its_last_words(tmp_path: Path, ports: None) -> None:
    fleet = started(tmp_path, "echo first; printf '\\033[31mboom: bad frame\\033[0m\\n' >&2; exit 7")
    with pytest.raises(SitlError) as told, fleet:
        fleet.start()
    log = tmp_path / "sitl" / "uav1" / "sitl.log"
    assert "uav1: its simulator ended with exit code 7" in str(told.value)
    assert "first / boom: bad frame" in str(told.value)
    assert str(log) in str(told.value)
    assert told.value.exit_code == LinkError.exit_code
    assert "boom" in log.read_text()


def test_a_program_that_is_killed_is_told(tmp_path: Path, ports: None) -> None:
    fleet = started(tmp_path, "kill -SEGV $$")
    with pytest.raises(SitlError, match=r"killed by signal 11 \(Segmentation fault\)"), fleet:
        fleet.start()


def test_what_is_no_program_for_this_machine_is_told(tmp_path: Path, ports: None) -> None:
    fleet = started(tmp_path, "")
    (tmp_path / "arducopter").write_bytes(b"\x7fELF nonsense")
    with pytest.raises(SitlError, match="cannot be run: Exec format error"), fleet:
        fleet.start()


@pytest.mark.parametrize(("text", "expected"), [("exec sleep 60", "to listen on tcp"), (LISTENS, "heard nothing")])
def test_programs_that_are_no_autopilots_are_told_and_killed(
    text: str, expected: str, tmp_path: Path, ports: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sitl, "_BEGIN_S", 1.0)
    monkeypatch.setattr(sitl, "_BEGIN_EACH_S", 0.0)
    pids = tmp_path / "pids"
    listens = text.format(pids=pids, seconds=60) if text is LISTENS else f"echo $$ > {pids}; {text}"
    fleet = started(tmp_path, listens)
    with pytest.raises(SitlError, match=expected), fleet:
        fleet.start()
    assert not alive(int(pids.read_text()))


def test_when_one_ends_all_are_killed_with_what_they_have_started(
    tmp_path: Path, ports: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sitl, "_STOP_S", 0.2)
    pids = tmp_path / "pids"
    listens = LISTENS.format(pids=pids, seconds=60)
    text = f"""case "$*" in *"-I $(cat {tmp_path}/last)"*) sleep 0.5; exit 3;; esac
trap '' TERM
sleep 60 & echo $! >> {pids}
{listens}"""
    (tmp_path / "last").write_text(str(free_numbers(3)[2]))
    fleet = started(tmp_path, text, count=3)
    with pytest.raises(SitlError, match=r"uav3: .* exit code 3.*all others were stopped"), fleet:
        fleet.start()
    running = [int(line) for line in pids.read_text().split()]
    assert len(running) == 4
    assert not any(map(alive, running))
    fleet.check()  # told once


@pytest.mark.skipif(sys.platform != "linux", reason="the system has no way to have children killed with their parent")
def test_killing_us_kills_them(tmp_path: Path, ports: None) -> None:
    pids = tmp_path / "pids"
    script(tmp_path, "arducopter", f"echo $$ > {pids}; exec sleep 60")
    code = f"""
from pathlib import Path
from adapters.sitl import SitlFleet
from tests.unit.test_sitl import COPTER, level_plan
folder = Path({str(tmp_path)!r})
with SitlFleet(level_plan(COPTER), {{COPTER: folder / "arducopter"}}, folder) as fleet:
    fleet.start()
"""
    parent = subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parents[2])
    try:
        wait_for(lambda: pids.exists() and pids.read_text().strip())
        child = int(pids.read_text())
        assert alive(child)
    finally:
        parent.kill()
        parent.wait()
    wait_for(lambda: not alive(child))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_stop_them_and_are_told(number: int, tmp_path: Path, ports: None) -> None:
    pids, told = tmp_path / "pids", []
    program = script(tmp_path, "arducopter", f"echo $$ > {pids}; exec sleep 60")
    fleet = SitlFleet(level_plan(COPTER), {COPTER: program}, tmp_path / "sitl", tell=told.append)
    before = signal.getsignal(signal.SIGTERM)

    def interrupt(seconds: float) -> None:
        if pids.exists() and pids.read_text().strip():
            os.kill(os.getpid(), number)

    with pytest.MonkeyPatch.context() as patch, pytest.raises((SystemExit, KeyboardInterrupt)), fleet:
        patch.setattr(sitl.time, "sleep", interrupt)
        fleet.start()
    assert not alive(int(pids.read_text()))
    assert told == [f"1 simulator was stopped; logs are in {tmp_path / 'sitl'}"]
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_shell_set_up_for_another_simulation_does_no_harm(
    tmp_path: Path, ports: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("PX4_SYS_AUTOSTART", "PX4_PARAM_NAV_ACC_RAD", "PX4_SIM_MODEL", "PLAIN"):
        monkeypatch.setenv(name, "theirs")
    px4 = script(tmp_path, "px4_build/bin/px4", "env; exit 1")
    airframes = tmp_path / "px4_build" / "etc" / "init.d-posix" / "airframes"
    airframes.mkdir(parents=True)
    (airframes.parent / "rcS").touch()
    (airframes / "10040_sihsim_quadx").touch()
    fleet = SitlFleet(level_plan(("px4", "copter")), sitl_programs([str(px4)]), tmp_path / "sitl")
    with pytest.raises(SitlError), fleet:
        fleet.start()
    told = dict(line.split("=", 1) for line in (tmp_path / "sitl" / "uav1" / "sitl.log").read_text().splitlines())
    assert told["PLAIN"] == "theirs"
    assert told["PX4_SIM_MODEL"] == "sihsim_quadx"
    assert float(told["PX4_PARAM_NAV_ACC_RAD"]) > 0.0
    assert "PX4_SYS_AUTOSTART" not in told


def test_what_an_earlier_flight_has_left_is_gone(tmp_path: Path, ports: None) -> None:
    own = tmp_path / "sitl" / "uav1"
    for name in ("eeprom.bin", "dataman", "parameters.bson", "terrain/N34W119.DAT", "logs/00000001.BIN"):
        (own / name).parent.mkdir(parents=True, exist_ok=True)
        (own / name).touch()
    fleet = started(tmp_path, "ls; exit 1")
    with pytest.raises(SitlError), fleet:
        fleet.start()
    assert (own / "sitl.log").read_text().split() == ["defaults.parm", "logs", "sitl.log", "terrain"]
    assert list((own / "terrain").iterdir()) == []


def test_simulators_of_others_are_left_alone(tmp_path: Path, ports: None) -> None:
    first, second = free_numbers(2)
    with socket.create_server(("127.0.0.1", 5762 + 10 * first)):
        assert free_numbers(1) == [second]
    fleet = started(tmp_path, "exit 0", kind=("px4", "copter"))
    taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with taken, pytest.raises(SitlError, match=r"uav1: .* UDP port 14580.*nothing was started"), fleet:
        taken.bind(("127.0.0.1", 14580))
        fleet.start()
    assert not (tmp_path / "sitl").exists()
