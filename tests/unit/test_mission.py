from __future__ import annotations

import json
from pathlib import Path

import pytest

from missionplanner.errors import MissionError
from missionplanner.mission import (
    Inspection,
    Mission,
    Vehicle,
    VehicleSettings,
    load_mission,
    mission_schema,
    parse_mission,
)

SMALL = """\
name: small
origin: {lat_deg: 34.35, lon_deg: -118.2}
terrain: {kind: flat, alt_amsl_m: 100}
defaults:
  speed_m_s: {min: 3, max: 8}
  safety: {terrain_m: 15}
obstacles:
  - {kind: cylinder, name: mast, center: {x_m: 200, y_m: 5}, radius_m: 3}
  - kind: no_fly
    name: school
    polygon: [{x_m: 0, y_m: 300}, {x_m: 50, y_m: 300}, {x_m: 0, y_m: 350}]
inspection:
  towers:
    - {name: T1, x_m: 300, y_m: 0}
    - {name: T2, x_m: 400, y_m: 0}
vehicles:
  - name: alpha
    home: {x_m: 0, y_m: 0}
    goal: {x_m: 500, y_m: 0, alt_amsl_m: 150}
    inspects: {first: T1, last: T2}
  - name: bravo
    start: {x_m: 0, y_m: 50, height_agl_m: 40}
    speed_m_s: {max: 9}
    safety: {obstacle_m: 4}
    goal: {x_m: 500, y_m: 60, alt_amsl_m: 150}
"""


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


def test_a_small_mission_is_read_with_its_defaults() -> None:
    mission = parse_mission(SMALL, "small.yaml")
    alpha, bravo = mission.vehicles
    assert alpha.speed_m_s is not None
    assert (alpha.speed_m_s.min, alpha.speed_m_s.max) == (3, 8)
    assert bravo.speed_m_s is not None
    assert (bravo.speed_m_s.min, bravo.speed_m_s.max) == (3, 9)
    assert (bravo.safety.terrain_m, bravo.safety.obstacle_m) == (15, 4)
    assert (alpha.safety.terrain_m, alpha.safety.obstacle_m) == (15, 10)
    assert mission.fleet.arrive_together
    assert mission.planner.algorithm == "pso-abc-sa"


def test_what_is_read_can_be_written_and_read_again() -> None:
    mission = parse_mission(SMALL, "small.yaml")
    for text in (mission.model_dump_json(by_alias=True), mission.model_dump_json(by_alias=True, exclude_none=True)):
        assert parse_mission(text, "again").vehicles == mission.vehicles


def test_a_vehicle_may_undo_a_default() -> None:
    text = SMALL.replace("defaults:\n", "defaults:\n  endurance_s: 600\n").replace(
        "  - name: alpha\n", "  - name: alpha\n    endurance_s: null\n"
    )
    alpha, bravo = parse_mission(text, "m").vehicles
    assert (alpha.endurance_s, bravo.endurance_s) == (None, 600)


def test_missions_made_in_python_share_defaults_too() -> None:
    data = parse_mission(SMALL, "m").model_dump(by_alias=True, exclude_unset=True)
    data["defaults"] = VehicleSettings(tracking_error_m=1.5)
    data["vehicles"] = [
        Vehicle.model_validate({"name": "a", "home": {"x_m": 0, "y_m": 0}, "goal": v["goal"]})
        for v in data["vehicles"][:1]
    ]
    assert Mission.model_validate(data).vehicles[0].tracking_error_m == 1.5


