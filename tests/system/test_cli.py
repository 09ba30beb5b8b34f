"""The real command line, in process: wrong input gives one clear line and an exit code, and leaves nothing behind."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rasterio.transform import Affine

from adapters import fleet_link
from adapters.endpoint import open_endpoint
from missionplanner.geodesy import FloatArray
from missionplanner.plan_folder import PLAN_NAME
from tests.command_line import Cli, expect_refusal
from tests.main_job import plan_into
from tests.rasters import hill, hill_in, write_tif
from tests.scenes import at, copter, hilly, mission_file, question, scene_of

MAST = {"kind": "cylinder", "name": "mast", "center": at(150, 0), "radius_m": 5}


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan folder of two copters on level ground; not to be changed."""
    return _planned(tmp_path_factory.mktemp("planned"), question())


@pytest.fixture(scope="module")
def planned_over_hill(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan folder of one copter over a hill read from a file; not to be changed."""
    folder = tmp_path_factory.mktemp("hill")
    return _planned(folder, hilly(folder))


def _planned(folder: Path, data: dict[str, Any]) -> Path:
    plan_into(folder / "plan", scene_of(data, folder))
    return folder / "plan"


def edited(planned: Path, folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Return a copy of a plan folder with something changed in its plan.json."""
    copy = Path(shutil.copytree(planned, folder / "edited"))
    document = json.loads((copy / PLAN_NAME).read_text())
    change(document)
    (copy / PLAN_NAME).write_text(json.dumps(document))
    return copy


def field(data: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Return the mission with one field set, ``path`` like ``vehicles.0.goal.x_m``."""
    changed = json.loads(json.dumps(data))
    *parents, last = [int(step) if step.isdigit() else step for step in path.split(".")]
    at_field = changed
    for step in parents:
        at_field = at_field[step]
    at_field[last] = value
    return dict(changed)


def without(data: dict[str, Any], *path: str | int) -> dict[str, Any]:
    changed = json.loads(json.dumps(data))
    at_field = changed
    for step in path[:-1]:
        at_field = at_field[step]
    del at_field[path[-1]]
    return dict(changed)


# --- wrong missions

WRONG_MISSIONS = {
    "missing field": (
        without(question(), "vehicles", 1, "goal"),
        ["vehicles[1].goal", "expected this field, got none"],
    ),
    "misspelt field": (question(obstacels=[]), ["'obstacels'", "did you mean obstacles?"]),
    "a time without its zone": (
        question(fleet={"arrival_utc": "2030-01-01T10:00:00"}),
        ["fleet.arrival_utc", "date, time and zone"],
    ),
    "an order of others": (
        question(fleet={"arrival_order": ["alpha", "brave"], "arrival_spacing_s": 5}),
        ["fleet.arrival_order", "'brave'", "did you mean bravo?"],
    ),
    "one named twice": (
        question(fleet={"arrival_order": ["alpha", "alpha"], "arrival_spacing_s": 5}),
        ["fleet.arrival_order", "'alpha' twice"],
    ),
    "an order at one time": (question(fleet={"arrival_order": ["alpha", "bravo"]}), ["arrival_spacing_s above 0"]),
    "spacing of ages": (
        question(fleet={"arrival_order": ["alpha", "bravo"], "arrival_spacing_s": 1e9}),
        ["fleet.arrival_spacing_s", "86400"],
    ),
    "a date before all": (question(fleet={"arrival_utc": "0001-01-01T00:00:00+14:00"}), ["fleet.arrival_utc"]),
    "a meeting between places": (
        question(fleet={"rendezvous": [{"name": "line", "at": {"alpha": 1.5, "bravo": 0}}]}),
        ["fleet.rendezvous[0].at", "alpha: expected a number (0, 1, ...)", "got 1.5"],
    ),
    "spacing without order": (question(fleet={"arrival_spacing_s": 5}), ["fleet.arrival_spacing_s", "arrival_order"]),
    "a clock without a common arrival": (
        question(fleet={"arrive_together": False, "arrival_utc": "2030-01-01T10:00:00Z"}),
        ["fleet.arrival_utc", "arrive_together"],
    ),
    "a meeting with nobody": (
        question(fleet={"rendezvous": [{"name": "line", "at": {"alpha": 0, "charly": 0}}]}),
        ["fleet.rendezvous[0].at", "'charly'"],
    ),
    "misspelt inside": (field(question(), "vehicles.0.sped_m_s", 3), ["vehicles[0]", "did you mean speed_m_s?"]),
    "speeds reversed": (
        field(question(), "vehicles.1.speed_m_s", {"min": 12, "max": 4}),
        ["vehicles[1].speed_m_s", "min 12", "max 4"],
    ),
    "start inside an obstacle": (
        question(
            copter("alpha", (150, 0), (300, 0), start=at(150, 0, agl=40)),
            obstacles=[{**MAST, "top_height_agl_m": 80}],
        ),
        ["vehicles[0].start (alpha)", "obstacle mast", "5.0 m inside it"],
    ),
    "start under the ground": (
        question(copter("alpha", (0, 0), (300, 0), start=at(0, 0, amsl=90))),
        ["vehicles[0].start (alpha)", "10.0 m below it", "raise it by 35.0 m"],
    ),
    "two with one start": (
        question(
            copter("alpha", (0, 0), (300, 0), start=at(20, 0, agl=40)),
            copter("bravo", (0, 60), (300, 60), start=at(20, 0, agl=40)),
        ),
        ["start", "alpha", "bravo", "the same place"],
    ),
    "two with one home": (
        question(copter("alpha", (0, 0), (300, 0)), copter("bravo", (0, 0), (300, 60))),
        ["home", "alpha", "bravo", "the same place"],
    ),
    "negative radius": (question(obstacles=[MAST | {"radius_m": -5}]), ["obstacles[0].radius_m", "above 0", "-5"]),
    "unknown algorithm": (
        question(planner={"algorithm": "pso-abc-as"}),
        ["pso-abc-as", "did you mean", "pso-abc-sa"],
    ),
}


@pytest.mark.parametrize("command", ["validate", "plan", "fly"])
@pytest.mark.parametrize("wrong", WRONG_MISSIONS)
def test_a_wrong_mission_is_told_in_one_line(cli: Cli, tmp_path: Path, wrong: str, command: str) -> None:
    data, expected = WRONG_MISSIONS[wrong]
    path = mission_file(tmp_path, data)
    output = [] if command == "validate" else ["-o", "out"]
    outcome = cli(command, path, *output, "--json")
    expect_refusal(outcome, 2, str(path), *expected)
    assert outcome.json["error"]["exit_code"] == 2
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("written", [".nan", ".inf", "-.inf", "1.0e400"])
@pytest.mark.parametrize("place", ["x_m: 0,", "alt_amsl_m: 100"])
def test_nan_and_infinity_are_told_with_their_line(cli: Cli, tmp_path: Path, written: str, place: str) -> None:
    text = "name: endless\norigin: {lat_deg: 34.35, lon_deg: -118.2}\n" + (
        "terrain: {kind: flat, alt_amsl_m: 100}\n"
        "vehicles: [{name: alpha, home: {x_m: 0, y_m: 0}, goal: {x_m: 300, y_m: 0, height_agl_m: 40}}]\n"
    ).replace(place, place.partition(":")[0] + f": {written}" + ("," if place.endswith(",") else ""), 1)
    path = tmp_path / "mission.yaml"
    path.write_text(text)
    line = 3 if place.startswith("alt") else 4
    expect_refusal(cli("plan", path, "-o", "out", "--json"), 2, f"{path}:{line}: ", "expected a finite number")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "got an empty file"),
        (b"\xff\xfe\x00", "expected UTF-8"),
        (b"name: [1, 2", "YAML"),
        (b"name: a\nname: b\n", "name"),
        (b"- 1\n- 2\n", "got a list"),
    ],
)
def test_a_file_that_is_no_mission_is_told_in_one_line(cli: Cli, tmp_path: Path, content: bytes, expected: str) -> None:
    path = tmp_path / "mission.yaml"
    path.write_bytes(content)
    expect_refusal(cli("validate", path, "--json"), 2, str(path), expected)


def test_a_mission_that_is_not_there(cli: Cli) -> None:
    expect_refusal(cli("plan", "nowhere.yaml", "--json"), 2, "nowhere.yaml", "No such file")
    expect_refusal(cli("fly", "nowhere.yaml"), 2, "nowhere.yaml", "No such file")


# --- terrain


def test_a_goal_outside_the_terrain(cli: Cli, tmp_path: Path) -> None:
    data = field(hilly(tmp_path), "vehicles.0.goal", at(9000, 0, amsl=1200))
    path = mission_file(tmp_path, data)
    expect_refusal(cli("plan", path, "-o", "out"), 2, str(path), "vehicles[0].goal (alpha)", "hill.tif")
    assert not (tmp_path / "out").exists()


def test_terrain_that_is_not_there(cli: Cli, tmp_path: Path) -> None:
    path = mission_file(tmp_path, question(terrain={"kind": "raster", "file": "nowhere.tif"}))
    expect_refusal(cli("plan", path, "-o", "out"), 2, str(path), "nowhere.tif")


@pytest.mark.parametrize("content", [b"", b"not a raster at all", b"II*\x00\x08\x00\x00\x00"])
def test_terrain_that_is_no_raster(cli: Cli, tmp_path: Path, content: bytes) -> None:
    (tmp_path / "hill.tif").write_bytes(content)
    path = mission_file(tmp_path, question(terrain={"kind": "raster", "file": "hill.tif"}))
    expect_refusal(cli("plan", path, "-o", "out"), 2, str(path), "hill.tif")


def test_terrain_with_voids_along_the_way(cli: Cli, tmp_path: Path) -> None:
    data = hilly(tmp_path)

    def with_hole(heights: FloatArray) -> FloatArray:
        rows, columns = heights.shape
        heights[rows // 2 - 10 : rows // 2 + 10, columns // 2 - 20 : columns // 2 - 14] = -9999.0
        return heights

    hill_in(tmp_path / "hill.tif", "EPSG:32611", 20.0, change=with_hole, nodata=-9999.0)
    path = mission_file(tmp_path, data)
    expect_refusal(cli("plan", path, "-o", "out"), 2, str(path), "void", "hill.tif")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("crs", "cell"), [("EPSG:4326", 2e-4), ("EPSG:3857", 25.0)])
def test_terrain_in_another_coordinate_system_works(cli: Cli, tmp_path: Path, crs: str, cell: float) -> None:
    data = hilly(tmp_path)
    hill_in(tmp_path / "hill.tif", crs, cell)
    outcome = cli("plan", mission_file(tmp_path, data), "-o", "out", "--json")
    assert outcome.code == 0, outcome.err
    (vehicle,) = outcome.json["vehicles"]
    (terrain,) = [c for c in vehicle["clearances"] if c["to"] == "terrain"]
    assert terrain["ok"]
    goal = json.loads((tmp_path / "out" / PLAN_NAME).read_text())["vehicles"][0]["waypoints"][-1]
    assert goal["alt_amsl_m"] == pytest.approx(float(hill(0.0, 50.0)) + 40.0, abs=0.3)


def test_a_raster_without_coordinate_system(cli: Cli, tmp_path: Path) -> None:
    data = hilly(tmp_path)
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 20.0, write_crs=None)
    expect_refusal(cli("validate", mission_file(tmp_path, data)), 2, "hill.tif", "coordinate reference system")


def test_a_raster_of_nothing_but_voids(cli: Cli, tmp_path: Path) -> None:
    data = hilly(tmp_path)
    write_tif(
        tmp_path / "hill.tif",
        np.full((200, 200), np.nan, dtype=np.float32),
        Affine(1e-3, 0.0, -118.3, 0.0, -1e-3, 34.4),
        "EPSG:4326",
        nodata=np.nan,
    )
    expect_refusal(cli("validate", mission_file(tmp_path, data)), 2, "hill.tif")


# --- no plan


def test_windows_that_do_not_meet_say_who_is_too_early_and_what_helps(cli: Cli, tmp_path: Path) -> None:
    data = question(
        copter("tortoise", (0, 0), (1500, 0), speed_m_s={"min": 2, "max": 4}),
        copter("hare", (0, 60), (300, 60), speed_m_s={"min": 9, "max": 10}),
        fleet={"lose_time_by": "detour"},
        area={"south_west": at(-50, -50), "north_east": at(1550, 80)},  # no room for one
    )
    outcome = cli("plan", mission_file(tmp_path, data), "-o", "out", "--json")
    expect_refusal(outcome, 3, "hare cannot take longer", "let it start later (fleet.lose_time_by)")
    assert not any((tmp_path / "out").iterdir())


def test_an_arrival_asked_for_too_early_names_the_earliest(cli: Cli, tmp_path: Path) -> None:
    data = question(fleet={"arrival_time_s": 20})
    expect_refusal(cli("plan", mission_file(tmp_path, data), "-o", "out"), 3, "arrival_time_s", "too early", "at least")


@pytest.mark.parametrize(
    ("ahead_s", "told"), [(-3600.0, "UTC is past; the earliest arrival"), (15.0, "is too soon: the fleet flies")]
)
def test_an_arrival_by_the_clock_that_cannot_be_names_the_earliest(
    cli: Cli, tmp_path: Path, ahead_s: float, told: str
) -> None:
    clock = datetime.now(UTC) + timedelta(seconds=ahead_s)
    data = question(fleet={"arrival_utc": clock.isoformat()})
    expect_refusal(cli("plan", mission_file(tmp_path, data), "-o", "out"), 3, "fleet.arrival_utc", told, "earliest")
    assert not (tmp_path / "out" / PLAN_NAME).exists()


def test_an_arrival_by_the_clock(cli: Cli, tmp_path: Path) -> None:
    text = mission_file(tmp_path, question()).read_text()
    clock = (datetime.now(UTC) + timedelta(hours=1)).strftime("%Y-%m-%dT%H:%M:%SZ")
    path = tmp_path / "clock.yaml"
    path.write_text(text.rstrip()[:-1] + f", fleet: {{arrival_utc: {clock}}}}}\n")  # unquoted, as people write it
    assert cli("plan", path, "-o", "out").code == 0


def test_a_goal_that_is_walled_in_is_infeasible(cli: Cli, tmp_path: Path) -> None:
    # a square ring of four walls without limit of height around the goal, room enough inside
    walls = [
        {"kind": "no_fly", "name": name, "polygon": [at(w, s), at(e, s), at(e, n), at(w, n)]}
        for name, w, s, e, n in [
            ("west", 240, -60, 245, 60),
            ("east", 355, -60, 360, 60),
            ("south", 240, -60, 360, -55),
            ("north", 240, 55, 360, 60),
        ]
    ]
    area = {"south_west": at(-50, -100), "north_east": at(400, 100)}
    data = question(copter("alpha", (0, 0), (300, 0)), obstacles=walls, area=area)
    expect_refusal(cli("plan", mission_file(tmp_path, data), "-o", "out"), 3, "alpha")
    assert not any((tmp_path / "out").iterdir())


# --- places that cannot be written


@pytest.mark.parametrize("command", ["plan", "fly"])
def test_a_folder_below_a_file_cannot_be_written(cli: Cli, tmp_path: Path, command: str) -> None:
    path = mission_file(tmp_path, question())
    expect_refusal(cli(command, path, "-o", path / "out", "--json"), 2, "expected a folder that can be written to")
    expect_refusal(cli(command, path, "-o", path, "--json"), 2, "expected a folder that can be written to")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="no /proc here")
def test_a_folder_that_the_system_refuses(cli: Cli, tmp_path: Path) -> None:
    path = mission_file(tmp_path, question())
    expect_refusal(cli("plan", path, "-o", "/proc/here"), 2, "/proc/here", "expected a folder that can be written to")


def test_an_export_that_cannot_be_written(cli: Cli, planned: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    expect_refusal(cli("export", planned, "-o", tmp_path / "file" / "out", "--json"), 2, str(tmp_path / "file"))
    assert (tmp_path / "file").read_text() == ""


# --- plan folders


def test_no_plan_there(cli: Cli, tmp_path: Path) -> None:
    for command in ("fly", "export", "report"):
        expect_refusal(cli(command, tmp_path, "--json"), 2, str(tmp_path / PLAN_NAME), "plan a mission first")
    expect_refusal(cli("export", tmp_path / "nowhere"), 2, "plan a mission first")


@pytest.mark.parametrize("command", ["export", "fly", "report", "upload"])
@pytest.mark.parametrize("keep", [0, 1, 700, -1, -20])
def test_a_truncated_plan(cli: Cli, planned: Path, tmp_path: Path, command: str, keep: int) -> None:
    copy = Path(shutil.copytree(planned, tmp_path / "edited"))
    text = (copy / PLAN_NAME).read_text().rstrip()
    (copy / PLAN_NAME).write_text(text[:keep])
    connect = ["--connect", "udpin:127.0.0.1:0"] if command == "upload" else []
    outcome = cli(command, copy, *connect, "--json")
    expect_refusal(outcome, 2, str(copy / PLAN_NAME), "damaged", "plan the mission again")


def test_a_plan_of_bytes_that_are_no_text(cli: Cli, planned: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(planned, tmp_path / "edited"))
    (copy / PLAN_NAME).write_bytes(b"\x00\xff" * 500)
    expect_refusal(cli("fly", copy), 2, str(copy / PLAN_NAME), "plan the mission again")


def _set(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        document.update(field(document, path, value))

    return change


CORRUPT_PLANS: dict[str, tuple[Callable[[dict[str, Any]], object], list[str]]] = {
    "another version": (_set("version", 1), ["version"]),
    "another format": (_set("format", "qgc-plan"), ["format"]),
    "no vehicles": (_set("vehicles", []), ["expected plans for alpha, bravo"]),
    "vehicles swapped": (lambda d: d["vehicles"].reverse(), ["expected plans for alpha, bravo"]),
    "a word for a number": (_set("vehicles.0.waypoints.1.speed_m_s", "fast"), ["waypoints.1.speed_m_s"]),
    "not a number": (_set("vehicles.0.waypoints.0.position_m.2", float("nan")), ["vehicles.0.waypoints.0.position_m"]),
    "infinity": (_set("vehicles.0.path_m.3.1", float("inf")), ["vehicles.0.path_m.3.1"]),
    "one waypoint": (lambda d: d["vehicles"][0]["waypoints"].pop(), ["vehicles.0.waypoints"]),
    "a negative delay": (_set("vehicles.0.start_delay_s", -1), ["vehicles.0.start_delay_s"]),
    "no mission": (lambda d: d.pop("mission"), ["mission"]),
    "mission edited": (_set("mission.vehicles.0.goal.height_agl_m", 45), ["sha256", "plan the mission again"]),
    "mission broken": (_set("mission.vehicles.0.goal.height_agl_m", "high"), ["goal.height_agl_m"]),
    "a start nowhere": (_set("vehicles.0.waypoints.0.position_m", [40, 0, 140]), ["alpha", "the top of the take-off"]),
    "a goal elsewhere": (_set("vehicles.0.waypoints.1.position_m", [290, 0, 140]), ["alpha", "goal"]),
    "a speed it may not fly": (_set("vehicles.1.waypoints.1.speed_m_s", 25.0), ["bravo", "25", "10"]),
    "a crawl of months": (_set("vehicles.1.waypoints.1.speed_m_s", 1e-6), ["bravo", "1e-06", "3"]),
    "a waypoint beyond the moon": (_set("vehicles.0.waypoints.0.position_m", [0, 0, 4e8]), ["position_m"]),
}


@pytest.mark.parametrize("corrupt", CORRUPT_PLANS)
def test_a_corrupt_plan(cli: Cli, planned: Path, tmp_path: Path, corrupt: str) -> None:
    change, expected = CORRUPT_PLANS[corrupt]
    copy = edited(planned, tmp_path, change)
    before = sorted(copy.rglob("*"))
    expect_refusal(cli("fly", copy, "--json"), 2, str(copy), *expected)
    assert sorted(copy.rglob("*")) == before


@pytest.mark.parametrize("command", ["export", "fly"])
def test_a_waypoint_edited_into_a_hill(cli: Cli, planned_over_hill: Path, tmp_path: Path, command: str) -> None:
    def through_the_hill(document: dict[str, Any]) -> None:
        first, last = document["vehicles"][0]["waypoints"]
        into = dict(last, position_m=[-200.0, 25.0, 740.0])
        document["vehicles"][0]["waypoints"] = [first, into, last]

    assert hill(-200.0, 25.0) > 725
    copy = edited(planned_over_hill, tmp_path, through_the_hill)
    stale = "not proven" if command == "export" else "of other missions than those that would be sent: check the plan"
    expect_refusal(cli(command, copy, "--json"), 3, str(copy), stale)
    outcome = cli("check", copy)
    assert outcome.code == 3
    assert "alpha: item 4: terrain clearance is" in outcome.err
    assert "expected 20 m: raise waypoint 4 or the one before it by" in outcome.err
    expect_refusal(cli(command, copy, "--json"), 3, str(copy), "not proven", "alpha", "terrain", "expected 20 m")
    assert not (copy / "flight.json").exists()


def test_terrain_changed_under_a_plan(cli: Cli, planned_over_hill: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(planned_over_hill, tmp_path / "edited"))
    hill_in(copy / "terrain.tif", "EPSG:32611", 20.0, change=lambda h: h + 1.0)
    expect_refusal(cli("fly", copy), 2, str(copy / PLAN_NAME), "sha256")
    (copy / "terrain.tif").unlink()
    expect_refusal(cli("fly", copy), 2, "terrain.tif")


def test_a_plan_folder_takes_no_seed(cli: Cli, planned: Path) -> None:
    expect_refusal(cli("fly", planned, "--seed", "3"), 2, "is a plan already")
    expect_refusal(cli("fly", planned, "-o", "elsewhere"), 2, "is a plan already")


# --- links


class _Hurried:
    """A wall clock for which waiting takes no time."""

    def __init__(self, endpoints: object) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        return self._now_s

    def wait(self, seconds: float) -> None:
        self._now_s += seconds


@pytest.mark.parametrize("command", ["upload", "fly"])
def test_a_connection_that_nobody_answers(
    cli: Cli, planned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr(fleet_link, "WallClock", _Hurried)
    copy = Path(shutil.copytree(planned, tmp_path / "copy"))
    outcome = cli(command, copy, "--connect", "udpin:127.0.0.1:0", "--json")
    expect_refusal(outcome, 4, "udpin:127.0.0.1", "alpha (sysid 1), bravo (sysid 2)", "nobody answered")
    assert outcome.json["error"]["exit_code"] == 4
    assert not (copy / "flight.json").exists()


def test_a_port_that_nobody_listens_on(cli: Cli, planned: Path, tmp_path: Path) -> None:
    with closing(open_endpoint("tcpin:127.0.0.1:0")) as server:
        free = server.url.replace("tcpin", "tcp")
    copy = Path(shutil.copytree(planned, tmp_path / "copy"))
    expect_refusal(cli("fly", copy, "--connect", free), 4, "127.0.0.1", "refused")
    expect_refusal(cli("upload", copy, "--connect", "carrier-pigeon"), 4, "carrier-pigeon", "udpin:")


def test_options_that_contradict_each_other(cli: Cli, planned: Path) -> None:
    expect_refusal(cli("fly", planned, "--connect", "udpin:127.0.0.1:0", "--speedup", "2"), 2, "--speedup")
    expect_refusal(cli("sim", "--home", "47,8,500"), 2, "--connect", "--listen")
    for wrong in ("here", "47,8", "nan,8,500", "47,8,inf", "91,0,0"):
        expect_refusal(cli("sim", "--home", wrong, "--connect", "udpout:127.0.0.1:9"), 2, "--home", wrong)
    link = ("sim", "--home", "47,8,500", "--connect", "udpout:127.0.0.1:9")
    for wrong in ("30", "5,-1", "a,b", "0,inf"):
        expect_refusal(cli(*link, "--down", wrong), 2, "--down", wrong)


def test_no_link_at_all(cli: Cli, planned: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(planned, tmp_path / "copy"))
    expect_refusal(cli("fly", copy, "--connect", " , ", "--json"), 2, "--connect", "expected at least one URL")


@pytest.mark.parametrize("wrong", [["plan"], ["plan", "a", "b"], ["plan", "a", "--sed", "3"], ["sim"], ["fli", "a"]])
def test_wrong_usage_is_told_to_machines_too(cli: Cli, wrong: list[str]) -> None:
    outcome = cli(*wrong, "--json")
    assert outcome.code == 2
    assert "Traceback" not in outcome.err
    assert "Usage: " in outcome.err
    assert outcome.json["error"]["exit_code"] == 2


# --- what works


def test_plan_says_what_it_wrote(cli: Cli, tmp_path: Path) -> None:
    path = mission_file(tmp_path, question())
    outcome = cli("plan", path, "-o", "out", "--seed", "5", "--json")
    assert outcome.code == 0
    assert outcome.err == ""
    summary = outcome.json
    assert (summary["mission"], summary["seed"]) == ("small", 5)
    assert [v["name"] for v in summary["vehicles"]] == ["alpha", "bravo"]
    assert summary["fleet"]["clear"] is True
    document = json.loads(Path(summary["plan"]).read_text())
    assert document["seed"] == 5
    assert {p.name for p in Path(summary["files"]).iterdir()} == {
        "alpha.plan", "alpha.waypoints", "bravo.plan", "bravo.waypoints", "fleet.kml", "fleet.geojson",
    }  # fmt: skip


def test_without_an_output_folder_the_mission_names_it(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("plan", mission_file(tmp_path, question()))
    assert outcome.code == 0
    assert (tmp_path / "out" / "small" / PLAN_NAME).is_file()
    assert "alpha" in outcome.out
    assert str(Path("out") / "small" / PLAN_NAME) in outcome.out


def test_another_algorithm_by_option(cli: Cli, tmp_path: Path) -> None:
    path = mission_file(tmp_path, question())
    assert cli("plan", path, "-o", "out", "--algorithm", "pso").code == 0
    assert json.loads((tmp_path / "out" / PLAN_NAME).read_text())["mission"]["planner"]["algorithm"] == "pso"
    expect_refusal(
        cli("plan", path, "-o", "other", "--algorithm", "psso", "--json"), 2, "'psso'", "did you mean pso or"
    )
    assert not (tmp_path / "other").exists()


def test_a_new_plan_takes_the_old_ones_place_and_nothing_elses(cli: Cli, tmp_path: Path) -> None:
    files = tmp_path / "out" / "files"
    files.mkdir(parents=True)
    (files / "mine.plan").write_text("drawn by hand")
    path = mission_file(tmp_path, question())
    assert cli("plan", path, "-o", "out").code == 0
    assert (files / "mine.plan").read_text() == "drawn by hand"
    path = mission_file(tmp_path, question(copter("charlie", (0, 0), (300, 0))))
    assert cli("plan", path, "-o", "out").code == 0
    assert {p.name for p in files.iterdir()} >= {"charlie.plan", "charlie.waypoints"}
    assert not (files / "alpha.plan").exists()
    assert not (files / "bravo.waypoints").exists()


def test_validate_says_what_it_saw(cli: Cli, tmp_path: Path) -> None:
    path = mission_file(tmp_path, question(obstacles=[MAST | {"center": at(150, 30)}]))
    outcome = cli("validate", path)
    assert (outcome.code, outcome.err) == (0, "")
    assert "2 vehicles, 1 obstacles" in outcome.out
    assert cli("validate", path, "--json").json == {"mission": "small", "vehicles": ["alpha", "bravo"], "valid": True}


def test_export_writes_the_same_files_again(cli: Cli, planned: Path, tmp_path: Path) -> None:
    outcome = cli("export", planned, "-o", tmp_path / "again", "--json")
    assert outcome.code == 0
    paths = [Path(path) for path in outcome.json["files"]]
    assert len(paths) == 6
    for path in paths:
        assert path.read_bytes() == (planned / "files" / path.name).read_bytes()


def test_schema_is_a_json_schema(cli: Cli) -> None:
    outcome = cli("schema")
    assert outcome.code == 0
    assert outcome.json["$schema"].startswith("https://json-schema.org/")
    assert "vehicles" in outcome.json["required"]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_fly_plans_uploads_flies_and_reports(cli: Cli, tmp_path: Path, autopilot: str) -> None:
    path = mission_file(tmp_path, question(defaults={"autopilot": autopilot}))
    outcome = cli("fly", path, "-o", "out", "--json")
    assert outcome.code == 0, outcome.err
    fleet = outcome.json["fleet"]
    assert fleet["flown_clear"] is True
    assert fleet["flown_arrival_spread_s"] < 1.0
    for vehicle in outcome.json["vehicles"]:
        assert vehicle["flown_arrival_s"] == pytest.approx(vehicle["arrival_s"], abs=2.0)
    folder = tmp_path / "out"
    assert (folder / "report.html").read_text().startswith("<!DOCTYPE html>")
    assert {p.suffix for p in (folder / "logs").iterdir()} == {".tlog"}
    # and once more, what is in the folder now
    again = cli("fly", folder, "--json")
    assert again.json["fleet"] == fleet


def test_the_same_mission_and_seed_give_the_same_bytes_in_another_process(cli: Cli, tmp_path: Path) -> None:
    mast = MAST | {"center": at(150, 5), "top_height_agl_m": 120}
    path = mission_file(tmp_path, question(obstacles=[mast]))
    assert cli("plan", path, "-o", "here", "--seed", "7").code == 0
    command = [sys.executable, "-c", "from missionplanner.cli import main; main()"]
    subprocess.run([*command, "plan", path, "-o", "there", "--seed", "7"], check=True, capture_output=True)
    assert (tmp_path / "here" / PLAN_NAME).read_bytes() == (tmp_path / "there" / PLAN_NAME).read_bytes()
    for path_here in (tmp_path / "here" / "files").iterdir():
        assert path_here.read_bytes() == (tmp_path / "there" / "files" / path_here.name).read_bytes()
