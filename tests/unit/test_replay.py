"""A recorded flight against its plan: where it belongs on a path that crosses itself, and what follows from that."""

from __future__ import annotations

import csv
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.geodesy import FloatArray
from missionplanner.plan import FlownVehicle, Trajectory, VehiclePlan
from missionplanner.replay import (
    _STAND_M_S,
    _forward,
    match,
    path_distance_m,
    replay,
    replay_vehicle,
    save_replay,
)
from missionplanner.report import write_replay
from tests.plans import fleet_plan, small_fleet, vehicle_plan

OUT_AND_BACK = [(0, 0, 30), (200, 0, 30), (200, 20, 30), (0, 20, 30), (100, -50, 30), (100, 80, 30), (0, 0, 30)]


def trajectory(points_m: object, speed_m_s: float = 5.0) -> Trajectory:
    """Return a flight along points at constant speed, a sample every 0.1 s."""
    points = np.array(points_m, dtype=float)
    at_s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]) / speed_m_s
    t_s = np.union1d(np.arange(0.0, at_s[-1], 0.1), at_s)
    return Trajectory(t_s, Trajectory(at_s, points).at(t_s))


def flown(track: Trajectory, arrival_s: float | None = None) -> FlownVehicle:
    return FlownVehicle("uav1", 1, track, arrival_s, None)


coordinate = st.floats(-300.0, 300.0).map(lambda value: round(value, 1))


@settings(deadline=None, max_examples=40)
@given(
    points=st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=8),
    late_s=st.floats(-3.0, 20.0),
    slower=st.floats(0.8, 1.3),
)
def test_a_late_flight_is_late_by_just_that_everywhere(
    points: list[tuple[float, float]], late_s: float, slower: float
) -> None:
    """However a path crosses itself or doubles back."""
    way = [(x, y, 30.0) for x, y in points]
    steps = np.linalg.norm(np.diff(np.array(way), axis=0), axis=1)
    if steps.min() < 20.0:
        return
    planned = trajectory(way)
    shifted = Trajectory(slower * planned.t_s + late_s, planned.position_m)
    t_s = np.arange(shifted.t_s[0], shifted.t_s[-1], 0.23)
    found = match(planned, Trajectory(t_s, shifted.at(t_s)))
    expected = (t_s - late_s) / slower
    # at a sharp turn, a little of the way before it and of that after it are equally near
    np.testing.assert_allclose(found, expected, atol=0.8)
    assert np.median(np.abs(found - expected)) <= 0.05


def test_the_way_never_goes_back_and_is_the_best_of_all() -> None:
    rng = np.random.default_rng(1)
    for _ in range(30):
        grid_s, t_s = np.arange(5.0), np.sort(rng.uniform(0.0, 5.0, 4))
        grid_m, position_m = rng.uniform(-5.0, 5.0, (5, 3)), rng.uniform(-5.0, 5.0, (4, 3))

        def price(
            places: tuple[int, ...],
            grid_s: FloatArray = grid_s,
            grid_m: FloatArray = grid_m,
            t_s: FloatArray = t_s,
            position_m: FloatArray = position_m,
        ) -> float:
            off = grid_m[list(places)] - position_m
            return float((off**2).sum() + ((_STAND_M_S * (grid_s[list(places)] - t_s)) ** 2).sum())

        best = min(itertools.combinations_with_replacement(range(5), 4), key=price)
        assert price(tuple(_forward(grid_s, grid_m, t_s, position_m).tolist())) == pytest.approx(price(best))


def test_the_nearest_place_alone_would_mistake_the_way_back_for_the_way_out() -> None:
    planned = trajectory([(0, 0, 30), (200, 0, 30), (0, 0, 30)])
    track = Trajectory(planned.t_s + 4.0, planned.position_m + np.array([0.0, 3.0, 0.0]))
    np.testing.assert_allclose(match(planned, track), planned.t_s, atol=0.25)


