"""Parameters of one vehicle, read and set, as state machines: messages and time in, messages out; no sockets.

The rules (https://mavlink.io/en/services/parameter.html, and what real autopilots make of them):

1. A vehicle is silent about a parameter that it does not have; only the newest firmware answers PARAM_ERROR. A lossy
   link is silent too. So silence proves an absence only where another parameter, a witness that is known to be there
   and asked for right behind it, was answered again and again meanwhile.
2. A parameter is read before it is set: only the vehicle knows the type it stores, PX4 refuses any other, and ArduPilot
   says nothing to a PARAM_SET that changes nothing.
3. PARAM_SET is answered by PARAM_VALUE with what is stored now. That answer may be lost, so a repeated PARAM_SET comes
   with a request to read; values from before the set may still arrive, so only one that stays different is a refusal.
4. Integers travel as numbers (ArduPilot) or by their bytes (PX4) in the same 32-bit float.
5. Only the target's autopilot counts. PARAM_VALUE is addressed to nobody: an answer to another ground station is as
   true as one to us.
6. Many may be asked for at once, but no more than a vehicle queues (ArduPilot: 20; what comes beyond is lost in
   silence). PARAM_REQUEST_LIST is answered by a stream of all; what is lost of it is asked for by index.
"""

from __future__ import annotations

import itertools
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import to_float32
from adapters.mission_protocol import AUTOPILOT_COMPONENT, Party
from missionplanner.errors import LinkError
from missionplanner.vehicle import Autopilot

Message = Any  # a pymavlink message: its classes are generated, and carry no types

_RETRY_S = 0.7
_PATIENCE_S = 14.0  # 20 tries: at 40 % loss each way, one read in 7,000 is given up
_WITNESSED_PATIENCE_S = 60.0
_WITNESSES = 12  # answers about the witness that prove an absence: at 40 % loss, wrong once in 10^6
_BY_NAME = -1  # instead of an index
_AT_ONCE = 16  # requests: ArduPilot queues 20
_STREAM_SILENCE_S = 1.5  # after which a stream of parameters has ended, or never begun
_NO_INDEX = 65_535  # of what is no part of the list: PX4's hash of it, ArduPilot's answers by name

_REAL32 = int(mavlink.MAV_PARAM_TYPE_REAL32)
_INTEGERS: dict[int, str] = {
    mavlink.MAV_PARAM_TYPE_UINT8: "B",
    mavlink.MAV_PARAM_TYPE_INT8: "b",
    mavlink.MAV_PARAM_TYPE_UINT16: "H",
    mavlink.MAV_PARAM_TYPE_INT16: "h",
    mavlink.MAV_PARAM_TYPE_UINT32: "I",
    mavlink.MAV_PARAM_TYPE_INT32: "i",
}
_REFUSALS: dict[int, str] = {
    mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE: "out of its range",
    mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED: "not permitted",
    mavlink.MAV_PARAM_ERROR_READ_ONLY: "read-only",
}


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """A parameter as the vehicle holds it: ``kind`` is its MAV_PARAM_TYPE."""

    name: str
    value: float
    kind: int


def to_wire(value: float, kind: int, autopilot: Autopilot) -> float:
    """Return what stands in the ``param_value`` field for a value of a type.

    Raises
    ------
    ValueError
        The type cannot hold the value, or the field cannot carry it: a fraction, beyond the type's range, an integer
        that single precision rounds (ArduPilot) or whose bytes are a signalling NaN (PX4).
    """
    if kind == _REAL32:
        return to_float32(value)
    code = _INTEGERS.get(kind)
    if code is None:
        raise ValueError(f"unknown parameter type {kind}")
    if not math.isfinite(value) or value != int(value):
        raise ValueError("not a whole number")
    try:
        data = struct.pack(f"<{code}", int(value))
    except struct.error:
        raise ValueError("beyond the range of its type") from None
    wire = struct.unpack("<f", data.ljust(4, b"\0"))[0] if autopilot == "px4" else to_float32(value)
    if from_wire(wire, kind, autopilot) != value:
        raise ValueError("not exactly carried by MAVLink")
    return float(wire)


def from_wire(wire: float, kind: int, autopilot: Autopilot) -> float:
    """Return the value that a ``param_value`` field means; NaN where it means none.

    Raises
    ------
    ValueError
        An unknown type.
    """
    if kind == _REAL32:
        return to_float32(wire)
    code = _INTEGERS.get(kind)
    if code is None:
        raise ValueError(f"unknown parameter type {kind}")
    if autopilot == "px4":
        return float(struct.unpack_from(f"<{code}", struct.pack("<f", wire))[0])
    return float(wire) if math.isfinite(wire) and wire == round(wire) else math.nan


