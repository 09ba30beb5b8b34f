"""``missionplanner import``: the example as it is written, real maps with their terrain, and what is refused."""

from __future__ import annotations

import json
import re
import shlex
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from missionplanner.geodesy import LocalFrame
from missionplanner.mission import Mission, Stop, load_mission
from missionplanner.scene import build_check_scene, build_scene
from tests import maps
from tests.command_line import Cli, expect_refusal

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "missions/liechtenstein"
DATA = ROOT.parent / "shared/data"
BAYREUTH = [DATA / "bayreuth_power_lines.geojson", DATA / "bayreuth_power_towers.geojson"]
TERRAIN = DATA / "bayreuth_srtm3_filled.tif"
needs_bayreuth = pytest.mark.skipif(not TERRAIN.exists(), reason="../shared/data is not here")

TOWERS = [(round(47.0 + 0.002 * k, 7), round(9.5 + 0.0004 * k, 7)) for k in range(6)]

FAR_APART = [(47.0, 9.5), (47.05, 9.5), (47.1, 9.5)]


def test_the_example_runs_as_its_readme_says(cli: Cli, tmp_path: Path) -> None:
    text = (EXAMPLE / "README.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^\.venv/bin/missionplanner (import .*)$", text, re.MULTILINE)
    (tmp_path / "missions").symlink_to(ROOT / "missions")
    outcome = cli(*shlex.split(command))
    assert outcome.code == 0, outcome.err
    mission = load_mission(tmp_path / "out/liechtenstein.yaml")
    assert mission.inspection is not None
    nodes = json.loads((EXAMPLE / "liechtenstein_power_lines.geojson").read_text())["features"][0]
    south, west, north, east = 47.06, 9.46, 47.20, 9.55
    within = [
        (lat, lon) for lon, lat, *_ in nodes["geometry"]["coordinates"] if south <= lat <= north and west <= lon <= east
    ]
    looked_at = [t for t in mission.inspection.towers if t.views != "none"]
    assert [(t.lat_deg, t.lon_deg) for t in looked_at] == within
    assert "OpenStreetMap contributors" in (tmp_path / "out/liechtenstein.yaml").read_text(encoding="utf-8")
    assert "220 kV" in outcome.out
    assert "note: heights of" in outcome.err


def test_the_example_is_not_planned_before_it_has_a_terrain(cli: Cli, tmp_path: Path) -> None:
    files = sorted(EXAMPLE.glob("*.geojson"))
    assert cli("import", *files, "-o", "m.yaml").code == 0
    expect_refusal(cli("validate", "m.yaml"), 2, "terrain.file", "FILL-IN-a-terrain-model.tif")


