"""What every fleet plan keeps, on small scenes; separation is sampled here, not measured by the planner's rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from adapters.sorties import plan_sortie
from missionplanner import proof
from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.path_search import PlannedPath
from missionplanner.plan import FleetPlan, Trajectory
from missionplanner.planner import _Pin, plan_fleet, returning_at, schedule
from missionplanner.scene import Scene
from missionplanner.timing import reached_times
from missionplanner.waypoints import passes
from tests.scenes import at, copter, question, scene_of

# Four copters that swap places: the straight ways of all pairs cross, two of them head-on.
RING = [("east", 120, 0), ("north", 0, 120), ("west", -120, 0), ("south", 0, -120)]
SWAP = [copter(name, (x, y), (-0.8 * x + 0.2 * y, -0.8 * y - 0.2 * x)) for name, x, y in RING]
CROSSING = [copter("alpha", (0, 0), (300, 0)), copter("bravo", (150, -150), (150, 150))]
MAST = {"kind": "cylinder", "name": "mast", "center": at(150, 2), "radius_m": 8}
TOWER = {"kind": "cylinder", "name": "tower", "center": at(200, 40), "radius_m": 8, "top_height_agl_m": 80}
WAIVED = {"direct_return": "waived"}
APART_M = 20 + 3 + 3
"""The fleet's separation, and what each of two copters may be off its predicted flight."""


def planned(*vehicles: dict[str, Any], seed: int | None = None, **changes: Any) -> tuple[Scene, FleetPlan]:
    scene = scene_of(question(*vehicles, **changes))
    plan = plan_fleet(scene, seed=seed)
    assert_proven(scene, plan)
    return scene, plan


def assert_proven(scene: Scene, plan: FleetPlan) -> None:
    """Check that a plan carries a certificate, and that what its vehicles will hold is proven again from its items."""
    certificate = plan.certificate
    assert certificate is not None
    assert certificate.proven
    assert certificate.problems == ()
    assert certificate.return_height_m == {v.name: v.motion.return_height_m for v in plan.vehicles}
    sorties = [plan_sortie(vehicle, plan.frame) for vehicle in plan.vehicles]
    again = proof.prove(scene, sorties, arrival_s=plan.arrival_s)
    assert [str(finding) for finding in again.problems] == []
    assert {leg.vehicle for leg in certificate.legs} == {v.name for v in plan.vehicles}
    for vehicle in plan.vehicles:
        assert all(clearance.ok for clearance in vehicle.clearances)


def least_distance_m(plan: FleetPlan) -> float:
    """Return the least distance of any two predicted flights, sampled every 0.02 s."""
    return least_between_m([v.trajectory for v in plan.vehicles])


def least_between_m(flights: Sequence[Trajectory]) -> float:
    t_s = np.arange(0.0, max(float(flight.t_s[-1]) for flight in flights), 0.02)
    places = [flight.at(t_s) for flight in flights]
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
    scene, plan = planned(*vehicles, fleet=WAIVED)
    assert least_distance_m(plan) >= APART_M - 1e-6
    # what is proven is the flight of the missions as they are sent, to 1e-7 degrees
    sent = proof.predict(scene, [plan_sortie(vehicle, plan.frame) for vehicle in plan.vehicles])
    sampled_m = least_between_m([flight.trajectory for flight in sent])
    assert plan.separation is not None
    assert plan.separation.distance_m <= sampled_m + 1e-6
    assert plan.separation.distance_m == pytest.approx(sampled_m, abs=0.2)
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
def test_who_meets_although_their_ways_were_priced_is_parted(vehicles: list[dict[str, Any]]) -> None:
    scene = scene_of(question(*vehicles, fleet={"arrive_together": False, **WAIVED}))
    plan = plan_fleet(scene)
    assert plan.resolutions  # else this tests nothing
    for resolution in plan.resolutions:
        assert {resolution.vehicle, resolution.other} == {"alpha", "bravo"}
    assert_proven(scene, plan)
    assert least_distance_m(plan) >= APART_M - 1e-6


