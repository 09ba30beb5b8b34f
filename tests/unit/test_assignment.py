"""Who inspects what: laws of every assignment, the best of all on tiny ones, and what is left out with its reason."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from missionplanner import assignment
from missionplanner.assignment import Assignment, Way, assign, relieved, share_out
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Action
from missionplanner.scene import Scene
from missionplanner.travel import TravelCosts
from missionplanner.views import Viewpoint, Visit
from tests.lines import open_question, open_scene
from tests.scenes import at

WAYS: tuple[Way, ...] = ("split", "nearest")


def scene(targets: int, vehicles: int, weights: Sequence[float] = (), **assignment: Any) -> Scene:
    """Return an open mission of towers T1, T2, ... and copters; what is flown is told by costs alone."""
    data = open_question([(200.0 * k, 0.0) for k in range(targets)])
    for tower, weight in zip(data["inspection"]["towers"], weights, strict=False):
        tower["weight"] = weight
    data["inspection"]["assignment"] = {"iterations": 100, "swap_s": 100.0} | assignment
    data["vehicles"] = [{"name": f"v{k}", "home": at(60.0 * k, -90.0), "endurance_s": 1000.0} for k in range(vehicles)]
    return open_scene(data)


def visits_of(targets: int, each: int, *, reversible: bool) -> tuple[Visit, ...]:
    """Return visits of every target, of two viewpoints each where they may be turned."""
    found = []
    for t, side in itertools.product(range(targets), range(each)):
        points = [np.array([200.0 * t + d, 30.0 * side, 150.0]) for d in ((0.0, 20.0) if reversible else (0.0,))]
        name = f"T{t + 1}.{side}"
        found.append(Visit(name, f"T{t + 1}", tuple(Viewpoint(p, Action(name)) for p in points), reversible))
    return tuple(found)


def costs_of(visits: Sequence[Visit], vehicles: int, rng: np.random.Generator, *, returns: bool = False) -> TravelCosts:
    """Return costs between places strewn at random: times as the crow flies, another for each of two models."""
    turned_round = [k for k, visit in enumerate(visits) if visit.reversible]
    visit = np.array([*range(len(visits)), *turned_round], dtype=np.intp)
    turned = np.arange(len(visit), dtype=np.intp)
    for extra, k in enumerate(turned_round):
        turned[k], turned[len(visits) + extra] = len(visits) + extra, k
    ends = rng.uniform(-100.0, 100.0, (2, len(visits), 2))
    first = np.concatenate([ends[0], ends[1][turned_round]])
    last = np.concatenate([ends[1], ends[0][turned_round]])
    homes = rng.uniform(-100.0, 100.0, (vehicles, 2))
    count = len(visit)
    inspection_s = np.linalg.norm(last - first, axis=1) + 5.0
    arrive, leave = np.concatenate([first, homes]), np.concatenate([last, homes])
    time_s = np.linalg.norm(leave[:, None] - arrive[None], axis=2)
    time_s[:, :count] += inspection_s
    time_s[count:, :count] += 10.0  # take-off
    time_s[:count, count:] += 15.0  # landing
    np.fill_diagonal(time_s[:count, :count], np.inf)
    models = np.stack([time_s, 1.2 * time_s])
    home_share = np.linalg.norm(homes[:, None] - last[None], axis=2) / 600.0
    return TravelCosts(
        visits=tuple(visits),
        forms=(*visits, *(visits[k].reversed() for k in turned_round)),
        visit=visit,
        turned=turned,
        model=np.arange(vehicles, dtype=np.intp) % 2,
        time_s=models,
        energy_share=models / 1000.0,
        inspection_s=np.stack([inspection_s, 1.2 * inspection_s]),
        inspection_share=np.stack([inspection_s, 1.2 * inspection_s]) / 1000.0,
        home_share=home_share,
        return_height_m=rng.uniform(20.0, 60.0, (vehicles, count)),
        higher_share_m=np.full(vehicles, 1e-4),
        top_height_m=np.full(vehicles, 30.0),
        top_share=np.full(vehicles, 0.01),
        reserve_share=np.full(vehicles, 0.2),
        returns=returns,
    )


def reckoned(costs: TravelCosts, vehicle: int, forms: Sequence[int]) -> tuple[float, float]:
    """Return time and share of one tour, step by step: slow, obvious."""
    m, home = costs.model[vehicle], costs.home(vehicle)
    places = [home, *forms, home]
    time_s = used = need = 0.0
    heights = [costs.return_height_m[vehicle, form] for form in forms]
    for a, b in itertools.pairwise(places):
        time_s += float(costs.time_s[m, a, b])
        used += float(costs.energy_share[m, a, b])
        if costs.returns and b != home:
            higher_m = max(heights) - costs.return_height_m[vehicle, b]
            need = max(need, used + costs.home_share[vehicle, b] + higher_m * costs.higher_share_m[vehicle])
    if costs.returns:
        higher_m = max(0.0, max(heights) - costs.top_height_m[vehicle])
        need = max(need, used + costs.top_share[vehicle] + higher_m * costs.higher_share_m[vehicle])
    return time_s, max(need, used)


def check(found: Assignment, costs: TravelCosts, place: Scene, sorties_max: int) -> None:
    """Check what holds of every assignment."""
    forms = {id(form): k for k, form in enumerate(costs.forms)}
    flown = [visit.name for tour in found.tours for visit in tour.visits]
    assert len(flown) == len(set(flown))
    all_of = {visit.target: {v.name for v in costs.visits if v.target == visit.target} for visit in costs.visits}
    left = [left.target for left in found.left_out]
    assert len(left) == len(set(left))
    assert all("\n" not in left.why and left.why for left in found.left_out)
    for target, names in all_of.items():
        assert names <= set(flown) if target not in left else not names & set(flown)
    for tour in found.tours:
        assert tour.visits
        time_s, share = reckoned(costs, tour.vehicle, [forms[id(visit)] for visit in tour.visits])
        assert tour.time_s == pytest.approx(time_s)
        assert tour.energy_share == pytest.approx(share)
        assert share <= 0.8 + 1e-6
    by_place = [(tour.round, tour.vehicle) for tour in found.tours]
    assert by_place == sorted(set(by_place))
    for v in range(len(place.tasks)):
        own = [tour for tour in found.tours if tour.vehicle == v]
        assert [tour.round for tour in own] == list(range(len(own)))
        assert [tour.time_s for tour in own] == sorted((tour.time_s for tour in own), reverse=True)
    assert found.rounds <= sorties_max
    longest = [max(t.time_s for t in found.tours if t.round == r) for r in range(found.rounds)]
    assert found.makespan_s == pytest.approx(sum(longest) + 100.0 * max(0, found.rounds - 1))
    assert found.bound_s <= found.flight_s + 1e-6


def worth(found: Assignment, place: Scene, costs: TravelCosts, objective: str) -> tuple[float, ...]:
    """Return what is to be small, as a user would say it."""
    assert place.towers is not None
    weights = dict(zip(place.towers.names, place.towers.weight.tolist(), strict=True))
    done = {visit.target for tour in found.tours for visit in tour.visits}
    missing = round(sum(weights[t] for t in {v.target for v in costs.visits} - done), 6)
    if objective == "priority":
        return (missing,)
    each = [sum(t.time_s for t in found.tours if t.vehicle == v) for v in range(len(place.tasks))]
    last = found.makespan_s if objective == "makespan" else math.ceil((max(each) - min(each)) / 10.0)
    return (missing, found.rounds, last)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.integers(0, 2**31),
    st.integers(1, 7),
    st.integers(1, 2),
    st.integers(1, 3),
    st.booleans(),
    st.booleans(),
    st.sampled_from(["makespan", "priority", "balanced"]),
    st.integers(1, 3),
)
def test_what_holds_of_every_assignment(
    seed: int, targets: int, each: int, vehicles: int, reversible: bool, returns: bool, objective: str, sorties: int
) -> None:
    """Every visit once at most, whole targets or nothing, no battery overdrawn, never worse than the simple ways."""
    rng = np.random.default_rng(seed)
    visits = visits_of(targets, each, reversible=reversible)
    costs = costs_of(visits, vehicles, rng, returns=returns)
    weights = rng.integers(0, 5, targets).astype(float).tolist()
    place = scene(targets, vehicles, weights, objective=objective, sorties_max=sorties)
    sorties = 1 if objective == "priority" else sorties
    found = assign(place, visits, seed=seed, costs=costs)
    check(found, costs, place, sorties)
    for way in WAYS:
        simple = share_out(place, visits, way, costs=costs)
        check(simple, costs, place, sorties)
        assert worth(found, place, costs, objective) <= worth(simple, place, costs, objective)


def tours_of(costs: TravelCosts, vehicle: int, visits: Sequence[int]) -> float:
    """Return the least time of one tour through visits that the battery allows, of all orders and turns."""
    best = math.inf
    for order in itertools.permutations(visits):
        choices = [{k, int(costs.turned[k])} for k in order]
        for forms in itertools.product(*choices):
            time_s, share = reckoned(costs, vehicle, forms)
            if share <= 0.8 + 1e-9:
                best = min(best, time_s)
    return best


def plans(costs: TravelCosts, vehicles: int) -> Iterator[tuple[frozenset[int], list[float]]]:
    """Yield all ways to give visits to vehicles, a sortie each: what is flown, and each one's least time."""
    count = len(costs.visits)
    least = {
        (v, chosen): tours_of(costs, v, chosen) if chosen else 0.0
        for v in range(vehicles)
        for size in range(count + 1)
        for chosen in itertools.combinations(range(count), size)
    }
    for owner in itertools.product(range(-1, vehicles), repeat=count):
        parts = [tuple(k for k in range(count) if owner[k] == v) for v in range(vehicles)]
        times = [least[v, part] for v, part in enumerate(parts)]
        if all(map(math.isfinite, times)):
            yield frozenset(k for k in range(count) if owner[k] >= 0), times


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("returns", [False, True])
def test_tiny_ones_are_solved_best(seed: int, returns: bool) -> None:
    """Of all ways to share out four visits: the least makespan, the most weight; and the bound is below all of them."""
    rng = np.random.default_rng(seed)
    visits = visits_of(2, 2, reversible=seed % 2 == 0)
    costs = costs_of(visits, 2, rng, returns=returns)
    costs = replace(costs, energy_share=costs.energy_share * 1.6, home_share=costs.home_share * 1.6)
    weights = [1.0, 2.5]
    ways = list(plans(costs, 2))
    whole = [times for flown, times in ways if len(flown) == 4]
    place = scene(2, 2, weights, objective="makespan", sorties_max=1)
    found = assign(place, visits, seed=seed, costs=costs)
    if whole:
        assert found.makespan_s == pytest.approx(min(max(times) for times in whole), rel=1e-3)
        assert found.bound_s <= min(sum(times) for times in whole) + 1e-6
    most = max(sum(w for t, w in enumerate(weights) if {2 * t, 2 * t + 1} <= flown) for flown, _ in ways)
    found = assign(scene(2, 2, weights, objective="priority"), visits, seed=seed, costs=costs)
    done = {visit.target for tour in found.tours for visit in tour.visits}
    assert sum(w for t, w in enumerate(weights) if f"T{t + 1}" in done) == most


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 3), st.booleans())
def test_batteries_that_are_enough_are_enough_for_slow_returns(seed: int, vehicles: int, reversible: bool) -> None:
    """Who returns slowly or from far away has it counted from everywhere, whatever else is flown after."""
    rng = np.random.default_rng(seed)
    visits = visits_of(5, 1, reversible=reversible)
    costs = costs_of(visits, vehicles, rng, returns=True)
    costs = replace(costs, home_share=3.0 * costs.home_share, return_height_m=2.0 * costs.return_height_m)
    place = scene(5, vehicles, objective="makespan", sorties_max=3)
    check(assign(place, visits, seed=seed, costs=costs), costs, place, 3)


