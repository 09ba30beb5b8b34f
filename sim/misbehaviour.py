"""Vehicles that misbehave on demand: mute, deaf, confused, rebooting. A link's own faults are in :mod:`sim.faults`.

A fault is asked for in words, e.g. ``vehicle 2: reboot at item 5``: see :func:`parse_fault`. QGroundControl's names of
the failures of its own fake vehicle (its MockLink) are words, too.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from types import MappingProxyType
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from missionplanner.errors import MissionError
from sim.mission_service import Link, Outgoing
from sim.vehicle_link import VehicleLink

Kind = Literal["deaf", "mute", "unanswered", "wrong", "changed", "error", "acceptance", "reboot", "silent"]

_SHIFT_M = 10.0  # by which a changed item is higher
_RESULT_MAX = int(mavlink.MAV_MISSION_OPERATION_CANCELLED)


@dataclass(frozen=True, slots=True)
class Fault:
    """One way to misbehave.

    ``message`` is the MAVLink message that it is about (MISSION_ITEM and MISSION_REQUEST mean their _INT forms, too;
    None: all), ``item`` the seq of a mission item or the number of a command that it is about (None: every one).
    ``result`` is the MAV_MISSION_RESULT of an acknowledgement that is an error.
    """

    kind: Kind
    message: str | None = None
    item: int | None = None
    times: float = math.inf
    after_s: float = 0.0
    for_s: float = math.inf
    result: int = int(mavlink.MAV_MISSION_ERROR)


_FIELDS: Mapping[str, frozenset[str]] = MappingProxyType(
    {kind.msgname: frozenset(kind.fieldnames) for kind in mavlink.mavlink_map.values()}
)
_NUMBERS = ("seq", "command", "param_index")  # what "item N" means of a message, whichever it has first
_NAME = r"(?P<message>[A-Z][A-Z0-9_]*)"
_ITEM = r"(?: item (?P<item>\d+))?"
_RESULT = r"(?: (?P<result>\d+))?"
_FORMS: Mapping[Kind, tuple[str, str]] = MappingProxyType(
    {
        "reboot": (r"reboot(?: at item (?P<item>\d+))?", "reboot [at item N]"),
        "silent": (r"silent(?: at item (?P<item>\d+))?", "silent [at item N]"),
        "deaf": (rf"deaf(?: to {_NAME})?", "deaf [to MESSAGE]"),
        "unanswered": (rf"no answer to {_NAME}(?: (?P<item>\d+))?", "no answer to MESSAGE [COMMAND]"),
        "mute": (rf"no {_NAME}{_ITEM}", "no MESSAGE [item N]"),
        "wrong": (rf"wrong {_NAME}{_RESULT}{_ITEM}", "wrong MESSAGE [RESULT] [item N]"),
        "changed": (rf"changed (?P<message>MISSION_ITEM){_ITEM}", "changed MISSION_ITEM [item N]"),
        "error": (rf"error{_RESULT} instead of {_NAME}{_ITEM}", "error [RESULT] instead of MESSAGE [item N]"),
        "acceptance": (rf"acceptance instead of {_NAME}{_ITEM}", "acceptance instead of MESSAGE [item N]"),
    }
)
_SUFFIX = re.compile(r"\s+(?:(?P<once>once)|after (?P<after>[\d.]+) s|for (?P<for>[\d.]+) s)$")

QGROUNDCONTROL_FAULTS: Mapping[str, Fault] = MappingProxyType(
    {
        # MockLinkMissionItemHandler::FailureMode_t
        "FailReadRequestListNoResponse": Fault("unanswered", "MISSION_REQUEST_LIST"),
        "FailReadRequestListFirstResponse": Fault("unanswered", "MISSION_REQUEST_LIST", times=1),
        "FailReadRequest0NoResponse": Fault("mute", "MISSION_ITEM", 0),
        "FailReadRequest1NoResponse": Fault("mute", "MISSION_ITEM", 1),
        "FailReadRequest1FirstResponse": Fault("mute", "MISSION_ITEM", 1, times=1),
        "FailReadRequest0IncorrectSequence": Fault("wrong", "MISSION_ITEM", 0),
        "FailReadRequest1IncorrectSequence": Fault("wrong", "MISSION_ITEM", 1),
        "FailReadRequest0ErrorAck": Fault("error", "MISSION_ITEM", 0),
        "FailReadRequest1ErrorAck": Fault("error", "MISSION_ITEM", 1),
        "FailWriteMissionCountNoResponse": Fault("deaf", "MISSION_COUNT"),
        "FailWriteMissionCountFirstResponse": Fault("deaf", "MISSION_COUNT", times=1),
        "FailWriteRequest1NoResponse": Fault("mute", "MISSION_REQUEST", 1),
        "FailWriteRequest0IncorrectSequence": Fault("wrong", "MISSION_REQUEST", 0),
        "FailWriteRequest1IncorrectSequence": Fault("wrong", "MISSION_REQUEST", 1),
        "FailWriteRequest0ErrorAck": Fault("error", "MISSION_REQUEST", 0),
        "FailWriteRequest1ErrorAck": Fault("error", "MISSION_REQUEST", 1),
        "FailWriteFinalAckNoResponse": Fault("mute", "MISSION_ACK"),
        "FailWriteFinalAckErrorAck": Fault("wrong", "MISSION_ACK"),
        "FailWriteFinalAckMissingRequests": Fault("acceptance", "MISSION_REQUEST", 3),
        # MockConfiguration::FailureMode_t, MockLink's modes of parameters and requested messages
        "FailParamNoResponseToRequestList": Fault("deaf", "PARAM_REQUEST_LIST"),
        "FailMissingParamOnInitialRequest": Fault("mute", "PARAM_VALUE", 3, times=1),
        "FailMissingParamOnAllRequests": Fault("mute", "PARAM_VALUE", 3),
        "FailInitialConnectRequestMessageAutopilotVersionFailure": Fault("wrong", "COMMAND_ACK", 512),
        "FailInitialConnectRequestMessageAutopilotVersionLost": Fault("mute", "AUTOPILOT_VERSION"),
        "FailParamSetNoAck": Fault("unanswered", "PARAM_SET"),
        "FailParamSetFirstAttemptNoAck": Fault("unanswered", "PARAM_SET", times=1),
        "FailParamRequestReadNoResponse": Fault("unanswered", "PARAM_REQUEST_READ"),
        "FailParamRequestReadFirstAttemptNoResponse": Fault("unanswered", "PARAM_REQUEST_READ", times=1),
        "FailRequestMessageCommandAcceptedMsgNotSent": Fault("mute", "AUTOPILOT_VERSION"),
        "FailRequestMessageCommandUnsupported": Fault("wrong", "COMMAND_ACK", 512),
        "FailRequestMessageCommandNoResponse": Fault("unanswered", "COMMAND_LONG", 512),
    }
)


def parse_fault(text: str) -> tuple[int | None, Fault]:
    """Read ``vehicle N: FAULT [once] [after S s] [for S s]``; returns the vehicle's sysid (None: all) and the fault.

    Raises
    ------
    MissionError
        Words that mean no fault: with all that would.
    """
    head = re.fullmatch(r"\s*(?:vehicle (?P<sysid>\d+)|all vehicles):\s*(?P<rest>.+?)\s*", text)
    if head is None:
        raise MissionError(f"fault: expected 'vehicle N: FAULT' or 'all vehicles: FAULT', got {text!r}; {_forms()}")
    rest, times, after_s, for_s = head["rest"], math.inf, 0.0, math.inf
    while suffix := _SUFFIX.search(rest):
        rest = rest[: suffix.start()]
        try:
            times = 1.0 if suffix["once"] else times
            after_s = float(suffix["after"]) if suffix["after"] else after_s
            for_s = float(suffix["for"]) if suffix["for"] else for_s
        except ValueError:
            raise MissionError(f"fault: expected seconds as a number, got {text!r}") from None
    fault = QGROUNDCONTROL_FAULTS.get(rest)
    for kind, (pattern, _) in _FORMS.items():
        match = re.fullmatch(pattern, rest)
        if match is None or fault is not None:
            continue
        groups = match.groupdict()
        item = groups.get("item")
        fault = Fault(kind, groups.get("message"), None if item is None else int(item))
        if groups.get("result") is not None:
            fault = replace(fault, result=int(groups["result"]))
        if kind == "reboot":
            times = 1.0
    if fault is None:
        raise MissionError(f"fault: {rest!r} is none; {_forms(rest)}")
    if fault.message is not None:
        _check_message(fault, text)
    if fault.result > _RESULT_MAX:
        raise MissionError(f"fault: expected a MAV_MISSION_RESULT from 0 to {_RESULT_MAX}, got {text!r}")
    sysid = None if head["sysid"] is None else int(head["sysid"])
    return sysid, replace(fault, times=min(fault.times, times), after_s=after_s, for_s=for_s)


def _check_message(fault: Fault, text: str) -> None:
    """Refuse a fault that would never strike."""
    fields = _FIELDS.get(str(fault.message))
    if fields is None:
        raise MissionError(f"fault: expected the name of a MAVLink message, got {fault.message!r} in {text!r}")
    if fault.item is not None and fields.isdisjoint(_NUMBERS):
        raise MissionError(f"fault: expected no number after {fault.message}, which is about no item, got {text!r}")
    if fault.kind == "wrong" and fault.message not in ("MISSION_ACK", "COMMAND_ACK") and "seq" not in fields:
        raise MissionError(f"fault: expected a message with a seq, or an acknowledgement, to be wrong, got {text!r}")


def faults_of(texts: Iterable[str], sysids: Sequence[int]) -> dict[int, tuple[Fault, ...]]:
    """Read faults for a fleet: those of each vehicle, by its sysid.

    Raises
    ------
    MissionError
        Words that mean no fault, or a vehicle that there is not.
    """
    found: dict[int, tuple[Fault, ...]] = {}
    for text in texts:
        sysid, fault = parse_fault(text)
        if sysid is not None and sysid not in sysids:
            raise MissionError(f"fault: expected a vehicle from {min(sysids)} to {max(sysids)}, got {text!r}")
        for each in sysids if sysid is None else (sysid,):
            found[each] = (*found.get(each, ()), fault)
    return found


def _forms(words: str = "") -> str:
    """Return what would be a fault: of QGroundControl's many names the nearest, or all there is room for."""
    names = list(QGROUNDCONTROL_FAULTS)
    if words.startswith("Fail"):
        return f"QGroundControl's failure modes like it: {', '.join(get_close_matches(words, names, 8, 0.0))}"
    forms = ", ".join(form for _, form in _FORMS.values())
    return (
        f"faults are: {forms}, each with [once] [after SECONDS s] [for SECONDS s]; "
        f"and QGroundControl's failure modes by their names, such as {names[0]} or {names[-1]}"
    )


