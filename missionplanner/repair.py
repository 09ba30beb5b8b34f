"""Waypoints moved as little as it takes for legs to be proven; what ``check --repair`` does.

Wherever a leg's tube is too near the ground, an obstacle or the fence, too high or too steep, the two ends of that leg
must move: a point at a share s along it follows them by 1 - s and s. Each such want is a half-space for the moves of a
sortie's waypoints, and the least moves that meet all of them are a least-distance problem (Lawson and Hanson 1974,
chapter 23). Solving it shows where the next want is, until nothing is left.

The ground only asks for height, so its half-spaces are exact. An obstacle's is tangent to it: for a convex one whoever
keeps to it is clear, so redrawing it where the leg now is can only shorten the moves. A leg right through an obstacle
is told a side first: the cheapest of left, right, above and below.

No waypoint is inserted: over a sharp ridge between two distant waypoints both of them are lifted, which is safe but
higher than a third one would be. Whatever moving waypoints cannot mend (separation, energy, speeds, turns, the way
home, unknown ground, items that are not understood) is left to the proof, to be told there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from missionplanner import kernels, obstacles, proof
from missionplanner.certificate import Position
from missionplanner.clearance import tube_clearances
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.motion.spline import spline_chords
from missionplanner.proof import Flight
from missionplanner.scene import Scene
from missionplanner.sortie import Sortie
from missionplanner.vehicle import VehicleLimits

ROOM_M = 0.03
"""How much more than is asked for a leg gets: places are rounded to 1e-7 degrees."""

FURTHEST_M = 1000.0
"""A waypoint that would have to move further is not repaired but another one."""

_ROUNDS = 200
_TRIFLE_M = 0.15
_FORGOTTEN = 5  # times
_SHORTER_M = 0.01  # by which moves must still shrink for another round
_INSIDE = 0.7  # a nearest way out that runs along the leg this much does not lead out
_DEFINED = 0.5  # length of a numerical gradient that has a direction
_BURIED_M = 1.0  # lower than this below what is asked, a leg is lifted before anything else
_AT_END_M = 2.0  # about how exactly the place of a bound is known
_STEP_M = 0.01
_SHIFT_ROUNDS = 200
_TRIFLE_M = 0.15
_FORGOTTEN = 5  # times
_TIE = 1.01  # sides that cost no more than this are equal
_SPLINE_CHORD_M = 0.05
_MOVED_M = 1e-6

_Kind = Literal["terrain", "ceiling", "altitude", "obstacle", "fence", "angle"]
_Side = Literal["cheapest", "above"]


@dataclass(frozen=True, slots=True)
class Move:
    """One mission item's waypoint, moved; local frame, z AMSL."""

    vehicle: str
    seq: int
    from_m: Position
    to_m: Position


@dataclass(frozen=True, slots=True, eq=False)
class Repair:
    """Sorties, in their order, with the moves that made them; one that needed none is the one that was given."""

    sorties: tuple[Sortie, ...]
    moves: tuple[Move, ...]


def repair(scene: Scene, sorties: Sequence[Sortie]) -> Repair:
    """Return sorties whose legs keep from ground, obstacles, fence and ceilings, and within the angles allowed.

    A copter's take-off stays where it stands, and so does where a vehicle lands: these only change in height. What is
    returned is to be proven: all that is not about legs is left as it was.

    Raises
    ------
    InfeasibleError
        Legs that cannot be made so by moving waypoints.
    """
    repaired, problems = [], []
    for flight in proof.predict(scene, sorties):
        try:
            repaired.append(_repaired(scene, flight))
        except InfeasibleError as error:
            problems.append(str(error))
    if problems:
        raise InfeasibleError("; ".join(problems))
    moves = [move for before, after in zip(sorties, repaired, strict=True) for move in moves_between(before, after)]
    return Repair(tuple(repaired), tuple(moves))


