"""Mission transfer, rule by rule: what is answered to what, when it is repeated, and how it fails."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem, plan_items
from adapters.mission_protocol import (
    OWN_COMPONENT,
    Message,
    MissionDownload,
    MissionUpload,
    Party,
    Timing,
    item_message,
    mismatches,
)
from missionplanner.errors import LinkError
from missionplanner.vehicle import Autopilot, VehicleClass
from tests.plans import FRAME, vehicle_plan

PARTY = Party("uav3", 3)
ITEMS = plan_items(vehicle_plan(), FRAME)
PX4_ITEMS = plan_items(vehicle_plan(autopilot="px4"), FRAME)
LAST = len(ITEMS) - 1
_AIR = mavlink.MAVLink(None, srcSystem=3, srcComponent=1)


def from_vehicle(message: Message) -> Message:
    message.pack(_AIR)
    return message


def request(seq: int, *, integer: bool = False) -> Message:
    kind = mavlink.MAVLink_mission_request_int_message if integer else mavlink.MAVLink_mission_request_message
    return from_vehicle(kind(255, OWN_COMPONENT, seq))


def ack(result: int) -> Message:
    return from_vehicle(mavlink.MAVLink_mission_ack_message(255, OWN_COMPONENT, result))


def count(number: int) -> Message:
    return from_vehicle(mavlink.MAVLink_mission_count_message(255, OWN_COMPONENT, number))


def begun(autopilot: Autopilot = "ardupilot", upto: int | None = None) -> MissionUpload:
    """Return an upload in which the vehicle has asked for items 0 to ``upto``."""
    upload = MissionUpload(PARTY, autopilot, ITEMS)
    upload.poll(0.0)
    for seq in range(-1 if upto is None else upto + 1):
        upload.receive(request(seq), 0.01 * seq)
    return upload


@pytest.mark.parametrize("integer", [False, True])
def test_an_upload_from_count_to_ack(integer: bool) -> None:
    upload = MissionUpload(PARTY, "ardupilot", ITEMS)
    [first] = upload.poll(0.0)
    assert (first.get_type(), first.target_system, first.count) == ("MISSION_COUNT", 3, len(ITEMS))
    for seq, item in enumerate(ITEMS):
        [reply] = upload.receive(request(seq, integer=integer), 0.1)
        assert reply.get_type() == "MISSION_ITEM_INT"
        assert (reply.target_system, reply.target_component, reply.seq) == (3, 1, seq)
        assert (reply.x, reply.y, reply.frame, reply.command) == (item.x, item.y, item.frame, item.command)
        assert upload.sent == seq
        assert not upload.done
    assert upload.receive(ack(0), 0.2) == []
    assert upload.done
    assert upload.confirmed
    assert upload.sent == upload.total == len(ITEMS)


def test_exactly_one_item_is_current() -> None:
    assert sum(item_message(item, 3).current for item in ITEMS) == 1


def test_nothing_is_said_before_it_is_time() -> None:
    upload = begun()
    assert upload.poll(1.49) == []
    assert [m.get_type() for m in upload.poll(1.5)] == ["MISSION_COUNT"]
    upload.receive(request(0), 1.6)
    assert upload.poll(1.84) == []
    [again] = upload.poll(2.2)
    assert (again.get_type(), again.seq) == ("MISSION_ITEM_INT", 0)


def test_the_wait_follows_the_round_trips() -> None:
    slow, fast = begun(), begun()
    for seq in range(5):
        slow.receive(request(seq), 0.8 * (seq + 1))
        fast.receive(request(seq), 0.01 * (seq + 1))
    assert fast.poll(0.05 + 0.25) != []
    assert slow.poll(4.0 + 0.6) == []


def test_silence_to_count_is_an_error_that_names_the_vehicle() -> None:
    upload = MissionUpload(PARTY, "ardupilot", ITEMS)
    sent, now_s = 0, 0.0
    with pytest.raises(LinkError, match=r"uav3 \(sysid 3\): .*no answer to 11 MISSION_COUNTs; it may hold a mixture"):
        while now_s < 60.0:
            sent += len(upload.poll(now_s))
            now_s += 0.1
    assert sent == 11
    assert now_s == pytest.approx(16.5, abs=1.0)


def test_a_vehicle_that_vanishes_in_mid_upload_is_told_with_its_state() -> None:
    for autopilot, state in (("ardupilot", "mixture of the old mission and the new"), ("px4", "keeps its old mission")):
        upload = begun(autopilot, 2)  # type: ignore[arg-type]
        now_s = 0.1
        with pytest.raises(LinkError, match=state):
            while now_s < 300.0:
                upload.poll(now_s)
                now_s += 0.1
        assert now_s < 100.0


def test_a_vehicle_that_asks_for_one_item_for_ever_is_given_up() -> None:
    upload = begun(upto=2)
    now_s = 0.1
    with pytest.raises(LinkError, match=r"given up after 4 attempts: no progress after item 2 \(command 178\) of 5"):
        while now_s < 300.0:
            upload.poll(now_s)
            upload.receive(request(2), now_s)
            now_s += 0.5


def test_accepted_before_the_last_item_is_an_error() -> None:
    upload = begun(upto=LAST - 1)
    with pytest.raises(LinkError, match=r"accepted the mission before its last item was sent \(item 4"):
        upload.receive(ack(0), 1.0)
    assert not upload.done


def test_an_echo_of_an_earlier_transfer_does_not_end_one_that_has_not_begun() -> None:
    upload = begun()
    assert upload.receive(ack(0), 0.1) == []
    assert upload.receive(ack(mavlink.MAV_MISSION_OPERATION_CANCELLED), 0.1) == []
    assert not upload.done
    assert upload.receive(request(0), 0.2) != []


def test_no_space_just_after_connecting_is_asked_again() -> None:
    upload = begun()
    now_s = 0.0
    for _ in range(8):
        assert upload.receive(ack(mavlink.MAV_MISSION_NO_SPACE), now_s) == []
        assert upload.poll(now_s + 0.9) == []
        now_s += 1.0
        assert [m.get_type() for m in upload.poll(now_s)] == ["MISSION_COUNT"]
    for seq in range(len(ITEMS)):
        upload.receive(request(seq), now_s)
    upload.receive(ack(0), now_s)
    assert upload.done


def test_no_space_for_ever_is_an_error() -> None:
    upload = begun()
    with pytest.raises(LinkError, match=r"refused a mission of 6 items \(no space\) 13 times"):
        for k in range(20):
            upload.receive(ack(mavlink.MAV_MISSION_NO_SPACE), float(k))
            upload.poll(float(k) + 1.0)


def test_ardupilots_invalid_sequence_is_no_end() -> None:
    upload = begun(upto=3)
    assert upload.receive(ack(mavlink.MAV_MISSION_INVALID_SEQUENCE), 0.1) == []
    assert upload.receive(request(4), 0.1) != []


def test_px4s_invalid_sequence_begins_anew() -> None:
    upload = begun("px4", 3)
    assert [m.get_type() for m in upload.receive(ack(mavlink.MAV_MISSION_INVALID_SEQUENCE), 0.1)] == ["MISSION_COUNT"]


def test_a_lost_ack_leaves_the_upload_to_the_read_back() -> None:
    upload = begun(upto=LAST)
    assert [m.seq for m in upload.poll(5.0)] == [LAST]
    upload.receive(ack(mavlink.MAV_MISSION_ERROR), 5.1)  # "item after completion"
    assert upload.done
    assert not upload.confirmed


def test_px4_acknowledges_the_last_item_again() -> None:
    upload = begun("px4", LAST)
    assert [m.seq for m in upload.poll(5.0)] == [LAST]
    upload.receive(ack(0), 5.1)
    assert upload.confirmed


def test_a_cancelled_transfer_is_begun_again_a_few_times() -> None:
    upload = begun(upto=2)
    for _ in range(3):
        [again] = upload.receive(ack(mavlink.MAV_MISSION_OPERATION_CANCELLED), 1.0)
        assert again.get_type() == "MISSION_COUNT"
        upload.receive(request(0), 1.0)
    with pytest.raises(LinkError, match="given up after 4 attempts: a cancelled transfer"):
        upload.receive(ack(mavlink.MAV_MISSION_OPERATION_CANCELLED), 1.0)


def test_the_last_item_of_an_attempt_before_does_not_count() -> None:
    upload = begun(upto=LAST)
    upload.receive(ack(mavlink.MAV_MISSION_OPERATION_CANCELLED), 1.0)
    upload.receive(request(0), 1.1)
    with pytest.raises(LinkError, match="before its last item was sent"):
        upload.receive(ack(0), 1.2)


def test_requests_after_the_end_are_still_served() -> None:
    upload = begun(upto=LAST)
    upload.receive(ack(0), 1.0)
    [reply] = upload.receive(request(0), 2.0)
    assert reply.seq == 0
    assert upload.poll(100.0) == []
    assert upload.receive(ack(mavlink.MAV_MISSION_OPERATION_CANCELLED), 3.0) == []
    assert upload.done


@pytest.mark.parametrize(
    ("result", "says"),
    [
        (2, r"unsupported frame, item 2 \(command 178\)"),
        (3, "unsupported command"),
        (6, "invalid param1"),
        (10, "invalid latitude"),
        (14, "another ground station"),
        (99, "MAV_MISSION_RESULT 99"),
    ],
)
def test_refusals_are_told_in_words(result: int, says: str) -> None:
    upload = begun(upto=2)
    with pytest.raises(LinkError, match=says) as error:
        upload.receive(ack(result), 1.0)
    assert str(error.value).startswith("uav3 (sysid 3): refused")


def test_requests_beyond_the_mission_are_ignored() -> None:
    upload = begun()
    assert upload.receive(request(len(ITEMS)), 0.1) == []
    assert upload.poll(0.2) == []


def test_an_empty_mission_clears() -> None:
    upload = MissionUpload(PARTY, "px4", ())
    [first] = upload.poll(0.0)
    assert first.count == 0
    upload.receive(ack(0), 0.1)
    assert upload.confirmed


def test_a_download_from_list_to_ack() -> None:
    download = MissionDownload(PARTY)
    [first] = download.poll(0.0)
    assert (first.get_type(), first.target_system) == ("MISSION_REQUEST_LIST", 3)
    replies = download.receive(count(len(ITEMS)), 0.1)
    for seq, item in enumerate(ITEMS):
        [asked] = replies
        assert (asked.get_type(), asked.seq) == ("MISSION_REQUEST_INT", seq)
        message = item_message(item, 255)
        message.target_component = OWN_COMPONENT
        if seq == 2:  # an item that was not asked for changes nothing
            stray = item_message(ITEMS[4], 255)
            stray.target_component = OWN_COMPONENT
            assert download.receive(from_vehicle(stray), 0.2) == []
        replies = download.receive(from_vehicle(message), 0.2)
    assert [m.get_type() for m in replies] == ["MISSION_ACK"]
    assert download.done
    assert download.items == ITEMS
    assert download.total == len(ITEMS)


def test_an_empty_vehicle_reads_back_empty() -> None:
    download = MissionDownload(PARTY)
    download.poll(0.0)
    [reply] = download.receive(count(0), 0.1)
    assert reply.get_type() == "MISSION_ACK"
    assert download.items == ()


def test_a_download_asks_again_and_gives_up() -> None:
    download = MissionDownload(PARTY)
    now_s, sent = 0.0, 0
    with pytest.raises(LinkError, match=r"uav3 \(sysid 3\): .*MISSION_REQUEST_LIST"):
        while now_s < 60.0:
            sent += len(download.poll(now_s))
            now_s += 0.1
    assert sent == 11
    reading = MissionDownload(PARTY, timing=Timing(read_attempts=1))
    reading.poll(0.0)
    reading.receive(count(4), 0.1)
    now_s = 0.1
    with pytest.raises(LinkError, match="given up after 1 attempts: silence at item 0 of 4"):
        while now_s < 300.0:
            reading.poll(now_s)
            now_s += 0.1


def test_a_busy_vehicle_is_asked_for_its_mission_again() -> None:
    download = MissionDownload(PARTY)
    download.poll(0.0)
    assert download.receive(ack(mavlink.MAV_MISSION_DENIED), 0.1) == []
    assert download.poll(1.0) == []
    assert [m.get_type() for m in download.poll(1.2)] == ["MISSION_REQUEST_LIST"]
    with pytest.raises(LinkError, match="refused to give its mission"):
        for k in range(20):
            download.receive(ack(mavlink.MAV_MISSION_DENIED), 2.0 + k)


def test_firmware_without_rally_points_holds_none() -> None:
    download = MissionDownload(PARTY, mission_type=mavlink.MAV_MISSION_TYPE_RALLY)
    download.poll(0.0)
    refusal = mavlink.MAVLink_mission_ack_message(255, OWN_COMPONENT, mavlink.MAV_MISSION_UNSUPPORTED, mission_type=2)
    refusal.pack(mavlink.MAVLink(None, srcSystem=PARTY.sysid, srcComponent=1))
    assert download.receive(refusal, 0.1) == []
    assert (download.done, download.items, download.total) == (True, (), 0)
    mission = MissionDownload(PARTY)
    mission.poll(0.0)
    mission.receive(ack(mavlink.MAV_MISSION_UNSUPPORTED), 0.1)
    assert not mission.done


def test_a_mission_that_changes_while_it_is_read_is_read_anew() -> None:
    download = MissionDownload(PARTY)
    download.poll(0.0)
    download.receive(count(4), 0.1)
    assert download.receive(count(4), 0.2) == []
    assert [m.get_type() for m in download.receive(count(5), 0.2)] == ["MISSION_REQUEST_LIST"]


def test_what_autopilots_are_known_to_rewrite_is_no_mismatch() -> None:
    read = list(ITEMS)
    read[0] = replace(read[0], z=1200.09, x=read[0].x + 3)  # the vehicle's own home
    read[2] = replace(read[2], frame=0)
    read[3] = replace(read[3], z=1251.24, current=1)
    read[5] = replace(read[5], param4=1.0)
    assert mismatches(ITEMS, read, "ardupilot") == []
    rtl = plan_items(vehicle_plan(end="rtl"), FRAME)
    assert mismatches(rtl, [*rtl[:-1], replace(rtl[-1], frame=0)], "ardupilot") == []
    old_names = [replace(item, frame={0: 5, 3: 6}.get(item.frame, item.frame)) for item in PX4_ITEMS]
    assert mismatches(PX4_ITEMS, old_names, "px4") == []


@pytest.mark.parametrize(
    ("seq", "change", "field"),
    [
        (1, {"z": 30.02}, "z"),
        (1, {"frame": 0}, "frame"),
        (2, {"param2": 7.0}, "param2"),
        (2, {"param1": 0.0}, "param1"),
        (3, {"x": 1}, "x"),
        (3, {"y": ITEMS[3].y + 1}, "y"),
        (3, {"frame": 3}, "frame"),
        (4, {"command": 82}, "command"),
        (4, {"param1": 2.0}, "param1"),
        (5, {"x": 0, "y": 0}, "x"),
    ],
)
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_what_would_change_the_flight_is_a_mismatch(
    autopilot: Autopilot, seq: int, change: dict[str, float], field: str
) -> None:
    items = ITEMS if autopilot == "ardupilot" else (MissionItem(0, 0, 22), *ITEMS[1:])
    read = [*items[:seq], replace(items[seq], **change), *items[seq + 1 :]]  # type: ignore[arg-type]
    found = mismatches(items, read, autopilot)
    assert (found[0].seq, found[0].field) == (seq, field)
    assert str(found[0]).startswith(f"item {seq}: {field}: sent ")


def test_a_short_read_back_is_a_mismatch() -> None:
    [found] = mismatches(ITEMS, ITEMS[:-1], "ardupilot")
    assert str(found) == "item 5: count of items: sent 6, the vehicle holds 5"
    assert mismatches(ITEMS, (), "px4")


def test_px4s_home_item_is_no_home() -> None:
    read = [replace(PX4_ITEMS[0], z=1.0), *PX4_ITEMS[1:]]
    assert [found.field for found in mismatches(PX4_ITEMS, read, "px4")] == ["z"]


def test_a_choice_left_to_the_vehicle_must_stay_so() -> None:
    read = [replace(item, param4=0.0 if math.isnan(item.param4) else item.param4) for item in PX4_ITEMS]
    assert {found.field for found in mismatches(PX4_ITEMS, read, "px4")} == {"param4"}


def test_commands_without_a_mask_are_compared_entirely() -> None:
    item = MissionItem(0, 2, 206, 10.0, 0.0, 1.0)
    assert mismatches([item], [replace(item, param3=0.0)], "px4")
    assert not mismatches([item], [item], "px4")


def test_five_requests_ahead_are_all_served() -> None:
    """As MAVProxy asks; an item that is lost is asked for alone."""
    upload = begun()
    for ahead in range(LAST + 1):
        [item] = upload.receive(request(ahead), 0.1)
        assert item.seq == ahead
    [again] = upload.receive(request(2), 0.5)
    assert again.seq == 2
    assert not upload.done
    upload.receive(ack(0), 0.6)
    assert upload.confirmed


def test_a_vehicle_that_asks_for_the_same_items_for_ever_is_given_up() -> None:
    """Also by turns, also from the beginning: only what is asked for the first time is progress."""
    for cycle in ((1, 2), tuple(range(LAST))):
        upload = begun(upto=2)
        now_s = 0.1
        with pytest.raises(LinkError, match="given up after 4 attempts: no progress"):
            while now_s < 2_000.0:
                for seq in cycle:
                    upload.poll(now_s)
                    upload.receive(request(seq), now_s)
                    now_s += 0.4
        assert now_s < 600.0


def test_silence_after_the_last_item_leaves_it_to_the_read_back() -> None:
    upload = begun(upto=LAST)
    now_s = 0.1
    while not upload.done and now_s < 100.0:
        assert {m.seq for m in upload.poll(now_s)} <= {LAST}
        now_s += 0.1
    assert upload.done
    assert not upload.confirmed


@pytest.mark.parametrize(("kind", "what"), [(1, "a fence"), (2, "a set of rally points")])
def test_too_many_fence_or_rally_items_are_told_as_such(kind: int, what: str) -> None:
    upload = MissionUpload(PARTY, "px4", ITEMS, mission_type=kind)
    [first] = upload.poll(0.0)
    assert first.mission_type == kind
    refusal = from_vehicle(mavlink.MAVLink_mission_ack_message(255, OWN_COMPONENT, mavlink.MAV_MISSION_NO_SPACE, kind))
    assert upload.receive(ack(mavlink.MAV_MISSION_NO_SPACE), 0.1) == []  # of a mission
    now_s = 0.1
    with pytest.raises(LinkError, match=rf"refused {what} of 6 items \(no space\) 13 times; it holds fewer"):
        while now_s < 60.0:
            upload.receive(refusal, now_s)
            now_s += 1.0
            upload.poll(now_s)


def item(command: int, frame: int = 0, *params: float, x: int = 5, y: int = 7, z: float = 30.0) -> MissionItem:
    return MissionItem(1, frame, command, *params, *[0.0] * (4 - len(params)), x=x, y=y, z=z)


@pytest.mark.parametrize(
    ("sent", "read", "autopilot", "vehicle_class", "fields"),
    [
        (item(16, 0, 2.9), item(16, 0, 2.0), "ardupilot", "copter", []),
        (item(16, 0, 2.9), item(16, 0, 0.0), "ardupilot", "copter", ["param1"]),
        (item(16, 0, 0.0, 45.0), item(16, 0, 0.0, 45.0), "ardupilot", "plane", []),
        (item(16, 0, 0.0, 45.0), item(16, 0, 0.0, 0.0), "ardupilot", "plane", ["param2"]),
        (item(17, 0, 0.0, 0.0, -60.5), item(17, 0, 0.0, 0.0, -60.0), "ardupilot", "plane", []),
        (item(17, 0, 0.0, 0.0, -60.0), item(17, 0, 0.0, 0.0, 60.0), "ardupilot", "plane", ["param3"]),
        (item(16, 0, 0.0, 2.0, 0.0, -90.0), item(16, 0, 0.0, 2.0, 0.0, 270.0), "px4", "copter", []),
        (item(16, 0, 0.0, 2.0, 0.0, -90.0), item(16, 0, 0.0, 2.0, 0.0, 90.0), "px4", "copter", ["param4"]),
        (item(195, 0), item(195, 0), "ardupilot", "copter", []),
        (item(195, 3), item(195, 0), "ardupilot", "copter", ["frame"]),
        (item(195, 0), item(195, 0, x=6), "ardupilot", "copter", ["x"]),
        (item(206, 2, 25.0), item(206, 0, 25.0, x=0, y=0, z=0.0), "ardupilot", "copter", []),
        (item(206, 2, 25.0), item(206, 0, 24.0, x=0, y=0, z=0.0), "ardupilot", "copter", ["param1"]),
        (item(5002, 3, 4.0), item(5002, 0, 4.0, z=0.0), "ardupilot", "copter", []),
        (item(5002, 3, 4.0), item(5002, 0, 3.0, y=8), "ardupilot", "copter", ["param1", "y"]),
        (item(5004, 0, 80.5), item(5004, 0, 80.5), "px4", "copter", []),
        (item(5100, 3, z=41.7), item(5100, 3, z=41.0), "ardupilot", "copter", []),
        (item(5100, 3, z=41.7), item(5100, 0, z=41.7), "px4", "copter", ["frame"]),
    ],
)
def test_what_is_compared_depends_on_firmware_and_command(
    sent: MissionItem, read: MissionItem, autopilot: Autopilot, vehicle_class: VehicleClass, fields: list[str]
) -> None:
    kind = {5002: 1, 5004: 1, 5100: 2}.get(sent.command, 0)
    found = mismatches([replace(sent, seq=1)] * 2, [read] * 2, autopilot, vehicle_class, mission_type=kind)
    assert [m.field for m in found] == fields * 2


def test_only_a_mission_has_its_home_as_first_item() -> None:
    sent, read = [replace(item(5001, 0, 3.0), seq=0)], [replace(item(5001, 0, 3.0, x=6), seq=0)]
    assert mismatches(sent, read, "ardupilot") == []
    assert [m.field for m in mismatches(sent, read, "ardupilot", mission_type=1)] == ["x"]


def asked(messages: list[Message]) -> list[int]:
    assert {m.get_type() for m in messages} <= {"MISSION_REQUEST_INT"}
    return [m.seq for m in messages]


def reading(ahead: int) -> MissionDownload:
    download = MissionDownload(PARTY, ahead=ahead)
    download.poll(0.0)
    return download


def from_ours(item: MissionItem) -> Message:
    """Return an item as the vehicle sends it to us."""
    message = item_message(item, PARTY.own_sysid)
    message.target_component = PARTY.own_component
    return from_vehicle(message)


def test_several_items_at_once_in_any_order_and_only_what_is_missing_again() -> None:
    download = reading(3)
    assert asked(download.receive(count(6), 0.1)) == [0, 1, 2]
    assert asked(download.receive(from_ours(ITEMS[1]), 0.2)) == [3]
    assert asked(download.receive(from_ours(ITEMS[1]), 0.2)) == []  # twice
    assert asked(download.receive(from_ours(ITEMS[3]), 0.3)) == [4]
    assert asked(download.poll(0.4)) == []
    assert asked(download.poll(1.2)) == [0, 2, 4]
    assert asked(download.receive(from_ours(ITEMS[0]), 1.3)) == [5]
    for seq in (5, 4):
        assert asked(download.receive(from_ours(ITEMS[seq]), 1.4)) == []
    assert not download.done
    [last] = download.receive(from_ours(ITEMS[2]), 1.5)
    assert last.get_type() == "MISSION_ACK"
    assert download.items == ITEMS


def test_copies_of_a_repeated_request_are_given_time_to_arrive() -> None:
    """PX4 ends a download at any request but the next and the last one."""
    download = reading(1)
    assert asked(download.receive(count(6), 0.1)) == [0]
    assert asked(download.receive(from_ours(ITEMS[0]), 0.2)) == [1]  # nothing else is under way
    assert asked(download.poll(0.6)) == [1]
    assert asked(download.receive(from_ours(ITEMS[1]), 0.65)) == []  # the first copy's answer; the second is on its way
    assert asked(download.poll(0.7)) == []
    assert asked(download.poll(0.91)) == [2]
    assert asked(download.receive(from_ours(ITEMS[2]), 1.0)) == [3]


def test_no_wait_is_so_long_that_an_autopilot_gives_up() -> None:
    """Round trips of 2 s: it is still asked seven times in the 5 s after which PX4 ends a download."""
    download = reading(1)
    download.receive(count(6), 2.0)
    now_s, asks = 2.0, 0
    while now_s < 7.0:
        now_s += 0.01
        asks += len(download.poll(now_s))
    assert asks >= 7