@dataclass(slots=True)
class _Armed:
    """A fault and how often it may still strike; ``until_s`` bounds one that has begun at an item."""

    fault: Fault
    left: float
    until_s: float = -math.inf

    def now(self, now_s: float) -> bool:
        after_s = self.fault.after_s
        return self.left > 0 and after_s <= now_s < after_s + self.fault.for_s


class MisbehavingLink(VehicleLink):
    """A vehicle's link with faults. What the vehicle hears and says passes through them; it knows nothing of them."""

    def __init__(self, *arguments: Any, faults: Sequence[Fault], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._faults = [_Armed(fault, fault.times) for fault in faults]

    @property
    def wake_s(self) -> float:
        """When :meth:`poll` is due."""
        due_s = (armed.fault.after_s for armed in self._faults if self._waits_for_its_time(armed))
        return min(super().wake_s, *due_s, math.inf)

    @staticmethod
    def _waits_for_its_time(armed: _Armed) -> bool:
        return armed.fault.kind == "reboot" and armed.fault.item is None and armed.left > 0

    def receive(self, message: Any, link: Link, now_s: float) -> list[Outgoing]:
        """Obey one message, or not; return the replies, or others."""
        name = message.get_type()
        for armed in self._faults:
            if armed.fault.kind == "deaf" and armed.now(now_s) and _about(armed.fault, name):
                if self._is_mine(message):
                    armed.left -= 1
                return []
        replies = super().receive(message, link, now_s)
        for armed in self._faults:
            fault = armed.fault
            unanswered = fault.kind == "unanswered" and armed.now(now_s) and _about(fault, name)
            if unanswered and replies and fault.item in (None, getattr(message, "command", None)):
                armed.left -= 1
                return []
        return self._said(replies, now_s)

    def _is_mine(self, message: Any) -> bool:
        return getattr(message, "target_system", self.sysid) in (0, self.sysid)

    def poll(self, now_s: float) -> list[Outgoing]:
        """Return what is due, or what a confused vehicle takes for it."""
        for armed in self._faults:
            if self._waits_for_its_time(armed) and now_s >= armed.fault.after_s:
                armed.left -= 1
                self.reboot(now_s)
        return self._said(super().poll(now_s), now_s)

    def _said(self, messages: list[Outgoing], now_s: float) -> list[Outgoing]:
        """Return what becomes of messages on their way out."""
        out: list[Outgoing] = []
        for link, message in messages:
            if self._strikes_at_item(message, now_s):
                return []
            said = message
            for armed in self._faults:
                change = _CHANGES.get(armed.fault.kind)
                if said is None or change is None or not armed.now(now_s) or not _strikes(armed.fault, said):
                    continue
                armed.left -= 1
                said = change(self, said, armed.fault.result)
            if said is not None:
                out.append((link, said))
        return [] if self._is_silent(now_s) else out

    def _strikes_at_item(self, message: Any, now_s: float) -> bool:
        """Whether the vehicle reboots instead of asking for an item, or falls silent."""
        for armed in self._faults:
            fault = armed.fault
            if fault.kind not in ("reboot", "silent") or fault.item is None or armed.left <= 0 or now_s < fault.after_s:
                continue
            if not _strikes(replace(fault, message="MISSION_REQUEST"), message):
                continue
            if fault.kind == "reboot":
                armed.left -= 1
                self.reboot(now_s)
                return True
            if armed.until_s == -math.inf:
                armed.until_s = now_s + fault.for_s
        return False

    def _is_silent(self, now_s: float) -> bool:
        silent = (armed for armed in self._faults if armed.fault.kind == "silent")
        return any(armed.now(now_s) if armed.fault.item is None else now_s < armed.until_s for armed in silent)

    def _wrong(self, message: Any, result: int) -> Any:
        """Return a message with the next seq (an item with that one's content), or a refusing acknowledgement."""
        name = message.get_type()
        if name == "MISSION_ACK":
            return mavlink.MAVLink_mission_ack_message(
                message.target_system, message.target_component, result, message.mission_type
            )
        if name == "COMMAND_ACK":
            message.result = mavlink.MAV_RESULT_UNSUPPORTED
            return message
        message.seq = (message.seq + 1) % 65_536
        held = self.missions.items(message.mission_type) if name.startswith("MISSION_ITEM") else ()
        if message.seq < len(held):
            item = held[message.seq]
            scale = 1 if name == "MISSION_ITEM_INT" else 1e-7
            message.frame, message.command, message.z = item.frame, item.command, item.z
            message.x, message.y = item.x * scale, item.y * scale
            message.param1, message.param2 = item.param1, item.param2
            message.param3, message.param4 = item.param3, item.param4
        return message

    def _instead(self, message: Any, result: int) -> Any:
        target = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        return mavlink.MAVLink_mission_ack_message(*target, result, getattr(message, "mission_type", 0))

    def _changed(self, message: Any, result: int) -> Any:
        del result
        message.z += _SHIFT_M
        return message


_CHANGES: Mapping[Kind, Callable[[MisbehavingLink, Any, int], Any]] = MappingProxyType(
    {
        "mute": lambda *_: None,
        "wrong": MisbehavingLink._wrong,
        "changed": MisbehavingLink._changed,
        "error": MisbehavingLink._instead,
        "acceptance": lambda link, message, _: link._instead(message, mavlink.MAV_MISSION_ACCEPTED),
    }
)


def _about(fault: Fault, name: str) -> bool:
    """Whether a fault is about messages of that name."""
    both = fault.message in ("MISSION_ITEM", "MISSION_REQUEST")
    return fault.message in (None, name) or (both and name == f"{fault.message}_INT")


def _strikes(fault: Fault, message: Any) -> bool:
    """Whether a fault is about this outgoing message."""
    numbers = (getattr(message, name, None) for name in _NUMBERS)
    number = next((n for n in numbers if n is not None), None)
    return _about(fault, message.get_type()) and fault.item in (None, number)
