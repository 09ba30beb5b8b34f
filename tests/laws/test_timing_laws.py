"""Separation and slack against dense sampling; arrival against the model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.plan import Trajectory
from missionplanner.schedule import solve_speed
from missionplanner.timing import lateness_slack, least_separation, least_slack, reached_times
from missionplanner.vehicle import MotionModel

COPTER = MotionModel("ardupilot", "copter", 2.5, 1.0, 2.5, 1.5, 2.0, 0.0)
seeds = st.integers(0, 2**32 - 1)


def wander(rng: np.random.Generator, count: int, least_s: float = 0.01) -> Trajectory:
    t = np.cumsum(rng.uniform(least_s, 3.0, count))
    return Trajectory(t, rng.normal(0.0, 30.0, 3) + np.cumsum(rng.normal(0.0, 5.0, (count, 3)), axis=0))


@settings(deadline=None, max_examples=100)
@given(seed=seeds, counts=st.tuples(st.integers(1, 30), st.integers(1, 30)))
def test_separation_is_the_least_of_all_instants(seed: int, counts: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    one, other = (wander(rng, n) for n in counts)
    (pair,) = least_separation([one, other])
    t = np.linspace(0.0, max(one.t_s[-1], other.t_s[-1]), 4001)
    sampled = np.linalg.norm(one.at(t) - other.at(t), axis=1)
    assert pair.distance_m <= sampled.min() + 1e-9
    assert np.linalg.norm(one.at(pair.t_s) - other.at(pair.t_s)) == pytest.approx(pair.distance_m, abs=1e-6)
    (swapped,) = least_separation([other, one])
    assert swapped.distance_m == pytest.approx(pair.distance_m, abs=1e-12)


STEP_S = 0.05


def sampled_slack(one: Trajectory, other: Trajectory, required_m: float, limit_s: float) -> float:
    """Return the least difference of all sampled times at which two are too close: never less than the true one."""
    begin, end = min(one.t_s[0], other.t_s[0]), max(one.t_s[-1], other.t_s[-1])
    t = np.linspace(begin, end, max(2, int((end - begin) / STEP_S) + 2))
    a, b = one.at(t), other.at(t)
    close = np.linalg.norm(a[:, None] - b[None], axis=-1) < required_m
    return float(min(np.abs(t[:, None] - t[None])[close].min(initial=limit_s), limit_s))


def fastest_m_s(flight: Trajectory) -> float:
    speeds = np.linalg.norm(np.diff(flight.position_m, axis=0), axis=1) / np.diff(flight.t_s)
    return float(speeds.max(initial=0.0))


def flights(longest: int) -> st.SearchStrategy[Trajectory]:
    """Short motions, with standing still, turning back and equal times now and then."""
    spot = st.tuples(st.integers(-40, 40), st.integers(-40, 40), st.integers(0, 20))
    pause = st.sampled_from([0.5, 1.0, 1.7, 4.0, 20.0])

    def flown(start: int, hops: list[tuple[tuple[int, int, int], float]], home: tuple[int, int, int]) -> Trajectory:
        t = start + np.concatenate([[0.0], np.cumsum([s for _, s in hops])])
        return Trajectory(t, np.array([home, *(p for p, _ in hops)], dtype=float))

    return st.builds(flown, st.integers(0, 30), st.lists(st.tuples(spot, pause), max_size=longest), spot)


def assert_within_sampling(one: Trajectory, other: Trajectory, required_m: float, limit_s: float) -> None:
    slack_s = lateness_slack(one, other, required_m, limit_s)
    assert slack_s <= sampled_slack(one, other, required_m, limit_s) + 1e-9
    # no further below the truth than told: what is too close at any times is nearly so at sampled ones
    wider_m = required_m + STEP_S * (fastest_m_s(one) + fastest_m_s(other)) + 1e-6
    assert slack_s >= sampled_slack(one, other, wider_m, limit_s + 1.0) - 2 * STEP_S - 0.01 or slack_s == limit_s
    assert 0.0 <= slack_s <= limit_s


@settings(deadline=None, max_examples=60)
@given(one=flights(6), other=flights(6), required_m=st.floats(0.5, 60.0), limit_s=st.sampled_from([5.0, 60.0]))
def test_slack_is_the_least_difference_of_times_too_close(
    one: Trajectory, other: Trajectory, required_m: float, limit_s: float
) -> None:
    assert_within_sampling(one, other, required_m, limit_s)


def assert_apart_up_to(slack_s: float, one: Trajectory, other: Trajectory, required_m: float, late_s: float) -> None:
    """Whoever is late by no more than the slack keeps apart; by hardly more, some time or other, does not."""

    def nearest_m(by_s: float) -> float:
        return least_separation([Trajectory(one.t_s + by_s, one.position_m), other])[0].distance_m

    if slack_s > 0.0:
        assert nearest_m(late_s * slack_s) >= required_m - 2e-6
    if slack_s < 59.9:
        beyond_s = slack_s + np.linspace(0.0, 0.02, 9)
        hardly_m = 0.0013 * (fastest_m_s(one) + fastest_m_s(other))
        assert min(nearest_m(by_s) for by_s in [*beyond_s, *-beyond_s]) < required_m + hardly_m


@settings(deadline=None, max_examples=60)
@given(one=flights(8), other=flights(8), required_m=st.floats(0.5, 60.0), late_s=st.floats(-1.0, 1.0))
def test_whoever_is_late_by_no_more_than_the_slack_keeps_apart(
    one: Trajectory, other: Trajectory, required_m: float, late_s: float
) -> None:
    assert_apart_up_to(lateness_slack(one, other, required_m), one, other, required_m, late_s)


@settings(deadline=None, max_examples=100)
@given(seed=seeds, counts=st.tuples(st.integers(1, 90), st.integers(1, 90)), late_s=st.floats(-1.0, 1.0))
def test_slack_of_long_flights_too(seed: int, counts: tuple[int, int], late_s: float) -> None:
    rng = np.random.default_rng(seed)
    one, other = (wander(rng, n, least_s=0.5) for n in counts)
    required_m = rng.uniform(0.5, 30.0)
    assert_apart_up_to(lateness_slack(one, other, required_m), one, other, required_m, late_s)


@settings(deadline=None, max_examples=40)
@given(one=flights(8), other=flights(8), required_m=st.floats(0.5, 60.0), more_m=st.floats(0.0, 20.0))
def test_slack_is_the_same_either_way_and_less_for_more_distance(
    one: Trajectory, other: Trajectory, required_m: float, more_m: float
) -> None:
    slack_s = lateness_slack(one, other, required_m)
    assert lateness_slack(other, one, required_m) == pytest.approx(slack_s, abs=0.011)
    assert lateness_slack(one, other, required_m + more_m) <= slack_s + 0.011


@settings(deadline=None, max_examples=20)
@given(fleet=st.lists(flights(8), min_size=2, max_size=5), required_m=st.floats(0.5, 60.0))
def test_a_fleets_slack_is_that_of_its_pairs(fleet: list[Trajectory], required_m: float) -> None:
    found = least_slack(fleet, lambda i, j: required_m + i + j)
    assert len(found) == len(fleet) * (len(fleet) - 1) // 2
    assert [s.slack_s for s in found] == sorted(s.slack_s for s in found)
    for slack in found:
        alone_s = lateness_slack(fleet[slack.first], fleet[slack.second], required_m + slack.first + slack.second)
        assert slack.slack_s == pytest.approx(alone_s, abs=0.011)


@settings(deadline=None, max_examples=25)
@given(seed=seeds, share=st.floats(0.0, 1.0), spread_m=st.floats(20.0, 150.0))
def test_a_solved_speed_meets_its_time(seed: int, share: float, spread_m: float) -> None:
    rng = np.random.default_rng(seed)
    waypoints = np.cumsum(rng.normal(0.0, spread_m, (6, 3)) * [1, 1, 0.1], axis=0) + np.array([0, 0, 60])
    home = waypoints[0] - [0, 0, 30]

    def arrives_s(speed_m_s: float) -> float:
        return float(reached_times(COPTER, home, waypoints, speed_m_s)[-1])

    wanted_s = arrives_s(10.0) + share * (arrives_s(2.0) - arrives_s(10.0))
    assert abs(arrives_s(solve_speed(lambda v: arrives_s(v) - wanted_s, 2.0, 10.0)) - wanted_s) <= 0.05
