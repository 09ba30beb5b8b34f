"""Many independent runs through one executor: processes of this machine, or a Dask cluster.

What comes of a run is written to the folder as soon as it is known. A campaign that was ended, by Ctrl-C, a kill or a
power cut, goes on from there when it is started again. Results depend on the jobs alone: not on the number of workers,
the order in which they finish, or how often the campaign was ended.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, as_completed, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import version as version_of_package
from pathlib import Path
from typing import Any

from missionplanner.errors import MissionError, MissionPlannerError
from missionplanner.files import alone, ensure_writable, write_atomic

Progress = Callable[[str, float], None]
Keep = Callable[["Job", dict[str, Any]], None]

RUNS_NAME = "runs.jsonl"
"""The file of a campaign's results: what it is of, then a line per run."""

MARK_NAME = ".experiment"
"""The file that says whose results a folder holds."""

CONNECT_S = 5.0
"""How long a cluster may take to answer."""

_OTHER = "choose another folder by --output"
_BUSY = (
    "expected a folder that nobody writes to, got one where another experiment is at work: wait for it, or choose "
    "another folder by --output"
)
_ONE_THREAD = {f"{library}_NUM_THREADS": "1" for library in ("NUMBA", "OMP", "OPENBLAS", "MKL")}
_PACKAGES = ("numpy", "numba", "scipy")  # what the last bits of a result depend on


@dataclass(frozen=True, slots=True)
class Job:
    """One run: a function at the top of its module, called with arguments that JSON can write, as its result."""

    key: str
    function: Callable[..., dict[str, Any]]
    arguments: dict[str, Any]


def run(
    jobs: Sequence[Job],
    folder: Path,
    *,
    experiment: str,
    version: str,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress | None = None,
) -> dict[str, dict[str, Any]]:
    """Return the result of every job by its key, in the order of the jobs; only those not yet in the folder are run.

    Parameters
    ----------
    experiment : whose runs these are; a folder of another is refused.
    version : of what else a run depends on, as by :func:`version_of`; results of another are refused.
    workers : processes, of one thread each; default: one per core.
    cluster : address of a Dask scheduler (``tcp://HOST:PORT``) whose workers run the jobs instead.
    progress : told the experiment's name and the share that is done.

    Raises
    ------
    MissionError
        A folder of other results, or where another campaign is at work; a cluster that cannot be reached or runs other
        software; a worker that died. What was known before is kept.
    """
    assert len({job.key for job in jobs}) == len(jobs), "two jobs have one key"
    if workers is not None and workers < 1:
        raise MissionError(f"workers: expected at least 1, got {workers}")
    ensure_writable(folder)
    with alone(folder, _BUSY):
        return _run(jobs, folder, experiment, version, workers, cluster, progress)


def _run(
    jobs: Sequence[Job],
    folder: Path,
    experiment: str,
    version: str,
    workers: int | None,
    cluster: str | None,
    progress: Progress | None,
) -> dict[str, dict[str, Any]]:
    kept = _Kept(folder, experiment, version)
    missing = [job for job in jobs if job.key not in kept.results]
    todo = len(missing)

    def tell() -> None:
        if progress is not None:
            progress(experiment, 1.0 - todo / max(1, len(jobs)))

    def keep(job: Job, result: dict[str, Any]) -> None:
        nonlocal todo
        kept.add(job.key, result)
        todo -= 1
        tell()

    tell()
    if missing:
        dead = _in_processes(missing, workers, keep) if cluster is None else _on_cluster(missing, cluster, keep)
        if dead:
            raise MissionError(
                f"{experiment}: {', '.join(job.key for job in dead)}: expected a result, got a worker that died, also "
                f"when tried again (out of memory, or killed); {len(jobs) - todo} of {len(jobs)} runs are kept in "
                f"{folder}: free memory and start the same command again"
            )
    return {job.key: kept.results[job.key] for job in jobs}


