from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from missionplanner import cost
from missionplanner.cost import CONSTRAINTS, TERMS, Price
from missionplanner.kernels import SpaceArrays, TerrainArrays
from missionplanner.mission import Weights
from missionplanner.obstacles import CableSolid, ConeSolid, CylinderSolid, PrismSolid, SphereSolid, pack
from missionplanner.scene import Towers
from tests.benchmarks.price_kernel import mountain_case
from tests.limits import limits
from tests.oracles.price import price_terms

LIMITS = limits(terrain_margin_m=18.0, obstacle_margin_m=8.0, height_agl_max_m=122.0)
"""The path itself keeps 20 m above ground, 10 m from obstacles and fence, and stays below 120 m above ground."""

SQUARE = np.array([[-500.0, -500.0], [500.0, -500.0], [500.0, 500.0], [-500.0, 500.0]])


def flat_space(*solids, fence=None, top=math.inf, ground=0.0):
    to_cell = np.zeros((2, 10))
    to_cell[:, 0] = 60.0
    to_cell[0, 2] = to_cell[1, 1] = 500.0  # cells of 20 m, heights known from -1180 to 1180
    return SpaceArrays(
        TerrainArrays(np.full((121, 121), ground, dtype=np.float32), to_cell),
        pack(solids).arrays,
        np.empty((0, 2)) if fence is None else fence,
        top,
        np.array([-1e4, -1e4, 1e4, 1e4]),
    )


def straight(start, end, samples=101):
    return np.linspace(start, end, samples)[np.newaxis].astype(float)


def terms(path, *solids, limits=LIMITS, route_length_m=1000.0, space=None, **settings):
    price = Price(space or flat_space(*solids), limits, route_length_m, Weights(), **settings)
    return {name: float(value[0]) for name, value in price.terms(path).items()}


def towers(*tops, weight=None, range_m=60.0):
    top_m = np.array(tops, dtype=float)
    weight = np.ones(len(tops)) if weight is None else np.array(weight, dtype=float)
    return Towers(tuple(f"T{k}" for k in range(len(tops))), top_m, np.full(len(tops), 35.0), weight, range_m, 1.0)


