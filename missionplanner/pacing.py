"""Watch and correct: where vehicles are along their plans, when they will arrive, and speeds that bring them together.

Pure: sightings of vehicles in, advice out; the adapters fly by it. What is predicted is the whole flight by the motion
model, at a multiple of the planned speeds and in the wind that the fleet has felt so far; the time that it takes from a
place to the goal is what remains. One law makes a correction: all planned arrivals shift by one delay, none while all
can still make it, else the least that all can make. A speed is commanded only where a vehicle would miss that by more
than a dead band, and only after all remaining flights, as they would be corrected, were shown to keep apart.

Nobody is told to fly faster than its whole flight, alone, is proven to be flown: its way, its battery with the reserve,
its way home from everywhere. That two who return at the same instant keep apart is proven of the planned times only.
"""

from __future__ import annotations

import math
from collections import OrderedDict, deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Literal, NamedTuple

import numpy as np

from missionplanner import energy, proof, timing
from missionplanner.errors import InfeasibleError
from missionplanner.geodesy import FloatArray
from missionplanner.plan import FleetPlan, Trajectory
from missionplanner.scene import Scene
from missionplanner.vehicle import Ending, MotionModel, true_airspeed
from missionplanner.waypoints import passes
from missionplanner.wind import airspeed_limit_m_s, off_legs_m

SPEED_STEP_M_S = 1e-3
"""Commanded speeds are whole multiples of this."""


@dataclass(frozen=True, slots=True)
class Rules:
    """When a speed is commanded."""

    period_s: float = 5.0
    """How often the fleet is thought over."""
    interval_s: float = 10.0
    """Least time between two commands to one vehicle: radio links are narrow."""
    band_s: float = 0.5
    """A predicted miss below this is none ..."""
    band_share: float = 0.006
    """... nor one below this share of what remains: it is left for later."""
    freeze_s: float = 15.0
    """Nothing is commanded so shortly before a goal."""
    stale_s: float = 4.0
    """Who was not heard for so long is where nobody knows."""
    lateness_s: float = 3.0
    """Corrected flights keep apart also when any one of them is so much early or late, if the planned ones do."""
    tries: int = 3
    """Commands refused or unanswered in a row before a vehicle is left alone."""
    hold_s: float = 4.0
    """Copters that are earlier than this even at their least speed are stopped for a while, where that is allowed."""
    hold_before_s: float = 300.0
    """Not much earlier than so long before the goal: until then, it may turn out to be unnecessary."""
    start_s: float = 20.0
    """Nobody waits longer for who does not lift off ..."""
    stand_s: float = 60.0
    """... or stands for so long where it should not."""
    meeting_s: float = 5.0
    """It is told when those who are to meet on the way will be there further apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """What one vehicle is to fly, and what may be changed of it.

    ``speed_m_s`` (W - 1,) is planned on the legs to the waypoints after the first, ``hold_s`` (W - 1,) the standing
    still there; a correction scales all speeds alike, within the limits.
    """

    name: str
    model: MotionModel
    home_m: FloatArray  # (3,)
    waypoints_m: FloatArray  # (W, 3); the first is the top of the take-off
    speed_m_s: FloatArray
    hold_s: FloatArray
    end: Ending
    planned: Trajectory
    reached_s: FloatArray  # (W,) planned
    arrival_s: float  # planned
    speed_min_m_s: float
    speed_max_m_s: float
    deviation_m: float = math.inf  # how far its autopilot may leave the legs (planes: the planned flight)
    spare_s: FloatArray | None = None  # (S,) longer than planned its battery surely lasts, from each planned sample on
    hastes: tuple[Haste, ...] | None = None  # proven scales above 1, rising; None: nobody asked for a proof

    @property
    def start_s(self) -> float:
        """When it is planned to leave the ground."""
        return times_at(self, self.planned, self.reached_s, Place(0, 0.0))[1]

    def speeds(self, factor: float) -> FloatArray:
        """Return the speeds (W - 1,) commanded when the planned ones are scaled."""
        speeds: FloatArray = np.clip(factor * self.speed_m_s, self.speed_min_m_s, self.speed_max_m_s)
        return speeds

    def latest_s(self, place: Place, fastest: float = 1.0) -> float:
        """Return up to which arrival its battery surely lasts, as a vehicle that has come to a place.

        ``fastest`` is the greatest scale that it has flown at.
        """
        if self.spare_s is None:
            return math.inf
        at_s, _ = times_at(self, self.planned, self.reached_s, place)
        sample = int(np.searchsorted(self.planned.t_s, at_s, side="right")) - 1
        spare_s = float(self.spare_s[max(sample, 0)])
        if fastest > 1.0 and self.hastes is not None:
            spare_s = min([spare_s, *(haste.spare_s for haste in self.hastes if haste.scale >= fastest - 1e-9)][:2])
        return self.arrival_s + spare_s

    def greatest(self, lost_s: float) -> float:
        """Return the greatest scale that is proven, for who has lost time in the air that its battery must last too."""
        if self.hastes is None:
            return math.inf
        lasting = takewhile(lambda haste: haste.spare_s >= lost_s, self.hastes)
        return max((haste.scale for haste in lasting), default=1.0)

    @property
    def factors(self) -> tuple[float, float]:
        """The scales at which every leg is flown as slowly, and as fast, as is allowed."""
        return self.speed_min_m_s / float(self.speed_m_s.max()), self.speed_max_m_s / float(self.speed_m_s.min())


_AT_PLACE_M = 0.1


class Meeting(NamedTuple):
    """A rendezvous: which waypoint of each vehicle (by its index) it is."""

    name: str
    waypoints: Mapping[int, int]


def meetings(scene: Scene, plan: FleetPlan) -> tuple[Meeting, ...]:
    """Return who is to meet where; of missions of other origin, nothing is known."""
    index = {vehicle.name: i for i, vehicle in enumerate(plan.vehicles)}
    found = []
    for rendezvous in scene.mission.fleet.rendezvous:
        at: dict[int, int] = {}
        for name, place in rendezvous.at.items():
            task = scene.tasks[index[name]]
            stops = passes(task.route_m, plan.vehicles[index[name]].waypoints_m, _AT_PLACE_M)
            number = task.places.get(place, len(stops))
            if number < len(stops):
                at[index[name]] = stops[number]
        if len(at) > 1:
            found.append(Meeting(rendezvous.name, at))
    return tuple(found)


class Haste(NamedTuple):
    """A scale of the planned speeds at which a whole flight is proven, and how much longer its battery then lasts."""

    scale: float
    spare_s: float


def course(scene: Scene, plan: FleetPlan, index: int, *, hasten: bool = True) -> Course:
    """Return what a plan's vehicle is to fly, and how slowly and how long its speed range and its battery allow.

    ``hasten``: prove how much faster it may fly, too.
    """
    vehicle, limits = plan.vehicles[index], scene.tasks[index].limits
    due_after_s = scene.mission.fleet.arrives_after_s(vehicle.name)
    found = Course(
        name=vehicle.name,
        model=vehicle.motion,
        home_m=vehicle.home_m,
        waypoints_m=vehicle.waypoints_m,
        speed_m_s=vehicle.speeds_m_s,
        hold_s=vehicle.hold_s,
        end=vehicle.end,
        planned=vehicle.trajectory,
        reached_s=vehicle.reached_s,
        arrival_s=vehicle.arrival_s if plan.arrival_s is None else plan.arrival_s + due_after_s,
        speed_min_m_s=limits.speed_min_m_s,
        speed_max_m_s=limits.speed_max_m_s,
        deviation_m=limits.deviation_m,
        spare_s=_spare_s(scene, plan, index),
    )
    return replace(found, hastes=_hastes(scene, plan, index, found)) if hasten else found


def _hastes(scene: Scene, plan: FleetPlan, index: int, course: Course) -> tuple[Haste, ...]:
    """Return scales above 1 at which a vehicle's whole flight is proven, as all that are tried below them are."""
    sortie = proof.planned_sortie(scene, plan.vehicles[index])
    share_s = _share_s(scene, plan, index)

    def proven(scale: float) -> Haste | None:
        speeds_m_s = course.speeds(scale)
        takeoff, *legs = sortie.legs
        faster = [replace(leg, speed_m_s=float(v)) for leg, v in zip(legs, speeds_m_s, strict=True)]
        takeoff = replace(takeoff, speed_m_s=faster[0].speed_m_s)
        try:
            flight, *_ = proof.predict(scene, [replace(sortie, legs=(takeoff, *faster))])
            certificate = proof.prove_flights(scene, [flight])
        except InfeasibleError:  # a leg that cannot be flown so fast in the wind
            return None
        if any(finding.vehicle == course.name for finding in certificate.problems):
            return None
        spare = [
            finding.required - finding.value
            for finding in certificate.findings
            if finding.check == "energy" and finding.unit == "" and finding.required is not None
            if finding.value is not None and not finding.waived
        ]
        if not spare or not share_s:
            return Haste(scale, math.inf)
        spare_s = min(spare) / share_s
        if course.model.vehicle_class == "plane":  # it circles until the last of the fleet is down
            spare_s -= max(float(course.planned.t_s[-1] - flight.trajectory.t_s[-1]), 0.0)
        return Haste(scale, spare_s) if spare_s >= 0.0 else None

    greatest = course.factors[1]
    found: list[Haste] = []
    low, high = 1.0, math.inf
    for scale in [*(scale for scale in _HASTES if scale < greatest), greatest]:
        haste = proven(scale) if scale > 1.0 + 1e-6 else None
        if haste is None:
            high = scale
            break
        found.append(haste)
        low = scale
    for _ in range(_HALVINGS if 1.0 + 1e-6 < high < math.inf else 0):
        haste = proven(0.5 * (low + high))
        if haste is None:
            high = 0.5 * (low + high)
        else:
            found.append(haste)
            low = haste.scale
    return tuple(found)


