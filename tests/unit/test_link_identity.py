"""Who is read, sent to and armed is who was identified: nobody else takes its place, and what is left is told."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.backup import restore
from adapters.downloads import download
from adapters.endpoint import in_process_pair
from adapters.fleet_link import FleetLink, download_missions
from adapters.listener import by_sysid
from adapters.mission_protocol import OWN_COMPONENT, OWN_SYSID
from adapters.pymavlink_link import PymavlinkLink
from adapters.vehicle_parameters import read_parameters
from missionplanner.errors import LinkError
from missionplanner.mission import Point, RallyPoint, Vehicle
from missionplanner.vehicle import Autopilot
from sim.fleet import LockstepClock, SimFleet, planned_vehicles
from tests.plans import small_fleet
from tests.rig import MeddledEndpoint, Merged, Rig, together
from tests.simulated import mission
from tests.unit.test_fleet_transfer import bound

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
PLACE = Point(x_m=0.0, y_m=0.0, alt_amsl_m=1200.0)
READERS: dict[str, Callable[..., Any]] = {
    "check": download_missions,
    "download": download,
    "parameters": read_parameters,
}
ANY_READER = pytest.mark.parametrize("read", READERS.values(), ids=READERS)


def asked(autopilot: Autopilot, *uids: str | None) -> dict[int, Vehicle]:
    return by_sysid(
        [
            Vehicle(name=f"uav{k}", autopilot=autopilot, home=PLACE, goal=PLACE, uid=uid)
            for k, uid in enumerate(uids, start=1)
        ]
    )


@BOTH
@ANY_READER
def test_another_autopilot_than_the_missions_is_not_read(read: Callable[..., Any], autopilot: Autopilot) -> None:
    rig = Rig(small_fleet(autopilot, 2))
    rig.upload()
    own = [next(iter(v.unique_ids)) for v in rig.link._station.peers.values()]
    told = r"uav2 \(sysid 2\): expected the autopilot with uid f{16}, got [0-9a-f ]+.*: the wrong vehicle.*nothing was"
    with pytest.raises(LinkError, match=told):
        read(rig.pipes, rig.clock, asked=asked(autopilot, own[0], "f" * 16))
    assert len(read(rig.pipes, rig.clock, asked=asked(autopilot, own[0], own[1]))) == 2


@ANY_READER
def test_another_kind_than_the_missions_is_not_read(read: Callable[..., Any]) -> None:
    rig = Rig(small_fleet("ardupilot", 1))
    with pytest.raises(LinkError, match=r"uav1 \(sysid 1\): expected px4 copter, got ardupilot copter"):
        read(rig.pipes, rig.clock, asked=asked("px4", None))


@ANY_READER
def test_who_is_heard_without_a_heartbeat_is_waited_for(read: Callable[..., Any]) -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    rig.upload()
    begun_s = rig.sim.now_s
    silenced_s = 4.0

    def down(message: Any) -> Any:
        lost = message.get_type() == "HEARTBEAT" and rig.sim.now_s < begun_s + silenced_s
        return None if lost else message

    rig.pipes[1].down = down
    assert len(read(rig.pipes, rig.clock)) == 2
    silenced_s = 1e9
    begun_s = rig.sim.now_s
    with pytest.raises(LinkError, match="expected a heartbeat of sysid 2 within 5 s"):
        read(rig.pipes, rig.clock, timeout_s=5.0)


@ANY_READER
def test_two_autopilots_behind_one_address_are_not_read(read: Callable[..., Any]) -> None:
    rig, other = Rig(small_fleet("ardupilot", 1)), Rig(small_fleet("ardupilot", 1))
    rig.upload()
    other.upload()
    with pytest.raises(LinkError, match=r"expected one autopilot, (heard|got answers of) two"):
        read([_two(rig, other)], rig.clock, expected=[1])


def _two(rig: Rig, other: Rig) -> Merged:
    """Return two vehicles' pipes as one address; the second vehicle has another unique id."""

    def down(message: Any) -> Any:
        if message.get_type() == "AUTOPILOT_VERSION":
            message.uid = 0xABC
        return message

    together(rig.clock, rig.sim, other.sim)
    other.pipes[0].down = down
    return Merged(rig.pipes[0], other.pipes[0])


