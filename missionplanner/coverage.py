"""What was seen: of every tower each side asked for, of every span its conductors, judged by where vehicles flew.

A side of a tower was seen if a vehicle was near enough and within the angles that its view allows, with the ground
and all solids off the line of sight, and stood still there about as long as asked for. A place of a span was seen from
a side if a vehicle passed it so. Nothing is assumed between two positions further apart in time than ``GAP_S``: what
the log does not show was not seen.

**Which way did the camera look?** Logs seldom tell. A stand or photo counts for what is to be looked at from nearest to
where it happened (by the views' places and the ways along spans), no further off than a vehicle may stray: right of one
line is often left of the next. Where the plan of the flight is known, it counts only for what that was to look at.
Where views that look different ways are as near (but for straying), it counts for all of them if the flight was to look
at all and stood there, or passed, as often as there are of them, and else for none.

**Photos.** Where any log tells of photos, even of failed ones, what was not photographed was not seen, by no vehicle.
Where none does, positions alone decide, and :attr:`Coverage.by_position` says so.

Without :class:`.Assignment` there are no views: a tower counts then when a vehicle passed its top within
``inspection.range_m`` (as the proof counts plans).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from missionplanner import camera, views
from missionplanner.camera import CameraModel
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.plan import Trajectory
from missionplanner.scene import Scene
from missionplanner.spans import Span
from missionplanner.terrain import Terrain
from missionplanner.views import Sight, SpanSight

GAP_S = 2.0
"""Between positions further apart in time nothing is known."""
SPAN_SHARE = 0.95
"""The share of a span's length that is to be seen from a side: next to towers a little is hidden by them."""
_STEP_S = 0.25
_STEP_M = 1.0
_STILL_M_S = 1.0
_HOLD_SLACK_S = 1.0  # an autopilot counts a hold from where it is near, not from where it stands
_ANGLE_SLACK_DEG = 10.0  # views are at most that high, and vehicles a little off them
_PIECE_M = 5.0
_UP = np.array([0.0, 0.0, 1.0])
_APART_COS = 0.5  # views that differ by less look the same way: who shows one may show the other
_PASSED_SHARE = 0.9  # of the way that as many passes are long
_PASS_GAP = 3.0  # times as far apart as photos usually are: not one pass
_SIGHTINGS = 3  # of a place of a span: whose line of sight is looked at, the nearest first


@dataclass(frozen=True, slots=True)
class SideSeen:
    """One direction from which a tower was to be seen; figures are those of the best sighting, else of the nearest."""

    target: str
    visit: str  # that it belongs to, e.g. T01.orbit
    name: str  # e.g. T01.left
    toward: tuple[float, float, float]  # the direction in which it was to be seen from there; upwards: from above
    seen: bool
    distance_m: float | None  # from what is looked at; None: no vehicle was recorded
    angle_deg: float | None  # between the direction asked for and the line of sight, as seen from above
    elevation_deg: float | None  # of the vehicle as seen from there
    t_s: float | None
    vehicle: str
    gsd_mm: float | None  # where the camera is known
    photos: int | None  # that show it; None: no log tells
    why: str = ""  # it was not seen


