"""What it takes to fly from view to view: times and shares of the battery, before anything is planned.

Between two places a vehicle is taken to fly straight in plan and, in height, along the string that is drawn taut over
the ground and over what stands in the way, both with the vehicle's margins: lines are crossed above them, masts passed
beside them. Where that is blocked, or the places are many and far apart, the shortest way over other places counts.
Speeds, climbs and standing starts are those of the motion model, powers those of :mod:`.energy`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from missionplanner import energy, kernels, timing, wind
from missionplanner.clearance import Margins
from missionplanner.energy import EnergyModel
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import ObstacleArrays, SpaceArrays, kernel, leaf, terrain_height
from missionplanner.motion import Navigator, Route
from missionplanner.plan import Trajectory
from missionplanner.scene import Scene, VehicleTask, takeoff_height_m
from missionplanner.views import Visit

IntArray = npt.NDArray[np.intp]

_STEP_M = 12.0  # between samples of the ground
_ASIDE_SHARE = 0.5  # of the margin: who comes so near from the side passes a little further off, at hardly any cost
_SLIM_M = 60.0  # radius, with the margin, of what is rather passed beside than overflown
_DIRECT_PAIRS = 60_000  # of places, that are all looked at themselves
_NEAREST_MIN = 16
_SAME_PLACE_M = 0.5
_CORNER_ROOM_M = 5.0
_LEAST_S = 1e-6  # an edge of a graph is never free
_SHORT_M, _LONG_M, _LENGTHS = 2.0, 2000.0, 11  # legs whose starts and stops are flown for the table of them
_SLOW_SHARES = (0.1, 0.25, 0.5, 0.75, 1.0)  # of the greatest speed
_HELD_S = 3.0  # long enough to come to rest
_STAR_M, _STAR_POINTS = 400.0, 8

# Columns of `_ways`
_THERE_S, _THERE_SHARE, _BACK_S, _BACK_SHARE, _HIGHEST_M = range(5)
_WAY_COLUMNS = 5


@dataclass(frozen=True, slots=True, eq=False)
class TravelCosts:
    """What vehicles (V) need from one visit to the next; of F ways to fly the visits, then V homes: N = F + V places.

    ``time_s[m, i, j]`` is from the end of what is flown by form i (or from rest at home) to the end of form j (or rest
    at home), for a vehicle of model m; ``energy_share`` likewise. Infinite: there is no such way.
    """

    visits: tuple[Visit, ...]
    forms: tuple[Visit, ...]  # (F,) every visit as it is, then those turned round that may be
    visit: IntArray  # (F,) which of the visits
    turned: IntArray  # (F,) the same visit the other way round; itself where it may not be
    model: IntArray  # (V,)
    time_s: FloatArray  # (M, N, N)
    energy_share: FloatArray  # (M, N, N)
    inspection_s: FloatArray  # (M, F) of that, on the visits themselves
    inspection_share: FloatArray  # (M, F)
    home_share: FloatArray  # (V, F) what returning home during a form, or after it, takes beyond what the form took
    return_height_m: FloatArray  # (V, F) above home, at which that is
    higher_share_m: FloatArray  # (V,) per metre that it returns higher
    top_height_m: FloatArray  # (V,) above home, of the take-off and of the end
    top_share: FloatArray  # (V,) what returning from there, no higher, takes beyond landing as planned
    reserve_share: FloatArray  # (V,) left when it is back; 0 where nothing is known of its battery
    returns: bool  # whether it must be able to return from everywhere (fleet.direct_return)

    def home(self, vehicle: int) -> int:
        """Return the place of a vehicle's home."""
        return len(self.forms) + vehicle


def travel_costs(scene: Scene, visits: Sequence[Visit]) -> TravelCosts:
    """Return the times and energies between all visits and homes, for every vehicle of a scene without routes.

    Raises
    ------
    InfeasibleError
        The wind is too strong for somebody.
    """
    wind.refuse_storm(scene.tasks)
    reversible = [k for k, visit in enumerate(visits) if visit.reversible and len(visit.viewpoints) > 1]
    forms = (*visits, *(visits[k].reversed() for k in reversible))
    visit = np.concatenate([np.arange(len(visits)), np.array(reversible, dtype=np.intp)]).astype(np.intp)
    turned = np.arange(len(forms), dtype=np.intp)
    for extra, k in enumerate(reversible):
        turned[k], turned[len(visits) + extra] = len(visits) + extra, k
    fliers = [_Flier(scene, index) for index in range(len(scene.tasks))]
    models: list[_Flier] = []
    model = np.zeros(len(fliers), dtype=np.intp)
    for v, flier in enumerate(fliers):
        same = next((m for m, other in enumerate(models) if other.flies_like(flier)), len(models))
        model[v] = same
        if same == len(models):
            models.append(flier)
    tables = [
        _table(scene, flier, forms, [f if m == k else None for f, m in zip(fliers, model, strict=True)])
        for k, flier in enumerate(models)
    ]
    home = [_home_shares(scene, flier, forms, tables[m]) for flier, m in zip(fliers, model, strict=True)]
    count = len(forms)
    return TravelCosts(
        visits=tuple(visits),
        forms=forms,
        visit=visit,
        turned=turned,
        model=model,
        time_s=np.stack([table.time_s for table in tables]),
        energy_share=np.stack([table.energy_share for table in tables]),
        inspection_s=np.stack([table.inspection_s for table in tables]),
        inspection_share=np.stack([table.inspection_share for table in tables]),
        home_share=np.array([row[0] for row in home]).reshape(len(fliers), count),
        return_height_m=np.array([row[1] for row in home]).reshape(len(fliers), count),
        higher_share_m=np.array([row[2] for row in home]),
        top_height_m=np.array([flier.top_m[2] - flier.task.home_m[2] for flier in fliers]),
        top_share=np.array([_top_share(flier) for flier in fliers]),
        reserve_share=np.array([0.0 if f.energy is None else f.energy.reserve_share for f in fliers]),
        returns=scene.mission.fleet.direct_return == "required",
    )


