"""The parts of PSO-ABC-SA's best form, each against what its docstring says."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.search import minimise
from missionplanner.search.base import FloatArray
from missionplanner.search.moves import accepted
from missionplanner.search.pso_abc_sa import (
    PsoAbcSa,
    PsoAbcSaSettings,
    _Bees,
    _Leader,
    groups_for,
    population_for,
    positive_cauchy,
)


def sphere(x: FloatArray) -> FloatArray:
    value: FloatArray = ((x - 0.3) ** 2).sum(axis=1)
    return value


def rugged(x: FloatArray) -> FloatArray:
    value: FloatArray = (10.0 * (x - 0.6) ** 2 - np.cos(20.0 * np.pi * (x - 0.6)) + 1.0).sum(axis=1)
    return value


def bees(dimensions: int = 6, evaluations: int = 4000, change: PsoAbcSaSettings | None = None) -> _Bees:
    rng = np.random.default_rng(1)
    first = rng.random((population_for(dimensions, evaluations), dimensions))
    return _Bees(first, evaluations, rng, change or PsoAbcSaSettings())


@given(st.integers(1, 200), st.integers(1, 10**6))
def test_first_populations_leave_time_for_generations(dimensions: int, evaluations: int) -> None:
    population, groups = population_for(dimensions, evaluations), groups_for(dimensions, evaluations)
    assert 1 <= groups <= 12
    assert population % groups == 0
    assert population >= 8
    assert population <= max(8 * groups, evaluations / 12)


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1.0), st.floats(1e-3, 1.0))
def test_learning_factors_are_above_zero_and_move_together(seed: int, one: float, other: float) -> None:
    middle = np.repeat([[one], [other]], 50, axis=1)
    drawn = positive_cauchy(np.random.default_rng(seed), middle)
    assert (drawn > 0.0).all()
    np.testing.assert_allclose(drawn[0] - one, drawn[1] - other, atol=1e-6 * np.abs(drawn).max())


def test_factors_and_shares_stay_in_their_bounds_whatever_is_learned() -> None:
    colony, rng = bees(), np.random.default_rng(2)
    colony.tell(sphere(colony.ask(0.0)))
    for k in range(60):
        colony.tell(rng.standard_cauchy(len(colony.ask(k / 60))) * 1e12)
        assert (colony._drawn > 0.0).all()
        assert (colony._drawn <= 1.0).all()
        assert (colony._memory > 0.0).all()
        assert (colony._memory <= 1.0).all()


def test_memories_learn_the_weighted_lehmer_mean() -> None:
    colony = bees(change=PsoAbcSaSettings(groups=False))
    colony.tell(sphere(colony.ask(0.0)))
    colony.ask(0.1)
    gain = np.zeros(len(colony.cost))
    gain[[2, 5]] = 3.0, 1.0
    drawn, before = colony._drawn[:, [2, 5]].copy(), colony._memory[:, 0, 0].copy()
    colony._learn_factors(gain)
    mean = (3.0 * drawn[:, 0] ** 2 + drawn[:, 1] ** 2) / (3.0 * drawn[:, 0] + drawn[:, 1])
    np.testing.assert_allclose(colony._memory[:, 0, 0], 0.5 * (before + mean), rtol=1e-12)
    np.testing.assert_array_equal(colony._memory[:, 0, -1], 0.9)


def test_every_group_shrinks_to_its_best_and_to_five_in_the_end() -> None:
    colony = bees(10, 20_000)
    colony.tell(sphere(colony.ask(0.0)))
    groups = len(np.unique(colony._group))
    assert groups > 1
    best = [colony.cost[colony._group == g].min() for g in range(groups)]
    sizes = []
    for progress in (0.05, 0.1, 0.2, 0.29):
        colony._shrink(progress)
        sizes.append(len(colony.cost))
        assert [colony.cost[colony._group == g].min() for g in range(groups)] == best
        assert np.ptp(np.bincount(colony._group)) == 0
    assert sizes == sorted(sizes, reverse=True)
    colony.ask(PsoAbcSaSettings().apart)
    assert not colony._group.any()
    colony._shrink(1.0)
    assert len(colony.cost) == PsoAbcSaSettings().smallest
    assert colony.cost.min() == min(best)


def test_groups_keep_apart_until_they_are_one() -> None:
    """A bee's fellows and its better one are of its own group."""
    colony = bees(10, 20_000)
    colony.tell(sphere(colony.ask(0.0)))
    better, one, _ = colony._fellows(0.2)
    np.testing.assert_array_equal(colony._group[better], colony._group)
    np.testing.assert_array_equal(colony._group[one], colony._group)
    assert (one != np.arange(len(one))).all()
    ranks = np.empty(len(one), dtype=int)
    for g in range(colony._groups):
        members = np.flatnonzero(colony._group == g)
        ranks[members[np.argsort(colony.cost[members])]] = np.arange(len(members))
    assert ranks[better].max() < 0.2 * len(one) / colony._groups + 1


def test_what_changes_as_a_block_is_a_block() -> None:
    colony = bees(12, 4000)
    colony.tell(sphere(colony.ask(0.0)))
    colony._block_share = 1.0
    for k in range(20):
        changed = colony.ask(0.01 * k) != colony.source
        edges = (changed != np.roll(changed, 1, axis=1)).sum(axis=1)
        assert (edges <= 2).all()


