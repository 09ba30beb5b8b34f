"""QGroundControl's ``.plan`` file (https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html).

As its code enforces it, which is stricter than its page: ``mission``, ``geoFence`` and ``rallyPoints`` are all
required; an item has exactly 7 ``params``, null for NaN; the three altitude fields come all or none; altitude mode 3 is
never written (a reload copies heights above ground into altitudes AMSL). Home is ``plannedHomePosition``, not an item.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from adapters.guards import Area
from adapters.mission_items import (
    CHANGE_SPEED,
    FRAME_GLOBAL,
    FRAME_MISSION,
    FRAME_RELATIVE,
    WAYPOINT,
    MissionItem,
    degrees_to_wire,
    float32_text,
    wire_to_degrees,
)
from missionplanner.errors import MissionError
from missionplanner.geodesy import GeoPoint
from missionplanner.vehicle import Autopilot, VehicleClass

_FIRMWARE: dict[Autopilot, int] = {"ardupilot": 3, "px4": 12}  # MAV_AUTOPILOT
_VEHICLE_TYPE: dict[VehicleClass, int] = {"plane": 1, "copter": 2}  # MAV_TYPE
_ABOVE_TERRAIN = 10  # frame
# QGroundControl: 1 relative to launch, 2 AMSL, 4 above the terrain that the vehicle knows
_ALTITUDE_MODE = {FRAME_GLOBAL: 2, FRAME_RELATIVE: 1, _ABOVE_TERRAIN: 4}
_CALCULATED_ABOVE_TERRAIN = 3  # altitude mode
_PARAMS = 7
_LARGEST_INT = 2**31 - 1  # of the wire
_LARGEST = 1.7e308  # an integer of JSON may be beyond any float


@dataclass(frozen=True, slots=True)
class PlanFile:
    """What a ``.plan`` holds: ``items`` is the mission to upload, with its home item where the autopilot has one."""

    autopilot: Autopilot
    home: GeoPoint
    items: tuple[MissionItem, ...]
    fence_items: int = 0  # polygons and circles, counted only
    rally_points: int = 0


def plan_text(
    plan: PlanFile, vehicle_class: VehicleClass, areas: Sequence[Area] = (), rally: Sequence[MissionItem] = ()
) -> str:
    """Return the file's text, with the areas of a fence and rally points (heights above home)."""
    items = plan.items[1:] if plan.autopilot == "ardupilot" else plan.items
    speeds_m_s = [item.param2 for item in items if item.command == CHANGE_SPEED and not math.isnan(item.param2)]
    whole_speed_m_s = max(1, round(speeds_m_s[0])) if speeds_m_s else 5  # Mission Planner reads integers only
    document = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "mission": {
            "version": 2,
            "firmwareType": _FIRMWARE[plan.autopilot],
            "vehicleType": _VEHICLE_TYPE[vehicle_class],
            "globalPlanAltitudeMode": 0,
            "cruiseSpeed": whole_speed_m_s,
            "hoverSpeed": whole_speed_m_s,
            "plannedHomePosition": [
                wire_to_degrees(degrees_to_wire(plan.home.lat_deg)),
                wire_to_degrees(degrees_to_wire(plan.home.lon_deg)),
                float(float32_text(plan.home.alt_amsl_m)),
            ],
            "items": [_simple_item(item, jump_id) for jump_id, item in enumerate(items, start=1)],
        },
        "geoFence": {
            "version": 2,
            "circles": [
                {
                    "circle": {"center": _degrees(*area.corners[0]), "radius": float(float32_text(area.radius_m))},
                    "inclusion": area.inclusion,
                    "version": 1,
                }
                for area in areas
                if area.radius_m
            ],
            "polygons": [
                {"inclusion": area.inclusion, "polygon": [_degrees(*c) for c in area.corners], "version": 1}
                for area in areas
                if not area.radius_m
            ],
        },
        "rallyPoints": {
            "version": 2,
            "points": [[*_degrees(point.x, point.y), float(float32_text(point.z))] for point in rally],
        },
    }
    return json.dumps(document, indent=4) + "\n"


def _simple_item(item: MissionItem, jump_id: int) -> dict[str, Any]:
    params = [_number(value) for value in (item.param1, item.param2, item.param3, item.param4)]
    altitude = (
        {"AMSLAltAboveTerrain": None, "Altitude": _number(item.z), "AltitudeMode": _ALTITUDE_MODE[item.frame]}
        if item.frame in _ALTITUDE_MODE
        else {}
    )
    return {
        **altitude,
        "autoContinue": bool(item.autocontinue),
        "command": item.command,
        "doJumpId": jump_id,
        "frame": item.frame,
        "params": [*params, *(_place(value, item.frame) for value in (item.x, item.y)), _number(item.z)],
        "type": "SimpleItem",
    }


def _place(wire: int, frame: int) -> float:
    """Return a latitude or longitude; where there is none, the number that is meant (a gimbal's flags) as it is."""
    return float(wire) if frame == FRAME_MISSION else wire_to_degrees(wire)


def _degrees(x: int, y: int) -> list[float]:
    return [wire_to_degrees(x), wire_to_degrees(y)]


def _number(value: float) -> float | None:
    return None if math.isnan(value) else float(float32_text(value))


