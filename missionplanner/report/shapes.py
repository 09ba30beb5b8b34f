"""The obstacles as shapes to draw: outlines for the map, facets for the view in space."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np

from missionplanner import kernels
from missionplanner.geodesy import FloatArray
from missionplanner.scene import Scene
from missionplanner.spans import Conductor

_ROUND = np.linspace(0.0, 2.0 * math.pi, 49)
_KIND_NAMES = {
    kernels.CYLINDER: "cylinder",
    kernels.CONE: "cone",
    kernels.RADAR: "radar",
    kernels.MARINE: "marine",
    kernels.PRISM: "no_fly",
    kernels.CABLE: "cable",
}
HANGING = ("cable", "conductor", "line")
"""Kinds that are lines; all but the first with the room below them, down to the ground."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """One obstacle: its outline from above and its range of heights (AMSL; inf and -inf: without limit).

    Kinds are those of the mission file; tower and conductor (a span) of lines to inspect; support and line (a span)
    of others.
    """

    name: str
    kind: str  # cylinder, cone, radar, marine, no_fly, cable, or below
    hard: bool
    outline_m: FloatArray  # (K, 2), closed; what hangs: seen from above
    radius_m: float  # of a round one, or of what hangs
    low_m: float
    high_m: float
    axis_m: FloatArray  # (2, 3): centre at low and high; what hangs: (K, 3) along it

    @property
    def centre_m(self) -> FloatArray:
        """Middle of the outline (2,)."""
        return np.asarray((self.outline_m.min(axis=0) + self.outline_m.max(axis=0)) / 2)


def shapes(scene: Scene) -> tuple[Shape, ...]:
    """Return every obstacle of the scene, in order: solids, then what hangs between supports, span by span."""
    declared = {obstacle.name: obstacle.kind for obstacle in scene.mission.obstacles}
    arrays, names = scene.obstacles.arrays, scene.obstacles.names
    solids = [
        _shape(scene, i, names[i], declared.get(names[i]))
        for i in np.flatnonzero(arrays.kind != kernels.CURTAIN).tolist()
    ]
    return (*solids, *(_span(conductor, conductor.name in declared) for conductor in scene.conductors))


def _span(conductor: Conductor, other: bool) -> Shape:
    curve = conductor.catenary.chords_m()
    kind, high = "line" if other else "conductor", float(curve[:, 2].max())
    return Shape(conductor.name, kind, True, curve[:, :2], conductor.radius_m, -math.inf, high, curve)


def _shape(scene: Scene, i: int, name: str, declared: str | None) -> Shape:
    arrays = scene.obstacles.arrays
    p, hard = arrays.params[i], bool(arrays.hard[i])
    kind = _KIND_NAMES[int(arrays.kind[i])]
    if kind == "cable":
        ends = np.array([p[0:3], p[3:6]])
        low, high = float(ends[:, 2].min()), float(ends[:, 2].max())
        return Shape(name, kind, hard, ends[:, :2], float(p[6]), low, high, ends)
    if kind == "no_fly":
        corners = arrays.vertices[arrays.vertex_start[i] : arrays.vertex_start[i + 1]]
        outline = np.concatenate([corners, corners[:1]])
        centre = corners.mean(axis=0)
        axis = np.array([[*centre, p[0]], [*centre, p[1]]])
        return Shape(name, kind, hard, outline, 0.0, float(p[0]), float(p[1]), axis)
    if kind == "cylinder":
        radius, low, high = float(p[2]), -math.inf, float(p[3])
        kind = {"cylinder": kind, "line": "support"}.get(declared or "", "tower")
    elif kind == "cone":
        radius, low, high = float(p[2]), float(p[3]), float(p[3] + p[4])
    else:
        radius, low, high = float(p[3]), float(p[2] - p[3]), float(p[2] + p[3])
    outline = p[:2] + radius * np.stack([np.cos(_ROUND), np.sin(_ROUND)], axis=-1)
    return Shape(name, kind, hard, outline, radius, low, high, np.array([[p[0], p[1], low], [p[0], p[1], high]]))


def vertical_range(shape: Shape, xy_m: FloatArray, around_m: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest altitude (N,) that the shape, ``around_m`` thicker, takes above places (N, 2).

    NaN where it takes none. The thickening of a cone is drawn a little too large.
    """
    if shape.kind in HANGING:
        pieces = [_cable_range(a, b, xy_m, shape.radius_m + around_m) for a, b in itertools.pairwise(shape.axis_m)]
        bottom, top = np.fmin.reduce([low for low, _ in pieces]), np.fmax.reduce([high for _, high in pieces])
        return bottom if shape.kind == "cable" else np.where(np.isnan(top), top, -math.inf), top
    if shape.kind == "no_fly":
        corners = np.ascontiguousarray(shape.outline_m[:-1])
        out = np.array([kernels.polygon_distance(corners, 0, len(corners), x, y) for x, y in xy_m])
    else:
        out = np.hypot(*(xy_m - shape.centre_m).T) - shape.radius_m
    reach = np.where(out <= around_m, 0.0, np.nan)
    if shape.kind in ("radar", "marine"):
        middle = (shape.low_m + shape.high_m) / 2
        half = np.sqrt(np.maximum((shape.radius_m + around_m) ** 2 - (out + shape.radius_m) ** 2, 0.0)) + reach
        return middle - half, middle + half
    beyond = np.sqrt(np.maximum(around_m**2 - np.maximum(out, 0.0) ** 2, 0.0)) + reach
    if shape.kind == "cone":
        share = np.clip(-(out - around_m) / shape.radius_m, 0.0, 1.0)
        return shape.low_m - beyond, shape.low_m + share * (shape.high_m - shape.low_m) + beyond
    return shape.low_m - beyond, shape.high_m + beyond


