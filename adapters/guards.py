"""What a vehicle watches over by itself: its fence and its rally points, from the mission file, as MAVLink items.

A fence is a guard against what is not planned, so a planned flight must never touch it: the vehicle would break off a
proven mission. It has neither floor nor top, and its edges are straight between latitudes and longitudes. So a no-fly
area is sent only to who crosses it nowhere, neither on its mission nor on its way home from any place of it; and of any
fence, ours or one that a vehicle holds already, :func:`breach` says whether the flight keeps clear of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import (
    FRAME_GLOBAL,
    FRAME_RELATIVE,
    MissionItem,
    degrees_to_wire,
    wire_to_degrees,
)
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Place
from missionplanner.plan import FleetPlan, VehiclePlan
from missionplanner.vehicle import Autopilot, deviation_m

INCLUSION_VERTEX = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
EXCLUSION_VERTEX = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION
INCLUSION_CIRCLE = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION
EXCLUSION_CIRCLE = mavlink.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION
RETURN_POINT = mavlink.MAV_CMD_NAV_FENCE_RETURN_POINT
RALLY_POINT = mavlink.MAV_CMD_NAV_RALLY_POINT
_Limit = Literal["", "highest", "farthest", "lowest"]
_LIMITS: dict[Autopilot, dict[str, _Limit]] = {
    "ardupilot": {
        "FENCE_ENABLE": "",
        "FENCE_AUTOENABLE": "",
        "FENCE_TYPE": "",
        "FENCE_ALT_MAX": "highest",
        "FENCE_RADIUS": "farthest",
        "FENCE_ALT_MIN": "lowest",
    },
    "px4": {"GF_ACTION": "", "GF_MAX_VER_DIST": "highest", "GF_MAX_HOR_DIST": "farthest"},
}
_EARTH_M = 6_371_000.0
_CORNERS_MIN = 3
_AT_ONCE = 2_000  # segments of a flight held against all edges: bounds memory


@dataclass(frozen=True, slots=True)
class Guard:
    """What one vehicle is to hold besides its mission; ``kept_back`` says what of the mission file it is not sent."""

    fence: tuple[MissionItem, ...] = ()
    rally: tuple[MissionItem, ...] = ()
    kept_back: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Area:
    """One area of a fence as a vehicle holds it: a polygon, or (with one corner) a circle around it."""

    inclusion: bool
    corners: tuple[tuple[int, int], ...]  # latitude and longitude in 1e-7 degrees
    radius_m: float = 0.0

    def __str__(self) -> str:
        kind = "inclusion" if self.inclusion else "exclusion"
        lat_deg, lon_deg = (wire_to_degrees(value) for value in self.corners[0])
        shape = "circle" if self.radius_m else f"polygon of {len(self.corners)} corners"
        return f"{kind} {shape} at {lat_deg:.5f}, {lon_deg:.5f}"


def guard(plan: FleetPlan, vehicle: VehiclePlan) -> Guard:
    """Return the fence and the rally points of one vehicle of a plan.

    Raises
    ------
    InfeasibleError
        The mission file's fence does not hold the whole flight.
    """
    question = plan.mission
    areas: list[Area] = []
    kept_back = []
    if question.fleet.send_fence and question.fence is not None:
        area = Area(True, _corners(plan, question.fence.polygon))
        reason = _Flight(plan, vehicle).breach(area)
        if reason is not None:
            raise InfeasibleError(
                f"{vehicle.name}: as a fence that the vehicle holds, fence.polygon would end its mission: {reason}; "
                "widen it, or set fleet.send_fence: false"
            )
        areas.append(area)
    no_fly = [obstacle for obstacle in question.obstacles if obstacle.kind == "no_fly"]
    if question.fleet.send_fence and no_fly:
        flight = _Flight(plan, vehicle)
        for obstacle in no_fly:
            area = Area(False, _corners(plan, obstacle.polygon))
            reason = flight.breach(area) or flight.breach_on_return(area)
            if reason is None:
                areas.append(area)
            else:
                kept_back.append(
                    f"{vehicle.name} is not sent no-fly area {obstacle.name}: {reason}, and its fence knows no heights"
                )
    return Guard(area_items(areas), _rally(plan, vehicle), tuple(kept_back))


def breach(fence: Sequence[MissionItem], plan: FleetPlan, vehicle: VehiclePlan) -> str | None:
    """Return how a planned flight would breach a fence that its vehicle holds; None: it keeps clear of it."""
    if not fence:
        return None
    try:
        areas = read_areas(fence)
    except ValueError as error:
        return str(error)
    flight = _Flight(plan, vehicle)
    for area in areas:
        reason = flight.breach(area) or flight.breach_on_return(area)
        if reason is not None:
            return f"{area}: {reason}"
    return None


def fence_limits(autopilot: Autopilot) -> tuple[tuple[str, ...], ...]:
    """Return the parameters that say how high and how far from home a vehicle lets itself fly.

    Before them comes one that every vehicle has, to tell a vehicle without fences from one that does not answer.
    """
    return ("SYSID_THISMAV", "MAV_SYSID", "MAV_SYS_ID"), *((name,) for name in _LIMITS[autopilot])


def limit_breach(held: Mapping[str, float], plan: FleetPlan, vehicle: VehiclePlan) -> str | None:
    """Return how a planned flight would breach the limits that its vehicle holds: :func:`fence_limits`; None: not."""
    if vehicle.autopilot == "ardupilot":
        enabled = held.get("FENCE_ENABLE", 0.0) or held.get("FENCE_AUTOENABLE", 0.0)
        kinds = int(held.get("FENCE_TYPE", 0.0)) if enabled else 0
        active = {"FENCE_ALT_MAX": kinds & 1, "FENCE_RADIUS": kinds & 2, "FENCE_ALT_MIN": kinds & 8}
    else:
        acts = held.get("GF_ACTION", 0.0) > 0.0
        active = {name: acts and held.get(name, 0.0) > 0.0 for name in ("GF_MAX_VER_DIST", "GF_MAX_HOR_DIST")}
    flight = _Flight(plan, vehicle)
    for name, is_active in active.items():
        if is_active and name in held and (problem := flight.beyond(_LIMITS[vehicle.autopilot][name], held[name])):
            return f"{problem} ({name}): change it on the vehicle, or plan within it"
    return None


def area_items(areas: Sequence[Area]) -> tuple[MissionItem, ...]:
    """Return areas as the items of a fence."""
    items = []
    for area in areas:
        if area.radius_m:
            command, size = (INCLUSION_CIRCLE if area.inclusion else EXCLUSION_CIRCLE), area.radius_m
        else:
            command, size = (INCLUSION_VERTEX if area.inclusion else EXCLUSION_VERTEX), float(len(area.corners))
        items += [MissionItem(0, FRAME_GLOBAL, command, size, x=x, y=y) for x, y in area.corners]
    return tuple(replace(item, seq=seq) for seq, item in enumerate(items))


def read_areas(fence: Sequence[MissionItem]) -> list[Area]:
    """Return the areas of a fence.

    Raises
    ------
    ValueError
        Items that are none: the message says which.
    """
    areas = []
    k = 0
    while k < len(fence):
        item = fence[k]
        if item.command in (INCLUSION_CIRCLE, EXCLUSION_CIRCLE):
            if not 0.0 < item.param1 < math.inf:
                raise ValueError(f"fence item {k}: expected a radius above 0, got {item.param1:g}")
            areas.append(Area(item.command == INCLUSION_CIRCLE, ((item.x, item.y),), item.param1))
            k += 1
        elif item.command in (INCLUSION_VERTEX, EXCLUSION_VERTEX):
            count = int(item.param1) if math.isfinite(item.param1) else 0
            corners = [i for i in fence[k : k + count] if (i.command, i.param1) == (item.command, item.param1)]
            if not _CORNERS_MIN <= count == len(corners):
                raise ValueError(f"fence item {k}: expected {item.param1:g} corners of a polygon in a row, got others")
            areas.append(Area(item.command == INCLUSION_VERTEX, tuple((i.x, i.y) for i in corners)))
            k += count
        elif item.command == RETURN_POINT:
            k += 1
        else:
            raise ValueError(f"fence item {k}: expected an area, got command {item.command}")
    return areas


def _corners(plan: FleetPlan, polygon: Sequence[Place]) -> tuple[tuple[int, int], ...]:
    return tuple(_wire(plan, place) for place in polygon)


def _wire(plan: FleetPlan, place: Place) -> tuple[int, int]:
    if place.lat_deg is not None and place.lon_deg is not None:
        return degrees_to_wire(place.lat_deg), degrees_to_wire(place.lon_deg)
    assert place.x_m is not None and place.y_m is not None
    point = plan.frame.geo_point([place.x_m, place.y_m, 0.0])
    return degrees_to_wire(point.lat_deg), degrees_to_wire(point.lon_deg)


def _rally(plan: FleetPlan, vehicle: VehiclePlan) -> tuple[MissionItem, ...]:
    points = next((asked.rally for asked in plan.mission.vehicles if asked.name == vehicle.name), ())
    places = [(*_wire(plan, point), point.height_above_home_m) for point in points]
    if vehicle.autopilot == "ardupilot":  # it holds whole metres
        places = [(x, y, float(math.ceil(height_m))) for x, y, height_m in places]
    return tuple(MissionItem(seq, FRAME_RELATIVE, RALLY_POINT, x=x, y=y, z=z) for seq, (x, y, z) in enumerate(places))


class _Flight:
    """Where a planned flight is over the ground, and straight home from there."""

    def __init__(self, plan: FleetPlan, vehicle: VehiclePlan) -> None:
        self._frame = plan.frame
        asked = next(asked for asked in plan.mission.vehicles if asked.name == vehicle.name)
        self._reach_m = asked.tracking_error_m + asked.position_error_m + deviation_m(vehicle.motion)
        self._home_m = vehicle.home_m[:2]
        self._waypoints_m = np.vstack([vehicle.home_m, vehicle.waypoints_m])[:, :2]
        flown_m = vehicle.trajectory.position_m[:, :2]
        self._track_m = np.concatenate([_segments(self._waypoints_m), _segments(flown_m)])
        heights_m = vehicle.waypoints_m[:, 2] - vehicle.home_m[2]
        self._highest_m, self._lowest_m = float(heights_m.max()), float(heights_m.min())
        self._return_height_m = vehicle.motion.return_height_m
        self._aside_m = 0.0
        if vehicle.vehicle_class == "plane":
            highest_m = float(vehicle.trajectory.position_m[:, 2].max())
            self._aside_m = vehicle.motion.aside_m(
                vehicle.motion.cruise_speed_m_s, highest_m, plan.mission.wind_strongest_m_s
            )

    def beyond(self, limit: _Limit, bound_m: float) -> str | None:
        """Return what is wrong with a bound on heights above home, or on the distance from it."""
        if limit == "farthest":
            away_m = float(np.hypot(*(self._track_m.reshape(-1, 2) - self._home_m).T).max()) + self._reach_m
            return f"it flies {away_m:.0f} m from home, at most {bound_m:g} m are allowed" if away_m > bound_m else None
        if limit == "highest":
            high_m = max(self._highest_m, self._return_height_m) + self._reach_m
            return (
                f"it flies {high_m:.0f} m above home, at most {bound_m:g} m are allowed" if high_m > bound_m else None
            )
        low_m = self._lowest_m - self._reach_m
        return f"it flies {low_m:.0f} m above home, at least {bound_m:g} m are asked for" if low_m < bound_m else None

    def breach(self, area: Area) -> str | None:
        """Return what is wrong where the mission is flown."""
        return self._wrong(area, self._track_m, self._reach_m, "its mission")

    def breach_on_return(self, area: Area) -> str | None:
        """Return what is wrong on the straight way home from any place of the mission."""
        spokes_m = np.stack([np.broadcast_to(self._home_m, self._waypoints_m.shape), self._waypoints_m], axis=1)
        reason = self._wrong(area, spokes_m, self._reach_m + self._aside_m, "its way home")
        if reason is None and not area.inclusion:
            inside_m, _ = self._local(area)
            for a, b in zip(self._waypoints_m[:-1], self._waypoints_m[1:], strict=True):
                if _holds(np.array([self._home_m, a, b]), inside_m[0]):
                    return "its way home crosses it"
        return reason

    def _wrong(self, area: Area, lines_m: FloatArray, reach_m: float, what: str) -> str | None:
        corners_m, bulge_m = self._local(area)
        need_m = reach_m + bulge_m
        if area.radius_m:
            if area.inclusion:
                room_m = area.radius_m - float(np.hypot(*(lines_m.reshape(-1, 2) - corners_m[0]).T).max())
            else:
                room_m = float(_point_distances(corners_m, lines_m).min()) - area.radius_m
        else:
            edges_m = _segments(np.vstack([corners_m, corners_m[:1]]))
            pieces = (lines_m[k : k + _AT_ONCE] for k in range(0, len(lines_m), _AT_ONCE))
            room_m = min(float(_distances(piece_m, edges_m).min()) for piece_m in pieces)
            if _holds(corners_m, lines_m[0, 0]) != area.inclusion:
                room_m = -room_m
        if room_m >= need_m:
            return None
        if room_m <= 0.0:
            return f"{what} {'leaves' if area.inclusion else 'crosses'} it"
        return f"{what} comes within {room_m:.1f} m of its edge, where it may stray {need_m:.1f} m"

    def _local(self, area: Area) -> tuple[FloatArray, float]:
        """Return an area's corners (K, 2), and how far its edges may bulge: straight is not the same on every map."""
        lat_deg, lon_deg = (np.array([wire_to_degrees(corner[k]) for corner in area.corners]) for k in (0, 1))
        corners_m = self._frame.to_local(lat_deg, lon_deg, np.zeros(len(lat_deg)))[:, :2]
        if area.radius_m:
            return corners_m, 0.005 * area.radius_m  # metres per degree differ by so much between formulas
        longest_m = float(np.hypot(*(corners_m - np.roll(corners_m, 1, axis=0)).T).max())
        tangent = math.tan(math.radians(min(float(np.abs(lat_deg).max()), 85.0)))
        return corners_m, longest_m**2 * tangent / (8.0 * _EARTH_M)


