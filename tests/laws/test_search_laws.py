import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.search import SearchResult, algorithms, minimise
from missionplanner.search.base import FloatArray

names = st.sampled_from([algorithm.name for algorithm in algorithms()])


def rugged(x: FloatArray) -> FloatArray:
    return (x**2).sum(axis=1) + np.sin(17 * x).sum(axis=1)


@settings(max_examples=40, deadline=None)
@given(
    name=names,
    evaluations=st.integers(1, 400),
    population=st.integers(1, 60),
    seed=st.integers(0, 2**32),
    box=st.tuples(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=6), st.floats(0, 1e3)),
)
def test_budget_box_history_and_repeatability(
    name: str, evaluations: int, population: int, seed: int, box: tuple[list[float], float]
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
    points = np.concatenate([x for x, _ in priced])
    assert len(points) == result.evaluations == evaluations
    assert ((points >= lower) & (points <= upper)).all()
    assert result.cost == min(value.min() for _, value in priced) == result.history[-1]
    assert rugged(result.best[None])[0] == result.cost
    assert (np.diff(result.history) <= 0).all()
    again = search()
    np.testing.assert_array_equal(again.best, result.best)
    np.testing.assert_array_equal(again.history, result.history)


@settings(max_examples=20, deadline=None)
@given(name=names, seed=st.integers(0, 1000), power=st.integers(-8, 8))
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
