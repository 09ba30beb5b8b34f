"""The paper's scenes, run twice: as the paper poses them, and as this planner solves them.

*As the paper poses them*: a vehicle's path is a natural cubic spline through control points that may be anywhere in the
area. An optimiser that knows nothing else starts from random ones and minimises the mission's own price
(:mod:`missionplanner.cost`), vehicle after vehicle, each pricing the paths of those before it.

*As this planner solves them*: :func:`missionplanner.planner.plan_fleet`, from the mission and a seed.

What comes of both is judged alike: by that price, and by :mod:`.scene_judge`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from missionplanner import proof
from missionplanner.cost import THREADS, Price
from missionplanner.errors import MissionPlannerError
from missionplanner.experiments.document import provenance
from missionplanner.experiments.scene_judge import Judge, least_apart_m, together
from missionplanner.geodesy import FloatArray
from missionplanner.mission import parse_mission
from missionplanner.path import basis, evenly, length_m, uniform_knots
from missionplanner.path_search import PlannedPath
from missionplanner.plan import Trajectory
from missionplanner.planner import plan_fleet
from missionplanner.scene import Scene, build_scene
from missionplanner.search.run import minimise

POPULATION, ITERATIONS = 50, 200
"""The paper's."""

EVALUATIONS = POPULATION * ITERATIONS
CONTROLS = 10
"""Control points that are searched, per vehicle: 30 coordinates in space. The paper does not give its number."""

GRID = np.arange(1, ITERATIONS + 1) * POPULATION
"""The evaluations at which the curve of convergence is kept."""

SOFT_M, ROUNDING_M = 0.2, 0.05
"""How much nearer than it must a safe path may be: one that ends on soft limits, which forgive so much; one that is
proven, for what the judge's ground differs."""

_CLOCK = time.thread_time if THREADS == 1 else time.process_time
"""Of the planner, whose prices share threads where there are several; others' work counts then, too."""
_SAMPLES = 128
_ROOM_ABOVE_M = 100.0
_FELLOW_INSTANTS = 128


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """All paths of one vehicle that the paper's search can make: ``paths`` of points (P, D) of a box."""

    matrix: FloatArray  # (S, K + 2), the spline's basis
    ends_m: FloatArray  # (2, 3)
    lower: FloatArray  # (D,), of K points; in the plane: x and y alone, at the start's altitude
    upper: FloatArray

    def paths(self, x: FloatArray) -> FloatArray:
        """Return paths (P, S, 3)."""
        per_point = 2 if len(self.lower) == 2 * (self.matrix.shape[1] - 2) else 3
        points = np.empty((len(x), self.matrix.shape[1], 3))
        points[..., 2] = self.ends_m[0, 2]
        points[:, 0], points[:, -1] = self.ends_m
        points[:, 1:-1, :per_point] = x.reshape(len(x), -1, per_point)
        found: FloatArray = np.matmul(self.matrix, points)
        return found


def curves(scene: Scene, vehicle: int, controls: int = CONTROLS, *, planar: bool = False) -> Curves:
    """Return the curves of a vehicle through so many control points within the scene's area."""
    ends_m = scene.tasks[vehicle].route_m[[0, -1]]
    west, south, east, north = scene.area_m
    heights = scene.terrain.arrays.height_amsl_m
    routes = np.concatenate([task.route_m for task in scene.tasks])
    low_m = float(np.nanmin(heights))
    high_m = max(float(np.nanmax(heights)), float(routes[:, 2].max())) + _ROOM_ABOVE_M
    per_point = 2 if planar else 3
    return Curves(
        matrix=basis(uniform_knots(controls + 2), np.linspace(0.0, 1.0, _SAMPLES)),
        ends_m=ends_m,
        lower=np.tile(np.array([west, south, low_m])[:per_point], controls),
        upper=np.tile(np.array([east, north, high_m])[:per_point], controls),
    )


def price_of(scene: Scene, vehicle: int, fellows: Sequence[FloatArray]) -> Price:
    """Return the mission's price of a vehicle's path (S, 3), given the paths of those before it."""
    task = scene.tasks[vehicle]
    return Price(
        space=scene.space,
        limits=task.limits,
        route_length_m=float(np.linalg.norm(np.diff(task.route_m, axis=0), axis=1).sum()),
        weights=scene.mission.planner.weights,
        fellows=np.stack([evenly(path_m, _FELLOW_INSTANTS) for path_m in fellows]) if fellows else None,
        separation_m=max(proof.required_apart_m(scene, task, other) for other in scene.tasks),
    )


@lru_cache(maxsize=4)
def resolved(text: str) -> tuple[Scene, Judge]:
    """Return the scene of a mission's text, and its judge."""
    question = parse_mission(text, "mission")
    judge = Judge(question)  # refuses what needs files
    return build_scene(question, Path()), judge


def search_fleet(
    text: str, algorithm: str, seed: int, evaluations: int = EVALUATIONS, controls: int = CONTROLS, planar: bool = False
) -> dict[str, Any]:
    """Search all vehicles' paths as the paper poses it; return what came of it, judged."""
    scene, judge = resolved(text)
    vehicles = len(scene.tasks)
    seeds = np.random.SeedSequence(seed).generate_state(vehicles)
    paths: list[FloatArray] = []
    history = np.zeros(len(GRID))
    used, points = 0, []
    _warm_up(text, algorithm)
    begin_s = time.thread_time()
    for vehicle in range(vehicles):
        family, price = curves(scene, vehicle, controls, planar=planar), price_of(scene, vehicle, paths)
        found = minimise(
            _cost(family, price),
            family.lower,
            family.upper,
            algorithm=algorithm,
            evaluations=evaluations,
            seed=int(seeds[vehicle]),
        )
        paths.append(family.paths(found.best[np.newaxis])[0])
        points.append(np.round(found.best, 3).tolist())
        at = np.searchsorted(found.history_evaluations, GRID, side="right") - 1
        history += found.history[np.clip(at, 0, len(found.history) - 1)]
        used += found.evaluations
    cpu_s = time.thread_time() - begin_s
    return {
        **provenance(),
        **_judged(scene, judge, paths, paths, together(paths), SOFT_M),
        "history": np.round(history, 6).tolist(),
        "evaluations": used,
        "cpu_s": cpu_s,
        "points": points,
    }


