"""Views of towers: by hand where they can be told by hand; their laws against distances of an oracle's own."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner import camera, mission
from missionplanner.clearance import Margins
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.scene import Scene
from missionplanner.views import FURTHEST, STEEPEST_DEG, Visit, in_sight, sights, span_sights, visits
from tests.lines import open_question, open_scene
from tests.scenes import at

TOP_M = 135.0  # of all towers here: 35 m above ground at 100 m
MAST = {"kind": "cylinder", "name": "mast", "radius_m": 4.0, "top_height_agl_m": 60.0}


def views_of(data: dict[str, Any]) -> tuple[dict[str, Visit], dict[str, str]]:
    """Return visits and reasons for what is left out, by name."""
    found, left_out = visits(open_scene(data))
    return {visit.name: visit for visit in found}, {left.target: left.why for left in left_out}


def places(visit: Visit) -> FloatArray:
    return np.array([viewpoint.position_m for viewpoint in visit.viewpoints])


# --- by hand


def test_nobody_looks_through_an_obstacle() -> None:
    silo = {"kind": "cylinder", "name": "silo", "center": at(-20.0, 200.0), "radius_m": 3.0}
    for top_m, hides in ((60.0, True), (15.0, False)):
        asked = {"views": {"distance_m": 40.0}, "obstacles": [silo | {"top_height_agl_m": top_m}]}
        found, left_out = views_of(open_question(**asked))
        assert not left_out
        (place,) = places(found["T2.left"])
        way = place + np.linspace(0.0, 1.0, 201)[:, np.newaxis] * ([0.0, 200.0, 130.0] - place)
        through = (np.hypot(way[:, 0] + 20.0, way[:, 1] - 200.0) < 3.0) & (way[:, 2] < 100.0 + top_m)
        assert not through.any()
        assert bool(found["T2.left"].note) is hides


def test_a_way_along_a_span_from_which_all_is_in_sight_is_preferred() -> None:
    hall = {"kind": "no_fly", "name": "hall", "polygon": [at(-22, 90), at(-18, 90), at(-18, 110), at(-22, 110)]}
    asked = {"spans": {"sides": "left", "lateral_m": 40.0}}
    for top_m, rises in ((45.0, True), (15.0, False)):
        scene = open_scene(open_question(**asked, obstacles=[hall | {"top_height_agl_m": top_m}]))
        (sight, _) = span_sights(scene)
        assert sight.way_m is not None
        share = np.linspace(0.0, 1.0, 41)
        way = sight.way_m[0] + share[:, np.newaxis] * (sight.way_m[1] - sight.way_m[0])
        lines = np.stack([way, sight.span.conductor.catenary.at(share)], axis=1)
        at_hall = lines[:, 0] + (lines[:, 0, :1] + 20.0) / (lines[:, 0, :1] - lines[:, 1, :1]) * (
            lines[:, 1] - lines[:, 0]
        )
        beside = (at_hall[:, 1] >= 90.0) & (at_hall[:, 1] <= 110.0)
        assert (at_hall[beside, 2] > 100.0 + top_m).all()
        assert bool(sight.way_m[0, 2] > 136.0) is rises


@pytest.mark.parametrize(
    ("first", "second", "turned", "asked"),
    [
        ("left", "right", False, {"left": 30.0, "right": 40.0}),
        ("left", "both", False, {"left": 30.0, "right": 40.0}),
        ("left", "left", True, {"left": 30.0, "right": 40.0}),
        ("left", "right", True, {"left": 30.0}),
        ("both", "left", False, {"left": 30.0, "right": 30.0}),
    ],
)
def test_circuits_on_the_same_towers_are_each_seen_from_the_sides_they_ask_for(
    first: str, second: str, turned: bool, asked: dict[str, float]
) -> None:
    towers = ["T1", "T2", "T3"]
    lines = [
        {"name": "A", "towers": towers, "spans": {"sides": first, "lateral_m": 30.0}},
        {"name": "B", "towers": towers[::-1] if turned else towers, "spans": {"sides": second, "lateral_m": 40.0}},
    ]
    found = span_sights(open_scene(open_question(lines=lines)))
    assert {s.name: s.lateral_m for s in found if s.span.name == "span T1-T2"} == {
        f"span T1-T2.{side}": lateral_m for side, lateral_m in asked.items()
    }


def test_two_sides_are_left_and_right_of_the_line_in_the_order_of_its_towers() -> None:
    found, left_out = views_of(open_question(views={"distance_m": 30.0, "below_top_m": [8.0]}))
    assert list(found) == ["T1.left", "T1.right", "T2.left", "T2.right", "T3.left", "T3.right"]
    assert not left_out
    assert places(found["T2.left"]) == pytest.approx(np.array([[-30.0, 200.0, TOP_M - 8.0]]))
    assert places(found["T2.right"]) == pytest.approx(np.array([[30.0, 200.0, TOP_M - 8.0]]))
    backwards = open_question(lines=[{"name": "back", "towers": ["T3", "T2", "T1"]}], views={"distance_m": 30.0})
    assert places(views_of(backwards)[0]["T2.left"])[0, 0] == pytest.approx(30.0)


def test_a_viewpoint_looks_at_its_tower_stands_still_in_whole_seconds_and_takes_its_photos() -> None:
    found, _ = views_of(open_question(views={"hold_s": 2.3, "photos": 3, "below_top_m": [4.0, 9.0]}))
    visit = found["T2.right"]
    assert [v.action.name for v in visit.viewpoints] == ["T2.right-1", "T2.right-2"]
    assert [v.action.look_at_m for v in visit.viewpoints] == [(0.0, 200.0, TOP_M - 4.0), (0.0, 200.0, TOP_M - 9.0)]
    assert {(v.action.inspects, v.action.hold_s, v.action.photos) for v in visit.viewpoints} == {("T2", 3.0, 3)}
    assert visit.target == "T2"
    assert visit.note == ""


def test_four_sides_are_seen_before_and_behind_the_tower_on_each_side() -> None:
    views = {"kind": "four_sides", "distance_m": 40.0, "below_top_m": [5.0, 8.0]}
    found, _ = views_of(open_question(views=views))
    diagonal = 40.0 * math.sqrt(0.5)
    left = [[-diagonal, 200.0 - diagonal], [-diagonal, 200.0 + diagonal]]
    assert places(found["T2.left"])[:, :2] == pytest.approx(np.array([*left, *left[::-1]]))  # there and back
    assert places(found["T2.left"])[:, 2] == pytest.approx(np.array([130.0, 130.0, 127.0, 127.0]))
    names = [v.action.name for v in found["T2.right"].viewpoints]
    assert names == ["T2.right-before-1", "T2.right-behind-1", "T2.right-behind-2", "T2.right-before-2"]


def test_a_view_has_room_to_return_from_where_there_is_some() -> None:
    """One that just keeps its margins is a little further off than asked for; one with room is where it is asked."""
    scene = open_scene(open_question())
    asked = scene.mission.inspection
    assert asked is not None
    least_m = max(Margins.of(task.limits).obstacle_m for task in scene.tasks) + 0.3
    least_m += max(asked.tower_radius_m, asked.conductor_radius_m)

    def off_m(distance_m: float) -> float:
        found, _ = views_of(open_question(views={"distance_m": distance_m, "below_top_m": [8.0]}))
        return float(np.hypot(*places(found["T2.left"])[0, :2] - [0.0, 200.0]))

    assert least_m + 1.5 <= off_m(least_m) <= 1.35 * least_m
    assert off_m(least_m + 1.5) == pytest.approx(least_m + 1.5)


def test_a_tower_is_overflown_above_its_top() -> None:
    found, _ = views_of(open_question(views={"kind": "overfly", "distance_m": 30.0}))
    (viewpoint,) = found["T3.overfly"].viewpoints
    assert viewpoint.position_m == pytest.approx([0.0, 400.0, TOP_M + 30.0])
    assert viewpoint.action.look_at_m == (0.0, 400.0, TOP_M)


def test_at_an_angle_the_sides_halve_it() -> None:
    found, _ = views_of(open_question([(0, 0), (0, 200), (200, 200)], views={"distance_m": 40.0}))
    off = 40.0 * math.sqrt(0.5)
    assert places(found["T2.left"])[0, :2] == pytest.approx([-off, 200.0 + off])
    assert places(found["T2.right"])[0, :2] == pytest.approx([off, 200.0 - off])
    assert places(found["T3.left"])[0, :2] == pytest.approx([200.0, 240.0])


def test_where_a_line_goes_straight_back_it_has_sides_too() -> None:
    lines = [{"name": "there-and-back", "towers": ["T1", "T2", "T1"]}, {"name": "rest", "towers": ["T2", "T3"]}]
    found, _ = views_of(open_question(lines=lines, views={"distance_m": 30.0}))
    assert abs(places(found["T2.left"])[0, 0]) == pytest.approx(30.0)


def test_a_tower_of_several_lines_has_the_sides_of_the_first() -> None:
    cross = [(0, 0), (0, 200), (0, 400), (300, 200)]
    lines = [{"name": "first", "towers": ["T1", "T2", "T3"]}, {"name": "branch", "towers": ["T2", "T4"]}]
    found, left_out = views_of(open_question(cross, lines=lines, views={"distance_m": 30.0}))
    assert places(found["T2.left"])[0, :2] == pytest.approx([-30.0, 200.0])
    assert not left_out
    right = places(found["T2.right"])[0]  # the branch is in the way there
    assert right[0] > 10.0
    assert "moved by" in found["T2.right"].note


def test_a_tower_alone_has_sides_as_well() -> None:
    found, _ = views_of(open_question([(0, 0)], views={"distance_m": 30.0}))
    assert places(found["T1.left"])[0, :2] == pytest.approx([-30.0, 0.0])


def test_towers_may_have_views_of_their_own_or_none() -> None:
    data = open_question(views={"distance_m": 30.0})
    data["inspection"]["towers"][0]["views"] = "none"
    data["inspection"]["towers"][1]["views"] = {"kind": "overfly"}
    assert list(views_of(data)[0]) == ["T2.overfly", "T3.left", "T3.right"]


# --- moved, or left out


def test_a_view_in_the_way_of_a_mast_is_moved_and_says_so() -> None:
    data = open_question(obstacles=[MAST | {"center": at(-30.0, 200.0)}], views={"distance_m": 30.0})
    found, left_out = views_of(data)
    assert not left_out
    moved = places(found["T2.left"])[0]
    assert np.linalg.norm(moved - [-30.0, 200.0, 130.0]) > 10.0
    assert "moved by" in found["T2.left"].note
    assert found["T2.right"].note == ""


def test_a_tower_none_of_whose_left_views_is_clear_is_left_out_with_the_reason() -> None:
    corners = [at(-100, 100), at(-5, 100), at(-5, 300), at(-100, 300)]
    school = {"kind": "no_fly", "name": "school", "polygon": corners}
    found, left_out = views_of(open_question(obstacles=[school], views={"distance_m": 30.0}))
    assert set(found) == {"T1.left", "T1.right", "T3.left", "T3.right"}
    (why,) = left_out.values()
    assert why.startswith("T2.left: expected at least 15.0 m from school")
    assert "raise views.distance_m" in why


def test_who_flies_keeps_the_widest_margins_of_the_fleet() -> None:
    data = open_question(views={"distance_m": 25.0})
    data["vehicles"][1]["safety"] = {"obstacle_m": 22.0}
    found, _ = views_of(data)
    scene = open_scene(data)
    need_m = max(Margins.of(task.limits).obstacle_m for task in scene.tasks)
    assert need_m == 27.0
    assert scene.obstacles.distance_m(places(found["T2.left"])).min() >= need_m


def test_on_a_slope_the_uphill_view_is_raised_by_as_much_as_it_lacks() -> None:
    peak = {"x_m": 60.0, "y_m": 200.0, "height_m": 40.0, "spread_m": 60.0}
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100.0, "peaks": [peak], "cell_m": 5.0}
    data = open_question(terrain=terrain, views={"distance_m": 30.0})
    scene = open_scene(data)
    assert scene.towers is not None
    found = {visit.name: visit for visit in visits(scene)[0]}
    uphill = places(found["T2.right"])[0]
    assert uphill[2] > scene.towers.top_m[1, 2] - 5.0 + 1.0
    margins = Margins.of(scene.tasks[0].limits)
    height_m = uphill[2] - scene.terrain.height_amsl_m(uphill[0], uphill[1])
    assert margins.height_agl_min_m <= height_m <= margins.height_agl_min_m + 5.0  # of the tube: to its sides too


def test_below_the_ceiling_or_not_at_all() -> None:
    data = open_question(defaults={"height_agl_max_m": 40.0}, views={"distance_m": 30.0})
    assert not views_of(data)[1]
    data = open_question(defaults={"height_agl_max_m": 33.0}, views={"distance_m": 30.0})
    found, left_out = views_of(data)
    assert not found
    assert "T1.left: expected at most 33 m above the ground" in left_out["T1"]


def test_outside_the_fence_nothing_is_seen() -> None:
    polygon = [at(-300, -300), at(10, -300), at(10, 700), at(-300, 700)]
    found, left_out = views_of(open_question(fence={"polygon": polygon}, views={"distance_m": 30.0}))
    assert not found
    assert "T1.right: expected at least 15.0 m inside the fence" in left_out["T1"]


def test_who_looks_below_the_foot_of_a_tower_is_told() -> None:
    _, left_out = views_of(open_question(views={"distance_m": 30.0, "below_top_m": [5.0, 40.0]}))
    assert "expected views.below_top_m less than its height" in left_out["T1"]


def test_a_view_too_far_off_for_its_camera_is_left_out_and_the_remedy_is_one() -> None:
    lens = {"preset": "sony_rx0m2", "gsd_max_mm": 9.0}
    views = {"distance_m": 30.0, "below_top_m": [5.0]}
    found, left_out = views_of(open_question(views=views, camera=lens))
    assert not found
    model = camera.of(mission.Camera.model_validate(lens))
    assert model is not None
    assert f"got {model.gsd_mm(33.0):.2f} mm" in left_out["T1"]  # with the 3 m that a vehicle may stray
    nearer_m = float(left_out["T1"].split("lower views.distance_m to ")[1].split(" m")[0])
    found, left_out = views_of(open_question(views=views | {"distance_m": nearer_m}, camera=lens))
    assert not left_out
    assert len(found) == 6


# --- orbits


def test_an_orbit_crosses_its_line_above_it_and_no_more_often_than_it_must() -> None:
    found, left_out = views_of(open_question(views={"kind": "orbit", "distance_m": 30.0, "points": 12}))
    assert not left_out
    visit = found["T2.orbit"]
    way = places(visit)
    sides = np.sign(way[:, 0]) * (np.abs(way[:, 0]) > 1.0)
    level = [side for side, z in zip(sides.tolist(), way[:, 2].tolist(), strict=True) if z < TOP_M]
    assert 0.0 not in level  # beside the tower, unless above its conductors
    assert sum(a != b for a, b in itertools.pairwise(level)) == 1
    turns = np.unwrap([math.atan2(y - 200.0, x) for x, y, _ in way.tolist()])
    assert (np.diff(turns) > 0.0).all() or (np.diff(turns) < 0.0).all()


def test_an_orbit_at_two_heights_goes_round_and_back() -> None:
    views = {"kind": "orbit", "distance_m": 40.0, "points": 6, "below_top_m": [5.0, 8.0]}
    found, _ = views_of(open_question([(0, 0)], views=views))
    aims = [v.action.look_at_m for v in found["T1.orbit"].viewpoints]
    assert [aim[2] for aim in aims if aim] == [TOP_M - 5.0] * 6 + [TOP_M - 8.0] * 6
    turns = np.unwrap([math.atan2(y, x) for x, y, _ in places(found["T1.orbit"]).tolist()])
    steps = np.diff(turns)
    assert (steps[:5] > 0.0).all()
    assert steps[5] == pytest.approx(0.0)
    assert (steps[6:] < 0.0).all()


def test_points_of_an_orbit_that_nobody_can_fly_to_are_left_out_of_it_and_told() -> None:
    corners = [at(35, 180), at(90, 180), at(90, 220), at(35, 220)]
    school = {"kind": "no_fly", "name": "school", "polygon": corners}
    views = {"kind": "orbit", "distance_m": 30.0, "points": 8}
    found, left_out = views_of(open_question(obstacles=[school], views=views))
    assert "T2" not in left_out
    assert "points: nobody can fly to the others" in found["T2.orbit"].note
    seen = {sight.name for sight in sights(open_scene(open_question(obstacles=[school], views=views)))}
    flown = {v.action.name for visit in found.values() for v in visit.viewpoints}
    assert seen == flown  # no more is asked for than can be flown


# --- laws


def test_backwards_twice_is_as_before_and_photos_stay_on_their_way() -> None:
    found, _ = views_of(open_question(views={"kind": "four_sides", "distance_m": 40.0}))
    visit = found["T1.left"]
    assert places(visit.reversed()) == pytest.approx(places(visit)[::-1])
    assert [v.action for v in visit.reversed().reversed().viewpoints] == [v.action for v in visit.viewpoints]


bends = st.lists(st.tuples(st.floats(120.0, 300.0), st.floats(-70.0, 70.0)), min_size=1, max_size=5)
asked = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["overfly", "two_sides", "four_sides", "orbit"]),
        "distance_m": st.floats(12.0, 60.0),
        "below_top_m": st.lists(st.floats(0.0, 30.0), min_size=1, max_size=2),
        "points": st.integers(3, 12),
    }
)
masts = st.lists(st.tuples(st.floats(-100.0, 100.0), st.floats(-50.0, 500.0)), max_size=4)
peaks = st.tuples(st.floats(-300.0, 300.0), st.floats(0.0, 500.0), st.floats(0.0, 120.0), st.floats(80.0, 300.0))


def crooked(bends: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the towers of a line by the lengths of its spans and the turns between them."""
    course, towers = 0.0, [(0.0, 0.0)]
    for length_m, turn_deg in bends:
        course += math.radians(turn_deg)
        x, y = towers[-1]
        towers.append((x + length_m * math.sin(course), y + length_m * math.cos(course)))
    return towers