@dataclass(frozen=True, slots=True)
class SpanSeen:
    """One side from which a span was to be seen."""

    target: str
    name: str  # e.g. span T01-T02.left
    seen: bool
    length_m: float
    share: float  # of its length
    distance_min_m: float | None  # of the places that were seen, each from its nearest sighting
    distance_max_m: float | None
    gsd_mm: float | None  # the coarsest
    photos: int | None
    vehicles: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Coverage:
    """What was seen of all that is asked for."""

    towers: tuple[SideSeen, ...]
    spans: tuple[SpanSeen, ...]
    weight: Mapping[str, float]  # of the towers
    by_position: bool = False  # photos were asked for, and no log tells of any

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of the figures must know, a line each."""
        return ("judged by position only: no log tells of photos",) if self.by_position else ()

    @property
    def done(self) -> frozenset[str]:
        """The towers and spans that were seen from all sides asked for."""
        rows: list[SideSeen | SpanSeen] = [*self.towers, *self.spans]
        return frozenset(row.target for row in rows) - {row.target for row in rows if not row.seen}

    @property
    def share(self) -> float:
        """The share of the towers' weight that was seen (PAPER.md eq. 6); of the spans' length, if there are none."""
        done = self.done
        parts = {row.target: self.weight[row.target] for row in self.towers}
        if not parts:
            parts = {row.target: row.length_m for row in self.spans}
        if sum(parts.values()) <= 0.0:  # nobody is asked for more than another
            parts = dict.fromkeys(parts, 1.0)
        whole = sum(parts.values())
        return sum(part for target, part in parts.items() if target in done) / whole if whole > 0.0 else 1.0

    @property
    def spans_share(self) -> float | None:
        """The share of the spans' length that was seen, each side asked for by itself; None: no spans."""
        whole_m = sum(row.length_m for row in self.spans)
        return sum(row.share * row.length_m for row in self.spans) / whole_m if self.spans else None

    @property
    def missing(self) -> tuple[str, ...]:
        """What was not seen and why, a line each."""
        towers = [f"{row.name}: {row.why}" for row in self.towers if not row.seen]
        spans = [f"{row.name}: {row.share:.0%} of {row.length_m:.0f} m seen" for row in self.spans if not row.seen]
        return (*towers, *spans)

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "share": round(self.share, 4),
            "spans_share": None if self.spans_share is None else round(self.spans_share, 4),
            "done": sorted(self.done),
            "missing": list(self.missing),
            "notes": list(self.notes),
            "towers": [_row_json(row) for row in self.towers],
            "spans": [_row_json(row) for row in self.spans],
        }


def _row_json(row: SideSeen | SpanSeen) -> dict[str, Any]:
    values = ((name, getattr(row, name)) for name in row.__slots__)
    return {
        name: round(value, 3) if isinstance(value, float) else list(value) if isinstance(value, tuple) else value
        for name, value in values
        if name != "toward"
    }


def measure(
    scene: Scene,
    tracks: Sequence[Trajectory],
    *,
    names: Sequence[str] = (),
    photos: Sequence[Trajectory | None] = (),
    targets: Sequence[Collection[str] | None] = (),
) -> Coverage:
    """Return what flights have seen.

    Parameters
    ----------
    scene : of the mission; of an open one, that without routes
    tracks : recorded positions, one for each flight of a vehicle
    names : whose, for each track
    photos : when and where each track's vehicle took photos; None: its log does not tell
    targets : what each was to look at by its plan; None: that is not known

    Raises
    ------
    MissionError
        A camera that is not known.
    """
    lens = None if scene.mission.inspection is None else camera.of(scene.mission.inspection.camera)
    none = [None] * len(tracks)
    flown = _Flown(tracks, names or [""] * len(tracks), photos or none, targets or none)
    towers = scene.towers
    weight = {} if towers is None else dict(zip(towers.names, towers.weight.tolist(), strict=True))
    if not scene.mission.is_open:
        return Coverage(tuple(_passes(scene, flown, lens)), (), weight)
    tube_m = max((task.limits.tube_m for task in scene.tasks), default=0.0)
    sights, along = views.sights(scene), views.span_sights(scene)
    setting = _Setting(scene.terrain, views.hiding(scene), lens, tube_m)
    places, ways = _Places(sights, tube_m), _Ways(along, tube_m)
    sides = tuple(_side(setting, flown, places, sight) for sight in sights)
    evidence = _Evidence.of(flown, photographed=lens is not None)
    spans = tuple(_span(setting, flown, ways, evidence, sight) for sight in along)
    photographed = any(sight.photos for sight in sights) or (lens is not None and len(along) > 0)
    by_position = photographed and len(flown.t_s) > 0 and not flown.told.any()
    return Coverage(sides, spans, weight, by_position)


@dataclass(frozen=True, slots=True, eq=False)
class _Setting:
    """What is looked through, and with what."""

    terrain: Terrain
    solids: SpaceArrays | None
    lens: CameraModel | None
    tube_m: float

    def in_sight(self, from_m: FloatArray, to_m: FloatArray) -> npt.NDArray[np.bool_]:
        return views.in_sight(self.terrain, from_m, to_m, self.solids)


