"""The weights experiment: its schemes differ in nothing but the polish, and its sentence says what its table holds."""

from __future__ import annotations

from pathlib import Path

import pytest

from missionplanner.experiments import weights
from missionplanner.experiments.weights import ADAPTIVE, SCHEMES


def test_every_scheme_is_planned_and_a_sentence_compares_each_with_ours(tmp_path: Path) -> None:
    mission = tmp_path / "small.yaml"
    mission.write_text(
        """
name: small
origin: {lat_deg: 47.0, lon_deg: 8.0}
terrain: {kind: flat, alt_amsl_m: 0}
obstacles: [{kind: cylinder, name: mast, center: {x_m: 150, y_m: 0}, radius_m: 10}]
vehicles: [{name: a, home: {x_m: 0, y_m: 0}, goal: {x_m: 300, y_m: 0, height_agl_m: 50}}]
fleet: {direct_return: waived}
"""
    )
    found = {scheme: weights.plan(str(mission), scheme, 3) for scheme in SCHEMES}
    assert all(row["proven"] for row in found.values())
    assert found["no polish"]["cost"] >= found[ADAPTIVE]["cost"]
    rows = [{"mission": "small", "scheme": scheme, **row} for scheme, row in found.items()]
    table = [weights._summary("small", scheme, rows) for scheme in SCHEMES]
    assert [row["proven"] for row in table] == [1] * len(SCHEMES)
    assert table[0]["cost"] == pytest.approx(found[ADAPTIVE]["cost"])
    gain = 100.0 * (found["no polish"]["cost"] / found[ADAPTIVE]["cost"] - 1.0)
    assert f"*no polish*: price {gain:+.2f} %" in weights._words(table)
