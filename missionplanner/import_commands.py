"""``missionplanner import FILE... -o MISSION``: from a utility's maps to a mission file."""

from __future__ import annotations

import os
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated

import typer

from missionplanner.errors import MissionError
from missionplanner.terminal import print_json, stderr, stdout


def import_maps(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="maps of towers and lines: GeoJSON, KML, KMZ, Shapefile, GeoPackage, CSV, OpenStreetMap (.osm, .pbf)",
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="MISSION", help="mission file to write (YAML)")],
    area: Annotated[
        str | None, typer.Option(metavar="SOUTH,WEST,NORTH,EAST", help="degrees; only towers in here are inspected")
    ] = None,
    terrain: Annotated[Path | None, typer.Option(metavar="FILE", help="elevation model (GeoTIFF, HGT)")] = None,
    geoid_undulation: Annotated[
        float | None,
        typer.Option(metavar="M", help="of the geoid above the ellipsoid, where the terrain's heights are above that"),
    ] = None,
    line: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME|VOLTAGE", help="inspect these lines, e.g. 161 or 110kV; default: highest voltage"),
    ] = None,
    tower_height: Annotated[
        float | None, typer.Option(metavar="M", min=3.0, max=400.0, help="of towers without one; default: by voltage")
    ] = None,
    as_of: Annotated[
        str | None, typer.Option(metavar="DATE", help="day from which times since inspections count; default: today")
    ] = None,
    home: Annotated[
        list[str] | None, typer.Option(metavar="LAT,LON", help="of the first, second, ... vehicle; default: assumed")
    ] = None,
    vehicles: Annotated[
        int | None, typer.Option(min=1, max=250, help="how many copters; default: one per home, else 2")
    ] = None,
    crs: Annotated[
        str | None, typer.Option(metavar="EPSG:...", help="coordinate system of files that do not say theirs")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a mission file that is there")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON on stdout instead of text")] = False,
) -> None:
    """Write a mission file, for a person to complete, from maps of power lines and what stands beside them."""
    from adapters.map_files import read_maps
    from missionplanner.files import ensure_writable, write_atomic
    from missionplanner.line_map import read_line_map
    from missionplanner.line_mission import NO_TERRAIN, Wishes, imported_mission
    from missionplanner.mission import parse_mission

    if output.exists() and not overwrite:
        raise MissionError(f"{output}: expected no such file, got one that may hold your work: give --overwrite")
    ensure_writable(output.parent)
    if geoid_undulation is not None and terrain is None:
        raise MissionError("--geoid-undulation: expected --terrain with it, got none")
    homes = tuple(_place(text) for text in home or ())
    count = vehicles if vehicles is not None else len(homes) or 2
    if len(homes) > count:
        raise MissionError(f"--home: expected at most one for each of {count} vehicles, got {len(homes)}")
    wishes = Wishes(
        name=output.stem,
        area_deg=None if area is None else _area(area),
        lines=tuple(line or ()),
        tower_height_m=tower_height,
        as_of=_day(as_of) if as_of is not None else datetime.now(UTC).date().isoformat(),
        homes_deg=homes,
        vehicles=count,
        terrain=terrain,
        geoid_undulation_m=geoid_undulation,
        terrain_as_written=NO_TERRAIN if terrain is None else Path(os.path.relpath(terrain, output.parent)),
    )
    maps = read_maps(files, crs)
    made = imported_mission(read_line_map(maps.features), wishes, [file.name for file in files], maps.notes)
    parse_mission(made.text, str(output))
    write_atomic(output, made.text)
    if as_json:
        lines = [{"name": n, "towers": towers, "voltage_kv": kv} for n, towers, kv in made.lines]
        counts = {"towers": made.towers, "obstacles": made.obstacles}
        print_json({"mission": str(output), "lines": lines, **counts, "notes": list(made.notes)})
        return
    for n, towers, kv in made.lines:
        volts = "voltage unknown" if kv is None else f"{kv:g} kV"
        stdout.print(f"line {n}: {towers} towers, {volts}", markup=False, highlight=False, soft_wrap=True)
    for note in made.notes:
        stderr.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)
    stdout.print(
        f"{output}: {made.towers} towers to inspect, {made.obstacles} obstacles, {count} vehicles; read it "
        "through, then validate it",
        markup=False,
        highlight=False,
        soft_wrap=True,
    )


def _numbers(text: str, count: int) -> list[float] | None:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return None
    return numbers if len(numbers) == count else None


def _area(text: str) -> tuple[float, float, float, float]:
    numbers = _numbers(text, 4)
    if numbers is None:
        raise MissionError(f"--area: expected SOUTH,WEST,NORTH,EAST in degrees, e.g. 49.9,11.3,50.1,11.7, got {text!r}")
    south, west, north, east = numbers
    if not (-84 <= south < north <= 84 and -180 <= west < east <= 180):
        raise MissionError(
            f"--area: expected SOUTH,WEST,NORTH,EAST with south below north and west below east, got {text!r}"
        )
    return south, west, north, east


def _place(text: str) -> tuple[float, float]:
    numbers = _numbers(text, 2)
    if numbers is None or not (abs(numbers[0]) <= 84 and abs(numbers[1]) <= 180):
        raise MissionError(f"--home: expected LAT,LON in degrees, e.g. 47.14,9.52, got {text!r}")
    return numbers[0], numbers[1]


def _day(text: str) -> str:
    try:
        return date.fromisoformat(text).isoformat()
    except ValueError:
        raise MissionError(f"--as-of: expected a date, e.g. 2026-05-04, got {text!r}") from None
