"""Fleets of every kind, with every ending and rule of starting: planned and flown in lock-step."""

from __future__ import annotations

from typing import Any

import pytest

from missionplanner.flight_check import check_flight
from missionplanner.planner import plan_fleet
from tests.main_job import fly
from tests.scenes import at, copter, question, scene_of

_MAST = {"kind": "cylinder", "name": "mast", "center": at(250, 0), "radius_m": 8, "top_height_agl_m": 90}
_COPTERS = (
    copter("a", (0, -50), (500, -50)),
    copter("b", (0, 50), (480, 100), stops=[at(200, 130, agl=50)]),
    copter("c", (0, 0), (500, 20), autopilot="px4"),
)  # their ways home do not cross


@pytest.mark.parametrize(
    ("end", "rules"),
    [
        ("land", {"launch_interval_s": 10.0}),
        ("rtl", {}),
        ("rtl", {"arrive_together": False, "launch_interval_s": 12.0}),
        ("loiter", {"launch_interval_s": 7.3}),
        ("loiter", {"arrive_together": False}),
    ],
)
def test_copters(end: str, rules: dict[str, Any]) -> None:
    scene = scene_of(question(*_COPTERS, obstacles=[_MAST], fleet=rules, defaults={"end": end}))
    plan = plan_fleet(scene)
    flight = fly(scene, plan)
    assert check_flight(scene, plan, flight).ok
    for index, (planned, flown) in enumerate(zip(plan.vehicles, flight.vehicles, strict=True)):
        assert planned.start_delay_s >= index * rules.get("launch_interval_s", 0.0)
        assert flown.arrival_s == pytest.approx(planned.arrival_s, abs=0.15)
        assert (flown.landed_s is None) == (end == "loiter")
        if flown.landed_s is not None:
            # a PX4 vehicle that climbs for its return does so at once or some seconds later: a centimetre of where it
            # came to rest decides
            late_s = 5.0 if end == "rtl" and scene.tasks[index].motion.autopilot == "px4" else 0.5
            assert flown.landed_s == pytest.approx(planned.trajectory.t_s[-1], abs=late_s)
    if rules.get("arrive_together", True):
        assert flight.arrival_spread_s is not None
        assert flight.arrival_spread_s < 0.2


@pytest.mark.parametrize(("copters_end", "planes_end"), [("land", "loiter"), ("rtl", "rtl")])
def test_all_four_kinds_arrive_together(copters_end: str, planes_end: str) -> None:
    planes = {"class": "plane", "end": planes_end}
    scene = scene_of(
        question(
            copter("ac", (0, 0), (900, 40), end=copters_end),
            copter("pc", (0, 100), (900, 140), end=copters_end, autopilot="px4"),
            copter("ap", (-400, -380), (1700, -380), stops=[at(500, -600, agl=80)], **planes),
            copter("pp", (-400, 480), (1700, 580), stops=[at(500, 800, agl=80)], autopilot="px4", **planes),
            obstacles=[{**_MAST, "center": at(500, 55)}],
        )
    )
    plan = plan_fleet(scene)
    flight = fly(scene, plan)
    assert plan.arrival_s is not None
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s < 0.2
    assert [v.arrival_s for v in flight.vehicles] == pytest.approx([plan.arrival_s] * 4, abs=0.15)
    assert check_flight(scene, plan, flight).ok
