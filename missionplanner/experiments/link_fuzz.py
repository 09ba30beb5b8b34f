"""Mutated MAVLink frames to the simulated vehicles and to the ground station: who breaks, grows, or obeys a stranger.

Frames are mutations of recorded traffic by what fields mean, of any other message of the dialect, and of bytes. A first
part runs under a tracer, and what reaches lines that none before did is mutated further. Frames go in batches for one
vehicle; of everybody whom no frame of a batch is for, the whole state is compared before and after.
"""

from __future__ import annotations

import math
import os
import sys
import types
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint, in_process_pair
from adapters.fleet_link import FleetLink
from adapters.ground_station import WAIT_S, Peer, Station
from adapters.mission_items import MissionItem, plan_items
from adapters.mission_protocol import OWN_COMPONENT, OWN_SYSID, MissionDownload, MissionUpload, Party
from adapters.parameter_protocol import ParametersRead
from missionplanner.errors import LinkError
from missionplanner.experiments.link_trials import fleet_plan, holds
from missionplanner.geodesy import LocalFrame
from missionplanner.vehicle import Autopilot, MotionModel
from sim.fleet import LockstepClock, SimFleet, SimVehicle, planned_vehicles, sim_vehicles
from sim.personality import Personality

Message = Any  # a pymavlink message: its classes are generated, and carry no types
Kind = Any  # such a class

_MISSION = int(mavlink.MAV_MISSION_TYPE_MISSION)
_STATION = (OWN_SYSID, int(OWN_COMPONENT))
_DELIVERED = (255, int(mavlink.MAV_COMP_ID_MISSIONPLANNER))  # what most ground stations are
_BATCH = 16
_GUIDED_SHARE = 0.02  # of the frames that run under a tracer, which makes them ten times as slow
_CORPUS_MAX = 2_000
_DAMAGED_SHARE = 0.25
_RECORDED_MAX = 40  # of every message
_ITEMS = 12
_LONGEST = 300  # bytes: no frame is longer
_SIZES = {"uint8_t": (1, False), "int8_t": (1, True), "uint16_t": (2, False), "int16_t": (2, True)} | {
    "uint32_t": (4, False),
    "int32_t": (4, True),
    "uint64_t": (8, False),
    "int64_t": (8, True),
}
_REALS = (0.0, -0.0, 1.0, -1.0, math.nan, math.inf, -math.inf, 3.4e38, 1e-45, 21196.0, 255.0, 65_536.0, 1e10, -1e10)
_COMMANDS = tuple(n for n in mavlink.enums["MAV_CMD"] if 0 < n < 65_536)
_WHOLE_DIALECT = tuple(mavlink.mavlink_map.values())
_PARTIAL = mavlink.MAVLink_mission_write_partial_list_message
_MISSION_PROTOCOL = tuple(kind for kind in _WHOLE_DIALECT if kind.msgname.startswith("MISSION_"))


@dataclass(slots=True)
class Fuzzed:
    """What came of one run of frames."""

    frames: int = 0
    heard: int = 0  # messages that were valid
    batches: int = 0  # of which somebody's state was compared
    corpus: int = 0  # frames kept since they reached new lines
    lines: int = 0  # reached under the tracer
    refusals: int = 0  # by the ground station: errors that it is to raise
    memory_mb: float = 0.0  # grown after a fifth of the frames
    faults: list[str] = field(default_factory=list)
    """What must not be: a frame that broke something, or changed somebody whom it was not for."""

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {name: getattr(self, name) for name in self.__slots__}


# --- mutation ---------------------------------------------------------------------------------------------------------