def test_ways_may_cross_at_different_times() -> None:
    # bravo starts long after alpha has passed: no need to go around
    _, plan = planned(*CROSSING, fleet={"arrive_together": False, "launch_interval_s": 60, **WAIVED})
    assert least_between_ways_m(plan) < 12.0
    assert least_distance_m(plan) >= APART_M


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
    earliest_s, _ = plan.vehicles[0].window_s
    with pytest.raises(InfeasibleError, match=rf"arrival_time_s: 30 s is too early: .* at least {earliest_s:.1f} s"):
        planned(fleet={"arrival_time_s": 30})
    _, late = planned(fleet={"arrival_time_s": 900})
    assert late.vehicles[0].arrival_s == pytest.approx(900.0, abs=0.05)
    assert late.vehicles[0].start_delay_s > 0.0
    _, plan = planned(fleet={"arrival_time_s": np.ceil(earliest_s * 10) / 10})
    assert plan.arrival_s == pytest.approx(earliest_s, abs=0.1)


HARE = copter("hare", (0, 60), (100, 60), speed_m_s={"min": 9, "max": 10})
TORTOISE = copter("tortoise", (0, 0), (900, 0), speed_m_s={"min": 2, "max": 4})


def test_who_would_be_too_early_starts_later() -> None:
    _, plan = planned(HARE, TORTOISE)
    hare, tortoise = plan.vehicles
    assert hare.start_delay_s > 100.0
    assert tortoise.start_delay_s == 0.0
    assert hare.arrival_s == pytest.approx(tortoise.arrival_s, abs=0.1)
    assert hare.arrival_s == pytest.approx(tortoise.window_s[0], abs=0.1)


def test_or_flies_a_detour() -> None:
    _, plan = planned(HARE, TORTOISE, fleet={"lose_time_by": "detour", **WAIVED})
    hare, tortoise = plan.vehicles
    assert hare.start_delay_s == 0.0
    assert hare.length_m > 800.0
    assert hare.arrival_s == pytest.approx(tortoise.arrival_s, abs=0.1)
    assert [r.how for r in plan.resolutions if r.vehicle == "hare"] == ["detour"] * len(plan.resolutions)
    roofless = {"south_west": at(-40, 20), "north_east": at(1000, 80)}
    with pytest.raises(InfeasibleError, match=r"hare cannot take longer than .* lower its least speed"):
        planned(HARE, copter("tortoise", (0, 40), (900, 40), speed_m_s={"min": 2, "max": 4}),
                area=roofless, fleet={"lose_time_by": "detour", "separation_m": 5, **WAIVED})  # fmt: skip


LINE = [copter(f"uav{k}", (0, 60 * k), (500, 60 * k), stops=[at(100 + 40 * k, 60 * k, agl=40), at(400, 60 * k, agl=45)])
        for k in range(3)]  # fmt: skip


def test_meetings_on_the_way() -> None:
    names = ("uav0", "uav1", "uav2")
    meetings = [{"name": "begin", "at": dict.fromkeys(names, 1)}, {"name": "end", "at": {"uav0": 2, "uav2": 2}}]
    scene, plan = planned(*LINE, fleet={"rendezvous": meetings})
    places = [[int(np.argmin(np.linalg.norm(v.waypoints_m - task.route_m[k], axis=1))) for k in (1, 2)]
              for v, task in zip(plan.vehicles, scene.tasks, strict=True)]  # fmt: skip
    first = [v.reached_s[begin] for v, (begin, _) in zip(plan.vehicles, places, strict=True)]
    second = [plan.vehicles[k].reached_s[places[k][1]] for k in (0, 2)]
    assert max(first) - min(first) <= 0.1
    assert max(second) - min(second) <= 0.1
    assert max(v.arrival_s for v in plan.vehicles) - min(v.arrival_s for v in plan.vehicles) <= 0.1
    assert len(set(plan.vehicles[0].speeds_m_s.tolist())) > 1
    assert plan.certificate is not None
    found = [f for f in plan.certificate.findings if f.check == "rendezvous"]
    assert [f.proven for f in found] == [True, True]
    # a vehicle that is off its meeting is found out: by its mission, not by what the plan says
    sorties = [proof.planned_sortie(scene, v) for v in plan.vehicles]
    legs = tuple(replace(leg, speed_m_s=0.6 * leg.speed_m_s) for leg in sorties[1].legs)
    certificate = proof.prove(scene, [sorties[0], replace(sorties[1], legs=legs), sorties[2]])
    wrong = [str(f) for f in certificate.problems if f.check == "rendezvous"]
    assert len(wrong) == 1
    assert "begin" in wrong[0]


