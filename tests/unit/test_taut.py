"""Taut strings against an exact oracle: the tangent visibility graph of discs."""

import math

import numpy as np
import pytest

from missionplanner.clearance import Margins, legs_clear, polyline_legs
from missionplanner.geodesy import FloatArray
from missionplanner.obstacles import CableSolid, CylinderSolid, PrismSolid
from missionplanner.seeds import first_guesses
from missionplanner.taut import Rules, tighten
from tests.oracles.tangent_graph import shortest_m
from tests.unit.test_seeds import (
    CYLINDERS,
    EAST,
    GOAL,
    START,
    WEST,
    box,
    check,
    ground,
    length_m,
    limits,
    mountain,
    space,
)

MARGIN_M = 10.0


def crowd(
    rng: np.random.Generator, count: int, radii_m: tuple[float, float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Discs (N, 3) that leave the ends, (2,) each, clear."""
    discs = np.column_stack([rng.uniform(-450, 450, (count, 2)), rng.uniform(*radii_m, count)])
    start, goal = np.array([-480.0, rng.uniform(-300, 300)]), np.array([480.0, rng.uniform(-300, 300)])
    clear = [np.hypot(*(discs[:, :2] - end).T) > discs[:, 2] + MARGIN_M + 1.0 for end in (start, goal)]
    return discs[clear[0] & clear[1]], start, goal


@pytest.mark.parametrize(("count", "radii_m"), [(8, (10.0, 80.0)), (30, (40.0, 75.0)), (60, (5.0, 45.0))])
def test_among_discs_nearly_all_paths_are_the_shortest_and_none_shorter(
    count: int, radii_m: tuple[float, float]
) -> None:
    rng = np.random.default_rng(count)
    rules, excess = limits(60.0, MARGIN_M), []
    while len(excess) < 20:
        discs, start, goal = crowd(rng, count, radii_m)
        wider = [(x, y, radius + MARGIN_M) for x, y, radius in discs.tolist()]
        level_m = shortest_m(tuple(start), tuple(goal), wider)
        if not math.isfinite(level_m):
            continue
        where = space(*(CylinderSolid("mast", *disc) for disc in discs.tolist()))
        a, b = np.array([*start, 100.0]), np.array([*goal, 160.0])
        path = first_guesses(where, rules, a, b, thorough=True)[0]
        assert legs_clear(where, Margins.of(rules), polyline_legs(path)).all()
        excess.append(length_m(path) / math.hypot(level_m, 60.0) - 1.0)
    assert min(excess) > -1e-7
    assert np.mean(np.array(excess) < 2e-4) >= 0.95


@pytest.mark.parametrize("margin_m", [0.0, 5.0, 10.0, 20.0])
def test_mountain_scene_is_shortest_to_a_ten_thousandth(margin_m: float) -> None:
    level_m = shortest_m((100.0, 20.0), (600.0, 450.0), [(x, y, r + margin_m) for x, y, r in CYLINDERS])
    shortest = math.hypot(level_m, GOAL[2] - START[2])
    for thorough, excess in ((False, 1e-4), (True, 3e-5)):
        [path] = first_guesses(mountain(), limits(60.0, margin_m), START, GOAL, thorough=thorough)
        assert shortest - 1e-6 <= length_m(path) <= shortest * (1.0 + excess)


def test_narrow_gaps_are_no_obstacle() -> None:
    """Two rows of masts whose gaps, 0.4 m beyond both margins, no grid would meet."""
    masts = [
        CylinderSolid("mast", x, y + shift, 30.0)
        for x, shift in ((-60.0, 0.0), (60.0, 40.2))
        for y in np.arange(-1005.0, 1005.0, 80.4)
    ]
    where, rules = space(*masts), limits(60.0, MARGIN_M)
    [path] = first_guesses(where, rules, WEST, EAST)
    discs = [(mast.x, mast.y, mast.radius_m + MARGIN_M) for mast in masts]
    assert length_m(path) <= shortest_m((-400.0, 0.0), (400.0, 0.0), discs) * 1.0002


def test_over_a_long_wall_the_path_bends_at_its_rounded_edges() -> None:
    """A wall 100 m high and 40 m wide with a margin of 10 m: two quarter-like arcs around its upper edges."""
    where = space(PrismSolid("wall", box(-20, -2000, 20, 2000), -math.inf, 200.0), half_m=1000.0)
    rules = limits(80.0, MARGIN_M)
    [path] = first_guesses(where, rules, WEST, EAST, thorough=True)
    to_edge_m = math.hypot(380.0, 100.0)
    tangent_m = math.sqrt(to_edge_m**2 - MARGIN_M**2)
    turn = math.atan2(100.0, 380.0) + math.asin(MARGIN_M / to_edge_m)
    shortest = 2.0 * (tangent_m + MARGIN_M * turn) + 40.0
    check(where, rules, [path], WEST, EAST)
    assert shortest - 1e-4 <= length_m(path) <= shortest * 1.0001


def test_beneath_a_slanting_cable_the_path_is_a_plane_tangent_to_it() -> None:
    """Around a cable level with both ends: in the plane square to it, by symmetry under or over alike."""
    cable = CableSolid("cable", np.array([0.0, -900.0, 100.0]), np.array([0.0, 900.0, 100.0]), 1.0)
    where, rules = space(cable), limits(60.0, MARGIN_M)
    [path] = first_guesses(where, rules, WEST, EAST, thorough=True)
    tangent_m = math.sqrt(400.0**2 - 11.0**2)
    shortest = 2.0 * (tangent_m + 11.0 * math.asin(11.0 / 400.0))
    assert shortest - 1e-4 <= length_m(path) <= shortest * 1.0001


def test_over_a_round_ridge_the_string_touches_the_ground() -> None:
    """A ridge of parabolic section: tangents from both ends, and the parabola's own arc between."""
    x = np.linspace(-1200, 1200, 241)
    ridge = np.broadcast_to(np.maximum(150.0 - x**2 / 400.0, 0.0)[None, :], (241, 241))
    where, rules = space(terrain=ground(ridge)), limits(80.0)
    [path] = first_guesses(where, rules, WEST, EAST, thorough=True)
    # height 20 above the ground: tangent from (-400, 100) to z = 170 - x^2 / 400 touches where z' (x + 400) = z - 100
    touch = -400.0 + math.sqrt(400.0**2 - 400.0 * 70.0)
    dense = np.linspace(touch, -touch, 20_001)
    arc_m = float(np.hypot(np.diff(dense), np.diff(170.0 - dense**2 / 400.0)).sum())
    shortest = 2.0 * math.hypot(touch + 400.0, 170.0 - touch**2 / 400.0 - 100.0) + arc_m
    check(where, rules, [path], WEST, EAST)
    assert abs(length_m(path) / shortest - 1.0) < 2e-4


def test_thorough_paths_are_never_longer() -> None:
    x = np.linspace(-1200, 1200, 241)
    hills = 90.0 * np.sin(x / 90.0)[None, :] * np.cos(x / 120.0)[:, None]
    where, rules = space(CylinderSolid("mast", 0, 20, 60), terrain=ground(hills)), limits(70.0)
    start, goal = WEST * [1, 1, 1.3], EAST * [1, 1, 1.3]
    plain, fine = (first_guesses(where, rules, start, goal, thorough=thorough)[0] for thorough in (False, True))
    check(where, rules, [fine], start, goal)
    assert length_m(fine) <= length_m(plain) * (1.0 + 1e-9)


def test_points_that_are_one_do_no_harm_where_none_can_be_dropped() -> None:
    where = space(CylinderSolid("mast", 0, 20, 60))
    too_steep = Rules(20.0, math.inf, math.inf, 10.0, 0.0, 0.01, 0.01, 0.0)
    corner = np.array([0.0, -80.0, WEST[2] + 50.0])
    way = np.array([WEST, corner, corner, EAST])
    points = np.concatenate([way, np.zeros((60, 3))])
    size = tighten(where, too_steep, np.empty((0, 11)), points, len(way), 0.01)
    assert np.array_equal(points[:size], way)
