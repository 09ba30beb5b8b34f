"""Time and memory of ``missionplanner plan``: cold (nothing compiled yet, as after installation) and warm.

Run ``python -m tests.benchmarks.planning [MISSION] [--repeats 3]``. Each run is a process of its own, interpreter
start, imports, terrain, planning, checks and files included. Peak memory is that of the largest single process.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.main_job import mission_path

_BYTES_PER_RSS = 1 if sys.platform == "darwin" else 1024


@dataclass(frozen=True)
class Cost:
    """What one run took."""

    wall_s: float
    cpu_s: float
    peak_bytes: int


def measure(mission: Path, folder: Path, environment: Mapping[str, str]) -> Cost:
    """Plan a mission in a process of its own."""
    script = "from missionplanner.cli import main; main()"
    command = [sys.executable, "-c", script, "plan", str(mission), "-o", str(folder), "--json"]
    begin_s = time.perf_counter()
    process = subprocess.Popen(command, env={**os.environ, **environment}, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - begin_s
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}")
    return Cost(wall_s, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * _BYTES_PER_RSS)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mission", type=Path, nargs="?", default=mission_path("ridge_line"))
    parser.add_argument("--repeats", type=int, default=3, help="warm runs")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cache = {"NUMBA_CACHE_DIR": str(folder / "cache")}
        runs = {"cold": [measure(options.mission, folder / "cold", cache)]}
        runs["warm"] = [measure(options.mission, folder / f"warm{k}", cache) for k in range(options.repeats)]
        plans = {path.read_bytes() for path in folder.glob("*/plan.json")}
    table = Table(title=f"missionplanner plan {options.mission.name}, {os.cpu_count()} cores")
    for heading in ("", "runs", "wall s (median)", "wall s (least)", "CPU s (least)", "peak memory MB"):
        table.add_column(heading, justify="right")
    for kind, costs in runs.items():
        table.add_row(
            kind,
            str(len(costs)),
            f"{statistics.median(c.wall_s for c in costs):.1f}",
            f"{min(c.wall_s for c in costs):.1f}",
            f"{min(c.cpu_s for c in costs):.1f}",
            f"{max(c.peak_bytes for c in costs) / 1e6:.0f}",
        )
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    print("all plans are the same, byte for byte" if len(plans) == 1 else f"PLANS DIFFER: {len(plans)} different ones")


if __name__ == "__main__":
    main()
