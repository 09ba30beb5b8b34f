"""First guesses: taut clear polylines from a coarse graph search, one per way around what is in the way.

A layered grid is laid between start and goal, along the line that joins them. Its moves keep the climb and descent
limits, so spirals and zig-zags come out by themselves where the climb is too steep; each move is checked exactly, so
what A* finds is clear however coarse the grid. The path is then drawn taut (:mod:`.taut`), every new leg checked the
same way. Gaps that a grid is too coarse for, and near ties, are left to a roadmap of points around the solids
(:mod:`.roadmap`); where all is passed sideways and neither ground nor climb holds the path, it needs no grid.

Other ways around come from walls: a half-disc that closes the side on which the last path touched something, after
which the next path must pass on another side (the partition of Yen, 1971, over homotopy classes,
doi:10.1287/mnsc.17.11.712).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner import kernels
from missionplanner.clearance import STEP_M, Margins, legs_clear, legs_within_angles, polyline_legs
from missionplanner.compiled import njit
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.roadmap import shortest_way
from missionplanner.taut import LEAF, OUTER, Rules, leg_length, leg_ok, pull, tighten
from missionplanner.vehicle import VehicleLimits

_TIGHT_END_M = 1e-3  # a start or goal that lacks this little (rounding) is taken as it is
_BOUND_SLACK_M = 2e-4  # distances along legs are lower bounds within 1e-4 m: an end at the margin must still pass
_NODES_MAX = 1_500_000
_STEEPEST_RAD = math.radians(89.0)
_PROBE_M = 0.01
_SPARES_M = (0.05, 1.0)  # kept above ground beyond the margin, for what lies between samples
_GREED = 1.2  # A* weighs what is to go this much: what it loses, drawing taut makes good
_CUTS_MAX = 40
_TIGHT_ROOM = 250  # points
_HIDDEN_M = 5e-3  # shorter is no shorter, in flight
_TAUT_TOLERANCE = 1e-5  # of the section's length: a corner is cut, a round repeated, while that saves more


class _Grid(NamedTuple):
    """Nodes start + u (ux, uy) cell + v (-uy, ux) cell + w layer, for integers u, v, w from the lows."""

    ux: float
    uy: float
    cell_m: float
    layer_m: float
    u_low: int
    v_low: int
    w_low: int
    u_count: int
    v_count: int
    w_count: int


class _Nodes(NamedTuple):
    """What A* knows of the nodes (N,), and its queue, a binary heap."""

    cost: FloatArray
    parent: npt.NDArray[np.int64]
    radius: FloatArray  # free of obstacles and fence; NaN: not yet asked, negative: one may not be there
    closed: npt.NDArray[np.bool_]
    floor: FloatArray  # of columns: the ground, NaN: not yet asked
    queue_cost: FloatArray
    queue_node: npt.NDArray[np.int64]


@njit(**LEAF)
def _free_radius(space: SpaceArrays, rules: Rules, x: float, y: float, z: float, enough: float) -> float:
    """Return how far one may fly in any direction and keep obstacles and fence; at most ``enough``, negative: not."""
    free = min(enough, kernels.inside_distance(space, x, y, z) - rules.fence_m, rules.alt_max_m - z)
    reach = free + rules.obstacle_m
    if free >= 0.0 and reach > 0.0:
        nearest = kernels.nearest_hard(space.obstacles, x, y, z, reach)
        if nearest < reach:
            free = nearest - rules.obstacle_m
    return free


@njit(**LEAF)
def _sift_up(q: _Nodes, n: int, key: float, node: int) -> None:
    """Add an entry to the heap of the first ``n``. Ours, because numba takes seconds over heapq."""
    while n > 0:
        up = (n - 1) >> 1
        if q.queue_cost[up] <= key:
            break
        q.queue_cost[n] = q.queue_cost[up]
        q.queue_node[n] = q.queue_node[up]
        n = up
    q.queue_cost[n] = key
    q.queue_node[n] = node


@njit(**LEAF)
def _sift_down(q: _Nodes, n: int) -> None:
    """Drop the least entry of the heap of the first ``n + 1``."""
    key = q.queue_cost[n]
    node = q.queue_node[n]
    at = 0
    while True:
        child = 2 * at + 1
        if child >= n:
            break
        if child + 1 < n and q.queue_cost[child + 1] < q.queue_cost[child]:
            child += 1
        if q.queue_cost[child] >= key:
            break
        q.queue_cost[at] = q.queue_cost[child]
        q.queue_node[at] = q.queue_node[child]
        at = child
    q.queue_cost[at] = key
    q.queue_node[at] = node


@njit(**LEAF)
def _place(grid: _Grid, ends: FloatArray, u: int, v: int, w: int, out: FloatArray, row: int) -> None:
    """Write the position of a node into a row."""
    a = (u + grid.u_low) * grid.cell_m
    b = (v + grid.v_low) * grid.cell_m
    out[row, 0] = ends[0, 0] + a * grid.ux - b * grid.uy
    out[row, 1] = ends[0, 1] + a * grid.uy + b * grid.ux
    out[row, 2] = ends[0, 2] + (w + grid.w_low) * grid.layer_m


@njit(**LEAF)
def _node_radius(
    space: SpaceArrays, rules: Rules, floor: FloatArray, column: int, at: FloatArray, enough: float
) -> float:
    """Return the free radius of a node at ``at[1]``, negative where one may not be; ``floor`` remembers the ground."""
    below = floor[column]
    if math.isnan(below):
        below = kernels.terrain_height(space.terrain, at[1, 0], at[1, 1])
        if math.isnan(below):
            below = np.inf
        floor[column] = below
    height = at[1, 2] - below
    if not rules.height_min_m <= height <= rules.height_max_m:
        return -1.0
    radius: float = _free_radius(space, rules, at[1, 0], at[1, 1], at[1, 2], enough)
    return radius


@njit(**LEAF)
def _to_go(rules: Rules, goal: FloatArray, leg: FloatArray) -> float:
    """Return a lower bound of the length from the leg's second point to the goal: straight, or as steep as allowed."""
    rise = goal[2] - leg[1, 2]
    across2 = (goal[0] - leg[1, 0]) ** 2 + (goal[1] - leg[1, 1]) ** 2
    slope = rules.slope_up if rise > 0.0 else rules.slope_down
    return math.sqrt(rise * rise + max(across2, (rise / slope) ** 2))


