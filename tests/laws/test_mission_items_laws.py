"""Laws of the wire's units and of both mission files: what is written is what is read."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from adapters.mission_items import (
    MissionItem,
    degrees_to_wire,
    float32_text,
    item_waypoints,
    plan_items,
    to_float32,
    wire_to_degrees,
)
from adapters.plan_file import PlanFile, plan_text, read_plan
from adapters.waypoints_file import read_waypoints, waypoints_text
from missionplanner.geodesy import GeoPoint
from missionplanner.vehicle import Autopilot, Ending
from tests.plans import FRAME, vehicle_plan

autopilots: st.SearchStrategy[Autopilot] = st.sampled_from(["ardupilot", "px4"])
endings: st.SearchStrategy[Ending] = st.sampled_from(["land", "rtl", "loiter"])
single = st.floats(width=32, allow_nan=False, allow_infinity=False)
longitudes = st.integers(-1_800_000_000, 1_800_000_000)
latitudes = st.integers(-900_000_000, 900_000_000)
points = st.tuples(st.floats(-20e3, 20e3), st.floats(-20e3, 20e3), st.floats(-400, 8000))


@given(st.floats(-180, 180))
def test_scaling_is_to_the_nearest(degrees: float) -> None:
    assert abs(degrees_to_wire(degrees) - degrees * 1e7) <= 0.5 + 1e-6


@given(longitudes)
def test_wire_degrees_survive(wire: int) -> None:
    assert degrees_to_wire(wire_to_degrees(wire)) == wire
    assert degrees_to_wire(float(f"{wire_to_degrees(wire):.8f}")) == wire


@given(st.floats(width=32, allow_infinity=False))
def test_short_numbers_read_back_exactly(value: float) -> None:
    back = float(np.float32(float(float32_text(value))))
    assert back == value or (math.isnan(back) and math.isnan(value))


@st.composite
def missions(draw: st.DrawFn, autopilot: Autopilot) -> tuple[MissionItem, ...]:
    count = draw(st.integers(1, 12))
    param = single if autopilot == "ardupilot" else st.one_of(single, st.just(math.nan))
    items = [
        MissionItem(
            seq,
            draw(st.sampled_from([0, 2, 3])),
            draw(st.sampled_from([16, 20, 21, 22, 93, 178])),
            *(draw(param) for _ in range(4)),
            draw(latitudes),
            draw(longitudes),
            draw(single),
            current=int(seq == 0),
        )
        for seq in range(count)
    ]
    if autopilot == "ardupilot":
        home = draw(st.tuples(latitudes, longitudes, single))
        items[0] = MissionItem(0, 0, 16, x=home[0], y=home[1], z=home[2], current=1)
    return tuple(items)


@given(st.data(), autopilots)
def test_files_read_back_equal(data: st.DataObject, autopilot: Autopilot) -> None:
    items = data.draw(missions(autopilot))
    home = GeoPoint(wire_to_degrees(items[0].x), wire_to_degrees(items[0].y), items[0].z)
    with tempfile.TemporaryDirectory() as folder:
        plan_path = Path(folder, "uav.plan")
        plan_path.write_text(plan_text(PlanFile(autopilot, home, items), "copter"))
        back = read_plan(plan_path)
        waypoints_path = Path(folder, "uav.waypoints")
        waypoints_path.write_text(waypoints_text(items, autopilot, home))
        assert read_waypoints(waypoints_path, autopilot) == items
    assert back.items == items
    assert back.autopilot == autopilot
    assert (back.home.lat_deg, back.home.lon_deg) == (home.lat_deg, home.lon_deg)
    assert to_float32(back.home.alt_amsl_m) == home.alt_amsl_m


@given(st.lists(points, min_size=2, max_size=8), autopilots, endings)
def test_plans_come_back_within_a_hundred_nanodegrees_and_a_millimetre(
    waypoints_m: list[tuple[float, float, float]], autopilot: Autopilot, end: Ending
) -> None:
    vehicle = vehicle_plan(autopilot=autopilot, end=end, waypoints_m=waypoints_m)
    back = FRAME.to_geo(item_waypoints(plan_items(vehicle, FRAME), autopilot, FRAME))
    there = FRAME.to_geo(vehicle.waypoints_m)
    if autopilot == "ardupilot":  # to which an altitude of nought means the present one: never sent, but for home's top
        there[2][1:][np.abs(there[2][1:]) < 0.02] = 0.02
    for k, tolerance in enumerate([1e-7, 1e-7, 1e-3]):
        np.testing.assert_allclose(back[k], there[k], atol=tolerance, rtol=0)
