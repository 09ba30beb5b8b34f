"""Who inspects what, in which order, on which sortie: team orienteering with batteries (PAPER.md eqs 6 and 15).

Costs are :mod:`.travel`'s. The search is PyVRP's iterated local search (https://pyvrp.org): visits are its clients,
visits that may be flown backwards a choice between two of them, flight time is its duration, the battery its distance.
It starts from the better of two simple ways to share out the work, and what it finds counts only where it is better.

A *round* is one sortie of every vehicle that has one; the next begins when all have landed and batteries are changed.
So a vehicle flies its longest sortie first, and what counts is the sum over rounds of the longest sortie.
"""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt
import pyvrp
from pyvrp.exceptions import PenaltyBoundWarning
from pyvrp.stop import MaxIterations
from scipy.optimize import linear_sum_assignment

from missionplanner import mission
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.scene import Scene
from missionplanner.travel import TravelCosts, travel_costs
from missionplanner.views import LeftOut, Visit

Objective = Literal["makespan", "priority", "balanced"]
Way = Literal["split", "nearest"]
"""Simple ways to share out the work: equal parts along the lines; every vehicle in turn the nearest."""

_TICK_S, _SHARE = 0.1, 1e-6  # the solver counts in whole ones of these
_BLOCKED = 10**8  # of either, longer than any way
_OVERTIME = 20  # how many seconds of flight one is worth that a tour is too long
_SHORTER = (0.97, 0.985, 0.995)  # of its longest tours, what is tried next
_PRIZE_S = 3000.0  # what a target of mean weight is worth: more than any way to it
_ORDERS = 4  # ways to fly the visits of one target one after the other
_SAME = 1e-9
_PRIZE_MIN = 0.05  # of a mean weight: even what weighs nothing is inspected where there is time
_REFINEMENTS = 4
_PER_EXCHANGE = 16  # iterations of the solver take about as long as one exchange of targets
_DISTURBED = 4  # targets that are taken out together at most
_NOISE, _HASTES = 0.3, (0.0, 0.5, 1.0, 1.0)
_TRIES, _EVENER_TRIES, _FIRSTS = 12, 200, 2
_EVEN_S = 10.0  # flight times that differ by less are equal
_MEND = 0.995
_MENDS = 4
_OWN_MAX = 30_000_000  # ways, up to which the solver knows every vehicle's own home
ITEMS_MAX = 600
"""How many mission items the places of a sortie take at most: an ArduPilot holds some 700."""

_NO_BARS: Mapping[tuple[int, str], str] = {}
_ASCENTS, _MANY, _PATIENCE = 200, 600, 10


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """One sortie: from home through visits and back."""

    vehicle: int  # index of the scene's tasks
    round: int  # from 0
    visits: tuple[Visit, ...]  # as they are flown
    time_s: float  # from start to landing
    energy_share: float  # of the battery: in all, or on returning from wherever that takes most


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """Tours that inspect all that is not left out."""

    tours: tuple[Tour, ...]  # by round, then by vehicle
    left_out: tuple[LeftOut, ...]
    makespan_s: float  # from the first start to the last landing, changes of batteries included
    bound_s: float  # no tours through the same visits take less flight time in all

    @property
    def flight_s(self) -> float:
        """The flight time of all tours."""
        return sum(tour.time_s for tour in self.tours)

    @property
    def rounds(self) -> int:
        """How many rounds there are."""
        return 1 + max((tour.round for tour in self.tours), default=-1)


def assign(
    scene: Scene,
    visits: Sequence[Visit],
    *,
    seed: int,
    budget_share: Sequence[float] | None = None,
    done: Collection[str] = (),
    barred: Mapping[tuple[int, str], str] = _NO_BARS,
    costs: TravelCosts | None = None,
) -> Assignment:
    """Share out visits by the mission's objective; the same scene, visits and seed give the same, bit for bit.

    Parameters
    ----------
    scene : of an open mission, without routes
    budget_share : of each vehicle, how much of its battery a tour may take; default: all but its reserve. To inspect
        what is so far off that this is not enough, a tour may take all but the reserve.
    done : targets that are not asked for any more
    barred : why a vehicle (index of the scene's tasks) is not to inspect a target
    costs : of exactly these visits; default: :func:`.travel_costs`

    Raises
    ------
    InfeasibleError
        The wind is too strong for somebody.
    """
    problem = _Problem.of(scene, visits, budget_share, done, costs, barred)
    return problem.assignment(_solve(problem, seed))


def relieved(
    scene: Scene,
    visits: Sequence[Visit],
    tours: Sequence[Tour],
    *,
    budget_share: Sequence[float],
    barred: Mapping[tuple[int, str], str],
    costs: TravelCosts,
) -> tuple[Tour, ...] | None:
    """Return tours of which those that take too much are shorter: others have room for what they leave.

    A vehicle without a tour in one of the tours' rounds may fly one more then. None: nothing is to be moved, or there
    is no room. The tours are of what :func:`assign` made of the same costs.
    """
    problem = _Problem.of(scene, visits, budget_share, (), costs, barred)
    number = {id(form): k for k, form in enumerate(costs.forms)}
    plan = tuple(_Route(tour.vehicle, tuple(number[id(visit)] for visit in tour.visits)) for tour in tours)
    rounds = sorted({tour.round for tour in tours})
    if all(map(problem.fits, plan)):
        return None
    moved = _Moves(problem, plan, len(rounds)).relieved()
    if moved is None:
        return None
    found: list[Tour] = []
    for k, route in enumerate(moved):
        flown = {tour.round for tour in (*tours, *found) if tour.vehicle == route.vehicle}
        when = tours[k].round if k < len(tours) else max(set(rounds) - flown)
        if route.forms:
            of = tuple(costs.forms[form] for form in route.forms)
            found.append(Tour(route.vehicle, when, of, problem.route_s(route), problem.needs([route])[0]))
    return tuple(sorted(found, key=lambda tour: (tour.round, tour.vehicle)))


def _without_barred(costs: TravelCosts, barred: Collection[tuple[int, str]]) -> TravelCosts:
    """Return costs in which a vehicle has no way to what it is barred from: a model of its own."""
    times, shares = [costs.time_s], [costs.energy_share]
    inspection_s, inspection_share = [costs.inspection_s], [costs.inspection_share]
    model = costs.model.copy()
    for v in sorted({vehicle for vehicle, _ in barred}):
        m = int(costs.model[v])
        shut = [k for k, form in enumerate(costs.forms) if (v, form.target) in barred]
        for of, all_ in ((costs.time_s, times), (costs.energy_share, shares)):
            own = of[m].copy()
            own[:, shut] = own[shut, :] = np.inf
            all_.append(own[np.newaxis])
        inspection_s.append(costs.inspection_s[m : m + 1])
        inspection_share.append(costs.inspection_share[m : m + 1])
        model[v] = sum(map(len, times)) - 1
    return replace(
        costs,
        model=model,
        time_s=np.concatenate(times),
        energy_share=np.concatenate(shares),
        inspection_s=np.concatenate(inspection_s),
        inspection_share=np.concatenate(inspection_share),
    )


