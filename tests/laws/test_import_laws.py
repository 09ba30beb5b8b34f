"""Whatever the format, a line is imported with its towers where they are, in their order."""

from __future__ import annotations

import random
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.errors import MissionError
from missionplanner.map_tags import iso_dates
from tests import maps

Towers = list[tuple[float, float]]
STRAIGHT = [(round(47.0 + 0.002 * k, 7), 9.5) for k in range(5)]
TOLERANCE_DEG = 1.5e-7  # as written, to seven places; projected coordinates there and back


def same(found: Towers, towers: Towers) -> bool:
    return len(found) == len(towers) and bool(np.abs(np.array(found) - np.array(towers)).max() <= TOLERANCE_DEG)


WRITERS: dict[str, Any] = {
    "towers.geojson": maps.geojson,
    "towers.kml": maps.kml,
    "towers.kmz": maps.kmz,
    "towers.shp": maps.shapefile,
    "towers.osm": maps.osm,
    "towers.osm.pbf": maps.osm,
}


@pytest.mark.parametrize("name", WRITERS)
@given(towers=maps.routes())
@settings(max_examples=8)
def test_a_drawn_line_keeps_its_towers_and_their_order(name: str, towers: Towers) -> None:
    with TemporaryDirectory() as folder:
        made, mission = maps.imported(WRITERS[name](Path(folder) / name, towers))
    assert made.lines[0][0] in {"L1", "110-kV-L1"}
    assert same(maps.line_places(mission), towers)
    assert mission.obstacles == ()


@given(towers=maps.routes(), seed=st.integers(0, 1000))
@settings(max_examples=20)
def test_a_table_is_sorted_by_its_order_column(towers: Towers, seed: int) -> None:
    order = list(range(len(towers)))
    random.Random(seed).shuffle(order)
    with TemporaryDirectory() as folder:
        _, mission = maps.imported(maps.csv(Path(folder) / "towers.csv", towers, order))
    assert same(maps.line_places(mission), towers)
    assert mission.inspection is not None
    assert {tower.height_m for tower in mission.inspection.towers} == {31.5}
    assert {tower.assumed for tower in mission.inspection.towers} == {()}


@given(towers=maps.routes(turn_deg=25.0), seed=st.integers(0, 1000))
@settings(max_examples=15)
def test_towers_without_a_line_are_ordered_along_it_one_way_or_the_other(towers: Towers, seed: int) -> None:
    mixed = towers.copy()
    random.Random(seed).shuffle(mixed)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "towers.csv"
        rows = ["lat,lon", *(f"{lat!r},{lon!r}" for lat, lon in mixed)]
        path.write_text("\n".join(rows) + "\n", encoding="utf-8")
        made, mission = maps.imported(path)
    found = maps.line_places(mission)
    assert same(found, towers) or same(found[::-1], towers)
    assert any("towers in order of" in note for note in made.notes)


@given(towers=maps.routes(least=4), cut=st.integers(1, 18), turned=st.tuples(st.booleans(), st.booleans()))
@settings(max_examples=20)
def test_pieces_that_continue_each_other_are_one_line(towers: Towers, cut: int, turned: tuple[bool, bool]) -> None:
    cut = min(cut, len(towers) - 2)
    pieces = [towers[: cut + 1], towers[cut:]]
    with TemporaryDirectory() as folder:
        paths = [
            maps.geojson(Path(folder) / f"{k}.geojson", piece[::-1] if turned[k] else piece)
            for k, piece in enumerate(pieces)
        ]
        _, mission = maps.imported(*paths)
    assert mission.inspection is not None
    assert len(mission.inspection.lines) == 1
    found = maps.line_places(mission)
    assert same(found[::-1] if turned[0] else found, towers)  # the first piece says which way the line goes


@given(towers=maps.routes(), seed=st.integers(0, 9))
@settings(max_examples=10)
def test_the_same_maps_give_the_same_bytes(towers: Towers, seed: int) -> None:
    with TemporaryDirectory() as folder:
        path = maps.geojson(Path(folder) / "towers.geojson", towers)
        assert maps.imported(path, vehicles=1 + seed)[0].text == maps.imported(path, vehicles=1 + seed)[0].text


@given(st.dates(min_value=date(1950, 1, 1)))
def test_a_day_is_the_same_however_it_is_written(day: Any) -> None:
    spellings = [
        day.isoformat(),
        day.strftime("%Y/%m/%d"),
        day.strftime("%Y%m%d"),
        day.strftime("%d.%m.%Y"),
        f"{day.day}.{day.month}.{day.year}",
        day.strftime("%d %B %Y"),
        day.strftime("%b %d, %Y"),
        day.isoformat() + "T12:30:00Z",
    ]
    assert set(iso_dates((f"row {k}", text) for k, text in enumerate(spellings)).values()) == {day.isoformat()}


@given(st.lists(st.dates(min_value=date(1950, 1, 1)), min_size=1, max_size=8), st.booleans())
def test_slashed_dates_are_read_as_the_whole_table_can_be_or_refused(days: list[Any], day_first: bool) -> None:
    pattern = "%d/%m/%Y" if day_first else "%m/%d/%Y"
    texts = [(f"row {k}", day.strftime(pattern)) for k, day in enumerate(days)]
    if any(day.day > 12 for day in days) or all(day.day == day.month for day in days):
        assert list(iso_dates(texts).values()) == [day.isoformat() for day in days]
    else:
        with pytest.raises(Exception, match="day or month first"):
            iso_dates(texts)


@pytest.mark.parametrize("name", [*WRITERS, "towers.csv"])
@given(data=st.data())
@settings(max_examples=12)
def test_a_damaged_map_is_read_or_refused_in_one_line(name: str, data: st.DataObject) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        if name.endswith(".csv"):
            maps.csv(path, STRAIGHT, range(len(STRAIGHT)))
        else:
            WRITERS[name](path, STRAIGHT)
        content = bytearray(path.read_bytes())
        for _ in range(data.draw(st.integers(1, 4), label="damages")):
            at = data.draw(st.integers(0, len(content) - 1), label="at")
            length = data.draw(st.integers(0, 40), label="bytes replaced")
            content[at : at + length] = data.draw(st.binary(max_size=8), label="by")
            content = content or bytearray(b"\0")
        path.write_bytes(content)
        try:
            maps.imported(path)
        except MissionError as refusal:
            assert "\n" not in str(refusal)
            assert len(str(refusal)) < 900
