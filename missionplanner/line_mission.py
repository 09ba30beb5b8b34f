"""From a map's lines to a mission file that a person can edit: what to inspect, what stands in the way, who flies.

What the map does not say is assumed, written out, and marked. The file holds an *open* mission: who inspects what is
found when it is planned.
"""

from __future__ import annotations

import itertools
import json
import math
import re
import textwrap
import unicodedata
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from missionplanner import mission
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.line_homes import TUBE_M, Site
from missionplanner.line_map import COARSE_M, SPAN_MAX_M, LineMap, Wire
from missionplanner.map_tags import MapFeature, made_of, number, plain
from missionplanner.terrain import Rectangle, Terrain, read_raster

NO_TERRAIN = Path("FILL-IN-a-terrain-model.tif")
"""What terrain.file says until somebody fills it in: the message that it is missing then says what to do."""

_REACH_M = 100_000.0
_ROOM_M = 1000.0  # of the mission's area around its towers and homes
_TOWERS_MAX = 5000
_HOME_REACH_M = 20_000.0
_DENSE_M = 250.0  # between supports that are made up below a line drawn without them
_OBSTACLE_M = 10.0


@dataclass(frozen=True, slots=True)
class Assumed:
    """What is assumed of a line where nobody says it: docs/IMPORT.md."""

    height_m: float  # of its towers
    half_width_m: float  # of its conductors, from side to side
    safety_m: float  # to be kept from them


# up to so many kV: height, half width: ours, at the upper end of what is usual
_SIZES_M = (
    (1.0, 12.0, 3.0),
    (45.0, 16.0, 4.0),
    (123.0, 35.0, 8.0),
    (245.0, 45.0, 12.0),
    (420.0, 60.0, 16.0),
    (765.0, 75.0, 22.0),
    (math.inf, 100.0, 30.0),
)
# up to so many kV: DIN VDE 0105-100 table 103 up to 380 (and so 400), then 29 CFR 1926.1408 table A; then ours
_DISTANCES_M = ((1.0, 1.0), (110.0, 3.0), (220.0, 4.0), (420.0, 5.0), (500.0, 8.0), (750.0, 11.0), (1000.0, 14.0))
_LARGEST_DISTANCE_M = 20.0
_UNKNOWN = Assumed(35.0, 8.0, 5.0)
_MINOR = Assumed(16.0, 4.0, 5.0)
_ROPEWAY_HEIGHT_M = {
    **dict.fromkeys(("cable_car",), 60.0),
    **dict.fromkeys(("gondola", "mixed_lift", "goods", "zip_line"), 40.0),
    "chair_lift": 25.0,
    **dict.fromkeys(("drag_lift", "t-bar", "j-bar", "platter", "rope_tow"), 12.0),
}
_OTHER_ROPEWAY_M = 40.0
_MAST_RADIUS_M = 10.0
_LONE_RADIUS_M = 6.0  # of a tower of no known line
_GUYED_FROM_M, _GUYS_SHARE = 50.0, 0.7  # masts so high may be guyed; their guys reach so much of the height outwards
_ROTOR_RADIUS_M = 90.0  # the largest on land


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a person asked for; places are latitude and longitude."""

    name: str
    area_deg: tuple[float, float, float, float] | None = None  # south, west, north, east
    lines: tuple[str, ...] = ()  # names, refs or voltages (110kV); none: the highest voltage
    tower_height_m: float | None = None  # where the map does not say it
    as_of: str | None = None
    homes_deg: tuple[tuple[float, float], ...] = ()
    vehicles: int = 2
    terrain: Path | None = None  # as it is to be read
    terrain_as_written: Path = NO_TERRAIN  # as the mission file names it
    geoid_undulation_m: float | None = None  # where the terrain's heights are above the ellipsoid


@dataclass(frozen=True, slots=True)
class ImportedMission:
    """A mission file's text, and what a person should know of it."""

    text: str
    lines: tuple[tuple[str, int, float | None], ...]  # name, towers, voltage
    towers: int
    obstacles: int
    notes: tuple[str, ...]


def imported_mission(found: LineMap, wishes: Wishes, sources: Sequence[str], notes: Sequence[str]) -> ImportedMission:
    """Return the open mission of what was found on maps; ``sources`` names them, ``notes`` were made in reading.

    Raises
    ------
    MissionError
        Nothing to inspect in the area; a line without towers; towers outside of the terrain; no place for a home.
    """
    return _Importer(found, wishes, sources, notes).mission()


def assumed_of(voltage_kv: float | None, *, minor: bool = False) -> Assumed:
    """Return what is assumed of a line of this voltage."""
    if voltage_kv is None:
        return _MINOR if minor else _UNKNOWN
    height_m, half_width_m = next(sizes for up_to_kv, *sizes in _SIZES_M if voltage_kv <= up_to_kv)
    safety_m = next((far_m for up_to_kv, far_m in _DISTANCES_M if voltage_kv <= up_to_kv), _LARGEST_DISTANCE_M)
    return Assumed(height_m, half_width_m, safety_m)


@dataclass(frozen=True, slots=True)
class _Run:
    """Neighbouring towers of a line that are inspected together; its ends may be outside of the area."""

    wire: Wire
    supports: tuple[int, ...]