@njit(**OUTER)
def _expand(
    space: SpaceArrays,
    rules: Rules,
    walls: FloatArray,
    ends: FloatArray,
    grid: _Grid,
    moves: npt.NDArray[np.int64],
    lengths: FloatArray,
    nodes: _Nodes,
    longest_m: float,
) -> int:
    """Run A* from ``ends[0]`` to ``ends[1]`` over moves (M, 3) in u, v, w; return the node before the goal, or -1."""
    nv, nw = grid.v_count, grid.w_count
    leg = np.empty((2, 3))
    queued = 1
    reach_m = lengths.max()
    best_cost = longest_m
    last = -1
    while queued > 0 and nodes.queue_cost[0] < best_cost:
        node = nodes.queue_node[0]
        queued -= 1
        _sift_down(nodes, queued)
        if nodes.closed[node]:
            continue
        nodes.closed[node] = True
        w = node % nw
        v = node // nw % nv
        u = node // nw // nv
        _place(grid, ends, u, v, w, leg, 0)
        for k in range(3):
            leg[1, k] = ends[1, k]
        across = abs(leg[1, 0] - leg[0, 0]) + abs(leg[1, 1] - leg[0, 1])
        near = across < 4.0 * grid.cell_m and nodes.cost[node] + leg_length(leg) < best_cost
        for m in range(-1 if near else 0, moves.shape[0]):  # -1: straight to the goal
            total = nodes.cost[node]
            ahead = -1
            open_air = False
            if m < 0:
                total += leg_length(leg)
            else:
                u1 = u + moves[m, 0]
                v1 = v + moves[m, 1]
                w1 = w + moves[m, 2]
                if u1 < 0 or u1 >= grid.u_count or v1 < 0 or v1 >= nv or w1 < 0 or w1 >= nw:
                    continue
                ahead = (u1 * nv + v1) * nw + w1
                total += lengths[m]
                if nodes.closed[ahead] or total >= nodes.cost[ahead]:
                    continue
                _place(grid, ends, u1, v1, w1, leg, 1)
                if math.isnan(nodes.radius[ahead]):
                    nodes.radius[ahead] = _node_radius(space, rules, nodes.floor, u1 * nv + v1, leg, reach_m)
                radius = nodes.radius[ahead]
                if radius < 0.0 or queued == nodes.queue_cost.shape[0]:
                    continue
                open_air = max(radius, nodes.radius[node]) >= lengths[m]
            if not leg_ok(space, rules, walls, leg, open_air):
                continue
            if ahead < 0:
                best_cost = total
                last = node
                continue
            nodes.cost[ahead] = total
            nodes.parent[ahead] = node
            _sift_up(nodes, queued, total + _GREED * _to_go(rules, ends[1], leg), ahead)
            queued += 1
    return last


@njit(**OUTER)
def _away(o: kernels.ObstacleArrays, index: npt.NDArray[np.intp], at: FloatArray, out: FloatArray) -> None:
    """Write the directions (N, 3) in which the distances from places (N, 3) to solids ``index`` (N,) grow."""
    near = np.empty(3)
    for n in range(index.shape[0]):
        square = 0.0
        for k in range(6):
            for m in range(3):
                near[m] = at[n, m]
            near[k % 3] += _PROBE_M if k < 3 else -_PROBE_M
            distance = kernels.obstacle_distance(o, index[n], near[0], near[1], near[2])
            out[n, k % 3] = distance if k < 3 else out[n, k % 3] - distance
        for k in range(3):
            square += out[n, k] * out[n, k]
        for k in range(3):
            out[n, k] /= math.sqrt(max(square, 1e-30))


