"""The mission resolved in the local frame: terrain loaded, heights above ground settled, places checked."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from missionplanner import kernels, mission, terrain
from missionplanner.clearance import Margins
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.kernels import SpaceArrays
from missionplanner.mission import Mission
from missionplanner.obstacles import (
    CableSolid,
    ConeSolid,
    CurtainSolid,
    CylinderSolid,
    Obstacles,
    PrismSolid,
    Solid,
    SphereSolid,
    check_polygon,
    pack,
)
from missionplanner.plan import Action
from missionplanner.spans import SLACKEST, Catenary, Conductor, Span, catenary
from missionplanner.terrain import Rectangle, Terrain
from missionplanner.terrain_bounds import least_heights, steepest
from missionplanner.vehicle import (
    Ending,
    MotionModel,
    VehicleLimits,
    ending,
    motion_model,
    vehicle_limits,
)

TERRAIN_NAME = "terrain.tif"
"""The terrain file of a mission made portable by :func:`portable_mission`."""

RUNWAY_RISE_M = 1.0
"""How much higher than its home the ground may be that a plane rolls along."""

_REACH_M = 100_000.0  # of the local frame; further away, a place is more likely a slip than meant
_AREA_ROOM_M, _AREA_ROOM_SHARE = 300.0, 0.2
_TAKEOFF_ROOM_M = 10.0
_SAME_PLACE_M = 1.0
_TOLERANCE_M = 1e-6
_STEP_M = 1.0  # between samples of the terrain
_SPAN_MAX_M = 6000.0  # the longest there is crosses the Ameralik fjord with 5376 m


@dataclass(frozen=True, slots=True, eq=False)
class VehicleTask:
    """One vehicle's problem: fly through ``route_m`` (R, 3) in order; the first is the top of the take-off."""

    name: str
    sysid: int
    home_m: FloatArray  # (3,), on the ground
    route_m: FloatArray  # (R, 3), R >= 2; the last is the goal
    end: Ending
    limits: VehicleLimits
    motion: MotionModel
    places: Mapping[int | str, int]  # what the mission calls the route's points: numbers (0: its start) and towers
    actions: Mapping[int, Action] = field(default_factory=dict)  # by point of the route

    @property
    def off_prediction_m(self) -> float:
        """How far it may be from its predicted flight at any time; a plane's is predicted less well."""
        return self.limits.tube_m if self.motion.vehicle_class == "plane" else self.limits.stray_m


