from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from missionplanner import kernels
from missionplanner.errors import MissionError
from missionplanner.mission import Mission, VehicleSettings, parse_mission
from missionplanner.scene import TERRAIN_NAME, Scene, build_check_scene, build_scene, portable_mission
from missionplanner.spans import conductor_distance_m
from missionplanner.terrain import write_raster
from missionplanner.vehicle import motion_model
from tests.rasters import AREA, FRAME, hill, hill_in, write_tif

FLAT: dict[str, Any] = {
    "name": "flat",
    "origin": {"lat_deg": 34.35, "lon_deg": -118.2},
    "terrain": {"kind": "flat", "alt_amsl_m": 100},
    "vehicles": [
        {"name": "alpha", "home": {"x_m": 0, "y_m": 0}, "goal": {"x_m": 500, "y_m": 0, "alt_amsl_m": 150}},
        {"name": "bravo", "home": {"x_m": 0, "y_m": 50}, "goal": {"x_m": 500, "y_m": 60, "height_agl_m": 40}},
    ],
}


def question(**changes: Any) -> dict[str, Any]:
    return {**copy.deepcopy(FLAT), **changes}


def flying(*vehicles: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """Return a mission whose vehicles differ from alpha by what is given."""
    return question(vehicles=[{**FLAT["vehicles"][0], "name": f"v{i}", **v} for i, v in enumerate(vehicles)], **changes)


def scene_of(data: dict[str, Any], folder: Path = Path()) -> Scene:
    return build_scene(Mission.model_validate(data), folder)


def problem_of(data: dict[str, Any], folder: Path = Path()) -> str:
    with pytest.raises(MissionError) as raised:
        scene_of(data, folder)
    assert "\n" not in str(raised.value)
    return str(raised.value)


def at(x: float, y: float, alt: float | None = None, *, agl: float | None = None) -> dict[str, float]:
    place = {"x_m": x, "y_m": y}
    if alt is not None:
        place["alt_amsl_m"] = alt
    if agl is not None:
        place["height_agl_m"] = agl
    return place


SAG_100_M = 2000.0 * (math.cosh(50.0 / 2000.0) - 1.0)


def least_m(scene: Scene, name: str, position: list[float]) -> float:
    """Return the distance to the nearest of the solids of this name."""
    named = [n == name for n in scene.obstacles.names]
    return float(scene.obstacles.distance_m(position)[named].min())


MAST = {"kind": "cylinder", "name": "mast", "center": at(200, 0), "radius_m": 5}
SQUARE = [at(-100, -200), at(700, -200), at(700, 300), at(-100, 300)]


# --- what is resolved


def test_heights_above_ground_and_above_the_sea_are_settled() -> None:
    alpha, bravo = scene_of(question()).tasks
    assert alpha.home_m.tolist() == pytest.approx([0, 0, 100])
    assert alpha.route_m[-1].tolist() == pytest.approx([500, 0, 150])
    assert bravo.route_m[-1].tolist() == pytest.approx([500, 60, 140])
    assert (alpha.sysid, bravo.sysid) == (1, 2)
    assert (alpha.end, bravo.end) == ("land", "land")


def test_places_in_degrees_are_those_in_metres() -> None:
    point = FRAME.geo_point(np.array([500.0, 0.0, 150.0]))
    goal = {"lat_deg": point.lat_deg, "lon_deg": point.lon_deg, "alt_amsl_m": 150}
    (task,) = scene_of(flying({"goal": goal})).tasks
    assert task.route_m[-1].tolist() == pytest.approx([500, 0, 150], abs=1e-6)


def test_a_copter_climbs_straight_up_first() -> None:
    (task,) = scene_of(flying({})).tasks
    assert task.route_m[0].tolist() == pytest.approx([0, 0, 135])  # margin 20, tube 2 + 1 + 2, and room 10
    (task,) = scene_of(flying({"takeoff_height_m": 60})).tasks
    assert task.route_m[0].tolist() == pytest.approx([0, 0, 160])
    (task,) = scene_of(flying({"height_agl_max_m": 35, "goal": at(500, 0, agl=27)})).tasks
    assert task.route_m[0].tolist() == pytest.approx([0, 0, 130])


def test_a_start_above_home_is_the_top_of_the_take_off_and_another_is_flown_to() -> None:
    (above,) = scene_of(flying({"home": at(0.5, 0), "start": at(0, 0, 155)})).tasks
    assert above.route_m.tolist() == [[0, 0, 155], [500, 0, 150]]
    (away,) = scene_of(flying({"start": at(30, 0, 155)})).tasks
    assert away.route_m.tolist() == pytest.approx(np.array([[0, 0, 135], [30, 0, 155], [500, 0, 150]]))
    data = flying({"start": at(30, 0, 155)})
    del data["vehicles"][0]["home"]
    (below,) = scene_of(data).tasks
    assert below.home_m.tolist() == pytest.approx([30, 0, 100])
    assert below.route_m.tolist() == [[30, 0, 155], [500, 0, 150]]


def test_stops_are_flown_in_order_and_then_the_towers() -> None:
    towers = [{"name": f"T{i}", **at(100 * i, 100), "height_m": 30} for i in range(1, 4)]
    stops = [at(50, 20, 140), at(80, 20, 140)]
    data = flying(
        {"stops": stops, "inspects": {"first": "T1", "last": "T2"}},
        {"home": at(0, 60), "goal": at(500, 80, 150), "inspects": {"first": "T3", "last": "T2"}},
        inspection={"towers": towers, "standoff_m": 25},
    )
    scene = scene_of(data)
    assert scene.tasks[0].route_m[1:].tolist() == pytest.approx(
        np.array([[50, 20, 140], [80, 20, 140], [100, 100, 155], [200, 100, 155], [500, 0, 150]])
    )
    assert scene.tasks[1].route_m[1:3, 0].tolist() == [300, 200]
    assert scene.towers is not None
    assert scene.towers.top_m.tolist() == pytest.approx(np.array([[100, 100, 130], [200, 100, 130], [300, 100, 130]]))
    assert list(dict.fromkeys(scene.obstacles.names)) == ["T1", "T2", "T3", "span T1-T2", "span T2-T3"]
    assert least_m(scene, "span T1-T2", [150.0, 100.0, 150.0]) == pytest.approx(20 + SAG_100_M - 8, abs=0.01)


def towers(*places: tuple[float, float], **more: Any) -> list[dict[str, Any]]:
    return [{"name": f"T{i + 1}", **at(*place), "height_m": 30, **more} for i, place in enumerate(places)]


def test_nobody_is_below_a_conductor_and_above_it_is_free() -> None:
    line = {"towers": towers((100, 100), (400, 100))}
    scene = scene_of(flying({}, inspection=line))
    (span,) = scene.spans
    assert (span.name, span.line, span.lines, span.towers) == ("span T1-T2", "line", ("line",), (0, 1))
    assert span.curve_m[[0, -1]].tolist() == pytest.approx(np.array([[100, 100, 130], [400, 100, 130]]))
    sag_m = 2000.0 * (math.cosh(150.0 / 2000.0) - 1.0)
    lowest_m = 130 - sag_m
    assert least_m(scene, "span T1-T2", [250.0, 100.0, 0.0]) == pytest.approx(-8)
    assert least_m(scene, "span T1-T2", [250.0, 120.0, 110.0]) == pytest.approx(12)
    over = least_m(scene, "span T1-T2", [250.0, 100.0, lowest_m + 50.0])
    assert 42 - 0.5 <= over <= 42 + 1e-6  # the straight pieces lie above the cable, by half a metre at most
    place = np.array([[250.0, 100.0, lowest_m - 30.0], [250.0, 130.0, lowest_m]])
    assert conductor_distance_m(scene.conductors, place).tolist() == pytest.approx([22, 22])


def test_circuits_on_the_same_towers_share_their_spans_as_wide_and_as_tight_as_either() -> None:
    lines = [
        {"name": "east", "towers": ["T1", "T2", "T3"], "conductor_radius_m": 3, "catenary_m": 4000},
        {"name": "west", "towers": ["T4", "T2", "T1"], "conductor_radius_m": 5, "catenary_m": 1000},
    ]
    line = {"towers": towers((100, 100), (300, 100), (500, 100), (300, 200)), "lines": lines}
    spans = scene_of(flying({}, inspection=line)).spans
    assert [(s.name, s.lines, s.towers) for s in spans] == [
        ("span T1-T2", ("east", "west"), (0, 1)),
        ("span T2-T3", ("east",), (1, 2)),
        ("span T4-T2", ("west",), (3, 1)),
    ]
    assert [(s.conductor.radius_m, s.conductor.catenary.constant_m) for s in spans] == [
        (5, 4000),
        (3, 4000),
        (5, 1000),
    ]


def test_other_lines_are_supports_and_the_room_below_their_cables() -> None:
    lift = {
        "kind": "line", "name": "lift", "supports": [at(100, 100, agl=20), at(200, 100, agl=20), at(300, 150, 145)],
        "catenary_m": 2000,
    }  # fmt: skip
    scene = scene_of(flying({}, obstacles=[lift]))
    assert set(scene.obstacles.names) == {"lift"}
    assert least_m(scene, "lift", [200.0, 95.0, 110.0]) == pytest.approx(5 - 3)
    assert least_m(scene, "lift", [150.0, 100.0, 0.0]) == pytest.approx(-3)
    assert least_m(scene, "lift", [150.0, 100.0, 130.0]) == pytest.approx(10 + SAG_100_M - 3, abs=0.01)
    assert conductor_distance_m(scene.conductors, np.array([[150.0, 100.0, 130.0]])) == pytest.approx(
        10 + SAG_100_M - 3
    )
    assert scene.spans == ()


def test_a_tower_that_is_an_obstacle_only_weighs_nothing() -> None:
    first, second = towers((100, 100), (300, 100))
    scene = scene_of(flying({}, inspection={"towers": [{**first, "views": "none", "weight": 9}, second]}))
    assert scene.towers is not None
    assert scene.towers.weight.tolist() == [0, 1]
    assert scene.towers.height_m.tolist() == [30, 30]
    assert "T1" in scene.obstacles.names


@pytest.mark.parametrize(
    ("places", "line", "says"),
    [
        (
            [(100, 100), (6200, 100)],
            {},
            "inspection.lines (line): T2: expected a tower within 6 km of T1, the one before it, got one 6.1 km away: "
            "check their order, or make them two lines",
        ),
        (
            [(100, 100), (100.5, 100)],
            {},
            "T2: expected a tower at least 1.0 m from T1, the one before it, got one 0.50",
        ),
        (
            [(100, 100), (500, 100)],
            {"catenary_m": 90},
            "T2: expected a catenary_m of at least 100 m for the 400 m from",
        ),
    ],
)
def test_towers_that_no_conductor_can_hang_between(
    places: list[tuple[float, float]], line: dict[str, Any], says: str
) -> None:
    lines = [{"name": "line", "towers": ["T1", "T2"], **line}]
    assert says in problem_of(flying({}, inspection={"towers": towers(*places), "lines": lines}))


def test_supports_that_no_cable_can_hang_between() -> None:
    lift = {"kind": "line", "name": "lift", "supports": [at(100, 100, agl=20), at(7000, 100, agl=20)]}
    assert problem_of(flying({}, obstacles=[lift])).startswith(
        "obstacles[0] (lift).supports[1]: expected a support within 6 km of the one before, got one 6.9 km away"
    )


def test_a_plane_climbs_towards_its_first_point() -> None:
    plane = {"class": "plane", "takeoff_height_m": 50, "climb": {"angle_max_deg": 10}}
    (task,) = scene_of(flying(plane)).tasks
    assert task.route_m[0].tolist() == pytest.approx([50 / math.tan(math.radians(10)), 0, 150])
    assert task.end == "loiter"
    wide = {"south_west": at(-300, -300), "north_east": at(800, 400)}
    (task,) = scene_of(flying({**plane, "home": at(500, 0)}, area=wide)).tasks  # straight below its goal
    assert task.route_m[0, 1] == pytest.approx(50 / math.tan(math.radians(10)))
    strong = {"angle_max_deg": 45, "rate_m_s": 12}
    (task,) = scene_of(flying({**plane, "climb": strong})).tasks  # rolls, then climbs its steepest
    assert task.route_m[0, 0] == pytest.approx(37.0 + 50 / math.tan(math.radians(20)), rel=0.02)
    (task,) = scene_of(flying({**plane, "climb": {"angle_max_deg": 45, "rate_m_s": 6}})).tasks  # or as stated
    assert task.route_m[0, 0] == pytest.approx(37.0 + 50 * 22 / 6, rel=0.03)


def test_a_planes_circle_must_be_clear() -> None:
    plane = {"class": "plane", "goal": at(500, 0, agl=60)}
    mast = {"kind": "cylinder", "name": "mast", "center": at(500, 65), "radius_m": 3}
    problem = problem_of(flying(plane, obstacles=[mast]))
    assert (
        "goal (v0), the circle of 60 m radius on which it stays: expected at least 23.0 m from obstacle mast" in problem
    )
    scene_of(flying({**plane, "motion": {"loiter_radius_m": 95}}, obstacles=[mast]))
    home_mast = {**mast, "center": at(60, 0), "top_height_agl_m": 120}
    scene_of(flying({**plane, "home": at(0, 300)}, obstacles=[{**home_mast, "center": at(60, 300)}]))
    returning = {**plane, "home": at(0, 300), "end": "rtl"}
    problem = problem_of(flying(returning, obstacles=[{**home_mast, "center": at(60, 300)}]))
    assert "home (v0), the circle of 60 m radius on which it stays" in problem


def test_circling_planes_stay_apart() -> None:
    first = {"class": "plane", "goal": at(600, 0, agl=60)}
    second = {"class": "plane", "home": at(0, 250), "goal": at(600, 210, agl=60)}
    problem = problem_of(flying(first, second))
    assert "(v1): expected to stay at its end at least 46 m from" in problem  # 20 and twice 13
    wide_m = motion_model(VehicleSettings(vehicle_class="plane")).circle_m(22.0, 160.0)
    assert 80.0 < wide_m < 105.0  # as wide as it is flown, not as it is asked for
    assert f"got {210 - 2 * wide_m:.1f} m" in problem
    scene_of(flying(first, {**second, "goal": at(600, 2 * wide_m + 46.1, agl=60)}))
    scene_of(flying(first, {**second, "goal": at(600, 210, agl=110)}))
    assert "circles of planes included" in problem_of(flying(first, {"home": at(0, 200), "goal": at(600, 70, agl=50)}))
    both_home = ({**first, "end": "rtl"}, {**second, "end": "rtl", "home": at(0, 130)})
    assert "circles of planes included" in problem_of(flying(*both_home))


def test_every_kind_of_obstacle_stands_where_it_says() -> None:
    obstacles = [
        {**MAST, "center": at(100, 500), "top_height_agl_m": 30},
        {"kind": "cone", "name": "cone", "center": at(200, 500), "base_radius_m": 20, "height_m": 40},
        {"kind": "radar", "name": "radar", "center": at(300, 500, agl=10), "radius_m": 20, "hard": False},
        {"kind": "marine", "name": "marine", "center": at(400, 500, 100), "radius_m": 20},
        {"kind": "no_fly", "name": "zone", "polygon": [at(480, 480), at(520, 480), at(520, 520), at(480, 520)],
         "top_alt_amsl_m": 150, "floor_alt_amsl_m": 120},
        {"kind": "cable", "name": "cable", "start": at(580, 500, 120), "end": at(620, 500, agl=20), "radius_m": 1},
    ]  # fmt: skip
    scene = scene_of(question(obstacles=obstacles))
    assert scene.obstacles.names == ("mast", "cone", "radar", "marine", "zone", "cable")
    for i, top in enumerate((130, 140, 130, 120, 150, 121)):
        x = 100 * (i + 1)
        above = scene.obstacles.distance_m([[x, 500.0, top + 3.0]])[0, i]
        assert above == pytest.approx(3.0)
    assert scene.obstacles.arrays.hard.tolist() == [True, True, False, True, True, True]
    assert scene.obstacles.distance_m([[500.0, 500.0, 118.0]])[0, 4] == pytest.approx(2.0)


def test_tops_above_ground_count_from_the_highest_ground_of_the_footprint(tmp_path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0)
    zone = [at(0, 0), at(400, 0), at(400, 400), at(0, 400)]
    data = question(
        terrain={"kind": "raster", "file": "hill.tif"},
        obstacles=[{"kind": "no_fly", "name": "zone", "polygon": zone, "top_height_agl_m": 50}],
        vehicles=[{"name": "a", "home": at(-500, 0), "goal": at(-500, 300, agl=50)}],
    )
    x, y = np.meshgrid(np.linspace(0, 400, 401), np.linspace(0, 400, 401))
    top = scene_of(data, tmp_path).obstacles.arrays.params[0, 1]
    assert top == pytest.approx(hill(x, y).max() + 50, abs=0.5)


def test_the_fence_and_its_top_become_the_space() -> None:
    scene = scene_of(question(fence={"polygon": SQUARE, "top_alt_amsl_m": 220}))
    assert scene.area_m == (-100, -200, 700, 300)
    assert scene.space.fence.shape == (4, 2)
    assert scene.space.fence_top_amsl_m == 220
    scene = scene_of(question(fence={"polygon": SQUARE, "top_height_agl_m": 90}))
    assert scene.space.fence_top_amsl_m == math.inf
    assert [task.limits.height_agl_max_m for task in scene.tasks] == [90, 90]


def test_the_area_holds_everything_with_room_around() -> None:
    assert scene_of(question()).area_m == (-300, -300, 800, 360)
    far = [{**MAST, "center": at(0, -3000), "radius_m": 50}]
    assert scene_of(question(obstacles=far)).area_m == pytest.approx((-50 - 622, -3050 - 622, 500 + 622, 60 + 622))
    area = {"south_west": at(-100, -200), "north_east": at(900, 400)}
    assert scene_of(question(area=area)).area_m == (-100, -200, 900, 400)


def test_the_area_ends_with_the_terrain(tmp_path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32612", 10.0, room=-300.0)
    data = question(terrain={"kind": "raster", "file": "hill.tif"})
    steep = {"safety": {"landing_slope_max_deg": 20}}
    data["vehicles"] = [{"name": "a", "home": at(-300, 0), "goal": at(300, 0, agl=50), **steep}]
    data["obstacles"] = [{**MAST, "center": at(0, 5000), "radius_m": 50}]
    scene = scene_of(data, tmp_path)
    west, south, east, north = scene.area_m
    assert -2500 < west < -900
    assert 1000 < north < 2500
    x, y = np.meshgrid(np.linspace(west, east, 100), np.linspace(south, north, 100))
    reached = scene.terrain.reaches(x, y)
    assert reached.mean() > 0.8
    assert reached[:, 1:-1].any(axis=0).all()
    assert reached[1:-1].any(axis=1).all()


# --- wrong starts, stops and goals


@pytest.mark.parametrize(
    ("vehicle", "problem"),
    [
        ({"start": at(0, 0, 90)}, "vehicles[0].start (v0): expected at least 25.0 m above the ground (safety.terrain_m "
         "and the radius of its tube), got 10.0 m below it (ground 100.0 m, altitude 90.0 m AMSL): raise it by 35.0 m"),
        ({"start": at(0, 0, 124)}, "got 24.0 m (ground 100.0 m, altitude 124.0 m AMSL): raise it by 1.0 m"),
        ({"goal": at(500, 0, agl=-5)}, "vehicles[0].goal (v0): expected at least 25.0 m above the ground"),
        ({"stops": [at(9, 9, agl=50), at(300, 9, agl=5)]}, "vehicles[0].stops[1] (v0): expected at least 25.0 m above"),
        ({"takeoff_height_m": 10}, "vehicles[0].home (v0), top of the take-off: expected at least 25.0 m above the"),
        ({"height_agl_max_m": 40}, "vehicles[0].goal (v0): expected at most 35.0 m above the ground (upper limit less"),
        ({"alt_amsl_max_m": 140}, "vehicles[0].goal (v0): expected at most 135.0 m AMSL (upper limit less the radius "),
        ({"goal": at(200, 0, 150)}, "vehicles[0].goal (v0): expected at least 15.0 m from obstacle mast (safety."),
        ({"goal": at(200, 0, 150)}, "got 5.0 m inside it: move it 20.0 m away"),
        ({"start": at(190, 0, 150)}, "vehicles[0].start (v0): expected at least 15.0 m from obstacle mast (safety.obs"),
        ({"start": at(190, 0, 150)}, "got 5.0 m: move it 10.0 m away"),
        ({"stops": [at(200, 0, 150)]}, "vehicles[0].stops[0] (v0): expected at least 15.0 m from obstacle mast"),
        ({"home": at(203, 0), "goal": at(400, 0, agl=30)}, "vehicles[0].home (v0), top of the take-off: expected at "),
        ({"goal": at(500, 0, 150), "home": at(500, 0), "start": at(500, 0, 150.5)},
         "vehicles[0].goal (v0): expected a place at least 1.0 m from the one before it, "
         "got that of vehicles[0].start (v0): remove one"),
        ({"goal": at(1e6, 0, 150)}, "vehicles[0].goal (v0): expected a place within 100 km of the origin, got one 10"),
        ({"home": {"lat_deg": -34.35, "lon_deg": -118.2}}, "vehicles[0].home (v0): expected a place within 100 km"),
    ],
)  # fmt: skip
def test_places_that_cannot_be_flown_to_are_named(vehicle: dict[str, Any], problem: str) -> None:
    assert problem in problem_of(flying(vehicle, obstacles=[MAST]))


def test_the_climb_and_the_descent_must_be_clear_too() -> None:
    cable = {"kind": "cable", "name": "wire", "start": at(-50, 0, 115), "end": at(50, 0, 115)}
    problem = problem_of(flying({"takeoff_height_m": 60}, obstacles=[cable]))
    assert problem.startswith(
        "vehicles[0].home (v0), top of the take-off, the climb to it from home: expected at least 15"
    )
    cable = {"kind": "cable", "name": "wire", "start": at(450, 0, 115), "end": at(550, 0, 115)}
    problem = problem_of(flying({}, obstacles=[cable]))
    assert problem.startswith(
        "vehicles[0].goal (v0), the descent to the ground: expected at least 15.0 m from obstacle w"
    )
    scene_of(flying({"end": "rtl"}, obstacles=[cable]))


def test_a_soft_zone_may_be_entered() -> None:
    zone = {"kind": "radar", "name": "radar", "center": at(500, 0, 150), "radius_m": 100}
    assert "from obstacle radar" in problem_of(flying({}, obstacles=[zone]))
    scene_of(flying({}, obstacles=[{**zone, "hard": False}]))


def test_places_outside_the_fence_or_the_area_are_named() -> None:
    fence = {"polygon": SQUARE}
    problem = problem_of(flying({"goal": at(710, 0, 150)}, fence=fence))
    assert "vehicles[0].goal (v0): expected at least 15.0 m inside the fence" in problem
    assert "got 10.0 m outside: move it, or widen the fence" in problem
    assert "got 8.0 m: move it" in problem_of(flying({"stops": [at(600, 292, 150)]}, fence=fence))
    assert "vehicles[0].home (v0)" in problem_of(flying({"home": at(-95, 0)}, fence=fence))
    assert "inside the fence" in problem_of(flying({"goal": at(500, 0, 199)}, fence={**fence, "top_alt_amsl_m": 200}))
    area = {"south_west": at(-100, -200), "north_east": at(450, 400)}
    assert "vehicles[0].goal (v0): expected at least 15.0 m inside the area" in problem_of(flying({}, area=area))
    area = {"south_west": at(900, -200), "north_east": at(-100, 400)}
    assert problem_of(flying({}, area=area)).startswith("area: expected south_west to lie south and west of north_east")


def test_polygons_must_be_simple() -> None:
    bow = [at(100, 100), at(200, 200), at(200, 100), at(100, 200)]
    zone = {"kind": "no_fly", "name": "bow", "polygon": bow}
    assert "obstacle bow: expected a polygon whose edges do not cross" in problem_of(question(obstacles=[zone]))
    assert "fence.polygon: expected a polygon whose edges do not cross" in problem_of(question(fence={"polygon": bow}))
    zone = {**zone, "polygon": SQUARE[:3], "floor_alt_amsl_m": 200, "top_alt_amsl_m": 150}
    assert "obstacle bow: expected top above its floor" in problem_of(question(obstacles=[zone]))


def test_a_stand_off_below_the_margins_is_told_with_its_tower() -> None:
    data = flying(
        {"inspects": {"first": "T1", "last": "T2"}},
        inspection={"towers": [{"name": "T1", **at(100, 100)}, {"name": "T2", **at(250, 100)}], "standoff_m": 15},
    )
    assert problem_of(data).startswith(
        "inspection.towers[0] (T1), stop of vehicles[0] (v0): expected at least 15.0 m from obstacle span T1-T2"
    )


# --- two vehicles


@pytest.mark.parametrize(
    ("first", "second", "problem"),
    [
        ({}, {"goal": at(500, 90, 150)}, "vehicles[1].home (v1): expected at least 26 m from the home of "
         "vehicles[0] (v0) (fleet.separation_m and both vehicles' errors), got the same place: move one of them"),
        ({}, {"home": at(0, 15), "goal": at(500, 90, 150)}, "vehicles[1].home (v1): expected at least 26 m from the "
         "home of vehicles[0] (v0) (fleet.separation_m and both vehicles' errors), got 15.0 m"),
        ({"start": at(60, 0, 150)}, {"home": at(0, 90), "start": at(60, 0, 150), "goal": at(500, 90, 150)},
         "vehicles[1].start (v1): expected at least 0.01 m from the start of vehicles[0] (v0) (fleet.separation_m "),
        ({}, {"home": at(0, 90)}, "vehicles[1].goal (v1): expected at least 26 m from the goal of vehicles[0] (v0)"),
        ({}, {"home": at(0, 90), "goal": at(510, 0, 190)}, "vehicles[1].goal (v1): expected at least 26 m from the g"),
        ({"end": "rtl"}, {"end": "rtl", "home": at(0, 90)}, "vehicles[1].goal (v1): expected at least 26 m from the "),
    ],
)  # fmt: skip
def test_two_vehicles_need_two_places(first: dict[str, Any], second: dict[str, Any], problem: str) -> None:
    assert problem in problem_of(flying(first, second))


def test_vehicles_that_never_meet_may_share_a_goal() -> None:
    alone = {"arrive_together": False}
    scene_of(flying({"end": "rtl"}, {"end": "rtl", "home": at(0, 90)}, fleet=alone))
    assert "goal" in problem_of(flying({"end": "land"}, {"end": "land", "home": at(0, 90)}, fleet=alone))
    assert "goal" in problem_of(flying({"end": "loiter"}, {"end": "loiter", "home": at(0, 90)}, fleet=alone))
    stacked = {"end": "loiter", "home": at(0, 90), "goal": at(500, 0, 180)}
    scene_of(flying({"end": "loiter"}, stacked))


def test_even_without_separation_no_two_homes_are_one() -> None:
    both = ({}, {"goal": at(500, 90, 150)})
    assert "the same place" in problem_of(flying(*both, fleet={"separation_m": 0}))
    scene_of(flying({}, {"home": at(0, 6.1), "goal": at(500, 90, 150)}, fleet={"separation_m": 0}))
    too_near = ({}, {"home": at(0, 5.9), "goal": at(500, 90, 150)})  # each may be 3 m off
    assert "expected at least 6 m" in problem_of(flying(*too_near, fleet={"separation_m": 0}))


# --- wrong terrain


def on_the_hill(vehicle: dict[str, Any] | None = None, **terrain: Any) -> dict[str, Any]:
    data = question(terrain={"kind": "raster", "file": "hill.tif", **terrain})
    data["vehicles"] = [{"name": "a", "home": at(-500, 0), "goal": at(500, 0, agl=60), **(vehicle or {})}]
    return data


@pytest.mark.parametrize(("crs", "cell"), [("EPSG:32611", 10.0), ("EPSG:4326", 1 / 10800), ("EPSG:2229", 33.0)])
def test_terrain_of_any_coordinate_system_gives_the_same_scene(tmp_path: Path, crs: str, cell: float) -> None:
    hill_in(tmp_path / "hill.tif", crs, cell)
    (task,) = scene_of(on_the_hill(), tmp_path).tasks
    assert task.home_m.tolist() == pytest.approx([-500, 0, hill(-500, 0)], abs=0.01)
    assert task.route_m[-1].tolist() == pytest.approx([500, 0, hill(500, 0) + 60], abs=0.01)


def test_a_terrain_file_that_is_missing_or_none_is_told(tmp_path: Path) -> None:
    assert "expected an elevation file (GeoTIFF, HGT), got no such file" in problem_of(on_the_hill(), tmp_path)
    (tmp_path / "hill.tif").write_text("hello")
    assert "expected an elevation file (GeoTIFF, HGT), got: " in problem_of(on_the_hill(), tmp_path)


def test_a_place_outside_the_terrain_is_told(tmp_path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0)
    problem = problem_of(on_the_hill({"goal": at(9000, 0, 900)}), tmp_path)
    assert problem.startswith(
        "vehicles[0].goal (a): expected a place within the terrain, got x 9000 m, y 0 m from the or"
    )
    assert "vehicles[0].home (a)" in problem_of(on_the_hill({"home": at(-9000, 0)}), tmp_path)
    assert "vehicles[0].stops[0] (a)" in problem_of(on_the_hill({"stops": [at(0, 9000, agl=50)]}), tmp_path)
    data = {**on_the_hill(), "origin": {"lat_deg": 0, "lon_deg": 0}}
    assert "hill.tif: expected terrain below the mission" in problem_of(data, tmp_path)


def test_voids_below_places_and_along_the_way_are_told(tmp_path: Path) -> None:
    def punch(at_x: float) -> None:
        def change(heights: npt.NDArray[Any]) -> npt.NDArray[Any]:
            middle = heights.shape[0] // 2
            column = middle + round((at_x - 0.5 * (AREA[0] + AREA[2])) / 10)
            heights[:, column - 5 : column + 5] = -9999
            return heights

        hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0, change=change, nodata=-9999)

    punch(0.0)
    problem = problem_of(on_the_hill(), tmp_path)
    assert problem.startswith("vehicles[0].goal (a): expected heights along the way to it, got voids of hill.tif")
    assert "for 1" in problem
    assert "fill them" in problem
    punch(500.0)
    assert "vehicles[0].goal (a): expected a height below it, got a void of hill.tif" in problem_of(
        on_the_hill(), tmp_path
    )
    punch(-500.0)
    assert "vehicles[0].home (a): expected a height below it, got a void of hill.tif" in problem_of(
        on_the_hill(), tmp_path
    )
    punch(900.0)
    scene_of(on_the_hill(), tmp_path)


def test_the_terrain_models_error_widens_the_margin(tmp_path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0)
    (task,) = scene_of(on_the_hill(vertical_error_m=7), tmp_path).tasks
    assert task.limits.terrain_margin_m == 27
    assert task.route_m[0, 2] - task.home_m[2] == pytest.approx(42)
    problem = problem_of(on_the_hill({"goal": at(500, 0, agl=25)}, vertical_error_m=7), tmp_path)
    assert "expected at least 32.0 m above the ground" in problem


def test_a_planes_climb_out_must_outrun_the_ground(tmp_path: Path) -> None:
    heights = np.full((300, 300), 100.0, dtype=np.float32)
    heights[:, 160:168] = 118.0
    from rasterio.transform import Affine  # noqa: PLC0415

    lat, lon, _ = FRAME.to_geo(np.zeros(3))
    cell = 1 / 10800
    write_tif(
        tmp_path / "hill.tif", heights, Affine(cell, 0, lon - 150 * cell, 0, -cell, lat + 150 * cell), "EPSG:4326"
    )
    plane = {"class": "plane", "home": at(0, 0), "goal": at(600, 0, agl=80), "takeoff_height_m": 60}
    problem = problem_of(on_the_hill(plane), tmp_path)
    assert "top of the take-off, the climb to it from home: expected the ground to fall behind" in problem
    strong = {"angle_max_deg": 45, "rate_m_s": 10}
    scene_of(on_the_hill({**plane, "climb": strong, "home": at(-80, 0)}), tmp_path)
    problem = problem_of(on_the_hill({**plane, "climb": {**strong, "rate_m_s": 5}, "home": at(-80, 0)}), tmp_path)
    assert "expected the ground to fall behind" in problem


def test_homes_and_landing_places_are_on_ground_to_land_on(tmp_path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0)
    # the hill is 19.3 degrees steep at its middle, 10.1 at its sides, where the vehicles of other tests stand
    problem = problem_of(on_the_hill({"home": at(0, 0)}), tmp_path)
    assert problem.startswith("vehicles[0].home (a): expected ground of at most 15 degrees to land on (safety.landing")
    assert "got up to 19." in problem
    lands = {"goal": at(0, 0, agl=60)}
    assert problem_of(on_the_hill(lands), tmp_path).startswith("vehicles[0].goal (a): expected ground of at most 15 d")
    for elsewhere in ("rtl", "loiter"):
        scene_of(on_the_hill({**lands, "end": elsewhere}), tmp_path)
    scene_of(on_the_hill({**lands, "safety": {"landing_slope_max_deg": 20}}), tmp_path)
    assert "at most 10 degrees" in problem_of(on_the_hill({"safety": {"landing_slope_max_deg": 10}}), tmp_path)
    plane = {"class": "plane", "home": at(0, 0), "goal": at(-700, 0, agl=90)}
    assert "vehicles[0].home (a): expected ground of at most 15" in problem_of(on_the_hill(plane), tmp_path)


# --- judging flights that were not planned here


def test_a_scene_for_checking_has_the_vehicles_limits_and_homes_but_no_routes() -> None:
    # a start below the ground and a goal in an obstacle: they are not what is judged
    data = flying({"start": at(0, 0, 90), "goal": at(200, 0, 150), "tracking_error_m": 4}, obstacles=[MAST])
    with pytest.raises(MissionError):
        scene_of(data)
    places_deg = [(FRAME.origin_lat_deg, FRAME.origin_lon_deg + 0.05)]
    scene = build_check_scene(Mission.model_validate(data), Path(), places_deg)
    (task,) = scene.tasks
    assert (task.name, task.sysid, task.end, task.route_m.shape) == ("v0", 1, "land", (0, 3))
    assert task.home_m.tolist() == pytest.approx([0, 0, 100])
    assert (task.limits.tracking_error_m, task.limits.tube_m) == (4, 7)
    assert scene.obstacles.names == ("mast",)
    # what is judged lies within the area
    x, y, _ = scene.frame.to_local(*places_deg[0], 0.0)
    west, south, east, north = scene.area_m
    assert west < x < east
    assert south < y < north
    with pytest.raises(MissionError, match="expected a place within 100 km of the origin"):
        build_check_scene(Mission.model_validate(data), Path(), [(0.0, 0.0)])


def test_how_far_a_vehicle_may_be_from_its_predicted_flight() -> None:
    copter, px4, plane = scene_of(
        flying(
            {"tracking_error_m": 1.5, "position_error_m": 0.5},
            {"autopilot": "px4", "home": at(0, 50), "goal": at(500, 50, 150)},
            {"class": "plane", "home": at(0, 150), "goal": at(500, 200, 160)},
        )
    ).tasks
    assert copter.off_prediction_m == 2.0  # the corners it cuts are predicted
    assert px4.off_prediction_m == 3.0
    assert plane.off_prediction_m == 2.0 + 1.0 + 10.0


# --- the whole as input of a plan


def test_a_mission_is_the_same_wherever_it_is_kept(tmp_path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32612", 10.0)
    data = {**on_the_hill(), "defaults": {"tracking_error_m": 1.5, "endurance_s": 600}}
    data["vehicles"][0]["endurance_s"] = None
    scene = scene_of(data, tmp_path)
    folder = tmp_path / "plan"
    write_raster(folder / TERRAIN_NAME, scene.terrain)
    for dump in (
        portable_mission(scene).model_dump(mode="json", by_alias=True, exclude_unset=True),
        portable_mission(scene).model_dump(mode="json", by_alias=True),
    ):
        again = build_scene(parse_mission(json.dumps(dump), "plan.json"), folder)
        assert again.input_sha256 == scene.input_sha256
        assert again.area_m == scene.area_m
        assert again.tasks[0].limits == scene.tasks[0].limits
        assert np.array_equal(again.tasks[0].route_m, scene.tasks[0].route_m)
        assert np.array_equal(again.terrain.arrays.to_cell, scene.terrain.arrays.to_cell)


def test_the_hash_tells_missions_and_terrains_apart(tmp_path: Path) -> None:
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0)
    first = scene_of(on_the_hill(), tmp_path).input_sha256
    assert scene_of(on_the_hill(), tmp_path).input_sha256 == first
    assert scene_of(on_the_hill({"goal": at(500, 0, agl=60.001)}), tmp_path).input_sha256 != first
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0, change=lambda h: h + np.float32(0.01))
    assert scene_of(on_the_hill(), tmp_path).input_sha256 != first
    hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0, room=410.0)
    assert scene_of(on_the_hill(), tmp_path).input_sha256 != first


