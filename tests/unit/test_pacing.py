"""Where vehicles are along their plans, how late, and speeds that bring them together: laws, and a toy fleet."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner import energy, proof, timing
from missionplanner.mission import VehicleSettings
from missionplanner.motion import TICK_S, Navigator, Route, takeoff_points
from missionplanner.pacing import (
    Advice,
    Course,
    Gust,
    Haste,
    Meeting,
    Pacer,
    Place,
    Rules,
    Sighting,
    Trim,
    common_delay,
    lateness_s,
    pacer,
    place_of,
    steady_wind,
    times_at,
)
from missionplanner.plan import FleetPlan
from missionplanner.planner import plan_fleet
from missionplanner.scene import Scene
from missionplanner.vehicle import MotionModel, motion_model
from tests.scenes import at, question, scene_of

COPTER = motion_model(VehicleSettings())
EIGHT = ((0, 0, 30), (200, 200, 30), (200, 0, 30), (0, 200, 30), (-100, 200, 30))
"""Its second and fourth waypoints' legs cross at (100, 100)."""


def course(
    name: str = "uav1",
    waypoints_m: Sequence[tuple[float, float, float]] = EIGHT,
    speed_m_s: float | Sequence[float] = 6.0,
    hold_s: Sequence[float] | None = None,
    model: MotionModel = COPTER,
    limits_m_s: tuple[float, float] = (3.0, 10.0),
    arrival_s: float | None = None,
) -> Course:
    points = np.array(waypoints_m, dtype=float)
    home = points[0] * [1.0, 1.0, 0.0]
    speeds = np.array(np.broadcast_to(speed_m_s, len(points) - 1), dtype=float)
    holds = np.zeros(len(points) - 1) if hold_s is None else np.array(hold_s, dtype=float)
    planned, reached_s = timing.predict_flight(model, home, points, speeds, hold_s=holds, end="land")
    arrives_s = float(reached_s[-1]) if arrival_s is None else arrival_s
    return Course(name, model, home, points, speeds, holds, "land", planned, reached_s, arrives_s, *limits_m_s)


def waypoint_at(which: Course, t_s: float) -> int:
    return int(np.searchsorted(which.reached_s, t_s, side="right"))


# where, and how late


def test_the_leg_is_the_one_that_is_flown_where_paths_cross() -> None:
    eight = course()
    crossing = np.array([100.0, 100.0, 30.0])
    assert place_of(eight, 1, crossing) == Place(1, pytest.approx(0.5))
    assert place_of(eight, 3, crossing) == Place(3, pytest.approx(0.5))
    late = [lateness_s(eight, place_of(eight, leg, crossing), 60.0) for leg in (1, 3)]
    assert late[0] > late[1] + 30.0


@settings(max_examples=60, deadline=None)
@given(share=st.floats(0.02, 0.98), late_s=st.floats(-20.0, 200.0), noise_m=st.tuples(*[st.floats(-1.0, 1.0)] * 2))
def test_who_flies_its_plan_later_is_that_much_late(share: float, late_s: float, noise_m: tuple[float, float]) -> None:
    eight = course()
    t_s = share * float(eight.reached_s[-1])
    position_m = eight.planned.at(t_s) + np.array([*noise_m, 0.0])
    found = lateness_s(eight, place_of(eight, waypoint_at(eight, t_s), position_m), t_s + late_s)
    velocity_m_s = (eight.planned.at(t_s + 0.5) - eight.planned.at(t_s - 0.5))[:2]
    # slow corners tell little, and are cut within the waypoint's radius
    slowest_m_s = max(float(np.hypot(*velocity_m_s)), 0.5)
    assert abs(found - late_s) <= 0.3 + (math.hypot(*noise_m) + 0.5) / slowest_m_s + 2.0 * (slowest_m_s < 4.0)


def test_nobody_is_late_while_it_holds_as_planned() -> None:
    held = course(hold_s=[0.0, 20.0, 0.0, 0.0])
    place = Place(2, 0.999)
    come_s, leave_s = times_at(held, held.planned, held.reached_s, place)
    assert leave_s - come_s == pytest.approx(20.0)
    assert lateness_s(held, place, come_s + 15.0) == 0.0
    assert lateness_s(held, place, leave_s + 3.0) == pytest.approx(3.0)
    assert lateness_s(held, place, come_s - 2.0) == pytest.approx(-2.0)


def test_who_goes_on_after_a_hold_stood_still_as_planned() -> None:
    """It stands for a moment more while it takes its photos: its mission is at the next waypoint by then."""
    held = course(hold_s=[0.0, 6.0, 0.0, 0.0])
    pacer = Pacer([held], lambda _i, _j: 0.0)
    states = []
    for tick in range(40):
        t_s, waypoint = float(held.reached_s[2]) + 0.2 * tick, 2 if tick < 30 else 3
        pacer.saw(0, Sighting(t_s, held.waypoints_m[2], np.zeros(3), waypoint, True, arrival_s=None))
        *_, advice = _thought(pacer)
        states.append(advice.paces[0].state)
    assert states[20] == "holding"
    assert states[31] == "flying"
    assert "paused" not in states


