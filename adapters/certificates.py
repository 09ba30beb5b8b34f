"""Certificates for what is sent: missions are exported, read back, and only then proven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from adapters.fleet_link import Downloaded
from adapters.mission_items import FRAME_MISSION, MissionItem, items_sha256, plan_items, wire_to_degrees
from adapters.sorties import mission_file_notes, mission_file_rally_points, read_mission_file, read_sortie
from adapters.vehicle_parameters import compared
from missionplanner import proof
from missionplanner.certificate import Certificate, Finding
from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Mission, Vehicle
from missionplanner.plan import FleetPlan, VehiclePlan
from missionplanner.planner import return_heights_m
from missionplanner.scene import Scene, VehicleTask, build_check_scene
from missionplanner.sortie import Sortie


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """One vehicle's mission, wherever it comes from: a plan, a file, the vehicle itself."""

    name: str
    items: tuple[MissionItem, ...]
    home_m: FloatArray | None  # None: as the mission itself says
    return_height_m: float
    start_delay_s: float = 0.0
    path: Path | None = None  # of the file it was read from
    notes: tuple[str, ...] = ()  # what of it was not judged
    return_remarks: tuple[str, ...] = ()  # why its vehicle would return otherwise than straight home at that height
    motion_remarks: tuple[str, ...] = ()  # why its vehicle would not fly as is predicted


def planned(plan: FleetPlan) -> list[Held]:
    """Return the missions of a plan as they are sent."""
    return [_held(plan, vehicle, plan_items(vehicle, plan.frame)) for vehicle in plan.vehicles]


def held_by_vehicles(plan: FleetPlan, items: Mapping[int, Sequence[MissionItem]]) -> list[Held]:
    """Return the missions that were read back from a plan's vehicles, by sysid."""
    return [_held(plan, vehicle, items[vehicle.sysid]) for vehicle in plan.vehicles]


def _held(plan: FleetPlan, vehicle: VehiclePlan, items: Sequence[MissionItem]) -> Held:
    rally = next((asked.rally for asked in plan.mission.vehicles if asked.name == vehicle.name), ())
    remarks = (f"it holds {len(rally)} rally points, to which it may return instead of its home",) if rally else ()
    return Held(
        vehicle.name,
        tuple(items),
        vehicle.home_m,
        vehicle.motion.return_height_m,
        vehicle.start_delay_s,
        return_remarks=remarks,
    )


def certify(scene: Scene, missions: Sequence[Held], *, arrival_s: float | None = None) -> Certificate:
    """Return what is proven of missions, read from their items.

    Raises
    ------
    MissionError
        A mission that cannot be read at all: empty, without home, with places that are none.
    """
    sorties = [sortie(scene, held) for held in missions]
    hashes = {held.name: items_sha256(held.items) for held in missions}
    certificate = proof.prove(scene, sorties, mission_sha256=hashes, arrival_s=arrival_s)
    waived = {s.name: s.ending != "rtl" and scene.mission.fleet.direct_return == "waived" for s in sorties}
    remedy = "clear rally points; upload sets the rest"
    otherwise = [  # a mission that ends with its return cannot do without
        Finding("return", held.name, False, remark, remedy, unit="", waived=waived[held.name])
        for held in missions
        for remark in held.return_remarks
    ]
    remedy = "set it on the vehicle, or say so in the mission file's parameters"
    otherwise += [
        Finding("understood", held.name, False, remark, remedy, unit="")
        for held in missions
        for remark in held.motion_remarks
    ]
    return replace(certificate, findings=(*certificate.findings, *otherwise))


def sortie(scene: Scene, held: Held) -> Sortie:
    """Return one mission as its vehicle will fly it."""
    task = _task(scene, held.name)
    read = read_sortie(
        held.items,
        name=held.name,
        sysid=task.sysid,
        autopilot=task.motion.autopilot,
        vehicle_class=task.motion.vehicle_class,
        frame=scene.frame,
        home_m=held.home_m,
        motion=replace(task.motion, return_height_m=held.return_height_m),
        start_delay_s=held.start_delay_s,
        ground=lambda x_m, y_m: float(scene.terrain.height_amsl_m(x_m, y_m)),
    )
    return replace(read, notes=(*read.notes, *held.notes))


def certify_plan(scene: Scene, plan: FleetPlan) -> Certificate:
    """Return what is proven of a plan's missions as they are sent."""
    return certify(scene, planned(plan), arrival_s=plan.arrival_s)


def certify_folder(scene: Scene, plan: FleetPlan, files: Path) -> Certificate:
    """Return what is proven of a plan, whose exported files, where there are any, must hold just its missions."""
    certificate = certify_plan(scene, plan)
    edited = [finding for held in planned(plan) for finding in _edited(scene, held, files)]
    return replace(certificate, findings=(*certificate.findings, *edited))


def _edited(scene: Scene, held: Held, files: Path) -> list[Finding]:
    """Return for each of a vehicle's exported files whether it holds what the plan holds."""
    findings = []
    autopilot = _task(scene, held.name).motion.autopilot
    for path in (files / f"{held.name}.plan", files / f"{held.name}.waypoints"):
        if not path.exists():
            continue
        try:
            items, _ = read_mission_file(path, autopilot)
            same = items_sha256(items) == items_sha256(held.items)
            detail = f"{path} holds what the plan holds" if same else f"{path} is not what the plan holds"
        except MissionError as error:
            same, detail = False, str(error)
        remedy = "" if same else f"export it again, or check it alone (check --mission MISSION {path})"
        findings.append(Finding("files", held.name, same, detail, remedy, unit=""))
    return findings


