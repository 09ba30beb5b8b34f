"""Lines from what maps draw, on places in metres around one origin."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from missionplanner.errors import MissionError
from missionplanner.geodesy import LocalFrame
from missionplanner.line_map import LineMap, Wire, read_line_map
from missionplanner.map_tags import LAYER, MapFeature

FRAME = LocalFrame(47.0, 9.5)
XY = tuple[float, float]


def places(xy_m: Sequence[XY]) -> np.ndarray:
    lat, lon, _ = FRAME.to_geo(np.column_stack([np.array(xy_m), np.zeros(len(xy_m))]))
    return np.stack([lat, lon], axis=1)


def line(xy_m: Sequence[XY], *, nodes: Sequence[int] = (), osm: bool = False, **tags: str) -> MapFeature:
    ids = tuple(map(str, nodes))
    return MapFeature("line", places(xy_m), tags, "map, line", "", ids, osm)


def tower(x: float, y: float = 0.0, *, node: int | None = None, osm: bool = False, **tags: str) -> MapFeature:
    name = "" if node is None else str(node)
    return MapFeature("point", places([(x, y)]), tags, f"map, tower at {x:g}, {y:g}", name, (), osm)


def row(*xs: float, y: float = 0.0) -> list[XY]:
    return [(x, y) for x in xs]


def along(found: LineMap, wire: Wire) -> list[tuple[int, int]]:
    """Return a line's supports as metres from the origin."""
    at_deg = np.array([found.supports[s].lat_lon_deg for s in wire.supports])
    xy = FRAME.to_local(at_deg[:, 0], at_deg[:, 1], 0.0)[:, :2]
    return [(round(x), round(y)) for x, y in xy.tolist()]


def tagged(found: LineMap, wire: Wire) -> list[bool]:
    return [found.supports[s].tagged for s in wire.supports]


def test_towers_a_few_metres_off_the_vertices_are_the_lines() -> None:
    found = read_line_map([line(row(0, 200, 400)), tower(0, 4), tower(203, -3), tower(400)])
    (wire,) = found.wires
    assert along(found, wire) == [(0, 4), (203, -3), (400, 0)]
    assert all(tagged(found, wire))
    assert found.alone == ()


def test_vertices_without_a_tower_are_taken_for_one_and_marked() -> None:
    found = read_line_map([line(row(0, 200, 400)), tower(0), tower(400)])
    (wire,) = found.wires
    assert tagged(found, wire) == [True, False, True]


def test_ids_go_before_distance() -> None:
    near_another = line([(0, 0), (200, 0), (400, 0)], nodes=[1, 2, 3], osm=True, power="line")
    other = tower(201, 3, node=9, osm=True, power="tower")  # of a line beside it
    mine = [tower(0, node=1, osm=True, power="tower"), tower(400, node=3, osm=True, power="tower")]
    found = read_line_map([near_another, other, *mine])
    assert tagged(found, found.wires[0]) == [True, False, True]
    assert len(found.alone) == 1


def test_towers_between_the_vertices_of_a_rough_drawing_carry_it_in_order() -> None:
    drawn = line([(0, 0), (1000, 0), (1000, 1000)])
    towers = [tower(700, 12), tower(300, -10), tower(0), tower(998, 3), tower(1010, 600), tower(1000, 1000)]
    found = read_line_map([drawn, *towers])
    (wire,) = found.wires
    assert along(found, wire) == [(0, 0), (300, -10), (700, 12), (998, 3), (1010, 600), (1000, 1000)]
    assert all(tagged(found, wire))


def test_two_circuits_share_their_towers() -> None:
    found = read_line_map([line(row(0, 200, 400, 600), ref="161"), line(row(200, 400, 600, y=5), ref="162")])
    first, second = found.wires
    assert second.supports == first.supports[1:]


def test_the_same_line_in_two_files_is_one() -> None:
    found = read_line_map([line(row(0, 200, 400), ref="161"), line(row(400, 200, 0), ref="161")])
    assert len(found.wires) == 1


