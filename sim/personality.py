"""What differs between autopilots, as data: modes, the rules of mission transfer, what each stores of an item.

Measured on ArduCopter 4.5.6, ArduPlane 4.5.6 and PX4 1.15 in SITL; where not measured, read in their sources
(AP_Mission, GCS_MAVLink/MissionItemProtocol; PX4 mavlink_mission, Commander).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum, auto
from types import MappingProxyType

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem
from missionplanner.vehicle import Autopilot, VehicleClass


class Behaviour(Enum):
    """What a flight mode makes the vehicle do; nobody is at the sticks, so manual modes hold position in the air."""

    HOLD = auto()
    AUTO = auto()
    GUIDED = auto()
    TAKEOFF = auto()
    RTL = auto()
    LAND = auto()


@dataclass(frozen=True, slots=True)
class Mode:
    """One flight mode: its name, its HEARTBEAT.custom_mode, what it does, and whether one may arm in it."""

    name: str
    custom_mode: int
    behaviour: Behaviour
    armable: bool = True


@dataclass(frozen=True, slots=True)
class TransferRules:
    """How the vehicle's half of a mission upload behaves (https://mavlink.io/en/services/mission.html)."""

    home_is_item_0: bool  # seq 0 is home whatever is sent
    atomic: bool  # the old mission stays until the last item has come; else items replace the old ones one by one
    int_requests: bool | None  # MISSION_REQUEST_INT always, never, or (None) as the peer spoke last
    retry_s: float
    give_up_s: float
    give_up_ack: int | None
    out_of_sequence_ack: int | None  # None: dropped in silence
    second_uploader_ack: int
    one_transfer: bool  # at a time, up or down; downloads are given in order
    repeats_last_ack: bool  # an item already stored as the last is acknowledged again
    partial_writes: bool
    plan_ids: bool  # opaque_id: a CRC32 of each plan
    item_max: tuple[int, int, int]  # of mission, fence and rally points
    timeout_texts: tuple[str, str, str]  # likewise
    frames: frozenset[int]  # that an item with a position may have
    commands: frozenset[int]


ReturnHeight = Callable[[Mapping[str, int | float], float, float], float]
"""Height above home that RTL returns at, from the parameters, the present height above home, and the way home (m)."""


@dataclass(frozen=True, slots=True)
class Personality:
    """One autopilot for one class of vehicle."""

    autopilot: Autopilot
    vehicle_class: VehicleClass
    autopilot_id: int
    type_id: int
    modes: tuple[Mode, ...]
    boot_mode: str
    transfer: TransferRules
    check: Callable[[MissionItem], int]  # MAV_MISSION_RESULT of one item
    stored: Callable[[MissionItem], MissionItem]  # as it reads back
    frame_read: Callable[[int], int]  # the frame that MISSION_ITEM_INT gives back for a stored one
    capabilities: int
    software_version: int
    integers_bytewise: bool  # PARAM_VALUE carries integers by their bytes (PX4), else converted to float
    one_reached_slot: bool  # only the last of several items completed at one instant is reported
    announces_items: bool  # STATUSTEXT for each item begun and each waypoint reached
    start_arms: bool  # MISSION_START arms, and begins at the item it names; else it may name none
    answers: Mapping[int, int | None]  # MAV_RESULT of commands without effect here; None: real ones stay silent too
    takeoff_needs_flight_mode: bool  # NAV_TAKEOFF only in GUIDED (ArduPilot), else it switches mode itself (PX4)
    speed_resets: bool  # DO_CHANGE_SPEED <= 0 restores the default (PX4), else it is ignored
    speed_min_m_s: float  # smaller commanded speeds are ignored
    idle_disarm_parameter: str | None  # seconds armed on the ground until it disarms itself; None: never
    landed_disarm_s: float
    cold_start_s: float  # from power-up until it can be armed
    storage_ready_s: float  # from power-up until it takes a mission
    refusal: int  # MAV_RESULT of a command that the vehicle is in no state to obey
    armed_text: str
    disarmed_text: str
    not_ready_text: str
    no_mission_text: str
    speed_parameter: tuple[str, float]  # its name, and its unit in m/s
    parameters: Mapping[str, int | float]  # beside those of its motion model; integers are INT32, floats REAL32
    return_height_m: ReturnHeight
    speed_limit_parameters: tuple[str, str] | None = None  # speeds commanded outside are ignored

    def mode(self, name: str) -> Mode:
        """Return the mode of that name; there must be one."""
        return next(mode for mode in self.modes if mode.name == name)

    def mode_for(self, behaviour: Behaviour) -> Mode:
        """Return the first mode that behaves so."""
        return next(mode for mode in self.modes if mode.behaviour is behaviour)


