"""One vehicle's path: first guesses from the graph, PSO-ABC-SA on a smooth curve, then the legs that are flown.

A guess is a clear polyline. It becomes a C2 cubic spline that hugs it, the closer the nearer its control points stand
to the corners. Of all guesses, one per homotopy class, the cheapest curve is taken, and the search bends it: it moves a
few handles between the route's points, and the curve follows as a second, wider spline of their offsets. So the search
starts from a clear path and can only improve on it. A curve counts only when every leg fitted to it is proven clear
with its whole tube, a plane's predicted flight likewise; if not, the next attempt hugs closer and keeps further off.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from missionplanner.clearance import Margins, legs_clear, legs_within_angles, polyline_legs, tubes_clear
from missionplanner.cost import Price
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.mission import Planner
from missionplanner.path import basis, length_m
from missionplanner.scene import VehicleTask
from missionplanner.search.base import SearchResult
from missionplanner.search.run import minimise
from missionplanner.seeds import first_guesses
from missionplanner.terrain_bounds import Pyramid
from missionplanner.waypoints import fit_waypoints

_EXTRA_M = (0.0, 1.0, 2.0, 4.0, 7.0)
"""How much wider the margins are in each attempt: beside steep ground, a tube needs more height than straight below."""
_WIRE_M = 0.02
"""What rounding to 1e-7 degrees and single precision moves a waypoint at most."""
_GUESSES_PER_SECTION = 2
_SAMPLES = 200
"""On an evenly sampled path, beyond which the way is long enough for coarser steps; corners get more."""
_SAMPLE_M = 15.0
_CORNER_M = 24.0
"""How far from a corner its neighbouring control points stand in the first attempt; halved in each further one."""
_SETTLING_COST = 0.003
"""Share of the price that may be given up for a curve of fewer bends."""
_GENTLER = 0.85
"""By how much guesses climb and descend less when the curves around them were too steep."""
_ANGLE_SLACK_RAD = math.radians(0.5)
"""The search keeps this far inside the climb limit, because a chord may be steeper than the curve it cuts."""


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


@dataclass(frozen=True, slots=True, eq=False)
class _Family:
    """Curves around one guess: samples of the guess's own spline, plus a spline of the handles' offsets."""

    base_m: FloatArray  # (S, 3)
    stops: npt.NDArray[np.intp]  # the samples at the route's points
    handles: FloatArray  # (S, H), the basis of the offsets; zero at the stops
    reach_m: FloatArray  # (H, 3), the greatest offsets

    @property
    def dimensions(self) -> int:
        """Coordinates of the search: three per handle."""
        return self.reach_m.size

    @property
    def guess(self) -> FloatArray:
        """The point of the unit box (3 H,) that is the guess itself."""
        return np.full(self.dimensions, 0.5)

    def paths(self, x: FloatArray) -> FloatArray:
        """Return the curves (P, S, 3) of points of the unit box (P, 3 H); its centre is the guess."""
        offsets = (2.0 * x.reshape(len(x), -1, 3) - 1.0) * self.reach_m
        paths: FloatArray = self.base_m + np.matmul(self.handles, offsets)
        return paths


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

    Raises
    ------
    InfeasibleError
        No clear path was found; the message names the vehicle and what blocks it.
    """
    gentleness = 1.0
    for attempt, more_m in enumerate(_EXTRA_M):
        # the fitted legs may leave the curve by the tolerance
        extra_m = settings.waypoint_tolerance_m + wider_m + more_m
        try:
            sections = _guess_sections(task, space, names, extra_m, gentleness)
        except InfeasibleError:
            if attempt > 0:
                break  # there is a way, but no room to hold it closer
            extra_m = settings.waypoint_tolerance_m
            sections = _guess_sections(task, space, names, extra_m, gentleness)
        price = price_of(extra_m)
        family = _cheapest_family(sections, _corner_m(task) / 2**attempt, price)
        result = _search(family, price, settings, rng, on_iteration if attempt == 0 else None)
        settled = _settled(family, result.best, price)
        for path_m in np.round(family.paths(np.stack([settled, result.best, family.guess])), 3):
            waypoints = _flyable_legs(path_m, family.stops, task, space, bounds, settings.waypoint_tolerance_m)
            if waypoints is not None and flown_is_clear(waypoints):
                return PlannedPath(
                    path_m=path_m,
                    waypoints_m=waypoints,
                    length_m=float(length_m(path_m)),
                    cost=float(price.total(path_m[np.newaxis])[0]),
                    cost_terms={name: float(value[0]) for name, value in price.terms(path_m[np.newaxis]).items()},
                    history=result.history,
                    evaluations=result.evaluations,
                )
        if not legs_within_angles(task.limits, polyline_legs(family.base_m), _ANGLE_SLACK_RAD).all():
            gentleness *= _GENTLER  # a curve cuts the bends of a climb that winds up, and gets steeper there
    raise InfeasibleError(
        f"{task.name}: found no path that is proven clear with its whole tube in {len(_EXTRA_M)} attempts: "
        "widen the gaps, reduce its safety distances, or move its stops"
    )


