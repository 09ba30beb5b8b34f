"""The ablation: it searches as ``minimise`` does, its variants differ, and its runs do not depend on the workers."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.experiments import ablation
from missionplanner.experiments.test_functions import find_function
from missionplanner.search import minimise
from missionplanner.search.pso_abc_sa import PsoAbcSaSettings


def test_the_whole_is_what_minimise_finds() -> None:
    f = find_function("f9")
    for seed in range(3):
        expected = minimise(f.cost, f.lower, f.upper, evaluations=700, seed=seed)
        assert ablation.search("f9", None, ablation.WHOLE, 700, seed)["cost"] == expected.cost


def test_every_switch_is_left_out_once() -> None:
    switches = {f.name for f in fields(PsoAbcSaSettings) if f.type == "bool"} | {"shrink"}
    changed = [name for _, change in ablation.VARIANTS.values() for name in change]
    assert sorted(changed) == sorted(switches)


def test_tables_are_of_the_runs_and_runs_of_the_jobs_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablation, "FUNCTIONS", (find_function("f3"), find_function("f5")))
    one = ablation.main(tmp_path / "one", runs=2, evaluations=300, workers=1)
    two = ablation.main(tmp_path / "two", runs=2, evaluations=300, workers=2)
    assert one == two
    ranks = one["friedman"]["test functions"]["ranks"]
    assert sum(ranks.values()) == pytest.approx(sum(range(1, len(ablation.VARIANTS) + 1)))
    counts = one["beside_the_whole"]["no memory"]
    assert counts["better"] + counts["equal"] + counts["worse"] == 4
    text = (tmp_path / "one" / "results.md").read_text(encoding="utf-8")
    assert all(variant in text for variant in ablation.VARIANTS)
    assert (tmp_path / "one" / "ranks.png").stat().st_size > 1000
    rows = (tmp_path / "one" / "ablation.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + 2 * 2 * len(ablation.VARIANTS)
    with pytest.raises(MissionError, match="expected"):
        ablation.main(tmp_path / "one", runs=2, evaluations=400, workers=1)  # results of other settings


def test_ranks_and_counts_against_a_table_done_by_hand() -> None:
    found = np.array([[0.0, 1.0, 1.0], [2.0, 1.0, 3.0]])
    results = ablation.Results(100, 2, (ablation.WHOLE, "one group", "no memory"), {"f": found}, {})
    np.testing.assert_allclose(results.ranked(("f",)).ranks, [1.5, 1.75, 2.75])
    beside = ablation.compared(results)
    assert (beside["one group"]["better"], beside["one group"]["equal"], beside["one group"]["worse"]) == (1, 0, 1)
    assert (beside["no memory"]["better"], beside["no memory"]["worse"]) == (0, 2)


def test_a_folder_without_instances_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"expected a folder with instances of the UAV objective \(\*\.npz\)"):
        ablation.measure(tmp_path / "out", 1, 100, tmp_path)
