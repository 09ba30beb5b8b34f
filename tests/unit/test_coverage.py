"""What flights have seen: by hand where it can be told by hand; the laws of all tracks."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.coverage import Coverage, SideSeen, SpanSeen, measure
from missionplanner.geodesy import FloatArray
from missionplanner.plan import Trajectory
from missionplanner.proof import inspected_share
from missionplanner.scene import Scene
from missionplanner.views import Visit, visits
from tests.lines import STRAIGHT, open_question, open_scene
from tests.scenes import at, copter, question, scene_of

TWO_SIDES = {"views": {"distance_m": 30.0, "hold_s": 3.0}}
LENS = {"preset": "sony_a7rm4_35mm", "overlap_share": 0.3, "interval_min_s": 0.5}
ALONG = {"views": {"distance_m": 30.0}, "spans": {"lateral_m": 30.0}}


def flown(found: Sequence[Visit], speed_m_s: float = 6.0, step_s: float = 0.5) -> Trajectory:
    """Return a flight straight from viewpoint to viewpoint that stands still where it shall, recorded evenly."""
    t_s, places = [0.0], [found[0].viewpoints[0].position_m]
    for viewpoint in (viewpoint for visit in found for viewpoint in visit.viewpoints):
        way_m = float(np.linalg.norm(viewpoint.position_m - places[-1]))
        t_s += [t_s[-1] + max(way_m, 0.1) / speed_m_s]
        places += [viewpoint.position_m]
        if viewpoint.action.stand_s > 0.0:
            t_s += [t_s[-1] + viewpoint.action.stand_s]
            places += [viewpoint.position_m]
    corners = Trajectory(np.array(t_s), np.array(places))
    times = np.arange(0.0, t_s[-1] + step_s, step_s)
    return Trajectory(times, corners.at(times))


def all_flown(scene: Scene, **how: float) -> Trajectory:
    return flown(visits(scene)[0], **how)


def sides(found: Coverage) -> dict[str, SideSeen]:
    return {row.name: row for row in found.towers}


def spans(found: Coverage) -> dict[str, SpanSeen]:
    return {row.name: row for row in found.spans}


def still(position_m: FloatArray, lasts_s: float, step_s: float = 0.5) -> Trajectory:
    times = np.arange(0.0, lasts_s + step_s, step_s)
    return Trajectory(times, np.tile(np.asarray(position_m, dtype=float), (len(times), 1)))


def cut(track: Trajectory, keep: FloatArray) -> list[Trajectory]:
    """Return what is left of a track, a track of its own for each piece."""
    pieces = np.split(np.arange(len(track.t_s)), np.flatnonzero(np.diff(keep.astype(int))) + 1)
    return [Trajectory(track.t_s[k], track.position_m[k]) for k in pieces if keep[k[0]]]


# --- by hand


def test_a_side_is_seen_from_where_it_is_asked_to_be() -> None:
    scene = open_scene(open_question(**TWO_SIDES, camera=LENS))
    found = measure(scene, [still([-30.0, 200.0, 130.0], 4.0)], names=["alpha"])
    row = sides(found)["T2.left"]
    assert row.seen
    assert row.distance_m == pytest.approx(30.0)
    assert row.angle_deg == pytest.approx(0.0, abs=1e-6)
    assert row.elevation_deg == pytest.approx(0.0, abs=1e-6)
    assert row.vehicle == "alpha"
    assert row.gsd_mm == pytest.approx(1000.0 * 30.0 * 35.7 / 9504.0 / 35.0, rel=1e-3)
    assert row.photos is None  # nobody tells
    assert [name for name, side in sides(found).items() if side.seen] == ["T2.left"]
    assert found.done == frozenset()
    assert found.share == 0.0
    assert sides(found)["T1.left"].why.startswith("expected a vehicle within 65 m, got ")


@pytest.mark.parametrize(
    ("turned_deg", "away_m", "up_m", "seen"),
    [
        (0.0, 30.0, 0.0, True),
        (40.0, 30.0, 0.0, True),
        (50.0, 30.0, 0.0, False),  # more than 45 degrees off its side
        (0.0, 64.0, 0.0, True),
        (0.0, 66.0, 0.0, False),  # more than twice as far off, and the tube's 5 m
        (0.0, 30.0, 40.0, True),
        (0.0, 30.0, 50.0, False),  # steeper than 55 degrees
        (180.0, 30.0, 0.0, False),
    ],
)
def test_range_and_angles_decide(turned_deg: float, away_m: float, up_m: float, seen: bool) -> None:
    scene = open_scene(open_question([(0.0, 0.0), (0.0, 400.0)], **TWO_SIDES))
    turn = math.radians(180.0 + turned_deg)
    place = [away_m * math.cos(turn), away_m * math.sin(turn), 130.0 + up_m]
    found = sides(measure(scene, [still(np.array(place), 4.0)]))["T1.left"]
    assert found.seen is seen
    assert seen or found.why


def test_who_flies_through_has_not_looked_where_a_hold_is_asked_for() -> None:
    scene = open_scene(open_question(**TWO_SIDES))
    way = np.array([[-30.0, -100.0, 130.0], [-30.0, 500.0, 130.0]])
    times = np.arange(0.0, 120.0, 0.5)
    passing = Trajectory(times, Trajectory(np.array([0.0, 120.0]), way).at(times))
    row = sides(measure(scene, [passing]))["T2.left"]
    assert not row.seen
    assert row.why == "nobody stood still there for 3 s"
    through = open_scene(open_question(views={"distance_m": 30.0, "hold_s": 0.0}))
    assert sides(measure(through, [passing]))["T2.left"].seen


@pytest.mark.parametrize(("stood_s", "seen"), [(1.0, False), (2.5, True), (4.0, True)])
def test_a_hold_may_be_shorter_by_a_second(stood_s: float, seen: bool) -> None:
    scene = open_scene(open_question(**TWO_SIDES))
    assert sides(measure(scene, [still([-30.0, 200.0, 130.0], stood_s)]))["T2.left"].seen is seen


def test_what_the_log_does_not_show_was_not_seen() -> None:
    scene = open_scene(open_question(views={"distance_m": 30.0, "hold_s": 0.0}))
    way = np.array([[-30.0, -100.0, 130.0], [-30.0, 500.0, 130.0]])
    for gap_s, seen in ((1.9, True), (40.0, False)):
        times = np.array(
            [t for t in np.arange(0.0, 120.0, 0.5).tolist() if not 60.0 - gap_s / 2 < t < 60.0 + gap_s / 2]
        )
        track = Trajectory(times, Trajectory(np.array([0.0, 120.0]), way).at(times))
        row = sides(measure(scene, [track]))["T2.left"]
        assert row.seen is seen


def test_a_hill_between_hides_a_side() -> None:
    hill = {"x_m": -28.0, "y_m": 0.0, "height_m": 40.0, "spread_m": 12.0}
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100.0, "peaks": [hill], "cell_m": 2.0}
    lines = [(0.0, 0.0), (0.0, 400.0)]
    track = still(np.array([-55.0, 0.0, 130.0]), 5.0)
    assert sides(measure(open_scene(open_question(lines, **TWO_SIDES)), [track]))["T1.left"].seen
    row = sides(measure(open_scene(open_question(lines, **TWO_SIDES, terrain=terrain)), [track]))["T1.left"]
    assert not row.seen
    assert "in sight" in row.why


def test_a_camera_sees_only_as_far_as_its_pixels_are_fine_enough() -> None:
    track = still(np.array([-50.0, 200.0, 130.0]), 5.0)
    for gsd_max_mm, seen in ((5.5, True), (5.0, False)):  # 5.37 mm from 50 m
        scene = open_scene(open_question(**TWO_SIDES, camera=LENS | {"gsd_max_mm": gsd_max_mm}))
        assert sides(measure(scene, [track]))["T2.left"].seen is seen


def test_who_is_told_to_take_photos_and_tells_of_them_has_seen_what_it_has_photographed() -> None:
    scene = open_scene(open_question([(0.0, 0.0), (0.0, 400.0)], **TWO_SIDES))
    track = all_flown(scene)
    left_m = visits(scene)[0][0].viewpoints[0].position_m
    taken = Trajectory(np.array([3.0, 4.0]), np.array([left_m, left_m]))
    unknown, known = measure(scene, [track]), measure(scene, [track], photos=[taken])
    assert unknown.share == 1.0
    assert {name for name, row in sides(known).items() if row.seen} == {"T1.left"}
    assert sides(known)["T1.left"].photos == 2
    assert sides(known)["T1.right"].photos == 0
    assert sides(known)["T1.right"].why == "no photo was taken from there"
    looked = open_question([(0.0, 0.0), (0.0, 400.0)], views=TWO_SIDES["views"] | {"photos": 0})
    assert measure(open_scene(looked), [track], photos=[taken]).share == 1.0


def test_a_tower_counts_with_its_weight_when_all_its_sides_were_seen() -> None:
    data = open_question(**TWO_SIDES)
    for tower, weight in zip(data["inspection"]["towers"], (1.0, 2.0, 5.0), strict=True):
        tower["weight"] = weight
    scene = open_scene(data)
    by_name = {visit.name: visit for visit in visits(scene)[0]}
    found = measure(scene, [flown([by_name[name] for name in ("T1.left", "T2.left", "T2.right")])])
    assert found.done == {"T2"}
    assert found.share == pytest.approx(2.0 / 8.0)
    assert len(found.missing) == 3


def test_towers_without_any_weight_count_alike() -> None:
    data = open_question(**TWO_SIDES)
    for tower in data["inspection"]["towers"]:
        tower["weight"] = 0.0
    scene = open_scene(data)
    assert measure(scene, []).share == 0.0
    assert measure(scene, [flown([v for v in visits(scene)[0] if v.target == "T2"])]).share == pytest.approx(1.0 / 3.0)
    assert inspected_share(scene, [np.array([[0.0, 200.0, 140.0], [0.0, 210.0, 140.0]])]) == pytest.approx(1.0 / 3.0)


def test_nothing_flown_is_nothing_seen() -> None:
    nowhere = Trajectory(np.zeros(0), np.zeros((0, 3)))
    assert measure(open_scene(open_question(**ALONG)), [nowhere], photos=[nowhere]).share == 0.0
    found = measure(open_scene(open_question(**ALONG)), [])
    assert found.share == 0.0
    assert found.spans_share == 0.0
    assert not found.done
    assert {row.why for row in found.towers} == {"no flight was recorded"}


# --- spans


def test_half_a_span_flown_along_is_half_of_it_seen() -> None:
    scene = open_scene(open_question(**ALONG))
    times = np.arange(0.0, 40.0, 0.5)
    corners = np.array([[-30.0, 0.0, 135.0], [-30.0, 70.0, 135.0]])
    row = spans(measure(scene, [Trajectory(times, Trajectory(np.array([0.0, 40.0]), corners).at(times))]))
    left = row["span T1-T2.left"]
    assert left.share == pytest.approx(0.5, abs=0.03)  # and 30 m ahead, at 45 degrees
    assert left.length_m == pytest.approx(200.0, abs=1.0)
    assert left.distance_min_m == pytest.approx(30.0, abs=0.2)
    assert left.distance_max_m == pytest.approx(math.hypot(30.0, 30.0), abs=3.5)
    assert row["span T1-T2.right"].share == 0.0


def test_conductors_between_photos_too_far_apart_were_not_seen() -> None:
    scene = open_scene(open_question(**ALONG, camera=LENS))
    found = [visit for visit in visits(scene)[0] if visit.name == "span T1-T2.left"]
    track = flown(found)
    every_m = found[0].viewpoints[1].action.photo_every_m
    begin, end = found[0].viewpoints[0].position_m, found[0].viewpoints[1].position_m

    def seen(apart_m: float) -> SpanSeen:
        share = np.arange(0.0, 1.0, apart_m / float(np.linalg.norm(end - begin)))
        places = begin + share[:, np.newaxis] * (end - begin)
        photos = Trajectory(share, places)
        return spans(measure(scene, [track], photos=[photos]))["span T1-T2.left"]

    assert seen(every_m).seen
    assert seen(every_m).photos == pytest.approx(200.0 / every_m, abs=2)
    assert seen(4.0 * every_m).share < 0.8
    no_photos = Trajectory(np.zeros(0), np.zeros((0, 3)))
    assert spans(measure(scene, [track], photos=[no_photos]))["span T1-T2.left"].share == 0.0
    assert spans(measure(scene, [track]))["span T1-T2.left"].seen  # no log tells of photos


# --- which way the camera looked


PARALLEL = ((0.0, 0.0), (0.0, 200.0), (60.0, 0.0), (60.0, 200.0), (120.0, 0.0), (120.0, 200.0))
"""Three lines, 60 m apart: right of one is left of the next."""


def parallel(**changes: Any) -> Scene:
    lines = [{"name": name, "towers": [f"T{k}", f"T{k + 1}"]} for name, k in (("A", 1), ("B", 3), ("C", 5))]
    asked = {"views": TWO_SIDES["views"], "spans": {"lateral_m": 30.0}, "camera": LENS}
    return open_scene(open_question(PARALLEL, **({"lines": lines} | asked | changes)))


def photographed(found: Sequence[Visit]) -> Trajectory:
    """Return a photo at every tower's view, and as many along spans as are asked for."""
    taken = []
    for visit in found:
        points = [viewpoint.position_m for viewpoint in visit.viewpoints]
        if visit.target.startswith("span"):
            every_m = visit.viewpoints[1].action.photo_every_m
            points = list(np.linspace(*points, 2 + int(np.linalg.norm(points[1] - points[0]) / every_m)))
        taken += points
    return Trajectory(np.arange(len(taken), dtype=float), np.array(taken))


