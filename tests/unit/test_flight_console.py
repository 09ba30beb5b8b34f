"""What an operator sees and does at the terminal while a fleet flies."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.fleet_flight import Request
from missionplanner import flight_console
from missionplanner.errors import LinkError, MissionError
from missionplanner.flight_console import ORDERS_FOLDER, fly_and_watch
from missionplanner.pacing import Pacer
from missionplanner.plan import FleetFlight, FleetPlan
from tests.plans import small_fleet
from tests.rig import Rig
from tests.unit.test_fleet_flight import arms, delayed, lose, refusing
from tests.unit.test_pace_keeper import courses


class Typed:
    """Keys that are typed at times of the flight; a time may also be that of a signal."""

    def __init__(self, rig: Rig, present: bool, *steps: tuple[float, str | int]) -> None:
        self.present = present
        self._rig = rig
        self._steps = list(steps)
        self.start_s: float | None = None

    def due(self) -> str | int | None:
        if self.start_s is None or not self._steps or self._rig.clock.now_s() - self.start_s < self._steps[0][0]:
            return None
        return self._steps.pop(0)[1]

    @property
    def signals_next(self) -> bool:
        return bool(self._steps) and isinstance(self._steps[0][1], int)

    def read(self) -> str:
        due = None if self.signals_next else self.due()
        return due if isinstance(due, str) else ""

    def __enter__(self) -> Typed:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Console:
    """Flies plans at a terminal; keys are typed, or signals come, at times after the start; -1: once all are armed."""

    rig: Rig

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.folder = folder
        self.meddle: Callable[[Rig], None] = lambda _rig: None  # with the links, before the start
        self._patch = monkeypatch

    def __call__(self, plan: FleetPlan, *steps: tuple[float, str | int], terminal: bool = True) -> FleetFlight:
        rig = self.rig = Rig(plan)
        rig.upload()
        rig.link.set_returns()
        self.meddle(rig)
        keys = Typed(rig, terminal, *steps)
        self._patch.setattr(flight_console, "Keys", lambda: keys)
        wait, start = rig.clock.wait, rig.link.start

        def waiting(seconds: float) -> None:
            wait(seconds)
            if keys.start_s is None and steps and steps[0][0] < 0.0 and all(rig.armed()):
                keys.start_s = 0.0
            if keys.signals_next and isinstance(due := keys.due(), int):
                os.kill(os.getpid(), due)

        def begin(*args: object, **options: object) -> None:
            start(*args, **options)  # type: ignore[arg-type]
            keys.start_s = rig.clock.now_s()

        self._patch.setattr(rig.clock, "wait", waiting)
        self._patch.setattr(rig.link, "start", begin)
        pacer = Pacer(courses(plan), lambda _i, _j: 20.0, correct=False)
        return fly_and_watch(rig.link, plan, pacer, self.folder, simulated=False, start_s=lambda _tell: None)


@pytest.fixture
def console(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Console:
    return Console(tmp_path, monkeypatch)


def last_line(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err.replace("\n", " ").split("missionplanner: ")[-1].strip()


def test_keys_pause_continue_and_return(console: Console, capsys: pytest.CaptureFixture[str]) -> None:
    flight = console(small_fleet("ardupilot", 2), (14.0, "p"), (24.0, "c"), (30.0, "R"))
    told = capsys.readouterr().err
    assert [ordered.order for ordered in flight.orders] == ["pause"] * 2 + ["resume"] * 2 + ["rtl"] * 2
    for words in ("uav1 stands on its way, at item", "uav2 goes on, at item", "uav1 returns home"):
        assert words in told
    assert all(vehicle.landed_s is not None for vehicle in flight.vehicles)


@pytest.mark.parametrize("key", ["r", "l", "x"])
def test_a_key_hit_by_mistake_orders_nothing(console: Console, capsys: pytest.CaptureFixture[str], key: str) -> None:
    flight = console(small_fleet("ardupilot", 1), (14.0, key))
    assert flight.orders == ()
    assert "p pause  c continue  R return  L land where they are" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("key", "left"),
    [
        ("f", "uav1 flies on with its mission, at item"),
        ("p", "uav1 stands on its way, at item"),
        ("r", "uav1 returns home"),
        ("l", "uav1 lands where it is"),
    ],
)
def test_ctrl_c_asks_and_the_last_line_says_how_all_are_left(
    console: Console, capsys: pytest.CaptureFixture[str], key: str, left: str
) -> None:
    with pytest.raises(KeyboardInterrupt):
        console(small_fleet("ardupilot", 2), (14.0, signal.SIGINT), (16.0, key))
    said = last_line(capsys)
    assert said.startswith("nobody watches them now: ")
    assert left in said
    assert left.replace("uav1", "uav2") in said


def test_ctrl_c_may_be_thought_better_of(console: Console, capsys: pytest.CaptureFixture[str]) -> None:
    flight = console(small_fleet("ardupilot", 1), (14.0, signal.SIGINT), (15.0, "w"))
    assert flight.vehicles[0].landed_s is not None
    assert "leave them: f fly on unattended" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("terminal", "signals"),
    [(True, (signal.SIGINT, signal.SIGINT)), (False, (signal.SIGINT,)), (True, (signal.SIGTERM,))],
)
def test_without_an_answer_they_fly_on(
    console: Console,
    capsys: pytest.CaptureFixture[str],
    terminal: bool,
    signals: tuple[int, ...],
) -> None:
    before = signal.getsignal(signal.SIGINT)
    steps = [(14.0 + k, number) for k, number in enumerate(signals)]
    with pytest.raises(KeyboardInterrupt):
        console(small_fleet("px4", 1), *steps, terminal=terminal)
    assert "uav1 flies on with its mission" in last_line(capsys)
    assert signal.getsignal(signal.SIGINT) is before
    assert console.rig.armed() == [True]


def test_who_has_not_started_when_the_operator_leaves_is_disarmed_and_named(
    console: Console, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        console(delayed(), (22.5, signal.SIGINT), terminal=False)
    told = capsys.readouterr().err.replace("\n", " ")
    assert "not started, and left disarmed on the ground: second" in told
    assert "first flies on with its mission" in told
    assert "second is disarmed on the ground" in told
    assert console.rig.armed() == [True, False]


def test_an_interrupt_before_the_start_leaves_nobody_armed(
    console: Console, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        console(small_fleet("ardupilot", 2), (-1.0, signal.SIGINT), terminal=False)
    assert console.rig.armed() == [False, False]
    assert last_line(capsys) == "nobody flies: uav1 is disarmed on the ground; uav2 is disarmed on the ground"


def test_another_terminal_may_order_while_it_flies(
    console: Console, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    box = tmp_path / ORDERS_FOLDER
    monkeypatch.setattr(flight_console, "_LOOK_S", 0.0)
    take = flight_console.OrderBox.take

    def given(self: flight_console.OrderBox) -> Request | None:
        if not list(box.iterdir()) and console.rig.link.flight().vehicles[0].trajectory.t_s[-1] > 14.0:
            order = {"order": "land", "vehicles": ["uav2"], "unproven": False}
            (box / "one.order").write_text(json.dumps(order))
            monkeypatch.setattr(flight_console.OrderBox, "take", take)
        return take(self)

    answers: list[object] = []
    answer = flight_console.OrderBox.answer

    def noted(self: flight_console.OrderBox, outcomes: object) -> None:
        answer(self, outcomes)  # type: ignore[arg-type]
        answers.append(json.loads((box / "one.answer").read_text()))

    monkeypatch.setattr(flight_console.OrderBox, "take", given)
    monkeypatch.setattr(flight_console.OrderBox, "answer", noted)
    flight = console(small_fleet("px4", 2))
    assert [(ordered.vehicle, ordered.result) for ordered in flight.orders] == [("uav2", "obeyed")]
    assert [o["words"] for o in answers[0]] == ["uav2 lands where it is"]  # type: ignore[index]
    assert flight.vehicles[0].arrival_s is not None
    assert flight.vehicles[1].arrival_s is None
    assert not box.exists()


def test_a_start_that_fails_with_somebody_armed_is_told_not_watched(
    console: Console, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first does not hear that it is to disarm; the second refuses to arm, late."""

    def meddle(rig: Rig) -> None:
        refusing(rig, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, arms)
        disarms = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        rig.pipes[0].up = lose(lambda m: m.get_type() == "COMMAND_LONG" and m.command == disarms and not arms(m))

    console.meddle = meddle
    with pytest.raises(LinkError, match="uav1 did not answer and may be flying: take over by hand"):
        console(small_fleet("px4", 2))
    said = last_line(capsys)
    assert said.startswith("nobody watches them now: uav1 is armed, and was not seen to start; uav2 is disarmed")
    assert said.endswith("may return by its own failsafe")
    assert not (console.folder / ORDERS_FOLDER).exists()


