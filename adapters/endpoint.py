"""Byte pipes to vehicles and ground stations: UDP, TCP, serial and in-process, none of them ever blocking.

An endpoint may have several peers (a UDP port hears many vehicles, a TCP port has many clients): what is received says
from whom, what is sent says to whom. Connection URLs are read in both usual spellings, pymavlink's and MAVSDK's.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import socket
import time
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import serial

from missionplanner.errors import LinkError

Peer = Hashable
Kind = Literal["udpin", "udpout", "tcpin", "tcpout", "serial"]

_DATAGRAM_MAX = 65_535
_PEERS_MAX = 1_024
_UNREAD_MAX = 1 << 20  # a TCP client that has not read this much is taken for dead
_TCP_CONNECT_TIMEOUT_S = 5.0
_RETRY_S = 1.0
_DEFAULT_PORT: dict[Kind, int] = {"udpin": 14550, "udpout": 14550, "tcpin": 5760, "tcpout": 5760, "serial": 0}
_DEFAULT_BAUD = 57_600
_SCHEMES: dict[str, Kind] = {
    # pymavlink and MAVSDK agree that a bare "udp" listens and a bare "tcp" connects
    "udp": "udpin",
    "udpin": "udpin",
    "udpout": "udpout",
    "tcp": "tcpout",
    "tcpin": "tcpin",
    "tcpout": "tcpout",
}
_EXAMPLES = "udpin:0.0.0.0:14550, udpout:127.0.0.1:14540, tcp:127.0.0.1:5760, /dev/ttyUSB0:57600"


@dataclass(frozen=True, slots=True)
class Address:
    """Where an endpoint listens or connects to; ``host`` is the device of a serial line."""

    kind: Kind
    host: str
    port: int = 0
    baud: int = _DEFAULT_BAUD

    def __str__(self) -> str:
        if self.kind == "serial":
            return f"{self.host}:{self.baud}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind}:{host}:{self.port}"

    def listening(self) -> Address:
        """Return the same place as one that listens, as ``--listen tcp:127.0.0.1:5760`` means it."""
        listening: dict[Kind, Kind] = {"udpout": "udpin", "tcpout": "tcpin"}
        return replace(self, kind=listening.get(self.kind, self.kind))

    def with_port_offset(self, offset: int) -> Address:
        """Return the address ``offset`` ports further, as a second simulated vehicle has it."""
        return replace(self, port=self.port + offset)


def parse_url(url: str) -> Address:
    """Read a connection URL as pymavlink (``udpin:host:port``) or MAVSDK (``udpin://host:port``) spell it.

    ``udp`` listens, ``tcp`` connects; serial devices are ``/dev/ttyUSB0:57600``, ``COM3:57600`` or
    ``serial:///dev/ttyUSB0:57600`` (https://mavsdk.mavlink.io/main/en/cpp/guide/connections.html).

    Raises
    ------
    LinkError
        The URL is none of these.
    """
    text = url.strip()
    device = re.fullmatch(r"(?:serial(?:_flowcontrol)?:(?://)?)?(/dev/[^:,]+|COM\d+)(?:[:,](\d+))?", text)
    if device:
        return Address("serial", device[1], baud=int(device[2] or _DEFAULT_BAUD))
    network = re.fullmatch(r"(\w+):(?://)?(\[[0-9a-fA-F:]+\]|[^:/\[\]]*)(?::(\d{1,5}))?/?", text)
    if not network or network[1].lower() not in _SCHEMES:
        raise LinkError(f"{url!r}: expected a connection URL, for example {_EXAMPLES}")
    kind = _SCHEMES[network[1].lower()]
    host = network[2].strip("[]") or ("0.0.0.0" if kind.endswith("in") else "127.0.0.1")
    port = int(network[3]) if network[3] else _DEFAULT_PORT[kind]
    if not 0 <= port <= 65_535:
        raise LinkError(f"{url!r}: expected a port from 0 to 65535, got {port}")
    return Address(kind, host, port)


class Endpoint(Protocol):
    """A non-blocking byte pipe to one or more peers."""

    @property
    def url(self) -> str:
        """Where it listens or connects to, for messages to users."""
        ...

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return all that has arrived since the last call, in order, each piece with its sender."""
        ...

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Send to one peer, or (None) to all peers that are known."""
        ...

    def filenos(self) -> list[int]:
        """Return the descriptors to wait on; none for an in-process pipe."""
        ...

    def close(self) -> None:
        """Give the port or device back; further calls do nothing."""
        ...


class WrappedEndpoint:
    """Another endpoint, whose bytes a subclass looks at or changes on their way."""

    def __init__(self, inner: Endpoint) -> None:
        self._inner = inner

    @property
    def url(self) -> str:
        """Where the wrapped endpoint listens or connects to."""
        return self._inner.url

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return what has arrived."""
        return self._inner.receive()

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Send to one peer, or to all that are known."""
        self._inner.send(data, peer)

    def filenos(self) -> list[int]:
        """Return the wrapped endpoint's descriptors."""
        return self._inner.filenos()

    def close(self) -> None:
        """Close the wrapped endpoint."""
        self._inner.close()


def open_endpoint(address: Address | str) -> Endpoint:
    """Open the endpoint that a URL or address describes.

    Raises
    ------
    LinkError
        A malformed URL, a port in use, nobody listening, an unknown host, a missing device.
    """
    place = parse_url(address) if isinstance(address, str) else address
    match place.kind:
        case "udpin" | "udpout":
            return UdpEndpoint(place)
        case "tcpin":
            return TcpServer(place)
        case "tcpout":
            return TcpClient(place)
        case "serial":
            return SerialEndpoint(place)


class UdpEndpoint:
    """One UDP socket: bound to the address (``udpin``), or sending to it first (``udpout``)."""

    def __init__(self, address: Address) -> None:
        family, target = _resolve(address, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        # a burst of telemetry from a hundred vehicles must fit while the other side computes
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self._peers: dict[Peer, None] = {}
        if address.kind == "udpout":
            self._peers[target] = None
            self._address = address
        else:
            _bind(self._socket, target, address)
            self._address = replace(address, port=self._socket.getsockname()[1])

    @property
    def url(self) -> str:
        """Where it listens or sends to; the port is the real one where 0 was asked for."""
        return str(self._address)

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return all datagrams that wait, each with its sender's (host, port)."""
        datagrams: list[tuple[bytes, Peer]] = []
        while self._socket.fileno() >= 0:
            try:
                data, peer = self._socket.recvfrom(_DATAGRAM_MAX)
            except BlockingIOError:
                break
            except (ConnectionResetError, ConnectionRefusedError):  # an earlier datagram found a closed port
                continue
            if peer not in self._peers and len(self._peers) >= _PEERS_MAX:  # somebody speaks from ever new ports
                self._peers.pop(next(iter(self._peers)))
            self._peers[peer] = self._peers.pop(peer, None)  # the one heard last stands last
            datagrams.append((data, peer))
        return datagrams

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Send one datagram; one that the system will not take is lost, as on any UDP link."""
        for target in [peer] if peer is not None else list(self._peers):
            with contextlib.suppress(OSError):
                self._socket.sendto(data, target)  # type: ignore[call-overload]

    def filenos(self) -> list[int]:
        """Return the socket's descriptor."""
        return [fd for fd in (self._socket.fileno(),) if fd >= 0]

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class _Stream:
    """One TCP connection; what the system does not take at once waits here."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket = connection
        self.open = True
        self._unsent = bytearray()

    def receive(self) -> bytes:
        self.flush()
        pieces = bytearray()
        while self.open:
            try:
                piece = self.socket.recv(_DATAGRAM_MAX)
            except BlockingIOError:
                break
            except OSError:
                piece = b""
            if not piece:
                self.close()
            pieces += piece
        return bytes(pieces)

    def send(self, data: bytes) -> None:
        self._unsent += data
        self.flush()
        if len(self._unsent) > _UNREAD_MAX:
            self.close()

    def flush(self) -> None:
        while self.open and self._unsent:
            try:
                sent = self.socket.send(self._unsent)
            except BlockingIOError:
                break
            except OSError:
                self.close()
                break
            del self._unsent[:sent]

    def close(self) -> None:
        self.open = False
        self.socket.close()


class TcpServer:
    """A listening TCP port; every client is a peer."""

    def __init__(self, address: Address) -> None:
        family, target = _resolve(address, socket.SOCK_STREAM)
        self._listener = socket.socket(family, socket.SOCK_STREAM)
        if os.name == "posix":  # elsewhere the option means sharing the port with a stranger
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        _bind(self._listener, target, address)
        self._listener.listen()
        self._listener.setblocking(False)
        self._address = replace(address, port=self._listener.getsockname()[1])
        self._clients: dict[Peer, _Stream] = {}

    @property
    def url(self) -> str:
        """Where it listens; the port is the real one where 0 was asked for."""
        return str(self._address)

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Accept who waits, forget who left, return what the others sent."""
        while self._listener.fileno() >= 0:
            try:
                connection, peer = self._listener.accept()
            except OSError:  # nobody waits, or left before being accepted
                break
            self._clients[peer] = _Stream(connection)
        arrived = [(stream.receive(), peer) for peer, stream in self._clients.items()]
        self._clients = {peer: stream for peer, stream in self._clients.items() if stream.open}
        return [(data, peer) for data, peer in arrived if data]

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Send to one client, or to all; clients that left are skipped."""
        for name, stream in self._clients.items():
            if stream.open and peer in (None, name):
                stream.send(data)

    def filenos(self) -> list[int]:
        """Return the descriptors of the port and of all clients."""
        streams = [stream.socket.fileno() for stream in self._clients.values() if stream.open]
        return [fd for fd in (self._listener.fileno(), *streams) if fd >= 0]

    def close(self) -> None:
        """Close the port and all connections."""
        self._listener.close()
        for stream in self._clients.values():
            stream.close()
        self._clients.clear()


class TcpClient:
    """A TCP connection to a server, which is its only peer; it is made anew when it breaks."""

    def __init__(self, address: Address) -> None:
        self._address = address
        self._family, self._target = _resolve(address, socket.SOCK_STREAM)
        self._peer: Peer = self._target
        connection = socket.socket(self._family, socket.SOCK_STREAM)
        connection.settimeout(_TCP_CONNECT_TIMEOUT_S)
        try:
            connection.connect(self._target)
        except OSError as error:
            connection.close()
            raise LinkError(
                f"{address}: expected a vehicle listening there, got: {error.strerror or error}; "
                "start the vehicle or simulator first, or correct the address"
            ) from error
        self._stream = _Stream(connection)
        self._closed = False
        self._retry_s = 0.0

    @property
    def url(self) -> str:
        """Where it is connected to."""
        return str(self._address)

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return what the server sent; try, about once a second, to get a broken connection back."""
        data = self._stream.receive() if self._stream.open else b""
        if not self._stream.open and not self._closed and time.monotonic() >= self._retry_s:
            self._retry_s = time.monotonic() + _RETRY_S
            connection = socket.socket(self._family, socket.SOCK_STREAM)
            connection.setblocking(False)
            # in progress at best: reading fails, and closes it again, should it come to nothing
            if connection.connect_ex(self._target) in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
                self._stream = _Stream(connection)
            else:
                connection.close()
        return [(data, self._peer)] if data else []

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Send to the server; lost while the connection is broken."""
        if self._stream.open and peer in (None, self._peer):
            self._stream.send(data)

    def filenos(self) -> list[int]:
        """Return the connection's descriptor while it is open."""
        return [self._stream.socket.fileno()] if self._stream.open else []

    def close(self) -> None:
        """Close the connection for good."""
        self._closed = True
        self._stream.close()


class SerialEndpoint:
    """A serial line: a telemetry radio or a USB cable, opened anew when it was pulled out and comes back."""

    def __init__(self, address: Address) -> None:
        self._address = address
        try:
            self._port = serial.Serial(address.host, address.baud, timeout=0, write_timeout=0)
        except (serial.SerialException, ValueError) as error:
            raise LinkError(
                f"{address}: expected a serial device that can be opened, got: {error}; "
                "check the cable, the name and your permission to use it"
            ) from error
        self._closed = False
        self._retry_s = 0.0

    @property
    def url(self) -> str:
        """The device and its rate."""
        return str(self._address)

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return the bytes that wait; nothing while the device is gone, which is tried about once a second."""
        if not (self._port.is_open or self._closed) and time.monotonic() >= self._retry_s:
            self._retry_s = time.monotonic() + _RETRY_S
            with contextlib.suppress(serial.SerialException, OSError):
                self._port.open()
        try:
            data = self._port.read(_DATAGRAM_MAX) if self._port.is_open else b""
        except (serial.SerialException, OSError):
            self._port.close()
            data = b""
        return [(data, self._address.host)] if data else []

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Queue the bytes; what the line cannot take is lost, as on a radio."""
        if self._port.is_open and peer in (None, self._address.host):
            with contextlib.suppress(serial.SerialException, OSError):
                self._port.write(data)

    def filenos(self) -> list[int]:
        """Return the device's descriptor where the system has one."""
        try:
            return [self._port.fileno()] if self._port.is_open else []
        except (AttributeError, OSError):  # Windows has none
            return []

    def close(self) -> None:
        """Close the device for good."""
        self._closed = True
        self._port.close()


class InProcessEndpoint:
    """One end of a pipe within the process: no sockets, nothing lost, same order every time."""

    def __init__(self, url: str, inbox: deque[bytes], outbox: deque[bytes]) -> None:
        self._url = url
        self._inbox = inbox
        self._outbox = outbox
        self._open = True

    @property
    def url(self) -> str:
        """The name that the pipe was given."""
        return self._url

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return what the other end has sent; the peer is the pipe's name."""
        pieces: list[tuple[bytes, Peer]] = [(data, self._url) for data in self._inbox]
        self._inbox.clear()
        return pieces

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        """Hand the bytes to the other end."""
        if self._open and peer in (None, self._url):
            self._outbox.append(data)

    def filenos(self) -> list[int]:
        """There is nothing to wait on."""
        return []

    def close(self) -> None:
        """Send nothing more."""
        self._open = False


def in_process_pair(name: str = "in-process") -> tuple[InProcessEndpoint, InProcessEndpoint]:
    """Return the two ends of a pipe within this process."""
    there: deque[bytes] = deque()
    back: deque[bytes] = deque()
    return InProcessEndpoint(name, there, back), InProcessEndpoint(name, back, there)


_SocketAddress = tuple[str, int] | tuple[str, int, int, int]


def _resolve(address: Address, kind: socket.SocketKind) -> tuple[socket.AddressFamily, _SocketAddress]:
    try:
        family, _, _, _, target = socket.getaddrinfo(address.host, address.port, type=kind)[0]
    except OSError as error:
        raise LinkError(f"{address}: expected a known host, got {address.host!r}: {error.strerror or error}") from error
    return family, target  # type: ignore[return-value]


def _bind(listener: socket.socket, target: _SocketAddress, address: Address) -> None:
    try:
        listener.bind(target)
    except OSError as error:
        listener.close()
        raise LinkError(
            f"{address}: cannot listen there: {error.strerror or error}; "
            "stop the other program that uses the port, or choose another"
        ) from error
