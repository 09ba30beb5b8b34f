"""N simulated vehicles behind their MAVLink links, in one thread and on one clock that somebody else advances."""

from __future__ import annotations

import math
import select
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint, Peer, open_endpoint, parse_url
from missionplanner.autopilot_parameters import held
from missionplanner.errors import LinkError, MissionError
from missionplanner.geodesy import FloatArray, GeoPoint, LocalFrame
from missionplanner.mission import VehicleSettings
from missionplanner.motion import TICK_S, Navigator
from missionplanner.plan import FleetPlan
from missionplanner.vehicle import Autopilot as AutopilotName
from missionplanner.vehicle import MotionModel, VehicleClass, motion_model
from sim.autopilot import Autopilot, Ground
from sim.misbehaviour import Fault, MisbehavingLink
from sim.mission_service import Outgoing
from sim.personality import personality
from sim.telemetry import Motion
from sim.vehicle_link import COMPONENT_ID, VehicleLink

_DATAGRAM_BYTES = 1_400  # several messages share a datagram up to this size
_PEERS_MAX = 256
_MOVING_M_S = 0.3
_AIRBORNE_M = 1.0  # above its home, the wind turns a plane's nose away from its course
_LAG_MAX_S = 0.5  # real time; a computer that cannot keep up runs the simulation slower instead of in bursts
_SYSTEM_MAX = 250
_LISTEN_PORT_STEP = 10  # as ArduPilot's SITL instances have it


@dataclass(frozen=True, slots=True, eq=False)
class SimVehicle:
    """One vehicle to simulate, standing at home."""

    sysid: int
    autopilot: AutopilotName
    vehicle_class: VehicleClass
    home: GeoPoint
    motion: MotionModel
    late_s: float = 0.0  # how much later than told it takes off
    faults: tuple[Fault, ...] = ()  # how it misbehaves


