"""A fleet in flight: orders, gaps in what is heard, and what is said of both."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.fleet_flight import Request
from adapters.fleet_link import FleetLink
from adapters.fleet_vehicle import Order
from adapters.mission_items import WAYPOINT
from adapters.telemetry_log import FleetLog, read_log
from missionplanner.errors import LinkError
from missionplanner.pacing import Pacer, Rules
from missionplanner.plan import FleetPlan, Ordered
from missionplanner.vehicle import Autopilot
from sim.personality import Behaviour
from tests.plans import fleet_plan, small_fleet, vehicle_plan
from tests.rig import Rig
from tests.unit.test_pace_keeper import Stopping, courses


class Script:
    """An operator who gives orders at times after the watch began; each once the one before is answered."""

    def __init__(self, rig: Rig, *steps: tuple[float, Order, tuple[str, ...]]) -> None:
        self.answers: list[Sequence[Ordered]] = []
        self._rig = rig
        self._steps = list(steps)
        self._begun_s = rig.clock.now_s()

    def request(self) -> Request | None:
        if self._steps and self._rig.clock.now_s() - self._begun_s >= self._steps[0][0]:
            _, order, names = self._steps.pop(0)
            return Request(order, frozenset(names))
        return None

    def answer(self, outcomes: Sequence[Ordered]) -> None:
        self.answers.append(outcomes)


def started(plan: FleetPlan, **options: Any) -> Rig:
    rig = Rig(plan, **options)
    rig.upload()
    rig.link.set_returns()
    rig.link.start()
    return rig


def results(outcomes: Sequence[Ordered]) -> list[tuple[str, str]]:
    return [(outcome.vehicle, outcome.result) for outcome in outcomes]


def long_legs(autopilot: Autopilot, count: int = 2) -> FleetPlan:
    """Vehicles whose second leg is set another speed than their first."""
    return fleet_plan(
        *(
            replace(
                vehicle_plan(
                    f"uav{k}",
                    k,
                    autopilot=autopilot,
                    home_m=(0.0, 60.0 * k, 1200.0),
                    waypoints_m=((0, 60 * k, 1225), (100, 60 * k, 1225), (400, 60 * k, 1225)),
                ),
                speeds_m_s=np.array([7.0, 4.0]),
            )
            for k in range(1, count + 1)
        )
    )


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_who_is_paused_stands_and_then_goes_on_to_the_right_item_at_the_right_speed(autopilot: Autopilot) -> None:
    plan = long_legs(autopilot)
    rig = started(plan)
    script = Script(rig, (45.0, "pause", ()), (75.0, "resume", ()))
    told: list[str] = []
    flight = rig.link.watch(tell=told.append, helm=script)
    assert [results(outcomes) for outcomes in script.answers] == [[("uav1", "obeyed"), ("uav2", "obeyed")]] * 2
    for vehicle, flown in zip(plan.vehicles, flight.vehicles, strict=True):
        track = flown.trajectory
        assert np.linalg.norm(track.at(60.0) - track.at(74.0)) < 0.2
        assert flown.landed_s is not None
        for waypoint_m in vehicle.waypoints_m:
            assert np.min(np.linalg.norm(track.position_m - waypoint_m, axis=1)) <= 3.0
        off_m = np.abs(track.position_m[:, 1] - vehicle.home_m[1])
        assert np.max(off_m) < 1.0  # and never another way
        moving = np.linalg.norm(track.at(95.0) - track.at(90.0)) / 5.0
        assert moving == pytest.approx(4.0, abs=0.2)  # as its mission has set it there, not the parameter's
    assert any("was proven for the planned times only" in line for line in told)
    assert [ordered.order for ordered in flight.orders] == ["pause", "pause", "resume", "resume"]


def test_a_restart_of_missions_on_the_vehicle_does_not_send_it_back() -> None:
    """As ArduPilot does with MIS_RESTART = 1, where the mode is entered without its item being set before."""
    rig = started(long_legs("px4", 1))
    autopilot = rig.sim.links[0].autopilot
    set_mode = autopilot.set_mode

    def restarting(mode: Any, now_s: float) -> int:
        result = set_mode(mode, now_s)
        if autopilot.flying_mission:
            autopilot.set_current(0, now_s)
        return result

    autopilot.set_mode = restarting  # type: ignore[method-assign]
    script = Script(rig, (45.0, "pause", ()), (60.0, "resume", ()))
    flight = rig.link.watch(helm=script)
    assert results(script.answers[1]) == [("uav1", "obeyed")]
    track = flight.vehicles[0].trajectory
    after = track.position_m[track.t_s > 58.0]
    assert np.min(after[:, 0]) > track.at(58.0)[0] - 10.0  # it did not fly back to its first waypoint, 0


def test_one_alone_is_paused_and_the_others_fly_on() -> None:
    rig = started(small_fleet("ardupilot", 2))
    script = Script(rig, (15.0, "pause", ("uav2",)), (60.0, "resume", ("uav2",)))
    flight = rig.link.watch(helm=script)
    assert [results(outcomes) for outcomes in script.answers] == [[("uav2", "obeyed")]] * 2
    first, second = flight.vehicles
    assert first.landed_s is not None
    assert second.landed_s is not None
    assert second.landed_s - first.landed_s == pytest.approx(45.0, abs=3.0)


def test_a_pause_is_not_taken_for_a_flight_that_never_ends() -> None:
    rig = started(small_fleet("px4", 1))
    script = Script(rig, (15.0, "pause", ()), (900.0, "resume", ()))
    assert rig.link.watch(helm=script).vehicles[0].landed_s is not None


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("order", ["rtl", "land"])
def test_all_return_or_land_when_told(autopilot: Autopilot, order: Order) -> None:
    plan = small_fleet(autopilot, 2)
    rig = started(plan)
    script = Script(rig, (26.0, order, ()))
    flight = rig.link.watch(helm=script)
    assert results(script.answers[0]) == [("uav1", "obeyed"), ("uav2", "obeyed")]
    for vehicle, flown in zip(plan.vehicles, flight.vehicles, strict=True):
        away_m = np.linalg.norm((flown.trajectory.position_m[-1] - vehicle.home_m)[:2])
        assert (away_m < 1.0) == (order == "rtl")
        assert flown.landed_s is not None


def test_planes_told_to_land_return_and_that_is_said() -> None:
    plane = vehicle_plan(
        vehicle_class="plane", end="loiter", waypoints_m=((0, 0, 1260), (800, 0, 1260), (1600, 0, 1260))
    )
    rig = started(fleet_plan(replace(plane, speeds_m_s=np.full(2, 18.0))))
    script = Script(rig, (40.0, "land", ()))
    flight = rig.link.watch(helm=script)
    assert "planes do not land where they are" in script.answers[0][0].words
    assert np.linalg.norm((flight.vehicles[0].trajectory.position_m[-1])[:2]) < 160.0


def test_a_way_back_that_is_not_proven_is_flown_only_when_asked_for_twice() -> None:
    rig = started(long_legs("px4", 1))
    script = Script(rig, (40.0, "rtl", ()), (63.0, "resume", ("uav1",)), (65.0, "resume", ("uav1",)))
    flight = rig.link.watch(helm=script)
    _, first, second = script.answers
    assert first[0].result == "refused"
    assert "the way there is not proven" in first[0].words
    assert second[0].result == "obeyed"
    assert "not proven" in second[0].words
    assert np.linalg.norm(flight.vehicles[0].trajectory.position_m[-1, :2] - [400, 60]) < 1.0


def lose(kinds: Callable[[Any], bool]) -> Callable[[Any], Any]:
    return lambda message: None if kinds(message) else message


def test_who_does_not_answer_is_named_and_the_others_obey() -> None:
    rig = started(small_fleet("ardupilot", 3))
    rig.sim.advance(15.0)
    rig.pipes[1].up = lambda _message: None
    outcomes = rig.link.order("rtl")
    assert results(outcomes) == [("uav1", "obeyed"), ("uav2", "silent"), ("uav3", "obeyed")]
    assert "whether it obeys is not known; take over by hand" in outcomes[1].words


def test_an_answer_is_not_believed_before_a_heartbeat_shows_it() -> None:
    rig = started(small_fleet("px4", 1))
    rig.sim.advance(15.0)

    def ignored(message: Any) -> Any:
        if message.get_type() == "COMMAND_ACK":
            message.command, message.result = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_RESULT_ACCEPTED
        return message

    def unheeded(message: Any) -> Any:
        if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_DO_SET_MODE:
            message.command = 31_999
        return message

    rig.pipes[0].down, rig.pipes[0].up = ignored, unheeded
    (outcome,) = rig.link.order("rtl")
    assert outcome.result == "refused"
    assert "accepted, but is in mode" in outcome.words


def test_a_copter_that_cannot_pause_in_its_mission_is_held_and_resumes_all_the_same() -> None:
    """ArduCopter before 4.2, or in its take-off."""
    rig = started(long_legs("ardupilot", 1))
    pipe = rig.pipes[0]

    def refuse(message: Any) -> Any:
        if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_DO_PAUSE_CONTINUE:
            message.command = 31_998
        return message

    def refused(message: Any) -> Any:
        if message.get_type() == "COMMAND_ACK" and message.command == 31_998:
            message.command = mavlink.MAV_CMD_DO_PAUSE_CONTINUE
        return message

    pipe.up, pipe.down = refuse, refused
    script = Script(rig, (45.0, "pause", ()), (65.0, "resume", ()))
    flight = rig.link.watch(helm=script)
    assert [results(outcomes) for outcomes in script.answers] == [[("uav1", "obeyed")]] * 2
    assert "at 4.00 m/s" in script.answers[1][0].words
    track = flight.vehicles[0].trajectory
    assert np.linalg.norm(track.at(85.0) - track.at(80.0)) / 5.0 == pytest.approx(4.0, abs=0.2)


def delayed() -> FleetPlan:
    """The second starts 25 s after the first."""
    first = vehicle_plan("first", 1, waypoints_m=((0, 0, 1230), (240, 0, 1244.5), (480, 0, 1244.5)))
    second = vehicle_plan(
        "second", 2, start_delay_s=25.0, home_m=(0, 60, 1200), waypoints_m=((0, 60, 1230), (240, 60, 1244.5))
    )
    return fleet_plan(first, second)


@pytest.mark.parametrize("at_s", [12.0, 22.5])  # before it is armed, and when it is
def test_a_later_start_is_put_off_by_a_pause(at_s: float) -> None:
    rig = started(delayed())
    script = Script(rig, (at_s, "pause", ()), (at_s + 40.0, "resume", ()))
    flight = rig.link.watch(helm=script)
    assert results(script.answers[0]) == [("first", "obeyed"), ("second", "grounded")]
    second = flight.vehicles[1].trajectory
    lifted_s = float(second.t_s[np.argmax(second.position_m[:, 2] > 1202.0)])
    assert lifted_s == pytest.approx(67.0, abs=4.0)
    assert flight.vehicles[1].landed_s is not None


@pytest.mark.parametrize("at_s", [12.0, 22.5])
def test_who_is_told_to_return_before_it_has_started_does_not_start(at_s: float) -> None:
    rig = started(delayed())
    script = Script(rig, (at_s, "rtl", ()))
    with pytest.raises(
        LinkError, match=r"second \(sysid 2\): was told to rtl before its start: it stays on the ground"
    ):
        rig.link.watch(helm=script)
    assert results(script.answers[0]) == [("first", "obeyed"), ("second", "grounded")]
    assert rig.armed() == [False, False]


def test_a_gap_is_told_and_the_log_goes_on_after_it(tmp_path: Path) -> None:
    with FleetLog(tmp_path, {1: "uav1"}, 1.7e9) as log:
        rig = started(small_fleet("ardupilot", 1), log=log)
        begun_s = rig.clock.now_s()
        rig.pipes[0].down = lambda message: None if 15.0 <= rig.clock.now_s() - begun_s <= 35.0 else message
        told: list[str] = []
        flight = rig.link.watch(tell=told.append)
    assert flight.vehicles[0].landed_s is not None
    lost, back = [line for line in told if "heard" in line]
    assert lost.startswith("uav1: not heard for 5 s, at item ")
    assert lost.endswith("what it does is not known, its own failsafe may bring it home")
    assert back.startswith("uav1: heard again, at item ")
    records = read_log(tmp_path / "uav1.tlog").records
    times = np.array([t for t, m in records if m.get_srcSystem() == 1]) - 1.7e9 - begun_s
    assert np.all(np.diff(times) >= 0.0)
    assert not np.any((times > 15.1) & (times < 34.9))
    assert np.sum(times > 35.0) > 50
    notes = [m.text for _, m in records if m.get_type() == "STATUSTEXT" and m.get_srcSystem() == 255]
    assert any("heard again" in note for note in notes)


def test_what_a_vehicle_lacks_is_told_in_full() -> None:
    rig = Rig(small_fleet("ardupilot", 1))
    gps_and_arming = mavlink.MAV_SYS_STATUS_SENSOR_GPS | mavlink.MAV_SYS_STATUS_PREARM_CHECK

    def unhealthy(message: Any) -> Any:
        if message.get_type() == "SYS_STATUS":
            message.onboard_control_sensors_present |= gps_and_arming
            message.onboard_control_sensors_health &= ~gps_and_arming
        if message.get_type() == "ATTITUDE":
            return mavlink.MAVLink_statustext_message(4, b"PreArm: Battery 1 low voltage failsafe")
        return message

    rig.pipes[0].down = unhealthy
    rig.upload()
    said: list[tuple[str, str]] = []
    with pytest.raises(LinkError, match="not ready to arm within 10 s: GPS not healthy; pre-arm checks fail"):
        rig.link.start(lambda *args: said.append(args), ready_timeout_s=10.0)
    assert any("GPS not healthy; pre-arm checks fail" in missing for _, missing in said)


def test_one_that_vanishes_in_mid_start_leaves_a_fleet_whose_state_is_said() -> None:
    rig = Rig(small_fleet("ardupilot", 3))
    rig.upload()

    def vanish(message: Any) -> Any:
        if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_MISSION_START:
            rig.pipes[1].down = lambda _message: None
        return message

    rig.pipes[1].up = vanish
    with pytest.raises(LinkError) as error:
        rig.link.start()
    said = str(error.value)
    assert "uav2 (sysid 2): expected an answer to MISSION_START, got none" in said
    assert "uav2 did not answer and may be flying: take over by hand" in said
    assert "uav1, uav3 told to land" in said
    assert "on the ground" not in said  # they had left it
    assert "\n" not in said
    rig.sim.advance(60.0)
    assert [link.autopilot.landed for link in rig.sim.links][0::2] == [True, True]


def test_nothing_is_commanded_while_an_operator_has_a_say() -> None:
    plan = long_legs("ardupilot", 2)
    rig = started(plan)
    rules = Rules(period_s=1.0, interval_s=2.0, band_s=0.0, band_share=0.0, freeze_s=0.0)
    pacer = Pacer(courses(plan), lambda _i, _j: 20.0, correct=True, rules=rules)
    script = Script(rig, (40.0, "pause", ()), (60.0, "resume", ("uav1",)), (75.0, "resume", ("uav2",)))
    flight = rig.link.watch(pacer=pacer, helm=script)
    assert not [c for c in flight.corrections if 40.5 < c.t_s < 75.0]
    assert [c for c in flight.corrections if c.t_s > 75.0]  # and then it goes on
    assert all(vehicle.landed_s is not None for vehicle in flight.vehicles)


def test_who_is_not_heard_when_the_watch_ends_is_not_said_to_fly_on() -> None:
    rig = started(small_fleet("px4", 1))
    rig.sim.advance(15.0)
    rig.link.pump()
    rig.pipes[0].down = lambda _message: None
    rig.link._station.settle(20.0)
    (words,) = rig.link.standing()
    assert "when it was last heard, 20 s ago: what it does is not known, its own failsafe may" in words


def test_who_stands_already_is_left_standing_and_who_flies_already_is_left_flying() -> None:
    """Some versions of ArduCopter refuse a second pause, and a resume that nothing was paused before."""
    rig = started(long_legs("ardupilot", 1))
    autopilot = rig.sim.links[0].autopilot
    pause, unpause = autopilot.pause, autopilot.unpause
    failed = int(mavlink.MAV_RESULT_FAILED)
    autopilot.pause = lambda now_s: failed if autopilot.paused else pause(now_s)  # type: ignore[method-assign]
    autopilot.unpause = lambda now_s: unpause(now_s) if autopilot.paused else failed  # type: ignore[method-assign]
    times = ((40.0, "pause"), (52.0, "pause"), (56.0, "resume"), (62.0, "resume"))
    script = Script(rig, *((at_s, order, ()) for at_s, order in times))  # type: ignore[arg-type]
    flight = rig.link.watch(helm=script)
    assert [outcomes[0].result for outcomes in script.answers] == ["obeyed"] * 4
    assert "stands on its way" in script.answers[1][0].words
    assert flight.vehicles[0].landed_s is not None


def test_a_resume_that_is_accepted_and_not_followed_is_no_success() -> None:
    rig = started(long_legs("ardupilot", 1))
    autopilot = rig.sim.links[0].autopilot
    rig.sim.advance(40.0)
    assert rig.link.order("pause")[0].result == "obeyed"
    unpause = autopilot.unpause
    autopilot.unpause = lambda _now_s: int(mavlink.MAV_RESULT_ACCEPTED)  # type: ignore[method-assign]
    (outcome,) = rig.link.order("resume")
    assert outcome.result == "refused"
    assert "accepted, and still stands" in outcome.words
    autopilot.unpause = unpause  # type: ignore[method-assign]
    assert rig.link.order("resume")[0].result == "obeyed"


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_take_off_is_paused_and_resumed(autopilot: Autopilot) -> None:
    rig = started(long_legs(autopilot, 1))
    script = Script(rig, (5.0, "pause", ()), (30.0, "resume", ()))
    flight = rig.link.watch(helm=script)
    assert [outcomes[0].result for outcomes in script.answers] == ["obeyed"] * 2
    track = flight.vehicles[0].trajectory
    assert 1201.0 < float(track.at(25.0)[2]) < 1224.0
    assert np.linalg.norm(track.at(20.0) - track.at(28.0)) < 0.3
    assert flight.vehicles[0].arrival_s is not None


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    autopilot=st.sampled_from(["ardupilot", "px4"]),
    loss=st.sampled_from([0.0, 0.3]),  # of all messages, each way, once they fly
    orders=st.lists(
        st.tuples(
            st.floats(6.0, 25.0),
            st.sampled_from(["pause", "resume", "rtl", "land"]),
            st.sampled_from([(), ("uav1",), ("uav2",)]),
        ),
        min_size=1,
        max_size=5,
    ),
)
def test_whatever_is_ordered_is_answered_truly(
    autopilot: Autopilot, loss: float, orders: list[tuple[float, Order, tuple[str, ...]]]
) -> None:
    """Each vehicle does what it obeyed last, and no order crosses to another vehicle."""
    rig = started(long_legs(autopilot))
    rig.lose(loss, seed=1)
    at_s, steps = 4.0, []
    for after_s, order, names in orders:
        at_s += after_s
        steps.append((at_s, order, names))

    class Ending(Script):
        """Leaves when all that was ordered has been answered, and had time to show."""

        def request(self) -> Request | None:
            done = len(self.answers) == len(steps)
            if done and self._rig.clock.now_s() - self._begun_s > steps[-1][0] + 12.0:
                raise KeyboardInterrupt
            return super().request()

    script = Ending(rig, *steps)
    with contextlib.suppress(KeyboardInterrupt):  # all may have landed before
        rig.link.watch(helm=script)
    asked = [names or ("uav1", "uav2") for _, _, names in steps]
    assert [tuple(o.vehicle for o in outcomes) for outcomes in script.answers] == asked[: len(script.answers)]
    for name, link in zip(("uav1", "uav2"), rig.sim.links, strict=True):
        last: str = "resume"  # it flies its mission
        for outcomes in script.answers:
            for outcome in outcomes:
                assert loss or outcome.result in ("obeyed", "refused", "grounded")
                if outcome.vehicle == name and outcome.result == "obeyed":
                    last = outcome.order
                elif outcome.vehicle == name and (loss or outcome.result == "silent"):
                    last = "unknown"  # and it was said so
        vehicle = link.autopilot
        if vehicle.landed or last == "unknown":
            continue
        doing = {"pause": Behaviour.HOLD, "resume": Behaviour.AUTO, "rtl": Behaviour.RTL, "land": Behaviour.LAND}[last]
        stands = last == "pause" and vehicle.paused
        assert stands or vehicle.mode.behaviour in (doing, Behaviour.GUIDED if last == "pause" else doing), (name, last)
        if last == "pause":
            before_m = vehicle.position_m
            rig.sim.advance(3.0)
            assert np.linalg.norm(vehicle.position_m - before_m) < 0.5


def refusing(rig: Rig, k: int, command: int, when: Callable[[Any], bool] = lambda _message: True) -> None:
    """Let vehicle k refuse a command."""
    pipe = rig.pipes[k]
    nobodys = 31_998

    def up(message: Any) -> Any:
        if message.get_type() == "COMMAND_LONG" and message.command == command and when(message):
            message.command = nobodys
        return message

    def down(message: Any) -> Any:
        if message.get_type() == "COMMAND_ACK" and message.command == nobodys:
            message.command, message.result = command, mavlink.MAV_RESULT_FAILED
        return message

    pipe.up, pipe.down = up, down


def arms(message: Any) -> bool:
    return bool(message.param1 == 1.0)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_start_that_is_called_off_leaves_nobody_armed_who_was_armed_just_now(autopilot: Autopilot) -> None:
    """No heartbeat has told yet that the first is armed when the second refuses."""
    rig = Rig(small_fleet(autopilot, 2))
    rig.upload()
    refusing(rig, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, arms)
    with pytest.raises(LinkError, match="the start was called off: all vehicles are disarmed on the ground"):
        rig.link.start()
    assert rig.armed() == [False, False]


def test_who_was_asked_to_arm_is_disarmed_though_no_heartbeat_tells_that_it_is_armed() -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    rig.upload()

    def asked(message: Any) -> Any:
        if message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            rig.pipes[0].down = lose(lambda m: m.get_type() == "HEARTBEAT")
        return message

    rig.pipes[0].up = asked
    with pytest.raises(LinkError, match=r"uav1 \(sysid 1\): accepted, and did not arm") as error:
        rig.link.start()
    assert "all vehicles are disarmed" not in str(error.value)  # nobody has seen it
    assert rig.armed() == [False, False]


def test_planes_are_not_said_to_land_when_a_start_is_called_off() -> None:
    planes = [
        replace(
            vehicle_plan(
                f"p{k}",
                k,
                vehicle_class="plane",
                end="loiter",
                home_m=(0, 200 * k, 1200),
                waypoints_m=((0, 200 * k, 1260), (800, 200 * k, 1260), (1600, 200 * k, 1260)),
            ),
            speeds_m_s=np.full(2, 18.0),
        )
        for k in (1, 2)
    ]
    rig = Rig(fleet_plan(*planes))
    rig.upload()
    refusing(rig, 1, mavlink.MAV_CMD_MISSION_START)
    with pytest.raises(LinkError) as error:
        rig.link.start()
    assert "p1 told to return (planes do not land where they are), and circles above home" in str(error.value)
    assert "told to land" not in str(error.value)
    assert str(error.value).endswith("the others are disarmed on the ground")


def test_who_refuses_to_land_when_a_start_is_called_off_has_answered() -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    rig.upload()
    refusing(rig, 1, mavlink.MAV_CMD_MISSION_START)
    refusing(rig, 0, mavlink.MAV_CMD_DO_SET_MODE, lambda message: message.param2 == 9.0)
    with pytest.raises(LinkError, match=r"uav1 told to land, and refused.*: take over by hand") as error:
        rig.link.start()
    assert "did not answer" not in str(error.value)


def change_mission(rig: Rig, sysid: int, by_m: float = -20.0) -> None:
    """Give a vehicle another mission, as another ground station may."""
    stored = rig.sim.links[sysid - 1].missions._stores[mavlink.MAV_MISSION_TYPE_MISSION]
    stored[:] = [replace(i, z=i.z + by_m) if i.command == WAYPOINT and i.seq > 1 else i for i in stored]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_mission_that_was_changed_since_it_was_read_back_is_not_flown(autopilot: Autopilot) -> None:
    rig = Rig(small_fleet(autopilot, 2))
    rig.upload()
    change_mission(rig, 2)
    with pytest.raises(LinkError, match=r"uav2 \(sysid 2\): it holds another mission than its plan's: item .* armed$"):
        rig.link.start()
    assert rig.armed() == [False, False]


def test_a_mission_that_was_changed_before_a_start_by_the_clock_is_not_flown() -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    rig.upload()
    at_s = rig.clock.now_s() + 90.0
    wait = rig.clock.wait

    def waiting(seconds: float) -> None:
        wait(seconds)
        if rig.clock.now_s() > at_s - 60.0:
            rig.clock.wait = wait  # type: ignore[method-assign]
            change_mission(rig, 1)

    rig.clock.wait = waiting  # type: ignore[method-assign]
    with pytest.raises(LinkError, match=r"uav1 \(sysid 1\): it holds another mission .*nothing was armed"):
        rig.link.start(at_s=at_s)
    assert rig.clock.now_s() < at_s
    assert rig.armed() == [False, False]


def test_a_mission_that_was_changed_before_a_later_start_is_not_flown() -> None:
    rig = started(delayed())
    change_mission(rig, 2)
    told: list[str] = []
    with pytest.raises(LinkError, match=r"second \(sysid 2\): it holds another mission"):
        rig.link.watch(tell=told.append)
    assert any("it was not started; the others fly their missions" in line for line in told)
    assert float(rig.sim.links[1].autopilot.position_m[2]) == pytest.approx(1200.0, abs=0.1)


@pytest.mark.parametrize("k", [0, 1])
def test_who_is_armed_already_is_not_started(k: int) -> None:
    rig = Rig(small_fleet("ardupilot", 2))
    rig.upload()

    def armed(message: Any) -> Any:
        if message.get_type() == "HEARTBEAT":
            message.base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return message

    rig.pipes[k].down = armed
    with pytest.raises(LinkError, match=rf"uav{k + 1} .*is armed already, not from here.*; nothing was armed"):
        rig.link.start()
    assert rig.armed() == [False, False]


def in_flight(plan: FleetPlan, at_s: float = 40.0) -> Rig:
    rig = started(plan)
    rig.sim.advance(at_s)
    rig.link._station.settle(1.5)
    return rig


def switch(rig: Rig, mode: str | Behaviour, k: int = 0) -> None:
    """Let a vehicle change its mode by itself, or by its pilot's switch."""
    autopilot = rig.sim.links[k].autopilot
    kind = autopilot.personality
    autopilot.set_mode(kind.mode(mode) if isinstance(mode, str) else kind.mode_for(mode), rig.clock.now_s())
    rig.link._station.settle(3.0)


