"""An inspection on disk: ``inspection.json`` and, for every round, an ordinary plan folder ``round-K``.

``inspection.json`` is written last: a folder without it is no inspection. What it says of tours is held against the
rounds' plans when it is read, and those are predicted and checked again. The format is described in docs/PLAN_FILE.md.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from missionplanner import __version__, views
from missionplanner.assignment import Assignment, Tour
from missionplanner.errors import MissionError
from missionplanner.files import ensure_writable, write_atomic
from missionplanner.inspection import InspectionPlan, Round, open_scene, stops
from missionplanner.mission import parse_mission
from missionplanner.plan_folder import (
    INSPECTION_NAME,
    OF_EARLIER,
    PLAN_NAME,
    Record,
    load_plan,
    read_record,
    remove,
)
from missionplanner.scene import TERRAIN_NAME, VehicleTask, portable_mission
from missionplanner.terrain import write_raster
from missionplanner.tower_rows import TowerRow, tower_rows
from missionplanner.views import LeftOut, Visit

FORMAT = "missionplanner-inspection"
VERSION = 1
_AGAIN = "plan the inspection again"
_STALE = (  # what could also be flown by mistake
    *(*OF_EARLIER, PLAN_NAME, "towers.csv", "towers.geojson"),
    *(f"files/{name}" for name in ("*.plan", "*.waypoints", "*.kml", "*.geojson", "*.kmz", "*-litchi*.csv")),
)


class _VisitRecord(Record):
    name: str
    reversed: bool


class _TourRecord(Record):
    vehicle: str
    visits: tuple[_VisitRecord, ...] = Field(min_length=1)
    time_s: float
    energy_share: float


class _RoundRecord(Record):
    input_sha256: str
    tours: tuple[_TourRecord, ...] = Field(min_length=1)


class _LeftOutRecord(Record):
    target: str
    why: str


class _InspectionRecord(Record):
    format: Literal["missionplanner-inspection"]
    version: Literal[1]
    seed: int = Field(ge=0)
    input_sha256: str
    assigned_makespan_s: float
    bound_s: float
    rounds: tuple[_RoundRecord, ...]
    left_out: tuple[_LeftOutRecord, ...]
    done: tuple[str, ...]
    mission: dict[str, Any]


def round_folder(folder: Path, number: int) -> Path:
    """Return the plan folder of a round, from 1."""
    return folder / f"round-{number}"


def save_inspection(folder: Path, plan: InspectionPlan, save_round: Callable[[Path, Round], None]) -> Path:
    """Write all rounds by ``save_round``, then ``inspection.json``; return its path.

    What an earlier plan or inspection has left in this folder is removed; logs of flights stay.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    clear(folder)
    mission = portable_mission(plan.scene)
    if mission.terrain.kind == "raster":
        write_raster(folder / TERRAIN_NAME, plan.scene.terrain)
    for number, round_ in enumerate(plan.rounds, start=1):
        save_round(round_folder(folder, number), round_)
    names = [task.name for task in plan.scene.tasks]
    visits = {visit.name: visit for visit in plan.visits}
    document = {
        "format": FORMAT,
        "version": VERSION,
        "software_version": __version__,
        "seed": plan.seed,
        "input_sha256": plan.scene.input_sha256,
        "share": round(plan.share, 6),
        "makespan_s": round(plan.makespan_s, 2),
        "assigned_makespan_s": plan.assignment.makespan_s,
        "bound_s": plan.assignment.bound_s,
        "rounds": [
            {
                "folder": round_folder(folder, number).name,
                "input_sha256": round_.scene.input_sha256,
                "lasts_s": round(round_.lasts_s, 2),
                "tours": [
                    {
                        "vehicle": names[tour.vehicle],
                        "time_s": tour.time_s,
                        "energy_share": tour.energy_share,
                        "visits": [
                            {"name": visit.name, "reversed": _turned(visit, visits[visit.name])}
                            for visit in tour.visits
                        ],
                    }
                    for tour in round_.tours
                ],
            }
            for number, round_ in enumerate(plan.rounds, start=1)
        ],
        "targets": [_target(row) for row in tower_rows(plan) if row.sortie is not None],
        "left_out": [{"target": left.target, "why": left.why} for left in plan.left_out],
        "done": sorted(plan.done),
        "mission": mission.model_dump(mode="json", by_alias=True, exclude_unset=True),
    }
    path = folder / INSPECTION_NAME
    write_atomic(path, json.dumps(document, indent=1, allow_nan=False) + "\n")
    return path