def _search(
    family: _Family,
    price: Price,
    settings: Planner,
    rng: np.random.Generator,
    on_iteration: Callable[[float], None] | None,
) -> SearchResult:
    """Return the cheapest member of the family that the search finds; it begins at and around the guess."""
    evaluations = settings.population * settings.iterations
    shaken = family.guess + rng.normal(0.0, 0.1, (settings.population // 2, family.dimensions))

    def report(used: int, _best: float) -> None:
        if on_iteration is not None:
            on_iteration(used / evaluations)

    return minimise(
        lambda x: price.total(family.paths(x)),
        np.zeros(family.dimensions),
        np.ones(family.dimensions),
        algorithm=settings.algorithm,
        evaluations=evaluations,
        seed=int(rng.integers(2**63)),
        population=settings.population,
        initial=np.concatenate([family.guess[np.newaxis], shaken]),
        callback=report,
    )


def _settled(family: _Family, x: FloatArray, price: Price) -> FloatArray:
    """Return ``x`` with every handle back on the guess that does not earn its place.

    A swarm leaves all handles a little off. Each costs waypoints, for a curve that straight legs would fly as well.
    """
    handles = x.reshape(-1, 3).copy()
    most = float(price.total(family.paths(x[np.newaxis]))[0]) * (1.0 + _SETTLING_COST)
    off = list(range(len(handles)))
    while off:
        trials = np.repeat(handles[np.newaxis], len(off), axis=0)
        trials[np.arange(len(off)), off] = 0.5
        costs = price.total(family.paths(trials.reshape(len(off), -1)))
        cheapest = int(np.argmin(costs))
        if costs[cheapest] > most:
            break
        handles[off.pop(cheapest)] = 0.5
    return handles.ravel()


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


def _guess_sections(
    task: VehicleTask, space: SpaceArrays, names: tuple[str, ...], extra_m: float, gentleness: float
) -> list[list[FloatArray]]:
    """Return, for each pair of consecutive route points, clear polylines (K, 3) between them, the shortest first."""
    climb_rad, descent_rad = (
        gentleness * max(angle_rad - 2 * _ANGLE_SLACK_RAD, 0.5 * angle_rad)
        for angle_rad in (task.limits.climb_angle_rad, task.limits.descent_angle_rad)
    )
    limits = replace(task.limits, climb_angle_rad=climb_rad, descent_angle_rad=descent_rad)
    sections = []
    for index, (start, goal) in enumerate(pairwise(task.route_m)):
        try:
            sections.append(
                first_guesses(
                    space, limits, start, goal, count=_GUESSES_PER_SECTION, clearance_extra_m=extra_m, names=names
                )
            )
        except InfeasibleError as error:
            raise InfeasibleError(f"{task.name}: no way from stop {index} to stop {index + 1}: {error}") from error
    return sections


def _corner_m(task: VehicleTask) -> float:
    """Return how far from its corners the first attempt's curve may leave the guess: room for the turns it must fly."""
    return max(_CORNER_M, 2.0 * task.limits.turn_radius_m)


def _cheapest_family(sections: list[list[FloatArray]], corner_m: float, price: Price) -> _Family:
    """Return the curves around the cheapest combination of the sections' guesses, looked for section by section."""
    chosen = [guesses[0] for guesses in sections]
    best = _family(chosen, corner_m)
    best_cost = float(price.total(best.base_m[np.newaxis])[0])
    for s, guesses in enumerate(sections):
        for other in guesses[1:]:
            candidate = _family([*chosen[:s], other, *chosen[s + 1 :]], corner_m)
            cost = float(price.total(candidate.base_m[np.newaxis])[0])
            if cost < best_cost:
                best, best_cost, chosen = candidate, cost, [*chosen[:s], other, *chosen[s + 1 :]]
    return best


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
    return _Family(
        base_m=basis(knots, samples) @ points,
        stops=stops,
        handles=basis(handle_knots, samples)[:, moving],
        reach_m=np.stack([lateral_m, lateral_m, vertical_m], axis=1),
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