class Mutator:
    """Makes frames of recorded messages, by chance."""

    def __init__(self, recorded: Sequence[Message], rng: np.random.Generator, sysids: Sequence[int]) -> None:
        self._rng = rng
        self._sysids = (*sysids, 0, 255, 77)
        kept: dict[str, list[Message]] = {}
        for message in recorded:
            of_kind = kept.setdefault(message.get_type(), [])
            if len(of_kind) < _RECORDED_MAX:
                of_kind.append(message)
        self._corpus = [(type(m), _values(m)) for of_kind in kept.values() for m in of_kind]
        self._recorded = len(self._corpus)
        self._codecs: dict[tuple[int, int], Any] = {}

    @property
    def found(self) -> int:
        """How many messages were added to those recorded."""
        return len(self._corpus) - self._recorded

    def keep(self, kind: Kind, values: list[Any]) -> None:
        """Mutate this message from now on, too."""
        if self.found < _CORPUS_MAX:
            self._corpus.append((kind, values))

    def message(
        self, target: int, kinds: Sequence[Kind] = _WHOLE_DIALECT, *, addressed: bool = False
    ) -> tuple[Kind, list[Any]]:
        """Return a message and the values of its fields, most of them for ``target``; of a kind that has one."""
        while True:
            kind, values = self._message(target, kinds)
            if not addressed or "target_system" in kind.fieldnames:
                return kind, values

    def _message(self, target: int, kinds: Sequence[Kind]) -> tuple[Kind, list[Any]]:
        rng = self._rng
        if kinds is _WHOLE_DIALECT and self._corpus and rng.random() < 0.8:
            kind, values = self._corpus[int(rng.integers(len(self._corpus)))]
            values = list(values)
            changes = int(rng.integers(0, 4))
        else:
            kind = kinds[int(rng.integers(len(kinds)))]
            values = [self._value(kind, k) for k in range(len(kind.fieldnames))]
            changes = 0
        names: list[str] = kind.fieldnames
        for _ in range(min(changes, len(names))):
            k = int(rng.integers(len(names)))
            values[k] = self._value(kind, k)
        if "target_system" in names and rng.random() < 0.95:
            values[names.index("target_system")] = target
        if "target_component" in names and rng.random() < 0.9:
            values[names.index("target_component")] = int(rng.integers(0, 2))
        return kind, values

    def frame(
        self, kind: Kind, values: Sequence[Any], source: tuple[int, int], *, damage: float = _DAMAGED_SHARE
    ) -> bytes:
        """Return a message as a frame, now and then damaged."""
        rng = self._rng
        codec = self._codecs.get(source)
        if codec is None:
            codec = self._codecs[source] = mavlink.MAVLink(None, srcSystem=source[0], srcComponent=source[1])
        codec.seq = int(rng.integers(256))
        message = kind(*values)
        old = rng.random() < 0.05 and kind.id < 256
        data = bytearray(message.pack(codec, force_mavlink1=old))
        if rng.random() >= damage:
            return bytes(data)
        match int(rng.integers(6)):
            case 0:  # bits of the payload, with a checksum that is right
                data[_head(data) + int(rng.integers(max(len(data) - 12, 1))) % max(data[1], 1)] ^= 1 << rng.integers(8)
                return _checked(data, kind.crc_extra)
            case 1:  # bits anywhere
                for _ in range(int(rng.integers(1, 9))):
                    data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
            case 2:  # cut short
                del data[int(rng.integers(len(data))) :]
            case 3:  # another message's number
                other = _WHOLE_DIALECT[rng.integers(len(_WHOLE_DIALECT))]
                if not old:
                    data[7:10] = int(other.id).to_bytes(3, "little")
                    return _checked(data, other.crc_extra)
            case 4:  # flags that say it is signed, or something unknown
                if not old:
                    data[2] = int(rng.integers(256))
            case _:  # bytes of nobody
                data += rng.bytes(int(rng.integers(1, 300)))
        return bytes(data)

    def source(self, own: tuple[int, int]) -> tuple[int, int]:
        """Return who a frame says it is from: mostly ``own``."""
        rng = self._rng
        if rng.random() < 0.8:
            return own
        return int(self._sysids[rng.integers(len(self._sysids))]), int((0, 1, _STATION[1], 191, 154)[rng.integers(5)])

    def _value(self, kind: Kind, k: int) -> Any:
        rng, name, form = self._rng, kind.fieldnames[k], kind.fieldtypes[k]
        count = kind.array_lengths[kind.ordered_fieldnames.index(name)]
        if form == "char":
            return rng.bytes(max(count, 1)) if rng.random() < 0.5 else b"RTL_ALT"[: max(count, 1)]
        if name == "command" and count == 0:
            return int(_COMMANDS[rng.integers(len(_COMMANDS))])
        if count > 0:
            return [self._number(form) for _ in range(count)]
        if name == "mission_type" and rng.random() < 0.7:
            return _MISSION
        if name in ("seq", "count", "start_index", "end_index") and rng.random() < 0.5:
            return int(rng.integers(0, 4 * _ITEMS))
        return self._number(form)

    def _number(self, form: str) -> float | int:
        rng = self._rng
        if form in ("float", "double"):
            return float(_REALS[rng.integers(len(_REALS))] if rng.random() < 0.6 else rng.normal(0.0, 100.0))
        size, signed = _SIZES[form.removesuffix("_mavlink_version")]
        top = 1 << (8 * size)
        low, high = (-top // 2, top // 2 - 1) if signed else (0, top - 1)
        near = (0, 1, 2, 3, 255, 650, 651, 2_000, 2_001, 900_000_001, low, high, high - 1)
        value = int(near[rng.integers(len(near))]) if rng.random() < 0.7 else int.from_bytes(rng.bytes(size), "little")
        return min(max(value if value <= high else value - top, low), high)


def _values(message: Message) -> list[Any]:
    """Return the values of a message's fields as its class takes them."""
    found = []
    for name, form in zip(message.fieldnames, message.fieldtypes, strict=True):
        value = getattr(message, name)
        found.append(value.encode("utf-8", "replace") if form == "char" and isinstance(value, str) else value)
    return found


def _head(frame: bytearray) -> int:
    return 6 if frame[0] == mavlink.PROTOCOL_MARKER_V1 else 10


def _checked(frame: bytearray, extra: int) -> bytes:
    """Return a frame with the checksum that its bytes ask for."""
    end = _head(frame) + frame[1]
    digest = mavlink.x25crc(frame[1:end])
    digest.accumulate(bytes([extra]))
    frame[end : end + 2] = digest.crc.to_bytes(2, "little")
    return bytes(frame)


# --- what must not change ---------------------------------------------------------------------------------------------

_SAME_FOR_ALL = (
    types.FunctionType,
    types.MethodType,
    types.BuiltinFunctionType,
    type,
    Personality,
    LocalFrame,
    MotionModel,
)


def state(thing: object, skipped: Sequence[type] = ()) -> list[object]:
    """Return all that an object holds, however deep, as a list that compares; but no functions and no constants."""
    found: list[object] = []
    seen: set[int] = set()
    todo: list[object] = [thing]
    passed_over = (*_SAME_FOR_ALL, *skipped)
    while todo:
        here = todo.pop()
        if here is None or isinstance(here, bool | int | str | bytes | Enum):
            found.append(here)
        elif isinstance(here, float | np.generic):
            found.append(repr(here))
        elif isinstance(here, np.ndarray):
            found.append(here.tobytes())
        elif isinstance(here, passed_over) or id(here) in seen:
            continue
        elif type(here).__module__ == "sim.fleet":  # the link that somebody was heard on: which it is, counts
            found.append(id(here))
        elif isinstance(here, Mapping):
            found.append(len(here))
            todo += [part for pair in here.items() for part in pair]
        elif isinstance(here, list | tuple | deque | set | frozenset):
            found.append(len(here))
            todo += here
        else:
            seen.add(id(here))
            found.append(type(here).__name__)
            slots = (name for kind in type(here).__mro__ for name in getattr(kind, "__slots__", ()))
            todo += [getattr(here, name, None) for name in slots if name != "__dict__"]
            todo += getattr(here, "__dict__", {}).values()
    return found


class _Tracer:
    """Which lines of our packages have been reached."""

    def __init__(self) -> None:
        root = Path(__file__).parents[2]
        self._ours = tuple(str(root / package) + os.sep for package in ("sim", "adapters"))
        self.reached: set[tuple[str, int]] = set()

    def new(self, action: Callable[[], None]) -> bool:
        """Do something; return whether it reached lines that nothing before did."""
        before = len(self.reached)
        was = sys.gettrace()
        sys.settrace(self._enter)
        try:
            action()
        finally:
            sys.settrace(was)
        return len(self.reached) > before

    def _enter(self, frame: types.FrameType, event: str, _: object) -> Any:
        return self._line if event == "call" and frame.f_code.co_filename.startswith(self._ours) else None

    def _line(self, frame: types.FrameType, event: str, _: object) -> Any:
        if event == "line":
            self.reached.add((frame.f_code.co_filename, frame.f_lineno))
        return self._line


def _memory_mb() -> float:
    """Return the memory that this process holds now, 0 where the system does not say."""
    pages = Path("/proc/self/statm")
    return int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6 if pages.exists() else 0.0


class _Recorder:
    """An endpoint that remembers the messages that passed."""

    def __init__(self, inner: Endpoint) -> None:
        self._inner = inner
        self.came: list[Message] = []
        self.went: list[Message] = []
        self._parsers = [mavlink.MAVLink(None), mavlink.MAVLink(None)]

    @property
    def url(self) -> str:
        return self._inner.url

    def receive(self) -> list[tuple[bytes, Any]]:
        pieces = self._inner.receive()
        for data, _ in pieces:
            self.came += self._parsers[0].parse_buffer(data) or ()
        return pieces

    def send(self, data: bytes, peer: Any = None) -> None:
        self.went += self._parsers[1].parse_buffer(data) or ()
        self._inner.send(data, peer)

    def filenos(self) -> list[int]:
        return []

    def close(self) -> None:
        self._inner.close()


def recorded(autopilot: Autopilot) -> tuple[list[Message], list[Message]]:
    """Return what passes between ground and vehicle while a mission is uploaded and flown: to it, and from it."""
    plan = fleet_plan(1, _ITEMS, autopilot, 1)
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame)
    ground, air = in_process_pair()
    fleet.attach(air)
    pipe = _Recorder(ground)
    link = FleetLink(plan, [pipe], LockstepClock(fleet))
    link.connect()
    link.compare_parameters()
    link.upload()
    link.verify()
    link.set_returns()
    link.start()
    fleet.advance(20.0)
    link.call_off()
    return pipe.went, pipe.came


