"""Maps as utilities have them: GeoJSON, KML and KMZ, Shapefile, GeoPackage, CSV, OpenStreetMap; any coordinate system.

Everything is read, nothing is guessed: what a feature means is asked in :mod:`missionplanner.map_tags`. Archives are
unpacked with bounds, into a folder that is gone afterwards.
"""

from __future__ import annotations

import csv
import io
import json
import re
import stat
import tempfile
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pyogrio
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from adapters.osm_files import read_osm
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.map_tags import EASTINGS, LATITUDES, LAYER, LONGITUDES, NORTHINGS, MapFeature, number, plain, value

FORMATS = "GeoJSON, KML, KMZ, Shapefile (.shp or .zip), GeoPackage, CSV, OpenStreetMap (.osm, .osm.pbf)"

_MAX_BYTES = 256 * 1024 * 1024
_MAX_OSM_BYTES = 1024 * 1024 * 1024
_MAX_MEMBERS = 1000
_MAX_FEATURES = 200_000
_MAX_VERTICES = 2_000_000
_OSM_SUFFIXES = (".osm", ".osm.gz", ".osm.bz2", ".pbf")
_TABLES = (".csv", ".tsv", ".txt")
_INNER = (".shp", ".kml", ".geojson", ".json", ".gpkg", ".csv")  # others' .txt are licences and the like
_OSM_COLUMNS = {"osm_id", "osm_node", "osm_way", "@id", "power", "aerialway", "man_made"}
_GOOD_M = 2.0  # transformations of so good an accuracy, or a better one, are not worth a word
_WGS84 = CRS.from_epsg(4326)
_OTHER_DATUMS = re.compile(
    r"\b(DHDN|MGI|Gau(?:ss|ß)[- ]?Kr(?:ü|ue)ger|CH1903\+?|LV ?95|LV ?03|ED ?50|NAD ?27|Pulkovo|Lambert|Monte Mario|"
    r"OSGB36)\b",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True, eq=False)
class MapFiles:
    """What is on the maps, and what a person should know of how they were read."""

    features: tuple[MapFeature, ...]
    notes: tuple[str, ...]


def read_maps(paths: Sequence[Path], crs: str | None = None) -> MapFiles:
    """Read maps; ``crs`` (e.g. EPSG:25832) counts for files that do not say theirs, or say one that cannot be.

    Raises
    ------
    MissionError
        A file that cannot be read, is damaged, empty, too large or of an unknown kind; coordinates of an unknown
        system.
    """
    reader = _Reader(_known_crs(crs) if crs is not None else None)
    for path in paths:
        before = len(reader.features)
        if path.is_dir() or not path.exists():
            what = "a folder" if path.is_dir() else "no such file"
            raise MissionError(f"{path}: expected a map ({FORMATS}), got {what}")
        reader.read(path, path.name)
        if len(reader.features) == before:
            raise MissionError(f"{path}: expected towers or lines, got a map without any feature")
    return MapFiles(tuple(reader.features), tuple(dict.fromkeys(reader.notes)))


def _known_crs(text: str) -> CRS:
    try:
        return CRS.from_user_input(text).to_2d()
    except CRSError:
        raise MissionError(f"--crs: expected a coordinate system, e.g. EPSG:25832, got {text!r}") from None