def _share_s(scene: Scene, plan: FleetPlan, index: int) -> float | None:
    """Return the share of its battery that a second of level flight takes at most; None: nothing is known of it."""
    vehicle = plan.vehicles[index]
    model = energy.energy_model(scene.mission.vehicles[index], scene.mission.air_m_s)
    if model is None:
        return None
    wind_m_s = (scene.mission.wind_max_m_s or 0.0) + math.hypot(*scene.mission.air_m_s)
    return float(model.power_share(vehicle.speed_m_s, 0.0, wind_m_s, float(vehicle.waypoints_m[:, 2].max())))


def _spare_s(scene: Scene, plan: FleetPlan, index: int) -> FloatArray | None:
    """Return how much longer than planned a vehicle's battery surely lasts from each sample of its flight on (S,).

    To the end of its mission, and home from everywhere on the way, with its reserve. None: nothing is known of it.
    """
    vehicle, settings = plan.vehicles[index], scene.mission.vehicles[index]
    model = energy.energy_model(settings, scene.mission.air_m_s)
    share_s = _share_s(scene, plan, index)
    if model is None or share_s is None:
        return None
    wind_m_s = scene.mission.wind_max_m_s or 0.0
    flight = vehicle.trajectory
    used = energy.used_share(model, flight, wind_m_s, vehicle.start_delay_s)
    need = np.full(len(used), used[-1])
    if scene.mission.fleet.direct_return != "waived":
        home = energy.return_share(model, flight, vehicle.home_m, vehicle.motion.return_height_m, wind_m_s)
        need = np.where(flight.t_s <= vehicle.reached_s[-1], np.maximum(used + home, need), need)
    from_here_on = np.maximum.accumulate(need[::-1])[::-1]
    spare: FloatArray = np.maximum(1.0 - model.reserve_share - from_here_on, 0.0) / share_s
    return spare


def pacer(
    scene: Scene, plan: FleetPlan, *, correct: bool, hold: bool | None = None, rules: Rules | None = None
) -> Pacer:
    """Return what watches, and where allowed corrects, the flight of a plan; ``hold`` defaults to the mission's."""
    tasks = scene.tasks
    return Pacer(
        [course(scene, plan, index, hasten=correct) for index in range(len(plan.vehicles))],
        lambda i, j: proof.required_apart_m(scene, tasks[i], tasks[j]),
        together=plan.arrival_s is not None,
        correct=correct,
        hold=scene.mission.fleet.correction == "speed_and_hold" if hold is None else hold,
        lateness_s=scene.mission.fleet.lateness_s,
        meetings=meetings(scene, plan),
        rules=rules,
    )


# ---------------------------------------------------------------------------------------------------------------------
# Where along its plan a vehicle is, and how late.


class Place(NamedTuple):
    """How far a vehicle has come: on the leg *to* a waypoint (0: the take-off), and which share of that leg."""

    leg: int
    share: float


def place_of(course: Course, waypoint: int, position_m: FloatArray) -> Place:
    """Return where a vehicle is that flies to ``waypoint``: its projection on that leg alone.

    The leg is what the vehicle says it flies, never the nearest one: paths cross themselves, and come close.
    """
    if waypoint >= len(course.waypoints_m):
        return Place(len(course.waypoints_m), 0.0)
    shares = _shares(course, waypoint, np.asarray(position_m, dtype=float)[None])
    return Place(waypoint, float(shares[0]))


def _on_ground(place: Place) -> bool:
    return place.leg == 0 and place.share < _LIFTED_OFF


def _shares(course: Course, leg: int, position_m: FloatArray) -> FloatArray:
    """Return which share of a leg lies behind each of the positions (N, 3)."""
    start_m = course.home_m if leg == 0 else course.waypoints_m[leg - 1]
    way_m = course.waypoints_m[leg] - start_m
    if leg == 0:
        way_m = np.array([0.0, 0.0, way_m[2]])  # whoever takes off is as far as it is high
    squared = float(way_m @ way_m)
    if squared < 1e-6:
        return np.ones(len(position_m))
    shares: FloatArray = np.clip((position_m - start_m) @ way_m / squared, 0.0, 1.0)
    return shares


def times_at(course: Course, flight: Trajectory, reached_s: FloatArray, place: Place) -> tuple[float, float]:
    """Return when a flight comes to a place, and when it leaves it: later only where it stands still there."""
    if place.leg >= len(reached_s):
        return float(reached_s[-1]), math.inf
    if holds_at(course, place):
        return float(reached_s[place.leg]), float(reached_s[place.leg] + course.hold_s[place.leg - 1])
    begin_s = float(flight.t_s[0]) if place.leg == 0 else float(reached_s[place.leg - 1])
    end_s = float(reached_s[place.leg])
    first, last = np.searchsorted(flight.t_s, [begin_s, end_s])
    ends_m = flight.at(np.array([begin_s, end_s]))
    t_s = np.concatenate([[begin_s], flight.t_s[first:last], [end_s]])
    position_m = np.concatenate([ends_m[:1], flight.position_m[first:last], ends_m[1:]])
    shares = np.maximum.accumulate(_shares(course, place.leg, position_m))
    if shares[-1] <= place.share:
        return end_s, end_s
    at = int(np.searchsorted(shares, place.share))
    until = int(np.searchsorted(shares, place.share, side="right"))
    if at == 0:
        return begin_s, float(t_s[max(until - 1, 0)])
    part = (place.share - shares[at - 1]) / max(shares[at] - shares[at - 1], 1e-12)
    come_s = float(t_s[at - 1] + part * (t_s[at] - t_s[at - 1]))
    return come_s, max(come_s, float(t_s[until - 1]))


