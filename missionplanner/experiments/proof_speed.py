"""How long the checker takes, and how that grows with legs, vehicles and the size of the terrain."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from missionplanner import proof, terrain_bounds
from missionplanner.clearance import tube_clearances
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays, TerrainArrays
from missionplanner.mission import load_mission
from missionplanner.obstacles import pack
from missionplanner.scene import Scene, build_scene
from missionplanner.sortie import Leg, Sortie

LEGS_EACH = (10, 20, 40, 80, 160, 320, 640)
VEHICLES = (5, 10, 20, 50, 100, 200)
CELLS = (10**6, 10**7, 10**8)

FLEET, LEGS = 5, 40
"""Vehicles, and legs of each, of the fleet that is timed while one of the two grows."""

_LEG_M = 40.0
_ROW_M = 1200.0  # lanes run to and fro over so much
_LANE_M = 40.0
_ABOVE_M = 110.0
_TERRAIN_LEGS = 2000
_CELL_M = 30.0
_REPEATS = 3


@dataclass(frozen=True, slots=True)
class Timing:
    """What took how long."""

    what: str  # legs, vehicles, cells
    count: int
    check_s: float
    pyramid_s: float | None = None


def measure(
    mission_path: Path,
    legs: Sequence[int],
    vehicles: Sequence[int],
    cells: Sequence[int],
    progress: Callable[[float], None],
) -> list[Timing]:
    """Return the times of whole proofs over a mission's terrain, and of tubes' clearances over synthetic ones; warm."""
    timings = []
    steps = len(legs) + len(vehicles) + len(cells)
    scene, sorties = fleet(mission_path, FLEET, LEGS)
    proof.prove(scene, sorties)
    for count in legs:
        scene, sorties = fleet(mission_path, FLEET, count)
        timings.append(Timing("legs", count, _proving_s(scene, sorties)))
        progress(len(timings) / steps)
    for count in vehicles:
        scene, sorties = fleet(mission_path, count, LEGS)
        timings.append(Timing("vehicles", count, _proving_s(scene, sorties)))
        progress(len(timings) / steps)
    for count in cells:
        timings.append(_terrain(count))
        progress(len(timings) / steps)
    return timings


def exponent(timings: Sequence[Timing], what: str) -> float | None:
    """Return the power with which the time grows over the upper half of the counts; None for too few."""
    found = sorted((t.count, t.check_s) for t in timings if t.what == what)
    upper = found[len(found) // 2 :] if len(found) > 3 else found
    if len(upper) < 2:
        return None
    count, seconds = np.log(np.array(upper)).T
    return float(np.polyfit(count, seconds, 1)[0])


def fleet(mission_path: Path, vehicles: int, legs: int) -> tuple[Scene, list[Sortie]]:
    """Return copters side by side over a mission's terrain among its obstacles, each on a lane of so many legs."""
    scene = build_scene(load_mission(mission_path), mission_path.parent)
    settings = scene.mission.vehicles[0]
    names = [f"v{k}" for k in range(vehicles)]
    copies = tuple(settings.model_copy(update={"name": name, "sysid": k + 1}) for k, name in enumerate(names))
    west, south, east, north = scene.area_m
    lane_m = min(_LANE_M, 0.8 * (east - west) / vehicles)
    x = 0.5 * (west + east) + (np.arange(vehicles) - 0.5 * (vehicles - 1)) * lane_m
    y = 0.5 * (south + north) - 0.5 * _ROW_M
    homes = np.stack([x, np.full(vehicles, y), scene.terrain.height_amsl_m(x, y)], axis=-1)
    task = scene.tasks[0]
    tasks = [replace(task, name=n, sysid=k + 1, home_m=homes[k]) for k, n in enumerate(names)]
    scene = replace(scene, mission=scene.mission.model_copy(update={"vehicles": copies}), tasks=tuple(tasks))
    return scene, [_lane(scene, k, legs) for k in range(vehicles)]


