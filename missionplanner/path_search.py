"""One vehicle's path: first guesses from the graph, drawn to their optima, explored around by a swarm, then flown legs.

A guess is a clear polyline. It becomes a C2 cubic spline that hugs it, the closer the nearer its control points stand
to the corners. The cheapest few curves, of different homotopy classes, are polished (:mod:`.polish`): all their control
points move to the optimum that is nearest downhill, by exact derivatives. Around the cheapest of those PSO-ABC-SA, or
whatever the mission names, looks for what lies beyond the next hill: it bends the curve by a few wide handles, for as
long as that gains anything, and its best few finds are polished in turn. So a search starts from a clear path and can
only improve on it. A curve counts only when every leg fitted to it is proven clear with its whole tube, a plane's
predicted flight likewise; if not, the next cheapest is tried, then the guess, and then another attempt hugs closer and
keeps further off.

A vehicle that stands still at a place has one problem before it and another after it: its way is searched piece by
piece, and so is that of a copter through very many places. A piece of one leg that is clear itself, and costs nothing
but its length and climb, is the best there is: nothing is searched.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import partial
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from missionplanner.clearance import Margins, legs_clear, legs_within_angles, polyline_legs, tubes_clear
from missionplanner.cost import THREADS, Price
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.mission import Planner
from missionplanner.path import basis, length_m
from missionplanner.polish import polish
from missionplanner.scene import VehicleTask
from missionplanner.search.run import minimise
from missionplanner.seeds import first_guesses
from missionplanner.terrain_bounds import Pyramid
from missionplanner.waypoints import fit_waypoints, passes

_EXTRA_M = (0.0, 1.0, 2.0, 4.0, 7.0)
"""How much wider the margins are in each attempt: beside steep ground, a tube needs more height than straight below."""
_WIRE_M = 0.02
"""What rounding to 1e-7 degrees and single precision moves a waypoint at most."""
_OTHER_WAYS = 2
"""Guesses per section where other ways around are looked for."""
_DEAR = 0.05
"""Share of the price of flying straight by which a curve is so dear that another way around may be cheaper."""
_CLASSES = 3
"""How many of the guesses' curves are polished."""
_SAMPLES = 200
"""On an evenly sampled path, beyond which the way is long enough for coarser steps; corners get more."""
_SAMPLE_M = 15.0
_CORNER_M = 24.0
"""How far from a corner its neighbouring control points stand in the first attempt; halved in each further one."""
_PATIENCE = 3
"""Generations without a gain after which the swarm has seen enough."""
_LONG_PATIENCE = 20
"""The same while there is time; so many swarms in turn, too, may gain nothing."""
_GAIN = 1e-3
"""Share of the price that is a gain."""
_ELSEWHERE = 0.25
"""How far from the centre of its box (1: across) a point of the swarm is another find than its centre."""
_GENTLER = 0.85
"""By how much guesses climb and descend less when the curves around them were too steep."""
_LONG = 16
"""Sections of a copter's way between stops, more of which are not searched at once."""
_LEAST_FOUND = ("voyage", "climb", "inspection")
"""What any path pays: its length, and its climb; and all alike for towers that it does not pass."""
_NO_PRICE = 1e-9
_ANGLE_SLACK_RAD = math.radians(0.5)
"""The search keeps this far inside the climb limit, because a chord may be steeper than the curve it cuts."""

Clock = Callable[[], float]


@dataclass(slots=True)
class SearchSeconds:
    """What the parts of a search took, by the clock that was passed in."""

    graph_s: float = 0.0
    swarm_s: float = 0.0
    polish_s: float = 0.0
    proof_s: float = 0.0

    @property
    def search_s(self) -> float:
        """All but fitting the legs and proving them."""
        return self.graph_s + self.swarm_s + self.polish_s


@dataclass(frozen=True, slots=True)
class Budget:
    """Until when, by a clock that is passed in, a search may go on though it gains little; by default it does not.

    Time costs repeatability: how far a search comes depends on the machine.
    """

    clock: Clock | None = None
    until_s: float = -math.inf

    @property
    def left_s(self) -> float:
        """What is left, never below 0."""
        return 0.0 if self.clock is None else max(0.0, self.until_s - self.clock())

    @property
    def improves(self) -> bool:
        """Whether there is time left."""
        return self.left_s > 0.0

    def part(self, share: float) -> Budget:
        """Return a budget that ends when this share of what is left has passed."""
        return self if self.clock is None else Budget(self.clock, self.clock() + share * self.left_s)


