"""Laws of parameters: what is set is what is read, in both encodings, whatever the link loses, doubles and delays."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_protocol import Party
from adapters.parameter_protocol import ParameterRead, ParameterSet, ParameterValue, from_wire, to_wire
from adapters.return_settings import return_settings
from missionplanner.vehicle import Autopilot, VehicleClass

RANGES = {
    1: (0, 255),
    2: (-128, 127),
    3: (0, 65_535),
    4: (-32_768, 32_767),
    5: (0, 2**32 - 1),
    6: (-(2**31), 2**31 - 1),
}
REAL32 = 9
autopilots: st.SearchStrategy[Autopilot] = st.sampled_from(["ardupilot", "px4"])


@st.composite
def typed(draw: st.DrawFn) -> tuple[int, float]:
    kind = draw(st.sampled_from([*RANGES, REAL32]))
    if kind == REAL32:
        return kind, draw(st.floats(width=32, allow_nan=False))
    low, high = RANGES[kind]
    return kind, float(draw(st.integers(low, high)))


def through_mavlink(name: str, wire: float, kind: int) -> float:
    """Return what a receiver finds in the field, after the bytes of a frame."""
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = mavlink.MAVLink_param_set_message(1, 1, name.encode(), wire, kind).pack(codec)
    [message] = mavlink.MAVLink(None).parse_buffer(frame)
    return float(message.param_value)


@given(typed(), autopilots)
@settings(max_examples=400)
def test_what_is_written_is_read_or_refused(value: tuple[int, float], autopilot: Autopilot) -> None:
    kind, number = value
    try:
        wire = to_wire(number, kind, autopilot)
    except ValueError:
        bits = int(number) & 0xFFFF_FFFF
        signalling = bits & 0x7FC0_0000 == 0x7F80_0000 and bits & 0x003F_FFFF != 0
        rounded = float(np.float32(number)) != number
        assert kind in (5, 6)  # all others fit
        assert signalling if autopilot == "px4" else rounded
        return
    assert from_wire(through_mavlink("RTL_ALT", wire, kind), kind, autopilot) == number


@given(st.floats(2.0, 500.0), autopilots, st.sampled_from(["copter", "plane"]), st.sampled_from([4, 6, REAL32]))
def test_a_height_is_kept_to_the_centimetre_or_refused(
    height_m: float, autopilot: Autopilot, vehicle_class: VehicleClass, kind: int
) -> None:
    height, *others = return_settings(autopilot, vehicle_class, height_m)
    for name in height.names:
        held = ParameterValue(name, 0.0, kind)
        try:
            wanted = height.wanted(held, autopilot)
        except ValueError:
            assert kind in RANGES
            continue
        assert abs(height.meant(ParameterValue(name, wanted, kind)) - height_m) <= 0.0101
    for setting in others:
        for name in setting.names:
            if setting.value == 0.0:
                assert setting.wanted(ParameterValue(name, 3.0, kind), autopilot) == 0.0


class _Vehicle:
    """A vehicle with one parameter behind a link that loses, doubles and delays; ArduPilot's is silent on no change."""

    def __init__(self, autopilot: Autopilot, kind: int, value: float) -> None:
        self.autopilot = autopilot
        self.kind = kind
        self.value = value

    def answers(self, message: Any) -> list[Any]:
        if message.get_type() == "PARAM_SET":
            before, code = self.value, "?BbHhIi"[self.kind] if self.kind != REAL32 else "f"
            if self.kind == REAL32 or self.autopilot == "ardupilot":
                self.value = message.param_value
            else:
                (self.value,) = struct.unpack_from(f"<{code}", struct.pack("<f", message.param_value))
            if self.autopilot == "ardupilot" and before == self.value:
                return []
        wire = to_wire(float(self.value), self.kind, self.autopilot)
        answer = mavlink.MAVLink_param_value_message(b"RTL_X", wire, self.kind, 1, 65_535)
        answer.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1))
        return [answer]


@given(
    autopilots,
    st.sampled_from([3, 4, 6, REAL32]),
    st.integers(0, 30_000),
    st.integers(0, 30_000),
    st.floats(0.0, 0.4),
    st.integers(0, 2**32 - 1),
)
def test_set_then_read_is_identity_over_any_link(
    autopilot: Autopilot, kind: int, before: int, after: int, loss: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    vehicle = _Vehicle(autopilot, kind, float(before))
    party = Party("uav1", 1)
    now_s = 0.0
    air: list[tuple[float, bool, Any]] = []  # when it arrives, whether at the vehicle, what

    def launch(message: Any, up: bool) -> None:
        for _ in range(int(rng.choice([1, 1, 1, 2]))):
            if rng.random() >= loss:
                air.append((now_s + float(rng.exponential(0.3)), up, message))

    def run(machine: ParameterRead | ParameterSet) -> None:
        nonlocal now_s, air
        while not machine.done:
            for message in machine.poll(now_s):
                launch(message, up=True)
            now_s += 0.1
            arrived = sorted((entry for entry in air if entry[0] <= now_s), key=lambda entry: entry[0])
            air = [entry for entry in air if entry[0] > now_s]
            for _, up, message in arrived:
                if up:
                    for answer in vehicle.answers(message):
                        launch(answer, up=False)
                else:
                    machine.receive(message, now_s)

    read = ParameterRead(party, autopilot, ["RTL_X"], patience_s=600.0)
    run(read)
    assert read.held is not None
    assert read.held.value == before
    run(ParameterSet(party, autopilot, read.held, float(after), patience_s=600.0))
    assert float(vehicle.value) == after
    air = []  # what is still under way says what was
    again = ParameterRead(party, autopilot, ["RTL_X"], patience_s=600.0)
    run(again)
    assert again.held == ParameterValue("RTL_X", float(after), kind)
