"""One simulated vehicle and a ground station beside it, for tests: messages in, messages out, time by hand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import in_process_pair
from adapters.mission_items import MissionItem
from missionplanner.geodesy import GeoPoint
from missionplanner.motion import TICK_S
from missionplanner.vehicle import Autopilot, VehicleClass
from sim.fleet import SimFleet, sim_vehicles

HOME = GeoPoint(34.3, -118.1, 584.0)
LAT, LON = 343_000_000, -1_181_000_000
NAN = float("nan")


def mission(autopilot: Autopilot, ending: int = mavlink.MAV_CMD_NAV_LAND, speed_m_s: float = 8.0) -> list[MissionItem]:
    """Return take-off, speed, two waypoints 60 m apart and an ending."""
    home = [MissionItem(0, 0, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT, y=LON, z=584.0)] if autopilot == "ardupilot" else []
    relative, amsl = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL
    items = [
        *home,
        MissionItem(0, relative, mavlink.MAV_CMD_NAV_TAKEOFF, x=LAT, y=LON, z=20.0),
        MissionItem(0, mavlink.MAV_FRAME_MISSION, mavlink.MAV_CMD_DO_CHANGE_SPEED, 1.0, speed_m_s, -1.0),
        MissionItem(0, amsl, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT + 5_400, y=LON, z=604.0),
        MissionItem(0, amsl, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT + 5_400, y=LON + 6_500, z=604.0),
        MissionItem(0, amsl, ending, x=LAT + 5_400, y=LON + 6_500, z=584.0)
        if ending != mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH
        else MissionItem(0, mavlink.MAV_FRAME_MISSION, ending),
    ]
    return renumbered(items)


def renumbered(items: Sequence[MissionItem]) -> list[MissionItem]:
    """Return items with seqs from 0, the first one current."""
    return [
        MissionItem(
            seq,
            i.frame,
            i.command,
            i.param1,
            i.param2,
            i.param3,
            i.param4,
            i.x,
            i.y,
            i.z,
            int(seq == 0),
            i.autocontinue,
        )
        for seq, i in enumerate(items)
    ]


class Ground:
    """A ground station on an in-process pipe to one simulated vehicle."""

    def __init__(
        self,
        autopilot: Autopilot = "ardupilot",
        vehicle_class: VehicleClass = "copter",
        *,
        sysid: int = 255,
        cold_start: bool = False,
    ) -> None:
        vehicles = sim_vehicles(1, HOME, autopilot=autopilot, vehicle_class=vehicle_class)
        self.fleet = SimFleet(vehicles, cold_start=cold_start)
        self.vehicle = self.fleet.links[0]
        self.autopilot = self.vehicle.autopilot
        theirs, self._pipe = in_process_pair()
        self.fleet.attach(theirs)
        self._encoder = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=190)
        self._parser = mavlink.MAVLink(None)
        self.heard: list[Any] = []

    def send(self, message: Any) -> list[Any]:
        """Send one message and return what is answered at once."""
        self._pipe.send(message.pack(self._encoder))
        self.fleet.poll()
        return self._receive()

    def command(self, number: int, *params: float) -> int:
        """Send a COMMAND_LONG and return the result of its acknowledgement."""
        seven = (*params, *[0.0] * (7 - len(params)))
        replies = self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *seven))
        acks = [m for m in replies if m.get_type() == "COMMAND_ACK" and m.command == number]
        assert len(acks) == 1
        return int(acks[0].result)

    def mode(self, name: str) -> int:
        """Ask for a flight mode by name."""
        custom = self.autopilot.personality.mode(name).custom_mode
        if self.autopilot.personality.autopilot == "px4":
            return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, custom >> 16 & 0xFF, custom >> 24)
        return self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, custom)

    def arm(self) -> int:
        return self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def start(self) -> int:
        return self.command(mavlink.MAV_CMD_MISSION_START)

    def upload(self, items: Sequence[MissionItem], kind: int = 0) -> int:
        """Upload items as the vehicle asks for them and return the type of its MISSION_ACK."""
        replies = self.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), kind))
        for _ in range(2 * len(items) + 2):
            assert len(replies) >= 1, "the vehicle neither asks nor acknowledges"
            last = replies[0]
            if last.get_type() == "MISSION_ACK":
                return int(last.type)
            replies = self.send(item_message(items[last.seq], kind))
        raise AssertionError("the upload does not end")

    def run(self, duration_s: float) -> list[Any]:
        """Let simulated time pass and return what was heard meanwhile."""
        heard: list[Any] = []
        for _ in range(round(duration_s / TICK_S)):
            self.fleet.step()
            heard += self._receive()
        return heard

    def fly_mission(self, limit_s: float = 300.0) -> list[Any]:
        """Let time pass until the vehicle has disarmed itself."""
        heard: list[Any] = []
        while self.autopilot.armed and self.fleet.now_s < limit_s:
            heard += self.run(1.0)
        return heard + self.run(1.0)

    def _receive(self) -> list[Any]:
        messages = [m for data, _ in self._pipe.receive() for m in self._parser.parse_buffer(data) or ()]
        self.heard += messages
        return messages


def item_message(item: MissionItem, kind: int = 0) -> Any:
    """Return an item as MISSION_ITEM_INT for vehicle 1."""
    i = item
    params = (i.param1, i.param2, i.param3, i.param4)
    return mavlink.MAVLink_mission_item_int_message(
        1, 1, i.seq, i.frame, i.command, i.current, i.autocontinue, *params, i.x, i.y, i.z, kind
    )


def of_type(messages: Sequence[Any], name: str) -> list[Any]:
    """Return the messages of one type."""
    return [m for m in messages if m.get_type() == name]


def texts(messages: Sequence[Any]) -> list[str]:
    """Return the STATUSTEXTs."""
    return [m.text for m in of_type(messages, "STATUSTEXT")]