def _segments(points: FloatArray) -> FloatArray:
    """Return the segments (N - 1, 2, 2) between points (N, 2)."""
    return np.stack([points[:-1], points[1:]], axis=1)


def _distances(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the distances (N, K) between segments (N, 2, 2) and (K, 2, 2); 0 where they cross."""
    apart = np.minimum(
        np.minimum(_point_distances(first[:, 0], second), _point_distances(first[:, 1], second)),
        np.minimum(_point_distances(second[:, 0], first), _point_distances(second[:, 1], first)).T,
    )
    a, b = first[:, None, 0], first[:, None, 1]
    c, d = second[None, :, 0], second[None, :, 1]
    crossing = (_side(a, b, c) * _side(a, b, d) < 0.0) & (_side(c, d, a) * _side(c, d, b) < 0.0)
    return np.where(crossing, 0.0, apart)


def _side(a: FloatArray, b: FloatArray, p: FloatArray) -> FloatArray:
    """Return on which side of the line from a to b a point is: positive, negative, 0 on it."""
    ab, ap = b - a, p - a
    side: FloatArray = ab[..., 0] * ap[..., 1] - ab[..., 1] * ap[..., 0]
    return side


def _point_distances(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Return the distances (N, K) of points (N, 2) to segments (K, 2, 2)."""
    start, along = segments[None, :, 0], (segments[:, 1] - segments[:, 0])[None]
    length2 = np.maximum((along**2).sum(axis=-1), 1e-12)
    offset = points[:, None] - start
    share = np.clip((offset * along).sum(axis=-1) / length2, 0.0, 1.0)
    nearest = offset - share[..., None] * along
    distances: FloatArray = np.hypot(nearest[..., 0], nearest[..., 1])
    return distances


def _holds(polygon: FloatArray, point: FloatArray) -> bool:
    """Return whether a polygon (K, 2) holds a point, by the edges that a ray from it crosses."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    above = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # of edges that no ray crosses
        x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool((above & (point[0] < x)).sum() % 2)