class _Reader:
    """Collects the features of one file after the other."""

    def __init__(self, crs: CRS | None) -> None:
        self.features: list[MapFeature] = []
        self.notes: list[str] = []
        self._crs = crs
        self._vertices = 0

    def read(self, path: Path, name: str) -> None:
        suffix = _suffix(path)
        most = _MAX_OSM_BYTES if suffix in _OSM_SUFFIXES else _MAX_BYTES
        try:
            size = path.stat().st_size
            with path.open("rb") as file:
                head = file.read(4096)
        except OSError as error:
            raise MissionError(f"{name}: expected a map that can be read, got: {error.strerror}") from error
        if size == 0:
            raise MissionError(f"{name}: expected a map ({FORMATS}), got an empty file")
        if size > most:
            raise MissionError(
                f"{name}: expected at most {most // 1024**2} MB, got {size / 1024**2:.0f}: cut it to the area first "
                "(ogr2ogr -clipsrc, osmium extract)"
            )
        if suffix in _OSM_SUFFIXES:
            self._add(read_osm(path, name, _MAX_FEATURES))
        elif suffix in {".kmz", ".zip"}:
            self._read_archive(path, name)
        elif suffix in _TABLES:
            self._read_table(path, name)
        elif suffix in {".geojson", ".json"}:
            self._read_text_layers(path, name, "GeoJSON")
        elif suffix == ".kml":
            self._read_text_layers(path, name, "KML")
        elif suffix in {".shp", ".gpkg"}:
            if suffix == ".gpkg" and not head.startswith(b"SQLite format 3\0"):
                raise MissionError(f"{name}: expected a GeoPackage, got a damaged one, or something else")
            self._read_layers(path.resolve(), name)
        else:
            raise MissionError(f"{name}: expected a map ({FORMATS}), got a file named {suffix or 'without an ending'}")

    def _add(self, features: Iterator[MapFeature] | Sequence[MapFeature]) -> None:
        for feature in features:
            self.features.append(feature)
            self._vertices += len(feature.lat_lon_deg)
            if len(self.features) > _MAX_FEATURES or self._vertices > _MAX_VERTICES:
                raise MissionError(
                    f"{feature.source}: expected at most {_MAX_FEATURES} features with {_MAX_VERTICES} vertices, got "
                    "more: cut the map to the area first"
                )

    # --- archives

    def _read_archive(self, path: Path, name: str) -> None:
        try:
            with tempfile.TemporaryDirectory() as made, zipfile.ZipFile(path) as archive:
                folder = Path(made)
                members = _unpack(archive, folder, name)
                maps = [m for m in members if m.suffix.lower() in _INNER]
                if not maps:
                    raise MissionError(f"{name}: expected a map inside ({', '.join(_INNER)}), got none")
                if any(member.suffix.lower() == ".zip" for member in members):
                    self.notes.append(f"{name}: archives within it were not read")
                for member in maps:
                    self.read(member, f"{name}/{member.relative_to(folder).as_posix()}")
        except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError, ValueError, OSError) as error:
            reason = str(error)[:200]
            raise MissionError(f"{name}: expected an archive that can be read, got a damaged one: {reason}") from error
        except RuntimeError as error:  # as zipfile says it of passwords
            raise MissionError(f"{name}: expected an archive without password, got: {error}") from error

    # --- layers that GDAL reads

    def _read_text_layers(self, path: Path, name: str, what: str) -> None:
        content = path.read_bytes()
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            if what == "KML" and not re.match(rb'<\?xml[^>]*encoding=["\'](?!utf-8)', content, re.IGNORECASE):
                raise _not_utf8(name, what, content, error) from error
            if what == "GeoJSON":
                raise _not_utf8(name, what, content, error) from error
            text = content.decode("latin-1")  # for the look below only; GDAL reads what the file says it is
        if "<!ENTITY" in text or "<!DOCTYPE" in text:
            raise MissionError(f"{name}: expected {what} without a document type of its own, got one: remove it")
        if what == "GeoJSON":
            self._look_at_json(text, name)
        elif hint := _OTHER_DATUMS.search(text):
            self.notes.append(
                f"{name}: speaks of {hint.group()}, but KML is WGS 84 by definition: check in an aerial image that its "
                "places were transformed"
            )
        self._read_layers(content.removeprefix(b"\xef\xbb\xbf"), name)

    def _look_at_json(self, text: str, name: str) -> None:
        try:
            document = json.loads(text)
        except (json.JSONDecodeError, RecursionError) as error:
            raise MissionError(f"{name}: expected GeoJSON, got a damaged file: {error}") from error
        known = isinstance(document, dict) and document.get("type") in {"FeatureCollection", "Feature"}
        if not known:
            raise MissionError(f"{name}: expected a GeoJSON FeatureCollection, got other JSON")

    def _read_layers(self, source: Path | bytes, name: str) -> None:
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                layers = [str(layer) for layer, _ in pyogrio.list_layers(source)]
                for index, layer in enumerate(layers):
                    self._read_layer(source, index, name, {LAYER: layer} if len(layers) > 1 else {})
        except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError, pyogrio.errors.FeatureError) as error:
            raise MissionError(
                f"{name}: expected a map that can be read, got a damaged one: {_reason(error, source)}"
            ) from error
        except (UnicodeDecodeError, pyogrio.errors.GeometryError, shapely.errors.ShapelyError) as error:
            raise MissionError(f"{name}: expected a map that can be read, got: {_reason(error, source)}") from error
        self.notes += [f"{name}: {_reason(w.message, source)}" for w in caught]

    def _read_layer(self, source: Path | bytes, layer: int, name: str, layer_tag: Mapping[str, str]) -> None:
        meta, _, geometry, columns = pyogrio.raw.read(
            source, layer=layer, force_2d=True, datetime_as_string=True, max_features=_MAX_FEATURES + 1
        )
        if geometry is None or not len(geometry):
            return
        names = [plain(str(field)) for field in meta["fields"]]
        subtypes = list(meta["ogr_subtypes"])
        openstreetmap = not _OSM_COLUMNS.isdisjoint(names)
        shapes = shapely.from_wkb(geometry)
        crs = self._crs_of(meta["crs"], shapes, name)
        to_geo = _to_geo(crs, name)
        found = []
        for k, shape in enumerate(shapes.tolist()):
            if shape is None or shape.is_empty:
                continue
            tags = {**layer_tag} | _tags(names, subtypes, [column[k] for column in columns])
            nodes = tuple(tags.pop("node_ids").split(";")) if "node_ids" in tags else ()
            common = MapFeature(
                "point", np.empty((0, 2)), tags, f"{name}, feature {k + 1}", _osm_id(tags), nodes, openstreetmap
            )
            found += [part for one in shapely.get_parts(shape).tolist() for part in _parts(common, one)]
        self._place(found, to_geo, name)

    def _place(self, found: Sequence[MapFeature], to_geo: Transformer | None, name: str) -> None:
        self._add([_placed(feature, to_geo) for feature in found])
        if to_geo is not None and found and (doubt := _doubt(to_geo)):
            self.notes.append(f"{name}: {doubt}: compare with an aerial image")

    def _crs_of(self, said: str | None, shapes: Any, name: str) -> CRS:
        """Return the coordinate system of a layer.

        Raises
        ------
        MissionError
            Nobody says it, or its numbers are no degrees though it says so.
        """
        crs = None if said is None else CRS.from_user_input(said)
        if crs is not None:
            crs = crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()
        west, south, east, north = shapely.total_bounds(shapes).tolist()
        degrees = max(abs(west), abs(east)) <= 180.0 and max(abs(south), abs(north)) <= 90.0
        if crs is not None and (degrees or not crs.is_geographic):
            if self._crs is None or self._crs.is_geographic != crs.is_geographic or _is_tied(crs):
                return crs
            self.notes.append(f"{name}: the datum of its system {crs.name!r} is unknown: taken as --crs says")
            return self._crs
        if self._crs is not None:
            if self._crs.is_geographic and not degrees:
                raise MissionError(
                    f"{name}: expected degrees (--crs {self._crs.to_string()}), got coordinates up to "
                    f"{max(abs(east), abs(west)):.0f}, {max(abs(north), abs(south)):.0f}: give the projected system"
                )
            return self._crs
        if crs is None:
            looks = "WGS 84 may be EPSG:4326" if degrees else "projected coordinates"
            raise MissionError(
                f"{name}: expected a coordinate system (a .prj file beside the .shp), got none ({looks}): give --crs, "
                "e.g. --crs EPSG:25832"
            )
        if max(abs(west), abs(east)) <= 90.0 and max(abs(south), abs(north)) <= 180.0:
            raise MissionError(
                f"{name}: expected longitude before latitude, within 180 and 90 degrees, got a second number of "
                f"{max(abs(south), abs(north)):g}: are latitude and longitude swapped?"
            )
        raise MissionError(
            f"{name}: expected longitude and latitude in degrees, got {west:.6g}, {south:.6g}: these are projected "
            "coordinates: give --crs, e.g. --crs EPSG:25832"
        )

    # --- tables

    def _read_table(self, path: Path, name: str) -> None:
        text = self._text(path, name)
        try:
            table = csv.reader(io.StringIO(text, newline=""), _dialect(text))
            rows = [row for row in table if any(cell.strip() for cell in row)]
        except csv.Error as error:
            raise MissionError(f"{name}: expected a table, got a damaged one: {error}") from error
        if len(rows) < 2:
            raise MissionError(f"{name}: expected a line of column names and a line per tower, got {len(rows)} lines")
        names = [plain(cell) for cell in rows[0]]
        if len(set(filter(None, names))) < len([n for n in names if n]):
            twice = next(n for n in names if n and names.count(n) > 1)
            raise MissionError(f"{name}: expected every column once, got {twice} again: rename one")
        columns, crs = self._columns(names, name)
        openstreetmap = not _OSM_COLUMNS.isdisjoint(names)
        found = []
        for line, row in enumerate(rows[1:], start=2):
            source = f"{name}, line {line}"
            tags = {n: cell.strip() for n, cell in zip(names, row, strict=False) if n and cell.strip()}
            x, y = (self._coordinate(tags, column, source) for column in columns)
            found.append(
                MapFeature("point", np.array([[x, y]]), tags, source, _osm_id(tags), openstreetmap=openstreetmap)
            )
        self._place(found, _to_geo(self._crs_of_table(columns, crs, found), name), name)

    def _crs_of_table(self, columns: tuple[str, str], crs: CRS | None, found: Sequence[MapFeature]) -> CRS:
        """Return the system of columns: degrees in lat and lon are degrees, whatever is given for other files."""
        named = columns[0] in LONGITUDES
        wrong = [f for f in found if (np.abs(f.lat_lon_deg) > [180.0, 90.0]).any()]
        if named and not wrong:
            return crs if crs is not None and crs.is_geographic else _WGS84
        if wrong and (crs is None or crs.is_geographic):
            x, y = wrong[0].lat_lon_deg[0].tolist()
            swapped = abs(x) <= 90.0 and abs(y) <= 180.0
            raise MissionError(
                f"{wrong[0].source}: expected degrees, got latitude {y:g}, longitude {x:g}: "
                + ("are they swapped?" if swapped else "projected coordinates: give --crs, e.g. EPSG:25832")
            )
        assert crs is not None
        if not wrong and not crs.is_geographic:
            raise MissionError(
                f"{found[0].source}: expected coordinates of {crs.name!r} in columns {columns[0]} and {columns[1]}, "
                "got degrees: call the columns lon and lat"
            )
        return crs

    def _columns(self, names: Sequence[str], name: str) -> tuple[tuple[str, str], CRS | None]:
        """Return the columns of east and north, and the coordinate system given for them."""
        there = dict.fromkeys(names, "")
        geographic = value(there, LONGITUDES), value(there, LATITUDES)
        if geographic[0] and geographic[1]:
            return (geographic[0][0], geographic[1][0]), self._crs
        projected = value(there, EASTINGS), value(there, NORTHINGS)
        if projected[0] and projected[1]:
            if self._crs is None:
                raise MissionError(
                    f"{name}: expected the coordinate system of columns {projected[0][0]} and {projected[1][0]}: give "
                    "--crs, e.g. --crs EPSG:25832 (EPSG:4326 for degrees)"
                )
            return (projected[0][0], projected[1][0]), self._crs
        shown = ", ".join(n for n in names if n)[:200]
        raise MissionError(f"{name}: expected columns lat and lon (or easting and northing), got {shown}")

    def _coordinate(self, tags: dict[str, str], column: str, source: str) -> float:
        found = value(tags, (column,))
        parsed = None if found is None else number(found[1].replace(" ", "").rstrip("°"))
        if parsed is None:
            got = "none" if found is None else repr(found[1])
            raise MissionError(f"{source}: expected a number in column {column}, got {got}")
        return parsed

    def _text(self, path: Path, name: str) -> str:
        content = path.read_bytes()
        wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
        encodings = ["utf-16"] if wide else ["utf-8-sig", "cp1252"]
        for encoding in encodings:
            try:
                text = content.decode(encoding)
            except UnicodeDecodeError:
                continue
            if "\0" in text:
                break
            if encoding == "cp1252":
                self.notes.append(f"{name}: is not UTF-8 and was read as Windows-1252: check its names")
            return text
        raise MissionError(f"{name}: expected a table as text (UTF-8), got something else")