@dataclass(frozen=True, slots=True, eq=False)
class PlannedPath:
    """A clear curve ``path_m`` (S, 3), its legs' ``waypoints_m`` (W, 3), and how the search came to it."""

    path_m: FloatArray
    waypoints_m: FloatArray
    length_m: float
    cost: float
    cost_terms: dict[str, float]
    history: FloatArray
    evaluations: int
    seconds: SearchSeconds = field(default_factory=SearchSeconds)
    pieces: tuple[PlannedPath, ...] = ()  # where it was searched piece by piece


@dataclass(frozen=True, slots=True, eq=False)
class _Family:
    """Curves around one curve: its samples, plus a spline of the handles' offsets."""

    base_m: FloatArray  # (S, 3)
    stops: npt.NDArray[np.intp]  # the samples at the route's points
    handles: FloatArray  # (S, H), the basis of the offsets; zero at the stops
    reach_m: FloatArray  # (H, 3), the greatest offsets
    freedom: FloatArray  # (S, K), the basis of all that the curve's own control points may do; zero at the stops

    @property
    def dimensions(self) -> int:
        """Coordinates of the search: three per handle."""
        return self.reach_m.size

    @property
    def centre(self) -> FloatArray:
        """The point of the unit box (3 H,) that is the curve itself."""
        return np.full(self.dimensions, 0.5)

    def paths(self, x: FloatArray) -> FloatArray:
        """Return the curves (P, S, 3) of points of the unit box (P, 3 H); its centre is the curve itself."""
        offsets = (2.0 * x.reshape(len(x), -1, 3) - 1.0) * self.reach_m
        paths: FloatArray = self.base_m + np.matmul(self.handles, offsets)
        return paths


@dataclass(frozen=True, slots=True, eq=False)
class _Curve:
    """A curve (S, 3), its price, and what it is a member of."""

    cost: float
    path_m: FloatArray
    family: _Family


@dataclass(slots=True, eq=False)
class _Finds:
    """What a search has found, the cheapest curve first, and what it took."""

    price: Price
    budget: Budget
    seconds: SearchSeconds = field(default_factory=SearchSeconds)
    begin: int = 0  # the stop at which the route begins, for messages
    history: list[float] = field(default_factory=list)
    evaluations: int = 0
    curves: list[_Curve] = field(default_factory=list)

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Add what is done within to a part of the seconds."""
        began_s = self.budget.clock() if self.budget.clock is not None else 0.0
        yield
        if self.budget.clock is not None:
            setattr(self.seconds, part, getattr(self.seconds, part) + self.budget.clock() - began_s)

    def add(self, cost: float, path_m: FloatArray, family: _Family) -> None:
        """Take a curve."""
        self.curves.append(_Curve(cost, path_m, family))
        self.curves.sort(key=lambda curve: curve.cost)
        self.told([cost])

    def told(self, costs: list[float]) -> None:
        """Take news of the cheapest price."""
        for cost in costs:
            self.history.append(min([cost, *self.history[-1:]]))

    def polished(self, path_m: FloatArray, family: _Family) -> None:
        """Draw a curve of a family to its optimum and take it."""
        with self.timed("polish_s"):
            result = polish(self.price, path_m, family.freedom)
        self.evaluations += result.evaluations
        self.add(result.cost, result.path_m, family)


@dataclass(frozen=True, slots=True, eq=False)
class Guesses:
    """The first guess per section (K, 3), or None where there is none with all that is wished for, and what it took."""

    sections: list[list[FloatArray]] | None
    graph_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """A part of a vehicle's way that is searched on its own: ``task`` has that part of the route only."""

    task: VehicleTask
    begin: int  # its first place's index in the whole route
    share: tuple[float, float]  # of the whole flight's time, roughly: when it begins and ends