@dataclass(frozen=True, slots=True, eq=False)
class Towers:
    """The towers: ``top_m`` (T, 3), heights and weights (T,), names, and when one counts as inspected.

    One that is an obstacle only has weight 0.
    """

    names: tuple[str, ...]
    top_m: FloatArray
    height_m: FloatArray
    weight: FloatArray
    range_m: float
    share_min: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that a path is judged against, in the local frame."""

    mission: Mission
    frame: LocalFrame
    terrain: Terrain
    obstacles: Obstacles
    towers: Towers | None
    spans: tuple[Span, ...]
    conductors: tuple[Conductor, ...]  # of the spans and of all other lines
    area_m: Rectangle
    space: SpaceArrays
    tasks: tuple[VehicleTask, ...]
    input_sha256: str


def build_scene(mission: Mission, folder: Path) -> Scene:
    """Resolve a mission whose relative file names start at ``folder``.

    Raises
    ------
    MissionError
        A terrain file that cannot be read or does not cover a place, or has voids along the way; a start, stop or goal
        below ground, inside an obstacle or outside the fence; two vehicles with one home or start; an inspection whose
        towers are still to be shared out (see :mod:`.inspection`).
    """
    if mission.inspection is not None and mission.inspection.assignment is not None:
        raise MissionError(
            "inspection.assignment: expected stops of every vehicle, got towers that are still to be shared out: plan "
            "the mission first"
        )
    return _Builder(mission, folder).scene()


def build_check_scene(mission: Mission, folder: Path, places_deg: Sequence[tuple[float, float]]) -> Scene:
    """Resolve a mission for judging flights that it did not plan; its area holds ``places_deg`` (latitude, longitude).

    Its vehicles' limits count, their starts, stops and goals do not: they have no route.

    Raises
    ------
    MissionError
        As :func:`build_scene`, but for starts, stops and goals.
    """
    return _Builder(mission, folder, places_deg).scene(with_routes=False)


def build_open_scene(mission: Mission, folder: Path) -> Scene:
    """Resolve a mission whose towers are still to be shared out; its vehicles have homes and limits, but no route.

    Raises
    ------
    MissionError
        As :func:`build_scene`: of homes, the climb from them, and landing there.
    """
    return _Builder(mission, folder).open_scene()


def takeoff_height_m(vehicle: mission.Vehicle, margins: Margins) -> float:
    """Return how high above its home a vehicle takes off: as stated, or somewhat higher than it must be."""
    if vehicle.takeoff_height_m is not None:
        return vehicle.takeoff_height_m
    lowest = margins.height_agl_min_m
    return max(lowest, min(lowest + _TAKEOFF_ROOM_M, margins.height_agl_max_m))


def portable_mission(scene: Scene) -> Mission:
    """Return the scene's mission as it reads beside ``terrain.tif``, the terrain that :func:`.write_raster` writes.

    A mission whose terrain is not a file needs none. Defaults are already part of the vehicles.
    """
    return _portable(scene.mission)


def _portable(question: Mission) -> Mission:
    changes: dict[str, object] = {"defaults": mission.VehicleSettings()}
    if question.terrain.kind == "raster":
        changes["terrain"] = question.terrain.model_copy(
            update={"file": Path(TERRAIN_NAME), "geoid_undulation_m": None}
        )
    return question.model_copy(update=changes)


def _input_sha256(question: Mission, ground: Terrain) -> str:
    """Return a hash of all that a plan depends on, the same wherever and under whatever name the terrain is kept."""
    digest = hashlib.sha256(_portable(question).model_dump_json(by_alias=True).encode())
    heights = ground.arrays.height_amsl_m
    digest.update(repr((heights.shape, ground.reference.transform)).encode())
    digest.update(heights.astype("<f4", copy=False).data)
    return digest.hexdigest()


_OneSolid = mission.Cylinder | mission.Cone | mission.Radar | mission.Marine | mission.NoFly | mission.Cable


@dataclass(frozen=True, slots=True, eq=False)
class _Spot:
    """A point of a route and what it is called in errors."""

    what: str
    position_m: FloatArray
    action: Action | None = None


class _Builder:
    """Resolves one mission, part by part: each step uses what those before it left."""

    def __init__(self, question: Mission, folder: Path, also_deg: Sequence[tuple[float, float]] = ()) -> None:
        self._mission = question = mission.with_parameter_files(question, folder)
        self._frame = LocalFrame(question.origin.lat_deg, question.origin.lon_deg)
        self._also = [
            self._xy(mission.Place(lat_deg=lat_deg, lon_deg=lon_deg), f"{lat_deg:.5f}, {lon_deg:.5f}")
            for lat_deg, lon_deg in also_deg
        ]
        self._area, self._terrain = self._area_and_terrain(folder)
        self._towers = self._tower_tops()
        self._spans = self._spans_of_lines()
        others = [c for i, o in enumerate(question.obstacles) if o.kind == "line" for c in self._other_line(i, o)]
        self._conductors = (*others, *(span.conductor for span in self._spans))
        declared = (solid for i, obstacle in enumerate(question.obstacles) for solid in self._solids(i, obstacle))
        curtains = (solid for conductor in self._conductors for solid in _curtains(conductor))
        self._obstacles = pack([*declared, *self._masts(), *curtains])
        self._space = self._everything()

    def scene(self, *, with_routes: bool = True) -> Scene:
        numbered = enumerate(self._mission.vehicles)
        if with_routes:
            tasks = tuple(self._task(i, vehicle) for i, vehicle in numbered)
            self._check_apart(tasks)
        else:
            tasks = tuple(self._task_without_route(i, vehicle) for i, vehicle in numbered)
        return self._scene_of(tasks)

    def open_scene(self) -> Scene:
        vehicles = self._mission.vehicles
        tasks = tuple(self._task_without_route(i, vehicle) for i, vehicle in enumerate(vehicles))
        for i, (vehicle, task) in enumerate(zip(vehicles, tasks, strict=True)):
            self._check_home(i, vehicle, task)
        for (i, a), (j, b) in itertools.combinations(enumerate(tasks), 2):
            self._check_distance("home", (i, j), _apart_across_m(a.home_m, b.home_m), self._separation_m(a, b))
        return self._scene_of(tasks)

    def _scene_of(self, tasks: tuple[VehicleTask, ...]) -> Scene:
        return Scene(
            mission=self._mission,
            frame=self._frame,
            terrain=self._terrain,
            obstacles=self._obstacles,
            towers=self._towers,
            spans=self._spans,
            conductors=self._conductors,
            area_m=self._area,
            space=self._space,
            tasks=tasks,
            input_sha256=_input_sha256(self._mission, self._terrain),
        )

    # --- places

    def _xy(self, place: mission.Place, what: str) -> tuple[float, float]:
        if place.x_m is not None and place.y_m is not None:
            x, y = place.x_m, place.y_m
        else:
            assert place.lat_deg is not None
            assert place.lon_deg is not None
            x, y, _ = self._frame.to_local(place.lat_deg, place.lon_deg, 0.0).tolist()
        distance = math.hypot(x, y)
        if not distance <= _REACH_M:
            raise MissionError(
                f"{what}: expected a place within {_REACH_M / 1000:.0f} km of the origin, got one "
                f"{distance / 1000:.0f} km away: check signs and order of its coordinates, or move the origin"
            )
        return x, y

    def _outline(self, places: Sequence[mission.Place], what: str) -> FloatArray:
        return np.array([self._xy(place, f"{what}[{k}]") for k, place in enumerate(places)])

    def _position(self, point: mission.Point, what: str) -> FloatArray:
        x, y = self._xy(point, what)
        if point.alt_amsl_m is not None:
            return np.array([x, y, point.alt_amsl_m])
        assert point.height_agl_m is not None
        return np.array([x, y, self._terrain.ground_amsl_m(x, y, what) + point.height_agl_m])

    # --- area and terrain

    def _area_and_terrain(self, folder: Path) -> tuple[Rectangle, Terrain]:
        needed = _around(self._places_needed())
        wanted = self._wanted_area(needed)
        ground = self._load_terrain(folder, wanted)
        if self._mission.area is not None:
            return wanted, ground
        return _clipped(ground, needed, wanted), ground

    def _wanted_area(self, needed: Rectangle) -> Rectangle:
        area, fence = self._mission.area, self._mission.fence
        if area is not None:
            west, south = self._xy(area.south_west, "area.south_west")
            east, north = self._xy(area.north_east, "area.north_east")
            if not (west < east and south < north):
                raise MissionError(
                    "area: expected south_west to lie south and west of north_east, got "
                    f"x {west:.0f} to {east:.0f} m and y {south:.0f} to {north:.0f} m"
                )
            return west, south, east, north
        if fence is not None:
            return _around(self._outline(fence.polygon, "fence.polygon"))
        west, south, east, north = _around([needed[:2], needed[2:], *self._places_of_obstacles()])
        room = max(_AREA_ROOM_M, _AREA_ROOM_SHARE * max(east - west, north - south))
        return west - room, south - room, east + room, north + room

    def _places_needed(self) -> Iterator[tuple[float, float]]:
        yield from self._also
        for i, vehicle in enumerate(self._mission.vehicles):
            for name in ("home", "start", "goal"):
                place = getattr(vehicle, name)
                if place is not None:
                    yield self._xy(place, _named(i, vehicle, name))
            for k, stop in enumerate(vehicle.stops):
                yield self._xy(stop, _named(i, vehicle, f"stops[{k}]"))
        if self._mission.inspection is not None:
            for i, tower in enumerate(self._mission.inspection.towers):
                yield self._xy(tower, _tower(i, tower))

    def _places_of_obstacles(self) -> Iterator[tuple[float, float]]:
        for i, obstacle in enumerate(self._mission.obstacles):
            what = _obstacle(i, obstacle)
            match obstacle:
                case mission.NoFly():
                    yield from self._outline(obstacle.polygon, f"{what}.polygon").tolist()
                case mission.Cable():
                    yield self._xy(obstacle.start, f"{what}.start")
                    yield self._xy(obstacle.end, f"{what}.end")
                case mission.OverheadLine():
                    for k, support in enumerate(obstacle.supports):
                        yield self._xy(support, f"{what}.supports[{k}]")
                case _:
                    x, y = self._xy(obstacle.center, f"{what}.center")
                    radius = obstacle.base_radius_m if isinstance(obstacle, mission.Cone) else obstacle.radius_m
                    yield x - radius, y - radius
                    yield x + radius, y + radius

    def _load_terrain(self, folder: Path, area: Rectangle) -> Terrain:
        source = self._mission.terrain
        match source:
            case mission.RasterTerrain():
                return terrain.read_raster(folder / source.file, self._frame, area, source.geoid_undulation_m)
            case mission.PeaksTerrain():
                peaks = [
                    (*self._xy(peak, f"terrain.peaks[{i}]"), peak.height_m, peak.spread_m)
                    for i, peak in enumerate(source.peaks)
                ]
                return terrain.peaks_terrain(peaks, source.base_alt_amsl_m, source.cell_m, self._frame, area)
            case mission.FlatTerrain():
                return terrain.flat_terrain(source.alt_amsl_m, self._frame, area)

    # --- solids

    def _solids(self, index: int, obstacle: mission.Obstacle) -> list[Solid]:
        if not isinstance(obstacle, mission.OverheadLine):
            return [self._solid(index, obstacle)]
        tops = np.array(self._support_tops(index, obstacle))
        return [CylinderSolid(obstacle.name, x, y, obstacle.support_radius_m, z) for x, y, z in tops.tolist()]

    def _support_tops(self, index: int, line: mission.OverheadLine) -> list[FloatArray]:
        what = _obstacle(index, line)
        return [self._position(support, f"{what}.supports[{k}]") for k, support in enumerate(line.supports)]

    def _other_line(self, index: int, line: mission.OverheadLine) -> list[Conductor]:
        what = _obstacle(index, line)
        return [
            Conductor(
                line.name,
                _hung(f"{what}.supports[{k + 1}]", ("support", "the one before"), a, b, line.catenary_m),
                line.cable_radius_m,
            )
            for k, (a, b) in enumerate(itertools.pairwise(self._support_tops(index, line)))
        ]

    def _solid(self, index: int, obstacle: _OneSolid) -> Solid:
        what, name = _obstacle(index, obstacle), obstacle.name
        match obstacle:
            case mission.Cylinder():
                x, y = self._xy(obstacle.center, f"{what}.center")
                outline = _circle(x, y, obstacle.radius_m)
                return CylinderSolid(name, x, y, obstacle.radius_m, self._top(obstacle, outline, what))
            case mission.Cone():
                x, y = self._xy(obstacle.center, f"{what}.center")
                base = obstacle.base_alt_amsl_m
                if base is None:
                    base = self._terrain.ground_amsl_m(x, y, what)
                return ConeSolid(name, x, y, obstacle.base_radius_m, base, obstacle.height_m)
            case mission.Radar():
                x, y, z = self._position(obstacle.center, f"{what}.center").tolist()
                return SphereSolid(name, x, y, z, obstacle.radius_m, "radar", obstacle.hard)
            case mission.Marine():
                x, y, z = self._position(obstacle.center, f"{what}.center").tolist()
                return SphereSolid(name, x, y, z, obstacle.radius_m, "marine")
            case mission.NoFly():
                outline = self._outline(obstacle.polygon, f"{what}.polygon")
                floor = -math.inf if obstacle.floor_alt_amsl_m is None else obstacle.floor_alt_amsl_m
                return PrismSolid(name, outline, floor, self._top(obstacle, outline, what))
            case mission.Cable():
                start = self._position(obstacle.start, f"{what}.start")
                end = self._position(obstacle.end, f"{what}.end")
                if np.linalg.norm(end - start) < _SAME_PLACE_M:
                    raise MissionError(
                        f"{what}.end: expected a place {_SAME_PLACE_M} m or more from its start, got that"
                    )
                return CableSolid(name, start, end, obstacle.radius_m)

    def _top(self, obstacle: mission.Cylinder | mission.NoFly, outline: FloatArray, what: str) -> float:
        if obstacle.top_alt_amsl_m is not None:
            heights = self._terrain.height_amsl_m(outline[:, 0], outline[:, 1])
            ground = float(np.nanmin(heights)) if np.isfinite(heights).any() else -math.inf
            if obstacle.top_alt_amsl_m <= ground:
                raise MissionError(
                    f"{what}: expected top_alt_amsl_m above the ground there ({ground:.1f} m AMSL), got "
                    f"{obstacle.top_alt_amsl_m:g}: for a height above ground write top_height_agl_m"
                )
            return obstacle.top_alt_amsl_m
        if obstacle.top_height_agl_m is None:
            return math.inf
        return self._highest_ground(outline, what) + obstacle.top_height_agl_m

    def _highest_ground(self, outline: FloatArray, what: str) -> float:
        """Return an upper bound of the ground in a polygon: the triangles at its first corner cover all of it."""
        for x, y in outline.tolist():
            self._terrain.ground_amsl_m(x, y, what)
        triangles = np.zeros((len(outline) - 2, 3, 3))
        for k, triangle in enumerate(triangles, start=1):
            triangle[:, :2] = outline[[0, k, k + 1]]
        none = np.zeros(len(triangles))
        found = least_heights(self._terrain.arrays, self._terrain.bounds, triangles, none, 1.0, none + np.inf)
        highest_m = -float(found[:, 0].min())
        if not math.isfinite(highest_m):
            raise MissionError(f"{what}: expected terrain below all of it, got voids: write top_alt_amsl_m instead")
        return highest_m

    def _tower_tops(self) -> Towers | None:
        inspection = self._mission.inspection
        if inspection is None:
            return None
        tops = []
        for i, tower in enumerate(inspection.towers):
            what = _tower(i, tower)
            x, y = self._xy(tower, what)
            tops.append((x, y, self._terrain.ground_amsl_m(x, y, what) + tower.height_m))
        none = np.array([tower.views == "none" for tower in inspection.towers])
        return Towers(
            names=tuple(tower.name for tower in inspection.towers),
            top_m=np.array(tops),
            height_m=np.array([tower.height_m for tower in inspection.towers]),
            weight=np.where(none, 0.0, np.array(inspection.weights, dtype=np.float64)),
            range_m=inspection.range_m,
            share_min=inspection.share_min,
        )

    def _masts(self) -> list[Solid]:
        """Return the towers as cylinders."""
        inspection, towers = self._mission.inspection, self._towers
        if inspection is None or towers is None:
            return []
        return [
            CylinderSolid(name, x, y, inspection.tower_radius_m, z)
            for name, (x, y, z) in zip(towers.names, towers.top_m.tolist(), strict=True)
        ]

    def _spans_of_lines(self) -> tuple[Span, ...]:
        """Return the spans of all lines, in their order; one that several share once, the widest and the highest."""
        inspection, towers = self._mission.inspection, self._towers
        if inspection is None or towers is None:
            return ()
        index = {name: i for i, name in enumerate(towers.names)}
        found: dict[frozenset[int], Span] = {}
        for line in inspection.lines_or_one:
            for ends in itertools.pairwise(line.towers):
                first, second = (index[name] for name in ends)
                what = f"inspection.lines ({line.name}): {ends[1]}"
                start, end = towers.top_m[first], towers.top_m[second]
                hung = _hung(what, ("tower", f"{ends[0]}, the one before it"), start, end, line.catenary_m)
                name, radius_m = f"span {ends[0]}-{ends[1]}", line.conductor_radius_m or inspection.conductor_radius_m
                conductor = Conductor(name, hung, radius_m)
                span = Span(name, (line.name,), (first, second), hung.chords_m(), conductor)
                between = frozenset((first, second))
                found[between] = _shared(found[between], span) if between in found else span
        return tuple(found.values())

    def _everything(self) -> SpaceArrays:
        fence, top = np.zeros((0, 2)), math.inf
        if self._mission.fence is not None:
            fence = self._outline(self._mission.fence.polygon, "fence.polygon")
            check_polygon(fence, "fence.polygon")
            if self._mission.fence.top_alt_amsl_m is not None:
                top = self._mission.fence.top_alt_amsl_m
        return SpaceArrays(self._terrain.arrays, self._obstacles.arrays, fence, top, np.array(self._area))

    # --- vehicles

    def _task(self, index: int, vehicle: mission.Vehicle) -> VehicleTask:
        limits = self._limits(vehicle)
        margins = Margins.of(limits)
        after = self._route_after_takeoff(index, vehicle)
        home_what = _named(index, vehicle, "home" if vehicle.home is not None else "start")
        home_place = vehicle.home or vehicle.start
        assert home_place is not None
        x, y = self._xy(home_place, home_what)
        home = np.array([x, y, self._terrain.ground_amsl_m(x, y, home_what)])
        straight_up = vehicle.vehicle_class == "copter"
        if straight_up and vehicle.start is not None and _apart_across_m(home, after[0].position_m) <= _SAME_PLACE_M:
            route = after
        else:
            top = self._takeoff_top(vehicle, limits, margins, home, after)
            route = [_Spot(f"{home_what}, top of the take-off", top), *after]
        if vehicle.goal is None:  # above where it started
            route.append(_Spot(f"{home_what}, where it ends", self._takeoff_top(vehicle, limits, margins, home, after)))

        for spot in route:
            self._check_spot(spot, margins)
        for this, following in itertools.pairwise(route):
            if np.linalg.norm(following.position_m - this.position_m) < _SAME_PLACE_M:
                raise MissionError(
                    f"{following.what}: expected a place at least {_SAME_PLACE_M} m from the one before it, got that "
                    f"of {this.what}: remove one"
                )
            self._check_no_void(this, following)
        model = motion_model(vehicle, self._mission.air_m_s)
        tail_m_s = _tailwind_m_s(model, route[0].position_m - home)
        roll_m = None if straight_up else model.takeoff_distance_m(0.0, home[2], tail_m_s)
        self._check_takeoff(home, route[0], margins, roll_m)
        end = ending(vehicle)
        self._check_level(_Spot(home_what, home), limits)
        if straight_up and end == "land":
            self._check_landing(route[-1], margins)
            self._check_level(route[-1], limits)
        if not straight_up:
            above_home = np.array([x, y, model.return_alt_amsl_m(route[-1].position_m[2], home[2])])
            circled = route[-1] if end == "loiter" else _Spot(home_what, above_home)
            self._check_circle(circled, model.loiter_radius_m, margins)
        return VehicleTask(
            name=vehicle.name,
            sysid=vehicle.sysid or index + 1,
            home_m=home,
            route_m=np.array([spot.position_m for spot in route]),
            end=end,
            limits=limits,
            motion=model,
            places=self._places(vehicle, len(route)),
            actions={k: spot.action for k, spot in enumerate(route) if spot.action is not None},
        )

    def _task_without_route(self, index: int, vehicle: mission.Vehicle) -> VehicleTask:
        home_place = vehicle.home or vehicle.start
        assert home_place is not None
        what = _named(index, vehicle, "home" if vehicle.home is not None else "start")
        x, y = self._xy(home_place, what)
        return VehicleTask(
            name=vehicle.name,
            sysid=vehicle.sysid or index + 1,
            home_m=np.array([x, y, self._terrain.ground_amsl_m(x, y, what)]),
            route_m=np.empty((0, 3)),
            end=ending(vehicle),
            limits=self._limits(vehicle),
            motion=motion_model(vehicle, self._mission.air_m_s),
            places={},
        )

    def _check_home(self, index: int, vehicle: mission.Vehicle, task: VehicleTask) -> None:
        """Check that a copter can take off from its home, and land there again."""
        what, margins = _named(index, vehicle, "home" if vehicle.home is not None else "start"), Margins.of(task.limits)
        self._check_level(_Spot(what, task.home_m), task.limits)
        top = _Spot(f"{what}, top of the take-off", self._takeoff_top(vehicle, task.limits, margins, task.home_m, []))
        self._check_spot(top, margins)
        self._check_takeoff(task.home_m, top, margins, None)

    def _places(self, vehicle: mission.Vehicle, route_points: int) -> dict[int | str, int]:
        """Return the route's points before the goal by what the mission calls them.

        Raises
        ------
        MissionError
            A rendezvous of the fleet is at none of them, or not after the one before it.
        """
        towers = [name for name, _ in self._inspected(vehicle)]
        begin = 0  # of what is numbered: a climb to a start elsewhere comes before it
        if vehicle.start is not None:
            begin = route_points - (1 + len(vehicle.stops) + len(towers) + 1)
        places: dict[int | str, int] = {k: begin + k for k in range(route_points - 1 - begin)}
        places |= {name: route_points - 1 - len(towers) + k for k, name in enumerate(towers)}
        last = -1
        for k, meeting in enumerate(self._mission.fleet.rendezvous):
            if vehicle.name not in meeting.at:
                continue
            what = f"fleet.rendezvous[{k}] ({meeting.name}): {vehicle.name}"
            place = meeting.at[vehicle.name]
            if place not in places:
                known = ", ".join(map(str, places))
                goal = place == route_points - 1 - begin
                hint = ": that is its goal, where fleet.arrive_together brings all together" if goal else ""
                raise MissionError(f"{what}: expected a place of its route, one of {known}, got {place}{hint}")
            if places[place] <= last:
                raise MissionError(f"{what}: expected a place after its rendezvous before, got {place}: reorder them")
            last = places[place]
        return places

    def _limits(self, vehicle: mission.Vehicle) -> VehicleLimits:
        source, fence = self._mission.terrain, self._mission.fence
        limits = vehicle_limits(vehicle, source.vertical_error_m if isinstance(source, mission.RasterTerrain) else 0.0)
        limits = replace(limits, wind_max_m_s=self._mission.wind_strongest_m_s)
        if fence is None or fence.top_height_agl_m is None:
            return limits
        return replace(limits, height_agl_max_m=min(limits.height_agl_max_m, fence.top_height_agl_m))

    def _route_after_takeoff(self, index: int, vehicle: mission.Vehicle) -> list[_Spot]:
        def spot(field: str, point: mission.Point) -> _Spot:
            what = _named(index, vehicle, field)
            return _Spot(what, self._position(point, what))

        spots = [spot("start", vehicle.start)] if vehicle.start is not None else []
        for k, stop in enumerate(vehicle.stops):
            at = spot(f"stops[{k}]", stop)
            spots.append(replace(at, action=self._action(stop, at.what)))
        spots += self._tower_stops(index, vehicle)
        return [*spots, spot("goal", vehicle.goal)] if vehicle.goal is not None else spots

    def _action(self, stop: mission.Stop, what: str) -> Action | None:
        """Return what is done on the way to a stop and there; None: nothing."""
        look_at_m = None if stop.look_at is None else tuple(self._position(stop.look_at, f"{what}.look_at").tolist())
        look_deg = None if stop.look is None else (stop.look.heading_deg, stop.look.pitch_deg)
        action = Action(
            stop.name or "",
            stop.inspects or "",
            stop.hold_s,
            look_at_m,
            look_deg,
            stop.photos,
            stop.photo_every_m or 0.0,
        )
        return action if action != Action() else None

    def _inspected(self, vehicle: mission.Vehicle) -> list[tuple[str, int]]:
        """Return names and places in the line of the towers that a vehicle inspects, in its order."""
        towers = self._towers
        if vehicle.inspects is None or towers is None:
            return []
        first, last = (towers.names.index(name) for name in (vehicle.inspects.first, vehicle.inspects.last))
        order = range(first, last + 1) if first <= last else range(first, last - 1, -1)
        return [(towers.names[i], i) for i in order]

    def _tower_stops(self, index: int, vehicle: mission.Vehicle) -> Iterator[_Spot]:
        inspection, towers = self._mission.inspection, self._towers
        if inspection is None or towers is None:
            return
        for _, i in self._inspected(vehicle):
            what = f"{_tower(i, inspection.towers[i])}, stop of {_named(index, vehicle)}"
            yield _Spot(what, towers.top_m[i] + np.array([0.0, 0.0, inspection.standoff_m]))

    def _takeoff_top(
        self, vehicle: mission.Vehicle, limits: VehicleLimits, margins: Margins, home: FloatArray, after: list[_Spot]
    ) -> FloatArray:
        height = takeoff_height_m(vehicle, margins)
        x, y, z = home.tolist()
        if vehicle.vehicle_class == "copter":
            return np.array([x, y, z + height])
        aims = [spot.position_m[:2] - home[:2] for spot in after]
        aim = next((a for a in aims if np.linalg.norm(a) > _SAME_PLACE_M), np.array([0.0, 1.0]))
        model = motion_model(vehicle, self._mission.air_m_s)
        far_m = model.takeoff_distance_m(height, z, _tailwind_m_s(model, aim))
        far_m = max(height / math.tan(limits.climb_angle_rad), far_m)
        across = aim / np.linalg.norm(aim) * far_m
        return np.array([x + across[0], y + across[1], z + height])

    # --- checks of what is asked for

    def _check_spot(self, spot: _Spot, margins: Margins) -> None:
        x, y, z = spot.position_m.tolist()
        ground = self._terrain.ground_amsl_m(x, y, spot.what)
        height, lowest = z - ground, margins.height_agl_min_m
        if height < lowest - _TOLERANCE_M:
            got = f"{-height:.1f} m below it" if height < 0 else f"{height:.1f} m"
            raise MissionError(
                f"{spot.what}: expected at least {lowest:.1f} m above the ground (safety.terrain_m and the radius of "
                f"its tube), got {got} (ground {ground:.1f} m, altitude {z:.1f} m AMSL): raise it by "
                f"{lowest - height:.1f} m"
            )
        for what, value, most in (
            ("m above the ground", height, margins.height_agl_max_m),
            ("m AMSL", z, margins.alt_amsl_max_m),
        ):
            if value > most + _TOLERANCE_M:
                raise MissionError(
                    f"{spot.what}: expected at most {most:.1f} {what} (upper limit less the radius of its tube), got "
                    f"{value:.1f}: lower it by {value - most:.1f} m"
                )
        self._check_leg(spot.what, spot.position_m, spot.position_m, margins)

    def _check_takeoff(self, home: FloatArray, top: _Spot, margins: Margins, roll_m: float | None) -> None:
        """Check the way up to the first point: straight, or for a plane along the ground for ``roll_m`` first."""
        what = f"{top.what}, the climb to it from home"
        if roll_m is None:
            self._check_leg(what, home, top.position_m, margins)
            return
        lift_off = top.position_m - home
        lift_off = home + lift_off * [1.0, 1.0, 0.0] * roll_m / math.hypot(lift_off[0], lift_off[1])
        self._check_leg(what, home, lift_off, margins)
        self._check_leg(what, lift_off, top.position_m, margins)
        # a plane cannot keep the margin before it has climbed to it: its share of the way, its share of the margin
        share = np.linspace(0.0, 1.0, 101)[1:]
        points = lift_off + share[:, None] * (top.position_m - lift_off)
        missing = share * margins.height_agl_min_m - (
            points[:, 2] - self._terrain.height_amsl_m(points[:, 0], points[:, 1])
        )
        if not missing.max() <= RUNWAY_RISE_M:
            raise MissionError(
                f"{what}: expected the ground to fall behind, got {np.nanmax(missing):.1f} m too little height along "
                "the climb: move home, or lower takeoff_height_m"
            )

    def _check_level(self, spot: _Spot, limits: VehicleLimits) -> None:
        """Check that one can land there, in an emergency too."""
        slope = float(steepest(self._terrain.arrays, spot.position_m[0], spot.position_m[1], limits.tube_m))
        steep_deg, most_deg = math.degrees(math.atan(slope)), math.degrees(limits.landing_slope_rad)
        if not steep_deg <= most_deg:
            raise MissionError(
                f"{spot.what}: expected ground of at most {most_deg:g} degrees to land on "
                f"(safety.landing_slope_max_deg), got up to {steep_deg:.1f} degrees within {limits.tube_m:g} m: "
                "move it to level ground"
            )

    def _check_circle(self, center: _Spot, radius_m: float, margins: Margins) -> None:
        """Check the circle on which a plane stays at its end; its first, wider turn is checked as it is predicted."""
        what = f"{center.what}, the circle of {radius_m:g} m radius on which it stays"
        for x, y in _circle(center.position_m[0], center.position_m[1], radius_m).tolist():
            self._check_spot(_Spot(what, np.array([x, y, center.position_m[2]])), margins)

    def _check_landing(self, goal: _Spot, margins: Margins) -> None:
        x, y, _ = goal.position_m.tolist()
        ground = self._terrain.ground_amsl_m(x, y, goal.what)
        self._check_leg(f"{goal.what}, the descent to the ground", goal.position_m, np.array([x, y, ground]), margins)

    def _check_leg(self, what: str, start: FloatArray, end: FloatArray, margins: Margins) -> None:
        """Check the distances from obstacles, fence and the area's edge along a leg (or at a point)."""
        row = kernels.legs_clearance(self._space, np.array([[start, end]]), math.inf)[0]
        distance, need = float(row[kernels.OBSTACLE]), margins.obstacle_m
        if distance < need - _TOLERANCE_M:
            name = self._obstacles.names[int(row[kernels.OBSTACLE_INDEX])]
            got = f"{-distance:.1f} m inside it" if distance < 0 else f"{distance:.1f} m"
            raise MissionError(
                f"{what}: expected at least {need:.1f} m from obstacle {name} (safety.obstacle_m and the radius of its "
                f"tube), got {got}: move it {need - distance:.1f} m away"
            )
        inside, need = float(row[kernels.FENCE]), margins.fence_m
        if inside < need - _TOLERANCE_M:
            border = "fence" if self._mission.fence is not None else "area"
            got = f"{-inside:.1f} m outside" if inside < 0 else f"{inside:.1f} m"
            raise MissionError(
                f"{what}: expected at least {need:.1f} m inside the {border} (safety.obstacle_m and the radius of its "
                f"tube), got {got}: move it, or widen the {border}"
            )

    def _check_no_void(self, start: _Spot, end: _Spot) -> None:
        """Check that the ground is known below the straight way: what cannot be seen cannot be planned over."""
        across_m = _apart_across_m(start.position_m, end.position_m)
        share = np.linspace(0.0, 1.0, 2 + int(2 * across_m / self._terrain.spacing_m))
        points = start.position_m + share[:, None] * (end.position_m - start.position_m)
        x, y = points[:, 0], points[:, 1]
        voids = np.isnan(self._terrain.height_amsl_m(x, y)) & self._terrain.reaches(x, y)
        if voids.any():
            at = self._frame.geo_point(points[int(np.argmax(voids))])
            raise MissionError(
                f"{end.what}: expected heights along the way to it, got voids of {self._terrain.description} for "
                f"{across_m * voids.mean():.0f} m from {at.lat_deg:.5f}, {at.lon_deg:.5f}: fill them "
                "(e.g. gdal_fillnodata)"
            )

    def _separation_m(self, a: VehicleTask, b: VehicleTask) -> float:
        return self._mission.fleet.separation_m + a.off_prediction_m + b.off_prediction_m

    def _check_distance(self, field: str, pair: tuple[int, int], distance: float, need: float) -> None:
        vehicles, (i, j) = self._mission.vehicles, pair
        if distance < max(need, 0.01) - _TOLERANCE_M:
            got = "the same place" if distance < 0.01 else f"{distance:.1f} m"
            raise MissionError(
                f"{_named(j, vehicles[j], field)}: expected at least {max(need, 0.01):g} m from the {field} of "
                f"{_named(i, vehicles[i])} (fleet.separation_m and both vehicles' errors), got {got}: move one of them"
            )

    def _check_apart(self, tasks: Sequence[VehicleTask]) -> None:
        vehicles = self._mission.vehicles
        together = self._mission.fleet.arrive_together
        starts = [self._position(v.start, _named(i, v, "start")) if v.start else None for i, v in enumerate(vehicles)]
        for (i, a), (j, b) in itertools.combinations(enumerate(tasks), 2):
            pair, start_a, start_b = (i, j), starts[i], starts[j]
            separation_m = self._separation_m(a, b)
            if start_a is not None and start_b is not None:
                self._check_distance("start", pair, float(np.linalg.norm(start_a - start_b)), 0.0)
            self._check_distance("home", pair, _apart_across_m(a.home_m, b.home_m), separation_m)
            goal_a, goal_b = a.route_m[-1], b.route_m[-1]
            if a.end == b.end == "land":
                self._check_distance("goal", pair, _apart_across_m(goal_a, goal_b), separation_m)
            elif together or (a.end != "rtl" and b.end != "rtl"):
                self._check_distance("goal", pair, float(np.linalg.norm(goal_a - goal_b)), separation_m)
            (place_a, radius_a_m), (place_b, radius_b_m) = _stay(a), _stay(b)
            across_m = max(0.0, _apart_across_m(place_a, place_b) - radius_a_m - radius_b_m)
            apart_m = math.hypot(across_m, place_a[2] - place_b[2])
            if radius_a_m + radius_b_m > 0.0 and apart_m < separation_m - _TOLERANCE_M:
                raise MissionError(
                    f"{_named(j, vehicles[j])}: expected to stay at its end at least {separation_m:g} m from "
                    f"{_named(i, vehicles[i])}, circles of planes included (fleet.separation_m), got {apart_m:.1f} m: "
                    "move one's goal (with rtl: home), or change its height"
                )