def test_an_order_with_a_name_that_is_nobodys_is_given_to_nobody() -> None:
    rig = in_flight(small_fleet("ardupilot", 2), 15.0)
    assert rig.link.order("land", ["uav1", "typo"]) == ()
    assert rig.sim.links[0].autopilot.flying_mission


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_resuming_all_takes_nobody_out_of_a_failsafe(autopilot: Autopilot) -> None:
    rig = in_flight(long_legs(autopilot))
    assert results(rig.link.order("pause", ["uav2"])) == [("uav2", "obeyed")]
    switch(rig, Behaviour.RTL)
    outcomes = rig.link.order("resume")
    assert results(outcomes) == [("uav1", "refused"), ("uav2", "obeyed")]
    assert "it returns home, and was not paused from here" in outcomes[0].words
    assert rig.sim.links[0].autopilot.mode.behaviour is Behaviour.RTL
    assert results(rig.link.order("resume", ["uav1"], unproven=True)) == [("uav1", "obeyed")]
    assert rig.sim.links[0].autopilot.flying_mission


def test_who_was_paused_here_and_returns_by_a_failsafe_since_is_not_resumed_with_all() -> None:
    rig = in_flight(long_legs("px4", 1))
    rig.link.order("pause")
    switch(rig, Behaviour.RTL)
    assert results(rig.link.order("resume")) == [("uav1", "refused")]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize(
    ("order", "mode", "said"),
    [
        ("rtl", Behaviour.AUTO, "uav1 flies on with its mission, at item"),
        ("pause", Behaviour.RTL, "uav1 returns home"),
        ("land", "hold", "uav1 holds, at item"),
    ],
)
def test_the_last_word_is_what_a_vehicle_does_not_what_it_was_told(
    autopilot: Autopilot, order: Order, mode: Behaviour | Literal["hold"], said: str
) -> None:
    rig = in_flight(long_legs(autopilot, 1))
    assert results(rig.link.order(order)) == [("uav1", "obeyed")]
    held = Behaviour.GUIDED if autopilot == "ardupilot" else Behaviour.HOLD
    switch(rig, held if mode == "hold" else mode)
    (words,) = rig.link.standing()
    assert words.startswith(said)


