import math
from itertools import pairwise

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from missionplanner.errors import InfeasibleError
from missionplanner.kernels import obstacle_distances, terrain_heights
from missionplanner.obstacles import CableSolid, CurtainSolid, CylinderSolid, PrismSolid, Solid, SphereSolid
from missionplanner.seeds import first_guesses
from tests.unit.test_seeds import box, ground, length_m, limits, space

near = st.floats(-450, 450)
size = st.floats(2, 120)
top = st.one_of(st.just(math.inf), st.floats(30, 250))
solid = st.one_of(
    st.builds(lambda x, y, r, t: CylinderSolid("mast", x, y, r, t), near, near, size, top),
    st.builds(lambda x, y, z, r: SphereSolid("dome", x, y, z, r, "radar"), near, near, st.floats(0, 200), size),
    st.builds(
        lambda x, y, a, b, t: PrismSolid("zone", box(x - a, y - b, x + a, y + b), -math.inf, t),
        near,
        near,
        size,
        size,
        top,
    ),
    st.builds(
        lambda x, y, z, u, v, w: CableSolid("cable", np.array([x, y, z]), np.array([u, v, w]), 1.0),
        *(near, near, st.floats(20, 200), near, near, st.floats(20, 200)),
    ),
    st.builds(
        lambda x, y, z, u, v, w: CurtainSolid("span", np.array([x, y, z]), np.array([u, v, w]), 3.0),
        *(near, near, st.floats(20, 100), near, near, st.floats(20, 100)),
    ).filter(lambda span: math.dist(span.start[:2], span.end[:2]) > 1.0),
)
hills = st.builds(
    lambda height, phase: height * np.sin(np.linspace(0, 30, 241) + phase)[:, None] * np.cos(np.linspace(0, 25, 241)),
    st.floats(0, 80),
    st.floats(0, 6),
)


@settings(max_examples=60, deadline=None)
@given(
    solids=st.lists(solid, max_size=8),
    height=hills,
    ends=st.tuples(near, near, st.floats(21, 120), near, near, st.floats(21, 120)),
    angle_deg=st.sampled_from([8.0, 20.0, 45.0, 70.0]),
    count=st.integers(1, 4),
)
def test_every_guess_is_clear_between_its_samples(
    solids: list[Solid], height: np.ndarray, ends: tuple[float, ...], angle_deg: float, count: int
) -> None:
    """Judged by plain dense sampling, 0.25 m apart; and no path is shorter than straight or as steep as allowed."""
    where, rules = space(*solids, terrain=ground(height)), limits(angle_deg)
    start, goal = np.array(ends[:3]), np.array(ends[3:])
    for end in (start, goal):
        end[2] += terrain_heights(where.terrain, end[None, :2])[0]
    assume((obstacle_distances(where.obstacles, np.array([start, goal])) > 10.01).all())
    try:
        guesses = first_guesses(where, rules, start, goal, count=count)
    except InfeasibleError:
        # Walls all round an end can do this; without solids nothing can.
        assert solids
        return
    assert 1 <= len(guesses) <= count
    rise = abs(goal[2] - start[2])
    least_m = max(float(np.linalg.norm(goal - start)), rise / math.sin(math.radians(angle_deg)))
    lengths = [length_m(path) for path in guesses]
    assert lengths == sorted(lengths)
    assert lengths[0] > least_m - 1e-6
    for path in guesses:
        np.testing.assert_array_equal(path[[0, -1]], [start, goal])
        for a, b in pairwise(path):
            dense = np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / 0.25))
            assert (dense[:, 2] - terrain_heights(where.terrain, dense[:, :2])).min() > 20.0 - 0.01
            assert obstacle_distances(where.obstacles, dense).min(initial=math.inf) > 10.0 - 1e-3
            assert abs(b[2] - a[2]) <= math.tan(math.radians(angle_deg)) * math.hypot(*(b - a)[:2]) + 1e-6


@settings(max_examples=20, deadline=None)
@given(
    solids=st.lists(solid, max_size=4),
    shift=st.tuples(st.integers(-100, 100), st.integers(-100, 100)),
    angle_deg=st.sampled_from([20.0, 60.0]),
)
def test_the_way_back_is_about_as_long(solids: list[Solid], shift: tuple[int, int], angle_deg: float) -> None:
    where, rules = space(*solids), limits(angle_deg)
    start, goal = np.array([-480.0 + shift[0], shift[1], 60.0]), np.array([480.0, -shift[1], 90.0])
    assume((obstacle_distances(where.obstacles, np.array([start, goal])) > 10.01).all())
    there, back = (first_guesses(where, rules, a, b, count=3) for a, b in ((start, goal), (goal, start)))
    np.testing.assert_allclose(length_m(there[0]), length_m(back[0]), rtol=0.1)
