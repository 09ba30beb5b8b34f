"""Vehicles that misbehave on demand, and what we make of each: a verified mission, or one clear error."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import in_process_pair
from adapters.mission_protocol import mismatches
from adapters.vehicle_parameters import read_parameters
from missionplanner.errors import LinkError, MissionError
from missionplanner.vehicle import Autopilot
from sim.fleet import LockstepClock, SimFleet, planned_vehicles, sim_vehicles
from sim.misbehaviour import QGROUNDCONTROL_FAULTS, Fault, faults_of, parse_fault
from tests.plans import small_fleet
from tests.rig import Rig
from tests.simulated import HOME, Ground, item_message, mission, of_type

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])


def rig_with(autopilot: Autopilot, words: str) -> Rig:
    """Return a fleet of two, the second of which misbehaves."""
    plan = small_fleet(autopilot, 2)
    first, second = planned_vehicles(plan)
    return Rig(plan, vehicles=[first, replace(second, faults=(parse_fault(f"vehicle 2: {words}")[1],))])


NO_ANSWER = "got no answer to"
GIVEN_UP = "given up after"
REFUSED = "refused a mission of"
UPLOADS: dict[str, str | None] = {
    # how each ends: verified (None), or with an error that says this of vehicle 2
    "FailReadRequestListNoResponse": NO_ANSWER,
    "FailReadRequestListFirstResponse": None,
    "FailReadRequest0NoResponse": GIVEN_UP,
    "FailReadRequest1NoResponse": GIVEN_UP,
    "FailReadRequest1FirstResponse": None,
    "FailReadRequest0IncorrectSequence": GIVEN_UP,
    "FailReadRequest1IncorrectSequence": GIVEN_UP,
    "FailReadRequest0ErrorAck": GIVEN_UP,
    "FailReadRequest1ErrorAck": GIVEN_UP,
    "FailWriteMissionCountNoResponse": NO_ANSWER,
    "FailWriteMissionCountFirstResponse": None,
    "FailWriteRequest1NoResponse": f"{GIVEN_UP}|{REFUSED}",  # PX4 is busy with the upload that it waits for
    "FailWriteRequest0IncorrectSequence": GIVEN_UP,
    "FailWriteRequest1IncorrectSequence": GIVEN_UP,
    "FailWriteRequest0ErrorAck": REFUSED,
    "FailWriteRequest1ErrorAck": f"{GIVEN_UP}|{REFUSED}",
    "FailWriteFinalAckNoResponse": None,  # the read-back decides
    "wrong MISSION_ACK 14": "refused the upload (DENIED)",
    "error 9 instead of MISSION_REQUEST item 1": "refused the mission: invalid param4",
    "error 15 instead of MISSION_REQUEST item 1 once": None,
    "FailWriteFinalAckMissingRequests": "before its last item was sent",
    "reboot at item 2": None,  # the upload begins anew
    "silent at item 2": NO_ANSWER,
    "silent at item 2 for 3 s": None,
    "deaf": "expected an answer to REQUEST_MESSAGE, got none",
    "changed MISSION_ITEM item 3": "holds another mission than was sent: item 3: z",
}


@BOTH
@pytest.mark.parametrize("words", UPLOADS)
def test_a_misbehaving_vehicle_ends_in_a_verified_mission_or_one_clear_error(autopilot: Autopilot, words: str) -> None:
    rig = rig_with(autopilot, words)
    said = ""
    try:
        rig.link.connect()
        rig.link.upload()
        rig.link.verify()
    except LinkError as error:
        said = str(error)
    expected = UPLOADS[words]
    if expected is None:
        assert said == ""
    else:
        others = said.replace("uav1: it holds the new mission, not read back", "")
        assert "uav2 (sysid 2)" in said and "uav1" not in others and "\n" not in said
        assert any(part in said for part in expected.split("|")), said
    assert not any(link.autopilot.armed for link in rig.sim.links)
    for link in rig.sim.links:
        held = link.missions.items()
        if said == "" or (link.sysid == 1 and "nothing was uploaded" not in said):
            assert not mismatches(rig.link.items[link.sysid], held, autopilot)


def test_a_final_ack_that_refuses_is_believed_only_where_the_autopilot_means_it() -> None:
    """ArduPilot's ERROR after the last item may be about an item sent twice: the read-back decides."""
    ardupilot, px4 = (rig_with(autopilot, "FailWriteFinalAckErrorAck") for autopilot in ("ardupilot", "px4"))
    for rig in (ardupilot, px4):
        rig.link.connect()
    ardupilot.link.upload()
    ardupilot.link.verify()
    with pytest.raises(LinkError, match=r"uav2 \(sysid 2\): upload given up after"):
        px4.link.upload()