def test_where_the_plan_stands_still_the_time_decides() -> None:
    planned = Trajectory(np.array([0.0, 10.0, 40.0, 50.0]), np.array([[0, 0, 0], [50, 0, 0], [50, 0, 0], [100, 0, 0]]))
    t_s = np.arange(12.0, 40.0, 1.0)
    found = match(planned, Trajectory(t_s, np.tile([50.0, 0.0, 0.0], (len(t_s), 1))))
    np.testing.assert_allclose(found, t_s, atol=0.02)


def test_beside_above_behind() -> None:
    plan = vehicle_plan()
    track = plan.trajectory
    t_s = np.arange(track.t_s[0], plan.arrival_s, 0.2)
    ahead = np.diff(plan.waypoints_m, axis=0)[0]
    right = np.array([ahead[1], -ahead[0], 0.0]) / np.hypot(*ahead[:2])
    late = Trajectory(t_s + 2.0, track.at(t_s) + 3.0 * right + [0.0, 0.0, 1.5])
    row = replay_vehicle(plan, flown(late, plan.arrival_s + 2.0), {})
    on_leg = (row.planned_s > plan.reached_s[0] + 2.0) & (row.planned_s < plan.reached_s[1] - 2.0)
    assert on_leg.sum() > 50
    climb = ahead[2] / np.linalg.norm(ahead)  # the nearest place of a climbing leg lies ahead of one above it
    ahead_s = 1.5 * climb / plan.speed_m_s
    np.testing.assert_allclose(row.cross_track_m[on_leg], 3.0, atol=0.05)
    np.testing.assert_allclose(row.above_m[on_leg], 1.5, atol=0.1)
    np.testing.assert_allclose(row.time_error_s[on_leg], 2.0 - ahead_s, atol=0.05)
    np.testing.assert_allclose(row.along_error_m[on_leg], -(2.0 - ahead_s) * plan.speed_m_s, atol=0.4)
    assert row.arrival_error_s == pytest.approx(2.0)
    left = Trajectory(t_s, track.at(t_s) - 3.0 * right)
    np.testing.assert_allclose(replay_vehicle(plan, flown(left), {}).cross_track_m[on_leg], -3.0, atol=0.05)