def test_whoever_takes_a_verified_vehicles_place_is_not_armed() -> None:
    plan = small_fleet("ardupilot", 1)
    fleets = [SimFleet(planned_vehicles(plan), frame=plan.frame) for _ in range(2)]
    heard = [True, False]
    ends = []
    for k, fleet in enumerate(fleets):
        ground, air = in_process_pair(f"radio{k}")
        fleet.attach(air)
        ends.append(MeddledEndpoint(ground, lambda message, k=k: message if heard[k] else None))
    clock = LockstepClock(fleets[0])
    together(clock, *fleets)
    fleets[1].links[0].missions._store(0, list(mission("ardupilot")), None, 0.0)
    link = FleetLink(plan, ends, clock)
    link.connect()
    link.upload()
    link.verify()
    heard[0] = False
    link._station.settle(6.0)
    heard[1] = True
    with pytest.raises(LinkError, match=r"is heard on radio1 from radio1 since: whether that is the same vehicle"):
        link.start()
    assert not any(fleet.links[0].autopilot.armed for fleet in fleets)


def test_in_flight_a_vehicle_may_come_back_from_elsewhere() -> None:
    plan = small_fleet("ardupilot", 1)
    rig = Rig(plan)
    other, air = in_process_pair("other")
    rig.link = FleetLink(plan, [*rig.pipes, other], rig.clock)
    rig.upload()
    rig.link.start()
    rig.pipes[0].down = lambda message: air.send(_frame(message))  # returns None: lost here
    flight = rig.link.watch()
    assert flight.vehicles[0].landed_s is not None


def _frame(message: Any) -> bytes:
    return bytes(message.get_msgbuf())


def test_who_was_identified_is_heard_at_its_place_only_until_it_flies() -> None:
    (ground1, air1), (ground2, air2) = in_process_pair("one"), in_process_pair("two")
    link = PymavlinkLink([ground1, ground2])
    beat = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 3, 1))
    air1.send(beat)
    link.receive(0.0)
    link.pin(3)
    air2.send(beat)
    assert link.receive(60.0) == []
    assert link.elsewhere(3) == "two from two"
    link.unpin(3)
    air2.send(beat)
    assert len(link.receive(61.0)) == 1


@BOTH
def test_a_second_address_in_mid_upload_leaves_nobody_untold(autopilot: Autopilot) -> None:
    plan = small_fleet(autopilot, 2)
    rig = Rig(plan)
    stray, air = in_process_pair("stray")
    link = FleetLink(plan, [*rig.pipes, stray], rig.clock)
    link.connect()
    beat = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 1, 1))

    def down(message: Any) -> Any:
        if message.get_type().startswith("MISSION_REQUEST") and message.seq == 2:
            air.send(beat)
        return message

    rig.pipes[1].down = down
    state = "may hold a mixture" if autopilot == "ardupilot" else "it keeps its old mission"
    with pytest.raises(
        LinkError, match=rf"sysid 1: expected one vehicle, heard two.*uav\d.*{state}.*nothing was armed"
    ):
        link.upload()


def test_who_was_sent_its_mission_is_told_when_another_fails() -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    rig.link.connect()
    rig.pipes[1].down = lambda message: None if message.get_type().startswith("MISSION_") else message
    with pytest.raises(LinkError) as failure:
        rig.link.upload()
    said = str(failure.value)
    assert "uav2 (sysid 2): expected requests" in said
    assert "uav1: it holds the new mission, not read back" in said
    rig.pipes[1].down = lambda message: message
    rig.link.upload()
    rig.link.verify()
    assert rig.link._station.left_behind() == ""


def test_rally_points_half_sent_are_a_mixture() -> None:
    points = tuple(RallyPoint(x_m=-20.0, y_m=40.0 + k, height_above_home_m=31.0) for k in range(3))
    rig = Rig(bound(small_fleet("ardupilot", 1), rally=points))
    rig.upload()
    heard = 0

    def down(message: Any) -> Any:
        nonlocal heard
        if (
            not message.get_type().startswith("MISSION_REQUEST")
            or message.mission_type != mavlink.MAV_MISSION_TYPE_RALLY
        ):
            return message
        heard += 1
        return message if heard <= 2 else None

    rig.pipes[0].down = down
    with pytest.raises(LinkError, match="may hold a mixture of the old set of rally points and the new one"):
        rig.link.send_guards()