def share_out(
    scene: Scene,
    visits: Sequence[Visit],
    way: Way,
    *,
    budget_share: Sequence[float] | None = None,
    costs: TravelCosts | None = None,
) -> Assignment:
    """Share out visits in a simple way, as it is done without a solver: to compare with, and to start from."""
    problem = _Problem.of(scene, visits, budget_share, (), costs)
    return problem.assignment(_split(problem) if way == "split" else _nearest(problem))


# --- the problem, and what is made of it


@dataclass(frozen=True, slots=True)
class _Route:
    """One vehicle's way through forms of visits."""

    vehicle: int
    forms: tuple[int, ...]


_Plan = tuple[_Route, ...]
"""Tours in no order; a vehicle may have several."""
_Score = tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is asked for, in numbers."""

    costs: TravelCosts
    settings: mission.Assignment
    names: tuple[str, ...]  # of the vehicles
    budget: FloatArray  # (V,)
    allowed: FloatArray  # (V,) all but the reserve
    alone: FloatArray  # (V, F) what each form takes alone
    weights: dict[str, float]  # of targets that were not done
    targets: dict[str, tuple[int, ...]]  # that can be reached: their visits
    unreachable: tuple[LeftOut, ...]

    @classmethod
    def of(
        cls,
        scene: Scene,
        visits: Sequence[Visit],
        budget_share: Sequence[float] | None,
        done: Collection[str],
        costs: TravelCosts | None,
        barred: Mapping[tuple[int, str], str] = _NO_BARS,
    ) -> _Problem:
        inspection = scene.mission.inspection
        if inspection is None or inspection.assignment is None or scene.towers is None:
            raise MissionError("inspection.assignment: expected this field, got none: nothing is to be shared out")
        found = travel_costs(scene, visits) if costs is None else costs
        if barred:
            found = _without_barred(found, barred)
        budget = 1.0 - found.reserve_share if budget_share is None else np.asarray(budget_share, dtype=float)
        of: dict[str, list[int]] = {}
        for index, visit in enumerate(found.visits):
            if visit.target not in done:
                of.setdefault(visit.target, []).append(index)
        of_towers = dict(zip(scene.towers.names, scene.towers.weight.tolist(), strict=True))
        mean = float(scene.towers.weight.mean())  # what a span weighs
        names = tuple(task.name for task in scene.tasks)
        problem = cls(
            costs=found,
            settings=inspection.assignment,
            names=names,
            budget=budget,
            allowed=1.0 - found.reserve_share,
            alone=_alone(found),
            weights={target: of_towers.get(target, mean) for target in of},
            targets={},
            unreachable=(),
        )
        unreachable = []
        for target, indices in of.items():
            why = next((w for w in (problem._why_unreachable(k) for k in indices) if w is not None), None)
            if why is None:
                problem.targets[target] = tuple(indices)
                continue
            at_m = found.visits[indices[0]].viewpoints[0].position_m
            whys = [(float(np.hypot(*(scene.tasks[v].home_m - at_m)[:2])), v) for v, t in barred if t == target]
            unreachable.append(LeftOut(target, barred[min(whys)[1], target] if whys else why))
        return replace(problem, unreachable=tuple(unreachable))

    @property
    def vehicles(self) -> int:
        return len(self.names)

    @property
    def sorties_max(self) -> int:
        return 1 if self.settings.objective == "priority" else self.settings.sorties_max

    @cached_property
    def forms(self) -> tuple[tuple[int, ...], ...]:
        """The forms of every visit."""
        turned = self.costs.turned
        return tuple((k,) if turned[k] == k else (k, int(turned[k])) for k in range(len(self.costs.visits)))

    def target_of(self, form: int) -> str:
        return self.costs.forms[form].target

    def _why_unreachable(self, visit: int) -> str | None:
        """Return why no vehicle can fly a visit alone, and what helps; None: one can."""
        forms = list(self.forms[visit])
        if any(self.items_of([f]) > ITEMS_MAX for f in forms):
            return (
                f"expected at most {ITEMS_MAX} mission items in a sortie, got more in {self.costs.visits[visit].name} "
                "alone: lower views.points or views.photos"
            )
        alone = self.alone[:, forms].min(axis=1)
        if (alone <= self.allowed + _SAME).any():
            return None
        name = self.costs.visits[visit].name
        v = int(np.argmin(alone - self.allowed))
        need = float(alone[v])
        if not math.isfinite(need):
            return (
                f"no vehicle has a way to {name}: it is walled in, below a ceiling or beyond the terrain: move homes, "
                "or raise ceilings"
            )
        return (
            f"to fly to {name} alone takes {need:.1%} of the battery of {self.names[v]}, the least of all, allowed "
            f"{self.allowed[v]:.0%}: move a home nearer to it, or take a larger battery (energy, endurance_s)"
        )

    # what routes take

    def route_s(self, route: _Route) -> float:
        return float(self.along(route, self.costs.time_s).sum())

    def along(self, route: _Route, of: FloatArray) -> FloatArray:
        home = self.costs.home(route.vehicle)
        places = np.array([home, *route.forms, home])
        steps: FloatArray = of[self.costs.model[route.vehicle], places[:-1], places[1:]]
        return steps

    def needs(self, routes: Iterable[_Route]) -> list[float]:
        """Return the share of the battery that each route takes, on returning from wherever that takes most."""
        costs = self.costs
        found = []
        for route in routes:
            used = np.cumsum(self.along(route, costs.energy_share))
            need = float(used[-1])
            if costs.returns:
                v, forms = route.vehicle, list(route.forms)
                heights = costs.return_height_m[v, forms]
                higher = float(costs.higher_share_m[v])
                home = costs.home_share[v, forms] + higher * (heights.max() - heights)
                top_m = float(heights.max() - costs.top_height_m[v])
                top = float(costs.top_share[v]) + higher * max(0.0, top_m)
                need = max(need + top, float((used[:-1] + home).max()))
            found.append(need if math.isfinite(self.route_s(route)) else math.inf)
        return found

    def fits(self, route: _Route) -> bool:
        if not route.forms:
            return True
        if self.items_of(route.forms) > ITEMS_MAX:
            return False
        return bool(self.needs([route])[0] <= self.budget_of(route) + _SAME)

    def items_of(self, forms: Sequence[int]) -> int:
        """Return about how many mission items forms take: a waypoint or two to each place, the camera, its photos."""
        actions = [viewpoint.action for form in forms for viewpoint in self.costs.forms[form].viewpoints]
        return sum(3 + (2 * a.photos if a.hold_s > 0.0 else min(a.photos, 1)) for a in actions)

    def budget_of(self, route: _Route) -> float:
        """Return how much a tour may take: as much as its furthest visit takes alone, if that is more than others."""
        v = route.vehicle
        furthest = max((float(self.alone[v, form]) for form in route.forms), default=0.0)
        return float(max(self.budget[v], min(furthest, self.allowed[v])))

    # what plans are worth

    def inspected(self, plan: _Plan) -> set[str]:
        """Return the targets of which all visits are flown."""
        flown = {int(self.costs.visit[form]) for route in plan for form in route.forms}
        return {target for target, visits in self.targets.items() if flown.issuperset(visits)}

    def complete(self, plan: _Plan) -> _Plan:
        """Return a plan without visits of targets of which others are missing."""
        kept = self.inspected(plan)
        routes = (_Route(r.vehicle, tuple(f for f in r.forms if self.target_of(f) in kept)) for r in plan)
        return tuple(route for route in routes if route.forms)

    def rounds_of(self, plan: _Plan) -> list[list[tuple[float, _Route]]]:
        """Return the routes of each round with their times: each vehicle's longest first."""
        rounds: list[list[tuple[float, _Route]]] = []
        for v in range(self.vehicles):
            own = sorted(((self.route_s(r), r) for r in plan if r.vehicle == v), key=lambda o: (-o[0], o[1].forms))
            rounds += [[] for _ in range(len(own) - len(rounds))]
            for k, timed in enumerate(own):
                rounds[k].append(timed)
        return rounds

    def makespan_s(self, plan: _Plan) -> float:
        rounds = self.rounds_of(plan)
        longest = sum(max(time_s for time_s, _ in round_) for round_ in rounds)
        return longest + self.settings.swap_s * max(0, len(rounds) - 1)

    def score(self, plan: _Plan) -> _Score:
        """Return what is to be as small as can be, what counts most first."""
        inspected = self.inspected(plan)
        missing = sum(weight for target, weight in self.weights.items() if target not in inspected)
        lost = (round(missing, 9), float(len(self.targets) - len(inspected)))
        flight_s = sum(self.route_s(route) for route in plan)
        rounds = float(len(self.rounds_of(plan)))
        if self.settings.objective == "priority":
            return (*lost, flight_s)
        if self.settings.objective == "balanced":
            each = [sum(self.route_s(r) for r in plan if r.vehicle == v) for v in range(self.vehicles)]
            return (*lost, rounds, float(math.ceil((max(each) - min(each)) / _EVEN_S)), flight_s)
        return (*lost, rounds, self.makespan_s(plan), flight_s)

    def valid(self, plan: _Plan) -> bool:
        """Whether every visit is flown at most once, no battery is overdrawn, and nobody flies too often."""
        flown = [int(self.costs.visit[form]) for route in plan for form in route.forms]
        often = [sum(route.vehicle == v for route in plan) for v in range(self.vehicles)]
        once = len(flown) == len(set(flown))
        return once and max(often) <= self.sorties_max and all(self.fits(route) for route in plan)

    def best(self, plans: Iterable[_Plan]) -> _Plan:
        """Return the best of the valid ones; the first of equals."""
        return min((plan for plan in map(self.complete, plans) if self.valid(plan)), key=self.score)

    def assignment(self, plan: _Plan) -> Assignment:
        tours = []
        for number, round_ in enumerate(self.rounds_of(plan)):
            for time_s, route in sorted(round_, key=lambda timed: timed[1].vehicle):
                visits = tuple(self.costs.forms[form] for form in route.forms)
                tours.append(Tour(route.vehicle, number, visits, time_s, self.needs([route])[0]))
        inspected = self.inspected(plan)
        left_out = [LeftOut(t, self._why_not()) for t in self.targets if t not in inspected]
        order = {target: k for k, target in enumerate(self.weights)}
        return Assignment(
            tours=tuple(tours),
            left_out=tuple(sorted((*self.unreachable, *left_out), key=lambda left: order[left.target])),
            makespan_s=self.makespan_s(plan) if plan else 0.0,
            bound_s=_bound_s(self, sorted({int(self.costs.visit[f]) for r in plan for f in r.forms}), plan),
        )

    def _why_not(self) -> str:
        if self.settings.objective == "priority":
            return (
                "one sortie of each vehicle is not enough for it beside what weighs more: add vehicles, or ask for all "
                "(inspection.assignment.objective: makespan)"
            )
        return (
            f"needs more sorties than {self.settings.sorties_max} of each vehicle: raise "
            "inspection.assignment.sorties_max, or add vehicles"
        )


