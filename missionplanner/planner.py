"""The orchestrator: a scene becomes a fleet plan.

Vehicles are planned one after the other, each pricing the ways of those before it; then all are timed together
(:mod:`.schedule`, PAPER.md eq. 10) and their predicted flights held against each other (eq. 9). Of two who come too
close, one passes at another speed or starts later, if that keeps them well apart in time and makes the fleet hardly
later; else one is planned again around the other's flight. Then the heights at which they return are chosen, and all
of it is proven (:mod:`.proof`); who is not proven is planned again with more room. What is returned has a certificate;
else nothing is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Literal, Protocol

import numpy as np

from missionplanner import __version__, energy, obstacles, proof, returns, timing, wind
from missionplanner.certificate import Finding
from missionplanner.clearance import Margins, distance_to_legs_m, polyline_legs, tubes_clear
from missionplanner.cost import THREADS, Price
from missionplanner.errors import InfeasibleError, MissionError, MissionPlannerError
from missionplanner.geodesy import FloatArray
from missionplanner.kernels import SpaceArrays
from missionplanner.obstacles import CableSolid, CylinderSolid, Solid
from missionplanner.path import evenly, length_m
from missionplanner.path_search import Budget, Clock, Guesses, Piece, PlannedPath, find_way, guess, pieces_of
from missionplanner.plan import Action, FleetPlan, Resolution, Trajectory, VehiclePlan
from missionplanner.proof import Conflict
from missionplanner.returns import Returning, UnreturnableError
from missionplanner.scene import Scene, Towers, VehicleTask
from missionplanner.schedule import Flier, Meeting, Schedule, TooEarlyError, arrange
from missionplanner.waypoints import passes

_FELLOW_INSTANTS, _FELLOW_INSTANTS_LEAST = 128, 8
_FELLOW_SLACK_M = 2.0
_SEARCH_SHARE = 0.7
"""Of the time that is left for a search: what parts vehicles afterwards takes time as well."""
_ROUNDS = 24
_AVOID_S = 20.0
"""How long before and after a conflict the other's flight is kept clear of."""
_SHIFTS_S = (5.0, -5.0, 10.0, -10.0, 15.0, -15.0, 25.0, -25.0, 40.0)
"""How much later or earlier a vehicle may pass where it would meet another."""
_AFTER_STANDING_S = (5.0, 10.0, 20.0, -5.0)
"""How much longer than one of them stands still there it passes later, or how much less."""
_LATER_S = 3.0
_LATER_MAX_S = 60.0
"""By how much the fleet may arrive later for that: rather than flying around each other, and where there is no way."""
_AROUND_S = 60.0
_OFF_S = 3.0
"""Who is parted by time alone keeps apart even if one is this much early or late."""
_PACES = 13
_DETOURS = 8
_DETOUR_SHARE = 1.05
_DETOUR_ROOM_M = 5.0
_BENDS = (1, 2, 3, 4, 6, 8)
_STARTS = 3
_PROOFS = 4
_MENDS, _MENDED_PIECES = 8, 16
"""How often vehicles are planned again that cannot return; as often again for every so many pieces of their ways."""
_ROOM_M = 1.0
"""How much further off a vehicle is planned again that was not proven, beyond what it lacked."""
_GENTLER, _GENTLEST_RAD = 0.7, math.radians(2.0)
"""How steeply a plane that was not proven climbs then, of how it did: a weak one lags behind a climb that is steep."""
_AT_THE_SAME_M = 1.0
_BESIDE_S = 2.0
"""How long before and after a piece of a flight it is looked at, to know how it moves there."""
_STORED_M = 0.1
"""Room that pieces leave on the ways home: autopilots round altitudes that they store, which is proven as well."""
_ROUTE_ROOM_M = 5.0
"""What the way around another's flight leaves of room at the route's own points, beyond the margin."""


Searched = Callable[[PlannedPath], None]


class UnprovenError(InfeasibleError):
    """A plan was found, and ``problems`` of it are not proven."""

    def __init__(self, problems: Sequence[Finding]) -> None:
        super().__init__(f"not proven: {'; '.join(map(str, problems))}")
        self.problems = tuple(problems)


class Watch(Protocol):
    """Told how the work goes on: the vehicle's name and the share of its search that is done, 0 to 1."""

    def __call__(self, vehicle: str, done: float) -> None:
        """Take the news."""


def plan_fleet(
    scene: Scene,
    *,
    seed: int | None = None,
    watch: Watch | None = None,
    seconds: float | None = None,
    clock: Clock | None = None,
    searched: Searched | None = None,
) -> FleetPlan:
    """Return a plan for the whole fleet that is clear of terrain, obstacles, fence and itself.

    The same scene and seed give the same plan, bit for bit, unless ``seconds`` bound the search: then how good it
    becomes depends on the machine, too. ``seed`` and ``seconds`` default to the mission's.

    Parameters
    ----------
    seconds
        For how long the paths are improved, beyond the search that every plan takes.
    clock
        Counts them, as ``time.perf_counter`` does; without one, the mission's are not taken.
    searched
        Told of every path that is found, with what it took by ``clock``; also of those that give way to another later.

    Raises
    ------
    InfeasibleError
        No such plan was found; the message names the vehicles, and what blocks them or keeps them from arriving
        together.
    """
    wind.refuse_storm(scene.tasks)
    seed = scene.mission.planner.seed if seed is None else seed
    if seconds is not None and clock is None:
        raise MissionError("seconds: expected a clock with them, got none: add clock=time.perf_counter")
    seconds = scene.mission.planner.seconds if seconds is None else seconds
    if seconds is not None and not seconds > 0.0:
        raise MissionError(f"seconds: expected above 0, got {seconds:g}")
    budget = Budget() if clock is None else Budget(clock, -math.inf if seconds is None else clock() + seconds)
    for start in range(_STARTS - 1):
        try:
            return _proven(_Team(scene, seed, start, watch, budget, searched))
        except UnreturnableError:  # who gives way to whom decides who can return: once more, the other way round
            continue
    return _proven(_Team(scene, seed, _STARTS - 1, watch, budget, searched))


def _proven(team: _Team) -> FleetPlan:
    """Return the team's plan with its certificate."""
    problems: tuple[Finding, ...] = ()
    for _ in range(_PROOFS):
        plan = proof.checked(*team.apart())
        assert plan.certificate is not None
        problems = plan.certificate.problems
        if not problems:
            return plan
        if not team.give_room(problems):
            break
    raise UnprovenError(problems)


