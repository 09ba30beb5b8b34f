"""The vehicle's half of mission transfer, as measured on real autopilots."""

from __future__ import annotations

from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import in_process_pair
from adapters.mission_items import MissionItem
from missionplanner.vehicle import Autopilot
from tests.simulated import LAT, NAN, Ground, item_message, mission, of_type, texts

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])


def count(n: int, kind: int = 0) -> mavlink.MAVLink_mission_count_message:
    return mavlink.MAVLink_mission_count_message(1, 1, n, kind)


def other_ground(ground: Ground) -> Ground:
    """Return a second ground station (sysid 254) that talks to the same vehicle."""
    second = Ground(sysid=254)
    second.fleet.close()
    theirs = ground.fleet
    second.fleet, second.vehicle, second.autopilot = theirs, ground.vehicle, ground.autopilot
    end, second._pipe = in_process_pair("second")
    theirs.attach(end)
    return second


@BOTH
def test_upload_is_requested_item_by_item_and_accepted(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    assert ground.upload(mission(autopilot)) == mavlink.MAV_MISSION_ACCEPTED
    assert len(ground.vehicle.missions.items()) == len(mission(autopilot))


def test_ardupilot_asks_with_plain_requests() -> None:
    ground = Ground("ardupilot")
    ground.upload(mission("ardupilot"))
    assert {m.get_type() for m in ground.heard} >= {"MISSION_REQUEST"}
    assert not of_type(ground.heard, "MISSION_REQUEST_INT")


def test_px4_asks_once_plainly_then_for_integers() -> None:
    ground = Ground("px4")
    ground.upload(mission("px4"))
    assert [m.seq for m in of_type(ground.heard, "MISSION_REQUEST")] == [0]
    assert [m.seq for m in of_type(ground.heard, "MISSION_REQUEST_INT")] == [1, 2, 3, 4]


def test_px4_switches_to_integers_when_told_that_floats_are_unsupported() -> None:
    ground = Ground("px4")
    assert of_type(ground.send(count(3)), "MISSION_REQUEST")
    refusal = mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_UNSUPPORTED)
    assert [m.seq for m in of_type(ground.send(refusal), "MISSION_REQUEST_INT")] == [0]


def test_ardupilot_overwrites_seq_0_with_home() -> None:
    ground = Ground("ardupilot")
    items = mission("ardupilot")
    ground.upload([replace(items[0], command=mavlink.MAV_CMD_NAV_TAKEOFF, z=33.0), *items[1:]])
    held = ground.vehicle.missions.items()[0]
    assert (held.command, held.x, held.z) == (mavlink.MAV_CMD_NAV_WAYPOINT, LAT, pytest.approx(584.0))


def test_ardupilot_has_a_home_item_even_without_a_mission() -> None:
    ground = Ground("ardupilot")
    (item,) = ground.send(mavlink.MAVLink_mission_request_int_message(1, 1, 0))
    assert item.get_type() == "MISSION_ITEM_INT"
    lesson = ground.send(mavlink.MAVLink_mission_request_int_message(1, 1, 1))
    assert [m.get_type() for m in lesson] == ["MISSION_COUNT", "MISSION_ACK"]
    assert (lesson[0].count, lesson[1].type) == (0, mavlink.MAV_MISSION_ERROR)


def test_px4_has_no_home_item() -> None:
    ground = Ground("px4")
    assert [m.count for m in ground.send(mavlink.MAVLink_mission_request_list_message(1, 1))] == [0]
    (ack,) = ground.send(mavlink.MAVLink_mission_request_int_message(1, 1, 0))
    assert ack.type == mavlink.MAV_MISSION_ERROR


def test_ardupilot_reads_back_what_its_storage_keeps() -> None:
    ground = Ground("ardupilot")
    items = mission("ardupilot")
    items[3] = replace(items[3], param1=1.7, param2=5.0, param4=NAN, z=604.128)
    assert ground.upload(items) == mavlink.MAV_MISSION_ACCEPTED
    held = ground.vehicle.missions.items()
    assert held[2].frame == mavlink.MAV_FRAME_GLOBAL  # sent in frame 2
    assert (held[2].param1, held[2].param2, held[2].param3) == (1.0, 8.0, -1.0)
    assert (held[3].param1, held[3].param2, held[3].param4) == (1.0, 0.0, 0.0)
    assert held[3].z == pytest.approx(604.12, abs=1e-4)  # whole centimetres
    assert held[5].param4 == 1.0  # of LAND


