"""A whole inspection: an open mission becomes rounds of sorties, each an ordinary mission that is planned and proven.

Views are found (:mod:`.views`), shared out among the vehicles and their sorties (:mod:`.assignment`), and every round
is planned as a mission of its own: each vehicle from its home through the places of its tour and back. A tour that
takes too much of a battery leaves some to others with room, in its round or a later one; where nobody has room, all is
shared out again. Two who cannot be kept apart fly one after the other, and so do the halves of a tour that is not
proven as a whole. A target to which a vehicle has no way is another's or, where nobody has one, left out, by name.
Nothing is dropped silently, and less than ``inspection.share_min`` is refused.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from missionplanner import mission, planner, views, wind
from missionplanner.assignment import Assignment, Tour, assign, relieved
from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.mission import Area, Direction, Fleet, Inspection, Mission, Place, Point, Stop
from missionplanner.plan import FleetPlan
from missionplanner.planner import UnprovenError, Watch
from missionplanner.returns import UnreturnableError
from missionplanner.scene import Scene, build_open_scene, build_scene
from missionplanner.travel import TravelCosts, travel_costs
from missionplanner.views import LeftOut, Viewpoint, Visit

_NAME_MAX = 40
_ATTEMPTS = 8
_SPARE = 0.96
"""Of what a tour may take of the battery: what it is expected to take, since planned ways are a little longer."""
_TIGHTER = 0.985
"""Of that, once a vehicle's battery was not enough: less than fits by its figures."""


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One sortie of every vehicle that has one: an ordinary mission, planned and proven."""

    scene: Scene
    plan: FleetPlan
    tours: tuple[Tour, ...]

    @property
    def lasts_s(self) -> float:
        """From the start until all have landed, as predicted."""
        return max(float(vehicle.trajectory.t_s[-1]) for vehicle in self.plan.vehicles)


@dataclass(frozen=True, slots=True, eq=False)
class InspectionPlan:
    """Rounds that inspect all that is not left out, nor done before."""

    scene: Scene  # of the open mission: no routes
    visits: tuple[Visit, ...]  # all that are asked for, also of what is done
    rounds: tuple[Round, ...]
    left_out: tuple[LeftOut, ...]
    assignment: Assignment  # the rounds' tours, and what they were expected to take
    done: frozenset[str]  # targets inspected before
    seed: int

    @property
    def inspected(self) -> tuple[str, ...]:
        """The targets all of whose visits the rounds fly, in the order of the visits."""
        flown = {visit.name for tour in self.tours for visit in tour.visits}
        missed = {visit.target for visit in self.visits if visit.name not in flown}
        return tuple(dict.fromkeys(visit.target for visit in self.visits if visit.target not in missed))

    @property
    def tours(self) -> tuple[Tour, ...]:
        """The tours of all rounds."""
        return tuple(tour for round_ in self.rounds for tour in round_.tours)

    @property
    def share(self) -> float:
        """The share of the towers' weight that is inspected, or was before (PAPER.md eq. 6)."""
        return self.share_of({*self.inspected, *self.done})

    def share_of(self, targets: Collection[str]) -> float:
        """Return the share of the towers' weight that these targets are; where only spans are asked for, of those."""
        towers = self.scene.towers
        asked = {visit.target for visit in self.visits} | {left.target for left in self.left_out}
        weights = {} if towers is None else dict(zip(towers.names, towers.weight.tolist(), strict=True))
        parts = {name: weights[name] for name in asked if name in weights}
        if sum(parts.values()) <= 0.0:  # nobody is asked for more than another
            parts = dict.fromkeys(parts, 1.0)
        if not parts:
            parts = dict.fromkeys(asked, 1.0)
        whole = math.fsum(parts.values())
        return math.fsum(part for name, part in parts.items() if name in targets) / whole if whole > 0.0 else 1.0

    @property
    def share_min(self) -> float:
        """The least share that must be inspected; where one sortie each is asked for, and none is stated: none."""
        inspection, assignment = _inspection(self.scene), _assignment(self.scene)
        stated = "share_min" in inspection.model_fields_set
        return 0.0 if assignment.objective == "priority" and not stated else inspection.share_min

    @property
    def swap_s(self) -> float:
        """How long batteries are changed between two rounds."""
        return _assignment(self.scene).swap_s

    @property
    def makespan_s(self) -> float:
        """From the first start to the last landing, with the changes of batteries between rounds."""
        return sum(r.lasts_s for r in self.rounds) + self.swap_s * max(0, len(self.rounds) - 1)


