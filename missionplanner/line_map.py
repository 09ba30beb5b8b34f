"""From points and lines on a map to power lines with their towers in order.

Maps tell towers and lines apart from each other, or only one of them, and lines in pieces. Towers belong to the
vertices of lines by OpenStreetMap's ids, else by place; vertices where no tower stands are taken for towers; towers
that no line passes are ordered along one. What was taken so is marked.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.map_tags import (
    HEIGHT_RANGE_M,
    INSPECTIONS,
    LAYER,
    LINES,
    NAMES,
    ORDERS,
    MapFeature,
    called,
    height_m,
    is_minor,
    iso_dates,
    kind,
    number,
    parts,
    unread_heights,
    value,
    voltage_kv,
)

COARSE_M = 800.0
"""Further apart, vertices without towers are bends of a drawing: spans of lines are rarely longer."""
SPAN_MAX_M = 3000.0
"""No span is longer, but for a handful on earth."""

_SAME_M = 1.0  # two points of a map this close are one tower
_MATCH_M = 10.0  # a tower this close to a vertex of a line stands at it
_BESIDE_M = 25.0  # a tower this close to a line, between its vertices, carries it
_BEND_M = 25.0  # a vertex this close to a tower that carries the line is no tower of its own
_DETOUR_SHARE = 1.05  # numbers of towers, or their order in a file, may make a way so much longer than the shortest
_MEDIAN_HEIGHT_MAX_M = 120.0  # of a map's towers: more are elevations
_TWO_OPT_ROUNDS = 60


@dataclass(slots=True, eq=False)
class Support:
    """What carries a line: a tower, a pole, a pylon; not ``tagged``: a vertex where one is taken to stand."""

    lat_lon_deg: tuple[float, float]
    tagged: bool
    source: str
    what: str = ""  # tower, pole, portal, pylon
    label: str = ""  # what the map calls it
    height_m: float | None = None
    last_inspected: str | None = None
    voltage_kv: float | None = None
    lines: dict[str, float | None] = field(default_factory=dict)  # that a table says it carries: its place in each
    layer: str = ""  # of the file: a folder of placemarks
    wires: int = 0  # that it carries


@dataclass(frozen=True, slots=True, eq=False)
class Wire:
    """A line on supports, in order, as the map draws it."""

    supports: tuple[int, ...]
    labels: tuple[str, ...]  # what the map calls it: refs first
    voltage_kv: float | None
    minor: bool
    source: str
    aerialway: str = ""  # its kind, of a ropeway; power lines: none
    ordered_by: str = ""  # what was assumed of the order of its towers; nothing: the map says it

    @property
    def title(self) -> str:
        """What people call it."""
        what = f"aerialway {self.aerialway}" if self.aerialway else "line"
        volts = f", {self.voltage_kv:g} kV" if self.voltage_kv else ""
        return f"{what} {' / '.join(self.labels) or 'without a name'}{volts} ({self.source})"


@dataclass(frozen=True, slots=True, eq=False)
class LineMap:
    """Everything on the map that matters: what carries lines, the lines, what stands alone, what was not used."""

    supports: tuple[Support, ...]
    wires: tuple[Wire, ...]
    alone: tuple[int, ...]  # supports that carry nothing known
    tall: tuple[MapFeature, ...]  # masts, chimneys, wind turbines
    underground: int  # how many cables were left out
    unknown: Mapping[str, int]  # how many of what else was left out
    unread_heights: tuple[str, ...]  # columns that may hold heights of towers
    openstreetmap: bool
    frame: LocalFrame = field(compare=False)

    def xy_m(self, supports: Iterable[int]) -> FloatArray:
        """Return places (S, 2) of supports in the map's own frame."""
        places = np.array([self.supports[s].lat_lon_deg for s in supports]).reshape(-1, 2)
        return self.frame.to_local(places[:, 0], places[:, 1], 0.0)[:, :2]

    def coarse_gap_m(self, wire: Wire) -> float:
        """Return the longest gap beside a vertex that is only taken for a support; 0 where supports are known."""
        if len(wire.supports) < 2:
            return 0.0
        length_m = np.linalg.norm(np.diff(self.xy_m(wire.supports), axis=0), axis=1)
        known = np.array([self.supports[s].tagged for s in wire.supports])
        loose = ~(known[:-1] & known[1:])
        return float(length_m[loose].max(initial=0.0))

    def longest_span_m(self, supports: Sequence[int]) -> float:
        """Return how far apart neighbours are, at most."""
        return float(np.linalg.norm(np.diff(self.xy_m(supports), axis=0), axis=1).max(initial=0.0))

    def is_drawing(self, wire: Wire) -> bool:
        """Return whether a line is drawn without its towers: so far apart are its vertices, and none is known."""
        length_m = np.linalg.norm(np.diff(self.xy_m(wire.supports), axis=0), axis=1)
        nobody = not any(self.supports[s].tagged for s in wire.supports[1:-1])
        return nobody and float(np.median(length_m)) > COARSE_M