def lacking_m(scene: Scene, position_m: FloatArray) -> float:
    """Return what a place lacks of the margins of any vehicle, the ground looked at place by place in its tube."""
    most = 0.0
    turn = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
    for task in scene.tasks:
        margins, tube_m = Margins.of(task.limits), task.limits.tube_m
        ring = tube_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        x, y = (position_m[:2] + np.concatenate([[[0.0, 0.0]], 0.5 * ring, ring])).T
        below_m = np.sqrt(np.maximum(tube_m**2 - (x - position_m[0]) ** 2 - (y - position_m[1]) ** 2, 0.0))
        height_m = (position_m[2] - below_m - scene.terrain.height_amsl_m(x, y)).min()
        obstacle_m = scene.obstacles.distance_m(position_m).min()
        most = max(most, task.limits.terrain_margin_m - height_m, margins.obstacle_m - obstacle_m)
    return float(most)


@settings(max_examples=40)
@given(bends, asked, masts, peaks)
def test_every_view_is_clear_near_enough_and_sees_its_tower_or_is_left_out_with_a_reason(
    bends: list[tuple[float, float]],
    asked: dict[str, Any],
    masts: list[tuple[float, float]],
    peak: tuple[float, float, float, float],
) -> None:
    x, y, height_m, spread_m = peak
    hill = {"x_m": x, "y_m": y, "height_m": max(height_m, 0.1), "spread_m": spread_m}
    data = open_question(
        crooked(bends),
        terrain={"kind": "peaks", "base_alt_amsl_m": 100.0, "peaks": [hill], "cell_m": 10.0},
        obstacles=[MAST | {"name": f"mast-{k}", "center": at(*place)} for k, place in enumerate(masts)],
        views=asked,
    )
    scene = open_scene(data)
    found, left_out = visits(scene)
    towers = {tower["name"] for tower in data["inspection"]["towers"]}
    assert {visit.target for visit in found} | {left.target for left in left_out} == towers
    assert {visit.target for visit in found}.isdisjoint(left.target for left in left_out)
    assert all(": expected " in left.why and "\n" not in left.why for left in left_out)
    for visit in found:
        for viewpoint in visit.viewpoints:
            aim = np.array(viewpoint.action.look_at_m)
            offset = viewpoint.position_m - aim
            assert lacking_m(scene, viewpoint.position_m) <= 0.0
            assert np.linalg.norm(offset) <= FURTHEST * asked["distance_m"] + 1e-6
            if asked["kind"] != "overfly":
                steep_deg = math.degrees(math.atan2(offset[2], math.hypot(offset[0], offset[1])))
                assert steep_deg <= STEEPEST_DEG + 1e-6
            assert in_sight(scene.terrain, viewpoint.position_m[np.newaxis], aim[np.newaxis]).all()


