"""MAVLink messages to and from vehicles over any number of endpoints; who is where is learned from who speaks.

A vehicle is known by its sysid. Two sources with one sysid would each get the other's mission: that is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint, Peer
from adapters.mission_protocol import AUTOPILOT_COMPONENT, OWN_COMPONENT, OWN_SYSID
from adapters.telemetry_log import FleetLog
from missionplanner.errors import LinkError

Message = Any  # a pymavlink message: its classes are generated, and carry no types

_HEARTBEAT_S = 1.0
_MOVED_AFTER_S = 5.0  # a vehicle silent for this long may come back from another address
_PEERS_MAX = 256  # of an endpoint, whose pieces of frames are kept


@dataclass(slots=True)
class _Route:
    endpoint: int
    peer: Peer
    heard_s: float


class PymavlinkLink:
    """One ground station on many endpoints."""

    def __init__(self, endpoints: Sequence[Endpoint], log: FleetLog | None = None) -> None:
        self._endpoints = endpoints
        self._log = log
        self._parsers: dict[tuple[int, Peer], Any] = {}
        self._senders = [_codec() for _ in endpoints]
        self._routes: dict[int, _Route] = {}
        self._beat_s = -_HEARTBEAT_S
        self._keeps_to_routes = False
        self._pinned: set[int] = set()
        self._elsewhere: dict[int, str] = {}  # where else pinned vehicles were heard, once silent
        self.strangers: dict[int, int] = {}  # messages that were dropped since, by sysid

    @property
    def urls(self) -> str:
        """All endpoints, for messages to users."""
        return ", ".join(endpoint.url for endpoint in self._endpoints)

    def receive(self, now_s: float) -> list[Message]:
        """Return the messages of autopilots that have arrived, each valid and from a known place.

        Raises
        ------
        LinkError
            Two vehicles share one sysid, before :meth:`keep_to_routes`.
        """
        if now_s - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = now_s
            self._beat()
        messages: list[Message] = []
        for index, endpoint in enumerate(self._endpoints):
            for data, peer in endpoint.receive():
                parser = self._parsers.get((index, peer))
                if parser is None:
                    if len(self._parsers) >= _PEERS_MAX * len(self._endpoints):  # somebody speaks from ever new ports
                        self._parsers.pop(next(iter(self._parsers)))
                    parser = self._parsers[index, peer] = _codec()
                for message in parser.parse_buffer(data) or ():
                    if self._from_vehicle(message) and self._learn(message, index, peer, now_s):
                        self._write(now_s, message.get_srcSystem(), message.get_msgbuf())
                        messages.append(message)
        return messages

    def send(self, message: Message, sysid: int, now_s: float) -> None:
        """Send to the place where the vehicle was heard.

        Raises
        ------
        LinkError
            The vehicle was never heard.
        """
        route = self._routes.get(sysid)
        if route is None:
            raise LinkError(f"sysid {sysid}: expected it on {self.urls}, never heard of it")
        frame = self._pack(message, route.endpoint)
        self._endpoints[route.endpoint].send(frame, route.peer)
        self._write(now_s, sysid, frame)

    def pass_on(self, message: Message, sysids: Iterable[int], now_s: float) -> None:
        """Send another station's message, as it signs itself: to its target, or to all of these vehicles if to all."""
        target = getattr(message, "target_system", 0)
        for sysid in sysids if target == 0 else {target}.intersection(sysids):
            route = self._routes.get(sysid)
            if route is not None:
                frame = bytes(message.get_msgbuf())
                self._endpoints[route.endpoint].send(frame, route.peer)
                self._write(now_s, sysid, frame)

    def pin(self, sysid: int) -> None:
        """From now on, hear a vehicle only where it was heard, however long it is silent: who it is has been asked."""
        self._pinned.add(sysid)
        self._elsewhere.pop(sysid, None)

    def unpin(self, sysid: int) -> None:
        """From now on, let a vehicle come back from another place when it has been silent there: it flies."""
        self._pinned.discard(sysid)
        self._elsewhere.pop(sysid, None)

    def elsewhere(self, sysid: int) -> str | None:
        """Return the place at which somebody spoke in a pinned vehicle's name while it was silent; None: nobody did."""
        return self._elsewhere.get(sysid)

    def keep_to_routes(self) -> None:
        """From now on, drop what comes from elsewhere in a vehicle's name, instead of refusing both: they fly."""
        self._keeps_to_routes = True

    def close(self) -> None:
        """Close all endpoints."""
        for endpoint in self._endpoints:
            endpoint.close()

    def _beat(self) -> None:
        message = mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        )
        for index, endpoint in enumerate(self._endpoints):
            endpoint.send(self._pack(message, index))

    def _pack(self, message: Message, endpoint: int) -> bytes:
        sender = self._senders[endpoint]
        frame: bytes = bytes(message.pack(sender))
        sender.seq = (sender.seq + 1) % 256
        return frame

    def _from_vehicle(self, message: Message) -> bool:
        if message.get_type() == "BAD_DATA" or message.get_srcComponent() != AUTOPILOT_COMPONENT:
            return False
        is_station = message.get_type() == "HEARTBEAT" and message.type == mavlink.MAV_TYPE_GCS
        return message.get_srcSystem() not in (0, OWN_SYSID) and not is_station

    def _learn(self, message: Message, endpoint: int, peer: Peer, now_s: float) -> bool:
        """Note where a vehicle is heard; return whether it is there that it is to be heard."""
        sysid = message.get_srcSystem()
        route = self._routes.get(sysid)
        if route is not None and (route.endpoint, route.peer) != (endpoint, peer):
            if now_s - route.heard_s >= _MOVED_AFTER_S and sysid in self._pinned:
                self._elsewhere[sysid] = f"{self._endpoints[endpoint].url} from {_place(peer)}"
                return False
            if now_s - route.heard_s < _MOVED_AFTER_S:
                if self._keeps_to_routes:
                    self.strangers[sysid] = self.strangers.get(sysid, 0) + 1
                    return False
                places = [
                    f"{self._endpoints[e].url} from {_place(p)}"
                    for e, p in ((route.endpoint, route.peer), (endpoint, peer))
                ]
                raise LinkError(
                    f"sysid {sysid}: expected one vehicle, heard two: {' and '.join(places)}; "
                    "give each vehicle its own sysid (ArduPilot SYSID_THISMAV, PX4 MAV_SYS_ID)"
                )
            route = None
        if route is None:
            self._routes[sysid] = _Route(endpoint, peer, now_s)
        else:
            route.heard_s = now_s
        return True

    def _write(self, now_s: float, sysid: int, frame: bytes) -> None:
        if self._log is not None:
            self._log.write(now_s, sysid, bytes(frame))


def _codec() -> Any:
    codec = mavlink.MAVLink(None, srcSystem=OWN_SYSID, srcComponent=OWN_COMPONENT)
    codec.robust_parsing = True  # what is damaged comes out as BAD_DATA, not as an exception
    return codec


def _place(peer: Peer) -> str:
    return ":".join(str(part) for part in peer[:2]) if isinstance(peer, tuple) else str(peer)
