"""``check``, and what ``upload`` and ``fly`` do without a valid certificate, by the command line."""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters import certificates, fleet_link
from adapters.endpoint import open_endpoint
from adapters.mission_items import MissionItem, degrees_to_wire
from adapters.telemetry_log import read_log
from missionplanner.plan_folder import CERTIFICATE_NAME, FLIGHT_NAME, PLAN_NAME
from sim.fleet import SimFleet, SimVehicle, connect_fleet, serve
from tests.command_line import Cli, Outcome, expect_line, expect_refusal
from tests.main_job import plan_into
from tests.rasters import FRAME, hill, hill_in
from tests.scenes import ORIGIN, at, copter, mission_file, question, scene_of

TAKEOFF, WAYPOINT, LAND, RTL = 22, 16, 21, 20
AMSL, RELATIVE, NO_FRAME, TERRAIN = 0, 3, 2, 10
NOBODY = "udpin:127.0.0.1:0"

Row = tuple[int, int, tuple[float, float, float, float], float, float, float]
"""Frame, command, four parameters, x and y in metres (0, 0 of a command without a place: none), altitude."""


def row(command: int, x_m: float = 0.0, y_m: float = 0.0, z: float = 0.0, frame: int = RELATIVE, **p: float) -> Row:
    return frame, command, (p.get("p1", 0.0), p.get("p2", 0.0), p.get("p3", 0.0), p.get("p4", 0.0)), x_m, y_m, z


def degrees(x_m: float, y_m: float) -> tuple[float, float]:
    point = FRAME.geo_point([x_m, y_m, 0.0])
    return round(point.lat_deg, 7), round(point.lon_deg, 7)


SOUND = [row(TAKEOFF, z=40.0), row(WAYPOINT, 150, 10, 40.0), row(WAYPOINT, 300, 0, 45.0), row(RTL, frame=NO_FRAME)]
"""Somebody's mission over level ground at 100 m AMSL."""


def waypoints(path: Path, rows: list[Row], home: tuple[float, float, float] | None = (0.0, 0.0, 100.0)) -> Path:
    """Write a QGC WPL 110 file as Mission Planner does; without home its row is there, but says nothing."""
    first = row(WAYPOINT, *home, frame=AMSL) if home is not None else None
    lines = ["QGC WPL 110"]
    for seq, item in enumerate([first, *rows]):
        frame, command, params, x, y, z = item if item is not None else row(WAYPOINT, frame=AMSL)
        lat, lon = (0.0, 0.0) if item is None or command in (RTL, TAKEOFF, 177, 178) else degrees(x, y)
        columns = [seq, int(seq == 0), frame, command, *params, f"{lat:.8f}", f"{lon:.8f}", f"{z:.6f}", 1]
        lines.append("\t".join(map(str, columns)))
    path.write_text("\n".join(lines) + "\n")
    return path


def plan_file(path: Path, rows: list[Row], firmware: int = 3, **parts: Any) -> Path:
    """Write a .plan file as QGroundControl does."""
    items = []
    for number, (frame, command, params, x, y, z) in enumerate(rows, start=1):
        place = (0.0, 0.0) if command in (RTL, TAKEOFF) else degrees(x, y)
        items.append(
            {
                "AMSLAltAboveTerrain": None,
                "Altitude": z,
                "AltitudeMode": 2 if frame == AMSL else 1,
                "autoContinue": True,
                "command": command,
                "doJumpId": number,
                "frame": frame,
                "params": [*params[:3], None, *place, z],
                "type": "SimpleItem",
            }
        )
    mission = {
        "cruiseSpeed": 15,
        "firmwareType": firmware,
        "globalPlanAltitudeMode": 1,
        "hoverSpeed": 5,
        "items": items,
        "plannedHomePosition": [*degrees(0.0, 0.0), 100.0],
        "vehicleType": 2,
        "version": 2,
    }
    document = {
        "fileType": "Plan",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "groundStation": "QGroundControl",
        "mission": mission,
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    }
    path.write_text(json.dumps(document | parts, indent=4))
    return path


def alone(return_height_m: float = 30.0, **changes: Any) -> dict[str, Any]:
    """Return a question of one copter on level ground, which returns high enough."""
    return question(copter("alpha", (0, 0), (300, 0), return_height_m=return_height_m), **changes)


def problems(outcome: Outcome) -> dict[str, list[dict[str, Any]]]:
    """Return what a certificate on stdout says is not proven, by check."""
    found: dict[str, list[dict[str, Any]]] = {}
    for finding in outcome.json["findings"]:
        if not (finding["proven"] or finding["waived"]):
            found.setdefault(finding["check"], []).append(finding)
    return found


