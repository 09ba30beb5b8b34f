"""A ground station without a plan: it takes in whoever it hears, and asks who they are before anything else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint
from adapters.ground_station import ANSWER_S, Clock, Peer, Station, Steps
from adapters.mission_items import wire_to_degrees
from adapters.mission_protocol import Party
from adapters.telemetry_log import FleetLog
from missionplanner.geodesy import GeoPoint
from missionplanner.mission import Vehicle

Message = Any  # a pymavlink message: its classes are generated, and carry no types


class Stranger(Peer):
    """A vehicle that no plan describes."""

    home: GeoPoint | None = None

    def receive(self, message: Message, now_s: float) -> list[Message]:
        """Take one message of this vehicle and return what to answer."""
        if message.get_type() == "HOME_POSITION":
            self.home = GeoPoint(
                wire_to_degrees(message.latitude), wire_to_degrees(message.longitude), message.altitude / 1e3
            )
        return super().receive(message, now_s)


class Listener(Station[Stranger]):
    """A ground station that takes in whoever it hears."""

    def __init__(self, endpoints: Sequence[Endpoint], clock: Clock, log: FleetLog | None) -> None:
        super().__init__({}, endpoints, clock, log)

    def met(self, sysid: int) -> None:
        """Take it in, called by its number until it has a name."""
        self.peers[sysid] = Stranger(Party(f"vehicle {sysid}", sysid))

    def acquaint(
        self, expected: Sequence[int] | None, asked: Mapping[int, Vehicle], timeout_s: float
    ) -> dict[int, Stranger]:
        """Wait for vehicles, those ``expected`` or all that are heard, ask each who it is, and return them by sysid.

        ``asked`` by sysid are a mission's vehicles: who has such a sysid must be that vehicle, and is called so.

        Raises
        ------
        LinkError
            Somebody is not heard in time, or only without a heartbeat; two vehicles have one sysid; one is of another
            kind than asked for, or another autopilot than the mission's uid says.
        """
        names = {sysid: f"{vehicle.name} (sysid {sysid})" for sysid, vehicle in asked.items()}
        wanted = None if expected is None else sorted(set(expected))
        self.wait_for(wanted, {sysid: names.get(sysid, f"sysid {sysid}") for sysid in wanted or ()}, timeout_s)
        peers = {k: peer for k, peer in sorted(self.peers.items()) if wanted is None or k in wanted}
        for sysid, peer in peers.items():
            if sysid in asked:
                peer.party = Party(asked[sysid].name, sysid)
        nothing = "nothing was read"
        self.together({k: self.identifying(peer) for k, peer in peers.items()}, after_failure=nothing)
        for sysid, peer in peers.items():
            vehicle = asked.get(sysid)
            kind = None if vehicle is None else (vehicle.autopilot, vehicle.vehicle_class)
            uids = () if vehicle is None or vehicle.uid is None else (vehicle.uid,)
            peer.expect_identity(kind, uids, f"the wrong vehicle, or correct the mission file; {nothing}")
        return peers

    def homing(self, peer: Stranger) -> Steps:
        """Ask a vehicle for its home; one without a home yet refuses."""
        home = mavlink.MAVLINK_MSG_ID_HOME_POSITION
        result = yield from self.commanding(peer, mavlink.MAV_CMD_REQUEST_MESSAGE, home)
        end_s = self.clock.now_s() + ANSWER_S
        while result == mavlink.MAV_RESULT_ACCEPTED and peer.home is None and self.clock.now_s() < end_s:
            yield


def by_sysid(vehicles: Sequence[Vehicle]) -> dict[int, Vehicle]:
    """Return a mission's vehicles by sysid: where it gives none, they are counted."""
    return {vehicle.sysid or index: vehicle for index, vehicle in enumerate(vehicles, start=1)}
