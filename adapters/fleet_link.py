"""A fleet on its links: find it, upload, verify, then start and watch it. Non-blocking beneath, timed by a clock.

The order is a rule: nothing is armed before every vehicle holds its mission as sent. What goes wrong is a
:class:`LinkError` that says how it leaves the fleet.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.backup import Saved, saving
from adapters.endpoint import Endpoint
from adapters.fleet_flight import FlightControl, ReadyProgress, WatchProgress
from adapters.fleet_vehicle import FleetVehicle, Order, VehicleStatus
from adapters.ground_station import Clock, Steps, TransferProgress, WallClock, telling
from adapters.guards import Guard, breach, fence_limits, limit_breach
from adapters.listener import Listener, Stranger
from adapters.mavsdk_link import Mavsdk
from adapters.mission_items import MissionItem
from adapters.mission_protocol import what_is_sent
from adapters.parameter_protocol import ParameterValue, mismatch
from adapters.return_settings import Setting, return_settings
from adapters.telemetry_log import FleetLog
from adapters.vehicle_parameters import Comparison, compared, reading_motion
from missionplanner.errors import LinkError
from missionplanner.geodesy import GeoPoint
from missionplanner.mission import Vehicle
from missionplanner.vehicle import Autopilot, VehicleClass

__all__ = [
    "Clock",
    "Downloaded",
    "FleetLink",
    "Order",
    "ParameterChange",
    "ReadyProgress",
    "TransferProgress",
    "VehicleStatus",
    "WallClock",
    "WatchProgress",
    "download_missions",
]

Message = Any  # a pymavlink message: its classes are generated, and carry no types


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A parameter that was set on a vehicle, which keeps it after the flight."""

    vehicle: str
    name: str
    before: float
    after: float

    def __str__(self) -> str:
        return f"{self.vehicle}: set {self.name} from {self.before:g} to {self.after:g}"


_UNREAD = "whoever is not named may hold its new mission, not read back; nothing was armed"


