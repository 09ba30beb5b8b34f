from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionplanner.certificate import Certificate
from missionplanner.errors import MissionError
from missionplanner.plan import Correction, FleetFlight, FleetPlan, FlownMeeting, FlownVehicle, Trajectory
from missionplanner.plan_folder import (
    CERTIFICATE_NAME,
    FLIGHT_NAME,
    PLAN_NAME,
    load_flight,
    load_plan,
    save_certificate,
    save_flight,
    save_plan,
    uncertified,
)
from missionplanner.planner import plan_fleet, returning_at
from missionplanner.scene import TERRAIN_NAME, Scene
from tests.scenes import at, copter, hilly, question, scene_of

MAST = {"kind": "cylinder", "name": "mast", "center": at(150, 5), "radius_m": 5, "top_height_agl_m": 120}
STOPS = [at(100, 40, agl=40), at(200, -40, agl=50)]


@pytest.fixture(scope="module")
def small() -> tuple[Scene, FleetPlan]:
    """Two copters on level ground, one of them with stops and a mast in its way, that start one after the other."""
    alpha = copter("alpha", (0, 0), (300, 0), stops=STOPS)
    data = question(alpha, copter("bravo", (0, 90), (300, 90)), obstacles=[MAST], fleet={"launch_interval_s": 5})
    scene = scene_of(data)
    return scene, plan_fleet(scene)


@pytest.fixture
def folder(small: tuple[Scene, FleetPlan], tmp_path: Path) -> Path:
    save_plan(tmp_path / "plan", *small)
    return tmp_path / "plan"


def assert_same(a: object, b: object) -> None:
    """Check that two plans are equal to the last bit, arrays and trajectories included."""
    assert type(a) is type(b)
    if isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, np.asarray(b))
    elif isinstance(a, tuple) and isinstance(b, tuple):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    elif hasattr(a, "__dataclass_fields__"):
        for part in fields(a):  # type: ignore[arg-type]
            assert_same(getattr(a, part.name), getattr(b, part.name))
    else:
        assert a == b


