"""Inspections on the command line: a small line planned, flown, seen, resumed, and all that can be wrong with it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from adapters.certificates import certify_plan
from adapters.export import export_fleet
from adapters.telemetry_log import SIMULATED
from missionplanner.inspection import Round, plan_inspection
from missionplanner.inspection_folder import load_inspection, round_folder, save_inspection
from missionplanner.mission import Mission
from missionplanner.plan_folder import planned_targets, save_certificate, save_plan
from tests.command_line import Cli, expect_line, expect_refusal
from tests.lines import open_question
from tests.scenes import at, mission_file, question

LINE: dict[str, Any] = {"assignment": {"iterations": 20, "swap_s": 60.0}, "camera": {"preset": "sony_rx0m2"}}


def line(**changes: Any) -> dict[str, Any]:
    """Return a line of two towers that is inspected from above: quick to plan and fly."""
    views = {"kind": "overfly", "distance_m": 30.0, "hold_s": 2.0}
    return open_question(((0.0, 0.0), (0.0, 200.0)), **{"views": views} | LINE | changes)


def save_round(folder: Path, this: Round) -> None:
    save_plan(folder, this.scene, this.plan)
    save_certificate(folder, certify_plan(this.scene, this.plan))
    export_fleet(this.plan, folder / "files")


def fly_for_real(folder: Path, without: str = "") -> None:
    """Make a plan folder's rehearsal a flight: what notes that it is simulated goes, and one vehicle, if named."""
    record = folder / "flight.json"
    record.write_text(json.dumps(json.loads(record.read_text()) | {"simulated": False}))
    for path in (folder / "logs").glob("*.tlog"):
        data = path.read_bytes()
        text = data.index(SIMULATED.encode())
        frame = text - 11  # MAVLink 2: 10 bytes before its payload, a STATUSTEXT's first is the severity
        path.write_bytes(data[: frame - 8] + data[frame + 12 + data[frame + 1] :])
    if without:
        for path in (folder / "logs" / f"{without}.tlog", folder / "logs" / "fleet.tlog"):
            path.unlink()


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a planned inspection; not to be changed."""
    folder = tmp_path_factory.mktemp("planned") / "line"
    save_inspection(folder, plan_inspection(Mission.model_validate(line()), Path()), save_round)
    return folder


@pytest.fixture
def copied(planned: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(planned, tmp_path / "line"))


# --- from a mission file to what was seen


def test_a_line_is_planned_flown_seen_and_done(cli: Cli, tmp_path: Path) -> None:
    path = mission_file(tmp_path, line())
    told = cli("validate", path, "--json")
    assert told.code == 0, told.err
    assert told.json["targets"] == ["T1", "T2"]
    assert told.json["visits"] == 2

    flown = cli("fly", path, "-o", "out", "--json")
    assert flown.code == 0, flown.err
    assert "stands still" not in flown.err
    found = flown.json
    assert found["share"] == found["seen"]["share"] == 1.0
    assert found["seen"]["targets"] == ["T1", "T2"]
    assert found["seen"]["photos"] >= 2
    assert found["flown_rounds"] == len(found["rounds"]) == 1
    assert found["rounds"][0]["proof"]["proven"]
    assert found["rounds"][0]["fleet"]["flown_clear"]

    seen = cli("coverage", "out", "--json")
    assert seen.code == 0, seen.err
    assert seen.json["share"] == 1.0
    assert all(row["seen"] for row in seen.json["towers"])
    by_log = cli("coverage", "out", "--log", "out/round-1/logs", "--json")
    assert [row["seen"] for row in by_log.json["towers"]] == [True, True]
    assert "seen: 100.0% of the towers' weight" in cli("coverage", "out").out
    sorties = {s["vehicle"]: set(s["targets"]) for s in found["rounds"][0]["sorties"]}
    assert planned_targets(tmp_path / "out" / "round-1") == sorties  # beside a log: what that flight was to look at

    # it was a rehearsal: told wherever it is shown, and it has inspected nothing
    assert found["simulated"] == seen.json["simulated"] == seen.json["flights"] == ["round-1"]
    assert by_log.json["simulated"] == ["out/round-1/logs"]
    assert "SIMULATED: no vehicle was in the air" in cli("coverage", "out").out
    assert json.loads((tmp_path / "out" / "coverage.json").read_text())["simulated"] == ["round-1"]
    assert ",yes," not in (tmp_path / "out" / "towers.csv").read_text()
    assert cli("report", "out").code == 0
    assert ",yes," not in (tmp_path / "out" / "towers.csv").read_text()
    assert "SIMULATED: no vehicle was in the air in round-1" in (tmp_path / "out" / "report.html").read_text()
    rest = cli("plan", path, "--flown", "out", "-o", "rest", "--json")
    expect_refusal(rest, 2, "--flown", "got simulated ones only", "out/round-1/logs", "--simulated")
    assert not (tmp_path / "rest").exists()
    rest = cli("plan", path, "--flown", "out", "--simulated", "-o", "rest", "--json")
    assert rest.json["done_before"] == ["T1", "T2"], rest.err

    # one vehicle's flight alone, and a rehearsal before it: the other's tower is left
    (vehicle, targets), (other, _) = [(s["vehicle"], s["targets"]) for s in found["rounds"][0]["sorties"]]
    real = Path(shutil.copytree(tmp_path / "out", tmp_path / "real"))
    shutil.copytree(tmp_path / "out" / "round-1" / "logs", real / "round-1" / "logs" / "earlier" / "1")
    fly_for_real(real / "round-1", without=other)
    rest = cli("plan", path, "--flown", "real", "-o", "rest", "--json")
    assert rest.code == 0, rest.err
    assert "real/round-1/logs/earlier/1: not counted: a simulated flight" in rest.err
    assert rest.json["done_before"] == targets
    assert rest.json["inspected"] == 2 - len(targets)
    assert rest.json["share"] == 1.0

    # nothing is left: said, and the rest that was planned before is not there to be flown again
    every = Path(shutil.copytree(tmp_path / "out", tmp_path / "every"))
    fly_for_real(every / "round-1")
    seen = cli("coverage", "every", "--json")
    assert (seen.json["share"], seen.json["flights"], seen.json["simulated"]) == (1.0, ["round-1"], [])
    assert ",yes," in (tmp_path / "every" / "towers.csv").read_text()
    rest = cli("plan", path, "--flown", "every", "-o", "rest", "--json")
    assert rest.code == 0, rest.err
    assert rest.json == {"mission": "small", "done_before": ["T1", "T2"], "rounds": [], "left_out": []}
    assert not [at for at in (tmp_path / "rest").rglob("*") if at.is_file()]
    assert "nothing is left to inspect" in cli("plan", path, "--flown", "every", "-o", "rest").out

    # into what is read, nothing is written
    told = "--output: expected another folder than every"
    for read in ("every", "every/round-1/logs", f"every/round-1/logs/{vehicle}.tlog"):
        expect_refusal(cli("plan", path, "--flown", read, "-o", "every", "--json"), 2, told)
    assert (every / "round-1" / "flight.json").exists()


def test_who_went_on_with_a_round_counts(cli: Cli, copied: Path) -> None:
    """The flight of what was resumed beside its round is one of the inspection's."""
    at = round_folder(copied, 1)
    vehicle, targets = next(iter(planned_targets(at).items()))
    resumed = cli("resume", at, "--vehicle", vehicle, "--from", "3", "--json")
    assert resumed.code == 0, resumed.err
    rest = copied / f"round-1_{vehicle}_resumed"
    assert cli("fly", rest).code == 0
    expect_line(cli("coverage", rest), 2, "expected the whole inspection", str(copied))
    seen = cli("coverage", copied, "--json")
    assert seen.code == 3
    assert seen.json["flights"] == [rest.name]
    assert seen.json["done"] == sorted(targets)
    assert cli("report", copied).code == 0
    assert f"no vehicle was in the air in {rest.name}" in (copied / "report.html").read_text()

    # flown to its end: there is nothing to resume
    expect_line(cli("resume", rest, "--vehicle", vehicle, "--log", rest), 2, vehicle, "nothing is left but its end")


