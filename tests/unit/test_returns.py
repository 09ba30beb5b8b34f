from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from missionplanner.errors import InfeasibleError
from missionplanner.motion.navigator import Navigator
from missionplanner.obstacles import CableSolid, CurtainSolid, CylinderSolid, PrismSolid, SphereSolid
from missionplanner.plan import Trajectory
from missionplanner.returns import Returning, choose_return_heights, prove_returns
from missionplanner.terrain_bounds import pyramid
from tests.returning import flight, model, space_of

NEED_M = 24.0  # 20 m and twice 2 m of tube


def apart_m(i: int, j: int) -> float:
    assert i < j
    return NEED_M


def at_heights(vehicles, heights_m):
    return [
        replace(v, motion=replace(v.motion, return_height_m=height_m))
        for v, height_m in zip(vehicles, heights_m, strict=True)
    ]


def proven(world, vehicles, heights_m) -> dict[str, bool]:
    found = prove_returns(*world, at_heights(vehicles, heights_m), apart_m)
    return {finding.vehicle: finding.proven for finding in found}


def chosen(world, vehicles, fixed=None) -> list[float]:
    heights_m = choose_return_heights(*world, vehicles, apart_m, fixed or [None] * len(vehicles))
    findings = prove_returns(*world, at_heights(vehicles, heights_m), apart_m)
    assert all(f.proven for f in findings), [str(f) for f in findings if not f.proven]
    return heights_m


def around(x: float, y: float, half: float) -> np.ndarray:
    return np.array([[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]])


# out to the north of what stands at (150, 0), and straight home over it
DETOUR = [(0.0, 0.0, 140.0), (0.0, 300.0, 140.0), (300.0, 300.0, 140.0), (300.0, 0.0, 140.0)]


def test_nothing_in_the_way_asks_for_no_more_than_the_default() -> None:
    alpha = flight("alpha", (0, 0), [(0, 0, 140), (300, 0, 140)])
    assert chosen(space_of(), [alpha]) == [15.0]


def test_the_height_over_a_ridge_clears_it_and_one_metre_less_does_not() -> None:
    world = space_of(ridge_m=100.0)
    alpha = flight("alpha", (0, 0), [(0, 0, 230), (300, 0, 230)])
    (height_m,) = chosen(world, [alpha])
    # 100 m of ridge, 10 m of margin, 2 m of tube, 1 m for turning home early
    assert 113.0 <= height_m <= 114.0
    assert not proven(world, [alpha], [height_m - 1.0])["alpha"]
    finding = prove_returns(*world, at_heights([alpha], [60.0]), apart_m)[0]
    assert finding.to == "terrain"
    assert finding.value == pytest.approx(60.0 - 100.0 - 3.0, abs=1.0)
    assert finding.position_m is not None
    assert finding.position_m[0] == pytest.approx(150.0, abs=10.0)


def test_the_whole_tube_counts() -> None:
    world = space_of(ridge_m=100.0)
    narrow = flight("alpha", (0, 0), [(0, 0, 230), (300, 0, 230)])
    wide = replace(narrow, limits=replace(narrow.limits, tracking_error_m=7.0))
    assert chosen(world, [wide])[0] == chosen(world, [narrow])[0] + 5.0


def test_the_height_over_a_mast_is_its_top_and_all_margins() -> None:
    alpha = flight("alpha", (0, 0), DETOUR)
    world = space_of([CylinderSolid("mast", 150.0, 0.0, 3.0, 190.0)])
    # 90 m above home, margin 10 m, tube 2 m, 1 m for turning home early
    (height_m,) = chosen(world, [alpha])
    assert 103.0 <= height_m <= 104.0
    assert not proven(world, [alpha], [102.0])["alpha"]
    finding = prove_returns(*world, at_heights([alpha], [40.0]), apart_m)[0]
    assert (finding.to, finding.proven) == ("mast", False)


def test_a_sphere_is_passed_over_as_low_as_it_allows() -> None:
    alpha = flight("alpha", (0, 0), DETOUR)
    world = space_of([SphereSolid("radar", 150.0, 40.0, 120.0, 80.0, "radar")])
    (height_m,) = chosen(world, [alpha])
    assert not proven(world, [alpha], [height_m - 2.0])["alpha"]
    soft = space_of([SphereSolid("radar", 150.0, 40.0, 120.0, 80.0, "radar", hard=False)])
    assert chosen(soft, [alpha]) == [15.0]


