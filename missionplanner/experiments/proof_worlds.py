"""Random grounds, solids, fences and legs to hold the checker against, as the checker and as the oracle take them."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from missionplanner import terrain_bounds
from missionplanner.experiments.proof_oracle import Ground, Solids, solids_of
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.kernels import SpaceArrays, TerrainArrays
from missionplanner.mission import RasterTerrain, load_mission
from missionplanner.obstacles import (
    CableSolid,
    ConeSolid,
    CurtainSolid,
    CylinderSolid,
    PrismSolid,
    Solid,
    SphereSolid,
    pack,
)
from missionplanner.scene import build_scene
from missionplanner.terrain import GridReference, Rectangle, Terrain
from missionplanner.terrain_bounds import Pyramid

_ROOM_M = 1200.0  # of a real terrain: around a world's middle
_SIDE_M = 2400.0  # of a synthetic one


@dataclass(frozen=True, slots=True, eq=False)
class Land:
    """A terrain as the checker and as the oracle take it, where worlds may be made on it."""

    name: str
    terrain: TerrainArrays
    bounds: Pyramid
    ground: Ground
    area: Rectangle  # of the terrain
    calm: bool  # whether a grid of which the oracle's parabola along a leg is exact enough for any radius


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A land, and what stands on it, around a middle."""

    land: Land
    middle: FloatArray  # (2,)
    half_m: float
    solids: tuple[Solid, ...]
    space: SpaceArrays
    seen: Solids


@functools.lru_cache(maxsize=2)
def real_land(mission_path: Path) -> Land | None:
    """Return the terrain of a mission that has one from a file; None for others, or where the file is missing."""
    mission = load_mission(mission_path)
    if not isinstance(mission.terrain, RasterTerrain):
        return None
    path = mission_path.parent / mission.terrain.file
    if not path.is_file():
        return None
    scene = build_scene(mission, mission_path.parent)
    ground = Ground.read(path, mission.origin.lat_deg, mission.origin.lon_deg)
    arrays = scene.terrain.arrays
    reach_m = max(map(abs, scene.area_m)) + _SIDE_M
    return Land(path.name, arrays, terrain_bounds.pyramid(arrays, reach_m), ground, scene.area_m, calm=True)