def test_a_round_by_itself_does_not_say_what_was_seen(cli: Cli, copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lonely = Path(shutil.copytree(round_folder(copied, 1), copied.parent / "lonely"))
    expect_line(cli("coverage", lonely), 2, "expected the folder of the whole inspection", f"--log {lonely}")
    monkeypatch.chdir(round_folder(copied, 1))
    expect_line(cli("coverage", "."), 2, "expected the whole inspection", str(copied.resolve()))


def test_what_an_earlier_inspection_showed_goes_with_it(copied: Path) -> None:
    told = ["coverage.json", "coverage.png", "report.html", "pictures/coverage.png", "round-1/report.html"]
    told += ["round-1/report-alpha.html", "round-1/pictures/map.png", "round-1/flight.json", "round-7/plan.json"]
    told += ["round-1_alpha_resumed/plan.json", "round-1_alpha_resumed/files/alpha.plan", "round-1/files/bravo.kmz"]
    log = "round-1/logs/alpha.tlog"
    again = load_inspection(copied)
    for name in (*told, log):
        (copied / name).parent.mkdir(parents=True, exist_ok=True)
        (copied / name).write_text("of an earlier one")
    save_inspection(copied, again, save_round)
    assert not [name for name in told if (copied / name).exists()]
    assert (copied / log).exists()


def test_files_of_one_vehicle_are_checked_against_the_whole_mission(cli: Cli, copied: Path, tmp_path: Path) -> None:
    path = mission_file(tmp_path, line())
    alone = round_folder(copied, 1) / "files" / "alpha.plan"
    checked = cli("check", "--mission", path, alone, "--json")
    assert checked.code == 0, checked.err
    assert "not judged of an open mission" in checked.out


def test_a_planned_folder_is_checked_exported_and_uploaded_by_rounds(cli: Cli, copied: Path) -> None:
    checked = cli("check", copied, "--json")
    assert checked.code == 0, checked.err
    assert checked.json["proven"]
    assert len(checked.json["rounds"]) == 1
    exported = cli("export", copied, "-o", "files", "--json")
    assert exported.code == 0, exported.err
    assert any(name.endswith("round-1/alpha.plan") for name in exported.json["files"])
    told = "expected one round at a time, got a whole inspection"
    expect_line(cli("upload", copied, "--connect", "tcp:127.0.0.1:9"), 2, told, "round-1")
    expect_line(cli("fly", copied, "--connect", "tcp:127.0.0.1:9"), 2, told, "round-1")
    expect_line(cli("resume", copied, "--vehicle", "alpha", "--from", "3"), 2, "name one of them", "round-1")
    expect_line(cli("coverage", copied), 2, "expected flights, got none")
    expect_line(cli("coverage", round_folder(copied, 1)), 2, "expected the whole inspection", str(copied))


def test_what_is_read_is_what_was_written(planned: Path) -> None:
    first = load_inspection(planned)
    assert [visit.name for tour in first.tours for visit in tour.visits]
    assert first.share == 1.0
    document = json.loads((planned / "inspection.json").read_text())
    assert document["makespan_s"] == pytest.approx(first.makespan_s, abs=0.01)
    assert [row["target"] for row in document["targets"]] == ["T1", "T2"]
    assert {row["vehicle"] for row in document["targets"]} <= {"alpha", "bravo"}


def test_an_edited_plan_is_refused(cli: Cli, copied: Path) -> None:
    path = round_folder(copied, 1) / "plan.json"
    document = json.loads(path.read_text())
    vehicle = document["vehicles"][0]
    vehicle["return_height_m"] = 5.0
    path.write_text(json.dumps(document))
    checked = cli("check", copied, "--json")
    expect_line(checked, 3, f"not proven: {round_folder(copied, 1)}: {vehicle['name']}: ", "when told to return")
    assert not checked.json["proven"]
    told = f"{round_folder(copied, 1)}: not proven: {vehicle['name']}: "
    expect_refusal(cli("fly", copied, "--json"), 3, told, "when told to return", "nothing was sent")
    vehicle["waypoints"][1]["position_m"][2] -= 25.0
    path.write_text(json.dumps(document))
    told = f"{vehicle['name']}: expected waypoints from the top of the take-off through every stop"
    for command in ("check", "fly"):
        expect_refusal(cli(command, copied, "--json"), 2, str(path), told)


# --- what is wrong


def _edit(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def edit(folder: Path) -> None:
        path = folder / "inspection.json"
        document = json.loads(path.read_text())
        change(document)
        path.write_text(json.dumps(document))

    return edit


WRONG_FOLDERS: dict[str, tuple[Callable[[Path], object], list[str]]] = {
    "a missing round": (lambda f: shutil.rmtree(f / "round-1"), ["round-1", "expected the plan of this round"]),
    "cut short": (lambda f: (f / "inspection.json").write_text('{"format'), ["not JSON"]),
    "another version": (_edit(lambda d: d.update(version=2)), ["version 1", "plan the inspection again"]),
    "another mission": (_edit(lambda d: d["mission"]["inspection"].update(range_m=99)), ["sha256"]),
    "an unknown vehicle": (_edit(lambda d: d["rounds"][0]["tours"][0].update(vehicle="zulu")), ["zulu"]),
    "an unknown view": (
        _edit(lambda d: d["rounds"][0]["tours"][0]["visits"][0].update(name="T9.left")),
        ["T9.left"],
    ),
    "a tour of others": (
        _edit(lambda d: d["rounds"][0]["tours"][0].update(visits=[{"name": "T2", "reversed": False}] * 2)),
        ["expected"],
    ),
    "another round": (_edit(lambda d: d["rounds"][0].update(input_sha256="0" * 64)), ["got another"]),
}


@pytest.mark.parametrize("wrong", WRONG_FOLDERS)
def test_a_damaged_folder_is_refused(cli: Cli, copied: Path, wrong: str) -> None:
    damage, expected = WRONG_FOLDERS[wrong]
    damage(copied)
    expect_refusal(cli("check", copied, "--json"), 2, *expected)


WRONG_MISSIONS: dict[str, tuple[dict[str, Any], list[str]]] = {
    "stops of its own": (
        line(vehicles=[{"name": "alpha", "home": at(-150, 0), "stops": [at(0, 50, agl=50)]}]),
        ["vehicles[0].stops", "expected none where inspection.assignment"],
    ),
    "a plane": (
        line(vehicles=[{"name": "alpha", "home": at(-150, 0), "class": "plane"}]),
        ["vehicles[0].class", "expected copters"],
    ),
    "who stays in the air": (
        line(vehicles=[{"name": "alpha", "home": at(-150, 0), "end": "loiter"}]),
        ["vehicles[0].end", "expected land or rtl"],
    ),
    "a meeting": (
        line(fleet={"rendezvous": [{"name": "line", "at": {"alpha": 0, "bravo": 0}}]}),
        ["fleet.rendezvous", "expected none where inspection.assignment"],
    ),
    "an arrival": (line(fleet={"arrival_time_s": 500}), ["fleet.arrival_time_s", "expected none where"]),
    "an unknown camera": (line(camera={"preset": "sony_rx0m3"}), ["inspection.camera.preset", "did you mean"]),
    "nothing to look at": (line(views={"kind": "overfly"}, towers_none=True), ["expected something to inspect"]),
    "too near to conductors": (
        line(safety_distance_m=40.0),
        ["safety.obstacle_m", "expected at least inspection.safety_distance_m (40 m)"],
    ),
}


@pytest.mark.parametrize("wrong", WRONG_MISSIONS)
def test_a_wrong_open_mission_is_told_in_one_line(cli: Cli, tmp_path: Path, wrong: str) -> None:
    data, expected = WRONG_MISSIONS[wrong]
    if data["inspection"].pop("towers_none", False):
        data["inspection"]["towers"] = [tower | {"views": "none"} for tower in data["inspection"]["towers"]]
    path = mission_file(tmp_path, data)
    expect_refusal(cli("validate", path, "--json"), 2, str(path), *expected)
    assert list(tmp_path.iterdir()) == [path]


def test_options_that_do_not_go_with_an_inspection(cli: Cli, tmp_path: Path) -> None:
    path = mission_file(tmp_path, line())
    expect_line(cli("plan", path, "--within", "3"), 2, "--within", "got an inspection")
    expect_line(cli("fly", path, "--connect", "tcp:127.0.0.1:9"), 2, "a round at a time")
    expect_line(cli("plan", path, "--flown", "nowhere"), 2, "nowhere", "expected a telemetry log")
    for nothing in ("", ",", " , "):
        expect_line(cli("plan", path, "--flown", nothing), 2, "--flown: expected folders or logs of flights")
    expect_line(cli("plan", path, "--simulated"), 2, "--simulated: expected with --flown")
    (tmp_path / "empty").mkdir()
    expect_line(cli("plan", path, "--flown", "empty"), 2, "empty", "got a folder without any")
    plain = tmp_path / "plain.yaml"
    plain.write_text(json.dumps(question()))
    expect_line(cli("plan", plain, "--flown", "empty"), 2, "--flown", "resume")
    assert not (tmp_path / "out").exists()


def test_a_tower_out_of_reach_is_named(cli: Cli, tmp_path: Path) -> None:
    """A battery for a minute: nothing can be inspected, and why is said of each; nothing is left behind."""
    path = mission_file(tmp_path, line(defaults={"endurance_s": 60.0}))
    outcome = cli("plan", path, "-o", "out", "--json")
    expect_refusal(outcome, 3, "inspection.share_min: expected 100%", "T1: ", "T2: ")
    assert not list((tmp_path / "out").iterdir())


def test_cameras_are_listed(cli: Cli) -> None:
    listed = cli("cameras", "--json").json["cameras"]
    assert {"dji_p1_35mm", "sony_rx0m2"} <= {camera["preset"] for camera in listed}
    assert "sony_rx0m2" in cli("cameras").out


@pytest.mark.slow
def test_the_example_is_planned_proven_flown_and_seen_as_a_whole(cli: Cli) -> None:
    path = Path(__file__).parents[2] / "missions" / "san_gabriel.yaml"
    flown = cli("fly", path, "-o", "out", "--json")
    assert flown.code == 0, flown.err
    found = flown.json
    assert found["targets"] == found["inspected"]
    assert not found["left_out"]
    assert found["share"] == found["seen"]["share"] == 1.0
    assert not found["seen"]["missing"]
    assert all(round_["proof"]["proven"] and round_["fleet"]["flown_clear"] for round_ in found["rounds"])
