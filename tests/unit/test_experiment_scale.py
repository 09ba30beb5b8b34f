"""The scale experiment: its vehicles fly, its counts are right, its growth is what was measured."""

from __future__ import annotations

import json
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from missionplanner.experiments import scale
from missionplanner.experiments.scale import Measured, Results, flights, homes, table, way


def test_growth_is_that_of_the_upper_sizes() -> None:
    """A law of the third power is found; what small sizes cost does not count, nor make one size a law."""
    cubes = [Measured("separation", n, 1.0, 1e-6 * n**3 + (5.0 if n < 5 else 0.0)) for n in (2, 5, 20, 50, 100)]
    results = Results(1, 600.0, (*cubes, Measured("motion", 10, 1.0, 1.0, 600.0, 1.0)))
    assert results.exponent("separation") == pytest.approx(3.0)
    assert results.exponent("motion") is None
    flat = [Measured("motion", n, 1.0, 2e-3 * n, 100.0, 1.0) for n in (10, 100, 1000)]
    assert Results(1, 100.0, tuple(flat)).exponent("motion") == pytest.approx(1.0)
    assert flat[0].each_us == pytest.approx(20.0)
    assert flat[0].times_real_time == pytest.approx(100.0)


def test_ways_take_long_enough_and_stay_in_their_area() -> None:
    """However far a vehicle goes, as many others are near: the density does not depend on their number."""
    places = homes(10)
    apart = [np.linalg.norm(a - b) for a, b in combinations(places, 2)]
    assert min(apart) == pytest.approx(500.0)
    rng = np.random.default_rng(3)
    for home in places:
        points = way(rng, home, 600.0)
        assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() > 600.0 * 8.0
        assert np.abs(points[:, :2] - home[:2]).max() <= 500.0 + 1e-9


def test_near_pairs_are_those_that_samples_show() -> None:
    """Against all pairs of samples at the same instants, of flights in a crowd."""
    tracks = flights(6, 5, 200.0)
    measured = {m.what: m for m in scale.separation(6, 5, 200.0)}
    t_s = np.arange(0.0, 200.0, 0.05)
    places = [np.stack([np.interp(t_s, t.t_s, t.position_m[:, k]) for k in range(3)], axis=-1) for t in tracks]
    near = sum(np.linalg.norm(a - b, axis=1).min() < 20.0 for a, b in combinations(places, 2))
    assert measured["separation"].pairs == near
    assert set(measured) == {"separation", "tightest", "slack"}


@pytest.mark.slow
def test_a_quick_run(tmp_path: Path) -> None:
    """Every kind of work is measured, in processes of their own, and told."""
    told = scale.main(tmp_path, seed=1, quick=True, progress=lambda _what, _share: None)
    assert {m["what"] for m in told["measured"]} == set(told["exponents"])
    assert all(m["cpu_s"] > 0.0 for m in told["measured"])
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert {p.name for p in tmp_path.iterdir()} == {"scale.csv", "results.md", "scale.png"}
    assert "near pairs" in (tmp_path / "results.md").read_text(encoding="utf-8")


def test_the_table_tells_whether_cost_grows() -> None:
    """Per vehicle: in proportion is not growth, more is."""
    for power, words in ((1.0, "does not grow"), (1.5, "grows.")):
        measured = tuple(Measured("motion", n, 1.0, 1e-3 * n**power, 100.0, 1.0) for n in (10, 100, 1000))
        assert words in table(Results(1, 100.0, measured))
