"""Repaired items and files differ from theirs in the positions that were moved, and in nothing else."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.certificates import Held, certify, read_files, sortie
from adapters.mission_items import (
    CHANGE_SPEED,
    LAND,
    LOITER_UNLIMITED,
    RETURN_TO_LAUNCH,
    TAKEOFF,
    WAYPOINT,
    MissionItem,
    degrees_to_wire,
)
from adapters.plan_file import PlanFile, plan_text, read_plan
from adapters.repaired_files import differences, moved_items, repaired, write_repaired
from adapters.sorties import LOITER_TIME
from adapters.waypoints_file import read_waypoints, waypoints_text
from missionplanner.errors import MissionError
from missionplanner.geodesy import GeoPoint
from missionplanner.mission import Mission
from missionplanner.repair import Move
from missionplanner.scene import Scene, build_check_scene
from missionplanner.vehicle import Autopilot
from tests.rasters import FRAME
from tests.scenes import at, copter, question

HILL = {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": [{**at(420, 0), "height_m": 40, "spread_m": 30}]}
AREA = {"south_west": at(-400, -400), "north_east": at(1000, 400)}


def asked(autopilot: Autopilot = "ardupilot") -> Mission:
    """Return a question: a hill at x = 420 m that reaches 140 m AMSL on ground of 100 m."""
    return Mission.model_validate(
        question(copter("alpha", (0, 0), (600, 0), autopilot=autopilot), area=AREA, terrain=HILL)
    )


def item(command: int, x_m: float, y_m: float, z: float, frame: int = 3, **changes: Any) -> MissionItem:
    point = FRAME.geo_point([x_m, y_m, 0.0])
    x, y = degrees_to_wire(point.lat_deg), degrees_to_wire(point.lon_deg)
    return replace(MissionItem(0, frame, command, x=x, y=y, z=z), **changes)


def numbered(*items: MissionItem) -> tuple[MissionItem, ...]:
    return tuple(replace(item, seq=seq, current=int(seq == 0)) for seq, item in enumerate(items))


HOME = item(WAYPOINT, 0, 0, 100, 0)
SPEED = MissionItem(0, 2, CHANGE_SPEED, 1.0, 5.0, -1.0)
RETURN = MissionItem(0, 2, RETURN_TO_LAUNCH)


def low(*between: MissionItem, frame: int = 3) -> tuple[MissionItem, ...]:
    """Return a mission whose last leg, from x = 300 to 600 m, is 25 m too low over the hill."""
    z = 40.0 if frame == 3 else 140.0
    return numbered(
        HOME,
        item(TAKEOFF, 0, 0, 40),
        SPEED,
        item(WAYPOINT, 300, 0, z, frame, param1=2.0),
        *between,
        item(WAYPOINT, 600, 0, z, frame),
    )


def scene() -> Scene:
    return build_check_scene(asked(), Path(), [])


def repaired_items(items: Sequence[MissionItem]) -> dict[int, tuple[MissionItem, MissionItem]]:
    """Return the items that a repair changes, before and after, after having looked that its legs then hold."""
    space = scene()
    held = Held("alpha", tuple(items), None, 70.0)
    (done,), rows = repaired(space, [held], Path("nowhere"))
    certificate = certify(space, [done])
    assert all(leg.proven for leg in certificate.legs)
    assert rows
    return {new.seq: (old, new) for old, new in zip(items, done.items, strict=True) if old != new}


@pytest.mark.parametrize("frame", [0, 3, 5, 6])
def test_altitudes_stay_in_their_frames(frame: int) -> None:
    items = low(frame=frame) if frame in (0, 3) else [replace(i, frame=frame) if i.frame else i for i in low()]
    if frame == 5:
        items = [replace(i, frame=5) if i.seq > 2 else i for i in low(frame=0)]
    changed = repaired_items(items)
    assert set(changed) == {3, 4}
    for old, new in changed.values():
        assert new == replace(old, z=new.z)
        assert 15.0 < new.z - old.z < 32.0


def test_a_mission_that_holds_is_returned_as_it_is(tmp_path: Path) -> None:
    items = tuple(replace(i, z=i.z + 40.0) if i.seq > 2 else i for i in low())
    held = Held("alpha", items, None, 90.0)
    (done,), rows = repaired(scene(), [held], tmp_path)
    assert done is held
    assert rows == []


def test_what_stays_at_the_last_waypoint_moves_with_it_and_what_lands_there_does_not() -> None:
    stays = numbered(*low(), item(LOITER_UNLIMITED, 600, 0, 40))
    changed = repaired_items(stays)
    assert set(changed) == {3, 4, 5}
    assert changed[4][1].z == changed[5][1].z
    assert set(repaired_items(numbered(*low(), item(LAND, 600, 0, 0)))) == {3, 4}
    assert set(repaired_items(numbered(*low(), RETURN))) == {3, 4}


def test_items_that_stay_as_high_as_the_one_before_are_told_how_high_that_was() -> None:
    """ArduCopter keeps its altitude at altitude 0, and its place at 0, 0."""
    waits = MissionItem(0, 3, LOITER_TIME, 5.0)
    before = low(waits)
    changed = repaired_items(before)
    assert set(changed) == {3, 5}  # it waits wherever, as high as the item before it

    level = item(WAYPOINT, 150, 100, 0)  # as high as the take-off
    behind = numbered(HOME, item(TAKEOFF, 0, 0, 20), SPEED, level, item(WAYPOINT, 100, 100, 60), RETURN)
    changed = repaired_items(behind)
    assert {seq: round(new.z - old.z, 0) for seq, (old, new) in changed.items()} == {1: 5.0, 3: 25.0}

    moves = [Move("alpha", 3, (300.0, 0.0, 140.0), (300.0, 9.0, 150.0))]
    follower = low(item(WAYPOINT, 450, 0, 0))
    read = sortie(scene(), Held("alpha", follower, None, 60.0))
    new = moved_items(follower, moves, read, FRAME)
    assert new[4].z == pytest.approx(40.0)
    assert (new[4].x, new[4].y) == (follower[4].x, follower[4].y)
    here = low(MissionItem(0, 3, LOITER_TIME, 5.0))
    read = sortie(scene(), Held("alpha", here, None, 60.0))
    new = moved_items(here, moves, read, FRAME)
    assert (new[4].x, new[4].y) == pytest.approx((here[3].x, here[3].y), abs=1)
    assert new[4].z == pytest.approx(40.0)


def test_heights_above_unknown_terrain_are_not_repaired() -> None:
    items = tuple(replace(i, frame=10) if i.seq == 3 else i for i in low())
    with pytest.raises(MissionError, match=r"alpha: item 3: expected an altitude AMSL or above home .* got frame 10"):
        repaired(scene(), [Held("alpha", items, None, 60.0)], Path("nowhere"))


def test_the_difference_is_told_in_degrees_and_metres() -> None:
    moves = [Move("alpha", 3, (10.0, 20.0, 140.0), (7.0, 16.0, 152.5)), Move("alpha", 4, (0, 0, 9.0), (0, 0, 8.0))]
    first, second = differences(moves, FRAME)
    assert first.shifted_m == pytest.approx(5.0)
    assert first.course_deg == pytest.approx(180.0 + math.degrees(math.atan2(3.0, 4.0)))
    assert (first.raised_m, second.raised_m, second.course_deg) == (12.5, -1.0, None)
    np.testing.assert_allclose(
        FRAME.to_local(first.after.lat_deg, first.after.lon_deg, first.after.alt_amsl_m), moves[0].to_m, atol=1e-3
    )
    assert json.dumps(second.as_json(), allow_nan=False)


# --- files ----------------------------------------------------------------------------------------------------------


def leaves(value: Any, where: str = "") -> dict[str, Any]:
    """Return every plain value of a JSON document by where it stands."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else None
    if pairs is None:
        return {where: value}
    return {path: leaf for key, part in pairs for path, leaf in leaves(part, f"{where}/{key}").items()}


