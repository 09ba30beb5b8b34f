"""Fixed wing from mission to flight: planned, uploaded, flown in lock-step, and held against the prediction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.flight_check import check_flight
from missionplanner.planner import plan_fleet
from tests.main_job import fly
from tests.scenes import ORIGIN, at, scene_of

_PEAKS = {
    "kind": "peaks",
    "base_alt_amsl_m": 480,
    "cell_m": 20,
    "peaks": [
        {**at(900, 500), "height_m": 180, "spread_m": 350},
        {**at(1800, -200), "height_m": 120, "spread_m": 300},
    ],
}
_MAST = {"kind": "cylinder", "name": "mast", "center": at(1300, 100), "radius_m": 10, "top_height_agl_m": 200}
_RADAR = {"kind": "radar", "name": "radar", "center": at(2000, 600, agl=0), "radius_m": 250}


def _mission(**defaults: Any) -> dict[str, Any]:
    return {
        "name": "planes",
        "origin": ORIGIN,
        "terrain": _PEAKS,
        "obstacles": [_MAST, _RADAR],
        "defaults": {"class": "plane", "tracking_error_m": 5, **defaults},
        "vehicles": [
            {"name": "p1", "home": at(0, 0), "goal": at(2800, 300, agl=90)},
            {
                "name": "p2",
                "autopilot": "px4",
                "home": at(0, 200),
                "stops": [at(1200, 1100, agl=100)],
                "goal": at(2600, 1000, agl=100),
            },
        ],
        "planner": {"population": 20, "iterations": 40},
        "fleet": {"direct_return": "waived"},  # bounded roughly, a plane's way home is not proven beside mountains
    }


@pytest.mark.parametrize("seed", [1, 2])
def test_two_planes_pass_a_mast_and_a_radar_and_arrive_together(seed: int) -> None:
    scene = scene_of(_mission())
    plan = plan_fleet(scene, seed=seed)
    flight = fly(scene, plan)
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s < 0.2
    assert check_flight(scene, plan, flight).ok
    for planned, flown in zip(plan.vehicles, flight.vehicles, strict=True):
        assert flown.arrival_s == pytest.approx(planned.arrival_s, abs=0.1)
        off_m = np.linalg.norm(flown.trajectory.position_m - planned.trajectory.at(flown.trajectory.t_s), axis=1)
        assert off_m.max() < 0.5


def test_planes_that_return_end_above_their_homes() -> None:
    question = _mission(end="rtl")
    question["terrain"] = {"kind": "flat", "alt_amsl_m": 480}
    question["obstacles"] = [_MAST | {"center": at(1300, -250)}]  # beside all ways home: planes do not climb over it
    question["vehicles"][1]["home"] = at(0, 900)  # as far apart as planes that turn onto their ways home need
    scene = scene_of(question)
    plan = plan_fleet(scene)
    flight = fly(scene, plan)
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s < 0.2
    assert check_flight(scene, plan, flight).ok
    for planned, flown in zip(plan.vehicles, flight.vehicles, strict=True):
        assert flown.landed_s is None
        away_m = np.hypot(*(flown.trajectory.position_m[-1] - planned.home_m)[:2])
        assert away_m < planned.motion.loiter_radius_m + 100.0
        circling = planned.trajectory.position_m[-200:]
        away_m = np.hypot(*(circling - planned.home_m)[:, :2].T)  # it slips outwards, the more in thin air
        assert away_m.min() > planned.motion.loiter_radius_m
        assert away_m.max() < 1.5 * planned.motion.loiter_radius_m
        assert circling[:, 2] == pytest.approx(planned.home_m[2] + planned.motion.return_height_m, abs=1.0)


def test_a_plane_is_not_told_to_land() -> None:
    with pytest.raises((MissionError, ValueError), match="expected loiter or rtl for a plane"):
        scene_of(_mission(end="land"))