def test_a_mode_of_the_pilots_is_named() -> None:
    rig = in_flight(long_legs("ardupilot", 1))
    rig.link.order("pause")
    switch(rig, "LOITER")
    assert rig.link.standing()[0].startswith("uav1 is in mode LOITER, not in its mission, at item")


def test_who_was_kept_on_the_ground_and_is_armed_by_hand_is_not_said_to_stay_there() -> None:
    rig = started(delayed())
    begun_s = rig.clock.now_s()

    def armed(message: Any) -> Any:
        if message.get_type() == "HEARTBEAT" and rig.clock.now_s() - begun_s > 15.0:
            message.base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
            message.custom_mode = 5
        return message

    class Leaving(Script):
        def request(self) -> Request | None:
            if self._rig.clock.now_s() - self._begun_s > 20.0:
                raise KeyboardInterrupt
            return super().request()

    rig.pipes[1].down = armed
    with pytest.raises(KeyboardInterrupt):
        rig.link.watch(helm=Leaving(rig, (5.0, "rtl", ("second",))))
    assert rig.link.flying == ["first", "second"]
    assert rig.link.standing()[1].startswith("second is in mode LOITER, not in its mission")


def test_an_autopilot_that_restarts_in_flight_is_not_said_to_be_on_the_ground() -> None:
    rig = in_flight(small_fleet("ardupilot", 1), 20.0)
    base_ms: list[int] = []

    def restarted(message: Any) -> Any:
        if message.get_type() == "HEARTBEAT":
            message.base_mode &= ~mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        if message.get_type() == "EXTENDED_SYS_STATE":
            message.landed_state = mavlink.MAV_LANDED_STATE_ON_GROUND
        if hasattr(message, "time_boot_ms"):
            base_ms.append(message.time_boot_ms)
            message.time_boot_ms -= base_ms[0] - 1_000
        return message

    rig.pipes[0].down = restarted
    with pytest.raises(LinkError, match=r"uav1 \(sysid 1\): its autopilot restarted in flight"):
        rig.link.watch()
    rig.link._station.settle(2.0)
    (words,) = rig.link.standing()
    assert words.startswith("uav1 has restarted its autopilot in flight, ")
    assert words.endswith("and is disarmed: what it does is not known")


