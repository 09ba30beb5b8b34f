"""Names on a map: each where it covers no path, no mark and no other name, or not at all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties

from missionplanner.geodesy import FloatArray
from missionplanner.report import style

_DIRECTIONS = tuple((math.cos(a), math.sin(a)) for a in np.radians([0, 180, 45, 135, -45, -135, 90, -90]))
_SPACING_PX = 3.0


class Labels:
    """Places names one after another, the important ones first; works in pixels."""

    def __init__(self, axes: Axes) -> None:
        self._axes = axes
        self._canvas = axes.figure.canvas
        self._per_point = axes.figure.dpi / 72.0
        self._taken = np.empty((0, 4))
        self._points = np.empty((0, 2))
        self._frame = axes.get_window_extent()

    def avoid_line(self, line_m: FloatArray) -> None:
        """Keep names off a line (N, 2) in data coordinates."""
        pixels = self._axes.transData.transform(line_m[:, :2])
        steps = np.linalg.norm(np.diff(pixels, axis=0), axis=-1)
        run = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.linspace(0.0, run[-1], max(2, int(run[-1] / _SPACING_PX) + 1))
        dense = np.stack([np.interp(at, run, pixels[:, 0]), np.interp(at, run, pixels[:, 1])], axis=-1)
        self._points = np.concatenate([self._points, dense])

    def avoid_mark(self, place_m: FloatArray, radius_pt: float) -> None:
        """Keep names off a mark at a place (2,) in data coordinates."""
        x, y = self._axes.transData.transform(place_m[:2])
        r = radius_pt * self._per_point
        self._taken = np.concatenate([self._taken, [[x - r, y - r, x + r, y + r]]])

    def place(
        self, text: str, place_m: FloatArray, *, size: float, gap_pt: float = 4.0, must: bool = False,
        centred: bool = False, **text_style: Any,
    ) -> bool:  # fmt: skip
        """Write ``text`` beside a place (2,), with a thin leader if it had to go far; False if there was no room.

        A name that ``must`` appear is put where it covers least; a ``centred`` one stands on its place.
        """
        anchor = self._axes.transData.transform(place_m[:2])
        if not self._frame.contains(*anchor):
            return False
        width, height = self._size(text, size, text_style.get("fontweight", "normal"))
        best: tuple[float, FloatArray, float] | None = None
        reach = (0.0,) if centred else (gap_pt, gap_pt + 7.0, gap_pt + 16.0, gap_pt + 28.0)
        for distance_pt in reach:
            gap = distance_pt * self._per_point
            for dx, dy in ((0.0, 0.0),) if centred else _DIRECTIONS:
                centre = anchor + np.array([dx * (gap + width / 2), dy * (gap + height / 2)])
                box = np.array(
                    [centre[0] - width / 2, centre[1] - height / 2, centre[0] + width / 2, centre[1] + height / 2]
                )
                covered = self._covered(box)
                if best is None or covered < best[0]:
                    best = (covered, box, distance_pt)
                if covered == 0.0:
                    break
            if best is not None and best[0] == 0.0:
                break
        if best is None or (best[0] > 0.0 and not must) or math.isinf(best[0]):
            return False
        self._taken = np.concatenate([self._taken, [best[1]]])
        if best[2] > gap_pt + 8.0:
            self._lead(anchor, best[1], text_style.get("color", style.INK))
        to_data = self._axes.transData.inverted()
        x, y = to_data.transform((best[1][:2] + best[1][2:]) / 2)
        self._axes.text(
            x, y, text, fontsize=size, ha="center", va="center", zorder=20, path_effects=style.halo(2.0), **text_style
        )
        return True

    def place_group(self, names: Sequence[str], colours: Sequence[str], places_m: FloatArray, together: str) -> None:
        """Name places (N, 2) one by one; where they lie too close together, all at once."""
        pixels = self._axes.transData.transform(places_m[:, :2])
        if len(places_m) > 1 and float(np.ptp(pixels, axis=0).max()) < 8.0 * self._per_point * len(places_m):
            self.place(together, places_m.mean(axis=0), size=8.5, gap_pt=8, must=True, fontweight="bold")
            return
        for name, colour, place in zip(names, colours, places_m, strict=True):
            self.place(name, place, size=8, gap_pt=6, must=len(names) <= 12, fontweight="bold", color=colour)

    def _lead(self, anchor: FloatArray, box: FloatArray, colour: str) -> None:
        near = np.clip(anchor, box[:2], box[2:])
        ends = self._axes.transData.inverted().transform(np.array([anchor, near]))
        self._axes.plot(ends[:, 0], ends[:, 1], color=colour, linewidth=0.5, zorder=19)

    def _size(self, text: str, size: float, weight: str) -> tuple[float, float]:
        font = FontProperties(family="DejaVu Sans", size=size, weight=weight)
        width, height, _ = self._canvas.get_renderer().get_text_width_height_descent(text, font, False)  # type: ignore[attr-defined]
        return float(width) + 2.0 * self._per_point, float(height) + 2.0 * self._per_point

    def _covered(self, box: FloatArray) -> float:
        """Return how much a box would cover; inf outside the frame."""
        f = self._frame
        if box[0] < f.x0 + 2 or box[1] < f.y0 + 2 or box[2] > f.x1 - 2 or box[3] > f.y1 - 2:
            return math.inf
        across = np.minimum(box[2], self._taken[:, 2]) - np.maximum(box[0], self._taken[:, 0])
        up = np.minimum(box[3], self._taken[:, 3]) - np.maximum(box[1], self._taken[:, 1])
        shared = float((np.maximum(across, 0.0) * np.maximum(up, 0.0)).sum())
        p = self._points
        on_lines = ((p[:, 0] > box[0]) & (p[:, 0] < box[2]) & (p[:, 1] > box[1]) & (p[:, 1] < box[3])).sum()
        return shared + 30.0 * float(on_lines)