class _Importer:
    """Builds one mission, part by part: each step uses what those before it left."""

    def __init__(self, found: LineMap, wishes: Wishes, sources: Sequence[str], notes: Sequence[str]) -> None:
        self._map, self._wishes, self._sources = found, wishes, sources
        self._notes = list(notes)
        self._inside = [self._in_area(support.lat_lon_deg) for support in found.supports]
        self._chosen = self._choose()
        self._runs = [run for wire in self._chosen for run in self._runs_of(wire)]
        self._inspected = dict.fromkeys(s for run in self._runs for s in run.supports)
        self._line_names = self._name_lines()
        self._tower_names = self._name_towers()
        self._frame = self._local_frame()
        self._carried = self._all_carried()
        self._of_line = self._greatest([run.wire for run in self._runs])
        self._area = self._mission_area()
        self._terrain = self._read_terrain()
        self._in_the_way: list[Wire] = []  # power lines among the obstacles
        self._groundless: list[str] = []  # obstacles of whose ground the terrain says nothing
        self._obstacles, self._obstacle_comments = self._all_obstacles()
        self._safety_m = self._greatest([*(run.wire for run in self._runs), *self._in_the_way]).safety_m
        self._homes = self._all_homes()

    # --- what is inspected

    def _in_area(self, place: tuple[float, float]) -> bool:
        if self._wishes.area_deg is None:
            return True
        south, west, north, east = self._wishes.area_deg
        return south <= place[0] <= north and west <= place[1] <= east

    def _choose(self) -> list[Wire]:
        lines = [wire for wire in self._map.wires if not wire.aerialway]
        if not lines:
            towers = len(self._map.supports)
            raise MissionError(
                f"{', '.join(self._sources)}: expected a power line or two towers, got {towers} towers without a line"
            )
        here = [wire for wire in lines if any(self._inside[s] for s in wire.supports)]
        if not here:
            raise self._nothing_in_the_area(lines)
        if self._wishes.lines:
            chosen = []
            for asked in self._wishes.lines:
                matching = [wire for wire in here if _is_called(wire, asked)]
                if not matching:
                    shown = "; ".join(wire.title for wire in here[:6])
                    more = f"; and {len(here) - 6} more" if len(here) > 6 else ""
                    raise MissionError(f"--line: expected one of {shown}{more}, got {asked!r}")
                chosen += [wire for wire in matching if wire not in chosen]
        else:
            chosen = _of_highest_voltage(here)
        others = len(here) - len(chosen)
        if others and not self._wishes.lines:
            rest = _count(others, "other line")
            self._notes.append(f"inspected: {_volts(chosen)}; obstacles: {rest} (--line chooses what to inspect)")
        return chosen

    def _nothing_in_the_area(self, lines: Sequence[Wire]) -> MissionError:
        assert self._wishes.area_deg is not None
        south, west, north, east = self._wishes.area_deg
        places = np.array([self._map.supports[s].lat_lon_deg for wire in lines for s in wire.supports])
        swapped = (
            (places[:, 1] >= south) & (places[:, 1] <= north) & (places[:, 0] >= west) & (places[:, 0] <= east)
        ).any()
        low, high = places.min(axis=0), places.max(axis=0)
        hint = (
            "swapped they lie in it: the map's latitudes and longitudes, or the area's, are the wrong way round"
            if swapped
            else "give --area SOUTH,WEST,NORTH,EAST around them"
        )
        return MissionError(
            f"--area {south:g},{west:g},{north:g},{east:g}: expected something to inspect there, got {len(lines)} "
            f"lines all at latitudes {low[0]:.4f} to {high[0]:.4f} and longitudes {low[1]:.4f} to {high[1]:.4f}: {hint}"
        )

    def _expect_towers(self, wire: Wire) -> None:
        if self._map.is_drawing(wire) or self._map.coarse_gap_m(wire) > SPAN_MAX_M:
            spacing_m = np.linalg.norm(np.diff(self._map.xy_m(wire.supports), axis=0), axis=1)
            raise MissionError(
                f"{wire.title}: a line without towers: expected a vertex or a point at every tower, got "
                f"{len(wire.supports)} vertices {np.median(spacing_m):.0f} m apart (up to {spacing_m.max():.0f} m): "
                "import a map of its towers too, or leave it out with --line"
            )

    def _runs_of(self, wire: Wire) -> Iterator[_Run]:
        """Yield the stretches of a line in the area, each with the towers just outside."""
        row, n = wire.supports, len(wire.supports)
        inside = [self._inside[s] for s in row]
        for is_in, places in itertools.groupby(range(n), key=inside.__getitem__):
            stretch = list(places)
            if is_in:
                supports = row[max(0, stretch[0] - 1) : min(n, stretch[-1] + 2)]
                self._expect_towers(replace(wire, supports=supports))
                yield _Run(wire, supports)

    def _name_lines(self) -> list[str]:
        names: list[str] = []
        for k, run in enumerate(self._runs, start=1):
            label = run.wire.labels[0] if run.wire.labels else ""
            volts = f"{run.wire.voltage_kv:g}kV-{k}" if run.wire.voltage_kv else f"line-{k}"
            names.append(_unique(_name(label) or volts, names))
        return names

    def _name_towers(self) -> dict[int, str]:
        labels = Counter(_name(self._map.supports[s].label) for s in self._inspected)
        names: dict[int, str] = {}
        taken: set[str] = set()
        for k, (line, run) in enumerate(zip(self._line_names, self._runs, strict=True), start=1):
            prefix = line if len(line) <= 9 else f"L{k}"
            width = max(2, len(str(len(run.supports))))
            for place, s in enumerate(run.supports, start=1):
                if s in names:
                    continue
                label = _name(self._map.supports[s].label)[:30]
                if label and not label.isdigit() and labels[label] == 1:
                    name = label
                else:
                    name = f"{prefix}-{label or f'{place:0{width}d}'}"
                names[s] = _unique(name, taken)
                taken.add(names[s])
        return names

    # --- where

    def _local_frame(self) -> LocalFrame:
        places = np.array([self._map.supports[s].lat_lon_deg for s in self._inspected])
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        frame = LocalFrame(round(float(middle[0]), 5), round(float(middle[1]), 5))
        away_m = np.linalg.norm(frame.to_local(places[:, 0], places[:, 1], 0.0), axis=1)
        if not away_m.max() <= _REACH_M - 2 * _ROOM_M:
            raise MissionError(
                f"the map: expected towers within {_REACH_M / 1000:.0f} km of their middle, got some "
                f"{away_m.max() / 1000:.0f} km away: give --area or --line"
            )
        if len(self._inspected) > _TOWERS_MAX:
            raise MissionError(
                f"the map: expected at most {_TOWERS_MAX} towers to inspect, got {len(self._inspected)}: give --area "
                "or --line"
            )
        return frame

    def _xy(self, places_deg: Sequence[tuple[float, float]]) -> FloatArray:
        places = np.array(places_deg).reshape(-1, 2)
        return self._frame.to_local(places[:, 0], places[:, 1], 0.0)[:, :2]

    def _places(self, supports: Iterable[int]) -> list[tuple[float, float]]:
        return [self._map.supports[s].lat_lon_deg for s in supports]

    def _all_carried(self) -> dict[int, list[Wire]]:
        """Return the power lines that each support carries, whether or not they are inspected."""
        carried: dict[int, list[Wire]] = defaultdict(list)
        for wire in self._map.wires:
            for s in dict.fromkeys(() if wire.aerialway else wire.supports):
                carried[s].append(wire)
        return carried

    def _sized(self, wire: Wire) -> Assumed:
        """Return what is assumed of a power line; one without a voltage has the highest that its towers tell."""
        told = (self._map.supports[s].voltage_kv for s in wire.supports)
        known_kv = wire.voltage_kv or max((kv for kv in told if kv), default=None)
        return assumed_of(known_kv, minor=wire.minor)

    def _assumed_height_m(self, s: int) -> float:
        """Return the height that is assumed of a tower: it carries the highest of its lines."""
        support = self._map.supports[s]
        heights_m = [self._sized(wire).height_m for wire in self._carried.get(s, ())]
        if support.voltage_kv is not None or not heights_m:
            heights_m.append(assumed_of(support.voltage_kv, minor=support.what == "pole").height_m)
        return max(heights_m)

    def _greatest(self, wires: Iterable[Wire]) -> Assumed:
        """Return what is assumed of lines together: the greatest of each."""
        all_ = [self._sized(wire) for wire in wires]
        return Assumed(
            max(c.height_m for c in all_),
            max(c.half_width_m for c in all_),
            max(c.safety_m for c in all_),
        )

    def _mission_area(self) -> Rectangle:
        towers_m = self._xy(self._places(self._inspected))
        for lat_deg, lon_deg in self._wishes.homes_deg:
            away_m = float(np.linalg.norm(towers_m - self._xy([(lat_deg, lon_deg)]), axis=1).min())
            if not away_m <= _HOME_REACH_M:
                raise MissionError(
                    f"--home {lat_deg:g},{lon_deg:g}: expected a place within {_HOME_REACH_M / 1000:g} km of a tower, "
                    f"got one {away_m / 1000:.0f} km away: latitude comes first"
                )
        xy_m = self._xy([*self._places(self._inspected), *self._wishes.homes_deg])
        west, south = (xy_m.min(axis=0) - _ROOM_M).tolist()
        east, north = (xy_m.max(axis=0) + _ROOM_M).tolist()
        return west, south, east, north

    def _read_terrain(self) -> Terrain | None:
        if self._wishes.terrain is None:
            return None
        try:
            ground = read_raster(self._wishes.terrain, self._frame, self._area, self._wishes.geoid_undulation_m)
        except MissionError as error:
            if "terrain.geoid_undulation_m" in str(error):
                raise MissionError(str(error).replace("terrain.geoid_undulation_m", "--geoid-undulation")) from error
            if "expected terrain below the mission" in str(error) and self._lies_there_swapped():
                raise MissionError(f"{error}: swapped they match: {_SWAP}") from error
            raise
        self._let_go_of_the_unknown(ground)
        xy_m = self._xy(self._places(self._inspected))
        bare = np.isnan(ground.height_amsl_m(xy_m[:, 0], xy_m[:, 1]))
        if bare.any():
            missing = [self._tower_names[s] for s, gone in zip(self._inspected, bare, strict=True) if gone]
            shown = ", ".join(missing[:3]) + (", ..." if len(missing) > 3 else "")
            what = "outside" if not ground.reaches(xy_m[bare, 0], xy_m[bare, 1]).all() else "at voids"
            raise MissionError(
                f"--terrain: expected heights below all towers, got {len(missing)} of {len(self._inspected)} {what} of "
                f"{ground.description} ({shown}): give a terrain that covers them, or --area to leave them out"
            )
        return ground

    def _let_go_of_the_unknown(self, ground: Terrain) -> None:
        """Leave ends of spans across the border to the obstacles where they have no ground."""

        def bare(s: int) -> bool:
            x, y = self._xy([self._map.supports[s].lat_lon_deg])[0].tolist()
            return not self._inside[s] and bool(np.isnan(ground.height_amsl_m(x, y)))

        for k, run in enumerate(self._runs):
            kept = tuple(s for s in run.supports if not bare(s))
            if len(kept) > 1:
                self._runs[k] = _Run(run.wire, kept)
        self._inspected = dict.fromkeys(s for run in self._runs for s in run.supports)

    def _lies_there_swapped(self) -> bool:
        assert self._wishes.terrain is not None
        frame = self._frame
        if abs(frame.origin_lon_deg) > 84.0:
            return False
        west, south, east, north = self._area
        try:
            read_raster(
                self._wishes.terrain,
                LocalFrame(frame.origin_lon_deg, frame.origin_lat_deg),
                (south, west, north, east),
                self._wishes.geoid_undulation_m,
            )
        except MissionError:
            return False
        return True

    # --- what stands in the way

    def _all_obstacles(self) -> tuple[list[mission.Obstacle], dict[str, str]]:
        made: list[mission.Obstacle] = []
        comments: dict[str, str] = {}
        taken = set(self._tower_names.values())

        def add(obstacle: mission.Obstacle, comment: str) -> None:
            made.append(obstacle)
            taken.add(obstacle.name)
            comments[obstacle.name] = comment

        for wire in self._map.wires:
            for supports, what in self._other_stretches(wire):
                half_m = self._half_width_m(wire)
                found = False
                for tops, title in self._drawn_along(wire, supports):
                    for chain in self._within(tops, half_m):
                        name = _unique(_name(f"{what}{title}"), taken)
                        add(self._overhead_line(name, half_m, chain), wire.title)
                        found = True
                    for polygon in self._over_unknown_ground(tops, half_m):
                        name = _unique(_name(f"{what[:30]}-no-ground"), taken)
                        add(mission.NoFly(kind="no_fly", name=name, polygon=polygon), f"{wire.title}{_GROUNDLESS}")
                        self._groundless.append(name)
                        found = True
                if found and not wire.aerialway:
                    self._in_the_way.append(wire)
        for s in self._map.alone:
            support = self._map.supports[s]
            if support.tagged and self._near(self._xy([support.lat_lon_deg])[0], _LONE_RADIUS_M):
                add(*self._lone_tower(s, taken))
        for feature in self._map.tall:
            if (tall := self._tall(feature, taken)) is not None:
                add(*tall)
        return made, comments

    def _other_stretches(self, wire: Wire) -> Iterator[tuple[tuple[int, ...], str]]:
        """Yield what of a line is not inspected, and how to call it."""
        label = _name(wire.labels[0])[:28] if wire.labels else ""
        what = label or (wire.aerialway or ("minor-line" if wire.minor else "line"))
        if wire not in self._chosen:
            yield wire.supports, what
            return
        covered = {
            frozenset(pair) for run in self._runs if run.wire is wire for pair in itertools.pairwise(run.supports)
        }
        rest: list[int] = []
        for a, b in itertools.pairwise(wire.supports):
            if frozenset((a, b)) in covered:
                if rest:
                    yield tuple(rest), f"{what}-beyond"
                rest = []
            else:
                rest = rest or [a]
                rest.append(b)
        if rest:
            yield tuple(rest), f"{what}-beyond"

    def _drawn_along(self, wire: Wire, supports: Sequence[int]) -> Iterator[tuple[list[_Top], str]]:
        """Yield the supports of a line as obstacles tell it, and what is added to their names.

        A line whose supports nobody knows may hang high between its vertices, or stand on the hills between them: it
        is told as both.
        """
        tops = [self._top(s, wire) for s in supports]
        known_between = any(self._map.supports[s].tagged for s in supports[1:-1])
        coarse = self._map.coarse_gap_m(wire) > COARSE_M
        if coarse or (wire.aerialway and not known_between):
            yield (tops if coarse else [tops[0], tops[-1]]), "-straight"
        yield (self._densified(tops) if coarse else tops), ""

    def _top(self, s: int, wire: Wire) -> _Top:
        support = self._map.supports[s]
        if support.height_m is not None:
            height_m = support.height_m
        elif wire.aerialway:
            height_m = _ROPEWAY_HEIGHT_M.get(wire.aerialway, _OTHER_ROPEWAY_M)
        else:
            height_m = max(self._assumed_height_m(s), self._wishes.tower_height_m or 0.0)
        assumed = (
            *(() if support.height_m is not None else ("height_agl_m",)),
            *(() if support.tagged else ("place",)),
        )
        return _Top(support.lat_lon_deg, height_m, assumed)

    def _densified(self, tops: Sequence[_Top]) -> list[_Top]:
        dense = [tops[0]]
        for (a, b), (at_a, at_b) in zip(
            itertools.pairwise(tops), itertools.pairwise(self._xy([t.place_deg for t in tops])), strict=True
        ):
            pieces = math.ceil(float(np.linalg.norm(at_b - at_a)) / _DENSE_M)
            height_m = max(a.height_m, b.height_m)
            shares = [k / pieces for k in range(1, pieces)]
            dense += [_Top(_between(a.place_deg, b.place_deg, share), height_m, _MADE_UP) for share in shares]
            dense.append(b)
        return dense

    def _within(self, tops: Sequence[_Top], half_m: float) -> Iterator[list[_Top]]:
        """Yield the stretches whose spans touch the area, with supports only where the ground is known."""
        xy_m = self._xy([top.place_deg for top in tops])
        chain: list[_Top] = []
        for k, (a, b) in enumerate(itertools.pairwise(tops)):
            span = self._on_known_ground(a, b) if self._clipped(xy_m[k], xy_m[k + 1], half_m) else None
            if span is not None and chain:  # the last one ended at this support, so its ground is known
                chain.append(span[1])
            else:
                if len(chain) > 1:
                    yield chain
                chain = [] if span is None else list(span)
            if span is not None and span[1] is not b:
                yield chain
                chain = []
        if len(chain) > 1:
            yield chain

    def _on_known_ground(self, a: _Top, b: _Top) -> tuple[_Top, _Top] | None:
        """Return a span, cut off where the terrain ends; None where nothing of it is above known ground."""
        known = self._known_part(a.place_deg, b.place_deg)
        if known is None:
            return None
        height_m = max(a.height_m, b.height_m) + _CUT_HIGHER_M
        first, last = known
        return (
            a if first == 0.0 else _Top(_between(a.place_deg, b.place_deg, first), height_m, _MADE_UP),
            b if last == 1.0 else _Top(_between(a.place_deg, b.place_deg, last), height_m, _MADE_UP),
        )

    def _known_part(self, a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float] | None:
        """Return from which share of a span to which the ground is known; voids between do not count."""
        ground = self._terrain
        if ground is None:
            return 0.0, 1.0
        pieces = max(2, math.ceil(float(np.linalg.norm(np.diff(self._xy([a, b]), axis=0))) / _LOOK_M))
        xy_m = self._xy([_between(a, b, k / pieces) for k in range(pieces + 1)])
        known = np.flatnonzero(np.isfinite(ground.height_amsl_m(xy_m[:, 0], xy_m[:, 1])))
        if len(known) < 2:
            return None
        return int(known[0]) / pieces, int(known[-1]) / pieces

    def _over_unknown_ground(self, tops: Sequence[_Top], half_m: float) -> Iterator[tuple[mission.Place, ...]]:
        """Yield the outlines, within the area, of what hangs where the terrain says nothing."""
        for a, b in itertools.pairwise(top.place_deg for top in tops):
            first, last = self._known_part(a, b) or (1.0, 1.0)
            for begin, end in ((0.0, first), (last, 1.0)):
                at_m = self._xy([_between(a, b, begin), _between(a, b, end)])
                touched = self._clipped(at_m[0], at_m[1], half_m) if begin < end else None
                if touched is None:
                    continue
                start_m, end_m = (at_m[0] + share * (at_m[1] - at_m[0]) for share in touched)
                along = (at_m[1] - at_m[0]) / np.linalg.norm(at_m[1] - at_m[0]) * half_m
                aside = np.array([-along[1], along[0]])
                corners = (
                    start_m - along - aside,
                    end_m + along - aside,
                    end_m + along + aside,
                    start_m - along + aside,
                )
                lat_deg, lon_deg, _ = self._frame.to_geo(np.array([[x, y, 0.0] for x, y in corners]))
                places = zip(lat_deg.tolist(), lon_deg.tolist(), strict=True)
                yield tuple(mission.Place(lat_deg=_deg(lat), lon_deg=_deg(lon)) for lat, lon in places)

    def _near(self, xy_m: FloatArray, room_m: float) -> bool:
        west, south, east, north = self._area
        x, y = xy_m.tolist()
        return bool(west - room_m <= x <= east + room_m and south - room_m <= y <= north + room_m)

    def _is_ground_known(self, xy_m: FloatArray, radius_m: float) -> bool:
        """Return whether the ground is known all over a circle, and a little around."""
        ground = self._terrain
        if ground is None:
            return True
        reach_m = 1.1 * radius_m + ground.spacing_m
        side = np.linspace(-reach_m, reach_m, min(200, 3 + math.ceil(4 * reach_m / ground.spacing_m)))
        x, y = (offset.ravel() for offset in np.meshgrid(side, side))
        around = np.hypot(x, y) <= reach_m
        return bool(np.isfinite(ground.height_amsl_m(xy_m[0] + x[around], xy_m[1] + y[around])).all())

    def _clipped(self, a: FloatArray, b: FloatArray, room_m: float) -> tuple[float, float] | None:
        """Return from which share of a way to which it is within the area and so much room around (Liang, Barsky)."""
        west, south, east, north = self._area
        way = b - a
        enter, leave = 0.0, 1.0
        for step, room in (
            (-way[0], a[0] - west + room_m),
            (way[0], east + room_m - a[0]),
            (-way[1], a[1] - south + room_m),
            (way[1], north + room_m - a[1]),
        ):
            if step == 0.0:
                if room < 0.0:
                    return None
            elif step < 0.0:
                enter = max(enter, float(room / step))
            else:
                leave = min(leave, float(room / step))
        return (enter, leave) if enter <= leave else None

    def _half_width_m(self, wire: Wire) -> float:
        return 5.0 if wire.aerialway else self._sized(wire).half_width_m

    def _overhead_line(self, name: str, half_m: float, chain: Sequence[_Top]) -> mission.OverheadLine:
        return mission.OverheadLine(
            kind="line",
            name=name,
            supports=tuple(
                mission.Point(lat_deg=_deg(top.place_deg[0]), lon_deg=_deg(top.place_deg[1]), height_agl_m=top.height_m)
                for top in chain
            ),
            cable_radius_m=half_m,
            assumed=tuple(dict.fromkeys(a for top in chain for a in top.assumed)),
        )

    def _lone_tower(self, s: int, taken: set[str]) -> tuple[mission.Cylinder, str]:
        support = self._map.supports[s]
        height_m = support.height_m
        if height_m is None and support.what == "pylon":
            height_m = _OTHER_ROPEWAY_M
        elif height_m is None:
            height_m = max(self._assumed_height_m(s), self._wishes.tower_height_m or 0.0)
        name = _unique(_name(support.label)[:28] or support.what or "tower", taken)
        at_m = self._xy([support.lat_lon_deg])[0]
        comment = f"a {support.what} of no known line ({support.source})"
        return self._cylinder(name, at_m, _LONE_RADIUS_M, height_m, comment)

    def _cylinder(
        self, name: str, at_m: FloatArray, radius_m: float, height_m: float | None, comment: str
    ) -> tuple[mission.Cylinder, str]:
        """Return what stands alone: without an upper limit where its height or the ground below it is unknown."""
        if height_m is None:
            comment += ", height unknown: no upper limit"
        elif not self._is_ground_known(at_m, radius_m):
            height_m, comment = None, comment + _GROUNDLESS
            self._groundless.append(name)
        lat_deg, lon_deg, _ = self._frame.to_geo(np.append(at_m, 0.0))
        obstacle = mission.Cylinder(
            kind="cylinder",
            name=name,
            center=mission.Place(lat_deg=_deg(float(lat_deg)), lon_deg=_deg(float(lon_deg))),
            radius_m=round(radius_m, 1),
            top_height_agl_m=height_m,
        )
        return obstacle, comment

    def _tall(self, feature: MapFeature, taken: set[str]) -> tuple[mission.Cylinder, str] | None:
        """Return a mast, chimney or wind turbine; without a height it has no upper limit."""
        tags = feature.tags
        places = self._xy([(float(lat), float(lon)) for lat, lon in feature.lat_lon_deg])
        middle = (places.min(axis=0) + places.max(axis=0)) / 2
        outline_m = float(np.linalg.norm(places - middle, axis=1).max())
        height_m = _metres(tags, "height")
        what = made_of(tags) or "wind-turbine"
        if not made_of(tags):
            rotor_m = _metres(tags, "rotor:diameter")
            radius_m = rotor_m / 2 if rotor_m else _ROTOR_RADIUS_M
            hub_m = _metres(tags, "height:hub")
            height_m = hub_m + radius_m if height_m is None and hub_m else height_m
        else:
            radius_m = max(outline_m, (_metres(tags, "diameter") or _metres(tags, "width") or 0.0) / 2, _MAST_RADIUS_M)
            guyed = "guyed" in tags.get("tower:construction", "") or tags.get("guyed") == "yes"
            maybe = what == "mast" and "tower:construction" not in tags
            if guyed or (maybe and (height_m or math.inf) > _GUYED_FROM_M):
                radius_m = max(radius_m, _GUYS_SHARE * (height_m or 2 * _GUYED_FROM_M))
        if not self._near(middle, radius_m):
            return None
        name = _unique(_name(tags.get("name", ""))[:24] or _name(what), taken)
        return self._cylinder(name, middle, radius_m, height_m, f"{what} ({feature.source})")

    # --- who flies

    def _all_homes(self) -> list[tuple[tuple[float, float], str]]:
        """Return per vehicle its home and what to say of it."""
        given, wanted = self._wishes.homes_deg, self._wishes.vehicles
        pairs = [pair for run in self._runs for pair in itertools.pairwise(run.supports)]
        pairs = [(a, b) for a, b in pairs if self._inside[a] and self._inside[b]] or pairs
        starts, ends = (self._xy(self._places(side)) for side in zip(*pairs, strict=True))
        site = Site(self._area, self._terrain, starts, ends, tuple(self._standing()))
        found = site.homes([self._xy([place])[0] for place in given[:wanted]], wanted)
        if not given:
            level = ", level" if self._terrain is not None else " (not if level: no terrain was at hand)"
            self._notes.append(
                f"homes: {_count(wanted, 'site')} beside the lines assumed, clear of what is on the map{level}: check "
                "each on the spot (buildings, trees, roads and owners are not on the map), or give --home"
            )
        lat_deg, lon_deg, _ = self._frame.to_geo(np.array([[*home.at_m, 0.0] for home in found]))
        places = list(zip(lat_deg.tolist(), lon_deg.tolist(), strict=True))
        told = [home.told for home in found]
        return list(zip([*given[:wanted], *places[len(given) :]], told, strict=True))

    def _standing(self) -> Iterator[tuple[FloatArray, float]]:
        """Yield what a home must be clear of: places (N, 2) along it, and how wide it is to either side."""
        for run in self._runs:
            yield self._xy(self._places(run.supports)), self._of_line.half_width_m
        for obstacle in self._obstacles:
            match obstacle:
                case mission.OverheadLine():
                    yield self._xy(_degrees(obstacle.supports)), obstacle.cable_radius_m
                case mission.Cylinder():
                    yield self._xy(_degrees([obstacle.center])), obstacle.radius_m
                case mission.NoFly():
                    yield self._xy(_degrees([*obstacle.polygon, obstacle.polygon[0]])), 0.0

    # --- the file

    def _tower_height(self, s: int) -> tuple[float, bool]:
        """Return a tower's height, and whether it was assumed."""
        support = self._map.supports[s]
        if support.height_m is not None:
            return support.height_m, False
        if self._wishes.tower_height_m is not None:
            return self._wishes.tower_height_m, True
        return self._assumed_height_m(s), True

    def mission(self) -> ImportedMission:
        """Return the file."""
        inspected = sum(self._inside[s] for s in self._inspected)
        unknown = sum(self._tower_height(s)[1] for s in self._inspected)
        loose = sum(not self._map.supports[s].tagged for s in self._inspected)
        notes = self._notes
        if unknown:
            notes.append(f"heights of {unknown} of {len(self._inspected)} towers were assumed: fill in height_m")
        if loose:
            what = _count(loose, "vertex", "vertices")
            notes.append(f"{what} of lines without a tower on the map taken for towers: marked assumed: [place]")
        never = sum(self._map.supports[s].last_inspected is None for s in self._inspected)
        if 0 < never < len(self._inspected):
            what = _count(never, "tower")
            notes.append(f"{what} without last_inspected count as much as the longest known: fill in either")
        for name, run in zip(self._line_names, self._runs, strict=True):
            longest_m = self._map.longest_span_m(run.supports)
            if run.wire.ordered_by:
                by = run.wire.ordered_by
                notes.append(f"line {name}: towers in order of {by} (longest span {longest_m:.0f} m): check it")
            elif longest_m > SPAN_MAX_M:
                notes.append(f"line {name}: has a span of {longest_m:.0f} m: check that no tower is missing")
        if self._groundless:
            shown = ", ".join(self._groundless[:3]) + (", ..." if len(self._groundless) > 3 else "")
            what = _count(len(self._groundless), "obstacle")
            notes.append(f"{what} without an upper limit, as the terrain does not hold the ground there ({shown})")
        if self._map.underground:
            notes.append(f"{_count(self._map.underground, 'cable')} in the ground or under water left out")
        if self._map.unknown:
            kinds = list(self._map.unknown.items())
            shown = ", ".join(f"{count} of {kind}" for kind, count in kinds[:_KINDS_SHOWN])
            rest = sum(count for _, count in kinds[_KINDS_SHOWN:])
            shown += f", {rest} others" if rest else ""
            notes.append(f"left out, as neither towers nor lines nor masts: {shown}: add what stands in the way")
        if self._map.unread_heights:
            shown = ", ".join(self._map.unread_heights[:6])
            notes.append(f"columns not read: {shown}: if they hold heights of towers above the ground, call one height")
        alone = [s for s in self._map.alone if self._inside[s] and self._map.supports[s].what != "pylon"]
        if alone:
            shown = ", ".join(self._map.supports[s].label or self._map.supports[s].source for s in alone[:3])
            shown += ", ..." if len(alone) > 3 else ""
            what = _count(len(alone), "tower")
            notes.append(f"{what} on no line, so obstacles only ({shown}): if they belong to one, draw it through them")
        if any(wire.voltage_kv is None for wire in self._chosen):
            notes.append(f"voltages of some lines are unknown: {self._safety_m:g} m are kept from conductors")
        if self._terrain is None:
            notes.append(
                "no terrain: import with --terrain (or fill in terrain.file, and shorten lines that leave the area): "
                "nothing is proven without it"
            )
        notes = [_one_line(note) for note in notes]
        text = "\n".join(self._text(notes)) + "\n"
        return ImportedMission(
            text=text,
            lines=tuple(
                (name, len(run.supports), run.wire.voltage_kv)
                for name, run in zip(self._line_names, self._runs, strict=True)
            ),
            towers=inspected,
            obstacles=len(self._obstacles),
            notes=tuple(notes),
        )

    def _text(self, notes: Sequence[str]) -> Iterator[str]:
        wishes, of_line = self._wishes, self._of_line
        sources = _one_line(", ".join(self._sources))
        yield f"# An inspection of {_count(len(self._runs), 'line')}, imported from {sources}."
        if self._map.openstreetmap:
            yield "# Data (c) OpenStreetMap contributors, Open Database License 1.0: https://www.openstreetmap.org/copyright"
        yield "# What the map does not say was assumed. Check it before anybody flies; only then delete these lines:"
        yield from (f"# - {note}" for note in notes)
        yield f"name: {_flow(_name(wishes.name) or 'inspection')}"
        yield f"origin: {_flow(_geo(self._frame.origin_lat_deg, self._frame.origin_lon_deg))}"
        corners = np.array([[self._area[0], self._area[1], 0.0], [self._area[2], self._area[3], 0.0]])
        lat_deg, lon_deg, _ = self._frame.to_geo(corners)
        yield "area: # paths stay in here: beyond it, nobody looked for obstacles"
        for name, lat, lon in zip(("south_west", "north_east"), lat_deg.tolist(), lon_deg.tolist(), strict=True):
            yield f"  {name}: {_flow(_geo(lat, lon))}"
        yield from self._terrain_text()
        yield from self._obstacles_text()
        yield "inspection:"
        if self._any_dates():
            yield f"  as_of: {_flow(wishes.as_of)} # the days since last_inspected are a tower's priority"
        yield (
            f"  safety_distance_m: {self._safety_m:g} # to conductors, by voltage: DIN VDE 0105-100, docs/IMPORT.md; "
            "ask the line's owner"
        )
        yield f"  conductor_radius_m: {of_line.half_width_m:g} # assumed: half the width of the conductors"
        views = {"kind": "two_sides", "distance_m": self._distance_m(), "below_top_m": [5], "hold_s": 3}
        yield f"  views: {_flow(views)}"
        yield "  spans: none # or, to fly along the conductors: {sides: left, lateral_m: 30, vertical_m: 5}"
        yield "  camera: {preset: sony_rx0m2} # assumed; the command cameras lists others"
        yield "  assignment: {objective: makespan} # or priority, balanced: planning finds who inspects what"
        yield "  lines:"
        for name, run in zip(self._line_names, self._runs, strict=True):
            yield f"    - name: {_flow(name)} # {_one_line(run.wire.title)}"
            if run.wire.voltage_kv is not None:
                yield f"      voltage_kv: {_flow(run.wire.voltage_kv)}"
            names = ", ".join(_flow(self._tower_names[s]) for s in run.supports)
            yield "      towers:"
            yield from textwrap.wrap(
                f"[{names}]", 116, initial_indent=" " * 8, subsequent_indent=" " * 9, break_on_hyphens=False
            )
        yield "  towers:"
        for s in self._inspected:
            yield f"    - {_flow(self._tower(s))}"
        yield from self._fleet_text()

    def _any_dates(self) -> bool:
        return any(self._map.supports[s].last_inspected for s in self._inspected)

    def _tower(self, s: int) -> dict[str, Any]:
        support = self._map.supports[s]
        height_m, guessed = self._tower_height(s)
        tower: dict[str, Any] = {"name": self._tower_names[s], **_geo(*support.lat_lon_deg), "height_m": height_m}
        if support.last_inspected:
            today = self._wishes.as_of
            if today is not None and support.last_inspected > today:
                raise MissionError(
                    f"{support.source}: expected a last inspection not after {today} (--as-of), got "
                    f"{support.last_inspected}"
                )
            tower["last_inspected"] = support.last_inspected
        if not self._inside[s]:
            tower["views"] = "none"  # beyond the border: an obstacle only
        assumed = [*(["height_m"] if guessed else []), *([] if support.tagged else ["place"])]
        return tower | ({"assumed": assumed} if assumed else {})

    def _distance_m(self) -> float:
        """Return how far from a tower's axis one may look at it: the conductors and all margins fit between."""
        carried = (wire for s in self._inspected for wire in self._carried[s])
        need_m = self._greatest(carried).half_width_m + self._obstacle_m() + TUBE_M + 2.0
        return max(25.0, math.ceil(need_m))

    def _obstacle_m(self) -> float:
        return max(_OBSTACLE_M, self._safety_m)

    def _terrain_text(self) -> Iterator[str]:
        if self._terrain is None:
            yield "terrain: # fill in an elevation model of the area (GeoTIFF, HGT): nothing can be proven without"
            yield f"  {{kind: raster, file: {_flow(str(NO_TERRAIN))}, vertical_error_m: 4}}"
            return
        error_m = 9 if self._terrain.spacing_m > 45.0 else 4
        yield f"terrain: # {self._terrain.description}; its error is assumed: look it up"
        source = {"kind": "raster", "file": str(self._wishes.terrain_as_written), "vertical_error_m": error_m}
        if self._wishes.geoid_undulation_m is not None:
            source["geoid_undulation_m"] = self._wishes.geoid_undulation_m
        yield "  " + _flow(source)

    def _obstacles_text(self) -> Iterator[str]:
        if not self._obstacles:
            yield "obstacles: [] # none on the map: add what you know"
            return
        yield "obstacles: # also add what the map does not hold: trees, buildings, cranes"
        for obstacle in self._obstacles:
            comment = f" # {_one_line(self._obstacle_comments[obstacle.name])}"
            if isinstance(obstacle, mission.OverheadLine):
                head = {"kind": "line", "name": obstacle.name, "cable_radius_m": obstacle.cable_radius_m}
                if obstacle.assumed:
                    head["assumed"] = list(obstacle.assumed)
                first, *rest = head.items()
                yield f"  - {first[0]}: {_flow(first[1])}{comment}"
                yield from (f"    {key}: {_flow(value)}" for key, value in rest)
                yield "    supports:"
                for point in obstacle.supports:
                    yield f"      - {_flow(point.model_dump(exclude_none=True))}"
            else:
                yield f"  - {_flow(obstacle.model_dump(exclude_none=True))}{comment}"

    def _fleet_text(self) -> Iterator[str]:
        yield "defaults: # assumed: fill in what your vehicles are"
        yield "  autopilot: ardupilot"
        yield "  speed_m_s: {min: 3, max: 10}"
        yield "  endurance_s: 1500 # hovering in calm air at sea level"
        safety = {"terrain_m": 10, "obstacle_m": self._obstacle_m()}
        yield f"  safety: {_flow(safety)} # obstacle_m: inspection.safety_distance_m or more"
        yield "vehicles:"
        for k, (place, told) in enumerate(self._homes, start=1):
            yield f"  - {_flow({'name': f'copter-{k}', 'home': _geo(*place)})} # {told}"
        yield "fleet: {separation_m: 20, arrive_together: false}"


