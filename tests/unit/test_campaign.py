"""Campaigns: many runs through one executor, kept as they come, taken up again, and never mixed with others."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.experiments import campaign
from missionplanner.experiments.campaign import RUNS_NAME, Job, run, version_of

needs_dask = pytest.mark.skipif(
    importlib.util.find_spec("distributed") is None, reason="no dask.distributed: pip install 'missionplanner[cluster]'"
)


def square(x: int, log: str | None = None) -> dict[str, Any]:
    if log is not None:
        with Path(log).open("a", encoding="utf-8") as file:
            file.write(f"{x}\n")
    return {"x": x, "square": x * x, "root": math.sqrt(x), "never": math.inf, "pair": (x, x)}


def threads() -> dict[str, Any]:
    import numba  # noqa: PLC0415

    return {"threads": numba.config.NUMBA_NUM_THREADS}


def slow(x: int, started: str) -> dict[str, Any]:
    (Path(started) / str(x)).touch()
    time.sleep(0.3)
    return {"x": x}


def die(x: int) -> dict[str, Any]:
    os.kill(os.getpid(), signal.SIGKILL)
    return {"x": x}


def die_once(x: int, mark: str) -> dict[str, Any]:
    if not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"x": x}


def refuse(x: int) -> dict[str, Any]:
    raise InfeasibleError(f"no way to {x}")


def fail(x: int) -> dict[str, Any]:
    raise ValueError(f"a bug with {x}")


def squares(count: int, log: Path | None = None) -> list[Job]:
    return [Job(f"square/{x}", square, {"x": x, "log": None if log is None else str(log)}) for x in range(count)]


def runs(folder: Path) -> list[str]:
    return (folder / RUNS_NAME).read_text(encoding="utf-8").splitlines()


def test_the_number_of_workers_changes_nothing(tmp_path: Path) -> None:
    """The same results in the order of the jobs; progress rises to 1."""
    told: list[float] = []
    one = run(squares(5), tmp_path / "one", experiment="squares", version="1", workers=1)
    two = run(
        squares(5)[::-1],
        tmp_path / "two",
        experiment="squares",
        version="1",
        workers=2,
        progress=lambda _what, share: told.append(share),
    )
    assert one == two
    assert list(two) == list(one)[::-1]
    assert one["square/3"] == {"x": 3, "square": 9, "root": math.sqrt(3), "never": math.inf, "pair": [3, 3]}
    assert told == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


def test_workers_have_a_thread_each(tmp_path: Path) -> None:
    """Also where numba would use more: workers would be in each other's way."""
    found = run([Job("threads", threads, {})], tmp_path, experiment="threads", version="1", workers=2)
    assert found == {"threads": {"threads": 1}}


def test_an_ended_campaign_goes_on(tmp_path: Path) -> None:
    """What is known is not run again, a line that was cut short is; no run comes twice."""
    log = tmp_path / "log"
    whole = run(squares(4, log), tmp_path / "out", experiment="squares", version="1", workers=1)
    path = tmp_path / "out" / RUNS_NAME
    lines = runs(tmp_path / "out")
    path.write_text("\n".join([*lines[:3], lines[3][:25]]), encoding="utf-8")
    log.unlink()
    assert run(squares(4, log), tmp_path / "out", experiment="squares", version="1", workers=1) == whole
    assert log.read_text(encoding="utf-8").split() == ["2", "3"]
    assert len(runs(tmp_path / "out")) == 5
    assert run(squares(4, log), tmp_path / "out", experiment="squares", version="1") == whole
    assert log.read_text(encoding="utf-8").split() == ["2", "3"]


def test_other_results_are_refused(tmp_path: Path) -> None:
    """Of another experiment, another version, or no campaign at all: told, and left as they were."""
    run(squares(1), tmp_path, experiment="squares", version="1", workers=1)
    before = runs(tmp_path)
    with pytest.raises(MissionError, match=r"expected the runs of cubes, got those of squares: .*--output"):
        run(squares(1), tmp_path, experiment="cubes", version="1")
    with pytest.raises(MissionError, match=r"another version .*delete this file"):
        run(squares(1), tmp_path, experiment="squares", version="2")
    assert runs(tmp_path) == before
    (tmp_path / RUNS_NAME).write_text(f"{before[0]}\n", encoding="utf-8")
    assert run(squares(1), tmp_path, experiment="squares", version="2") == run(
        squares(1), tmp_path / "b", experiment="squares", version="2"
    )  # without runs there is nothing to mix
    (tmp_path / RUNS_NAME).write_text("anything\n", encoding="utf-8")
    with pytest.raises(MissionError, match="got another file"):
        run(squares(1), tmp_path, experiment="squares", version="1")
    with pytest.raises(MissionError, match="workers: expected at least 1"):
        run(squares(1), tmp_path / "new", experiment="squares", version="1", workers=0)
    (tmp_path / "odd" / RUNS_NAME).mkdir(parents=True)
    with pytest.raises(MissionError, match="expected a file that can be read, got: Is a directory"):
        run(squares(1), tmp_path / "odd", experiment="squares", version="1")