# --- searching -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """One section: the space, the rules and the two ends."""

    space: SpaceArrays
    margins: Margins
    limits: VehicleLimits
    start_m: FloatArray
    goal_m: FloatArray

    @property
    def slope_up(self) -> float:
        return math.tan(min(self.limits.climb_angle_rad, _STEEPEST_RAD))

    @property
    def slope_down(self) -> float:
        return math.tan(min(self.limits.descent_angle_rad, _STEEPEST_RAD))

    @property
    def least_m(self) -> float:
        """A lower bound of the length of any path."""
        rise = self.goal_m[2] - self.start_m[2]
        slope = self.slope_up if rise > 0.0 else self.slope_down
        across = math.hypot(self.goal_m[0] - self.start_m[0], self.goal_m[1] - self.start_m[1])
        return math.hypot(rise, max(across, abs(rise) / slope))

    @property
    def length_m(self) -> float:
        """The horizontal length that the section needs at least; never tiny."""
        across, rise = math.hypot(*(self.goal_m - self.start_m)[:2]), self.goal_m[2] - self.start_m[2]
        return float(max(across, rise / self.slope_up, -rise / self.slope_down, 30.0))

    @property
    def spare_m(self) -> float:
        """How much higher above ground than it must be the lower end is: no leg from there can keep more."""
        heights = np.array([self.start_m[2], self.goal_m[2]]) - kernels.terrain_heights(
            self.space.terrain, np.array([self.start_m[:2], self.goal_m[:2]])
        )
        low, high = self.margins.height_agl_min_m, self.margins.height_agl_max_m
        return max(0.0, float(min(heights.min() - low, high - heights.max())))

    @property
    def straight_m(self) -> float:
        """The length of the straight line."""
        return float(np.linalg.norm(self.goal_m - self.start_m))

    def tolerance_m(self, share: float) -> float:
        """Return what cutting a corner saves at least; on short sections points would crowd for millimetres."""
        return max(share * self.length_m, _HIDDEN_M if share >= _TAUT_TOLERANCE else 0.1 * _HIDDEN_M)

    def rules(self, ground_slope: float, spare_m: float) -> Rules:
        """Return the margins for the kernels; ``spare_m`` covers what the terrain does between samples."""
        m = self.margins
        return Rules(
            height_min_m=m.height_agl_min_m + spare_m,
            height_max_m=m.height_agl_max_m - spare_m,
            alt_max_m=m.alt_amsl_max_m,
            obstacle_m=m.obstacle_m,
            fence_m=m.fence_m,
            slope_up=self.slope_up * (1.0 - 1e-9),
            slope_down=self.slope_down * (1.0 - 1e-9),
            ground_slope=ground_slope,
        )

    def accepts(self, path: FloatArray) -> bool:
        """Return whether every leg of a path (K, 3) keeps the margins and angles: the judge of all that is returned."""
        legs = polyline_legs(path)
        return bool(
            legs_clear(self.space, self.margins, legs).all() and legs_within_angles(self.limits, legs, 1e-12).all()
        )


@dataclass(frozen=True, slots=True)
class _Level:
    """One grid to try: cells per section length, and how far the box reaches beyond the ends, in section lengths."""

    cells: int
    reach: float


_LEVELS = (_Level(16, 0.5), _Level(32, 1.0), _Level(16, 4.0), _Level(64, 1.0), _Level(48, 4.0), _Level(48, math.inf))
_NO_WALLS = np.empty((0, 11))
_NO_POINTS = np.empty((0, 3))


def _grids(problem: _Problem, levels: Sequence[_Level]) -> Iterator[tuple[_Grid, npt.NDArray[np.int64], float]]:
    """Yield ever larger and finer grids, each with its moves and the steepest ground within it."""
    start, goal = problem.start_m, problem.goal_m
    across = math.hypot(*(goal - start)[:2])
    ux, uy = (goal - start)[:2] / across if across > 1e-6 else (1.0, 0.0)
    turn = np.array([[ux, -uy], [uy, ux]])  # columns: along and left of the section
    west, south, east, north = problem.space.area
    area = (np.array([[west, south], [west, north], [east, south], [east, north]]) - start[:2]) @ turn
    for level in levels:
        reach_m = level.reach * problem.length_m
        low = np.maximum(area.min(axis=0), -reach_m)
        high = np.minimum(area.max(axis=0), [across + reach_m, reach_m])
        corners = np.array([[u, v] for u in (low[0], high[0]) for v in (low[1], high[1])]) @ turn.T + start[:2]
        ground_low, ground_high, ground_slope = _survey(problem.space.terrain, corners)
        bottom, top = _altitudes(problem, corners, ground_low, ground_high)
        low, high = np.append(low, bottom - start[2]), np.append(high, top - start[2])
        cell_m = problem.length_m / level.cells
        while True:
            layer_m = _layer_m(problem, cell_m, top - bottom)
            step = np.array([cell_m, cell_m, layer_m])
            first = np.minimum(np.ceil(low / step), 0.0)
            size = np.maximum(np.floor(high / step), 0.0) - first + 1.0
            if size.prod() <= _NODES_MAX:
                break
            cell_m *= 1.25
        grid = _Grid(float(ux), float(uy), cell_m, layer_m, *first.astype(int).tolist(), *size.astype(int).tolist())
        yield grid, _moves(problem, cell_m, layer_m), ground_slope


def _survey(terrain: kernels.TerrainArrays, corners: FloatArray) -> tuple[float, float, float]:
    """Return lowest and highest ground and its steepest slope (inf near voids) in the hull of corners (N, 2)."""
    height = terrain.height_amsl_m
    cells = np.array([kernels.cell_position(terrain, x, y) for x, y in corners])
    low = np.clip(np.floor(cells.min(axis=0)) - 2, 0, np.array(height.shape) - 1).astype(int)
    high = np.clip(np.ceil(cells.max(axis=0)) + 3, 1, height.shape).astype(int)
    window = height[low[0] : high[0], low[1] : high[1]]
    voids = np.isnan(window)
    if voids.all():
        return math.inf, -math.inf, math.inf
    lowest, highest = float(np.nanmin(window)), float(np.nanmax(window))
    if voids.any():
        return lowest, highest, math.inf
    down, right = np.diff(window, axis=0)[:, :-1], np.diff(window, axis=1)[:-1]
    rise = math.sqrt(float((down * down + right * right).max(initial=0.0)))
    x, y = corners.mean(axis=0)
    here, east, north = (
        np.array(kernels.cell_position(terrain, x + dx, y + dy)) for dx, dy in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    )
    cells_per_m = float(np.linalg.norm([east - here, north - here], ord=2))
    # Between samples Keys' cubic is hardly steeper than its steepest data; if it is, the judge, sampling densely, sees.
    return lowest, highest, 1.2 * rise * cells_per_m


