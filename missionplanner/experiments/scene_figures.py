"""Pictures of a scene and of the paths that were found in it: in space, from above, their pitch; and convergence."""

from __future__ import annotations

import io
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from PIL import Image

from missionplanner import mission
from missionplanner.experiments.scene_judge import Judge, xy
from missionplanner.files import write_atomic
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Mission

INK, MUTED, RULE = "#1d2730", "#66727d", "#d9dfe4"
COLOURS = {  # Okabe and Ito's, but their yellow; the two forms of the paper's own algorithm stand out
    "pso-abc-sa": "#d55e00",
    "pso-abc-sa-paper": "#e69f00",
    "planner": "#1d2730",
    "pso": "#0072b2",
    "pso-sa": "#56b4e9",
    "abc-sa": "#009e73",
    "qpso": "#cc79a7",
    "avoa": "#66727d",
    "ga": "#009e73",
    "gwo": "#56b4e9",
    "ssa": "#cc79a7",
}
VEHICLES = ("#0072b2", "#d55e00", "#009e73", "#aa3377", "#e69f00", "#332288", "#56b4e9")
_SOLID = {"cylinder": "#7a4a3a", "cone": "#8a6a3c", "radar": "#8e2a6b", "marine": "#0b4f6c", "no_fly": "#b3261e"}
_RELIEF = LinearSegmentedColormap.from_list("relief", ["#dfe6dc", "#e9e3d3", "#d2bfa0", "#a98c6c", "#f2efe9"])
_LEGS = 60  # more are a curve
_AROUND = np.linspace(0.0, 2.0 * np.pi, 33)


def vehicle_colours(count: int) -> list[str]:
    """Return a colour per vehicle; of many, several share one."""
    return list(itertools.islice(itertools.cycle(VEHICLES), count))


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure on a canvas of its own."""
    figure = Figure(figsize=(width_in, height_in), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save_png(path: Path, figure: Figure) -> None:
    """Write a small PNG: 128 colours are enough for these."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    small = io.BytesIO()
    Image.open(buffer).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(small, format="png", optimize=True)
    write_atomic(path, small.getvalue())


def titled(axes: Any, title: str) -> None:
    """Write a small title above axes."""
    axes.set_title(title, fontsize=8.5, color=INK)


def tidy(axes: Axes) -> None:
    """Give axes small labels and no frame above and beside."""
    axes.tick_params(labelsize=7, length=2, colors=MUTED)
    axes.xaxis.label.set_fontsize(8)
    axes.yaxis.label.set_fontsize(8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(MUTED)


def convergence(
    axes: Axes, evaluations: npt.ArrayLike, found: Mapping[str, FloatArray], titles: Mapping[str, str]
) -> None:
    """Draw the median best cost over evaluations, and between which costs half of the runs are (3, G)."""
    for name, (low, middle, high) in found.items():
        ours = name.startswith("pso-abc-sa")
        axes.fill_between(evaluations, low, high, color=COLOURS[name], alpha=0.12, linewidth=0)
        axes.plot(evaluations, middle, color=COLOURS[name], linewidth=1.8 if ours else 1.1, label=titles[name])
    axes.set_yscale("log")
    axes.set_xlim(0, float(np.max(evaluations)))
    axes.grid(True, which="both", color=RULE, linewidth=0.5)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:g}"[0] in "235" else "")
    axes.tick_params(which="minor", labelsize=6, colors=MUTED)
    axes.set(xlabel="evaluations per vehicle", ylabel="best cost, all vehicles")
    tidy(axes)


def from_above(axes: Axes, question: Mission, judge: Judge) -> None:
    """Draw ground and obstacles from above."""
    west, south, east, north = _extent(question)
    x, y = np.meshgrid(np.linspace(west, east, 160), np.linspace(south, north, 160))
    if question.terrain.kind != "flat":
        heights = judge.heights_m(x, y)
        axes.contourf(x, y, heights, 12, cmap=_RELIEF, alpha=0.9)
        axes.contour(x, y, heights, 12, colors="#8d7f6a", linewidths=0.25, alpha=0.6)
    for obstacle in question.obstacles:
        colour = _SOLID.get(obstacle.kind, INK)
        style: dict[str, Any] = {"facecolor": colour, "edgecolor": colour, "linewidth": 0.6}
        style["alpha"] = 0.25 if obstacle.kind in {"radar", "marine", "cone"} else 0.75
        match obstacle:
            case mission.NoFly():
                axes.add_patch(Polygon([xy(p) for p in obstacle.polygon], **style))
            case mission.Cone():
                axes.add_patch(Circle(xy(obstacle.center), obstacle.base_radius_m, **style))
            case mission.Cylinder() | mission.Radar() | mission.Marine():
                axes.add_patch(Circle(xy(obstacle.center), obstacle.radius_m, **style))
            case _:
                pass
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    axes.set_aspect("equal")
    tidy(axes)


def ways_from_above(axes: Axes, paths: Sequence[FloatArray], colours: Sequence[str], width: float = 1.2) -> None:
    """Draw paths (S, 3) from above, with their ends."""
    for path, colour in zip(paths, colours, strict=True):
        axes.plot(path[:, 0], path[:, 1], color="white", linewidth=width + 1.0, zorder=3)
        axes.plot(path[:, 0], path[:, 1], color=colour, linewidth=width, zorder=4)
    ends = np.concatenate([path[[0, -1]] for path in paths])
    axes.plot(ends[::2, 0], ends[::2, 1], "o", color="white", markeredgecolor=INK, markersize=3.5, zorder=5)
    axes.plot(ends[1::2, 0], ends[1::2, 1], "*", color=INK, markersize=5, zorder=5)