def expect_proven(outcome: Outcome) -> None:
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.json["proven"] is True
    assert problems(outcome) == {}
    assert outcome.json["legs"]
    assert all(leg["proven"] for leg in outcome.json["legs"])


def expect_unproven(outcome: Outcome, check: str, *expected: str) -> dict[str, Any]:
    """Check that this is not proven, told in one line, and return the finding."""
    told = [f["detail"] + f["remedy"] for f in problems(outcome)[check]]
    expect_line(outcome, 3, "not proven: ")
    assert outcome.json["proven"] is False
    for part in expected:
        assert any(part in text for text in told), told
    return problems(outcome)[check][0]


# --- plan folders


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A proven plan folder of two copters on level ground; not to be changed."""
    folder = tmp_path_factory.mktemp("planned") / "plan"
    plan_into(folder, scene_of(question()))
    return folder


@pytest.fixture
def folder(planned: Path, tmp_path: Path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copytree(planned, tmp_path / "plan"))


def change_json(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def lower(document: dict[str, Any]) -> None:
    """Bring a waypoint of the first vehicle down to 12 m above the ground."""
    first, *others = document["vehicles"][0]["waypoints"]
    low = dict(others[0], position_m=[150.0, 5.0, 112.0])
    document["vehicles"][0]["waypoints"] = [first, low, *others]


def test_a_plan_folder_as_it_was_planned_is_proven(cli: Cli, folder: Path) -> None:
    (folder / CERTIFICATE_NAME).unlink()
    outcome = cli("check", folder, "--json")
    expect_proven(outcome)
    certificate = json.loads((folder / CERTIFICATE_NAME).read_text())
    assert outcome.json.items() >= (certificate.keys() - {"format", "version"} and {"proven": True}.items())
    assert certificate["proven"] is True
    assert set(certificate["mission_sha256"]) == {"alpha", "bravo"}
    assert {f["check"] for f in certificate["findings"]} >= {"terrain", "return", "separation", "lateness", "files"}
    assert Path(outcome.json["report"]).read_text().startswith("<!DOCTYPE html>")


def test_checking_writes_the_certificate_that_planning_did(cli: Cli, tmp_path: Path) -> None:
    assert cli("plan", mission_file(tmp_path, question()), "-o", "out").code == 0
    before = json.loads((tmp_path / "out" / CERTIFICATE_NAME).read_text())
    assert cli("check", "out").code == 0
    after = json.loads((tmp_path / "out" / CERTIFICATE_NAME).read_text())
    after["findings"] = [f for f in after["findings"] if f["check"] != "files"]
    assert after == before


def _without_certificate(folder: Path) -> None:
    (folder / CERTIFICATE_NAME).unlink()


def _waypoint_lowered(folder: Path) -> None:
    change_json(folder / PLAN_NAME, lower)


def _speed_changed(folder: Path) -> None:
    def faster(document: dict[str, Any]) -> None:
        for waypoint in document["vehicles"][0]["waypoints"][1:]:
            waypoint["speed_m_s"] = 7.5

    change_json(folder / PLAN_NAME, faster)


def _plan_file_edited(folder: Path) -> None:
    def nudge(document: dict[str, Any]) -> None:
        document["mission"]["items"][-2]["params"][6] += 1.0

    change_json(folder / "files" / "bravo.plan", nudge)


def _waypoints_file_damaged(folder: Path) -> None:
    path = folder / "files" / "alpha.waypoints"
    path.write_text(path.read_text()[:-40])


def _certificate_of_another_mission(folder: Path) -> None:
    def another(document: dict[str, Any]) -> None:
        document["input_sha256"] = "0" * 64

    change_json(folder / CERTIFICATE_NAME, another)


def _certificate_of_another_plan(folder: Path) -> None:
    def another(document: dict[str, Any]) -> None:
        document["mission_sha256"]["alpha"] = "0" * 64

    change_json(folder / CERTIFICATE_NAME, another)


def _certificate_that_says_no(folder: Path) -> None:
    change_json(folder / CERTIFICATE_NAME, lambda document: document.update(proven=False))


def _certificate_damaged(folder: Path) -> None:
    (folder / CERTIFICATE_NAME).write_text('{"proven": true')


UNCERTIFIED: dict[str, tuple[Callable[[Path], None], list[str]]] = {
    "no certificate": (_without_certificate, ["there is no", CERTIFICATE_NAME, "check the plan"]),
    "a waypoint lowered": (_waypoint_lowered, [CERTIFICATE_NAME, "of other missions", "check the plan again"]),
    "a speed changed": (_speed_changed, [CERTIFICATE_NAME, "of other missions", "check the plan again"]),
    "a .plan edited": (_plan_file_edited, ["bravo.plan is not what the plan holds", "export it again"]),
    "a .waypoints damaged": (_waypoints_file_damaged, ["alpha.waypoints", "export it again"]),
    "of another mission": (_certificate_of_another_mission, ["of another mission file or terrain"]),
    "of another plan": (_certificate_of_another_plan, ["of other missions", "check the plan again"]),
    "says no": (_certificate_that_says_no, [CERTIFICATE_NAME, "says so", "check the plan again"]),
    "damaged": (_certificate_damaged, [CERTIFICATE_NAME, "damaged", "check the plan again"]),
}


@pytest.mark.parametrize("command", ["upload", "fly"])
@pytest.mark.parametrize("what", UNCERTIFIED)
def test_without_a_certificate_for_just_these_missions_nothing_is_sent(
    cli: Cli, folder: Path, monkeypatch: pytest.MonkeyPatch, what: str, command: str
) -> None:
    def no_link(url: object) -> None:
        raise AssertionError(f"a link to {url} was opened")

    monkeypatch.setattr("adapters.endpoint.open_endpoint", no_link)
    change, expected = UNCERTIFIED[what]
    change(folder)
    before = sorted(folder.rglob("*"))
    for connect in [["--connect", NOBODY]] if command == "upload" else [["--connect", NOBODY], []]:
        expect_refusal(cli(command, folder, *connect, "--json"), 3, str(folder), *expected, "nothing was sent")
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("command", ["upload", "fly"])
def test_a_verdict_pasted_into_a_certificate_is_not_believed(cli: Cli, folder: Path, command: str) -> None:
    _waypoint_lowered(folder)
    checked = cli("check", folder)
    assert checked.code == 3
    assert json.loads((folder / CERTIFICATE_NAME).read_text())["proven"] is False
    change_json(folder / CERTIFICATE_NAME, lambda document: document.update(proven=True, findings=[]))
    refused = cli(command, folder, "--connect", NOBODY)
    expect_refusal(
        refused, 3, "not proven: alpha: item 4: terrain clearance is 7.00 m, expected 20 m", "raise waypoint"
    )


def test_check_names_what_is_wrong_with_an_edited_plan(cli: Cli, folder: Path) -> None:
    _waypoint_lowered(folder)
    outcome = cli("check", folder, "--json")
    low = expect_unproven(outcome, "terrain", "raise waypoint 4 or the one before it by 13.0 m")
    assert (low["vehicle"], low["seq"]) == ("alpha", 4)  # after home, take-off and speed
    assert low["value"] == pytest.approx(7.0)  # 12 m, and a tube of 5 m
    assert [leg["proven"] for leg in outcome.json["legs"] if leg["vehicle"] == "alpha"].count(False) >= 1
    expect_unproven(outcome, "files", "alpha.plan is not what the plan holds")


def test_check_names_edited_files_until_they_are_exported_again(cli: Cli, folder: Path) -> None:
    _plan_file_edited(folder)
    outcome = cli("check", folder, "--json")
    assert list(problems(outcome)) == ["files"]
    expect_unproven(outcome, "files", "bravo.plan is not what the plan holds", "export it again")
    expect_refusal(cli("upload", folder, "--connect", NOBODY), 3, "bravo.plan")
    assert cli("export", folder).code == 0
    expect_proven(cli("check", folder, "--json"))


def test_an_unproven_plan_is_flown_by_order_only_and_every_record_says_so(cli: Cli, folder: Path) -> None:
    _without_certificate(folder)
    outcome = cli("fly", folder, "--unproven", "--json")
    assert outcome.code == 0, outcome.err
    assert "UNPROVEN: there is no" in outcome.err
    assert json.loads((folder / FLIGHT_NAME).read_text())["unproven"] is True
    logs = sorted((folder / "logs").glob("*.tlog"))
    assert logs
    for path in logs:
        said = [m.text for _, m in read_log(path).records if m.get_type() == "STATUSTEXT"]
        assert "UNPROVEN mission sent by order of the operator" in said, path
    # once certified, nothing is said any more
    assert cli("check", folder).code == 0
    again = cli("fly", folder, "--json")
    assert again.code == 0, again.err
    assert "UNPROVEN" not in again.err
    assert json.loads((folder / FLIGHT_NAME).read_text())["unproven"] is False


def test_wrong_usage_of_check(cli: Cli, folder: Path, tmp_path: Path) -> None:
    path = mission_file(tmp_path, alone())
    expect_refusal(cli("check"), 2, "expected one plan folder, or --mission")
    expect_refusal(cli("check", path), 2, "expected one plan folder, or --mission")
    expect_refusal(cli("check", folder, folder), 2, "expected one plan folder")
    expect_refusal(cli("check", folder, "--repair", "--json"), 2, "--repair: expected with --mission")
    expect_refusal(cli("check", folder, "--connect", NOBODY), 2, "expected with --mission")
    expect_refusal(cli("check", "--mission", path, "--json"), 2, "expected mission files (.plan, .waypoints)")
    expect_refusal(cli("check", "--mission", path, "--connect", NOBODY, "--repair"), 2, "--repair")
    expect_refusal(cli("check", "--mission", path, "a.plan", "--connect", NOBODY), 2, "expected neither files")
    expect_refusal(cli("check", tmp_path / "nowhere"), 2, "expected one plan folder")
    expect_refusal(cli("check", "--mission", "nowhere.yaml", "a.plan"), 2, "nowhere.yaml", "No such file")


def test_an_output_folder_of_a_plan_folder_is_refused(cli: Cli, folder: Path) -> None:
    expect_refusal(cli("check", folder, "-o", "elsewhere"), 2, "--output")


# --- files of any origin


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    return mission_file(tmp_path, alone())


@pytest.mark.parametrize("write", [waypoints, plan_file])
def test_somebodys_mission_is_proven(cli: Cli, tmp_path: Path, mission: Path, write: Callable[..., Path]) -> None:
    path = write(tmp_path / "theirs.txt", SOUND)
    before = path.read_bytes()
    outcome = cli("check", "--mission", mission, path, "-o", "checked", "--json")
    expect_proven(outcome)
    assert path.read_bytes() == before
    least = next(f for f in outcome.json["findings"] if f["check"] == "terrain")
    assert least["value"] == pytest.approx(35.0, abs=0.01)
    assert {p.name for p in (tmp_path / "checked").iterdir()} >= {CERTIFICATE_NAME, Path(outcome.json["report"]).name}
    shown = cli("check", "--mission", mission, path)
    assert shown.code == 0
    assert "its tube stays at least 35.00 m above the ground" in shown.out
    assert (tmp_path / "out" / "check_small" / CERTIFICATE_NAME).is_file()


def test_two_missions_belong_to_their_vehicles_by_name_or_by_place(cli: Cli, tmp_path: Path) -> None:
    mission = mission_file(tmp_path, question())
    north = [row(c, x, 60.0, z, f) for f, c, _, x, _, z in SOUND]
    bravo = waypoints(tmp_path / "bravo.waypoints", north, home=(0.0, 60.0, 100.0))
    other = plan_file(tmp_path / "theirs.plan", SOUND)
    outcome = cli("check", "--mission", mission, bravo, other, "--json")
    assert set(outcome.json["mission_sha256"]) == {"alpha", "bravo"}
    assert {f["check"] for f in outcome.json["findings"]} >= {"separation", "lateness"}
    by_home = {leg["vehicle"]: leg["start_m"][1] for leg in outcome.json["legs"] if leg["kind"] == "takeoff"}
    assert by_home == pytest.approx({"alpha": 0.0, "bravo": 60.0}, abs=0.02)
    two_alike = cli("check", "--mission", mission, other, plan_file(tmp_path / "again.plan", SOUND), "--json")
    expect_unproven(two_alike, "separation", "0.0 m apart", "expected 26 m")


def ridge(folder: Path) -> Path:
    """Write a mission file with a ridge of 60 m across the way at x = 150 m."""
    peaks = [{**at(150, y), "height_m": 60, "spread_m": 30} for y in range(-300, 301, 300)]
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100, "cell_m": 10, "peaks": peaks}
    area = {"south_west": at(-300, -300), "north_east": at(700, 300)}
    return mission_file(folder, alone(100.0, terrain=terrain, area=area))


OVER = [
    row(TAKEOFF, z=50.0), row(WAYPOINT, 20, 0, 50.0), row(WAYPOINT, 280, 0, 50.0), row(LAND, 280, 0, 0.0),
]  # fmt: skip


def test_a_leg_through_a_ridge_between_two_good_waypoints(cli: Cli, tmp_path: Path) -> None:
    path = waypoints(tmp_path / "theirs.waypoints", OVER)
    outcome = cli("check", "--mission", ridge(tmp_path), path, "--json")
    through = expect_unproven(outcome, "terrain", "raise waypoint 3 or the one before it by")
    assert through["value"] < -10.0  # 50 m less 60 m, less the tube
    assert through["position_m"][0] == pytest.approx(150.0, abs=10.0)
    assert {leg["seq"]: leg["proven"] for leg in outcome.json["legs"]}[3] is False


@pytest.mark.parametrize("suffix", ["waypoints", "plan"])
def test_a_repair_is_proven_and_shows_the_difference(cli: Cli, tmp_path: Path, suffix: str) -> None:
    write = waypoints if suffix == "waypoints" else plan_file
    path = write(tmp_path / f"theirs.{suffix}", OVER)
    before = path.read_bytes()
    mission = ridge(tmp_path)
    outcome = cli("check", "--mission", mission, path, "--repair", "-o", "fixed", "--json")
    assert outcome.code == 0, outcome.err
    assert path.read_bytes() == before
    moved = {move["seq"]: move for move in outcome.json["moved"]}
    assert set(moved) <= {1, 2, 3}
    assert moved[3]["raised_m"] > 35.0  # the ridge, its margin and the tube, less 50 m
    assert moved[3]["after"]["alt_amsl_m"] - moved[3]["before"]["alt_amsl_m"] == pytest.approx(moved[3]["raised_m"])
    repaired = tmp_path / "fixed" / f"alpha.{suffix}"
    expect_proven(cli("check", "--mission", mission, repaired, "--json"))
    shown = cli("check", "--mission", mission, path, "--repair", "-o", "fixed")
    assert f"waypoints moved: {len(moved)}" in shown.out
    assert f"{moved[3]['raised_m']:+.2f}" in shown.out


def test_what_cannot_be_repaired_leaves_nothing_half_written(cli: Cli, tmp_path: Path) -> None:
    # a copter whose goal is under a roof: nothing that moving waypoints could mend
    ceiling = alone(vehicles=[copter("alpha", (0, 0), (300, 0), height_agl_max_m=28.0)])
    mission = mission_file(tmp_path, ceiling | {"defaults": {"safety": {"terrain_m": 25}}})
    path = waypoints(tmp_path / "theirs.waypoints", [*SOUND])
    before = sorted(tmp_path.rglob("*"))
    expect_refusal(cli("check", "--mission", mission, path, "--repair", "-o", "fixed", "--json"), 3, "alpha")
    assert [p for p in sorted(tmp_path.rglob("*")) if p.is_file()] == [p for p in before if p.is_file()]


def test_a_repair_over_the_original_is_refused(cli: Cli, tmp_path: Path) -> None:
    path = waypoints(tmp_path / "alpha.waypoints", OVER)
    before = path.read_bytes()
    outcome = cli("check", "--mission", ridge(tmp_path), path, "--repair", "-o", tmp_path, "--json")
    expect_refusal(outcome, 2, str(path), "another file", "choose another folder")
    assert path.read_bytes() == before


def test_a_leg_through_an_obstacle_is_named_and_repaired(cli: Cli, tmp_path: Path) -> None:
    mast = {"kind": "cylinder", "name": "mast", "center": at(200, 0), "radius_m": 5, "top_height_agl_m": 120}
    mission = mission_file(tmp_path, alone(obstacles=[mast], fleet={"direct_return": "waived"}))
    path = waypoints(tmp_path / "theirs.waypoints", [*SOUND[:-1], row(LAND, 300, 0)])
    near = expect_unproven(cli("check", "--mission", mission, path, "--json"), "obstacle", "mast", "expected 10 m")
    assert near["to"] == "mast"
    assert cli("check", "--mission", mission, path, "--repair", "-o", "fixed").code == 0
    expect_proven(cli("check", "--mission", mission, tmp_path / "fixed" / "alpha.waypoints", "--json"))


DOUBTFUL: dict[str, tuple[list[Row], str, list[str]]] = {
    "an altitude AMSL that was meant above home": (
        [*SOUND[:1], row(WAYPOINT, 150, 10, 40.0, AMSL), *SOUND[2:]],
        "terrain",
        ["terrain clearance is -65.00 m, expected 20 m"],
    ),
    "a jump": ([*SOUND[:3], row(177, frame=NO_FRAME, p1=2.0, p2=5.0), SOUND[3]], "understood", ["DO_JUMP"]),
    "an unknown command": ([*SOUND[:3], row(31010, 200, 0, 40.0), SOUND[3]], "understood", ["31010"]),
    "an altitude above terrain": (
        [*SOUND[:1], row(WAYPOINT, 150, 10, 40.0, TERRAIN), *SOUND[2:]],
        "understood",
        ["terrain"],
    ),
    "a speed beyond the vehicle's": (
        [*SOUND[:1], row(178, frame=NO_FRAME, p1=1.0, p2=25.0, p3=-1.0), *SOUND[1:]],
        "speed",
        ["25 m/s"],
    ),
}


@pytest.mark.parametrize("what", DOUBTFUL)
def test_what_is_not_known_or_not_allowed_is_named_and_not_proven(
    cli: Cli, tmp_path: Path, mission: Path, what: str
) -> None:
    rows, check, expected = DOUBTFUL[what]
    outcome = cli("check", "--mission", mission, waypoints(tmp_path / "theirs.waypoints", rows), "--json")
    expect_unproven(outcome, check, *expected)


def test_a_place_outside_the_terrain(cli: Cli, tmp_path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 20.0)
    mission = mission_file(tmp_path, alone(terrain={"kind": "raster", "file": "hill.tif"}))
    home_m = float(hill(0.0, 0.0))
    far = [row(TAKEOFF, z=200.0), row(WAYPOINT, 9000, 0, 200.0), row(RTL, frame=NO_FRAME)]
    path = waypoints(tmp_path / "theirs.waypoints", far, home=(0.0, 0.0, home_m))
    outcome = cli("check", "--mission", mission, path, "--json")
    if outcome.code == 2:  # the place may be refused before anything is judged
        expect_refusal(outcome, 2, "hill.tif")
    else:
        expect_unproven(outcome, "terrain", "the ground below is not known")


def test_a_mission_on_the_other_side_of_the_world(cli: Cli, tmp_path: Path, mission: Path) -> None:
    path = waypoints(tmp_path / "theirs.waypoints", SOUND)
    path.write_text(path.read_text().replace("-118.", "118."))
    expect_refusal(cli("check", "--mission", mission, path, "--json"), 2, "within 100 km of the origin", "check signs")


def test_a_missing_home(cli: Cli, tmp_path: Path, mission: Path) -> None:
    path = waypoints(tmp_path / "theirs.waypoints", SOUND, home=None)
    expect_refusal(cli("check", "--mission", mission, path, "--json"), 2, "alpha", "missing home")


def test_a_home_far_above_the_ground(cli: Cli, tmp_path: Path, mission: Path) -> None:
    path = waypoints(tmp_path / "theirs.waypoints", SOUND, home=(0.0, 0.0, 148.0))
    outcome = cli("check", "--mission", mission, path, "--json")
    expect_unproven(outcome, "understood", "lies 48 m above the terrain's ground")


def test_more_files_than_vehicles(cli: Cli, tmp_path: Path, mission: Path) -> None:
    paths = [waypoints(tmp_path / f"{k}.waypoints", SOUND) for k in range(2)]
    expect_refusal(cli("check", "--mission", mission, *paths, "--json"), 2, "at most a file for each", "alpha", "got 2")


def test_a_plan_of_another_autopilot(cli: Cli, tmp_path: Path, mission: Path) -> None:
    path = plan_file(tmp_path / "theirs.plan", SOUND, firmware=12)
    expect_refusal(cli("check", "--mission", mission, path, "--json"), 2, str(path), "expected a plan for ardupilot")


@pytest.mark.parametrize(
    "content",
    [b"", b"\x00\xff" * 300, b"QGC WPL 110\n0\t1\t0\n", b'{"fileType": "Plan"', b"{}", b"# notes"],
)
def test_a_damaged_file(cli: Cli, tmp_path: Path, mission: Path, content: bytes) -> None:
    path = tmp_path / "theirs.plan"
    path.write_bytes(content)
    expect_refusal(cli("check", "--mission", mission, path, "-o", "out", "--json"), 2, "theirs.plan")
    expect_refusal(cli("check", "--mission", mission, tmp_path / "nowhere.plan", "--json"), 2, "nowhere.plan")
    assert not (tmp_path / "out").exists()


def test_a_file_without_items(cli: Cli, tmp_path: Path, mission: Path) -> None:
    (tmp_path / "theirs.waypoints").write_text("QGC WPL 110\n")
    outcome = cli("check", "--mission", mission, tmp_path / "theirs.waypoints", "--json")
    expect_refusal(outcome, 2, "alpha: expected a mission, got no items")


def test_a_vehicle_that_returns_too_low(cli: Cli, tmp_path: Path) -> None:
    low = ridge(tmp_path)
    change_json(low, lambda data: data["vehicles"][0].update(return_height_m=15.0))
    over = [row(TAKEOFF, z=130.0), row(WAYPOINT, 20, 0, 130.0), row(WAYPOINT, 280, 0, 130.0), OVER[-1]]
    path = waypoints(tmp_path / "theirs.waypoints", over)
    outcome = cli("check", "--mission", low, path, "--json")
    assert list(problems(outcome)) == ["return"]  # who is told to return while it lands behind the ridge
    expect_unproven(outcome, "return", "above the ground", "raise return_height_m")


def test_rally_points_in_a_plan_are_not_passed_over(cli: Cli, tmp_path: Path, mission: Path) -> None:
    rally = {"points": [[*degrees(100, 100), 20.0]], "version": 2}
    path = plan_file(tmp_path / "theirs.plan", SOUND, rallyPoints=rally)
    expect_unproven(
        cli("check", "--mission", mission, path, "--json"), "return", "rally points: 1", "clear rally points"
    )


# --- what vehicles hold


def items(rows: list[Row]) -> list[MissionItem]:
    """Return what an ArduPilot vehicle holds of somebody's mission."""
    found = []
    for seq, (frame, command, params, x, y, z) in enumerate([row(WAYPOINT, 0, 0, 100.0, AMSL), *rows]):
        lat, lon = (0.0, 0.0) if command in (RTL, TAKEOFF) else degrees(x, y)
        wire = degrees_to_wire(lat), degrees_to_wire(lon)
        found.append(MissionItem(seq, frame, command, *params, x=wire[0], y=wire[1], z=z, current=int(seq == 0)))
    return found


