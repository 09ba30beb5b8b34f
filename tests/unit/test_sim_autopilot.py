"""Modes, arming and mission execution, with the traps that real autopilots set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem
from missionplanner.mission import VehicleSettings
from missionplanner.vehicle import Autopilot, VehicleClass, motion_model
from sim.autopilot import LandedState, MissionState
from sim.personality import personality
from tests.simulated import LAT, LON, NAN, Ground, mission, of_type, renumbered, texts

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
ACCEPTED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_FAILED
REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED


def flying(autopilot: Autopilot, items: list[MissionItem] | None = None, after_s: float = 20.0) -> Ground:
    """Return a vehicle some time into its mission."""
    ground = Ground(autopilot)
    assert ground.upload(items or mission(autopilot)) == mavlink.MAV_MISSION_ACCEPTED
    if autopilot == "ardupilot":
        assert ground.mode("GUIDED") == ACCEPTED
        assert ground.arm() == ACCEPTED
    assert ground.start() == ACCEPTED
    ground.run(after_s)
    return ground


@BOTH
def test_mission_is_flown_to_the_end_and_landed(autopilot: Autopilot) -> None:
    ground = flying(autopilot)
    ground.fly_mission()
    assert ground.autopilot.mission_state is MissionState.COMPLETE
    assert not ground.autopilot.armed
    assert ground.autopilot.landed
    last = mission(autopilot)[-1]
    expected = ground.fleet.frame.to_local(last.x * 1e-7, last.y * 1e-7, 584.0)
    assert ground.autopilot.position_m == pytest.approx(expected, abs=0.1)
    assert {m.landed_state for m in of_type(ground.heard, "EXTENDED_SYS_STATE")} == set(LandedState)


@BOTH
def test_current_item_goes_through_what_is_flown(autopilot: Autopilot) -> None:
    ground = flying(autopilot, after_s=0.0)
    ground.fly_mission()
    seqs = [m.seq for m in of_type(ground.heard, "MISSION_CURRENT") if m.mission_state == MissionState.ACTIVE]
    first = 1 if autopilot == "ardupilot" else 0
    assert list(dict.fromkeys(seqs)) == [first, first + 2, first + 3, first + 4]


def test_ardupilot_hides_an_item_reached_behind_a_do_item() -> None:
    ground = flying("ardupilot")
    ground.fly_mission()
    assert [m.seq for m in of_type(ground.heard, "MISSION_ITEM_REACHED")] == [2, 3, 4, 5]  # 1, the take-off, is hidden
    said = texts(ground.heard)
    assert [t for t in said if t.startswith("Reached")] == ["Reached command #3", "Reached command #4"]
    assert "Mission: 1 Takeoff" in said


def test_px4_reports_every_item_and_the_last_one_again() -> None:
    ground = flying("px4")
    ground.fly_mission()
    ground.run(20.0)
    reached = [m.seq for m in of_type(ground.heard, "MISSION_ITEM_REACHED")]
    assert list(dict.fromkeys(reached)) == sorted(set(reached)) == [0, 1, 2, 3, 4]
    assert reached.count(4) == 11  # MavlinkMissionManager::send: "another 10 times"
    ground.upload(mission("px4"))
    assert not of_type(ground.run(5.0), "MISSION_ITEM_REACHED")


@BOTH
def test_a_reboot_loses_what_is_not_stored(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    ground.upload(mission(autopilot))
    ground.run(20.0)
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, 3, mavlink.MAV_MISSION_TYPE_RALLY))
    assert ground.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) == ACCEPTED
    assert ground.send(mavlink.MAVLink_mission_request_list_message(1, 1)) == []
    assert ground.run(2.9) == []
    heard = ground.run(4.0)
    assert ground.arm() != ACCEPTED
    heard += ground.run(5.0)
    assert not of_type(heard, "MISSION_REQUEST") and not of_type(heard, "MISSION_ACK")
    boots = [m.time_boot_ms for m in of_type(heard, "GLOBAL_POSITION_INT")]
    assert 0 <= min(boots) <= max(boots) < 9_500  # its clock starts anew
    assert len(ground.vehicle.missions.items()) == len(mission(autopilot))
    ground.run(35.0)
    assert ground.mode("GUIDED" if autopilot == "ardupilot" else "POSCTL") == ACCEPTED
    assert ground.arm() == ACCEPTED
    assert ground.command(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0) != ACCEPTED  # armed


def test_a_reboot_in_the_air_is_a_fall() -> None:
    ground = flying("ardupilot")
    ground.vehicle.reboot(ground.fleet.now_s)
    ground.run(30.0)
    assert ground.autopilot.landed and not ground.autopilot.armed
    assert ground.autopilot.position_m[2] == pytest.approx(584.0, abs=0.1)
    assert ground.autopilot.mission_state is MissionState.NOT_STARTED


def test_takeoff_sent_to_ardupilot_as_seq_0_is_lost() -> None:
    ground = Ground("ardupilot")
    ground.upload(renumbered(mission("ardupilot")[1:]))
    ground.mode("GUIDED")
    ground.arm()
    assert ground.start() == FAILED
    assert "Auto: Missing Takeoff Cmd" in texts(ground.run(0.2))


def test_ardupilot_accepts_a_start_while_disarmed_and_does_nothing() -> None:
    ground = Ground("ardupilot")
    ground.upload(mission("ardupilot"))
    assert ground.start() == ACCEPTED
    assert ground.arm() == FAILED  # for AUTO is no mode to arm in
    assert "Arm: AUTO mode not armable" in texts(ground.run(0.2))
    ground.run(5.0)
    assert ground.autopilot.landed
    assert ground.autopilot.mission_state is MissionState.NOT_STARTED


def test_px4_arms_by_mission_start() -> None:
    ground = flying("px4", after_s=10.0)
    assert ground.autopilot.armed
    assert not ground.autopilot.landed


@BOTH
def test_idle_armed_copter_disarms_after_10_s(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    ground.mode("GUIDED" if autopilot == "ardupilot" else "POSCTL")
    ground.arm()
    ground.run(9.5)
    assert ground.autopilot.armed
    ground.run(1.0)
    assert not ground.autopilot.armed


@BOTH
def test_no_mission_no_start(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    assert ground.start() == (FAILED if autopilot == "ardupilot" else REJECTED)
    assert not ground.autopilot.flying_mission


@pytest.mark.parametrize(("autopilot", "ready_s"), [("ardupilot", 42.0), ("px4", 10.0)])
def test_cold_vehicle_is_not_ready(autopilot: Autopilot, ready_s: float) -> None:
    ground = Ground(autopilot, cold_start=True)
    assert ground.arm() != ACCEPTED
    ground.run(ready_s + 0.1)
    assert ground.arm() == ACCEPTED


def test_ardupilot_without_throttle_waits_for_mission_start() -> None:
    ground = Ground("ardupilot")
    ground.autopilot.parameters["AUTO_OPTIONS"] = 0
    ground.upload(mission("ardupilot"))
    ground.mode("GUIDED")
    ground.arm()
    assert ground.mode("AUTO") == ACCEPTED
    ground.run(3.0)
    assert ground.autopilot.landed
    assert ground.start() == ACCEPTED
    ground.run(5.0)
    assert not ground.autopilot.landed


def test_commanded_speed_is_flown() -> None:
    top = []
    for speed_m_s in (2.0, 5.0):
        ground = flying("ardupilot", mission("ardupilot", speed_m_s=speed_m_s))
        hud = of_type(ground.run(25.0), "VFR_HUD")
        top.append(max(m.groundspeed for m in hud))
    assert top == [pytest.approx(2.0, abs=0.2), pytest.approx(5.0, abs=0.2)]


def test_ardupilot_ignores_speeds_that_are_not_speeds() -> None:
    ground = flying("ardupilot")
    for value, result in ((0.0, FAILED), (-1.0, FAILED), (0.1, ACCEPTED)):
        assert ground.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, value, -1) == result
    assert ground.autopilot.speed_m_s == 8.0


def test_px4_returns_to_its_own_speed_when_told_zero() -> None:
    ground = flying("px4")
    ground.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 1, 0.0, -1)
    assert ground.autopilot.speed_m_s == 5.0


@BOTH
def test_hold_and_resume_loses_no_item(autopilot: Autopilot) -> None:
    ground = flying(autopilot)
    before = ground.autopilot.current
    ground.mode("LOITER")
    ground.run(20.0)
    assert ground.autopilot.mission_state is MissionState.PAUSED
    here = ground.autopilot.position_m
    ground.run(5.0)
    assert ground.autopilot.position_m == pytest.approx(here, abs=0.1)
    assert ground.mode("AUTO" if autopilot == "ardupilot" else "MISSION") == ACCEPTED
    assert ground.autopilot.current == before
    ground.fly_mission()
    assert ground.autopilot.mission_state is MissionState.COMPLETE


def test_px4_forgets_the_missions_speed_when_it_leaves_the_mission() -> None:
    ground = flying("px4")
    assert ground.autopilot.speed_m_s == 8.0
    ground.mode("LOITER")
    assert ground.autopilot.speed_m_s == 5.0


def test_pause_stops_and_continue_goes_on() -> None:
    ground = flying("ardupilot")
    ground.command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0)
    ground.run(20.0)
    assert float(np.linalg.norm(ground.fleet.navigator.velocity_m_s[0])) < 0.01
    ground.command(mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1)
    ground.fly_mission()
    assert ground.autopilot.mission_state is MissionState.COMPLETE


@BOTH
@pytest.mark.parametrize("ending", [mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, mavlink.MAV_CMD_NAV_LAND])
def test_command_brings_it_down(autopilot: Autopilot, ending: int) -> None:
    ground = flying(autopilot, after_s=25.0)
    where = ground.autopilot.position_m
    assert ground.command(ending) == ACCEPTED
    ground.fly_mission()
    down = ground.autopilot.position_m
    target = ground.autopilot.home_m if ending == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH else where
    assert down[2] == pytest.approx(584.0, abs=0.1)
    assert np.hypot(*(down - target)[:2]) < (0.1 if ending == mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH else 25.0)
    assert not ground.autopilot.armed


@BOTH
def test_mission_that_ends_with_rtl_ends_at_home(autopilot: Autopilot) -> None:
    ground = flying(autopilot, mission(autopilot, mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH))
    ground.fly_mission()
    assert ground.autopilot.position_m == pytest.approx(ground.autopilot.home_m, abs=0.1)
    assert ground.autopilot.mission_state is MissionState.COMPLETE


RETURN_ALT = {"ardupilot": ("RTL_ALT", 0.01), "px4": ("RTL_RETURN_ALT", 1.0)}


@BOTH
@pytest.mark.parametrize("vehicle_class", ["copter", "plane"])
def test_the_heights_that_autopilots_return_at_by_default_are_the_motion_models(
    autopilot: Autopilot, vehicle_class: VehicleClass
) -> None:
    ground = Ground(autopilot, vehicle_class)
    model = motion_model(VehicleSettings(autopilot=autopilot, vehicle_class=vehicle_class))
    height_m = ground.autopilot.personality.return_height_m(ground.autopilot.parameters, 1.0, 500.0)
    assert height_m == pytest.approx(model.return_height_m)


@BOTH
@pytest.mark.parametrize("height_m", [12.0, 37.5, 80.0])
def test_a_copter_returns_as_high_as_its_parameter_says(autopilot: Autopilot, height_m: float) -> None:
    ground = flying(autopilot, after_s=25.0)
    name, unit = RETURN_ALT[autopilot]
    ground.autopilot.parameters[name] = type(ground.autopilot.parameters[name])(height_m / unit)
    begun_m = float(ground.autopilot.position_m[2]) - 584.0
    assert ground.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    highest_m = 0.0
    while ground.autopilot.armed and ground.fleet.now_s < 300.0:
        ground.run(0.5)
        highest_m = max(highest_m, float(ground.autopilot.position_m[2]) - 584.0)
    assert highest_m == pytest.approx(max(height_m, begun_m), abs=0.3)
    assert ground.autopilot.position_m == pytest.approx(ground.autopilot.home_m, abs=0.2)


@pytest.mark.parametrize(
    ("cone", "climb", "height_m", "distance_m", "returns_m"),
    [
        (3.0, 0, 4.0, 3.0, 9.0),  # of a cone near home
        (3.0, 0, 12.0, 3.0, 12.0),  # never down
        (3.0, 0, 4.0, 50.0, 15.0),
        (0.4, 0, 4.0, 3.0, 15.0),  # too shallow to be one
        (0.0, 0, 4.0, 0.5, 15.0),
        (0.0, 500, 20.0, 50.0, 25.0),
        (3.0, 500, 4.0, 1.0, 9.0),
    ],
)
def test_arducopter_climbs_less_near_home(
    cone: float, climb: int, height_m: float, distance_m: float, returns_m: float
) -> None:
    parameters = {"RTL_ALT": 1500, "RTL_CONE_SLOPE": cone, "RTL_CLIMB_MIN": climb}
    found_m = personality("ardupilot", "copter").return_height_m(parameters, height_m, distance_m)
    assert found_m == pytest.approx(returns_m)


@pytest.mark.parametrize(
    ("angle", "height_m", "distance_m", "returns_m"),
    [
        (0, 5.0, 1.0, 60.0),
        (45, 5.0, 8.0, 8.0),
        (45, 5.0, 12.0, 60.0),  # beyond RTL_MIN_DIST
        (45, 1.0, 1.5, 3.0),  # within NAV_ACC_RAD
        (80, 1.0, 8.0, 4.0),
        (45, 70.0, 8.0, 70.0),
    ],
)
def test_px4_climbs_less_near_home(angle: int, height_m: float, distance_m: float, returns_m: float) -> None:
    parameters = {"RTL_RETURN_ALT": 60.0, "RTL_CONE_ANG": angle, "RTL_MIN_DIST": 10.0, "NAV_ACC_RAD": 2.0}
    found_m = personality("px4", "copter").return_height_m(parameters, height_m, distance_m)
    assert found_m == pytest.approx(returns_m)


def test_loiter_at_the_end_stays_armed_and_active() -> None:
    ground = flying("ardupilot", mission("ardupilot", mavlink.MAV_CMD_NAV_LOITER_UNLIM), after_s=120.0)
    assert ground.autopilot.armed
    assert ground.autopilot.mission_state is MissionState.ACTIVE
    assert ground.autopilot.current == 5


def test_waypoint_with_a_hold_is_a_full_stop() -> None:
    items = mission("ardupilot")
    items[3] = replace(items[3], param1=5.0)
    held, free = flying("ardupilot", items, after_s=0.0), flying("ardupilot", after_s=0.0)
    held.fly_mission()
    free.fly_mission()
    assert held.fleet.now_s - free.fleet.now_s > 5.0


def test_delay_waits() -> None:
    items = mission("ardupilot")
    delay = MissionItem(0, 2, mavlink.MAV_CMD_NAV_DELAY, 12.0)
    waiting = flying("ardupilot", renumbered([*items[:4], delay, *items[4:]]), after_s=0.0)
    free = flying("ardupilot", after_s=0.0)
    waiting.fly_mission()
    free.fly_mission()
    assert waiting.fleet.now_s - free.fleet.now_s == pytest.approx(14.0, abs=3.0)


def test_jump_repeats_as_often_as_told() -> None:
    items = mission("ardupilot")
    jump = MissionItem(0, 2, mavlink.MAV_CMD_DO_JUMP, 3.0, 2.0)
    ground = flying("ardupilot", renumbered([*items[:5], jump, items[5]]))
    ground.fly_mission()
    assert texts(ground.heard).count("Reached command #3") == 3
    assert ground.autopilot.mission_state is MissionState.COMPLETE


@pytest.mark.parametrize(
    ("autopilot", "target"), [("ardupilot", 5.0), ("px4", 4.0), ("px4", 0.5), ("px4", 99.0), ("px4", -3.0)]
)
def test_jump_to_nowhere_is_passed_over_and_jumping_in_place_ends(autopilot: Autopilot, target: float) -> None:
    items = mission(autopilot)
    jump = MissionItem(0, 2, mavlink.MAV_CMD_DO_JUMP, target, 2.0)
    ground = flying(autopilot, renumbered([*items[:-1], jump, items[-1]]))
    ground.run(120.0)
    assert ground.autopilot.mission_state is MissionState.COMPLETE or not ground.autopilot.armed


@pytest.mark.parametrize("target", [0.0, 99.0, -3.0, NAN])
def test_ardupilot_refuses_a_jump_to_nowhere(target: float) -> None:
    items = mission("ardupilot")
    jump = MissionItem(0, 2, mavlink.MAV_CMD_DO_JUMP, target, -1.0)
    assert Ground("ardupilot").upload(renumbered([*items[:5], jump, items[5]])) != mavlink.MAV_MISSION_ACCEPTED


@BOTH
def test_set_current_before_and_during_the_flight(autopilot: Autopilot) -> None:
    ground = flying(autopilot)
    last = len(mission(autopilot)) - 1
    assert ground.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, last) == ACCEPTED
    assert ground.autopilot.current == last
    assert ground.command(mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, last + 1) != ACCEPTED
    ground.fly_mission()
    assert ground.autopilot.mission_state is MissionState.COMPLETE


def test_new_mission_in_flight_is_taken_up() -> None:
    ground = flying("ardupilot")
    items = mission("ardupilot")
    items[4] = replace(items[4], y=LON + 20_000)
    ground.upload(items)
    ground.run(60.0)
    assert min(abs(m.lon - items[4].y) for m in of_type(ground.heard, "GLOBAL_POSITION_INT")) < 300


def test_second_mission_begins_at_its_beginning() -> None:
    ground = flying("ardupilot")
    ground.fly_mission()
    assert ground.mode("GUIDED") == ACCEPTED
    assert ground.arm() == ACCEPTED
    assert ground.start() == ACCEPTED
    ground.run(2.0)
    assert ground.autopilot.current == 1
    assert ground.autopilot.mission_state is MissionState.ACTIVE


def test_takeoff_by_command_needs_guided_and_arms_on_ardupilot() -> None:
    ground = Ground("ardupilot")
    assert ground.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 15.0) == FAILED
    ground.mode("GUIDED")
    assert ground.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 15.0) == FAILED
    ground.arm()
    assert ground.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 15.0) == ACCEPTED
    ground.run(20.0)
    assert ground.autopilot.position_m[2] == pytest.approx(599.0, abs=0.05)


def test_reposition_flies_there() -> None:
    ground = flying("px4", after_s=30.0)
    x, y = LAT + 9_000, LON - 9_000
    reposition = mavlink.MAVLink_command_int_message(
        1, 1, 0, mavlink.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1.0, 0.0, float("nan"), x, y, 620.0
    )
    acks = of_type(ground.send(reposition), "COMMAND_ACK")
    assert [a.result for a in acks] == [ACCEPTED]
    ground.run(60.0)
    there = ground.fleet.frame.to_local(x * 1e-7, y * 1e-7, 620.0)
    assert np.linalg.norm(ground.autopilot.position_m - there) < 11.0


@BOTH
def test_disarm_in_the_air_needs_force(autopilot: Autopilot) -> None:
    ground = flying(autopilot)
    assert ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0) != ACCEPTED
    assert ground.autopilot.armed
    assert ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 21196) == ACCEPTED
    ground.run(60.0)
    assert not ground.autopilot.armed
    assert ground.autopilot.position_m[2] == pytest.approx(584.0, abs=0.1)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_plane_flies_its_mission_and_circles(autopilot: Autopilot) -> None:
    ground = Ground(autopilot, "plane")
    amsl = mavlink.MAV_FRAME_GLOBAL
    home = [MissionItem(0, amsl, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT, y=LON, z=584.0)]
    places = [(30_000, 0), (60_000, 30_000), (30_000, 60_000)]
    items = [
        *(home if autopilot == "ardupilot" else []),
        MissionItem(0, amsl, mavlink.MAV_CMD_NAV_TAKEOFF, 10.0, x=LAT + 30_000, y=LON, z=640.0),
        *(MissionItem(0, amsl, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT + dx, y=LON + dy, z=660.0) for dx, dy in places),
        MissionItem(0, amsl, mavlink.MAV_CMD_NAV_LOITER_UNLIM, x=LAT, y=LON, z=680.0),
    ]
    assert ground.upload(renumbered(items)) == mavlink.MAV_MISSION_ACCEPTED
    assert ground.arm() == ACCEPTED
    assert ground.start() == ACCEPTED
    ground.run(200.0)
    assert ground.autopilot.current == len(items) - 1
    assert ground.autopilot.armed
    assert np.hypot(*(ground.autopilot.position_m - ground.autopilot.home_m)[:2]) < 250.0


def test_arduplane_has_no_mode_that_lands() -> None:
    ground = Ground("ardupilot", "plane")
    assert ground.command(mavlink.MAV_CMD_NAV_LAND) == mavlink.MAV_RESULT_UNSUPPORTED


def test_uploading_the_same_mission_in_flight_disturbs_nothing() -> None:
    disturbed, calm = flying("ardupilot"), flying("ardupilot")
    disturbed.upload(mission("ardupilot"))
    disturbed.run(10.0)
    calm.run(10.0)
    assert disturbed.autopilot.position_m == pytest.approx(calm.autopilot.position_m, abs=1e-9)


@pytest.mark.parametrize(("speed_m_s", "flown_m_s"), [(18.0, 18.0), (35.0, 22.0), (5.0, 22.0)])
def test_arduplane_ignores_speeds_outside_its_limits(speed_m_s: float, flown_m_s: float) -> None:
    ground = Ground("ardupilot", "plane")
    ground.mode("GUIDED")
    expected = ACCEPTED if speed_m_s == flown_m_s else FAILED
    assert ground.command(mavlink.MAV_CMD_DO_CHANGE_SPEED, 0, speed_m_s, -1) == expected
    assert ground.autopilot.speed_m_s == flown_m_s


@BOTH
def test_a_plane_that_lands_meets_the_ground_and_stands(autopilot: Autopilot) -> None:
    ground = Ground(autopilot, "plane")
    ground.upload(mission(autopilot, mavlink.MAV_CMD_NAV_LAND, speed_m_s=18.0))
    ground.mode("AUTO" if autopilot == "ardupilot" else "MISSION")
    ground.arm()
    ground.start()
    while not ground.autopilot.landed or ground.fleet.now_s < 10.0:
        before = ground.autopilot.position_m
        ground.run(0.5)
        assert ground.fleet.now_s < 200.0
    assert ground.autopilot.position_m[2] == pytest.approx(584.0, abs=0.5)
    assert np.linalg.norm(ground.autopilot.position_m - before) < 15.0  # it did not drop out of the sky
    stands = ground.autopilot.position_m
    ground.run(30.0)
    assert np.array_equal(ground.autopilot.position_m, stands)
    assert not ground.autopilot.armed


def test_a_plane_disarmed_in_the_air_is_down() -> None:
    ground = Ground("ardupilot", "plane")
    ground.upload(mission("ardupilot", speed_m_s=18.0))
    ground.mode("AUTO")
    ground.arm()
    ground.start()
    ground.run(15.0)
    assert ground.autopilot.position_m[2] > 590.0
    assert ground.autopilot.disarm(ground.fleet.now_s, force=True) == ACCEPTED
    ground.run(5.0)
    assert ground.autopilot.position_m[2] == pytest.approx(584.0)
    assert ground.autopilot.landed_state is LandedState.ON_GROUND