@dataclass(slots=True)
class _Run:
    """A run of so many frames, and what has come of it so far."""

    frames: int
    result: Fuzzed = field(default_factory=Fuzzed)
    tracer: _Tracer = field(default_factory=_Tracer)
    settled_mb: float = 0.0  # after a fifth of the frames

    @property
    def next_batch(self) -> int:
        """How many frames go together: one, while a tracer tells which reach new lines."""
        return 1 if self.result.frames < int(_GUIDED_SHARE * self.frames) else _BATCH

    def count(self, frames: int, heard: int, *, compared: bool) -> None:
        """Count a batch that did no harm."""
        result = self.result
        result.frames += frames
        result.heard += heard
        result.batches += compared
        if self.settled_mb == 0.0 and result.frames > self.frames // 5:
            self.settled_mb = _memory_mb()

    def ended(self, mutator: Mutator) -> dict[str, Any]:
        """Return the result as plain JSON values."""
        self.result.memory_mb = _memory_mb() - self.settled_mb if self.settled_mb else 0.0
        self.result.corpus, self.result.lines = mutator.found, len(self.tracer.reached)
        return self.result.as_json()


# --- to the vehicles --------------------------------------------------------------------------------------------------


def vehicles(frames: int, seed: int) -> dict[str, Any]:
    """Send frames to three vehicles on two links, while they fly or do what else the frames tell them."""
    rng = np.random.default_rng(seed)
    kinds: tuple[tuple[Autopilot, str], ...] = (("ardupilot", "copter"), ("px4", "copter"), ("ardupilot", "plane"))
    fleet = SimFleet(_mixed(kinds), seed=seed)
    pipes: list[Endpoint] = []
    for _ in range(2):
        ground, air = in_process_pair(f"pipe-{len(pipes)}")
        fleet.attach(air)
        pipes.append(ground)
    sysids = [v.sysid for v in fleet.vehicles]
    traffic = [m for autopilot in ("ardupilot", "px4") for m in recorded(autopilot)[0]]
    mutator = Mutator(traffic, rng, sysids)
    parsers = [_parser() for _ in pipes]
    run = _Run(frames)
    result, tracer = run.result, run.tracer
    while result.frames < frames:
        size = run.next_batch
        target = int((*sysids, *sysids, 0, 77)[rng.integers(2 * len(sysids) + 2)])
        k = int(rng.integers(len(pipes)))
        addressed = rng.random() < 0.75
        made = [mutator.message(target, addressed=addressed) for _ in range(size)]
        pieces = [mutator.frame(kind, values, mutator.source(_STATION)) for kind, values in made]
        heard = [m for piece in pieces for m in parsers[k].parse_buffer(piece) or () if m.get_type() != "BAD_DATA"]
        others = [i for i, sysid in enumerate(sysids) if not any(_is_for(m, sysid) for m in heard)]
        before = {i: _vehicle_state(fleet, i) for i in others}
        try:
            if size == 1:
                if tracer.new(lambda: _fed(pipes[k], pieces, fleet)):  # noqa: B023
                    mutator.keep(*made[0])
            else:
                _fed(pipes[k], pieces, fleet)
        except Exception as error:  # whatever it is, it is a find
            result.faults.append(f"{type(error).__name__}: {error}: {_hex(pieces)}")
            break
        changed = [sysids[i] for i in others if _vehicle_state(fleet, i) != before[i]]
        if changed:
            result.faults.append(f"vehicle {changed} changed by frames for others: {_hex(pieces)}")
            break
        fleet.step()
        for pipe in pipes:
            pipe.receive()
        run.count(size, len(heard), compared=bool(others))
    return run.ended(mutator)


