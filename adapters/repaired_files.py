"""Repaired missions: moves applied to items in their own frames, and files that differ from theirs in nothing else."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adapters.certificates import Held, sortie
from adapters.mission_items import (
    FRAME_GLOBAL,
    FRAME_RELATIVE,
    LOITER_UNLIMITED,
    TAKEOFF,
    WAYPOINT,
    MissionItem,
    degrees_to_wire,
    float32_text,
    wire_to_degrees,
)
from adapters.sorties import LOITER_TIME, LOITER_TURNS, SPLINE_WAYPOINT, read_mission_file
from missionplanner.errors import MissionError
from missionplanner.files import replacing
from missionplanner.geodesy import GeoPoint, LocalFrame
from missionplanner.repair import Move, repair
from missionplanner.scene import Scene
from missionplanner.sortie import Sortie
from missionplanner.vehicle import Autopilot

_PLACED = (WAYPOINT, SPLINE_WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, TAKEOFF)
"""Commands that are moved. A LAND's altitude means nothing, and its place stays."""

_AMSL_FRAMES = (FRAME_GLOBAL, 5)
_HOME_FRAMES = (FRAME_RELATIVE, 6)
_AMSL_MODE, _CALCULATED_ABOVE_TERRAIN = 2, 3  # QGroundControl's altitude modes
_MOVED_M = 1e-6
_READ_BACK_M = 0.02  # 1e-7 degrees in both directions
_NO_COURSE_M = 0.005


@dataclass(frozen=True, slots=True)
class Difference:
    """How one mission item was moved."""

    vehicle: str
    seq: int
    shifted_m: float
    course_deg: float | None  # in which it was shifted, clockwise from north; None: nowhere
    raised_m: float  # negative: lowered
    before: GeoPoint
    after: GeoPoint

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "vehicle": self.vehicle,
            "seq": self.seq,
            "shifted_m": round(self.shifted_m, 2),
            "course_deg": None if self.course_deg is None else round(self.course_deg, 1),
            "raised_m": round(self.raised_m, 2),
            "before": _point(self.before),
            "after": _point(self.after),
        }


def _point(point: GeoPoint) -> dict[str, float]:
    return {
        "lat_deg": round(point.lat_deg, 7),
        "lon_deg": round(point.lon_deg, 7),
        "alt_amsl_m": round(point.alt_amsl_m, 2),
    }


def differences(moves: Sequence[Move], frame: LocalFrame) -> list[Difference]:
    """Return the table of what was moved, an item a row."""
    rows = []
    for move in moves:
        east_m, north_m, up_m = np.subtract(move.to_m, move.from_m).tolist()
        shifted_m = math.hypot(east_m, north_m)
        course_deg = math.degrees(math.atan2(east_m, north_m)) % 360.0 if shifted_m > _NO_COURSE_M else None
        before, after = frame.geo_point(move.from_m), frame.geo_point(move.to_m)
        rows.append(Difference(move.vehicle, move.seq, shifted_m, course_deg, up_m, before, after))
    return rows


def repaired(scene: Scene, missions: Sequence[Held], folder: Path) -> tuple[list[Held], list[Difference]]:
    """Return missions with their waypoints moved until their legs hold, and how; those moved are written to ``folder``.

    A file is named after its vehicle. What is returned is to be proven.

    Raises
    ------
    MissionError
        A mission that cannot be read, or not be written as it would have to be.
    InfeasibleError
        Legs that cannot be repaired by moving waypoints.
    """
    before = [sortie(scene, held) for held in missions]
    done = repair(scene, before)
    changed: list[Held] = []
    for held, was, becomes in zip(missions, before, done.sorties, strict=True):
        moves = [move for move in done.moves if move.vehicle == held.name]
        if not moves:
            changed.append(held)
            continue
        moved = replace(held, items=moved_items(held.items, moves, was, scene.frame))
        _check_read_back(sortie(scene, moved), becomes)
        if held.path is not None:
            path = folder / f"{held.name}{held.path.suffix}"
            write_repaired(held.path, path, moved.items, was.autopilot)
            moved = replace(moved, path=path)
        changed.append(moved)
    return changed, differences(done.moves, scene.frame)


def _check_read_back(read: Sortie, wanted: Sortie) -> None:
    """Raise when items do not say what their repair does, as where a moved waypoint changes what the next one means."""
    ends = [[leg.end_m for leg in flown.legs] for flown in (read, wanted)]
    if len(ends[0]) != len(ends[1]) or not np.allclose(ends[0], ends[1], rtol=0.0, atol=_READ_BACK_M):
        raise MissionError(
            f"{wanted.name}: expected the repaired items to be flown as repaired, got another path: "
            "give every waypoint its own position and altitude first"
        )


# --- items ----------------------------------------------------------------------------------------------------------


def moved_items(
    items: Sequence[MissionItem], moves: Sequence[Move], flown: Sortie, frame: LocalFrame
) -> tuple[MissionItem, ...]:
    """Return one vehicle's items with moves applied: altitudes in the items' own frames, all else as it was.

    ``flown`` is the sortie that the items were read as. ArduPilot takes position 0, 0 and altitude 0 as those of the
    item before; where that has moved and such an item has not, it is told where it was.

    Raises
    ------
    MissionError
        A moved item whose altitude is neither AMSL nor above home.
    """
    wanted = {move.seq: move for move in moves}
    before: Move | None = None  # of the item before
    result = []
    for item in items:
        move = wanted.get(item.seq)
        if item.command not in _PLACED or (move is None and before is None):
            result.append(item)
            continue
        held = flown.autopilot == "ardupilot" and item.x == 0 and item.y == 0
        copter = flown.vehicle_class == "copter"
        level = flown.autopilot == "ardupilot" and int(item.z * 100.0) == 0 and (copter or held)
        if move is not None and before is not None and held and level and move.to_m == before.to_m:
            result.append(item)  # it follows
        elif move is not None:
            shift = math.dist(move.from_m[:2], move.to_m[:2]) > _MOVED_M or (held and before is not None)
            lift = abs(move.to_m[2] - move.from_m[2]) > _MOVED_M or (level and before is not None)
            result.append(_at(item, move.to_m, flown, frame, shift=shift, lift=lift))
        else:
            assert before is not None
            result.append(_at(item, before.from_m, flown, frame, shift=held, lift=level))
        before = move
    return tuple(result)