@pytest.mark.parametrize(
    ("first", "second", "one"),
    [
        ({"ref": "161"}, {"ref": "161"}, True),
        ({"ref": "161"}, {}, True),
        ({"ref": "161"}, {"ref": "162"}, False),
        ({"voltage": "110"}, {"voltage": "220"}, False),
        ({"voltage": "110"}, {}, True),
        ({"power": "line"}, {"power": "minor_line"}, False),
        ({"power": "line"}, {"aerialway": "gondola"}, False),
    ],
)
def test_pieces_are_joined_unless_they_are_different_lines(
    first: dict[str, str], second: dict[str, str], one: bool
) -> None:
    found = read_line_map([line(row(0, 200, 400), **first), line(row(400, 600), **second)])
    assert len(found.wires) == (1 if one else 2)


def test_at_a_branch_only_pieces_of_one_name_are_joined() -> None:
    main = [line(row(0, 200, 400), ref="161"), line(row(400, 600), ref="161")]
    branch = line([(400, 0), (400, 200)])
    found = read_line_map([*main, branch])
    assert sorted(len(wire.supports) for wire in found.wires) == [2, 4]


def test_a_ring_in_two_halves_is_one_line_that_ends_where_it_begins_or_two() -> None:
    half = line([(0, 0), (200, 100), (400, 0)], ref="r")
    found = read_line_map([half, line([(400, 0), (200, -100), (0, 0)], ref="r")])
    ends = {wire.supports[0] for wire in found.wires} | {wire.supports[-1] for wire in found.wires}
    assert sum(len(wire.supports) - 1 for wire in found.wires) == 4
    assert ends


def test_a_table_names_the_lines_of_its_towers_and_a_tower_may_carry_two() -> None:
    a = [tower(x, line="A", order=str(x / 200)) for x in (400, 0, 600)]
    both = tower(200, line="A;B", order="1")
    b = [tower(200, -200, line="B", order="0"), tower(200, 200, line="B", order="2")]
    found = read_line_map([*a, both, *b])
    assert {wire.labels[0]: along(found, wire) for wire in found.wires} == {
        "A": [(0, 0), (200, 0), (400, 0), (600, 0)],
        "B": [(200, -200), (200, 0), (200, 200)],
    }
    assert {wire.ordered_by for wire in found.wires} == {""}


def test_towers_of_one_folder_are_one_line_where_none_is_drawn() -> None:
    folders = {"110 kV Nord": 0.0, "Süd": 500.0}
    towers = [tower(x, y, name=f"{x:g}", **{LAYER: name}) for name, y in folders.items() for x in (0, 200, 400)]
    found = read_line_map(towers)
    assert {wire.labels[0]: (along(found, wire)[0], wire.voltage_kv) for wire in found.wires} == {
        "110 kV Nord": ((0, 0), 110.0),
        "Süd": ((0, 500), None),
    }
    drawn = read_line_map([*towers, line([(0, 900), (200, 900)])])
    assert len(drawn.wires) == 1
    assert len(drawn.alone) == 6


def test_a_tower_in_two_rows_is_one_with_the_greater_height_and_the_later_inspection() -> None:
    rows = [
        tower(0, line="A", order="1", height="30", last_inspected="2020-01-01"),
        tower(0, line="B", order="7", height="33", last_inspected="2022-01-01"),
        *(tower(200, y, line=name, order="2") for name, y in (("A", 0.0), ("B", 200.0))),
    ]
    found = read_line_map(rows)
    assert len(found.supports) == 3
    assert found.supports[0].lines == {"A": 1.0, "B": 7.0}
    assert (found.supports[0].height_m, found.supports[0].last_inspected) == (33.0, "2022-01-01")


@pytest.mark.parametrize(
    ("labels", "by"),
    [
        (["M10", "M7", "M8", "M9"], "the numbers in their names"),
        (["a", "b", "c", "d"], "the shortest way through them"),
        (["M2", "M8", "M7", "M1"], "the shortest way through them"),  # numbers that make no line
    ],
)
def test_what_the_order_was_taken_from_is_told(labels: list[str], by: str) -> None:
    towers = [tower(x, name=label) for x, label in zip((600, 0, 200, 400), labels, strict=True)]
    found = read_line_map(towers)
    (wire,) = found.wires
    assert wire.ordered_by == by
    assert along(found, wire) in ([(0, 0), (200, 0), (400, 0), (600, 0)], [(600, 0), (400, 0), (200, 0), (0, 0)])