def _altitudes(problem: _Problem, corners: FloatArray, ground_low: float, ground_high: float) -> tuple[float, float]:
    """Return the lowest and highest altitude at which it can help to fly."""
    margins, o = problem.margins, problem.space.obstacles
    ends = (problem.start_m[2], problem.goal_m[2])
    middle = corners.mean(axis=0)
    near = np.hypot(*(o.bound[:, :2] - middle).T) < o.bound[:, 2] + np.linalg.norm(corners[0] - middle)
    tops = [top for top, counts in zip(_tops_amsl_m(o), near & o.hard, strict=True) if counts and math.isfinite(top)]
    top = max([*ends, ground_high + margins.height_agl_min_m, *(top + margins.obstacle_m for top in tops)]) + 30.0
    top = min(top, margins.alt_amsl_max_m, problem.space.fence_top_amsl_m - margins.fence_m)
    bottom = max(ground_low + margins.height_agl_min_m, min(ends) - problem.length_m)
    return min(bottom, *ends), max(top, *ends)


def _tops_amsl_m(o: kernels.ObstacleArrays) -> FloatArray:
    p, kind = o.params, o.kind
    return np.select(
        [
            kind == kernels.CYLINDER,
            kind == kernels.CONE,
            kind == kernels.PRISM,
            (kind == kernels.CABLE) | (kind == kernels.CURTAIN),
        ],
        [p[:, 3], p[:, 3] + p[:, 4], p[:, 1], np.maximum(p[:, 2], p[:, 5]) + p[:, 6]],
        p[:, 2] + p[:, 3],
    )


def _layer_m(problem: _Problem, cell_m: float, range_m: float) -> float:
    """Return the spacing of layers: one cell's climb is never less than one layer."""
    steepest_m = 0.98 * cell_m * min(problem.slope_up, problem.slope_down)
    band_m = problem.margins.height_agl_max_m - problem.margins.height_agl_min_m
    return min(steepest_m, 0.5 * cell_m, max(range_m / 24.0, 4.0), max(band_m / 3.0, 1.0))


_DIRECTIONS = tuple((u, v) for u in range(-2, 3) for v in range(-2, 3) if math.gcd(u, v) == 1)


def _moves(problem: _Problem, cell_m: float, layer_m: float) -> npt.NDArray[np.int64]:
    """Return moves (M, 3): sixteen directions, each level, up or down by one layer or as steep as allowed."""
    moves = []
    for u, v in _DIRECTIONS:
        across_m = math.hypot(u, v) * cell_m
        up, down = (int(slope * across_m / layer_m * (1.0 - 1e-6)) for slope in (problem.slope_up, problem.slope_down))
        moves += [(u, v, w) for w in sorted({0, min(1, up), up, -min(1, down), -down})]
    return np.array(moves, dtype=np.int64)


def _find(
    problem: _Problem, walls: FloatArray, levels: Sequence[_Level], longest_m: float = math.inf
) -> FloatArray | None:
    """Return a taut path (K, 3) that crosses no wall, or None if none of the grids holds one."""
    for grid, moves, ground_slope in _grids(problem, levels):
        for spare_m in _SPARES_M:
            rules = problem.rules(ground_slope, min(spare_m, problem.spare_m))
            raw = _graph_path(problem, rules, walls, grid, moves, longest_m)
            if not len(raw):
                break
            path = _draw_taut(problem, rules, walls, raw)
            if path is not None:
                return _let_go(problem, rules, path) if len(walls) else path
    return None


def _let_go(problem: _Problem, rules: Rules, path: FloatArray) -> FloatArray:
    """Return a path that may lean on a wall's edge drawn taut without walls, if it stays on its sides of everything."""
    freed = _draw_taut(problem, rules, _NO_WALLS, path)
    return path if freed is None or (_sides(problem, path) != _sides(problem, freed)).any() else freed


def _graph_path(
    problem: _Problem,
    rules: Rules,
    walls: FloatArray,
    grid: _Grid,
    moves: npt.NDArray[np.int64],
    longest_m: float,
) -> FloatArray:
    """Return the shortest path (K, 3) along the grid, (0, 3) if there is none as short as asked."""
    columns = grid.u_count * grid.v_count
    count = columns * grid.w_count
    nodes = _Nodes(
        cost=np.full(count, np.inf),
        parent=np.full(count, -1),
        radius=np.full(count, np.nan),
        closed=np.zeros(count, dtype=np.bool_),
        floor=np.full(columns, np.nan),
        queue_cost=np.empty(8 * count),
        queue_node=np.empty(8 * count, dtype=np.int64),
    )
    first = (-grid.u_low * grid.v_count - grid.v_low) * grid.w_count - grid.w_low
    nodes.cost[first] = nodes.radius[first] = nodes.queue_cost[0] = 0.0
    nodes.queue_node[0] = first
    ends = np.array([problem.start_m, problem.goal_m])
    lengths = np.linalg.norm(moves * (grid.cell_m, grid.cell_m, grid.layer_m), axis=1)
    node = _expand(problem.space, rules, walls, ends, grid, moves, lengths, nodes, longest_m)
    if node < 0:
        return np.empty((0, 3))
    path = [problem.goal_m]
    while node != first:
        u, v, w = np.unravel_index(node, (grid.u_count, grid.v_count, grid.w_count))
        a, b, c = (u + grid.u_low) * grid.cell_m, (v + grid.v_low) * grid.cell_m, (w + grid.w_low) * grid.layer_m
        path.append(problem.start_m + np.array([a * grid.ux - b * grid.uy, a * grid.uy + b * grid.ux, c]))
        node = int(nodes.parent[node])
    return np.array([problem.start_m, *path[::-1]])


