"""Searches of the UAV path objective: as a black box, and from a graph search of the objective itself.

Four ways to spend the same number of evaluations:

* *black box*: PSO-ABC-SA over the box of vectors, knowing nothing;
* *planner's guesses*: the same, begun with the planner's own first guesses (:mod:`missionplanner.seeds`), which know
  the ground, the cylinders and the band of heights, but not the objective;
* *guessed*: the same, begun with the paths of a graph search over the map (:func:`.uav_graph.lattice_routes`);
* *grey box*: these paths improved by weaving, without any swarm. Places are drawn around all waypoints at once, and the
  cheapest of all paths through them is found by dynamic programming (:func:`.uav_graph.woven`). Places close in while
  nothing is better; a path that nothing near improves is kicked, a few waypoints off, and woven anew.

What counts: every call of the objective, and in weaving every n + 1 legs priced, rounded up, since a path has so many.
What the graph search and the planner's guesses take is not counted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from missionplanner import seeds
from missionplanner.errors import InfeasibleError
from missionplanner.experiments.uav_graph import Routes, decoded, encoded, lattice_routes, woven
from missionplanner.experiments.uav_objective import HIGH_M, LOW_M, OUTER_M, Instance
from missionplanner.experiments.uav_scene import uav_scene
from missionplanner.geodesy import FloatArray
from missionplanner.path import evenly
from missionplanner.search.run import minimise

METHODS = {"black": "black box", "planned": "planner's guesses", "guessed": "guessed", "grey": "grey box"}

ROUTES = 10
_PLACES = 5  # per waypoint, the present one among them
_BEGIN_M, _SETTLED_M, _WIDEST_M = 8.0, 0.1, 40.0  # how far places are from waypoints
_WIDER, _CLOSER = 1.5, 0.8
_OTHER_HEIGHT = 0.15  # share of places at another height
_SLIDE_EVERY = 6  # rounds: waypoints move along the path, so that one more is where it is needed
_HAIR_M = 0.01
_KICK_M, _KICKED = 20.0, 4  # how far, and at most how many waypoints
_TOLERANCE = 5e-4  # of the price: how much worse a settled path may be, on average, to be kicked next
_CLIMBERS_EACH = 600  # evaluations, at least, per path that is woven at first


# --- one search ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a search found.

    Attributes
    ----------
    curve : evaluations, and the best price by then, whenever it fell.
    """

    point: FloatArray  # (D,)
    price: float
    curve: list[tuple[int, float]]
    evaluations: int


def search(instance: Instance, *, method: str, evaluations: int, seed: int, routes: Routes | None = None) -> Found:
    """Search an instance in one of :data:`METHODS`; the same arguments give the same path.

    ``routes`` are those of :func:`first_guesses` with the same seed, if known already.
    """
    if method == "black":
        return _swarmed(instance, evaluations, seed, None)
    if method == "planned":
        return _swarmed(instance, evaluations, seed, planned_guesses(instance))
    guesses = (routes or first_guesses(instance, seed)).paths
    if method == "guessed" or evaluations == 1:  # of which nothing is left for weaving
        return _swarmed(instance, evaluations, seed, encoded(instance, guesses))
    ledger = _Ledger(instance, evaluations)
    _weave(ledger, guesses, np.random.default_rng(seed))
    point = encoded(instance, ledger.path[None])
    ledger.used += 1  # what is told is what the objective says
    return Found(point[0], float(instance.price(point, 1)[0]), ledger.curve, ledger.used)


def first_guesses(instance: Instance, seed: int) -> Routes:
    """Return the paths with which a seed's searches begin."""
    return lattice_routes(instance, routes=ROUTES, rng=np.random.default_rng(seed))