class _Flown:
    """Where vehicles were, closely sampled between positions that are not far apart in time."""

    def __init__(
        self,
        tracks: Sequence[Trajectory],
        names: Sequence[str],
        photos: Sequence[Trajectory | None],
        targets: Sequence[Collection[str] | None],
    ) -> None:
        sampled = [_samples(track) for track in tracks]
        track = [np.full(len(t_s), k) for k, (t_s, _, _) in enumerate(sampled)]
        self.names = names
        self.t_s = np.concatenate([np.zeros(0), *(t_s for t_s, _, _ in sampled)])
        self.position_m = np.concatenate([np.zeros((0, 3)), *(at_m for _, at_m, _ in sampled)])
        self.joined = np.concatenate([np.zeros(0, dtype=bool), *(joined for _, _, joined in sampled)])
        self.track = np.concatenate([np.zeros(0, dtype=np.intp), *track])
        self.still = np.concatenate([np.zeros(0, dtype=bool), *(_stands(*samples) for samples in sampled)])
        self.tree = cKDTree(self.position_m)
        known = [k for k, taken in enumerate(photos) if taken is not None]
        # (tracks,) whether it is known which photos it took: where one log tells of photos, the others tell of none
        self.told = np.full(len(tracks), len(known) > 0)
        self.targets = [None if of_track is None else frozenset(of_track) for of_track in targets]
        follows = self.joined & self.still & np.concatenate([[False], self.still[:-1]])[: len(self.still)]
        self.stay = np.cumsum(~follows)  # (S,) which stay each sample belongs to; who moves makes none
        taken_m = [taken.position_m for taken in photos if taken is not None]
        self.photo_m = np.concatenate([np.zeros((0, 3)), *taken_m])
        self.photo_track = np.repeat(np.array(known, dtype=np.intp), [len(at_m) for at_m in taken_m])
        self.photo_tree = cKDTree(self.photo_m)


def _samples(track: Trajectory) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Return times (S,), positions (S, 3), and whether (S,) each follows on the one before it without a gap."""
    if not len(track.t_s):
        return np.zeros(0), np.zeros((0, 3)), np.zeros(0, dtype=np.bool_)
    gap_s = np.diff(track.t_s)
    way_m = np.linalg.norm(np.diff(track.position_m, axis=0), axis=1)
    known = gap_s <= GAP_S
    pieces = np.where(known, np.maximum(np.ceil(np.maximum(gap_s / _STEP_S, way_m / _STEP_M)), 1.0), 1.0).astype(int)
    first = np.concatenate([[0], np.cumsum(pieces)])
    place = np.interp(np.arange(first[-1] + 1), first, np.arange(len(track.t_s)))
    t_s = np.interp(place, np.arange(len(track.t_s)), track.t_s)
    joined = np.concatenate([[False], np.repeat(known, pieces)])
    return t_s, track.at(t_s), joined


def _stands(t_s: FloatArray, position_m: FloatArray, joined: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return which samples (S,) begin or end a piece of the way at which the vehicle hardly moves."""
    if not len(t_s):
        return np.zeros(0, dtype=np.bool_)
    way_m = np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    slow = joined[1:] & (way_m <= _STILL_M_S * np.diff(t_s))
    stands: npt.NDArray[np.bool_] = np.concatenate([[False], slow]) | np.concatenate([slow, [False]])
    return stands


@dataclass(frozen=True, slots=True, eq=False)
class _Aspect:
    """How places are seen from what they look at."""

    distance_m: FloatArray  # (N,)
    angle_deg: FloatArray  # (N,) off the direction asked for, as seen from above; from above a tower: off the vertical
    elevation_deg: FloatArray  # (N,)

    @classmethod
    def of(cls, offset_m: FloatArray, toward: FloatArray) -> _Aspect:
        """Return it of places that far (N, 3) from what they look at."""
        across_m = np.hypot(offset_m[:, 0], offset_m[:, 1])
        elevation_deg = np.degrees(np.arctan2(offset_m[:, 2], across_m))
        if toward[2] > 0.5:
            angle_deg = 90.0 - elevation_deg
        else:
            along, beside = offset_m[:, :2] @ toward[:2], offset_m[:, :2] @ np.array([-toward[1], toward[0]])
            angle_deg = np.degrees(np.abs(np.arctan2(beside, along)))
        return cls(np.linalg.norm(offset_m, axis=1), angle_deg, elevation_deg)


