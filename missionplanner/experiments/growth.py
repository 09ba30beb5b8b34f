"""How planning grows with vehicles, obstacles and terrain; ``missionplanner experiment growth``.

Each size is planned once, in a process of its own that planned a small mission on flat ground before: what that
compiles does not count; what only terrain from files or more vehicles ask for does. Time is the processor's and the
clock's, memory the most that the process ever held beyond what it held before. Obstacles fill the same share of the
same field, however many they are; vehicles fly side by side, each through a field like the others'. Direct returns from
everywhere are waived.
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rasterio.transform import Affine
from rasterio.windows import Window

from missionplanner import planner
from missionplanner.errors import InfeasibleError
from missionplanner.experiments.document import joined, machine
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv
from missionplanner.geodesy import LocalFrame
from missionplanner.mission import parse_mission
from missionplanner.scene import build_scene

Progress = Callable[[str, float], None]

VEHICLES = (1, 5, 20, 100)
OBSTACLES = (10, 100, 1_000)
CELLS = (1_000_000, 10_000_000, 100_000_000)
_QUICK = ((1, 3), (10, 30), (90_000, 360_000))

_LAT_DEG, _LON_DEG = 46.5, 8.0
_LANE_M = 60.0
_WAY_M = 1_500.0
_FIELD_M = 1_200.0  # of the way, in its middle
_FEW = 10  # obstacles on each vehicle's way where vehicles are counted
_CELL_M = 10.0
_STRIP_CELLS = 4_000_000

TITLES = {
    "vehicles": f"vehicles, each with {_FEW} obstacles on its way",
    "obstacles": "obstacles before one vehicle",
    "terrain, a corner": "cells of a terrain of which a mission needs little",
    "terrain, all": "cells of a terrain that a mission's area covers",
}


@dataclass(frozen=True, slots=True)
class Measured:
    """What a size of one kind took."""

    what: str
    size: int
    scene_s: float  # processor: reading the mission and its terrain
    plan_s: float  # processor
    wall_s: float  # both, by the clock
    memory_mb: float  # beyond what the process held before it read the mission
    refused: str  # why there is no plan; empty: there is one, with its certificate

    @property
    def cpu_s(self) -> float:
        """Return the processor's time, all in all."""
        return self.scene_s + self.plan_s


def main(
    folder: Path, *, seed: int = 1, quick: bool = False, progress: Progress = lambda _what, _share: None
) -> dict[str, Any]:
    """Measure; write results.md, growth.csv and growth.png into ``folder``; return the figures.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    ensure_writable(folder)
    vehicles, obstacles, cells = _QUICK if quick else (VEHICLES, OBSTACLES, CELLS)
    measured: list[Measured] = []

    def measure(what: str, size: int, text: str, where: Path) -> None:
        with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
            measured.append(Measured(what, size, *pool.submit(planned, text, str(where), seed).result()))

    for k, count in enumerate(vehicles, start=1):
        measure("vehicles", count, mission_text(count, _FEW, seed), folder)
        progress("vehicles", k / len(vehicles))
    for k, count in enumerate(obstacles, start=1):
        measure("obstacles", count, mission_text(1, count, seed), folder)
        progress("obstacles", k / len(obstacles))
    with tempfile.TemporaryDirectory(dir=folder, prefix=".terrain-") as where:
        for k, count in enumerate(cells, start=1):
            side = write_hills(Path(where) / "hills.tif", count)
            half_m = 0.5 * _CELL_M * side - 5 * _CELL_M
            terrain = "{kind: raster, file: hills.tif}"
            measure("terrain, a corner", count, mission_text(1, _FEW, seed, terrain), Path(where))
            measure("terrain, all", count, mission_text(1, _FEW, seed, terrain, half_m), Path(where))
            progress("terrain", k / len(cells))
    _write(folder, measured)
    return {
        "measured": [asdict(m) | {"cpu_s": m.cpu_s} for m in measured],
        "exponents": {what: exponent(measured, what) for what in TITLES},
    }


def exponent(measured: Sequence[Measured], what: str) -> float | None:
    """Return the power of the size with which the processor's time grows, over the sizes that were planned."""
    found = [m for m in measured if m.what == what and not m.refused]
    if len(found) < 2:
        return None
    sizes, times = np.log([m.size for m in found]), np.log([m.cpu_s for m in found])
    return float(np.polyfit(sizes, times, 1)[0])


