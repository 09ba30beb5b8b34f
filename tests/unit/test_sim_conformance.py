"""The vehicle's half of the mission protocol, row by row: what is done to it, what it answers, who says so.

``measured`` facts were seen on ArduCopter 4.5.6 and PX4 1.15 in SITL; the others are read in their sources:
MissionItemProtocol*.cpp and AP_Mission.cpp of ArduPilot, mavlink_mission.cpp of PX4.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import in_process_pair
from adapters.mission_items import MissionItem
from missionplanner.vehicle import Autopilot
from tests.simulated import LAT, LON, NAN, Ground, item_message, mission, of_type, texts

ACCEPTED, ERROR = mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_ERROR
DENIED, NO_SPACE = mavlink.MAV_MISSION_DENIED, mavlink.MAV_MISSION_NO_SPACE
CANCELLED, SEQUENCE = mavlink.MAV_MISSION_OPERATION_CANCELLED, mavlink.MAV_MISSION_INVALID_SEQUENCE
UNSUPPORTED, FRAME = mavlink.MAV_MISSION_UNSUPPORTED, mavlink.MAV_MISSION_UNSUPPORTED_FRAME
FENCE, RALLY = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY
CORNER = mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION


def count(n: int, kind: int = 0) -> Any:
    return mavlink.MAVLink_mission_count_message(1, 1, n, kind)


def listing(kind: int = 0) -> Any:
    return mavlink.MAVLink_mission_request_list_message(1, 1, kind)


def wanted(seq: int, kind: int = 0, *, plain: bool = False) -> Any:
    request = mavlink.MAVLink_mission_request_message if plain else mavlink.MAVLink_mission_request_int_message
    return request(1, 1, seq, kind)


def ack(result: int, kind: int = 0) -> Any:
    return mavlink.MAVLink_mission_ack_message(1, 1, result, kind)


def clear(kind: int = 0) -> Any:
    return mavlink.MAVLink_mission_clear_all_message(1, 1, kind)


def float_item(item: MissionItem) -> Any:
    params = (item.param1, item.param2, item.param3, item.param4)
    place = (item.x * 1e-7, item.y * 1e-7, item.z)
    return mavlink.MAVLink_mission_item_message(
        1, 1, item.seq, item.frame, item.command, item.current, item.autocontinue, *params, *place
    )


def corners(n: int, claimed: float | None = None) -> list[MissionItem]:
    return [MissionItem(k, 3, CORNER, n if claimed is None else claimed, x=LAT + k, y=LON + k * k) for k in range(n)]


Step = Callable[[Ground], list[Any]]
"""Does something to a vehicle; returns what it answers."""


def sent(*messages: Any) -> Step:
    """Send messages; the answers to the last one count."""

    def step(ground: Ground) -> list[Any]:
        replies: list[Any] = []
        for message in messages:
            replies = ground.send(message)
        return replies

    return step


def uploaded(items: Sequence[MissionItem] | None = None, kind: int = 0) -> Step:
    def step(ground: Ground) -> list[Any]:
        chosen = mission(ground.autopilot.personality.autopilot) if items is None else items
        result = ground.upload(chosen, kind)
        return [mavlink.MAVLink_mission_ack_message(255, 190, result, kind)]

    return step


def changed(seq: int, **fields: float) -> Step:
    """Upload a mission with one field of an item changed; seqs count from the take-off."""

    def step(ground: Ground) -> list[Any]:
        autopilot = ground.autopilot.personality.autopilot
        items = mission(autopilot)
        index = seq + (1 if autopilot == "ardupilot" else 0)
        items[index] = replace(items[index], **fields)  # type: ignore[arg-type]
        return uploaded(items)(ground)

    return step


def waited(duration_s: float) -> Step:
    return lambda ground: [m for m in ground.run(duration_s) if m.get_type() in ("MISSION_ACK", PLAIN, INTEGER)]


def told(duration_s: float = 0.2) -> Step:
    """Return the words that the vehicle says meanwhile, as they are."""
    return lambda ground: list(texts(ground.run(duration_s)))


def by_another(*messages: Any) -> Step:
    """Send messages as another ground station (sysid 254) that speaks to the same vehicle."""

    def step(ground: Ground) -> list[Any]:
        end, pipe = in_process_pair("another")
        ground.fleet.attach(end)
        encoder, parser = mavlink.MAVLink(None, srcSystem=254, srcComponent=190), mavlink.MAVLink(None)
        for message in messages:
            pipe.send(message.pack(encoder))
            ground.fleet.poll()
        heard = [m for data, _ in pipe.receive() for m in parser.parse_buffer(data) or ()]
        return [m for m in heard if m.get_type().startswith("MISSION_")]

    return step


@dataclass(frozen=True, slots=True)
class Row:
    """What is done, and the short form of what is answered, by ArduPilot and by PX4 (None: not said here)."""

    fact: str
    steps: tuple[Step, ...]
    ardupilot: list[Any] | None = None
    px4: list[Any] | None = None
    cold: bool = False


def short(message: Any) -> Any:
    """Return what matters of an answer: an ACK's result, else the name and seq or count."""
    if isinstance(message, str):
        return message
    kind = message.get_type()
    if kind == "MISSION_ACK":
        return int(message.type)
    return kind, int(message.count if kind == "MISSION_COUNT" else message.seq)


