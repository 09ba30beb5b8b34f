"""Every example mission, planned, exported, checked by the dense oracle, and flown in lock-step simulation."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from adapters.mission_items import plan_items
from missionplanner.plan import FleetFlight, FleetPlan
from missionplanner.plan_folder import load_plan, save_flight
from missionplanner.scene import Scene
from tests.benchmarks.main_job import SPREAD_MAX_S, run
from tests.main_job import EXAMPLES, fly, load_scene, mission_path, plan_into
from tests.mavsdk_importer import mavsdk_importer
from tests.oracles.dense_check import Report, World, check_folder, plan_polyline, waypoints_polyline


@dataclass(frozen=True)
class Job:
    """One example mission, done."""

    name: str
    folder: Path
    scene: Scene
    plan: FleetPlan
    flight: FleetFlight
    report: Report


@pytest.fixture(scope="module", params=EXAMPLES)
def job(request: pytest.FixtureRequest) -> Iterator[Job]:
    path = mission_path(request.param)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = load_scene(path)
        plan = plan_into(folder, scene, seed=1)
        flight = fly(scene, plan)
        save_flight(folder, flight)
        yield Job(request.param, folder, scene, plan, flight, check_folder(path, folder))


def test_every_vehicle_keeps_every_margin_as_planned_and_as_flown(job: Job) -> None:
    for found in (job.report.planned, job.report.flown):
        assert found.keys() == {vehicle.name for vehicle in job.plan.vehicles}
        assert [least for leasts in found.values() for least in leasts if not least.ok] == []


def test_the_proof_says_what_the_dense_check_says(job: Job) -> None:
    for vehicle in job.plan.vehicles:
        dense = {least.what: least.distance_m for least in job.report.planned[vehicle.name]}
        for clearance in vehicle.clearances:
            if clearance.what in dense and clearance.what != "fence":  # the proof's area may be narrower
                assert clearance.distance_m <= dense[clearance.what] + 0.1


def test_all_arrive_together(job: Job) -> None:
    assert job.report.arrival_spread_s is not None
    assert job.report.arrival_spread_s < SPREAD_MAX_S
    for vehicle, flown in zip(job.plan.vehicles, job.flight.vehicles, strict=True):
        assert flown.arrival_s == pytest.approx(vehicle.arrival_s, abs=SPREAD_MAX_S)


def test_they_arrive_where_they_should(job: Job) -> None:
    for vehicle, flown in zip(job.plan.vehicles, job.flight.vehicles, strict=True):
        assert flown.arrival_s is not None
        away_m = np.linalg.norm(flown.trajectory.at(flown.arrival_s) - vehicle.waypoints_m[-1])
        assert away_m <= vehicle.motion.waypoint_radius_m + 1.0
        assert (flown.landed_s is not None) == (vehicle.end == "land")


def test_they_keep_apart(job: Job) -> None:
    assert job.report.separation is not None
    assert job.report.separation.distance_m >= job.scene.mission.fleet.separation_m


def test_every_tower_is_inspected(job: Job) -> None:
    for inspected in (job.report.inspected, job.report.inspected_flown):
        assert (inspected is None) == (job.scene.mission.inspection is None)
        assert inspected is None or inspected.missed == ()


def test_exported_files_hold_the_plan(job: Job) -> None:
    world = World(mission_path(job.name))
    for vehicle in job.plan.vehicles:
        lat_deg, lon_deg, alt_m = job.plan.frame.to_geo(vehicle.waypoints_m)
        for read, suffix in ((waypoints_polyline, "waypoints"), (plan_polyline, "plan")):
            points_m = read(world, job.folder / "files" / f"{vehicle.name}.{suffix}")
            read_lat, read_lon, read_alt = job.plan.frame.to_geo(points_m)
            np.testing.assert_allclose(read_lat, lat_deg, rtol=0, atol=1e-7)
            np.testing.assert_allclose(read_lon, lon_deg, rtol=0, atol=1e-7)
            np.testing.assert_allclose(read_alt, alt_m, rtol=0, atol=1e-3)


def test_the_plan_folder_reads_back_safe_and_the_same(job: Job) -> None:
    _, again = load_plan(job.folder)
    for vehicle, read in zip(job.plan.vehicles, again.vehicles, strict=True):
        np.testing.assert_array_equal(read.waypoints_m, vehicle.waypoints_m)
        assert read.clearances == vehicle.clearances
        assert read.arrival_s == vehicle.arrival_s


def test_mavsdk_loads_every_file_with_the_right_count(job: Job) -> None:
    for autopilot in {vehicle.autopilot for vehicle in job.plan.vehicles}:
        with mavsdk_importer(autopilot) as importer:
            for vehicle in (v for v in job.plan.vehicles if v.autopilot == autopilot):
                count = len(plan_items(vehicle, job.plan.frame))
                path = job.folder / "files" / f"{vehicle.name}.plan"
                assert len(importer.import_qgroundcontrol_mission(str(path)).mission_items) == count
                # this importer puts a home of its own before ArduPilot's, and takes row 0 for an item of PX4's
                path = path.with_suffix(".waypoints")
                assert len(importer.import_mission_planner_mission(str(path)).mission_items) == count + 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 6))
@pytest.mark.parametrize("name", EXAMPLES)
def test_other_seeds_do_as_well(name: str, seed: int) -> None:
    assert list(run(name, seed, flown=True).problems(flown=True)) == []