@needs_bayreuth
def test_a_real_network_with_its_terrain_makes_a_scene(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("import", *BAYREUTH, "--terrain", TERRAIN, "--vehicles", 6, "-o", "bayreuth.yaml", "--json")
    told = outcome.json
    assert [(line["name"], line["towers"], line["voltage_kv"]) for line in told["lines"]] == [
        ("161-162", 79, 110),
        ("135-138", 52, 110),
    ]
    mission = load_mission(tmp_path / "bayreuth.yaml")
    assert mission.inspection is not None
    drawn = [f for f in json.loads(BAYREUTH[0].read_text())["features"] if f["properties"].get("voltage") == "110000"]
    at = {t.name: (t.lat_deg, t.lon_deg) for t in mission.inspection.towers}
    for line, feature in zip(mission.inspection.lines, drawn, strict=True):
        assert [at[name] for name in line.towers] == [(lat, lon) for lon, lat, *_ in feature["geometry"]["coordinates"]]
    assert len(at) == 131
    scene = build_check_scene(mission, tmp_path, [])
    assert scene.towers is not None
    ground = scene.terrain.height_amsl_m(scene.towers.top_m[:, 0], scene.towers.top_m[:, 1])
    np.testing.assert_allclose(scene.towers.top_m[:, 2] - ground, 35.0)
    homes = np.array([task.home_m for task in scene.tasks])
    assert len(homes) == 6
    assert np.linalg.norm(homes[:, None] - homes, axis=-1)[~np.eye(6, dtype=bool)].min() > 1000  # all along the lines
    build_scene(with_a_hop(mission), tmp_path)  # homes are level, clear of everything, and apart
    assert len(mission.obstacles) == 20  # of 22 other lines: one is in the ground, two are pieces of one


def with_a_hop(mission: Mission) -> Mission:
    """Return the mission with one stop near home for each vehicle, instead of an open inspection."""
    vehicles = tuple(
        vehicle.model_copy(
            update={
                "stops": (
                    Stop(
                        lat_deg=(vehicle.home.lat_deg or 0.0) + 2e-4,
                        lon_deg=vehicle.home.lon_deg,
                        height_agl_m=90.0,
                    ),
                )
            }
        )
        for vehicle in mission.vehicles
        if vehicle.home is not None
    )
    assert mission.inspection is not None
    closed = mission.inspection.model_copy(update={"assignment": None})
    return mission.model_copy(update={"inspection": closed, "vehicles": vehicles})


@needs_bayreuth
def test_an_area_leaves_the_rest_of_a_real_network_standing(cli: Cli, tmp_path: Path) -> None:
    area = "50.00,11.48,50.06,11.62"
    outcome = cli("import", *BAYREUTH, "--terrain", TERRAIN, "--area", area, "-o", "part.yaml", "--json")
    assert outcome.code == 0, outcome.err
    mission = load_mission(tmp_path / "part.yaml")
    assert mission.inspection is not None
    views = [tower.views for tower in mission.inspection.towers]
    assert views.count("none") == 4
    assert {o.name for o in mission.obstacles} >= {"161-162-beyond", "135-138-beyond"}
    build_check_scene(mission, tmp_path, [])


@needs_bayreuth
def test_maps_and_terrain_that_do_not_belong_together_are_refused(cli: Cli) -> None:
    files = sorted(EXAMPLE.glob("*.geojson"))
    outcome = cli("import", *files, "--terrain", TERRAIN, "--area", "47.06,9.46,47.20,9.55", "-o", "m.yaml")
    expect_refusal(outcome, 2, "expected terrain below the mission", "47.", "49.9")


def test_a_mission_file_is_not_replaced_unasked(cli: Cli, tmp_path: Path) -> None:
    path = maps.geojson(tmp_path / "towers.geojson", TOWERS)
    assert cli("import", path, "-o", "m.yaml").code == 0
    (tmp_path / "m.yaml").write_text("edited by hand")
    expect_refusal(cli("import", path, "-o", "m.yaml", "--json"), 2, "m.yaml", "--overwrite")
    assert (tmp_path / "m.yaml").read_text() == "edited by hand"
    assert cli("import", path, "-o", "m.yaml", "--overwrite").code == 0
    assert load_mission(tmp_path / "m.yaml").name == "m"


def test_homes_and_the_day_are_taken_from_the_command_line(cli: Cli, tmp_path: Path) -> None:
    path = tmp_path / "towers.csv"
    path.write_text(
        "name,lat,lon,last_inspected\n" + "".join(f"T{k},{a},{b},2024\n" for k, (a, b) in enumerate(TOWERS))
    )
    homes = ["--home", "47.003,9.503", "--home", "47.007,9.505"]
    outcome = cli("import", path, *homes, "--as-of", "2026-05-04", "-o", "sub/m.yaml")
    assert outcome.code == 0, outcome.err
    mission = load_mission(tmp_path / "sub/m.yaml")
    assert [(v.home.lat_deg, v.home.lon_deg) for v in mission.vehicles if v.home] == [(47.003, 9.503), (47.007, 9.505)]
    assert mission.inspection is not None
    assert mission.inspection.as_of == "2026-05-04"
    assert {tower.last_inspected for tower in mission.inspection.towers} == {"2024-01-01"}


WRONG_OPTIONS = {
    "an area of three": (["--area", "47,9,48"], ["--area", "SOUTH,WEST,NORTH,EAST"]),
    "an area of words": (["--area", "a,b,c,d"], ["--area", "'a,b,c,d'"]),
    "an area upside down": (["--area", "48,9,47,10"], ["--area", "south below north"]),
    "a home of one number": (["--home", "47"], ["--home", "LAT,LON"]),
    "a home beyond the pole": (["--home", "97,9"], ["--home", "LAT,LON"]),
    "homes for nobody": (["--home", "47,9.5", "--home", "47.1,9.5", "--vehicles", "1"], ["--home", "1 vehicles", "2"]),
    "a day that is none": (["--as-of", "04.05.2026"], ["--as-of", "2026-05-04", "'04.05.2026'"]),
    "a system that is none": (["--crs", "EPSG:1"], ["--crs", "'EPSG:1'"]),
    "a line that is not there": (["--line", "foo"], ["--line", "line L1", "'foo'"]),
    "an area elsewhere": (["--area", "40,9,41,10"], ["--area", "47.0000 to 47.0100"]),
    "no such terrain": (["--terrain", "dem.tif"], ["terrain.file", "no such file", "dem.tif"]),
    "a home far off": (["--home", "60,9.5"], ["--home 60,9.5", "within 20 km of a tower"]),
}


@pytest.mark.parametrize("case", WRONG_OPTIONS)
def test_wrong_options_are_told_in_one_line_and_nothing_is_written(cli: Cli, tmp_path: Path, case: str) -> None:
    options, expected = WRONG_OPTIONS[case]
    path = maps.geojson(tmp_path / "towers.geojson", TOWERS)
    expect_refusal(cli("import", path, *options, "-o", "m.yaml", "--json"), 2, *expected)
    assert [p.name for p in tmp_path.iterdir()] == ["towers.geojson"]


def _damaged_kmz(path: Path) -> None:
    maps.kmz(path, TOWERS)
    content = bytearray(path.read_bytes())
    content[80:120] = bytes(40)
    path.write_bytes(content)


def _way_out(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("../evil.csv", "name,lat,lon\nA,47,9.5\n")


def _kml_of(replaced: str, by: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(maps.kml_text(TOWERS).replace(replaced, by), encoding="utf-8")


def _text(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8")


WRONG_FILES: dict[str, tuple[str, Callable[[Path], object], list[str]]] = {
    "nothing in it": ("m.csv", _text(""), ["m.csv", "an empty file"]),
    "no kind that we know": ("m.dwg", _text("x"), ["m.dwg", "GeoJSON, KML", ".dwg"]),
    "no features": ("m.geojson", _text('{"type": "FeatureCollection", "features": []}'), ["without any feature"]),
    "cut off GeoJSON": ("m.geojson", _text('{"type": "FeatureCollection", "feat'), ["damaged"]),
    "other JSON": ("m.json", _text('{"towers": 7}'), ["FeatureCollection", "other JSON"]),
    "GeoJSON in Latin-1": ("m.geojson", lambda p: p.write_bytes(b'{"type": "F\xfcr"}'), ["UTF-8", "0xfc"]),
    "cut off KML": ("m.kml", lambda p: p.write_text(maps.kml_text(TOWERS)[:500]), ["m.kml", "damaged"]),
    "KML with entities": ("m.kml", _kml_of("<kml", "<!DOCTYPE kml [<!ENTITY a 'b'>]><kml"), ["document type"]),
    "projected KML": ("m.kml", _kml_of("9.5", "3509.5"), ["projected coordinates", "--crs"]),
    "latitude first": ("m.kml", _kml_of("<coordinates>9.5,47.0", "<coordinates>47.0,109.5"), ["m.kml", "swapped"]),
    "a damaged archive": ("m.kmz", _damaged_kmz, ["m.kmz", "damaged"]),
    "no archive at all": ("m.zip", _text("PK, but no more"), ["m.zip", "damaged"]),
    "an archive with a way out": ("m.zip", _way_out, ["'../evil.csv'", "a way out"]),
    "no Shapefile": ("m.shp", _text("x" * 200), ["m.shp", "damaged"]),
    "no GeoPackage": ("m.gpkg", _text("x" * 200), ["m.gpkg", "damaged"]),
    "cut off OpenStreetMap": ("m.osm", _text('<osm version="0.6"><node id="1" lat="4'), ["m.osm", "damaged"]),
    "no PBF": ("m.osm.pbf", _text("x" * 200), ["m.osm.pbf", "damaged"]),
    "a table without places": ("m.csv", _text("a,b\n1,2\n3,4\n"), ["columns lat and lon", "a, b"]),
    "a table without a system": ("m.csv", _text("name,x,y\nA,1,2\nB,3,4\n"), ["columns x and y", "--crs"]),
    "a table of words": ("m.csv", _text("lat,lon\n47,9.5\n47.1,far\n"), ["m.csv, line 3", "column lon", "'far'"]),
    "a table swapped": ("m.csv", _text("lat,lon\n147,9.5\n147.1,9.5\n"), ["m.csv, line 2", "swapped"]),
    "a table of metres": ("m.csv", _text("lat,lon\n5200000,650000\n"), ["m.csv, line 2", "projected", "--crs"]),
    "one column twice": ("m.csv", _text("lat,lon,lat\n1,2,3\n"), ["every column once", "lat"]),
    "elevations for heights": ("m.csv", _text("lat,lon,height\n47,9,450\n47.1,9,460\n"), ["call them ele"]),
    "a tall tale": ("m.csv", _text("lat,lon,height\n47,9,tall\n47.1,9,30\n"), ["m.csv, line 2", "height 'tall'"]),
    "dates both ways": (
        "m.csv",
        _text("lat,lon,inspected\n47,9,04/05/2024\n47.001,9,05/06/2024\n"),
        ["m.csv, line 2", "day or month first"],
    ),
    "one tower": ("m.csv", _text("lat,lon\n47,9\n"), ["two towers", "got 1"]),
    "a line without towers": (
        "m.kml",
        lambda p: p.write_text(re.sub(r"<Folder><name>Masten.*?</Folder>", "", maps.kml_text(FAR_APART))),
        ["a line without towers", "import a map of its towers too"],
    ),
}


@pytest.mark.parametrize("case", WRONG_FILES)
def test_wrong_files_are_told_in_one_line_and_nothing_is_written(cli: Cli, tmp_path: Path, case: str) -> None:
    name, write, expected = WRONG_FILES[case]
    write(tmp_path / name)
    expect_refusal(cli("import", name, "-o", "out.yaml", "--json"), 2, *expected)
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_the_origin_of_a_frame_is_the_middle_of_the_towers(cli: Cli, tmp_path: Path) -> None:
    assert cli("import", maps.geojson(tmp_path / "towers.geojson", TOWERS), "-o", "m.yaml").code == 0
    mission = load_mission(tmp_path / "m.yaml")
    frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
    at_m = frame.to_local(*np.array(TOWERS).T, 0.0)[:, :2]
    assert np.abs(at_m.min(axis=0) + at_m.max(axis=0)).max() < 5
