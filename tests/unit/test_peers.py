"""Searches of other libraries are counted exactly, whatever they do with budgets; and ours beside them.

Those of libraries that are not installed are skipped: all run after ``pip install 'missionplanner[peers]'``.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missionplanner.errors import MissionError
from missionplanner.experiments import contenders, peers
from missionplanner.experiments.contenders import PEERS, BudgetSpent, Contender, Tally, find_contender, ours
from missionplanner.experiments.peers import Results, Run

LOWER, UPPER = np.full(3, -4.0), np.array([6.0, 5.0, 7.0])


def bowl(points: np.ndarray) -> np.ndarray:
    assert points.ndim == 2
    assert np.all((points >= LOWER) & (points <= UPPER)), "priced outside the box"
    return ((points - [1.0, -1.0, 2.0]) ** 2).sum(axis=1)


class Recorder:
    """A price that remembers all that it was asked."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []

    def __call__(self, points: np.ndarray) -> np.ndarray:
        self.rows += list(points.copy())
        return bowl(points)


@given(st.lists(st.integers(1, 9), min_size=1, max_size=12), st.integers(1, 40), st.integers(0, 2**32))
def test_the_count_is_exact(batches: list[int], budget: int, seed: int) -> None:
    """However it is asked, a tally prices the first points up to its budget, and its best is the best of those."""
    rng = np.random.default_rng(seed)
    asked = [rng.uniform(-6.0, 8.0, (size, 3)) for size in batches]
    record = Recorder()
    tally = Tally(record, LOWER, UPPER, budget)
    ended = False
    for points in asked:
        try:
            np.testing.assert_array_equal(tally.batch(points), bowl(np.clip(points, LOWER, UPPER)))
        except BudgetSpent:
            ended = True
            break
    everything = np.clip(np.concatenate(asked), LOWER, UPPER)
    within = everything[:budget]
    assert ended == tally.spent == (len(everything) > budget)
    assert tally.used == len(record.rows) == len(within)
    np.testing.assert_array_equal(record.rows, within)
    assert tally.cost == bowl(within).min()
    np.testing.assert_array_equal(tally.best, within[np.argmin(bowl(within))])