def random_land(rng: np.random.Generator) -> Land:
    """Return peaks, terraces with cliffs, or noise on a turned and sheared grid, bent or not; below the sea or not."""
    bent = bool(rng.random() < 0.25)
    cell_m = float(rng.choice([3.0, 5.0, 8.0] if bent else [5.0, 10.0, 20.0, 30.0]))
    count = math.ceil(_SIDE_M / cell_m)
    kind = "wall" if bent and rng.random() < 0.5 else str(rng.choice(["peaks", "terraces", "noise"]))
    heights = rng.uniform(-400.0, 2500.0) + _relief(rng, kind, count, cell_m)
    turn, shear = rng.uniform(-math.pi, math.pi), rng.uniform(-0.2, 0.2)
    if kind == "wall":  # its rows run east and are bent towards it
        turn = 0.5 * math.pi + rng.uniform(-0.1, 0.1)
    a = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn) + shear, math.cos(turn)]]) / cell_m
    bend = rng.uniform(-0.5e-4, 0.5e-4, 2) / cell_m if bent else np.zeros(2)  # cells per square metre
    bend[0] = -0.5e-4 / cell_m if kind == "wall" else bend[0]
    middle = 0.5 * (count - 1)
    to_cell = np.zeros((2, 10))
    to_cell[:, 0], to_cell[:, 1], to_cell[:, 2] = middle, a[:, 0] * 1e4, a[:, 1] * 1e4
    to_cell[:, 3] = bend * 1e8
    arrays = TerrainArrays(np.ascontiguousarray(heights, dtype=np.float32), to_cell)

    def cells(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        row = middle + a[0, 0] * x + a[0, 1] * y + bend[0] * x * x
        return row, middle + a[1, 0] * x + a[1, 1] * y + bend[1] * x * x

    half = 0.3 * _SIDE_M
    return Land(
        name=f"{kind}{' on a bent grid' if bent else ''}",
        terrain=arrays,
        bounds=terrain_bounds.pyramid(arrays, _SIDE_M),
        ground=Ground(arrays.height_amsl_m.astype(np.float64), cells),
        area=(-half, -half, half, half),
        calm=not bent,
    )


def _relief(rng: np.random.Generator, kind: str, count: int, cell_m: float) -> FloatArray:
    place = np.arange(count) * cell_m
    hills = np.zeros((count, count))
    for _ in range(12):
        x, y = rng.uniform(0.0, _SIDE_M, 2)
        spread = rng.uniform(60.0, 500.0)
        along_y, along_x = np.exp(-(((place - y) / spread) ** 2)), np.exp(-(((place - x) / spread) ** 2))
        hills += rng.uniform(20.0, 1.2 * spread) * along_y[:, None] * along_x
    if kind == "terraces":  # the surface overshoots at every edge
        step = rng.uniform(0.3, 1.5) * cell_m
        return np.floor(hills / step) * step
    if kind == "wall":
        level = np.zeros((count, count))
        first = _border(count) + 2
        level[first : first + 4] = 2.0 * cell_m
        return level
    if kind == "noise":
        rough: FloatArray = 0.3 * hills + rng.normal(0.0, rng.uniform(0.02, 0.3) * cell_m, (count, count))
        return rough
    return hills


def _border(count: int) -> int:
    """Return a row near the middle of a grid at which blocks of all sizes up to 256 end."""
    return 256 * max(1, round(0.5 * count / 256))


def random_world(rng: np.random.Generator, land: Land, *, roomy: bool = False) -> World:
    """Return a world on a land: up to five solids of all kinds, mostly a fence; less of both if ``roomy``."""
    west, south, east, north = land.area
    half = float(min(rng.uniform(250.0, 500.0), 0.5 * (east - west), 0.5 * (north - south)))
    solid_count, fenced, wide = (int(rng.integers(0, 3)), 0.5, 1.8) if roomy else (int(rng.integers(0, 6)), 0.7, 1.0)
    middle = np.array([rng.uniform(west + half, east - half), rng.uniform(south + half, north - half)])
    ground_m = float(land.ground.at(middle[np.newaxis])[0])
    if rng.random() < 0.15:  # nothing but prisms with notches
        solids: tuple[Solid, ...] = tuple(_notched(rng, middle, half, k) for k in range(6))
    else:
        solids = tuple(_solid(rng, land, middle, half, k) for k in range(solid_count))
    fence, top = np.zeros((0, 2)), math.inf
    if rng.random() < fenced and land.calm:
        fence = _star(rng, middle, 0.8 * wide * half, 1.6 * wide * half)
        top = ground_m + rng.uniform(100.0, 800.0) if rng.random() < 0.5 else math.inf
    room = 1.3 * wide * half if land.calm else 0.6 * _SIDE_M
    area = np.array([*(middle - room), *(middle + room)])
    space = SpaceArrays(land.terrain, pack(solids).arrays, fence, top, area)
    return World(land, middle, half, solids, space, solids_of(solids, fence, top, area))


def _star(rng: np.random.Generator, middle: FloatArray, least: float, most: float) -> FloatArray:
    """Return a polygon around a middle, mostly one that is not convex."""
    count = int(rng.integers(3, 10))
    turn = rng.uniform(0.0, 2.0 * math.pi) + (np.arange(count) + rng.uniform(-0.3, 0.3, count)) * 2.0 * math.pi / count
    reach = rng.uniform(least, most, count)
    outline: FloatArray = middle + reach[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    return outline[::-1].copy() if rng.random() < 0.5 else outline


def _notched(rng: np.random.Generator, middle: FloatArray, half: float, number: int) -> Solid:
    """Return a prism as high as one likes, of which a line may come near twice."""
    outline = _star(rng, middle + rng.uniform(-half, half, 2), 5.0, 0.5 * half)
    return PrismSolid(f"solid-{number}", outline)


def _solid(rng: np.random.Generator, land: Land, middle: FloatArray, half: float, number: int) -> Solid:
    xy = middle + rng.uniform(-half, half, 2)
    x, y = map(float, xy)
    ground_m = float(np.nan_to_num(land.ground.at(xy[np.newaxis])[0]))
    name = f"solid-{number}"
    top = ground_m + rng.uniform(10.0, 150.0)
    match int(rng.integers(0, 6)):
        case 0:
            return CylinderSolid(name, x, y, rng.uniform(2.0, 60.0), top if rng.random() < 0.7 else math.inf)
        case 1:
            return ConeSolid(name, x, y, rng.uniform(10.0, 120.0), ground_m, rng.uniform(20.0, 200.0))
        case 2:
            return SphereSolid(name, x, y, top, rng.uniform(5.0, 80.0), "radar", hard=bool(rng.random() < 0.8))
        case 3:
            return SphereSolid(name, x, y, ground_m, rng.uniform(5.0, 80.0), "marine")
        case 4:
            floor = ground_m - 50.0 if rng.random() < 0.5 else top - rng.uniform(5.0, 40.0)
            outline = _star(rng, xy, 10.0, 90.0)
            return PrismSolid(name, outline, floor, top if rng.random() < 0.7 else math.inf)
        case _:
            end = np.array([*(xy + rng.uniform(-200.0, 200.0, 2)), top + rng.uniform(-40.0, 40.0)])
            hung = CurtainSolid if number % 2 else CableSolid
            return hung(name, np.array([x, y, top]), end, rng.uniform(0.5, 10.0))


def random_legs(
    rng: np.random.Generator, world: World, count: int, height_m: Callable[[int], FloatArray]
) -> FloatArray:
    """Return legs (N, 2, 3) whose middle lines pass at least ``height_m`` (N,) above the ground, as far as one sees."""
    calm = world.land.calm  # else only long legs show what a bent grid does
    long_m = np.where(rng.random(count) < (0.85 if calm else 0.6), 120.0, 400.0 if calm else 1600.0)
    length = 3.0 * (long_m / 3.0) ** rng.random(count)
    turn = rng.uniform(0.0, 2.0 * math.pi, count)
    ahead = length[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    start = world.middle + rng.uniform(-world.half_m, world.half_m, (count, 2)) * (1.0 if calm else 0.5)
    start -= 0.0 if calm else 0.5 * ahead
    end = start + ahead
    if not calm:  # half of them between two places of one row, which lines between them leave
        row = _border(len(world.land.ground.height_m)) - rng.uniform(0.5, 4.0, count)
        chosen = (rng.random(count) < 0.5)[:, None]
        start, end = (np.where(chosen, _in_row(world.land.ground, place, row), place) for place in (start, end))
    slope = rng.uniform(-0.4, 0.4, count) * (rng.random(count) < 0.7)
    legs = np.zeros((count, 2, 3))
    legs[:, 0, :2], legs[:, 1, :2] = start, end
    legs[:, 1, 2] = slope * length
    return raised(world.land.ground, legs, height_m(count))


def _in_row(ground: Ground, place: FloatArray, row: FloatArray) -> FloatArray:
    """Return places (N, 2) near these in rows (N,) of the grid."""
    for _ in range(8):
        x, y = place.T
        slope = np.stack(
            [
                ground.to_cell(x + 0.5, y)[0] - ground.to_cell(x - 0.5, y)[0],
                ground.to_cell(x, y + 0.5)[0] - ground.to_cell(x, y - 0.5)[0],
            ],
            axis=-1,
        )
        place = place + ((row - ground.to_cell(x, y)[0]) / (slope**2).sum(axis=1))[:, None] * slope
    return place


def raised(ground: Ground, legs: FloatArray, height_m: FloatArray) -> FloatArray:
    """Return legs (N, 2, 3) raised or lowered until they pass just so high (N,) above what is seen of the ground."""
    share = np.linspace(0.0, 1.0, 33)[:, None, None]
    places = legs[:, 0] + share * (legs[:, 1] - legs[:, 0])  # (33, N, 3)
    heights = ground.at(places.reshape(-1, 3)[:, :2]).reshape(places.shape[:2])
    above = np.min(places[:, :, 2] - np.where(np.isnan(heights), -1e4, heights), axis=0)
    moved = legs.copy()
    moved[:, :, 2] += (height_m - above)[:, None]
    return moved


def terrain_of(land: Land, frame: LocalFrame) -> Terrain:
    """Return a land as scenes hold it."""
    reference = GridReference(frame.crs.to_wkt(), (1.0, 0.0, 0.0, 0.0, -1.0, 0.0))
    return Terrain(land.terrain, land.bounds, 10.0, land.name, reference)