@pytest.mark.parametrize(
    ("old", "new", "field", "problem"),
    [
        ("goal: {x_m: 500, y_m: 60, alt_amsl_m: 150}\n", "end: land\n", "vehicles[1].goal", "expected this field, got"),
        ("max: 9", "maks: 9", "vehicles[1].speed_m_s.maks", "expected a known field, got 'maks': did you mean max?"),
        ("obstacle_m: 4", "zzz: 4", "vehicles[1].safety.zzz", "expected a known field, got 'zzz': known are terrain_m"),
        ("max: 9", "min: 18, max: 12", "vehicles[1].speed_m_s", "expected 0 < min <= max, got min 18.0 and max 12.0"),
        ("max: 9", "min: 18", "vehicles[1].speed_m_s", "expected 0 < min <= max, got min 18.0 and max 8.0"),
        ("min: 3,", "min: 0,", "defaults.speed_m_s.min", "expected a number above 0, got 0"),
        ("min: 3,", "minn: 3,", "defaults.speed_m_s.minn", "expected a known field, got 'minn': did you mean min?"),
        ("terrain_m: 15", "terrain_m: -1", "defaults.safety.terrain_m", "expected a number of at least 0, got -1"),
        ("radius_m: 3", "radius_m: -3", "obstacles[0].radius_m", "expected a number above 0, got -3"),
        ("radius_m: 3", "radius_m: 1e200", "obstacles[0].radius_m", "expected a number of at most 1e+07, got 1e+200"),
        ("radius_m: 3", "radius_m: .inf", "obstacles[0].radius_m", "expected a finite number, got inf"),
        ("radius_m: 3", "radius_m: -.inf", "obstacles[0].radius_m", "expected a "),
        ("radius_m: 3", "radius_m: .nan", "obstacles[0].radius_m", "expected a "),
        ("radius_m: 3", "radius_m: 1e999", "obstacles[0].radius_m", "expected a finite number, got inf"),
        ("radius_m: 3", "radius_m: " + "9" * 400, "obstacles[0].radius_m", "expected a finite number, got inf"),
        ("alt_amsl_m: 100", "alt_amsl_m: .NaN", "terrain.alt_amsl_m", "expected a finite number, got nan"),
        ("radius_m: 3", "radius_m: '3'", "obstacles[0].radius_m", "expected a number, got '3': remove the quotes"),
        ("radius_m: 3", "radius_m: true", "obstacles[0].radius_m", "expected a number, got true"),
        ("radius_m: 3", "radius_m: wide", "obstacles[0].radius_m", "expected a number, got 'wide'"),
        ("radius_m: 3", "radius_m:", "obstacles[0].radius_m", "expected a number, got nothing"),
        ("radius_m: 3", "radius_m: 2024-01-01", "obstacles[0].radius_m", "expected a number, got '2024-01-01'"),
        ("radius_m: 3", "radius_m: [3]", "obstacles[0].radius_m", "expected a number, got a list"),
        ("radius_m: 3", "radius: 3", "obstacles[0].radius", "expected a known field, got 'radius': did you mean radiu"),
        ("kind: cylinder", "kind: cilinder", "obstacles[0]", "got 'cilinder': did you mean cylinder?"),
        ("kind: cylinder, ", "", "obstacles[0]", "expected a field kind, one of cable, cone, cylinder"),
        (", {x_m: 0, y_m: 350}]", "]", "obstacles[1].polygon", "expected at least 3 of them, got 2"),
        ("kind: flat, alt_amsl_m: 100", "kind: raster", "terrain.file", "expected this field, got none"),
        ("lat_deg: 34.35", "lat_deg: -118.2", "origin.lat_deg", "got -118.2: are latitude and longitude swapped?"),
        ("lat_deg: 34.35", "lat_deg: 91000", "origin.lat_deg", "expected a number of at most 84, got 91000"),
        ("home: {x_m: 0, y_m: 0}", "home: {x_m: 0}", "vehicles[0].home", "expected either lat_deg and lon_deg, or x_m"),
        ("home: {x_m: 0, y_m: 0}", "home: {x_m: 0, y_m: 0, lat_deg: 1, lon_deg: 1}", "vehicles[0].home", "expected ei"),
        ("home: {x_m: 0, y_m: 0}", "home: 12", "vehicles[0].home", "expected a mapping of fields, got 12"),
        ("    home: {x_m: 0, y_m: 0}\n", "", "vehicles[0]", "expected home, start or both"),
        ("y_m: 60, alt_amsl_m: 150", "y_m: 60", "vehicles[1].goal", "expected exactly one of alt_amsl_m (above mean s"),
        ("y_m: 60, ", "y_m: 60, height_agl_m: 9, ", "vehicles[1].goal", "expected exactly one of alt_amsl_m"),
        ("name: bravo", "name: bravo\n    class: plane\n    end: land", "vehicles[1].end", "expected loiter or rtl"),
        ("name: bravo", "name: alpha", "vehicles[1].name", "expected a name of its own, got 'alpha' like vehicles[0]"),
        ("name: school", "name: T2", "inspection.towers[1].name", "expected a name of its own, got 'T2' like obstacle"),
        ("name: bravo", "name: bravo\n    sysid: 1", "vehicles[1].sysid", "expected a sysid of its own, got 1 like ve"),
        ("name: bravo", "name: bravo\n    sysid: 1.5", "vehicles[1].sysid", "expected a whole number, got 1.5"),
        ("name: bravo", "name: bravo\n    sysid: 251", "vehicles[1].sysid", "expected a number of at most 250, got 25"),
        ("name: bravo", "name: 7", "vehicles[1].name", "expected text, got 7: put it in quotes"),
        ("name: bravo", "name: no way", "vehicles[1].name", "expected a name of letters, digits, '_', '-' and '.', be"),
        ("name: bravo", "name: ''", "vehicles[1].name", "expected at least 1 character, got ''"),
        ("name: bravo", "name: " + "b" * 41, "vehicles[1].name", "expected at most 40 characters, got 'bbbb"),
        ("name: bravo", "name: bravo\n    autopilot: apm", "vehicles[1].autopilot", "expected 'ardupilot' or 'px4', g"),
        ("last: T2", "last: T3", "vehicles[0].inspects.last", "expected the name of a tower, got 'T3': did you"),
        ("last: T2", "last: pylon", "vehicles[0].inspects.last", "expected the name of a tower, got 'pylon': known ar"),
        ("vehicles:", "fleet: {arrive_together: yes}\nvehicles:", "fleet.arrive_together", "expected true or false, g"),
        ("vehicles:", "planner: {population: 0}\nvehicles:", "planner.population", "expected a number of at least 6, "),
        ("defaults:\n", "defaults:\n  goal: 3\n", "defaults.goal", "expected a known field, got 'goal'"),
    ],
)  # fmt: skip
def test_mistakes_are_told_with_line_and_field(old: str, new: str, field: str, problem: str) -> None:
    assert SMALL.count(old) == 1
    text = SMALL.replace(old, new)
    with pytest.raises(MissionError) as raised:
        parse_mission(text, "m.yaml")
    message = str(raised.value)
    place, _, rest = message.partition(": ")
    assert rest.startswith(f"{field}: ")
    assert problem in rest
    assert "\n" not in message
    source, _, line = place.partition(":")
    assert source == "m.yaml"
    key = field.rpartition(".")[2]
    lines = text.splitlines()[int(line) - 1]
    assert key in lines or "[" in key or problem.startswith("expected this field")


