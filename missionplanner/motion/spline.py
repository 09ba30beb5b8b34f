"""The curves that ArduCopter 4.5 flies to its spline waypoints, and chords that hold them.

A cubic Hermite curve from waypoint to waypoint (AP_Math's SplineCurve, as AC_WPNav sets it up):

- It arrives with the vector from its origin to the next waypoint if that is a spline too, with the vector from its own
  end to the next place if that is flown to in a straight line, at rest if it stops there or nothing comes after.
- It departs as the spline before it arrived; after a straight leg, with that leg's whole vector; after a stop, a
  take-off or a circle, from rest.
- Where the two together are longer than four times the way, both are scaled down to that for this curve (its successor
  starts from the unscaled one).

Source: ArduPilot libraries/AC_WPNav/AC_WPNav.cpp (set_spline_destination), libraries/AP_Math/SplineCurve.cpp and
ArduCopter/mode_auto.cpp (get_spline_from_cmd, set_next_wp).
"""

from __future__ import annotations

import math

import numpy as np

from missionplanner.geodesy import FloatArray
from missionplanner.sortie import Sortie

_LONGEST = 4.0  # times the way: departure and arrival together


def hermite_bezier(
    start_m: FloatArray, end_m: FloatArray, departure_m: FloatArray, arrival_m: FloatArray
) -> FloatArray:
    """Return the Bezier control points (4, 3) of the curve with these ends and tangents, each (3,)."""
    longest_m = _LONGEST * float(np.linalg.norm(end_m - start_m))
    tangents_m = float(np.linalg.norm(departure_m) + np.linalg.norm(arrival_m))
    scale = (longest_m / tangents_m if tangents_m > longest_m else 1.0) / 3.0
    return np.stack([start_m, start_m + scale * departure_m, end_m - scale * arrival_m, end_m])


def chords(bezier_m: FloatArray, tolerance_m: float) -> FloatArray:
    """Return points (N, 3) on a cubic (4, 3) such that no place on it is further than a tolerance from their polyline.

    Linear interpolation over a step 1 / n of the parameter errs by at most max |B''| / (8 n^2), and B'' lies between
    the control polygon's second differences times 6.
    """
    second_m = np.linalg.norm(np.diff(bezier_m, n=2, axis=0), axis=1).max()
    count = max(1, math.ceil(math.sqrt(6.0 * float(second_m) / (8.0 * tolerance_m))))
    t = np.linspace(0.0, 1.0, count + 1)[:, np.newaxis]
    s = 1.0 - t
    points = s**3 * bezier_m[0] + 3 * s**2 * t * bezier_m[1] + 3 * s * t**2 * bezier_m[2] + t**3 * bezier_m[3]
    points[0], points[-1] = bezier_m[0], bezier_m[3]
    return points


def spline_bezier(sortie: Sortie, index: int) -> FloatArray:
    """Return the control points (4, 3) of spline leg ``index``."""
    start_m, end_m = sortie.legs[index - 1].end_m, sortie.legs[index].end_m
    return hermite_bezier(start_m, end_m, _departure(sortie, index), _arrival(sortie, index))


def spline_chords(sortie: Sortie, index: int, tolerance_m: float) -> FloatArray:
    """Return the polyline (N, 3) from which spline leg ``index`` is nowhere further than a tolerance."""
    return chords(spline_bezier(sortie, index), tolerance_m)


def _departure(sortie: Sortie, index: int) -> FloatArray:
    before = sortie.legs[index - 1]
    if before.hold_s > 0.0 or before.kind in ("takeoff", "circle"):
        return np.zeros(3)
    if before.kind == "spline":
        # a curve without length forgets how it was to arrive
        moves = np.any(before.end_m != sortie.legs[index - 2].end_m)
        return _arrival(sortie, index - 1) if moves else np.zeros(3)
    return before.end_m - sortie.legs[index - 2].end_m


def _arrival(sortie: Sortie, index: int) -> FloatArray:
    leg = sortie.legs[index]
    if leg.hold_s > 0.0 or index + 1 == len(sortie.legs):
        return np.zeros(3)
    after = sortie.legs[index + 1]
    return after.end_m - (sortie.legs[index - 1].end_m if after.kind == "spline" else leg.end_m)