def edit(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    document = json.loads((folder / PLAN_NAME).read_text())
    change(document)
    (folder / PLAN_NAME).write_text(json.dumps(document))


def problem_of(folder: Path) -> str:
    with pytest.raises(MissionError) as raised:
        load_plan(folder)
    assert "\n" not in str(raised.value)
    return str(raised.value)


# --- round trips


def test_what_is_loaded_is_what_was_saved(small: tuple[Scene, FleetPlan], folder: Path) -> None:
    scene, plan = small
    loaded_scene, loaded = load_plan(folder)
    mission = loaded.mission
    assert_same(replace(loaded, mission=plan.mission), plan)
    assert mission.vehicles == plan.mission.vehicles
    assert mission.terrain == plan.mission.terrain
    assert loaded_scene.input_sha256 == scene.input_sha256
    heights_m = {vehicle.name: vehicle.motion.return_height_m for vehicle in plan.vehicles}
    assert all(type(height_m) is float for height_m in heights_m.values())
    assert_same(loaded_scene.tasks, returning_at(scene, heights_m).tasks)
    assert loaded.certificate is not None
    assert loaded.certificate.proven


def test_saving_what_was_loaded_gives_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    save_plan(tmp_path / "again", *load_plan(folder))
    assert (tmp_path / "again" / PLAN_NAME).read_bytes() == (folder / PLAN_NAME).read_bytes()


def test_who_made_the_plan_is_kept(folder: Path) -> None:
    edit(folder, lambda d: d.update(software_version="0.0.7"))
    assert load_plan(folder)[1].software_version == "0.0.7"


def test_a_folder_with_terrain_goes_anywhere_without_the_original(tmp_path: Path) -> None:
    here = tmp_path / "here"
    here.mkdir()
    scene = scene_of(hilly(here), here)
    plan = plan_fleet(scene)
    save_plan(here / "plan", scene, plan)
    shutil.move(here / "plan", tmp_path / "there")
    shutil.rmtree(here)
    loaded_scene, loaded = load_plan(tmp_path / "there")
    assert plan.certificate is not None
    told = tuple(line.replace("hill.tif", TERRAIN_NAME) for line in plan.certificate.assumptions)
    plan = replace(plan, certificate=replace(plan.certificate, assumptions=told))
    assert_same(replace(loaded, mission=plan.mission), plan)
    assert loaded_scene.input_sha256 == scene.input_sha256
    assert loaded.vehicles[0].clearances == plan.vehicles[0].clearances
    # and from there once more
    save_plan(tmp_path / "again", loaded_scene, loaded)
    for name in (PLAN_NAME, TERRAIN_NAME):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()


def test_flight_and_certificate_of_an_earlier_plan_are_removed(small: tuple[Scene, FleetPlan], folder: Path) -> None:
    save_flight(folder, flight_of(small[1]))
    save_certificate(folder, certified(small))
    save_plan(folder, *small)
    assert not (folder / FLIGHT_NAME).exists()
    assert not (folder / CERTIFICATE_NAME).exists()


def test_the_document_is_strict_json_with_its_version_first(folder: Path) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    document = json.loads((folder / PLAN_NAME).read_text(), parse_constant=refuse)
    assert list(document)[:2] == ["format", "version"]
    assert (document["format"], document["version"]) == ("missionplanner-plan", 3)
    for vehicle in document["vehicles"]:
        assert vehicle["waypoints"][-1]["reached_s"] == pytest.approx(vehicle["arrival_s"], abs=1e-3)
        assert all(c["ok"] for c in vehicle["clearances"])


def test_nothing_is_written_where_nothing_can_be(small: tuple[Scene, FleetPlan], tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    with pytest.raises(MissionError, match="expected a folder that can be written to"):
        save_plan(tmp_path / "file" / "plan", *small)
    assert (tmp_path / "file").read_text() == "kept"


# --- plans that do not fit their mission


def waypoints(document: dict[str, Any]) -> list[dict[str, Any]]:
    return document["vehicles"][0]["waypoints"]  # type: ignore[no-any-return]


def at_stop(document: dict[str, Any], stop: int) -> int:
    """Return the index of alpha's waypoint at a stop."""
    x, y = STOPS[stop]["x_m"], STOPS[stop]["y_m"]
    (index,) = [k for k, w in enumerate(waypoints(document)) if w["position_m"][:2] == [x, y]]
    return index


def test_a_stop_left_out_is_noticed(folder: Path) -> None:
    edit(folder, lambda d: waypoints(d).pop(at_stop(d, 1)))
    assert "alpha: expected waypoints" in problem_of(folder)
    assert "got none at stop 2: plan the mission again" in problem_of(folder)


def test_stops_in_another_order_are_noticed(folder: Path) -> None:
    def swap(document: dict[str, Any]) -> None:
        points, a, b = waypoints(document), at_stop(document, 0), at_stop(document, 1)
        points[a], points[b] = points[b], points[a]

    edit(folder, swap)
    assert "got none at stop 2" in problem_of(folder)


@pytest.mark.parametrize(("end", "named"), [(0, "the top of the take-off"), (-1, "the goal")])
def test_another_beginning_or_end_is_noticed(folder: Path, end: int, named: str) -> None:
    edit(folder, lambda d: waypoints(d)[end]["position_m"].__setitem__(2, 141.0))
    assert f"got none at {named}" in problem_of(folder)


def test_a_way_on_beyond_the_goal_is_noticed(folder: Path) -> None:
    edit(folder, lambda d: waypoints(d).append({"position_m": [320.0, 0.0, 140.0], "speed_m_s": 5.0}))
    assert "got none at the goal" in problem_of(folder)


@pytest.mark.parametrize("speed_m_s", [2.9, 10.1, 1e-9, 1e9])
def test_a_speed_out_of_range_is_noticed(folder: Path, speed_m_s: float) -> None:
    edit(folder, lambda d: d["vehicles"][1]["waypoints"][-1].update(speed_m_s=speed_m_s))
    assert f"bravo: expected a speed of 3 to 10 m/s, got {speed_m_s:g}" in problem_of(folder)


def test_a_leg_without_a_speed_is_refused(folder: Path) -> None:
    edit(folder, lambda d: waypoints(d)[-1].pop("speed_m_s"))
    assert "expected speed_m_s, of the leg to it, with waypoint" in problem_of(folder)


def test_a_start_before_its_turn_is_noticed(folder: Path) -> None:
    edit(folder, lambda d: d["vehicles"][1].update(start_delay_s=4.0))
    assert "bravo: expected a start 5 s after mission start (fleet.launch_interval_s), got 4" in problem_of(folder)


def test_another_mission_is_noticed(folder: Path) -> None:
    edit(folder, lambda d: d["mission"]["obstacles"][0].update(radius_m=4))
    assert "expected the mission and terrain it was planned for (sha256 " in problem_of(folder)


def test_vehicles_in_another_order_are_noticed(folder: Path) -> None:
    edit(folder, lambda d: d["vehicles"].reverse())
    assert "expected plans for alpha, bravo, got others" in problem_of(folder)


def test_a_waypoint_that_no_flight_reaches_is_refused_at_once(folder: Path) -> None:
    edit(folder, lambda d: waypoints(d).insert(1, {"position_m": [1e12, 0.0, 140.0], "speed_m_s": 5.0}))
    assert "vehicles.0.waypoints.1.position_m.0" in problem_of(folder)


@pytest.mark.parametrize("text", ["", "null", "[]", "{}", "[" * 100_000, '{"format": "missionplanner-plan"}'])
def test_what_is_no_plan_is_said_to_be_none(folder: Path, text: str) -> None:
    (folder / PLAN_NAME).write_text(text)
    assert "expected what this program wrote (version 3), got a damaged file" in problem_of(folder)


@pytest.mark.parametrize("version", [1, 2])
def test_a_plan_of_another_version_is_refused(folder: Path, version: int) -> None:
    edit(folder, lambda d: d.update(version=version))
    assert "expected what this program wrote (version 3)" in problem_of(folder)


@pytest.mark.parametrize("height_m", [0.0, -5.0, None, "high"])
def test_a_return_height_that_is_none_is_refused(folder: Path, height_m: object) -> None:
    edit(folder, lambda d: d["vehicles"][1].update(return_height_m=height_m))
    assert "vehicles.1.return_height_m" in problem_of(folder)


def test_another_return_height_is_proven_anew(small: tuple[Scene, FleetPlan], folder: Path) -> None:
    planned_m = [vehicle.motion.return_height_m for vehicle in small[1].vehicles]
    assert planned_m[0] > 120 + 10  # above the mast
    edit(folder, lambda d: d["vehicles"][0].update(return_height_m=30.0))
    plan = load_plan(folder)[1]
    assert [vehicle.motion.return_height_m for vehicle in plan.vehicles] == [30.0, planned_m[1]]
    assert plan.certificate is not None
    assert not plan.certificate.proven
    assert {finding.check for finding in plan.certificate.problems} == {"return"}


def test_a_waypoint_moved_into_the_mast_is_not_proven(folder: Path) -> None:
    edit(folder, lambda d: waypoints(d).insert(at_stop(d, 1), {"position_m": [150.0, 5.0, 140.0], "speed_m_s": 5.0}))
    certificate = load_plan(folder)[1].certificate
    assert certificate is not None
    assert "obstacle" in {finding.check for finding in certificate.problems}


def test_another_arrival_is_not_proven_and_none_is_refused(folder: Path) -> None:
    edit(folder, lambda d: d.update(arrival_s=d["arrival_s"] + 5.0))
    certificate = load_plan(folder)[1].certificate
    assert certificate is not None
    assert {finding.check for finding in certificate.problems} == {"arrival"}
    edit(folder, lambda d: d.update(arrival_s=None))
    assert "expected a common arrival (fleet.arrive_together), got none" in problem_of(folder)


def test_verdicts_in_the_file_are_not_believed(folder: Path) -> None:
    def boast(document: dict[str, Any]) -> None:
        for vehicle in document["vehicles"]:
            vehicle["clearances"] = []
            vehicle["arrival_s"] = 1.0
            vehicle["length_m"] = 1.0
        document["separation"] = None

    honest = load_plan(folder)[1]
    edit(folder, boast)
    assert_same(load_plan(folder)[1].vehicles, honest.vehicles)
    assert_same(load_plan(folder)[1].separation, honest.separation)


# --- certificates


def certified(small: tuple[Scene, FleetPlan]) -> Certificate:
    """Return the plan's certificate as if its missions had been read back."""
    certificate = small[1].certificate
    assert certificate is not None
    return replace(certificate, mission_sha256={"alpha": "a" * 64, "bravo": "b" * 64})


def test_a_certificate_covers_just_its_own_missions(small: tuple[Scene, FleetPlan], folder: Path) -> None:
    fresh = certified(small)
    assert "there is no " in str(uncertified(folder, fresh))
    path = save_certificate(folder, fresh)
    assert path == folder / CERTIFICATE_NAME
    assert uncertified(folder, fresh) is None
    others = replace(fresh, mission_sha256={**fresh.mission_sha256, "bravo": "c" * 64})
    assert "is of other missions than those that would be sent" in str(uncertified(folder, others))
    fewer = replace(fresh, mission_sha256={"alpha": "a" * 64})
    assert "is of other missions" in str(uncertified(folder, fewer))
    elsewhere = replace(fresh, input_sha256="0" * 64)
    assert "is of another mission file or terrain" in str(uncertified(folder, elsewhere))


def test_neither_side_of_a_certificate_is_believed_alone(small: tuple[Scene, FleetPlan], folder: Path) -> None:
    fresh = certified(small)
    failed = replace(fresh, findings=(replace(fresh.findings[0], proven=False, detail="no such luck"),))
    save_certificate(folder, fresh)
    assert str(uncertified(folder, failed)).startswith("not proven: alpha: no such luck")
    save_certificate(folder, failed)
    assert "certificate.json says so: check the plan again" in str(uncertified(folder, fresh))
    # boasting does not help: what is proven now counts
    document = json.loads((folder / CERTIFICATE_NAME).read_text())
    (folder / CERTIFICATE_NAME).write_text(json.dumps(document | {"proven": True}))
    assert uncertified(folder, failed) is not None


@pytest.mark.parametrize("text", ["", "{}", "null", '{"format": "missionplanner-certificate", "version": 1}'])
def test_a_damaged_certificate_covers_nothing(small: tuple[Scene, FleetPlan], folder: Path, text: str) -> None:
    (folder / CERTIFICATE_NAME).write_text(text)
    told = uncertified(folder, certified(small))
    assert told is not None
    assert "damaged file" in told
    assert "check the plan again" in told
    assert "\n" not in told


def test_a_certificate_file_is_strict_json_with_its_version_first(small: tuple[Scene, FleetPlan], folder: Path) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    endless = replace(certified(small).findings[0], value=float("-inf"), t_s=float("nan"))
    path = save_certificate(folder, replace(certified(small), findings=(endless,)))
    document = json.loads(path.read_text(), parse_constant=refuse)
    assert list(document)[:2] == ["format", "version"]
    assert (document["format"], document["version"]) == ("missionplanner-certificate", 1)
    assert document["mission_sha256"] == {"alpha": "a" * 64, "bravo": "b" * 64}
    assert document["return_height_m"] == dict(certified(small).return_height_m)
    save_certificate(folder, certified(small))
    first = path.read_bytes()
    save_certificate(folder, certified(small))
    assert path.read_bytes() == first


# --- flights


def flight_of(plan: FleetPlan) -> FleetFlight:
    alpha, bravo = plan.vehicles
    return FleetFlight(
        (
            FlownVehicle(alpha.name, alpha.sysid, alpha.trajectory, alpha.arrival_s, 99.5),
            FlownVehicle(bravo.name, bravo.sysid, Trajectory(np.array([0.0]), np.zeros((1, 3))), None, None),
        )
    )


def test_what_was_corrected_and_met_on_the_way_is_read_back(small: tuple[Scene, FleetPlan], folder: Path) -> None:
    plan = small[1]
    corrections = (Correction("alpha", 31.5, 6.0, 7.25, "to arrive with the others", True),)
    meetings = (FlownMeeting("line", {"alpha": 40.25, "bravo": None}),)
    save_flight(folder, replace(flight_of(plan), corrections=corrections, meetings=meetings))
    loaded = load_flight(folder, plan)
    assert loaded is not None
    assert (loaded.corrections, loaded.meetings) == (corrections, meetings)


def test_a_flight_is_read_back_to_the_millimetre(small: tuple[Scene, FleetPlan], folder: Path) -> None:
    _, plan = small
    assert load_flight(folder, plan) is None
    flight = flight_of(plan)
    save_flight(folder, flight)
    loaded = load_flight(folder, plan)
    assert loaded is not None
    for saved, read in zip(flight.vehicles, loaded.vehicles, strict=True):
        assert (read.name, read.sysid, read.arrival_s, read.landed_s) == (
            saved.name,
            saved.sysid,
            saved.arrival_s,
            saved.landed_s,
        )
        np.testing.assert_allclose(read.trajectory.t_s, saved.trajectory.t_s, atol=5.1e-4)
        np.testing.assert_allclose(read.trajectory.position_m, saved.trajectory.position_m, atol=5.1e-4)


FlightEdit = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["vehicles"][0]["t_s"].pop(),
        lambda d: d["vehicles"][0]["position_m"].pop(),
        lambda d: d["vehicles"][0]["t_s"].reverse(),
        lambda d: d["vehicles"][1].update(t_s=[], position_m=[]),
        lambda d: d["vehicles"][0]["position_m"][3].__setitem__(1, float("nan")),
        lambda d: d.update(version=2),
        lambda d: d["vehicles"].pop(),
        lambda d: d["vehicles"].reverse(),
    ],
)
def test_a_damaged_flight_is_refused(small: tuple[Scene, FleetPlan], folder: Path, change: FlightEdit) -> None:
    path = save_flight(folder, flight_of(small[1]))
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(MissionError, match=FLIGHT_NAME) as raised:
        load_flight(folder, small[1])
    assert "\n" not in str(raised.value)
