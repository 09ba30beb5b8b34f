"""Mission upload, download and comparison as state machines: messages and time in, messages out; no sockets.

The rules (https://mavlink.io/en/services/mission.html, and what real autopilots make of them):

1. Upload: COUNT, then the vehicle asks for every item, with MISSION_REQUEST or MISSION_REQUEST_INT; both are answered
   with MISSION_ITEM_INT. It ends with the vehicle's ACK, and only once the last item has been sent.
2. The vehicle leads: whatever it asks for (again) is sent (again), even after the end, since its last words may be lost
   or a doubled COUNT may have started it anew. We repeat what we said last when it falls silent.
3. Only the target's answers count, addressed to us, about our kind of mission.
4. A vehicle that is busy (NO_SPACE from ArduPilot just after connecting, ERROR from PX4 whose last transfer has not
   timed out yet) is asked again; one that cancels (ArduPilot after 8 s without an item) gets the whole mission again.
   Both are bounded.
5. ArduPilot answers INVALID_SEQUENCE to an item that comes twice and goes on; it answers ERROR to one that comes after
   it has accepted the mission. Then its ACK was lost: the upload ends unconfirmed and the read-back decides; so it does
   when nothing more is heard once the last item was sent.
6. Download: a vehicle that gives items in any order (ArduPilot) is asked for several at once. PX4 gives them in order,
   and ends the download at any request but the next or the last one: after one had to be repeated, its copies that are
   still under way are given the time to arrive.
7. An upload is believed when it reads back as sent, see :func:`mismatches`; not before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import (
    CHANGE_SPEED,
    FRAME_MISSION,
    LAND,
    LOITER_UNLIMITED,
    RETURN_TO_LAUNCH,
    TAKEOFF,
    WAYPOINT,
    MissionItem,
    float32_text,
)
from missionplanner.errors import LinkError
from missionplanner.vehicle import Autopilot, VehicleClass

Message = Any  # a pymavlink message: its classes are generated, and carry no types

OWN_SYSID = 255
# Ground stations as delivered all are 255/190 (MAVProxy 255/230): with ids of our own, who uploads by theirs is not
# served our items, and neither takes the other's answers. Autopilots look at their ground station's sysid only.
OWN_COMPONENT = mavlink.MAV_COMP_ID_USER53
AUTOPILOT_COMPONENT = 1


@dataclass(frozen=True, slots=True)
class Timing:
    """How long to wait, and how often to try."""

    answer_s: float = 1.5  # for the answer to a COUNT or REQUEST_LIST, as the specification says
    item_s: float = 0.25  # least wait for an item or for a request after one, likewise
    # the wait grows with the round trips measured, up to this: PX4 ends a download, ArduPilot an upload, when it hears
    # nothing for 5 and 8 s, and most of what is sent may be lost
    item_max_s: float = 0.7
    straggle_max_s: float = 1.0  # for copies of a request to arrive before the next is sent
    retries: int = 10  # of a COUNT or REQUEST_LIST; the specification's 5 lose 7 % of first contacts at 40 % loss
    item_retries: int = 20
    busy_s: float = 1.0  # before asking a busy vehicle again
    busy_retries: int = 12
    attempts: int = 4  # of the whole transfer
    read_attempts: int = 12  # of a download: PX4 ends it as soon as an old request comes late
    stalled_s: float = 20.0  # without a new item, however often the vehicle asks for the old ones
    restarts: int = 20  # of the vehicle's own, at each COUNT that comes late or twice: more of them are no progress

    def retries_of(self, attempt: int) -> int:
        """Return how often a COUNT or REQUEST_LIST is repeated: whoever has answered before gets more of them."""
        return self.retries if attempt == 1 else 2 * self.retries


@dataclass(frozen=True, slots=True)
class Party:
    """Who talks with whom: the vehicle's name and ids, and ours."""

    vehicle: str
    sysid: int
    own_sysid: int = OWN_SYSID
    own_component: int = OWN_COMPONENT

    def hears(self, message: Message, mission_type: int) -> bool:
        """Return whether a message is the vehicle's, for us, about that kind of mission."""
        return bool(
            message.get_srcSystem() == self.sysid
            and message.get_srcComponent() == AUTOPILOT_COMPONENT
            and message.target_system == self.own_sysid
            and message.target_component in (self.own_component, 0)
            and message.mission_type == mission_type
        )

    def error(self, text: str) -> LinkError:
        """Return an error that names the vehicle."""
        return LinkError(f"{self.vehicle} (sysid {self.sysid}): {text}")


