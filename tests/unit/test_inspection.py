"""Rounds of an inspection: what of them is planned, shared out again, flown later, left out, and refused."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from missionplanner import inspection
from missionplanner.assignment import Assignment, Tour
from missionplanner.certificate import Finding
from missionplanner.errors import InfeasibleError, MissionError
from missionplanner.inspection import InspectionPlan, plan_inspection, round_mission
from missionplanner.mission import Mission
from missionplanner.plan import FleetPlan
from missionplanner.planner import UnprovenError
from missionplanner.returns import UnreturnableError
from missionplanner.scene import Scene, build_scene
from missionplanner.views import LeftOut, Visit
from tests.lines import open_question
from tests.plans import vehicle_plan
from tests.scenes import question


def opened(**changes: Any) -> Mission:
    return Mission.model_validate(open_question(**{"assignment": {"iterations": 50}} | changes))


@pytest.fixture(scope="module")
def plan() -> InspectionPlan:
    return plan_inspection(opened(), Path())


def straight(scene: Scene) -> FleetPlan:
    """Return a plan of straight ways that nobody searched for or proved."""
    vehicles = []
    for task in scene.tasks:
        plan = vehicle_plan(task.name, task.sysid, home_m=tuple(task.home_m.tolist()), waypoints_m=task.route_m)
        vehicles.append(replace(plan, actions=task.actions))
    return FleetPlan(scene.mission, scene.frame, tuple(vehicles), None, None, 1, "0", scene.input_sha256)


def in_turn(
    scene: Scene,
    visits: Sequence[Visit],
    *,
    budget_share: Sequence[float],
    done: Collection[str],
    barred: Mapping[tuple[int, str], str],
    **_: Any,
) -> Assignment:
    """Share out targets to the vehicles in turn, or the next that is not barred, all in one round."""
    assert not {visit.target for visit in visits} & set(done)
    count = len(budget_share)
    owner: dict[str, int | None] = {}
    for k, target in enumerate(dict.fromkeys(visit.target for visit in visits)):
        turns = [(k + n) % count for n in range(count)]
        owner[target] = next((v for v in turns if (v, target) not in barred), None)
    tours = []
    for v, share in enumerate(budget_share):
        mine = tuple(visit for visit in visits if owner[visit.target] == v)
        if mine:
            tours.append(Tour(v, 0, mine, 100.0 - v, share))
    left_out = tuple(LeftOut(target, barred[0, target]) for target, v in owner.items() if v is None)
    return Assignment(tuple(tours), left_out, 100.0, 0.0)


Problem = Callable[[Scene], None]


@pytest.fixture
def planned_unless(monkeypatch: pytest.MonkeyPatch) -> Callable[[Problem], list[Sequence[float]]]:
    """Let rounds be straight ways, unless a problem raises; return the budgets that towers were shared out with."""

    def install(problem: Problem) -> list[Sequence[float]]:
        budgets: list[Sequence[float]] = []

        def plan_fleet(scene: Scene, **_: Any) -> FleetPlan:
            problem(scene)
            return straight(scene)

        def assign(*args: Any, **options: Any) -> Assignment:
            budgets.append(tuple(options["budget_share"]))
            return in_turn(*args, **options)

        monkeypatch.setattr(inspection.planner, "plan_fleet", plan_fleet)
        monkeypatch.setattr(inspection, "assign", assign)
        return budgets

    return install


def fine(scene: Scene) -> None:
    del scene


def names(scene: Scene) -> list[str]:
    return [task.name for task in scene.tasks]


def visits_of(plan: InspectionPlan) -> list[str]:
    return [visit.name for tour in plan.tours for visit in tour.visits]


def test_every_visit_is_flown_once_and_as_its_tour_says(plan: InspectionPlan) -> None:
    assert sorted(visits_of(plan)) == sorted(visit.name for visit in plan.visits)
    assert plan.share == 1.0
    assert not plan.left_out
    for number, round_ in enumerate(plan.rounds, start=1):
        assert round_.plan.certificate is not None
        assert round_.plan.certificate.proven
        assert round_.scene.mission.name == f"small-round-{number}"
        for tour in round_.tours:
            task = next(t for t in round_.scene.tasks if t.sysid == plan.scene.tasks[tour.vehicle].sysid)
            wanted = [viewpoint for visit in tour.visits for viewpoint in visit.viewpoints]
            assert np.allclose(task.route_m[1:-1], [v.position_m for v in wanted], atol=0.0)
            assert [task.actions[k + 1] for k in range(len(wanted))] == [v.action for v in wanted]
            flown = next(v for v in round_.plan.vehicles if v.name == task.name)
            assert [a.name for _, a in sorted(flown.actions.items()) if a.name] == [v.action.name for v in wanted]


def test_the_same_seed_gives_the_same_inspection(plan: InspectionPlan) -> None:
    again = plan_inspection(opened(), Path())
    assert visits_of(again) == visits_of(plan)
    for one, other in zip(plan.rounds, again.rounds, strict=True):
        assert one.scene.input_sha256 == other.scene.input_sha256
        for a, b in zip(one.plan.vehicles, other.plan.vehicles, strict=True):
            assert np.array_equal(a.waypoints_m, b.waypoints_m)


def test_a_rounds_mission_stands_alone(plan: InspectionPlan) -> None:
    """Written and read it is the same: sysids, area and stops do not depend on who else is in it."""
    (first, *_) = plan.rounds
    (tour, *_) = first.tours
    alone = round_mission(plan.scene, [tour], 1)
    again = Mission.model_validate(alone.model_dump(mode="json", by_alias=True, exclude_unset=True))
    assert again == alone
    assert not alone.is_open
    assert [v.sysid for v in alone.vehicles] == [plan.scene.tasks[tour.vehicle].sysid]
    assert build_scene(alone, Path()).area_m == pytest.approx(plan.scene.area_m)


def test_rounds_land_when_they_may_unless_asked_to_land_together() -> None:
    scene = inspection.open_scene(opened(), Path())
    visits, _ = inspection.views.visits(scene)
    tours = [Tour(k, 0, (visits[k],), 10.0, 0.1) for k in (0, 1)]
    assert not round_mission(scene, tours, 1).fleet.arrive_together
    asked = inspection.open_scene(opened(fleet={"arrive_together": True}), Path())
    assert round_mission(asked, tours, 1).fleet.arrive_together
    order = {"arrival_order": ["bravo", "alpha"], "arrival_spacing_s": 20.0}
    ordered = inspection.open_scene(opened(fleet=order), Path())
    assert round_mission(ordered, tours, 1).fleet.arrival_order == ("bravo", "alpha")
    assert round_mission(ordered, tours[:1], 1).fleet.arrival_spacing_s == 0.0


def test_who_has_too_little_energy_gets_less_to_do(planned_unless: Any) -> None:
    """The first tour of alpha takes a tenth too much: the next takes so much less of its battery."""
    told: list[str] = []

    def problem(scene: Scene) -> None:
        if not told:
            told.append("takes 88% of its battery")
            raise UnprovenError([Finding("energy", "alpha", False, told[0], "", 0.88, 0.8, "")])

    budgets = planned_unless(problem)
    plan = plan_inspection(opened(), Path())
    assert plan.share == 1.0
    assert budgets[0][0] == budgets[0][1] < 0.8
    assert budgets[1][0] == pytest.approx(budgets[0][0] * (0.8 / 0.88) * 0.985)
    assert budgets[1][1] == budgets[0][1]


def test_what_one_has_no_way_to_is_anothers(planned_unless: Any) -> None:
    """No tower is lost for one vehicle's sake, and no more is shared out again than must be."""

    def problem(scene: Scene) -> None:
        for task in scene.tasks:
            if task.name == "alpha" and any(action.inspects == "T1" for action in task.actions.values()):
                raise InfeasibleError("alpha: no way from stop 1 to stop 2: a wall")

    budgets = planned_unless(problem)
    plan = plan_inspection(opened(), Path())
    assert not plan.left_out
    assert plan.share == 1.0
    assert len(budgets) == 2
    for tour in plan.tours:
        assert tour.vehicle == 1 or all(visit.target != "T1" for visit in tour.visits)


