"""Mission items of any origin, ours or somebody's, read as what the vehicle that holds them will fly.

Rules and where they come from: ArduPilot 4.5's ``ArduCopter/mode_auto.cpp``, ``ArduPlane/commands_logic.cpp`` and
``libraries/AP_Mission/AP_Mission.cpp``, PX4 1.15's ``src/modules/navigator/mission.cpp``, ``mission_block.cpp`` and
``src/modules/mavlink/mavlink_mission.cpp``; https://mavlink.io/en/messages/common.html#mav_commands. Whatever has a
path or an effect on it that these do not settle is a gap: nothing uncertain is reported as safe.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from adapters.mission_items import (
    CHANGE_SPEED,
    FRAME_GLOBAL,
    FRAME_RELATIVE,
    LAND,
    LOITER_UNLIMITED,
    NAV_DELAY,
    RETURN_TO_LAUNCH,
    TAKEOFF,
    WAYPOINT,
    MissionItem,
    plan_items,
    wire_to_degrees,
)
from adapters.plan_file import read_plan
from adapters.waypoints_file import read_waypoints_home
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray, GeoPoint, LocalFrame
from missionplanner.plan import VehiclePlan
from missionplanner.sortie import Gap, Leg, LegKind, Sortie
from missionplanner.vehicle import Autopilot, Ending, MotionModel, VehicleClass

LOITER_TURNS = 18
LOITER_TIME = 19
SPLINE_WAYPOINT = 82

Ground = Callable[[float, float], float]  # x_m, y_m -> altitude AMSL, NaN where it is not known

_AMSL_FRAMES = (FRAME_GLOBAL, 5)
_HOME_FRAMES = (FRAME_RELATIVE, 6)
_TERRAIN_FRAMES = (10, 11)

_UNDERSTOOD = {
    WAYPOINT: "WAYPOINT",
    LOITER_UNLIMITED: "LOITER_UNLIM",
    LOITER_TURNS: "LOITER_TURNS",
    LOITER_TIME: "LOITER_TIME",
    RETURN_TO_LAUNCH: "RETURN_TO_LAUNCH",
    LAND: "LAND",
    TAKEOFF: "TAKEOFF",
    SPLINE_WAYPOINT: "SPLINE_WAYPOINT",
    NAV_DELAY: "DELAY",
    CHANGE_SPEED: "DO_CHANGE_SPEED",
}

_CONDITIONS = {112: "CONDITION_DELAY", 114: "CONDITION_DISTANCE", 115: "CONDITION_YAW"}
"""They delay DO commands until the next waypoint, never the vehicle itself."""

NO_EFFECT = {
    80: "ROI",
    181: "DO_SET_RELAY",
    182: "DO_REPEAT_RELAY",
    183: "DO_SET_SERVO",
    184: "DO_REPEAT_SERVO",
    195: "DO_SET_ROI_LOCATION",
    196: "DO_SET_ROI_WPNEXT_OFFSET",
    197: "DO_SET_ROI_NONE",
    200: "DO_CONTROL_VIDEO",
    201: "DO_SET_ROI",
    202: "DO_DIGICAM_CONFIGURE",
    203: "DO_DIGICAM_CONTROL",
    204: "DO_MOUNT_CONFIGURE",
    205: "DO_MOUNT_CONTROL",
    206: "DO_SET_CAM_TRIGG_DIST",
    211: "DO_GRIPPER",
    214: "DO_SET_CAM_TRIGG_INTERVAL",
    216: "DO_SPRAYER",
    530: "SET_CAMERA_MODE",
    531: "SET_CAMERA_ZOOM",
    532: "SET_CAMERA_FOCUS",
    600: "JUMP_TAG",
    1000: "DO_GIMBAL_MANAGER_PITCHYAW",
    1001: "DO_GIMBAL_MANAGER_CONFIGURE",
    2000: "IMAGE_START_CAPTURE",
    2001: "IMAGE_STOP_CAPTURE",
    2003: "DO_TRIGGER_CONTROL",
    2500: "VIDEO_START_CAPTURE",
    2501: "VIDEO_STOP_CAPTURE",
}
"""Commands known to leave the path and its times alone: cameras, gimbals, regions of interest, servos, relays."""

_NOT_FOLLOWED = {
    30: ("CONTINUE_AND_CHANGE_ALT", "flies on along its heading until an altitude"),
    31: ("LOITER_TO_ALT", "where it leaves its circle is not known"),
    32: ("DO_FOLLOW", "follows another vehicle"),
    33: ("DO_FOLLOW_REPOSITION", "follows another vehicle"),
    83: ("ALTITUDE_WAIT", "drifts until an altitude"),
    84: ("VTOL_TAKEOFF", "VTOL aircraft are not modelled"),
    85: ("VTOL_LAND", "VTOL aircraft are not modelled"),
    92: ("GUIDED_ENABLE", "another computer steers"),
    94: ("PAYLOAD_PLACE", "descends until it feels the ground"),
    113: ("CONDITION_CHANGE_ALT", "changes the altitude"),
    177: ("DO_JUMP", "repeats items, its path is not followed"),
    178: ("DO_CHANGE_SPEED", "its effect is not known"),
    179: ("DO_SET_HOME", "moves home, to which heights and the return refer"),
    188: ("DO_RETURN_PATH_START", "changes the way home"),
    189: ("DO_LAND_START", "changes the way home"),
    191: ("DO_GO_AROUND", "aborts a landing"),
    207: ("DO_FENCE_ENABLE", "a fence of the vehicle's own can end the mission"),
    208: ("DO_PARACHUTE", "ends the flight"),
    210: ("DO_INVERTED_FLIGHT", "is not modelled"),
    212: ("DO_AUTOTUNE_ENABLE", "shakes the vehicle"),
    218: ("DO_AUX_FUNCTION", "can be anything"),
    222: ("DO_GUIDED_LIMITS", "another computer steers"),
    223: ("DO_ENGINE_CONTROL", "can stop the engine"),
    400: ("COMPONENT_ARM_DISARM", "can stop the motors"),
    601: ("DO_JUMP_TAG", "repeats items, its path is not followed"),
    3000: ("DO_VTOL_TRANSITION", "VTOL aircraft are not modelled"),
}

_LEAST_RATE_M_S = 0.1  # the least of WPNAV_SPEED_UP and WPNAV_SPEED_DN
_AIRSPEED, _GROUND_SPEED, _CLIMB_SPEED, _DESCENT_SPEED = range(4)  # speed types
_LEAST_SPEED_M_S = 0.2  # ArduCopter ignores less (measured)
_LEAST_CLIMB_M = 1.0  # a take-off to less is raised by the autopilot itself
_CIRCLE_RADIUS_M = 10.0  # CIRCLE_RADIUS
_CIRCLE_RATE_RAD_S = math.radians(20.0)  # CIRCLE_RATE
_STORED_RADIUS_M = 255.0  # what one byte holds
_STORED_SECONDS = 65_535.0
_DAY_S = 86_400.0  # nobody waits, or flies, for longer
_BRIEF_STOP_S = 1e-3  # a stop that the mission gives no time
_SAME_PLACE_M = 0.01  # 1e-7 degrees
_HOME_TOLERANCE_M = 10.0  # between what is said of home here and there: GPS, rounded files
_REACH_M = 200_000.0  # from the frame's origin; what lies further is another place
_HIGHEST_M = 100_000.0


def read_sortie(
    items: Sequence[MissionItem],
    *,
    name: str,
    sysid: int,
    autopilot: Autopilot,
    vehicle_class: VehicleClass,
    frame: LocalFrame,
    home_m: FloatArray | None,
    motion: MotionModel,
    start_delay_s: float = 0.0,
    speed_default_m_s: float | None = None,
    airspeed_limits_m_s: tuple[float, float] | None = None,
    ground: Ground | None = None,
) -> Sortie:
    """Return what a vehicle that holds these items flies.

    Parameters
    ----------
    home_m : (3,) where the vehicle stands; PX4's missions do not say, ArduPilot's do in item 0 unless that is 0, 0
    speed_default_m_s : before any DO_CHANGE_SPEED; default: the autopilot's own
    airspeed_limits_m_s : of a plane, outside of which ArduPlane ignores a speed; default: its motion's
    ground : a terrain model, to which home's altitude is held

    Raises
    ------
    MissionError
        No items, no home, no waypoint, items out of order, or an item whose position cannot be one.
    """
    if not items:
        raise MissionError(f"{name}: expected a mission, got no items: upload or export one first")
    for place, item in enumerate(items):
        if item.seq != place:
            raise MissionError(f"{name}: expected item {place}, got {item.seq}: items are numbered from 0 without gaps")
    home, home_gaps, notes = _home(items[0], name, autopilot, frame, home_m, ground)
    if speed_default_m_s is None:
        ardupilot = autopilot == "ardupilot"
        copter_m_s = motion.arducopter.cruise_speed_m_s if ardupilot else motion.px4.return_speed_m_s
        speed_default_m_s = motion.cruise_speed_m_s if vehicle_class == "plane" else copter_m_s
    reader = _Reader(
        name,
        autopilot,
        vehicle_class,
        frame,
        home,
        motion,
        speed_default_m_s,
        airspeed_limits_m_s or motion.airspeed_limits_m_s,
        ground,
    )
    reader.gaps += home_gaps
    reader.notes += notes
    reader.read(items[1:] if autopilot == "ardupilot" else items)
    if not reader.legs:
        raise MissionError(f"{name}: expected at least one waypoint, got none in {len(items)} items")
    _check_duration(reader.legs, name)
    return Sortie(
        name=name,
        sysid=sysid,
        autopilot=autopilot,
        vehicle_class=vehicle_class,
        home_m=home,
        legs=tuple(reader.legs),
        ending=reader.ending or ("rtl" if reader.ardupilot and reader.plane else "loiter"),
        ending_seq=reader.legs[-1].seq if reader.ending is None else reader.ending_seq,
        start_delay_s=start_delay_s + reader.wait_s,
        return_height_m=motion.return_height_m,
        gaps=tuple(reader.gaps),
        notes=tuple(reader.notes),
    )


def plan_sortie(vehicle: VehiclePlan, frame: LocalFrame) -> Sortie:
    """Return a plan as its vehicle will hold it: through the wire's items and back."""
    return read_sortie(
        plan_items(vehicle, frame),
        name=vehicle.name,
        sysid=vehicle.sysid,
        autopilot=vehicle.autopilot,
        vehicle_class=vehicle.vehicle_class,
        frame=frame,
        home_m=vehicle.home_m,
        motion=vehicle.motion,
        start_delay_s=vehicle.start_delay_s,
    )