@given(st.integers(0, 2**32), st.integers(1, 30))
def test_points_one_by_one_are_counted_as_a_batch_is(seed: int, budget: int) -> None:
    """Also those without a price, which are told as a large number."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-6.0, 8.0, (20, 3))

    def price(rows: np.ndarray) -> np.ndarray:
        return np.where(rows[:, 0] > 2.0, np.nan, bowl(rows))

    alone, together = Tally(price, LOWER, UPPER, budget), Tally(price, LOWER, UPPER, budget)
    told: list[float] = []
    with suppress(BudgetSpent):
        for point in points:
            told += [alone.single(point)]
    with suppress(BudgetSpent):
        np.testing.assert_array_equal(told, together.batch(points))
    assert np.isfinite(told).all()
    assert (alone.used, alone.cost, alone.spent) == (together.used, together.cost, together.spent)
    np.testing.assert_array_equal(alone.best, together.best)
    assert alone.curve[-1:] == [] or alone.curve[-1][::2] == together.curve[-1][::2]


def test_the_curve_falls_to_the_cost_at_the_evaluation_that_found_it() -> None:
    costs = np.array([5.0, 7.0, 3.0, np.nan, 3.0, 1.0, np.inf, 2.0])
    given_costs = iter(costs)
    tally = Tally(lambda points: [next(given_costs) for _ in points], LOWER, UPPER, 8)
    for size in (1, 4, 3):
        tally.batch(np.zeros((size, 3)))
    used, _, cost = zip(*tally.curve, strict=True)
    assert used == (1, 3, 6)
    assert cost == (5.0, 3.0, 1.0)
    assert not tally.spent
    with pytest.raises(BudgetSpent):
        tally.single(np.zeros(3))
    assert tally.spent


def test_time_ends_a_search_too() -> None:
    now = iter(range(100))
    tally = Tally(bowl, LOWER, UPPER, 1000, seconds=5.0, clock=lambda: float(next(now)))
    with pytest.raises(BudgetSpent):
        for _ in range(50):
            tally.single(np.zeros(3))
    assert 1 <= tally.used <= 5


@pytest.mark.parametrize("contender", [*PEERS, *ours()[:2]], ids=lambda c: c.name)
@pytest.mark.parametrize("nothing", [np.nan, np.inf])
@pytest.mark.filterwarnings("ignore")  # of other libraries
def test_points_without_a_price_end_nobody(contender: Contender, nothing: float) -> None:
    """A third of the box, from the first point on."""
    if not contender.installed:
        pytest.skip(f"{contender.library} is not installed: {contenders.INSTALL}")

    def price(points: np.ndarray) -> np.ndarray:
        return np.where(points[:, 0] > 2.0, nothing, bowl(points))

    tally = contender.run(price, LOWER, UPPER, evaluations=613, seed=5)
    assert tally.used == 613
    assert tally.best[0] <= 2.0
    assert np.isfinite(tally.cost)


@pytest.mark.parametrize("contender", [*PEERS, *ours()[:2]], ids=lambda c: c.name)
@pytest.mark.filterwarnings("ignore")  # of other libraries
def test_everybody_keeps_to_the_budget_and_repeats(contender: Contender) -> None:
    """And learns: better than random points, a sixth as many. The budget is no multiple of any population."""
    if not contender.installed:
        pytest.skip(f"{contender.library} is not installed: {contenders.INSTALL}")
    found = []
    for _ in range(2):
        record = Recorder()
        tally = contender.run(record, LOWER, UPPER, evaluations=613, seed=5)
        assert tally.used == len(record.rows) == 613, "nobody has an early end of its own, or it is switched off"
        assert tally.cost == bowl(np.array(record.rows)).min() == bowl(tally.best[None])[0]
        found.append(record.rows)
    np.testing.assert_array_equal(found[0], found[1])
    random = np.random.default_rng(5).uniform(LOWER, UPPER, (100, 3))
    assert tally.cost < bowl(random).min()
    other = contender.run(bowl, LOWER, UPPER, evaluations=613, seed=6)
    assert not np.array_equal(other.best, tally.best) or other.cost == 0.0


def test_an_error_of_the_function_is_not_taken_for_the_end() -> None:
    def broken(points: np.ndarray) -> np.ndarray:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        find_contender("scipy DE").run(broken, LOWER, UPPER, evaluations=100, seed=1)


def test_who_is_absent_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    absent = Contender("nowhere X", "no-such-library", find_contender("scipy DE").search)
    assert not absent.installed
    with pytest.raises(MissionError, match=r"nowhere X: expected no-such-library.*missionplanner\[peers\]"):
        absent.run(bowl, LOWER, UPPER, evaluations=10, seed=1)
    with pytest.raises(MissionError, match="did you mean"):
        find_contender("pso-abc")
    monkeypatch.setattr(contenders, "_version", lambda _library: "1.0")  # installed, and broken
    with pytest.raises(MissionError, match=r"no-such-library: expected a library that can be imported, got: No module"):
        absent.run(bowl, LOWER, UPPER, evaluations=10, seed=1)


def test_digests_tell_algorithms_and_settings_apart() -> None:
    """Each its own: rerunning one after a change leaves the runs of all others valid."""
    present = [c for c in (*ours(), *PEERS) if c.installed]
    digests = [c.digest() for c in present]
    assert digests == [c.digest() for c in present]
    assert len(set(digests)) == len({repr(c.search) for c in present})


def test_digests_are_of_code_not_of_who_takes_part(tmp_path: Path) -> None:
    """All that a result may depend on counts; the table of peers, comments and documents do not."""
    source = Path(contenders.__file__).read_text(encoding="utf-8")
    code = contenders.code_of("missionplanner.experiments.contenders", without="PEERS")
    assert "_LONG = 30000" in code
    assert "class Tally" in code
    assert "LSHADE" not in code
    assert "LSHADE" in source
    assert "#" not in code
    assert '"""' not in code
    maps = tmp_path / "maps"
    instance(maps)
    asked = peers.problem("uav", str(maps / "small.npz"))
    assert asked.digest() != replace(asked, modules=()).digest()


# --- the experiment ----------------------------------------------------------------------------------------------