def in_space(axes: Any, question: Mission, judge: Judge, top_m: float, view: tuple[float, float] = (32, -68)) -> None:
    """Draw ground and obstacles in space, up to an altitude; paths come before both."""
    axes.computed_zorder = False
    west, south, east, north = _extent(question)
    x, y = np.meshgrid(np.linspace(west, east, 60), np.linspace(south, north, 60))
    ground = judge.heights_m(x, y)
    axes.plot_surface(
        x, y, ground, cmap=_RELIEF, alpha=0.9, linewidth=0, antialiased=False, rcount=60, ccount=60, zorder=1
    )
    low_m = float(ground.min())
    for obstacle in question.obstacles:
        colour = _SOLID.get(obstacle.kind, INK)
        match obstacle:
            case mission.Cylinder():
                _tube(axes, obstacle.center, (obstacle.radius_m, obstacle.radius_m), (low_m, top_m), colour)
            case mission.Cone():
                base_m = float(judge.heights_m(*map(np.asarray, xy(obstacle.center))))
                heights = (base_m, base_m + obstacle.height_m)
                _tube(axes, obstacle.center, (obstacle.base_radius_m, 0.0), heights, colour)
            case mission.Radar() | mission.Marine():
                _ball(axes, obstacle.center, obstacle.radius_m, low_m, colour)
            case mission.NoFly():
                corners = np.array([xy(p) for p in (*obstacle.polygon, obstacle.polygon[0])])
                floor_m = obstacle.floor_alt_amsl_m if obstacle.floor_alt_amsl_m is not None else low_m
                roof_m = obstacle.top_alt_amsl_m if obstacle.top_alt_amsl_m is not None else top_m
                z = np.repeat([[floor_m], [roof_m]], len(corners), axis=1)
                axes.plot_surface(
                    *(np.tile(c, (2, 1)) for c in corners.T), z, color=colour, alpha=0.35, linewidth=0, zorder=2
                )
                axes.plot_surface(
                    *(np.array([c[:2], c[[3, 2]]]) for c in corners.T),
                    np.full((2, 2), roof_m),
                    color=colour,
                    alpha=0.3,
                    zorder=2,
                )
            case _:
                pass
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    axes.set_zlim(low_m, top_m)
    axes.view_init(*view)
    axes.set_box_aspect((east - west, north - south, 0.75 * max(east - west, north - south)), zoom=1.2)
    axes.tick_params(labelsize=5.5, pad=-3, colors=MUTED)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.pane.set_alpha(0.0)
        axis._axinfo["grid"].update(color=RULE, linewidth=0.4)  # there is no public way


def ways_in_space(axes: Any, paths: Sequence[FloatArray], colours: Sequence[str], width: float = 1.3) -> None:
    """Draw paths (S, 3) in space; what stands before them does not hide them."""
    for path, colour in zip(paths, colours, strict=True):
        axes.plot(*path.T, color=colour, linewidth=width, zorder=20)
        axes.plot(*path[:1].T, "o", color="white", markeredgecolor=INK, markersize=3, zorder=21)
        axes.plot(*path[-1:].T, "*", color=INK, markersize=5, zorder=21)


def pitch(axes: Axes, path: FloatArray, colour: str, width: float = 1.2) -> None:
    """Draw the climb angle along a path (S, 3), over the share of it that is flown; of few legs, as steps."""
    step = np.diff(path, axis=0)
    angle = np.degrees(np.arctan2(step[:, 2], np.hypot(step[:, 0], step[:, 1])))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(step, axis=1))])
    share = 100.0 * along / along[-1]
    if len(step) > _LEGS:
        axes.plot(0.5 * (share[:-1] + share[1:]), angle, color=colour, linewidth=width)
    else:
        axes.step(share, np.append(angle, angle[-1]), where="post", color=colour, linewidth=width)
    axes.set(xlabel="% of the way", ylabel="climb angle, degrees", xlim=(0, 100))
    axes.grid(True, color=RULE, linewidth=0.5)
    tidy(axes)


def key(figure: Figure, handles: Sequence[Any], columns: int = 4) -> None:
    """Put one legend below all panels."""
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=7.5, frameon=False)


def _tube(
    axes: Any, centre: mission.Place, radii_m: tuple[float, float], heights_m: tuple[float, float], colour: str
) -> None:
    east, north = xy(centre)
    radius, height = np.array(radii_m)[:, None], np.repeat(np.array(heights_m)[:, None], len(_AROUND), axis=1)
    x, y = east + radius * np.cos(_AROUND), north + radius * np.sin(_AROUND)
    axes.plot_surface(x, y, height, color=colour, alpha=0.45, linewidth=0, zorder=2)


def _ball(axes: Any, centre: mission.Point, radius_m: float, low_m: float, colour: str) -> None:
    east, north = xy(centre)
    up = np.linspace(0.0, 0.5 * np.pi, 9)[:, None]  # its upper half: the lower one is below the ground or the sea
    z = np.repeat((centre.alt_amsl_m or low_m) + radius_m * np.sin(up), len(_AROUND), axis=1)
    x = east + radius_m * np.cos(up) * np.cos(_AROUND)
    axes.plot_surface(
        x, north + radius_m * np.cos(up) * np.sin(_AROUND), z, color=colour, alpha=0.25, linewidth=0, zorder=2
    )


def _extent(question: Mission) -> tuple[float, float, float, float]:
    assert question.area is not None
    return *xy(question.area.south_west), *xy(question.area.north_east)
