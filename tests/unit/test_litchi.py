"""Litchi's CSV, held against what Mission Hub documents and exports."""

from __future__ import annotations

import csv
import io
import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.export import export_fleet, export_options, export_remarks
from adapters.litchi import WAYPOINTS_MAX, litchi_csv, remarks
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Action, FleetPlan, VehiclePlan
from tests.plans import vehicle_plan
from tests.routes import ACTIONS, TOWER_M, looking, looking_fleet

NUMBER = r"-?\d+(\.\d+)?"
ROW = re.compile(  # as Mission Hub writes them
    rf"^{NUMBER},{NUMBER},{NUMBER},{NUMBER},{NUMBER},[01],[0-2],{NUMBER},((-1|[0-5]),{NUMBER},){{15}}"
    rf"[01],{NUMBER},{NUMBER},{NUMBER},{NUMBER},[01],(-1\.0|{NUMBER}),(-1\.0|{NUMBER})$"
)


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def parts(plan: FleetPlan, vehicle: VehiclePlan | None = None) -> list[list[dict[str, str]]]:
    return [rows(text) for text in litchi_csv(plan, vehicle or plan.vehicles[0])]


def positions_m(plan: FleetPlan, vehicle: VehiclePlan, read: list[dict[str, str]]) -> FloatArray:
    return np.array(
        [
            plan.frame.to_local(
                float(r["latitude"]), float(r["longitude"]), vehicle.home_m[2] + float(r["altitude(m)"])
            )
            for r in read
        ]
    )


def actions(row: dict[str, str]) -> list[tuple[int, int]]:
    pairs = [(int(row[f"actiontype{k}"]), int(row[f"actionparam{k}"])) for k in range(1, 16)]
    done = [pair for pair in pairs if pair[0] != -1]
    assert pairs[: len(done)] == done  # without gaps
    return done


def test_rows_are_written_as_mission_hub_writes_them() -> None:
    (text,) = litchi_csv(looking_fleet(), looking())
    header, *body = text.splitlines()
    assert header.startswith("latitude,longitude,altitude(m),heading(deg),curvesize(m),rotationdir,gimbalmode,")
    assert header.endswith("poi_altitude(m),poi_altitudemode,photo_timeinterval,photo_distinterval")
    assert len(header.split(",")) == 46
    assert all(ROW.match(row) for row in body), body


def test_places_heights_and_speeds_are_the_plans() -> None:
    plan = looking_fleet()
    vehicle = replace(plan.vehicles[0], speeds_m_s=np.array([3.0, 4.0, 5.0, 6.0, 7.0]))
    (read,) = parts(plan, vehicle)
    assert np.abs(positions_m(plan, vehicle, read) - vehicle.waypoints_m).max() < 0.01
    assert [float(row["speed(m/s)"]) for row in read] == [3.0, 4.0, 5.0, 6.0, 7.0, 7.0]
    assert {(row["curvesize(m)"], row["altitudemode"]) for row in read} == {("0.0", "0")}


def test_it_turns_tilts_stands_and_takes_photos() -> None:
    plan = looking_fleet()
    (read,) = parts(plan)
    away_m = np.array(TOWER_M) - plan.vehicles[0].waypoints_m[1]
    heading_deg = np.degrees(np.arctan2(away_m[0], away_m[1]))
    pitch_deg = np.degrees(np.arctan2(away_m[2], np.hypot(*away_m[:2])))
    assert float(read[1]["heading(deg)"]) == pytest.approx(heading_deg, abs=0.06)
    assert float(read[1]["gimbalpitchangle"]) == pytest.approx(pitch_deg, abs=0.06)
    assert read[1]["gimbalmode"] == "2"
    assert actions(read[1]) == [(4, round(heading_deg)), (5, round(pitch_deg)), (0, 3000), (1, 0), (1, 0)]
    assert actions(read[2]) == []
    assert read[2]["gimbalmode"] == "0"


def test_photos_on_the_way_are_asked_for_where_it_begins() -> None:
    (read,) = parts(looking_fleet())
    assert [float(row["photo_distinterval"]) for row in read] == [-1, -1, -1, 12.5, -1, -1]
    assert {row["photo_timeinterval"] for row in read} == {"-1.0"}
    (read,) = parts(looking_fleet(), replace(looking(), actions={4: ACTIONS[4]}))
    assert actions(read[3]) == [(4, 10), (5, -20)]


def test_a_long_hold_is_written_in_pieces() -> None:
    vehicle = replace(looking(), actions={2: Action(hold_s=70.0)})
    (read,) = parts(looking_fleet(), vehicle)
    assert actions(read[2]) == [(0, 32000), (0, 32000), (0, 6000)]