def test_the_line_is_that_of_the_field() -> None:
    text = SMALL.replace("radius_m: 3", "radius_m: -3").replace("max: 9", "max: -9")
    with pytest.raises(MissionError) as raised:
        parse_mission(text, "m.yaml")
    first, second = line_of(text, "radius_m: -3"), line_of(text, "max: -9")
    assert str(raised.value) == (
        f"m.yaml:{first}: obstacles[0].radius_m: expected a number above 0, got -3 "
        f"(and 1 more: line {second}: vehicles[1].speed_m_s.max: expected a number above 0, got -9)"
    )


def test_many_mistakes_still_make_one_line() -> None:
    text = SMALL.replace("_m: ", "_q: ")
    with pytest.raises(MissionError, match=r"and \d+ more: .*; \.\.\.\)$") as raised:
        parse_mission(text, "m.yaml")
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 1000


def test_a_mistake_in_the_defaults_is_told_once() -> None:
    with pytest.raises(MissionError) as raised:
        parse_mission(SMALL.replace("min: 3,", "min: -3,"), "m.yaml")
    assert str(raised.value) == "m.yaml:5: defaults.speed_m_s.min: expected a number above 0, got -3"


def test_a_name_that_does_not_name_itself_is_the_places_default() -> None:
    mission = parse_mission(SMALL.replace("name: bravo", "name: 'no'"), "m")
    assert mission.vehicles[1].name == "no"
    assert parse_mission(SMALL.replace("name: bravo", "name: no"), "m").vehicles[1].name == "no"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "m.yaml: expected a mapping of fields, got an empty file"),
        ("# nothing\n", "m.yaml: expected a mapping of fields, got an empty file"),
        ("- name: a\n", "m.yaml:1: expected a mapping of fields (name: ...), got a list"),
        ("hello", "m.yaml:1: expected a mapping of fields (name: ...), got 'hello'"),
        ("a: [1, 2\nb: 3\n", "m.yaml:2: expected YAML, got a syntax error in column 2: "),
        ("a: {b: 1\n", "m.yaml:2: expected YAML, got a syntax error"),
        ("a: b: c\n", "m.yaml:1: expected YAML, got a syntax error in column 5: "),
        ("a:\n\tb: 1\n", "m.yaml:2: expected YAML, got a syntax error in column 1: "),
        ("a: *missing\n", "m.yaml:1: expected YAML, got a syntax error in column 4: "),
        ("a: 1\n---\nb: 2\n", "m.yaml:2: expected YAML, got a syntax error in column 1: "),
        ("name: a\nname: b\n", "m.yaml:2: expected every field once, got 'name' again (first in line 1)"),
        ("a: {b: 1, b: 2}\n", "m.yaml:1: expected every field once, got 'b' again (first in line 1)"),
        ("1: a\n", "m.yaml:1: expected the name of a field, got '1'"),
        ("? [a]\n: b\n", "m.yaml:1: expected the name of a field, got 'a collection'"),
        ("a: !!python/object:os.system x\n", "m.yaml:1: expected a plain value, got the tag "),
        ("a: !!timestamp 2001-01-01\n", "m.yaml:1: expected a plain value, got the tag "),
        ("a: &x [*x]\n", "m.yaml:1: expected values that end, got an alias that contains itself"),
        ("a: 3\n<<: 3\n", "m.yaml:2: expected '<<' to name a mapping, or a list of mappings"),
        ("a: " + "[" * 1000, "m.yaml: expected fields within fields, got nesting deeper than can be read"),
        ("\x00\x01GIF89a", "m.yaml: expected a YAML text file, got: "),
    ],
)  # fmt: skip
def test_what_is_no_mission_is_said_in_one_line(text: str, problem: str) -> None:
    with pytest.raises(MissionError) as raised:
        parse_mission(text, "m.yaml")
    assert str(raised.value).startswith(problem)
    assert "\n" not in str(raised.value)


