"""Separation against dense sampling; arrival against the model."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.errors import InfeasibleError
from missionplanner.plan import Trajectory
from missionplanner.timing import arrival_after, arrival_window, common_arrival, least_separation, speed_for_arrival
from missionplanner.vehicle import MotionModel

COPTER = MotionModel("ardupilot", "copter", 2.5, 1.0, 2.5, 1.5, 2.0, 0.0)
seeds = st.integers(0, 2**32 - 1)


def wander(rng: np.random.Generator, count: int) -> Trajectory:
    t = np.cumsum(rng.uniform(0.01, 3.0, count))
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


@settings(deadline=None, max_examples=25)
@given(seed=seeds, share=st.floats(0.0, 1.0), spread_m=st.floats(20.0, 150.0))
def test_a_solved_speed_meets_its_time(seed: int, share: float, spread_m: float) -> None:
    rng = np.random.default_rng(seed)
    waypoints = np.cumsum(rng.normal(0.0, spread_m, (6, 3)) * [1, 1, 0.1], axis=0) + np.array([0, 0, 60])
    home = waypoints[0] - [0, 0, 30]
    fastest_s, slowest_s = arrival_window(COPTER, home, waypoints, 2.0, 10.0)
    wanted_s = fastest_s + share * (slowest_s - fastest_s)
    speed = speed_for_arrival(COPTER, home, waypoints, wanted_s, 2.0, 10.0)
    assert abs(arrival_after(COPTER, home, waypoints, speed) - wanted_s) <= 0.05


@given(
    windows=st.lists(st.tuples(st.floats(1, 1e3), st.floats(0, 1e3), st.floats(0, 100)), min_size=1, max_size=6),
)
def test_common_arrival_lies_in_every_window(windows: list[tuple[float, float, float]]) -> None:
    by_name = {f"v{k}": (fast, fast + more) for k, (fast, more, _) in enumerate(windows)}
    delay = {f"v{k}": d for k, (_, _, d) in enumerate(windows)}
    try:
        arrival_s = common_arrival(by_name, delay)
    except InfeasibleError:
        earliest = max(fast + delay[name] for name, (fast, _) in by_name.items())
        assert earliest > min(slow + delay[name] for name, (_, slow) in by_name.items())
        return
    for name, (fast, slow) in by_name.items():
        assert fast + delay[name] <= arrival_s <= slow + delay[name]