def test_the_same_seed_gives_the_same_bit_for_bit() -> None:
    """Another seed may not."""
    visits = visits_of(12, 2, reversible=False)
    costs = costs_of(visits, 3, np.random.default_rng(5))
    place = scene(12, 3, objective="makespan")

    def told(seed: int) -> list[tuple[int, int, list[str], float]]:
        found = assign(place, visits, seed=seed, costs=costs)
        return [(t.vehicle, t.round, [visit.name for visit in t.visits], t.time_s) for t in found.tours]

    assert told(3) == told(3)


def test_what_was_done_is_not_asked_for() -> None:
    """Neither flown nor left out."""
    visits = visits_of(4, 1, reversible=False)
    costs = costs_of(visits, 2, np.random.default_rng(5))
    found = assign(scene(4, 2), visits, seed=1, costs=costs, done={"T2", "T4"})
    assert {visit.target for tour in found.tours for visit in tour.visits} == {"T1", "T3"}
    assert not found.left_out
    nothing = assign(scene(4, 2), visits, seed=1, costs=costs, done={"T1", "T2", "T3", "T4"})
    assert (nothing.tours, nothing.left_out, nothing.makespan_s, nothing.bound_s) == ((), (), 0.0, 0.0)


def test_who_may_take_less_of_its_battery_flies_less() -> None:
    """budget_share holds vehicle by vehicle."""
    visits = visits_of(6, 1, reversible=False)
    costs = costs_of(visits, 2, np.random.default_rng(5))
    found = assign(scene(6, 2), visits, seed=1, costs=costs, budget_share=[0.3, 0.8])
    assert all(tour.energy_share <= (0.3, 0.8)[tour.vehicle] + 1e-9 for tour in found.tours)
    assert not found.left_out