def planned_guesses(instance: Instance) -> FloatArray | None:
    """Return the points (G, D) nearest to the planner's own first guesses; none where it finds no way."""
    m = instance.arrays
    scene = uav_scene(m.height_m, m.threat, m.start, m.end, threat_margin_m=OUTER_M, height_min_m=LOW_M,
                      height_max_m=HIGH_M)  # fmt: skip
    try:
        ways = seeds.first_guesses(scene.space, scene.limits, scene.start_m, scene.goal_m, count=ROUTES)
    except InfeasibleError:  # an end nearer to a cylinder than the margin, as the objective allows
        return None
    paths = np.stack([evenly(way, instance.dimensions // 3 + 2) for way in ways])
    rows, columns = m.height_m.shape
    row = np.clip(np.rint(paths[..., 1]).astype(int), 1, rows) - 1
    column = np.clip(np.rint(paths[..., 0]).astype(int), 1, columns) - 1
    paths[..., 2] = np.clip(paths[..., 2] - m.height_m[row, column], LOW_M, HIGH_M)
    return encoded(instance, paths)


def _swarmed(instance: Instance, evaluations: int, seed: int, initial: FloatArray | None) -> Found:
    result = minimise(
        lambda x: instance.price(x, 1),
        instance.lower,
        instance.upper,
        evaluations=evaluations,
        seed=seed,
        initial=initial,
    )
    curve: list[tuple[int, float]] = []
    for k, price in zip(result.history_evaluations.tolist(), result.history.tolist(), strict=True):
        if not curve or price < curve[-1][1]:
            curve.append((k, price))
    return Found(result.best, result.cost, curve, result.evaluations)


# --- weaving ---------------------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class _Ledger:
    """Evaluations spent, and the best path so far."""

    instance: Instance
    evaluations: int
    used: int = 0
    price: float = math.inf
    path: FloatArray = field(default_factory=lambda: np.empty(0))
    curve: list[tuple[int, float]] = field(default_factory=list)

    @property
    def weaving(self) -> int:
        """Return what one round of weaving costs at most."""
        vectors = self.instance.dimensions // 3
        return -(-(_PLACES**2 * (vectors - 1) + 2 * _PLACES) // (vectors + 1))

    def see(self, price: float, path: FloatArray) -> None:
        if price < self.price:
            self.price, self.path = price, path.copy()
            self.curve.append((self.used, price))

    def priced(self, paths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the paths (P, n + 2, 3) nearest to some that the box can express, and their prices (P,)."""
        points = encoded(self.instance, paths)
        price, inside = self.instance.price(points, 1), decoded(self.instance, points)
        for one, path in zip(price, inside, strict=True):
            self.used += 1
            self.see(float(one), path)
        return inside, price

    def woven(self, places: FloatArray) -> tuple[FloatArray, float]:
        """Return the cheapest path through places (n, K, 3), and its price."""
        rows, columns = self.instance.arrays.height_m.shape
        inside = np.clip(places, (1.0, 1.0, LOW_M), (columns - 1.0, rows - 1.0, HIGH_M))
        path = np.empty((len(places) + 2, 3))
        price, legs = woven(inside, self.instance.arrays, self.instance.upper[0], path)
        self.used += -(-legs // (len(places) + 1))
        self.see(price, path)
        return path, price


class _Climber:
    """A path on its way down: woven through ever nearer places, kicked when that ends."""

    def __init__(self, path: FloatArray, price: float) -> None:
        self.home, self.home_price = path, price  # settled last
        self._path, self._price = path, price
        self._reach_m = _BEGIN_M
        self._round = 0

    @property
    def price(self) -> float:
        return min(self._price, self.home_price)

    def step(self, ledger: _Ledger, rng: np.random.Generator) -> None:
        """Spend one round of weaving, or one evaluation on a kick."""
        if self._reach_m < _SETTLED_M:
            self._kick(ledger, rng)
            return
        self._round += 1
        slides = self._round % _SLIDE_EVERY == 0
        path, price = ledger.woven(_slid(self._path, rng) if slides else _around(self._path, self._reach_m, rng))
        better = price < self._price - 1e-9
        if better:
            self._path, self._price = path, price
        if not slides:
            self._reach_m = min(self._reach_m * _WIDER, _WIDEST_M) if better else self._reach_m * _CLOSER

    def _kick(self, ledger: _Ledger, rng: np.random.Generator) -> None:
        if self._price < self.home_price * (1.0 + _TOLERANCE * rng.exponential()):
            self.home, self.home_price = self._path, self._price
        kicked = self.home.copy()
        moved = min(int(rng.integers(1, _KICKED + 1)), len(kicked) - 2)
        first = int(rng.integers(1, len(kicked) - moved))
        kicked[first : first + moved, :2] += _KICK_M * rng.normal(size=(moved, 2))
        paths, prices = ledger.priced(kicked[None])
        self._path, self._price = paths[0], float(prices[0])
        self._reach_m = _BEGIN_M


def _weave(ledger: _Ledger, guesses: FloatArray, rng: np.random.Generator) -> None:
    """Improve guesses: after each third of the time the cheaper half of them goes on."""
    paths, prices = ledger.priced(guesses[: max(1, ledger.evaluations - 1)])
    climbers = [_Climber(path, float(price)) for path, price in zip(paths, prices, strict=True)]
    number = min(len(climbers), max(4, ledger.evaluations // _CLIMBERS_EACH))
    for stages in (3, 2, 1):
        climbers = sorted(climbers, key=lambda climber: climber.price)[: max(1, number >> (3 - stages))]
        until = ledger.used + (ledger.evaluations - 1 - ledger.used) // stages
        turn = 0
        while ledger.used + ledger.weaving <= until:
            climbers[turn % len(climbers)].step(ledger, rng)
            turn += 1


def _around(path: FloatArray, reach_m: float, rng: np.random.Generator) -> FloatArray:
    """Return places (n, K, 3) around a path's waypoints, which come first."""
    places = np.repeat(path[1:-1, None], _PLACES, axis=1)
    shape = (len(places), _PLACES - 1)
    far = reach_m * np.exp(0.7 * rng.normal(size=shape))
    places[:, 1:, :2] += far[..., None] * rng.normal(size=(*shape, 2))
    kind, rise = rng.random(shape), far * rng.normal(size=shape)
    middle, other = kind < 0.5 * _OTHER_HEIGHT, kind < _OTHER_HEIGHT
    height = places[:, 1:, 2]
    height[:] = np.where(middle, 0.5 * (LOW_M + HIGH_M), np.where(other, height + rise, height))
    return places


def _slid(path: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return places (n, 5, 3) along a path: its waypoints, their neighbours, and places on the way to those."""
    here, before, after = path[1:-1], path[:-2].copy(), path[2:].copy()
    before[0], after[-1] = here[0], here[-1]  # a waypoint at an end would be a leg of no length
    share = rng.random((len(here), 1))
    on, back = here + share * (after - here), here + share * (before - here)
    places = np.stack([here, before, after, on, back], axis=1)
    places[:, 1:, :2] += _HAIR_M * rng.normal(size=(len(here), 4, 2))
    return places