class _Patience:
    """When to repeat a message and when to give up; the waits follow the measured round trips (RFC 6298)."""

    def __init__(self, timing: Timing) -> None:
        self._timing = timing
        self._mean_s: float | None = None
        self._deviation_s = 0.0
        self._sent_s = 0.0
        self._repeats = 0
        self.due_s = math.inf

    def sent(self, now_s: float, *, again: bool, wait_s: float | None = None) -> None:
        """Note that something was sent, the first time or again."""
        self._repeats = self._repeats + 1 if again else 0
        self._sent_s = now_s
        self.due_s = now_s + (self._item_wait_s() if wait_s is None else wait_s)

    def answered(self, now_s: float) -> None:
        """Note the awaited answer; one to a repeated message says nothing of the round trip (Karn)."""
        if self._repeats == 0:
            trip_s = now_s - self._sent_s
            if self._mean_s is None:
                self._mean_s, self._deviation_s = trip_s, trip_s / 2
            else:
                self._deviation_s += (abs(trip_s - self._mean_s) - self._deviation_s) / 4
                self._mean_s += (trip_s - self._mean_s) / 8

    def straggle_s(self) -> float:
        """Return how much later than the answered copy of what was repeated another copy may arrive; 0: none does."""
        if self._repeats == 0:
            return 0.0
        return min(max(4 * self._deviation_s, self._timing.item_s), self._timing.straggle_max_s)

    def _item_wait_s(self) -> float:
        if self._mean_s is None:
            return 2 * self._timing.item_s
        wait_s = max(self._mean_s + 4 * self._deviation_s, self._timing.item_s)
        # grows slowly: on a lossy link there is nobody to make room for
        return min(wait_s * 1.1**self._repeats, self._timing.item_max_s)

    def exhausted(self, retries: int) -> bool:
        return self._repeats >= retries


_REASONS: dict[int, str] = {
    mavlink.MAV_MISSION_UNSUPPORTED_FRAME: "unsupported frame",
    mavlink.MAV_MISSION_UNSUPPORTED: "unsupported command",
    mavlink.MAV_MISSION_INVALID: "invalid item",
    mavlink.MAV_MISSION_INVALID_PARAM1: "invalid param1",
    mavlink.MAV_MISSION_INVALID_PARAM2: "invalid param2",
    mavlink.MAV_MISSION_INVALID_PARAM3: "invalid param3",
    mavlink.MAV_MISSION_INVALID_PARAM4: "invalid param4",
    mavlink.MAV_MISSION_INVALID_PARAM5_X: "invalid latitude",
    mavlink.MAV_MISSION_INVALID_PARAM6_Y: "invalid longitude",
    mavlink.MAV_MISSION_INVALID_PARAM7: "invalid altitude",
}
_ACK = "MISSION_ACK"
_REQUESTS = ("MISSION_REQUEST", "MISSION_REQUEST_INT")


