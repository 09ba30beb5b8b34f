from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from missionplanner.geodesy import FloatArray
from missionplanner.waypoints import fit_waypoints


def clear_everywhere(legs: FloatArray) -> np.ndarray:
    return np.ones(len(legs), dtype=bool)


def arc(radius_m: float, angle_rad: float, samples: int) -> FloatArray:
    a = np.linspace(0.0, angle_rad, samples)
    return np.stack([radius_m * np.cos(a), radius_m * np.sin(a), np.zeros(samples)], axis=1)


def distance_to_polyline(points: FloatArray, line: FloatArray) -> FloatArray:
    d = np.full(len(points), np.inf)
    for a, b in pairwise(line):
        t = np.clip(((points - a) @ (b - a)) / ((b - a) @ (b - a)), 0, 1)
        d = np.minimum(d, np.linalg.norm(points - a - t[:, None] * (b - a), axis=1))
    return d


def ends(path: FloatArray) -> np.ndarray:
    return np.array([0, len(path) - 1])


def test_a_straight_line_needs_two_waypoints() -> None:
    path = np.linspace([0.0, 0.0, 100.0], [300.0, 400.0, 150.0], 60)
    waypoints = fit_waypoints(path, ends(path), 1.0, clear_everywhere)
    assert waypoints is not None
    np.testing.assert_array_equal(waypoints, path[[0, -1]])


@pytest.mark.parametrize("tolerance_m", [0.5, 2.0, 8.0])
def test_an_arc_gets_as_few_chords_as_its_sagitta_allows(tolerance_m: float) -> None:
    radius_m, angle_rad = 200.0, np.pi
    path = arc(radius_m, angle_rad, 721)
    waypoints = fit_waypoints(path, ends(path), tolerance_m, clear_everywhere)
    assert waypoints is not None
    # a chord of an arc of 2 h deviates by r (1 - cos h)
    fewest = int(np.ceil(angle_rad / (2 * np.arccos(1 - tolerance_m / radius_m))))
    assert len(waypoints) - 1 == fewest
    assert distance_to_polyline(path, waypoints).max() <= tolerance_m + 1e-9


def test_stops_are_waypoints() -> None:
    path = np.linspace([0.0, 0.0, 0.0], [100.0, 0.0, 0.0], 11)
    waypoints = fit_waypoints(path, np.array([0, 3, 7, 10]), 5.0, clear_everywhere)
    assert waypoints is not None
    np.testing.assert_array_equal(waypoints, path[[0, 3, 7, 10]])


def test_a_leg_that_is_not_clear_is_gone_around_along_the_curve() -> None:
    path = arc(100.0, np.pi / 2, 91)

    def clear(legs: FloatArray) -> np.ndarray:
        return np.linalg.norm(legs[:, 1] - legs[:, 0], axis=1) < 30.0

    waypoints = fit_waypoints(path, ends(path), 50.0, clear)
    assert waypoints is not None
    assert np.linalg.norm(np.diff(waypoints, axis=0), axis=1).max() < 30.0
    assert len(waypoints) - 1 == 6  # an arc of 157 m in chords below 30 m


def test_no_clear_chain_is_said_so() -> None:
    path = arc(100.0, np.pi / 2, 20)
    assert fit_waypoints(path, ends(path), 5.0, lambda legs: np.zeros(len(legs), dtype=bool)) is None


def test_only_legs_of_shortest_chains_are_judged() -> None:
    path = arc(200.0, np.pi, 200)
    judged = 0

    def clear(legs: FloatArray) -> np.ndarray:
        nonlocal judged
        judged += len(legs)
        return np.ones(len(legs), dtype=bool)

    waypoints = fit_waypoints(path, ends(path), 2.0, clear)
    assert waypoints is not None
    assert judged == len(waypoints) - 1
