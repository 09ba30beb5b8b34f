"""A fleet plan as files for other tools: ``.plan`` and ``.waypoints`` per vehicle, KML and GeoJSON of the fleet."""

from __future__ import annotations

from pathlib import Path

from adapters.geo_files import fleet_geojson, fleet_kml
from adapters.guards import guard, read_areas
from adapters.mission_items import plan_items
from adapters.plan_file import PlanFile, plan_text
from adapters.waypoints_file import waypoints_text
from missionplanner.files import write_atomic
from missionplanner.plan import FleetPlan


def export_fleet(plan: FleetPlan, folder: Path) -> list[Path]:
    """Write all files of the fleet into ``folder`` and return their paths.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    InfeasibleError
        A vehicle's own fence would end its mission.
    """
    texts: dict[str, str] = {}
    for vehicle in plan.vehicles:
        items = plan_items(vehicle, plan.frame)
        home = plan.frame.geo_point(vehicle.home_m)
        held, sent = PlanFile(vehicle.autopilot, home, items), guard(plan, vehicle)
        texts[f"{vehicle.name}.plan"] = plan_text(held, vehicle.vehicle_class, read_areas(sent.fence), sent.rally)
        texts[f"{vehicle.name}.waypoints"] = waypoints_text(items, vehicle.autopilot, home)
    texts["fleet.kml"] = fleet_kml(plan)
    texts["fleet.geojson"] = fleet_geojson(plan)
    # everything is made before anything is written: a plan that cannot be exported leaves no half of it
    for name, text in texts.items():
        write_atomic(folder / name, text)
    return [folder / name for name in texts]
