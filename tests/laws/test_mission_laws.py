from __future__ import annotations

import copy
import json
import math
from typing import Any

import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.document import parse_document
from missionplanner.errors import MissionError
from missionplanner.mission import Mission, parse_mission

NAMES = st.from_regex(r"\A[A-Za-z0-9_][A-Za-z0-9_.-]{0,39}\Z")
FINITE = st.floats(-50_000, 50_000)
POSITIVE = st.floats(0.1, 1000)
PLACES = st.one_of(
    st.fixed_dictionaries({"x_m": FINITE, "y_m": FINITE}),
    st.fixed_dictionaries({"lat_deg": st.floats(-84, 84), "lon_deg": st.floats(-180, 180)}),
)
POINTS = st.builds(
    lambda place, height: {**place, **height},
    PLACES,
    st.one_of(
        st.fixed_dictionaries({"alt_amsl_m": st.floats(0, 5000)}),
        st.fixed_dictionaries({"height_agl_m": st.floats(0, 500)}),
    ),
)
SETTINGS = {
    "autopilot": st.sampled_from(["ardupilot", "px4"]),
    "class": st.sampled_from(["copter", "plane"]),
    "climb": st.fixed_dictionaries({}, optional={"rate_m_s": POSITIVE, "angle_max_deg": st.floats(1, 89)}),
    "safety": st.fixed_dictionaries({}, optional={"terrain_m": POSITIVE, "obstacle_m": POSITIVE}),
    "tracking_error_m": POSITIVE,
    "endurance_s": st.none() | POSITIVE,
}
VEHICLES = st.lists(
    st.fixed_dictionaries({"name": NAMES, "home": PLACES, "goal": POINTS}, optional=SETTINGS),
    min_size=1, max_size=4, unique_by=lambda v: v["name"],
)  # fmt: skip
MISSIONS = st.fixed_dictionaries(
    {
        "name": NAMES,
        "origin": st.fixed_dictionaries({"lat_deg": st.floats(-84, 84), "lon_deg": st.floats(-180, 180)}),
        "terrain": st.fixed_dictionaries({"kind": st.just("flat"), "alt_amsl_m": st.floats(0, 4000)}),
        "vehicles": VEHICLES,
    },
    optional={
        "defaults": st.fixed_dictionaries({}, optional=SETTINGS),
        "obstacles": st.lists(
            st.fixed_dictionaries({"kind": st.just("cylinder"), "name": NAMES, "center": PLACES, "radius_m": POSITIVE}),
            max_size=3,
            unique_by=lambda o: o["name"],
        ),
    },
)
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs"], exclude_characters="\ufeff\u2028\u2029"))
JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-(10**17), 10**17), st.floats(-1e300, 1e300), TEXTS),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abcxyz_", min_size=1), inner, max_size=4),
    max_leaves=10,
)  # fmt: skip


def paths(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return where every value within a value stands."""
    found = [at] if at else []
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        found += paths(inner, (*at, key))
    return found


@settings(deadline=None, max_examples=40)
@given(MISSIONS)
def test_missions_survive_writing_and_reading(data: dict[str, Any]) -> None:
    mission = parse_mission(json.dumps(data), "m")
    assert mission == Mission.model_validate(data)
    assert parse_mission(mission.model_dump_json(by_alias=True), "m") == mission
    assert parse_mission(mission.model_dump_json(by_alias=True, exclude_unset=True), "m") == mission


@settings(deadline=None, max_examples=40)
@given(MISSIONS)
def test_own_values_come_before_defaults_and_defaults_before_ours(data: dict[str, Any]) -> None:
    mission = parse_mission(json.dumps(data), "m")
    defaults = data.get("defaults", {})
    for vehicle, own in zip(mission.vehicles, data["vehicles"], strict=True):
        assert vehicle.tracking_error_m == own.get("tracking_error_m", defaults.get("tracking_error_m", 2.0))
        assert vehicle.autopilot == own.get("autopilot", defaults.get("autopilot", "ardupilot"))
        for field, ours in (("terrain_m", 20.0), ("obstacle_m", 10.0)):
            shared = defaults.get("safety", {}).get(field, ours)
            assert getattr(vehicle.safety, field) == own.get("safety", {}).get(field, shared)


@settings(deadline=None, max_examples=40)
@given(MISSIONS, st.data())
def test_whatever_is_wrong_is_told_in_one_line_with_its_place(data: dict[str, Any], draw: st.DataObject) -> None:
    """Any value replaced by any other: the mission is read, or one line says where it went wrong."""
    at = draw.draw(st.sampled_from(paths(data)))
    wrong = draw.draw(st.sampled_from([None, True, "text", [], {}, [1], -1, 0, math.nan, math.inf, 1e300, {"x_m": 1}]))
    broken = copy.deepcopy(data)
    holder = broken
    for step in at[:-1]:
        holder = holder[step]
    holder[at[-1]] = wrong
    try:
        parse_mission(yaml.safe_dump(broken), "m.yaml")
    except MissionError as error:
        message = str(error)
        place, _, rest = message.partition(": ")
        assert place.rpartition(":")[2].isdigit() or place == "m.yaml"
        assert "expected" in rest
        assert "\n" not in message


@settings(deadline=None, max_examples=40)
@given(MISSIONS, st.data())
def test_a_misspelt_field_is_named_with_its_line(data: dict[str, Any], draw: st.DataObject) -> None:
    at = draw.draw(st.sampled_from([p for p in paths(data) if isinstance(p[-1], str) and p[-1] != "kind"]))
    broken = copy.deepcopy(data)
    holder = broken
    for step in at[:-1]:
        holder = holder[step]
    holder[at[-1] + "_q"] = holder.pop(at[-1])
    text = yaml.safe_dump(broken)
    try:
        parse_mission(text, "m.yaml")
        raise AssertionError("a misspelt field was taken")
    except MissionError as error:
        message = str(error)
    assert f"{at[-1]}_q" in message
    line = next(n for n, line in enumerate(text.splitlines(), 1) if f"{at[-1]}_q:" in line)
    assert message.startswith(f"m.yaml:{line}: ") or f"line {line}: " in message


@settings(deadline=None)
@given(st.dictionaries(st.text("abcxyz_", min_size=1), JSON))
def test_documents_read_json_as_json_does(data: dict[str, Any]) -> None:
    assert parse_document(json.dumps(data), "d").data == data


@settings(deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_in_one_line(text: str) -> None:
    try:
        parse_mission(text, "m.yaml")
    except MissionError as error:
        assert "\n" not in str(error)