@pytest.mark.skipif(os.name != "posix", reason="folders are locked by fcntl")
def test_two_campaigns_at_once_do_not_share_a_folder(tmp_path: Path) -> None:
    """The second is refused while the first runs, not after; nor after it failed."""
    seen: list[str] = []

    def told(_what: str, done: float) -> None:
        if done < 1.0:
            with pytest.raises(MissionError, match="another experiment is at work"):
                run(squares(1), tmp_path, experiment="squares", version="1", workers=1)
            seen.append("refused")

    run(squares(2), tmp_path, experiment="squares", version="1", workers=1, progress=told)
    assert seen
    with pytest.raises(InfeasibleError):
        run([Job("no", refuse, {"x": 1})], tmp_path, experiment="squares", version="1", workers=1)
    run(squares(2), tmp_path, experiment="squares", version="1", workers=1)


def test_a_folder_belongs_to_one_experiment(tmp_path: Path) -> None:
    """Also of those that keep no runs; results of nobody known are not written over either."""
    campaign.claim(tmp_path / "none", "table3")
    campaign.claim(tmp_path, "table3")
    (tmp_path / "results.md").write_text("mine", encoding="utf-8")
    with pytest.raises(MissionError, match=r"one of experiment table3, got results of something else: .*--output"):
        campaign.claim(tmp_path, "table3")
    campaign.mark(tmp_path, "table3")
    campaign.claim(tmp_path, "table3")
    with pytest.raises(MissionError, match="one of experiment growth, got results of table3"):
        campaign.claim(tmp_path, "growth")
    run(squares(1), tmp_path / "runs", experiment="squares", version="1", workers=1)
    with pytest.raises(MissionError, match="one of experiment table3, got results of squares"):
        campaign.claim(tmp_path / "runs", "table3")
    campaign.claim(tmp_path / "runs", "squares")


def test_a_version_is_of_settings_and_source() -> None:
    """It changes with either, and with nothing else."""
    assert version_of({"seed": 1}) == version_of({"seed": 1})
    assert version_of({"seed": 1}) != version_of({"seed": 2})
    modules = [("missionplanner.search",), ("missionplanner.cost",), ("missionplanner.search", "missionplanner.cost")]
    assert len({version_of({}, m) for m in modules}) == 3


def test_a_worker_that_dies(tmp_path: Path) -> None:
    """Whose job is named, also among others; what else ran is kept, and who died with it is run again."""
    victim = Job("victim", slow, {"x": 1, "started": str(tmp_path)})
    jobs = [*squares(2), Job("deadly", die, {"x": 0}), victim, *squares(4)[2:]]
    with pytest.raises(MissionError, match=r"squares: deadly: expected a result, got a worker that died") as error:
        run(jobs, tmp_path / "out", experiment="squares", version="1", workers=2)
    assert "5 of 6 runs are kept" in str(error.value)
    kept = {json.loads(line)["key"] for line in runs(tmp_path / "out")[1:]}
    assert kept == {job.key for job in jobs} - {"deadly"}


def test_a_worker_that_dies_once(tmp_path: Path) -> None:
    """Its job is tried again, alone: two at once may have been too many for the memory."""
    jobs = [Job("unlucky", die_once, {"x": 1, "mark": str(tmp_path / "mark")})]
    assert run(jobs, tmp_path / "out", experiment="e", version="1", workers=1) == {"unlucky": {"x": 1}}


