"""A small inspection, made by hand: two copters, two rounds, a line of four towers, for tests of what is made of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from missionplanner import views
from missionplanner.assignment import Assignment, Tour
from missionplanner.inspection import InspectionPlan, Round, open_scene
from missionplanner.mission import Mission
from missionplanner.plan import FleetPlan, VehiclePlan
from missionplanner.scene import Scene
from missionplanner.views import LeftOut, Visit
from tests.plans import vehicle_plan


def at(x: float, y: float) -> dict[str, float]:
    return {"x_m": x, "y_m": y}


def question(**changes: Any) -> Mission:
    inspection = {
        "towers": [
            {"name": "T01", **at(100, 300), "last_inspected": "2025-05-04"},
            {"name": "T02", **at(300, 320), "height_m": 40, "weight": 3},
            {"name": "T03", **at(500, 300)},
            {"name": "T04", **at(700, 280)},
        ],
        "lines": [
            {"name": "north", "towers": ["T01", "T02", "T03"]},
            {"name": "south", "towers": ["T02", "T04"]},
        ],
        "as_of": "2025-05-24",
        "spans": {"sides": "left"},
        "camera": {"preset": "sony_rx0m2"},
        "assignment": {"swap_s": 120},
    }
    return Mission.model_validate(
        {
            "name": "by-hand",
            "origin": {"lat_deg": 46.5, "lon_deg": 8.0},
            "terrain": {"kind": "flat", "alt_amsl_m": 500},
            "inspection": {**inspection, **changes},
            "vehicles": [
                {"name": "alpha", "home": at(0, 0), "sysid": 7, "endurance_s": 1500},
                {"name": "bravo", "home": at(60, 0), "endurance_s": 1500},
            ],
        }
    )


def sortie(scene: Scene, index: int, visits: tuple[Visit, ...]) -> VehiclePlan:
    """Return a vehicle's straight way through the viewpoints of visits, from above its home and back."""
    task = scene.tasks[index]
    viewpoints = [viewpoint for visit in visits for viewpoint in visit.viewpoints]
    above_m = task.home_m + np.array([0.0, 0.0, 60.0])
    points = np.array([above_m, *(viewpoint.position_m for viewpoint in viewpoints), above_m])
    plan = vehicle_plan(task.name, task.sysid, home_m=tuple(task.home_m.tolist()), waypoints_m=points)
    holds_s = np.array([*(viewpoint.action.hold_s for viewpoint in viewpoints), 0.0])
    return replace(plan, hold_s=holds_s, actions={k: v.action for k, v in enumerate(viewpoints, start=1)})


def inspection_by_hand(mission: Mission | None = None) -> InspectionPlan:
    """Return an inspection: T01 done before, T03 left out; nothing of it is proven."""
    scene = open_scene(mission or question(), Path())
    found, _ = views.visits(scene)
    todo = [visit for visit in found if visit.target not in {"T01", "T03"}]
    shared = [(0, 0, todo[:2]), (1, 0, todo[2:4]), (0, 1, todo[4:])]
    tours = tuple(Tour(k, number, tuple(visits), 100.0, 0.5) for k, number, visits in shared)
    rounds = []
    for number in (0, 1):
        of_round = tuple(tour for tour in tours if tour.round == number)
        vehicles = tuple(sortie(scene, tour.vehicle, tour.visits) for tour in of_round)
        plan = FleetPlan(scene.mission, scene.frame, vehicles, None, None, 1, "0", scene.input_sha256)
        flying = replace(scene, tasks=tuple(scene.tasks[tour.vehicle] for tour in of_round))
        rounds.append(Round(flying, plan, of_round))
    return InspectionPlan(
        scene=scene,
        visits=found,
        rounds=tuple(rounds),
        left_out=(LeftOut("T03", 'no view is clear of "mast", 4.2 m are missing: raise distance_m'),),
        assignment=Assignment(tours, (), 400.0, 200.0),
        done=frozenset({"T01"}),
        seed=1,
    )