def version_of(settings: Mapping[str, Any], modules: Sequence[str] = ("missionplanner",)) -> str:
    """Return a digest of settings, of the source of modules (packages as a whole), and of the libraries beneath."""
    digest = hashlib.sha256(json.dumps([settings, _packages()], sort_keys=True, default=str).encode())
    for module in modules:
        digest.update(_source_sha256(module).encode())
    return digest.hexdigest()


def _packages() -> dict[str, str]:
    return {name: version_of_package(name) for name in _PACKAGES}


@cache
def _source_sha256(module: str) -> str:
    path = Path(__file__).parents[2].joinpath(*module.split("."))
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*.py")) if path.is_dir() else [path.with_suffix(".py")]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


# --- what is kept ----------------------------------------------------------------------------------------------------


class _Kept:
    """Results in a file: read when made, then one line more for each, on the disk before the next is begun."""

    def __init__(self, folder: Path, experiment: str, version: str) -> None:
        self.results: dict[str, dict[str, Any]] = {}
        path = folder / RUNS_NAME
        head = {"experiment": experiment, "version": version}
        lines = _read(path).splitlines() if path.exists() else []
        if lines:
            _check_head(path, _parsed(lines[0]), head, empty=len(lines) == 1)
        for line in lines[1:]:
            found = _parsed(line)  # one may have been cut short
            if found is not None and isinstance(found.get("result"), dict):
                self.results[str(found.get("key"))] = found["result"]
        whole = [head, *({"key": key, "result": result} for key, result in self.results.items())]
        write_atomic(path, "".join(f"{json.dumps(line)}\n" for line in whole))
        self._path = path

    def add(self, key: str, result: dict[str, Any]) -> None:
        line = json.dumps({"key": key, "result": result})
        with self._path.open("a", encoding="utf-8") as file:
            file.write(f"{line}\n")
            file.flush()
            os.fsync(file.fileno())
        self.results[key] = json.loads(line)["result"]  # the same whether just run or read again


def claim(folder: Path, experiment: str) -> None:
    """Refuse a folder that holds the results of another experiment.

    Raises
    ------
    MissionError
        It holds them, or results without a word whose they are.
    """
    said, runs = folder / MARK_NAME, folder / RUNS_NAME
    if said.is_file():
        owner = _read(said).strip()
    elif runs.is_file():
        owner = str((_parsed(_read(runs).partition("\n")[0]) or {}).get("experiment", "something else"))
    elif (folder / "results.md").exists():
        owner = "something else"
    else:
        return
    if owner != experiment:
        raise MissionError(
            f"{folder}: expected a new folder or one of experiment {experiment}, got results of {owner}: {_OTHER}"
        )


def mark(folder: Path, experiment: str) -> None:
    """Say whose results a folder holds, for :func:`claim`."""
    write_atomic(folder / MARK_NAME, f"{experiment}\n")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise MissionError(f"{path}: expected a file that can be read, got: {error.strerror}: {_OTHER}") from error


def _check_head(path: Path, found: dict[str, Any] | None, wanted: dict[str, str], *, empty: bool) -> None:
    if found is None or "experiment" not in found:
        raise MissionError(f"{path}: expected the runs of {wanted['experiment']}, got another file: {_OTHER}")
    if found["experiment"] != wanted["experiment"]:
        raise MissionError(
            f"{path}: expected the runs of {wanted['experiment']}, got those of {found['experiment']}: {_OTHER}"
        )
    if found != wanted and not empty:
        raise MissionError(
            f"{path}: expected runs of this software with these settings, got those of another version or of other "
            f"settings: {_OTHER}, or delete this file to begin anew"
        )


def _parsed(line: str) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except json.JSONDecodeError:
        return None
    return found if isinstance(found, dict) else None


# --- who works -------------------------------------------------------------------------------------------------------


def _call(function: Callable[..., dict[str, Any]], arguments: dict[str, Any]) -> dict[str, Any]:
    return function(**arguments)


def _result(job: Job, future: Future[dict[str, Any]]) -> dict[str, Any]:
    """Return what came of a job; an error says which job it was."""
    try:
        return future.result()
    except MissionPlannerError as error:
        raise type(error)(f"{job.key}: {error}") from error
    except Exception as error:
        error.add_note(f"in the run {job.key}")
        raise