def test_disarm_is_not_done_by_the_answer_to_arm() -> None:
    """A second of delay: the answer to ARM's repetition comes when DISARM, which is lost, has been sent."""
    rig = Rig(small_fleet("ardupilot", 2))
    rig.upload()
    pipe = rig.pipes[0]
    late: deque[tuple[float, Any]] = deque()
    receive = pipe.receive
    delay_s = 0.0
    lost = 0

    def delayed() -> list[Any]:
        now_s = rig.sim.now_s
        late.extend((now_s + delay_s, piece) for piece in receive())
        arrived = []
        while late and late[0][0] <= now_s:
            arrived.append(late.popleft()[1])
        return arrived

    def up(message: Any) -> Any:
        nonlocal delay_s, lost
        if message.get_type() == "COMMAND_LONG" and message.command == ARM:
            delay_s = 1.0
            if message.param1 == 0.0 and not lost:
                lost += 1
                return None
        return message

    def refused(message: Any) -> Any:
        if message.get_type() == "COMMAND_ACK" and message.command == ARM:
            message.result = mavlink.MAV_RESULT_FAILED
        return message

    pipe.receive = delayed  # type: ignore[method-assign]
    pipe.up = up
    rig.pipes[1].down = refused
    with pytest.raises(LinkError, match=r"uav2 .*refused to arm"):
        rig.link.start()
    assert lost
    rig.link._station.settle(3.0)
    assert not rig.armed()[0]


@BOTH
def test_an_interrupted_restore_says_what_is_left(autopilot: Autopilot) -> None:
    rig = Rig(small_fleet(autopilot, 2))
    rig.upload()
    saved = [vehicle.saved for vehicle in download(rig.pipes, rig.clock)]
    for link in rig.sim.links:
        link.missions._store(0, list(mission(autopilot)), None, 0.0)

    def down(message: Any) -> Any:
        if message.get_type().startswith("MISSION_REQUEST") and message.seq == 2:
            raise KeyboardInterrupt
        return message

    rig.pipes[1].down = down
    state = "may hold a mixture" if autopilot == "ardupilot" else "keeps its old mission"
    with pytest.raises(KeyboardInterrupt, match=rf"sysid2: it {state}.*restore again"):
        restore(saved, rig.pipes, rig.clock)


def test_nothing_is_said_of_others_where_there_are_none() -> None:
    rig = Rig(small_fleet("ardupilot", 1))
    rig.upload()
    [saved] = [vehicle.saved for vehicle in download(rig.pipes, rig.clock)]
    rig.sim.links[0].missions._store(0, list(mission("ardupilot")), None, 0.0)
    saved = replace(saved, mission=saved.mission[:-1])
    rig.pipes[0].down = lambda message: None if message.get_type().startswith("MISSION_REQUEST") else message
    with pytest.raises(LinkError) as failure:
        restore([saved], rig.pipes, rig.clock)
    assert "mixture" in str(failure.value)
    assert "others" not in str(failure.value) and "is held" not in str(failure.value)


@BOTH
def test_nothing_is_served_once_it_has_been_read_back(autopilot: Autopilot) -> None:
    """Another ground station, with our ids even, gives the vehicle a mission of its own: none of our items gets in."""
    rig = Rig(small_fleet(autopilot, 1))
    rig.upload()
    sent: list[str] = []

    def spy(message: Any) -> Any:
        sent.append(message.get_type())
        return message

    rig.pipes[0].up = spy
    for component in (OWN_COMPONENT, mavlink.MAV_COMP_ID_MISSIONPLANNER):
        other = mavlink.MAVLink(None, srcSystem=OWN_SYSID, srcComponent=component)
        rig.pipes[0]._inner.send(mavlink.MAVLink_mission_count_message(1, 1, 5).pack(other))
        rig.link._station.settle(1.0)
        assert "MISSION_ITEM_INT" not in sent


def test_who_uploads_as_ground_stations_are_delivered_is_not_served_our_items() -> None:
    rig = Rig(small_fleet("ardupilot", 1))
    rig.link.connect()
    rig.link.upload()  # not read back yet: what the vehicle asks for again is served
    other = mavlink.MAVLink(None, srcSystem=OWN_SYSID, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
    rig.pipes[0]._inner.send(mavlink.MAVLink_mission_count_message(1, 1, 5).pack(other))
    sent: list[str] = []

    def spy(message: Any) -> Any:
        sent.append(message.get_type())
        return message

    rig.pipes[0].up = spy
    rig.link._station.settle(1.0)
    assert "MISSION_ITEM_INT" not in sent


def test_parameters_that_were_set_are_told_when_another_vehicle_fails() -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    rig.upload()
    rig.pipes[1].down = lambda message: None if message.get_type() == "PARAM_VALUE" else message
    with pytest.raises(LinkError, match=r"uav2 \(sysid 2\).*; uav1: set RTL_CONE_SLOPE from 3 to 0; nothing was armed"):
        rig.link.set_returns()
