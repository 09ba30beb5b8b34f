"""The paper's test functions f1 to f9 (PAPER.md Table I), with both readings of f4, and shifted f1, f3 and f7.

The paper prints Branin as f4 and reports the minimum of Goldstein-Price: both are here. Its range for f4, [-5, 5], is
kept for Goldstein-Price; Branin has its usual box, in which all three of its minimisers lie. f7's dimension is not
given: 30. The optimum of f1, f3 and f7 is the centre of their boxes, which flatters optimisers that contract to it:
shifted, it is at :func:`shift` instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from missionplanner.errors import MissionError

FloatArray = npt.NDArray[np.float64]

_GOLDEN = 0.6180339887498949
_SHIFTED_SHARE = 0.8  # of half the box: a shifted optimum keeps a tenth of the box to every wall

_KOWALIK_A = np.array([0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246])
_KOWALIK_B = 1.0 / np.array([0.25, 0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0])
_HARTMANN_ALPHA = np.array([1.0, 1.2, 3.0, 3.2])
_HARTMANN_A = np.array(
    [[10, 3, 17, 3.5, 1.7, 8], [0.05, 10, 17, 0.1, 8, 14], [3, 3.5, 1.7, 10, 17, 8], [17, 8, 0.05, 10, 0.1, 14]]
)
_HARTMANN_P = 1e-4 * np.array(
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ]
)


@dataclass(frozen=True, slots=True, eq=False)
class BenchmarkFunction:
    """A function to minimise over a box, and where its least value is known to be.

    Attributes
    ----------
    cost : takes points (P, D), returns their values (P,).
    lower, upper : (D,) the box.
    minimum : the least value in the box.
    minimiser : (D,) where it is taken, to about 1e-8 of the box; one of several in places.
    rounding : what is so little above the minimum is so by the rounding of the function's own terms or coordinates.
    """

    name: str
    title: str
    cost: Callable[[FloatArray], FloatArray]
    lower: FloatArray
    upper: FloatArray
    minimum: float
    minimiser: FloatArray
    rounding: float

    @property
    def dimensions(self) -> int:
        """The number of coordinates."""
        return len(self.lower)

    @property
    def label(self) -> str:
        """The paper's name and the usual one."""
        return f"{self.name.partition('-')[0]} {self.title}"


def schwefel_2_21(x: FloatArray) -> FloatArray:
    """f1: the largest coordinate by magnitude."""
    found: FloatArray = np.abs(x).max(axis=1)
    return found


def kowalik(x: FloatArray) -> FloatArray:
    """f2: misfit of a rational function to eleven data; a pole is infinitely bad."""
    x1, x2, x3, x4 = (x[:, k, None] for k in range(4))
    b = _KOWALIK_B
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        misfit = ((_KOWALIK_A - x1 * (b * b + b * x2) / (b * b + b * x3 + x4)) ** 2).sum(axis=1)
    return np.where(np.isnan(misfit), np.inf, misfit)


def schaffer_2(x: FloatArray) -> FloatArray:
    """f3: rings around the origin."""
    u, v = x[:, 0] ** 2, x[:, 1] ** 2
    return 0.5 + (np.sin(u - v) ** 2 - 0.5) / (1.0 + 0.001 * (u + v)) ** 2


def branin(x: FloatArray) -> FloatArray:
    """f4 as printed: three equal minima."""
    u, v = x[:, 0], x[:, 1]
    bowl = v - 5.1 / (4.0 * np.pi**2) * u**2 + 5.0 / np.pi * u - 6.0
    return bowl**2 + 10.0 * (1.0 - 1.0 / (8.0 * np.pi)) * np.cos(u) + 10.0


def goldstein_price(x: FloatArray) -> FloatArray:
    """f4 as its results say: 3 at (0, -1)."""
    u, v = x[:, 0], x[:, 1]
    one = 1.0 + (u + v + 1.0) ** 2 * (19.0 - 14.0 * u + 3.0 * u**2 - 14.0 * v + 6.0 * u * v + 3.0 * v**2)
    two = 30.0 + (2.0 * u - 3.0 * v) ** 2 * (18.0 - 32.0 * u + 12.0 * u**2 + 48.0 * v - 36.0 * u * v + 27.0 * v**2)
    return one * two


def hartmann_6(x: FloatArray) -> FloatArray:
    """f5: four dents in six dimensions."""
    away = (_HARTMANN_A * (x[:, None, :] - _HARTMANN_P) ** 2).sum(axis=2)
    found: FloatArray = -(np.exp(-away) @ _HARTMANN_ALPHA)
    return found


def eggholder(x: FloatArray) -> FloatArray:
    """f6: least on the box's wall."""
    u, v = x[:, 0], x[:, 1] + 47.0
    found: FloatArray = -v * np.sin(np.sqrt(np.abs(0.5 * u + v))) - u * np.sin(np.sqrt(np.abs(u - v)))
    return found


