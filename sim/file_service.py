"""The vehicle's half of MAVLink FTP, as far as ground stations need it: ArduPilot's file of all parameters.

Requests and replies are the payloads of FILE_TRANSFER_PROTOCOL (https://mavlink.io/en/services/ftp.html); the file is
``@PARAM/param.pck`` (AP_Filesystem_Param). Whatever else is asked for is refused at once, so that nobody waits.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Hashable, Mapping
from enum import IntEnum

PARAMETER_FILE = "@PARAM/param.pck"

_HEADER = struct.Struct("<HBBBBBxI")  # seq, session, opcode, size, request's opcode, burst complete, offset
_DATA_MAX = 239
_PAYLOAD = _HEADER.size + _DATA_MAX
_INVALID_SESSION, _END_OF_FILE, _UNKNOWN_COMMAND, _FILE_NOT_FOUND = 4, 6, 7, 10
_READERS_MAX = 8
_MAGIC, _MAGIC_WITH_DEFAULTS = 0x671B, 0x671C
_INT32, _FLOAT = 3, 4
_NOT_DEFAULT = 1 << 4
_NAME_SHARED_MAX = 15


class _Opcode(IntEnum):
    TERMINATE = 1
    RESET = 2
    OPEN = 4
    READ = 5
    BURST = 15
    ACK = 128
    NAK = 129


def parameter_file(parameters: Mapping[str, int | float], defaults: Mapping[str, int | float] | None = None) -> bytes:
    """Return parameters as ArduPilot packs them: INT32 and FLOAT, each name without what it shares with the last one.

    With ``defaults`` a value that differs from its default is followed by that.
    """
    magic = _MAGIC if defaults is None else _MAGIC_WITH_DEFAULTS
    packed = bytearray(struct.pack("<HHH", magic, len(parameters), len(parameters)))
    last = ""
    for name, value in parameters.items():
        whole = isinstance(value, int)
        changed = defaults is not None and defaults[name] != value
        differs = (k for k, (one, other) in enumerate(zip(last, name, strict=False)) if one != other)
        shared = min(next(differs, len(last)), _NAME_SHARED_MAX, len(name) - 1)
        rest = name[shared:].encode()
        packed += bytes(
            [(_INT32 if whole else _FLOAT) | (_NOT_DEFAULT if changed else 0), shared | (len(rest) - 1) << 4]
        )
        packed += rest
        for each in (value, defaults[name]) if defaults is not None and changed else (value,):
            packed += struct.pack("<i" if whole else "<f", each)
        last = name
    return bytes(packed)


class FileService:
    """Answers requests for files. ``parameters`` returns the parameter file, with defaults or without (None: none)."""

    def __init__(self, parameters: Callable[[bool], bytes] | None) -> None:
        self._parameters = parameters
        self._open: dict[Hashable, bytes] = {}  # what each reader has opened, as it was then

    def answer(self, payload: bytes, reader: Hashable) -> list[bytes]:
        """Return the payloads of the replies to a request."""
        if len(payload) < _HEADER.size:
            return []
        sequence, session, opcode, size, _, _, offset = _HEADER.unpack_from(payload)
        data = payload[_HEADER.size : _HEADER.size + min(size, _DATA_MAX)]

        def reply(kind: int, content: bytes, at: int = 0, number: int = 0, *, complete: bool = False) -> bytes:
            head = ((sequence + 1 + number) & 0xFFFF, session, kind, len(content), opcode, complete, at)
            return (_HEADER.pack(*head) + content).ljust(_PAYLOAD, b"\0")

        match opcode:
            case _Opcode.TERMINATE | _Opcode.RESET:
                self._open.pop(reader, None)
                return [reply(_Opcode.ACK, b"")]
            case _Opcode.OPEN:
                file = self._found(data)
                if file is None:
                    return [reply(_Opcode.NAK, bytes([_FILE_NOT_FOUND]))]
                if len(self._open) >= _READERS_MAX:
                    self._open.pop(next(iter(self._open)))
                self._open[reader] = file
                return [reply(_Opcode.ACK, struct.pack("<I", len(file)))]
            case _Opcode.READ | _Opcode.BURST:
                file = self._open.get(reader)
                if file is None:
                    return [reply(_Opcode.NAK, bytes([_INVALID_SESSION]))]
                if offset >= len(file):
                    return [reply(_Opcode.NAK, bytes([_END_OF_FILE]), offset)]
                step = min(size, _DATA_MAX) or _DATA_MAX
                if opcode == _Opcode.READ:
                    return [reply(_Opcode.ACK, file[offset : offset + step], offset)]
                starts = range(offset, len(file), step)
                return [
                    reply(_Opcode.ACK, file[at : at + step], at, number, complete=at + step >= len(file))
                    for number, at in enumerate(starts)
                ]
        return [reply(_Opcode.NAK, bytes([_UNKNOWN_COMMAND]))]

    def _found(self, data: bytes) -> bytes | None:
        name, _, query = data.split(b"\0", 1)[0].decode("ascii", "replace").partition("?")
        if self._parameters is None or name != PARAMETER_FILE:
            return None
        return self._parameters("withdefaults=1" in query.split("&"))