class MissionUpload:
    """One mission to one vehicle. Feed it all messages and poll it; it is done when ``done`` says so."""

    def __init__(
        self,
        party: Party,
        autopilot: Autopilot,
        items: Sequence[MissionItem],
        *,
        mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION,
        timing: Timing | None = None,
    ) -> None:
        self.total = len(items)
        self.sent = 0  # items that the vehicle has asked beyond: progress
        self.done = False
        self.confirmed = False  # by an ACK; otherwise the read-back decides
        self._party = party
        self._autopilot = autopilot
        self._items = tuple(items)
        self._mission_type = mission_type
        self._timing = timing or Timing()
        self._patience = _Patience(self._timing)
        self._phase: Literal["idle", "counting", "sending"] = "idle"
        self._attempt = 0
        self._busy = 0
        self._errors = 0  # since it asked last
        self._last: int | None = None  # the item sent last, in this attempt
        self._last_item_sent = False
        self._sent_whole = False  # in any attempt
        self._asked: set[int] = set()  # since the vehicle began
        self._restarts = 0
        self._progress_s = 0.0

    @property
    def state(self) -> str:
        """What the vehicle holds, as far as that is known, and what to do.

        Of ArduPilot's stores, COUNT alone cuts the mission and the rally points short, answered or not; only its fence
        is kept until a whole one has come.
        """
        what = self._what
        if self._phase == "idle":
            return f"it keeps its old {what}: upload again before flying"
        if self.confirmed:
            return f"it holds the new {what}, not read back: upload again before flying"
        if self._autopilot == "ardupilot" and self._mission_type != mavlink.MAV_MISSION_TYPE_FENCE:
            return f"it may hold a mixture of the old {what} and the new one: do not fly it, upload again"
        if self._sent_whole:
            return f"it may hold the old {what} or the new one: upload again before flying"
        return f"it keeps its old {what}: upload again before flying"

    def poll(self, now_s: float) -> list[Message]:
        """Start at the first call, then repeat what was said last when the vehicle has been silent too long.

        Raises
        ------
        LinkError
            The vehicle stays silent.
        """
        if self._phase == "idle":
            return self._begin(now_s)
        if self.done:
            return []
        return self._poll_counting(now_s) if self._phase == "counting" else self._poll_sending(now_s)

    def _poll_sending(self, now_s: float) -> list[Message]:
        if now_s > self._progress_s + self._timing.stalled_s:
            return self._again(now_s, "no progress")
        if now_s < self._patience.due_s:
            return []
        if self._patience.exhausted(self._timing.item_retries):
            if not self._last_item_sent:
                return self._again(now_s, "silence")
            self._finish(confirmed=False)
            return []
        assert self._last is not None
        return [self._item(self._last, now_s, again=True)]

    def _poll_counting(self, now_s: float) -> list[Message]:
        if now_s < self._patience.due_s:
            return []
        if self._patience.exhausted(self._timing.retries_of(self._attempt)):
            counts = self._timing.retries_of(self._attempt) + 1
            raise self._party.error(
                f"expected requests for {self._what} items, got no answer to {counts} MISSION_COUNTs; "
                f"{self.state}; check the link"
            )
        return [self._count(now_s, again=True)]

    def receive(self, message: Message, now_s: float) -> list[Message]:
        """Take one message from anywhere and return what to answer.

        Raises
        ------
        LinkError
            The vehicle refuses, cancels too often, or accepts a mission that it has not been sent.
        """
        kind = message.get_type()
        if (
            self._phase == "idle"
            or kind not in (_ACK, *_REQUESTS)
            or not self._party.hears(message, self._mission_type)
        ):
            return []
        if kind == _ACK:
            return self._acknowledged(message.type, now_s)
        if not 0 <= message.seq < self.total:
            return []  # an echo of a longer mission
        if message.seq != self._last:
            self._patience.answered(now_s)
        if message.seq == 0 and self._last not in (None, 0) and self._restarts < self._timing.restarts:
            self._restarts += 1
            self._asked.clear()
        if message.seq not in self._asked:
            self._asked.add(message.seq)
            self._progress_s = now_s
        self._phase = "sending"
        self._errors = 0
        self.sent = max(self.sent, message.seq)
        return [self._item(message.seq, now_s, again=False)]

    def _begin(self, now_s: float) -> list[Message]:
        self._attempt += 1
        self._phase = "counting"
        self._last = None
        self._last_item_sent = False
        self._errors = 0
        self._asked.clear()
        return [self._count(now_s, again=False)]

    def _count(self, now_s: float, *, again: bool) -> Message:
        self._patience.sent(now_s, again=again, wait_s=self._timing.answer_s)
        return mavlink.MAVLink_mission_count_message(
            self._party.sysid, AUTOPILOT_COMPONENT, self.total, mission_type=self._mission_type
        )

    def _item(self, seq: int, now_s: float, *, again: bool) -> Message:
        if not self.done:
            self._patience.sent(now_s, again=again)
        self._last = seq
        self._last_item_sent |= seq == self.total - 1
        self._sent_whole |= self._last_item_sent
        return item_message(self._items[seq], self._party.sysid, self._mission_type)

    def _acknowledged(self, result: int, now_s: float) -> list[Message]:
        if self.done:
            return []
        match result:
            case mavlink.MAV_MISSION_ACCEPTED:
                return self._accepted()
            case mavlink.MAV_MISSION_INVALID_SEQUENCE if self._autopilot == "ardupilot":
                return []  # an item came twice; the transfer goes on
            case mavlink.MAV_MISSION_ERROR if self._autopilot == "ardupilot" and self._last_item_sent:
                self._finish(confirmed=False)
                return []
            case mavlink.MAV_MISSION_ERROR if self._phase == "sending":
                # one may be about a doubled COUNT; two, and it knows of no upload: it has restarted, or has given up
                self._errors += 1
                return self._again(now_s, "an upload that it knows nothing of") if self._errors > 1 else []
            case mavlink.MAV_MISSION_NO_SPACE | mavlink.MAV_MISSION_ERROR:
                return self._wait_while_busy(result, now_s)
            case mavlink.MAV_MISSION_OPERATION_CANCELLED | mavlink.MAV_MISSION_INVALID_SEQUENCE:
                # a late echo of the attempt before cannot end this one before it has begun
                return self._again(now_s, "a cancelled transfer") if self._phase == "sending" else []
            case mavlink.MAV_MISSION_DENIED:
                raise self._party.error(
                    "refused the upload (DENIED): another ground station may be uploading; disconnect it and try "
                    f"again; {self.state}"
                )
        raise self._party.error(
            f"refused the {self._what}: {_REASONS.get(result, f'MAV_MISSION_RESULT {result}')}, "
            f"{self._at_last_item()}; {self.state}"
        )

    def _accepted(self) -> list[Message]:
        if self.total == 0 or self._last_item_sent:
            self._finish(confirmed=True)
        elif self._phase == "sending":
            raise self._party.error(
                f"accepted the {self._what} before its last item was sent "
                f"({self._at_last_item()} of {self.total - 1}); {self.state}"
            )
        return []  # while counting: an echo of an earlier transfer

    def _wait_while_busy(self, result: int, now_s: float) -> list[Message]:
        self._busy += 1
        if self._busy > self._timing.busy_retries:
            reason = "no space" if result == mavlink.MAV_MISSION_NO_SPACE else "error"
            raise self._party.error(
                f"refused a {self._what} of {self.total} items ({reason}) {self._busy} times; "
                f"it holds fewer: shorten it, or wait until the vehicle is ready and upload again; {self.state}"
            )
        if self._phase == "counting":
            self._patience.sent(now_s, again=False, wait_s=self._timing.busy_s)
        return []

    def _again(self, now_s: float, why: str) -> list[Message]:
        if self._attempt >= self._timing.attempts:
            raise self._party.error(
                f"upload given up after {self._attempt} attempts: {why} after {self._at_last_item()} "
                f"of {self.total - 1}; "
                f"{self.state}"
            )
        return self._begin(now_s)

    def _finish(self, *, confirmed: bool) -> None:
        self.done = True
        self.confirmed = confirmed
        self.sent = self.total

    def _at_last_item(self) -> str:
        if self._last is None:
            return "no item sent"
        return f"item {self._last} (command {self._items[self._last].command})"

    @property
    def _what(self) -> str:
        return what_is_sent(self._mission_type)


