"""What the planner produces: a plan for every vehicle, and for the fleet; and what a flight of it recorded.

Positions are in the mission's local frame: x east, y north, z altitude AMSL, all in metres.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from missionplanner.certificate import Certificate
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.mission import Mission
from missionplanner.vehicle import Autopilot, Ending, MotionModel, VehicleClass


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Positions over time, linear between samples: ``t_s`` (S,) rising from mission start, ``position_m`` (S, 3)."""

    t_s: FloatArray
    position_m: FloatArray

    def at(self, t_s: FloatArray | float) -> FloatArray:
        """Return positions (..., 3) at times (...); before the start and after the end the vehicle stands still."""
        t = np.asarray(t_s, dtype=float)
        return np.stack([np.interp(t, self.t_s, self.position_m[:, k]) for k in range(3)], axis=-1)


PHOTO_S = 1.0
"""How long a vehicle that stands still at a place goes on doing so for each photo; whole seconds."""

_FAR_M = 10_000.0


@dataclass(frozen=True, slots=True)
class Action:
    """What a vehicle does on the way to a place of its route, and there: stand still, then take photos."""

    name: str = ""  # what reports call the place, e.g. T01.left
    inspects: str = ""  # the tower or span that is looked at
    hold_s: float = 0.0  # whole seconds
    look_at_m: tuple[float, float, float] | None = None  # the camera points there
    look_deg: tuple[float, float] | None = (
        None  # or that way: heading clockwise from true north, pitch above the horizon
    )
    photos: int = 0  # there, after the hold
    photo_every_m: float = 0.0  # on the way; 0: none

    @property
    def stand_s(self) -> float:
        """How long the vehicle stands still there in all: the hold, then the photos; 0: it flies through."""
        return self.hold_s + PHOTO_S * self.photos if self.hold_s > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that is done between two waypoints: in a vehicle's mission, one item.

    ``aim`` the camera at a place, ``release`` it to where it looks by itself, ``trigger`` a photo every so many metres
    (0: no more), take ``photos``, ``stand`` still for so many seconds.
    """

    what: Literal["aim", "release", "trigger", "photos", "stand"]
    amount: float = 0.0  # metres, photos or seconds
    at_m: tuple[float, float, float] | None = None  # to aim


@dataclass(frozen=True, slots=True)
class Clearance:
    """The least distance kept to one kind of thing: how much, to what, and where.

    Of a plan, what its whole tube keeps at least, by proof; between vehicles, the distance of predicted flights.
    """

    distance_m: float  # to the thing itself; for terrain: height above the ground
    required_m: float
    what: str  # "terrain", an obstacle's or a vehicle's name, "fence"
    position_m: tuple[float, float, float]  # on the path; for a plan's terrain, in its tube
    t_s: float | None = None  # for fellows: when

    @property
    def ok(self) -> bool:
        """Whether the distance is at least the required one (to a micrometre)."""
        return self.distance_m >= self.required_m - 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class VehiclePlan:
    """One vehicle's way: from home straight up to ``waypoints_m[0]``, along straight legs to the last, then its end.

    ``path_m`` (S, 3) is the smooth curve that the legs follow within the mission's waypoint tolerance. Arrival is the
    time at which the last waypoint, the goal, is reached.
    """

    name: str
    sysid: int
    autopilot: Autopilot
    vehicle_class: VehicleClass
    motion: MotionModel
    home_m: FloatArray  # (3,), on the ground
    path_m: FloatArray  # (S, 3)
    waypoints_m: FloatArray  # (W, 3); the first is the top of the take-off
    end: Ending
    length_m: float  # of path_m
    speeds_m_s: FloatArray  # (W - 1,) commanded along the leg to each waypoint but the first
    hold_s: FloatArray  # (W - 1,) whole seconds to stand still there
    start_delay_s: float
    window_s: tuple[float, float]  # of the arrival, fastest and slowest, without delay (eq. 10)
    arrival_s: float  # predicted, delay included
    reached_s: FloatArray  # (W,) predicted times at the waypoints, delay included
    trajectory: Trajectory  # predicted flight, from mission start to touch-down
    cost: float
    cost_terms: dict[str, float]  # unweighted price of path_m, term by term
    history: FloatArray  # (G,) best cost per iteration
    evaluations: int
    clearances: tuple[Clearance, ...]  # least to terrain, and to the nearest obstacle or fence if there is any
    # by waypoint; where there is any, all stops and the goal have one, if of nothing: it holds on the whole way there
    actions: Mapping[int, Action] = field(default_factory=dict)

    def steps(self) -> tuple[tuple[tuple[Step, ...], tuple[Step, ...]], ...]:
        """Return what is done before each waypoint (W) is flown to, and at it; nothing that is so already.

        A direction to look in is a place far off that way: autopilots know places in the earth's frame, but directions
        only in whole degrees, of the vehicle's, or not for gimbals that cannot turn (seen from half of a leg of 300 m
        away it is within a degree).
        """
        steps: list[tuple[tuple[Step, ...], tuple[Step, ...]]] = [((), ())] * len(self.waypoints_m)
        aimed: tuple[float, float, float] | None = None
        every_m = 0.0
        begin = 0
        for end, action in sorted(self.actions.items()):
            before: list[Step] = []
            aim = self._aim(action, begin, end)
            if aim != aimed:
                before.append(Step("release") if aim is None else Step("aim", at_m=aim))
            if action.photo_every_m != every_m:
                before.append(Step("trigger", action.photo_every_m))
            aimed, every_m = aim, action.photo_every_m
            at = [Step("photos", float(action.photos))] if action.photos > 0 else []
            if action.hold_s > 0.0:
                at = [Step("photos", 1.0), Step("stand", PHOTO_S)] * action.photos
            steps[begin + 1] = (tuple(before), steps[begin + 1][1])
            steps[end] = (steps[end][0], tuple(at))
            begin = end
        return tuple(steps)

    def _aim(self, action: Action, begin: int, end: int) -> tuple[float, float, float] | None:
        """Return what is aimed at on the way between two waypoints and at the second; None: nothing."""
        if action.look_deg is None:
            return action.look_at_m
        heading_rad, pitch_rad = np.radians(action.look_deg)
        level = np.cos(pitch_rad)
        toward = np.array([level * np.sin(heading_rad), level * np.cos(heading_rad), np.sin(pitch_rad)])
        from_m = self.waypoints_m[end]
        if action.photo_every_m > 0.0:
            from_m = 0.5 * (self.waypoints_m[begin] + from_m)
        x, y, z = np.round(from_m + _FAR_M * toward, 3).tolist()
        return x, y, z

    @property
    def speed_m_s(self) -> float:
        """The greatest speed commanded: that of all legs, unless meetings on the way ask for others."""
        return float(self.speeds_m_s.max())


@dataclass(frozen=True, slots=True)
class Resolution:
    """How a vehicle was kept apart from another, or kept from being too early."""

    vehicle: str
    other: str  # whom it would have met; empty where it only lost time
    t_s: float  # when
    how: Literal["speed", "start", "altitude", "way", "detour"]
    detail: str


@dataclass(frozen=True, slots=True, eq=False)
class FleetPlan:
    """The whole fleet's plan."""

    mission: Mission
    frame: LocalFrame
    vehicles: tuple[VehiclePlan, ...]
    arrival_s: float | None  # common arrival, None where the mission does not ask for it
    separation: Clearance | None  # least between any two predicted trajectories; None for a single vehicle
    seed: int
    software_version: str
    input_sha256: str  # of the mission and its terrain
    certificate: Certificate | None = None  # of the missions as planned; None: nothing is proven yet
    resolutions: tuple[Resolution, ...] = ()  # in the order in which they were found


