"""A fleet plan as MAVLink mission items and back; the only place that scales degrees to 1e-7.

The two autopilots want different missions (https://mavlink.io/en/services/mission.html):

- ArduPilot keeps home in seq 0 and overwrites whatever was sent there, so a take-off must be seq 1. Its take-off height
  is above home. It refuses NaN in most parameters.
- PX4 has no home item; the take-off is seq 0, at its altitude AMSL. NaN means "leave it to the vehicle" and is needed
  in p4, where 0 would turn the nose north.

Planes are told what they would else take from parameters: how steeply to climb out, when the goal counts as reached (it
would depend on the item after it), how wide to circle there.

What a camera does is one item for each :class:`.Step`. Of what both autopilots know (ArduPilot 4.5's AP_Mission,
AP_Camera and ModeAuto; PX4 1.15's mission_block, navigator_main, gimbal/input_mavlink and camera_trigger), what each
obeys whatever gimbal and camera it has, and every ground station sends on as it is written:

===================  =================================  ===============================================================
step                 item                               rather than
===================  =================================  ===============================================================
aim                  DO_SET_ROI_LOCATION, AMSL          DO_GIMBAL_MANAGER_PITCHYAW: ArduPilot keeps whole degrees, PX4
                                                        obeys only who is in control, and its flags are in param 5,
                                                        which some ground stations scale as a latitude;
                                                        DO_MOUNT_CONTROL: a heading of the vehicle's own
release              DO_SET_ROI_NONE                    gimbal commands to neutral: likewise
photos, one          IMAGE_START_CAPTURE, param 3: 1    DO_DIGICAM_CONTROL: params 5 and 6; PX4 makes it of the former
photos in passing    IMAGE_START_CAPTURE, a second      (PX4 then asks the camera itself, not its own trigger)
                     between them
trigger              DO_SET_CAM_TRIGG_DIST, param 3: 1  DO_SET_CAM_TRIGG_INTERVAL: ArduPilot has none
stand                NAV_DELAY                          a waypoint at the same place
===================  =================================  ===============================================================

A region of interest turns an ArduCopter whose gimbal cannot pan, and the gimbal of any other; it moves neither off its
way. Both autopilots do such items when the waypoint before them is done, its hold included: ArduPilot as the next leg
begins, one in every other turn of its main loop, PX4 one after the other before it. So what stands before a waypoint
holds on the way to it, and a photo that nobody shall be moved or turned away from is followed by a delay.

Waypoints are AMSL on both. The speed comes right after the take-off: ArduCopter lost it during the take-off until
December 2023, and PX4 wants it in MAV_FRAME_MISSION.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.plan import PHOTO_S, FleetPlan, Step, VehiclePlan
from missionplanner.vehicle import Autopilot

DEGREE_SCALE = 10_000_000

FRAME_GLOBAL = 0  # altitude AMSL
FRAME_MISSION = 2  # no position
FRAME_RELATIVE = 3  # altitude above home

WAYPOINT = 16
LOITER_UNLIMITED = 17
RETURN_TO_LAUNCH = 20
LAND = 21
TAKEOFF = 22
NAV_DELAY = 93
CHANGE_SPEED = 178
SET_ROI_LOCATION = 195
SET_ROI_NONE = 197
SET_TRIGGER_DISTANCE = 206
IMAGE_START_CAPTURE = 2000

_AIRSPEED, _GROUND_SPEED = 0.0, 1.0
_THROTTLE_UNCHANGED = -1.0
_NAN = bytes.fromhex("0000c07f")
_KEEPS_ALTITUDE_M = 0.02  # ArduPilot takes an altitude of less than a centimetre for "as high as now"
_CLIMB_OUT_DEG = 15.0  # least pitch; without it ArduPlane takes 4 degrees


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One MISSION_ITEM_INT in wire names and wire units (https://mavlink.io/en/messages/common.html#MISSION_ITEM_INT).

    ``x`` and ``y`` are latitude and longitude in 1e-7 degrees; ``z`` is metres in the datum of ``frame``:
    0 (MAV_FRAME_GLOBAL) AMSL, 3 above home, 10 above ground; frame 2 (MAV_FRAME_MISSION) has no position. Floats are
    held as the wire carries them, in single precision (0.2 mm at 2000 m), so that what reads back can be equal.
    """

    seq: int
    frame: int
    command: int
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    x: int = 0
    y: int = 0
    z: float = 0.0
    current: int = 0
    autocontinue: int = 1

    def __post_init__(self) -> None:
        if not (0 <= self.frame <= 255 and 0 <= self.command <= 65_535):
            raise MissionError(
                f"mission item {self.seq}: expected a frame up to 255 and a command up to 65535, "
                f"got {self.frame} and {self.command}"
            )
        for name in ("param1", "param2", "param3", "param4", "z"):
            object.__setattr__(self, name, to_float32(getattr(self, name)))