def test_who_is_disarmed_in_the_air_is_lost_not_landed() -> None:
    rig = in_flight(small_fleet("ardupilot", 2), 15.0)

    def disarmed(message: Any) -> Any:
        if message.get_type() == "HEARTBEAT":
            message.base_mode &= ~mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return None if message.get_type() == "EXTENDED_SYS_STATE" else message

    def left(message: Any) -> Any:
        return None if rig.clock.now_s() > ends_s else disarmed(message)

    ends_s = rig.clock.now_s() + 14.0
    rig.pipes[0].down = left
    told: list[str] = []
    with pytest.raises(LinkError, match=r"uav1 \(sysid 1\): disarmed in the air, \d\d m above home, at item"):
        rig.link.watch(tell=told.append)
    assert rig.clock.now_s() < ends_s + 50.0  # nobody waits for it, as for one that is not heard
    assert any(line.startswith("uav1 is disarmed in the air, ") for line in told)
    assert rig.link.flight().vehicles[0].landed_s is None
    assert rig.link.flight().vehicles[1].landed_s is not None


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("order", ["pause", "rtl"])
def test_an_order_is_obeyed_though_only_its_answer_was_lost(autopilot: Autopilot, order: Order) -> None:
    rig = in_flight(long_legs(autopilot, 1))
    rig.pipes[0].down = lose(lambda message: message.get_type() == "COMMAND_ACK")
    (outcome,) = rig.link.order(order)
    assert outcome.result == "obeyed"
    assert rig.link.standing() == [outcome.words]