def read_mission_file(path: Path, autopilot: Autopilot) -> tuple[tuple[MissionItem, ...], GeoPoint | None]:
    """Read a ``.plan`` or QGC WPL 110 file, told apart by what is in it, as the mission to upload and its home.

    Raises
    ------
    MissionError
        The file cannot be read, is neither, is another autopilot's, or is refused by its reader.
    """
    items: tuple[MissionItem, ...]
    home: GeoPoint | None
    if _is_plan(path):
        plan = read_plan(path)
        if plan.autopilot != autopilot:
            raise MissionError(
                f"{path}: expected a plan for {autopilot}, got one for {plan.autopilot}: "
                "make it for that firmware, or set the vehicle's autopilot in the mission file"
            )
        items, home = plan.items, plan.home
    else:
        items, home = read_waypoints_home(path, autopilot)
    nowhere = home is None or home.lat_deg == home.lon_deg == 0.0
    return items, None if nowhere else home


def mission_file_notes(path: Path) -> tuple[str, ...]:
    """Return what a mission file holds besides its mission, which nobody checks."""
    if not _is_plan(path):
        return ()
    plan = read_plan(path)
    counts = ((plan.fence_items, "geofence item"), (plan.rally_points, "rally point"))
    return tuple(
        f"{path.name}: {count} {what}{'s' * (count > 1)} not checked: the vehicle may obey what is not proven"
        for count, what in counts
        if count
    )


