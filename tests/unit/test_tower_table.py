"""The table of towers, read back by Python's csv and by GDAL."""

from __future__ import annotations

import csv
import io
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyogrio.raw
import pytest

from adapters.tower_table import CSV_NAME, GEOJSON_NAME, tower_csv, tower_geojson, write_tower_table
from missionplanner import coverage
from missionplanner.inspection import InspectionPlan
from missionplanner.plan import Trajectory
from missionplanner.tower_rows import TowerRow, tower_rows
from tests.inspections import inspection_by_hand, question


@pytest.fixture(scope="module")
def planned() -> InspectionPlan:
    return inspection_by_hand()


@pytest.fixture(scope="module")
def rows(planned: InspectionPlan) -> tuple[TowerRow, ...]:
    return tower_rows(planned)


def still(planned: InspectionPlan, visits: set[str]) -> list[Trajectory]:
    """Return flights that stand for a while at every viewpoint of some visits."""
    found = [v.position_m for visit in planned.visits if visit.name in visits for v in visit.viewpoints]
    return [Trajectory(np.arange(0.0, 8.0, 0.5), np.tile(place_m, (16, 1))) for place_m in found]


def test_every_visit_has_its_row_and_every_target_one(planned: InspectionPlan, rows: tuple[TowerRow, ...]) -> None:
    assert [row.visit for row in rows if row.visit] == sorted(
        (visit.name for visit in planned.visits), key=[row.visit for row in rows].index
    )
    assert {row.visit for row in rows if row.visit} == {visit.name for visit in planned.visits}
    asked = {visit.target for visit in planned.visits} | {left.target for left in planned.left_out}
    assert {row.target for row in rows} == asked
    towers = [row.target for row in rows if row.kind == "tower"]
    assert towers == sorted(towers)
    assert {row.status for row in rows if row.target == "T01"} == {"done before"}
    left_out = [row for row in rows if row.target == "T03"]
    assert {(row.status, row.sortie) for row in left_out} == {("left out", None)}
    assert all("4.2 m are missing" in row.note for row in left_out)
    assert {row.status for row in rows if row.target not in {"T01", "T03"}} == {"planned"}


def test_who_flies_it_and_when_is_as_planned(planned: InspectionPlan, rows: tuple[TowerRow, ...]) -> None:
    told = {row.visit: row.sortie for row in rows if row.sortie is not None}
    begins_s = [0.0, planned.rounds[0].lasts_s + 120.0]
    for number, round_ in enumerate(planned.rounds):
        for tour in round_.tours:
            vehicle = next(v for v in round_.plan.vehicles if v.name == planned.scene.tasks[tour.vehicle].name)
            waypoint = 1
            for order, visit in enumerate(tour.visits, start=1):
                sortie = told.pop(visit.name)
                assert sortie is not None
                assert (sortie.vehicle, sortie.round, sortie.order) == (vehicle.name, number + 1, order)
                assert sortie.sysid == {"alpha": 7, "bravo": 2}[sortie.vehicle]
                assert sortie.round_begins_s == begins_s[number]
                assert sortie.begins_s == vehicle.reached_s[waypoint]
                waypoint += len(visit.viewpoints)
                assert sortie.ends_s == vehicle.reached_s[waypoint - 1] + vehicle.hold_s[waypoint - 2]
                assert sortie.viewpoints == len(visit.viewpoints)
    assert not told


def test_photos_at_places_and_on_the_way_between_them_count(
    planned: InspectionPlan, rows: tuple[TowerRow, ...]
) -> None:
    visits = {visit.name: visit for visit in planned.visits}
    spans = [row for row in rows if row.kind == "span" and row.sortie is not None]
    assert spans
    for row in rows:
        if row.sortie is None:
            continue
        points = visits[row.visit].viewpoints
        expected = sum(v.action.photos for v in points)
        for begin, end in itertools.pairwise(points):
            if end.action.photo_every_m:
                expected += int(np.linalg.norm(end.position_m - begin.position_m) / end.action.photo_every_m)
        assert row.sortie.photos == expected
    assert all(row.sortie is not None and row.sortie.photos > 5 for row in spans)


def test_what_a_mission_says_of_its_towers(rows: tuple[TowerRow, ...]) -> None:
    first = {row.target: row for row in reversed(rows)}
    assert (first["T01"].weight, first["T01"].last_inspected, first["T01"].lines) == (20.0, "2025-05-04", ("north",))
    assert (first["T02"].weight, first["T02"].lines, first["T02"].height_m) == (3.0, ("north", "south"), 40.0)
    assert first["T02"].top_alt_amsl_m == pytest.approx(540.0)
    span = first["span T02-T04"]
    assert (span.kind, span.lines, span.weight, len(span.place_deg)) == ("span", ("south",), None, 2)


def test_csv_reads_back(rows: tuple[TowerRow, ...]) -> None:
    text = tower_csv(rows)
    assert text.count("\r\n") == len(rows) + 1  # RFC 4180
    read = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
    assert [row["target"] for row in read] == [row.target for row in rows]
    for row, cells in zip(rows, read, strict=True):
        assert cells["note"] == row.note
        assert cells["seen"] == ""
        assert cells["status"] == row.status
        if row.sortie is None:
            assert (cells["vehicle"], cells["photos"], cells["begins_s"]) == ("", "", "")
        else:
            assert (cells["vehicle"], int(cells["photos"])) == (row.sortie.vehicle, row.sortie.photos)
            assert float(cells["begins_s"]) == pytest.approx(row.sortie.begins_s, abs=0.051)
        if row.kind == "tower":
            assert (float(cells["lat_deg"]), float(cells["lon_deg"])) == pytest.approx(row.place_deg[0], abs=1e-7)


