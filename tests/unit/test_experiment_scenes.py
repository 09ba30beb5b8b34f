"""The paper's scenes: the judge of paths, the bound of lengths, the grids, one search, and what is made of results."""

from __future__ import annotations

import ast
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from missionplanner.errors import MissionError
from missionplanner.experiment_commands import app
from missionplanner.experiments import mountain, multi_domain, scene_comparison, scene_runs, scenes_2d
from missionplanner.experiments.document import collect, machine
from missionplanner.experiments.mountain import bounds_m, shortest_m
from missionplanner.experiments.scene_comparison import BEST, PLANNER, Comparison, table
from missionplanner.experiments.scene_judge import Judge, least_apart_m, together
from missionplanner.experiments.scene_runs import GRID, curves, path_of, resolved, search_fleet
from missionplanner.experiments.scenes_2d import SCENES, built, mission_text
from missionplanner.geodesy import FloatArray
from missionplanner.mission import parse_mission
from tests.main_job import mission_path

MOUNTAIN = mission_path("mountain").read_text(encoding="utf-8")
MULTI_DOMAIN = mission_path("multi_domain").read_text(encoding="utf-8")
NOTHING = np.zeros((0, 2))


# --- the bound


def test_the_shortest_way_around_the_papers_cylinders() -> None:
    """Known exactly, for four margins (PEERS.md), climb included."""
    scene, _ = resolved(MOUNTAIN)
    cylinders: list[Any] = list(scene.mission.obstacles)
    centres = np.array([(c.center.x_m, c.center.y_m) for c in cylinders])
    radii = np.array([c.radius_m for c in cylinders])
    start, goal = np.array([100.0, 20.0]), np.array([600.0, 450.0])
    for margin_m, known_m in ((0.0, 827.904), (5.0, 828.333), (10.0, 839.680)):
        found_m = math.hypot(shortest_m(start, goal, centres, radii + margin_m), 500.0)
        assert found_m == pytest.approx(known_m, abs=1e-3)


@given(
    st.floats(1.0, 60.0), st.floats(-80.0, 80.0), st.floats(70.0, 200.0), st.floats(70.0, 200.0), st.floats(-3.0, 3.0)
)
def test_the_shortest_way_around_one_disc(radius: float, off: float, before: float, after: float, turn: float) -> None:
    """Two tangents and an arc, or straight; the same wherever and however the map is turned."""
    start, goal, centre = np.array([-before, off]), np.array([after, off]), np.zeros(2)
    a, b = math.hypot(*start), math.hypot(*goal)
    known = before + after
    if abs(off) < radius:
        between = math.atan2(off * (before + after), float(start @ goal))  # an arc cosine loses it near half a turn
        swept = abs(between) - math.acos(radius / a) - math.acos(radius / b)
        known = math.sqrt(a * a - radius**2) + math.sqrt(b * b - radius**2) + radius * swept
    spin = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    moved = [spin @ place + [30.0, -40.0] for place in (start, goal, centre)]
    found = shortest_m(moved[0], moved[1], moved[2][np.newaxis], np.array([radius]))
    assert found == pytest.approx(known, rel=1e-9)


def test_no_way_between_discs_that_overlap() -> None:
    """A ring of discs around the goal lets nobody in, and a gap in it somebody."""
    turn = np.linspace(0.0, 2.0 * math.pi, 12, endpoint=False)
    ring = 50.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    start, goal = np.array([200.0, 0.0]), np.zeros(2)
    assert shortest_m(start, goal, ring, np.full(12, 15.0)) == math.inf
    assert 200.0 < shortest_m(start, goal, np.delete(ring, 1, axis=0), np.full(11, 15.0)) < 230.0
    assert shortest_m(start, goal, NOTHING, np.zeros(0)) == 200.0