# --- one vehicle


class _Flier:
    """One vehicle: how fast it flies, what that takes, how it takes off and lands."""

    def __init__(self, scene: Scene, index: int) -> None:
        settings = scene.mission.vehicles[index]
        self.task: VehicleTask = scene.tasks[index]
        self.margins = Margins.of(self.task.limits)
        self.motion = self.task.motion
        self.energy: EnergyModel | None = energy.energy_model(settings, scene.mission.air_m_s)
        self.wind_m_s = scene.mission.wind_max_m_s or 0.0
        height_m = takeoff_height_m(settings, self.margins)
        self.top_m: FloatArray = self.task.home_m + np.array([0.0, 0.0, height_m])
        self.speed_m_s = _speed_m_s(self.task, self.top_m)
        self.ramps = _Ramps(self)
        flight, reached_s = timing.predict_flight(
            self.motion,
            self.task.home_m,
            self.top_m,
            self.speed_m_s,
            end=self.task.end,
            ground_amsl_m=float(self.task.home_m[2]),
        )
        self.takeoff_s = float(reached_s[-1])
        self.ending_s = float(flight.t_s[-1]) - self.takeoff_s
        used = np.zeros(len(flight.t_s))
        if self.energy is not None:
            used = energy.used_share(self.energy, flight, self.wind_m_s)
        self.takeoff_share = float(np.interp(self.takeoff_s, flight.t_s, used))
        self.ending_share = float(used[-1]) - self.takeoff_share

    def flies_like(self, other: _Flier) -> bool:
        """Whether both need the same between the same places."""
        mine, theirs = self.task, other.task
        return (mine.motion, mine.limits, self.energy, self.speed_m_s) == (
            theirs.motion,
            theirs.limits,
            other.energy,
            other.speed_m_s,
        )

    def standing_share_s(self, alt_amsl_m: npt.ArrayLike) -> FloatArray:
        """Return what each second of standing still takes at altitudes (...)."""
        if self.energy is None:
            return np.zeros(np.shape(alt_amsl_m))
        if self.wind_m_s > 0.0:
            return self.energy.power_share(0.0, 0.0, self.wind_m_s, alt_amsl_m)
        return self.energy.power_share(math.hypot(*self.motion.wind_m_s), 0.0, 0.0, alt_amsl_m)

    @property
    def reach_m(self) -> float:
        """How far from home it may be at all: there and back, no faster than at its greatest speed."""
        return math.inf if self.energy is None else 0.5 * self.speed_m_s / self.energy.level_share_s

    @property
    def rules(self) -> _Rules:
        """What the kernel asks of ways."""
        model, margins, motion = self.energy, self.margins, self.motion
        return _Rules(
            height_min_m=margins.height_agl_min_m,
            height_max_m=margins.height_agl_max_m,
            alt_max_m=margins.alt_amsl_max_m,
            obstacle_m=margins.obstacle_m,
            fence_m=margins.fence_m,
            speed_m_s=self.speed_m_s,
            climb_m_s=motion.climb_rate_m_s,
            descent_m_s=motion.descent_rate_m_s,
            level_share_s=0.0 if model is None else model.level_share_s,
            climb_share_m=0.0 if model is None else model.climb_share_m,
            drag_share_s=0.0 if model is None else model.drag_share_s,
            wind_max_m_s=self.wind_m_s,
            wind_east_m_s=motion.wind_m_s[0],
            wind_north_m_s=motion.wind_m_s[1],
            airspeed_m_s=wind.airspeed_limit_m_s(motion),
        )


def _speed_m_s(task: VehicleTask, top_m: FloatArray) -> float:
    """Return the greatest speed that may be commanded on whatever course; a whole mission is flown at one.

    Raises
    ------
    InfeasibleError
        There is none in the wind.
    """
    turn = np.linspace(0.0, 2.0 * math.pi, _STAR_POINTS, endpoint=False)
    star = np.zeros((2 * _STAR_POINTS + 1, 3)) + top_m
    star[1::2, 0] += _STAR_M * np.cos(turn)
    star[1::2, 1] += _STAR_M * np.sin(turn)
    return wind.speed_range_m_s(task, star)[1]