def read_line_map(features: Sequence[MapFeature]) -> LineMap:
    """Return the lines of a map.

    Raises
    ------
    MissionError
        Nothing that could be a tower or a line; heights or dates that cannot be read.
    """
    sorted_: dict[str, list[MapFeature]] = defaultdict(list)
    for feature in features:
        sorted_[kind(feature)].append(feature)
    drawn = [f for f in [*sorted_["power"], *sorted_["aerialway"]] if len(f.lat_lon_deg) > 1]
    points = [*sorted_["tower"], *sorted_["pylon"]]
    if not points and not drawn:
        raise MissionError(
            f"{_files(features)}: expected towers or lines, got {_counted(sorted_)}: OpenStreetMap's need power=tower, "
            "power=line; other maps' points are towers and their lines are power lines"
        )
    places = np.concatenate([f.lat_lon_deg for f in [*points, *drawn]])
    frame = LocalFrame(*(round(float(v), 5) for v in (places.min(axis=0) + places.max(axis=0)) / 2))
    builder = _Builder(frame)
    points = [_at_its_middle(feature) for feature in points]
    builder.add_points(points)
    builder.add_lines(drawn)
    wires = _each_once(builder.wires) + builder.rows_of_towers()
    for wire in wires:
        for s in set(wire.supports):
            builder.supports[s].wires += 1
    return LineMap(
        supports=tuple(builder.supports),
        wires=tuple(_joined(wires, builder.supports)),
        alone=tuple(s for s, support in enumerate(builder.supports) if support.wires == 0),
        tall=(*sorted_["mast"], *sorted_["turbine"]),
        underground=len(sorted_["underground"]),
        unknown=dict(Counter(called(feature) for feature in sorted_["other"]).most_common()),
        unread_heights=tuple(dict.fromkeys(name for f in points for name in unread_heights(f))),
        openstreetmap=any(f.openstreetmap for f in features),
        frame=frame,
    )


def _at_its_middle(feature: MapFeature) -> MapFeature:
    """Return a tower as a point, however it is drawn."""
    if feature.shape == "point":
        return feature
    places = feature.lat_lon_deg
    return replace(feature, shape="point", lat_lon_deg=((places.min(axis=0) + places.max(axis=0)) / 2)[None])


def _files(features: Sequence[MapFeature]) -> str:
    names = sorted({f.source.split(",")[0] for f in features})
    return ", ".join(names[:3]) or "the map"


def _counted(sorted_: Mapping[str, Sequence[MapFeature]]) -> str:
    names = {"mast": "masts or chimneys", "turbine": "wind turbines", "underground": "cables in the ground"}
    counts = [f"{len(found)} {names.get(what, 'other things')}" for what, found in sorted_.items() if found]
    return " and ".join(counts) or "nothing at all"