def _alone(costs: TravelCosts) -> FloatArray:
    """Return what each form takes of each vehicle's battery (V, F) alone, on returning from wherever it takes most."""
    rows = []
    for v in range(len(costs.model)):
        m, home, count = costs.model[v], costs.home(v), len(costs.forms)
        out, back = costs.energy_share[m, home, :count], costs.energy_share[m, :count, home]
        need: FloatArray = out + back
        if costs.returns:
            above_m = np.maximum(costs.return_height_m[v] - costs.top_height_m[v], 0.0)
            need = np.maximum(need + costs.top_share[v] + costs.higher_share_m[v] * above_m, out + costs.home_share[v])
        known = np.isfinite(costs.time_s[m, home, :count] + costs.time_s[m, :count, home])
        rows.append(np.where(known, need, np.inf))
    return np.array(rows)


# --- simple ways


def _split(problem: _Problem) -> _Plan:
    """Cut the towers in their order into equal parts, one for each vehicle, which flies out on one side and back."""
    targets = list(problem.targets)
    parts = [part.tolist() for part in np.array_split(np.arange(len(targets)), problem.vehicles)]
    parts = [part for part in parts if part]
    if not parts:
        return ()

    def far_s(v: int, part: Sequence[int]) -> float:
        away = problem.costs.time_s[problem.costs.model[v], problem.costs.home(v)]
        found_s = min(float(away[f]) for k in part for u in problem.targets[targets[k]] for f in problem.forms[u])
        return min(found_s, float(_BLOCKED))

    far = np.array([[far_s(v, part) for part in parts] for v in range(problem.vehicles)])
    routes = []
    for v, p in zip(*linear_sum_assignment(far), strict=True):
        left = [targets[k] for k in parts[p]]
        for _ in range(problem.sorties_max):
            first, last = _window(problem, int(v), left)
            if first < last:
                routes.append(_out_and_back(problem, int(v), left[first:last]))
            left = left[:first] + left[last:]
    return tuple(routes)


