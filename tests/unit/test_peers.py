"""Searches of other libraries are counted exactly, whatever they do with budgets; and ours beside them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missionplanner.errors import MissionError
from missionplanner.experiments import contenders
from missionplanner.experiments.contenders import PEERS, BudgetSpent, Contender, Tally, find_contender, ours

LOWER, UPPER = np.full(3, -4.0), np.array([6.0, 5.0, 7.0])


def bowl(points: np.ndarray) -> np.ndarray:
    assert points.ndim == 2
    assert np.all((points >= LOWER) & (points <= UPPER)), "priced outside the box"
    return ((points - [1.0, -1.0, 2.0]) ** 2).sum(axis=1)


class Recorder:
    """A price that remembers all that it was asked."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []

    def __call__(self, points: np.ndarray) -> np.ndarray:
        self.rows += list(points.copy())
        return bowl(points)


@given(st.lists(st.integers(1, 9), min_size=1, max_size=12), st.integers(1, 40), st.integers(0, 2**32))
def test_the_count_is_exact(batches: list[int], budget: int, seed: int) -> None:
    """However it is asked, a tally prices the first points up to its budget, and its best is the best of those."""
    rng = np.random.default_rng(seed)
    asked = [rng.uniform(-6.0, 8.0, (size, 3)) for size in batches]
    record = Recorder()
    tally = Tally(record, LOWER, UPPER, budget)
    ended = False
    for points in asked:
        try:
            np.testing.assert_array_equal(tally.batch(points), bowl(np.clip(points, LOWER, UPPER)))
        except BudgetSpent:
            ended = True
            break
    everything = np.clip(np.concatenate(asked), LOWER, UPPER)
    within = everything[:budget]
    assert ended == tally.spent == (len(everything) > budget)
    assert tally.used == len(record.rows) == len(within)
    np.testing.assert_array_equal(record.rows, within)
    assert tally.cost == bowl(within).min()
    np.testing.assert_array_equal(tally.best, within[np.argmin(bowl(within))])


def test_the_curve_falls_to_the_cost_at_the_evaluation_that_found_it() -> None:
    costs = np.array([5.0, 7.0, 3.0, np.nan, 3.0, 1.0, np.inf, 2.0])
    given_costs = iter(costs)
    tally = Tally(lambda points: [next(given_costs) for _ in points], LOWER, UPPER, 8)
    for size in (1, 4, 3):
        tally.batch(np.zeros((size, 3)))
    used, _, cost = zip(*tally.curve, strict=True)
    assert used == (1, 3, 6)
    assert cost == (5.0, 3.0, 1.0)
    assert not tally.spent
    with pytest.raises(BudgetSpent):
        tally.single(np.zeros(3))
    assert tally.spent


def test_time_ends_a_search_too() -> None:
    now = iter(range(100))
    tally = Tally(bowl, LOWER, UPPER, 1000, seconds=5.0, clock=lambda: float(next(now)))
    with pytest.raises(BudgetSpent):
        for _ in range(50):
            tally.single(np.zeros(3))
    assert 1 <= tally.used <= 5


@pytest.mark.parametrize("contender", [*PEERS, *ours()[:2]], ids=lambda c: c.name)
@pytest.mark.filterwarnings("ignore")  # of other libraries
def test_everybody_keeps_to_the_budget_and_repeats(contender: Contender) -> None:
    """And learns: better than random points, a sixth as many. The budget is no multiple of any population."""
    if not contender.installed:
        pytest.skip(f"{contender.library} is not installed: {contenders.INSTALL}")
    found = []
    for _ in range(2):
        record = Recorder()
        tally = contender.run(record, LOWER, UPPER, evaluations=613, seed=5)
        assert tally.used == len(record.rows) <= 613
        assert tally.used >= 400, "ended early"
        assert tally.cost == bowl(np.array(record.rows)).min() == bowl(tally.best[None])[0]
        found.append(record.rows)
    np.testing.assert_array_equal(found[0], found[1])
    random = np.random.default_rng(5).uniform(LOWER, UPPER, (100, 3))
    assert tally.cost < bowl(random).min()
    other = contender.run(bowl, LOWER, UPPER, evaluations=613, seed=6)
    assert not np.array_equal(other.best, tally.best) or other.cost == 0.0


def test_an_error_of_the_function_is_not_taken_for_the_end() -> None:
    def broken(points: np.ndarray) -> np.ndarray:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        find_contender("scipy DE").run(broken, LOWER, UPPER, evaluations=100, seed=1)


def test_who_is_absent_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    absent = Contender("nowhere X", "no-such-library", find_contender("scipy DE").search)
    assert not absent.installed
    with pytest.raises(MissionError, match=r"nowhere X: expected no-such-library.*missionplanner\[peers\]"):
        absent.run(bowl, LOWER, UPPER, evaluations=10, seed=1)
    with pytest.raises(MissionError, match="did you mean"):
        find_contender("pso-abc")


def test_digests_tell_algorithms_and_settings_apart() -> None:
    """Each its own: rerunning one after a change leaves the runs of all others valid."""
    present = [c for c in (*ours(), *PEERS) if c.installed]
    digests = [c.digest() for c in present]
    assert digests == [c.digest() for c in present]
    assert len(set(digests)) == len({repr(c.search) for c in present})