def _shortcut(problem: _Problem, rules: Rules, walls: FloatArray, path: FloatArray) -> FloatArray:
    """Return the path without the points that a clear leg can skip: from each the farthest, found by galloping."""
    kept, last = [0], len(path) - 1
    while kept[-1] < last:
        here = kept[-1]
        good, bad, stride = here + 1, last + 1, 2
        while bad - good > 1:
            trial = min(here + stride, last) if bad > last else (good + bad) // 2
            if leg_ok(problem.space, rules, walls, path[[here, trial]], False):
                good, stride = trial, 2 * stride
            else:
                bad = trial
        kept.append(good)
    return path[kept]


def _tightened(problem: _Problem, ground_slope: float, path: FloatArray, tolerance: float) -> FloatArray:
    """Return the path brought to its taut string, if that is shorter and passes the judge; else the path."""
    points = np.concatenate([path, np.zeros((_TIGHT_ROOM, 3))])
    for spare_m in _SPARES_M if len(path) > 2 else ():
        rules = problem.rules(ground_slope, min(spare_m, problem.spare_m))
        trial = points.copy()
        size = tighten(problem.space, rules, _NO_WALLS, trial, len(path), problem.tolerance_m(tolerance))
        trial = trial[:size].copy()
        if _length_m(trial) < _length_m(path) and problem.accepts(trial):
            return trial
    return path


