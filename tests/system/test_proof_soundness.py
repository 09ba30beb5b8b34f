"""The checker's claims about random legs and fleets against an independent oracle: a small part of the experiment."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from missionplanner.experiments import proof, proof_oracle, proof_trials, proof_worlds
from missionplanner.obstacles import (
    CableSolid,
    ConeSolid,
    CurtainSolid,
    CylinderSolid,
    PrismSolid,
    Solid,
    SphereSolid,
    pack,
)
from tests.oracles import surface

MISSION = Path(__file__).parents[2] / "missions" / "ridge_line.yaml"


def test_no_sample_contradicts_a_claim() -> None:
    tally = proof.soundness(7, legs=500, fleets=4, mission=MISSION)
    assert tally.violations == []
    assert tally.made["proven legs"] > 150
    checks = {"terrain", "obstacle", "fence", "ceiling"}
    assert {f"legs: {check}" for check in checks} <= set(tally.claims)
    assert {"fleets: items", "fleets: separation", "fleets: lateness", "fleets: return, apart"} <= set(tally.claims)
    close = np.array(tally.room_m)
    assert (close < 0.2).sum() > 100  # many are only just proven: there a mistake would show


def test_bounds_over_real_terrain_are_tight() -> None:
    loose_m = np.array(proof.tightness(3, 250, mission=MISSION))
    assert loose_m.min() >= -proof_trials.ROOM_M
    assert np.median(loose_m) < 0.3
    assert np.quantile(loose_m, 0.99) < proof.TIGHT_P99_M


def test_results_do_not_depend_on_the_number_of_processes() -> None:
    one, two = (proof.soundness(5, legs=500, fleets=0, mission=MISSION, workers=w) for w in (1, 2))
    assert one == two


# --- the oracle itself ------------------------------------------------------------------------------------------------


def test_the_oracles_ground_is_the_textbooks() -> None:
    rng = np.random.default_rng(1)
    land = proof_worlds.real_land(MISSION)
    assert land is not None
    heights = land.ground.height_m
    row, column = rng.uniform(1.0, heights.shape[0] - 3.0, 300), rng.uniform(1.0, heights.shape[1] - 3.0, 300)
    by_the_book = surface.bicubic(heights, row, column)
    ground = proof_oracle.Ground(heights, lambda _x, _y: (row, column))
    np.testing.assert_allclose(ground.at(np.zeros((300, 2))), by_the_book, atol=1e-8)


NOTCHED = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 50.0], [30.0, 10.0], [0.0, 50.0]])


@pytest.mark.parametrize(
    "solid",
    [
        CylinderSolid("s", 10.0, 20.0, 15.0, 40.0),
        ConeSolid("s", 10.0, 20.0, 30.0, 5.0, 50.0),
        SphereSolid("s", 10.0, 20.0, 30.0, 25.0, "marine"),
        PrismSolid("s", NOTCHED, 10.0, 40.0),
        CableSolid("s", np.array([-40.0, 0.0, 20.0]), np.array([50.0, 30.0, 60.0]), 4.0),
        CurtainSolid("s", np.array([-40.0, 0.0, 20.0]), np.array([50.0, 30.0, 60.0]), 4.0),
    ],
)
def test_the_oracles_distances_are_those_of_points_on_the_solid(solid: Solid) -> None:
    """The product's own distances are another derivation of the same; where inside, the oracle only says so."""
    rng = np.random.default_rng(2)
    points = rng.uniform([-80.0, -80.0, -30.0], [120.0, 120.0, 120.0], (4000, 3))
    area = np.array([-1e4, -1e4, 1e4, 1e4])
    seen = proof_oracle.solids_of([solid], np.zeros((0, 2)), math.inf, area)
    distance = np.array([proof_oracle.nearest(seen, *point)[0] for point in points])
    product = pack([solid]).distance_m(points)[:, 0]
    outside = product > 1e-9
    np.testing.assert_allclose(distance[outside], product[outside], atol=1e-8)
    assert (distance[product < -1e-9] == -1.0).all()


def test_a_wrong_claim_is_a_violation() -> None:
    tally = proof_trials.Tally()
    tally.claim("legs", "terrain", 10.0, 10.0, "here")
    assert tally.violations == []
    tally.claim("legs", "terrain", 10.0, 9.99, "here")
    tally.claim("legs", "terrain", 10.0, math.nan, "there")
    assert [v.where for v in tally.violations] == ["here", "there"]
