"""Mission files from maps: what is inspected, what stands in the way, where vehicles start; and that they load."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pyproj import CRS
from rasterio.transform import Affine

from missionplanner.errors import MissionError
from missionplanner.geodesy import LocalFrame
from missionplanner.line_map import read_line_map
from missionplanner.line_mission import NO_TERRAIN, ImportedMission, Wishes, assumed_of, imported_mission
from missionplanner.map_tags import MapFeature
from missionplanner.mission import Cylinder, FlatTerrain, Inspection, Mission, NoFly, OverheadLine, parse_mission
from missionplanner.scene import build_check_scene
from tests.rasters import write_tif

FRAME = LocalFrame(47.0, 9.5)
XY = tuple[float, float]


def places(xy_m: Sequence[XY]) -> np.ndarray:
    lat, lon, _ = FRAME.to_geo(np.column_stack([np.array(xy_m), np.zeros(len(xy_m))]))
    return np.stack([lat, lon], axis=1)


def line(*xy_m: XY, **tags: str) -> MapFeature:
    return MapFeature("line", places(xy_m), tags, "map, line")


def point(x: float, y: float, **tags: str) -> MapFeature:
    spelled = {name.replace("__", ":"): text for name, text in tags.items()}
    return MapFeature("point", places([(x, y)]), spelled, f"map, point at {x:g}, {y:g}")


MAIN = line(*((x, 0.0) for x in range(0, 2001, 250)), ref="161", voltage="110000")  # nine towers
SMALL = line((900, -600), (900, -300), (900, 300), (900, 600), ref="7", voltage="20000")


def made_of(*features: MapFeature, **wishes: Any) -> tuple[ImportedMission, Mission, Inspection]:
    asked = Wishes(**{"name": "imported", "as_of": "2026-01-01", **wishes})
    made = imported_mission(read_line_map(features), asked, ["map"], [])
    mission = parse_mission(made.text, "imported.yaml")
    assert mission.inspection is not None
    return made, mission, mission.inspection


def lines_of(mission: Mission) -> dict[str, OverheadLine]:
    return {o.name: o for o in mission.obstacles if isinstance(o, OverheadLine)}


def cylinders_of(mission: Mission) -> dict[str, Cylinder]:
    return {o.name: o for o in mission.obstacles if isinstance(o, Cylinder)}


def area_deg(west: float, south: float, east: float, north: float) -> tuple[float, float, float, float]:
    (south_deg, west_deg), (north_deg, east_deg) = places([(west, south), (east, north)]).tolist()
    return south_deg, west_deg, north_deg, east_deg


def ground(path: Path, slope: float = 0.0, west: float = -3000.0, east: float = 5000.0) -> Path:
    """Write a plane that rises eastwards, on the test's own frame."""
    cell = 25.0
    cols, rows = int((east - west) / cell), 240
    x = west + cell * (np.arange(cols) + 0.5)
    heights = np.broadcast_to(500.0 + slope * (x - west), (rows, cols)).astype(np.float32)
    return write_tif(path, heights, Affine(cell, 0, west, 0, -cell, 3000.0), FRAME.crs.to_wkt())


# --- what is inspected


def test_the_highest_voltage_is_inspected_and_the_rest_stands_in_the_way() -> None:
    made, mission, inspection = made_of(MAIN, SMALL)
    assert [(name, towers) for name, towers, _ in made.lines] == [("161", 9)]
    assert len(inspection.towers) == 9
    assert set(lines_of(mission)) == {"7"}
    assert inspection.assignment is not None
    assert all(vehicle.goal is None and vehicle.home is not None for vehicle in mission.vehicles)


@pytest.mark.parametrize(
    ("asked", "inspected"),
    [
        (("20kV",), {"7"}),
        (("20 kV",), {"7"}),
        (("110kV",), {"161"}),
        (("161", "7"), {"161", "7"}),
        (("162",), {"162-163"}),
        (("Nord - Ost",), {"162-163"}),
        (("nord",), {"162-163"}),
    ],
)
def test_lines_are_chosen_by_voltage_ref_or_name(asked: tuple[str, ...], inspected: set[str]) -> None:
    third = line((0, 900), (300, 900), ref="162;163", name="Nord - Ost", voltage="60000")
    made, _, _ = made_of(MAIN, SMALL, third, lines=asked)
    assert {name for name, _, _ in made.lines} == inspected


