"""Signed links: the same key on both sides, nothing twice, nothing forged; pymavlink is the other side."""

from __future__ import annotations

import os
import select
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import InProcessEndpoint, in_process_pair
from adapters.fleet_link import FleetLink
from adapters.pymavlink_link import PymavlinkLink
from adapters.signing import Signing, open_links, read_key, signing_from
from missionplanner.errors import LinkError, MissionError
from missionplanner.geodesy import GeoPoint
from sim.fleet import LockstepClock, SimFleet, connect_fleet, planned_vehicles, sim_vehicles
from tests.plans import small_fleet

KEY = bytes(range(32))
NOW_S = 1.8e9


def clock() -> float:
    return NOW_S


def beat(codec: Any) -> bytes:
    message = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)
    frame = bytes(message.pack(codec))
    codec.seq = (codec.seq + 1) % 256
    return frame


def signer(key: bytes = KEY, sysid: int = 1, *, at_s: float = NOW_S, link_id: int = 7) -> Any:
    """Return pymavlink's own signing codec."""
    codec = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1)
    codec.signing.secret_key = key
    codec.signing.sign_outgoing = True
    codec.signing.link_id = link_id
    codec.signing.timestamp = int((at_s - 1_420_070_400) * 1e5)
    return codec


def station() -> tuple[PymavlinkLink, InProcessEndpoint, Signing]:
    ground, air = in_process_pair("pipe")
    signing = Signing(KEY, clock)
    return PymavlinkLink([signing.sealed(ground)]), air, signing


def dropped(signing: Signing, sysid: int = 1) -> tuple[int, int, int]:
    counts = signing.dropped[sysid]
    return counts.unsigned, counts.wrong, counts.replayed


def test_only_what_is_signed_with_the_key_is_heard() -> None:
    link, air, signing = station()
    good, bad, bare = signer(), signer(bytes(32)), mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    air.send(beat(bad) + beat(bare) + bytes(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3).pack(bare, True)))
    assert link.receive(0.0) == []
    assert dropped(signing) == (2, 1, 0)
    air.send(beat(good))
    [message] = link.receive(0.1)
    assert message.get_type() == "HEARTBEAT"


def test_nothing_counts_twice_not_even_from_another_address() -> None:
    (first, air), (second, elsewhere) = in_process_pair("one"), in_process_pair("two")
    signing = Signing(KEY, clock)
    link = PymavlinkLink([signing.sealed(first), signing.sealed(second)])
    codec = signer()
    old, new = beat(codec), beat(codec)
    air.send(new + new + old)
    assert len(link.receive(0.0)) == 1
    elsewhere.send(new)
    assert link.receive(0.1) == []  # and it is no second vehicle of that sysid either
    assert dropped(signing) == (0, 0, 3)


def test_a_recording_of_an_earlier_flight_is_no_new_vehicle() -> None:
    link, air, signing = station()
    air.send(beat(signer(at_s=NOW_S - 61.0)))
    assert link.receive(0.0) == []
    air.send(beat(signer(at_s=NOW_S - 59.0)))
    assert len(link.receive(0.0)) == 1
    assert dropped(signing) == (0, 0, 1)


def test_a_forged_timestamp_does_not_silence_the_vehicle() -> None:
    link, air, _ = station()
    air.send(beat(signer(bytes(32), at_s=NOW_S + 1e6)))
    air.send(beat(signer()))
    assert len(link.receive(0.0)) == 1


@given(st.integers(0, 199), st.integers(1, 255))
def test_no_changed_byte_passes(place: int, change: int) -> None:
    link, air, _ = station()
    frame = bytearray(beat(signer()))
    frame[place % len(frame)] ^= change
    air.send(bytes(frame))
    assert link.receive(0.0) == []


def test_pymavlink_takes_what_we_sign_and_nothing_twice() -> None:
    link, air, _ = station()
    link.receive(0.0)
    link.receive(1.0)
    peer = signer(sysid=9)
    frames = [data for data, _ in air.receive()]
    peer.robust_parsing = True
    heard = [m for data in [*frames, frames[0]] for m in peer.parse_buffer(data) or ()]
    assert [m.get_type() for m in heard] == ["HEARTBEAT", "HEARTBEAT", "BAD_DATA"]
    assert all(m.get_signed() for m in heard[:2])