def holds_at(course: Course, place: Place) -> bool:
    """Whether a vehicle is where its mission holds it: within the radius of that waypoint."""
    if not 0 < place.leg < len(course.waypoints_m) or course.hold_s[place.leg - 1] <= 0.0:
        return False
    length_m = float(np.linalg.norm(course.waypoints_m[place.leg] - course.waypoints_m[place.leg - 1]))
    return (1.0 - place.share) * length_m <= course.model.waypoint_radius_m


def lateness_s(course: Course, place: Place, t_s: float) -> float:
    """Return how much later than planned a vehicle is at a place; below 0: earlier."""
    come_s, leave_s = times_at(course, course.planned, course.reached_s, place)
    return t_s - min(max(t_s, come_s), leave_s)


# ---------------------------------------------------------------------------------------------------------------------
# The air that the fleet has felt.


class Gust(NamedTuple):
    """A steady motion over ground (east, north) at a known airspeed; ``tight`` false: at no more than that."""

    t_s: float
    velocity_m_s: tuple[float, float]
    airspeed_m_s: float
    tight: bool


_AIR_NOISE_M_S = 0.5
_WIND_SPREAD_M_S = 5.0
_AIR_MEMORY_S = 900.0
_GUSTS = 3
"""Who was held up less often may have been held up by something else."""
_WIND_SHARE_MAX = 0.65  # of an airspeed: nobody plans flights in more


def steady_wind(felt: Sequence[Gust], expected_m_s: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """Return the wind (east, north) that best explains how vehicles were held up, the least that does.

    Each motion says that ground velocity less wind is as long as the airspeed: a circle on which the wind lies. Least
    squares over all circles, and towards what was expected, by Gauss-Newton.
    """
    wind = np.array(expected_m_s, dtype=float)
    if sum(gust.tight for gust in felt) < _GUSTS:
        return wind
    velocity = np.array([gust.velocity_m_s for gust in felt])
    airspeed = np.array([gust.airspeed_m_s for gust in felt])
    tight = np.array([gust.tight for gust in felt])
    for _ in range(20):
        through_air = velocity - wind
        flown = np.maximum(np.linalg.norm(through_air, axis=1), 1e-6)
        miss = flown - airspeed
        counts = tight | (miss > 0.0)
        slope = -(through_air / flown[:, None])[counts] / _AIR_NOISE_M_S
        residual = miss[counts] / _AIR_NOISE_M_S
        normal = slope.T @ slope + np.eye(2) / _WIND_SPREAD_M_S**2
        gradient = slope.T @ residual + (wind - np.array(expected_m_s)) / _WIND_SPREAD_M_S**2
        step = np.linalg.solve(normal, gradient)
        wind = wind - step
        if float(np.linalg.norm(step)) < 1e-3:
            break
    most = _WIND_SHARE_MAX * float(airspeed.min())
    blown = float(np.linalg.norm(wind))
    return wind if blown <= most else wind * (most / blown)


def airspeed_max_m_s(model: MotionModel, alt_amsl_m: float, speed_m_s: float) -> float:
    """Return how fast through the air a vehicle that is held up by the wind flies.

    A copter as fast as it may lean, a plane as fast as commanded.
    """
    if model.vehicle_class == "plane":
        return speed_m_s * true_airspeed(alt_amsl_m)
    return airspeed_limit_m_s(model)


# ---------------------------------------------------------------------------------------------------------------------
# One vehicle.


State = Literal["grounded", "waiting", "climbing", "flying", "holding", "paused", "away", "unheard", "arrived"]
"""Grounded: will not start any more; waiting: has not left the ground; holding: as its mission wants, paused: as it
does not; away: in another mode than its mission's; unheard: nobody knows where it is."""


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """What is known of a vehicle. Times are the vehicle's since the common start; ages count from now."""

    t_s: float
    position_m: FloatArray  # (3,)
    velocity_m_s: FloatArray  # (3,)
    waypoint: int  # flown to; the number of waypoints once the goal is reached
    in_mission: bool  # armed, in the mode that flies missions, and not returning or landing
    paused: bool = False  # by its own word
    age_s: float = 0.0  # of position and waypoint
    arrival_s: float | None = None  # once known


@dataclass(frozen=True, slots=True)
class Pace:
    """How one vehicle is doing; arrivals are predicted, at the present, the greatest and the least speed."""

    name: str
    state: State
    lateness_s: float | None
    planned_s: float
    arrival_s: float | None
    earliest_s: float | None
    latest_s: float | None
    speed_m_s: float | None  # commanded
    at_s: float | None  # time of the sighting
    fixed: bool = False  # whether nothing can be changed of its arrival any more


@dataclass(frozen=True, slots=True)
class Trim:
    """A speed to command; to 0: a stop, expected to be so long, from 0: going on."""

    vehicle: int
    name: str
    from_m_s: float
    to_m_s: float
    factor: float
    why: str
    stop_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Advice:
    """How all are doing, by how much all arrive later than planned, what to command, and what an operator should know.

    ``delay_s`` is None where nothing is to be brought together.
    """

    paces: tuple[Pace, ...]
    delay_s: float | None
    wind_m_s: tuple[float, float]
    trims: tuple[Trim, ...]
    remarks: tuple[str, ...]


@dataclass(slots=True, eq=False)
class _Tracked:
    """What is remembered of one vehicle."""

    course: Course
    seen: Sighting | None = None
    place: Place | None = None
    factor: float = 1.0
    factor_leg: int = 0  # on which it was commanded
    due_s: float = -math.inf  # no command before
    lost: bool = False  # the autopilot has forgotten what was commanded
    failures: int = 0
    held_s: float | None = None  # since when it holds where its mission wants it
    freed_s: float = -math.inf  # when it last ceased to
    bounds: tuple[tuple[float, float], tuple[float, float]] | None = None  # of its scale, and the wind they hold in
    stopped_s: float | None = None  # until when it is to stand, by our command (or it may: it did not answer)
    overdue_s: float | None = None  # since when it is to go on
    grounded: bool = False  # will not start any more
    reached_s: dict[int, float] = field(default_factory=dict)  # waypoints
    fastest: float = 1.0  # of its scales
    lost_s: float = 0.0  # in the air
    least_late_s: float = math.inf  # since it last lost some
    stands: tuple[float, FloatArray] | None = None  # since when, and where, it has hardly moved
    moves: deque[tuple[float, int, FloatArray]] = field(default_factory=lambda: deque(maxlen=64))
    felt: deque[Gust] = field(default_factory=lambda: deque(maxlen=120))
    ways: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=24))  # taken, predicted (s)
    before: tuple[float, float, Place] | None = None  # time, factor, place
    flights: OrderedDict[tuple[float, float, float], tuple[Trajectory, FloatArray]] = field(default_factory=OrderedDict)

    @property
    def slowness(self) -> float:
        """Time taken over time predicted, lately; 1 as long as there is little to tell it from."""
        taken = sum(way[0] for way in self.ways)
        predicted = sum(way[1] for way in self.ways)
        return min(max((taken + _TRUSTED_S) / (predicted + _TRUSTED_S), _SLOWNESS[0]), _SLOWNESS[1])