def instance(folder: Path) -> None:
    """Write a small map with two cylinders between its ends."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(3)
    np.savez(
        folder / "small.npz",
        H=rng.uniform(0.0, 3.0, (200, 200)),
        threats=np.array([[100.0, 100.0, 100.0, 20.0], [60.0, 90.0, 100.0, 15.0]]),
        start=np.array([20.0, 20.0, 150.0]),
        end=np.array([180.0, 180.0, 150.0]),
    )


def made(costs: dict[str, list[float]], free: bool = True, known: float = np.inf) -> Results:
    """Return results of one instance by given costs of contenders."""
    runs = {
        ("inst", name, 100): tuple(
            Run(c, free, 100, 0.5, ((1, 0.01, 2 * c), (50, 0.02, c)), "a processor", "2026-01-02") for c in values
        )
        for name, values in costs.items()
    }
    return Results((), ("inst",), tuple(find_contender(name) for name in costs), (), None, {"inst": known}, runs)


def test_gaps_are_over_the_best_of_all_runs() -> None:
    results = made({"pso-abc-sa": [100.0, 110.0, 120.0], "scipy DE": [150.0, 160.0, 200.0]})
    first, second = peers.summary(results, ["inst"], 100)
    assert (first["contender"], second["contender"]) == ("pso-abc-sa", "scipy DE")
    assert (first["gap_median_percent"], first["gap_worst_percent"]) == pytest.approx((10.0, 20.0))
    assert second["gap_mean_percent"] == pytest.approx(70.0)
    assert (first["rank"], second["rank"]) == (1.0, 2.0)
    assert second["p_holm"] == pytest.approx(0.0495, abs=1e-4)  # three below three: 4.5 / sqrt(5.25) deviations
    assert first["gap_median_interval_percent"] == [0.0, pytest.approx(20.0)]
    assert first["cpu_s_per_10000"] == pytest.approx(50.0)
    assert peers.as_json(results)["instances"][0]["best_peer"] == "scipy DE"


def test_what_was_known_before_counts_as_best() -> None:
    row = peers.summary(made({"pso-abc-sa": [100.0, 100.0]}, known=50.0), ["inst"], 100)[0]
    assert row["gap_median_percent"] == pytest.approx(100.0)


def test_the_verdict_is_against_every_other() -> None:
    costs = {"pso-abc-sa": [110.0, 110.0], "pso-abc-sa-paper": [100.0, 100.0], "scipy DE": [112.0, 112.0]}
    found = peers.verdict(peers.summary(made(costs), ["inst"], 100))
    assert found is not None
    assert (found["lowest_gap"], found["most_free"], found["nearest"]) == (True, False, "scipy DE")
    assert "median gap 10.00 %, free 100 %; of the others run scipy DE has the lowest gap, 12.00 %" in found["words"]
    assert peers.verdict(peers.summary(made({"pso-abc-sa": [1.0]}), ["inst"], 100)) is None


def test_the_verdict_names_who_was_not_run() -> None:
    results = made({"pso-abc-sa": [110.0, 110.0], "scipy DE": [112.0, 112.0]})
    late = find_contender("scipy dual annealing")
    absent = Contender("nowhere X", "no-such-library", late.search)
    results = replace(results, contenders=(*results.contenders, late), absent=(absent,))
    found = peers.as_json(results)["uav"][0]["verdict"]
    assert found["left_out"] == ["scipy dual annealing", "nowhere X"]
    assert found["words"].endswith("Not run: scipy dual annealing, nowhere X.")


def test_runs_of_different_machines_are_told_and_their_times_are_not() -> None:
    results = made({"pso-abc-sa": [110.0, 110.0], "scipy DE": [112.0, 112.0]})
    text = peers.table(results)
    assert "Runs of 2026-01-02 on a processor, a thread each" in text
    assert "processor s per 10,000" in text
    first, second = results.runs["inst", "scipy DE", 100]
    other = (first, replace(second, machine="another", date="2026-03-04"))
    mixed = peers.table(replace(results, runs={**results.runs, ("inst", "scipy DE", 100): other}))
    assert "Runs from 2026-01-02 to 2026-03-04 of 2 machines (a processor; another)" in mixed
    assert "processor s per 10,000" not in mixed
    assert "Times are left out" in mixed
    table = [line.count("|") for line in mixed.splitlines() if line.startswith("|")]
    assert len({*table[:4]}) == 1


def test_a_small_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ours and SciPy on a map and a scene; asked again nothing is run; who is absent or slow is told."""
    instance(tmp_path / "maps")
    monkeypatch.setattr(peers, "_SLOW_FROM", 400)
    absent = Contender("nowhere X", "no-such-library", find_contender("scipy DE").search)
    slow = replace(find_contender("scipy dual annealing"), slow=True)
    who = [find_contender("pso-abc-sa"), find_contender("scipy DE"), absent, slow]
    out = tmp_path / "out"

    def again() -> Results:
        return peers.run(out, who, instances=tmp_path / "maps", scenes=[], budgets=(300, 500), seeds=2, workers=1)

    results = again()
    kept = (out / "runs.jsonl").read_bytes()
    assert [c.name for c in results.absent] == ["nowhere X"]
    assert [c.name for c in results.who(["small"], 500)] == ["pso-abc-sa", "scipy DE"]
    assert [c.name for c in results.who(["small"], 300)] == ["pso-abc-sa", "scipy DE", "scipy dual annealing"]
    assert again().runs == results.runs
    assert (out / "runs.jsonl").read_bytes() == kept
    for (name, _, budget), runs in results.runs.items():
        for one in runs:
            assert one.evaluations <= budget
            used, _, cost = zip(*one.curve, strict=True)
            assert cost[-1] == one.cost
            assert used[-1] <= one.evaluations
            assert list(cost) == sorted(cost, reverse=True)
            assert one.cost >= results.best(name)
    peers._write(out, results)
    text = (out / "results.md").read_text(encoding="utf-8")
    assert "left out of the long budget (--slow-peers): scipy dual annealing" in text
    assert "Not installed, left out: nowhere X" in text
    assert {p.name for p in out.iterdir()} == {"runs.jsonl", "peers.csv", "results.md", "gap.png"}
    told = peers.as_json(results)
    assert json.loads(json.dumps(told, allow_nan=False)) == told