class _Ramps:
    """How much longer legs take from rest to rest than at an even speed, as the navigator flies them.

    Flown level, over lengths and speeds: a leg that a climb slows down starts and stops like one that is so slow.
    """

    def __init__(self, flier: _Flier) -> None:
        self._lengths_m = np.geomspace(_SHORT_M, _LONG_M, _LENGTHS)
        self._speeds_m_s = flier.speed_m_s * np.array(_SLOW_SHARES)
        self._extra_s = np.array(
            [[_ramp_s(flier, float(v), float(length)) for length in self._lengths_m] for v in self._speeds_m_s]
        )

    def extra_s(self, length_m: FloatArray, cruise_s: FloatArray) -> FloatArray:
        """Return the extra times (...) of legs of lengths (...) flown evenly in times (...)."""
        speed = length_m / np.maximum(cruise_s, _LEAST_S)
        column = np.interp(np.log(np.maximum(length_m, _SHORT_M)), np.log(self._lengths_m), np.arange(float(_LENGTHS)))
        row = np.interp(speed, self._speeds_m_s, np.arange(float(len(self._speeds_m_s))))
        i = np.minimum(row.astype(np.intp), len(self._speeds_m_s) - 2)
        j = np.minimum(column.astype(np.intp), len(self._lengths_m) - 2)
        a, b = row - i, column - j
        table = self._extra_s
        extra: FloatArray = (1.0 - a) * ((1.0 - b) * table[i, j] + b * table[i, j + 1]) + a * (
            (1.0 - b) * table[i + 1, j] + b * table[i + 1, j + 1]
        )
        return extra


def _ramp_s(flier: _Flier, speed_m_s: float, length_m: float) -> float:
    """Return how much longer than at an even speed a leg takes from one hold to the next."""
    points = flier.top_m + length_m * np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [2.0, 1.0, 0.0]])
    _, reached_s = Navigator([flier.motion], flier.top_m[np.newaxis]).fly(Route.through(points, speed_m_s, _HELD_S))
    return max(0.0, float(reached_s[2] - reached_s[1]) - _HELD_S - length_m / speed_m_s)


# --- ways between places


class _Rules(NamedTuple):
    """What a way must keep, how fast it is flown, and what that takes; all floats, so that one kernel serves all."""

    height_min_m: float
    height_max_m: float
    alt_max_m: float
    obstacle_m: float
    fence_m: float
    speed_m_s: float
    climb_m_s: float
    descent_m_s: float
    level_share_s: float
    climb_share_m: float
    drag_share_s: float
    wind_max_m_s: float
    wind_east_m_s: float
    wind_north_m_s: float
    airspeed_m_s: float  # at its lean limit


@leaf
def _over(o: ObstacleArrays, i: int, x: float, y: float, z: float, margin_m: float) -> float:
    """Return how high one must fly at a place to be above a solid by the margin; -inf: it is not there, or above z."""
    p = o.params
    kind = o.kind[i]
    near_m = (1.0 - _ASIDE_SHARE) * margin_m
    if kind == kernels.PRISM:
        if z <= p[i, 0] - margin_m:
            return -np.inf
        across = kernels.polygon_distance(o.vertices, o.vertex_start[i], o.vertex_start[i + 1], x, y)
        over: float = p[i, 1] + margin_m if across < near_m else -np.inf
        return over
    dx: float = x - p[i, 0]
    dy: float = y - p[i, 1]
    if kind == kernels.CYLINDER:
        above: float = p[i, 3] + margin_m if math.sqrt(dx * dx + dy * dy) - p[i, 2] < near_m else -np.inf
        return above
    if kind == kernels.CONE:
        rho = math.sqrt(dx * dx + dy * dy) - margin_m
        if rho >= p[i, 2]:
            return -np.inf
        slope: float = p[i, 3] + margin_m + p[i, 4] * min(1.0, 1.0 - rho / p[i, 2])
        return slope
    if kind == kernels.RADAR or kind == kernels.MARINE:  # noqa: PLR1714  (numba)
        reach = p[i, 3] + margin_m
        rest = reach * reach - dx * dx - dy * dy
        if rest <= 0.0 or z <= p[i, 2] - math.sqrt(rest):
            return -np.inf
        dome: float = p[i, 2] + math.sqrt(rest)
        return dome
    ex = p[i, 3] - p[i, 0]
    ey = p[i, 4] - p[i, 1]
    ee = ex * ex + ey * ey
    s = min(1.0, max(0.0, (dx * ex + dy * ey) / ee)) if ee > 0.0 else 0.0
    dx -= s * ex
    dy -= s * ey
    if math.sqrt(dx * dx + dy * dy) - p[i, 6] >= near_m:
        return -np.inf
    top: float = p[i, 2] + s * (p[i, 5] - p[i, 2]) + p[i, 6] + margin_m
    return top