def blocked(costs: TravelCosts, visit: int) -> FloatArray:
    time_s = costs.time_s.copy()
    time_s[:, :, visit] = time_s[:, visit, :] = np.inf
    return time_s


def test_what_nobody_reaches_is_left_out_with_the_reason() -> None:
    """Too far for every battery: the numbers, and what to do; no way at all: that."""
    visits = visits_of(3, 1, reversible=False)
    costs = costs_of(visits, 2, np.random.default_rng(5))
    far = costs.energy_share.copy()
    far[:, costs.home(0) :, 1] += 0.5
    found = assign(scene(3, 2), visits, seed=1, costs=replace(costs, energy_share=far))
    (left,) = found.left_out
    assert left.target == "T2"
    assert "of the battery of v" in left.why
    assert "allowed 80%" in left.why
    found = assign(scene(3, 2), visits, seed=1, costs=replace(costs, time_s=blocked(costs, 2)))
    (left,) = found.left_out
    assert left.target == "T3"
    assert "no vehicle has a way to T3.0" in left.why


def test_too_few_sorties_take_what_weighs_most() -> None:
    """What is left out says which number to raise; with sorties enough nothing is left."""
    visits = visits_of(8, 1, reversible=False)
    costs = costs_of(visits, 1, np.random.default_rng(7))
    weights = [1.0, 1.0, 1.0, 9.0, 1.0, 1.0, 9.0, 1.0]
    few = assign(scene(8, 1, weights, sorties_max=1), visits, seed=1, costs=costs)
    assert few.left_out
    assert all("sorties_max" in left.why for left in few.left_out)
    done = {visit.target for tour in few.tours for visit in tour.visits}
    assert {"T4", "T7"} <= done
    assert not assign(scene(8, 1, weights, sorties_max=8), visits, seed=1, costs=costs).left_out


