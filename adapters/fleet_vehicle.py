"""One vehicle of a fleet plan on its link: what is heard of it, how its flight goes, how it is told to switch modes."""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.flight_recorder import FlightRecorder, landing_amsl_m, status_text
from adapters.ground_station import Peer
from adapters.guards import guard
from adapters.mission_items import CHANGE_SPEED, TAKEOFF, WAYPOINT, MissionItem, goal_seq, plan_items
from adapters.mission_protocol import Party
from missionplanner.errors import LinkError
from missionplanner.geodesy import FloatArray
from missionplanner.pacing import Pace, Sighting
from missionplanner.plan import FleetPlan, FlownVehicle, VehiclePlan
from missionplanner.vehicle import Autopilot, VehicleClass

Message = Any  # a pymavlink message: its classes are generated, and carry no types
Mode = Literal["auto", "hold", "land", "rtl"]
Order = Literal["pause", "resume", "rtl", "land"]
"""What an operator tells flying vehicles: to stop, to go on with their missions, to return, to land where they are."""


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """One vehicle while the fleet is being watched."""

    name: str
    sysid: int
    t_s: float | None  # since the common start, of the last position
    item: int | None  # flown to at present
    items: int
    position_m: FloatArray | None  # (3,)
    armed: bool
    arrived: bool
    landed: bool
    silent_s: float  # since anything was heard
    text: str  # what the vehicle said last
    pace: Pace | None = None  # how it is doing against the plan, where that is watched
    doing: str = ""  # in a word, as it says itself


_TEXT_FOR_S = 30.0  # a vehicle repeats what keeps it from arming
_COMPLAINT = re.compile(r"PreArm|Arm:|Preflight", re.IGNORECASE)
_COMPLAINTS_KEPT = 5
UNHEARD_S = 5.0  # a heartbeat comes every second
LOST_S = 60.0
STANDS_M_S = 0.5
NOT_KNOWN = "what it does is not known, its own failsafe may bring it home"
_NEWS_KEPT = 20
_RETURNED_M = 90.0  # beyond its circle, within which a plane has come home

_PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_POSITION_SENSORS = {
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO: "gyroscope",
    mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL: "accelerometer",
    mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG: "compass",
    mavlink.MAV_SYS_STATUS_SENSOR_GPS: "GPS",
}
_ESTIMATES = {
    mavlink.ESTIMATOR_ATTITUDE: "attitude",
    mavlink.ESTIMATOR_VELOCITY_HORIZ: "velocity",
    mavlink.ESTIMATOR_POS_HORIZ_ABS: "position",
}
# HEARTBEAT.custom_mode by what we want; "hold" is also the mode to be armed in, in which a copter stays on the ground.
# ArduPlane has no mode that lands where it is: it returns. PX4 packs main and sub mode.
MODES: dict[tuple[Autopilot, VehicleClass], dict[Mode, int]] = {
    ("ardupilot", "copter"): {"hold": 4, "auto": 3, "land": 9, "rtl": 6},
    ("ardupilot", "plane"): {"hold": 12, "auto": 10, "land": 11, "rtl": 11},
    **{
        ("px4", kind): {
            "hold": 4 << 16 | 3 << 24,
            "auto": 4 << 16 | 4 << 24,
            "land": 4 << 16 | 6 << 24,
            "rtl": 4 << 16 | 5 << 24,
        }
        for kind in ("copter", "plane")
    },
}
# ArduPlane is armed in FBWA, which waits for the sticks: good on the ground, never to be ordered in the air
ARMING_MODES: dict[tuple[Autopilot, VehicleClass], int] = {("ardupilot", "plane"): 5}