class SimFleet:
    """Simulated vehicles that speak MAVLink on endpoints.

    Parameters
    ----------
    vehicles : with different sysids
    frame : local frame to move in; by default centred on the first home
    ground : ground altitude AMSL at (x_m, y_m) of the frame, where vehicles land; by default each vehicle's home's
    seed : of what is left to chance: headings, and when within a second slow messages are sent
    position_hz : rate of GLOBAL_POSITION_INT
    cold_start : whether vehicles need as long to get ready as real ones after power-up; else they are warmed up
    """

    def __init__(
        self,
        vehicles: Sequence[SimVehicle],
        *,
        frame: LocalFrame | None = None,
        ground: Ground | None = None,
        seed: int = 1,
        position_hz: float = 5.0,
        cold_start: bool = False,
    ) -> None:
        if not vehicles or len({v.sysid for v in vehicles}) < len(vehicles):
            raise MissionError("simulator: expected at least one vehicle, each with a sysid of its own")
        self.vehicles = tuple(vehicles)
        self.frame = frame or LocalFrame(vehicles[0].home.lat_deg, vehicles[0].home.lon_deg)
        rng = np.random.default_rng(seed)
        homes_m = np.array(
            [self.frame.to_local(v.home.lat_deg, v.home.lon_deg, v.home.alt_amsl_m) for v in vehicles]
        ).reshape(-1, 3)
        self.navigator = Navigator([v.motion for v in vehicles], homes_m)
        self.links: list[VehicleLink] = []
        self._course_rad = rng.uniform(0.0, 2.0 * math.pi, len(vehicles))
        self._nose_rad = self._course_rad
        self._wind_m_s = np.array([v.motion.wind_m_s for v in vehicles])
        self._ground_amsl_m = np.where([v.vehicle_class == "plane" for v in vehicles], homes_m[:, 2], np.inf)
        self._geo_tick = -1
        self._geo: tuple[FloatArray, FloatArray] = (np.empty(0), np.empty(0))
        for i, vehicle in enumerate(vehicles):
            kind = personality(vehicle.autopilot, vehicle.vehicle_class)
            sysid_name = "SYSID_THISMAV" if vehicle.autopilot == "ardupilot" else "MAV_SYS_ID"
            moving = held((vehicle.autopilot, vehicle.vehicle_class), vehicle.motion)
            parameters = {sysid_name: vehicle.sysid, **moving, **kind.parameters}
            autopilot = Autopilot(
                kind,
                motion=vehicle.motion,
                navigator=self.navigator,
                index=i,
                frame=self.frame,
                ground=ground or _level(vehicle.home.alt_amsl_m),
                parameters=parameters,
                cold_start=cold_start,
                late_s=vehicle.late_s,
            )
            phase_s = TICK_S * int(rng.integers(0, round(0.2 / TICK_S)))
            kind_of_link = partial(MisbehavingLink, faults=vehicle.faults) if vehicle.faults else VehicleLink
            link = kind_of_link(
                vehicle.sysid,
                autopilot,
                partial(self._motion, i),
                self.frame,
                position_hz=position_hz,
                phase_s=phase_s,
                cold_start=cold_start,
            )
            self.links.append(link)
        self._ports: list[_Port] = []
        self._ports_of: list[list[_Port]] = [[] for _ in vehicles]
        self._tick = 0
        self._waypoint = self.navigator.waypoint.copy()
        self._finished = self.navigator.finished.copy()
        self._wake_s = np.full(len(vehicles), -math.inf)
        self.answered = False  # whether the last tick sent a reply to somebody

    @property
    def now_s(self) -> float:
        """Simulated time since power-up."""
        return self._tick * TICK_S

    def attach(self, endpoint: Endpoint, vehicles: Sequence[int] | None = None) -> None:
        """Let vehicles (by their place in the fleet; None: all) speak on an endpoint."""
        members = list(range(len(self.links))) if vehicles is None else list(vehicles)
        port = _Port(endpoint, members, {i: _encoder(self.links[i].sysid) for i in members})
        self._ports.append(port)
        for i in members:
            self._ports_of[i].append(port)

    def endpoints(self) -> list[Endpoint]:
        """Return the endpoints that the fleet speaks on."""
        return [port.endpoint for port in self._ports]

    def close(self) -> None:
        """Close all endpoints."""
        for port in self._ports:
            port.endpoint.close()

    def advance(self, duration_s: float) -> None:
        """Advance simulated time by whole ticks, at least ``duration_s``, obeying what arrives meanwhile."""
        for _ in range(math.ceil(duration_s / TICK_S - 1e-9)):
            self.poll()
            self.step()

    def step(self) -> None:
        """Move everybody by one tick and tell of it."""
        self.navigator.step()
        self._tick += 1
        now_s = self.now_s
        waypoint, finished = self.navigator.waypoint, self.navigator.finished
        changed = (waypoint != self._waypoint) | (finished != self._finished)
        for i in np.flatnonzero(changed | (self._wake_s <= now_s)).tolist():
            link = self.links[i]
            link.autopilot.update(now_s)
            self._send(i, link.poll(now_s))
            # a new route may be over at once, so look again at the next tick
            self._wake_s[i] = -math.inf if changed[i] else self._wake(i)
        np.copyto(self._waypoint, self.navigator.waypoint)
        self._finished = self.navigator.finished
        for port in self._ports:
            port.flush()

    def poll(self) -> None:
        """Obey and answer what has arrived, without time passing."""
        now_s = self.now_s
        self.answered = False
        for port in self._ports:
            for message, peer in port.receive():
                for i in port.members:
                    replies = self.links[i].receive(message, (port, peer), now_s)
                    self._send(i, replies)
                    if replies:
                        self.answered = True
                    self._wake_s[i] = -math.inf
        if self.answered:
            for port in self._ports:
                port.flush()

    def _wake(self, i: int) -> float:
        link = self.links[i]
        return min(link.wake_s, link.autopilot.wake_s)

    def _send(self, i: int, messages: Sequence[Outgoing]) -> None:
        for link, message in messages:
            if link is None:
                for port in self._ports_of[i]:
                    port.send(i, message, None)
            else:
                port, peer = cast("tuple[_Port, Peer]", link)
                port.send(i, message, peer)
                self.answered = True

    def _motion(self, i: int) -> Motion:
        if self._geo_tick != self._tick:
            lat_deg, lon_deg, _ = self.frame.to_geo(self.navigator.position_m)
            self._geo = lat_deg, lon_deg
            velocity = self.navigator.velocity_m_s
            moving = np.hypot(velocity[:, 0], velocity[:, 1]) > _MOVING_M_S
            course = np.arctan2(velocity[:, 0], velocity[:, 1]) % (2.0 * math.pi)
            self._course_rad = np.where(moving, course, self._course_rad)
            through = velocity[:, :2] - self._wind_m_s
            crabbing = self.navigator.position_m[:, 2] > self._ground_amsl_m + _AIRBORNE_M
            nose = np.arctan2(through[:, 0], through[:, 1]) % (2.0 * math.pi)
            self._nose_rad = np.where(crabbing, nose, self._course_rad)
            self._geo_tick = self._tick
        return Motion(
            float(self._geo[0][i]),
            float(self._geo[1][i]),
            self.navigator.position_m[i],
            self.navigator.velocity_m_s[i],
            float(self._course_rad[i]),
            float(self._nose_rad[i]),
            self.vehicles[i].motion.wind_m_s,
        )