def _thought(pacer: Pacer) -> Iterator[Advice]:
    advice = yield from pacer.deliberate()
    yield advice


def test_a_climb_counts_by_its_height() -> None:
    eight = course()
    for t_s in (3.0, 6.0, 9.0):
        assert lateness_s(eight, place_of(eight, 0, eight.planned.at(t_s)), t_s + 10.0) == pytest.approx(10.0, abs=0.1)


# one delay for all

windows = st.lists(st.tuples(st.floats(-100, 100), st.floats(0, 100)).map(lambda w: (w[0], w[0] + w[1])), min_size=1)


@given(windows)
def test_the_common_delay_is_none_or_the_least_that_all_can_make(found: list[tuple[float, float]]) -> None:
    delay_s = common_delay(found)
    earliest, latest = max(w[0] for w in found), min(w[1] for w in found)
    assert delay_s >= earliest
    if earliest <= 0.0 <= latest:
        assert delay_s == 0.0
    elif earliest <= latest:
        assert earliest <= delay_s <= latest
        assert abs(delay_s) == min(abs(earliest), abs(latest))
    else:
        assert delay_s == earliest


@given(windows, st.integers(0, 5), st.floats(0, 50))
def test_who_gets_later_never_makes_the_fleet_earlier(
    found: list[tuple[float, float]], which: int, more_s: float
) -> None:
    later = list(found)
    k = which % len(found)
    later[k] = (found[k][0] + more_s, found[k][1] + more_s)
    assert common_delay(later) >= common_delay(found)


def test_those_who_have_arrived_are_joined_as_soon_as_can_be() -> None:
    assert common_delay([(5.0, 50.0)], [12.0]) == 12.0
    assert common_delay([(20.0, 50.0)], [12.0]) == 20.0
    assert common_delay([], [12.0]) == 12.0


# the air


@settings(max_examples=50, deadline=None)
@given(speed=st.floats(0.5, 5.5), angle=st.floats(0.0, 2 * math.pi), turn=st.floats(0.8, 2.3))
def test_wind_is_known_once_it_has_held_vehicles_up_on_two_courses(speed: float, angle: float, turn: float) -> None:
    wind = speed * np.array([math.cos(angle), math.sin(angle)])
    airspeed = 10.35
    felt = []
    for k, heading in enumerate([angle + math.pi, angle + math.pi + turn] * 4):
        velocity = wind + airspeed * np.array([math.cos(heading), math.sin(heading)])
        felt.append(Gust(float(k), (float(velocity[0]), float(velocity[1])), airspeed, True))
    np.testing.assert_allclose(steady_wind(felt), wind, atol=0.15)


def test_calm_air_and_what_tells_nothing_leave_the_wind_as_expected() -> None:
    loose = [Gust(float(k), (6.0, 0.0), 10.35, False) for k in range(10)]
    assert steady_wind([], (1.0, 2.0)).tolist() == [1.0, 2.0]
    assert steady_wind(loose, (1.0, 2.0)).tolist() == [1.0, 2.0]
    one = [Gust(0.0, (6.0, 0.0), 10.35, True)]
    assert steady_wind(one).tolist() == [0.0, 0.0]


# a toy fleet


