"""Conductors between towers: catenaries, and the few straight pieces that stand for them as obstacles.

A conductor hangs as ``z = a cosh((u - u0) / a) + const`` in the vertical plane of its ends, ``a`` its horizontal
tension over its weight per metre. Chords of a catenary lie above it, never below: who keeps above them keeps above it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from missionplanner.geodesy import FloatArray

CHORD_ERROR_M = 0.5
"""How far above the conductor the straight pieces that stand for it are at most."""

_USUAL_CATENARY_M = 2000.0  # of lines up to some 500 m apart
_ASSUMED_SAG_M = 15.0
"""Where nobody says how tight a conductor is, longer spans are taken to be tighter than usual: crossings are."""

SLACKEST = 4.0
"""So many times its catenary constant a span may be long."""

_NEWTON_STEPS, _SETTLED_M = 40, 1e-7
_POSITIONS = 65_536
"""Looked at together."""


@dataclass(frozen=True, slots=True, eq=False)
class Catenary:
    """A conductor's curve between two attachments (3,), apart seen from above."""

    start_m: FloatArray
    end_m: FloatArray
    constant_m: float  # horizontal tension over weight per metre: the larger, the less sag

    @property
    def length_m(self) -> float:
        """Distance of the ends seen from above."""
        return math.hypot(self.end_m[0] - self.start_m[0], self.end_m[1] - self.start_m[1])

    @property
    def is_slack(self) -> bool:
        """Whether it hangs deeper than any line does."""
        return self.length_m > SLACKEST * self.constant_m

    def at(self, share: FloatArray) -> FloatArray:
        """Return the points (..., 3) at shares of the way from start to end, seen from above."""
        share = np.asarray(share, dtype=np.float64)
        points: FloatArray = self.start_m + share[..., np.newaxis] * (self.end_m - self.start_m)
        points[..., 2] = self.start_m[2] + self._climb_m(share * self.length_m)[0]
        return points

    def chords_m(self, error_m: float = CHORD_ERROR_M) -> FloatArray:
        """Return points (K, 3) on it, the ends among them, whose chords are at most ``error_m`` above it."""
        # an arc's greatest height below its chord is l^2 / 8 times its curvature, which is least sharp when level
        steepest = max(abs(float(slope)) for slope in self._climb_m(np.array([0.0, self.length_m]))[1])
        bend = math.hypot(1.0, steepest) / self.constant_m
        pieces = max(1, math.ceil(self.length_m * math.sqrt(bend / (8.0 * error_m))))
        points = self.at(np.linspace(0.0, 1.0, pieces + 1))
        points[0], points[-1] = self.start_m, self.end_m
        return points

    def distance_m(self, position_m: FloatArray) -> FloatArray:
        """Return the distances (N,) of positions (N, 3): exact for all that is nearer than its curve is bent.

        Newton's method from the nearest place of the straight line between the ends.
        """
        away = self.end_m - self.start_m
        length_m = self.length_m
        p = np.asarray(position_m, dtype=np.float64) - self.start_m
        along = p[:, :2] @ away[:2] / length_m
        aside = (p[:, 0] * away[1] - p[:, 1] * away[0]) / length_m
        u = np.clip((along * length_m + p[:, 2] * away[2]) * length_m / (length_m**2 + away[2] ** 2), 0.0, length_m)
        for _ in range(_NEWTON_STEPS):
            climb, slope, bend = self._climb_m(u)
            below = climb - p[:, 2]
            curving = 1.0 + slope**2 + below * bend
            # far below it the nearest place is not where Newton leads: any step downhill will do
            before = u
            u = np.clip(u - (u - along + below * slope) / np.maximum(curving, 0.5), 0.0, length_m)
            if np.abs(u - before).max(initial=0.0) < _SETTLED_M:
                break
        distance: FloatArray = np.sqrt((u - along) ** 2 + aside**2 + (self._climb_m(u)[0] - p[:, 2]) ** 2)
        return distance

    def _climb_m(self, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how much higher than its start it is ``u`` metres along, its slope there and how that changes."""
        a, length_m = self.constant_m, self.length_m
        tilt = math.asinh(float(self.end_m[2] - self.start_m[2]) / (2.0 * a * math.sinh(length_m / (2.0 * a))))
        # as a product of two sinh: no difference of large numbers, however tight it is
        climb = 2.0 * a * np.sinh(u / (2.0 * a)) * np.sinh((u - length_m) / (2.0 * a) + tilt)
        turned = (u - 0.5 * length_m) / a + tilt
        return climb, np.sinh(turned), np.cosh(turned) / a


@dataclass(frozen=True, slots=True, eq=False)
class Conductor:
    """What hangs between two supports: a bundle of conductors, or the cables of a ropeway."""

    name: str
    catenary: Catenary
    radius_m: float  # half the width of the bundle


@dataclass(frozen=True, slots=True, eq=False)
class Span:
    """One span of the lines to inspect."""

    name: str  # span T01-T02
    lines: tuple[str, ...]  # more than one: circuits on the same towers
    towers: tuple[int, int]  # of the scene's, in the order of the first line
    curve_m: FloatArray  # (K, 3) on the catenary, from top to top
    conductor: Conductor

    @property
    def line(self) -> str:
        """The first of the lines that it is part of."""
        return self.lines[0]


def catenary(start_m: FloatArray, end_m: FloatArray, constant_m: float | None) -> Catenary:
    """Return a conductor as tight as stated; where that is not (None), at least as tight as such lines are."""
    if constant_m is None:
        across_m = math.hypot(end_m[0] - start_m[0], end_m[1] - start_m[1])
        constant_m = max(_USUAL_CATENARY_M, across_m**2 / (8.0 * _ASSUMED_SAG_M))
    return Catenary(start_m, end_m, constant_m)


def conductor_distance_m(conductors: Iterable[Conductor], position_m: FloatArray) -> FloatArray:
    """Return the signed distances (N,) of positions (N, 3) to the nearest conductor itself; inf: there is none.

    To the cable with its radius, not to what stands for it when paths are planned: room below it is free.
    """
    position_m = np.asarray(position_m, dtype=np.float64)
    found = np.full(len(position_m), np.inf)
    for conductor in conductors:
        curve = conductor.catenary.chords_m()
        low, high = curve.min(axis=0) - [0.0, 0.0, CHORD_ERROR_M], curve.max(axis=0)
        for first in range(0, len(position_m), _POSITIONS):
            here = slice(first, first + _POSITIONS)
            off = np.maximum(np.maximum(low - position_m[here], position_m[here] - high), 0.0)
            near = np.flatnonzero(np.linalg.norm(off, axis=1) - conductor.radius_m < found[here])
            distance_m = conductor.catenary.distance_m(position_m[here][near]) - conductor.radius_m
            found[first + near] = np.minimum(found[first + near], distance_m)
    return found