FIRST = sent(count(5))
PLAIN, INTEGER = "MISSION_REQUEST", "MISSION_REQUEST_INT"
ITEM0 = item_message(mission("px4")[0])
ROWS = [
    # who asks, and how
    Row("measured: ArduPilot asks with MISSION_REQUEST, PX4 its first time, too", (FIRST,), [(PLAIN, 0)], [(PLAIN, 0)]),
    Row(
        "measured: after an integer item PX4 asks with MISSION_REQUEST_INT",
        (FIRST, sent(ITEM0)),
        [(PLAIN, 1)],
        [(INTEGER, 1)],
    ),
    Row(
        "handle_mission_item: after a float item PX4 asks plainly",
        (FIRST, sent(float_item(mission("px4")[0]))),
        [(PLAIN, 1)],
        [(PLAIN, 1)],
    ),
    Row(
        "PX4 keeps the way its partner spoke last for the next upload",
        (uploaded(), FIRST),
        [(PLAIN, 0)],
        [(INTEGER, 0)],
    ),
    Row(
        "handle_mission_ack: UNSUPPORTED makes PX4 ask in the other way",
        (FIRST, sent(ack(UNSUPPORTED))),
        [],
        [(INTEGER, 0)],
    ),
    # timers, in simulated time
    Row("measured: ArduPilot asks again each second", (FIRST, waited(1.05)), [(PLAIN, 0)], None),
    Row("PX4 asks again each 250 ms", (FIRST, waited(0.55)), None, [(PLAIN, 0)] * 2),
    Row("measured: ArduPilot gives up after 8 s with ACK 15", (FIRST, waited(7.1), waited(3.0)), [CANCELLED], None),
    Row("PX4 gives up after 5 s", (FIRST, waited(5.1), waited(2.0)), None, []),
    Row("PX4 gives up in words only", (FIRST, told(6.0)), None, ["Operation timeout"]),
    Row("ArduPilot says it, too", (FIRST, told(9.0)), ["Mission upload timeout"], None),
    Row(
        "timeout(): each of ArduPilot's stores has its own words",
        (sent(count(3, FENCE)), told(9.0)),
        ["Fence upload timeout"],
        None,
    ),
    # faults of items
    Row(
        "measured: a wrong seq gets ACK 13 from ArduPilot, silence from PX4",
        (FIRST, sent(item_message(mission("px4")[3]))),
        [SEQUENCE],
        [],
    ),
    Row(
        "and the transfer goes on", (FIRST, sent(item_message(mission("px4")[3]), ITEM0)), [(PLAIN, 1)], [(INTEGER, 1)]
    ),
    Row("measured: so does an item that comes twice", (FIRST, sent(ITEM0, ITEM0)), [SEQUENCE], []),
    Row("measured: an item after completion gets ACK 1", (uploaded(), sent(ITEM0)), [ERROR], [ERROR]),
    Row(
        "PX4 acknowledges the last item again", (uploaded(), sent(item_message(mission("px4")[4]))), [ERROR], [ACCEPTED]
    ),
    Row("measured: bad frame 2", (changed(2, frame=1),), [FRAME], [FRAME]),
    Row("measured: unknown command 3", (changed(2, command=31_999),), [UNSUPPORTED], [UNSUPPORTED]),
    Row("measured: NaN p1: 6; PX4 takes it", (changed(2, param1=NAN),), [6], [ACCEPTED]),
    Row("measured: NaN p4 is accepted on a waypoint", (changed(2, param4=NAN),), [ACCEPTED], [ACCEPTED]),
    Row("ArduPilot takes NaN in p4 of 16/21/22/84/85 only", (changed(1, param4=NAN),), [9], [ACCEPTED]),
    Row("measured: bad latitude: 10", (changed(2, x=910_000_000),), [10], [10]),
    Row("bad longitude: 11, bad altitude: 12", (changed(2, y=1_810_000_000),), [11], [11]),
    Row("bad altitude: 12", (changed(2, z=NAN),), [12], [12]),
    Row("PX4 takes a speed in the mission's frame only", (changed(1, frame=3),), [ACCEPTED], [UNSUPPORTED]),
    Row("PX4 takes a waypoint in a global frame only", (changed(2, frame=2),), [ACCEPTED], [UNSUPPORTED]),
    Row("PX4 takes no terrain frames", (changed(2, frame=10),), [ACCEPTED], [FRAME]),
    Row("PX4 takes no splines", (changed(2, command=mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT),), [ACCEPTED], [UNSUPPORTED]),
    Row(
        "append_item: ArduPilot refuses a jump to nowhere",
        (changed(1, command=mavlink.MAV_CMD_DO_JUMP, param1=0.0),),
        [ERROR],
        [ACCEPTED],
    ),
    # counts
    Row("measured: more than 650 items: 4", (sent(count(651)),), [NO_SPACE], None),
    Row("ArduPilot says how many it takes", (sent(count(651)), told()), ["Only 650 items are supported"], None),
    Row("PX4: more than its storage: 4", (sent(count(2001)),), None, [NO_SPACE]),
    Row("dataman: 64 points of a fence", (sent(count(65, FENCE)),), None, [NO_SPACE]),
    Row("measured: NO_SPACE about 1 s after connecting", (waited(1.0), uploaded()), [NO_SPACE], [ACCEPTED], cold=True),
    Row("measured: and 6 to 8 s later it works", (waited(8.0), uploaded()), [ACCEPTED], [ACCEPTED], cold=True),
    Row(
        "COUNT 0 clears", (uploaded(), sent(count(0)), sent(listing())), [("MISSION_COUNT", 0)], [("MISSION_COUNT", 0)]
    ),
    Row(
        "a new COUNT begins anew at ArduPilot; PX4 in mid-upload is busy",
        (FIRST, sent(ITEM0), FIRST),
        [(PLAIN, 0)],
        [ERROR],
    ),
    Row("PX4 takes a doubled COUNT for its first request lost", (FIRST, FIRST), [(PLAIN, 0)], [(PLAIN, 0)]),
    Row(
        "PX4's busy answer does not end the upload",
        (FIRST, sent(ITEM0), FIRST, sent(item_message(mission("px4")[1]))),
        None,
        [(INTEGER, 2)],
    ),
    # a second uploader
    Row("measured: 14 from ArduPilot, 1 from PX4", (FIRST, by_another(count(2))), [DENIED], [ERROR]),
    Row("its items: 14 where the seq is right, words from PX4", (FIRST, by_another(ITEM0)), [DENIED], []),
    Row("its items: 13 where it is not", (FIRST, by_another(item_message(mission("px4")[3]))), [SEQUENCE], []),
    Row("its cancelling is nothing", (FIRST, by_another(ack(CANCELLED)), sent(ITEM0)), [(PLAIN, 1)], [(INTEGER, 1)]),
    Row("nor its clearing", (FIRST, by_another(clear()), sent(ITEM0)), [(PLAIN, 1)], [(INTEGER, 1)]),
    Row("clearing in mid-upload: ERROR from ArduPilot, words from PX4", (FIRST, sent(clear())), [ERROR], []),
    Row("ArduPilot's stores are apart", (FIRST, by_another(count(3, FENCE))), [(PLAIN, 0)], [ERROR]),
    Row("its download: DENIED, ignored by PX4", (FIRST, by_another(listing())), [DENIED], []),
    # partial writes, cancelling, clearing
    Row(
        "ArduPilot takes WRITE_PARTIAL, PX4 does not know it",
        (uploaded(), sent(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 3, 3))),
        [(PLAIN, 3)],
        [],
    ),
    Row("beyond the end: ERROR", (sent(mavlink.MAVLink_mission_write_partial_list_message(1, 1, 3, 3)),), [ERROR], []),
    Row("cancel = ACK 15 at PX4; ArduPilot has none", (FIRST, sent(ack(CANCELLED)), waited(1.05)), [(PLAIN, 0)], []),
    Row(
        "mission_type 255 clears all",
        (uploaded(), uploaded(corners(3), FENCE), sent(clear(255)), sent(listing(FENCE))),
        [("MISSION_COUNT", 0)],
        [("MISSION_COUNT", 0)],
    ),
    Row("a type that there is not: 3", (sent(count(1, 9)),), [UNSUPPORTED], [UNSUPPORTED]),
    # set current
    Row(
        "MISSION_SET_CURRENT is answered by MISSION_CURRENT",
        (uploaded(), sent(mavlink.MAVLink_mission_set_current_message(1, 1, 2))),
        [("MISSION_CURRENT", 2)],
        [("MISSION_CURRENT", 2)],
    ),
    Row(
        "an item that there is not: PX4 says so",
        (uploaded(), sent(mavlink.MAVLink_mission_set_current_message(1, 1, 9)), told()),
        None,
        ["WPM: WP CURR CMD: Not in list"],
    ),
    Row(
        "PX4 heeds it only when no transfer is under way",
        (uploaded(), sent(count(2), mavlink.MAVLink_mission_set_current_message(1, 1, 2)), told()),
        None,
        ["WPM: IGN WP CURR CMD: Busy"],
    ),
    # downloads
    Row("measured: ArduPilot's seq 0 is home, always readable", (sent(wanted(0)),), [("MISSION_ITEM_INT", 0)], []),
    Row(
        "get_item: beyond the end ArduPilot tells how many there are",
        (sent(wanted(7)),),
        [("MISSION_COUNT", 0), ERROR],
        [],
    ),
    Row("PX4 ignores requests without a list", (uploaded(), sent(wanted(1))), [("MISSION_ITEM_INT", 1)], []),
    Row(
        "after a list it answers in order",
        (uploaded(), sent(listing(), wanted(0), wanted(1))),
        [("MISSION_ITEM_INT", 1)],
        [("MISSION_ITEM_INT", 1)],
    ),
    Row(
        "and again",
        (uploaded(), sent(listing(), wanted(0), wanted(0))),
        [("MISSION_ITEM_INT", 0)],
        [("MISSION_ITEM_INT", 0)],
    ),
    Row(
        "out of order: ERROR from PX4, and it is over",
        (uploaded(), sent(listing(), wanted(2))),
        [("MISSION_ITEM_INT", 2)],
        [ERROR],
    ),
    Row(
        "so that it must be listed again",
        (uploaded(), sent(listing(), wanted(2), wanted(0))),
        [("MISSION_ITEM_INT", 0)],
        [],
    ),
    Row(
        "a plain request gets a float item",
        (uploaded(), sent(listing(), wanted(0, plain=True))),
        [("MISSION_ITEM", 0)],
        [("MISSION_ITEM", 0)],
    ),
    Row(
        "an upload while PX4 is read: ERROR",
        (uploaded(), sent(listing(), wanted(0)), by_another(count(1))),
        [(PLAIN, 0)],
        [ERROR],
    ),
    Row(
        "until the reader's ACK",
        (uploaded(), sent(listing(), wanted(0), ack(ACCEPTED), count(1))),
        [(PLAIN, 0)],
        [(INTEGER, 0)],
    ),
    Row(
        "or 5 s of silence",
        (uploaded(), sent(listing(), wanted(0)), waited(5.2), sent(count(1))),
        [(PLAIN, 0)],
        [(INTEGER, 0)],
    ),
    Row("in mid-upload ArduPilot denies integer requests", (FIRST, sent(wanted(0))), [DENIED], []),
    # fences and rally points
    Row(
        "a fence is a store of its own",
        (uploaded(), uploaded(corners(3), FENCE), sent(listing(FENCE))),
        [("MISSION_COUNT", 3)],
        [("MISSION_COUNT", 3)],
    ),
    Row("a mission item is none of a fence", (uploaded(mission("px4"), FENCE),), [UNSUPPORTED], [UNSUPPORTED]),
    Row("nor a corner one of a mission", (uploaded(corners(3)),), [UNSUPPORTED], [UNSUPPORTED]),
    Row("PX4 refuses a polygon of two", (uploaded(corners(2), FENCE),), None, [ERROR]),
    Row(
        "a rally point",
        (uploaded([MissionItem(0, 3, mavlink.MAV_CMD_NAV_RALLY_POINT, x=LAT, y=LON, z=30.0)], RALLY),),
        [ACCEPTED],
        [ACCEPTED],
    ),
]


