"""How early or late vehicles may be, where it can be told by hand; separation of many against every breakpoint."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import pytest

from missionplanner.plan import Trajectory
from missionplanner.timing import Slack, lateness_slack, least_separation, least_slack

TOLERANCE_S = 0.05


def straight(start: list[float], velocity: list[float], begin_s: float, end_s: float, ticks: int = 1) -> Trajectory:
    t = np.linspace(begin_s, end_s, ticks + 1)
    return Trajectory(t, np.array(start) + np.outer(t - begin_s, velocity))


def assert_slack(slack_s: float, expected_s: float) -> None:
    assert expected_s - TOLERANCE_S <= slack_s <= expected_s + 1e-6


@pytest.mark.parametrize("ticks", [1, 7, 8, 9, 400])
def test_who_follows_on_the_same_path_may_be_late_by_what_separates_them(ticks: int) -> None:
    ahead = straight([100, 0, 50], [5, 0, 0], 0.0, 100.0, ticks)
    behind = straight([0, 0, 50], [5, 0, 0], 0.0, 100.0, ticks)
    # 100 m apart, 5 m/s: where one was, the other is 20 s later; but its goal lies 100 m before the other's
    assert_slack(lateness_slack(ahead, behind, 30.0), (100 - 30) / 5)
    assert_slack(lateness_slack(behind, ahead, 30.0), (100 - 30) / 5)
    assert lateness_slack(ahead, behind, 100.5) == 0.0


@pytest.mark.parametrize("ticks", [1, 400])
def test_crossing_paths_are_free_until_one_leaves_and_the_other_comes(ticks: int) -> None:
    east = straight([-300, 0, 100], [6, 0, 0], 0.0, 100.0, ticks)  # over the crossing at 50 s
    north = straight([0, -400, 104], [0, 5, 0], 20.0, 180.0, ticks)  # at 100 s
    # late by s, east is at x = -6 (t' - s): least distance of (6 (s - t'), 5 t', 4) over t' is 30 s / sqrt(61), and 4
    expected_s = 50 - math.sqrt(30**2 - 4**2) * math.sqrt(61) / 30
    assert_slack(lateness_slack(east, north, 30.0), expected_s)
    assert lateness_slack(east, north, 4.0) == 60.0  # never so near
    assert lateness_slack(east, north, 30.0, limit_s=40.0) == 40.0


def test_parked_vehicles_are_met_before_they_start_and_after_they_end() -> None:
    parked = straight([0, 0, 0], [0, 0, 1], 100.0, 140.0)  # leaves its pad at 100 s
    passing = straight([200, 5, 0], [-4, 0, 0], 130.0, 230.0)  # at x at 180 - x / 4
    # 13 m apart where x^2 + h^2 = 12^2, with h reached at 100 + h: the difference is least for x / h = 1 / 4
    assert_slack(lateness_slack(parked, passing, 13.0, limit_s=100.0), 80 - 12 * math.sqrt(1 + 1 / 16))
    assert lateness_slack(parked, passing, 13.0) == 60.0
    landed = straight([0, 0, 50], [0, 0, -1], 0.0, 50.0)
    assert lateness_slack(landed, passing, 13.0) == 0.0  # it stands there for ever


def test_exactly_as_far_as_required_is_kept() -> None:
    one, other = straight([0, 0, 0], [1, 1, 0], 0.0, 50.0, 100), straight([26, -26, 0], [1, 1, 0], 0.0, 50.0, 100)
    assert lateness_slack(one, other, 26.0 * math.sqrt(2.0)) == 60.0
    assert lateness_slack(one, other, 26.0 * math.sqrt(2.0) + 1e-3) == 0.0


def test_a_fleet_may_be_as_late_as_its_worst_pair() -> None:
    fleet = [straight([-100.0 * k, 0, 50], [5, 0, 0], 0.0, 100.0, 300) for k in range(4)]
    required_m = {(0, 1): 30.0, (1, 2): 80.0, (2, 3): 50.0}
    found = least_slack(fleet, lambda i, j: required_m.get((i, j), 20.0))
    assert [(slack.first, slack.second) for slack in found[:3]] == [(1, 2), (2, 3), (0, 1)]
    for slack, expected_s in zip(found, [4.0, 10.0, 14.0, 36.0, 36.0, 56.0], strict=True):
        assert_slack(slack.slack_s, expected_s)
    assert all(isinstance(slack, Slack) for slack in found)
    assert least_slack(fleet[:1], lambda _i, _j: 10.0) == []
    assert least_slack([], lambda _i, _j: 10.0) == []


def test_single_samples_stand_where_they_are() -> None:
    here, there = (Trajectory(np.array([t]), np.array([[x, 0.0, 0.0]])) for t, x in ((3.0, 0.0), (3.0, 9.0)))
    (pair,) = least_separation([here, there])
    assert (pair.distance_m, pair.t_s) == (9.0, 3.0)
    assert lateness_slack(here, there, 9.5) == 0.0
    assert lateness_slack(here, there, 8.5) == 60.0


def wandering(seed: int, ticks: int) -> Trajectory:
    """Minutes of smooth flight in ticks, from a pad of its own."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0.0, 100.0, 2))[0] + 0.1 * np.arange(ticks)
    turns = np.cumsum(rng.normal(0.0, 0.05, (ticks, 3)), axis=0)
    step = np.stack([np.cos(turns[:, 0]), np.sin(turns[:, 0]), 0.2 * np.sin(turns[:, 1])], axis=-1)
    return Trajectory(t, rng.uniform(-200.0, 200.0, 3) * [1, 1, 0.1] + 0.8 * np.cumsum(step, axis=0))


