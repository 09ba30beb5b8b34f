"""The price of paths: PAPER.md eqs 13 and 20, term by term, in one kernel for a whole population.

Every term is a number without unit, of order one for a path of ordinary badness:

=========== ======= ======================================================================================
term        eq.     what it measures; L is the route's straight length, "/ L" an integral along the path
=========== ======= ======================================================================================
voyage      14      length / L
smooth      11, 12  integral of curvature squared * (20 m)^2 / L (sound reading: the bending energy)
inspection  15      share of the towers' weight not collected; a missed tower costs the more, the further off
radar       17      zones that are not hard: (depth / radius)^2 / L
atmosphere  18      (altitude / 1 km)^2 / L
climb       -       height gained / L, a stand-in for energy
terrain     4       depth below the least height above ground / that height / L; 100 m and more where there is no data
ceiling     4       height above the highest allowed, above ground or sea level / least height / L
obstacle    1, 3    depth within the required distance of cylinders, prisms, cables and hard radar zones / it / L
collision   16      the same for cones (sound reading)
ocean       19      the same for marine hazards (sound reading)
fence       -       the same for fence (sides and top) and area, from the inside
fellows     1, 9    mean depth within the separation of vehicles already planned / it
climb_angle 7       height gained or lost beyond what the steepest path may / L
turn        5, 8    course changes beyond what turn radius and turn angle allow / pi
=========== ======= ======================================================================================

The total is the sum of the terms by their weights (`mission.Weights`); all from terrain on share the weight
``constraint``. Between samples nothing deeper than 0.1 m in an obstacle is missed, however thin it is: depths are taken
as densely as the required distance asks for, and only where there may be any.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING

import numba
import numpy as np

from missionplanner import kernels, price_gradient
from missionplanner.clearance import Margins
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import PriceSettings, SpaceArrays
from missionplanner.mission import Weights
from missionplanner.vehicle import VehicleLimits

if TYPE_CHECKING:  # only named here: the price needs no terrain files
    from missionplanner.scene import Towers

THREADS: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]
"""That share a population: as many as numba would use (environment NUMBA_NUM_THREADS; default: the cores)."""

_ROWS_PER_THREAD = 8
"""Fewer paths than this are not worth a thread's while."""

_STEEPEST_RAD = math.radians(89.9)


@dataclass(frozen=True, slots=True, eq=False)
class CostTerms:
    """The unweighted price of a population, one array (P,) per term, in the order of the kernel's columns."""

    voyage: FloatArray
    smooth: FloatArray
    inspection: FloatArray
    radar: FloatArray
    atmosphere: FloatArray
    climb: FloatArray
    terrain: FloatArray
    ceiling: FloatArray
    obstacle: FloatArray
    collision: FloatArray
    ocean: FloatArray
    fence: FloatArray
    fellows: FloatArray
    climb_angle: FloatArray
    turn: FloatArray

    def items(self) -> Iterator[tuple[str, FloatArray]]:
        """Return the terms with their names."""
        return ((name, getattr(self, name)) for name in TERMS)

    @property
    def violation(self) -> FloatArray:
        """The sum (P,) of what is forbidden; 0 where every limit is kept."""
        violation: FloatArray = np.sum([getattr(self, name) for name in CONSTRAINTS], axis=0)
        return violation


TERMS: tuple[str, ...] = tuple(f.name for f in fields(CostTerms))
CONSTRAINTS: tuple[str, ...] = TERMS[kernels.TERRAIN :]
"""The terms that no flown path may have."""