@dataclass(frozen=True, slots=True, eq=False)
class _Claim:
    """Whether what happened at places counts for a view."""

    near: npt.NDArray[np.bool_]  # (N,) it is the nearest, or as near as another
    rivals: npt.NDArray[np.intp]  # (N,) how many others, which look another way, are as near

    @property
    def sure(self) -> npt.NDArray[np.bool_]:
        """Return which (N,) count for this view and no other."""
        sure: npt.NDArray[np.bool_] = self.near & (self.rivals == 0)
        return sure

    @classmethod
    def of(
        cls,
        own_m: FloatArray,
        others_m: FloatArray,
        stray_m: float,
        apart: npt.NDArray[np.bool_],
        group: npt.NDArray[np.intp],
        *,
        placed: bool,
    ) -> _Claim:
        """Return it of places so far (N,) from where the view is flown, and so far (N, L) from others'.

        ``apart`` (L,): which look another way, at another target. ``group`` (L,): those of one are one rival.
        """
        nearest_m = np.minimum(others_m.min(axis=1, initial=math.inf), own_m if placed else math.inf)
        near = own_m <= nearest_m + stray_m if placed else own_m + stray_m < nearest_m
        close = others_m <= (nearest_m + stray_m)[:, np.newaxis]
        rivals = np.zeros(len(own_m), dtype=np.intp)
        for one in np.unique(group[apart]):
            rivals += close[:, apart & (group == one)].any(axis=1)
        return cls(near, rivals)


class _Places:
    """Where towers are looked at from, to tell what a stand or photo was for."""

    def __init__(self, sights: Sequence[Sight], stray_m: float) -> None:
        self._stray_m = stray_m
        placed = [sight for sight in sights if sight.from_m is not None]
        self._from_m = np.array([sight.from_m for sight in placed]).reshape(-1, 3)
        self._toward = np.array([sight.toward for sight in placed]).reshape(-1, 3)
        names = {name: k for k, name in enumerate(dict.fromkeys(sight.target for sight in sights))}
        self._names = names
        self._target = np.array([names[sight.target] for sight in placed], dtype=np.intp)
        self._tree = cKDTree(self._from_m)

    def claim(self, flown: _Flown, sight: Sight, position_m: FloatArray, track: npt.NDArray[np.intp]) -> _Claim:
        """Return whether stands or photos at places (N, 3) of tracks (N,) are of a side of a tower."""
        from_m = sight.at_m + sight.distance_m * sight.toward if sight.from_m is None else sight.from_m
        own_m = np.linalg.norm(position_m - from_m, axis=1)
        around_m = 2.0 * float(own_m.max(initial=0.0)) + 2.0 * self._stray_m
        others = np.array(self._tree.query_ball_point(from_m, around_m), dtype=np.intp)
        others_m = np.linalg.norm(position_m[:, np.newaxis] - self._from_m[others], axis=2)
        barred = _barred(flown, track, self._names)
        if barred is not None:
            others_m[barred[:, self._target[others]]] = math.inf
            own_m = np.where(barred[:, self._names[sight.target]], math.inf, own_m)
        group = self._target[others]
        apart = (group != self._names[sight.target]) & (self._toward[others] @ sight.toward < _APART_COS)
        found = _Claim.of(own_m, others_m, self._stray_m, apart, group, placed=sight.from_m is not None)
        return _Claim(found.near & np.isfinite(own_m), found.rivals)


