"""Pictures of a replay: a recorded flight beside its plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from missionplanner.geodesy import FloatArray
from missionplanner.replay import FleetReplay, VehicleReplay
from missionplanner.report import charts, style
from missionplanner.report.facts import distances

_NAMED = 10
_LEAST_SPAN = {"m": 1.0, "s": 0.5}  # of an axis: noise shall not look like an error


def ways(fleet: FleetReplay) -> Figure:
    """Draw the planned paths from above, and the flown tracks on them."""
    points = np.concatenate([v.plan.trajectory.position_m[:, :2] for v in fleet.vehicles])
    points = np.concatenate([points, *(v.flown.trajectory.position_m[:, :2] for v in fleet.vehicles)])
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 0.12 * float(np.max(high - low)) + 10.0)
    middle = 0.5 * (low + high)
    height_in = float(np.clip(8.9 * span[1] / span[0], 2.2, 8.0))
    figure = style.new_figure(height_in + 0.75)
    axes = figure.add_axes((0.07, 0.45 / (height_in + 0.75), 0.915, height_in / (height_in + 0.75)))
    for i, v in enumerate(fleet.vehicles):
        colour = style.vehicle_colour(i)
        path = v.plan.trajectory.position_m
        axes.plot(path[:, 0], path[:, 1], color=colour, linewidth=4.0, alpha=0.28, solid_capstyle="round", zorder=2)
        way = v.flown.trajectory.position_m
        axes.plot(way[:, 0], way[:, 1], color=colour, linewidth=1.0, linestyle=style.vehicle_dashes(i), zorder=3)
        axes.plot(
            *v.plan.waypoints_m[:, :2].T, linestyle="none", marker="o", markersize=3.0, zorder=4,
            markerfacecolor="white", markeredgecolor=colour, markeredgewidth=0.9,
        )  # fmt: skip
    room = 0.55 * np.maximum(span, span[::-1] * np.array([8.9 / height_in, height_in / 8.9]))
    axes.set_xlim(middle[0] - room[0], middle[0] + room[0])
    axes.set_ylim(middle[1] - room[1], middle[1] + room[1])
    axes.set_aspect("equal")
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    style.quiet(axes)
    _names(figure, fleet, 1.0 - 0.14 / (height_in + 0.75))
    return figure


def errors(fleet: FleetReplay) -> Figure:
    """Draw every vehicle's time, along-track, cross-track and height errors over time."""
    panels: list[tuple[str, str, Callable[[VehicleReplay], FloatArray]]] = [
        ("late (s)", "s", lambda v: np.where(v.timed, v.time_error_s, np.nan)),
        ("ahead (m)", "m", lambda v: v.along_error_m),
        ("right of path (m)", "m", lambda v: v.cross_track_m),
        ("above path (m)", "m", lambda v: v.above_m),
    ]
    figure = style.new_figure(7.4)
    for row, (label, unit, values) in enumerate(panels):
        axes = figure.add_axes((0.07, 0.065 + (3 - row) * 0.228, 0.915, 0.2))
        for i, v in enumerate(fleet.vehicles):
            colour = style.vehicle_colour(i)
            shown = v.en_route
            axes.plot(
                v.t_s[shown], values(v)[shown], color=colour, linewidth=0.9, linestyle=style.vehicle_dashes(i), zorder=3
            )
            if row == 0:
                _waypoint_dots(axes, v, colour)
        _span(axes, fleet, values, unit)
        axes.axhline(0.0, color=style.MUTED, linewidth=0.8, zorder=1)
        axes.set_xlim(0.0, _last_s(fleet))
        axes.set_ylabel(label)
        style.quiet(axes)
        if row < len(panels) - 1:
            axes.tick_params(axis="x", labelbottom=False)
        else:
            axes.set_xlabel("time since mission start (s)")
    _names(figure, fleet, 0.975)
    words = "up to each arrival; late: while the plan moves; dots: at waypoints"
    figure.text(0.985, 0.975, words, color=style.MUTED, fontsize=7.5, ha="right", va="center")
    return figure


