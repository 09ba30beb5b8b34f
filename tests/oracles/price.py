"""The price of paths in plain NumPy and SciPy: slow, obvious, and written from the definitions, not from the kernel.

Vectorised over the points of a path, a plain loop over paths and solids. Every point is looked at.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from missionplanner.clearance import Margins
from missionplanner.cost import TERMS
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import (
    CABLE,
    CONE,
    CURTAIN,
    CYLINDER,
    MARINE,
    PRISM,
    ObstacleArrays,
    SpaceArrays,
    TerrainArrays,
)
from missionplanner.vehicle import VehicleLimits


def keys_kernel(t: FloatArray) -> FloatArray:
    """Cubic convolution, Keys 1981 eq. 15 with a = -1/2."""
    a, t = -0.5, np.abs(t)
    near = (a + 2) * t**3 - (a + 3) * t**2 + 1
    far = a * t**3 - 5 * a * t**2 + 8 * a * t - 4 * a
    return np.where(t <= 1, near, np.where(t < 2, far, 0.0))


def cells(terrain: TerrainArrays, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    u, v = xy[..., 0] / 1e4, xy[..., 1] / 1e4
    monomials = np.stack([np.ones_like(u), u, v, u**2, u * v, v**2, u**3, u**2 * v, u * v**2, v**3])
    row, col = np.tensordot(terrain.to_cell, monomials, axes=1)
    return row, col


def terrain_heights(terrain: TerrainArrays, xy: FloatArray) -> FloatArray:
    row, col = cells(terrain, xy)
    rows, cols = terrain.height_amsl_m.shape
    known = (row >= 1) & (row < rows - 2) & (col >= 1) & (col < cols - 2)
    i, j = np.floor(np.where(known, row, 1)).astype(int), np.floor(np.where(known, col, 1)).astype(int)
    height = np.zeros(row.shape)
    for di in range(-1, 3):
        for dj in range(-1, 3):
            weight = keys_kernel(row - (i + di)) * keys_kernel(col - (j + dj))
            height = height + weight * terrain.height_amsl_m[i + di, j + dj].astype(float)
    return np.where(known, height, np.nan)


def segment_distance(points: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Distance from points (..., D) to the segment a-b."""
    e = b - a
    ee = float(e @ e)
    s = np.clip((points - a) @ e / ee, 0, 1) if ee > 0 else np.zeros(points.shape[:-1])
    return np.linalg.norm(points - a - s[..., None] * e, axis=-1)


def inside_polygon(xy: FloatArray, polygon: FloatArray) -> FloatArray:
    """Winding number of the polygon around each point is not zero."""
    angle = np.zeros(xy.shape[:-1])
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        p, q = a - xy, b - xy
        angle += np.arctan2(p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0], (p * q).sum(axis=-1))
    return np.abs(angle) > math.pi


def polygon_distance(xy: FloatArray, polygon: FloatArray) -> FloatArray:
    edges = zip(polygon, np.roll(polygon, -1, axis=0), strict=True)
    distance = np.min([segment_distance(xy, a, b) for a, b in edges], axis=0)
    return np.where(inside_polygon(xy, polygon), -distance, distance)


def solid_distance(o: ObstacleArrays, i: int, points: FloatArray) -> FloatArray:
    """Signed distance from points (..., 3) to solid i, negative inside."""
    p = o.params[i]
    if o.kind[i] == CABLE:
        return segment_distance(points, p[0:3], p[3:6]) - p[6]
    if o.kind[i] == CURTAIN:  # a polygon in its own plane, as deep as no point is, thickened
        length = np.linalg.norm(p[3:5] - p[0:2])
        along = (points[..., :2] - p[:2]) @ (p[3:5] - p[0:2]) / length
        aside = np.linalg.norm(points[..., :2] - p[:2] - along[..., None] * (p[3:5] - p[0:2]) / length, axis=-1)
        bottom = min(p[2], p[5], float(points[..., 2].min())) - 1e4
        outline = np.array([[0.0, p[2]], [length, p[5]], [length, bottom], [0.0, bottom]])
        off = polygon_distance(np.stack([along, points[..., 2]], axis=-1), outline)
        return np.hypot(np.maximum(off, 0.0), aside) - p[6]
    if o.kind[i] == PRISM:
        across = polygon_distance(points[..., :2], o.vertices[o.vertex_start[i] : o.vertex_start[i + 1]])
        along = np.maximum(p[0] - points[..., 2], points[..., 2] - p[1])
    else:
        rho = np.linalg.norm(points[..., :2] - p[:2], axis=-1)
        if o.kind[i] == CONE:
            radius, base, height = p[2], p[3], p[4]
            profile = np.stack([rho, points[..., 2]], axis=-1)
            triangle = np.array([[-radius, base], [radius, base], [0.0, base + height]])
            return polygon_distance(profile, triangle)
        if o.kind[i] != CYLINDER:
            return np.sqrt(rho**2 + (points[..., 2] - p[2]) ** 2) - p[3]
        across, along = rho - p[2], points[..., 2] - p[3]
    outside = np.hypot(np.maximum(across, 0), np.maximum(along, 0))
    return np.where((across <= 0) & (along <= 0), np.maximum(across, along), outside)