def is_integer(kind: int) -> bool:
    """Return whether a MAV_PARAM_TYPE holds whole numbers only."""
    return kind in _INTEGERS


class ParameterRead:
    """One parameter, asked for by name until it is answered.

    ``names`` are what different firmware calls it: the first that is answered is it, and becomes ``held``. With a
    ``witness`` it need not exist: ``held`` stays None once its absence is proven.
    """

    def __init__(
        self,
        party: Party,
        autopilot: Autopilot,
        names: Sequence[str],
        *,
        witness: str | None = None,
        retry_s: float = _RETRY_S,
        patience_s: float | None = None,
    ) -> None:
        self.held: ParameterValue | None = None
        self.done = False
        self._party = party
        self._autopilot = autopilot
        self._names = tuple(names)
        self._witness = witness
        self._retry_s = retry_s
        self._patience_s = patience_s or (_PATIENCE_S if witness is None else _WITNESSED_PATIENCE_S)
        self._unknown: set[str] = set()
        self._witnessed = 0
        self._witness_due = False
        self._tries = 0
        self._due_s = -math.inf
        self._give_up_s = math.inf
        self._refusal: LinkError | None = None

    def poll(self, now_s: float) -> list[Message]:
        """Ask at the first call, then again when it is time.

        Raises
        ------
        LinkError
            No answer, the parameter does not exist, or its type is unknown.
        """
        if self._refusal is not None:
            raise self._refusal
        if self.done or now_s < self._due_s:
            return []
        if self._tries == 0:
            self._give_up_s = now_s + self._patience_s
        elif now_s >= self._give_up_s:
            raise self._party.error(
                f"expected parameter {self._called}, got no answer to {self._tries} requests: "
                "its firmware does not have it, or the link is bad"
            )
        self._tries += 1
        self._due_s = now_s + self._retry_s
        self._witness_due = self._witness is not None
        asked = [*self._names, *([self._witness] if self._witness else [])]
        return [read_message(self._party, name) for name in asked]

    def receive(self, message: Message, now_s: float) -> None:
        """Take one message from anywhere; the vehicle's word on this parameter counts."""
        del now_s
        if self.done or self._tries == 0 or not _speaks(self._party, message):
            return
        name = parameter_name(message)
        if message.get_type() == "PARAM_ERROR":
            self._failed(name, message.error)
        elif name in self._names:
            try:
                value = from_wire(message.param_value, message.param_type, self._autopilot)
            except ValueError as error:
                self._refusal = self._party.error(f"parameter {name}: {error}")
                return
            self.held = ParameterValue(name, value, int(message.param_type))
            self.done = True
        elif name == self._witness and self._witness_due:
            self._witness_due = False  # one for each time that was asked, however often it is doubled
            self._witnessed += 1
            self.done = self._witnessed >= _WITNESSES

    def _failed(self, name: str, error: int) -> None:
        if name not in self._names or error != mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST:
            return
        self._unknown.add(name)
        if self._unknown >= set(self._names):
            if self._witness is None:
                self._refusal = self._party.error(f"expected parameter {self._called}, its firmware does not have it")
            else:
                self.done = True

    @property
    def _called(self) -> str:
        return " or ".join(self._names)


