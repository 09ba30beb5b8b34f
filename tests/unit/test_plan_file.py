"""QGroundControl's ``.plan``: its rules kept, real plans read, wrong ones refused by field."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from adapters.mission_items import MissionItem, plan_items
from adapters.plan_file import PlanFile, plan_text, read_plan
from missionplanner.errors import MissionError
from missionplanner.geodesy import GeoPoint
from missionplanner.vehicle import Autopilot, Ending
from tests.plans import FRAME, vehicle_plan

SAMPLES = Path(__file__).parents[3] / "shared" / "samples" / "plan"


def _document(autopilot: Autopilot = "ardupilot", end: Ending = "land") -> dict[str, Any]:
    vehicle = vehicle_plan(autopilot=autopilot, end=end)
    plan = PlanFile(autopilot, FRAME.geo_point(vehicle.home_m), plan_items(vehicle, FRAME))
    document: dict[str, Any] = json.loads(plan_text(plan, "copter"), parse_constant=pytest.fail)
    return document


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("end", ["land", "rtl", "loiter"])
def test_it_keeps_qgroundcontrols_rules(autopilot: Autopilot, end: Ending) -> None:
    document = _document(autopilot, end)
    assert document["fileType"] == "Plan"
    assert document["version"] == 1
    assert isinstance(document["groundStation"], str)
    assert document["geoFence"] == {"version": 2, "circles": [], "polygons": []}
    assert document["rallyPoints"] == {"version": 2, "points": []}
    mission = document["mission"]
    assert mission["version"] == 2
    assert mission["firmwareType"] == (3 if autopilot == "ardupilot" else 12)
    assert mission["plannedHomePosition"] == [34.36, -118.18, 1200.0]
    assert [type(mission[key]) for key in ("cruiseSpeed", "hoverSpeed")] == [int, int]
    assert [item["doJumpId"] for item in mission["items"]] == [1, 2, 3, 4, 5]  # home is not an item
    assert mission["items"][0]["command"] == 22
    for item in mission["items"]:
        assert item["type"] == "SimpleItem"
        assert len(item["params"]) == 7
        altitude = {"AltitudeMode", "Altitude", "AMSLAltAboveTerrain"} & set(item)
        assert len(altitude) == (0 if item["frame"] == 2 else 3)
        assert item.get("AltitudeMode", 2) == {0: 2, 3: 1, 2: 2}[item["frame"]]
        assert item.get("Altitude") in (None, item["params"][6])


def test_px4s_heading_is_null() -> None:
    items = _document("px4")["mission"]["items"]
    assert [item["params"][3] for item in items] == [None, 0.0, None, None, None]


def test_numbers_that_are_no_place_are_not_scaled(tmp_path: Path) -> None:
    """QGroundControl sends param 5 of a frame without position as it stands: a gimbal's flags, a shutter."""
    pitch_yaw = MissionItem(0, 2, 1000, -30.0, 90.0, math.nan, math.nan, x=28, y=0, current=1)
    path = tmp_path / "m.plan"
    path.write_text(plan_text(PlanFile("px4", GeoPoint(47.0, 8.0, 400.0), (pitch_yaw,)), "copter"))
    (item,) = json.loads(path.read_text())["mission"]["items"]
    assert item["params"][4:] == [28.0, 0.0, 0.0]
    assert read_plan(path).items == (pitch_yaw,)


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("mavsdk_qgroundcontrol_sample.plan", 14),
        ("mavsdk_qgroundcontrol_sample_with_survey.plan", None),
        ("mavsdk_qgroundcontrol_sample_with_digicam_control.plan", None),
    ],
)
def test_real_plans_are_read(name: str, count: int | None) -> None:
    path = SAMPLES / name
    if not path.exists():
        pytest.skip("real sample plans are not at hand")
    plan = read_plan(path)
    document = json.loads(path.read_text())
    entries = document["mission"]["items"]
    simple = [k for e in entries for k in e.get("TransectStyleComplexItem", {"Items": [e]})["Items"]]
    items = plan.items[1:] if plan.autopilot == "ardupilot" else plan.items
    assert [item.command for item in items] == [entry["command"] for entry in simple]
    assert [item.seq for item in plan.items] == list(range(len(plan.items)))
    for item, entry in zip(items, simple, strict=True):
        lat = entry["params"][4] or 0.0  # in frame 2 it is none, but perhaps the shutter of DO_DIGICAM_CONTROL
        assert abs(item.x / 1e7 - lat) <= 0.5e-7 + 1e-12 if entry["frame"] != 2 else item.x == lat
        assert math.isnan(item.param4) == (entry["params"][3] is None)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        (
            "qgc_TerrainTest-ArduCopter.plan",
            "mission.items[5].params: expected a latitude, a longitude and an altitude",
        ),
        ("mavsdk_qgroundcontrol_sample_with_structured_scan.plan", "StructureScan"),
        ("mavsdk_qgroundcontrol_sample_with_survey_missing_items.plan", "Items"),
        ("mavsdk_qgroundcontrol_sample_without_mission.plan", "mission: expected an object, got None"),
        ("mavsdk_qgroundcontrol_sample_wrong_mission_version.plan", "mission.version: expected 2, got 7"),
        ("mavsdk_qgroundcontrol_sample_wrong_overall_version.plan", "version: expected 1, got 42"),
    ],
)
def test_real_wrong_plans_are_refused(name: str, says: str) -> None:
    path = SAMPLES / name
    if not path.exists():
        pytest.skip("real sample plans are not at hand")
    with pytest.raises(MissionError) as error:
        read_plan(path)
    assert says in str(error.value)
    assert str(path) in str(error.value)


