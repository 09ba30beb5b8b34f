"""Meetings on the way, arrivals in order, later starts and holds: planned and flown in lock-step."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from missionplanner.flight_check import check_flight
from missionplanner.plan import FleetFlight, FleetPlan, FlownVehicle
from missionplanner.planner import plan_fleet
from missionplanner.scene import Scene
from tests.main_job import fly
from tests.scenes import at, copter, question, scene_of

_NEAR_S = 1.0  # PX4 accepts a place 2 m before it, and may stop there; positions are recorded five times a second


def passed_s(flown: FlownVehicle, place_m: np.ndarray) -> float:
    """Return when a vehicle was nearest to a place, between its recorded positions."""
    t_s = np.arange(0.0, float(flown.trajectory.t_s[-1]), 0.02)
    return float(t_s[np.argmin(np.linalg.norm(flown.trajectory.at(t_s) - place_m, axis=1))])


def planned_and_flown(*vehicles: dict[str, Any], **changes: Any) -> tuple[Scene, FleetPlan, FleetFlight]:
    scene = scene_of(question(*vehicles, **changes))
    plan = plan_fleet(scene)
    flight = fly(scene, plan)
    assert check_flight(scene, plan, flight).ok
    return scene, plan, flight


@pytest.mark.parametrize("autopilots", [("ardupilot", "ardupilot"), ("px4", "px4"), ("ardupilot", "px4")])
def test_two_meet_twice_and_arrive_in_order(autopilots: tuple[str, str]) -> None:
    one = copter("one", (0, 0), (700, 0), stops=[at(150, 0, agl=40), at(400, 30, agl=50)], autopilot=autopilots[0])
    two = copter("two", (0, 80), (700, 80), stops=[at(260, 80, agl=45), at(560, 90, agl=40)], autopilot=autopilots[1])
    meetings = [{"name": "begin", "at": {"one": 1, "two": 1}}, {"name": "end", "at": {"one": 2, "two": 2}}]
    fleet = {"rendezvous": meetings, "arrival_order": ["two", "one"], "arrival_spacing_s": 9.0}
    scene, plan, flight = planned_and_flown(one, two, fleet=fleet)
    for number in (1, 2):
        times = [passed_s(v, task.route_m[number]) for v, task in zip(flight.vehicles, scene.tasks, strict=True)]
        assert abs(times[0] - times[1]) <= _NEAR_S
    first, second = flight.vehicles
    assert first.arrival_s is not None
    assert second.arrival_s is not None
    assert first.arrival_s - second.arrival_s == pytest.approx(9.0, abs=0.2)
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s <= 0.2
    assert plan.arrival_s == pytest.approx(second.arrival_s, abs=0.15)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_who_is_early_waits_at_the_meeting_and_all_arrive_together(autopilot: str) -> None:
    short = copter("short", (0, 0), (350, 0), stops=[at(300, 0, agl=40)], autopilot=autopilot)
    long = copter("long", (0, 80), (1000, 300), stops=[at(300, 80, agl=40)])
    meetings = [{"name": "line", "at": {"short": 1, "long": 1}}]
    _, plan, flight = planned_and_flown(short, long, fleet={"rendezvous": meetings})
    assert plan.vehicles[0].hold_s.max() > 10.0
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s <= 0.3
    track = flight.vehicles[0].trajectory
    still = [b for a, b in pairwise(track.t_s) if np.linalg.norm(track.at(a) - track.at(b)) <= 0.05 * (b - a)]
    assert len(still) > 10  # it stood there


def test_who_starts_later_arrives_with_the_others() -> None:
    near = copter("near", (0, 0), (150, 0))
    far = copter("far", (0, 80), (1500, 80))
    plane = copter("plane", (-300, 400), (2200, 600), **{"class": "plane", "end": "loiter"})
    _, plan, flight = planned_and_flown(near, far, plane)
    assert plan.vehicles[0].start_delay_s > 60.0
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s <= 0.2
    begins_s = plan.vehicles[0].start_delay_s
    stands_m = flight.vehicles[0].trajectory.at(np.linspace(0.0, begins_s, 20))
    np.testing.assert_allclose(stands_m, np.tile(stands_m[0], (20, 1)), atol=0.1)
