from __future__ import annotations

import io
import json
from dataclasses import replace

import pytest
from rich.console import Console
from rich.table import Table

from missionplanner.certificate import Certificate, Finding
from missionplanner.flight_check import FlightCheck
from missionplanner.mission import Wind
from missionplanner.plan import Clearance, FleetFlight, FleetPlan, FlownMeeting, FlownVehicle
from missionplanner.summary import certificate_table, fleet_lines, moves_table, summarise, vehicle_table
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


HELD = Finding("terrain", "uav1", True, "its tube stays at least 31.00 m above the ground", value=31.0, required=20.0)
LATE = Finding("lateness", "uav1 - uav2", True, "all keep apart", value=3.1999, required=1.0, unit="s")
FAILED = Finding("obstacle", "uav2", False, "mast clearance is 3.00 m", "move waypoint 4", 3.0, 10.0, seq=4)
WAIVED = Finding("return", "uav1", False, "the direct return is not asked for", waived=True)


def certificate(*findings: Finding) -> Certificate:
    return Certificate(findings, (), ("wind of at most 3 m/s",), {}, {}, "0" * 64, "0")


def proven_by(*findings: Finding) -> dict[str, object]:
    return summarise(replace(plan(separation=None, arrival_s=None), certificate=certificate(*findings)))


def shown(table: Table) -> str:
    out = io.StringIO()
    Console(file=out, width=160).print(table)
    return out.getvalue()


def printed(summary: dict[str, object]) -> str:
    return shown(vehicle_table(summary))


def test_a_plan_in_figures() -> None:
    summary = summarise(plan())
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert (summary["mission"], summary["seed"]) == ("by-hand", 1)
    row = summary["vehicles"][0]
    assert (row["name"], row["sysid"], row["waypoints"], row["speeds_m_s"]) == ("uav1", 1, 3, [8.0])
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


def test_the_wind_that_is_planned_with_is_told() -> None:
    fleet = plan()
    windy = fleet.mission.model_copy(update={"wind": Wind(speed_m_s=5.0, from_deg=270.0)})
    summary = summarise(replace(fleet, mission=windy))
    assert summary["fleet"]["wind"] == {"speed_m_s": 5.0, "from_deg": 270.0}
    assert "predicted in a steady wind of 5 m/s from 270 degrees" in fleet_lines(summary)
    assert summarise(fleet)["fleet"]["wind"] is None
    assert not any("wind" in line for line in fleet_lines(summarise(fleet)))


def test_a_single_vehicle_without_obstacles() -> None:
    fleet = fleet_plan()
    alone = replace(fleet, vehicles=(replace(fleet.vehicles[0], clearances=(TERRAIN,)),))
    summary = summarise(alone)
    assert {name: value for name, value in summary["fleet"].items() if value} == {"clear": True}
    assert fleet_lines(summary)[0].startswith("proven: NO")  # nobody has proven it
    assert "-" in printed(summary)


def test_a_proof_in_figures_promises_no_more_than_is_proven() -> None:
    summary = proven_by(HELD, LATE)
    assert summary["proof"] == {"proven": True, "problems": [], "waived": [], "lateness_s": 3.19}
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert fleet_lines(summary) == ["proven: yes; all keep apart while none is more than 3.19 s early or late"]


def test_what_is_not_proven_is_told_with_its_remedy() -> None:
    summary = proven_by(HELD, FAILED, WAIVED)
    told = "uav2: item 4: mast clearance is 3.00 m: move waypoint 4"
    assert summary["proof"]["proven"] is False  # type: ignore[index]
    assert summary["proof"]["problems"] == [told]  # type: ignore[index]
    assert fleet_lines(summary) == [
        "proven: NO, 1 check failed",
        f"  not proven: {told}",
        "  waived: uav1: the direct return is not asked for",
    ]


def test_what_the_mission_waives_is_never_just_proven() -> None:
    lines = fleet_lines(proven_by(HELD, WAIVED))
    assert lines[0] == "proven: yes, but for what the mission waives (1)"


@pytest.mark.parametrize("fleet", [plan(), replace(plan(), certificate=certificate())], ids=["no proof", "empty proof"])
def test_what_nobody_checked_is_not_proven(fleet: FleetPlan) -> None:
    summary = summarise(fleet)
    assert summary["proof"]["proven"] is False
    assert summary["proof"]["lateness_s"] is None
    assert fleet_lines(summary)[0].startswith("proven: NO")


def test_a_certificate_in_a_table_has_what_fails_first() -> None:
    text = shown(certificate_table(certificate(HELD, WAIVED, replace(FAILED, detail="[red]mast[/red] is near"))))
    assert "NOT PROVEN" in text.splitlines()[0]
    places = [text.index(part) for part in ("[red]mast[/red] is near: move waypoint 4", "waived", "its tube stays")]
    assert places == sorted(places)
    assert shown(certificate_table(certificate(HELD))).startswith("proven")
    assert shown(certificate_table(certificate())).startswith("NOT PROVEN")


def test_moved_waypoints_in_a_table() -> None:
    after = {"lat_deg": 46.5, "lon_deg": 8.0, "alt_amsl_m": 112.25}
    move = {"vehicle": "uav1", "seq": 7, "shifted_m": 0.0, "course_deg": None, "raised_m": 12.25, "after": after}
    text = shown(moves_table([move, {**move, "shifted_m": 3.5, "course_deg": 271.4}]))
    for part in ("waypoints moved: 2", "uav1", "7", "+12.25", "46.5000000, 8.0000000", "112.25", "3.50", "271"):
        assert part in text


def test_flown_meetings_are_told() -> None:
    fleet = plan()
    met = (FlownMeeting("tea", {"uav1": 20.0, "uav2": 21.46}), FlownMeeting("supper", {"uav1": 30.0, "uav2": None}))
    flown = replace(flight(fleet, 40.0, 40.0), meetings=met)
    found = summarise(fleet, flown, FlightCheck(clearances=((), ()), separation=None))
    assert [m["spread_s"] for m in found["fleet"]["flown_rendezvous"]] == [1.46, None]
    lines = fleet_lines(found)
    assert "rendezvous tea flown: uav1 at 20.0 s, uav2 at 21.5 s (within 1.5 s)" in lines
    assert "rendezvous supper flown: uav1 at 30.0 s, uav2 never" in lines
