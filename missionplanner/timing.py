"""Where vehicles are when: predicted flights, and how far apart they stay.

All times come from the motion model (:mod:`.motion`), never from length over speed: real vehicles accelerate, slow down
in corners and look only one leg ahead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from missionplanner.geodesy import FloatArray
from missionplanner.kernels import kernel
from missionplanner.motion import Navigator, Route, landing_points, return_points, takeoff_points
from missionplanner.plan import Trajectory
from missionplanner.vehicle import Ending, MotionModel

_HOVER_S = 5.0


def predict_flight(
    model: MotionModel,
    home_m: npt.ArrayLike,
    waypoints_m: npt.ArrayLike,
    speed_m_s: npt.ArrayLike,
    *,
    hold_s: npt.ArrayLike | None = None,
    spline: npt.ArrayLike | None = None,
    vertical_m_s: npt.ArrayLike | None = None,
    end: Ending = "loiter",
    ground_amsl_m: float = 0.0,
    start_delay_s: float = 0.0,
    until_s: float = 0.0,
) -> tuple[Trajectory, FloatArray]:
    """Return the whole flight and the times (W,) at which ``waypoints_m`` (W, 3) are reached, both with the delay.

    From rest at ``home_m`` (3,) up to the first waypoint, along the legs, then the end. Arrival is the last waypoint's
    time. A vehicle that stays in the air at its end is followed until it has settled there (a plane:
    has circled twice), and at least until ``until_s``.

    Parameters
    ----------
    speed_m_s : of all legs, or of each leg (W - 1,)
    hold_s : how long it stands still at each waypoint but the first (W - 1,); default: nowhere
    spline : whether an ArduCopter flies a spline to each waypoint but the first (W - 1,); default: nowhere
    vertical_m_s : bound on the climb or descent rate to each waypoint but the first (W - 1,); default: none
    ground_amsl_m : the ground under the last waypoint, for ``end="land"``
    start_delay_s : time at home before the start
    until_s : time up to which the flight is of interest; one that has landed stays where it is anyway
    """
    home = np.asarray(home_m, dtype=float)
    waypoints = np.asarray(waypoints_m, dtype=float).reshape(-1, 3)
    navigator = Navigator([model], home[None])
    parts, reached_s = _outbound(navigator, model, home, waypoints, speed_m_s, hold_s, spline, vertical_m_s)
    last_m_s = float(np.ravel(speed_m_s)[-1])
    match end:
        case "land":
            if model.autopilot == "ardupilot" and model.vehicle_class == "copter":  # first to the place, as told
                parts.append(navigator.fly(Route.through(waypoints[-1:], last_m_s))[0])
            way = landing_points(model, waypoints[-1], ground_amsl_m, last_m_s)
        case "rtl":
            way = return_points(model, navigator.position_m[0], home)
        case "loiter":
            way = Route.through(waypoints[-1:], last_m_s)
    parts.append(navigator.fly(way)[0])
    if end == "loiter" or (end == "rtl" and model.vehicle_class == "plane"):
        settling_s = _settling_s(model, float(way.speed_m_s[-1]), float(way.points_m[-1, 2]))
        flown_s = start_delay_s + sum(float(part.t_s[-1]) for part in parts)
        parts.append(navigator.linger(max(settling_s, until_s - flown_s)))
    t_s = [np.zeros(1)] if start_delay_s > 0.0 else []
    position_m = [home[None]] if start_delay_s > 0.0 else []
    begin_s = start_delay_s
    for k, part in enumerate(parts):
        first = 0 if k == 0 else 1  # a part begins where the last one ended
        t_s.append(begin_s + part.t_s[first:])
        position_m.append(part.position_m[first:])
        begin_s += float(part.t_s[-1])
    return Trajectory(np.concatenate(t_s), np.concatenate(position_m)), reached_s + start_delay_s


def _settling_s(model: MotionModel, speed_m_s: float, alt_amsl_m: float) -> float:
    """Return how long a vehicle is followed that stays at its end."""
    if model.vehicle_class == "copter":
        return _HOVER_S
    wind_m_s = math.hypot(*model.wind_m_s)
    ground_m_s = max(speed_m_s - wind_m_s, 0.25 * speed_m_s)
    return 2.0 * 2.0 * math.pi * model.circle_m(speed_m_s, alt_amsl_m, wind_m_s) / ground_m_s


def _outbound(
    navigator: Navigator,
    model: MotionModel,
    home: FloatArray,
    waypoints: FloatArray,
    speed_m_s: npt.ArrayLike,
    hold_s: npt.ArrayLike | None = None,
    spline: npt.ArrayLike | None = None,
    vertical_m_s: npt.ArrayLike | None = None,
) -> tuple[list[Trajectory], FloatArray]:
    """Fly take-off and legs; return their trajectories and when the waypoints were reached, without delay."""
    takeoff, times = navigator.fly(takeoff_points(model, home, waypoints[0]))
    parts = [takeoff]
    reached_s = times[-1:]
    if len(waypoints) > 1:
        legs, times = navigator.fly(Route.through(waypoints[1:], speed_m_s, hold_s, vertical_m_s, spline=spline))
        parts.append(legs)
        reached_s = np.concatenate([reached_s, float(takeoff.t_s[-1]) + times])
    return parts, reached_s


def reached_times(
    model: MotionModel,
    home_m: npt.ArrayLike,
    waypoints_m: npt.ArrayLike,
    speed_m_s: npt.ArrayLike,
    hold_s: npt.ArrayLike | None = None,
) -> FloatArray:
    """Return how long after its start a vehicle reaches each waypoint (W,): :func:`predict_flight` without its end."""
    home = np.asarray(home_m, dtype=float)
    waypoints = np.asarray(waypoints_m, dtype=float).reshape(-1, 3)
    return _outbound(Navigator([model], home[None]), model, home, waypoints, speed_m_s, hold_s)[1]


# ---------------------------------------------------------------------------------------------------------------------
# Separation in space and time.


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """The least distance between two vehicles ``first`` < ``second`` (indices), when it occurs, and where each is."""

    first: int
    second: int
    distance_m: float
    t_s: float
    first_m: FloatArray  # (3,)
    second_m: FloatArray  # (3,)


@dataclass(frozen=True, slots=True)
class Slack:
    """How early or late either of two vehicles (indices, ``first`` < ``second``) may be before they come too close."""

    first: int
    second: int
    slack_s: float


class TimeTree(NamedTuple):
    """A flight's samples (S,) and bounds of its parts: a binary tree over blocks of them, node n above 2n and 2n + 1.

    Node n spans the samples ``span[n, 0]`` to ``span[n, 1]`` (none where they are equal), all within ``box[n]`` (least
    x, y, z, greatest x, y, z) and at every time within ``bend_m[n]`` of the straight, even motion between the two ends.
    """

    t_s: FloatArray
    position_m: FloatArray
    span: npt.NDArray[np.int64]  # (N, 2)
    box: FloatArray  # (N, 6)
    bend_m: FloatArray  # (N,)


_BLOCK = 8  # samples
_STACK = 256  # far more than two trees are deep
_LATENESS_TOLERANCE_S = 0.01
_BRACKET_S = 1e-4
_TOUCH_M = 1e-6  # distances are kept to a micrometre, as in `Clearance.ok`
_ROUNDING_M = 1e-9
_SAME_M = 1e-7  # for those who fly in formation are nearest always: once is enough


def least_separation(trajectories: Sequence[Trajectory], near_m: float | None = None) -> list[Separation]:
    """Return for every pair its least distance over all time (PAPER.md eq. 9), in closed form per pair of segments.

    Nothing is sampled: between two neighbouring times of either vehicle both move linearly, so the distance there is
    that of a point to a segment. What bounds show not to be nearer (by 0.1 micrometres) is not looked at. Before its
    start and after its end a vehicle stands still.

    Parameters
    ----------
    near_m : only pairs that come closer than this are returned; None: all
    """
    trees = _time_trees(trajectories)
    most_m = math.inf if near_m is None else near_m
    found = []
    for i, j in combinations(range(len(trees)), 2) if near_m is None else _near_pairs(trees, near_m):
        distance_m, t_s = closest_approach(trees[i], trees[j], most_m)
        if distance_m < most_m:
            found.append(Separation(i, j, distance_m, t_s, trajectories[i].at(t_s), trajectories[j].at(t_s)))
    return found


def tightest_pair(trajectories: Sequence[Trajectory], required_m: Callable[[int, int], float]) -> Separation | None:
    """Return of all pairs the one whose least distance exceeds what i and j require by the least; None of none.

    As :func:`least_separation` finds it, to 0.1 micrometres; pairs that cannot be it are hardly looked at.
    """
    trees = _time_trees(trajectories)
    boxes = _boxes(trees)
    low, high = boxes[:, None, :3], boxes[:, None, 3:]
    gaps = np.maximum(0.0, np.maximum(low - high.swapaxes(0, 1), low.swapaxes(0, 1) - high))
    apart_m = np.sqrt((gaps * gaps).sum(axis=-1)).tolist()
    rooms = []
    for i, j in combinations(range(len(trees)), 2):
        need_m = required_m(i, j)
        rooms.append((apart_m[i][j] - need_m, i, j, need_m))
    tightest: Separation | None = None
    least_m = math.inf
    for room_m, i, j, need_m in sorted(rooms):
        if room_m >= least_m:
            break  # nor can any after it
        most_m = least_m + need_m
        distance_m, t_s = closest_approach(trees[i], trees[j], most_m)
        if distance_m < most_m:
            least_m = distance_m - need_m
            tightest = Separation(i, j, distance_m, t_s, trajectories[i].at(t_s), trajectories[j].at(t_s))
    return tightest


def lateness_slack(one: Trajectory, other: Trajectory, required_m: float, limit_s: float = 60.0) -> float:
    """Return how early or late either of two vehicles may be while they still keep ``required_m`` apart.

    The least ``|t - u|`` of all times t of one and u of the other between whose places there is less than that; 0 where
    they are too close on time already, ``limit_s`` where it is more. Proven for continuous time: at most the true
    value, and less by at most 0.01 s.
    """
    first, second = _time_trees([one, other])
    return float(_least_lateness(first, second, required_m, limit_s))


def least_slack(
    trajectories: Sequence[Trajectory], required_m: Callable[[int, int], float], limit_s: float = 60.0
) -> list[Slack]:
    """Return the :func:`lateness_slack` of every pair, the least first; ``required_m`` says how far apart i and j are.

    The first is how early or late any one vehicle may be, all others being on time.
    """
    trees = _time_trees(trajectories)
    need_m = {pair: required_m(*pair) for pair in combinations(range(len(trees)), 2)}
    slack_s = dict.fromkeys(need_m, limit_s)  # whoever is never where another is may be as late as that
    for i, j in _near_pairs(trees, max(need_m.values(), default=0.0)):
        slack_s[i, j] = _least_lateness(trees[i], trees[j], need_m[i, j], limit_s)
    return sorted((Slack(i, j, least_s) for (i, j), least_s in slack_s.items()), key=lambda slack: slack.slack_s)


def _boxes(trees: Sequence[TimeTree]) -> FloatArray:
    """Return the boxes (V, 6) of whole flights: least x, y, z, greatest x, y, z."""
    return np.array([tree.box[1] for tree in trees]).reshape(-1, 6)


def _near_pairs(trees: Sequence[TimeTree], near_m: float) -> list[tuple[int, int]]:
    """Return the pairs whose boxes are nearer than that, in order: sorted along x, and swept."""
    boxes = _boxes(trees)
    order = np.argsort(boxes[:, 0], kind="stable")
    begins = boxes[order, 0]
    within_m = near_m + _ROUNDING_M
    found: list[tuple[int, int]] = []
    for rank, i in enumerate(order.tolist()):
        others = order[rank + 1 : int(np.searchsorted(begins, boxes[i, 3] + within_m, side="right"))]
        gaps = np.maximum(boxes[others, :3] - boxes[i, 3:], boxes[i, :3] - boxes[others, 3:])
        near = others[(gaps <= within_m).all(axis=1)]
        found += [(min(i, j), max(i, j)) for j in near.tolist()]
    return sorted(found)


def _time_trees(trajectories: Sequence[Trajectory]) -> list[TimeTree]:
    """Return trees over one time for all: from the first start to the last end; who does not fly stands."""
    begin_s = min((float(trajectory.t_s[0]) for trajectory in trajectories), default=0.0)
    end_s = max((float(trajectory.t_s[-1]) for trajectory in trajectories), default=0.0)
    end_s = max(end_s, begin_s + 1.0)  # of single samples, too, there is a segment
    trees = []
    for trajectory in trajectories:
        t_s, position_m = trajectory.t_s, trajectory.position_m
        first = [begin_s] if begin_s < t_s[0] else []
        last = [end_s] if end_s > t_s[-1] else []
        t_s = np.concatenate([first, t_s, last])
        position_m = np.concatenate([position_m[: len(first)], position_m, position_m[len(position_m) - len(last) :]])
        nodes = 2
        while nodes * _BLOCK < 2 * (len(t_s) - 1):
            nodes *= 2
        tree = TimeTree(t_s, position_m, np.zeros((nodes, 2), dtype=np.int64), np.empty((nodes, 6)), np.zeros(nodes))
        _grow(tree)
        trees.append(tree)
    return trees


@kernel
def _grow(tree: TimeTree) -> None:
    """Fill in the bounds of all nodes."""
    t, p = tree.t_s, tree.position_m
    leaves = tree.span.shape[0] // 2
    last = t.shape[0] - 1
    for n in range(2 * leaves - 1, 0, -1):
        if n >= leaves:
            begin = min((n - leaves) * _BLOCK, last)
            end = min(begin + _BLOCK, last)
            for axis in range(3):
                tree.box[n, axis] = tree.box[n, 3 + axis] = p[begin, axis]
                for k in range(begin + 1, end + 1):
                    tree.box[n, axis] = min(tree.box[n, axis], p[k, axis])
                    tree.box[n, 3 + axis] = max(tree.box[n, 3 + axis], p[k, axis])
            for k in range(begin + 1, end):  # of two piecewise linear motions the difference is greatest at a sample
                tree.bend_m[n] = max(tree.bend_m[n], _off_chord(t, p, begin, end, k))
        else:
            begin = tree.span[2 * n, 0]
            middle = tree.span[2 * n, 1]
            end = max(middle, tree.span[2 * n + 1, 1])
            for axis in range(3):
                tree.box[n, axis] = min(tree.box[2 * n, axis], tree.box[2 * n + 1, axis])
                tree.box[n, 3 + axis] = max(tree.box[2 * n, 3 + axis], tree.box[2 * n + 1, 3 + axis])
            tree.bend_m[n] = max(tree.bend_m[2 * n], tree.bend_m[2 * n + 1])
            if begin < middle < end:  # both halves' chords are off this one by most where they meet
                tree.bend_m[n] += _off_chord(t, p, begin, end, middle)
        tree.span[n, 0] = begin
        tree.span[n, 1] = end


@kernel
def _share(times: FloatArray, begin: int, end: int, t: float) -> float:
    """Return how far ``t`` is from one sample's time to another's; 0 where two samples have the same."""
    duration = times[end] - times[begin]
    share: float = (t - times[begin]) / duration if duration > 0.0 else 0.0
    return share


@kernel
def _off_chord(t: FloatArray, p: FloatArray, begin: int, end: int, k: int) -> float:
    """Return how far sample ``k`` is off the even motion from sample ``begin`` to ``end``."""
    share = _share(t, begin, end, t[k])
    x = p[begin, 0] + share * (p[end, 0] - p[begin, 0]) - p[k, 0]
    y = p[begin, 1] + share * (p[end, 1] - p[begin, 1]) - p[k, 1]
    z = p[begin, 2] + share * (p[end, 2] - p[begin, 2]) - p[k, 2]
    return math.sqrt(x * x + y * y + z * z)


@kernel
def _boxes_apart_m(one: TimeTree, n: int, other: TimeTree, m: int) -> float:
    """Return the distance of the boxes of two nodes."""
    squared = 0.0
    for axis in range(3):
        gap = max(one.box[n, axis] - other.box[m, 3 + axis], other.box[m, axis] - one.box[n, 3 + axis])
        if gap > 0.0:
            squared += gap * gap
    return math.sqrt(squared)


@kernel
def _splits_first(one: TimeTree, n: int, other: TimeTree, m: int) -> bool:
    """Whether of two nodes, not both leaves, the first is to be split: the one that takes longer."""
    if 2 * n >= one.span.shape[0]:
        return False
    if 2 * m >= other.span.shape[0]:
        return True
    longer: bool = (
        one.t_s[one.span[n, 1]] - one.t_s[one.span[n, 0]] >= other.t_s[other.span[m, 1]] - other.t_s[other.span[m, 0]]
    )
    return longer


@kernel
def closest_approach(one: TimeTree, other: TimeTree, most_m: float) -> tuple[float, float]:
    """Return the least distance of two motions over the same time, and when; ``most_m`` where it is not less."""
    stack = np.empty((_STACK, 2), dtype=np.int64)
    bounds = np.empty(_STACK)
    best = most_m
    when = one.t_s[0]
    stack[0] = 1
    bounds[0] = 0.0
    size = 1
    while size > 0:
        size -= 1
        n, m = stack[size]
        if bounds[size] >= best - _SAME_M:
            continue
        if 2 * n >= one.span.shape[0] and 2 * m >= other.span.shape[0]:
            distance, t = _closest_in_leaves(one, n, other, m)
            if distance < best:
                best = distance
                when = t
            continue
        first = _splits_first(one, n, other, m)
        early_n, early_m = (2 * n, m) if first else (n, 2 * m)
        late_n, late_m = (2 * n + 1, m) if first else (n, 2 * m + 1)
        early = _apart_at_least(one, early_n, other, early_m)
        late = _apart_at_least(one, late_n, other, late_m)
        for turn in range(2):  # the nearer last, to be looked at first
            if (turn == 0) == (early <= late):
                stack[size, 0], stack[size, 1], bounds[size] = late_n, late_m, late
            else:
                stack[size, 0], stack[size, 1], bounds[size] = early_n, early_m, early
            size += 1
    return best, when


@kernel
def _apart_at_least(one: TimeTree, n: int, other: TimeTree, m: int) -> float:
    """Return a bound of the distance while two nodes last at once; infinite where they never do."""
    i, i_end = one.span[n]
    j, j_end = other.span[m]
    begin = max(one.t_s[i], other.t_s[j])
    end = min(one.t_s[i_end], other.t_s[j_end])
    if begin >= end:
        return math.inf
    straight = math.sqrt(
        _squared_between(one.t_s, one.position_m, i, i_end, other.t_s, other.position_m, j, j_end, begin, end, 0.0)
    )
    bent: float = straight - one.bend_m[n] - other.bend_m[m] - _ROUNDING_M
    return max(bent, _boxes_apart_m(one, n, other, m))


@kernel
def _closest_in_leaves(one: TimeTree, n: int, other: TimeTree, m: int) -> tuple[float, float]:
    """Return the least distance while two leaves last at once, and when: segment by segment."""
    t_a, t_b = one.t_s, other.t_s
    i, i_end = one.span[n]
    j, j_end = other.span[m]
    t = max(t_a[i], t_b[j])
    end = min(t_a[i_end], t_b[j_end])
    best = math.inf
    when = t
    while t < end:
        while t_a[i + 1] <= t:
            i += 1
        while t_b[j + 1] <= t:
            j += 1
        until = min(t_a[i + 1], t_b[j + 1])
        x, y, z = _difference(t_a, one.position_m, i, i + 1, t, t_b, other.position_m, j, j + 1, t)
        dx, dy, dz = _difference(t_a, one.position_m, i, i + 1, until, t_b, other.position_m, j, j + 1, until)
        dx, dy, dz = dx - x, dy - y, dz - z
        length2 = dx * dx + dy * dy + dz * dz
        share = min(1.0, max(0.0, -(x * dx + y * dy + z * dz) / length2)) if length2 > 0.0 else 0.0
        squared = (x + share * dx) ** 2 + (y + share * dy) ** 2 + (z + share * dz) ** 2
        if squared < best:
            best = squared
            when = t + share * (until - t)
        t = until
    return math.sqrt(best), when


@kernel
def _difference(
    t_a: FloatArray, a: FloatArray, i: int, i_end: int, t: float,
    t_b: FloatArray, b: FloatArray, j: int, j_end: int, u: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return one's place at ``t`` minus the other's at ``u``, both in even motion between two of their samples."""
    r = _share(t_a, i, i_end, t)
    s = _share(t_b, j, j_end, u)
    return (
        a[i, 0] + r * (a[i_end, 0] - a[i, 0]) - (b[j, 0] + s * (b[j_end, 0] - b[j, 0])),
        a[i, 1] + r * (a[i_end, 1] - a[i, 1]) - (b[j, 1] + s * (b[j_end, 1] - b[j, 1])),
        a[i, 2] + r * (a[i_end, 2] - a[i, 2]) - (b[j, 2] + s * (b[j_end, 2] - b[j, 2])),
    )


