from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest
from rich.console import Console

from missionplanner.plan import Clearance, FleetFlight, FleetPlan, FlownVehicle
from missionplanner.proof import FlightCheck
from missionplanner.summary import fleet_lines, summarise, vehicle_table
from tests.plans import fleet_plan, small_fleet

TERRAIN = Clearance(31.4159, 22.0, "terrain", (1.0, 2.0, 3.0))
MAST = Clearance(12.345, 12.0, "mast", (1.0, 2.0, 3.0))
TOO_NEAR = Clearance(11.0, 12.0, "mast", (1.0, 2.0, 3.0))
APART = Clearance(40.04, 24.0, "uav1 - uav2", (1.0, 2.0, 3.0), 12.34)


def plan(*clearances: Clearance, separation: Clearance | None = APART, arrival_s: float | None = 40.0) -> FleetPlan:
    fleet = small_fleet("ardupilot", 2)
    vehicles = tuple(replace(v, clearances=clearances or (TERRAIN, MAST)) for v in fleet.vehicles)
    return replace(fleet, vehicles=vehicles, separation=separation, arrival_s=arrival_s)


def flight(fleet: FleetPlan, *arrivals_s: float | None) -> FleetFlight:
    return FleetFlight(
        tuple(
            FlownVehicle(v.name, v.sysid, v.trajectory, arrival_s, 70.0)
            for v, arrival_s in zip(fleet.vehicles, arrivals_s, strict=True)
        )
    )


def printed(summary: dict[str, object]) -> str:
    out = io.StringIO()
    Console(file=out, width=160).print(vehicle_table(summary))
    return out.getvalue()


def test_a_plan_in_figures() -> None:
    summary = summarise(plan())
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert (summary["mission"], summary["seed"]) == ("by-hand", 1)
    row = summary["vehicles"][0]
    assert (row["name"], row["sysid"], row["waypoints"], row["speed_m_s"]) == ("uav1", 1, 3, 8.0)
    assert row["clearances"][0] == {"to": "terrain", "distance_m": 31.42, "required_m": 22.0, "ok": True, "t_s": None}
    assert summary["fleet"]["clear"] is True
    assert summary["fleet"]["separation"]["distance_m"] == 40.04
    assert "flown_clear" not in summary["fleet"]
    assert "flown_arrival_s" not in row


@pytest.mark.parametrize(
    "unclear", [plan(TERRAIN, TOO_NEAR), plan(separation=replace(APART, distance_m=23.0))], ids=["obstacle", "fellow"]
)
def test_one_clearance_not_kept_and_the_fleet_is_not_clear(unclear: FleetPlan) -> None:
    assert summarise(unclear)["fleet"]["clear"] is False


def test_a_clearance_that_is_not_known_is_not_kept() -> None:
    assert not Clearance(float("nan"), 12.0, "mast", (0.0, 0.0, 0.0)).ok
    assert Clearance(12.0, 12.0, "mast", (0.0, 0.0, 0.0)).ok


def test_a_flight_in_figures() -> None:
    fleet = plan()
    check = FlightCheck(((TERRAIN,), (TERRAIN, MAST)), replace(APART, distance_m=33.0))
    summary = summarise(fleet, flight(fleet, 40.25, 40.5), check)
    assert summary["vehicles"][1]["flown_arrival_s"] == 40.5
    assert [c["to"] for c in summary["vehicles"][1]["flown_clearances"]] == ["terrain", "mast"]
    assert summary["fleet"]["flown_arrival_spread_s"] == 0.25
    assert summary["fleet"]["flown_clear"] is True
    lines = fleet_lines(summary)
    assert "common arrival: 40.0 s after mission start" in lines
    assert "spread of arrivals flown: 0.25 s" in lines
    assert "least separation flown: 33.0 m (>= 24 m), uav1 - uav2, at 12 s" in lines
    assert lines[-1].endswith(": yes")


def test_who_never_arrived_is_said() -> None:
    fleet = plan()
    check = FlightCheck(((TERRAIN,), (TOO_NEAR,)), None)
    summary = summarise(fleet, flight(fleet, 40.25, None), check)
    assert summary["fleet"]["flown_arrival_spread_s"] is None
    assert summary["fleet"]["flown_clear"] is False
    assert "spread of arrivals flown: not all arrived" in fleet_lines(summary)
    assert fleet_lines(summary)[-1].endswith(": NO")
    assert "never" in printed(summary)


def test_the_table_names_what_is_nearest() -> None:
    text = printed(summarise(plan()))
    for part in ("by-hand", "uav1", "uav2", "8.00", "31.4", "12.3", "mast"):
        assert part in text


def test_a_single_vehicle_without_obstacles() -> None:
    fleet = fleet_plan()
    alone = replace(fleet, vehicles=(replace(fleet.vehicles[0], clearances=(TERRAIN,)),))
    summary = summarise(alone)
    assert summary["fleet"] == {"arrival_s": None, "separation": None, "clear": True}
    assert fleet_lines(summary) == []
    assert "-" in printed(summary)
