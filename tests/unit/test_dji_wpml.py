"""DJI routes, held against what DJI documents of them."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from adapters.dji_wpml import AIRCRAFT, remarks, wpml_kmz
from adapters.export import export_fleet, export_options, export_remarks
from missionplanner.errors import MissionError
from missionplanner.mission import Inspection
from missionplanner.plan import Action, FleetPlan, VehiclePlan
from tests.plans import vehicle_plan
from tests.routes import ACTIONS, TOWER_M, looking, looking_fleet

KML, WPML = "{http://www.opengis.net/kml/2.2}", "{http://www.dji.com/wpmz/1.0.2}"

# What the documentation allows in each element, in its order; a * is not needed, a + may come again
_HEADING = ("waypointHeadingMode", "waypointHeadingAngle", "waypointHeadingPathMode")
_CONFIG = (
    *("flyToWaylineMode", "finishAction", "exitOnRCLost", "executeRCLostAction", "takeOffSecurityHeight"),
    *("globalTransitionalSpeed", "globalRTHHeight*", "droneInfo", "payloadInfo"),
)
_COMMON: dict[str, tuple[str, ...]] = {
    "kml": ("Document",),
    "missionConfig": _CONFIG,
    "droneInfo": ("droneEnumValue", "droneSubEnumValue"),
    "payloadInfo": ("payloadEnumValue", "payloadSubEnumValue", "payloadPositionIndex"),
    "Point": ("coordinates",),
    "globalWaypointHeadingParam": _HEADING,
    "waypointHeadingParam": _HEADING,
    "waypointTurnParam": ("waypointTurnMode", "waypointTurnDampingDist"),
    "actionGroup": (
        *("actionGroupId", "actionGroupStartIndex", "actionGroupEndIndex", "actionGroupMode", "actionTrigger"),
        "action+",
    ),
    "actionTrigger": ("actionTriggerType", "actionTriggerParam*"),
    "action": ("actionId", "actionActuatorFunc", "actionActuatorFuncParam"),
}
_TEMPLATE = _COMMON | {
    "Document": ("author", "missionConfig", "Folder"),
    "Folder": (
        *("templateType", "templateId", "waylineCoordinateSysParam", "autoFlightSpeed", "globalHeight"),
        *("gimbalPitchMode", "globalWaypointHeadingParam", "globalWaypointTurnMode", "globalUseStraightLine"),
        "Placemark+",
    ),
    "waylineCoordinateSysParam": ("coordinateMode", "heightMode"),
    "Placemark": (
        *("Point", "index", "ellipsoidHeight", "height", "useGlobalHeight", "useGlobalSpeed", "waypointSpeed"),
        *("useGlobalHeadingParam", "waypointHeadingParam", "useGlobalTurnParam", "actionGroup*+"),
    ),
}
_WAYLINES = _COMMON | {
    "Document": ("missionConfig", "Folder"),
    "Folder": ("templateId", "executeHeightMode", "waylineId", "autoFlightSpeed", "Placemark+"),
    "Placemark": (
        *("Point", "index", "executeHeight", "waypointSpeed", "waypointHeadingParam", "waypointTurnParam"),
        *("useStraightLine", "actionGroup*+"),
    ),
}
_PARAMETERS = {
    "takePhoto": ("payloadPositionIndex", "fileSuffix", "payloadLensIndex*", "useGlobalPayloadLensIndex"),
    "hover": ("hoverTime",),
    "rotateYaw": ("aircraftHeading", "aircraftPathMode"),
    "gimbalRotate": (
        *("payloadPositionIndex", "gimbalHeadingYawBase", "gimbalRotateMode", "gimbalPitchRotateEnable"),
        *("gimbalPitchRotateAngle", "gimbalRollRotateEnable", "gimbalRollRotateAngle", "gimbalYawRotateEnable"),
        *("gimbalYawRotateAngle", "gimbalRotateTimeEnable", "gimbalRotateTime"),
    ),
}


def bare(element: ET.Element) -> str:
    return element.tag.rpartition("}")[2]


def fits(children: Sequence[str], allowed: Sequence[str]) -> bool:
    """Return whether children are those that are allowed, in their order."""
    left = list(children)
    for entry in allowed:
        name = entry.rstrip("*+")
        count = 0
        while left and left[0] == name and (count == 0 or "+" in entry):
            left.pop(0)
            count += 1
        if count == 0 and "*" not in entry:
            return False
    return not left


def check(element: ET.Element, allowed: dict[str, tuple[str, ...]]) -> None:
    name, children = bare(element), [bare(child) for child in element]
    if name == "actionActuatorFuncParam":
        return
    if name == "action":
        function, parameters = element[1].text, [bare(child) for child in element[2]]
        assert function in _PARAMETERS
        assert fits(parameters, _PARAMETERS[function]), (function, parameters)
    if children or name in allowed:
        assert fits(children, allowed[name]), (name, children)
    else:
        assert element.text
    for child in element:
        check(child, allowed)


def documents(
    plan: FleetPlan, vehicle: VehiclePlan | None = None, aircraft: str = "m350-h20t"
) -> tuple[ET.Element, ET.Element]:
    kmz = wpml_kmz(plan, vehicle or plan.vehicles[0], AIRCRAFT[aircraft])
    with zipfile.ZipFile(io.BytesIO(kmz)) as archive:
        assert archive.namelist() == ["wpmz/template.kml", "wpmz/waylines.wpml"]
        template, waylines = (ET.fromstring(archive.read(name)) for name in archive.namelist())
    return template, waylines


def text(element: ET.Element, path: str) -> str:
    found = element.find("/".join(WPML + step for step in path.split("/")))
    assert found is not None, path
    assert found.text is not None
    return found.text


def marks(document: ET.Element) -> list[ET.Element]:
    return list(document.iter(f"{KML}Placemark"))


def steps(mark: ET.Element, trigger: str = "reachPoint") -> list[tuple[str, dict[str, str]]]:
    return [
        (
            text(action, "actionActuatorFunc"),
            {bare(p): p.text or "" for p in action.find(f"{WPML}actionActuatorFuncParam") or ()},
        )
        for group in mark.iter(f"{WPML}actionGroup")
        if text(group, "actionTrigger/actionTriggerType") == trigger
        for action in group.iter(f"{WPML}action")
    ]


@pytest.mark.parametrize("aircraft", sorted(AIRCRAFT))
def test_elements_are_the_documented_ones_in_their_order(aircraft: str) -> None:
    template, waylines = documents(looking_fleet(), aircraft=aircraft)
    check(template, _TEMPLATE)
    check(waylines, _WAYLINES)
    for document in (template, waylines):
        ids = [int(text(group, "actionGroupId")) for group in document.iter(f"{WPML}actionGroup")]
        assert ids == list(range(len(ids)))
        assert [int(text(mark, "index")) for mark in marks(document)] == list(range(6))


def test_the_checker_notices() -> None:
    _, waylines = documents(looking_fleet())
    mark = marks(waylines)[0]
    mark.remove(mark[2])
    with pytest.raises(AssertionError, match="Placemark"):
        check(waylines, _WAYLINES)


@pytest.mark.parametrize(("document", "height"), [(0, "height"), (1, "executeHeight")], ids=["template", "waylines"])
def test_places_heights_and_speeds_are_the_plans(document: int, height: str) -> None:
    plan = looking_fleet()
    vehicle = replace(plan.vehicles[0], speeds_m_s=np.array([3.0, 4.0, 5.0, 6.0, 7.0]))
    found = marks(documents(plan, vehicle)[document])
    for k, mark in enumerate(found):
        lon_deg, lat_deg = map(float, (mark.findtext(f"{KML}Point/{KML}coordinates") or "").split(","))
        position_m = plan.frame.to_local(lat_deg, lon_deg, vehicle.home_m[2] + float(text(mark, height)))
        assert np.linalg.norm(position_m - vehicle.waypoints_m[k]) < 0.01
        # the speed of a DJI waypoint is that of the leg from it
        assert float(text(mark, "waypointSpeed")) == [3.0, 4.0, 5.0, 6.0, 7.0, 7.0][k]


def test_it_flies_straight_and_stops_at_every_waypoint() -> None:
    template, waylines = documents(looking_fleet())
    stop = "toPointAndStopWithDiscontinuityCurvature"
    assert template.find(f"{KML}Document/{KML}Folder/{WPML}globalWaypointTurnMode").text == stop  # type: ignore[union-attr]
    assert all(text(mark, "useGlobalTurnParam") == "1" for mark in marks(template))
    assert [text(mark, "waypointTurnParam/waypointTurnMode") for mark in marks(waylines)] == [stop] * 6


def test_it_looks_at_the_tower_stands_and_takes_photos() -> None:
    plan = looking_fleet()
    vehicle = plan.vehicles[0]
    _, waylines = documents(plan)
    mark = marks(waylines)[1]
    away_m = np.array(TOWER_M) - vehicle.waypoints_m[1]
    heading_deg = float(text(mark, "waypointHeadingParam/waypointHeadingAngle"))
    assert heading_deg == pytest.approx(np.degrees(np.arctan2(away_m[0], away_m[1])), abs=0.01)
    done = steps(mark)
    assert [function for function, _ in done] == ["gimbalRotate", "hover", "takePhoto", "takePhoto"]
    pitch_deg = np.degrees(np.arctan2(away_m[2], np.hypot(*away_m[:2])))
    assert float(done[0][1]["gimbalPitchRotateAngle"]) == pytest.approx(pitch_deg, abs=0.01)
    assert done[0][1]["gimbalYawRotateEnable"] == "0"
    assert done[1][1] == {"hoverTime": "3"}
    assert done[2][1]["fileSuffix"] == "T01-left"


def test_photos_on_the_way_are_taken_between_its_waypoints() -> None:
    _, waylines = documents(looking_fleet())
    (group,) = [
        g for g in waylines.iter(f"{WPML}actionGroup")
        if text(g, "actionTrigger/actionTriggerType") == "multipleDistance"
    ]  # fmt: skip
    assert (text(group, "actionGroupStartIndex"), text(group, "actionGroupEndIndex")) == ("3", "4")
    assert text(group, "actionTrigger/actionTriggerParam") == "12.5"
    assert [text(action, "actionActuatorFunc") for action in group.iter(f"{WPML}action")] == ["takePhoto"]
    # it faces there already, and so nothing is turned again
    assert [function for function, _ in steps(marks(waylines)[3])] == ["gimbalRotate"]


def test_it_turns_before_it_flies_along_what_it_photographs() -> None:
    plan = looking_fleet()
    actions = {4: ACTIONS[4]}  # where the way begins, nothing is looked at
    _, waylines = documents(plan, replace(plan.vehicles[0], actions=actions))
    (turn, tilt) = steps(marks(waylines)[3])
    # along the leg it would face east; to 10 degrees it is nearer counter-clockwise
    assert turn == ("rotateYaw", {"aircraftHeading": "10", "aircraftPathMode": "counterClockwise"})
    assert tilt[0] == "gimbalRotate"
    assert tilt[1]["gimbalPitchRotateAngle"] == "-20"


def test_who_looks_at_nothing_faces_the_way_it_flies() -> None:
    plan = looking_fleet(vehicle_plan(waypoints_m=((0, 0, 1230), (100, 0, 1230), (100, 0, 1260), (100, -50, 1260))))
    _, waylines = documents(plan)
    angles = [float(text(m, "waypointHeadingParam/waypointHeadingAngle")) for m in marks(waylines)]
    assert angles == pytest.approx([90.0, 90.0, 180.0, 180.0], abs=0.01) or angles == pytest.approx(
        [90.0, 90.0, -180.0, -180.0], abs=0.01
    )
    assert not list(waylines.iter(f"{WPML}actionGroup"))


@pytest.mark.parametrize(("end", "finish"), [("land", "autoLand"), ("rtl", "goHome"), ("loiter", "noAction")])
def test_it_ends_as_planned(end: Any, finish: str) -> None:
    for document in documents(looking_fleet(looking(end=end))):
        assert text(document.find(f"{KML}Document"), "missionConfig/finishAction") == finish  # type: ignore[arg-type]


@pytest.mark.parametrize(("waived", "lost"), [(False, "executeLostAction"), (True, "goContinue")])
def test_a_lost_link_brings_it_home_only_where_the_way_home_is_clear(waived: bool, lost: str) -> None:
    plan = looking_fleet()
    fleet = plan.mission.fleet.model_copy(update={"direct_return": "waived" if waived else "required"})
    plan = replace(plan, mission=plan.mission.model_copy(update={"fleet": fleet}))
    config = documents(plan)[1].find(f"{KML}Document/{WPML}missionConfig")
    assert config is not None
    assert text(config, "exitOnRCLost") == lost
    assert text(config, "executeRCLostAction") == ("hover" if waived else "goBack")
    assert float(text(config, "globalRTHHeight")) == pytest.approx(plan.vehicles[0].motion.return_height_m, abs=1e-3)
    assert float(text(config, "takeOffSecurityHeight")) == 30.0


def test_the_files_say_that_nothing_is_proven() -> None:
    plan = looking_fleet(looking("al--pha"))
    with zipfile.ZipFile(io.BytesIO(wpml_kmz(plan, plan.vehicles[0], AIRCRAFT["m30"]))) as archive:
        for name in archive.namelist():
            said = archive.read(name).decode()
            assert "NOT PROVEN for DJI" in said
            ET.fromstring(said)
    assert any("NOT PROVEN" in line for line in remarks(looking_fleet(looking("a", 1)), AIRCRAFT["m30"]))
    assert any("Matrice 30:" in line for line in remarks(looking_fleet(looking("a", 1)), AIRCRAFT["m30"]))


@pytest.mark.parametrize(
    ("vehicle", "told"),
    [
        (vehicle_plan(vehicle_class="plane", end="loiter", speed_m_s=14.0), "uav1: expected a copter .* got a plane"),
        (looking(speed_m_s=15.5), "alpha: expected speeds of 1 to 15 m/s .* got 15.5"),
        (looking(speed_m_s=0.9), "got 0.9"),
        (looking(home_m=(0.0, 0.0, -400.0)), "take-off of at most 1500 m .* got 1630 m"),
        (
            replace(looking(), actions={2: Action("T09.top", "T09", look_deg=(0.0, 60.0))}),
            "alpha: T09.top: expected a camera pitch of -120 to 45 degrees .* got 60",
        ),
    ],
)
def test_what_dji_cannot_fly_is_refused_and_named(vehicle: VehiclePlan, told: str) -> None:
    with pytest.raises(MissionError, match=told):
        wpml_kmz(looking_fleet(vehicle), vehicle, AIRCRAFT["m350-h20t"])


def test_files_have_names_that_dji_takes_and_each_its_own(tmp_path: Path) -> None:
    plan = looking_fleet(looking("a_1", 1), looking("a.1", 2), looking("b", 3))
    paths = export_fleet(plan, tmp_path, export_options("dji", "M3E"))
    assert [path.name for path in paths] == ["a-1-1.kmz", "a-1-2.kmz", "b.kmz"]
    assert export_remarks(plan, export_options("dji", "m3e"))[0].startswith("DJI routes are for a Mavic 3E")


@pytest.mark.parametrize(
    ("camera", "aircraft", "told"),
    [
        ({"preset": "sony_a7rm4_35mm"}, "m3e", True),
        ({"preset": "dji_mavic3e_wide"}, "m3e", False),
        ({"preset": "dji_mavic3e_tele", "overlap_share": 0.6}, "m3e", False),
        ({"preset": "dji_mavic3e_wide", "focal_length_mm": 24.0}, "m3e", True),
        ({"preset": "dji_mavic3e_wide"}, "m350-h20t", True),
        ({"preset": "dji_h20_wide"}, "m350-h20t", False),
        ({"preset": "dji_h20_wide"}, "m30t", True),
        (None, "m3e", False),
    ],
)
def test_a_camera_that_the_aircraft_does_not_carry_is_told(
    camera: dict[str, Any] | None, aircraft: str, told: bool
) -> None:
    towers = [{"name": "T1", "lat_deg": 46.5, "lon_deg": 8.0}]
    plan = looking_fleet(looking("a", 1))
    asked = Inspection.model_validate({"towers": towers} | ({} if camera is None else {"camera": camera}))
    plan = replace(plan, mission=plan.mission.model_copy(update={"inspection": asked}))
    found = export_remarks(plan, export_options("dji,litchi", aircraft))
    assert any(line.startswith("CAMERA: ") and AIRCRAFT[aircraft].words in line for line in found) is told
    assert any("fly with no other" in line for line in found) is (camera is not None)


@pytest.mark.parametrize(
    ("formats", "aircraft", "told"),
    [
        ("dij", "m3e", "--format: expected a format, got 'dij': did you mean dji"),
        ("dji,,plan", "m3e", "--format: expected a format, got ''"),
        ("dji", "phantom", "--dji-aircraft: expected an aircraft, got 'phantom': known are"),
    ],
)
def test_names_that_are_none_are_refused(formats: str, aircraft: str, told: str) -> None:
    with pytest.raises(MissionError, match=told):
        export_options(formats, aircraft)