@contextmanager
def flown_by(fleet: SimFleet) -> Iterator[str]:
    """Serve a fleet in a thread, faster than real time; yields the URL that a ground station listens on."""
    with_port = open_endpoint("udpin:127.0.0.1:0")
    url = with_port.url
    with_port.close()
    connect_fleet(fleet, url.replace("udpin", "udpout"))
    stop = threading.Event()
    server = threading.Thread(target=serve, args=(fleet, 10.0, stop.is_set), daemon=True)
    server.start()
    try:
        yield url
    finally:
        stop.set()
        server.join()
        fleet.close()


def _fleet(*homes_m: tuple[float, float]) -> SimFleet:
    scene = scene_of(question())
    vehicles = [
        SimVehicle(k, "ardupilot", "copter", FRAME.geo_point([*home_m, 100.0]), scene.tasks[0].motion)
        for k, home_m in enumerate(homes_m, start=1)
    ]
    return SimFleet(vehicles, frame=FRAME)


def _hold(fleet: SimFleet, rows: list[Row], *, cone: float = 0.0) -> None:
    vehicle = fleet.links[0]
    vehicle.missions._stores[0] = items(rows)
    vehicle.autopilot.parameters.update(RTL_CONE_SLOPE=cone)


def test_what_was_uploaded_is_proven_on_the_vehicles(cli: Cli, folder: Path, tmp_path: Path) -> None:
    mission = mission_file(tmp_path, question())
    with flown_by(_fleet((0, 0), (0, 60))) as url:
        sent = cli("upload", folder, "--connect", url, "--json")
        assert sent.code == 0, sent.err
        assert [v["verified"] for v in sent.json["vehicles"]] == [True, True]
        outcome = cli("check", "--mission", mission, "--connect", url, "--json")
    assert set(outcome.json["mission_sha256"]) == {"alpha", "bravo"}
    heights = json.loads((folder / CERTIFICATE_NAME).read_text())["return_height_m"]
    assert outcome.json["return_height_m"] == heights
    expect_proven(outcome)