def test_a_hill_between_hides() -> None:
    peak = {"x_m": 0.0, "y_m": 200.0, "height_m": 60.0, "spread_m": 50.0}
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100.0, "peaks": [peak], "cell_m": 5.0}
    ground = open_scene(open_question(terrain=terrain)).terrain

    def seen(z: float, east_m: float) -> bool:
        return bool(in_sight(ground, np.array([[-150.0, 200.0, z]]), np.array([[east_m, 200.0, z]])).all())

    assert [seen(z, 150.0) for z in (150.0, 159.0, 161.0)] == [False, False, True]
    assert not seen(500.0, 1e6)  # unknown ground hides too


# --- along spans

LENS = {"preset": "sony_a7rm4_35mm", "overlap_share": 0.5, "interval_min_s": 0.5}
ALONG = {"views": {"distance_m": 30.0}, "spans": {"lateral_m": 30.0, "vertical_m": 2.0}}


def test_a_span_is_flown_along_on_both_sides_parallel_to_the_line_from_top_to_top() -> None:
    data = open_question(**ALONG, camera=LENS)
    data["inspection"]["towers"][1]["height_m"] = 45.0
    found, left_out = views_of(data)
    assert not left_out
    assert places(found["span T1-T2.left"]) == pytest.approx(np.array([[-30.0, 0.0, 137.0], [-30.0, 200.0, 147.0]]))
    assert places(found["span T2-T3.right"]) == pytest.approx(np.array([[30.0, 200.0, 147.0], [30.0, 400.0, 137.0]]))
    assert found["span T1-T2.left"].target == "span T1-T2"
    # who stands still at both ends flies straight between them
    assert all(viewpoint.action.hold_s == 1.0 for viewpoint in found["span T1-T2.left"].viewpoints)