def test_below_a_floor_is_as_good_as_above_a_top() -> None:
    alpha = flight("alpha", (0, 0), DETOUR)
    assert chosen(space_of([PrismSolid("lane", around(150, 0, 30), 190.0, 260.0)]), [alpha]) == [15.0]
    world = space_of([PrismSolid("lane", around(150, 0, 30), 120.0, 260.0)])
    assert 173.0 <= chosen(world, [alpha])[0] <= 174.0


def test_a_no_fly_area_without_top_has_no_height() -> None:
    alpha = flight("alpha", (0, 0), DETOUR)
    world = space_of([PrismSolid("camp", around(150, 0, 30))])
    with pytest.raises(InfeasibleError, match=r"alpha: .* told to at \d+ s, but camp .*direct_return: waived"):
        chosen(world, [alpha])


def test_a_ceiling_above_sea_level_binds() -> None:
    alpha = flight("alpha", (0, 0), DETOUR, alt_amsl_max_m=200.0)
    assert proven(space_of(), [alpha], [97.0])["alpha"]
    assert not proven(space_of(), [alpha], [99.0])["alpha"]
    world = space_of([CylinderSolid("mast", 150.0, 0.0, 3.0, 190.0)])
    with pytest.raises(InfeasibleError, match="alt_amsl_max_m"):
        chosen(world, [alpha])


def test_the_fence_binds_on_the_way_home() -> None:
    # an L: both ends of the way home are inside, its middle is not
    ell = [(-50, -50), (50, -50), (50, 250), (350, 250), (350, 350), (-50, 350)]
    alpha = flight("alpha", (0, 0), [(0, 0, 140), (0, 300, 140), (300, 300, 140)])
    finding = prove_returns(*space_of(fence=ell), [alpha], apart_m)[0]
    assert (finding.to, finding.proven) == ("fence", False)
    with pytest.raises(InfeasibleError, match="fence"):
        chosen(space_of(fence=ell), [alpha])
    square = [(-50, -50), (350, -50), (350, 350), (-50, 350)]
    assert chosen(space_of(fence=square), [alpha]) == [15.0]


def test_it_must_be_able_to_brake() -> None:
    # towards a mast and, by a right angle, past it: only who is told to return just before the corner overshoots it
    way = [(0.0, 0.0, 140.0), (300.0, 0.0, 140.0), (300.0, 100.0, 140.0)]
    mast = CylinderSolid("mast", 325.0, 0.0, 3.0, 150.0)
    slow = flight("alpha", (0, 0), way, speed_m_s=1.0)
    fast = flight("alpha", (0, 0), way, speed_m_s=8.0)
    assert proven(space_of([mast]), [slow], [15.0])["alpha"]
    finding = prove_returns(*space_of([mast]), [fast], apart_m)[0]
    assert not finding.proven
    assert finding.to == "mast"
    assert finding.t_s is not None
    assert finding.t_s == pytest.approx(20.0 + 300.0 / 8.0, abs=3.0)
    with pytest.raises(InfeasibleError, match="mast"):
        chosen(space_of([mast]), [fast])


def test_a_cable_overhead_bars_the_climb() -> None:
    cable = CableSolid("ropeway", np.array([150.0, -200.0, 220.0]), np.array([150.0, 200.0, 220.0]), 3.0)
    below = flight("alpha", (0, 0), [(0, 0, 140), (300, 0, 140)])
    assert proven(space_of([cable]), [below], [50.0])["alpha"]
    assert not proven(space_of([cable]), [below], [150.0])["alpha"]


def test_what_has_a_top_is_not_to_be_given_one() -> None:
    below = flight("alpha", (0, 0), [(0, 0, 140), (300, 0, 140)])
    cable = CableSolid("ropeway", np.array([150.0, -200.0, 220.0]), np.array([150.0, 200.0, 220.0]), 3.0)
    curtain = CurtainSolid("span T1-T2", np.array([150.0, -200.0, 150.0]), np.array([150.0, 200.0, 150.0]), 3.0)
    for solid in (cable, curtain):
        (finding,) = prove_returns(*space_of([solid]), at_heights([below], [150.0]), apart_m)
        assert not finding.proven
        assert "further from it (views.distance_m)" in str(finding)
        assert "a top" not in str(finding)
    area = PrismSolid("camp", around(150, 0, 50), -math.inf, math.inf)
    (finding,) = prove_returns(*space_of([area]), at_heights([below], [150.0]), apart_m)
    assert "give the obstacle a top" in str(finding)