def least_at_breakpoints(one: Trajectory, other: Trajectory) -> float:
    """Return the least distance: between all neighbouring times of either, that of a point to a segment."""
    t = np.union1d(one.t_s, other.t_s)
    away = one.at(t) - other.at(t)
    step = np.diff(away, axis=0)
    share = np.clip(-np.sum(away[:-1] * step, axis=1) / np.maximum(np.sum(step * step, axis=1), 1e-30), 0.0, 1.0)
    return float(np.linalg.norm(away[:-1] + share[:, None] * step, axis=1).min())


def test_bounds_skip_no_pair_and_no_instant() -> None:
    fleet = [wandering(seed, 150 + 90 * seed) for seed in range(16)]
    every = least_separation(fleet)
    assert [(p.first, p.second) for p in every] == list(combinations(range(16), 2))
    for pair in every:
        expected_m = least_at_breakpoints(fleet[pair.first], fleet[pair.second])
        assert pair.distance_m == pytest.approx(expected_m, abs=2e-7)
        apart_m = np.linalg.norm(fleet[pair.first].at(pair.t_s) - fleet[pair.second].at(pair.t_s))
        assert apart_m == pytest.approx(pair.distance_m, abs=1e-6)
        assert pair.first_m == pytest.approx(fleet[pair.first].at(pair.t_s))


@pytest.mark.parametrize("near_m", [1.0, 30.0, 120.0, 1e6])
def test_only_near_pairs_are_told_and_those_exactly(near_m: float) -> None:
    fleet = [wandering(seed, 200 + 90 * seed) for seed in range(16)]
    every = least_separation(fleet)
    near = least_separation(fleet, near_m)
    assert [(p.first, p.second) for p in near] == [(p.first, p.second) for p in every if p.distance_m < near_m]
    told = {(p.first, p.second): p.distance_m for p in every}
    assert [p.distance_m for p in near] == pytest.approx([told[p.first, p.second] for p in near], abs=2e-7)


def test_formations_are_nearest_at_first() -> None:
    one = wandering(3, 3000)
    lane = Trajectory(one.t_s, one.position_m + np.array([0.0, 40.0, 0.0]))
    (pair,) = least_separation([one, lane])
    assert pair.distance_m == pytest.approx(40.0, abs=1e-6)