def test_somebodys_low_mission_on_a_vehicle(cli: Cli, mission: Path) -> None:
    fleet = _fleet((0, 0))
    _hold(fleet, [*SOUND[:1], row(WAYPOINT, 150, 10, 12.0), *SOUND[2:]])
    with flown_by(fleet) as url:
        outcome = cli("check", "--mission", mission, "--connect", url, "--json")
    low = expect_unproven(outcome, "terrain", "raise waypoint 2 or the one before it by 13.0 m")
    assert low["value"] == pytest.approx(7.0, abs=0.01)


def test_a_vehicle_that_would_return_otherwise(cli: Cli, mission: Path) -> None:
    fleet = _fleet((0, 0))
    _hold(fleet, SOUND, cone=3.0)
    rally = MissionItem(0, 3, mavlink.MAV_CMD_NAV_RALLY_POINT, x=1, y=1, z=30.0)
    fleet.links[0].missions._stores[mavlink.MAV_MISSION_TYPE_RALLY] = [rally]
    with flown_by(fleet) as url:
        outcome = cli("check", "--mission", mission, "--connect", url, "--json")
    expect_unproven(outcome, "return", "RTL_CONE_SLOPE is 3", "1 rally points")


def test_an_empty_vehicle(cli: Cli, mission: Path) -> None:
    with flown_by(_fleet((0, 0))) as url:
        expect_refusal(cli("check", "--mission", mission, "--connect", url, "--json"), 2, "alpha", "expected")


