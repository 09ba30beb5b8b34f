"""The maps: relief, obstacles, towers and paths from above, with everything that explains them beside the map."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon, Rectangle
from matplotlib.ticker import FuncFormatter, MaxNLocator

from missionplanner.geodesy import FloatArray
from missionplanner.report import style
from missionplanner.report.facts import Course, Sketch
from missionplanner.report.labels import Labels
from missionplanner.report.relief import (
    HAIR,
    Box,
    Ground,
    contour_interval_m,
    contour_levels_m,
    relief_colours,
    sample_ground,
)
from missionplanner.report.shapes import HANGING, Shape

_MAP_WIDTH_IN = 7.3
_MAP_LEFT_IN = 0.36
_MAP_BOTTOM_IN = 0.62
_SCALE_BOTTOM_IN = 0.26
_ROW_IN = 0.185
_SITE_SHARE = 0.2
_EDGE_IN = 0.05
_OBSTACLES_WIDEN, _FENCE_WIDENS = 1.5, 1.8  # at most, the map
_CONTOUR_LABELS_APART_PX = 260.0
_NAMED_VEHICLES = 14
_NAMED_LEGS = 12
_NUMBERED = 40
_SAME_PLACE_M = 1.0
_KINDS = {
    "cylinder": "mast or building",
    "cone": "peak",
    "radar": "radar zone",
    "soft radar": "radar zone, priced only",
    "marine": "marine hazard",
    "no_fly": "no-fly zone",
    "cable": "cable",
    "conductor": "conductors of the line",
    "tower": "tower of the line",
    "line": "another line",
}
_TOWER_WORDS = {
    "planned": "tower, by its vehicle",
    "left out": "tower left out",
    "done before": "tower done before",
}
_CONDUCTOR: dict[str, Any] = {"color": "#55606a", "linewidth": 6.2, "alpha": 0.55, "solid_capstyle": "butt"}
_BAND: dict[str, Any] = {"linewidth": 7.5, "alpha": 0.85}
_AROUND: dict[str, Any] = {"linewidth": 1.2, "linestyle": (0, (3, 1.5))}
_OTHER: dict[str, Any] = {"color": style.MUTED, "linewidth": 1.0, "alpha": 0.75}
_FENCE: dict[str, Any] = {"color": style.FENCE, "linewidth": 1.3, "linestyle": (0, (7, 2, 1.5, 2))}
_FILL_ALPHA = {"cylinder": 0.55, "cone": 0.35, "radar": 0.18, "soft radar": 0.08, "marine": 0.30, "no_fly": 0.14}


def fleet_map(facts: Sketch, shapes: Sequence[Shape]) -> Figure:
    """Draw the whole mission from above."""
    return _map(facts, shapes, map_box(facts, shapes), _Extra())


def vehicle_map(facts: Sketch, shapes: Sequence[Shape], vehicle: Course, places_m: Mapping[str, FloatArray]) -> Figure:
    """Draw one vehicle's way from above, with places (3,) on it by their numbers, and the others' ways faintly."""
    own = Sketch(facts.scene, (vehicle,), tuple(f for f in facts.findings if f.vehicle == vehicle.name))
    others = [other.way_m[:, :2] for other in facts.vehicles if other.index != vehicle.index]
    return _map(own, shapes, map_box(own, shapes, towers=False), _Extra(places_m, others))


@dataclass(frozen=True, slots=True, eq=False)
class TowerMark:
    """A tower (3,) and the colours of the vehicles that inspect it."""

    place_m: FloatArray
    colours: tuple[str, ...]
    status: Literal["planned", "left out", "done before"]


def inspection_map(facts: Sketch, shapes: Sequence[Shape], towers: Sequence[TowerMark]) -> Figure:
    """Draw the ways of an inspection's vehicles from above, with its towers by who inspects them."""
    return _map(facts, shapes, map_box(facts, shapes), _Extra(towers=towers))


@dataclass(frozen=True, slots=True, eq=False)
class _Extra:
    """What a map shows besides: numbered places on the ways, ways (N, 2) of vehicles that it is not about, towers."""

    places_m: Mapping[str, FloatArray] = field(default_factory=dict)
    others_m: Sequence[FloatArray] = ()
    towers: Sequence[TowerMark] = ()


