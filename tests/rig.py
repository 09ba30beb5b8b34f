"""A fleet plan, simulated vehicles and a ground station on links that a test can meddle with, in lock-step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint, InProcessEndpoint, Peer, WrappedEndpoint, in_process_pair
from adapters.fleet_link import FleetLink
from adapters.telemetry_log import FleetLog
from missionplanner.plan import FleetPlan
from sim.fleet import LockstepClock, SimFleet, SimVehicle, planned_vehicles

Edit = Callable[[Any], Any]
"""Takes a message, returns it (changed or not), or None to lose it."""


def untouched(message: Any) -> Any:
    return message


class MeddledEndpoint(WrappedEndpoint):
    """The ground's end of a pipe on which messages are changed, lost or delayed."""

    def __init__(self, inner: InProcessEndpoint, down: Edit = untouched, up: Edit = untouched) -> None:
        super().__init__(inner)
        self.down = down  # from the vehicle
        self.up = up  # to the vehicle
        self._parsers = [mavlink.MAVLink(None), mavlink.MAVLink(None)]

    def receive(self) -> list[tuple[bytes, Peer]]:
        return [(frame, peer) for data, peer in self._inner.receive() if (frame := self._edited(data, 0, self.down))]

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        if frame := self._edited(data, 1, self.up):
            self._inner.send(frame, peer)

    def _edited(self, data: bytes, way: int, edit: Edit) -> bytes:
        frames = b""
        for message in self._parsers[way].parse_buffer(data) or ():
            edited = edit(message)
            if edited is not None:
                codec = mavlink.MAVLink(
                    None, srcSystem=message.get_srcSystem(), srcComponent=message.get_srcComponent()
                )
                codec.seq = message.get_seq()
                frames += bytes(edited.pack(codec))
        return frames


class Rig:
    """Vehicle k of the plan behind pipe k."""

    def __init__(
        self,
        plan: FleetPlan,
        *,
        log: FleetLog | None = None,
        vehicles: Sequence[SimVehicle] | None = None,
        **fleet_options: Any,
    ) -> None:
        self.sim = SimFleet(planned_vehicles(plan) if vehicles is None else vehicles, frame=plan.frame, **fleet_options)
        self.pipes: list[MeddledEndpoint] = []
        for k, vehicle in enumerate(plan.vehicles):
            ground, air = in_process_pair(f"pipe-{vehicle.name}")
            self.sim.attach(air, [k])
            self.pipes.append(MeddledEndpoint(ground))
        self.clock = LockstepClock(self.sim)
        endpoints: list[Endpoint] = list(self.pipes)
        self.link = FleetLink(plan, endpoints, self.clock, log=log)

    def lose(self, share: float, seed: int) -> None:
        """Lose a share of all messages, each way."""
        rng = np.random.default_rng(seed)

        def maybe(message: Any) -> Any:
            return message if rng.random() >= share else None

        for pipe in self.pipes:
            pipe.down = pipe.up = maybe

    def upload(self) -> None:
        """Go up to the verified mission."""
        self.link.connect()
        self.link.upload()
        self.link.verify()

    def armed(self) -> list[bool]:
        """Return which vehicles are armed, by their own word."""
        return [link.autopilot.armed for link in self.sim.links]


class Merged:
    """Two pipes as one address, as a router or two radios on one channel make them."""

    def __init__(self, *ends: Any) -> None:
        self._ends = ends

    @property
    def url(self) -> str:
        return "router"

    def receive(self) -> list[tuple[bytes, Peer]]:
        return [(data, "router") for end in self._ends for data, _ in end.receive()]

    def send(self, data: bytes, peer: Peer | None = None) -> None:
        for end in self._ends:
            end.send(data)

    def filenos(self) -> list[int]:
        return []

    def close(self) -> None:
        pass


def together(clock: LockstepClock, leader: SimFleet, other: SimFleet) -> None:
    """Let another fleet live by the same clock as its own."""
    wait = clock.wait

    def both(seconds: float) -> None:
        before_s = leader.now_s
        wait(seconds)
        other.advance(leader.now_s - before_s)

    clock.wait = both  # type: ignore[method-assign]