def test_a_place_passed_twice_is_met_at_its_own_visit() -> None:
    there, beyond = at(200, 0, agl=40), at(260, 30, agl=40)
    again = copter("again", (0, 0), (400, 0), stops=[there, beyond, there])
    other = copter("other", (0, 100), (400, 100), stops=[at(200, 100, agl=40)])
    meetings = [{"name": "line", "at": {"again": 3, "other": 1}}]
    scene, plan = planned(again, other, fleet={"rendezvous": meetings, **WAIVED})
    stops = passes(scene.tasks[0].route_m, plan.vehicles[0].waypoints_m)
    other_stops = passes(scene.tasks[1].route_m, plan.vehicles[1].waypoints_m)
    assert plan.vehicles[0].reached_s[stops[3]] == pytest.approx(plan.vehicles[1].reached_s[other_stops[1]], abs=0.1)


def test_meetings_before_a_late_arrival_are_late_too() -> None:
    meetings = [{"name": "begin", "at": {"uav0": 1, "uav1": 1}}]
    _, plan = planned(*LINE[:2], fleet={"rendezvous": meetings, "arrival_time_s": 600})
    assert plan.arrival_s == 600.0
    assert all(v.start_delay_s > 400.0 for v in plan.vehicles)
    assert all(v.hold_s.max() == 0.0 for v in plan.vehicles)


def test_a_pin_comes_after_its_own_vehicles_earlier_meetings() -> None:
    meetings = [{"name": "others", "at": {"uav1": 1, "uav2": 1}}, {"name": "mine", "at": {"uav0": 1, "uav1": 2}}]
    scene = scene_of(question(*LINE, fleet={"rendezvous": meetings}))
    paths = [PlannedPath(t.route_m, t.route_m, 0.0, 0.0, {}, np.zeros(1), 0) for t in scene.tasks]
    schedules, _ = schedule(scene, paths, [0.0] * 3, [_Pin(0, 2, 130.0)])
    one, other, _ = (
        when.start_delay_s + reached_times(task.motion, task.home_m, task.route_m, when.speeds_m_s, when.hold_s)
        for task, when in zip(scene.tasks, schedules, strict=True)
    )
    assert one[1] == pytest.approx(other[2], abs=0.1)
    assert one[2] == pytest.approx(130.0, abs=0.1)


@pytest.mark.parametrize(
    ("at_", "told"),
    [
        (
            {"uav0": 2, "uav1": 7},
            r"rendezvous\[1\] \(end\): uav1: expected a place of its route, one of 0, 1, 2, got 7",
        ),
        ({"uav0": 2, "uav1": 3}, r"got 3: that is its goal, where fleet.arrive_together brings all together"),
        ({"uav0": 0, "uav1": 2}, r"uav0: expected a place after its rendezvous before, got 0: reorder them"),
    ],
)
def test_a_meeting_nowhere(at_: dict[str, int], told: str) -> None:
    meetings = [{"name": "begin", "at": {"uav0": 1, "uav1": 1}}, {"name": "end", "at": at_}]
    with pytest.raises(MissionError, match=told):
        scene_of(question(*LINE, fleet={"rendezvous": meetings}))


def test_arrival_in_order() -> None:
    fleet = {"arrival_order": ["uav2", "uav0", "uav1"], "arrival_spacing_s": 8}
    _, plan = planned(*LINE, fleet=fleet)
    assert plan.arrival_s is not None
    times = {v.name: v.arrival_s - plan.arrival_s for v in plan.vehicles}
    assert times == pytest.approx({"uav2": 0.0, "uav0": 8.0, "uav1": 16.0}, abs=0.06)


