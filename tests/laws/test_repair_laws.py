"""Whatever is repaired holds, by other judges too; nothing is moved without need, nor further than needed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from missionplanner import kernels
from missionplanner.clearance import legs_within_angles, polyline_legs, tubes_clear
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Mission
from missionplanner.repair import ROOM_M, least_moves, repair
from missionplanner.scene import Scene, build_check_scene
from missionplanner.sortie import Leg, Sortie
from tests.scenes import at, copter, question

AREA = {"south_west": at(-500, -500), "north_east": at(1100, 500)}
LOWEST_M = 100.0 + 20.0 + 5.0  # level ground, margin, tube
APART_M = 10.0 + 5.0


def scene(*obstacles: dict[str, Any], terrain: dict[str, Any] | None = None, **vehicle: Any) -> Scene:
    ground = terrain or {"kind": "flat", "alt_amsl_m": 100}
    named = [{"name": f"thing-{k}", **obstacle} for k, obstacle in enumerate(obstacles)]
    data = question(copter("alpha", (0, 0), (600, 0), **vehicle), area=AREA, terrain=ground, obstacles=named)
    return build_check_scene(Mission.model_validate(data), Path(), [])


def sortie(ends: FloatArray) -> Sortie:
    legs = [Leg(1 + k, "straight" if k else "takeoff", end, 5.0) for k, end in enumerate(ends)]
    home = np.array([ends[0, 0], ends[0, 1], 100.0])
    return Sortie("alpha", 1, "ardupilot", "copter", home, tuple(legs), "loiter", len(legs), 0.0, 15.0)


def ends_of(flown: Sortie) -> FloatArray:
    return np.array([leg.end_m for leg in flown.legs])


def cylinder(x: float, y: float, radius: float, top: float | None) -> dict[str, Any]:
    height = {} if top is None else {"top_height_agl_m": top}
    return {"kind": "cylinder", "center": at(x, y), "radius_m": radius, **height}


def zone(x: float, y: float, width: float, depth: float, turn: float) -> dict[str, Any]:
    corners = [(-width, -depth), (width, -depth), (width, depth), (-width, depth)]
    c, s = math.cos(turn), math.sin(turn)
    return {"kind": "no_fly", "polygon": [at(x + c * a - s * b, y + s * a + c * b) for a, b in corners]}


def near(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False).map(lambda value: round(value, 2))


obstacles = st.lists(
    st.one_of(
        st.builds(cylinder, near(80, 900), near(-150, 150), near(1, 30), st.none() | near(5, 90)),
        st.builds(zone, near(150, 800), near(-150, 150), near(10, 60), near(10, 60), near(0, 3)),
    ),
    max_size=3,
)
hills = st.lists(
    st.builds(
        lambda x, y, height, spread: {**at(x, y), "height_m": height, "spread_m": spread},
        near(100, 900),
        near(-200, 200),
        near(1, 120),
        near(40, 150),
    ),
    max_size=2,
)
ways = st.lists(st.tuples(near(40, 250), near(-120, 120), near(105, 200)), min_size=1, max_size=5).map(
    lambda steps: np.array(
        [(0.0, 0.0, 140.0), *((x, y, z) for x, (_, y, z) in zip(np.cumsum([s[0] for s in steps]), steps, strict=True))]
    )
)


def sampled_clear(space: Scene, legs: FloatArray, seed: int) -> bool:
    """Return whether no sample of the legs' tubes breaks a margin: an oracle that knows no bounds."""
    limits, rng = space.tasks[0].limits, np.random.default_rng(seed)
    points = np.concatenate([start + np.linspace(0, 1, 400)[:, None] * (end - start) for start, end in legs])
    off = rng.normal(size=points.shape)
    off *= limits.tube_m / np.linalg.norm(off, axis=1)[:, None]
    off[::3] = [0.0, 0.0, -limits.tube_m]
    tube = points + off
    ground = kernels.terrain_heights(space.space.terrain, np.ascontiguousarray(tube[:, :2]))
    high = bool((tube[:, 2] - ground >= limits.terrain_margin_m - 1e-6).all())
    far = space.obstacles.distance_m(points)
    return high and bool((far >= limits.obstacle_margin_m + limits.tube_m - 1e-3).all())


@given(ways, obstacles, hills, st.sampled_from([{}, {"alt_amsl_max_m": 300}, {"climb": {"angle_max_deg": 30}}]))
@settings(max_examples=60)
def test_what_is_repaired_holds_and_is_not_repaired_again(
    ends: FloatArray, things: list[dict[str, Any]], peaks: list[dict[str, Any]], vehicle: dict[str, Any]
) -> None:
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100, "cell_m": 20, "peaks": peaks} if peaks else None
    space = scene(*things, terrain=terrain, **vehicle)
    given_ = sortie(ends)
    try:
        done = repair(space, [given_])
    except InfeasibleError as error:
        assert "\n" not in str(error)
        assume(False)
    (flown,) = done.sorties
    legs = polyline_legs(ends_of(flown))
    limits = space.tasks[0].limits
    assert tubes_clear(space.space, space.terrain.bounds, limits, legs).all()
    assert legs_within_angles(limits, legs).all()
    assert sampled_clear(space, legs, seed=1)
    np.testing.assert_array_equal(flown.legs[0].end_m[:2], given_.home_m[:2])
    # what holds is returned as it is
    again = repair(space, [flown])
    assert again.moves == ()
    assert again.sorties == (flown,)
    changed = {leg.seq for leg, was in zip(flown.legs, given_.legs, strict=True) if (leg.end_m != was.end_m).any()}
    assert {move.seq for move in done.moves} == changed


