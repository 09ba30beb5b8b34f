"""What holds for every optimiser of the registry, whatever it is asked to minimise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.errors import MissionError
from missionplanner.search import SearchResult, algorithms, find_algorithm, minimise
from missionplanner.search.base import FloatArray

NAMES = [algorithm.name for algorithm in algorithms()]
every_algorithm = pytest.mark.parametrize("name", NAMES)


def rugged(x: FloatArray) -> FloatArray:
    return (x**2).sum(axis=1) + np.sin(17 * x).sum(axis=1)


@every_algorithm
@settings(max_examples=12, deadline=None)
@given(
    evaluations=st.integers(1, 400),
    population=st.integers(1, 60) | st.none(),
    seed=st.integers(0, 2**32),
    box=st.tuples(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=6), st.floats(0, 1e3)),
)
def test_budget_box_history_and_repeatability(
    name: str, evaluations: int, population: int | None, seed: int, box: tuple[list[float], float]
) -> None:
    lower = np.array(box[0])
    upper = lower + box[1]
    priced: list[tuple[FloatArray, FloatArray]] = []

    def cost(x: FloatArray) -> FloatArray:
        priced.append((x, rugged(x)))
        return priced[-1][1]

    def search() -> SearchResult:
        return minimise(cost, lower, upper, algorithm=name, evaluations=evaluations, population=population, seed=seed)

    result = search()
    sizes = [len(x) for x, _ in priced]
    points = np.concatenate([x for x, _ in priced])
    assert len(points) == result.evaluations == evaluations
    assert min(sizes) > 0
    np.testing.assert_array_equal(result.history_evaluations, np.cumsum(sizes))
    assert ((points >= lower) & (points <= upper)).all()
    np.testing.assert_array_equal(result.history, np.minimum.accumulate([value.min() for _, value in priced]))
    assert result.cost == result.history[-1]
    assert rugged(result.best[None])[0] == result.cost
    again = search()
    np.testing.assert_array_equal(again.best, result.best)
    np.testing.assert_array_equal(again.history, result.history)


costs = st.sampled_from([0.0, 1.0, -1.0, 1e-300, 1e300, -1e300, np.finfo(float).max, -np.finfo(float).max]) | st.floats(
    -10.0, 10.0
)


@every_algorithm
@settings(max_examples=12, deadline=None)
@given(
    levels=st.lists(costs | st.just(np.inf) | st.just(np.nan), min_size=1, max_size=5),
    dimensions=st.integers(1, 4),
    population=st.integers(1, 30),
    seed=st.integers(0, 1000),
)
def test_no_price_is_too_odd(name: str, levels: list[float], dimensions: int, population: int, seed: int) -> None:
    """Plateaus, holes, costs near the largest number: points stay in the box, and the least number seen is found."""
    seen: list[FloatArray] = []

    def cost(x: FloatArray) -> FloatArray:
        assert ((x >= -1.0) & (x <= 1.0)).all()
        seen.append(np.array(levels)[(np.abs(x).sum(axis=1) * 1e3).astype(int) % len(levels)])
        return seen[-1]

    try:
        result = minimise(
            cost, [-1] * dimensions, [1] * dimensions, algorithm=name, evaluations=300, population=population, seed=seed
        )
    except MissionError as error:
        assert "got only NaN (300 points)" in str(error)
        assert np.isnan(np.concatenate(seen)).all()
        return
    assert result.evaluations == 300
    assert result.cost == np.nanmin(np.concatenate(seen))
    assert not np.isnan(result.history).any()


@every_algorithm
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 1000), power=st.integers(-8, 8))
def test_stretching_the_box_stretches_the_search(name: str, seed: int, power: int) -> None:
    """Powers of two scale without rounding: the same search, bit for bit, on a box of any size."""
    scale = 2.0**power
    low, high = np.array([-1.0, -2.0]), np.array([1.0, 2.0])
    plain = minimise(rugged, low, high, algorithm=name, evaluations=2000, seed=seed)
    stretched = minimise(
        lambda x: rugged(x / scale), low * scale, high * scale, algorithm=name, evaluations=2000, seed=seed
    )
    np.testing.assert_array_equal(stretched.history, plain.history)
    np.testing.assert_array_equal(stretched.best, plain.best * scale)


@every_algorithm
@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 1000), guess=st.lists(st.floats(0, 1), min_size=3, max_size=3))
def test_a_first_guess_is_priced_exactly_and_never_lost(name: str, seed: int, guess: list[float]) -> None:
    """A needle that only the guess touches."""
    needle = np.array(guess)

    def cost(x: FloatArray) -> FloatArray:
        return np.where((x == needle).all(axis=1), -1.0, x.sum(axis=1))

    found = minimise(cost, [0] * 3, [1] * 3, algorithm=name, evaluations=300, seed=seed, initial=needle[None])
    assert found.cost == -1.0
    np.testing.assert_array_equal(found.best, needle)


@every_algorithm
@settings(max_examples=4, deadline=None)
@given(seed=st.integers(0, 1000), dimensions=st.integers(1, 5))
def test_asking_and_telling_without_the_runner(name: str, seed: int, dimensions: int) -> None:
    """By ask and tell alone: the first points are the initial ones, every answer is in the unit box."""
    rng = np.random.default_rng(seed)
    initial = rng.random((12, dimensions))
    kept = initial.copy()
    optimiser = find_algorithm(name).make(initial, 600, rng)
    asked: list[FloatArray] = []
    for _ in range(30):
        points = optimiser.ask()
        assert points.shape[1] == dimensions
        assert len(points) > 0
        assert ((points >= 0) & (points <= 1)).all()
        asked.append(points.copy())
        with np.errstate(all="ignore"):
            optimiser.tell(rugged(points))
    np.testing.assert_array_equal(asked[0], kept)
    np.testing.assert_array_equal(initial, kept)
