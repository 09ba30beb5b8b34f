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

    # nothing is left: said, and nothing written
    rest = cli("plan", path, "--flown", "out", "-o", "rest", "--json")
    assert rest.code == 0, rest.err
    assert rest.json == {"mission": "small", "done_before": ["T1", "T2"], "rounds": [], "left_out": []}
    assert not list((tmp_path / "rest").iterdir())
    assert "nothing is left to inspect" in cli("plan", path, "--flown", "out", "-o", "rest").out

    # one vehicle's log alone: the other's tower is left
    ((vehicle, targets),) = [(s["vehicle"], s["targets"]) for s in found["rounds"][0]["sorties"]][:1]
    rest = cli("plan", path, "--flown", f"out/round-1/logs/{vehicle}.tlog", "-o", "rest", "--json")
    assert rest.code == 0, rest.err
    assert rest.json["done_before"] == targets
    assert rest.json["inspected"] == 2 - len(targets)
    assert rest.json["share"] == 1.0
    expect_refusal(
        cli("plan", path, "--flown", "out", "-o", "out", "--json"), 2, "--output: expected another folder than out"
    )


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


def test_an_edited_waypoint_is_no_longer_proven(cli: Cli, copied: Path) -> None:
    path = round_folder(copied, 1) / "plan.json"
    document = json.loads(path.read_text())
    waypoint = document["vehicles"][0]["waypoints"][1]
    waypoint["position_m"][2] -= 25.0
    path.write_text(json.dumps(document))
    checked = cli("check", copied, "--json")
    assert checked.code in (2, 3), checked.out
    assert cli("fly", copied, "--json").code in (2, 3)


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
