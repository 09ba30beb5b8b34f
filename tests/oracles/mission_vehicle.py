"""The vehicle's half of the mission protocol, as short as it can be: what the uploader is tested against.

It follows the measurements of real autopilots (ArduPilot: hybrid uploads, MISSION_REQUEST each second, home in seq 0;
PX4: atomic uploads, MISSION_REQUEST_INT each 250 ms), and shares no code with the uploader.
"""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from missionplanner.vehicle import Autopilot

Stored = tuple[Any, ...]  # frame, command, p1, p2, p3, p4, x, y, z


class MissionVehicle:
    """Messages and time in, messages out."""

    def __init__(self, autopilot: Autopilot, home: Stored, busy_until_s: float = 0.0) -> None:
        self.ardupilot = autopilot == "ardupilot"
        self.home = home
        self.busy_until_s = busy_until_s
        self.mission: list[Stored] = []
        self.receiving = False
        self._draft: list[Stored] = []
        self._count = 0
        self._peer = (0, 0)
        self._asked_s = 0.0
        self._heard_s = 0.0

    def held(self) -> list[Stored]:
        """Return what a read-back gives."""
        return [self.home, *self.mission[1:]] if self.ardupilot and self.mission else list(self.mission)

    def tick(self, now_s: float) -> list[Any]:
        if not self.receiving:
            return []
        if now_s - self._heard_s > (8.0 if self.ardupilot else 5.0):
            self.receiving = False
            if self.ardupilot:
                return [self._ack(mavlink.MAV_MISSION_OPERATION_CANCELLED)]
            return []
        if now_s - self._asked_s > (1.0 if self.ardupilot else 0.25):
            return [self._ask(now_s)]
        return []

    def receive(self, message: Any, now_s: float) -> list[Any]:
        peer = (message.get_srcSystem(), message.get_srcComponent())
        match message.get_type():
            case "MISSION_COUNT" if now_s < self.busy_until_s:
                self._peer = peer
                return [self._ack(mavlink.MAV_MISSION_NO_SPACE)]
            case "MISSION_COUNT":
                self._peer = peer
                self._count = message.count
                self._draft = []
                self.receiving = True
                self._heard_s = now_s
                if self.ardupilot:
                    del self.mission[self._count :]
                return [self._ask(now_s)]
            case "MISSION_ITEM_INT":
                return self._item(message, now_s)
            case "MISSION_REQUEST_LIST" if self.receiving:
                return [self._ack(mavlink.MAV_MISSION_DENIED if self.ardupilot else mavlink.MAV_MISSION_ERROR)]
            case "MISSION_REQUEST_LIST":
                self._peer = peer
                return [mavlink.MAVLink_mission_count_message(*peer, len(self.held()))]
            case "MISSION_REQUEST_INT" if message.seq < len(self.held()):
                frame, command, *rest = self.held()[message.seq]
                return [mavlink.MAVLink_mission_item_int_message(*peer, message.seq, frame, command, 0, 1, *rest)]
        return []

    def _item(self, m: Any, now_s: float) -> list[Any]:
        if not self.receiving:
            if self.ardupilot:
                return [self._ack(mavlink.MAV_MISSION_ERROR)]
            return [self._ack(mavlink.MAV_MISSION_ACCEPTED)] if m.seq == self._count - 1 else []
        if m.seq != len(self._draft):
            return [self._ack(mavlink.MAV_MISSION_INVALID_SEQUENCE)] if self.ardupilot else []
        self._heard_s = now_s
        stored = (m.frame, m.command, m.param1, m.param2, m.param3, m.param4, m.x, m.y, m.z)
        self._draft.append(stored)
        if self.ardupilot:
            self.mission[m.seq : m.seq + 1] = [stored]
        if len(self._draft) < self._count:
            return [self._ask(now_s)]
        self.receiving = False
        self.mission = list(self._draft)
        return [self._ack(mavlink.MAV_MISSION_ACCEPTED)]

    def _ask(self, now_s: float) -> Any:
        self._asked_s = now_s
        kind = (
            mavlink.MAVLink_mission_request_message if self.ardupilot else mavlink.MAVLink_mission_request_int_message
        )
        return kind(*self._peer, len(self._draft))

    def _ack(self, result: int) -> Any:
        return mavlink.MAVLink_mission_ack_message(*self._peer, result)
