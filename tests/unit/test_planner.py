"""What every fleet plan keeps, on small scenes; separation is sampled here, not measured by the planner's rule."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pytest

from missionplanner import proof
from missionplanner.errors import InfeasibleError
from missionplanner.plan import FleetPlan
from missionplanner.planner import plan_fleet
from missionplanner.scene import Scene
from tests.scenes import at, copter, question, scene_of

# Four copters that swap places: the straight ways of all pairs cross, two of them head-on.
RING = [("east", 120, 0), ("north", 0, 120), ("west", -120, 0), ("south", 0, -120)]
SWAP = [copter(name, (x, y), (-0.8 * x + 0.2 * y, -0.8 * y - 0.2 * x)) for name, x, y in RING]
CROSSING = [copter("alpha", (0, 0), (300, 0)), copter("bravo", (150, -150), (150, 150))]
MAST = {"kind": "cylinder", "name": "mast", "center": at(150, 2), "radius_m": 8}


def planned(*vehicles: dict[str, Any], seed: int | None = None, **changes: Any) -> tuple[Scene, FleetPlan]:
    scene = scene_of(question(*vehicles, **changes))
    plan = plan_fleet(scene, seed=seed)
    assert proof.unsafe(scene, plan) == []
    return scene, plan


def least_distance_m(plan: FleetPlan) -> float:
    """Return the least distance of any two predicted flights, sampled every 0.02 s."""
    end_s = max(float(v.trajectory.t_s[-1]) for v in plan.vehicles)
    t_s = np.arange(0.0, end_s, 0.02)
    places = [v.trajectory.at(t_s) for v in plan.vehicles]
    return min(float(np.linalg.norm(a - b, axis=1).min()) for a, b in combinations(places, 2))


def least_between_ways_m(plan: FleetPlan) -> float:
    """Return the least distance of the ways of two vehicles, whenever they fly them."""
    one, other = (v.trajectory.position_m[::5] for v in plan.vehicles)
    return float(np.linalg.norm(one[:, None] - other[None], axis=-1).min())


def test_all_arrive_together_with_speeds_in_their_ranges() -> None:
    slow = copter("slow", (0, 100), (120, 100), speed_m_s={"min": 2, "max": 6})
    scene, plan = planned(copter("fast", (0, 0), (300, 0)), slow)
    assert plan.arrival_s is not None
    for task, vehicle in zip(scene.tasks, plan.vehicles, strict=True):
        assert vehicle.arrival_s == pytest.approx(plan.arrival_s, abs=0.05)
        assert task.limits.speed_min_m_s <= vehicle.speed_m_s <= task.limits.speed_max_m_s
        assert vehicle.window_s[0] - 0.05 <= plan.arrival_s <= vehicle.window_s[1] + 0.05
    # as early as the slowest can
    assert plan.arrival_s == pytest.approx(max(v.window_s[0] for v in plan.vehicles))


@pytest.mark.parametrize("vehicles", [CROSSING, SWAP], ids=["crossing", "swap"])
def test_fleets_whose_straight_ways_cross_are_parted(vehicles: list[dict[str, Any]]) -> None:
    _, plan = planned(*vehicles)
    assert least_distance_m(plan) >= 24.0 - 1e-6
    assert plan.separation is not None
    assert plan.separation.distance_m <= least_distance_m(plan) + 1e-6
    assert plan.separation.distance_m == pytest.approx(least_distance_m(plan), abs=0.2)
    spread_s = [v.arrival_s for v in plan.vehicles]
    assert max(spread_s) - min(spread_s) <= 0.1


@pytest.mark.parametrize(
    "vehicles",
    [
        [copter("alpha", (0, 0), (300, 0)), copter("bravo", (270, 0), (-30, 0), speed_m_s={"min": 2, "max": 4})],
        [
            copter("alpha", (0, 0), (300, 0), stops=[at(150, 0, agl=40)]),
            copter("bravo", (150, -150), (150, 150), stops=[at(150, 5, agl=40)]),
        ],
    ],
    ids=["head-on at different speeds", "stops next to each other"],
)
def test_who_meets_although_their_ways_were_priced_is_planned_again(vehicles: list[dict[str, Any]]) -> None:
    news: list[tuple[str, float]] = []
    scene = scene_of(question(*vehicles, fleet={"arrive_together": False}))
    plan = plan_fleet(scene, watch=lambda vehicle, done: news.append((vehicle, done)))
    assert [name for name, done in news if done == 1.0].count("bravo") > 1  # else this tests nothing
    assert proof.unsafe(scene, plan) == []
    assert least_distance_m(plan) >= 24.0 - 1e-6


def test_ways_may_cross_at_different_times() -> None:
    # bravo starts long after alpha has passed: no need to go around
    _, plan = planned(*CROSSING, fleet={"arrive_together": False, "launch_interval_s": 60})
    assert least_between_ways_m(plan) < 12.0
    assert least_distance_m(plan) >= 24.0


def test_launches_keep_their_interval() -> None:
    fleet = {"launch_interval_s": 7.5}
    _, plan = planned(*(copter(f"uav{k}", (0, 40 * k), (300, 40 * k)) for k in range(3)), fleet=fleet)
    assert [v.start_delay_s for v in plan.vehicles] == [0.0, 7.5, 15.0]
    for vehicle in plan.vehicles:
        assert vehicle.arrival_s == pytest.approx(plan.vehicles[0].arrival_s, abs=0.1)
        on_ground = vehicle.trajectory.at(np.linspace(0.0, vehicle.start_delay_s, 5))
        np.testing.assert_allclose(on_ground, np.tile(vehicle.home_m, (5, 1)))
    assert plan.vehicles[0].speed_m_s < plan.vehicles[2].speed_m_s


def test_without_a_common_arrival_each_flies_as_fast_as_it_may() -> None:
    near = copter("near", (0, 60), (120, 60), speed_m_s={"min": 2, "max": 6})
    _, plan = planned(copter("far", (0, 0), (300, 0)), near, fleet={"arrive_together": False})
    assert plan.arrival_s is None
    assert [v.speed_m_s for v in plan.vehicles] == [10.0, 6.0]
    for vehicle in plan.vehicles:
        assert vehicle.arrival_s == pytest.approx(vehicle.window_s[0])


def test_the_arrival_asked_for_is_met() -> None:
    _, plan = planned(fleet={"arrival_time_s": 80})
    assert plan.arrival_s == 80.0
    for vehicle in plan.vehicles:
        assert vehicle.arrival_s == pytest.approx(80.0, abs=0.05)


def test_an_arrival_too_early_or_late_names_what_can_be_had() -> None:
    _, plan = planned()
    earliest_s, latest_s = plan.vehicles[0].window_s
    with pytest.raises(InfeasibleError, match=rf"arrival_time_s: 30 s is too early: .* at least {earliest_s:.1f} s"):
        planned(fleet={"arrival_time_s": 30})
    with pytest.raises(InfeasibleError, match=rf"arrival_time_s: 900 s is too late: .* at most {latest_s:.1f} s"):
        planned(fleet={"arrival_time_s": 900})
    _, plan = planned(fleet={"arrival_time_s": np.ceil(earliest_s * 10) / 10})
    assert plan.arrival_s == pytest.approx(earliest_s, abs=0.1)


def test_windows_that_do_not_meet() -> None:
    hare = copter("hare", (0, 60), (100, 60), speed_m_s={"min": 9, "max": 10})
    tortoise = copter("tortoise", (0, 0), (900, 0), speed_m_s={"min": 2, "max": 4})
    with pytest.raises(InfeasibleError, match=r"tortoise needs at least .* but hare cannot take longer") as raised:
        planned(hare, tortoise)
    # the remedy it names is one: start hare that much later
    later_s = float(str(raised.value).partition("start hare ")[2].partition(" s later")[0])
    _, plan = planned(tortoise, hare, fleet={"launch_interval_s": later_s + 0.1})
    assert plan.arrival_s is not None


def test_a_fleet_that_cannot_be_parted_is_refused_with_its_pair() -> None:
    # two that must pass each other in a lane too narrow and low for it, arriving together
    lane = {"south_west": at(-40, -13), "north_east": at(340, 13)}
    low = {"height_agl_max_m": 45}
    vehicles = [copter("alpha", (0, 0), (300, 0), **low), copter("bravo", (260, 0), (40, 0), **low)]
    with pytest.raises(InfeasibleError, match=r"alpha and bravo come within|bravo and alpha come within") as raised:
        planned(*vehicles, area=lane)
    assert "fleet.separation_m" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_endurance_too_short_is_refused() -> None:
    with pytest.raises(InfeasibleError, match=r"alpha: flies \d+ s, longer than its endurance of 45 s"):
        planned(copter("alpha", (0, 0), (300, 0), endurance_s=45))


def test_the_seed_decides_everything() -> None:
    # hills leave much to choose: how high, and how far to the side
    peaks = [{**at(x, y), "height_m": 90, "spread_m": 70} for x, y in ((100, 30), (200, -60), (150, 120))]
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": peaks}
    changes: dict[str, Any] = {"terrain": terrain, "planner": {"population": 20, "iterations": 40}}
    _, one = planned(*CROSSING, seed=3, **changes)
    _, same = planned(*CROSSING, seed=3, **changes)
    for a, b in zip(one.vehicles, same.vehicles, strict=True):
        np.testing.assert_array_equal(a.path_m, b.path_m)
        np.testing.assert_array_equal(a.trajectory.position_m, b.trajectory.position_m)
        assert (a.speed_m_s, a.cost, a.cost_terms) == (b.speed_m_s, b.cost, b.cost_terms)
    _, other = planned(*CROSSING, seed=4, **changes)
    assert any(a.path_m.tolist() != b.path_m.tolist() for a, b in zip(one.vehicles, other.vehicles, strict=True))
    assert (one.seed, other.seed) == (3, 4)
    _, default = planned(*CROSSING, **changes | {"planner": changes["planner"] | {"seed": 3}})
    np.testing.assert_array_equal(default.vehicles[0].path_m, one.vehicles[0].path_m)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("end", ["land", "rtl", "loiter"])
def test_either_autopilot_and_every_ending(autopilot: str, end: str) -> None:
    stop = at(100, 50, agl=45)
    vehicles = [
        copter("alpha", (0, 0), (300, 0), stops=[stop]),
        copter("bravo", (0, 90), (300, 90)),
    ]
    mast = {**MAST, "center": at(200, 40)}
    scene, plan = planned(*vehicles, defaults={"autopilot": autopilot, "end": end}, obstacles=[mast])
    assert least_distance_m(plan) >= 24.0 - 1e-6
    for task, vehicle in zip(scene.tasks, plan.vehicles, strict=True):
        assert (vehicle.autopilot, vehicle.end) == (autopilot, end)
        last = vehicle.trajectory.position_m[-1]
        expected = {"land": [*task.route_m[-1, :2], 100.0], "rtl": task.home_m, "loiter": task.route_m[-1]}[end]
        np.testing.assert_allclose(last, expected, atol=2.0)  # the radius within which a waypoint counts as reached
        stops = np.linalg.norm(vehicle.waypoints_m[:, None] - task.route_m[None], axis=-1).min(axis=0)
        assert stops.max() < 1e-3


def test_the_planner_tells_how_it_goes_on() -> None:
    news: list[tuple[str, float]] = []
    scene = scene_of(question())
    plan_fleet(scene, watch=lambda vehicle, done: news.append((vehicle, done)))
    for name in ("alpha", "bravo"):
        shares = [done for vehicle, done in news if vehicle == name]
        assert shares == sorted(shares)
        assert shares[-1] == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 21))
def test_twenty_seeds_of_a_crowded_crossing(seed: int) -> None:
    _, plan = planned(*SWAP, seed=seed, obstacles=[{**MAST, "center": at(5, 5)}])
    assert least_distance_m(plan) >= 24.0 - 1e-6
