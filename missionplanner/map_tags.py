"""What a map says of a thing: the names and spellings that utilities and OpenStreetMap use for it.

Names of attributes come as :func:`plain` leaves them. Elevations (``ele``, ``ground_elev_m``, a point's third number)
are never heights.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Literal

from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray

Kind = Literal["tower", "pylon", "mast", "turbine", "power", "aerialway", "underground", "other"]
"""Of points: a tower of a power line, a pylon of an aerialway; of lines: power, aerialway, underground."""


@dataclass(frozen=True, slots=True, eq=False)
class MapFeature:
    """One thing on a map: its places (N, 2) as latitude and longitude, WGS84, and what is said of it."""

    shape: Literal["point", "line", "area"]
    lat_lon_deg: FloatArray
    tags: Mapping[str, str]
    source: str  # what errors call it: "lines.geojson, feature 3"
    id: str = ""  # of OpenStreetMap's node or way
    nodes: tuple[str, ...] = ()  # ids of a line's vertices, where the file tells them
    openstreetmap: bool = False  # only what is tagged so is a tower or a line


def plain(name: str) -> str:
    """Return an attribute's name in small letters without accents, units and spaces: ``Höhe [m]`` is ``hoehe_m``."""
    name = name.lower().replace("ä", "ae").replace("ö", "oe").replace("ü", "ue").replace("ß", "ss")
    name = "".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))
    return re.sub(r"[^a-z0-9:@]+", "_", name).strip("_")


NAMES = (
    *("ref", "name", "tower", "tower_name", "tower_id", "tower_no", "tower_nr", "mast", "mast_nr", "mastnr"),
    *("mastnummer", "mast_name", "mastbezeichnung", "pole", "pole_id", "support", "structure", "pylon", "bezeichnung"),
    *("label", "nummer", "number", "nr", "no", "id", "objectid", "fid"),
)
HEIGHTS = (
    *("height", "height_m", "tower:height", "tower_height", "tower_height_m", "height_agl", "height_agl_m"),
    *("structure_height", "h", "h_m", "hoehe", "hoehe_m", "masthoehe", "masthoehe_m", "gesamthoehe", "gesamthoehe_m"),
    *("bauhoehe", "hauteur", "altezza", "altura"),
)
_WHOLE_HEIGHTS = (
    *("hoehe_ueber_grund", "hoehe_ueber_grund_m", "hoehe_ueber_gelaende", "hoehe_ueber_gelaende_m", "hoehe_ue_grund"),
    *("hoehe_ue_grund_m", "hoehe_ue_gelaende", "hoehe_ueber_gok", "hoehe_ue_gok", "hoehe_ueber_boden", "hoehe_gok"),
    *("hoehe_agl", "mast_hoehe", "mast_hoehe_m", "turmhoehe", "turmhoehe_m", "height_above_ground", "agl", "agl_m"),
    *("height_above_ground_m", "height_above_ground_level", "mast_height", "mast_height_m", "pole_height", "hgt"),
    *("pole_height_m", "total_height", "total_height_m", "hauteur_m", "hauteur_hors_sol", "altezza_m", "altura_m"),
)
"""Heights too, but never by the start of their names: ``hoehe_uebe`` may be an elevation."""
_LOOKS_HIGH = re.compile(r"hoehe|height|hgt|hauteur|altezza|altura|(^|_)(h|agl)(_|$)")
_ELEVATION = re.compile(r"(^|_)(nn|nhn|amsl|msl|ele|elev|elevation|sea|z)(_|$)|meer|adria|gelaendehoehe|ground_height")
_HEIGHTS_FT = ("height_ft", "tower_height_ft", "structure_height_ft", "height_feet")
LINES = (
    *("line", "line_name", "line_id", "line_no", "line_nr", "line_ref", "leitung", "leitungsname", "leitungsnr"),
    *("leitung_nr", "ltg", "ltg_nr", "ltgnr", "circuit", "circuit_name", "stromkreis", "trasse", "feeder", "ligne"),
    "linea",
)
LAYER = "@layer"
"""Under this name readers tell the layer of a file, or the folder of placemarks, that a thing is in."""
ORDERS = ("order", "seq", "sequence", "sequence_no", "reihenfolge", "position_no", "lfd", "lfd_nr", "lfdnr", "index")
_VOLTAGES_KV = ("voltage_kv", "kv", "u_kv", "un_kv", "spannung_kv", "nennspannung_kv", "nominal_kv")
_VOLTAGES = ("voltage", "spannung", "nennspannung", "spannungsebene", "un", "tension", "volt")
INSPECTIONS = (
    *("last_inspected", "last_inspection", "last_inspection_date", "inspected", "inspected_on", "inspection_date"),
    *("date_inspected", "letzte_inspektion", "letzte_begehung", "letzte_befliegung", "letzte_kontrolle", "inspektion"),
    *("begehung", "befliegung", "derniere_inspection", "ultima_ispezione", "ultima_inspeccion"),
)
_TYPES = ("type", "typ", "art", "kind", "objektart", "class", "klasse", "category", "kategorie", "feature_type")
LATITUDES = ("lat", "latitude", "lat_deg", "breite", "breitengrad", "geo_lat", "wgs84_lat", "geographische_breite")
LONGITUDES = ("lon", "long", "lng", "longitude", "lon_deg", "laenge", "laengengrad", "geo_lon", "geo_lng", "wgs84_lon")
EASTINGS = ("x", "easting", "east", "e", "rechtswert", "ostwert", "utm_e", "x_coord", "x_koordinate", "xcoord", "x_m")
NORTHINGS = ("y", "northing", "north", "n", "hochwert", "nordwert", "utm_n", "y_coord", "y_koordinate", "ycoord", "y_m")

