"""The flat pictures: height profiles, distances over time, arrival windows, cost over iterations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from scipy.ndimage import grey_dilation, grey_erosion

from missionplanner.geodesy import FloatArray
from missionplanner.plan import Clearance, Trajectory
from missionplanner.report import style
from missionplanner.report.facts import Course, Distances, Facts, Sketch, VehicleFacts, along_m, along_path_m, distances
from missionplanner.report.shapes import Shape, vertical_range
from missionplanner.report.verdicts import ENDINGS, floored
from missionplanner.scene import Scene
from missionplanner.terrain import Terrain

_PROFILE_SAMPLES = 2000
_FAR_M = 1e5
_ABREAST = 9
_ITEM_WIDTH_PX = 90.0
_NAMED_LINES = 10


def height_profile(facts: Sketch, shapes: Sequence[Shape], vehicle: Course) -> Figure:
    """Draw one vehicle's legs, its tube and its flight over the ground below them, with the room it must keep."""
    figure = style.new_figure(2.75)
    axes = figure.add_axes((0.07, 0.16, 0.915, 0.66))
    limits, terrain = vehicle.task.limits, facts.scene.terrain
    colour = style.vehicle_colour(vehicle.index)
    way = _way(vehicle)
    line, run = np.concatenate([part.line_m for part in way]), np.concatenate([part.run_m for part in way])
    length_m = max(float(run[-1]), 1.0)
    below_run = np.linspace(0.0, length_m, _PROFILE_SAMPLES)
    below = np.stack([np.interp(below_run, run, line[:, k]) for k in range(3)], axis=-1)
    ground = terrain.height_amsl_m(below[:, 0], below[:, 1])
    known = np.isfinite(ground)
    required_m = limits.terrain_margin_m
    tube_m = limits.tube_m if vehicle.legs else 0.0

    tops = [float(part.line_m[:, 2].max()) + part.tube_m for part in way]
    track = vehicle.flown.en_route.position_m if vehicle.flown else None
    if track is not None:
        tops.append(float(track[:, 2].max()))
    low, high = float(min(ground[known].min(initial=np.inf), line[:, 2].min())), max(tops)
    room = max(high - low, 30.0)
    bottom, top = low - 0.14 * room, high + 0.12 * room

    ends = np.array([part.run_m[-1] for part in way])
    tubes_m = np.array([part.tube_m for part in way])[np.searchsorted(ends[:-1], below_run)]
    kept = _ground_under_tube(terrain, below, tubes_m) + required_m
    axes.fill_between(below_run, bottom, ground, color=style.GROUND, linewidth=0, zorder=2)
    axes.plot(below_run, ground, color=style.GROUND_EDGE, linewidth=0.9, zorder=3)
    axes.fill_between(below_run, ground, kept, color=style.MARGIN, alpha=0.28, linewidth=0, zorder=1.5)
    axes.fill_between(below_run, bottom, top, where=~known, color=style.BAD, alpha=0.10, linewidth=0, zorder=1)
    _draw_section(axes, [s for s in shapes if s.hard], below_run, below, limits.obstacle_margin_m)
    ceiling = np.minimum(ground + limits.height_agl_max_m, limits.alt_amsl_max_m)
    ceiling_seen = float(ceiling[known].min(initial=np.inf)) < top
    if ceiling_seen:
        axes.plot(below_run, ceiling, color=style.BAD, linewidth=0.9, linestyle=(0, (4, 2)), zorder=5)
    _draw_tubes(axes, way, below_run, colour)
    axes.plot(run, line[:, 2], color="white", linewidth=3.4, zorder=5.9)
    for part in way:
        shade = colour if part.proven else style.BAD
        axes.plot(part.run_m, part.line_m[:, 2], color=shade, linewidth=2.0, zorder=6 if part.proven else 6.1)
    axes.plot(
        *_waypoint_marks(vehicle, way), linestyle="none", marker="o", markersize=3.6, zorder=7,
        markerfacecolor="white", markeredgecolor=colour, markeredgewidth=1.0,
    )  # fmt: skip
    if track is not None:
        track = track[:: max(1, len(track) // 1500)]
        axes.plot(along_path_m(line, track), track[:, 2], color=style.INK, linewidth=0.8, zorder=8)

    shown = [c for c in vehicle.clearances if c.what not in {"ceiling", "fence"} or not c.ok]
    said = ["height above ground not known"] * any(not math.isfinite(c.distance_m) for c in shown)
    for mark, clearance in zip("abcd", [c for c in shown if math.isfinite(c.distance_m)], strict=False):
        where = float(along_path_m(line, np.array([clearance.position_m]), window_m=math.inf)[0])
        _mark_least(axes, facts.scene, clearance, where, mark)
        said.append(f"{mark}  {_clearance_words(clearance)}")
    axes.set_xlim(0.0, length_m)
    axes.set_ylim(bottom, top)
    axes.set_ylabel("altitude AMSL (m)")
    axes.yaxis.set_major_locator(MaxNLocator(5))
    _distance_axis(axes, length_m)
    style.quiet(axes)
    _name_open_parts(axes, way)
    figure.text(0.07, 0.935, vehicle.name, color=colour, fontsize=11, fontweight="bold", va="center")
    said_colour = style.INK if all(c.ok for c in shown) else style.BAD
    figure.text(0.985, 0.935, "     ".join(said), color=said_colour, fontsize=8, ha="right", va="center")
    key = _profile_key(
        required_m,
        tube_m,
        circles=any(part.tube_m > tube_m for part in way),
        ceiling=ceiling_seen,
        flown=track is not None,
        red=any(not part.proven for part in way),
        unknown=not known.all(),
    )
    figure.text(0.07, 0.865, key, color=style.MUTED, fontsize=7, va="center")
    return figure


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A leg on a height profile: its line (N, 3), and how far along the whole way each point is."""

    seq: int | None
    kind: str
    line_m: FloatArray
    run_m: FloatArray  # (N,)
    tube_m: float  # 0: none is drawn, where it leaves and meets the ground
    proven: bool


def _way(vehicle: Course) -> list[_Part]:
    """Return a vehicle's legs one after the other, but once around where it circles; of one without proof, its path."""
    parts: list[_Part] = []
    begin_m = 0.0
    for leg in vehicle.legs:
        line_m, run_m = leg.line_m, along_m(leg.line_m)
        if leg.kind == "loiter":
            once = run_m <= 2.0 * math.pi * vehicle.task.motion.loiter_radius_m
            line_m, run_m = line_m[once], run_m[once]
        tube_m = vehicle.task.limits.tube_m + leg.wider_m if leg.over_terrain else 0.0
        parts.append(_Part(leg.seq, leg.kind, line_m, begin_m + run_m, tube_m, leg.proven))
        begin_m = float(parts[-1].run_m[-1])
    return parts or [_Part(None, "straight", vehicle.path_m, along_m(vehicle.path_m), 0.0, True)]


def _ground_under_tube(terrain: Terrain, below: FloatArray, tube_m: FloatArray) -> FloatArray:
    """Return the highest ground (N,) that the underside of tubes (N,) about the way (N, 3) meets, abreast of it."""
    ahead = np.gradient(below[:, :2], axis=0)
    aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-9)
    turn = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _ABREAST)
    places = below[:, None, :2] + (tube_m[:, None] * np.sin(turn))[..., None] * aside[:, None, :]
    heights = terrain.height_amsl_m(places[..., 0], places[..., 1])
    return np.asarray((heights - tube_m[:, None] * (1.0 - np.cos(turn))).max(axis=1))


