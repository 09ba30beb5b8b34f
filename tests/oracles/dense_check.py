"""What exported missions and flown tracks keep clear of, found the slow and obvious way: samples every 0.1 m.

Nothing of the planner is used: the mission file is read as plain YAML, the ``.waypoints`` and ``.plan`` files as text,
the ground is Keys' convolution in the raster's own coordinates (or the sum of the peaks), and distances are school
geometry. Legs are judged with balls rolled along them, as wide as a copter may be off: to the sides of slopes too.
``python -m tests.oracles.dense_check MISSION FOLDER`` prints what it finds of a plan folder.
"""

from __future__ import annotations

import functools
import itertools
import json
import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import shapely
import yaml
from pyproj import CRS, Transformer
from scipy.optimize import brentq

STEP_M = 0.1
ROUNDING_M = 0.05
"""Room for what is not the planner's: 1e-7 degree is 1.1 cm, on slopes also in height; peaks are not gridded here."""
_COARSE = 50  # samples
_BESIDE = 5  # samples between the balls whose surfaces are held against the ground
_RINGS, _SPOKES = 4, 16

_TAKEOFF, _WAYPOINT = 22, 16
_GLOBAL, _RELATIVE = 0, 3  # frames

Array = np.ndarray
Distance = Callable[[Array], Array]
"""Signed distances (N,) of points (N, 3), negative inside."""


@dataclass(frozen=True)
class Least:
    """The least distance that was found, and the one that was asked for."""

    what: str
    distance_m: float
    required_m: float
    at_m: tuple[float, ...]

    @property
    def margin_m(self) -> float:
        """How much more than asked for; NaN (no terrain) is none."""
        return -math.inf if math.isnan(self.distance_m) else self.distance_m - self.required_m

    @property
    def ok(self) -> bool:
        return self.margin_m >= -ROUNDING_M


@dataclass(frozen=True)
class Inspected:
    """The share of towers, by weight, that somebody passed within range, and the least that was asked for."""

    share: float
    share_min: float
    missed: tuple[str, ...]