def test_px4_reads_back_what_was_sent() -> None:
    ground = Ground("px4")
    items = [replace(item, param4=NAN) for item in mission("px4")]
    ground.upload(items)
    held = ground.vehicle.missions.items()
    frames = {0: 5, 2: 2, 3: 6}  # the integer forms of the frames sent
    assert [repr(i) for i in held] == [repr(replace(i, frame=frames[i.frame])) for i in items]


def test_px4_keeps_of_an_item_with_a_place_what_it_uses() -> None:
    ground = Ground("px4")
    items = mission("px4")
    items[2] = replace(items[2], param1=1.5, param2=4.0, param3=7.0, param4=-90.0)
    ground.upload(items)
    held = ground.vehicle.missions.items()[2]
    assert (held.param1, held.param2, held.param3, held.param4) == (1.5, 4.0, 0.0, 270.0)


@BOTH
def test_download_serves_integers_and_floats(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    ground.upload(mission(autopilot))
    (counted,) = ground.send(mavlink.MAVLink_mission_request_list_message(1, 1))
    assert counted.count == len(mission(autopilot))
    for seq in range(4):
        (exact,) = ground.send(mavlink.MAVLink_mission_request_int_message(1, 1, seq))
        (rounded,) = ground.send(mavlink.MAVLink_mission_request_message(1, 1, seq))
    assert (exact.get_type(), rounded.get_type()) == ("MISSION_ITEM_INT", "MISSION_ITEM")
    assert (exact.seq, rounded.seq) == (3, 3)
    assert rounded.x == pytest.approx(exact.x * 1e-7, abs=4e-6)  # float32 degrees
    assert (exact.frame, rounded.frame) == ((0, 0) if autopilot == "ardupilot" else (5, 0))


@pytest.mark.parametrize(("autopilot", "retry_s", "give_up_s"), [("ardupilot", 1.0, 8.0), ("px4", 0.25, 5.0)])
def test_vehicle_asks_again_then_gives_up(autopilot: Autopilot, retry_s: float, give_up_s: float) -> None:
    ground = Ground(autopilot)
    ground.send(count(3))
    heard = ground.run(give_up_s + 2.0)
    requests = of_type(heard, "MISSION_REQUEST")
    assert len(requests) == pytest.approx(give_up_s / retry_s - 1, abs=1)
    acks = [m.type for m in of_type(heard, "MISSION_ACK")]
    assert acks == ([mavlink.MAV_MISSION_OPERATION_CANCELLED] if autopilot == "ardupilot" else [])
    assert ("Mission upload timeout" if autopilot == "ardupilot" else "Operation timeout") in texts(heard)


def test_a_broken_upload_leaves_ardupilot_a_hybrid() -> None:
    ground = Ground("ardupilot")
    ground.upload(mission("ardupilot"))
    ground.send(count(4))
    ground.send(item_message(mission("ardupilot")[0]))
    ground.send(item_message(replace(mission("ardupilot")[1], z=99.0)))
    ground.run(10.0)
    held = ground.vehicle.missions.items()
    assert len(held) == 4  # COUNT truncates at once
    assert held[1].z == pytest.approx(99.0)  # new
    assert held[3].z == pytest.approx(604.0)  # old


def test_a_broken_upload_leaves_px4_its_old_mission() -> None:
    ground = Ground("px4")
    ground.upload(mission("px4"))
    before = ground.vehicle.missions.items()
    ground.send(count(2))
    ground.send(item_message(replace(mission("px4")[0], z=99.0)))
    ground.run(10.0)
    assert ground.vehicle.missions.items() == before


def test_wrong_seq_is_refused_by_ardupilot_and_dropped_by_px4_and_both_go_on() -> None:
    ardupilot, px4 = Ground("ardupilot"), Ground("px4")
    for ground in (ardupilot, px4):
        ground.send(count(5))
    wrong = item_message(replace(mission("px4")[3], seq=3))
    (ack,) = ardupilot.send(wrong)
    assert ack.type == mavlink.MAV_MISSION_INVALID_SEQUENCE
    assert px4.send(wrong) == []
    assert [m.seq for m in ardupilot.send(item_message(mission("ardupilot")[0]))] == [1]
    assert [m.seq for m in px4.send(item_message(mission("px4")[0]))] == [1]


def test_item_after_completion() -> None:
    ardupilot, px4 = Ground("ardupilot"), Ground("px4")
    ardupilot.upload(mission("ardupilot"))
    px4.upload(mission("px4"))
    (ack,) = ardupilot.send(item_message(mission("ardupilot")[5]))
    assert ack.type == mavlink.MAV_MISSION_ERROR
    (ack,) = px4.send(item_message(mission("px4")[4]))  # its acknowledgement was lost
    assert ack.type == mavlink.MAV_MISSION_ACCEPTED
    (ack,) = px4.send(item_message(mission("px4")[2]))
    assert ack.type == mavlink.MAV_MISSION_ERROR


@pytest.mark.parametrize(
    ("change", "result"),
    [
        ({"frame": 1}, mavlink.MAV_MISSION_UNSUPPORTED_FRAME),
        ({"command": 31_999}, mavlink.MAV_MISSION_UNSUPPORTED),
        ({"param1": NAN}, mavlink.MAV_MISSION_INVALID_PARAM1),
        ({"param1": float("inf")}, mavlink.MAV_MISSION_INVALID_PARAM1),
        ({"x": 910_000_000}, mavlink.MAV_MISSION_INVALID_PARAM5_X),
        ({"y": 1_810_000_000}, mavlink.MAV_MISSION_INVALID_PARAM6_Y),
        ({"z": 1e9}, mavlink.MAV_MISSION_INVALID_PARAM7),
        ({"param4": NAN}, mavlink.MAV_MISSION_ACCEPTED),
    ],
)
def test_ardupilot_names_what_is_wrong_with_an_item(change: dict[str, float], result: int) -> None:
    items = mission("ardupilot")
    items[3] = replace(items[3], **change)  # type: ignore[arg-type]
    assert Ground("ardupilot").upload(items) == result


@pytest.mark.parametrize(
    ("change", "result"),
    [
        ({"frame": mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT}, mavlink.MAV_MISSION_UNSUPPORTED_FRAME),
        ({"command": mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT}, mavlink.MAV_MISSION_UNSUPPORTED),
        ({"param1": float("inf")}, mavlink.MAV_MISSION_INVALID_PARAM1),
        ({"z": NAN}, mavlink.MAV_MISSION_INVALID_PARAM7),
        ({"param2": NAN, "param4": NAN}, mavlink.MAV_MISSION_ACCEPTED),
    ],
)
def test_px4_names_what_is_wrong_with_an_item(change: dict[str, float], result: int) -> None:
    items = mission("px4")
    items[2] = replace(items[2], **change)  # type: ignore[arg-type]
    assert Ground("px4").upload(items) == result


def test_px4_refuses_a_speed_change_outside_the_mission_frame() -> None:
    items = mission("px4")
    items[1] = replace(items[1], frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT)
    assert Ground("px4").upload(items) == mavlink.MAV_MISSION_UNSUPPORTED


@BOTH
def test_second_uploader_is_turned_away_and_changes_nothing(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    second = other_ground(ground)
    ground.send(count(len(mission(autopilot))))
    denied, error = mavlink.MAV_MISSION_DENIED, mavlink.MAV_MISSION_ERROR
    expected = [[denied], [denied], [error]] if autopilot == "ardupilot" else [[error], [], []]
    intrusions = (count(1), item_message(mission(autopilot)[0]), mavlink.MAVLink_mission_clear_all_message(1, 1))
    for intrusion, answer in zip(intrusions, expected, strict=True):
        assert [m.type for m in second.send(intrusion)] == answer
    cancel = mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_OPERATION_CANCELLED)
    assert second.send(cancel) == []
    for item in mission(autopilot):
        replies = ground.send(item_message(item))
    assert [m.type for m in replies] == [mavlink.MAV_MISSION_ACCEPTED]


@BOTH
def test_too_many_items_have_no_space(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    for kind, most in enumerate(ground.autopilot.personality.transfer.item_max):
        assert [m.type for m in ground.send(count(most + 1, kind))] == [mavlink.MAV_MISSION_NO_SPACE]


@BOTH
def test_count_zero_and_clear_all_empty_the_store(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    ground.upload(mission(autopilot))
    assert [m.type for m in ground.send(count(0))] == [mavlink.MAV_MISSION_ACCEPTED]
    assert ground.vehicle.missions.items() == ()
    ground.upload(mission(autopilot))
    assert [m.type for m in ground.send(mavlink.MAVLink_mission_clear_all_message(1, 1, 255))] == [0]
    assert ground.vehicle.missions.items() == ()


def test_ardupilot_does_not_clear_the_mission_that_it_flies() -> None:
    ground = Ground("ardupilot")
    ground.upload(mission("ardupilot"))
    ground.mode("GUIDED")
    ground.arm()
    ground.start()
    ground.run(5.0)
    (ack,) = ground.send(mavlink.MAVLink_mission_clear_all_message(1, 1))
    assert ack.type == mavlink.MAV_MISSION_ERROR


def test_partial_write_replaces_some_items_on_ardupilot_only() -> None:
    ground = Ground("ardupilot")
    ground.upload(mission("ardupilot"))
    (request,) = ground.send(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 3, 3))
    assert request.seq == 3
    (ack,) = ground.send(item_message(replace(mission("ardupilot")[3], z=650.0)))
    assert ack.type == mavlink.MAV_MISSION_ACCEPTED
    assert [round(i.z) for i in ground.vehicle.missions.items()] == [584, 20, 0, 650, 604, 584]
    assert Ground("px4").send(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 0, 0)) == []


def test_px4_upload_can_be_cancelled() -> None:
    ground = Ground("px4")
    ground.send(count(3))
    ground.send(mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_OPERATION_CANCELLED))
    assert not of_type(ground.run(2.0), "MISSION_REQUEST")


