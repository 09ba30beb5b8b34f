"""PX4 planes: predicted with PX4's own parameters, and said not to be measured."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from missionplanner import timing
from missionplanner.replay import path_distance_m
from missionplanner.scene import Scene
from tests.scenes import at, question, scene_of
from tests.unit.test_proof import by_hand

WIDE = {"south_west": at(-3000, -3000), "north_east": at(3000, 3000)}
SPEED_M_S = 18.0


def lone(autopilot: str, **changes: Any) -> Scene:
    plane: dict[str, Any] = {
        "name": "pat",
        "home": at(-1500, 0),
        "goal": at(300, 0, agl=100),
        "autopilot": autopilot,
        "class": "plane",
    }
    plane |= {"takeoff_height_m": 60, "end": "loiter", "speed_m_s": {"min": 12, "max": 20}}
    return scene_of(question(plane | changes, area=WIDE, fleet={"direct_return": "waived"}))


def turning(scene: Scene) -> list[tuple[float, float, float]]:
    """Return a route with two right angles and a turn back."""
    x_m, y_m, z_m = scene.tasks[0].route_m[0].tolist()
    return [(x_m, y_m, z_m), (-300, 0, 200), (-300, 600, 200), (300, 0, 200)]


@pytest.mark.parametrize(("parameters", "off_m"), [({"FW_R_LIM": 35}, 13.0), ({"NPFG_PERIOD": 25}, 13.0)])
def test_what_turns_it_otherwise_is_flown_otherwise(parameters: dict[str, float], off_m: float) -> None:
    """Set so in the mission file it is another certificate; held by the vehicle alone, it would leave its tube."""
    usual, other = (lone("px4", parameters=said).tasks[0] for said in ({}, parameters))
    waypoints_m = np.array(turning(lone("px4")))
    flown = [
        timing.predict_flight(task.motion, task.home_m, waypoints_m, SPEED_M_S, end="loiter") for task in (usual, other)
    ]
    (predicted, _), (track, reached_s) = flown
    en_route = track.t_s < reached_s[-1]
    assert path_distance_m(track.position_m[en_route], predicted.position_m).max() > off_m


def test_what_it_is_certified_with_is_what_px4_holds_by_default() -> None:
    task = lone("px4").tasks[0]
    told = replace(task.motion.plane, roll_max_deg=50.0, l1_period_s=10.0, l1_damping=0.7, pitch_limits_deg=(-30, 30))
    assert told == task.motion.plane


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_certificate_says_what_was_never_measured(autopilot: str) -> None:
    scene = lone(autopilot)
    certificate = by_hand(scene, turning(scene), speed_m_s=SPEED_M_S).certificate
    assert certificate is not None
    told = "pat flies as predicted: not measured, no PX4 plane was ever recorded"
    assert (told in certificate.assumptions) == (autopilot == "px4")