class MissionDownload:
    """The mission that one vehicle holds. Feed it all messages and poll it; then read ``items``.

    ``ahead`` is how many items are asked for at once: 1 where they are only given in order.
    """

    def __init__(
        self,
        party: Party,
        *,
        mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION,
        ahead: int = 1,
        timing: Timing | None = None,
    ) -> None:
        self.total: int | None = None
        self.done = False
        self._items: dict[int, MissionItem] = {}
        self._asked: set[int] = set()
        self._party = party
        self._mission_type = mission_type
        self._ahead = ahead
        self._timing = timing or Timing()
        self._patience = _Patience(self._timing)
        self._phase: Literal["idle", "listing", "reading"] = "idle"
        self._attempt = 0
        self._busy = 0
        self._next_s = -math.inf  # before then, nothing more is asked for

    @property
    def items(self) -> tuple[MissionItem, ...]:
        """The items read so far, in order; all of them once ``done``."""
        return tuple(self._items[seq] for seq in sorted(self._items))

    def poll(self, now_s: float) -> list[Message]:
        """Start at the first call, then ask again when the vehicle has been silent too long.

        Raises
        ------
        LinkError
            The vehicle stays silent.
        """
        if self._phase == "idle":
            return self._begin(now_s)
        if self.done:
            return []
        if self._phase == "reading" and not self._asked and now_s >= self._next_s:
            return self._ask(now_s)
        if now_s < self._patience.due_s:
            return []
        if self._phase == "listing":
            if self._patience.exhausted(self._timing.retries_of(self._attempt)):
                what = what_is_sent(self._mission_type)
                raise self._party.error(f"expected its {what}, got no answer to MISSION_REQUEST_LIST; check the link")
            return [self._list(now_s, again=True)]
        if self._patience.exhausted(self._timing.item_retries):
            return self._again(now_s, "silence")
        return [self._request(seq, now_s, again=True) for seq in sorted(self._asked)]

    def receive(self, message: Message, now_s: float) -> list[Message]:
        """Take one message from anywhere and return what to answer.

        Raises
        ------
        LinkError
            The vehicle refuses, or its mission changes meanwhile.
        """
        kind = message.get_type()
        if (
            self._phase == "idle"
            or self.done
            or kind not in (_ACK, "MISSION_COUNT", "MISSION_ITEM_INT")
            or not self._party.hears(message, self._mission_type)
        ):
            return []
        if kind == _ACK:
            return self._refused(message.type, now_s)
        if kind == "MISSION_COUNT":
            return self._counted(message.count, now_s)
        if self._phase != "reading" or message.seq not in self._asked:
            return []
        self._asked.discard(message.seq)
        self._next_s = now_s + (self._patience.straggle_s() if self._ahead == 1 else 0.0)
        self._patience.answered(now_s)
        self._items[message.seq] = message_item(message)
        return self._next(now_s)

    def _begin(self, now_s: float) -> list[Message]:
        self._attempt += 1
        self._phase = "listing"
        self._items.clear()
        self._asked.clear()
        self.total = None
        return [self._list(now_s, again=False)]

    def _list(self, now_s: float, *, again: bool) -> Message:
        self._patience.sent(now_s, again=again, wait_s=self._timing.answer_s)
        return mavlink.MAVLink_mission_request_list_message(
            self._party.sysid, AUTOPILOT_COMPONENT, mission_type=self._mission_type
        )

    def _ask(self, now_s: float) -> list[Message]:
        """Ask for the first items that are neither read nor asked for, as many as may be under way."""
        assert self.total is not None
        free = self._ahead - len(self._asked)
        last = max([*self._items, *self._asked], default=-1)
        more = list(range(last + 1, min(last + 1 + free, self.total)))
        self._asked.update(more)
        return [self._request(seq, now_s, again=False) for seq in more]

    def _request(self, seq: int, now_s: float, *, again: bool) -> Message:
        if not again or seq == min(self._asked):  # several that are repeated at once are one repetition
            self._patience.sent(now_s, again=again)
        return mavlink.MAVLink_mission_request_int_message(
            self._party.sysid, AUTOPILOT_COMPONENT, seq, mission_type=self._mission_type
        )

    def _counted(self, count: int, now_s: float) -> list[Message]:
        if self._phase == "listing":
            self._patience.answered(now_s)
            self._phase = "reading"
            self._next_s = now_s
            self.total = count
            return self._next(now_s)
        if count != self.total:
            return self._again(now_s, "its mission changing")
        return []

    def _next(self, now_s: float) -> list[Message]:
        if len(self._items) != self.total:
            return self._ask(now_s) if now_s >= self._next_s else []
        self.done = True
        return [
            mavlink.MAVLink_mission_ack_message(
                self._party.sysid, AUTOPILOT_COMPONENT, mavlink.MAV_MISSION_ACCEPTED, mission_type=self._mission_type
            )
        ]

    def _refused(self, result: int, now_s: float) -> list[Message]:
        if result == mavlink.MAV_MISSION_ACCEPTED:
            return []  # an echo of an upload
        if result == mavlink.MAV_MISSION_UNSUPPORTED and self._mission_type != mavlink.MAV_MISSION_TYPE_MISSION:
            self.total = 0  # firmware without fences or rally points holds none
            self.done = True
            return []
        if self._phase == "reading":
            return self._again(now_s, f"refusal (MAV_MISSION_RESULT {result})")
        self._busy += 1
        if self._busy > self._timing.busy_retries:
            raise self._party.error(f"refused to give its mission (MAV_MISSION_RESULT {result}); wait and try again")
        # busy with another transfer: ask again in a while
        self._patience.sent(now_s, again=False, wait_s=self._timing.busy_s)
        return []

    def _again(self, now_s: float, why: str) -> list[Message]:
        if self._attempt >= self._timing.read_attempts:
            raise self._party.error(
                f"reading its mission given up after {self._attempt} attempts: {why} "
                f"at item {len(self._items)} of {self.total}; "
                "check the link"
            )
        return self._begin(now_s)


