"""The map of what was seen, and its table: towers by their sides, spans by how much of them, where vehicles flew."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Wedge

from missionplanner.coverage import Coverage, SideSeen, SpanSeen
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Trajectory
from missionplanner.report import maps, style
from missionplanner.report.facts import Sketch
from missionplanner.report.labels import Labels
from missionplanner.scene import Scene

_SEEN, _PARTLY = "#2fa05a", "#e69f00"
_RADIUS_PT, _LEAST_RADIUS_PT = 5.5, 2.2
_BESIDE_PT = 2.4  # a span's sides run so far beside it
_TRACK_POINTS = 3000
_NAMED = 25  # towers that are not seen whole

Verdict = Literal["seen", "partly seen", "not seen"]
_VERDICTS: tuple[Verdict, ...] = ("seen", "partly seen", "not seen")


@dataclass(frozen=True, slots=True)
class CoverageRow:
    """What was seen of one tower or span; of several sides, the least favourable figures."""

    target: str
    verdict: Verdict
    sides: str  # e.g. "1 of 2"; of spans, the share of their length
    distance_m: float | None
    angle_deg: float | None  # off the side that was asked for
    gsd_mm: float | None
    photos: int | None  # None: no log tells
    vehicles: tuple[str, ...]
    why: str  # not all of it was seen


def coverage_rows(coverage: Coverage) -> tuple[CoverageRow, ...]:
    """Return a row for every tower, then for every span."""
    towers = [
        _tower_row(target, list(rows))
        for target, rows in itertools.groupby(coverage.towers, key=lambda row: row.target)
    ]
    spans = [
        _span_row(target, list(rows)) for target, rows in itertools.groupby(coverage.spans, key=lambda row: row.target)
    ]
    return (*towers, *spans)


def _tower_row(target: str, rows: Sequence[SideSeen]) -> CoverageRow:
    seen = [row for row in rows if row.seen]
    return CoverageRow(
        target=target,
        verdict=_verdict(len(seen) / len(rows)),
        sides=f"{len(seen)} of {len(rows)}",
        distance_m=_most(row.distance_m for row in seen),
        angle_deg=_most(row.angle_deg for row in seen),
        gsd_mm=_most(row.gsd_mm for row in seen),
        photos=_total(row.photos for row in rows),
        vehicles=tuple(sorted({row.vehicle for row in seen if row.vehicle})),
        why="; ".join(f"{row.name}: {row.why}" for row in rows if not row.seen),
    )


def _span_row(target: str, rows: Sequence[SpanSeen]) -> CoverageRow:
    share = min(row.share for row in rows)
    whole = all(row.seen for row in rows)
    return CoverageRow(
        target=target,
        verdict="seen" if whole else _verdict(min(max(row.share for row in rows), 0.5)),
        sides=f"{share:.0%}",
        distance_m=_most(row.distance_max_m for row in rows),
        angle_deg=None,
        gsd_mm=_most(row.gsd_mm for row in rows),
        photos=_total(row.photos for row in rows),
        vehicles=tuple(sorted({name for row in rows for name in row.vehicles if name})),
        why="; ".join(f"{row.name}: {row.share:.0%} of its length" for row in rows if not row.seen),
    )


def _verdict(share: float) -> Verdict:
    return "seen" if share >= 1.0 else "partly seen" if share > 0.0 else "not seen"


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _total(values: Iterable[int | None]) -> int | None:
    known = [value for value in values if value is not None]
    return sum(known) if known else None


def coverage_map(scene: Scene, coverage: Coverage, tracks: Sequence[Trajectory]) -> Figure:
    """Draw what was seen: each tower's sides as parts of a disc, each span's as lines beside it, flights thinly."""
    flown = [track.position_m[:: max(1, len(track.t_s) // _TRACK_POINTS), :2] for track in tracks if len(track.t_s)]
    towers = np.zeros((0, 2)) if scene.towers is None else scene.towers.top_m[:, :2]
    sketch = Sketch(scene, (), ())
    box = maps.map_box(sketch, (), also_m=flown)
    figure, axes, _ = maps.ground_map(sketch, box)
    axes.add_collection(LineCollection(flown, colors=style.INK, linewidths=0.55, alpha=0.75, zorder=6.0))
    labels = Labels(axes)
    point_m = (box[2] - box[0]) / (axes.get_window_extent().width * 72.0 / figure.dpi)
    _draw_spans(axes, scene, coverage, point_m)
    radius_m = _radius_m(towers, point_m)
    _draw_towers(axes, labels, scene, coverage, radius_m)
    maps.side_panel(figure, sketch, box, _legend(coverage, flown=bool(flown)))
    return figure


def _radius_m(towers: FloatArray, point_m: float) -> float:
    """Return how large a tower is drawn: less where they stand close."""
    apart_m = np.linalg.norm(np.diff(towers, axis=0), axis=1)
    room_pt = 0.45 * float(np.median(apart_m)) / point_m if len(apart_m) else _RADIUS_PT
    return min(max(room_pt, _LEAST_RADIUS_PT), _RADIUS_PT) * point_m


def _draw_spans(axes: Axes, scene: Scene, coverage: Coverage, point_m: float) -> None:
    curves = {span.name: span.curve_m[:, :2] for span in scene.spans}
    axes.add_collection(LineCollection(list(curves.values()), colors=style.STEEL, linewidths=0.9, zorder=4.5))
    for row in coverage.spans:
        curve = curves[row.target]
        ahead = (curve[-1] - curve[0]) / math.dist(curve[-1], curve[0])
        left = 1.0 if row.name.endswith(".left") else -1.0
        beside = curve + left * _BESIDE_PT * point_m * np.array([-ahead[1], ahead[0]])
        verdict: Verdict = "seen" if row.seen else _verdict(min(row.share, 0.5))
        axes.plot(beside[:, 0], beside[:, 1], zorder=7.0, **_line(verdict))


def _line(verdict: Verdict) -> dict[str, Any]:
    colour = {"seen": _SEEN, "partly seen": _PARTLY, "not seen": style.BAD}[verdict]
    dashes: Any = {"seen": "solid", "partly seen": (0, (4, 1)), "not seen": (0, (1.2, 1.2))}[verdict]
    return {"color": colour, "linestyle": dashes, "linewidth": 1.9, "solid_capstyle": "butt", "dash_capstyle": "butt"}


def _draw_towers(axes: Axes, labels: Labels, scene: Scene, coverage: Coverage, radius_m: float) -> None:
    towers = scene.towers
    if towers is None:
        return
    places = dict(zip(towers.names, towers.top_m[:, :2], strict=True))
    asked = {target: list(rows) for target, rows in itertools.groupby(coverage.towers, key=lambda row: row.target)}
    for name, place in places.items():
        if name not in asked:
            axes.plot(*place, marker="s", markersize=2.6, color=style.MUTED, zorder=8.0)
            continue
        for middle_deg, width_deg, seen in _parts(asked[name]):
            wedge = Wedge(
                (float(place[0]), float(place[1])), radius_m, middle_deg - width_deg / 2, middle_deg + width_deg / 2,
                facecolor=_SEEN if seen else "white", edgecolor=style.INK if seen else style.BAD,
                linewidth=0.4 if seen else 1.0, zorder=8.0 if seen else 8.1,
            )  # fmt: skip
            axes.add_patch(wedge)
        labels.avoid_mark(place, _RADIUS_PT)
    lost = [name for name, rows in asked.items() if not all(row.seen for row in rows)]
    for name in lost[:_NAMED]:
        labels.place(
            name, places[name], size=7, gap_pt=6.5, must=len(lost) <= _NAMED, fontweight="bold", color=style.BAD
        )
    for name in [*asked][:: max(1, len(asked) // _NAMED)]:
        if name not in lost:
            labels.place(name, places[name], size=6, gap_pt=6.5, color=style.STEEL)


def _parts(rows: Sequence[SideSeen]) -> list[tuple[float, float, bool]]:
    """Return a disc's parts: where each is centred and how wide, in degrees from east; and whether it was seen."""
    seen: dict[float | None, bool] = {}
    for row in rows:
        x, y, z = row.toward
        middle = None if z > 0.5 else round(math.degrees(math.atan2(y, x)), 3)
        seen[middle] = seen.get(middle, True) and row.seen
    width_deg = 360.0 / len(seen)
    return [(middle or 0.0, width_deg, all_) for middle, all_ in seen.items()]


