"""The experiment on links: its judge sees every wrong mission, its frames find planted faults, its report tells all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.fleet_link import FleetLink
from adapters.mission_items import FRAME_MISSION, MissionItem, plan_items
from adapters.mission_protocol import OWN_COMPONENT
from adapters.pymavlink_link import PymavlinkLink
from missionplanner.experiments import link_fuzz, link_loads, link_trials, links
from missionplanner.vehicle import Autopilot
from sim.mission_service import MissionService
from sim.vehicle_link import VehicleLink
from tests.simulated import Ground, of_type

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])


def items(autopilot: Autopilot, count: int = 30) -> tuple[MissionItem, ...]:
    plan = link_trials.fleet_plan(1, count, autopilot, 1)
    return plan_items(plan.vehicles[0], plan.frame)


# --- uploads ----------------------------------------------------------------------------------------------------------


@BOTH
def test_missions_have_as_many_items_as_asked_for_and_differ_by_seed(autopilot: Autopilot) -> None:
    assert len(items(autopilot, 100)) == 100
    one, other = (link_trials.fleet_plan(2, 20, autopilot, seed) for seed in (1, 2))
    missions = [plan_items(v, plan.frame) for plan in (one, other) for v in plan.vehicles]
    assert not any(link_trials.holds(a, b, autopilot) for k, a in enumerate(missions) for b in missions[:k])


@given(st.sampled_from(["ardupilot", "px4"]), st.data())
def test_the_judge_sees_whatever_would_be_flown_otherwise(autopilot: Autopilot, data: st.DataObject) -> None:
    sent = items(autopilot)
    assert link_trials.holds(sent, sent, autopilot)
    places = [i for i in sent[1:] if i.frame != FRAME_MISSION]
    item = data.draw(st.sampled_from(places))
    name, by = data.draw(
        st.sampled_from(
            [("x", 1), ("y", -1), ("z", 0.5), ("command", 1), ("param1", 1.0), ("frame", 3 - 2 * item.frame)]
        )
    )
    changed = replace(item, **{name: getattr(item, name) + by})
    assert not link_trials.holds(sent, [changed if i is item else i for i in sent], autopilot)
    assert not link_trials.holds(sent, sent[:-1], autopilot)
    assert not link_trials.holds(sent, [*sent[:5], sent[6], sent[5], *sent[7:]], autopilot)


def test_frames_that_mean_the_same_are_the_same() -> None:
    sent = items("px4")
    assert link_trials.holds(sent, [replace(i, frame={0: 5, 3: 6}.get(i.frame, i.frame)) for i in sent], "px4")


@BOTH
@pytest.mark.parametrize("link", ["0% loss", "20% loss", "down for 10 s"])
def test_uploads_over_bad_links_are_verified_and_repeat(autopilot: Autopilot, link: str) -> None:
    found = [link_trials.uploads(autopilot, link, 15, [1, 2])["trials"] for _ in range(2)]
    assert [trial["verdict"] for trial in found[0]] == ["verified", "verified"]
    assert found[0] == found[1]
    assert found[0][0]["verified_s"] > found[0][0]["upload_s"] > 0.0


@BOTH
def test_an_upload_over_a_dead_link_is_refused_by_the_vehicles_name(autopilot: Autopilot) -> None:
    [trial] = link_trials.uploads(autopilot, "down for ever", 60, [3])["trials"]
    assert trial["verdict"] == "refused"
    assert "uav1 (sysid 1)" in trial["said"]


def test_a_success_that_is_none_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    upload = FleetLink.upload
    monkeypatch.setattr(FleetLink, "upload", lambda link: done.append("") if done else (done.append(""), upload(link)))
    monkeypatch.setattr(FleetLink, "verify", lambda _: None)
    [trial] = link_trials.uploads("px4", "0% loss", 10, [1])["trials"]  # the vehicle keeps its old mission
    assert trial["verdict"] == "wrong"


def test_over_sockets_and_in_real_time_it_is_the_same() -> None:
    trials = link_trials.clients("missionplanner", "px4", "0% loss", 5, 2, 1)["trials"]
    assert [trial["verdict"] for trial in trials] == ["verified", "verified"]


# --- mutated frames ---------------------------------------------------------------------------------------------------


_RECORDED = cache(link_fuzz.recorded)


@pytest.fixture(autouse=True)
def recorded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    for autopilot in links.AUTOPILOTS:
        _RECORDED(autopilot)
    monkeypatch.setattr(link_fuzz, "recorded", _RECORDED)


@pytest.fixture
def traffic() -> list[Any]:
    return _RECORDED("px4")[0]


def test_the_same_seed_makes_the_same_frames(traffic: list[Any]) -> None:
    def made(seed: int) -> list[bytes]:
        mutator = link_fuzz.Mutator(traffic, np.random.default_rng(seed), [1, 2])
        return [mutator.frame(*mutator.message(1), mutator.source((255, OWN_COMPONENT))) for _ in range(300)]

    assert made(1) == made(1) != made(2)


def test_frames_are_of_all_kinds_most_of_them_valid(traffic: list[Any]) -> None:
    mutator = link_fuzz.Mutator(traffic, np.random.default_rng(1), [1, 2])
    heard, bad = [], 0
    for _ in range(3_000):
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = True
        for message in (
            parser.parse_buffer(mutator.frame(*mutator.message(1), mutator.source((255, OWN_COMPONENT)))) or ()
        ):
            bad += message.get_type() == "BAD_DATA"
            heard.append(message)
    assert 0.03 < bad / len(heard) < 0.4
    assert len({m.get_type() for m in heard}) > 100
    assert {m.get_srcSystem() for m in heard if m.get_type() != "BAD_DATA"} >= {255, 1, 2, 0, 77}
    numbers = [m.param1 for m in heard if m.get_type() == "COMMAND_LONG"]
    assert any(np.isnan(numbers))
    assert any(np.isinf(numbers))


def test_an_interval_longer_than_its_field_is_told_as_the_longest() -> None:
    ground = Ground("px4")
    ground.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 3e38)
    ground.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT)
    assert of_type(ground.heard, "MESSAGE_INTERVAL")[-1].interval_us == 2**31 - 1


def test_vehicles_bear_mutated_frames() -> None:
    found = link_fuzz.vehicles(3_000, 5)
    assert found["faults"] == []
    assert found["heard"] > 1_500
    assert found["batches"] > 50
    assert found["corpus"] > 5


def test_the_ground_station_bears_mutated_frames() -> None:
    found = link_fuzz.ground_station(3_000, 5)
    assert found["faults"] == []
    assert found["heard"] > 1_500
    assert found["batches"] > 50


def test_a_vehicle_that_obeys_others_frames_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    obeyed = VehicleLink.receive

    def anybodys(self: VehicleLink, message: Any, link: Any, now_s: float) -> Any:
        if message.get_type() == "PARAM_SET":
            message.target_system = 0
        return obeyed(self, message, link, now_s)

    monkeypatch.setattr(VehicleLink, "receive", anybodys)
    [fault] = link_fuzz.vehicles(20_000, 1)["faults"]
    assert "changed by frames for others" in fault


def test_a_vehicle_that_breaks_is_found_with_the_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    obeyed = VehicleLink.receive

    def breaking(self: VehicleLink, message: Any, link: Any, now_s: float) -> Any:
        if message.get_type() == "MISSION_COUNT" and message.count > 60_000:
            raise ZeroDivisionError("no space")
        return obeyed(self, message, link, now_s)

    monkeypatch.setattr(VehicleLink, "receive", breaking)
    [fault] = link_fuzz.vehicles(20_000, 1)["faults"]
    assert fault.startswith("ZeroDivisionError: no space: f")


def test_a_station_that_believes_others_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    receive = PymavlinkLink.receive

    def as_from_another(self: PymavlinkLink, now_s: float) -> list[Any]:
        messages = receive(self, now_s)
        for message in messages:
            if message.get_type() == "MISSION_REQUEST":
                message.get_header().srcSystem = 2
        return messages

    monkeypatch.setattr(PymavlinkLink, "receive", as_from_another)
    [fault] = link_fuzz.ground_station(20_000, 1)["faults"]
    assert "changed by frames of others" in fault


def test_no_second_ground_station_alters_or_ends_an_upload() -> None:
    assert link_fuzz.spoofed_uploads(8, 5, 3)["faults"] == []


def test_a_vehicle_that_takes_items_of_everybody_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(MissionService, "_same", lambda *_: True)
    assert link_fuzz.spoofed_uploads(2, 20, 3)["faults"] != []


@pytest.mark.slow
@pytest.mark.parametrize("work", [link_fuzz.vehicles, link_fuzz.ground_station])
def test_nobody_breaks_or_grows_by_many_frames(work: Callable[[int, int], dict[str, Any]]) -> None:
    found = work(200_000, 11)
    assert found["faults"] == []
    assert found["memory_mb"] < 10.0


@pytest.mark.slow
@BOTH
def test_at_a_fifth_lost_nearly_all_uploads_are_verified_and_none_is_wrong(autopilot: Autopilot) -> None:
    for link, least in (("20% loss", 0.99), ("40% loss", 0.0)):
        verdicts = [t["verdict"] for t in link_trials.uploads(autopilot, link, 100, range(100))["trials"]]
        assert set(verdicts) <= {"verified", "refused"}
        assert verdicts.count("verified") >= least * len(verdicts)


# --- the report -------------------------------------------------------------------------------------------------------


def test_the_report_tells_all_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def ended(verdict: str, said: str = "") -> dict[str, Any]:
        good = verdict == "verified"
        return {
            "verdict": verdict,
            "upload_s": 10.0 if good else None,
            "verified_s": 20.0 if good else None,
            "said": said,
        }

    def found(jobs: Any, *_: Any, **__: Any) -> dict[str, Any]:
        results: dict[str, Any] = {}
        for job in jobs:
            if job.key == "second station":
                results[job.key] = {"uploads": 8, "frames": 1_234, "faults": ["px4: holds another mission"]}
            elif job.key.startswith("frames to"):
                results[job.key] = link_fuzz.Fuzzed(frames=job.arguments["frames"], faults=["a find: fd00"]).as_json()
            else:
                refused = ended("refused", "uav1: no answer")
                results[job.key] = {"trials": [ended("verified"), ended("wrong"), refused, ended("unclear", "?")]}
        return results

    load = link_loads.Load("missionplanner", "px4", 1, 1_000, 5, 0.3, 0.6, 0.1)
    served = link_loads.Telemetry(**dict.fromkeys((f.name for f in fields(link_loads.Telemetry)), 0.5))
    monkeypatch.setattr(links, "run", found)
    monkeypatch.setattr(links, "_loads", lambda *_, **__: [load])
    monkeypatch.setattr(links, "_telemetry", lambda **_: [served, served])
    figures = links.main(tmp_path, runs=4, frames=60_000)
    text = (tmp_path / "results.md").read_text()
    assert "| 40% loss | ardupilot | 4 | 25.0% | 1 | 1 | 1 | 10.0 | 20.0 | 20.0 |" in text
    assert "- missionplanner, px4, radio: uav1: no answer" in text or "radio: ?" in text
    assert "| the simulated vehicles | 60,000 |" in text
    assert text.count("- a find: fd00") == 4
    assert "1,234 messages" in text
    assert "1 of them ended otherwise" in text
    assert figures["loads"] == [asdict(load)]
    assert (tmp_path / "links.png").stat().st_size > 10_000
