"""From where towers are looked at: what an inspection asks for, as places that every vehicle may fly to.

A view that is not clear as asked for is moved as little as may be: further out (up to twice as far), to the side (up to
30 degrees), or up (at most 45 degrees above what it looks at). Where none of these is clear, the whole tower is left
out, with the reason.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from missionplanner import camera, mission
from missionplanner.camera import CameraModel
from missionplanner.clearance import Margins, tube_clearances
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Action
from missionplanner.scene import Scene
from missionplanner.terrain import Terrain

FURTHEST = 2.0
"""How many times as far off as asked for a view may be at most, in all."""
STEEPEST_DEG = 45.0
"""How high above what it looks at a view from the side may be, as an angle."""
_TOLERANCE_DEG = 45.0  # within which a direction counts as the one asked for; of orbits, half the way to the next
_SPARE_M = 0.25  # beyond what a proof asks for: places are rounded on their way to a vehicle
_MOVED_M = 0.5  # from which on it is told
_SIGHT_STEP_M = 5.0
_SIGHT_SAMPLES = 1 << 20
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


def visits(scene: Scene) -> tuple[tuple[Visit, ...], tuple[LeftOut, ...]]:
    """Return all visits that an open mission asks for, in the order of its towers, and what cannot be visited.

    Any vehicle may fly any visit: each keeps the widest margins of all.

    Raises
    ------
    MissionError
        A camera that is not known.
    """
    survey = _survey(scene)
    return survey.visits, survey.left_out


def sights(scene: Scene) -> tuple[Sight, ...]:
    """Return the directions from which towers are to be seen, those of towers that are left out too."""
    return _survey(scene).sights


def in_sight(terrain: Terrain, from_m: FloatArray, to_m: FloatArray) -> npt.NDArray[np.bool_]:
    """Return whether the ground lies below the straight lines from places (N, 3) to places (N, 3); unknown: no."""
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
    return seen


@dataclass(frozen=True, slots=True, eq=False)
class _Survey:
    visits: tuple[Visit, ...]
    left_out: tuple[LeftOut, ...]
    sights: tuple[Sight, ...]


def _survey(scene: Scene) -> _Survey:
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
        wanted += [sight for visit in kept for sight, _ in visit]
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
        self._scene = scene
        self.tube_m = max(limit.tube_m for limit in limits)
        self.stray_m = max(limit.stray_m for limit in limits)
        self.terrain_m = max(limit.terrain_margin_m for limit in limits)
        self.height_agl_max_m = min(limit.height_agl_max_m for limit in limits)
        self.alt_amsl_max_m = min(margin.alt_amsl_max_m for margin in margins)
        self.obstacle_m = max(margin.obstacle_m for margin in margins)
        self.fence_m = max(margin.fence_m for margin in margins)

    def missing_m(self, legs: FloatArray) -> tuple[FloatArray, npt.NDArray[np.intp]]:
        """Return how much legs (N, 2, 3) lack, (N, 5), and their nearest obstacles (N,).

        Of height above the ground, below the ceilings (above ground, AMSL), from obstacles and inside the fence; what
        is clear lacks nothing, or less.
        """
        found = tube_clearances(self._scene.space, self._scene.terrain.bounds, legs, np.full(len(legs), self.tube_m))
        lacks = [
            self.terrain_m - found.height_min_m,
            found.height_max_m - self.height_agl_max_m,
            legs[:, :, 2].max(axis=1) - self.alt_amsl_max_m,
            self.obstacle_m - self.tube_m - found.obstacle_m,
            self.fence_m - self.tube_m - found.fence_m,
        ]
        return np.stack(lacks, axis=1) + _SPARE_M, found.obstacle

    def raised(self, position_m: FloatArray) -> FloatArray:
        """Return places (N, 3) raised to where they are high enough above the ground, where that is known."""
        lacks_m = self.missing_m(as_legs(position_m))[0][:, 0]
        lift_m = np.where(np.isfinite(lacks_m), np.maximum(lacks_m, 0.0), 0.0)
        lifted: FloatArray = position_m + lift_m[:, np.newaxis] * [0.0, 0.0, 1.0]
        return lifted

    def told(self, lacks_m: FloatArray, obstacle: int) -> str:
        """Return what is the matter, and what to do, of a row of what :meth:`missing_m` returns."""
        scene = self._scene
        kind = int(np.argmax(lacks_m))
        lack_m = float(lacks_m[kind])
        if not math.isfinite(lack_m):
            return "expected a place within the terrain, got none: give a terrain that covers it"
        if kind == 0:
            return (
                f"expected at least {self.terrain_m:g} m above the ground for all of a tube of {self.tube_m:g} m, got "
                f"{self.terrain_m - lack_m:.1f} m: lower views.below_top_m or safety.terrain_m"
            )
        if kind == 1:
            got_m = self.height_agl_max_m + lack_m
            return (
                f"expected at most {self.height_agl_max_m:g} m above the ground, got {got_m:.1f} m: raise the ceiling"
            )
        if kind == 2:
            got_m = self.alt_amsl_max_m + lack_m
            return f"expected at most {self.alt_amsl_max_m:.1f} m AMSL, got {got_m:.1f} m: raise alt_amsl_max_m"
        if kind == 3:
            name = scene.obstacles.names[obstacle]
            return (
                f"expected at least {self.obstacle_m:.1f} m from {name} (safety.obstacle_m and the radius of the "
                f"widest tube), got {self.obstacle_m - lack_m:.1f} m: raise views.distance_m, or choose other views"
            )
        border = "fence" if scene.mission.fence is not None else "area"
        return (
            f"expected at least {self.fence_m:.1f} m inside the {border}, got {self.fence_m - lack_m:.1f} m: widen the "
            f"{border}"
        )


def as_legs(position_m: FloatArray) -> FloatArray:
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

    none = np.zeros(len(asked), dtype=np.bool_)
    placed = np.full((len(asked), 3), np.nan)
    for out, up, turn_deg in _MOVES:
        barred = above if up > 0.0 or turn_deg != 0.0 else none
        index = np.flatnonzero(np.isnan(placed[:, 0]) & ~barred & ~(orbit if turn_deg != 0.0 else none))
        if not len(index):
            continue
        turn = math.radians(turn_deg)
        x, y, z = toward[index].T
        aim = np.stack([math.cos(turn) * x - math.sin(turn) * y, math.sin(turn) * x + math.cos(turn) * y, z], axis=1)
        offset = distance_m[index, np.newaxis] * (out * aim + [0.0, 0.0, up])
        tried_m = room.raised(at[index] + offset)
        good = _is_view(tried_m - at[index], above[index], furthest_m[index])
        index, tried_m = index[good], tried_m[good]
        lacks_m, _ = room.missing_m(as_legs(tried_m))
        good = (lacks_m.max(axis=1) <= 0.0) & in_sight(scene.terrain, tried_m, at[index])
        placed[index[good]] = tried_m[good]

    lacks_m, obstacle = room.missing_m(as_legs(asked_m))
    seen = in_sight(scene.terrain, asked_m, at)
    ground_m = scene.terrain.height_amsl_m(at[:, 0], at[:, 1])
    found = []
    for k, sight in enumerate(asked):
        if not at[k, 2] > ground_m[k]:
            problem = "expected views.below_top_m less than its height, got one that looks at the ground: lower it"
            found.append(_Place(None, f"{sight.name}: {problem}"))
        elif np.isnan(placed[k, 0]):
            found.append(_Place(None, f"{sight.name}: {_problem(room, lens, sight, lacks_m[k], obstacle[k], seen[k])}"))
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


def _problem(
    room: _Room, lens: CameraModel | None, sight: Sight, lacks_m: FloatArray, obstacle: int, seen: bool
) -> str:
    """Return why a view is flown from nowhere, and what to do."""
    if lens is not None and lens.gsd_mm(sight.distance_m + room.stray_m) > lens.gsd_max_mm:
        worst_mm, sharp_m = lens.gsd_mm(sight.distance_m + room.stray_m), _sharp_m(lens) - room.stray_m
        remedy = f"lower views.distance_m to {sharp_m:.1f} m" if sharp_m > 0.0 else "take a longer lens"
        return (
            f"expected a ground sampling distance of at most {lens.gsd_max_mm:g} mm (inspection.camera.gsd_max_mm), "
            f"got {worst_mm:.2f} mm with {room.stray_m:g} m off: {remedy}, or raise gsd_max_mm"
        )
    if (lacks_m > 0.0).any():
        what, _, remedy = room.told(lacks_m, obstacle).rpartition(": ")
        return f"{what}, and nowhere near it is clear: {remedy}"
    if not seen:
        return (
            "expected the ground to leave a view of it, got a hill between, and nowhere near it is clear: leave it out"
        )
    return "expected a place that is clear, got none: choose other views"


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
