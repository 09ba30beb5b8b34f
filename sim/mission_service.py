"""The vehicle's half of the mission protocol as a state machine: messages and time in, messages out; no sockets.

The rules (https://mavlink.io/en/services/mission.html; what differs between autopilots is ``TransferRules``):

* MISSION_COUNT opens an upload. The vehicle asks for item after item, asks again when none comes, and gives up.
* MISSION_ACK ends an upload: accepted after the last item, or the reason why not. Nobody else may disturb it.
* Missions, fences and rally points are three separate stores.
* ArduPilot answers every request for an item, and takes an upload to each store at a time. PX4 has one transfer at a
  time, up or down: MISSION_REQUEST_LIST opens a download, whose items may be asked for in order only.
"""

from __future__ import annotations

import math
import struct
import zlib
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
_MOVED_AFTER_S = 2.0
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
    rest: list[MissionItem] = field(default_factory=list)  # kept behind them
    plan_id: int = 0

    @property
    def finished(self) -> bool:
        return self.next_seq >= self.end_seq


@dataclass(slots=True)
class _Download:
    """Of an autopilot that gives its items in order only."""

    partner: Partner
    mission_type: int
    count: int
    heard_s: float
    next_seq: int = 0


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
        self._uploads: dict[int, _Upload] = {}  # by mission type
        self._download: _Download | None = None
        self._last_done: _Upload | None = None
        self._plan_ids = {_MISSION: 0, _FENCE: 0, _RALLY: 0}
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
        due_s = math.inf if self._download is None else self._download.heard_s + self._rules.give_up_s
        for upload in self._uploads.values():
            due_s = min(due_s, upload.asked_s + self._rules.retry_s, upload.heard_s + self._rules.give_up_s)
        return due_s

    @property
    def transferring(self) -> bool:
        """Whether a transfer is under way."""
        return bool(self._uploads) or self._download is not None

    @property
    def plan_ids(self) -> tuple[int, int, int]:
        """The opaque_id of mission, fence and rally points; 0 where the autopilot has none."""
        return self._plan_ids[_MISSION], self._plan_ids[_FENCE], self._plan_ids[_RALLY]

    def reboot(self, now_s: float) -> None:
        """Forget every transfer; what is stored stays as it is."""
        self._uploads.clear()
        self._download = self._last_done = None
        self._int_mode = bool(self._rules.int_requests)
        self._ready_s = now_s + self._personality.storage_ready_s

    def items(self, mission_type: int = _MISSION) -> tuple[MissionItem, ...]:
        """Return what the vehicle holds, as it reads back in MISSION_ITEM_INTs."""
        read = (self._read(mission_type, seq) for seq in range(len(self._stores[mission_type])))
        return tuple(replace(item, frame=self._personality.frame_read(item.frame)) for item in read)

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
        out: list[Outgoing] = []
        for kind, upload in list(self._uploads.items()):
            if now_s - upload.heard_s >= self._rules.give_up_s:
                del self._uploads[kind]
                self._say(mavlink.MAV_SEVERITY_WARNING, self._rules.timeout_texts[kind])
                if self._rules.give_up_ack is not None:
                    out.append(self._ack(upload.partner, self._rules.give_up_ack, kind))
            elif now_s - upload.asked_s >= self._rules.retry_s:
                out.append(self._request(upload, now_s))
        download = self._download
        if download is not None and now_s - download.heard_s >= self._rules.give_up_s:
            self._download = None
            self._say(mavlink.MAV_SEVERITY_CRITICAL, self._rules.timeout_texts[download.mission_type])
        return out

    # -- upload -----------------------------------------------------------------------------------------------------

    def _open_all(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        if self._rules.one_transfer and self.transferring:
            return self._open_while_busy(partner, kind, now_s)
        if self._taken_by_another(partner, kind, now_s):
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        most = self._rules.item_max[kind]
        if now_s < self._ready_s or message.count > most:
            if message.count > most and not self._rules.atomic:
                self._say(mavlink.MAV_SEVERITY_WARNING, f"Only {most} items are supported")
            return [self._ack(partner, mavlink.MAV_MISSION_NO_SPACE, kind)]
        upload = _Upload(partner, kind, 0, message.count, now_s, now_s)
        if upload.finished:
            self._uploads.pop(kind, None)
            self._store(kind, [], None, now_s)
            return [self._ack(partner, _ACCEPTED, kind)]
        self._uploads[kind] = upload
        self._last_done = None
        if not self._waits(kind):
            del self._stores[kind][message.count :]
        return [self._request(upload, now_s)]

    def _open_while_busy(self, partner: Partner, kind: int, now_s: float) -> list[Outgoing]:
        upload = next(iter(self._uploads.values()), None)
        if upload is not None and self._same(upload, partner, now_s):
            upload.heard_s = now_s
            if upload.next_seq == 0:  # our first request was lost
                return [self._request(upload, now_s)]
            self._say(mavlink.MAV_SEVERITY_CRITICAL, "WPM: REJ. CMD: Busy")
        return [self._ack(partner, self._rules.second_uploader_ack, kind)]

    def _open_partial(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        count, start, last = len(self._stores[kind]), message.start_index, message.end_index
        if not self._rules.partial_writes:
            return []  # PX4 does not know the message
        if not 0 <= start <= last <= count:
            return [self._ack(partner, mavlink.MAV_MISSION_ERROR, kind)]
        upload = _Upload(partner, kind, start, last + 1, now_s, now_s)
        if self._waits(kind):
            upload.items, upload.rest = self._stores[kind][:start], self._stores[kind][last + 1 :]
        self._uploads[kind] = upload
        return [self._request(upload, now_s)]

    def _waits(self, kind: int) -> bool:
        """Whether an upload changes the store only once it is complete; of ArduPilot's, only a fence does."""
        return self._rules.atomic or kind == _FENCE

    def _take(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        integers = isinstance(message, mavlink.MAVLink_mission_item_int_message)
        upload = self._uploads.get(kind)
        if self._rules.one_transfer:
            upload = next(iter(self._uploads.values()), None)
            expected = upload or self._download or self._last_done
            if expected is not None and not self._same(expected, partner, now_s):
                self._say(mavlink.MAV_SEVERITY_CRITICAL, "REJ. MIS ITEM: partner id mismatch")
                return []
            if upload is not None and upload.mission_type != kind:
                return [self._ack(partner, mavlink.MAV_MISSION_ERROR, kind)]
            self._int_mode = integers
        if upload is None:
            return self._take_stray(partner, kind, message.seq)
        same = self._same(upload, partner, now_s)
        upload.heard_s = now_s if self._rules.one_transfer and same else upload.heard_s
        if message.seq != upload.next_seq:
            refusal = self._rules.out_of_sequence_ack
            return [] if refusal is None else [self._ack(partner, refusal, kind)]
        if not same:
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        item = _from_message(message)
        result = self._check(kind, item, upload)
        if result != _ACCEPTED:
            del self._uploads[kind]
            return [self._ack(partner, result, kind)]
        if self._rules.plan_ids:
            upload.plan_id = _plan_id(message, integers=integers, before=upload.plan_id)
        item = self._personality.stored(item)
        upload.heard_s = now_s
        upload.next_seq += 1
        if self._waits(kind):
            upload.items.append(item)
        else:
            self._write(kind, item, now_s)
        if not upload.finished:
            return [self._request(upload, now_s)]
        del self._uploads[kind]
        self._last_done = upload
        if self._waits(kind):
            self._complete(upload, now_s)
        if self._personality.announces_items and kind == _MISSION:
            self._say(mavlink.MAV_SEVERITY_INFO, "Flight plan received")
        return [self._ack(partner, _ACCEPTED, kind, upload.plan_id)]

    def _complete(self, upload: _Upload, now_s: float) -> None:
        kind, plan_id = upload.mission_type, upload.plan_id
        if plan_id != 0 and plan_id == self._plan_ids[kind]:
            return  # PX4 flies on where it is if it is given the same again
        marked = next((i.seq for i in upload.items if i.current == 1), 0 if self._rules.atomic else None)
        self._store(kind, [*upload.items, *upload.rest], marked, now_s, plan_id)

    def _take_stray(self, partner: Partner, kind: int, seq: int) -> list[Outgoing]:
        done = self._last_done
        if self._rules.repeats_last_ack and self._download is None and done is not None and seq == done.end_seq - 1:
            return [self._ack(partner, _ACCEPTED, kind, done.plan_id)]  # our acknowledgement was lost
        if self._rules.one_transfer:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, "IGN MISSION_ITEM: No transfer")
        return [self._ack(partner, mavlink.MAV_MISSION_ERROR, kind)]

    def _write(self, kind: int, item: MissionItem, now_s: float) -> None:
        store = self._stores[kind]
        if item.seq < len(store):
            store[item.seq] = item
        else:
            store.append(item)
        if kind == _MISSION:
            self._changed(tuple(store), None, now_s)

    def _store(self, kind: int, items: list[MissionItem], current: int | None, now_s: float, plan_id: int = 0) -> None:
        self._stores[kind] = items
        self._plan_ids[kind] = plan_id
        if kind == _MISSION:
            self._changed(tuple(items), current, now_s)

    def _heard_ack(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        """Take an acknowledgement as PX4 does: it ends a download, cancels an upload or has it ask in the other way."""
        if not self._rules.one_transfer:
            return []
        download, upload = self._download, next(iter(self._uploads.values()), None)
        if download is not None and self._same(download, partner, now_s) and download.mission_type == kind:
            self._download = None
        elif upload is not None and self._same(upload, partner, now_s):
            if message.type == mavlink.MAV_MISSION_OPERATION_CANCELLED:
                self._uploads.clear()
            elif message.type == mavlink.MAV_MISSION_UNSUPPORTED:
                self._int_mode = not self._int_mode
                return [self._request(upload, now_s)]
        return []

    def _taken_by_another(self, partner: Partner, kind: int, now_s: float) -> bool:
        upload = self._uploads.get(kind)
        return upload is not None and not self._same(upload, partner, now_s)

    def _same(self, transfer: _Upload | _Download, partner: Partner, now_s: float) -> bool:
        """Whether a transfer is this ground station's.

        ArduPilot goes by the ids alone, though it asks for items where the transfer was begun. PX4 has a transfer on
        one link at a time; one that has moved to another is known once that is quiet.
        """
        one = transfer.partner
        known = (one.system, one.component) == (partner.system, partner.component)
        if not self._rules.one_transfer:
            return known
        if known and one.link != partner.link and now_s - transfer.heard_s > _MOVED_AFTER_S:
            transfer.partner = partner
        return known and transfer.partner.link == partner.link

    def _check(self, kind: int, item: MissionItem, upload: _Upload) -> int:
        commands = FENCE_AND_RALLY_COMMANDS.get(kind, self._rules.commands)
        if item.command not in commands:
            return int(mavlink.MAV_MISSION_UNSUPPORTED)
        if item.frame not in self._rules.frames:
            return int(mavlink.MAV_MISSION_UNSUPPORTED_FRAME)
        result = self._personality.check(item)
        jumps = item.command == mavlink.MAV_CMD_DO_JUMP and self._rules.home_is_item_0 and result == _ACCEPTED
        if jumps and not 0 < item.param1 < max(upload.end_seq, len(self._stores[kind])):
            return int(mavlink.MAV_MISSION_ERROR)
        return result

    def _request(self, upload: _Upload, now_s: float) -> Outgoing:
        upload.asked_s = now_s
        kind = (
            mavlink.MAVLink_mission_request_int_message if self._int_mode else mavlink.MAVLink_mission_request_message
        )
        partner = upload.partner
        return partner.link, kind(partner.system, partner.component, upload.next_seq, upload.mission_type)

    # -- download and clearing --------------------------------------------------------------------------------------

    def _list(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        del message
        count = len(self._stores[kind])
        if self._rules.one_transfer:
            if self._uploads or not self._may_list(partner, kind, now_s):
                self._say(mavlink.MAV_SEVERITY_INFO, "Mission download request ignored, already active")
                return []
            self._download = _Download(partner, kind, count, now_s)
        elif kind in self._uploads:
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        reply = mavlink.MAVLink_mission_count_message(partner.system, partner.component, count, kind)
        return [(partner.link, with_plan_ids(reply, self._plan_ids[kind]))]

    def _may_list(self, partner: Partner, kind: int, now_s: float) -> bool:
        download = self._download
        if download is None or download.next_seq == download.count:  # all is sent: its ACK may have been lost
            return True
        return self._same(download, partner, now_s) and download.mission_type == kind

    def _send_item(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        seq = message.seq
        integers = isinstance(message, mavlink.MAVLink_mission_request_int_message)
        if self._rules.one_transfer:
            self._int_mode = integers
            refusal = self._refusal_in_order(partner, kind, seq, now_s)
            if refusal is not None:
                return refusal
        elif integers and kind in self._uploads:
            return [self._ack(partner, self._rules.second_uploader_ack, kind)]
        readable_home = kind == _MISSION and seq == 0 and self._rules.home_is_item_0
        if not readable_home and seq >= len(self._stores[kind]):
            return self._beyond_the_end(partner, kind)
        item = self._read(kind, seq)
        frame = self._personality.frame_read(item.frame) if integers else item.frame
        x, y = (item.x, item.y) if integers else (item.x * 1e-7, item.y * 1e-7)
        reply = mavlink.MAVLink_mission_item_int_message if integers else mavlink.MAVLink_mission_item_message
        fields = (frame, item.command, item.current, item.autocontinue)
        params = (item.param1, item.param2, item.param3, item.param4)
        return [(partner.link, reply(partner.system, partner.component, seq, *fields, *params, x, y, item.z, kind))]

    def _refusal_in_order(self, partner: Partner, kind: int, seq: int, now_s: float) -> list[Outgoing] | None:
        """Return PX4's answer to a request that is not the next of a download, or None where it is."""
        download = self._download
        transfer = download or next(iter(self._uploads.values()), None)
        if transfer is None:
            return []
        if not self._same(transfer, partner, now_s):
            self._say(mavlink.MAV_SEVERITY_CRITICAL, "WPM: REJ. CMD: partner id mismatch")
            return []
        if download is None:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, "WPM: REJ. CMD: Busy")
            return []
        if download.mission_type != kind:
            return []
        download.heard_s = now_s
        if seq == download.next_seq and seq < min(download.count, len(self._stores[kind])):
            download.next_seq += 1
        elif seq != download.next_seq - 1:
            self._download = None
            self._say(mavlink.MAV_SEVERITY_CRITICAL, "WPM: REJ. CMD: Req. WP was unexpected")
            return [self._ack(partner, mavlink.MAV_MISSION_ERROR, kind)]
        return None

    def _beyond_the_end(self, partner: Partner, kind: int) -> list[Outgoing]:
        """Return ArduPilot's answer to a request for an item that there is not: a lesson in how many there are."""
        if kind != _MISSION:
            return [self._ack(partner, mavlink.MAV_MISSION_INVALID_SEQUENCE, kind)]
        count = mavlink.MAVLink_mission_count_message(partner.system, partner.component, len(self._stores[kind]), kind)
        return [(partner.link, count), self._ack(partner, mavlink.MAV_MISSION_ERROR, kind)]

    def _read(self, kind: int, seq: int) -> MissionItem:
        is_home = kind == _MISSION and seq == 0 and self._rules.home_is_item_0
        item = self._home() if is_home else self._stores[kind][seq]
        return replace(item, seq=seq, current=int(kind == _MISSION and seq == self._current()))

    def _clear(self, partner: Partner, kind: int, message: Any, now_s: float) -> list[Outgoing]:
        del message
        kinds = list(self._stores) if kind == _ALL_TYPES else [kind]
        if self._rules.one_transfer and self.transferring:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, "WPM: IGN CLEAR CMD: Busy")
            return []
        if any(each in self._uploads for each in kinds) or (_MISSION in kinds and self._busy()):
            return [self._ack(partner, mavlink.MAV_MISSION_ERROR, kind)]
        for each in kinds:
            self._store(each, [], None, now_s)
        return [self._ack(partner, _ACCEPTED, kind)]

    def _ack(self, partner: Partner, result: int, kind: int, plan_id: int = 0) -> Outgoing:
        ack = mavlink.MAVLink_mission_ack_message(partner.system, partner.component, int(result), kind)
        return partner.link, with_plan_ids(ack, plan_id)


_BYTES_BEFORE_IDS = {
    int(mavlink.MAVLINK_MSG_ID_MISSION_COUNT): 5,
    int(mavlink.MAVLINK_MSG_ID_MISSION_ACK): 4,
    int(mavlink.MAVLINK_MSG_ID_MISSION_CURRENT): 6,
}


def with_plan_ids(message: Any, *ids: int) -> Any:
    """Return a MISSION_COUNT, _ACK or _CURRENT that carries opaque_ids, extension fields that pymavlink has not."""
    if not any(ids):
        return message

    def pack(mav: Any, force_mavlink1: bool = False) -> bytes:
        known = message.unpacker.pack(*(getattr(message, name) for name in message.ordered_fieldnames))
        known = known[: _BYTES_BEFORE_IDS[message.get_msgId()]]
        payload = known if force_mavlink1 else known + struct.pack(f"<{len(ids)}I", *ids)
        return bytes(message._pack(mav, message.crc_extra, payload, force_mavlink1=force_mavlink1))

    message.pack = pack
    return message


def _plan_id(message: Any, *, integers: bool, before: int) -> int:
    """Return PX4's running CRC32 of a plan after one more item: MavlinkMissionManager::crc32_for_mission_item."""
    params = (message.param1, message.param2, message.param3, message.param4)
    place = struct.pack("<iif" if integers else "<fff", message.x, message.y, message.z)
    data = struct.pack("<BHB4f", message.frame, message.command, message.autocontinue, *params) + place
    return zlib.crc32(data, before ^ 0xFFFFFFFF) ^ 0xFFFFFFFF  # zlib inverts at both ends, PX4 does not


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