def moves_between(before: Sortie, after: Sortie) -> Iterator[Move]:
    """Yield how the waypoints of one sortie were moved to become another's, an item each, in the order flown."""
    ends = {leg.seq: (leg.end_m, moved.end_m) for leg, moved in zip(before.legs, after.legs, strict=True)}
    if before.ending == "loiter":
        # an item that makes it stay where its last leg ends goes with it
        ends.setdefault(before.ending_seq, (before.legs[-1].end_m, after.legs[-1].end_m))
    for seq, (start, end) in ends.items():
        if np.abs(end - start).max() > _MOVED_M:
            yield Move(before.name, seq, _position(start), _position(end))


# --- one sortie -----------------------------------------------------------------------------------------------------


def _repaired(scene: Scene, flight: Flight) -> Sortie:
    """Return the sortie, moved by as little as was found to be enough."""
    handles = _Handles.of(flight.sortie)
    sides = _Sides("cheapest")
    try:
        moved = _least_clear(scene, flight, handles, sides)
    except InfeasibleError:
        if not sides.taken:
            raise
        sides = _Sides("above")
        moved = _least_clear(scene, flight, handles, sides)
    trifling = np.abs(moved) < _TRIFLE_M
    if moved.any() and trifling.any():
        try:  # without what only comes from not knowing places exactly
            handles_left = handles.without(trifling)
            left = _least_clear(scene, flight, handles_left, sides)
            if _length(left) <= _length(moved) + _TRIFLE_M:
                handles, moved = handles_left, left
        except InfeasibleError:
            pass  # it was needed
    return handles.sortie(flight.sortie, moved) if moved.any() else flight.sortie


def _least_clear(scene: Scene, flight: Flight, handles: _Handles, sides: _Sides) -> FloatArray:
    """Return the moves (N,) of the handles after which nothing is wanted any more.

    Raises
    ------
    InfeasibleError
        None were found.
    """
    seen: dict[tuple[str, int], _Want] = {}
    forgotten = 0
    kept: dict[tuple[object, ...], _Want] = {}
    moved = np.zeros(handles.count)
    least: FloatArray | None = None
    for attempt in range(_ROUNDS):
        now = _flown(scene, flight, handles.sortie(flight.sortie, moved))
        wants = [want for want in _wants(scene, now, sides) if _matters(want, handles, now)]
        if not wants:
            least = moved if least is None or _length(moved) < _length(least) else least
        for want in wants:
            seen.setdefault((want.kind, want.seq), replace(want, told="" if attempt else want.told))
        kept = {key: _redrawn(scene, now, want) for key, want in kept.items()}
        kept.update({want.key: want for want in wants})
        ahead = _ahead(handles, moved, list(kept.values()))
        if ahead is None and least is None and forgotten < _FORGOTTEN:
            forgotten += 1  # older wants may stand against what is wanted where the legs are now
            kept = {want.key: want for want in wants}
            ahead = _ahead(handles, moved, wants)
        if ahead is None or (least is not None and _length(ahead) > _length(least) - _SHORTER_M):
            break
        moved = ahead
    if least is None:
        raise _infeasible(flight, list(seen.values()))
    return least


def _ahead(handles: _Handles, moved: FloatArray, wants: Sequence[_Want]) -> FloatArray | None:
    """Return the least moves that meet wants, as they are after those already ``moved``; None: there are none."""
    rows = np.array([handles.row(want.weights) for want in wants]).reshape(len(wants), handles.count)
    ahead = least_moves(rows, rows @ moved + np.array([want.short_m for want in wants]))
    return None if ahead is None or np.abs(ahead).max(initial=0.0) > FURTHEST_M else ahead


def _matters(want: _Want, handles: _Handles, flight: Flight) -> bool:
    """Return whether a want is one of ours; what no waypoint changes and comes after the last leg is the proof's.

    Raises
    ------
    InfeasibleError
        It is a leg's, and neither end may move as it would have to.
    """
    if np.any(handles.row(want.weights) != 0.0):
        return True
    if want.index >= len(flight.sortie.legs):
        return False
    raise _infeasible(flight, [want])