def holding() -> Returning:
    """Return one that flies from its home to the north-east and holds there."""
    return flight("alpha", (0, 0), [(0, 0, 114), (0, 200, 114), (200, 200, 114)], hold_s=200.0)


def crossing() -> list[Returning]:
    """Return it, and one whose way home passes over where the first one holds, and then crosses its way home."""
    legs = [(200, 0, 114), (300, 100, 114), (300, 300, 114), (100, 300, 114), (0, 200, 114)]
    return [holding(), flight("bravo", (200, 0), legs, wait_s=70.0)]


def test_ways_that_cross_are_staggered_by_the_separation() -> None:
    # and one metre for turning home early
    assert chosen(space_of(), crossing()) == [15.0, 15.0 + NEED_M + 1.0]
    for heights_m, apart in (((60.0, 60.0), False), ((60.0, 84.0), False), ((60.0, 85.0), True), ((85.0, 60.0), False)):
        assert proven(space_of(), crossing(), heights_m)["alpha - bravo"] == apart


def test_heights_follow_from_the_lowest() -> None:
    # the mast below the first one's way home lifts both
    world = space_of([CylinderSolid("mast", 40.0, 40.0, 3.0, 150.0)])
    assert chosen(world, crossing()) == [63.0, 63.0 + NEED_M + 1.0]


def test_a_fixed_height_is_kept_and_the_other_gives_way() -> None:
    assert chosen(space_of(), crossing(), [None, 50.0]) == [15.0, 50.0]
    assert chosen(space_of(), crossing(), [20.5, None]) == [20.5, math.ceil(20.5 + NEED_M + 1.0)]
    with pytest.raises(InfeasibleError, match="alpha - bravo"):
        chosen(space_of(), crossing(), [50.0, 30.0])
    with pytest.raises(InfeasibleError, match="alpha - bravo"):
        chosen(space_of(), crossing(), [None, 30.0])


def test_who_climbs_below_another_way_home_returns_below_it() -> None:
    under = flight("bravo", (200, 0), [(200, 0, 114), (0, 200, 114)], wait_s=70.0)
    assert chosen(space_of(), [holding(), under]) == [15.0 + NEED_M + 1.0, 15.0]
    assert chosen(space_of(), [under, replace(holding(), name="zulu")])[0] == 15.0
    assert not proven(space_of(), [holding(), under], [15.0, 200.0])["alpha - bravo"]


def test_a_cycle_is_told() -> None:
    # it climbs below the first one's way home, and its own passes over the first one's home
    legs = [(200, 0, 114), (0, 200, 114), (-200, 0, 114)]
    vehicles = [holding(), flight("bravo", (200, 0), legs, wait_s=70.0)]
    with pytest.raises(InfeasibleError, match=r"alpha - bravo: .*told to at \d+ s"):
        chosen(space_of(), vehicles)
    for heights_m in ((15.0, 100.0), (100.0, 15.0)):
        assert not proven(space_of(), vehicles, heights_m)["alpha - bravo"]


def test_who_has_landed_stays_there() -> None:
    landed = flight("alpha", (0, 0), [(0, 0, 140), (100, 0, 140)])
    over = flight("bravo", (300, 0), [(300, 0, 150), (-100, 0, 150)], wait_s=70.0)
    # not below the landed one's return, but above the place where it stands
    assert chosen(space_of(), [landed, over]) == [15.0, NEED_M + 1.0]


def test_a_vehicle_higher_than_its_return_height_stays_so_high() -> None:
    vehicles = crossing()
    high = flight("alpha", (0, 0), [(0, 0, 200), (0, 200, 200), (200, 200, 200)], hold_s=200.0)
    assert proven(space_of(), [high, vehicles[1]], [15.0, 15.0])["alpha - bravo"]
    assert not proven(space_of(), [high, vehicles[1]], [15.0, 100.0])["alpha - bravo"]


def test_homes_too_close_are_not_apart() -> None:
    pair = [flight(n, (0, y), [(0, y, 140), (-100, y, 140)]) for n, y in (("alpha", 0.0), ("bravo", NEED_M - 0.5))]
    assert not proven(space_of(), pair, [15.0, 15.0])["alpha - bravo"]
    pair[1] = flight("bravo", (0, NEED_M + 2.0), [(0, NEED_M + 2.0, 140), (-100, NEED_M + 2.0, 140)])
    assert proven(space_of(), pair, [15.0, 15.0])["alpha - bravo"]