def test_a_half_started_fleet_that_flies_is_watched_down(console: Console, capsys: pytest.CaptureFixture[str]) -> None:
    console.meddle = lambda rig: refusing(rig, 1, mavlink.MAV_CMD_MISSION_START)
    with pytest.raises(LinkError, match=r"uav2 \(sysid 2\): its start was called off"):
        console(small_fleet("ardupilot", 2))
    assert "uav1 told to land; the others are disarmed on the ground; watching" in capsys.readouterr().err.replace(
        "\n", " "
    )
    assert [link.autopilot.landed for link in console.rig.sim.links] == [True, True]
    assert console.rig.link.flight().vehicles[0].landed_s is not None


def test_nothing_flies_where_orders_cannot_be_taken(console: Console) -> None:
    (console.folder / ORDERS_FOLDER).write_text("a file")
    with pytest.raises(MissionError, match="orders: expected a folder that can be written to"):
        console(small_fleet("ardupilot", 2))
    assert console.rig.armed() == [False, False]
    assert not console.rig.link.started


@pytest.mark.parametrize("error", [OSError("the radio is gone"), MissionError("a full disk"), LinkError("lost")])
def test_whatever_ends_the_watch_the_last_word_is_said(
    console: Console, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def request(_bridge: object) -> None:
        assert console.rig.link._start_s is not None
        if console.rig.link.now_s > console.rig.link._start_s + 22.5:  # the second is armed
            raise error

    monkeypatch.setattr(flight_console._Bridge, "request", request)
    with pytest.raises(type(error), match=str(error)):
        console(delayed())
    assert console.rig.link.flying[0] == "first"
    said = last_line(capsys)
    assert said.startswith("nobody watches them now: first flies on with its mission, at item")
    assert "second is disarmed on the ground" in said
    assert console.rig.armed() == [True, False]


@pytest.mark.parametrize("error", [OSError("the radio is gone"), RuntimeError("a bug")])
def test_whatever_ends_the_start_nobody_is_left_armed_and_it_is_said(
    console: Console, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def meddle(rig: Rig) -> None:
        wait = rig.clock.wait

        def waiting(seconds: float) -> None:
            wait(seconds)
            if all(rig.armed()):
                monkeypatch.setattr(rig.clock, "wait", wait)
                raise error

        monkeypatch.setattr(rig.clock, "wait", waiting)

    console.meddle = meddle
    with pytest.raises(type(error), match=str(error)):
        console(small_fleet("px4", 2))
    assert console.rig.armed() == [False, False]
    assert last_line(capsys) == "nobody flies: uav1 is disarmed on the ground; uav2 is disarmed on the ground"


def test_an_answer_that_cannot_be_written_ends_no_flight(
    console: Console, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_arguments: object) -> None:
        raise MissionError("orders: could not be written: No space left on device")

    monkeypatch.setattr(flight_console.OrderBox, "answer", full)
    flight = console(small_fleet("ardupilot", 1), (20.0, "p"), (30.0, "c"))
    assert [ordered.result for ordered in flight.orders] == ["obeyed", "obeyed"]
    assert flight.vehicles[0].landed_s is not None
    assert "the other terminal does not hear what came of its order" in capsys.readouterr().err.replace("\n", " ")
