"""Where vehicles may start: beside the lines, clear of what is on the map, on level ground."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.terrain import Rectangle, Terrain
from missionplanner.terrain_bounds import steepest

TUBE_M = 5.0
"""As copters have it by default."""

_PITCH_M = 40.0  # between homes: more than the fleet's separation and both vehicles' errors
_CLEAR_M = 45.0  # of a home from whatever stands around
_SLOPES_DEG = (5.0, 12.0)  # looked for at first, and at all
_AWAY_M = (60.0, 90.0, 120.0, 170.0, 230.0, 300.0)  # from the line
_LLOYD_ROUNDS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Home:
    """A place to start from (2,), and what a person should know of it."""

    at_m: FloatArray
    told: str


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """What is to be inspected, and what stands around it, in the mission's frame."""

    area: Rectangle
    terrain: Terrain | None
    starts_m: FloatArray  # (S, 2) of inspected spans
    ends_m: FloatArray
    standing: tuple[tuple[FloatArray, float], ...]  # what is there: places (N, 2) along it, half its width

    def homes(self, given_m: Sequence[FloatArray], wanted: int) -> list[Home]:
        """Return so many homes: those given, then others beside them, or beside the lines.

        Raises
        ------
        MissionError
            There is no place that is clear and level.
        """
        clear = self._is_clear()
        centers = self._parts_of_the_lines(wanted)
        homes = [Home(at_m, "as given") for at_m in given_m[:wanted]]
        for v in range(len(homes), wanted):
            if given_m:
                candidates = _around(given_m[v % len(given_m)])
                what = f"assumed, beside home {v % len(given_m) + 1}"
            else:
                candidates = self._beside_line(centers[v])
                what = "assumed, beside the line"
            at_m = self._first_good(list(candidates), [home.at_m for home in homes], clear)
            homes.append(Home(at_m, f"{what}: check on the spot"))
        return homes

    def _parts_of_the_lines(self, parts: int) -> list[FloatArray]:
        """Return the middles of so many parts of the inspected spans that lie together."""
        middles = (self.starts_m + self.ends_m) / 2
        centers = middles[((np.arange(parts) + 0.5) / parts * len(middles)).astype(int)]
        for _ in range(_LLOYD_ROUNDS):  # k-means by Lloyd's method, from parts of equal numbers
            nearest = np.linalg.norm(middles[:, None] - centers, axis=-1).argmin(axis=1)
            centers = np.array(
                [middles[nearest == k].mean(axis=0) if (nearest == k).any() else centers[k] for k in range(parts)]
            )
        return list(centers)

    def _beside_line(self, center: FloatArray) -> Iterator[FloatArray]:
        """Yield places beside the span that is nearest to the middle of a part of the lines, then beside others."""
        starts, ends = self.starts_m, self.ends_m
        middles = (starts + ends) / 2
        for k in np.argsort(np.linalg.norm(middles - center, axis=1), kind="stable")[:40].tolist():
            way = (ends[k] - starts[k]) / max(float(np.linalg.norm(ends[k] - starts[k])), 1.0)
            across = np.array([-way[1], way[0]])
            for away_m, side in itertools.product(_AWAY_M, (1.0, -1.0)):
                yield middles[k] + side * away_m * across
        yield from _around(center)

    def _first_good(
        self,
        candidates: Sequence[FloatArray],
        homes: Sequence[FloatArray],
        clear: Callable[[FloatArray], bool],
    ) -> FloatArray:
        for slope_deg in _SLOPES_DEG:
            for at_m in candidates:
                apart = all(math.hypot(at_m[0] - x, at_m[1] - y) >= _PITCH_M - 1e-6 for x, y in homes)
                if apart and clear(at_m) and self._is_level(at_m, slope_deg):
                    return at_m
        raise MissionError(
            f"--home: expected a level place for each vehicle, clear of lines, near the towers, got {len(homes)} such "
            "places: give homes, or fewer --vehicles"
        )

    def _is_level(self, at_m: FloatArray, slope_deg: float) -> bool:
        if self.terrain is None:
            return True
        slope = float(steepest(self.terrain.arrays, float(at_m[0]), float(at_m[1]), 2 * TUBE_M))
        return slope <= math.tan(math.radians(slope_deg))

    def _is_clear(self) -> Callable[[FloatArray], bool]:
        """Return who tells whether a home could be at a place: within the area, away from all that stands around."""
        a = np.concatenate([xy_m[:-1] if len(xy_m) > 1 else xy_m for xy_m, _ in self.standing])
        b = np.concatenate([xy_m[1:] if len(xy_m) > 1 else xy_m for xy_m, _ in self.standing])
        least = np.concatenate([np.full(max(1, len(xy_m) - 1), wide_m) for xy_m, wide_m in self.standing])
        least += _CLEAR_M
        square = np.maximum(((b - a) ** 2).sum(axis=1), 1e-9)
        west, south, east, north = self.area

        def clear(at_m: FloatArray) -> bool:
            inside = west + 50.0 <= at_m[0] <= east - 50.0 and south + 50.0 <= at_m[1] <= north - 50.0
            share = np.clip(((at_m - a) * (b - a)).sum(axis=1) / square, 0.0, 1.0)
            away_m = np.linalg.norm(a + share[:, None] * (b - a) - at_m, axis=1)
            return bool(inside and (away_m >= least).all())

        return clear


def _around(home_m: FloatArray) -> Iterator[FloatArray]:
    steps = sorted(itertools.product(range(-8, 9), repeat=2), key=lambda s: (s[0] ** 2 + s[1] ** 2, s))
    for step in steps[1:]:
        yield home_m + _PITCH_M * np.array(step, dtype=np.float64)