def test_least_energy() -> None:
    near = copter("near", (0, 60), (200, 60), endurance_s=900)
    far = copter("far", (0, 0), (600, 0), endurance_s=900)
    with pytest.raises(MissionError, match=r"least_energy: expected endurance_s or energy of every vehicle"):
        planned(*LINE[:2], fleet={"arrival": "least_energy"})
    _, fast = planned(near, far, fleet={"lose_time_by": "start_later"})
    _, thrifty = planned(near, far, fleet={"arrival": "least_energy"})

    def used(plan: FleetPlan) -> list[float]:
        assert plan.certificate is not None
        found = [f for f in plan.certificate.findings if f.check == "energy" and "takes" in f.detail]
        return [f.value for f in found if f.value is not None]

    assert thrifty.vehicles[0].start_delay_s > 0.0
    assert used(thrifty)[0] < used(fast)[0] - 0.005
    assert used(thrifty)[1] <= used(fast)[1] + 1e-6
    assert thrifty.vehicles[0].arrival_s == pytest.approx(thrifty.vehicles[1].arrival_s, abs=0.1)


def test_who_crosses_passes_at_another_time_before_anybody_is_planned_again(monkeypatch: pytest.MonkeyPatch) -> None:
    # the shorter way has room to be flown slower or faster, and no price keeps the ways apart
    monkeypatch.setattr("missionplanner.planner._FELLOW_SLACK_M", -1e3)
    long = copter("long", (0, 0), (900, 0), stops=[at(450, 0, agl=40)])
    cross = copter("cross", (450, -300), (450, 300), stops=[at(450, 0, agl=40), at(450, 150, agl=40)])
    scene, plan = planned(long, cross, fleet=WAIVED)
    assert [r.how for r in plan.resolutions] in (["speed"], ["start"])
    assert least_between_ways_m(plan) < 15.0  # else they were not parted by time
    one, other = (v.trajectory for v in plan.vehicles)
    required_m = proof.required_apart_m(scene, *scene.tasks)
    for late_s in (-3.0, 0.0, 3.0):
        assert least_between_m([Trajectory(one.t_s + late_s, one.position_m), other]) >= required_m - 0.02


def test_a_fleet_that_cannot_be_parted_is_refused_with_its_pair() -> None:
    # two that must pass each other in a lane too narrow and low for it, arriving together
    lane = {"south_west": at(-40, -18), "north_east": at(340, 18)}
    low = {"height_agl_max_m": 46}
    vehicles = [copter("alpha", (0, 0), (300, 0), **low), copter("bravo", (260, 0), (40, 0), **low)]
    with pytest.raises(InfeasibleError, match=r"alpha and bravo come within|bravo and alpha come within") as raised:
        planned(*vehicles, area=lane)
    assert "fleet.separation_m" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_endurance_too_short_is_refused() -> None:
    with pytest.raises(InfeasibleError, match=r"^not proven: alpha: takes \d+\.\d% of its battery, allowed 80%"):
        planned(copter("alpha", (0, 0), (300, 0), endurance_s=45))
    _, plan = planned(copter("alpha", (0, 0), (300, 0), endurance_s=450))
    assert plan.certificate is not None
    used, home = (f for f in plan.certificate.findings if f.check == "energy")
    assert used.value is not None
    assert home.value is not None
    assert used.value > (plan.vehicles[0].trajectory.t_s[-1] - 1.0) / 450
    assert used.value < home.value <= 0.8  # from far off, there is more to fly than to land


def test_the_seed_decides_everything() -> None:
    # hills leave much to choose: how high, and how far to the side
    peaks = [{**at(x, y), "height_m": 90, "spread_m": 70} for x, y in ((100, 30), (200, -60), (150, 120))]
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100, "cell_m": 30, "peaks": peaks}
    changes: dict[str, Any] = {"terrain": terrain, "planner": {"population": 20, "iterations": 40}, "fleet": WAIVED}
    changes["defaults"] = {"safety": {"landing_slope_max_deg": 60}}
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
    scene, plan = planned(*vehicles, defaults={"autopilot": autopilot, "end": end}, obstacles=[TOWER])
    assert least_distance_m(plan) >= APART_M - 1e-6
    for task, vehicle in zip(scene.tasks, plan.vehicles, strict=True):
        assert (vehicle.autopilot, vehicle.end) == (autopilot, end)
        last = vehicle.trajectory.position_m[-1]
        expected = {"land": [*task.route_m[-1, :2], 100.0], "rtl": task.home_m, "loiter": task.route_m[-1]}[end]
        np.testing.assert_allclose(last, expected, atol=2.0)  # the radius within which a waypoint counts as reached
        stops = np.linalg.norm(vehicle.waypoints_m[:, None] - task.route_m[None], axis=-1).min(axis=0)
        assert stops.max() < 1e-3