def _mixed(kinds: Iterable[tuple[Autopilot, Any]]) -> list[SimVehicle]:
    home = fleet_plan(1, _ITEMS, "px4", 1).frame.geo_point([0.0, 0.0, 1_000.0])
    return [
        SimVehicle(sysid, *kind, place.home, sim_vehicles(1, home, autopilot=kind[0], vehicle_class=kind[1])[0].motion)
        for sysid, (kind, place) in enumerate(zip(kinds, sim_vehicles(3, home), strict=True), start=1)
    ]


def _fed(pipe: Endpoint, pieces: Sequence[bytes], fleet: SimFleet) -> None:
    for piece in pieces:
        pipe.send(piece)
    fleet.poll()


def _is_for(message: Message, sysid: int) -> bool:
    """Return whether a message is for a vehicle's autopilot; one without a target is for everybody."""
    if "target_system" not in message.fieldnames:
        return True
    component = getattr(message, "target_component", 0)
    return message.target_system in (0, sysid) and component in (0, mavlink.MAV_COMP_ID_AUTOPILOT1)


def _vehicle_state(fleet: SimFleet, i: int) -> list[object]:
    navigator = fleet.navigator  # its routes are stored together, and take more room for all when one is longer
    row = [getattr(navigator, name)[i] for name in ("position_m", "velocity_m_s", "waypoint", "finished")]
    return [*state(fleet.links[i], (type(navigator),)), *state(row)]


