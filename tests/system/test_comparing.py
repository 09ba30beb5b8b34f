"""What was flown against what was planned and predicted, by command: replay and experiment fidelity."""

from __future__ import annotations

import json
import re
import shutil
import struct
import sys
from pathlib import Path
from typing import Any

import pytest

from adapters.telemetry_log import FleetLog
from missionplanner.cli import main
from missionplanner.experiments.fidelity import MARKS
from tests.command_line import Cli, expect_line, expect_refusal
from tests.main_job import plan_into
from tests.recorded import legs, record
from tests.scenes import question, scene_of

STAMP = struct.Struct(">Q")


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan folder of two copters, flown by ``missionplanner fly``; not to be changed."""
    folder = tmp_path_factory.mktemp("flown")
    plan_into(folder / "plan", scene_of(question(), folder))
    with pytest.MonkeyPatch.context() as patched, pytest.raises(SystemExit) as ended:
        patched.setattr(sys, "argv", ["missionplanner", "fly", str(folder / "plan"), "--json"])
        main()
    assert not ended.value.code
    return folder / "plan"


def copy_of(flown: Path, folder: Path) -> Path:
    return Path(shutil.copytree(flown, folder / "copy"))


def moved_in_time(data: bytes, shift_s: float) -> bytes:
    """Return a log with all its times moved."""
    moved, position = bytearray(data), 0
    while position < len(moved):
        (stamp_us,) = STAMP.unpack_from(moved, position)
        STAMP.pack_into(moved, position, stamp_us + round(shift_s * 1e6))
        position += 8 + 12 + moved[position + 9]
    return bytes(moved)


def test_what_fly_has_logged_is_what_it_reported(cli: Cli, flown: Path, tmp_path: Path) -> None:
    plan = copy_of(flown, tmp_path)
    outcome = cli("replay", "--plan", plan, "--json")
    assert outcome.code == 0, outcome.err
    found: dict[str, Any] = outcome.json
    reported = json.loads((plan / "flight.json").read_text())
    assert found["start"]["by"] == "commanded"
    for row, vehicle in zip(found["vehicles"], reported["vehicles"], strict=True):
        assert row["name"] == vehicle["name"]
        assert row["arrival_s"] == pytest.approx(vehicle["arrival_s"], abs=0.06)
        assert row["landed_s"] == pytest.approx(vehicle["landed_s"], abs=0.06)
        assert row["cross_track_m"]["worst"] < 0.3
        assert abs(row["arrival_error_s"]) < 0.3
        assert [w["how"] for w in row["waypoints"]][-1] == "reported"
    assert found["fleet"]["arrival_spread_s"] < 0.3
    assert found["fleet"]["separation"]["ok"]
    assert not found["notes"]
    assert not found["problems"]
    page = (plan / "replay" / "replay.html").read_text()
    assert "All arrived" in page
    for name in ("errors", "arrivals", "apart", "ways"):
        assert (plan / "replay" / "pictures" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((plan / "replay" / "replay.json").read_text())["vehicles"] == found["vehicles"]
    table = cli("replay", *sorted((plan / "logs").glob("[!f]*.tlog")), "--plan", plan, "-o", tmp_path / "again")
    assert table.code == 0, table.err
    assert "arrivals from first to last" in table.out
    assert "when MISSION_START was sent" in table.out
    assert (tmp_path / "again" / "replay.html").exists()


def test_a_log_of_one_vehicle_that_came_late_shows_it_late(cli: Cli, flown: Path, tmp_path: Path) -> None:
    first, second = sorted(path for path in (flown / "logs").glob("*.tlog") if path.stem != "fleet")
    late = tmp_path / "late.tlog"
    late.write_bytes(moved_in_time(second.read_bytes(), 4.0))
    found = cli("replay", first, late, "--plan", flown, "-o", tmp_path / "out", "--json").json
    by_name = {row["name"]: row for row in found["vehicles"]}
    assert by_name[second.stem]["arrival_error_s"] == pytest.approx(4.0, abs=0.3)
    assert by_name[first.stem]["arrival_error_s"] == pytest.approx(0.0, abs=0.3)
    assert found["fleet"]["arrival_spread_s"] == pytest.approx(4.0, abs=0.3)
    assert found["started_s"][second.stem] == pytest.approx(4.0, abs=0.1)


def test_a_damaged_log_is_read_as_far_as_it_is_whole(cli: Cli, flown: Path, tmp_path: Path) -> None:
    data = (flown / "logs" / "fleet.tlog").read_bytes()
    fifth = len(data) // 5
    (tmp_path / "cut.tlog").write_bytes(data[:fifth] + bytes(range(256)) + data[fifth : 2 * fifth])
    outcome = cli("replay", tmp_path / "cut.tlog", "--plan", flown, "-o", tmp_path / "out", "--json")
    assert outcome.code == 0, outcome.err
    said = " ".join(outcome.json["notes"])
    assert "bytes skipped" in said
    assert "cut short" in said
    assert "never reached its goal" in said
    assert outcome.json["fleet"]["arrival_spread_s"] is None


def test_what_is_no_log_of_the_plan_is_refused(cli: Cli, flown: Path, tmp_path: Path) -> None:
    out = ("--plan", flown, "-o", tmp_path / "out")
    (tmp_path / "empty.tlog").touch()
    expect_refusal(cli("replay", tmp_path / "empty.tlog", *out, "--json"), 2, "empty.tlog", "got an empty file")
    (tmp_path / "words.tlog").write_text("no log\n" * 50)
    expect_refusal(cli("replay", tmp_path / "words.tlog", *out, "--json"), 2, "without any MAVLink frame")
    expect_refusal(cli("replay", tmp_path / "no.tlog", *out, "--json"), 2, "no.tlog", "No such file")
    expect_line(cli("replay", tmp_path / "empty.tlog", "--plan", tmp_path), 2, "plan.json")
    expect_line(cli("replay", tmp_path / "empty.tlog"), 2, "--plan: expected the plan folder")
    unflown = tmp_path / "unflown"
    shutil.copytree(flown, unflown)
    shutil.rmtree(unflown / "logs")
    expect_line(cli("replay", "--plan", unflown), 2, "expected telemetry logs (.tlog), got none")
    (unflown / "logs").mkdir()
    (unflown / "logs" / "fleet.tlog").touch()
    resumed = cli("resume", unflown, "--vehicle", "alpha", "--log", unflown, "-o", tmp_path / "rest")
    expect_line(resumed, 2, "expected the log of a flight of alpha, found none")
    assert not (tmp_path / "out").exists()


def test_a_flight_is_found_though_something_was_uploaded_since(cli: Cli, flown: Path, tmp_path: Path) -> None:
    plan = Path(shutil.copytree(flown, tmp_path / "plan"))
    for _ in range(2):
        with FleetLog(plan / "logs", {1: "alpha", 2: "bravo"}, 1.8e9) as log:
            log.note(0.0, "an upload")
    outcome = cli("replay", "--plan", plan, "--json")
    assert outcome.code == 0, outcome.err
    assert "the latest flight is in" in outcome.err
    assert all(row["arrival_s"] is not None for row in outcome.json["vehicles"])
    resumed = cli("resume", plan, "--vehicle", "alpha", "--log", plan, "-o", tmp_path / "rest")
    assert resumed.code == 0, resumed.err
    assert f"broken off in {plan / 'logs' / 'earlier' / '1' / 'fleet.tlog'}" in resumed.err


def test_what_cannot_be_replayed_is_told_beside_what_can(cli: Cli, flown: Path, tmp_path: Path) -> None:
    (tmp_path / "words.tlog").write_text("no log\n" * 50)
    logs = flown / "logs" / "fleet.tlog", tmp_path / "words.tlog"
    outcome = cli("replay", *logs, "--plan", flown, "-o", tmp_path / "out", "--json")
    expect_line(outcome, 2, "words.tlog", "without any MAVLink frame")
    assert len(outcome.json["vehicles"]) == 2
    assert len(outcome.json["problems"]) == 1
    assert "Not everything could be replayed" in (tmp_path / "out" / "replay.html").read_text()


FIGURES = (
    "leg_time_error_mean",
    "leg_time_error_worst",
    "arrival_error_s",
    "arrival_error_fraction",
    "position_error_p95_m",
)


def test_the_fidelity_experiment(cli: Cli, tmp_path: Path) -> None:
    for name in ("one", "two"):
        record(tmp_path, name, "arducopter", legs(), stretch=1.01)
    record(tmp_path, "three", "px4", legs())
    (tmp_path / "page.md").write_text(f"{MARKS[0]}\n{MARKS[1]}\n")
    outcome = cli("experiment", "fidelity", "--flights", tmp_path, "--update", tmp_path / "page.md", "--json")
    assert outcome.code == 0, outcome.err
    flights = {flight["name"]: flight for flight in outcome.json["flights"]}
    assert list(flights) == ["one", "three", "two"]
    assert all(isinstance(flight[figure], float) for flight in flights.values() for figure in FIGURES)
    assert flights["one"]["arrival_error_fraction"] == pytest.approx(1 / 1.01 - 1, abs=1e-3)
    assert (tmp_path / "out" / "experiment_fidelity" / "flights.csv").exists()
    assert re.search(r"^\| three +\| PX4 multicopter \|", (tmp_path / "page.md").read_text(), re.MULTILINE)
    table = cli("experiment", "fidelity", "--flights", tmp_path)
    assert re.search(r"^\| one +\| ArduCopter +\|", table.out, re.MULTILINE)


def test_flights_that_cannot_be_read_are_told_at_the_end(cli: Cli, tmp_path: Path) -> None:
    for name in ("one", "two"):
        record(tmp_path, name, "arducopter", legs())
    (tmp_path / "one.json").unlink()
    outcome = cli("experiment", "fidelity", "--flights", tmp_path, "--json")
    expect_line(outcome, 2, "one.json: missing")
    assert [flight["name"] for flight in outcome.json["flights"]] == ["two"]
    assert [flight["name"] for flight in outcome.json["unreadable"]] == ["one"]
    (tmp_path / "none").mkdir()
    expect_refusal(cli("experiment", "fidelity", "--flights", tmp_path / "none", "--json"), 2, "found none")
    expect_refusal(cli("experiment", "fidelity", "--json"), 2, "--flights: expected a folder")
