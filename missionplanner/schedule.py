"""When each vehicle flies how fast: common arrivals, arrivals in order, meetings on the way (PAPER.md eq. 10).

All times come from predicted flights, never from length over speed. A vehicle's way is cut into sections by the
meetings it takes part in; each section has one speed, found by solving the prediction for the time of its meeting. Who
would be too early even at its least speed loses time where that costs least: on the ground before its start, or, later
on, standing at the meeting before. As a navigator looks ahead, a later speed shifts an earlier time a little: all
sections are solved anew until every meeting is met.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray

SPEED_STEP_M_S = 1e-4
"""Commanded speeds are whole multiples of this."""

ARRIVAL_TOLERANCE_S = 0.05
"""How close to the time asked for a solved speed brings the predicted arrival."""

_TURNS = 6
_LATER_STEP_S = 0.1
_HOLDS = 4

ReachedAt = Callable[[tuple[float, ...], tuple[float, ...]], FloatArray]


@dataclass(frozen=True, slots=True)
class Schedule:
    """When and how fast one vehicle flies its waypoints (W): speeds and holds are of the legs' ends, W - 1 of them."""

    start_delay_s: float
    speeds_m_s: tuple[float, ...]
    hold_s: tuple[float, ...]  # whole seconds: what it has to do there, and waits
    window_s: tuple[float, float]  # of its arrival, fastest and slowest, after its own start and without waits


@dataclass(frozen=True, slots=True, eq=False)
class Flier:
    """One vehicle that is to be timed."""

    name: str
    reached_s: ReachedAt  # from speeds and holds (W - 1) to times (W,) at its waypoints, after its own start
    legs: int  # W - 1
    speed_min_m_s: float
    speed_max_m_s: float
    pace_m_s: float  # no meeting is set so early that it must fly faster than this
    delay_s: float  # it starts no earlier
    can_wait: bool  # stand still at a waypoint: no plane can
    thrifty: bool = False  # starts later rather than fly slower than its pace
    stand_s: tuple[float, ...] = ()  # (W - 1), how long it stands still at the legs' ends anyway; default: nowhere

    @property
    def stands_s(self) -> tuple[float, ...]:
        """How long it stands still at the end of each leg (W - 1), waiting for nobody."""
        return self.stand_s or (0.0,) * self.legs


@dataclass(frozen=True, slots=True, eq=False)
class Meeting:
    """Places that vehicles, by index, reach at one time: ``at`` names the waypoint, ``after_s`` who is due later."""

    what: str
    at: Mapping[int, int]
    after_s: Mapping[int, float] = field(default_factory=dict)
    time_s: float | None = None  # asked for; None: as early as all can


class TooEarlyError(InfeasibleError):
    """A vehicle that would be too early somewhere and may not lose time: its index, waypoints and seconds."""

    def __init__(self, message: str, index: int, legs: tuple[int, int], early_s: float) -> None:
        super().__init__(message)
        self.index = index
        self.legs = legs
        self.early_s = early_s


def arrange(
    fliers: Sequence[Flier], meetings: Sequence[Meeting], *, start_later: bool = True
) -> tuple[list[Schedule], list[float]]:
    """Return every vehicle's schedule, and the times of the meetings.

    Parameters
    ----------
    meetings : in the order of time; each vehicle's at ever later waypoints
    start_later : whether who is too early may start later

    Raises
    ------
    TooEarlyError
        Somebody cannot fly slowly enough, and may not start later nor wait.
    InfeasibleError
        A meeting cannot be at the time asked for; the message says which can.
    """
    courses = [_Course(flier) for flier in fliers]
    times = [0.0] * len(meetings)
    for _ in range(_TURNS):
        begins = [0] * len(fliers)
        for m, meeting in enumerate(meetings):
            sections = {i: (begins[i], end) for i, end in meeting.at.items()}
            times[m] = _meet(courses, sections, meeting, start_later=start_later)
            for i, end in meeting.at.items():
                begins[i] = end
        if _off_s(courses, meetings, times) <= ARRIVAL_TOLERANCE_S:
            break
    return [course.schedule() for course in courses], times


