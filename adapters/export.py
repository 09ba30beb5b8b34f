"""A fleet plan as files for other tools: for ground stations, DJI's and Litchi's apps, and maps."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path

from adapters import dji_wpml, litchi
from adapters.geo_files import fleet_geojson, fleet_kml
from adapters.guards import guard, read_areas
from adapters.mission_items import plan_items
from adapters.plan_file import PlanFile, plan_text
from adapters.waypoints_file import waypoints_text
from missionplanner.errors import MissionError
from missionplanner.files import write_atomic
from missionplanner.plan import FleetPlan, VehiclePlan

DEFAULT_FORMATS = ("plan", "waypoints", "kml", "geojson")
FORMATS = (*DEFAULT_FORMATS, "dji", "litchi")


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What is written of a plan, and for which DJI aircraft."""

    formats: Sequence[str] = DEFAULT_FORMATS
    aircraft: dji_wpml.Aircraft = field(default_factory=lambda: dji_wpml.AIRCRAFT[dji_wpml.DEFAULT_AIRCRAFT])


def export_options(formats: str, aircraft: str = dji_wpml.DEFAULT_AIRCRAFT) -> ExportOptions:
    """Return what a user asks for: names of formats with commas between, and of a DJI aircraft.

    Raises
    ------
    MissionError
        A name that is none.
    """
    asked = [name.strip().lower() for name in formats.split(",")]
    for name in asked:
        _expect("--format", name, FORMATS)
    _expect("--dji-aircraft", aircraft.lower(), dji_wpml.AIRCRAFT)
    chosen = tuple(name for name in FORMATS if name in asked)
    return ExportOptions(chosen, dji_wpml.AIRCRAFT[aircraft.lower()])


def _expect(option: str, name: str, known: Collection[str]) -> None:
    if name not in known:
        near = get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}"
        raise MissionError(
            f"{option}: expected {'a format' if option == '--format' else 'an aircraft'}, got {name!r}: {hint}"
        )


def export_fleet(plan: FleetPlan, folder: Path, options: ExportOptions | None = None) -> list[Path]:
    """Write all files of the fleet into ``folder`` and return their paths.

    Raises
    ------
    MissionError
        The folder cannot be written to, or a format cannot say what the plan asks for.
    InfeasibleError
        A vehicle's own fence would end its mission.
    """
    options = options or ExportOptions()
    contents: dict[str, str | bytes] = {}
    for vehicle in plan.vehicles:
        for name in options.formats:
            if name in _OF_A_VEHICLE:
                contents |= _OF_A_VEHICLE[name](plan, vehicle, options)
    for name in options.formats:
        if name in _OF_THE_FLEET:
            contents[f"fleet.{name}"] = _OF_THE_FLEET[name](plan)
    # everything is made before anything is written: a plan that cannot be exported leaves no half of it
    for name, content in contents.items():
        write_atomic(folder / name, content)
    return [folder / name for name in contents]


def export_remarks(plan: FleetPlan, options: ExportOptions) -> list[str]:
    """Return what who flies the exported files must know."""
    told: list[str] = []
    if "dji" in options.formats:
        told += dji_wpml.remarks(plan, options.aircraft)
    if "litchi" in options.formats:
        told += litchi.remarks(plan)
    return told


def flyable(path: Path) -> bool:
    """Return whether a file's name is that of one that somebody could fly, were it left from an earlier plan."""
    return path.suffix in {".plan", ".waypoints", ".kmz"} or (path.suffix == ".csv" and "-litchi" in path.stem)


def _mission_file(plan: FleetPlan, vehicle: VehiclePlan, _: ExportOptions) -> dict[str, str | bytes]:
    held = PlanFile(vehicle.autopilot, plan.frame.geo_point(vehicle.home_m), plan_items(vehicle, plan.frame))
    sent = guard(plan, vehicle)
    return {f"{vehicle.name}.plan": plan_text(held, vehicle.vehicle_class, read_areas(sent.fence), sent.rally)}


def _waypoints_file(plan: FleetPlan, vehicle: VehiclePlan, _: ExportOptions) -> dict[str, str | bytes]:
    home, items = plan.frame.geo_point(vehicle.home_m), plan_items(vehicle, plan.frame)
    return {f"{vehicle.name}.waypoints": waypoints_text(items, vehicle.autopilot, home)}


def _dji_file(plan: FleetPlan, vehicle: VehiclePlan, options: ExportOptions) -> dict[str, str | bytes]:
    name = dji_wpml.dji_name(vehicle.name)
    if any(dji_wpml.dji_name(other.name) == name for other in plan.vehicles if other is not vehicle):
        name = f"{name}-{vehicle.sysid}"
    return {f"{name}.kmz": dji_wpml.wpml_kmz(plan, vehicle, options.aircraft)}


def _litchi_files(plan: FleetPlan, vehicle: VehiclePlan, _: ExportOptions) -> dict[str, str | bytes]:
    parts = litchi.litchi_csv(plan, vehicle)
    return {
        f"{vehicle.name}-litchi{f'-{number}' if len(parts) > 1 else ''}.csv": part
        for number, part in enumerate(parts, start=1)
    }


_OF_A_VEHICLE: Mapping[str, Callable[[FleetPlan, VehiclePlan, ExportOptions], dict[str, str | bytes]]] = {
    "plan": _mission_file,
    "waypoints": _waypoints_file,
    "dji": _dji_file,
    "litchi": _litchi_files,
}
_OF_THE_FLEET: Mapping[str, Callable[[FleetPlan], str]] = {"kml": fleet_kml, "geojson": fleet_geojson}