def test_time_is_the_same_for_everybody(tmp_path: Path) -> None:
    """A timed search ends at its time, by a clock that runs a millisecond whenever it is read."""
    instance(tmp_path)
    source = {"kind": "uav", "text": str(tmp_path / "small.npz")}
    readings = 0

    def clock() -> float:
        nonlocal readings
        readings += 1
        return 1e-3 * readings

    told = peers.search(source, "pso-abc-sa", 0, 0.2, 1, clock)
    assert told["evaluations"] > 0
    assert told["curve"][-1][1] <= 0.2
    assert 0.2 <= told["cpu_s"] <= 0.21
    with pytest.raises(MissionError, match=r"--seconds: expected time for one evaluation at least, got 0\.001"):
        peers.search(source, "pso-abc-sa", 0, 0.001, 1, clock)
    for seconds in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(MissionError, match="--seconds: expected a time above 0"):
            peers.run(tmp_path / "o", [], instances=tmp_path, scenes=[], budgets=(), seeds=1, seconds=seconds)
    with pytest.raises(MissionError, match="on this machine"):
        peers.run(
            tmp_path / "o",
            [],
            instances=tmp_path,
            scenes=[],
            budgets=(),
            seeds=1,
            seconds=1.0,
            cluster="tcp://localhost:1",
        )


def test_scenes_are_searched_as_the_paper_poses_them(tmp_path: Path) -> None:
    """The first vehicle's control points; what is free touches neither ground nor obstacles."""
    mission = Path("missions/mountain.yaml")
    asked = peers.problem("scene", mission.read_text(encoding="utf-8"))
    assert (asked.name, len(asked.lower)) == ("mountain", 30)
    start, goal = np.array([100.0, 20.0, 1500.0]), np.array([600.0, 450.0, 2000.0])
    straight = np.linspace(start, goal, 12)[1:-1]
    around = straight + np.sin(np.linspace(0.0, np.pi, 12))[1:-1, None] * np.array([60.0, -60.0, 0.0])
    assert not asked.free(straight.ravel())  # the straight way crosses a cylinder
    assert asked.free(around.ravel())
    assert asked.price(around.reshape(1, -1))[0] < asked.price(straight.reshape(1, -1))[0]


def test_wrong_input_is_told(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"expected a folder with instances \(\*\.npz\), found none"):
        peers.main(tmp_path / "out", instances=tmp_path)
    with pytest.raises(MissionError, match="expected numbers of at least 1, got 0"):
        peers.main(tmp_path / "out", scenes=[Path("missions/mountain.yaml")], budgets=[0, 10])
    with pytest.raises(MissionError, match="expected something to search"):
        peers.main(tmp_path / "out")
    mission = Path("missions/mountain.yaml")
    (tmp_path / "maps").mkdir()
    instance(tmp_path / "maps")
    (tmp_path / "small.yaml").write_text(mission.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(MissionError, match=r"different names, got .*small\.npz and .*small\.yaml"):
        peers.main(tmp_path / "out", instances=tmp_path / "maps", scenes=[tmp_path / "small.yaml"])