def test_a_line_that_is_not_there_is_told_with_those_that_are() -> None:
    with pytest.raises(MissionError, match=r"--line: expected one of line 161, 110 kV \(map, line\); line 7, .*'162'"):
        made_of(MAIN, SMALL, lines=("162",))


def test_without_voltages_minor_lines_are_obstacles() -> None:
    minor = line((900, -300), (900, 300), power="minor_line")
    made, mission, inspection = made_of(line((0, 0), (250, 0), (500, 0), power="line"), minor)
    assert len(made.lines) == 1
    assert inspection.safety_distance_m == 5  # as of an unknown voltage
    assert set(lines_of(mission)) == {"minor-line"}


def test_an_area_cuts_lines_and_keeps_the_towers_just_outside_as_obstacles() -> None:
    made, mission, inspection = made_of(MAIN, area_deg=area_deg(700, -200, 1300, 200))
    looked_at = {t.name: t.views for t in inspection.towers}
    assert looked_at == {"161-01": "none", "161-02": None, "161-03": None, "161-04": None, "161-05": "none"}
    assert made.towers == 3
    beyond = lines_of(mission)
    assert {len(o.supports) for o in beyond.values()} == {3}  # on both sides, from the outer tower to the line's end
    assert len(beyond) == 2


def test_a_line_that_leaves_the_area_and_comes_back_is_told_in_parts() -> None:
    bow = line((0, 0), (250, 0), (400, 500), (650, 500), (800, 0), (1050, 0), ref="b", voltage="110000")
    made, _, _ = made_of(bow, area_deg=area_deg(-100, -100, 2000, 100))
    assert [(name, towers) for name, towers, _ in made.lines] == [("b", 3), ("b-2", 3)]


@pytest.mark.parametrize(
    ("area", "words"),
    [
        (area_deg(5000, 5000, 9000, 9000), "give --area"),
        ((9.4, 46.9, 9.6, 47.1), "the wrong way round"),
    ],
)
def test_nothing_in_the_area_says_what_lies_where(area: tuple[float, float, float, float], words: str) -> None:
    with pytest.raises(MissionError, match=f"expected something to inspect there, got 1 lines all at.*{words}"):
        made_of(MAIN, area_deg=area)


def test_a_drawing_without_towers_is_refused_with_what_to_do() -> None:
    with pytest.raises(MissionError, match=r"line far .*: a line without towers: .*3 vertices 2000 m apart.*--line"):
        made_of(line((0, 0), (2000, 0), (4000, 0), name="far"))


def test_two_towers_are_needed() -> None:
    with pytest.raises(MissionError, match="expected a power line or two towers, got 1 towers"):
        made_of(point(0, 0, name="T1"))


def test_lines_all_over_the_country_are_refused() -> None:
    far = line((300_000, 0), (300_250, 0), voltage="110000")
    with pytest.raises(MissionError, match=r"within 100 km of their middle.*give --area or --line"):
        made_of(MAIN, far)


# --- what is assumed


@pytest.mark.parametrize(
    ("kv", "safety_m"),
    [
        (0.4, 1),
        (1, 1),
        (20, 3),
        (110, 3),
        (123, 4),
        (132, 4),
        (220, 4),
        (380, 5),
        (400, 5),
        (500, 8),
        (750, 11),
        (765, 14),
        (1100, 20),
    ],
)
def test_distances_follow_the_voltage(kv: float, safety_m: float) -> None:
    assert assumed_of(kv).safety_m == safety_m
    assert assumed_of(None).safety_m == 5


@pytest.mark.parametrize("kv", [None, 20, 110, 220, 380, 765, 1100])
def test_views_leave_room_for_conductors_and_all_margins(kv: float | None) -> None:
    tags = {} if kv is None else {"voltage": f"{kv} kV"}
    _, mission, inspection = made_of(line((0, 0), (250, 0), (500, 0), **tags))
    safety = mission.vehicles[0].safety
    assert safety.obstacle_m >= (inspection.safety_distance_m or math.inf)
    assert inspection.views.distance_m >= inspection.conductor_radius_m + safety.obstacle_m + 5.0
    assert inspection.views.distance_m >= inspection.tower_radius_m + safety.obstacle_m + 5.0