def plan_inspection(
    question: Mission,
    folder: Path,
    *,
    seed: int | None = None,
    watch: Watch | None = None,
    done: Collection[str] = frozenset(),
) -> InspectionPlan:
    """Return proven rounds of sorties that inspect what an open mission asks for; the same for the same seed.

    Parameters
    ----------
    folder : where the mission's relative file names start
    done : targets (towers and spans) that were inspected before

    Raises
    ------
    MissionError
        The mission is wrong, or shares out nothing (``inspection.assignment``).
    InfeasibleError
        Less than ``inspection.share_min`` can be inspected: names what is left out, and why; or a round was not
        proven, whatever was tried.
    """
    scene = open_scene(question, folder)
    wind.refuse_storm(scene.tasks)
    told = watch or _no_watch
    told("views", 0.0)
    visits, without_way = views.visits(scene)
    told("views", 1.0)
    targets = {visit.target for visit in visits} | {left.target for left in without_way}
    if unknown := sorted(set(done) - targets):
        raise MissionError(f"done: expected targets of this mission, got {', '.join(unknown[:3])}: of another one?")
    seed = scene.mission.planner.seed if seed is None else seed
    search = _Search(scene, folder, seed, told, frozenset(done), visits, {left.target: left for left in without_way})
    plan = search.plan()
    _expect_share(plan)
    return plan


def open_scene(question: Mission, folder: Path) -> Scene:
    """Return the scene of an open mission: terrain, obstacles, towers, and the vehicles' homes and limits.

    Raises
    ------
    MissionError
        As :func:`.build_open_scene`; or the mission shares out nothing.
    """
    if not question.is_open:
        raise MissionError("inspection.assignment: expected this field, got none: vehicles have stops of their own")
    return build_open_scene(question, folder)


def round_mission(scene: Scene, tours: Sequence[Tour], number: int) -> Mission:
    """Return the ordinary mission of a round (from 1): its vehicles, each through the places of its tour and home."""
    question = scene.mission
    flying = {tour.vehicle: tour for tour in tours}
    vehicles = [
        vehicle.model_copy(update={"sysid": scene.tasks[index].sysid, "stops": stops(flying[index])})
        for index, vehicle in enumerate(question.vehicles)
        if index in flying
    ]
    west, south, east, north = scene.area_m
    weights = question.planner.weights.model_copy(update={"inspection": 0.0})  # what is inspected is in the stops
    inspection = _inspection(scene).model_copy(update={"assignment": None, "share_min": 0.0})
    ending = f"-round-{number}"
    changed = question.model_copy(
        update={
            "name": f"{question.name[: _NAME_MAX - len(ending)]}{ending}",
            "description": f"{question.description} (round {number} of the inspection {question.name})".strip(),
            "area": Area(south_west=Place(x_m=west, y_m=south), north_east=Place(x_m=east, y_m=north)),
            "vehicles": tuple(vehicles),
            "fleet": _fleet(question.fleet, [vehicle.name for vehicle in vehicles]),
            "inspection": inspection,
            "planner": question.planner.model_copy(update={"weights": weights}),
        }
    )
    # as it will be read again: what was not validated yet is
    return Mission.model_validate(changed.model_dump(mode="json", by_alias=True, exclude_unset=True))


def stops(tour: Tour) -> tuple[Stop, ...]:
    """Return what a vehicle's tour is in a mission file."""
    return tuple(_stop(viewpoint) for viewpoint in _viewpoints(tour))


def _fleet(fleet: Fleet, names: Sequence[str]) -> Fleet:
    """Return the rules of a round: all land together only where the mission asks for it."""
    together = fleet.arrive_together and bool({"arrive_together", "arrival_order"} & fleet.model_fields_set)
    changes: dict[str, object] = {"arrive_together": together}
    if fleet.arrival_order:
        order = tuple(name for name in fleet.arrival_order if name in names)
        changes |= {"arrival_order": order} if len(order) > 1 else {"arrival_order": (), "arrival_spacing_s": 0.0}
    return fleet.model_copy(update=changes)


