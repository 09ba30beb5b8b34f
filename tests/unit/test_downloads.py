"""What vehicles hold becomes files: equal to what was uploaded, by our readers and by others' rules."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.backup import read_backup, write_backup
from adapters.downloads import Found, download
from adapters.mission_items import MissionItem
from adapters.plan_file import read_plan
from adapters.sorties import read_mission_file
from adapters.waypoints_file import read_waypoints_home
from missionplanner.errors import LinkError, MissionError
from missionplanner.geodesy import GeoPoint
from missionplanner.mission import Point, Vehicle
from missionplanner.vehicle import Autopilot
from tests.plans import FRAME, small_fleet
from tests.rig import Rig

SAVED_AT = "2027-05-04T10:30:00+00:00"


def holding(autopilot: Autopilot) -> Rig:
    rig = Rig(small_fleet(autopilot, 2))
    rig.upload()
    return rig


def found_by(rig: Rig, **options: Any) -> tuple[Found, ...]:
    return download(rig.pipes, rig.clock, **options)


def asked(autopilot: Autopilot, *names: str) -> dict[int, Vehicle]:
    place = Point(x_m=0.0, y_m=0.0, alt_amsl_m=1200.0)
    return {k: Vehicle(name=name, autopilot=autopilot, home=place, goal=place) for k, name in enumerate(names, start=1)}


def homes(found: Sequence[Found]) -> dict[int, GeoPoint]:
    return {vehicle.saved.sysid: vehicle.home for vehicle in found if vehicle.home is not None}


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_files_say_what_vehicles_hold(autopilot: Autopilot, tmp_path: Path) -> None:
    rig = holding(autopilot)
    found = found_by(rig, asked=asked(autopilot, "alpha"))
    assert [(v.saved.name, v.saved.sysid, v.remarks) for v in found] == [("alpha", 1, ()), ("sysid2", 2, ())]
    write_backup(tmp_path, [v.saved for v in found], SAVED_AT, homes(found))
    for vehicle, plan in zip(found, rig.link._plan.vehicles, strict=True):
        home = FRAME.geo_point(plan.home_m)
        for suffix in ("plan", "waypoints"):
            items, read_home = read_mission_file(tmp_path / f"{vehicle.saved.name}.{suffix}", autopilot)
            assert read_home is not None
            assert read_home.lat_deg == pytest.approx(home.lat_deg, abs=1e-6)
            assert read_home.alt_amsl_m == pytest.approx(home.alt_amsl_m, abs=0.1)
            assert len(items) == len(vehicle.saved.mission)
            for item, held in zip(items, vehicle.saved.mission, strict=True):
                assert (item.command, item.x, item.y) == (held.command, held.x, held.y)
                assert item.z == pytest.approx(held.z, abs=1e-3)
                assert item.frame in (0, 2, 3)  # none of the superseded ones
    assert [saved.sha256 for saved in read_backup(tmp_path)] == [v.saved.sha256 for v in found]


def test_only_those_asked_for_are_read(tmp_path: Path) -> None:
    rig = holding("ardupilot")
    assert [v.saved.sysid for v in found_by(rig, expected=[2])] == [2]
    with pytest.raises(LinkError, match=r"expected sysid 7 within 3 s, heard only sysid 1, 2"):
        found_by(rig, expected=[2, 7], timeout_s=3.0)


def test_nothing_there_is_replaced(tmp_path: Path) -> None:
    found = found_by(holding("px4"), asked=asked("px4", "alpha", "bravo"))
    (tmp_path / "bravo.waypoints").write_text("mine")
    with pytest.raises(MissionError, match=r"bravo\.waypoints: is there already, and is not replaced"):
        write_backup(tmp_path, [v.saved for v in found], SAVED_AT, homes(found))
    assert [path.name for path in tmp_path.iterdir()] == ["bravo.waypoints"]
    assert (tmp_path / "bravo.waypoints").read_text() == "mine"


def test_fences_and_rally_points_are_in_the_plan_file(tmp_path: Path) -> None:
    rig = holding("ardupilot")
    corner = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
    corners = [(343_500_000, -1_181_900_000), (343_500_000, -1_181_700_000), (343_700_000, -1_181_800_000)]
    fence = tuple(MissionItem(k, 0, corner, 3.0, x=x, y=y) for k, (x, y) in enumerate(corners))
    rally = (MissionItem(0, 3, mavlink.MAV_CMD_NAV_RALLY_POINT, x=343_600_000, y=-1_181_800_000, z=25.0),)
    station, peer = rig.link._station, rig.link._vehicles[1]
    for kind, items in ((mavlink.MAV_MISSION_TYPE_FENCE, fence), (mavlink.MAV_MISSION_TYPE_RALLY, rally)):
        station.together({1: station.uploading(peer, "ardupilot", items, mission_type=kind)})
    found = found_by(rig)
    write_backup(tmp_path, [v.saved for v in found], SAVED_AT, homes(found))
    plan = read_plan(tmp_path / "sysid1.plan")
    assert (plan.fence_items, plan.rally_points) == (1, 1)
    document = json.loads((tmp_path / "sysid1.plan").read_text())
    assert document["geoFence"]["polygons"][0]["inclusion"] is True
    assert document["rallyPoints"]["points"] == [[34.36, -118.18, 25.0]]


def test_what_no_plan_file_can_say_is_told(tmp_path: Path) -> None:
    (found, _) = found_by(holding("px4"))
    fence = (MissionItem(0, 0, mavlink.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION, math.nan),)
    odd = Found(type(found.saved)("odd", 1, "px4", "copter", (), (), fence, ()), None)
    assert len(odd.remarks) == 3
    assert "holds no mission" in odd.remarks[0]
    assert "has no home yet" in odd.remarks[1]
    assert "its fence is in backup.json only, no .plan can say it" in odd.remarks[2]
    write_backup(tmp_path, [odd.saved], SAVED_AT)
    assert read_waypoints_home(tmp_path / "odd.waypoints", "px4")[0] == ()


def test_heights_above_terrain_keep_their_meaning_in_files(tmp_path: Path) -> None:
    (found, _) = found_by(holding("ardupilot"))
    first, *rest = found.saved.mission
    above = MissionItem(2, 11, 16, x=343_600_000, y=-1_181_800_000, z=40.0)
    saved = type(found.saved)("low", 1, "ardupilot", "copter", (), (first, rest[0], above), (), ())
    write_backup(tmp_path, [saved], SAVED_AT)
    item = json.loads((tmp_path / "low.plan").read_text())["mission"]["items"][-1]
    assert (item["frame"], item["AltitudeMode"], item["Altitude"]) == (10, 4, 40.0)  # never 3
    assert read_plan(tmp_path / "low.plan").items[-1].frame == 10