class TestByHand:
    def test_a_good_path_costs_its_length_and_nothing_else(self):
        got = terms(straight((0, 0, 50), (1000, 0, 50)))
        assert got.pop("voyage") == pytest.approx(1.0)
        assert got.pop("atmosphere") == pytest.approx(0.05**2)
        assert got == pytest.approx(dict.fromkeys(got, 0.0), abs=1e-12)

    def test_climb_and_climb_angle(self):
        # up 200 m over 100 m: 100 m beyond 45 degrees; down 50 m over 100 m: allowed
        path = np.array([[[0, 0, 25], [100, 0, 225], [200, 0, 175]]], dtype=float)
        got = terms(path, limits=replace(LIMITS, height_agl_max_m=math.inf))
        assert got["climb"] == pytest.approx(0.2)
        assert got["climb_angle"] == pytest.approx(0.1)
        down = terms(path[:, ::-1], limits=replace(LIMITS, height_agl_max_m=math.inf))
        assert down["climb"] == pytest.approx(0.05)
        assert down["climb_angle"] == pytest.approx(0.1)

    def test_bending_of_a_circle_is_its_angle_over_its_radius(self):
        angle = np.linspace(0.0, math.pi, 2001)
        path = np.stack([200 * np.cos(angle), 200 * np.sin(angle), np.full(2001, 50.0)], axis=-1)[np.newaxis]
        assert terms(path)["smooth"] == pytest.approx(math.pi / 200 * 20**2 / 1000, rel=1e-3)

    def test_turn_radius_and_turn_angle(self):
        angle = np.linspace(0.0, math.pi, 1001)
        path = np.stack([50 * np.cos(angle), 50 * np.sin(angle), np.full(1001, 50.0)], axis=-1)[np.newaxis]
        assert terms(path, limits=replace(LIMITS, turn_radius_m=49.9))["turn"] == 0.0
        # a radius of 100 m allows half the turn
        assert terms(path, limits=replace(LIMITS, turn_radius_m=100.0))["turn"] == pytest.approx(0.5, rel=2e-3)
        corner = np.array([[[0, 0, 50], [100, 0, 50], [100, 100, 50]]], dtype=float)
        assert terms(corner, limits=replace(LIMITS, turn_angle_rad=math.radians(60)))["turn"] == pytest.approx(30 / 180)

    def test_too_low_and_too_high(self):
        # 5 m below 20 m all along; 10 m above 120 m all along
        assert terms(straight((0, 0, 15), (1000, 0, 15)))["terrain"] == pytest.approx(5 / 20)
        assert terms(straight((0, 0, 130), (1000, 0, 130)))["ceiling"] == pytest.approx(10 / 20)
        low_sky = replace(LIMITS, alt_amsl_max_m=52.0)
        assert terms(straight((0, 0, 60), (1000, 0, 60)), limits=low_sky)["ceiling"] == pytest.approx(10 / 20)

    def test_outside_the_terrain_is_deep_and_deeper_further_out(self):
        known = terms(straight((0, 0, 50), (1000, 0, 50)))["terrain"]
        near = terms(straight((0, 1200, 50), (1000, 1200, 50)))["terrain"]
        far = terms(straight((0, 2000, 50), (1000, 2000, 50)))["terrain"]
        assert known == 0.0
        assert near == pytest.approx((100 + 20) / 20)
        assert far == pytest.approx((100 + 820) / 20)

    def test_a_void_is_deep(self):
        space = flat_space()
        space.terrain.height_amsl_m[60, 70] = np.nan  # at (200, 0): no height within two cells
        got = terms(straight((0, 0, 50), (1000, 0, 50)), space=space)["terrain"]
        assert got == pytest.approx(80 * 100 / 20 / 1000, rel=0.2)

    def test_through_a_mast(self):
        # a chord through the middle: depth 10 + 5 - |x|, so that the integral is 15^2
        got = terms(straight((-500, 0, 50), (500, 0, 50)), CylinderSolid("mast", 0, 0, 5))
        assert got["obstacle"] == pytest.approx(15**2 / 10 / 1000, rel=0.02)
        assert got["collision"] == got["ocean"] == got["fence"] == 0.0

    def test_each_kind_under_its_own_name(self):
        path = straight((-500, 0, 50), (500, 0, 50))
        kinds = {
            "obstacle": [
                CylinderSolid("c", 0, 0, 5),
                PrismSolid("p", SQUARE / 100),
                CableSolid("w", np.array([0, -50, 50.0]), np.array([0, 50, 50.0]), 0.5),
                SphereSolid("r", 0, 0, 50, 20, "radar"),
            ],
            "collision": [ConeSolid("k", 0, 0, 100, 0, 200)],
            "ocean": [SphereSolid("m", 0, 0, 0, 60, "marine")],
            "radar": [SphereSolid("r", 0, 0, 50, 20, "radar", hard=False)],
        }
        for name, solids in kinds.items():
            for solid in solids:
                got = terms(path, solid)
                assert got[name] > 0.0, solid
                others = {other: got[other] for other in (*CONSTRAINTS, "radar") if other != name}
                assert others == pytest.approx(dict.fromkeys(others, 0.0)), solid

    def test_soft_radar_is_depth_squared(self):
        # through the middle: integral of (1 - |x| / R)^2 = 2 R / 3
        zone = SphereSolid("r", 0, 0, 50, 90, "radar", hard=False)
        assert terms(straight((-500, 0, 50), (500, 0, 50)), zone)["radar"] == pytest.approx(60 / 1000, rel=0.01)

    def test_fence_and_its_top(self):
        outside = terms(straight((-400, 600, 50), (400, 600, 50)), space=flat_space(fence=SQUARE), route_length_m=800)
        assert outside["fence"] == pytest.approx((100 + 10) / 10)
        high = terms(
            straight((-400, 0, 95), (400, 0, 95)), space=flat_space(fence=SQUARE, top=100.0), route_length_m=800
        )
        assert high["fence"] == pytest.approx(5 / 10)
        assert terms(straight((-400, 0, 90), (400, 0, 90)), space=flat_space(fence=SQUARE, top=100.0))["fence"] == 0.0

    def test_margins_widen_by_the_extra_asked_for(self):
        path = straight((-500, 12, 21), (500, 12, 21))
        assert terms(path, CylinderSolid("mast", 0, 0, 1))["obstacle"] == 0.0
        wider = terms(path, CylinderSolid("mast", 0, 0, 1), clearance_extra_m=4.0)
        assert wider["obstacle"] > 0.0
        assert wider["terrain"] == pytest.approx(3 / 24)

    def test_a_thin_cable_between_far_samples_is_not_missed(self):
        # samples 250 m apart; the cable crosses between them
        cable = CableSolid("w", np.array([130.0, -50, 50]), np.array([130.0, 50, 50]), 0.01)
        got = terms(straight((-500, 0, 50), (500, 0, 50), samples=5), cable)["obstacle"]
        assert got == pytest.approx(10.01**2 / 10 / 1000, rel=0.05)

    def test_inspection_by_range(self):
        path = straight((0, 0, 50), (1000, 0, 50))
        assert terms(path, towers=towers((100, 0, 30), (505, 30, 30)))["inspection"] == 0.0
        # 60 m too far of a range of 60 m: half of its weight of three quarters
        half = terms(path, towers=towers((100, 0, 30), (505, 120, 50), weight=[1, 3]))
        assert half["inspection"] == pytest.approx(0.75 / 2)
        assert terms(path, towers=towers((505, 1e6, 50)))["inspection"] == pytest.approx(1.0, abs=1e-3)
        assert terms(path, towers=towers((505, 1e6, 50), weight=[0]))["inspection"] == 0.0

    def test_fellows_beside_and_crossing(self):
        path = straight((0, 0, 50), (1000, 0, 50))
        beside = straight((0, 12, 50), (1000, 12, 50), samples=33)
        assert terms(path, fellows=beside, separation_m=20.0)["fellows"] == pytest.approx(8 / 20)
        assert terms(path, fellows=beside, separation_m=12.0)["fellows"] == 0.0
        # head on at twice the speed: the depth 20 - 2000 |f - 1/2| integrates to 400 / 2000
        against = straight((1000, 0, 50), (0, 0, 50), samples=4)
        assert terms(path, fellows=against, separation_m=20.0)["fellows"] == pytest.approx(0.2 / 20)
        # same place, but never at the same time
        behind = straight((-100, 0, 50), (900, 0, 50), samples=33)
        assert terms(path, fellows=behind, separation_m=90.0)["fellows"] == 0.0

    def test_fellows_are_compared_at_shares_of_the_length_not_of_the_samples(self):
        uneven = np.concatenate([np.linspace(0, 10, 50), np.linspace(20, 1000, 50)])
        path = np.stack([uneven, np.zeros(100), np.full(100, 50.0)], axis=-1)[np.newaxis]
        beside = straight((0, 12, 50), (1000, 12, 50), samples=65)
        assert terms(path, fellows=beside, separation_m=20.0)["fellows"] == pytest.approx(8 / 20, rel=1e-6)


