"""Which paths of a scene are clear, judged by looking at very many points; nothing of the planner's geometry is used.

The mission is read as it is written. The ground is the formula of its peaks on a fine grid of the judge's own,
distances are those of :mod:`.proof_oracle`, and two vehicles are compared at all times, moving evenly between samples.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from missionplanner import mission
from missionplanner.errors import MissionError
from missionplanner.experiments import proof_oracle
from missionplanner.experiments.proof_oracle import FENCE, LOWEST, OBSTACLE, Ground, Solids
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Mission
from missionplanner.obstacles import ConeSolid, CylinderSolid, PrismSolid, Solid, SphereSolid
from missionplanner.plan import Trajectory

STEP_M = 0.5
"""Spacing of the points that are looked at; each is strayed from in several directions."""

_CELLS = 800  # of the judge's own ground, along its longer side
_PAD = 4


@dataclass(frozen=True, slots=True)
class Kept:
    """The least that a path keeps above ground, from obstacles (-1 inside) and the area's edge; its steepest piece."""

    height_m: float
    obstacle_m: float
    edge_m: float
    climb_rad: float  # the steepest piece, up or down


class Judge:
    """A mission's ground and obstacles, as the judge sees them."""

    def __init__(self, question: Mission) -> None:
        if question.area is None or question.terrain.kind == "raster":
            raise MissionError(f"{question.name}: expected a mission with an area, on flat ground or peaks")
        west, south = xy(question.area.south_west)
        east, north = xy(question.area.north_east)
        self._area = np.array([west, south, east, north])
        self._question = question
        self.ground = self._own_ground()
        solids = [self._solid(obstacle) for obstacle in question.obstacles]
        self._solids: Solids = proof_oracle.solids_of(solids, np.zeros((0, 2)), math.inf, self._area)
        self._unit = proof_oracle.strays(np.random.default_rng(0))

    def kept(self, path_m: FloatArray, stray_m: float = 0.0) -> Kept:
        """Return what a polyline (S, 3) keeps at least, by whoever strays from it so far."""
        legs = np.stack([path_m[:-1], path_m[1:]], axis=1)
        radius_m = np.full(len(legs), stray_m)
        table = proof_oracle.sample_legs(self.ground, self._solids, legs, radius_m, STEP_M, self._unit)
        along = legs[:, 1] - legs[:, 0]
        climb = np.arctan2(np.abs(along[:, 2]), np.hypot(along[:, 0], along[:, 1]))
        return Kept(
            height_m=float(table[:, LOWEST].min()),
            obstacle_m=float(table[:, OBSTACLE].min()),
            edge_m=float(table[:, FENCE].min()),
            climb_rad=float(climb.max()),
        )

    def heights_m(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the ground's altitudes (...) by its formula."""
        source = self._question.terrain
        if source.kind == "flat":
            return np.full(np.shape(x_m), float(source.alt_amsl_m))
        assert source.kind == "peaks"
        heights = np.full(np.shape(x_m), float(source.base_alt_amsl_m))
        for peak in source.peaks:
            x, y = xy(peak)
            heights += peak.height_m * np.exp(-((x_m - x) ** 2 + (y_m - y) ** 2) / peak.spread_m**2)
        return heights

    def _own_ground(self) -> Ground:
        west, south, east, north = self._area
        cell_m = max(east - west, north - south) / _CELLS
        x = np.arange(west - _PAD * cell_m, east + (_PAD + 1) * cell_m, cell_m)
        y = np.arange(south - _PAD * cell_m, north + (_PAD + 1) * cell_m, cell_m)

        def to_cell(x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
            return (y_m - y[0]) / cell_m, (x_m - x[0]) / cell_m

        return Ground(self.heights_m(*np.meshgrid(x, y)), to_cell)

    def _altitude(self, point: mission.Point) -> float:
        if point.alt_amsl_m is not None:
            return point.alt_amsl_m
        assert point.height_agl_m is not None
        return float(self.heights_m(*map(np.asarray, xy(point)))) + point.height_agl_m

    def _solid(self, obstacle: mission.Obstacle) -> Solid:
        match obstacle:
            case mission.Cylinder(top_alt_amsl_m=None, top_height_agl_m=None):
                return CylinderSolid(obstacle.name, *xy(obstacle.center), obstacle.radius_m)
            case mission.Cone():
                x, y = xy(obstacle.center)
                base_m = obstacle.base_alt_amsl_m
                if base_m is None:
                    base_m = float(self.heights_m(np.asarray(x), np.asarray(y)))
                return ConeSolid(obstacle.name, x, y, obstacle.base_radius_m, base_m, obstacle.height_m)
            case mission.Radar() | mission.Marine():
                at = (*xy(obstacle.center), self._altitude(obstacle.center))
                hard = isinstance(obstacle, mission.Marine) or obstacle.hard
                return SphereSolid(obstacle.name, *at, obstacle.radius_m, "radar", hard)
            case mission.NoFly(top_height_agl_m=None):
                floor_m, top_m = obstacle.floor_alt_amsl_m, obstacle.top_alt_amsl_m
                return PrismSolid(
                    obstacle.name,
                    np.array([xy(corner) for corner in obstacle.polygon]),
                    -math.inf if floor_m is None else floor_m,
                    math.inf if top_m is None else top_m,
                )
            case _:
                raise MissionError(f"obstacle {obstacle.name}: expected one whose top is no height above ground")


def xy(place: mission.Place) -> tuple[float, float]:
    """Return where a place is that the mission gives in metres."""
    if place.x_m is None or place.y_m is None:
        raise MissionError("expected a mission whose places are x_m and y_m")
    return place.x_m, place.y_m


def together(paths_m: Sequence[FloatArray], instants: int = 2001) -> list[Trajectory]:
    """Return paths (S, 3) flown evenly from a common start to a common arrival, in a time of 1."""
    t = np.linspace(0.0, 1.0, instants)
    found = []
    for path_m in paths_m:
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path_m, axis=0), axis=1))])
        at = np.stack([np.interp(t * along[-1], along, path_m[:, k]) for k in range(3)], axis=-1)
        found.append(Trajectory(t, at))
    return found


def least_apart_m(flights: Sequence[Trajectory]) -> FloatArray:
    """Return how near each flight (V,) comes to any other at one time; inf for a single one."""
    least = np.full(len(flights), np.inf)
    times = np.unique(np.concatenate([flight.t_s for flight in flights]))
    at = [flight.at(times) for flight in flights]
    for i, j in itertools.combinations(range(len(flights)), 2):
        apart = at[j] - at[i]
        move = np.diff(apart, axis=0)
        square = np.maximum((move**2).sum(axis=1), 1e-12)
        share = np.clip(-(apart[:-1] * move).sum(axis=1) / square, 0.0, 1.0)  # of the way to the next time
        nearest = float(np.linalg.norm(apart[:-1] + share[:, np.newaxis] * move, axis=1).min())
        least[i], least[j] = min(least[i], nearest), min(least[j], nearest)
    return least
