from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest

from missionplanner import path_search
from missionplanner.clearance import Margins, legs_clear, legs_within_angles, polyline_legs, tubes_clear
from missionplanner.cost import Price
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.path_search import Budget, PlannedPath, find_path, find_way, pieces_of
from missionplanner.scene import Scene
from missionplanner.seeds import first_guesses
from tests.scenes import at, copter, question, scene_of

MAST = {"kind": "cylinder", "name": "mast", "center": at(150, 4), "radius_m": 10}
ALPHA = copter("alpha", (0, 0), (300, 0), start=at(0, 0, agl=40))


def scene(*vehicles: dict[str, Any], **changes: Any) -> Scene:
    return scene_of(question(*(vehicles or (ALPHA,)), **({"planner": {"population": 20, "iterations": 30}} | changes)))


def price(scene: Scene, extra_m: float) -> Price:
    task = scene.tasks[0]
    return Price(
        space=scene.space,
        limits=task.limits,
        route_length_m=float(np.linalg.norm(np.diff(task.route_m, axis=0), axis=1).sum()),
        weights=scene.mission.planner.weights,
        towers=None,
        fellows=None,
        separation_m=20.0,
        clearance_extra_m=extra_m,
    )


def found(
    scene: Scene,
    seed: int = 1,
    flown_is_clear: Callable[[FloatArray], bool] = lambda waypoints_m: True,
    on_iteration: Callable[[float], None] | None = None,
    wider_m: float = 0.0,
    budget: Budget | None = None,
) -> PlannedPath:
    return find_path(
        scene.tasks[0],
        scene.space,
        scene.terrain.bounds,
        scene.obstacles.names,
        lambda extra_m: price(scene, extra_m),
        scene.mission.planner,
        np.random.default_rng(seed),
        flown_is_clear,
        on_iteration,
        wider_m,
        budget,
    )


def assert_flyable(scene: Scene, path: PlannedPath, wider_m: float = 0.0) -> None:
    task = scene.tasks[0]
    legs = polyline_legs(path.waypoints_m)
    assert tubes_clear(scene.space, scene.terrain.bounds, task.limits, legs, wider_m).all()
    for line in (path.path_m, path.waypoints_m):
        assert legs_clear(scene.space, Margins.of(task.limits), polyline_legs(line), 0.1).all()
        np.testing.assert_allclose(line[[0, -1]], task.route_m[[0, -1]], atol=1e-3)
    assert legs_within_angles(task.limits, polyline_legs(path.waypoints_m), 1e-5).all()
    along = legs[:, 1] - legs[:, 0]
    for point in path.path_m:
        t = np.clip(np.sum((point - legs[:, 0]) * along, axis=1) / np.sum(along**2, axis=1), 0, 1)
        nearest_m = np.linalg.norm(legs[:, 0] + t[:, None] * along - point, axis=1).min()
        assert nearest_m <= scene.mission.planner.waypoint_tolerance_m + 1e-6


def test_where_nothing_is_in_the_way_it_is_one_straight_leg() -> None:
    path = found(scene())
    np.testing.assert_allclose(path.waypoints_m, [[0, 0, 140], [300, 0, 140]], atol=1e-3)
    assert path.length_m == pytest.approx(300.0, abs=0.01)


def test_a_mast_is_gone_around_by_little() -> None:
    around = scene(obstacles=[MAST])
    path = found(around)
    assert_flyable(around, path)
    assert 300.5 < path.length_m < 312.0
    assert len(path.waypoints_m) <= 6


@pytest.mark.parametrize("seed", range(5))
def test_whatever_the_seed_the_path_is_flyable(seed: int) -> None:
    masts = [MAST | {"name": f"m{k}", "center": at(60 + 60 * k, 15 * (-1) ** k)} for k in range(4)]
    cable = {"kind": "cable", "name": "wire", "start": at(240, -200, amsl=145), "end": at(240, 200, amsl=145)}
    cluttered = scene(obstacles=[*masts, cable])
    assert_flyable(cluttered, found(cluttered, seed))


def test_a_ridge_is_flown_over_where_it_is_low() -> None:
    peaks = [{**at(150, y), "height_m": 150, "spread_m": 60} for y in (-150, -50, 160, 260)]
    area = {"south_west": at(-100, -200), "north_east": at(400, 310)}
    pass_between = scene(terrain={"kind": "peaks", "base_alt_amsl_m": 100, "peaks": peaks}, area=area)
    path = found(pass_between)
    assert_flyable(pass_between, path)
    assert path.path_m[:, 1].max() > 20.0  # through the gap at y = 55 m rather than over the peaks


