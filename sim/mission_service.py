"""The vehicle's half of the mission protocol as a state machine: messages and time in, messages out; no sockets.

The rules (https://mavlink.io/en/services/mission.html; what differs between autopilots is ``TransferRules``):

* MISSION_COUNT opens an upload. The vehicle asks for item after item, asks again when none comes, and gives up.
* MISSION_ACK ends an upload: accepted after the last item, or the reason why not. Nobody else may disturb it.
* Missions, fences and rally points are three separate stores.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem, degrees_to_wire
from sim.personality import FENCE_AND_RALLY_COMMANDS, Personality

Link = Hashable
"""Where a message came from, or (None, when sending) everybody."""

Outgoing = tuple[Link | None, Any]
"""A message and the link that it goes to."""

_MISSION, _FENCE, _RALLY = range(3)
_ALL_TYPES = 255
_ACCEPTED = int(mavlink.MAV_MISSION_ACCEPTED)


@dataclass(frozen=True, slots=True)
class Partner:
    """A ground station: its ids and the link it was heard on."""

    system: int
    component: int
    link: Link


@dataclass(slots=True)
class _Upload:
    partner: Partner
    mission_type: int
    next_seq: int
    end_seq: int  # one past the last
    heard_s: float
    asked_s: float
    items: list[MissionItem] = field(default_factory=list)  # atomic uploads wait here

    @property
    def finished(self) -> bool:
        return self.next_seq >= self.end_seq


class MissionService:
    """Stores missions, fences and rally points as one autopilot does.

    Parameters
    ----------
    home : the home item as it reads back, where home is item 0
    current : seq of the item being flown
    changed : called with the mission's items and the seq to go on with (None: as before) whenever they change
    busy : whether the mission is being flown, which forbids clearing it
    say : called with a severity and a text for ground stations
    """

    def __init__(
        self,
        personality: Personality,
        *,
        home: Callable[[], MissionItem],
        current: Callable[[], int],
        changed: Callable[[Sequence[MissionItem], int | None, float], None],
        busy: Callable[[], bool],
        say: Callable[[int, str], None],
        ready_s: float = 0.0,
    ) -> None:
        self._personality = personality
        self._rules = personality.transfer
        self._home = home
        self._current = current
        self._changed = changed
        self._busy = busy
        self._say = say
        self._ready_s = ready_s
        self._stores: dict[int, list[MissionItem]] = {_MISSION: [], _FENCE: [], _RALLY: []}
        self._upload: _Upload | None = None
        self._last_done: _Upload | None = None
        self._int_mode = bool(self._rules.int_requests)
        self._handlers: dict[type, Callable[[Partner, int, Any, float], list[Outgoing]]] = {
            mavlink.MAVLink_mission_count_message: self._open_all,
            mavlink.MAVLink_mission_write_partial_list_message: self._open_partial,
            mavlink.MAVLink_mission_item_int_message: self._take,
            mavlink.MAVLink_mission_item_message: self._take,
            mavlink.MAVLink_mission_ack_message: self._heard_ack,
            mavlink.MAVLink_mission_request_list_message: self._list,
            mavlink.MAVLink_mission_request_int_message: self._send_item,
            mavlink.MAVLink_mission_request_message: self._send_item,
            mavlink.MAVLink_mission_clear_all_message: self._clear,
        }

    @property
    def wake_s(self) -> float:
        """When :meth:`poll` is due."""
        upload = self._upload
        if upload is None:
            return math.inf
        return min(upload.asked_s + self._rules.retry_s, upload.heard_s + self._rules.give_up_s)

    def items(self, mission_type: int = _MISSION) -> tuple[MissionItem, ...]:
        """Return what the vehicle holds, as it would read back."""
        store = self._stores[mission_type]
        return tuple(self._read(mission_type, seq) for seq in range(len(store)))

    def receive(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        """Answer one message of the mission protocol that is meant for this vehicle."""
        partner = Partner(message.get_srcSystem(), message.get_srcComponent(), link)
        kind = getattr(message, "mission_type", _MISSION)
        clear = isinstance(message, mavlink.MAVLink_mission_clear_all_message)
        if kind not in self._stores and not (clear and kind == _ALL_TYPES):
            return [self._ack(partner, mavlink.MAV_MISSION_UNSUPPORTED, kind)]
        handler = self._handlers.get(type(message))
        return [] if handler is None else handler(partner, kind, message, now_s)

    def poll(self, now_s: float) -> list[Outgoing]:
        """Ask again for an item that does not come, and in the end give up."""
        upload = self._upload
        if upload is None:
            return []
        if now_s - upload.heard_s >= self._rules.give_up_s:
            self._upload = None
            self._say(mavlink.MAV_SEVERITY_WARNING, "Mission upload timeout")
            if self._rules.give_up_ack is None:
                return []
            return [self._ack(upload.partner, self._rules.give_up_ack, upload.mission_type)]
        if now_s - upload.asked_s >= self._rules.retry_s:
            return [self._request(upload, now_s)]
        return []

    # -- upload -----------------------------------------------------------------------------------------------------

    def _open_all(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        if self._taken_by_another(partner):
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        if now_s < self._ready_s or message.count > self._rules.item_max:
            return [self._ack(partner, mavlink.MAV_MISSION_NO_SPACE, kind)]
        upload = _Upload(partner, kind, 0, message.count, now_s, now_s)
        if upload.finished:
            self._upload = None
            self._store(kind, [], None, now_s)
            return [self._ack(partner, _ACCEPTED, kind)]
        self._upload = upload
        self._last_done = None
        self._int_mode = bool(self._rules.int_requests)
        if not self._rules.atomic:
            del self._stores[kind][message.count :]
        return [self._request(upload, now_s)]

    def _open_partial(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        count, start, last = len(self._stores[kind]), message.start_index, message.end_index
        if not self._rules.partial_writes:
            return [self._ack(partner, mavlink.MAV_MISSION_UNSUPPORTED, kind)]
        if not 0 <= start <= last <= count:
            return [self._ack(partner, mavlink.MAV_MISSION_ERROR, kind)]
        if self._taken_by_another(partner):
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        self._upload = _Upload(partner, kind, start, last + 1, now_s, now_s)
        return [self._request(self._upload, now_s)]

    def _take(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        upload = self._upload
        if upload is None or upload.mission_type != kind:
            return self._take_stray(partner, kind, message.seq)
        if self._taken_by_another(partner):
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        if isinstance(message, mavlink.MAVLink_mission_item_int_message) and self._rules.int_requests is None:
            self._int_mode = True
        if message.seq != upload.next_seq:
            refusal = self._rules.out_of_sequence_ack
            return [] if refusal is None else [self._ack(partner, refusal, kind)]
        item = _from_message(message)
        result = self._check(kind, item)
        if result != _ACCEPTED:
            self._upload = None
            return [self._ack(partner, result, kind)]
        item = self._personality.stored(item)
        upload.heard_s = now_s
        upload.next_seq += 1
        if self._rules.atomic:
            upload.items.append(item)
        else:
            self._write(kind, item, now_s)
        if not upload.finished:
            return [self._request(upload, now_s)]
        self._upload = None
        self._last_done = upload
        if self._rules.atomic:
            marked = next((i.seq for i in upload.items if i.current == 1), None)
            self._store(kind, upload.items, marked, now_s)
        if self._personality.announces_items:
            what = {_MISSION: "Flight plan", _FENCE: "Fence", _RALLY: "Rally points"}[kind]
            self._say(mavlink.MAV_SEVERITY_INFO, f"{what} received")
        return [self._ack(partner, _ACCEPTED, kind)]

    def _take_stray(self, partner: Partner, kind: int, seq: int) -> list[Outgoing]:
        done = self._last_done
        if self._rules.repeats_last_ack and done is not None and done.partner == partner and seq == done.end_seq - 1:
            return [self._ack(partner, _ACCEPTED, kind)]  # our acknowledgement was lost
        refusal = self._rules.stray_item_ack
        return [] if refusal is None else [self._ack(partner, refusal, kind)]

    def _write(self, kind: int, item: MissionItem, now_s: float) -> None:
        store = self._stores[kind]
        if item.seq < len(store):
            store[item.seq] = item
        else:
            store.append(item)
        if kind == _MISSION:
            self._changed(tuple(store), None, now_s)

    def _store(self, kind: int, items: list[MissionItem], current: int | None, now_s: float) -> None:
        self._stores[kind] = items
        if kind == _MISSION:
            self._changed(tuple(items), current, now_s)

    def _heard_ack(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        """During an upload, PX4 takes an acknowledgement as "cancel" or as "ask in the other way"."""
        upload = self._upload
        if upload is None or upload.mission_type != kind or self._taken_by_another(partner) or not self._rules.atomic:
            return []
        if message.type == mavlink.MAV_MISSION_OPERATION_CANCELLED:
            self._upload = None
        elif message.type == mavlink.MAV_MISSION_UNSUPPORTED:
            self._int_mode = not self._int_mode
            return [self._request(upload, now_s)]
        return []

    def _taken_by_another(self, partner: Partner) -> bool:
        upload = self._upload
        return upload is not None and (upload.partner.system, upload.partner.component) != (
            partner.system,
            partner.component,
        )

    def _check(self, kind: int, item: MissionItem) -> int:
        commands = FENCE_AND_RALLY_COMMANDS.get(kind, self._rules.commands)
        if item.command not in commands:
            return int(mavlink.MAV_MISSION_UNSUPPORTED)
        if item.frame not in self._rules.frames:
            return int(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
        return self._personality.check(item)

    def _request(self, upload: _Upload, now_s: float) -> Outgoing:
        upload.asked_s = now_s
        kind = (
            mavlink.MAVLink_mission_request_int_message if self._int_mode else mavlink.MAVLink_mission_request_message
        )
        partner = upload.partner
        return partner.link, kind(partner.system, partner.component, upload.next_seq, upload.mission_type)

    # -- download and clearing --------------------------------------------------------------------------------------

    def _list(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        del message, now_s
        if self._upload is not None:
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        count = len(self._stores[kind])
        return [(partner.link, mavlink.MAVLink_mission_count_message(partner.system, partner.component, count, kind))]

    def _send_item(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        del now_s
        seq = message.seq
        integers = isinstance(message, mavlink.MAVLink_mission_request_int_message)
        readable_home = kind == _MISSION and seq == 0 and self._rules.home_is_item_0
        if not readable_home and seq >= len(self._stores[kind]):
            return [self._ack(partner, mavlink.MAV_MISSION_INVALID_SEQUENCE, kind)]
        item = self._read(kind, seq)
        x, y = (item.x, item.y) if integers else (item.x * 1e-7, item.y * 1e-7)
        reply = mavlink.MAVLink_mission_item_int_message if integers else mavlink.MAVLink_mission_item_message
        fields = (item.frame, item.command, item.current, item.autocontinue)
        params = (item.param1, item.param2, item.param3, item.param4)
        return [(partner.link, reply(partner.system, partner.component, seq, *fields, *params, x, y, item.z, kind))]

    def _read(self, kind: int, seq: int) -> MissionItem:
        is_home = kind == _MISSION and seq == 0 and self._rules.home_is_item_0
        item = self._home() if is_home else self._stores[kind][seq]
        return replace(item, seq=seq, current=int(kind == _MISSION and seq == self._current()))

    def _clear(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        del message
        if self._taken_by_another(partner):
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        kinds = list(self._stores) if kind == _ALL_TYPES else [kind]
        if _MISSION in kinds and self._busy():
            return [self._ack(partner, mavlink.MAV_MISSION_ERROR, kind)]
        self._upload = None
        for each in kinds:
            self._store(each, [], None, now_s)
        return [self._ack(partner, _ACCEPTED, kind)]

    def _ack(self, partner: Partner, result: int, kind: int) -> Outgoing:
        return partner.link, mavlink.MAVLink_mission_ack_message(partner.system, partner.component, int(result), kind)


def _from_message(message: Any) -> MissionItem:
    """Return the item of a MISSION_ITEM_INT, or of a MISSION_ITEM with its degrees as float32."""
    x, y = message.x, message.y
    if isinstance(message, mavlink.MAVLink_mission_item_message):
        # a place beyond what the integers can hold is wrong anyway, and is refused as such
        x, y = (degrees_to_wire(v) if math.isfinite(v) and abs(v) < 200.0 else 2_000_000_000 for v in (x, y))
    return MissionItem(
        seq=message.seq,
        frame=message.frame,
        command=message.command,
        param1=message.param1,
        param2=message.param2,
        param3=message.param3,
        param4=message.param4,
        x=x,
        y=y,
        z=message.z,
        current=message.current,
        autocontinue=message.autocontinue,
    )