def pieces_of(task: VehicleTask) -> list[Piece]:
    """Return the parts of a way that do not depend on each other: between the places where a copter stands still.

    And of a copter's way through very many places at most so many; planes turn smoothly everywhere.
    """
    last = len(task.route_m) - 1
    cuts = [0]
    if task.motion.vehicle_class == "copter":
        for k in range(1, last):
            held = k in task.actions and task.actions[k].stand_s > 0.0
            if held or (last > _LONG and k - cuts[-1] >= _LONG):
                cuts.append(k)
    cuts.append(last)
    legs_s = np.linalg.norm(np.diff(task.route_m, axis=0), axis=1) / task.limits.speed_max_m_s
    stands_s = [task.actions[k].stand_s if k in task.actions else 0.0 for k in range(1, last + 1)]
    times = np.concatenate([[0.0], np.cumsum(legs_s + stands_s)])
    times /= max(float(times[-1]), 1e-9)
    return [
        Piece(replace(task, route_m=task.route_m[a : b + 1], actions={}), a, (float(times[a]), float(times[b])))
        for a, b in pairwise(cuts)
    ]


def _one_leg(task: VehicleTask, space: SpaceArrays, bounds: Pyramid, wider_m: float) -> FloatArray | None:
    """Return the leg (2, 3) of a route of two places if it may be flown as it is, with room beyond; else None."""
    leg: FloatArray = np.round(task.route_m, 3)
    if len(leg) != 2:
        return None
    legs = leg[np.newaxis]
    clear = tubes_clear(space, bounds, task.limits, legs, _WIRE_M + wider_m)
    clear &= legs_within_angles(task.limits, legs, -_ANGLE_SLACK_RAD)
    return leg if clear.all() else None


def find_way(
    task: VehicleTask,
    space: SpaceArrays,
    bounds: Pyramid,
    names: tuple[str, ...],
    price_of: Callable[[Piece, float], Price],
    settings: Planner,
    rng: np.random.Generator,
    flown_is_clear: Callable[[FloatArray], bool],
    on_iteration: Callable[[float], None] | None = None,
    wider_m: Mapping[int, float] | None = None,
    budget: Budget | None = None,
    guesses: Guesses | None = None,
    kept: Mapping[int, PlannedPath] | None = None,
) -> PlannedPath:
    """Return a vehicle's whole way, its pieces found by :func:`find_path`, which says what the arguments are.

    Parameters
    ----------
    price_of
        The price of a piece's curves when all margins are tighter by the metres given.
    wider_m
        By piece; default: no wider.
    kept
        Paths of pieces, by number, that are not searched again.

    Raises
    ------
    InfeasibleError
        As :func:`find_path`.
    """
    pieces = pieces_of(task)
    budget = budget or Budget()
    wider_m = wider_m or {}
    kept = kept or {}
    generators = rng.spawn(len(pieces)) if len(pieces) > 1 else [rng]
    told = on_iteration if len(pieces) == 1 else None

    def find(number: int) -> PlannedPath:
        piece = pieces[number]
        if number in kept and len(passes(piece.task.route_m[[0, -1]], kept[number].waypoints_m[[0, -1]])) == 2:
            return kept[number]
        prices = partial(price_of, piece)
        room_m = wider_m.get(number, 0.0)
        straight = _straight(piece, prices(room_m), space, bounds, room_m) if len(pieces) > 1 else None
        if straight is not None:
            return straight
        known = guesses
        if guesses is not None and guesses.sections is not None:
            sections = guesses.sections[piece.begin : piece.begin + len(piece.task.route_m) - 1]
            known = replace(guesses, sections=sections, graph_s=guesses.graph_s if number == 0 else 0.0)
        return find_path(
            piece.task, space, bounds, names, prices, settings, generators[number], flown_is_clear, told, room_m,
            budget.part(min(1.0, THREADS / (len(pieces) - number))), known, begin=piece.begin,
        )  # fmt: skip

    if len(pieces) == 1:
        return find(0)
    found: list[PlannedPath] = []
    with ThreadPoolExecutor(THREADS, thread_name_prefix="piece") as pool:
        for path in pool.map(find, range(len(pieces))):
            found.append(path)
            if on_iteration is not None:
                on_iteration(len(found) / len(pieces))
    whole = _joined(pieces, found, price_of(Piece(task, 0, (0.0, 1.0)), settings.waypoint_tolerance_m))
    if not flown_is_clear(whole.waypoints_m):
        raise InfeasibleError(
            f"{task.name}: its way is clear, but turns where its pieces meet more than it may: put stops around the "
            "corners, or raise turn_angle_max_deg"
        )
    return whole


