"""Parameter files of the three ground stations: read, written, refused, and taken up by a mission."""

from __future__ import annotations

from pathlib import Path

import pytest

from missionplanner.errors import MissionError
from missionplanner.mission import Mission, load_mission, with_parameter_files
from missionplanner.parameter_files import parse_parameters, read_parameters, write_parameters
from missionplanner.scene import build_scene, portable_mission

MISSION_PLANNER = """\
#NOTE: 11/25/2026 12:00:00 PM
ACRO_BAL_PITCH,1
WPNAV_ACCEL,200
WPNAV_RADIUS,350.5
RTL_ALT,6000
"""
MAVPROXY = """\
# generated
ACRO_BAL_PITCH   1.000000
WPNAV_ACCEL      200.000000  # slow
WPNAV_RADIUS     350.500000
RTL_ALT          6000
"""
QGROUNDCONTROL = (
    "# Onboard parameters for Vehicle 7\n#\n# Vehicle-Id Component-Id Name Value Type\n"
    "7\t1\tACRO_BAL_PITCH\t1.000000000000000000\t9\n"
    "7\t1\tWPNAV_ACCEL\t200.000000000000000000\t9\n"
    "7\t1\tWPNAV_RADIUS\t350.500000000000000000\t9\n"
    "7\t1\tRTL_ALT\t6000\t6\n"
    "7\t154\tWPNAV_ACCEL\t3\t6\n"
)
THREE = pytest.mark.parametrize("text", [MISSION_PLANNER, MAVPROXY, QGROUNDCONTROL])


@THREE
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_all_kinds_are_read(text: str, end: str) -> None:
    found = parse_parameters(text.replace("\n", end), "v.param")
    values = {name: entry.value for name, entry in found.items()}
    assert values == {"ACRO_BAL_PITCH": 1.0, "WPNAV_ACCEL": 200.0, "WPNAV_RADIUS": 350.5, "RTL_ALT": 6000.0}
    assert text.splitlines()[found["WPNAV_RADIUS"].line - 1].split("#")[0].count("WPNAV_RADIUS") == 1


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "v.param: expected NAME,VALUE (Mission Planner)"),
        ("# nothing\n", "got none"),
        ("WPNAV_ACCEL,200\nWPNAV_ACCEL\n", "v.param:2: expected NAME,VALUE"),
        ("WPNAV_ACCEL,fast\n", "v.param:1: expected NAME,VALUE"),
        ("QGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t47.4\t8.5\t488\t1\n", "v.param:1: expected NAME,VALUE"),
        ("<html>\n", "v.param:1: expected NAME,VALUE"),
        ("WPNAV_ACCELERATION_MAX,1\n", "v.param:1: expected NAME,VALUE"),
        ("A,1\nB,2\nA,3\n", "v.param:3: A is 3 here and 1 in line 1: keep one"),
        ("1\t1\tA\t1\t9\n2\t1\tA\t1\t9\n", "v.param:2: expected the parameters of one vehicle, got those of 1 and 2"),
    ],
)
def test_what_is_no_parameter_file_is_told(text: str, told: str) -> None:
    with pytest.raises(MissionError) as error:
        parse_parameters(text, "v.param")
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_parameter_twice_alike_is_one() -> None:
    assert parse_parameters("A,1\nA 1.0\n", "x")["A"].value == 1.0


@pytest.mark.parametrize("suffix", [".param", ".parm", ".params"])
def test_what_is_written_is_read(tmp_path: Path, suffix: str) -> None:
    values = {"WPNAV_ACCEL": 250.0, "WPNAV_JERK": 1.7000000476837158, "RTL_ALT": 1500.0, "BIG": 3.0e9, "SMALL": -1e-7}
    path = tmp_path / f"v{suffix}"
    write_parameters(path, values, 7, {"RTL_ALT": 6}, "ardupilot copter, sysid 7")
    read = {name: entry.value for name, entry in read_parameters(path).items()}
    assert read == pytest.approx(values, rel=1e-7)
    text = path.read_text(encoding="utf-8")
    assert "WPNAV_JERK" in text
    assert "1.7" in text
    assert "1.70000004" not in text  # no more digits than single precision has
    if suffix == ".params":
        assert "7\t1\tRTL_ALT\t1500\t6\n" in text
        assert "7\t1\tWPNAV_ACCEL\t250\t9\n" in text


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"expected a name that ends in \.param, \.parm, \.params, got '\.txt'"):
        write_parameters(tmp_path / "v.txt", {"A": 1.0}, 1, {}, "")


@pytest.mark.parametrize("make", ["nothing", "folder"])
def test_a_file_that_cannot_be_read_is_told(tmp_path: Path, make: str) -> None:
    path = tmp_path / "v.param"
    if make == "folder":
        path.mkdir()
    with pytest.raises(MissionError, match=r"v\.param: expected a parameter file that can be read"):
        read_parameters(path)


# in a mission


