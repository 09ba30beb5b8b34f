"""Whatever is sent to a vehicle, it stays a vehicle."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem
from adapters.mission_protocol import mismatches
from missionplanner.errors import LinkError
from missionplanner.vehicle import Autopilot, VehicleClass
from sim.fleet import planned_vehicles
from sim.misbehaviour import Fault
from sim.personality import personality
from sim.vehicle_link import _MISSION_MESSAGES, VehicleLink
from tests.plans import small_fleet
from tests.rig import Rig
from tests.simulated import LAT, LON, Ground, item_message, mission, of_type, renumbered

AUTOPILOTS = st.sampled_from(["ardupilot", "px4"])
FLOATS = st.floats(width=32)
COMMANDS = st.sampled_from(sorted(personality("ardupilot", "copter").transfer.commands)) | st.integers(0, 65_535)
ITEMS = st.builds(
    MissionItem,
    seq=st.just(0),
    frame=st.integers(0, 12),
    command=COMMANDS,
    param1=FLOATS,
    param2=FLOATS,
    param3=FLOATS,
    param4=FLOATS,
    x=st.integers(LAT - 20_000, LAT + 20_000) | st.integers(-(2**31), 2**31 - 1),
    y=st.integers(LON - 20_000, LON + 20_000) | st.integers(-(2**31), 2**31 - 1),
    z=st.floats(0.0, 2000.0, width=32) | FLOATS,
    current=st.integers(0, 1),
)
LAW = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@LAW
@given(AUTOPILOTS, ITEMS)
def test_what_is_accepted_is_stored_once_and_for_all(autopilot: Autopilot, item: MissionItem) -> None:
    """An accepted item reads back as a fixed point: uploading the read-back changes nothing more.

    But for a centimetre: ArduPilot tells 30 cm as 30 * 0.01f, which is below 0.3, and cuts that to 29 cm.
    """
    kind = personality(autopilot, "copter")
    if item.command in kind.transfer.commands and item.frame in kind.transfer.frames and kind.check(item) == 0:
        once = kind.stored(item)
        again = kind.stored(once)
        assert abs(again.z - once.z) <= 0.0101
        assert repr(replace(again, z=once.z)) == repr(once)
        if not math.isclose(once.z, item.z, abs_tol=0.0101):
            assert once.z == 0.0  # of an item without a place
        assert (once.x, once.y) in {(item.x, item.y), (0, 0)}


@LAW
@given(AUTOPILOTS, st.lists(ITEMS, min_size=1, max_size=8), st.integers(0, 9))
def test_no_mission_makes_a_vehicle_crash(autopilot: Autopilot, items: list[MissionItem], skip: int) -> None:
    """Any mission is refused, or flown with finite positions and never below the ground."""
    ground = Ground(autopilot)
    valid = mission(autopilot)
    result = ground.upload(renumbered([*valid[: len(valid) - skip % 3], *items]))
    assert 0 <= result <= 15
    ground.mode("GUIDED" if autopilot == "ardupilot" else "POSCTL")
    ground.arm()
    ground.start()
    ground.run(30.0)
    assert np.isfinite(ground.autopilot.position_m).all()
    ground.command(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    ground.run(5.0)
    assert np.isfinite(ground.autopilot.position_m).all()


@LAW
@given(AUTOPILOTS, st.lists(st.tuples(st.integers(0, 6), st.booleans()), max_size=25))
def test_an_upload_is_accepted_only_when_every_item_has_come(
    autopilot: Autopilot, sent: list[tuple[int, bool]]
) -> None:
    """Items in any order, repeated or left out: the vehicle never acknowledges a mission that it does not hold."""
    ground = Ground(autopilot)
    items = mission(autopilot)
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, len(items)))
    wanted = 0
    accepted = False
    for seq, pause in sent:
        if pause:
            ground.run(0.3)
        index = min(seq, len(items) - 1)
        replies = ground.send(item_message(items[index]))
        if not accepted and index == wanted:
            wanted += 1
        accepted = accepted or any(m.type == 0 for m in of_type(replies, "MISSION_ACK"))
        assert accepted == (wanted == len(items))
    if accepted:
        assert len(ground.vehicle.missions.items()) == len(items)


@LAW
@given(AUTOPILOTS, st.binary(max_size=300), st.integers(0, 300), st.integers(0, 255))
def test_mutated_frames_are_survived(autopilot: Autopilot, noise: bytes, where: int, byte: int) -> None:
    ground = Ground(autopilot)
    frame = bytearray(item_message(replace(mission(autopilot)[0])).pack(ground._encoder))
    frame[where % len(frame)] = byte
    ground._pipe.send(noise + bytes(frame))
    ground.fleet.poll()
    ground.run(0.1)
    assert not ground.autopilot.armed


FAULTS = st.builds(
    Fault,
    kind=st.sampled_from(["deaf", "mute", "unanswered", "wrong", "changed", "error", "acceptance", "reboot", "silent"]),
    message=st.sampled_from(["MISSION_COUNT", "MISSION_REQUEST", "MISSION_ITEM", "MISSION_ACK", "COMMAND_ACK"]),
    item=st.none() | st.integers(0, 5),
    times=st.integers(1, 3) | st.just(math.inf),
    after_s=st.floats(0.0, 8.0),
    for_s=st.floats(0.5, 5.0),
    result=st.integers(0, 15),
)


@settings(LAW, max_examples=25)
@given(AUTOPILOTS, st.lists(FAULTS, min_size=1, max_size=3))
def test_whatever_a_vehicle_does_its_mission_is_verified_or_it_is_named(
    autopilot: Autopilot, faults: list[Fault]
) -> None:
    """What is called verified is held; what is not is said of the vehicle at fault, and nobody is armed."""
    plan = small_fleet(autopilot, 2)
    first, second = planned_vehicles(plan)
    changed = [replace(f, message="MISSION_ITEM") if f.kind == "changed" else f for f in faults]
    rig = Rig(plan, vehicles=[first, replace(second, faults=tuple(changed))])
    try:
        rig.link.connect()
        rig.link.upload()
        rig.link.verify()
    except LinkError as error:
        assert "uav2 (sysid 2)" in str(error)
        assert "\n" not in str(error)
    else:
        for link in rig.sim.links:
            assert not mismatches(rig.link.items[link.sysid], link.missions.items(), autopilot)
    assert not any(link.autopilot.armed for link in rig.sim.links)


MESSAGES = [*VehicleLink._HANDLERS, *_MISSION_MESSAGES]
NUMBERS = [0.0, 1.0, -1.0, 2.0, 4.0, 16.0, 255.0, 21_196.0, 1e30, -1e30, math.inf, -math.inf, math.nan]
RANGES = {f"{sign}int{bits}_t": bits for sign in ("", "u") for bits in (8, 16, 32, 64)}


def random_message(rng: np.random.Generator, ground: Ground) -> Any:
    """Return a message that the vehicle heeds, with fields from the edges of what they can hold."""
    kind = MESSAGES[rng.integers(len(MESSAGES))]
    commands = [*ground.vehicle._commands, *ground.autopilot.personality.transfer.commands]

    def value(name: str, wire_type: str) -> Any:
        if wire_type in ("float", "double"):
            return NUMBERS[rng.integers(len(NUMBERS))]
        if wire_type == "char":
            return b"WPNAV_SPEED"
        if name in ("target_system", "target_component"):
            return int(rng.integers(2))
        if name == "command":
            return int(commands[rng.integers(len(commands))])
        bits = RANGES[wire_type]
        low, high = (0, 2**bits - 1) if wire_type.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        edges = [low, high, 0, 1, 2, 3, 5, 6]
        return edges[rng.integers(len(edges))]

    def field(name: str, wire_type: str) -> Any:
        return [value(name, wire_type) for _ in range(251)] if name == "payload" else value(name, wire_type)

    return kind(*(field(n, t) for n, t in zip(kind.fieldnames, kind.fieldtypes, strict=True)))


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("vehicle_class", ["copter", "plane"])
def test_no_message_makes_a_flying_vehicle_crash(autopilot: Autopilot, vehicle_class: VehicleClass) -> None:
    rng = np.random.default_rng(11)
    for _ in range(4):
        ground = Ground(autopilot, vehicle_class)
        ground.upload(mission(autopilot))
        ground.mode("GUIDED" if autopilot == "ardupilot" else "POSCTL")
        ground.arm()
        ground.start()
        for _ in range(200):
            ground.send(random_message(rng, ground))
            ground.run(0.1)
            assert np.isfinite(ground.autopilot.position_m).all()