def file_of(folder: Path, items: Sequence[MissionItem], autopilot: Autopilot, kind: str) -> Path:
    home = GeoPoint(FRAME.origin_lat_deg, FRAME.origin_lon_deg, 100.0)
    path = folder / f"ridge.{kind}"
    if kind == "plan":
        document = json.loads(plan_text(PlanFile(autopilot, home, tuple(items)), "copter"))
        document["mission"]["hoverSpeed"] = 7
        document["geoFence"]["polygons"] = [{"polygon": [[1.5, 2.25], [3, 4], [5, 6]], "inclusion": True, "Ü": None}]
        path.write_text(json.dumps(document, indent=2))
    else:
        path.write_bytes(waypoints_text(items, autopilot, home).replace("\n", "\r\n").encode())
    return path


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_plan_keeps_all_but_what_moved(tmp_path: Path, autopilot: Autopilot) -> None:
    items = low(frame=0) if autopilot == "ardupilot" else numbered(*low(frame=0)[1:])
    items = tuple(replace(i, frame=0, z=140.0) if i.command == TAKEOFF else i for i in items)
    path = file_of(tmp_path, items, autopilot, "plan")
    space, missions = read_files(asked(autopilot), tmp_path, [path])
    (done,), rows = repaired(space, missions, tmp_path / "out")
    assert all(leg.proven for leg in certify(space, [done]).legs)
    assert done.path == tmp_path / "out" / "alpha.plan"
    before, after = (leaves(json.loads(p.read_text())) for p in (path, done.path))
    assert before.keys() == after.keys()
    first = 1 if autopilot == "ardupilot" else 0
    expected = {f"/mission/items/{row.seq - first}/{what}" for row in rows for what in ("Altitude", "params/6")}
    assert {where for where in before if before[where] != after[where]} == expected
    assert read_plan(done.path).items == done.items


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_rows_keep_all_but_what_moved(tmp_path: Path, autopilot: Autopilot) -> None:
    items = low(frame=0) if autopilot == "ardupilot" else numbered(*low(frame=0)[1:])
    items = tuple(replace(i, frame=0, z=140.0) if i.command == TAKEOFF else i for i in items)
    path = file_of(tmp_path, items, autopilot, "waypoints")
    space, missions = read_files(asked(autopilot), tmp_path, [path])
    (done,), rows = repaired(space, missions, tmp_path / "out")
    assert done.path is not None
    before, after = (p.read_bytes().split(b"\r\n") for p in (path, done.path))
    offset = 1 if autopilot == "ardupilot" else 2  # the header, and PX4's home
    different = [n for n, (old, new) in enumerate(zip(before, after, strict=True)) if old != new]
    assert different == [row.seq + offset for row in rows]
    for n in different:
        old, new = before[n].split(b"\t"), after[n].split(b"\t")
        assert [k for k in range(12) if old[k] != new[k]] == [10]
    assert read_waypoints(done.path, autopilot) == done.items


