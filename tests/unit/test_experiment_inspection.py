"""The inspection experiment: its questions, what it counts as kept, and a small run of it on real lines."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.experiments import inspection
from missionplanner.experiments.inspection import Results, bayreuth, many, table
from missionplanner.inspection import open_scene
from missionplanner.plan import Trajectory

DATA = Path(__file__).parents[3] / "shared" / "data"
real = pytest.mark.skipif(not (DATA / inspection.LINES).is_file(), reason=f"no lines of Bayreuth in {DATA}")


def shared(weight: float) -> dict[str, Any]:
    return {
        "towers": 3,
        "left_out": 0,
        "weight": weight,
        "rounds": 1,
        "makespan_s": 400.0,
        "flight_s": 800.0,
        "bound_s": 700.0,
    }


def results(**changes: Any) -> Results:
    """Return what came of a run in which all was kept."""
    made = {"machine": "one", "date": "2026-05-04"}
    three = {"ours": shared(30.0), "split": shared(20.0), "nearest": shared(25.0), "all": 3, "weight_all": 40.0}
    three |= {"travel_cpu_s": 1.0, "solver_cpu_s": 9.0}
    tour = {"round": 1, "vehicle": "copter-1", "visits": 6, "reckoned_s": 400.0, "planned_s": 410.0}
    tour |= {"reckoned_share": 0.5, "planned_share": 0.51, "way_m": [[0.0, 0.0], [100.0, 50.0]]}
    fleet = three | {
        "planned_towers": 3,
        "planned_left_out": [],
        "planned_makespan_s": 410.0,
        "planned_flight_s": 810.0,
        "rounds": [410.0],
        "tours": [tour],
        "lines": [[[0.0, 0.0], [0.0, 200.0]]],
        "homes": [[-100.0, 0.0]],
        "planning_s": 50.0,
        "planning_cpu_s": 60.0,
    }
    flight = {"round": 1, "vehicles": 2, "landed": 2, "lasts_s": 415.0, "conductor_m": 16.9, "required_m": 10.0}
    flight |= {"separation_m": None, "margin_m": 1.2}
    size = {
        "towers": 50,
        "vehicles": 3,
        "problem": None,
        "planned_towers": 50,
        "rounds": 2,
        "planned_rounds": "all",
        "travel_cpu_s": 1.0,
    }
    size |= {"solver_cpu_s": 3.0, "planning_s": 100.0, "planning_cpu_s": 90.0, "flight_s": 1000.0, "bound_s": 950.0}
    parts: dict[str, Any] = {
        "fleet": fleet,
        "priorities": ({"set": 1, **three}, {"set": 2, **three}),
        "flights": (flight,),
        "coverage": {"seen": ["A01", "A02", "A03"], "missing": []},
        "sizes": (size,),
        "made": (made,),
    }
    for name, change in changes.items():
        one = isinstance(parts[name], dict)
        parts[name] = {**parts[name], **change} if one else tuple({**part, **change} for part in parts[name])
    return Results(**parts)


def test_what_is_not_kept_is_told() -> None:
    """Less than a simple way collects, too near a conductor, somebody who did not land, a size that failed."""
    assert results().problems() == []
    assert "All was kept." in table(results())
    for changes, words in (
        ({"priorities": {"nearest": shared(31.0)}}, "nearest first collects 31, ours 30"),
        ({"flights": {"conductor_m": 9.9}}, "9.9 m from a conductor, asked 10 m"),
        ({"flights": {"landed": 1}}, "1 of 2 landed"),
        ({"sizes": {"problem": "no way"}}, "50 towers: no way"),
        ({"coverage": {"seen": ["A01"], "missing": ["A02.left: never near"]}}, "1 of 3 towers seen: A02.left"),
        ({"fleet": {"planned_left_out": ["A01: too far"]}}, "left out: A01: too far"),
    ):
        found = results(**changes)
        assert any(words in problem for problem in found.problems())
        assert words in table(found)
        assert words in json.dumps(found.as_json(), allow_nan=False)


def test_tracks_are_read_as_they_were_kept(tmp_path: Path) -> None:
    """What rounds flew is measured together: in their order, every instant."""
    tracks = [Trajectory(np.arange(3.0) + k, np.full((3, 3), float(k))) for k in range(11)]
    inspection._save_tracks(tmp_path / "plan", 2, tracks)
    found = inspection._tracks(tmp_path / "plan", 2)
    assert [track.t_s.tolist() for track in found] == [track.t_s.tolist() for track in tracks]
    assert [track.position_m.tolist() for track in found] == [track.position_m.tolist() for track in tracks]


def test_gains_are_those_of_weight() -> None:
    """Half as much again as the split; a set of which a simple way gets nothing has no gain."""
    assert results().gains("split") == pytest.approx([0.5, 0.5])
    assert results(priorities={"split": shared(0.0)}).gains("split") == []


def test_without_the_data_it_is_refused(tmp_path: Path) -> None:
    """The option, the file and the folder are named."""
    with pytest.raises(MissionError, match=rf"^--data: expected a folder with {inspection.TERRAIN} .*{tmp_path}"):
        bayreuth(tmp_path)


@real
def test_the_lines_are_the_real_ones() -> None:
    """131 towers of two lines; crews beside them, away from every line, as near to their parts as can be."""
    mission = bayreuth(DATA)
    asked = mission.inspection
    assert asked is not None
    assert [len(line.towers) for line in asked.lines] == [79, 52]
    assert len(mission.vehicles) == 6
    assert len(mission.obstacles) == 21
    scene = open_scene(mission, DATA)
    assert scene.towers is not None
    away = [np.hypot(*(scene.towers.top_m - task.home_m)[:, :2].T) for task in scene.tasks]
    assert all(80.0 <= row.min() <= 250.0 for row in away)
    assert np.min(away, axis=0).max() < 3600.0


@real
@pytest.mark.parametrize("towers", [4, 61, 62, 63, 200])
def test_as_many_towers_as_asked_for(towers: int) -> None:
    """Lines of two towers or more, at even distances."""
    mission = many(DATA, towers)
    assert mission.inspection is not None
    assert len(mission.inspection.towers) == towers
    assert all(len(line.towers) >= 2 for line in mission.inspection.lines)
    assert len(mission.vehicles) >= math.ceil(towers / 20)
    places = np.array([[tower.x_m, tower.y_m] for tower in mission.inspection.towers], dtype=float)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 1e9 * np.eye(towers)
    assert apart.min() == pytest.approx(250.0)


@real
@pytest.mark.slow
def test_a_small_run(tmp_path: Path) -> None:
    """Three towers of the real line, two copters: planned, flown, seen; started again, it goes on where it was."""
    told: list[float] = []

    def run() -> dict[str, Any]:
        return inspection.main(
            tmp_path, data=DATA, seed=1, quick=True, workers=1, progress=lambda _, done: told.append(done)
        )

    found = run()
    assert found["problems"] == []
    assert found["fleet"]["planned_towers"] == 3
    assert found["coverage"]["seen"] == ["A01", "A02", "A03"]
    assert min(flight["conductor_m"] for flight in found["flights"]) >= 10.0
    for tour in found["fleet"]["tours"]:
        assert tour["planned_s"] == pytest.approx(tour["reckoned_s"], rel=0.1)
    assert {p.name for p in tmp_path.iterdir()} >= {"results.md", "map.png", "bars.png", "tours.csv", "priorities.csv"}
    told.clear()
    assert run() == found
    assert min(told) == 1.0