@leaf
def _power(r: _Rules, east_m_s: float, north_m_s: float, rise_m_s: float, alt_m: float) -> float:
    """Return the share of a second (as :meth:`.EnergyModel.power_share`, of copters)."""
    if r.wind_max_m_s > 0.0:
        across = math.sqrt(east_m_s * east_m_s + north_m_s * north_m_s) + r.wind_max_m_s
    else:
        east_m_s -= r.wind_east_m_s
        north_m_s -= r.wind_north_m_s
        across = math.sqrt(east_m_s * east_m_s + north_m_s * north_m_s)
    density = max(1.0 - 2.25577e-5 * alt_m, 0.1) ** 4.256
    airspeed = math.sqrt(across * across + rise_m_s * rise_m_s)
    share: float = (
        r.level_share_s / math.sqrt(density)
        + r.drag_share_s * density * airspeed * airspeed * airspeed
        + r.climb_share_m * max(rise_m_s, 0.0)
    )
    return share


@leaf
def _made_m_s(r: _Rules, east: float, north: float) -> float:
    """Return the ground speed along a course (as :func:`.along_m_s`, and no more than commanded)."""
    if r.wind_east_m_s == 0.0 and r.wind_north_m_s == 0.0:
        return r.speed_m_s
    tail = east * r.wind_east_m_s + north * r.wind_north_m_s
    across = east * r.wind_north_m_s - north * r.wind_east_m_s
    spare = r.airspeed_m_s * r.airspeed_m_s - across * across
    made: float = min(r.speed_m_s, tail + math.sqrt(spare)) if spare > 0.0 else 0.0
    return made


@leaf
def _slim(o: ObstacleArrays, i: int, margin_m: float) -> bool:
    """Whether a solid is passed beside."""
    long = o.kind[i] == kernels.CYLINDER or o.kind[i] == kernels.CONE or o.kind[i] == kernels.PRISM
    sphere = o.kind[i] == kernels.RADAR or o.kind[i] == kernels.MARINE
    slim: bool = (long or sphere) and o.bound[i, 2] + margin_m <= _SLIM_M
    return slim


