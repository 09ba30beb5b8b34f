"""What the sweep over boxes leaves out makes no difference: against all pairs, one by one."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from missionplanner.plan import Trajectory
from missionplanner.timing import lateness_slack, least_separation, least_slack, tightest_pair

seeds = st.integers(0, 2**32 - 1)
SAME_M = 2e-7  # of two that are nearest within a tenth of a micrometre either may be told


def crowd(seed: int, count: int, spread_m: float, *, grid: bool) -> list[Trajectory]:
    """Return flights that begin all over a square; on a grid of whole 10 m, where boxes touch and distances tie."""
    rng = np.random.default_rng(seed)
    tracks = []
    for _ in range(count):
        samples = int(rng.integers(1, 20))
        t_s = rng.uniform(0.0, 20.0) + np.cumsum(rng.uniform(0.05, 3.0, samples))
        start = np.array([*rng.uniform(0.0, spread_m, 2), 50.0])
        steps = start + np.cumsum(rng.normal(0.0, 6.0, (samples, 3)), axis=0)
        tracks.append(Trajectory(t_s, 10.0 * np.round(steps / 10.0) if grid else steps))
    return tracks


crowds = st.builds(crowd, seeds, st.integers(0, 12), st.sampled_from([20.0, 150.0, 600.0]), grid=st.booleans())


def needs(seed: int, count: int) -> Callable[[int, int], float]:
    """Return what each pair requires: something else for each, nothing for some."""
    table = np.round(np.random.default_rng(seed).uniform(-10.0, 40.0, (count + 1, count + 1)).clip(0.0))
    return lambda i, j: float(table[i, j])


@settings(deadline=None, max_examples=150)
@given(tracks=crowds, near_m=st.sampled_from([0.0, 5.0, 10.0, 20.0, 60.0]))
def test_near_pairs_are_those_of_all_that_are_near(tracks: list[Trajectory], near_m: float) -> None:
    every = {(p.first, p.second): p.distance_m for p in least_separation(tracks)}
    assert list(every) == list(combinations(range(len(tracks)), 2))
    near = {(p.first, p.second): p.distance_m for p in least_separation(tracks, near_m)}
    assert list(near) == sorted(near)
    assert set(near) >= {pair for pair, distance_m in every.items() if distance_m < near_m - SAME_M}
    assert set(near) <= {pair for pair, distance_m in every.items() if distance_m < near_m + SAME_M}
    for pair, distance_m in near.items():
        assert distance_m == pytest.approx(every[pair], abs=SAME_M)


@settings(deadline=None, max_examples=150)
@given(tracks=crowds, seed=seeds)
@example(tracks=crowd(144201, 12, 150.0, grid=False), seed=56)
def test_the_tightest_pair_is_that_of_all(tracks: list[Trajectory], seed: int) -> None:
    required_m = needs(seed, len(tracks))
    rooms = {(p.first, p.second): p.distance_m - required_m(p.first, p.second) for p in least_separation(tracks)}
    found = tightest_pair(tracks, required_m)
    if not rooms:
        assert found is None
        return
    assert found is not None
    room_m = found.distance_m - required_m(found.first, found.second)
    assert room_m == pytest.approx(min(rooms.values()), abs=SAME_M)
    assert rooms[found.first, found.second] == pytest.approx(room_m, abs=SAME_M)
    apart_m = np.linalg.norm(tracks[found.first].at(found.t_s) - tracks[found.second].at(found.t_s))
    assert apart_m == pytest.approx(found.distance_m, abs=1e-6)
    np.testing.assert_array_equal(found.first_m, tracks[found.first].at(found.t_s))


@settings(deadline=None, max_examples=60)
@given(tracks=crowds, seed=seeds, limit_s=st.sampled_from([5.0, 60.0]))
def test_slacks_are_those_of_pairs_alone(tracks: list[Trajectory], seed: int, limit_s: float) -> None:
    required_m = needs(seed, len(tracks))
    slacks = least_slack(tracks, required_m, limit_s)
    assert sorted((s.first, s.second) for s in slacks) == list(combinations(range(len(tracks)), 2))
    assert [s.slack_s for s in slacks] == sorted(s.slack_s for s in slacks)
    for s in slacks:
        # alone, the two have no others' time to wait in: a little longer or shorter, to the tolerance of the search
        alone_s = lateness_slack(tracks[s.first], tracks[s.second], required_m(s.first, s.second), limit_s)
        assert s.slack_s == pytest.approx(alone_s, abs=0.0101)