class _Builder:
    """Collects supports and what they carry."""

    def __init__(self, frame: LocalFrame) -> None:
        self._frame = frame
        self.supports: list[Support] = []
        self.wires: list[Wire] = []
        self._xy: list[tuple[float, float]] = []
        self._by_id: dict[str, int] = {}
        self._towers: list[int] = []  # of power lines

    # --- towers

    def add_points(self, points: Sequence[MapFeature]) -> None:
        """Add towers and pylons, each once."""
        if not points:
            return
        told = [
            (f.source, found[1])
            for f in points
            if not f.openstreetmap and (found := value(f.tags, INSPECTIONS)) is not None
        ]
        inspected = iso_dates(told)
        at_m = self._local(np.array([f.lat_lon_deg[0] for f in points]))
        first_of = _first_within(at_m, _SAME_M)
        of_point: list[int] = []
        heights: list[tuple[MapFeature, str, float]] = []
        for k, feature in enumerate(points):
            new = self._support(feature, inspected.get(feature.source), heights)
            old = self._by_id.get(feature.id) if feature.id else None
            if old is None and first_of[k] != k:
                old = of_point[int(first_of[k])]
            of_point.append(self._add(new, at_m[k]) if old is None else self._merge(old, new))
            if feature.id:
                self._by_id[feature.id] = of_point[-1]
            for node in feature.nodes:  # of its outline, where it is drawn as an area: lines end there
                self._by_id.setdefault(node, of_point[-1])
            if old is None and kind(feature) == "tower":
                self._towers.append(of_point[-1])
        _check_heights(heights)

    def _support(
        self, feature: MapFeature, inspected: str | None, heights: list[tuple[MapFeature, str, float]]
    ) -> Support:
        height = height_m(feature)
        if height is not None and not feature.openstreetmap:
            heights.append((feature, *height))
        names_of = NAMES[:2] if feature.openstreetmap else NAMES
        name, line, order = (value(feature.tags, names) for names in (names_of, LINES, ORDERS))
        place = None if order is None else number(order[1])
        return Support(
            lat_lon_deg=(float(feature.lat_lon_deg[0, 0]), float(feature.lat_lon_deg[0, 1])),
            tagged=True,
            source=feature.source,
            what=feature.tags.get("power") or feature.tags.get("aerialway") or "tower",
            label="" if name is None else name[1],
            height_m=None if height is None else height[1],
            last_inspected=inspected,
            voltage_kv=voltage_kv(feature),
            lines={} if line is None or feature.openstreetmap else dict.fromkeys(parts(line[1]), place),
            layer=feature.tags.get(LAYER, ""),
        )

    def _add(self, support: Support, xy_m: FloatArray) -> int:
        self.supports.append(support)
        self._xy.append((float(xy_m[0]), float(xy_m[1])))
        return len(self.supports) - 1

    def _merge(self, index: int, twin: Support) -> int:
        """Add what a second mention of a tower says: in a table with a row per circuit, or in another file."""
        kept = self.supports[index]
        kept.label = kept.label or twin.label
        kept.height_m = max((h for h in (kept.height_m, twin.height_m) if h is not None), default=None)
        kept.last_inspected = max((day for day in (kept.last_inspected, twin.last_inspected) if day), default=None)
        kept.voltage_kv = max((v for v in (kept.voltage_kv, twin.voltage_kv) if v is not None), default=None)
        kept.lines = twin.lines | kept.lines
        return index

    def _local(self, lat_lon_deg: FloatArray) -> FloatArray:
        return self._frame.to_local(lat_lon_deg[:, 0], lat_lon_deg[:, 1], 0.0)[:, :2]

    # --- lines

    def add_lines(self, drawn: Sequence[MapFeature]) -> None:
        """Add drawn lines, on the towers that stand at their vertices or beside them."""
        vertices = [self._local(feature.lat_lon_deg) for feature in drawn]
        stops = [self._stops_at_vertices(f, xy_m) for f, xy_m in zip(drawn, vertices, strict=True)]
        taken = {stop for found in stops for stop in found if stop is not None}
        free = [s for s in self._towers if s not in taken]
        # where ids tell which vertices are towers, one beside the line is another's
        told = [any(node in self._by_id for node in feature.nodes) for feature in drawn]
        beside = [[] if by_id else self._towers_beside(free, xy_m) for by_id, xy_m in zip(told, vertices, strict=True)]
        loose = _Grid(_MATCH_M)
        for k, feature in enumerate(drawn):
            supports = self._along(feature, vertices[k], stops[k], beside[k], loose)
            if len(supports) > 1:
                self.wires.append(_wire(feature, supports))

    def _stops_at_vertices(self, feature: MapFeature, xy_m: FloatArray) -> list[int | None]:
        found: list[int | None] = [self._by_id.get(node) for node in feature.nodes] or [None] * len(xy_m)
        if not self._xy:
            return found
        # where ids tell towers from other vertices, only a tower at the very place is another file's mention of it
        reach_m = _SAME_M if any(stop is not None for stop in found) else _MATCH_M
        away_m, nearest = cKDTree(np.array(self._xy)).query(xy_m)
        return [
            int(near) if stop is None and away <= reach_m else stop
            for stop, away, near in zip(found, away_m, nearest, strict=True)
        ]

    def _towers_beside(self, free: Sequence[int], xy_m: FloatArray) -> list[tuple[int, float, int]]:
        """Return the free towers along a line: segment, share of the segment, tower."""
        if not free:
            return []
        beside: list[tuple[int, float, int]] = []
        at_m = np.array([self._xy[s] for s in free])
        low, high = xy_m.min(axis=0) - _BESIDE_M, xy_m.max(axis=0) + _BESIDE_M
        start, way = xy_m[:-1], np.diff(xy_m, axis=0)
        square = np.maximum((way**2).sum(axis=1), 1e-9)
        for n in np.flatnonzero(((at_m >= low) & (at_m <= high)).all(axis=1)).tolist():
            share = np.clip(((at_m[n] - start) * way).sum(axis=1) / square, 0.0, 1.0)
            away_m = np.linalg.norm(start + share[:, None] * way - at_m[n], axis=1)
            segment = int(np.argmin(away_m))
            if away_m[segment] <= _BESIDE_M:
                beside.append((segment, float(share[segment]), free[n]))
        return beside

    def _along(
        self,
        feature: MapFeature,
        xy_m: FloatArray,
        stops: Sequence[int | None],
        beside: Sequence[tuple[int, float, int]],
        loose: _Grid,
    ) -> tuple[int, ...]:
        """Return a line's supports in order; vertices without a tower become supports that are not tagged."""
        known = [stop for stop in stops if stop is not None] + [tower for _, _, tower in beside]
        known_m = np.array([self._xy[s] for s in known]).reshape(-1, 2)
        order: list[tuple[float, int]] = [(segment + share, tower) for segment, share, tower in beside]
        for v, stop in enumerate(stops):
            if stop is not None:
                order.append((float(v), stop))
                continue
            if beside and np.linalg.norm(known_m - xy_m[v], axis=1).min() <= _BEND_M:
                continue
            order.append((float(v), self._loose(feature, v, xy_m[v], loose)))
        supports = [support for _, support in sorted(order)]
        return tuple(s for s, before in zip(supports, [-1, *supports], strict=False) if s != before)

    def _loose(self, feature: MapFeature, vertex: int, xy_m: FloatArray, loose: _Grid) -> int:
        node = feature.nodes[vertex] if feature.nodes else ""
        index = self._by_id.get(node) if node else loose.near(xy_m)
        if index is None:
            lat_deg, lon_deg = feature.lat_lon_deg[vertex].tolist()
            index = self._add(Support((lat_deg, lon_deg), False, f"{feature.source}, vertex {vertex + 1}"), xy_m)
            if node:
                self._by_id[node] = index
            loose.add(xy_m, index)
        return index

    # --- towers without a drawn line

    def rows_of_towers(self) -> list[Wire]:
        """Return lines through towers that no drawn line passes: by what tables say, else one through all."""
        used = {s for wire in self.wires for s in wire.supports}
        drawn = {label for wire in self.wires for label in wire.labels}
        rows: dict[str, list[int]] = defaultdict(list)
        for s in self._towers:
            if s in used:
                continue
            support = self.supports[s]
            names = [name for name in support.lines if name not in drawn]
            if not support.lines and not self.wires:
                names = [support.layer]
            for name in names:
                rows[name].append(s)
        return [wire for name, members in rows.items() for wire in self._lines_through(name, members)]

    def _lines_through(self, name: str, members: list[int]) -> Iterator[Wire]:
        """Yield the lines of so many towers: what no span can reach is another line."""
        counted = self._are_counted(name, members)
        groups = [members] if counted else [sorted(group) for group in self._parted(self._nearby(members))]
        wires = [self._row(name, group) for group in groups if len(group) > 1]
        rows = [(wire, list(self._parted(wire.supports))) for wire in wires]
        parted = len(groups) > 1 or any(len(pieces) > 1 for _, pieces in rows)
        for wire, pieces in rows:
            by = wire.ordered_by or ("their order column" if parted else "")
            by += f", lines of their own where more than {SPAN_MAX_M:g} m lie between" if parted else ""
            yield from (replace(wire, supports=tuple(piece), ordered_by=by) for piece in pieces if len(piece) > 1)

    def _nearby(self, members: list[int]) -> list[int]:
        return [members[k] for k in _shortest_way(np.array([self._xy[s] for s in members]))]

    def _parted(self, way: Sequence[int]) -> Iterator[list[int]]:
        """Yield a way in pieces without a gap that no span reaches over."""
        piece = [way[0]]
        for a, b in itertools.pairwise(way):
            if math.dist(self._xy[a], self._xy[b]) > SPAN_MAX_M:
                yield piece
                piece = []
            piece.append(b)
        yield piece

    def _are_counted(self, name: str, members: Sequence[int]) -> bool:
        """Return whether a table says the place of each of a line's towers."""
        told = {self.supports[s].lines.get(name) for s in members}
        return len(told) == len(members) and None not in told

    def _row(self, name: str, members: list[int]) -> Wire:
        supports = [self.supports[s] for s in members]
        if self._are_counted(name, members):
            told = np.array([support.lines[name] for support in supports])
            order, assumed = np.argsort(told, kind="stable").tolist(), ""
        else:
            order, assumed = _best_order(np.array([self._xy[s] for s in members]), [s.label for s in supports])
        return Wire(
            supports=tuple(members[k] for k in order),
            labels=(name,) if name else (),
            voltage_kv=max((s.voltage_kv for s in supports if s.voltage_kv), default=None) or _said_kv(name),
            minor=False,
            source=supports[0].source.split(",")[0],
            ordered_by=assumed,
        )