@kernel
def _ways(space: SpaceArrays, r: _Rules, start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the ways (N, columns) between points (N, 3), there and back: times, shares, the highest floor between.

    Without starts and stops. Infinite where what has no top, a ceiling, the fence or missing ground blocks it.
    """
    o = space.obstacles
    out = np.empty((start.shape[0], _WAY_COLUMNS))
    longest = 0.0
    for n in range(start.shape[0]):
        longest = max(longest, math.sqrt((end[n, 0] - start[n, 0]) ** 2 + (end[n, 1] - start[n, 1]) ** 2))
    floor = np.empty(int(longest / _STEP_M) + 3)
    hull = np.empty(floor.shape[0], dtype=np.int64)
    alt_max = min(r.alt_max_m, space.fence_top_amsl_m - r.fence_m)
    for n in range(start.shape[0]):
        ex = end[n, 0] - start[n, 0]
        ey = end[n, 1] - start[n, 1]
        ez = end[n, 2] - start[n, 2]
        length = math.sqrt(ex * ex + ey * ey)
        pieces = int(length / _STEP_M) + 1
        out[n] = np.inf
        highest = -np.inf
        blocked = False
        floor[0] = start[n, 2]
        floor[pieces] = end[n, 2]
        for k in range(1, pieces):
            x = start[n, 0] + ex * k / pieces
            y = start[n, 1] + ey * k / pieces
            ground = terrain_height(space.terrain, x, y)
            floor[k] = ground + r.height_min_m
            if math.isnan(ground) or kernels.inside_distance(space, x, y, -1e9) < r.fence_m:
                blocked = True
                break
        if blocked:
            continue
        longer = 0.0
        for i in range(o.kind.shape[0]):
            if not o.hard[i]:
                continue
            reach = o.bound[i, 2] + r.obstacle_m
            wx = o.bound[i, 0] - start[n, 0]
            wy = o.bound[i, 1] - start[n, 1]
            along = (wx * ex + wy * ey) / length if length > 0.0 else 0.0
            nearest = min(length, max(0.0, along))
            fx = wx - nearest * (ex / length if length > 0.0 else 0.0)
            fy = wy - nearest * (ey / length if length > 0.0 else 0.0)
            off = math.sqrt(fx * fx + fy * fy)
            if off >= reach:
                continue
            if _slim(o, i, r.obstacle_m) and 0.0 < along < length:
                aside = reach - off
                longer += 0.5 * aside * aside * (1.0 / max(along, reach) + 1.0 / max(length - along, reach))
                continue
            first = max(1, int((along - reach) / length * pieces)) if length > 0.0 else 1
            last = min(pieces - 1, int((along + reach) / length * pieces) + 1) if length > 0.0 else 0
            for k in range(first, last + 1):
                s = k / pieces
                z = start[n, 2] + ez * s
                floor[k] = max(floor[k], _over(o, i, start[n, 0] + ex * s, start[n, 1] + ey * s, z, r.obstacle_m))
        for k in range(1, pieces):
            highest = max(highest, floor[k])
            if floor[k] > alt_max:
                blocked = True
            elif r.height_max_m < np.inf:
                ground = terrain_height(space.terrain, start[n, 0] + ex * k / pieces, start[n, 1] + ey * k / pieces)
                blocked = blocked or floor[k] > ground + r.height_max_m
        if blocked:
            continue
        there_m_s = _made_m_s(r, ex / length, ey / length) if length > 0.0 else r.speed_m_s
        back_m_s = _made_m_s(r, -ex / length, -ey / length) if length > 0.0 else r.speed_m_s
        if min(there_m_s, back_m_s) <= 0.0:
            continue
        # the string over the floor, from end to end
        count = 0
        for k in range(pieces + 1):
            while count > 1:
                a = hull[count - 2]
                b = hull[count - 1]
                if (floor[b] - floor[a]) * (k - a) > (floor[k] - floor[a]) * (b - a):
                    break
                count -= 1
            hull[count] = k
            count += 1
        there_s = back_s = there = back = 0.0
        for c in range(1, count):
            share = (hull[c] - hull[c - 1]) / pieces
            across = share * (length + longer)
            low = floor[hull[c - 1]]
            high = floor[hull[c]]
            alt = max(low, high)
            rise = high - low
            up_s = max(across / there_m_s, rise / r.climb_m_s, -rise / r.descent_m_s)
            down_s = max(across / back_m_s, -rise / r.climb_m_s, rise / r.descent_m_s)
            there_s += up_s
            back_s += down_s
            if up_s > 0.0:
                there += up_s * _power(r, share * ex / up_s, share * ey / up_s, rise / up_s, alt)
                back += down_s * _power(r, -share * ex / down_s, -share * ey / down_s, -rise / down_s, alt)
        out[n, _THERE_S] = there_s
        out[n, _THERE_SHARE] = there
        out[n, _BACK_S] = back_s
        out[n, _BACK_SHARE] = back
        out[n, _HIGHEST_M] = highest
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """What the vehicles of one model need: see :class:`TravelCosts`."""

    time_s: FloatArray  # (N, N)
    energy_share: FloatArray
    inspection_s: FloatArray  # (F,)
    inspection_share: FloatArray
    after_share: tuple[FloatArray, ...]  # (F) of (K,): what of the inspection is still to come at each viewpoint


@dataclass(frozen=True, slots=True, eq=False)
class _Ends:
    """Where forms begin and end, and how they are met: where vehicles stand still, and the courses (F, 2) of others."""

    first_m: FloatArray  # (F, 3)
    last_m: FloatArray
    first_stands: npt.NDArray[np.bool_]  # (F,)
    last_stands: npt.NDArray[np.bool_]
    first_course: FloatArray  # 0: there is none
    last_course: FloatArray


def _table(scene: Scene, flier: _Flier, forms: Sequence[Visit], homes: Sequence[_Flier | None]) -> _Table:
    """Return the costs for one model; ``homes`` (V,) are the vehicles of this model."""
    inspections = [_inspection(scene, flier, form) for form in forms]
    inspection_s = np.array([i[0] for i in inspections])
    inspection_share = np.array([i[1] for i in inspections])
    ends = _ends(forms)
    own = [v for v, home in enumerate(homes) if home is not None]
    tops = np.array([homes[v].top_m for v in own]).reshape(-1, 3)  # type: ignore[union-attr]
    cruise = _cruise(scene, flier, ends, tops)
    count, vehicles = len(forms), len(homes)
    time_s = np.full((count + vehicles, count + vehicles), np.inf)
    share = np.full_like(time_s, np.inf)
    standing = flier.standing_share_s(ends.first_m[:, 2])
    for i in range(count):
        ramp_s = _ramp_between_s(flier, ends, i, np.arange(count), cruise.time_s[cruise.last[i], cruise.first])
        time_s[i, :count] = cruise.time_s[cruise.last[i], cruise.first] + ramp_s + inspection_s
        share[i, :count] = cruise.share[cruise.last[i], cruise.first] + ramp_s * standing + inspection_share
        time_s[i, i] = share[i, i] = np.inf
    for k, v in enumerate(own):
        home = homes[v]
        assert home is not None
        place, top = count + v, cruise.tops[k]
        to_s = cruise.time_s[top, cruise.first]
        ramp_s = _ramp_home_s(flier, tops[k], ends.first_m, ends.first_stands, ends.first_course, to_s)
        time_s[place, :count] = home.takeoff_s + to_s + ramp_s + inspection_s
        share[place, :count] = home.takeoff_share + cruise.share[top, cruise.first] + ramp_s * standing
        share[place, :count] += inspection_share
        from_s = cruise.time_s[cruise.last, top]
        ramp_s = _ramp_home_s(flier, tops[k], ends.last_m, ends.last_stands, -ends.last_course, from_s)
        time_s[:count, place] = from_s + ramp_s + home.ending_s
        share[:count, place] = cruise.share[cruise.last, top] + ramp_s * standing + home.ending_share
        time_s[place, place] = share[place, place] = 0.0
    after = tuple(i[2] for i in inspections)
    return _Table(time_s, share, inspection_s, inspection_share, after)


def _ends(forms: Sequence[Visit]) -> _Ends:
    def course(a: FloatArray, b: FloatArray) -> FloatArray:
        way: FloatArray = b[:2] - a[:2]
        return way / max(float(np.hypot(*way)), _SAME_PLACE_M)

    points = [np.array([viewpoint.position_m for viewpoint in form.viewpoints]) for form in forms]
    return _Ends(
        first_m=np.array([p[0] for p in points]).reshape(-1, 3),
        last_m=np.array([p[-1] for p in points]).reshape(-1, 3),
        first_stands=np.array([form.viewpoints[0].action.stand_s > 0.0 for form in forms], dtype=np.bool_),
        last_stands=np.array([form.viewpoints[-1].action.stand_s > 0.0 for form in forms], dtype=np.bool_),
        first_course=np.array([course(p[0], p[min(1, len(p) - 1)]) for p in points]).reshape(-1, 2),
        last_course=np.array([course(p[max(0, len(p) - 2)], p[-1]) for p in points]).reshape(-1, 2),
    )


def _slows(stands: npt.NDArray[np.bool_], way_m: FloatArray, course: FloatArray) -> FloatArray:
    """Return how much of a full stop (...) there is between a way (..., 2) and the course that goes on from it."""
    length = np.maximum(np.hypot(way_m[..., 0], way_m[..., 1]), _SAME_PLACE_M)
    straight = (way_m * course).sum(axis=-1) / length
    slows: FloatArray = np.where(stands, 1.0, 0.5 * (1.0 - straight))
    return slows


def _ramp_between_s(flier: _Flier, ends: _Ends, i: int, to: IntArray, cruise_s: FloatArray) -> FloatArray:
    way = ends.first_m[to] - ends.last_m[i]
    stops = _slows(ends.last_stands[i], way[:, :2], ends.last_course[i])
    stops = 0.5 * (stops + _slows(ends.first_stands[to], way[:, :2], ends.first_course[to]))
    return _ramps_s(flier, way, cruise_s) * stops


def _ramp_home_s(
    flier: _Flier,
    top_m: FloatArray,
    ends_m: FloatArray,
    stands: npt.NDArray[np.bool_],
    course: FloatArray,
    cruise_s: FloatArray,
) -> FloatArray:
    way = ends_m - top_m
    return _ramps_s(flier, way, cruise_s) * (0.5 + 0.5 * _slows(stands, way[:, :2], course))


def _ramps_s(flier: _Flier, way_m: FloatArray, cruise_s: FloatArray) -> FloatArray:
    """Return what a start from rest and a stop at the end of ways (..., 3) add."""
    length = np.hypot(way_m[..., 0], way_m[..., 1])
    moves = np.maximum(length, np.abs(way_m[..., 2])) >= _SAME_PLACE_M
    extra: FloatArray = np.where(moves, flier.ramps.extra_s(length, cruise_s), 0.0)
    return extra


def _inspection(scene: Scene, flier: _Flier, form: Visit) -> tuple[float, float, FloatArray]:
    """Return what a form takes: time, share of the battery, and what of that is still to come at its viewpoints."""
    points = np.array([viewpoint.position_m for viewpoint in form.viewpoints])
    stand_s = np.array([viewpoint.action.stand_s for viewpoint in form.viewpoints])
    standing = flier.standing_share_s(points[:, 2])
    held = stand_s * standing
    if len(points) == 1:
        return float(stand_s[0]), float(held[0]), np.zeros(1)
    ways = _ways(scene.space, flier.rules, points[:-1], points[1:])
    way = np.diff(points, axis=0)
    stands = stand_s > 0.0
    slows = np.ones(len(points))  # the first and the last belong to the ways to and from there
    slows[1:-1] = _slows(stands[1:-1], way[:-1, :2], _courses(way[1:, :2]))
    slows[0], slows[-1] = float(stands[0]), float(stands[-1])
    ramp_s = _ramps_s(flier, way, ways[:, _THERE_S]) * 0.5 * (slows[:-1] + slows[1:])
    legs = ways[:, _THERE_SHARE] + ramp_s * standing[1:]
    each = np.concatenate([[0.0], legs]) + held
    time_s = float((ways[:, _THERE_S] + ramp_s).sum() + stand_s.sum())
    return time_s, float(each.sum()), float(each.sum()) - np.cumsum(each)


def _courses(way_m: FloatArray) -> FloatArray:
    courses: FloatArray = way_m / np.maximum(np.hypot(way_m[:, 0], way_m[:, 1]), _SAME_PLACE_M)[:, np.newaxis]
    return courses


@dataclass(frozen=True, slots=True, eq=False)
class _Cruise:
    """Times and shares (P, P) between the places that matter, without starts and stops; which place is which."""

    time_s: FloatArray
    share: FloatArray
    first: IntArray  # (F,)
    last: IntArray  # (F,)
    tops: IntArray  # (own vehicles,)


def _cruise(scene: Scene, flier: _Flier, ends: _Ends, tops_m: FloatArray) -> _Cruise:
    count = len(ends.first_m)
    places, where = np.unique(np.concatenate([ends.first_m, ends.last_m]), axis=0, return_inverse=True)
    where = where.ravel()
    corners = _corners(scene, flier)
    wanted = len(places) + len(tops_m)
    points = np.concatenate([places, tops_m, corners])
    first, second, all_looked_at = _pairs(points, len(places), len(tops_m), flier.reach_m)
    ways = _ways(scene.space, flier.rules, points[first], points[second])
    size = len(points)
    time_s, share = np.full((size, size), np.inf), np.full((size, size), np.inf)
    time_s[first, second], share[first, second] = ways[:, _THERE_S], ways[:, _THERE_SHARE]
    time_s[second, first], share[second, first] = ways[:, _BACK_S], ways[:, _BACK_SHARE]
    np.fill_diagonal(time_s, 0.0)
    np.fill_diagonal(share, 0.0)
    if not (all_looked_at and np.isfinite(time_s[:wanted, :wanted]).all()):
        time_s, share = _around(time_s, share)
    return _Cruise(
        time_s[:wanted, :wanted], share[:wanted, :wanted], where[:count], where[count:], np.arange(len(places), wanted)
    )


def _pairs(points: FloatArray, places: int, tops: int, reach_m: float) -> tuple[IntArray, IntArray, bool]:
    """Return which points to look straight across from one to the other, and whether that is all.

    If not, each to those near it, and homes to all within reach.
    """
    size = len(points)
    if size * (size - 1) // 2 <= _DIRECT_PAIRS:
        first, second = np.triu_indices(size, 1)
        return first, second, True
    nearest = min(size - 1, max(_NEAREST_MIN, _DIRECT_PAIRS // size))
    _, near = KDTree(points[:, :2]).query(points[:, :2], nearest + 1)
    pairs = np.stack([np.repeat(np.arange(size), nearest + 1), near.ravel()], axis=1)
    homes = np.arange(places, places + tops)
    from_home = np.stack([np.repeat(homes, size), np.tile(np.arange(size), tops)], axis=1)
    way = points[from_home[:, 1]] - points[from_home[:, 0]]
    from_home = from_home[np.hypot(way[:, 0], way[:, 1]) <= reach_m]
    pairs = np.sort(np.concatenate([pairs, from_home]), axis=1)
    pairs = np.unique(pairs[pairs[:, 0] < pairs[:, 1]], axis=0)
    return pairs[:, 0], pairs[:, 1], False


def _around(time_s: FloatArray, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times and shares (P, P) of the shortest ways over other places."""
    first, second = np.nonzero(np.isfinite(time_s))
    off = first != second
    first, second = first[off], second[off]

    def shortest(cost: FloatArray) -> FloatArray:
        edges = np.maximum(cost[first, second], _LEAST_S)
        found: FloatArray = dijkstra(coo_array((edges, (first, second)), shape=cost.shape).tocsr())
        return found

    around_s = shortest(time_s)
    return around_s, shortest(share) if share[first, second].any() else np.where(np.isfinite(around_s), 0.0, np.inf)


def _corners(scene: Scene, flier: _Flier) -> FloatArray:
    """Return places (N, 3) around what is too wide to be passed without a thought: where ways may bend."""
    arrays, margin_m = scene.obstacles.arrays, flier.margins.obstacle_m
    outlines = []
    for i in range(len(arrays.kind)):
        top = arrays.params[i, 1] if arrays.kind[i] == kernels.PRISM else arrays.params[i, 3]
        wide = arrays.hard[i] and not _slim(arrays, i, margin_m)
        if wide and arrays.kind[i] == kernels.PRISM:
            outline = shapely.Polygon(arrays.vertices[arrays.vertex_start[i] : arrays.vertex_start[i + 1]])
        elif wide and arrays.kind[i] == kernels.CYLINDER and not math.isfinite(top):
            outline = shapely.Point(arrays.params[i, :2]).buffer(arrays.params[i, 2] / math.cos(math.pi / 16), 4)
        elif wide and arrays.kind[i] in (kernels.CABLE, kernels.CURTAIN) and _reaches_ceiling(scene, flier, i):
            ends = arrays.params[i, :6].reshape(2, 3)[:, :2]
            outline = shapely.LineString(ends).buffer(arrays.params[i, 6], cap_style="square")
        elif wide and arrays.kind[i] in (kernels.RADAR, kernels.MARINE):
            outline = shapely.Point(arrays.params[i, :2]).buffer(arrays.params[i, 3] / math.cos(math.pi / 16), 4)
        else:
            continue
        outlines.append(outline.buffer(margin_m + _CORNER_ROOM_M, join_style="mitre", mitre_limit=2.0))
    if len(scene.space.fence):
        outlines.append(shapely.Polygon(scene.space.fence).buffer(-flier.margins.fence_m - 0.1, join_style="mitre"))
    corners = [shapely.get_coordinates(outline) for outline in outlines]
    xy = np.unique(np.concatenate([np.zeros((0, 2)), *corners]), axis=0)
    height = scene.terrain.height_amsl_m(xy[:, 0], xy[:, 1]) + flier.margins.height_agl_min_m + _CORNER_ROOM_M
    known = np.isfinite(height)
    points: FloatArray = np.concatenate([xy, height[:, np.newaxis]], axis=1)[known]
    return points


def _reaches_ceiling(scene: Scene, flier: _Flier, i: int) -> bool:
    """Whether a cable cannot be flown over everywhere."""
    x, y, z = scene.obstacles.arrays.params[i, :6].reshape(2, 3).T
    over_m = z + scene.obstacles.arrays.params[i, 6] + flier.margins.obstacle_m
    ceiling_m = scene.terrain.height_amsl_m(x, y) + flier.margins.height_agl_max_m
    return not bool((over_m <= np.minimum(ceiling_m, flier.margins.alt_amsl_max_m)).all())


# --- the way home


def _home_shares(
    scene: Scene, flier: _Flier, forms: Sequence[Visit], table: _Table
) -> tuple[FloatArray, FloatArray, float]:
    """Return what returning from each form (F,) takes beyond the form, how high it returns, and more per metre."""
    sizes = [len(form.viewpoints) for form in forms]
    points = np.array([viewpoint.position_m for form in forms for viewpoint in form.viewpoints]).reshape(-1, 3)
    home_m = flier.task.home_m
    begins = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.intp)
    lowest = np.array([0.0, 0.0, flier.margins.height_agl_min_m])
    homes = np.broadcast_to(home_m + lowest, points.shape)
    near = np.flatnonzero(np.hypot(*(points - home_m)[:, :2].T) <= flier.reach_m)
    highest = np.full(len(points), -np.inf)
    highest[near] = _ways(scene.space, flier.rules, points[near], np.ascontiguousarray(homes[near]))[:, _HIGHEST_M]
    stated = scene.mission.vehicles[_index(scene, flier)].return_height_m
    height = np.where(np.isfinite(highest), highest - home_m[2], flier.margins.height_agl_min_m)
    height = np.maximum(height, flier.margins.height_agl_min_m) if stated is None else np.full(len(points), stated)
    heights: FloatArray = np.maximum.reduceat(height, begins) if len(forms) else np.zeros(0)
    if flier.energy is None:
        return np.zeros(len(forms)), heights, 0.0
    if not len(forms):
        return np.zeros(0), heights, 0.0
    after = np.concatenate(table.after_share)
    shares = np.empty(len(points))
    each = np.repeat(heights, sizes)
    for height_m in np.unique(each):
        at = np.flatnonzero(each == height_m)
        shares[at] = energy.return_share(
            flier.energy, _at_speed(flier, points[at]), home_m, float(height_m), flier.wind_m_s
        )[:-1]
    excess: FloatArray = np.maximum.reduceat(shares - after, begins)
    climb = flier.energy.power_share(0.0, flier.motion.climb_rate_m_s, flier.wind_m_s, home_m[2])
    sink = flier.standing_share_s(home_m[2])
    higher = float(climb) / flier.motion.climb_rate_m_s + float(sink) / flier.motion.descent_rate_m_s
    return excess, heights, higher


