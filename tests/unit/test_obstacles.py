from __future__ import annotations

import math

import numpy as np
import pytest

from missionplanner import obstacles
from missionplanner.errors import MissionError
from missionplanner.kernels import nearest_hard
from missionplanner.obstacles import (
    CableSolid,
    ConeSolid,
    CurtainSolid,
    CylinderSolid,
    PrismSolid,
    SphereSolid,
    beneath,
    join,
    pack,
)

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
ARROW = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [5.0, 2.0], [0.0, 10.0]])

GOLDEN = [
    # from -inf up to the top
    (CylinderSolid("c", 0, 0, 5, 100), (8, 0, 50), 3.0),
    (CylinderSolid("c", 0, 0, 5, 100), (0, 3, 50), -2.0),
    (CylinderSolid("c", 0, 0, 5, 100), (0, 3, 99), -1.0),
    (CylinderSolid("c", 0, 0, 5, 100), (0, 3, 104), 4.0),
    (CylinderSolid("c", 0, 0, 5, 100), (8, 0, 104), 5.0),
    (CylinderSolid("c", 0, 0, 5, 100), (0, 0, -1e6), -5.0),
    (CylinderSolid("c", 0, 0, 5), (0, 9, 1e6), 4.0),
    # base radius 30 at z = 10, apex at z = 50: a 3-4-5 triangle
    (ConeSolid("k", 0, 0, 30, 10, 40), (0, 0, 55), 5.0),
    (ConeSolid("k", 0, 0, 30, 10, 40), (0, 20, 3), 7.0),
    (ConeSolid("k", 0, 0, 30, 10, 40), (33, 0, 6), 5.0),
    (ConeSolid("k", 0, 0, 30, 10, 40), (15 + 8, 0, 30 + 6), 10.0),
    (ConeSolid("k", 0, 0, 30, 10, 40), (15 - 4, 0, 30 - 3), -5.0),
    (ConeSolid("k", 0, 0, 30, 10, 40), (0, 0, 12), -2.0),
    (SphereSolid("s", 1, 2, 3, 10, "radar"), (1, 2, 3), -10.0),
    (SphereSolid("s", 1, 2, 3, 10, "marine"), (4, 6, 15), 3.0),
    (PrismSolid("p", SQUARE, 0, 20), (5, 4, 10), -4.0),
    (PrismSolid("p", SQUARE, 0, 20), (5, 5, 19), -1.0),
    (PrismSolid("p", SQUARE, 0, 20), (13, 14, 10), 5.0),
    (PrismSolid("p", SQUARE, 0, 20), (13, 5, 24), 5.0),
    (PrismSolid("p", SQUARE, 5, 20), (5, 5, 2), 3.0),
    (PrismSolid("p", SQUARE), (5, 2, -1e5), -2.0),
    (PrismSolid("p", SQUARE[::-1]), (5, 2, 0), -2.0),
    (PrismSolid("p", ARROW), (5, 1, 0), -1.0),
    (PrismSolid("p", ARROW), (5, 0.5, 0), -0.5),
    (CableSolid("w", np.zeros(3), np.array([10.0, 0, 0]), 1), (5, 3, 4), 4.0),
    (CableSolid("w", np.zeros(3), np.array([10.0, 0, 0]), 1), (13, 0, 4), 4.0),
    (CableSolid("w", np.zeros(3), np.array([10.0, 0, 0]), 1), (5, 0, 0), -1.0),
    (CableSolid("w", np.zeros(3), np.zeros(3), 1), (0, 0, 3), 2.0),
    # from (0, 0, 0) up to (40, 0, 30): 3-4-5 again
    (CurtainSolid("l", np.zeros(3), np.array([40.0, 0, 30]), 1), (20, 5, -1e6), 4.0),
    (CurtainSolid("l", np.zeros(3), np.array([40.0, 0, 30]), 1), (20, 0, 10), -1.0),
    (CurtainSolid("l", np.zeros(3), np.array([40.0, 0, 30]), 1), (20 - 3, 0, 15 + 4), 4.0),
    (CurtainSolid("l", np.zeros(3), np.array([40.0, 0, 30]), 1), (-12, 5, -7), 12.0),
    (CurtainSolid("l", np.zeros(3), np.array([40.0, 0, 30]), 1), (-3, 0, 4), 4.0),
    (CurtainSolid("l", np.zeros(3), np.array([40.0, 0, 30]), 1), (-6, 0, 8), 9.0),
    (CurtainSolid("l", np.zeros(3), np.array([40.0, 0, 30]), 1), (43, -4, 42), 12.0),
    (CurtainSolid("l", np.array([40.0, 0, 30]), np.zeros(3), 1), (43, 0, 10), 2.0),
    (CurtainSolid("l", np.zeros(3), np.array([40.0, 0, 30]), 1), (55, 20, 29), 24.0),
]


@pytest.mark.parametrize(("solid", "point", "distance"), GOLDEN)
def test_distance_by_hand(solid, point, distance):
    assert pack([solid]).distance_m(point) == pytest.approx([distance], abs=1e-9)