def test_heights_are_kept_where_known_and_else_assumed_and_marked() -> None:
    towers = [point(0, 0, height="41"), point(250, 0), point(500, 0, last_inspected="04.05.2024")]
    _, _, inspection = made_of(*towers)
    told = {t.height_m: t.assumed for t in inspection.towers}
    assert told == {41.0: (), 35.0: ("height_m",)}
    assert inspection.as_of == "2026-01-01"
    assert [t.last_inspected for t in inspection.towers].count("2024-05-04") == 1
    _, _, inspection = made_of(*towers, tower_height_m=28.0)
    assert {t.height_m for t in inspection.towers} == {41.0, 28.0}


def test_an_inspection_after_today_is_refused() -> None:
    with pytest.raises(MissionError, match=r"map, point at 0, 0: .* not after 2026-01-01 \(--as-of\), got 2026-05-04"):
        made_of(point(0, 0, inspected="2026-05-04"), point(250, 0))


def test_vertices_taken_for_towers_are_marked() -> None:
    _, _, inspection = made_of(MAIN, point(0, 0))
    assert [t.assumed for t in inspection.towers[:2]] == [("height_m",), ("height_m", "place")]


# --- what stands in the way


def test_masts_chimneys_and_turbines_are_cylinders_without_a_top_where_nobody_knows_it() -> None:
    _, mission, _ = made_of(
        MAIN,
        point(300, 500, man_made="chimney", height="80"),
        point(600, 500, man_made="mast", name="Sender Süd"),
        point(900, 500, man_made="mast", height="100"),
        point(1200, 500, man_made="mast", height="100", tower__construction="freestanding"),
        point(1500, 500, power="generator", generator__source="wind", height__hub="100", rotor__diameter="120"),
        point(1800, 500, power="generator", generator__source="wind"),
        point(1800, 9000, man_made="chimney"),  # far off
    )
    shown = {name: (c.radius_m, c.top_height_agl_m) for name, c in cylinders_of(mission).items()}
    assert shown == {
        "chimney": (10, 80),
        "Sender-Süd": (70, None),
        "mast": (70, 100),  # its guys
        "mast-2": (10, 100),
        "wind-turbine": (60, 160),
        "wind-turbine-2": (90, None),
    }


def test_an_aerialway_hangs_high_where_its_pylons_are_not_known() -> None:
    free = line((300, 800), (600, 800), (900, 800), aerialway="gondola", name="Bahn")
    _, mission, _ = made_of(MAIN, free)
    found = lines_of(mission)
    assert {name: len(o.supports) for name, o in found.items()} == {"Bahn": 3, "Bahn-straight": 2}
    pylon = point(600, 800, aerialway="pylon", height="22")
    _, mission, _ = made_of(MAIN, free, pylon)
    assert set(lines_of(mission)) == {"Bahn"}
    assert [s.height_agl_m for s in lines_of(mission)["Bahn"].supports] == [40, 22, 40]


def test_a_coarse_line_is_both_straight_and_on_the_hills_between() -> None:
    _, mission, _ = made_of(MAIN, line((-500, -900), (2500, -900), voltage="20000", ref="c"))
    found = lines_of(mission)
    assert set(found) == {"c", "c-straight"}
    assert len(found["c"].supports) == 13
    assert found["c"].assumed == ("height_agl_m", "place")


def test_a_pole_of_no_line_is_an_obstacle_and_is_told() -> None:
    made, mission, _ = made_of(MAIN, point(400, 400, power="pole", ref="x7"))
    assert cylinders_of(mission)["x7"].top_height_agl_m == 16
    assert any("1 tower on no line, so obstacles only (x7)" in note for note in made.notes)


def test_a_tower_is_as_high_as_its_highest_line_needs() -> None:
    above = line(*((x, 0.0) for x in range(0, 2001, 250)), ref="9", voltage="380000")
    _, mission, inspection = made_of(MAIN, above, lines=("110kV",))
    assert {t.height_m for t in inspection.towers} == {60}
    assert {s.height_agl_m for s in lines_of(mission)["9"].supports} == {60}
    assert inspection.safety_distance_m == 5  # the obstacle's, not 3
    assert isinstance(inspection.views.distance_m, float)
    assert inspection.views.distance_m >= 16 + 10  # beside the wider conductors