def _top_share(flier: _Flier) -> float:
    """Return what returning takes, told to just before the end of a mission, beyond the end itself."""
    if flier.energy is None:
        return 0.0
    height_m = float(flier.top_m[2] - flier.task.home_m[2])
    flight = _at_speed(flier, flier.top_m[np.newaxis])
    share = energy.return_share(flier.energy, flight, flier.task.home_m, height_m, flier.wind_m_s)[0]
    return max(0.0, float(share) - flier.ending_share)


def _index(scene: Scene, flier: _Flier) -> int:
    return next(i for i, task in enumerate(scene.tasks) if task is flier.task)


def _at_speed(flier: _Flier, points_m: FloatArray) -> Trajectory:
    """Return a flight through points (N, 3), and on, at the speeds that it is flown with: from which it must brake."""
    beyond = points_m[-1] + [flier.speed_m_s, 0.0, flier.motion.climb_rate_m_s]
    points = np.concatenate([points_m, beyond[np.newaxis]])
    step = np.diff(points, axis=0)
    rates = np.stack(
        [np.hypot(step[:, 0], step[:, 1]) / flier.speed_m_s, np.abs(step[:, 2]) / flier.motion.climb_rate_m_s]
    )
    return Trajectory(np.concatenate([[0.0], np.cumsum(np.maximum(rates.max(axis=0), 1.0))]), points)
