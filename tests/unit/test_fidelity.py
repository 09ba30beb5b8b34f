"""Predicted against recorded flights: the figures are those of the differences, and no flight is read amiss."""

from __future__ import annotations

import csv
import gzip
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.experiments import fidelity
from missionplanner.experiments.fidelity import Comparison, compare
from missionplanner.experiments.recordings import FlatEarth, Kind, find_recordings, read_recording
from tests.oracles import flights
from tests.recorded import ALT, LAT, LON, Row, legs, mission_text, plane_legs, record

KINDS: list[tuple[Kind, list[Row]]] = [("arducopter", legs()), ("px4", legs()), ("arduplane", plane_legs())]
real = pytest.mark.skipif(not flights.FOLDER.is_dir(), reason="no recorded flights in ../shared/data/flights")


def compared(folder: Path, name: str = "one") -> Comparison:
    return compare(read_recording(folder, name))


@pytest.mark.parametrize(("kind", "rows"), KINDS)
def test_who_flies_as_predicted_has_no_errors(tmp_path: Path, kind: Kind, rows: list[Row]) -> None:
    """Whatever its name: what it is, its content says."""
    record(tmp_path, "one", kind, rows)
    found = compared(tmp_path)
    assert found.recording.kind == kind
    assert found.leg_worst == pytest.approx(0.0, abs=1e-3)
    assert found.arrival_error_s == pytest.approx(0.0, abs=1e-3)
    assert found.climb_error_s == pytest.approx(0.0, abs=1e-3)
    assert found.position_p95_m < 0.05
    assert found.position_whole_p95_m < 0.05
    assert found.path_max_m < 0.1


@pytest.mark.parametrize(("kind", "rows"), KINDS)
@pytest.mark.parametrize("stretch", [0.9, 1.03])
def test_who_takes_longer_is_predicted_too_fast(tmp_path: Path, kind: Kind, rows: list[Row], stretch: float) -> None:
    record(tmp_path, "one", kind, rows, stretch=stretch, aside_m=0.7)
    found = compared(tmp_path)
    expected = 1.0 / stretch - 1.0
    assert [leg.error for leg in found.legs] == pytest.approx([expected] * len(found.legs), abs=2e-3)
    assert found.leg_mean == pytest.approx(abs(expected), abs=2e-3)
    assert found.arrival_fraction == pytest.approx(expected, abs=1e-3)
    assert found.arrival_error_s == pytest.approx(expected * found.arrival_s, abs=0.01)
    assert found.flight_fraction == pytest.approx(expected, abs=2e-3)
    assert found.path_max_m == pytest.approx(0.7, abs=0.1)
    track, at_s = found.trajectory, np.arange(0.0, found.arrival_s, 0.1)
    off_m = np.linalg.norm(track.at(at_s) - track.at(at_s / stretch) - np.array([0.7, 0.0, 0.0]), axis=1)
    assert found.position_p95_m == pytest.approx(np.percentile(off_m, 95), rel=0.02, abs=0.02)


def test_a_waypoint_where_the_take_off_ended_is_no_leg(tmp_path: Path) -> None:
    flight = record(tmp_path, "one", "arducopter", legs())
    first_s = float(flight.reached_s[1] - flight.reached_s[0])
    expected = [(3, 4), (4, 6), (6, 7)] if first_s < fidelity.LEG_LEAST_S else [(1, 3), (3, 4), (4, 6), (6, 7)]
    assert [(leg.from_seq, leg.to_seq) for leg in compared(tmp_path).legs] == expected


def test_a_hold_is_part_of_what_is_reported(tmp_path: Path) -> None:
    record(tmp_path, "one", "arducopter", legs(hold_s=7.0))
    found = compared(tmp_path)
    assert found.leg_worst == pytest.approx(0.0, abs=1e-3)
    record(tmp_path, "none", "arducopter", legs())
    shorter = compared(tmp_path, "none")
    seven_s = found.recording.done_s[4] - shorter.recording.done_s[4]
    assert 7.0 <= seven_s <= 10.0  # it stops there


def _edit(path: Path, change: Callable[[dict[int, dict[str, Any]]], None]) -> None:
    document = json.loads(path.read_text())
    change({wp["seq"]: wp for wp in document["wp"]})
    path.write_text(json.dumps(document))


def _lose(*seqs: int) -> Callable[[dict[int, dict[str, Any]]], None]:
    def change(by_seq: dict[int, dict[str, Any]]) -> None:
        for seq in seqs:
            by_seq[seq]["t_reached"] = None

    return change