def test_towers_further_apart_than_any_span_are_lines_of_their_own() -> None:
    towers = [tower(x, y, name=f"{side}{x}") for side, y in (("A", 0), ("B", 11_000)) for x in (0, 300, 600)]
    found = read_line_map(towers)
    assert {frozenset(along(found, wire)) for wire in found.wires} == {
        frozenset((x, y) for x in (0, 300, 600)) for y in (0, 11_000)
    }
    assert all("lines of their own" in wire.ordered_by for wire in found.wires)


def test_an_order_column_makes_no_span_that_there_cannot_be() -> None:
    found = read_line_map([tower(x, line="A", order=str(k)) for k, x in enumerate((0, 300, 9000, 9300, 20_000))])
    assert [len(wire.supports) for wire in found.wires] == [2, 2]
    assert all(wire.ordered_by.startswith("their order column, lines of their own") for wire in found.wires)
    assert len(found.alone) == 1


def test_a_tower_drawn_as_an_area_carries_the_line_that_ends_at_its_corner() -> None:
    corners = places([(600, -15), (630, -15), (630, 15), (600, 15), (600, -15)])
    large = MapFeature(
        "line", corners, {"power": "tower", "ref": "9"}, "map, way 4", "", ("1", "2", "3", "4", "1"), True
    )
    drawn = MapFeature(
        "line", places([(0, -15), (300, -15), (600, -15)]), {"power": "line"}, "map", "", ("8", "9", "1")
    )
    found = read_line_map([large, drawn])
    (wire,) = found.wires
    end = found.supports[wire.supports[-1]]
    assert (end.label, end.tagged) == ("9", True)
    assert along(found, wire)[-1] == (615, 0)


def test_what_is_left_out_is_counted_by_its_type() -> None:
    left = [tower(0, 50, type="Umspannwerk"), tower(9, 50, type="Umspannwerk"), tower(0, 90, man_made="survey_point")]
    found = read_line_map([line(row(0, 200, 400)), *left, line(row(0, 9), power="cable")])
    assert found.unknown == {"type=Umspannwerk": 2, "man_made=survey_point": 1}
    assert found.underground == 1


@pytest.mark.parametrize("seed", range(8))
def test_no_stretch_of_the_way_through_scattered_towers_is_better_turned_round(seed: int) -> None:
    scattered = np.random.default_rng(seed).uniform(0, 2000, (11, 2)).round().tolist()
    found = read_line_map([tower(x, y) for x, y in scattered])
    (wire,) = found.wires
    if wire.ordered_by != "the shortest way through them":
        return

    def length_m(way: Sequence[XY]) -> float:
        return float(np.hypot(*np.diff(np.array(way), axis=0).T).sum())

    way = along(found, wire)
    assert sorted(way) == sorted((round(x), round(y)) for x, y in scattered)
    for a, b in itertools.combinations(range(len(way) + 1), 2):
        assert length_m([*way[:a], *way[a:b][::-1], *way[b:]]) >= length_m(way) - 2


def test_towers_beside_a_drawn_line_of_others_stand_alone() -> None:
    found = read_line_map([line(row(0, 200, 400)), tower(200, 300), tower(300, 300)])
    assert len(found.wires) == 1
    assert len(found.alone) == 2


def test_a_drawing_is_told_from_a_line_with_its_towers() -> None:
    found = read_line_map([line(row(0, 3000, 6000, y=500)), line(row(0, 300, 600, 2500), power="minor_line")])
    drawing, dense = found.wires
    assert found.is_drawing(drawing)
    assert not found.is_drawing(dense)
    assert found.coarse_gap_m(dense) == pytest.approx(1900, abs=1)


def test_a_long_span_between_two_known_towers_is_no_gap() -> None:
    found = read_line_map([line(row(0, 2000, 2300)), tower(0), tower(2000), tower(2300)])
    assert found.coarse_gap_m(found.wires[0]) == 0.0


@pytest.mark.parametrize(
    ("height", "match"), [("450", "call them ele"), ("1.5", "3 to 400 m"), ("1500", "call them ele")]
)
def test_heights_that_are_none_of_towers_are_refused(height: str, match: str) -> None:
    with pytest.raises(MissionError, match=match):
        read_line_map([tower(0, height=height), tower(200, height=height)])


def test_a_map_without_towers_and_lines_says_what_is_on_it() -> None:
    things = [tower(0, man_made="mast"), line(row(0, 100), power="cable")]
    with pytest.raises(MissionError, match="map: expected towers or lines, got 1 masts or chimneys and 1 cables"):
        read_line_map(things)