NAV_COMMANDS = frozenset(
    {
        mavlink.MAV_CMD_NAV_WAYPOINT,
        mavlink.MAV_CMD_NAV_LOITER_UNLIM,
        mavlink.MAV_CMD_NAV_LOITER_TURNS,
        mavlink.MAV_CMD_NAV_LOITER_TIME,
        mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_NAV_LOITER_TO_ALT,
        mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT,
        mavlink.MAV_CMD_NAV_VTOL_TAKEOFF,
        mavlink.MAV_CMD_NAV_VTOL_LAND,
        mavlink.MAV_CMD_NAV_DELAY,
    }
)
"""Items flown one after the other; every other command of a mission acts at once and is passed over."""

_POSITIONED = NAV_COMMANDS - {mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, mavlink.MAV_CMD_NAV_DELAY} | {
    mavlink.MAV_CMD_DO_SET_HOME,
    mavlink.MAV_CMD_DO_SET_ROI,
    mavlink.MAV_CMD_DO_SET_ROI_LOCATION,
    mavlink.MAV_CMD_DO_LAND_START,
}

FENCE_AND_RALLY_COMMANDS: Mapping[int, frozenset[int]] = MappingProxyType(
    {
        mavlink.MAV_MISSION_TYPE_FENCE: frozenset(
            {
                mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT,
                mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
                mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
                mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
                mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
            }
        ),
        mavlink.MAV_MISSION_TYPE_RALLY: frozenset({mavlink.MAV_CMD_NAV_RALLY_POINT}),
    }
)

_COMMON_DO = frozenset(
    {
        mavlink.MAV_CMD_CONDITION_DELAY,
        mavlink.MAV_CMD_CONDITION_DISTANCE,
        mavlink.MAV_CMD_DO_JUMP,
        mavlink.MAV_CMD_DO_CHANGE_SPEED,
        mavlink.MAV_CMD_DO_SET_HOME,
        mavlink.MAV_CMD_DO_SET_SERVO,
        mavlink.MAV_CMD_DO_LAND_START,
        mavlink.MAV_CMD_DO_SET_ROI_LOCATION,
        mavlink.MAV_CMD_DO_SET_ROI_NONE,
        mavlink.MAV_CMD_DO_SET_ROI,
        mavlink.MAV_CMD_DO_DIGICAM_CONTROL,
        mavlink.MAV_CMD_DO_MOUNT_CONTROL,
        mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
        mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
        mavlink.MAV_CMD_DO_GRIPPER,
        mavlink.MAV_CMD_IMAGE_START_CAPTURE,
        mavlink.MAV_CMD_IMAGE_STOP_CAPTURE,
        mavlink.MAV_CMD_VIDEO_START_CAPTURE,
        mavlink.MAV_CMD_VIDEO_STOP_CAPTURE,
        mavlink.MAV_CMD_SET_CAMERA_ZOOM,
        mavlink.MAV_CMD_SET_CAMERA_FOCUS,
    }
)
_ARDUPILOT_COMMANDS = (
    NAV_COMMANDS
    | _COMMON_DO
    | {
        mavlink.MAV_CMD_NAV_CONTINUE_AND_CHANGE_ALT,
        mavlink.MAV_CMD_NAV_GUIDED_ENABLE,
        mavlink.MAV_CMD_NAV_ALTITUDE_WAIT,
        mavlink.MAV_CMD_NAV_PAYLOAD_PLACE,
        mavlink.MAV_CMD_CONDITION_YAW,
        mavlink.MAV_CMD_DO_SET_RELAY,
        mavlink.MAV_CMD_DO_REPEAT_SERVO,
        mavlink.MAV_CMD_DO_REPEAT_RELAY,
        mavlink.MAV_CMD_DO_SET_REVERSE,
        mavlink.MAV_CMD_DO_DIGICAM_CONFIGURE,
        mavlink.MAV_CMD_DO_FENCE_ENABLE,
        mavlink.MAV_CMD_DO_PARACHUTE,
        mavlink.MAV_CMD_DO_INVERTED_FLIGHT,
        mavlink.MAV_CMD_DO_AUTOTUNE_ENABLE,
        mavlink.MAV_CMD_DO_GUIDED_LIMITS,
        mavlink.MAV_CMD_DO_ENGINE_CONTROL,
        mavlink.MAV_CMD_JUMP_TAG,
        mavlink.MAV_CMD_DO_JUMP_TAG,
    }
)
_PX4_COMMANDS = (NAV_COMMANDS - {mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT, mavlink.MAV_CMD_NAV_LOITER_TURNS}) | (
    _COMMON_DO
    | {
        mavlink.MAV_CMD_CONDITION_GATE,
        mavlink.MAV_CMD_DO_SET_ACTUATOR,
        mavlink.MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET,
        mavlink.MAV_CMD_DO_MOUNT_CONFIGURE,
        mavlink.MAV_CMD_DO_TRIGGER_CONTROL,
        mavlink.MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL,
        mavlink.MAV_CMD_SET_CAMERA_MODE,
        mavlink.MAV_CMD_SET_CAMERA_SOURCE,
        mavlink.MAV_CMD_OBLIQUE_SURVEY,
        mavlink.MAV_CMD_DO_VTOL_TRANSITION,
        mavlink.MAV_CMD_DO_WINCH,
    }
)

