"""The view in space: the ground as a block seen obliquely from above, with obstacles and paths over it.

The ground is drawn pixel by pixel, column by column, front to back (a height field needs no more), which also says
exactly what it hides; everything else is projected and drawn over it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from scipy.ndimage import map_coordinates

from missionplanner.geodesy import FloatArray
from missionplanner.report import style
from missionplanner.report.facts import Course, Sketch
from missionplanner.report.labels import Labels
from missionplanner.report.maps import fence_sides, map_box, named, overlaps, within
from missionplanner.report.relief import Box, Ground, relief_colours, sample_ground
from missionplanner.report.shapes import HANGING, Shape, facets

_VIEWS = {"south-south-west": 24.0, "south-south-east": -24.0, "west-south-west": 60.0, "east-south-east": -60.0}
_ELEVATION_RAD = math.radians(38.0)
_COLUMNS = 1440
_DEPTHS = 900
_GROUND_CELLS = 420
_SKIRTS = ((168, 153, 133), (194, 181, 161))
_WALL_ALPHA = 0.16  # of the room below conductors
_LIGHT = np.array([-0.6, -0.25, 0.75])


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    """An orthographic view of a ground block; screen positions are metres right of and above the block's middle."""

    stands: str  # where the viewer stands
    middle_m: FloatArray  # (2,)
    base_m: float  # altitude of the block's foot
    exaggeration: float

    def turn(self, positions_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how far right (...) and how far away (...) positions (..., 2 or 3) are."""
        x, y = positions_m[..., 0] - self.middle_m[0], positions_m[..., 1] - self.middle_m[1]
        sin, cos = self.sin_cos
        return x * cos - y * sin, x * sin + y * cos

    @property
    def sin_cos(self) -> tuple[float, float]:
        """Sine and cosine of the bearing of the view."""
        bearing_rad = math.radians(_VIEWS[self.stands])
        return math.sin(bearing_rad), math.cos(bearing_rad)

    def up(self, away_m: FloatArray, z_m: FloatArray) -> FloatArray:
        """Return the height on the screen of points this far away and at these altitudes."""
        lifted = (z_m - self.base_m) * self.exaggeration
        return away_m * math.sin(_ELEVATION_RAD) + lifted * math.cos(_ELEVATION_RAD)

    def project(self, positions_m: FloatArray) -> FloatArray:
        """Return screen positions (..., 2) of positions (..., 3)."""
        right, away = self.turn(positions_m)
        return np.stack([right, self.up(away, positions_m[..., 2])], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """The drawn ground: its picture, and per column of the picture how high the ground in front of a depth reaches."""

    camera: _Camera
    box: Box
    front_m: float  # how far right the nearest corner is
    right_m: FloatArray  # (C,)
    near_m: FloatArray  # (C,) where a column enters the block
    far_m: FloatArray
    horizon_m: FloatArray  # (D, C): highest screen position up to that depth
    image: npt.NDArray[np.uint8]  # (H, C, 4)
    screen: tuple[float, float, float, float]  # left, right, bottom, top

    def visible(self, positions_m: FloatArray) -> npt.NDArray[np.bool_]:
        """Return which of positions (..., 3) no ground hides."""
        right, away = self.camera.turn(positions_m)
        depths, columns = self.horizon_m.shape
        step = self.right_m[1] - self.right_m[0]
        column = np.clip(np.round((right - self.right_m[0]) / step).astype(int), 0, columns - 1)
        near, far = self.near_m[column], self.far_m[column]
        depth = np.floor((away - near) / np.maximum(far - near, 1e-9) * (depths - 1)).astype(int) - 2
        horizon = self.horizon_m[np.clip(depth, 0, depths - 1), column]
        return np.asarray((depth < 0) | (self.camera.up(away, positions_m[..., 2]) >= horizon - step))


def space_view(facts: Sketch, shapes: Sequence[Shape]) -> Figure:
    """Draw terrain, obstacles and paths as seen from the air."""
    block, ground = _draw_block(facts, shapes)
    left, right, bottom, top = block.screen
    height_in = style.WIDTH_IN * (top - bottom) / (right - left)
    figure = style.new_figure(height_in)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.imshow(block.image, extent=block.screen, origin="lower", interpolation="bilinear", aspect="auto", zorder=0)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    labels = Labels(axes)
    _draw_fence(axes, facts, block)
    _draw_shapes(axes, facts, block, shapes)
    for v in facts.vehicles:
        _draw_vehicle(axes, facts, block, v)
        labels.avoid_line(block.camera.project(v.path_m))
        for place in block.camera.project(np.array([v.home_m, v.path_m[-1]])):
            labels.avoid_mark(place, 4.5)
    _label(labels, axes, facts, block, shapes)
    _compass(axes, block, ground)
    return figure


def _draw_block(facts: Sketch, shapes: Sequence[Shape]) -> tuple[_Block, Ground]:
    box = map_box(facts, shapes, least_ratio=(0.4, 0.4))
    ground = sample_ground(facts.scene.terrain, box, _GROUND_CELLS)
    sea = any(o.kind == "marine" for o in facts.scene.mission.obstacles)
    colours = relief_colours(ground, sea=sea)
    known = ground.height_amsl_m[np.isfinite(ground.height_amsl_m)]
    low = float(known.min()) if known.size else 0.0
    heights = np.where(np.isfinite(ground.height_amsl_m), ground.height_amsl_m, low)
    west, south, east, north = box
    across = math.hypot(east - west, north - south)
    highest = max(float(heights.max()), *(float(v.path_m[:, 2].max()) for v in facts.vehicles))
    exaggeration = _exaggeration(highest - low, across)
    base = low - 0.035 * across / exaggeration
    cameras = [_Camera(name, np.array([(west + east) / 2, (south + north) / 2]), base, exaggeration) for name in _VIEWS]
    paths = np.concatenate([v.path_m for v in facts.vehicles])
    camera = max(cameras, key=lambda c: round(float(np.ptp(c.turn(paths)[0])), 3))

    corners = np.array([[west, south], [east, south], [east, north], [west, north]])
    right_corner, away_corner = camera.turn(corners)
    right = np.linspace(right_corner.min(), right_corner.max(), _COLUMNS)
    near, far = _block_edges(right_corner, away_corner, right)
    away = near + (far - near) * np.linspace(0.0, 1.0, _DEPTHS)[:, None]
    sin, cos = camera.sin_cos
    x = right * cos + away * sin + camera.middle_m[0]
    y = -right * sin + away * cos + camera.middle_m[1]
    at = [
        (y - south) / (north - south) * (len(ground.y_m) - 1),
        (x - west) / (east - west) * (len(ground.x_m) - 1),
    ]
    screen_up = camera.up(away, map_coordinates(heights, at, order=1, mode="nearest"))
    horizon = np.maximum.accumulate(screen_up, axis=0)

    tallest = [camera.project(v.path_m)[:, 1].max() for v in facts.vehicles]
    cap = _cap_m(facts, base)
    tallest += [
        camera.project(np.column_stack([s.outline_m, np.full(len(s.outline_m), min(s.high_m, cap))]))[:, 1].max()
        for s in shapes
        if overlaps(s.outline_m, box)
    ]
    step = right[1] - right[0]
    bottom = float(camera.up(near, np.array(base)).min()) - 3 * step
    top = max(float(horizon[-1].max()), *map(float, tallest)) + 0.045 * (right[-1] - right[0])
    rows = np.arange(bottom, top, step)
    image = np.zeros((rows.size, _COLUMNS, 4), dtype=np.uint8)
    texture = np.stack([map_coordinates(colours[..., k], at, order=1, mode="nearest") for k in range(3)], axis=-1)
    foot = camera.up(near, np.full(near.shape, base))
    front = int(np.argmin(away_corner))
    for c in range(_COLUMNS):
        first, rise, last = np.searchsorted(rows, [foot[c], horizon[0, c], horizon[-1, c]])
        seen = np.searchsorted(horizon[:, c], rows[rise:last])
        image[rise:last, c, :3] = texture[np.minimum(seen, _DEPTHS - 1), c]
        image[first:rise, c, :3] = _SKIRTS[int(right[c] > right_corner[front])]
        image[first:last, c, 3] = 255
    screen = (float(right[0]), float(right[-1]), bottom, float(rows[-1] + step))
    return _Block(camera, box, float(right_corner[front]), right, near, far, horizon, image, screen), ground


def _exaggeration(relief_m: float, across_m: float) -> float:
    """Return a round factor that keeps heights readable: low relief is stretched, high relief flattened."""
    relief_m = max(relief_m, 1.0)
    stretched = min(max(0.14 * across_m / relief_m, 1.0), 3.0, 0.4 * across_m / relief_m)
    return round(stretched * 2) / 2 if stretched >= 1.0 else max(round(stretched * 20) / 20, 0.05)


def _block_edges(right_corner: FloatArray, away_corner: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the columns enter and leave the rectangle with these corners."""
    near, far = np.full(right.shape, np.inf), np.full(right.shape, -np.inf)
    for i in range(4):
        a, b = sorted((i, (i + 1) % 4), key=lambda k: float(right_corner[k]))
        on = (right >= right_corner[a]) & (right <= right_corner[b])
        away = np.interp(right, right_corner[[a, b]], away_corner[[a, b]])
        near = np.where(on, np.minimum(near, away), near)
        far = np.where(on, np.maximum(far, away), far)
    return near, far


def _draw_fence(axes: Axes, facts: Sketch, block: _Block) -> None:
    """Draw the fence's foot along the ground, where it runs through the block."""
    for side in fence_sides(facts):
        line = within(side, block.box)
        if len(line) > 1:
            foot = np.column_stack([line, facts.scene.terrain.height_amsl_m(line[:, 0], line[:, 1])])
            _draw_line(axes, block, foot, style.FENCE, 1.2, zorder=3, hidden=False)


def _draw_shapes(axes: Axes, facts: Sketch, block: _Block, shapes: Sequence[Shape]) -> None:
    cap = _cap_m(facts, block.camera.base_m)
    polygons: list[tuple[float, FloatArray, tuple[float, ...]]] = []
    for shape in shapes:
        if not overlaps(shape.outline_m, block.box):
            continue
        colour = style.OBSTACLE_COLOURS.get(shape.kind, style.STEEL)
        if shape.kind in HANGING:
            line = within(_finely(shape.axis_m), block.box)
            if len(line) > 1:
                _draw_line(axes, block, line, colour, 1.3 if shape.kind == "cable" else 0.8, zorder=5)
                if shape.kind != "cable":
                    polygons += _wall(facts, block, line, colour)
            continue
        centre = shape.centre_m
        heights = facts.scene.terrain.height_amsl_m(shape.outline_m[:, 0], shape.outline_m[:, 1])
        ground = float(heights.min())
        slim_m = 5e-3 * (block.right_m[-1] - block.right_m[0])
        slim = shape.kind in ("tower", "support")
        if slim or (shape.kind == "cylinder" and shape.radius_m < slim_m):
            stem = np.array([[*centre, ground], [*centre, min(shape.high_m, cap)]])
            _draw_line(axes, block, stem, colour, 1.4 if slim else 2.4, zorder=5)
            continue
        for facet in facets(shape, ground if math.isfinite(ground) else block.camera.base_m, cap):
            polygons += _shaded(facts, block, facet, colour, 0.34 if shape.hard else 0.15)
    polygons.sort(key=lambda entry: -entry[0])
    if polygons:
        collection = PolyCollection(
            [outline for _, outline, _ in polygons], facecolors=[colour for _, _, colour in polygons],
            edgecolors="none", zorder=4,
        )  # fmt: skip
        axes.add_collection(collection)


def _finely(line_m: FloatArray) -> FloatArray:
    """Return a line (K, 3) as many points (N, 3)."""
    at = np.linspace(0.0, len(line_m) - 1.0, 100)
    return np.stack([np.interp(at, np.arange(len(line_m)), line_m[:, k]) for k in range(3)], axis=1)


def _wall(
    facts: Sketch, block: _Block, line_m: FloatArray, colour: str
) -> list[tuple[float, FloatArray, tuple[float, ...]]]:
    """Return depth, outline on the screen and colour of what of the room below a line is seen, from both sides."""
    foot = line_m.copy()
    foot[:, 2] = np.fmin(line_m[:, 2], facts.scene.terrain.height_amsl_m(line_m[:, 0], line_m[:, 1]))
    quads = np.stack([line_m[:-1], line_m[1:], foot[1:], foot[:-1]], axis=1)
    middle = quads.mean(axis=1)
    screen, depth = block.camera.project(quads), block.camera.turn(middle)[1]
    return [(float(depth[i]), screen[i], (*to_rgb(colour), _WALL_ALPHA)) for i in np.flatnonzero(block.visible(middle))]


def _cap_m(facts: Sketch, base_m: float) -> float:
    """Return the altitude at which solids are cut: a little above the highest path."""
    highest = max(float(v.path_m[:, 2].max()) for v in facts.vehicles)
    return highest + 0.12 * (highest - base_m)


def _shaded(
    facts: Sketch, block: _Block, facets_m: FloatArray, colour: str, alpha: float
) -> list[tuple[float, FloatArray, tuple[float, ...]]]:
    """Return depth, outline on the screen and colour of those facets (F, N, 3) that are seen; cut at the ground."""
    ground = facts.scene.terrain.height_amsl_m(facets_m[..., 0], facets_m[..., 1])
    buried = facets_m[..., 2] < ground
    standing = ~buried.all(axis=1)
    facets_m, z = facets_m[standing], np.where(buried, ground, facets_m[..., 2])[standing]
    outline = block.camera.project(facets_m)
    turned = np.roll(outline, -1, axis=1)
    towards = (outline[..., 0] * turned[..., 1] - turned[..., 0] * outline[..., 1]).sum(axis=1) > 0.0
    facets_m = np.concatenate([facets_m[..., :2], z[..., None]], axis=-1)
    screen = block.camera.project(facets_m)
    middle = facets_m.mean(axis=1)
    seen = towards & block.visible(middle)
    normal = np.cross(facets_m[:, 1] - facets_m[:, 0], facets_m[:, 2] - facets_m[:, 0])
    light = 0.78 + 0.3 * (normal @ _LIGHT) / np.maximum(np.linalg.norm(normal, axis=1), 1e-9)
    shades = np.clip(np.array(to_rgb(colour)) * light[:, None] + 0.08, 0.0, 1.0)
    depth = block.camera.turn(middle)[1]
    return [(float(depth[i]), screen[i], (*shades[i], alpha)) for i in np.flatnonzero(seen)]


def _draw_vehicle(axes: Axes, facts: Sketch, block: _Block, v: Course) -> None:
    colour = style.vehicle_colour(v.index)
    path = v.path_m
    below = path.copy()
    below[:, 2] = facts.scene.terrain.height_amsl_m(path[:, 0], path[:, 1])
    seen = block.visible(path) & block.visible(below)
    top, foot = block.camera.project(path), block.camera.project(below)
    both = seen[:-1] & seen[1:]
    curtain = [np.concatenate([a, b[::-1]]) for a, b in zip(_runs(top, both), _runs(foot, both), strict=True)]
    axes.add_collection(PolyCollection(curtain, facecolors=colour, alpha=0.13, edgecolors="none", zorder=6))
    _draw_line(axes, block, below, style.INK, 0.7, zorder=6.1, alpha=0.45, hidden=False)
    home = np.array([v.home_m, path[0]])
    _draw_line(axes, block, home, colour, 1.2, zorder=7)
    _draw_line(axes, block, path, colour, 2.1, zorder=7, casing=True)
    if v.flown:
        track = v.flown.en_route.position_m
        _draw_line(axes, block, track[:: max(1, len(track) // 1500)], style.INK, 0.6, zorder=9, hidden=False)
    places = block.camera.project(np.array([v.home_m, path[-1]]))
    axes.plot(
        *places[0], marker="s", markersize=5, color="white", markeredgecolor=colour, markeredgewidth=1.6, zorder=10
    )
    axes.plot(
        *places[1], marker="o", markersize=7, color=colour, markeredgecolor="white", markeredgewidth=1.1, zorder=10
    )


def _draw_line(
    axes: Axes, block: _Block, line_m: FloatArray, colour: str, width: float, *, zorder: float, alpha: float = 1.0,
    casing: bool = False, hidden: bool = True,
) -> None:  # fmt: skip
    """Draw a line in space: full where it is seen, faint (or not at all) where the ground hides it."""
    screen, seen = block.camera.project(line_m), block.visible(line_m)
    both = seen[:-1] | seen[1:]
    shown = list(_runs(screen, both))
    if casing:
        axes.add_collection(
            LineCollection(shown, colors="white", linewidths=width + 1.5, alpha=0.85, zorder=zorder - 0.1)
        )
    axes.add_collection(LineCollection(shown, colors=colour, linewidths=width, alpha=alpha, zorder=zorder))
    if hidden:
        behind = list(_runs(screen, ~both))
        dots: dict[str, Any] = {"linestyles": [(0, (1.0, 1.4))], "linewidths": 0.8 * width, "alpha": 0.55}
        axes.add_collection(LineCollection(behind, colors=colour, zorder=zorder, **dots))


def _runs(line: FloatArray, keep: npt.NDArray[np.bool_]) -> Iterable[FloatArray]:
    """Yield the pieces of a line (N, 2) whose segments (N - 1,) are kept."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], keep, [False]]).astype(int)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        yield line[begin : end + 1]


def _label(labels: Labels, axes: Axes, facts: Sketch, block: _Block, shapes: Sequence[Shape]) -> None:
    for places, word in (
        (np.array([v.path_m[-1] for v in facts.vehicles]), "goals"),
        (np.array([v.home_m for v in facts.vehicles]), "homes"),
    ):
        labels.place_group(
            [v.name for v in facts.vehicles], [style.vehicle_colour(v.index) for v in facts.vehicles],
            block.camera.project(places), f"{len(places)} {word}",
        )  # fmt: skip
    cap = _cap_m(facts, block.camera.base_m)
    for shape in named(shapes):
        if not overlaps(shape.outline_m, block.box):
            continue
        top = np.array([*shape.centre_m, min(shape.high_m, cap)])
        if block.visible(top):
            colour = style.OBSTACLE_COLOURS.get(shape.kind, style.STEEL)
            labels.place(shape.name, block.camera.project(top), size=7.5, gap_pt=4, color=colour)
    towers = facts.scene.towers
    if towers is not None:
        for i in dict.fromkeys((0, len(towers.names) - 1)):
            labels.place(towers.names[i], block.camera.project(towers.top_m[i]), size=7, color=style.STEEL)


def _compass(axes: Axes, block: _Block, ground: Ground) -> None:
    """Draw where north is, lying on the ground plane in the lower left corner, and say how heights are stretched."""
    left, right, bottom, _ = block.screen
    size = 0.045 * (right - left)
    flat = math.sin(_ELEVATION_RAD)
    sin, cos = block.camera.sin_cos
    turn = np.array([[cos, -sin], [sin, cos]])
    arrow = np.array([[0.0, 1.0], [-0.38, -0.7], [0.0, -0.35], [0.38, -0.7]]) @ turn.T * (size, size * flat)
    middle = np.array([left + 1.4 * size, bottom + 1.6 * size])
    axes.add_patch(Polygon(middle + arrow, facecolor=style.INK, linewidth=0, zorder=20))
    tip = middle + 1.55 * (np.array([0.0, 1.0]) @ turn.T * (size, size * flat))
    axes.text(tip[0], tip[1], "N", fontsize=8, fontweight="bold", ha="center", va="center", zorder=20)
    words = f"seen from the {block.camera.stands}"
    if block.camera.exaggeration != 1.0:
        words += f", heights times {block.camera.exaggeration:g}"
    at = 0.995 if block.front_m < 0.0 else 0.005
    side = "right" if block.front_m < 0.0 else "left"
    axes.text(at, 0.012, words, transform=axes.transAxes, fontsize=7, color=style.MUTED, ha=side, va="bottom")
