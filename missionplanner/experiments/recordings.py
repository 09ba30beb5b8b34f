"""Flights recorded from real autopilot code: ``NAME.waypoints``, ``NAME.csv.gz`` (or ``.csv``) and ``NAME.json``.

The format is described in docs/FIDELITY.md. Positions are metres of the autopilot's own flat earth around its home.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
import math
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from adapters.mission_items import TAKEOFF, WAYPOINT, MissionItem, wire_to_degrees
from adapters.sorties import LOITER_TIME, SPLINE_WAYPOINT
from adapters.waypoints_file import read_waypoints_home
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray, GeoPoint, LocalFrame
from missionplanner.vehicle import Autopilot, VehicleClass

Kind = Literal["arducopter", "arduplane", "px4"]

METRES_PER_DEG = 111_318.84502
"""ArduPilot's flat earth (LOCATION_SCALING_FACTOR): a degree of latitude, whatever the latitude."""

_COPTER_AUTO, _PLANE_AUTO = 3, 10  # HEARTBEAT.custom_mode in a mission
_DO_FROM = 96  # commands from here on are done at once (MAV_CMD_NAV_LAST is 95)
_PLACED = (WAYPOINT, SPLINE_WAYPOINT, LOITER_TIME)
_COLUMNS = ("t", "x_east", "y_north", "alt_rel", "seq")
_AWAY_M = 200.0  # a plane passes by its waypoints by less