def test_the_space_is_what_the_kernels_take() -> None:
    scene = scene_of(question(obstacles=[MAST]))
    legs = np.array([[[0.0, 0.0, 150.0], [500.0, 0.0, 150.0]]])
    row = kernels.legs_clearance(scene.space, legs, 1.0)[0]
    assert row[kernels.OBSTACLE] == pytest.approx(-5.0, abs=0.01)
    assert row[kernels.HEIGHT_MIN] == pytest.approx(50.0)


def test_peaks_stand_where_the_mission_says() -> None:
    peaks = [{"x_m": 500, "y_m": 0, "height_m": 80, "spread_m": 200}]
    scene = scene_of(question(terrain={"kind": "peaks", "base_alt_amsl_m": 10, "cell_m": 5, "peaks": peaks}))
    assert scene.tasks[1].route_m[-1, 2] == pytest.approx(10 + 80 * math.exp(-((60 / 200) ** 2)) + 40, abs=0.01)
    assert portable_mission(scene).terrain == scene.mission.terrain
    far = [{**peaks[0], "x_m": 1e7}]
    assert "terrain.peaks[0]: expected a place within" in problem_of(question(terrain={"kind": "peaks", "peaks": far}))


def test_an_obstacle_below_the_ground_is_a_height_in_the_wrong_datum() -> None:
    buried = {"kind": "cylinder", "name": "mast", "center": at(300, 200), "radius_m": 5, "top_alt_amsl_m": 60}
    problem = problem_of(question(obstacles=[buried]))
    assert "(mast)" in problem
    assert "expected top_alt_amsl_m above the ground there (100.0 m AMSL), got 60" in problem
    assert "top_height_agl_m" in problem