def _draw_tubes(axes: Axes, way: Sequence[_Part], run: FloatArray, colour: str) -> None:
    """Shade the tubes in the vertical surface along the way, those of one width together."""
    step_m = float(run[1] - run[0])
    for tube_m, group in itertools.groupby(way, key=lambda part: part.tube_m):
        parts = list(group)
        if tube_m == 0.0:
            continue
        reach = np.arange(-math.floor(tube_m / step_m), math.floor(tube_m / step_m) + 1) * step_m
        round_ = np.sqrt(np.maximum(tube_m**2 - reach**2, 0.0))
        at, z = np.concatenate([p.run_m for p in parts]), np.concatenate([p.line_m[:, 2] for p in parts])
        first, last = np.searchsorted(run, at[0] - 1e-9), np.searchsorted(run, at[-1] + 1e-9, side="right")
        samples = slice(min(int(first), len(run) - 1), max(int(last), int(first) + 1))
        low = np.interp(run[samples], at, z)
        high = low.copy()
        for i in np.flatnonzero(np.diff(at) < step_m):  # what is steep falls between the samples
            k = int(np.argmin(np.abs(run[samples] - at[i])))
            low[k], high[k] = min(low[k], *z[i : i + 2]), max(high[k], *z[i : i + 2])
        low = grey_erosion(low, structure=round_, mode="nearest")
        high = grey_dilation(high, structure=round_, mode="nearest")
        axes.fill_between(run[samples], low, high, color=colour, alpha=0.25, linewidth=0, zorder=4)


