"""One vehicle's plan as a DJI route: a KMZ with ``wpmz/template.kml`` and ``wpmz/waylines.wpml``, WPML 1.0.2.

Elements, their order and values are those of DJI's documentation (Cloud API, DJI WPML: template.kml, waylines.wpml,
common elements; https://developer.dji.com/doc/cloud-api-tutorial/en/api-reference/dji-wpml/overview.html).

The aircraft flies straight to each waypoint and stops there, so that its legs are those of the plan. Heights count from
where it takes off (``relativeToStartPoint``): DJI's other heights are above the ellipsoid or by its own ground model,
and a plan's are above mean sea level, so no geoid comes in between. Its nose is turned to what is looked at, its gimbal
only tilted: not every DJI gimbal turns sideways. ``waypointSpeed`` is that of the leg *from* a waypoint.

Nothing of it is proven for DJI aircraft: the files say so themselves.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from adapters.aiming import aim, headings_deg, hold_s, turn_deg
from missionplanner import camera as cameras
from missionplanner.errors import MissionError
from missionplanner.plan import Action, FleetPlan, VehiclePlan

NAMESPACE = "http://www.dji.com/wpmz/1.0.2"
DEFAULT_AIRCRAFT = "m350-h20t"

_KML = "http://www.opengis.net/kml/2.2"
_WAYPOINTS = (2, 65_535)
_SPEEDS_M_S = (1.0, 15.0)
_TAKE_OFF_M = (2.0, 1500.0)
_SAME_DEG = 1.0  # a nose or gimbal that is so much off is not turned again
_ENDINGS = {"land": "autoLand", "rtl": "goHome", "loiter": "noAction"}
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)  # the same plan, the same bytes


@dataclass(frozen=True, slots=True)
class Aircraft:
    """A DJI aircraft with its camera, by DJI's numbers."""

    words: str
    drone: tuple[int, int]  # type and subtype
    payload: int
    pitches_deg: tuple[float, float]
    lens: str = ""  # whose photos are kept, where the format asks for it
    cameras: tuple[str, ...] = ()  # of those that missions know, the ones it carries


_MATRICE = {"m300": ("Matrice 300 RTK", 60), "m350": ("Matrice 350 RTK", 89)}
_ZENMUSE = {"h20": ("H20", 42), "h20t": ("H20T", 43), "h20n": ("H20N", 61), "h30": ("H30", 82), "h30t": ("H30T", 83)}
_WIDE = {"h20": ("dji_h20_wide",), "h20t": ("dji_h20_wide",)}  # the same wide camera

AIRCRAFT: Mapping[str, Aircraft] = {
    **{
        f"{matrice}-{camera}": Aircraft(
            f"{words} with {named}", (drone, 0), payload, (-120.0, 45.0), "", _WIDE.get(camera, ())
        )
        for matrice, (words, drone) in _MATRICE.items()
        for camera, (named, payload) in _ZENMUSE.items()
    },
    "m30": Aircraft("Matrice 30", (67, 0), 52, (-120.0, 45.0), "wide"),
    "m30t": Aircraft("Matrice 30T", (67, 1), 53, (-120.0, 45.0), "wide"),
    "m3e": Aircraft("Mavic 3E", (77, 0), 66, (-90.0, 35.0), "", ("dji_mavic3e_wide", "dji_mavic3e_tele")),
    "m3t": Aircraft("Mavic 3T", (77, 1), 67, (-90.0, 35.0)),
    "m3d": Aircraft("Matrice 3D", (91, 0), 80, (-90.0, 30.0), "wide"),
    "m3td": Aircraft("Matrice 3TD", (91, 1), 81, (-90.0, 30.0), "wide"),
}
"""What routes can be written for, by the name that a user gives."""


def wpml_kmz(plan: FleetPlan, vehicle: VehiclePlan, aircraft: Aircraft) -> bytes:
    """Return the KMZ of one vehicle's route.

    Raises
    ------
    MissionError
        The plan asks for what a DJI route cannot say: a plane, a speed, a height, a camera's pitch out of range.
    """
    route = _Route(plan, vehicle, aircraft)
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as kmz:
        for name, document in (("wpmz/template.kml", route.template()), ("wpmz/waylines.wpml", route.waylines())):
            kmz.writestr(zipfile.ZipInfo(name, _ZIP_TIME), document)
    return archive.getvalue()