def test_long_legs_get_waypoints_between_on_the_same_line() -> None:
    points = ((0.0, 0.0, 1230.0), (3000.0, 4000.0, 1430.0), (3000.0, 4100.0, 1430.0))
    plan = looking_fleet(vehicle_plan(waypoints_m=points))
    (read,) = parts(plan)
    found_m = positions_m(plan, plan.vehicles[0], read)
    legs_m = np.linalg.norm(np.diff(found_m, axis=0), axis=1)
    assert len(read) == 5
    assert legs_m.max() < 1999.0
    assert legs_m.sum() == pytest.approx(np.linalg.norm(np.diff(points, axis=0), axis=1).sum(), abs=0.1)
    assert float(read[1]["altitude(m)"]) == pytest.approx(30.0 + 200.0 / 3.0, abs=0.01)


@pytest.mark.parametrize("count", [2, 99, 100, 197, 198, 400])
def test_long_missions_are_written_in_parts_that_join(count: int) -> None:
    points = [(10.0 * k, 20.0 * (k % 2), 1230.0) for k in range(count)]
    vehicle = vehicle_plan(waypoints_m=points)
    vehicle = replace(vehicle, actions={k: Action("p", look_deg=(0.0, 0.0), photos=1) for k in range(1, count)})
    plan = looking_fleet(vehicle)
    read = parts(plan)
    assert all(2 <= len(part) <= WAYPOINTS_MAX for part in read)
    for before, after in itertools.pairwise(read):
        assert (before[-1]["latitude"], before[-1]["longitude"]) == (after[0]["latitude"], after[0]["longitude"])
        assert actions(after[0]) == []
    joined = [read[0][0], *(row for part in read for row in part[1:])]
    assert np.abs(positions_m(plan, vehicle, joined) - vehicle.waypoints_m).max() < 0.01
    assert sum(code == 1 for row in joined for code, _ in actions(row)) == count - 1


def test_a_photographed_leg_is_not_parted_from_where_it_is_turned_to() -> None:
    points = [(10.0 * k, 0.0, 1230.0) for k in range(150)]
    vehicle = replace(vehicle_plan(waypoints_m=points), actions={99: replace(ACTIONS[4], photo_every_m=4.0)})
    first, second = parts(looking_fleet(vehicle))
    assert (len(first), len(second)) == (98, 53)
    assert float(second[1]["photo_distinterval"]) == 4.0
    assert (4, 10) in actions(second[1])


@pytest.mark.parametrize(
    ("vehicle", "told"),
    [
        (vehicle_plan(vehicle_class="plane", end="loiter", speed_m_s=14.0), "uav1: expected a copter .* got a plane"),
        (looking(speed_m_s=15.5), "alpha: expected speeds in m/s of 0.1 to 15 .* got 15.5"),
        (looking(home_m=(0.0, 0.0, 500.0)), "heights above home in m of -200 to 500 .* got 730"),
        (replace(looking(), actions={2: Action("T09", look_deg=(0.0, 60.0))}), "camera pitches .* got 60"),
        (replace(looking(), actions={2: Action("T09", photos=16)}), "alpha: T09: expected at most 15 actions"),
        (looking(waypoints_m=((0, 0, 1230), (0, 0.5, 1230))), "0 and 1 only 0.50 m apart"),
    ],
)
def test_what_litchi_cannot_say_is_refused_and_named(vehicle: VehiclePlan, told: str) -> None:
    with pytest.raises(MissionError, match=told):
        litchi_csv(looking_fleet(vehicle), vehicle)


def test_who_flies_them_is_told_what_to_set() -> None:
    plan = looking_fleet(looking("a", 1), looking("b", 2, end="rtl"))
    told = " ".join(remarks(plan))
    for words in ("NOT PROVEN", "Straight Lines", "a Land, b RTH", "one at a time"):
        assert words in told
    both = export_remarks(plan, export_options("litchi,dji"))
    assert len(both) == 6
    assert not export_remarks(plan, export_options("plan,kml"))


def test_files_of_all_formats(tmp_path: Path) -> None:
    points = [(10.0 * k, 0.0, 1230.0) for k in range(120)]
    plan = looking_fleet(looking("a", 1), vehicle_plan("b", 2, waypoints_m=points))
    paths = export_fleet(plan, tmp_path, export_options("litchi,dji,geojson"))
    assert [p.name for p in paths] == [
        "a.kmz",
        "a-litchi.csv",
        "b.kmz",
        "b-litchi-1.csv",
        "b-litchi-2.csv",
        "fleet.geojson",
    ]


def test_one_that_cannot_be_written_leaves_none(tmp_path: Path) -> None:
    plan = looking_fleet(looking("a", 1), looking("b", 2, speed_m_s=20.0))
    with pytest.raises(MissionError, match="b: expected speeds"):
        export_fleet(plan, tmp_path, export_options("plan,dji"))
    assert not list(tmp_path.iterdir())
