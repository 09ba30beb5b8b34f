"""The pages of single vehicles and of whole inspections."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from missionplanner import coverage, energy
from missionplanner.certificate import Certificate, Finding
from missionplanner.errors import MissionError
from missionplanner.inspection import InspectionPlan
from missionplanner.plan import Action, FleetPlan, Trajectory
from missionplanner.report import style, write_report
from missionplanner.report.crew import write_vehicle_pages
from missionplanner.report.facts import collect
from missionplanner.report.maps import TowerMark, inspection_map
from missionplanner.report.overview import write_inspection_report
from missionplanner.scene import Scene
from tests import inspections
from tests.inspections import inspection_by_hand
from tests.unit.test_report import plan_of, question, scene_of


def plain(path: Path) -> str:
    """Return a page's words, without pictures and marks."""
    body = re.sub(r"<style>.*?</style>|base64,[^\"]*", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", body)))


def rows(path: Path, table: str) -> list[list[str]]:
    """Return the cells of a page's table by its class."""
    html = path.read_text(encoding="utf-8")
    (found,) = re.findall(rf'<table class="{table}">(.*?)</table>', html, flags=re.DOTALL)
    return [
        [unescape(re.sub(r"<[^>]+>", "", cell)).strip() for cell in re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row)]
        for row in re.findall(r"<tr[^>]*>(.*?)</tr>", found.partition("<tbody>")[2], flags=re.DOTALL)
    ]


# --- a vehicle's page


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(question(description="<b>Bold</b>"))


@pytest.fixture(scope="module")
def plan(scene: Scene) -> FleetPlan:
    plan = plan_of(scene)
    first = plan.vehicles[0]
    actions = {3: Action("T01.left", "T01", hold_s=3.0, look_at_m=(1.0, 2.0, 3.0), photos=2)}
    assert len(first.waypoints_m) > 4
    holds_s = first.hold_s.copy()
    holds_s[2] = 3.0
    return replace(plan, vehicles=(replace(first, actions=actions, hold_s=holds_s), *plan.vehicles[1:]))