def _is_tied(crs: CRS) -> bool:
    """Return whether PROJ knows where on earth a system's datum lies, within metres."""
    try:
        _transformer(crs)
    except ProjError:
        return False
    return True


def _transformer(crs: CRS) -> Transformer:
    # an unknown datum on these ellipsoids is within metres of WGS 84; on others it may be hundreds off
    harmless = crs.ellipsoid is not None and re.sub(r"[ _]", "", crs.ellipsoid.name) in {"WGS84", "GRS1980", "GRS80"}
    return Transformer.from_crs(crs, _WGS84, always_xy=True, allow_ballpark=harmless)


def _to_geo(crs: CRS, name: str) -> Transformer | None:
    """Return the way from a system to WGS 84's longitude and latitude; None: it is that.

    Raises
    ------
    MissionError
        Nobody knows it.
    """
    if crs.equals(_WGS84):
        return None
    try:
        return _transformer(crs)
    except ProjError as error:
        raise MissionError(
            f"{name}: expected a coordinate system whose datum is known, got {crs.name!r}, which may be hundreds of "
            "metres off: give the true one, e.g. --crs EPSG:31468"
        ) from error


def _doubt(to_geo: Transformer) -> str:
    """Return what is to be said of places that were just transformed; nothing: they are good."""
    try:
        used = to_geo.get_last_used_operation()
    except ProjError:
        used = to_geo  # there is one way only
    if used.accuracy > _GOOD_M:
        return f"places are good to {used.accuracy:g} m only ({used.description.strip()[:120]})"
    if "allpark" in used.description:
        return "the datum of its coordinate system is unknown and was taken for WGS 84"
    return ""


