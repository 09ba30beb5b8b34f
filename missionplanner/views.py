"""From where towers and spans are looked at: what an inspection asks for, as places that every vehicle may fly to.

A view that is not clear as asked for is moved as little as may be: further out (up to twice as far), to the side (up to
30 degrees), or up (at most 45 degrees above what it looks at). A way along a span is moved out and up, and may begin
and end later and earlier. Where none of these is clear, the whole tower or span is left out, with the reason.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from missionplanner import camera, kernels, mission
from missionplanner.camera import CameraModel
from missionplanner.clearance import Margins, legs_clear, tube_clearances, tubes_clear
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.obstacles import indexed
from missionplanner.plan import Action
from missionplanner.scene import Scene
from missionplanner.spans import Span
from missionplanner.terrain import Terrain
from missionplanner.terrain_bounds import least_heights

FURTHEST = 2.0
"""How many times as far off as asked for a view may be at most, in all."""
STEEPEST_DEG = 45.0
"""How high above what it looks at a view from the side may be, as an angle."""
_TOLERANCE_DEG = 45.0  # within which a direction counts as the one asked for; of orbits, half the way to the next
_SPARE_M = 0.25  # beyond what a proof asks for: places are rounded on their way to a vehicle
_ROOM_M = 1.5
"""How much further from obstacles a view is where it may: who is told to return near it brakes and climbs."""
_ROOM_SHARE = 0.35  # of its distance: so far it is moved for that at most
_MOVED_M = 0.5  # from which on it is told
_SIGHT_STEP_M = 5.0
_SIGHT_SAMPLES = 1 << 20
_SAG_SAMPLES = 65
_SIGHTS_ALONG = 17
_QUARTER_TURN = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # to the left, of rows
_OTHER = {"left": "right", "right": "left"}
_ORBIT_GAP_DEG = 120.0  # an orbit whose points leave more than this between them is none


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """A place to fly to, and what is done on the way there and there."""

    position_m: FloatArray  # (3,)
    action: Action


@dataclass(frozen=True, slots=True, eq=False)
class Visit:
    """Viewpoints of one target that are flown one after the other."""

    name: str  # e.g. T01.left
    target: str  # the tower's or span's name; it is done when all its visits are
    viewpoints: tuple[Viewpoint, ...]
    reversible: bool = True  # whether it may be flown backwards
    note: str = ""  # what is not as asked for

    def reversed(self) -> Visit:
        """Return the visit flown backwards; what is done on the way between two places is so still."""
        assert self.reversible, "asked of visits that may be flown backwards only"
        first, *later = self.viewpoints
        every_m = (first.action.photo_every_m, *(v.action.photo_every_m for v in reversed(later)))
        turned = tuple(
            replace(v, action=replace(v.action, photo_every_m=spacing_m))
            for v, spacing_m in zip(reversed(self.viewpoints), every_m, strict=True)
        )
        return replace(self, viewpoints=turned)


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A target that is not inspected."""

    target: str
    why: str  # one line, with the remedy


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """A direction from which a tower is to be seen."""

    target: str
    visit: str
    name: str
    at_m: FloatArray  # (3,) what is looked at
    toward: FloatArray  # (3,) the unit vector from there to where it was asked to be seen from
    distance_m: float  # as asked for
    tolerance_deg: float
    hold_s: float
    photos: int
    kind: Literal["overfly", "two_sides", "four_sides", "orbit"]
    from_m: FloatArray | None = None  # (3,) where it is flown from; None: its target is left out


@dataclass(frozen=True, slots=True, eq=False)
class SpanSight:
    """A side from which the conductors of a span are to be seen."""

    name: str  # e.g. span T01-T02.left
    span: Span
    toward: FloatArray  # (3,) the level unit vector from the conductors to where they are seen from
    lateral_m: float
    vertical_m: float  # above the straight line from top to top
    way_m: FloatArray | None = None  # (2, 3) that is flown along it; None: the span is left out

    @property
    def distance_m(self) -> float:
        """How far from that line it is flown, as asked for."""
        return math.hypot(self.lateral_m, self.vertical_m)


def visits(scene: Scene) -> tuple[tuple[Visit, ...], tuple[LeftOut, ...]]:
    """Return all visits that an open mission asks for, of towers, then of spans, and what cannot be visited.

    Any vehicle may fly any visit: each keeps the widest margins of all.

    Raises
    ------
    MissionError
        A camera that is not known, or that takes photos too slowly for a vehicle's speed along a span.
    """
    towers, spans = _survey_towers(scene), _survey_spans(scene)
    return (*towers.visits, *spans[0]), (*towers.left_out, *spans[1])


def sights(scene: Scene) -> tuple[Sight, ...]:
    """Return the directions from which towers are to be seen, those of towers that are left out too."""
    return _survey_towers(scene).sights


def span_sights(scene: Scene) -> tuple[SpanSight, ...]:
    """Return the sides from which spans are to be seen, in the order of the spans."""
    asked, conductors = _asked_along(scene)
    if not asked or scene.mission.inspection is None:
        return ()
    ways = _ways(scene, _Room(scene), camera.of(scene.mission.inspection.camera), asked, conductors)
    lost = {sight.span.name for sight, way in zip(asked, ways, strict=True) if np.isnan(way).any()}
    return tuple(
        sight if sight.span.name in lost else replace(sight, way_m=way) for sight, way in zip(asked, ways, strict=True)
    )


