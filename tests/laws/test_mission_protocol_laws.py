"""Laws of mission transfer over links that lose, double, delay and reorder."""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem, plan_items
from adapters.mission_protocol import OWN_COMPONENT, Message, MissionDownload, MissionUpload, Party, mismatches
from missionplanner.errors import LinkError
from missionplanner.vehicle import Autopilot
from tests.oracles.mission_vehicle import MissionVehicle
from tests.plans import FRAME, vehicle_plan

PARTY = Party("uav3", 3)
TICK_S = 0.05
PATIENCE_S = 600.0


@dataclass(frozen=True)
class Weather:
    """What a link does to each message, each way."""

    loss: float = 0.0
    duplication: float = 0.0
    delay_s: float = 0.0  # mean of an exponential: reorders

    def deliver(self, now_s: float, rng: np.random.Generator) -> list[float]:
        copies = 1 + int(rng.random() < self.duplication)
        return [
            now_s + (rng.exponential(self.delay_s) if self.delay_s else 0.0)
            for _ in range(copies)
            if rng.random() >= self.loss
        ]


class Wire:
    """A vehicle behind weather, and the ground's machines before it, in simulated time."""

    def __init__(self, vehicle: MissionVehicle, weather: Weather, seed: int) -> None:
        self.vehicle = vehicle
        self.now_s = 0.0
        self.machines: list[MissionUpload | MissionDownload] = []
        self._weather = weather
        self._rng = np.random.default_rng(seed)
        self._queue: list[tuple[float, int, bool, bytes]] = []
        self._order = itertools.count()
        self._ground = mavlink.MAVLink(None, srcSystem=255, srcComponent=OWN_COMPONENT)
        self._air = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
        self._parser = mavlink.MAVLink(None)

    def run(self, machine: MissionUpload | MissionDownload) -> None:
        self.machines.append(machine)
        end_s = self.now_s + PATIENCE_S
        while not machine.done:
            assert self.now_s < end_s, "neither done nor failed"
            self._send(self.vehicle.tick(self.now_s), to_vehicle=False)
            for each in self.machines:
                self._send(each.poll(self.now_s), to_vehicle=True)
            self.now_s += TICK_S
            while self._queue and self._queue[0][0] <= self.now_s:
                _, _, to_vehicle, frame = heapq.heappop(self._queue)
                [message] = self._parser.parse_buffer(frame)
                if to_vehicle:
                    self._send(self.vehicle.receive(message, self.now_s), to_vehicle=False)
                else:
                    for each in self.machines:
                        self._send(each.receive(message, self.now_s), to_vehicle=True)

    def _send(self, messages: list[Message], *, to_vehicle: bool) -> None:
        sender = self._ground if to_vehicle else self._air
        for message in messages:
            for at_s in self._weather.deliver(self.now_s, self._rng):
                heapq.heappush(self._queue, (at_s, next(self._order), to_vehicle, message.pack(sender)))


def _mission(autopilot: Autopilot, count: int, seed: int) -> tuple[MissionItem, ...]:
    rng = np.random.default_rng(seed)
    waypoints_m = np.column_stack([rng.uniform(-2000, 2000, (count, 2)), rng.uniform(1210, 1400, count)])
    return plan_items(vehicle_plan(autopilot=autopilot, waypoints_m=waypoints_m), FRAME)


def _vehicle(autopilot: Autopilot, seed: int) -> MissionVehicle:
    vehicle = MissionVehicle(autopilot, (0, 16, 0.0, 0.0, 0.0, 0.0, 343_600_001, -1_181_800_002, 1200.09))
    vehicle.mission = [
        (i.frame, i.command, i.param1, i.param2, i.param3, i.param4, i.x, i.y, i.z)
        for i in _mission(autopilot, 9, seed)
    ]
    return vehicle


def _transfer(wire: Wire, autopilot: Autopilot, items: tuple[MissionItem, ...]) -> bool:
    """Upload and read back; return whether the ground believes it."""
    wire.run(MissionUpload(PARTY, autopilot, items))
    download = MissionDownload(PARTY)
    wire.run(download)
    return not mismatches(items, download.items, autopilot)


autopilots: st.SearchStrategy[Autopilot] = st.sampled_from(["ardupilot", "px4"])
weathers = st.builds(Weather, st.floats(0, 0.4), st.floats(0, 0.3), st.sampled_from([0.0, 0.05, 0.3]))