def ground_map(facts: Sketch, box: Box) -> tuple[Figure, Axes, Ground]:
    """Draw the ground alone, with room beside it for :func:`side_panel`."""
    height_in = _MAP_WIDTH_IN * (box[3] - box[1]) / (box[2] - box[0])
    figure = style.new_figure(height_in + _MAP_BOTTOM_IN + 0.12)
    axes = _map_axes(figure, box, _MAP_LEFT_IN, _MAP_WIDTH_IN, height_in)
    ground = _draw_ground(axes, facts, box, columns=620)
    _scale_bar(figure, box, _MAP_LEFT_IN, _MAP_WIDTH_IN)
    return figure, axes, ground


def _map(facts: Sketch, shapes: Sequence[Shape], box: Box, extra: _Extra) -> Figure:
    figure, axes, ground = ground_map(facts, box)
    drawn = [s for s in shapes if overlaps(s.outline_m, box)]
    axes.add_collection(LineCollection(extra.others_m, zorder=5.2, **_OTHER))
    for tower in extra.towers:
        axes.plot(*tower.place_m[:2], zorder=9.5, **_tower_mark(tower.status, tower.colours))
    _draw_all(axes, facts, drawn, ground, extra)
    side_panel(figure, facts, box, _legend(facts, drawn, ground, box, extra))
    return figure


def detail_maps(facts: Sketch, shapes: Sequence[Shape]) -> Figure | None:
    """Draw where the fleet takes off and where it ends, if these are too small to be seen on the whole map."""
    whole = map_box(facts, shapes)
    across = min(whole[2] - whole[0], whole[3] - whole[1])
    sites = {
        "Take-off": np.array([v.home_m for v in facts.vehicles]),
        "Goals": np.array([v.waypoints_m[-1] for v in facts.vehicles]),
    }
    both = np.concatenate(list(sites.values()))
    if _extent_m(both) < _SITE_SHARE * across:
        sites = {"Take-off and goals": both}
    small = {title: places for title, places in sites.items() if _extent_m(places) < _SITE_SHARE * across}
    if not small:
        return None
    height_in = 4.1
    width_in = height_in if len(small) > 1 else style.WIDTH_IN - _MAP_LEFT_IN - _EDGE_IN
    figure = style.new_figure(height_in + 0.95)
    for i, (title, places) in enumerate(small.items()):
        middle = (places.min(axis=0) + places.max(axis=0))[:2] / 2
        half = max(0.85 * _extent_m(places), 0.02 * across, 40.0)
        wide = half * width_in / height_in
        box = (middle[0] - wide, middle[1] - half, middle[0] + wide, middle[1] + half)
        left = _MAP_LEFT_IN + i * (width_in + 0.75)
        axes = _map_axes(figure, box, left, width_in, height_in)
        ground = _draw_ground(axes, facts, box, columns=300)
        _draw_all(axes, facts, [s for s in shapes if overlaps(s.outline_m, box)], ground, _Extra())
        axes.set_title(title, loc="left", fontsize=9, fontweight="bold", color=style.INK, pad=5)
        _scale_bar(figure, box, left, width_in)
    return figure


def _extent_m(places: FloatArray) -> float:
    return float(np.ptp(places[:, :2], axis=0).max())


def map_box(
    facts: Sketch,
    shapes: Sequence[Shape],
    least_ratio: tuple[float, float] = (0.95, 0.52),
    *,
    towers: bool = True,
    also_m: Sequence[FloatArray] = (),
) -> Box:
    """Return what the map shows: all paths, homes and towers; obstacles and fence where they are not much farther.

    ``also_m``: other lines (N, 2) that it shows.

    Width to height and height to width are at least ``least_ratio``.
    """
    places = [v.path_m[:, :2] for v in facts.vehicles] + [v.home_m[None, :2] for v in facts.vehicles]
    places += [v.flown.record.trajectory.position_m[:, :2] for v in facts.vehicles if v.flown]
    if towers and facts.scene.towers is not None:
        places.append(facts.scene.towers.top_m[:, :2])
    everything = np.concatenate([*places, *also_m])
    low, high = everything.min(axis=0), everything.max(axis=0)
    shown = _shown_size(high - low, least_ratio)
    extras = [(s.outline_m, _OBSTACLES_WIDEN) for s in shapes]
    if len(facts.scene.space.fence):
        extras.append((facts.scene.space.fence, _FENCE_WIDENS))
    for extra, widen in extras:
        wider_low, wider_high = np.minimum(low, extra.min(axis=0)), np.maximum(high, extra.max(axis=0))
        if np.all(wider_high - wider_low <= widen * shown):
            low, high = wider_low, wider_high
    size = _shown_size(high - low, least_ratio)
    west, south = (low + high - size) / 2
    east, north = (low + high + size) / 2
    return float(west), float(south), float(east), float(north)


