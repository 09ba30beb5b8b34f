r"""QGC WPL 110, the ``.waypoints`` file of Mission Planner, MAVProxy and QGroundControl.

A header, then one line per item of 12 columns with exactly one tab between (QGroundControl takes nothing else, no
comment and no blank line): ``seq current frame command p1 p2 p3 p4 lat lon alt autocontinue``. Row 0 is home, for
either autopilot: QGroundControl always consumes it as home, and a file without it loses a waypoint
(https://mavlink.io/en/file_formats/#mission_plain_text_file).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from adapters.mission_items import (
    FRAME_GLOBAL,
    FRAME_MISSION,
    WAYPOINT,
    MissionItem,
    degrees_to_wire,
    float32_text,
    wire_to_degrees,
)
from missionplanner.errors import MissionError
from missionplanner.geodesy import GeoPoint
from missionplanner.vehicle import Autopilot

_HEADER = "QGC WPL 110"
_COLUMNS = 12
_FRAME_GLOBAL_INT = 5
_LARGEST_INT = 2**31 - 1  # of the wire


def waypoints_text(items: Sequence[MissionItem], autopilot: Autopilot, home: GeoPoint) -> str:
    """Return the file's text; PX4's missions, which have no home item, get the home row in front."""
    rows = list(items)
    if autopilot == "px4":
        x, y = degrees_to_wire(home.lat_deg), degrees_to_wire(home.lon_deg)
        rows.insert(0, MissionItem(0, FRAME_GLOBAL, WAYPOINT, x=x, y=y, z=home.alt_amsl_m))
    lines = [_row(replace(item, seq=seq, current=int(seq == 0))) for seq, item in enumerate(rows)]
    return "\n".join([_HEADER, *lines]) + "\n"


def _row(item: MissionItem) -> str:
    columns = [
        *(str(value) for value in (item.seq, item.current, item.frame, item.command)),
        *(float32_text(value) for value in (item.param1, item.param2, item.param3, item.param4)),
        # one decimal more than the wire holds, so that no reader's truncation can reach it
        *(f"{v if item.frame == FRAME_MISSION else wire_to_degrees(v):.8f}" for v in (item.x, item.y)),
        float32_text(item.z),
        str(item.autocontinue),
    ]
    return "\t".join(columns)


def read_waypoints(path: Path, autopilot: Autopilot) -> tuple[MissionItem, ...]:
    """Read a file as the mission to upload: ArduPilot's with row 0 as its home item, PX4's without it.

    Spaces between columns are accepted, as Mission Planner and MAVProxy do.

    Raises
    ------
    MissionError
        The file cannot be read, is not QGC WPL 110, or a line has not 12 numbers in sequence.
    """
    return read_waypoints_home(path, autopilot)[0]


def read_waypoints_home(path: Path, autopilot: Autopilot) -> tuple[tuple[MissionItem, ...], GeoPoint | None]:
    """Read a file as the mission to upload and the home of its row 0.

    For ArduPilot, row 0 is its home item whatever it says: the vehicle overwrites it. A file for PX4 whose row 0 cannot
    be home is refused: some ground stations would fly it, others drop it.

    Raises
    ------
    MissionError
        As :func:`read_waypoints`.
    """
    rows = _read_rows(path)
    first = rows[0] if rows else None
    is_home = first is not None and first.command == WAYPOINT
    if autopilot == "px4" and first is not None:
        if not is_home:
            raise MissionError(
                f"{path}: expected home in row 0 (command {WAYPOINT}), got command {first.command}: add it in front, "
                "ground stations never fly row 0"
            )
        rows = [replace(row, seq=seq, current=int(seq == 0)) for seq, row in enumerate(rows[1:])]
    if first is None or not is_home or first.frame not in (FRAME_GLOBAL, _FRAME_GLOBAL_INT):
        return tuple(rows), None
    return tuple(rows), GeoPoint(wire_to_degrees(first.x), wire_to_degrees(first.y), first.z)


def _read_rows(path: Path) -> list[MissionItem]:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(f"{path}: expected a readable text file, got: {error}") from error
    if not lines or lines[0].strip() != _HEADER:
        got = lines[0].strip()[:40] if lines else "an empty file"
        raise MissionError(f"{path}:1: expected the header {_HEADER!r}, got {got!r}")
    rows = [
        _item(line, f"{path}:{number}")
        for number, line in enumerate(lines[1:], start=2)
        if line.strip() and not line.startswith("#")
    ]
    for seq, row in enumerate(rows):
        if row.seq != seq:
            raise MissionError(f"{path}: expected item {seq}, got {row.seq}: rows must be numbered from 0 without gaps")
    return rows


def _item(line: str, where: str) -> MissionItem:
    columns = line.split()
    if len(columns) != _COLUMNS:
        raise MissionError(f"{where}: expected {_COLUMNS} columns, got {len(columns)}")
    try:
        seq, current, frame, command = (int(column) for column in columns[:4])
        param1, param2, param3, param4, lat_deg, lon_deg, z = (float(column) for column in columns[4:11])
        autocontinue = int(columns[11])
    except ValueError as error:
        raise MissionError(f"{where}: expected numbers: {error}") from error
    nowhere = frame == FRAME_MISSION  # what stands there then, a gimbal's flags perhaps, is meant as it is
    most = (_LARGEST_INT, _LARGEST_INT) if nowhere else (90, 180)
    if not (abs(lat_deg) <= most[0] and abs(lon_deg) <= most[1] and math.isfinite(z)):
        raise MissionError(
            f"{where}: expected a latitude, a longitude and an altitude, got {lat_deg}, {lon_deg} and {z}"
        )
    x, y = (round(value) if nowhere else degrees_to_wire(value) for value in (lat_deg, lon_deg))
    return MissionItem(seq, frame, command, param1, param2, param3, param4, x, y, z, current, autocontinue)
