"""Mistakes put into the checker, one at a time: the soundness experiment must find each of them."""

from __future__ import annotations

import sys
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from numba import njit

from adapters import sorties
from missionplanner import clearance, kernels, proof, returns, terrain_bounds, timing
from missionplanner.experiments import proof_trials, proof_worlds
from missionplanner.experiments.proof_trials import Tally

pytestmark = pytest.mark.slow

MISSION = Path(__file__).parents[2] / "missions" / "ridge_line.yaml"
LEGS = proof_trials.LEGS_PER_WORLD

Install = Callable[[pytest.MonkeyPatch, types.ModuleType], None]


def worlds_of_legs(tries: int) -> Iterator[Tally]:
    for number in range(tries):
        yield proof_trials.try_legs(11, number, MISSION if number % 2 else None, LEGS)


def fleets(tries: int) -> Iterator[Tally]:
    for number in range(tries):
        yield proof_trials.try_fleet(11, number, MISSION if number % 2 else None)


# --- where a mutant goes ----------------------------------------------------------------------------------------------


def in_place_of_bounds(patch: pytest.MonkeyPatch, mutant: types.ModuleType) -> None:
    patch.setattr(clearance, "least_heights", mutant.least_heights)
    patch.setattr(proof_worlds, "terrain_bounds", mutant)
    proof_worlds.real_land.cache_clear()  # holds a pyramid


def in_place_of_kernels(patch: pytest.MonkeyPatch, mutant: types.ModuleType) -> None:
    patch.setattr(clearance, "kernels", mutant)


def in_place_of_clearance(patch: pytest.MonkeyPatch, mutant: types.ModuleType) -> None:
    patch.setattr(proof_trials, "clearance", mutant)
    patch.setattr(proof, "tube_clearances", mutant.tube_clearances)


def in_place_of_sorties(patch: pytest.MonkeyPatch, mutant: types.ModuleType) -> None:
    patch.setattr(proof_trials, "sorties", mutant)


def in_place_of_proof(patch: pytest.MonkeyPatch, mutant: types.ModuleType) -> None:
    patch.setattr(proof_trials, "proof", mutant)


def in_place_of_timing(patch: pytest.MonkeyPatch, mutant: types.ModuleType) -> None:
    patch.setattr(proof, "timing", mutant)


def in_place_of_returns(patch: pytest.MonkeyPatch, mutant: types.ModuleType) -> None:
    patch.setattr(proof, "returns", mutant)
    patch.setattr(proof_trials, "returns", mutant)


INSTALL: dict[types.ModuleType, Install] = {
    terrain_bounds: in_place_of_bounds,
    kernels: in_place_of_kernels,
    clearance: in_place_of_clearance,
    sorties: in_place_of_sorties,
    proof: in_place_of_proof,
    timing: in_place_of_timing,
    returns: in_place_of_returns,
}


@dataclass(frozen=True)
class Mutant:
    """A mistake, which check's claims must fall, and in how many worlds or fleets at most."""

    name: str
    module: types.ModuleType
    right: str
    wrong: str
    found_by: str
    tries: int = 20


