from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner import kernels
from missionplanner.cost import Price
from missionplanner.kernels import SpaceArrays
from missionplanner.mission import Weights
from missionplanner.obstacles import pack
from missionplanner.path import basis, evenly, leg_lengths_m, uniform_knots
from tests.benchmarks.price_kernel import LIMITS
from tests.laws.test_kernels_laws import FLAT, point, solid, star

laws = settings(deadline=None, max_examples=80)

OPEN = replace(LIMITS, terrain_margin_m=0.0, tracking_error_m=0.0, height_agl_max_m=math.inf)


def scene(solids, fence=None):
    outline = np.empty((0, 2)) if fence is None else fence
    return SpaceArrays(FLAT, pack(solids).arrays, outline, math.inf, np.array([-900.0, -900.0, 900.0, 900.0]))


curve = (
    st.lists(point, min_size=3, max_size=6)
    .map(lambda points: basis(uniform_knots(len(points)), np.linspace(0.0, 1.0, 40)) @ np.array(points) * [1, 1, 0.5])
    .filter(lambda path: leg_lengths_m(path).min() > 1e-3)
)


@laws
@given(st.lists(solid, max_size=5), st.one_of(st.none(), star()), curve)
def test_terms_are_finite_never_negative_and_backwards_the_same(solids, fence, path):
    price = Price(scene(solids, fence), OPEN, 400.0, Weights())
    there = dict(price.terms(path[np.newaxis]).items())
    back = dict(price.terms(path[np.newaxis, ::-1]).items())
    for name, value in there.items():
        assert math.isfinite(value[0]), name
        assert value[0] >= 0.0, name
        if name not in {"climb", "climb_angle"}:
            np.testing.assert_allclose(value, back[name], rtol=1e-6, atol=1e-9, err_msg=name)


@laws
@given(st.lists(solid, min_size=1, max_size=4), curve, st.floats(0.5, 30.0))
def test_free_means_clear_to_a_decimetre_and_clear_means_free(solids, path, margin_m):
    """No obstacle price: nothing nearer than the margin less 0.1 m, also between samples. Clear: no price."""
    space = scene(solids)
    limits = replace(OPEN, obstacle_margin_m=margin_m)
    terms = Price(space, limits, 400.0, Weights()).terms(path[np.newaxis])
    priced = float(terms.obstacle[0] + terms.collision[0] + terms.ocean[0])
    dense = np.concatenate([a + np.linspace(0, 1, 60)[:, None] * (b - a) for a, b in pairwise(path)])
    least = kernels.obstacle_distances(space.obstacles, dense).min()
    if priced == 0.0:
        assert least >= margin_m - 0.11
    if least > margin_m + leg_lengths_m(path).max() / 60:
        assert priced == 0.0


@laws
@given(st.lists(solid, min_size=1, max_size=4), curve)
def test_a_wider_margin_never_costs_less(solids, path):
    space = scene(solids)
    depth = []
    for extra_m in (0.0, 2.0, 10.0):
        price = Price(space, replace(OPEN, obstacle_margin_m=10.0), 400.0, Weights(), clearance_extra_m=extra_m)
        terms = price.terms(path[np.newaxis])
        scale_m = price.settings.obstacle_m  # the terms are shares of the margin
        depth.append(scale_m * float(terms.obstacle[0] + terms.collision[0] + terms.ocean[0]))
    # depths grow point by point; the points themselves move with the margin, by which an integral may differ a little
    assert depth[0] <= depth[1] * 1.05 + 0.05
    assert depth[1] <= depth[2] * 1.05 + 0.05


@laws
@given(curve, curve, st.floats(1.0, 60.0))
def test_fellows_mind_each_other_alike(mine, theirs, separation_m):
    space = scene([])

    def depth(path, other):
        fellow = evenly(other, 200)[np.newaxis]
        return Price(space, OPEN, 400.0, Weights(), None, fellow, separation_m).terms(path[np.newaxis]).fellows

    np.testing.assert_allclose(depth(mine, theirs), depth(theirs, mine), rtol=0.05, atol=1e-3)
    assert depth(mine, mine)[0] > 0.9