def test_an_error_names_its_run(tmp_path: Path) -> None:
    """One of ours stays of its kind; a bug keeps its traceback."""
    with pytest.raises(InfeasibleError, match="way/2: no way to 2"):
        run([Job("way/2", refuse, {"x": 2})], tmp_path / "a", experiment="e", version="1", workers=1)
    with pytest.raises(ValueError, match="a bug with 3") as error:
        run([Job("way/3", fail, {"x": 3})], tmp_path / "b", experiment="e", version="1", workers=1)
    assert error.value.__notes__ == ["in the run way/3"]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_kill_and_what_comes_after(tmp_path: Path, how: signal.Signals) -> None:
    """A campaign in a process of its own, ended in the middle: nobody works on, and the next one does the rest."""
    started, folder = tmp_path / "started", tmp_path / "out"
    started.mkdir()
    script = (
        "import signal\n"
        "from pathlib import Path\n"
        "from tests.unit.test_campaign import slow\n"
        "from missionplanner.experiments.campaign import Job, run\n"
        "if __name__ == '__main__':\n"
        "    signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a shell's background jobs ignore it
        f"    jobs = [Job(str(x), slow, dict(x=x, started={str(started)!r})) for x in range(40)]\n"
        f"    run(jobs, Path({str(folder)!r}), experiment='slow', version='1', workers=2)\n"
    )
    (tmp_path / "script.py").write_text(script, encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    ended = subprocess.Popen(
        [sys.executable, tmp_path / "script.py"],
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    until = time.monotonic() + 60.0
    while len(runs(folder) if (folder / RUNS_NAME).exists() else []) < 4:
        assert ended.poll() is None, ended.communicate()[1]
        assert time.monotonic() < until
        time.sleep(0.02)
    if how == signal.SIGINT:
        os.killpg(ended.pid, how)  # as Ctrl-C: to all of its processes
    else:
        ended.kill()
    _, said = ended.communicate(timeout=30)
    assert ended.returncode != 0
    if how == signal.SIGINT:
        assert said.count("Traceback") == 1, said  # the parent's; the command line turns it into a line
    kept = [json.loads(line)["key"] for line in runs(folder)[1:]]
    assert 3 <= len(kept) < 40
    time.sleep(1.0)
    before = len(list(started.iterdir()))
    time.sleep(0.7)
    assert len(list(started.iterdir())) == before, "somebody works on"
    for mark in started.iterdir():
        mark.unlink()
    jobs = [Job(str(x), slow, {"x": x, "started": str(started)}) for x in range(len(kept) + 3)]
    found = run(jobs, folder, experiment="slow", version="1", workers=2)
    assert found == {str(x): {"x": x} for x in range(len(kept) + 3)}
    assert {mark.name for mark in started.iterdir()} == set(found) - set(kept)


def test_a_cluster_that_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line, whether nobody answers, the address is none, or dask is not installed."""
    monkeypatch.setattr(campaign, "CONNECT_S", 0.3)
    has_dask = importlib.util.find_spec("distributed") is not None
    for address in ("tcp://127.0.0.1:9", "nonsense://x") if has_dask else ("tcp://127.0.0.1:9",):
        with pytest.raises(MissionError, match=r"--cluster.*: expected") as error:
            run(squares(1), tmp_path, experiment="squares", version="1", cluster=address)
        assert "\n" not in str(error.value)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissionError, match="not installed"):
        run(squares(1), tmp_path, experiment="squares", version="1", cluster="tcp://127.0.0.1:9")


@needs_dask
def test_a_real_cluster(tmp_path: Path) -> None:
    """Its results are those of this machine's processes; what was known is not run again; deaths are told."""
    from distributed import LocalCluster  # noqa: PLC0415

    here = run(squares(4), tmp_path / "here", experiment="squares", version="1", workers=1)
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, scheduler_port=0, silence_logs="CRITICAL"
    ) as cluster:
        log = tmp_path / "log"
        address = cluster.scheduler_address
        run(squares(2, log), tmp_path / "there", experiment="squares", version="1", cluster=address)
        there = run(squares(4, log), tmp_path / "there", experiment="squares", version="1", cluster=address)
        assert there == here
        assert sorted(log.read_text(encoding="utf-8").split()) == ["0", "1", "2", "3"]
        with pytest.raises(InfeasibleError, match="way: no way to 2"):
            run([Job("way", refuse, {"x": 2})], tmp_path / "refused", experiment="e", version="1", cluster=address)


@needs_dask
def test_a_cluster_without_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A scheduler alone is told from one that works."""
    from distributed import LocalCluster  # noqa: PLC0415

    monkeypatch.setattr(campaign, "CONNECT_S", 0.5)
    with (
        LocalCluster(n_workers=0, dashboard_address=None, scheduler_port=0, silence_logs="CRITICAL") as cluster,
        pytest.raises(MissionError, match="expected a worker, got none"),
    ):
        run(squares(1), tmp_path, experiment="squares", version="1", cluster=cluster.scheduler_address)
