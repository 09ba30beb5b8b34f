"""The UAV objective from a graph search of itself: by laws, by brute force, and by what is counted."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from missionplanner.errors import MissionError
from missionplanner.experiments import uav_graph, uav_objective, uav_search, uav_weaving
from missionplanner.experiments.uav_graph import decoded, encoded, lattice_routes
from missionplanner.experiments.uav_objective import Instance
from missionplanner.experiments.uav_weaving import METHODS, search
from missionplanner.geodesy import FloatArray

BENCH = Path(__file__).parents[3] / "shared" / "bench" / "instances"
KNOWN_BEFORE = {"inst01": 5_982.0, "inst04": 5_688.0, "inst12": 5_664.0}
SIZE = 260
START, END = np.array([22.0, 20.0, 150.0]), np.array([236.0, 228.0, 150.0])


@pytest.fixture(autouse=True)
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lay coarser lattices: these maps are small."""
    monkeypatch.setattr(uav_graph, "_CELLS", 50)


def made(seed: int, *, relief_m: float = 60.0, threats: int = 6, vectors: int = 10) -> Instance:
    """Return a small instance: smooth noise for ground, and discs that leave both ends free."""
    rng = np.random.default_rng(seed)
    noise = gaussian_filter(rng.normal(size=(SIZE, SIZE)), 12.0)
    discs: list[list[float]] = []
    while len(discs) < threats:
        x, y, radius = rng.uniform(30, SIZE - 30), rng.uniform(30, SIZE - 30), rng.uniform(10, 25)
        if min(math.dist((x, y), end[:2]) for end in (START, END)) > radius + 15.0:
            discs.append([x, y, 0.0, radius])
    table = np.array(discs).reshape(-1, 4)
    return uav_objective.make("made", relief_m * noise / noise.std(), table, START, END, vectors=vectors)


def barred(heights: FloatArray, discs: Sequence[Sequence[float]]) -> Instance:
    return uav_objective.make("barred", heights, np.array(discs, dtype=float).reshape(-1, 4), START, END)


def weave(instance: Instance, places: FloatArray) -> tuple[FloatArray, float, int]:
    path = np.empty((len(places) + 2, 3))
    price, legs = uav_graph.woven(np.ascontiguousarray(places), instance.arrays, float(instance.upper[0]), path)
    return path, price, legs


def points(instance: Instance, rng: np.random.Generator, count: int, share: float = 0.5) -> FloatArray:
    """Return random points (P, D) of the box whose paths stay on the map."""
    unit = rng.random((count, instance.dimensions))
    unit[:, 0::3] = share * (0.05 + 0.95 * unit[:, 0::3])
    return instance.lower + unit * (instance.upper - instance.lower)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=60)
def test_a_path_of_the_box_is_encoded_and_decoded_as_itself(seed: int) -> None:
    rng = np.random.default_rng(seed)
    instance = made(int(rng.integers(5)))
    paths = decoded(instance, points(instance, rng, 8))
    on_map = (paths[..., :2] > 1.0).all(axis=(1, 2)) & (paths[..., :2] < SIZE - 1.0).all(axis=(1, 2))
    again = decoded(instance, encoded(instance, paths))
    np.testing.assert_allclose(again[on_map], paths[on_map], rtol=0.0, atol=1e-8)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 500.0))