def _viewpoints(tour: Tour) -> list[Viewpoint]:
    return [viewpoint for visit in tour.visits for viewpoint in visit.viewpoints]


def _stop(viewpoint: Viewpoint) -> Stop:
    action = viewpoint.action
    x_m, y_m, z_m = map(float, viewpoint.position_m)
    given: dict[str, object] = {"x_m": x_m, "y_m": y_m, "alt_amsl_m": z_m}
    if action.look_at_m is not None:
        x_m, y_m, z_m = map(float, action.look_at_m)
        given["look_at"] = Point(x_m=x_m, y_m=y_m, alt_amsl_m=z_m)
    if action.look_deg is not None:
        heading_deg, pitch_deg = map(float, action.look_deg)
        given["look"] = Direction(heading_deg=heading_deg, pitch_deg=pitch_deg)
    done = {
        "name": action.name,
        "inspects": action.inspects,
        "hold_s": float(action.hold_s),
        "photos": action.photos,
        "photo_every_m": float(action.photo_every_m),
    }
    given |= {field: value for field, value in done.items() if value}
    return Stop.model_validate(given)


class _ReassignError(Exception):
    """A round cannot be flown as it is: less is asked of somebody, or a target is left out."""


@dataclass(slots=True)
class _Search:
    """The rounds while they are looked for, and what was learned on the way."""

    scene: Scene
    folder: Path
    seed: int
    watch: Watch
    done: frozenset[str]
    visits: tuple[Visit, ...]
    left_out: dict[str, LeftOut]
    budget: list[float] = field(init=False)
    _todo: tuple[Visit, ...] = field(init=False)
    _costs: TravelCosts = field(init=False)
    _barred: dict[tuple[int, str], str] = field(init=False, default_factory=dict)
    _known: dict[tuple[object, ...], Round] = field(init=False, default_factory=dict)
    _problem: InfeasibleError | None = field(init=False, default=None)

    def __post_init__(self) -> None:
        self.budget = [_SPARE * (1.0 - vehicle.reserve_share) for vehicle in self.scene.mission.vehicles]
        self._todo = tuple(visit for visit in self.visits if visit.target not in self.done)
        self._costs = travel_costs(self.scene, self._todo)

    def plan(self) -> InspectionPlan:
        for _ in range(_ATTEMPTS):
            self.watch("assignment", 0.0)
            found = assign(
                self.scene,
                self._todo,
                seed=self.seed,
                budget_share=self.budget,
                done=self.done,
                barred=self._barred,
                costs=self._costs,
            )
            self.watch("assignment", 1.0)
            try:
                rounds = self._rounds(found)
            except _ReassignError:
                continue
            left_out = {**{left.target: left for left in found.left_out}, **self.left_out}
            tours = tuple(tour for round_ in rounds for tour in round_.tours)
            return InspectionPlan(
                scene=self.scene,
                visits=self.visits,
                rounds=rounds,
                left_out=tuple(left for target, left in left_out.items() if target not in self.done),
                assignment=replace(found, tours=tours),
                done=self.done,
                seed=self.seed,
            )
        raise InfeasibleError(f"the towers were shared out {_ATTEMPTS} times, and still: {self._problem}")

    def _rounds(self, found: Assignment) -> tuple[Round, ...]:
        rounds: list[Round] = []
        waiting = _by_round(found.tours)
        while waiting:
            try:
                rounds.append(self._round(waiting[0], len(rounds) + 1))
                del waiting[0]
            except InfeasibleError as error:
                self._problem = error
                waiting = self._changed(waiting, len(rounds) + 1, error)
        return tuple(replace(r, tours=tuple(replace(tour, round=k) for tour in r.tours)) for k, r in enumerate(rounds))

    def _round(self, tours: Sequence[Tour], number: int) -> Round:
        key = (number, *((tour.vehicle, tuple(_signature(tour))) for tour in tours))
        if key not in self._known:
            self._known[key] = self._planned(tours, number)
        return self._known[key]

    def _planned(self, tours: Sequence[Tour], number: int) -> Round:
        """Return the planned round.

        Raises
        ------
        InfeasibleError
            It is not safe, or not possible at all.
        """

        def watch(vehicle: str, done: float) -> None:
            self.watch(f"{vehicle}, round {number}", done)

        try:
            scene = build_scene(round_mission(self.scene, tours, number), self.folder)
        except MissionError as error:  # it speaks of a mission that the user has not written
            raise InfeasibleError(f"round {number}: {error}") from error
        return Round(scene, planner.plan_fleet(scene, seed=self.seed, watch=watch), tuple(tours))

    def _changed(self, waiting: list[tuple[Tour, ...]], number: int, error: InfeasibleError) -> list[tuple[Tour, ...]]:
        """Return the rounds from one on that was not proven, with changes that may help.

        Raises
        ------
        _ReassignError
            All is to be shared out again.
        """
        tours = waiting[0]
        if self._less_energy(tours, error):
            return self._relieved(waiting)
        pair = isinstance(error, UnreturnableError) and len(error.vehicles) > 1
        if pair and len(tours) > 1:
            unable = []
        elif len(tours) > 1:
            alone = [(tour, self._alone(tour, number)) for tour in tours]
            unable = [(tour, problem) for tour, problem in alone if problem is not None]
        else:
            unable = [(tours[0], error)]
        again, short = False, False
        for tour, problem in unable:
            if self._less_energy([tour], problem):
                short = True
            elif self._without_ways(tour, number):
                again = True
            else:  # each of its visits can be flown, but not one after the other
                waiting = self._halved(waiting, tour, problem)
        if again:
            raise _ReassignError
        if short:
            return self._relieved(waiting)
        return waiting if unable else self._later(waiting, (self._disturbed(tours, error),))

    def _relieved(self, waiting: list[tuple[Tour, ...]]) -> list[tuple[Tour, ...]]:
        """Return rounds in which tours that take too much have left some to others."""
        tours = [tour for round_ in waiting for tour in round_]
        found = relieved(
            self.scene, self._todo, tours, budget_share=self.budget, barred=self._barred, costs=self._costs
        )
        if found is None:
            raise _ReassignError
        return _by_round(found)

    def _later(self, waiting: list[tuple[Tour, ...]], moved: Sequence[Tour]) -> list[tuple[Tour, ...]]:
        """Return rounds of which the first is without some tours; these are one round of their own, the next."""
        first = tuple(tour for tour in waiting[0] if tour not in moved)
        return _numbered([first, tuple(moved), *waiting[1:]])

    def _halved(self, waiting: list[tuple[Tour, ...]], tour: Tour, problem: InfeasibleError) -> list[tuple[Tour, ...]]:
        """Return rounds in which the second half of a tour is flown in the next in which its vehicle has none.

        Raises
        ------
        InfeasibleError
            It is a single visit, or there would be more sorties than are allowed.
        """
        assignment = _assignment(self.scene)
        most = 1 if assignment.objective == "priority" else assignment.sorties_max
        free = next((k for k, r in enumerate(waiting) if k > 0 and all(t.vehicle != tour.vehicle for t in r)), None)
        if len(tour.visits) < 2 or (free is None and tour.round + len(waiting) >= most):
            raise InfeasibleError(f"{self.scene.tasks[tour.vehicle].name}: its tour is not proven: {problem}")
        middle = len(tour.visits) // 2
        halves = [replace(tour, visits=tour.visits[:middle]), replace(tour, visits=tour.visits[middle:])]
        changed = [list(round_) for round_ in waiting]
        changed[0] = [halves[0] if other.vehicle == tour.vehicle else other for other in changed[0]]
        if free is None:
            changed.append([halves[1]])
        else:
            changed[free].append(halves[1])
        return _numbered(changed)

    def _alone(self, tour: Tour, number: int) -> InfeasibleError | None:
        """Return why a tour cannot be flown even alone; None: it can."""
        try:
            self._planned([tour], number)
        except InfeasibleError as error:
            return error
        return None

    def _less_energy(self, tours: Sequence[Tour], error: InfeasibleError) -> bool:
        """Let those take less of their batteries of whom too little was left; False where it is not about that."""
        if not isinstance(error, UnprovenError):
            return False
        names = {self.scene.tasks[tour.vehicle].name: tour for tour in tours}
        short = [f for f in error.problems if f.check == "energy" and f.vehicle in names]
        for finding in short:
            tour = names[finding.vehicle]
            if len({visit.target for visit in tour.visits}) == 1:
                why = f"{finding.vehicle} cannot fly to it alone: {finding}"
                self._barred[tour.vehicle, tour.visits[0].target] = why
                continue
            fits = 1.0
            if finding.value and finding.required and finding.unit == "":
                fits = min(1.0, finding.required / finding.value)
            reckoned = min(tour.energy_share or math.inf, self.budget[tour.vehicle])
            self.budget[tour.vehicle] = reckoned * fits * _TIGHTER
        return bool(short)

    def _without_ways(self, tour: Tour, number: int) -> bool:
        """Bar a vehicle from the targets of its tour that it cannot fly to even alone; False where there are none.

        Others that cannot, either, are barred until one is found that can, the nearest first.
        """
        found = False
        for visit in tour.visits:
            if self._bars(tour.vehicle, visit, number):
                found = True
                at_m = visit.viewpoints[0].position_m
                away_m = [float(math.dist(task.home_m[:2], at_m[:2])) for task in self.scene.tasks]
                for v in sorted(range(len(away_m)), key=away_m.__getitem__):
                    if v != tour.vehicle and not self._bars(v, visit, number):
                        break
        return found

    def _bars(self, vehicle: int, visit: Visit, number: int) -> bool:
        """Whether a vehicle cannot fly to a visit even alone; it is barred from the target then."""
        if (vehicle, visit.target) in self._barred:
            return True
        problem = self._alone(Tour(vehicle, 0, (visit,), 0.0, 0.0), number)
        if problem is not None:
            name = self.scene.tasks[vehicle].name
            why = f"{visit.name}: {name} cannot be shown to fly there and back: {problem}"
            self._barred[vehicle, visit.target] = why
        return problem is not None

    def _disturbed(self, tours: Sequence[Tour], error: InfeasibleError) -> Tour:
        """Return whose tour is flown later: the shorter one of the two that are named, else the shortest of all."""
        names = [self.scene.tasks[tour.vehicle].name for tour in tours]
        named: set[str] = set()
        if isinstance(error, UnreturnableError):
            named = set(error.vehicles)
        elif isinstance(error, UnprovenError):
            named = {name for finding in error.problems for name in finding.vehicle.split(" - ")}
        among = [tour for tour, name in zip(tours, names, strict=True) if name in named] or list(tours)
        return min(among, key=lambda tour: tour.time_s)