class _Grid:
    """Finds what was added within a distance, the nearest first."""

    def __init__(self, reach_m: float) -> None:
        self._reach_m = reach_m
        self._cells: dict[tuple[int, int], list[tuple[float, float, int]]] = defaultdict(list)

    def _cell(self, xy_m: FloatArray) -> tuple[int, int]:
        return math.floor(xy_m[0] / self._reach_m), math.floor(xy_m[1] / self._reach_m)

    def add(self, xy_m: FloatArray, index: int) -> None:
        self._cells[self._cell(xy_m)].append((float(xy_m[0]), float(xy_m[1]), index))

    def near(self, xy_m: FloatArray) -> int | None:
        col, row = self._cell(xy_m)
        around = itertools.product((col - 1, col, col + 1), (row - 1, row, row + 1))
        found = [
            (math.hypot(x - xy_m[0], y - xy_m[1]), index)
            for cell in around
            for x, y, index in self._cells.get(cell, ())
        ]
        away_m, index = min(found, default=(math.inf, -1))
        return index if away_m <= self._reach_m else None


def _first_within(xy_m: FloatArray, reach_m: float) -> npt.NDArray[np.int64]:
    """Return per point (N, 2) the first of those within reach, or itself: chains of near points become one."""
    first = np.arange(len(xy_m))
    for a, b in sorted(cKDTree(xy_m).query_pairs(reach_m)):
        first[b] = min(first[a], first[b])
    return first