def _waypoint_marks(vehicle: Course, way: Sequence[_Part]) -> tuple[FloatArray, FloatArray]:
    """Return how far along the way, and how high, its waypoints are: where legs end."""
    if not vehicle.legs:
        return along_path_m(vehicle.path_m, vehicle.waypoints_m, window_m=math.inf), vehicle.waypoints_m[:, 2]
    ends = [(part.run_m[-1], part.line_m[-1, 2]) for part in way if part.kind not in ENDINGS]
    return np.array([run for run, _ in ends]), np.array([z for _, z in ends])


def _name_open_parts(axes: Axes, way: Sequence[_Part]) -> None:
    """Write the item's number above every leg that is not proven, as far as there is room."""
    taken = -math.inf
    for part in way:
        if part.proven or part.seq is None:
            continue
        middle = 0.5 * float(part.run_m[0] + part.run_m[-1])
        x, _ = axes.transData.transform((middle, 0.0))
        if x - taken < _ITEM_WIDTH_PX:
            continue
        taken = x
        z = float(np.interp(middle, part.run_m, part.line_m[:, 2]))
        side = (
            "left" if middle < 0.03 * way[-1].run_m[-1] else "right" if middle > 0.97 * way[-1].run_m[-1] else "center"
        )
        axes.annotate(
            f"item {part.seq}", xy=(middle, z), xytext=(0, 9), textcoords="offset points", ha=side, va="bottom",
            fontsize=7.5, fontweight="bold", color=style.BAD, zorder=10, path_effects=style.halo(2.2),
        )  # fmt: skip


def separation(facts: Facts) -> Figure:
    """Draw the distances between the vehicles over time, planned and flown, beside the required separation."""
    panels = [_panel(facts, "planned", [v.plan.trajectory for v in facts.vehicles], facts.plan.separation)]
    flown = [v.flown.record.trajectory for v in facts.vehicles if v.flown]
    if len(flown) == len(facts.vehicles):
        panels.append(_panel(facts, "flown", flown, facts.flown_separation))
    figure = style.new_figure(2.9)
    width = (0.915 - 0.05 * (len(panels) - 1)) / len(panels)
    for i, panel in enumerate(panels):
        axes = figure.add_axes((0.07 + i * (width + 0.05), 0.155, width, 0.66))
        axes.set_title(panel.title, loc="left", fontsize=9, fontweight="bold", color=style.INK, pad=5)
        axes.set_xlabel("time since mission start (s)")
        axes.set_xlim(0.0, max(float(p.lines.t_s[-1]) for p in panels))
        distance_scale(axes, panels)
        draw_distances(axes, panel)
        if i == 0:
            axes.set_ylabel("distance (m)")
    if panels[0].lines.pairs is None:
        words = "each vehicle to its nearest fellow"
        figure.text(0.985, 0.955, words, color=style.MUTED, fontsize=7.5, ha="right", va="center")
    _name_key(figure, facts, 0.955)
    return figure


