"""PSO-ABC-SA in its best form: bees in groups with learned factors, a leader that flies, annealing between them.

The idea is the paper's (PAPER.md section 4): groups with three roles of bees, two learning factors, Metropolis
acceptance. What each is made of has been chosen by measurement (``missionplanner experiment ablation``).

*Groups.* The first population is dealt into groups that keep apart until ``apart`` of the budget is spent, and are one
group from then on; there are the more of them, the more evaluations there are per squared dimension: in many dimensions
one large group finds better than several small ones. Every group shrinks to its best few as the budget is spent
(Tanabe & Fukunaga 2014, L-SHADE, doi:10.1109/CEC.2014.6900380).

*Employed bees.* Each searches from its own source x (24, 30)::

    v = x + C1 (better - x) + C2 (one - other)

``better`` is one of the group's best, ``one`` a fellow, ``other`` a fellow or a source that was given up not long ago
(current-to-pbest/1 with an archive: Zhang & Sanderson 2009, JADE, doi:10.1109/TEVC.2009.2014613). The learning factors
C1 and C2 lie in (0, 1]. Both, and the share of coordinates that change, are drawn around what led to success in the
group lately: memories as in jSO (Brest, Maucec & Boskovic 2017, doi:10.1109/CEC.2017.7969456), whose last entry stays
at 0.9. Factors begin large, to explore, and start again small once the groups are one. Coordinates change one by one,
or as a block of neighbours (coordinates next to each other often belong together: waypoints of a path); the more
successful of the two is used more. Bees stop at the walls: many an optimum lies there. A better source replaces the
old one.

*The leader* takes off from the best source after a quarter of the evaluations, or later if that leaves more than it
needs: bees explore better alone. It flies by CMA-ES (Hansen 2016, arXiv:1604.00772): its velocity is the evolution
path, its coordinate system that of the better half of the bees at first, then its own. Bees and leader share the
evaluations by what each has gained lately for each that it was given; without gain the leader's share falls. A point of
the leader's that is better than all replaces the worst bee's source.

*Scouts, annealed.* A leader that has been behind the bees for ``patience`` generations is judged by the Metropolis rule
(32, 33): it flies on with probability ``exp(-rise / (T * spread))``, where T falls from 1 to 0 over the budget and
``spread`` is the bees' median deviation of costs. Otherwise it is recalled, the bees are alone for half of what is
left, and a new one takes off as scout from where they are by then (26). When a flight comes to rest, the next begins at
once.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from missionplanner.search.base import FloatArray, IntArray
from missionplanner.search.moves import accepted, spread

_WIDTH = 0.1  # of the draws around the memories, as in JADE
_MEMORY, _KEPT = 5, 0.9  # entries that learn, and the one more that does not
_FIRST_FACTOR, _FIRST_SHARE = 0.7, 0.8
_MERGED_FACTOR = 0.2  # once groups are one: from far to near
_ELITE, _ELITE_LATE = 0.2, 0.05  # of the group: those that a bee may be drawn to, at first and at the end
_ARCHIVE = 1.5  # sources given up that are remembered, per bee
_BLOCKS_LEAST = 0.1
_TURN = 0.1  # how fast the share of blocks follows their success
_HALF_LIFE = 30.0  # evaluations per dimension after which a gain counts half
_FLIGHT = 7500.0  # evaluations that a leader shares with the bees, in up to 30 dimensions
_BEES_LEAST = 8  # in a group, or there is one group less
_ALONE = 0.5  # of what is left: bees without a leader after one was behind
_LEADER_WIDTH = 0.5  # first step over the bees' standard deviation
_LEADER_FIRST = 0.1  # of the box: where the bees have none


@dataclass(frozen=True, slots=True)
class PsoAbcSaSettings:
    """What can be switched off or changed, for the ablation; the defaults are the algorithm.

    Attributes
    ----------
    groups : keep the bees in groups at first. ``apart`` : share of the budget until they are one.
    memory : learn the factors and the share of coordinates; else they stay at their first values.
    archive : differences to sources that were given up.
    blocks : change blocks of neighbouring coordinates as well.
    walls : stop at walls; else half way to them.
    shrink : exponent of the population's decline; 0 for none. ``smallest`` : bees left in the end.
    flight : let a leader fly. ``share_least`` : of the evaluations from then on, for bees as for the leader.
    scouts : recall leaders that are behind. ``annealing`` : by the Metropolis rule; else always.
    """

    groups: bool = True
    apart: float = 0.25
    memory: bool = True
    archive: bool = True
    blocks: bool = True
    walls: bool = True
    shrink: float = 1.5
    smallest: int = 5
    flight: bool = True
    share_least: float = 0.25
    scouts: bool = True
    annealing: bool = True


def groups_for(dimensions: int, evaluations: int) -> int:
    """Return how many groups there are: one for every 100 evaluations per squared dimension, up to twelve."""
    return int(min(max(round(evaluations / (100.0 * dimensions**2)), 1), 12))


def population_for(dimensions: int, evaluations: int) -> int:
    """Return the size of the first population: 2 bees per dimension and group, more when evaluations abound.

    The growth with the evaluations is that of ARRDE (Muzakka et al. 2025, minionpy), per group.
    """
    groups = groups_for(dimensions, evaluations)
    plenty = max(math.log10(evaluations / (groups * dimensions)) - 2.0, 0.0)
    bees = (2.0 + 5.756 * plenty**1.609) * dimensions
    return groups * int(max(min(bees, evaluations / (12.0 * groups)), _BEES_LEAST))


def take_off_for(dimensions: int, evaluations: int) -> float:
    """Return the share of the budget until the leader takes off: it needs only so many evaluations for its flight."""
    return max(0.25, 1.0 - _FLIGHT * max(1.0, dimensions / 30.0) / evaluations)


class PsoAbcSa:
    """Bees and a leader that share the evaluations."""

    def __init__(
        self, initial: FloatArray, evaluations: int, rng: np.random.Generator, settings: PsoAbcSaSettings | None = None
    ) -> None:
        self._settings, self._evaluations, self._rng = settings or PsoAbcSaSettings(), evaluations, rng
        self._bees = _Bees(initial, evaluations, rng, self._settings)
        self._leader: _Leader | None = None
        self._flies = False
        self._best_cost = np.inf
        self._used = 0
        self._take_off = evaluations * take_off_for(initial.shape[1], evaluations)
        self._behind = 0
        self._spent, self._gained = np.ones(2), np.zeros(2)  # by the bees and by the leader, lately
        self._leader_share = 0.5
        self._half_life = _HALF_LIFE * initial.shape[1]
        self._patience = 10 + initial.shape[1]

    def ask(self) -> FloatArray:
        """Return the bees' next points (P', D), or the leader's."""
        if self._leader is None and self._settings.flight and self._used >= self._take_off:
            self._leader = self._bees.leader()
        self._flies = self._leader is not None and self._spent[1] < self._leader_share * self._spent.sum()
        if self._leader is not None and self._flies:
            return self._leader.ask()
        return self._bees.ask(self._progress)

    def tell(self, cost: FloatArray) -> None:
        """Take the costs to those who asked, and settle who gets how many of the next evaluations."""
        self._used += len(cost)
        before = self._best_cost
        if self._leader is not None and self._flies:
            self._leader.tell(cost)
            self._best_cost = min(before, self._leader.best_cost)
            self._bees.learn(self._leader.best, self._leader.best_cost)
            self._judge(self._leader)
        else:
            self._bees.tell(cost)
            self._best_cost = min(before, self._bees.best_cost)
        if self._leader is not None:
            gain = before - self._best_cost
            self._settle(len(cost), gain if np.isfinite(gain) else 0.0)

    @property
    def _progress(self) -> float:
        return min(self._used / self._evaluations, 1.0)

    def _settle(self, evaluations: int, gain: float) -> None:
        fade = 0.5 ** (evaluations / self._half_life)
        self._spent *= fade
        self._gained *= fade
        self._spent[int(self._flies)] += evaluations
        self._gained[int(self._flies)] += gain
        rate = self._gained / np.maximum(self._spent, 1.0)
        least = self._settings.share_least
        if gain == 0.0:
            self._leader_share += (least - self._leader_share) * (1.0 - fade)
        elif 0.0 < rate.sum() < np.inf:
            self._leader_share = float(min(max(rate[1] / rate.sum(), least), 1.0 - least))

    def _judge(self, leader: _Leader) -> None:
        """Recall the leader when it rests, or when it is behind and the Metropolis rule says so."""
        self._behind = self._behind + 1 if leader.best_cost > self._bees.best_cost else 0
        recalled = False
        if self._settings.scouts and self._behind > self._patience:
            temperature = (1.0 - self._progress) * spread(self._bees.cost) if self._settings.annealing else 0.0
            found, best = np.array([leader.best_cost]), np.array([self._bees.best_cost])
            recalled = not accepted(self._rng, found, best, temperature)[0]
            self._behind = 0
        if leader.rests:
            self._leader, self._behind = self._bees.leader(), 0
        elif recalled:
            self._leader = None
            self._take_off = self._used + _ALONE * (self._evaluations - self._used)