def _check_heights(heights: Sequence[tuple[MapFeature, str, float]]) -> None:
    if not heights:
        return
    median_m = float(np.median([height for _, _, height in heights]))
    if median_m > _MEDIAN_HEIGHT_MAX_M:
        raise MissionError(
            f"{heights[0][0].source}: expected heights of towers above the ground, got {heights[0][1]} with a median "
            f"of {median_m:.0f} m: if these are elevations, call them ele"
        )
    low_m, high_m = HEIGHT_RANGE_M
    for feature, name, height in heights:
        if not low_m <= height <= high_m:
            raise MissionError(
                f"{feature.source}: expected a height of {low_m:g} to {high_m:g} m above the ground, got {name} "
                f"{height:g} m"
            )


def _said_kv(text: str) -> float | None:
    """Return the voltage that a name tells: ``110 kV Nord - Ost``."""
    found = [number(match) for match in re.findall(r"(\d+(?:[.,]\d+)?)[ -]?kv\b", text.lower())]
    return max((kv for kv in found if kv), default=None)


def _wire(feature: MapFeature, supports: tuple[int, ...]) -> Wire:
    tags = feature.tags
    named = [value(tags, names) for names in (("ref",), LINES, ("name", "bezeichnung", "label"))]
    labels = tuple(dict.fromkeys(found[1] for found in named if found is not None))
    if not labels and LAYER in tags:
        labels = (tags[LAYER],)
    roped = tags.get("aerialway", "ropeway") if kind(feature) == "aerialway" else ""
    return Wire(
        supports=supports,
        labels=labels,
        voltage_kv=None if roped else voltage_kv(feature) or _said_kv(" ".join((*labels, tags.get(LAYER, "")))),
        minor=is_minor(feature),
        source=feature.source,
        aerialway=roped,
    )


