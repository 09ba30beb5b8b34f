"""Recorded flights made by hand, in the format of docs/FIDELITY.md: for tests where no real ones are at hand."""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from adapters.waypoints_file import read_waypoints_home
from missionplanner.experiments import fidelity
from missionplanner.experiments.recordings import FlatEarth, Kind, Recording
from missionplanner.geodesy import FloatArray
from missionplanner.proof import Flight

LAT, LON, ALT = -35.363262, 149.165237, 584.0
TAKEOFF, SPEED, WAYPOINT, LAND = 22, 178, 16, 21
NAN = math.nan

Row = tuple[int, int, float, float, float, float, float, float]  # frame, command, p1, p2, p3, east, north, up


def legs(speed_m_s: float = 8.0, hold_s: float = 0.0) -> list[Row]:
    """Return a mission of four waypoints, the first where the take-off ends."""
    return [
        (3, TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0),
        (2, SPEED, 1.0, speed_m_s, -1.0, NAN, NAN, 0.0),
        (3, WAYPOINT, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0),
        (3, WAYPOINT, hold_s, 0.0, 0.0, 0.0, 120.0, 25.0),
        (2, SPEED, 1.0, 5.0, -1.0, NAN, NAN, 0.0),
        (3, WAYPOINT, 0.0, 0.0, 0.0, 90.0, 120.0, 25.0),
        (3, WAYPOINT, 0.0, 0.0, 0.0, 90.0, 20.0, 22.0),
        (3, LAND, 0.0, 0.0, 0.0, 90.0, 20.0, 0.0),
    ]


def plane_legs() -> list[Row]:
    """Return a plane's mission."""
    return [
        (3, TAKEOFF, 15.0, 0.0, 0.0, 0.0, 0.0, 60.0),
        (2, SPEED, 0.0, 20.0, -1.0, NAN, NAN, 0.0),
        (3, WAYPOINT, 0.0, 0.0, 0.0, 0.0, 600.0, 60.0),
        (3, WAYPOINT, 0.0, 0.0, 0.0, 500.0, 700.0, 60.0),
        (3, WAYPOINT, 0.0, 0.0, 0.0, 900.0, 200.0, 60.0),
        (2, 20, 0.0, 0.0, 0.0, NAN, NAN, 0.0),
    ]


def mission_text(rows: Sequence[Row]) -> str:
    """Return the .waypoints file."""
    frame = FlatEarth(LAT, LON)
    lines = ["QGC WPL 110", f"0\t1\t0\t16\t0\t0\t0\t0\t{LAT:.8f}\t{LON:.8f}\t{ALT}\t1"]
    for seq, (kind, command, p1, p2, p3, east, north, up) in enumerate(rows, start=1):
        nowhere = math.isnan(east)
        lat, lon, _ = (0.0, 0.0, 0.0) if nowhere else frame.to_geo([east, north, 0.0])
        lines.append(f"{seq}\t0\t{kind}\t{command}\t{p1}\t{p2}\t{p3}\t0\t{lat:.8f}\t{lon:.8f}\t{up}\t1")
    return "\n".join(lines) + "\n"


def record(
    folder: Path, name: str, kind: Kind, rows: Sequence[Row], *, stretch: float = 1.0, aside_m: float = 0.0
) -> Flight:
    """Write what is predicted of a mission as a recording, ``stretch`` times as slow and beside its path."""
    path = folder / f"{name}.waypoints"
    path.write_text(mission_text(rows))
    items, home = read_waypoints_home(path, "px4" if kind == "px4" else "ardupilot")
    assert home is not None
    ahead = np.array([[0.0, 0.0, ALT], [0.0, 100.0, ALT]])  # the way a plane stands
    blank = Recording(name, kind, home, items, {}, np.arange(2.0), ahead, np.zeros(2), np.zeros(2, dtype=np.int64))
    flight = fidelity.predict(blank)
    done_s = {
        leg.seq: stretch * (float(at_s) + leg.hold_s)
        for leg, at_s in zip(flight.sortie.legs, flight.reached_s, strict=True)
    }
    reports = []
    for item in items[0 if kind == "px4" else 1 :]:
        told = {SPEED: done_s.get(item.seq - 1), WAYPOINT: done_s.get(item.seq)}.get(item.command)
        reports.append({"seq": item.seq, "cmd": item.command, "t_reached": None if told is None else round(told, 4)})
    t_s = np.arange(0.0, float(flight.trajectory.t_s[-1]) * stretch, 0.1)
    position_m = flight.trajectory.at(t_s / stretch) + np.array([aside_m, 0.0, -ALT])
    ends = sorted((end_s, seq) for seq, end_s in done_s.items())
    after = np.array([ends[0][1], *(seq + 1 for _, seq in ends)])
    current = after[np.searchsorted([end_s for end_s, _ in ends], t_s, side="left")]
    write(folder, name, kind, t_s, position_m, current, reports)
    return flight


def write(
    folder: Path,
    name: str,
    kind: Kind,
    t_s: FloatArray,
    position_m: FloatArray,
    current: npt.NDArray[np.int64],
    reports: Sequence[dict[str, Any]],
) -> None:
    """Write the table and the reports, with the columns that the kind has."""
    velocity_m_s = np.gradient(position_m, t_s, axis=0)
    lines = []
    for at_s, (x, y, z), (vx, vy, vz), seq in zip(t_s, position_m, velocity_m_s, current, strict=True):
        place = f"{x:.3f},{y:.3f}"
        if kind == "px4":
            lines.append(f"{at_s:.3f},{place},{z:.3f},{math.hypot(vx, vy):.3f},{seq}")
        else:
            mode = 10 if kind == "arduplane" else 3
            lines.append(
                f"{at_s:.3f},{at_s * 1e3:.0f},0,0,{z + ALT:.3f},{z:.3f},{vy:.3f},{vx:.3f},{-vz:.3f},0,"
                f"{place},{seq},{mode}"
            )
    head = "t,x_east,y_north,alt_rel,ground_speed,seq"
    if kind != "px4":
        head = "t,boot_ms,lat,lon,alt_amsl,alt_rel,vn,ve,vd,heading,x_east,y_north,seq,mode"
    (folder / f"{name}.csv.gz").write_bytes(gzip.compress("\n".join([head, *lines, ""]).encode()))
    (folder / f"{name}.json").write_text(json.dumps({"wp": list(reports)}))
