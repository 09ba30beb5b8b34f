"""One vehicle's path: first guesses from the graph, PSO-ABC-SA on a smooth curve, then the legs that are flown.

The curve is a C2 cubic spline through the route's points and free control points between them. The search moves the
free ones in a box around the guesses of all homotopy classes at once, so that it may change its mind about the side of
an obstacle. A curve counts only when every piece of it, and every leg fitted to it, is clear by the vehicle's whole
margin; if not, the next attempt holds the curve closer to the guess, which is itself clear.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from missionplanner.clearance import Margins, legs_clear, legs_within_angles, polyline_legs
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
from missionplanner.waypoints import fit_waypoints

_ATTEMPTS = 5
_GUESSES_PER_SECTION = 4
_CANDIDATES = 8
_SAMPLES_MAX = 600
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
class _Curve:
    """A family of splines: ``control`` (K, 3) of the first guess, of which ``free`` may move, sampled by ``matrix``."""

    matrix: FloatArray  # (S, K)
    stops: npt.NDArray[np.intp]  # samples at the route's points
    free: npt.NDArray[np.intp]
    candidates: FloatArray  # (C, K, 3)
    lower: FloatArray  # (F, 3)
    upper: FloatArray  # (F, 3)

    @property
    def guesses(self) -> FloatArray:
        """The candidates' free points in the unit box: (C, 3 F)."""
        moved = (self.candidates[:, self.free] - self.lower) / (self.upper - self.lower)
        return moved.reshape(len(moved), -1)

    def paths(self, x: FloatArray) -> FloatArray:
        """Return the curves (P, S, 3) of points of the unit box (P, 3 F)."""
        control = np.repeat(self.candidates[:1], len(x), axis=0)
        control[:, self.free] = self.lower + x.reshape(len(x), -1, 3) * (self.upper - self.lower)
        paths: FloatArray = np.matmul(self.matrix, control)
        return paths


def find_path(
    task: VehicleTask,
    space: SpaceArrays,
    price_of: Callable[[float], Price],
    settings: Planner,
    rng: np.random.Generator,
    flown_is_clear: Callable[[FloatArray], bool],
    on_iteration: Callable[[float], None] | None = None,
) -> PlannedPath:
    """Return a clear, flyable, short and smooth path for one vehicle.

    Parameters
    ----------
    price_of
        The price of curves when all margins are tighter by the metres given.
    flown_is_clear
        Whether the curve that the autopilot flies along waypoints (W, 3), corners cut, is clear.
    on_iteration
        Told the share of the search that is done.

    Raises
    ------
    InfeasibleError
        No clear path was found; the message names the vehicle and what blocks it.
    """
    corner_m = 0.2 * task.motion.waypoint_radius_m
    for attempt in range(_ATTEMPTS):
        # the fitted legs may leave the curve by the tolerance and the vehicle cuts its corners: room for both
        extra_m = settings.waypoint_tolerance_m + corner_m * (1 + attempt)
        try:
            sections = _guess_sections(task, space, extra_m)
        except InfeasibleError:
            if attempt > 0:
                break  # there is a way, but no room to hold it closer
            extra_m = settings.waypoint_tolerance_m
            sections = _guess_sections(task, space, extra_m)
        curve = _curve(sections, 2**attempt)
        price = price_of(extra_m)
        result = _search(curve, price, settings, rng, on_iteration if attempt == 0 else None)
        for x in (result.best, curve.guesses[0]):
            path_m = np.round(curve.paths(x[np.newaxis])[0], 3)
            waypoints = _flyable_legs(path_m, curve.stops, task, space, settings.waypoint_tolerance_m)
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
    raise InfeasibleError(
        f"{task.name}: found no path that stays clear by its whole margin, corners included, in {_ATTEMPTS} attempts: "
        "widen the gaps, reduce its safety distances, or move its stops"
    )


