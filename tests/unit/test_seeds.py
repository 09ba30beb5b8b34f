import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionplanner.clearance import Margins, legs_clear, legs_within_angles, polyline_legs
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays, TerrainArrays, obstacle_distances, terrain_height
from missionplanner.mission import load_mission
from missionplanner.obstacles import CableSolid, CylinderSolid, PrismSolid, Solid, SphereSolid, pack
from missionplanner.scene import build_scene
from missionplanner.seeds import first_guesses
from missionplanner.vehicle import VehicleLimits
from tests import limits as test_limits

CYLINDERS = [  # PAPER.md section 6
    *((10, 35, 5), (100, 150, 10), (150, 360, 10), (210, 100, 10), (300, 160, 20), (390, 200, 15), (390, 350, 15)),
    *((460, 400, 30), (500, 350, 20), (600, 400, 20), (400, 250, 20)),
]
START, GOAL = np.array([100.0, 20.0, 1500.0]), np.array([600.0, 450.0, 2000.0])
WEST, EAST = np.array([-400.0, 0.0, 100.0]), np.array([400.0, 0.0, 100.0])


def limits(
    angle_deg: float = 60.0,
    margin_m: float = 10.0,
    *,
    descent_deg: float | None = None,
    agl_max_m: float = math.inf,
    alt_max_m: float = math.inf,
) -> VehicleLimits:
    return test_limits.limits(
        climb_angle_rad=math.radians(angle_deg),
        descent_angle_rad=math.radians(angle_deg if descent_deg is None else descent_deg),
        obstacle_margin_m=margin_m,
        tracking_error_m=0.0,
        height_agl_max_m=agl_max_m,
        alt_amsl_max_m=alt_max_m,
    )


def ground(height: FloatArray | float, cell_m: float = 10.0, half_m: float = 1200.0) -> TerrainArrays:
    """A local grid centred on the origin; ``height`` (R, C) with rows from south to north, or one number."""
    n = int(2 * half_m / cell_m) + 1
    to_cell = np.zeros((2, 10))
    to_cell[:, 0] = half_m / cell_m
    to_cell[1, 1] = to_cell[0, 2] = 1e4 / cell_m
    return TerrainArrays(np.ascontiguousarray(np.broadcast_to(height, (n, n)), dtype=np.float32), to_cell)


def space(
    *solids: Solid,
    terrain: TerrainArrays | None = None,
    fence: FloatArray | None = None,
    top_m: float = math.inf,
    half_m: float = 1000.0,
) -> SpaceArrays:
    return SpaceArrays(
        ground(0.0) if terrain is None else terrain,
        pack(solids).arrays,
        np.zeros((0, 2)) if fence is None else fence,
        top_m,
        np.array([-half_m, -half_m, half_m, half_m]),
    )


def mountain() -> SpaceArrays:
    solids = [CylinderSolid(f"mast{n}", *row) for n, row in enumerate(CYLINDERS)]
    return space(*solids, terrain=ground(1000.0))


def box(west: float, south: float, east: float, north: float) -> FloatArray:
    return np.array([[west, south], [east, south], [east, north], [west, north]], dtype=float)