class ParametersRead:
    """Many parameters, asked for by name, several at once, until each is answered or proven to be absent.

    ``groups`` has for each what different firmware calls it: the first that is answered is it. ``held`` then has them
    in that order, None where there is none. The first to be answered is the witness for the absence of others.
    """

    def __init__(
        self,
        party: Party,
        autopilot: Autopilot,
        groups: Sequence[Sequence[str]],
        *,
        retry_s: float = _RETRY_S,
        patience_s: float = _PATIENCE_S,
    ) -> None:
        self.held: list[ParameterValue | None] = [None] * len(groups)
        self._party = party
        self._autopilot = autopilot
        self._groups = [tuple(names) for names in groups]
        self._place = {name: k for k, names in enumerate(self._groups) for name in names}
        self._open = list(range(len(groups)))  # in the order in which they are asked for
        self._asked: list[int] = []
        self._unknown: set[str] = set()
        self._witness: str | None = None
        self._witness_due = False
        self._witnessed = [0] * len(groups)
        self._retry_s = retry_s
        self._patience_s = patience_s
        self._due_s = -math.inf
        self._give_up_s = math.inf
        self._refusal: LinkError | None = None

    @property
    def done(self) -> bool:
        """Whether nothing is open."""
        return not self._open

    def poll(self, now_s: float) -> list[Message]:
        """Ask for the next few once those asked for are answered, and again for others when it is time.

        Raises
        ------
        LinkError
            No answers any more, or a type that is unknown.
        """
        if self._refusal is not None:
            raise self._refusal
        if self.done or now_s < self._due_s:
            return []
        if not self._asked:
            self._give_up_s = now_s + self._patience_s
        elif now_s >= self._give_up_s:
            names = " or ".join(self._groups[self._open[0]])
            raise self._party.error(f"expected parameter {names}, got no answer any more: the link is bad")
        self._due_s = now_s + self._retry_s
        # those asked for in vain go to the end of the line
        self._open.sort(key=self._asked.__contains__)
        names_asked: list[str] = []
        self._asked = []
        for k in self._open:
            if len(names_asked) + len(self._groups[k]) >= _AT_ONCE:
                break
            names_asked += self._groups[k]
            self._asked.append(k)
        if self._witness is not None:
            names_asked.append(self._witness)
            self._witness_due = True
        return [read_message(self._party, name) for name in names_asked]

    def receive(self, message: Message, now_s: float) -> None:
        """Take one message from anywhere; the vehicle's word on these parameters counts."""
        if self.done or not self._asked or not _speaks(self._party, message):
            return
        name = parameter_name(message)
        k = self._place.get(name)
        if k is None:
            return
        if message.get_type() == "PARAM_ERROR":
            if message.error == mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST:
                self._unknown.add(name)
                if self._unknown.issuperset(self._groups[k]):
                    self._close(k)
        elif k in self._open:
            try:
                value = from_wire(message.param_value, message.param_type, self._autopilot)
            except ValueError as error:
                self._refusal = self._party.error(f"parameter {name}: {error}")
                return
            self.held[k] = ParameterValue(name, value, int(message.param_type))
            self._witness = self._witness or name
            self._give_up_s = now_s + self._patience_s
            self._close(k)
        elif name == self._witness and self._witness_due:
            self._witness_due = False  # one for each time that was asked, however often it is doubled
            self._give_up_s = now_s + self._patience_s
            self._due_s = -math.inf
            for k in [k for k in self._open if k in self._asked]:
                self._witnessed[k] += 1
                if self._witnessed[k] >= _WITNESSES:
                    self._close(k)

    def _close(self, k: int) -> None:
        if k in self._open:
            self._open.remove(k)
        if not set(self._asked).intersection(self._open):
            self._due_s = -math.inf


class ParameterList:
    """All parameters of a vehicle: ``held`` has them by name once ``done``, ``total`` how many there are."""

    def __init__(
        self,
        party: Party,
        autopilot: Autopilot,
        *,
        silence_s: float = _STREAM_SILENCE_S,
        patience_s: float = _PATIENCE_S,
    ) -> None:
        self.held: dict[str, ParameterValue] = {}
        self.total: int | None = None
        self._party = party
        self._autopilot = autopilot
        self._silence_s = silence_s
        self._patience_s = patience_s
        self._read: set[int] = set()
        self._asked: list[int] = []
        self._due_s = -math.inf
        self._give_up_s: float | None = None
        self._refusal: LinkError | None = None

    @property
    def done(self) -> bool:
        """Whether none is missing."""
        return self.total is not None and len(self._read) >= self.total

    @property
    def read(self) -> int:
        """How many have come."""
        return len(self._read)

    def poll(self, now_s: float) -> list[Message]:
        """Ask for the stream; once it has ended, for what is missing of it.

        Raises
        ------
        LinkError
            No answers any more, or a type that is unknown.
        """
        if self._refusal is not None:
            raise self._refusal
        if self.done or now_s < self._due_s:
            return []
        if self._give_up_s is None:
            self._give_up_s = now_s + self._patience_s
        elif now_s >= self._give_up_s:
            got = "none" if self.total is None else f"{self.read} of {self.total}"
            raise self._party.error(f"expected all its parameters, got {got}: the link is bad")
        self._due_s = now_s + self._silence_s
        party = self._party
        if self.total is None:
            return [mavlink.MAVLink_param_request_list_message(party.sysid, AUTOPILOT_COMPONENT)]
        self._asked = list(itertools.islice((k for k in range(self.total) if k not in self._read), _AT_ONCE))
        component = AUTOPILOT_COMPONENT
        return [mavlink.MAVLink_param_request_read_message(party.sysid, component, b"", k) for k in self._asked]

    def receive(self, message: Message, now_s: float) -> None:
        """Take one message from anywhere; the vehicle's parameters count."""
        if self.done or self._give_up_s is None or not _speaks(self._party, message):
            return
        if message.get_type() != "PARAM_VALUE" or message.param_index == _NO_INDEX:
            return
        name = parameter_name(message)
        try:
            value = from_wire(message.param_value, message.param_type, self._autopilot)
        except ValueError as error:
            self._refusal = self._party.error(f"parameter {name}: {error}")
            return
        self.held[name] = ParameterValue(name, value, int(message.param_type))
        self.total = int(message.param_count)
        self._read.add(int(message.param_index))
        self._give_up_s = now_s + self._patience_s
        self._due_s = -math.inf if self._asked and self._read.issuperset(self._asked) else now_s + self._silence_s