class Toy:
    """Vehicles that fly their courses by the motion model, in wind, with a pacer that sees them every 0.4 s."""

    def __init__(
        self,
        courses: Sequence[Course],
        *,
        wind_m_s: tuple[float, float] = (0.0, 0.0),
        late_s: Sequence[float] = (),
        required_m: float = 0.0,
        correct: bool = True,
        hold: bool = False,
        rules: Rules | None = None,
    ) -> None:
        self.courses = courses
        self.pacer = Pacer(courses, lambda i, j: required_m, correct=correct, hold=hold, rules=rules)
        self.navigators = [Navigator([replace(c.model, wind_m_s=wind_m_s)], c.home_m[None]) for c in courses]
        self.late_s = list(late_s) or [0.0] * len(courses)
        self.on_legs = [False] * len(courses)
        self.started = [False] * len(courses)
        self.arrival_s: list[float | None] = [None] * len(courses)
        self.t_s = 0.0
        self.commanded: list[tuple[float, int, float]] = []
        self.advice: list[Advice] = []
        self.answer: Callable[[int], bool] = lambda _i: True
        self.lost_answers = 0  # to stops that are obeyed
        self.edit: Callable[[int, Sighting], Sighting | None] = lambda _i, sighting: sighting

    def step(self) -> None:
        self.t_s += TICK_S
        for i, (navigator, which) in enumerate(zip(self.navigators, self.courses, strict=True)):
            if self.t_s < self.late_s[i]:
                continue
            if not self.started[i]:
                self.started[i] = True
                navigator.follow(0, *takeoff_points(which.model, which.home_m, which.waypoints_m[0]))
            navigator.step()
            if navigator.finished[0]:
                if not self.on_legs[i]:
                    self.on_legs[i] = True
                    navigator.follow(0, *Route.through(which.waypoints_m[1:], which.speed_m_s, which.hold_s))
                elif self.arrival_s[i] is None:
                    self.arrival_s[i] = self.t_s

    def sighting(self, i: int) -> Sighting:
        navigator, which = self.navigators[i], self.courses[i]
        waypoint = 1 + int(navigator.waypoint[0]) if self.on_legs[i] else 0
        waypoint = min(waypoint, len(which.waypoints_m) - (self.arrival_s[i] is None))
        return Sighting(
            self.t_s, navigator.position_m[0].copy(), navigator.velocity_m_s[0].copy(), waypoint, True,
            arrival_s=self.arrival_s[i],
        )  # fmt: skip

    def think(self) -> Advice:
        for i in range(len(self.courses)):
            sighting = self.edit(i, self.sighting(i))
            if sighting is not None:
                self.pacer.saw(i, sighting)
        thinking = self.pacer.deliberate()
        while True:
            try:
                next(thinking)
            except StopIteration as done:
                advice: Advice = done.value
                break
        self.advice.append(advice)
        for trim in advice.trims:
            assert advice.paces[trim.vehicle].state == ("paused" if trim.from_m_s == 0.0 else "flying")
            self.commanded.append((self.t_s, trim.vehicle, trim.to_m_s))
            navigator = self.navigators[trim.vehicle]
            if self.answer(trim.vehicle):
                if trim.to_m_s == 0.0:
                    navigator.halt(0)
                elif trim.from_m_s == 0.0:
                    navigator.resume(0)
                else:
                    navigator.set_speed(0, trim.to_m_s)
                if self.lost_answers > 0 and trim.to_m_s == 0.0:
                    self.lost_answers -= 1
                    self.pacer.refused(trim, self.t_s, answered=False)
                else:
                    self.pacer.obeyed(trim, self.t_s)
            else:
                self.pacer.refused(trim, self.t_s)
        return advice

    def run(self, until_s: float = 3000.0) -> Toy:
        while self.t_s < until_s and any(arrival is None for arrival in self.arrival_s):
            self.step()
            tick = round(self.t_s / TICK_S)
            if tick % round(0.4 / TICK_S) == 0:
                for i in range(len(self.courses)):
                    sighting = self.edit(i, self.sighting(i))
                    if sighting is not None:
                        self.pacer.saw(i, sighting)
            if tick % round(5.0 / TICK_S) == 0:
                self.think()
        return self

    @property
    def spread_s(self) -> float:
        arrivals = [a for a in self.arrival_s if a is not None]
        assert len(arrivals) == len(self.courses)
        return max(arrivals) - min(arrivals)


def line(name: str, y_m: float, length_m: float, heading_deg: float = 90.0, **more: object) -> Course:
    """There and back along a straight line, with waypoints every 150 m or so."""
    ahead = np.array([math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))])
    steps = max(2, round(length_m / 2.0 / 150.0))
    away = np.concatenate(
        [np.linspace(0.0, length_m / 2.0, steps + 1), np.linspace(length_m / 2.0, 0.0, steps + 1)[1:]]
    )
    points = [(float(a * ahead[0]), float(y_m + a * ahead[1]), 40.0) for a in away]
    return course(name, points, **more)  # type: ignore[arg-type]


def together(*which: Course) -> list[Course]:
    """Return courses whose speeds let them arrive with the slowest of them."""
    arrival_s = max(c.arrival_s for c in which)
    made = []
    for c in which:
        low, high = 1.0, 12.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            _, reached_s = timing.predict_flight(c.model, c.home_m, c.waypoints_m, middle, end="land")
            low, high = (middle, high) if reached_s[-1] > arrival_s else (low, middle)
        made.append(course(c.name, [tuple(p) for p in c.waypoints_m.tolist()], high))
    return made


def three() -> list[Course]:
    return together(
        line("fast", 0.0, 4500.0, 90.0, speed_m_s=9.0),
        line("middle", 300.0, 3600.0, 30.0, speed_m_s=8.0),
        line("slow", 600.0, 2700.0, 180.0, speed_m_s=8.0),
    )


def test_a_fleet_on_time_is_left_alone() -> None:
    toy = Toy(three()).run()
    assert toy.commanded == []
    assert toy.spread_s <= 0.2
    late = [pace.lateness_s for advice in toy.advice for pace in advice.paces if pace.lateness_s is not None]
    assert max(map(abs, late)) <= 0.5


