"""QGC WPL 110: exact columns, home in row 0, real files read, wrong ones refused by line."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink import mavwp

from adapters.mission_items import plan_items
from adapters.waypoints_file import read_waypoints, waypoints_text
from missionplanner.errors import MissionError
from missionplanner.vehicle import Autopilot
from tests.plans import FRAME, vehicle_plan

SAMPLES = Path(__file__).parents[3] / "shared" / "samples" / "waypoints"


def _text(autopilot: Autopilot) -> str:
    vehicle = vehicle_plan(autopilot=autopilot)
    return waypoints_text(plan_items(vehicle, FRAME), autopilot, FRAME.geo_point(vehicle.home_m))


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_exact_tabs_and_home_in_row_0(autopilot: Autopilot) -> None:
    text = _text(autopilot)
    lines = text.split("\n")
    assert lines[0] == "QGC WPL 110"
    assert lines.pop() == ""
    rows = [line.split("\t") for line in lines[1:]]
    assert {len(row) for row in rows} == {12}
    assert all(column == column.strip() != "" for row in rows for column in row)
    assert rows[0] == ["0", "1", "0", "16", "0", "0", "0", "0", "34.36000000", "-118.18000000", "1200", "1"]
    assert [row[0] for row in rows] == [str(k) for k in range(6)]
    assert [row[1] for row in rows] == ["1", "0", "0", "0", "0", "0"]
    assert [row[3] for row in rows] == ["16", "22", "178", "16", "16", "21"]
    assert rows[1][7] == ("nan" if autopilot == "px4" else "0")


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_pymavlink_loads_it(tmp_path: Path, autopilot: Autopilot) -> None:
    path = tmp_path / "uav.waypoints"
    path.write_text(_text(autopilot))
    loader = mavwp.MAVWPLoader()
    assert loader.load(str(path)) == 6
    assert [loader.wp(k).command for k in range(6)] == [16, 22, 178, 16, 16, 21]
    items = read_waypoints(path, "ardupilot")
    for k in range(6):
        assert abs(loader.wp(k).x - items[k].x / 1e7) <= 1e-7
        assert abs(loader.wp(k).y - items[k].y / 1e7) <= 1e-7
        assert abs(loader.wp(k).z - items[k].z) <= 1e-3


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("qgc_MissionPlanner.waypoints", 6),
        ("mavsdk_mission_planner_sample.txt", 4),
        ("dronekit_mpmission.txt", None),
        ("ardupilot_NavDelayTakeoffAbsTime.txt", None),
        ("ardupilot_DO_CHANGE_SPEED_mission.txt", None),
        ("ardupilot_copter_terrain_mission.txt", None),
    ],
)
def test_real_files_are_read(name: str, count: int | None) -> None:
    path = SAMPLES / name
    if not path.exists():
        pytest.skip("real sample files are not at hand")
    loader = mavwp.MAVWPLoader()
    loader.load(str(path))
    items = read_waypoints(path, "ardupilot")
    assert len(items) == (count or loader.count())
    for k, item in enumerate(items):
        wp = loader.wp(k)
        assert (item.seq, item.frame, item.command) == (wp.seq, wp.frame, wp.command)
        assert abs(item.x / 1e7 - wp.x) <= 0.5e-7 + 1e-12
        assert item.z == pytest.approx(wp.z, abs=1e-3)


def test_px4s_mission_comes_back_without_the_home_row(tmp_path: Path) -> None:
    path = tmp_path / "uav.waypoints"
    path.write_text(_text("px4"))
    assert read_waypoints(path, "px4") == plan_items(vehicle_plan(autopilot="px4"), FRAME)


_ROW = "0\t1\t0\t16\t0\t0\t0\t0\t34.0\t-118.0\t1200\t1\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", ":1: expected the header 'QGC WPL 110', got 'an empty file'"),
        ("QGC WPL 100\n" + _ROW, ":1: expected the header"),
        ("QGC WPL 110\n0\t1\t0\n", ":2: expected 12 columns, got 3"),
        ("QGC WPL 110\n" + _ROW + _ROW.replace("16", "sixteen").replace("0", "1", 1), ":3: expected numbers"),
        ("QGC WPL 110\n" + _ROW + _ROW, "expected item 1, got 0"),
        ("QGC WPL 110\n" + _ROW.replace("34.0", "nan"), ":2: expected a latitude"),
        ("QGC WPL 110\n" + _ROW.replace("34.0", "340"), ":2: expected a latitude"),
        ("QGC WPL 110\n" + _ROW.replace("1200", "inf"), ":2: expected a latitude"),
    ],
)
def test_wrong_lines_are_named(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "wrong.waypoints"
    path.write_text(text)
    with pytest.raises(MissionError) as error:
        read_waypoints(path, "ardupilot")
    assert says in str(error.value)


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wrong.waypoints"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(MissionError, match="expected a readable text file"):
        read_waypoints(path, "px4")
    with pytest.raises(MissionError, match="expected a readable text file"):
        read_waypoints(tmp_path / "nowhere", "px4")