def _infeasible(flight: Flight, wants: Sequence[_Want]) -> InfeasibleError:
    """Return the error that wants cannot be met; those without words came up on the way."""
    told = ", ".join(dict.fromkeys(f"item {want.seq} {want.told}" for want in wants if want.told))
    others = ", ".join(f"{want.kind} at item {want.seq}" for want in wants if not want.told)
    against = f" (against it stand {others})" if others else ""
    return InfeasibleError(
        f"{flight.sortie.name}: {told}: cannot be repaired by moving waypoints{against}: put others between, or plan "
        "it again"
    )


def _flown(scene: Scene, flight: Flight, sortie: Sortie) -> Flight:
    """Return a sortie's flight; a copter's tube is about its legs, so that only a plane's is predicted anew."""
    return proof.predict(scene, [sortie])[0] if sortie.vehicle_class == "plane" else replace(flight, sortie=sortie)


def least_moves(rows: FloatArray, least: FloatArray) -> FloatArray | None:
    """Return the shortest vector (N,) with ``rows @ vector >= least`` for rows (M, N); None: there is none."""
    if not np.any(least > 0.0):
        return np.zeros(rows.shape[1])
    scale = float(np.max(least))
    system = np.vstack([rows.T, least / scale])
    target = np.zeros(len(system))
    target[-1] = 1.0
    try:
        residual = system @ nnls(system, target, maxiter=30 * len(rows) + 300)[0] - target
    except RuntimeError:  # it found no end: no answer either
        return None
    if not residual[-1] < -1e-9:
        return None
    vector: FloatArray = -scale * residual[:-1] / residual[-1]
    return vector if np.all(rows @ vector >= least - 1e-4) else None


def _length(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))


@dataclass(frozen=True, slots=True, eq=False)
class _Handles:
    """What of a sortie may move: which variable moves which coordinate of which leg's end; -1: it stays."""

    variable: npt.NDArray[np.intp]  # (L, 3)
    count: int

    @classmethod
    def of(cls, sortie: Sortie) -> _Handles:
        legs, variable, count = sortie.legs, np.full((len(sortie.legs), 3), -1), 0
        stays = {0} if sortie.legs[0].kind == "takeoff" else set()
        if sortie.ending == "land":
            last = len(legs) - 1
            stays.add(last)
            while last > 0 and np.array_equal(legs[last - 1].end_m, legs[last].end_m):
                last -= 1
                stays.add(last)
        for k, leg in enumerate(legs):
            if k > 0 and np.array_equal(leg.end_m, legs[k - 1].end_m):
                variable[k] = variable[k - 1]  # it waits, or climbs on, where it is
                continue
            if k not in stays:
                variable[k, :2] = count, count + 1
                count += 2
            touches_down = sortie.ending == "land" and leg.seq == sortie.ending_seq
            if touches_down and sortie.vehicle_class == "plane":
                continue
            if k > 0 and (leg.seq == legs[k - 1].seq or touches_down):
                variable[k, 2] = variable[k - 1, 2]  # of one item, or as high as before
            else:
                variable[k, 2] = count
                count += 1
        return cls(variable, count)

    def without(self, dropped: npt.NDArray[np.bool_]) -> _Handles:
        """Return the handles but for those dropped (N,): what they moved stays."""
        number = np.append(np.where(dropped, -1, np.cumsum(~dropped) - 1), -1)
        return _Handles(number[self.variable], int(np.count_nonzero(~dropped)))

    def sortie(self, sortie: Sortie, moved: FloatArray) -> Sortie:
        """Return the sortie with its ends moved by ``moved`` (N,)."""
        by = np.where(self.variable >= 0, np.append(moved, 0.0)[self.variable], 0.0)
        legs = tuple(
            replace(leg, end_m=leg.end_m + step) if step.any() else leg
            for leg, step in zip(sortie.legs, by, strict=True)
        )
        return replace(sortie, legs=legs)

    def row(self, weights: FloatArray) -> FloatArray:
        """Return the gradient (N,) of what grows by ``weights`` (L, 3) per metre of the legs' ends."""
        row = np.zeros(self.count + 1)
        np.add.at(row, self.variable, weights)
        return row[:-1]


