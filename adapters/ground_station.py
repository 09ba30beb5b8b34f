"""A ground station's talk with many vehicles, side by side: everything waits without blocking, timed by a clock.

What goes on with a vehicle is a generator that yields whenever it waits; :meth:`Station.together` runs them all. Each
holds at most one of every kind of exchange (transfer, command, parameter) with its vehicle, which takes in the answers.
"""

from __future__ import annotations

import select
import time
from collections import deque
from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar, cast

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.command_protocol import Command, command_name
from adapters.endpoint import Endpoint
from adapters.mission_items import MissionItem
from adapters.mission_protocol import Mismatch, MissionDownload, MissionUpload, Party, mismatches, what_is_sent
from adapters.parameter_protocol import ParameterList, ParameterRead, ParameterSet, ParametersRead, ParameterValue
from adapters.pymavlink_link import PymavlinkLink
from adapters.return_settings import Setting
from adapters.signing import SignedEndpoint
from adapters.telemetry_log import FleetLog
from missionplanner.errors import LinkError
from missionplanner.vehicle import Autopilot, VehicleClass

Message = Any  # a pymavlink message: its classes are generated, and carry no types
Result = TypeVar("Result")
Waiting = Generator[None, None, Result]  # something that goes on over time: yields until its next look at the world
Steps = Waiting[None]
TransferProgress = Callable[[str, int, int], None]
"""Called with a vehicle's name, its items transferred and the count of them."""


def telling(progress: TransferProgress | None, vehicle: str) -> Callable[[int, int | None], None]:
    """Return what tells of one vehicle's transfer, once the count of items is known."""

    def tell(done: int, total: int | None) -> None:
        if progress is not None and total is not None:
            progress(vehicle, done, total)

    return tell


class Clock(Protocol):
    """The time by which a fleet is flown: the wall's, or a simulator's that only runs while somebody waits."""

    def now_s(self) -> float:
        """Return seconds since some fixed instant; never falls."""
        ...

    def wait(self, seconds: float) -> None:
        """Let at most that time pass; may return as soon as something has arrived."""
        ...


class WallClock:
    """Real time; waiting ends early when one of the endpoints has something to read."""

    def __init__(self, endpoints: Sequence[Endpoint]) -> None:
        self._endpoints = endpoints
        self._start_s = time.monotonic()

    def now_s(self) -> float:
        """Return seconds since the clock was made."""
        return time.monotonic() - self._start_s

    def wait(self, seconds: float) -> None:
        """Sleep until something arrives, at most ``seconds``."""
        descriptors = [fd for endpoint in self._endpoints for fd in endpoint.filenos()]
        if descriptors:
            select.select(descriptors, [], [], max(seconds, 0.0))
        else:
            time.sleep(max(seconds, 0.0))


WAIT_S = 0.05
_SIGNED = 0x01  # of a header's incompat_flags
_UPLOADS = 3  # of what was not confirmed, and reads back otherwise
_READ_AHEAD = 5  # items of ArduPilot asked for at once, as MAVProxy does
_VERSIONS_LOST = 12  # at most, though they were promised
_IDENTIFY_S = 15.0  # for an answer: 40 % of loss each way leave one in 10,000 unanswered
_CONTRADICTIONS = 3  # between numbers of frames and how many arrive
_STRETCH_MAX = 100  # frames: whoever loses more than every second one contradicts nothing
_SETBACK_MS = 5_000  # no link holds a message for so long while it lets later ones through
_TWO = "give each vehicle its own sysid (ArduPilot SYSID_THISMAV, PX4 MAV_SYS_ID)"
LISTEN_S = 2.5  # two heartbeats: long enough to hear a second vehicle with the same sysid
ANSWER_S = 7.0
_SHOWN_S = 3.0  # from an answer to a heartbeat that shows what was answered; they come every second
VERSION_S = 1.0  # from the answer to a request for AUTOPILOT_VERSION to that message

_AUTOPILOTS: dict[int, Autopilot] = {
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot",
    mavlink.MAV_AUTOPILOT_PX4: "px4",
}
_COPTERS = frozenset({2, 3, 4, 13, 14, 15, 29, 35})  # MAV_TYPE: multirotors, coaxial and helicopters
_PLANES = frozenset({1, *range(19, 26)})  # fixed wing and VTOL