def test_errors_after_the_arrival_do_not_count() -> None:
    plan = vehicle_plan()
    track = plan.trajectory
    t_s = np.arange(0.0, track.t_s[-1], 0.2)
    away = track.at(t_s) + np.where(t_s > plan.arrival_s + 1.0, 40.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    figures = replay_vehicle(plan, flown(Trajectory(t_s, away), plan.arrival_s), {}).as_json()
    assert figures["off_path_m"]["worst"] < 0.1
    assert figures["cross_track_m"]["worst"] < 0.1


def test_waypoints_are_reached_as_reported_else_as_passed_else_never() -> None:
    plan = vehicle_plan()
    t_s = np.arange(0.0, plan.reached_s[1] + 3.0, 0.2)
    half = Trajectory(t_s + 1.0, plan.trajectory.at(t_s))
    times = replay_vehicle(plan, flown(half), {0: 14.25}).waypoints
    assert [w.how for w in times] == ["reported", "passed", None]
    assert times[0].error_s == pytest.approx(14.25 - plan.reached_s[0])
    assert times[1].error_s == pytest.approx(1.0, abs=0.15)
    assert times[2].error_s is None


def test_of_a_fleet_spread_and_separation() -> None:
    plan = small_fleet("ardupilot")
    late_s = {"uav1": 0.0, "uav2": 1.5, "uav3": 0.25}
    tracks = {
        v.name: FlownVehicle(
            v.name,
            v.sysid,
            Trajectory(v.trajectory.t_s + late_s[v.name], v.trajectory.position_m),
            v.arrival_s + late_s[v.name],
            None,
        )
        for v in plan.vehicles
    }
    found = replay(plan, tracks, {})
    assert found.arrival_spread_s == pytest.approx(1.5)
    assert found.planned_spread_s == pytest.approx(0.0, abs=1e-9)
    assert found.separation is not None
    assert found.separation.distance_m == pytest.approx(40.0, abs=1.0)
    never = tracks | {"uav2": FlownVehicle("uav2", 2, tracks["uav2"].trajectory, None, None)}
    assert replay(plan, never, {}).arrival_spread_s is None
    one = replay(plan, {"uav3": tracks["uav3"]}, {})
    assert [v.plan.name for v in one.vehicles] == ["uav3"]
    assert one.separation is None


def test_who_stays_in_the_air_is_followed_no_further_than_its_plan() -> None:
    plan = vehicle_plan(end="loiter")
    t_s = np.arange(0.0, plan.arrival_s + 600.0, 0.5)
    row = replay_vehicle(plan, flown(Trajectory(t_s, plan.trajectory.at(t_s)), plan.arrival_s), {})
    assert row.t_s[-1] <= plan.arrival_s
    assert np.abs(row.time_error_s).max() < 1.0


@given(seed=st.integers(0, 1000))
def test_the_distance_from_a_path_is_that_from_its_nearest_sample(seed: int) -> None:
    rng = np.random.default_rng(seed)
    path, points = rng.uniform(-50.0, 50.0, (5, 3)), rng.uniform(-80.0, 80.0, (7, 3))
    path[2] = path[1]  # a place where it stands
    dense = Trajectory(np.arange(5.0), path).at(np.linspace(0.0, 4.0, 20_001))
    expected = np.linalg.norm(points[:, None] - dense, axis=-1).min(axis=1)
    np.testing.assert_allclose(path_distance_m(points, path), expected, atol=0.02)
    assert (path_distance_m(points, path) <= expected + 1e-9).all()


def _replayed(plan: VehiclePlan) -> FlownVehicle:
    t_s = np.arange(0.0, plan.arrival_s, 0.2)
    return flown(Trajectory(t_s + 0.5, plan.trajectory.at(t_s)), plan.arrival_s + 0.5)


def test_what_is_written_says_the_same(tmp_path: Path) -> None:
    plan = vehicle_plan()
    found = replay(fleet_plan(plan), {"uav1": _replayed(plan)}, {"uav1": {2: plan.arrival_s + 0.5}})
    paths = save_replay(tmp_path, found, found.as_json())
    with paths["errors"].open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(found.vehicles[0].t_s)
    assert all(math.isfinite(float(row["cross_track_m"])) and row["vehicle"] == "uav1" for row in rows)
    late = [float(row["t_s"]) - float(row["planned_s"]) - float(row["time_error_s"]) for row in rows]
    assert np.abs(late).max() <= 0.0021  # each is rounded to a millisecond
    with paths["waypoints"].open() as file:
        assert [row["how"] for row in csv.DictReader(file)] == ["passed", "passed", "reported"]
    figures = json.loads(paths["figures"].read_text())
    assert figures["vehicles"][0]["arrival_error_s"] == pytest.approx(0.5)
    assert len(figures["vehicles"][0]["waypoints"]) == 3


def test_the_page_says_who_came_too_close_and_who_never_arrived(tmp_path: Path) -> None:
    plan = small_fleet("ardupilot", 2)
    one, two = plan.vehicles
    beside = Trajectory(one.trajectory.t_s, one.trajectory.position_m + np.array([0.0, 3.0, 0.0]))
    near = FlownVehicle("uav2", 2, beside, two.arrival_s, None)
    tracks = {"uav1": FlownVehicle("uav1", 1, one.trajectory, one.arrival_s, None), "uav2": near}
    page = write_replay(tmp_path, plan.mission, replay(plan, tracks, {}), start="now", troubles=(), remarks=("gap",))
    assert "Vehicles came too close to one another" in page.read_text()
    assert "uav1 - uav2 came within 3.0 m; " in page.read_text()
    tracks["uav2"] = FlownVehicle("uav2", 2, two.trajectory, None, None)
    page = write_replay(tmp_path, plan.mission, replay(plan, tracks, {}), start="now", troubles=(), remarks=())
    assert "1 of 2 vehicles never reached their goals" in page.read_text()
    assert "too close" not in page.read_text()
