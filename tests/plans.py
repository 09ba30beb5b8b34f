"""Small fleet plans made by hand, for tests of what comes after planning."""

from __future__ import annotations

import numpy as np

from missionplanner.geodesy import LocalFrame
from missionplanner.mission import FlatTerrain, Mission, Origin, Point, Vehicle
from missionplanner.plan import FleetPlan, Trajectory, VehiclePlan
from missionplanner.vehicle import Autopilot, Ending, VehicleClass, motion_model

FRAME = LocalFrame(34.36, -118.18)


def vehicle_plan(
    name: str = "uav1",
    sysid: int = 1,
    *,
    autopilot: Autopilot = "ardupilot",
    vehicle_class: VehicleClass = "copter",
    end: Ending = "land",
    home_m: tuple[float, float, float] = (0.0, 0.0, 1200.0),
    waypoints_m: object = ((0.0, 0.0, 1230.0), (120.0, 40.0, 1251.25), (240.0, -35.0, 1244.5)),
    speed_m_s: float = 7.3,
    start_delay_s: float = 0.0,
) -> VehiclePlan:
    """Return a vehicle that flies its legs at constant speed and sinks to 1190 m (or climbs home) at the end."""
    points = np.array(waypoints_m, dtype=float)
    home = np.array(home_m, dtype=float)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    reached_s = start_delay_s + 12.0 + np.concatenate([[0.0], np.cumsum(lengths / speed_m_s)])
    down = np.array([*points[-1, :2], 1190.0]) if end == "land" else home if end == "rtl" else points[-1]
    trajectory = Trajectory(
        np.concatenate([[start_delay_s], reached_s, [reached_s[-1] + 30.0]]), np.vstack([home, points, down])
    )
    settings = Vehicle(name=name, autopilot=autopilot, vehicle_class=vehicle_class, goal=_GOAL, home=_GOAL)
    return VehiclePlan(
        name=name,
        sysid=sysid,
        autopilot=autopilot,
        vehicle_class=vehicle_class,
        motion=motion_model(settings),
        home_m=home,
        path_m=points,
        waypoints_m=points,
        end=end,
        length_m=float(lengths.sum()),
        speeds_m_s=np.full(len(points) - 1, speed_m_s),
        hold_s=np.zeros(len(points) - 1),
        start_delay_s=start_delay_s,
        window_s=(float(reached_s[-1]) - 5.0, float(reached_s[-1]) + 50.0),
        arrival_s=float(reached_s[-1]),
        reached_s=reached_s,
        trajectory=trajectory,
        cost=1.0,
        cost_terms={"voyage": 1.0},
        history=np.array([2.0, 1.0]),
        evaluations=100,
        clearances=(),
    )


_GOAL = Point(x_m=0.0, y_m=0.0, alt_amsl_m=1244.5)


def fleet_plan(*vehicles: VehiclePlan) -> FleetPlan:
    """Return a fleet of these vehicles (one default vehicle where none is given)."""
    plans = vehicles or (vehicle_plan(),)
    mission = Mission(
        name="by-hand",
        description='legs & ends, <simple> and "plain"',
        origin=Origin(lat_deg=FRAME.origin_lat_deg, lon_deg=FRAME.origin_lon_deg),
        terrain=FlatTerrain(kind="flat", alt_amsl_m=1190.0),
        vehicles=tuple(Vehicle(name=plan.name, goal=_GOAL, home=_GOAL) for plan in plans),
    )
    return FleetPlan(mission, FRAME, plans, None, None, 1, "0", "0" * 64)


def small_fleet(autopilot: Autopilot, count: int = 3, end: Ending = "land") -> FleetPlan:
    """Return ``count`` copters side by side, 40 m apart."""
    return fleet_plan(
        *(
            vehicle_plan(
                f"uav{k}",
                k,
                autopilot=autopilot,
                end=end,
                home_m=(0.0, 40.0 * k, 1200.0),
                waypoints_m=((0.0, 40.0 * k, 1225.0), (80.0, 40.0 * k, 1230.0), (160.0, 40.0 * k, 1228.0)),
                speed_m_s=8.0,
            )
            for k in range(1, count + 1)
        )
    )