def remarks(plan: FleetPlan, aircraft: Aircraft) -> list[str]:
    """Return what who flies a DJI route must know."""
    return [
        *_camera_remarks(plan, aircraft),
        f"DJI routes are for a {aircraft.words}: another aircraft or camera is chosen with --dji-aircraft",
        "DJI routes are NOT PROVEN: no proof covers how a DJI aircraft flies between waypoints, whether its battery "
        "lasts with a stop at each, its way home, or that vehicles keep apart: fly one at a time",
        "DJI heights count from where the aircraft takes off: start it at its planned home, and nowhere else",
    ]


def _camera_remarks(plan: FleetPlan, aircraft: Aircraft) -> list[str]:
    """Tell of a mission's camera that the aircraft is not known to carry: views and photos are made for that."""
    inspection = plan.mission.inspection
    asked = None if inspection is None else cameras.of(inspection.camera)
    if asked is None or any(_same_optics(asked, cameras.PRESETS[name]) for name in aircraft.cameras):
        return []
    carries = ", ".join(cameras.PRESETS[name].name for name in aircraft.cameras) or "none that is known here"
    return [
        f"CAMERA: views and photos are planned for {asked.name} (inspection.camera), a {aircraft.words} carries "
        f"{carries}: distances, overlap and ground sampling hold for the planned one only: choose --dji-aircraft to "
        "match, or plan again with the camera that flies"
    ]


def _same_optics(one: cameras.CameraModel, other: cameras.CameraModel) -> bool:
    return all(
        getattr(one, name) == getattr(other, name)
        for name in ("focal_length_mm", "sensor_width_mm", "sensor_height_mm", "image_width_px", "image_height_px")
    )


