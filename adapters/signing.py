"""MAVLink 2 signing: endpoints that sign what they send, and let nothing through that is not signed with the same key.

A signature is the link's id, a timestamp and six bytes of a SHA-256 (https://mavlink.io/en/guide/message_signing.html).
Timestamps are units of 10 us since 2015 that only grow, per link and sender: a frame that comes twice, or from an
earlier flight, is dropped. pymavlink signs too, but takes note of a timestamp before it knows whose it is (anybody
could so silence a vehicle), and knows streams per parser, so that a replay from another address would pass.
"""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import stat
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint, Peer, WrappedEndpoint, open_endpoint
from missionplanner.errors import LinkError, MissionError
from missionplanner.files import write_atomic

_KEY_BYTES = 32
_EPOCH_S = 1_420_070_400.0  # 2015-01-01, where timestamps begin
_TICKS_PER_S = 100_000
_STALE = 60 * _TICKS_PER_S  # a stream that is new to us may be this much behind
_REMEMBERED = 5 * _TICKS_PER_S  # how often the timestamp is written down
_TIMESTAMP_MAX = (1 << 48) - 1
_MARKER_V2 = 0xFD
_SIGNED = 0x01  # of incompat_flags
_HEADER_BYTES, _CHECKSUM_BYTES, _SIGNATURE_BYTES = 10, 2, 13
_PEERS_MAX = 256


@dataclass(slots=True)
class Dropped:
    """What of one system's frames was not let through."""

    unsigned: int = 0
    wrong: int = 0  # signed with another key, or forged
    replayed: int = 0

    def __str__(self) -> str:
        kinds = (
            (self.unsigned, "not signed"),
            (self.wrong, "signed with another key"),
            (self.replayed, "come twice or too late"),
        )
        return ", ".join(f"{count} {what}" for count, what in kinds if count)


class Signing:
    """One key, and all that is known of the streams signed with it: whoever shares the key shares this.

    Parameters
    ----------
    key : 32 bytes
    clock : seconds since 1970
    after : no timestamp is below this one
    remember : called with the timestamp now and then, so that the next run can begin ``after`` it
    """

    def __init__(
        self, key: bytes, clock: Callable[[], float], *, after: int = 0, remember: Callable[[int], None] | None = None
    ) -> None:
        assert len(key) == _KEY_BYTES
        self.dropped: dict[int, Dropped] = {}  # by sysid
        self._key = key
        self._clock = clock
        self._timestamp = after
        self._remember = remember
        self._remembered = -_REMEMBERED
        self._streams: dict[tuple[int, int, int], int] = {}  # (link, system, component): its last timestamp
        self._links = 0

    def sealed(self, endpoint: Endpoint) -> SignedEndpoint:
        """Return the endpoint behind this key, with a link id of its own."""
        link_id = self._links % 256
        self._links += 1
        return SignedEndpoint(endpoint, self, link_id)

    def sign(self, frame: bytes, link_id: int) -> bytes:
        """Return an unsigned MAVLink 2 frame as a signed one."""
        head = bytearray(frame[:-_CHECKSUM_BYTES])
        head[2] |= _SIGNED
        checksum = mavlink.x25crc(head[1:])
        checksum.accumulate(bytes([mavlink.mavlink_map[int.from_bytes(head[7:10], "little")].crc_extra]))
        signed = bytes(head) + struct.pack("<HB", checksum.crc, link_id) + self._next().to_bytes(6, "little")
        return signed + self._signature(signed)

    def accepts(self, message: Any) -> bool:
        """Return whether a decoded message was signed with this key, and is newer than all before it; count if not."""
        frame = bytes(message.get_msgbuf())
        if frame[0] != _MARKER_V2 or not frame[2] & _SIGNED:
            self._dropped(message).unsigned += 1
            return False
        if not hmac.compare_digest(self._signature(frame[:-6]), frame[-6:]):
            self._dropped(message).wrong += 1
            return False
        timestamp = int.from_bytes(frame[-12:-6], "little")
        stream = (frame[-_SIGNATURE_BYTES], message.get_srcSystem(), message.get_srcComponent())
        last = self._streams.get(stream, max(self._timestamp, self._now()) - _STALE - 1)
        if timestamp <= last:
            self._dropped(message).replayed += 1
            return False
        self._streams[stream] = timestamp
        self._timestamp = max(self._timestamp, timestamp)
        return True

    def explained(self, error: LinkError) -> LinkError:
        """Return an error of the link with what was dropped on it, since that may be why."""
        told = [f"sysid {sysid}: {dropped}" for sysid, dropped in sorted(self.dropped.items())]
        if not told:
            return error
        more = f"; and {len(told) - 5} more" if len(told) > 5 else ""
        return LinkError(
            f"{error}; messages were dropped ({'; '.join(told[:5])}{more}): wrong key? "
            "The vehicles must sign with the key of --signing-key"
        )

    def save(self) -> None:
        """Write the timestamp down."""
        if self._remember is not None:
            self._remembered = self._timestamp
            self._remember(self._timestamp)

    def _now(self) -> int:
        return int((self._clock() - _EPOCH_S) * _TICKS_PER_S)

    def _next(self) -> int:
        self._timestamp = min(max(self._timestamp + 1, self._now()), _TIMESTAMP_MAX)
        if self._timestamp >= self._remembered + _REMEMBERED:
            self.save()
        return self._timestamp

    def _signature(self, signed: bytes) -> bytes:
        return hashlib.sha256(self._key + signed).digest()[:6]

    def _dropped(self, message: Any) -> Dropped:
        return self.dropped.setdefault(message.get_srcSystem(), Dropped())