@pytest.mark.parametrize("from_deg", [0.0, 90.0, 225.0])
def test_wind_that_nobody_planned_for_does_not_part_the_fleet(from_deg: float) -> None:
    angle = math.radians(from_deg)
    wind = (-5.0 * math.sin(angle), -5.0 * math.cos(angle))
    alone = Toy(three(), wind_m_s=wind, correct=False).run()
    toy = Toy(three(), wind_m_s=wind).run()
    assert alone.commanded == []
    assert alone.spread_s > 15.0
    assert toy.spread_s <= 1.0
    assert toy.commanded
    assert all(3.0 <= speed <= 10.0 for _, _, speed in toy.commanded)
    for k in range(3):
        times = [t for t, i, _ in toy.commanded if i == k]
        assert all(b - a >= 10.0 - 1e-6 for a, b in pairwise(times))
        assert all(
            t <= arrival - 14.0 for t, arrival in zip(times, [toy.arrival_s[k]] * len(times), strict=True) if arrival
        )


def test_a_late_start_is_caught_up_where_it_can_be() -> None:
    courses = three()
    toy = Toy(courses, late_s=(0.0, 15.0, 0.0)).run()
    assert toy.spread_s <= 0.6
    assert max(a or 0.0 for a in toy.arrival_s) == pytest.approx(courses[0].arrival_s, abs=0.6)
    assert {i for _, i, _ in toy.commanded} == {1}
    # who takes up a new speed is not held up by any wind
    assert {advice.wind_m_s for advice in toy.advice} == {(0.0, 0.0)}


def test_a_late_start_that_cannot_be_caught_up_delays_all_by_as_little_as_can_be() -> None:
    courses = [replace(c, speed_max_m_s=9.01) for c in three()]
    assert courses[0].speed_m_s.max() == pytest.approx(9.0, abs=0.05)
    toy = Toy(courses, late_s=(12.0, 0.0, 0.0)).run()
    assert toy.spread_s <= 0.6
    assert max(a or 0.0 for a in toy.arrival_s) == pytest.approx(courses[0].arrival_s + 12.0, abs=0.6)


def test_nothing_is_commanded_before_the_first_waypoint_or_while_a_vehicle_stands() -> None:
    toy = Toy(three(), late_s=(30.0, 0.0, 0.0))
    while toy.t_s < 40.0:
        toy.step()
        if round(toy.t_s / TICK_S) % 8 == 0:
            toy.think()
    assert not [1 for _, i, _ in toy.commanded if i == 0]
    toy.navigators[1].halt(0)
    before = len([1 for _, i, _ in toy.commanded if i == 1])
    for _ in range(round(30.0 / TICK_S)):
        toy.step()
        if round(toy.t_s / TICK_S) % 8 == 0:
            toy.think()
    assert toy.advice[-1].paces[1].state == "paused"
    halted_s = toy.t_s - 22.0
    assert len([1 for t, i, _ in toy.commanded if i == 1 and t > halted_s]) == 0
    assert len([1 for _, i, _ in toy.commanded if i == 1]) <= before + 1
    toy.navigators[1].resume(0)
    toy.run()
    assert toy.spread_s <= 0.8


def test_lost_and_repeated_telemetry_changes_little() -> None:
    wind = (0.0, 4.0)
    rng = np.random.default_rng(3)
    toy = Toy(three(), wind_m_s=wind)
    old: dict[int, Sighting] = {}

    def meddle(i: int, sighting: Sighting) -> Sighting | None:
        if rng.random() < 0.3:
            return None
        if rng.random() < 0.2 and i in old:
            return old[i]  # once more, and out of order
        old[i] = sighting
        return sighting

    toy.edit = meddle
    assert toy.run().spread_s <= 1.2


def test_who_is_not_heard_keeps_all_speeds_as_they_are() -> None:
    toy = Toy(three(), late_s=(0.0, 15.0, 0.0))
    toy.edit = lambda i, s: replace(s, age_s=30.0) if i == 2 else s
    toy.run()
    assert toy.commanded == []
    assert any("slow is not heard" in remark for advice in toy.advice for remark in advice.remarks)


def test_who_left_its_mission_keeps_all_speeds_as_they_are_until_it_is_back() -> None:
    toy = Toy(three(), late_s=(0.0, 15.0, 0.0))
    toy.edit = lambda i, s: replace(s, in_mission=not (i == 2 and 40.0 < toy.t_s < 120.0))
    toy.run()
    assert [t for t, _, _ in toy.commanded if 45.0 < t < 120.0] == []
    assert any("left its mission" in remark for advice in toy.advice for remark in advice.remarks)
    back = [(t, speed) for t, i, speed in toy.commanded if i == 2 and t >= 120.0]
    # an autopilot flies at its own default when it enters a mission anew: it is told its speed again, at once
    assert back[0][0] <= 131.0
    assert back[0][1] == pytest.approx(float(toy.courses[2].speed_m_s[0]), rel=0.05)


