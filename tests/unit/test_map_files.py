"""What files say and how they say it; wrong files are in tests/system/test_importing.py."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import osmium
import pyogrio
import pytest
import shapely
from pyproj import CRS, Transformer

from adapters import map_files
from adapters.map_files import read_maps
from missionplanner.errors import MissionError
from missionplanner.map_tags import LAYER
from tests import maps

TOWERS = [(round(47.0 + 0.002 * k, 7), round(9.5 + 0.0004 * k, 7)) for k in range(4)]


def collection(path: Path, *features: dict[str, Any], **members: object) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features, **members}), encoding="utf-8")
    return path


def point(x: float, y: float, **properties: object) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": "Point", "coordinates": [x, y]}}


def test_what_openstreetmap_extracts_say_of_nodes_is_kept(tmp_path: Path) -> None:
    line = {
        "type": "Feature",
        "properties": {"osm_way": 5, "power": "line", "node_ids": [11, 12]},
        "geometry": {"type": "LineString", "coordinates": [[9.5, 47.0, 431.0], [9.51, 47.0, 432.0]]},
    }
    path = collection(tmp_path / "map.geojson", line, point(9.5, 47.0, osm_node=11, power="tower"))
    way, node = read_maps([path]).features
    assert (way.nodes, node.id, way.id) == (("11", "12"), "11", "")
    assert way.openstreetmap
    assert way.lat_lon_deg.tolist() == [[47.0, 9.5], [47.0, 9.51]]


def test_tags_are_found_where_overpass_and_gdal_pack_them(tmp_path: Path) -> None:
    packed = '"height"=>"35","name"=>"a \\"b\\""'
    path = collection(
        tmp_path / "map.geojson",
        {**point(9.5, 47.0, power="tower"), "id": "node/7"},
        point(9.5, 47.1, power="tower", other_tags=packed),
        point(9.5, 47.2, tags={"power": "tower", "height": "36"}),
    )
    overpass, gdal, nested = read_maps([path]).features
    assert overpass.id == "7"
    assert gdal.tags["height"] == "35"
    assert nested.tags["height"] == "36"


def test_many_parts_are_told_one_by_one(tmp_path: Path) -> None:
    parts = [[[9.5, 47.0], [9.51, 47.0]], [[9.6, 47.0], [9.61, 47.0]]]
    both = {"type": "MultiLineString", "coordinates": parts}
    mixed = {"type": "GeometryCollection", "geometries": [both, {"type": "Point", "coordinates": [9.5, 47.0]}]}
    path = collection(tmp_path / "map.geojson", {"type": "Feature", "properties": {"a": 1}, "geometry": mixed})
    assert [f.shape for f in read_maps([path]).features] == ["line", "line", "point"]


@pytest.mark.parametrize("epsg", [2056, 25832, 31287])
def test_a_coordinate_system_in_geojson_counts(tmp_path: Path, epsg: int) -> None:
    x, y = Transformer.from_crs(4326, epsg, always_xy=True).transform(9.5, 47.0)
    system = {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}
    (found,) = read_maps([collection(tmp_path / "map.geojson", point(x, y), crs=system)]).features
    np.testing.assert_allclose(found.lat_lon_deg, [[47.0, 9.5]], atol=1e-7)


def test_projected_numbers_that_claim_to_be_degrees_need_and_take_a_system(tmp_path: Path) -> None:
    x, y = Transformer.from_crs(4326, 25832, always_xy=True).transform(9.5, 47.0)
    path = collection(tmp_path / "map.geojson", point(x, y))
    with pytest.raises(MissionError, match=r"map.geojson: .*projected coordinates: give --crs"):
        read_maps([path])
    (found,) = read_maps([path], "EPSG:25832").features
    np.testing.assert_allclose(found.lat_lon_deg, [[47.0, 9.5]], atol=1e-7)


def test_degrees_keep_their_own_system_whatever_is_given_for_others(tmp_path: Path) -> None:
    (found,) = read_maps([collection(tmp_path / "map.geojson", point(9.5, 47.0))], "EPSG:25832").features
    np.testing.assert_allclose(found.lat_lon_deg, [[47.0, 9.5]])


def test_a_shapefile_without_prj_asks_for_its_system(tmp_path: Path) -> None:
    path = maps.shapefile(tmp_path / "map.shp", TOWERS, 25832)
    (tmp_path / "map.prj").unlink()
    with pytest.raises(MissionError, match=r"map.shp: .*\.prj.*--crs"):
        read_maps([path])
    (found,) = read_maps([path], "EPSG:25832").features
    np.testing.assert_allclose(found.lat_lon_deg, TOWERS, atol=1e-7)


BESSEL_UNKNOWN = (
    'PROJCS["unnamed",GEOGCS["GCS_unknown",DATUM["D_Unknown_based_on_Bessel_1841_ellipsoid",'
    'SPHEROID["Bessel_1841",6377397.155,299.1528128]],PRIMEM["Greenwich",0.0],UNIT["Degree",0.0174532925199433]],'
    'PROJECTION["Gauss_Kruger"],PARAMETER["False_Easting",4500000.0],PARAMETER["False_Northing",0.0],'
    'PARAMETER["Central_Meridian",12.0],PARAMETER["Scale_Factor",1.0],PARAMETER["Latitude_Of_Origin",0.0],'
    'UNIT["Meter",1.0]]'
)


def shapefile(path: Path, x: float, y: float, prj: str) -> Path:
    shape = np.array([shapely.to_wkb(shapely.Point(x, y))], dtype=object)
    names = [np.array(["T1"], dtype=object)]
    pyogrio.raw.write(path, shape, names, fields=["name"], geometry_type="Point", crs="EPSG:31468")
    path.with_suffix(".prj").write_text(prj)
    return path


def test_an_unknown_datum_is_refused_or_taken_as_given(tmp_path: Path) -> None:
    x, y = Transformer.from_crs(4326, 31468, always_xy=True).transform(11.5, 49.95)
    path = shapefile(tmp_path / "gk.shp", x, y, BESSEL_UNKNOWN)
    with pytest.raises(MissionError, match=r"gk.shp: .*whose datum is known.*--crs EPSG:"):
        read_maps([path])
    told = read_maps([path], "EPSG:31468")
    np.testing.assert_allclose(told.features[0].lat_lon_deg, [[49.95, 11.5]], atol=1e-6)
    assert any("datum" in note for note in told.notes)
    assert any("good to 3 m only" in note for note in told.notes)


def test_an_unknown_datum_within_metres_of_wgs84_is_told(tmp_path: Path) -> None:
    x, y = Transformer.from_crs(4326, 25832, always_xy=True).transform(11.5, 49.95)
    prj = CRS.from_user_input("+proj=utm +zone=32 +ellps=GRS80 +units=m").to_wkt("WKT1_ESRI")
    told = read_maps([shapefile(tmp_path / "utm.shp", x, y, prj)])
    np.testing.assert_allclose(told.features[0].lat_lon_deg, [[49.95, 11.5]], atol=1e-5)
    assert any("taken for WGS 84" in note for note in told.notes)


def test_good_transformations_are_not_worth_a_word(tmp_path: Path) -> None:
    x, y = Transformer.from_crs(4326, 25832, always_xy=True).transform(11.5, 49.95)
    assert read_maps([shapefile(tmp_path / "utm.shp", x, y, CRS.from_epsg(25832).to_wkt("WKT1_ESRI"))]).notes == ()


@pytest.mark.parametrize("crs", [None, "EPSG:25832", "EPSG:4258"])
def test_latitudes_of_a_table_are_degrees_whatever_is_given_for_others(tmp_path: Path, crs: str | None) -> None:
    path = tmp_path / "towers.csv"
    path.write_text("name,lat,lon\nT1,49.95,11.5\n")
    (found,) = read_maps([path], crs).features
    np.testing.assert_allclose(found.lat_lon_deg, [[49.95, 11.5]], atol=1e-7)


def test_degrees_in_columns_of_a_projected_system_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "towers.csv"
    path.write_text("name,x,y\nT1,11.5,49.95\n")
    with pytest.raises(MissionError, match=r"towers.csv, line 2: .*got degrees"):
        read_maps([path], "EPSG:25832")


def test_a_zipped_shapefile_is_read_from_any_folder_in_it(tmp_path: Path) -> None:
    maps.shapefile(tmp_path / "map.shp", TOWERS)
    with zipfile.ZipFile(tmp_path / "map.zip", "w") as archive:
        archive.writestr("README.txt", "made by hand")
        for part in sorted(tmp_path.glob("map.???")):
            if part.suffix != ".zip":
                archive.write(part, f"export/2026/{part.name}")
    (found,) = read_maps([tmp_path / "map.zip"]).features
    np.testing.assert_allclose(found.lat_lon_deg, TOWERS, atol=1e-7)
    assert found.source == "map.zip/export/2026/map.shp, feature 1"


def test_layers_of_a_geopackage_are_told(tmp_path: Path) -> None:
    path = tmp_path / "map.gpkg"
    at = shapely.to_wkb(shapely.points([9.5, 9.51], [47.0, 47.0]))
    for layer in ("Leitung 1", "Leitung 2"):
        names = np.array([f"{layer} {k}" for k in range(2)], dtype=object)
        pyogrio.raw.write(
            path, at, [names], ["Mast"], geometry_type="Point", crs="EPSG:4326", layer=layer, append=path.exists()
        )
    found = read_maps([path]).features
    assert [f.tags[LAYER] for f in found] == ["Leitung 1"] * 2 + ["Leitung 2"] * 2
    assert found[0].tags["mast"] == "Leitung 1 0"


def test_kml_folders_are_layers_and_altitudes_nothing(tmp_path: Path) -> None:
    found = read_maps([maps.kml(tmp_path / "map.kml", TOWERS)]).features
    assert [f.tags[LAYER] for f in found] == ["Masten"] * 4 + ["Leitungen"]
    assert all("431" not in text for f in found for text in f.tags.values())


def test_kml_that_speaks_of_another_datum_is_told(tmp_path: Path) -> None:
    path = tmp_path / "map.kml"
    path.write_text(maps.kml_text(TOWERS, "110 kV (DHDN, Gauß-Krüger)"), encoding="utf-8")
    assert any("speaks of DHDN" in note for note in read_maps([path]).notes)
    assert read_maps([maps.kml(tmp_path / "other.kml", TOWERS)]).notes == ()


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize(("separator", "comma"), [(";", ","), (";", "."), (",", "."), ("\t", ","), ("|", ".")])
def test_tables_are_read_in_any_encoding_and_with_any_separator(
    tmp_path: Path, encoding: str, separator: str, comma: str
) -> None:
    rows = [["Länge", "Breite", "Mast"], ["9.5", "47.25", "Süd 1"], ["9.5", "47.5", "Süd 2"], []]
    text = "\r\n".join(separator.join(cell.replace(".", comma) for cell in row) for row in rows)
    (tmp_path / "map.csv").write_bytes(text.encode(encoding))
    read = read_maps([tmp_path / "map.csv"])
    assert [f.lat_lon_deg.tolist() for f in read.features] == [[[47.25, 9.5]], [[47.5, 9.5]]]
    assert [f.tags["mast"] for f in read.features] == ["Süd 1", "Süd 2"]
    assert bool(read.notes) == (encoding == "cp1252")


def test_eastings_and_northings_of_a_table_are_of_the_system_given(tmp_path: Path) -> None:
    x, y = Transformer.from_crs(4326, 31468, always_xy=True).transform(11.5, 50.0)
    (tmp_path / "map.csv").write_text(f"Mast;Rechtswert;Hochwert\nA;{x:.3f};{y:.3f}\n".replace(".", ","))
    (found,) = read_maps([tmp_path / "map.csv"], "EPSG:31468").features
    np.testing.assert_allclose(found.lat_lon_deg, [[50.0, 11.5]], atol=1e-7)


def test_a_way_that_an_extract_cut_is_told_in_pieces(tmp_path: Path) -> None:
    """Nodes 3 and 6 are not in the file: no span is made up across the gap."""
    path = tmp_path / "map.osm"
    with osmium.SimpleWriter(str(path)) as writer:
        for k in (1, 2, 4, 5, 7):
            writer.add_node(osmium.osm.mutable.Node(id=k, version=1, location=(9.5, 47.0 + k / 1000)))
        writer.add_way(osmium.osm.mutable.Way(id=9, version=1, nodes=[1, 2, 3, 4, 5, 6, 7], tags={"power": "line"}))
        writer.add_way(osmium.osm.mutable.Way(id=10, version=1, nodes=[1, 2], tags={"highway": "path"}))
    found = read_maps([path]).features
    assert [f.nodes for f in found] == [("1", "2"), ("4", "5")]


def test_bombs_are_stopped_whatever_the_archive_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_files, "_MAX_BYTES", 1_000_000)
    with zipfile.ZipFile(tmp_path / "map.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("map.csv", bytes(2_000_000))
    with pytest.raises(MissionError, match="at most 0 MB when unpacked"):
        read_maps([tmp_path / "map.zip"])
    with zipfile.ZipFile(tmp_path / "many.zip", "w") as archive:
        for k in range(1001):
            archive.writestr(f"{k}.csv", "")
    with pytest.raises(MissionError, match="at most 1000 files inside, got 1001"):
        read_maps([tmp_path / "many.zip"])


@pytest.mark.parametrize("name", ["/etc/evil.csv", "a/../../evil.csv", "..\\evil.csv", "C:\\evil.csv"])
def test_archives_write_nowhere_else(tmp_path: Path, name: str) -> None:
    with zipfile.ZipFile(tmp_path / "map.zip", "w") as archive:
        archive.writestr(name, "lat,lon\n47,9\n")
    with pytest.raises(MissionError, match="a way out of it"):
        read_maps([tmp_path / "map.zip"])


def test_links_and_passwords_in_archives_are_refused(tmp_path: Path) -> None:
    link = zipfile.ZipInfo("map.csv")
    link.external_attr = 0o120777 << 16
    with zipfile.ZipFile(tmp_path / "link.zip", "w") as archive:
        archive.writestr(link, "/etc/passwd")
    with pytest.raises(MissionError, match="a way out of it"):
        read_maps([tmp_path / "link.zip"])
    maps.kmz(tmp_path / "map.kmz", TOWERS)
    content = bytearray((tmp_path / "map.kmz").read_bytes())
    content[6] |= 1  # encrypted, says the first file's header, and so the directory at the end
    content[content.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "locked.kmz").write_bytes(content)
    with pytest.raises(MissionError, match="without password"):
        read_maps([tmp_path / "locked.kmz"])


def test_too_many_features_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_files, "_MAX_FEATURES", 3)
    for path in (maps.geojson(tmp_path / "map.geojson", TOWERS), maps.osm(tmp_path / "map.osm", TOWERS)):
        with pytest.raises(MissionError, match="at most 3 features"):
            read_maps([path])
    monkeypatch.setattr(map_files, "_MAX_BYTES", 100)
    with pytest.raises(MissionError, match="expected at most 0 MB"):
        read_maps([tmp_path / "map.geojson"])