def test_a_tour_that_is_not_proven_as_a_whole_is_flown_in_parts(planned_unless: Any) -> None:
    """Though nothing is known of batteries: at most so many stops in one sortie of alpha; the rest later."""

    def problem(scene: Scene) -> None:
        for task in scene.tasks:
            if task.name == "alpha" and len(task.actions) > 2:
                raise InfeasibleError("alpha: it drifts")

    vehicles = [{"name": name, "home": {"x_m": -150.0, "y_m": y}} for name, y in (("alpha", -50.0), ("bravo", 0.0))]
    budgets = planned_unless(problem)
    plan = plan_inspection(opened(vehicles=vehicles), Path())
    assert len(budgets) == 1
    assert plan.share == 1.0
    assert [len(round_.tours) for round_ in plan.rounds] == [2, 1]
    assert sorted(visits_of(plan)) == sorted(visit.name for visit in plan.visits)
    with pytest.raises(InfeasibleError, match="alpha: its tour is not proven: alpha: it drifts"):
        plan_inspection(opened(vehicles=vehicles, assignment={"objective": "priority"}), Path())


def test_rounds_that_stay_as_they_are_are_planned_once(planned_unless: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tour of a later round takes too much: it leaves a visit to another of that round; the first round stands."""
    planned: list[list[str]] = []

    def problem(scene: Scene) -> None:
        planned.append(names(scene))
        if len(planned) == 2:
            raise UnprovenError([Finding("energy", "alpha", False, "takes 88% of its battery", "", 0.88, 0.8, "")])

    def one_tower_first(*args: Any, **options: Any) -> Assignment:
        found = in_turn(*args, **options)
        alpha, bravo = (replace(tour, energy_share=0.03) for tour in found.tours)
        first = replace(alpha, visits=alpha.visits[:1])
        return replace(found, tours=(first, replace(alpha, visits=alpha.visits[1:], round=1), replace(bravo, round=1)))

    planned_unless(problem)
    monkeypatch.setattr(inspection, "assign", one_tower_first)
    plan = plan_inspection(opened(defaults={"endurance_s": 1500.0}), Path())
    assert planned[:2] == [["alpha"], ["alpha", "bravo"]]
    assert len(planned) == 3
    assert "bravo" in planned[2]
    assert plan.share == 1.0
    assert sorted(visits_of(plan)) == sorted(visit.name for visit in plan.visits)


def test_two_who_disturb_each_other_fly_one_after_the_other(planned_unless: Any) -> None:
    def problem(scene: Scene) -> None:
        if len(scene.tasks) > 1:
            raise UnreturnableError("alpha - bravo: no heights part them", ("alpha", "bravo"), 100.0)

    planned_unless(problem)
    plan = plan_inspection(opened(), Path())
    assert [names(round_.scene) for round_ in plan.rounds] in ([["alpha"], ["bravo"]], [["bravo"], ["alpha"]])
    assert [tour.round for tour in plan.tours] == [0, 1]
    assert plan.share == 1.0
    assert plan.makespan_s == pytest.approx(sum(r.lasts_s for r in plan.rounds) + plan.swap_s)


def _no_way_to(tower: str) -> Callable[[Scene], None]:
    def problem(scene: Scene) -> None:
        for task in scene.tasks:
            if any(action.inspects == tower for action in task.actions.values()):
                raise InfeasibleError(f"{task.name}: no way from stop 1 to stop 2: a wall")

    return problem


def test_less_than_asked_for_is_refused_by_name(planned_unless: Any) -> None:
    planned_unless(_no_way_to("T2"))
    with pytest.raises(InfeasibleError, match=r"inspection.share_min: expected 100%.*got 66.7%.*T2: T2\.\w+:.*a wall"):
        plan_inspection(opened(), Path())


def test_what_has_no_way_is_left_out_by_name(planned_unless: Any) -> None:
    planned_unless(_no_way_to("T2"))
    plan = plan_inspection(opened(share_min=0.6), Path())
    assert set(plan.inspected) == {"T1", "T3"}
    assert [left.target for left in plan.left_out] == ["T2"]
    assert "a wall" in plan.left_out[0].why
    assert plan.share == pytest.approx(2 / 3)


def test_a_round_that_is_never_proven_ends_in_a_refusal(planned_unless: Any) -> None:
    def problem(scene: Scene) -> None:
        raise UnprovenError([Finding("lateness", "", False, "they drift")])

    planned_unless(problem)
    with pytest.raises(InfeasibleError, match="they drift"):
        plan_inspection(opened(share_min=0.0), Path())


def test_what_is_done_is_not_asked_for_again(planned_unless: Any) -> None:
    planned_unless(fine)
    plan = plan_inspection(opened(), Path(), done={"T1", "T3"})
    assert plan.inspected == ("T2",)
    assert plan.share == 1.0
    nothing = plan_inspection(opened(), Path(), done={"T1", "T2", "T3"})
    assert nothing.rounds == ()
    assert nothing.share == 1.0
    with pytest.raises(MissionError, match="expected targets of this mission, got T9"):
        plan_inspection(opened(), Path(), done={"T9"})


def test_a_tower_that_cannot_be_looked_at_is_told(planned_unless: Any) -> None:
    """A mast stands where every view of T2 would be."""
    planned_unless(fine)
    wall = {"kind": "cylinder", "name": "mast", "center": {"x_m": 0.0, "y_m": 200.0}, "radius_m": 90.0}
    with pytest.raises(InfeasibleError, match=r"share_min.*T2: .*mast"):
        plan_inspection(opened(obstacles=[wall]), Path())
    plan = plan_inspection(opened(obstacles=[wall], share_min=0.5), Path())
    assert [left.target for left in plan.left_out] == ["T2"]


def test_nothing_at_all_is_no_plan(planned_unless: Any) -> None:
    planned_unless(fine)
    wall = {"kind": "cylinder", "name": "mast", "center": {"x_m": 0.0, "y_m": 200.0}, "radius_m": 290.0}
    homes = [{"name": "alpha", "home": {"x_m": -600.0, "y_m": -50.0}}]
    with pytest.raises(InfeasibleError, match="left out"):
        plan_inspection(opened(obstacles=[wall], share_min=0.0, vehicles=homes), Path())


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            {"home": {"x_m": -150.0, "y_m": -50.0}},
            r"vehicles\[1\]\.home \(bravo\): expected at least .* home of .*alpha",
        ),
        ({"home": {"x_m": 2.0, "y_m": 100.0}}, r"vehicles\[1\].*\(bravo\), .*obstacle span T1-T2"),
        ({"home": {"x_m": 2.0, "y_m": 200.0}}, r"vehicles\[1\].*\(bravo\), .*from obstacle"),
        ({"takeoff_height_m": 3.0}, r"vehicles\[1\].*\(bravo\), top of the take-off: expected at least"),
    ],
)
def test_a_home_that_nobody_can_use_is_refused_by_name(changes: dict[str, Any], problem: str) -> None:
    homes = [{"name": name, "home": {"x_m": -150.0, "y_m": y}} for name, y in (("alpha", -50.0), ("bravo", 0.0))]
    with pytest.raises(MissionError, match=problem):
        inspection.open_scene(opened(vehicles=[homes[0], homes[1] | changes]), Path())


def test_a_home_on_a_steep_slope_is_refused() -> None:
    hill = [{"x_m": -150.0, "y_m": 30.0, "height_m": 40.0, "spread_m": 25.0}]
    terrain = {"kind": "peaks", "base_alt_amsl_m": 100.0, "cell_m": 5.0, "peaks": hill}
    with pytest.raises(MissionError, match=r"vehicles\[1\]\.home \(bravo\): expected ground of at most"):
        inspection.open_scene(opened(terrain=terrain), Path())


def test_most_weight_in_one_sortie_each_asks_for_no_share(planned_unless: Any) -> None:
    planned_unless(_no_way_to("T2"))
    plan = plan_inspection(opened(assignment={"objective": "priority"}), Path())
    assert plan.share_min == 0.0
    assert len(plan.inspected) == 2
    with pytest.raises(InfeasibleError, match=r"expected 70%.*got 66\.7%"):
        plan_inspection(opened(assignment={"objective": "priority"}, share_min=0.7), Path())


def test_a_mission_that_shares_out_nothing_is_refused() -> None:
    with pytest.raises(MissionError, match=r"inspection\.assignment: expected this field"):
        plan_inspection(Mission.model_validate(question()), Path())
