"""What every optimiser is: points asked for, costs told. Arrays in, arrays out; nothing here knows of UAVs.

Optimisers live in the unit box [0, 1]^D and see finite costs or ``inf``; :mod:`.run` scales to the user's box, counts
evaluations and remembers the best, so an optimiser holds its idea and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import NoReturn, Protocol

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]
Cost = Callable[[FloatArray], npt.ArrayLike]  # (P, D) -> (P,)
Callback = Callable[[int, float], bool | None]  # (evaluations so far, best cost) -> true to stop


class Optimiser(Protocol):
    """One population moving through the unit box; every ``ask`` is answered by one ``tell``.

    Both are called with numpy's floating-point warnings off: costs may be as large as numbers get.
    """

    def ask(self) -> FloatArray:
        """Return the points (P', D) to price next, each inside the unit box.

        At least one; how many may differ from generation to generation. The caller does not keep them.
        """

    def tell(self, cost: FloatArray) -> None:
        """Take the costs (P',) of the points last asked for; ``inf`` marks a point without a price, NaN never comes."""


class OptimiserClass(Protocol):
    """How an optimiser is made: from its first population (P, D) and all the evaluations it may spend."""

    def __call__(self, initial: FloatArray, evaluations: int, rng: np.random.Generator) -> Optimiser:
        """Return an optimiser that prices ``initial`` first; it may not change that array."""


Steps = Generator[FloatArray, FloatArray, NoReturn]


class Stepwise:
    """An optimiser written as a generator: it yields points and is sent their costs.

    Algorithms of several phases then read like their papers. ``steps`` has the parameters of :class:`OptimiserClass`.
    """

    def __init__(
        self,
        steps: Callable[[FloatArray, int, np.random.Generator], Steps],
        initial: FloatArray,
        evaluations: int,
        rng: np.random.Generator,
    ) -> None:
        self._steps = steps(initial, evaluations, rng)
        self._points = next(self._steps)

    def ask(self) -> FloatArray:
        """Return the points that wait for their costs."""
        return self._points

    def tell(self, cost: FloatArray) -> None:
        """Send the costs, and move on to the next points."""
        self._points = self._steps.send(cost)


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """What a search found.

    Attributes
    ----------
    best : (D,) the cheapest point priced, exactly as it was priced.
    cost : its cost.
    history : (G,) the best cost so far after every generation; never rises.
    history_evaluations : (G,) rows priced by then: ``history`` over it is the curve of convergence.
    evaluations : rows priced in all.
    seed : repeats the search.
    """

    best: FloatArray
    cost: float
    history: FloatArray
    history_evaluations: IntArray
    evaluations: int
    seed: int