_SHAPEFILE_NAME = 10  # Shapefiles cut names off there

_BUILT, _ROPED, _MADE = (
    (key, f"disused:{key}", f"abandoned:{key}", f"construction:{key}") for key in ("power", "aerialway", "man_made")
)
KEYS = (*_BUILT, *_ROPED, *_MADE, "generator:source")
"""OpenStreetMap's keys that tell what a thing is."""
_SUPPORTS = {"tower", "pole", "portal", "terminal"}
_WIRES = {"line", "minor_line"}
_HIDDEN = {"underground", "underwater", "submarine", "indoor"}
_TALL = {
    *("mast", "tower", "chimney", "communications_tower", "antenna", "water_tower", "silo", "gasometer", "crane"),
    *("lighthouse", "windmill", "flagpole", "observatory", "obelisk", "cooling_tower", "storage_tank", "telescope"),
    *("flare", "beacon", "monitoring_station", "goods_conveyor"),
}
_ON_THE_GROUND = {"magic_carpet", "station", "pylon", "no"}


def value(tags: Mapping[str, str], names: Sequence[str]) -> tuple[str, str] | None:
    """Return name and value of the first of these attributes that is there."""
    for name in names:
        if name in tags:
            return name, tags[name]
    for name in names:
        cut = name[:_SHAPEFILE_NAME]
        if len(name) > _SHAPEFILE_NAME and cut in tags:
            return name, tags[cut]
    return None


def kind(feature: MapFeature) -> Kind:
    """Return what a thing is, as far as planning must know."""
    tags, shape = feature.tags, feature.shape
    power = value(tags, _BUILT)
    roped = value(tags, _ROPED)
    if shape == "line" and (_hidden(tags) or (power and power[1] == "cable" and tags.get("location") != "overhead")):
        return "underground"
    if power and power[1] in _SUPPORTS:  # large ones are drawn as areas, portals as lines
        return "tower"
    if power and shape == "line" and power[1] in {*_WIRES, "cable"}:
        return "power"
    if power and power[1] == "generator" and tags.get("generator:source") == "wind":
        return "turbine" if shape != "line" or _closed(feature) else "other"
    if roped:
        if roped[1] == "pylon":
            return "pylon"
        return "aerialway" if shape == "line" and roped[1] not in _ON_THE_GROUND else "other"
    made = made_of(tags)
    if made in _TALL:
        return "mast" if shape != "line" or _closed(feature) else "other"
    if feature.openstreetmap or power or made or shape == "area":
        return "other"
    return _kind_by_type(feature)