class SignedEndpoint(WrappedEndpoint):
    """An endpoint whose other side must hold the same key."""

    def __init__(self, inner: Endpoint, signing: Signing, link_id: int) -> None:
        super().__init__(inner)
        self._signing = signing
        self._link_id = link_id
        self._parsers: dict[Peer, Any] = {}

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return the frames that have arrived and are signed as they must be."""
        arrived = []
        for data, peer in self._inner.receive():
            parser = self._parsers.get(peer)
            if parser is None:
                if len(self._parsers) >= _PEERS_MAX:  # somebody speaks from ever new ports
                    self._parsers.pop(next(iter(self._parsers)))
                parser = self._parsers[peer] = mavlink.MAVLink(None)
                parser.robust_parsing = True
            frames = [
                bytes(message.get_msgbuf())
                for message in parser.parse_buffer(data) or ()
                if message.get_msgId() >= 0 and self._signing.accepts(message)  # below: damaged or unknown
            ]
            if frames:
                arrived.append((b"".join(frames), peer))
        return arrived

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Sign every frame and send it."""
        signed = bytearray()
        start = 0
        while start < len(data):
            assert data[start] == _MARKER_V2, "what we send is MAVLink 2"
            end = start + _HEADER_BYTES + data[start + 1] + _CHECKSUM_BYTES
            signed += self._signing.sign(data[start:end], self._link_id)
            start = end
        self._inner.send(bytes(signed), peer)


def read_key(path: Path) -> tuple[bytes, str | None]:
    """Return a key, and what is to be said of its file: others than its owner should not be able to read it.

    Raises
    ------
    MissionError
        The file cannot be read, or holds neither 32 bytes nor 64 hexadecimal digits.
    """
    try:
        with path.open("rb") as file:
            content = file.read(1024)
            mode = os.fstat(file.fileno()).st_mode
    except OSError as error:
        raise MissionError(f"{path}: expected a signing key that can be read, got: {error.strerror}") from error
    key = content
    text = content.strip()
    if len(content) != _KEY_BYTES and re.fullmatch(rb"[0-9a-fA-F]{64}", text):
        key = bytes.fromhex(text.decode())
    if len(key) != _KEY_BYTES:
        raise MissionError(
            f"{path}: expected a signing key of {_KEY_BYTES} bytes or {2 * _KEY_BYTES} hexadecimal digits, "
            f"got {len(content)} bytes"
        )
    open_to_others = os.name == "posix" and mode & (stat.S_IRGRP | stat.S_IROTH)
    return key, f"{path}: others than its owner can read this key: chmod 600 {path}" if open_to_others else None


def signing_from(path: Path, clock: Callable[[], float], warn: Callable[[str], None]) -> Signing:
    """Return what signs with the key of a file; its last timestamp is kept beside it, as FILE.timestamp.

    So timestamps grow from run to run also where the clock is set back. Where nothing can be written there, that is
    told, and the clock must do.

    Raises
    ------
    MissionError
        As :func:`read_key`, or the timestamp is none.
    """
    key, remark = read_key(path)
    if remark is not None:
        warn(remark)
    beside = path.with_name(f"{path.name}.timestamp")
    after = 0
    if beside.exists():
        try:
            after = int(beside.read_text(encoding="ascii")) + _REMEMBERED
        except (OSError, ValueError) as error:
            raise MissionError(
                f"{beside}: expected the last timestamp of {path.name}, got: {error}: delete it"
            ) from error
        if not 0 <= after < _TIMESTAMP_MAX:
            raise MissionError(f"{beside}: expected a timestamp of 48 bits, got {after}: delete it")
    failed = False

    def remember(timestamp: int) -> None:
        nonlocal failed
        if failed:
            return
        try:
            write_atomic(beside, f"{timestamp}\n")
        except MissionError as error:
            failed = True
            warn(f"{error}; vehicles refuse signatures while this computer's clock is behind their last flight")

    return Signing(key, clock, after=after, remember=remember)


@contextmanager
def open_links(
    urls: Sequence[str], key: Path | None, clock: Callable[[], float], warn: Callable[[str], None]
) -> Iterator[list[Endpoint]]:
    """Open endpoints for a while, signed where there is a key; errors of the link then tell what was dropped.

    Raises
    ------
    LinkError, MissionError
        An endpoint that cannot be opened; a key that cannot be read.
    """
    signing = None if key is None else signing_from(key, clock, warn)
    with ExitStack() as stack:
        endpoints: list[Endpoint] = [stack.enter_context(closing(open_endpoint(url))) for url in urls]
        if signing is None:
            yield endpoints
            return
        try:
            yield [signing.sealed(endpoint) for endpoint in endpoints]
        except LinkError as error:
            raise signing.explained(error) from error
        finally:
            signing.save()