def arrival_windows(facts: Facts) -> Figure:
    """Draw when each vehicle can arrive, when it is planned to and when it did."""
    count = len(facts.vehicles)
    row_in = 0.3 if count <= 12 else max(0.12, 3.6 / count)
    height_in = 0.95 + row_in * count
    figure = style.new_figure(height_in)
    axes = figure.add_axes((0.12, 0.5 / height_in, 0.72, 1 - 0.9 / height_in))
    windows = np.array([v.plan.window_s for v in facts.vehicles]) + np.array(
        [[v.plan.start_delay_s] for v in facts.vehicles]
    )
    arrivals = [v.plan.arrival_s for v in facts.vehicles]
    flown = [v.flown.record.arrival_s for v in facts.vehicles if v.flown and v.flown.record.arrival_s is not None]
    finite = windows[np.isfinite(windows)]
    latest = max([*finite, *arrivals, *flown])
    start = min([*finite, *arrivals, *flown])
    room = max(latest - start, 1.0)
    left, right = max(0.0, start - 0.12 * room), latest + 0.12 * room
    begin, end = windows[:, 0].max(), windows[:, 1].min()
    if facts.plan.arrival_s is not None and begin <= end:
        axes.axvspan(begin, min(end, right), color="#1a7f4b", alpha=0.10, linewidth=0, zorder=0)
    for v, (first, last) in zip(facts.vehicles, windows, strict=True):
        colour = style.vehicle_colour(v.index)
        axes.barh(v.index, min(last, right) - first, left=first, height=0.5, color=colour, alpha=0.35, linewidth=0)
        for edge in (first, last):
            axes.plot([edge, edge], [v.index - 0.25, v.index + 0.25], color=colour, linewidth=1.6)
        axes.plot(v.plan.arrival_s, v.index, marker="o", color=colour, markersize=6, markeredgecolor="white", zorder=5)
        if v.flown and v.flown.record.arrival_s is not None:
            axes.plot(
                v.flown.record.arrival_s, v.index, marker="D", markersize=4.2, linestyle="none", zorder=6,
                markerfacecolor="none", markeredgecolor=style.INK, markeredgewidth=1.1,
            )  # fmt: skip
        if row_in >= 0.2:
            axes.annotate(
                _arrival_words(v), xy=(1, v.index), xycoords=("axes fraction", "data"), xytext=(6, 0),
                textcoords="offset points", fontsize=7.5, va="center",
            )  # fmt: skip
    if facts.plan.arrival_s is not None:
        axes.axvline(facts.plan.arrival_s, color=style.INK, linewidth=1.0, zorder=4)
    axes.set_xlim(left, right)
    axes.set_ylim(count - 0.5, -0.5)
    step = 1 if row_in >= 0.2 else math.ceil(0.2 / row_in)
    axes.set_yticks(range(0, count, step), [v.name for v in facts.vehicles][::step])
    axes.tick_params(axis="y", length=0, labelcolor=style.INK)
    axes.set_xlabel("time since mission start (s)")
    axes.grid(True, axis="x")
    axes.set_axisbelow(True)
    axes.spines["left"].set_visible(False)
    words = "bar: fastest to slowest arrival     ●  planned"
    words += "     ◇  flown" if flown else ""
    if facts.plan.arrival_s is not None:
        words += f"     line: common arrival {facts.plan.arrival_s:.1f} s     green: when all can arrive"
    figure.text(0.12, 1 - 0.2 / height_in, words, color=style.MUTED, fontsize=7.5, va="center")
    return figure


def cost_history(facts: Facts) -> Figure:
    """Draw the best cost of every vehicle's search, iteration by iteration."""
    figure = style.new_figure(2.7)
    axes = figure.add_axes((0.07, 0.165, 0.915, 0.68))
    lowest, highest = math.inf, -math.inf
    for v in facts.vehicles:
        history = np.asarray(v.plan.history, dtype=float)
        shown = history[np.isfinite(history)]
        if not shown.size:
            continue
        lowest, highest = min(lowest, float(shown.min())), max(highest, float(shown.max()))
        axes.step(
            np.arange(1, history.size + 1), history, where="post", color=style.vehicle_colour(v.index),
            linestyle=style.vehicle_dashes(v.index), linewidth=1.6,
        )  # fmt: skip
        axes.plot(history.size, history[-1], "o", color=style.vehicle_colour(v.index), markersize=3.5)
    if lowest > 0 and highest > 8 * lowest:
        axes.set_yscale("log")
        _plain_log(axes)
    axes.set_xlim(left=1)
    axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    axes.set_xlabel("iteration")
    axes.set_ylabel("best cost")
    style.quiet(axes)
    _name_key(figure, facts, 0.925)
    return figure