def _parser() -> Any:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    return parser


def _hex(pieces: Sequence[bytes]) -> str:
    return " ".join(piece.hex() for piece in pieces)


# --- to the ground station --------------------------------------------------------------------------------------------


def ground_station(frames: int, seed: int) -> dict[str, Any]:
    """Send frames to a ground station that talks with two vehicles, each on a link of its own, about everything."""
    rng = np.random.default_rng(seed)
    sysids: dict[int, Autopilot] = {1: "ardupilot", 2: "px4"}
    pipes = {sysid: in_process_pair(f"pipe-{sysid}") for sysid in sysids}
    peers = {sysid: Peer(Party(f"uav{sysid}", sysid)) for sysid in sysids}
    clock = _Hand()
    station = Station(peers, [near for near, _ in pipes.values()], clock, None)
    traffic = [m for autopilot in sysids.values() for m in recorded(autopilot)[1]]
    mutator = Mutator(traffic, rng, list(sysids))
    run = _Run(frames)
    result, tracer = run.result, run.tracer
    plans = {sysid: fleet_plan(1, _ITEMS, autopilot, 1) for sysid, autopilot in sysids.items()}
    items = {sysid: plan_items(plan.vehicles[0], plan.frame) for sysid, plan in plans.items()}
    while result.frames < frames:
        size = run.next_batch
        speaker = int(rng.integers(1, 3))
        for sysid, peer in peers.items():
            result.refusals += _kept_busy(station, peer, sysids[sysid], items[sysid])
        made = [mutator.message(255) for _ in range(size)]
        own = (speaker, 1)
        pieces = [
            mutator.frame(kind, values, own if rng.random() < 0.8 else mutator.source(own)) for kind, values in made
        ]
        parser = _parser()
        # what a damaged frame has begun ends here, in our parser as in that of the link
        pieces.append(bytes(_LONGEST))
        heard = [m for piece in pieces for m in parser.parse_buffer(piece) or () if m.get_type() != "BAD_DATA"]
        others = [sysid for sysid in sysids if not any(m.get_srcSystem() == sysid for m in heard)]
        before = {sysid: state(peers[sysid]) for sysid in others}

        def feed() -> None:
            for piece in pieces:  # noqa: B023
                pipes[speaker][1].send(piece)  # noqa: B023
            try:
                station.exchange()
            except LinkError:
                result.refusals += 1

        try:
            if size == 1:
                if tracer.new(feed):
                    mutator.keep(*made[0])
            else:
                feed()
        except Exception as error:  # whatever it is, it is a find
            result.faults.append(f"{type(error).__name__}: {error}: {_hex(pieces)}")
            break
        changed = [sysid for sysid in others if state(peers[sysid]) != before[sysid]]
        if changed:
            result.faults.append(f"talk with vehicle {changed} changed by frames of others: {_hex(pieces)}")
            break
        for _, far in pipes.values():
            far.receive()
        clock.time_s += 0.05
        run.count(size, len(heard), compared=bool(others))
    return run.ended(mutator)


