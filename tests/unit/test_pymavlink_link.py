"""Who is where is learned from who speaks; two of one name are refused; noise is dropped."""

from __future__ import annotations

import os
import select
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import InProcessEndpoint, in_process_pair, open_endpoint
from adapters.mission_protocol import OWN_COMPONENT
from adapters.pymavlink_link import PymavlinkLink
from adapters.telemetry_log import FleetLog, read_log
from missionplanner.errors import LinkError


def beat(sysid: int, component: int = 1, kind: int = mavlink.MAV_TYPE_QUADROTOR) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 3, 3)
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=sysid, srcComponent=component)))


def heard(end: InProcessEndpoint) -> list[Any]:
    parser = mavlink.MAVLink(None)
    return [message for data, _ in end.receive() for message in parser.parse_buffer(data) or ()]


def test_what_is_sent_to_a_vehicle_goes_where_it_was_heard() -> None:
    (ground1, air1), (ground2, air2) = in_process_pair("one"), in_process_pair("two")
    link = PymavlinkLink([ground1, ground2])
    air1.send(beat(1))
    air2.send(beat(2))
    assert [message.get_srcSystem() for message in link.receive(0.0)] == [1, 2]
    assert [m.get_type() for end in (air1, air2) for m in heard(end)] == ["HEARTBEAT", "HEARTBEAT"]
    for _ in range(3):
        link.send(mavlink.MAVLink_mission_request_list_message(2, 1), 2, 0.1)
    assert heard(air1) == []
    messages = heard(air2)
    assert [(m.get_srcSystem(), m.get_srcComponent()) for m in messages] == [(255, OWN_COMPONENT)] * 3
    assert [m.get_seq() for m in messages] == [1, 2, 3]
    with pytest.raises(LinkError, match="sysid 9: expected it on one, two, never heard of it"):
        link.send(mavlink.MAVLink_mission_request_list_message(9, 1), 9, 0.1)


def test_our_own_heartbeat_is_sent_each_second() -> None:
    ground, air = in_process_pair()
    link = PymavlinkLink([ground])
    for tick in range(41):
        link.receive(0.1 * tick)
    beats = heard(air)
    assert 4 <= len(beats) <= 5
    assert {(m.type, m.autopilot) for m in beats} == {(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID)}


def test_one_sysid_from_two_places_is_refused() -> None:
    (ground1, air1), (ground2, air2) = in_process_pair("one"), in_process_pair("two")
    link = PymavlinkLink([ground1, ground2])
    air1.send(beat(3))
    link.receive(0.0)
    air2.send(beat(3))
    with pytest.raises(LinkError, match=r"sysid 3: .*heard two: one from one and two from two; .*SYSID_THISMAV"):
        link.receive(1.0)


def test_a_vehicle_may_come_back_from_elsewhere_after_silence() -> None:
    (ground1, air1), (ground2, air2) = in_process_pair("one"), in_process_pair("two")
    link = PymavlinkLink([ground1, ground2])
    air1.send(beat(3))
    link.receive(0.0)
    air2.send(beat(3))
    link.receive(6.0)
    heard(air1)
    link.send(mavlink.MAVLink_mission_request_list_message(3, 1), 3, 6.1)
    assert [m.get_type() for m in heard(air2)][-1] == "MISSION_REQUEST_LIST"
    assert heard(air1) == []


@pytest.mark.parametrize(
    "other",
    [beat(255), beat(0), beat(7, 100), beat(7, kind=mavlink.MAV_TYPE_GCS)],
    ids=["own", "none", "camera", "station"],
)
def test_others_on_the_link_are_no_vehicles(other: bytes) -> None:
    ground, air = in_process_pair()
    link = PymavlinkLink([ground])
    air.send(other)
    assert link.receive(0.0) == []


def test_noise_and_damage_are_dropped_and_frames_may_come_in_pieces() -> None:
    ground, air = in_process_pair()
    link = PymavlinkLink([ground])
    frame = beat(4)
    damaged = bytearray(frame)
    damaged[12] ^= 0x55
    air.send(b"\xfd\x00noise" + bytes(range(50, 90)))
    air.send(bytes(damaged))
    for k in range(0, len(frame), 5):
        air.send(frame[k : k + 5])
    air.send(beat(4) * 3)
    count = len(link.receive(0.0))
    assert 2 <= count <= 4
    for _ in range(50):
        air.send(os.urandom(200))
    for _ in range(40):
        air.send(beat(4))
    assert link.receive(1.0)


def test_what_comes_and_goes_is_logged(tmp_path: Path) -> None:
    ground, air = in_process_pair()
    with FleetLog(tmp_path, {4: "uav4"}, 1.7e9) as log:
        link = PymavlinkLink([ground], log)
        air.send(beat(4) + beat(5))
        link.receive(1.0)
        link.send(mavlink.MAVLink_mission_request_list_message(4, 1), 4, 2.0)
        link.close()
    kinds = [(t - 1.7e9, m.get_type(), m.get_srcSystem()) for t, m in read_log(tmp_path / "uav4.tlog").records]
    assert kinds == [(1.0, "HEARTBEAT", 4), (2.0, "MISSION_REQUEST_LIST", 255)]
    assert len(read_log(tmp_path / "fleet.tlog").records) == 3


def test_one_sysid_from_two_sources_of_one_port_is_refused() -> None:
    """Two autopilots that send to the same UDP port, each from its own."""
    ground = open_endpoint("udpin:127.0.0.1:0")
    airs = [open_endpoint(ground.url.replace("udpin", "udpout")) for _ in range(2)]
    link = PymavlinkLink([ground])
    try:
        for air in airs:
            air.send(beat(3))
            select.select(ground.filenos(), [], [], 5.0)
            if air is airs[0]:
                assert len(link.receive(0.0)) == 1
        with pytest.raises(
            LinkError, match=r"sysid 3: expected one vehicle, heard two: udpin:.* from 127.0.0.1:\d+ and"
        ):
            link.receive(1.0)
    finally:
        for endpoint in (ground, *airs):
            endpoint.close()


def test_in_flight_nobody_takes_a_vehicle_over() -> None:
    (ground1, air1), (ground2, air2) = in_process_pair("one"), in_process_pair("two")
    link = PymavlinkLink([ground1, ground2])
    air1.send(beat(3))
    link.receive(0.0)
    link.keep_to_routes()
    air2.send(beat(3) * 2)
    air1.send(beat(3))
    assert len(link.receive(1.0)) == 1
    assert link.strangers == {3: 2}
    air2.send(beat(3))
    assert len(link.receive(7.0)) == 1  # silent for long: it may have moved


def test_ever_new_senders_fill_no_memory() -> None:
    class Many(InProcessEndpoint):
        def receive(self) -> list[tuple[bytes, Any]]:
            return [(b"\xfd\xff", ("192.0.2.1", k)) for k in range(1000)]

    ground, _ = in_process_pair()
    ground.__class__ = Many
    link = PymavlinkLink([ground])
    link.receive(0.0)
    assert len(link._parsers) <= 256
