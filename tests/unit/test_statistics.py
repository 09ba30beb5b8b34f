"""Ranks and tests: against SciPy, by hand, and where nothing differs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from missionplanner.experiments.statistics import (
    friedman,
    holm,
    median_interval,
    paired,
    rank_sum,
    signed_rank,
    stratified_rank_sum,
)

tables = arrays(np.float64, st.tuples(st.integers(2, 12), st.integers(3, 6)), elements=st.integers(0, 5).map(float))


@given(tables)
def test_friedman_is_scipys(values: np.ndarray) -> None:
    found = friedman(values)
    assert found.ranks.sum() == pytest.approx(values.shape[1] * (values.shape[1] + 1) / 2)
    if (values == values[:, :1]).all():
        assert (found.statistic, found.p) == (0.0, 1.0)
        return
    expected = stats.friedmanchisquare(*values.T)
    assert found.statistic == pytest.approx(expected.statistic, rel=1e-9, abs=1e-9)
    assert found.p == pytest.approx(expected.pvalue, rel=1e-6, abs=1e-12)


def test_friedman_by_hand() -> None:
    """Three problems, two algorithms; one problem is a tie. R = (1.17, 1.83), T = 1 * 9 * 2 (1/3)^2 / 1 = 2."""
    found = friedman([[1.0, 2.0], [0.5, 0.7], [3.0, 3.0]])
    assert found.ranks == pytest.approx([7 / 6, 11 / 6])
    assert found.statistic == pytest.approx(2.0)
    assert found.p == pytest.approx(stats.chi2.sf(2.0, 1))


def test_a_failure_without_a_price_ranks_last() -> None:
    assert friedman([[np.inf, 1.0, 2.0], [np.inf, np.inf, 0.0]]).ranks == pytest.approx([2.75, 1.75, 1.5])


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.6]) == pytest.approx([1.0, 1.0])
    assert holm([]).tolist() == []


def test_equal_values_are_no_difference() -> None:
    same = [1.0, 2.0, 3.0]
    assert signed_rank(same, same) == 1.0
    assert rank_sum([2.0, 2.0], [2.0, 2.0, 2.0]) == 1.0
    assert friedman(np.ones((4, 3))).p == 1.0


def test_tests_are_scipys() -> None:
    rng = np.random.default_rng(5)
    one, other = rng.normal(0.0, 1.0, 30), rng.normal(0.5, 1.0, 30)
    assert signed_rank(one, other) == pytest.approx(stats.wilcoxon(one, other).pvalue)
    assert rank_sum(one, other) == pytest.approx(stats.ranksums(one, other).pvalue, rel=0.05)
    ties = np.concatenate([one, [0.3, 0.3]]), np.concatenate([other, [0.3, 0.3]])
    assert signed_rank(*ties) == pytest.approx(signed_rank(one, other))


def test_comparisons_are_corrected_together() -> None:
    values = np.array(
        [[1.0, 2.0, 1.0], [1.0, 3.0, 0.5], [2.0, 4.0, 3.0], [1.0, 5.0, 2.0], [0.0, 1.0, 0.0], [1.0, 9.0, 2]]
    )
    b, c = paired(values, ["a", "b", "c"], "a")
    assert (b.one, b.other, b.better, b.equal, b.worse) == ("a", "b", 6, 0, 0)
    assert (c.other, c.better, c.equal, c.worse) == ("c", 3, 2, 1)
    assert b.p == pytest.approx(2 / 2**6)  # all six of one sign
    assert [b.p_holm, c.p_holm] == pytest.approx(holm([b.p, c.p]))


def test_the_median_is_within_its_interval() -> None:
    """And the interval holds the true median about as often as it says."""
    rng = np.random.default_rng(6)
    held = 0
    for _ in range(200):
        sample = rng.normal(10.0, 2.0, 25)
        low, high = median_interval(sample, rng)
        assert low <= np.median(sample) <= high
        held += low <= 10.0 <= high
    assert 180 <= held <= 200


@given(st.integers(0, 2**32), st.integers(2, 9), st.integers(2, 9))
def test_rank_sums_of_one_problem_are_scipys(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = rng.integers(0, 6, n), rng.integers(0, 6, m)
    if np.unique([*one, *other]).size == 1:
        assert stratified_rank_sum([(one, other)]) == 1.0
        return
    expected = stats.mannwhitneyu(one, other, method="asymptotic", use_continuity=False).pvalue
    assert stratified_rank_sum([(one, other)]) == pytest.approx(expected, rel=1e-9)


def test_rank_sums_of_several_problems_are_right_by_chance() -> None:
    """Runs alike in law, problems of other scales: p is below 5 % in about 5 of 100; better in all, it is small."""
    rng = np.random.default_rng(4)
    scale = np.array([1.0, 1e3, 1e6])[:, np.newaxis]
    p = []
    for _ in range(2000):
        one, other = scale * rng.exponential(size=(3, 7)), scale * rng.exponential(size=(3, 8))
        p.append(stratified_rank_sum(list(zip(one, other, strict=True))))
    assert 0.035 <= np.mean(np.array(p) < 0.05) <= 0.065
    one, other = scale * rng.exponential(size=(3, 7)), scale * (1.0 + rng.exponential(size=(3, 8)))
    assert stratified_rank_sum(list(zip(one, other, strict=True))) < 1e-3