def load(folder: Path, defaults: str = "", alpha: str = "", **files: str) -> Mission:
    for name, text in files.items():
        (folder / f"{name}.param").write_text(text, encoding="utf-8")
    (folder / "m.yaml").write_text(
        "name: small\n"
        "origin: {lat_deg: 47.4, lon_deg: 8.5}\n"
        "terrain: {kind: flat, alt_amsl_m: 488}\n"
        f"defaults: {{{defaults}}}\n"
        "vehicles:\n"
        "  - name: alpha\n"
        "    home: {x_m: 0, y_m: 0}\n"
        "    goal: {x_m: 0, y_m: 300, height_agl_m: 40}\n"
        f"    {alpha}\n"
        "  - name: bravo\n"
        "    home: {x_m: 90, y_m: 0}\n"
        "    goal: {x_m: 90, y_m: 300, height_agl_m: 40}\n",
        encoding="utf-8",
    )
    return load_mission(folder / "m.yaml")


def test_a_vehicle_takes_its_file(tmp_path: Path) -> None:
    mission = load(tmp_path, alpha="parameter_file: a.param", a=MISSION_PLANNER)
    alpha, bravo = (task.motion for task in build_scene(mission, tmp_path).tasks)
    assert (alpha.acceleration_m_s2, alpha.waypoint_radius_m) == (2.0, 3.505)
    assert (bravo.acceleration_m_s2, bravo.waypoint_radius_m) == (2.5, 2.0)
    # what others know is passed over, and a return height is the plan's to choose
    resolved = with_parameter_files(mission, tmp_path).vehicles[0]
    assert resolved.parameters == {"WPNAV_ACCEL": 200.0, "WPNAV_RADIUS": 350.5}
    assert resolved.asked_motion().get("return_height_m") is None


def test_typed_parameters_go_before_the_file(tmp_path: Path) -> None:
    typed = "{parameter_file: a.param, parameters: {WP_ACC: 3.0}}"
    mission = load(tmp_path, alpha=typed[1:-1].replace(", parameters", "\n    parameters"), a=MISSION_PLANNER)
    alpha = build_scene(mission, tmp_path).tasks[0].motion
    assert (alpha.acceleration_m_s2, alpha.waypoint_radius_m) == (3.0, 3.505)


def test_all_may_share_a_file_and_one_have_its_own(tmp_path: Path) -> None:
    mission = load(
        tmp_path, "parameter_file: a.param", "parameter_file: b.param", a=MISSION_PLANNER, b="WPNAV_ACCEL,100\n"
    )
    alpha, bravo = (task.motion.acceleration_m_s2 for task in build_scene(mission, tmp_path).tasks)
    assert (alpha, bravo) == (1.0, 2.0)


@pytest.mark.parametrize(
    ("alpha", "text", "told"),
    [
        ("parameter_file: b.param", "", "b.param: expected a parameter file that can be read, got: No such file"),
        ("parameter_file: a.param", "A,1\nWPNAV_RADIUS,-3\n", "a.param:2: alpha: expected WPNAV_RADIUS between 5 and"),
        ("parameter_file: a.param", "MPC_ACC_HOR,3\n", "a.param: expected parameters of alpha (ardupilot copter), got"),
        (
            "parameter_file: a.param\n    motion: {acceleration_m_s2: 2.5}",
            MISSION_PLANNER,
            "a.param:3: alpha: WPNAV_ACCEL 200 contradicts motion.acceleration_m_s2 2.5: leave one of them out",
        ),
    ],
)
def test_what_is_wrong_with_a_file_is_told_with_its_line(tmp_path: Path, alpha: str, text: str, told: str) -> None:
    mission = load(tmp_path, alpha=alpha, a=text)
    with pytest.raises(MissionError) as error:
        build_scene(mission, tmp_path)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_planes_speeds_are_held_against_its_file(tmp_path: Path) -> None:
    plane = "parameter_file: a.param\n    class: plane\n    speed_m_s: {min: 12, max: 28}"
    assert load(tmp_path, alpha=plane, a="AIRSPEED_MAX,30\n")
    mission = load(tmp_path, alpha=plane, a="AIRSPEED_MAX,25\n")
    with pytest.raises(MissionError, match=r"alpha\.speed_m_s: expected max of at most 25 \(AIRSPEED_MAX\), got 28"):
        with_parameter_files(mission, tmp_path)


def test_a_portable_mission_needs_no_parameter_file(tmp_path: Path) -> None:
    mission = load(tmp_path, alpha="parameter_file: a.param", a=MISSION_PLANNER)
    scene = build_scene(mission, tmp_path)
    portable = portable_mission(scene)
    (tmp_path / "a.param").unlink()
    again = Mission.model_validate(portable.model_dump(mode="json", by_alias=True, exclude_unset=True))
    assert build_scene(again, tmp_path).tasks[0].motion == scene.tasks[0].motion
    assert build_scene(again, tmp_path).input_sha256 == scene.input_sha256