def test_a_small_file_cannot_fill_the_memory() -> None:
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 12)
    )
    with pytest.raises(MissionError, match="expected at most 300000 values, got more"):
        parse_mission(bomb, "m.yaml")


def test_anchors_aliases_and_merges_work() -> None:
    text = SMALL.replace("alt_amsl_m: 150}\n    inspects", "alt_amsl_m: &height 150}\n    inspects")
    text = text.replace("y_m: 60, alt_amsl_m: 150", "y_m: 60, alt_amsl_m: *height")
    text = text.replace("safety: {terrain_m: 15}", "safety: &safe {terrain_m: 15}")
    text = text.replace("safety: {obstacle_m: 4}", "safety: {<<: *safe, obstacle_m: 4}")
    bravo = parse_mission(text, "m").vehicles[1]
    assert bravo.goal.alt_amsl_m == 150
    assert (bravo.safety.terrain_m, bravo.safety.obstacle_m) == (15, 4)


def test_own_fields_win_over_merged_ones_and_the_first_merge_over_the_second() -> None:
    text = SMALL.replace("safety: {terrain_m: 15}", "safety: {terrain_m: 15}\n  climb: &a {rate_m_s: 1}\n  descent: &b "
                         "{rate_m_s: 2, angle_max_deg: 30}")  # fmt: skip
    text = text.replace("safety: {obstacle_m: 4}", "climb: {<<: [*a, *b]}\n    descent: {<<: *b, angle_max_deg: 20}")
    bravo = parse_mission(text, "m").vehicles[1]
    assert (bravo.climb.rate_m_s, bravo.climb.angle_max_deg) == (1, 30)
    assert (bravo.descent.rate_m_s, bravo.descent.angle_max_deg) == (2, 20)