# --- the certificate


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_plan_always_carries_the_certificate_of_what_it_sends(autopilot: str) -> None:
    scene, plan = planned(obstacles=[TOWER], defaults={"autopilot": autopilot})
    assert plan.certificate is not None
    checks = {finding.check for finding in plan.certificate.findings}
    assert checks >= {"terrain", "obstacle", "fence", "angle", "turn", "speed", "landing", "understood", "return"}
    assert checks >= {"separation", "lateness", "arrival"}
    assert plan.certificate.input_sha256 == scene.input_sha256
    # what the vehicles' plans say is what it says
    for vehicle in plan.vehicles:
        assert vehicle.clearances == proof.clearances(plan.certificate, vehicle.name)
        assert [c.what for c in vehicle.clearances] == ["terrain", "tower", "fence"]
    assert plan.separation is not None
    assert plan.separation.required_m == APART_M


def test_beside_a_steep_hill_it_is_planned_until_the_whole_tube_is_proven() -> None:
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100}
    terrain |= {"peaks": [{**at(150, 60), "height_m": 100, "spread_m": 60}]}
    scene, plan = planned(copter("alpha", (0, 0), (300, 0)), terrain=terrain, fleet=WAIVED)
    assert scene.terrain.height_amsl_m(150.0, 0.0) > 130  # a straight way keeps too little
    (terrain_m,) = [c for c in plan.vehicles[0].clearances if c.what == "terrain"]
    assert terrain_m.distance_m >= 20.0


def test_all_keep_apart_also_when_one_is_late() -> None:
    fleet = {"arrive_together": False, "launch_interval_s": 60, **WAIVED}
    _, plan = planned(*CROSSING, fleet={**fleet, "lateness_s": 8})
    (late,) = [f for f in plan.certificate.findings if f.check == "lateness"] if plan.certificate else []
    assert late.value is not None
    assert late.value >= 8.0
    # by that much, either may be early or late: the least distance over all shifts, sampled
    one, other = (v.trajectory for v in plan.vehicles)
    t_s = np.arange(0.0, max(one.t_s[-1], other.t_s[-1]), 0.05)
    for shift_s in np.linspace(-8.0, 8.0, 33):
        assert np.linalg.norm(one.at(t_s) - other.at(t_s + shift_s), axis=1).min() >= APART_M - 0.5


def test_a_lateness_that_cannot_be_had_is_refused() -> None:
    # they cross: however far apart they start, who is hours late meets the other
    fleet = {"arrive_together": False, "launch_interval_s": 25, "lateness_s": 10_000, **WAIVED}
    low = {"height_agl_max_m": 46}
    with pytest.raises(
        InfeasibleError, match=r"alpha and bravo come closer than 26 m.* if one of them is 10000 s early"
    ):
        planned(*({**vehicle, **low} for vehicle in CROSSING), fleet=fleet)


# --- the way home


def test_return_heights_are_the_least_that_are_clear_and_apart() -> None:
    scene, plan = planned(copter("alpha", (0, 0), (300, 0)), obstacles=[{**TOWER, "center": at(150, 12)}])
    (alpha,) = plan.vehicles
    # 80 m of tower, 10 m of safety, 3 m of errors; whole metres, and a metre or two for the climb
    assert 93 <= alpha.motion.return_height_m <= 96
    assert alpha.motion.return_height_m == round(alpha.motion.return_height_m)
    sortie = plan_sortie(alpha, plan.frame)
    lower = proof.prove(scene, [replace(sortie, return_height_m=alpha.motion.return_height_m - 3)])
    assert "return" in {finding.check for finding in lower.problems}