class _Bees:
    """Sources (P, D) with their costs (P,), in groups, and what the groups have learned."""

    def __init__(
        self, initial: FloatArray, evaluations: int, rng: np.random.Generator, settings: PsoAbcSaSettings
    ) -> None:
        self._rng, self._settings = rng, settings
        first, dimensions = initial.shape
        wanted = groups_for(dimensions, evaluations) if settings.groups else 1
        self._groups = max(1, min(wanted, first // _BEES_LEAST))
        self._group = np.arange(first) % self._groups
        self._first, self._apart = first, True
        self.source = initial.copy()
        self.cost = np.full(first, np.inf)
        self.best_cost = np.inf
        # (3, G, H): of C1, of C2, and of the share of coordinates that change
        self._memory = np.full((3, self._groups, _MEMORY + 1), _FIRST_FACTOR)
        self._memory[2] = _FIRST_SHARE
        if settings.memory:
            self._memory[:, :, _MEMORY] = _KEPT
        self._oldest = np.zeros(self._groups, dtype=np.intp)
        self._given_up = np.empty((0, dimensions))
        self._block_share = 0.5 if settings.blocks and dimensions > 2 else 0.0
        self._candidate = self.source
        self._drawn = np.zeros((3, first))
        self._in_block = np.zeros(first, dtype=np.bool_)
        self._priced = False

    def ask(self, progress: float) -> FloatArray:
        """Return a candidate for every bee."""
        if not self._priced:
            return self._candidate
        if self._apart and progress >= self._settings.apart:
            self._apart, self._groups = False, 1
            self._group[:] = 0
            if self._settings.memory:
                self._memory[:2, :, :_MEMORY] = _MERGED_FACTOR
        self._shrink(progress)
        self._drawn = self._draw(progress)
        self._candidate = self._search(progress)
        return self._candidate

    def tell(self, cost: FloatArray) -> None:
        """Keep what is no worse; learn from what is better."""
        if not self._priced:
            self._priced = True
            self.cost = cost.copy()
            self.best_cost = float(cost.min())
            return
        better, kept = cost < self.cost, cost <= self.cost
        fall = self.cost - cost
        gain = np.where(better, np.where(np.isfinite(fall), fall, 1.0), 0.0)
        if self._settings.memory:
            self._learn_factors(gain)
        self._learn_blocks(gain)
        if self._settings.archive:
            self._given_up = np.concatenate([self._given_up, self.source[better]])
        self.source[kept] = self._candidate[kept]
        self.cost[kept] = cost[kept]
        self.best_cost = float(self.cost.min())

    def learn(self, point: FloatArray, cost: float) -> None:
        """Put a point that is better than all in the place of the worst."""
        if cost < self.best_cost:
            worst = int(np.argmax(self.cost))
            self.source[worst], self.cost[worst] = point, cost
            self.best_cost = cost

    def leader(self) -> _Leader:
        """Return a leader about to take off from the best source, with the better half around it."""
        order = np.argsort(self.cost, kind="stable")
        around = self.source[order[: max(2, len(order) // 2)]]
        return _Leader(around, float(self.cost[order[0]]), self._rng)

    def _shrink(self, progress: float) -> None:
        """Leave every group its best bees."""
        s = self._settings
        bees = round(s.smallest + (self._first / self._groups - s.smallest) * (1.0 - progress) ** s.shrink)
        order = np.argsort(self.cost, kind="stable")
        stay = np.concatenate([order[self._group[order] == g][: max(bees, s.smallest)] for g in range(self._groups)])
        if len(stay) < len(order):
            stay.sort()
            self.source, self.cost, self._group = (
                self.source[stay],
                self.cost[stay],
                self._group[stay],
            )
        room = round(_ARCHIVE * len(self.cost))
        if len(self._given_up) > room:
            self._given_up = self._given_up[np.sort(self._rng.permutation(len(self._given_up))[:room])]

    def _draw(self, progress: float) -> FloatArray:
        """Return C1, C2 and the share of coordinates that change, for every bee (3, P)."""
        bees = len(self.cost)
        entry = self._memory[:, self._group, self._rng.integers(0, _MEMORY + 1, bees)]
        drawn = np.empty((3, bees))
        drawn[:2] = np.minimum(positive_cauchy(self._rng, entry[:2]), 1.0)
        # few coordinates at a time find what separates, but not while there is much to explore
        least = 0.7 if progress < 0.25 else 0.6 if progress < 0.5 else 0.0
        drawn[2] = np.clip(entry[2] + _WIDTH * self._rng.standard_normal(bees), least, 1.0)
        return drawn

    def _search(self, progress: float) -> FloatArray:
        rng, x = self._rng, self.source
        bees, dimensions = x.shape
        better, one, other = self._fellows(_ELITE + (_ELITE_LATE - _ELITE) * progress)
        first, second, share = self._drawn[:, :, None]
        known = np.concatenate([x, self._given_up])
        moved = x + first * (x[better] - x) + second * (x[one] - known[other])

        everyone, start = np.arange(bees), rng.integers(0, dimensions, (bees,))
        changes = rng.random((bees, dimensions)) < share
        changes[everyone, start] = True
        self._in_block = rng.random((bees,)) < self._block_share
        length = 1.0 + np.floor(rng.random((bees, 1)) * np.maximum(2.0 * share * dimensions - 1.0, 1.0))
        block = (np.arange(dimensions) - start[:, None]) % dimensions < length
        moved = np.where(np.where(self._in_block[:, None], block, changes), moved, x)
        if self._settings.walls:
            inside: FloatArray = np.clip(moved, 0.0, 1.0)
        else:
            inside = np.where(moved < 0.0, 0.5 * x, np.where(moved > 1.0, 0.5 * (1.0 + x), moved))
        return inside

    def _fellows(self, elite: float) -> tuple[IntArray, IntArray, IntArray]:
        """Return for every bee one of its group's best, another fellow, and a fellow or a source given up (P, ...)."""
        rng, bees, given_up = self._rng, len(self.cost), len(self._given_up)
        better, one, other = (np.zeros(bees, dtype=np.intp) for _ in range(3))
        order = np.argsort(self.cost, kind="stable")
        for g in range(self._groups):
            ranked = order[self._group[order] == g]
            members = np.sort(ranked)
            count = len(members)
            better[members] = ranked[rng.integers(0, max(min(2, count), round(elite * count)), count)]
            pick = rng.integers(0, max(1, count - 1), count)
            pick += pick >= np.arange(count)
            one[members] = members[pick % count]
            pick = rng.integers(0, count + given_up * count // bees, count)
            old = bees + rng.integers(0, max(given_up, 1), count)
            other[members] = np.where(pick >= count, old, members[np.minimum(pick, count - 1)])
        return better, one, other

    def _learn_factors(self, gain: FloatArray) -> None:
        """Move each group's oldest entry half way to what succeeded, weighted by its gain."""
        for g in np.unique(self._group[gain > 0.0]):
            mine = (self._group == g) & (gain > 0.0)
            weight, drawn, slot = (
                gain[mine] / gain[mine].max(),
                self._drawn[:, mine],
                self._oldest[g],
            )
            mean = (weight * drawn * drawn).sum(axis=1) / (weight * drawn).sum(axis=1)
            self._memory[:, g, slot] = 0.5 * (self._memory[:, g, slot] + mean)
            self._oldest[g] = (slot + 1) % _MEMORY

    def _learn_blocks(self, gain: FloatArray) -> None:
        """Turn the share of blocks towards what gained more for each candidate."""
        blocks = self._in_block
        if not self._block_share or blocks.all() or not blocks.any():
            return
        by_block, by_one = gain[blocks].mean(), gain[~blocks].mean()
        if 0.0 < by_block + by_one < np.inf:
            share = (1.0 - _TURN) * self._block_share + _TURN * by_block / (by_block + by_one)
            self._block_share = float(min(max(share, _BLOCKS_LEAST), 1.0 - _BLOCKS_LEAST))


class _Leader:
    """CMA-ES in the unit box; names and formulas of arXiv:1604.00772."""

    def __init__(self, around: FloatArray, best_cost: float, rng: np.random.Generator) -> None:
        self._rng = rng
        self.best, self.best_cost = around[0].copy(), best_cost
        self.rests = False
        n = self._n = around.shape[1]
        self._lambda = 4 + int(3.0 * math.log(n))
        mu = self._lambda // 2
        weights = math.log((self._lambda + 1) / 2) - np.log(np.arange(1, mu + 1))
        self._weights = weights / weights.sum()
        eff = self._mu_eff = 1.0 / float((self._weights**2).sum())
        self._c_sigma = (eff + 2.0) / (n + eff + 5.0)
        self._damping = 1.0 + 2.0 * max(0.0, math.sqrt((eff - 1.0) / (n + 1.0)) - 1.0) + self._c_sigma
        self._c_c = (4.0 + eff / n) / (n + 4.0 + 2.0 * eff / n)
        self._c_1 = 2.0 / ((n + 1.3) ** 2 + eff)
        self._c_mu = min(1.0 - self._c_1, 2.0 * (eff - 2.0 + 1.0 / eff) / ((n + 2.0) ** 2 + eff))
        self._chi = math.sqrt(n) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))

        offsets = around - around.mean(axis=0)
        covariance = offsets.T @ offsets / len(around)
        variance = float(np.trace(covariance)) / n
        self._mean = self.best.copy()
        self._sigma = max(_LEADER_WIDTH * math.sqrt(variance), 1e-9) if variance > 0.0 else _LEADER_FIRST
        self._covariance = 0.5 * np.eye(n) + 0.5 * covariance / variance if variance > 0.0 else np.eye(n)
        self._path_sigma, self._path_c = np.zeros((2, n))
        self._generation = self._idle = 0
        self._axes, self._lengths, self._axes_age = np.eye(n), np.ones(n), math.inf
        self._candidate = np.empty((self._lambda, n))

    def ask(self) -> FloatArray:
        """Return points (lambda, D) around the mean, reflected at the walls."""
        if self._axes_age > 1.0 / (10.0 * self._n * (self._c_1 + self._c_mu)):
            squares, self._axes = np.linalg.eigh(self._covariance)
            self._lengths = np.sqrt(np.maximum(squares, 1e-30 * squares[-1]))
            self._axes_age = 0.0
        steps = (self._rng.standard_normal((self._lambda, self._n)) * self._lengths) @ self._axes.T
        free = self._mean + self._sigma * steps
        self._candidate = np.clip(
            np.where(free < 0.0, -free, np.where(free > 1.0, 2.0 - free, free)),
            0.0,
            1.0,
        )
        return self._candidate

    def tell(self, cost: FloatArray) -> None:
        """Move the mean to the better half, and turn and stretch the coordinate system."""
        n = self._n
        order = np.argsort(cost, kind="stable")[: len(self._weights)]
        self._generation += 1
        self._axes_age += 1.0
        self._idle += 1
        if cost[order[0]] < self.best_cost:
            self.best, self.best_cost, self._idle = (
                self._candidate[order[0]].copy(),
                float(cost[order[0]]),
                0,
            )
        steps = (self._candidate[order] - self._mean) / self._sigma
        step = self._weights @ steps
        self._mean = self._mean + self._sigma * step
        white = self._axes @ ((self._axes.T @ step) / self._lengths)
        c = self._c_sigma
        self._path_sigma = (1.0 - c) * self._path_sigma + math.sqrt(c * (2.0 - c) * self._mu_eff) * white
        length = float(np.linalg.norm(self._path_sigma))
        usual = math.sqrt(1.0 - (1.0 - c) ** (2 * self._generation)) * (1.4 + 2.0 / (n + 1.0)) * self._chi
        steady = float(length < usual)
        c = self._c_c
        self._path_c = (1.0 - c) * self._path_c + steady * math.sqrt(c * (2.0 - c) * self._mu_eff) * step
        self._covariance = (
            (1.0 - self._c_1 * (1.0 - (1.0 - steady) * c * (2.0 - c)) - self._c_mu) * self._covariance
            + self._c_1 * np.outer(self._path_c, self._path_c)
            + self._c_mu * (steps.T * self._weights) @ steps
        )
        self._sigma *= math.exp(min(1.0, self._c_sigma / self._damping * (length / self._chi - 1.0)))
        widest = self._sigma * float(self._lengths[-1])
        self.rests = self._idle > 100 + 20 * n or not 1e-19 < widest < 1e3


def positive_cauchy(rng: np.random.Generator, middle: FloatArray) -> FloatArray:
    """Return draws (K, P) above 0 around ``middle`` > 0: of a Cauchy distribution of width 0.1, the same for all K."""
    drawn = np.zeros(middle.shape)
    wrong = np.full(middle.shape[1], True)
    while wrong.any():
        drawn[:, wrong] = middle[:, wrong] + _WIDTH * np.tan(np.pi * (rng.random(int(wrong.sum())) - 0.5))
        wrong = drawn.min(axis=0) <= 0.0
    return drawn
