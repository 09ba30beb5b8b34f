"""Who inspects which tower, as a table for spreadsheets (CSV) and for GIS (GeoJSON), and what of it was seen.

A row for every visit (see :mod:`missionplanner.tower_rows`). Both hold the same fields, with units in their names: CSV
as RFC 4180 has it, in UTF-8; GeoJSON as RFC 7946, towers as points, spans as lines from tower to tower.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path

from missionplanner.files import write_atomic
from missionplanner.tower_rows import Seen, Sortied, TowerRow, tower_rows

__all__ = ["CSV_NAME", "GEOJSON_NAME", "tower_csv", "tower_geojson", "tower_rows", "write_tower_table"]

CSV_NAME, GEOJSON_NAME = "towers.csv", "towers.geojson"

Value = str | float | int | bool | None


def write_tower_table(folder: Path, name: str, rows: Sequence[TowerRow]) -> list[Path]:
    """Write ``towers.csv`` and ``towers.geojson`` into ``folder`` and return their paths.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    texts = {CSV_NAME: tower_csv(rows), GEOJSON_NAME: tower_geojson(rows, name)}
    for file, text in texts.items():
        write_atomic(folder / file, text)
    return [folder / file for file in texts]


def tower_csv(rows: Sequence[TowerRow]) -> str:
    """Return the table as CSV; what is not known, or not asked for, is empty."""
    text = io.StringIO()
    writer = csv.writer(text)  # RFC 4180: commas, lines that end with CR LF, quotes where they are needed
    flat = [{**_place(row), **_fields(row)} for row in rows]
    writer.writerow(_COLUMNS)
    writer.writerows([[_cell(fields[column]) for column in _COLUMNS] for fields in flat])
    return text.getvalue()


def tower_geojson(rows: Sequence[TowerRow], name: str) -> str:
    """Return the table as a GeoJSON feature collection, without heights: they would be above the ellipsoid."""
    features = []
    for row in rows:
        places = [[round(lon_deg, 7), round(lat_deg, 7)] for lat_deg, lon_deg in row.place_deg]
        geometry = (
            {"type": "Point", "coordinates": places[0]}
            if row.kind == "tower"
            else {"type": "LineString", "coordinates": places}
        )
        features.append({"type": "Feature", "properties": _fields(row), "geometry": geometry})
    document = {"type": "FeatureCollection", "name": name, "features": features}
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _place(row: TowerRow) -> dict[str, Value]:
    """Return where a target is: of a span, its middle."""
    lat_deg, lon_deg = (sum(values) / len(row.place_deg) for values in zip(*row.place_deg, strict=True))
    return {"lat_deg": round(lat_deg, 7), "lon_deg": round(lon_deg, 7)}


def _fields(row: TowerRow) -> dict[str, Value]:
    return {
        "target": row.target,
        "kind": row.kind,
        "line": "; ".join(row.lines),
        "top_alt_amsl_m": _rounded(row.top_alt_amsl_m, 1),
        "height_m": _rounded(row.height_m, 1),
        "weight": row.weight,
        "last_inspected": row.last_inspected,
        "visit": row.visit,
        "status": row.status,
        "note": row.note,
        **(dict.fromkeys(_SORTIE) if row.sortie is None else _sortie_fields(row.sortie)),
        **(dict.fromkeys(_SEEN) if row.seen is None else _seen_fields(row.seen)),
    }


def _sortie_fields(sortie: Sortied) -> dict[str, Value]:
    return {
        "vehicle": sortie.vehicle,
        "sysid": sortie.sysid,
        "round": sortie.round,
        "order_in_sortie": sortie.order,
        "begins_s": _rounded(sortie.begins_s, 1),
        "ends_s": _rounded(sortie.ends_s, 1),
        "round_begins_s": _rounded(sortie.round_begins_s, 1),
        "photos": sortie.photos,
        "viewpoints": sortie.viewpoints,
    }


def _seen_fields(seen: Seen) -> dict[str, Value]:
    return {
        "seen": seen.seen,
        "seen_share": _rounded(seen.share, 3),
        "seen_by": "; ".join(seen.vehicles),
        "seen_distance_m": _rounded(seen.distance_m, 1),
        "seen_angle_deg": _rounded(seen.angle_deg, 1),
        "seen_gsd_mm": _rounded(seen.gsd_mm, 2),
        "seen_photos": seen.photos,
        "why_not_seen": seen.why,
    }


_SORTIE = (
    *("vehicle", "sysid", "round", "order_in_sortie", "begins_s", "ends_s", "round_begins_s", "photos"),
    "viewpoints",
)
_SEEN = (
    *("seen", "seen_share", "seen_by", "seen_distance_m", "seen_angle_deg", "seen_gsd_mm", "seen_photos"),
    "why_not_seen",
)
_COLUMNS = (
    *("target", "kind", "line", "lat_deg", "lon_deg", "top_alt_amsl_m", "height_m", "weight", "last_inspected"),
    *("visit", "status", "note", *_SORTIE, *_SEEN),
)


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits) + 0.0


def _cell(value: Value) -> str:
    match value:
        case None:
            return ""
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.10g}"
        case _:
            return str(value)