CASES = [
    pytest.param(autopilot, row, expected, id=f"{autopilot}: {row.fact}")
    for row in ROWS
    for autopilot, expected in (("ardupilot", row.ardupilot), ("px4", row.px4))
    if expected is not None
]


@pytest.mark.parametrize(("autopilot", "row", "expected"), CASES)
def test_the_vehicle_answers_as_its_autopilot_does(autopilot: Autopilot, row: Row, expected: list[Any]) -> None:
    ground = Ground(autopilot, cold_start=row.cold)
    answer: list[Any] = []
    for step in row.steps:
        answer = step(ground)
    assert [short(message) for message in answer] == expected


# -- what is left on the vehicle -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("autopilot", "heights"), [("ardupilot", [584.0, 99.0, 0.0]), ("px4", [20.0, 0.0, 604.0])])
def test_a_broken_upload_leaves_a_hybrid_or_the_old_mission(autopilot: Autopilot, heights: list[float]) -> None:
    """Measured: ArduPilot's COUNT truncates at once and items replace the old ones; PX4's upload is atomic."""
    ground = Ground(autopilot)
    ground.upload(mission(autopilot))
    sent(count(3), ITEM0, item_message(replace(mission("ardupilot")[1], z=99.0)))(ground)
    ground.run(10.0)
    assert [i.z for i in ground.vehicle.missions.items()][:3] == pytest.approx(heights)
    assert len(ground.vehicle.missions.items()) == (3 if autopilot == "ardupilot" else 5)