def test_who_does_not_answer_is_said_to_do_what_it_is_seen_to_do() -> None:
    rig = in_flight(long_legs("ardupilot", 1))
    rig.pipes[0].up = lambda _message: None
    assert results(rig.link.order("rtl")) == [("uav1", "silent")]
    (words,) = rig.link.standing()
    assert words.startswith("uav1 flies on with its mission, at item")
    assert "(it was told to rtl, and does not answer" in words


def test_a_warning_of_the_way_back_holds_for_that_place_and_order_only() -> None:
    rig = in_flight(long_legs("px4", 1))

    def resume() -> str:
        (outcome,) = rig.link.order("resume", ["uav1"])
        assert (outcome.result == "obeyed") != ("the way there is not proven; resume again" in outcome.words)
        return outcome.result

    def wait(duration_s: float) -> None:
        rig.link._station.settle(duration_s)

    assert rig.link.order("rtl")[0].result == "obeyed"
    wait(22.0)
    assert resume() == "refused"
    assert rig.link.order("pause")[0].result == "obeyed"  # it is told something else meanwhile
    assert resume() == "refused"
    wait(1.0)
    assert resume() == "obeyed"
    assert rig.link.order("pause")[0].result == "obeyed"
    assert resume() == "refused"  # off its leg still: said again
    assert rig.link.order("rtl")[0].result == "obeyed"
    assert resume() == "refused"
    wait(8.0)
    assert resume() == "refused"  # it has flown on since
    assert resume() == "obeyed"