def read_plan(path: Path) -> PlanFile:
    """Read a ``.plan``, QGroundControl's or ours, as the mission to upload.

    Surveys and corridor scans are taken with the simple items that they carry.

    Raises
    ------
    MissionError
        The file cannot be read, is of another version, lacks a part, or has an item whose path it does not give.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise MissionError(f"{path}: expected a readable QGroundControl plan (JSON), got: {error}") from error
    plan = _Reader(path, "", document)
    plan.expect("fileType", "Plan")
    plan.expect("version", 1)
    mission = plan.part("mission", dict)
    mission.expect("version", 2)
    firmware = mission.part("firmwareType", int).value
    by_number = {number: autopilot for autopilot, number in _FIRMWARE.items()}
    if firmware not in by_number:
        raise mission.error("firmwareType", "3 (ArduPilot) or 12 (PX4)", firmware)
    autopilot = by_number[firmware]
    home = GeoPoint(*mission.numbers("plannedHomePosition", 3))
    if not (abs(home.lat_deg) <= 90 and abs(home.lon_deg) <= 180):
        raise mission.error("plannedHomePosition", "a latitude, a longitude and an altitude", home)
    items = [item for entry in mission.parts("items") for item in _read_entry(entry)]
    if autopilot == "ardupilot":
        x, y = degrees_to_wire(home.lat_deg), degrees_to_wire(home.lon_deg)
        items.insert(0, MissionItem(0, FRAME_GLOBAL, WAYPOINT, x=x, y=y, z=home.alt_amsl_m))
    return PlanFile(
        autopilot,
        home,
        tuple(replace(item, seq=seq, current=int(seq == 0)) for seq, item in enumerate(items)),
        fence_items=sum(plan.count("geoFence", key) for key in ("polygons", "circles")),
        rally_points=plan.count("rallyPoints", "points"),
    )


def _read_entry(entry: _Reader) -> list[MissionItem]:
    kind = entry.part("type", str).value
    if kind == "SimpleItem":
        return [_read_simple(entry)]
    # surveys and corridors keep the items that they stand for; a structure scan does not
    if kind == "ComplexItem" and "TransectStyleComplexItem" in entry.value:
        return [_read_simple(item) for item in entry.part("TransectStyleComplexItem", dict).parts("Items")]
    raise entry.error("type", "SimpleItem or a survey with its items", entry.value.get("complexItemType", kind))


def _read_simple(entry: _Reader) -> MissionItem:
    param1, param2, param3, param4, lat_deg, lon_deg, z = entry.numbers("params", _PARAMS, null=math.nan)
    frame = entry.part("frame", int).value
    if frame == FRAME_MISSION:  # what stands in for a position there is not one
        lat_deg, lon_deg, z = (0.0 if math.isnan(value) else value for value in (lat_deg, lon_deg, z))
    if math.isnan(z) and entry.value.get("AltitudeMode") == _CALCULATED_ABOVE_TERRAIN:
        expected = "a latitude, a longitude and an altitude that QGroundControl has calculated above its terrain"
        raise entry.error("params", f"{expected} (open the plan there and save it again)", [lat_deg, lon_deg, z])
    nowhere = frame == FRAME_MISSION
    most = (_LARGEST_INT, _LARGEST_INT) if nowhere else (90, 180)
    if not (abs(lat_deg) <= most[0] and abs(lon_deg) <= most[1] and math.isfinite(z)):
        raise entry.error("params", "a latitude, a longitude and an altitude at the end", [lat_deg, lon_deg, z])
    command = entry.part("command", int).value
    autocontinue = int(entry.value.get("autoContinue") is not False)
    x, y = (round(value) if nowhere else degrees_to_wire(value) for value in (lat_deg, lon_deg))
    return MissionItem(0, frame, command, param1, param2, param3, param4, x, y, z, 0, autocontinue)


class _Reader:
    """A part of the JSON document that knows where it stands."""

    def __init__(self, path: Path, where: str, value: Any) -> None:
        self.path = path
        self.where = where
        self.value = value

    def error(self, key: str, expected: str, got: object) -> MissionError:
        return MissionError(f"{self.path}: {self._name(key)}: expected {expected}, got {str(got)[:60]}")

    def part(self, key: str, kind: type) -> _Reader:
        value = self.value.get(key) if isinstance(self.value, dict) else None
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self.error(key, {dict: "an object", int: "an integer", str: "a text"}.get(kind, "a list"), value)
        return _Reader(self.path, self._name(key), value)

    def parts(self, key: str) -> list[_Reader]:
        entries = self.part(key, list)
        return [_Reader(self.path, f"{entries.where}[{k}]", value) for k, value in enumerate(entries.value)]

    def count(self, key: str, lists: str) -> int:
        """Return how many entries a list of an optional part has; what is not there has none."""
        part = self.value.get(key)
        entries = part.get(lists) if isinstance(part, dict) else None
        return len(entries) if isinstance(entries, list) else 0

    def expect(self, key: str, value: object) -> None:
        got = self.value.get(key) if isinstance(self.value, dict) else None
        if got != value:
            raise self.error(key, repr(value), repr(got))

    def numbers(self, key: str, count: int, *, null: float | None = None) -> Sequence[float]:
        values = self.part(key, list).value
        numbers: list[float] = []
        for value in values:
            if value is None and null is not None:
                numbers.append(null)
            elif isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _LARGEST:
                numbers.append(float(value))
        if len(numbers) != count or len(values) != count:
            raise self.error(key, f"{count} numbers", values)
        return numbers

    def _name(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key