@settings(deadline=None, max_examples=60)
def test_any_path_is_encoded_into_the_box_and_its_first_waypoint_as_near_as_the_box_comes(
    seed: int, far_m: float
) -> None:
    rng = np.random.default_rng(seed)
    instance = made(1)
    path = np.linspace(START, END, 12)[None] + far_m * rng.normal(size=(1, 12, 3))
    point = encoded(instance, path)
    assert (point >= instance.lower).all()
    assert (point <= instance.upper).all()
    first = decoded(instance, point)[0, 1]
    others = decoded(instance, instance.lower + rng.random((200, 30)) * (instance.upper - instance.lower))[:, 1]
    level = np.hypot(*(others[:, :2] - path[0, 1, :2]).T)
    if abs(path[0, 1, 2] - START[2]) < 1e-9:  # then no height is traded for nearness in plan
        assert math.dist(first[:2], path[0, 1, :2]) <= level.min() + 1e-6


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=60)
def test_legs_and_corners_add_up_to_the_objective(seed: int) -> None:
    rng = np.random.default_rng(seed)
    instance = made(int(rng.integers(5)), relief_m=float(rng.choice([5.0, 80.0])))
    x = points(instance, rng, 6)
    for path, price, terms in zip(decoded(instance, x), instance.price(x), instance.terms(x), strict=True):
        again, total, legs = weave(instance, path[1:-1, None])
        if not legs:  # cut by the map's edge, so that its steps are not in the box as they are
            continue
        if math.isinf(total):
            assert ((path[:, :2] <= 1.0) | (path[:, :2] >= SIZE - 1e-9)).any()
            continue
        np.testing.assert_array_equal(again, path)
        if terms[uav_objective.TERMS.index("ground")] == 0.0:
            assert total == pytest.approx(price, rel=1e-9)
        else:  # which is paid once there, and leg by leg here
            assert total >= price - 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_weaving_finds_the_cheapest_of_all_paths_through_its_places(seed: int) -> None:
    rng = np.random.default_rng(seed)
    instance = made(seed, relief_m=20.0, vectors=5)
    middle = np.linspace(START, END, 7)
    places = middle[1:-1, None] + np.array([1.0, 1.0, 0.3]) * rng.normal(0.0, 12.0, (5, 4, 3))
    places[..., 2] = np.clip(places[..., 2], 100.0, 200.0)
    every = np.array([np.stack(choice) for choice in itertools.product(*places)])
    ends = np.ones((len(every), 1, 1))
    every = np.concatenate([ends * START, every, ends * END], axis=1)
    x = encoded(instance, every)
    in_box = np.abs(decoded(instance, x) - every).max(axis=(1, 2)) < 1e-9
    assert in_box.sum() > 20, "too few paths to choose from"
    path, price, legs = weave(instance, places)
    assert price == pytest.approx(instance.price(x)[in_box].min(), rel=1e-9)
    np.testing.assert_array_equal(path, every[in_box][np.argmin(instance.price(x)[in_box])])
    assert legs <= 4 + 4 * 16 + 4


@pytest.mark.parametrize("seed", range(6))
def test_first_guesses_are_free_of_penalties_and_nearly_as_cheap_as_can_be(seed: int) -> None:
    instance = made(seed, threats=10)
    routes = lattice_routes(instance, routes=6, rng=np.random.default_rng(seed))
    x = encoded(instance, routes.paths)
    np.testing.assert_allclose(decoded(instance, x), routes.paths, atol=1e-8)
    assert instance.free(x[:1]).all()
    assert instance.price(x)[0] == pytest.approx(instance.price(x).min(), rel=0.05)  # turns are not seen
    blind = search(instance, method="black", evaluations=4_000, seed=seed)
    assert instance.price(x).min() < 1.02 * blind.price


def test_over_a_plain_the_way_is_straight() -> None:
    instance = barred(np.zeros((SIZE, SIZE)), [])
    straight = 5.0 * math.dist(START, END)
    routes = lattice_routes(instance, routes=3, rng=np.random.default_rng(0))
    assert straight <= instance.price(encoded(instance, routes.paths))[0] < 1.005 * straight
    assert straight <= search(instance, method="grey", evaluations=2_500, seed=0).price < 1.0001 * straight


def test_past_one_disc_the_way_is_a_tangent() -> None:
    # Off the disc by all that costs something, and by nothing more: tangents and the arc between them.
    radius, middle = 40.0, 0.5 * (START + END)
    instance = barred(np.zeros((SIZE, SIZE)), [(middle[0], middle[1], 0.0, radius)])
    half = 0.5 * math.dist(START, END)
    taut = [2.0 * (math.sqrt(half**2 - r**2) + r * math.asin(r / half)) for r in (radius + 1.0, radius + 11.0)]
    found = search(instance, method="grey", evaluations=5_000, seed=0)
    assert instance.free(found.point[None])[0]
    assert 5.0 * taut[0] < found.price < 5.0 * taut[1] * 1.005


def test_routes_go_through_every_gap_of_a_wall() -> None:
    flat = np.zeros((SIZE, SIZE))
    across = [(x, 250.0 - x) for x in np.arange(0.0, 260.0, 12.0)]
    gaps = [(180.0, 70.0), (70.0, 180.0)]
    wall = [(x, y, 0.0, 12.0) for x, y in across if min(math.dist((x, y), gap) for gap in gaps) > 30.0]
    instance = barred(flat, wall)
    routes = lattice_routes(instance, routes=4, rng=np.random.default_rng(0))
    x = encoded(instance, routes.paths)
    free = routes.paths[instance.free(x)]
    along = np.linspace(0.0, 1.0, 50)[:, None]
    lines = [np.concatenate([a + along * (b - a) for a, b in itertools.pairwise(path)]) for path in free]
    for gap in gaps:
        assert min(np.hypot(*(line[:, :2] - gap).T).min() for line in lines) < 25.0