def test_bounds_are_of_climb_limits_too() -> None:
    """A vehicle that climbs 500 m at 20 degrees at most flies 500 / sin(20) m at least."""
    free = bounds_m(MOUNTAIN)
    steep = bounds_m(MOUNTAIN.replace("angle_max_deg: 45", "angle_max_deg: 20"))
    assert steep == pytest.approx([500.0 / math.sin(math.radians(20.0))] * 5)
    assert all(a < b for a, b in zip(free, steep, strict=True))


# --- the judge


@pytest.mark.parametrize("text", [MOUNTAIN, MULTI_DOMAIN], ids=["mountain", "multi_domain"])
def test_the_judge_sees_the_scenes_solids_and_ground(text: str) -> None:
    """What it measures at random places is what the planner's kernels measure, which it does not use."""
    scene, judge = resolved(text)
    rng = np.random.default_rng(1)
    west, south, east, north = scene.area_m
    places = rng.uniform([west + 30.0, south + 30.0, 0.0], [east - 30.0, north - 30.0, 500.0], (150, 3))
    ground = scene.terrain.height_amsl_m(places[:, 0], places[:, 1])
    places[:, 2] += ground + 1.0
    seen = [judge.kept(np.stack([p, p + np.array([0.0, 0.0, 1e-6])])) for p in places]
    away = scene.obstacles.distance_m(places)[:, scene.space.obstacles.hard].min(axis=1)
    assert (away < 0.0).any()
    for kept, distance_m, place, height_m in zip(seen, away, places, ground, strict=True):
        assert kept.obstacle_m == pytest.approx(distance_m if distance_m > 0.0 else -1.0, abs=1e-4)
        assert kept.height_m == pytest.approx(place[2] - height_m, abs=0.5)  # the planner's grid is coarser


def test_the_judge_finds_what_is_between_points() -> None:
    """A leg through a cylinder, beside one, under the ground; the climb of the steepest leg."""
    _, judge = resolved(MOUNTAIN)
    through = judge.kept(np.array([[300.0, 100.0, 1800.0], [300.0, 220.0, 1800.0]]))
    assert through.obstacle_m == -1.0
    beside = np.array([[323.0, 100.0, 1800.0], [323.0, 220.0, 1920.0]])
    assert judge.kept(beside).obstacle_m == pytest.approx(3.0, abs=0.01)
    assert judge.kept(beside, stray_m=2.0).obstacle_m == pytest.approx(1.0, abs=0.1)
    assert math.degrees(judge.kept(beside).climb_rad) == pytest.approx(45.0)
    assert judge.kept(np.array([[50.0, 20.0, 1300.0], [150.0, 20.0, 1200.0]])).height_m < 0.0


def test_the_judge_refuses_what_it_cannot_read() -> None:
    """A terrain from a file, a height above ground of a top: said, not guessed."""
    text = mission_path("ridge_line").read_text(encoding="utf-8")
    with pytest.raises(MissionError, match="on flat ground or peaks"):
        Judge(parse_mission(text, "m"))
    lower = MOUNTAIN.replace(
        "center: {x_m: 10, y_m: 35}, radius_m: 5", "center: {x_m: 10, y_m: 35}, radius_m: 5, top_height_agl_m: 9"
    )
    with pytest.raises(MissionError, match="c1"):
        Judge(parse_mission(lower, "m"))