def test_json_is_a_mission_file_too() -> None:
    mission = parse_mission(SMALL, "m")
    assert parse_mission(json.dumps(mission.model_dump(mode="json", by_alias=True)), "m.json") == mission


def test_json_with_escaped_emoji_is_read(tmp_path: Path) -> None:
    data = parse_mission(SMALL, "m").model_dump(mode="json", by_alias=True) | {"description": "🚁 über den Grat"}
    assert parse_mission(json.dumps(data), "m.json").description == "🚁 über den Grat"
    with pytest.raises(MissionError, match="m:1: expected text, got half of a pair of surrogates"):
        parse_mission('name: "\\ud83d"', "m")


def test_numbers_read_as_yaml_1_2_reads_them() -> None:
    for text, value in (("1e2", 100.0), ("+1.5E-1", 0.15), (".5", 0.5), ("2.", 2.0), ("0x10", 16.0), ("007", 7.0)):
        assert parse_mission(SMALL.replace("radius_m: 3", f"radius_m: {text}"), "m").obstacles[0].radius_m == value  # type: ignore[union-attr]
    with pytest.raises(MissionError, match="expected a number, got '12:30'"):
        parse_mission(SMALL.replace("radius_m: 3", "radius_m: 12:30"), "m")


def test_files_are_read(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + SMALL.replace("\n", "\r\n").encode())
    assert load_mission(path) == parse_mission(SMALL, "m")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("naïve: 1".encode("latin-1"), "expected UTF-8 text, got byte 0xef at offset 2"),
        ("name: a".encode("utf-16"), "expected UTF-8 text, got byte 0xff at offset 0"),
        (bytes(range(256)), "expected UTF-8 text, got byte 0x80 at offset 128"),
        (b"PK\x03\x04", "expected a YAML text file, got: "),
        (b"", "expected a mapping of fields, got an empty file"),
    ],
)
def test_files_that_are_no_text_are_refused(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "m.yaml"
    path.write_bytes(content)
    with pytest.raises(MissionError) as raised:
        load_mission(path)
    assert str(raised.value).startswith(f"{path}: {problem}")
    assert "\n" not in str(raised.value)


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"none\.yaml: expected a mission file that can be read, got: No such file"):
        load_mission(tmp_path / "none.yaml")
    with pytest.raises(MissionError, match="expected a mission file that can be read, got: a folder"):
        load_mission(tmp_path)
    huge = tmp_path / "huge.yaml"
    with huge.open("wb") as file:
        file.truncate(10**9)
    with pytest.raises(MissionError, match="at most 16777216 bytes, got more"):
        load_mission(huge)


def test_the_schema_knows_every_field_and_refuses_others() -> None:
    schema = mission_schema()
    assert schema["$schema"].startswith("https://json-schema.org/")
    assert set(schema["required"]) == {"name", "origin", "terrain", "vehicles"}
    vehicle = schema["$defs"]["Vehicle"]
    assert vehicle["additionalProperties"] is False
    assert "class" in vehicle["properties"]
    assert set(schema["$defs"]["VehicleSettings"]["properties"]) < set(vehicle["properties"])
    assert schema["$defs"]["Cylinder"]["properties"]["radius_m"]["exclusiveMinimum"] == 0
    assert json.loads(json.dumps(schema)) == schema


def test_the_line_of_a_merged_field_is_where_it_was_written() -> None:
    text = SMALL.replace("safety: {terrain_m: 15}", "safety: &safe\n    terrain_m: -15")
    text = text.replace("safety: {obstacle_m: 4}", "safety: {<<: *safe, obstacle_m: 4}")
    with pytest.raises(MissionError) as raised:
        parse_mission(text, "m.yaml")
    line = line_of(text, "terrain_m: -15")
    assert f"line {line}: vehicles[1].safety.terrain_m: " in str(raised.value)


