"""The direct return from every point of a mission: told to at any instant, each vehicle is clear, and apart from all.

A copter that is told to return (by hand, low battery, lost link) brakes, climbs, flies straight home and descends:

- It comes to rest somewhere between where it is and its farthest stopping point, straight ahead. ArduCopter stops
  v^2 / 2a + a / 2p^2 ahead (sqrt controller, p = PSC_POSXY_P = 1 / s; v / p when slow); PX4 brakes with limited jerk,
  v^2 / 2a + v a / 2j, once its present acceleration is gone, and may fly back to where it was told. Both are within
  v^2 / 2a + v max(1 s, a / 2j), where v is what it flies plus what its present acceleration still adds. What that adds
  to the sides widens the place. PX4's trajectory is ahead of the vehicle, up to 2.7 m/s faster while it gains speed:
  wherever it moves it may have to brake from all that is commanded. Parameters that make a copter lean or answer more
  slowly than the default ones lengthen the 1 s, and it is as much further off when it sets out for home. Climb and
  descent go on as ArduCopter's, with b = 1 m/s^2 (WPNAV_ACCEL_Z) for a; PX4 brakes harder.
- Whoever climbs and is to climb further keeps three quarters of its rate while it brakes (PX4 all of it).
- It may climb all along, so the climb is anywhere above that way, up to the greater of its altitude and the return
  height; so high it flies home from anywhere above it. The ways home from a piece of the flight fill a triangle.
- Above home it descends to the ground.

A plane turns towards home, at any altitude between its own and the return height, as near its way as its guidance, its
bank and the strongest wind let it turn and circle (:meth:`.MotionModel.aside_m`).

In wind, a copter brakes with what is left of its lean limit when the strongest wind allowed for pushes it on. On its
way home it is off by what the wind it is planned with pushes it aside at most, whatever its course.

Pieces of the flight form trees; each node is a segment that all stopping ways of its piece are within a stated reach
of. Nodes are looked into until decided: nothing is sampled.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from missionplanner.certificate import Finding, Position
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import (
    CABLE,
    CONE,
    CURTAIN,
    CYLINDER,
    PRISM,
    ObstacleArrays,
    SpaceArrays,
    inside_distance,
    kernel,
    obstacle_distance,
    polygon_distance,
    terrain_height,
)
from missionplanner.plan import Trajectory
from missionplanner.terrain_bounds import Pyramid, least_height
from missionplanner.vehicle import MotionModel, VehicleLimits
from missionplanner.wind import braking_m_s2, pushed_off_m

_TICK_S = 0.1
_LEAN_S = 0.3  # for which ArduCopter still accelerates as before, with its default parameters
_CLIMB_KEPT = 0.75
"""ArduCopter climbs anew from its stopping point while it still brakes to that: 0.8 remain at WPNAV_JERK = 1 m/s^3."""

_SLOW_M_S = 0.3  # no direction is made of less
_PX4_GAINING_S = 0.75  # MPC_ACC_HOR / MPC_JERK_AUTO
_PX4_UNSEEN_M_S = 1.2
"""What PX4's trajectory gains to the side or backwards at most, by default, while it loses an acceleration.

Of what the vehicle does not show yet: the room for straying has been found to cover so much, and no more.
"""

_STARTING_M_S2 = 0.3  # who gains speed so fast has a target that is on its way
_LEVEL_M = 1.0
"""How far below its return height a copter may turn home: NAV_MC_ALT_RAD is 0.8 m."""

_ROOT_TICKS = 128
_NODES = 2 * _ROOT_TICKS  # per root, as a heap: node h has children 2 h and 2 h + 1; none has index 0
_FINE_M = 0.1  # reach of pieces that are not looked into further
_FINE_RISE_M = 0.25

# Columns of a node: ends of its segment, reach around it, lowest and highest altitude, the lowest at which it must be
# clear of the ground on its way as well (inf: taking off and landing only), what it is, and the lowest altitudes again,
# now as a line from the segment's one end to the other.
_AX, _AY, _BX, _BY, _REACH, _LOW, _HIGH, _FLOOR, _STATE, _LEAF, _LOW_A, _LOW_B = range(12)
_COLUMNS = 12
_ABSENT, _RETURNING, _LANDED = 0.0, 1.0, 2.0
_UNSET = -1.0  # as a leaf: below one

# What a vehicle passes through.
_WAY, _CLIMB, _HOME = range(3)  # the first takes up all the ground that the others do
_PARTS = ("on the way home", "where it brakes and climbs", "above home")

_TOLERANCE_M = 0.1
_SLICE_M = 2.0
_ROUNDING_M = 1e-9
_SAMPLE_M = 30.0
_AMPLE_M = 10.0  # beyond a margin: how much more there is nobody asks
_NARROW_M = 0.25
_STACK = 128
_CLIMB_TRIES = 4
_TRIES = 400
_EXHAUSTIVE = 8
"""Fleets of up to so many vehicles get the lowest heights found in so many tries, larger ones the first."""

_REMEDY = "give the obstacle a top, move the home, or set fleet.direct_return: waived"
_REMEDY_TOPPED = "look and stop further from it (views.distance_m), move the home, or set fleet.direct_return: waived"


class UnreturnableError(InfeasibleError):
    """No height brings one vehicle home clear, or two apart: who, when told to return, and what one lacks on its way.

    ``short_m`` is how much further off its legs would have to be; 0 where that does not help.
    """

    def __init__(self, message: str, vehicles: tuple[str, ...], t_s: float | None, short_m: float = 0.0) -> None:
        super().__init__(message)
        self.vehicles = vehicles
        self.t_s = t_s
        self.short_m = short_m


@dataclass(frozen=True, slots=True)
class Returning:
    """One vehicle that may be told to return at any time of its predicted flight.

    From ``airborne_s`` to ``descends_s`` it flies its mission; a copter climbs above home before, and sinks straight
    down at its end after. Where ``airborne_s`` is not before ``descends_s``, it only returns at its end.
    """

    name: str
    home_m: FloatArray  # (3,)
    limits: VehicleLimits
    motion: MotionModel
    trajectory: Trajectory  # since mission start
    airborne_s: float
    descends_s: float
    commanded_m_s: float = 0.0  # the fastest of its legs
    circles_at_m: FloatArray | None = None  # planes: the middle of the circle at its end; None: not known

    @property
    def circled_m(self) -> float:
        """How far from their middle a plane's circles at its end lead at most."""
        return self.motion.circle_m(*self._fastest())

    @property
    def aside_m(self) -> float:
        """How far aside of its straight way home a plane flies at most."""
        return self.motion.aside_m(*self._fastest())

    def _fastest(self) -> tuple[float, float, float]:
        """Return a plane's greatest airspeed and altitude, and the strongest wind."""
        high_m = float(self.trajectory.position_m[:, 2].max())
        home_m = self.motion.return_alt_amsl_m(high_m, float(self.home_m[2]))
        wind_m_s = max(self.limits.wind_max_m_s, math.hypot(*self.motion.wind_m_s))
        return max(self.commanded_m_s, self.motion.cruise_speed_m_s), max(high_m, home_m), wind_m_s