class _Ways:
    """Which ways run along spans, to tell what was passed or photographed on them."""

    def __init__(self, sights: Sequence[SpanSight], stray_m: float) -> None:
        self._stray_m = stray_m
        placed = [sight for sight in sights if sight.way_m is not None]
        self._side = [sight.name for sight in placed]
        self._way_m = np.array([sight.way_m for sight in placed]).reshape(-1, 2, 3)
        self._toward = np.array([sight.toward for sight in placed]).reshape(-1, 3)
        names = {name: k for k, name in enumerate(dict.fromkeys(sight.span.name for sight in sights))}
        self._names = names
        self._target = np.array([names[sight.span.name] for sight in placed], dtype=np.intp)
        self._half_m = 0.5 * np.linalg.norm(self._way_m[:, 1] - self._way_m[:, 0], axis=1)
        self._tree = cKDTree(self._way_m.mean(axis=1))

    def claim(self, flown: _Flown, sight: SpanSight, position_m: FloatArray, track: npt.NDArray[np.intp]) -> _Claim:
        """Return whether what happened at places (N, 3) of tracks (N,) was along a side of a span."""
        way_m = sight.way_m
        if way_m is None:
            aside = sight.lateral_m * sight.toward + [0.0, 0.0, sight.vertical_m]
            way_m = np.stack([sight.span.curve_m[0] + aside, sight.span.curve_m[-1] + aside])
        own_m = _off_way_m(position_m, way_m)
        around_m = float(np.linalg.norm(way_m[1] - way_m[0])) + 2.0 * float(own_m.max(initial=0.0))
        around_m += float(self._half_m.max(initial=0.0)) + 2.0 * self._stray_m
        found = self._tree.query_ball_point(way_m.mean(axis=0), around_m)
        others = np.array([k for k in found if self._side[k] != sight.name], dtype=np.intp)
        others_m = (
            np.array([_off_way_m(position_m, self._way_m[k]) for k in others]).reshape(len(others), len(position_m)).T
        )
        barred = _barred(flown, track, self._names)
        if barred is not None:
            others_m = np.where(barred[:, self._target[others]], math.inf, others_m)
            own_m = np.where(barred[:, self._names[sight.span.name]], math.inf, own_m)
        apart = self._toward[others] @ sight.toward < _APART_COS
        claim = _Claim.of(own_m, others_m, self._stray_m, apart, others, placed=sight.way_m is not None)
        return _Claim(claim.near & np.isfinite(own_m), claim.rivals)


def _off_way_m(position_m: FloatArray, way_m: FloatArray) -> FloatArray:
    """Return the distances (N,) of places (N, 3) from a straight way (2, 3)."""
    along = way_m[1] - way_m[0]
    share = np.clip((position_m - way_m[0]) @ along / max(float(along @ along), 1e-9), 0.0, 1.0)
    distance_m: FloatArray = np.linalg.norm(position_m - way_m[0] - share[:, np.newaxis] * along, axis=1)
    return distance_m


def _barred(flown: _Flown, track: npt.NDArray[np.intp], names: Mapping[str, int]) -> npt.NDArray[np.bool_] | None:
    """Return whether what tracks (N,) show counts for none of the targets (N, T) by their plans; None: for any."""
    if all(of_track is None for of_track in flown.targets):
        return None
    rows = np.array([[of is not None and name not in of for name in names] for of in flown.targets], dtype=np.bool_)
    barred: npt.NDArray[np.bool_] = rows[track]
    return barred


def _planned(
    flown: _Flown, track: npt.NDArray[np.intp], which: npt.NDArray[np.bool_]
) -> Iterator[npt.NDArray[np.intp]]:
    """Yield what of ``which`` (N,) belongs to each track whose plan is known."""
    for one in np.unique(track[which]).tolist():
        if flown.targets[one] is not None:
            yield np.flatnonzero(which & (track == one))


