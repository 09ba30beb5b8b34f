"""Evaluations per second of the price kernel beside the plain NumPy oracle, on a mountain scene like San Gabriel's.

Run ``python -m tests.benchmarks.price_kernel``. Both price the same paths, and must agree before they are timed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from missionplanner import cost
from missionplanner.cost import TERMS, Price
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays, TerrainArrays, terrain_heights
from missionplanner.mission import Weights
from missionplanner.obstacles import CableSolid, CylinderSolid, PrismSolid, Solid, SphereSolid, pack
from missionplanner.path import basis, evenly, uniform_knots
from tests.limits import limits
from tests.oracles.price import price_terms

LIMITS = limits(height_agl_max_m=300.0)


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A population of paths over a scene, and what its price takes into account."""

    space: SpaceArrays
    paths: FloatArray  # (P, S, 3)
    route_length_m: float
    fellows: FloatArray
    separation_m: float

    def price(self) -> Price:
        return Price(
            self.space, LIMITS, self.route_length_m, Weights(), fellows=self.fellows, separation_m=self.separation_m
        )

    def oracle(self, paths: FloatArray) -> dict[str, FloatArray]:
        return price_terms(
            paths,
            self.space,
            LIMITS,
            self.route_length_m,
            np.empty((0, 3)),
            np.empty(0),
            1.0,
            self.fellows,
            self.separation_m,
        )


def mountain_terrain(rng: np.random.Generator, cells: int = 300, cell_m: float = 30.0) -> TerrainArrays:
    """Ridges and valleys on a 30 m grid, 400 to 1,600 m high, centred on the origin."""
    place = np.arange(cells) * cell_m
    x, y = np.meshgrid(place, place)
    height = np.full((cells, cells), 1000.0)
    for wave_m, amplitude_m in ((6000.0, 250.0), (2500.0, 120.0), (900.0, 40.0), (300.0, 10.0)):
        for _ in range(3):
            heading, phase = rng.uniform(0.0, 2.0 * math.pi, 2)
            along = (x * math.cos(heading) + y * math.sin(heading)) * 2.0 * math.pi / wave_m
            height += amplitude_m / 2.0 * np.sin(along + phase)
    to_cell = np.zeros((2, 10))
    to_cell[:, 0] = (cells - 1) / 2.0
    to_cell[0, 2] = -1e4 / cell_m  # rows run southwards
    to_cell[1, 1] = 1e4 / cell_m
    return TerrainArrays(height.astype(np.float32), to_cell)


def mountain_case(seed: int = 1, population: int = 50, samples: int = 240) -> Case:
    """Three kilometres along a power line of 40 towers, with masts, a crossing cable, radars and a no-fly polygon."""
    rng = np.random.default_rng(seed)
    terrain = mountain_terrain(rng)
    line = np.stack([np.linspace(-2000.0, 2000.0, 40), rng.normal(0.0, 30.0, 40)], axis=1)
    ground = terrain_heights(terrain, line)
    tops = np.column_stack([line, ground + 35.0])
    solids: list[Solid] = [CylinderSolid(f"T{k}", *tops[k, :2], 6.0, tops[k, 2]) for k in range(40)]
    solids += [CableSolid(f"S{k}", tops[k], tops[k + 1], 8.0) for k in range(39)]
    for k in range(4):
        x, y = rng.uniform(-1500.0, 1500.0), rng.uniform(-300.0, 300.0)
        foot = float(terrain_heights(terrain, np.array([[x, y]]))[0])
        solids.append(CylinderSolid(f"M{k}", x, y, 10.0, foot + 120.0))
    solids.append(CableSolid("crossing", np.array([0.0, -400.0, 1150.0]), np.array([50.0, 400.0, 1200.0]), 0.5))
    solids.append(SphereSolid("radar", 800.0, 500.0, 1000.0, 300.0, "radar"))
    solids.append(SphereSolid("soft", -800.0, -200.0, 1000.0, 250.0, "radar", hard=False))
    corners = np.array([[300.0, -350.0], [600.0, -380.0], [620.0, -120.0], [450.0, -200.0], [280.0, -100.0]])
    solids.append(PrismSolid("no-fly", corners))

    begin, end = np.array([-1500.0, -60.0]), np.array([1500.0, 60.0])
    controls = 8
    share = uniform_knots(controls)[:, None]
    control = np.empty((population, controls, 3))
    control[:, :, :2] = begin + share * (end - begin) + rng.normal(0.0, 60.0, (population, controls, 2))
    control[:, 0, :2], control[:, -1, :2] = begin, end
    for path in control:
        path[:, 2] = (
            terrain_heights(terrain, np.ascontiguousarray(path[:, :2])) + 110.0 + rng.normal(0.0, 15.0, controls)
        )
    paths = basis(uniform_knots(controls), np.linspace(0.0, 1.0, samples)) @ control
    fellows = np.stack([evenly(paths[k], 256) + np.array([0.0, 40.0 * (k - 1.5), 0.0]) for k in range(4)])
    space = SpaceArrays(
        terrain,
        pack(solids).arrays,
        np.array([[-3000.0, -1500.0], [3000.0, -1500.0], [3200.0, 0.0], [3000.0, 1500.0], [-3000.0, 1500.0]]),
        2500.0,
        np.array([-3500.0, -2000.0, 3500.0, 2000.0]),
    )
    return Case(space, paths, float(np.linalg.norm(paths[0, -1] - paths[0, 0])), fellows, 20.0)


def best_seconds(run: Callable[[], object], repeats: int) -> float:
    """Return the least time of several runs: the one least disturbed by the machine."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def main() -> None:
    """Print both speeds and their ratio."""
    case = mountain_case()
    begin = time.perf_counter()
    price = case.price()
    terms = price.terms(case.paths)
    print(f"first call, with compilation or from its cache: {time.perf_counter() - begin:.2f} s")
    few = case.paths[:10]
    for name, expected in case.oracle(few).items():
        np.testing.assert_allclose(getattr(terms, name)[:10], expected, rtol=1e-9, atol=1e-9, err_msg=name)
    slow = len(few) / best_seconds(lambda: case.oracle(few), 3)
    print(f"scene: {len(case.space.obstacles.kind)} solids, {case.paths.shape[1]} samples, {len(case.fellows)} fellows")
    print(f"terms agree with the oracle: {', '.join(TERMS)}")
    print(f"NumPy oracle: {slow:12,.0f} evaluations/s")
    for count in sorted({1, cost.THREADS}):
        cost.THREADS = count
        fast = len(case.paths) / best_seconds(lambda: price.total(case.paths), 50)
        print(
            f"kernel, {count} thread{'s' if count > 1 else ' '}: {fast:10,.0f} evaluations/s, ratio {fast / slow:,.0f}"
        )


if __name__ == "__main__":
    main()
