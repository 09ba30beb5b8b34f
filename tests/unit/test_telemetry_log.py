"""Telemetry logs: readable by us and by pymavlink, also when cut short or damaged."""

from __future__ import annotations

import contextlib
import json
import random
import subprocess
import sys
from pathlib import Path

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import plan_items
from adapters.telemetry_log import FleetLog, read_log
from adapters.waypoints_file import read_waypoints
from missionplanner.errors import MissionError
from tests.plans import small_fleet
from tests.rig import Rig

EPOCH_S = 1_700_000_000.0


def _frame(sysid: int, seq: int) -> bytes:
    codec = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1)
    codec.seq = seq % 256
    message = mavlink.MAVLink_global_position_int_message(seq * 200, seq, -seq, 1000 * seq, 0, 0, 0, 0, 0)
    return bytes(message.pack(codec))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with FleetLog(tmp_path / "logs", {1: "a", 2: "b"}, EPOCH_S) as log:
        for seq in range(50):
            for sysid in (1, 2, 9):
                log.write(0.2 * seq, sysid, _frame(sysid, seq))
        assert [path.name for path in log.paths] == ["a.tlog", "b.tlog", "fleet.tlog"]
    return tmp_path / "logs"


def test_each_vehicle_has_its_own_log_and_all_are_merged(folder: Path) -> None:
    for name, count in (("a", 50), ("b", 50), ("fleet", 150)):
        log = read_log(folder / f"{name}.tlog")
        assert len(log.records) == count
        assert log.lost_bytes == 0
        assert log.records[0][0] == EPOCH_S
        assert log.records[-1][0] == pytest.approx(EPOCH_S + 9.8, abs=1e-5)
        assert log.records[-1][1].lat == 49
    assert {m.get_srcSystem() for _, m in read_log(folder / "b.tlog").records} == {2}


def test_pymavlink_reads_it(folder: Path) -> None:
    with contextlib.closing(mavutil.mavlink_connection(str(folder / "a.tlog"))) as log:
        messages = []
        while (message := log.recv_match()) is not None:
            messages.append(message)
    assert [m.lat for m in messages if m.get_type() == "GLOBAL_POSITION_INT"] == list(range(50))
    assert messages[-1]._timestamp == pytest.approx(EPOCH_S + 9.8, abs=1e-3)


def test_a_log_cut_short_is_read_up_to_the_cut(folder: Path) -> None:
    path = folder / "a.tlog"
    data = path.read_bytes()
    path.write_bytes(data[:-5])
    log = read_log(path)
    assert len(log.records) == 49
    assert 0 < log.lost_bytes < 60


def test_damage_costs_only_what_it_hits(folder: Path) -> None:
    path = folder / "a.tlog"
    data = bytearray(path.read_bytes())
    rng = random.Random(1)
    for _ in range(5):
        data[rng.randrange(len(data))] ^= 0xFF
    data[700:700] = bytes(rng.randrange(256) for _ in range(300))
    path.write_bytes(data)
    log = read_log(path)
    assert 40 <= len(log.records) < 50
    assert log.lost_bytes >= 300
    assert all(m.lat == -m.lon for _, m in log.records)


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.tlog").write_bytes(b"QGC WPL 110\n" * 50)
    with pytest.raises(MissionError, match=r"x\.tlog: expected a telemetry log, got 600 bytes without any MAVLink"):
        read_log(tmp_path / "x.tlog")
    with pytest.raises(MissionError, match="expected a telemetry log"):
        read_log(tmp_path / "nowhere.tlog")
    (tmp_path / "empty.tlog").write_bytes(b"")
    assert read_log(tmp_path / "empty.tlog").records == ()


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "logs").write_text("in the way")
    with pytest.raises(MissionError, match="logs: expected a folder"):
        FleetLog(tmp_path / "logs", {1: "a"}, EPOCH_S)


TEXTS = ["UNPROVEN mission", "x" * 50, "ein Flug, der nicht bewiesen ist: " * 4, "y" * 100]


def test_a_note_stands_in_every_log_at_its_time(tmp_path: Path) -> None:
    with FleetLog(tmp_path, {1: "a", 2: "b"}, EPOCH_S) as log:
        log.write(1.0, 1, _frame(1, 1))
        log.note(2.5, TEXTS[0])
        log.write(3.0, 2, _frame(2, 2))
    for name, count in (("a", 2), ("b", 2), ("fleet", 3)):
        read = read_log(tmp_path / f"{name}.tlog")
        assert (len(read.records), read.lost_bytes) == (count, 0)
        [(at_s, note)] = [(t, m) for t, m in read.records if m.get_type() == "STATUSTEXT"]
        assert (at_s, note.text, note.get_srcSystem()) == (EPOCH_S + 2.5, "UNPROVEN mission", 255)
        assert note.severity == mavlink.MAV_SEVERITY_WARNING


def test_notes_of_any_length_are_shown_by_pymavlink(tmp_path: Path) -> None:
    with FleetLog(tmp_path, {1: "a"}, EPOCH_S) as log:
        for k, text in enumerate(TEXTS):
            log.note(float(k), text)
    with contextlib.closing(mavutil.mavlink_connection(str(tmp_path / "a.tlog"))) as reader:
        messages = []
        while (message := reader.recv_match(type="STATUSTEXT")) is not None:
            messages.append(message)
    whole: list[str] = []
    for message in messages:  # https://mavlink.io/en/messages/common.html#STATUSTEXT
        if message.id == 0 or message.chunk_seq == 0:
            whole.append("")
        whole[-1] += message.text
    assert whole == TEXTS
    numbers = [(m.id, m.chunk_seq) for m in messages]
    assert numbers == [(0, 0), (0, 0), (3, 0), (3, 1), (3, 2), (4, 0), (4, 1), (4, 2)]


