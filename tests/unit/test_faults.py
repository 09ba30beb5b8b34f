"""Bad links lose, double, delay and damage what they say, frame by frame, and the same again with the same seed."""

from __future__ import annotations

import select
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import in_process_pair, open_endpoint
from missionplanner.errors import MissionError
from sim.faults import REORDER_S, Faults, FaultyEndpoint, bad_links
from sim.fleet import LockstepClock, SimFleet, connect_fleet, sim_vehicles
from tests.plans import small_fleet
from tests.rig import Rig
from tests.simulated import HOME

FRAMES = 2_000


class Pipe:
    """Numbered frames through a bad link, and the numbers that come out, by a clock that the test sets."""

    def __init__(self, faults: Faults, seed: int = 1) -> None:
        self.now_s = 0.0
        self.near, far = in_process_pair()
        self.far = FaultyEndpoint(far, faults, lambda: self.now_s, np.random.default_rng(seed))
        self._codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True

    def frame(self, number: int) -> bytes:
        return bytes(mavlink.MAVLink_mission_request_int_message(1, 1, number).pack(self._codec))

    def numbers(self, pieces: list[Any]) -> list[int]:
        found = [m for data, _ in pieces for m in self._parser.parse_buffer(data) or ()]
        return [m.seq for m in found if m.get_type() == "MISSION_REQUEST_INT"]

    def through(self, count: int, *, back: bool = False, until_s: float = 10.0, together: int = 1) -> list[int]:
        """Send frames, ``together`` in one piece, and return the numbers of those that arrive."""
        near, far = (self.far, self.near) if back else (self.near, self.far)
        for k in range(0, count, together):
            near.send(b"".join(self.frame(i) for i in range(k, k + together)))
        arrived: list[int] = []
        while self.now_s < until_s:
            if back:
                self.far.receive()
            arrived += self.numbers(far.receive())
            self.now_s += 0.05
        return arrived


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("together", [1, 10])
def test_a_good_link_changes_nothing(back: bool, together: int) -> None:
    assert Pipe(Faults()).through(300, back=back, until_s=0.01, together=together) == list(range(300))


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("together", [1, 10])
def test_a_share_of_frames_is_lost_also_of_those_that_share_a_datagram(back: bool, together: int) -> None:
    arrived = Pipe(Faults(loss=0.4)).through(FRAMES, back=back, together=together)
    assert len(arrived) == pytest.approx(0.6 * FRAMES, abs=4 * (FRAMES * 0.24) ** 0.5)
    assert arrived == sorted(set(arrived))
    if together > 1:
        whole = sum({k + i for i in range(together)} <= set(arrived) for k in range(0, FRAMES, together))
        assert whole < 0.05 * FRAMES / together


def test_a_share_of_frames_comes_twice() -> None:
    arrived = Pipe(Faults(duplicate=0.25)).through(FRAMES)
    assert sorted(set(arrived)) == list(range(FRAMES))
    assert len(arrived) - FRAMES == pytest.approx(0.25 * FRAMES, abs=4 * (FRAMES * 0.1875) ** 0.5)


def test_a_share_of_frames_is_overtaken_but_not_for_long() -> None:
    pipe = Pipe(Faults(reorder=0.1))
    at_once = pipe.through(FRAMES, until_s=0.01)
    assert len(at_once) == pytest.approx(0.9 * FRAMES, abs=4 * (FRAMES * 0.09) ** 0.5)
    assert at_once == sorted(at_once)
    late = pipe.through(0, until_s=REORDER_S + 0.1)
    assert sorted(at_once + late) == list(range(FRAMES))


def test_jitter_alone_keeps_the_order() -> None:
    pipe = Pipe(Faults(delay_s=0.2, jitter_s=0.3))
    assert pipe.through(FRAMES, until_s=0.19) == []
    assert pipe.through(0, until_s=0.6) == list(range(FRAMES))