OF = {"A": {"T1", "T2", "span T1-T2"}, "B": {"T3", "T4", "span T3-T4"}, "C": {"T5", "T6", "span T5-T6"}}


@pytest.mark.parametrize("told", [False, True])
def test_a_line_that_nobody_visited_is_not_seen_from_its_neighbours(told: bool) -> None:
    scene = parallel()
    found = [visit for visit in visits(scene)[0] if visit.target not in OF["B"]]
    taken = [photographed(found)] if told else [None]
    unknown = measure(scene, [flown(found)], photos=taken)
    assert not unknown.done & OF["B"]
    assert sides(unknown)["T1.left"].seen  # nothing else is looked at from there
    assert not sides(unknown)["T3.left"].seen
    planned = measure(scene, [flown(found)], photos=taken, targets=[OF["A"] | OF["C"]])
    assert planned.done == OF["A"] | OF["C"]
    assert "looked at something else" in sides(planned)["T3.left"].why
    assert not any(row.share for row in planned.spans if row.target == "span T3-T4")


@pytest.mark.parametrize("told", [False, True])
def test_who_is_to_look_both_ways_from_a_place_and_was_there_twice_has_done_so(told: bool) -> None:
    scene = parallel()
    found = visits(scene)[0]
    of_a, both = [visit for visit in found if visit.target in OF["A"]], OF["A"] | OF["B"]
    for flew, done in (([v for v in found if v.target in both], both), (of_a, frozenset())):
        taken = [photographed(flew)] if told else [None]
        assert measure(scene, [flown(flew)], photos=taken, targets=[both]).done == done
    by_two = [[v for v in found if v.target in OF[line]] for line in "ABC"]
    seen = measure(scene, [flown(own) for own in by_two], targets=[OF[line] for line in "ABC"])
    assert seen.done == OF["A"] | OF["B"] | OF["C"]
    # one after the other, without moving
    right, left = (next(v for v in found if v.name == name) for name in ("T1.right", "T3.left"))
    stood = {name for name, row in sides(measure(scene, [flown([right, left])], targets=[both])).items() if row.seen}
    assert stood == {"T1.right", "T3.left"}