def _kind_by_type(feature: MapFeature) -> Kind:
    """Return what a utility's thing is: points are towers and lines are lines, unless a column says otherwise."""
    named = value(feature.tags, _TYPES)
    said = plain(named[1]) if named else ""
    if feature.shape == "point":
        carries = re.search(r"mast|tower|pole|pylon", said)  # a transformer on a pole stands on a pole
        if not carries and re.search(r"station|umspann|trafo|schalt|transformer|substation|building|gebaeude", said):
            return "other"
        return "turbine" if re.search(r"wind_?(turbine|kraft|energie|rad)", said) else "tower"
    in_the_air = re.search(r"seilbahn|luft|frei|overhead|aerial", said)
    if re.search(r"erdkabel|underground|kabel|^cable(?!_car)|submarine", said) and not in_the_air:
        return "underground"
    if re.search(r"seilbahn|ski_?lift|sessellift|chair|gondola|ropeway|aerialway|cable_car", said):
        return "aerialway"
    return "other" if re.search(r"road|strasse|river|fluss|grenze|boundary", said) else "power"


def made_of(tags: Mapping[str, str]) -> str:
    """Return what a man-made thing is, whether or not it is in use; nothing: it is not called man-made."""
    found = value(tags, _MADE)
    return found[1] if found else ""


def called(feature: MapFeature) -> str:
    """Return what a map calls the kind of a thing that planning does not know."""
    found = next((f for keys in (_BUILT, _ROPED, _MADE, _TYPES) if (f := value(feature.tags, keys))), None)
    return f"{found[0]}={found[1]}" if found else f"{feature.shape} without a type that is known"


def unread_heights(feature: MapFeature) -> tuple[str, ...]:
    """Return attributes that look like heights above ground, of a thing none of whose is read as one."""
    if feature.openstreetmap or height_m(feature) is not None:
        return ()
    return tuple(name for name in feature.tags if _LOOKS_HIGH.search(name) and not _ELEVATION.search(name))


def _hidden(tags: Mapping[str, str]) -> bool:
    return any(tags.get(key) in _HIDDEN for key in ("location", "position")) or tags.get("tunnel") == "yes"


def _closed(feature: MapFeature) -> bool:
    places = feature.lat_lon_deg
    return len(places) > 3 and bool((places[0] == places[-1]).all())


def is_minor(feature: MapFeature) -> bool:
    """Return whether a power line is tagged as one of the local net, or as one that is not in use."""
    tags = feature.tags
    return tags.get("power") == "minor_line" or ("power" not in tags and value(tags, _BUILT) is not None)


HEIGHT_RANGE_M = (3.0, 400.0)
"""Of towers: the tallest stands 380 m high."""
_LEAST_VOLTS = 200.0  # of an overhead line: fewer are kilovolts, whatever OpenStreetMap asks for
_MOST_KILOVOLTS = 1500.0  # no line has more: more are volts

_NUMBER = re.compile(r"[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?")


def number(text: str) -> float | None:
    """Return the number that a text is; decimal commas count, thousands are not set apart."""
    match = _NUMBER.fullmatch(text.strip())
    found = float(match.group().replace(",", ".")) if match else math.nan
    return found if math.isfinite(found) else None


def height_m(feature: MapFeature) -> tuple[str, float] | None:
    """Return the attribute and the height above ground that it states, in metres.

    What OpenStreetMap's volunteers wrote and nobody can read as a tower's height is none: its reader cannot mend it.

    Raises
    ------
    MissionError
        It is no height.
    """
    found = value(feature.tags, (*HEIGHTS, *_HEIGHTS_FT))
    found = found or next(((name, feature.tags[name]) for name in _WHOLE_HEIGHTS if name in feature.tags), None)
    if found is None:
        return None
    name, text = found
    match = re.fullmatch(r"\s*~?\s*([\d.,]+)\s*(m|metres?|meters?|ft|feet|')?\s*", text.lower())
    metres = number(match.group(1)) if match else None
    if match is not None and metres is not None:
        in_feet = match.group(2) in {"ft", "feet", "'"} or name in _HEIGHTS_FT
        metres = metres * 0.3048 if in_feet else metres
    if feature.openstreetmap and not (metres is not None and HEIGHT_RANGE_M[0] <= metres <= HEIGHT_RANGE_M[1]):
        return None
    if metres is None or metres <= 0.0:
        raise MissionError(f"{feature.source}: expected a height in metres, e.g. 35 or 35 m, got {name} {text!r}")
    return name, metres