def _stands_counted(flown: _Flown, claim: _Claim, sample: npt.NDArray[np.intp], hold_s: float) -> npt.NDArray[np.bool_]:
    """Return which stands, at samples (N,), count for a view: of as many as views look from there, all."""
    counted = claim.sure.copy()
    for own in _planned(flown, flown.track[sample], claim.near & ~counted):
        stays = 0.0
        for stay in np.unique(flown.stay[sample[own]]):
            t_s = flown.t_s[sample[own][flown.stay[sample[own]] == stay]]
            stays += max(1.0, float(np.ptp(t_s) + _HOLD_SLACK_S) // max(hold_s, 1.0))
        counted[own] = hold_s <= 0.0 or stays >= 1 + claim.rivals[own].max()
    return counted


def _photos_counted(flown: _Flown, claim: _Claim, track: npt.NDArray[np.intp]) -> npt.NDArray[np.bool_]:
    """Return which photos (N,) count for a view: of as many as views look from there, all."""
    counted = claim.sure.copy()
    for own in _planned(flown, track, claim.near & ~counted):
        counted[own] = len(own) >= 1 + claim.rivals[own].max()
    return counted


def _passes_counted(
    flown: _Flown, claim: _Claim, track: npt.NDArray[np.intp], index: npt.NDArray[np.intp], along_m: FloatArray
) -> npt.NDArray[np.bool_]:
    """Return what (N,), so far along a way, counts for it: of as many passes as ways are there, all."""
    counted = claim.sure.copy()
    for own in _planned(flown, track, claim.near & ~counted):
        steps_m = np.abs(np.diff(along_m[own]))
        if len(steps_m):
            steps_m = steps_m[(np.diff(index[own]) == 1) & (steps_m <= max(_PASS_GAP * np.median(steps_m), _PIECE_M))]
        passes = 1 + claim.rivals[own].max()
        long_m = passes * float(np.ptp(along_m[own]))
        counted[own] = long_m > 0.0 and float(steps_m.sum()) >= _PASSED_SHARE * long_m
    return counted


def _side(setting: _Setting, flown: _Flown, places: _Places, sight: Sight) -> SideSeen:
    """Return whether a tower was seen from one side, and from where best."""
    lens = setting.lens
    reach_m = views.FURTHEST * sight.distance_m + setting.tube_m
    if lens is not None:
        reach_m = min(reach_m, lens.distance_m(lens.gsd_max_mm))
    level = sight.kind != "overfly"
    steepest_deg = views.STEEPEST_DEG + _ANGLE_SLACK_DEG

    def fitting(position_m: FloatArray) -> tuple[npt.NDArray[np.intp], _Aspect]:
        """Return which places (N, 3) show that side, and how all do."""
        aspect = _Aspect.of(position_m - sight.at_m, sight.toward)
        fits = (aspect.angle_deg <= sight.tolerance_deg) & (aspect.distance_m <= reach_m)
        if level:
            fits &= np.abs(aspect.elevation_deg) <= steepest_deg
        index = np.flatnonzero(fits)
        return index[setting.in_sight(position_m[index], np.tile(sight.at_m, (len(index), 1)))], aspect

    near = np.sort(np.array(flown.tree.query_ball_point(sight.at_m, reach_m), dtype=np.intp))
    fits, aspect = fitting(flown.position_m[near])
    taken = np.array(flown.photo_tree.query_ball_point(sight.at_m, reach_m), dtype=np.intp)
    taken = taken[fitting(flown.photo_m[taken])[0]]
    by = flown.photo_track[taken]
    taken = taken[_photos_counted(flown, places.claim(flown, sight, flown.photo_m[taken], by), by)]
    photos = len(taken) if flown.told.any() else None
    # a vehicle whose log tells of photos has seen what it has photographed
    good = ~flown.told | np.isin(np.arange(len(flown.told)), flown.photo_track[taken]) | (sight.photos == 0)
    stood = _stood(flown, near[fits], sight.hold_s)
    stands = fits[stood]
    claim = places.claim(flown, sight, flown.position_m[near[stands]], flown.track[near[stands]])
    counted = _stands_counted(flown, claim, near[stands], sight.hold_s)
    best = stands[counted & good[flown.track[near[stands]]]].tolist()
    why = ""
    if not best:
        why = _why_not(flown, near, fits, reach_m, sight, claim, counted)
    chosen = best or fits.tolist()
    if chosen:
        k = min(chosen, key=lambda k: aspect.angle_deg[k] + abs(aspect.elevation_deg[k]) * level)
        sample = near[k]
    elif len(flown.t_s):
        sample = flown.tree.query(sight.at_m)[1]
        aspect, k = _Aspect.of(flown.position_m[sample][np.newaxis] - sight.at_m, sight.toward), 0
    else:
        return _never(sight.target, sight.visit, sight.name, sight.toward, why)
    distance_m = float(aspect.distance_m[k])
    return SideSeen(
        target=sight.target,
        visit=sight.visit,
        name=sight.name,
        toward=_floats(sight.toward),
        seen=bool(best),
        distance_m=distance_m,
        angle_deg=float(aspect.angle_deg[k]),
        elevation_deg=float(aspect.elevation_deg[k]),
        t_s=float(flown.t_s[sample]),
        vehicle=flown.names[flown.track[sample]],
        gsd_mm=None if lens is None else lens.gsd_mm(distance_m),
        photos=photos,
        why=why,
    )


def _never(target: str, visit: str, name: str, toward: FloatArray, why: str) -> SideSeen:
    """Return that nobody was recorded who could have seen it."""
    return SideSeen(target, visit, name, _floats(toward), False, None, None, None, None, "", None, None, why)


def _floats(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def _stood(flown: _Flown, index: npt.NDArray[np.intp], hold_s: float) -> npt.NDArray[np.bool_]:
    """Return which of samples (N,), in order, belong to a time of standing still about as long as asked for."""
    if hold_s <= 0.0 or not len(index):
        return np.ones(len(index), dtype=np.bool_)
    still = flown.still[index]
    follows = np.concatenate([[False], (np.diff(index) == 1) & flown.joined[index[1:]] & still[1:] & still[:-1]])
    run = np.cumsum(~follows)  # which stay each sample belongs to
    _, begins, run = np.unique(run, return_index=True, return_inverse=True)
    ends = np.concatenate([begins[1:], [len(index)]]) - 1
    lasts_s = flown.t_s[index[ends]] - flown.t_s[index[begins]]
    enough: npt.NDArray[np.bool_] = still & (lasts_s[run] >= max(hold_s - _HOLD_SLACK_S, 0.0))
    return enough


def _why_not(
    flown: _Flown,
    near: npt.NDArray[np.intp],
    fits: npt.NDArray[np.intp],
    reach_m: float,
    sight: Sight,
    claim: _Claim,
    counted: npt.NDArray[np.bool_],
) -> str:
    if not len(flown.t_s):
        return "no flight was recorded"
    if not len(near):
        nearest_m = float(flown.tree.query(sight.at_m)[0])
        return f"expected a vehicle within {reach_m:.0f} m, got {nearest_m:.0f} m at the nearest"
    if not len(fits):
        return f"never within {sight.tolerance_deg:g} degrees of this side and in sight, {reach_m:.0f} m off or less"
    if not len(claim.near):
        return f"nobody stood still there for {sight.hold_s:g} s"
    if not claim.near.any():
        return "who stood there looked at something else, by the plan or since that is looked at from nearer by"
    if not counted.any():
        return "others are looked at from there, too, and too few stands show that it was this one"
    return "no photo was taken from there"


@dataclass(frozen=True, slots=True, eq=False)
class _Evidence:
    """From where spans may have been seen: where photos were taken; where vehicles flew that tell of none."""

    position_m: FloatArray  # (E, 3)
    track: npt.NDArray[np.intp]  # (E,)
    photo: npt.NDArray[np.bool_]  # (E,)
    tree: cKDTree

    @classmethod
    def of(cls, flown: _Flown, *, photographed: bool) -> _Evidence:
        """Return it; where no photos are asked for along spans, flying past is enough."""
        untold = np.flatnonzero(~flown.told[flown.track]) if photographed else np.arange(len(flown.track))
        flew = untold[::2]  # at most 2 m apart
        taken = np.arange(len(flown.photo_m)) if photographed else np.zeros(0, dtype=np.intp)
        position_m = np.concatenate([flown.position_m[flew], flown.photo_m[taken]])
        track = np.concatenate([flown.track[flew], flown.photo_track[taken]])
        photo = np.repeat([False, True], [len(flew), len(taken)])
        return cls(position_m, track, photo, cKDTree(position_m))


def _span(setting: _Setting, flown: _Flown, ways: _Ways, evidence: _Evidence, sight: SpanSight) -> SpanSeen:
    """Return how much of a span was seen from one side."""
    lens = setting.lens
    place_m, length_m = _pieces(sight.span)
    whole_m = float(length_m.sum())
    reach_m = views.FURTHEST * sight.distance_m + views.sag_m(sight.span) + setting.tube_m
    if lens is not None:
        reach_m = min(reach_m, lens.distance_m(lens.gsd_max_mm))
    near = evidence.tree.query_ball_point(place_m[len(place_m) // 2], reach_m + 0.5 * whole_m + _PIECE_M)
    index = np.sort(np.array(near, dtype=np.intp))
    # a conductor hangs in a plane: how far beside that, along it, and at which altitude
    axis = np.array([[-sight.toward[1], sight.toward[0], 0.0], sight.toward, _UP])
    away_m = (evidence.position_m[index] - place_m[0]) @ axis.T
    on_side = (away_m[:, 1] > 0.0) & (away_m[:, 1] <= reach_m)
    index, away_m = index[on_side], away_m[on_side]
    track = evidence.track[index]
    claim = ways.claim(flown, sight, evidence.position_m[index], track)
    counted = _passes_counted(flown, claim, track, index, away_m[:, 0])
    index, away_m = index[counted], away_m[counted]
    along_m, beside_m, above_m = away_m.T
    ahead_m = np.abs(along_m - ((place_m - place_m[0]) @ axis[0])[:, np.newaxis])
    higher_m = np.abs(above_m - (place_m[:, 2] - place_m[0, 2])[:, np.newaxis])
    distance_m = np.sqrt(beside_m**2 + ahead_m**2 + higher_m**2)
    fits = (distance_m <= reach_m) & (ahead_m <= math.tan(math.radians(views.beside_deg(lens))) * beside_m)
    fits &= higher_m <= math.tan(math.radians(views.LOWEST_DEG + _ANGLE_SLACK_DEG)) * np.hypot(beside_m, ahead_m)
    distance_m = np.where(fits, distance_m, math.inf)
    order = np.argsort(distance_m, axis=1, kind="stable")[:, :_SIGHTINGS]
    place, rank = np.nonzero(np.isfinite(np.take_along_axis(distance_m, order, axis=1)))
    by = order[place, rank]
    visible = setting.in_sight(evidence.position_m[index[by]], place_m[place])
    place, first = np.unique(place[visible], return_index=True)  # nearer ones come first
    by = by[visible][first]
    seen_m = distance_m[place, by]
    photos = np.unique(np.nonzero(np.isfinite(distance_m))[1])
    return SpanSeen(
        target=sight.span.name,
        name=sight.name,
        seen=float(length_m[place].sum()) >= SPAN_SHARE * whole_m,
        length_m=whole_m,
        share=float(length_m[place].sum()) / whole_m,
        distance_min_m=float(seen_m.min()) if len(seen_m) else None,
        distance_max_m=float(seen_m.max()) if len(seen_m) else None,
        gsd_mm=None if lens is None or not len(seen_m) else lens.gsd_mm(float(seen_m.max())),
        photos=int(evidence.photo[index[photos]].sum()) if flown.told.any() else None,
        vehicles=tuple(sorted({flown.names[track] for track in evidence.track[index[by]].tolist()})),
    )


def _pieces(span: Span) -> tuple[FloatArray, FloatArray]:
    """Return the middles (N, 3) and lengths (N,) of a conductor's pieces, each a few metres long."""
    catenary = span.conductor.catenary
    ends_m = catenary.at(np.linspace(0.0, 1.0, 1 + max(1, math.ceil(catenary.length_m / _PIECE_M))))
    return 0.5 * (ends_m[:-1] + ends_m[1:]), np.linalg.norm(np.diff(ends_m, axis=0), axis=1)


def _passes(scene: Scene, flown: _Flown, lens: CameraModel | None) -> Iterator[SideSeen]:
    """Yield whether each tower was passed as near as a mission without views asks for."""
    towers = scene.towers
    if towers is None:
        return
    for name, top_m in zip(towers.names, towers.top_m, strict=True):
        if not len(flown.t_s):
            yield _never(name, name, name, _UP, "no flight was recorded")
            continue
        distance_m, sample = flown.tree.query(top_m)
        elevation_deg = float(_Aspect.of((flown.position_m[sample] - top_m)[np.newaxis], _UP).elevation_deg[0])
        seen = bool(distance_m <= towers.range_m)
        yield SideSeen(
            target=name,
            visit=name,
            name=name,
            toward=_floats(_UP),
            seen=seen,
            distance_m=float(distance_m),
            angle_deg=None,
            elevation_deg=elevation_deg,
            t_s=float(flown.t_s[sample]),
            vehicle=flown.names[flown.track[sample]],
            gsd_mm=None if lens is None else lens.gsd_mm(float(distance_m)),
            photos=None,
            why=""
            if seen
            else f"expected a vehicle within {towers.range_m:g} m, got {distance_m:.0f} m at the nearest",
        )