def test_what_towers_say_of_their_voltage_counts() -> None:
    towers = [point(x, 0, power="tower", voltage="380000") for x in (0, 250, 500)]
    _, _, inspection = made_of(line((0, 0), (250, 0), (500, 0), ref="A"), *towers)
    assert {t.height_m for t in inspection.towers} == {60}
    assert inspection.conductor_radius_m == 16


def test_the_distance_is_that_of_the_highest_line_around() -> None:
    _, mission, inspection = made_of(MAIN, line((0, 400), (400, 400), ref="9", voltage="765000"), lines=("161",))
    assert inspection.safety_distance_m == 14
    assert {v.safety.obstacle_m for v in mission.vehicles} == {14}


def test_a_given_height_is_the_least_of_other_lines_towers() -> None:
    _, mission, inspection = made_of(
        MAIN,
        SMALL,
        point(400, 500, power="pole", ref="x"),
        point(0, 0, power="tower", height="28"),
        tower_height_m=30.0,
    )
    assert {t.height_m for t in inspection.towers} == {28, 30}
    assert {s.height_agl_m for s in lines_of(mission)["7"].supports} == {30}
    assert cylinders_of(mission)["x"].top_height_agl_m == 30
    _, mission, _ = made_of(MAIN, SMALL, tower_height_m=10.0)
    assert {s.height_agl_m for s in lines_of(mission)["7"].supports} == {16}  # an obstacle is never less than assumed


def test_what_is_left_out_or_not_read_is_told() -> None:
    made, _, _ = made_of(MAIN, point(0, 900, type="Umspannwerk"), point(900, 900, name="T", hoehe_uebe="51"))
    assert any("1 of type=Umspannwerk" in note for note in made.notes)
    assert any("columns not read: hoehe_uebe" in note for note in made.notes)


@given(
    others=st.lists(
        st.lists(st.tuples(st.integers(-1800, 3800), st.integers(-1800, 1800)), min_size=2, max_size=5, unique=True),
        min_size=1,
        max_size=3,
    ),
    inner=st.integers(0, 1500),
)
@settings(max_examples=20)
def test_every_conductor_within_the_area_is_in_the_file(others: list[list[XY]], inner: int) -> None:
    """Held against shapely: what is drawn, clipped to the area, is covered by spans of obstacles and lines."""
    assume(all(math.dist(a, b) > 40 for xy in others for a, b in itertools.pairwise(xy)))  # else they are one tower
    drawn = [line(*xy, voltage="20000") for xy in others]
    _, mission, inspection = made_of(MAIN, *drawn, area_deg=area_deg(inner - 100, -100, inner + 700, 100))
    frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)

    def shape(at_deg: Sequence[tuple[float, float]]) -> Any:
        lat, lon = np.array(at_deg).T
        return shapely.linestrings(frame.to_local(lat, lon, 0.0)[:, :2])

    at = {t.name: (t.lat_deg or 0.0, t.lon_deg or 0.0) for t in inspection.towers}
    told = [shape([at[name] for name in run.towers]) for run in inspection.lines]
    told += [shape([(s.lat_deg or 0.0, s.lon_deg or 0.0) for s in o.supports]) for o in lines_of(mission).values()]
    assert mission.area is not None
    low, high = shape(
        [(c.lat_deg or 0.0, c.lon_deg or 0.0) for c in (mission.area.south_west, mission.area.north_east)]
    ).coords
    box = shapely.box(*low, *high)
    for feature in (MAIN, *drawn):
        rest = shape(feature.lat_lon_deg.tolist()).intersection(box).difference(shapely.union_all(told).buffer(15.0))
        assert rest.length < 0.1  # 15 m: vertices so close to a tower are that tower


# --- where vehicles start