def _each_once(wires: Sequence[Wire]) -> list[Wire]:
    """Return the lines without those that another file, or layer, tells again."""
    first: dict[tuple[tuple[int, ...], tuple[str, ...]], Wire] = {}
    for wire in wires:
        first.setdefault((min(wire.supports, wire.supports[::-1]), wire.labels), wire)
    return list(first.values())


def _joined(wires: Sequence[Wire], supports: Sequence[Support]) -> list[Wire]:
    """Return the lines with pieces that continue each other made one; at a branch only those of one name are."""
    chains = {k: [k] for k in range(len(wires))}  # the pieces of each, by its first
    made = dict(enumerate(wires))
    ends: dict[int, list[int]] = defaultdict(list)
    for k, wire in made.items():
        if wire.supports[0] != wire.supports[-1]:
            ends[wire.supports[0]].append(k)
            ends[wire.supports[-1]].append(k)
    home = {k: k for k in made}  # in which chain a piece is
    for support, pieces in sorted(ends.items()):
        pairs = [(a, b) for a, b in itertools.combinations(pieces, 2) if _continue(wires[a], wires[b])]
        if len(pieces) > 2:
            pairs = [(a, b) for a, b in pairs if wires[a].labels and wires[a].labels == wires[b].labels]
        uses = Counter(piece for pair in pairs for piece in pair)
        for a, b in pairs:
            if uses[a] > 1 or uses[b] > 1 or home[a] == home[b]:
                continue
            first, second = sorted((home[a], home[b]))
            made[first] = _in_a_row(made[first], made.pop(second), support)
            for piece in chains[second]:
                home[piece] = first
            chains[first] += chains.pop(second)
    return list(made.values())