def what_is_sent(mission_type: int) -> str:
    """Return what a MAV_MISSION_TYPE is called."""
    return {mavlink.MAV_MISSION_TYPE_FENCE: "fence", mavlink.MAV_MISSION_TYPE_RALLY: "set of rally points"}.get(
        mission_type, "mission"
    )


def item_message(item: MissionItem, sysid: int, mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION) -> Message:
    """Return an item as a MISSION_ITEM_INT for one vehicle."""
    return mavlink.MAVLink_mission_item_int_message(
        sysid,
        AUTOPILOT_COMPONENT,
        item.seq,
        item.frame,
        item.command,
        item.current,
        item.autocontinue,
        item.param1,
        item.param2,
        item.param3,
        item.param4,
        item.x,
        item.y,
        item.z,
        mission_type=mission_type,
    )


def message_item(message: Message) -> MissionItem:
    """Return what a MISSION_ITEM_INT carries."""
    return MissionItem(
        seq=message.seq,
        frame=message.frame,
        command=message.command,
        param1=message.param1,
        param2=message.param2,
        param3=message.param3,
        param4=message.param4,
        x=message.x,
        y=message.y,
        z=message.z,
        current=message.current,
        autocontinue=message.autocontinue,
    )


@dataclass(frozen=True, slots=True)
class Mismatch:
    """One field of a mission that the vehicle does not hold as it was sent."""

    seq: int
    field: str
    sent: float
    read: float

    def __str__(self) -> str:
        sent, read = (str(value) if isinstance(value, int) else float32_text(value) for value in (self.sent, self.read))
        return f"item {self.seq}: {self.field}: sent {sent}, the vehicle holds {read}"