_SWAP = "are latitude and longitude the wrong way round in the map?"
_MADE_UP = ("height_agl_m", "place")
_GROUNDLESS = ", ground unknown: no upper limit"
_LOOK_M = 20.0  # between places below a span where the ground is looked up
_KINDS_SHOWN = 5
_CUT_HIGHER_M = 20.0  # than its towers, a span that is cut off where the terrain ends: it may hang over a valley


@dataclass(frozen=True, slots=True)
class _Top:
    """The top of a support of an obstacle."""

    place_deg: tuple[float, float]
    height_m: float
    assumed: tuple[str, ...]


def _is_called(wire: Wire, asked: str) -> bool:
    """Return whether a line has this voltage, ref or name, or a name with this in it."""
    volts = re.fullmatch(r"\s*(\d+(?:[.,]\d+)?)\s*kv\s*", asked.lower())
    if volts:
        return wire.voltage_kv == number(volts.group(1))
    said = plain(asked)
    whole = {plain(part) for label in wire.labels for part in (label, *re.split(r"[;|]", label), _name(label))}
    return said in whole or (len(said) > 3 and any(said in plain(label) for label in wire.labels))


def _of_highest_voltage(wires: Sequence[Wire]) -> list[Wire]:
    """Return the lines of the highest class of voltage; where no voltage is known, those that are not minor."""
    known = [wire.voltage_kv for wire in wires if wire.voltage_kv is not None]
    if known:
        return [wire for wire in wires if wire.voltage_kv is not None and wire.voltage_kv >= 0.85 * max(known)]
    return [wire for wire in wires if not wire.minor] or list(wires)