def _off_s(courses: Sequence[_Course], meetings: Sequence[Meeting], times: Sequence[float]) -> float:
    """Return by how much the worst misses a meeting."""
    return max(
        (
            abs(courses[i].reached_at(end) - time_s - meeting.after_s.get(i, 0.0))
            for meeting, time_s in zip(meetings, times, strict=True)
            for i, end in meeting.at.items()
        ),
        default=0.0,
    )


class _Course:
    """One vehicle's speeds, holds and delay while they are being found."""

    def __init__(self, flier: Flier) -> None:
        self.flier = flier
        self.delay_s = flier.delay_s
        self.speeds = [flier.pace_m_s] * flier.legs
        self.holds = list(flier.stands_s)

    def reached_at(self, waypoint: int) -> float:
        """Return when a waypoint is reached, after mission start."""
        return self.delay_s + float(self.flier.reached_s(tuple(self.speeds), tuple(self.holds))[waypoint])

    def at_speed(self, section: tuple[int, int], speed_m_s: float) -> float:
        """Return when the section's end is reached if it is flown at a speed, from now on."""
        begin, end = section
        self.speeds[begin:end] = [speed_m_s] * (end - begin)
        return self.reached_at(end)

    def earliest(self, section: tuple[int, int]) -> float:
        return self.at_speed(section, self.flier.pace_m_s)

    def fastest(self, section: tuple[int, int]) -> float:
        return self.at_speed(section, self.flier.speed_max_m_s)

    def latest(self, section: tuple[int, int]) -> float:
        return self.at_speed(section, self.flier.speed_min_m_s)

    def solve(self, section: tuple[int, int], due_s: float) -> None:
        """Fly a section at the speed that brings the vehicle to its end on time, or as near to it as it can."""
        speed_m_s = solve_speed(
            lambda v: self.at_speed(section, v) - due_s, self.flier.speed_min_m_s, self.flier.speed_max_m_s
        )
        self.at_speed(section, speed_m_s)

    def schedule(self) -> Schedule:
        flier = self.flier
        fast_s, slow_s = (
            float(flier.reached_s((speed_m_s,) * flier.legs, flier.stands_s)[-1])
            for speed_m_s in (flier.speed_max_m_s, flier.speed_min_m_s)
        )
        return Schedule(self.delay_s, tuple(self.speeds), tuple(self.holds), (min(fast_s, slow_s), slow_s))


def _meet(
    courses: Sequence[_Course], sections: Mapping[int, tuple[int, int]], meeting: Meeting, *, start_later: bool
) -> float:
    """Bring all that take part to a meeting on time; return its time."""
    after_s = {i: meeting.after_s.get(i, 0.0) for i in sections}
    if meeting.time_s is None:
        time_s = max(courses[i].earliest(section) - after_s[i] for i, section in sections.items())
    else:
        time_s = meeting.time_s
        fastest = {i: courses[i].fastest(section) - after_s[i] for i, section in sections.items()}
        last = max(fastest, key=lambda i: fastest[i])
        if fastest[last] > time_s + ARRIVAL_TOLERANCE_S:
            raise InfeasibleError(
                f"{meeting.what}: {time_s:g} s is too early: {courses[last].flier.name} needs at least "
                f"{fastest[last]:.1f} s; ask for {math.ceil(fastest[last] * 10) / 10:.1f} s or more"
            )
    for i, section in sections.items():
        due_s = time_s + after_s[i]
        course = courses[i]
        if due_s > course.earliest(section):
            _lose_time(course, i, section, due_s, meeting.what, start_later=start_later)
        course.solve(section, due_s)
    return time_s