class FleetVehicle(Peer):
    """What is known of one vehicle, and what goes on with it."""

    def __init__(self, plan: VehiclePlan, fleet: FleetPlan) -> None:
        super().__init__(Party(plan.name, plan.sysid))
        self.plan = plan
        self.items = plan_items(plan, fleet.frame)
        self.modes = MODES[plan.autopilot, plan.vehicle_class]
        self.recorder = FlightRecorder(
            goal_seq(self.items),
            plan.waypoints_m[-1],
            plan.motion.waypoint_radius_m + 1.0,
            fleet.frame,
            landing_amsl_m(plan),
        )
        self._uid = next((asked.uid for asked in fleet.mission.vehicles if asked.name == plan.name), None)
        self.guard = guard(fleet, plan)
        self._due_after_s = fleet.mission.fleet.arrives_after_s(plan.name)
        self.asked_to_arm = False  # and neither seen to start nor disarmed since
        self.started = False  # seen to fly its mission
        self.held: tuple[MissionItem, ...] | None = None
        self.current_item: int | None = None
        self._status: Message | None = None
        self._ekf_flags: int | None = None
        self._text = ""
        self._text_s = -math.inf
        self._complaints: dict[str, float] = {}  # what keeps it from arming, in its own words, and when it said so last
        self._heard_s = -math.inf
        self._item_s = self._position_s = -math.inf
        self._velocity_m_s = np.zeros(3)
        self.paused = False  # stands in its mission, by its own word
        self.order: Order | None = None  # obeyed last
        self.left_item: int | None = None  # flown to when it was told to leave its mission
        self.warned_m: FloatArray | None = None  # where it was said that its way back to its mission is not proven
        self.strayed = False  # left its mission, or what it was told, not by our order
        self._news: deque[str] = deque(maxlen=_NEWS_KEPT)
        self._flown_to = [item.seq for item in self.items if item.command in (TAKEOFF, WAYPOINT)]
        if plan.autopilot == "ardupilot":
            del self._flown_to[0]  # home

    @property
    def custom_mode(self) -> int | None:
        """Its mode, as its last heartbeat numbers it."""
        return None if self.heartbeat is None else int(self.heartbeat.custom_mode)

    @property
    def ended(self) -> bool:
        """Whether it has done all that its plan asks."""
        if self.recorder.rebooted:
            return False
        if self.recorder.landed:
            return True
        if (self.order == "pause" and self.follows("pause")) or not (self.recorder.reached_goal or self._returns):
            return False
        if self.plan.end == "loiter" and not self._returns:
            return True
        # a plane that has returned circles above home until somebody lands it
        position_m = self.recorder.position_m
        return (
            self.plan.vehicle_class == "plane"
            and (self.plan.end == "rtl" or self._returns)
            and position_m is not None
            and float(np.hypot(*(position_m - self.plan.home_m)[:2])) <= self.plan.motion.loiter_radius_m + _RETURNED_M
        )

    @property
    def speed_m_s(self) -> float:
        """How fast it last said to be."""
        return float(np.linalg.norm(self._velocity_m_s))

    @property
    def where(self) -> str:
        """Where in its mission it is, for a sentence."""
        item = self.current_item if self.left_item is None else self.left_item
        return "before its first item" if item is None else f"at item {item} of {len(self.items) - 1}"

    @property
    def _returns(self) -> bool:
        """Whether it obeys an order to return."""
        return self.order in ("rtl", "land") and self.in_mode("rtl")

    def follows(self, order: Order) -> bool:
        """Return whether what it says of itself agrees with an order."""
        if order == "pause":
            return self.in_mode("hold") or (self.in_mode("auto") and self._stands)
        return self.in_mode("auto") and not self.paused if order == "resume" else self.in_mode(order)

    @property
    def _stands(self) -> bool:
        """Whether it stands in its mission; not all firmware says so."""
        return self.paused or (self.order == "pause" and self.speed_m_s <= STANDS_M_S)

    @property
    def mode_name(self) -> str:
        """The name of its mode in its own autopilot's words."""
        return "unknown" if self.heartbeat is None else str(mavutil.mode_string_v10(self.heartbeat))

    @property
    def doing(self) -> str:
        """What it does, in a word."""
        if not self.armed:
            fallen = self.recorder.disarmed_up_m is not None
            return "landed" if self.recorder.landed else "fallen" if fallen else "waits"
        if self.in_mode("auto"):
            return "paused" if self._stands else "flying"
        if self.in_mode("hold"):
            return "paused" if self.order == "pause" else "holds"
        return "returns" if self.in_mode("rtl") else "lands" if self.in_mode("land") else self.mode_name

    @property
    def state(self) -> str:
        """What it does, by its own word, as the end of a sentence that begins with its name."""
        if self.recorder.rebooted:
            armed = "armed" if self.armed else "disarmed"
            return f"has restarted its autopilot in flight, {self.where}, and is {armed}: what it does is not known"
        if not self.armed:
            up_m = self.recorder.disarmed_up_m
            if up_m is not None:
                return f"is disarmed in the air, {up_m:.0f} m above home"
            return "has landed" if self.recorder.landed else "is disarmed on the ground"
        if self.asked_to_arm:
            return "is armed, and was not seen to start"
        if self.ended and (self.in_mode("auto") or self.in_mode("hold")):
            return "is where its mission ends"
        if self.in_mode("auto"):
            return f"{'stands on its way' if self._stands else 'flies on with its mission'}, {self.where}"
        if self.in_mode("rtl"):  # of a plane its landing, too
            return "returns home"
        if self.in_mode("land"):
            return "lands where it is"
        held = "holds" if self.in_mode("hold") else f"is in mode {self.mode_name}, not in its mission"
        return f"{held}, {self.where}"

    def take_news(self) -> list[str]:
        """Return what it has said since the last call that is at least a warning, each once in a while."""
        news = list(self._news)
        self._news.clear()
        return news

    def in_mode(self, mode: Mode) -> bool:
        """Return whether its last heartbeat says so."""
        return self.custom_mode == self.modes[mode]

    def receive(self, message: Message, now_s: float) -> list[Message]:
        """Take one message of this vehicle and return what to answer."""
        self._heard_s = now_s
        match message.get_type():
            case "SYS_STATUS":
                self._status = message
            case "EKF_STATUS_REPORT":
                self._ekf_flags = message.flags
            case "MISSION_CURRENT":
                self.current_item = message.seq
                self._item_s = now_s
                self.paused = message.mission_state == mavlink.MISSION_STATE_PAUSED
            case "GLOBAL_POSITION_INT":
                self._position_s = now_s
                self._velocity_m_s = np.array([message.vy, message.vx, -message.vz]) / 100.0  # north, east, down
            case "STATUSTEXT":
                self._text, self._text_s = status_text(message), now_s
                told_s = self._complaints.get(self._text, -math.inf)
                if message.severity <= mavlink.MAV_SEVERITY_WARNING and now_s - told_s > _TEXT_FOR_S:
                    self._news.append("".join(c if c.isprintable() else " " for c in self._text))
                if message.severity <= mavlink.MAV_SEVERITY_WARNING or _COMPLAINT.match(self._text):
                    self._complaints[self._text] = now_s
                    while len(self._complaints) > _COMPLAINTS_KEPT:
                        del self._complaints[min(self._complaints, key=self._complaints.__getitem__)]
        self.recorder.receive(message, now_s)
        return super().receive(message, now_s)

    def check_identity(self) -> None:
        """Refuse a vehicle of another kind than planned, two behind one sysid, and any other than the mission's own."""
        kind = (self.plan.autopilot, self.plan.vehicle_class)
        self.expect_kind(kind, "the wrong vehicle, or correct the mission file and plan again")
        self.check_alone()
        if self._uid is not None:
            self.expect_uid((self._uid,), "the wrong vehicle, or correct the mission file's uid")

    def lacks(self, now_s: float) -> tuple[str, ...]:
        """Return what is missing until it can be armed, nothing if it is ready; with its own words in the end."""
        if self.silent_s(now_s) > UNHEARD_S:
            return (f"not heard for {self.silent_s(now_s):.0f} s",)
        status = self._status
        if status is None:
            return ("no SYS_STATUS",)
        present, health = status.onboard_control_sensors_present, status.onboard_control_sensors_health
        if self.recorder.position_m is None or not np.isfinite(self.recorder.position_m).all():
            return ("no position",)
        missing = [
            f"{name} not healthy" for bit, name in _POSITION_SENSORS.items() if present & bit and not health & bit
        ]
        flags = self._ekf_flags
        estimates = [name for bit, name in _ESTIMATES.items() if flags is not None and not flags & bit]
        if estimates:
            missing.append(f"its estimate of {', '.join(estimates)} is not healthy")
        if present & _PREARM and not health & _PREARM:
            missing.append("pre-arm checks fail")
        if missing:
            fresh = [text for text, text_s in self._complaints.items() if now_s - text_s <= _TEXT_FOR_S]
            missing += [f'"{text}"' for text in fresh]
        return tuple(missing)

    def said(self, now_s: float) -> str:
        """Return the vehicle's own last words in brackets, if they are fresh."""
        return f' ("{self._text}")' if self._text and now_s - self._text_s <= _TEXT_FOR_S else ""

    def silent_s(self, now_s: float) -> float:
        """Return how long ago it was heard last."""
        return now_s - self._heard_s

    def lost(self, now_s: float) -> bool:
        """Return whether nothing more is to be expected of it."""
        return self.silent_s(now_s) > LOST_S or self.recorder.rebooted or self.recorder.fell(now_s)

    def failure(self, now_s: float) -> LinkError:
        """Return what to say of a vehicle that has not ended its mission."""
        where = f"at item {self.recorder.item}" if self.recorder.item is not None else "before its first item"
        if self.recorder.rebooted:
            return self.error(f"its autopilot restarted in flight, {where}")
        if self.recorder.fell(now_s):
            return self.error(f"disarmed in the air, {self.recorder.disarmed_up_m:.0f} m above home, {where}")
        if self.lost(now_s):
            return self.error(
                f"not heard for {self.silent_s(now_s):.0f} s, {where}; {NOT_KNOWN}: watch for it at its goal and home"
            )
        return self.error(f"still flying long after its planned end, {where}: take over, or watch again")

    def sighting(self, now_s: float) -> Sighting | None:
        """Return where it is on its mission; None before that is known."""
        t_s, position_m, item = self.recorder.t_s, self.recorder.position_m, self.recorder.item
        if t_s is None or position_m is None or item is None:
            return None
        waypoint = len(self._flown_to) if self.recorder.reached_goal else bisect_left(self._flown_to, item)
        return Sighting(
            t_s=t_s,
            position_m=position_m,
            velocity_m_s=self._velocity_m_s,
            waypoint=waypoint,
            in_mission=self.armed and self.in_mode("auto"),
            paused=self.paused,
            age_s=now_s - min(self._item_s, self._position_s),
            arrival_s=self.recorder.arrival_s if self.recorder.reached_goal else None,
        )

    def status(self, now_s: float, pace: Pace | None = None) -> VehicleStatus:
        """Return how it is, for whoever watches."""
        return VehicleStatus(
            name=self.plan.name,
            sysid=self.plan.sysid,
            t_s=self.recorder.t_s,
            item=self.recorder.item,
            items=len(self.items),
            position_m=self.recorder.position_m,
            armed=self.armed,
            arrived=self.recorder.reached_goal,
            landed=self.recorder.landed,
            silent_s=self.silent_s(now_s),
            text=self._text,
            pace=pace,
            doing=self.doing,
        )

    @property
    def speed_item(self) -> MissionItem | None:
        """The item of its mission that has set the speed at which it flies to the present one; None: none has."""
        at = self.current_item if self.left_item is None else self.left_item
        before = self.items[:at] if at is not None else ()
        return next((item for item in reversed(before) if item.command == CHANGE_SPEED), None)

    def off_way_m(self) -> float:
        """Return how far it is from the leg to the item that it was flying to; 0 where its way home begins anywhere."""
        position_m = self.recorder.position_m
        item = self.current_item if self.left_item is None else self.left_item
        if position_m is None or item is None:
            return math.inf
        k = bisect_left(self._flown_to, item)
        ways_m = np.vstack([self.plan.home_m, self.plan.waypoints_m])
        if k == len(self._flown_to):
            if self.plan.end == "rtl":
                return 0.0
            ground_m = np.array([*ways_m[-1, :2], self.plan.trajectory.position_m[-1, 2]])
            ways_m = np.vstack([ways_m, ground_m if self.plan.end == "land" else ways_m[-1]])
        from_m, leg_m = ways_m[k], ways_m[k + 1] - ways_m[k]
        share = np.clip(np.dot(position_m - from_m, leg_m) / max(float(np.dot(leg_m, leg_m)), 1e-9), 0.0, 1.0)
        return float(np.linalg.norm(position_m - from_m - share * leg_m))

    def reached_s(self, waypoint: int) -> float | None:
        """Return when a waypoint of its plan was reached, since the common start."""
        place_m, reach_m = self.plan.waypoints_m[waypoint], self.plan.motion.waypoint_radius_m + 1.0
        return self.recorder.reached_s(self._flown_to[waypoint], place_m, reach_m)

    def flown(self) -> FlownVehicle:
        """Return its flight as recorded."""
        recorder = self.recorder
        return FlownVehicle(
            self.plan.name,
            self.plan.sysid,
            recorder.trajectory(),
            recorder.arrival_s,
            recorder.landed_s,
            self._due_after_s,
        )