def one_constraint(share: float, short_m: float) -> float:
    """Return the length of the least moves of two ends that bring a place at a share between them further."""
    return short_m / math.hypot(share, 1.0 - share)


@given(near(0.05, 0.95), near(0.5, 12.0), st.booleans())
@settings(max_examples=40)
def test_one_mast_beside_one_leg_moves_its_ends_by_the_least_there_is(share: float, short_m: float, left: bool) -> None:
    side = 1.0 if left else -1.0
    y = side * (3.0 + APART_M - short_m)
    space = scene(cylinder(200 + 500 * share, y, 3.0, None))
    before = np.array([(0, 0, 140), (200, 0, 140), (700, 0, 140)], dtype=float)
    # neither end itself is near it, so that it is one constraint
    assume(min(share, 1.0 - share) * 500 > 3.0 + APART_M + 15.0)
    by = ends_of(repair(space, [sortie(before)]).sorties[0]) - before
    least_m = one_constraint(share, short_m)
    assert np.linalg.norm(by) == pytest.approx(least_m, abs=1.5 * ROOM_M + 0.02 * least_m)
    shares = np.array([1.0 - share, share]) * least_m / math.hypot(share, 1.0 - share)
    np.testing.assert_allclose(by[1:, 1], -side * shares, atol=0.2)  # trifles are left out


@given(near(0.1, 0.9), near(0.5, 30.0))
@settings(max_examples=40)
def test_one_cable_below_one_leg_lifts_its_ends_by_the_least_there_is(share: float, short_m: float) -> None:
    x, z = 200 + 500 * share, 180.0 - APART_M - 0.5 + short_m
    cable = {"kind": "cable", "start": at(x, -450, amsl=z), "end": at(x, 450, amsl=z), "radius_m": 0.5}
    space = scene(cable)
    before = np.array([(0, 0, 180), (200, 0, 180), (700, 0, 180)], dtype=float)
    # the way out is up, and neither end is near it
    assume(short_m < APART_M and min(share, 1.0 - share) * 500 > 40.0)
    by = ends_of(repair(space, [sortie(before)]).sorties[0]) - before
    least_m = one_constraint(share, short_m)
    assert np.linalg.norm(by) == pytest.approx(least_m, abs=1.5 * ROOM_M + 0.02 * least_m)


@given(near(105.0, LOWEST_M - 0.5), near(130.0, 160.0))
@settings(max_examples=20)
def test_a_waypoint_too_low_over_level_ground_is_lifted_to_its_margin(low: float, other: float) -> None:
    space = scene()
    before = np.array([(0, 0, 140), (300, 0, low), (600, 100, other)], dtype=float)
    by = ends_of(repair(space, [sortie(before)]).sorties[0]) - before
    np.testing.assert_allclose(by[1], [0, 0, LOWEST_M - low], atol=0.1 + ROOM_M)
    assert not by[[0, 2]].any()  # by nothing at all


FOOT_OF_A_HILL = np.array([(0, 0, 140), (40, 0, 105), (80, 0, 105)], dtype=float)


@given(ways, hills, near(1.0, 30.0), st.integers(1, 5))
@example(FOOT_OF_A_HILL, [{**at(100, 0), "height_m": 24.0, "spread_m": 45.0}], 12.0, 1)
@settings(max_examples=30)
def test_waypoints_pushed_down_come_back_by_no_more_than_the_push(
    ends: FloatArray, peaks: list[dict[str, Any]], down_m: float, which: int
) -> None:
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100, "cell_m": 20, "peaks": peaks} if peaks else None
    space = scene(terrain=terrain)
    try:
        (sound,) = repair(space, [sortie(ends)]).sorties
    except InfeasibleError:
        assume(False)
    low = ends_of(sound)
    low[min(which, len(low) - 1), 2] -= down_m
    by = ends_of(repair(space, [sortie(low)]).sorties[0]) - low
    # undoing the push is one repair, so the least is no longer; of every waypoint the bounds are known within 0.1 m
    assert np.linalg.norm(by) <= down_m + (0.1 + 2.0 * ROOM_M) * math.sqrt(len(low))


@given(st.integers(0, 10_000), st.integers(1, 6), st.integers(1, 8))
@settings(max_examples=60)
def test_least_moves_are_those_of_a_general_optimiser(seed: int, wide: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    rows, least = rng.normal(size=(count, wide)), rng.normal(size=count) * 10.0
    found = least_moves(rows, least)
    oracle = minimize(
        lambda x: 0.5 * x @ x,
        rng.normal(size=wide),
        jac=lambda x: x,
        constraints={"type": "ineq", "fun": lambda x: rows @ x - least, "jac": lambda x: rows},
        method="SLSQP",
        options={"maxiter": 500, "ftol": 1e-12},
    )
    feasible = oracle.success and bool((rows @ oracle.x >= least - 1e-5).all())
    if found is None:
        assert not feasible or np.linalg.norm(oracle.x) > 1e4
    else:
        assert (rows @ found >= least - 1e-4).all()
        if feasible:
            assert np.linalg.norm(found) <= np.linalg.norm(oracle.x) + 1e-3