# --- what is wanted -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Want:
    """That the legs' ends move by at least ``short_m`` in all, measured by ``weights`` (L, 3)."""

    kind: _Kind
    index: int  # of the tube; from the number of legs on: after the last leg
    seq: int
    share: float  # along the tube
    obstacle: int
    weights: FloatArray
    short_m: float
    need_m: float  # of the leg itself, from the obstacle
    place_m: FloatArray  # (3,), on the leg
    normal: FloatArray  # (3,)
    told: str
    held_m: FloatArray  # (L, 3): the ends for which it was drawn

    @property
    def key(self) -> tuple[object, ...]:
        """What it replaces: an older want of the same place. Several edges of a fence stand beside each other."""
        towards = tuple(np.round(self.normal, 1)) if self.kind == "fence" else ()
        return self.kind, self.index, round(self.share, 3), self.obstacle, towards, self.normal[2] > 0.0


@dataclass(slots=True)
class _Sides:
    """On which side legs through obstacles leave them: chosen once per leg, alike for all where equal."""

    prefer: _Side
    taken: dict[int, FloatArray] = field(default_factory=dict)  # by obstacle, -1: the fence


def _wants(scene: Scene, flight: Flight, sides: _Sides) -> list[_Want]:
    """Return the worst of each kind on each leg, where something is not as it must be."""
    limits, tubes = flight.task.limits, proof._tubes(scene, flight)
    pieces = np.concatenate([tube.pieces for tube in tubes])
    owner = np.concatenate([np.full(len(tube.pieces), k) for k, tube in enumerate(tubes)])
    wide = np.concatenate([np.full(len(tube.pieces), limits.tube_m + tube.wider_m) for tube in tubes])
    table = tube_clearances(scene.space, scene.terrain.bounds, pieces, wide)
    up, wants = np.array([0.0, 0.0, 1.0]), []
    for index, tube in enumerate(tubes):
        first = int(np.argmax(owner == index))
        own = slice(first, first + len(tube.pieces))
        spot = _Spot(flight, index, tube.leg.seq, tube.pieces)
        buried = False
        if tube.over_terrain:
            low = int(np.argmin(table.height_min_m[own]))
            height_m = float(table.height_min_m[own][low])
            if math.isfinite(height_m) and height_m < limits.terrain_margin_m:
                share = spot.share(low, _centre(scene, table.height_min_at_m[own][low], float(wide[first]), 1.0))
                told = f"terrain clearance is {height_m:.2f} m, expected {limits.terrain_margin_m:g} m"
                wants.append(spot.want("terrain", share, up, limits.terrain_margin_m - height_m, told))
                buried = height_m < limits.terrain_margin_m - _BURIED_M
            high = int(np.argmax(table.height_max_m[own]))
            above_m = float(table.height_max_m[own][high])
            if math.isfinite(above_m) and above_m > limits.height_agl_max_m:
                share = spot.share(high, _centre(scene, table.height_max_at_m[own][high], float(wide[first]), -1.0))
                told = f"reaches {above_m:.2f} m above the ground, allowed {limits.height_agl_max_m:g} m"
                wants.append(spot.want("ceiling", share, -up, above_m - limits.height_agl_max_m, told))
        tops = tube.pieces[:, :, 2]
        top = int(np.argmax(tops.max(axis=1)))
        top_m = float(tops[top].max()) + float(wide[first])
        if top_m > limits.alt_amsl_max_m:
            share = spot.share(top, tube.pieces[top, int(np.argmax(tops[top]))])
            told = f"reaches {top_m:.2f} m AMSL, allowed {limits.alt_amsl_max_m:g} m"
            wants.append(spot.want("altitude", share, -up, top_m - limits.alt_amsl_max_m, told))
        need_m = limits.obstacle_margin_m
        near = int(np.argmin(table.obstacle_m[own]))
        if table.obstacle_m[own][near] < need_m and not buried:  # the way out of an obstacle is another above ground
            name = scene.obstacles.names[int(table.obstacle[own][near])]
            told = f"{name} clearance is {table.obstacle_m[own][near]:.2f} m, expected {need_m:g} m"
            around = _Around(scene, flight, int(table.obstacle[own][near]), need_m + float(wide[first]))
            short_m = need_m - float(table.obstacle_m[own][near])
            wants.append(spot.away(around, near, table.obstacle_at_m[own][near], short_m, sides, told))
        edge = int(np.argmin(table.fence_m[own]))
        if table.fence_m[own][edge] < need_m:
            border = "fence" if scene.mission.fence is not None else "edge of the area"
            told = f"{border} clearance is {table.fence_m[own][edge]:.2f} m, expected {need_m:g} m"
            around = _Around(scene, flight, -1, need_m + float(wide[first]))
            short_m = need_m - float(table.fence_m[own][edge])
            wants.append(spot.away(around, edge, table.fence_at_m[own][edge], short_m, sides, told))
    return [*wants, *_too_steep(flight)]