def _asked_along(scene: Scene) -> tuple[list[SpanSight], list[_Hung]]:
    """Return the sides from which spans are to be seen, without ways, and how each's conductor hangs."""
    inspection = scene.mission.inspection
    if inspection is None:
        return [], []
    asked = {line.name: line.spans or inspection.spans for line in inspection.lines_or_one}
    ways = {line.name: set(itertools.pairwise(line.towers)) for line in inspection.lines_or_one}
    names = [tower.name for tower in inspection.towers]
    found = []
    for span in scene.spans:
        begin, end = span.curve_m[0], span.curve_m[-1]
        left = _level((end - begin)[:2]) @ _QUARTER_TURN
        ahead = names[span.towers[0]], names[span.towers[1]]
        wanted: dict[str, list[mission.SpanViews]] = {"left": [], "right": []}
        for line in span.lines:
            views = asked[line]
            if views == "none":
                continue
            # a line's left is that of its own direction, and of both where it goes there and back
            for along, turned in ((ahead, False), (ahead[::-1], True)):
                if along in ways[line]:
                    for side in ("left", "right"):
                        if views.sides in (side, "both"):
                            wanted[_OTHER[side] if turned else side].append(views)
        for side, toward in (("left", left), ("right", -left)):
            if wanted[side]:  # of several circuits' wishes, the nearest way
                near = min(wanted[side], key=lambda asked: math.hypot(asked.lateral_m, asked.vertical_m))
                found.append(SpanSight(f"{span.name}.{side}", span, toward, near.lateral_m, near.vertical_m))
    hung = [sight.span for sight in found]
    return found, [_Hung(s.curve_m[0], s.curve_m[-1], sag_m(s), s.conductor.radius_m) for s in hung]


def hiding(scene: Scene) -> SpaceArrays | None:
    """Return the solids that one cannot see through; None: there are none.

    Inspected towers and conductors hide little, and radar zones, hazards and no-fly areas without a top nothing.
    """
    arrays = scene.obstacles.arrays
    towers = set() if scene.towers is None else set(scene.towers.names)
    solid = np.isin(arrays.kind, (kernels.CYLINDER, kernels.CONE))
    solid |= (arrays.kind == kernels.PRISM) & np.isfinite(arrays.bound[:, 4])
    solid &= np.array([name not in towers for name in scene.obstacles.names], dtype=np.bool_)
    kept = np.flatnonzero(solid)
    if not len(kept):
        return None
    outlines = [arrays.vertices[arrays.vertex_start[k] : arrays.vertex_start[k + 1]] for k in kept]
    start = np.concatenate([[0], np.cumsum([len(outline) for outline in outlines])]).astype(np.int64)
    of_kept = indexed(
        arrays.kind[kept], arrays.params[kept], arrays.bound[kept], arrays.hard[kept], np.concatenate(outlines), start
    )
    return scene.space._replace(obstacles=of_kept)