def test_a_step_in_the_ground_is_climbed_close_to_it() -> None:
    y, x = np.mgrid[1 : SIZE + 1, 1 : SIZE + 1]
    instance = barred(np.where(x + y > SIZE, 400.0, 0.0), [])
    routes = lattice_routes(instance, routes=3, rng=np.random.default_rng(0))
    assert instance.free(encoded(instance, routes.paths))[0]


def test_where_no_path_is_free_a_guess_is_given_all_the_same() -> None:
    instance = barred(
        np.zeros((SIZE, SIZE)), [(130.0, 130.0, 0.0, 90.0), (60.0, 200.0, 0.0, 90.0), (200.0, 60.0, 0.0, 90.0)]
    )
    found = search(instance, method="grey", evaluations=200, seed=0)
    assert math.isfinite(found.price)
    assert not instance.free(found.point[None])[0]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("evaluations", [1, 7, 60, 700])
def test_no_search_takes_more_than_it_says(method: str, evaluations: int, monkeypatch: pytest.MonkeyPatch) -> None:
    instance = made(3)
    routes = uav_weaving.first_guesses(instance, 5)
    rows = legs = 0
    price, woven = Instance.price, uav_graph.woven

    def priced(self: Instance, x: npt.ArrayLike, threads: int = 1) -> FloatArray:
        nonlocal rows
        rows += len(np.asarray(x))
        return price(self, x, threads)

    def counted(*arguments: Any) -> tuple[float, int]:
        nonlocal legs
        total, more = woven(*arguments)
        legs += more
        return total, more

    monkeypatch.setattr(Instance, "price", priced)
    monkeypatch.setattr("missionplanner.experiments.uav_weaving.woven", counted)
    found = search(instance, method=method, evaluations=evaluations, seed=5, routes=routes)
    spent = rows + legs / 11
    assert spent <= found.evaluations <= evaluations
    if evaluations >= 60:
        assert spent > 0.5 * evaluations
    assert found.price == price(instance, found.point[None])[0]
    steps, prices = np.array(found.curve).T
    assert (np.diff(steps) >= 0).all()
    assert (np.diff(prices) < 0.0).all()
    assert prices[-1] == pytest.approx(found.price, rel=1e-12)