_PX4_POLYGONS = frozenset(
    {mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION}
)
# PX4 takes these in the global frames only, and every other command in the mission frame only
_PX4_PLACED = (
    (NAV_COMMANDS - {mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, mavlink.MAV_CMD_NAV_DELAY})
    | {mavlink.MAV_CMD_DO_SET_ROI_LOCATION, mavlink.MAV_CMD_CONDITION_GATE}
    | FENCE_AND_RALLY_COMMANDS[mavlink.MAV_MISSION_TYPE_FENCE]
    | FENCE_AND_RALLY_COMMANDS[mavlink.MAV_MISSION_TYPE_RALLY]
)

_ALT_MAX_M = 83_000.0
_YAW_MAY_BE_NAN = frozenset(
    {
        mavlink.MAV_CMD_NAV_WAYPOINT,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_NAV_VTOL_TAKEOFF,
        mavlink.MAV_CMD_NAV_VTOL_LAND,
    }
)


def _check_ardupilot(item: MissionItem) -> int:
    allowed_nan = {4} if item.command in _YAW_MAY_BE_NAN else set()
    if item.command == mavlink.MAV_CMD_NAV_VTOL_LAND:
        allowed_nan.add(3)
    for number, value in enumerate((item.param1, item.param2, item.param3, item.param4), start=1):
        if not math.isfinite(value) and not (math.isnan(value) and number in allowed_nan):
            return int(mavlink.MAV_MISSION_INVALID_PARAM1) + number - 1
    return _check_place(item)


def _check_px4(item: MissionItem) -> int:
    anywhere = item.command == mavlink.MAV_CMD_DO_SET_ROI
    if not anywhere and (item.frame == mavlink.MAV_FRAME_MISSION) is (item.command in _PX4_PLACED):
        return int(mavlink.MAV_MISSION_UNSUPPORTED)
    if item.command in _PX4_POLYGONS and item.param1 < 3.0:
        return int(mavlink.MAV_MISSION_ERROR)
    for number, value in enumerate((item.param1, item.param2, item.param3, item.param4), start=1):
        if math.isinf(value) or (math.isnan(value) and item.command == mavlink.MAV_CMD_DO_JUMP):
            return int(mavlink.MAV_MISSION_INVALID_PARAM1) + number - 1
    return _check_place(item)


def _check_place(item: MissionItem) -> int:
    if item.command in _POSITIONED:
        if abs(item.x) > 90 * 10**7:
            return int(mavlink.MAV_MISSION_INVALID_PARAM5_X)
        if abs(item.y) > 180 * 10**7:
            return int(mavlink.MAV_MISSION_INVALID_PARAM6_Y)
        if not abs(item.z) < _ALT_MAX_M:
            return int(mavlink.MAV_MISSION_INVALID_PARAM7)
    return int(mavlink.MAV_MISSION_ACCEPTED)


