"""What is no input of a search is told in one line, whatever kind of thing it is."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from missionplanner.errors import MissionError
from missionplanner.search import minimise
from missionplanner.search.registry import algorithms, find_algorithm


def sphere(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    found: npt.NDArray[np.float64] = ((x - 0.5) ** 2).sum(axis=1)
    return found


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"algorithm": None}, "algorithm: expected a name, as 'pso-abc-sa', got None"),
        ({"algorithm": 3}, "algorithm: expected a name, as 'pso-abc-sa', got 3"),
        ({"seconds": "1"}, "seconds: expected a number, got '1'"),
        ({"target": "x"}, "target: expected a number, got 'x'"),
        ({"target": True}, "target: expected a number, got True"),
        ({"target": np.nan}, "target: expected a number, got nan"),
        ({"callback": 3}, "callback: expected a function, got 3"),
        ({"cost": None}, "cost: expected a function, got None"),
        ({"cost": lambda x: sphere(x) + 1j}, r"cost: expected an array of numbers \(they are complex\)"),
        ({"lower": [0j, 0j]}, r"lower: expected an array of numbers \(they are complex\)"),
        ({"population": 10**12}, "population: expected one that fits into memory, got 1000000000000"),
        ({"population": 10**30}, "population: expected one that fits into memory, got 1000000"),
    ],
)
def test_wrong_kinds_are_one_clear_line(change: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"cost": sphere, "lower": [0, 0], "upper": [1, 1], "evaluations": 100, "seed": 0}
    with pytest.raises(MissionError, match=message) as caught:
        minimise(**(arguments | change))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_whole_numbers_and_those_of_numpy_are_numbers() -> None:
    found = minimise(sphere, [0], [1], evaluations=100, seed=0, target=np.float64(0.0), seconds=100)
    assert found.evaluations == 100


@pytest.mark.parametrize("name", [a.name for a in algorithms()])
def test_iterations_are_calls_of_the_cost(name: str) -> None:
    calls = 0

    def cost(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        nonlocal calls
        calls += 1
        return sphere(x)

    found = minimise(cost, [0, 0], [1, 1], algorithm=name, evaluations=10_000, seed=1, iterations=7)
    assert calls == len(found.history) == 7
    assert find_algorithm(name).source
