"""What becomes of other people's mission files: each is checked, or refused with its reason."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from adapters import certificates
from adapters.mission_items import FRAME_MISSION, MissionItem, wire_to_degrees
from adapters.sorties import read_mission_file
from missionplanner.errors import MissionError, MissionPlannerError
from missionplanner.geodesy import GeoPoint
from missionplanner.mission import Mission, load_mission
from missionplanner.vehicle import Autopilot

_SUFFIXES = (".plan", ".waypoints", ".txt")
_AUTOPILOTS: tuple[Autopilot, ...] = ("ardupilot", "px4")


@dataclass(frozen=True, slots=True)
class SampleOutcome:
    """What became of one file over one terrain."""

    file: str
    over: str  # which terrain
    outcome: str  # proven, not proven, refused
    reason: str  # why not


def check_samples(folder: Path, mission_path: Path) -> list[SampleOutcome]:
    """Return what becomes of mission files below a folder: over a mission's terrain, and over level ground there."""
    paths = sorted(p for p in folder.rglob("*") if p.suffix in _SUFFIXES and p.name != "SOURCES.txt")
    found = []
    for path in paths:
        name = str(path.relative_to(folder))
        try:
            autopilot, items, home = _read(path)
        except MissionError as error:
            found.append(SampleOutcome(name, "", "refused", str(error).replace(str(folder) + "/", "")))
            continue
        question = load_mission(mission_path)
        vehicle = question.vehicles[0].model_copy(update={"autopilot": autopilot})
        elsewhere = question.model_copy(update={"vehicles": (vehicle,), "inspection": None})
        found.append(_checked(name, mission_path.stem, elsewhere, mission_path.parent, path))
        found.append(_checked(name, "level ground", _on_the_spot(autopilot, items, home), folder, path))
    return found


def _read(path: Path) -> tuple[Autopilot, tuple[MissionItem, ...], GeoPoint | None]:
    """Read a file as whichever autopilot's it is."""
    errors = []
    for autopilot in _AUTOPILOTS:
        try:
            return (autopilot, *read_mission_file(path, autopilot))
        except MissionError as error:
            errors.append(error)
    raise errors[0]


def _on_the_spot(autopilot: Autopilot, items: tuple[MissionItem, ...], home: GeoPoint | None) -> Mission:
    """Return a mission of one copter over level ground as high as its home."""
    places = [(i.x, i.y) for i in items if (i.x or i.y) and i.frame != FRAME_MISSION]
    lat_deg, lon_deg = (wire_to_degrees(v) for v in (places[0] if places else (0, 0)))
    place = {"lat_deg": lat_deg, "lon_deg": lon_deg}
    vehicle = {"name": "sample", "autopilot": autopilot, "home": place, "goal": {**place, "height_agl_m": 50.0}}
    terrain = {"kind": "flat", "alt_amsl_m": 0.0 if home is None else home.alt_amsl_m}
    return Mission.model_validate({"name": "sample", "origin": place, "terrain": terrain, "vehicles": [vehicle]})


def _checked(name: str, over: str, question: Mission, folder: Path, path: Path) -> SampleOutcome:
    try:
        scene, missions = certificates.read_files(question, folder, [path])
        certificate = certificates.certify(scene, missions)
    except MissionPlannerError as error:
        return SampleOutcome(name, over, "refused", str(error))
    if certificate.proven:
        return SampleOutcome(name, over, "proven", "")
    problems = certificate.problems
    checks = ", ".join(f"{check} {count}" for check, count in Counter(p.check for p in problems).items())
    return SampleOutcome(name, over, "not proven", f"{checks}; first: {problems[0]}")