def mission_file_rally_points(path: Path) -> int:
    """Return how many rally points a mission file holds: the vehicle may return to one of them instead of its home."""
    return read_plan(path).rally_points if _is_plan(path) else 0


def _is_plan(path: Path) -> bool:
    try:
        start = path.read_bytes()[:64].removeprefix(b"\xef\xbb\xbf").lstrip()
    except OSError as error:
        raise MissionError(f"{path}: expected a readable mission file, got: {error}") from error
    if start.startswith(b"{"):
        return True
    if start.startswith(b"QGC WPL"):
        return False
    raise MissionError(
        f"{path}: expected a QGroundControl plan (JSON) or a QGC WPL 110 file, got neither: export the mission as one"
    )


def command_name(command: int) -> str:
    """Return a command's MAV_CMD name without its prefix, its number where it is not known here."""
    if command in _NOT_FOLLOWED:
        return _NOT_FOLLOWED[command][0]
    return (_UNDERSTOOD | _CONDITIONS | NO_EFFECT).get(command, f"command {command}")


def _home(
    first: MissionItem,
    name: str,
    autopilot: Autopilot,
    frame: LocalFrame,
    home_m: FloatArray | None,
    ground: Ground | None,
) -> tuple[FloatArray, list[Gap], list[str]]:
    """Return where the vehicle stands, what is doubtful about that, and notes."""
    told = None if home_m is None else np.array(home_m, dtype=float)
    row = None
    if autopilot == "ardupilot" and first.command == WAYPOINT and first.frame in _AMSL_FRAMES and (first.x or first.y):
        row = _local(first, name, frame, first.z)
    home = told if row is None else row
    if home is None:
        raise MissionError(
            f"{name}: missing home: "
            + (
                "PX4's missions have none: give the vehicle's home in the mission file"
                if autopilot == "px4"
                else "item 0 gives no position AMSL: give the vehicle's home there (plannedHomePosition of a .plan)"
            )
        )
    if not np.isfinite(home).all():
        raise MissionError(f"{name}: expected a home of finite numbers, got {home.tolist()}")
    gaps: list[Gap] = []
    notes: list[str] = []
    if row is not None and told is not None:
        apart_m = float(np.linalg.norm(row - told))
        if apart_m > _HOME_TOLERANCE_M:
            gaps.append(
                Gap(0, f"home: the mission's lies {apart_m:.0f} m from the vehicle's own: heights are not known")
            )
        elif apart_m > 1.0:
            notes.append(f"home in the mission lies {apart_m:.1f} m from the vehicle's own")
    if autopilot == "ardupilot" and first.command != WAYPOINT:
        gaps.append(Gap(0, f"{command_name(first.command)}: item 0 is overwritten by home and never flown"))
    if ground is not None:
        height_m = float(home[2]) - ground(float(home[0]), float(home[1]))
        if math.isnan(height_m):
            gaps.append(Gap(0, "home: no terrain is known there to hold its altitude to"))
        elif abs(height_m) > _HOME_TOLERANCE_M:
            gaps.append(Gap(0, f"home: lies {height_m:.0f} m above the terrain's ground: which altitude is right?"))
    return home, gaps, notes