def test_one_top_is_enough() -> None:
    text = SMALL.replace("radius_m: 3", "radius_m: 3, top_alt_amsl_m: 150, top_height_agl_m: 50")
    with pytest.raises(
        MissionError, match=r"obstacles\[0\]: expected at most one of top_alt_amsl_m and top_height_agl_m"
    ):
        parse_mission(text, "m.yaml")


@pytest.mark.parametrize("name", ["..", ".", "-o", ".hidden", "a/b", ""])
def test_a_name_cannot_lead_elsewhere(name: str) -> None:
    with pytest.raises(MissionError, match="name"):
        parse_mission(SMALL.replace("name: small", f"name: {name!r}", 1), "x.yaml")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "name: alpha",
            "name: alpha\n    uid: 12ab",
            "vehicles[0].uid: expected 16 or 36 hexadecimal digits, got '12ab'",
        ),
        (
            "name: alpha",
            f"name: alpha\n    uid: '{'0' * 35}g'",
            "vehicles[0].uid: expected 16 or 36 hexadecimal digits",
        ),
        (
            "name: alpha",
            "name: alpha\n    uid: 1234567890123456",
            "expected text, got 1234567890123456: put it in quotes",
        ),
        (
            "name: alpha",
            "name: alpha\n    rally: [{x_m: 10, y_m: 20, height_above_home_m: 30}]",
            "vehicles[0].rally: expected fleet.direct_return: waived with it",
        ),
        (
            "name: alpha",
            "name: alpha\n    end: rtl\n    rally: [{x_m: 10, y_m: 20, height_above_home_m: 30}]",
            "vehicles[0].rally",
        ),
        ("name: alpha", "name: alpha\n    rally: [{x_m: 10, y_m: 20}]", "rally[0].height_above_home_m: expected"),
        ("vehicles:", "fleet: {home_within_m: 0}\nvehicles:", "fleet.home_within_m: expected a number above 0"),
    ],
)
def test_what_binds_a_vehicle_is_checked(old: str, new: str, told: str) -> None:
    with pytest.raises(MissionError) as error:
        parse_mission(SMALL.replace(old, new, 1), "small.yaml")
    assert told in str(error.value)


def test_one_autopilot_is_bound_to_one_vehicle() -> None:
    bound = SMALL.replace("name: alpha", "name: alpha\n    uid: 00112233445566AA", 1)
    assert parse_mission(bound, "small.yaml").vehicles[0].uid == "00112233445566aa"
    twice = bound.replace("name: bravo", "name: bravo\n    uid: 00112233445566aa", 1)
    with pytest.raises(MissionError, match=r"vehicles\[1\].uid: expected a uid of its own"):
        parse_mission(twice, "small.yaml")


def test_rally_points_need_a_return_that_is_waived() -> None:
    point = "rally: [{x_m: 10, y_m: 20, height_above_home_m: 30}]"
    waived = SMALL.replace("defaults:", f"fleet: {{direct_return: waived}}\ndefaults:\n  {point}", 1)
    assert [len(v.rally) for v in parse_mission(waived, "small.yaml").vehicles] == [1, 1]
    with pytest.raises(MissionError, match=r"vehicles\[0\].end: expected land or loiter with rally points"):
        parse_mission(waived.replace("name: alpha", "name: alpha\n    end: rtl", 1), "small.yaml")


@pytest.mark.parametrize(
    ("towers", "expected"),
    [
        ([{"last_inspected": "2024-01-01"}, {}, {"last_inspected": "2024-01-21"}, {"weight": 3.0}], (30, 30, 10, 3)),
        ([{"last_inspected": "2024-01-21", "weight": 2.0}, {}], (2, 10)),
        ([{"last_inspected": "2024-01-31"}, {}], (0, 1)),
        ([{}, {"weight": 0.5}], (1, 0.5)),
    ],
)
def test_who_was_never_inspected_counts_as_much_as_who_waits_longest(
    towers: list[dict[str, object]], expected: tuple[float, ...]
) -> None:
    named = [{"name": f"T{k}", "x_m": 100.0 * k, "y_m": 0.0} | tower for k, tower in enumerate(towers)]
    assert Inspection.model_validate({"towers": named, "as_of": "2024-01-31"}).weights == expected