def _window(problem: _Problem, vehicle: int, targets: Sequence[str]) -> tuple[int, int]:
    """Return which of targets in their order one sortie inspects: the nearest to home, and on to both sides."""
    away = problem.costs.time_s[problem.costs.model[vehicle], problem.costs.home(vehicle)]
    near_s = [min(float(away[f]) for u in problem.targets[t] for f in problem.forms[u]) for t in targets]
    for nearest in np.argsort(near_s, kind="stable").tolist():
        first, last = nearest, nearest + 1
        if not problem.fits(_out_and_back(problem, vehicle, targets[first:last])):
            continue
        while True:
            wider = [(near_s[first - 1], first - 1, last)] if first > 0 else []
            wider += [(near_s[last], first, last + 1)] if last < len(targets) else []
            fitting = (w for w in sorted(wider) if problem.fits(_out_and_back(problem, vehicle, targets[w[1] : w[2]])))
            found = next(fitting, None)
            if found is None:
                return first, last
            _, first, last = found
    return 0, 0


def _out_and_back(problem: _Problem, vehicle: int, targets: Sequence[str]) -> _Route:
    visits = [problem.targets[target] for target in targets]
    order = [of[0] for of in visits] + [visit for of in reversed(visits) for visit in of[1:]]
    forms: list[int] = []
    for visit in order:
        forms.append(_nearest_form(problem, vehicle, forms, problem.forms[visit]))
    return _Route(vehicle, tuple(forms))


def _nearest_form(problem: _Problem, vehicle: int, before: Sequence[int], forms: Sequence[int]) -> int:
    """Return which of some forms is nearest to the end of a route."""
    time_s = problem.costs.time_s[problem.costs.model[vehicle]]
    place = before[-1] if before else problem.costs.home(vehicle)
    return min(forms, key=lambda form: (time_s[place, form], form))


def _nearest(problem: _Problem) -> _Plan:
    """Let the vehicles in turn take the nearest target that is left and that their batteries still allow."""
    left = dict.fromkeys(problem.targets)
    now: list[_Route] = [_Route(v, ()) for v in range(problem.vehicles)]
    sorties = [0] * problem.vehicles
    routes: list[_Route] = []
    flying = list(range(problem.vehicles))
    while flying:
        v = flying.pop(0)
        longer = next((r for r in _with_nearest(problem, now[v], left) if problem.fits(r)), None)
        if longer is not None:
            now[v] = longer
            left.pop(problem.target_of(longer.forms[-1]))
            flying.append(v)
        elif now[v].forms:
            routes.append(now[v])
            now[v], sorties[v] = _Route(v, ()), sorties[v] + 1
            if sorties[v] < problem.sorties_max:
                flying.append(v)
    return tuple(routes)


def _with_nearest(problem: _Problem, route: _Route, left: Iterable[str]) -> Iterator[_Route]:
    """Yield the route with one more target, the nearest first."""
    time_s = problem.costs.time_s[problem.costs.model[route.vehicle]]
    place = route.forms[-1] if route.forms else problem.costs.home(route.vehicle)

    def away_s(target: str) -> float:
        return float(min(time_s[place, form] for visit in problem.targets[target] for form in problem.forms[visit]))

    for target in sorted(left, key=away_s):
        forms = list(route.forms)
        visits = list(problem.targets[target])
        while visits:
            choices = [form for visit in visits for form in problem.forms[visit]]
            forms.append(_nearest_form(problem, route.vehicle, forms, choices))
            visits.remove(int(problem.costs.visit[forms[-1]]))
        yield _Route(route.vehicle, tuple(forms))


# --- the solver


def _solve(problem: _Problem, seed: int) -> _Plan:
    """Return the best plan that was found."""
    best = problem.best([(), _split(problem), _nearest(problem)])
    if not problem.targets:
        return best
    search = _Search(problem, seed, best)
    if problem.settings.objective == "priority" or not search.cover():
        search.most_weight()
        return search.found
    search.shorten()
    if problem.settings.objective == "balanced":
        search.even_out()
    return search.found


@dataclass(frozen=True, slots=True)
class _Choice:
    """What the solver calls a client: one of some ways to fly something, each through forms one after the other."""

    options: tuple[tuple[int, ...], ...]
    prize_s: float = 0.0  # 0: it must be flown


