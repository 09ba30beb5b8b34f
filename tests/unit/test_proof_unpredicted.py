"""What is not predicted is not proven: flights with circles away from what was recorded, planes in more wind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionplanner import proof
from missionplanner.certificate import Certificate
from missionplanner.mission import Mission
from missionplanner.scene import build_check_scene
from missionplanner.sortie import Sortie
from tests.scenes import at, copter, question
from tests.unit.test_proof import leg, problems, scene, sortie

SHARP = {"MPC_XY_TRAJ_P": 1.0, "MPC_ACC_HOR": 10, "MPC_JERK_AUTO": 40}
UNKNOWN = "is not known: how it flies its circle is not predicted: replace the circle by waypoints"


def cornering(circle: bool, speed_m_s: float, **changes: Any) -> Certificate:
    speeds = {"min": 3, "max": 12}
    there = scene(copter("alpha", (0, 0), (300, 0), autopilot="px4", speed_m_s=speeds, **changes))
    ends = [(100, 0), (60, 90), (300, 0)]
    legs = [leg(x, y, seq=k, speed_m_s=speed_m_s) for k, (x, y) in enumerate(ends, start=1)]
    if circle:
        legs.append(leg(300, 0, seq=4, kind="circle", radius_m=20.0, speed_m_s=speed_m_s))
    return proof.prove(there, [sortie(there, *legs, ending="loiter", ending_seq=6)])


def test_a_circle_does_not_hide_that_corners_are_cut() -> None:
    (reason,) = problems(cornering(False, 12.0, parameters=SHARP))
    assert "off its legs with its speed and parameters" in reason
    (reason,) = problems(cornering(True, 12.0, parameters=SHARP))
    assert reason == f"alpha: item 4: whether it stays near its legs with its speed and parameters {UNKNOWN}"


def test_a_circle_as_it_was_recorded_is_proven() -> None:
    assert problems(cornering(True, 5.0)) == []


def test_a_circle_does_not_hide_splines() -> None:
    there = scene()
    legs = [leg(100, 40, kind="spline"), leg(200, 0, seq=4), leg(200, 0, seq=5, kind="circle", radius_m=20.0)]
    (reason,) = problems(proof.prove(there, [sortie(there, *legs, ending="loiter", ending_seq=6)]))
    assert reason == f"alpha: item 5: whether it stays near its legs with its splines {UNKNOWN}"


def wing_in(wind: dict[str, Any], tracking_error_m: float = 2.0) -> Certificate:
    wing = {"name": "wing", "class": "plane", "home": at(0, 0), "goal": at(2600, 0, amsl=260)}
    area = {"south_west": at(-1900, -1900), "north_east": at(4500, 1900)}
    margins = {"tracking_error_m": tracking_error_m}
    asked = question(wing, area=area, defaults=margins, fleet={"direct_return": "waived"}, **wind)
    there = build_check_scene(Mission.model_validate(asked), Path(), [])
    ends = [(1800, 0), (2600, 0), (2600, 800), (1000, 800)]
    legs = [leg(x, y, 160, seq=k, speed_m_s=20.0) for k, (x, y) in enumerate(ends, start=1)]
    legs[0] = replace(legs[0], kind="takeoff")
    home = np.array([0.0, 0.0, 100.0])
    flown = Sortie("wing", 1, "ardupilot", "plane", home, tuple(legs), "loiter", 5, 0.0, 250.0)
    return proof.prove(there, [flown])


def off_its_flight(certificate: Certificate) -> list[str]:
    return [reason for reason in problems(certificate) if "off its predicted flight" in reason]


@pytest.mark.parametrize(
    ("wind", "tracking_error_m", "holds"),
    [
        ({}, 2.0, True),
        ({"wind_max_m_s": 8}, 2.0, False),
        ({"wind_max_m_s": 8}, 90.0, True),
        ({"wind": {"speed_m_s": 8, "from_deg": 180}, "wind_max_m_s": 8}, 2.0, True),
        ({"wind": {"speed_m_s": 2, "from_deg": 180}, "wind_max_m_s": 8}, 2.0, False),
    ],
)
def test_a_plane_is_held_to_its_tube_in_the_strongest_wind(
    wind: dict[str, Any], tracking_error_m: float, holds: bool
) -> None:
    reasons = off_its_flight(wing_in(wind, tracking_error_m))
    assert (reasons == []) is holds
    assert all("state the wind (wind), or a greater tracking_error_m" in reason for reason in reasons)


def test_the_strongest_wind_is_said_to_leave_times_alone() -> None:
    (line,) = [line for line in wing_in({"wind_max_m_s": 8}).assumptions if "wind of at most" in line]
    assert line == "wind of at most 8 m/s: energy, braking and ways home allow for it, times do not"