# --- what is planned -------------------------------------------------------------------------------------------------


def mission_text(
    vehicles: int, obstacles: int, seed: int, terrain: str = "{kind: flat, alt_amsl_m: 400}", half_m: float = 0.0
) -> str:
    """Return a mission: vehicles side by side, each with so many obstacles on its way; ``half_m``: of its area."""
    rng = np.random.default_rng(seed)
    wide_m = max(_LANE_M, 600.0 if vehicles == 1 else 0.0)
    columns = max(1, round(np.sqrt(obstacles * wide_m / _FIELD_M)))
    rows = -(-obstacles // columns)
    step_x, step_y = wide_m / columns, _FIELD_M / rows
    lines = [
        "name: growth",
        f"origin: {{lat_deg: {_LAT_DEG}, lon_deg: {_LON_DEG}}}",
        f"terrain: {terrain}",
        "defaults: {endurance_s: 3600, speed_m_s: {min: 2, max: 8}}",
        "fleet: {direct_return: waived}",
        "obstacles:",
    ]
    if half_m > 0.0:
        corners = (f"{{x_m: {s * half_m}, y_m: {s * half_m}}}" for s in (-1, 1))
        lines.insert(2, "area: {{south_west: {}, north_east: {}}}".format(*corners))
    lanes_x = _LANE_M * (np.arange(vehicles) - 0.5 * (vehicles - 1))
    for v, lane_x in enumerate(lanes_x):
        for i in range(obstacles):
            x = lane_x - 0.5 * wide_m + step_x * (i % columns + rng.uniform(0.3, 0.7))
            y = -0.5 * _FIELD_M + step_y * (i // columns + rng.uniform(0.3, 0.7))
            radius_m = rng.uniform(0.05, 0.12) * min(step_x, step_y)
            lines.append(
                f"  - {{kind: cylinder, name: o{v}-{i}, center: {{x_m: {x:.2f}, y_m: {y:.2f}}}, "
                f"radius_m: {radius_m:.2f}, top_height_agl_m: 60}}"
            )
    lines.append("vehicles:")
    for v, x in enumerate(lanes_x):
        lines.append(
            f"  - {{name: v{v}, home: {{x_m: {x}, y_m: {-0.5 * _WAY_M}}}, "
            f"goal: {{x_m: {x}, y_m: {0.5 * _WAY_M}, height_agl_m: 50}}}}"
        )
    return "\n".join(lines)


def write_hills(path: Path, cells: int) -> int:
    """Write a square terrain of about so many cells around the origin; return its side, in cells."""
    side = int(cells**0.5)
    half_m = 0.5 * _CELL_M * side
    profile = {
        "driver": "GTiff",
        "height": side,
        "width": side,
        "count": 1,
        "dtype": "float32",
        "crs": LocalFrame(_LAT_DEG, _LON_DEG).crs.to_wkt(),
        "transform": Affine(_CELL_M, 0.0, -half_m, 0.0, -_CELL_M, half_m),
        "tiled": True,
        "blockxsize": 256,
        "blockysize": 256,
    }
    x = np.arange(side) * _CELL_M
    rows = max(256, _STRIP_CELLS // side // 256 * 256)
    with rasterio.open(path, "w", **profile) as dataset:
        for top in range(0, side, rows):
            y = np.arange(top, min(top + rows, side)) * _CELL_M
            heights = 500.0 + 40.0 * np.sin(y / 900.0)[:, np.newaxis] * np.sin(x / 1100.0)
            dataset.write(heights.astype(np.float32), 1, window=Window(0, top, side, len(y)))
    return side


def planned(text: str, folder: str, seed: int) -> tuple[float, float, float, float, str]:
    """Plan a mission: processor time of reading and of planning, the clock's, memory, and why there is no plan."""
    planner.plan_fleet(build_scene(parse_mission(mission_text(2, 3, seed), "growth"), Path(folder)), seed=seed)
    held_mb = _most_memory_mb()
    begun, begun_here = time.perf_counter(), time.process_time()
    scene = build_scene(parse_mission(text, "growth"), Path(folder))
    read = time.process_time()
    refused = ""
    try:
        planner.plan_fleet(scene, seed=seed)
    except InfeasibleError as error:
        refused = str(error)
    done = time.process_time()
    return read - begun_here, done - read, time.perf_counter() - begun, _most_memory_mb() - held_mb, refused


def _most_memory_mb() -> float:
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (1e6 if sys.platform == "darwin" else 1e6 / 1024)


# --- what is written -------------------------------------------------------------------------------------------------


def _write(folder: Path, measured: Sequence[Measured]) -> None:
    fields = list(Measured.__dataclass_fields__)
    write_csv(folder / "growth.csv", fields, [[getattr(m, f) for f in fields] for m in measured])
    write_atomic(folder / "results.md", report(measured))
    with replacing(folder / "growth.png") as draft:
        _drawn(measured).savefig(draft, format="png", metadata={"Software": None})


def report(measured: Sequence[Measured]) -> str:
    """Return the figures as Markdown."""
    parts: list[str | Sequence[str]] = [
        "# Growth of planning",
        machine(),
        "A plan is searched, timed, proven and certified; every size once, in a process of its own that planned "
        "a small mission on flat ground before: that compiles nearly everything. "
        "Processor time is of all cores together. Memory is the most the process held beyond what it held before. "
        "Direct returns are waived.",
    ]
    for what, title in TITLES.items():
        found = [m for m in measured if m.what == what]
        if not found:
            continue
        power = exponent(measured, what)
        table = ["| size | read, s | plan, s | by the clock, s | memory, MB | |", "|---|---|---|---|---|---|"]
        table += [
            f"| {m.size:,} | {m.scene_s:.3f} | {m.plan_s:.2f} | {m.wall_s:.2f} | {m.memory_mb:,.0f} "
            f"| {f'no plan: {m.refused}' if m.refused else 'proven'} |"
            for m in found
        ]
        law = f"Processor time grows with size^{power:.2f}." if power is not None else "Too few plans for a law."
        parts += [f"## {title[0].upper()}{title[1:]}", table, law]
    return joined(*parts, "![Growth](growth.png)")


def _drawn(measured: Sequence[Measured]) -> Figure:
    colours = dict(zip(TITLES, ("#0072b2", "#d55e00", "#56b4e9", "#009e73"), strict=True))
    panels = (
        ("vehicles", ("vehicles",)),
        ("obstacles", ("obstacles",)),
        ("cells", ("terrain, a corner", "terrain, all")),
    )
    figure = Figure(figsize=(9.0, 4.6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(panels), sharex="col", sharey="row")
    for column, (label, kinds) in enumerate(panels):
        for what in kinds:
            found = [m for m in measured if m.what == what and not m.refused]
            if not found:
                continue
            sizes = [m.size for m in found]
            power = exponent(measured, what)
            name = what + (f": size^{power:.2f}" if power is not None else "")
            axes[0, column].loglog(sizes, [m.cpu_s for m in found], "o-", color=colours[what], label=name)
            axes[1, column].loglog(sizes, [max(m.memory_mb, 1.0) for m in found], "o-", color=colours[what])
        axes[1, column].set_xlabel(label)
        for ax in axes[:, column]:
            ax.grid(True)
            ax.set_axisbelow(True)
        if axes[0, column].lines:
            axes[0, column].legend(fontsize=7.5, loc="upper left")
    axes[0, 0].set_ylabel("processor, s")
    axes[1, 0].set_ylabel("memory, MB")
    return figure
