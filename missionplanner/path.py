"""Smooth paths: C2 natural cubic splines through control points, and what is measured on their samples.

Knots are fixed, so that the samples of a whole population are one matrix product with :func:`basis`.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_banded

from missionplanner.geodesy import FloatArray


def uniform_knots(controls: int) -> FloatArray:
    """Return knots (K,) evenly spread over [0, 1]."""
    return np.linspace(0.0, 1.0, controls)


def chord_knots(control_m: FloatArray) -> FloatArray:
    """Return knots (K,) over [0, 1] in proportion to the distances along control points (K, 3)."""
    chord = np.linalg.norm(np.diff(control_m, axis=0), axis=1)
    knots = np.concatenate([[0.0], np.cumsum(chord)])
    if not (np.diff(knots) > 0.0).all():
        raise ValueError("expected consecutive control points to differ")
    return np.asarray(knots / knots[-1])


def basis(knots: FloatArray, samples: FloatArray) -> FloatArray:
    """Return the matrix (S, K) that takes control points (K, 3) at the knots to the spline's points at the samples.

    The spline is cubic between knots, with a continuous second derivative that vanishes at both ends (natural): of all
    curves through the control points it bends least. Two control points give a straight line.

    Examples
    --------
    >>> matrix = basis(uniform_knots(6), np.linspace(0.0, 1.0, 96))
    >>> paths = matrix @ np.zeros((50, 6, 3))  # (P, K, 3) -> (P, S, 3)
    >>> paths.shape
    (50, 96, 3)
    """
    count = len(knots)
    gap = np.diff(knots)
    if not (gap > 0.0).all():
        raise ValueError("expected rising knots")
    # second derivatives at the knots, as rows of weights of the control points: zero at the ends
    bend = np.zeros((count, count))
    if count > 2:
        inner = np.arange(1, count - 1)
        left, right = gap[:-1], gap[1:]
        system = np.zeros((3, count - 2))  # its diagonals: three, so it is solved in no time
        system[0, 1:], system[1], system[2, :-1] = right[:-1], 2.0 * (left + right), left[1:]
        rise = np.zeros((count - 2, count))
        rise[inner - 1, inner - 1] = 6.0 / left
        rise[inner - 1, inner] = -6.0 / left - 6.0 / right
        rise[inner - 1, inner + 1] = 6.0 / right
        bend[1:-1] = solve_banded((1, 1), system, rise)
    piece = np.clip(np.searchsorted(knots, samples, side="right") - 1, 0, count - 2)
    width = gap[piece]
    after = (samples - knots[piece]) / width
    before = 1.0 - after
    matrix = np.zeros((len(samples), count))
    rows = np.arange(len(samples))
    matrix[rows, piece] = before
    matrix[rows, piece + 1] += after
    matrix += ((before**3 - before) * width**2 / 6.0)[:, np.newaxis] * bend[piece]
    matrix += ((after**3 - after) * width**2 / 6.0)[:, np.newaxis] * bend[piece + 1]
    return matrix


def leg_lengths_m(paths: FloatArray) -> FloatArray:
    """Return the distances (..., S - 1) between consecutive samples of paths (..., S, 3)."""
    length: FloatArray = np.linalg.norm(np.diff(paths, axis=-2), axis=-1)
    return length


def length_m(paths: FloatArray) -> FloatArray:
    """Return the lengths (...) of paths (..., S, 3), straight between samples."""
    length: FloatArray = leg_lengths_m(paths).sum(axis=-1)
    return length


def climb_angle_rad(paths: FloatArray) -> FloatArray:
    """Return the climb angle (..., S - 1) of every piece of paths (..., S, 3); negative in descent (PAPER.md eq. 7)."""
    step = np.diff(paths, axis=-2)
    angle: FloatArray = np.arctan2(step[..., 2], np.hypot(step[..., 0], step[..., 1]))
    return angle


def turn_angle_rad(paths: FloatArray) -> FloatArray:
    """Return the change of course (..., S - 2) at every inner sample of paths (..., S, 3), 0 to pi (PAPER.md eq. 8)."""
    step = np.diff(paths[..., :2], axis=-2)
    before, after = step[..., :-1, :], step[..., 1:, :]
    cross = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    angle: FloatArray = np.arctan2(np.abs(cross), (before * after).sum(axis=-1))
    return angle


def turn_radius_m(paths: FloatArray) -> FloatArray:
    """Return the horizontal radius of curvature (..., S - 2) at every inner sample of paths (..., S, 3).

    PAPER.md eq. 5. It is that of the circle through the sample and its two neighbours; inf where they stand in line.
    """
    a, b, c = paths[..., :-2, :2], paths[..., 1:-1, :2], paths[..., 2:, :2]
    u, v = b - a, c - b
    doubled_area = np.abs(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
    sides = np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1) * np.linalg.norm(c - a, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        radius: FloatArray = np.where(doubled_area > 0.0, sides / (2.0 * doubled_area), np.inf)
    return radius


def resample(path_m: FloatArray, distance_m: npt.ArrayLike) -> FloatArray:
    """Return the points (..., 3) at distances (...) along one path (S, 3), straight between samples."""
    along = np.concatenate([[0.0], np.cumsum(leg_lengths_m(path_m))])
    distance = np.asarray(distance_m, dtype=np.float64)
    return np.stack([np.interp(distance, along, path_m[:, k]) for k in range(3)], axis=-1)


def evenly(path_m: FloatArray, points: int) -> FloatArray:
    """Return ``points`` points (N, 3) of one path (S, 3) at equal distances along it, both ends included."""
    return resample(path_m, np.linspace(0.0, float(length_m(path_m)), points))