def _search(
    curve: _Curve,
    price: Price,
    settings: Planner,
    rng: np.random.Generator,
    on_iteration: Callable[[float], None] | None,
) -> SearchResult:
    """Return the cheapest member of the family found from its guesses."""
    evaluations = settings.population * settings.iterations

    def report(used: int, _best: float) -> None:
        if on_iteration is not None:
            on_iteration(used / evaluations)

    return minimise(
        lambda x: price.total(curve.paths(x)),
        np.zeros(curve.lower.size),
        np.ones(curve.lower.size),
        algorithm=settings.algorithm,
        evaluations=evaluations,
        seed=int(rng.integers(2**63)),
        population=settings.population,
        initial=_around(curve.guesses, settings.population // 2, rng),
        callback=report,
    )


def _flyable_legs(
    path_m: FloatArray, stops: npt.NDArray[np.intp], task: VehicleTask, space: SpaceArrays, tolerance_m: float
) -> FloatArray | None:
    """Return waypoints when the curve and the legs fitted to it are clear, else None."""
    limits, margins = task.limits, Margins.of(task.limits)
    if not legs_clear(space, margins, polyline_legs(path_m)).all():
        return None
    if not legs_within_angles(limits, polyline_legs(path_m), _ANGLE_SLACK_RAD).all():
        return None
    return fit_waypoints(
        path_m,
        stops,
        tolerance_m,
        lambda legs: legs_clear(space, margins, legs) & legs_within_angles(limits, legs, 1e-6),
    )


def _guess_sections(task: VehicleTask, space: SpaceArrays, extra_m: float) -> list[list[FloatArray]]:
    limits = replace(
        task.limits,
        climb_angle_rad=max(task.limits.climb_angle_rad - 2 * _ANGLE_SLACK_RAD, 0.5 * task.limits.climb_angle_rad),
        descent_angle_rad=max(
            task.limits.descent_angle_rad - 2 * _ANGLE_SLACK_RAD, 0.5 * task.limits.descent_angle_rad
        ),
    )
    sections = []
    for index, (start, goal) in enumerate(pairwise(task.route_m)):
        try:
            sections.append(
                first_guesses(space, limits, start, goal, count=_GUESSES_PER_SECTION, clearance_extra_m=extra_m)
            )
        except InfeasibleError as error:
            raise InfeasibleError(f"{task.name}: no way from stop {index} to stop {index + 1}: {error}") from error
    return sections


def _curve(sections: list[list[FloatArray]], density: int) -> _Curve:
    """Return the splines around the sections' guesses, with ``density`` times the usual number of control points."""
    counts = [_free_points(guesses[0], density) for guesses in sections]
    combinations = [[guesses[0] for guesses in sections]]
    for s, guesses in enumerate(sections):
        for other in guesses[1:]:
            combinations.append([*combinations[0][:s], other, *combinations[0][s + 1 :]])
    combinations = combinations[:_CANDIDATES]
    candidates = np.stack([_control(c, counts) for c in combinations])  # (C, K, 3)
    fixed = np.cumsum([0, *(n + 1 for n in counts)])
    control_count = candidates.shape[1]
    free = np.setdiff1d(np.arange(control_count), fixed)

    chords = np.linalg.norm(np.diff(candidates[0], axis=0), axis=1)
    knots = np.concatenate([[0.0], np.cumsum(np.maximum(chords, 1e-3))])
    spacing = max(knots[-1] / _SAMPLES_MAX, min(15.0, knots[-1] / 64))
    samples = [np.zeros(1)]
    stops = [0]
    for begin, end in pairwise(fixed):
        pieces = max(int(end - begin) * 4, math.ceil((knots[end] - knots[begin]) / spacing))
        samples.append(np.linspace(knots[begin], knots[end], pieces + 1)[1:])
        stops.append(stops[-1] + pieces)

    room = _room(knots, fixed, free, density)
    moving = candidates[:, free]
    return _Curve(
        matrix=basis(knots, np.concatenate(samples)),
        stops=np.array(stops, dtype=np.intp),
        free=free,
        candidates=candidates,
        lower=moving.min(axis=0) - room,
        upper=moving.max(axis=0) + room,
    )


def _free_points(guess: FloatArray, density: int) -> int:
    """Return how many control points a section gets: more where the way is long or bends."""
    bends = len(guess) - 2
    return density * max(1, min(4, round(float(length_m(guess)) / 400)), min(12, 2 * bends + 1))


def _control(polylines: list[FloatArray], counts: list[int]) -> FloatArray:
    """Return control points (K, 3): the route's points, and between them ``counts`` points evenly along the guess."""
    points = [polylines[0][:1]]
    for polyline, count in zip(polylines, counts, strict=True):
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(polyline, axis=0), axis=1))])
        at = np.linspace(0.0, along[-1], count + 2)[1:]
        points.append(np.stack([np.interp(at, along, polyline[:, k]) for k in range(3)], axis=1))
    return np.concatenate(points)


def _room(knots: FloatArray, fixed: npt.NDArray[np.intp], free: npt.NDArray[np.intp], density: int) -> FloatArray:
    """Return how far (F, 3) each free point may leave the guesses: with the section's length, less when denser."""
    section = np.searchsorted(fixed, free) - 1
    length = knots[fixed[section + 1]] - knots[fixed[section]]
    lateral = np.clip(0.1 * length, 3.0, 150.0) / density**2
    vertical = np.clip(0.05 * length, 3.0, 60.0) / density**2
    return np.stack([lateral, lateral, vertical], axis=1)


def _around(guesses: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Return the guesses (C, D) and, up to ``count`` rows, copies of them shaken a little."""
    copies = guesses[np.arange(max(0, count - len(guesses))) % len(guesses)]
    shaken = copies + rng.normal(0.0, 0.05, copies.shape)
    around: FloatArray = np.clip(np.concatenate([guesses, shaken]), 0.0, 1.0)
    return around