class _Numbering:
    """Whether a vehicle's frames bear the numbers of one sender.

    Of one sender, no more frames arrive between two heartbeats than it has numbered meanwhile, but for a few that were
    overtaken. Numbers begin anew after 256: so nothing is said of longer stretches, and one contradiction is none: a
    link that was down for long makes one, too.
    """

    def __init__(self) -> None:
        self._count = 0
        self._beats: deque[tuple[int, int]] = deque(maxlen=3)  # number and count at the last heartbeats
        self._recent: deque[bytes] = deque(maxlen=256)  # a frame that comes on two ways counts once
        self._contradictions = 0

    @property
    def of_two(self) -> bool:
        """Whether two senders number their frames by turns."""
        return self._contradictions >= _CONTRADICTIONS

    def hear(self, message: Message) -> None:
        """Take note of a frame."""
        frame = bytes(message.get_msgbuf())
        if frame in self._recent:
            return
        self._recent.append(frame)
        self._count += 1
        if message.get_type() != "HEARTBEAT":
            return
        self._beats.append((message.get_seq(), self._count))
        if len(self._beats) == self._beats.maxlen:  # two senders beat by turns
            (number, count), _, (last_number, last_count) = self._beats
            arrived, numbered = last_count - count, (last_number - number) % 256
            self._contradictions += arrived < _STRETCH_MAX and arrived > 1.4 * numbered + 3