def griewank(x: FloatArray) -> FloatArray:
    """f7: a bowl with a regular grid of dents."""
    waves = np.cos(x / np.sqrt(np.arange(1.0, x.shape[1] + 1.0))).prod(axis=1)
    found: FloatArray = (x**2).sum(axis=1) / 4000.0 - waves + 1.0
    return found


def levy_13(x: FloatArray) -> FloatArray:
    """f8: rough along both coordinates."""
    u, v = x[:, 0], x[:, 1]
    one = np.sin(3.0 * np.pi * u) ** 2 + (u - 1.0) ** 2 * (1.0 + np.sin(3.0 * np.pi * v) ** 2)
    return one + (v - 1.0) ** 2 * (1.0 + np.sin(2.0 * np.pi * v) ** 2)


def colville(x: FloatArray) -> FloatArray:
    """f9: two coupled curved valleys."""
    a, b, c, d = x.T
    valleys = 100.0 * (a**2 - b) ** 2 + (a - 1.0) ** 2 + (c - 1.0) ** 2 + 90.0 * (c**2 - d) ** 2
    found: FloatArray = valleys + 10.1 * ((b - 1.0) ** 2 + (d - 1.0) ** 2) + 19.8 * (b - 1.0) * (d - 1.0)
    return found


def shift(half_width: float, dimensions: int) -> FloatArray:
    """Return where a shifted optimum is (D,): multiples of the golden ratio, spread evenly over the box's inner 80 %.

    Coordinate d = 1, 2, ... is ``0.8 half_width (2 frac(0.618... d) - 1)``: published by this formula.
    """
    share = np.modf(_GOLDEN * np.arange(1.0, dimensions + 1.0))[0]
    away: FloatArray = _SHIFTED_SHARE * half_width * (2.0 * share - 1.0)
    return away


def _function(
    name: str,
    title: str,
    cost: Callable[[FloatArray], FloatArray],
    lower: float | list[float],
    upper: float | list[float],
    minimum: float,
    minimiser: list[float],
    rounding: float,
) -> BenchmarkFunction:
    best = np.array(minimiser)
    low, high = (np.broadcast_to(np.asarray(bound, dtype=float), best.shape).copy() for bound in (lower, upper))
    return BenchmarkFunction(name, title, cost, low, high, minimum, best, rounding)


def _shifted(plain: BenchmarkFunction, rounding: float) -> BenchmarkFunction:
    """Return a function of a box around the origin with its optimum moved away from there."""
    away = shift(float(plain.upper[0]), plain.dimensions)
    return BenchmarkFunction(
        f"{plain.name}-shifted",
        f"{plain.title}, shifted",
        lambda x: plain.cost(x - away),
        plain.lower,
        plain.upper,
        plain.minimum,
        plain.minimiser + away,
        rounding,
    )


_F1 = _function("f1", "Schwefel 2.21", schwefel_2_21, -100.0, 100.0, 0.0, [0.0] * 30, 0.0)
_F3 = _function("f3", "Schaffer N.2", schaffer_2, -100.0, 100.0, 0.0, [0.0] * 2, 1e-15)
_F7 = _function("f7", "Griewank", griewank, -600.0, 600.0, 0.0, [0.0] * 30, 1e-15)

FUNCTIONS: tuple[BenchmarkFunction, ...] = (
    _F1,
    _function(
        "f2",
        "Kowalik",
        kowalik,
        -5.0,
        5.0,
        0.00030748598780560557,
        [0.19283345304, 0.19083623956, 0.12311729512, 0.13576599110],
        1e-15,
    ),
    _F3,
    _function("f4-branin", "Branin", branin, [-5.0, 0.0], [10.0, 15.0], 10.0 / (8.0 * np.pi), [np.pi, 2.275], 1e-14),
    _function("f4-goldstein", "Goldstein-Price", goldstein_price, -5.0, 5.0, 3.0, [0.0, -1.0], 1e-12),
    _function(
        "f5",
        "Hartmann 6",
        hartmann_6,
        0.0,
        1.0,
        -3.322368011415515,
        [0.20168951, 0.15001069, 0.47687397, 0.27533243, 0.31165162, 0.65730053],
        1e-12,
    ),
    _function("f6", "Eggholder", eggholder, -512.0, 512.0, -959.640662720851, [512.0, 404.2318050928957], 1e-9),
    _F7,
    _function("f8", "Levy N.13", levy_13, -10.0, 10.0, 0.0, [1.0, 1.0], 1e-30),
    _function("f9", "Colville", colville, -10.0, 10.0, 0.0, [1.0] * 4, 1e-30),
    _shifted(_F1, 1e-13),
    _shifted(_F3, 1e-15),
    _shifted(_F7, 1e-15),
)


def find_function(name: str) -> BenchmarkFunction:
    """Return the test function called ``name``.

    Raises
    ------
    MissionError
        There is none.
    """
    for function in FUNCTIONS:
        if function.name == name:
            return function
    raise MissionError(f"test function: expected one of {', '.join(f.name for f in FUNCTIONS)}, got '{name}'")