def _check_duration(legs: Sequence[Leg], name: str) -> None:
    """Refuse what takes longer to fly than anybody flies, before it takes as long to predict."""
    flown_s = 0.0
    for before, leg in pairwise(legs):
        flown_s += float(np.linalg.norm(leg.end_m - before.end_m)) / leg.speed_m_s
        if not flown_s <= _DAY_S:
            raise MissionError(
                f"{name}: item {leg.seq}: expected to be flown within a day, got {flown_s / 3600.0:.3g} hours at the "
                f"speeds that are set ({leg.speed_m_s:g} m/s there): correct the DO_CHANGE_SPEED before it"
            )


def _where(item: MissionItem, name: str) -> str:
    return f"{name}: item {item.seq} ({command_name(item.command)})"


def _check_position(item: MissionItem, name: str) -> None:
    lat_deg, lon_deg = wire_to_degrees(item.x), wire_to_degrees(item.y)
    if not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0 and abs(item.z) <= _HIGHEST_M):
        raise MissionError(
            f"{_where(item, name)}: expected a latitude, a longitude and an altitude, "
            f"got {lat_deg}, {lon_deg} and {item.z}"
        )


def _local(item: MissionItem, name: str, frame: LocalFrame, alt_amsl_m: float) -> FloatArray:
    """Return an item's position (3,), if it is one near by."""
    _check_position(item, name)
    lat_deg, lon_deg = wire_to_degrees(item.x), wire_to_degrees(item.y)
    position_m = frame.to_local(lat_deg, lon_deg, alt_amsl_m)
    if not math.hypot(position_m[0], position_m[1]) <= _REACH_M:
        raise MissionError(
            f"{_where(item, name)}: expected a place within {_REACH_M / 1000:.0f} km of the mission's origin, "
            f"got {lat_deg}, {lon_deg}: is it another site's mission?"
        )
    return position_m