_TRUSTED_S = 60.0
_SLOWNESS = (0.8, 1.5)
_KEPT_FLIGHTS = 12
_LIFTED_OFF = 0.02  # share of the climb to the first waypoint
_STILL_M_S = 0.4
_STILL_S = 4.0
_MOVED_M = 3.0  # hovering, a copter strays less
_STEADY_S = 3.0
_STEADY_M_S = 0.4
_HELD_UP_M_S = 0.4
_GUST_EVERY_S = 5.0
_FROM_CORNERS_M = 25.0
_SPARSE = 10  # samples: half a second
_COPTER_STRAYS, _PLANE_STRAYS = 0.95, 0.2
"""Shares of what may be strayed; a plane's is its navigator's, of which a correction may take only little."""
_LITTLE_S, _MUCH = 1.5, 0.25  # no such share of its speed is changed for so little time
_TRIED = 9  # scales
_LOOKS = 4  # in so many thoughts, all flights are held against each other once
_ROOM_S = 0.5  # how early or late any one may be before it is told that vehicles come too close
_TOLD_S = 5.0  # who is earlier than that is told
_HASTES = (1.1, 1.25, 1.5)
"""Scales that are proven, beside the greatest; between the last that is and the first that is not, halving."""
_HALVINGS = 3
_NOWHERE = ("grounded", "unheard", "away")
_LOST_S = 2.0  # less may be noise
_AFTER_A_STOP = 1.1  # times the least speed
_NEAR_S = 0.1  # how well a speed solves for an arrival
_ELSEWHERE_S = (2.0, 5.0, 10.0, 20.0, -2.0, -5.0, -10.0)  # other delays, where the first is not proven apart