def clear(folder: Path) -> None:
    """Remove what an earlier plan or inspection has left in a folder and its rounds, but for logs of flights.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    ensure_writable(folder)
    (folder / INSPECTION_NAME).unlink(missing_ok=True)
    for at in (folder, *folder.glob("round-*")):  # resumed ones, too
        remove(at, _STALE)


def load_inspection(folder: Path) -> InspectionPlan:
    """Read an inspection; every round's flights are predicted and checked again.

    Raises
    ------
    MissionError
        There is none, a round is missing, or something is damaged, of another version, or does not fit the rest.
    """
    path = folder / INSPECTION_NAME
    record = read_record(path, _InspectionRecord, _AGAIN)
    scene = open_scene(parse_mission(json.dumps(record.mission), f"{path}: mission"), folder)
    if scene.input_sha256 != record.input_sha256:
        raise MissionError(
            f"{path}: expected the mission and terrain it was planned for (sha256 {record.input_sha256[:12]}...), got "
            f"others ({scene.input_sha256[:12]}...): {_AGAIN}"
        )
    found, _ = views.visits(scene)
    visits = {visit.name: visit for visit in found}
    indices = {task.name: index for index, task in enumerate(scene.tasks)}
    rounds = []
    for number, this in enumerate(record.rounds, start=1):
        tours = tuple(_tour(path, tour, number, indices, visits) for tour in this.tours)
        rounds.append(_round(round_folder(folder, number), this.input_sha256, tours, scene.tasks))
    return InspectionPlan(
        scene=scene,
        visits=found,
        rounds=tuple(rounds),
        left_out=tuple(LeftOut(left.target, left.why) for left in record.left_out),
        assignment=Assignment(
            tours=tuple(tour for round_ in rounds for tour in round_.tours),
            left_out=(),
            makespan_s=record.assigned_makespan_s,
            bound_s=record.bound_s,
        ),
        done=frozenset(record.done),
        seed=record.seed,
    )


def _target(row: TowerRow) -> dict[str, Any]:
    sortie = row.sortie
    assert sortie is not None
    return {
        "target": row.target,
        "visit": row.visit,
        "round": sortie.round,
        "vehicle": sortie.vehicle,
        "order": sortie.order,
        "begins_s": round(sortie.begins_s, 2),
        "ends_s": round(sortie.ends_s, 2),
        "photos": sortie.photos,
        "viewpoints": sortie.viewpoints,
    }


def _tour(
    path: Path, record: _TourRecord, number: int, indices: Mapping[str, int], visits: Mapping[str, Visit]
) -> Tour:
    if record.vehicle not in indices:
        raise MissionError(f"{path}: expected vehicles of its mission, got {record.vehicle}: {_AGAIN}")
    if unknown := [visit.name for visit in record.visits if visit.name not in visits]:
        raise MissionError(f"{path}: expected views that its mission asks for, got {unknown[0]}: {_AGAIN}")
    flown = tuple(visits[v.name].reversed() if v.reversed else visits[v.name] for v in record.visits)
    return Tour(indices[record.vehicle], number - 1, flown, record.time_s, record.energy_share)


def _round(folder: Path, input_sha256: str, tours: tuple[Tour, ...], tasks: Sequence[VehicleTask]) -> Round:
    if not (folder / PLAN_NAME).exists():
        raise MissionError(f"{folder}: expected the plan of this round of the inspection, got none: {_AGAIN}")
    scene, plan = load_plan(folder)
    asked = {tasks[tour.vehicle].name: stops(tour) for tour in tours}
    found = {vehicle.name: vehicle.stops for vehicle in scene.mission.vehicles}
    if scene.input_sha256 != input_sha256 or found != asked:
        raise MissionError(f"{folder}: expected the round that the inspection was planned with, got another: {_AGAIN}")
    return Round(scene, plan, tours)


def _turned(flown: Visit, asked: Visit) -> bool:
    """Return whether a visit is flown backwards."""
    return not np.array_equal(flown.viewpoints[0].position_m, asked.viewpoints[0].position_m)