@kernel
def _squared_between(
    t_a: FloatArray, a: FloatArray, i: int, i_end: int,
    t_b: FloatArray, b: FloatArray, j: int, j_end: int, begin: float, end: float, late: float,
) -> float:  # fmt: skip
    """Return the least squared distance while the other's time is ``begin`` to ``end`` and one's ``late`` more."""
    x, y, z = _difference(t_a, a, i, i_end, begin + late, t_b, b, j, j_end, begin)
    dx, dy, dz = _difference(t_a, a, i, i_end, end + late, t_b, b, j, j_end, end)
    dx, dy, dz = dx - x, dy - y, dz - z
    length2 = dx * dx + dy * dy + dz * dz
    share = min(1.0, max(0.0, -(x * dx + y * dy + z * dz) / length2)) if length2 > 0.0 else 0.0
    x, y, z = x + share * dx, y + share * dy, z + share * dz
    return x * x + y * y + z * z


@kernel
def _least_lateness(one: TimeTree, other: TimeTree, required_m: float, limit_s: float) -> float:
    """Return a lower bound, to the tolerance, of :func:`lateness_slack`: branch and bound over pairs of parts."""
    stack = np.empty((_STACK, 2), dtype=np.int64)
    bounds = np.empty(_STACK)
    apart = required_m - _TOUCH_M
    enough = limit_s  # what is known to be at least this late need not be looked at
    proven: float = limit_s
    stack[0] = 1
    bounds[0] = 0.0
    size = 1
    while size > 0:
        size -= 1
        n, m = stack[size]
        if bounds[size] >= enough:
            proven = min(proven, bounds[size])
            continue
        if 2 * n >= one.span.shape[0] and 2 * m >= other.span.shape[0]:
            for i in range(one.span[n, 0], one.span[n, 1]):
                for j in range(other.span[m, 0], other.span[m, 1]):
                    least, most = _lateness_between(one, i, i + 1, other, j, j + 1, apart, enough)
                    proven = min(proven, least)
                    enough = min(enough, max(0.0, most - _LATENESS_TOLERANCE_S))
            continue
        first = _splits_first(one, n, other, m)
        left_n, left_m = (2 * n, m) if first else (n, 2 * m)
        right_n, right_m = (2 * n + 1, m) if first else (n, 2 * m + 1)
        left = _late_at_least(one, left_n, other, left_m, apart, enough)
        right = _late_at_least(one, right_n, other, right_m, apart, enough)
        for turn in range(2):  # the less late last, to be looked at first
            if (turn == 0) == (left <= right):
                stack[size, 0], stack[size, 1], bounds[size] = right_n, right_m, right
            else:
                stack[size, 0], stack[size, 1], bounds[size] = left_n, left_m, left
            size += 1
    return proven