def test_altitudes_that_qgroundcontrol_derives_are_fixed(tmp_path: Path) -> None:
    items = low(frame=0)
    path = file_of(tmp_path, items, "ardupilot", "plan")
    document = json.loads(path.read_text())
    document["mission"]["items"][2] |= {"AltitudeMode": 3, "Altitude": 40, "AMSLAltAboveTerrain": 140}
    path.write_text(json.dumps(document))
    new = tuple(replace(i, z=160.0) if i.seq == 3 else i for i in items)
    write_repaired(path, tmp_path / "new.plan", new, "ardupilot")
    entry = json.loads((tmp_path / "new.plan").read_text())["mission"]["items"][2]
    assert (entry["AltitudeMode"], entry["Altitude"], entry["AMSLAltAboveTerrain"]) == (2, 160.0, None)


def test_items_of_a_survey_are_not_moved(tmp_path: Path) -> None:
    items = low()
    path = file_of(tmp_path, items, "ardupilot", "plan")
    document = json.loads(path.read_text())
    entries = document["mission"]["items"]
    survey = {"type": "ComplexItem", "complexItemType": "survey", "TransectStyleComplexItem": {"Items": entries[2:3]}}
    entries[2:3] = [survey]
    path.write_text(json.dumps(document))
    assert read_plan(path).items == items
    after = tuple(replace(i, z=77.0) if i.seq == 4 else i for i in items)
    write_repaired(path, tmp_path / "new.plan", after, "ardupilot")
    assert read_plan(tmp_path / "new.plan").items == after
    within = tuple(replace(i, z=77.0) if i.seq == 3 else i for i in items)
    with pytest.raises(MissionError, match=r"mission\.items\[2\]: expected single waypoints .* item 3 of a survey"):
        write_repaired(path, tmp_path / "other.plan", within, "ardupilot")
    assert not (tmp_path / "other.plan").exists()


def test_other_items_and_the_file_itself_are_refused(tmp_path: Path) -> None:
    items = low()
    path = file_of(tmp_path, items, "ardupilot", "waypoints")
    with pytest.raises(MissionError, match="expected its own 5 items with other positions, got others"):
        write_repaired(path, tmp_path / "new.waypoints", items[:-1], "ardupilot")
    with pytest.raises(MissionError, match="got others"):
        faster = tuple(replace(i, param2=9.0) if i.command == CHANGE_SPEED else i for i in items)
        write_repaired(path, tmp_path / "new.waypoints", faster, "ardupilot")
    with pytest.raises(MissionError, match="expected another file than the one that is repaired"):
        write_repaired(path, path, items, "ardupilot")


def test_one_vehicle_has_one_file(tmp_path: Path) -> None:
    question_ = Mission.model_validate(question(area=AREA))  # alpha and bravo
    paths = [tmp_path / "alpha.plan", tmp_path / "alpha.waypoints"]
    with pytest.raises(MissionError, match=r"alpha: expected one file, got .*alpha.plan and .*alpha.waypoints"):
        read_files(question_, tmp_path, paths)


@pytest.mark.parametrize(("ending", "waived"), [(RETURN_TO_LAUNCH, False), (LOITER_UNLIMITED, True)])
def test_a_mission_that_ends_with_its_return_cannot_do_without(ending: int, waived: bool) -> None:
    """It would end elsewhere than where it is proven to, whatever fleet.direct_return says."""
    last = MissionItem(0, 2, ending) if ending == RETURN_TO_LAUNCH else item(ending, 200, 0, 60)
    items = numbered(HOME, item(TAKEOFF, 0, 0, 60), item(WAYPOINT, 200, 0, 60), last)
    asks = Mission.model_validate(
        question(copter("alpha", (0, 0), (200, 0)), area=AREA, fleet={"direct_return": "waived"})
    )
    space = build_check_scene(asks, Path(), [])
    held = Held("alpha", items, None, 30.0, return_remarks=("it holds 2 rally points",))
    certificate = certify(space, [held])
    finding = next(f for f in certificate.findings if f.detail == "it holds 2 rally points")
    assert (finding.proven, finding.waived, certificate.proven) == (False, waived, waived)