def to_float32(value: float) -> float:
    """Return the nearest single-precision number; NaN as the one object ``math.nan``, so that items compare equal."""
    if math.isnan(value):
        return math.nan
    with np.errstate(over="ignore"):  # what is too large for the wire becomes infinite there, and is refused there
        return float(np.float32(value))


def float32_text(value: float) -> str:
    """Return the shortest decimal that reads back as the same single-precision number."""
    return "nan" if math.isnan(value) else np.format_float_positional(np.float32(value), unique=True, trim="-")


def degrees_to_wire(degrees: float) -> int:
    """Return degrees in units of 1e-7, rounded to the nearest (truncation is off by one for 6 % of values)."""
    return round(degrees * DEGREE_SCALE)


def wire_to_degrees(wire: int) -> float:
    """Return units of 1e-7 degrees as degrees."""
    return wire / DEGREE_SCALE


def plan_items(vehicle: VehiclePlan, frame: LocalFrame) -> tuple[MissionItem, ...]:
    """Return one vehicle's mission: (home,) take-off, speed, waypoints, ending; ``current`` marks the first item.

    The first waypoint is the take-off item itself; the goal is a waypoint of its own before the ending, so that its
    arrival is reported.
    """
    ardupilot = vehicle.autopilot == "ardupilot"
    top_m, goal_m = vehicle.waypoints_m[0], vehicle.waypoints_m[-1]
    unset = 0.0 if ardupilot else math.nan
    plane = vehicle.vehicle_class == "plane"
    accept_m = 0.0 if ardupilot else vehicle.motion.waypoint_radius_m  # ArduCopter drops it
    # a plane flies by airspeed; ArduPlane would take a "ground speed" for its least one
    speed_type = _AIRSPEED if plane else _GROUND_SPEED

    def at(command: int, position_m: FloatArray, param2: float = 0.0) -> MissionItem:
        point = frame.geo_point(position_m)
        x, y = degrees_to_wire(point.lat_deg), degrees_to_wire(point.lon_deg)
        return MissionItem(0, FRAME_GLOBAL, command, param2=param2, param4=unset, x=x, y=y, z=point.alt_amsl_m)

    def through(item: MissionItem) -> MissionItem:
        return replace(item, z=_KEEPS_ALTITUDE_M) if ardupilot and abs(item.z) < _KEEPS_ALTITUDE_M else item

    def step(done: Step) -> MissionItem:
        match done.what:
            case "aim":
                return replace(at(SET_ROI_LOCATION, np.array(done.at_m)), param4=0.0)
            case "release":
                return MissionItem(0, FRAME_MISSION, SET_ROI_NONE)
            case "trigger":
                first = 1.0 if done.amount > 0.0 else 0.0  # the first photo at once
                return MissionItem(0, FRAME_MISSION, SET_TRIGGER_DISTANCE, done.amount, param3=first)
            case "photos":
                between_s = PHOTO_S if done.amount > 1.0 else 0.0
                return MissionItem(0, FRAME_MISSION, IMAGE_START_CAPTURE, 0.0, between_s, done.amount)
            case "stand":
                return MissionItem(0, FRAME_MISSION, NAV_DELAY, done.amount)

    takeoff = replace(at(TAKEOFF, top_m), param1=_CLIMB_OUT_DEG if plane else 0.0)
    if ardupilot:
        takeoff = replace(takeoff, frame=FRAME_RELATIVE, z=float(top_m[2] - vehicle.home_m[2]))
    match vehicle.end:
        case "land":
            ending = at(LAND, np.array([goal_m[0], goal_m[1], vehicle.trajectory.position_m[-1, 2]]))
        case "rtl":
            ending = MissionItem(0, FRAME_MISSION, RETURN_TO_LAUNCH)
        case "loiter":
            radius_m = float(round(vehicle.motion.loiter_radius_m)) if plane else 0.0
            ending = replace(at(LOITER_UNLIMITED, goal_m), param3=radius_m)
    legs: list[MissionItem] = []
    before_m_s = math.nan
    goal_accept_m = float(round(vehicle.motion.waypoint_radius_m)) if plane else accept_m
    steps = vehicle.steps()
    for k, (waypoint_m, speed_m_s) in enumerate(zip(vehicle.waypoints_m[1:], vehicle.speeds_m_s.tolist(), strict=True)):
        before, there = steps[k + 1]
        if speed_m_s != before_m_s:  # it holds until the next one
            legs.append(MissionItem(0, FRAME_MISSION, CHANGE_SPEED, speed_type, speed_m_s, _THROTTLE_UNCHANGED))
        before_m_s = speed_m_s
        accepted_m = goal_accept_m if k == len(vehicle.speeds_m_s) - 1 else accept_m
        later_s = sum(done.amount for done in there if done.what == "stand")
        legs += map(step, before)
        legs.append(replace(through(at(WAYPOINT, waypoint_m, accepted_m)), param1=float(vehicle.hold_s[k]) - later_s))
        legs += map(step, there)
    items = [*([at(WAYPOINT, vehicle.home_m)] if ardupilot else []), takeoff, *legs, ending]
    return tuple(replace(item, seq=seq, current=int(seq == 0)) for seq, item in enumerate(items))