def _shown_size(extent_m: FloatArray, least_ratio: tuple[float, float]) -> FloatArray:
    """Return the width and height (2,) of a picture of this extent: a rim all around, and never too slim."""
    size = np.maximum(extent_m, 60.0) * 1.12
    return np.maximum(size, [size[1] * least_ratio[0], size[0] * least_ratio[1]])


def overlaps(outline_m: FloatArray, box: Box) -> bool:
    """Return whether an outline's bounding box and a box share a place."""
    low, high = outline_m.min(axis=0), outline_m.max(axis=0)
    return bool(low[0] < box[2] and high[0] > box[0] and low[1] < box[3] and high[1] > box[1])


def within(line_m: FloatArray, box: Box) -> FloatArray:
    """Return those points of a line (N, 2 or 3) that lie in a box."""
    x, y = line_m[:, 0], line_m[:, 1]
    return line_m[(x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])]


def fence_sides(facts: Sketch) -> list[FloatArray]:
    """Return the fence's sides, each as many points (N, 2)."""
    fence = facts.scene.space.fence
    return [np.linspace(a, b, 240) for a, b in zip(fence, np.roll(fence, -1, axis=0), strict=True)]


def _map_axes(figure: Figure, box: Box, left_in: float, width_in: float, height_in: float) -> Axes:
    whole = figure.get_size_inches()
    axes = figure.add_axes((left_in / whole[0], _MAP_BOTTOM_IN / whole[1], width_in / whole[0], height_in / whole[1]))
    axes.set_xlim(box[0], box[2])
    axes.set_ylim(box[1], box[3])
    for spine in axes.spines.values():
        spine.set_visible(True)
        spine.set_color(style.MUTED)
        spine.set_zorder(30)
    kilometres = box[2] - box[0] > 3000
    words = FuncFormatter(lambda value, _: f"{value / 1000:g}" if kilometres else f"{value:g}")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
        axis.set_major_formatter(words)
    axes.tick_params(length=2.5, width=0.6, labelsize=7, pad=2)
    axes.tick_params(axis="y", labelrotation=90)
    for label in axes.get_yticklabels():
        label.set_verticalalignment("center")
    return axes


def _draw_ground(axes: Axes, facts: Sketch, box: Box, columns: int) -> Ground:
    ground = sample_ground(facts.scene.terrain, box, columns)
    sea = any(o.kind == "marine" for o in facts.scene.mission.obstacles)
    colours = relief_colours(ground, sea=sea)
    extent = (box[0], box[2], box[1], box[3])
    axes.imshow(colours, extent=extent, origin="lower", interpolation="bilinear", aspect="auto", zorder=0)
    levels = contour_levels_m(ground)
    if levels.size:
        nth = np.round(levels / contour_interval_m(ground.relief_m))
        axes.contour(
            ground.x_m, ground.y_m, ground.height_amsl_m, levels=levels, colors="#7c6a50", alpha=0.55, zorder=1,
            linewidths=np.where(nth % 5 == 0, 0.8, 0.4),
        )  # fmt: skip
    return ground


def _draw_all(axes: Axes, facts: Sketch, shapes: Sequence[Shape], ground: Ground, extra: _Extra) -> None:
    labels = Labels(axes)
    _draw_fence(axes, facts)
    for shape in shapes:
        _draw_shape(axes, shape)
    for v in facts.vehicles:
        _draw_legs(axes, v)
        _draw_vehicle(axes, v)
        labels.avoid_line(v.way_m)
        labels.avoid_mark(v.home_m, 4.5)
        labels.avoid_mark(v.waypoints_m[-1], 5.0)
    _label_vehicles(labels, facts)
    _label_places(axes, labels, extra.places_m)
    _label_open_legs(axes, labels, facts)
    _label_shapes(axes, labels, named(shapes))
    _label_towers(labels, facts, 4.5 if extra.towers else 2.6)
    _label_contours(axes, labels, ground)