def _with(document: dict[str, Any], where: str, value: object) -> dict[str, Any]:
    part: Any = document
    *keys, last = where.split("/")
    for key in keys:
        part = part[int(key) if key.isdigit() else key]
    part[int(last) if last.isdigit() else last] = value
    return document


@pytest.mark.parametrize(
    ("where", "value", "says"),
    [
        ("fileType", "Survey", "fileType: expected 'Plan'"),
        ("mission/firmwareType", 1, "mission.firmwareType: expected 3 (ArduPilot) or 12 (PX4), got 1"),
        ("mission/firmwareType", True, "mission.firmwareType: expected an integer, got True"),
        ("mission/items", {}, "mission.items: expected a list"),
        ("mission/items/1", 7, "mission.items[1].type: expected a text"),
        ("mission/items/2/params", [0, 0], "mission.items[2].params: expected 7 numbers"),
        ("mission/items/2/params/4", 134.0, "mission.items[2].params: expected a latitude"),
        ("mission/items/2/params/6", None, "mission.items[2].params: expected a latitude, a longitude and an altitude"),
        ("mission/items/2/params/0", math.inf, "mission.items[2].params: expected 7 numbers"),
        ("mission/items/2/command", "LAND", "mission.items[2].command: expected an integer, got LAND"),
        ("mission/items/2/command", 70_000, "expected a frame up to 255 and a command up to 65535"),
        ("mission/plannedHomePosition", [1.0, 2.0], "mission.plannedHomePosition: expected 3 numbers"),
        ("mission/plannedHomePosition", [1.0, None, 2.0], "mission.plannedHomePosition: expected 3 numbers"),
        ("mission/plannedHomePosition", [99.0, 0.0, 2.0], "mission.plannedHomePosition: expected a latitude"),
    ],
)
def test_wrong_fields_are_named(tmp_path: Path, where: str, value: object, says: str) -> None:
    path = tmp_path / "wrong.plan"
    path.write_text(json.dumps(_with(_document(), where, value)))
    with pytest.raises(MissionError) as error:
        read_plan(path)
    assert says in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", [b"", b"[1, 2]", b"{", b"\xff\xfe\x00", b"QGC WPL 110\n"])
def test_what_is_no_plan_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "wrong.plan"
    path.write_bytes(content)
    with pytest.raises(MissionError, match=r"wrong\.plan"):
        read_plan(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"nowhere\.plan: expected a readable"):
        read_plan(tmp_path / "nowhere.plan")