def test_stops_are_waypoints_in_their_order() -> None:
    stops = [at(100, 80, agl=50), at(200, -80, agl=40), at(250, 40, agl=60)]
    winding = scene({**ALPHA, "stops": stops}, obstacles=[MAST])
    path = found(winding)
    assert_flyable(winding, path)
    route_m = winding.tasks[0].route_m
    at_stop = [int(np.argmin(np.linalg.norm(path.waypoints_m - stop, axis=1))) for stop in route_m]
    np.testing.assert_allclose(path.waypoints_m[at_stop], route_m, atol=1e-3)
    assert at_stop == sorted(at_stop)


def test_a_climb_too_steep_for_the_straight_way_winds_up() -> None:
    steep = scene(copter("alpha", (0, 0), (100, 0), goal=at(100, 0, agl=160), climb={"angle_max_deg": 30}))
    path = found(steep)
    assert_flyable(steep, path)
    assert path.length_m > 120.0 / np.sin(np.radians(30)) > 230.0


def test_the_search_only_improves_and_reports_what_it_did() -> None:
    news: list[float] = []
    around = scene(obstacles=[MAST])
    path = found(around, on_iteration=news.append)
    assert path.history.size > 0
    assert np.all(np.diff(path.history) <= 0.0)
    assert path.evaluations > 0
    assert news == sorted(news)
    assert news[-1] == 1.0
    exact = price(around, around.mission.planner.waypoint_tolerance_m)
    assert path.cost == pytest.approx(exact.total(path.path_m[None])[0])
    assert path.cost_terms == {name: pytest.approx(v[0]) for name, v in exact.terms(path.path_m[None]).items()}
    assert path.cost <= path.history[-1] * 1.001  # the cheapest that is flyable


def test_more_room_is_kept_when_it_is_asked_for() -> None:
    around = scene(obstacles=[MAST])
    path, wider = found(around), found(around, wider_m=6.0)
    assert_flyable(around, wider, 6.0)
    legs = polyline_legs(path.waypoints_m)
    limits, bounds = around.tasks[0].limits, around.terrain.bounds
    assert not tubes_clear(around.space, bounds, limits, legs, 6.0).all()  # else this tests nothing
    assert wider.length_m > path.length_m


def test_beside_a_slope_it_is_the_whole_tube_that_counts() -> None:
    # 1 up for 1 across: straight below a leg along the slope there is more ground than 5 m from it at a right angle
    steep = {"kind": "peaks", "base_alt_amsl_m": 100, "peaks": [{**at(150, 75), "height_m": 110, "spread_m": 70}]}
    beside = scene(terrain=steep)
    task = beside.tasks[0]
    path = found(beside)
    assert_flyable(beside, path)
    # the way that just keeps its height straight below does not keep it with its tube
    x = np.linspace(0.0, 300.0, 301)
    lowest = beside.terrain.height_amsl_m(x, np.zeros_like(x)) + Margins.of(task.limits).height_agl_min_m
    z = np.maximum(140.0, lowest + 0.1)
    legs = polyline_legs(np.stack([x, np.zeros_like(x), z], axis=-1))
    assert legs_clear(beside.space, Margins.of(task.limits), legs, 0.1).all()
    assert not tubes_clear(beside.space, beside.terrain.bounds, task.limits, legs).all()