def _draw_fence(axes: Axes, facts: Sketch) -> None:
    fence = facts.scene.space.fence
    if len(fence):
        outline = np.concatenate([fence, fence[:1]])
        axes.plot(outline[:, 0], outline[:, 1], color="white", linewidth=2.6, zorder=4.0)
        axes.plot(outline[:, 0], outline[:, 1], zorder=4.1, **_FENCE)


def _kind(shape: Shape) -> str:
    return "soft radar" if shape.kind == "radar" and not shape.hard else shape.kind


def _draw_shape(axes: Axes, shape: Shape) -> None:
    colour = style.OBSTACLE_COLOURS.get(shape.kind, style.STEEL)
    outline = shape.outline_m
    if shape.kind in HANGING:
        if shape.kind == "conductor":  # wide enough to show on both sides of a path that follows the line
            axes.plot(outline[:, 0], outline[:, 1], zorder=4.5, **_CONDUCTOR)
        else:
            axes.plot(outline[:, 0], outline[:, 1], color="white", linewidth=2.9, zorder=4.4)
            axes.plot(outline[:, 0], outline[:, 1], color=colour, linewidth=1.5, zorder=4.5)
        if shape.kind == "cable":
            axes.plot(
                outline[:, 0], outline[:, 1], linestyle="none", marker="|", markersize=6, color=colour,
                markeredgewidth=1.5, zorder=4.6,
            )  # fmt: skip
        return
    if shape.kind in ("tower", "support"):
        axes.plot(
            *shape.centre_m, marker="s", markersize=3.4, color=colour, markeredgecolor="white",
            markeredgewidth=0.6, zorder=8.5,
        )  # fmt: skip
        return
    hatch = {"no_fly": "////", "marine": "....", "radar": "" if shape.hard else "...."}.get(shape.kind)
    axes.add_patch(
        Polygon(outline, closed=True, facecolor=colour, alpha=_FILL_ALPHA[_kind(shape)], linewidth=0, zorder=3)
    )
    if hatch:
        axes.add_patch(Polygon(outline, fill=False, edgecolor=colour, alpha=0.45, linewidth=0, hatch=hatch, zorder=3.1))
    dashes = (0, (4, 2)) if shape.kind == "radar" else "solid"
    axes.add_patch(
        Polygon(outline, closed=True, fill=False, edgecolor=colour, linewidth=1.0, linestyle=dashes, zorder=3.2)
    )
    if shape.kind == "cone":
        for share in (0.33, 0.66):
            ring = shape.centre_m + share * (outline - shape.centre_m)
            axes.plot(ring[:, 0], ring[:, 1], color=colour, linewidth=0.5, zorder=3.2)
        axes.plot(*shape.centre_m, marker="^", markersize=4, color=colour, zorder=3.3)
    # too small to be seen at this scale: a mark of its own
    across_px = np.ptp(axes.transData.transform(outline)[:, 0])
    if across_px < 5.0 * axes.figure.dpi / 72.0:
        axes.plot(
            *shape.centre_m, marker="X" if shape.kind == "cylinder" else "o", markersize=6.5, color=colour,
            markeredgecolor="white", markeredgewidth=0.7, zorder=8.6,
        )  # fmt: skip


def _draw_legs(axes: Axes, v: Course) -> None:
    """Draw each leg as a wide band that shows through beside the path, those with the least to spare on top."""
    legs = sorted(v.legs, key=lambda leg: (not leg.proven, -leg.room_m))
    colours = [style.room_colour(leg.room_m, proven=leg.proven) for leg in legs]
    axes.add_collection(LineCollection([leg.line_m[:, :2] for leg in legs], colors=colours, zorder=5.5, **_BAND))
    around = [leg.line_m[:, :2] for leg in legs if leg.ends or leg.kind == "takeoff"]
    axes.add_collection(LineCollection(around, colors=style.vehicle_colour(v.index), zorder=5.9, **_AROUND))