class Price:
    """What a path of one vehicle costs, for whole populations of sampled paths (P, S, 3).

    Parameters
    ----------
    space
        What stands still.
    limits
        The vehicle's; its margins are widened by its tracking error and by ``clearance_extra_m``.
    route_length_m
        Straight length of the route, by which the price is normalised.
    towers
        To inspect on this path; None: nothing.
    fellows
        Positions (F, N, 3) of vehicles already planned, at N instants evenly spread over the common flight time. This
        vehicle's path is compared at the same shares of its length: all arrive together. Straight motion between.
    separation_m
        Least distance from fellows.
    """

    def __init__(
        self,
        space: SpaceArrays,
        limits: VehicleLimits,
        route_length_m: float,
        weights: Weights,
        towers: Towers | None = None,
        fellows: FloatArray | None = None,
        separation_m: float = 0.0,
        clearance_extra_m: float = 0.0,
    ) -> None:
        margins = Margins.of(limits, clearance_extra_m)
        self.space = space
        self.settings = PriceSettings(
            route_length_m=max(float(route_length_m), 1.0),
            height_min_m=float(margins.height_agl_min_m),
            height_max_m=float(margins.height_agl_max_m),
            alt_max_m=float(margins.alt_amsl_max_m),
            obstacle_m=float(margins.obstacle_m),
            fence_m=float(margins.fence_m),
            climb_slope=math.tan(min(limits.climb_angle_rad, _STEEPEST_RAD)),
            descent_slope=math.tan(min(limits.descent_angle_rad, _STEEPEST_RAD)),
            turn_radius_m=float(limits.turn_radius_m),
            turn_angle_rad=float(limits.turn_angle_rad),
            separation_m=float(separation_m),
            tower_range_m=float(towers.range_m) if towers is not None else 1.0,
            cell_m=_cell_m(space),
        )
        self.weights = np.array([getattr(weights, name, weights.constraint) for name in TERMS], dtype=np.float64)
        # what has no weight need not be looked at
        inspects = towers is not None and weights.inspection > 0.0
        self.tower_tops = _floats(towers.top_m) if towers is not None and inspects else np.empty((0, 3))
        self.tower_weights = _floats(towers.weight) if towers is not None and inspects else np.empty(0)
        self.fellows = _floats(fellows) if fellows is not None else np.empty((0, 0, 3))

    def terms(self, paths: FloatArray) -> CostTerms:
        """Return every term (P,) of paths (P, S, 3), S >= 2; inf for paths with NaN."""
        return CostTerms(*np.ascontiguousarray(self._table(paths).T))

    def total(self, paths: FloatArray, threads: int = THREADS) -> FloatArray:
        """Return the weighted sum (P,) of the terms of paths (P, S, 3)."""
        total: FloatArray = self._table(paths, threads) @ self.weights
        return np.where(np.isnan(total), np.inf, total)

    def weighted(self, paths: FloatArray) -> dict[str, FloatArray]:
        """Return the weighted terms, each (P,), by name; they sum to :meth:`total`."""
        table = self._table(paths) * self.weights
        return {name: table[:, k] for k, name in enumerate(TERMS)}

    def straight(self, route_m: FloatArray) -> float:
        """Return the price of flying straight from point to point of a route (R, 3): no path costs less.

        But for what all paths pay alike, as where a route's points themselves lie in a zone.
        """
        rise_m = np.maximum(np.diff(route_m[:, 2]), 0.0).sum()
        way_m = np.linalg.norm(np.diff(route_m, axis=0), axis=1).sum()
        per_m = self.weights[[kernels.VOYAGE, kernels.CLIMB]] / self.settings.route_length_m
        return float(per_m @ [way_m, rise_m])

    def slopes(self, paths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the weighted sums (P,) of finite paths (P, S, 3) and their derivatives (P, S, 3) by every sample.

        Exact, but where the price has kinks (see :mod:`.price_gradient`): there they are one-sided.
        """
        population = _floats(paths)
        table, slopes = np.empty((len(population), kernels.PRICE_COLUMNS)), np.empty(population.shape)
        price_gradient.price_slopes(
            population,
            self.space,
            self.settings,
            self.tower_tops,
            self.tower_weights,
            self.fellows,
            self.weights,
            table,
            slopes,
        )
        return table @ self.weights, slopes

    def _table(self, paths: FloatArray, threads: int = THREADS) -> FloatArray:
        """Return the terms (P, PRICE_COLUMNS), the population shared by threads."""
        population = _floats(paths)
        table = np.empty((len(population), kernels.PRICE_COLUMNS))

        def price(part: slice) -> None:
            kernels.price_paths(
                population[part],
                self.space,
                self.settings,
                self.tower_tops,
                self.tower_weights,
                self.fellows,
                table[part],
            )

        threads = min(threads, len(population) // _ROWS_PER_THREAD)
        if threads > 1:
            edges = np.linspace(0, len(population), threads + 1).astype(int)
            others = [_threads().submit(price, slice(a, b)) for a, b in pairwise(edges[1:])]
            price(slice(0, edges[1]))
            for other in others:
                other.result()
        else:
            price(slice(0, len(population)))
        return table


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, THREADS - 1), thread_name_prefix="price")


if hasattr(os, "register_at_fork"):  # a forked child has none of its parent's threads
    os.register_at_fork(after_in_child=_threads.cache_clear)


def _floats(values: FloatArray) -> FloatArray:
    return np.ascontiguousarray(values, dtype=np.float64)


def _cell_m(space: SpaceArrays) -> float:
    """Return the terrain grid's spacing (geometric mean of both directions)."""
    a = space.terrain.to_cell
    return 1e4 / math.sqrt(abs(float(a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1])))