def test_a_resume_uses_its_warning_up() -> None:
    rig = in_flight(long_legs("px4", 1))
    rig.link.order("rtl")
    rig.link._station.settle(22.0)
    switch(rig, Behaviour.HOLD)
    assert [rig.link.order("resume", ["uav1"])[0].result for _ in range(2)] == ["refused", "obeyed"]
    switch(rig, Behaviour.HOLD)  # by its pilot, off its leg still
    assert rig.link.order("resume", ["uav1"])[0].result == "refused"


def test_what_vehicles_warn_of_is_shown_and_who_leaves_its_mission_is_told_once() -> None:
    rig = in_flight(long_legs("ardupilot"))
    autopilot = rig.sim.links[0].autopilot
    wait, done = rig.clock.wait, []
    at_s = rig.clock.now_s() + 3.0

    def waiting(seconds: float) -> None:
        wait(seconds)
        if not done and rig.clock.now_s() > at_s:
            done.append(True)
            for _ in range(3):
                autopilot._say(mavlink.MAV_SEVERITY_WARNING, "Battery 1 failsafe: RTL")
            autopilot._say(mavlink.MAV_SEVERITY_INFO, "nothing to worry about")
            autopilot.set_mode(autopilot.personality.mode_for(Behaviour.RTL), rig.clock.now_s())

    rig.clock.wait = waiting  # type: ignore[method-assign]
    told: list[str] = []
    shown: list[tuple[str, str]] = []
    with contextlib.suppress(LinkError):
        rig.link.watch(lambda fleet: shown.extend((v.name, v.doing) for v in fleet), tell=told.append)
    assert told.count("uav1: Battery 1 failsafe: RTL") == 1
    assert not any("nothing to worry about" in line for line in told)
    assert [line for line in told if "not by an order" in line] == ["uav1 returns home: not by an order given here"]
    assert ("uav1", "returns") in shown
    assert ("uav1", "flying") in shown
    assert not any(name == "uav2" and doing == "returns" for name, doing in shown)