def fleet_items(plan: FleetPlan) -> dict[int, tuple[MissionItem, ...]]:
    """Return every vehicle's mission by sysid."""
    return {vehicle.sysid: plan_items(vehicle, plan.frame) for vehicle in plan.vehicles}


def items_sha256(items: Sequence[MissionItem]) -> str:
    """Return the SHA-256 of a mission as it is sent: every field of every item in its wire type, in order.

    Raises
    ------
    MissionError
        A number that does not fit its field.
    """
    digest = hashlib.sha256()
    for item in items:
        numbers = (item.seq, item.frame, item.command, item.current, item.autocontinue, item.x, item.y)
        floats = (item.z, item.param1, item.param2, item.param3, item.param4)
        try:
            packed = struct.pack("<HBHBBii", *numbers)
        except struct.error as error:
            raise MissionError(
                f"mission item {item.seq}: expected numbers that fit MISSION_ITEM_INT: {error}"
            ) from error
        # NaN has many bit patterns and one meaning
        digest.update(packed + b"".join(_NAN if math.isnan(value) else struct.pack("<f", value) for value in floats))
    return digest.hexdigest()


def goal_seq(items: Sequence[MissionItem]) -> int:
    """Return the seq of the goal: the last waypoint of the mission.

    Raises
    ------
    MissionError
        There is no waypoint.
    """
    for item in reversed(items):
        if item.command in (WAYPOINT, TAKEOFF):
            return item.seq
    raise MissionError("mission: expected at least one waypoint, got none")


def item_waypoints(items: Sequence[MissionItem], autopilot: Autopilot, frame: LocalFrame) -> FloatArray:
    """Return the waypoints (W, 3) of a mission that :func:`plan_items` wrote, the take-off's top first.

    Raises
    ------
    MissionError
        A positioned item in a frame other than AMSL or above home, or heights above home without a home item.
    """
    home = items[0] if autopilot == "ardupilot" and items else None
    points: list[FloatArray] = []
    for item in items if home is None else items[1:]:
        if item.command not in (WAYPOINT, TAKEOFF):
            continue
        if item.frame == FRAME_GLOBAL:
            alt_amsl_m = item.z
        elif item.frame == FRAME_RELATIVE and home is not None:
            alt_amsl_m = home.z + item.z
        else:
            raise MissionError(
                f"mission item {item.seq}: expected an altitude AMSL (frame 0) or above a home item (frame 3), "
                f"got frame {item.frame}"
            )
        points.append(frame.to_local(wire_to_degrees(item.x), wire_to_degrees(item.y), alt_amsl_m))
    return np.stack(points) if points else np.empty((0, 3))
