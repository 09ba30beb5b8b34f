"""One vehicle's plan as Litchi's CSV, as its Mission Hub imports and exports it.

One row per waypoint: heights above the take-off, a heading, a camera's pitch and up to 15 actions. Columns, codes and
ranges: https://www.litchiutilities.com/docs/litchiCsv.php and DJI's limits behind them (DJI Mobile SDK, Waypoint;
https://forum.flylitchi.com/t/903). Speed and distance between photos are those of the leg *from* a waypoint.

The file holds waypoints only. What it cannot say must be set by hand after its import (see :func:`remarks`). Nothing of
it is proven for the aircraft that fly it.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
from dataclasses import dataclass, replace

import numpy as np

from adapters.aiming import aim, headings_deg, hold_s, turn_deg
from missionplanner import camera
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Action, FleetPlan, VehiclePlan

WAYPOINTS_MAX = 99
"""Of one mission: longer ones are written in parts."""

_ACTIONS = 15
_HEADER = (
    *("latitude", "longitude", "altitude(m)", "heading(deg)", "curvesize(m)", "rotationdir", "gimbalmode"),
    "gimbalpitchangle",
    *itertools.chain.from_iterable((f"actiontype{k}", f"actionparam{k}") for k in range(1, _ACTIONS + 1)),
    *("altitudemode", "speed(m/s)", "poi_latitude", "poi_longitude", "poi_altitude(m)", "poi_altitudemode"),
    *("photo_timeinterval", "photo_distinterval"),
)
_NOTHING, _STAY, _PHOTO, _TURN, _TILT = -1, 0, 1, 4, 5
_AIM_DISABLED, _AIM_INTERPOLATED = 0, 2
_ABOVE_TAKE_OFF = 0
_NONE = -1.0
_HEIGHTS_M = (-200.0, 500.0)
_SPEEDS_M_S = (0.1, 15.0)
_PITCHES_DEG = (-90.0, 30.0)
_LEG_M = (0.6, 1999.0)
_STAY_MS = 32_000
_SAME_DEG = 1.0  # a nose or camera that is so much off is not turned again


@dataclass(frozen=True, slots=True, eq=False)
class _Waypoint:
    """One row, before it is written."""

    position_m: FloatArray
    heading_deg: float
    pitch_deg: float | None
    actions: tuple[tuple[int, int], ...]  # code and parameter
    speed_m_s: float
    photo_every_m: float  # on the leg from here; 0: none


def litchi_csv(plan: FleetPlan, vehicle: VehiclePlan) -> list[str]:
    """Return the files of one vehicle: one, or as many parts as it takes, each beginning where the one before ended.

    Raises
    ------
    MissionError
        The plan asks for what Litchi cannot say: a plane, a speed, a height, a camera's pitch out of range.
    """
    rows = _with_short_legs(_waypoints(plan, vehicle))
    _check(vehicle, rows)
    return [_text(plan, vehicle, part) for part in _parts(rows)]


def remarks(plan: FleetPlan) -> list[str]:
    """Return what who flies Litchi's missions must know and set."""
    ends = {"land": "Land", "rtl": "RTH", "loiter": "None"}
    finish = sorted({f"{vehicle.name} {ends[vehicle.end]}" for vehicle in plan.vehicles})
    lens = None if plan.mission.inspection is None else camera.of(plan.mission.inspection.camera)
    return [
        *([] if lens is None else [f"CAMERA: views and photos are planned for {lens.name}: fly with no other"]),
        "Litchi missions are NOT PROVEN: no proof covers how the aircraft flies between waypoints, whether its battery "
        "lasts, its way home, or that vehicles keep apart: fly one at a time",
        "Litchi heights count from the take-off: start each at its planned home, and nowhere else",
        "Litchi's settings are not in its files: set Path Mode to Straight Lines, Heading Mode to Custom, and Finish "
        f"Action to: {', '.join(finish)} (of a mission in parts: None, but for its last part)",
    ]


def _waypoints(plan: FleetPlan, vehicle: VehiclePlan) -> list[_Waypoint]:
    headings = headings_deg(vehicle, plan.frame)
    speeds_m_s = [*vehicle.speeds_m_s.tolist(), float(vehicle.speeds_m_s[-1])]
    return [
        _waypoint(plan, vehicle, k, heading_deg, speed_m_s)
        for k, (heading_deg, speed_m_s) in enumerate(zip(headings, speeds_m_s, strict=True))
    ]