def _by_round(tours: Sequence[Tour]) -> list[tuple[Tour, ...]]:
    numbers = sorted({tour.round for tour in tours})
    return [
        tuple(sorted((t for t in tours if t.round == number and t.visits), key=lambda t: t.vehicle))
        for number in numbers
    ]


def _numbered(rounds: Sequence[Sequence[Tour]]) -> list[tuple[Tour, ...]]:
    """Return rounds whose tours say so, after those before them; without empty ones."""
    first = min(tour.round for round_ in rounds for tour in round_)
    filled = [round_ for round_ in rounds if round_]
    return [tuple(replace(tour, round=first + k) for tour in round_) for k, round_ in enumerate(filled)]


def _signature(tour: Tour) -> Iterator[str]:
    """Yield what tells a tour from another: its viewpoints' names, or places, in their order."""
    for viewpoint in _viewpoints(tour):
        yield f"{viewpoint.action.name} {viewpoint.position_m.tolist()}"


def _expect_share(plan: InspectionPlan) -> None:
    least = plan.share_min
    nothing = not plan.rounds and not plan.done
    if plan.share >= least - 1e-9 and not (nothing and plan.left_out):
        return
    told = [f"{left.target}: {left.why}" for left in plan.left_out]
    more = f"; and {len(told) - 3} more" if len(told) > 3 else ""
    raise InfeasibleError(
        f"inspection.share_min: expected {least:.0%} of the towers' weight (eq. 6), got {plan.share:.1%}: left out are "
        f"{'; '.join(told[:3])}{more}"
    )


def _inspection(scene: Scene) -> Inspection:
    inspection = scene.mission.inspection
    assert inspection is not None
    return inspection


def _assignment(scene: Scene) -> mission.Assignment:
    assignment = _inspection(scene).assignment
    assert assignment is not None
    return assignment


def _no_watch(vehicle: str, done: float) -> None:
    del vehicle, done
