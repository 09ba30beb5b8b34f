import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.search import algorithms, find_algorithm, minimise
from missionplanner.search.base import FloatArray
from missionplanner.search.pso_abc_sa import PsoAbcSa

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


def test_a_first_guess_is_priced_first_and_never_lost() -> None:
    guess = np.array([[0.3, 0.3]])
    result = minimise(sphere, [0, 0], [1, 1], evaluations=10, population=10, seed=0, initial=guess)
    np.testing.assert_array_equal(result.best, guess[0])


def test_more_first_guesses_than_particles() -> None:
    seen: list[FloatArray] = []

    def cost(x: FloatArray) -> FloatArray:
        seen.append(x)
        return sphere(x)

    guesses = np.linspace(-1, 2, 40).reshape(20, 2)
    minimise(cost, [0, 0], [1, 1], evaluations=4, population=4, seed=0, initial=guesses)
    np.testing.assert_allclose(seen[0], np.clip(guesses[:4], 0, 1), atol=1e-15)


def test_target_and_callback_stop_the_search() -> None:
    assert minimise(sphere, [0], [1], evaluations=10_000, seed=0, target=0.1).evaluations < 10_000
    calls: list[tuple[int, float]] = []

    def callback(evaluations: int, best_cost: float) -> bool:
        calls.append((evaluations, best_cost))
        return len(calls) == 3

    result = minimise(sphere, [0], [1], evaluations=10_000, seed=0, callback=callback)
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
    """50 particles into 3 groups (PAPER.md section 4): every one gets a candidate inside the box, every iteration."""
    rng = np.random.default_rng(0)
    swarm = PsoAbcSa(rng.random((50, 4)), 10, rng)
    for _ in range(60):
        points = swarm.ask()
        assert points.shape == (50, 4)
        assert ((points >= 0) & (points <= 1)).all()
        swarm.tell(sphere(points))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algorithm": "pso_abc_as"}, "there is no 'pso_abc_as'; did you mean pso-abc-sa"),
        ({"algorithm": "zzz"}, "expected one of pso-abc-sa, pso"),
        ({"population": 0}, "population: expected at least 1, got 0"),
        ({"evaluations": 0}, "evaluations: expected at least 1, got 0"),
        ({"lower": [0, 2]}, "expected finite lower <= upper, got 2 and 1 in dimension 1"),
        ({"upper": [1, np.nan]}, "expected finite lower <= upper, got 0 and nan in dimension 1"),
        ({"upper": [1]}, r"expected two arrays of one shape \(D,\), got \(2,\) and \(1,\)"),
        ({"initial": [[0.5]]}, r"initial: expected shape \(P0, D\) = \(any, 2\), got \(1, 1\)"),
        ({"initial": [[0.5, np.nan]]}, "initial: expected finite"),
        ({"cost": lambda x: sphere(x)[:, None]}, r"cost: expected shape \(P,\) = \(50,\), got \(50, 1\)"),
        ({"cost": lambda x: np.full(len(x), np.nan)}, r"cost: expected numbers, got only NaN \(100 points\)"),
    ],
)
def test_wrong_input_is_one_clear_line(change: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"cost": sphere, "lower": [0, 0], "upper": [1, 1], "evaluations": 100, "seed": 0}
    with pytest.raises(MissionError, match=message) as caught:
        minimise(**(arguments | change))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_every_algorithm_names_its_source() -> None:
    assert NAMES[0] == "pso-abc-sa"
    assert all(algorithm.source and find_algorithm(algorithm.name) is algorithm for algorithm in algorithms())