def test_earlier_logs_are_put_aside_and_kept(folder: Path) -> None:
    before = {path.name: path.read_bytes() for path in folder.glob("*.tlog")}
    for _ in range(2):
        with FleetLog(folder, {1: "a", 2: "b"}, EPOCH_S) as log:
            log.write(0.0, 1, _frame(1, 7))
    assert {path.name: path.read_bytes() for path in (folder / "earlier" / "1").iterdir()} == before
    assert len(read_log(folder / "earlier" / "2" / "a.tlog").records) == 1
    assert len(read_log(folder / "a.tlog").records) == 1


def test_a_vehicle_called_fleet_does_not_share_the_log_of_all(tmp_path: Path) -> None:
    with FleetLog(tmp_path, {1: "fleet", 2: "b"}, EPOCH_S) as log:
        log.write(0.0, 1, _frame(1, 1))
        log.write(0.1, 2, _frame(2, 1))
    assert len(read_log(tmp_path / "fleet.tlog").records) == 2
    assert len(read_log(tmp_path / "1-fleet.tlog").records) == 1


_WRITER = """
import os, signal, sys
from pathlib import Path
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from adapters.telemetry_log import FleetLog
signal.signal(signal.SIGINT, signal.default_int_handler)  # though this was started in the background
log = FleetLog(Path(sys.argv[1]), {1: "a"}, 1.7e9)
codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
for k in range(100):
    log.write(0.1 * k, 1, bytes(mavlink.MAVLink_system_time_message(k, k).pack(codec)))
os.kill(os.getpid(), getattr(signal, sys.argv[2]))
signal.pause()
"""


@pytest.mark.parametrize("ending", ["SIGKILL", "SIGINT"])
def test_a_program_that_is_killed_has_lost_nothing(tmp_path: Path, ending: str) -> None:
    killed = subprocess.run([sys.executable, "-c", _WRITER, str(tmp_path), ending], capture_output=True, check=False)
    assert killed.returncode != 0
    for name in ("a", "fleet"):
        log = read_log(tmp_path / f"{name}.tlog")
        assert (len(log.records), log.lost_bytes) == (100, 0)


def test_times_never_go_back(tmp_path: Path) -> None:
    with FleetLog(tmp_path, {1: "a"}, EPOCH_S) as log:
        for now_s in (5.0, 4.9, 5.1):
            log.write(now_s, 1, _frame(1, 1))
    assert [t - EPOCH_S for t, _ in read_log(tmp_path / "a.tlog").records] == pytest.approx([5.0, 5.0, 5.1], abs=1e-5)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full: a full disk cannot be tried here")
def test_a_full_disk_ends_the_log_and_not_the_flight(tmp_path: Path) -> None:
    (tmp_path / "fleet.tlog").symlink_to("/dev/full")
    with FleetLog(tmp_path, {1: "a"}, EPOCH_S) as log:
        log.write(0.0, 1, _frame(1, 1))
        log.write(0.1, 1, _frame(1, 2))
        assert log.trouble is not None
        assert "the telemetry logs end here, they cannot be written: No space left" in log.trouble


def _tool(name: str, *arguments: object) -> str:
    """Run one of the programs that pymavlink and MAVProxy install beside Python."""
    program = Path(sys.executable).with_name(name)
    if not program.exists():
        pytest.skip(f"{name} is not installed beside {sys.executable}: install the test extra")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", program, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        stdin=subprocess.DEVNULL,
    )
    return done.stdout


@pytest.mark.parametrize(("name", "senders"), [("a", {1}), ("fleet", {1, 2, 9})])
def test_mavlogdump_reads_it_in_full(folder: Path, name: str, senders: set[int]) -> None:
    lines = _tool("mavlogdump.py", "--format", "json", folder / f"{name}.tlog").splitlines()
    dumped = [json.loads(line) for line in lines if line.startswith("{")]
    positions = [entry for entry in dumped if entry["meta"]["type"] == "GLOBAL_POSITION_INT"]
    assert [entry["data"]["lat"] for entry in positions] == [
        m.lat for _, m in read_log(folder / f"{name}.tlog").records
    ]
    assert {entry["meta"].get("srcSystem", 1) for entry in positions} <= senders
    times = [entry["meta"]["timestamp"] for entry in positions]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx(9.8, abs=0.01)


def test_tools_find_mission_modes_and_track_in_a_flights_log(tmp_path: Path) -> None:
    plan = small_fleet("ardupilot", 2)
    with FleetLog(tmp_path, {v.sysid: v.name for v in plan.vehicles}, EPOCH_S) as log:
        rig = Rig(plan, log=log)
        rig.upload()
        rig.link.start()
        rig.link.watch()
    path = tmp_path / "uav2.tlog"
    _tool("mavmission.py", "--output", tmp_path / "sent.waypoints", path)  # of what went to the vehicle
    held = read_waypoints(tmp_path / "sent.waypoints", "ardupilot")
    sent = plan_items(plan.vehicles[1], plan.frame)
    assert [item.command for item in held] == [item.command for item in sent]
    assert all(abs(a.x - b.x) <= 10 and abs(a.y - b.y) <= 10 for a, b in zip(held, sent, strict=True))  # 6 decimals
    assert "AUTO" in _tool("mavflightmodes.py", path)
    assert "Flight time" in _tool("mavflighttime.py", path)
    _tool("mavtogpx.py", path)
    assert (tmp_path / "uav2.tlog.gpx").read_text().count("<trkpt") > 50
