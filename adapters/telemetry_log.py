"""Telemetry logs (``.tlog``): raw MAVLink frames, each after its time, as MAVProxy and Mission Planner write them.

A record is 8 bytes, big-endian microseconds since 1970, then one frame as it was on the wire. There is no header and no
end mark, so a log that was cut short is readable up to the cut
(https://ardupilot.org/planner/docs/mission-planner-telemetry-logs.html).
"""

from __future__ import annotations

import errno
import os
import re
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from io import RawIOBase
from pathlib import Path
from types import TracebackType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from missionplanner.errors import MissionError

_STAMP = struct.Struct(">Q")
MERGED = "fleet.tlog"
"""The log of all vehicles; it holds what their own logs do."""

SIMULATED = "SIMULATED flight: no vehicle was in the air"
"""Noted in the logs of every rehearsal; in one piece, so that it is found at once."""

_EARLIER = "earlier"
_OWN_SYSID = 255
_TEXT_MAX = 50  # bytes of a STATUSTEXT
_STX2, _STX1 = 0xFD, 0xFE
_MARKER = re.compile(b"[\xfd\xfe]")
_SIGNED = 0x01
_SIGNATURE = 13  # bytes
_YEAR_2000_US, _YEAR_2200_US = 946_684_800 * 10**6, 7_258_118_400 * 10**6