def test_every_failure_mode_of_qgroundcontrols_mission_handler_is_tested() -> None:
    modes = {name for name in QGROUNDCONTROL_FAULTS if name.startswith(("FailRead", "FailWrite"))}
    assert len(modes) == 19
    assert modes == {name for name in UPLOADS if name.startswith("Fail")} | {"FailWriteFinalAckErrorAck"}


@BOTH
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("FailParamSetNoAck", None),  # it is set all the same, and read back
        ("FailParamSetFirstAttemptNoAck", None),
        ("FailParamRequestReadNoResponse", "expected parameter RTL_"),
        ("FailParamRequestReadFirstAttemptNoResponse", None),
        ("FailInitialConnectRequestMessageAutopilotVersionFailure", None),
        ("FailInitialConnectRequestMessageAutopilotVersionLost", None),
        ("FailRequestMessageCommandAcceptedMsgNotSent", None),
        ("FailRequestMessageCommandUnsupported", None),
        ("FailRequestMessageCommandNoResponse", "expected an answer to REQUEST_MESSAGE, got none"),
    ],
)
def test_parameters_of_a_misbehaving_vehicle_are_set_or_not_and_said(
    autopilot: Autopilot, words: str, expected: str | None
) -> None:
    rig = rig_with(autopilot, words)
    if expected is not None:
        with pytest.raises(LinkError, match=rf"uav2 \(sysid 2\): {expected}"):
            rig.link.connect()
            rig.link.set_returns()
        return
    rig.link.connect()
    changes = [change for change in rig.link.set_returns() if change.vehicle == "uav2"]
    assert changes
    for change in changes:
        assert rig.sim.links[1].autopilot.parameters[change.name] == pytest.approx(change.after)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("FailParamNoResponseToRequestList", r"sysid 1.*"),
        ("FailMissingParamOnInitialRequest", None),
        ("FailMissingParamOnAllRequests", r"sysid 1.*"),
    ],
)
def test_a_parameter_list_is_complete_or_an_error(words: str, expected: str | None) -> None:
    (vehicle,) = sim_vehicles(1, HOME)
    fleet = SimFleet([replace(vehicle, faults=(parse_fault(f"vehicle 1: {words}")[1],))])
    ground, air = in_process_pair()
    fleet.attach(air)
    if expected is not None:
        with pytest.raises(LinkError, match=expected):
            read_parameters([ground], LockstepClock(fleet), everything=True)
        return
    held = read_parameters([ground], LockstepClock(fleet), everything=True)
    assert set(held[1].values) == set(fleet.links[0].autopilot.parameters)


# -- the words -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "sysid", "fault"),
    [
        ("vehicle 2: reboot at item 5", 2, Fault("reboot", item=5, times=1)),
        ("vehicle 1: reboot after 30 s", 1, Fault("reboot", times=1, after_s=30.0)),
        ("all vehicles: silent after 10 s for 2.5 s", None, Fault("silent", after_s=10.0, for_s=2.5)),
        ("vehicle 3: no MISSION_ITEM item 1 once", 3, Fault("mute", "MISSION_ITEM", 1, times=1)),
        ("vehicle 3: no answer to COMMAND_LONG 400", 3, Fault("unanswered", "COMMAND_LONG", 400)),
        ("vehicle 3: deaf to MISSION_COUNT", 3, Fault("deaf", "MISSION_COUNT")),
        ("vehicle 3: error instead of MISSION_REQUEST item 0", 3, Fault("error", "MISSION_REQUEST", 0)),
        ("vehicle 3: error 14 instead of MISSION_REQUEST", 3, Fault("error", "MISSION_REQUEST", result=14)),
        ("vehicle 3: wrong MISSION_ACK 4 once", 3, Fault("wrong", "MISSION_ACK", times=1, result=4)),
        ("vehicle 1: FailWriteFinalAckNoResponse once", 1, Fault("mute", "MISSION_ACK", times=1)),
    ],
)
def test_faults_are_read(text: str, sysid: int | None, fault: Fault) -> None:
    assert parse_fault(text) == (sysid, fault)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("reboot", r"expected 'vehicle N: FAULT'.*faults are: reboot"),
        ("vehicle 2: explode", r"'explode' is none; faults are: .*deaf \[to MESSAGE\].*FailReadRequestListNoResponse"),
        ("vehicle 2: FailReadRequest0", r"'FailReadRequest0' is none; .* like it: FailReadRequest0"),
        ("vehicle 2: no MISSION_ITEMS", r"expected the name of a MAVLink message, got 'MISSION_ITEMS'"),
        ("vehicle 2: no HEARTBEAT item 3", r"expected no number after HEARTBEAT"),
        ("vehicle 2: wrong HEARTBEAT", r"expected a message with a seq, or an acknowledgement"),
        ("vehicle 2: error 99 instead of MISSION_REQUEST", r"expected a MAV_MISSION_RESULT from 0 to 15"),
        ("vehicle 2: silent after 1.2.3 s", r"expected seconds as a number"),
        ("vehicle 9: reboot", r"expected a vehicle from 1 to 3, got 'vehicle 9: reboot'"),
    ],
)
def test_words_that_mean_no_fault_are_refused(text: str, expected: str) -> None:
    with pytest.raises(MissionError, match=expected):
        faults_of([text], [1, 2, 3])