@dataclass(frozen=True, slots=True, eq=False)
class _Spot:
    """One tube of a flight, and how places along it follow the ends of legs."""

    flight: Flight
    index: int
    seq: int
    pieces: FloatArray  # (N, 2, 3)

    def share(self, piece: int, place: FloatArray) -> float:
        """Return the share along the tube of a place in one of its pieces."""
        start, end = self.pieces[piece]
        along = end - start
        if np.hypot(along[0], along[1]) > 1.0:
            along, place = along * [1.0, 1.0, 0.0], place * [1.0, 1.0, 0.0]  # ground is met high or low beside the leg
        square = float(along @ along)
        within = min(1.0, max(0.0, float((place - start) @ along) / square)) if square > 0.0 else 1.0
        lengths = np.linalg.norm(self.pieces[:, 1] - self.pieces[:, 0], axis=1)
        total = float(lengths.sum())
        way = float(lengths[:piece].sum() + within * lengths[piece])
        if way > total - _AT_END_M:
            return 1.0
        return 0.0 if way < _AT_END_M else way / total

    def weights(self, share: float, normal: FloatArray) -> FloatArray:
        """Return how far (L, 3) a place goes along a normal, per metre of each leg's end."""
        sortie = self.flight.sortie
        weights = np.zeros((len(sortie.legs), 3))
        if self.index < len(sortie.legs):
            weights[self.index] = share * normal
            if self.index > 0:
                weights[self.index - 1] = (1.0 - share) * normal
        elif sortie.ending == "loiter":
            weights[-1] = normal
        elif sortie.ending == "rtl" and sortie.vehicle_class == "copter" and self.index == len(sortie.legs):
            # it returns as high as it is, unless that is too low
            level = sortie.legs[-1].end_m[2] >= sortie.home_m[2] + sortie.return_height_m
            weights[-1] = normal * [1.0 - share, 1.0 - share, 1.0 if level else 0.0]
        return weights

    def want(
        self,
        kind: _Kind,
        share: float,
        normal: FloatArray,
        short_m: float,
        told: str,
        obstacle: int = -1,
        need_m: float = 0.0,
    ) -> _Want:
        return _Want(
            kind,
            self.index,
            self.seq,
            share,
            obstacle,
            self.weights(share, normal),
            short_m + ROOM_M,
            need_m,
            self.place(share),
            normal,
            told,
            _ends(self.flight.sortie),
        )

    def place(self, share: float) -> FloatArray:
        """Return the place at a share of the straight line from the tube's beginning to its end."""
        place: FloatArray = self.pieces[0, 0] + share * (self.pieces[-1, 1] - self.pieces[0, 0])
        return place

    def away(self, around: _Around, piece: int, place: FloatArray, short_m: float, sides: _Sides, told: str) -> _Want:
        """Return the want to be further from an obstacle, or further inside the fence, than at a place on a piece."""
        kind: _Kind = "fence" if around.obstacle < 0 else "obstacle"
        share = self.share(piece, place)
        normal, leg = around.outward(place), self.pieces[piece]
        if (
            normal is None
            or _leads_nowhere(normal, leg, share)
            or (sides.prefer == "above" and kind == "obstacle")
            or (normal[2] < 0.0 and around.beyond(leg + short_m * normal)[1] > ROOM_M)
        ):
            normal, short_m = self._side(around, leg, share, short_m, sides)
        return self.want(kind, share, normal, short_m, told, around.obstacle, around.need_m)

    def _side(
        self, around: _Around, leg: FloatArray, share: float, short_m: float, sides: _Sides
    ) -> tuple[FloatArray, float]:
        """Return which way, and how far, a leg right through something leaves it."""
        handles = _Handles.of(self.flight.sortie)
        options: list[tuple[bool, float, FloatArray, float]] = []
        for normal in _ways(leg):
            grip = _length(handles.row(self.weights(share, normal)))
            shift_m = around.shift_m(leg, normal) if grip > 0.0 else math.inf
            if math.isfinite(shift_m):
                shut, lift_m = around.beyond(leg + shift_m * normal)
                shut |= bool(normal[2] < 0.0 and lift_m > ROOM_M)
                options.append((shut, math.hypot(shift_m, lift_m) / grip, normal, shift_m))
        if not options:
            return np.zeros(3), short_m
        open_ways = [option for option in options if not option[0]] or options
        if sides.prefer == "above":
            open_ways = [option for option in open_ways if option[2][2] > 0.0] or open_ways
        cheapest = min(option[1] for option in open_ways)
        equal = [option for option in open_ways if option[1] <= _TIE * cheapest]
        known = sides.taken.get(around.obstacle)
        chosen = equal[0] if known is None else max(equal, key=lambda option: float(option[2] @ known))
        sides.taken.setdefault(around.obstacle, chosen[2])
        return chosen[2], chosen[3]