def test_a_report_that_is_lost_costs_no_time(tmp_path: Path) -> None:
    record(tmp_path, "one", "arducopter", legs(), stretch=1.1)
    whole = compared(tmp_path)
    _edit(tmp_path / "one.json", _lose(4))  # the speed change after it was done at the same instant
    hidden = compared(tmp_path)
    assert [(leg.to_seq, leg.recorded_s) for leg in hidden.legs] == [(leg.to_seq, leg.recorded_s) for leg in whole.legs]
    _edit(tmp_path / "one.json", _lose(4, 5))
    lost = compared(tmp_path)
    assert [leg.to_seq for leg in lost.legs][-2:] == [6, 7]
    assert sum(leg.recorded_s for leg in lost.legs) == pytest.approx(sum(leg.recorded_s for leg in whole.legs))
    assert lost.leg_mean == pytest.approx(1.0 - 1.0 / 1.1, abs=2e-3)
    _edit(tmp_path / "one.json", _lose(2, 7))  # then the item that is being flown tells
    seen = compared(tmp_path)
    assert seen.arrival_s == pytest.approx(whole.arrival_s, abs=0.11)
    assert seen.recording.climbed_s == pytest.approx(whole.recording.climbed_s, abs=0.11)


def test_the_flat_earth_is_one_way_and_back() -> None:
    frame = FlatEarth(LAT, LON)
    here = np.array([[120.0, -340.0, ALT], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(frame.to_local(*frame.to_geo(here)), here, atol=1e-6)
    assert frame.to_local(LAT + 0.001, LON, 0.0)[1] == pytest.approx(111.31884502)


# --- wrong input -----------------------------------------------------------------------------------------------------


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-40])


def _other_columns(path: Path) -> None:
    path.write_bytes(gzip.compress(b"time,x,y\n1,2,3\n"))


def _words(path: Path) -> None:
    table = gzip.decompress(path.read_bytes()).decode().splitlines()
    table[5] = "x" + table[5]
    path.write_bytes(gzip.compress("\n".join(table).encode()))


def _short_row(path: Path) -> None:
    table = gzip.decompress(path.read_bytes()).decode().rstrip()
    path.write_bytes(gzip.compress(table[:-9].rsplit(",", 1)[0].encode()))


def _elsewhere(path: Path) -> None:
    rows = [*legs()]
    rows[5] = (3, 16, 0.0, 0.0, 0.0, 90.0, 5120.0, 25.0)
    path.write_text(mission_text(rows))


@pytest.mark.parametrize(
    ("suffix", "spoil", "told"),
    [
        (".csv.gz", Path.unlink, "one.csv.gz: missing: a flight is NAME.waypoints, NAME.csv.gz and NAME.json"),
        (".json", Path.unlink, "one.json: missing"),
        (".waypoints", Path.unlink, "one.waypoints: expected a readable text file"),
        (".csv.gz", _cut, "one.csv.gz: expected a readable table, got: "),
        (".csv.gz", _other_columns, "expected the columns t, x_east"),
        (".csv.gz", _words, "one.csv.gz: expected numbers"),
        (".csv.gz", _short_row, "columns, got"),
        (".json", _cut, "one.json: expected a list wp of seq, cmd and t_reached"),
        (".json", lambda path: path.write_text("[]"), "one.json: expected a list wp"),
        (".json", lambda path: _edit(path, lambda wp: wp[3].update(cmd=82)), "item 3: expected what one.waypoints"),
        (".json", lambda path: _edit(path, lambda wp: wp[3].update(t_reached="soon")), "one.json: expected a list wp"),
        (".waypoints", _elsewhere, "item 6: expected a flight past it, but the recorded one stays 5"),
    ],
)  # fmt: skip
def test_a_damaged_flight_is_told_and_the_others_are_read(
    tmp_path: Path, suffix: str, spoil: Callable[[Path], object], told: str
) -> None:
    for name in ("one", "two"):
        record(tmp_path, name, "arducopter", legs())
    spoil(tmp_path / f"one{suffix}")
    results = fidelity.run(tmp_path / "out", tmp_path)
    assert [f.recording.name for f in results.flights] == ["two"]
    [(name, reason)] = results.unreadable
    assert name == "one"
    assert told in reason
    assert "\n" not in reason
    assert f"- one: {reason}" in (tmp_path / "out" / "results.md").read_text()


@pytest.mark.parametrize("at_s", [0.0, -5.0, None])
@pytest.mark.parametrize(("kind", "rows"), KINDS)
def test_who_arrives_before_it_has_climbed_is_told(
    tmp_path: Path, kind: Kind, rows: list[Row], at_s: float | None
) -> None:
    """All reports at 0 or before, or (None) all at the end of the take-off."""
    record(tmp_path, "good", kind, rows)
    record(tmp_path, "one", kind, rows)
    when_s = compared(tmp_path).recording.climbed_s if at_s is None else at_s

    def change(by_seq: dict[int, dict[str, Any]]) -> None:
        for wp in by_seq.values():
            wp["t_reached"] = when_s

    _edit(tmp_path / "one.json", change)
    with pytest.raises(MissionError, match="reached after the take-off's end"):
        compared(tmp_path)
    results = fidelity.run(tmp_path / "out", tmp_path)
    assert [flight.recording.name for flight in results.flights] == ["good"]
    assert [name for name, _ in results.unreadable] == ["one"]


