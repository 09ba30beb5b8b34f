"""The shortest way among discs, exactly: the tangent visibility graph, in plain Python, nothing of the planner's in it.

Such a way is a chain of straight pieces that touch discs and of arcs on their rims (Chew 1985,
doi:10.1145/323233.323251). Upright cylinders without top are discs seen from above: over them the way climbs evenly.
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from collections.abc import Sequence

Point = tuple[float, float]
Disc = tuple[float, float, float]
_TOUCH_M = 1e-9


def shortest_m(start: Point, goal: Point, discs: Sequence[Disc]) -> float:
    """Return the length of the shortest way from start to goal outside all open discs; inf if there is none."""
    ends = [start, goal]
    rims: dict[int, list[tuple[float, int]]] = defaultdict(list)  # disc -> angle and node of each point on its rim
    edges: dict[int, list[tuple[int, float]]] = defaultdict(list)
    count = 2

    def node(disc: int | None, angle: float, end: int) -> int:
        nonlocal count
        if disc is None:
            return end
        rims[disc].append((angle % math.tau, count))
        count += 1
        return count - 1

    def join(a: int, b: int, length: float) -> None:
        edges[a].append((b, length))
        edges[b].append((a, length))

    round_things: list[tuple[float, float, float, int | None, int]] = [
        (*ends[0], 0.0, None, 0),
        (*ends[1], 0.0, None, 1),
        *((*disc, i, -1) for i, disc in enumerate(discs)),
    ]
    for n, (x1, y1, r1, i, end1) in enumerate(round_things):
        for x2, y2, r2, j, end2 in round_things[n + 1 :]:
            apart = math.hypot(x2 - x1, y2 - y1)
            for side1 in (1.0, -1.0) if r1 else (1.0,):
                for side2 in (1.0, -1.0) if r2 else (1.0,):
                    lean = side1 * r1 - side2 * r2  # of the common tangent that has both centres on these sides
                    if apart <= abs(lean) or apart == 0.0:
                        continue
                    normal = math.atan2(y2 - y1, x2 - x1) + math.acos(lean / apart)
                    c, s = math.cos(normal), math.sin(normal)
                    a = (x1 + side1 * r1 * c, y1 + side1 * r1 * s)
                    b = (x2 + side2 * r2 * c, y2 + side2 * r2 * s)
                    if all(_distance(disc[:2], a, b) >= disc[2] - _TOUCH_M for disc in discs):
                        turns = [normal + (0.0 if side > 0.0 else math.pi) for side in (side1, side2)]
                        join(node(i, turns[0], end1), node(j, turns[1], end2), math.dist(a, b))
    for i, rim in rims.items():
        rim.sort()
        radius = discs[i][2]
        blocked = [_covered(discs[i], other) for k, other in enumerate(discs) if k != i]
        for n, (angle, a) in enumerate(rim):
            after, b = rim[(n + 1) % len(rim)]
            width = (after - angle) % math.tau
            if a != b and not any(_overlap(angle, width, *arc) for arc in blocked if arc is not None):
                join(a, b, radius * width)
    return _dijkstra(edges)


def _distance(p: Point, a: Point, b: Point) -> float:
    ex, ey = b[0] - a[0], b[1] - a[1]
    square = ex * ex + ey * ey
    s = ((p[0] - a[0]) * ex + (p[1] - a[1]) * ey) / square if square else 0.0
    s = min(1.0, max(0.0, s))
    return math.hypot(a[0] + s * ex - p[0], a[1] + s * ey - p[1])


def _covered(disc: Disc, other: Disc) -> tuple[float, float] | None:
    """Return where the arc of a disc's rim within another disc begins, and its width; None: there is none."""
    apart = math.hypot(other[0] - disc[0], other[1] - disc[1])
    if apart >= disc[2] + other[2] or apart + other[2] <= disc[2]:
        return None
    if apart + disc[2] <= other[2]:
        return 0.0, math.tau
    half = math.acos((apart**2 + disc[2] ** 2 - other[2] ** 2) / (2.0 * apart * disc[2]))
    return (math.atan2(other[1] - disc[1], other[0] - disc[0]) - half) % math.tau, 2.0 * half


def _overlap(first: float, width: float, other: float, other_width: float) -> bool:
    return (other - first) % math.tau < width - _TOUCH_M or (first - other) % math.tau < other_width - _TOUCH_M


def _dijkstra(edges: dict[int, list[tuple[int, float]]]) -> float:
    best = {0: 0.0}
    queue = [(0.0, 0)]
    while queue:
        length, a = heapq.heappop(queue)
        if a == 1:
            return length
        if length > best[a]:
            continue
        for b, more in edges[a]:
            if length + more < best.get(b, math.inf):
                best[b] = length + more
                heapq.heappush(queue, (length + more, b))
    return math.inf
