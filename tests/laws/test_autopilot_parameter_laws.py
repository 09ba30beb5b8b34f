"""Laws of the motion model's parameters: what a model says, a vehicle holds, and a mission makes a model of again."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.mission_protocol import Party
from adapters.parameter_protocol import ParameterList, ParametersRead, ParameterValue
from adapters.vehicle_parameters import compared
from missionplanner.autopilot_parameters import Kind, Parameter, differences, held, parameters, value_of, with_values
from missionplanner.mission import VehicleSettings
from missionplanner.parameter_files import parse_parameters
from missionplanner.vehicle import MotionModel, motion_model
from tests.laws.parameter_vehicles import LossyVehicle

KINDS: list[Kind] = [("ardupilot", "copter"), ("ardupilot", "plane"), ("px4", "copter"), ("px4", "plane")]
kinds = st.sampled_from(KINDS)
_AIRSPEEDS = "airspeed_limits_m_s.0", "cruise_speed_m_s", "airspeed_limits_m_s.1"


def settings_of(kind: Kind, **said: object) -> VehicleSettings:
    autopilot, vehicle_class = kind
    # a plane that turns tightly may circle tightly
    return VehicleSettings.model_validate({"autopilot": autopilot, "class": vehicle_class, "turn_radius_m": 0.0} | said)


def value_in(parameter: Parameter) -> st.SearchStrategy[float]:
    """Return values of the field that the parameter's first spelling can hold."""
    spelling = parameter.spellings[0]
    if spelling.whole:
        low, high = parameter.low * spelling.per_unit, parameter.high * spelling.per_unit
        return st.integers(int(np.ceil(low)), int(high)).map(lambda n: n / spelling.per_unit)
    return st.floats(parameter.low, parameter.high)


@st.composite
def models(draw: st.DrawFn) -> tuple[Kind, MotionModel]:
    kind = draw(kinds)
    values = {p.field: draw(value_in(p)) for p in parameters(kind) if not p.sent}
    if kind[1] == "plane":  # others are refused
        values |= zip(_AIRSPEEDS, sorted(values[field] for field in _AIRSPEEDS), strict=True)
    return kind, with_values(motion_model(settings_of(kind)), values)


@given(models())
@settings(max_examples=200)
def test_a_model_survives_the_vehicle_that_holds_it(drawn: tuple[Kind, MotionModel]) -> None:
    kind, model = drawn
    values = held(kind, model)
    assert all(float(np.float32(value)) == value for value in values.values())  # MAVLink carries no more
    assert differences(kind, model, values) == ()
    again = motion_model(settings_of(kind, parameters=values))
    for parameter in parameters(kind):
        np.testing.assert_allclose(
            value_of(again, parameter.field), value_of(model, parameter.field), rtol=1e-7, atol=1e-12
        )
    assert held(kind, again) == values


@given(models(), st.sampled_from([",", "   ", "\t"]))
@settings(max_examples=50)
def test_a_model_survives_a_file(drawn: tuple[Kind, MotionModel], between: str) -> None:
    kind, model = drawn
    values = held(kind, model)
    text = "\n".join(f"{name}{between}{np.float32(value)!s}" for name, value in values.items())
    read = {name: entry.value for name, entry in parse_parameters(text, "v.param").items()}
    assert differences(kind, model, read) == ()


@given(models(), st.data())
@settings(max_examples=200)
def test_every_difference_is_found_and_no_other(drawn: tuple[Kind, MotionModel], data: st.DataObject) -> None:
    kind, model = drawn
    changed = data.draw(st.sampled_from([p for p in parameters(kind) if not p.sent and p.low < p.high]))
    value = data.draw(value_in(changed))
    values = held(kind, with_values(model, {changed.field: value}))
    before = value_of(model, changed.field)
    far = abs(value - before) > max(2e-6 * max(abs(value), abs(before)), 2e-9)
    named = [difference.name for difference in differences(kind, model, values)]
    if far:
        assert named == [changed.name]
        comparison = compared("uav", model, {n: ParameterValue(n, float(v), 9) for n, v in values.items()})
        assert comparison.problem is not None
        assert comparison.problem.startswith(f"uav: holds {changed.name} ")
    else:
        assert set(named) <= {changed.name}


@given(
    st.lists(st.integers(1, 3), min_size=1, max_size=30),
    st.data(),
    st.floats(0.0, 0.4),
    st.integers(0, 2**32 - 1),
    st.integers(16, 40),
)
@settings(max_examples=60, deadline=None)
def test_many_are_read_over_any_link_and_never_more_asked_than_are_queued(
    spellings: list[int], data: st.DataObject, loss: float, seed: int, queue: int
) -> None:
    groups = [[f"P{k}_{n}" for n in range(count)] for k, count in enumerate(spellings)]
    there = {0: groups[0][0]}  # of each that exists, the name that this firmware has
    for k, names in enumerate(groups[1:], start=1):
        name = data.draw(st.none() | st.sampled_from(names))
        if name is not None:
            there[k] = name
    vehicle = LossyVehicle({name: 0.5 * k for k, name in there.items()}, loss, seed, queue)
    read = ParametersRead(Party("uav", 3), "ardupilot", groups, patience_s=120.0)
    vehicle.run(read)
    assert [None if h is None else (h.name, h.value) for h in read.held] == [
        (there[k], 0.5 * k) if k in there else None for k in range(len(groups))
    ]
    assert vehicle.overflows == 0


@given(st.integers(1, 120), st.floats(0.0, 0.4), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_all_are_listed_over_any_link(count: int, loss: float, seed: int) -> None:
    values = {f"P{k}": 0.25 * k for k in range(count)}
    vehicle = LossyVehicle(values, loss, seed, 20)
    read = ParameterList(Party("uav", 3), "px4", patience_s=120.0)
    vehicle.run(read)
    assert {name: parameter.value for name, parameter in read.held.items()} == values
    assert read.total == count
    assert vehicle.overflows == 0