def test_a_recording_that_begins_after_the_arrival_is_told(tmp_path: Path) -> None:
    record(tmp_path, "one", "arducopter", legs())
    lines = gzip.decompress((tmp_path / "one.csv.gz").read_bytes()).decode().splitlines()
    late = [row.split(",") for row in lines[1:]]
    at = lines[0].split(",").index("t")
    rows = [",".join([*row[:at], str(float(row[at]) + 1000.0), *row[at + 1 :]]) for row in late]
    (tmp_path / "one.csv.gz").write_bytes(gzip.compress("\n".join([lines[0], *rows]).encode()))
    with pytest.raises(MissionError, match="and 0 positions until then"):
        compared(tmp_path)


def test_a_folder_without_flights_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"expected recorded flights .* found none"):
        find_recordings(tmp_path)
    with pytest.raises(MissionError, match="which is none"):
        find_recordings(tmp_path / "nowhere")
    record(tmp_path, "one", "arducopter", legs())
    (tmp_path / "one.json").unlink()
    with pytest.raises(MissionError, match=r"none of 1 flights can be read: .*one\.json: missing"):
        fidelity.run(tmp_path / "out", tmp_path)


# --- what is written -------------------------------------------------------------------------------------------------


def test_tables_and_figures(tmp_path: Path) -> None:
    for k, (kind, rows) in enumerate(KINDS):
        record(tmp_path, f"{kind}{k}", kind, rows, stretch=1.004)
    page = tmp_path / "doc.md"
    page.write_text(f"before\n{fidelity.MARKS[0]}\nold\n{fidelity.MARKS[1]}\nafter\n")
    results = fidelity.run(tmp_path / "out", tmp_path, update=page)
    figures = json.loads((tmp_path / "out" / "results.json").read_text())
    assert figures == results.as_json()
    with (tmp_path / "out" / "flights.csv").open() as file:
        rows_read = list(csv.DictReader(file))
    assert [row["name"] for row in rows_read] == [f["name"] for f in figures["flights"]]
    assert float(rows_read[0]["leg_time_error_mean"]) == figures["flights"][0]["leg_time_error_mean"]
    with (tmp_path / "out" / "legs.csv").open() as file:
        assert len(list(csv.DictReader(file))) == sum(f["legs"] for f in figures["flights"])
    for name in ("errors.png", "speed.png"):
        assert (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG")
    written = page.read_text()
    assert written.startswith("before\n")
    assert written.endswith("\nafter\n")
    assert "old" not in written
    assert fidelity.table(results) in written
    assert set(figures["summary"]) == {"ArduCopter", "ArduPlane", "PX4 multicopter"}
    assert all(group["wanted_kept"] for group in figures["summary"].values())


def test_what_is_wanted_and_not_kept_is_said(tmp_path: Path) -> None:
    record(tmp_path, "slow", "px4", legs(), stretch=1.06)
    summary = fidelity.run(tmp_path / "out", tmp_path).as_json()["summary"]["PX4 multicopter"]
    assert not summary["wanted_kept"]
    assert summary["leg_time_error_mean"] == pytest.approx(1.0 - 1.0 / 1.06, abs=2e-3)
    assert "not kept" in (tmp_path / "out" / "results.md").read_text()


def test_a_document_without_marks_is_left_alone(tmp_path: Path) -> None:
    record(tmp_path, "one", "arducopter", legs())
    page = tmp_path / "doc.md"
    page.write_text("nothing\n")
    with pytest.raises(MissionError, match="around the table"):
        fidelity.run(tmp_path / "out", tmp_path, update=page)
    assert page.read_text() == "nothing\n"


# --- real flights ----------------------------------------------------------------------------------------------------


@real
@pytest.mark.parametrize("name", ["P_plane0", "X_do", "px4_lawn3", "F_splinecircle_5"])
def test_a_flight_is_the_same_under_any_name(tmp_path: Path, name: str) -> None:
    for suffix in (".waypoints", ".csv.gz", ".json"):
        shutil.copy(flights.FOLDER / f"{name}{suffix}", tmp_path / f"P_px4_renamed{suffix}")
    renamed, original = compared(tmp_path, "P_px4_renamed").as_json(), compared(flights.FOLDER, name).as_json()
    assert renamed | {"name": name} == original


@real
def test_kinds_and_times_are_those_of_the_recordings() -> None:
    """Against the other reader of the same files."""
    kinds = {"ardupilot": "arducopter", "plane": "arduplane", "px4": "px4"}
    for name in flights.names():
        oracle, found = flights.read(name), read_recording(flights.FOLDER, name)
        assert found.kind == kinds[oracle.kind], name
        assert found.climbed_s == pytest.approx(oracle.begin_s, abs=0.25), name
        known = np.isfinite(oracle.reached_s)
        times = np.array([found.reached_s(item.seq) or np.nan for item in found.waypoints])
        np.testing.assert_array_equal(times[known], oracle.reached_s[known], name)
        np.testing.assert_allclose(found.position_m, oracle.position_m, atol=1e-6, err_msg=name)