def _legend(coverage: Coverage, *, flown: bool) -> list[tuple[str, list[maps.LegendRow]]]:
    rows = coverage_rows(coverage)
    count = len({row.target for row in coverage.towers})
    legend = []
    if count:
        marks: dict[Verdict, dict[str, Any]] = {
            "seen": {"marker": "o", "markersize": 7.0, "color": _SEEN, "markeredgecolor": style.INK},
            "partly seen": {"marker": "o", "markersize": 7.0, "fillstyle": "left", "color": _SEEN}
            | {"markerfacecoloralt": "white", "markeredgecolor": style.BAD},
            "not seen": {"marker": "o", "markersize": 7.0, "color": "white", "markeredgecolor": style.BAD},
        }
        legend.append(("Towers, by their sides", _counted(rows[:count], marks, {})))
    if len(rows) > count:
        lines = {verdict: _line(verdict) for verdict in _VERDICTS}
        legend.append(("Conductors, by their sides", _counted(rows[count:], {}, lines)))
    if flown:
        legend.append(("Flights", [maps.LegendRow("flown track", {"color": style.INK, "linewidth": 0.9})]))
    return legend


def _counted(
    rows: Sequence[CoverageRow], marks: Mapping[Verdict, dict[str, Any]], lines: Mapping[Verdict, dict[str, Any]]
) -> list[maps.LegendRow]:
    """Return a legend's rows with how many there are of each."""
    counts = Counter(row.verdict for row in rows)
    return [
        maps.LegendRow(f"{verdict}: {counts[verdict]}", lines.get(verdict), marks.get(verdict)) for verdict in _VERDICTS
    ]