def test_gdal_reads_the_geojson(tmp_path: Path, planned: InspectionPlan, rows: tuple[TowerRow, ...]) -> None:
    paths = write_tower_table(tmp_path, "by-hand", rows)
    assert [path.name for path in paths] == [CSV_NAME, GEOJSON_NAME]
    meta, _, _, fields = pyogrio.raw.read(tmp_path / GEOJSON_NAME)
    table = dict(zip(meta["fields"], fields, strict=True))
    assert meta["crs"] == "EPSG:4326"
    assert table["target"].tolist() == [row.target for row in rows]
    assert table["vehicle"].tolist() == [None if row.sortie is None else row.sortie.vehicle for row in rows]
    info = pyogrio.read_info(tmp_path / GEOJSON_NAME, force_total_bounds=True)
    lat_deg, lon_deg, _ = planned.scene.frame.to_geo(planned.scene.towers.top_m)  # type: ignore[union-attr]
    assert info["total_bounds"] == pytest.approx([lon_deg.min(), lat_deg.min(), lon_deg.max(), lat_deg.max()], abs=1e-6)


def test_geojson_is_as_rfc_7946_has_it(rows: tuple[TowerRow, ...]) -> None:
    document = json.loads(tower_geojson(rows, "lines"))
    assert document["type"] == "FeatureCollection"
    for feature in document["features"]:
        assert set(feature) == {"type", "properties", "geometry"}
        geometry = feature["geometry"]
        places = [geometry["coordinates"]] if geometry["type"] == "Point" else geometry["coordinates"]
        for lon_deg, lat_deg in places:  # longitude first, no third number
            assert (round(lon_deg), round(lat_deg)) == (8, 46) or (round(lon_deg), round(lat_deg)) == (8, 47)


def test_after_a_flight_it_says_what_was_seen(planned: InspectionPlan) -> None:
    tracks = still(planned, {"T02.left", "T04.left", "T04.right"})
    seen = coverage.measure(planned.scene, tracks, names=["alpha"] * len(tracks))
    rows = {row.visit: row for row in tower_rows(planned, seen)}
    left, right = rows["T02.left"].seen, rows["T02.right"].seen
    assert left is not None
    assert right is not None
    assert (left.seen, left.vehicles, left.why) == (True, ("alpha",), "")
    assert left.distance_m == pytest.approx(25.0, abs=1.0)
    assert left.gsd_mm is not None
    assert (right.seen, right.vehicles) == (False, ())
    assert right.why
    cells = {row["visit"]: row for row in csv.DictReader(io.StringIO(tower_csv(list(rows.values()))))}
    assert (cells["T02.left"]["seen"], cells["T02.right"]["seen"]) == ("yes", "no")
    assert float(cells["T02.left"]["seen_distance_m"]) == pytest.approx(25.0, abs=1.0)


@pytest.mark.parametrize("kind", ["overfly", "two_sides", "four_sides", "orbit"])
def test_every_kind_of_view_has_its_figures(kind: str) -> None:
    planned = inspection_by_hand(question(views={"kind": kind, "below_top_m": [3.0, 12.0], "distance_m": 25.0}))
    towers = {visit.name for visit in planned.visits if not visit.target.startswith("span")}
    away = [Trajectory(t.t_s, t.position_m + np.array([2000.0, 0.0, 0.0])) for t in still(planned, towers)]
    for tracks, seen in ((still(planned, towers), True), (away, False)):
        found = coverage.measure(planned.scene, tracks, names=["alpha"] * len(tracks))
        rows = [row for row in tower_rows(planned, found) if row.kind == "tower"]
        assert {row.visit for row in rows} == towers
        for row in rows:
            assert row.seen is not None
            assert row.seen.seen is seen
            assert row.seen.distance_m is not None


def test_a_span_of_two_circuits_names_both() -> None:
    lines = [{"name": "north", "towers": ["T01", "T02"]}, {"name": "south", "towers": ["T02", "T01", "T03", "T04"]}]
    rows = {row.target: row for row in tower_rows(inspection_by_hand(question(lines=lines)))}
    assert rows["span T01-T02"].lines == ("north", "south")
    assert rows["span T01-T03"].lines == ("south",)


def test_a_target_without_any_view_has_a_row_of_its_own(planned: InspectionPlan) -> None:
    without = replace(planned, visits=tuple(v for v in planned.visits if v.target != "T03"))
    (row,) = [row for row in tower_rows(without) if row.target == "T03"]
    assert (row.visit, row.status, row.sortie) == ("", "left out", None)


def test_names_and_notes_of_any_script_are_kept(tmp_path: Path) -> None:
    planned = inspection_by_hand(question(towers=[
        {"name": "Zürich.1", "x_m": 100, "y_m": 300}, {"name": "T02", "x_m": 300, "y_m": 320},
        {"name": "T03", "x_m": 500, "y_m": 300}, {"name": "T04", "x_m": 700, "y_m": 280},
    ], lines=[]))  # fmt: skip
    rows = tower_rows(planned)
    write_tower_table(tmp_path, "n", rows)
    assert "Zürich.1" in (tmp_path / CSV_NAME).read_text(encoding="utf-8")
    meta, _, _, fields = pyogrio.raw.read(tmp_path / GEOJSON_NAME)
    assert "Zürich.1" in dict(zip(meta["fields"], fields, strict=True))["target"].tolist()