def test_what_is_so_far_off_that_a_tour_may_not_be_filled_is_inspected_still() -> None:
    """A tour to it may take all but the reserve, whatever tours are filled up to; beyond that, the reserve is told."""
    visits = visits_of(3, 2, reversible=False)
    costs = costs_of(visits, 2, np.random.default_rng(5))
    far = costs.energy_share.copy()
    far[:, :, 2] += 0.78 - min(far[v, costs.home(v), 2] + far[v, 2, costs.home(v)] for v in (0, 1))
    costs = replace(costs, energy_share=far)
    found = assign(scene(3, 2), visits, seed=1, costs=costs, budget_share=[0.7, 0.7])
    assert not found.left_out
    (tour,) = (t for t in found.tours if any(visit.name == "T2.0" for visit in t.visits))
    assert 0.7 < tour.energy_share <= 0.8
    assert all(t.energy_share <= 0.7 for t in found.tours if t is not tour)
    far[:, :, 2] += 0.1
    (left,) = assign(scene(3, 2), visits, seed=1, costs=costs, budget_share=[0.7, 0.7]).left_out
    assert left.target == "T2"
    assert "allowed 80%" in left.why


def test_who_is_barred_from_a_target_leaves_it_to_others() -> None:
    """It is left out only where nobody is left, for the reason of the nearest."""
    visits = visits_of(4, 2, reversible=True)
    costs = costs_of(visits, 2, np.random.default_rng(5))
    place = scene(4, 2)
    for mine in (0, 1):
        barred = {(mine, "T2"): "a wall", (mine, "T3"): "a wall"}
        found = assign(place, visits, seed=1, costs=costs, barred=barred)
        assert not found.left_out
        flown = {visit.target for tour in found.tours for visit in tour.visits if tour.vehicle == mine}
        assert not flown & {"T2", "T3"}
    barred = {(0, "T2"): "the further one's", (1, "T2"): "the nearer one's"}
    found = assign(place, visits, seed=1, costs=costs, barred=barred)
    assert [(left.target, left.why) for left in found.left_out] == [("T2", "the nearer one's")]


