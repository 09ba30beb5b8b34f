from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from missionplanner.cost import Price
from missionplanner.mission import Weights
from missionplanner.obstacles import CylinderSolid
from missionplanner.path import basis, length_m, uniform_knots
from missionplanner.polish import FULL, polish
from tests.benchmarks.price_kernel import mountain_case
from tests.limits import limits
from tests.unit.test_cost import flat_space

LIMITS = limits(terrain_margin_m=18.0, obstacle_margin_m=8.0, height_agl_max_m=122.0)
CONTROLS = 24
BASIS = basis(uniform_knots(CONTROLS), np.linspace(0.0, 1.0, 120))
FREEDOM = BASIS[:, 1:-1]


def around(bow_m, height_m=50.0):
    """A curve of 400 m that goes around the middle by ``bow_m``."""
    x = np.linspace(-200.0, 200.0, CONTROLS)
    return BASIS @ np.stack([x, bow_m * np.cos(x * math.pi / 400.0), np.full(CONTROLS, height_m)], axis=1)


def price(*solids, weights=None, **settings):
    return Price(flat_space(*solids), LIMITS, 400.0, weights or Weights(), **settings)


def test_around_a_mast_it_is_the_taut_string():
    # tangents to a circle of 30 m (10 m of mast, 10 m of margin and of tube), and the arc between them
    mast = CylinderSolid("mast", 0.0, 0.0, 20.0, 500.0)
    free = price(mast, weights=Weights(smooth=0.0, climb=0.0))
    radius_m = 20.0 + free.settings.obstacle_m
    taut_m = 2.0 * math.sqrt(200.0**2 - radius_m**2) + radius_m * 2.0 * math.asin(radius_m / 200.0)
    result = polish(free, around(80.0), FREEDOM)
    assert float(free.terms(result.path_m[None]).violation[0]) < 1e-6
    assert taut_m <= float(length_m(result.path_m)) + 0.02
    assert float(length_m(result.path_m)) == pytest.approx(taut_m, rel=5e-4)


def test_without_limits_in_reach_it_is_what_another_minimiser_finds():
    zone = price(weights=Weights(smooth=3.0, atmosphere=20.0))
    start = around(60.0, 90.0)

    def cost(x):
        total, slope = zone.slopes((start + FREEDOM @ x.reshape(-1, 3))[None])
        return total[0], (FREEDOM.T @ slope[0]).ravel()

    low = zone.settings.height_min_m
    peer = minimize(cost, np.zeros(3 * FREEDOM.shape[1]), jac=True, method="L-BFGS-B", options={"maxiter": 3000})
    mine = polish(zone, start, FREEDOM)
    assert mine.path_m[:, 2].min() >= low - 1e-3
    assert mine.cost <= peer.fun + 1e-4
    assert mine.evaluations < peer.nfev


def test_what_violates_a_limit_is_brought_back_inside():
    low = price()
    under = around(0.0, 50.0)
    under[40:80, 2] = 12.0
    assert low.total(under[None])[0] > 1.5
    result = polish(low, under, FREEDOM)
    assert result.cost < low.total(under[None])[0]
    steep = price(weights=Weights())
    climbing = BASIS @ np.stack(
        [np.linspace(0, 150, CONTROLS), np.zeros(CONTROLS), np.linspace(30, 110, CONTROLS)], axis=1
    )
    result = polish(steep, climbing, FREEDOM)
    assert result.cost <= steep.total(climbing[None])[0]


def test_multipliers_place_the_path_where_a_fixed_weight_leaves_it_inside():
    mast = CylinderSolid("mast", 0.0, 0.0, 20.0, 500.0)
    free = price(mast, weights=Weights(smooth=0.0))
    soft = FULL._replace(penalty=3.0)
    fixed = polish(free, around(80.0), FREEDOM, soft._replace(rounds=1, steps=300))
    adaptive = polish(free, around(80.0), FREEDOM, soft)
    assert adaptive.cost < fixed.cost


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 200.0))
def test_no_path_becomes_dearer_and_chance_has_no_part(seed, rough_m):
    case = mountain_case(population=4)
    dear = case.price()
    path = case.paths[0] + FREE_ENDS @ np.random.default_rng(seed).normal(0.0, rough_m, (10, 3))
    free = FREE_ENDS
    one, other = polish(dear, path, free), polish(dear, path, free)
    assert one.cost <= dear.total(path[None])[0]
    assert one.cost == pytest.approx(dear.total(one.path_m[None])[0], rel=1e-12)
    np.testing.assert_array_equal(one.path_m, other.path_m)
    np.testing.assert_allclose(one.path_m[[0, -1]], path[[0, -1]], atol=1e-9)
    assert one.evaluations == other.evaluations


FREE_ENDS = basis(uniform_knots(12), np.linspace(0.0, 1.0, 240))[:, 1:-1]