@given(st.floats(0.0, 30.0), st.floats(0.2, 3.0))
@settings(max_examples=30)
def test_who_meets_at_one_time(off_m: float, longer: float) -> None:
    """Two that cross halfway are as near there as they pass; two on the same way at other times are not."""
    east = np.array([[-100.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    north = np.array([[0.0, -100.0 * longer, off_m], [0.0, 100.0 * longer, off_m]])
    assert least_apart_m(together([east, north])) == pytest.approx([off_m, off_m], abs=1e-6)
    behind = east - np.array([50.0, 0.0, 0.0])
    far = east + np.array([0.0, 500.0, 0.0])
    assert least_apart_m(together([east, behind, far])) == pytest.approx([50.0, 50.0, 500.0])
    assert least_apart_m(together([east])).tolist() == [math.inf]


def judged(path_m: FloatArray) -> dict[str, Any]:
    """Return the verdict on the first vehicle's path when the others fly elsewhere."""
    scene, judge = resolved(MOUNTAIN)
    alone = replace(scene, tasks=scene.tasks[:1])
    (vehicle,) = scene_runs._judged(alone, judge, [path_m], [path_m], together([path_m]), 0.0)["vehicles"]
    return dict(vehicle)


def test_verdicts() -> None:
    """Straight through a cylinder; past it within the margin; wide of it; too steep."""
    along, across = np.array([0.8, 0.6, 0.0]), np.array([0.6, -0.8, 0.0])
    for off_m, verdict in ((5.0, (False, False)), (22.0, (True, False)), (40.0, (True, True))):
        by = np.array([500.0, 350.0, 1850.0]) + off_m * across
        found = judged(np.stack([by - 80.0 * along, by + 80.0 * along]))
        assert (found["avoids"], found["safe"]) == verdict, off_m
    assert found["flyable"]
    assert not judged(np.array([[100.0, 20.0, 1500.0], [150.0, 20.0, 1600.0]]))["flyable"]


# --- grids


@pytest.mark.parametrize("scene", SCENES, ids=lambda s: s.name)
def test_grids(scene: scenes_2d.GridScene) -> None:
    """As dense as stated, both ends free, a way between them; as a mission, the same cells are built on."""
    cells = built(scene)
    assert cells.mean() == pytest.approx(scene.share, abs=0.02)
    labels, _ = ndimage.label(~cells)
    assert labels[0, 0] == labels[-1, -1] > 0
    question, judge = resolved(mission_text(scene))
    at = (np.stack(np.meshgrid(*[np.arange(20)] * 2), axis=-1).reshape(-1, 2) + 0.5) * scenes_2d.CELL_M
    inside = question.obstacles.distance_m(np.column_stack([at, np.full(400, 50.0)])).min(axis=1) < 0.0
    assert (inside == cells.ravel()).all()
    assert judge.heights_m(at[:, 0], at[:, 1]).max() == 0.0


# --- one search


def test_curves() -> None:
    """From start to goal through the control points; in the plane, at one altitude."""
    scene, _ = resolved(MOUNTAIN)
    family = curves(scene, 1, 4)
    x = np.random.default_rng(1).uniform(family.lower, family.upper, (3, 12))
    paths = family.paths(x)
    assert paths[:, [0, -1]] == pytest.approx(np.tile(scene.tasks[1].route_m, (3, 1, 1)))
    for path, points in zip(paths, x.reshape(3, 4, 3), strict=True):
        nearest = np.linalg.norm(path[:, None] - points, axis=-1).min(axis=0)
        assert (nearest < np.linalg.norm(np.diff(path, axis=0), axis=1).max()).all()
    flat = curves(resolved(mission_text(SCENES[0]))[0], 0, 4, planar=True)
    assert len(flat.lower) == 8
    assert np.ptp(flat.paths(flat.upper[np.newaxis])[..., 2]) < 1e-9


def test_a_search_repeats_itself_and_is_priced_as_it_is_drawn() -> None:
    """The same seed, the same result; another, another. What is drawn costs what the table says."""
    found = search_fleet(MOUNTAIN, "pso", 4, evaluations=200, controls=3)
    again = search_fleet(MOUNTAIN, "pso", 4, evaluations=200, controls=3)
    assert {**found, "cpu_s": 0.0, "date": ""} == {**again, "cpu_s": 0.0, "date": ""}
    assert search_fleet(MOUNTAIN, "pso", 5, evaluations=200, controls=3)["cost"] != found["cost"]
    assert found["evaluations"] == 5 * 200
    assert found["cost"] == pytest.approx(sum(v["cost"] for v in found["vehicles"]))
    assert found["history"][-1] == pytest.approx(found["cost"], rel=1e-5)
    assert (np.diff(found["history"]) <= 0.0).all()
    assert len(found["history"]) == len(GRID)
    scene, _ = resolved(MOUNTAIN)
    paths = [path_of(MOUNTAIN, found, k) for k in range(5)]
    for k, vehicle in enumerate(found["vehicles"]):
        price = scene_runs.price_of(scene, k, paths[:k])
        assert float(price.total(paths[k][np.newaxis])[0]) == pytest.approx(vehicle["cost"], rel=1e-2)


def test_the_planners_searches_are_timed() -> None:
    """Every path that is searched, without whatever else the planner does."""
    found = scene_runs.plan_scene(mission_text(SCENES[0]), 1)
    assert found["proven"]
    assert len(found["searches_s"]) == len(found["legs_s"]) >= 1
    assert 0.0 < sum(found["searches_s"]) < sum(found["searches_s"] + found["legs_s"]) < found["cpu_s"]


# --- what is made of results


def vehicle(**changes: Any) -> dict[str, Any]:
    return {"cost": 1.0, "length_m": 100.0, "avoids": True, "safe": True, "flyable": True, "apart_m": 30.0} | changes


def test_who_has_no_plan_has_no_clear_path() -> None:
    """Failed runs count as paths that are not clear; rates never round up to all."""
    runs = [{"cost": 2.0 + k, "length_m": 200.0, "cpu_s": 1.0, "vehicles": [vehicle(), vehicle()]} for k in range(3)]
    comparison = Comparison(
        MOUNTAIN,
        3,
        False,
        {
            "pso": runs,
            BEST: [{**run, "cost": run["cost"] - 0.5} for run in runs],
            PLANNER: [*({**run, "error": ""} for run in runs[:2]), {"error": "no way", "cpu_s": 9.0}],
        },
    )
    found = comparison.summary(PLANNER)
    assert (found["runs"], found["failed"], found["paths"], found["avoids"], found["all"]) == (3, 1, 6, 4, 4)
    assert comparison.ranks() == {"pso": 2.0, BEST: 1.0}
    assert comparison.typical("pso")["cost"] == 3.0
    rows = table(comparison, {"pso": ("1", "2", "3", "4 s", "5", "66 %")})
    assert "66.7 %" in rows[-1]
    assert "1 / 2 / 3 | 4 s | 5 | 66 %" in rows[2]
    assert len({row.count("|") for row in rows}) == 1
    many = [{**runs[0], "vehicles": [vehicle()] * 2000}] * 2 + [{**runs[0], "vehicles": [vehicle(avoids=False)] * 2000}]
    assert "66.7 %" in table(Comparison(MOUNTAIN, 3, False, {"pso": many, BEST: runs}))[2]


def scene_of(text: str, algorithms: tuple[str, ...], planned: dict[str, Any]) -> Comparison:
    """Return results of which the searches' are all of one short search."""
    found = search_fleet(text, "pso", 1, evaluations=100, controls=3)
    return Comparison(text, 3, False, {**{name: [found, found] for name in algorithms}, PLANNER: [planned, planned]})


def test_a_mission_without_a_plan_is_told(tmp_path: Path) -> None:
    """The planner found none in any run: said in the tables and left out of the pictures."""
    none = {"error": "no way", "cpu_s": 1.0, "machine": "m", "date": "2026-01-02"}
    found = scene_of(MOUNTAIN, mountain.ALGORITHMS, none)
    mountain.draw_all(tmp_path, found, mountain._PANELS, view=(24, -62))
    assert len(list(tmp_path.glob("*.png"))) == 5
    told = mountain.report([found])
    assert "Plans found: 0 of 2. no way" in told
    assert "found no plan: 0 of 2 runs" in multi_domain.report(found)
    assert found.as_json()["algorithms"][-1]["cost_best"] is None
    assert {row.count("|") for row in table(found)} == {11}


def test_a_fleet_of_more_than_seven_is_drawn(tmp_path: Path) -> None:
    """Colours are used again."""
    more = "".join(
        f"  - {{name: more{k}, start: {{x_m: {x}, y_m: {y}, alt_amsl_m: 1500}}, "
        f"goal: {{x_m: {x + 500}, y_m: {y + 430}, alt_amsl_m: 2000}}}}\n"
        for k, (x, y) in enumerate(((20, 60), (10, 160), (60, 160)))
    )
    text = MOUNTAIN.replace("# the paper's cylinders have no top", f"{more}# no top")
    assert len(resolved(text)[0].tasks) == 8
    none = {"error": "no way", "cpu_s": 1.0}
    mountain.draw_all(tmp_path, scene_of(text, mountain.ALGORITHMS, none), mountain._PANELS, view=(24, -62))


def test_runs_of_two_machines_are_told() -> None:
    """A resumed campaign may be of several machines and days: none of them is hidden."""
    none = {"error": "no way", "cpu_s": 1.0}
    found = Comparison(MOUNTAIN, 3, False, {PLANNER: [{**none, "machine": m, "date": d} for m, d in
                                                     (("one", "2026-01-02"), ("two", "2026-01-05"))]})  # fmt: skip
    told = scene_comparison.made([found])
    assert all(word in told for word in ("one; two", "2026-01-02", "2026-01-05", "do not compare"))


def test_what_runs_depend_on() -> None:
    """What is left out of a search's version is imported by nothing that prices or judges its path."""
    root = Path(scene_comparison.__file__).parents[1]
    core = scene_comparison.core_modules()
    assert {f"missionplanner.{m}" for m in ("proof", "obstacles", "terrain", "cost", "kernels", "motion")} <= set(core)
    for module in core:
        path = root.parent.joinpath(*module.split("."))
        for file in path.rglob("*.py") if path.is_dir() else [path.with_suffix(".py")]:
            tree = ast.parse(file.read_text(encoding="utf-8"))
            imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
            names = {f"{node.module}.{a.name}".split(".")[1] for node in imported for a in node.names
                     if (node.module or "").startswith("missionplanner")}  # fmt: skip
            if file.stem != "scene_runs":  # it runs the planner, whose runs depend on all
                assert not names.intersection(scene_comparison._PLANNER_ONLY), file


def test_results_are_collected(tmp_path: Path) -> None:
    """A section becomes its results, with their pictures; what stands between sections and other sections stay."""
    other = "<!-- peers: begin -->\nas it was\n<!-- peers: end -->\n"
    text = f"# All\n\nKept.\n<!-- scenes-2d: begin -->\nold\n<!-- scenes-2d: end -->\nAlso kept.\n{other}"
    document = tmp_path / "docs" / "E.md"
    document.parent.mkdir()
    document.write_text(text, encoding="utf-8")
    with pytest.raises(MissionError, match="expected a folder experiment_NAME"):
        collect(document, tmp_path)
    folder = tmp_path / "experiment_scenes_2d"
    folder.mkdir()
    (folder / "results.md").write_text("# Title\n\n## Part\n\nnew\n\n![a](paths.png)\n", encoding="utf-8")
    with pytest.raises(MissionError, match=r"expected the picture paths\.png"):
        collect(document, tmp_path)
    (folder / "paths.png").write_bytes(b"png")
    assert collect(document, tmp_path) == ["scenes-2d"]
    told = document.read_text(encoding="utf-8")
    assert (
        "<!-- scenes-2d: begin -->\n### Part\n\nnew\n\n![a](figures/scenes-2d-paths.png)\n<!-- scenes-2d: end -->"
        in told
    )
    assert told.startswith("# All\n\nKept.\n")
    assert told.endswith(f"Also kept.\n{other}")
    assert (tmp_path / "docs" / "figures" / "scenes-2d-paths.png").read_bytes() == b"png"
    assert collect(document, tmp_path) == ["scenes-2d"]
    assert document.read_text(encoding="utf-8") == told
    (tmp_path / "plain.md").write_text("nothing\n", encoding="utf-8")
    with pytest.raises(MissionError, match="got none"):
        collect(tmp_path / "plain.md", tmp_path)
    with pytest.raises(MissionError, match="expected a Markdown file"):
        collect(tmp_path / "absent.md", tmp_path)
    (folder / "results.md").write_bytes("# Größe\n".encode("latin-1"))
    with pytest.raises(MissionError, match=r"results\.md: expected Markdown in UTF-8"):
        collect(document, tmp_path)
    document.write_bytes("# Größe\n".encode("latin-1"))
    with pytest.raises(MissionError, match=r"E\.md: expected Markdown in UTF-8"):
        collect(document, tmp_path)


def test_every_section_is_of_a_command() -> None:
    """What the document of experiments shows can be run again under the name that it has there."""
    text = (mission_path("mountain").parents[1] / "docs" / "EXPERIMENTS.md").read_text(encoding="utf-8")
    sections = set(re.findall(r"<!-- ([a-z0-9-]+): begin -->", text))
    commands = {c.name or c.callback.__name__ for c in app.registered_commands if c.callback is not None}
    assert sections <= commands
    assert sections == set(re.findall(r"<!-- ([a-z0-9-]+): end -->", text))
    assert {"table2", "scenes-2d", "mountain", "multi-domain"} <= sections
    for name in sections:
        assert f"`missionplanner experiment {name}`" in text


def test_the_machine_is_told() -> None:
    """When and on what."""
    assert "cores" in machine()
    assert "numpy" in machine()


@pytest.mark.slow
def test_grids_are_searched_and_planned(tmp_path: Path) -> None:
    """A small part of the experiment: tables, pictures, and grids as mission files."""
    figures = scenes_2d.main(tmp_path, quick=True, workers=2)
    assert {p.name for p in tmp_path.iterdir()} == {
        "runs.jsonl", "results.md", "sparse.csv", "dense.csv", "grid_sparse.yaml", "grid_dense.yaml", "paths.png",
        "fitness.png",
    }  # fmt: skip
    for name in ("sparse", "dense"):
        planner = figures[name]["algorithms"][-1]
        assert (planner["algorithm"], planner["all"], planner["paths"]) == (PLANNER, 2, 2)
        assert (tmp_path / "paths.png").stat().st_size < 150_000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mountain", "multi_domain"])
def test_scenes_are_searched_and_planned(tmp_path: Path, name: str) -> None:
    """One run of each: all that the planner found is clear, and what is written is whole."""
    experiment = {"mountain": mountain, "multi_domain": multi_domain}[name]
    figures = experiment.main(tmp_path, mission=mission_path(name), runs=1, workers=2)
    problem = figures["problems"][0] if name == "mountain" else figures
    planner = problem["algorithms"][-1]
    vehicles = len(resolved(mission_path(name).read_text(encoding="utf-8"))[0].tasks)
    assert (planner["algorithm"], planner["all"], planner["paths"]) == (PLANNER, vehicles, vehicles)
    if name == "mountain":
        assert figures["planner"]["excess"]["worst"] > 0.0
        assert 0.0 < figures["planner"]["search_ms"]["once"] < figures["planner"]["cpu_ms_per_vehicle"]
    pictures = sorted(tmp_path.glob("*.png"))
    assert [p.name for p in pictures] == ["above.png", "fitness.png", "pitch.png", "scene.png", "space.png"]
    assert all(p.stat().st_size < 150_000 for p in pictures)
    told = (tmp_path / "results.md").read_text(encoding="utf-8")
    assert all(f"({p.name})" in told for p in pictures)