def test_return_heights_are_staggered_where_ways_home_cross() -> None:
    # their missions keep 40 m apart, their direct ways home cross
    alpha = copter("alpha", (0, 0), (300, 100), goal=at(300, 100, agl=40))
    bravo = copter("bravo", (0, 60), (300, -40), goal=at(300, -40, agl=80), takeoff_height_m=80)
    scene, plan = planned(alpha, bravo)
    assert plan.certificate is not None
    (pair,) = [f for f in plan.certificate.findings if f.check == "return" and f.vehicle == "alpha - bravo"]
    assert pair.value is not None
    assert pair.value >= APART_M
    sorties = [plan_sortie(vehicle, plan.frame) for vehicle in plan.vehicles]
    heights_m = [sortie.return_height_m for sortie in sorties]
    level = [replace(sortie, return_height_m=max(*heights_m, 100.0)) for sortie in sorties]
    unproven = [f.vehicle for f in proof.prove(scene, level).problems if f.check == "return"]
    assert unproven == ["alpha - bravo"]


def test_the_return_height_that_is_asked_for_is_kept() -> None:
    _, plan = planned(copter("alpha", (0, 0), (300, 0), return_height_m=77))
    assert plan.vehicles[0].motion.return_height_m == 77.0


def test_a_return_that_cannot_be_proven_is_infeasible_unless_it_is_waived() -> None:
    # a mast without a top stands on the way home from a stop behind it
    vehicle = copter("alpha", (0, 0), (300, 100), stops=[at(300, 5, agl=40)])
    blocked = {"obstacles": [MAST]}
    with pytest.raises(InfeasibleError, match=r"alpha.*return") as raised:
        planned(vehicle, **blocked)
    assert "\n" not in str(raised.value)
    assert "fleet.direct_return: waived" in str(raised.value)
    _, plan = planned(vehicle, **blocked, fleet=WAIVED)
    assert plan.certificate is not None
    (finding,) = [f for f in plan.certificate.findings if f.check == "return"]
    assert (finding.proven, finding.waived) == (False, True)


def test_heights_that_are_given_are_returned_at() -> None:
    scene = scene_of(question())
    changed = returning_at(scene, {"bravo": 55.0})
    assert [task.motion.return_height_m for task in changed.tasks] == [15.0, 55.0]
    assert [task.motion.return_height_m for task in scene.tasks] == [15.0, 15.0]


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
    _, plan = planned(*SWAP, seed=seed, obstacles=[{**MAST, "center": at(5, 5)}], fleet=WAIVED)
    assert least_distance_m(plan) >= APART_M - 1e-6


def test_time_improves_a_plan_and_ends() -> None:
    scene = scene_of(question(*CROSSING, fleet=WAIVED))
    ticks = iter(range(10**9))
    plan = plan_fleet(scene, seconds=3.0, clock=lambda: 0.01 * next(ticks))
    assert_proven(scene, plan)
    assert next(ticks) > 200  # most of the time is used
    usual = plan_fleet(scene)
    assert sum(v.cost for v in plan.vehicles) <= 1.001 * sum(v.cost for v in usual.vehicles)
    assert sum(v.evaluations for v in plan.vehicles) > sum(v.evaluations for v in usual.vehicles)
    with pytest.raises(MissionError, match=r"^seconds: expected above 0, got -1$"):
        plan_fleet(scene, seconds=-1.0, clock=lambda: 0.0)
    with pytest.raises(MissionError, match=r"^seconds: expected a clock with them, got none: add clock="):
        plan_fleet(scene, seconds=1.0)


def test_the_planner_has_no_clock_of_its_own() -> None:
    """Though the mission asks for time: what does not depend on the machine comes out the same."""
    timed, usual = (
        scene_of(question(obstacles=[MAST], fleet=WAIVED, planner={"iterations": 30, "seconds": seconds}))
        for seconds in (2.0, None)
    )
    ticks = iter(range(10**9))
    alone, improved = plan_fleet(timed), plan_fleet(timed, clock=lambda: 0.01 * next(ticks))
    for one, other, more in zip(alone.vehicles, plan_fleet(usual).vehicles, improved.vehicles, strict=True):
        np.testing.assert_array_equal(one.path_m, other.path_m)
        assert one.evaluations == other.evaluations < more.evaluations