def _draw_section(axes: Axes, shapes: Sequence[Shape], run: FloatArray, below: FloatArray, around_m: float) -> None:
    """Fill what the obstacles, and the distance to keep from them, take of the vertical surface along the path."""
    place = below[:, :2]
    for thicker, zorder in ((around_m, 1.6), (0.0, 1.8)):
        polygons: list[FloatArray] = []
        colours: list[tuple[float, ...]] = []
        for shape in shapes:
            found = _section(shape, run, place, thicker)
            polygons += found
            colours += [to_rgba(style.MARGIN, 0.28) if thicker else _section_colour(shape)] * len(found)
        edges = "none" if thicker else colours  # a thin thing keeps the width of its edge
        axes.add_collection(
            PolyCollection(polygons, facecolors=colours, edgecolors=edges, linewidths=0.6, zorder=zorder)
        )


def _section(shape: Shape, run: FloatArray, place: FloatArray, around_m: float) -> list[FloatArray]:
    """Return the polygons (run, altitude) that a shape, thickened, takes of the surface."""
    reach = shape.radius_m + around_m
    low, high = shape.outline_m.min(axis=0) - reach, shape.outline_m.max(axis=0) + reach
    near = np.flatnonzero(((place >= low) & (place <= high)).all(axis=1))
    if not near.size:
        return []
    bottom, top = vertical_range(shape, place[near], around_m)
    taken = near[~np.isnan(top)]
    bottom, top = (np.clip(z[~np.isnan(z)], -_FAR_M, _FAR_M) for z in (bottom, top))
    cuts = np.flatnonzero(np.diff(taken) > 1) + 1
    return [
        np.concatenate([np.column_stack([x, y]), np.column_stack([x, z])[::-1]])
        for x, y, z in zip(*(np.split(v, cuts) for v in (run[taken], bottom, top)), strict=True)
        if len(x)
    ]


def _section_colour(shape: Shape) -> tuple[float, ...]:
    zone = shape.kind in ("radar", "marine", "no_fly", "conductor", "line")
    return to_rgba(style.OBSTACLE_COLOURS.get(shape.kind, style.STEEL), 0.45 if zone else 0.8)


