from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from missionplanner import path

T = np.linspace(0.0, 1.0, 201)


def circle(radius_m, samples=400, climb_m=0.0):
    angle = np.linspace(0.0, 2.0 * math.pi, samples)
    return np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), climb_m * angle / (2.0 * math.pi)], axis=-1)


class TestBasis:
    def test_two_control_points_give_a_straight_line(self):
        np.testing.assert_allclose(
            path.basis(np.array([0.0, 1.0]), T) @ np.array([[2.0], [6.0]]), 2.0 + 4.0 * T[:, None]
        )

    def test_the_curve_goes_through_its_control_points(self):
        knots = np.array([0.0, 0.1, 0.35, 0.7, 1.0])
        np.testing.assert_allclose(path.basis(knots, knots), np.eye(5), atol=1e-14)

    def test_by_hand_three_points(self):
        # natural spline through (0, 0), (1, 1), (2, 0): s = 1.5 t - 0.5 t^3 on the first piece
        at = np.linspace(0.0, 1.0, 11)
        matrix = path.basis(np.array([0.0, 1.0, 2.0]), at)
        np.testing.assert_allclose(matrix @ np.array([0.0, 1.0, 0.0]), 1.5 * at - 0.5 * at**3, atol=1e-14)

    def test_straight_lines_are_reproduced(self):
        knots = np.array([0.0, 0.2, 0.3, 1.0])
        np.testing.assert_allclose(path.basis(knots, T) @ (3.0 * knots - 1.0), 3.0 * T - 1.0, atol=1e-13)

    def test_second_derivative_is_continuous_and_vanishes_at_the_ends(self):
        knots = path.uniform_knots(6)
        control = np.random.default_rng(3).normal(size=6)

        def second(at, h=1e-4):
            return (path.basis(knots, np.array([at - h, at, at + h])) @ control) @ [1.0, -2.0, 1.0] / h**2

        for knot in knots[1:-1]:
            assert second(knot - 2e-4) == pytest.approx(second(knot + 2e-4), abs=0.5)
        largest = max(abs(second(at)) for at in knots[1:-1])
        assert abs(second(2e-4)) < 0.01 * largest

    def test_whole_populations_are_one_product(self):
        control = np.random.default_rng(4).normal(size=(5, 6, 3))
        matrix = path.basis(path.uniform_knots(6), T)
        together = matrix @ control
        assert together.shape == (5, 201, 3)
        np.testing.assert_allclose(together[3], matrix @ control[3], atol=1e-14)

    def test_knots_by_chords(self):
        control = np.array([[0.0, 0, 0], [3.0, 4.0, 0], [3.0, 4.0, 15.0]])
        np.testing.assert_allclose(path.chord_knots(control), [0.0, 0.25, 1.0])
        with pytest.raises(ValueError, match="differ"):
            path.chord_knots(control[[0, 1, 1]])


class TestMeasures:
    def test_length(self):
        corner = np.array([[0.0, 0, 0], [3.0, 4.0, 0], [3.0, 4.0, 12.0]])
        np.testing.assert_allclose(path.leg_lengths_m(corner), [5.0, 12.0])
        np.testing.assert_allclose(path.length_m(np.stack([corner, 2 * corner])), [17.0, 34.0])

    def test_climb_angle(self):
        steps = np.array([[0.0, 0, 0], [3.0, 4.0, 5.0], [6.0, 8.0, 5.0], [6.0, 8.0, 0.0]])
        np.testing.assert_allclose(np.degrees(path.climb_angle_rad(steps)), [45.0, 0.0, -90.0])

    def test_turn_angle(self):
        corners = np.array([[0.0, 0, 0], [10.0, 0, 5.0], [10.0, 10.0, 0], [10.0, 5.0, 0]])
        np.testing.assert_allclose(np.degrees(path.turn_angle_rad(corners)), [90.0, 180.0])

    def test_turn_radius_of_circle_helix_and_line(self):
        np.testing.assert_allclose(path.turn_radius_m(circle(70.0)), 70.0)
        np.testing.assert_allclose(path.turn_radius_m(circle(70.0, climb_m=100.0)), 70.0)
        assert np.isinf(path.turn_radius_m(np.arange(12.0).reshape(4, 3))).all()

    def test_resampling(self):
        corner = np.array([[0.0, 0, 0], [10.0, 0, 0], [10.0, 30.0, 0]])
        np.testing.assert_allclose(path.resample(corner, [5.0, 20.0]), [[5.0, 0, 0], [10.0, 10.0, 0]])
        even = path.evenly(corner, 5)
        np.testing.assert_allclose(even[[0, 1, 4]], [[0, 0, 0], [10, 0, 0], [10, 30, 0]])


@pytest.mark.parametrize("controls", [2, 3, 4, 40])
def test_the_basis_is_scipys_natural_spline(controls: int) -> None:
    rng = np.random.default_rng(controls)
    knots = np.cumsum(rng.uniform(0.5, 100.0, controls))
    samples = np.concatenate([knots, rng.uniform(knots[0], knots[-1], 200)])
    expected = CubicSpline(knots, np.eye(controls), bc_type="natural")(samples)
    np.testing.assert_allclose(path.basis(knots, samples), expected, atol=1e-12)