class World:
    """The mission file's terrain, obstacles and fence, from the text."""

    def __init__(self, mission_path: Path) -> None:
        self.mission: dict[str, Any] = yaml.safe_load(mission_path.read_text(encoding="utf-8"))
        origin = self.mission["origin"]
        self.local = CRS.from_proj4(
            f"+proj=tmerc +lat_0={origin['lat_deg']!r} +lon_0={origin['lon_deg']!r} +k=1 +ellps=WGS84 +units=m"
        )
        self._from_degrees = Transformer.from_crs(4326, self.local, always_xy=True)
        self.vehicles = [_over(self.mission.get("defaults", {}), v) for v in self.mission["vehicles"]]
        self.ground_m = self._ground(mission_path.parent)
        self.obstacles: list[tuple[str, Distance]] = [
            (o["name"], solid)
            for o in self.mission.get("obstacles", ())
            if o.get("hard", True)
            for solid in (self._other_line(o) if o["kind"] == "line" else [self._solid(o)])
        ]
        self.obstacles += self._line()
        self.fence = self._fence()
        self.vertical_error_m = float(self.mission["terrain"].get("vertical_error_m", 0.0))
        self.separation_m = float(self.mission.get("fleet", {}).get("separation_m", 20.0))

    def position(self, lat_deg: float, lon_deg: float, alt_amsl_m: float) -> Array:
        return np.array([*self._from_degrees.transform(lon_deg, lat_deg), alt_amsl_m])

    # --- the ground

    def _ground(self, folder: Path) -> Callable[[Array], Array]:
        terrain = self.mission["terrain"]
        if terrain["kind"] == "flat":
            return lambda xy: np.full(len(xy), float(terrain["alt_amsl_m"]))
        if terrain["kind"] == "peaks":
            peaks = [(self.xy(p), p["height_m"], p["spread_m"]) for p in terrain["peaks"]]
            base = float(terrain.get("base_alt_amsl_m", 0.0))
            return lambda xy: (
                base + sum(h * np.exp(-(((xy - p) ** 2).sum(axis=1) / spread**2)) for p, h, spread in peaks)
            )
        with rasterio.open(folder / terrain["file"]) as dataset:
            heights = dataset.read(1).astype(float)
            if dataset.nodata is not None:
                heights[heights == dataset.nodata] = np.nan
            (a, b, c, d, e, f), crs = (~dataset.transform)[:6], CRS.from_wkt(dataset.crs.to_wkt())
        to_raster = Transformer.from_crs(self.local, crs, always_xy=True)

        def ground(xy: Array) -> Array:
            east, north = to_raster.transform(xy[:, 0], xy[:, 1])
            col, row = a * east + b * north + c, d * east + e * north + f  # from a pixel's corner
            return _keys(heights, row - 0.5, col - 0.5)

        return ground

    def xy(self, place: dict[str, Any]) -> Array:
        if "x_m" in place:
            return np.array([place["x_m"], place["y_m"]], dtype=float)
        return self.position(place["lat_deg"], place["lon_deg"], 0.0)[:2]

    def ground_at(self, xy: Array) -> float:
        return float(self.ground_m(xy[np.newaxis])[0])

    def point(self, place: dict[str, Any]) -> Array:
        xy = self.xy(place)
        z = place["alt_amsl_m"] if "alt_amsl_m" in place else self.ground_at(xy) + place["height_agl_m"]
        return np.array([*xy, z])

    # --- what stands on it

    def _solid(self, o: dict[str, Any]) -> Distance:
        match o["kind"]:
            case "cylinder":
                xy = self.xy(o["center"])
                disc = shapely.Point(xy).buffer(o["radius_m"], quad_segs=90)
                return functools.partial(_cylinder, xy, o["radius_m"], self._top(o, disc))
            case "cone":
                xy = self.xy(o["center"])
                base = o.get("base_alt_amsl_m")
                base = self.ground_at(xy) if base is None else base
                return functools.partial(_cone, np.array([*xy, base]), o["base_radius_m"], o["height_m"])
            case "radar" | "marine":
                return functools.partial(_sphere, self.point(o["center"]), o["radius_m"])
            case "no_fly":
                polygon = shapely.Polygon([self.xy(p) for p in o["polygon"]])
                floor = o.get("floor_alt_amsl_m", -math.inf)
                return functools.partial(_prism, polygon, floor, self._top(o, polygon))
            case "cable":
                ends = self.point(o["start"]), self.point(o["end"])
                return functools.partial(_cable, *ends, o.get("radius_m", 0.5))
        raise ValueError(f"obstacle of unknown kind: {o}")

    def _other_line(self, o: dict[str, Any]) -> list[Distance]:
        tops = [self.point(support) for support in o["supports"]]
        return [
            *(functools.partial(_cylinder, top[:2], o.get("support_radius_m", 3.0), top[2]) for top in tops),
            *(_hung(a, b, o, o.get("cable_radius_m", 3.0)) for a, b in itertools.pairwise(tops)),
        ]

    def _top(self, o: dict[str, Any], footprint: shapely.Polygon) -> float:
        if "top_alt_amsl_m" in o:
            return float(o["top_alt_amsl_m"])
        if "top_height_agl_m" not in o:
            return math.inf
        west, south, east, north = footprint.bounds
        grid = np.stack(np.meshgrid(np.linspace(west, east, 101), np.linspace(south, north, 101)), axis=-1)
        rim = shapely.get_coordinates(footprint.segmentize(1.0))
        points = grid.reshape(-1, 2)
        inside = points[shapely.contains_xy(footprint, points)]
        return float(self.ground_m(np.concatenate([rim, inside])).max() + o["top_height_agl_m"])

    def _line(self) -> list[tuple[str, Distance]]:
        """Towers, and conductors from top to top."""
        if "inspection" not in self.mission:
            self.tower_names, self.tower_tops_m, self.tower_weights = [], np.empty((0, 3)), np.empty(0)
            return []
        inspection = self.mission["inspection"]
        towers = inspection["towers"]
        feet = [self.xy(t) for t in towers]
        tops = [np.array([*f, self.ground_at(f) + t.get("height_m", 35.0)]) for f, t in zip(feet, towers, strict=True)]
        self.tower_names = [t["name"] for t in towers]
        self.tower_tops_m = np.array(tops)
        self.tower_weights = np.array([t.get("weight", 1.0) for t in towers])
        radius, wide = inspection.get("tower_radius_m", 6.0), inspection.get("conductor_radius_m", 8.0)
        masts: list[tuple[str, Distance]] = [
            (t["name"], functools.partial(_cylinder, top[:2], radius, top[2]))
            for t, top in zip(towers, tops, strict=True)
        ]
        top_of = dict(zip(self.tower_names, tops, strict=True))
        lines = inspection.get("lines", [{"towers": self.tower_names}])
        spans: list[tuple[str, Distance]] = [
            (f"span {a}-{b}", _hung(top_of[a], top_of[b], line, line.get("conductor_radius_m", wide)))
            for line in lines
            for a, b in itertools.pairwise(line["towers"])
        ]
        return masts + spans

    def _fence(self) -> Distance | None:
        """Distance to the outside of the area and the fence, where the mission gives them."""
        walls = []
        if "area" in self.mission:
            corners = [self.xy(self.mission["area"][c]) for c in ("south_west", "north_east")]
            walls.append((shapely.box(*corners[0], *corners[1]), math.inf))
        if "fence" in self.mission:
            fence = self.mission["fence"]
            walls.append(
                (shapely.Polygon([self.xy(p) for p in fence["polygon"]]), fence.get("top_alt_amsl_m", math.inf))
            )
        if not walls:
            return None
        return lambda p: np.min([-_prism(polygon, -math.inf, top, p) for polygon, top in walls], axis=0)

    # --- the checks

    def clearances(self, vehicle: int, path_m: Array, *, flown: bool) -> list[Least]:
        """Return what a polyline (N, 3) keeps, as wide as its vehicle may be off it; where flown, just itself."""
        settings = self.vehicles[vehicle]
        safety = settings.get("safety", {})
        radius_m = 0.0 if flown else _off_m(settings)
        points = densely(path_m)
        low, height_m, high_m = self._heights(points, radius_m)
        above_m = safety.get("terrain_m", 20.0) + self.vertical_error_m
        apart_m = safety.get("obstacle_m", 10.0)
        found = [Least("terrain", height_m, above_m, tuple(points[low]))]
        walls = [("fence", self.fence)] if self.fence is not None else []
        for name, distance in [*self.obstacles, *walls]:
            k, d = _least(distance, points)
            found.append(Least(name, d - radius_m, apart_m, tuple(points[k])))
        for limit, value in (
            ("height_agl_max_m", high_m),
            ("alt_amsl_max_m", float(points[:, 2].max()) + radius_m),
        ):
            if limit in settings:
                found.append(Least(limit, settings[limit] - value, 0.0, ()))
        return found

    def _heights(self, points: Array, radius_m: float) -> tuple[int, float, float]:
        """Return where balls rolled through points come lowest above the ground below them, how low, and how high."""
        height = points[:, 2] - self.ground_m(points[:, :2])
        low, least_m, most_m = int(np.argmin(height)), float(height.min()) - radius_m, float(height.max()) + radius_m
        chosen = np.unique([*range(0, len(points), _BESIDE), len(points) - 1])
        for away_m in radius_m * np.arange(1, _RINGS + 1) / _RINGS if radius_m > 0.0 else ():
            up_m = math.sqrt(max(radius_m**2 - away_m**2, 0.0))
            for angle in 2.0 * math.pi * np.arange(_SPOKES) / _SPOKES:
                beside = points[chosen, :2] + away_m * np.array([math.cos(angle), math.sin(angle)])
                height = points[chosen, 2] - self.ground_m(beside)
                k = int(np.argmin(height))  # a NaN counts as least, and stays it
                if not math.isnan(least_m) and not float(height[k]) - up_m >= least_m:
                    low, least_m = int(chosen[k]), float(height[k]) - up_m
                most_m = max(most_m, float(height.max()) + up_m)
        return low, least_m, most_m

    def inspected(self, paths_m: Sequence[Array]) -> Inspected | None:
        """Return what polylines (N, 3) pass of the towers' tops."""
        if not self.tower_names:
            return None
        inspection = self.mission["inspection"]
        points = np.concatenate([densely(path) for path in paths_m])
        nearest = np.array([np.linalg.norm(points - top, axis=1).min() for top in self.tower_tops_m])
        seen = nearest <= inspection.get("range_m", 60.0) + ROUNDING_M
        missed = tuple(name for name, s in zip(self.tower_names, seen, strict=True) if not s)
        share = float(self.tower_weights[seen].sum() / self.tower_weights.sum())
        return Inspected(share, inspection.get("share_min", 1.0), missed)