def test_photos_are_taken_on_the_way_along_a_span_so_that_the_nearest_conductors_overlap() -> None:
    found, _ = views_of(open_question(**ALONG, camera=LENS, conductor_radius_m=5.0))
    begin, end = found["span T1-T2.right"].viewpoints
    model = camera.of(mission.Camera.model_validate(LENS))
    assert model is not None
    assert begin.action.photo_every_m == 0.0
    assert end.action.photo_every_m == pytest.approx(model.spacing_m(25.0), abs=0.1)
    assert end.action.photo_every_m <= model.spacing_m(25.0)
    last, first = found["span T1-T2.right"].reversed().viewpoints
    assert last.position_m == pytest.approx(end.position_m)
    assert (last.action.photo_every_m, first.action.photo_every_m) == (0.0, end.action.photo_every_m)


def test_the_camera_looks_across_at_the_conductors_and_half_way_down_their_sag() -> None:
    found, _ = views_of(open_question(**ALONG))
    for name, heading_deg in (("span T1-T2.left", 90.0), ("span T1-T2.right", 270.0)):
        looks = {viewpoint.action.look_deg for viewpoint in found[name].viewpoints}
        ((heading, pitch),) = looks
        assert heading == pytest.approx(heading_deg, abs=0.05)
        sag_m = 200.0**2 / (8.0 * 2000.0)
        low, high = (-math.degrees(math.atan2(2.0 + sag, 30.0)) for sag in (sag_m, 0.0))
        assert pitch == pytest.approx(0.5 * (low + high), abs=0.1)