def _stored_by_ardupilot(item: MissionItem) -> MissionItem:
    """Return what AP_Mission's packed storage keeps of an item: see AP_Mission::mavlink_int_to_mission_cmd."""
    if item.command in FENCE_AND_RALLY_COMMANDS[mavlink.MAV_MISSION_TYPE_FENCE]:
        kept = MissionItem(item.seq, mavlink.MAV_FRAME_GLOBAL, item.command, item.param1, x=item.x, y=item.y)
        return replace(kept, param1=0.0) if item.command == mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT else kept
    if item.command == mavlink.MAV_CMD_NAV_RALLY_POINT:
        whole_m = float(int(item.z))  # of heights above home, in 16 bits
        return MissionItem(item.seq, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, item.command, x=item.x, y=item.y, z=whole_m)
    if item.command == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:  # nothing of it is stored
        return MissionItem(item.seq, mavlink.MAV_FRAME_GLOBAL, item.command, current=item.current)
    if item.command not in _POSITIONED:
        return _without_place(item)
    frame = {
        mavlink.MAV_FRAME_MISSION: mavlink.MAV_FRAME_GLOBAL,
        mavlink.MAV_FRAME_GLOBAL_INT: mavlink.MAV_FRAME_GLOBAL,
        mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT,
    }.get(item.frame, item.frame)
    # altitudes are whole centimetres, truncated from float32
    alt_cm = int(np.float32(item.z) * np.float32(100.0))
    item = replace(item, frame=int(frame), z=float(np.float32(alt_cm) * np.float32(0.01)))
    match item.command:
        case mavlink.MAV_CMD_NAV_WAYPOINT:
            return replace(item, param1=_whole(item.param1), param2=0.0, param3=0.0, param4=0.0)
        case mavlink.MAV_CMD_NAV_LAND:
            return replace(item, param1=_whole(item.param1), param2=0.0, param3=0.0, param4=1.0)
        case mavlink.MAV_CMD_NAV_TAKEOFF:
            return replace(item, param1=_whole(item.param1), param2=0.0, param3=0.0, param4=0.0)
        case _:
            return item


def _without_place(item: MissionItem) -> MissionItem:
    """Return what ArduPilot keeps of an item that is nowhere; some have numbers where others have their place."""
    p1, p2, p3, p4 = item.param1, item.param2, item.param3, item.param4
    x, y, z = 0, 0, 0.0
    match item.command:
        case mavlink.MAV_CMD_DO_CHANGE_SPEED | mavlink.MAV_CMD_DO_MOUNT_CONTROL:
            p4 = 0.0
        case mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST:
            p2, p3, p4 = 0.0, float(int(p3) % 256), 0.0
        case mavlink.MAV_CMD_IMAGE_START_CAPTURE:
            p1, p3, p4 = float(int(p1) % 256), _whole(p3), _whole(p4)
        case mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW:  # whole degrees
            p1, p2, p3, p4 = (float(int(p)) for p in (p1, p2, p3, p4))
            x, z = item.x % 256, float(int(item.z) % 256)
        case mavlink.MAV_CMD_DO_DIGICAM_CONTROL:
            p1, p2, p3, p4 = (float(int(p) % 256) for p in (p1, p2, p3, p4))
            x, y = item.x % 256, item.y % 256
    frame = int(mavlink.MAV_FRAME_GLOBAL)
    return replace(item, frame=frame, param1=p1, param2=p2, param3=p3, param4=p4, x=x, y=y, z=z)


def _stored_by_arduplane(item: MissionItem) -> MissionItem:
    """Return what ArduPlane keeps: of a waypoint two radii, in a byte each, and no delay."""
    stored = _stored_by_ardupilot(item)
    if item.command != mavlink.MAV_CMD_NAV_WAYPOINT:
        return stored
    return replace(stored, param1=0.0, param2=_whole(item.param2) % 256.0, param3=_whole(item.param3) % 256.0)


def _whole(value: float) -> float:
    """Return a parameter as a 16-bit field keeps it."""
    return 0.0 if math.isnan(value) else float(min(max(int(value), 0), 65535))