def _leads_nowhere(normal: FloatArray, leg: FloatArray, share: float) -> bool:
    """Return whether a direction runs along a leg (2, 3), so that moving the leg there changes nothing."""
    along = leg[1] - leg[0]
    return 0.0 < share < 1.0 and abs(float(normal @ along)) > _INSIDE * float(np.linalg.norm(along))


def _ways(leg: FloatArray) -> list[FloatArray]:
    """Return the ways a leg can be moved aside: left first."""
    x, y, _ = leg[1] - leg[0]
    across = math.hypot(x, y)
    ahead = np.array([x / across, y / across, 0.0]) if across > 1.0 else np.array([1.0, 0.0, 0.0])
    left, up = np.array([-ahead[1], ahead[0], 0.0]), np.array([0.0, 0.0, 1.0])
    return [left, -left, up, -up] if across > 1.0 else [left, -left, ahead, -ahead]


@dataclass(frozen=True, slots=True, eq=False)
class _Around:
    """One obstacle (-1: fence and area) that a leg must keep ``need_m`` from."""

    scene: Scene
    flight: Flight
    obstacle: int
    need_m: float

    def distance_m(self, place: FloatArray) -> float:
        """Return how far a place is from the obstacle, or inside the fence."""
        x, y, z = place
        if self.obstacle < 0:
            return float(kernels.inside_distance(self.scene.space, x, y, z))
        return float(kernels.obstacle_distance(self.scene.obstacles.arrays, self.obstacle, x, y, z))

    def outward(self, place: FloatArray) -> FloatArray | None:
        """Return the direction (3,) in which the distance grows; None: there is no one such direction."""
        steps = _STEP_M * np.eye(3)
        gradient = np.array([self.distance_m(place + step) - self.distance_m(place - step) for step in steps])
        gradient /= 2.0 * _STEP_M
        length = _length(gradient)
        return gradient / length if length > _DEFINED else None

    def shift_m(self, leg: FloatArray, normal: FloatArray) -> float:
        """Return how far a leg (2, 3) must be moved along a direction to keep its distance; inf: it never does.

        Steps by what is missing: distances change by no more than a metre per metre.
        """
        space, column = self.scene.space, kernels.FENCE
        if self.obstacle >= 0:
            space, column = space._replace(obstacles=_alone(self.scene, self.obstacle)), kernels.OBSTACLE
        shift_m = 0.0
        for _ in range(_SHIFT_ROUNDS):
            moved = np.ascontiguousarray(leg[np.newaxis] + shift_m * normal)
            missing_m = self.need_m - float(kernels.legs_clearance(space, moved, math.inf)[0, column])
            if missing_m <= 0.0:
                return shift_m
            shift_m += max(missing_m, 2.0 * ROOM_M)
            if shift_m > FURTHEST_M:
                break
        return math.inf

    def beyond(self, leg: FloatArray) -> tuple[bool, float]:
        """Return whether a leg leaves fence or ceilings or meets an obstacle, and how much lift the ground asks for."""
        limits = self.flight.task.limits
        radius_m = np.array([limits.tube_m])
        table = tube_clearances(self.scene.space, self.scene.terrain.bounds, leg[np.newaxis], radius_m)
        missing_m = limits.terrain_margin_m - float(table.height_min_m[0])
        shut = (
            float(table.fence_m[0]) < limits.obstacle_margin_m
            or float(table.obstacle_m[0]) < limits.obstacle_margin_m - ROOM_M
            or float(table.height_max_m[0]) > limits.height_agl_max_m
            or float(leg[:, 2].max()) + limits.tube_m > limits.alt_amsl_max_m
            or math.isinf(missing_m)
        )
        return shut, max(missing_m, 0.0) if math.isfinite(missing_m) else 0.0


