"""Schedules against a toy navigator whose times are known, and against the real motion model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.errors import InfeasibleError
from missionplanner.schedule import (
    ARRIVAL_TOLERANCE_S,
    SPEED_STEP_M_S,
    Flier,
    Meeting,
    Schedule,
    TooEarlyError,
    arrange,
    solve_speed,
)
from missionplanner.timing import reached_times
from missionplanner.vehicle import MotionModel

COPTER = MotionModel("ardupilot", "copter", 2.5, 1.0, 2.5, 1.5, 2.0, 0.0)
PX4 = MotionModel("px4", "copter", 3.0, 4.0, 3.0, 1.5, 2.0, 0.0)
HOME = (0.0, 0.0, 0.0)
STOP_S = 5.0  # what a stop costs the toy beside its hold


def toy(lengths_m: Sequence[float], speeds: tuple[float, ...], holds: tuple[float, ...]) -> np.ndarray:
    """Climb for 10 s, then length over speed; a hold costs a stop as well, and a change of speed shifts the corner."""
    legs = np.array(lengths_m) / np.array(speeds)
    stops = np.array([hold + STOP_S * (hold > 0.0) for hold in holds])
    corner = np.concatenate([0.05 * np.abs(np.diff(speeds)), [0.0]])
    return (
        10.0 + np.concatenate([[0.0], np.cumsum(legs + corner)]) + np.concatenate([[0.0, 0.0], np.cumsum(stops)[:-1]])
    )


def flier(name: str, *lengths_m: float, speeds: tuple[float, float] = (3.0, 10.0), delay_s: float = 0.0) -> Flier:
    low, high = speeds
    return Flier(name, partial(toy, lengths_m), len(lengths_m), low, high, high, delay_s, can_wait=True)


def reached(one: Flier, schedule: Schedule) -> np.ndarray:
    return np.asarray(schedule.start_delay_s + one.reached_s(schedule.speeds_m_s, schedule.hold_s))


def goals(*fliers: Flier, **kwargs: object) -> Meeting:
    return Meeting("fleet.arrival_time_s", {i: one.legs for i, one in enumerate(fliers)}, **kwargs)  # type: ignore[arg-type]


def test_all_arrive_with_the_slowest() -> None:
    fliers = [flier("near", 100.0, 200.0), flier("far", 600.0, 200.0)]
    schedules, (arrival_s,) = arrange(fliers, [goals(*fliers)])
    assert arrival_s == pytest.approx(90.0)
    assert schedules[1].speeds_m_s == (10.0, 10.0)
    assert schedules[0].speeds_m_s == pytest.approx((3.75, 3.75), abs=0.01)
    for one, schedule in zip(fliers, schedules, strict=True):
        assert reached(one, schedule)[-1] == pytest.approx(arrival_s, abs=ARRIVAL_TOLERANCE_S)
        assert schedule.start_delay_s == 0.0
        assert schedule.window_s == pytest.approx(
            (reached(one, replace(schedule, speeds_m_s=(10.0, 10.0)))[-1],
             reached(one, replace(schedule, speeds_m_s=(3.0, 3.0)))[-1])
        )  # fmt: skip


def test_who_is_too_early_starts_later_and_keeps_room_both_ways() -> None:
    fliers = [flier("near", 60.0), flier("far", 3000.0)]
    schedules, (arrival_s,) = arrange(fliers, [goals(*fliers)])
    assert schedules[0].start_delay_s > 200.0
    assert 3.0 < schedules[0].speeds_m_s[0] < 10.0
    assert reached(fliers[0], schedules[0])[-1] == pytest.approx(arrival_s, abs=ARRIVAL_TOLERANCE_S)
    with pytest.raises(TooEarlyError, match=r"near cannot take longer than 30.0 s but is due at 310.0 s") as caught:
        arrange(fliers, [goals(*fliers)], start_later=False)
    assert (caught.value.index, caught.value.legs) == (0, (0, 1))
    assert caught.value.early_s == pytest.approx(280.0)


def test_arrival_in_order() -> None:
    fliers = [flier("c", 500.0), flier("a", 800.0), flier("b", 300.0)]
    meeting = replace(goals(*fliers), after_s={0: 24.0, 1: 0.0, 2: 12.0})
    schedules, (arrival_s,) = arrange(fliers, [meeting])
    times = [reached(one, schedule)[-1] for one, schedule in zip(fliers, schedules, strict=True)]
    assert times == pytest.approx([arrival_s + 24.0, arrival_s, arrival_s + 12.0], abs=ARRIVAL_TOLERANCE_S)
    assert arrival_s == pytest.approx(90.0)


def test_meetings_on_the_way_are_met_one_after_the_other() -> None:
    fliers = [flier("a", 200.0, 300.0, 300.0), flier("b", 400.0, 200.0, 500.0)]
    meetings = [Meeting("start", {0: 1, 1: 1}), Meeting("end", {0: 2, 1: 2}), goals(*fliers)]
    schedules, times = arrange(fliers, meetings)
    for k, time_s in enumerate(times, start=1):
        for one, schedule in zip(fliers, schedules, strict=True):
            assert reached(one, schedule)[k] == pytest.approx(time_s, abs=ARRIVAL_TOLERANCE_S)
    assert len(set(schedules[0].speeds_m_s)) > 1
    assert times == sorted(times)


def test_who_is_early_at_a_later_meeting_waits_at_the_one_before() -> None:
    fliers = [flier("short", 300.0, 100.0), flier("long", 300.0, 1000.0)]
    meetings = [Meeting("line", {0: 1, 1: 1}), goals(*fliers)]
    schedules, times = arrange(fliers, meetings)
    hold_s = schedules[0].hold_s[0]
    assert hold_s == math.floor(hold_s) > 0.0
    assert reached(fliers[0], schedules[0])[-1] == pytest.approx(times[-1], abs=ARRIVAL_TOLERANCE_S)
    plane = replace(fliers[0], can_wait=False)
    with pytest.raises(TooEarlyError, match=r"short cannot take longer"):
        arrange([plane, fliers[1]], meetings)


def test_the_time_asked_for() -> None:
    fliers = [flier("a", 300.0), flier("b", 500.0)]
    _, (arrival_s,) = arrange(fliers, [replace(goals(*fliers), time_s=100.0)])
    assert arrival_s == 100.0
    with pytest.raises(InfeasibleError, match=r"arrival_time_s: 30 s is too early: b needs at least 60.0 s"):
        arrange(fliers, [replace(goals(*fliers), time_s=30.0)])


def test_the_thrifty_start_later_rather_than_crawl() -> None:
    fliers = [
        replace(flier("a", 300.0), pace_m_s=6.0, thrifty=True),
        replace(flier("b", 900.0), pace_m_s=6.0, thrifty=True),
    ]
    schedules, (arrival_s,) = arrange(fliers, [goals(*fliers)])
    assert [s.speeds_m_s[0] for s in schedules] == pytest.approx([6.0, 6.0], abs=0.02)
    assert schedules[0].start_delay_s == pytest.approx(100.0, abs=0.2)
    assert arrival_s == pytest.approx(160.0)


lengths = st.lists(st.floats(30.0, 900.0), min_size=3, max_size=3)


@settings(max_examples=60, deadline=None)
@given(ways=st.lists(lengths, min_size=2, max_size=5), spacing_s=st.sampled_from([0.0, 7.0]))
def test_every_meeting_is_met_within_limits(ways: list[list[float]], spacing_s: float) -> None:
    fliers = [flier(f"uav{k}", *way) for k, way in enumerate(ways)]
    after_s = {i: spacing_s * i for i in range(len(fliers))}
    meetings = [Meeting("line", dict.fromkeys(range(len(fliers)), 1)), replace(goals(*fliers), after_s=after_s)]
    schedules, times = arrange(fliers, meetings)
    for i, (one, schedule) in enumerate(zip(fliers, schedules, strict=True)):
        assert reached(one, schedule)[1] == pytest.approx(times[0], abs=ARRIVAL_TOLERANCE_S)
        assert reached(one, schedule)[-1] == pytest.approx(times[1] + after_s[i], abs=ARRIVAL_TOLERANCE_S)
        for speed_m_s in schedule.speeds_m_s:
            assert 3.0 - 1e-9 <= speed_m_s <= 10.0 + 1e-9
            assert speed_m_s / SPEED_STEP_M_S == pytest.approx(round(speed_m_s / SPEED_STEP_M_S), abs=1e-6)
    # as early as the slowest can: nobody who could be earlier is waited for
    first = min(times[0] - one.reached_s((10.0,) * 3, (0.0,) * 3)[1] for one in fliers)
    assert first == pytest.approx(0.0, abs=0.5)


@pytest.mark.parametrize("model", [COPTER, PX4], ids=["ardupilot", "px4"])
def test_real_navigators_meet_on_the_way(model: MotionModel) -> None:
    ways = [
        [(0, 0, 30), (120, 40, 35), (260, -30, 40), (420, 0, 30)],
        [(0, 60, 30), (200, 90, 50), (300, 60, 40), (420, 80, 30)],
    ]

    def timed(way: list[tuple[float, float, float]]) -> Flier:
        @lru_cache
        def times(speeds: tuple[float, ...], holds: tuple[float, ...]) -> np.ndarray:
            return reached_times(model, [*way[0][:2], 0.0], way, speeds, holds)

        return Flier(f"uav{way[0][1]}", times, 3, 2.0, 10.0, 10.0, 0.0, can_wait=True)

    fliers = [timed(way) for way in ways]
    meetings = [Meeting("line", {0: 1, 1: 1}), Meeting("end", {0: 2, 1: 2}), goals(*fliers)]
    schedules, times = arrange(fliers, meetings)
    for k, time_s in enumerate(times, start=1):
        for one, schedule in zip(fliers, schedules, strict=True):
            assert reached(one, schedule)[k] == pytest.approx(time_s, abs=2 * ARRIVAL_TOLERANCE_S)


@pytest.mark.parametrize("model", [COPTER, PX4], ids=["ardupilot", "px4"])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.55, 0.9, 1.0])
def test_the_solved_speed_arrives_on_time(model: MotionModel, share: float) -> None:
    way = [[0, 0, 30], [150, 20, 40], [250, 120, 50], [240, 300, 40], [400, 420, 35]]

    def arrives_s(speed_m_s: float) -> float:
        return float(reached_times(model, HOME, way, speed_m_s)[-1])

    wanted_s = arrives_s(10.0) + share * (arrives_s(3.0) - arrives_s(10.0))
    assert arrives_s(solve_speed(lambda v: arrives_s(v) - wanted_s, 3.0, 10.0)) == pytest.approx(
        wanted_s, abs=ARRIVAL_TOLERANCE_S
    )


def test_a_solved_speed_is_a_multiple_of_its_step_and_the_nearest_in_time() -> None:
    assert solve_speed(lambda v: 100.0 / v - 25.0, 2.0, 10.0) == pytest.approx(4.0, abs=0.01)
    assert solve_speed(lambda v: 100.0 / v - 5.0, 2.0, 10.0) == 10.0  # never so early
    assert solve_speed(lambda v: 100.0 / v - 500.0, 2.0, 10.0) == 2.0

    def jumping(v: float) -> float:  # a corner that is cut above 5 m/s only: 18 s are met below it alone
        return 100.0 / v - (0.0 if v < 5.0 else 3.0) - 20.5

    assert abs(jumping(solve_speed(jumping, 2.0, 10.0))) <= ARRIVAL_TOLERANCE_S


@given(st.lists(st.integers(0, 20), min_size=3, max_size=3), st.floats(60.0, 400.0))
@settings(deadline=None)
def test_what_is_to_be_done_takes_its_time_and_waits_come_on_top(stands: list[int], far_m: float) -> None:
    """Stands are never cut short; meetings are met around them, and who waits does so longer where it stands anyway."""
    stand_s = (float(stands[0]), float(stands[1]), 0.0)
    busy = replace(flier("busy", 60.0, 60.0, 60.0), stand_s=stand_s)
    far = flier("far", far_m, 600.0, 1200.0)
    meetings = [Meeting("there", {0: 1, 1: 1}), goals(busy, far)]
    (one, other), times = arrange([busy, far], meetings)
    assert all(held >= stand for held, stand in zip(one.hold_s, stand_s, strict=True))
    assert one.hold_s[0] > stand_s[0] + 10.0  # it waits there for the other, who has further to go from there on
    assert one.hold_s[1:] == stand_s[1:]
    assert other.hold_s == (0.0, 0.0, 0.0)
    for k, place in enumerate((1, 3)):
        assert abs(reached(busy, one)[place] - times[k]) <= 1.5
        assert abs(reached(far, other)[place] - times[k]) <= 1.5
    alone, _ = arrange([busy], [])
    assert alone[0].hold_s == stand_s
    assert alone[0].window_s[0] == pytest.approx(toy([60.0] * 3, (10.0,) * 3, stand_s)[-1])
