"""What vehicles hold, read from whoever is heard, to be kept as files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from adapters.backup import Saved, saving
from adapters.endpoint import Endpoint
from adapters.ground_station import Clock, Steps, TransferProgress
from adapters.guards import read_areas
from adapters.listener import Listener, Stranger
from adapters.mission_protocol import Party
from missionplanner.geodesy import GeoPoint
from missionplanner.mission import Vehicle


@dataclass(frozen=True, slots=True)
class Found:
    """What a vehicle holds, and its home; None: it has none yet."""

    saved: Saved
    home: GeoPoint | None

    @property
    def remarks(self) -> tuple[str, ...]:
        """What its files do not say as the vehicle means it."""
        name, home_items = self.saved.name, int(self.saved.autopilot == "ardupilot")
        told = []
        if len(self.saved.mission) <= home_items:
            told.append(f"{name}: holds no mission")
        if self.home is None and not home_items:
            told.append(f"{name}: has no home yet: its files take the first place of its mission for it")
        try:
            read_areas(self.saved.fence)
        except ValueError as error:
            told.append(f"{name}: its fence is in backup.json only, no .plan can say it ({error})")
        return tuple(told)


def download(
    endpoints: Sequence[Endpoint],
    clock: Clock,
    *,
    asked: Mapping[int, Vehicle] | None = None,
    expected: Sequence[int] | None = None,
    timeout_s: float = 30.0,
    progress: TransferProgress | None = None,
) -> tuple[Found, ...]:
    """Read missions, fences and rally points, and change nothing: of those expected, or of all that are heard.

    ``asked`` by sysid are a mission's vehicles, which they must be, by whose names they are saved; others are called
    after their sysid.

    Raises
    ------
    LinkError
        Nobody, or not everybody answers; a vehicle of a kind that we do not know, or another than asked for; two
        vehicles with one sysid.
    """
    station = Listener(endpoints, clock, None)
    peers = station.acquaint(expected, asked or {}, timeout_s)
    found: dict[int, Found] = {}

    def finding(sysid: int, peer: Stranger) -> Steps:
        if sysid not in (asked or {}):
            peer.party = Party(f"sysid{sysid}", sysid)
        saved = yield from saving(station, peer, progress)
        yield from station.homing(peer)
        peer.check_alone()  # still: what was read is one vehicle's
        found[sysid] = Found(saved, peer.home)

    station.together({k: finding(k, peer) for k, peer in peers.items()}, after_failure="nothing was written")
    return tuple(found[k] for k in peers)