def test_who_refuses_is_left_alone_and_the_others_join_it() -> None:
    toy = Toy(three(), late_s=(0.0, 15.0, 0.0))
    toy.answer = lambda i: i != 1
    toy.run()
    assert len([1 for _, i, _ in toy.commanded if i == 1]) == Rules().tries
    arrivals = np.array(toy.arrival_s, dtype=float)
    assert toy.spread_s <= 1.5
    assert arrivals[1] == pytest.approx(toy.courses[1].arrival_s + 15.0, abs=1.0)


def test_speeds_leg_by_leg_are_scaled_and_told_again_after_the_mission_sets_its_own() -> None:
    points = [(150.0 * k, 0.0, 40.0) for k in range(13)]
    slow_middle = course("varied", points, [8.0] * 4 + [5.0] * 4 + [8.0] * 4)
    toy = Toy([slow_middle], late_s=(10.0,))

    class Forgetful:
        leg = 0

    def mission_sets_speed() -> None:
        leg = int(toy.navigators[0].waypoint[0])
        if toy.on_legs[0] and leg != Forgetful.leg:
            Forgetful.leg = leg
            if leg in (4, 8):
                toy.navigators[0].set_speed(0, float(slow_middle.speed_m_s[leg]))

    while toy.arrival_s[0] is None and toy.t_s < 600.0:
        toy.step()
        mission_sets_speed()
        tick = round(toy.t_s / TICK_S)
        if tick % 8 == 0:
            toy.pacer.saw(0, toy.sighting(0))
        if tick % 100 == 0:
            toy.think()
    assert toy.arrival_s[0] == pytest.approx(slow_middle.arrival_s, abs=1.0)
    speeds = [speed for _, _, speed in toy.commanded]
    assert any(8.0 < speed <= 10.0 for speed in speeds)
    assert any(5.0 < speed < 8.0 for speed in speeds)


def crossing() -> list[Course]:
    """Two that pass the same point, one well after the other."""
    first = course("first", [(0, 0, 40), (600, 0, 40), (1200, 0, 40)], 6.0)
    second = course("second", [(600, -1000, 40), (600, -200, 40), (600, 600, 40)], 6.0)
    arrival_s = max(first.arrival_s, second.arrival_s)
    return [replace(c, arrival_s=arrival_s) for c in (first, second)]


def nearest_m(toy: Toy) -> float:
    """Return how close two vehicles come."""
    least_m = math.inf
    while any(arrival is None for arrival in toy.arrival_s) and toy.t_s < 900.0:
        toy.run(toy.t_s + 0.4)
        between_m = toy.navigators[0].position_m[0] - toy.navigators[1].position_m[0]
        least_m = min(least_m, float(np.linalg.norm(between_m)))
    return least_m


@pytest.mark.parametrize("after_s", [-10.0, 10.0])
def test_what_would_bring_vehicles_too_close_is_not_commanded(after_s: float) -> None:
    courses = crossing()

    def passes_s(which: Course) -> float:
        away_m = np.linalg.norm(which.planned.position_m - [600.0, 0.0, 40.0], axis=1)
        return float(which.planned.t_s[int(np.argmin(away_m))])

    # the first starts so late that it passes just before, or just after the second: catching up, it would meet it
    late_s = passes_s(courses[1]) - passes_s(courses[0]) + after_s
    free = Toy(courses, late_s=(late_s, 0.0), required_m=0.1)
    assert nearest_m(free) < 25.0
    kept = Toy(courses, late_s=(late_s, 0.0), required_m=30.0)
    assert nearest_m(kept) >= 30.0
    told = [remark for advice in kept.advice for remark in advice.remarks]
    assert any("first and second within 30 m" in remark for remark in told)


def test_a_solved_speed_is_monotone_in_the_arrival_asked_for() -> None:
    toy = Toy(three())
    while toy.t_s < 60.0:
        toy.step()
    toy.think()
    tracked = toy.pacer._tracked[1]
    asked_s = np.linspace(200.0, 1500.0, 27) + toy.t_s
    factors = [toy.pacer._factor_for(tracked, float(a)) for a in asked_s]
    assert all(b <= a + 1e-9 for a, b in pairwise(factors))
    low, high = tracked.course.factors
    assert min(factors) == low
    assert max(factors) == high
    for a, factor in zip(asked_s, factors, strict=True):
        if low < factor < high:
            assert toy.pacer._arrival_s(tracked, factor) == pytest.approx(float(a), abs=0.3)