class _Route:
    """One vehicle's waypoints as DJI writes them."""

    def __init__(self, plan: FleetPlan, vehicle: VehiclePlan, aircraft: Aircraft) -> None:
        self._plan, self._vehicle, self._aircraft = plan, vehicle, aircraft
        self._speeds_m_s = [*vehicle.speeds_m_s.tolist(), float(vehicle.speeds_m_s[-1])]
        self._headings_deg = headings_deg(vehicle, plan.frame)
        self._heights_m = (vehicle.waypoints_m[:, 2] - vehicle.home_m[2]).tolist()
        self._groups = 0  # of actions, in the document that is being written
        self._check()

    def template(self) -> str:
        """Return ``template.kml``: what DJI's apps show, and what they make a route from anew when it is edited."""
        root, document = self._begin()
        _add(document, "author", "missionplanner")
        self._mission(document)
        folder = ET.SubElement(document, "Folder")
        _add(folder, "templateType", "waypoint")
        _add(folder, "templateId", 0)
        system = _add(folder, "waylineCoordinateSysParam")
        _add(system, "coordinateMode", "WGS84")
        _add(system, "heightMode", "relativeToStartPoint")
        _add(folder, "autoFlightSpeed", max(self._speeds_m_s))
        _add(folder, "globalHeight", self._heights_m[0])
        _add(folder, "gimbalPitchMode", "manual")  # tilted by actions
        _heading(folder, "globalWaypointHeadingParam", "followWayline", 0.0)
        _add(folder, "globalWaypointTurnMode", "toPointAndStopWithDiscontinuityCurvature")
        _add(folder, "globalUseStraightLine", 1)
        for k, height_m in enumerate(self._heights_m):
            mark = self._placemark(folder, k)
            _add(mark, "ellipsoidHeight", height_m)  # asked for, and not used where heights count from the take-off
            _add(mark, "height", height_m)
            _add(mark, "useGlobalHeight", 0)
            _add(mark, "useGlobalSpeed", 0)
            _add(mark, "waypointSpeed", self._speeds_m_s[k])
            _add(mark, "useGlobalHeadingParam", 0)
            _heading(mark, "waypointHeadingParam", "smoothTransition", self._headings_deg[k])
            _add(mark, "useGlobalTurnParam", 1)
            self._actions(mark, k)
        return _text(root)

    def waylines(self) -> str:
        """Return ``waylines.wpml``: what the aircraft flies."""
        root, document = self._begin()
        self._mission(document, return_height_m=self._vehicle.motion.return_height_m)
        folder = ET.SubElement(document, "Folder")
        _add(folder, "templateId", 0)
        _add(folder, "executeHeightMode", "relativeToStartPoint")
        _add(folder, "waylineId", 0)
        _add(folder, "autoFlightSpeed", max(self._speeds_m_s))
        for k, height_m in enumerate(self._heights_m):
            mark = self._placemark(folder, k)
            _add(mark, "executeHeight", height_m)
            _add(mark, "waypointSpeed", self._speeds_m_s[k])
            _heading(mark, "waypointHeadingParam", "smoothTransition", self._headings_deg[k])
            turn = _add(mark, "waypointTurnParam")
            _add(turn, "waypointTurnMode", "toPointAndStopWithDiscontinuityCurvature")
            _add(turn, "waypointTurnDampingDist", 0)
            _add(mark, "useStraightLine", 1)
            self._actions(mark, k)
        return _text(root)

    def _check(self) -> None:
        name, vehicle = self._vehicle.name, self._vehicle
        if vehicle.vehicle_class != "copter":
            raise MissionError(f"{name}: expected a copter for a DJI route, got a {vehicle.vehicle_class}")
        least, most = _WAYPOINTS
        if not least <= len(self._heights_m) <= most:
            raise MissionError(f"{name}: expected {least} to {most} waypoints for DJI, got {len(self._heights_m)}")
        slow, fast = _SPEEDS_M_S
        for speed_m_s in self._speeds_m_s:
            if not slow <= speed_m_s <= fast:
                raise MissionError(
                    f"{name}: expected speeds of {slow:g} to {fast:g} m/s for DJI, got {speed_m_s:g}: change its "
                    "speed_m_s and plan again"
                )
        if self._heights_m[0] > _TAKE_OFF_M[1]:
            raise MissionError(
                f"{name}: expected a take-off of at most {_TAKE_OFF_M[1]:g} m for DJI, got {self._heights_m[0]:.0f} m"
            )
        low, high = self._aircraft.pitches_deg
        for k, action in vehicle.actions.items():
            asked = aim(action, vehicle.waypoints_m[k], self._plan.frame)
            if asked is not None and not low <= asked.pitch_deg <= high:
                raise MissionError(
                    f"{name}: {action.name or f'waypoint {k}'}: expected a camera pitch of {low:g} to {high:g} degrees "
                    f"for a {self._aircraft.words}, got {asked.pitch_deg:.0f}: look from higher up"
                )

    def _begin(self) -> tuple[ET.Element, ET.Element]:
        self._groups = 0
        root = ET.Element("kml", {"xmlns": _KML, "xmlns:wpml": NAMESPACE})
        document = ET.SubElement(root, "Document")
        words = (
            f"{self._plan.mission.name}, {self._vehicle.name}: NOT PROVEN for DJI aircraft. Heights count from the "
            f"take-off, at the planned home ({self._vehicle.home_m[2]:.1f} m AMSL)."
        )
        document.append(ET.Comment(f" {words.replace('-', chr(0x2010))} "))  # a comment may hold no two hyphens
        return root, document

    def _mission(self, document: ET.Element, return_height_m: float | None = None) -> None:
        # a link that is lost: the way home is planned from everywhere, unless the mission waives that
        waived = self._plan.mission.fleet.direct_return == "waived"
        config = _add(document, "missionConfig")
        _add(config, "flyToWaylineMode", "safely")
        _add(config, "finishAction", _ENDINGS[self._vehicle.end])
        _add(config, "exitOnRCLost", "goContinue" if waived else "executeLostAction")
        _add(config, "executeRCLostAction", "hover" if waived else "goBack")
        _add(config, "takeOffSecurityHeight", max(self._heights_m[0], _TAKE_OFF_M[0]))
        _add(config, "globalTransitionalSpeed", self._speeds_m_s[0])
        if return_height_m is not None:
            _add(config, "globalRTHHeight", return_height_m)
        drone = _add(config, "droneInfo")
        _add(drone, "droneEnumValue", self._aircraft.drone[0])
        _add(drone, "droneSubEnumValue", self._aircraft.drone[1])
        payload = _add(config, "payloadInfo")
        _add(payload, "payloadEnumValue", self._aircraft.payload)
        _add(payload, "payloadSubEnumValue", 0)
        _add(payload, "payloadPositionIndex", 0)

    def _placemark(self, folder: ET.Element, k: int) -> ET.Element:
        place = self._plan.frame.geo_point(self._vehicle.waypoints_m[k])
        mark = ET.SubElement(folder, "Placemark")
        point = ET.SubElement(mark, "Point")
        ET.SubElement(point, "coordinates").text = f"{place.lon_deg:.8f},{place.lat_deg:.8f}"
        _add(mark, "index", k)
        return mark

    # --- what is done at a waypoint, and on the way from it

    def _actions(self, mark: ET.Element, k: int) -> None:
        steps = [*self._here(k), *self._before_photographed_leg(k)]
        following = self._vehicle.actions.get(k + 1, Action())
        if steps:
            self._group(mark, (k, k), ("reachPoint", None), steps)
        if following.photo_every_m > 0.0:
            trigger = ("multipleDistance", following.photo_every_m)
            self._group(mark, (k, k + 1), trigger, [self._photo(following)])

    def _here(self, k: int) -> Iterator[_Step]:
        action = self._vehicle.actions.get(k, Action())
        asked = aim(action, self._vehicle.waypoints_m[k], self._plan.frame)
        if asked is not None:
            yield self._tilt(asked.pitch_deg)
        if (stands_s := hold_s(self._vehicle, k)) > 0.0:
            yield _Step("hover", {"hoverTime": stands_s})
        for _ in range(action.photos):
            yield self._photo(action)

    def _before_photographed_leg(self, k: int) -> Iterator[_Step]:
        """Turn to what is photographed on the leg from a waypoint before it is flown."""
        following, here = self._vehicle.actions.get(k + 1, Action()), self._vehicle.waypoints_m[k]
        asked = aim(following, here, self._plan.frame) if following.photo_every_m > 0.0 else None
        if asked is None:
            return
        if asked.heading_deg is not None:
            turned = turn_deg(self._headings_deg[k], asked.heading_deg)
            if abs(turned) > _SAME_DEG:
                way = "clockwise" if turned > 0.0 else "counterClockwise"
                yield _Step("rotateYaw", {"aircraftHeading": turn_deg(0.0, asked.heading_deg), "aircraftPathMode": way})
        own = aim(self._vehicle.actions.get(k, Action()), here, self._plan.frame)
        if own is None or abs(own.pitch_deg - asked.pitch_deg) > _SAME_DEG:
            yield self._tilt(asked.pitch_deg)

    def _tilt(self, pitch_deg: float) -> _Step:
        return _Step(
            "gimbalRotate",
            {
                "payloadPositionIndex": 0,
                "gimbalHeadingYawBase": "north",
                "gimbalRotateMode": "absoluteAngle",
                "gimbalPitchRotateEnable": 1,
                "gimbalPitchRotateAngle": pitch_deg,
                "gimbalRollRotateEnable": 0,
                "gimbalRollRotateAngle": 0,
                "gimbalYawRotateEnable": 0,
                "gimbalYawRotateAngle": 0,
                "gimbalRotateTimeEnable": 0,
                "gimbalRotateTime": 0,
            },
        )

    def _photo(self, action: Action) -> _Step:
        lens = {"payloadLensIndex": self._aircraft.lens} if self._aircraft.lens else {}
        suffix = dji_name(action.name or action.inspects or "photo")
        return _Step(
            "takePhoto", {"payloadPositionIndex": 0, "fileSuffix": suffix, **lens, "useGlobalPayloadLensIndex": 0}
        )

    def _group(
        self,
        mark: ET.Element,
        span: tuple[int, int],
        trigger: tuple[str, float | None],
        steps: list[_Step],
    ) -> None:
        group = _add(mark, "actionGroup")
        _add(group, "actionGroupId", self._groups)
        _add(group, "actionGroupStartIndex", span[0])
        _add(group, "actionGroupEndIndex", span[1])
        _add(group, "actionGroupMode", "sequence")
        what = _add(group, "actionTrigger")
        self._groups += 1
        _add(what, "actionTriggerType", trigger[0])
        if trigger[1] is not None:
            _add(what, "actionTriggerParam", trigger[1])
        for k, step in enumerate(steps):
            action = _add(group, "action")
            _add(action, "actionId", k)
            _add(action, "actionActuatorFunc", step.function)
            parameters = _add(action, "actionActuatorFuncParam")
            for name, value in step.parameters.items():
                _add(parameters, name, value)


@dataclass(frozen=True, slots=True)
class _Step:
    """An action of DJI's, with its parameters in their documented order."""

    function: str
    parameters: Mapping[str, object]


def dji_name(name: str) -> str:
    """Return a name that DJI's apps and its cloud take: they refuse dots and underscores, among others."""
    return "".join(c if c.isalnum() or c == "-" else "-" for c in name)


def _heading(parent: ET.Element, name: str, mode: str, heading_deg: float) -> None:
    parameters = _add(parent, name)
    _add(parameters, "waypointHeadingMode", mode)
    _add(parameters, "waypointHeadingAngle", turn_deg(0.0, heading_deg))
    _add(parameters, "waypointHeadingPathMode", "followBadArc")


def _add(parent: ET.Element, name: str, value: object = None) -> ET.Element:
    element = ET.SubElement(parent, f"wpml:{name}")
    if isinstance(value, float):
        element.text = f"{round(value, 3) + 0.0:.12g}"
    elif value is not None:
        element.text = str(value)
    return element


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
