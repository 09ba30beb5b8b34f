"""Planned in steady wind and flown in it: the fleet arrives together; planes crab, and tell of the wind."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import in_process_pair
from missionplanner.flight_check import check_flight
from missionplanner.mission import VehicleSettings, Wind, load_mission
from missionplanner.motion import TICK_S, Route
from missionplanner.planner import plan_fleet
from missionplanner.scene import build_scene
from missionplanner.vehicle import Autopilot, motion_model
from sim.fleet import SimFleet, SimVehicle
from tests.main_job import fly, mission_path
from tests.simulated import HOME


@pytest.mark.parametrize(("speed_m_s", "from_deg"), [(5.0, 270.0), (5.0, 160.0), (7.0, 45.0)])
def test_the_quickstart_planned_in_wind_arrives_together_in_it(speed_m_s: float, from_deg: float) -> None:
    path = mission_path("quickstart")
    mission = load_mission(path).model_copy(update={"wind": Wind(speed_m_s=speed_m_s, from_deg=from_deg)})
    scene = build_scene(mission, path.parent)
    plan = plan_fleet(scene, seed=7)
    flight = fly(scene, plan)
    assert check_flight(scene, plan, flight).ok
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s <= 0.5
    for planned, flown in zip(plan.vehicles, flight.vehicles, strict=True):
        assert flown.arrival_s == pytest.approx(planned.arrival_s, abs=0.2)
        off_m = np.linalg.norm(flown.trajectory.position_m - planned.trajectory.at(flown.trajectory.t_s), axis=1)
        assert np.percentile(off_m, 95) < 1.0


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_plane_tells_of_the_wind_and_points_into_it(autopilot: Autopilot) -> None:
    settings = VehicleSettings.model_validate({"class": "plane", "autopilot": autopilot})
    model = motion_model(settings, Wind(speed_m_s=6.0, from_deg=0.0).velocity_m_s)
    fleet = SimFleet([SimVehicle(1, autopilot, "plane", HOME, model)])
    theirs, pipe = in_process_pair()
    fleet.attach(theirs)
    fleet.links[0].autopilot.landed = False
    start = fleet.navigator.position_m[0].copy()
    fleet.navigator.follow(0, *Route.through([start + np.array([3000.0, 0.0, 100.0])], model.cruise_speed_m_s))
    parser = mavlink.MAVLink(None)
    last = {}
    for _ in range(round(60.0 / TICK_S)):
        fleet.step()
        for data, _ in pipe.receive():
            last.update({message.get_type(): message for message in parser.parse_buffer(data) or ()})
    east, north = fleet.navigator.velocity_m_s[0, :2]
    nose = math.degrees(math.atan2(east, north + 6.0))
    assert nose < 85.0  # into the wind from the north, while its course is east
    assert last["VFR_HUD"].heading == pytest.approx(nose, abs=1.5)
    assert last["GLOBAL_POSITION_INT"].hdg / 100 == pytest.approx(nose, abs=1.0)
    assert last["GPS_RAW_INT"].cog / 100 == pytest.approx(math.degrees(math.atan2(east, north)), abs=1.0)
    assert last["VFR_HUD"].groundspeed == pytest.approx(math.hypot(east, north), abs=0.2)
    through = math.hypot(east, north + 6.0)
    assert last["VFR_HUD"].airspeed < through  # true airspeed is more than what the sensor shows, 600 m up
    assert last["VFR_HUD"].airspeed == pytest.approx(through, rel=0.06)
    if autopilot == "ardupilot":
        assert (last["WIND"].direction, last["WIND"].speed) == pytest.approx((0.0, 6.0), abs=1e-3)
    else:
        assert (last["WIND_COV"].wind_x, last["WIND_COV"].wind_y) == pytest.approx((-6.0, 0.0), abs=1e-3)
