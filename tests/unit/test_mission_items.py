"""Mission items as each autopilot wants them, and back to waypoints."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adapters.mission_items import (
    MissionItem,
    degrees_to_wire,
    fleet_items,
    float32_text,
    goal_seq,
    item_waypoints,
    plan_items,
)
from missionplanner.errors import MissionError
from missionplanner.vehicle import Autopilot, Ending, VehicleClass
from tests.plans import FRAME, fleet_plan, vehicle_plan


def test_ardupilot_keeps_seq_0_for_home_and_takes_off_above_it() -> None:
    items = plan_items(vehicle_plan(), FRAME)
    assert [(item.command, item.frame) for item in items] == [(16, 0), (22, 3), (178, 2), (16, 0), (16, 0), (21, 0)]
    assert [item.seq for item in items] == list(range(6))
    assert [item.current for item in items] == [1, 0, 0, 0, 0, 0]
    home, takeoff, speed, first, goal, land = items
    assert (home.x, home.y, home.z) == (343_600_000, -1_181_800_000, 1200.0)
    assert takeoff.z == 30.0
    assert (speed.param1, speed.param3, speed.param4) == (1.0, -1.0, 0.0)
    assert speed.param2 == pytest.approx(7.3, abs=1e-6)
    assert (speed.x, speed.y, speed.z) == (0, 0, 0.0)
    assert first.z == 1251.25
    assert (land.x, land.y) == (goal.x, goal.y)
    assert land.z == 1190.0
    assert all(
        not math.isnan(value) for item in items for value in (item.param1, item.param2, item.param3, item.param4)
    )


def test_px4_has_no_home_and_leaves_the_heading_to_the_vehicle() -> None:
    items = plan_items(vehicle_plan(autopilot="px4"), FRAME)
    assert [(item.command, item.frame) for item in items] == [(22, 0), (178, 2), (16, 0), (16, 0), (21, 0)]
    assert items[0].current == 1
    assert items[0].z == 1230.0
    assert all(math.isnan(item.param4) for item in items if item.command != 178)
    assert [item.param2 for item in items if item.command == 16] == [2.0, 2.0]


@pytest.mark.parametrize(("end", "command", "frame"), [("land", 21, 0), ("rtl", 20, 2), ("loiter", 17, 0)])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_the_end_follows_the_goal(autopilot: Autopilot, end: Ending, command: int, frame: int) -> None:
    items = plan_items(vehicle_plan(autopilot=autopilot, end=end), FRAME)
    assert (items[-1].command, items[-1].frame) == (command, frame)
    assert goal_seq(items) == items[-1].seq - 1
    if end == "rtl":  # ArduPilot refuses NaN there
        assert [items[-1].param1, items[-1].param2, items[-1].param3, items[-1].param4] == [0.0] * 4


@pytest.mark.parametrize(("vehicle_class", "kind"), [("copter", 1.0), ("plane", 0.0)])
def test_planes_fly_by_airspeed(vehicle_class: VehicleClass, kind: float) -> None:
    [speed] = [i for i in plan_items(vehicle_plan(vehicle_class=vehicle_class), FRAME) if i.command == 178]
    assert speed.param1 == kind


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_planes_are_told_what_they_would_take_from_parameters(autopilot: Autopilot) -> None:
    plan = vehicle_plan(autopilot=autopilot, vehicle_class="plane", end="loiter")
    items = plan_items(plan, FRAME)
    takeoff = next(i for i in items if i.command == 22)
    assert takeoff.param1 == 15.0
    assert items[-2].param2 == plan.motion.waypoint_radius_m == 50.0
    assert items[-1].param3 == plan.motion.loiter_radius_m == {"ardupilot": 60.0, "px4": 80.0}[autopilot]


def test_items_by_sysid() -> None:
    plan = fleet_plan(vehicle_plan("a", 3), vehicle_plan("b", 7, autopilot="px4"))
    items = fleet_items(plan)
    assert set(items) == {3, 7}
    assert [len(items[3]), len(items[7])] == [6, 5]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_waypoints_come_back(autopilot: Autopilot) -> None:
    vehicle = vehicle_plan(autopilot=autopilot)
    back = item_waypoints(plan_items(vehicle, FRAME), autopilot, FRAME)
    assert back.shape == vehicle.waypoints_m.shape
    np.testing.assert_allclose(back[:, :2], vehicle.waypoints_m[:, :2], atol=0.012)  # half of 1e-7 degree is 6 mm
    np.testing.assert_allclose(back[:, 2], vehicle.waypoints_m[:, 2], atol=1e-3)


def test_heights_above_terrain_are_not_guessed() -> None:
    items = (MissionItem(0, 0, 16), MissionItem(1, 10, 16, z=30.0))
    with pytest.raises(MissionError, match="item 1: expected an altitude AMSL"):
        item_waypoints(items, "ardupilot", FRAME)
    with pytest.raises(MissionError, match="frame 3"):
        item_waypoints((MissionItem(0, 3, 22, z=30.0),), "px4", FRAME)


def test_a_mission_without_waypoint_has_no_goal() -> None:
    with pytest.raises(MissionError, match="at least one waypoint"):
        goal_seq((MissionItem(0, 2, 20),))


def test_an_item_that_the_wire_cannot_carry_is_refused() -> None:
    with pytest.raises(MissionError, match="item 4: expected a frame up to 255 and a command up to 65535"):
        MissionItem(4, 0, 70_000)


def test_scaling_rounds() -> None:
    assert degrees_to_wire(34.3599999999) == 343_600_000
    assert degrees_to_wire(-118.18000004) == -1_181_800_000
    assert degrees_to_wire(-118.18000006) == -1_181_800_001


def test_numbers_are_written_short() -> None:
    assert [float32_text(value) for value in (7.3, -1.0, 0.0, math.nan, 1251.2501)] == [
        "7.3",
        "-1",
        "0",
        "nan",
        "1251.2501",
    ]


def test_what_single_precision_cannot_hold_is_infinite() -> None:
    assert MissionItem(0, 0, 16, 1e300).param1 == math.inf