def test_the_same_generator_gives_the_same_path() -> None:
    around = scene(obstacles=[MAST])
    one, same, other = (found(around, seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.path_m, same.path_m)
    np.testing.assert_array_equal(one.history, same.history)
    assert other.cost == pytest.approx(one.cost, rel=1e-3)  # whatever chance has shown it


def test_a_flight_that_cuts_its_corners_too_much_is_planned_again() -> None:
    asked: list[FloatArray] = []

    def third_time_lucky(waypoints_m: FloatArray) -> bool:
        asked.append(waypoints_m)
        return len(asked) > 2

    around = scene(obstacles=[MAST])
    path = found(around, flown_is_clear=third_time_lucky)
    assert len(asked) == 3
    assert_flyable(around, path)


def test_no_flight_is_clear_and_the_vehicle_is_named() -> None:
    with pytest.raises(
        InfeasibleError, match=r"^alpha: found no path that is proven clear with its whole tube in 5 att"
    ):
        found(scene(obstacles=[MAST]), flown_is_clear=lambda waypoints_m: False)


def test_what_blocks_the_way_is_named() -> None:
    wall = {"kind": "no_fly", "name": "wall", "polygon": [at(140, -300), at(160, -300), at(160, 300), at(140, 300)]}
    area = {"south_west": at(-100, -150), "north_east": at(400, 150)}
    with pytest.raises(InfeasibleError, match=r"^alpha: no way from stop 0 to stop 1: .*past wall") as raised:
        found(scene(obstacles=[wall], area=area))
    assert "\n" not in str(raised.value)


def test_of_two_ways_the_cheaper_is_taken() -> None:
    # the mast's axis lies 4 m to the left: to its right the way is shorter, unless a soft zone lies there
    right = found(scene(obstacles=[MAST]))
    assert right.path_m[:, 1].min() < -10.0
    zone = {"kind": "radar", "name": "zone", "center": at(150, -60, amsl=140), "radius_m": 55, "hard": False}
    dear = {"population": 20, "iterations": 30, "weights": {"radar": 50}}
    left = found(scene(obstacles=[MAST, zone], planner=dear))
    assert left.path_m[:, 1].max() > 10.0


def test_a_gap_with_just_enough_room_is_used() -> None:
    # 34.2 m between two walls: on both sides 15 m of margin, 2 m that the legs may leave the curve, and 0.1 m
    walls = [
        {"kind": "no_fly", "name": name, "polygon": [at(140, a), at(160, a), at(160, b), at(140, b)]}
        for name, a, b in [("south", -300, -17.1), ("north", 17.1, 300)]
    ]
    area = {"south_west": at(-100, -150), "north_east": at(400, 150)}
    narrow = scene(ALPHA, obstacles=walls, area=area)
    assert_flyable(narrow, found(narrow))
    closed = [walls[0], {**walls[1], "polygon": [at(140, 12), at(160, 12), at(160, 300), at(140, 300)]}]
    with pytest.raises(InfeasibleError, match="alpha: no way"):
        found(scene(ALPHA, obstacles=closed, area=area))


def test_limits_that_are_changed_are_kept() -> None:
    low = scene({**ALPHA, "height_agl_max_m": 50}, obstacles=[MAST | {"top_height_agl_m": 60}])
    path = found(low)
    assert_flyable(low, path)
    assert path.path_m[:, 2].max() <= 145.0 + 1e-6
    assert replace(low.tasks[0].limits).height_agl_max_m == 50.0


def test_time_may_run_out_at_any_reading_of_the_clock() -> None:
    around = scene(obstacles=[MAST], planner={"population": 6, "iterations": 4})
    for ticks in range(1, 40):
        clock = count().__next__
        assert_flyable(around, found(around, budget=Budget(clock, float(ticks))))
        assert clock() > ticks  # all of it is used


def test_a_shorter_first_guess_of_several_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    corners = [at(100, -60), at(200, -60), at(200, 120), at(100, 120)]
    around = scene(obstacles=[{"kind": "no_fly", "name": "zone", "polygon": corners}])
    task = around.tasks[0]
    ways = first_guesses(around.space, task.limits, *task.route_m, count=2, clearance_extra_m=2.0)
    assert [way[:, 1].mean() > 0.0 for way in ways] == [False, True]
    monkeypatch.setattr(path_search, "first_guesses", lambda *_, count, **__: ways if count > 1 else ways[1:])
    path = found(around)
    assert_flyable(around, path)
    assert path.path_m[:, 1].mean() < 0.0


# --- piece by piece


STANDS = [at(x, y, agl=40) | {"hold_s": 3} for x, y in ((80, 0), (160, 30), (240, 0))]


def way(scene: Scene, seed: int = 1, **changes: Any) -> PlannedPath:
    return find_way(
        scene.tasks[0],
        scene.space,
        scene.terrain.bounds,
        scene.obstacles.names,
        lambda piece, extra_m: price(replace(scene, tasks=(piece.task,)), extra_m),
        scene.mission.planner,
        np.random.default_rng(seed),
        lambda waypoints_m: True,
        **changes,
    )


def test_ways_are_cut_where_a_vehicle_stands_still() -> None:
    task = scene(ALPHA | {"stops": [*STANDS, at(270, 20, agl=40)]}).tasks[0]
    pieces = pieces_of(task)
    assert [len(piece.task.route_m) for piece in pieces] == [2, 2, 2, 3]
    assert [piece.begin for piece in pieces] == [0, 1, 2, 3]
    np.testing.assert_array_equal(np.vstack([p.task.route_m[:-1] for p in pieces[:3]]), task.route_m[:3])
    shares = [share for piece in pieces for share in piece.share]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    many = scene(ALPHA | {"stops": [at(7 * k + 7, 5 * (-1) ** k, agl=40) for k in range(40)]}).tasks[0]
    assert [len(piece.task.route_m) - 1 for piece in pieces_of(many)] == [16, 16, 9]
    plane = replace(many, motion=replace(many.motion, vehicle_class="plane"))
    assert len(pieces_of(plane)) == 1


def test_clear_legs_between_stands_are_not_searched() -> None:
    free = scene(ALPHA | {"stops": STANDS})
    path = way(free)
    np.testing.assert_allclose(path.waypoints_m, free.tasks[0].route_m, atol=1e-3)
    assert path.evaluations == 4
    assert path.length_m == pytest.approx(
        np.linalg.norm(np.diff(free.tasks[0].route_m, axis=0), axis=1).sum(), abs=0.01
    )
    assert path.cost == pytest.approx(price(free, 1.0).total(path.path_m[np.newaxis])[0])


def test_only_the_piece_with_a_mast_in_its_way_is_searched() -> None:
    around = scene(ALPHA | {"stops": STANDS}, obstacles=[MAST | {"center": at(40, 2)}])
    path = way(around)
    assert_flyable(around, path)
    assert len(path.pieces) == 4
    assert [piece.evaluations for piece in path.pieces[1:]] == [1, 1, 1]
    assert path.evaluations > 50
    assert (np.diff(path.history) <= 1e-12).all()
    again = way(around)
    np.testing.assert_array_equal(path.path_m, again.path_m)
    np.testing.assert_array_equal(path.history, again.history)


@pytest.mark.parametrize("seed", range(3))
def test_each_piece_is_as_good_as_alone(seed: int) -> None:
    masts = [MAST | {"name": f"m{k}", "center": at(40 + 80 * k, 3 * (-1) ** k + 15 * (k in (1, 2)))} for k in range(3)]
    cluttered = scene(ALPHA | {"stops": STANDS}, obstacles=masts)
    path = way(cluttered, seed)
    assert_flyable(cluttered, path)
    for piece, whole in zip(pieces_of(cluttered.tasks[0]), path.pieces, strict=True):
        alone = found(replace(cluttered, tasks=(piece.task,)), seed)
        assert whole.length_m <= alone.length_m * 1.02


def test_pieces_that_are_kept_stay_as_they_are_unless_they_lead_elsewhere() -> None:
    around = scene(ALPHA | {"stops": STANDS}, obstacles=[MAST | {"center": at(40, 2)}])
    path = way(around)
    bent = replace(path.pieces[2], path_m=path.pieces[2].path_m + np.array([0.0, 0.0, 1.0]))
    kept = way(around, kept={2: bent})
    assert kept.pieces[2] is bent
    elsewhere = replace(bent, waypoints_m=bent.waypoints_m + 5.0)
    assert way(around, kept={2: elsewhere}).pieces[2] is not elsewhere


def test_what_is_wider_is_wider_where_it_is_asked_for() -> None:
    beside = [MAST | {"name": f"m{k}", "center": at(x, 26), "radius_m": 8} for k, x in enumerate((40, 270))]
    near = scene(
        ALPHA | {"stops": [at(80, 0, agl=40) | {"hold_s": 3}, at(230, 0, agl=40) | {"hold_s": 3}]}, obstacles=beside
    )
    off = [np.abs(piece.path_m[:, 1]).max() for piece in way(near).pieces]
    wider = [np.abs(piece.path_m[:, 1]).max() for piece in way(near, wider_m={0: 6.0}).pieces]
    assert off[0] < 0.1
    assert wider[0] > 1.0
    assert wider[1:] == off[1:]


def test_which_stops_have_no_way_between_them_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def blocked(_space: object, _limits: object, start_m: FloatArray, *_: object, **__: object) -> list[FloatArray]:
        raise InfeasibleError(f"the wall, from {start_m[0]:.0f} m on")

    monkeypatch.setattr(path_search, "first_guesses", blocked)
    walled = scene(ALPHA | {"stops": STANDS}, obstacles=[MAST | {"center": at(200, 15), "radius_m": 5}])
    with pytest.raises(InfeasibleError, match="alpha: no way from stop 2 to stop 3: the wall, from 160 m on"):
        way(walled)