@dataclass(frozen=True)
class Report:
    """What was found of a plan folder: clearances by vehicle's name, separation, spread of arrivals."""

    planned: dict[str, list[Least]]
    inspected: Inspected | None
    flown: dict[str, list[Least]]
    inspected_flown: Inspected | None
    separation: Least | None  # flown
    arrival_spread_s: float | None  # flown; None where somebody did not arrive

    def clear(self, name: str) -> bool:
        return all(least.ok for least in [*self.planned[name], *self.flown.get(name, [])])


def check_folder(mission_path: Path, folder: Path) -> Report:
    """Check the exported files of a plan folder against the mission file and, where there is one, its flight."""
    world = World(mission_path)
    names = [vehicle["name"] for vehicle in world.vehicles]
    legs = {name: waypoints_polyline(world, folder / "files" / f"{name}.waypoints") for name in names}
    for name in names:
        other = plan_polyline(world, folder / "files" / f"{name}.plan")
        np.testing.assert_allclose(other, legs[name], atol=1e-3, err_msg=f"{name}: .plan and .waypoints differ")
    planned = {name: world.clearances(k, legs[name], flown=False) for k, name in enumerate(names)}
    flown: dict[str, list[Least]] = {}
    separation = spread_s = inspected_flown = None
    if (folder / "flight.json").exists():
        flight = json.loads((folder / "flight.json").read_text(encoding="utf-8"))["vehicles"]
        t_s = [np.array(v["t_s"]) for v in flight]
        track_m = [np.array(v["position_m"]) for v in flight]
        arrivals_s = [v["arrival_s"] for v in flight]
        tracks = {}
        for k, name in enumerate(names):
            assert flight[k]["name"] == name
            tracks[name] = _between_top_and_goal(t_s[k], track_m[k], legs[name], arrivals_s[k])
            flown[name] = world.clearances(k, tracks[name], flown=True)
        separation = _least_separation(names, t_s, track_m, world.separation_m)
        inspected_flown = world.inspected(list(tracks.values()))
        if None not in arrivals_s:
            spread_s = max(arrivals_s) - min(arrivals_s)
    return Report(planned, world.inspected(list(legs.values())), flown, inspected_flown, separation, spread_s)


