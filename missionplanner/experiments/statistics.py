"""Which of several algorithms is better, from many runs: ranks, tests, intervals. Low values are good; ties are ties.

Rows are problems (or runs of a problem), columns are algorithms. Tests are SciPy's; what is here joins them: equal
values everywhere are no difference, and p-values of many comparisons are corrected by Holm's method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Friedman:
    """Mean ranks (K,), 1 the best, and the test that all K algorithms are alike."""

    ranks: FloatArray
    statistic: float
    p: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """One algorithm against another: where it is better, equal and worse; p as found and corrected for all pairs."""

    one: str
    other: str
    better: int
    equal: int
    worse: int
    p: float
    p_holm: float


def friedman(values: npt.ArrayLike) -> Friedman:
    """Rank K >= 2 algorithms on N problems (N, K); ties share their mean rank and are corrected for in the test."""
    table = np.asarray(values, dtype=float)
    rows, columns = table.shape
    ranks = stats.rankdata(table, axis=1)
    mean: FloatArray = ranks.mean(axis=0)
    middle = 0.5 * (columns + 1)
    scatter = float(((ranks - middle) ** 2).sum())
    if scatter == 0.0:
        return Friedman(mean, 0.0, 1.0)
    statistic = (columns - 1) * rows**2 * float(((mean - middle) ** 2).sum()) / scatter
    return Friedman(mean, statistic, float(stats.chi2.sf(statistic, columns - 1)))


def holm(p: npt.ArrayLike) -> FloatArray:
    """Return p-values (M,) corrected for M comparisons by Holm's step-down method."""
    found = np.asarray(p, dtype=float)
    order = np.argsort(found, kind="stable")
    stepped = np.maximum.accumulate(found[order] * np.arange(len(found), 0, -1))
    corrected = np.empty_like(found)
    corrected[order] = np.minimum(stepped, 1.0)
    return corrected


def signed_rank(one: npt.ArrayLike, other: npt.ArrayLike) -> float:
    """Return p of Wilcoxon's signed-rank test of paired values (N,); equal pairs say nothing."""
    first, second = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    differ = first != second
    if not differ.any():
        return 1.0
    return float(stats.wilcoxon(first[differ], second[differ]).pvalue)


def rank_sum(one: npt.ArrayLike, other: npt.ArrayLike) -> float:
    """Return p of Wilcoxon's rank-sum test of independent runs (N,), (M,), corrected for ties."""
    first, second = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    if np.unique(np.concatenate([first, second])).size == 1:
        return 1.0
    return float(stats.mannwhitneyu(first, second, method="asymptotic").pvalue)


def stratified_rank_sum(strata: Sequence[tuple[npt.ArrayLike, npt.ArrayLike]]) -> float:
    """Return p of van Elteren's test: rank sums of independent runs (N,), (M,) on several problems, taken together.

    Runs are ranked within their problem alone, so problems may be of any scale; ties are corrected for.
    """
    away = scatter = 0.0
    for one, other in strata:
        first, second = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
        n, m = len(first), len(second)
        ranks = stats.rankdata(np.concatenate([first, second]))
        away += float((ranks[:n] - 0.5 * (n + m + 1)).sum()) / (n + m + 1)
        scatter += n * m * float(ranks.var(ddof=1)) / (n + m) / (n + m + 1) ** 2
    return 1.0 if scatter == 0.0 else float(2.0 * stats.norm.sf(abs(away) / scatter**0.5))


def paired(values: npt.ArrayLike, names: Sequence[str], reference: str) -> list[Comparison]:
    """Compare ``reference`` with every other algorithm over the same problems (N, K), by signed ranks."""
    table = np.asarray(values, dtype=float)
    own = table[:, names.index(reference)]
    others = {name: table[:, k] for k, name in enumerate(names) if name != reference}
    p = [signed_rank(own, theirs) for theirs in others.values()]
    return [
        Comparison(
            reference,
            name,
            int((own < theirs).sum()),
            int((own == theirs).sum()),
            int((own > theirs).sum()),
            found,
            float(corrected),
        )
        for (name, theirs), found, corrected in zip(others.items(), p, holm(p), strict=True)
    ]


def median_interval(values: npt.ArrayLike, rng: np.random.Generator, level: float = 0.95) -> tuple[float, float]:
    """Return a bootstrapped interval (percentiles of 2,000 resamples) of the median of ``values`` (N,)."""
    found = np.asarray(values, dtype=float)
    medians = np.median(found[rng.integers(0, len(found), (2000, len(found)))], axis=1)
    low, high = np.quantile(medians, [0.5 - 0.5 * level, 0.5 + 0.5 * level], method="nearest")
    return float(low), float(high)
