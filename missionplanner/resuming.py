"""The rest of a vehicle's mission, from home again: after a change of batteries, or a flight that was broken off.

The way from home to where the rest begins is planned as any other; the rest is flown as it was planned, at its speeds.
All of it is proven anew as one flight. The vehicle flies alone: nothing is proven of others that fly meanwhile.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from missionplanner import planner, proof
from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Direction, Mission, Place, Point, Stop
from missionplanner.path_search import PlannedPath
from missionplanner.plan import Action, FleetPlan, VehiclePlan
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
    actions = _rest_of(vehicle, waypoint)
    whole = build_scene(_alone(scene.mission, name, vehicle.home_m, rest_m, vehicle.end, actions), folder)
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
    when = replace(as_fast, speeds_m_s=speeds_m_s)

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


def _rest_of(vehicle: VehiclePlan, waypoint: int) -> dict[int, Action]:
    """Return what is still to be done from a waypoint on, by waypoint after it.

    Every waypoint becomes a stop: on the way to a place that has others between, the camera works from the first on. On
    the way back to the first it does not take photos: it has taken them, or they belong to the leg before.
    """
    rest: dict[int, Action] = {}
    for end in sorted(vehicle.actions):
        begin = max((k for k in vehicle.actions if k < end), default=0)
        action = vehicle.actions[end]
        on_the_way = replace(action, name="", hold_s=0.0, photos=0)
        for k in range(max(begin + 1, waypoint), end + 1):
            done = action if k == end else on_the_way
            rest[k - waypoint] = replace(done, photo_every_m=0.0) if k == waypoint else done
    return rest


def _stop(place_m: FloatArray, action: Action) -> Stop:
    return Stop(
        **_point(place_m),
        name=action.name or None,
        inspects=action.inspects or None,
        hold_s=action.hold_s,
        look_at=None if action.look_at_m is None else Point(**_point(action.look_at_m)),
        look=None
        if action.look_deg is None
        else Direction(heading_deg=action.look_deg[0], pitch_deg=action.look_deg[1]),
        photos=action.photos,
        photo_every_m=action.photo_every_m or None,
    )


def _point(place_m: FloatArray | tuple[float, float, float]) -> dict[str, float]:
    x, y, z = place_m
    return {"x_m": float(x), "y_m": float(y), "alt_amsl_m": float(z)}


def _alone(
    question: Mission,
    name: str,
    home_m: FloatArray,
    places_m: FloatArray,
    end: Ending,
    actions: Mapping[int, Action] | None = None,
) -> Mission:
    """Return the mission of one vehicle through places (P, 3), all else as it was; towers are obstacles only.

    What is done at places is in ``actions``, by place.
    """
    number, asked = next((i, v) for i, v in enumerate(question.vehicles, start=1) if v.name == name)
    stops = tuple(_stop(place_m, (actions or {}).get(k, Action())) for k, place_m in enumerate(places_m[:-1]))
    changes = {
        "sysid": asked.sysid or number,
        "home": Place(x_m=float(home_m[0]), y_m=float(home_m[1])),
        "start": asked.start if asked.vehicle_class == "plane" else None,  # which says where it climbs to
        "stops": stops,
        "goal": Point(**_point(places_m[-1])),
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