def test_of_levels_on_one_tower_each_is_seen_from_its_own() -> None:
    scene = open_scene(open_question(views={"distance_m": 30.0, "hold_s": 3.0, "below_top_m": [2.0, 20.0]}))
    found = next(visit.viewpoints for visit in visits(scene)[0] if visit.name == "T2.left")
    seen = sides(measure(scene, [still(found[0].position_m, 5.0)]))
    assert (seen["T2.left-1"].seen, seen["T2.left-2"].seen) == (True, False)


# --- photos


def test_where_one_log_tells_of_photos_the_others_have_none() -> None:
    scene = open_scene(open_question(**TWO_SIDES, camera=LENS))
    found = visits(scene)[0]
    of_one, others = ([v for v in found if (v.target == "T1") is first] for first in (True, False))
    tracks = [flown(of_one), flown(others)]
    seen = measure(scene, tracks, photos=[photographed(of_one), None])
    assert seen.done == {"T1"}
    assert {row.why for row in seen.towers if not row.seen} == {"no photo was taken from there"}
    assert not seen.notes


def test_a_dead_camera_has_seen_nothing() -> None:
    scene = open_scene(open_question(**ALONG, camera=LENS))
    none = Trajectory(np.zeros(0), np.zeros((0, 3)))
    seen = measure(scene, [all_flown(scene)], photos=[none])
    assert not seen.done
    assert seen.spans_share == 0.0


