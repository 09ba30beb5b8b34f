"""Fences and rally points from the mission file: what is sent, what is kept back, and what a held fence would do."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from shapely import LineString, Point, Polygon

from adapters.export import export_fleet
from adapters.guards import Area, Guard, area_items, breach, guard, read_areas
from adapters.mission_items import MissionItem, wire_to_degrees
from missionplanner.errors import InfeasibleError
from missionplanner.mission import Fence, Fleet, NoFly, Place, RallyPoint
from missionplanner.plan import FleetPlan
from missionplanner.vehicle import Autopilot
from tests.plans import FRAME, fleet_plan, vehicle_plan

REACH_M = 5.0  # of an ArduCopter: 2 + 1 m, and corners cut within 2 m
PLAN = fleet_plan(vehicle_plan())  # from 0, 0 over 120, 40 to 240, -35


def polygon(*corners: tuple[float, float]) -> tuple[Place, ...]:
    return tuple(Place(x_m=x, y_m=y) for x, y in corners)


def box(west: float, south: float, east: float, north: float) -> tuple[Place, ...]:
    return polygon((west, south), (east, south), (east, north), (west, north))


def asked(
    *no_fly: tuple[Place, ...], fence: tuple[Place, ...] | None = None, send: bool = True, plan: FleetPlan = PLAN
) -> FleetPlan:
    changes = {
        "obstacles": tuple(NoFly(kind="no_fly", name=f"area{k}", polygon=area) for k, area in enumerate(no_fly)),
        "fence": None if fence is None else Fence(polygon=fence),
        "fleet": Fleet(send_fence=send),
    }
    return replace(plan, mission=plan.mission.model_copy(update=changes))


def sent(plan: FleetPlan) -> Guard:
    return guard(plan, plan.vehicles[0])


def test_nothing_asked_nothing_sent() -> None:
    assert sent(PLAN) == Guard()
    assert sent(asked(box(400, 0, 500, 50), fence=box(-50, -100, 300, 100), send=False)) == Guard()


def test_the_fence_and_the_areas_far_off_are_sent() -> None:
    items = sent(asked(box(100, 100, 200, 200), fence=box(-50, -100, 300, 300))).fence
    assert [(i.seq, i.command, i.param1) for i in items] == [
        *((k, 5001, 4.0) for k in range(4)),
        *((k, 5002, 4.0) for k in range(4, 8)),
    ]
    back_m = FRAME.to_local([i.x * 1e-7 for i in items], [i.y * 1e-7 for i in items], [0.0] * 8)
    expected = [(-50, -100), (300, -100), (300, 300), (-50, 300), (100, 100), (200, 100), (200, 200), (100, 200)]
    np.testing.assert_allclose(back_m[:, :2], expected, atol=0.01)


@pytest.mark.parametrize(
    ("area", "told"),
    [
        (box(50, -10, 70, 30), "its mission crosses it"),
        (box(110, 42, 130, 80), "its mission comes within 2.0 m of its edge, where it may stray 5.0 m"),
        (box(90, -8, 110, 2), "its way home crosses it"),
        (box(119, 10, 121, 20), "its way home crosses it"),  # within the triangle of a leg and home
        (box(80, -40, 160, -8), "its way home crosses it"),
    ],
)
def test_an_area_that_is_crossed_somewhere_is_kept_back(area: tuple[Place, ...], told: str) -> None:
    found = sent(asked(area, box(400, 0, 500, 50)))
    assert len(found.fence) == 4
    assert found.kept_back == (f"uav1 is not sent no-fly area area0: {told}, and its fence knows no heights",)


def test_a_fence_that_would_end_the_mission_is_never_sent() -> None:
    for fence, told in (
        (box(-50, -100, 200, 100), "its mission leaves it"),
        (box(-50, -100, 243, 100), "its mission comes within 3.0 m of its edge, where it may stray 5.0 m"),
    ):
        with pytest.raises(InfeasibleError, match=f"uav1: as a fence .* end its mission: {told}; widen it"):
            sent(asked(fence=fence))


def test_long_edges_need_more_room_for_they_bulge() -> None:
    """Straight between latitudes and longitudes is not straight on the map: 4.7 m over 20 km at 34 degrees."""
    near = asked(fence=box(-8_000, -100, 245.2, 20_000))
    assert sent(asked(fence=box(-80, -100, 245.2, 100))).fence
    with pytest.raises(InfeasibleError, match=r"comes within 5\.2 m of its edge, where it may stray 10"):
        sent(near)


@given(
    st.lists(st.tuples(st.floats(-400, 400), st.floats(-400, 400)), min_size=3, max_size=6),
    st.lists(st.tuples(st.floats(-300, 300), st.floats(-300, 300)), min_size=2, max_size=5),
    st.booleans(),
)
def test_what_is_let_through_keeps_clear(
    corners: list[tuple[float, float]], way: list[tuple[float, float]], inclusion: bool
) -> None:
    """By shapely: whoever is let through keeps its reach from the area, on its mission and on its ways home."""
    outline = Polygon(corners)
    assume(outline.is_valid and outline.area > 1.0)
    track = LineString([(0.0, 0.0), *way])
    assume(all(math.dist(a, b) > 1.0 for a, b in itertools.pairwise(way)))
    plan = fleet_plan(vehicle_plan(waypoints_m=[(x, y, 1230.0) for x, y in way], end="loiter"))
    wires = [FRAME.geo_point([x, y, 0.0]) for x, y in corners]
    area = Area(inclusion, tuple((round(p.lat_deg * 1e7), round(p.lon_deg * 1e7)) for p in wires))
    reason = breach(area_items([area]), plan, plan.vehicles[0])
    swept = track
    for a, b in itertools.pairwise(track.coords):
        swept = swept.union(Polygon([(0.0, 0.0), a, b]) if Polygon([(0.0, 0.0), a, b]).area > 0 else LineString([a, b]))
    apart_m = outline.exterior.distance(swept)
    clear = (outline.contains(swept) if inclusion else not outline.intersects(swept)) and apart_m >= REACH_M
    if abs(apart_m - REACH_M) > 0.1 and apart_m > 0.0:
        assert (reason is None) == clear


@pytest.mark.parametrize(("radius_m", "kept"), [(5.0, False), (239.0, False), (245.0, False), (249.5, True)])
def test_circles_that_vehicles_hold_are_judged(radius_m: float, kept: bool) -> None:
    centre = FRAME.geo_point([0.0, 0.0, 0.0])
    circle = Area(True, ((round(centre.lat_deg * 1e7), round(centre.lon_deg * 1e7)),), radius_m)
    assert (breach(area_items([circle]), PLAN, PLAN.vehicles[0]) is None) == kept
    outside = Point(240, -35).distance(Point(0, 0))
    assert outside + REACH_M < 249.5


@given(
    st.lists(
        st.builds(
            Area,
            st.booleans(),
            st.lists(st.tuples(st.integers(-(10**8), 10**8), st.integers(-(10**9), 10**9)), min_size=3, max_size=5).map(
                tuple
            ),
        )
        | st.builds(
            Area,
            st.booleans(),
            st.tuples(st.tuples(st.integers(-(10**8), 10**8), st.integers(-(10**9), 10**9))),
            st.integers(1, 10_000).map(float),
        )
    )
)
def test_areas_survive_the_wire(areas: list[Area]) -> None:
    items = area_items(areas)
    assert [item.seq for item in items] == list(range(len(items)))
    read = read_areas(items)
    assert [(a.inclusion, a.corners, a.radius_m) for a in read] == [(a.inclusion, a.corners, a.radius_m) for a in areas]


@pytest.mark.parametrize(
    ("items", "told"),
    [
        ([(5001, 3.0)] * 2, "fence item 0: expected 3 corners of a polygon in a row, got others"),
        ([(5001, 3.0)] * 3 + [(5002, 4.0)] * 3 + [(5001, 4.0)], "fence item 3: expected 4 corners"),
        ([(5001, 2.0)] * 2, "fence item 0: expected 2 corners"),
        ([(5001, math.nan)], "fence item 0: expected nan corners"),
        ([(5003, 0.0)], "fence item 0: expected a radius above 0, got 0"),
        ([(16, 0.0)], "fence item 0: expected an area, got command 16"),
    ],
)
def test_a_fence_that_cannot_be_understood_is_no_fence_to_fly_with(items: list[tuple[int, float]], told: str) -> None:
    fence = [MissionItem(k, 0, command, size, x=k, y=k) for k, (command, size) in enumerate(items)]
    assert told in str(breach(fence, PLAN, PLAN.vehicles[0]))


@pytest.mark.parametrize(("autopilot", "height_m"), [("ardupilot", 42.0), ("px4", 41.5)])
def test_rally_points_are_above_home(autopilot: Autopilot, height_m: float) -> None:
    plan = fleet_plan(vehicle_plan(autopilot=autopilot))
    [vehicle] = plan.mission.vehicles
    bound = vehicle.model_copy(update={"rally": (RallyPoint(x_m=50.0, y_m=60.0, height_above_home_m=41.5),)})
    plan = replace(plan, mission=plan.mission.model_copy(update={"vehicles": (bound,)}))
    [item] = sent(plan).rally
    assert (item.frame, item.command, item.z) == (3, 5100, height_m)
    np.testing.assert_allclose(FRAME.to_local(item.x * 1e-7, item.y * 1e-7, 0.0)[:2], [50.0, 60.0], atol=0.01)


def test_ground_stations_get_them_in_the_plan_file(tmp_path: Path) -> None:
    export_fleet(asked(box(100, 100, 200, 200), fence=box(-50, -100, 300, 300)), tmp_path)
    document = json.loads((tmp_path / "uav1.plan").read_text())
    assert document["rallyPoints"] == {"version": 2, "points": []}
    assert document["geoFence"]["circles"] == []
    inclusion, exclusion = document["geoFence"]["polygons"]
    assert (inclusion["inclusion"], exclusion["inclusion"]) == (True, False)
    assert (inclusion["version"], len(exclusion["polygon"])) == (1, 4)
    lat_deg, lon_deg = exclusion["polygon"][0]
    np.testing.assert_allclose(FRAME.to_local(lat_deg, lon_deg, 0.0)[:2], [100.0, 100.0], atol=0.01)
    assert round(lat_deg * 1e7) * 1e-7 == pytest.approx(lat_deg, abs=1e-12)
    assert wire_to_degrees(round(lat_deg * 1e7)) == lat_deg