def read_files(question: Mission, folder: Path, paths: Sequence[Path]) -> tuple[Scene, list[Held]]:
    """Return mission files of any origin, each with its vehicle of a mission, and the scene to judge them in.

    A file belongs to the vehicle whose name it bears, else to the one at its place in the list.

    Raises
    ------
    MissionError
        A file that cannot be read, is another autopilot's, or more files than vehicles.
    """
    owners = _owners(question, paths)
    read = [read_mission_file(path, vehicle.autopilot) for vehicle, path in zip(owners, paths, strict=True)]
    scene = build_check_scene(question, folder, _places([items for items, _ in read]))
    missions = []
    for vehicle, path, (items, home) in zip(owners, paths, read, strict=True):
        home_m = None if home is None else scene.frame.to_local(home.lat_deg, home.lon_deg, home.alt_amsl_m)
        if home_m is None and vehicle.autopilot == "px4":
            home_m = _task(scene, vehicle.name).home_m
        return_height_m = _task(scene, vehicle.name).motion.return_height_m
        notes, rally = mission_file_notes(path), mission_file_rally_points(path)
        if path.stem != vehicle.name:
            notes = (f"its mission is taken to be {path.name}", *notes)
        remarks = (f"{path.name}: rally points: {rally}, to which it may return instead of its home",) if rally else ()
        missions.append(
            Held(
                vehicle.name,
                tuple(items),
                home_m,
                return_height_m,
                path=path,
                notes=notes,
                return_remarks=remarks,
            )
        )
    return scene, missions


def with_return_heights(scene: Scene, missions: Sequence[Held]) -> list[Held]:
    """Return missions with the least heights at which their vehicles return clear of all, and apart, if there are any.

    Files do not say at which height their vehicles return: the certificate says which to set. Heights that the mission
    file gives are kept.
    """
    flights = proof.predict(scene, [sortie(scene, held) for held in missions])
    if not all(flight.timed for flight in flights):
        return list(missions)
    try:
        heights_m = return_heights_m(scene, flights)
    except InfeasibleError:
        return list(missions)  # the proof will say why
    return [replace(held, return_height_m=heights_m.get(held.name, held.return_height_m)) for held in missions]


def read_vehicles(question: Mission, folder: Path, downloaded: Mapping[int, Downloaded]) -> tuple[Scene, list[Held]]:
    """Return the missions that a mission's vehicles were found to hold, by sysid, and the scene to judge them in.

    Raises
    ------
    MissionError
        A vehicle of another kind than the mission says.
    """
    owners = {vehicle.sysid or index: vehicle for index, vehicle in enumerate(question.vehicles, start=1)}
    for sysid, found in downloaded.items():
        vehicle = owners[sysid]
        if (found.autopilot, found.vehicle_class) != (vehicle.autopilot, vehicle.vehicle_class):
            raise MissionError(
                f"{vehicle.name} (sysid {sysid}): expected {vehicle.autopilot} {vehicle.vehicle_class}, got "
                f"{found.autopilot} {found.vehicle_class}: correct the mission file, or the sysid"
            )
    scene = build_check_scene(question, folder, _places([found.items for found in downloaded.values()]))
    missions = []
    for sysid, found in sorted(downloaded.items()):
        name, home = owners[sysid].name, found.home
        home_m = _task(scene, name).home_m
        if home is not None:
            home_m = scene.frame.to_local(home.lat_deg, home.lon_deg, home.alt_amsl_m)
        comparison = compared(name, _task(scene, name).motion, found.parameters)
        missions.append(
            Held(
                name,
                found.items,
                home_m,
                found.return_height_m,
                notes=found.notes,
                return_remarks=found.remarks,
                motion_remarks=(*map(str, comparison.differences), *comparison.unheld),
            )
        )
    return scene, missions


def _owners(question: Mission, paths: Sequence[Path]) -> list[Vehicle]:
    vehicles = {vehicle.name: vehicle for vehicle in question.vehicles}
    if len(paths) > len(vehicles):
        raise MissionError(
            f"--mission: expected at most a file for each of its vehicles ({', '.join(vehicles)}), got {len(paths)}"
        )
    stems = [path.stem for path in paths]
    for name in vehicles:
        if stems.count(name) > 1:
            told = " and ".join(str(path) for path in paths if path.stem == name)
            raise MissionError(f"{name}: expected one file, got {told}: check them one after the other")
    named = {path: vehicles.pop(path.stem) for path in paths if path.stem in vehicles}
    left = iter(vehicles.values())
    return [named[path] if path in named else next(left) for path in paths]


def _places(missions: Sequence[Sequence[MissionItem]]) -> list[tuple[float, float]]:
    """Return the latitudes and longitudes that missions go to; 0, 0 is where a vehicle is at the time."""
    return [
        (wire_to_degrees(item.x), wire_to_degrees(item.y))
        for items in missions
        for item in items
        if (item.x or item.y) and item.frame != FRAME_MISSION
    ]


def _task(scene: Scene, name: str) -> VehicleTask:
    return next(task for task in scene.tasks if task.name == name)
