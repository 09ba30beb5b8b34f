"""Plans, checks and times inspection missions for fleets of UAVs.

The public names are imported when first used, so that light commands stay light.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from missionplanner.mission import load_mission
    from missionplanner.plan_folder import load_plan, save_certificate, save_plan
    from missionplanner.planner import plan_fleet
    from missionplanner.scene import build_scene
    from missionplanner.search.run import minimise

__version__ = "0.1.0"
__all__ = [
    "__version__",
    "build_scene",
    "load_mission",
    "load_plan",
    "minimise",
    "plan_fleet",
    "save_certificate",
    "save_plan",
]

_HOME = {
    "build_scene": "missionplanner.scene",
    "load_mission": "missionplanner.mission",
    "load_plan": "missionplanner.plan_folder",
    "minimise": "missionplanner.search.run",
    "plan_fleet": "missionplanner.planner",
    "save_certificate": "missionplanner.plan_folder",
    "save_plan": "missionplanner.plan_folder",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