def test_without_a_camera_spans_are_flown_along_without_photos_and_that_is_told() -> None:
    found, _ = views_of(open_question(**ALONG))
    visit = found["span T1-T2.left"]
    assert all(viewpoint.action.photo_every_m == 0.0 for viewpoint in visit.viewpoints)
    assert visit.note == "no photos: inspection.camera is not given"


def test_who_flies_too_fast_for_the_photos_along_a_span_is_told_how_fast_it_may() -> None:
    slow = LENS | {"interval_min_s": 3.0}
    with pytest.raises(MissionError, match=r"alpha.speed_m_s.max: expected at most .* along span T1-T2") as refused:
        views_of(open_question(**ALONG, camera=slow))
    most_m_s = float(str(refused.value).split("at most ")[1].split(" m/s")[0])
    speeds = {"speed_m_s": {"min": 1.0, "max": most_m_s}}
    assert not views_of(open_question(**ALONG, camera=slow, defaults=speeds))[1]


def test_lines_may_ask_for_spans_of_their_own() -> None:
    lines = [
        {"name": "one", "towers": ["T1", "T2"], "spans": {"sides": "right", "lateral_m": 40.0}},
        {"name": "two", "towers": ["T2", "T3"], "spans": "none"},
    ]
    found, _ = views_of(open_question(**ALONG, lines=lines))
    assert [name for name in found if name.startswith("span")] == ["span T1-T2.right"]
    assert places(found["span T1-T2.right"])[:, 0] == pytest.approx(40.0)