_INTEGER_FRAMES = {
    int(mavlink.MAV_FRAME_GLOBAL): int(mavlink.MAV_FRAME_GLOBAL_INT),
    int(mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT): int(mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT),
}
# what PX4 keeps of the params of an item with a place: MavlinkMissionManager::format_mavlink_mission_item; 4 is a yaw
_PX4_KEPT: dict[int, tuple[int, ...]] = {
    mavlink.MAV_CMD_NAV_WAYPOINT: (1, 2, 4),
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: (3, 4),
    mavlink.MAV_CMD_NAV_LOITER_TIME: (1, 2, 3),
    mavlink.MAV_CMD_NAV_LAND: (2, 4),
    mavlink.MAV_CMD_NAV_TAKEOFF: (4,),
    mavlink.MAV_CMD_NAV_LOITER_TO_ALT: (1, 2),
    mavlink.MAV_CMD_NAV_VTOL_TAKEOFF: (4,),
    mavlink.MAV_CMD_NAV_VTOL_LAND: (4,),
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: (1,),
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: (1,),
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: (1,),
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: (1,),
}


def _stored_by_px4(item: MissionItem) -> MissionItem:
    """Return what PX4's mission_item_s keeps: *_INT frames are its plain ones, unused params 0, yaw is wrapped."""
    if item.frame == mavlink.MAV_FRAME_MISSION:
        return item
    frame = {v: k for k, v in _INTEGER_FRAMES.items()}.get(item.frame, item.frame)
    kept = _PX4_KEPT.get(item.command, ())
    given = (item.param1, item.param2, item.param3, item.param4)
    p1, p2, p3, p4 = (value if number in kept else 0.0 for number, value in enumerate(given, start=1))
    if 4 in kept and math.isfinite(p4):
        p4 %= 360.0
    return replace(item, frame=frame, param1=p1, param2=p2, param3=p3, param4=p4)


_ARDUPILOT_TRANSFER = TransferRules(
    home_is_item_0=True,
    atomic=False,
    int_requests=False,
    retry_s=1.0,
    give_up_s=8.0,
    give_up_ack=mavlink.MAV_MISSION_OPERATION_CANCELLED,
    out_of_sequence_ack=mavlink.MAV_MISSION_INVALID_SEQUENCE,
    second_uploader_ack=mavlink.MAV_MISSION_DENIED,
    one_transfer=False,
    repeats_last_ack=False,
    partial_writes=True,
    plan_ids=False,
    item_max=(650, 255, 255),
    timeout_texts=("Mission upload timeout", "Fence upload timeout", "Rally upload timeout"),
    frames=frozenset({0, 2, 3, 5, 6, 10, 11}),
    commands=_ARDUPILOT_COMMANDS,
)
_PX4_TRANSFER = TransferRules(
    home_is_item_0=False,
    atomic=True,
    int_requests=None,
    retry_s=0.25,
    give_up_s=5.0,
    give_up_ack=None,
    out_of_sequence_ack=None,
    second_uploader_ack=mavlink.MAV_MISSION_ERROR,
    one_transfer=True,
    repeats_last_ack=True,
    partial_writes=False,
    plan_ids=True,
    item_max=(2000, 64, 32),
    timeout_texts=("Operation timeout",) * 3,
    frames=frozenset({0, 2, 3, 5, 6}),
    commands=_PX4_COMMANDS,
)

_COPTER_MODES = (
    Mode("STABILIZE", 0, Behaviour.HOLD),
    Mode("ACRO", 1, Behaviour.HOLD),
    Mode("ALT_HOLD", 2, Behaviour.HOLD),
    Mode("AUTO", 3, Behaviour.AUTO, armable=False),
    Mode("GUIDED", 4, Behaviour.GUIDED),
    Mode("LOITER", 5, Behaviour.HOLD),
    Mode("RTL", 6, Behaviour.RTL, armable=False),
    Mode("CIRCLE", 7, Behaviour.HOLD, armable=False),
    Mode("LAND", 9, Behaviour.LAND, armable=False),
    Mode("POSHOLD", 16, Behaviour.HOLD),
    Mode("BRAKE", 17, Behaviour.HOLD, armable=False),
    Mode("SMART_RTL", 21, Behaviour.RTL, armable=False),
)
_PLANE_MODES = (
    Mode("MANUAL", 0, Behaviour.HOLD),
    Mode("CIRCLE", 1, Behaviour.HOLD, armable=False),
    Mode("STABILIZE", 2, Behaviour.HOLD),
    Mode("FBWA", 5, Behaviour.HOLD),
    Mode("FBWB", 6, Behaviour.HOLD),
    Mode("CRUISE", 7, Behaviour.HOLD),
    Mode("AUTO", 10, Behaviour.AUTO),
    Mode("RTL", 11, Behaviour.RTL, armable=False),
    Mode("LOITER", 12, Behaviour.HOLD),
    Mode("TAKEOFF", 13, Behaviour.TAKEOFF),
    Mode("GUIDED", 15, Behaviour.GUIDED),
)