def _waypoint(plan: FleetPlan, vehicle: VehiclePlan, k: int, heading_deg: float, speed_m_s: float) -> _Waypoint:
    here, following = vehicle.actions.get(k, Action()), vehicle.actions.get(k + 1, Action())
    position_m = vehicle.waypoints_m[k]
    own = aim(here, position_m, plan.frame)
    actions: list[tuple[int, int]] = []
    if own is not None:
        actions += [(_TURN, round(heading_deg) % 360), (_TILT, round(own.pitch_deg))]
    left_ms = round(1000.0 * hold_s(vehicle, k))
    while left_ms > 0:
        actions.append((_STAY, min(left_ms, _STAY_MS)))
        left_ms -= _STAY_MS
    actions += [(_PHOTO, 0)] * here.photos
    ahead = aim(following, position_m, plan.frame) if following.photo_every_m > 0.0 else None
    if ahead is not None:
        if ahead.heading_deg is not None and abs(turn_deg(heading_deg, ahead.heading_deg)) > _SAME_DEG:
            actions.append((_TURN, round(ahead.heading_deg) % 360))
        if own is None or abs(own.pitch_deg - ahead.pitch_deg) > _SAME_DEG:
            actions.append((_TILT, round(ahead.pitch_deg)))
    if len(actions) > _ACTIONS:
        raise MissionError(
            f"{vehicle.name}: {here.name or f'waypoint {k}'}: expected at most {_ACTIONS} actions for Litchi, got "
            f"{len(actions)}: take fewer photos there, or hold for less time"
        )
    pitch_deg = None if own is None else own.pitch_deg
    return _Waypoint(position_m, heading_deg, pitch_deg, tuple(actions), speed_m_s, following.photo_every_m)


def _with_short_legs(rows: list[_Waypoint]) -> list[_Waypoint]:
    """Return waypoints with others between them, on the same straight legs, where a leg is longer than DJI flies."""
    short: list[_Waypoint] = []
    for row, following in itertools.pairwise(rows):
        step_m = following.position_m - row.position_m
        pieces = math.ceil(float(np.linalg.norm(step_m)) / _LEG_M[1])
        short.append(row)
        for piece in range(1, pieces):
            share = piece / pieces
            turned_deg = turn_deg(row.heading_deg, following.heading_deg)
            between = replace(
                row,
                position_m=row.position_m + share * step_m,
                heading_deg=(row.heading_deg + share * turned_deg) % 360.0,
                actions=(),
            )
            short.append(between)
    return [*short, rows[-1]]


def _parts(rows: list[_Waypoint]) -> list[list[_Waypoint]]:
    """Return rows in parts of at most 99; a part begins with a bare copy of the last waypoint of the one before."""
    parts: list[list[_Waypoint]] = []
    begin = 0
    while begin < len(rows) - 1:
        end = min(begin + WAYPOINTS_MAX, len(rows))
        while end < len(rows) and rows[end - 1].photo_every_m > 0.0 and end - 1 > begin + 1:
            end -= 1  # the camera is turned before a leg that is photographed: both in one part
        first = rows[begin] if begin == 0 else replace(rows[begin], actions=())
        parts.append([first, *rows[begin + 1 : end]])
        begin = end - 1
    return parts


def _check(vehicle: VehiclePlan, rows: list[_Waypoint]) -> None:
    name = vehicle.name
    if vehicle.vehicle_class != "copter":
        raise MissionError(f"{name}: expected a copter for Litchi, got a {vehicle.vehicle_class}")
    for row in rows:
        for what, value, (low, high), remedy in (
            ("heights above home in m", row.position_m[2] - vehicle.home_m[2], _HEIGHTS_M, "start nearer to them"),
            ("speeds in m/s", row.speed_m_s, _SPEEDS_M_S, "change its speed_m_s and plan again"),
            ("camera pitches in degrees", row.pitch_deg or 0.0, _PITCHES_DEG, "look from higher up"),
        ):
            if not low <= value <= high:
                raise MissionError(
                    f"{name}: expected {what} of {low:g} to {high:g} for Litchi, got {value:.4g}: {remedy}"
                )
    for number, (begin, end) in enumerate(itertools.pairwise(rows)):
        apart_m = float(np.linalg.norm(end.position_m - begin.position_m))
        if apart_m < _LEG_M[0]:
            raise MissionError(
                f"{name}: expected waypoints at least {_LEG_M[0]:g} m apart for Litchi, got {number} and {number + 1} "
                f"only {apart_m:.2f} m apart"
            )


def _text(plan: FleetPlan, vehicle: VehiclePlan, rows: list[_Waypoint]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_HEADER)
    for k, row in enumerate(rows):
        place = plan.frame.geo_point(row.position_m)
        actions = [*row.actions, *[(_NOTHING, 0)] * (_ACTIONS - len(row.actions))]
        photographed = row.photo_every_m > 0.0 and k < len(rows) - 1
        writer.writerow(
            [
                f"{place.lat_deg:.8f}",
                f"{place.lon_deg:.8f}",
                f"{row.position_m[2] - vehicle.home_m[2]:.2f}",
                round(row.heading_deg, 1) + 0.0,
                0.0,  # no curves: the legs of the plan
                0,
                _AIM_DISABLED if row.pitch_deg is None else _AIM_INTERPOLATED,
                round(row.pitch_deg or 0.0, 1) + 0.0,
                *itertools.chain.from_iterable(actions),
                _ABOVE_TAKE_OFF,
                f"{row.speed_m_s:.2f}",
                *(0.0, 0.0, 0.0, 0),
                _NONE,
                f"{row.photo_every_m:.2f}" if photographed else _NONE,
            ]
        )
    return text.getvalue()