def _hung(
    what: str, kinds: tuple[str, str], start_m: FloatArray, end_m: FloatArray, constant_m: float | None
) -> Catenary:
    """Return the conductor between the tops of two supports, the second named ``what``."""
    this, before = kinds
    across_m = _apart_across_m(start_m, end_m)
    if across_m < _SAME_PLACE_M:
        raise MissionError(
            f"{what}: expected a {this} at least {_SAME_PLACE_M} m from {before}, got one {across_m:.2f} m away: "
            "remove one of them"
        )
    if across_m > _SPAN_MAX_M:
        raise MissionError(
            f"{what}: expected a {this} within {_SPAN_MAX_M / 1000:g} km of {before}, got one "
            f"{across_m / 1000:.1f} km away: check their order, or make them two lines"
        )
    found = catenary(start_m, end_m, constant_m)
    if found.is_slack:
        raise MissionError(
            f"{what}: expected a catenary_m of at least {across_m / SLACKEST:.0f} m for the {across_m:.0f} m from "
            f"{before}, got {found.constant_m:g}: so slack it would hang to the ground"
        )
    return found


def _shared(span: Span, other: Span) -> Span:
    """Return the span of two circuits, or of a line that goes there and back: as wide and as tight as either."""
    one, two = span.conductor, other.conductor
    hung = replace(one.catenary, constant_m=max(one.catenary.constant_m, two.catenary.constant_m))
    conductor = replace(one, catenary=hung, radius_m=max(one.radius_m, two.radius_m))
    lines = tuple(dict.fromkeys((*span.lines, *other.lines)))
    return replace(span, lines=lines, curve_m=hung.chords_m(), conductor=conductor)


