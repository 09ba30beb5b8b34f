"""What vehicles hold, saved before anything else is sent to them, and given back: mission, fence and rally points.

A backup is a folder: ``backup.json`` has every item as it was read, and whose it was; beside it lie a ``.plan`` and a
``.waypoints`` file per vehicle, which other ground stations load. ``backup.json`` is written last: a folder that has
one is complete.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint
from adapters.ground_station import Clock, Peer, Station, Steps, TransferProgress, Waiting, telling
from adapters.guards import read_areas
from adapters.mission_items import FRAME_MISSION, MissionItem, items_sha256, wire_to_degrees
from adapters.mission_protocol import Party, what_is_sent
from adapters.plan_file import PlanFile, plan_text
from adapters.telemetry_log import FleetLog
from adapters.waypoints_file import waypoints_text
from missionplanner.errors import MissionError
from missionplanner.files import write_atomic
from missionplanner.geodesy import GeoPoint
from missionplanner.vehicle import Autopilot, VehicleClass

_MANIFEST = "backup.json"
_FORMAT = "missionplanner backup"
_FILE_FRAMES = {5: 0, 6: 3, 11: 10}  # the wire's INT frames mean the same, and are superseded: files do not have them
_MAX_FILE_BYTES = 64 * 1024 * 1024
_KINDS = (mavlink.MAV_MISSION_TYPE_MISSION, mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY)


@dataclass(frozen=True, slots=True)
class Saved:
    """What one vehicle held, and who it was."""

    name: str
    sysid: int
    autopilot: Autopilot
    vehicle_class: VehicleClass
    unique_ids: tuple[str, ...]  # empty: it told none
    mission: tuple[MissionItem, ...]
    fence: tuple[MissionItem, ...]
    rally: tuple[MissionItem, ...]

    def of(self, mission_type: int) -> tuple[MissionItem, ...]:
        """Return the items of one MAV_MISSION_TYPE."""
        return (self.mission, self.fence, self.rally)[_KINDS.index(mission_type)]

    @property
    def sha256(self) -> str:
        """The hash of all that it held."""
        return hashlib.sha256("".join(items_sha256(self.of(kind)) for kind in _KINDS).encode()).hexdigest()


def saving(station: Station[Any], peer: Peer, progress: TransferProgress | None) -> Waiting[Saved]:
    """Read all that a vehicle holds; it must have been asked who it is."""
    autopilot, vehicle_class = peer.known_kind()
    mission = yield from station.downloading(peer, telling(progress, peer.party.vehicle))
    fence = yield from station.downloading(peer, mission_type=mavlink.MAV_MISSION_TYPE_FENCE)
    rally = yield from station.downloading(peer, mission_type=mavlink.MAV_MISSION_TYPE_RALLY)
    ids = tuple(sorted(peer.unique_ids))
    return Saved(peer.party.vehicle, peer.party.sysid, autopilot, vehicle_class, ids, mission, fence, rally)


def expect_no_backup(folder: Path, names: Sequence[str] = ()) -> None:
    """Refuse a folder that has a backup already, or files of vehicles so named: what was held first is wanted most.

    Raises
    ------
    MissionError
        It has.
    """
    if (folder / _MANIFEST).exists():
        raise MissionError(f"{folder}: expected a folder without a backup, got one: choose another, it is not replaced")
    for name in names:
        for path in (folder / f"{name}.plan", folder / f"{name}.waypoints"):
            if path.exists():
                raise MissionError(f"{path}: is there already, and is not replaced: choose another folder")


def write_backup(
    folder: Path, vehicles: Sequence[Saved], saved_at: str, homes: Mapping[int, GeoPoint] | None = None
) -> list[Path]:
    """Write what vehicles held, ``saved_at`` that time, and return the files' paths; ``homes`` by sysid, where known.

    Raises
    ------
    MissionError
        As :func:`expect_no_backup`, or the folder cannot be written to.
    """
    expect_no_backup(folder, [vehicle.name for vehicle in vehicles])
    texts: dict[str, str] = {}
    for vehicle in vehicles:
        home = (homes or {}).get(vehicle.sysid) or _home(vehicle)
        mission = [replace(item, frame=_FILE_FRAMES.get(item.frame, item.frame)) for item in vehicle.mission]
        try:
            areas = read_areas(vehicle.fence)
        except ValueError:  # no plan file can say what it holds; backup.json does
            areas = []
        held = PlanFile(vehicle.autopilot, home, tuple(mission))
        texts[f"{vehicle.name}.plan"] = plan_text(held, vehicle.vehicle_class, areas, vehicle.rally)
        texts[f"{vehicle.name}.waypoints"] = waypoints_text(mission, vehicle.autopilot, home)
    document = {"format": _FORMAT, "version": 1, "saved": saved_at, "vehicles": [_as_json(v) for v in vehicles]}
    texts[_MANIFEST] = json.dumps(document, indent=1, allow_nan=False) + "\n"
    for name, text in texts.items():
        write_atomic(folder / name, text)
    return [folder / name for name in texts]


def read_backup(folder: Path) -> tuple[Saved, ...]:
    """Return what a backup has of its vehicles.

    Raises
    ------
    MissionError
        There is none, or it is not as it was written.
    """
    path = folder / _MANIFEST
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_FILE_BYTES)
        record = _Record.model_validate_json(content)
        vehicles = tuple(_saved(vehicle) for vehicle in record.vehicles)
    except OSError as error:
        raise MissionError(f"{path}: expected a backup, as upload --backup writes, got: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "file"
        raise MissionError(f"{path}: {where}: expected a backup as it was written, got: {first['msg']}") from error
    for vehicle, kept in zip(vehicles, record.vehicles, strict=True):
        if vehicle.sha256 != kept.sha256:
            raise MissionError(
                f"{path}: {vehicle.name}: expected what was saved (sha256 {kept.sha256[:12]}...), got other items "
                f"({vehicle.sha256[:12]}...): the file was changed; upload an edited mission by its .plan instead"
            )
    sysids = [vehicle.sysid for vehicle in vehicles]
    if not vehicles or len(set(sysids)) < len(sysids):
        raise MissionError(f"{path}: expected vehicles with different sysids, got {sysids}")
    return vehicles


def restore(
    vehicles: Sequence[Saved],
    endpoints: Sequence[Endpoint],
    clock: Clock,
    *,
    timeout_s: float = 30.0,
    progress: TransferProgress | None = None,
    log: FleetLog | None = None,
) -> dict[int, tuple[str, ...]]:
    """Give vehicles back just what was saved of them, read it back, and return what of it had to be sent, by sysid.

    Raises
    ------
    LinkError
        Not everybody answers, or somebody is another vehicle than the one saved, or armed: then nothing was sent. A
        vehicle refuses, or holds something else afterwards.
    KeyboardInterrupt
        With what was left.
    """
    peers = {vehicle.sysid: Peer(Party(vehicle.name, vehicle.sysid)) for vehicle in vehicles}
    station: Station[Peer] = Station(peers, endpoints, clock, log)
    station.wait_for(list(peers), {v.sysid: f"{v.name} (sysid {v.sysid})" for v in vehicles}, timeout_s)
    nothing_sent = "nothing was restored"
    station.together({k: station.identifying(peer) for k, peer in peers.items()}, after_failure=nothing_sent)
    for vehicle in vehicles:
        _expect_the_same_vehicle(peers[vehicle.sysid], vehicle)
    sent: dict[int, tuple[str, ...]] = {}

    def told() -> str:
        whole = [vehicle.name for vehicle in vehicles if vehicle.sysid in sent]
        return (f"{', '.join(whole)}: all that was saved is held; " if whole else "") + "restore again"

    try:
        station.together(
            {v.sysid: _restoring(station, peers[v.sysid], v, progress, sent) for v in vehicles}, after_failure=told
        )
    except KeyboardInterrupt:
        raise KeyboardInterrupt("; ".join(text for text in (station.left_behind(), told()) if text)) from None
    return sent


def _expect_the_same_vehicle(peer: Peer, saved: Saved) -> None:
    remedy = "it is not the vehicle that was saved; nothing was restored"
    peer.expect_identity((saved.autopilot, saved.vehicle_class), saved.unique_ids, remedy)
    if peer.armed:
        raise peer.error("is armed: land and disarm it first; nothing was restored")


def _restoring(
    station: Station[Peer],
    peer: Peer,
    saved: Saved,
    progress: TransferProgress | None,
    sent: dict[int, tuple[str, ...]],
) -> Steps:
    tell = telling(progress, saved.name)
    changed = []
    for kind in _KINDS:
        wanted = saved.of(kind)
        held = yield from station.downloading(peer, mission_type=kind)
        if not _differing(peer, wanted, held, kind):
            continue
        changed.append(what_is_sent(kind))
        yield from station.uploading(peer, saved.autopilot, wanted, tell, kind)
        if wanted:
            yield from station.reading_back(peer, saved.autopilot, wanted, mission_type=kind)
            continue
        held = yield from station.downloading(peer, mission_type=kind)
        peer.uploads.pop(kind, None)
        if _differing(peer, wanted, held, kind):
            raise peer.error(f"still holds a {what_is_sent(kind)} of {len(held)} items, where it held none")
    sent[saved.sysid] = tuple(changed)


def _differing(peer: Peer, wanted: Sequence[MissionItem], held: Sequence[MissionItem], kind: int) -> Sequence[object]:
    # ArduPilot counts its home as a mission of one item, or not
    if kind == mavlink.MAV_MISSION_TYPE_MISSION and peer.autopilot == "ardupilot" and max(len(wanted), len(held)) <= 1:
        return ()
    return peer.differing(wanted, held, kind)


def _home(vehicle: Saved) -> GeoPoint:
    """Return the home of a mission; where it has none, the first place that it goes to: files must have one."""
    for item in vehicle.mission:
        if item.frame != FRAME_MISSION and (item.x or item.y):
            return GeoPoint(wire_to_degrees(item.x), wire_to_degrees(item.y), item.z if item.frame == 0 else 0.0)
    return GeoPoint(0.0, 0.0, 0.0)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


_Number = float | Literal["inf", "-inf"] | None  # None: NaN
_Row = tuple[int, int, int, _Number, _Number, _Number, _Number, int, int, _Number, int, int]


class _SavedVehicle(_Model):
    name: str
    sysid: int
    autopilot: Autopilot
    vehicle_class: VehicleClass
    uid: tuple[str, ...]
    mission: tuple[_Row, ...]
    fence: tuple[_Row, ...]
    rally: tuple[_Row, ...]
    sha256: str


class _Record(_Model):
    format: Literal["missionplanner backup"]
    version: Literal[1]
    saved: str
    vehicles: tuple[_SavedVehicle, ...]


def _as_json(vehicle: Saved) -> Mapping[str, object]:
    rows = {what: [_row(i) for i in getattr(vehicle, what)] for what in ("mission", "fence", "rally")}
    return {
        "name": vehicle.name,
        "sysid": vehicle.sysid,
        "autopilot": vehicle.autopilot,
        "vehicle_class": vehicle.vehicle_class,
        "uid": vehicle.unique_ids,
        **rows,
        "sha256": vehicle.sha256,
    }


def _row(item: MissionItem) -> list[int | float | str | None]:
    """Return an item's fields in their order; NaN as None."""
    return [
        value if isinstance(value, int) or math.isfinite(value) else None if math.isnan(value) else str(value)
        for value in astuple(item)
    ]


def _saved(record: _SavedVehicle) -> Saved:
    def items(rows: tuple[_Row, ...]) -> tuple[MissionItem, ...]:
        try:
            return tuple(MissionItem(*map(_plain, row)) for row in rows)
        except MissionError as error:
            raise MissionError(f"{_MANIFEST}: {record.name}: {error}") from error

    kinds = (items(rows) for rows in (record.mission, record.fence, record.rally))
    return Saved(record.name, record.sysid, record.autopilot, record.vehicle_class, record.uid, *kinds)


def _plain(value: Any) -> Any:
    return math.nan if value is None else float(value) if isinstance(value, str) else value