# --- pieces of the flight ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """A vehicle's flight as trees of pieces, all vehicles' of the same instants."""

    vehicle: Returning
    nodes: FloatArray  # (R * _NODES, _COLUMNS)
    home_m: FloatArray
    plane: bool
    radius_m: float  # around what is predicted
    widen_m: float  # around a plane's way home

    @property
    def default_amsl_m(self) -> float:
        return float(self.home_m[2]) + self.vehicle.motion.return_height_m

    def at(self, alt_amsl_m: float) -> _Flyer:
        """Return what the kernels ask of the vehicle when it returns at an altitude."""
        return _Flyer(self.nodes, self.home_m, alt_amsl_m, self.plane, self.radius_m, self.widen_m)

    def rounded_up_m(self, alt_amsl_m: float) -> float:
        """Return the least altitude from there on that is a whole number of metres above home."""
        home = float(self.home_m[2])
        return home + math.ceil(alt_amsl_m - home - 1e-6)

    def finding(self, node: int, keeps: str, value: float, required: float, remedy: str) -> Finding:
        """Return what the vehicle keeps on its returns, least on that from a node."""
        told = f", least when told to return at {self.time_s(node):.0f} s" if node >= 0 else " on its returns"
        proven = value >= required
        return Finding(
            "return",
            self.vehicle.name,
            proven=proven,
            detail=f"keeps {keeps}{told}, expected {required:.1f} m",
            remedy="" if proven else remedy,
            value=value,
            required=required,
            t_s=self.time_s(node) if node >= 0 else None,
        )

    def top_amsl_m(self, alt_amsl_m: float) -> float:
        """Return how high it is at most on its returns."""
        there = self.nodes[:, _STATE] == _RETURNING
        return max(float(self.nodes[there, _HIGH].max(initial=-math.inf)), alt_amsl_m)

    def time_s(self, node: int) -> float:
        """Return the middle of a node's piece."""
        root, h = divmod(node, _NODES)
        level = h.bit_length() - 1
        ticks = _ROOT_TICKS >> level
        return (root * _ROOT_TICKS + (h - (1 << level) + 0.5) * ticks) * _TICK_S

    def place(self, node: int, alt_amsl_m: float) -> Position:
        """Return where a piece is, in the middle of its segment."""
        root, h = divmod(node, _NODES)
        while self.nodes[root * _NODES + h, _LEAF] == _UNSET:
            h //= 2
        node = root * _NODES + h
        x, y = 0.5 * (self.nodes[node, [_AX, _AY]] + self.nodes[node, [_BX, _BY]])
        return float(x), float(y), alt_amsl_m


def _tracks(vehicles: Sequence[Returning]) -> list[_Track]:
    last_s = max((float(v.trajectory.t_s[-1]) for v in vehicles), default=0.0)
    ticks = max(1, math.ceil(last_s / _TICK_S - 1e-9)) + 1
    return [_track(vehicle, ticks) for vehicle in vehicles]


def _track(v: Returning, ticks: int) -> _Track:
    t: FloatArray = np.arange(ticks + 1, dtype=np.float64) * _TICK_S
    end_s = float(v.trajectory.t_s[-1])
    p = v.trajectory.at(t)
    between = np.linalg.norm(v.trajectory.at(v.trajectory.t_s) - Trajectory(t, p).at(v.trajectory.t_s), axis=1).max()
    plane = v.motion.vehicle_class == "plane"
    only_at_end = v.airborne_s >= v.descends_s
    before = t < v.airborne_s
    after = t > v.descends_s
    state = np.full(len(t), _RETURNING)
    if only_at_end:
        state[before & ~after] = _ABSENT
    if plane:
        if v.circles_at_m is not None:
            p[t > end_s, :2] = v.circles_at_m[:2]
        wide_m = v.circled_m if v.circles_at_m is not None else 2.0 * v.circled_m
        stop, swing = p[:, :2].copy(), np.where(t > end_s, wide_m, 0.0)
        low = high = p[:, 2]
        lift = np.zeros(len(t))
    else:
        p[before & (state == _RETURNING), :2] = v.home_m[:2]
        p[after, :2] = p[-1, :2]
        if v.descends_s < end_s:
            state[t > end_s] = _LANDED
        # as it is predicted: what is snapped to its home or landing place jumps there
        flown = v.trajectory.at(t)
        stop, swing, drop, rise, lift = stopping_region(v, flown)
        swing = swing + np.hypot(*(flown[:, :2] - p[:, :2]).T)
        low, high = p[:, 2] - drop, p[:, 2] + rise
    floor = np.where(before | after, math.inf, low)
    return _Track(
        vehicle=v,
        nodes=_grow(p, stop, swing + between, low, low + lift, high, floor, state),
        home_m=np.asarray(v.home_m, dtype=np.float64),
        plane=plane,
        radius_m=v.limits.tube_m if plane else v.limits.stray_m + pushed_off_m(v.motion),
        widen_m=v.aside_m if plane else 0.0,
    )