def _straight(piece: Piece, price: Price, space: SpaceArrays, bounds: Pyramid, wider_m: float) -> PlannedPath | None:
    """Return a piece of one leg, if no path is better; None: it is not known to be."""
    leg = _one_leg(piece.task, space, bounds, wider_m)
    if leg is None:
        return None
    samples = 1 + math.ceil(float(np.linalg.norm(leg[1] - leg[0])) / _SAMPLE_M)
    shares = np.linspace(0.0, 1.0, samples + 1)[:, np.newaxis]
    path_m: FloatArray = leg[0] + shares * (leg[1] - leg[0])
    weighted = {name: float(value[0]) for name, value in price.weighted(path_m[np.newaxis]).items()}
    cost = sum(weighted.values())
    if not cost - sum(weighted[name] for name in _LEAST_FOUND) <= _NO_PRICE:
        return None
    terms = {name: float(v[0]) for name, v in price.terms(path_m[np.newaxis]).items()}
    return PlannedPath(path_m, leg, float(length_m(path_m)), cost, terms, np.array([cost]), 1)


def _joined(pieces: list[Piece], found: list[PlannedPath], price: Price) -> PlannedPath:
    """Return the pieces' paths as one, its price that of the whole; its history weighs the pieces by their lengths."""
    path_m = np.concatenate([found[0].path_m, *(path.path_m[1:] for path in found[1:])])
    turns = max(len(path.history) for path in found)
    lengths_m = np.array([float(length_m(piece.task.route_m)) for piece in pieces])
    histories = [np.pad(path.history, (0, turns - len(path.history)), mode="edge") for path in found]
    seconds = SearchSeconds(
        *(sum(getattr(path.seconds, part.name) for path in found) for part in fields(SearchSeconds))
    )
    return PlannedPath(
        path_m=path_m,
        waypoints_m=np.concatenate([found[0].waypoints_m, *(path.waypoints_m[1:] for path in found[1:])]),
        length_m=float(length_m(path_m)),
        cost=float(price.total(path_m[np.newaxis])[0]),
        cost_terms={name: float(v[0]) for name, v in price.terms(path_m[np.newaxis]).items()},
        history=lengths_m @ np.array(histories) / lengths_m.sum(),
        evaluations=sum(path.evaluations for path in found),
        seconds=seconds,
        pieces=tuple(found),
    )


def guess(
    task: VehicleTask,
    space: SpaceArrays,
    bounds: Pyramid,
    names: tuple[str, ...],
    settings: Planner,
    clock: Clock | None = None,
) -> Guesses:
    """Return what :func:`find_way` begins with; it asks for it itself, unless it is given it.

    It depends on nobody else's path: those of several vehicles may be looked for at once, in threads.
    """
    began_s = clock() if clock is not None else 0.0
    extra_m = settings.waypoint_tolerance_m + _EXTRA_M[0]
    sections: list[list[FloatArray]] = []
    unknown = False
    pieces = pieces_of(task)
    try:
        for piece in pieces:
            leg = _one_leg(piece.task, space, bounds, 0.0) if len(pieces) > 1 else None
            sections += [[leg]] if leg is not None else _guess_sections(piece.task, space, names, extra_m, 1.0, 1)
    except InfeasibleError:
        unknown = True
    return Guesses(None if unknown else sections, clock() - began_s if clock is not None else 0.0)