def inside_distance(space: SpaceArrays, points: FloatArray) -> FloatArray:
    west, south, east, north = space.area
    x, y, z = np.moveaxis(points, -1, 0)
    distance = np.min([x - west, east - x, y - south, north - y], axis=0)
    if len(space.fence):
        distance = np.minimum(distance, -polygon_distance(points[..., :2], space.fence))
        distance = np.minimum(distance, space.fence_top_amsl_m - z)
    return distance


def refined(path: FloatArray, pieces: npt.NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """Return the path with every leg cut into its number of equal pieces, and the trapezoidal rule's weights."""
    step = np.diff(path, axis=0)
    leg = np.repeat(np.arange(len(pieces)), pieces)
    share = (np.arange(len(leg)) - (np.cumsum(pieces) - pieces)[leg] + 1) / pieces[leg]
    points = np.concatenate([path[:1], path[leg] + share[:, None] * step[leg]])
    length = (np.linalg.norm(step, axis=1) / pieces)[leg]
    return points, (np.append(length, 0.0) + np.append(0.0, length)) / 2


def price_terms(
    paths: FloatArray,
    space: SpaceArrays,
    limits: VehicleLimits,
    route_length_m: float,
    tower_tops: FloatArray,
    tower_weights: FloatArray,
    tower_range_m: float,
    fellows: FloatArray,
    separation_m: float,
    clearance_extra_m: float = 0.0,
) -> dict[str, FloatArray]:
    rows = [
        _one(
            path,
            space,
            limits,
            route_length_m,
            tower_tops,
            tower_weights,
            tower_range_m,
            fellows,
            separation_m,
            Margins.of(limits, clearance_extra_m),
        )
        for path in paths
    ]
    return {name: np.array([row[name] for row in rows]) for name in TERMS}


def _one(
    path: FloatArray,
    space: SpaceArrays,
    limits: VehicleLimits,
    route_m: float,
    tower_tops: FloatArray,
    tower_weights: FloatArray,
    tower_range_m: float,
    fellows: FloatArray,
    separation_m: float,
    margins: Margins,
) -> dict[str, float]:
    step = np.diff(path, axis=0)
    hop = np.linalg.norm(step, axis=1)
    level = np.hypot(step[:, 0], step[:, 1])
    unit = step / hop[:, None]
    terms = dict.fromkeys(TERMS, 0.0)
    terms["voyage"] = hop.sum() / route_m
    terms["smooth"] = (np.sum(np.diff(unit, axis=0) ** 2, axis=1) / ((hop[:-1] + hop[1:]) / 2)).sum() * 400 / route_m
    z2 = (path[:, 2] / 1000) ** 2
    terms["atmosphere"] = np.sum(hop * (z2[:-1] + z2[1:]) / 2) / route_m
    terms["climb"] = step[:, 2].clip(0).sum() / route_m
    up, down = math.tan(limits.climb_angle_rad), math.tan(limits.descent_angle_rad)
    terms["climb_angle"] = (
        np.maximum(0, np.maximum(step[:, 2] - up * level, -step[:, 2] - down * level)).sum() / route_m
    )

    course = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs((np.diff(course) + math.pi) % (2 * math.pi) - math.pi)
    allowed = np.full(turn.shape, limits.turn_angle_rad)
    if limits.turn_radius_m > 0:
        allowed = np.minimum(allowed, (level[:-1] + level[1:]) / 2 / limits.turn_radius_m)
    terms["turn"] = np.maximum(0, turn - allowed).sum() / math.pi

    terms |= _heights(path, hop, space, margins, route_m)

    def depth_integral(distance, reach, round_m, power):
        pieces = np.maximum(1, np.ceil(hop / max(0.5, math.sqrt(0.8 * round_m)))).astype(int)
        points, weight = refined(path, pieces)
        return float(np.sum(weight * np.maximum(0, reach - distance(points)) ** power))

    o, reach = space.obstacles, margins.obstacle_m
    for i, kind in enumerate(o.kind):

        def distance(points, i=i):
            return solid_distance(o, i, points)

        if o.hard[i]:
            name = {CONE: "collision", MARINE: "ocean"}.get(kind, "obstacle")
            terms[name] += depth_integral(distance, reach, reach, 1) / max(1, reach) / route_m
        else:
            radius = o.params[i, 3]
            terms["radar"] += depth_integral(distance, 0.0, radius, 2) / radius**2 / route_m
    fence_m = margins.fence_m
    terms["fence"] = (
        depth_integral(lambda points: inside_distance(space, points), fence_m, fence_m, 1) / max(1, fence_m) / route_m
    )

    if len(tower_tops) and tower_weights.sum() > 0:
        legs = list(pairwise(path))
        nearest = np.min([segment_distance(tower_tops, a, b) for a, b in legs], axis=0)
        off = np.maximum(0, nearest - tower_range_m) / tower_range_m
        terms["inspection"] = float(np.sum(tower_weights * off / (1 + off)) / tower_weights.sum())
    if len(fellows) and separation_m > 0:
        terms["fellows"] = _fellows(path, hop, fellows, separation_m)
    return terms


def _heights(
    path: FloatArray, hop: FloatArray, space: SpaceArrays, margins: Margins, route_m: float
) -> dict[str, float]:
    terrain = space.terrain
    cell_m = 1e4 / math.sqrt(abs(np.linalg.det(terrain.to_cell[:, 1:3])))

    def judge(points):
        ground = terrain_heights(terrain, points[:, :2])
        row, col = cells(terrain, points[:, :2])
        rows, cols = terrain.height_amsl_m.shape
        out = np.hypot(
            np.maximum(0, np.maximum(1 - row, row - (rows - 2))), np.maximum(0, np.maximum(1 - col, col - (cols - 2)))
        )
        height = points[:, 2] - ground
        missing = np.isnan(ground)
        under = np.where(missing, 100.0 + cell_m * out, np.maximum(0, margins.height_agl_min_m - height))
        over = np.maximum(0, points[:, 2] - margins.alt_amsl_max_m)
        over = np.where(missing, over, np.maximum(over, height - margins.height_agl_max_m))
        slack = np.minimum(height - margins.height_agl_min_m, margins.height_agl_max_m - height)
        return under, over, np.where(missing, -np.inf, slack)

    slack = judge(path)[2]
    near = slack[:-1] + slack[1:] < 2 * hop
    pieces = np.where(near, np.maximum(1, np.ceil(2 * hop / cell_m)), 1).astype(int)
    points, weight = refined(path, pieces)
    under, over, _ = judge(points)
    scale = max(1, margins.height_agl_min_m) * route_m
    return {"terrain": float(np.sum(weight * under)) / scale, "ceiling": float(np.sum(weight * over)) / scale}


def _fellows(path: FloatArray, hop: FloatArray, fellows: FloatArray, separation_m: float) -> float:
    """Mean depth within the separation, by Gauss-Legendre between the places where the depth begins, kinks and ends."""
    instants = fellows.shape[1]
    along = np.concatenate([[0.0], np.cumsum(hop)])
    at = np.linspace(0, along[-1], instants)
    own = np.stack([np.interp(at, along, path[:, k]) for k in range(3)], axis=1)
    apart = own - fellows
    r, v = apart[:, :-1].reshape(-1, 3), np.diff(apart, axis=1).reshape(-1, 3)
    vv = np.maximum(np.sum(v * v, axis=1), 1e-30)
    closest = -np.sum(r * v, axis=1) / vv
    half = np.sqrt(np.maximum(0, closest**2 - (np.sum(r * r, axis=1) - separation_m**2) / vv))
    zero, one = np.zeros_like(closest), np.ones_like(closest)
    cuts = np.clip(np.stack([zero, closest - half, closest, closest + half, one], axis=1), 0, 1)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for low, high in pairwise(cuts.T):
        s = low[:, None] + (high - low)[:, None] * (nodes + 1) / 2
        depth = np.maximum(0, separation_m - np.linalg.norm(r[:, None] + s[:, :, None] * v[:, None], axis=2))
        total += float(np.sum((high - low) / 2 * (depth @ weights)))
    return total / ((instants - 1) * separation_m)