def test_sources_only_get_better() -> None:
    colony = bees()
    colony.tell(rugged(colony.ask(0.0)))
    for k in range(40):
        points = colony.ask(0.2)
        before = colony.cost.copy()
        colony.tell(rugged(points))
        assert (colony.cost <= before).all()
        np.testing.assert_allclose(rugged(colony.source), colony.cost, rtol=1e-12)
        assert ((points >= 0.0) & (points <= 1.0)).all(), k


def test_the_leader_finds_a_narrow_bent_valley() -> None:
    """Rosenbrock's function turned: what no coordinate alone improves."""
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.standard_normal((5, 5)))[0]

    def valley(x: FloatArray) -> FloatArray:
        y = (x - 0.5) @ turn * 4.0
        value: FloatArray = (100.0 * (y[:, 1:] - y[:, :-1] ** 2) ** 2 + (1.0 - y[:, :-1]) ** 2).sum(axis=1)
        return value

    around = 0.5 + 0.1 * rng.standard_normal((10, 5))
    leader = _Leader(around, float(valley(around).min()), rng)
    first = leader.best_cost
    for _ in range(600):
        leader.tell(valley(leader.ask()))
    assert leader.best_cost < 1e-9 < first


def test_a_leader_comes_to_rest_where_nothing_is_gained() -> None:
    leader = _Leader(np.random.default_rng(0).random((6, 2)), 0.0, np.random.default_rng(1))
    for _ in range(300):
        points = leader.ask()
        assert ((points >= 0.0) & (points <= 1.0)).all()
        leader.tell(np.ones(len(points)))
        if leader.rests:
            break
    assert leader.rests


@pytest.mark.parametrize("rise", [0.1, 1.0, 3.0])
def test_who_is_behind_flies_on_as_metropolis_says(rise: float) -> None:
    kept = accepted(np.random.default_rng(4), np.full(20_000, rise), np.zeros(20_000), 0.7)
    expected = np.exp(-rise / 0.7)
    assert abs(kept.mean() - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / 20_000)


@pytest.mark.parametrize(("annealing", "recalls"), [(True, False), (False, True)])
def test_hot_leaders_are_not_recalled(annealing: bool, recalls: bool) -> None:
    """Early, and little behind for the bees' spread, the Metropolis rule lets a leader fly on; without it, never."""
    rng = np.random.default_rng(5)
    search = PsoAbcSa(rng.random((30, 3)), 10**6, rng, PsoAbcSaSettings(annealing=annealing, groups=False))
    search.tell(np.linspace(0.0, 1.0, len(search.ask())))
    leader = search._bees.leader()
    leader.best_cost = 1e-6
    search._leader = leader
    search._behind = 10**6
    search._judge(leader)
    assert (search._leader is not leader) == recalls


def test_bees_are_alone_for_half_of_what_is_left_after_a_recall() -> None:
    rng = np.random.default_rng(5)
    search = PsoAbcSa(rng.random((30, 3)), 6000, rng, PsoAbcSaSettings(annealing=False, groups=False))
    search._used = 2000
    search._bees.tell(np.linspace(0.0, 1.0, 30))
    leader = search._leader = search._bees.leader()
    leader.best_cost = 1.0
    search._behind = 10**6
    search._judge(leader)
    search._used = 3999
    search.ask()
    assert search._leader is None
    search._used = 4000
    search.ask()
    assert search._leader is not None


def test_many_dimensions_are_searched_by_one_group() -> None:
    assert [groups_for(30, n) for n in (2500, 10_000, 100_000)] == [1, 1, 1]
    assert groups_for(6, 10_000) > 1
    assert groups_for(2, 10_000) == 12


def test_first_guesses_are_never_lost() -> None:
    guess = np.full((1, 8), 0.3)

    def needle(x: FloatArray) -> FloatArray:
        return np.where((x == 0.3).all(axis=1), -1.0, sphere(x))

    result = minimise(needle, np.zeros(8), np.ones(8), evaluations=3000, seed=0, initial=guess)
    np.testing.assert_array_equal(result.best, guess[0])


SWITCHES: list[dict[str, bool]] = [{}] + [
    {name: False} for name in ("groups", "memory", "archive", "blocks", "walls", "flight", "scouts")
]


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from([*SWITCHES, {"annealing": False}, {"shrink": 0.0}]),
    st.integers(1, 12),
    st.integers(1, 40),
    st.integers(0, 2**32 - 1),
)
def test_any_form_stays_in_the_box(change: dict[str, bool], dimensions: int, population: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    search = PsoAbcSa(rng.random((population, dimensions)), 600, rng, PsoAbcSaSettings(**change))
    used = 0
    with np.errstate(all="ignore"):
        while used < 600:
            points = search.ask()
            assert points.shape[1] == dimensions
            assert ((points >= 0.0) & (points <= 1.0)).all()
            cost = sphere(points)
            cost[rng.random(len(cost)) < 0.2] = np.inf
            search.tell(cost)
            used += len(points)


def test_narrow_and_rugged_bowls_are_searched_to_the_bottom() -> None:
    for dimensions, bound in ((2, 1e-20), (10, 1.5)):
        costs = [
            minimise(rugged, np.zeros(dimensions), np.ones(dimensions), evaluations=8000, seed=seed).cost
            for seed in range(5)
        ]
        assert np.median(costs) < bound