def in_sight(
    terrain: Terrain, from_m: FloatArray, to_m: FloatArray, solids: SpaceArrays | None = None
) -> npt.NDArray[np.bool_]:
    """Return whether straight lines from places (N, 3) to places (N, 3) run above the ground and beside ``solids``.

    Where the ground is unknown: no. What stands within a solid itself, as in a no-fly area, is not hidden by any.
    """
    seen = np.ones(len(from_m), dtype=np.bool_)
    if not len(from_m):
        return seen
    step_m = min(_SIGHT_STEP_M, 0.5 * terrain.spacing_m)
    longest_m = float(np.hypot(*(to_m - from_m)[:, :2].T).max())
    share = np.linspace(0.0, 1.0, 2 + math.ceil(longest_m / step_m))[:-1, np.newaxis]
    rows = max(1, _SIGHT_SAMPLES // len(share))
    for first in range(0, len(from_m), rows):
        a, b = from_m[first : first + rows, np.newaxis], to_m[first : first + rows, np.newaxis]
        x, y, z = np.moveaxis(a + share * (b - a), -1, 0)
        seen[first : first + rows] = (z > terrain.height_amsl_m(x, y)).all(axis=1)
    if solids is not None:
        open_ = np.flatnonzero(seen)
        lines, ends = np.stack([from_m[open_], to_m[open_]], axis=1), np.stack([to_m[open_], to_m[open_]], axis=1)
        apart_m, inside_m = (
            kernels.legs_clearance(solids, np.ascontiguousarray(legs), math.inf)[:, kernels.OBSTACLE]
            for legs in (lines, ends)
        )
        seen[open_] = (apart_m > 0.0) | (inside_m <= 0.0)
    return seen


def sag_m(span: Span) -> float:
    """Return how far a span's conductor hangs below the straight line from top to top, at most."""
    share = np.linspace(0.0, 1.0, _SAG_SAMPLES)
    curve_m, (first, last) = span.conductor.catenary.at(share), span.curve_m[[0, -1]]
    return float((first[2] + share * (last[2] - first[2]) - curve_m[:, 2]).max())


def beside_deg(lens: CameraModel | None) -> float:
    """Return how far before or behind a vehicle beside a span its camera sees conductors, as an angle."""
    return _TOLERANCE_DEG if lens is None else min(_TOLERANCE_DEG, 0.5 * lens.field_of_view_deg[0])


@dataclass(frozen=True, slots=True, eq=False)
class _Survey:
    visits: tuple[Visit, ...]
    left_out: tuple[LeftOut, ...]
    sights: tuple[Sight, ...]


def _survey_towers(scene: Scene) -> _Survey:
    found: list[Visit] = []
    left_out: list[LeftOut] = []
    wanted: list[Sight] = []
    asked = list(_tower_sights(scene))
    placed = _place(scene, asked)
    rows = zip(asked, placed, strict=True)
    for target, of_target in itertools.groupby(rows, key=lambda row: row[0].target):
        pairs = list(of_target)
        by_visit = [list(v) for _, v in itertools.groupby(pairs, key=lambda row: row[0].visit)]
        kept = [_without_gaps(visit) for visit in by_visit]
        problems = [place.problem for visit in kept for _, place in visit if place.position_m is None]
        wanted += [
            sight if problems else replace(sight, from_m=place.position_m) for visit in kept for sight, place in visit
        ]
        if problems:
            more = f" (and {len(problems) - 1} more of its views)" if len(problems) > 1 else ""
            left_out.append(LeftOut(target, problems[0] + more))
        else:
            found += [_visit(visit, len(all_)) for visit, all_ in zip(kept, by_visit, strict=True)]
    return _Survey(tuple(found), tuple(left_out), tuple(wanted))


# --- what is asked for ------------------------------------------------------------------------------------------------


def _tower_sights(scene: Scene) -> Iterator[Sight]:
    """Yield the directions from which towers shall be seen, as asked for, by tower and visit."""
    inspection, towers = scene.mission.inspection, scene.towers
    if inspection is None or towers is None:
        return
    along = _along(inspection, towers.names, towers.top_m)
    for index, tower in enumerate(inspection.towers):
        views = tower.views or inspection.views
        if views == "none":
            continue
        for visit, side, below_m, toward in _directions(views, along[index]):
            orbit = views.kind == "orbit"
            yield Sight(
                target=tower.name,
                visit=f"{tower.name}.{visit}",
                name=f"{tower.name}.{side}",
                at_m=towers.top_m[index] - [0.0, 0.0, below_m],
                toward=toward,
                distance_m=views.distance_m,
                tolerance_deg=_TOLERANCE_DEG if not orbit else min(max(180.0 / views.points, 22.5), _TOLERANCE_DEG),
                hold_s=float(math.ceil(views.hold_s)),
                photos=views.photos,
                kind=views.kind,
            )


def _directions(views: mission.TowerViews, along: FloatArray) -> Iterator[tuple[str, str, float, FloatArray]]:
    """Yield visit, side, how far below the top it looks, and the direction (3,) of each view, in flying order."""
    if views.kind == "overfly":
        yield "overfly", "overfly", 0.0, np.array([0.0, 0.0, 1.0])
        return
    left = np.array([-along[1], along[0]])
    for k, below_m in enumerate(views.below_top_m):
        level = f"-{k + 1}" if len(views.below_top_m) > 1 else ""
        if views.kind == "orbit":
            turns = 0.5 * math.pi + 2.0 * math.pi * np.arange(views.points) / views.points
            for n, turn in enumerate(turns.tolist()):
                yield "orbit", f"orbit{level}-{n + 1}", below_m, _level(math.cos(turn) * along + math.sin(turn) * left)
    if views.kind == "orbit":
        return
    for side, across in (("left", left), ("right", -left)):
        for k, below_m in enumerate(views.below_top_m):
            level = f"-{k + 1}" if len(views.below_top_m) > 1 else ""
            if views.kind == "two_sides":
                yield side, f"{side}{level}", below_m, _level(across)
                continue
            ends = [(f"{side}-before", across - along), (f"{side}-behind", across + along)]
            for name, toward in ends if k % 2 == 0 else reversed(ends):
                yield side, f"{name}{level}", below_m, _level(toward)


def _level(direction: FloatArray) -> FloatArray:
    """Return the level unit vector (3,) of a direction (2,)."""
    return np.array([*direction, 0.0]) / math.hypot(*direction)


def _along(inspection: mission.Inspection, names: Sequence[str], top_m: FloatArray) -> FloatArray:
    """Return the direction (T, 2) of the line at every tower, halving its angle; of several lines, the first's."""
    along = np.tile([0.0, 1.0], (len(names), 1))
    index = {name: k for k, name in enumerate(names)}
    for line in reversed(inspection.lines_or_one):
        towers = [index[name] for name in line.towers]
        span = np.diff(top_m[towers, :2], axis=0)
        span /= np.maximum(np.hypot(span[:, 0], span[:, 1]), 1e-9)[:, np.newaxis]
        middle = np.concatenate([span[:1], span[:-1] + span[1:], span[-1:]])
        size = np.hypot(middle[:, 0], middle[:, 1])
        back = size < 1e-6  # where the line goes straight back
        middle[back], size[back] = np.concatenate([span, span[-1:]])[back], 1.0
        for k, direction in reversed(list(zip(towers, middle / size[:, np.newaxis], strict=True))):
            along[k] = direction
    return along


# --- where it can be seen from ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """Where a view is flown from; None: nowhere, for this problem."""

    position_m: FloatArray | None
    problem: str = ""
    moved_m: float = 0.0


_OUT = (1.0, 1.15, 1.3, 1.5, 1.75, FURTHEST)
_UP = (0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 1.15, 1.4)
_TURN_DEG = (0.0, 15.0, -15.0, 30.0, -30.0)


def _displacement(move: tuple[float, float, float]) -> float:
    out, up, turn_deg = move
    return out**2 + 1.0 - 2.0 * out * math.cos(math.radians(turn_deg)) + up**2


_MOVES = sorted(
    (
        (out, up, turn_deg)
        for out, up, turn_deg in itertools.product(_OUT, _UP, _TURN_DEG)
        if math.hypot(out, up) <= FURTHEST and up <= out * math.tan(math.radians(STEEPEST_DEG))
    ),
    key=_displacement,
)
"""How far out, up (both as multiples of the distance asked for) and to the side views are tried, the nearest first."""


class _Room:
    """How far any vehicle of the fleet keeps from everything: the widest margins of all."""

    def __init__(self, scene: Scene) -> None:
        limits = [task.limits for task in scene.tasks]
        margins = [Margins.of(limit) for limit in limits]
        tube_m = max(limit.tube_m for limit in limits)
        self._scene = scene
        self._widest = replace(
            limits[0],
            tracking_error_m=tube_m,
            position_error_m=0.0,
            deviation_m=0.0,
            terrain_margin_m=max(limit.terrain_margin_m for limit in limits),
            obstacle_margin_m=max(margin.obstacle_m for margin in margins) - tube_m,
            height_agl_max_m=min(limit.height_agl_max_m for limit in limits),
            alt_amsl_max_m=min(margin.alt_amsl_max_m for margin in margins) + tube_m,
        )
        self.stray_m = max(limit.stray_m for limit in limits)

    def clear(self, legs: FloatArray, room_m: float = 0.0) -> npt.NDArray[np.bool_]:
        """Return which legs (N, 2, 3) keep all margins, and a little more; those to obstacles so much more."""
        clear = tubes_clear(self._scene.space, self._scene.terrain.bounds, self._widest, legs, _SPARE_M)
        return clear if room_m == 0.0 else clear & self.clear_beside(legs, room_m)

    def clear_beside(self, legs: FloatArray, room_m: float = 0.0) -> npt.NDArray[np.bool_]:
        """Return which legs (N, 2, 3) keep all margins but those to the ground."""
        margins = replace(
            Margins.of(self._widest, _SPARE_M + room_m), height_agl_min_m=-math.inf, height_agl_max_m=math.inf
        )
        return legs_clear(self._scene.space, margins, legs, math.inf)

    def raised(self, legs: FloatArray) -> FloatArray:
        """Return legs (N, 2, 3) raised to where they are high enough above the ground, where that is known."""
        reach_m, never = np.full(len(legs), self._widest.tube_m + _SPARE_M), np.full(len(legs), math.inf)
        space, bounds = self._scene.space, self._scene.terrain.bounds
        low_m = least_heights(space.terrain, bounds, np.ascontiguousarray(legs[:, [0, 1, 0]]), reach_m, 1.0, never)[
            :, 0
        ]
        lift_m = np.where(np.isfinite(low_m), np.maximum(self._widest.terrain_margin_m - low_m + 1e-6, 0.0), 0.0)
        lifted: FloatArray = legs + lift_m[:, np.newaxis, np.newaxis] * [0.0, 0.0, 1.0]
        return lifted

    def problem(self, leg: FloatArray, higher: str, further: str) -> str | None:
        """Return what a leg (2, 3) lacks most, and what to do; None: nothing.

        ``higher`` and ``further`` say what brings it further from the ground, and from obstacles.
        """
        scene, limits = self._scene, self._widest
        margins, tube_m = Margins.of(limits), limits.tube_m
        found = tube_clearances(scene.space, scene.terrain.bounds, leg[np.newaxis], np.array([tube_m]))
        height_m, height_max_m = float(found.height_min_m[0]), float(found.height_max_m[0])
        apart_m, inside_m = float(found.obstacle_m[0]) + tube_m, float(found.fence_m[0]) + tube_m
        top_m = float(leg[:, 2].max())
        nowhere = ", and nowhere near it is clear"
        if not math.isfinite(height_m):
            return "expected a place within the terrain, got none: give a terrain that covers it"
        border = "fence" if scene.mission.fence is not None else "area"
        name = scene.obstacles.names[int(found.obstacle[0])] if math.isfinite(apart_m) else ""
        lacks = [
            (
                limits.terrain_margin_m - height_m,
                f"expected at least {limits.terrain_margin_m:g} m above the ground for all of a tube of {tube_m:g} m, "
                f"got {height_m:.1f} m{nowhere}: {higher}, or lower safety.terrain_m",
            ),
            (
                height_max_m - limits.height_agl_max_m,
                f"expected at most {limits.height_agl_max_m:g} m above the ground for all of a tube of {tube_m:g} m, "
                f"got {height_max_m:.1f} m{nowhere}: raise height_agl_max_m",
            ),
            (
                top_m - margins.alt_amsl_max_m,
                f"expected at most {margins.alt_amsl_max_m:.1f} m AMSL, got {top_m:.1f} m{nowhere}: raise "
                "alt_amsl_max_m",
            ),
            (
                margins.obstacle_m - apart_m,
                f"expected at least {margins.obstacle_m:.1f} m from {name} (safety.obstacle_m and the radius of the "
                f"widest tube), got {apart_m:.1f} m{nowhere}: {further}",
            ),
            (
                margins.fence_m - inside_m,
                f"expected at least {margins.fence_m:.1f} m inside the {border}, got {inside_m:.1f} m{nowhere}: widen "
                f"the {border}",
            ),
        ]
        lack_m, what = max(lacks)
        return what if lack_m + _SPARE_M > 0.0 else None


def _as_legs(position_m: FloatArray) -> FloatArray:
    """Return places (N, 3) as legs (N, 2, 3) without length."""
    return np.stack([position_m, position_m], axis=1)


def _place(scene: Scene, asked: Sequence[Sight]) -> list[_Place]:
    """Return where each view is flown from: as near to where it is asked for as all vehicles may be."""
    if not asked:
        return []
    room, lens = _Room(scene), camera.of(scene.mission.inspection.camera if scene.mission.inspection else None)
    at = np.array([sight.at_m for sight in asked])
    toward = np.array([sight.toward for sight in asked])
    distance_m = np.array([sight.distance_m for sight in asked])
    above = np.array([sight.kind == "overfly" for sight in asked])
    orbit = np.array([sight.kind == "orbit" for sight in asked])
    furthest_m = np.minimum(FURTHEST * distance_m, _sharp_m(lens) - room.stray_m)
    asked_m = at + distance_m[:, np.newaxis] * toward
    solids = hiding(scene)

    def nearest(room_m: float) -> FloatArray:
        """Return the nearest places (N, 3) to those asked for that are clear with so much room; NaN: none."""
        placed = np.full((len(asked), 3), np.nan)
        for out, up, turn_deg in _MOVES:
            barred = above if up > 0.0 or turn_deg != 0.0 else none
            index = np.flatnonzero(np.isnan(placed[:, 0]) & ~barred & ~(orbit if turn_deg != 0.0 else none))
            if not len(index):
                continue
            turn = math.radians(turn_deg)
            x, y, z = toward[index].T
            aim = np.stack(
                [math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y, z], axis=1
            )
            offset = distance_m[index, np.newaxis] * (out * aim + [0.0, 0.0, up])
            tried_m = room.raised(_as_legs(at[index] + offset))[:, 0]
            good = _is_view(tried_m - at[index], above[index], furthest_m[index])
            index, tried_m = index[good], tried_m[good]
            good = room.clear(_as_legs(tried_m), room_m) & in_sight(scene.terrain, tried_m, at[index], solids)
            placed[index[good]] = tried_m[good]
        return placed

    none = np.zeros(len(asked), dtype=np.bool_)
    placed, roomy = nearest(0.0), nearest(_ROOM_M)
    better = np.linalg.norm(roomy - placed, axis=1) <= _ROOM_SHARE * distance_m
    placed[better] = roomy[better]

    ground_m = scene.terrain.height_amsl_m(at[:, 0], at[:, 1])
    found = []
    for k, sight in enumerate(asked):
        if not at[k, 2] > ground_m[k]:
            problem = "expected views.below_top_m less than its height, got one that looks at the ground: lower it"
            found.append(_Place(None, f"{sight.name}: {problem}"))
        elif np.isnan(placed[k, 0]):
            found.append(_Place(None, f"{sight.name}: {_problem(room, lens, sight, asked_m[k])}"))
        else:
            found.append(_Place(placed[k], moved_m=float(np.linalg.norm(placed[k] - asked_m[k]))))
    return found


def _sharp_m(lens: CameraModel | None) -> float:
    """Return from how far at most a camera shows as much as is asked for."""
    return math.inf if lens is None else lens.distance_m(lens.gsd_max_mm)


def _is_view(offset_m: FloatArray, above: npt.NDArray[np.bool_], furthest_m: FloatArray) -> npt.NDArray[np.bool_]:
    """Return whether places that far (N, 3) from what they look at are near enough, and not too high."""
    across_m = np.hypot(offset_m[:, 0], offset_m[:, 1])
    steepest = math.tan(math.radians(STEEPEST_DEG)) + 1e-9
    level = above | (offset_m[:, 2] <= steepest * across_m)
    fit: npt.NDArray[np.bool_] = level & (np.linalg.norm(offset_m, axis=1) <= furthest_m + 1e-9)
    return fit


def _problem(room: _Room, lens: CameraModel | None, sight: Sight, asked_m: FloatArray) -> str:
    """Return why a view is flown from nowhere, and what to do."""
    sharp_m = _sharp_m(lens) - room.stray_m
    if lens is not None and sight.distance_m > sharp_m:
        nearest_m = math.floor(10.0 * sharp_m) / 10.0
        remedy = f"lower views.distance_m to {nearest_m:g} m" if nearest_m > 0.0 else "take a longer lens"
        return (
            f"expected a ground sampling distance of at most {lens.gsd_max_mm:g} mm (inspection.camera.gsd_max_mm), "
            f"got {lens.gsd_mm(sight.distance_m + room.stray_m):.2f} mm, {room.stray_m:g} m off included: {remedy}, or "
            "raise gsd_max_mm"
        )
    further = "raise views.distance_m, or choose other views"
    if sharp_m < FURTHEST * sight.distance_m:
        further = f"raise camera.gsd_max_mm, which allows no more than {sharp_m:.1f} m, and views.distance_m"
    lack = room.problem(np.stack([asked_m, asked_m]), "lower views.below_top_m", further)
    between = "got a hill or an obstacle between"
    return lack or f"expected to see it from near where it is asked for, {between}: choose other views"


# --- visits -----------------------------------------------------------------------------------------------------------


def _without_gaps(visit: list[tuple[Sight, _Place]]) -> list[tuple[Sight, _Place]]:
    """Return an orbit without the points that nobody can fly to, if enough are left; anything else as it is."""
    left = [row for row in visit if row[1].position_m is not None]
    if visit[0][0].kind != "orbit" or len(left) == len(visit) or len(left) < 3:
        return visit
    for height_m in {float(sight.at_m[2]) for sight, _ in visit}:
        turns = sorted(
            math.atan2(sight.toward[1], sight.toward[0]) for sight, _ in left if float(sight.at_m[2]) == height_m
        )
        gaps = np.diff([*turns, turns[0] + 2.0 * math.pi]) if turns else np.array([2.0 * math.pi])
        if gaps.max() > math.radians(_ORBIT_GAP_DEG) + 1e-9:
            return visit
    return left


def _visit(rows: list[tuple[Sight, _Place]], asked: int) -> Visit:
    sight = rows[0][0]
    notes = [f"{len(rows)} of {asked} points: nobody can fly to the others"] if len(rows) < asked else []
    moved_m = [place.moved_m for _, place in rows if place.moved_m > _MOVED_M]
    if moved_m:
        what = "moved" if len(rows) == 1 else f"{len(moved_m)} of {len(rows)} points moved"
        notes.append(f"{what} by {'' if len(moved_m) == 1 else 'up to '}{max(moved_m):.0f} m to where it is clear")
    return Visit(
        name=sight.visit,
        target=sight.target,
        viewpoints=tuple(_viewpoint(*row) for row in _in_flying_order(rows)),
        note="; ".join(notes),
    )


def _in_flying_order(rows: list[tuple[Sight, _Place]]) -> list[tuple[Sight, _Place]]:
    """Return an orbit's points from the one after the longest way on, height by height, to and fro."""
    if rows[0][0].kind != "orbit":
        return rows
    rings = [list(ring) for _, ring in itertools.groupby(rows, key=lambda row: float(row[0].at_m[2]))]
    points = np.array([place.position_m for _, place in rings[0]])
    ways_m = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    first = rings[0][int(np.argmax(ways_m))][0].toward
    ordered = []
    for k, ring in enumerate(rings):
        begin = int(np.argmax([float(sight.toward @ first) for sight, _ in ring]))
        turned = ring[begin:] + ring[:begin]
        ordered += turned if k % 2 == 0 else turned[::-1]
    return ordered


def _viewpoint(sight: Sight, place: _Place) -> Viewpoint:
    assert place.position_m is not None, "the visits of what is left out are not made"
    x, y, z = sight.at_m.tolist()
    action = Action(
        name=sight.name, inspects=sight.target, hold_s=sight.hold_s, look_at_m=(x, y, z), photos=sight.photos
    )
    return Viewpoint(place.position_m, action)


# --- along spans ------------------------------------------------------------------------------------------------------


_INSETS = (0.0, 0.25, 0.5, 0.75, 1.0)  # of what a way may be shorter at either end
_INSET_SHARE = 0.3  # of the span, at most; nor more than what is seen from its end, though it strays
LOWEST_DEG = 55.0
"""How steeply a way along a span looks down on the lowest of its conductor, at most."""
_FULL_SHARE = 0.9  # of a photo's height: nothing is aimed at that well
_SPACING_STEP_M = 0.1
_STAND_S = 1.0  # at both ends of a way: who flies through them bends the way between


@dataclass(frozen=True, slots=True, eq=False)
class _Hung:
    """A span as seen from one side: where its straight way from top to top runs, and how far below it hangs."""

    begin_m: FloatArray  # (3,)
    end_m: FloatArray
    sag_m: float
    radius_m: float


def _survey_spans(scene: Scene) -> tuple[list[Visit], list[LeftOut]]:
    """Return the visits along spans, and the spans that cannot be flown along on all sides asked for."""
    asked, conductors = _asked_along(scene)
    inspection = scene.mission.inspection
    if not asked or inspection is None:
        return [], []
    room, lens = _Room(scene), camera.of(inspection.camera)
    if lens is not None:
        _expect_time_for_photos(scene, asked, conductors, lens)
    ways = _ways(scene, room, lens, asked, conductors)
    found: list[Visit] = []
    left_out: list[LeftOut] = []
    for target, of_target in itertools.groupby(enumerate(asked), key=lambda row: row[1].span.name):
        sides = [k for k, _ in of_target]
        lost = [k for k in sides if np.isnan(ways[k]).any()]
        if lost:
            sight, conductor = asked[lost[0]], conductors[lost[0]]
            left_out.append(LeftOut(target, f"{sight.name}: {_way_problem(room, lens, sight, conductor)}"))
        else:
            found += [_way_visit(scene, lens, asked[k], conductors[k], ways[k]) for k in sides]
    return found, left_out


def _near_m(lateral_m: float, radius_m: float) -> float:
    """Return from how near the nearest of a span's conductors is photographed."""
    return max(lateral_m - radius_m, 0.0)


def _expect_time_for_photos(
    scene: Scene, asked: Sequence[SpanSight], conductors: Sequence[_Hung], lens: CameraModel
) -> None:
    near_m, name = min(
        (_near_m(sight.lateral_m, conductor.radius_m), sight.name)
        for sight, conductor in zip(asked, conductors, strict=True)
    )
    fast = max(scene.tasks, key=lambda task: task.limits.speed_max_m_s)
    if fast.limits.speed_max_m_s > lens.speed_max_m_s(near_m):
        raise MissionError(
            f"{fast.name}.speed_m_s.max: expected at most {math.floor(10.0 * lens.speed_max_m_s(near_m)) / 10.0:g} m/s "
            f"along {name}, where the nearest conductors are {near_m:g} m off: {lens.name} must take a photo every "
            f"{lens.spacing_m(near_m):.1f} m, and takes {lens.interval_min_s:g} s for it, got "
            f"{fast.limits.speed_max_m_s:g} m/s: lower it, raise spans.lateral_m, or lower camera.overlap_share"
        )


def _lines_of_sight_deg(rise_m: float, across_m: float, sag_m: float) -> tuple[float, float]:
    """Return how far below level one looks at the straight line from top to top, and at the lowest conductor."""
    return math.degrees(math.atan2(rise_m, across_m)), math.degrees(math.atan2(rise_m + sag_m, across_m))


def _shows(room: _Room, lens: CameraModel | None, rise_m: float, across_m: float, sag_m: float) -> bool:
    """Return whether a way so far beside and above a span shows all of the conductor, as finely as asked for."""
    high_deg, low_deg = _lines_of_sight_deg(rise_m, across_m, sag_m)
    if max(abs(high_deg), abs(low_deg)) > LOWEST_DEG:
        return False
    if lens is None:
        return True
    far_m = math.hypot(across_m, max(abs(rise_m), abs(rise_m + sag_m))) + room.stray_m
    return lens.gsd_mm(far_m) <= lens.gsd_max_mm and low_deg - high_deg <= _FULL_SHARE * lens.field_of_view_deg[1]


def _ways(
    scene: Scene, room: _Room, lens: CameraModel | None, asked: Sequence[SpanSight], conductors: Sequence[_Hung]
) -> FloatArray:
    """Return the ways (N, 2, 3) along spans, as near to where they are asked for as all vehicles may be; NaN: none.

    One from which all is in sight is preferred to a nearer one.
    """
    solids = hiding(scene)
    ways = np.full((len(asked), 2, 3), np.nan)
    hidden: dict[int, FloatArray] = {}
    begin, end = np.array([c.begin_m for c in conductors]), np.array([c.end_m for c in conductors])
    toward = np.array([sight.toward for sight in asked])
    lateral_m = np.array([sight.lateral_m for sight in asked])
    vertical_m = np.array([sight.vertical_m for sight in asked])
    distance_m = np.hypot(lateral_m, vertical_m)
    along_m = np.hypot(*(end - begin)[:, :2].T)
    inset_m = math.tan(math.radians(beside_deg(lens))) * lateral_m - room.stray_m
    inset = np.clip(inset_m / along_m, 0.0, _INSET_SHARE)
    for out, up, turn_deg in _MOVES:
        index = np.flatnonzero(np.isnan(ways[:, 0, 0]))
        if turn_deg != 0.0 or not len(index):
            continue
        offset = out * lateral_m[index, np.newaxis] * toward[index]
        offset[:, 2] += vertical_m[index] + up * distance_m[index]
        span = end[index] - begin[index]
        ends = []
        for begins in (True, False):
            share = np.full(len(index), np.nan)
            for part in _INSETS:
                open_ = np.flatnonzero(np.isnan(share))
                if not len(open_):
                    break
                tried = part * inset[index[open_]] if begins else 1.0 - part * inset[index[open_]]
                place_m = begin[index[open_]] + tried[:, np.newaxis] * span[open_] + offset[open_]
                clear = room.clear_beside(_as_legs(place_m))
                share[open_[clear]] = tried[clear]
            ends.append(begin[index] + share[:, np.newaxis] * span + offset)
        legs = np.stack(ends, axis=1)
        known = ~np.isnan(legs).any(axis=(1, 2))
        index, legs = index[known], legs[known]
        if not len(index):
            continue
        legs = room.raised(legs)
        for k, leg, clear in zip(index.tolist(), legs, room.clear(legs).tolist(), strict=True):
            across_m, rise_m = _beside(leg, conductors[k], toward[k])
            near = math.hypot(across_m, rise_m) <= FURTHEST * distance_m[k] + 1e-9
            if clear and near and _shows(room, lens, rise_m, across_m, conductors[k].sag_m):
                if _all_in_sight(scene, solids, asked[k].span, leg):
                    ways[k] = leg
                else:
                    hidden.setdefault(k, leg)
    for k, leg in hidden.items():
        if np.isnan(ways[k]).any():
            ways[k] = leg
    return ways


def _all_in_sight(scene: Scene, solids: SpaceArrays | None, span: Span, leg: FloatArray) -> bool:
    """Return whether nothing stands between a way along a span and its conductor."""
    share = np.linspace(0.0, 1.0, _SIGHTS_ALONG)
    places_m = leg[0] + share[:, np.newaxis] * (leg[1] - leg[0])
    return bool(in_sight(scene.terrain, places_m, span.conductor.catenary.at(share), solids).all())


def _beside(leg: FloatArray, conductor: _Hung, toward: FloatArray) -> tuple[float, float]:
    """Return how far beside and above the straight line from top to top a way runs."""
    span = conductor.end_m - conductor.begin_m
    off = leg[0] - conductor.begin_m
    share = float(off[:2] @ span[:2]) / float(span[:2] @ span[:2])
    return float(off @ toward), float(off[2] - share * span[2])


def _way_problem(room: _Room, lens: CameraModel | None, sight: SpanSight, conductor: _Hung) -> str:
    """Return why no way along a span is clear, and what to do."""
    offset = sight.lateral_m * sight.toward + [0.0, 0.0, sight.vertical_m]
    if not _shows(room, lens, sight.vertical_m, sight.lateral_m, conductor.sag_m):
        high_deg, low_deg = _lines_of_sight_deg(sight.vertical_m, sight.lateral_m, conductor.sag_m)
        if max(abs(high_deg), abs(low_deg)) > LOWEST_DEG:
            return (
                f"expected to look at most {LOWEST_DEG:g} degrees down or up at conductors that sag by "
                f"{conductor.sag_m:.1f} m, got {max(abs(high_deg), abs(low_deg)):.0f}: raise spans.lateral_m, or bring "
                "spans.vertical_m nearer to 0"
            )
        assert lens is not None, "without a camera only steepness counts"
        if low_deg - high_deg > _FULL_SHARE * lens.field_of_view_deg[1]:
            return (
                f"expected conductors that sag by {conductor.sag_m:.1f} m, {low_deg - high_deg:.0f} degrees, to fit "
                f"into a photo, got {_FULL_SHARE * lens.field_of_view_deg[1]:.0f} degrees of {lens.name}: raise "
                "spans.lateral_m, or take a shorter lens"
            )
        far_m = math.hypot(sight.lateral_m, sight.vertical_m + conductor.sag_m) + room.stray_m
        return (
            f"expected a ground sampling distance of at most {lens.gsd_max_mm:g} mm (inspection.camera.gsd_max_mm), "
            f"got {lens.gsd_mm(far_m):.2f} mm from {far_m:.0f} m, sag and {room.stray_m:g} m off included: lower "
            "spans.lateral_m, or raise gsd_max_mm"
        )
    leg = np.stack([conductor.begin_m + offset, conductor.end_m + offset])
    lack = room.problem(leg, "raise spans.vertical_m", "raise spans.lateral_m")
    return lack or "expected a way that is clear of everything, got none near the one asked for: choose another side"


def _way_visit(scene: Scene, lens: CameraModel | None, sight: SpanSight, conductor: _Hung, leg: FloatArray) -> Visit:
    across_m, rise_m = _beside(leg, conductor, sight.toward)
    middle_m = leg.mean(axis=0)
    heading_deg = scene.frame.heading_deg(middle_m, middle_m - across_m * sight.toward)
    pitch_deg = -0.5 * sum(_lines_of_sight_deg(rise_m, across_m, conductor.sag_m))
    every_m = 0.0
    notes = []
    if lens is None:
        notes.append("no photos: inspection.camera is not given")
    else:
        spacing_m = lens.spacing_m(_near_m(across_m, conductor.radius_m))
        every_m = max(round(math.floor(spacing_m / _SPACING_STEP_M) * _SPACING_STEP_M, 1), _SPACING_STEP_M)
    moved_m = math.hypot(across_m - sight.lateral_m, rise_m - sight.vertical_m)
    if moved_m > _MOVED_M:
        notes.append(f"moved by {moved_m:.0f} m to where it is clear")
    if not _all_in_sight(scene, hiding(scene), sight.span, leg):
        notes.append("part of it is hidden by the ground or an obstacle")
    span_m = float(np.linalg.norm(conductor.end_m - conductor.begin_m))
    short_m = span_m - float(np.linalg.norm(leg[1] - leg[0]))
    if short_m > _MOVED_M:
        notes.append(f"{short_m:.0f} m shorter than the span")
    action = Action(inspects=sight.span.name, hold_s=_STAND_S, look_deg=(heading_deg, pitch_deg))
    return Visit(
        name=sight.name,
        target=sight.span.name,
        viewpoints=(
            Viewpoint(leg[0], replace(action, name=f"{sight.name}-begin")),
            Viewpoint(leg[1], replace(action, name=f"{sight.name}-end", photo_every_m=every_m)),
        ),
        note="; ".join(notes),
    )