@dataclass(frozen=True, slots=True)
class _Pin:
    """A time at which one vehicle passes one of its waypoints, so that it does not meet another."""

    index: int
    waypoint: int
    t_s: float


class _Team:
    """The vehicles' paths while a plan is looked for, and what each has learned to keep clear of."""

    def __init__(
        self, scene: Scene, seed: int, start: int, watch: Watch | None, budget: Budget, searched: Searched | None
    ) -> None:
        self._scene = scene
        self._seed = seed
        self._start = start
        self._watch = watch
        self._searched = searched
        self._budget = budget
        self._generators = np.random.default_rng(seed if start == 0 else [seed, start]).spawn(len(scene.tasks))
        self._wider_m: list[dict[int, float]] = [{} for _ in scene.tasks]  # by piece of the way
        self._climb_rad = [task.limits.climb_angle_rad for task in scene.tasks]
        cuts = sum(len(pieces_of(task)) - 1 for task in scene.tasks)
        self._mends = _MENDS * (1 + cuts // _MENDED_PIECES)
        # from which ways, and pieces of ways at which speeds, vehicles are known to return by themselves
        self._returning: set[tuple[PlannedPath, Schedule]] = set()
        self._fine: set[tuple[PlannedPath, tuple[float, ...]]] = set()
        self._overhead = _overhead(scene)
        self._avoided: list[list[Solid]] = [[] for _ in scene.tasks]
        self._detours: list[dict[int, FloatArray]] = [{} for _ in scene.tasks]
        self._delays_s = [index * scene.mission.fleet.launch_interval_s for index in range(len(scene.tasks))]
        self._pins: list[_Pin] = []
        self._resolutions: list[Resolution] = []
        self._paths: list[PlannedPath] = []
        for index, guesses in enumerate(_guesses(scene, self._overhead, budget.clock)):
            self._paths.append(self._path(index, [], self._paths, guesses))

    def _path(
        self,
        index: int,
        avoided: Sequence[Solid],
        fellows: Sequence[PlannedPath],
        guesses: Guesses | None = None,
        again: Collection[int] | None = None,
    ) -> PlannedPath:
        """Return a vehicle's path; ``again``: only these pieces of its way are searched, the others stay."""
        task = self._scene.tasks[index]
        detours = self._detours[index]
        for after in sorted(detours, reverse=True):
            before, after_m = task.route_m[: after + 1], task.route_m[after + 1 :]
            later = len(detours[after])
            actions = {k if k <= after else k + later: action for k, action in task.actions.items()}
            task = replace(task, route_m=np.concatenate([before, detours[after], after_m]), actions=actions)
        # the first plan's time is shared by those who have no path yet
        waiting = max(1, len(self._scene.tasks) - len(self._paths))
        budget = self._budget.part(_SEARCH_SHARE / waiting)
        task = replace(task, limits=replace(task.limits, climb_angle_rad=self._climb_rad[index]))
        rng, wider_m = self._generators[index], self._wider_m[index]
        avoided = [*self._overhead, *avoided]
        kept = {} if again is None else {k: p for k, p in enumerate(self._paths[index].pieces) if k not in again}
        found = _path(self._scene, avoided, task, fellows, rng, self._watch, wider_m, budget, guesses, kept)
        if self._searched is not None:
            self._searched(found)
        return found

    def _fellows(self, index: int) -> list[PlannedPath]:
        return [path for k, path in enumerate(self._paths) if k != index]

    def _replace(self, index: int, path: PlannedPath) -> None:
        """Take a new path for a vehicle: what timed the old one no longer holds."""
        name = self._scene.tasks[index].name
        self._paths[index] = path
        self._pins = [pin for pin in self._pins if pin.index != index]
        self._resolutions = [r for r in self._resolutions if r.vehicle != name or r.how != "speed"]

    def _scheduled(self) -> tuple[list[Schedule], float | None]:
        """Return the schedules; whoever may not lose time but by a detour is planned again with one."""
        for _ in range(_DETOURS):
            try:
                return schedule(self._scene, self._paths, self._delays_s, self._pins)
            except TooEarlyError as error:
                if self._scene.mission.fleet.lose_time_by != "detour" or not self._detoured(error):
                    raise
        return schedule(self._scene, self._paths, self._delays_s, self._pins)

    def apart(self) -> tuple[Scene, FleetPlan]:
        """Return a plan in which all keep apart, and the scene with the heights at which they return.

        Raises
        ------
        InfeasibleError
            They cannot arrive together, or not apart, or not return.
        """
        scene = self._scene
        conflict: Conflict | None = None
        for round_ in range(_ROUNDS):
            try:
                schedules, arrival_s = self._scheduled()
            except InfeasibleError:
                if conflict is None:
                    raise
                break  # what would part them keeps them from arriving together
            plan = self._assembled(scene, schedules, arrival_s)
            conflict = proof.worst_conflict(scene, plan)
            if conflict is None:
                if self._mended_alone(plan, schedules):
                    continue
                try:
                    returned = with_return_heights(scene, plan)
                except UnreturnableError as error:
                    if not self._mended(error, plan, round_):
                        raise
                    continue
                plan = self._assembled(returned, schedules, arrival_s)
                conflict = proof.worst_conflict(returned, plan)  # who returns at its end now does so at its own height
            if conflict is None:
                return returned, plan
            parted = (
                self._timed_apart(conflict, plan, _LATER_S)
                or (not _both_stand(plan, conflict) and self._part(conflict, plan, round_))
                or self._timed_apart(conflict, plan, _LATER_MAX_S)
            )
            if not parted:
                break
        raise InfeasibleError(
            f"{conflict}, and no new plan parted them: move their starts, goals or stops apart, set "
            "fleet.launch_interval_s, or lower fleet.separation_m"
        )

    def _assembled(self, scene: Scene, schedules: Sequence[Schedule], arrival_s: float | None) -> FleetPlan:
        plan = assemble(scene, self._paths, schedules, arrival_s, self._seed)
        return replace(plan, resolutions=tuple(self._resolutions))

    def _timed_apart(self, conflict: Conflict, plan: FleetPlan, later_max_s: float) -> bool:
        """Let one of two pass where they meet at another time; False where no small change keeps them well apart.

        The fleet may arrive up to ``later_max_s`` later for it. Of all that helps, what makes it arrive the least
        later, then what changes the least.
        """
        found: list[tuple[float, float, list[_Pin], list[float], Resolution]] = []
        before_s = plan.arrival_s
        for index in (conflict.second, conflict.first):
            name, other = plan.vehicles[index].name, conflict.names[int(index == conflict.first)]
            longer_s = _standing_s(plan, conflict)
            for shift_s in (*_SHIFTS_S, *(longer_s + more_s for more_s in _AFTER_STANDING_S if longer_s > 0.0)):
                if not self._promising(index, conflict, plan, shift_s, later_max_s):
                    continue
                for pins, delays_s, how, told in self._timings(index, conflict, plan, shift_s, longer_s):
                    try:
                        schedules, arrival_s = schedule(self._scene, self._paths, delays_s, pins)
                    except InfeasibleError:
                        continue
                    later_s = (arrival_s or 0.0) - (before_s or 0.0)
                    if later_s > later_max_s + longer_s:
                        continue
                    trial = assemble(self._scene, self._paths, schedules, arrival_s, self._seed)
                    if self._keeps_apart(index, conflict, trial):
                        resolution = Resolution(name, other, conflict.t_s, how, told)
                        found.append((max(later_s, 0.0), abs(shift_s), pins, delays_s, resolution))
            if found:
                break  # who comes later in the mission gives way, if it can
        if not found:
            return False
        _, _, self._pins, self._delays_s, resolution = min(found, key=lambda option: option[:2])
        self._resolutions.append(resolution)
        return True

    def _promising(self, index: int, conflict: Conflict, plan: FleetPlan, shift_s: float, later_max_s: float) -> bool:
        """Whether passing so much later may help, judged by the flights as they are: solving for it takes long."""
        vehicle = plan.vehicles[index]
        other = conflict.first if index == conflict.second else conflict.second
        top_m_s = self._scene.tasks[index].limits.speed_max_m_s
        left_s = vehicle.arrival_s - conflict.t_s
        if plan.arrival_s is not None and shift_s - left_s * (1.0 - vehicle.speeds_m_s[-1] / top_m_s) > later_max_s:
            return False  # it could not make up for it
        around_s = np.linspace(conflict.t_s - _AROUND_S, conflict.t_s + _AROUND_S, 2 * int(_AROUND_S) + 1)
        theirs = Trajectory(around_s, plan.vehicles[other].trajectory.at(around_s))
        required_m = proof.required_apart_m(self._scene, self._scene.tasks[index], self._scene.tasks[other])
        for off_s in (-_OFF_S, 0.0, _OFF_S):
            mine = Trajectory(around_s, vehicle.trajectory.at(around_s - shift_s - off_s))
            if timing.least_separation([mine, theirs], required_m):
                return False
        return True

    def _timings(
        self, index: int, conflict: Conflict, plan: FleetPlan, shift_s: float, longer_s: float
    ) -> Iterator[tuple[list[_Pin], list[float], Literal["speed", "start"], str]]:
        """Yield pins and delays with which a vehicle passes the conflict ``shift_s`` later (below 0: earlier).

        Where somebody stands still there, also with the other where it is now: it must not come later as well.
        """
        vehicle = plan.vehicles[index]
        last = len(vehicle.reached_s) - 1
        # the waypoint before or after the conflict at which it can still make up for it
        passed = min(max(int(np.searchsorted(vehicle.reached_s, conflict.t_s)), 1), last - 1)
        if 1 <= passed < last:
            pin = _Pin(index, passed, round(float(vehicle.reached_s[passed]) + shift_s, 2))
            kept = [p for p in self._pins if (p.index, p.waypoint) != (index, passed)]
            told = f"passes waypoint {passed} {abs(shift_s):g} s {'later' if shift_s > 0.0 else 'earlier'}"
            yield [*kept, pin], self._delays_s, "speed", told
        if shift_s > 0.0:
            delays_s = list(self._delays_s)
            delays_s[index] = vehicle.start_delay_s + shift_s
            yield self._pins, delays_s, "start", f"starts {delays_s[index]:g} s after the mission"
        other = conflict.first if index == conflict.second else conflict.second
        at = _place_at(plan.vehicles[other], conflict.t_s)
        if longer_s > 0.0 and 1 <= passed < last and 1 <= at < len(plan.vehicles[other].reached_s) - 1:
            stays = _Pin(other, at, round(float(plan.vehicles[other].reached_s[at]), 2))
            others = [p for p in kept if (p.index, p.waypoint) != (other, at)]
            yield [*others, pin, stays], self._delays_s, "speed", told

    def _keeps_apart(self, index: int, conflict: Conflict, plan: FleetPlan) -> bool:
        """Whether a vehicle comes too close to nobody, and to whom it would have met not even if one is a bit off."""
        other = conflict.first if index == conflict.second else conflict.second
        mine = plan.vehicles[index].trajectory
        for k, vehicle in enumerate(plan.vehicles):
            required_m = proof.required_apart_m(self._scene, self._scene.tasks[index], self._scene.tasks[k])
            if k != index and timing.least_separation([mine, vehicle.trajectory], required_m):
                return False
        late_s = max(_OFF_S, self._scene.mission.fleet.lateness_s)
        required_m = proof.required_apart_m(self._scene, self._scene.tasks[index], self._scene.tasks[other])
        return timing.lateness_slack(mine, plan.vehicles[other].trajectory, required_m, late_s) >= late_s

    def _part(self, conflict: Conflict, plan: FleetPlan, round_: int, *, tall: bool = False) -> bool:
        """Plan one of two again around the other's flight: the later one, when that has not parted them the other.

        ``tall``: neither above nor below it either.
        """
        later_first = (round_ + self._start) % 2 == 0
        for index in (conflict.second, conflict.first) if later_first else (conflict.first, conflict.second):
            other = plan.vehicles[conflict.first if index == conflict.second else conflict.second]
            flight = _flight_around(other, conflict, self._scene.tasks[index], tall=tall)
            before = self._paths[index]
            around_s = _AVOID_S + conflict.late_s
            again = _pieces_at(before, plan.vehicles[index], conflict.t_s - around_s, conflict.t_s + around_s)
            try:
                path = self._path(index, [*self._avoided[index], *flight], self._fellows(index), again=again)
            except InfeasibleError:
                continue
            self._replace(index, path)
            self._avoided[index] += flight
            self._resolutions.append(_went_around(plan.vehicles[index], other.name, conflict.t_s, before, path))
            return True
        return False

    def _detoured(self, error: TooEarlyError) -> bool:
        """Plan a vehicle again with a way so much longer that it arrives on time; False where there is none."""
        index = error.index
        task = self._scene.tasks[index]
        stops = _stop_indices(task.route_m, self._paths[index].waypoints_m)
        inside = [k for k in range(len(stops) - 1) if stops[k] >= error.legs[0] and stops[k + 1] <= error.legs[1]]
        if not inside:
            return False
        lengths_m = np.linalg.norm(np.diff(task.route_m, axis=0), axis=1)
        longest = max(inside, key=lambda k: lengths_m[k])
        ends = task.route_m[longest : longest + 2]
        way_m = float(lengths_m[longest])
        bends = self._detours[index].get(longest, np.empty((0, 3)))
        now_m = float(length_m(np.concatenate([ends[:1], bends, ends[1:]])))
        longer_m = now_m + error.early_s * task.limits.speed_min_m_s * _DETOUR_SHARE
        off_m = 0.5 * math.sqrt(longer_m**2 - way_m**2)  # of one bend; several are as long together
        before, kept = self._paths[index], dict(self._detours[index])
        for count in _BENDS:
            for side in (1.0, -1.0):
                try:
                    self._detours[index] = kept | {longest: self._zigzag(task, ends, count, side * off_m / count)}
                    path = self._path(index, self._avoided[index], self._fellows(index))
                except MissionPlannerError:  # outside the terrain, or no way there
                    continue
                self._replace(index, path)
                told = f"flies {path.length_m - before.length_m:.0f} m more, to arrive {error.early_s:.0f} s later"
                self._resolutions.append(Resolution(task.name, "", 0.0, "detour", told))
                return True
        self._detours[index] = kept
        return False

    def _zigzag(self, task: VehicleTask, ends_m: FloatArray, count: int, off_m: float) -> FloatArray:
        """Return bends (count, 3) on both sides of the straight way between two places, raised to where it may fly."""
        along = np.diff(ends_m, axis=0)[0]
        across = np.array([-along[1], along[0], 0.0]) / max(float(np.hypot(along[0], along[1])), 1e-9)
        shares = (np.arange(count)[:, np.newaxis] + 0.5) / count
        bends: FloatArray = ends_m[0] + shares * along + off_m * (-1.0) ** np.arange(count)[:, np.newaxis] * across
        for bend in bends:
            ground_m = self._scene.terrain.ground_amsl_m(bend[0], bend[1], f"{task.name}'s detour")
            bend[2] = max(bend[2], ground_m + Margins.of(task.limits).height_agl_min_m + _DETOUR_ROOM_M)
        return bends

    def _mended(self, error: UnreturnableError, plan: FleetPlan, round_: int) -> bool:
        """Plan those again who cannot return, or not apart; False where nothing was found to help."""
        names = [task.name for task in self._scene.tasks]
        who = [names.index(name) for name in error.vehicles]
        self._mends -= 1
        if self._mends < 0 or error.t_s is None:
            return False
        if len(who) == 1:
            again = _pieces_at(self._paths[who[0]], plan.vehicles[who[0]], error.t_s, error.t_s)
            return error.short_m > 0.0 and self._roomier(who[0], dict.fromkeys(again or [0], error.short_m))
        first, second = sorted(who)
        required_m = proof.required_apart_m(self._scene, self._scene.tasks[first], self._scene.tasks[second])
        required_m += max(_braking_m(self._scene.tasks[k]) for k in who)  # they brake, perhaps towards each other
        over = Conflict(first, second, (names[first], names[second]), 0.0, required_m, error.t_s)
        return self._part(over, plan, round_, tall=True)  # who climbs home must not be below another's way

    def _mended_alone(self, plan: FleetPlan, schedules: Sequence[Schedule]) -> bool:
        """Plan those again who cannot return even by themselves, of ways of many pieces; False where none was.

        All in one round: each of their pieces may need it.
        """
        changed = False
        for index, (vehicle, when) in enumerate(zip(plan.vehicles, schedules, strict=True)):
            path = self._paths[index]
            if not path.pieces or (path, when) in self._returning:
                continue
            (flight,) = proof.predict(self._scene, [proof.planned_sortie(self._scene, vehicle)])
            lacking_m = self._lacking_m(path, vehicle, flight)
            if not lacking_m:
                try:
                    return_heights_m(self._scene, [flight])
                    self._returning.add((path, when))
                except UnreturnableError as error:
                    if error.t_s is not None and error.short_m > 0.0:
                        at = _pieces_at(path, vehicle, error.t_s, error.t_s)
                        lacking_m = dict.fromkeys(at, error.short_m)
            if lacking_m:
                self._mends -= 1
                changed |= self._mends >= 0 and self._roomier(index, lacking_m)
        return changed

    def _lacking_m(self, path: PlannedPath, vehicle: VehiclePlan, flight: proof.Flight) -> dict[int, float]:
        """Return, by piece of its way, by how much a vehicle that is told to return on it lacks room, where it does."""
        whole = proof.returning(flight)
        limits = replace(whole.limits, tracking_error_m=whole.limits.tracking_error_m + _STORED_M)
        whole = replace(whole, limits=limits)
        lacking: dict[int, float] = {}
        first = 0
        for k, (piece, begin_s, end_s) in enumerate(zip(path.pieces, *_spans_s(path, vehicle), strict=True)):
            known = piece, tuple(vehicle.speeds_m_s[first : first + len(piece.waypoints_m) - 1].tolist())
            first += len(known[1])
            if known in self._fine:
                continue
            from_s = max(begin_s - _BESIDE_S, float(vehicle.reached_s[0]))
            t_s = np.arange(from_s, max(from_s + 1.0, min(end_s + _BESIDE_S, whole.descends_s)), 0.1)
            part = Trajectory(t_s - from_s, whole.trajectory.at(t_s))
            alone = replace(whole, trajectory=part, airborne_s=0.0, descends_s=float(part.t_s[-1]))
            try:
                returns.choose_return_heights(
                    self._scene.space,
                    self._scene.terrain.bounds,
                    self._scene.obstacles.names,
                    [alone],
                    lambda _i, _j: 0.0,
                    [None],
                )
                self._fine.add(known)
            except UnreturnableError as error:
                if error.short_m > 0.0:
                    lacking[k] = error.short_m
        return lacking

    def give_room(self, problems: Sequence[Finding]) -> bool:
        """Plan those again, further off, whose own way is not proven; False where that cannot help."""
        names = [task.name for task in self._scene.tasks]
        helped = [f for f in problems if f.check in ("terrain", "obstacle", "fence", "ceiling", "turn", "angle")]
        for index in {names.index(f.vehicle) for f in helped}:
            own = [f for f in helped if f.vehicle == names[index] and f.check != "turn"]
            short_m = [f.required - f.value for f in own if f.value is not None and f.required is not None]
            places_m = [f.position_m for f in helped if f.vehicle == names[index]]
            again = _pieces_near(self._paths[index], [p for p in places_m if p is not None])
            if None in places_m:
                again = list(range(len(self._paths[index].pieces)))
            lacks_m = max([0.0, *(m for m in short_m if m < np.inf)])
            if not self._roomier(index, dict.fromkeys(again or [0], lacks_m)):
                return False
        return len(helped) == len(problems)

    def _roomier(self, index: int, short_m: Mapping[int, float]) -> bool:
        """Plan pieces of one vehicle's way again, further off everything by what they lack and a little more."""
        wider_m = self._wider_m[index]
        wider_m.update({k: wider_m.get(k, 0.0) + _ROOM_M + lacks_m for k, lacks_m in short_m.items()})
        if self._scene.tasks[index].motion.vehicle_class == "plane":
            legs = np.diff(self._paths[index].waypoints_m, axis=0)
            steepest_rad = float(np.arctan2(legs[:, 2], np.hypot(legs[:, 0], legs[:, 1])).max())
            self._climb_rad[index] = min(self._climb_rad[index], max(_GENTLER * steepest_rad, _GENTLEST_RAD))
        try:
            path = self._path(index, self._avoided[index], self._fellows(index), again=short_m)
            self._replace(index, path)
        except InfeasibleError:
            return False
        return True


def _place_at(vehicle: VehiclePlan, t_s: float) -> int:
    """Return the waypoint at which a vehicle stands, or to which it flies, at a time; beyond the goal: their number."""
    return int(np.searchsorted(vehicle.reached_s + np.concatenate([[0.0], vehicle.hold_s]), t_s))


def _standing_s(plan: FleetPlan, conflict: Conflict) -> float:
    """Return for how long the first or second of two stands still where they are too close, the longer one's."""
    found = [0.0]
    for index in (conflict.first, conflict.second):
        at = _place_at(plan.vehicles[index], conflict.t_s)
        if at in plan.vehicles[index].actions:
            found.append(plan.vehicles[index].actions[at].stand_s)
    return max(found)


def _both_stand(plan: FleetPlan, conflict: Conflict) -> bool:
    """Whether two meet where each has to stand still, too close to the other's place: no other way parts them."""
    places = []
    for index in (conflict.first, conflict.second):
        vehicle = plan.vehicles[index]
        at = _place_at(vehicle, conflict.t_s)
        if at not in vehicle.actions or vehicle.actions[at].stand_s == 0.0:
            return False
        places.append(vehicle.waypoints_m[at])
    return bool(np.linalg.norm(places[0] - places[1]) < conflict.required_m)


def _spans_s(path: PlannedPath, vehicle: VehiclePlan) -> tuple[FloatArray, FloatArray]:
    """Return when the pieces (P,) of a vehicle's way begin and end, stands at both ends included."""
    ends = np.cumsum([0, *(len(piece.waypoints_m) - 1 for piece in path.pieces)])
    left_s = vehicle.reached_s + np.concatenate([[0.0], vehicle.hold_s])
    return vehicle.reached_s[ends[:-1]], left_s[ends[1:]]


def _pieces_at(path: PlannedPath, vehicle: VehiclePlan, begin_s: float, end_s: float) -> list[int]:
    """Return which pieces of a vehicle's way are flown between two times; take-off and end belong to the outermost."""
    from_s, until_s = _spans_s(path, vehicle)
    from_s[:1], until_s[-1:] = -np.inf, np.inf
    return [k for k, (a, b) in enumerate(zip(from_s, until_s, strict=True)) if a <= end_s and b >= begin_s]


def _pieces_near(path: PlannedPath, places_m: Sequence[Sequence[float]]) -> list[int]:
    """Return which pieces of a vehicle's way are nearest to each of some places (3,); two where they meet."""
    near: set[int] = set()
    for place_m in places_m if path.pieces else ():
        off_m = [distance_to_legs_m(np.array(place_m), polyline_legs(p.waypoints_m)).min() for p in path.pieces]
        near.update(np.flatnonzero(np.array(off_m) <= min(off_m) + _AT_THE_SAME_M).tolist())
    return sorted(near)


def with_return_heights(scene: Scene, plan: FleetPlan) -> Scene:
    """Return the scene with the least heights at which all of a plan's vehicles return clear of all, and apart.

    Raises
    ------
    InfeasibleError
        There are none.
    """
    flights = proof.predict(scene, [proof.planned_sortie(scene, vehicle) for vehicle in plan.vehicles])
    return returning_at(scene, return_heights_m(scene, flights))


def return_heights_m(scene: Scene, flights: Sequence[proof.Flight]) -> dict[str, float]:
    """Return, by name, the least heights above home at which vehicles return clear of all, and apart.

    Where the mission waives the direct return, only of those that return at their goals.

    Raises
    ------
    UnreturnableError
        There are none.
    """
    vehicles = [_waiting(flight) if flight.sortie.ending == "rtl" else proof.returning(flight) for flight in flights]
    if scene.mission.fleet.direct_return == "waived":
        vehicles = [
            replace(v, airborne_s=v.descends_s)
            for v, flight in zip(vehicles, flights, strict=True)
            if flight.sortie.ending == "rtl"
        ]
    settings = {vehicle.name: vehicle.asked_motion().get("return_height_m") for vehicle in scene.mission.vehicles}
    tasks = {task.name: task for task in scene.tasks}

    def apart_m(i: int, j: int) -> float:
        return proof.required_apart_m(scene, tasks[vehicles[i].name], tasks[vehicles[j].name])

    heights_m = returns.choose_return_heights(
        scene.space,
        scene.terrain.bounds,
        scene.obstacles.names,
        vehicles,
        apart_m,
        [settings[v.name] for v in vehicles],
    )
    return {v.name: height_m for v, height_m in zip(vehicles, heights_m, strict=True)}


def _waiting(flight: proof.Flight) -> Returning:
    """Return a flight that waits at its goal: at which height it returns from there is still to be chosen.

    That way home is one of its mission's legs, and as wide as they are.
    """
    until = flight.trajectory.t_s <= flight.reached_s[-1]
    trajectory = Trajectory(flight.trajectory.t_s[until], flight.trajectory.position_m[until])
    limits = flight.task.limits
    limits = replace(limits, tracking_error_m=limits.tracking_error_m + limits.deviation_m)
    returning = proof.returning(flight)
    return replace(returning, limits=limits, trajectory=trajectory, descends_s=float(trajectory.t_s[-1]))


def returning_at(scene: Scene, height_m: Mapping[str, float]) -> Scene:
    """Return the scene with vehicles, by name, that return at these heights above home."""
    tasks = [
        replace(
            task,
            motion=replace(task.motion, return_height_m=float(height_m.get(task.name, task.motion.return_height_m))),
        )
        for task in scene.tasks
    ]
    return replace(scene, tasks=tuple(tasks))


def schedule(
    scene: Scene, paths: Sequence[PlannedPath], delays_s: Sequence[float], pins: Sequence[_Pin] = ()
) -> tuple[list[Schedule], float | None]:
    """Return when and how fast each vehicle flies, and the common arrival if the mission asks for one (eq. 10).

    Raises
    ------
    InfeasibleError
        The fleet cannot meet, or not arrive together.
    """
    fleet = scene.mission.fleet
    rows = list(zip(scene.tasks, paths, delays_s, strict=True))
    fliers = [_flier(scene, *row) for row in rows]
    stops = [_stop_indices(task.route_m, path.waypoints_m) for task, path, _ in rows]
    names = {task.name: index for index, task in enumerate(scene.tasks)}
    meetings = [
        Meeting(
            f"rendezvous {meeting.name}",
            {names[n]: stops[names[n]][scene.tasks[names[n]].places[place]] for n, place in meeting.at.items()},
        )
        for meeting in fleet.rendezvous
    ]
    start_later = fleet.lose_time_by == "start_later"
    if fleet.arrive_together:
        goals = {index: stop[-1] for index, stop in enumerate(stops)}
        after_s = {index: fleet.arrives_after_s(task.name) for index, task in enumerate(scene.tasks)}
        goal = Meeting("fleet.arrival_time_s", goals, after_s)
        if fleet.arrival_time_s is not None and meetings and start_later:
            # nobody shall hurry to a meeting and then wait for the arrival: all start later instead
            _, times = arrange(fliers, [*meetings, goal])
            later_s = max(0.0, math.floor((fleet.arrival_time_s - times[-1]) * 10.0) / 10.0)
            fliers = [replace(flier, delay_s=flier.delay_s + later_s) for flier in fliers]
        meetings.append(replace(goal, time_s=fleet.arrival_time_s))
    for pin in pins:
        before = [k for k, m in enumerate(meetings) if m.at.get(pin.index, -1) >= pin.waypoint]
        at = before[0] if before else len(meetings)
        if at == len(meetings) or meetings[at].at.get(pin.index) != pin.waypoint:
            meetings.insert(
                at, Meeting(f"{scene.tasks[pin.index].name}'s pass", {pin.index: pin.waypoint}, {}, pin.t_s)
            )
    schedules, times = arrange(fliers, meetings, start_later=start_later)
    return schedules, times[-1] if fleet.arrive_together else None


def _flier(scene: Scene, task: VehicleTask, path: PlannedPath, delay_s: float) -> Flier:
    thrifty = scene.mission.fleet.arrival == "least_energy"
    low_m_s, high_m_s = _speed_range(task, path)
    return Flier(
        name=task.name,
        reached_s=partial(_reached, task, path),
        legs=len(path.waypoints_m) - 1,
        speed_min_m_s=low_m_s,
        speed_max_m_s=high_m_s,
        pace_m_s=_thriftiest_m_s(scene, task, path) if thrifty else high_m_s,
        delay_s=delay_s,
        can_wait=task.motion.vehicle_class == "copter",
        thrifty=thrifty,
        stand_s=stands_s(task, path.waypoints_m),
    )


def waypoint_actions(task: VehicleTask, waypoints_m: FloatArray) -> dict[int, Action]:
    """Return what a vehicle does at which of its waypoints (W, 3), and on the way to them from the stop before."""
    if not task.actions:
        return {}
    stops = _stop_indices(task.route_m, waypoints_m)
    return {stops[point]: task.actions.get(point, Action()) for point in range(1, len(stops))}


def stands_s(task: VehicleTask, waypoints_m: FloatArray) -> tuple[float, ...]:
    """Return how long a vehicle has to stand still at each of its waypoints (W, 3) but the first (W - 1)."""
    actions = waypoint_actions(task, waypoints_m)
    return tuple(actions[k].stand_s if k in actions else 0.0 for k in range(1, len(waypoints_m)))


def _stop_indices(route_m: FloatArray, waypoints_m: FloatArray) -> list[int]:
    """Return which of its waypoints are the points of a vehicle's route."""
    stops = passes(route_m, waypoints_m)
    assert len(stops) == len(route_m), "legs are fitted through every stop"
    return stops


def assemble(
    scene: Scene, paths: Sequence[PlannedPath], schedules: Sequence[Schedule], arrival_s: float | None, seed: int
) -> FleetPlan:
    """Return the fleet plan of paths and schedules, flights predicted, nothing checked yet."""
    rows = list(zip(scene.tasks, paths, schedules, strict=True))
    flights = [_flight(*row, _goal_ground(scene, row[0])) for row in rows]
    # planes circle for as long as others still fly: a place that is free now may not be in ten seconds
    last_s = max(float(trajectory.t_s[-1]) for trajectory, _ in flights)
    for index, row in enumerate(rows):
        if row[0].motion.vehicle_class == "plane":
            flights[index] = _flight(*row, _goal_ground(scene, row[0]), last_s)
    vehicles = []
    for (task, path, when), (trajectory, reached_s) in zip(rows, flights, strict=True):
        vehicles.append(
            VehiclePlan(
                name=task.name,
                sysid=task.sysid,
                autopilot=task.motion.autopilot,
                vehicle_class=task.motion.vehicle_class,
                motion=task.motion,
                home_m=task.home_m,
                path_m=path.path_m,
                waypoints_m=path.waypoints_m,
                end=task.end,
                length_m=path.length_m,
                speeds_m_s=np.array(when.speeds_m_s),
                hold_s=np.array(when.hold_s),
                start_delay_s=when.start_delay_s,
                window_s=when.window_s,
                arrival_s=float(reached_s[-1]),
                reached_s=reached_s,
                trajectory=trajectory,
                cost=path.cost,
                cost_terms=path.cost_terms,
                history=path.history,
                evaluations=path.evaluations,
                clearances=(),
                actions=waypoint_actions(task, path.waypoints_m),
            )
        )
    return FleetPlan(
        mission=scene.mission,
        frame=scene.frame,
        vehicles=tuple(vehicles),
        arrival_s=arrival_s,
        separation=None,
        seed=seed,
        software_version=__version__,
        input_sha256=scene.input_sha256,
        certificate=None,
    )


# Most paths outlive a round of the planner: what follows from one is worked out once (they compare by identity).


@lru_cache(maxsize=16384)
def _reached(
    task: VehicleTask, path: PlannedPath, speeds_m_s: tuple[float, ...], hold_s: tuple[float, ...]
) -> FloatArray:
    return timing.reached_times(task.motion, task.home_m, path.waypoints_m, speeds_m_s, hold_s)


@lru_cache(maxsize=256)
def _speed_range(task: VehicleTask, path: PlannedPath) -> tuple[float, float]:
    return wind.speed_range_m_s(task, path.waypoints_m)


@lru_cache(maxsize=256)
def _thriftiest_m_s(scene: Scene, task: VehicleTask, path: PlannedPath) -> float:
    """Return the speed along the whole way that takes least of the battery, of some between least and greatest."""
    settings = next(vehicle for vehicle in scene.mission.vehicles if vehicle.name == task.name)
    model = energy.energy_model(settings, scene.mission.air_m_s)
    if model is None:
        raise MissionError(
            f"fleet.arrival: least_energy: expected endurance_s or energy of every vehicle, got neither of {task.name}"
        )
    low_m_s, high_m_s = _speed_range(task, path)
    used: dict[float, float] = {}
    for speed_m_s in np.linspace(low_m_s, high_m_s, _PACES).round(2).clip(low_m_s, high_m_s).tolist():
        flight, reached_s = timing.predict_flight(
            task.motion, task.home_m, path.waypoints_m, speed_m_s, hold_s=stands_s(task, path.waypoints_m)
        )
        share = energy.used_share(model, flight, scene.mission.wind_max_m_s or 0.0)
        used[speed_m_s] = float(np.interp(reached_s[-1], flight.t_s, share))
    return min(used, key=lambda speed_m_s: used[speed_m_s])


@lru_cache(maxsize=256)
def _flight(
    task: VehicleTask, path: PlannedPath, when: Schedule, ground_amsl_m: float, until_s: float = 0.0
) -> tuple[Trajectory, FloatArray]:
    return timing.predict_flight(
        task.motion,
        task.home_m,
        path.waypoints_m,
        when.speeds_m_s,
        hold_s=when.hold_s,
        end=task.end,
        ground_amsl_m=ground_amsl_m,
        start_delay_s=when.start_delay_s,
        until_s=until_s,
    )


def _goal_ground(scene: Scene, task: VehicleTask) -> float:
    x_m, y_m, _ = task.route_m[-1]
    return scene.terrain.ground_amsl_m(x_m, y_m, f"{task.name}'s goal")


def _path(
    scene: Scene,
    avoided: Sequence[Solid],
    task: VehicleTask,
    fellows: Sequence[PlannedPath],
    rng: np.random.Generator,
    watch: Watch | None,
    wider_m: Mapping[int, float],
    budget: Budget,
    guesses: Guesses | None,
    kept: Mapping[int, PlannedPath],
) -> PlannedPath:
    """Return one vehicle's path around all that stands still and what is to be ``avoided``.

    The ways of ``fellows`` are priced as if all flew evenly and arrived together.
    """
    space, names = _with(scene.space, avoided), _names(scene, avoided)
    fleet = scene.mission.fleet
    if not fleet.arrive_together and fleet.launch_interval_s > 0.0:
        fellows = []  # where they are when, compared with this one, nobody knows yet
    fellows_m = np.stack([evenly(f.path_m, _FELLOW_INSTANTS) for f in fellows]) if fellows else None
    unvisited = _unvisited(scene)
    # what the proof asks for, and a little more: the price knows the fellows' timing only roughly
    separation_m = max(proof.required_apart_m(scene, task, other) for other in scene.tasks) + _FELLOW_SLACK_M

    def price_of(piece: Piece, extra_m: float) -> Price:
        return Price(
            space=space,
            limits=task.limits,
            route_length_m=float(np.linalg.norm(np.diff(piece.task.route_m, axis=0), axis=1).sum()),
            weights=scene.mission.planner.weights,
            towers=unvisited,
            fellows=None if fellows_m is None else _meanwhile(fellows_m, piece.share),
            separation_m=separation_m,
            clearance_extra_m=extra_m,
        )

    # a plane is held to its predicted flight: its turns are wider the faster it flies, what it cuts differs
    plane = task.motion.vehicle_class == "plane"
    ground_amsl_m = _goal_ground(scene, task)

    def flown_is_clear(waypoints_m: FloatArray) -> bool:
        if not proof.turns_allowed(task, waypoints_m):
            return False
        for speed_m_s in reversed(wind.speed_range_m_s(task, waypoints_m)) if plane else ():
            trajectory, reached_s = timing.predict_flight(
                task.motion, task.home_m, waypoints_m, speed_m_s, end=task.end, ground_amsl_m=ground_amsl_m
            )
            flown = proof.chords(trajectory, float(reached_s[0]))
            if not tubes_clear(space, scene.terrain.bounds, task.limits, flown, proof.CHORD_ERROR_M).all():
                return False
        return True

    on_iteration = None if watch is None else lambda done: watch(task.name, done)
    return find_way(
        task,
        space,
        scene.terrain.bounds,
        names,
        price_of,
        scene.mission.planner,
        rng,
        flown_is_clear,
        on_iteration,
        wider_m,
        budget,
        guesses,
        kept,
    )


def _meanwhile(ways_m: FloatArray, share: tuple[float, float]) -> FloatArray:
    """Return where others, whose whole ways are given (F, N, 3), are in a part of the flight's time."""
    if share == (0.0, 1.0):
        return ways_m
    begin, end = share
    at = np.linspace(begin, end, max(_FELLOW_INSTANTS_LEAST, round((end - begin) * _FELLOW_INSTANTS)))
    instants = np.linspace(0.0, 1.0, _FELLOW_INSTANTS)
    return np.stack([[np.interp(at, instants, way_m[:, k]) for k in range(3)] for way_m in ways_m]).swapaxes(1, 2)


def _guesses(scene: Scene, avoided: Sequence[Solid], clock: Clock | None) -> Iterator[Guesses]:
    """Yield what every vehicle's search begins with: the graph's part of the work, on all cores."""
    space, names = _with(scene.space, avoided), _names(scene, avoided)

    def guessed(task: VehicleTask) -> Guesses:
        return guess(task, space, scene.terrain.bounds, names, scene.mission.planner, clock)

    if THREADS == 1 or len(scene.tasks) == 1:
        yield from map(guessed, scene.tasks)
        return
    with ThreadPoolExecutor(THREADS, thread_name_prefix="guess") as pool:
        yield from pool.map(guessed, scene.tasks)


def _names(scene: Scene, avoided: Sequence[Solid]) -> tuple[str, ...]:
    return (*scene.obstacles.names, *(solid.name for solid in avoided))


def _unvisited(scene: Scene) -> Towers | None:
    """Return the towers that no vehicle's route passes anyway: only those make a difference to a path's price."""
    towers = scene.towers
    if towers is None:
        return None
    stops_m = np.concatenate([task.route_m for task in scene.tasks])
    nearest_m = np.linalg.norm(towers.top_m[:, np.newaxis] - stops_m, axis=-1).min(axis=1)
    left = np.flatnonzero((nearest_m > towers.range_m) & (towers.weight > 0.0))
    if left.size == 0:
        return None
    return replace(
        towers,
        names=tuple(towers.names[k] for k in left),
        top_m=towers.top_m[left],
        height_m=towers.height_m[left],
        weight=towers.weight[left],
    )


def _went_around(vehicle: VehiclePlan, other: str, t_s: float, before: PlannedPath, after: PlannedPath) -> Resolution:
    """Return how a new path keeps away from where another was met: rather above or below, or rather beside it."""
    legs = polyline_legs(after.waypoints_m)
    met_m = vehicle.trajectory.at(t_s)
    along = np.clip(
        ((met_m - legs[:, 0]) * (legs[:, 1] - legs[:, 0])).sum(axis=1)
        / np.maximum(((legs[:, 1] - legs[:, 0]) ** 2).sum(axis=1), 1e-9),
        0.0,
        1.0,
    )
    nearest_m = legs[:, 0] + along[:, np.newaxis] * (legs[:, 1] - legs[:, 0])
    off_m = nearest_m[int(np.argmin(np.linalg.norm(nearest_m - met_m, axis=1)))] - met_m
    higher = abs(off_m[2]) > float(np.hypot(off_m[0], off_m[1]))
    higher &= bool(abs(off_m[2]) >= 1.0)
    where = f"{abs(off_m[2]):.0f} m {'higher' if off_m[2] > 0.0 else 'lower'}" if higher else "another way"
    longer = f"{after.length_m - before.length_m:+.0f} m"
    return Resolution(vehicle.name, other, t_s, "altitude" if higher else "way", f"flies {where}, {longer}")


def _braking_m(task: VehicleTask) -> float:
    """Return how far a vehicle that is told to return flies on at most while it brakes, roughly."""
    return 0.5 * task.limits.speed_max_m_s**2 / wind.braking_m_s2(task.motion, task.limits.wind_max_m_s)


def _overhead(scene: Scene) -> list[Solid]:
    """Return the room below what hangs in the air, where anybody could fly there: who returns climbs straight up."""
    if scene.mission.fleet.direct_return == "waived":
        return []
    # a vehicle's tube fits below only where there is room for it and for both its margins
    need_m = min(Margins.of(task.limits).height_agl_min_m + Margins.of(task.limits).obstacle_m for task in scene.tasks)
    return [solid for solid in obstacles.beneath(scene.obstacles) if _room_below_m(scene, solid) > need_m]


def _room_below_m(scene: Scene, solid: Solid) -> float:
    """Return how high the top of what fills the room below something is above the ground there, at most."""
    match solid:
        case obstacles.PrismSolid(xy=xy, top_amsl_m=top_m):
            corners = np.concatenate([xy, 0.5 * (xy + np.roll(xy, -1, axis=0)), xy.mean(axis=0)[np.newaxis]])
        case CylinderSolid(x=x, y=y, radius_m=radius_m, top_amsl_m=top_m):
            turn = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
            corners = np.array([x, y]) + radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        case _:
            return np.inf
    ground_m = scene.terrain.height_amsl_m(corners[:, 0], corners[:, 1])
    return top_m - float(np.nanmin(ground_m)) if np.isfinite(ground_m).any() else np.inf


def _flight_around(other: VehiclePlan, conflict: Conflict, task: VehicleTask, *, tall: bool) -> Sequence[Solid]:
    """Return the other's predicted flight around the conflict as solids that ``task`` keeps clear of."""
    around_s = _AVOID_S + conflict.late_s
    times = np.linspace(conflict.t_s - around_s, conflict.t_s + around_s, 17)
    points = other.trajectory.at(times)
    route_m = task.route_m * [1.0, 1.0, 0.0] if tall else task.route_m
    if tall:
        points[:, 2] = 0.0
    points = points[np.concatenate([[True], np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-3])]
    if len(points) == 1:
        points = np.concatenate([points, points + np.array([0.0, 0.0, 0.1])])
    legs = polyline_legs(points)
    # the other may pass close to where this one must go, only not at the same time: its route stays open
    room_m = np.min([distance_to_legs_m(point, legs) for point in route_m], axis=0) - _ROUTE_ROOM_M
    radius_m = np.minimum(conflict.required_m + 1.0, room_m) - Margins.of(task.limits).obstacle_m
    found = [(a, b, float(r)) for (a, b), r in zip(legs, radius_m, strict=True) if r > 0.5]
    if tall:
        return [CylinderSolid(other.name, float(x), float(y), r) for a, b, r in found for x, y, _ in (a, b)]
    return [CableSolid(other.name, a, b, r) for a, b, r in found]


def _with(space: SpaceArrays, solids: Sequence[Solid]) -> SpaceArrays:
    return space._replace(obstacles=obstacles.join(space.obstacles, obstacles.pack(solids).arrays))