def _continue(a: Wire, b: Wire) -> bool:
    """Return whether two pieces may be one line: of one kind, and of one voltage and name where both say any."""
    if (a.aerialway, a.minor) != (b.aerialway, b.minor):
        return False
    same_voltage = a.voltage_kv is None or b.voltage_kv is None or a.voltage_kv == b.voltage_kv
    return same_voltage and (not a.labels or not b.labels or bool(set(a.labels) & set(b.labels)))


def _in_a_row(a: Wire, b: Wire, support: int) -> Wire:
    before, after = a.supports, b.supports
    if support == before[0] and support == after[-1]:
        row = after + before[1:]
    elif support == before[0]:
        row = after[::-1] + before[1:]
    else:
        row = before + (after if support == after[0] else after[::-1])[1:]
    named = a if a.labels else b
    return Wire(
        row, named.labels, a.voltage_kv or b.voltage_kv, a.minor, a.source, a.aerialway, a.ordered_by or b.ordered_by
    )


def _best_order(xy_m: FloatArray, labels: Sequence[str]) -> tuple[list[int], str]:
    """Return an order of towers along their line, and what it was taken from."""
    shortest = _shortest_way(xy_m)
    limit_m = _DETOUR_SHARE * _length_m(xy_m, shortest)
    numbers = [re.findall(r"\d+", label) for label in labels]
    counted = [int(found[-1]) if found else -1 for found in numbers]
    if len(set(counted)) == len(counted):
        by_number = sorted(range(len(labels)), key=counted.__getitem__)
        if _length_m(xy_m, by_number) <= limit_m:
            return by_number, "the numbers in their names"
    as_listed = list(range(len(labels)))
    if _length_m(xy_m, as_listed) <= limit_m:
        return as_listed, "their order in the file"
    return shortest, "the shortest way through them"


def _length_m(xy_m: FloatArray, order: Sequence[int]) -> float:
    return float(np.linalg.norm(np.diff(xy_m[list(order)], axis=0), axis=1).sum())


def _shortest_way(xy_m: FloatArray) -> list[int]:
    """Return a short open path through points (N, 2): nearest neighbours from either far end, then 2-opt."""
    middle = xy_m.mean(axis=0)
    one_end = int(np.argmax(((xy_m - middle) ** 2).sum(axis=1)))
    other_end = int(np.argmax(((xy_m - xy_m[one_end]) ** 2).sum(axis=1)))
    ways = [_two_opt(xy_m, _nearest_neighbours(xy_m, begin)) for begin in (one_end, other_end)]
    best = min(ways, key=lambda way: _length_m(xy_m, way))
    return best if best[0] <= best[-1] else best[::-1]


def _nearest_neighbours(xy_m: FloatArray, begin: int) -> list[int]:
    way, left = [begin], np.ones(len(xy_m), dtype=bool)
    left[begin] = False
    while left.any():
        rest = np.flatnonzero(left)
        following = int(rest[np.argmin(((xy_m[rest] - xy_m[way[-1]]) ** 2).sum(axis=1))])
        way.append(following)
        left[following] = False
    return way


def _two_opt(xy_m: FloatArray, way: list[int]) -> list[int]:
    """Return the way with stretches turned round as long as that shortens it; its ends may be turned too."""
    order = np.array(way)
    n = len(order)
    for _ in range(_TWO_OPT_ROUNDS):
        better = False
        for i in range(n - 1):
            at = xy_m[order]
            ends = np.arange(i + 1, n)  # the stretch from i to such an end is turned
            before = at[i - 1] if i > 0 else None
            gain = np.zeros(len(ends))
            if before is not None:
                gain += np.linalg.norm(at[i] - before) - np.linalg.norm(at[ends] - before, axis=1)
            inner = ends[:-1]
            gain[:-1] += np.linalg.norm(at[inner + 1] - at[inner], axis=1) - np.linalg.norm(
                at[inner + 1] - at[i], axis=1
            )
            best = int(np.argmax(gain))
            if gain[best] > 1e-6:
                order[i : ends[best] + 1] = order[i : ends[best] + 1][::-1].copy()
                better = True
        if not better:
            break
    return [int(k) for k in order]
