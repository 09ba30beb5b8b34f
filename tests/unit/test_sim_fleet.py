"""Several vehicles, one clock: endpoints, lock-step, real time."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint, in_process_pair, open_endpoint
from adapters.fleet_link import FleetLink
from missionplanner.errors import LinkError, MissionError
from missionplanner.motion import TICK_S
from missionplanner.timing import predict_flight
from missionplanner.vehicle import Autopilot
from sim.fleet import LockstepClock, SimFleet, connect_fleet, listen_fleet, planned_vehicles, serve, sim_vehicles
from tests.plans import small_fleet
from tests.simulated import HOME


def parsed(parser: Any, endpoint: Endpoint) -> list[Any]:
    return [m for data, _ in endpoint.receive() for m in parser.parse_buffer(data) or ()]


def arm_everybody(endpoint: Endpoint) -> None:
    encoder = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    message = mavlink.MAVLink_command_long_message(0, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    endpoint.send(message.pack(encoder))


def test_homes_stand_side_by_side() -> None:
    vehicles = sim_vehicles(4, HOME, spacing_m=25.0)
    assert [v.sysid for v in vehicles] == [1, 2, 3, 4]
    fleet = SimFleet(vehicles)
    gaps = np.diff(fleet.navigator.position_m, axis=0)
    assert gaps == pytest.approx(np.tile([25.0, 0.0, 0.0], (3, 1)), abs=1e-3)


@pytest.mark.parametrize("count", [0, 251])
def test_more_vehicles_than_sysids_are_refused(count: int) -> None:
    with pytest.raises(MissionError, match="vehicles: expected 1 to 250"):
        sim_vehicles(count, HOME)


def test_two_vehicles_with_one_sysid_are_refused() -> None:
    (vehicle,) = sim_vehicles(1, HOME)
    with pytest.raises(MissionError, match="sysid of its own"):
        SimFleet([vehicle, vehicle])


def test_connected_vehicles_share_the_ground_stations_port_and_have_their_own() -> None:
    ground = open_endpoint("udpin:127.0.0.1:0")
    fleet = SimFleet(sim_vehicles(3, HOME))
    connect_fleet(fleet, ground.url.replace("udpin:", "udpout://"))
    fleet.advance(1.0)
    parser, heard = mavlink.MAVLink(None), {}
    for data, peer in ground.receive():
        for message in parser.parse_buffer(data) or ():
            heard.setdefault(message.get_srcSystem(), set()).add(peer)
    fleet.close()
    ground.close()
    assert sorted(heard) == [1, 2, 3]
    assert len(set.union(*heard.values())) == 3


def _listens(fleet: SimFleet, port: int) -> bool:
    try:
        listen_fleet(fleet, f"tcp:127.0.0.1:{port}")
    except LinkError:  # somebody else's port
        return False
    return True


def test_listening_vehicles_are_ten_ports_apart() -> None:
    fleet = SimFleet(sim_vehicles(2, HOME))
    first = next(port for port in range(25760, 26760, 37) if _listens(fleet, port))
    clients = [open_endpoint(f"tcp:127.0.0.1:{first + 10 * i}") for i in range(2)]
    fleet.advance(1.5)
    heard = [{m.get_srcSystem() for m in parsed(mavlink.MAVLink(None), client)} for client in clients]
    for endpoint in (*clients, *fleet.endpoints()):
        endpoint.close()
    assert heard == [{1}, {2}]


def test_wrong_addresses_are_told_in_one_line() -> None:
    fleet = SimFleet(sim_vehicles(2, HOME))
    with pytest.raises(LinkError, match="use --listen"):
        connect_fleet(fleet, "udpin:127.0.0.1:14540")
    taken = open_endpoint("udpin:127.0.0.1:0")
    with pytest.raises(LinkError, match="cannot listen"):
        listen_fleet(fleet, taken.url)
    taken.close()


def test_time_passes_only_while_somebody_waits() -> None:
    fleet = SimFleet(sim_vehicles(1, HOME))
    clock = LockstepClock(fleet)
    assert clock.now_s() == 0.0
    clock.wait(1.0)
    assert clock.now_s() == pytest.approx(1.0)
    for _ in range(10):
        clock.wait(0.02)  # shorter than a tick: they add up
    assert clock.now_s() == pytest.approx(1.2)


def test_waiting_ends_with_an_answer() -> None:
    fleet = SimFleet(sim_vehicles(2, HOME, autopilot="px4"))
    theirs, mine = in_process_pair()
    fleet.attach(theirs)
    clock = LockstepClock(fleet)
    arm_everybody(mine)
    clock.wait(5.0)
    assert clock.now_s() == 0.0
    assert all(link.autopilot.armed for link in fleet.links)
    clock.wait(5.0)
    assert clock.now_s() == pytest.approx(5.0)


def test_commands_sent_before_a_wait_take_effect_in_the_same_tick() -> None:
    plan = small_fleet("px4", 3)
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame)
    theirs, mine = in_process_pair()
    fleet.attach(theirs)
    link = FleetLink(plan, [mine], LockstepClock(fleet))
    link.connect()
    link.upload()
    encoder = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    for sysid in (1, 2, 3):
        message = mavlink.MAVLink_command_long_message(sysid, 1, mavlink.MAV_CMD_MISSION_START, 0, 0, 0, 0, 0, 0, 0, 0)
        mine.send(message.pack(encoder))
    fleet.advance(10.0)
    heights = fleet.navigator.position_m[:, 2]
    assert heights[0] > 1201.0
    assert np.ptp(heights) == 0.0


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_plan_is_flown_as_predicted(autopilot: Autopilot) -> None:
    plan = small_fleet(autopilot, 3)
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame, ground=lambda _x, _y: 1190.0)
    theirs, mine = in_process_pair()
    fleet.attach(theirs)
    link = FleetLink(plan, [mine], LockstepClock(fleet))
    link.connect()
    link.upload()
    link.verify()
    link.start()
    flight = link.watch()
    assert flight.arrival_spread_s == 0.0
    for flown, vehicle in zip(flight.vehicles, plan.vehicles, strict=True):
        trajectory, reached_s = predict_flight(
            vehicle.motion, vehicle.home_m, vehicle.waypoints_m, vehicle.speed_m_s, end="land", ground_amsl_m=1190.0
        )
        assert flown.arrival_s == pytest.approx(reached_s[-1], abs=0.25)
        before = flown.trajectory.t_s < reached_s[-1]
        error_m = (flown.trajectory.position_m - trajectory.at(flown.trajectory.t_s))[before]
        assert float(np.abs(error_m).max()) < 0.1


def flown_heights(seed: int) -> bytes:
    plan = small_fleet("ardupilot", 2)
    fleet = SimFleet(planned_vehicles(plan), frame=plan.frame, seed=seed)
    theirs, mine = in_process_pair()
    fleet.attach(theirs)
    arm_everybody(mine)
    fleet.advance(12.0)
    return b"".join(data for data, _ in mine.receive())


def test_same_seed_same_bytes() -> None:
    assert flown_heights(3) == flown_heights(3)
    assert flown_heights(3) != flown_heights(4)


def test_vehicles_on_one_link_answer_for_themselves_only() -> None:
    fleet = SimFleet(sim_vehicles(3, HOME))
    theirs, mine = in_process_pair()
    fleet.attach(theirs)
    encoder = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    mine.send(mavlink.MAVLink_mission_request_list_message(2, 1).pack(encoder))
    fleet.poll()
    counts = [m for m in parsed(mavlink.MAVLink(None), mine) if m.get_type() == "MISSION_COUNT"]
    assert [m.get_srcSystem() for m in counts] == [2]


def test_garbage_is_survived() -> None:
    fleet = SimFleet(sim_vehicles(1, HOME))
    theirs, mine = in_process_pair()
    fleet.attach(theirs)
    rng = np.random.default_rng(5)
    for _ in range(50):
        mine.send(rng.bytes(400))
        fleet.advance(TICK_S)
    mine.send(b"\xfd" * 300)
    arm_everybody(mine)
    fleet.advance(1.0)
    assert parsed(mavlink.MAVLink(None), mine)


@pytest.mark.parametrize("speedup", [0.0, -1.0, float("nan"), float("inf")])
def test_speedup_must_be_a_speed(speedup: float) -> None:
    with pytest.raises(MissionError, match="speedup"):
        LockstepClock(SimFleet(sim_vehicles(1, HOME)), speedup)


def test_serving_keeps_time_and_answers_at_once() -> None:
    ground = open_endpoint("udpin:127.0.0.1:0")
    fleet = SimFleet(sim_vehicles(1, HOME, autopilot="px4"))
    connect_fleet(fleet, ground.url.replace("udpin", "udpout"))
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(fleet, 20.0, stop.is_set))
    thread.start()
    try:
        parser, heard, give_up_s = mavlink.MAVLink(None), [], time.monotonic() + 20.0
        while not any(m.get_type() == "COMMAND_ACK" for m in heard) and time.monotonic() < give_up_s:
            heard += parsed(parser, ground)
            if heard:
                arm_everybody(ground)
            time.sleep(0.01)
    finally:
        stop.set()
        thread.join()
        fleet.close()
        ground.close()
    assert any(m.get_type() == "COMMAND_ACK" for m in heard)
    assert fleet.now_s > 0.0
