"""The map and the table of what was seen say what the coverage says."""

from __future__ import annotations

from collections import Counter

import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Wedge

from missionplanner.coverage import Coverage, measure
from missionplanner.plan import Trajectory
from missionplanner.report import style
from missionplanner.report.coverage import CoverageRow, coverage_map, coverage_rows
from missionplanner.scene import Scene
from missionplanner.views import visits
from tests.lines import open_question, open_scene
from tests.scenes import at, copter, question, scene_of
from tests.unit.test_coverage import ALONG, flown, still


def partly() -> tuple[Scene, Coverage, list[Trajectory]]:
    """Return a line of which T1 is seen, T2 from the left only, T3 not; of its spans, one side."""
    scene = open_scene(open_question(**ALONG))
    wanted = {"T1.left", "T1.right", "T2.left", "span T1-T2.left"}
    tracks = [flown([visit]) for visit in visits(scene)[0] if visit.name in wanted]
    return scene, measure(scene, tracks, names=["alpha"] * len(tracks)), tracks


def words(figure: Figure) -> Counter[str]:
    return Counter(text.get_text() for axes in figure.axes for text in axes.texts)


def test_a_row_for_every_tower_and_span_with_its_least_favourable_figures() -> None:
    _, found, _ = partly()
    rows = {row.target: row for row in coverage_rows(found)}
    shares = {target: [row.share for row in found.spans if row.target == target] for target in rows}
    assert list(rows) == ["T1", "T2", "T3", "span T1-T2", "span T2-T3"]
    assert {name: (row.verdict, row.sides) for name, row in rows.items()} == {
        "T1": ("seen", "2 of 2"),
        "T2": ("partly seen", "1 of 2"),
        "T3": ("not seen", "0 of 2"),
        "span T1-T2": ("partly seen", f"{min(shares['span T1-T2']):.0%}"),
        "span T2-T3": ("partly seen", f"{min(shares['span T2-T3']):.0%}"),  # who stands beside T2 sees its beginning
    }
    assert rows["T1"].distance_m == pytest.approx(30.0)
    assert rows["T1"].vehicles == ("alpha",)
    assert rows["T1"].why == ""
    assert rows["T2"].why.startswith("T2.right: ")
    assert rows["T3"].distance_m is None
    assert rows["T1"].photos is None


def test_the_map_shows_each_side_of_each_tower_as_seen_or_not() -> None:
    scene, found, tracks = partly()
    with style.look():
        figure = coverage_map(scene, found, tracks)
        assert len(style.to_png(figure)) > 10_000
    wedges = [patch for axes in figure.axes for patch in axes.patches if isinstance(patch, Wedge)]
    assert len(wedges) == 6
    assert Counter(to_hex(wedge.get_facecolor()) for wedge in wedges) == {"#2fa05a": 3, "#ffffff": 3}
    west = [
        wedge
        for wedge in wedges
        if wedge.theta1 <= 180.0 <= wedge.theta2 and to_hex(wedge.get_facecolor()) != "#ffffff"
    ]
    assert len(west) == 2  # the left sides of T1 and T2: the line runs north
    shown = words(figure)
    assert {"T2", "T3"} <= set(shown)
    assert {"seen: 1", "partly seen: 1", "not seen: 1", "flown track"} <= set(shown)


def test_the_map_shows_spans_by_how_much_of_them_was_seen() -> None:
    scene, found, tracks = partly()
    with style.look():
        figure = coverage_map(scene, found, tracks)
    colours = Counter(to_hex(line.get_color()) for line in figure.axes[0].lines)
    assert colours["#2fa05a"] == 1
    assert colours["#e69f00"] == sum(0.0 < row.share < 0.95 for row in found.spans)
    assert colours[style.BAD] == sum(row.share == 0.0 for row in found.spans)
    drawn = [part for part in figure.axes[0].collections if isinstance(part, LineCollection)]
    assert max(len(part.get_segments()) for part in drawn) >= len(tracks)


def test_towers_that_are_not_asked_for_are_drawn_as_such() -> None:
    data = open_question(**ALONG)
    data["inspection"]["towers"][2]["views"] = "none"
    scene = open_scene(data)
    with style.look():
        figure = coverage_map(scene, measure(scene, []), [])
    wedges = [patch for patch in figure.axes[0].patches if isinstance(patch, Wedge)]
    assert len(wedges) == 4
    assert "flown track" not in words(figure)


def test_a_mission_without_views_has_a_map_too() -> None:
    towers = [{"name": f"T{k}", **at(0.0, 200.0 * k), "height_m": 35.0} for k in range(3)]
    scene = scene_of(question(copter("alpha", (-100.0, 0.0), (-100.0, 400.0)), inspection={"towers": towers}))
    track = still([0.0, 200.0, 150.0], 5.0)
    found = measure(scene, [track], names=["alpha"])
    assert coverage_rows(found)[1] == CoverageRow(
        target="T1",
        verdict="seen",
        sides="1 of 1",
        distance_m=pytest.approx(15.0),
        angle_deg=None,
        gsd_mm=None,
        photos=None,
        vehicles=("alpha",),
        why="",
    )
    with style.look():
        figure = coverage_map(scene, found, [track])
    assert {"seen: 1", "not seen: 2"} <= set(words(figure))