def _curtains(conductor: Conductor) -> Iterator[Solid]:
    """Yield what stands for a conductor: nobody flies below it."""
    for start, end in itertools.pairwise(conductor.catenary.chords_m()):
        yield CurtainSolid(conductor.name, start, end, conductor.radius_m)


def _stay(task: VehicleTask) -> tuple[FloatArray, float]:
    """Return where a vehicle is when its mission is over, and the radius of the circle that a plane flies there."""
    if task.motion.vehicle_class == "copter":
        return (task.home_m if task.end == "rtl" else task.route_m[-1]), 0.0
    x, y, z = task.home_m
    above_home = np.array([x, y, task.motion.return_alt_amsl_m(task.route_m[-1, 2], z)])
    place = task.route_m[-1] if task.end == "loiter" else above_home
    wind_m_s = max(task.limits.wind_max_m_s, math.hypot(*task.motion.wind_m_s))
    return place, task.motion.circle_m(task.limits.speed_max_m_s, float(place[2]), wind_m_s)


def _tailwind_m_s(model: MotionModel, way_m: FloatArray) -> float:
    """Return how fast the air moves along a way; 0 against it: what a headwind spares is not counted on."""
    across_m = float(math.hypot(way_m[0], way_m[1]))
    east, north = model.wind_m_s
    return max(0.0, east * way_m[0] + north * way_m[1]) / across_m if across_m > 0.0 else 0.0


