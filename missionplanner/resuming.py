"""The rest of a vehicle's mission, from home again: after a change of batteries, or a flight that was broken off.

The way from home to where the rest begins is planned as any other; the rest is flown as it was planned, at its speeds.
All of it is proven anew as one flight. The vehicle flies alone: nothing is proven of others that fly meanwhile.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from missionplanner import planner, proof
from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Mission, Place, Point, Stop
from missionplanner.path_search import PlannedPath
from missionplanner.plan import FleetPlan, VehiclePlan
from missionplanner.planner import Watch
from missionplanner.scene import Scene, build_scene
from missionplanner.vehicle import Ending
from missionplanner.waypoints import passes

_NAME_MAX = 40


def find_vehicle(plan: FleetPlan, name: str) -> VehiclePlan:
    """Return a plan's vehicle.

    Raises
    ------
    MissionError
        It has none of that name.
    """
    for vehicle in plan.vehicles:
        if vehicle.name == name:
            return vehicle
    raise MissionError(f"--vehicle: expected one of {', '.join(v.name for v in plan.vehicles)}, got {name!r}")


def resume(
    scene: Scene,
    plan: FleetPlan,
    folder: Path,
    name: str,
    waypoint: int,
    *,
    seed: int | None = None,
    watch: Watch | None = None,
) -> tuple[Scene, FleetPlan]:
    """Return the scene and the proven plan of a vehicle that flies from its home to a waypoint, and then the rest.

    Parameters
    ----------
    folder : where the scene's terrain file lies
    waypoint : its index among the vehicle's waypoints, above 0: that is the top of the take-off

    Raises
    ------
    MissionError
        No such vehicle or waypoint.
    InfeasibleError
        There is no clear way back to it, or the whole is not proven.
    """
    vehicle = find_vehicle(plan, name)
    if not 1 <= waypoint < len(vehicle.waypoints_m):
        raise MissionError(f"{name}: expected a waypoint from 1 to {len(vehicle.waypoints_m) - 1}, got {waypoint}")
    rest_m = vehicle.waypoints_m[waypoint:]
    back = way_to(scene.mission, folder, name, vehicle.home_m, rest_m, vehicle.end, seed=seed, watch=watch)
    whole = build_scene(_alone(scene.mission, name, vehicle.home_m, rest_m, vehicle.end), folder)
    begins = int(np.argmin(np.linalg.norm(vehicle.path_m - rest_m[0], axis=1)))
    path_m = np.vstack([back.path_m, vehicle.path_m[begins + 1 :]])
    path = PlannedPath(
        path_m=path_m,
        waypoints_m=np.vstack([back.waypoints_m[:-1], rest_m]),
        length_m=float(np.linalg.norm(np.diff(path_m, axis=0), axis=1).sum()),
        cost=back.cost,
        cost_terms=back.cost_terms,
        history=back.history,
        evaluations=back.evaluations,
    )
    speeds_m_s = (*back.speeds_m_s.tolist(), *vehicle.speeds_m_s[waypoint:].tolist())
    ((as_fast,), _) = planner.schedule(whole, [path], [0.0])
    when = replace(as_fast, speeds_m_s=speeds_m_s, hold_s=(0.0,) * len(speeds_m_s))

    def assembled(scene: Scene) -> FleetPlan:
        made = planner.assemble(scene, [path], [when], None, plan.seed if seed is None else seed)
        return replace(made, arrival_s=made.vehicles[0].arrival_s)

    whole = planner.with_return_heights(whole, assembled(whole))
    found = proof.checked(whole, assembled(whole))
    assert found.certificate is not None
    if not found.certificate.proven:
        raise InfeasibleError(
            f"{name}: not proven: {found.certificate.refusal}; resume from the waypoint before or after instead"
        )
    return whole, found


def way_to(
    question: Mission,
    folder: Path,
    name: str,
    home_m: FloatArray,
    rest_m: FloatArray,
    end: Ending,
    *,
    seed: int | None = None,
    watch: Watch | None = None,
) -> VehiclePlan:
    """Return a mission's vehicle on a clear way from a home (3,) to the first of the places (P, 3) of its rest.

    A plane cannot stop there: its way is planned on through the rest to its end, so that it turns towards that.

    Raises
    ------
    InfeasibleError
        There is none.
    """
    asked = next(v for v in question.vehicles if v.name == name)
    places_m, ends = (rest_m, end) if asked.vehicle_class == "plane" else (rest_m[:1], "loiter")
    try:
        scene = build_scene(_alone(question, name, home_m, places_m, ends), folder)
        found = planner.plan_fleet(scene, seed=seed, watch=watch).vehicles[0]
    except (MissionError, InfeasibleError) as error:  # it speaks of a mission that the user has not written
        raise InfeasibleError(
            f"{name}: no way from home to where it is to go on was found: resume from the waypoint before or after "
            f"({error})"
        ) from error
    route_m = scene.tasks[0].route_m
    there = passes(route_m, found.waypoints_m)[len(route_m) - len(places_m)]
    samples = int(np.argmin(np.linalg.norm(found.path_m - rest_m[0], axis=1))) + 1
    return replace(
        found,
        path_m=found.path_m[:samples],
        waypoints_m=found.waypoints_m[: there + 1],
        speeds_m_s=found.speeds_m_s[:there],
        hold_s=found.hold_s[:there],
        end="loiter",
    )


def _alone(question: Mission, name: str, home_m: FloatArray, places_m: FloatArray, end: Ending) -> Mission:
    """Return the mission of one vehicle through places (P, 3), all else as it was; towers are obstacles only."""
    number, asked = next((i, v) for i, v in enumerate(question.vehicles, start=1) if v.name == name)
    *stops, goal = [{"x_m": float(x), "y_m": float(y), "alt_amsl_m": float(z)} for x, y, z in places_m]
    changes = {
        "sysid": asked.sysid or number,
        "home": Place(x_m=float(home_m[0]), y_m=float(home_m[1])),
        "start": asked.start if asked.vehicle_class == "plane" else None,  # which says where it climbs to
        "stops": tuple(Stop(**stop) for stop in stops),
        "goal": Point(**goal),
        "inspects": None,
        "end": end,
    }
    kept = {"direct_return", "home_within_m", "send_fence", "separation_m"} & question.fleet.model_fields_set
    fleet = type(question.fleet)(**{field: getattr(question.fleet, field) for field in kept})
    inspection = question.inspection
    if inspection is not None:  # what is left of the inspection is in the waypoints
        inspection = inspection.model_copy(update={"share_min": 0.0})
    weights = question.planner.weights.model_copy(update={"inspection": 0.0})
    return question.model_copy(
        update={
            "description": f"{question.description} (the rest of {name}'s mission, while nobody else flies)",
            "name": f"{question.name}_{name}_resumed"[:_NAME_MAX],
            "vehicles": (asked.model_copy(update=changes),),
            "fleet": fleet,
            "inspection": inspection,
            "planner": question.planner.model_copy(update={"weights": weights}),
        }
    )