@lru_cache(maxsize=64)
def _warm_up(text: str, algorithm: str | None) -> None:
    """Compile what a search or, without an algorithm, a plan needs, or read it from the cache: none of its time."""
    scene, _ = resolved(text)
    if algorithm is None:
        with suppress(MissionPlannerError):
            plan_fleet(scene)
        return
    family, price = curves(scene, 0), price_of(scene, 0, [])
    minimise(_cost(family, price), family.lower, family.upper, algorithm=algorithm, evaluations=300, seed=0)


def _cost(family: Curves, price: Price) -> Any:
    return lambda x: price.total(family.paths(x), threads=1)


def plan_scene(text: str, seed: int) -> dict[str, Any]:
    """Plan the mission with this planner; return what came of it, judged as it would be flown."""
    scene, judge = resolved(text)
    _warm_up(text, None)
    searched: list[PlannedPath] = []
    begin_s = _CLOCK()
    try:
        plan = plan_fleet(scene, seed=seed, clock=_CLOCK, searched=searched.append)
    except MissionPlannerError as error:
        return {**provenance(), "error": str(error), "cpu_s": _CLOCK() - begin_s}
    cpu_s = _CLOCK() - begin_s
    paths = [vehicle.path_m for vehicle in plan.vehicles]
    legs = [vehicle.waypoints_m for vehicle in plan.vehicles]
    flights = [vehicle.trajectory for vehicle in plan.vehicles]
    return {
        **provenance(),
        **_judged(scene, judge, paths, legs, flights, ROUNDING_M),
        "error": "",
        "evaluations": sum(vehicle.evaluations for vehicle in plan.vehicles),
        "cpu_s": cpu_s,
        "searches_s": [path.seconds.search_s for path in searched],
        "legs_s": [path.seconds.proof_s for path in searched],
        "proven": plan.certificate is not None and plan.certificate.proven,
        "paths": [np.round(way, 2).tolist() for way in legs],
    }


def _judged(
    scene: Scene,
    judge: Judge,
    paths: Sequence[FloatArray],
    legs: Sequence[FloatArray],
    flights: Sequence[Trajectory],
    forgiven_m: float,
) -> dict[str, Any]:
    """Return each vehicle's price and length, and what is true of the legs that it flies.

    It *avoids* when its legs touch nothing and its flight keeps the fleet's separation; it is *safe* when all that
    strays from them by its tube's radius keeps the safety distances too; it is *flyable* when no leg is too steep.
    """
    apart_m = least_apart_m(flights)
    vehicles = []
    for k, (task, path_m, legs_m) in enumerate(zip(scene.tasks, paths, legs, strict=True)):
        kept, wide = judge.kept(legs_m), judge.kept(legs_m, task.limits.tube_m)
        free = kept.height_m > 0.0 and kept.obstacle_m > 0.0
        roomy = (
            wide.height_m >= task.limits.terrain_margin_m - forgiven_m
            and wide.obstacle_m >= task.limits.obstacle_margin_m - forgiven_m
            and wide.edge_m >= task.limits.obstacle_margin_m - forgiven_m
        )
        price = price_of(scene, k, paths[:k])
        others = [proof.required_apart_m(scene, task, other) for other in scene.tasks if other is not task]
        vehicles.append(
            {
                "name": task.name,
                "cost": float(price.total(path_m[np.newaxis])[0]),
                "length_m": float(length_m(path_m)),
                "height_m": kept.height_m,
                "obstacle_m": kept.obstacle_m,
                "apart_m": float(apart_m[k]),
                "climb_deg": math.degrees(kept.climb_rad),
                "avoids": bool(free and apart_m[k] >= scene.mission.fleet.separation_m),
                "safe": bool(roomy and apart_m[k] >= max(others, default=0.0) - forgiven_m),
                "flyable": bool(kept.climb_rad <= task.limits.climb_angle_rad + 1e-3),
            }
        )
    return {
        "vehicles": vehicles,
        "cost": float(np.sum([v["cost"] for v in vehicles])),
        "length_m": float(np.sum([v["length_m"] for v in vehicles])),
    }


def path_of(text: str, result: dict[str, Any], vehicle: int, *, planar: bool = False) -> FloatArray:
    """Return the path (S, 3) of a vehicle in a result of :func:`search_fleet` or :func:`plan_scene`."""
    if "paths" in result:
        return np.array(result["paths"][vehicle])
    points = np.array(result["points"][vehicle])
    controls = len(points) // (2 if planar else 3)
    path: FloatArray = curves(resolved(text)[0], vehicle, controls, planar=planar).paths(points[np.newaxis])[0]
    return path


def quartiles(histories: Sequence[npt.ArrayLike]) -> FloatArray:
    """Return lower quartile, median and upper quartile (3, G) of curves of convergence (R, G)."""
    found: FloatArray = np.array(np.quantile(np.array(histories), [0.25, 0.5, 0.75], axis=0), dtype=np.float64)
    return found