def find_path(
    task: VehicleTask,
    space: SpaceArrays,
    bounds: Pyramid,
    names: tuple[str, ...],
    price_of: Callable[[float], Price],
    settings: Planner,
    rng: np.random.Generator,
    flown_is_clear: Callable[[FloatArray], bool],
    on_iteration: Callable[[float], None] | None = None,
    wider_m: float = 0.0,
    budget: Budget | None = None,
    guesses: Guesses | None = None,
    begin: int = 0,
) -> PlannedPath:
    """Return a clear, flyable, short and smooth path for one vehicle.

    Parameters
    ----------
    names
        Of the space's obstacles, for messages.
    price_of
        The price of curves when all margins are tighter by the metres given.
    flown_is_clear
        Whether the flight that is predicted along waypoints (W, 3) is clear and turns no tighter than it may.
    on_iteration
        Told the share of the search that is done.
    wider_m
        How much more than the margins is looked for, where there is room.
    budget
        How much longer it goes on improving.
    guesses
        What :func:`guess` found for the same task and space, where nothing wider is looked for.
    begin
        The stop at which the task's route begins, for messages.

    Raises
    ------
    InfeasibleError
        No clear path was found; the message names the vehicle and what blocks it.
    """
    budget = budget or Budget()
    seconds = SearchSeconds(graph_s=guesses.graph_s if guesses is not None else 0.0)
    known = guesses.sections if guesses is not None and wider_m == 0.0 else None
    gentleness = 1.0
    for attempt, more_m in enumerate(_EXTRA_M):
        # the fitted legs may leave the curve by the tolerance
        extra_m = settings.waypoint_tolerance_m + wider_m + more_m
        finds = _Finds(price_of(extra_m), budget, seconds, begin)
        corner_m = _corner_m(task) / 2**attempt
        try:
            _guess(task, space, names, extra_m, gentleness, corner_m, finds, known=known if attempt == 0 else None)
        except InfeasibleError:
            if attempt > 0:
                break  # there is a way, but no room to hold it closer
            extra_m = settings.waypoint_tolerance_m
            finds.price = price_of(extra_m)
            _guess(task, space, names, extra_m, gentleness, corner_m, finds)
        base_m = finds.curves[0].family.base_m
        if finds.curves[0].cost > (1.0 + _DEAR) * finds.price.straight(task.route_m):
            _guess(task, space, names, extra_m, gentleness, corner_m, finds, _OTHER_WAYS)
        _explore(finds, settings, rng, on_iteration if attempt == 0 else None)
        for curve in finds.curves:
            path_m, family = np.round(curve.path_m, 3), curve.family
            with finds.timed("proof_s"):
                waypoints = _flyable_legs(path_m, family.stops, task, space, bounds, settings.waypoint_tolerance_m)
                clear = waypoints is not None and flown_is_clear(waypoints)
            if waypoints is not None and clear:
                return PlannedPath(
                    path_m=path_m,
                    waypoints_m=waypoints,
                    length_m=float(length_m(path_m)),
                    cost=float(finds.price.total(path_m[np.newaxis])[0]),
                    cost_terms={name: float(v[0]) for name, v in finds.price.terms(path_m[np.newaxis]).items()},
                    history=np.array(finds.history),
                    evaluations=finds.evaluations,
                    seconds=seconds,
                )
        if not legs_within_angles(task.limits, polyline_legs(base_m), _ANGLE_SLACK_RAD).all():
            gentleness *= _GENTLER  # a curve cuts the bends of a climb that winds up, and gets steeper there
    raise InfeasibleError(
        f"{task.name}: found no path that is proven clear with its whole tube in {len(_EXTRA_M)} attempts: "
        "widen the gaps, reduce its safety distances, or move its stops"
    )


def _explore(
    finds: _Finds, settings: Planner, rng: np.random.Generator, on_iteration: Callable[[float], None] | None
) -> None:
    """Look around the cheapest curve for others, and polish them; again while that gains, or while there is time."""
    idle = 0
    told = on_iteration
    while idle < (_LONG_PATIENCE if finds.budget.improves else 1):
        best = finds.curves[0]
        for path_m in _swarm(best, finds, settings, rng, told):
            finds.polished(path_m, best.family)
        told = None
        idle = 0 if finds.curves[0].cost < (1.0 - _GAIN) * best.cost else idle + 1
    if on_iteration is not None:
        on_iteration(1.0)