# --- files, as text


def waypoints_polyline(world: World, path: Path) -> Array:
    """Return the polyline (W, 3) of a ``.waypoints`` file, from the top of the take-off to the goal."""
    header, *lines = path.read_text(encoding="utf-8").splitlines()
    assert header == "QGC WPL 110", header
    rows = [line.split("\t") for line in lines]
    assert all(len(row) == 12 for row in rows)
    items = [(int(r[2]), int(r[3]), float(r[8]), float(r[9]), float(r[10])) for r in rows]
    return _polyline(world, items[1:], home_alt_amsl_m=items[0][4])


def plan_polyline(world: World, path: Path) -> Array:
    """Return the polyline (W, 3) of a ``.plan`` file, from the top of the take-off to the goal."""
    mission = json.loads(path.read_text(encoding="utf-8"))["mission"]
    items = [(item["frame"], item["command"], *item["params"][4:7]) for item in mission["items"]]
    return _polyline(world, items, home_alt_amsl_m=mission["plannedHomePosition"][2])


def _polyline(world: World, items: Sequence[tuple[Any, ...]], home_alt_amsl_m: float) -> Array:
    points = []
    for frame, command, lat_deg, lon_deg, alt_m in items:
        if command in (_TAKEOFF, _WAYPOINT):
            assert frame in (_GLOBAL, _RELATIVE), frame
            datum_m = home_alt_amsl_m if frame == _RELATIVE else 0.0
            points.append(world.position(lat_deg, lon_deg, datum_m + alt_m))
    return np.array(points)


# --- geometry