@settings(deadline=None, max_examples=60)
@given(autopilots, weathers, st.integers(2, 25), st.integers(0, 2**32 - 1))
def test_a_believed_mission_is_the_one_sent_and_a_failure_is_a_clear_error(
    autopilot: Autopilot, weather: Weather, count: int, seed: int
) -> None:
    items = _mission(autopilot, count, seed)
    vehicle = _vehicle(autopilot, seed + 1)
    wire = Wire(vehicle, weather, seed)
    try:
        believed = _transfer(wire, autopilot, items)
    except LinkError as error:
        assert weather.loss > 0.05
        assert str(error).startswith("uav3 (sysid 3): ")
        assert "\n" not in str(error)
        return
    if believed:
        first = 1 if autopilot == "ardupilot" else 0
        held = vehicle.held()
        assert len(held) == len(items)
        for item, stored in zip(items[first:], held[first:], strict=True):
            assert (item.frame, item.command, item.x, item.y, item.z) == (*stored[:2], *stored[6:])


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize(
    ("weather", "share"), [(Weather(), 1.0), (Weather(0.05, 0.05, 0.05), 1.0), (Weather(0.2, 0.1, 0.1), 0.95)]
)
def test_how_often_it_succeeds(autopilot: Autopilot, weather: Weather, share: float) -> None:
    verified = 0
    for seed in range(20):
        wire = Wire(_vehicle(autopilot, seed), weather, seed)
        verified += _transfer(wire, autopilot, _mission(autopilot, 40, seed))
    assert verified >= share * 20


@given(
    autopilots, st.lists(st.tuples(st.sampled_from(range(8)), st.integers(0, 70_000), st.integers(0, 255)), max_size=30)
)
def test_nothing_from_others_moves_an_upload(autopilot: Autopilot, noise: list[tuple[int, int, int]]) -> None:
    upload = MissionUpload(PARTY, autopilot, _mission(autopilot, 3, 1))
    assert len(upload.poll(0.0)) == 1
    for kind, number, small in noise:
        sysid, component, target, mission_type = 3, 1, 255, 0
        match kind % 4:
            case 0:
                sysid = 4 + small % 200
            case 1:
                component = 2 + small % 200
            case 2:
                target = small % 255
            case 3:
                mission_type = 1 + small % 2
        seq = number % 65_536
        if kind < 4:
            message = mavlink.MAVLink_mission_ack_message(target, OWN_COMPONENT, small % 16, mission_type)
        else:
            message = mavlink.MAVLink_mission_request_message(target, OWN_COMPONENT, seq % 8, mission_type)
        message.pack(mavlink.MAVLink(None, srcSystem=sysid, srcComponent=component))
        assert upload.receive(message, 0.1) == []
    assert not upload.done
    assert upload.poll(0.2) == []


_small = st.integers(0, 9)
_any_message = st.one_of(
    st.builds(lambda seq: mavlink.MAVLink_mission_request_message(255, OWN_COMPONENT, seq), _small),
    st.builds(lambda seq: mavlink.MAVLink_mission_request_int_message(255, 0, seq), st.integers(0, 65_535)),
    st.builds(lambda result: mavlink.MAVLink_mission_ack_message(255, OWN_COMPONENT, result), st.integers(0, 16)),
    st.builds(lambda count: mavlink.MAVLink_mission_count_message(255, OWN_COMPONENT, count), _small),
    st.builds(
        lambda seq, command, value, place: mavlink.MAVLink_mission_item_int_message(
            255, OWN_COMPONENT, seq, 0, command, 0, 1, value, value, value, value, place, place, value
        ),
        _small,
        st.integers(0, 65_535),
        st.floats(width=32),
        st.integers(-(2**31), 2**31 - 1),
    ),
)


@given(autopilots, st.lists(st.tuples(_any_message, st.floats(0, 3)), max_size=60))
def test_whatever_a_vehicle_says_ends_in_a_whole_mission_or_a_clear_error(
    autopilot: Autopilot, said: list[tuple[Message, float]]
) -> None:
    items = _mission(autopilot, 3, 1)
    upload, download = MissionUpload(PARTY, autopilot, items), MissionDownload(PARTY)
    sender = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)
    sent: set[int] = set()
    now_s = 0.0
    try:
        for message, pause_s in said:
            now_s += pause_s
            message.pack(sender)
            answers = [*upload.poll(now_s), *upload.receive(message, now_s)]
            sent |= {answer.seq for answer in answers if answer.get_type() == "MISSION_ITEM_INT"}
            download.poll(now_s)
            download.receive(message, now_s)
    except LinkError as error:
        assert str(error).startswith("uav3 (sysid 3): ")
        return
    assert not upload.done or len(items) - 1 in sent
    assert not download.done or len(download.items) == download.total
    mismatches(items, download.items, autopilot)