class Pacer:
    """Watches a fleet and advises speeds.

    Parameters
    ----------
    courses : of all vehicles of the plan
    required_m : how far apart vehicles i and j must be
    together : whether they are to arrive as planned relative to each other; else each at its own time
    correct : whether speeds may be commanded; else it only tells
    hold : whether copters may be stopped as well
    lateness_s : up to which the mission asks for separation
    meetings : on the way; corrections do not keep them, it is only told that they are missed
    """

    def __init__(
        self,
        courses: Sequence[Course],
        required_m: Callable[[int, int], float],
        *,
        together: bool = True,
        correct: bool = True,
        hold: bool = False,
        lateness_s: float = 0.0,
        meetings: Sequence[Meeting] = (),
        rules: Rules | None = None,
    ) -> None:
        self.rules = rules or Rules()
        self.correct = correct
        self.hold = hold
        self._required_m = required_m
        self._together = together
        self._tracked = [_Tracked(course) for course in courses]
        self._lateness_s = lateness_s
        self._slack_s: float | None = None
        self._thoughts = 0
        self._conflict = ""
        self.meetings = tuple(meetings)
        self._missed: dict[str, str] = {}  # meetings, and what was told of them
        self._wind_m_s = courses[0].model.wind_m_s

    @property
    def courses(self) -> tuple[Course, ...]:
        """What the vehicles are to fly."""
        return tuple(tracked.course for tracked in self._tracked)

    def saw(self, vehicle: int, sighting: Sighting) -> None:
        """Take note of where a vehicle is; what is older than known is passed over."""
        tracked = self._tracked[vehicle]
        before = tracked.seen
        if before is not None and not before.in_mission and sighting.in_mission and tracked.place is not None:
            tracked.lost = tracked.place.leg > 0  # whoever enters the mission anew flies at its own default
        if before is not None and sighting.t_s <= before.t_s:
            tracked.seen = replace(
                sighting, t_s=before.t_s, position_m=before.position_m, velocity_m_s=before.velocity_m_s
            )
        else:
            tracked.seen = sighting
            tracked.moves.append((sighting.t_s, sighting.waypoint, np.array(sighting.velocity_m_s, dtype=float)))
            self._feel(tracked, sighting)
        left = sighting.waypoint if tracked.place is None else tracked.place.leg
        for waypoint in range(left, sighting.waypoint):
            there_s = tracked.seen.t_s if tracked.held_s is None or waypoint > left else tracked.held_s
            tracked.reached_s.setdefault(waypoint, there_s)
        tracked.place = place_of(tracked.course, sighting.waypoint, tracked.seen.position_m)
        held = holds_at(tracked.course, tracked.place)
        if tracked.held_s is not None and not held:
            tracked.freed_s = tracked.seen.t_s
        tracked.held_s = (tracked.seen.t_s if tracked.held_s is None else tracked.held_s) if held else None
        away_m = math.inf if tracked.stands is None else math.dist(tracked.seen.position_m, tracked.stands[1])
        if held or (away_m > _MOVED_M and not (tracked.seen.paused and tracked.stands is not None)):
            tracked.stands = (tracked.seen.t_s, np.array(tracked.seen.position_m, dtype=float))
        if not sighting.in_mission or self._goes_on(tracked):  # somebody else has let it go on
            tracked.stopped_s = tracked.overdue_s = None
        speeds = tracked.course.speed_m_s
        leg = tracked.place.leg
        if 0 < leg <= len(speeds) and tracked.factor_leg > 0 and speeds[leg - 1] != speeds[tracked.factor_leg - 1]:
            tracked.lost = True  # an item of its mission has set its own speed

    def obeyed(self, trim: Trim, t_s: float) -> None:
        """Take note that a speed was accepted."""
        tracked = self._tracked[trim.vehicle]
        tracked.stopped_s = t_s + trim.stop_s if trim.to_m_s == 0.0 else None
        tracked.overdue_s = None
        tracked.factor = trim.factor
        tracked.fastest = max(tracked.fastest, trim.factor)
        tracked.factor_leg = _leg_from(tracked)
        tracked.lost = False
        tracked.failures = 0
        tracked.due_s = t_s + self.rules.interval_s
        tracked.before = None

    @property
    def stopped(self) -> frozenset[int]:
        """Who stands by our command, or may: each waits for a command to go on."""
        return frozenset(k for k, tracked in enumerate(self._tracked) if tracked.stopped_s is not None)

    @property
    def has_stood(self) -> bool:
        """Whether somebody has stood for as long as was thought: time to think, whatever the period."""
        return any(
            tracked.stopped_s is not None
            and tracked.overdue_s is None
            and tracked.seen is not None
            and tracked.seen.paused
            and tracked.seen.t_s >= tracked.stopped_s
            for tracked in self._tracked
        )

    def went_on(self, vehicle: int) -> None:
        """Take note that a stopped vehicle was let go on."""
        self._tracked[vehicle].stopped_s = self._tracked[vehicle].overdue_s = None

    def as_planned(self, vehicle: int) -> None:
        """Take note that a vehicle was told its planned speed, after it had left its mission and come back."""
        tracked = self._tracked[vehicle]
        tracked.factor, tracked.lost, tracked.before = 1.0, False, None
        tracked.factor_leg = _leg_from(tracked)

    def ground(self, vehicle: int) -> None:
        """Take note that a vehicle will not start any more: nobody waits for it, but it stands in the way."""
        self._tracked[vehicle].grounded = True

    def refused(self, trim: Trim, t_s: float, *, answered: bool = True) -> bool:
        """Take note that a speed was refused or not answered; True: this vehicle is now left alone.

        Who does not answer a stop may have obeyed it: it is taken to stand until it is seen to fly.
        """
        tracked = self._tracked[trim.vehicle]
        tracked.due_s = t_s + self.rules.interval_s
        if not answered and trim.to_m_s == 0.0:
            tracked.stopped_s, tracked.overdue_s = t_s + trim.stop_s, None
            tracked.failures += 1
            return tracked.failures >= self.rules.tries
        tracked.failures += 1
        if tracked.stopped_s is not None:  # it must go on, however often it is asked
            return False
        return tracked.failures >= self.rules.tries

    def deliberate(self) -> Generator[None, None, Advice]:
        """Think the fleet over; yields now and then, so that whoever listens to it can go on listening."""
        wind_m_s = self._wind()
        if wind_m_s != self._wind_m_s:  # what it explains is not to count once more
            self._wind_m_s = wind_m_s
            for tracked in self._tracked:
                tracked.ways.clear()
                tracked.before = None
        paces: list[Pace] = []
        for tracked in self._tracked:
            paces.append(self._pace(tracked))
            yield
        out = [self._left_out(tracked, pace) for tracked, pace in zip(self._tracked, paces, strict=True)]
        delays = self._delays([pace for pace, why in zip(paces, out, strict=True) if not why], paces)
        stopped = [tracked.stopped_s is not None for tracked in self._tracked]
        remarks = [self._remark(pace, stopped=still) for pace, still in zip(paces, stopped, strict=True)]
        trims: tuple[Trim, ...] = ()
        hindered = next((r for r, p in zip(remarks, paces, strict=True) if r and p.state in ("away", "unheard")), None)
        remarks += out
        if self.correct:
            trims, problem = self._going_on(paces, delays)
            remarks.append(problem)
        if delays is not None and self.correct and hindered is None and not trims:
            ready = [k for k, pace in enumerate(paces) if not out[k] and self._may_trim(k, pace)]
            trims, problem = yield from self._corrections(paces, delays, ready)
            remarks.append(problem)
            if not trims:
                trims = yield from self._stops(paces, delays)
        if trims or self._thoughts % _LOOKS == 0:
            tight = self._too_close({trim.vehicle: trim.factor for trim in trims if trim.to_m_s > 0.0}, _ROOM_S)
            self._conflict = "" if tight is None else f"as they fly now, {tight} of each other"
        self._look_at_meetings({trim.vehicle: trim.factor for trim in trims if trim.to_m_s > 0.0})
        remarks += self._missed.values()
        self._thoughts += 1
        remarks.append(self._conflict)
        delay_s = None if delays is None or not self._together else delays[0]
        if delay_s is not None and self.correct:
            remarks += [_too_early(pace, delay_s) for pace in paces]
        return Advice(tuple(paces), delay_s, self._wind_m_s, trims, tuple(r for r in remarks if r))

    # -- the vehicles -----------------------------------------------------------------------------------------------

    def _state(self, tracked: _Tracked) -> State:
        seen, place = tracked.seen, tracked.place
        if tracked.grounded:
            return "grounded"
        if seen is None or place is None:
            return "unheard"
        if place.leg >= len(tracked.course.waypoints_m) or seen.arrival_s is not None:
            return "arrived"
        if seen.age_s > self.rules.stale_s:
            return "unheard"
        if _on_ground(place):
            return "waiting"
        if not seen.in_mission:
            return "away"
        if place.leg == 0:
            return "climbing"
        if tracked.stopped_s is not None:  # however it sways
            return "paused"
        if tracked.held_s is not None:
            return "holding"
        return "paused" if seen.paused or self._stands(tracked) else "flying"

    def _stands(self, tracked: _Tracked) -> bool:
        """Whether a vehicle has stood still for some time where its mission does not hold it."""
        if tracked.course.model.vehicle_class == "plane":
            return False
        last_s = tracked.moves[-1][0]
        recent = [move for move in tracked.moves if move[0] >= max(last_s - _STILL_S, tracked.freed_s)]
        if last_s - recent[0][0] < 0.8 * _STILL_S:
            return False
        return all(float(np.linalg.norm(velocity)) < _STILL_M_S for _, _, velocity in recent)

    def _goes_on(self, tracked: _Tracked) -> bool:
        """Whether a vehicle that was to stand is seen to fly."""
        assert tracked.seen is not None
        if tracked.stopped_s is None or tracked.seen.paused or tracked.seen.t_s < tracked.due_s:
            return False
        last_s = tracked.moves[-1][0]
        recent = [move for move in tracked.moves if move[0] >= last_s - _STILL_S]
        if last_s - recent[0][0] < 0.8 * _STILL_S:
            return False
        return float(np.linalg.norm(np.mean([move[2] for move in recent], axis=0))) > 0.5 * tracked.course.speed_min_m_s

    def _left_out(self, tracked: _Tracked, pace: Pace) -> str:
        """Return why the others wait no longer for a vehicle; nothing: they do."""
        course, seen = tracked.course, tracked.seen
        if pace.state == "grounded":
            return f"{course.name} does not start: the others fly on without it"
        if seen is None or tracked.stands is None or pace.state in ("arrived", "unheard", "away", "holding"):
            return ""
        if pace.state == "waiting":
            late = seen.t_s > course.start_s + self.rules.start_s
            return f"{course.name} does not lift off: the others wait no longer for it" if late else ""
        if course.model.vehicle_class == "plane" and not seen.paused:
            return ""
        since_s = tracked.overdue_s if tracked.stopped_s is not None else tracked.stands[0]
        if since_s is None or seen.t_s <= since_s + self.rules.stand_s:
            return ""
        return f"{course.name} has stood too long: the others wait no longer for it"

    def _pace(self, tracked: _Tracked) -> Pace:
        course, seen, state = tracked.course, tracked.seen, self._state(tracked)
        if seen is None or tracked.place is None or state == "grounded":
            return Pace(course.name, state, None, course.arrival_s, None, None, None, None, None)
        speed_m_s = None
        if 0 < tracked.place.leg <= len(course.speed_m_s) and not tracked.lost:
            speed_m_s = float(course.speeds(tracked.factor)[tracked.place.leg - 1])
        if state == "arrived":
            at_s = seen.t_s if seen.arrival_s is None else seen.arrival_s
            late_s = at_s - course.arrival_s
            return Pace(course.name, state, late_s, course.arrival_s, at_s, at_s, at_s, None, seen.t_s, fixed=True)
        late_s = lateness_s(course, tracked.place, seen.t_s)
        if not _on_ground(tracked.place):
            if late_s > tracked.least_late_s + _LOST_S:
                tracked.lost_s += late_s - tracked.least_late_s
                tracked.least_late_s = late_s
            tracked.least_late_s = min(tracked.least_late_s, late_s)
        low, high = self._bounds(tracked)
        if state == "flying":
            self._learn(tracked)
        else:
            tracked.before = None
        present_s = self._arrival_s(tracked, tracked.factor)
        earliest_s = latest_s = present_s
        fixed = present_s - seen.t_s <= self.rules.freeze_s or tracked.failures >= self.rules.tries
        if not fixed:
            earliest_s = self._arrival_s(tracked, high)
            if tracked.factor <= high:
                earliest_s = min(present_s, earliest_s)
            latest_s = min(self._arrival_s(tracked, low), course.latest_s(tracked.place, tracked.fastest))
            latest_s = max(present_s, earliest_s, latest_s)
        return Pace(
            course.name,
            state,
            late_s,
            course.arrival_s,
            present_s,
            earliest_s,
            latest_s,
            speed_m_s,
            seen.t_s,
            fixed,
        )

    def _learn(self, tracked: _Tracked) -> None:
        """Compare the time that passed since the last look with what the model takes for the same way."""
        assert tracked.seen is not None
        assert tracked.place is not None
        before = tracked.before
        tracked.before = now = (tracked.seen.t_s, tracked.factor, tracked.place)
        if before is None or before[1] != now[1] or before[0] + 0.5 * self.rules.period_s > now[0]:
            return
        flight, reached_s = self._flight(tracked, tracked.factor)
        _, begin_s = times_at(tracked.course, flight, reached_s, before[2])
        end_s, _ = times_at(tracked.course, flight, reached_s, now[2])
        if end_s > begin_s:
            tracked.ways.append((now[0] - before[0], end_s - begin_s))

    def _flight(
        self, tracked: _Tracked, factor: float, wind_m_s: tuple[float, float] | None = None
    ) -> tuple[Trajectory, FloatArray]:
        """Return the whole flight at scaled speeds from its own start, in the air as it is known if none is given."""
        wind_m_s = self._wind_m_s if wind_m_s is None else wind_m_s
        key = (factor, *wind_m_s)
        found = tracked.flights.get(key)
        if found is None:
            course = tracked.course
            found = timing.predict_flight(
                replace(course.model, wind_m_s=wind_m_s),
                course.home_m,
                course.waypoints_m,
                course.speeds(factor),
                hold_s=course.hold_s,
                end=course.end,
                ground_amsl_m=float(course.planned.position_m[-1, 2]),
            )
            tracked.flights[key] = found
            while len(tracked.flights) > _KEPT_FLIGHTS:
                tracked.flights.popitem(last=False)
        tracked.flights.move_to_end(key)
        return found

    def _arrival_s(self, tracked: _Tracked, factor: float) -> float:
        assert tracked.seen is not None
        flight, reached_s = self._flight(tracked, factor)
        remaining_s = float(reached_s[-1]) - self._now_in_s(tracked, flight, reached_s)
        return self._goes_on_s(tracked) + tracked.slowness * max(remaining_s, 0.0)

    def _goes_on_s(self, tracked: _Tracked) -> float:
        """Return from when on a vehicle flies what is left: from its start on, if that is still to come."""
        assert tracked.seen is not None
        assert tracked.place is not None
        t_s = tracked.seen.t_s
        return max(t_s, tracked.course.start_s) if _on_ground(tracked.place) else t_s

    def _now_in_s(self, tracked: _Tracked, flight: Trajectory, reached_s: FloatArray) -> float:
        """Return when a flight is where the vehicle is now."""
        assert tracked.seen is not None
        assert tracked.place is not None
        come_s, leave_s = times_at(tracked.course, flight, reached_s, tracked.place)
        if tracked.held_s is None:
            return leave_s
        return min(come_s + tracked.seen.t_s - tracked.held_s, leave_s)

    def _ahead(self, tracked: _Tracked, factor: float) -> Trajectory:
        """Return the rest of the flight, to its end, from where the vehicle is now."""
        assert tracked.seen is not None
        assert tracked.place is not None
        flight, reached_s = self._flight(tracked, factor)
        if tracked.place.leg >= len(tracked.course.waypoints_m):
            at_s = tracked.seen.t_s if tracked.seen.arrival_s is None else tracked.seen.arrival_s
            begin_s = float(reached_s[-1]) + max(tracked.seen.t_s - at_s, 0.0)
            slowness = 1.0
        else:
            begin_s = self._now_in_s(tracked, flight, reached_s)
            slowness = tracked.slowness
        later = flight.t_s > begin_s
        t_s = self._goes_on_s(tracked) + slowness * (np.concatenate([[begin_s], flight.t_s[later]]) - begin_s)
        return Trajectory(t_s, np.concatenate([flight.at(begin_s)[None], flight.position_m[later]]))

    def _factor_for(self, tracked: _Tracked, arrival_s: float) -> float:
        """Return the scale of the planned speeds at which a vehicle arrives closest to a time."""
        low, high = self._bounds(tracked)
        late, early = self._arrival_s(tracked, low) - arrival_s, self._arrival_s(tracked, high) - arrival_s
        if late <= 0.0:
            return low
        if early >= 0.0:
            return high
        best = min((abs(late), low), (abs(early), high))
        for _ in range(12):
            # the secant of time over pace, which is nearly straight, kept away from the ends
            share = min(0.95, max(0.05, late / (late - early)))
            factor = 1.0 / ((1.0 - share) / low + share / high)
            miss = self._arrival_s(tracked, factor) - arrival_s
            best = min(best, (abs(miss), factor))
            if abs(miss) < _NEAR_S:
                break
            if miss > 0.0:
                low, late = factor, miss
            else:
                high, early = factor, miss
        return best[1]

    # -- the air ----------------------------------------------------------------------------------------------------

    def _wind(self) -> tuple[float, float]:
        expected = self._tracked[0].course.model.wind_m_s
        wind = steady_wind([gust for tracked in self._tracked for gust in tracked.felt], expected)
        # in steps, so that flights predicted before can be used again
        near = np.abs(wind - np.array(self._wind_m_s)) < 0.15
        east, north = np.where(near, self._wind_m_s, np.round(wind, 1))
        return float(east), float(north)

    def _feel(self, tracked: _Tracked, seen: Sighting) -> None:
        """Take note of a steady motion in the middle of a leg."""
        course, leg = tracked.course, seen.waypoint
        if not (seen.in_mission and 0 < leg < len(course.waypoints_m)) or tracked.lost or seen.paused:
            return
        if tracked.felt and seen.t_s < tracked.felt[-1].t_s + _GUST_EVERY_S:
            return
        if seen.t_s < tracked.due_s:  # it may still be taking up the speed last commanded
            return
        recent = [move for move in tracked.moves if move[0] >= seen.t_s - _STEADY_S]
        if seen.t_s - recent[0][0] < 0.7 * _STEADY_S or any(move[1] != leg for move in recent):
            return
        velocity = np.array([move[2][:2] for move in recent])
        mean = velocity.mean(axis=0)
        if float(np.abs(velocity - mean).max()) > _STEADY_M_S:
            return
        from_m, to_m = course.waypoints_m[leg - 1], course.waypoints_m[leg]
        if min(math.dist(seen.position_m[:2], from_m[:2]), math.dist(seen.position_m[:2], to_m[:2])) < _FROM_CORNERS_M:
            return
        speed = float(np.hypot(*mean))
        if speed < 2.0 * _STILL_M_S:
            return
        commanded = float(course.speeds(tracked.factor)[leg - 1])
        airspeed = airspeed_max_m_s(course.model, float(seen.position_m[2]), commanded)
        expected = self._expected_m_s(tracked, place_of(course, leg, seen.position_m))
        tight = course.model.vehicle_class == "plane" or speed < min(expected, airspeed) - _HELD_UP_M_S
        tracked.felt.append(Gust(seen.t_s, (float(mean[0]), float(mean[1])), airspeed, tight))
        while tracked.felt[0].t_s < seen.t_s - _AIR_MEMORY_S:
            tracked.felt.popleft()

    def _expected_m_s(self, tracked: _Tracked, place: Place) -> float:
        """Return how fast over ground a vehicle would be at a place in the wind that was planned for."""
        flight, reached_s = self._flight(tracked, tracked.factor, tracked.course.model.wind_m_s)
        at_s, _ = times_at(tracked.course, flight, reached_s, place)
        before_m, after_m = flight.at(np.array([at_s - 0.5, at_s + 0.5]))
        return math.dist(before_m[:2], after_m[:2])

    # -- the fleet --------------------------------------------------------------------------------------------------

    def _delays(self, awaited: Sequence[Pace], paces: Sequence[Pace]) -> list[float] | None:
        """Return by how much each shall arrive later than planned; None: nobody is left to be brought together."""
        taking_part = [p for p in awaited if p.arrival_s is not None and p.state not in ("away", "unheard")]
        if all(p.state == "arrived" for p in taking_part):
            return None
        if not self._together:
            windows = [(_less(p.earliest_s, p), _less(p.latest_s, p)) for p in paces]
            return [common_delay([window]) for window in windows]
        fixed = [p for p in taking_part if p.fixed]
        free = [(_less(p.earliest_s, p), _less(p.latest_s, p)) for p in taking_part if not p.fixed]
        return [common_delay(free, [_less(p.arrival_s, p) for p in fixed])] * len(paces)

    def _corrections(
        self, paces: Sequence[Pace], delays: Sequence[float], ready: Sequence[int]
    ) -> Generator[None, None, tuple[tuple[Trim, ...], str]]:
        """Return the speeds to command, all remaining flights under them proven apart, or what stands against it."""
        wanting = [k for k in ready if self._misses(paces[k], delays[k]) or self._tracked[k].lost]
        if not wanting:
            return (), ""
        needed_s = self._needed_slack_s()
        problem = ""
        for shift_s in (0.0, *_ELSEWHERE_S):
            factors: dict[int, float] = {}
            for k in wanting if shift_s == 0.0 else ready:
                factors[k] = self._factor_for(self._tracked[k], _target_s(paces[k], delays[k] + shift_s))
                yield
            tight = self._too_close(factors, needed_s)
            if tight is None:
                trims = [self._trim(k, factors[k], paces[k], delays[k] + shift_s) for k in factors]
                return tuple(trim for trim in trims if trim is not None), problem
            if not problem:
                problem = f"arriving {delays[wanting[0]]:+.0f} s from the plan would bring {tight}"
        return (), f"{problem}, and so would what was tried instead: speeds are left as they are"

    def _stops(self, paces: Sequence[Pace], delays: Sequence[float]) -> Generator[None, None, tuple[Trim, ...]]:
        """Return who is to stop because it cannot fly slowly enough, proven apart."""
        if not self.hold:
            return ()
        for k, pace in enumerate(paces):
            tracked = self._tracked[k]
            model = tracked.course.model
            # PX4 knows no pause that it goes on from by command, planes circle where nothing is proven
            if model.autopilot != "ardupilot" or model.vehicle_class != "copter" or not self._may_trim(k, pace):
                continue
            assert pace.latest_s is not None
            assert pace.at_s is not None
            early_s = pace.planned_s + delays[k] - pace.latest_s
            if early_s <= self.rules.hold_s:
                continue
            wait_s = self._wait_s(tracked, pace, delays[k])
            yield
            if (
                wait_s > 0.0
                and pace.latest_s - pace.at_s < self.rules.hold_before_s + 2.0 * wait_s
                and self._too_close({}, self._needed_slack_s(), {k: wait_s}) is None
            ):
                speed_m_s = float(tracked.course.speeds(tracked.factor)[self._leg(tracked)])
                why = f"would arrive {early_s:.0f} s early even at its least speed"
                return (Trim(k, pace.name, speed_m_s, 0.0, tracked.factor, why, stop_s=wait_s),)
        return ()

    def _going_on(self, paces: Sequence[Pace], delays: Sequence[float] | None) -> tuple[tuple[Trim, ...], str]:
        """Return who has stood long enough, and what keeps it from going on."""
        for k, pace in enumerate(paces):
            tracked = self._tracked[k]
            if tracked.stopped_s is None or pace.state != "paused" or pace.at_s is None:
                continue
            asked = tracked.overdue_s is not None  # already: then again after the interval, not before
            if pace.at_s < (tracked.due_s if asked else min(tracked.due_s, tracked.stopped_s)):
                continue
            wait_s = 0.0 if delays is None else self._wait_s(tracked, pace, delays[k])
            tracked.stopped_s = pace.at_s + wait_s
            if wait_s > 0.0:
                continue
            tracked.overdue_s = pace.at_s if tracked.overdue_s is None else tracked.overdue_s
            tight = self._too_close({}, _ROOM_S, going_on=k)
            if tight is not None:
                return (), f"{pace.name} stands longer: going on now would bring {tight}"
            speed_m_s = float(tracked.course.speeds(tracked.factor)[self._leg(tracked)])
            return (Trim(k, pace.name, 0.0, speed_m_s, tracked.factor, "has stood long enough"),), ""
        return (), ""

    def _wait_s(self, tracked: _Tracked, pace: Pace, delay_s: float) -> float:
        """Return how long a vehicle must stand so that it arrives in time a little above its least speed.

        What is left then, above and below, is for corrections after it.
        """
        low, high = self._bounds(tracked)
        then_s = self._arrival_s(tracked, min(_AFTER_A_STOP * low, high))
        assert tracked.place is not None
        return min(pace.planned_s + delay_s, tracked.course.latest_s(tracked.place)) - then_s

    def _leg(self, tracked: _Tracked) -> int:
        """Return which of the speeds a vehicle flies at."""
        assert tracked.place is not None
        return tracked.place.leg - 1

    def _bounds(self, tracked: _Tracked) -> tuple[float, float]:
        """Return the least and the greatest scale at which the rest of a flight stays on its proven way.

        In the air as it is known. A copter that leans as far as it may has nothing left against a wind from the side; a
        plane's turns are wider the faster it flies, and it was proven around its planned flight.
        """
        low, high = self._steady_bounds(tracked)
        # who flies faster than its battery lasts now, for the time that it has lost, is to slow down
        return low, max(min(high, tracked.course.greatest(tracked.lost_s)), 1.0, low)

    def _steady_bounds(self, tracked: _Tracked) -> tuple[float, float]:
        course = tracked.course
        low, high = course.factors
        plane = course.model.vehicle_class == "plane"
        if math.isinf(course.deviation_m) or (not plane and self._wind_m_s == (0.0, 0.0)):
            return low, high
        if tracked.bounds is None or tracked.bounds[0] != self._wind_m_s:
            if plane:
                slower = takewhile(lambda scale: self._on_its_way(tracked, scale), np.linspace(1.0, low, _TRIED)[1:])
                faster = takewhile(lambda scale: self._on_its_way(tracked, scale), np.linspace(1.0, high, _TRIED)[1:])
                found = min([1.0, *map(float, slower)]), max([1.0, *map(float, faster)])
            else:
                tries = np.linspace(high, low, _TRIED)
                found = low, next((float(scale) for scale in tries if self._on_its_way(tracked, float(scale))), low)
            tracked.bounds = (self._wind_m_s, found)
        low, high = tracked.bounds[1]
        return min(low, tracked.factor), max(high, min(tracked.factor, course.factors[1]))

    def _on_its_way(self, tracked: _Tracked, scale: float) -> bool:
        course = tracked.course
        plane = course.model.vehicle_class == "plane"
        line = np.concatenate([course.home_m[None], course.waypoints_m])
        if plane:
            line = course.planned.position_m[::_SPARSE]
        ahead = self._ahead(tracked, scale)
        until = max(int(np.searchsorted(ahead.t_s, self._arrival_s(tracked, scale))), 1)
        flown = Trajectory(ahead.t_s[:until:_SPARSE], ahead.position_m[:until:_SPARSE])
        allowed_m = (_PLANE_STRAYS if plane else _COPTER_STRAYS) * course.deviation_m
        return off_legs_m(flown, np.stack([line[:-1], line[1:]], axis=1)) <= allowed_m

    def _look_at_meetings(self, factors: Mapping[int, float]) -> None:
        """Take note of meetings that are missed under new scales, for good: nobody is to be told again."""
        for meeting in self.meetings:
            times_s = {
                self._tracked[k].course.name: self._there_s(self._tracked[k], waypoint, factors.get(k))
                for k, waypoint in meeting.waypoints.items()
            }
            known = {name: t_s for name, t_s in times_s.items() if t_s is not None}
            if meeting.name in self._missed or len(known) < 2:
                continue
            first, last = min(known, key=lambda name: known[name]), max(known, key=lambda name: known[name])
            if known[last] - known[first] > self.rules.meeting_s:
                self._missed[meeting.name] = (
                    f"rendezvous {meeting.name} is missed by more than {self.rules.meeting_s:g} s: {first} is there "
                    f"before {last}; corrections keep the arrivals together, not meetings on the way"
                )

    def _there_s(self, tracked: _Tracked, waypoint: int, factor: float | None) -> float | None:
        """Return when a vehicle was, or will be, at a waypoint; None: nobody knows."""
        if waypoint in tracked.reached_s:
            return tracked.reached_s[waypoint]
        place = tracked.place
        if tracked.seen is None or place is None or place.leg > waypoint or self._state(tracked) in _NOWHERE:
            return None
        if place.leg == waypoint and tracked.held_s is not None:
            return tracked.held_s
        flight, reached_s = self._flight(tracked, tracked.factor if factor is None else factor)
        stands_s = 0.0 if tracked.stopped_s is None else max(tracked.stopped_s - tracked.seen.t_s, 0.0)
        remaining_s = max(float(reached_s[waypoint]) - self._now_in_s(tracked, flight, reached_s), 0.0)
        return self._goes_on_s(tracked) + stands_s + tracked.slowness * remaining_s

    def _may_trim(self, k: int, pace: Pace) -> bool:
        tracked = self._tracked[k]
        return (
            pace.state == "flying"
            and tracked.failures < self.rules.tries
            and pace.at_s is not None
            and pace.at_s >= tracked.due_s
            and pace.arrival_s is not None
            and pace.arrival_s - pace.at_s > self.rules.freeze_s
        )

    def _misses(self, pace: Pace, delay_s: float) -> bool:
        assert pace.arrival_s is not None
        assert pace.at_s is not None
        band_s = max(self.rules.band_s, self.rules.band_share * (pace.arrival_s - pace.at_s))
        return abs(pace.arrival_s - _target_s(pace, delay_s)) > band_s

    def _trim(self, k: int, factor: float, pace: Pace, delay_s: float) -> Trim | None:
        tracked = self._tracked[k]
        assert tracked.place is not None
        assert pace.arrival_s is not None
        leg = tracked.place.leg - 1
        course = tracked.course
        now_m_s = float(course.speeds(tracked.factor)[leg])
        then_m_s = round(float(course.speeds(factor)[leg]) / SPEED_STEP_M_S) * SPEED_STEP_M_S
        then_m_s = min(max(then_m_s, course.speed_min_m_s), course.speed_max_m_s)
        if abs(then_m_s - now_m_s) < 2.0 * SPEED_STEP_M_S and not tracked.lost:
            return None
        miss_s = pace.arrival_s - _target_s(pace, delay_s)
        if abs(miss_s) < _LITTLE_S and abs(then_m_s / now_m_s - 1.0) > _MUCH and not tracked.lost:
            return None  # what is left hardly depends on its speed: steep, or against the wind
        why = f"would arrive {abs(miss_s):.1f} s {'late' if miss_s > 0.0 else 'early'}"
        if abs(delay_s) >= 0.5:
            why += f"; all {abs(delay_s):.0f} s {'later' if delay_s > 0.0 else 'earlier'} than planned"
        if tracked.lost:
            why = "flies at a speed of its own again"
        return Trim(k, course.name, now_m_s, then_m_s, factor, why)

    def _needed_slack_s(self) -> float:
        """Return how early or late any one may be in corrected flights.

        What the mission asks for; and a few seconds, unless the planned flights leave less.
        """
        if self._slack_s is None:
            slacks = timing.least_slack(
                [tracked.course.planned for tracked in self._tracked], self._required_m, self.rules.lateness_s
            )
            self._slack_s = slacks[0].slack_s if slacks else self.rules.lateness_s
        return max(self._lateness_s, min(self.rules.lateness_s, 0.9 * self._slack_s))

    def _too_close(
        self,
        factors: Mapping[int, float],
        needed_s: float,
        stops_s: Mapping[int, float] | None = None,
        going_on: int | None = None,
    ) -> str | None:
        """Return who would come too close to whom under new scales; None: all keep apart, with room in time.

        Vehicles in ``stops_s`` stand still for so long first; ``going_on`` stands no more.
        """
        flights: list[Trajectory] = []
        whose: list[int] = []
        for k, tracked in enumerate(self._tracked):
            if tracked.grounded:
                whose.append(k)
                stands_m = tracked.course.home_m if tracked.seen is None else tracked.seen.position_m
                flights.append(Trajectory(np.zeros(1), np.array(stands_m, dtype=float)[None]))
                continue
            if tracked.seen is None:
                continue
            whose.append(k)
            ahead = self._ahead(tracked, factors.get(k, tracked.factor))
            stopped_s = 0.0 if tracked.stopped_s is None else tracked.stopped_s - tracked.seen.t_s
            flights.append(_after_stop(ahead, (stops_s or {}).get(k, stopped_s)))
            unsure = tracked.stopped_s is not None and tracked.failures > 0  # whether it stands, and until when
            if unsure and k != going_on:
                whose.append(k)
                flights.append(ahead)
            still = tracked.stopped_s is None and self._state(tracked) in ("waiting", "paused")  # nobody knows how long
            if (still or unsure) and k != going_on:
                whose.append(k)
                position_m = np.array(tracked.seen.position_m, dtype=float)
                flights.append(Trajectory(np.array([tracked.seen.t_s]), position_m[None]))

        def required_m(one: int, other: int) -> float:
            i, j = whose[one], whose[other]
            return 0.0 if i == j else self._required_m(i, j)

        for tight in timing.least_slack(flights, required_m, needed_s)[:1]:
            if tight.slack_s < needed_s - 1e-9:
                i, j = whose[tight.first], whose[tight.second]
                names = f"{self._tracked[i].course.name} and {self._tracked[j].course.name}"
                return f"{names} within {self._required_m(i, j):g} m"
        return None

    def _remark(self, pace: Pace, *, stopped: bool) -> str:
        match pace.state:
            case "away":
                return (
                    f"{pace.name} has left its mission: no speeds are commanded, "
                    "for its way home was proven against the planned flights"
                )
            case "unheard":
                return f"{pace.name} is not heard: no speeds are commanded"
            case "paused" if not stopped:
                return f"{pace.name} stands still"
            case _:
                return ""