class FlatEarth(LocalFrame):
    """The local frame as ArduPilot has it, and as its simulator flies: one scale for all latitudes.

    The ellipsoid's metres differ by up to 0.4 %, which would be taken for an error of the motion model.
    """

    __slots__ = ()

    def to_local(self, lat_deg: npt.ArrayLike, lon_deg: npt.ArrayLike, alt_amsl_m: npt.ArrayLike) -> FloatArray:
        """Return positions (..., 3) in metres for degrees and altitudes of shape (...)."""
        lat, lon, alt = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (lat_deg, lon_deg, alt_amsl_m)))
        east = METRES_PER_DEG * math.cos(math.radians(self.origin_lat_deg))
        return np.stack([(lon - self.origin_lon_deg) * east, (lat - self.origin_lat_deg) * METRES_PER_DEG, alt], -1)

    def to_geo(self, position_m: npt.ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return latitude, longitude (degrees) and altitude AMSL, each (...), of positions (..., 3)."""
        x, y, z = np.moveaxis(np.asarray(position_m, dtype=float), -1, 0)
        east = METRES_PER_DEG * math.cos(math.radians(self.origin_lat_deg))
        return self.origin_lat_deg + y / METRES_PER_DEG, self.origin_lon_deg + x / east, z


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One recorded flight. Time counts from MISSION_START, PX4's from arming."""

    name: str
    kind: Kind
    home: GeoPoint
    items: tuple[MissionItem, ...]  # as uploaded
    done_s: dict[int, float]  # when items were reported as reached, by seq
    t_s: FloatArray  # (S,) rising
    position_m: FloatArray  # (S, 3) in the flat earth around home, z AMSL
    speed_m_s: FloatArray  # (S,) over ground
    current: npt.NDArray[np.int64]  # (S,) the item being flown

    @property
    def autopilot(self) -> Autopilot:
        """The autopilot."""
        return "px4" if self.kind == "px4" else "ardupilot"

    @property
    def vehicle_class(self) -> VehicleClass:
        """The vehicle's class."""
        return "plane" if self.kind == "arduplane" else "copter"

    @property
    def frame(self) -> FlatEarth:
        """The frame of ``position_m``."""
        return FlatEarth(self.home.lat_deg, self.home.lon_deg)

    @property
    def waypoints(self) -> tuple[MissionItem, ...]:
        """The items whose times are compared: waypoints, straight and spline, and timed loiters."""
        home = self.autopilot == "ardupilot"  # is its item 0
        return tuple(item for item in self.items[1 if home else 0 :] if item.command in _PLACED)

    def reached_s(self, seq: int) -> float | None:
        """Return when an item was reached, None where that was lost.

        A DO command is done the instant the item before it is, and its report may replace that one's (PX4 has one
        slot, and a take-off's is never kept): then it tells the time.
        """
        if seq in self.done_s:
            return self.done_s[seq]
        after = self.items[seq + 1] if seq + 1 < len(self.items) else None
        return self.done_s.get(seq + 1) if after is not None and after.command >= _DO_FROM else None

    def passed_s(self, seq: int) -> float | None:
        """Return when an item was reached; where its report is lost, when the next one was first being flown."""
        at_s = self.reached_s(seq)
        if at_s is None:
            later = np.flatnonzero(self.current > seq)
            at_s = float(self.t_s[later[0]]) if later.size else None
        return at_s

    @property
    def climbed_s(self) -> float | None:
        """When the take-off ended."""
        takeoff = next((item.seq for item in self.items if item.command == TAKEOFF), None)
        return None if takeoff is None else self.passed_s(takeoff)


def find_recordings(folder: Path) -> list[str]:
    """Return the names of all flights of a folder, also of those that lack a file.

    Raises
    ------
    MissionError
        There is no such folder, or nothing of that kind in it.
    """
    if not folder.is_dir():
        raise MissionError(f"--flights: expected a folder of recorded flights, got {folder}, which is none")
    names = {path.name.removesuffix(".waypoints") for path in folder.glob("*.waypoints")}
    names |= {path.name.removesuffix(".gz").removesuffix(".csv") for path in folder.glob("*.csv*") if _is_table(path)}
    if not names:
        raise MissionError(
            f"--flights: expected recorded flights (NAME.waypoints, NAME.csv.gz, NAME.json) in {folder}, found none"
        )
    return sorted(names)


def _is_table(path: Path) -> bool:
    return path.name.endswith((".csv", ".csv.gz"))


def read_recording(folder: Path, name: str) -> Recording:
    """Read one flight; of which kind it is, its content says, and only where that does not, its name.

    Raises
    ------
    MissionError
        A file is missing or damaged, or they are not of one flight.
    """
    table_path = folder / f"{name}.csv.gz"
    if not table_path.exists() and (folder / f"{name}.csv").exists():
        table_path = folder / f"{name}.csv"
    table = _table(table_path)
    wp = _reports(folder / f"{name}.json")
    kind = _kind(name, table, wp)
    mission_path = folder / f"{name}.waypoints"
    items, home = read_waypoints_home(mission_path, "px4" if kind == "px4" else "ardupilot")
    if home is None:
        raise MissionError(f"{mission_path}: expected home in row 0, got none")
    done_s: dict[int, float] = {}
    for seq, command, at_s in wp:
        if not 0 <= seq < len(items) or items[seq].command != command:
            held = f"command {items[seq].command}" if 0 <= seq < len(items) else "no such item"
            raise MissionError(
                f"{folder / name}.json: item {seq}: expected what {mission_path.name} says ({held}), got command "
                f"{command}: are they of one flight?"
            )
        if at_s is not None:
            done_s[seq] = at_s
    position_m = np.stack([table["x_east"], table["y_north"], home.alt_amsl_m + table["alt_rel"]], axis=-1)
    speed = table["ground_speed"] if "ground_speed" in table else np.hypot(table["vn"], table["ve"])
    recording = Recording(name, kind, home, items, done_s, table["t"], position_m, speed, table["seq"].astype(np.int64))
    _check_places(recording, mission_path)
    return recording


def _check_places(recording: Recording, path: Path) -> None:
    """Refuse a flight that was not flown along its mission."""
    if not recording.waypoints:
        raise MissionError(f"{path}: expected at least one waypoint, got none")
    frame, positions = recording.frame, recording.position_m
    for item in recording.waypoints:
        if not (item.x or item.y):
            continue  # where it then is
        x, y, _ = frame.to_local(wire_to_degrees(item.x), wire_to_degrees(item.y), 0.0)
        away_m = float(np.hypot(positions[:, 0] - x, positions[:, 1] - y).min())
        if away_m > _AWAY_M:
            raise MissionError(
                f"{path}: item {item.seq}: expected a flight past it, but the recorded one stays {away_m:.0f} m away: "
                "are they of one flight?"
            )
    if recording.passed_s(recording.waypoints[-1].seq) is None:
        raise MissionError(f"{path}: expected a flight that reaches its last waypoint, got one that does not tell so")


def _kind(name: str, table: dict[str, FloatArray], wp: list[tuple[int, int, float | None]]) -> Kind:
    """Return whose flight it is: PX4 has no home item and tells no custom mode; in a mission, planes are in mode 10."""
    if wp and min(seq for seq, _, _ in wp) == 0 and "mode" not in table:
        return "px4"
    if "mode" in table:
        copter, plane = (int(np.count_nonzero(table["mode"] == mode)) for mode in (_COPTER_AUTO, _PLANE_AUTO))
        if copter != plane:
            return "arducopter" if copter > plane else "arduplane"
    return "px4" if name.startswith("px4_") else "arduplane" if name.startswith("P_") else "arducopter"


def _table(path: Path) -> dict[str, FloatArray]:
    """Return the columns of a recording."""
    try:
        data = path.read_bytes()
        text = (gzip.decompress(data) if path.suffix == ".gz" else data).decode()
        rows = list(csv.reader(io.StringIO(text)))
    except FileNotFoundError:
        raise MissionError(f"{path}: missing: a flight is NAME.waypoints, NAME.csv.gz and NAME.json") from None
    except (OSError, EOFError, zlib.error, UnicodeDecodeError, csv.Error) as error:
        raise MissionError(f"{path}: expected a readable table, got: {error}") from error
    head = [column.strip() for column in rows[0]] if rows else []
    speeds = {"ground_speed"} <= set(head) or {"vn", "ve"} <= set(head)
    if not set(_COLUMNS) <= set(head) or not speeds:
        wanted = f"{', '.join(_COLUMNS)} and ground_speed or vn, ve"
        raise MissionError(f"{path}: expected the columns {wanted}, got {', '.join(head)[:120] or 'an empty file'}")
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(head):
            raise MissionError(f"{path}:{number}: expected {len(head)} columns, got {len(row)}: is it cut short?")
    names = [c for c in head if c in {*_COLUMNS, "ground_speed", "vn", "ve", "mode"}]
    try:
        table = {c: np.array([float(row[head.index(c)]) for row in rows[1:]]) for c in names}
    except ValueError as error:
        raise MissionError(f"{path}: expected numbers, got: {error}") from error
    t_s = table["t"]
    if len(t_s) < 2 or not all(np.isfinite(column).all() for column in table.values()):
        raise MissionError(f"{path}: expected at least two rows of finite numbers, got {len(t_s)} rows")
    order = np.argsort(t_s, kind="stable")  # rows may come late over a link
    return {c: column[order] for c, column in table.items()}


def _reports(path: Path) -> list[tuple[int, int, float | None]]:
    """Return the seq of every item told of, its command, and when it was reached."""
    try:
        document: Any = json.loads(path.read_bytes())
        return [
            (int(wp["seq"]), int(wp["cmd"]), None if wp["t_reached"] is None else _time(wp["t_reached"]))
            for wp in document["wp"]
        ]
    except FileNotFoundError:
        raise MissionError(f"{path}: missing: a flight is NAME.waypoints, NAME.csv.gz and NAME.json") from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise MissionError(f"{path}: expected a list wp of seq, cmd and t_reached, got: {error!r}") from error


def _time(value: object) -> float:
    at_s = float(str(value))
    if not math.isfinite(at_s):
        raise ValueError(f"a time of {value}")
    return at_s
