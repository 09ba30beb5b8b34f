from __future__ import annotations

import base64
import io
import math
import re
from dataclasses import replace
from html import unescape
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.image import imread

from missionplanner import kernels, planner, proof
from missionplanner.certificate import Certificate, Finding
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Mission
from missionplanner.path_search import PlannedPath
from missionplanner.plan import FleetFlight, FleetPlan, FlownVehicle, Trajectory
from missionplanner.report import charts, maps, page, style, verdicts, view, write_check_report, write_report
from missionplanner.report.facts import along_m, along_path_m, collect, distances, sketch_of
from missionplanner.report.labels import Labels
from missionplanner.report.relief import Ground, contour_interval_m, contour_levels_m, relief_colours
from missionplanner.report.shapes import Shape, facets, shapes, vertical_range
from missionplanner.scene import Scene, build_check_scene, build_scene
from missionplanner.sortie import Gap, Leg, Sortie


def at(x: float, y: float, agl: float | None = None) -> dict[str, float]:
    return {"x_m": x, "y_m": y} if agl is None else {"x_m": x, "y_m": y, "height_agl_m": agl}


MAST = {"kind": "cylinder", "name": "mast", "center": at(300, 60), "radius_m": 8, "top_height_agl_m": 70}
CABLE = {"kind": "cable", "name": "ropeway", "start": at(150, -150, 30), "end": at(420, 330, 30), "radius_m": 1}
OBSTACLES: list[dict[str, Any]] = [
    MAST,
    {"kind": "cone", "name": "needle", "center": at(250, 260), "base_radius_m": 50, "height_m": 160},
    {"kind": "radar", "name": "radar", "center": at(480, -140, 5), "radius_m": 90},
    {"kind": "radar", "name": "soft", "center": at(60, 280, 5), "radius_m": 60, "hard": False},
    {"kind": "marine", "name": "storm", "center": at(90, -160, 0), "radius_m": 50},
    {
        "kind": "no_fly", "name": "camp", "polygon": [at(380, 200), at(460, 190), at(420, 230), at(455, 290)],
        "top_height_agl_m": 60,
    },
    CABLE,
]  # fmt: skip


def question(vehicles: int = 2, **changes: Any) -> dict[str, Any]:
    return {
        "name": "hills",
        "origin": {"lat_deg": 46.5, "lon_deg": 8.0},
        "terrain": {
            "kind": "peaks", "base_alt_amsl_m": 400,
            "peaks": [
                {**at(200, 150), "height_m": 120, "spread_m": 150},
                {**at(450, 0), "height_m": 90, "spread_m": 120},
            ],
        },
        "obstacles": OBSTACLES,
        "fence": {"polygon": [at(-150, -300), at(750, -300), at(750, 450), at(-150, 450)]},
        "inspection": {
            "share_min": 0.0,
            "towers": [{"name": f"T{i}", **at(120 + 70 * i, 20 + 15 * i), "height_m": 20} for i in range(5)],
            "conductor_radius_m": 4,
        },
        "vehicles": [
            {
                "name": f"uav{i}", "home": at(-40, 40 * i - 20), "goal": at(600, 40 * i - 20, 60),
                "safety": {"landing_slope_max_deg": 40}, "return_height_m": 260 + 40 * i, "endurance_s": 7200,
            }
            for i in range(vehicles)
        ],
        **changes,
    }  # fmt: skip


def scene_of(data: dict[str, Any]) -> Scene:
    return build_scene(Mission.model_validate(data), Path())


def plan_of(scene: Scene, above_m: float = 250.0) -> FleetPlan:
    """Return a plan whose every vehicle flies an arch, ``above_m`` higher in its middle than straight ahead."""
    paths = []
    for task in scene.tasks:
        share = np.linspace(0.0, 1.0, 61)
        path = task.route_m[0] + share[:, None] * (task.route_m[-1] - task.route_m[0])
        path[:, 2] += above_m * np.sin(np.pi * share)
        length_m = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        history = 3.0 * np.exp(-np.arange(40) / 8.0) + 1.0
        paths.append(PlannedPath(path, path[::10], length_m, float(history[-1]), {"voyage": 1.0}, history, 2000))
    schedules, arrival_s = planner.schedule(scene, paths, [0.0] * len(paths))
    return proof.checked(scene, planner.assemble(scene, paths, schedules, arrival_s, seed=7))


def flight_of(plan: FleetPlan, aside_m: float = 0.0) -> FleetFlight:
    """Return a flight as predicted, but for ``aside_m`` to the north half-way."""
    flown = []
    for vehicle in plan.vehicles:
        t_s = np.arange(0.0, float(vehicle.trajectory.t_s[-1]), 0.2)
        position = vehicle.trajectory.at(t_s)
        position[:, 1] += aside_m * np.exp(-(((t_s - vehicle.arrival_s / 2) / 8.0) ** 2))
        track = Trajectory(t_s, position)
        flown.append(FlownVehicle(vehicle.name, vehicle.sysid, track, vehicle.arrival_s + 0.1, float(t_s[-1])))
    return FleetFlight(tuple(flown))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(question(description="<b>Bold</b> & careful"))