MUTANTS = [
    Mutant(
        "the surface's lowest instead of its highest",
        terrain_bounds,
        "bound = lowest - radius - (high if sign > 0.0 else -low)",
        "bound = lowest - radius - (low if sign > 0.0 else -high)",
        "legs: terrain",
    ),
    Mutant(
        "patches off by one row",
        terrain_bounds,
        "net[k, m] = h[i - 1 + k, j - 1 + m]",
        "net[k, m] = h[i - 2 + k, j - 1 + m]",
        "legs: terrain",
    ),
    Mutant(
        "patches off by one column",
        terrain_bounds,
        "net[k, m] = h[i - 1 + k, j - 1 + m]",
        "net[k, m] = h[i - 1 + k, j - 2 + m]",
        "legs: terrain",
    ),
    Mutant(
        "nothing lost by straying up a slope",
        terrain_bounds,
        "lost = radius * math.sqrt(1.0 + (_TURN * gx) ** 2 + (_TURN * gy) ** 2)",
        "lost = radius",
        "legs: terrain",
    ),
    Mutant(
        "no ground to the sides in rows",
        terrain_bounds,
        "reach_r = _TURN * (radius * per_row) + 0.1 * bulge_r",
        "reach_r = 0.0",
        "legs: terrain",
    ),
    Mutant(
        "bent grids taken for straight",
        terrain_bounds,
        "bulge_r = 0.25 * p.bend[0] * size2 + 1e-9\n        bulge_c = 0.25 * p.bend[1] * size2 + 1e-9",
        "bulge_r = 1e-9\n        bulge_c = 1e-9",
        "legs: terrain",
        120,
    ),
    Mutant(
        "no overshoot between samples", terrain_bounds, "_OVERSHOOT = 0.28125", "_OVERSHOOT = 0.0", "legs: terrain", 80
    ),
    Mutant(
        "terrain below the line alone",
        clearance,
        "low = least_heights(space.terrain, bounds, pieces, radius_m, 1.0, never)",
        "low = least_heights(space.terrain, bounds, pieces, 0.0 * radius_m, 1.0, never)",
        "legs: terrain",
    ),
    Mutant(
        "judged by the line alone",
        clearance,
        "found = least_heights(space.terrain, bounds, pieces, radius_m, sign, need_m)[:, 0]",
        "found = least_heights(space.terrain, bounds, pieces, 0.0 * radius_m, sign, need_m)[:, 0]",
        "legs: terrain",
    ),
    Mutant(
        "obstacles as far as from the line",
        clearance,
        "obstacle_m=table[:, kernels.OBSTACLE] - radius_m",
        "obstacle_m=table[:, kernels.OBSTACLE]",
        "legs: obstacle",
    ),
    Mutant(
        "fence as far as from the line",
        clearance,
        "fence_m=table[:, kernels.FENCE] - radius_m",
        "fence_m=table[:, kernels.FENCE]",
        "legs: fence",
    ),
    Mutant(
        "outside of the fence",
        kernels,
        "d = min(d, -polygon_distance(space.fence,",
        "d = min(d, polygon_distance(space.fence,",
        "legs: fence",
    ),
    Mutant(
        "notches taken for convex",
        kernels,
        "if o.kind[i] == PRISM and o.params[i, 2] == 0.0:",
        "if o.kind[i] == PRISM and o.params[i, 2] == 7.0:",
        "legs: obstacle",
        120,
    ),
    Mutant(
        "cables without thickness",
        kernels,
        "return math.sqrt(dx * dx + dy * dy + dz * dz) - cable_radius",
        "return math.sqrt(dx * dx + dy * dy + dz * dz)",
        "legs: obstacle",
    ),
    Mutant(
        "above home read as above the sea",
        sorties,
        "return item.z if amsl else float(self.home_m[2]) + item.z",
        "return item.z",
        "fleets: items",
    ),
    Mutant(
        "above the sea read as above home",
        sorties,
        "return item.z if amsl else float(self.home_m[2]) + item.z",
        "return float(self.home_m[2]) + item.z",
        "fleets: items",
    ),
    Mutant(
        "separation without errors",
        proof,
        "return scene.mission.fleet.separation_m + one.off_prediction_m + other.off_prediction_m",
        "return scene.mission.fleet.separation_m",
        "fleets: separation",
    ),
    Mutant(
        "late, but never early",
        timing,
        "    if abs(low) >= enough:\n        return abs(low), math.inf\n",
        "    if low < 0.0:\n        return math.inf, math.inf\n"
        "    if abs(low) >= enough:\n        return abs(low), math.inf\n",
        "fleets: lateness",
        60,
    ),
    Mutant(
        "stops at once",
        returns,
        "stop = p[:, :2] + distance[:, np.newaxis] * heading",
        "stop = p[:, :2].copy()",
        "fleets: return",
        60,
    ),
    Mutant(
        "all return at their own least heights",
        returns,
        "zip(self._staggered(tuple(alts)), self._tracks, self._fixed, strict=True)",
        "zip(alts, self._tracks, self._fixed, strict=True)",
        "fleets: chosen return heights",
        60,
    ),
]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
def test_each_mistake_is_found(mutant: Mutant, monkeypatch: pytest.MonkeyPatch) -> None:
    INSTALL[mutant.module](monkeypatch, built(mutant, monkeypatch))
    trials = worlds_of_legs(mutant.tries) if mutant.found_by.startswith("legs") else fleets(mutant.tries)
    try:
        found = next((tally.violations for tally in trials if falls(tally, mutant)), [])
    finally:
        proof_worlds.real_land.cache_clear()
    assert found, f"not found in {mutant.tries} trials: {mutant.name}"


def falls(tally: Tally, mutant: Mutant) -> bool:
    return any(f"{v.trial}: {v.of}".startswith(mutant.found_by) for v in tally.violations)


def built(mutant: Mutant, monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """Return the module with the mistake in it, compiled anew and nowhere cached."""
    assert mutant.module.__file__ is not None
    source = Path(mutant.module.__file__).read_text(encoding="utf-8")
    assert source.count(mutant.right) == 1, f"expected once in {mutant.module.__name__}: {mutant.right}"
    source = source.replace(mutant.right, mutant.wrong)
    source = source.replace("@kernel\n", "@_uncached\n").replace("cache=True", "cache=False")
    name = f"mutant_of_{mutant.module.__name__.rpartition('.')[2]}"
    module = types.ModuleType(name)
    module.__dict__["_uncached"] = njit(error_model="numpy")
    monkeypatch.setitem(sys.modules, name, module)
    exec(compile(source, "<mutant>", "exec"), module.__dict__)
    return module