def _px4_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


_PX4_MODES = (
    Mode("LOITER", _px4_mode(4, 3), Behaviour.HOLD),
    Mode("MANUAL", _px4_mode(1), Behaviour.HOLD),
    Mode("ALTCTL", _px4_mode(2), Behaviour.HOLD),
    Mode("POSCTL", _px4_mode(3), Behaviour.HOLD),
    Mode("TAKEOFF", _px4_mode(4, 2), Behaviour.TAKEOFF),
    Mode("MISSION", _px4_mode(4, 4), Behaviour.AUTO),
    Mode("RTL", _px4_mode(4, 5), Behaviour.RTL),
    Mode("LAND", _px4_mode(4, 6), Behaviour.LAND, armable=False),
    Mode("ACRO", _px4_mode(5), Behaviour.HOLD),
    Mode("OFFBOARD", _px4_mode(6), Behaviour.GUIDED),
    Mode("STABILIZED", _px4_mode(7), Behaviour.HOLD),
)

_COMMON_CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE
    | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
)
_ARDUPILOT_CAPABILITIES = (
    _COMMON_CAPABILITIES | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST | mavlink.MAV_PROTOCOL_CAPABILITY_FTP
)
_PX4_CAPABILITIES = _COMMON_CAPABILITIES | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
_RELEASE = 255  # FIRMWARE_VERSION_TYPE_OFFICIAL


_RTL_ALT_MIN_M = 0.3
_CONE_SLOPE_MIN = 0.5  # shallower cones are none


def _copter_return_height_m(parameters: Mapping[str, int | float], height_m: float, distance_m: float) -> float:
    """ArduCopter: ModeRTL::compute_return_target of 4.5, above home."""
    least_m = max(_RTL_ALT_MIN_M, height_m + max(0.0, 0.01 * parameters["RTL_CLIMB_MIN"]))
    target_m = max(0.01 * parameters["RTL_ALT"], least_m)
    if parameters["RTL_CONE_SLOPE"] >= _CONE_SLOPE_MIN:
        target_m = min(target_m, max(distance_m * parameters["RTL_CONE_SLOPE"], least_m))
    return target_m


def _plane_return_height_m(parameters: Mapping[str, int | float], height_m: float, distance_m: float) -> float:
    """ArduPlane: RTL_ALTITUDE, below 0 the present height."""
    del distance_m
    return float(parameters["RTL_ALTITUDE"]) if parameters["RTL_ALTITUDE"] >= 0.0 else height_m


def _px4_copter_return_height_m(parameters: Mapping[str, int | float], height_m: float, distance_m: float) -> float:
    """PX4 1.15: RTL::findRtlDestination and calculate_return_alt_from_cone_half_angle."""
    target_m, half_angle_deg, near_m = (float(parameters[n]) for n in ("RTL_RETURN_ALT", "RTL_CONE_ANG", "NAV_ACC_RAD"))
    if half_angle_deg > 0.0:
        if distance_m <= near_m:
            target_m = 2.0 * distance_m
        else:
            if distance_m <= parameters["RTL_MIN_DIST"]:
                target_m = min(target_m, distance_m / math.tan(math.radians(min(max(half_angle_deg, 1.0), 89.0))))
            target_m = max(target_m, 2.0 * near_m)
    return max(target_m, height_m)


def _px4_plane_return_height_m(parameters: Mapping[str, int | float], height_m: float, distance_m: float) -> float:
    """PX4 planes end where they circle: RTL_DESCEND_ALT, no higher than they return."""
    del distance_m
    return min(float(parameters["RTL_DESCEND_ALT"]), max(float(parameters["RTL_RETURN_ALT"]), height_m))