@BOTH
def test_fence_and_rally_points_are_stores_of_their_own(autopilot: Autopilot) -> None:
    ground = Ground(autopilot)
    ground.upload(mission(autopilot))
    corner = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
    fence = [MissionItem(k, 3, corner, 3.0, x=LAT + k, y=k) for k in range(3)]
    assert ground.upload(fence, mavlink.MAV_MISSION_TYPE_FENCE) == mavlink.MAV_MISSION_ACCEPTED
    (counted,) = ground.send(mavlink.MAVLink_mission_request_list_message(1, 1, mavlink.MAV_MISSION_TYPE_FENCE))
    assert counted.count == 3
    assert len(ground.vehicle.missions.items()) == len(mission(autopilot))
    ground.send(mavlink.MAVLink_mission_ack_message(1, 1, mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_TYPE_FENCE))
    assert ground.upload(mission(autopilot), mavlink.MAV_MISSION_TYPE_RALLY) == mavlink.MAV_MISSION_UNSUPPORTED
    (ack,) = ground.send(count(1, kind=9))
    assert ack.type == mavlink.MAV_MISSION_UNSUPPORTED


def test_after_a_cold_start_ardupilot_has_no_space_yet() -> None:
    ground = Ground("ardupilot", cold_start=True)
    assert ground.upload(mission("ardupilot")) == mavlink.MAV_MISSION_NO_SPACE
    ground.run(8.0)
    assert ground.upload(mission("ardupilot")) == mavlink.MAV_MISSION_ACCEPTED