def _named(index: int, vehicle: mission.Vehicle, field: str = "") -> str:
    return f"vehicles[{index}]{'.' if field else ''}{field} ({vehicle.name})"


def _tower(index: int, tower: mission.Tower) -> str:
    return f"inspection.towers[{index}] ({tower.name})"


def _obstacle(index: int, obstacle: mission.Obstacle) -> str:
    return f"obstacles[{index}] ({obstacle.name})"


def _around(places: Sequence[tuple[float, float]] | Iterator[tuple[float, float]] | FloatArray) -> Rectangle:
    xy = np.array(list(places), dtype=np.float64)
    west, south = xy.min(axis=0).tolist()
    east, north = xy.max(axis=0).tolist()
    return west, south, east, north


def _clipped(ground: Terrain, needed: Rectangle, wanted: Rectangle) -> Rectangle:
    """Return ``wanted`` without what lies wholly beside the terrain, but with all that is needed."""
    x, step_x = np.linspace(wanted[0], wanted[2], 257, retstep=True)
    y, step_y = np.linspace(wanted[1], wanted[3], 257, retstep=True)
    reached = ground.reaches(*np.meshgrid(x, y))
    x, y = x[reached.any(axis=0)], y[reached.any(axis=1)]
    if not len(x):
        return wanted
    return (
        min(needed[0], max(wanted[0], float(x[0] - step_x))),
        min(needed[1], max(wanted[1], float(y[0] - step_y))),
        max(needed[2], min(wanted[2], float(x[-1] + step_x))),
        max(needed[3], min(wanted[3], float(y[-1] + step_y))),
    )


def _apart_across_m(a: FloatArray, b: FloatArray) -> float:
    return float(math.hypot(a[0] - b[0], a[1] - b[1]))


def _circle(x: float, y: float, radius_m: float) -> FloatArray:
    angle = np.linspace(0.0, 2 * math.pi, 16, endpoint=False)
    around_m = radius_m / math.cos(math.pi / 16)
    return np.stack([x + around_m * np.cos(angle), y + around_m * np.sin(angle)], axis=-1)