def test_damaged_frames_are_not_taken_for_others() -> None:
    arrived = Pipe(Faults(corrupt=0.3)).through(FRAMES)
    # what follows a damaged length is swallowed with it
    assert 0.4 * FRAMES < len(arrived) < 0.75 * FRAMES
    assert set(arrived) <= set(range(FRAMES))


def test_a_radio_takes_its_time_and_does_not_take_everything() -> None:
    pipe = Pipe(Faults(baud=57_600))
    per_frame_s = 10 * len(pipe.frame(0)) / 57_600
    arrived = pipe.through(FRAMES, until_s=0.51)
    assert len(arrived) == pytest.approx(0.5 / per_frame_s, rel=0.02)
    arrived += pipe.through(0, until_s=5.0)
    assert len(arrived) == pytest.approx(1.0 / per_frame_s, rel=0.02)
    assert arrived == list(range(len(arrived)))


def test_everything_is_lost_while_the_link_is_down() -> None:
    pipe = Pipe(Faults(down_s=((1.0, 3.0),)))
    arrived = []
    for k in range(50):
        pipe.now_s = 0.1 * k
        pipe.near.send(pipe.frame(k))
        arrived += pipe.numbers(pipe.far.receive())
    assert arrived == [*range(10), *range(30, 50)]


@given(st.lists(st.binary(max_size=40), max_size=20), st.lists(st.integers(1, 30), min_size=1, max_size=10))
def test_whatever_passes_comes_out_in_order_however_it_is_cut(pieces: list[bytes], cuts: list[int]) -> None:
    pipe = Pipe(Faults())
    stream = b"".join(pipe.frame(k) + piece for k, piece in enumerate(pieces)) + pipe.frame(999)
    here, came = 0, b""
    for cut in (*cuts, len(stream)):
        pipe.near.send(stream[here : here + cut])
        came += b"".join(data for data, _ in pipe.far.receive())
        here += cut
    assert stream.startswith(came)
    assert len(stream) - len(came) < 290  # at most the beginning of a frame still waits for its end


def test_the_same_seed_does_the_same_and_another_something_else() -> None:
    faults = Faults(loss=0.2, duplicate=0.1, reorder=0.1, corrupt=0.05, jitter_s=0.2)
    runs = [Pipe(faults, seed).through(500) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]


@pytest.mark.parametrize(
    "wrong",
    [{"loss": 1.1}, {"loss": float("nan")}, {"delay_s": -1.0}, {"baud": 0}, {"down_s": ((3.0, 1.0),)}],
)
def test_links_that_cannot_be_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(MissionError, match=f"link: {next(iter(wrong))}: expected"):
        Faults(**wrong)


def test_a_fleet_uploads_through_a_bad_radio_in_simulated_time() -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    through = bad_links(Faults(loss=0.2, delay_s=0.1, duplicate=0.1, reorder=0.1), lambda: rig.sim.now_s, 3)
    for port in rig.sim._ports:
        port.endpoint = through(port.endpoint)
    rig.upload()
    assert isinstance(rig.clock, LockstepClock)
    assert rig.sim.now_s > 2.0
    assert {k: [i.command for i in items] for k, items in rig.link.held.items()} == {
        k: [i.command for i in items] for k, items in rig.link.items.items()
    }


def test_links_over_sockets_are_bad_too() -> None:
    ground = open_endpoint("udpin:127.0.0.1:0")
    fleet = SimFleet(sim_vehicles(2, HOME))
    through = bad_links(Faults(down_s=((0.0, 2.02),)), lambda: fleet.now_s, 1)
    connect_fleet(fleet, ground.url.replace("udpin", "udpout"), through)
    try:
        fleet.advance(2.0)
        assert ground.receive() == []
        fleet.advance(1.5)
        select.select(ground.filenos(), [], [], 5.0)
        assert ground.receive() != []
    finally:
        fleet.close()
        ground.close()