class _Search:
    """The best plan so far, and what improves it."""

    def __init__(self, problem: _Problem, seed: int, start: _Plan) -> None:
        self._problem = problem
        self._rng = np.random.default_rng(seed)
        self.found = start
        self._score = problem.score(start)
        self._height_m = _return_heights_m(problem)  # what the solver takes tours to return at
        self._spare = np.zeros(problem.vehicles)  # of each battery: what it still does not know of ways home
        visits = [visit for of in problem.targets.values() for visit in of]
        self._visits = {visit: _Choice(tuple((form,) for form in problem.forms[visit])) for visit in visits}

    def offer(self, plan: _Plan) -> bool:
        """Take a plan if it is better than the best so far."""
        plan = self._problem.complete(plan)
        if not self._problem.valid(plan):
            return False
        score = self._problem.score(plan)
        if score >= self._score:
            return False
        self.found, self._score = plan, score
        return True

    def cover(self) -> bool:
        """Find tours through all visits in the fewest rounds; False: none are found within the sorties allowed."""
        problem = self._problem
        rounds = len(problem.rounds_of(self.found)) if self._complete else problem.sorties_max
        while rounds >= _rounds_min(problem):
            start = [route for timed in problem.rounds_of(self.found)[:rounds] for _, route in timed]
            plan = self._mended_run(list(self._visits.values()), self._fleet([math.inf] * rounds), tuple(start))
            if plan is None or not self._complete:
                break
            rounds = min(rounds, len(problem.rounds_of(self.found))) - 1
        return self._complete

    @property
    def _complete(self) -> bool:
        return self._score[1] == 0.0

    def shorten(self) -> None:
        """Let the longest tours of all rounds become shorter."""
        for share in _SHORTER:
            rounds = self._problem.rounds_of(self.found)
            longest = [max(time_s for time_s, _ in round_) for round_ in rounds]
            self._mended_run(list(self._visits.values()), self._fleet([share * s for s in longest]), self.found)

    def most_weight(self) -> None:
        """Find the targets of most weight that can be inspected.

        The solver chooses targets whose visits follow one upon the other. Then targets that are near each other are
        taken out and what weighs more per second is put in, again and again, each visit where it fits best; and the
        solver orders anew what was chosen.
        """
        problem = self._problem
        mean = sum(problem.weights[target] for target in problem.targets) / len(problem.targets)
        choices = [
            _Choice(_orders(problem, visits), _PRIZE_S * max(problem.weights[target] / (mean or 1.0), _PRIZE_MIN))
            for target, visits in problem.targets.items()
        ]
        fleet = self._fleet([math.inf] * problem.sorties_max)
        self._mended_run(choices, fleet, None)
        for _ in range(_REFINEMENTS):
            before = self._score
            self._exchange()
            chosen = {visit for target in problem.inspected(self.found) for visit in problem.targets[target]}
            choices = [choice for visit, choice in self._visits.items() if visit in chosen]
            self._mended_run(choices, fleet, self.found)
            self.offer(self._grown(self.found))
            if self._score == before:
                break

    def _exchange(self) -> None:
        """Take out targets near each other, put in what fits; keep what is better."""
        problem = self._problem
        places = {t: problem.costs.visits[visits[0]].viewpoints[0].position_m for t, visits in problem.targets.items()}
        for _ in range(max(1, problem.settings.iterations // _PER_EXCHANGE)):
            inspected = sorted(problem.inspected(self.found))
            if not inspected or len(inspected) == len(problem.targets):
                break
            centre = places[inspected[int(self._rng.integers(len(inspected)))]]
            count = 1 + int(self._rng.integers(_DISTURBED))
            out = set(sorted(inspected, key=lambda t: float(np.hypot(*(places[t] - centre)[:2])))[:count])
            routes = (
                _Route(r.vehicle, tuple(f for f in r.forms if problem.target_of(f) not in out)) for r in self.found
            )
            self.offer(self._grown(tuple(r for r in routes if r.forms), self._rng))

    def _grown(self, plan: _Plan, rng: np.random.Generator | None = None) -> _Plan:
        """Return a plan with more targets, those first that weigh most for the time that they take."""
        problem = self._problem
        left = [target for target in problem.targets if target not in problem.inspected(plan)]
        while left:
            moves = _Moves(problem, plan)
            worth = moves.worth(left, 1.0 if rng is None else float(rng.choice(_HASTES)))
            if rng is not None:
                worth *= rng.uniform(1.0 - _NOISE, 1.0 + _NOISE, len(left))
            order = [k for k in np.argsort(-worth, kind="stable").tolist() if worth[k] > 0.0]
            found = ((moves.with_target(left[k]), k) for k in order[: None if rng is None else _TRIES])
            grown = next(((routes, k) for routes, k in found if routes is not None), None)
            if grown is None:
                break
            plan = grown[0]
            del left[grown[1]]
        return plan

    def even_out(self) -> None:
        """Let all vehicles fly about as long: at first all tours, then single visits change tours while that helps."""
        problem = self._problem
        rounds = len(problem.rounds_of(self.found))
        mean_s = sum(problem.route_s(route) for route in self.found) / (rounds * problem.vehicles)
        self._mended_run(list(self._visits.values()), self._fleet([mean_s] * rounds), self.found)
        plan: _Plan | None = self.found
        while plan is not None:
            self.offer(plan)
            plan = _Moves(problem, plan, rounds).evener()

    def _mended_run(
        self, choices: Sequence[_Choice], fleet: Sequence[tuple[int, float]], start: _Plan | None
    ) -> _Plan | None:
        """Run the solver until what it finds brings everybody home; None: it finds nothing."""
        for _ in range(_MENDS):
            plan = self._run(choices, fleet, start)
            if plan is None or not self._overdrawn(plan):
                return plan
            start = plan
        return None

    def _overdrawn(self, plan: _Plan) -> bool:
        """Whether a battery is not enough for some way home; the solver reckons with more then."""
        problem, found = self._problem, False
        for route, need in zip(plan, problem.needs(plan), strict=True):
            v, over = route.vehicle, need - problem.budget_of(route)
            if over <= _SAME:
                continue
            found = True
            height_m = float(problem.costs.return_height_m[v, list(route.forms)].max())
            if height_m > self._height_m[v]:
                self._height_m[v] = height_m
            else:
                self._spare[v] += over + 1.0 - _MEND
        return found

    def _fleet(self, longest_s: Sequence[float]) -> list[tuple[int, float]]:
        """Return one sortie of every vehicle for each round: the vehicle, and how long it should be at most."""
        return [(v, longest) for longest in longest_s for v in range(self._problem.vehicles)]

    def _run(self, choices: Sequence[_Choice], fleet: Sequence[tuple[int, float]], start: _Plan | None) -> _Plan | None:
        """Return what the solver finds, offering all that it finds on the way; None: no tours within the batteries."""
        problem, budget = self._problem, self._problem.budget - self._spare
        model = _Model(problem, choices, fleet, budget, self._height_m)
        if start is not None and start == self.found:  # it is allowed, whatever the solver reckons
            for route in start:
                budget[route.vehicle] = max(budget[route.vehicle], model.taken(route) + _SHARE)
            model = _Model(problem, choices, fleet, budget, self._height_m)
        watch = _Watch(model, self)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PenaltyBoundWarning)  # where too little is allowed, none is found
            result = pyvrp.solve(
                model.data,
                MaxIterations(problem.settings.iterations),
                seed=int(self._rng.integers(2**31)),
                collect_stats=False,
                params=pyvrp.SolveParams(ils=pyvrp.IteratedLocalSearchParams(callbacks=watch)),
                initial_solution=None if start is None else model.encoded(start),
            )
        return model.decoded(result.best) if result.best.is_feasible() else None


def _return_heights_m(problem: _Problem) -> FloatArray:
    """Return how high vehicles (V) return at most from what is nearer to their homes than to others'."""
    costs = problem.costs
    count = len(costs.forms)
    away_s = np.array([costs.time_s[costs.model[v], costs.home(v), :count] for v in range(problem.vehicles)])
    nearest = away_s.argmin(axis=0)
    heights_m = costs.return_height_m
    found: FloatArray = np.where(nearest == np.arange(problem.vehicles)[:, np.newaxis], heights_m, 0.0).max(axis=1)
    return found


class _Moves:
    """How single visits fit into the tours of a plan, and into one more tour of who may still fly one."""

    def __init__(self, problem: _Problem, plan: _Plan, rounds: int | None = None) -> None:
        self._problem = problem
        sorties = problem.sorties_max if rounds is None else rounds
        free = [v for v in range(problem.vehicles) if sum(r.vehicle == v for r in plan) < sorties]
        self._routes = [*plan, *(_Route(v, ()) for v in free)]
        shape = (len(self._routes), len(problem.costs.forms))
        self._more_s, self._fits = np.full(shape, np.inf), np.zeros(shape, dtype=np.bool_)
        for k in range(len(self._routes)):
            self._look_at(k)

    def _look_at(self, k: int) -> None:
        problem, route = self._problem, self._routes[k]
        more = self._more(route, problem.costs.energy_share)
        budget = np.minimum(problem.alone[route.vehicle], problem.allowed[route.vehicle])
        budget = np.maximum(budget, problem.budget_of(route))
        spare = budget - float(problem.along(route, problem.costs.energy_share).sum())
        self._more_s[k] = self._more(route, problem.costs.time_s).min(axis=0)
        self._fits[k] = more.min(axis=0) <= spare + _SAME

    def _with_route(self, k: int, route: _Route) -> _Moves:
        """Return the same with another route."""
        changed = copy.copy(self)
        changed._routes = [*self._routes[:k], route, *self._routes[k + 1 :]]
        changed._more_s, changed._fits = self._more_s.copy(), self._fits.copy()
        changed._look_at(k)
        return changed

    def _plan(self) -> _Plan:
        return tuple(route for route in self._routes if route.forms)

    def _more(self, route: _Route, of: FloatArray) -> FloatArray:
        """Return what each form (F) adds at each place of a route (K): (K, F)."""
        costs = self._problem.costs
        home, table = costs.home(route.vehicle), of[costs.model[route.vehicle]]
        before, after = np.array([home, *route.forms]), np.array([*route.forms, home])
        count = len(costs.forms)
        more: FloatArray = table[before, :count] + table[:count, after].T - table[before, after][:, np.newaxis]
        return more

    def worth(self, targets: Sequence[str], haste: float) -> FloatArray:
        """Return the weight of targets (N,) over how much longer they make the tours, to the power of ``haste``.

        0 where none can take them.
        """
        problem = self._problem
        least_s = np.where(self._fits, self._more_s, np.inf).min(axis=0)
        longer_s = np.array(
            [sum(min(least_s[f] for f in problem.forms[v]) for v in problem.targets[target]) for target in targets]
        )
        weights = np.array([max(problem.weights[target], _SAME) for target in targets])
        worth: FloatArray = np.where(np.isfinite(longer_s), weights / np.maximum(longer_s, _TICK_S) ** haste, 0.0)
        return worth

    def with_target(self, target: str) -> _Plan | None:
        """Return the plan with a target, each of its visits where it makes a tour the least longer; None: none fits.

        Where not all of them fit so, the first is tried in another tour, or another first.
        """
        visits = self._problem.targets[target]
        for first in visits[:_FIRSTS]:
            rest = [visit for visit in visits if visit != first]
            for moves in islice(self._with_visit(first), None if rest else 1):
                grown: _Moves | None = moves
                for visit in rest:
                    assert grown is not None
                    grown = next(grown._with_visit(visit), None)
                    if grown is None:
                        break
                if grown is not None:
                    return grown._plan()
        return None

    def _with_visit(self, visit: int) -> Iterator[_Moves]:
        """Yield the plan with one more visit, in the tour first that it makes the least longer."""
        forms = list(self._problem.forms[visit])
        longer_s = np.where(self._fits[:, forms], self._more_s[:, forms], np.inf).min(axis=1)
        for k in np.argsort(longer_s, kind="stable").tolist():
            if not math.isfinite(longer_s[k]):
                break
            longer = self._longer(k, visit)
            if longer is not None:
                yield self._with_route(k, longer)

    def _longer(self, k: int, visit: int) -> _Route | None:
        """Return a route with a visit, where it adds the least of some places at which the battery suffices."""
        route, forms = self._routes[k], list(self._problem.forms[visit])
        more_s = self._more(route, self._problem.costs.time_s)[:, forms]
        for flat in np.argsort(more_s, axis=None, kind="stable")[:_TRIES].tolist():
            at, form = divmod(flat, len(forms))
            longer = _Route(route.vehicle, (*route.forms[:at], forms[form], *route.forms[at:]))
            if math.isfinite(more_s[at, form]) and self._problem.fits(longer):
                return longer
        return None

    def relieved(self) -> tuple[_Route, ...] | None:
        """Return the tours, those that took too much shorter, and at their end one more of who may still fly one."""
        problem, moves = self._problem, self
        for k in range(len(self._routes)):
            while not problem.fits(moves._routes[k]):
                found = moves._without_one(k)
                if found is None:
                    return None
                moves = found
        return tuple(moves._routes)

    def _without_one(self, k: int) -> _Moves | None:
        """Return the same with one visit of a tour in another, where that makes all the least longer; None: no room."""
        problem, route = self._problem, self._routes[k]
        best: tuple[float, _Moves] | None = None
        for n, form in enumerate(route.forms):
            shorter = _Route(route.vehicle, route.forms[:n] + route.forms[n + 1 :])
            left = self._with_route(k, shorter)
            left._fits[k] = False
            visit = int(problem.costs.visit[form])
            to = next(left._with_visit(visit), None)
            if to is None:
                continue
            flown_s = sum(problem.route_s(r) for r in to._routes if r.forms)
            if best is None or flown_s < best[0]:
                to._look_at(k)
                best = flown_s, to
        return None if best is None else best[1]

    def evener(self) -> _Plan | None:
        """Return a plan in which one visit is another's, so that flight times differ less; None: there is none."""
        problem = self._problem
        flown_s = np.zeros(problem.vehicles)
        for route in self._routes:
            flown_s[route.vehicle] += problem.route_s(route)
        owner = np.array([route.vehicle for route in self._routes])
        options = []
        for k, route in enumerate(self._routes):
            steps = problem.along(route, problem.costs.time_s)
            table = problem.costs.time_s[problem.costs.model[route.vehicle]]
            home = problem.costs.home(route.vehicle)
            places = (home, *route.forms, home)
            for n, form in enumerate(route.forms):
                less_s = float(
                    steps[n] + steps[n + 1] - (table[places[n], places[n + 2]] if len(route.forms) > 1 else 0)
                )
                others = list(problem.forms[int(problem.costs.visit[form])])
                more_s = np.where(self._fits[:, others], self._more_s[:, others], np.inf).min(axis=1)
                mine_s, theirs_s = flown_s[route.vehicle], flown_s[owner]
                change = (mine_s - less_s) ** 2 + (theirs_s + more_s) ** 2 - mine_s**2 - theirs_s**2
                change[owner == route.vehicle] = np.inf
                options += [(float(change[to]), k, n, int(to)) for to in np.flatnonzero(change < -1.0)]
        for _, k, n, to in sorted(options)[:_EVENER_TRIES]:
            route = self._routes[k]
            longer = self._longer(to, int(problem.costs.visit[route.forms[n]]))
            shorter = _Route(route.vehicle, route.forms[:n] + route.forms[n + 1 :])
            if longer is not None and (not shorter.forms or problem.fits(shorter)):
                changed = {k: shorter, to: longer}
                routes = [changed.get(i, r) for i, r in enumerate(self._routes)]
                return tuple(r for r in routes if r.forms)
        return None


class _Watch(pyvrp.IteratedLocalSearchCallbacks):
    """Offers all that the solver finds: what is best for it need not be so by the objective."""

    def __init__(self, model: _Model, search: _Search) -> None:
        self._model = model
        self._search = search

    def on_best(self, best: pyvrp.Solution) -> None:
        """Take a solution that is the solver's best so far."""
        self._search.offer(self._model.decoded(best))


class _Model:
    """The problem in the solver's terms: a place for every option of every choice, then the homes."""

    def __init__(
        self,
        problem: _Problem,
        choices: Sequence[_Choice],
        fleet: Sequence[tuple[int, float]],
        budget: FloatArray,
        return_height_m: FloatArray,
    ) -> None:
        self._options = [option for choice in choices for option in choice.options]
        self._index = {option: k for k, option in enumerate(self._options)}
        self._fleet = fleet
        costs = problem.costs
        count, vehicles = len(self._options), problem.vehicles
        first = np.array([option[0] for option in self._options] + [costs.home(v) for v in range(vehicles)])
        last = np.array([option[-1] for option in self._options] + [costs.home(v) for v in range(vehicles)])
        groups_of = [np.array([v]) for v in range(vehicles)]
        if not costs.returns or vehicles * len(first) ** 2 > _OWN_MAX:  # vehicles of one model, then
            groups_of = [np.flatnonzero(costs.model == m) for m in np.unique(costs.model)]
        group_of = {int(v): g for g, own in enumerate(groups_of) for v in own}
        times, self._shares = [], []
        for own in groups_of:
            m = int(costs.model[own[0]])
            time_s, share = costs.time_s[m][np.ix_(last, first)], costs.energy_share[m][np.ix_(last, first)]
            for k, option in enumerate(self._options):
                time_s[:, k] += sum(costs.time_s[m, a, b] for a, b in pairwise(option))
                share[:, k] += sum(costs.energy_share[m, a, b] for a, b in pairwise(option))
            if costs.returns:
                self._add_returns(share, costs, own, return_height_m)
            self._discount(share, problem, own)
            np.fill_diagonal(time_s, 0.0)  # as the solver will have it
            np.fill_diagonal(share, 0.0)
            times.append(_whole(time_s, _TICK_S))
            self._shares.append(_whole(share, _SHARE))
        self._group_of = group_of
        clients: list[pyvrp.Client] = []
        groups: list[pyvrp.ClientGroup] = []
        for choice in choices:
            alone = len(choice.options) == 1
            required = choice.prize_s == 0.0
            group = pyvrp.ClientGroup(required=required)
            for _ in choice.options:
                clients.append(
                    pyvrp.Client(
                        location=len(clients),
                        prize=round(choice.prize_s / _TICK_S),
                        required=required and alone,
                        delivery=[problem.items_of(choice.options[0])],
                        group=None if alone else len(groups),
                    )
                )
                group.add_client(len(clients) - 1)
            if not alone:
                groups.append(group)
        self.data = pyvrp.ProblemData(
            locations=[pyvrp.Location(0, 0) for _ in range(count + vehicles)],
            clients=clients,
            depots=[pyvrp.Depot(location=count + v) for v in range(vehicles)],
            vehicle_types=[self._type(v, longest_s, float(budget[v])) for v, longest_s in fleet],
            distance_matrices=self._shares,  # type: ignore[arg-type]  # as its stubs write numpy's types
            duration_matrices=times,  # type: ignore[arg-type]
            groups=groups,
        )

    def _discount(self, share: FloatArray, problem: _Problem, own: npt.NDArray[np.intp]) -> None:
        """Let visits that take more than a tour may, alone, take just as much as that, half of it on either way."""
        count = len(self._options)
        ends = np.array([(option[0], option[-1]) for option in self._options], dtype=np.intp).reshape(-1, 2)
        for v in own.tolist():
            alone = np.minimum(problem.alone[v], problem.allowed[v])
            half = 0.5 * np.maximum(alone - problem.budget[v], 0.0)
            share[count + v, :count] -= half[ends[:, 0]]
            share[:count, count + v] -= half[ends[:, 1]]

    def _add_returns(
        self, share: FloatArray, costs: TravelCosts, own: npt.NDArray[np.intp], return_height_m: FloatArray
    ) -> None:
        """Let a tour take so much that it suffices for returning from everywhere on it, from no higher than given.

        Every way takes at least by what returning becomes easier on it: then the whole takes at least what it takes up
        to any place and home from there.
        """
        count, m = len(self._options), int(costs.model[own[0]])
        for v in own.tolist():
            higher = float(costs.higher_share_m[v])
            home = costs.home_share[v] + higher * np.maximum(return_height_m[v] - costs.return_height_m[v], 0.0)
            after = np.array([self._least_after(option, home, costs.energy_share[m]) for option in self._options])
            share[:count, :count] = np.maximum(share[:count, :count], after[:, np.newaxis] - after)
            top = costs.top_share[v] + higher * max(0.0, float(return_height_m[v] - costs.top_height_m[v]))
            share[:count, count + v] = np.maximum(share[:count, count + v] + top, after)

    @staticmethod
    def _least_after(option: tuple[int, ...], home: FloatArray, share: FloatArray) -> float:
        """Return what must be left after an option, so that it was enough for returning from everywhere on it."""
        least, still = -math.inf, 0.0
        for k in range(len(option) - 1, -1, -1):
            least = max(least, float(home[option[k]]) - still)
            still += float(share[option[k - 1], option[k]]) if k > 0 else 0.0
        return least

    def taken(self, route: _Route) -> float:
        """Return what the solver reckons that a route takes of the battery."""
        home = len(self._options) + route.vehicle
        places = [home, *self._clients(route), home]
        share = self._shares[self._group_of[route.vehicle]]
        return sum(int(share[a, b]) for a, b in pairwise(places)) * _SHARE

    def _type(self, vehicle: int, longest_s: float, budget: float) -> pyvrp.VehicleType:
        limited = math.isfinite(longest_s)
        return pyvrp.VehicleType(
            start_depot=vehicle,
            end_depot=vehicle,
            profile=self._group_of[vehicle],
            max_distance=max(0, math.floor(budget / _SHARE)),
            capacity=[ITEMS_MAX],
            unit_distance_cost=0,
            unit_duration_cost=1,
            shift_duration=round(longest_s / _TICK_S) if limited else _BLOCKED,
            max_overtime=_BLOCKED,
            unit_overtime_cost=_OVERTIME if limited else 0,
        )

    def encoded(self, plan: _Plan) -> pyvrp.Solution:
        """Return a plan as the solver has it: a vehicle's longest tours first."""
        free: dict[int, list[int]] = {}
        for k, (vehicle, _) in enumerate(self._fleet):
            free.setdefault(vehicle, []).append(k)
        routes = [pyvrp.Route(self.data, self._clients(route), free[route.vehicle].pop(0)) for route in plan]
        return pyvrp.Solution(self.data, routes)

    def _clients(self, route: _Route) -> list[int]:
        clients, left = [], route.forms
        while left:
            size = next(n for n in range(len(left), 0, -1) if left[:n] in self._index)
            clients.append(self._index[left[:size]])
            left = left[size:]
        return clients

    def decoded(self, solution: pyvrp.Solution) -> _Plan:
        """Return a solution as a plan."""
        routes = []
        for route in solution.routes():
            forms = [f for activity in route if activity.is_client() for f in self._options[activity.idx]]
            if forms:
                routes.append(_Route(self._fleet[route.vehicle_type()][0], tuple(forms)))
        return tuple(routes)


def _whole(values: FloatArray, unit: float) -> npt.NDArray[np.int64]:
    """Return values (...) in whole units, rounded up; what is infinite, as far more than any tour may take."""
    counted = np.where(np.isfinite(values), np.ceil(values / unit - 1e-9), _BLOCKED)
    whole: npt.NDArray[np.int64] = np.minimum(counted, _BLOCKED).astype(np.int64)
    return whole


def _orders(problem: _Problem, visits: Sequence[int]) -> tuple[tuple[int, ...], ...]:
    """Return the shortest ways to fly a target's visits one after the other."""
    time_s = problem.costs.time_s.min(axis=0)
    ways: list[tuple[int, ...]] = [()]
    for _ in visits:
        ways = [
            (*way, form)
            for way in ways
            for visit in visits
            if all(problem.costs.visit[f] != visit for f in way)
            for form in problem.forms[visit]
        ]

    def within_s(way: tuple[int, ...]) -> float:
        return float(sum(time_s[a, b] for a, b in pairwise(way)))

    return tuple(sorted(ways, key=lambda way: (within_s(way), way))[:_ORDERS])


# --- what no tours can undercut


def _rounds_min(problem: _Problem) -> int:
    """Return a lower bound on the rounds that all targets take: how often batteries must be full."""
    visits = [visit for of in problem.targets.values() for visit in of]
    return max(1, math.ceil(_tours_min(problem, visits) / problem.vehicles))


def _tours_min(problem: _Problem, visits: Sequence[int]) -> int:
    """Return a lower bound on the tours through visits, by the energy of the shortest tree that joins them."""
    costs = problem.costs
    graph = _Graph.of(problem, visits, costs.energy_share, costs.inspection_share)
    forms = [form for visit in visits for form in problem.forms[visit]]
    alone = np.minimum(problem.alone[:, forms], problem.allowed[:, np.newaxis])  # a tour to what is far off may take
    most = float(max(problem.budget.max(), alone.max(initial=0.0)))
    tours = 1
    while tours < len(visits) and graph.bound(np.zeros(len(visits)), tours)[0] > tours * most + _SAME:
        tours += 1
    return tours


def _bound_s(problem: _Problem, visits: Sequence[int], plan: _Plan) -> float:
    """Return a lower bound on the flight time of all tours through visits.

    Tours are trees and as many ways home; multipliers that are raised at visits where the cheapest tree has too many
    ends, and lowered at its leaves, bring it nearer to tours (Held and Karp, 1971, doi:10.1007/BF01584070).
    """
    if not visits:
        return 0.0
    costs = problem.costs
    tours = _tours_min(problem, visits)
    graph = _Graph.of(problem, visits, costs.time_s, costs.inspection_s)
    above_s = sum(problem.route_s(route) for route in plan)
    multipliers = np.zeros(len(visits))
    best_s, degrees = graph.bound(multipliers, tours)
    pace, since = 1.0, 0
    for _ in range(_ASCENTS if len(visits) <= _MANY else _ASCENTS // 4):
        off = degrees - 2.0
        square = float(off @ off)
        if square == 0.0 or above_s <= best_s:
            break
        multipliers = multipliers + pace * (above_s - best_s) / square * off
        bound_s, degrees = graph.bound(multipliers, tours)
        since += 1
        if bound_s > best_s:
            best_s, since = bound_s, 0
        elif since >= _PATIENCE:
            pace, since = 0.5 * pace, 0
    return best_s


@dataclass(frozen=True, slots=True, eq=False)
class _Graph:
    """What joins visits (U) at least, whoever flies them, from whichever end to whichever; and all homes as one."""

    inside: float  # the visits themselves
    between: FloatArray  # (U, U)
    home: FloatArray  # (U,) half of a take-off and a landing included

    @classmethod
    def of(cls, problem: _Problem, visits: Sequence[int], cost: FloatArray, inspection: FloatArray) -> _Graph:
        costs = problem.costs
        number = {visit: k for k, visit in enumerate(visits)}
        forms = np.array([f for f, visit in enumerate(costs.visit) if int(visit) in number])
        owner = np.array([number[int(costs.visit[f])] for f in forms])
        by_visit = np.argsort(owner, kind="stable")
        forms, begins = forms[by_visit], np.searchsorted(owner[by_visit], np.arange(len(visits)))
        ways = np.full((len(forms), len(forms)), np.inf)
        out, back = np.full(len(forms), np.inf), np.full(len(forms), np.inf)
        for m in range(len(cost)):
            homes = len(costs.forms) + np.flatnonzero(costs.model == m)
            if not len(homes):
                continue
            own = inspection[m, forms]
            np.minimum(ways, cost[m][np.ix_(forms, forms)] - own, out=ways)
            np.minimum(out, (cost[m][np.ix_(homes, forms)] - own).min(axis=0), out=out)
            np.minimum(back, cost[m][np.ix_(forms, homes)].min(axis=1), out=back)
        of_visits = np.minimum.reduceat(np.minimum.reduceat(ways, begins, axis=0), begins, axis=1)
        out, back = np.minimum.reduceat(out, begins), np.minimum.reduceat(back, begins)
        once = float(out.min() + back.min())
        between = np.minimum(of_visits, of_visits.T)
        np.fill_diagonal(between, np.inf)
        return cls(
            inside=float(np.minimum.reduceat(inspection[:, forms].min(axis=0), begins).sum()),
            between=between,
            home=np.minimum(out - out.min(), back - back.min()) + 0.5 * once,
        )

    def bound(self, multipliers: FloatArray, tours: int) -> tuple[float, FloatArray]:
        """Return what so many tours, or more, cost at least, and the degrees (U,) of what costs just that."""
        home = self.home + multipliers
        degrees = np.zeros(len(home))
        degrees[int(np.argmin(home))] += tours
        if home.min() < 0.0:  # then more tours might cost less: nothing follows
            return -math.inf, degrees
        total = self.inside - 2.0 * float(multipliers.sum()) + tours * float(home.min())
        nearest, joined_by = home.copy(), np.full(len(home), -1)
        left = np.ones(len(home), dtype=np.bool_)
        for _ in range(len(home)):  # Prim, 1957, from home
            k = int(np.argmin(np.where(left, nearest, np.inf)))
            total += float(nearest[k])
            left[k] = False
            degrees[k] += 1.0
            if joined_by[k] >= 0:
                degrees[joined_by[k]] += 1.0
            way = self.between[k] + multipliers[k] + multipliers
            closer = left & (way < nearest)
            nearest[closer], joined_by[closer] = way[closer], k
        return total, degrees