def _after_stop(flight: Trajectory, stop_s: float) -> Trajectory:
    """Return a flight that stands still for a while before it begins."""
    if stop_s <= 0.0:
        return flight
    t_s = np.concatenate([flight.t_s[:1], flight.t_s + stop_s])
    return Trajectory(t_s, np.concatenate([flight.position_m[:1], flight.position_m]))


def _too_early(pace: Pace, delay_s: float) -> str:
    if pace.state != "flying" or pace.latest_s is None or pace.latest_s > pace.planned_s + delay_s - _TOLD_S:
        return ""
    return f"{pace.name} is too early even at its least speed: others need longer"


def _leg_from(tracked: _Tracked) -> int:
    """Return the leg from which a speed counts that is commanded now; 0: before any."""
    return 0 if tracked.place is None else min(tracked.place.leg, len(tracked.course.speed_m_s))


def _target_s(pace: Pace, delay_s: float) -> float:
    """Return when a vehicle shall arrive: with the others, as far as it can."""
    assert pace.earliest_s is not None
    assert pace.latest_s is not None
    return min(max(pace.planned_s + delay_s, pace.earliest_s), pace.latest_s)


def _less(at_s: float | None, pace: Pace) -> float:
    return 0.0 if at_s is None else at_s - pace.planned_s


def common_delay(windows_s: Sequence[tuple[float, float]], fixed_s: Sequence[float] = ()) -> float:
    """Return the delay of all: none if it lies within all windows (earliest, latest), else the least that all can make.

    Who has arrived, or can no longer be changed, is joined as well as possible. Where windows do not meet, those who
    cannot be so late are early.
    """
    earliest = max((window[0] for window in windows_s), default=-math.inf)
    latest = min((window[1] for window in windows_s), default=math.inf)
    wanted = sum(fixed_s) / len(fixed_s) if fixed_s else min(0.0, latest)
    return max(earliest, wanted)