class Peer:
    """What is heard of one vehicle, and the exchanges that go on with it."""

    def __init__(self, party: Party) -> None:
        self.party = party
        self.heartbeat: Message | None = None
        self.uploads: dict[
            int, MissionUpload
        ] = {}  # by what was sent; served on when done, if its last words were lost
        self.download: MissionDownload | None = None
        self.command: Command | None = None
        self.last_command: Command | None = None
        self.heartbeats = 0  # heard
        self.parameter: ParameterRead | ParametersRead | ParameterList | ParameterSet | None = None
        self.told_version = False
        self.unique_ids: set[str] = set()  # as it has told, in hexadecimal digits
        self._refusal: LinkError | None = None
        self._boot_ms = 0
        self._setbacks = 0  # of its clock
        self._numbering: _Numbering | None = _Numbering()  # until it is known to be alone

    @property
    def signs(self) -> bool:
        """Whether its last heartbeat was signed, with whatever key."""
        return self.heartbeat is not None and bool(self.heartbeat.get_header().incompat_flags & _SIGNED)

    @property
    def armed(self) -> bool:
        """Whether its motors may turn, by its last heartbeat."""
        return self.heartbeat is not None and bool(self.heartbeat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def autopilot(self) -> Autopilot | str:
        """What steers it: an autopilot that we know, else a description of it."""
        assert self.heartbeat is not None
        number = self.heartbeat.autopilot
        return _AUTOPILOTS.get(number, f"autopilot {number}")

    @property
    def vehicle_class(self) -> VehicleClass | str:
        """What it is: a class that we know, else a description of it."""
        assert self.heartbeat is not None
        kind = self.heartbeat.type
        return "copter" if kind in _COPTERS else "plane" if kind in _PLANES else f"MAV_TYPE {kind}"

    def known_kind(self) -> tuple[Autopilot, VehicleClass]:
        """Return what steers it and what it is.

        Raises
        ------
        LinkError
            One of them is none of ours.
        """
        autopilot, vehicle_class = self.autopilot, self.vehicle_class
        if autopilot not in ("ardupilot", "px4") or vehicle_class not in ("copter", "plane"):
            raise self.error(
                f"expected a copter or plane of ArduPilot or PX4, got {autopilot}, {vehicle_class}: it is not checked"
            )
        return cast("Autopilot", autopilot), cast("VehicleClass", vehicle_class)

    def error(self, text: str) -> LinkError:
        """Return an error that names the vehicle."""
        return self.party.error(text)

    def receive(self, message: Message, now_s: float) -> list[Message]:
        """Take one message of this vehicle and return what to answer."""
        if self._numbering is not None:
            self._numbering.hear(message)
        if message.get_type() == "HEARTBEAT":
            self.heartbeat = message
            self.heartbeats += 1
        if message.get_type() == "AUTOPILOT_VERSION":
            self.told_version = True
            self.unique_ids |= _unique_ids(message)
        boot_ms = getattr(message, "time_boot_ms", None)
        if boot_ms is not None:
            self._setbacks += boot_ms + _SETBACK_MS < self._boot_ms
            self._boot_ms = boot_ms
        if self.command is not None:
            self.command.receive(message, now_s)
        if self.parameter is not None:
            self.parameter.receive(message, now_s)
        replies: list[Message] = []
        for transfer in (*self.uploads.values(), self.download):
            if transfer is not None and self._refusal is None:
                try:
                    replies += transfer.receive(message, now_s)
                except LinkError as refusal:  # this vehicle's alone: the others go on
                    self._refusal = refusal
        return replies

    def check_transfer(self) -> None:
        """Raise what the vehicle has answered to its transfer, if it was a refusal."""
        if self._refusal is not None:
            refusal, self._refusal = self._refusal, None
            self.uploads.clear()
            self.download = None
            raise refusal

    def differing(
        self, sent: Sequence[MissionItem], held: Sequence[MissionItem], mission_type: int = 0
    ) -> list[Mismatch]:
        """Return how what was read back differs from what was sent, but for what its firmware is known to rewrite."""
        autopilot, vehicle_class = self.known_kind()
        return mismatches(sent, held, autopilot, vehicle_class, mission_type=mission_type)

    def expect_identity(self, kind: tuple[str, str] | None, uids: Collection[str], remedy: str) -> None:
        """Refuse a vehicle of another kind than expected, two behind one sysid, and another autopilot than expected.

        ``uids`` are the unique ids of which it must tell one; none: any vehicle will do. It must have been asked.

        Raises
        ------
        LinkError
            It is refused, with what to do.
        """
        if kind is not None:
            self.expect_kind(kind, remedy)
        self.check_alone()
        if uids:
            self.expect_uid(uids, remedy)

    def expect_kind(self, kind: tuple[str, str], remedy: str) -> None:
        """Refuse a vehicle of another autopilot or class."""
        if (self.autopilot, self.vehicle_class) != kind:
            expected, got = " ".join(kind), f"{self.autopilot} {self.vehicle_class}"
            raise self.error(f"expected {expected}, got {got}: {remedy}")

    def expect_uid(self, uids: Collection[str], remedy: str) -> None:
        """Refuse an autopilot that has told none of these unique ids."""
        if self.unique_ids.isdisjoint(uids):
            told = " or ".join(sorted(self.unique_ids)) or "none"
            raise self.error(f"expected the autopilot with uid {' or '.join(uids)}, got {told}: {remedy}")

    def check_alone(self) -> None:
        """Refuse a sysid that two autopilots share, though both are heard from one address.

        Raises
        ------
        LinkError
            It has told two unique ids, its clock has been set back more than once, or its frames bear the numbers of
            two senders.
        """
        numbering, self._numbering = self._numbering, None
        for digits in (36, 16):
            told = sorted(uid for uid in self.unique_ids if len(uid) == digits)
            if len(told) > 1:
                raise self.error(f"expected one autopilot, got answers of two ({' and '.join(told[:2])}): {_TWO}")
        if self._setbacks > 1:
            raise self.error(
                f"expected one autopilot, heard two by turns (times since start go back and forth): {_TWO}"
            )
        if numbering is not None and numbering.of_two:
            raise self.error(f"expected one autopilot, heard two by turns (frames bear the numbers of two): {_TWO}")


def _unique_ids(message: Message) -> set[str]:
    """Return what AUTOPILOT_VERSION tells of who it is: uid2 and uid, where they are not left empty."""
    long, short = bytes(message.uid2), int(message.uid)
    return {text for text, given in ((long.hex(), any(long)), (f"{short:016x}", short)) if given}


AnyPeer = TypeVar("AnyPeer", bound=Peer)


class Beside(Protocol):
    """Another ground station's software that shares our links."""

    def hear(self, frame: bytes) -> None:
        """Take in a frame that has arrived."""
        ...

    def said(self) -> Sequence[Message]:
        """Return the messages that it wants sent."""
        ...


class Station(Generic[AnyPeer]):
    """The loop beneath: one link, its clock, and the vehicles on it by sysid."""

    def __init__(
        self, peers: Mapping[int, AnyPeer], endpoints: Sequence[Endpoint], clock: Clock, log: FleetLog | None
    ) -> None:
        self.clock = clock
        self.link = PymavlinkLink(endpoints, log)
        self.peers = dict(peers)
        self.heard: set[int] = set()
        self.beside: Beside | None = None
        self._signed = any(isinstance(endpoint, SignedEndpoint) for endpoint in endpoints)

    def wait_for(self, sysids: Sequence[int] | None, names: Mapping[int, str], timeout_s: float) -> None:
        """Listen until all these vehicles (None: at least one) are heard, long enough to hear two with one sysid.

        Raises
        ------
        LinkError
            Somebody is not heard in time; two vehicles have one sysid.
        """
        begun_s = self.clock.now_s()
        self.settle(LISTEN_S)
        while True:
            known = [sysid for sysid, peer in self.peers.items() if peer.heartbeat is not None]
            missing = [f"a heartbeat of sysid {sysid}" for sysid in sorted(self.heard - set(known))] or (
                ["a vehicle"] if not known else []
            )
            if sysids is not None:
                missing = [names[sysid] for sysid in sysids if sysid not in known]
            if not missing:
                return
            if self.clock.now_s() >= begun_s + timeout_s:
                raise LinkError(self._missing(missing, set(sysids or ()), timeout_s))
            self.step()

    def together(self, goings: Mapping[int, Steps], after_failure: str | Callable[[], str] = "") -> None:
        """Go on with all vehicles side by side; when some fail, let the others finish, then say who failed.

        What was sent to others and not read back is told too, and ``after_failure``, or what it then returns.
        """
        running = dict(goings)
        failures: list[LinkError] = []
        failed: set[int] = set()
        while running:
            try:
                self.exchange()
            except LinkError as failure:  # of the links: nobody goes on
                raise self._with_what_is_left(failure, failed, after_failure) from failure
            for sysid in list(running):
                try:
                    next(running[sysid])
                except StopIteration:
                    del running[sysid]
                except LinkError as failure:
                    failures.append(self._with_its_cause(sysid, failure))
                    failed.add(sysid)
                    del running[sysid]
            if running:
                self.clock.wait(WAIT_S)
        if failures:
            raise self._with_what_is_left(joined(failures), failed, after_failure)

    def left_behind(self, told: Collection[int] = ()) -> str:
        """Return what vehicles hold of what was sent and not read back; empty: nothing was.

        Of those already ``told`` only transfers that were not what failed.
        """
        names: dict[str, list[str]] = {}
        for sysid, peer in self.peers.items():
            for upload in peer.uploads.values():
                if upload.done or sysid not in told:
                    names.setdefault(upload.state, []).append(peer.party.vehicle)
        return "; ".join(f"{', '.join(who)}: {state}" for state, who in names.items())

    def _with_what_is_left(
        self, error: LinkError, failed: Collection[int], after_failure: str | Callable[[], str]
    ) -> LinkError:
        after = after_failure if isinstance(after_failure, str) else after_failure()
        return LinkError("; ".join(text for text in (str(error), self.left_behind(failed), after) if text))

    def settle(self, duration_s: float) -> None:
        """Listen for a while."""
        end_s = self.clock.now_s() + duration_s
        while self.clock.now_s() < end_s:
            self.step()

    def begin_flight(self) -> None:
        """From now on, nobody who speaks in a vehicle's name ends the watch, and no requests for items are served.

        Until then a vehicle may ask again for what it has; but another ground station with our ids, as most have the
        same, may give it a mission of its own later, and must not get ours mixed in.
        """
        self.link.keep_to_routes()
        for peer in self.peers.values():
            peer.uploads.clear()

    def step(self) -> None:
        """Take in what has arrived, then wait a moment."""
        self.exchange()
        self.clock.wait(WAIT_S)

    def exchange(self) -> None:
        """Take in all that has arrived, and answer what must be answered."""
        now_s = self.clock.now_s()
        for message in self.link.receive(now_s):
            sysid = message.get_srcSystem()
            if sysid not in self.heard:
                self.heard.add(sysid)
                self.met(sysid)
            peer = self.peers.get(sysid)
            if peer is not None:
                self.send(peer, peer.receive(message, now_s))
            if self.beside is not None:
                self.beside.hear(bytes(message.get_msgbuf()))
        for message in self.beside.said() if self.beside is not None else ():
            self.link.pass_on(message, self.peers, now_s)

    def met(self, sysid: int) -> None:
        """Take note of a vehicle that is heard for the first time."""

    def send(self, peer: Peer, messages: Sequence[Message]) -> None:
        """Send messages to a vehicle that was heard."""
        for message in messages:
            self.link.send(message, peer.party.sysid, self.clock.now_s())

    # exchanges with one vehicle

    def commanding(
        self, peer: Peer, number: int, *params: float, retry_s: float = 0.7, patience_s: float = ANSWER_S
    ) -> Waiting[int]:
        """Command it, and return the MAV_RESULT that it answers."""
        party = peer.party
        command = Command(party.vehicle, party.sysid, number, *params, retry_s=retry_s, patience_s=patience_s)
        return (yield from self._until_answered(peer, command))

    def commanding_until(
        self, peer: Peer, shown: Callable[[], bool], number: int, *params: float, patience_s: float = ANSWER_S
    ) -> Waiting[int | None]:
        """Command what a heartbeat shows, arming or a mode, again and again until one does; return the MAV_RESULT.

        None: it was accepted, and no heartbeat has shown it.

        ``shown`` is asked of heartbeats that are heard after the command was accepted. A refusal that may be the answer
        to an opposite command sent before is asked for once more.

        Raises
        ------
        LinkError
            No answer.
        """
        end_s = self.clock.now_s() + patience_s
        party, last = peer.party, peer.last_command
        doubts: int | None = None
        while True:
            left_s = max(end_s - self.clock.now_s(), _SHOWN_S)
            command = Command(party.vehicle, party.sysid, number, *params, patience_s=left_s)
            if doubts is None:
                doubts = last.copies - 1 if last is not None and command.contradicts(last) else 0
            result = yield from self._until_answered(peer, command)
            if result != mavlink.MAV_RESULT_ACCEPTED:
                if doubts <= 0 or self.clock.now_s() >= end_s:
                    return result
                doubts -= 1
                continue
            beats, shown_end_s = peer.heartbeats, self.clock.now_s() + _SHOWN_S
            # two heartbeats that show otherwise are no matter of one that was on its way meanwhile
            while peer.heartbeats < beats + 2 and self.clock.now_s() < shown_end_s:
                if peer.heartbeats > beats and shown():
                    return result
                yield
            if peer.heartbeats > beats and shown():
                return result
            if self.clock.now_s() >= end_s:
                return None

    def _until_answered(self, peer: Peer, command: Command) -> Waiting[int]:
        peer.command = peer.last_command = command
        while command.result is None:
            self.send(peer, command.poll(self.clock.now_s()))
            yield
        peer.command = None
        return command.result

    def identifying(self, peer: Peer) -> Steps:
        """Ask for its unique id, as either of two generations of firmware has to be asked; it may have none.

        From then on it is heard from that place only: somebody else who has its sysid is not taken for it.
        """
        self.link.pin(peer.party.sysid)
        wanted, generation = float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION), 0
        asks = ((mavlink.MAV_CMD_REQUEST_MESSAGE, wanted), (mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES, 1.0))
        for _ in range(_VERSIONS_LOST):
            number, param = asks[generation]
            result = yield from self.commanding(peer, number, param, patience_s=_IDENTIFY_S)
            end_s = self.clock.now_s() + VERSION_S
            while self.clock.now_s() < end_s:  # to the end: a second autopilot may answer too
                yield
            if peer.told_version:
                return
            if result != mavlink.MAV_RESULT_ACCEPTED:
                generation += 1
            if generation == len(asks):
                return

    def uploading(
        self,
        peer: Peer,
        autopilot: Autopilot,
        items: Sequence[MissionItem],
        tell: Callable[[int, int], None] = lambda done, total: None,
        mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION,
    ) -> Steps:
        """Give it a mission, fence or rally points; what came of it, :meth:`reading_back` tells.

        Raises
        ------
        LinkError
            It refuses, or falls silent.
        """
        upload = MissionUpload(peer.party, autopilot, items, mission_type=mission_type)
        peer.uploads[mission_type] = upload
        shown = -1
        while not upload.done or upload.sent != shown:
            if upload.sent != shown:
                shown = upload.sent
                tell(shown, upload.total)
            self.send(peer, upload.poll(self.clock.now_s()))
            yield
            peer.check_transfer()

    def reading_back(
        self,
        peer: Peer,
        autopilot: Autopilot,
        items: Sequence[MissionItem],
        tell: Callable[[int, int | None], None] = lambda done, total: None,
        mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION,
    ) -> Waiting[tuple[MissionItem, ...]]:
        """Read what it holds of what was sent; if it never confirmed that, and holds otherwise, send it once more.

        Raises
        ------
        LinkError
            It refuses, falls silent, or holds something else.
        """
        for attempt in range(1, _UPLOADS + 1):
            held = yield from self.downloading(peer, tell, mission_type)
            wrong = peer.differing(items, held, mission_type)
            upload = peer.uploads.get(mission_type)
            if wrong and upload is not None and not upload.confirmed and attempt < _UPLOADS:
                yield from self.uploading(peer, autopilot, items, mission_type=mission_type)
            else:
                break
        peer.uploads.pop(mission_type, None)  # nothing more is served: who asks with our ids is somebody else's
        if wrong:
            more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
            seq = wrong[0].seq
            command = f" ({command_name(items[seq].command)})" if seq < len(items) else ""
            what = what_is_sent(mission_type)
            raise peer.error(f"holds another {what} than was sent: {wrong[0]}{command}{more}; upload it again")
        return held

    def downloading(
        self,
        peer: Peer,
        tell: Callable[[int, int | None], None] = lambda done, total: None,
        mission_type: int = mavlink.MAV_MISSION_TYPE_MISSION,
    ) -> Waiting[tuple[MissionItem, ...]]:
        """Read its mission, fence or rally points; ``tell`` hears of the items read and, once known, their count."""
        ahead = _READ_AHEAD if peer.autopilot == "ardupilot" else 1
        download = MissionDownload(peer.party, mission_type=mission_type, ahead=ahead)
        peer.download = download
        shown = -1
        while not download.done:
            self.send(peer, download.poll(self.clock.now_s()))
            if len(download.items) != shown:
                shown = len(download.items)
                tell(shown, download.total)
            yield
            peer.check_transfer()
        peer.download = None
        tell(len(download.items), download.total)
        return download.items

    def reading(
        self, peer: Peer, autopilot: Autopilot, setting: Setting, witness: str | None
    ) -> Waiting[ParameterValue | None]:
        """Read a parameter; None where it is optional and, as the known parameter ``witness`` shows, does not exist."""
        read = ParameterRead(peer.party, autopilot, setting.names, witness=witness if setting.optional else None)
        yield from self._until_done(peer, read)
        return read.held

    def reading_many(
        self, peer: Peer, autopilot: Autopilot, groups: Sequence[Sequence[str]]
    ) -> Waiting[list[ParameterValue | None]]:
        """Read parameters, each by the names that firmware gives it; None for one that does not exist."""
        read = ParametersRead(peer.party, autopilot, groups)
        yield from self._until_done(peer, read)
        return read.held

    def listing(
        self, peer: Peer, autopilot: Autopilot, tell: Callable[[int, int], None] = lambda done, total: None
    ) -> Waiting[dict[str, ParameterValue]]:
        """Read all parameters there are, by name; ``tell`` hears how many of how many have come."""
        read = ParameterList(peer.party, autopilot)
        for _ in self._until_done(peer, read):
            if read.total is not None:
                tell(read.read, read.total)
            yield
        tell(len(read.held), len(read.held))
        return read.held

    def setting(self, peer: Peer, autopilot: Autopilot, held: ParameterValue, value: float) -> Steps:
        """Set a parameter to a value that its type can hold."""
        change = ParameterSet(peer.party, autopilot, held, value)
        yield from self._until_done(peer, change)

    def _until_done(self, peer: Peer, dialogue: ParameterRead | ParametersRead | ParameterList | ParameterSet) -> Steps:
        """Let a dialogue about parameters hear the vehicle and say what it has to, until it is done."""
        peer.parameter = dialogue
        while not dialogue.done:
            self.send(peer, dialogue.poll(self.clock.now_s()))
            yield
        peer.parameter = None

    def _with_its_cause(self, sysid: int, failure: LinkError) -> LinkError:
        """Return a failure with what is likely to be behind it: a vehicle that signs obeys nobody who does not."""
        peer = self.peers.get(sysid)
        if (place := self.link.elsewhere(sysid)) is not None:
            return LinkError(
                f"{failure}; it fell silent where it was identified, and is heard on {place} since: whether that is "
                "the same vehicle is not known: begin again"
            )
        if self._signed or peer is None or not peer.signs:
            return failure
        return LinkError(f"{failure}; it signs its messages: expected --signing-key with its key")

    def _missing(self, names: Sequence[str], expected: set[int], timeout_s: float) -> str:
        others = sorted(self.heard - expected)
        if not self.heard:
            heard = "nobody answered"
        else:
            present = ", ".join(str(sysid) for sysid in sorted(self.heard))
            heard = f"heard only sysid {present}" if others else f"the others answered (sysid {present})"
        return (
            f"{self.link.urls}: expected {', '.join(names)} within {timeout_s:g} s, {heard}; "
            "check that the vehicles are on, send to this address, and have the sysids of the plan"
        )


def joined(failures: Sequence[LinkError]) -> LinkError:
    """Return the first failure, with the number of others."""
    others = f" (and {len(failures) - 1} more: {'; '.join(str(e) for e in failures[1:])})" if len(failures) > 1 else ""
    return LinkError(f"{failures[0]}{others}")