@kernel
def _late_at_least(one: TimeTree, n: int, other: TimeTree, m: int, apart: float, enough: float) -> float:
    """Return a bound of how late one must be to meet the other, each within its node; infinite where they never do."""
    i, i_end = one.span[n]
    j, j_end = other.span[m]
    if i == i_end or j == j_end or _boxes_apart_m(one, n, other, m) >= apart:
        return math.inf
    within = apart + one.bend_m[n] + other.bend_m[m] + _ROUNDING_M
    return _lateness_between(one, i, i_end, other, j, j_end, within, enough)[0]


@kernel
def _lateness_between(
    one: TimeTree, i: int, i_end: int, other: TimeTree, j: int, j_end: int, apart: float, enough: float
) -> tuple[float, float]:
    """Return bounds of the least ``|t - u|`` at which two even motions between samples are less than ``apart``.

    The times (t, u) at which they are too close are a convex set, and so are their differences an interval: it is met
    first on the way from the difference nearest to 0 to that of their closest places. Infinite where it is empty, and
    a lower bound alone where that is ``enough``.
    """
    t_a, a, t_b, b = one.t_s, one.position_m, other.t_s, other.position_m
    low = min(max(0.0, t_a[i] - t_b[j_end]), t_a[i_end] - t_b[j])
    if abs(low) >= enough:
        return abs(low), math.inf
    squared, high = _closest_chords(t_a, a, i, i_end, t_b, b, j, j_end)
    if squared >= apart * apart or apart <= 0.0:
        return math.inf, math.inf
    begin = max(t_b[j], t_a[i] - low)
    end = max(begin, min(t_b[j_end], t_a[i_end] - low))
    if _squared_between(t_a, a, i, i_end, t_b, b, j, j_end, begin, end, low) < apart * apart:
        return abs(low), abs(low)
    while abs(high - low) > _BRACKET_S:
        late = 0.5 * (low + high)
        begin = max(t_b[j], t_a[i] - late)
        end = max(begin, min(t_b[j_end], t_a[i_end] - late))
        if _squared_between(t_a, a, i, i_end, t_b, b, j, j_end, begin, end, late) < apart * apart:
            high = late
        else:
            low = late
    return abs(low), abs(high)