def _suffix(path: Path) -> str:
    name = path.name.lower()
    return next((suffix for suffix in _OSM_SUFFIXES if name.endswith(suffix)), path.suffix.lower())


def _reason(error: Exception | Warning | str, source: Path | bytes) -> str:
    """Return what GDAL says, on one line, without the names that only we and GDAL know."""
    text = re.sub(r"/vsimem/\w+", "the file", " ".join(str(error).split()))
    if isinstance(source, Path):
        text = text.replace(str(source), source.name)
    return text[:300].partition("; It might help")[0]


def _not_utf8(name: str, what: str, content: bytes, error: UnicodeDecodeError) -> MissionError:
    return MissionError(
        f"{name}: expected {what} in UTF-8, got byte 0x{content[error.start]:02x} at offset {error.start}: save it as "
        "UTF-8"
    )


def _unpack(archive: zipfile.ZipFile, folder: Path, name: str) -> list[Path]:
    """Unpack an archive's files into a folder, and return them, sorted.

    Raises
    ------
    MissionError
        Paths out of the folder, links, too many or too large files.
    """
    infos = [info for info in archive.infolist() if not info.is_dir()]
    if len(infos) > _MAX_MEMBERS:
        raise MissionError(f"{name}: expected at most {_MAX_MEMBERS} files inside, got {len(infos)}")
    left, made = _MAX_BYTES, []
    for info in infos:
        path = PurePosixPath(info.filename.replace("\\", "/"))
        linked = stat.S_ISLNK(info.external_attr >> 16)
        if path.is_absolute() or ".." in path.parts or ":" in info.filename or linked:
            raise MissionError(f"{name}: expected files inside the archive, got a way out of it: {info.filename!r}")
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(info) as packed, target.open("wb") as file:
            while block := packed.read(min(1024 * 1024, left + 1)):  # what it says of its size need not be true
                left -= len(block)
                if left < 0:
                    raise MissionError(
                        f"{name}: expected at most {_MAX_BYTES // 1024**2} MB when unpacked, got more: is it a map?"
                    )
                file.write(block)
        made.append(target)
    return sorted(made)


