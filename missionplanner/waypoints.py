"""From the planned curve to the legs that are uploaded: as few as a stated tolerance and safety allow.

A densely sampled curve must not be uploaded: ArduCopter plans one leg ahead and crawls through short legs (collinear
waypoints 10 m apart are flown at 2.75 m/s whatever speed is set). So the curve is replaced by the fewest straight legs
that stay within a tolerance of it, every one of them clear by the vehicle's whole margin.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from missionplanner.compiled import njit
from missionplanner.geodesy import FloatArray

LegsClear = Callable[[FloatArray], npt.NDArray[np.bool_]]
"""Legs (N, 2, 3) in; which of them may be flown (N,) out."""

_EXCLUDED = np.inf
AT_STOP_M = 0.01  # coordinates are stored to a millimetre


def passes(route_m: FloatArray, waypoints_m: FloatArray, within_m: float = AT_STOP_M) -> list[int]:
    """Return which waypoints (W, 3) are the points of a route (R, 3), in its order, up to the first one missed."""
    found: list[int] = []
    begin = 0
    for point_m in route_m:
        near = np.linalg.norm(waypoints_m[begin:] - point_m, axis=1) <= within_m
        if not near.any():
            break
        found.append(begin + int(np.argmax(near)))
        begin = found[-1] + 1
    return found


def fit_waypoints(
    path_m: FloatArray, stops: npt.NDArray[np.intp], tolerance_m: float, legs_clear: LegsClear
) -> FloatArray | None:
    """Return the fewest waypoints (W, 3) whose legs follow ``path_m`` (S, 3) and are clear; None if there are none.

    Parameters
    ----------
    path_m
        Dense samples of the curve.
    stops
        Indices of samples that must be waypoints, rising, the first 0 and the last S - 1.
    tolerance_m
        Greatest distance of a sample from its leg.
    legs_clear
        Judges candidate legs. Only legs of a shortest chain are asked for: the judgement is the dear part.
    """
    waypoints = [path_m[:1]]
    for first, last in pairwise(stops):
        section = np.ascontiguousarray(path_m[first : last + 1])
        chain = _fewest_clear_legs(section, tolerance_m, legs_clear)
        if chain is None:
            return None
        waypoints.append(section[chain[1:]])
    return np.concatenate(waypoints)


def _fewest_clear_legs(section: FloatArray, tolerance_m: float, legs_clear: LegsClear) -> npt.NDArray[np.intp] | None:
    deviation = _chord_deviations(section, tolerance_m)
    judged = np.zeros(deviation.shape, dtype=bool)
    while True:
        chain = _shortest_chain(deviation)
        if chain.size == 0:
            return None
        legs = np.stack([section[chain[:-1]], section[chain[1:]]], axis=1)
        unknown = ~judged[chain[:-1], chain[1:]]
        if not unknown.any():
            return chain
        clear = legs_clear(legs[unknown])
        begins, ends = chain[:-1][unknown], chain[1:][unknown]
        judged[begins, ends] = True
        deviation[begins[~clear], ends[~clear]] = _EXCLUDED


@njit(cache=True)
def _chord_deviations(section: FloatArray, tolerance_m: float) -> FloatArray:
    """Return (S, S): the greatest distance of the samples between i and j from the chord i-j; inf beyond tolerance."""
    count = section.shape[0]
    deviation = np.full((count, count), np.inf)
    for i in range(count - 1):
        deviation[i, i + 1] = 0.0
        misses = 0
        for j in range(i + 2, count):
            chord = section[j] - section[i]
            length2 = chord[0] ** 2 + chord[1] ** 2 + chord[2] ** 2
            worst2 = 0.0
            for k in range(i + 1, j):
                rx = section[k, 0] - section[i, 0]
                ry = section[k, 1] - section[i, 1]
                rz = section[k, 2] - section[i, 2]
                t = 0.0
                if length2 > 0.0:
                    t = min(1.0, max(0.0, (rx * chord[0] + ry * chord[1] + rz * chord[2]) / length2))
                dx = rx - t * chord[0]
                dy = ry - t * chord[1]
                dz = rz - t * chord[2]
                worst2 = max(worst2, dx * dx + dy * dy + dz * dz)
                if worst2 > tolerance_m * tolerance_m:
                    break
            if worst2 <= tolerance_m * tolerance_m:
                deviation[i, j] = np.sqrt(worst2)
                misses = 0
            else:
                misses += 1
                # past a bend chords only get worse; a curve that comes back to its chord within a few samples is
                # noise, not a reason to look at all of the rest
                if misses == 8:
                    break
    return deviation


@njit(cache=True)
def _shortest_chain(deviation: FloatArray) -> npt.NDArray[np.intp]:
    """Return the chain of indices from first to last with the fewest legs; among those, the least deviation."""
    count = deviation.shape[0]
    legs = np.full(count, count + 1)
    strain = np.full(count, np.inf)
    before = np.full(count, -1)
    legs[0] = 0
    strain[0] = 0.0
    for j in range(1, count):
        for i in range(j):
            if deviation[i, j] == np.inf or legs[i] > count:
                continue
            new_strain = strain[i] + deviation[i, j] ** 2
            if legs[i] + 1 < legs[j] or (legs[i] + 1 == legs[j] and new_strain < strain[j]):
                legs[j] = legs[i] + 1
                strain[j] = new_strain
                before[j] = i
    if before[count - 1] < 0:
        return np.empty(0, dtype=np.intp)
    chain = np.empty(legs[count - 1] + 1, dtype=np.intp)
    at = count - 1
    for k in range(legs[count - 1], -1, -1):
        chain[k] = at
        at = before[at]
    return chain
