"""The parameters that vehicles hold, and whether they move as a mission's motion model says.

Read by name, several at once: only those that the motion model knows matter, so that it costs little before a flight.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from adapters.endpoint import Endpoint
from adapters.ground_station import AnyPeer, Clock, Station, Steps, TransferProgress, Waiting, telling
from adapters.listener import Listener, Stranger
from adapters.parameter_protocol import ParameterValue
from adapters.telemetry_log import FleetLog
from missionplanner.autopilot_parameters import (
    Difference,
    Kind,
    defaults,
    differences,
    find,
    missing,
    parameters,
    same,
    shown,
    value_of,
)
from missionplanner.errors import LinkError
from missionplanner.mission import Mission, Vehicle
from missionplanner.vehicle import Autopilot, MotionModel, VehicleClass, motion_model


@dataclass(frozen=True, slots=True)
class HeldParameters:
    """What a vehicle holds, by name: all parameters, or those that the motion model knows."""

    sysid: int
    autopilot: Autopilot
    vehicle_class: VehicleClass
    values: Mapping[str, ParameterValue]
    uid: str = ""  # of its autopilot; empty: it tells none


@dataclass(frozen=True, slots=True)
class Comparison:
    """A vehicle's parameters held against the motion model that it was planned with.

    What its firmware does not have, under any name, is ``unheld`` where the plan was made with other than the usual
    value, so that the vehicle cannot fly so; else ``absent``. Both are told as they are to be read.
    """

    vehicle: str
    differences: tuple[Difference, ...]
    unheld: tuple[str, ...]
    absent: tuple[str, ...]

    @property
    def problem(self) -> str | None:
        """What is to be told to who wants to fly; None where the vehicle flies as planned."""
        if self.differences:
            first = self.differences[0]
            wanted, held = shown(first.planned), shown(first.held)
            told = f"holds {first.name} {held}, planned with {wanted}: set it to {wanted} on the vehicle"
            if first.plannable:
                told += f", or put {first.name}: {held} into its parameters in the mission file and plan again"
            others = [*map(str, self.differences[1:]), *self.unheld]
        elif self.unheld:
            told, *others = self.unheld
        else:
            return None
        more = f" (and {len(others)} more: {'; '.join(others)})" if others else ""
        return f"{self.vehicle}: {told}{more}"

    def as_json(self, held: HeldParameters) -> dict[str, Any]:
        """Return it with what is held, for machines."""
        kind: Kind = (held.autopilot, held.vehicle_class)
        values = {name: parameter.value for name, parameter in sorted(held.values.items())}
        return {
            "name": self.vehicle,
            "sysid": held.sysid,
            "autopilot": held.autopilot,
            "class": held.vehicle_class,
            "uid": held.uid or None,
            "parameters": {name: _finite(value) for name, value in values.items()},
            "sets": {name: meaning for name, value in values.items() if (meaning := _meaning(kind, name, value))},
            "differences": [{**asdict(found), "held": _finite(found.held)} for found in self.differences],
            "missing": [*self.unheld, *self.absent],
        }


def compared(vehicle: str, model: MotionModel, values: Mapping[str, ParameterValue]) -> Comparison:
    """Return how what a vehicle holds compares with the motion model that it was planned with."""
    kind: Kind = (model.autopilot, model.vehicle_class)
    usual = defaults(kind)
    unheld: list[str] = []
    absent: list[str] = []
    for parameter in missing(kind, values):
        planned = value_of(model, parameter.field)
        called = " or ".join(parameter.names)
        if same(planned, usual[parameter.field]):
            absent.append(f"{vehicle}: its firmware has no {called}: {planned:g} {parameter.unit} is assumed".rstrip())
        else:
            unheld.append(
                f"its firmware has no {called}, planned with {planned:g} {parameter.unit}: leave it out of the mission "
                "file and plan again"
            )
    found = differences(kind, model, {name: held.value for name, held in values.items()})
    return Comparison(vehicle, found, tuple(unheld), tuple(absent))


def _finite(value: float) -> float | None:
    """Return a value as JSON can tell it, which knows neither NaN nor infinity."""
    return value if math.isfinite(value) else None


def _meaning(kind: Kind, name: str, value: float) -> str:
    """Return what a parameter sets in the motion model; empty where it is none of its."""
    found = find(kind, name)
    if found is None:
        return ""
    parameter, spelling = found
    return f"{parameter.field} = {value / spelling.per_unit:g} {parameter.unit}".rstrip()


def reading_motion(
    station: Station[AnyPeer], peer: AnyPeer, autopilot: Autopilot, vehicle_class: VehicleClass
) -> Waiting[dict[str, ParameterValue]]:
    """Read the parameters that the motion model knows."""
    groups = [parameter.names for parameter in parameters((autopilot, vehicle_class))]
    read = yield from station.reading_many(peer, autopilot, groups)
    return {held.name: held for held in read if held is not None}


def read_parameters(
    endpoints: Sequence[Endpoint],
    clock: Clock,
    *,
    expected: Sequence[int] | None = None,
    asked: Mapping[int, Vehicle] | None = None,
    everything: bool = False,
    timeout_s: float = 30.0,
    progress: TransferProgress | None = None,
    log: FleetLog | None = None,
) -> dict[int, HeldParameters]:
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
    found: dict[int, HeldParameters] = {}

    def reading(peer: Stranger) -> Steps:
        autopilot, vehicle_class = peer.known_kind()
        if everything:
            values = yield from station.listing(peer, autopilot, telling(progress, peer.party.vehicle))
        else:
            values = yield from reading_motion(station, peer, autopilot, vehicle_class)
        uid = max(peer.unique_ids, key=len, default="")
        found[peer.party.sysid] = HeldParameters(peer.party.sysid, autopilot, vehicle_class, values, uid)

    station.together({k: reading(peer) for k, peer in peers.items()})
    return dict(sorted(found.items()))


def check_parameters(found: Iterable[HeldParameters], mission: Mission | None) -> list[Comparison]:
    """Compare what vehicles hold with what a mission assumes of the vehicles with these sysids; None: with nothing.

    Raises
    ------
    LinkError
        The mission has no vehicle of that sysid, or it is another autopilot's or class's.
    """
    if mission is None:
        return [Comparison(f"vehicle {held.sysid}", (), (), ()) for held in found]
    asked = {vehicle.sysid or index: vehicle for index, vehicle in enumerate(mission.vehicles, start=1)}
    comparisons: list[Comparison] = []
    for held in found:
        vehicle = asked.get(held.sysid)
        if vehicle is None:
            raise LinkError(
                f"vehicle {held.sysid}: expected one of the mission's sysids ({', '.join(map(str, asked))})"
            )
        if (held.autopilot, held.vehicle_class) != (vehicle.autopilot, vehicle.vehicle_class):
            raise LinkError(
                f"{vehicle.name} (sysid {held.sysid}): expected {vehicle.autopilot} {vehicle.vehicle_class}, got "
                f"{held.autopilot} {held.vehicle_class}: the wrong vehicle, or correct the mission file"
            )
        comparisons.append(compared(vehicle.name, motion_model(vehicle), held.values))
    return comparisons