def _mark_least(axes: Axes, scene: Scene, clearance: Clearance, run_m: float, mark: str) -> None:
    x, y, z = clearance.position_m
    colour = style.INK if clearance.ok else style.BAD
    foot = z
    if clearance.what == "terrain":
        foot = float(scene.terrain.height_amsl_m(np.array([x]), np.array([y]))[0])
        axes.annotate(
            "", xy=(run_m, foot), xytext=(run_m, z), zorder=9,
            arrowprops={"arrowstyle": "<->", "color": colour, "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0},
        )  # fmt: skip
    else:
        axes.plot(run_m, z, marker="D", markersize=4.5, color=colour, markeredgecolor="white", zorder=9)
    axes.annotate(
        mark, xy=(run_m, foot), xytext=(0, -9), textcoords="offset points", ha="center", va="center", zorder=10,
        fontsize=7.5, fontweight="bold", color="white",
        bbox={"boxstyle": "circle,pad=0.22", "facecolor": colour, "edgecolor": "white", "linewidth": 0.6},
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Distances between vehicles over time, as one chart shows them."""

    title: str
    lines: Distances
    least: Clearance | None
    required_m: float


def _panel(facts: Facts, title: str, trajectories: Sequence[Trajectory], least: Clearance | None) -> Panel:
    instants_s = [least.t_s] if least is not None and least.t_s is not None else []
    required_m = least.required_m if least is not None else facts.scene.mission.fleet.separation_m
    return Panel(title, distances(trajectories, instants_s), least, required_m)


def distance_scale(axes: Axes, panels: Sequence[Panel]) -> None:
    """Give all panels one scale: logarithmic where the required separation would otherwise vanish at the bottom."""
    floor = max(0.1, min(min(float(p.lines.distance_m.min()), p.required_m or math.inf) for p in panels))
    highest = max(float(p.lines.distance_m.max()) for p in panels)
    if highest > 8 * floor:
        axes.set_yscale("log")
        axes.set_ylim(floor * 0.5, highest * 1.35)
        _plain_log(axes)
    else:
        axes.set_ylim(0.0, highest * 1.1)
    style.quiet(axes)


def draw_distances(axes: Axes, panel: Panel) -> None:
    """Draw a line for each pair, the required distance and the least one."""
    lines, least, required_m = panel.lines, panel.least, panel.required_m
    for i, distance in enumerate(lines.distance_m):
        first, second = lines.pairs[i] if lines.pairs else (i, i)
        axes.plot(
            lines.t_s, distance, color=style.vehicle_colour(first), linewidth=1.3,
            linestyle=style.vehicle_dashes(first), zorder=3,
        )  # fmt: skip
        if first != second:
            axes.plot(lines.t_s, distance, color=style.vehicle_colour(second), linewidth=1.3, dashes=(4, 4), zorder=3.1)
    on_left = least is None or least.t_s is None or least.t_s < 0.5 * axes.get_xlim()[1]
    if required_m > 0:
        axes.axhspan(1e-3, required_m, color=style.BAD, alpha=0.09, linewidth=0, zorder=0)
        axes.axhline(required_m, color=style.BAD, linewidth=0.9, zorder=2)
        axes.annotate(
            f"required {required_m:g} m", xy=(1 if on_left else 0, required_m), xycoords=("axes fraction", "data"),
            xytext=(-4 if on_left else 4, -3), textcoords="offset points", color=style.BAD, fontsize=7.5,
            ha="right" if on_left else "left", va="top",
        )  # fmt: skip
    if least is not None and least.t_s is not None:
        colour = style.INK if least.ok else style.BAD
        axes.plot(least.t_s, least.distance_m, "o", color=colour, markersize=5, markeredgecolor="white", zorder=6)
        axes.annotate(
            f"least {least.distance_m:.1f} m", xy=(least.t_s, least.distance_m), zorder=7,
            xytext=(6 if on_left else -6, -11), textcoords="offset points", fontsize=7.5, fontweight="bold",
            color=colour, ha="left" if on_left else "right", va="center", path_effects=style.halo(2.2),
        )  # fmt: skip


def _name_key(figure: Figure, facts: Facts, height: float) -> None:
    """Write the vehicles' names in their colours, in one row."""
    shown = facts.vehicles[:_NAMED_LINES]
    left = 0.07
    for v in shown:
        figure.text(left, height, "●", color=style.vehicle_colour(v.index), fontsize=8, va="center")
        figure.text(left + 0.014, height, v.name, color=style.INK, fontsize=8, va="center")
        left += 0.03 + 0.0078 * len(v.name)
    if len(facts.vehicles) > len(shown):
        figure.text(
            left, height, f"and {len(facts.vehicles) - len(shown)} more", color=style.MUTED, fontsize=8, va="center"
        )


def _distance_axis(axes: Axes, length_m: float) -> None:
    if length_m > 2500:
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 1000:g}"))
        axes.set_xlabel("horizontal distance along the path (km)")
    else:
        axes.set_xlabel("horizontal distance along the path (m)")
    axes.xaxis.set_major_locator(MaxNLocator(10, steps=[1, 2, 5, 10]))


def _plain_log(axes: Axes) -> None:
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_locator(LogLocator(subs=()))


def _clearance_words(clearance: Clearance) -> str:
    thing = "above ground" if clearance.what == "terrain" else f"to {clearance.what}"
    return f"{floored(clearance.distance_m, 1)} m {thing} (needs {clearance.required_m:g})"


def _arrival_words(v: VehicleFacts) -> str:
    words = f"{v.plan.arrival_s:.1f} s"
    if v.flown is None:
        return words
    if v.flown.record.arrival_s is None:
        return f"{words}, never arrived"
    return f"{words}, flown {v.flown.record.arrival_s - v.plan.arrival_s:+.2f} s"


def _profile_key(
    required_m: float, tube_m: float, *, circles: bool, ceiling: bool, flown: bool, red: bool, unknown: bool
) -> str:
    tube = f"shaded: tube, {tube_m:g} m around{', more where it circles' if circles else ''}"
    words = ["coloured: legs, waypoints"] + [tube] * (tube_m > 0.0)
    words += ["red: not proven"] * red + [f"amber: {required_m:g} m above ground, to be kept clear"]
    words += ["pale red: ground unknown"] * unknown + ["red dashes: ceiling"] * ceiling + ["black: flown"] * flown
    return "    ".join(words)