# The superseded *_INT frames mean the same as these.
_FRAME_NAMES = {5: 0, 6: 3, 11: 10}
_PARAMS = ("param1", "param2", "param3", "param4")
_PLACE = ("x", "y", "z")
_GUARDS: dict[int, tuple[str, ...]] = {
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION: ("param1", "x", "y"),
    mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION: ("param1", "x", "y"),
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION: ("param1", "x", "y"),
    mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION: ("param1", "x", "y"),
    mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT: ("x", "y"),
    mavlink.MAV_CMD_NAV_RALLY_POINT: _PLACE,
}

# What each firmware keeps of a command, as measured or as its source has it (ArduPilot: AP_Mission.cpp; PX4:
# mavlink_mission.cpp); the rest is dropped or rewritten. ArduCopter drops p2 to p4 of a waypoint and sets p4 of LAND,
# ArduPlane drops p1 of a waypoint; neither autopilot keeps anything of RTL. What is not named is compared entirely.
_KEPT: dict[Autopilot, dict[int, tuple[str, ...]]] = {
    "ardupilot": {
        WAYPOINT: ("param1", *_PLACE),
        LOITER_UNLIMITED: ("param3", *_PLACE),
        mavlink.MAV_CMD_NAV_LOITER_TURNS: ("param1", "param3", *_PLACE),
        mavlink.MAV_CMD_NAV_LOITER_TIME: ("param1", *_PLACE),
        RETURN_TO_LAUNCH: (),
        LAND: ("param1", *_PLACE),
        TAKEOFF: ("param1", *_PLACE),
        mavlink.MAV_CMD_NAV_LOITER_TO_ALT: ("param2", *_PLACE),
        mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT: ("param1", *_PLACE),
        **_GUARDS,
        mavlink.MAV_CMD_CONDITION_DELAY: ("param1",),
        mavlink.MAV_CMD_CONDITION_DISTANCE: ("param1",),
        mavlink.MAV_CMD_DO_SET_MODE: ("param1",),
        mavlink.MAV_CMD_DO_JUMP: ("param1", "param2"),
        CHANGE_SPEED: ("param1", "param2", "param3"),
        mavlink.MAV_CMD_DO_LAND_START: _PLACE,
        mavlink.MAV_CMD_DO_SET_ROI_LOCATION: ("param1", *_PLACE),
        mavlink.MAV_CMD_DO_SET_ROI_NONE: (),
        mavlink.MAV_CMD_DO_SET_ROI: ("param1", *_PLACE),
        mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST: ("param1", "param3"),
        mavlink.MAV_CMD_DO_DIGICAM_CONTROL: (*_PARAMS, "x", "y"),
        mavlink.MAV_CMD_DO_MOUNT_CONTROL: ("param1", "param2", "param3"),
        mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: (*_PARAMS, "x", "z"),
        mavlink.MAV_CMD_IMAGE_START_CAPTURE: ("param1", "param2", "param3"),
        mavlink.MAV_CMD_IMAGE_STOP_CAPTURE: ("param1",),
    },
    "px4": {
        WAYPOINT: ("param1", "param2", "param4", *_PLACE),
        LOITER_UNLIMITED: ("param3", "param4", *_PLACE),
        mavlink.MAV_CMD_NAV_LOITER_TIME: ("param1", "param2", "param3", *_PLACE),
        RETURN_TO_LAUNCH: (),
        LAND: ("param2", "param4", *_PLACE),
        TAKEOFF: ("param4", *_PLACE),
        mavlink.MAV_CMD_NAV_LOITER_TO_ALT: ("param1", "param2", *_PLACE),
        **_GUARDS,
        mavlink.MAV_CMD_DO_JUMP: ("param1", "param2"),
        CHANGE_SPEED: ("param1", "param2", "param3"),
        mavlink.MAV_CMD_DO_SET_ROI_LOCATION: _PLACE,
        mavlink.MAV_CMD_DO_DIGICAM_CONTROL: (*_PARAMS, *_PLACE),
        mavlink.MAV_CMD_DO_MOUNT_CONTROL: (*_PARAMS, *_PLACE),
        mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: (*_PARAMS, *_PLACE),
    },
}
_KEPT_BY_ARDUPLANE: dict[int, tuple[str, ...]] = {WAYPOINT: ("param2", "param3", *_PLACE)}
# stored as whole numbers, truncated
_INTEGER_PARAMS: dict[Autopilot, dict[int, tuple[str, ...]]] = {
    "ardupilot": {
        WAYPOINT: ("param1", "param2", "param3"),
        LOITER_UNLIMITED: ("param3",),
        mavlink.MAV_CMD_NAV_LOITER_TURNS: ("param3",),
        mavlink.MAV_CMD_NAV_LOITER_TIME: ("param1",),
        LAND: ("param1",),
        TAKEOFF: ("param1",),
        mavlink.MAV_CMD_NAV_LOITER_TO_ALT: ("param2",),
        mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT: ("param1",),
        mavlink.MAV_CMD_NAV_RALLY_POINT: ("z",),
        mavlink.MAV_CMD_DO_DIGICAM_CONTROL: _PARAMS,
        mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW: _PARAMS,
        mavlink.MAV_CMD_IMAGE_START_CAPTURE: ("param1", "param3"),
    },
    "px4": {},
}
_YAW: dict[Autopilot, tuple[int, ...]] = {
    "ardupilot": (),
    "px4": (WAYPOINT, LOITER_UNLIMITED, LAND, TAKEOFF),
}  # p4, given back in 0 to 360
_ALTITUDE_TOLERANCE_M: dict[Autopilot, float] = {
    "ardupilot": 0.011,  # stores centimetres, truncated, of a single-precision number
    "px4": 1e-3,
}


