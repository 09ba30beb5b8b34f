"""What the arrival experiment counts as kept, what it keeps of a run that was ended, and one run of it."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from missionplanner.errors import MissionError
from missionplanner.experiments import arrival
from missionplanner.experiments.arrival import CONDITIONS, Results, Run, run, table, wind_of
from missionplanner.experiments.campaign import Job
from tests.main_job import mission_path

CALM, WIND_KNOWN, *_ = CONDITIONS
GOOD = Run("calm", 1, spread_s=0.5, separation_m=20.0, separation_required_m=20.0, margin_m=0.0, margin_to="terrain")


def test_what_is_wanted_of_a_run() -> None:
    """Each limit may be met exactly; what is unknown is not kept."""
    assert list(GOOD.problems(CALM)) == []
    for wrong, word in (
        (replace(GOOD, spread_s=0.51), "spread 0.51 s"),
        (replace(GOOD, spread_s=None), "did not arrive"),
        (replace(GOOD, separation_m=19.9), "separation 19.9 m"),
        (replace(GOOD, margin_m=-0.2), "0.2 m too close to terrain"),
        (replace(GOOD, margin_m=None), "nobody took off"),
        (Run("calm", 1, error="not planned: no"), "not planned"),
    ):
        (problem,) = wrong.problems(CALM)
        assert word in problem
    assert list(replace(GOOD, spread_s=0.9).problems(WIND_KNOWN)) == []


def test_what_failed_is_counted_and_told() -> None:
    """A plan that failed counts as a seed, not as one that was kept; no number stands for it."""
    results = Results("m", (GOOD, Run("calm", 2, error="not planned: x"), replace(GOOD, seed=3, spread_s=0.7)))
    told = results.as_json()
    calm = told["conditions"][0]
    assert (calm["seeds"], calm["flown"], calm["kept"], calm["spread_worst_s"]) == (3, 2, 1, 0.7)
    assert not told["kept"]
    assert [p.split(":")[0] for p in told["problems"]] == ["calm, seed 2", "calm, seed 3"]
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert "not planned: x" in table(results)


def test_winds_come_from_everywhere() -> None:
    """Of twenty seeds' winds none leaves a gap of more than twice its share, and all are as strong."""
    winds = [wind_of(seed) for seed in range(1, 21)]
    courses = sorted(w.from_deg for w in winds)
    gaps = [b - a for a, b in itertools.pairwise([*courses, courses[0] + 360.0])]
    assert max(gaps) <= 2 * 360.0 / 20
    assert {round(math.hypot(*w.velocity_m_s), 6) for w in winds} == {arrival.WIND_M_S}


def test_a_campaign_of_plans(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One job for each seed and each kind of plan; its runs come back by condition, as they went."""
    mission = tmp_path / "m.yaml"
    mission.write_text(mission_path("quickstart").read_text(encoding="utf-8"), encoding="utf-8")
    made: list[tuple[str, int]] = []
    versions: list[str] = []

    def pretend(_path: Path, weather: str, seed: int) -> list[Run]:
        made.append((weather, seed))
        return [replace(GOOD, condition=c.name, seed=seed, spread_s=0.1) for c in CONDITIONS if c.planned == weather]

    def campaign(jobs: Sequence[Job], _folder: Path, *, version: str, **_: object) -> dict[str, dict[str, Any]]:
        versions.append(version)
        return {job.key: json.loads(json.dumps(job.function(**job.arguments))) for job in jobs}

    monkeypatch.setattr(arrival, "fly_seed", pretend)
    monkeypatch.setattr(arrival.campaign, "run", campaign)
    found = run(tmp_path / "out", mission, [2, 1])
    assert made == [("calm", 2), ("known", 2), ("calm", 1), ("known", 1)]
    expected = [replace(GOOD, condition=c.name, seed=seed, spread_s=0.1) for c in CONDITIONS for seed in (2, 1)]
    assert list(found.runs) == expected
    run(tmp_path / "out", mission, [1])
    mission.write_text(mission.read_text(encoding="utf-8") + "# another\n", encoding="utf-8")
    run(tmp_path / "out", mission, [1])
    assert len(set(versions)) == 2
    assert versions[0] == versions[1]


def test_a_fleet_that_need_not_arrive_together(tmp_path: Path) -> None:
    """There is nothing to measure."""
    text = mission_path("quickstart").read_text(encoding="utf-8")
    mission = tmp_path / "m.yaml"
    mission.write_text(f"{text}\nfleet: {{arrive_together: false}}\n", encoding="utf-8")
    with pytest.raises(MissionError, match="arrive_together"):
        run(tmp_path / "out", mission, [1])


@pytest.mark.slow
def test_one_seed_of_a_mission(tmp_path: Path) -> None:
    """Planned and flown under all conditions: figures of each, apart and clear, later only where it was disturbed."""
    told = arrival.main(
        tmp_path, mission=mission_path("quickstart"), seed=2, seeds=5, quick=True, progress=lambda _w, _s: None
    )
    runs = {r["condition"]: r for r in told["runs"]}
    assert list(runs) == [c.name for c in CONDITIONS]
    for found in runs.values():
        assert not found["error"]
        assert found["separation_m"] >= found["separation_required_m"] == 20.0
        assert found["margin_m"] >= 0.0
    assert abs(runs["calm"]["late_s"]) < 0.5
    assert runs["calm"]["spread_s"] <= 0.5
    assert runs["calm"]["corrections"] == 0
    assert runs["late"]["corrections"] >= 1
    assert {p.name for p in tmp_path.iterdir()} == {"runs.jsonl", "runs.csv", "results.md", "spread.png"}
    assert asdict(Run("calm", 2)).keys() == runs["calm"].keys()