def test_at_the_inner_side_of_an_angle_ways_along_spans_are_shorter() -> None:
    bent = [(0.0, 0.0), (0.0, 300.0), (240.0, 480.0)]
    scene = open_scene(open_question(bent, **ALONG))
    found = {visit.name: visit for visit in visits(scene)[0]}
    assert "shorter than the span" in found["span T1-T2.right"].note
    assert "shorter" not in found["span T1-T2.left"].note
    need_m = max(Margins.of(task.limits).obstacle_m for task in scene.tasks)
    share = np.linspace(0.0, 1.0, 200)[:, np.newaxis]
    for visit in found.values():
        begin, end = places(visit)[[0, -1]]
        assert scene.obstacles.distance_m(begin + share * (end - begin)).min() >= need_m


def test_a_way_along_a_span_is_raised_over_a_ridge() -> None:
    ridge = {"x_m": -30.0, "y_m": 100.0, "height_m": 25.0, "spread_m": 60.0}
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100.0, "peaks": [ridge], "cell_m": 5.0}
    scene = open_scene(open_question(**ALONG, terrain=terrain))
    found, left_out = visits(scene)
    assert not left_out
    visit = next(visit for visit in found if visit.name == "span T1-T2.left")
    assert "moved by" in visit.note
    begin, end = places(visit)
    for share in np.linspace(0.0, 1.0, 41).tolist():
        assert lacking_m(scene, begin + share * (end - begin)) <= 0.0