def stopping_region(v: Returning, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what a copter's flight (K, 3), sampled every tick, has ahead at each instant when told to return.

    Farthest stopping points (K, 2), how far to their sides, how far it drops and rises, how much it has climbed there.
    """
    motion = v.motion
    brakes_m_s2 = braking_m_s2(motion, v.limits.wind_max_m_s)
    step = np.diff(p, axis=0) / _TICK_S
    behind, ahead = np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])
    velocity = 0.5 * (behind + ahead)[:, :2]
    speed = np.maximum(np.hypot(*behind[:, :2].T), np.hypot(*ahead[:, :2].T))
    mean = np.hypot(*velocity.T)
    gain = (ahead - behind)[:, :2] / _TICK_S
    slow = mean < _SLOW_M_S  # it goes where it accelerates to, and hardly anywhere where it does not
    course = np.where(slow[:, np.newaxis], gain, velocity)
    heading = course / np.maximum(np.hypot(*course.T), 1e-6)[:, np.newaxis]
    along = np.maximum(np.einsum("nk,nk->n", gain, heading), 0.0)
    across = np.abs(gain[:, 0] * heading[:, 1] - gain[:, 1] * heading[:, 0])
    a, jerk = motion.acceleration_m_s2, motion.jerk_m_s3
    lag_s, lean_s = max(motion.settling_s, a / (2.0 * jerk)), _LEAN_S + motion.sluggish_s
    along, across = np.minimum(along, 2.0 * a), np.minimum(across, 2.0 * a)  # corners take twice as much
    if motion.autopilot == "px4":
        distance = stopping_m(speed + along**2 / (2.0 * jerk), brakes_m_s2, lag_s) + speed * along / jerk
        moves = (speed > _SLOW_M_S) | (np.hypot(*gain.T) > _STARTING_M_S2)
        distance = np.maximum(distance, np.where(moves, _target_stopping_m(v.commanded_m_s, a, jerk, lag_s), 0.0))
        unseen_m_s = min(max(0.0, a**2 / (2.0 * jerk) - _PX4_UNSEEN_M_S), v.commanded_m_s)
        sideways = across**2 / (2.0 * jerk) + np.where(moves, unseen_m_s, 0.0)
    else:
        distance = stopping_m(speed + lean_s * along, brakes_m_s2, lag_s)
        sideways = lean_s * across
    swing = sideways * (0.5 * speed / brakes_m_s2 + lag_s)
    swing = swing + 0.75 * motion.sluggish_s * speed  # it sets out for home before it is at rest
    swing = np.where(slow, swing + stopping_m(speed, brakes_m_s2, lag_s), swing)
    stop = p[:, :2] + distance[:, np.newaxis] * heading
    climb = np.maximum(behind[:, 2], ahead[:, 2])
    sink = np.minimum(behind[:, 2], ahead[:, 2])
    lift = _CLIMB_KEPT * np.maximum(sink, 0.0) / np.maximum(speed, _SLOW_M_S) * np.where(slow, 0.0, distance)
    braking_s = np.where(
        slow, 0.0, 0.5 * speed / brakes_m_s2 + lag_s
    )  # it stops along its leg, and so climbs meanwhile
    # with little jerk PX4 goes on gaining speed along its leg, up and down too, for longer than at its default
    gaining_s = max(0.0, a / jerk - _PX4_GAINING_S) if motion.autopilot == "px4" else 0.0
    drop, rise = (
        np.maximum(_overrun_m(motion, rate), rate * braking_s) + np.where(rate > 0.0, most_m_s * gaining_s, 0.0)
        for rate, most_m_s in (
            (np.maximum(-sink, 0.0), motion.descent_rate_m_s),
            (np.maximum(climb, 0.0), motion.climb_rate_m_s),
        )
    )
    return stop, swing, drop, rise, lift


def _target_stopping_m(commanded_m_s: float, a_m_s2: float, jerk_m_s3: float, lag_s: float) -> float:
    """Return how far ahead PX4's trajectory comes to rest at most, which may be faster than the vehicle behind it.

    The worst is told to return while it gains speed: a it loses in a / j, gains a^2 / 2j meanwhile, up to what is
    commanded, and has gone v a / j - a^3 / 6j^2 for v commanded.
    """
    gains = min(a_m_s2, math.sqrt(2.0 * commanded_m_s * jerk_m_s3))
    going_m = commanded_m_s * gains / jerk_m_s3 - gains**3 / (6.0 * jerk_m_s3**2)
    braking_m = commanded_m_s * (commanded_m_s / (2.0 * a_m_s2) + a_m_s2 / (2.0 * jerk_m_s3))
    settled_m = commanded_m_s * (commanded_m_s / (2.0 * a_m_s2) + lag_s)
    return max(going_m + braking_m, settled_m)


def stopping_m(speed_m_s: FloatArray, acceleration_m_s2: float, lag_s: float) -> FloatArray:
    """Return how far ahead a copter comes to rest at most."""
    distance: FloatArray = speed_m_s * (speed_m_s / (2.0 * acceleration_m_s2) + lag_s)
    return distance


def _overrun_m(motion: MotionModel, rate_m_s: FloatArray) -> FloatArray:
    """Return how much further a copter climbs or sinks at most."""
    b_m_s2, loop_s = motion.vertical_acceleration_m_s2, motion.settling_s
    knee_m_s = b_m_s2 * loop_s
    fast = rate_m_s**2 / (2.0 * b_m_s2) + 0.5 * knee_m_s * loop_s
    return np.where(rate_m_s > knee_m_s, fast, rate_m_s * loop_s)


@kernel
def _grow(
    p: FloatArray,
    stop: FloatArray,
    swing: FloatArray,
    low: FloatArray,
    low_there: FloatArray,
    high: FloatArray,
    floor: FloatArray,
    state: FloatArray,
) -> FloatArray:
    """Return the nodes of all pieces of a flight: places (K, 3), farthest stopping points (K, 2), altitudes (K,)."""
    last_tick = p.shape[0] - 1
    roots = (last_tick + _ROOT_TICKS - 1) // _ROOT_TICKS
    nodes = np.zeros((roots * _NODES, _COLUMNS))
    nodes[:, _LEAF] = _UNSET
    for root in range(roots):
        width = _ROOT_TICKS
        count = 1
        while width > 0:
            for n in range(count):
                h = root * _NODES + count + n
                if count > 1 and nodes[root * _NODES + (count + n) // 2, _LEAF] != 0.0:
                    continue
                nodes[h, _LEAF] = 1.0
                first = root * _ROOT_TICKS + n * width
                last = min(first + width, last_tick)
                if first < last:
                    _write_node(p, stop, swing, low, low_there, high, floor, state, first, last, nodes[h])
            width //= 2
            count *= 2
    return nodes


@kernel
def _write_node(
    p: FloatArray,
    stop: FloatArray,
    swing: FloatArray,
    low: FloatArray,
    low_there: FloatArray,
    high: FloatArray,
    floor: FloatArray,
    state: FloatArray,
    first: int,
    last: int,
    node: FloatArray,
) -> None:
    """Write one piece. Its segment runs between two points of the piece far from each other."""
    bx = ax = p[first, 0]
    by = ay = p[first, 1]
    b_low = a_low = low[first]
    for _ in range(2):
        farthest = -1.0
        x, y, z = bx, by, b_low
        for k in range(first, last + 1):
            for m in range(2):
                qx = p[k, 0] if m == 0 else stop[k, 0]
                qy = p[k, 1] if m == 0 else stop[k, 1]
                d = (qx - x) ** 2 + (qy - y) ** 2
                if d > farthest:
                    farthest = d
                    ax, ay, a_low, bx, by = x, y, z, qx, qy
                    b_low = low[k] if m == 0 else low_there[k]
    ex = bx - ax
    ey = by - ay
    ee = ex * ex + ey * ey
    reach = 0.0
    swung = 0.0
    rise = 0.0
    over = 0.0
    node[_LOW], node[_HIGH], node[_FLOOR], node[_STATE] = np.inf, -np.inf, np.inf, _ABSENT
    for k in range(first, last + 1):
        for m in range(2):
            wx = (p[k, 0] if m == 0 else stop[k, 0]) - ax
            wy = (p[k, 1] if m == 0 else stop[k, 1]) - ay
            s = min(1.0, max(0.0, (wx * ex + wy * ey) / ee)) if ee > 0.0 else 0.0
            reach = max(reach, math.hypot(wx - s * ex, wy - s * ey) + swing[k])
            over = max(over, a_low + s * (b_low - a_low) - (low[k] if m == 0 else low_there[k]))
        swung = max(swung, swing[k])
        rise = max(rise, high[k] - low[k])
        node[_LOW] = min(node[_LOW], low[k])
        node[_HIGH] = max(node[_HIGH], high[k])
        node[_FLOOR] = min(node[_FLOOR], floor[k])
        if state[k] == _RETURNING or node[_STATE] == _ABSENT:
            node[_STATE] = state[k]
    node[_AX], node[_AY], node[_BX], node[_BY], node[_REACH] = ax, ay, bx, by, reach
    node[_LOW_A], node[_LOW_B] = a_low - over, b_low - over
    fine = reach <= swung + _FINE_M and node[_HIGH] - node[_LOW] <= rise + _FINE_RISE_M
    node[_LEAF] = 1.0 if fine or last - first == 1 else 0.0


class _Flyer(NamedTuple):
    """What the kernels ask of one vehicle: its pieces, where it returns to and how high, how far off it is."""

    nodes: FloatArray
    home: FloatArray
    alt: float
    plane: bool
    radius: float  # around all that is predicted
    widen: float  # around a plane's way home


# --- one vehicle against what stands still -------------------------------------------------------------------------


@kernel
def _band(v: _Flyer, node: FloatArray) -> tuple[float, float]:
    """Return between which altitudes a piece's ways home are; the lower for where it turns home too early."""
    if v.plane:
        return min(node[_LOW], v.alt), max(node[_HIGH], v.alt)
    return max(node[_LOW], v.alt) - _LEVEL_M, max(node[_HIGH], v.alt)


@kernel
def _put(corners: FloatArray, node: FloatArray, x: float, y: float, z: float) -> None:
    """Write the triangle between a node's segment and a place, level."""
    corners[0, 0], corners[0, 1] = node[_AX], node[_AY]
    corners[1, 0], corners[1, 1] = node[_BX], node[_BY]
    corners[2, 0], corners[2, 1] = x, y
    corners[:, 2] = z


@kernel
def _wide_height(
    space: SpaceArrays,
    bounds: Pyramid,
    corners: FloatArray,
    wide: float,
    radius: float,
    enough: float,
    refuse: float,
    at: FloatArray,
) -> float:
    """Lower bound of the height above ground of all within ``wide`` to the sides of a level triangle, and ``radius``.

    What is wide is not high as well: two triangles, which are written to ``corners``, make up a rectangle around it.
    """
    if wide <= _NARROW_M:
        return least_height(space.terrain, bounds, corners, radius + wide, 1.0, enough, refuse, at)
    ux = corners[2, 0] - 0.5 * (corners[0, 0] + corners[1, 0])
    uy = corners[2, 1] - 0.5 * (corners[0, 1] + corners[1, 1])
    length = math.hypot(ux, uy)
    ux, uy = (ux / length, uy / length) if length > 0.0 else (1.0, 0.0)
    ahead = left = np.inf
    behind = right = -np.inf
    for k in range(3):
        along = corners[k, 0] * ux + corners[k, 1] * uy
        across = corners[k, 1] * ux - corners[k, 0] * uy
        ahead, behind = min(ahead, along - wide), max(behind, along + wide)
        left, right = min(left, across - wide), max(right, across + wide)
    best = enough
    place = np.empty(3)
    for half in range(2):
        for k in range(3):
            # left ahead, right behind, and one of the other two
            along = behind if k == 1 or (k == 2 and half == 1) else ahead
            across = right if k == 1 or (k == 2 and half == 0) else left
            corners[k, 0] = along * ux - across * uy
            corners[k, 1] = along * uy + across * ux
        found = least_height(space.terrain, bounds, corners, radius, 1.0, best, refuse, place)
        if found < best:
            best = found
            at[:] = place
        if best < refuse:
            break
    return best


@kernel
def _climbs(v: _Flyer, node: FloatArray) -> bool:
    """Whether all along a piece there is further to climb."""
    climbs: bool = max(node[_LOW_A], node[_LOW_B]) <= v.alt
    return climbs


@kernel
def _terrain_of(
    space: SpaceArrays,
    bounds: Pyramid,
    v: _Flyer,
    node: FloatArray,
    enough: float,
    refuse: float,
    at: FloatArray,
) -> float:
    """Lower bound of the height above ground of a piece's ways to rest and home."""
    if node[_STATE] != _RETURNING:
        return enough
    corners = np.empty((3, 3))
    place = np.empty(3)
    best = enough
    if not v.plane or node[_FLOOR] < np.inf:  # on its take-off and landing a plane is as low as they are
        z = min(node[_FLOOR], v.alt) if v.plane else _band(v, node)[0]
        _put(corners, node, v.home[0], v.home[1], z)
        best = _wide_height(space, bounds, corners, v.widen + node[_REACH], v.radius, best, refuse, at)
    if v.plane or best < refuse or node[_FLOOR] == np.inf:
        return best
    _put(corners, node, node[_BX], node[_BY], node[_FLOOR])
    found = _wide_height(space, bounds, corners, node[_REACH], v.radius, best, refuse, place)
    if found < best and node[_FLOOR] <= node[_LOW] and _climbs(v, node):
        _put(corners, node, node[_BX], node[_BY], node[_LOW_B])
        corners[0, 2] = node[_LOW_A]
        found = least_height(space.terrain, bounds, corners, v.radius + node[_REACH], 1.0, best, refuse, place)
    if found < best:
        best = found
        at[:] = place
    return best


@kernel
def _set_node(v: _Flyer, root: int, h: int) -> int:
    """Return the node that stands for a piece: itself, or the leaf it is part of."""
    while v.nodes[root * _NODES + h, _LEAF] == _UNSET:
        h //= 2
    return root * _NODES + h


@kernel
def _highest(space: SpaceArrays, v: _Flyer, margin: float) -> tuple[float, int]:
    """Return the greatest altitude that samples of the ground below the ways home ask for, and the leaf it is of.

    Only a first guess, that spares most of the search.
    """
    best = -np.inf
    best_leaf = -1
    for root in range(v.nodes.shape[0] // _NODES):
        for h in range(_ROOT_TICKS, _NODES, _ROOT_TICKS // 4):
            n = _set_node(v, root, h)
            node = v.nodes[n]
            if node[_STATE] != _RETURNING or (v.plane and node[_FLOOR] == np.inf):
                continue
            dx = v.home[0] - node[_BX]
            dy = v.home[1] - node[_BY]
            samples = 1 + int(math.sqrt(dx * dx + dy * dy) / _SAMPLE_M)
            for k in range(samples + 1):
                x = node[_BX] + dx * k / samples
                y = node[_BY] + dy * k / samples
                need = terrain_height(space.terrain, x, y) + margin + v.radius
                if need > best and (v.plane or need > node[_LOW]):
                    best = need
                    best_leaf = n
    return best, best_leaf


@kernel
def _least_terrain(
    space: SpaceArrays, bounds: Pyramid, v: _Flyer, margin: float, enough: float, at: FloatArray
) -> tuple[float, int]:
    """Lower bound of the height above ground of all returns, where, and on the return from which node.

    At most ``enough``, of node -1 then.

    It may be given up to :data:`_TOLERANCE_M` too low, but not so that it undercuts ``margin`` for it.
    """
    stack = np.empty(_STACK, dtype=np.int64)
    place = np.empty(3)
    best_node = -1
    proven = enough
    _, first = _highest(space, v, margin)
    if first >= 0:
        best = _terrain_of(space, bounds, v, v.nodes[first], enough, -np.inf, at)
        if best < enough:
            best_node = first
            proven = max(best - _TOLERANCE_M, min(best, margin))
    for root in range(v.nodes.shape[0] // _NODES):
        stack[0] = 1
        depth = 1
        while depth > 0:
            depth -= 1
            h = stack[depth]
            n = root * _NODES + h
            node = v.nodes[n]
            leaf = node[_LEAF] == 1.0
            found = _terrain_of(space, bounds, v, node, proven, -np.inf if leaf else proven, place)
            if found >= proven:
                continue
            if leaf:
                best_node = n
                proven = max(found - _TOLERANCE_M, min(found, margin))
                at[:] = place
            else:
                stack[depth] = 2 * h + 1
                stack[depth + 1] = 2 * h
                depth += 2
    return proven, best_node


@kernel
def _terrain_need(space: SpaceArrays, bounds: Pyramid, v: _Flyer, margin: float) -> tuple[float, int]:
    """Return the least altitude of all ways home that is proven clear of the ground, and the node that asks for it.

    At least the vehicle's, and a whole number of metres above home. A piece flown high enough anyway asks for nothing.
    """
    stack = np.empty(_STACK, dtype=np.int64)
    corners = np.empty((3, 3))
    place = np.empty(3)
    level = 0.0 if v.plane else _LEVEL_M
    need, need_node = _highest(space, v, margin + level)
    need = v.home[2] + np.ceil(max(need, v.alt) - v.home[2] - 1e-6)
    for root in range(v.nodes.shape[0] // _NODES):
        stack[0] = 1
        depth = 1
        while depth > 0:
            depth -= 1
            h = stack[depth]
            n = root * _NODES + h
            node = v.nodes[n]
            if node[_STATE] != _RETURNING or (v.plane and node[_FLOOR] == np.inf):
                continue
            leaf = node[_LEAF] == 1.0
            enough = margin + level - (need if v.plane else max(node[_LOW], need))
            _put(corners, node, v.home[0], v.home[1], 0.0)
            refuse = -np.inf if leaf else enough
            found = _wide_height(space, bounds, corners, v.widen + node[_REACH], v.radius, enough, refuse, place)
            if found >= enough:
                continue
            if leaf:
                need = v.home[2] + np.ceil(margin + level - found - v.home[2])
                need_node = n
                if need == np.inf:
                    return need, need_node
            else:
                stack[depth] = 2 * h + 1
                stack[depth + 1] = 2 * h
                depth += 2
    return need, need_node


@kernel
def _to_triangle(c: FloatArray, x: float, y: float) -> float:
    """Return the horizontal distance from a place to a triangle (3, 2 or more); 0 inside."""
    least2 = np.inf
    left = False
    right = False
    for k in range(3):
        n = (k + 1) % 3
        ex = c[n, 0] - c[k, 0]
        ey = c[n, 1] - c[k, 1]
        wx = x - c[k, 0]
        wy = y - c[k, 1]
        turn = ex * wy - ey * wx
        left = left or turn > 0.0
        right = right or turn < 0.0
        ee = ex * ex + ey * ey
        s = min(1.0, max(0.0, (wx * ex + wy * ey) / ee)) if ee > 0.0 else 0.0
        wx -= s * ex
        wy -= s * ey
        least2 = min(least2, wx * wx + wy * wy)
    if left != right:
        return 0.0
    return math.sqrt(least2)


@kernel
def _crosses(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> bool:
    abx = b[0] - a[0]
    aby = b[1] - a[1]
    cdx = d[0] - c[0]
    cdy = d[1] - c[1]
    one = abx * (c[1] - a[1]) - aby * (c[0] - a[0])
    two = abx * (d[1] - a[1]) - aby * (d[0] - a[0])
    three = cdx * (a[1] - c[1]) - cdy * (a[0] - c[0])
    four = cdx * (b[1] - c[1]) - cdy * (b[0] - c[0])
    crosses: bool = (one > 0.0) != (two > 0.0) and (three > 0.0) != (four > 0.0)
    return crosses


@kernel
def _across(a: FloatArray, b: FloatArray) -> float:
    """Return the horizontal distance between two triangles; 0 where they share a place."""
    least = np.inf
    for k in range(3):
        least = min(least, _to_triangle(a, b[k, 0], b[k, 1]), _to_triangle(b, a[k, 0], a[k, 1]))
    if least > 0.0:
        for k in range(3):
            for n in range(3):
                if _crosses(a[k], a[(k + 1) % 3], b[n], b[(n + 1) % 3]):
                    return 0.0
    return least


@kernel
def _to_outline(o: ObstacleArrays, i: int, corners: FloatArray) -> float:
    """Lower bound of the horizontal signed distance between a triangle and the outline of prism ``i``."""
    edge = np.empty((3, 3))
    least = np.inf
    for k in range(o.vertex_start[i], o.vertex_start[i + 1]):
        after = k + 1 if k + 1 < o.vertex_start[i + 1] else o.vertex_start[i]
        edge[0, :2] = o.vertices[k]
        edge[1, :2] = o.vertices[after]
        edge[2, :2] = o.vertices[after]
        least = min(least, _across(corners, edge))
    first, stop = o.vertex_start[i], o.vertex_start[i + 1]
    if least <= 0.0 or polygon_distance(o.vertices, first, stop, corners[0, 0], corners[0, 1]) <= 0.0:
        least = -1.0 * o.bound[i, 2]  # nobody is further inside than the circle around it is wide
    return least


@kernel
def _over_curtain(row: FloatArray, corners: FloatArray, wide: float, low: float, enough: float) -> float:
    """Return :func:`_solid_distance` for a curtain: its distance from a place grows with height, so that of the lowest.

    Its top is halved until known: a piece of it is as far to the side as the nearest, below as the highest of it.
    """
    line = np.empty((3, 3))
    part = np.empty((_STACK, 2))
    part[0, 0] = 0.0
    part[0, 1] = 1.0
    depth = 1
    proven = enough
    while depth > 0:
        depth -= 1
        first, last = part[depth, 0], part[depth, 1]
        for axis in range(3):
            line[0, axis] = row[axis] + first * (row[3 + axis] - row[axis])
            line[1, axis] = row[axis] + last * (row[3 + axis] - row[axis])
            line[2, axis] = line[1, axis]
        beneath = max(0.0, low - max(line[0, 2], line[1, 2]))
        aside = max(0.0, _across(corners, line) - wide)
        bound = math.hypot(aside, beneath) - row[6]
        if bound >= proven:
            continue
        most = math.hypot(aside, max(0.0, low - min(line[0, 2], line[1, 2]))) - row[6]
        if most - bound <= 0.5 * _TOLERANCE_M or depth + 2 > _STACK:
            proven = bound
            continue
        middle = 0.5 * (first + last)
        part[depth, 0], part[depth, 1] = first, middle
        part[depth + 1, 0], part[depth + 1, 1] = middle, last
        depth += 2
    return proven


@kernel
def _solid_distance(
    o: ObstacleArrays, i: int, corners: FloatArray, wide: float, low: float, high: float, enough: float
) -> float:
    """Lower bound of the distance to solid ``i``, at most ``enough``, of all above a triangle between two altitudes.

    And of all ``wide`` to its sides.
    """
    p = o.params
    kind = o.kind[i]
    if kind == CURTAIN:
        return _over_curtain(p[i], corners, wide, low, enough)
    if kind == CABLE:
        line = np.empty((3, 3))
        line[0], line[1], line[2] = p[i, :3], p[i, 3:6], p[i, 3:6]
        over: float = max(0.0, low - max(p[i, 2], p[i, 5]), min(p[i, 2], p[i, 5]) - high)
        if math.hypot(max(0.0, _across(corners, line) - wide), over) - p[i, 6] >= enough:
            return enough
        return _least_over(o, i, corners, low, high, enough + wide) - wide
    across: float
    if kind == PRISM:
        across = _to_outline(o, i, corners) - wide
        along: float = max(p[i, 0] - high, low - p[i, 1])
        if across <= 0.0:
            distance: float = along if along > 0.0 else max(across, along)
        else:
            distance = math.hypot(across, along) if along > 0.0 else across
        return min(enough, distance)
    # of the round ones nothing is nearer, at any altitude, than what is nearest to the axis
    x = p[i, 0] + max(0.0, _to_triangle(corners, p[i, 0], p[i, 1]) - wide)
    if kind == CYLINDER:
        return min(enough, obstacle_distance(o, i, x, p[i, 1], low))
    if kind == CONE:
        slices = max(1, math.ceil((high - low) / _SLICE_M))
        half = 0.5 * (high - low) / slices
        least = enough
        for k in range(slices):
            least = min(least, obstacle_distance(o, i, x, p[i, 1], low + (2 * k + 1) * half) - half)
        return least
    return min(enough, obstacle_distance(o, i, x, p[i, 1], min(max(low, p[i, 2]), high)))


@kernel
def _least_over(o: ObstacleArrays, i: int, corners: FloatArray, low: float, high: float, enough: float) -> float:
    """Return :func:`_solid_distance` for solids without a closed form: branch and bound.

    A distance changes by at most a metre per metre, so over a piece it is that of its middle less the piece's radius.
    """
    stack = np.empty((_STACK, 3, 3))
    band = np.empty((_STACK, 2))
    stack[0] = corners
    band[0, 0] = low
    band[0, 1] = high
    depth = 1
    found = np.inf
    proven = enough
    while depth > 0:
        depth -= 1
        piece = stack[depth]
        bottom, top = band[depth, 0], band[depth, 1]
        x, y, across, edge = _around(piece)
        half = 0.5 * (top - bottom)
        size = math.sqrt(across * across + half * half)
        d = obstacle_distance(o, i, x, y, bottom + half)
        found = min(found, d)
        bound = d - size
        if bound >= min(proven, found - _TOLERANCE_M) or size < 0.5 * _TOLERANCE_M or depth + 2 > _STACK:
            proven = min(proven, bound)
            continue
        stack[depth + 1] = piece
        band[depth + 1, 1] = top
        band[depth + 1, 0] = bottom
        if half > across:
            band[depth + 1, 0] = bottom + half
            band[depth, 1] = bottom + half
        else:
            _halve(piece, stack[depth + 1], edge)
        depth += 2
    return proven


@kernel
def _around(piece: FloatArray) -> tuple[float, float, float, int]:
    """Return the horizontal middle of a triangle, its radius around that, and its longest edge."""
    x = (piece[0, 0] + piece[1, 0] + piece[2, 0]) / 3.0
    y = (piece[0, 1] + piece[1, 1] + piece[2, 1]) / 3.0
    size = 0.0
    longest = -1.0
    edge = 0
    for k in range(3):
        n = (k + 1) % 3
        size = max(size, math.hypot(piece[k, 0] - x, piece[k, 1] - y))
        length = math.hypot(piece[n, 0] - piece[k, 0], piece[n, 1] - piece[k, 1])
        if length > longest:
            longest = length
            edge = k
    return x, y, size, edge


@kernel
def _halve(piece: FloatArray, rest: FloatArray, edge: int) -> None:
    """Cut a triangle, and its copy ``rest``, down to the two halves of one edge."""
    n = (edge + 1) % 3
    for axis in range(2):
        half = 0.5 * (piece[edge, axis] + piece[n, axis])
        piece[n, axis] = half
        rest[edge, axis] = half


@kernel
def _inside(space: SpaceArrays, corners: FloatArray, high: float, enough: float) -> float:
    """Lower bound of the distance inside area and fence, at most ``enough``, of all below ``high`` over a triangle."""
    proven = enough
    if space.fence.shape[0] == 0:  # to a rectangle the distance inside is concave: least at a corner
        for k in range(3):
            proven = min(proven, inside_distance(space, corners[k, 0], corners[k, 1], high))
        return proven
    stack = np.empty((_STACK, 3, 3))
    stack[0] = corners
    depth = 1
    found = np.inf
    while depth > 0:
        depth -= 1
        piece = stack[depth]
        x, y, size, edge = _around(piece)
        d = inside_distance(space, x, y, high)
        found = min(found, d)
        bound = d - size
        if bound >= min(proven, found - _TOLERANCE_M) or size < 0.5 * _TOLERANCE_M or depth + 2 > _STACK:
            proven = min(proven, bound)
            continue
        stack[depth + 1] = piece
        _halve(piece, stack[depth + 1], edge)
        depth += 2
    return proven


@kernel
def _solid_of(
    space: SpaceArrays, i: int, v: _Flyer, node: FloatArray, enough: float, corners: FloatArray
) -> tuple[float, int]:
    """Lower bound of the distance of a piece's returns to solid ``i`` (the fence: O), and whether on climb or way."""
    o = space.obstacles
    low, high = _band(v, node)
    wide = v.widen + node[_REACH]
    reach = v.radius + wide
    part = _WAY
    _put(corners, node, v.home[0], v.home[1], 0.0)
    if i == o.kind.shape[0]:
        return _inside(space, corners, high, enough + reach) - reach, part
    near = _to_triangle(corners, o.bound[i, 0], o.bound[i, 1]) - o.bound[i, 2] - reach
    if near >= enough:
        return enough, part
    best = _solid_distance(o, i, corners, wide, low, high, enough + v.radius) - v.radius
    if not v.plane:
        _put(corners, node, node[_BX], node[_BY], 0.0)
        found = _solid_distance(o, i, corners, wide, node[_LOW], high, best + v.radius) - v.radius
        if found < best and _climbs(v, node):
            found = best
            dx = node[_BX] - node[_AX]
            dy = node[_BY] - node[_AY]
            dz = node[_LOW_B] - node[_LOW_A]
            slices = max(1, math.ceil(max(math.hypot(dx, dy) / _SLICE_M, abs(dz))))
            for k in range(slices):
                for c in range(3):
                    s = min(k + c, k + 1) / slices
                    corners[c, 0] = node[_AX] + s * dx
                    corners[c, 1] = node[_AY] + s * dy
                low = node[_LOW_A] + dz * (k if dz > 0.0 else k + 1) / slices
                distance = _solid_distance(o, i, corners, wide, low, high, found + v.radius) - v.radius
                found = min(found, distance)
        if found < best:
            best = found
            part = _CLIMB
    return best, part


@kernel
def _least_solids(space: SpaceArrays, v: _Flyer, margin: float, enough: float) -> tuple[float, int, int, int]:
    """Lower bound of the distance of all returns to hard solids and fence; where told, to which, and on which part.

    It may be given up to :data:`_TOLERANCE_M` too low, but not so that it undercuts ``margin`` for it.
    """
    o = space.obstacles
    count = o.kind.shape[0]
    stack = np.empty(_STACK, dtype=np.int64)
    corners = np.empty((3, 3))
    proven = enough
    best_node = -1
    best_solid = -1
    best_part = _WAY
    top = v.alt
    for n in range(v.nodes.shape[0]):
        if v.nodes[n, _STATE] == _RETURNING:
            top = max(top, v.nodes[n, _HIGH])
    for seeding in range(1, -1, -1):  # a few leaves first: a good first bound spares most of the search
        for solid in range(count + 1):
            if solid < count and not o.hard[solid]:
                continue
            for root in range(v.nodes.shape[0] // _NODES):
                stack[0] = _ROOT_TICKS if seeding == 1 else 1
                depth = 1
                while depth > 0:
                    depth -= 1
                    h = stack[depth]
                    n = _set_node(v, root, h)
                    node = v.nodes[n]
                    if node[_STATE] != _RETURNING:
                        continue
                    found, part = _solid_of(space, solid, v, node, proven, corners)
                    if found >= proven - _ROUNDING_M:
                        continue
                    if node[_LEAF] == 1.0:
                        proven = max(found - _TOLERANCE_M, min(found, margin))
                        best_node, best_solid, best_part = n, solid, part
                    else:
                        stack[depth] = 2 * h + 1
                        stack[depth + 1] = 2 * h
                        depth += 2
            if not v.plane and seeding == 1:
                corners[:, 0], corners[:, 1] = v.home[0], v.home[1]
                if solid == count:
                    found = _inside(space, corners, top, proven + v.radius) - v.radius
                else:
                    found = _solid_distance(o, solid, corners, 0.0, v.home[2], top, proven + v.radius) - v.radius
                if found < proven - _ROUNDING_M:
                    proven, best_node, best_solid, best_part = found, -1, solid, _HOME
    return proven, best_node, best_solid, best_part


# --- two vehicles --------------------------------------------------------------------------------------------------


@kernel
def _region(v: _Flyer, node: FloatArray, part: int, corners: FloatArray) -> tuple[bool, float, float, float]:
    """Write one part of a piece's return; return whether there is one, its reach, lowest and highest altitude."""
    low, high = _band(v, node)
    if node[_STATE] == _LANDED:
        _put(corners, node, node[_BX], node[_BY], 0.0)
        return part == _CLIMB, node[_REACH], node[_LOW], node[_HIGH]
    if part == _WAY:
        _put(corners, node, v.home[0], v.home[1], 0.0)
        return True, node[_REACH] + v.widen, low, high
    if part == _CLIMB:
        _put(corners, node, node[_BX], node[_BY], 0.0)
        return not v.plane, node[_REACH], node[_LOW], high
    corners[:, 0], corners[:, 1], corners[:, 2] = v.home[0], v.home[1], 0.0
    return not v.plane, 0.0, v.home[2], high


@kernel
def _pair_of(
    a: _Flyer,
    one: FloatArray,
    b: _Flyer,
    two: FloatArray,
    enough: float,
    apart: FloatArray,
) -> float:
    """Lower bound of the distance between two pieces' returns, whatever the timing of each.

    ``apart`` (9, 2) takes the horizontal and vertical distance of each part of the one (row / 3) from each of the
    other (row % 3).
    """
    if one[_STATE] == _ABSENT or two[_STATE] == _ABSENT:
        return np.inf
    mine = np.empty((3, 3))
    other = np.empty((3, 3))
    best = np.inf
    for m in range(3):
        there, reach, low, high = _region(a, one, m, mine)
        for n in range(3):
            also, reach_two, low_two, high_two = _region(b, two, n, other)
            across = _across(mine, other) - reach - reach_two
            if m == _WAY and n == _WAY and across >= enough:
                return across  # all else is above or below the ways home
            row = 3 * m + n
            apart[row] = np.inf
            if there and also:
                apart[row, 0] = max(0.0, across)
                apart[row, 1] = max(0.0, low - high_two, low_two - high)
                best = min(best, math.hypot(apart[row, 0], apart[row, 1]))
    return best


@kernel
def _least_pair(
    a: _Flyer,
    b: _Flyer,
    enough: float,
) -> tuple[float, int]:
    """Lower bound of the distance between two vehicles told to return at the same instant, and which node's."""
    stack = np.empty(_STACK, dtype=np.int64)
    apart = np.empty((9, 2))
    best = enough
    best_node = -1
    for root in range(a.nodes.shape[0] // _NODES):
        stack[0] = 1
        depth = 1
        while depth > 0:
            depth -= 1
            h = stack[depth]
            n = root * _NODES + h
            one, two = a.nodes[_set_node(a, root, h)], b.nodes[_set_node(b, root, h)]
            found = _pair_of(a, one, b, two, best, apart)
            if found >= best:
                continue
            if one[_LEAF] == 1.0 and two[_LEAF] == 1.0:
                best = found
                best_node = n
            else:
                stack[depth] = 2 * h + 1
                stack[depth + 1] = 2 * h
                depth += 2
    return best, best_node


# Columns of `_orders`: whether the one may return below the other, whether above; how high the one is on pieces where
# they would meet, be it at its return height at least (1) or as it stands (0); the same of the other; when.
_BELOW, _ABOVE, _TOP_ONE, _MOVES_ONE, _TOP_TWO, _MOVES_TWO, _WHEN = range(7)


@kernel
def _orders(
    a: _Flyer,
    b: _Flyer,
    need: float,
) -> FloatArray:
    """Return which order of heights parts two vehicles: all pieces where they would meet must allow it.

    Whoever returns below may climb and descend below the other's way home, who in turn must not below its own.
    """
    out = np.array([1.0, 1.0, -np.inf, 0.0, -np.inf, 0.0, -1.0])
    stack = np.empty(_STACK, dtype=np.int64)
    apart = np.empty((9, 2))
    for root in range(a.nodes.shape[0] // _NODES):
        stack[0] = 1
        depth = 1
        while depth > 0:
            depth -= 1
            h = stack[depth]
            n = root * _NODES + h
            one, two = a.nodes[_set_node(a, root, h)], b.nodes[_set_node(b, root, h)]
            found = _pair_of(a, one, b, two, need, apart)
            if found >= need:
                continue
            if one[_LEAF] != 1.0 or two[_LEAF] != 1.0:
                stack[depth] = 2 * h + 1
                stack[depth + 1] = 2 * h
                depth += 2
                continue
            below, above = out[_BELOW], out[_ABOVE]
            for row in range(9):
                if math.hypot(apart[row, 0], apart[row, 1]) < need:
                    if row % 3 != _WAY:  # the one would be where the other climbs or descends
                        out[_BELOW] = 0.0
                    if row // 3 != _WAY:
                        out[_ABOVE] = 0.0
            if out[_WHEN] < 0.0 or out[_BELOW] != below or out[_ABOVE] != above:
                out[_WHEN] = n
            out[_TOP_ONE] = max(out[_TOP_ONE], one[_HIGH])
            out[_TOP_TWO] = max(out[_TOP_TWO], two[_HIGH])
            if one[_STATE] == _RETURNING:
                out[_MOVES_ONE] = 1.0
            if two[_STATE] == _RETURNING:
                out[_MOVES_TWO] = 1.0
    return out


# --- the proof -----------------------------------------------------------------------------------------------------


def prove_returns(
    space: SpaceArrays,
    bounds: Pyramid,
    names: Sequence[str],
    vehicles: Sequence[Returning],
    separation_m: Callable[[int, int], float],
    *,
    waived: bool = False,
) -> list[Finding]:
    """Return a finding per vehicle, of its return whenever told to, and one per pair told to at the same instant.

    ``separation_m(i, j)`` is how far apart predicted flights must be: the fleet's separation and how far either may be
    from its prediction. The ceiling above ground does not bind in an emergency; that above sea level does.
    """
    pairs = list(itertools.combinations(range(len(vehicles)), 2))
    if waived:
        who = [v.name for v in vehicles] + [_both(vehicles[i], vehicles[j]) for i, j in pairs]
        detail = "the direct return is not asked for (fleet.direct_return: waived)"
        return [Finding("return", name, proven=False, detail=detail, waived=True) for name in who]
    tracks = _tracks(vehicles)
    found = [_alone(space, bounds, names, track, track.default_amsl_m) for track in tracks]
    return found + [_together(tracks[i], tracks[j], separation_m(i, j)) for i, j in pairs]


def _both(one: Returning, two: Returning) -> str:
    return f"{one.name} - {two.name}"


def _alone(space: SpaceArrays, bounds: Pyramid, names: Sequence[str], track: _Track, alt_amsl_m: float) -> Finding:
    """Return what one vehicle's returns keep from what stands still: what fails, else what has the least to spare."""
    limits = track.vehicle.limits
    at = np.full(3, np.nan)
    margin_m = limits.terrain_margin_m
    height_m, node = _least_terrain(space, bounds, track.at(alt_amsl_m), margin_m, margin_m + _AMPLE_M, at)
    if (
        height_m < margin_m
    ):  # looked into until decided, a bound is better than one that says how much there is to spare
        height_m = max(height_m, _least_terrain(space, bounds, track.at(alt_amsl_m), margin_m, margin_m, at)[0])
    found = [
        track.finding(
            node,
            f"at least {height_m:.1f} m above the ground"
            if math.isfinite(height_m)
            else "no known height above the ground",
            height_m,
            margin_m,
            "raise return_height_m or the legs flown then",
        )
    ]
    found[0] = replace(found[0], to="terrain", position_m=_position(at) if node >= 0 else None)
    margin_m = limits.obstacle_margin_m
    distance_m, node, solid, part = _least_solids(space, track.at(alt_amsl_m), margin_m, margin_m + _AMPLE_M)
    if distance_m < margin_m:
        distance_m = max(distance_m, _least_solids(space, track.at(alt_amsl_m), margin_m, margin_m)[0])
    if solid >= 0:
        what = _named(space, names, solid)
        keeps = f"at least {distance_m:.1f} m {'from' if solid < len(names) else 'inside the'} {what} {_PARTS[part]}"
        place = track.place(node, alt_amsl_m) if node >= 0 else _position(track.home_m)
        finding = track.finding(node, keeps, distance_m, limits.obstacle_margin_m, _remedy(space, solid))
        found.append(replace(finding, to=what, position_m=place))
    room_m = limits.alt_amsl_max_m - track.radius_m - track.top_amsl_m(alt_amsl_m)
    if math.isfinite(room_m):
        finding = track.finding(-1, f"{room_m:.1f} m below alt_amsl_max_m", room_m, 0.0, "lower return_height_m")
        found.append(replace(finding, to="ceiling"))
    return min(found, key=lambda f: (f.proven, (f.value or 0.0) - (f.required or 0.0)))


def _named(space: SpaceArrays, names: Sequence[str], solid: int) -> str:
    if solid < len(names):
        return names[solid]
    return "fence" if space.fence.shape[0] else "area"


def _remedy(space: SpaceArrays, solid: int) -> str:
    """Return what helps who cannot return past a solid: what has a top already is not to be given one."""
    bound = space.obstacles.bound
    return _REMEDY_TOPPED if solid < len(bound) and math.isfinite(bound[solid, 4]) else _REMEDY


def _position(at: FloatArray) -> Position:
    return float(at[0]), float(at[1]), float(at[2])


def _together(one: _Track, two: _Track, need_m: float) -> Finding:
    """Return how far apart two vehicles told to return at the same instant keep."""
    distance_m, node = _least_pair(one.at(one.default_amsl_m), two.at(two.default_amsl_m), math.inf)
    if node < 0:
        return Finding("return", _both(one.vehicle, two.vehicle), proven=True, detail="never return together")
    proven = distance_m >= need_m
    told = f"told to return at {one.time_s(node):.0f} s"
    return Finding(
        "return",
        _both(one.vehicle, two.vehicle),
        proven=proven,
        detail=f"{told}, they keep {distance_m:.1f} m apart, expected {need_m:.1f} m",
        remedy="" if proven else "set their return_height_m further apart, or move a home",
        value=distance_m,
        required=need_m,
        position_m=one.place(node, one.default_amsl_m),
        t_s=one.time_s(node),
    )


# --- the choice of heights -----------------------------------------------------------------------------------------


def choose_return_heights(
    space: SpaceArrays,
    bounds: Pyramid,
    names: Sequence[str],
    vehicles: Sequence[Returning],
    separation_m: Callable[[int, int], float],
    fixed: Sequence[float | None],
) -> list[float]:
    """Return heights above home, whole metres, with which :func:`prove_returns` holds; those ``fixed`` are kept.

    First each vehicle's least height that is clear, at least its autopilot's own; then whoever meets another returns
    above or below it, in the order that costs the least height.

    Raises
    ------
    UnreturnableError
        There are none.
    """
    return _Choice(space, bounds, names, _tracks(vehicles), separation_m, fixed).heights_m()


@dataclass(frozen=True, slots=True)
class _Order:
    """That one vehicle returns below another."""

    top_amsl_m: float  # how high the lower one is by itself, where they would meet
    moves: bool  # and at least as high as it returns: it is not on the ground for good


_Orders = dict[tuple[int, int], _Order]


class _Choice:
    """The search for return heights. Altitudes AMSL inside, one per vehicle."""

    def __init__(
        self,
        space: SpaceArrays,
        bounds: Pyramid,
        names: Sequence[str],
        tracks: Sequence[_Track],
        separation_m: Callable[[int, int], float],
        fixed: Sequence[float | None],
    ) -> None:
        self._space, self._bounds, self._names = space, bounds, names
        self._tracks = tracks
        self._need_m = separation_m
        self._fixed = fixed
        self._met: dict[tuple[int, int, float, float], bool] = {}
        self._failure: InfeasibleError | None = None

    def heights_m(self) -> list[float]:
        alts = []
        for k, (track, height_m) in enumerate(zip(self._tracks, self._fixed, strict=True)):
            set_m = None if height_m is None else float(track.home_m[2]) + height_m
            alts.append(self._clear_m(k, track.default_amsl_m) if set_m is None else set_m)
        return [
            round(alt - float(track.home_m[2])) if height_m is None else height_m
            for alt, track, height_m in zip(self._staggered(tuple(alts)), self._tracks, self._fixed, strict=True)
        ]

    # --- each by itself

    def _clear_m(self, k: int, lowest_amsl_m: float) -> float:
        """Return the least altitude, a whole number of metres above home, that is clear of everything that stands."""
        track = self._tracks[k]
        limits = track.vehicle.limits
        alt = track.rounded_up_m(lowest_amsl_m)
        spare_tries = _CLIMB_TRIES
        while True:
            need, node = _terrain_need(self._space, self._bounds, track.at(alt), limits.terrain_margin_m)
            if not math.isfinite(need):
                raise self._blocked(k, node, "the terrain is missing")
            if need > alt:
                alt = track.rounded_up_m(need)
            if track.top_amsl_m(alt) + track.radius_m > limits.alt_amsl_max_m:
                raise self._blocked(k, node, "nothing below alt_amsl_max_m is clear")
            need_m = limits.obstacle_margin_m
            found, node, solid, part = _least_solids(self._space, track.at(alt), need_m, need_m)
            if found >= need_m:
                break
            if part == _CLIMB and spare_tries > 0:  # who is to climb further climbs already while it brakes
                spare_tries -= 1
                alt += 1.0
                continue
            what = f"{_named(self._space, self._names, solid)} is {found:.1f} m off {_PARTS[part]}"
            solids = self._space.obstacles
            if part != _WAY or solid == len(self._names) or not math.isfinite(solids.bound[solid, 4]):
                short_m = need_m - found if part == _CLIMB else 0.0
                raise self._blocked(k, node, what, short_m, _remedy(self._space, solid))
            if (
                alt > solids.bound[solid, 4] + need_m + track.radius_m + _LEVEL_M
            ):  # above it, and still near: a plane's way
                raise self._blocked(k, node, what)
            # nobody gains more distance than height: nothing that is clear is skipped
            alt = track.rounded_up_m(alt + max(1.0, need_m - found - 3.0 * _TOLERANCE_M))
        at = np.empty(3)
        need_m = limits.terrain_margin_m
        if _least_terrain(self._space, self._bounds, track.at(alt), need_m, need_m, at)[0] >= need_m:
            return alt
        for higher in (alt, alt + 1.0):  # where bounds are no closer than their tolerance, one more metre helps
            finding = _alone(self._space, self._bounds, self._names, track, higher)
            if finding.proven:
                return higher
        short_m = (finding.required or 0.0) - (finding.value or 0.0)
        raise UnreturnableError(  # not for want of return height
            f"{finding}, or set fleet.direct_return: waived",
            (track.vehicle.name,),
            finding.t_s,
            short_m if math.isfinite(short_m) else 0.0,
        )

    def _blocked(self, k: int, node: int, why: str, short_m: float = 0.0, remedy: str = _REMEDY) -> UnreturnableError:
        track = self._tracks[k]
        t_s = track.time_s(node) if node >= 0 else None
        told = "" if t_s is None else f" when told to at {t_s:.0f} s"
        message = f"{track.vehicle.name}: expected a height to return at from everywhere{told}, but {why}: {remedy}"
        return UnreturnableError(message, (track.vehicle.name,), t_s, short_m)

    # --- apart

    def _staggered(self, alts: tuple[float, ...]) -> tuple[float, ...]:
        """Return altitudes, none below those given, at which all return apart."""
        pairs = list(itertools.combinations(range(len(alts)), 2))
        best: tuple[float, ...] | None = None
        for pair in pairs:  # who cannot be parted at all is told before any circle of several
            if self._meet(*pair, alts) and not self._parted(*pair, alts, {}):
                assert self._failure is not None
                raise self._failure
        self._failure = None
        open_states: list[tuple[tuple[float, ...], _Orders]] = [(alts, {})]
        tries = _TRIES + 4 * len(pairs)
        while open_states and tries > 0:
            tries -= 1
            alts, orders = open_states.pop()
            if best is not None and sum(alts) >= sum(best):
                continue
            meeting = next((pair for pair in pairs if self._meet(*pair, alts)), None)
            if meeting is None:
                best = alts
                if len(alts) > _EXHAUSTIVE:
                    break
            else:  # the cheaper order is looked into first
                open_states += sorted(self._parted(*meeting, alts, orders), key=lambda s: sum(s[0]), reverse=True)
        if best is None:
            assert self._failure is not None
            raise self._failure
        return best

    def _meet(self, i: int, j: int, alts: tuple[float, ...]) -> bool:
        key = (i, j, alts[i], alts[j])
        if key not in self._met:
            need_m = self._need_m(i, j)
            distance_m, _ = _least_pair(self._tracks[i].at(alts[i]), self._tracks[j].at(alts[j]), need_m)
            self._met[key] = distance_m < need_m
        return self._met[key]

    def _parted(
        self, i: int, j: int, alts: tuple[float, ...], orders: _Orders
    ) -> list[tuple[tuple[float, ...], _Orders]]:
        """Return how two that meet can be parted: either below the other, with the altitudes that follow."""
        one, two = self._tracks[i], self._tracks[j]
        row = _orders(one.at(alts[i]), two.at(alts[j]), self._need_m(i, j))
        ways = []
        for low, high, allowed, top, moves in (
            (i, j, row[_BELOW], row[_TOP_ONE], row[_MOVES_ONE]),
            (j, i, row[_ABOVE], row[_TOP_TWO], row[_MOVES_TWO]),
        ):
            if allowed == 0.0 or (high, low) in orders:
                continue
            known = orders.get((low, high), _Order(-math.inf, moves=False))
            order = _Order(max(known.top_amsl_m, float(top)), known.moves or moves == 1.0)
            more = {**orders, (low, high): order}
            raised = self._raised(alts, more)
            if raised is not None and raised != alts:
                ways.append((raised, more))
        if not ways and self._failure is None:
            t_s = one.time_s(int(row[_WHEN]))
            alone = row[_BELOW] == row[_ABOVE] == 0.0
            why = (
                "each climbs or descends where the other flies home" if alone else "neither can return above the other"
            )
            self._failure = UnreturnableError(
                f"{_both(one.vehicle, two.vehicle)}: expected return heights that part them, but when told to at "
                f"{t_s:.0f} s {why}: set return_height_m of neither, "
                "move a home or the legs flown then, or set fleet.direct_return: waived",
                (one.vehicle.name, two.vehicle.name),
                t_s,
            )
        return ways

    def _raised(self, alts: tuple[float, ...], orders: _Orders) -> tuple[float, ...] | None:
        """Return the least altitudes, none below those given, that keep all orders; None if there are none."""
        new = list(alts)
        for _ in range(len(new) + 1):
            before = tuple(new)
            for (low, high), order in orders.items():
                top = max(order.top_amsl_m, new[low]) if order.moves else order.top_amsl_m
                least = self._tracks[high].rounded_up_m(top + self._need_m(*sorted((low, high))) + _LEVEL_M)
                if least <= new[high]:
                    continue
                if self._fixed[high] is not None:
                    return None
                try:
                    new[high] = self._clear_m(high, least)
                except InfeasibleError as error:
                    self._failure = self._failure or error
                    return None
            if tuple(new) == before:
                return before
        return None  # each of some is to return above the next, and the last above the first