class _Reader:
    """Reads items one after the other, as the vehicle flies them."""

    def __init__(
        self,
        name: str,
        autopilot: Autopilot,
        vehicle_class: VehicleClass,
        frame: LocalFrame,
        home_m: FloatArray,
        motion: MotionModel,
        speed_m_s: float,
        airspeed_limits_m_s: tuple[float, float],
        ground: Ground | None,
    ) -> None:
        self.name = name
        self.ardupilot = autopilot == "ardupilot"
        self.plane = vehicle_class == "plane"
        self.frame = frame
        self.home_m = home_m
        self.motion = motion
        self.speed_m_s = self.default_m_s = speed_m_s
        self.climb_m_s = self.descent_m_s = math.inf
        self.airspeed_limits_m_s = airspeed_limits_m_s
        self.ground = ground
        self.here_m = home_m
        self.wait_s = 0.0  # on the ground
        self.waits_s = 0.0  # all holds and waits so far
        self.delayed = False  # whether DO commands wait for a condition
        self.datums: dict[str, int] = {}  # the first item in each
        self.legs: list[Leg] = []
        self.gaps: list[Gap] = []
        self.notes: list[str] = []
        self.ending: Ending | None = None
        self.ending_seq = self.ending_command = 0

    def read(self, items: Sequence[MissionItem]) -> None:
        """Read a mission without its home item."""
        if not self.ardupilot:
            started = [item.seq for item in items if item.current]
            if started and started != [0]:
                self.gaps.append(Gap(started[-1], "is the current item: PX4 starts there, not at the first"))
        for k, item in enumerate(items):
            self._take(item)
            if self.ending is not None:
                self._after_the_end(items[k + 1 :])
                break
        else:
            what = "ArduPlane returns home" if self.ardupilot and self.plane else "it stays at its last waypoint"
            self.notes.append(f"no item ends the mission: {what}")
        if len(self.datums) > 1:
            told = " and ".join(f"{datum} (first in item {seq})" for datum, seq in self.datums.items())
            self.notes.append(f"altitudes are mixed: {told}")

    def _take(self, item: MissionItem) -> None:
        if item.command in NO_EFFECT:
            return
        if item.command in _CONDITIONS:
            self.delayed = True
            return
        if item.command == CHANGE_SPEED:
            self._change_speed(item)
            return
        if item.command not in _UNDERSTOOD:
            self._gap(item, _NOT_FOLLOWED.get(item.command, ("", "is not known"))[1])
            return
        self.delayed = False  # a condition ends with the waypoint that it was given at
        if not self.ardupilot and not item.autocontinue:
            self._gap(item, "PX4 goes no further, autocontinue is 0")
        take = {
            TAKEOFF: self._take_off,
            WAYPOINT: self._waypoint,
            SPLINE_WAYPOINT: self._spline,
            LOITER_UNLIMITED: self._loiter,
            LOITER_TURNS: self._loiter,
            LOITER_TIME: self._loiter,
            LAND: self._land,
            RETURN_TO_LAUNCH: self._return,
            NAV_DELAY: self._delay,
        }[item.command]
        take(item)

    def _after_the_end(self, rest: Sequence[MissionItem]) -> None:
        """Say what comes after the mission's end; an autopilot that may take off again is a gap."""
        again = next((item for item in rest if item.command in (TAKEOFF, 84)), None)
        if again is not None and self.ending_command != LOITER_UNLIMITED:  # MIS_OPTIONS bit 2; PX4 does so once armed
            self._gap(again, f"may take off again after {command_name(self.ending_command)}")
        elif rest:
            which = f"item {rest[0].seq}" if len(rest) == 1 else f"items {rest[0].seq} to {rest[-1].seq}"
            self.notes.append(f"{which} after {command_name(self.ending_command)} are not flown")

    def _gap(self, item: MissionItem, why: str) -> None:
        self.gaps.append(Gap(item.seq, f"{command_name(item.command)}: {why}"))

    def _position(self, item: MissionItem) -> FloatArray:
        """Return where an item is (3,).

        ArduPilot takes 0, 0 as where it is; ArduCopter, and at 0, 0 ArduPlane too, altitude 0 as how high it is, in any
        frame (loc_from_cmd, Plane::set_next_WP). To PX4 these are numbers like others.
        """
        held = self._held(item)
        place = self._place(item)
        if held and self.plane:
            self._gap(item, "0, 0 is wherever the plane then is")
        elif held and self.legs and self.legs[-1].kind == "circle":
            self._gap(item, "0, 0 is wherever on its circle it then is")
        return np.array([place[0], place[1], self._altitude(item, place, level=int(item.z * 100.0) == 0 and held)])

    def _held(self, item: MissionItem) -> bool:
        return self.ardupilot and item.x == 0 and item.y == 0

    def _place(self, item: MissionItem) -> FloatArray:
        """Return an item's place (3,), whose altitude means nothing."""
        return self.here_m if self._held(item) else _local(item, self.name, self.frame, 0.0)

    def _altitude(self, item: MissionItem, place: FloatArray, *, level: bool) -> float:
        """Return an item's altitude AMSL; ``level``: keeps the one before."""
        _check_position(item, self.name)
        if item.frame in _TERRAIN_FRAMES:
            self._gap(item, "height above the terrain that the vehicle knows, which is not known here")
            ground_m = math.nan if self.ground is None else self.ground(float(place[0]), float(place[1]))
            return ground_m + item.z if math.isfinite(ground_m) else float(self.here_m[2])
        if item.frame not in (*_AMSL_FRAMES, *_HOME_FRAMES):
            self._gap(item, f"altitude in frame {item.frame}, which is none of 0, 3, 5, 6")
            return float(self.here_m[2])
        if level or (self.ardupilot and not self.plane and int(item.z * 100.0) == 0):
            return float(self.here_m[2])
        amsl = item.frame in _AMSL_FRAMES
        if item.command != TAKEOFF:  # its height is above home in many missions, ours too
            self.datums.setdefault("AMSL" if amsl else "above home", item.seq)
        return item.z if amsl else float(self.home_m[2]) + item.z

    def _add(self, leg: Leg) -> None:
        self.legs.append(leg)
        self.here_m = leg.end_m

    def _fly(self, item: MissionItem, end_m: FloatArray, kind: LegKind = "straight", hold_s: float = 0.0) -> None:
        """Add a leg; before the first comes a take-off."""
        if not self.legs and self._lift(item, end_m):
            return
        vertical_m_s = self.climb_m_s if end_m[2] > self.here_m[2] else self.descent_m_s
        self._add(Leg(item.seq, kind, end_m, self.speed_m_s, hold_s, vertical_m_s=vertical_m_s))

    def _lift(self, item: MissionItem, end_m: FloatArray) -> bool:
        """Add the take-off of a mission that has no item for it; return whether that is all there is to fly.

        PX4's copters climb straight up to the first waypoint's altitude (do_need_takeoff); nobody else starts.
        """
        if self.plane:
            self._gap(item, "no take-off comes before it")
            self._add(Leg(item.seq, "takeoff", end_m, self.motion.cruise_speed_m_s))
            return True
        if self.ardupilot:
            self._gap(item, "no take-off comes before it: ArduCopter does not start (Missing Takeoff Cmd)")
        self._climb(item, float(end_m[2]))
        return False

    def _climb(self, item: MissionItem, alt_amsl_m: float) -> None:
        """Add a copter's take-off, straight up from home."""
        least_m = 0.0 if self.ardupilot else self.motion.px4.takeoff_least_m
        if not alt_amsl_m >= self.home_m[2] + _LEAST_CLIMB_M:
            self._gap(item, f"take-off to {alt_amsl_m:.1f} m AMSL is not above home at {self.home_m[2]:.1f} m")
        elif alt_amsl_m < self.home_m[2] + least_m - _SAME_PLACE_M:
            height_m = alt_amsl_m - self.home_m[2]
            self._gap(item, f"take-off to {height_m:.1f} m above home: PX4 climbs to {least_m:g} m (MIS_TAKEOFF_ALT)")
        self._add(Leg(item.seq, "takeoff", np.array([*self.home_m[:2], alt_amsl_m]), self.speed_m_s))

    def _take_off(self, item: MissionItem) -> None:
        """ArduCopter ignores latitude and longitude; PX4 climbs at home, then flies to them; planes fly to them."""
        if self.legs:
            self._gap(item, "take-off in flight")
            return
        if self.plane:
            self._take_off_plane(item)
            return
        place = self.home_m if self.ardupilot else self._place(item)
        alt_amsl_m = self._altitude(item, place, level=False)
        self._climb(item, alt_amsl_m)
        aside_m = math.hypot(*(place[:2] - self.home_m[:2]))
        if aside_m > self.motion.waypoint_radius_m:
            self._add(Leg(item.seq, "straight", np.array([place[0], place[1], alt_amsl_m]), self.speed_m_s))

    def _take_off_plane(self, item: MissionItem) -> None:
        place = self._place(item)
        if self._held(item) or math.hypot(*(place[:2] - self.home_m[:2])) < 1.0:
            self._gap(item, "no direction is given: a plane climbs out the way it stands")
            place = self.home_m
        elif self.ardupilot:  # do_takeoff: next_WP_loc is home, the course is held
            self.notes.append("ArduPlane climbs out the way it stands: place it facing the take-off's position")
        end_m = np.array([place[0], place[1], self._altitude(item, place, level=False)])
        if not end_m[2] >= self.home_m[2] + _LEAST_CLIMB_M:
            self._gap(item, f"take-off to {end_m[2]:.1f} m AMSL is not above home at {self.home_m[2]:.1f} m")
        self._add(Leg(item.seq, "takeoff", end_m, self.motion.cruise_speed_m_s))

    def _waypoint(self, item: MissionItem) -> None:
        end_m = self._position(item)
        if self.plane:
            if not self.ardupilot and not item.param1 <= 0.0 and not math.isnan(item.param1):
                self._gap(item, "PX4 makes a plane circle where it is to hold")
            if item.param3 != 0.0 and not math.isnan(item.param3) and self.ardupilot:
                self._gap(item, "passes its waypoint by (param 3)")
        # ArduCopter drops it; ArduPlane keeps whole metres
        slack_m = 0.5 if self.plane else 0.0
        if (self.plane or not self.ardupilot) and item.param2 > self.motion.waypoint_radius_m + slack_m + 1e-3:
            radius = f"{item.param2:g} m accepts it further away than {self.motion.waypoint_radius_m:g} m"
            self._gap(item, f"its radius of {radius}")
        self._fly(item, end_m, hold_s=0.0 if self.plane else self._seconds(item))

    def _spline(self, item: MissionItem) -> None:
        end_m = self._position(item)
        if self.plane or not self.ardupilot:
            self._gap(item, "only ArduCopter flies splines")
            self._fly(item, end_m)
            return
        if any(leg.kind == "circle" for leg in self.legs[-2:]):
            self._gap(item, "a spline after a circle: where that is left is not known")
        self._fly(item, end_m, "spline", self._seconds(item))

    def _seconds(self, item: MissionItem) -> float:
        """Return how long an item holds the vehicle; ArduPilot keeps whole seconds (uint16)."""
        seconds = item.param1
        if not self.ardupilot:
            if math.isinf(seconds):
                self._gap(item, "is held for ever")
                return 0.0
            return 0.0 if math.isnan(seconds) else self._waits(item, max(seconds, 0.0))
        if not 0.0 <= seconds <= _STORED_SECONDS:
            self._gap(item, f"ArduPilot cannot hold it for {seconds:g} s")
            return 0.0
        return self._waits(item, float(int(seconds)))

    def _waits(self, item: MissionItem, seconds: float) -> float:
        """Return how long an item lets the vehicle wait, no time where all waits come to more than a day."""
        if self.waits_s + seconds > _DAY_S:
            self._gap(item, f"a wait of {seconds:g} s: all waits of a mission must take less than a day")
            return 0.0
        self.waits_s += seconds
        return seconds

    def _loiter(self, item: MissionItem) -> None:
        center_m = self._position(item)
        if item.command == LOITER_TURNS and not self.ardupilot:
            self._gap(item, "PX4 refuses it")
        if self.plane:
            self._circle_plane(item, center_m)
        elif item.command == LOITER_TURNS:
            self._circle_copter(item, center_m)
        elif item.command == LOITER_TIME:
            # it is a stop even if for no time
            self._fly(item, center_m, hold_s=max(self._seconds(item), _BRIEF_STOP_S))
        elif not self._is_at(center_m):
            self._fly(item, center_m)
        if item.command == LOITER_UNLIMITED:
            self._end(item, "loiter")

    def _circle_copter(self, item: MissionItem, center_m: FloatArray) -> None:
        """Add ArduCopter's circle; its speed is neither the mission's nor that of other legs (AC_Circle)."""
        radius_m = abs(item.param3) if math.isfinite(item.param3) else 0.0
        if not 1.0 <= radius_m <= _STORED_RADIUS_M:
            self._gap(item, f"its radius is the vehicle's own, not {item.param3:g} m")
        radius_m = float(int(radius_m)) if 1.0 <= radius_m <= _STORED_RADIUS_M else max(radius_m, _CIRCLE_RADIUS_M)
        lateral_m_s = math.sqrt(0.5 * self.motion.acceleration_m_s2 * radius_m)
        speed_m_s = min(self.speed_m_s, lateral_m_s, _CIRCLE_RATE_RAD_S * radius_m)
        if not self.legs:
            self._lift(item, center_m)
        self._add(Leg(item.seq, "circle", center_m, speed_m_s, radius_m=radius_m, turns=self._turns(item)))

    def _turns(self, item: MissionItem) -> float:
        if not 0.0 < item.param1 <= _STORED_RADIUS_M:
            self._gap(item, f"ArduPilot cannot fly {item.param1:g} turns")
            return math.inf
        return item.param1

    def _circle_plane(self, item: MissionItem, center_m: FloatArray) -> None:
        """Add a plane's circle, unless it is the one that it flies wherever a mission ends.

        ArduPlane has its own radius for LOITER_TIME; 0 means the vehicle's own for all.
        """
        asked_m = abs(item.param3) if math.isfinite(item.param3) else 0.0
        if (self.ardupilot and item.command == LOITER_TIME) or asked_m == 0.0:
            asked_m = self.motion.loiter_radius_m
        if self.ardupilot and item.command == LOITER_TURNS and asked_m > _STORED_RADIUS_M:
            self._gap(item, f"its radius of {asked_m:g} m is stored differently from version to version")
        own = abs(asked_m - self.motion.loiter_radius_m) <= 0.5 + 1e-3 and not item.param3 < 0.0
        if item.command == LOITER_UNLIMITED and own:
            if not self._is_at(center_m):
                self._fly(item, center_m)
            return
        hold_s, turns = 0.0, math.inf
        if item.command == LOITER_TURNS:
            turns = self._turns(item) + 1.0  # one more until it heads for the next waypoint
        elif item.command == LOITER_TIME:
            hold_s = self._seconds(item)
            turns = hold_s * self.speed_m_s / (2.0 * math.pi * asked_m) + 1.0 if asked_m > 0.0 else math.inf
        if not self.legs:
            self._lift(item, center_m)
        self._add(Leg(item.seq, "circle", center_m, self.speed_m_s, hold_s, asked_m, turns))

    def _land(self, item: MissionItem) -> None:
        """Fly to where it lands, no lower than before, then down; ArduPilot at 0, 0 straight down.

        The altitude is ignored by ArduCopter (shift_alt_to_current_alt), and by PX4 until it is there
        (do_need_move_to_land).
        """
        _check_position(item, self.name)
        if not self.legs:
            self._gap(item, "lands without having taken off")
        if not self.ardupilot and item.param2 > 0.0:
            self._gap(item, "a precision landing follows what it sees")
        place = self._place(item)
        if not self._held(item) and item.frame not in (*_AMSL_FRAMES, *_HOME_FRAMES):
            self._gap(item, f"altitude in frame {item.frame}, which is none of 0, 3, 5, 6")
        end_m = np.array([place[0], place[1], self.here_m[2]])
        if self.plane:
            self._gap(item, "a plane's approach, flare and go-around are not modelled")
            end_m[2] = self._altitude(item, place, level=False)
        elif self._rolling_spline() and self._altitude(item, place, level=False) != self.here_m[2]:
            self._gap(item, "the spline before it bends towards its altitude")
        circled = bool(self.legs) and self.legs[-1].kind == "circle"
        if self.legs and not (self._is_at(end_m) or (circled and self._held(item))):
            self._fly(item, end_m)
        self._end(item, "land")

    def _is_at(self, place_m: FloatArray) -> bool:
        """Return whether it is in the air and at a place already; around a circle's centre it is not."""
        if not self.legs or self.legs[-1].kind == "circle":
            return False
        return bool(np.linalg.norm(place_m - self.here_m) <= _SAME_PLACE_M)

    def _rolling_spline(self) -> bool:
        """Return whether the leg before is a spline that looks at what comes next."""
        return bool(self.legs) and self.legs[-1].kind == "spline" and self.legs[-1].hold_s == 0.0

    def _return(self, item: MissionItem) -> None:
        self._end(item, "rtl")

    def _end(self, item: MissionItem, ending: Ending) -> None:
        self.ending, self.ending_seq, self.ending_command = ending, item.seq, item.command

    def _delay(self, item: MissionItem) -> None:
        """Wait: on the ground, or in place (ArduPlane in the air: not at all; PX4 knows seconds only)."""
        seconds = item.param1
        if not (math.isfinite(seconds) and seconds > 0.0):
            if self.ardupilot or not seconds <= 0.0:
                self._gap(item, "until an hour of the day: its times are not known")
            return
        if not self.legs:
            self.wait_s += self._waits(item, seconds)
            return
        if self.plane:
            if not self.ardupilot:
                self._gap(item, "how a plane of PX4 waits is not known")
            return
        seconds = self._waits(item, seconds)
        last = self.legs[-1]
        if self._rolling_spline():
            self._gap(item, "how the spline before it ends is not known")
        if last.kind == "takeoff":
            self._add(Leg(item.seq, "straight", last.end_m, self.speed_m_s, seconds))
        else:
            self.legs[-1] = replace(last, hold_s=last.hold_s + seconds)

    def _change_speed(self, item: MissionItem) -> None:
        """Set the speed of the legs after it.

        PX4 takes any type, and its default for 0 and less. ArduCopter: types 0 and 1 are horizontal, 0 and less are
        ignored. ArduPlane: airspeed within its limits, -2 for its default; "ground speed" sets its least one.
        """
        kind, value_m_s = item.param1, item.param2
        if self.delayed:
            self._gap(item, "comes after a condition, when is not known")
        if not self.ardupilot:
            if math.isinf(value_m_s):
                self._gap(item, f"to {value_m_s} m/s")
            else:
                self.speed_m_s = value_m_s if value_m_s > 0.0 else self.default_m_s
            return
        if not (math.isfinite(kind) and math.isfinite(value_m_s)):
            self._gap(item, f"ArduPilot refuses the speed {value_m_s:g} m/s of type {kind:g}")
            return
        if self.plane:
            self._change_airspeed(item)
        elif value_m_s <= 0.0:
            self.notes.append(f"item {item.seq}: ArduCopter ignores a speed of {value_m_s:g} m/s")
        elif int(kind) in (_CLIMB_SPEED, _DESCENT_SPEED) and value_m_s < _LEAST_RATE_M_S:
            self._gap(item, f"what ArduCopter makes of a climb or descent at {value_m_s:g} m/s is not known")
        elif int(kind) == _CLIMB_SPEED:
            self.climb_m_s = value_m_s
        elif int(kind) == _DESCENT_SPEED:
            self.descent_m_s = value_m_s
        elif int(kind) not in (_AIRSPEED, _GROUND_SPEED):
            self._gap(item, f"changes a speed of type {kind:g}, which is not known")
        elif value_m_s < _LEAST_SPEED_M_S:
            if len(self.legs) < 2:  # kept until the first waypoint, and then raised
                self._gap(item, f"what ArduCopter makes of {value_m_s:g} m/s before its first waypoint is not known")
            self.notes.append(f"item {item.seq}: ArduCopter ignores a speed of {value_m_s:g} m/s")
        else:
            self.speed_m_s = value_m_s
            if not self.legs:
                self.notes.append(f"item {item.seq}: before 4.5, ArduCopter forgets a speed set before the take-off")

    def _change_airspeed(self, item: MissionItem) -> None:
        value_m_s = item.param2
        low_m_s, high_m_s = self.airspeed_limits_m_s
        if int(item.param1) == _GROUND_SPEED:
            if value_m_s > self.speed_m_s:
                self._gap(item, f"a least ground speed of {value_m_s:g} m/s, above its airspeed: how fast is not known")
            else:
                self.notes.append(f"item {item.seq}: ArduPlane takes a ground speed for its least one")
        elif int(item.param1) != _AIRSPEED:
            self._gap(item, "changes how fast it climbs or sinks, which is not modelled")
        elif value_m_s == -2.0:
            self.speed_m_s = self.default_m_s
        elif value_m_s > 0.0 and low_m_s <= value_m_s <= high_m_s:
            self.speed_m_s = value_m_s
        elif 0.0 < item.param3 <= 100.0:
            self._gap(item, "sets the throttle: how fast it flies is not known")
        else:
            self.notes.append(f"item {item.seq}: ArduPlane ignores an airspeed of {value_m_s:g} m/s")
