"""Shortest paths over the UAV objective's instances: what is kept of an instance, and the experiment as a whole."""

import json
import math
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.experiments import lengths
from missionplanner.experiments.uav_scene import UavScene, load_scene, uav_scene
from tests.oracles.tangent_graph import shortest_m

MOUNTAIN = Path(__file__).parents[2] / "missions" / "mountain.yaml"
SIZE = 200
THREATS = np.array([[60.0, 70.0, 0.0, 25.0], [120.0, 100.0, 0.0, 30.0], [150.0, 160.0, 0.0, 15.0]])
START, END = np.array([20.0, 30.0, 150.0]), np.array([180.0, 170.0, 130.0])


def hills() -> np.ndarray:
    """A slope that is bilinear, so that both surfaces are one, with a single peak of one sample."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(float)
    return 0.2 * x + 0.1 * y


def write(folder: Path, heights: np.ndarray) -> Path:
    np.savez(folder / "inst99.npz", H=heights, threats=THREATS, start=START, end=END)
    return folder / "inst99.npz"


def test_an_instance_as_a_space(tmp_path: Path) -> None:
    heights = hills()
    scene = load_scene(write(tmp_path, heights), threat_margin_m=1.0)
    np.testing.assert_allclose(scene.start_m, [20.0, 30.0, 150.0 + heights[29, 19]])
    np.testing.assert_allclose(scene.goal_m, [180.0, 170.0, 130.0 + heights[169, 179]])
    np.testing.assert_allclose(scene.space.obstacles.params[:, :3], THREATS[:, [0, 1, 3]])
    assert scene.space.obstacles.params[:, 3].tolist() == [math.inf] * 3


def leg(scene: UavScene, a: tuple[float, float, float], b: tuple[float, float, float]) -> bool:
    return bool(scene.clear(np.array([[a, b]]))[0])


def test_both_surfaces_and_the_threats_are_asked() -> None:
    heights = np.full((SIZE, SIZE), -5.0)
    heights[:, 40:44] = 8.0, 0.0, 0.0, 8.0  # between the middle two: bilinear 0 m, bicubic -1 m
    heights[:, 60:62] = 8.0  # between these: bilinear 8 m, bicubic 9.6 m
    scene = uav_scene(heights, THREATS, START, END)
    for x, alt_m, clear in ((41.5, 0.1, True), (41.5, -0.5, False), (60.5, 9.7, True), (60.5, 9.0, False)):
        assert leg(scene, (x, 110, alt_m), (x, 130, alt_m)) == clear
    assert leg(scene, (85.1, 40, 50), (85.1, 100, 50)) != leg(scene, (84.9, 40, 50), (84.9, 100, 50))
    assert not leg(scene, (20, 100, 20), (20, 199.5, 20))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"heights_m": np.zeros((3, 3))}, "heights: expected a finite grid of at least 4 x 4"),
        ({"threats": np.zeros((2, 3))}, "threats: expected rows of x, y, z and radius"),
        ({"start": (0.0, 5.0, 100.0)}, "start, end: expected x, y and height on a map of 199 x 199 m"),
        ({"start": (50.0, 50.0)}, "start, end: expected x, y and height of both"),
    ],
)
def test_no_instance(change: dict[str, object], message: str) -> None:
    fields = {"heights_m": np.zeros((SIZE, SIZE)), "threats": THREATS, "start": START, "end": END} | change
    with pytest.raises(MissionError, match="^" + message):
        uav_scene(**fields)  # type: ignore[arg-type]


def test_over_an_even_slope_the_shortest_path_is_that_among_discs(tmp_path: Path) -> None:
    path = write(tmp_path, hills())
    case = lengths._case(instance=str(path))
    level_m = shortest_m(tuple(START[:2]), tuple(END[:2]), [(x, y, r + 1.0) for x, y, _, r in THREATS.tolist()])
    exact_m = math.hypot(level_m, case.scene.goal_m[2] - case.scene.start_m[2])
    assert case.bound_m == pytest.approx(exact_m, abs=1e-6)
    for thorough in (False, True):
        found = lengths.shortest(case, thorough=thorough)
        assert case.judged(found)
        assert exact_m - 1e-6 <= lengths._length_m(found) <= exact_m * 1.0002


def test_rough_ground_is_kept_on_both_surfaces(tmp_path: Path) -> None:
    rough = np.random.default_rng(0).uniform(0.0, 12.0, (SIZE, SIZE)).cumsum(axis=0) * 0.2
    case = lengths._case(instance=str(write(tmp_path, rough)))
    assert case.judged(lengths.shortest(case, thorough=True))


def test_no_instances_in_the_folder(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"--instances: expected a folder with instances"):
        lengths.main(tmp_path / "out", mission=MOUNTAIN, instances=tmp_path)


def test_bounds_are_of_the_scene_not_of_its_name(tmp_path: Path) -> None:
    """The paper's known optima; a mission of the same name with another goal has another bound."""
    for margin_m, known_m in ((0.0, 827.904), (5.0, 828.333), (10.0, 839.680), (20.0, 850.937)):
        assert lengths._case(mission=str(MOUNTAIN), margin_m=margin_m).bound_m == pytest.approx(known_m, abs=1e-3)
    other = tmp_path / "mountain.yaml"
    other.write_text(MOUNTAIN.read_text().replace("goal: {x_m: 600, y_m: 450", "goal: {x_m: 600, y_m: 500"))
    bound_m = lengths._case(mission=str(other), margin_m=0.0).bound_m
    assert bound_m is not None
    assert bound_m > 840.0


def test_changed_files_are_other_problems(tmp_path: Path) -> None:
    mission = tmp_path / "m.yaml"
    mission.write_text(MOUNTAIN.read_text())
    instance = write(tmp_path, hills())
    before = lengths._contents(mission, tmp_path)
    assert set(before) == {str(mission), str(instance)}
    write(tmp_path, hills() + 1.0)
    moved = lengths._contents(mission, tmp_path)
    assert moved[str(instance)] != before[str(instance)]
    mission.write_text(MOUNTAIN.read_text() + "# another\n")
    assert lengths._contents(mission, tmp_path)[str(mission)] != before[str(mission)]


@pytest.mark.slow
def test_experiment_writes_tables_and_figures(tmp_path: Path) -> None:
    write(tmp_path, hills())
    figures = lengths.main(tmp_path / "out", mission=MOUNTAIN, instances=tmp_path, seeds=1, quick=True, workers=1)
    json.dumps(figures)
    assert set(figures["cases"]) == {"mountain, 0 m", "mountain, 10 m", "inst99"}
    for margin_m, known_m in ((0, 827.904), (10, 839.680)):
        run = figures["cases"][f"mountain, {margin_m} m"]["ours"][lengths.OURS]
        assert run["clear"]
        assert not run["lengths_differ"]
        assert known_m - 1e-3 < run["length_m"] <= known_m * 1.0001
    flight = figures["flight"]
    assert flight["bare_string_m"] < flight["string_m"] < flight["curve_m"] * (1.0 + 1e-9)
    text = (tmp_path / "out" / "results.md").read_text(encoding="utf-8")
    assert ("OMPL is not installed" in text) == (find_spec("ompl") is None)
    for name in ("growth.png", "inst99.png", "mountain__10_m.png", "lengths.csv"):
        assert (tmp_path / "out" / name).stat().st_size > 0