def _lose_time(
    course: _Course, index: int, section: tuple[int, int], due_s: float, what: str, *, start_later: bool
) -> None:
    """Let a vehicle start later or wait where it would be too early even at its least speed.

    Then it flies at a speed from the middle of its range, so that it can be both hurried and held up on its way.
    """
    begin, end = section
    flier = course.flier
    earliest_s = course.earliest(section)
    latest_s = max(course.latest(section), earliest_s)
    first = begin == 0
    wanted_s = earliest_s if flier.thrifty and first and start_later else latest_s
    if due_s <= wanted_s + ARRIVAL_TOLERANCE_S:
        return
    if first and start_later:
        aimed_s = earliest_s if flier.thrifty or end == 0 else 0.5 * (earliest_s + latest_s)
        later_s = due_s - aimed_s
        # a round number, unless there is no speed to make up for it
        course.delay_s += later_s if end == 0 else math.floor(later_s / _LATER_STEP_S) * _LATER_STEP_S
        course.delay_s = math.ceil(course.delay_s * 1000.0 - 1e-6) / 1000.0
        return
    if not first and flier.can_wait:
        least_s = max(1.0, flier.stands_s[begin - 1])
        for _ in range(_HOLDS):  # stopping takes time of its own: perhaps a shorter hold is enough
            early_s = due_s - course.latest(section) - ARRIVAL_TOLERANCE_S
            # even where the least hold makes it late: then the next turn waits for it
            course.holds[begin - 1] = max(least_s, course.holds[begin - 1] + math.ceil(early_s))
            if -1.0 < early_s <= 0.0:
                break
        return
    remedies = ["lower its least speed", "raise the others' greatest speeds"]
    remedies.append("let it start later (fleet.lose_time_by)" if first else "move the meetings")
    raise TooEarlyError(
        f"{what}: {flier.name} cannot take longer than {latest_s:.1f} s but is due at {due_s:.1f} s: "
        f"{', or '.join(remedies)}",
        index,
        section,
        due_s - latest_s,
    )


def solve_speed(lateness_s: Callable[[float], float], speed_min_m_s: float, speed_max_m_s: float) -> float:
    """Return the speed, a multiple of :data:`SPEED_STEP_M_S`, at which a vehicle is least early or late.

    Within :data:`ARRIVAL_TOLERANCE_S` where its range allows it (bisection on the prediction; where the navigator's
    corners make a jump, the neighbourhood is searched).
    """
    low = math.ceil(speed_min_m_s / SPEED_STEP_M_S - 1e-6)
    high = max(low, math.floor(speed_max_m_s / SPEED_STEP_M_S + 1e-6))

    def late(steps: int) -> float:
        return lateness_s(round(steps * SPEED_STEP_M_S, 4))

    tried = {low: late(low), high: late(high)}
    if tried[low] > 0.0 > tried[high]:
        _bisect(late, low, high, tried)
        if min(map(abs, tried.values())) > ARRIVAL_TOLERANCE_S:  # a jump: perhaps the time is also met elsewhere
            grid = sorted({round(low + (high - low) * k / 64) for k in range(65)})
            tried.update({steps: late(steps) for steps in grid})
            for a, b in pairwise(grid):
                if tried[a] > 0.0 > tried[b] or tried[a] < 0.0 < tried[b]:
                    _bisect(late, a, b, tried)
    best = min(tried, key=lambda steps: (abs(tried[steps]), steps))
    return round(best * SPEED_STEP_M_S, 4)


def _bisect(late: Callable[[int], float], low: int, high: int, tried: dict[int, float]) -> None:
    """Halve a bracket until a time is met well within the tolerance or no speed is left between its ends."""
    sign = math.copysign(1.0, tried[low])
    while high - low > 1:
        # the secant of time over pace, which is nearly straight, kept away from the ends
        share = min(0.95, max(0.05, tried[low] / (tried[low] - tried[high])))
        middle = round(1.0 / ((1.0 - share) / low + share / high))
        middle = min(high - 1, max(low + 1, middle))
        tried[middle] = late(middle)
        if abs(tried[middle]) < 0.1 * ARRIVAL_TOLERANCE_S:
            return
        if sign * tried[middle] > 0.0:
            low = middle
        else:
            high = middle