def _volts(wires: Sequence[Wire]) -> str:
    known = sorted({wire.voltage_kv for wire in wires if wire.voltage_kv is not None}, reverse=True)
    return _count(len(wires), "line") + (f" of {', '.join(f'{kv:g}' for kv in known)} kV" if known else "")


def _metres(tags: Mapping[str, str], name: str) -> float | None:
    match = re.fullmatch(r"~?\s*([\d.,]+)\s*(?:m|metres?|meters?)?", tags.get(name, "").strip().lower())
    metres = number(match.group(1)) if match else None
    return metres if metres else None


def _between(a: tuple[float, float], b: tuple[float, float], share: float) -> tuple[float, float]:
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])


def _name(text: str) -> str:
    """Return a text as a name that mission files allow."""
    letters = "".join(c if c == "." or _is_letter(c) else "-" for c in text)
    return re.sub(r"-+", "-", letters).strip("-.")[:40].rstrip("-.")


def _is_letter(character: str) -> bool:
    """Return whether a character may be in a name: letters with their marks, digits, underscores of any script."""
    category = unicodedata.category(character)
    return category[0] in "LM" or category in {"Nd", "Pc"}


def _unique(name: str, taken: Sequence[str] | set[str]) -> str:
    """Return a name, or the name with the first number that makes it one of its own."""
    if name not in taken:
        return name
    return next(tried for k in itertools.count(2) if (tried := f"{name[:35]}-{k}") not in taken)


