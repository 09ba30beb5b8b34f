"""Small missions and their scenes, for tests of planning, checking and flying."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from missionplanner.mission import Mission
from missionplanner.scene import Scene, build_scene
from tests.rasters import FRAME, hill_in

ORIGIN = {"lat_deg": FRAME.origin_lat_deg, "lon_deg": FRAME.origin_lon_deg}


def at(x_m: float, y_m: float, *, amsl: float | None = None, agl: float | None = None) -> dict[str, float]:
    """Return a place, or with a height a point, as a mission file has it."""
    heights = {"alt_amsl_m": amsl, "height_agl_m": agl}
    return {"x_m": x_m, "y_m": y_m, **{name: value for name, value in heights.items() if value is not None}}


def copter(name: str, home_xy: tuple[float, float], goal_xy: tuple[float, float], **changes: Any) -> dict[str, Any]:
    """Return a vehicle from ``home_xy`` to 40 m above ``goal_xy``."""
    return {"name": name, "home": at(*home_xy), "goal": at(*goal_xy, agl=40.0)} | changes


def question(*vehicles: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Return a mission on level ground at 100 m AMSL; by default, two copters side by side. The search is short."""
    base = {
        "name": "small",
        "origin": ORIGIN,
        "terrain": {"kind": "flat", "alt_amsl_m": 100},
        "vehicles": list(vehicles) or [copter("alpha", (0, 0), (300, 0)), copter("bravo", (0, 60), (300, 60))],
        "planner": {"population": 10, "iterations": 10},
    }
    return base | changes


def hilly(folder: Path, **changes: Any) -> dict[str, Any]:
    """Return a mission of one copter across the analytic hill, whose elevation file is written to ``folder``.

    It lands where the hill is 19 degrees steep, and is allowed to.
    """
    hill_in(folder / "hill.tif", "EPSG:32611", 20.0)
    terrain = {"kind": "raster", "file": "hill.tif"}
    defaults = {"safety": {"landing_slope_max_deg": 25}}
    return question(copter("alpha", (-500, 0), (0, 50))) | {"terrain": terrain, "defaults": defaults} | changes


def scene_of(data: dict[str, Any], folder: Path = Path()) -> Scene:
    return build_scene(Mission.model_validate(data), folder)


def mission_file(folder: Path, data: dict[str, Any]) -> Path:
    """Write a mission file (JSON is YAML) and return its path."""
    path = folder / "mission.yaml"
    path.write_text(json.dumps(data))
    return path