def test_nobody_there_to_check(cli: Cli, mission: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Hurried:
        def __init__(self, endpoints: object) -> None:
            self._now_s = 0.0

        def now_s(self) -> float:
            return self._now_s

        def wait(self, seconds: float) -> None:
            self._now_s += seconds

    monkeypatch.setattr(fleet_link, "WallClock", Hurried)
    expect_refusal(cli("check", "--mission", mission, "--connect", NOBODY, "--json"), 4, "sysid 1", "nobody answered")


def test_a_vehicle_that_holds_something_else_than_was_sent(cli: Cli, folder: Path) -> None:
    fleet = _fleet((0, 0), (0, 60))
    service = fleet.links[1].missions
    honest = service._read

    def lying(kind: int, seq: int) -> MissionItem:
        item = honest(kind, seq)
        return replace(item, z=item.z - 20.0) if seq == 3 else item

    service._read = lying  # type: ignore[method-assign]
    with flown_by(fleet) as url:
        outcome = cli("fly", folder, "--connect", url, "--json")
    expect_refusal(outcome, 4, "bravo (sysid 2): holds another mission than was sent", "item 3", "nothing was armed")
    assert not any(link.autopilot.armed for link in fleet.links)
    assert not (folder / FLIGHT_NAME).exists()


def test_what_the_vehicles_hold_is_proven_again_after_reading_it_back(
    cli: Cli, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = certificates.held_by_vehicles

    def low(plan: Any, held: Any) -> Any:
        lowered = {k: [replace(i, z=i.z - 30.0) if i.command == WAYPOINT else i for i in v] for k, v in held.items()}
        return honest(plan, {k: [held[k][0], *v[1:]] for k, v in lowered.items()})

    monkeypatch.setattr(certificates, "held_by_vehicles", low)
    outcome = cli("fly", folder, "--json")
    expect_refusal(outcome, 3, "what the vehicles hold is not proven", "terrain clearance", "nothing was armed")
    assert not (folder / FLIGHT_NAME).exists()


# --- real files

SAMPLES = Path(__file__).parents[3] / "shared" / "samples"
_PLACES = [(-35.363262, 149.165237, 584.0), (47.3977, 8.5456, 488.0), (47.6305, -122.0864, 9.0), (36.32, 138.65, 985.0)]


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="the sample missions are not part of the repository")
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("path", sorted(SAMPLES.glob("*/*")), ids=lambda path: path.name)
def test_real_samples_are_checked_or_refused(cli: Cli, tmp_path: Path, path: Path, autopilot: str) -> None:
    for lat, lon, ground_m in _PLACES:
        data = alone(
            origin={"lat_deg": lat, "lon_deg": lon}, terrain={"kind": "flat", "alt_amsl_m": ground_m},
            defaults={"autopilot": autopilot},
        )  # fmt: skip
        mission = mission_file(tmp_path, data)
        outcome = cli("check", "--mission", mission, path, "--json")
        if outcome.code == 2:
            expect_refusal(outcome, 2)
        elif outcome.code == 3:
            assert problems(outcome)
            expect_line(outcome, 3, "not proven: alpha: ")
        else:
            expect_proven(outcome)


@pytest.mark.skipif(not SAMPLES.is_dir(), reason="the sample missions are not part of the repository")
@pytest.mark.parametrize("path", sorted(SAMPLES.glob("*/*")), ids=lambda path: path.name)
def test_real_samples_are_never_safe_where_no_terrain_is_known(cli: Cli, tmp_path: Path, path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 20.0)
    mission = mission_file(tmp_path, alone(origin=ORIGIN, terrain={"kind": "raster", "file": "hill.tif"}))
    for autopilot in ("ardupilot", "px4"):
        for lat, lon, _ in _PLACES:
            data = json.loads(mission.read_text())
            data |= {"defaults": {"autopilot": autopilot}, "origin": {"lat_deg": lat, "lon_deg": lon}}
            mission.write_text(json.dumps(data))
            outcome = cli("check", "--mission", mission, path, "--json")
            assert outcome.code in (2, 3), outcome.out
            assert "Traceback" not in outcome.err
