"""What is predicted of a vehicle is what the simulated one flies, for every kind of vehicle and every ending."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from missionplanner.plan import FlownVehicle, VehiclePlan
from missionplanner.timing import predict_flight
from missionplanner.vehicle import Autopilot, Ending, VehicleClass
from tests.plans import fleet_plan, vehicle_plan
from tests.rig import Rig

_GROUND_AMSL_M = 1190.0
_LEGS = {
    "copter": [(0.0, 0.0, 1230.0), (120.0, 40.0, 1251.25), (240.0, -35.0, 1244.5), (300.0, 60.0, 1240.0)],
    "plane": [(250.0, 0.0, 1250.0), (700.0, 150.0, 1260.0), (1200.0, -200.0, 1255.0), (1800.0, 0.0, 1250.0)],
}
_SPEEDS_M_S = {"copter": (4.0, 8.5), "plane": (15.0, 19.0)}


def _planned(
    autopilot: Autopilot,
    vehicle_class: VehicleClass,
    end: Ending,
    *,
    speed_m_s: float,
    waypoint_radius_m: float | None = None,
    start_delay_s: float = 0.0,
) -> VehiclePlan:
    plan = vehicle_plan(
        autopilot=autopilot,
        vehicle_class=vehicle_class,
        end=end,
        waypoints_m=_LEGS[vehicle_class],
        speed_m_s=speed_m_s,
        start_delay_s=start_delay_s,
    )
    motion = plan.motion
    if waypoint_radius_m is not None:
        motion = replace(motion, waypoint_radius_m=waypoint_radius_m)
    trajectory, reached_s = predict_flight(
        motion,
        plan.home_m,
        plan.waypoints_m,
        speed_m_s,
        end=end,
        ground_amsl_m=_GROUND_AMSL_M,
        start_delay_s=start_delay_s,
    )
    arrival_s = float(reached_s[-1])
    return replace(plan, motion=motion, trajectory=trajectory, reached_s=reached_s, arrival_s=arrival_s)


def _flown(plan: VehiclePlan) -> FlownVehicle:
    rig = Rig(fleet_plan(plan), ground=lambda _x, _y: _GROUND_AMSL_M)
    rig.upload()
    rig.link.start()
    return rig.link.watch().vehicles[0]


def _agree(plan: VehiclePlan, flown: FlownVehicle, off_max_m: float = 0.3) -> None:
    assert flown.arrival_s == pytest.approx(plan.arrival_s, abs=0.1)
    off_m = np.linalg.norm(flown.trajectory.position_m - plan.trajectory.at(flown.trajectory.t_s), axis=1)
    assert off_m.max() < off_max_m


@pytest.mark.parametrize("speed", [0, 1])
@pytest.mark.parametrize("end", ["land", "rtl", "loiter"])
@pytest.mark.parametrize("vehicle_class", ["copter", "plane"])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_flown_as_predicted(autopilot: Autopilot, vehicle_class: VehicleClass, end: Ending, speed: int) -> None:
    plan = _planned(autopilot, vehicle_class, end, speed_m_s=_SPEEDS_M_S[vehicle_class][speed])
    flown = _flown(plan)
    # on the way home at 10 m/s, a point reached a tick or two later (waypoints travel in centimetres) shows
    _agree(plan, flown, off_max_m=1.5 if end == "rtl" else 0.3)
    lands = end == "land" or (end == "rtl" and vehicle_class == "copter")
    if lands:
        assert flown.landed_s == pytest.approx(plan.trajectory.t_s[-1], abs=0.2)
        ground_amsl_m = _GROUND_AMSL_M if end == "land" else plan.home_m[2]
        # a plane is seen down within a fifth of a second, and sinks several metres in each
        assert flown.trajectory.position_m[-1, 2] == pytest.approx(ground_amsl_m, abs=1.0)
    else:
        assert flown.landed_s is None


@pytest.mark.parametrize("end", ["land", "loiter"])
def test_px4_that_accepts_its_goal_from_afar(end: Ending) -> None:
    plan = _planned("px4", "copter", end, speed_m_s=6.0, waypoint_radius_m=10.0)
    flown = _flown(plan)
    _agree(plan, flown)
    if end == "land":  # at the place of its LAND item
        assert flown.trajectory.position_m[-1, :2] == pytest.approx(plan.waypoints_m[-1, :2], abs=0.2)


@pytest.mark.parametrize("vehicle_class", ["copter", "plane"])
def test_a_later_start(vehicle_class: VehicleClass) -> None:
    plan = _planned("ardupilot", vehicle_class, "loiter", speed_m_s=_SPEEDS_M_S[vehicle_class][1], start_delay_s=12.4)
    _agree(plan, _flown(plan), off_max_m=0.8)  # the start is ordered between two ticks