def test_no_copter_is_told_a_faster_speed_where_the_wind_would_push_it_off_its_way() -> None:
    way = line("uav1", 0.0, 2400.0, 90.0)
    found = {}
    for deviation_m in (math.inf, 2.0, 1e-4):  # the last: so narrow that no speed keeps to it
        toy = Toy([replace(way, deviation_m=deviation_m)])
        while toy.t_s < 40.0:
            toy.step()
        toy.think()
        toy.pacer._wind_m_s = (0.0, 6.5)
        (tracked,) = toy.pacer._tracked
        found[deviation_m] = toy.pacer._bounds(tracked)
        toy.pacer._wind_m_s = (0.0, 0.0)
        assert toy.pacer._bounds(tracked) == way.factors
    assert found[math.inf] == way.factors
    assert found[2.0][0] == found[1e-4][0] == way.factors[0]
    assert found[1e-4][1] == 1.0 <= found[2.0][1]  # as it flies now, but no faster


# nobody is waited for, or left standing, without bound


def narrow() -> list[Course]:
    """Two side by side that can hardly fly slower."""
    ways = [[(400.0 * k, y, 30.0) for k in range(4)] for y in (0.0, 500.0)]
    return [course(n, way, 10.0, limits_m_s=(9.0, 10.0)) for n, way in zip("ab", ways, strict=True)]


def test_who_does_not_lift_off_is_waited_for_only_for_a_while() -> None:
    courses = three()
    toy = Toy(courses, late_s=(0.0, 0.0, 5000.0))
    toy.run(1200.0)
    for k in range(2):
        assert toy.arrival_s[k] == pytest.approx(courses[k].arrival_s, abs=1.0)
    assert any("slow does not lift off" in remark for advice in toy.advice for remark in advice.remarks)


def test_who_is_told_not_to_start_neither_delays_the_others_nor_keeps_them_from_correcting() -> None:
    courses = three()
    toy = Toy(courses, late_s=(15.0, 0.0, 5000.0))
    toy.edit = lambda i, s: None if i == 2 else s
    toy.pacer.ground(2)
    toy.run(1200.0)
    assert {i for _, i, _ in toy.commanded} == {0}
    for k in range(2):
        assert toy.arrival_s[k] == pytest.approx(courses[k].arrival_s, abs=1.0)
    assert toy.advice[-1].paces[2].state == "grounded"


def test_who_is_told_not_to_start_still_stands_in_the_way() -> None:
    courses = crossing()
    # home of the third: beside the way of the first
    third = course("third", [(800, 20, 40), (800, 600, 40), (800, 1200, 40)], 6.0)
    toy = Toy([*courses, third], late_s=(10.0, 0.0, 5000.0), required_m=50.0)
    toy.pacer.ground(2)
    toy.run(60.0)
    assert toy.pacer._too_close({}, 0.5) == "first and third within 50 m"


def test_who_stands_for_long_is_waited_for_only_for_a_while() -> None:
    courses = three()
    toy = Toy(courses)
    toy.run(100.0)
    toy.navigators[2].halt(0)
    toy.run(1200.0)
    for k in range(2):
        assert toy.arrival_s[k] == pytest.approx(courses[k].arrival_s, abs=1.0)
    assert any("slow has stood too long" in remark for advice in toy.advice for remark in advice.remarks)


@pytest.mark.parametrize("sways_m_s", [0.0, 1.0])
def test_who_was_stopped_goes_on_however_it_sways(sways_m_s: float) -> None:
    toy = Toy(narrow(), late_s=(0.0, 60.0), hold=True)

    def sway(i: int, sighting: Sighting) -> Sighting:
        stands = i in toy.pacer.stopped
        swaying = np.array([sways_m_s * math.sin(sighting.t_s), 0.0, 0.0])
        return replace(sighting, velocity_m_s=sighting.velocity_m_s + swaying) if stands else sighting

    toy.edit = sway
    toy.run(600.0)
    assert 0.0 in [speed for _, i, speed in toy.commanded if i == 0]
    assert toy.spread_s <= 1.5


def test_who_obeys_a_stop_without_an_answer_goes_on() -> None:
    toy = Toy(narrow(), late_s=(0.0, 60.0), hold=True)
    toy.lost_answers = 1
    toy.run(600.0)
    assert toy.lost_answers == 0
    assert toy.spread_s <= 1.5
    assert toy.pacer.stopped == frozenset()


def test_who_neither_answers_nor_obeys_a_stop_is_seen_to_fly() -> None:
    toy = Toy(narrow(), late_s=(0.0, 60.0), hold=True)
    stops: list[float] = []
    refused = toy.pacer.refused

    def silent(trim: Trim, t_s: float, *, answered: bool = True) -> bool:
        stops.append(t_s)
        return refused(trim, t_s, answered=False)

    toy.pacer.refused = silent  # type: ignore[method-assign]
    toy.answer = lambda _i: toy.advice[-1].trims[0].to_m_s > 0.0
    toy.run(600.0)
    assert stops
    assert not [t for t, _, speed in toy.commanded if speed > 0.0 and any(s < t < s + 10.0 for s in stops)]
    assert toy.arrival_s[0] is not None
    assert toy.arrival_s[0] < toy.courses[0].arrival_s + 20.0
    assert toy.pacer.stopped == frozenset()