def test_a_broken_fence_upload_leaves_the_old_fence_on_both() -> None:
    """MissionItemProtocol_Fence writes its points once all are there."""
    for autopilot in ("ardupilot", "px4"):
        ground = Ground(autopilot)  # type: ignore[arg-type]
        ground.upload(corners(3), FENCE)
        before = ground.vehicle.missions.items(FENCE)
        sent(count(4, FENCE), item_message(replace(corners(4)[0], x=LAT + 99), FENCE))(ground)
        ground.run(10.0)
        assert ground.vehicle.missions.items(FENCE) == before


def test_px4_counts_its_plan_with_a_crc_that_peers_can_compute() -> None:
    """opaque_id: the CRC32, without inversions, of every item as it was sent; 0 once cleared (mavlink_mission.cpp)."""
    ground = Ground("px4")
    items = mission("px4")
    replies = ground.send(count(len(items)))
    for item in items:
        replies = ground.send(item_message(item))
    value = 0
    for i in items:
        packed = struct.pack("<BHB4f", i.frame, i.command, i.autocontinue, i.param1, i.param2, i.param3, i.param4)
        for byte in packed + struct.pack("<iif", i.x, i.y, i.z):
            value ^= byte
            for _ in range(8):
                value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
    (accepted,) = replies
    assert trailing_id(accepted, 4) == value
    (counted,) = ground.send(listing())
    assert trailing_id(counted, 5) == value
    (current, *_) = of_type(ground.run(1.5), "MISSION_CURRENT")
    assert trailing_id(current, 6) == value
    ground.send(ack(ACCEPTED))
    ground.send(clear())
    assert trailing_id(ground.send(listing())[0], 5) == 0


def trailing_id(message: Any, offset: int) -> int:
    """Return the opaque_id behind the fields that pymavlink knows, zero bytes being left out on the wire."""
    payload = bytes(message.get_msgbuf())[10:-2]
    return int.from_bytes(payload[offset : offset + 4].ljust(4, b"\0"), "little")


def test_px4_given_its_mission_again_stays_at_its_item() -> None:
    """handle_mission_item_both: "Only need to update if the mission actually changed"."""
    ground = Ground("px4")
    ground.upload(mission("px4"))
    ground.start()
    ground.run(25.0)
    at = ground.autopilot.current
    assert at > 0
    assert ground.upload(mission("px4")) == ACCEPTED
    assert ground.autopilot.current == at