class _Port:
    """One endpoint of the fleet: whose frames go out there, and who is heard there."""

    def __init__(self, endpoint: Endpoint, members: list[int], encoders: dict[int, Any]) -> None:
        self.endpoint = endpoint
        self.members = members
        self._encoders = encoders
        self._parsers: dict[Peer, Any] = {}
        self._pending: dict[tuple[int, Peer | None], bytearray] = {}

    def receive(self) -> list[tuple[Any, Peer]]:
        messages = []
        for data, peer in self.endpoint.receive():
            parser = self._parsers.get(peer)
            if parser is None:
                if len(self._parsers) >= _PEERS_MAX:  # somebody speaks from ever new ports
                    self._parsers.pop(next(iter(self._parsers)))
                parser = self._parsers[peer] = _encoder(0)
            for message in parser.parse_buffer(data) or ():
                if message.get_type() != "BAD_DATA":
                    messages.append((message, peer))  # noqa: PERF401
        return messages

    def send(self, member: int, message: Any, peer: Peer | None) -> None:
        frame = message.pack(self._encoders[member])
        pending = self._pending.setdefault((member, peer), bytearray())
        if len(pending) + len(frame) > _DATAGRAM_BYTES:
            self.endpoint.send(bytes(pending), peer)
            pending.clear()
        pending += frame
        encoder = self._encoders[member]
        encoder.seq = (encoder.seq + 1) % 256

    def flush(self) -> None:
        if not self._pending:
            return
        for (_, peer), pending in self._pending.items():
            self.endpoint.send(bytes(pending), peer)
        self._pending.clear()


def _level(alt_amsl_m: float) -> Ground:
    return lambda _x_m, _y_m: alt_amsl_m


def _encoder(sysid: int) -> Any:
    encoder = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=COMPONENT_ID)
    encoder.robust_parsing = True
    return encoder


class LockstepClock:
    """The clock of a ground station that flies simulated vehicles: time passes only while it waits.

    Waiting advances the simulation, as fast as it computes or (``speedup``) paced to that many times real time. It ends
    early once a vehicle has answered, so that dialogues take no longer than they must.
    """

    def __init__(self, fleet: SimFleet, speedup: float | None = None) -> None:
        self._fleet = fleet
        self._until_s = fleet.now_s
        self._pace = None if speedup is None else _Pace(speedup, fleet.now_s)

    def now_s(self) -> float:
        """Return simulated seconds."""
        return self._fleet.now_s

    def wait(self, seconds: float) -> None:
        """Let at most ``seconds`` of simulated time pass."""
        fleet = self._fleet
        fleet.poll()
        self._until_s = max(self._until_s, fleet.now_s) + seconds
        while fleet.now_s + TICK_S <= self._until_s + 1e-9:
            if fleet.answered:
                self._until_s = fleet.now_s
                return
            fleet.step()
            if not fleet.answered:
                fleet.poll()  # whoever would send waits here, but what a slow link carries may arrive
            if self._pace is not None:
                time.sleep(self._pace.ahead_s(fleet.now_s))


class _Pace:
    """Keeps simulated time at a multiple of real time."""

    def __init__(self, speedup: float, now_s: float) -> None:
        if not (math.isfinite(speedup) and speedup > 0.0):
            raise MissionError(f"speedup: expected a number above 0, got {speedup}")
        self._speedup = speedup
        self._anchor_s = time.monotonic() - now_s / speedup

    def ahead_s(self, now_s: float) -> float:
        """Return the real time to sleep until simulated time ``now_s`` has come."""
        ahead_s = self._anchor_s + now_s / self._speedup - time.monotonic()
        if ahead_s < -_LAG_MAX_S:
            self._anchor_s -= ahead_s + _LAG_MAX_S
        return max(ahead_s, 0.0)