def length_m(path: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def check(
    where: SpaceArrays, rules: VehicleLimits, guesses: list[FloatArray], start: FloatArray, goal: FloatArray
) -> None:
    assert guesses
    for path in guesses:
        np.testing.assert_array_equal(path[[0, -1]], [start, goal])
        legs = polyline_legs(path)
        assert legs_clear(where, Margins.of(rules), legs, 0.2).all()
        assert legs_within_angles(rules, legs, 1e-9).all()
    lengths = [length_m(path) for path in guesses]
    assert lengths == sorted(lengths)


@pytest.mark.parametrize(
    ("margin_m", "optimum_m", "excess_m"),
    [(0.0, 827.904, 0.1), (5.0, 828.333, 0.1), (10.0, 839.680, 0.2), (20.0, 850.9, 1.0)],
)
def test_mountain_scene_is_nearly_shortest(margin_m: float, optimum_m: float, excess_m: float) -> None:
    """Optima by tangent visibility graph (PEERS.md), levelled out: one vehicle, eleven cylinders."""
    where, rules = mountain(), limits(60.0, margin_m)
    guesses = first_guesses(where, rules, START, GOAL, count=4)
    check(where, rules, guesses, START, GOAL)
    assert optimum_m - 0.1 < length_m(guesses[0]) < optimum_m + excess_m


@pytest.mark.parametrize("angle_deg", [37.0, 30.0, 20.0, 12.0, 5.0])
def test_climb_limit_makes_detours_no_longer_than_needed(angle_deg: float) -> None:
    where, rules = mountain(), limits(angle_deg)
    guesses = first_guesses(where, rules, START, GOAL, count=2)
    check(where, rules, guesses, START, GOAL)
    least_m = max(839.680, 500.0 / math.sin(math.radians(angle_deg)))
    assert length_m(guesses[0]) < 1.02 * least_m


def test_climb_and_descent_have_their_own_limits() -> None:
    where, rules = space(), limits(60.0, descent_deg=6.0)
    high, low = np.array([0.0, 0.0, 400.0]), np.array([500.0, 0.0, 100.0])
    for start, goal, least_m in ((low, high, math.hypot(500, 300)), (high, low, 300 / math.sin(math.radians(6)))):
        guesses = first_guesses(where, rules, start, goal)
        check(where, rules, guesses, start, goal)
        assert least_m - 1e-6 <= length_m(guesses[0]) < 1.02 * least_m


def test_goal_straight_above_start_is_reached_in_a_spiral() -> None:
    where, rules = space(), limits(15.0)
    start, goal = np.array([3.0, 4.0, 50.0]), np.array([3.0, 4.0, 250.0])
    guesses = first_guesses(where, rules, start, goal)
    check(where, rules, guesses, start, goal)
    assert length_m(guesses[0]) < 1.05 * 200 / math.sin(math.radians(15))


def test_clear_straight_leg_is_the_only_guess() -> None:
    guesses = first_guesses(space(CylinderSolid("far", 0, 300, 20)), limits(), WEST, EAST, count=4)
    assert len(guesses) == 1
    np.testing.assert_array_equal(guesses[0], [WEST, EAST])


def test_no_fly_polygon_without_top_is_passed_on_both_sides() -> None:
    where, rules = space(PrismSolid("zone", box(-50, -150, 50, 200))), limits()
    guesses = first_guesses(where, rules, WEST, EAST, count=2)
    check(where, rules, guesses, WEST, EAST)
    sides = [np.sign(path[np.abs(path[:, 1]).argmax(), 1]) for path in guesses]
    assert sides == [-1.0, 1.0]
    to_corner_m = math.hypot(350, 150)
    tangent_m = math.sqrt(to_corner_m**2 - 10**2)
    arc_m = 10 * (math.atan2(150, 350) + math.asin(10 / to_corner_m))
    shortest_m = 2 * (tangent_m + arc_m) + 100
    assert shortest_m - 1e-3 < length_m(guesses[0]) < shortest_m + 0.1


def test_cable_is_passed_over_and_under() -> None:
    cable = CableSolid("cable", np.array([0.0, -900.0, 110.0]), np.array([0.0, 900.0, 110.0]), 1.0)
    where, rules = space(cable), limits()
    guesses = first_guesses(where, rules, WEST, EAST, count=2)
    check(where, rules, guesses, WEST, EAST)
    at_cable = [float(np.interp(0.0, path[:, 0], path[:, 2])) for path in guesses]
    assert at_cable[0] < 99.1
    assert at_cable[1] > 120.9


def test_low_cable_is_overflown_and_high_one_underflown() -> None:
    rules = limits(agl_max_m=90.0)
    for alt_m, over in ((30.0, True), (80.0, False)):
        cable = CableSolid("cable", np.array([0.0, -990.0, alt_m]), np.array([0.0, 990.0, alt_m]), 1.0)
        where, start, goal = space(cable), np.array([-400.0, 0.0, alt_m]), np.array([400.0, 0.0, alt_m])
        guesses = first_guesses(where, rules, start, goal)
        check(where, rules, guesses, start, goal)
        assert (np.interp(0.0, guesses[0][:, 0], guesses[0][:, 2]) > alt_m) == over


def test_dead_end_pocket_is_left_backwards() -> None:
    """A U of walls without top around the start, open only to the west: away from the goal, beyond the first box."""
    walls = [
        PrismSolid("north", box(-900, 60, 60, 80)),
        PrismSolid("south", box(-900, -80, 60, -60)),
        PrismSolid("east", box(60, -80, 80, 80)),
    ]
    where, rules = space(*walls), limits()
    start, goal = np.array([0.0, 0.0, 100.0]), np.array([160.0, 0.0, 100.0])
    guesses = first_guesses(where, rules, start, goal)
    check(where, rules, guesses, start, goal)
    least_m = 2 * math.hypot(905, 40) + 200
    assert least_m - 160 < length_m(guesses[0]) < least_m + 100


def test_narrow_gap_is_found() -> None:
    """A wall across the whole area with one gap of 24 m, 10 m of it on either side taken by the margin."""
    walls = [PrismSolid("a", box(-10, -1000, 10, 200)), PrismSolid("b", box(-10, 224, 10, 1000))]
    where, rules = space(*walls), limits()
    guesses = first_guesses(where, rules, WEST, EAST)
    check(where, rules, guesses, WEST, EAST)
    assert length_m(guesses[0]) < 2 * math.hypot(390, 212) + 25


def test_ridge_is_crossed_at_its_pass_under_a_ceiling() -> None:
    y = np.linspace(-1200, 1200, 241)
    x = y[None, :]
    ridge = 300.0 * np.exp(-((x / 150) ** 2)) * (1 - np.exp(-(((y[:, None] - 400) / 120) ** 2)))
    where, rules = space(terrain=ground(ridge)), limits(alt_max_m=200.0)
    guesses = first_guesses(where, rules, WEST, EAST)
    check(where, rules, guesses, WEST, EAST)
    assert 250 < np.interp(0.0, guesses[0][:, 0], guesses[0][:, 1]) < 400  # the near flank of the pass at y = 400


def test_height_band_over_hills_is_kept() -> None:
    y = np.linspace(-1200, 1200, 241)
    hills = 120.0 * np.cos(y[None, :] / 90) * np.cos(y[:, None] / 120)
    where, rules = space(terrain=ground(hills)), limits(45.0, agl_max_m=60.0)
    start, goal = WEST.copy(), EAST.copy()
    for end in (start, goal):
        end[2] = terrain_height(where.terrain, end[0], end[1]) + 40.0
    check(where, rules, first_guesses(where, rules, start, goal, count=2), start, goal)


def test_soft_zones_are_ignored() -> None:
    zone = SphereSolid("radar", 0, 0, 100, 200, "radar", hard=False)
    assert len(first_guesses(space(zone), limits(), WEST, EAST)[0]) == 2


def test_clearance_extra_is_kept_as_far_as_the_ends_do() -> None:
    mast = CylinderSolid("mast", 0, 0, 20)
    rules = limits()
    [path] = first_guesses(space(mast), rules, WEST, EAST, clearance_extra_m=15.0)
    dense = np.concatenate([np.linspace(a, b, 400) for a, b in pairwise(path)])
    assert np.hypot(dense[:, 0], dense[:, 1]).min() > 45.0 - 1e-3
    near = np.array([-32.0, 0.0, 100.0])  # 12 m from the mast: more than the margin, less than with the extra
    [path] = first_guesses(space(mast), rules, near, EAST, clearance_extra_m=15.0)
    check(space(mast), rules, [path], near, EAST)


def test_clearance_extra_gives_way_where_nothing_else_helps() -> None:
    walls = [PrismSolid("a", box(-10, -1000, 10, 0)), PrismSolid("b", box(-10, 24, 10, 1000))]
    where, rules = space(*walls), limits()
    check(where, rules, first_guesses(where, rules, WEST, EAST, clearance_extra_m=5.0), WEST, EAST)


def test_repeats_itself() -> None:
    one, two = (first_guesses(mountain(), limits(), START, GOAL, count=3) for _ in range(2))
    assert len(one) == len(two)
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def test_guesses_differ() -> None:
    where = mountain()
    guesses = first_guesses(where, limits(), START, GOAL, count=4)
    assert len(guesses) >= 3
    for n, a in enumerate(guesses):
        for b in guesses[n + 1 :]:
            at = np.linspace(100, 600, 50)
            apart = np.abs(np.interp(at, a[:, 0], a[:, 1]) - np.interp(at, b[:, 0], b[:, 1]))
            assert apart.max() > 10.0


def test_real_mountains() -> None:
    """30 m elevation model, legs of 100 m to 8 km between random places 40 m above the ground."""
    mission = Path(__file__).parents[2] / "missions" / "ridge_line.yaml"
    scene = build_scene(load_mission(mission), mission.parent)
    rng = np.random.default_rng(0)
    for reach_m in (100.0, 300.0, 1000.0, 3000.0, 8000.0):
        for _ in range(4):
            rules = limits(rng.choice([15.0, 30.0, 60.0]), agl_max_m=rng.choice([120.0, math.inf]))
            start, goal = _two_places(scene.space, rng, reach_m)
            check(scene.space, rules, first_guesses(scene.space, rules, start, goal, count=2), start, goal)


def _two_places(where: SpaceArrays, rng: np.random.Generator, reach_m: float) -> tuple[FloatArray, FloatArray]:
    west, south, east, north = where.area
    while True:
        a = rng.uniform((west + 50, south + 50), (east - 50, north - 50))
        heading = rng.uniform(0, 2 * math.pi)
        b = a + reach_m * np.array([math.cos(heading), math.sin(heading)])
        if not (west + 50 < b[0] < east - 50 and south + 50 < b[1] < north - 50):
            continue
        ends = np.array([[*p, terrain_height(where.terrain, p[0], p[1]) + 40.0] for p in (a, b)])
        hard = where.obstacles.hard
        if obstacle_distances(where.obstacles, ends)[:, hard].min() > 11.0:
            return ends[0], ends[1]


WALL = PrismSolid("wall", box(-10, -1100, 10, 1100))
LOW_WALL = PrismSolid("wall", box(-10, -1100, 10, 1100), -math.inf, 150.0)


@pytest.mark.parametrize(
    ("solids", "surroundings", "rules", "start_m", "message"),
    [
        ([], {}, limits(), (-400, 0, 19), "start is 19.0 m above the ground, expected at least 20.0 m"),
        (
            [CylinderSolid("mast", -400, 25, 20)],
            {},
            limits(),
            WEST,
            "start is 5.0 m from mast, expected at least 10.0 m",
        ),
        ([CylinderSolid("ring", 400, 0, 60), WALL], {}, limits(), WEST, "goal is -60.0 m from ring, expected at least"),
        (
            [],
            {"half_m": 405.0},
            limits(),
            WEST,
            "start is 5.0 m inside the fence and the area, expected at least 10.0 m",
        ),
        ([], {}, limits(agl_max_m=80.0), WEST, "start is 100.0 m above the ground, expected at most 80.0 m"),
        ([], {}, limits(alt_max_m=99.0), WEST, "start is 100.0 m AMSL, expected at most 99.0 m"),
        ([WALL], {}, limits(), WEST, "no clear way past wall with a margin of 10.0 m"),
        ([LOW_WALL], {}, limits(alt_max_m=140.0), WEST, "no clear way: the height limit is in the way"),
        (
            [CylinderSolid("mast", 0, 0, 20)],
            {"fence": box(-420, -25, 420, 25)},
            limits(),
            WEST,
            "no clear way: the fence is in the way",
        ),
    ],
)
def test_says_what_is_in_the_way(
    solids: list[Solid], surroundings: dict[str, Any], rules: VehicleLimits, start_m: FloatArray, message: str
) -> None:
    names = [solid.name for solid in solids]
    with pytest.raises(InfeasibleError) as caught:
        first_guesses(space(*solids, **surroundings), rules, start_m, EAST, names=names)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_climb_without_room_says_so() -> None:
    """A shaft of 80 m: no spiral fits that climbs 300 m at 1 degree."""
    where = space(fence=box(-450, -15, 450, 15), top_m=700.0)
    start, goal = np.array([-400.0, 0.0, 100.0]), np.array([-390.0, 0.0, 400.0])
    rules = limits(60.0)
    check(where, rules, first_guesses(where, rules, start, goal), start, goal)
    tight = space(fence=box(-412, -12, -378, 12), top_m=700.0)
    with pytest.raises(InfeasibleError, match=r"the straight way needs 88.1 deg, the limit is 1.0 deg"):
        first_guesses(tight, limits(1.0), start, goal)