@pytest.mark.parametrize("count", [1, 2, 6, 12])
def test_homes_are_apart_and_clear_of_everything(count: int) -> None:
    turbine = point(300, 90, power="generator", generator__source="wind", rotor__diameter="100")
    _, mission, _ = made_of(MAIN, SMALL, turbine, vehicles=count)
    frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
    homes = np.array([(v.home.lat_deg, v.home.lon_deg) for v in mission.vehicles if v.home])
    assert len(homes) == count
    at_m = frame.to_local(homes[:, 0], homes[:, 1], 0.0)[:, :2]
    apart_m = np.linalg.norm(at_m[:, None] - at_m, axis=-1) + 1e9 * np.eye(count)
    assert apart_m.min() > 39.9
    xy_m = np.array([FRAME.to_local(lat, lon, 0.0)[:2] for lat, lon in homes])
    solids = [
        shapely.LineString([(0, 0), (2000, 0)]).buffer(8),
        shapely.LineString([(900, -600), (900, 600)]).buffer(4),
    ]
    solids.append(shapely.Point(300, 90).buffer(50))
    assert min(shapely.Point(*xy).distance(solid) for xy in xy_m for solid in solids) > 44
    scene = build_check_scene(on_level_ground(mission), Path(), [])
    assert len(scene.tasks) == count


def on_level_ground(mission: Mission) -> Mission:
    return mission.model_copy(update={"terrain": FlatTerrain(kind="flat", alt_amsl_m=400.0)})


def test_many_vehicles_find_room_beside_a_short_line() -> None:
    assert len(made_of(line((0, 0), (250, 0)), vehicles=40)[1].vehicles) == 40


def test_given_homes_are_kept_and_the_others_stand_beside_them() -> None:
    given_deg = [tuple(p) for p in places([(100.0, 200.0), (1500.0, -200.0)]).tolist()]
    _, mission, _ = made_of(MAIN, homes_deg=tuple(given_deg), vehicles=5)
    homes = [(v.home.lat_deg, v.home.lon_deg) for v in mission.vehicles if v.home]
    assert np.abs(np.array(homes[:2]) - given_deg).max() < 1e-7
    xy_m = np.array([FRAME.to_local(lat or 0.0, lon or 0.0, 0.0)[:2] for lat, lon in homes])
    assert np.linalg.norm(xy_m[2:] - xy_m[[0, 1, 0]], axis=1).max() < 90


def test_homes_are_on_level_ground_or_refused(tmp_path: Path) -> None:
    made_of(MAIN, terrain=ground(tmp_path / "gentle.tif", slope=0.15))
    with pytest.raises(MissionError, match="--home: expected a level place"):
        made_of(MAIN, terrain=ground(tmp_path / "steep.tif", slope=0.4))


# --- terrain


def test_the_mission_names_its_terrain_and_loads_with_it(tmp_path: Path) -> None:
    path = ground(tmp_path / "ground.tif", slope=0.1)
    _, mission, inspection = made_of(MAIN, SMALL, terrain=path, terrain_as_written=Path("ground.tif"))
    scene = build_check_scene(mission, tmp_path, [])
    assert scene.towers is not None
    x = FRAME.to_local([t.lat_deg for t in inspection.towers], [t.lon_deg for t in inspection.towers], 0.0)[:, 0]
    np.testing.assert_allclose(scene.towers.top_m[:, 2], 500 + 0.1 * (x + 3000) + 35, atol=0.1)


def test_without_a_terrain_the_file_says_what_to_fill_in(tmp_path: Path) -> None:
    made, mission, _ = made_of(MAIN)
    assert any("terrain.file" in note for note in made.notes)
    with pytest.raises(MissionError, match=f"terrain.file: .*{NO_TERRAIN}"):
        build_check_scene(mission, tmp_path, [])


def test_towers_beyond_the_terrain_are_counted_and_named(tmp_path: Path) -> None:
    path = ground(tmp_path / "short.tif", east=1450.0)
    with pytest.raises(MissionError, match=r"got 3 of 9 outside of short.tif.*\(161-07, 161-08, 161-09\).*--area"):
        made_of(MAIN, terrain=path)
    made, mission, inspection = made_of(
        MAIN, terrain=path, terrain_as_written=path, area_deg=area_deg(-100, -100, 1300, 100)
    )
    assert made.towers == len(inspection.towers) == 6  # the one just outside has no ground: its span is cut off
    (beyond,) = lines_of(mission).values()
    assert beyond.assumed == ("height_agl_m", "place")
    build_check_scene(mission, tmp_path, [])