def _alone(scene: Scene, index: int) -> kernels.ObstacleArrays:
    """Return one obstacle without the others."""
    o = scene.obstacles.arrays
    one = slice(index, index + 1)
    vertices = o.vertices[o.vertex_start[index] : o.vertex_start[index + 1]]
    start = np.array([0, len(vertices)], dtype=np.int64)
    return obstacles.indexed(o.kind[one], o.params[one], o.bound[one], o.hard[one], vertices, start)


def _centre(scene: Scene, place: FloatArray, radius_m: float, sign: float) -> FloatArray:
    """Return whence a tube reaches a place that is its lowest (sign 1) or highest (-1) above the ground around.

    That is uphill or downhill of where the leg itself is.
    """
    x, y, z = place
    (east, west, north, south) = scene.terrain.height_amsl_m(
        np.array([x + 1.0, x - 1.0, x, x]), np.array([y, y, y + 1.0, y - 1.0])
    )
    slope = 0.5 * np.array([east - west, north - south])
    if not np.isfinite(slope).all():
        return place
    down_m = sign * radius_m / math.sqrt(1.0 + float(slope @ slope))
    return np.array([x - down_m * slope[0], y - down_m * slope[1], z + down_m])


def _too_steep(flight: Flight) -> Iterator[_Want]:
    """Yield the wants of legs that are steeper than the vehicle may climb or descend."""
    limits, sortie = flight.task.limits, flight.sortie
    for index, (before, leg) in enumerate(pairwise(sortie.legs), start=1):
        line = np.stack([before.end_m, leg.end_m])
        if leg.kind == "spline":
            line = spline_chords(sortie, index, _SPLINE_CHORD_M)
        steps = np.diff(line, axis=0)
        across = np.hypot(steps[:, 0], steps[:, 1])
        for sign, what in ((1.0, "climbs"), (-1.0, "descends")):
            rises = np.arctan2(sign * steps[:, 2], across)
            k = int(np.argmax(rises))
            most_rad = _steepest_rad(limits, sign)
            if rises[k] <= most_rad or not steps[k].any():
                continue
            told = f"{what} at {math.degrees(rises[k]):.1f} degrees, allowed {math.degrees(most_rad):.1f}"
            excess_m = sign * float(steps[k, 2]) - math.tan(most_rad) * float(across[k])
            if len(steps) > 1:  # of a curve, as if all of it were so steep
                excess_m *= float(across.sum()) / max(float(across[k]), ROOM_M)
            yield _steep_want(flight, index, sign, excess_m, told)


