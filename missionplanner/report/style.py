"""The report's look: colours that colour-blind readers tell apart, and figures that leave no global state behind."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_hex
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke

INK = "#1d2730"
MUTED = "#66727d"
RULE = "#d9dfe4"
GROUND = "#d8cfc0"
GROUND_EDGE = "#8d7f6a"
MARGIN = "#e8a33d"
BAD = "#b3261e"
STEEL = "#2f3a44"
FENCE = "#1a6b3c"

ROOM_SHOWN_M = 20.0
"""Room to spare from which on a leg is drawn as green as can be."""
_ROOM_COLOURS = LinearSegmentedColormap.from_list("room", ["#f2a100", "#c9c92e", "#2fa05a"])

WIDTH_IN = 9.6
DPI = 160

# Okabe & Ito's palette, its yellow and grey replaced by colours that also stand out on a relief
_VEHICLE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#aa3377", "#e69f00", "#332288", "#56b4e9", "#8c3b1a")
_DASHES: tuple[tuple[int, tuple[float, ...]] | str, ...] = (
    "solid",
    (0, (5.0, 1.5)),
    (0, (1.5, 1.2)),
    (0, (6.0, 1.5, 1.5, 1.5)),
)

OBSTACLE_COLOURS = {
    "cylinder": "#5a2a27",
    "cone": "#7a5230",
    "radar": "#8e2a6b",
    "marine": "#0b4f6c",
    "no_fly": "#b3261e",
    "cable": "#1d2730",
    "line": "#4d2f6e",
    "support": "#4d2f6e",
}

_RC: dict[str, object] = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": MUTED,
    "axes.labelsize": 8.0,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.5,
    "legend.frameon": False,
    "path.simplify": True,
}


@contextmanager
def look() -> Iterator[None]:
    """Draw with the report's own settings, whatever the user's matplotlibrc says; put everything back afterwards."""
    settings: dict[Any, Any] = {k: v for k, v in matplotlib.rcParamsDefault.items() if not k.startswith("backend")}
    settings.update(_RC)
    with matplotlib.rc_context(settings):
        yield


def vehicle_colour(index: int) -> str:
    """Return the colour of the vehicle with this place in the fleet."""
    return _VEHICLE_COLOURS[index % len(_VEHICLE_COLOURS)]


def vehicle_dashes(index: int) -> tuple[int, tuple[float, ...]] | str:
    """Return the line style that tells apart vehicles that must share a colour."""
    return _DASHES[index // len(_VEHICLE_COLOURS) % len(_DASHES)]


def room_colour(room_m: float, *, proven: bool = True) -> str:
    """Return the colour of a leg that keeps so much more than it must: amber to green; red where it is not proven."""
    return to_hex(_ROOM_COLOURS(min(max(room_m / ROOM_SHOWN_M, 0.0), 1.0))) if proven else BAD


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Figure:
    """Return an empty white figure on an Agg canvas."""
    figure = Figure(figsize=(width_in, height_in), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def halo(width: float = 2.0, colour: str = "white") -> list[AbstractPathEffect]:
    """Return path effects that keep lines and text legible on any background."""
    return [withStroke(linewidth=width, foreground=colour)]


def quiet(axes: Axes) -> None:
    """Give a chart its light grid and short ticks."""
    axes.grid(True, axis="y")
    axes.set_axisbelow(True)
    axes.tick_params(length=2.5, width=0.6)


def to_png(figure: Figure) -> bytes:
    """Return the drawn figure; the same bytes for the same drawing."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None}, pil_kwargs={"compress_level": 4})
    return buffer.getvalue()