def test_other_lines_are_cut_off_where_the_terrain_ends_and_go_on_where_it_begins_again(tmp_path: Path) -> None:
    path = ground(tmp_path / "short.tif", east=1800.0)
    out_and_back = line((1100, 300), (1400, 300), (2100, 300), (2100, 600), (1400, 600), (1100, 600), voltage="20000")
    _, mission, _ = made_of(
        MAIN, out_and_back, terrain=path, terrain_as_written=path, area_deg=area_deg(-100, -100, 1300, 100)
    )
    minor = [o for o in lines_of(mission).values() if o.cable_radius_m == 4]
    assert [len(o.supports) for o in minor] == [3, 3]
    scene = build_check_scene(mission, tmp_path, [])  # all supports have ground
    for obstacle in minor:
        xy_m = [FRAME.to_local(s.lat_deg or 0.0, s.lon_deg or 0.0, 0.0)[:2] for s in obstacle.supports]
        east_m, height_m = max((xy[0], s.height_agl_m) for xy, s in zip(xy_m, obstacle.supports, strict=True))
        assert 1700 < east_m < 1800
        assert height_m == 16 + 20  # it may hang over a valley that nobody knows
    assert scene.obstacles.names


def with_hole(path: Path, west: float, south: float, east: float, north: float) -> Path:
    """Write flat ground at 500 m with a void."""
    cell = 25.0
    x, y = -3000.0 + cell * (np.arange(320) + 0.5), 3000.0 - cell * (np.arange(240) + 0.5)
    hole = ((x > west) & (x < east))[None] & ((y > south) & (y < north))[:, None]
    heights = np.where(hole, -9999.0, 500.0).astype(np.float32)
    return write_tif(path, heights, Affine(cell, 0, -3000, 0, -cell, 3000.0), FRAME.crs.to_wkt(), nodata=-9999.0)


def test_what_stands_over_a_void_of_the_terrain_has_no_upper_limit(tmp_path: Path) -> None:
    path = with_hole(tmp_path / "hole.tif", 800, 300, 1200, 700)
    made, mission, _ = made_of(
        MAIN,
        point(1000, 500, man_made="mast", height="40", name="over"),
        point(780, 500, man_made="mast", height="40", name="beside"),
        point(400, 500, man_made="mast", height="40", name="far"),
        point(1100, 600, power="tower", ref="lone"),
        terrain=path,
        terrain_as_written=path,
    )
    found = cylinders_of(mission)
    assert {name: o.top_height_agl_m for name, o in found.items()} == {
        "over": None,
        "beside": None,
        "far": 40,
        "lone": None,
    }
    assert any(re.match(r"3 obstacles without an upper limit.*\(lone, over, beside\)", note) for note in made.notes)
    build_check_scene(mission, tmp_path, [])


def test_masts_outside_of_the_area_that_reach_into_it_are_kept(tmp_path: Path) -> None:
    path = ground(tmp_path / "ground.tif")
    for terrain in (None, path):
        _, mission, _ = made_of(
            MAIN,
            point(3150, 0, man_made="mast", height="300", name="near"),  # 210 m around, 150 m beyond the border
            point(3250, 0, man_made="mast", height="300", name="away"),
            terrain=terrain,
            terrain_as_written=path,
        )
        assert set(cylinders_of(mission)) == {"near"}
    build_check_scene(mission, tmp_path, [])


def outlines_of(mission: Mission) -> list[Any]:
    return [
        shapely.Polygon([FRAME.to_local(p.lat_deg or 0.0, p.lon_deg or 0.0, 0.0)[:2] for p in o.polygon])
        for o in mission.obstacles
        if isinstance(o, NoFly) and o.top_height_agl_m is None and o.top_alt_amsl_m is None
    ]


@pytest.mark.parametrize(
    "way",
    [
        ((850, 500), (1150, 500)),  # all of it over the void
        ((400, 500), (1000, 500), (1600, 500)),  # a tower in it
        ((400, 500), (1000, 500)),  # an end in it
    ],
)
def test_other_lines_over_voids_are_kept(tmp_path: Path, way: tuple[XY, ...]) -> None:
    """Held against shapely: spans with known ends, and prisms without a top, cover the line with its width."""
    path = with_hole(tmp_path / "hole.tif", 800, 300, 1200, 700)
    _, mission, _ = made_of(
        MAIN, line(*way, voltage="20000", ref="7"), terrain=path, terrain_as_written=path, lines=("161",)
    )
    kept = [
        shapely.LineString([FRAME.to_local(s.lat_deg or 0.0, s.lon_deg or 0.0, 0.0)[:2] for s in o.supports]).buffer(4)
        for o in lines_of(mission).values()
    ]
    covered = shapely.union_all([*kept, *outlines_of(mission)]).buffer(0.05)
    assert outlines_of(mission)
    assert covered.covers(shapely.LineString(way).buffer(4, cap_style="flat"))
    build_check_scene(mission, tmp_path, [])