def serve(fleet: SimFleet, speedup: float = 1.0, stop: Callable[[], bool] = lambda: False) -> None:
    """Run a fleet at ``speedup`` times real time until ``stop()``; what arrives is answered at once."""
    pace = _Pace(speedup, fleet.now_s)
    while not stop():
        fleet.poll()
        fleet.step()
        due_s = time.monotonic() + pace.ahead_s(fleet.now_s)
        while (left_s := due_s - time.monotonic()) > 0.0:
            descriptors = [fd for endpoint in fleet.endpoints() for fd in endpoint.filenos()]
            if not descriptors:
                time.sleep(left_s)
            elif select.select(descriptors, [], [], left_s)[0]:
                fleet.poll()


def sim_vehicles(
    count: int,
    home: GeoPoint,
    *,
    autopilot: AutopilotName = "ardupilot",
    vehicle_class: VehicleClass = "copter",
    spacing_m: float = 10.0,
) -> list[SimVehicle]:
    """Return vehicles with default motion and sysids from 1; homes stand ``spacing_m`` apart, from ``home`` eastwards.

    Raises
    ------
    MissionError
        A count that MAVLink has no sysids for.
    """
    if not 1 <= count <= _SYSTEM_MAX:
        raise MissionError(f"vehicles: expected 1 to {_SYSTEM_MAX}, got {count}")
    motion = motion_model(VehicleSettings(autopilot=autopilot, vehicle_class=vehicle_class))
    frame = LocalFrame(home.lat_deg, home.lon_deg)
    homes = [frame.geo_point([spacing_m * i, 0.0, home.alt_amsl_m]) for i in range(count)]
    return [SimVehicle(i + 1, autopilot, vehicle_class, place, motion) for i, place in enumerate(homes)]


def planned_vehicles(
    plan: FleetPlan, *, wind_m_s: tuple[float, float] | None = None, late_s: Mapping[str, float] | None = None
) -> list[SimVehicle]:
    """Return the vehicles of a plan, standing at their homes: to be simulated in ``plan.frame``.

    A rehearsal may disturb them in ways that the plan does not know of: ``wind_m_s`` (east, north) blows instead of the
    wind planned for, vehicles named in ``late_s`` take off so much later than told.

    Raises
    ------
    MissionError
        A name in ``late_s`` is no vehicle's.
    """
    late = late_s or {}
    unknown = set(late) - {v.name for v in plan.vehicles}
    if unknown:
        names = ", ".join(v.name for v in plan.vehicles)
        raise MissionError(f"late start: expected names of vehicles ({names}), got {', '.join(sorted(unknown))}")
    return [
        SimVehicle(
            v.sysid,
            v.autopilot,
            v.vehicle_class,
            plan.frame.geo_point(v.home_m),
            v.motion if wind_m_s is None else replace(v.motion, wind_m_s=wind_m_s),
            late.get(v.name, 0.0),
        )
        for v in plan.vehicles
    ]


Through = Callable[[Endpoint], Endpoint]
"""What an endpoint is put behind, as a bad link is."""


def connect_fleet(fleet: SimFleet, url: str, through: Through = lambda endpoint: endpoint) -> None:
    """Let every vehicle send to one address (``--connect``), each from a port of its own, as SITLs do.

    Raises
    ------
    LinkError
        A malformed URL, or one that cannot be connected to.
    """
    address = parse_url(url)
    if address.kind.endswith("in"):
        raise LinkError(f"{url}: expected an address to connect to, e.g. udpout:127.0.0.1:14540; use --listen to wait")
    if address.kind == "serial":
        fleet.attach(through(open_endpoint(address)))
        return
    for i in range(len(fleet.links)):
        fleet.attach(through(open_endpoint(address)), [i])


def listen_fleet(fleet: SimFleet, url: str, through: Through = lambda endpoint: endpoint) -> None:
    """Let vehicle i (from 1) listen on the address's port + 10 (i - 1) (``--listen``).

    Raises
    ------
    LinkError
        A malformed URL, or a port in use.
    """
    address = parse_url(url).listening()
    for i in range(len(fleet.links)):
        fleet.attach(through(open_endpoint(address.with_port_offset(_LISTEN_PORT_STEP * i))), [i])