@dataclass(frozen=True, slots=True)
class Correction:
    """A speed that was commanded while flying."""

    vehicle: str
    t_s: float  # since the fleet's common start
    from_m_s: float
    to_m_s: float
    why: str
    obeyed: bool  # as the vehicle answered


@dataclass(frozen=True, slots=True, eq=False)
class Lateness:
    """How late a vehicle was at times (N,): than planned where it was, and when it was predicted to arrive."""

    t_s: FloatArray
    lateness_s: FloatArray
    arrival_s: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FlownVehicle:
    """What was recorded of one vehicle: positions over time since the fleet's common start."""

    name: str
    sysid: int
    trajectory: Trajectory
    arrival_s: float | None  # at the goal; None: never arrived
    landed_s: float | None
    due_after_s: float = 0.0  # how long after the first of the fleet it was due to arrive
    lateness: Lateness | None = None  # where it was watched


@dataclass(frozen=True, slots=True)
class FlownMeeting:
    """When vehicles were at the place of a rendezvous, since the fleet's common start; None: never, or not known."""

    name: str
    times_s: dict[str, float | None]

    @property
    def spread_s(self) -> float | None:
        """Latest minus earliest; None when somebody was not there."""
        known = [t_s for t_s in self.times_s.values() if t_s is not None]
        return max(known) - min(known) if len(known) == len(self.times_s) else None


OrderResult = Literal["obeyed", "refused", "silent", "grounded"]


@dataclass(frozen=True, slots=True)
class Ordered:
    """What came of an operator's order to one vehicle; ``words`` say it as a whole."""

    vehicle: str
    order: Literal["pause", "resume", "rtl", "land"]
    t_s: float | None  # since the fleet's common start; None: before any position of it
    result: OrderResult  # silent: it did not answer; grounded: it did not fly
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class FleetFlight:
    """A recorded flight of a fleet plan."""

    vehicles: tuple[FlownVehicle, ...]
    corrections: tuple[Correction, ...] = ()
    meetings: tuple[FlownMeeting, ...] = ()  # where it was watched
    orders: tuple[Ordered, ...] = ()  # in the order in which they were given

    @property
    def arrival_spread_s(self) -> float | None:
        """Latest minus earliest arrival, each less what it was due later; None when somebody did not arrive."""
        arrivals = [None if v.arrival_s is None else v.arrival_s - v.due_after_s for v in self.vehicles]
        known = [a for a in arrivals if a is not None]
        return max(known) - min(known) if len(known) == len(arrivals) else None
