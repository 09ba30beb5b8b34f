"""Maps of one line for tests, written by other means than those that read them: in every format that is imported."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import osmium
import pyogrio
import shapely
from hypothesis import strategies as st
from pyproj import Transformer

from adapters.map_files import read_maps
from missionplanner.geodesy import LocalFrame
from missionplanner.line_map import read_line_map
from missionplanner.line_mission import ImportedMission, Wishes, imported_mission
from missionplanner.mission import Mission, parse_mission

Places = Sequence[tuple[float, float]]
AS_OF = "2026-01-01"


@st.composite
def routes(draw: st.DrawFn, turn_deg: float = 35.0, least: int = 3, most: int = 20) -> list[tuple[float, float]]:
    """Return towers of a line that goes one way on the whole: latitudes and longitudes to 1e-7 degrees."""
    frame = LocalFrame(draw(st.floats(-60, 60)), draw(st.floats(-170, 170)))
    count = draw(st.integers(least, most))
    bearing = np.radians(draw(st.floats(0, 360)))
    steps = draw(
        st.lists(st.tuples(st.floats(120, 400), st.floats(-turn_deg, turn_deg)), min_size=count, max_size=count)
    )
    headings = bearing + np.radians([turn for _, turn in steps])
    lengths = np.array([length for length, _ in steps])
    xy = np.cumsum(np.stack([lengths * np.sin(headings), lengths * np.cos(headings)], axis=1), axis=0)
    lat, lon, _ = frame.to_geo(np.column_stack([xy, np.zeros(count)]))
    return [(round(float(a), 7), round(float(b), 7)) for a, b in zip(lat, lon, strict=True)]


def imported(*paths: Path, crs: str | None = None, **wishes: object) -> tuple[ImportedMission, Mission]:
    """Return what is imported from maps, and the mission that its file is."""
    maps = read_maps(paths, crs)
    asked = Wishes(name="imported", as_of=AS_OF, **wishes)  # type: ignore[arg-type]
    made = imported_mission(read_line_map(maps.features), asked, [path.name for path in paths], maps.notes)
    return made, parse_mission(made.text, "imported.yaml")


def line_places(mission: Mission, index: int = 0) -> list[tuple[float, float]]:
    """Return the places of a line's towers, in its order."""
    assert mission.inspection is not None
    at = {tower.name: (tower.lat_deg or 0.0, tower.lon_deg or 0.0) for tower in mission.inspection.towers}
    return [at[name] for name in mission.inspection.lines[index].towers]


def geojson(path: Path, towers: Places, *, line: bool = True, **tags: object) -> Path:
    """Write towers as points, and the line through them."""
    features = [_feature("Point", [lon, lat], {"name": f"T{k}"}) for k, (lat, lon) in enumerate(towers, start=1)]
    if line:
        features.append(_feature("LineString", [[lon, lat] for lat, lon in towers], {"name": "L1", **tags}))
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}), encoding="utf-8")
    return path


def _feature(kind: str, coordinates: object, properties: dict[str, object]) -> dict[str, object]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def kml_text(towers: Places, name: str = "110 kV L1") -> str:
    points = "".join(
        f"<Placemark><name>T{k}</name><Point><coordinates>{lon!r},{lat!r},431</coordinates></Point></Placemark>"
        for k, (lat, lon) in enumerate(towers, start=1)
    )
    way = " ".join(f"{lon!r},{lat!r},431" for lat, lon in towers)
    return (
        '<?xml version="1.0" encoding="UTF-8"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document>'
        f"<Folder><name>Masten</name>{points}</Folder><Folder><name>Leitungen</name><Placemark><name>{name}</name>"
        f"<LineString><coordinates>{way}</coordinates></LineString></Placemark></Folder></Document></kml>"
    )


def kml(path: Path, towers: Places) -> Path:
    path.write_text(kml_text(towers), encoding="utf-8")
    return path


def kmz(path: Path, towers: Places) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("doc.kml", kml_text(towers))
        archive.writestr("files/icon.png", b"\x89PNG")
    return path


def csv(path: Path, towers: Places, order: Sequence[int]) -> Path:
    """Write a table as spreadsheets here do: semicolons, decimal commas; rows in another order than the line's."""
    rows = ["Mast;Breite;Länge;Höhe [m];Leitung;Reihenfolge"]
    for k in order:
        lat, lon = (str(v).replace(".", ",") for v in towers[k])
        rows.append(f"{chr(65 + k % 26)}{k // 26};{lat};{lon};31,5;L1;{k + 1}")
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def shapefile(path: Path, towers: Places, epsg: int = 3857) -> Path:
    """Write the line alone, in a projected coordinate system."""
    x, y = Transformer.from_crs(4326, epsg, always_xy=True).transform(*np.array(towers).T[::-1])
    line = shapely.to_wkb(np.array([shapely.linestrings(np.stack([x, y], axis=1))]))
    names = np.array(["L1"], dtype=object)
    pyogrio.raw.write(
        path, line, [names], ["name"], geometry_type="LineString", crs=f"EPSG:{epsg}", driver="ESRI Shapefile"
    )
    return path


def osm(path: Path, towers: Places, tags: dict[str, str] | None = None) -> Path:
    """Write OpenStreetMap's XML or PBF, whichever the path's name asks for."""
    with osmium.SimpleWriter(str(path), overwrite=True) as writer:
        for k, (lat, lon) in enumerate(towers, start=1):
            node_tags = {"power": "tower", "ref": str(k), "height": "42"}
            writer.add_node(osmium.osm.mutable.Node(id=k, version=1, location=(lon, lat), tags=node_tags))
        way_tags = {"power": "line", "ref": "L1", "voltage": "110000"} | (tags or {})
        writer.add_way(osmium.osm.mutable.Way(id=7, version=1, nodes=list(range(1, len(towers) + 1)), tags=way_tags))
    return path