def _off_m(settings: dict[str, Any]) -> float:
    """Return how far a copter may be off its legs: tracking, position, and what its autopilot makes of corners."""
    assert settings.get("class", "copter") == "copter", "a plane is not judged by its legs"
    corner_m = settings.get("motion", {}).get("waypoint_radius_m", 2.0)
    if settings.get("autopilot", "ardupilot") == "px4":
        corner_m *= 1.25
    return float(settings.get("tracking_error_m", 2.0) + settings.get("position_error_m", 1.0) + corner_m)


def densely(path_m: Array) -> Array:
    """Return points at most 0.1 m apart along a polyline (N, 3), its corners among them."""
    parts = [path_m[:1]]
    for a, b in itertools.pairwise(path_m):
        count = max(1, math.ceil(np.linalg.norm(b - a) / STEP_M))
        parts.append(a + (np.arange(1, count + 1) / count)[:, np.newaxis] * (b - a))
    return np.concatenate(parts)


def _least(distance: Distance, points: Array) -> tuple[int, float]:
    """Return where along dense points the distance is least, and how much it is.

    Every 50th point first: within 5 m of way no distance changes by more than 5 m, so only some stretches matter.
    """
    coarse = distance(points[::_COARSE])
    near = np.flatnonzero(coarse <= coarse.min() + 2 * _COARSE * STEP_M)
    candidates = np.unique(
        np.clip(near[:, np.newaxis] * _COARSE + np.arange(-_COARSE, _COARSE + 1), 0, len(points) - 1)
    )
    d = distance(points[candidates])
    k = int(np.argmin(d))
    return int(candidates[k]), float(d[k])


def _keys(heights: Array, row: Array, col: Array) -> Array:
    """Return Keys' cubic convolution with a = -1/2 (IEEE TASSP 29(6), 1981); NaN where a neighbour is missing."""
    top, left = np.floor(row).astype(int), np.floor(col).astype(int)
    known = (top >= 1) & (left >= 1) & (top + 2 < heights.shape[0]) & (left + 2 < heights.shape[1])
    total = np.where(known, 0.0, np.nan)
    for i in range(-1, 3):
        for j in range(-1, 3):
            sample = heights[np.where(known, top + i, 0), np.where(known, left + j, 0)]
            total += sample * _keys_weight(row - (top + i)) * _keys_weight(col - (left + j))
    return total


def _keys_weight(s: Array) -> Array:
    s = np.abs(s)
    near = 1.5 * s**3 - 2.5 * s**2 + 1.0
    far = -0.5 * s**3 + 2.5 * s**2 - 4.0 * s + 2.0
    return np.where(s <= 1.0, near, np.where(s <= 2.0, far, 0.0))


def _outside(across: Array, along: Array) -> Array:
    """Return the distance to a right-angled corner's inside, from the distances to its two sides."""
    beyond = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
    return np.where((across < 0.0) & (along < 0.0), np.maximum(across, along), beyond)


def _cylinder(xy: Array, radius_m: float, top_m: float, p: Array) -> Array:
    return _outside(np.hypot(p[:, 0] - xy[0], p[:, 1] - xy[1]) - radius_m, p[:, 2] - top_m)


def _sphere(centre: Array, radius_m: float, p: Array) -> Array:
    return np.linalg.norm(p - centre, axis=1) - radius_m


def _cable(a: Array, b: Array, radius_m: float, p: Array) -> Array:
    share = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(p - a - share[:, np.newaxis] * (b - a), axis=1) - radius_m


def _hung(a: Array, b: Array, line: dict[str, Any], radius_m: float) -> Distance:
    """Return the distance to all below a catenary, its lowest point found by numbers; tight where nobody says how."""
    across_m, rise_m = math.dist(a[:2], b[:2]), b[2] - a[2]
    constant_m = line.get("catenary_m") or max(2000.0, across_m**2 / 120.0)
    lowest_m = brentq(
        lambda low: constant_m * (math.cosh((across_m - low) / constant_m) - math.cosh(low / constant_m)) - rise_m,
        -20.0 * constant_m,
        20.0 * constant_m + across_m,
        xtol=1e-9,
    )
    u = np.linspace(0.0, across_m, 2 + int(across_m))
    z = a[2] + constant_m * (np.cosh((u - lowest_m) / constant_m) - math.cosh(lowest_m / constant_m))
    deep_m = min(a[2], b[2], z.min()) - 1e4
    room = shapely.Polygon([*zip(u, z, strict=True), (across_m, deep_m), (0.0, deep_m)])

    def distance(p: Array) -> Array:
        along = (p[:, :2] - a[:2]) @ (b - a)[:2] / across_m
        aside = ((p[:, 0] - a[0]) * (b[1] - a[1]) - (p[:, 1] - a[1]) * (b[0] - a[0])) / across_m
        return np.hypot(aside, shapely.distance(room, shapely.points(along, p[:, 2]))) - radius_m

    return distance


