"""The vehicle's half of the MAVLink services: mission, command, parameter, telemetry. No frames, no sockets.

Only messages for this vehicle (or for everybody) are obeyed, whoever sends them; replies go back on the link that they
came from, telemetry goes to all links.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem, degrees_to_wire
from missionplanner.geodesy import FloatArray, LocalFrame
from sim.autopilot import Autopilot, Completed, Photographed, Said
from sim.file_service import FileService, parameter_file
from sim.mission_service import Link, MissionService, Outgoing
from sim.personality import Behaviour
from sim.telemetry import Motion, Telemetry

COMPONENT_ID = int(mavlink.MAV_COMP_ID_AUTOPILOT1)

_TEXT_MAX = 50
_ALT_MAX_M = 83_000.0
_PARAMETERS_PER_POLL = 25
_PX4_HASH = "_HASH_CHECK"
_NO_INDEX = 65_535
_BOOT_S = 3.0  # deaf and dumb after a reboot
_REACHED_AGAIN = 10  # PX4 tells the item reached last so often again, once a second
_FORCE = 21196  # https://mavlink.io/en/messages/common.html#MAV_CMD_COMPONENT_ARM_DISARM
_IGNORE_POSITION = 0b111  # POSITION_TARGET_TYPEMASK

_ACCEPTED = int(mavlink.MAV_RESULT_ACCEPTED)
_DENIED = int(mavlink.MAV_RESULT_DENIED)
_UNSUPPORTED = int(mavlink.MAV_RESULT_UNSUPPORTED)
_FAILED = int(mavlink.MAV_RESULT_FAILED)

_RELATIVE_FRAMES = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT)
_MISSION_MESSAGES = (
    mavlink.MAVLink_mission_count_message,
    mavlink.MAVLink_mission_write_partial_list_message,
    mavlink.MAVLink_mission_item_int_message,
    mavlink.MAVLink_mission_item_message,
    mavlink.MAVLink_mission_ack_message,
    mavlink.MAVLink_mission_request_list_message,
    mavlink.MAVLink_mission_request_int_message,
    mavlink.MAVLink_mission_request_message,
    mavlink.MAVLink_mission_clear_all_message,
)


@dataclass(frozen=True, slots=True)
class _Command:
    """A COMMAND_LONG or COMMAND_INT; ``x`` and ``y`` are degrees, and zero or NaN where no place is meant."""

    number: int
    params: tuple[float, float, float, float]
    x: float
    y: float
    z: float
    frame: int
    link: Link
    sender: tuple[int, int]


class VehicleLink:
    """One vehicle as ground stations know it.

    Parameters
    ----------
    motion : the vehicle's present position and velocity
    frame : the local frame of the fleet
    battery_life_s : time in the air until the battery is empty
    position_hz : rate of GLOBAL_POSITION_INT
    phase_s : when within a second the slow messages are sent
    """

    def __init__(
        self,
        sysid: int,
        autopilot: Autopilot,
        motion: Callable[[], Motion],
        frame: LocalFrame,
        *,
        position_hz: float = 5.0,
        phase_s: float = 0.0,
        battery_life_s: float = 3_600.0,
        cold_start: bool = False,
    ) -> None:
        self.sysid = sysid
        self.autopilot = autopilot
        self._motion = motion
        self._frame = frame
        self._home_geo_of: tuple[FloatArray, tuple[float, float]] | None = None
        self._texts: list[Said] = []
        self._reached: list[int] = []
        self._reached_again = 0
        self._last_reached = -1
        self._awake_s = -math.inf
        self._parameter_queue: deque[tuple[Link, str]] = deque()
        self._default_parameters = dict(autopilot.parameters)
        self._commands = self._command_table()
        kind = autopilot.personality
        self._files = FileService(self._parameter_file if kind.autopilot == "ardupilot" else None)
        self.missions = MissionService(
            kind,
            home=self._home_item,
            current=lambda: autopilot.current,
            changed=autopilot.set_mission,
            busy=lambda: autopilot.flying_mission and not autopilot.landed and kind.autopilot == "ardupilot",
            say=lambda severity, text: self._texts.append(Said(severity, text)),
            ready_s=kind.storage_ready_s if cold_start else 0.0,
        )
        self.telemetry = Telemetry(
            autopilot,
            sysid,
            motion,
            self._home_geo,
            position_hz=position_hz,
            phase_s=phase_s,
            battery_life_s=battery_life_s,
            plan_ids=lambda: self.missions.plan_ids,
        )
        self.telemetry.changed(0.0)

    @property
    def wake_s(self) -> float:
        """When :meth:`poll` is due even if nothing has happened."""
        if math.isfinite(self._awake_s):
            return self._awake_s
        waiting = self._texts or self._reached or self._parameter_queue or self.autopilot.events
        return -math.inf if waiting else min(self.telemetry.due_s, self.missions.wake_s)

    def receive(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        """Obey one message; return the replies."""
        if now_s < self._awake_s:
            return []
        target = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        if target not in (0, self.sysid) or component not in (0, COMPONENT_ID):
            return []
        if isinstance(message, _MISSION_MESSAGES):
            if getattr(message, "current", 0) == 2 and isinstance(message, mavlink.MAVLink_mission_item_message):
                return self._guided_item(message, link, now_s)
            if isinstance(message, mavlink.MAVLink_mission_count_message):
                self._last_reached = -1
            return self.missions.receive(message, link, now_s)
        handler = self._HANDLERS.get(type(message))
        return [] if handler is None else handler(self, message, link, now_s)

    def poll(self, now_s: float) -> list[Outgoing]:
        """Return what is due: retries of the mission protocol, parameters, texts, telemetry."""
        if now_s < self._awake_s:
            return []
        self._awake_s = -math.inf
        out = self.missions.poll(now_s) if now_s >= self.missions.wake_s else []
        for event in self.autopilot.events:
            match event:
                case Said():
                    self._texts.append(event)
                case Completed(seq):
                    if self.autopilot.personality.one_reached_slot:
                        self._reached.clear()
                    self._reached.append(seq)
                    self._last_reached, self._reached_again = seq, 0
                case Photographed(number):
                    out.append((None, self.telemetry.photo(number, now_s)))
        self.autopilot.events.clear()
        for text in self._texts:
            out.append((None, mavlink.MAVLink_statustext_message(text.severity, text.text[:_TEXT_MAX].encode())))
        self._texts.clear()
        out.extend((None, mavlink.MAVLink_mission_item_reached_message(seq)) for seq in self._reached)
        self._reached.clear()
        for _ in range(min(_PARAMETERS_PER_POLL, len(self._parameter_queue))):
            link, name = self._parameter_queue.popleft()
            out.append((link, self._parameter_value(name)))
        out.extend((None, message) for message in self.telemetry.changed(now_s))
        due = self.telemetry.due(now_s)
        out.extend((None, message) for message in due)
        if self._tells_again(due):
            self._reached_again += 1
            out.append((None, mavlink.MAVLink_mission_item_reached_message(self._last_reached)))
        return out

    def _tells_again(self, due: Sequence[Any]) -> bool:
        """Whether the item reached last is told once more, beside a MISSION_CURRENT as PX4 does."""
        if self.autopilot.personality.one_reached_slot or not 0 <= self._last_reached < len(self.autopilot.mission):
            return False
        return self._reached_again < _REACHED_AGAIN and any(
            isinstance(message, mavlink.MAVLink_mission_current_message) for message in due
        )

    def reboot(self, now_s: float) -> None:
        """Lose what is not stored, and be silent for some seconds."""
        self._awake_s = now_s + _BOOT_S
        self._texts.clear()
        self._reached.clear()
        self._last_reached = -1
        self._parameter_queue.clear()
        self.autopilot.reboot(now_s)
        self.missions.reboot(now_s)
        self.telemetry.reboot(self._awake_s)
        self.telemetry.changed(now_s)

    # -- home --------------------------------------------------------------------------------------------------------

    def _home_geo(self) -> tuple[float, float]:
        home_m = self.autopilot.home_m
        if self._home_geo_of is None or self._home_geo_of[0] is not home_m:
            point = self._frame.geo_point(home_m)
            self._home_geo_of = home_m, (point.lat_deg, point.lon_deg)
        return self._home_geo_of[1]

    def _home_item(self) -> MissionItem:
        lat_deg, lon_deg = self._home_geo()
        home = MissionItem(
            seq=0,
            frame=mavlink.MAV_FRAME_GLOBAL,
            command=mavlink.MAV_CMD_NAV_WAYPOINT,
            x=degrees_to_wire(lat_deg),
            y=degrees_to_wire(lon_deg),
            z=float(self.autopilot.home_m[2]),
        )
        return self.autopilot.personality.stored(home)

    # -- small services ----------------------------------------------------------------------------------------------

    def _set_mode(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        result = self._change_mode(message.custom_mode, now_s)
        number = mavlink.MAVLINK_MSG_ID_SET_MODE
        return [(link, mavlink.MAVLink_command_ack_message(number, result))]

    def _change_mode(self, custom_mode: int, now_s: float) -> int:
        for mode in self.autopilot.personality.modes:
            if mode.custom_mode == custom_mode:
                return self.autopilot.set_mode(mode, now_s)
        return _FAILED

    def _set_current(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        one_transfer = self.autopilot.personality.transfer.one_transfer
        if one_transfer and self.missions.transferring:
            self._texts.append(Said(mavlink.MAV_SEVERITY_CRITICAL, "WPM: IGN WP CURR CMD: Busy"))
            return []
        if not self.autopilot.set_current(message.seq, now_s) and one_transfer:
            self._texts.append(Said(mavlink.MAV_SEVERITY_CRITICAL, "WPM: WP CURR CMD: Not in list"))
            return []
        reply = self.telemetry.build(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, now_s)
        return [(link, reply)]

    def _timesync(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        if message.tc1 != 0:
            return []
        return [(link, mavlink.MAVLink_timesync_message(round(self.telemetry.up_s(now_s) * 1e9), message.ts1))]

    def _ping(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        del now_s
        if message.target_system != 0:
            return []
        sender = message.get_srcSystem(), message.get_srcComponent()
        return [(link, mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender))]

    def _request_data_stream(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        del link
        if self.autopilot.personality.autopilot == "ardupilot":
            self.telemetry.set_stream(message.req_stream_id, message.req_message_rate, message.start_stop == 1, now_s)
        return []

    def _ftp(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        del now_s
        sender = _sender(message)
        replies = self._files.answer(bytes(message.payload), (sender, link))
        return [(link, mavlink.MAVLink_file_transfer_protocol_message(0, *sender, reply)) for reply in replies]

    def _parameter_file(self, with_defaults: bool) -> bytes:
        return parameter_file(self.autopilot.parameters, self._default_parameters if with_defaults else None)

    def _log_request_list(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        del message, now_s
        return [(link, mavlink.MAVLink_log_entry_message(0, 0, 0, 0, 0))]

    def _guided_item(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        """Obey the old way of flying to a point: a MISSION_ITEM with current = 2."""
        place = self._place(message.x, message.y, message.z, message.frame)
        result = _DENIED if place is None else self.autopilot.go_to(place, now_s)
        ack = mavlink.MAV_MISSION_ACCEPTED if result == _ACCEPTED else mavlink.MAV_MISSION_ERROR
        sender = message.get_srcSystem(), message.get_srcComponent()
        return [(link, mavlink.MAVLink_mission_ack_message(*sender, ack))]

    def _position_target(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        del link
        if message.type_mask & _IGNORE_POSITION == 0 and self.autopilot.mode.behaviour is Behaviour.GUIDED:
            place = self._place(message.lat_int * 1e-7, message.lon_int * 1e-7, message.alt, message.coordinate_frame)
            if place is not None:
                self.autopilot.go_to(place, now_s)
        return []

    def _place(self, lat_deg: float, lon_deg: float, alt_m: float, frame: int) -> FloatArray | None:
        """Return a position (3,); 0/0 or NaN is the place it is, NaN the altitude it is at. None: not on this earth."""
        here = self.autopilot.position_m
        x, y = float(here[0]), float(here[1])
        if abs(lat_deg) > 90.0 or abs(lon_deg) > 180.0 or abs(alt_m) > _ALT_MAX_M:
            return None
        if math.isfinite(lat_deg) and math.isfinite(lon_deg) and (lat_deg, lon_deg) != (0.0, 0.0):
            x, y, _ = map(float, self._frame.to_local(lat_deg, lon_deg, 0.0))
        if not (math.isfinite(x) and math.isfinite(y)):  # the other side of the earth has no place in the frame
            return None
        if not math.isfinite(alt_m):
            return np.array([x, y, here[2]])
        datum_m = float(self.autopilot.home_m[2]) if frame in _RELATIVE_FRAMES else 0.0
        return np.array([x, y, datum_m + alt_m])

    # -- parameters --------------------------------------------------------------------------------------------------

    def _parameter_request_list(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        del message, now_s
        self._parameter_queue = deque(entry for entry in self._parameter_queue if entry[0] != link)
        self._parameter_queue.extend((link, name) for name in self.autopilot.parameters)
        return [(link, self._parameter_hash())] if self.autopilot.personality.integers_bytewise else []

    def _parameter_request_read(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        del now_s
        names = list(self.autopilot.parameters)
        index = message.param_index
        name = names[index] if 0 <= index < len(names) else _text(message.param_id)
        if name == _PX4_HASH and self.autopilot.personality.integers_bytewise:
            return [(link, self._parameter_hash())]
        return [(link, self._parameter_value(name))] if name in self.autopilot.parameters else []

    def _parameter_set(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        del link, now_s
        name, parameters = _text(message.param_id), self.autopilot.parameters
        if name not in parameters:
            return []
        value = float(message.param_value)
        if isinstance(parameters[name], int):
            if self.autopilot.personality.integers_bytewise:
                value = struct.unpack("<i", struct.pack("<f", value))[0]
            if math.isfinite(value):
                parameters[name] = round(value)
        elif math.isfinite(value):
            parameters[name] = value
        return [(None, self._parameter_value(name))]  # to everybody, as the specification asks

    def _parameter_hash(self) -> Any:
        """Return the hash by which PX4 lets ground stations know whether they have its parameters already."""
        digest = 0
        for name, value in self.autopilot.parameters.items():
            digest = zlib.crc32(name.encode() + struct.pack("<i" if isinstance(value, int) else "<f", value), digest)
        (value,) = struct.unpack("<f", struct.pack("<I", digest))
        kind, count = mavlink.MAV_PARAM_TYPE_UINT32, len(self.autopilot.parameters)
        return mavlink.MAVLink_param_value_message(_PX4_HASH.encode(), value, kind, count, _NO_INDEX)

    def _parameter_value(self, name: str) -> Any:
        parameters = self.autopilot.parameters
        value = parameters[name]
        index = list(parameters).index(name)
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int):
            kind = mavlink.MAV_PARAM_TYPE_INT32
            if self.autopilot.personality.integers_bytewise:
                value = struct.unpack("<f", struct.pack("<i", value))[0]
        return mavlink.MAVLink_param_value_message(name.encode(), float(value), kind, len(parameters), index)

    # -- commands ----------------------------------------------------------------------------------------------------

    def _command_long(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        params = (message.param1, message.param2, message.param3, message.param4)
        place = (message.param5, message.param6, message.param7)
        # what height a COMMAND_LONG means is the autopilot's habit: ArduPilot above home, PX4 AMSL
        ardupilot = self.autopilot.personality.autopilot == "ardupilot"
        frame = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT if ardupilot else mavlink.MAV_FRAME_GLOBAL
        return self._execute(message, _Command(message.command, params, *place, frame, link, _sender(message)), now_s)

    def _command_int(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        params = (message.param1, message.param2, message.param3, message.param4)
        place = (message.x * 1e-7, message.y * 1e-7, message.z)
        command = _Command(message.command, params, *place, message.frame, link, _sender(message))
        return self._execute(message, command, now_s)

    def _execute(self, message: Any, command: _Command, now_s: float) -> list[Outgoing]:
        handler = self._commands.get(command.number)
        replies: list[Any] = []
        if handler is not None:
            result: int | None = handler(command, now_s, replies)
        else:
            result = self.autopilot.personality.answers.get(command.number, _UNSUPPORTED)
        if result is None:
            return []
        ack = mavlink.MAVLink_command_ack_message(command.number, result, 0, 0, *_sender(message))
        return [(command.link, ack), *((command.link, reply) for reply in replies)]

    def _command_table(self) -> dict[int, Callable[[_Command, float, list[Any]], int]]:
        return {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._do_arm_disarm,
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_MISSION_START: self._do_mission_start,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._do_takeoff,
            mavlink.MAV_CMD_NAV_LAND: lambda _, now_s, __: self._do_behave(Behaviour.LAND, now_s),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _, now_s, __: self._do_behave(Behaviour.RTL, now_s),
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: self._do_loiter,
            mavlink.MAV_CMD_DO_REPOSITION: self._do_reposition,
            mavlink.MAV_CMD_DO_PAUSE_CONTINUE: self._do_pause_continue,
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._do_change_speed,
            mavlink.MAV_CMD_DO_SET_HOME: self._do_set_home,
            mavlink.MAV_CMD_DO_SET_MISSION_CURRENT: self._do_set_mission_current,
            mavlink.MAV_CMD_GET_HOME_POSITION: self._do_get_home_position,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._do_request_message,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._do_set_message_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._do_get_message_interval,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._do_request_capabilities,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._do_reboot,
        }

    def _do_arm_disarm(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del replies
        force = command.params[1] == _FORCE
        if command.params[0] == 1.0:
            return self.autopilot.arm(now_s, force=force)
        if command.params[0] == 0.0:
            return self.autopilot.disarm(now_s, force=force)
        return _UNSUPPORTED

    def _do_set_mode(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del replies
        base, main, sub, _ = command.params
        if not all(map(math.isfinite, (base, main))) or not int(base) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return _UNSUPPORTED
        custom_mode = int(main)
        if self.autopilot.personality.autopilot == "px4":
            custom_mode = int(main) << 16 | (int(sub) if math.isfinite(sub) else 0) << 24
        return self._change_mode(custom_mode, now_s)

    def _do_mission_start(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del replies
        first, last = command.params[:2]
        if not self.autopilot.personality.start_arms:  # ArduPilot begins where it will, and takes no range of items
            return _DENIED if first != 0.0 or last != 0.0 else self.autopilot.start_mission(now_s)
        if not -1.0 <= first < max(len(self.autopilot.mission), 1):
            return _DENIED
        return self.autopilot.start_mission(now_s, int(first) if first >= 0.0 else None)

    def _do_takeoff(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del replies
        alt_amsl_m = None
        if math.isfinite(command.z) and command.z != 0.0:
            top_m = self._place(0.0, 0.0, command.z, command.frame)
            if top_m is None:
                return _DENIED
            alt_amsl_m = float(top_m[2])
        return self.autopilot.takeoff(alt_amsl_m, now_s)

    def _do_behave(self, behaviour: Behaviour, now_s: float) -> int:
        for mode in self.autopilot.personality.modes:
            if mode.behaviour is behaviour:
                return self.autopilot.set_mode(mode, now_s)
        return _UNSUPPORTED  # ArduPlane has no mode that lands

    def _do_loiter(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del command, replies
        return self.autopilot.set_mode(self.autopilot.personality.mode("LOITER"), now_s)

    def _do_reposition(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del replies
        change_mode = math.isfinite(command.params[1]) and int(command.params[1]) & 1
        if not change_mode and self.autopilot.mode.behaviour is not Behaviour.GUIDED:
            return _DENIED
        speed_m_s = command.params[0] if command.params[0] > 0.0 else None
        frame = command.frame if self.autopilot.personality.autopilot == "ardupilot" else mavlink.MAV_FRAME_GLOBAL
        place = self._place(command.x, command.y, command.z, frame)
        return _DENIED if place is None else self.autopilot.go_to(place, now_s, speed_m_s)

    def _do_pause_continue(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del replies
        if self.autopilot.landed:
            return self.autopilot.personality.refusal
        return self.autopilot.pause(now_s) if command.params[0] == 0.0 else self.autopilot.unpause(now_s)

    def _do_change_speed(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del now_s, replies
        kind, speed_m_s = command.params[:2]
        if not all(map(math.isfinite, (kind, speed_m_s))):
            return _FAILED if self.autopilot.personality.autopilot == "ardupilot" else _DENIED
        return self.autopilot.change_speed(kind, speed_m_s)

    def _do_set_home(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del now_s, replies
        if command.params[0] == 1.0:
            return self.autopilot.set_home(self.autopilot.position_m)
        place = self._place(command.x, command.y, command.z, mavlink.MAV_FRAME_GLOBAL)
        return _DENIED if place is None else self.autopilot.set_home(place)

    def _do_set_mission_current(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        seq = command.params[0]
        if not math.isfinite(seq) or not self.autopilot.set_current(int(seq), now_s):
            return _FAILED
        replies.append(self.telemetry.build(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT, now_s))
        return _ACCEPTED

    def _do_get_home_position(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del command
        replies.append(self.telemetry.build(mavlink.MAVLINK_MSG_ID_HOME_POSITION, now_s))
        return _ACCEPTED

    def _do_request_message(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        number = command.params[0]
        message = self.telemetry.build(int(number), now_s) if math.isfinite(number) else None
        if message is None:
            return _FAILED if self.autopilot.personality.autopilot == "ardupilot" else _DENIED
        replies.append(message)
        return _ACCEPTED

    def _do_set_message_interval(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del replies
        number, interval_us = command.params[:2]
        if not math.isfinite(number) or not self.telemetry.set_interval(int(number), interval_us, now_s):
            return _FAILED if self.autopilot.personality.autopilot == "ardupilot" else _DENIED
        return _ACCEPTED

    def _do_get_message_interval(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del now_s
        number = command.params[0]
        interval_us = self.telemetry.interval_us(int(number)) if math.isfinite(number) else None
        if interval_us is None:
            return _FAILED
        replies.append(mavlink.MAVLink_message_interval_message(int(number), interval_us))
        return _ACCEPTED

    def _do_request_capabilities(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del command
        replies.append(self.telemetry.build(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, now_s))
        return _ACCEPTED

    def _do_reboot(self, command: _Command, now_s: float, replies: list[Any]) -> int:
        del replies
        if command.params[0] != 1.0:
            return _UNSUPPORTED
        if self.autopilot.armed:
            return self.autopilot.personality.refusal
        self.reboot(now_s)
        return _ACCEPTED

    _HANDLERS: ClassVar[dict[type, Callable[[VehicleLink, Any, Link, float], list[Outgoing]]]] = {
        mavlink.MAVLink_command_long_message: _command_long,
        mavlink.MAVLink_command_int_message: _command_int,
        mavlink.MAVLink_set_mode_message: _set_mode,
        mavlink.MAVLink_mission_set_current_message: _set_current,
        mavlink.MAVLink_param_request_list_message: _parameter_request_list,
        mavlink.MAVLink_param_request_read_message: _parameter_request_read,
        mavlink.MAVLink_param_set_message: _parameter_set,
        mavlink.MAVLink_timesync_message: _timesync,
        mavlink.MAVLink_ping_message: _ping,
        mavlink.MAVLink_request_data_stream_message: _request_data_stream,
        mavlink.MAVLink_file_transfer_protocol_message: _ftp,
        mavlink.MAVLink_log_request_list_message: _log_request_list,
        mavlink.MAVLink_set_position_target_global_int_message: _position_target,
    }


def _sender(message: Any) -> tuple[int, int]:
    return message.get_srcSystem(), message.get_srcComponent()


def _text(value: str | bytes | Sequence[int]) -> str:
    if isinstance(value, str):
        return value.rstrip("\0")
    return bytes(value).split(b"\0", 1)[0].decode("ascii", "replace")