class ParameterSet:
    """One parameter, set until the vehicle says that it holds the value.

    ``held`` is it as read before; ``value`` must be one that its type can hold, see :func:`to_wire`.
    """

    def __init__(
        self,
        party: Party,
        autopilot: Autopilot,
        held: ParameterValue,
        value: float,
        *,
        retry_s: float = _RETRY_S,
        patience_s: float = _PATIENCE_S,
    ) -> None:
        self.done = False
        self._party = party
        self._autopilot = autopilot
        self._held = held
        self._wire = to_wire(value, held.kind, autopilot)
        self._value = from_wire(self._wire, held.kind, autopilot)
        self._read: float | None = None
        self._retry_s = retry_s
        self._patience_s = patience_s
        self._tries = 0
        self._due_s = -math.inf
        self._give_up_s = math.inf
        self._refusal: LinkError | None = None

    def poll(self, now_s: float) -> list[Message]:
        """Send at the first call, then again when it is time.

        Raises
        ------
        LinkError
            No answer, or the vehicle holds another value in the end.
        """
        if self._refusal is not None:
            raise self._refusal
        if self.done or now_s < self._due_s:
            return []
        if self._tries == 0:
            self._give_up_s = now_s + self._patience_s
        elif now_s >= self._give_up_s:
            raise self._failure()
        name = self._held.name
        messages = [set_message(self._party, name, self._wire, self._held.kind)]
        if self._tries > 0:
            messages.append(read_message(self._party, name))
        self._tries += 1
        self._due_s = now_s + self._retry_s
        return messages

    def receive(self, message: Message, now_s: float) -> None:
        """Take one message from anywhere; the vehicle's word on this parameter counts."""
        del now_s
        if self.done or self._tries == 0 or not _speaks(self._party, message):
            return
        if parameter_name(message) != self._held.name:
            return
        if message.get_type() == "PARAM_ERROR":
            reason = _REFUSALS.get(message.error)
            if reason is not None:
                self._refusal = self._party.error(
                    f"parameter {self._held.name}: refused {self._value:g} ({reason}); it holds {self._held.value:g}"
                )
        elif message.param_type == self._held.kind:
            self._read = from_wire(message.param_value, self._held.kind, self._autopilot)
            self.done = self._read == self._value

    def _failure(self) -> LinkError:
        name = self._held.name
        if self._read is None:
            return self._party.error(
                f"parameter {name}: expected an answer to PARAM_SET, got none to {self._tries}; it may hold "
                f"{self._held.value:g} or {self._value:g}: check the link"
            )
        return mismatch(self._party, name, self._value, self._read)


def mismatch(party: Party, name: str, sent: float, read: float) -> LinkError:
    """Return the error of a vehicle that does not hold a parameter as it was set."""
    return party.error(f"parameter {name}: sent {sent:g}, the vehicle holds {read:g}")


def read_message(party: Party, name: str) -> Message:
    """Return a PARAM_REQUEST_READ by name."""
    return mavlink.MAVLink_param_request_read_message(party.sysid, AUTOPILOT_COMPONENT, name.encode(), _BY_NAME)


def set_message(party: Party, name: str, wire: float, kind: int) -> Message:
    """Return a PARAM_SET of a value as :func:`to_wire` has it."""
    return mavlink.MAVLink_param_set_message(party.sysid, AUTOPILOT_COMPONENT, name.encode(), wire, kind)


def parameter_name(message: Message) -> str:
    """Return the name that a message about a parameter carries; 16 characters come without an end mark."""
    name = message.param_id
    text = name.decode("ascii", "replace") if isinstance(name, bytes) else str(name)
    return text.split("\0", 1)[0]


def _speaks(party: Party, message: Message) -> bool:
    """Return whether a message is the vehicle's, about a parameter, and not a refusal of somebody else's wish."""
    kind = message.get_type()
    return bool(
        kind in ("PARAM_VALUE", "PARAM_ERROR")
        and message.get_srcSystem() == party.sysid
        and message.get_srcComponent() == AUTOPILOT_COMPONENT
        and (kind == "PARAM_VALUE" or message.target_system in (0, party.own_sysid))
    )