def facets(shape: Shape, ground_amsl_m: float, cap_amsl_m: float) -> list[FloatArray]:
    """Return a solid's surface as polygons, counter-clockwise from outside, in stacks (F, N, 3) of equal corners.

    Cut at the ground and, where the solid is higher, at a cap.
    """
    if shape.kind in ("radar", "marine"):
        return [_sphere_facets(shape)]
    low, high = max(shape.low_m, ground_amsl_m), min(shape.high_m, cap_amsl_m)
    if high <= low:
        return []
    outline = shape.outline_m
    if _area_m2(outline) < 0.0:
        outline = outline[::-1]
    if shape.kind == "cone":
        top = shape.centre_m + (outline - shape.centre_m) * (1.0 - (high - shape.low_m) / (shape.high_m - shape.low_m))
        outline = shape.centre_m + (outline - shape.centre_m) * (
            1.0 - (low - shape.low_m) / (shape.high_m - shape.low_m)
        )
        shares = np.linspace(0.0, 1.0, 13)
    else:
        size_m = float(np.ptp(outline, axis=0).max()) / 16
        top = outline = _refined(outline, size_m)
        shares = np.linspace(0.0, 1.0, int(np.clip((high - low) / size_m, 1, 12)) + 1)
    rings = np.stack(
        [
            np.column_stack([outline + u * (top - outline), np.full(len(outline), low + u * (high - low))])
            for u in shares
        ]
    )
    walls = np.stack([rings[:-1, :-1], rings[:-1, 1:], rings[1:, 1:], rings[1:, :-1]], axis=2).reshape(-1, 4, 3)
    return [walls, rings[-1:, :-1]]


def _refined(outline_m: FloatArray, size_m: float) -> FloatArray:
    """Return a closed outline with corners at most ``size_m`` apart."""
    sides = [
        np.linspace(a, b, max(1, math.ceil(math.dist(a, b) / size_m)), endpoint=False)
        for a, b in itertools.pairwise(outline_m)
    ]
    return np.concatenate([*sides, outline_m[-1:]])


def _cable_range(
    begin: FloatArray, end: FloatArray, xy_m: FloatArray, radius_m: float
) -> tuple[FloatArray, FloatArray]:
    step = end - begin
    run2 = max(float(step[:2] @ step[:2]), 1e-9)
    share = np.clip((xy_m - begin[:2]) @ step[:2] / run2, 0.0, 1.0)
    nearest = begin + share[:, None] * step
    out = np.hypot(*(xy_m - nearest[:, :2]).T)
    slant = math.hypot(1.0, step[2] / math.sqrt(run2))
    half = np.sqrt(np.maximum(radius_m**2 - out**2, 0.0)) * slant + np.where(out <= radius_m, 0.0, np.nan)
    return nearest[:, 2] - half, nearest[:, 2] + half


def _sphere_facets(shape: Shape) -> FloatArray:
    x, y, z = shape.axis_m.mean(axis=0)
    turn, tilt = np.meshgrid(np.linspace(0.0, 2.0 * math.pi, 97), np.linspace(-math.pi / 2, math.pi / 2, 49))
    r = shape.radius_m
    grid = np.stack(
        [x + r * np.cos(tilt) * np.cos(turn), y + r * np.cos(tilt) * np.sin(turn), z + r * np.sin(tilt)], -1
    )
    quads = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)
    return quads.reshape(-1, 4, 3)


def _area_m2(ring: FloatArray) -> float:
    return float((ring[:-1, 0] * ring[1:, 1] - ring[1:, 0] * ring[:-1, 1]).sum()) / 2
