"""Flights recorded from real autopilot code, where ../shared/data/flights is at hand (format: SOURCES.txt there).

The recordings' x and y are ArduPilot's own flat earth, 111318.845 m per degree: missions are read the same way.
"""

from __future__ import annotations

import csv
import gzip
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parents[3] / "shared" / "data" / "flights"
_METRES_PER_DEG = 111318.84502
_TAKEOFF, _WAYPOINT, _SPLINE, _SPEED, _LAND = 22, 16, 82, 178, 21


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """One recorded flight: its mission's waypoints and when they were reached, from the end of the take-off on."""

    name: str
    kind: str  # "ardupilot", "px4", "plane"
    splines: bool
    lands: bool  # after its last waypoint; else it returns
    home_m: np.ndarray  # (3,)
    top_m: np.ndarray  # (3,) end of the take-off
    waypoints_m: np.ndarray  # (W, 3)
    speed_m_s: np.ndarray  # (W,)
    hold_s: np.ndarray  # (W,)
    vertical_m_s: np.ndarray  # (W,) bound set by the mission; infinite where it sets none
    spline: np.ndarray  # (W,) whether flown to along a spline
    begin_s: float
    reached_s: np.ndarray  # (W,) NaN where the recording lost it
    t_s: np.ndarray  # (S,)
    position_m: np.ndarray  # (S, 3)
    velocity_m_s: np.ndarray  # (3,) at the beginning; zero for PX4, which has not recorded it


def names() -> list[str]:
    """Return the names of all recordings."""
    return sorted(path.name.removesuffix(".waypoints") for path in FOLDER.glob("*.waypoints"))


def read(name: str) -> Recording:
    """Read one recording; altitudes are AMSL."""
    kind = "px4" if name.startswith("px4") else "plane" if name.startswith("P_") else "ardupilot"
    rows = [line.split("\t") for line in (FOLDER / f"{name}.waypoints").read_text().splitlines()[1:] if line]
    lat, lon, base = float(rows[0][8]), float(rows[0][9]), float(rows[0][10])
    shift = 1 if kind == "px4" else 0  # the home row was not sent
    log = {item["seq"] + shift: item["t_reached"] for item in json.loads((FOLDER / f"{name}.json").read_text())["wp"]}
    speed = {"px4": 5.0, "plane": 22.0, "ardupilot": 10.0}[kind]
    takeoff = next(row for row in rows if int(row[3]) == _TAKEOFF)
    points, speeds, holds, verticals, splines, reached = [], [], [], [], [], []
    climb = descent = math.inf
    alt = float(takeoff[10])
    for row in rows[1:]:
        seq, command = int(row[0]), int(row[3])
        if command == _SPEED and 0.2 <= float(row[5]) <= 30.0 and float(row[4]) < 2.0:  # others are ignored
            speed = float(row[5])
        if command == _SPEED and kind == "ardupilot" and float(row[4]) == 2.0:
            climb = float(row[5])
        if command == _SPEED and kind == "ardupilot" and float(row[4]) == 3.0:
            descent = float(row[5])
        if command in (_WAYPOINT, _SPLINE):
            east = (float(row[9]) - lon) * _METRES_PER_DEG * math.cos(math.radians(lat))
            points.append([east, (float(row[8]) - lat) * _METRES_PER_DEG, base + float(row[10])])
            speeds.append(speed)
            verticals.append(climb if float(row[10]) > alt else descent)
            splines.append(command == _SPLINE)
            alt = float(row[10])
            holds.append(float(int(float(row[4]))))
            reached.append(math.nan if log[seq] is None else log[seq])
    with gzip.open(FOLDER / f"{name}.csv.gz", "rt") as file:
        table = list(csv.DictReader(file))
    t_s = np.array([float(row["t"]) for row in table])
    position = np.array([[float(row[c]) for c in ("x_east", "y_north", "alt_rel")] for row in table])
    position[:, 2] += base
    after = int(takeoff[0]) + 1
    begin_s = log.get(after) if int(rows[after][3]) == _SPEED else None
    if begin_s is None:
        begin_s = float(t_s[np.argmax([int(row["seq"]) + shift >= after for row in table])])
    k = int(np.searchsorted(t_s, begin_s))
    velocity = [float(table[k][c]) for c in ("ve", "vn", "vd")] if "vn" in table[k] else [0.0] * 3
    top = position[k] if kind == "plane" else np.array([0.0, 0.0, base + float(takeoff[10])])
    return Recording(
        name=name,
        kind=kind,
        splines=any(splines),
        lands=int(rows[-1][3]) == _LAND,
        home_m=np.array([0.0, 0.0, base]),
        top_m=top,
        waypoints_m=np.array(points),
        speed_m_s=np.array(speeds),
        hold_s=np.array(holds),
        vertical_m_s=np.array(verticals),
        spline=np.array(splines),
        begin_s=begin_s,
        reached_s=np.array(reached, dtype=float),
        t_s=t_s,
        position_m=position,
        velocity_m_s=np.array(velocity) * [1, 1, -1],
    )