def voltage_kv(feature: MapFeature) -> float | None:
    """Return the highest voltage that is stated; OpenStreetMap's numbers are volts, others' small ones kilovolts."""
    found = value(feature.tags, (*_VOLTAGES_KV, *_VOLTAGES))
    if found is None:
        return None
    name, text = found
    known = []
    for part in re.split(r"[;/|]", text):
        match = re.fullmatch(r"\s*([\d.,]+)\s*(kv|v)?\s*(?:ac|dc)?\s*", part.lower())
        volts = number(match.group(1)) if match else None
        if match is None or volts is None or volts <= 0.0:
            continue  # "medium", "unknown": no voltage that could be counted with
        kilo = match.group(2) == "kv" or name in _VOLTAGES_KV
        if match.group(2) is None and name not in _VOLTAGES_KV:
            kilo = volts < (_LEAST_VOLTS if feature.openstreetmap else _MOST_KILOVOLTS)
        known.append(volts if kilo else volts / 1000.0)
    return max(known, default=None)


def parts(text: str) -> tuple[str, ...]:
    """Return the parts of a list in one value: OpenStreetMap and many tables set them apart by semicolons."""
    return tuple(part.strip() for part in re.split(r"[;|]", text) if part.strip())


_MONTHS = {
    name: month
    for month, names in enumerate(
        (
            *("jan january januar janvier", "feb february februar fevrier", "mar march maerz mrz mars"),
            *("apr april avril", "may mai", "jun june juni juin", "jul july juli juillet", "aug august aout"),
            *("sep sept september septembre", "oct october okt oktober octobre", "nov november novembre"),
            "dec december dez dezember decembre",
        ),
        start=1,
    )
    for name in names.split()
}


def iso_dates(texts: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return days as ISO 8601 writes them, by what errors call them.

    A year or month alone counts from its first day. ``05/04/2024`` is read as all of a table's dates can be read.

    Raises
    ------
    MissionError
        No date; dates that may be read either way.
    """
    texts = list(texts)
    slashed = [(int(m[1]), int(m[2])) for _, text in texts if (m := re.match(r"\s*(\d{1,2})/(\d{1,2})/\d{4}", text))]
    day_first = any(first > 12 for first, _ in slashed)
    month_first = any(second > 12 for _, second in slashed)
    return {where: _iso_date(where, text, day_first, month_first) for where, text in texts}


def _iso_date(where: str, text: str, day_first: bool, month_first: bool) -> str:
    bare = text.strip()
    try:
        if match := re.match(r"(\d{4})(?:[-/.](\d{1,2}))?(?:[-/.](\d{1,2}))?(?=$|[T ])", bare):
            return date(*(int(part or 1) for part in match.groups())).isoformat()
        if match := re.fullmatch(r"(\d{4})(\d{2})(\d{2})", bare):
            return date(*map(int, match.groups())).isoformat()
        if match := re.match(r"(\d{1,2})\.\s?(\d{1,2})\.\s?(\d{4})(?=$|[T ])", bare):
            return date(int(match[3]), int(match[2]), int(match[1])).isoformat()
        if match := re.match(r"(\d{1,2})/(\d{1,2})/(\d{4})(?=$|[T ])", bare):
            first, second = int(match[1]), int(match[2])
            if max(first, second) <= 12 and first != second and day_first == month_first:
                raise MissionError(
                    f"{where}: expected a date that can be read in one way only, got {bare!r}: day or month first? "
                    "Write 2026-05-04"
                )
            backwards = second > 12 or (first <= 12 and month_first)
            day, month = (second, first) if backwards else (first, second)
            return date(int(match[3]), month, day).isoformat()
        words = plain(bare).split("_")
        months = [word for word in words if word in _MONTHS]
        numbers = [int(word) for word in words if word.isdigit()]
        if len(words) == 3 and len(months) == 1 and len(numbers) == 2 and max(numbers) > 31:
            return date(max(numbers), _MONTHS[months[0]], min(numbers)).isoformat()
    except ValueError:
        pass  # the 31st of February: told below
    raise MissionError(f"{where}: expected a date, e.g. 2026-05-04 or 04.05.2026, got {bare!r}")