def _at(
    item: MissionItem,
    place: tuple[float, float, float],
    flown: Sortie,
    frame: LocalFrame,
    *,
    shift: bool,
    lift: bool,
) -> MissionItem:
    """Return an item at a place, or at its altitude."""
    if shift:
        point = frame.geo_point(place)
        item = replace(item, x=degrees_to_wire(point.lat_deg), y=degrees_to_wire(point.lon_deg))
    if not lift:
        return item
    if item.frame in _AMSL_FRAMES:
        return replace(item, z=place[2])
    if item.frame in _HOME_FRAMES:
        return replace(item, z=place[2] - float(flown.home_m[2]))
    raise MissionError(
        f"{flown.name}: item {item.seq}: expected an altitude AMSL or above home (frames 0, 3, 5, 6) to change, got "
        f"frame {item.frame}: give it one, then repair again"
    )


# --- files ----------------------------------------------------------------------------------------------------------


def write_repaired(path_in: Path, path_out: Path, items: Sequence[MissionItem], autopilot: Autopilot) -> None:
    """Write a ``.plan`` or QGC WPL 110 file that differs from ``path_in`` in the positions of moved items only.

    Raises
    ------
    MissionError
        A file that cannot be read or written, or is the one that was read; items that differ in more than their
        positions; a moved item that is part of a survey.
    """
    original, _ = read_mission_file(path_in, autopilot)
    if path_out.exists() and path_out.samefile(path_in):
        raise MissionError(f"{path_out}: expected another file than the one that is repaired: choose another folder")
    same = [replace(new, x=old.x, y=old.y, z=old.z) for old, new in zip(original, items, strict=False)]
    if len(original) != len(items) or tuple(same) != tuple(original):
        raise MissionError(f"{path_in}: expected its own {len(original)} items with other positions, got others")
    changed = {new.seq: (old, new) for old, new in zip(original, items, strict=True) if old != new}
    content = path_in.read_bytes().decode("utf-8-sig")
    if content.lstrip().startswith("{"):
        content = _plan_text(path_in, content, changed, first_seq=1 if autopilot == "ardupilot" else 0)
    else:
        content = _rows_text(content, changed, first_seq=0 if autopilot == "ardupilot" else -1)
    with replacing(path_out) as draft:
        draft.write_bytes(content.encode())
        written, _ = read_mission_file(draft, autopilot)
        if tuple(written) != tuple(items):
            raise MissionError(f"{path_out}: expected the repaired items to read back as written: not kept")


_Changed = Mapping[int, tuple[MissionItem, MissionItem]]


def _plan_text(path: Path, content: str, changed: _Changed, first_seq: int) -> str:
    """Return QGroundControl's document with the positions of changed items, all else as it was."""
    document = json.loads(content)
    seq = first_seq
    for place, entry in enumerate(document["mission"]["items"]):
        if entry["type"] == "SimpleItem":
            if seq in changed:
                _move_simple(entry, *changed[seq])
            seq += 1
            continue
        parts = range(seq, seq + len(entry["TransectStyleComplexItem"]["Items"]))
        touched = [part for part in parts if part in changed]
        if touched:
            raise MissionError(
                f"{path}: mission.items[{place}]: expected single waypoints to move, got item {touched[0]} of a "
                f"{entry.get('complexItemType', 'survey')}: change its altitude or area in QGroundControl"
            )
        seq = parts.stop
    return json.dumps(document, indent=4, ensure_ascii=False) + "\n"


def _move_simple(entry: dict[str, Any], old: MissionItem, new: MissionItem) -> None:
    if (old.x, old.y) != (new.x, new.y):
        entry["params"][4:6] = wire_to_degrees(new.x), wire_to_degrees(new.y)
    if old.z != new.z:
        entry["params"][6] = float(float32_text(new.z))
    if "Altitude" in entry:
        # what QGroundControl derives from its own terrain it would derive again, and undo the repair
        entry["AMSLAltAboveTerrain"] = None
        entry["Altitude"] = float(float32_text(new.z))
        if entry.get("AltitudeMode") == _CALCULATED_ABOVE_TERRAIN:
            entry["AltitudeMode"] = _AMSL_MODE


def _rows_text(content: str, changed: _Changed, first_seq: int) -> str:
    """Return QGC WPL 110 text with the positions of changed items; other lines are kept to the byte."""
    lines = content.splitlines(keepends=True)
    seq = first_seq
    for number, line in enumerate(lines[1:], start=1):
        if not line.strip() or line.startswith("#"):
            continue
        if seq in changed:
            old, new = changed[seq]
            columns = line.split()
            if (old.x, old.y) != (new.x, new.y):
                columns[8:10] = (f"{wire_to_degrees(value):.8f}" for value in (new.x, new.y))
            if old.z != new.z:
                columns[10] = float32_text(new.z)
            lines[number] = "\t".join(columns) + line[len(line.rstrip()) :]
        seq += 1
    return "".join(lines)