def test_the_same_seed_finds_the_same_path_and_another_seed_another() -> None:
    instance = made(2)
    one, two, other = (search(instance, method="grey", evaluations=500, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.point, two.point)
    assert one.curve == two.curve
    assert not np.array_equal(one.point, other.point)


@pytest.mark.parametrize("seed", range(3))
def test_weaving_improves_what_a_swarm_leaves_of_the_same_guesses(seed: int) -> None:
    instance = made(seed, threats=10)
    guessed, grey = (search(instance, method=m, evaluations=2_500, seed=seed).price for m in ("guessed", "grey"))
    assert grey < guessed


@pytest.mark.parametrize("name", KNOWN_BEFORE)
def test_instances_of_the_benchmark_at_2500_evaluations(name: str) -> None:
    if not (BENCH / f"{name}.npz").exists():
        pytest.skip("the benchmark's instances are not here")
    instance = uav_objective.load(BENCH / f"{name}.npz")
    found = search(instance, method="grey", evaluations=2_500, seed=1)
    assert instance.free(found.point[None])[0]
    assert found.price < 1.01 * KNOWN_BEFORE[name]


# --- the experiment --------------------------------------------------------------------------------------------------


def saved(folder: Path, **instances: Instance) -> Path:
    folder.mkdir()
    for name, instance in instances.items():
        m = instance.arrays
        np.savez(folder / f"{name}.npz", H=m.height_m, threats=m.threat, start=m.start, end=m.end)
    return folder


def test_the_experiment_tells_gaps_against_the_best_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    instances = saved(tmp_path / "in", hills=made(0), plain=made(1, relief_m=5.0, threats=0))
    best = tmp_path / "best.json"
    best.write_text(json.dumps({"hills": 100.0}))
    arguments: dict[str, Any] = {"instances": instances, "seeds": 1, "evaluations": (300, 60), "best": best}
    figures = uav_search.main(tmp_path / "out", workers=1, **arguments)
    assert figures["best_known"]["hills"] == 100.0
    assert figures["best_of_this_run"] == ["plain"]
    plain = {(row["evaluations"], row["method"]): row for row in figures["instances"]["plain"]}
    assert set(plain) == set(itertools.product((60, 300), METHODS))
    assert plain[300, "grey"]["gap_median"] < plain[300, "black"]["gap_median"]
    assert min(row["gap_median"] for row in figures["instances"]["hills"]) > 100.0  # in per cent
    assert figures["graph"]["hills"]["evaluations"] == pytest.approx(figures["graph"]["hills"]["legs"] / 11, abs=1.0)
    text = (tmp_path / "out" / "results.md").read_text()
    assert "| hills | 100.0 |" in text
    assert text.count("(of these runs)") == 2  # plain, at both numbers of evaluations
    assert text.count(" worth of legs of the graph)") == 2  # in the headings of both
    assert "Runs of " in text
    for picture in ("gaps.png", "paths.png"):
        assert (tmp_path / "out" / picture).read_bytes().startswith(b"\x89PNG")
    rows = (tmp_path / "out" / "runs.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 2 * len(METHODS)

    monkeypatch.setattr(uav_search, "run", None)  # nothing is run again
    assert uav_search.main(tmp_path / "out", workers=1, **arguments) == figures


def test_a_file_of_best_values_hides_none_that_is_better(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    instances = saved(tmp_path / "in", one=made(0))
    monkeypatch.setattr(uav_search, "BEST_KNOWN", {uav_search.digest(uav_objective.load(instances / "one.npz")): 50.0})
    best = tmp_path / "best.json"
    for told, counts in ((70.0, 50.0), (30.0, 30.0)):
        best.write_text(json.dumps({"one": told}))
        found = uav_search.measure(tmp_path / "out", instances, 1, (5,), best=best, workers=1)
        assert found.best["one"] == counts


def test_the_planners_guesses_are_in_the_box_and_go_around(tmp_path: Path) -> None:
    """Past a wall of cylinders, within the box; where an end is too near to a cylinder there are none."""
    wall = [[130.0 + 3.0 * k, 130.0 - 3.0 * k, 0.0, 12.0] for k in (-10, -5, 0, 5, 10)]
    instance = barred(np.zeros((SIZE, SIZE)), wall)
    found = uav_weaving.planned_guesses(instance)
    assert found is not None
    assert ((found >= instance.lower) & (found <= instance.upper)).all()
    paths = instance.waypoints_m(found)
    away = np.linalg.norm(paths[:, :, None, :2] - np.array(wall)[:, :2], axis=-1).min(axis=(1, 2))
    assert (away > 12.0).all()
    assert uav_weaving.planned_guesses(barred(np.zeros((SIZE, SIZE)), [[30.0, 20.0, 0.0, 6.0]])) is None


def test_an_instance_is_known_by_its_content() -> None:
    assert uav_search.digest(made(0)) == uav_search.digest(made(0))
    assert uav_search.digest(made(0)) != uav_search.digest(made(1))
    for name, path in ((p.stem, p) for p in BENCH.glob("*.npz")):
        assert uav_search.digest(uav_objective.load(path)) in uav_search.BEST_KNOWN, name


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"instances": Path("nowhere")}, "nowhere: expected a folder of instances"),
        ({"evaluations": (0,)}, "evaluations: expected numbers of at least 1"),
        ({"evaluations": ()}, "evaluations: expected numbers of at least 1"),
        ({"best": Path("none.json")}, "none.json: expected JSON of best values"),
        ({"best": {"one": 0.0}}, "one: expected a number above 0, got 0"),
        ({"best": {"one": math.inf}}, "one: expected a number above 0, got inf"),
    ],
)
def test_wrong_input_is_told_in_one_line(tmp_path: Path, change: dict[str, Any], told: str) -> None:
    instances = saved(tmp_path / "in", one=made(0))
    arguments = {"instances": instances, "seeds": 1, "evaluations": (10,), **change}
    if isinstance(arguments.get("best"), dict):
        (tmp_path / "best.json").write_text(json.dumps(arguments["best"]))
        arguments["best"] = tmp_path / "best.json"
    with pytest.raises(MissionError, match=told) as error:
        uav_search.main(tmp_path / "out", **arguments)
    assert "\n" not in str(error.value)