def _steepest_rad(limits: VehicleLimits, sign: float) -> float:
    return min(limits.climb_angle_rad if sign > 0.0 else limits.descent_angle_rad, math.radians(89.9))


def _steep_want(flight: Flight, index: int, sign: float, excess_m: float, told: str) -> _Want:
    """Return the want that a leg rises (sign 1) or sinks (-1) by less, or goes further."""
    legs, most = flight.sortie.legs, math.tan(_steepest_rad(flight.task.limits, sign))
    step = legs[index].end_m - legs[index - 1].end_m
    across = math.hypot(step[0], step[1])
    ahead = step[:2] / across if across > _MOVED_M else np.array([1.0, 0.0])
    normal = np.array([most * ahead[0], most * ahead[1], -sign])
    weights = np.zeros((len(legs), 3))
    weights[index], weights[index - 1] = normal, -normal
    return _Want(
        "angle",
        index,
        legs[index].seq,
        1.0,
        -1,
        weights,
        excess_m + ROOM_M,
        0.0,
        legs[index].end_m,
        normal,
        told,
        _ends(flight.sortie),
    )


def _ends(sortie: Sortie) -> FloatArray:
    return np.array([leg.end_m for leg in sortie.legs])


def _redrawn(scene: Scene, flight: Flight, want: _Want) -> _Want:
    """Return a want as it is now that the legs' ends have moved: how much of it is still short.

    Those of straight legs are drawn anew where the leg now is; those of curves stay the half-spaces that they were.
    """
    sortie, ends = flight.sortie, _ends(flight.sortie)
    met_m = float(np.sum(want.weights * (ends - want.held_m)))
    kept = replace(want, short_m=want.short_m - met_m, held_m=ends)
    curved = sortie.vehicle_class == "plane" or want.index >= len(sortie.legs)
    if curved or sortie.legs[want.index].kind == "spline" or want.kind in ("fence", "altitude"):
        return kept
    begin = sortie.legs[want.index - 1].end_m if want.index > 0 else sortie.home_m
    spot = _Spot(flight, want.index, want.seq, np.stack([begin, ends[want.index]])[np.newaxis])
    place = spot.place(want.share)
    if want.kind == "angle":
        sign = -float(np.sign(want.normal[2]))
        step = ends[want.index] - begin
        most = math.tan(_steepest_rad(flight.task.limits, sign))
        excess_m = sign * float(step[2]) - most * math.hypot(step[0], step[1])
        return _steep_want(flight, want.index, sign, excess_m, want.told)
    if want.kind == "obstacle":
        around = _Around(scene, flight, want.obstacle, want.need_m)
        normal = around.outward(place)
        if normal is None or _leads_nowhere(normal, spot.pieces[0], want.share):
            return kept
        short_m = want.need_m - around.distance_m(place)
        return spot.want("obstacle", want.share, normal, short_m, want.told, want.obstacle, want.need_m)
    then, now = scene.terrain.height_amsl_m(
        np.array([want.place_m[0], place[0]]), np.array([want.place_m[1], place[1]])
    )
    if not math.isfinite(now - then):
        return kept
    return replace(kept, short_m=kept.short_m + float(want.normal[2] * (now - then)), place_m=place)


def _position(point: FloatArray) -> Position:
    return float(point[0]), float(point[1]), float(point[2])