def test_missing_terrain_is_not_clear() -> None:
    alpha = flight("alpha", (0, 0), DETOUR)
    space, _, names = space_of()
    space.terrain.height_amsl_m[80:90, 98:102] = np.nan  # about (150, 0)
    world = (space, pyramid(space.terrain, 1600.0), names)
    assert not proven(world, [alpha], [400.0])["alpha"]
    with pytest.raises(InfeasibleError, match="terrain is missing"):
        chosen(world, [alpha])


def test_waived_is_told_as_waived_never_as_proven() -> None:
    findings = prove_returns(*space_of(), crossing(), apart_m, waived=True)
    assert [f.vehicle for f in findings] == ["alpha", "bravo", "alpha - bravo"]
    assert all(f.waived and not f.proven and f.holds and f.check == "return" for f in findings)


def test_who_returns_at_its_end_only_is_judged_there() -> None:
    world = space_of([CylinderSolid("mast", 150.0, 0.0, 3.0, 190.0)])
    detour = flight("alpha", (0, 0), [*DETOUR, (300.0, 300.0, 140.0)])
    at_end = replace(detour, airborne_s=detour.descends_s)
    assert not proven(world, [detour], [15.0])["alpha"]
    assert proven(world, [at_end], [15.0])["alpha"]


def test_a_plane_is_anywhere_beside_its_way_home() -> None:
    plane = model(vehicle_class="plane", turn_radius_m=20.0, loiter_radius_m=20.0, return_height_m=60.0)
    alpha = flight("alpha", (0, 0), [(0, 0, 160), (300, 0, 160)], motion=plane, speed_m_s=20.0)
    held = alpha.trajectory.t_s < alpha.descends_s  # nobody lands it
    t_s, position_m = alpha.trajectory.t_s[held], alpha.trajectory.position_m[held]
    alpha = replace(alpha, trajectory=Trajectory(t_s, position_m))
    # as far aside as it turns, and at its end it may be anywhere on its circle; mast, margin and tube are 15 m
    wide = alpha.aside_m + 15.0
    beside = {
        y: space_of([CylinderSolid("mast", 150.0, y, 3.0, 190.0)]) for y in (wide, wide + 2.0 * alpha.circled_m + 5.0)
    }
    assert [proven(world, [alpha], [60.0])["alpha"] for world in beside.values()] == [False, True]
    # as low as the lower of both, as high as the higher
    below = space_of([CylinderSolid("mast", 150.0, 0.0, 3.0, 147.0)])
    assert proven(below, [alpha], [60.0])["alpha"]
    assert proven(below, [alpha], [80.0])["alpha"]
    assert not proven(below, [alpha], [50.0])["alpha"]
    assert not proven(space_of(ridge_m=50.0), [alpha], [150.0])["alpha"]
    assert proven(space_of(ridge_m=40.0), [alpha], [150.0])["alpha"]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("speed_m_s", [2.0, 6.0, 9.0])
def test_simulated_vehicles_come_to_rest_where_they_are_proven_to(autopilot: str, speed_m_s: float) -> None:
    motion = model(
        autopilot=autopilot, jerk_m_s3=4.0 if autopilot == "px4" else 1.0, acceleration_m_s2=3.0, climb_rate_m_s=3.0
    )
    sky = Navigator([motion], [[0.0, 0.0, 140.0]])
    sky.follow(0, [[900.0, 0.0, 140.0]], speed_m_s)
    for _ in range(400):
        sky.step()
    told_x = float(sky.position_m[0, 0])
    speed = float(sky.velocity_m_s[0, 0])
    assert speed == pytest.approx(speed_m_s, rel=0.1)
    sky.follow(0, [[told_x, 0.0, 240.0]], 10.0)
    farthest_x = told_x
    for _ in range(400):
        sky.step()
        farthest_x = max(farthest_x, float(sky.position_m[0, 0]))
    # who is told to at its last straight metre before a corner of 3 s needs as much room: a wall at margin and tube
    # beyond must be called in the way
    edge_x = 100.0 - 1.5 * speed + (farthest_x - told_x) + 10.0 + 2.0 - 0.1
    wall = PrismSolid("wall", around(edge_x + 50.0, 0.0, 50.0))
    corner = flight("alpha", (0, 0), [(0, 0, 140), (100, 0, 140), (100, 60, 140)], speed_m_s=speed, motion=motion)
    assert not proven(space_of([wall]), [corner], [15.0])["alpha"]
