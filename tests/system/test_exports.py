"""Files for other apps, and reports for crews, from the command line."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from missionplanner.plan_folder import PLAN_NAME
from tests.command_line import Cli, expect_refusal
from tests.main_job import plan_into
from tests.scenes import at, copter, mission_file, question, scene_of


def looking() -> dict[str, Any]:
    """Return a mission of which one vehicle stands, looks at a tower and takes photos."""
    stop = {
        "name": "T01.left", "inspects": "T01", **at(150, 40, agl=40), "look_at": at(150, 90, agl=30), "hold_s": 2,
        "photos": 1,
    }  # fmt: skip
    return question(
        copter("alpha", (0, 0), (300, 0), stops=[stop], endurance_s=1200), copter("bravo", (0, -60), (300, -60))
    )


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("planned")
    plan_into(folder, scene_of(looking(), folder), seed=1)
    return folder


def test_routes_are_written_and_their_limits_told(cli: Cli, planned: Path, tmp_path: Path) -> None:
    outcome = cli("export", planned, "-o", "routes", "--format", "dji,litchi", "--dji-aircraft", "m3t")
    assert outcome.code == 0, outcome.err
    names = ["alpha.kmz", "alpha-litchi.csv", "bravo.kmz", "bravo-litchi.csv"]
    assert outcome.out.split() == [f"routes/{name}" for name in names]
    assert sorted(path.name for path in (tmp_path / "routes").iterdir()) == sorted(names)
    assert outcome.err.count("NOT PROVEN") == 2
    assert "Mavic 3T" in outcome.err
    with zipfile.ZipFile(tmp_path / "routes" / "alpha.kmz") as archive:
        text = archive.read("wpmz/waylines.wpml").decode()
    ET.fromstring(text)
    assert "<wpml:fileSuffix>T01-left</wpml:fileSuffix>" in text
    assert "<wpml:hoverTime>2</wpml:hoverTime>" in text


def test_a_plan_exports_as_before_unless_asked_otherwise(cli: Cli, planned: Path) -> None:
    outcome = cli("export", planned, "-o", "files", "--json")
    names = [Path(name).name for name in outcome.json["files"]]
    assert names == ["alpha.plan", "alpha.waypoints", "bravo.plan", "bravo.waypoints", "fleet.kml", "fleet.geojson"]
    assert outcome.json["remarks"] == []
    assert outcome.err == ""


def test_unknown_formats_and_aircraft_are_refused(cli: Cli, planned: Path, tmp_path: Path) -> None:
    expect_refusal(cli("export", planned, "--format", "djii", "--json"), 2, "--format", "did you mean dji?")
    outcome = cli("export", planned, "--format", "dji", "--dji-aircraft", "m3")
    expect_refusal(outcome, 2, "--dji-aircraft", "'m3'")
    assert not list(tmp_path.iterdir())


def test_a_plan_that_is_not_proven_is_not_exported(cli: Cli, planned: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(planned, copy)
    data = json.loads((copy / PLAN_NAME).read_text())
    for vehicle in data["vehicles"]:
        vehicle["return_height_m"] = 0.5
    (copy / PLAN_NAME).write_text(json.dumps(data))
    expect_refusal(cli("export", copy, "-o", "out", "--format", "dji"), 3, "not proven", "nothing was written")
    assert not (tmp_path / "out").exists()


def test_routes_of_an_earlier_plan_do_not_stay(cli: Cli, tmp_path: Path) -> None:
    mission = mission_file(tmp_path, looking())
    assert cli("plan", mission, "-o", "out").code == 0
    assert cli("export", "out", "--format", "dji,litchi").code == 0
    files = tmp_path / "out" / "files"
    (files / "own.csv").write_text("somebody's own")
    assert (files / "bravo.kmz").exists()
    assert cli("plan", mission, "-o", "out", "--seed", "2").code == 0
    assert {path.suffix for path in files.iterdir()} == {".plan", ".waypoints", ".kml", ".geojson", ".csv"}
    assert (files / "own.csv").read_text() == "somebody's own"
    assert not list(files.glob("*-litchi*"))


def test_every_crew_gets_its_page(cli: Cli, planned: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(planned, copy)
    outcome = cli("report", copy, "--json")
    assert outcome.json == {"report": str(copy / "report.html")}
    pages = sorted(path.name for path in copy.glob("report-*.html"))
    assert pages == ["report-alpha.html", "report-bravo.html"]
    said = (copy / "report-alpha.html").read_text(encoding="utf-8")
    assert "T01.left" in said
    assert "Proven" in said
    assert 'href="report-alpha.html"' in (copy / "report.html").read_text(encoding="utf-8")