def _lane(scene: Scene, number: int, legs: int) -> Sortie:
    """Return one copter's sortie: to and fro on its lane, as high above the ground."""
    task = scene.tasks[number]
    along = np.arange(legs + 1) * _LEG_M
    there = along % (2.0 * _ROW_M)
    y = task.home_m[1] + np.minimum(there, 2.0 * _ROW_M - there)
    x = np.full(legs + 1, task.home_m[0])
    z = scene.terrain.height_amsl_m(x, y) + _ABOVE_M
    corners = np.stack([x, y, z], axis=-1)
    kinds = ["takeoff", *["straight"] * legs]
    return Sortie(
        name=task.name,
        sysid=task.sysid,
        autopilot=task.motion.autopilot,
        vehicle_class="copter",
        home_m=task.home_m,
        legs=tuple(
            Leg(k + 1, "takeoff" if k == 0 else "straight", corner, 8.0)
            for k, corner in enumerate(corners[: len(kinds)])
        ),
        ending="land",
        ending_seq=legs + 2,
        start_delay_s=0.0,
        return_height_m=120.0,
    )


def _proving_s(scene: Scene, sorties: Sequence[Sortie]) -> float:
    return _least_s(lambda: proof.prove(scene, sorties))


def _least_s(action: Callable[[], object]) -> float:
    """Return the least time of a few runs: others use the machine, too."""
    found = []
    for _ in range(_REPEATS):
        begin_s = time.perf_counter()
        action()
        found.append(time.perf_counter() - begin_s)
        if found[-1] > 10.0:
            break
    return min(found)


def _terrain(cells: int) -> Timing:
    """Return how long the pyramid of a synthetic terrain takes, and the clearances of legs across it."""
    side = math.isqrt(cells)
    rng = np.random.default_rng(cells)
    place = np.arange(side, dtype=np.float32)
    waves = [(rng.uniform(20.0, 200.0), rng.uniform(10.0, 60.0)) for _ in range(3)]
    heights = np.zeros((side, side), dtype=np.float32)
    for length, height in waves:
        along, across = np.sin(place / np.float32(length)), np.cos(place / np.float32(0.7 * length))
        heights += np.float32(height) * along[:, None] * across
    for row in range(side):
        heights[row] += rng.normal(0.0, 0.5, side).astype(np.float32)
    to_cell = np.zeros((2, 10))
    to_cell[:, 0] = 0.5 * side
    to_cell[0, 2], to_cell[1, 1] = -1e4 / _CELL_M, 1e4 / _CELL_M
    terrain = TerrainArrays(heights, to_cell)
    reach_m = 0.5 * side * _CELL_M
    pyramid_s = _least_s(lambda: terrain_bounds.pyramid(terrain, reach_m))
    bounds = terrain_bounds.pyramid(terrain, reach_m)
    edges = np.array([-reach_m, -reach_m, reach_m, reach_m])
    space = SpaceArrays(terrain, pack([]).arrays, np.zeros((0, 2)), math.inf, edges)
    legs = _legs_across(rng, 0.9 * reach_m)
    radius_m = np.full(len(legs), 5.0)
    tube_clearances(space, bounds, legs[:1], radius_m[:1])
    return Timing("cells", cells, _least_s(lambda: tube_clearances(space, bounds, legs, radius_m)), pyramid_s)


def _legs_across(rng: np.random.Generator, reach_m: float) -> FloatArray:
    """Return legs (N, 2, 3) all over a terrain, as high as its waves."""
    start = rng.uniform(-reach_m, reach_m, (_TERRAIN_LEGS, 3))
    start[:, 2] = rng.uniform(100.0, 200.0, _TERRAIN_LEGS)
    ends = start + rng.uniform(-150.0, 150.0, (_TERRAIN_LEGS, 3)) * [1.0, 1.0, 0.1]
    return np.stack([start, ends], axis=1)