def test_a_span_that_no_side_way_is_clear_along_is_left_out() -> None:
    corners = [at(-100, 50), at(-5, 50), at(-5, 150), at(-100, 150)]
    school = {"kind": "no_fly", "name": "school", "polygon": corners}
    found, left_out = views_of(open_question(**ALONG, obstacles=[school]))
    assert left_out["span T1-T2"].startswith("span T1-T2.left: expected at least 15.0 m from school")
    assert "raise spans.lateral_m" in left_out["span T1-T2"]
    assert "span T2-T3.left" in found
    assert not any(visit.target == "span T1-T2" for visit in found.values())


@pytest.mark.parametrize(
    ("apart_m", "changes", "why"),
    [
        (700.0, {"camera": LENS | {"preset": "dji_mavic3e_tele"}}, "to fit into a photo"),  # they sag by 31 m
        (200.0, {"camera": LENS | {"gsd_max_mm": 3.0}}, "expected a ground sampling distance of at most 3 mm"),
        (200.0, {"spans": {"lateral_m": 12.0, "vertical_m": 40.0}}, "expected to look at most 55 degrees down or up"),
    ],
)
def test_conductors_that_a_way_does_not_show_are_left_out(apart_m: float, changes: dict[str, Any], why: str) -> None:
    far_apart = [(0.0, 0.0), (0.0, apart_m)]
    speeds = {"speed_m_s": {"min": 0.1, "max": 0.2}}
    _, left_out = views_of(open_question(far_apart, **ALONG | changes, defaults=speeds))
    assert why in left_out["span T1-T2"]