def _length_m(path: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def _draw_taut(problem: _Problem, rules: Rules, walls: FloatArray, raw: FloatArray) -> FloatArray | None:
    """Return the path drawn taut, or as it was where that does not pass the judge; None if neither does."""
    short = _shortcut(problem, rules, walls, raw)
    path = np.concatenate([short, np.zeros((_CUTS_MAX, 3))])
    size = pull(problem.space, rules, walls, path, len(short), _TAUT_TOLERANCE * problem.length_m)
    return next((path for path in (path[:size].copy(), short, raw) if problem.accepts(path)), None)


# --- the roadmap ---------------------------------------------------------------------------------------------------

_FINER = 4.0  # rings of a second look, where a first found no shorter way
_GROUND_CELLS = 24  # per section length, of points above the ground
_TIGHTEST = 2e-6  # of the section's length, as _TAUT_TOLERANCE
_WIDEST = 2.0  # times the straight line: longer ways are left to the grids
_UNHELD_M = 0.5  # so far from its limits of height a path is not held by them


def _along_roadmap(
    problem: _Problem,
    ground_slope: float,
    known: FloatArray,
    longest_m: float,
    tolerance: float,
    fineness: float,
    *,
    sideways: bool = False,
) -> FloatArray | None:
    """Return the shortest path (K, 3) along the roadmap, drawn taut; None if none is shorter than ``longest_m``.

    ``sideways``: where solids alone hold it, seen from above.
    """
    ends = problem.start_m, problem.goal_m
    for spare_m in _SPARES_M:
        rules = problem.rules(ground_slope, min(spare_m, problem.spare_m))
        path = shortest_way(problem.space, rules, *ends, known, longest_m, fineness=fineness, taut=sideways)
        if path is None:
            return None
        path = _tightened(problem, ground_slope, path, tolerance)
        if problem.accepts(path):
            return path
    return None


def _sideways_alone(problem: _Problem, length_m: float) -> bool:
    """Return whether no path of this length could pass over or under any solid near."""
    o, ends = problem.space.obstacles, np.array([problem.start_m, problem.goal_m])
    away = np.linalg.norm(o.bound[:, np.newaxis, :2] - ends[:, :2], axis=2).sum(axis=1)
    near = o.hard & (away - 2.0 * (o.bound[:, 2] + problem.margins.obstacle_m) < length_m)
    # an ellipse around the ends holds all such paths; half its height is how far they may climb
    reach_m = 0.5 * math.sqrt(max(length_m**2 - problem.straight_m**2, 0.0)) + problem.margins.obstacle_m
    tall = (o.bound[:, 4] >= ends[:, 2].max() + reach_m) & (o.bound[:, 3] <= ends[:, 2].min() - reach_m)
    upright = (o.kind == kernels.CYLINDER) | (o.kind == kernels.PRISM)
    return bool((tall & upright)[near].all())


def _held_sideways(problem: _Problem, path: FloatArray) -> bool:
    """Return whether neither ground nor ceiling nor a limit of climb nor the fence holds a path."""
    legs, m = polyline_legs(path), problem.margins
    table = kernels.legs_clearance(problem.space, legs, STEP_M)
    rise, across = legs[:, 1, 2] - legs[:, 0, 2], np.hypot(*(legs[:, 1] - legs[:, 0])[:, :2].T)
    return bool(
        (table[:, kernels.HEIGHT_MIN] > m.height_agl_min_m + _UNHELD_M).all()
        and (table[:, kernels.HEIGHT_MAX] < m.height_agl_max_m - _UNHELD_M).all()
        and path[:, 2].max() <= max(problem.start_m[2], problem.goal_m[2]) + 1e-6
        and (table[:, kernels.FENCE] > m.fence_m + _UNHELD_M).all()
        and (rise < 0.999 * problem.slope_up * across).all()
        and (-rise < 0.999 * problem.slope_down * across).all()
    )


def _over_ground(problem: _Problem, longest_m: float) -> FloatArray:
    """Return points (N, 3) low above the ground, and as high as the straight line, on a grid around the section."""
    across = (problem.goal_m - problem.start_m)[:2]
    level_m = float(np.linalg.norm(across))
    along = across / level_m if level_m > 1e-6 else np.array([1.0, 0.0])
    cell_m = problem.length_m / _GROUND_CELLS
    beyond_m = 0.5 * max(longest_m - problem.straight_m, 0.0)
    half_m = 0.5 * math.sqrt(max(longest_m**2 - problem.straight_m**2, 0.0))
    u = np.arange(-math.floor(beyond_m / cell_m), math.floor((level_m + beyond_m) / cell_m) + 1) * cell_m
    v = np.arange(-math.floor(half_m / cell_m), math.floor(half_m / cell_m) + 1) * cell_m
    u, v = (grid.ravel() for grid in np.meshgrid(u, v))
    xy = problem.start_m[:2] + u[:, np.newaxis] * along + v[:, np.newaxis] * np.array([-along[1], along[0]])
    ground = kernels.terrain_heights(problem.space.terrain, np.ascontiguousarray(xy))
    line = problem.start_m[2] + np.clip(u / max(level_m, 1e-6), 0.0, 1.0) * (problem.goal_m[2] - problem.start_m[2])
    low = ground + problem.margins.height_agl_min_m + _SPARES_M[-1]
    points = np.concatenate([np.column_stack([xy, low]), np.column_stack([xy, np.maximum(low, line)])])
    inside: FloatArray = points[np.isfinite(points[:, 2])]
    return inside


# --- other ways around ---------------------------------------------------------------------------------------------

_WALLS_PER_PATH = 3
_WALL_REACH = 0.35  # of the section's length
_NEAR = 0.25  # of the section's length: an obstacle this near may be passed on another side
_LONGEST = 1.5  # times the shortest: longer ways around are not worth a guess
_SHORT_ENOUGH = 1.003  # times the least any path can be: one guess is asked for, and this is it
_SAMPLES = 65
_LEANING = 0.5  # how much upwards it is away from a curtain that is passed above, not beside


def _resample(path: FloatArray) -> FloatArray:
    """Return points (_SAMPLES, 3) evenly along a path."""
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.linspace(0.0, s[-1], _SAMPLES)
    return np.stack([np.interp(at, s, path[:, k]) for k in range(3)], axis=1)


def _unit(v: FloatArray) -> FloatArray:
    unit: FloatArray = v / max(float(np.linalg.norm(v)), 1e-12)
    return unit


def _walls_at(problem: _Problem, path: FloatArray) -> list[FloatArray]:
    """Return walls (11,), each closing one side on which the path passes something: where it bends, what it nears."""
    o, reach_m = problem.space.obstacles, _WALL_REACH * problem.length_m
    samples = _resample(path)
    course = np.gradient(samples, axis=0)
    walls: list[FloatArray] = []

    def close(at: FloatArray, along: FloatArray, away: FloatArray, depth_m: float) -> None:
        walls.append(np.concatenate([at, _unit(along), away, [depth_m, reach_m]]))

    hard = np.flatnonzero(o.hard)
    distance = kernels.obstacle_distances(o, samples)[:, hard]
    nearest = distance.argmin(axis=0)
    least = distance.min(axis=0)
    passed = np.flatnonzero((least < _NEAR * problem.length_m) & (nearest > 0) & (nearest < _SAMPLES - 1))
    passed = passed[np.argsort(least[passed], kind="stable")][:_WALLS_PER_PATH]
    away = np.empty((len(passed), 3))
    _away(o, hard[passed], samples[nearest[passed]], away)
    for n, direction in zip(passed, away, strict=True):
        # The wall holds the solid's axis, or a path could pass it over there before the obstacle and be out of it here.
        axis = np.array([0.0, 0.0, 1.0])
        over = o.kind[hard[n]] == kernels.CURTAIN and direction[2] > _LEANING
        if over or o.kind[hard[n]] == kernels.CABLE:
            axis = _unit(o.params[hard[n], 3:6] - o.params[hard[n], :3])
        along = np.cross(axis, direction)
        if abs(along @ _unit(course[nearest[n]])) < 0.1:
            along = course[nearest[n]]
        close(samples[nearest[n]], along, direction, 0.9 * least[n])

    before, after = path[1:-1] - path[:-2], path[2:] - path[1:-1]
    turns = [_unit(b) - _unit(a) for a, b in zip(before, after, strict=True)]
    sharpest = max(range(len(turns)), key=lambda k: float(turns[k] @ turns[k]), default=-1)
    if sharpest >= 0 and least.min(initial=math.inf) > 2.0 * problem.margins.obstacle_m:
        close(
            path[sharpest + 1],
            path[sharpest + 2] - path[sharpest],
            -turns[sharpest],
            0.9 * problem.margins.height_agl_min_m,
        )
    return walls


def _sides(problem: _Problem, path: FloatArray) -> npt.NDArray[np.int64]:
    """Return the side (O,) on which the path passes each hard solid: 0 left, 1 over, 2 right, 3 under, -1 far away."""
    o = problem.space.obstacles
    samples = _resample(path)
    left = _unit(np.array([problem.start_m[1] - problem.goal_m[1], problem.goal_m[0] - problem.start_m[0], 0.0]))
    distance = kernels.obstacle_distances(o, samples)
    near = np.flatnonzero(o.hard & (distance.min(axis=0, initial=math.inf) < _NEAR * problem.length_m))
    away = np.empty((len(near), 3))
    _away(o, near, samples[distance[:, near].argmin(axis=0)], away)
    sides = np.full(len(o.kind), -1)
    sides[near] = np.rint(2.0 * np.arctan2(away[:, 2], away @ left) / math.pi).astype(np.int64) % 4
    return sides


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """A path, the walls it was made to go around, and what tells it from others."""

    path: FloatArray
    walls: FloatArray
    length_m: float
    samples: FloatArray
    sides: npt.NDArray[np.int64]


def _way(problem: _Problem, path: FloatArray, walls: FloatArray) -> _Way:
    length_m = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    return _Way(path, walls, length_m, _resample(path), _sides(problem, path))


def _differ(problem: _Problem, one: _Way, other: _Way) -> bool:
    """Return whether two ways are worth keeping both: far apart, or apart and on different sides of something."""
    apart_m = float(np.linalg.norm(one.samples - other.samples, axis=1).max())
    if apart_m < max(0.02 * problem.length_m, 2.0):
        return False
    return apart_m > 0.1 * problem.length_m or bool((one.sides != other.sides).any())


def first_guesses(
    space: SpaceArrays,
    limits: VehicleLimits,
    start_m: npt.ArrayLike,
    goal_m: npt.ArrayLike,
    *,
    count: int = 1,
    clearance_extra_m: float = 0.0,
    names: Sequence[str] = (),
    thorough: bool = False,
) -> list[FloatArray]:
    """Return up to ``count`` taut polylines (K, 3) from start to goal on different ways around, shortest first.

    Where the straight leg is clear, it is the only one: there is nothing to go around.

    Parameters
    ----------
    start_m, goal_m : (3,) the ends, themselves clear by the vehicle's margins.
    count : how many ways are wanted; what there is to find may be fewer.
    clearance_extra_m : kept on top of the margins, as far as both ends do and a way exists.
    names : of the obstacles, for the error message.
    thorough : take up to a second to find shorter ways over rough ground, and draw ten times finer arcs.

    Raises
    ------
    InfeasibleError
        No clear way was found; says which end or which limit is in the way.
    """
    start, goal = np.array(start_m, dtype=float), np.array(goal_m, dtype=float)
    ends = {"start": start, "goal": goal}
    margins = _end_margins(space, Margins.of(limits), Margins.of(limits, clearance_extra_m), ends, names)
    problem = _Problem(space, margins, limits, start, goal)
    straight = np.array([start, goal])
    if problem.accepts(straight):
        return [straight]
    ground_slope = next(_grids(problem, _LEVELS[:1]))[2]
    tolerance = _TIGHTEST if thorough else _TAUT_TOLERANCE
    first = _shortest_sideways(problem, ground_slope, tolerance)
    if first is not None:
        return [way.path for way in _ways(problem, ground_slope, first, None, count, thorough)]
    for level in _LEVELS:
        first = _find(problem, _NO_WALLS, (level,))
        if first is not None:
            return [way.path for way in _ways(problem, ground_slope, first, level, count, thorough)]
    if clearance_extra_m > 0.0:
        return first_guesses(space, limits, start, goal, count=count, names=names, thorough=thorough)
    raise InfeasibleError(_what_blocks(problem, names))


def _shortest_sideways(problem: _Problem, ground_slope: float, tolerance: float) -> FloatArray | None:
    """Return the shortest path where it passes everything sideways and nothing else holds it, else None."""
    longest_m = _WIDEST * problem.straight_m
    if not _sideways_alone(problem, problem.straight_m):
        return None
    best: FloatArray | None = None
    for fineness in (1.0, _FINER):
        path = _along_roadmap(problem, ground_slope, _NO_POINTS, longest_m, tolerance, fineness, sideways=True)
        if path is not None:
            best, longest_m = path, _length_m(path)
        if best is None or not (_held_sideways(problem, best) and _sideways_alone(problem, longest_m)):
            return None
    return best


def _ways(
    problem: _Problem, ground_slope: float, first: FloatArray, level: _Level | None, count: int, thorough: bool
) -> list[_Way]:
    """Return up to ``count`` different ways, shortest first, the first of them given.

    No level: it is the shortest, and taut enough unless thorough.
    """
    tolerance = _TIGHTEST if thorough else _TAUT_TOLERANCE
    taut = first if level is None and not thorough else _tightened(problem, ground_slope, first, tolerance)
    found = [_way(problem, taut, _NO_WALLS)]
    short = level is None or (not thorough and found[0].length_m < _SHORT_ENOUGH * problem.least_m)
    if count == 1 and short:
        return found
    longest_m = _LONGEST * found[0].length_m

    def look(walls: FloatArray, level: _Level) -> _Way | None:
        path = _find(problem, walls, (level,), longest_m)
        if path is None:
            return None
        tight = _tightened(problem, ground_slope, path, tolerance)
        if not len(walls) or (_sides(problem, tight) == _sides(problem, path)).all():
            path = tight
        way = _way(problem, path, walls)
        for n, known in enumerate(found):
            if not _differ(problem, way, known):
                found[n] = min(known, way, key=lambda w: w.length_m)
                return None
        found.append(way)
        return way

    if level is not None:
        # A grid measures lengths 2 to 3 % wrong and may take the wrong way for the shortest; others err otherwise.
        for other in (_Level(3 * level.cells // 4, level.reach), _Level(3 * level.cells // 2, level.reach)):
            look(_NO_WALLS, other)
    unopened = found.copy()
    searches = count + 2
    while unopened and searches > 0 and len(found) < max(count, 2):
        way = min(unopened, key=lambda w: w.length_m)
        unopened.remove(way)
        for wall in _walls_at(problem, way.path)[:searches]:
            searches -= 1
            another = look(np.concatenate([way.walls, wall[None]]), level or _LEVELS[0])
            if another is not None:
                unopened.append(another)
    if level is not None:
        _change_over(problem, ground_slope, found, thorough)
    return sorted(found, key=lambda w: w.length_m)[:count]


def _change_over(problem: _Problem, ground_slope: float, found: list[_Way], thorough: bool) -> None:
    """Add to the ways one that the roadmap knows to be shorter, from one way to another or where no grid sees."""
    known = [way.path[1:-1] for way in found]
    best = min(found, key=lambda w: w.length_m)
    if thorough:
        known.append(_over_ground(problem, best.length_m))
    for fineness in (1.0, _FINER) if thorough else (1.0,):
        tolerance = _TIGHTEST if thorough else _TAUT_TOLERANCE
        path = _along_roadmap(problem, ground_slope, np.concatenate(known), best.length_m, tolerance, fineness)
        if path is None or _length_m(path) >= best.length_m:
            continue
        best = _way(problem, path, _NO_WALLS)
        found[:] = [*(way for way in found if _differ(problem, way, best)), best]


def _end_margins(
    space: SpaceArrays, must: Margins, wish: Margins, ends: dict[str, FloatArray], names: Sequence[str]
) -> Margins:
    """Return the wished margins as far as both ends themselves keep them; an end that lacks what it must: error."""
    o = space.obstacles
    kept = wish
    for end, at in ends.items():
        height = at[2] - kernels.terrain_height(space.terrain, at[0], at[1])
        inside = float(kernels.inside_distance(space, *at)) - _BOUND_SLACK_M
        distance = np.where(o.hard, kernels.obstacle_distances(o, at[None])[0], math.inf) - _BOUND_SLACK_M
        nearest = int(distance.argmin()) if len(distance) else -1
        least = float(distance.min(initial=math.inf))
        what = _obstacle(names, nearest)
        for have, need, text in (
            (height, must.height_agl_min_m, "above the ground"),
            (least, must.obstacle_m, f"from {what}"),
            (inside, must.fence_m, "inside the fence and the area"),
        ):
            if not have >= need - _TIGHT_END_M:
                raise InfeasibleError(f"{end} is {have:.1f} m {text}, expected at least {need:.1f} m: move it")
        for have, need, text in (
            (height, must.height_agl_max_m, "above the ground"),
            (at[2], must.alt_amsl_max_m, "AMSL"),
        ):
            if not have <= need + _TIGHT_END_M:
                raise InfeasibleError(f"{end} is {have:.1f} m {text}, expected at most {need:.1f} m: move it")
        kept = Margins(
            height_agl_min_m=min(kept.height_agl_min_m, height - 1e-9),
            height_agl_max_m=max(kept.height_agl_max_m, height + 1e-9),
            alt_amsl_max_m=max(kept.alt_amsl_max_m, at[2]),
            obstacle_m=min(kept.obstacle_m, least),
            fence_m=min(kept.fence_m, inside),
        )
    return kept


def _obstacle(names: Sequence[str], index: int) -> str:
    return names[index] if 0 <= index < len(names) else f"obstacle {index}"


_LEVELS_WHEN_BLOCKED = 3


def _what_blocks(problem: _Problem, names: Sequence[str]) -> str:
    """Return what stands in the way: the one limit without which there is a path."""
    space, limits, margins = problem.space, problem.limits, problem.margins
    harmless = space.obstacles._replace(hard=np.zeros_like(space.obstacles.hard))
    anything = replace(limits, climb_angle_rad=_STEEPEST_RAD, descent_angle_rad=_STEEPEST_RAD)
    high = replace(margins, height_agl_max_m=math.inf, alt_amsl_max_m=math.inf)
    rise = problem.goal_m[2] - problem.start_m[2]
    angle_deg = math.degrees(limits.climb_angle_rad if rise > 0.0 else limits.descent_angle_rad)
    across = math.hypot(*(problem.goal_m - problem.start_m)[:2])
    direct_deg = math.degrees(math.atan2(abs(rise), across))
    trials = (
        (
            replace(problem, limits=anything),
            f"the straight way needs {direct_deg:.1f} deg, the limit is {angle_deg:.1f} deg, and there is no room for "
            "detours: allow steeper flight or move start or goal",
        ),
        (replace(problem, margins=high), "the height limit is in the way: raise height_agl_max_m or alt_amsl_max_m"),
        (
            replace(problem, space=space._replace(fence=np.empty((0, 2)), fence_top_amsl_m=math.inf)),
            "the fence is in the way: widen it",
        ),
        (
            replace(
                problem,
                space=space._replace(obstacles=harmless),
            ),
            "",
        ),
    )
    for trial, text in trials:
        path = _find(trial, _NO_WALLS, _LEVELS[:_LEVELS_WHEN_BLOCKED])
        if path is None:
            continue
        if text:
            return f"no clear way: {text}"
        near = kernels.legs_clearance(space, polyline_legs(path), STEP_M)
        hit = near[near[:, kernels.OBSTACLE] < margins.obstacle_m, kernels.OBSTACLE_INDEX]
        what = ", ".join(dict.fromkeys(_obstacle(names, int(i)) for i in hit))
        return f"no clear way past {what} with a margin of {margins.obstacle_m:.1f} m: lower it or move start or goal"
    return "no clear way: ground, obstacles and limits together leave none: widen the area or move start or goal"
