"""All files of a fleet at once, judged by the importers of MAVSDK and pymavlink."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavwp

from adapters.export import export_fleet
from adapters.mission_items import plan_items
from adapters.plan_file import read_plan
from adapters.waypoints_file import read_waypoints
from missionplanner.errors import MissionError
from missionplanner.plan import Action
from missionplanner.vehicle import Autopilot
from tests.mavsdk_importer import mavsdk_importer
from tests.plans import fleet_plan, vehicle_plan

ACTIONS = {
    1: Action("T1.left", "T1", hold_s=3.0, look_at_m=(50.0, 80.0, 1230.0), photos=2),
    2: Action(look_deg=(90.0, -45.0), photo_every_m=12.5),
}


def test_every_vehicle_gets_its_files_and_they_read_back(tmp_path: Path) -> None:
    plan = fleet_plan(vehicle_plan("a", 1), vehicle_plan("b", 2, autopilot="px4", end="rtl"))
    paths = export_fleet(plan, tmp_path / "new" / "folder")
    names = ["a.plan", "a.waypoints", "b.plan", "b.waypoints", "fleet.kml", "fleet.geojson"]
    assert [path.name for path in paths] == names
    assert sorted(p.name for p in (tmp_path / "new" / "folder").iterdir()) == sorted(names)
    for vehicle in plan.vehicles:
        items = plan_items(vehicle, plan.frame)
        folder = tmp_path / "new" / "folder"
        assert read_plan(folder / f"{vehicle.name}.plan").items == items
        assert read_waypoints(folder / f"{vehicle.name}.waypoints", vehicle.autopilot) == items


def test_the_same_plan_gives_the_same_bytes(tmp_path: Path) -> None:
    first = export_fleet(fleet_plan(), tmp_path / "1")
    second = export_fleet(fleet_plan(), tmp_path / "2")
    assert [p.read_bytes() for p in first] == [p.read_bytes() for p in second]


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(MissionError, match="file"):
        export_fleet(fleet_plan(), tmp_path / "file")


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_mavsdk_imports_both_formats(tmp_path: Path, autopilot: Autopilot) -> None:
    plan = fleet_plan(replace(vehicle_plan(autopilot=autopilot), hold_s=np.array([5.0, 0.0]), actions=ACTIONS))
    export_fleet(plan, tmp_path)
    with mavsdk_importer(autopilot) as importer:
        from_plan = importer.import_qgroundcontrol_mission(str(tmp_path / "uav1.plan")).mission_items
        from_waypoints = importer.import_mission_planner_mission(str(tmp_path / "uav1.waypoints")).mission_items
    items = plan_items(plan.vehicles[0], plan.frame)
    assert len(from_plan) == len(items)
    for got, item in zip(from_plan, items, strict=True):
        assert (got.seq, got.command, got.x, got.y) == (item.seq, item.command, item.x, item.y)
        assert {5: 0}.get(got.frame, got.frame) == item.frame  # its own home is in the old name of frame 0
        assert got.z == pytest.approx(item.z, abs=1e-3)
        assert [got.param1, got.param2, got.param3, got.param4] == pytest.approx(
            [item.param1, item.param2, item.param3, item.param4], nan_ok=True
        )
    # this importer puts a home of its own before ArduPilot's, and takes row 0 for an item of PX4's
    assert [item.command for item in from_waypoints] == [
        16,
        *([16] if autopilot == "ardupilot" else []),
        *(item.command for item in items if item.seq > 0 or autopilot == "px4"),
    ]
    photos = [item.param3 for item in from_waypoints if item.command == 2000]
    assert photos == [1.0, 1.0]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_pymavlink_counts_the_rows(tmp_path: Path, autopilot: Autopilot) -> None:
    plan = fleet_plan(replace(vehicle_plan(autopilot=autopilot), hold_s=np.array([5.0, 0.0]), actions=ACTIONS))
    export_fleet(plan, tmp_path)
    home_row = 0 if autopilot == "ardupilot" else 1
    assert mavwp.MAVWPLoader().load(str(tmp_path / "uav1.waypoints")) == home_row + len(
        plan_items(plan.vehicles[0], plan.frame)
    )
