"""The mission resolved in the local frame: terrain loaded, heights above ground settled, places checked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.mission import Mission
from missionplanner.obstacles import Obstacles
from missionplanner.terrain import Terrain
from missionplanner.vehicle import Ending, MotionModel, VehicleLimits


@dataclass(frozen=True, slots=True, eq=False)
class VehicleTask:
    """One vehicle's problem: fly through ``route_m`` (R, 3) in order; the first is the top of the take-off."""

    name: str
    sysid: int
    home_m: FloatArray  # (3,), on the ground
    route_m: FloatArray  # (R, 3), R >= 2; the last is the goal
    end: Ending
    limits: VehicleLimits
    motion: MotionModel


@dataclass(frozen=True, slots=True, eq=False)
class Towers:
    """The towers to inspect: ``top_m`` (T, 3), weights (T,), names, and when one counts as inspected."""

    names: tuple[str, ...]
    top_m: FloatArray
    weight: FloatArray
    range_m: float
    share_min: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything that a path is judged against, in the local frame."""

    mission: Mission
    frame: LocalFrame
    terrain: Terrain
    obstacles: Obstacles
    towers: Towers | None
    area_m: tuple[float, float, float, float]  # west, south, east, north
    tasks: tuple[VehicleTask, ...]
    input_sha256: str


def build_scene(mission: Mission, folder: Path) -> Scene:
    """Resolve a mission whose relative file names start at ``folder``.

    Raises
    ------
    MissionError
        A terrain file that cannot be read or does not cover a place; a start, stop or goal below ground, inside an
        obstacle or outside the fence; two vehicles with one home or start; an unknown tower.
    """
    raise NotImplementedError
