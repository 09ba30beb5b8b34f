"""The main job without the command line: plan a mission into a folder, and fly a plan in lock-step simulation."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from adapters.certificates import certify_plan
from adapters.endpoint import open_endpoint
from adapters.export import export_fleet
from adapters.fleet_link import FleetLink
from missionplanner import build_scene, load_mission, plan_fleet, save_certificate, save_plan
from missionplanner.plan import FleetFlight, FleetPlan
from missionplanner.scene import Scene
from sim.fleet import LockstepClock, SimFleet, connect_fleet, planned_vehicles

MISSIONS = Path(__file__).parents[1] / "missions"
EXAMPLES = ("quickstart", "mountain", "multi_domain", "ridge_line")


def mission_path(name: str) -> Path:
    """Return the file of an example mission."""
    return MISSIONS / f"{name}.yaml"


def load_scene(path: Path) -> Scene:
    """Return the scene of a mission file."""
    return build_scene(load_mission(path), path.parent)


def plan_into(folder: Path, scene: Scene, seed: int | None = None) -> FleetPlan:
    """Plan a mission; write ``plan.json``, its certificate and, in ``files``, what is exported."""
    plan = plan_fleet(scene, seed=seed)
    save_plan(folder, scene, plan)
    save_certificate(folder, certify_plan(scene, plan))
    export_fleet(plan, folder / "files")
    return plan


def fly(scene: Scene, plan: FleetPlan) -> FleetFlight:
    """Upload a plan to simulated vehicles, verify it, start them together and watch them until all have ended."""

    def ground(x_m: float, y_m: float) -> float:
        return scene.terrain.ground_amsl_m(x_m, y_m, "a landing place")

    station = open_endpoint("udpin:127.0.0.1:0")
    fleet = SimFleet(planned_vehicles(plan), frame=scene.frame, ground=ground, seed=plan.seed)
    with closing(station), closing(fleet):
        connect_fleet(fleet, station.url.replace("udpin", "udpout"))
        link = FleetLink(plan, [station], LockstepClock(fleet))
        link.connect()
        link.upload()
        link.verify()
        link.set_returns()
        link.start()
        return link.watch()