class _Hand:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        return self.time_s

    def wait(self, seconds: float) -> None:
        self.time_s += seconds


def _kept_busy(station: Station[Peer], peer: Peer, autopilot: Autopilot, items: Sequence[MissionItem]) -> int:
    """Go on with an upload, a download and a reading, and begin them anew when they are over; count those refused."""
    refused = 0
    upload = peer.uploads.get(_MISSION)
    if upload is None or upload.done:
        peer.uploads[_MISSION] = MissionUpload(peer.party, autopilot, items)
    if peer.download is None or peer.download.done:
        peer.download = MissionDownload(peer.party)
    if peer.parameter is None or peer.parameter.done:
        peer.parameter = ParametersRead(peer.party, autopilot, [("RTL_ALT",), ("WPNAV_SPEED",), ("MPC_XY_CRUISE",)])
    for talk in (*peer.uploads.values(), peer.download, peer.parameter):
        try:
            peer.check_transfer()
            station.send(peer, talk.poll(station.clock.now_s()))
        except LinkError:  # it was refused, has given up, or was never heard
            peer.uploads.clear()
            peer.download = peer.parameter = None
            refused += 1
    return refused


# --- a second ground station ------------------------------------------------------------------------------------------


def spoofed_uploads(uploads: int, frames_each: int, seed: int) -> dict[str, Any]:
    """Upload while a second station talks about missions to the vehicle, and poses as a vehicle to us; none may suffer.

    The second station has another sysid, or ours with another component, as ground stations as delivered have. What
    the vehicle holds when it says that it has taken the mission is what was sent, and our upload ends well.

    MISSION_WRITE_PARTIAL_LIST is not among what it says to ArduPilot, which lets anybody into an upload by it: against
    that only the read-back helps.
    """
    rng = np.random.default_rng(seed)
    faults: list[str] = []
    sent_frames = 0
    for n in range(uploads):
        autopilot: Autopilot = "px4" if n % 2 else "ardupilot"
        plan = fleet_plan(1, 4 * _ITEMS, autopilot, seed + n)
        items = plan_items(plan.vehicles[0], plan.frame)
        fleet = SimFleet(planned_vehicles(plan), frame=plan.frame, seed=n)
        ground, air = in_process_pair("ours")
        other, other_air = in_process_pair("theirs")
        fleet.attach(other_air)  # heard first: what comes after our last item may change the mission again
        fleet.attach(air)
        posing = ((254, 190), _DELIVERED, (255, 191), (1, 191))[n // 2 % 4]
        says = tuple(k for k in _MISSION_PROTOCOL if autopilot == "px4" or k is not _PARTIAL)
        mutator = Mutator([], rng, [1])
        peer = Peer(Party("uav1", 1))
        station = Station({1: peer}, [ground], clock := LockstepClock(fleet), None)
        station.settle(1.5)
        upload = peer.uploads[_MISSION] = MissionUpload(peer.party, autopilot, items)
        station.send(peer, upload.poll(clock.now_s()))
        fleet.poll()  # it has begun
        try:
            while True:
                station.exchange()
                peer.check_transfer()
                if upload.done:
                    break
                messages = upload.poll(clock.now_s())
                if any(isinstance(message, mavlink.MAVLink_mission_count_message) for message in messages):
                    raise peer.error("the upload was ended, and begun anew")
                station.send(peer, messages)
                for _ in range(frames_each):
                    other.send(mutator.frame(*mutator.message(1, says), posing))
                    # to us, as from a stranger on our own link
                    stranger = (posing[0] % 254 + 100, 1)
                    message = mutator.message(255, _MISSION_PROTOCOL)
                    air.send(mutator.frame(*message, stranger, damage=0.0))  # damaged, it would cost us ours
                    sent_frames += 2
                clock.wait(WAIT_S)
        except LinkError as error:
            faults.append(f"{autopilot}, posing as {posing}: {error}")
            continue
        if not holds(items, fleet.links[0].missions.items(), autopilot):
            faults.append(f"{autopilot}, posing as {posing}: holds another mission than was sent")
    return {"uploads": uploads, "frames": sent_frames, "faults": faults}