@pytest.mark.parametrize("objective", ["makespan", "priority"])
def test_no_tour_has_more_items_than_a_vehicle_holds(monkeypatch: pytest.MonkeyPatch, objective: str) -> None:
    monkeypatch.setattr(assignment, "ITEMS_MAX", 15)
    visits = visits_of(4, 2, reversible=True)  # of two places each
    costs = costs_of(visits, 2, np.random.default_rng(5))
    costs = replace(costs, energy_share=0.1 * costs.energy_share, home_share=0.1 * costs.home_share)
    found = assign(scene(4, 2, objective=objective, sorties_max=4), visits, seed=1, costs=costs)
    assert found.tours
    assert all(sum(len(visit.viewpoints) for visit in tour.visits) <= 5 for tour in found.tours)
    assert len(found.left_out) == (0 if objective == "makespan" else 2)


@pytest.mark.parametrize("seed", range(3))
def test_a_tour_that_takes_too_much_leaves_some_to_others(seed: int) -> None:
    """All is still flown once, within budgets; who takes enough already keeps what it has."""
    visits = visits_of(6, 2, reversible=True)
    costs = costs_of(visits, 3, np.random.default_rng(seed))
    costs = replace(costs, energy_share=0.4 * costs.energy_share, home_share=0.4 * costs.home_share)
    place = scene(6, 3)
    found = assign(place, visits, seed=seed, costs=costs)
    longest = max(found.tours, key=lambda tour: tour.energy_share)
    budget = [0.8] * 3
    budget[longest.vehicle] = 0.8 * longest.energy_share
    now = relieved(place, visits, found.tours, budget_share=budget, barred={}, costs=costs)
    assert now is not None
    flown = [[visit.name for tour in tours for visit in tour.visits] for tours in (found.tours, now)]
    assert sorted(flown[0]) == sorted(flown[1])
    assert all(tour.energy_share <= budget[tour.vehicle] + 1e-9 for tour in now)
    assert len({(tour.vehicle, tour.round) for tour in now}) == len(now)
    assert {tour.round for tour in now} <= {tour.round for tour in found.tours}
    assert relieved(place, visits, now, budget_share=budget, barred={}, costs=costs) is None
    assert relieved(place, visits, found.tours, budget_share=[0.1] * 3, barred={}, costs=costs) is None


def test_a_tour_of_which_nothing_fits_is_flown_by_others() -> None:
    place, visits = scene(4, 2), visits_of(4, 1, reversible=False)
    costs = costs_of(visits, 2, np.random.default_rng(7), returns=True)
    tours = assign(place, visits, seed=1, costs=costs).tours
    assert {tour.vehicle for tour in tours} == {0, 1}
    assert costs.model[0] != costs.model[1]
    energy_share = costs.energy_share.copy()
    energy_share[costs.model[0]] *= 10.0
    energy_share[costs.model[1]] *= 0.1
    heavier = replace(costs, energy_share=energy_share, home_share=costs.home_share * [[10.0], [0.1]])
    now = relieved(place, visits, tours, budget_share=[0.8, 0.8], barred={}, costs=heavier)
    assert now is not None
    assert {tour.vehicle for tour in now} == {1}
    assert sorted(v.name for t in now for v in t.visits) == sorted(v.name for t in tours for v in t.visits)