def _flown_besides(v: Course) -> bool:
    """Return whether there is a flight over ground before the first waypoint or after the last."""
    return any(np.ptp(leg.line_m[:, :2], axis=0).max() > 1.0 for leg in v.legs if leg.ends or leg.kind == "takeoff")


def _draw_vehicle(axes: Axes, v: Course) -> None:
    colour, dashes = style.vehicle_colour(v.index), style.vehicle_dashes(v.index)
    path, waypoints, home = v.way_m, v.waypoints_m, v.home_m
    axes.plot(path[:, 0], path[:, 1], color="white", linewidth=3.9, zorder=6, alpha=0.85, solid_capstyle="round")
    axes.plot(path[:, 0], path[:, 1], color=colour, linewidth=2.3, linestyle=dashes, zorder=7)
    pixels = axes.transData.transform(waypoints[:, :2])
    steps = np.linalg.norm(np.diff(pixels, axis=0), axis=-1)
    if len(steps) and np.median(steps) * 72.0 / axes.figure.dpi > 6.0:
        axes.plot(waypoints[1:-1, 0], waypoints[1:-1, 1], linestyle="none", zorder=8, **_ring("o", 2.8, colour, 0.9))
    if v.flown:
        track = v.flown.record.trajectory.position_m
        track = track[:: max(1, len(track) // 3000)]
        axes.plot(track[:, 0], track[:, 1], color=style.INK, linewidth=0.5, zorder=9)
    axes.plot(home[0], home[1], zorder=10, **_ring("s", 6.0, colour, 1.8))
    axes.plot(
        waypoints[-1, 0], waypoints[-1, 1], marker="o", markersize=7.5, color=colour, markeredgecolor="white",
        markeredgewidth=1.2, zorder=10,
    )  # fmt: skip


def _label_vehicles(labels: Labels, facts: Sketch) -> None:
    names = [v.name for v in facts.vehicles]
    colours = [style.vehicle_colour(v.index) for v in facts.vehicles]
    homes = np.array([v.home_m for v in facts.vehicles])
    goals = np.array([v.waypoints_m[-1] for v in facts.vehicles])
    labels.place_group(names, colours, homes, f"{len(homes)} homes")
    apart = np.flatnonzero(np.hypot(*(goals - homes)[:, :2].T) > _SAME_PLACE_M)
    if apart.size:
        told = [names[i] for i in apart], [colours[i] for i in apart]
        labels.place_group(*told, goals[apart], f"{apart.size} goals")


def _label_places(axes: Axes, labels: Labels, places_m: Mapping[str, FloatArray]) -> None:
    for place_m in places_m.values():
        axes.plot(place_m[0], place_m[1], marker="o", markersize=3.6, color=style.INK, zorder=10.5)
        labels.avoid_mark(place_m, 2.2)
    for number, place_m in places_m.items():
        labels.place(number, place_m, size=7, gap_pt=3, must=len(places_m) <= _NUMBERED, fontweight="bold")


def _label_open_legs(axes: Axes, labels: Labels, facts: Sketch) -> None:
    """Write the item's number at every leg that is not proven and can be seen."""
    open_ = [leg for v in facts.vehicles for leg in v.legs if not leg.proven]
    box = (*axes.get_xlim(), *axes.get_ylim())
    for leg in open_:
        inside = within(leg.line_m, (box[0], box[2], box[1], box[3]))
        middle = leg.line_m.mean(axis=0) if len(leg.line_m) == 2 or not len(inside) else inside[len(inside) // 2]
        must = len(open_) <= _NAMED_LEGS
        labels.place(f"item {leg.seq}", middle, size=8, gap_pt=7, must=must, fontweight="bold", color=style.BAD)


def _label_shapes(axes: Axes, labels: Labels, shapes: Sequence[Shape]) -> None:
    """Name obstacles: the large ones inside, the small ones beside."""
    for shape in shapes:
        colour = style.OBSTACLE_COLOURS.get(shape.kind, style.STEEL)
        must = len(shapes) <= 25
        if shape.kind in HANGING:
            labels.place(shape.name, shape.centre_m, size=7.5, must=must, color=colour)
            continue
        across_pt = float(np.ptp(axes.transData.transform(shape.outline_m), axis=0).min()) * 72.0 / axes.figure.dpi
        roomy = across_pt > 9.0 + 5.5 * len(shape.name)
        if roomy and labels.place(shape.name, shape.centre_m, size=7.5, centred=True, color=colour):
            continue
        gap_pt = 3.0 + (0.0 if roomy else max(across_pt / 2, 3.5))
        labels.place(shape.name, shape.centre_m, size=7.5, gap_pt=gap_pt, must=must, color=colour)


def named(shapes: Sequence[Shape]) -> list[Shape]:
    """Return the obstacles that are named: of towers only some are, of other lines the middle span."""
    lines: dict[str, list[Shape]] = {}
    for shape in shapes:
        if shape.kind == "line":
            lines.setdefault(shape.name, []).append(shape)
    unnamed = ("tower", "conductor", "support", "line")
    return [
        *(shape for shape in shapes if shape.kind not in unnamed),
        *(spans[len(spans) // 2] for spans in lines.values()),
    ]


def _label_towers(labels: Labels, facts: Sketch, mark_pt: float) -> None:
    """Name the first and the last tower, then as many between them as have room, evenly."""
    towers = facts.scene.towers
    if towers is None:
        return
    for top in towers.top_m:
        labels.avoid_mark(top, mark_pt)
    for span in facts.scene.spans:
        labels.avoid_line(span.curve_m)
    count = len(towers.names)
    order = [0, count - 1]
    for step in (10, 5, 2, 1):
        order += [i for i in range(0, count, step) if i not in order]
    for i in dict.fromkeys(order):
        labels.place(towers.names[i], towers.top_m[i], size=6, gap_pt=mark_pt + 0.9, color=style.STEEL)


def _label_contours(axes: Axes, labels: Labels, ground: Ground) -> None:
    """Write altitudes on the thick contours, where nothing else is."""
    interval = contour_interval_m(ground.relief_m)
    if not contour_levels_m(ground).size:
        return
    z, interval = ground.height_amsl_m - HAIR * interval, 5 * interval
    written: dict[float, list[FloatArray]] = {}
    for row in np.linspace(0.12, 0.88, 6) * (len(ground.y_m) - 1):
        heights = z[int(row)]
        over = np.floor(heights / interval)
        for column in np.flatnonzero(np.abs(np.diff(over)) == 1):
            level = max(over[column], over[column + 1]) * interval
            place = np.array([ground.x_m[column], ground.y_m[int(row)]])
            pixel = axes.transData.transform(place)
            others = written.setdefault(level, [])
            if all(math.dist(pixel, other) > _CONTOUR_LABELS_APART_PX for other in others) and labels.place(
                f"{level:g}", place, size=6, centred=True, color="#6b5a42"
            ):
                others.append(pixel)


def _scale_bar(figure: Figure, box: Box, left_in: float, width_in: float) -> None:
    metres = box[2] - box[0]
    rough = metres / 5.0
    decade = 10.0 ** math.floor(math.log10(rough))
    length = max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= rough)
    whole = figure.get_size_inches()
    bar_in = length / metres * width_in
    x0, x1, y = left_in / whole[0], (left_in + bar_in) / whole[0], _SCALE_BOTTOM_IN / whole[1]
    tick = 0.035 / whole[1]
    figure.add_artist(Line2D([x0, x0, x1, x1], [y + tick, y, y, y + tick], color=style.INK, linewidth=1.3))
    middle = (x0 + x1) / 2
    figure.add_artist(Line2D([middle, middle], [y, y + tick], color=style.INK, linewidth=0.8))
    words = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    figure.text(x1 + 0.07 / whole[0], y, words, fontsize=7.5, va="center")
    kilometres = metres > 3000
    figure.text(
        (left_in + width_in) / whole[0], y, f"grid: {'km' if kilometres else 'm'} east and north of the origin",
        fontsize=7, color=style.MUTED, ha="right", va="center",
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class LegendRow:
    """A line of the legend: its words, and how its line and its mark are drawn."""

    text: str
    line: dict[str, Any] | None = None
    mark: dict[str, Any] | None = None


def side_panel(figure: Figure, facts: Sketch, box: Box, legend: Sequence[tuple[str, Sequence[LegendRow]]]) -> None:
    """Draw north arrow, legend and, for a large area, an overview: beside the map, so nothing is covered."""
    whole = figure.get_size_inches()
    left_in = _MAP_LEFT_IN + _MAP_WIDTH_IN + 0.16
    width_in = whole[0] - left_in - _EDGE_IN
    axes = figure.add_axes((left_in / whole[0], 0.0, width_in / whole[0], 1.0))
    axes.set_xlim(0, width_in)
    axes.set_ylim(0, whole[1])
    axes.set_axis_off()
    top = whole[1] - 0.14
    _north_arrow(axes, width_in - 0.16, top)
    _wind_arrow(axes, facts, width_in - 0.62, top)
    y = top - 0.02
    for title, rows in legend:
        axes.text(0.0, y, title, fontsize=8, fontweight="bold", va="center")
        y -= _ROW_IN * 1.1
        for row in rows:
            if row.line:
                axes.add_line(Line2D([0.02, 0.30], [y, y], **row.line))
            if row.mark:
                axes.add_line(Line2D([0.16], [y], linestyle="none", **row.mark))
            axes.text(0.40, y, row.text, fontsize=7.5, va="center")
            y -= _ROW_IN
        y -= 0.1
    _overview(figure, facts, box, left_in, y)


def _north_arrow(axes: Axes, x: float, top: float) -> None:
    tip, notch = (x, top + 0.08), (x, top - 0.15)
    axes.add_patch(Polygon([tip, (x - 0.075, top - 0.22), notch], color=style.INK, linewidth=0))
    axes.add_patch(
        Polygon([tip, (x + 0.075, top - 0.22), notch], facecolor="white", edgecolor=style.INK, linewidth=0.7)
    )
    axes.text(x, top - 0.30, "N", fontsize=8, fontweight="bold", ha="center", va="center")


def _wind_arrow(axes: Axes, facts: Sketch, x: float, top: float) -> None:
    """Draw where the wind that is planned with blows to, and how strong it is."""
    wind = facts.scene.mission.wind
    if wind is None or wind.speed_m_s == 0.0:
        return
    east, north = (0.15 * part / wind.speed_m_s for part in wind.velocity_m_s)
    axes.annotate(
        "", (x + east, top - 0.07 + north), (x - east, top - 0.07 - north),
        arrowprops={"arrowstyle": "-|>", "color": style.INK, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0},
    )  # fmt: skip
    axes.text(x, top - 0.30, f"wind {wind.speed_m_s:g} m/s", fontsize=7, ha="center", va="center", color=style.INK)


def _legend(
    facts: Sketch, shapes: Sequence[Shape], ground: Ground, box: Box, extra: _Extra
) -> list[tuple[str, list[LegendRow]]]:
    shown = facts.vehicles[:_NAMED_VEHICLES]
    vehicles = [
        LegendRow(
            v.name,
            {"color": style.vehicle_colour(v.index), "linestyle": style.vehicle_dashes(v.index), "linewidth": 2.2},
        )
        for v in shown
    ]
    if len(facts.vehicles) > len(shown):
        vehicles.append(LegendRow(f"and {len(facts.vehicles) - len(shown)} more"))
    if extra.others_m:
        vehicles.append(LegendRow("other vehicles", _OTHER))
    grey = style.MUTED
    marks = [
        LegendRow("home", mark=_ring("s", 6.0, grey, 1.8)),
        LegendRow("goal", mark={"marker": "o", "markersize": 7.5, "color": grey}),
        LegendRow("waypoint", {"color": grey, "linewidth": 2.0}, _ring("o", 2.8, grey, 0.9)),
    ]
    if any(map(_flown_besides, facts.vehicles)):
        marks.append(LegendRow("take-off, way home", {"color": grey, **_AROUND}))
    if facts.flown:
        marks.append(LegendRow("flown track", {"color": style.INK, "linewidth": 0.9}))
    statuses = {tower.status for tower in extra.towers}
    for status, words in _TOWER_WORDS.items():
        if status in statuses:
            marks.append(LegendRow(words, mark=_tower_mark(status, (grey,))))
    kinds = {_kind(shape) for shape in shapes}
    things = [_key(kind) for kind in _KINDS if kind in kinds]
    if any(len(within(side, box)) for side in fence_sides(facts)):
        things.append(LegendRow("fence", _FENCE))
    if contour_levels_m(ground).size:
        interval = contour_interval_m(ground.relief_m)
        things.append(LegendRow(f"contours every {interval:g} m", {"color": "#7c6a50", "linewidth": 0.8}))
    return [
        ("Paths", vehicles),
        ("Proof: room to spare", _room_rows(facts)),
        ("Marks", marks),
        ("Obstacles and ground", things),
    ]


def _room_rows(facts: Sketch) -> list[LegendRow]:
    if not any(v.legs for v in facts.vehicles):
        return [LegendRow("nothing is proven")]
    most_m = style.ROOM_SHOWN_M
    told = ((f"{most_m:g} m or more", most_m), (f"{most_m / 2:g} m", most_m / 2), ("none, but proven", 0.0))
    rows = [
        LegendRow(text, {"color": style.room_colour(room_m), "solid_capstyle": "butt", **_BAND})
        for text, room_m in told
    ]
    return [*rows, LegendRow("not proven", {"color": style.BAD, "solid_capstyle": "butt", **_BAND})]


def _tower_mark(status: str, colours: Sequence[str]) -> dict[str, Any]:
    """Return how a tower is drawn: in the colour of who inspects it, in two halves where two do."""
    mark: dict[str, Any] = {"marker": "s", "markersize": 7.0, "markeredgecolor": "white", "markeredgewidth": 0.9}
    if status == "left out":
        return {"marker": "X", "markersize": 8.5, "color": style.BAD, "markeredgecolor": "white"}
    if status == "done before" or not colours:
        return {**mark, "color": "white", "markeredgecolor": style.MUTED}
    halves = {"fillstyle": "left", "markerfacecoloralt": colours[1]} if len(colours) > 1 else {}
    return {**mark, "color": colours[0], **halves}


def _ring(marker: str, size: float, colour: str, width: float) -> dict[str, Any]:
    return {
        "marker": marker, "markersize": size, "color": "white", "markeredgecolor": colour, "markeredgewidth": width
    }  # fmt: skip


def _key(kind: str) -> LegendRow:
    colour = style.OBSTACLE_COLOURS.get(kind.removeprefix("soft "), style.STEEL)
    if kind in HANGING:
        return LegendRow(_KINDS[kind], _CONDUCTOR if kind == "conductor" else {"color": colour, "linewidth": 1.5})
    if kind == "tower":
        return LegendRow(_KINDS[kind], mark={"marker": "s", "markersize": 3.8, "color": colour})
    mark = _ring("s" if kind == "no_fly" else "o", 8.0, colour, 1.0)
    return LegendRow(_KINDS[kind], mark={**mark, "color": to_rgba(colour, _FILL_ALPHA[kind])})


def _overview(figure: Figure, facts: Sketch, box: Box, left_in: float, top_in: float) -> None:
    """Show where the map lies in the mission's area, if that is much larger and there is room below the legend."""
    west, south, east, north = facts.scene.area_m
    if (east - west) < 1.5 * (box[2] - box[0]) and (north - south) < 1.5 * (box[3] - box[1]):
        return
    whole = figure.get_size_inches()
    width_in = whole[0] - left_in - _EDGE_IN
    height_in = width_in * (north - south) / (east - west)
    if height_in > min(2.2, top_in - 0.45):
        return
    axes = figure.add_axes((left_in / whole[0], _MAP_BOTTOM_IN / whole[1], width_in / whole[0], height_in / whole[1]))
    ground = sample_ground(facts.scene.terrain, facts.scene.area_m, 200)
    colours = relief_colours(ground, sea=False)
    axes.imshow(colours, extent=(west, east, south, north), origin="lower", interpolation="bilinear", aspect="auto")
    axes.add_patch(
        Rectangle((box[0], box[1]), box[2] - box[0], box[3] - box[1], fill=False, edgecolor=style.BAD, linewidth=1.2)
    )
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(True)
    figure.text(
        left_in / whole[0], (_MAP_BOTTOM_IN - 0.12) / whole[1],
        f"mission area, {(east - west) / 1000:.0f} by {(north - south) / 1000:.0f} km", fontsize=7, color=style.MUTED,
        va="center",
    )  # fmt: skip
