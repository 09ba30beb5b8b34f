"""A watched fleet is kept together by command: over MAVLink, with what links and vehicles do to it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.telemetry_log import FleetLog, read_log
from missionplanner import timing
from missionplanner.errors import LinkError
from missionplanner.pacing import Course, Meeting, Pacer, Rules
from missionplanner.plan import FleetFlight, FleetPlan
from missionplanner.plan_folder import load_flight, save_flight
from missionplanner.vehicle import Autopilot
from sim.fleet import planned_vehicles
from tests.plans import fleet_plan, vehicle_plan
from tests.rig import Rig

CHANGE_SPEED = mavlink.MAV_CMD_DO_CHANGE_SPEED


def long_fleet(autopilot: Autopilot = "ardupilot") -> FleetPlan:
    """Two copters side by side, half a minute or more from a goal."""
    return fleet_plan(
        *(
            vehicle_plan(
                f"uav{k}",
                k,
                autopilot=autopilot,
                home_m=(0.0, 60.0 * k, 1200.0),
                waypoints_m=[(200.0 * w, 60.0 * k, 1225.0) for w in range(5)],
                speed_m_s=6.0,
            )
            for k in (1, 2)
        )
    )


def courses(plan: FleetPlan, limits_m_s: tuple[float, float] = (3.0, 10.0)) -> list[Course]:
    """Return what the fleet flies, timed by the motion model."""
    found = []
    for v in plan.vehicles:
        planned, reached_s = timing.predict_flight(
            v.motion, v.home_m, v.waypoints_m, v.speeds_m_s, end=v.end, ground_amsl_m=1190.0
        )
        found.append(
            Course(
                v.name,
                v.motion,
                v.home_m,
                v.waypoints_m,
                v.speeds_m_s,
                v.hold_s,
                v.end,
                planned,
                reached_s,
                float(reached_s[-1]),
                *limits_m_s,
            )
        )
    return found


class Late(Rig):
    """The first vehicle takes off 8 s late."""

    def __init__(self, plan: FleetPlan, log: FleetLog | None = None) -> None:
        super().__init__(plan, log=log, vehicles=planned_vehicles(plan, late_s={"uav1": 8.0}))
        self.told: list[str] = []

    def fly(self, *, correct: bool = True, rules: Rules | None = None) -> FleetFlight:
        self.upload()
        self.link.start()
        pacer = Pacer(courses(self.link._plan), lambda _i, _j: 20.0, correct=correct, rules=rules)
        return self.link.watch(pacer=pacer, tell=self.told.append)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_late_vehicle_catches_up(autopilot: Autopilot, tmp_path: Path) -> None:
    plan = long_fleet(autopilot)
    with FleetLog(tmp_path / "logs", {v.sysid: v.name for v in plan.vehicles}, 1.7e9) as log:
        rig = Late(plan, log)
        flight = rig.fly()
    spread_s = flight.arrival_spread_s
    assert spread_s is not None
    assert spread_s <= 1.0
    assert flight.corrections
    assert {c.vehicle for c in flight.corrections if c.to_m_s > c.from_m_s} == {"uav1"}
    assert all(c.obeyed and 3.0 <= c.to_m_s <= 10.0 for c in flight.corrections)
    assert "late" in flight.corrections[0].why
    assert any("uav1: 6.00 to" in line for line in rig.told)
    notes = [m.text for _, m in read_log(tmp_path / "logs" / "fleet.tlog").records if m.get_type() == "STATUSTEXT"]
    assert any("uav1: 6.00 to" in note for note in notes)
    late = flight.vehicles[0].lateness
    assert late is not None
    assert late.lateness_s.max() == pytest.approx(8.0, abs=0.6)
    assert abs(late.lateness_s[-1]) < 4.0
    save_flight(tmp_path, flight)
    again = load_flight(tmp_path, plan)
    assert again is not None
    assert again.corrections == flight.corrections
    assert again.vehicles[0].lateness is not None
    np.testing.assert_allclose(again.vehicles[0].lateness.arrival_s, late.arrival_s, atol=0.006)
    assert json.loads((tmp_path / "flight.json").read_text())["corrections"][0]["vehicle"] == "uav1"


def test_only_watching_commands_nothing_and_tells_how_late_all_are() -> None:
    rig = Late(long_fleet())
    flight = rig.fly(correct=False)
    assert flight.corrections == ()
    assert flight.arrival_spread_s == pytest.approx(8.0, abs=0.6)
    assert flight.vehicles[0].lateness is not None
    assert flight.vehicles[0].lateness.lateness_s[-1] == pytest.approx(8.0, abs=0.6)


def test_a_refused_speed_is_told_and_given_up() -> None:
    rig = Late(long_fleet())

    def refuse(message: Any) -> Any:
        if message.get_type() == "COMMAND_ACK" and message.command == CHANGE_SPEED:
            message.result = mavlink.MAV_RESULT_FAILED
        return message

    for pipe in rig.pipes:
        pipe.down = refuse
    flight = rig.fly(rules=Rules(interval_s=5.0))
    first = [c for c in flight.corrections if c.vehicle == "uav1"]
    assert len(first) == Rules().tries
    assert not any(c.obeyed for c in flight.corrections)
    assert any("refused" in line for line in rig.told)
    assert any("left at its speed" in line for line in rig.told)


def test_a_speed_that_is_not_answered_is_asked_again_and_given_up() -> None:
    rig = Late(long_fleet())
    sent: list[float] = []

    def swallow(message: Any) -> Any:
        if message.get_type() == "COMMAND_LONG" and message.command == CHANGE_SPEED:
            sent.append(message.param2)
            return None
        return message

    rig.pipes[0].up = swallow
    flight = rig.fly(rules=Rules(interval_s=2.0))
    assert len(sent) > len([c for c in flight.corrections if c.vehicle == "uav1"]) > 0
    assert any("did not answer" in line for line in rig.told)
    assert all(v.arrival_s is not None for v in flight.vehicles)


def test_a_bad_link_does_not_keep_the_fleet_apart() -> None:
    rig = Late(long_fleet())
    rig.lose(0.2, seed=7)
    flight = rig.fly()
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s <= 1.8
    assert any(c.obeyed for c in flight.corrections)


def test_who_is_sent_home_ends_all_corrections() -> None:
    plan = long_fleet()
    rig = Late(plan)
    rig.upload()
    rig.link.start()
    rtl = rig.sim.links[1].autopilot
    clock_wait = rig.clock.wait
    start_s = rig.clock.now_s()
    sent = False

    def wait(seconds: float) -> None:
        nonlocal sent
        clock_wait(seconds)
        if not sent and rig.clock.now_s() > start_s + 25.0:
            sent = True
            rtl.set_mode(rtl.personality.mode("RTL"), rig.clock.now_s())

    rig.clock.wait = wait  # type: ignore[method-assign]
    told: list[str] = []
    flight = rig.link.watch(pacer=Pacer(courses(plan), lambda _i, _j: 20.0), tell=told.append)
    assert all(c.t_s < 27.0 for c in flight.corrections)
    assert any("uav2 has left its mission" in line for line in told)


class Stopping(Rig):
    """The second takes off so late that the first is stopped for a while: it can hardly fly slower."""

    def __init__(self) -> None:
        plan = long_fleet()
        super().__init__(plan, vehicles=planned_vehicles(plan, late_s={"uav2": 18.0}))
        self.told: list[str] = []

    def begin(self) -> None:
        self.upload()
        self.link.start()

    def watch(self) -> FleetFlight:
        which = courses(self.link._plan, (5.9, 6.0))
        pacer = Pacer(which, lambda _i, _j: 20.0, hold=True, rules=Rules(hold_s=2.0))
        return self.link.watch(pacer=pacer, tell=self.told.append)

    def when_it_stands(self, then: Callable[[], None]) -> None:
        """Do something once the first has been standing for 5 s."""
        wait = self.clock.wait
        since_s: list[float] = []

        def waited(seconds: float) -> None:
            wait(seconds)
            if self.sim.links[0].autopilot.paused:
                since_s.append(self.clock.now_s())
                if self.clock.now_s() > since_s[0] + 5.0:
                    self.clock.wait = wait  # type: ignore[method-assign]
                    then()

        self.clock.wait = waited  # type: ignore[method-assign]

    @property
    def stands(self) -> bool:
        return self.sim.links[0].autopilot.paused


def test_who_is_stopped_goes_on_and_arrives_with_the_other() -> None:
    rig = Stopping()
    rig.begin()
    flight = rig.watch()
    assert any(c.to_m_s == 0.0 for c in flight.corrections)
    assert flight.arrival_spread_s is not None
    assert flight.arrival_spread_s <= 4.5  # of 18 s: a tenth of a metre per second corrects little


@pytest.mark.parametrize("ends_by", [KeyboardInterrupt, OSError, LinkError])
def test_nobody_is_left_standing_when_a_watch_ends_early(ends_by: type[BaseException]) -> None:
    rig = Stopping()
    rig.begin()

    def end() -> None:
        raise ends_by("over")

    rig.when_it_stands(end)
    with pytest.raises(ends_by, match="over"):
        rig.watch()
    assert not rig.stands
    assert any("uav1: stood to lose time, and told to go on" in line for line in rig.told)


def test_who_does_not_confirm_that_it_goes_on_is_named_when_a_watch_ends_early() -> None:
    rig = Stopping()
    rig.begin()

    def end() -> None:
        rig.pipes[0].up = lambda _message: None
        raise LinkError("over")

    rig.when_it_stands(end)
    with pytest.raises(LinkError, match=r"over; uav1 .*it may stand by our command; take over by hand"):
        rig.watch()


def test_links_that_fail_leave_the_name_of_who_may_stand() -> None:
    rig = Stopping()
    rig.begin()

    def broken() -> None:
        raise OSError("no such device")

    def end() -> None:
        rig.link._station.exchange = broken  # type: ignore[method-assign]

    rig.when_it_stands(end)
    with pytest.raises(OSError, match="no such device"):
        rig.watch()
    assert any(line.startswith("uav1 may stand by our command (no such device)") for line in rig.told)


def test_a_stop_whose_answer_is_lost_is_undone() -> None:
    rig = Stopping()
    rig.begin()

    def lose(message: Any) -> Any:
        stop = message.get_type() == "COMMAND_ACK" and message.command == mavlink.MAV_CMD_DO_PAUSE_CONTINUE
        return None if stop and rig.stands else message

    rig.pipes[0].down = lose
    flight = rig.watch()
    stops = [c for c in flight.corrections if c.to_m_s == 0.0]
    assert stops
    assert not stops[0].obeyed
    assert any("it did not answer; it may stand" in line for line in rig.told)
    assert all(v.arrival_s is not None for v in flight.vehicles)


def test_long_before_the_watch_gives_up_nobody_stands_any_more() -> None:
    rig = Stopping()
    rig.begin()
    longest_s = max(float(v.trajectory.t_s[-1]) for v in rig.link._plan.vehicles)

    which = courses(rig.link._plan, (5.9, 6.0))
    pacer = Pacer(which, lambda _i, _j: 20.0, hold=True, rules=Rules(hold_s=2.0))
    pacer._going_on = lambda *_: ((), "")  # type: ignore[method-assign, assignment]
    begun_s = rig.clock.now_s()
    flight = rig.link.watch(pacer=pacer, tell=rig.told.append)
    assert any(c.to_m_s == 0.0 for c in flight.corrections)
    assert all(v.arrival_s is not None for v in flight.vehicles)
    assert rig.clock.now_s() - begun_s < 2.0 * longest_s + 120.0


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_when_vehicles_were_where_they_were_to_meet_is_recorded(autopilot: Autopilot) -> None:
    rig = Late(long_fleet(autopilot))
    rig.upload()
    rig.link.start()
    which = courses(rig.link._plan)
    pacer = Pacer(which, lambda _i, _j: 20.0, meetings=(Meeting("tea", {0: 1, 1: 2}),), correct=False)
    flight = rig.link.watch(pacer=pacer, tell=rig.told.append)
    (tea,) = flight.meetings
    assert tea.name == "tea"
    for name, k, waypoint, late_s in (("uav1", 0, 1, 8.0), ("uav2", 1, 2, 0.0)):
        assert tea.times_s[name] == pytest.approx(float(which[k].reached_s[waypoint]) + late_s, abs=1.5)
    assert sum("rendezvous tea is missed" in line for line in rig.told) == 1


def test_who_never_comes_to_a_meeting_has_no_time_there() -> None:
    rig = Late(long_fleet())
    rig.upload()
    rig.link.start()
    rig.sim.advance(15.0)
    rig.link.order("land")
    pacer = Pacer(courses(rig.link._plan), lambda _i, _j: 20.0, meetings=(Meeting("tea", {0: 3, 1: 3}),))
    (tea,) = rig.link.watch(pacer=pacer).meetings
    assert tea.times_s == {"uav1": None, "uav2": None}
    assert tea.spread_s is None