def test_faults_add_up_by_vehicle() -> None:
    found = faults_of(["all vehicles: deaf", "vehicle 2: silent"], [1, 2])
    assert {sysid: [f.kind for f in faults] for sysid, faults in found.items()} == {1: ["deaf"], 2: ["deaf", "silent"]}


# -- what a faulty vehicle does --------------------------------------------------------------------------------------


def faulty(autopilot: Autopilot, *words: str) -> Ground:
    ground = Ground(autopilot)
    pipe, ground._pipe = in_process_pair("faulty")
    (vehicle,) = sim_vehicles(1, HOME, autopilot=autopilot)
    ground.fleet = SimFleet([replace(vehicle, faults=faults_of([f"vehicle 1: {w}" for w in words], [1])[1])])
    ground.fleet.attach(pipe)
    ground.vehicle = ground.fleet.links[0]
    ground.autopilot = ground.vehicle.autopilot
    return ground


def test_silence_has_a_beginning_and_an_end() -> None:
    ground = faulty("px4", "silent after 5 s for 10 s")
    assert of_type(ground.run(4.9), "HEARTBEAT")
    assert ground.run(9.9) == []
    assert of_type(ground.run(2.0), "HEARTBEAT")


def test_a_reboot_at_a_time_happens_once() -> None:
    ground = faulty("ardupilot", "reboot after 5 s")
    ground.run(4.9)
    assert ground.run(2.9) == []
    heard = ground.run(20.0)
    assert max(m.time_boot_ms for m in of_type(heard, "GLOBAL_POSITION_INT")) < 20_000


@BOTH
def test_a_reboot_in_mid_upload_leaves_what_the_autopilot_had_stored(autopilot: Autopilot) -> None:
    ground = faulty(autopilot, "reboot at item 2")
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, len(mission(autopilot))))
    replies: list[Any] = []
    for item in mission(autopilot)[:2]:
        replies = ground.send(item_message(item))
    assert replies == []
    heard = ground.run(15.0)
    assert not of_type(heard, "MISSION_REQUEST") and not of_type(heard, "MISSION_REQUEST_INT")
    assert len(ground.vehicle.missions.items()) == (2 if autopilot == "ardupilot" else 0)  # PX4's is atomic
    assert ground.upload(mission(autopilot)) == mavlink.MAV_MISSION_ACCEPTED  # this time nothing happens


def test_a_fault_that_counts_heeds_only_what_was_meant_for_the_vehicle() -> None:
    ground = faulty("px4", "deaf to MISSION_COUNT once")
    assert ground.send(mavlink.MAVLink_mission_count_message(2, 1, 3)) == []  # another's
    assert ground.send(mavlink.MAVLink_mission_count_message(1, 1, 3)) == []
    assert of_type(ground.send(mavlink.MAVLink_mission_count_message(1, 1, 3)), "MISSION_REQUEST")


def test_without_faults_a_vehicle_is_what_it_was() -> None:
    plain, never = Ground("ardupilot"), faulty("ardupilot", f"silent after {1e9:.0f} s")
    assert [m.to_dict() for m in plain.run(10.0)] == [m.to_dict() for m in never.run(10.0)]
    assert math.isinf(Fault("deaf").times)