def test_a_line_just_outside_of_the_area_is_kept_where_its_width_reaches_in() -> None:
    _, mission, _ = made_of(MAIN, line((0, 1003), (400, 1003), voltage="20000", ref="7"), lines=("161",))
    assert set(lines_of(mission)) == {"7"}


def test_heights_above_the_ellipsoid_need_and_take_the_geoids(tmp_path: Path) -> None:
    crs = CRS.from_epsg(4979)  # latitude, longitude, ellipsoidal height
    (south, west), (north, east) = places([(-3000, -3000), (5000, 3000)]).tolist()
    heights = np.full((60, 80), 500.0, dtype=np.float32)
    transform = Affine((east - west) / 80, 0, west, 0, (south - north) / 60, north)
    path = write_tif(tmp_path / "ell.tif", heights, transform, crs.to_wkt())
    with pytest.raises(MissionError, match=r"ell.tif: .*above the ellipsoid: give --geoid-undulation,"):
        made_of(MAIN, terrain=path)
    _, mission, _ = made_of(MAIN, terrain=path, terrain_as_written=path, geoid_undulation_m=48.0)
    scene = build_check_scene(mission, tmp_path, [])
    assert scene.towers is not None
    np.testing.assert_allclose(scene.towers.top_m[:, 2], 500 - 48 + 35, atol=0.1)


def test_swapped_coordinates_are_found_out_by_the_terrain(tmp_path: Path) -> None:
    path = ground(tmp_path / "ground.tif")
    swapped = MapFeature("line", MAIN.lat_lon_deg[:, ::-1].copy(), MAIN.tags, "map, line")
    with pytest.raises(MissionError, match="are latitude and longitude the wrong way round in the map"):
        made_of(swapped, terrain=path)
    elsewhere = MapFeature("line", MAIN.lat_lon_deg + np.array([3.0, 0.0]), MAIN.tags, "map, line")
    with pytest.raises(MissionError) as refused:
        made_of(elsewhere, terrain=path)
    assert "wrong way round" not in str(refused.value)


# --- the file

TEXTS = st.text(min_size=1, max_size=60)


@given(name=TEXTS, labels=st.lists(TEXTS, min_size=3, max_size=3))
@settings(max_examples=25)
def test_whatever_a_map_calls_things_the_file_loads(name: str, labels: list[str]) -> None:
    towers = [point(250.0 * k, 0, name=label) for k, label in enumerate(labels)]
    row = line((0, 0), (250, 0), (500, 0), name=name, voltage="110")
    other = line((100, 300), (300, 300), name=name, voltage="20")
    made, mission, inspection = made_of(*towers, row, other, point(700, 700, man_made="mast", name=name))
    assert [tower.name for tower in inspection.towers] == list(inspection.lines[0].towers)
    assert len(mission.obstacles) == made.obstacles == 2


@pytest.mark.parametrize("label", ["yes", "null", "12", "1e3", "0x1F", "2024-05-04", "#7", "T1: a", "[a]", '"', "'"])
def test_names_that_yaml_could_take_for_something_else_stay_names(label: str) -> None:
    _, _, inspection = made_of(point(0, 0, name=label), point(250, 0, name="other"))
    assert {type(tower.name) for tower in inspection.towers} == {str}
    assert len(inspection.towers) == 2


def test_every_tower_has_a_line_of_its_own_with_its_name_first() -> None:
    made, _, inspection = made_of(MAIN, SMALL)
    for tower in inspection.towers:
        assert sum(f'- {{name: "{tower.name}", lat_deg' in row for row in made.text.splitlines()) == 1


def test_two_circuits_on_one_row_of_towers_are_two_lines_and_a_scene(tmp_path: Path) -> None:
    other = line(*((x, 4.0) for x in range(0, 1001, 250)), ref="162", voltage="110000")
    _, mission, inspection = made_of(MAIN, other)
    first, second = inspection.lines
    assert second.towers == first.towers[:5]
    assert len(inspection.towers) == 9
    build_check_scene(on_level_ground(mission), tmp_path, [])