def test_it_says_that_positions_alone_decided() -> None:
    scene = open_scene(open_question(**ALONG, camera=LENS))
    assert measure(scene, [all_flown(scene)]).notes == ("judged by position only: no log tells of photos",)
    assert "notes" in measure(scene, [all_flown(scene)]).as_json()
    assert measure(scene, []).notes == ()
    looked = open_scene(open_question(views=TWO_SIDES["views"] | {"photos": 0}))
    assert measure(looked, [all_flown(looked)]).notes == ()


# --- what stands between


SILO = {"kind": "cylinder", "name": "silo", "center": at(-18.0, 200.0), "radius_m": 5.0}


@pytest.mark.parametrize(("top_m", "seen"), [(60.0, False), (20.0, True)])
def test_an_obstacle_between_hides_a_side(top_m: float, seen: bool) -> None:
    scene = open_scene(open_question(views={"distance_m": 40.0}, obstacles=[SILO | {"top_height_agl_m": top_m}]))
    row = sides(measure(scene, [still([-40.0, 200.0, 130.0], 4.0)]))["T2.left"]
    assert row.seen is seen
    hall = {"kind": "no_fly", "name": "hall", "polygon": [at(-20, 60), at(-10, 60), at(-10, 140), at(-20, 140)]}
    for top, hides in (({"top_height_agl_m": 60.0}, True), ({}, False)):  # without a top it is airspace
        low = open_scene(open_question(spans={"lateral_m": 45.0}, obstacles=[hall | top]))
        way = Trajectory(np.linspace(0, 60, 241), np.linspace([-45.0, 0.0, 135.0], [-45.0, 200.0, 135.0], 241))
        share = spans(measure(low, [way]))["span T1-T2.left"].share
        assert (share < 0.9) is hides