class FleetLink(FlightControl):
    """A ground station for one fleet plan: what comes before the flight."""

    @property
    def items(self) -> Mapping[int, tuple[MissionItem, ...]]:
        """The missions that are uploaded, by sysid."""
        return {sysid: vehicle.items for sysid, vehicle in self._vehicles.items()}

    @property
    def held(self) -> Mapping[int, tuple[MissionItem, ...]]:
        """The missions as the vehicles hold them, by sysid: what :meth:`verify` has read of those that passed it."""
        return {sysid: vehicle.held for sysid, vehicle in self._vehicles.items() if vehicle.held is not None}

    @property
    def guards(self) -> Mapping[int, Guard]:
        """The fences and rally points that are sent, by sysid."""
        return {sysid: vehicle.guard for sysid, vehicle in self._vehicles.items()}

    def connect(self, timeout_s: float = 30.0) -> None:
        """Wait until every vehicle of the plan is heard, and is what the plan takes it for.

        Raises
        ------
        LinkError
            Nobody, or not everybody answers; another autopilot or class of vehicle than planned, or another autopilot
            than the mission's uid; two vehicles with one sysid.
        """
        names = {sysid: f"{vehicle.plan.name} (sysid {sysid})" for sysid, vehicle in self._vehicles.items()}
        self._station.wait_for(list(self._vehicles), names, timeout_s)
        goings = {sysid: self._station.identifying(vehicle) for sysid, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was uploaded")
        for vehicle in self._vehicles.values():
            try:
                vehicle.check_identity()
            except LinkError as error:
                raise LinkError(f"{error}; nothing was uploaded") from error

    def compare_parameters(self) -> tuple[Comparison, ...]:
        """Read the parameters that decide how each vehicle moves, and compare them with what it was planned with.

        Raises
        ------
        LinkError
            A vehicle does not answer; nothing was changed.
        """
        found: dict[int, Comparison] = {}
        goings = {sysid: self._comparing(vehicle, found) for sysid, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was uploaded")
        return tuple(found[sysid] for sysid in self._vehicles)

    def holdings(self, progress: TransferProgress | None = None) -> tuple[Saved, ...]:
        """Read all missions, fences and rally points that the vehicles hold, as a backup.

        Raises
        ------
        LinkError
            A vehicle does not answer; nothing was changed.
        """
        found: dict[int, Saved] = {}
        goings = {sysid: self._saving(vehicle, progress, found) for sysid, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was uploaded")
        return tuple(found[sysid] for sysid in self._vehicles)

    def upload(
        self, progress: TransferProgress | None = None, *, via: Literal["pymavlink", "mavsdk"] = "pymavlink"
    ) -> None:
        """Give every vehicle its mission, all at the same time, by our own protocol or by MAVSDK's (in real time).

        Raises
        ------
        LinkError
            A vehicle is armed, refuses, or falls silent; nothing was armed.
        MissionError
            MAVSDK is asked for, and is not installed.
        """
        for vehicle in self._vehicles.values():
            if vehicle.armed:
                raise vehicle.error("is armed: land and disarm it before giving it a mission; nothing was uploaded")
            vehicle.held = None
        if via == "mavsdk":
            with Mavsdk(self._station) as sdk:
                goings = {k: self._uploading_by(sdk, vehicle, progress) for k, vehicle in self._vehicles.items()}
                self._station.together(goings, after_failure=_UNREAD)
            return
        goings = {sysid: self._uploading(vehicle, progress) for sysid, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was armed")

    def verify(self, progress: TransferProgress | None = None) -> None:
        """Read every mission back and compare it with the plan's.

        Raises
        ------
        LinkError
            A vehicle holds another mission than the one sent, named by item and field; nothing was armed.
        """
        goings = {sysid: self._verifying(vehicle, progress) for sysid, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was armed")

    def send_guards(self, progress: TransferProgress | None = None) -> tuple[str, ...]:
        """Give every vehicle the fence and rally points of the mission file, read back; return what is to be told.

        A vehicle that is to have no fence may keep its own, if its mission keeps clear of it.

        Raises
        ------
        LinkError
            A vehicle refuses them, or holds others than those sent; or holds a fence or limits of its own that would
            end its mission; nothing was armed.
        """
        told = [text for vehicle in self._vehicles.values() for text in vehicle.guard.kept_back]
        replaced: list[str] = []
        goings = {k: self._guarding(vehicle, progress, replaced) for k, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure=lambda: "; ".join([*replaced, "nothing was armed"]))
        return (*told, *replaced)

    def set_returns(self, progress: TransferProgress | None = None) -> tuple[ParameterChange, ...]:
        """Set every vehicle to return straight home at its planned height, and read that back.

        Vehicles keep these parameters; what was changed is returned, so that it can be told.

        Raises
        ------
        LinkError
            A vehicle is armed, lacks a parameter, does not take its value, or holds rally points, to which it would
            return instead; nothing was armed.
        """
        for vehicle in self._vehicles.values():
            if vehicle.armed:
                raise vehicle.error("is armed: land and disarm it before setting its return height; nothing was set")
        changes: list[ParameterChange] = []
        goings = {k: self._setting_returns(vehicle, progress, changes) for k, vehicle in self._vehicles.items()}
        told = "nothing was armed"
        self._station.together(goings, after_failure=lambda: "; ".join([*map(str, changes), told]))
        return tuple(changes)

    # what goes on with one vehicle, each a generator that yields whenever it waits

    def _comparing(self, vehicle: FleetVehicle, found: dict[int, Comparison]) -> Steps:
        plan = vehicle.plan
        held = yield from reading_motion(self._station, vehicle, plan.autopilot, plan.vehicle_class)
        found[plan.sysid] = compared(plan.name, plan.motion, held)

    def _saving(self, vehicle: FleetVehicle, progress: TransferProgress | None, found: dict[int, Saved]) -> Steps:
        found[vehicle.plan.sysid] = yield from saving(self._station, vehicle, progress)

    def _uploading(self, vehicle: FleetVehicle, progress: TransferProgress | None) -> Steps:
        tell = telling(progress, vehicle.plan.name)
        return self._station.uploading(vehicle, vehicle.plan.autopilot, vehicle.items, tell)

    def _uploading_by(self, sdk: Mavsdk, vehicle: FleetVehicle, progress: TransferProgress | None) -> Steps:
        tell = telling(progress, vehicle.plan.name)
        tell(0, len(vehicle.items))
        yield from sdk.uploading(vehicle, vehicle.items)
        tell(len(vehicle.items), len(vehicle.items))

    def _verifying(self, vehicle: FleetVehicle, progress: TransferProgress | None) -> Steps:
        tell, items = telling(progress, vehicle.plan.name), vehicle.items

        def read(done: int, _total: int | None) -> None:
            tell(done, len(items))

        vehicle.held = yield from self._station.reading_back(vehicle, vehicle.plan.autopilot, items, read)

    def _guarding(self, vehicle: FleetVehicle, progress: TransferProgress | None, replaced: list[str]) -> Steps:
        name, autopilot = vehicle.plan.name, vehicle.plan.autopilot
        wanted_by_kind = {
            mavlink.MAV_MISSION_TYPE_FENCE: vehicle.guard.fence,
            mavlink.MAV_MISSION_TYPE_RALLY: vehicle.guard.rally,
        }
        for kind, wanted in wanted_by_kind.items():
            what = what_is_sent(kind)
            held = yield from self._station.downloading(vehicle, mission_type=kind)
            if not wanted:
                if kind == mavlink.MAV_MISSION_TYPE_FENCE and (reason := breach(held, self._plan, vehicle.plan)):
                    raise vehicle.error(
                        f"holds a fence that would end its mission: {reason}; clear it, or plan inside it"
                    )
                continue
            if vehicle.differing(wanted, held, kind):
                if vehicle.armed:
                    raise vehicle.error(f"is armed: land and disarm it before giving it a {what}; nothing was changed")
                if held:
                    replaced.append(f"{name}: its {what} of {len(held)} items was replaced")

                yield from self._station.uploading(vehicle, autopilot, wanted, telling(progress, name), kind)
                yield from self._station.reading_back(vehicle, autopilot, wanted, mission_type=kind)
        read = yield from self._station.reading_many(vehicle, autopilot, fence_limits(autopilot))
        values = {parameter.name: parameter.value for parameter in read if parameter is not None}
        reason = limit_breach(values, self._plan, vehicle.plan)
        if reason is not None:
            raise vehicle.error(f"its own fence would end its mission: {reason}")

    def _setting_returns(
        self, vehicle: FleetVehicle, progress: TransferProgress | None, changes: list[ParameterChange]
    ) -> Steps:
        rally = yield from self._station.downloading(vehicle, mission_type=mavlink.MAV_MISSION_TYPE_RALLY)
        if vehicle.differing(vehicle.guard.rally, rally, mavlink.MAV_MISSION_TYPE_RALLY):
            others = "others than the mission's, " if vehicle.guard.rally else ""
            raise vehicle.error(
                f"holds {len(rally)} rally points, {others}to which it would return instead of its home: clear them"
            )
        motion = vehicle.plan.motion
        settings = return_settings(motion.autopilot, motion.vehicle_class, motion.return_height_m)
        values: list[tuple[Setting, float]] = []
        witness: str | None = None
        for done, setting in enumerate(settings):
            telling(progress, vehicle.plan.name)(done, len(settings))
            held = yield from self._station.reading(vehicle, vehicle.plan.autopilot, setting, witness)
            if held is None:
                continue
            witness = held.name
            try:
                wanted = setting.wanted(held, vehicle.plan.autopilot)
            except ValueError as error:
                raise vehicle.error(
                    f"parameter {held.name}: cannot hold {setting.value:g} m ({error}): "
                    "change the vehicle's return_height_m and plan again"
                ) from error
            if held.value != wanted:
                yield from self._station.setting(vehicle, vehicle.plan.autopilot, held, wanted)
                changes.append(ParameterChange(vehicle.plan.name, held.name, held.value, wanted))
            values.append((setting, wanted))
        for setting, wanted in values:  # all of them once more: one may act upon another
            held = yield from self._station.reading(vehicle, vehicle.plan.autopilot, setting, None)
            assert held is not None
            if held.value != wanted:
                raise mismatch(vehicle.party, held.name, wanted, held.value)
        telling(progress, vehicle.plan.name)(len(settings), len(settings))


@dataclass(frozen=True, slots=True)
class Downloaded:
    """What a vehicle was found to hold.

    ``remarks`` say what would make it return otherwise than straight to ``home`` at ``return_height_m`` above it.
    """

    sysid: int
    autopilot: Autopilot
    vehicle_class: VehicleClass
    items: tuple[MissionItem, ...]
    home: GeoPoint | None  # None: it has none yet
    return_height_m: float
    remarks: tuple[str, ...]
    parameters: Mapping[str, ParameterValue]  # those that decide how it moves
    notes: tuple[str, ...] = ()  # what else it holds that nobody checks


def download_missions(
    endpoints: Sequence[Endpoint],
    clock: Clock,
    *,
    expected: Sequence[int] | None = None,
    asked: Mapping[int, Vehicle] | None = None,
    timeout_s: float = 30.0,
    progress: TransferProgress | None = None,
    log: FleetLog | None = None,
) -> dict[int, Downloaded]:
    """Read what vehicles hold, by sysid, and change nothing: of those expected, or of all that are heard.

    ``asked`` by sysid are a mission's vehicles, which they must be.

    Raises
    ------
    LinkError
        Nobody, or not everybody answers; a vehicle of a kind that we do not know, or another than asked for; two
        vehicles with one sysid.
    """
    station = Listener(endpoints, clock, log)
    peers = station.acquaint(expected, asked or {}, timeout_s)
    found: dict[int, Downloaded] = {}
    station.together({k: _finding(station, peer, progress, found) for k, peer in peers.items()})
    return dict(sorted(found.items()))


def _finding(
    station: Listener, peer: Stranger, progress: TransferProgress | None, found: dict[int, Downloaded]
) -> Steps:
    autopilot, vehicle_class = peer.known_kind()
    parameters = yield from reading_motion(station, peer, autopilot, vehicle_class)
    items = yield from station.downloading(peer, telling(progress, peer.party.vehicle))
    rally = yield from station.downloading(peer, mission_type=mavlink.MAV_MISSION_TYPE_RALLY)
    fence = yield from station.downloading(peer, mission_type=mavlink.MAV_MISSION_TYPE_FENCE)
    notes = (f"it holds a fence of {len(fence)} items, not checked: it may end the mission",) if fence else ()
    remarks = [f"it holds {len(rally)} rally points, to which it may return instead of its home"] if rally else []
    height, *_ = return_settings(autopilot, vehicle_class, 0.0)
    held_height = yield from station.reading(peer, autopilot, height, None)
    assert held_height is not None
    height_m = height.meant(held_height)
    if not math.isfinite(height_m):
        raise peer.error(f"holds {held_height.name} {held_height.value:g}: expected a height to return at: set it")
    for setting in return_settings(autopilot, vehicle_class, height_m)[1:]:
        held = yield from station.reading(peer, autopilot, setting, held_height.name)
        if held is not None and setting.meant(held) != setting.value:
            remarks.append(f"{held.name} is {held.value:g}: its return is known only for {setting.value:g}")
    if height_m < 0.0:
        remarks.append(f"{held_height.name} is {held_height.value:g}: it returns at its present height")
    yield from station.homing(peer)
    peer.check_alone()  # still: what was read is one vehicle's
    found[peer.party.sysid] = Downloaded(
        peer.party.sysid, autopilot, vehicle_class, items, peer.home, height_m, tuple(remarks), parameters, notes
    )