def mismatches(
    sent: Sequence[MissionItem],
    read: Sequence[MissionItem],
    autopilot: Autopilot,
    vehicle_class: VehicleClass = "copter",
    *,
    mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION,
) -> list[Mismatch]:
    """Compare a mission, fence or rally points with the read-back, allowing each autopilot what it is known to rewrite.

    ArduPilot's seq 0 of a mission is the vehicle's own home: its position is not compared.
    """
    if len(sent) != len(read):
        return [Mismatch(min(len(sent), len(read)), "count of items", len(sent), len(read))]
    own_home = autopilot == "ardupilot" and mission_type == mavlink.MAV_MISSION_TYPE_MISSION
    found = []
    for item, held in zip(sent, read, strict=True):
        if item.command != held.command:
            found.append(Mismatch(item.seq, "command", item.command, held.command))
        elif not (own_home and item.seq == 0):
            found += _item_mismatches(item, held, autopilot, vehicle_class)
    return found


def _item_mismatches(
    item: MissionItem, held: MissionItem, autopilot: Autopilot, vehicle_class: VehicleClass
) -> list[Mismatch]:
    sent_frame, held_frame = (_FRAME_NAMES.get(frame, frame) for frame in (item.frame, held.frame))
    positioned = sent_frame != FRAME_MISSION
    kept = _KEPT[autopilot].get(item.command, (*_PARAMS, *_PLACE) if positioned else _PARAMS)
    if autopilot == "ardupilot" and vehicle_class == "plane":
        kept = _KEPT_BY_ARDUPLANE.get(item.command, kept)
    found = []
    # ArduPilot gives frame 2 back as 0; where no altitude is meant, the frame says nothing
    if positioned and "z" in kept and sent_frame != held_frame:
        found.append(Mismatch(item.seq, "frame", item.frame, held.frame))
    for field in kept:
        want, got = getattr(item, field), getattr(held, field)
        if field in _INTEGER_PARAMS[autopilot].get(item.command, ()) and math.isfinite(want):
            want = float(math.trunc(want))
        turns = field == "param4" and item.command in _YAW[autopilot]
        if not _same(field, want, got, autopilot) and not (turns and _same_angle(want, got)):
            found.append(Mismatch(item.seq, field, want, got))
    return found


def _same_angle(want_deg: float, got_deg: float) -> bool:
    return math.isfinite(want_deg) and abs((want_deg - got_deg + 180.0) % 360.0 - 180.0) <= 1e-3


def _same(field: str, want: float, got: float, autopilot: Autopilot) -> bool:
    if math.isnan(want) or math.isnan(got):
        # NaN asks for the autopilot's own choice; ArduPilot gives 0 back for it
        return math.isnan(want) and (math.isnan(got) or autopilot == "ardupilot")
    tolerance = {"x": 0.0, "y": 0.0, "z": _ALTITUDE_TOLERANCE_M[autopilot]}.get(field, 1e-3)
    return abs(want - got) <= tolerance