def arrivals(fleet: FleetReplay) -> Figure:
    """Draw planned and flown arrivals, one row per vehicle."""
    count = len(fleet.vehicles)
    row_in = 0.3 if count <= 12 else max(0.12, 3.6 / count)
    height_in = 0.95 + row_in * count
    figure = style.new_figure(height_in)
    axes = figure.add_axes((0.12, 0.5 / height_in, 0.72, 1 - 0.9 / height_in))
    for i, v in enumerate(fleet.vehicles):
        colour, planned_s, flown_s = style.vehicle_colour(i), v.plan.arrival_s, v.flown.arrival_s
        if flown_s is not None:
            axes.plot([planned_s, flown_s], [i, i], color=colour, linewidth=2.2, alpha=0.5, zorder=3)
            axes.plot(
                flown_s, i, marker="D", markersize=4.6, linestyle="none", zorder=6,
                markerfacecolor="none", markeredgecolor=style.INK, markeredgewidth=1.1,
            )  # fmt: skip
        axes.plot(planned_s, i, marker="o", color=colour, markersize=6, markeredgecolor="white", zorder=5)
        if row_in >= 0.2:
            words = "never arrived" if flown_s is None else f"{flown_s:.1f} s, {flown_s - planned_s:+.2f} s"
            axes.annotate(
                words, xy=(1, i), xycoords=("axes fraction", "data"), xytext=(6, 0), textcoords="offset points",
                fontsize=7.5, va="center", color=style.BAD if flown_s is None else style.INK,
            )  # fmt: skip
    times = [t for v in fleet.vehicles for t in (v.plan.arrival_s, v.flown.arrival_s) if t is not None]
    room = max(max(times) - min(times), 2.0)
    axes.set_xlim(min(times) - 0.15 * room, max(times) + 0.15 * room)
    axes.set_ylim(count - 0.5, -0.5)
    step = 1 if row_in >= 0.2 else int(np.ceil(0.2 / row_in))
    axes.set_yticks(range(0, count, step), [v.plan.name for v in fleet.vehicles][::step])
    axes.tick_params(axis="y", length=0, labelcolor=style.INK)
    axes.set_xlabel("time since mission start (s)")
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.grid(True, axis="x")
    axes.set_axisbelow(True)
    axes.spines["left"].set_visible(False)
    figure.text(0.12, 1 - 0.2 / height_in, "●  planned     ◇  flown", color=style.MUTED, fontsize=7.5, va="center")
    return figure


def apart(fleet: FleetReplay) -> Figure:
    """Draw the distances between the flown vehicles over time beside the required separation."""
    least = fleet.separation
    instants = [least.t_s] if least is not None and least.t_s is not None else []
    lines = distances([v.flown.trajectory for v in fleet.vehicles], instants)
    figure = style.new_figure(2.9)
    axes = figure.add_axes((0.07, 0.155, 0.915, 0.72))
    panel = charts.Panel("", lines, least, 0.0 if least is None else least.required_m)
    axes.set_xlim(0.0, float(lines.t_s[-1]))
    axes.set_xlabel("time since mission start (s)")
    axes.set_ylabel("distance (m)")
    charts.distance_scale(axes, [panel])
    charts.draw_distances(axes, panel)
    _names(figure, fleet, 0.945)
    return figure


def _waypoint_dots(axes: Axes, v: VehicleReplay, colour: str) -> None:
    known = [(w.flown_s, w.error_s) for w in v.waypoints if w.flown_s is not None]
    if known:
        axes.plot(
            *zip(*known, strict=True), linestyle="none", marker="o", markersize=3.0, color=colour,
            markeredgecolor="white", markeredgewidth=0.5, zorder=4,
        )  # fmt: skip


def _span(axes: Axes, fleet: FleetReplay, values: Callable[[VehicleReplay], FloatArray], unit: str) -> None:
    """Let an axis span all values, but no less than what can be told from noise."""
    found = [*(values(v)[v.en_route] for v in fleet.vehicles), np.zeros(1)]
    low, high = float(np.nanmin(np.concatenate(found))), float(np.nanmax(np.concatenate(found)))
    if unit == "s":
        late = [w.error_s for v in fleet.vehicles for w in v.waypoints if w.error_s is not None]
        low, high = min([low, *late]), max([high, *late])
    least = _LEAST_SPAN[unit]
    low, high = min(low, -least), max(high, least)
    room = 0.06 * (high - low)
    axes.set_ylim(low - room, high + room)


def _last_s(fleet: FleetReplay) -> float:
    return max(float(v.t_s[v.en_route][-1]) for v in fleet.vehicles)


def _names(figure: Figure, fleet: FleetReplay, height: float) -> None:
    """Write the vehicles' names in their colours, in one row."""
    shown: Sequence[VehicleReplay] = fleet.vehicles[:_NAMED]
    left = 0.07
    for i, v in enumerate(shown):
        figure.text(left, height, "●", color=style.vehicle_colour(i), fontsize=8, va="center")
        figure.text(left + 0.014, height, v.plan.name, color=style.INK, fontsize=8, va="center")
        left += 0.03 + 0.0078 * len(v.plan.name)
    if len(fleet.vehicles) > len(shown):
        more = f"and {len(fleet.vehicles) - len(shown)} more"
        figure.text(left, height, more, color=style.MUTED, fontsize=8, va="center")
