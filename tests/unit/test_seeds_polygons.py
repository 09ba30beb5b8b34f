"""First guesses past many solids, finely drawn polygons, and such that reach around the path."""

import math
import tracemalloc

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from missionplanner.kernels import obstacle_distances
from missionplanner.obstacles import CylinderSolid, PrismSolid, Solid
from missionplanner.roadmap import _rings, shortest_way
from missionplanner.seeds import first_guesses
from missionplanner.taut import Rules
from tests.laws.test_near_solids_laws import every
from tests.oracles.tangent_graph import shortest_m
from tests.unit.test_seeds import EAST, WEST, check, length_m, limits, space

MARGIN_M = 10.0
ENDS = np.array([WEST, EAST])


def disc(x: float, y: float, radius_m: float, corners: int) -> PrismSolid:
    angle = math.tau * np.arange(corners) / corners
    return PrismSolid("disc", np.stack([x + radius_m * np.cos(angle), y + radius_m * np.sin(angle)], axis=1))


def test_memory_does_not_grow_with_the_square_of_the_corners() -> None:
    rng = np.random.default_rng(1)
    many = space(*(disc(x, y, 20.0, 120) for x, y in rng.uniform(-380.0, 380.0, (60, 2)))).obstacles
    tracemalloc.start()
    points = _rings(many, ENDS, MARGIN_M, 2400.0, 0.3)[0]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(points) < 60_000
    assert peak < 20e6  # all pairs of 7,200 corners are 400 MB


def test_corners_of_one_disc_leave_no_gaps() -> None:
    few, many = (_rings(space(disc(0.0, 0.0, 40.0, n)).obstacles, ENDS, MARGIN_M, 2400.0, 0.3)[0] for n in (12, 120))
    assert len(many) == 10 * len(few)  # as many around every corner


def test_past_a_finely_drawn_disc_the_path_is_as_short_as_past_a_round_one() -> None:
    where, rules = space(disc(0.0, 15.0, 60.0, 240)), limits(60.0, MARGIN_M)
    [path] = first_guesses(where, rules, WEST, EAST)
    check(where, rules, [path], WEST, EAST)
    shortest = shortest_m((-400.0, 0.0), (400.0, 0.0), [(0.0, 15.0, 60.0 + MARGIN_M)])
    assert abs(length_m(path) / shortest - 1.0) < 2e-4


def test_no_ring_stands_around_a_corner_that_points_inwards() -> None:
    outline = np.array([[0, 0], [100, 0], [100, 100], [50, 60], [0, 100]], dtype=float)
    for xy in (outline, outline[::-1]):
        points = _rings(space(PrismSolid("notch", xy)).obstacles, ENDS, MARGIN_M, 2400.0, 0.3)[0]
        away_m = np.hypot(*(points[:, np.newaxis] - outline).transpose(2, 0, 1)).min(axis=0)
        assert away_m[3] > 30.0
        assert (np.delete(away_m, 3) < MARGIN_M * 1.1).all()


def test_through_the_narrow_mouth_of_a_polygon_a_leg_leads_out() -> None:
    """A mouth 0.4 m wider than both margins, which no grid would meet, between two corners of the same polygon."""
    half_m = MARGIN_M + 0.2
    inner, outer = 120.0, 300.0
    right = [[40, half_m], [0, inner], [-inner, inner], [-inner, 0]]
    bowl = np.array(
        [
            *right,
            *([x, -y] for x, y in right[2:0:-1]),
            *([40, -half_m], [40, -outer], [-outer, -outer], [-outer, outer], [40, outer]),
        ],
        dtype=float,
    )
    start, goal = np.array([-60.0, 60.0, 100.0]), np.array([400.0, 90.0, 100.0])
    where, rules = space(PrismSolid("bowl", bowl)), limits(60.0, MARGIN_M)
    path = first_guesses(where, rules, start, goal)[0]
    check(where, rules, [path], start, goal)
    mouth = np.array([40.0, 0.0, 100.0])
    assert length_m(path) < 1.001 * (np.linalg.norm(mouth - start) + np.linalg.norm(goal - mouth))


def test_the_index_of_solids_changes_no_guess() -> None:
    for seed in range(4):
        rng = np.random.default_rng(seed)
        masts = [
            CylinderSolid("mast", x, y, rng.uniform(1.0, 12.0))
            for x, y in rng.uniform(-900.0, 900.0, (120, 2))
            if min(math.dist((x, y), end[:2]) for end in ENDS) > 40.0
        ]
        where, rules = space(*masts, CylinderSolid("zone", 0.0, 9e4, 8.99e4)), limits(60.0, MARGIN_M)
        assert where.obstacles.grid.large.size == 1
        plain = where._replace(obstacles=every(where.obstacles))
        for one, other in zip(*(first_guesses(w, rules, WEST, EAST, count=2) for w in (where, plain)), strict=True):
            np.testing.assert_array_equal(one, other)


@settings(max_examples=80, deadline=None)
@given(
    solids=st.lists(
        st.one_of(
            st.builds(
                lambda x, y, r: CylinderSolid("mast", x, y, r),
                st.floats(-330.0, 330.0),
                st.floats(-120.0, 120.0),
                st.floats(2.0, 60.0),
            ),
            st.builds(
                disc, st.floats(-330.0, 330.0), st.floats(-120.0, 120.0), st.floats(5.0, 50.0), st.integers(3, 7)
            ),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_a_way_that_only_touches_rings_is_as_short_as_any(solids: list[Solid]) -> None:
    """Between tall solids on level ground, overlapping or not, legs that touch no ring are on no shortest way."""
    where, rules = space(*solids), limits(60.0, MARGIN_M)
    assume((obstacle_distances(where.obstacles, ENDS) > MARGIN_M + 0.1).all())
    flight = Rules(
        height_min_m=20.0,
        height_max_m=math.inf,
        alt_max_m=math.inf,
        obstacle_m=MARGIN_M,
        fence_m=0.0,
        slope_up=math.tan(rules.climb_angle_rad),
        slope_down=math.tan(rules.descent_angle_rad),
        ground_slope=0.0,
    )
    any_, touching = (
        shortest_way(where, flight, WEST, EAST, np.empty((0, 3)), 1600.0, taut=taut) for taut in (False, True)
    )
    assert (any_ is None) == (touching is None)
    if any_ is not None and touching is not None:
        assert length_m(touching) <= length_m(any_) * (1.0 + 1e-4)
