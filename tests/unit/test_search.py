import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.search import algorithms, find_algorithm, minimise
from missionplanner.search.base import FloatArray

NAMES = [algorithm.name for algorithm in algorithms()]


def sphere(x: FloatArray) -> FloatArray:
    return ((x - 0.3) ** 2).sum(axis=1)


def eggholder(x: FloatArray) -> FloatArray:
    a, b = x.T
    return -(b + 47) * np.sin(np.sqrt(np.abs(a / 2 + b + 47))) - a * np.sin(np.sqrt(np.abs(a - b - 47)))


def colville(x: FloatArray) -> FloatArray:
    a, b, c, d = x.T
    return (
        100 * (a * a - b) ** 2
        + (a - 1) ** 2
        + (c - 1) ** 2
        + 90 * (c * c - d) ** 2
        + 10.1 * ((b - 1) ** 2 + (d - 1) ** 2)
        + 19.8 * (b - 1) * (d - 1)
    )


@pytest.mark.parametrize("name", NAMES)
def test_finds_the_bottom_of_a_bowl(name: str) -> None:
    result = minimise(sphere, [-5] * 5, [5] * 5, algorithm=name, evaluations=5000, seed=1)
    assert result.cost < 1e-3
    np.testing.assert_allclose(result.best, 0.3, atol=0.05)
    assert result.evaluations == 5000
    assert len(result.history) == len(result.history_evaluations)
    assert result.history_evaluations[-1] == 5000


def test_bees_escape_where_a_swarm_is_trapped() -> None:
    """Eggholder (f6), twelve seeds, the paper's budget: the hybrid finds the global minimum more often than PSO."""

    def hits(name: str) -> int:
        runs = [
            minimise(eggholder, [-512] * 2, [512] * 2, algorithm=name, evaluations=10_000, seed=seed)
            for seed in range(12)
        ]
        return sum(run.cost < -959.6 for run in runs)

    assert hits("pso-abc-sa") > hits("pso")


def test_reaches_the_papers_result_on_colville() -> None:
    """f9, the paper reports 0.0051871 for PSO-ABC-SA."""
    costs = [minimise(colville, [-10] * 4, [10] * 4, evaluations=10_000, seed=seed).cost for seed in range(9)]
    assert np.median(costs) < 0.0051871


