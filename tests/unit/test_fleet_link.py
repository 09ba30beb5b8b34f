"""A fleet on its links: what must go well, and what every failure says and leaves behind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import in_process_pair, open_endpoint
from adapters.fleet_link import FleetLink, VehicleStatus, WallClock, download_missions
from adapters.mission_items import MissionItem
from adapters.parameter_protocol import parameter_name
from adapters.telemetry_log import FleetLog, read_log
from missionplanner.errors import LinkError
from missionplanner.plan import FleetFlight, FleetPlan
from missionplanner.vehicle import Autopilot, Ending, VehicleClass
from tests.plans import fleet_plan, small_fleet, vehicle_plan
from tests.rig import Rig


def fly(rig: Rig) -> FleetFlight:
    rig.upload()
    rig.link.start()
    return rig.link.watch()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("end", ["land", "rtl", "loiter"])
def test_a_fleet_flies_its_plan(autopilot: Autopilot, end: Ending) -> None:
    plan = small_fleet(autopilot, end=end)
    flight = fly(Rig(plan))
    assert [v.name for v in flight.vehicles] == ["uav1", "uav2", "uav3"]
    spread_s = flight.arrival_spread_s
    assert spread_s is not None
    assert spread_s <= 0.1
    for vehicle, flown in zip(plan.vehicles, flight.vehicles, strict=True):
        assert flown.arrival_s is not None
        goal_m = vehicle.waypoints_m[-1]
        assert np.linalg.norm(flown.trajectory.at(flown.arrival_s) - goal_m) <= vehicle.motion.waypoint_radius_m + 1.0
        np.testing.assert_allclose(flown.trajectory.position_m[0], vehicle.home_m, atol=0.1)
        assert flown.trajectory.t_s[0] == 0.0
        assert np.all(np.diff(flown.trajectory.t_s) > 0)
        for waypoint_m in vehicle.waypoints_m:
            nearest_m = np.min(np.linalg.norm(flown.trajectory.position_m - waypoint_m, axis=1))
            assert nearest_m <= vehicle.motion.waypoint_radius_m + 1.0
        if end == "loiter":
            assert flown.landed_s is None
        else:
            assert flown.landed_s is not None
            assert flown.landed_s > flown.arrival_s
            down_m = vehicle.home_m if end == "rtl" else vehicle.waypoints_m[-1]
            assert np.linalg.norm(flown.trajectory.position_m[-1, :2] - down_m[:2]) <= 2.0


def test_progress_is_told() -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    uploads: list[tuple[str, int, int]] = []
    reads: list[tuple[str, int, int]] = []
    seen: list[list[VehicleStatus]] = []
    rig.link.connect()
    rig.link.upload(lambda *args: uploads.append(args))
    rig.link.verify(lambda *args: reads.append(args))
    rig.link.start()
    rig.link.watch(lambda fleet: seen.append(list(fleet)))
    for told in (uploads, reads):
        for name in ("uav1", "uav2"):
            done = [d for n, d, _ in told if n == name]
            assert done == sorted(done)
            assert done[-1] == 6
    assert {status.item for fleet in seen for status in fleet} >= {1, 3, 4, 5}
    assert all(status.landed and status.arrived for status in seen[-1])
    assert not seen[0][0].landed
    assert seen[0][0].items == 6


def test_both_directions_are_logged(tmp_path: Path) -> None:
    plan = small_fleet("ardupilot", 2)
    with FleetLog(tmp_path, {v.sysid: v.name for v in plan.vehicles}, 1.7e9) as log:
        fly(Rig(plan, log=log))
    merged = read_log(tmp_path / "fleet.tlog")
    assert merged.lost_bytes == 0
    for k, name in ((1, "uav1"), (2, "uav2")):
        records = read_log(tmp_path / f"{name}.tlog").records
        senders = {message.get_srcSystem() for _, message in records}
        assert senders == {k, 255}
        kinds = {message.get_type() for _, message in records}
        assert kinds >= {"HEARTBEAT", "GLOBAL_POSITION_INT", "MISSION_ITEM_INT", "MISSION_COUNT", "COMMAND_LONG"}
        times = [time_s for time_s, _ in records]
        assert times == sorted(times)
        assert 1.7e9 <= times[0] < 1.7e9 + 5.0
    assert len(merged.records) == sum(len(read_log(tmp_path / f"uav{k}.tlog").records) for k in (1, 2))


def test_a_bad_link_delays_but_does_not_deceive() -> None:
    plan = small_fleet("ardupilot", 2)
    rig = Rig(plan)
    rig.lose(0.2, seed=5)
    flight = fly(rig)
    clean = fly(Rig(plan))
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s <= 0.6
    for lossy, good in zip(flight.vehicles, clean.vehicles, strict=True):
        assert lossy.arrival_s == pytest.approx(good.arrival_s, abs=0.6)


def test_a_start_by_the_clock() -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    rig.upload()
    armed_s: list[float] = []
    at_s = rig.link.now_s + 60.0
    arming = rig.link._arming  # type: ignore[attr-defined]

    def noted(vehicle: Any) -> Any:
        armed_s.append(rig.link.now_s)
        return arming(vehicle)

    rig.link._arming = noted  # type: ignore[method-assign]
    rig.link.start(at_s=at_s)
    assert all(at_s - 5.0 <= t <= at_s for t in armed_s)
    assert rig.link.now_s == pytest.approx(at_s, abs=2.0)
    late = Rig(small_fleet("ardupilot", 2))
    late.upload()
    with pytest.raises(LinkError, match=r"after the start for fleet.arrival_utc: nothing was armed"):
        late.link.start(at_s=late.link.now_s - 1.0)
    assert late.link.armed == []


def test_a_delayed_vehicle_starts_later_on_the_common_clock() -> None:
    plan = fleet_plan(
        vehicle_plan("first", 1),
        vehicle_plan(
            "second", 2, start_delay_s=15.0, home_m=(0, 60, 1200), waypoints_m=((0, 60, 1230), (240, 60, 1244.5))
        ),
    )
    flight = fly(Rig(plan))
    first, second = (v.trajectory for v in flight.vehicles)
    assert first.at(10.0)[2] > 1215.0
    assert second.at(14.5)[2] == pytest.approx(1200.0, abs=0.2)
    assert second.at(27.0)[2] > 1220.0


def test_a_mission_flown_before_begins_at_its_first_item() -> None:
    rig = Rig(small_fleet("ardupilot", 1, end="rtl"))
    first = fly(rig)
    rig.link.start()
    second = rig.link.watch()
    assert first.vehicles[0].arrival_s == pytest.approx(second.vehicles[0].arrival_s, abs=0.11)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("end", ["rtl", "loiter"])
def test_planes_end_in_a_circle(autopilot: Autopilot, end: Ending) -> None:
    waypoints_m = ((200.0, 0.0, 1235.0), (600.0, 0.0, 1250.0), (1200.0, 0.0, 1240.0))
    plan = fleet_plan(
        vehicle_plan(autopilot=autopilot, vehicle_class="plane", end=end, waypoints_m=waypoints_m, speed_m_s=18.0)
    )
    [flown] = fly(Rig(plan)).vehicles
    assert flown.arrival_s is not None
    assert 50.0 <= flown.arrival_s <= 90.0


def test_a_cold_vehicle_is_waited_for() -> None:
    rig = Rig(small_fleet("ardupilot", 1), cold_start=True)
    rig.upload()
    said: list[tuple[str, str]] = []
    rig.link.start(lambda *args: said.append(args))
    flight = rig.link.watch()
    assert said[-1] == ("uav1", "ready")
    assert len(said) > 1
    assert flight.vehicles[0].arrival_s is not None
    assert rig.clock.now_s() > 42.0 + flight.vehicles[0].arrival_s


def test_lost_news_of_the_goal_is_made_up_from_the_track() -> None:
    plan = small_fleet("ardupilot", 1)
    expected_s = fly(Rig(plan)).vehicles[0].arrival_s
    rig = Rig(plan)
    rig.pipes[0].down = lambda m: None if m.get_type() in ("MISSION_ITEM_REACHED", "STATUSTEXT") else m
    assert fly(rig).vehicles[0].arrival_s == pytest.approx(expected_s, abs=0.5)
    silent = Rig(plan)
    silent.upload()
    silent.link.start()
    gone = ("MISSION_ITEM_REACHED", "STATUSTEXT", "MISSION_CURRENT")
    silent.pipes[0].down = lambda m: None if m.get_type() in gone else m
    assert silent.link.watch().vehicles[0].arrival_s == pytest.approx(expected_s, abs=2.0)


# returns


NAMES: dict[tuple[Autopilot, VehicleClass], dict[str, float]] = {
    ("ardupilot", "copter"): {"RTL_ALT": 4250, "RTL_CONE_SLOPE": 0.0, "RTL_CLIMB_MIN": 0, "RTL_ALT_TYPE": 0},
    ("ardupilot", "plane"): {"RTL_ALTITUDE": 42.5},
    ("px4", "copter"): {"RTL_RETURN_ALT": 42.5, "RTL_CONE_ANG": 0, "RTL_TYPE": 0},
    ("px4", "plane"): {"RTL_RETURN_ALT": 42.5, "RTL_DESCEND_ALT": 42.5, "RTL_TYPE": 0},
}


def returning(
    autopilot: Autopilot, heights_m: Sequence[float], vehicle_class: VehicleClass = "copter", **options: Any
) -> Rig:
    """Return a fleet whose vehicles are planned to return at these heights."""
    plan = small_fleet(autopilot, len(heights_m), **options)
    vehicles = tuple(
        replace(
            v, vehicle_class=vehicle_class, motion=replace(v.motion, return_height_m=h, vehicle_class=vehicle_class)
        )
        for v, h in zip(plan.vehicles, heights_m, strict=True)
    )
    return Rig(replace(plan, vehicles=vehicles))


@pytest.mark.parametrize(("autopilot", "vehicle_class"), NAMES)
def test_what_makes_vehicles_return_as_planned_is_set(autopilot: Autopilot, vehicle_class: VehicleClass) -> None:
    rig = returning(autopilot, [42.5, 42.5], vehicle_class)
    wanted = NAMES[autopilot, vehicle_class]
    parameters = [link.autopilot.parameters for link in rig.sim.links]
    before = [dict(p) for p in parameters]
    rig.link.connect()
    told: list[tuple[str, int, int]] = []
    changes = rig.link.set_returns(lambda *args: told.append(args))
    for k, held in enumerate(parameters):
        assert {name: held[name] for name in wanted} == wanted
        changed = {name: (before[k][name], held[name]) for name in held if held[name] != before[k][name]}
        assert changed == {c.name: (c.before, c.after) for c in changes if c.vehicle == f"uav{k + 1}"}
        assert list(changed) != []
    assert [done for name, done, _ in told if name == "uav1"] == list(range(told[-1][2] + 1))
    assert rig.link.set_returns() == ()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_vehicles_ordered_home_return_at_their_own_heights(autopilot: Autopilot) -> None:
    heights_m = [41.0, 52.5, 64.0]
    rig = returning(autopilot, heights_m)
    rig.upload()
    rig.link.set_returns()
    rig.link.start()
    rig.sim.advance(25.0)
    rig.link.order("rtl")
    flight = rig.link.watch()
    for flown, height_m in zip(flight.vehicles, heights_m, strict=True):
        assert flown.landed_s is not None
        track = flown.trajectory.position_m
        assert np.max(track[:, 2]) - 1200.0 == pytest.approx(height_m, abs=0.3)
        home_m = track[0]
        away_m = np.linalg.norm((track - home_m)[:, :2], axis=1)
        back = np.arange(len(track)) > int(np.argmax(away_m))
        way_home = back & (away_m > 3.0) & (away_m < 0.5 * np.max(away_m))  # it brakes, comes back and climbs first
        assert np.any(way_home)
        assert np.min(track[way_home, 2]) - 1200.0 >= height_m - 0.5


def test_a_fleet_whose_mission_ends_with_rtl_returns_as_high_as_planned() -> None:
    highest_m = []
    for is_set in (True, False):
        rig = returning("ardupilot", [35.0, 47.0], end="rtl")
        rig.upload()
        if is_set:
            rig.link.set_returns()
        rig.link.start()
        highest_m += [float(np.max(v.trajectory.position_m[:, 2])) for v in rig.link.watch().vehicles]
    assert highest_m == pytest.approx([1235.0, 1247.0, 1230.0, 1230.0], abs=0.3)  # else no higher than they fly


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_returns_are_set_over_a_lossy_link(autopilot: Autopilot) -> None:
    rig = returning(autopilot, [42.5, 55.0])
    rig.link.connect()
    rig.lose(0.3, seed=4)
    changes = rig.link.set_returns()
    heights = [
        link.autopilot.parameters["RTL_ALT" if autopilot == "ardupilot" else "RTL_RETURN_ALT"] for link in rig.sim.links
    ]
    assert heights == ([4250, 5500] if autopilot == "ardupilot" else [42.5, 55.0])
    assert len({(c.vehicle, c.name) for c in changes}) == len(changes)


def test_firmware_of_other_years_is_set_too() -> None:
    rig = returning("ardupilot", [42.5, 42.5])
    new, old = (link.autopilot.parameters for link in rig.sim.links)
    for name in ("RTL_ALT", "RTL_CLIMB_MIN"):  # ArduCopter 4.7 counts in metres
        del new[name]
        new[f"{name}_M"] = 7.0
    del old["RTL_ALT_TYPE"]  # before 4.0
    rig.link.connect()
    rig.link.set_returns()
    assert (new["RTL_ALT_M"], new["RTL_CLIMB_MIN_M"]) == (42.5, 0.0)
    assert old["RTL_ALT"] == 4250


@pytest.mark.parametrize(("autopilot", "missing"), [("ardupilot", "RTL_CONE_SLOPE"), ("px4", "RTL_RETURN_ALT")])
def test_a_parameter_that_must_be_there_and_is_not_is_named(autopilot: Autopilot, missing: str) -> None:
    rig = returning(autopilot, [42.5, 42.5])
    del rig.sim.links[1].autopilot.parameters[missing]
    rig.link.connect()
    with pytest.raises(LinkError) as error:
        rig.link.set_returns()
    assert str(error.value).startswith(f"uav2 (sysid 2): expected parameter {missing}, got no answer to 20 requests")
    assert str(error.value).endswith("nothing was armed")


def test_a_vehicle_that_keeps_another_value_is_named() -> None:
    rig = returning("px4", [42.5, 42.5])
    rig.link.connect()

    def lower(message: Any) -> Any:
        if message.get_type() == "PARAM_SET":
            message.param_value = 30.0
        return message

    rig.pipes[1].up = lower
    with pytest.raises(LinkError) as error:
        rig.link.set_returns()
    says = "uav2 (sysid 2): parameter RTL_RETURN_ALT: sent 42.5, the vehicle holds 30"
    others = "uav1: set RTL_RETURN_ALT from 30 to 42.5; uav1: set RTL_CONE_ANG from 45 to 0"
    assert str(error.value) == f"{says}; {others}; nothing was armed"


def test_a_value_that_another_one_changes_is_found_when_all_are_read_again() -> None:
    rig = returning("ardupilot", [42.5])
    rig.link.connect()

    def meddling(message: Any) -> Any:
        if message.get_type() == "PARAM_REQUEST_READ" and parameter_name(message) == "RTL_ALT_TYPE":
            rig.sim.links[0].autopilot.parameters["RTL_ALT"] = 1000
        return message

    rig.pipes[0].up = meddling
    with pytest.raises(LinkError, match=r"parameter RTL_ALT: sent 4250, the vehicle holds 1000; .*nothing was armed"):
        rig.link.set_returns()


def test_a_height_that_the_vehicles_type_cannot_hold_is_refused() -> None:
    rig = returning("ardupilot", [42.5], "plane")
    rig.sim.links[0].autopilot.parameters["RTL_ALTITUDE"] = 100  # whole metres
    rig.link.connect()
    with pytest.raises(
        LinkError, match=r"RTL_ALTITUDE: cannot hold 42.5 m \(it counts whole steps of 1 m\): change the"
    ):
        rig.link.set_returns()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_vehicle_with_rally_points_is_refused(autopilot: Autopilot) -> None:
    rig = returning(autopilot, [42.5, 42.5])
    rig.link.connect()
    rally = MissionItem(0, 3, mavlink.MAV_CMD_NAV_RALLY_POINT, x=1, y=1, z=30.0)
    rig.sim.links[1].missions._stores[mavlink.MAV_MISSION_TYPE_RALLY] = [rally, replace(rally, seq=1)]
    with pytest.raises(LinkError, match=r"uav2 \(sysid 2\): holds 2 rally points.*clear them; .*nothing was armed"):
        rig.link.set_returns()


def test_returns_of_an_armed_vehicle_are_left_alone() -> None:
    rig = returning("px4", [42.5])
    rig.upload()
    rig.link.start()
    with pytest.raises(
        LinkError, match="is armed: land and disarm it before setting its return height; nothing was set"
    ):
        rig.link.set_returns()
    assert rig.sim.links[0].autopilot.parameters["RTL_RETURN_ALT"] == 30.0


# what vehicles hold


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_what_was_read_back_is_what_the_vehicles_hold(autopilot: Autopilot) -> None:
    rig = Rig(small_fleet(autopilot, 2))
    rig.link.connect()
    rig.link.upload()
    assert rig.link.held == {}
    rig.link.verify()
    for link in rig.sim.links:
        held = [replace(item, current=0) for item in rig.link.held[link.sysid]]
        assert held == [replace(item, current=0) for item in link.missions.items()]
    rig.link.upload()
    assert rig.link.held == {}


def test_a_mission_that_reads_back_otherwise_is_not_held() -> None:
    rig = Rig(small_fleet("px4", 2))
    rig.link.connect()
    rig.link.upload()
    rig.pipes[0].down = lambda m: setattr(m, "z", 7.0) or m if m.get_type() == "MISSION_ITEM_INT" else m
    with pytest.raises(LinkError, match="uav1"):
        rig.link.verify()
    assert list(rig.link.held) == [2]


@pytest.mark.parametrize(("autopilot", "vehicle_class"), NAMES)
def test_missions_are_read_of_vehicles_that_no_plan_describes(
    autopilot: Autopilot, vehicle_class: VehicleClass
) -> None:
    rig = returning(autopilot, [42.5, 55.0], vehicle_class)
    for link in rig.sim.links:
        link.missions._stores[0] = list(rig.link.items[link.sysid])
    found = download_missions(rig.pipes, rig.clock)
    assert list(found) == [1, 2]
    for sysid, vehicle in found.items():
        assert (vehicle.sysid, vehicle.autopilot, vehicle.vehicle_class) == (sysid, autopilot, vehicle_class)
        assert [i.command for i in vehicle.items] == [i.command for i in rig.link.items[sysid]]
        assert (
            vehicle.return_height_m == {"ardupilot": 15.0, "px4": 30.0}[autopilot]
            if vehicle_class == "copter"
            else 100.0
        )
        assert vehicle.home is not None
        np.testing.assert_allclose(
            rig.sim.frame.to_local(vehicle.home.lat_deg, vehicle.home.lon_deg, vehicle.home.alt_amsl_m),
            (0.0, 40.0 * sysid, 1200.0),
            atol=0.02,
        )
    cone = {"ardupilot": "RTL_CONE_SLOPE is 3", "px4": "RTL_CONE_ANG is 45"}[autopilot]
    remarks = found[1].remarks
    assert remarks == ((f"{cone}: its return is known only for 0",) if vehicle_class == "copter" else ())
    rig.link.connect()
    rig.link.set_returns()
    again = download_missions(rig.pipes, rig.clock, expected=[2])
    assert list(again) == [2]
    assert (again[2].return_height_m, again[2].remarks) == (55.0, ())


def test_reading_changes_nothing_and_tells_of_rally_points_and_of_no_height() -> None:
    rig = returning("ardupilot", [42.5], "plane")
    parameters = rig.sim.links[0].autopilot.parameters
    parameters["RTL_ALTITUDE"] = -1.0
    rally = MissionItem(0, 3, mavlink.MAV_CMD_NAV_RALLY_POINT, x=1, y=1, z=30.0)
    rig.sim.links[0].missions._stores[mavlink.MAV_MISSION_TYPE_RALLY] = [rally]
    before = dict(parameters)
    sent: list[str] = []

    def note(message: Any) -> Any:
        sent.append(message.get_type())
        return message

    rig.pipes[0].up = note
    [vehicle] = download_missions(rig.pipes, rig.clock).values()
    assert vehicle.items == ()
    assert [remark.split(",")[0] for remark in vehicle.remarks] == [
        "it holds 1 rally points",
        "RTL_ALTITUDE is -1: it returns at its present height",
    ]
    assert dict(parameters) == before
    assert not {"PARAM_SET", "MISSION_COUNT", "MISSION_CLEAR_ALL", "MISSION_ITEM_INT"} & set(sent)


def test_a_return_height_that_is_no_number_is_refused() -> None:
    rig = returning("px4", [42.5])
    rig.sim.links[0].autopilot.parameters["RTL_RETURN_ALT"] = math.nan
    with pytest.raises(LinkError, match="holds RTL_RETURN_ALT nan: expected a height to return at"):
        download_missions(rig.pipes, rig.clock)


def test_a_vehicle_that_is_expected_and_silent_is_named() -> None:
    rig = Rig(small_fleet("px4", 2))
    with pytest.raises(LinkError, match=r"expected sysid 7 within 5 s, heard only sysid 1, 2"):
        download_missions(rig.pipes, rig.clock, expected=[1, 7], timeout_s=5.0)
    for pipe in rig.pipes:
        pipe.down = lambda m: None
    with pytest.raises(LinkError, match="expected a vehicle within 5 s, nobody answered"):
        download_missions(rig.pipes, rig.clock, timeout_s=5.0)


def test_a_vehicle_of_an_unknown_kind_is_not_read() -> None:
    rig = Rig(fleet_plan())

    def disguise(message: Any) -> Any:
        if message.get_type() == "HEARTBEAT":
            message.type = mavlink.MAV_TYPE_GROUND_ROVER
        return message

    rig.pipes[0].down = disguise
    with pytest.raises(
        LinkError, match=r"vehicle 1 \(sysid 1\): expected a copter or plane of ArduPilot or PX4, got ard"
    ):
        download_missions(rig.pipes, rig.clock)


# failures


def test_nobody_answers() -> None:
    ground, _ = in_process_pair("udpin:0.0.0.0:14550")
    clock = Rig(fleet_plan()).clock
    link = FleetLink(fleet_plan(), [ground], clock)
    with pytest.raises(LinkError) as error:
        link.connect(timeout_s=3.0)
    text = str(error.value)
    assert text.startswith("udpin:0.0.0.0:14550: expected uav1 (sysid 1) within 3 s, nobody answered; check that")
    assert error.value.exit_code == 4


def test_nobody_answers_in_real_time() -> None:
    endpoint = open_endpoint("udpin:127.0.0.1:0")
    link = FleetLink(fleet_plan(), [endpoint], WallClock([endpoint]))
    with pytest.raises(LinkError, match="nobody answered"):
        link.connect(timeout_s=0.2)
    link.close()


def test_somebody_is_missing() -> None:
    rig = Rig(small_fleet("ardupilot", 3))
    rig.pipes[1].down = lambda m: None
    with pytest.raises(LinkError, match=r"expected uav2 \(sysid 2\) within 5 s, the others answered \(sysid 1, 3\)"):
        rig.link.connect(timeout_s=5.0)


def test_somebody_else_answers() -> None:
    rig = Rig(fleet_plan(vehicle_plan("uav7", 7)))
    link = FleetLink(fleet_plan(vehicle_plan("uav1", 1)), rig.pipes, rig.clock)
    with pytest.raises(LinkError, match=r"expected uav1 \(sysid 1\) within 2 s, heard only sysid 7"):
        link.connect(timeout_s=2.0)


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("autopilot", 12, "expected ardupilot copter, got px4 copter"),
        ("autopilot", 8, "expected ardupilot copter, got autopilot 8 copter"),
        ("type", 1, "expected ardupilot copter, got ardupilot plane"),
        ("type", 10, "expected ardupilot copter, got ardupilot MAV_TYPE 10"),
    ],
)
def test_another_kind_of_vehicle_is_refused(field: str, value: int, says: str) -> None:
    rig = Rig(fleet_plan())

    def disguise(message: Any) -> Any:
        if message.get_type() == "HEARTBEAT":
            setattr(message, field, value)
        return message

    rig.pipes[0].down = disguise
    with pytest.raises(LinkError, match=says):
        rig.link.connect()


def test_two_vehicles_with_one_sysid_are_refused() -> None:
    rigs = [Rig(fleet_plan()), Rig(fleet_plan())]
    link = FleetLink(fleet_plan(), [rigs[0].pipes[0], rigs[1].pipes[0]], rigs[0].clock)
    rigs[1].sim.advance(3.0)
    with pytest.raises(LinkError, match=r"sysid 1: expected one vehicle, heard two: .*give each vehicle its own sysid"):
        link.connect()


def test_an_armed_vehicle_gets_no_mission() -> None:
    rig = Rig(fleet_plan())
    rig.upload()
    rig.link.start()
    with pytest.raises(LinkError, match=r"uav1 \(sysid 1\): is armed: land and disarm it"):
        rig.link.upload()


def test_a_refused_item_names_vehicle_and_item() -> None:
    rig = Rig(small_fleet("ardupilot", 2))

    def wrong_frame(message: Any) -> Any:
        if message.get_type() == "MISSION_ITEM_INT" and message.seq == 3:
            message.frame = 99
        return message

    rig.pipes[1].up = wrong_frame
    rig.link.connect()
    with pytest.raises(
        LinkError, match=r"uav2 \(sysid 2\): refused the mission: unsupported frame, item 3 .*not.* armed"
    ):
        rig.link.upload()
    assert rig.armed() == [False, False]


def test_a_mission_that_reads_back_otherwise_is_named_and_nothing_is_armed() -> None:
    rig = Rig(small_fleet("px4", 2))

    def lower(message: Any) -> Any:
        if message.get_type() == "MISSION_ITEM_INT" and message.seq == 2:
            message.z -= 20.0
        return message

    rig.pipes[1].up = lower
    rig.link.connect()
    rig.link.upload()
    with pytest.raises(LinkError) as error:
        rig.link.verify()
    says = "item 2: z: sent 1230, the vehicle holds 1210 (NAV_WAYPOINT)"
    assert str(error.value).startswith(f"uav2 (sysid 2): holds another mission than was sent: {says}")
    assert "uav1" not in str(error.value)
    assert str(error.value).endswith("nothing was armed")


def test_several_failures_are_told_together() -> None:
    rig = Rig(small_fleet("ardupilot", 3))
    rig.link.connect()
    for pipe in rig.pipes[1:]:
        pipe.down = lambda m: None
    with pytest.raises(LinkError, match=r"uav2 .*\(and 1 more: uav3 .*nothing was armed") as error:
        rig.link.upload()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("move_m", "says"),
    [((30.0, 0.0, 0.0), "stands 30.0 m from its planned home"), ((0.0, 0.0, 48.0), "check the terrain's datum")],
)
def test_a_vehicle_elsewhere_than_planned_is_not_armed(move_m: tuple[float, float, float], says: str) -> None:
    rig = Rig(fleet_plan())
    home_m = np.array([0.0, 0.0, 1200.0]) + move_m
    waypoints_m = home_m + np.array([[0.0, 0.0, 30.0], [90.0, 0.0, 30.0]])
    moved = fleet_plan(vehicle_plan(home_m=tuple(home_m), waypoints_m=waypoints_m))
    link = FleetLink(moved, rig.pipes, rig.clock)
    link.connect()
    link.upload()
    link.verify()
    with pytest.raises(LinkError, match=says):
        link.start()
    assert rig.armed() == [False]


def test_a_vehicle_that_is_not_ready_is_not_armed_and_says_why() -> None:
    rig = Rig(small_fleet("ardupilot", 2))

    def unhealthy(message: Any) -> Any:
        if message.get_type() == "SYS_STATUS":
            message.onboard_control_sensors_present |= mavlink.MAV_SYS_STATUS_PREARM_CHECK
            message.onboard_control_sensors_health &= ~mavlink.MAV_SYS_STATUS_PREARM_CHECK
        return message

    rig.pipes[1].down = unhealthy
    rig.upload()
    with pytest.raises(
        LinkError, match=r"uav2 \(sysid 2\): not ready to arm within 10 s: pre-arm checks fail.*nothing was"
    ):
        rig.link.start(ready_timeout_s=10.0)
    assert rig.armed() == [False, False]


def _refuse(command: int) -> Any:
    def edit(message: Any) -> Any:
        if message.get_type() == "COMMAND_LONG" and message.command == command and message.param1 == 1.0:
            message.command = 31_999  # a command that nobody knows
        return message

    return edit


def test_one_that_will_not_arm_keeps_all_on_the_ground() -> None:
    rig = Rig(small_fleet("ardupilot", 3))
    rig.upload()
    rig.pipes[1].up = _refuse(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
    with pytest.raises(LinkError) as error:
        rig.link.start()
    assert "uav2" in str(error.value)
    assert str(error.value).endswith("the start was called off: all vehicles are disarmed on the ground")
    assert rig.armed() == [False, False, False]


def test_one_that_only_pretends_to_start_brings_the_others_down() -> None:
    rig = Rig(small_fleet("ardupilot", 3))
    rig.upload()
    pretended = False

    def swallow(message: Any) -> Any:
        nonlocal pretended
        if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_MISSION_START:
            pretended = True
            return None
        return message

    def pretend(message: Any) -> Any:
        nonlocal pretended
        if pretended and message.get_type() == "HEARTBEAT":
            pretended = False
            return mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_MISSION_START, 0, target_system=255)
        return message

    rig.pipes[1].up, rig.pipes[1].down = swallow, pretend
    with pytest.raises(LinkError) as error:
        rig.link.start()
    assert "uav2 (sysid 2): accepted the start but does not fly its mission (mode 4, armed)" in str(error.value)
    assert "uav1, uav3 told to land" in str(error.value)
    rig.sim.advance(60.0)
    assert rig.armed() == [False, False, False]


def test_one_that_vanishes_in_flight_does_not_stop_the_watch_of_the_others() -> None:
    rig = Rig(small_fleet("ardupilot", 3))
    rig.upload()
    rig.link.start()
    rig.sim.advance(20.0)
    rig.pipes[1].down = lambda m: None
    with pytest.raises(
        LinkError,
        match=r"uav2 \(sysid 2\): not heard for \d+ s, .*is not known, its own failsafe may bring it home: watch",
    ):
        rig.link.watch()
    flight = rig.link.flight()
    assert [v.arrival_s is None for v in flight.vehicles] == [False, True, False]
    assert [v.landed_s is None for v in flight.vehicles] == [False, True, False]


def test_a_link_that_comes_back_loses_nothing_but_the_track_between() -> None:
    rig = Rig(small_fleet("ardupilot", 1))
    expected = fly(Rig(small_fleet("ardupilot", 1))).vehicles[0]
    rig.upload()
    rig.link.start()
    begun_s = rig.clock.now_s()

    def broken(message: Any) -> Any:
        return None if 20.0 <= rig.clock.now_s() - begun_s <= 50.0 else message

    rig.pipes[0].down = broken
    flown = rig.link.watch().vehicles[0]
    assert flown.landed_s == pytest.approx(expected.landed_s, abs=0.2)
    assert flown.arrival_s is not None
    assert 20.0 <= flown.arrival_s <= 51.0


def test_an_order_to_land_is_obeyed() -> None:
    rig = Rig(small_fleet("px4", 2))
    rig.upload()
    rig.link.start()
    rig.sim.advance(15.0)
    rig.link.order("land")
    flight = rig.link.watch()
    assert all(v.landed_s is not None for v in flight.vehicles)
    assert all(v.arrival_s is None for v in flight.vehicles)


def delayed_fleet() -> FleetPlan:
    """The second starts 15 s after the first."""
    first = vehicle_plan("first", 1, waypoints_m=((0, 0, 1230), (240, 0, 1244.5), (480, 0, 1244.5)))
    second = vehicle_plan(
        "second", 2, start_delay_s=15.0, home_m=(0, 60, 1200), waypoints_m=((0, 60, 1230), (240, 60, 1244.5))
    )
    return fleet_plan(first, second)


def watch_until(rig: Rig, after_s: float) -> None:
    """Watch until an operator interrupts."""
    end_s = rig.clock.now_s() + after_s
    wait = rig.clock.wait

    def interrupted(seconds: float) -> None:
        if rig.clock.now_s() >= end_s:
            rig.clock.wait = wait  # type: ignore[method-assign]
            raise KeyboardInterrupt
        wait(seconds)

    rig.clock.wait = interrupted  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        rig.link.watch()


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize(("after_s", "armed"), [(5.0, False), (13.0, True)])
def test_who_has_not_started_is_left_disarmed_when_an_operator_interrupts(
    autopilot: Autopilot, after_s: float, armed: bool
) -> None:
    rig = Rig(fleet_plan(*(replace(v, autopilot=autopilot) for v in delayed_fleet().vehicles)))
    rig.upload()
    rig.link.start()
    watch_until(rig, after_s)
    assert rig.armed() == [True, armed]
    assert rig.link.call_off() == ["second"]
    assert rig.armed() == [True, False]
    assert rig.link.armed == ["first"]
    rig.sim.advance(200.0)
    assert float(rig.sim.links[1].autopilot.position_m[2]) == pytest.approx(1200.0, abs=0.1)


def test_who_has_started_flies_on_when_an_operator_interrupts() -> None:
    rig = Rig(delayed_fleet())
    rig.upload()
    rig.link.start()
    watch_until(rig, 22.0)
    assert rig.link.call_off() == []
    assert rig.armed() == [True, True]


def test_who_may_be_armed_and_does_not_answer_is_named_when_an_operator_interrupts() -> None:
    rig = Rig(delayed_fleet())
    rig.upload()
    rig.link.start()
    watch_until(rig, 13.0)
    rig.pipes[1].up = lambda _message: None
    with pytest.raises(LinkError, match=r"second \(sysid 2\): has not been seen to start, and does not answer"):
        rig.link.call_off()


def test_a_later_start_that_fails_leaves_it_disarmed_and_the_others_flying() -> None:
    rig = Rig(delayed_fleet())
    rig.upload()
    rig.link.start()

    def refuse(message: Any) -> Any:
        if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_MISSION_START:
            message.command = 31_999
        return message

    rig.pipes[1].up = refuse
    told: list[str] = []
    with pytest.raises(LinkError, match=r"second \(sysid 2\): .*MISSION_START"):
        rig.link.watch(tell=told.append)
    assert any("it is disarmed on the ground; the others fly" in line for line in told)
    assert rig.armed() == [False, False]
    assert rig.link.flight().vehicles[0].landed_s is not None


def test_a_later_start_whose_answers_are_lost_is_watched() -> None:
    rig = Rig(delayed_fleet())
    rig.upload()
    rig.link.start()

    def lose(message: Any) -> Any:
        lost = message.get_type() == "COMMAND_ACK" and message.command == mavlink.MAV_CMD_MISSION_START
        return None if lost else message

    rig.pipes[1].down = lose
    told: list[str] = []
    flight = rig.link.watch(tell=told.append)
    assert any("it has left the ground and is watched" in line for line in told)
    assert flight.vehicles[1].landed_s is not None