def _tags(names: Sequence[str], subtypes: Sequence[str], values: Sequence[Any]) -> dict[str, str]:
    """Return what is said of a feature as text; also what GDAL and Overpass pack into one value."""
    tags: dict[str, str] = {}
    for name, subtype, said in zip(names, subtypes, values, strict=True):
        text = _as_text(said)
        if not text or not name:
            continue
        if name == "other_tags":
            tags |= {plain(k): v for k, v in re.findall(r'"((?:[^"\\]|\\.)*)"=>"((?:[^"\\]|\\.)*)"', text)}
        elif name == "tags" and subtype == "OFSTJSON":
            packed = json.loads(text)
            tags |= {plain(k): str(v) for k, v in packed.items()} if isinstance(packed, dict) else {}
        else:
            tags[name] = text
    return tags


def _as_text(said: Any) -> str:
    match said:
        case None:
            return ""
        case np.ndarray():
            return ";".join(map(_as_text, said.tolist()))
        case float() | np.floating():
            return "" if np.isnan(said) else repr(int(said)) if said == int(said) else repr(float(said))
        case _:
            return str(said).strip()


def _osm_id(tags: Mapping[str, str]) -> str:
    """Return OpenStreetMap's id of a node, where it is told: ways' ids are others."""
    if "osm_node" in tags:
        return tags["osm_node"]
    whole = tags.get("@id", "") or tags.get("id", "")
    return whole.removeprefix("node/") if whole.startswith("node/") else ""