def test_who_does_not_go_on_when_told_to_is_asked_again_and_not_waited_for() -> None:
    courses = narrow()
    toy = Toy(courses, late_s=(0.0, 60.0), hold=True)
    stopped: list[int] = []

    def answer(i: int) -> bool:
        stands = i in stopped
        if toy.advice[-1].trims[0].to_m_s == 0.0 and i == 0:
            stopped.append(i)
        return not stands

    toy.answer = answer
    toy.run(900.0)
    asked = [t for t, i, speed in toy.commanded if i == 0 and speed > 0.0 and t > 140.0]
    assert len(asked) > 20
    assert toy.arrival_s[1] is not None
    assert toy.arrival_s[1] <= courses[1].arrival_s + 60.0 + 70.0


# how much faster


def scene_and_plan(name: str, **changes: object) -> tuple[Scene, FleetPlan]:
    """Two vehicles, the first of which is planned much slower than it may fly, to arrive with the second."""
    plane = name == "planes"
    speed = {"min": 14, "max": 22} if plane else {"min": 3, "max": 10}
    height = 100.0 if plane else 60.0
    far = (9000.0, 1200.0) if plane else (3200.0, -300.0)
    near: dict[str, object] = {"goal": at(6000, 0, agl=height)}
    if not plane:
        near = {"stops": [at(800, 0, agl=height)], "goal": at(1600, 560, agl=height)}
    vehicles: list[dict[str, object]] = [
        {"name": "near", "start": at(0, 0, agl=height), **near},
        {"name": "far", "start": at(0, far[1], agl=height), "goal": at(*far, agl=height)},
    ]
    if plane:
        vehicles = [v | {"home": at(-500, y)} for v, y in zip(vehicles, (0.0, far[1]), strict=True)]
    defaults = {"speed_m_s": speed, "endurance_s": 6000}
    defaults |= {"class": "plane", "end": "rtl"} if plane else {"safety": {"obstacle_m": 5, "terrain_m": 20}}
    data = question(*vehicles, defaults=defaults, **changes)
    scene = scene_of(data)
    return scene, plan_fleet(scene)


def wall(x_m: float, y_m: float = 0.0) -> list[dict[str, object]]:
    """Return what stands beyond the first one's corner at 800 m."""
    place = {"center": at(x_m, y_m), "radius_m": 3.0, "top_height_agl_m": 64.0}
    return [{"name": "wall", "kind": "cylinder", **place}]


def sooner(which: Course) -> list[float]:
    assert which.hastes is not None
    return [haste.scale for haste in which.hastes]


def test_nobody_is_hurried_beyond_the_speed_at_which_its_way_home_is_proven() -> None:
    free = pacer(*scene_and_plan("copters"), correct=True).courses[0]
    assert sooner(free)[-1] == free.factors[1] > 1.5
    _, plan = scene_and_plan("copters", obstacles=wall(900.0))
    scene, _ = scene_and_plan("copters", obstacles=wall(826.0, -2.0))  # a plan made for it would turn wider
    watched = pacer(scene, plan, correct=True)
    course_ = watched.courses[0]
    greatest = max([1.0, *sooner(course_)])
    assert greatest < course_.factors[1]

    def problems(scale: float) -> list[str]:
        sortie = proof.planned_sortie(scene, plan.vehicles[0])
        legs = tuple(replace(leg, speed_m_s=scale * leg.speed_m_s) for leg in sortie.legs)
        certificate = proof.prove(scene, [replace(sortie, legs=legs)])
        return [str(finding) for finding in certificate.problems if finding.vehicle == "near"]

    assert not problems(greatest)
    assert any("wall" in problem for problem in problems(course_.factors[1]))
    # asked to arrive much too early, that is as fast as it is told to fly
    watched.saw(
        0, Sighting(100.0, course_.planned.at(100.0), np.array([5.0, 0.0, 0.0]), waypoint_at(course_, 100.0), True)
    )
    assert watched._factor_for(watched._tracked[0], 0.0) == pytest.approx(greatest)


def test_nobody_is_hurried_where_only_its_times_are_watched_or_ways_home_are_waived() -> None:
    scene, plan = scene_and_plan("copters", obstacles=wall(825.0))
    assert pacer(scene, plan, correct=False).courses[0].hastes is None
    waived = scene_and_plan("copters", obstacles=wall(825.0), fleet={"direct_return": "waived"})
    which = pacer(*waived, correct=True).courses[0]
    assert sooner(which)[-1] == which.factors[1]