def _count(number_: int, what: str, plural: str = "") -> str:
    return f"{number_} {what if number_ == 1 else plural or what + 's'}"


def _deg(value: float) -> float:
    return round(value, 7)


def _degrees(places: Iterable[mission.Point | mission.Place]) -> list[tuple[float, float]]:
    return [(place.lat_deg or 0.0, place.lon_deg or 0.0) for place in places]


def _geo(lat_deg: float, lon_deg: float) -> dict[str, float]:
    return {"lat_deg": _deg(lat_deg), "lon_deg": _deg(lon_deg)}


def _one_line(text: str) -> str:
    """Return a text as a comment may hold it: maps may call things anything."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    match value:
        case dict():
            return "{" + ", ".join(f"{key}: {_flow(part)}" for key, part in value.items()) + "}"
        case list() | tuple():
            return "[" + ", ".join(map(_flow, value)) + "]"
        case bool():
            return str(value).lower()
        case float():
            return str(int(value)) if value == int(value) else repr(value)
        case str():
            plain_text = re.fullmatch(r"[A-Za-z_][\w.-]*|\d{4}-\d{2}-\d{2}", value) and value.lower() not in _YAML_WORDS
            return value if plain_text else json.dumps(value, ensure_ascii=False)
        case _:
            return str(value)


_YAML_WORDS = {"true", "false", "null", "yes", "no", "on", "off", "y", "n"}