@pytest.fixture(scope="module")
def folder(scene: Scene, plan: FleetPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pages")
    write_report(folder, scene, plan, vehicle_pages=True)
    return folder


def test_every_vehicle_has_a_page_that_the_report_links_to(folder: Path, plan: FleetPlan) -> None:
    links = re.findall(r'href="([^"]+)"', (folder / "report.html").read_text(encoding="utf-8"))
    assert links == [f"report-{v.name}.html" for v in plan.vehicles]
    for v, link in zip(plan.vehicles, links, strict=True):
        html = (folder / link).read_text(encoding="utf-8")
        assert f"<title>hills: {v.name}</title>" in html
        assert "<b>" not in html
        assert all(src.startswith("data:image/png") for src in re.findall(r'src="([^"]{0,40})', html))
        others = {other.name for other in plan.vehicles} - {v.name}
        assert not [name for name in others if f">{name}<" in html]


def test_it_lists_what_is_done_where_and_when(folder: Path, plan: FleetPlan, scene: Scene) -> None:
    vehicle = plan.vehicles[0]
    found = rows(folder / "report-uav0.html", "places")
    assert [row[1] for row in found] == ["take-off", "T01.left", "goal", "touch-down"]
    number, _, _, clock, does, amsl, above_home, above_ground = found[1]
    assert number == "1"
    minutes, seconds = map(int, clock.split(":"))
    assert 60 * minutes + seconds == round(float(vehicle.reached_s[3]))
    assert does == "looks at T01, stands 3 s, 2 photos"
    x, y, z = vehicle.waypoints_m[3]
    assert (int(amsl), int(above_home)) == (round(z), round(z - vehicle.home_m[2]))
    assert int(above_ground) == round(z - float(scene.terrain.height_amsl_m(x, y)))
    assert f"{len(vehicle.waypoints_m) - 3} more waypoints" in plain(folder / "report-uav0.html")


def test_battery_and_return_height_are_those_of_the_plan(folder: Path, plan: FleetPlan, scene: Scene) -> None:
    vehicle, settings = plan.vehicles[1], scene.mission.vehicles[1]
    model = energy.energy_model(settings)
    assert model is not None
    used = energy.used_share(model, vehicle.trajectory, 0.0, vehicle.start_delay_s)[-1]
    words = plain(folder / "report-uav1.html")
    assert f"battery left {1.0 - used:.0%}" in words
    assert "returns at 300 m" in words
    assert "sysid 2" in words


def test_a_vehicle_that_is_not_proven_says_so_on_its_page_only(scene: Scene, plan: FleetPlan, tmp_path: Path) -> None:
    assert plan.certificate is not None
    low = Finding("terrain", "uav1", False, "12.3 m above ground", "fly higher")
    certificate = replace(plan.certificate, findings=(*plan.certificate.findings, low))
    write_vehicle_pages(tmp_path, collect(scene, replace(plan, certificate=certificate), None))
    assert "fly higher" in plain(tmp_path / "report-uav1.html")
    assert 'class="verdict unclear"' in (tmp_path / "report-uav1.html").read_text()
    assert "fly higher" not in plain(tmp_path / "report-uav0.html")


def test_the_same_plan_the_same_pages(scene: Scene, plan: FleetPlan, folder: Path, tmp_path: Path) -> None:
    pages = write_vehicle_pages(tmp_path, collect(scene, plan, None))
    assert [path.name for path in pages] == ["report-uav0.html", "report-uav1.html"]
    for path in pages:
        assert path.read_bytes() == (folder / path.name).read_bytes()


# --- a whole inspection


def proven(planned: InspectionPlan, *open_: Finding) -> InspectionPlan:
    """Return an inspection whose rounds carry certificates that prove all but some."""

    def certified(plan: FleetPlan) -> FleetPlan:
        own = [
            Finding("energy", v.name, True, "takes half of its battery", value=0.5, required=0.8, unit="")
            for v in plan.vehicles
        ]
        bad = [finding for finding in open_ if finding.vehicle in {v.name for v in plan.vehicles}]
        certificate = Certificate((*own, *bad), (), (), {}, {}, plan.input_sha256, "0")
        return replace(plan, certificate=certificate)

    return replace(planned, rounds=tuple(replace(r, plan=certified(r.plan)) for r in planned.rounds))


@pytest.fixture(scope="module")
def planned() -> InspectionPlan:
    return proven(inspection_by_hand())


@pytest.fixture(scope="module")
def overview(planned: InspectionPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_inspection_report(tmp_path_factory.mktemp("overview"), planned)


def test_what_is_left_out_stands_above_all(overview: Path) -> None:
    words = plain(overview)
    assert 'left out: T03: no view is clear of "mast", 4.2 m are missing: raise distance_m' in words
    assert 'class="verdict waived"' in overview.read_text(encoding="utf-8")
    assert "of 7 targets are inspected in 2 rounds, all proven; 1 were before" in words
    assert words.index("left out: T03") < words.index("makespan")


def test_it_links_to_the_rounds_reports_and_the_crews_pages_that_are_there(
    planned: InspectionPlan, overview: Path, tmp_path: Path
) -> None:
    assert "href=" not in overview.read_text(encoding="utf-8")
    there = ["round-1/report.html", "round-1/report-alpha.html", "round-1/report-bravo.html", "round-2/report.html"]
    for page in there:
        (tmp_path / page).parent.mkdir(exist_ok=True)
        (tmp_path / page).write_text("a page")
    html = write_inspection_report(tmp_path, planned).read_text(encoding="utf-8")
    assert re.findall(r'href="([^"]+)"', html) == there


def test_every_visit_is_listed_with_who_pays_it(overview: Path, planned: InspectionPlan) -> None:
    found = rows(overview, "targets")
    assert len(found) == len(planned.visits)
    by_whom = {row[2] for row in found}
    assert by_whom == {"alpha, round 1", "bravo, round 1", "alpha, round 2", "done before", "left out"}
    assert sum(row[2] == "left out" for row in found) == 2
    names = {path.stem for path in (overview.parent / "pictures").glob("*.png")}
    assert names >= {"inspection", "timetable"}


def test_a_round_that_is_not_proven_makes_all_unclear(tmp_path: Path) -> None:
    low = Finding("terrain", "bravo", False, "12.3 m above ground", "fly higher")
    page = write_inspection_report(tmp_path, proven(inspection_by_hand(), low))
    words = plain(page)
    assert 'class="verdict unclear"' in page.read_text(encoding="utf-8")
    assert "round 1: bravo: 12.3 m above ground: fly higher" in words
    assert "NOT PROVEN" in words


def test_what_flights_did_not_show_is_told(planned: InspectionPlan, tmp_path: Path) -> None:
    left = [v.position_m for visit in planned.visits if visit.name == "T02.left" for v in visit.viewpoints]
    tracks = [Trajectory(np.arange(0.0, 8.0, 0.5), np.tile(place_m, (16, 1))) for place_m in left]
    seen = coverage.measure(planned.scene, tracks, names=["alpha"])
    page = write_inspection_report(tmp_path, planned, seen, tracks)
    words = plain(page)
    assert "not seen: T02.right" in words
    assert "not seen: T02.left" not in words
    assert "not seen: T01" not in words  # it was inspected before
    told = {(row[0], row[1]): row[5] for row in rows(page, "targets")}
    assert told["T02", "left"].startswith("seen, 25 m")
    assert f"{seen.share:.0%}" in words
    assert "judged by position only: no log tells of photos" in words
    seen = coverage.measure(planned.scene, tracks, names=["alpha"], photos=tracks)
    assert "judged by position" not in plain(write_inspection_report(tmp_path, planned, seen, tracks))


@pytest.mark.parametrize("kind", ["overfly", "two_sides", "four_sides", "orbit"])
def test_what_no_flight_came_near_is_never_clear(kind: str, tmp_path: Path) -> None:
    data = inspections.question(views={"kind": kind, "below_top_m": [3.0, 12.0], "distance_m": 25.0})
    planned = replace(proven(inspection_by_hand(data)), left_out=(), done=frozenset())
    asked = {visit.name for r in planned.rounds for tour in r.tours for visit in tour.visits}

    def page(aside_m: float) -> tuple[str, list[list[str]]]:
        tracks = [
            Trajectory(np.arange(0.0, 12.0, 0.5), np.tile(v.position_m + np.array([aside_m, 0.0, 0.0]), (24, 1)))
            for visit in planned.visits
            for v in visit.viewpoints
        ]
        ways = [
            Trajectory(np.arange(0.0, 60.0, 0.5), np.linspace(begin, end, 120) + np.array([aside_m, 0.0, 0.0]))
            for visit in planned.visits
            if visit.target.startswith("span")
            for begin, end in [(visit.viewpoints[0].position_m, visit.viewpoints[1].position_m)]
        ]
        seen = coverage.measure(planned.scene, [*tracks, *ways])
        written = write_inspection_report(tmp_path, planned, seen, [*tracks, *ways])
        return written.read_text(encoding="utf-8"), rows(written, "targets")

    html, table = page(2000.0)
    assert 'class="verdict clear"' not in html
    flown = [row for row in table if "round" in row[2]]
    assert len(flown) == len(asked)
    assert all(row[5].startswith("not seen: ") for row in flown)
    html, table = page(0.0)
    assert 'class="verdict clear"' in html
    assert all(row[5].startswith("seen") for row in table if "round" in row[2])


def test_a_folder_in_the_way_is_told(planned: InspectionPlan, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(MissionError, match="taken"):
        write_inspection_report(tmp_path / "taken", planned)


def test_a_tower_of_two_vehicles_has_both_colours(planned: InspectionPlan) -> None:
    assert planned.scene.towers is not None
    here_m = planned.scene.towers.top_m[1]
    marks = [TowerMark(here_m, ("#ff0000", "#00ff00"), "planned")]
    facts = collect(planned.rounds[0].scene, planned.rounds[0].plan, None)
    with style.look():
        figure = inspection_map(facts, (), marks)
        pixels = np.asarray(imread(io.BytesIO(style.to_png(figure))))[..., :3]
    for colour in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]):
        assert (np.abs(pixels - colour).max(axis=-1) < 0.02).sum() > 20
