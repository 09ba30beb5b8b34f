"""After an installation, the kernels of flights and checks are compiled in a second process while the first one plans.

Compiling takes most of the very first run, and numba compiles on one core only. What a process has compiled, all later
ones load from its cache.
"""

from __future__ import annotations

import subprocess
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from missionplanner import planner, proof
from missionplanner.clearance import Margins, legs_clear
from missionplanner.mission import parse_mission
from missionplanner.path_search import PlannedPath
from missionplanner.scene import build_scene
from missionplanner.timing import closest_approach
from missionplanner.waypoints import fit_waypoints

_MISSION = """
name: warmup
origin: {lat_deg: 47.0, lon_deg: 8.0}
terrain: {kind: flat, alt_amsl_m: 0}
obstacles: [{kind: cylinder, name: mast, center: {x_m: 0, y_m: 100}, radius_m: 5}]
vehicles:
  - {name: a, home: {x_m: -50, y_m: 0}, goal: {x_m: -50, y_m: 200, height_agl_m: 50}}
  - {name: b, home: {x_m: 50, y_m: 0}, goal: {x_m: 50, y_m: 200, height_agl_m: 50}}
"""


def begin() -> subprocess.Popen[bytes] | None:
    """Start compiling in another process if nothing has been compiled yet; return the process to wait for."""
    cache = closest_approach.stats.cache_path
    if cache is None or any(Path(cache).glob("*.closest_approach-*.nbi")):
        return None
    return subprocess.Popen([sys.executable, "-m", __name__], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def compile_flights_and_checks() -> None:
    """Time, fly and check a mission of two straight paths: all of the planner but its search."""
    scene = build_scene(parse_mission(_MISSION, "warmup"), Path())
    paths = []
    for task in scene.tasks:
        path_m = np.concatenate([np.linspace(a, b, 20)[i > 0 :] for i, (a, b) in enumerate(pairwise(task.route_m))])
        stops = np.array([0, len(path_m) - 1])
        waypoints_m = fit_waypoints(path_m, stops, 2.0, partial(legs_clear, scene.space, Margins.of(task.limits)))
        assert waypoints_m is not None
        paths.append(PlannedPath(path_m, waypoints_m, 0.0, 0.0, {}, np.zeros(0), 0))
    schedules, arrival_s = planner.schedule(scene, paths, [0.0, 0.0])
    plan = planner.assemble(scene, paths, schedules, arrival_s, seed=0)
    proof.checked(planner.with_return_heights(scene, plan), plan)


if __name__ == "__main__":
    compile_flights_and_checks()