def test_beside_a_notch_the_nearest_edge_counts():
    # the right slope of the arrow runs from (10, 10) to (5, 2): the point above the notch is 2 m above its corner
    right = np.array([10.0, 10.0]) - [5.0, 2.0]
    across = abs(right[0] * 2.0) / np.linalg.norm(right)
    assert pack([PrismSolid("p", ARROW)]).distance_m((5, 4, 0))[0] == pytest.approx(across)


def test_shapes_follow_the_positions():
    obstacles = pack([solid for solid, _, _ in GOLDEN[:4]])
    assert obstacles.names == ("c", "c", "c", "c")
    assert obstacles.distance_m(np.zeros((2, 5, 3))).shape == (2, 5, 4)
    assert obstacles.distance_m((0, 0, 0)).shape == (4,)
    assert pack([]).distance_m(np.zeros((7, 3))).shape == (7, 0)


def test_bounds_hold_the_solid():
    for solid, _, _ in GOLDEN:
        packed = pack([solid])
        x, y, radius, low, high = packed.arrays.bound[0]
        rng = np.random.default_rng(1)
        points = rng.uniform(-60, 60, (4000, 3))
        inside = points[packed.distance_m(points)[:, 0] <= 0]
        assert (np.hypot(inside[:, 0] - x, inside[:, 1] - y) <= radius + 1e-9).all()
        assert ((inside[:, 2] >= low) & (inside[:, 2] <= high)).all()


def test_only_soft_radar_zones_are_not_hard():
    packed = pack([SphereSolid("a", 0, 0, 0, 1, "radar"), SphereSolid("b", 0, 0, 0, 1, "radar", hard=False)])
    assert packed.arrays.hard.tolist() == [True, False]


def test_nothing_hangs_in_the_air_below_a_curtain():
    span, cable = (kind("w", np.zeros(3), np.array([40.0, 0, 30]), 1) for kind in (CurtainSolid, CableSolid))
    assert not beneath(pack([span]))
    assert beneath(pack([cable]))


def test_join_keeps_every_solid():
    first = [PrismSolid("p", SQUARE), CylinderSolid("c", 50, 0, 5)]
    second = [SphereSolid("s", 0, 0, 0, 3, "marine"), PrismSolid("q", ARROW + 100.0)]
    points = np.random.default_rng(2).uniform(-20, 120, (200, 3))
    whole = pack([*first, *second])
    joined = join(pack(first).arrays, pack(second).arrays)
    for got, expected in zip([*joined[:-1], *joined.grid], [*whole.arrays[:-1], *whole.arrays.grid], strict=True):
        np.testing.assert_array_equal(got, expected)
    assert whole.distance_m(points).shape == (200, 4)


@pytest.mark.parametrize(
    ("solid", "says"),
    [
        (CylinderSolid("mast", 0, 0, -1), "mast: expected radius_m > 0, got -1"),
        (CylinderSolid("mast", 0, 0, math.nan), "radius_m > 0"),
        (CylinderSolid("mast", math.inf, 0, 1), "mast: expected numbers"),
        (CylinderSolid("mast", 0, 0, 1, math.nan), "mast: expected numbers"),
        (ConeSolid("hill", 0, 0, 10, 0, 0), "hill: expected height_m > 0"),
        (SphereSolid("radar", 0, 0, math.nan, 10, "radar"), "radar: expected numbers"),
        (CableSolid("wire", np.zeros(3), np.array([math.nan, 0, 0]), 1), "wire: expected numbers"),
        (CurtainSolid("span", np.zeros(3), np.array([0, 0, 9.0]), 1), "span: expected ends that are apart .* got 0"),
        (CurtainSolid("span", np.zeros(3), np.array([math.inf, 0, 9.0]), 1), "span: expected numbers"),
        (PrismSolid("zone", SQUARE[:2]), "zone: expected a polygon of at least 3"),
        (PrismSolid("zone", SQUARE[[0, 2, 1, 3]]), "zone: .* edges 1 and 3 crossing"),
        (PrismSolid("zone", SQUARE[[0, 1, 0, 3]]), "zone: "),
        (PrismSolid("zone", np.array([[0, 0], [1, 1], [2, 2.0]])), "zone: "),
        (PrismSolid("zone", SQUARE, 20, 10), "zone: expected top above its floor > 0, got -10"),
    ],
)
def test_bad_solids_are_refused_by_name(solid, says):
    with pytest.raises(MissionError, match=says):
        pack([solid])


def test_many_solids_in_one_point_have_an_index():
    packed = pack([SphereSolid("dust", 1e4, 1e4, 0, 1e-13, "radar")] * 20)
    assert packed.distance_m((1e4, 1e4 + 3, 4)) == pytest.approx([5.0] * 20)
    assert nearest_hard(packed.arrays, 1e4, 1e4 + 3, 4.0, 1e3) == pytest.approx(5.0)


def test_fine_polygons_are_looked_at_by_many_pairs_of_edges_at_once(monkeypatch):
    calls = []
    touch = obstacles._touch
    monkeypatch.setattr(obstacles, "_touch", lambda *ends: calls.append(1) or touch(*ends))
    angle = np.arange(600) * math.tau / 600
    disc = 50.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    pack([PrismSolid("disc", disc)])
    assert len(calls) < 20
    disc[[580, 590]] = disc[[590, 580]]
    with pytest.raises(MissionError, match=r"^obstacle disc: .* got edges 580 and 591 crossing"):
        pack([PrismSolid("disc", disc)])
