"""The ridge line, disturbed in ways that the plan does not know of, and kept together on the way."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from missionplanner.plan import FleetPlan
from missionplanner.scene import Scene
from sim.rehearsal import Pause, Rehearsal, rehearse
from tests.command_line import Cli
from tests.main_job import load_scene, mission_path, plan_into

SPREAD_MAX_S = 3.0


def wind(from_deg: float, speed_m_s: float = 5.0) -> tuple[float, float]:
    angle = math.radians(from_deg)
    return -speed_m_s * math.sin(angle), -speed_m_s * math.cos(angle)


@pytest.fixture(scope="module")
def planned() -> Iterator[tuple[Scene, FleetPlan]]:
    with tempfile.TemporaryDirectory() as name:
        scene = load_scene(mission_path("ridge_line"))
        yield scene, plan_into(Path(name), scene, seed=1)


def fly(planned: tuple[Scene, FleetPlan], **disturbed: Any) -> Rehearsal:
    scene, plan = planned
    return rehearse(scene, plan, **{"correct": True, **disturbed})


def check(rehearsal: Rehearsal, spread_max_s: float = SPREAD_MAX_S) -> None:
    spread_s = rehearsal.flight.arrival_spread_s
    assert spread_s is not None
    assert spread_s <= spread_max_s
    assert rehearsal.check.ok
    assert all(correction.obeyed for correction in rehearsal.flight.corrections)


@pytest.mark.slow
def test_undisturbed_nothing_is_corrected(planned: tuple[Scene, FleetPlan]) -> None:
    rehearsal = fly(planned)
    check(rehearsal, 0.5)
    assert rehearsal.flight.corrections == ()


@pytest.mark.slow
@pytest.mark.parametrize(("from_deg", "spread_max_s"), [(0.0, 5.0), (315.0, SPREAD_MAX_S)])  # 4.2 s from the north
def test_unknown_wind_does_not_part_the_fleet(
    planned: tuple[Scene, FleetPlan], from_deg: float, spread_max_s: float
) -> None:
    check(fly(planned, wind_m_s=wind(from_deg)), spread_max_s)


@pytest.mark.slow
def test_who_cannot_fly_slowly_enough_is_stopped_where_that_is_allowed(planned: tuple[Scene, FleetPlan]) -> None:
    rehearsal = fly(planned, wind_m_s=wind(225.0), hold=True)
    check(rehearsal)
    assert any(correction.to_m_s == 0.0 for correction in rehearsal.flight.corrections)
    assert any(correction.from_m_s == 0.0 for correction in rehearsal.flight.corrections)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["osprey"])
def test_a_late_start_does_not_part_the_fleet(planned: tuple[Scene, FleetPlan], name: str) -> None:
    alone = fly(planned, late_s={name: 10.0}, correct=False)
    spread_s = alone.flight.arrival_spread_s
    assert spread_s is not None
    assert spread_s > 8.0
    check(fly(planned, late_s={name: 10.0}))


@pytest.mark.slow
def test_a_pause_in_mid_mission_does_not_part_the_fleet(planned: tuple[Scene, FleetPlan]) -> None:
    rehearsal = fly(planned, pauses=[Pause("merlin", 400.0, 30.0), Pause("osprey", 800.0, 10.0)])
    check(rehearsal)


@pytest.mark.slow
def test_the_command_line_keeps_a_fleet_together(cli: Cli, tmp_path: Path) -> None:
    folder = tmp_path / "plan"
    assert cli("plan", mission_path("quickstart"), "--output", folder).code == 0
    disturbed = ("--sim-late", "alpha=6", "--sim-wind", "2,270", "--json")
    alone = json.loads(cli("fly", folder, *disturbed, "--no-correct").out)
    assert alone["fleet"]["flown_arrival_spread_s"] > 4.0
    ended = cli("fly", folder, *disturbed, "--correct")
    assert json.loads(ended.out)["fleet"]["flown_arrival_spread_s"] <= SPREAD_MAX_S
    assert "alpha: " in ended.err
    assert "would arrive" in ended.err
    flight = json.loads((folder / "flight.json").read_text())
    assert flight["corrections"]
    assert flight["vehicles"][0]["lateness"]["arrival_s"]


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("--sim-wind", "5", "expected SPEED_M_S,FROM_DEG"),
        ("--sim-wind", "fast,270", "expected SPEED_M_S,FROM_DEG"),
        ("--sim-wind", "-1,270", "expected a speed from 0 to 50 m/s"),
        ("--sim-wind", "nan,270", "expected a speed from 0 to 50 m/s"),
        ("--sim-late", "uav1", "expected NAME=SECONDS"),
        ("--sim-late", "uav1=soon", "expected NAME=SECONDS"),
        ("--sim-late", "uav1=-3", "expected 0 to 3600 seconds"),
    ],
)
def test_disturbances_are_checked_before_anything_is_planned(cli: Cli, option: str, value: str, told: str) -> None:
    ended = cli("fly", mission_path("quickstart"), f"{option}={value}")
    assert ended.code == 2
    assert told in ended.err


def test_real_vehicles_are_not_disturbed(cli: Cli) -> None:
    ended = cli("fly", mission_path("quickstart"), "--connect", "udpin:127.0.0.1:0", "--sim-wind", "5,270")
    assert ended.code == 2
    assert "--sim-wind: expected only with built-in simulated vehicles" in ended.err