def test_items_for_another_vehicle_are_not_ours() -> None:
    ground = Ground("ardupilot")
    assert ground.send(mavlink.MAVLink_mission_count_message(2, 1, 3)) == []
    assert ground.send(mavlink.MAVLink_mission_count_message(1, 154, 3)) == []  # its gimbal
    assert ground.run(2.0) and not of_type(ground.heard, "MISSION_REQUEST")


@pytest.mark.parametrize(("autopilot", "mixed"), [("ardupilot", True), ("px4", False)])
def test_who_has_our_ids_gets_its_items_in_at_ardupilot(autopilot: Autopilot, mixed: bool) -> None:
    """It goes by ids alone, whatever the link: only the read-back protects against that."""
    ground = Ground(autopilot)
    second = other_ground(ground)
    second._encoder = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)  # as the first
    items = mission(autopilot)
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), 0))
    ground.send(item_message(items[0]))
    theirs = replace(items[1], z=items[1].z + 300.0)
    second.send(item_message(theirs))
    for item in items[1 + mixed :]:
        ground.send(item_message(item))
    held = ground.vehicle.missions.items()
    assert len(held) == len(items)
    assert (abs(held[1].z - theirs.z) < 0.1) is mixed


def test_anybody_may_begin_a_partial_write_at_ardupilot() -> None:
    ground = Ground("ardupilot")
    second = other_ground(ground)
    items = mission("ardupilot")
    assert ground.upload(items) == mavlink.MAV_MISSION_ACCEPTED
    ground.send(mavlink.MAVLink_mission_count_message(1, 1, len(items), 0))
    [asked] = second.send(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 2, 3, 0))
    assert (asked.get_type(), asked.seq) == ("MISSION_REQUEST", 2)