@pytest.fixture(scope="module")
def plan(scene: Scene) -> FleetPlan:
    return plan_of(scene)


@pytest.fixture(scope="module")
def report(scene: Scene, plan: FleetPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(tmp_path_factory.mktemp("report"), scene, plan, flight_of(plan))


# --- the page ------------------------------------------------------------------------------------------------------


def test_the_page_needs_no_other_file(report: Path) -> None:
    html = report.read_text(encoding="utf-8")
    links = re.findall(r'(?:src|href)="([^"]{0,40})', html)
    assert links
    assert all(link.startswith("data:image/png;base64,") for link in links)
    assert "http" not in re.sub(r"base64,[^\"]*", "", html)


def test_every_picture_is_embedded_and_saved_beside_the_page(report: Path) -> None:
    html = report.read_text(encoding="utf-8")
    embedded = {base64.b64decode(data) for data in re.findall(r"base64,([^\"]*)", html)}
    saved = {path.read_bytes() for path in (report.parent / "pictures").glob("*.png")}
    assert embedded == saved
    names = {path.stem for path in (report.parent / "pictures").glob("*.png")}
    assert names >= {"map", "view", "profile-uav0", "profile-uav1", "separation", "arrival", "cost"}
    for png in saved:
        assert np.asarray(imread(io.BytesIO(png))).std() > 0.01  # something is drawn


def test_what_a_user_wrote_is_shown_as_text(report: Path) -> None:
    html = report.read_text(encoding="utf-8")
    assert "&lt;b&gt;Bold&lt;/b&gt; &amp; careful" in html
    assert "<b>" not in html


def test_the_page_says_where_the_plan_comes_from(report: Path, plan: FleetPlan) -> None:
    html = report.read_text(encoding="utf-8")
    assert plan.input_sha256 in html
    assert f"missionplanner {plan.software_version}" in html
    assert re.search(r"seed</th><td>7<", html)


def test_a_flight_as_predicted_is_all_clear(report: Path) -> None:
    html = report.read_text(encoding="utf-8")
    assert "All clear: plan and flight keep every required distance." in html
    assert 'class="verdict clear"' in html


def test_same_plan_same_bytes(scene: Scene, plan: FleetPlan, report: Path, tmp_path: Path) -> None:
    again = write_report(tmp_path, scene, plan, flight_of(plan))
    assert again.read_bytes() == report.read_bytes()


def test_settings_of_matplotlib_are_left_alone(scene: Scene, plan: FleetPlan) -> None:
    before = dict(matplotlib.rcParams)
    with matplotlib.rc_context({"font.size": 30.0, "lines.linewidth": 9.0}):
        unruly = map_of(scene, plan)
        assert matplotlib.rcParams["font.size"] == 30.0
    assert dict(matplotlib.rcParams) == before
    assert np.array_equal(unruly, map_of(scene, plan))


def test_a_plan_alone_has_no_flown_columns(scene: Scene, plan: FleetPlan, tmp_path: Path) -> None:
    html = write_report(tmp_path, scene, plan).read_text(encoding="utf-8")
    assert "All clear: plan keeps every required distance." in html
    assert "flown arrival" not in html


def test_a_plan_through_the_mast_is_not_clear_and_says_why(tmp_path: Path) -> None:
    scene = scene_of(question(vehicles=1, obstacles=[{**MAST, "center": at(300, -20)}], inspection=None))
    html = write_report(tmp_path, scene, plan_of(scene, above_m=0.0)).read_text(encoding="utf-8")
    assert 'class="verdict unclear"' in html
    assert re.search(r"<li>uav0: item \d+: mast clearance is -", html)
    assert not (tmp_path / "pictures" / "separation.png").exists()  # nobody to keep apart from


def test_a_folder_that_cannot_be_made_is_an_error_in_one_line(scene: Scene, plan: FleetPlan, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(MissionError, match="taken"):
        write_report(tmp_path / "taken", scene, plan)


def test_of_a_large_fleet_the_tightest_profiles_are_drawn(
    scene: Scene, plan: FleetPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(page, "_PROFILES_DRAWN", 1)
    tight = replace(plan.vehicles[1].clearances[0], distance_m=1.0)
    vehicles = (plan.vehicles[0], replace(plan.vehicles[1], clearances=(tight,)))
    facts = collect(scene, replace(plan, vehicles=vehicles), None)
    with style.look():
        (drawn,) = page._profiles(facts, shapes(scene))
    assert drawn.name == "profile-uav1"
    assert drawn.caption == "Of 2 vehicles, the 1 with the least to spare are drawn."


# --- the proof -----------------------------------------------------------------------------------------------------

LOW = Finding(
    "terrain", "uav0", False, "terrain clearance is 12.50 m, expected 20 m", "raise waypoint 5 by 7.5 m", 12.503, 20.0,
    seq=5, position_m=(100.0, -20.0, 430.0),
)  # fmt: skip
WAIVED = Finding("return", "uav1", False, "the direct return is not asked for", waived=True)


def proof_of(plan: FleetPlan) -> Certificate:
    assert plan.certificate is not None
    return plan.certificate


def with_findings(plan: FleetPlan, *more: Finding) -> FleetPlan:
    certificate = proof_of(plan)
    return replace(plan, certificate=replace(certificate, findings=(*certificate.findings, *more)))


def proof_part(html: str) -> str:
    """Return the section on the proof as text, a row or line each."""
    part = html[html.index('<section class="proof">') : html.index("<h2>Vehicles</h2>")]
    rows = re.sub(r"</(?:tr|li|p|h3|summary)>", "\0", part)
    return "\n".join(" ".join(unescape(re.sub(r"<[^>]*>", " ", row)).split()) for row in rows.split("\0"))


def test_a_proven_plan_says_what_is_proven_and_what_that_rests_on(
    scene: Scene, plan: FleetPlan, tmp_path: Path
) -> None:
    certificate = replace(proof_of(plan), mission_sha256={"uav0": "ab" * 32, "uav1": "cd" * 32})
    html = write_report(tmp_path, scene, replace(plan, certificate=certificate)).read_text(encoding="utf-8")
    lines = proof_part(html).splitlines()
    assert f"Proof ✓ Proven: all {len(certificate.findings)} checks." in lines
    assert "NOT PROVEN" not in html.replace("not proven", "")
    height = next(f for f in certificate.findings if f.check == "terrain" and f.vehicle == "uav0")
    assert height.value is not None
    row = next(line for line in lines if line.startswith("proven uav0 ground below"))
    assert re.search(
        rf"{re.escape(verdicts.floored(height.value, 2))} m 20 m item {height.seq}; 46\.\d{{5}}, 7\.\d+", row
    )
    for assumption in certificate.assumptions:
        assert assumption in lines or any(line.endswith(assumption) for line in lines)
    assert any(line.endswith("uav0 abababababab 260 m above home") for line in lines)
    assert any(line.endswith("uav1 cdcdcdcdcdcd 300 m above home") for line in lines)
    assert any(f"Proven by missionplanner {certificate.software_version}." in line for line in lines)


def test_what_is_not_proven_comes_first_in_red_with_place_and_remedy(
    scene: Scene, plan: FleetPlan, tmp_path: Path
) -> None:
    html = write_report(tmp_path, scene, with_findings(plan, WAIVED, LOW)).read_text(encoding="utf-8")
    count = len(proof_of(plan).findings) + 2
    text = proof_part(html)
    assert f"✕ NOT PROVEN: 1 of {count} checks; 1 waived by the mission." in text
    assert "All clear" not in html
    first = html.index('<tr class="unproven">')
    assert first < html.index('<tr class="waived">') < html.index('<tr class="proven">')
    row = next(line for line in text.splitlines() if "NOT PROVEN uav0" in line)
    assert (
        "terrain clearance is 12.50 m, expected 20 m raise waypoint 5 by 7.5 m 12.50 m 20 m item 5; 46.49982, " in row
    )


def test_what_the_mission_waives_is_amber_and_never_all_proven(scene: Scene, plan: FleetPlan, tmp_path: Path) -> None:
    again = replace(WAIVED, vehicle="uav0")
    html = write_report(tmp_path, scene, with_findings(plan, WAIVED, again)).read_text(encoding="utf-8")
    count = len(proof_of(plan).findings) + 2
    assert f"! Proven but for what the mission waives: 2 of {count} checks." in proof_part(html)
    assert 'class="verdict waived"' in html
    assert "waived by the mission uav1, uav0 way home from everywhere" in proof_part(html)  # told once
    assert "waived by the mission, of uav1, uav0: the direct return is not asked for" in html
    assert "Proven: all" not in html


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"certificate": None}, "NOT PROVEN: 2 of 2 checks."),
        ({"findings": ()}, "NOT PROVEN: 2 of 2 checks."),
        ({"input_sha256": "0" * 64}, "the certificate is of another mission file or terrain"),
        ({"without": "uav1"}, "uav1 every item's path is known the certificate says nothing of it"),
    ],
    ids=["none", "empty", "another's", "one left out"],
)
def test_a_certificate_that_does_not_cover_the_plan_proves_nothing(
    scene: Scene, plan: FleetPlan, tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    certificate: Certificate | None = proof_of(plan)
    assert certificate is not None
    if "certificate" in change:
        certificate = None
    elif "without" in change:
        findings = tuple(f for f in certificate.findings if f.vehicle != change["without"])
        certificate = replace(certificate, findings=findings)
    else:
        certificate = replace(certificate, **change)
    html = write_report(tmp_path, scene, replace(plan, certificate=certificate)).read_text(encoding="utf-8")
    assert told in proof_part(html)
    assert 'class="verdict unclear"' in html
    assert "All clear" not in html


def test_nothing_that_a_certificate_says_is_read_as_html(scene: Scene, plan: FleetPlan, tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>"
    findings = (
        replace(LOW, detail=evil, remedy=evil, to=evil),
        replace(WAIVED, vehicle=f"uav1{evil}", detail=evil),
        Finding("inspection", evil, True, evil, unit=evil, value=1.0),
    )
    certificate = replace(
        proof_of(with_findings(plan, *findings)),
        assumptions=(evil,),
        mission_sha256={evil: evil},
        software_version=evil,
    )
    html = write_report(tmp_path, scene, replace(plan, certificate=certificate)).read_text(encoding="utf-8")
    assert "<script" not in html
    assert html.count("&lt;script&gt;") >= 9


@pytest.mark.parametrize(
    ("finding", "figure"),
    [
        (Finding("terrain", "a", True, "", value=20.009, required=20.0), "20.00 m"),
        (Finding("terrain", "a", False, "", value=19.999, required=20.0), "19.99 m"),
        (Finding("landing", "a", True, "", value=14.991, required=15.0, unit="degrees"), "15.00 degrees"),
        (Finding("landing", "a", False, "", value=15.001, required=15.0, unit="degrees"), "15.01 degrees"),
        (Finding("landing", "a", True, "", value=1e-9, required=15.0, unit="degrees"), "0.00 degrees"),
        (Finding("terrain", "a", True, "", value=20.0, required=20.0), "20 m"),
        (Finding("terrain", "a", False, "", value=-math.inf, required=20.0), "not known"),
        (Finding("inspection", "", True, "", value=0.836, required=0.8, unit=""), "83 %"),
        (Finding("turn", "a", True, ""), "\N{EN DASH}"),
    ],
)
def test_figures_are_rounded_to_the_safe_side(scene: Scene, finding: Finding, figure: str) -> None:
    told = verdicts.section(None, [finding], scene.frame)
    assert (*told.open_rows, *told.proven_rows)[0].figure == figure


@pytest.mark.parametrize(
    ("late", "words"),
    [
        ((3.29, 2.0, True), "All keep apart while none is more than 3.2 s early or late, asked for is 2 s."),
        (
            (1.99, 2.0, False),
            "All keep apart while none is more than 1.9 s early or late, asked for is 2 s: NOT PROVEN.",
        ),
    ],
)
def test_how_late_anyone_may_be_is_told_beside_the_distances(
    scene: Scene, plan: FleetPlan, tmp_path: Path, late: tuple[float, float, bool], words: str
) -> None:
    value, required, proven = late
    finding = Finding("lateness", "uav0 - uav1", proven, "", value=value, required=required, unit="s")
    others = tuple(f for f in proof_of(plan).findings if f.check != "lateness")
    certificate = replace(proof_of(plan), findings=(*others, finding))
    html = write_report(tmp_path, scene, replace(plan, certificate=certificate)).read_text(encoding="utf-8")
    assert words in html[html.index("<h2>Distance between the vehicles</h2>") :]


def test_of_many_proven_pairs_the_tightest_are_listed(scene: Scene) -> None:
    pairs = [
        Finding("return", f"a{i} - b", True, "apart", value=30.0 + (i * 7) % 100, required=26.0) for i in range(100)
    ]
    told = verdicts.section(None, [*pairs, replace(WAIVED, vehicle="a - b"), LOW], scene.frame)
    assert told.proven_pairs_left == 100 - len(told.proven_rows) > 0
    assert [row.figure for row in told.proven_rows][:3] == ["30.00 m", "31.00 m", "32.00 m"]
    assert [row.state for row in told.open_rows] == ["unproven", "waived"]


def test_legs_are_as_green_as_they_have_room_and_red_where_not_proven() -> None:
    red, amber, green = (style.room_colour(room) for room in (-5.0, 0.0, style.ROOM_SHOWN_M))
    assert red == amber != green == style.room_colour(1e9)
    assert style.room_colour(1e9, proven=False) == style.BAD


# --- missions that were not planned here -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def check_scene() -> Scene:
    data = question(vehicles=3, description="<i>checked</i>")
    data["vehicles"][2].update({"class": "plane", "return_height_m": 320})
    return build_check_scene(Mission.model_validate(data), Path(), [])


def sortie(scene: Scene, index: int, *legs: Leg, **changes: Any) -> Sortie:
    task = scene.tasks[index]
    said = {"vehicle_class": "copter", "ending": "rtl", **changes}
    return Sortie(
        name=task.name, sysid=task.sysid, autopilot="ardupilot", home_m=task.home_m, legs=legs,
        ending_seq=legs[-1].seq + 1, start_delay_s=0.0, return_height_m=task.motion.return_height_m, **said,
    )  # fmt: skip


def leg(scene: Scene, seq: int, kind: Any, x: float, y: float, agl_m: float, **changes: Any) -> Leg:
    z = float(scene.terrain.height_amsl_m(x, y))
    return Leg(seq, kind, np.array([x, y, (z if math.isfinite(z) else 400.0) + agl_m]), 8.0, **changes)


@pytest.fixture(scope="module")
def sorties(check_scene: Scene) -> list[Sortie]:
    s = check_scene
    return [
        sortie(
            s, 0, leg(s, 1, "takeoff", -40, -20, 40), leg(s, 3, "straight", 100, -60, 60),
            leg(s, 4, "spline", 250, -120, 70), leg(s, 5, "spline", 330, 40, 60), leg(s, 6, "straight", 450, 120, 50),
        ),
        sortie(
            s, 1, leg(s, 1, "takeoff", -40, 20, 40), leg(s, 2, "straight", 60, 150, 80),
            leg(s, 3, "circle", 150, 330, 90, radius_m=50.0, turns=2.0), leg(s, 6, "straight", 600, 380, 60),
            ending="land", gaps=(Gap(5, "DO_JUMP: <u>repeats</u> items"),),
        ),
        sortie(
            s, 2, leg(s, 1, "takeoff", 150, 60, 150), leg(s, 2, "straight", 500, 60, 200),
            leg(s, 3, "straight", 100, 350, 200), vehicle_class="plane", ending="loiter",
        ),
    ]  # fmt: skip


@pytest.fixture(scope="module")
def checked(check_scene: Scene, sorties: list[Sortie]) -> Certificate:
    return proof.prove(check_scene, sorties)


def test_a_check_has_a_page_of_its_own(
    check_scene: Scene, sorties: list[Sortie], checked: Certificate, tmp_path: Path
) -> None:
    path = write_check_report(tmp_path, check_scene, checked, sorties)
    html = path.read_text(encoding="utf-8")
    assert path == tmp_path / "check.html"
    assert f"NOT PROVEN: {len(checked.problems)} of {len(checked.findings)} checks." in html
    assert "DO_JUMP: &lt;u&gt;repeats&lt;/u&gt; items" in html
    assert "&lt;i&gt;checked&lt;/i&gt;" in html
    assert not re.search(r"<[ui]>", html)
    embedded = {base64.b64decode(data) for data in re.findall(r"base64,([^\"]*)", html)}
    saved = {picture.name: picture.read_bytes() for picture in (tmp_path / "pictures").glob("*.png")}
    assert set(saved) == {"map.png", "profile-uav0.png", "profile-uav1.png", "profile-uav2.png"}
    assert embedded == set(saved.values())
    again = write_check_report(tmp_path / "again", check_scene, checked, sorties)
    assert again.read_bytes() == path.read_bytes()


def test_legs_are_drawn_where_they_are_flown(check_scene: Scene, sorties: list[Sortie], checked: Certificate) -> None:
    copter, circling, plane = sketch_of(check_scene, checked, sorties).vehicles
    spline = next(leg for leg in copter.legs if leg.kind == "spline")
    assert len(spline.line_m) > 5
    assert np.allclose(spline.line_m[[0, -1]], [sorties[0].legs[1].end_m, sorties[0].legs[2].end_m])
    home = copter.legs[-2]
    assert (home.kind, len(home.line_m)) == ("return", 3)  # up, then over home
    ring = next(leg for leg in circling.legs if leg.kind == "circle").line_m[1:]
    assert np.allclose(np.linalg.norm(ring - sorties[1].legs[2].end_m, axis=1), 50.0)
    (flight,) = [f for f in proof.predict(check_scene, sorties) if f.sortie.vehicle_class == "plane"]
    drawn = {tuple(point) for leg in plane.legs for point in leg.line_m.tolist()}
    assert drawn >= {tuple(point) for point in flight.trajectory.position_m.tolist()}
    for one, other in pairwise(plane.legs):
        assert np.array_equal(one.line_m[-1], other.line_m[0])


def test_the_legs_after_what_is_not_understood_are_not_shown_as_proven(
    check_scene: Scene, sorties: list[Sortie], checked: Certificate
) -> None:
    assured = replace(checked, legs=tuple(replace(verdict, proven=True) for verdict in checked.legs))
    gap = next(f for f in checked.findings if f.check == "understood" and not f.proven)
    course = sketch_of(check_scene, replace(assured, findings=(gap,)), sorties).vehicles[1]
    assert [leg.proven for leg in course.legs] == [leg.seq < 5 for leg in course.legs]
    steep = Finding("angle", "uav1", False, "too steep", seq=2)
    course = sketch_of(check_scene, replace(assured, findings=(steep,)), sorties).vehicles[1]
    assert [leg.seq for leg in course.legs if not leg.proven] == [2]


def test_room_to_spare_is_what_the_tightest_leaves(
    check_scene: Scene, sorties: list[Sortie], checked: Certificate
) -> None:
    course = sketch_of(check_scene, checked, sorties).vehicles[0]
    limits = course.task.limits
    verdict = next(v for v in checked.legs if v.vehicle == "uav0" and v.seq == 6)
    tight = replace(verdict, terrain_m=limits.terrain_margin_m + 9.0, obstacle_m=limits.obstacle_margin_m + 4.0)
    for change, room_m in (({}, 4.0), ({"fence_m": limits.obstacle_margin_m + 1.5}, 1.5), ({"obstacle_m": None}, 9.0)):
        changed = replace(tight, **{"fence_m": 1e3, **change})  # type: ignore[arg-type]
        nowhere = Trajectory(np.zeros(1), np.zeros((1, 3)))
        (drawn,) = verdicts.leg_facts(course.task, [changed], [], sorties[0], nowhere, np.zeros(5))
        assert drawn.room_m == pytest.approx(room_m)


def red_share(png: bytes) -> float:
    picture = np.asarray(imread(io.BytesIO(png)), dtype=float)[..., :3]
    red = np.array([int(style.BAD[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return float((np.abs(picture - red).max(axis=-1) < 0.04).mean())


def test_a_leg_that_is_not_proven_is_red_on_its_height_profile(scene: Scene, plan: FleetPlan) -> None:
    shares = []
    for one in (plan, with_findings(plan, LOW)):
        facts = collect(scene, one, None)
        with style.look():
            figure = charts.height_profile(facts, shapes(scene), facts.vehicles[0])
            shares.append(red_share(style.to_png(figure)))
            words = {text.get_text() for text in figure.axes[0].texts}
    assert shares[0] == 0.0
    assert shares[1] > 1e-3
    assert "item 5" in words


def test_a_mission_over_unknown_ground_is_drawn_without_it(check_scene: Scene) -> None:
    s = check_scene
    away = sortie(s, 0, leg(s, 1, "takeoff", 5000, 5000, 40), leg(s, 2, "straight", 5200, 5000, 60))
    away = replace(away, home_m=np.array([5000.0, 5000.0, 400.0]), ending="land")
    certificate = proof.prove(s, [away])
    sketch = sketch_of(s, certificate, [away])
    with style.look():
        figure = charts.height_profile(sketch, shapes(s), sketch.vehicles[0])
        style.to_png(figure)
    said = " ".join(text.get_text() for text in figure.texts)
    assert "height above ground not known" in said
    assert "pale red: ground unknown" in said


def test_the_ground_that_counts_is_what_the_tubes_underside_meets(scene: Scene) -> None:
    way = np.column_stack([np.linspace(100.0, 300.0, 50), np.full(50, 60.0), np.full(50, 600.0)])
    tube_m = np.where(np.arange(50) < 25, 0.0, 8.0)
    found = charts._ground_under_tube(scene.terrain, way, tube_m)
    below = scene.terrain.height_amsl_m(way[:, 0], way[:, 1])
    assert np.allclose(found[:25], below[:25])
    aside = np.linspace(-8.0, 8.0, 401)
    drop = 8.0 - np.sqrt(64.0 - aside**2)
    heights = scene.terrain.height_amsl_m(way[25:, :1] + 0.0 * aside, way[25:, 1:2] + aside) - drop
    assert np.allclose(found[25:], heights.max(axis=1), atol=0.3)
    assert (found[25:] > below[25:]).all()  # the way runs along a slope


# --- facts ---------------------------------------------------------------------------------------------------------


def test_a_flight_off_its_way_is_remarked(scene: Scene, plan: FleetPlan) -> None:
    facts = collect(scene, plan, flight_of(plan, aside_m=15.0))
    for vehicle in facts.vehicles:
        assert vehicle.flown is not None
        assert vehicle.flown.deviation_m == pytest.approx(15.0, abs=0.3)
    assert len(facts.remarks) == 2
    assert facts.troubles == ()


def test_a_vehicle_that_never_arrives_is_trouble(scene: Scene, plan: FleetPlan) -> None:
    flight = flight_of(plan)
    lost = replace(flight.vehicles[1], arrival_s=None, landed_s=None)
    facts = collect(scene, plan, FleetFlight((flight.vehicles[0], lost)))
    assert facts.troubles == ("uav1 never arrived at its goal",)


def test_vehicles_that_meet_in_flight_are_trouble(scene: Scene, plan: FleetPlan) -> None:
    flight = flight_of(plan)
    track = flight.vehicles[0].trajectory
    beside = Trajectory(track.t_s, track.position_m + np.array([0.0, 5.0, 0.0]))
    facts = collect(scene, plan, FleetFlight((flight.vehicles[0], replace(flight.vehicles[1], trajectory=beside))))
    assert any("5.0 m from each other" in trouble for trouble in facts.troubles)


def test_a_way_whose_legs_share_their_ends_is_followed_to_its_end() -> None:
    ends = np.array([[0.0, 0.0, 50.0], [900.0, 0.0, 60.0], [1300.0, 500.0, 70.0], [1300.0, 520.0, 70.0]])
    doubled = np.repeat(ends, 2, axis=0)  # as legs are put together
    positions = np.concatenate([np.linspace(a, b, 40, endpoint=False) for a, b in pairwise(ends)])
    np.testing.assert_allclose(along_path_m(doubled, positions), along_m(positions), atol=1e-6)


def test_places_are_found_in_order_on_a_path_that_crosses_itself() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    eight = np.stack([200 * np.sin(turn), 100 * np.sin(2 * turn), np.full(turn.shape, 50.0)], axis=-1)
    run = along_m(eight)
    found = along_path_m(eight, eight + np.array([0.3, -0.2, 0.4]))
    assert np.all(np.diff(found) >= 0.0)
    assert np.allclose(found, run, atol=2.0)


def test_distances_per_pair_and_to_the_nearest_of_many() -> None:
    t_s = np.array([0.0, 10.0])
    tracks = [Trajectory(t_s, np.array([[0.0, 30.0 * i, 0.0], [10.0, 30.0 * i * i, 0.0]])) for i in range(5)]
    few = distances(tracks[:3], [4.321])
    assert few.pairs == ((0, 1), (0, 2), (1, 2))
    assert 4.321 in few.t_s
    assert few.distance_m[1, 0] == pytest.approx(60.0)
    assert few.distance_m[1, -1] == pytest.approx(120.0)
    many = distances(tracks)
    assert many.pairs is None
    assert many.distance_m[4, -1] == pytest.approx(30.0 * (16 - 9))
    assert many.distance_m[0, -1] == pytest.approx(30.0)


# --- shapes --------------------------------------------------------------------------------------------------------


def shape_named(scene: Scene, name: str) -> tuple[Shape, int]:
    index = scene.obstacles.names.index(name)
    return shapes(scene)[index], index


@pytest.mark.parametrize("name", [o["name"] for o in OBSTACLES])
def test_the_section_of_an_obstacle_is_where_its_distance_is_negative(scene: Scene, name: str) -> None:
    shape, index = shape_named(scene, name)
    reach = np.ptp(shape.outline_m, axis=0).max() / 2 + 5.0
    xy = shape.centre_m + np.random.default_rng(1).uniform(-reach, reach, (400, 2))
    low, high = vertical_range(shape, xy)
    top = np.where(np.isfinite(high), high, 900.0)
    bottom = np.where(np.isfinite(low), low, -50.0)
    taken = ~np.isnan(high)
    assert taken.any()
    slack = 0.3  # a cable's section is a parallelogram's, not a capsule's, at its ends

    def distance(z: FloatArray) -> FloatArray:
        return scene.obstacles.distance_m(np.column_stack([xy, z]))[:, index]

    assert (distance((top + bottom) / 2)[taken] <= slack).all()
    assert (distance(top + 1.0)[taken & np.isfinite(high)] >= 0.0 - slack).all()
    anywhere = np.where(taken, 0.0, distance(np.random.default_rng(2).uniform(300, 700, 400)))
    assert (anywhere >= 0.0).all()


@pytest.mark.parametrize("name", ["mast", "needle", "radar", "storm", "camp"])
def test_facets_lie_on_the_surface_and_look_outward(scene: Scene, name: str) -> None:
    shape, index = shape_named(scene, name)
    for stack in facets(shape, ground_amsl_m=-1e3, cap_amsl_m=5e3):
        away = scene.obstacles.distance_m(stack)[..., index]
        assert np.abs(away).max() < 0.03 * shape.radius_m + 1e-6
        if stack.shape[1] == 4:
            normal = np.cross(stack[:, 2] - stack[:, 0], stack[:, 3] - stack[:, 1])
            size = np.linalg.norm(normal, axis=1)
            whole = size > 1e-6
            out = stack.mean(axis=1)[whole] + 0.5 * normal[whole] / size[whole, None]
            inward = stack.mean(axis=1)[whole] - 0.5 * normal[whole] / size[whole, None]
            assert np.all(
                scene.obstacles.distance_m(out)[:, index] > scene.obstacles.distance_m(inward)[:, index] - 1e-9
            )


def test_towers_and_conductors_are_told_from_declared_obstacles(scene: Scene) -> None:
    kinds = [shape.kind for shape in shapes(scene)]
    assert kinds.count("tower") == 5
    assert kinds.count("conductor") == 4
    assert kinds.count("cable") == 1
    assert kinds.count("cylinder") == 1


LIFT = {
    "kind": "line", "name": "lift", "supports": [at(-60, 300, 20), at(200, 380, 25), at(420, 400, 20)],
    "catenary_m": 500,
}  # fmt: skip


@pytest.mark.parametrize(("name", "kind"), [("span T1-T2", "conductor"), ("lift", "line")])
def test_the_section_of_a_span_is_all_below_its_conductors(name: str, kind: str) -> None:
    scene = scene_of(question(obstacles=[LIFT]))
    assert [shape.kind for shape in shapes(scene)].count("support") == 3
    shape = next(shape for shape in shapes(scene) if shape.name == name and shape.kind == kind)
    reach = np.ptp(shape.outline_m, axis=0).max() / 2 + 5.0
    xy = shape.centre_m + np.random.default_rng(1).uniform(-reach, reach, (400, 2))
    low, top = vertical_range(shape, xy)
    taken = ~np.isnan(top)
    assert taken.any()
    assert not taken.all()
    assert (low[taken] == -np.inf).all()
    ends = shape.axis_m[:, :2]
    between = np.all((xy > ends.min(axis=0)) & (xy < ends.max(axis=0)), axis=1)  # where no other span is as near
    curtains = (scene.obstacles.arrays.kind == kernels.CURTAIN) & [n == name for n in scene.obstacles.names]

    def distance(z: FloatArray | float) -> FloatArray:
        return scene.obstacles.distance_m(np.column_stack([xy, np.zeros(len(xy)) + z]))[:, curtains].min(axis=1)

    assert (distance(-1e3)[taken] <= 1e-6).all()
    if kind == "conductor":  # of another line all spans have one name
        assert (distance(-1e3)[~taken] >= -1e-9).all()
    assert (distance(top - 0.3)[taken & between] <= 0.0).all()
    assert (distance(top + 0.3)[taken & between] >= 0.0).all()


def test_of_another_line_the_middle_span_is_named() -> None:
    found = maps.named(shapes(scene_of(question(obstacles=[LIFT, MAST]))))
    assert [(shape.name, shape.kind) for shape in found] == [("mast", "cylinder"), ("lift", "line")]


# --- pictures ------------------------------------------------------------------------------------------------------


def map_of(scene: Scene, plan: FleetPlan) -> FloatArray:
    with style.look():
        figure = maps.fleet_map(collect(scene, plan, None), shapes(scene))
        return np.asarray(imread(io.BytesIO(style.to_png(figure))), dtype=float)[..., :3]


def test_a_thin_cable_is_seen_on_the_map(scene: Scene, plan: FleetPlan) -> None:
    with style.look():
        figure = maps.fleet_map(collect(scene, plan, None), shapes(scene))
        picture = np.asarray(imread(io.BytesIO(style.to_png(figure))), dtype=float)[..., :3]
        cable = np.array([150.0, -150.0]) + np.linspace(0.12, 0.95, 200)[:, None] * np.array([270.0, 480.0])
        along = figure.axes[0].transData.transform(cable)
    column, row = along[:, 0].round().astype(int), picture.shape[0] - 1 - along[:, 1].round().astype(int)
    dark = picture[row, column].max(axis=-1) < 0.35
    assert dark.mean() > 0.85  # hidden only where paths and towers lie over it


def test_names_cover_neither_each_other_nor_a_path() -> None:
    with style.look():
        figure = style.new_figure(4.0, 6.0)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_xlim(0, 100)
        axes.set_ylim(0, 70)
        labels = Labels(axes)
        line = np.column_stack([np.linspace(0, 100, 50), 35 + 20 * np.sin(np.linspace(0, 6, 50))])
        labels.avoid_line(line)
        rng = np.random.default_rng(3)
        placed = [labels.place(f"tower-{i}", rng.uniform([5, 5], [95, 65]), size=7) for i in range(60)]
        assert sum(placed) > 20
        figure.canvas.draw()
        boxes = [text.get_window_extent().extents for text in axes.texts]
        on_line = axes.transData.transform(line)
    assert len(boxes) == sum(placed)
    for i, a in enumerate(boxes):
        assert not ((on_line > a[:2]) & (on_line < a[2:])).all(axis=1).any()
        for b in boxes[i + 1 :]:
            assert min(a[2], b[2]) <= max(a[0], b[0]) or min(a[3], b[3]) <= max(a[1], b[1])


def test_the_ground_hides_what_is_behind_a_ridge() -> None:
    ridge = {"kind": "peaks", "peaks": [{**at(300, 100), "height_m": 300, "spread_m": 80}]}
    scene = scene_of(question(terrain=ridge, obstacles=[], fence=None, inspection=None))
    facts = collect(scene, plan_of(scene, above_m=400.0), None)
    block, _ = view._draw_block(facts, ())
    sin, cos = block.camera.sin_cos
    behind = np.array([300.0 + 200 * sin, 100.0 + 200 * cos, 10.0])
    in_front = np.array([300.0 - 200 * sin, 100.0 - 200 * cos, 10.0])
    above = behind + np.array([0.0, 0.0, 600.0])
    assert block.visible(np.array([behind, in_front, above])).tolist() == [False, True, True]


def test_slopes_towards_the_sun_are_brighter_and_voids_are_plain() -> None:
    x = np.linspace(0.0, 1000.0, 50)
    height = 300.0 * np.exp(-(((x[None, :] - 500) ** 2 + (x[:, None] - 500) ** 2) / 300.0**2))
    height[0, :5] = np.nan
    colours = relief_colours(Ground(x, x, height), sea=False)
    north_west, south_east = colours[32, 17].mean(), colours[17, 32].mean()
    assert north_west > south_east + 25
    assert np.ptp(colours[0, :5], axis=0).max() == 0.0


@pytest.mark.parametrize(("relief_m", "interval_m"), [(0.0, 0.0), (11.0, 1.0), (130.0, 20.0), (1900.0, 200.0)])
def test_contours_are_round_and_about_a_dozen(relief_m: float, interval_m: float) -> None:
    assert contour_interval_m(relief_m) == interval_m


def test_a_plain_at_a_round_altitude_has_no_contours() -> None:
    x = np.linspace(0.0, 1000.0, 60)
    noise = np.random.default_rng(5).normal(0.0, 1e-4, (60, 60))
    hill = 120.0 * np.exp(-(((x[None, :] - 500) ** 2 + (x[:, None] - 500) ** 2) / 100.0**2))
    ground = Ground(x, x, 400.0 + noise + hill)
    levels = contour_levels_m(ground)
    crossed = np.abs(np.diff(ground.height_amsl_m[:, :10] > levels[:, None, None], axis=1))
    assert 5 < levels.size < 15
    assert not crossed.any()


def test_only_a_fleet_that_arrives_together_has_a_common_time(scene: Scene, plan: FleetPlan) -> None:
    apart = scene_of(question(fleet={"arrive_together": False}))
    with style.look():
        together, alone = (
            charts.arrival_windows(collect(s, p, None)) for s, p in ((scene, plan), (apart, plan_of(apart)))
        )
    assert "common arrival" in together.texts[0].get_text()
    assert "common arrival" not in alone.texts[0].get_text()