class FleetLog:
    """One log per vehicle and one of all, in a folder; both directions, as ground stations keep them.

    ``epoch_s`` is the time since 1970 at which the link's clock showed zero. Every record is handed to the system whole
    and at once: whatever becomes of this program, it is in the file. Logs that lie in the folder already are put aside,
    never written over.
    """

    def __init__(self, folder: Path, names: Mapping[int, str], epoch_s: float) -> None:
        self._epoch_s = epoch_s
        self._codec = mavlink.MAVLink(None, srcSystem=_OWN_SYSID, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._notes = 0
        self._files: dict[int, RawIOBase] = {}
        self._stamp_us = 0
        self.trouble: str | None = None  # why nothing is written any more
        own = {sysid: f"{name}.tlog" for sysid, name in names.items()}
        self.paths = [folder / (f"{sysid}-{file}" if file == MERGED else file) for sysid, file in own.items()]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _put_aside(folder)
            for sysid, path in zip(names, self.paths, strict=True):
                self._files[sysid] = path.open("wb", buffering=0)
            self._merged: RawIOBase = (folder / MERGED).open("wb", buffering=0)
        except OSError as error:
            for file in self._files.values():
                file.close()
            raise MissionError(f"{folder}: expected a folder that can be written to, got: {error.strerror}") from error
        self.paths.append(folder / MERGED)

    def write(self, now_s: float, sysid: int, frame: bytes) -> None:
        """Add one frame from or to the vehicle ``sysid``; one of an unknown vehicle goes to the merged log only."""
        record = self._record(now_s, frame)
        self._write(record, [self._merged, *([self._files[sysid]] if sysid in self._files else [])])

    def note(self, now_s: float, text: str) -> None:
        """Add a remark of our own to every log: a STATUSTEXT from this ground station, in pieces where it is long."""
        data = text.encode()
        self._notes = self._notes % 65_535 + 1
        pieces = [data[i : i + _TEXT_MAX] for i in range(0, max(len(data), 1), _TEXT_MAX)]
        if len(pieces[-1]) == _TEXT_MAX and len(pieces) > 1:
            pieces.append(b"")  # the end of a text in pieces is a piece that is not full
        for number, piece in enumerate(pieces):
            identity = self._notes if len(pieces) > 1 else 0
            message = mavlink.MAVLink_statustext_message(mavlink.MAV_SEVERITY_WARNING, piece, identity, number)
            record = self._record(now_s, bytes(message.pack(self._codec)))
            self._write(record, [*self._files.values(), self._merged])

    def close(self) -> None:
        """Finish all files."""
        for file in (*self._files.values(), self._merged):
            file.close()

    def _write(self, record: bytes, files: Sequence[RawIOBase]) -> None:
        """Write a record to files; who cannot any more (a full disk) says so in ``trouble``: the flight goes on."""
        if self.trouble is not None:
            return
        try:
            for file in files:
                if file.write(record) != len(record):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            self.trouble = (
                f"{self.paths[-1].parent}: the telemetry logs end here, they cannot be written: {error.strerror}"
            )

    def _record(self, now_s: float, frame: bytes) -> bytes:
        self._stamp_us = max(round((self._epoch_s + now_s) * 1e6), self._stamp_us)
        return _STAMP.pack(self._stamp_us) + frame

    def __enter__(self) -> FleetLog:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _put_aside(folder: Path) -> None:
    """Move logs of earlier flights into a numbered folder of their own."""
    logs = [path for path in folder.glob("*.tlog") if path.stat().st_size]
    if logs:
        number = 1 + max((int(p.name) for p in (folder / _EARLIER).glob("*") if p.name.isdecimal()), default=0)
        aside = folder / _EARLIER / str(number)
        aside.mkdir(parents=True)
        for path in logs:
            path.rename(aside / path.name)


def latest_flight(folder: Path, sysids: Collection[int]) -> Path | None:
    """Return the latest log of all vehicles, also of those put aside, in which one of these is armed; None: in none.

    Raises
    ------
    MissionError
        A log cannot be read.
    """
    aside = [path for path in (folder / _EARLIER).glob("*") if path.name.isdecimal()]
    aside.sort(key=lambda path: int(path.name), reverse=True)
    for path in (folder / MERGED, *(earlier / MERGED for earlier in aside)):
        if path.is_file() and any(
            message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED and message.get_srcSystem() in sysids
            for _, message in read_log(path, (mavlink.MAVLINK_MSG_ID_HEARTBEAT,)).records
        ):
            return path
    return None


def is_simulated(path: Path) -> bool:
    """Return whether a log is of a rehearsal.

    Raises
    ------
    MissionError
        The file cannot be read.
    """
    return SIMULATED.encode() in _bytes(path)


@dataclass(frozen=True, slots=True)
class TelemetryLog:
    """What a log holds: messages with their times since 1970, and what of it could not be read."""

    records: tuple[tuple[float, Any], ...]
    sound_frames: int  # also those that were not asked for
    lost_bytes: int  # all that is in no whole, sound frame of a known kind
    damaged_frames: int = 0  # whole, but of a wrong checksum
    cut_bytes: int = 0  # of an unfinished record at the end
    unknown_frames: int = 0  # of kinds that are not known here, whose checksums cannot be told


def read_log(path: Path, kinds: Collection[int] | None = None) -> TelemetryLog:
    """Read all whole frames of a log; what is damaged or cut short is skipped and counted.

    With ``kinds``, messages of other ids are checked but left out: decoding them takes most of the time.

    Raises
    ------
    MissionError
        The file cannot be read, or holds no frame at all.
    """
    data = _bytes(path)
    log = parse_log(data, kinds)
    if data and not log.sound_frames:
        raise MissionError(f"{path}: expected a telemetry log, got {len(data)} bytes without any MAVLink frame")
    return log


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise MissionError(f"{path}: expected a telemetry log, got: {error.strerror or error}") from error


def parse_log(data: bytes, kinds: Collection[int] | None = None) -> TelemetryLog:
    """Read all whole frames of a log's bytes; see :func:`read_log`."""
    parser = mavlink.MAVLink(None)
    records: list[tuple[float, Any]] = []
    sound = lost = damaged = unknown = position = end = 0
    while position < len(data):
        length = _record_length(data, position)
        frame = data[position + _STAMP.size : position + length]
        kind = _kind(frame) if length else None
        if kind is not None and _is_sound(frame, kind):
            sound += 1
            if kinds is None or kind in kinds:
                (stamp_us,) = _STAMP.unpack_from(data, position)
                records.append((stamp_us / 1e6, parser.decode(bytearray(frame))))
            end = position = position + length
        elif length and _begins(data, position + length):  # what follows shows that it is a record indeed
            damaged += kind in mavlink.mavlink_map
            unknown += kind not in mavlink.mavlink_map
            lost += length
            end = position = position + length
        else:
            after = _next_record(data, position)
            lost += after - position
            position = after
    cut = len(data) - end if _begins(data, end) else 0
    return TelemetryLog(tuple(records), sound, lost, damaged, cut, unknown)


def _begins(data: bytes, position: int) -> bool:
    """Return whether a record may begin there, however short what is left of it; at the very end it may."""
    stamp = data[position : position + _STAMP.size]
    if len(stamp) < _STAMP.size:
        return stamp[:1] in (b"", b"\0")  # the first of a time's eight bytes is 0 for centuries
    (stamp_us,) = _STAMP.unpack(stamp)
    marker = data[position + _STAMP.size : position + _STAMP.size + 1]
    return _YEAR_2000_US < stamp_us < _YEAR_2200_US and marker in (b"", bytes([_STX1]), bytes([_STX2]))


def _next_record(data: bytes, position: int) -> int:
    """Return where, after ``position``, the next record may begin; the end where none does."""
    found = _MARKER.search(data, position + 1 + _STAMP.size)
    return len(data) if found is None else found.start() - _STAMP.size


def _record_length(data: bytes, position: int) -> int:
    """Return the length of the whole record that starts there, 0 if none does."""
    start = position + _STAMP.size
    if start + 3 > len(data):
        return 0
    (stamp_us,) = _STAMP.unpack_from(data, position)
    if not _YEAR_2000_US < stamp_us < _YEAR_2200_US:
        return 0
    payload = data[start + 1]
    if data[start] == _STX2:
        length = 12 + payload + (_SIGNATURE if data[start + 2] & _SIGNED else 0)
    elif data[start] == _STX1:
        length = 8 + payload
    else:
        return 0
    return _STAMP.size + length if start + length <= len(data) else 0


def _kind(frame: bytes) -> int:
    """Return the id of a frame's message."""
    return frame[5] if frame[0] == _STX1 else int.from_bytes(frame[7:10], "little")


def _is_sound(frame: bytes, kind: int) -> bool:
    """Return whether a frame is of a known kind and its checksum is right (https://mavlink.io/en/guide/serialization.html)."""
    known = mavlink.mavlink_map.get(kind)
    if known is None:
        return False
    signed = frame[0] == _STX2 and frame[2] & _SIGNED
    end = len(frame) - 2 - (_SIGNATURE if signed else 0)
    return bool(
        mavlink.x25crc(frame[1:end] + bytes([known.crc_extra])).crc == int.from_bytes(frame[end : end + 2], "little")
    )