def with_endurance(scene: Scene, endurance_s: float) -> Scene:
    vehicles = tuple(v.model_copy(update={"endurance_s": endurance_s}) for v in scene.mission.vehicles)
    return replace(scene, mission=scene.mission.model_copy(update={"vehicles": vehicles}))


def test_nobody_is_hurried_beyond_what_its_battery_lasts() -> None:
    scene, plan = scene_and_plan("planes")
    ample = pacer(scene, plan, correct=True).courses[0]
    flight = plan.vehicles[0].trajectory
    model = energy.energy_model(scene.mission.vehicles[0])
    assert model is not None
    used = float(energy.used_share(model, flight, 0.0)[-1])
    # so little that it is just enough as planned
    scene = with_endurance(scene, 6000.0 * used / (1.0 - model.reserve_share) * 1.02)
    watched = pacer(scene, plan, correct=True)
    scarce = watched.courses[0]
    assert max([1.0, *sooner(scarce)]) < 1.2 < max(sooner(ample))
    model = energy.energy_model(scene.mission.vehicles[0])
    assert model is not None
    assert scarce.hastes is not None
    for haste in scarce.hastes:
        faster, _ = timing.predict_flight(
            scarce.model,
            scarce.home_m,
            scarce.waypoints_m,
            scarce.speeds(haste.scale),
            end="rtl",
            until_s=flight.t_s[-1],
        )
        assert energy.used_share(model, faster, 0.0)[-1] <= 1.0 - model.reserve_share
        assert haste.spare_s >= 0.0


def test_time_lost_in_the_air_leaves_less_to_hurry_with() -> None:
    way = replace(line("uav1", 0.0, 2400.0), hastes=(Haste(1.2, 60.0), Haste(1.4, 20.0)))
    assert way.greatest(0.0) == 1.4
    assert way.greatest(30.0) == 1.2
    assert way.greatest(90.0) == 1.0
    toy = Toy([way], late_s=(40.0,))
    toy.run(120.0)
    (tracked,) = toy.pacer._tracked
    assert tracked.lost_s == 0.0  # on the ground nothing is lost
    assert toy.pacer._bounds(tracked)[1] == 1.4
    toy.navigators[0].halt(0)
    toy.run(150.0)
    toy.navigators[0].resume(0)
    toy.run(180.0)
    assert 25.0 <= tracked.lost_s <= 35.0
    assert toy.pacer._bounds(tracked)[1] == 1.2
    assert float(way.speeds(1.2)[0]) == pytest.approx(toy.commanded[-1][2], abs=0.01)


def test_who_has_hurried_may_be_less_late() -> None:
    way = line("uav1", 0.0, 2400.0)
    way = replace(way, spare_s=np.full(len(way.planned.t_s), 50.0), hastes=(Haste(1.2, 80.0), Haste(1.4, 20.0)))
    place = Place(2, 0.5)
    assert way.latest_s(place) == way.arrival_s + 50.0
    assert way.latest_s(place, 1.1) == way.arrival_s + 50.0
    assert way.latest_s(place, 1.3) == way.arrival_s + 20.0


# meetings on the way


def test_meetings_are_waypoints_of_the_plan() -> None:
    height = 40.0
    vehicles = [
        {"name": n, "start": at(0, y, agl=height), "stops": [at(200, y, agl=height)], "goal": at(400, y, agl=height)}
        for n, y in (("a", 0), ("b", 80))
    ]
    scene = scene_of(question(*vehicles, fleet={"rendezvous": [{"name": "r", "at": {"a": 0, "b": 1}}]}))
    plan = plan_fleet(scene)
    (meeting,) = pacer(scene, plan, correct=False).meetings
    assert meeting.name == "r"
    for k, place_m in ((0, (0.0, 0.0)), (1, (200.0, 80.0))):
        np.testing.assert_allclose(plan.vehicles[k].waypoints_m[meeting.waypoints[k], :2], place_m, atol=0.02)


def test_a_meeting_that_is_missed_is_told_once() -> None:
    courses = three()
    undisturbed = Toy(courses)
    undisturbed.pacer.meetings = (Meeting("tea", {0: 0, 1: 0}),)
    assert not [r for advice in undisturbed.run().advice for r in advice.remarks]
    toy = Toy(courses, late_s=(0.0, 15.0, 0.0))
    toy.pacer.meetings = (Meeting("tea", {0: 1, 1: 1}),)
    toy.run()
    told = {remark for advice in toy.advice for remark in advice.remarks if "rendezvous" in remark}
    begins_s = [c.reached_s[1] for c in courses]
    (tea,) = told
    assert tea.startswith("rendezvous tea is missed by more than 5 s: fast is there before middle")
    at_s = [toy.pacer._tracked[k].reached_s[1] for k in range(2)]
    assert at_s[0] == pytest.approx(begins_s[0], abs=1.0)
    assert at_s[1] == pytest.approx(begins_s[1] + 15.0, abs=1.5)