def _prism(polygon: shapely.Polygon, floor_m: float, top_m: float, p: Array) -> Array:
    points = shapely.points(p[:, :2])
    rim = shapely.distance(polygon.exterior, points)
    across = np.where(shapely.contains(polygon, points), -rim, rim)
    return _outside(across, np.maximum(floor_m - p[:, 2], p[:, 2] - top_m))


def _cone(base: Array, radius_m: float, height_m: float, p: Array) -> Array:
    """Return the distance to the triangle that the cone is in the plane of its axis and the point."""
    triangle = shapely.Polygon([(-radius_m, 0.0), (radius_m, 0.0), (0.0, height_m)])
    across = np.hypot(p[:, 0] - base[0], p[:, 1] - base[1])
    points = shapely.points(np.column_stack([across, p[:, 2] - base[2]]))
    rim = shapely.distance(triangle.exterior, points)
    return np.where(shapely.contains(triangle, points), -rim, rim)


# --- flights


def _between_top_and_goal(t_s: Array, track_m: Array, legs_m: Array, arrival_s: float | None) -> Array:
    """Return the part of a track from where it is as high as the take-off's top (less 2 m) until the arrival."""
    up = track_m[:, 2] >= legs_m[0, 2] - 2.0
    assert up.any(), "never reached the top of its take-off"
    first = int(np.argmax(up))
    last = len(t_s) if arrival_s is None else int(np.searchsorted(t_s, arrival_s)) + 1
    part: Array = track_m[first : max(last, first + 2)]
    return part


def _least_separation(names: list[str], t_s: list[Array], track_m: list[Array], required_m: float) -> Least | None:
    """Return the least distance between any two tracks, exactly: between samples, both fly straight and evenly."""
    found = []
    times = np.unique(np.concatenate(t_s))
    at = [np.column_stack([np.interp(times, t, m[:, k]) for k in range(3)]) for t, m in zip(t_s, track_m, strict=True)]
    for i, j in itertools.combinations(range(len(names)), 2):
        apart = at[j] - at[i]
        move = np.diff(apart, axis=0)
        squared = np.maximum((move**2).sum(axis=1), 1e-12)
        share = np.clip(-(apart[:-1] * move).sum(axis=1) / squared, 0.0, 1.0)
        distance = np.linalg.norm(apart[:-1] + share[:, np.newaxis] * move, axis=1)
        k = int(np.argmin(distance))
        found.append(Least(f"{names[i]} - {names[j]}", float(distance[k]), required_m, tuple(at[i][k])))
    return min(found, key=lambda least: least.distance_m, default=None)


def _over(defaults: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    merged = dict(defaults)
    for key, value in own.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _over(merged[key], value) if both else value
    return merged


def main() -> None:
    """Print the tightest clearances of a plan folder."""
    report = check_folder(Path(sys.argv[1]), Path(sys.argv[2]))
    for kind, by_vehicle in (("planned", report.planned), ("flown", report.flown)):
        for name, found in by_vehicle.items():
            for least in sorted(found, key=lambda least: least.margin_m)[:3]:
                asked = f"(>= {least.required_m:g} m) {'ok' if least.ok else 'NOT CLEAR'}"
                print(f"{kind:8} {name:10} {least.what:20} {least.distance_m:8.2f} m {asked}")
    print(f"separation flown: {report.separation}")
    print(f"arrival spread flown: {report.arrival_spread_s}")
    print(f"inspected: {report.inspected}, flown: {report.inspected_flown}")


if __name__ == "__main__":
    main()