class TestWhole:
    def test_total_is_the_weighted_sum_and_constraints_share_one_weight(self):
        case = mountain_case(population=6)
        weights = Weights(voyage=2.0, smooth=0.3, radar=5.0, climb=0.7, atmosphere=0.1, constraint=50.0)
        price = Price(case.space, LIMITS, 3000.0, weights)
        values = dict(price.terms(case.paths).items())
        expected = sum(value * getattr(weights, name, weights.constraint) for name, value in values.items())
        np.testing.assert_allclose(price.total(case.paths), expected)
        np.testing.assert_allclose(sum(price.weighted(case.paths).values()), expected)
        np.testing.assert_allclose(price.terms(case.paths).violation, sum(values[name] for name in CONSTRAINTS))
        assert tuple(values) == TERMS

    def test_nan_and_infinite_paths_cost_infinitely(self):
        paths = np.repeat(straight((0, 0, 50), (1000, 0, 50)), 3, axis=0)
        paths[0, 7, 1] = math.nan
        paths[1, 7, 2] = math.inf
        price = Price(
            flat_space(CylinderSolid("mast", 500, 0, 5), fence=SQUARE), LIMITS, 1000.0, Weights(atmosphere=1.0)
        )
        total = price.total(paths)
        assert total[:2].tolist() == [math.inf, math.inf]
        assert math.isfinite(total[2])

    def test_samples_that_coincide_change_nothing(self):
        path = straight((-500, 0, 50), (500, 0, 50), samples=5)
        doubled = np.repeat(path, 2, axis=1)
        solids = (CylinderSolid("mast", 0, 0, 5), SphereSolid("r", 250, 0, 50, 40, "radar"))
        got, expected = terms(doubled, *solids), terms(path, *solids)
        assert got == pytest.approx(expected, rel=1e-9)

    def test_every_number_of_threads_gives_the_same_bits(self, monkeypatch):
        case = mountain_case(population=40)
        tables = []
        for threads in (1, 2, 3):
            monkeypatch.setattr(cost, "THREADS", threads)
            tables.append(case.price().total(case.paths))
        np.testing.assert_array_equal(tables[0], tables[1])
        np.testing.assert_array_equal(tables[0], tables[2])

    def test_population_of_none(self):
        assert Price(flat_space(), LIMITS, 1000.0, Weights()).total(np.empty((0, 10, 3))).shape == (0,)


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_the_oracle_where_everything_goes_wrong(seed):
    """Random paths through ground, voids, solids, fence and fellows: every term must be hit, and equal."""
    rng = np.random.default_rng(seed)
    case = mountain_case(seed, population=4, samples=60)
    terrain = case.space.terrain
    terrain.height_amsl_m[100:110, 140:150] = np.nan
    solids = [
        CylinderSolid("c", -900.0, 0.0, 80.0, 1200.0),
        ConeSolid("k", *case.paths[0, 30, :2], 800.0, 0.0, 2000.0),
        SphereSolid("m", *case.paths[1, 20], 200.0, "marine"),
        SphereSolid("r", 900.0, 0.0, 1100.0, 250.0, "radar"),
        SphereSolid("soft", 500.0, 0.0, 1100.0, 400.0, "radar", hard=False),
        PrismSolid("p", np.array([[300.0, -200], [700, -250], [650, 200], [500, -50], [320, 150]]), 900.0, 1300.0),
        CableSolid("w", np.array([-1200.0, -300, 1000]), np.array([-1100.0, 300, 1100]), 0.5),
    ]
    space = SpaceArrays(
        terrain,
        pack(solids).arrays,
        np.array([[-1400.0, -200], [1400, -250], [1450, 50], [1200, 20], [1400, 200], [-1450, 150]]),
        1150.0,
        np.array([-1420.0, -3000.0, 1300.0, 3000.0]),
    )
    limits = replace(
        LIMITS,
        climb_angle_rad=math.radians(8.0),
        descent_angle_rad=math.radians(6.0),
        turn_radius_m=150.0,
        turn_angle_rad=math.radians(20.0),
        alt_amsl_max_m=1120.0,
    )
    paths = case.paths + rng.normal(0.0, 15.0, case.paths.shape) * [1, 1, 0.3]
    paths[..., 2] += np.linspace(-150.0, 40.0, 60)
    paths[3] += [6000.0, -200.0, 0.0]  # off the terrain
    fellows = paths[:3, np.linspace(0, 59, 40).astype(int)] + rng.normal(0.0, 10.0, (3, 40, 3))
    line = towers(*(paths[0, ::7] + rng.normal(0.0, 60.0, (9, 3))), weight=rng.uniform(0, 2, 9))
    price = Price(space, limits, 2900.0, Weights(), line, fellows, 45.0, 1.5)
    expected = price_terms(
        paths, space, limits, 2900.0, line.top_m, line.weight, line.range_m, fellows, 45.0, clearance_extra_m=1.5
    )
    got = dict(price.terms(paths).items())
    for name in TERMS:
        np.testing.assert_allclose(got[name], expected[name], rtol=1e-9, atol=1e-9, err_msg=name)
        assert (got[name] > 0.0).any(), name


def test_agrees_with_the_oracle_on_the_benchmark():
    case = mountain_case(population=5)
    got = dict(case.price().terms(case.paths).items())
    for name, expected in case.oracle(case.paths).items():
        np.testing.assert_allclose(got[name], expected, rtol=1e-9, atol=1e-9, err_msg=name)