def _in_processes(jobs: Sequence[Job], workers: int | None, keep: Keep) -> list[Job]:
    """Run jobs in processes; return those whose process died even when nothing else ran."""
    workers = workers or os.cpu_count() or 1
    waiting, dead = deque(jobs), list[Job]()
    while waiting:
        suspects: list[Job] = []
        with _pool(min(workers, len(waiting))) as pool:
            running: dict[Future[dict[str, Any]], Job] = {}
            while running or (waiting and not suspects):
                while (
                    waiting and len(running) < workers and not suspects
                ):  # no more: then it is known who may have died
                    job = waiting.popleft()
                    try:
                        running[pool.submit(_call, job.function, job.arguments)] = job
                    except BrokenProcessPool:
                        suspects.append(job)
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job = running.pop(future)
                    try:
                        keep(job, _result(job, future))
                    except BrokenProcessPool:
                        suspects.append(job)
        for job in suspects:
            with _pool(1) as alone:
                try:
                    keep(job, _result(job, alone.submit(_call, job.function, job.arguments)))
                except BrokenProcessPool:
                    dead.append(job)
    return dead


@contextmanager
def _pool(workers: int) -> Iterator[Executor]:
    """Yield processes that start afresh, with a thread each; an error, also Ctrl-C, ends them at once."""
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn"), initializer=begin)
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - before:
            process.terminate()
        raise
    finally:
        pool.shutdown()


def begin() -> None:
    """Begin a process that works for its parent: one thread for numpy and numba, which come later.

    Ctrl-C is left to the parent, and it ends when the parent does, however that ends.
    """
    os.environ.update(_ONE_THREAD)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def end() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=end, daemon=True).start()


def _on_cluster(jobs: Sequence[Job], address: str, keep: Keep) -> list[Job]:
    """Run jobs on a Dask cluster; return those whose workers died again and again."""
    try:
        distributed: Any = import_module("distributed")  # optional
    except ImportError:
        raise MissionError(
            "--cluster: expected dask.distributed, which is not installed: pip install 'missionplanner[cluster]'"
        ) from None
    _knock(distributed, address)
    dead = []
    with distributed.Client(address, timeout=CONNECT_S, set_as_default=False) as client:
        _check_cluster(client, address)
        executor = client.get_executor(pure=False)
        futures = {executor.submit(_call, job.function, job.arguments): job for job in jobs}
        try:
            for future in as_completed(futures):
                try:
                    keep(futures[future], _result(futures[future], future))
                except distributed.KilledWorker:
                    dead.append(futures[future])
        finally:
            executor.shutdown(wait=False)
    return dead


def _knock(distributed: Any, address: str) -> None:
    """Refuse an address where no scheduler answers; a client that finds none takes long, and tells of it in its way."""
    loop = distributed.utils.LoopRunner()
    loop.start()
    try:
        loop.run_sync(distributed.comm.connect, address, timeout=CONNECT_S).abort()
    except (OSError, ValueError) as error:
        raise MissionError(
            f"--cluster {address}: expected a Dask scheduler, nobody answered within {CONNECT_S:g} s: check the "
            "address (tcp://HOST:PORT), or start one by `dask scheduler`"
        ) from error
    finally:
        loop.stop()


def _check_cluster(client: Any, address: str) -> None:
    """Refuse a cluster without workers, or one whose workers would compute something else."""
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except TimeoutError:
        raise MissionError(
            f"--cluster {address}: expected a worker, got none within {CONNECT_S:g} s: start some by "
            f"`dask worker {address}`"
        ) from None
    here = version_of({})
    for worker, there in client.run(version_of, {}, on_error="return").items():
        if there != here:
            got = f"{type(there).__name__}: {there}" if isinstance(there, BaseException) else "another version"
            raise MissionError(
                f"--cluster {address}: expected this software on every worker, got on {worker}: {got}: install the "
                "same missionplanner, numpy, numba and scipy there"
            )
