"""Table III: the formula, what is wrong with the paper's rows, and that only the algorithm's own time counts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from missionplanner.experiments import table3
from missionplanner.experiments.table3 import Complexity


def test_the_formula() -> None:
    assert Complexity("x", 50, 1.5, 4.0, 0.1).value(0.5) == pytest.approx(5.0)


def test_the_papers_rows_contradict_its_formula() -> None:
    """Its PSO-ABC-SA by its own times is ten times what it prints."""
    ours = table3.PAPER_ROWS[0]
    assert ours.by_formula == pytest.approx(127.8, abs=0.05)
    assert ours.by_formula / ours.printed == pytest.approx(10.0, rel=0.01)


def test_the_functions_own_time_is_taken_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a clock that only evaluations move, an algorithm costs nothing; if asking moves it too, that is its cost."""
    now = 0.0
    monkeypatch.setattr(table3.time, "process_time", lambda: now)
    plain = table3.find_function(table3.FUNCTION)

    def slow(points):  # type: ignore[no-untyped-def]
        nonlocal now
        now += 0.001 * len(points)
        return plain.cost(points)

    timed = table3.BenchmarkFunction("f", "f", slow, plain.lower, plain.upper, 0.0, plain.minimiser, 0.0)
    monkeypatch.setattr(table3, "find_function", lambda _name: timed)
    found = table3.complexity("pso", 1010, 2, 1)
    assert found.rows == 50
    assert (found.t1_s, found.t2_s) == pytest.approx((1.01, 1.01))
    assert found.value(0.2) == pytest.approx(0.0, abs=1e-9)
    search = table3.minimise

    def thinks(*arguments, **keywords):  # type: ignore[no-untyped-def]
        nonlocal now
        now += 3.0
        return search(*arguments, **keywords)

    monkeypatch.setattr(table3, "minimise", thinks)
    assert table3.complexity("pso", 1010, 2, 1).value(0.5) == pytest.approx(6.0)


@pytest.mark.slow
def test_a_quick_run(tmp_path: Path) -> None:
    told = table3.main(tmp_path, quick=True)
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert {p.name for p in tmp_path.iterdir()} == {"table3.csv", "results.md", "complexity.png"}
    text = (tmp_path / "results.md").read_text(encoding="utf-8")
    assert "12.782 | 127.8" in text
    assert "14.898 | 8e+05" in text