_ACCEPTED, _FAILED = int(mavlink.MAV_RESULT_ACCEPTED), int(mavlink.MAV_RESULT_FAILED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)
_BOTH_ANSWER: dict[int, int | None] = {
    mavlink.MAV_CMD_DO_SET_ROI: _ACCEPTED,
    mavlink.MAV_CMD_DO_SET_ROI_LOCATION: _ACCEPTED,
    mavlink.MAV_CMD_DO_SET_ROI_NONE: _ACCEPTED,
    mavlink.MAV_CMD_PREFLIGHT_CALIBRATION: _ACCEPTED,
    mavlink.MAV_CMD_PREFLIGHT_STORAGE: _ACCEPTED,
    mavlink.MAV_CMD_RUN_PREARM_CHECKS: _ACCEPTED,
}
# AP_Camera::handle_command without a camera
_ARDUPILOT_ANSWERS: Mapping[int, int | None] = MappingProxyType(
    {
        **_BOTH_ANSWER,
        mavlink.MAV_CMD_DO_SET_SERVO: _ACCEPTED,
        mavlink.MAV_CMD_DO_SET_RELAY: _ACCEPTED,
        mavlink.MAV_CMD_DO_FENCE_ENABLE: _ACCEPTED,
        mavlink.MAV_CMD_CONDITION_YAW: _ACCEPTED,
        mavlink.MAV_CMD_DO_LAND_START: _FAILED,
        mavlink.MAV_CMD_DO_DIGICAM_CONFIGURE: _ACCEPTED,
        mavlink.MAV_CMD_DO_DIGICAM_CONTROL: _ACCEPTED,
        mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST: _ACCEPTED,
        mavlink.MAV_CMD_IMAGE_START_CAPTURE: _FAILED,
        mavlink.MAV_CMD_IMAGE_STOP_CAPTURE: _ACCEPTED,
        mavlink.MAV_CMD_VIDEO_START_CAPTURE: _FAILED,
        mavlink.MAV_CMD_VIDEO_STOP_CAPTURE: _FAILED,
        mavlink.MAV_CMD_SET_CAMERA_ZOOM: _DENIED,
        mavlink.MAV_CMD_SET_CAMERA_FOCUS: _DENIED,
        mavlink.MAV_CMD_SET_CAMERA_SOURCE: _DENIED,
    }
)
# PX4's Commander leaves these to drivers of cameras and gimbals; where there is none, nobody answers
_PX4_ANSWERS: Mapping[int, int | None] = MappingProxyType(
    {
        **_BOTH_ANSWER,
        mavlink.MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET: _ACCEPTED,
        mavlink.MAV_CMD_NAV_DELAY: None,
        mavlink.MAV_CMD_DO_GO_AROUND: None,
        mavlink.MAV_CMD_DO_DIGICAM_CONTROL: None,
        mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST: None,
        mavlink.MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL: None,
        mavlink.MAV_CMD_DO_TRIGGER_CONTROL: None,
        mavlink.MAV_CMD_SET_CAMERA_MODE: None,
        mavlink.MAV_CMD_SET_CAMERA_ZOOM: None,
        mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: None,
        mavlink.MAV_CMD_DO_WINCH: None,
        mavlink.MAV_CMD_DO_GRIPPER: None,
    }
)

