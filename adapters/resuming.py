"""Where a flight was broken off, and what of a mission of any origin must be set again to go on from an item.

Autopilots skip what acts at once (speeds, regions of interest, cameras) when they are told to begin at a later item.
What is in force there is issued again, each in the order in which the mission has it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.certificates import Held, read_files, sortie, with_return_heights
from adapters.fleet_vehicle import MODES
from adapters.mission_items import CHANGE_SPEED, TAKEOFF, WAYPOINT, MissionItem, plan_items
from adapters.plan_file import PlanFile, plan_text
from adapters.telemetry_log import read_log
from adapters.waypoints_file import waypoints_text
from missionplanner.errors import MissionError
from missionplanner.files import write_atomic
from missionplanner.mission import Mission
from missionplanner.plan import VehiclePlan
from missionplanner.planner import Watch
from missionplanner.resuming import way_to
from missionplanner.scene import Scene
from missionplanner.vehicle import Autopilot

_JUMPS = (mavlink.MAV_CMD_DO_JUMP, mavlink.MAV_CMD_JUMP_TAG, mavlink.MAV_CMD_DO_JUMP_TAG)
_ROI = (
    mavlink.MAV_CMD_NAV_ROI,
    mavlink.MAV_CMD_DO_SET_ROI_LOCATION,
    mavlink.MAV_CMD_DO_SET_ROI_WPNEXT_OFFSET,
    mavlink.MAV_CMD_DO_SET_ROI_NONE,
    mavlink.MAV_CMD_DO_SET_ROI,
)
_PER_NUMBER = (mavlink.MAV_CMD_DO_SET_RELAY, mavlink.MAV_CMD_DO_SET_SERVO)  # the last of every relay and servo
_VIDEO = (mavlink.MAV_CMD_VIDEO_START_CAPTURE, mavlink.MAV_CMD_VIDEO_STOP_CAPTURE)
_ENDS = (mavlink.MAV_CMD_DO_SET_ROI_NONE, mavlink.MAV_CMD_IMAGE_STOP_CAPTURE, mavlink.MAV_CMD_VIDEO_STOP_CAPTURE)
_TRIGGERS = (mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST, mavlink.MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL)
# what ends what was begun: the last of a group is in force
_GROUPS: dict[int, str] = {
    **dict.fromkeys(_ROI, "region of interest"),
    mavlink.MAV_CMD_DO_MOUNT_CONTROL: "mount",
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: "gimbal",
    mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE: "gimbal's master",
    mavlink.MAV_CMD_DO_MOUNT_CONFIGURE: "mount's mode",
    mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST: "trigger distance",
    mavlink.MAV_CMD_DO_SET_CAM_TRIGG_INTERVAL: "trigger interval",
    mavlink.MAV_CMD_DO_TRIGGER_CONTROL: "trigger",
    mavlink.MAV_CMD_SET_CAMERA_MODE: "camera mode",
    mavlink.MAV_CMD_SET_CAMERA_ZOOM: "zoom",
    mavlink.MAV_CMD_SET_CAMERA_FOCUS: "focus",
    mavlink.MAV_CMD_IMAGE_START_CAPTURE: "image capture",
    mavlink.MAV_CMD_IMAGE_STOP_CAPTURE: "image capture",
    mavlink.MAV_CMD_VIDEO_START_CAPTURE: "video",
    mavlink.MAV_CMD_VIDEO_STOP_CAPTURE: "video",
}


def flown_items(items: Sequence[MissionItem], autopilot: Autopilot) -> list[int]:
    """Return the seqs of a mission's take-off and waypoints; ArduPilot's home is none of them."""
    found = [item.seq for item in items if item.command in (TAKEOFF, WAYPOINT)]
    return found[1:] if autopilot == "ardupilot" else found


def item_left(path: Path, vehicle: VehiclePlan) -> int:
    """Return the item that a vehicle was flying to when it last was in its mission, by its log or its fleet's.

    Raises
    ------
    MissionError
        The log cannot be read, or the vehicle is never in its mission there.
    """
    kinds = (mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_MISSION_CURRENT)
    auto = MODES[vehicle.autopilot, vehicle.vehicle_class]["auto"]
    in_mission, left = False, None
    for _, message in read_log(path, kinds).records:
        if (message.get_srcSystem(), message.get_srcComponent()) != (vehicle.sysid, 1):
            continue
        if message.get_type() == "HEARTBEAT":
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            in_mission = armed and message.custom_mode == auto
        elif in_mission:
            left = int(message.seq)
    if left is None:
        raise MissionError(
            f"{path}: expected {vehicle.name} (sysid {vehicle.sysid}) in its mission, it never is: give --from"
        )
    return left


def in_force(items: Sequence[MissionItem], at: int) -> tuple[MissionItem, ...]:
    """Return what acts at once of the items before one, as far as it still holds there.

    Raises
    ------
    MissionError
        A jump: which items come before is not known.
    """
    last: dict[tuple[object, ...], MissionItem] = {}
    for item in items:
        if item.command in _JUMPS:
            raise MissionError(f"item {item.seq}: jumps, so what comes before item {at} is not known: write it out")
    for item in items[:at]:
        if item.command == CHANGE_SPEED:
            kind = int(item.param1) if math.isfinite(item.param1) else 0
            key: tuple[object, ...] = ("speed", "level" if kind in (0, 1) else kind)
        elif item.command in _PER_NUMBER:
            key = (item.command, item.param1)
        elif item.command == mavlink.MAV_CMD_IMAGE_START_CAPTURE and item.param3 >= 1.0:
            continue  # so many photos, and no more
        elif item.command in _GROUPS:
            key = (_GROUPS[item.command], item.param1 if item.command in _VIDEO else None)
        else:
            continue
        last.pop(key, None)
        last[key] = item
    return tuple(item for item in last.values() if not _is_nothing(item))


def _is_nothing(item: MissionItem) -> bool:
    """Return whether a vehicle that has just started is so already."""
    off = item.command in _ENDS
    return off or (item.command in _TRIGGERS and item.param1 == 0.0)


def resume_file(
    question: Mission,
    folder: Path,
    path: Path,
    name: str,
    at: int,
    *,
    seed: int | None = None,
    watch: Watch | None = None,
) -> tuple[Scene, Held]:
    """Return a mission file's rest for a vehicle of a mission: from its home to item ``at``, and on; not proven yet.

    Raises
    ------
    MissionError
        The file cannot be read, has no waypoint at that item, jumps, or is not understood before it.
    InfeasibleError
        There is no clear way to the item.
    """
    owner = next((v for v in question.vehicles if v.name == name), None)
    if owner is None:
        known = ", ".join(v.name for v in question.vehicles)
        raise MissionError(f"--vehicle: expected a vehicle of the mission ({known}), got {name!r}")
    number = question.vehicles.index(owner) + 1
    alone = question.model_copy(update={"vehicles": (owner.model_copy(update={"sysid": owner.sysid or number}),)})
    alone = alone.model_copy(update={"fleet": type(question.fleet)(direct_return=question.fleet.direct_return)})
    scene, (held,) = read_files(alone, folder, [path])
    flown = sortie(scene, held)
    legs = [leg for leg in flown.legs[1:] if leg.seq == at]
    if not legs or held.items[at].command != WAYPOINT:
        known = ", ".join(str(leg.seq) for leg in flown.legs[1:] if held.items[leg.seq].command == WAYPOINT)
        raise MissionError(f"{path}: expected a waypoint after the take-off at item {at}, got another: {known} are")
    rest_m = np.array([leg.end_m for leg in flown.legs if leg.seq >= at])
    back = way_to(alone, folder, name, flown.home_m, rest_m, flown.ending, seed=seed, watch=watch)
    *way, _goal, _ending = plan_items(back, scene.frame)  # the goal is the item itself
    whole = [*way, *in_force(held.items, at), *held.items[at:]]
    items = tuple(replace(item, seq=seq, current=int(seq == 0)) for seq, item in enumerate(whole))
    (resumed,) = with_return_heights(scene, [replace(held, items=items, home_m=flown.home_m, path=None, notes=())])
    return scene, resumed


def write_files(scene: Scene, held: Held, folder: Path) -> list[Path]:
    """Write a vehicle's mission as ``.plan`` and ``.waypoints`` and return their paths."""
    flown = sortie(scene, held)
    home = scene.frame.geo_point(flown.home_m)
    texts = {
        f"{held.name}.plan": plan_text(PlanFile(flown.autopilot, home, held.items), flown.vehicle_class),
        f"{held.name}.waypoints": waypoints_text(held.items, flown.autopilot, home),
    }
    for name, text in texts.items():
        write_atomic(folder / name, text)
    return [folder / name for name in texts]