def _parts(common: MapFeature, shape: Any) -> Iterator[MapFeature]:
    """Yield the points, lines and areas that a geometry is made of."""
    match shape.geom_type:
        case "Point":
            yield replace(common, shape="point", lat_lon_deg=shapely.get_coordinates(shape), nodes=())
        case "LineString" | "LinearRing":
            places = shapely.get_coordinates(shape)
            nodes = common.nodes if len(common.nodes) == len(places) else ()
            yield replace(common, shape="line", lat_lon_deg=places, nodes=nodes)
        case "Polygon":
            places = shapely.get_coordinates(shape.exterior)
            yield replace(common, shape="area", lat_lon_deg=places, nodes=())
        case _:
            for part in shapely.get_parts(shape).tolist():
                yield from _parts(common, part)


def _placed(feature: MapFeature, to_geo: Transformer | None) -> MapFeature:
    """Return a feature with longitude, latitude (or what ``to_geo`` makes them of) as latitude and longitude."""
    x, y = feature.lat_lon_deg.T
    if to_geo is not None:
        try:
            x, y = to_geo.transform(x, y)
        except ProjError as error:
            raise MissionError(f"{feature.source}: expected coordinates of its system, got: {error}") from error
    places: FloatArray = np.stack([y, x], axis=1).astype(np.float64)
    if not (np.isfinite(places).all() and (np.abs(places) <= [84.0, 180.0]).all()):
        raise MissionError(
            f"{feature.source}: expected a place between 84 degrees south and north, got {places[0, 0]:g}, "
            f"{places[0, 1]:g}: check its coordinate system and the order of its coordinates"
        )
    return replace(feature, lat_lon_deg=places)


def _dialect(text: str) -> type[csv.Dialect]:
    """Return how a table's columns are set apart: by what its first line holds most of, outside of quotes."""
    first = re.sub(r'"[^"]*"', "", text.splitlines()[0] if text.splitlines() else "")
    separator = max(";\t,|", key=first.count)

    class Table(csv.excel):
        delimiter = separator

    return Table