def _swarm(
    around: _Curve,
    finds: _Finds,
    settings: Planner,
    rng: np.random.Generator,
    on_iteration: Callable[[float], None] | None,
) -> list[FloatArray]:
    """Return the few curves that the mission's algorithm finds around one, worth a polish.

    The cheapest of all, if it is cheaper, and the cheapest of those that lie elsewhere: a polish may well make more of
    it. A swarm that gains nothing for a while stops.
    """
    family, least = replace(around.family, base_m=around.path_m), around.cost
    left_s = finds.budget.left_s  # asked once: it runs
    evaluations = settings.population * settings.iterations
    patience = _LONG_PATIENCE if left_s > 0.0 else _PATIENCE
    shaken = family.centre + rng.normal(0.0, 0.1, (settings.population // 2, family.dimensions))
    elsewhere, elsewhere_cost = family.base_m, math.inf
    gained, idle = least, 0

    def cost(x: FloatArray) -> FloatArray:
        nonlocal elsewhere, elsewhere_cost
        paths = family.paths(x)
        total = finds.price.total(paths)
        far = np.where(np.abs(x - family.centre).max(axis=1) > _ELSEWHERE, total, np.inf)
        leader = int(np.argmin(far))
        if far[leader] < elsewhere_cost:
            elsewhere, elsewhere_cost = paths[leader].copy(), float(far[leader])
        return total

    def seen_enough(used: int, best: float) -> bool:
        nonlocal gained, idle
        better = best < gained - _GAIN * abs(gained)
        gained, idle = (best, 0) if better else (gained, idle + 1)
        if on_iteration is not None:
            on_iteration(used / evaluations)
        return idle >= patience

    with finds.timed("swarm_s"):
        result = minimise(
            cost,
            np.zeros(family.dimensions),
            np.ones(family.dimensions),
            algorithm=settings.algorithm,
            evaluations=evaluations,
            seed=int(rng.integers(2**63)),
            population=settings.population,
            initial=np.concatenate([family.centre[np.newaxis], shaken]),
            callback=seen_enough,
            seconds=left_s or None,
            clock=finds.budget.clock or (lambda: 0.0),
        )
        finds.evaluations += result.evaluations
        finds.told(result.history.tolist())
        found = [family.paths(result.best[np.newaxis])[0]] if result.cost < least else []
    return found + ([elsewhere] if math.isfinite(elsewhere_cost) else [])


def _flyable_legs(
    path_m: FloatArray,
    stops: npt.NDArray[np.intp],
    task: VehicleTask,
    space: SpaceArrays,
    bounds: Pyramid,
    tolerance_m: float,
) -> FloatArray | None:
    """Return waypoints when the curve is clear and the legs fitted to it are proven, else None."""
    limits, margins = task.limits, Margins.of(task.limits)
    if not legs_clear(space, margins, polyline_legs(path_m)).all():
        return None
    if not legs_within_angles(limits, polyline_legs(path_m), _ANGLE_SLACK_RAD).all():
        return None
    return fit_waypoints(
        path_m,
        stops,
        tolerance_m,
        lambda legs: legs_within_angles(limits, legs, 1e-6) & tubes_clear(space, bounds, limits, legs, _WIRE_M),
    )


def _guess(
    task: VehicleTask,
    space: SpaceArrays,
    names: tuple[str, ...],
    extra_m: float,
    gentleness: float,
    corner_m: float,
    finds: _Finds,
    count: int = 1,
    known: list[list[FloatArray]] | None = None,
) -> None:
    """Take the curves around the first guesses that are not tried yet, and polish the cheapest few."""
    with finds.timed("graph_s"):
        sections = known or _guess_sections(task, space, names, extra_m, gentleness, count, finds.begin)
        families = _families(sections, corner_m, finds)
    for family in families:
        finds.polished(family.base_m, family)


def _guess_sections(
    task: VehicleTask,
    space: SpaceArrays,
    names: tuple[str, ...],
    extra_m: float,
    gentleness: float,
    count: int,
    begin: int = 0,
) -> list[list[FloatArray]]:
    """Return, for each pair of consecutive route points, clear polylines (K, 3) between them, the shortest first."""
    climb_rad, descent_rad = (
        gentleness * max(angle_rad - 2 * _ANGLE_SLACK_RAD, 0.5 * angle_rad)
        for angle_rad in (task.limits.climb_angle_rad, task.limits.descent_angle_rad)
    )
    limits = replace(task.limits, climb_angle_rad=climb_rad, descent_angle_rad=descent_rad)
    sections = []
    for index, (start, goal) in enumerate(pairwise(task.route_m), start=begin):
        try:
            sections.append(
                first_guesses(space, limits, start, goal, count=count, clearance_extra_m=extra_m, names=names)
            )
        except InfeasibleError as error:
            raise InfeasibleError(f"{task.name}: no way from stop {index} to stop {index + 1}: {error}") from error
    return sections


def _corner_m(task: VehicleTask) -> float:
    """Return how far from its corners the first attempt's curve may leave the guess: room for the turns it must fly."""
    return max(_CORNER_M, 2.0 * task.limits.turn_radius_m)


def _families(sections: list[list[FloatArray]], corner_m: float, finds: _Finds) -> list[_Family]:
    """Return the curves around the cheapest few new combinations of guesses, looked for section by section.

    Who looks for several guesses may find a shorter first one than who looks for one.
    """
    tried: list[_Curve] = []

    def cost_of(chosen: list[FloatArray]) -> float:
        family = _family(chosen, corner_m)
        cost = float(finds.price.total(family.base_m[np.newaxis])[0])
        tried.append(_Curve(cost, family.base_m, family))
        return cost

    chosen = [guesses[0] for guesses in sections]
    best_cost = cost_of(chosen)
    for s, guesses in enumerate(sections):
        for other in guesses[1:]:
            candidate = [*chosen[:s], other, *chosen[s + 1 :]]
            cost = cost_of(candidate)
            if cost < best_cost:
                best_cost, chosen = cost, candidate
    finds.evaluations += len(tried)
    known = [curve.family.base_m for curve in finds.curves]
    new = [curve for curve in tried if not any(np.array_equal(curve.path_m, base_m) for base_m in known)]
    new.sort(key=lambda curve: curve.cost)
    for curve in new:
        finds.add(curve.cost, curve.path_m, curve.family)
    return [curve.family for curve in new[:_CLASSES]]


def _family(polylines: list[FloatArray], corner_m: float) -> _Family:
    """Return the curves around one polyline per section."""
    control = [polylines[0][:1]]
    ends = [0]  # indices of the route's points among the control points
    for polyline in polylines:
        control += [_graded(a, b, corner_m) for a, b in pairwise(polyline) if not np.array_equal(a, b)]
        ends.append(sum(len(part) for part in control) - 1)
    points = np.concatenate(control)
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at_stops = knots[ends]

    # dense where control points stand close, at corners; elsewhere as coarse as a long way asks for
    spacing_m = max(_SAMPLE_M, at_stops[-1] / _SAMPLES)
    pieces = np.maximum(2, np.ceil(np.diff(knots) / spacing_m).astype(int))
    samples = np.concatenate(
        [[0.0], *(np.linspace(a, b, n + 1)[1:] for (a, b), n in zip(pairwise(knots), pieces, strict=True))]
    )
    stops = np.concatenate([[0], np.cumsum(pieces)])[ends]

    # a handle about every 250 m, at least one between stops; the vertical reach is smaller: height costs more
    counts = np.clip(np.round(np.diff(at_stops) / 250.0).astype(int), 1, 8)
    places = [np.linspace(a, b, n + 2)[1:-1] for (a, b), n in zip(pairwise(at_stops), counts, strict=True)]
    gaps = np.repeat(np.diff(at_stops) / (counts + 1), counts)
    handle_knots = np.sort(np.concatenate([at_stops, *places]))
    moving = ~np.isin(handle_knots, at_stops)
    lateral_m, vertical_m = np.clip(0.2 * gaps, 3.0, 60.0), np.clip(0.1 * gaps, 3.0, 30.0)
    own = basis(knots, samples)
    inner = np.ones(len(knots), dtype=bool)
    inner[ends] = False
    return _Family(
        base_m=own @ points,
        stops=stops,
        handles=basis(handle_knots, samples)[:, moving],
        reach_m=np.stack([lateral_m, lateral_m, vertical_m], axis=1),
        freedom=np.ascontiguousarray(own[:, inner]),
    )


def _graded(a: FloatArray, b: FloatArray, corner_m: float) -> FloatArray:
    """Return control points (N, 3) on the leg from a (excluded) to b: close at both ends, ever wider in between.

    Steps that double keep a spline from swinging out beside a corner.
    """
    leg_m = float(np.linalg.norm(b - a))
    from_end_m: list[float] = []
    step_m = min(corner_m, leg_m / 3.0)
    while sum(from_end_m[-1:]) + step_m < 0.5 * leg_m:
        from_end_m.append(sum(from_end_m[-1:]) + step_m)
        step_m *= 2.0
    along = np.array([*from_end_m, *(leg_m - d for d in reversed(from_end_m)), leg_m]) / max(leg_m, 1e-9)
    points: FloatArray = a + along[:, np.newaxis] * (b - a)
    return points