@pytest.mark.parametrize("order", ["pause", "rtl"])
def test_who_stood_to_lose_time_and_is_ordered_about_is_not_told_to_go_on(order: Order) -> None:
    """Neither when its time is up, nor when the watch ends: it is the operator's now."""
    rig = Stopping()
    rig.begin()
    ordered_s: list[float] = []
    sent: list[float] = []

    def noted(message: Any) -> Any:
        goes_on = message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_DO_PAUSE_CONTINUE
        if goes_on and message.param1 == 1.0 and ordered_s:
            sent.append(rig.clock.now_s())
        return message

    class Ordering(Script):
        def request(self) -> Request | None:
            if rig.stands and not ordered_s:
                ordered_s.append(rig.clock.now_s())
                return Request(order, frozenset({"uav1"}))
            if ordered_s and rig.clock.now_s() > ordered_s[0] + 40.0:
                raise KeyboardInterrupt
            return None

    rig.pipes[0].up = noted
    pacer = Pacer(courses(rig.link._plan, (5.9, 6.0)), lambda _i, _j: 20.0, hold=True, rules=Rules(hold_s=2.0))
    script = Ordering(rig)
    with pytest.raises(KeyboardInterrupt):
        rig.link.watch(pacer=pacer, helm=script)
    assert [results(outcomes) for outcomes in script.answers] == [[("uav1", "obeyed")]]
    rig.sim.advance(5.0)
    assert sent == []
    assert rig.sim.links[0].autopilot.paused == (order == "pause")


