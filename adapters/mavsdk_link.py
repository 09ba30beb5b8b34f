"""The second way onto the wire: MAVSDK uploads, over our own links, and our own read-back judges what came of it.

MAVSDK is given what is heard and sends through us, so that addresses, signing and logs are the same on both ways, and
each vehicle's frames go to it alone. It is an optional dependency, and works in real time only.
"""

from __future__ import annotations

import logging
import queue
from collections.abc import Sequence
from functools import cache
from types import TracebackType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.ground_station import Peer, Station, Steps
from adapters.mission_items import MissionItem
from missionplanner.errors import MissionError

_FOUND_S = 15.0  # until MAVSDK knows a vehicle that we know
_UPLOADED_S = 600.0


logger = logging.getLogger(__name__)


@cache  # told twice, it would forget whom its threads still tell
def _listen_to_its_log() -> None:
    """Take what it says of itself into our log, instead of letting it write to the terminal."""
    import mavsdk  # noqa: PLC0415

    def take(level: Any, text: str, file: str | None, line: int) -> bool:
        logger.debug("%s: %s (%s:%s)", level.name, text, file, line)
        return True

    mavsdk.log_subscribe(take)


class Mavsdk:
    """MAVSDK on a station's links, for as long as the block lasts.

    Raises
    ------
    MissionError
        It is not installed, or does not start.
    """

    def __init__(self, station: Station[Any]) -> None:
        try:
            import mavsdk  # noqa: PLC0415
            from mavsdk.plugins import mission_raw  # noqa: PLC0415
        except ImportError as error:
            raise MissionError(
                f"--via mavsdk: expected the package mavsdk, got: {error}; pip install 'missionplanner[mavsdk]', or "
                "leave --via out"
            ) from error
        _listen_to_its_log()
        self._station = station
        self._plugin: Any = mission_raw
        self._said: queue.SimpleQueue[bytes] = queue.SimpleQueue()  # from its threads
        self._results: dict[int, str] = {}
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        kind = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
        self._sdk: Any = mavsdk.Mavsdk(kind)
        result = self._sdk.add_any_connection("raw://")
        if result != mavsdk.ConnectionResult.SUCCESS:
            self._sdk.destroy()
            raise MissionError(f"--via mavsdk: expected it to work on our links, got {result}: leave --via out")
        self._sdk.subscribe_raw_bytes_to_be_sent(self._said.put)

    def __enter__(self) -> Mavsdk:
        self._station.beside = self
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._station.beside = None
        self._sdk.destroy()

    def hear(self, frame: bytes) -> None:
        """Give it a frame that has arrived."""
        self._sdk.pass_received_raw_bytes(frame)

    def said(self) -> list[Any]:
        """Return the messages that it wants sent."""
        messages: list[Any] = []
        while not self._said.empty():
            messages += self._parser.parse_buffer(self._said.get()) or ()
        return [message for message in messages if message.get_msgId() >= 0]

    def uploading(self, peer: Peer, items: Sequence[MissionItem]) -> Steps:
        """Let it upload a mission; whether the vehicle has it, the read-back must tell.

        Raises
        ------
        LinkError
            MAVSDK does not find the vehicle, or gives up.
        """
        clock, sysid = self._station.clock, peer.party.sysid
        end_s = clock.now_s() + _FOUND_S
        while (system := self._system(sysid)) is None:
            if clock.now_s() >= end_s:
                raise peer.error(f"MAVSDK does not find it within {_FOUND_S:g} s; leave --via out")
            yield
        raw = self._plugin.MissionRaw(system)
        fields = ("seq", "frame", "command", "current", "autocontinue", "param1", "param2", "param3", "param4")
        rows = [self._plugin.MissionItem(*(getattr(i, f) for f in fields), i.x, i.y, i.z, 0) for i in items]
        raw.upload_mission_async(rows, lambda result, _: self._results.update({sysid: result.name}))
        end_s = clock.now_s() + _UPLOADED_S
        while sysid not in self._results:
            if clock.now_s() >= end_s:
                raise peer.error(f"MAVSDK's upload has not ended within {_UPLOADED_S:g} s: upload again before flying")
            yield
        result = self._results.pop(sysid)
        if result != "SUCCESS":
            raise peer.error(
                f"MAVSDK's upload ended with {result}: the vehicle may hold a part of the mission: upload again before "
                "flying"
            )

    def _system(self, sysid: int) -> Any:
        known = (system for system in self._sdk.get_systems() if system.get_system_id() == sysid)
        return next((system for system in known if system.is_connected()), None)