_ARDUCOPTER = Personality(
    autopilot="ardupilot",
    vehicle_class="copter",
    autopilot_id=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA,
    type_id=mavlink.MAV_TYPE_QUADROTOR,
    modes=_COPTER_MODES,
    boot_mode="STABILIZE",
    transfer=_ARDUPILOT_TRANSFER,
    check=_check_ardupilot,
    stored=_stored_by_ardupilot,
    frame_read=lambda frame: frame,
    capabilities=_ARDUPILOT_CAPABILITIES,
    software_version=4 << 24 | 5 << 16 | 6 << 8 | _RELEASE,
    integers_bytewise=False,
    one_reached_slot=True,
    announces_items=True,
    start_arms=False,
    answers=_ARDUPILOT_ANSWERS,
    takeoff_needs_flight_mode=True,
    speed_resets=False,
    speed_min_m_s=0.2,
    idle_disarm_parameter="DISARM_DELAY",
    landed_disarm_s=0.0,
    cold_start_s=42.0,
    storage_ready_s=7.0,
    refusal=mavlink.MAV_RESULT_FAILED,
    armed_text="Arming motors",
    disarmed_text="Disarming motors",
    not_ready_text="Arm: Need Position Estimate",
    no_mission_text="Mode change to AUTO failed: init failed",
    speed_parameter=("WPNAV_SPEED", 0.01),
    # AUTO_OPTIONS 2: a simulated pilot has no throttle stick to raise before a take-off in AUTO
    parameters=MappingProxyType(
        {
            "ARMING_CHECK": 1,
            "AUTO_OPTIONS": 2,
            "DISARM_DELAY": 10,
            "MIS_RESTART": 0,
            "RTL_ALT": 1500,
            "RTL_ALT_TYPE": 0,
            "RTL_CLIMB_MIN": 0,
            "RTL_CONE_SLOPE": 3.0,
        }
    ),
    return_height_m=_copter_return_height_m,
)
_ARDUPLANE = replace(
    _ARDUCOPTER,
    vehicle_class="plane",
    type_id=mavlink.MAV_TYPE_FIXED_WING,
    modes=_PLANE_MODES,
    stored=_stored_by_arduplane,
    boot_mode="MANUAL",
    idle_disarm_parameter=None,
    landed_disarm_s=20.0,
    cold_start_s=23.0,
    speed_parameter=("AIRSPEED_CRUISE", 1.0),
    speed_limit_parameters=("AIRSPEED_MIN", "AIRSPEED_MAX"),
    parameters=MappingProxyType({"ARMING_CHECK": 1, "MIS_RESTART": 0, "RTL_ALTITUDE": 100.0}),
    return_height_m=_plane_return_height_m,
)
_PX4_COPTER = Personality(
    autopilot="px4",
    vehicle_class="copter",
    autopilot_id=mavlink.MAV_AUTOPILOT_PX4,
    type_id=mavlink.MAV_TYPE_QUADROTOR,
    modes=_PX4_MODES,
    boot_mode="LOITER",
    transfer=_PX4_TRANSFER,
    check=_check_px4,
    stored=_stored_by_px4,
    frame_read=lambda frame: _INTEGER_FRAMES.get(frame, frame),
    capabilities=_PX4_CAPABILITIES,
    software_version=1 << 24 | 15 << 16 | 0 << 8 | _RELEASE,
    integers_bytewise=True,
    one_reached_slot=False,
    announces_items=False,
    start_arms=True,
    answers=_PX4_ANSWERS,
    takeoff_needs_flight_mode=False,
    speed_resets=True,
    speed_min_m_s=0.0,
    idle_disarm_parameter="COM_DISARM_PRFLT",
    landed_disarm_s=0.0,
    cold_start_s=10.0,
    storage_ready_s=0.0,
    refusal=mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    armed_text="",
    disarmed_text="",
    not_ready_text="Arming denied: Resolve system health failures first",
    no_mission_text="Mission rejected: no valid mission",
    speed_parameter=("MPC_XY_CRUISE", 1.0),
    parameters=MappingProxyType(
        {
            "COM_DISARM_LAND": 2.0,
            "COM_DISARM_PRFLT": 10.0,
            "MIS_DIST_1WP": 10_000.0,
            "RTL_CONE_ANG": 45,
            "RTL_MIN_DIST": 10.0,
            "RTL_RETURN_ALT": 30.0,
            "RTL_TYPE": 0,  # the only one that is simulated
            "NAV_RCL_ACT": 2,
        }
    ),
    return_height_m=_px4_copter_return_height_m,
)
_PX4_PLANE = replace(
    _PX4_COPTER,
    vehicle_class="plane",
    type_id=mavlink.MAV_TYPE_FIXED_WING,
    speed_parameter=("FW_AIRSPD_TRIM", 1.0),
    parameters=MappingProxyType(
        {
            **_PX4_COPTER.parameters,
            "MIS_TAKEOFF_ALT": 2.5,
            "RTL_DESCEND_ALT": 100.0,
            "RTL_RETURN_ALT": 100.0,
        }
    ),
    return_height_m=_px4_plane_return_height_m,
)

_PERSONALITIES = {(p.autopilot, p.vehicle_class): p for p in (_ARDUCOPTER, _ARDUPLANE, _PX4_COPTER, _PX4_PLANE)}


def personality(autopilot: Autopilot, vehicle_class: VehicleClass) -> Personality:
    """Return the personality of an autopilot that steers a class of vehicle."""
    return _PERSONALITIES[autopilot, vehicle_class]