# --- missions without views


def test_without_views_towers_count_that_are_passed_as_the_proof_counts_them() -> None:
    towers = [{"name": f"T{k}", **at(0.0, 200.0 * k), "height_m": 35.0, "weight": 1.0 + k} for k in range(4)]
    data = question(copter("alpha", (-100.0, 0.0), (-100.0, 700.0)), inspection={"towers": towers, "share_min": 0.0})
    scene = scene_of(data)
    rng = np.random.default_rng(3)
    for _ in range(20):
        corners = rng.uniform([-90.0, -50.0, 140.0], [90.0, 700.0, 180.0], (3, 3))
        times = np.linspace(0.0, 100.0, 401)
        track = Trajectory(times, Trajectory(np.array([0.0, 50.0, 100.0]), corners).at(times))
        found = measure(scene, [track])
        assert found.share == pytest.approx(inspected_share(scene, [track.position_m]))
        assert found.done == {row.name for row in found.towers if row.distance_m is not None and row.distance_m <= 60.0}


# --- laws

kinds = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["overfly", "two_sides", "four_sides", "orbit"]),
        "distance_m": st.floats(25.0, 50.0),
        "below_top_m": st.lists(st.floats(0.0, 9.0), min_size=1, max_size=2),
        "points": st.integers(3, 10),
        "hold_s": st.floats(0.0, 5.0),
        "photos": st.integers(0, 2),
    }
)
corners = st.lists(st.tuples(st.floats(-60.0, 60.0), st.floats(150.0, 300.0)), min_size=1, max_size=3)


def line_of(steps: list[tuple[float, float]]) -> list[tuple[float, float]]:
    x, y = np.cumsum([(0.0, 0.0), *steps], axis=0).T.tolist()
    return list(zip(x, y, strict=True))


