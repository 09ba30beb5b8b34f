"""Bad links: an endpoint through which frames are lost, late, doubled, out of order or damaged, as chance has it.

Each MAVLink frame has its own fate, also where several share a datagram: a radio knows no datagrams. Both ways are
alike and independent of each other. Time is the simulation's, so that links are as slow as the vehicles on them.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from adapters.endpoint import Endpoint, Peer, WrappedEndpoint
from missionplanner.errors import MissionError

REORDER_S = 0.3
"""A frame that is overtaken comes up to this much later."""

_BACKLOG_S = 1.0  # what a radio has not sent after this long it does not take
_BITS_PER_BYTE = 10  # with start and stop bit
_FLIPPED_MAX = 8
_PEERS_MAX = 256
_FRAME_1, _FRAME_2 = 0xFE, 0xFD
_SIGNED = 1


@dataclass(frozen=True, slots=True)
class Faults:
    """What a link does to frames, each way.

    Shares of frames are from 0 to 1. A link of ``baud`` takes its time for every byte, and drops what would wait for
    longer than a second. ``down_s`` are stretches (from, to) of simulated time in which everything is lost.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    corrupt: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0  # at most this much is added to the delay
    baud: int | None = None
    down_s: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for name in ("loss", "duplicate", "reorder", "corrupt"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise MissionError(f"link: {name}: expected a share from 0 to 1, got {getattr(self, name)}")
        for name in ("delay_s", "jitter_s"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise MissionError(f"link: {name}: expected seconds from 0, got {getattr(self, name)}")
        if self.baud is not None and self.baud <= 0:
            raise MissionError(f"link: baud: expected a rate above 0, got {self.baud}")
        for from_s, to_s in self.down_s:
            if not 0.0 <= from_s <= to_s:
                raise MissionError(f"link: down_s: expected times from 0, the later one last, got {from_s} and {to_s}")


def bad_links(faults: Faults, now_s: Callable[[], float], seed: int) -> Callable[[Endpoint], Endpoint]:
    """Return what puts an endpoint behind a bad link: each behind one of its own, by chance of its own."""
    rng = np.random.default_rng(seed)
    return lambda endpoint: FaultyEndpoint(endpoint, faults, now_s, rng.spawn(1)[0])


class FaultyEndpoint(WrappedEndpoint):
    """An endpoint behind a bad link, for either side of it; whoever owns it must call :meth:`receive` ever so often.

    Parameters
    ----------
    inner : the endpoint that is wrapped
    now_s : the clock that delays and stretches of silence go by
    rng : decides what happens to which frame
    """

    def __init__(self, inner: Endpoint, faults: Faults, now_s: Callable[[], float], rng: np.random.Generator) -> None:
        super().__init__(inner)
        self._now_s = now_s
        there, back = rng.spawn(2)
        self._out = _Way(faults, there)
        self._in = _Way(faults, back)
        self._cut: dict[Peer, bytes] = {}

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return the frames that have come through by now; send on those of the other way."""
        now_s = self._now_s()
        for data, peer in self._inner.receive():
            frames, rest = _frames(self._cut.pop(peer, b"") + data)
            for frame in frames:
                self._in.take(frame, peer, now_s)
            if rest:
                self._cut[peer] = rest
                if len(self._cut) > _PEERS_MAX:  # somebody speaks from ever new ports
                    del self._cut[next(iter(self._cut))]
        self._send_on(now_s)
        return [(frame, peer) for frame, peer in self._in.due(now_s) if peer is not None]

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Put the frames of ``data`` on the link."""
        now_s = self._now_s()
        frames, rest = _frames(data)
        for frame in (*frames, rest) if rest else frames:
            self._out.take(frame, peer, now_s)
        self._send_on(now_s)

    def _send_on(self, now_s: float) -> None:
        for frame, peer in self._out.due(now_s):
            self._inner.send(frame, peer)


@dataclass(slots=True)
class _Way:
    """One way of a link: frames on it, by when they arrive."""

    faults: Faults
    rng: np.random.Generator
    _flying: list[tuple[float, int, bytes, Peer | None]] = field(default_factory=list)
    _count: itertools.count[int] = field(default_factory=itertools.count)
    _free_s: float = 0.0  # when the radio has sent all that it took
    _last_s: float = 0.0  # when the frame before arrives

    def take(self, frame: bytes, peer: Peer | None, now_s: float) -> None:
        faults = self.faults
        lost, damaged, doubled = self.rng.random(3)
        if any(from_s <= now_s < to_s for from_s, to_s in faults.down_s):
            return
        sent_s = now_s
        if faults.baud is not None:
            sent_s = max(now_s, self._free_s) + _BITS_PER_BYTE * len(frame) / faults.baud
            if sent_s > now_s + _BACKLOG_S:
                return
            self._free_s = sent_s  # the air is used for frames, too, that nobody receives
        if lost < faults.loss:
            return
        if damaged < faults.corrupt:
            frame = self._damaged(frame)
        for _ in range(1 + (doubled < faults.duplicate)):
            heapq.heappush(self._flying, (self._arrival_s(sent_s), next(self._count), frame, peer))

    def due(self, now_s: float) -> list[tuple[bytes, Peer | None]]:
        arrived = []
        while self._flying and self._flying[0][0] <= now_s:
            _, _, frame, peer = heapq.heappop(self._flying)
            arrived.append((frame, peer))
        return arrived

    def _arrival_s(self, sent_s: float) -> float:
        faults = self.faults
        jitter, overtaken, behind = self.rng.random(3)
        self._last_s = max(self._last_s, sent_s + faults.delay_s + faults.jitter_s * jitter)
        return self._last_s + (REORDER_S * behind if overtaken < faults.reorder else 0.0)

    def _damaged(self, frame: bytes) -> bytes:
        spoiled = bytearray(frame)
        for _ in range(int(self.rng.integers(1, _FLIPPED_MAX + 1))):
            spoiled[self.rng.integers(len(spoiled))] ^= 1 << int(self.rng.integers(8))
        return bytes(spoiled)


def _frames(data: bytes) -> tuple[list[bytes], bytes]:
    """Return MAVLink frames, and what is none in pieces of its own; and the beginning of a frame at the end."""
    pieces: list[bytes] = []
    here = stray = 0
    while here < len(data):
        if data[here] not in (_FRAME_1, _FRAME_2):
            here += 1
            continue
        if stray < here:
            pieces.append(data[stray:here])
        stray = here
        end = here + _frame_length(data[here : here + 3])
        if end > len(data):
            return pieces, data[here:]
        pieces.append(data[here:end])
        stray = here = end
    if stray < here:
        pieces.append(data[stray:here])
    return pieces, b""


def _frame_length(head: bytes) -> int:
    """Return the length of a frame by its first bytes (https://mavlink.io/en/guide/serialization.html)."""
    if len(head) < 3:
        return 3
    if head[0] == _FRAME_1:
        return 8 + head[1]
    return 12 + head[1] + (13 if head[2] & _SIGNED else 0)