def test_more_first_guesses_than_particles() -> None:
    seen: list[FloatArray] = []

    def cost(x: FloatArray) -> FloatArray:
        seen.append(x)
        return sphere(x)

    guesses = np.linspace(-1, 2, 40).reshape(20, 2)
    minimise(cost, [0, 0], [1, 1], evaluations=4, population=4, seed=0, initial=guesses)
    np.testing.assert_allclose(seen[0], np.clip(guesses[:4], 0, 1), atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_beats_random_search_on_a_bowl_off_the_middle(name: str) -> None:
    """Ten dimensions, 2,000 evaluations: far below the best of as many random points (sparrows least: a fifth)."""
    lower, upper = np.full(10, -1.0), np.full(10, 2.0)

    def bowl(x: FloatArray) -> FloatArray:
        return ((x - np.linspace(-0.5, 1.5, 10)) ** 2).sum(axis=1)

    found = [minimise(bowl, lower, upper, algorithm=name, evaluations=2000, seed=seed).cost for seed in range(5)]
    random = [bowl(np.random.default_rng(seed).uniform(lower, upper, (2000, 10))).min() for seed in range(5)]
    assert np.median(found) < 0.3 * np.median(random)


def test_whatever_ends_a_search_first() -> None:
    assert minimise(sphere, [0], [1], evaluations=10_000, seed=0, target=0.1).evaluations < 10_000
    assert minimise(lambda x: np.full(len(x), -np.inf), [0], [1], evaluations=99, population=9, seed=0).evaluations == 9
    assert (
        minimise(sphere, [0], [1], evaluations=10_000, population=20, seed=0, iterations=7, algorithm="pso").evaluations
        == 140
    )
    ticks = iter(range(100))
    timed = minimise(
        sphere,
        [0],
        [1],
        algorithm="pso",
        evaluations=10_000,
        population=20,
        seed=0,
        seconds=4.5,
        clock=lambda: float(next(ticks)),
    )
    assert timed.evaluations == 100  # the clock reads 0 at the start and 5 after the fifth generation
    calls: list[tuple[int, float]] = []

    def callback(evaluations: int, best_cost: float) -> bool:
        calls.append((evaluations, best_cost))
        return len(calls) == 3

    result = minimise(sphere, [0], [1], evaluations=10_000, population=50, seed=0, callback=callback, algorithm="pso")
    assert result.evaluations == 150
    assert calls[-1] == (150, result.cost)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("population", [1, 2, 3, 7])
def test_small_swarms_search_too(name: str, population: int) -> None:
    result = minimise(sphere, [0] * 2, [1] * 2, algorithm=name, evaluations=200, population=population, seed=3)
    assert result.evaluations == 200
    assert np.isfinite(result.cost)


@pytest.mark.parametrize("name", NAMES)
def test_nan_and_infinity_are_never_best(name: str) -> None:
    def holes(x: FloatArray) -> FloatArray:
        value = sphere(x)
        value[x[:, 0] < 0.5] = np.nan
        value[x[:, 1] < 0.5] = np.inf
        return value

    result = minimise(holes, [0, 0], [1, 1], algorithm=name, evaluations=3000, seed=0)
    np.testing.assert_allclose(result.best, 0.5, atol=0.02)
    assert np.isfinite(result.history[-1])


def test_dealing_covers_a_population_that_does_not_divide() -> None:
    """50 particles into 3 groups (PAPER.md section 4): every one gets a candidate, every iteration."""
    rng = np.random.default_rng(0)
    swarm = find_algorithm("pso-abc-sa-paper").make(rng.random((50, 4)), 3000, rng)
    for _ in range(60):
        points = swarm.ask()
        assert points.shape == (50, 4)
        assert len(np.unique(points, axis=0)) == 50
        swarm.tell(sphere(points))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algorithm": "pso_abc_as"}, "there is no 'pso_abc_as'; did you mean pso-abc-sa"),
        ({"algorithm": "zzz"}, "expected one of pso-abc-sa, pso"),
        ({"population": 0}, "population: expected at least 1, got 0"),
        ({"population": 2.5}, r"population: expected a whole number of at least 1, got 2.5"),
        ({"evaluations": 0}, "evaluations: expected at least 1, got 0"),
        ({"evaluations": 1e3}, "evaluations: expected a whole number of at least 1, got 1000.0"),
        ({"iterations": 0}, "iterations: expected at least 1, got 0"),
        ({"seconds": 0.0}, "seconds: expected above 0, got 0"),
        ({"seconds": np.nan}, "seconds: expected above 0, got nan"),
        ({"seed": -1}, "seed: expected at least 0, got -1"),
        ({"lower": "low"}, "lower: expected an array of numbers"),
        ({"lower": [-1e308, 0], "upper": [1e308, 1]}, "expected finite lower <= upper, got -1e.308 and 1e.308"),
        ({"cost": lambda _: "free"}, "cost: expected an array of numbers"),
        ({"lower": [0, 2]}, "expected finite lower <= upper, got 2 and 1 in dimension 1"),
        ({"upper": [1, np.nan]}, "expected finite lower <= upper, got 0 and nan in dimension 1"),
        ({"upper": [1]}, r"expected two arrays of one shape \(D,\), got \(2,\) and \(1,\)"),
        ({"initial": [[0.5]]}, r"initial: expected shape \(P0, D\) = \(any, 2\), got \(1, 1\)"),
        ({"initial": [[0.5, np.nan]]}, "initial: expected finite"),
        ({"cost": lambda x: sphere(x)[:, None]}, r"cost: expected shape \(P,\) = \(8,\), got \(8, 1\)"),
        ({"cost": lambda x: np.full(len(x), np.nan)}, r"cost: expected numbers, got only NaN \(\d+ points\)"),
    ],
)
def test_wrong_input_is_one_clear_line(change: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"cost": sphere, "lower": [0, 0], "upper": [1, 1], "evaluations": 100, "seed": 0}
    with pytest.raises(MissionError, match=message) as caught:
        minimise(**(arguments | change))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_every_algorithm_of_the_paper_is_there_with_its_source() -> None:
    swarms = ["pso-abc-sa", "pso-abc-sa-paper", "pso", "abc", "sa", "pso-sa", "abc-sa", "qpso"]
    rivals = ["ga", "pso-ga", "gwo", "ssa", "avoa", "gro", "swo", "coa"]
    assert sorted(NAMES) == sorted(swarms + rivals)
    assert NAMES[0] == "pso-abc-sa"
    assert len({algorithm.title for algorithm in algorithms()}) == len(NAMES)
    assert all(algorithm.source and find_algorithm(algorithm.name) is algorithm for algorithm in algorithms())