@settings(max_examples=25)
@given(corners, kinds, st.sampled_from([None, "both", "left"]), st.floats(0.1, 0.5))
def test_who_flies_all_visits_has_seen_all_that_is_not_left_out(
    steps: list[tuple[float, float]], views: dict[str, Any], along: str | None, step_s: float
) -> None:
    asked = {"views": views} | ({} if along is None else {"spans": {"sides": along, "lateral_m": 30.0}})
    scene = open_scene(open_question(line_of(steps), **asked))
    found, left_out = visits(scene)
    seen = measure(scene, [flown(found, step_s=step_s)]) if found else measure(scene, [])
    lost = {left.target for left in left_out}
    assert {row.target for row in [*seen.towers, *seen.spans]} == {visit.target for visit in found} | lost
    assert {visit.target for visit in found} <= seen.done, seen.missing
    assert bool(seen.missing) == (seen.done != {row.target for row in [*seen.towers, *seen.spans]})
    json.dumps(seen.as_json(), allow_nan=False)


@pytest.mark.parametrize("lost", ["T1.left", "T2.right", "T3.left", "span T1-T2.left", "span T2-T3.right"])
def test_a_visit_that_is_missing_from_the_log_is_exactly_what_is_not_seen(lost: str) -> None:
    scene = open_scene(open_question(STRAIGHT, **ALONG))
    found = visits(scene)[0]
    tracks = [flown([visit]) for visit in found if visit.name != lost]
    seen = measure(scene, tracks)
    assert {row.name for row in seen.towers if not row.seen} == ({lost} if "span" not in lost else set())
    assert {row.name for row in seen.spans if not row.seen} == ({lost} if "span" in lost else set())


def test_a_flight_far_away_sees_nothing() -> None:
    scene = open_scene(open_question(**ALONG))
    track = all_flown(scene)
    seen = measure(scene, [Trajectory(track.t_s, track.position_m + np.array([400.0, 0.0, 0.0]))])
    assert not any(row.seen for row in [*seen.towers, *seen.spans])
    assert seen.spans_share == 0.0


def anywhere(seed: int) -> Trajectory:
    """Return a flight to and fro among the towers, standing still now and then."""
    rng = np.random.default_rng(seed)
    places = np.repeat(rng.uniform([-60.0, -30.0, 115.0], [60.0, 430.0, 170.0], (8, 3)), 2, axis=0)
    times = np.cumsum(np.tile([20.0, 5.0], 8))
    dense = np.arange(times[0], times[-1], 0.5)
    return Trajectory(dense, Trajectory(times, places).at(dense))


@settings(max_examples=20)
@given(st.integers(0, 1000), st.integers(0, 1000), st.sampled_from(["two_sides", "four_sides", "orbit", "overfly"]))
def test_more_flights_never_see_less(one: int, other: int, kind: str) -> None:
    scene = open_scene(open_question(views={"kind": kind, "distance_m": 30.0}, spans={"lateral_m": 30.0}))
    first, second = anywhere(one), anywhere(other)
    alone, together = measure(scene, [first]), measure(scene, [first, second])
    for before, after in zip(alone.towers, together.towers, strict=True):
        assert after.seen or not before.seen
    for span_before, span_after in zip(alone.spans, together.spans, strict=True):
        assert span_after.share >= span_before.share - 1e-12
    assert alone.done <= together.done
    assert together.share >= alone.share


@settings(max_examples=20)
@given(st.integers(0, 1000), st.floats(0.05, 0.95), st.floats(5.0, 60.0))
def test_less_of_a_flight_never_sees_more(seed: int, begin: float, lasts_s: float) -> None:
    scene = open_scene(open_question(views={"distance_m": 30.0, "hold_s": 2.0}, spans={"lateral_m": 30.0}))
    track = anywhere(seed)
    from_s = track.t_s[0] + begin * (track.t_s[-1] - track.t_s[0])
    rest = cut(track, (track.t_s < from_s) | (track.t_s > from_s + lasts_s))
    whole, part = measure(scene, [track]), measure(scene, rest)
    assert part.done <= whole.done
    for before, after in zip(whole.spans, part.spans, strict=True):
        assert after.share <= before.share + 0.05  # cut ends are sampled anew


def test_who_flew_and_when_is_told_of_the_best_sighting() -> None:
    scene = open_scene(open_question(**TWO_SIDES))
    worse = still(np.array([-30.0, 215.0, 130.0]), 5.0)
    better = still(np.array([-31.0, 200.0, 130.0]), 5.0)
    row = sides(measure(scene, [worse, better], names=["alpha", "bravo"]))["T2.left"]
    assert row.vehicle == "bravo"
    assert row.distance_m == pytest.approx(31.0)