@kernel
def _closest_chords(
    t_a: FloatArray, a: FloatArray, i: int, i_end: int, t_b: FloatArray, b: FloatArray, j: int, j_end: int
) -> tuple[float, float]:
    """Return the least squared distance of two straight pieces, and how much later one is there than the other."""
    ux, uy, uz = a[i_end, 0] - a[i, 0], a[i_end, 1] - a[i, 1], a[i_end, 2] - a[i, 2]
    vx, vy, vz = b[j_end, 0] - b[j, 0], b[j_end, 1] - b[j, 1], b[j_end, 2] - b[j, 2]
    wx, wy, wz = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    uw = ux * wx + uy * wy + uz * wz
    vw = vx * wx + vy * wy + vz * wz
    best = math.inf
    late = 0.0
    crossing = uu * vv - uv * uv
    for side in range(5):  # the closest places: within both pieces, or at an end of one of them
        if side == 4:
            if crossing <= 0.0:
                break
            r = min(1.0, max(0.0, (uv * vw - uw * vv) / crossing))
            s = min(1.0, max(0.0, (uu * vw - uv * uw) / crossing))
        elif side < 2:
            r = float(side)
            s = min(1.0, max(0.0, (vw + r * uv) / vv)) if vv > 0.0 else 0.0
        else:
            s = float(side - 2)
            r = min(1.0, max(0.0, (s * uv - uw) / uu)) if uu > 0.0 else 0.0
        x, y, z = wx + r * ux - s * vx, wy + r * uy - s * vy, wz + r * uz - s * vz
        squared = x * x + y * y + z * z
        if squared < best:
            best = squared
            late = t_a[i] + r * (t_a[i_end] - t_a[i]) - t_b[j] - s * (t_b[j_end] - t_b[j])
    return best, late