def test_timestamps_grow_though_the_clock_is_set_back(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    told: list[str] = []
    stamps: list[int] = []
    for now_s in (NOW_S, NOW_S - 1e6, 0.0):
        signing = signing_from(path, lambda now_s=now_s: now_s, told.append)  # type: ignore[misc]
        frames = [signing.sign(beat(mavlink.MAVLink(None, 255, 190)), 0) for _ in range(3)]
        stamps += [int.from_bytes(frame[-12:-6], "little") for frame in frames]
        signing.save()
    assert stamps == sorted(set(stamps))
    assert told == []
    assert int((tmp_path / "key.timestamp").read_text()) == stamps[-1]
    (tmp_path / "key.timestamp").write_text("yesterday")
    with pytest.raises(MissionError, match=r"key.timestamp: expected the last timestamp of key, .*delete it"):
        signing_from(path, clock, told.append)


@pytest.mark.parametrize("content", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"])
def test_a_key_is_32_bytes_or_64_digits(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    assert read_key(path) == (KEY, None)
    if os.name == "posix":
        path.chmod(0o644)
        assert "others than its owner can read this key: chmod 600" in str(read_key(path)[1])


@pytest.mark.parametrize("content", [b"", KEY[:-1], KEY.hex()[:-1].encode(), b"x" * 64])
def test_anything_else_is_no_key(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    with pytest.raises(
        MissionError, match=rf"key: expected a signing key of 32 bytes or 64 .*, got {len(content)} bytes"
    ):
        read_key(path)
    with pytest.raises(MissionError, match="missing: expected a signing key that can be read"):
        read_key(tmp_path / "missing")


def test_a_wrong_key_is_told(tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    told: list[str] = []
    with (
        pytest.raises(
            LinkError, match=r"nobody answered; messages were dropped \(sysid 1: 1 signed with another key\)"
        ),
        open_links(["udpin:127.0.0.1:0"], path, clock, told.append) as [endpoint],
    ):
        with open_links([endpoint.url.replace("udpin", "udpout")], None, clock, told.append) as [air]:
            air.send(beat(signer(bytes(32))))
        select.select(endpoint.filenos(), [], [], 5.0)
        assert endpoint.receive() == []
        raise LinkError("nobody answered")


def test_a_fleet_is_uploaded_to_on_signed_links() -> None:
    """Both halves sign, each with what it knows; a third who does not is not obeyed."""
    plan = small_fleet("px4", 2)
    sim, signing, theirs = SimFleet(planned_vehicles(plan), frame=plan.frame), Signing(KEY, clock), Signing(KEY, clock)
    ground, air = in_process_pair()
    sim.attach(theirs.sealed(air))
    link = FleetLink(plan, [signing.sealed(ground)], LockstepClock(sim))
    link.connect()
    link.upload()
    link.verify()
    assert set(link.held) == {1, 2}
    assert signing.dropped == theirs.dropped == {}
    stranger = mavlink.MAVLink(None, srcSystem=254, srcComponent=190)
    ground.send(mavlink.MAVLink_mission_clear_all_message(1, 1).pack(stranger))
    sim.advance(0.1)
    assert len(sim.links[0].missions.items()) == len(link.held[1])
    assert dropped(theirs, 254) == (1, 0, 0)


def test_a_real_signing_ground_station_is_heard_and_hears() -> None:
    """pymavlink with its own signing, over UDP; without the key it gets no answer."""
    ground = mavutil.mavlink_connection("udpin:127.0.0.1:0", source_system=255)
    port = ground.port.getsockname()[1]
    fleet = SimFleet(sim_vehicles(1, GeoPoint(47.0, 8.0, 500.0)))
    signing = Signing(KEY, clock)
    connect_fleet(fleet, f"udpout:127.0.0.1:{port}", signing.sealed)
    ticks = int((NOW_S - 1_420_070_400) * 1e5)

    def answers() -> list[Any]:
        ground.mav.command_long_send(1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 148, 0, 0, 0, 0, 0, 0)
        heard = []
        for _ in range(40):
            fleet.advance(0.1)
            while (message := ground.recv_msg()) is not None:
                heard.append(message)
        return [m for m in heard if m.get_type() == "COMMAND_ACK"]

    try:
        fleet.advance(2.0)
        assert ground.recv_match(type="HEARTBEAT", blocking=True, timeout=5.0) is not None
        assert answers() == []
        assert dropped(signing, 255)[0] == 1
        ground.setup_signing(bytes(32), True, None, ticks)
        assert answers() == []
        ground.setup_signing(KEY, True, None, ticks)
        [answer] = answers()
        assert answer.get_signed()
    finally:
        ground.close()
        fleet.close()
