"""The paper's test functions: their values by hand, their minima by a local search, shifted ones in their boxes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import optimize

from missionplanner.errors import MissionError
from missionplanner.experiments.test_functions import FUNCTIONS, BenchmarkFunction, find_function, shift

every = pytest.mark.parametrize("function", FUNCTIONS, ids=lambda f: f.name)


@every
def test_the_minimum_is_taken_at_the_minimiser(function: BenchmarkFunction) -> None:
    assert np.all((function.lower <= function.minimiser) & (function.minimiser <= function.upper))
    assert function.cost(function.minimiser[None])[0] == pytest.approx(function.minimum, rel=1e-12, abs=1e-12)


@every
def test_nothing_in_the_box_is_lower(function: BenchmarkFunction) -> None:
    """Not random points, not what a local search finds from the best of them or from the minimiser itself."""
    rng = np.random.default_rng(1)
    points = function.lower + rng.random((20_000, function.dimensions)) * (function.upper - function.lower)
    values = function.cost(points)
    least = function.minimum - 1e-12 * max(1.0, abs(function.minimum))
    assert values.shape == (20_000,)
    assert values.min() >= least
    box = list(zip(function.lower, function.upper, strict=True))
    for start in (points[np.argmin(values)], function.minimiser):
        found = optimize.minimize(lambda x: function.cost(x[None])[0], start, method="L-BFGS-B", bounds=box)
        assert found.fun >= least


@every
def test_rows_do_not_know_of_each_other(function: BenchmarkFunction) -> None:
    rng = np.random.default_rng(2)
    points = function.lower + rng.random((7, function.dimensions)) * (function.upper - function.lower)
    single = [function.cost(point[None])[0] for point in points]
    np.testing.assert_allclose(function.cost(points), single, rtol=1e-14)


def _plainly(name: str, x: list[float]) -> float:
    """Return a function's value as its textbook formula says, coordinate by coordinate."""
    match name:
        case "f1":
            return max(abs(v) for v in x)
        case "f2":
            a = (0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246)
            b = (4, 2, 1, 1 / 2, 1 / 4, 1 / 6, 1 / 8, 1 / 10, 1 / 12, 1 / 14, 1 / 16)
            return sum(
                (ai - x[0] * (bi**2 + bi * x[1]) / (bi**2 + bi * x[2] + x[3])) ** 2 for ai, bi in zip(a, b, strict=True)
            )
        case "f3":
            return 0.5 + (math.sin(x[0] ** 2 - x[1] ** 2) ** 2 - 0.5) / (1 + 0.001 * (x[0] ** 2 + x[1] ** 2)) ** 2
        case "f4-branin":
            bowl = x[1] - 5.1 * x[0] ** 2 / (4 * math.pi**2) + 5 * x[0] / math.pi - 6
            return bowl**2 + 10 * (1 - 1 / (8 * math.pi)) * math.cos(x[0]) + 10
        case "f6":
            return -(x[1] + 47) * math.sin(math.sqrt(abs(x[1] + x[0] / 2 + 47))) - x[0] * math.sin(
                math.sqrt(abs(x[0] - (x[1] + 47)))
            )
        case "f7":
            product = math.prod(math.cos(v / math.sqrt(k)) for k, v in enumerate(x, start=1))
            return 1 + sum(v * v for v in x) / 4000 - product
        case "f8":
            return (
                math.sin(3 * math.pi * x[0]) ** 2
                + (x[0] - 1) ** 2 * (1 + math.sin(3 * math.pi * x[1]) ** 2)
                + (x[1] - 1) ** 2 * (1 + math.sin(2 * math.pi * x[1]) ** 2)
            )
        case _:
            a, b, c, d = x
            return (
                100 * (a * a - b) ** 2
                + (a - 1) ** 2
                + (c - 1) ** 2
                + 90 * (c * c - d) ** 2
                + 10.1 * ((b - 1) ** 2 + (d - 1) ** 2)
                + 19.8 * (b - 1) * (d - 1)
            )


@pytest.mark.parametrize("name", ["f1", "f2", "f3", "f4-branin", "f6", "f7", "f8", "f9"])
def test_values_are_those_of_the_formula(name: str) -> None:
    function = find_function(name)
    rng = np.random.default_rng(3)
    points = function.lower + rng.random((50, function.dimensions)) * (function.upper - function.lower)
    np.testing.assert_allclose(function.cost(points), [_plainly(name, list(p)) for p in points], rtol=1e-9)


def test_known_values() -> None:
    """Of functions whose formula is a table of numbers: values published elsewhere."""
    goldstein, hartmann = find_function("f4-goldstein"), find_function("f5")
    # the other local minima of Goldstein-Price: 30 at (-0.6, -0.4), 84 at (1.8, 0.2), 840 at (1.2, 0.8)
    np.testing.assert_allclose(
        goldstein.cost(np.array([[-0.6, -0.4], [1.8, 0.2], [1.2, 0.8], [0.0, 0.0]])), [30.0, 84.0, 840.0, 600.0]
    )
    # Hartmann 6: its second minimum
    second = np.array([[0.40465313, 0.88244493, 0.84610160, 0.57398969, 0.13892673, 0.03849589]])
    assert hartmann.cost(second)[0] == pytest.approx(-3.20316, abs=1e-4)


def test_a_pole_is_no_minimum() -> None:
    """Where Kowalik's denominator vanishes there is no number to be best, and no warning."""
    b = 0.25
    assert find_function("f2").cost(np.array([[1.0, -b, 0.0, -b * b], [1.0, 1.0, 0.0, -b * b]])).tolist() == [
        np.inf,
        np.inf,
    ]


def test_shifted_optima_are_off_centre_and_inside() -> None:
    away = shift(100.0, 30)
    assert np.abs(away).max() <= 80.0
    assert away[:2] == pytest.approx([18.88543819998, -42.2291236])
    assert np.abs(away).mean() == pytest.approx(40.0, abs=2.0)
    plain, shifted = find_function("f1"), find_function("f1-shifted")
    points = np.random.default_rng(4).uniform(-20.0, 20.0, (9, 30))
    np.testing.assert_allclose(shifted.cost(points + away), plain.cost(points))
    assert shifted.cost(np.zeros((1, 30)))[0] > 70.0


def test_an_unknown_function_is_refused() -> None:
    with pytest.raises(MissionError, match=r"expected one of f1, f2.*got 'f99'"):
        find_function("f99")