def command(rig: Rig, order: Order, *names: str) -> list[tuple[str, str]]:
    """Give an order as a ground station that has just come."""
    plan = rig.link._plan
    link = FleetLink(plan, list(rig.pipes), rig.clock)
    outcomes = link.command(Request(order, frozenset(names)))
    assert all(outcome.words.startswith(outcome.vehicle) for outcome in outcomes)
    assert not any("uploaded" in outcome.words for outcome in outcomes)
    return [(outcome.result, outcome.words) for outcome in outcomes]


def test_a_ground_station_that_comes_by_orders_all_whom_it_hears() -> None:
    rig = in_flight(small_fleet("ardupilot", 3), 15.0)
    rig.pipes[1].down = lambda _message: None
    begun_s = rig.clock.now_s()
    first, second, third = command(rig, "rtl")
    assert rig.clock.now_s() - begun_s < 12.0
    assert (first[0], second[0], third[0]) == ("obeyed", "silent", "obeyed")
    assert second[1] == "uav2 is not heard, and was not told to rtl: take over by hand"
    modes = [link.autopilot.mode.behaviour for link in rig.sim.links]
    assert modes == [Behaviour.RTL, Behaviour.AUTO, Behaviour.RTL]
    for pipe in rig.pipes:
        pipe.down = lambda _message: None
    with pytest.raises(LinkError, match="nobody answered"):
        command(rig, "land")


def test_a_ground_station_that_comes_by_orders_nobody_who_is_another() -> None:
    rig = in_flight(small_fleet("ardupilot", 2), 15.0)

    def another(message: Any) -> Any:
        if message.get_type() == "HEARTBEAT":
            message.type = mavlink.MAV_TYPE_FIXED_WING
        return message

    rig.pipes[0].down = another
    (refused, why), (obeyed, _) = command(rig, "land")
    assert (refused, obeyed) == ("refused", "obeyed")
    assert "expected ardupilot copter, got ardupilot plane" in why
    assert rig.sim.links[0].autopilot.flying_mission


def test_a_ground_station_that_comes_by_resumes_only_the_plans_missions() -> None:
    rig = in_flight(long_legs("ardupilot", 3))
    for k in range(3):
        switch(rig, Behaviour.HOLD, k)
    rig.sim.links[0].missions._stores[mavlink.MAV_MISSION_TYPE_MISSION].clear()
    change_mission(rig, 2)
    first, second, third = command(rig, "resume", "uav1", "uav2", "uav3")
    assert first == ("refused", "uav1 is not resumed: it holds no mission")
    assert second[0] == "refused"
    assert second[1].startswith("uav2 is not resumed: it holds another mission than its plan's: item")
    assert third[0] == "obeyed", third
