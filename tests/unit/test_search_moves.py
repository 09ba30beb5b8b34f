import math

import numpy as np
import pytest

from missionplanner.search.moves import (
    accepted,
    centred,
    fitness,
    levy,
    median,
    others,
    roulette,
    spread,
    tournament,
    uncentred,
)


@pytest.mark.parametrize("population", [1, 2, 3, 4, 50])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_others_are_not_oneself_and_all_different_if_there_are_enough(population: int, count: int) -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        picked = others(rng, population, count)
        assert picked.shape == (count, population)
        assert ((picked >= 0) & (picked < population)).all()
        if population > count:
            together = np.vstack([np.arange(population), picked])
            assert all(len(set(column)) == count + 1 for column in together.T)


def test_others_are_drawn_evenly() -> None:
    rng = np.random.default_rng(1)
    first = np.concatenate([others(rng, 5, 2)[:, 0] for _ in range(4000)])
    counts = np.bincount(first, minlength=5)
    assert counts[0] == 0
    np.testing.assert_allclose(counts[1:] / 8000, 0.25, atol=0.03)


def test_roulette_is_proportional_and_survives_odd_weights() -> None:
    rng = np.random.default_rng(0)
    counts = np.bincount(roulette(rng, np.array([1.0, 0.0, 3.0]), 20_000), minlength=3)
    assert counts[1] == 0
    np.testing.assert_allclose(counts[2] / 20_000, 0.75, atol=0.02)
    for weight in ([0.0, 0.0], [np.inf, 1.0], [1e308, 1e308]):
        assert set(roulette(rng, np.array(weight), 100)) == {0, 1}


def test_metropolis_accepts_as_often_as_boltzmann_says() -> None:
    rng = np.random.default_rng(0)
    rise, temperature = 2.0, 1.5
    kept = accepted(rng, np.full(50_000, 7.0 + rise), np.full(50_000, 7.0), temperature)
    np.testing.assert_allclose(kept.mean(), math.exp(-rise / temperature), atol=0.01)
    new, old = np.array([1.0, 2.0, 3.0, np.inf, np.inf]), np.array([2.0, 2.0, np.inf, 2.0, np.inf])
    for cold in (0.0, 1e-12):
        np.testing.assert_array_equal(accepted(rng, new, old, cold), [True, True, True, False, True])


def test_fitness_falls_with_cost() -> None:
    cost = np.array([-5.0, -0.5, 0.0, 0.5, 5.0, np.inf])
    assert (np.diff(fitness(cost)) < 0).all()
    np.testing.assert_allclose(fitness(cost), [6.0, 1.5, 1.0, 1 / 1.5, 1 / 6, 0.0])


def test_the_better_wins_three_of_four_tournaments() -> None:
    won = tournament(np.random.default_rng(0), np.array([2.0, 1.0]), 20_000)
    np.testing.assert_allclose(won.mean(), 0.75, atol=0.02)


def test_spread_counts_finite_costs_only() -> None:
    assert spread(np.array([1.0, 2.0, 4.0, np.inf])) == 1.0
    assert spread(np.array([np.inf, np.inf])) == 0.0
    assert median(np.array([4.0, 1.0, 2.0, 3.0])) == 2.5


def test_levy_steps_have_heavy_tails() -> None:
    """Mantegna's steps follow the law of exponent 1.5 in their tails: four times as far is an eighth as likely."""
    step = np.abs(levy(np.random.default_rng(0), (1_000_000,)))
    np.testing.assert_allclose((step > 40).mean() / (step > 10).mean(), 4**-1.5, rtol=0.1)


def test_centred_coordinates_are_undone() -> None:
    unit = np.linspace(0, 1, 11)
    np.testing.assert_allclose(uncentred(centred(unit)), unit, atol=1e-15)
    np.testing.assert_array_equal(centred(np.array([0.0, 0.5, 1.0])), [-100.0, 0.0, 100.0])
