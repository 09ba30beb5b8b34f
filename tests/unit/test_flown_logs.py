"""Telemetry logs as flights of a plan: since when, of whom, and what is lost; whatever a log has gone through."""

from __future__ import annotations

import random
import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.flown_logs import FlownLogs, read_flown, read_tracks
from adapters.telemetry_log import parse_log
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray
from missionplanner.plan import FleetPlan, VehiclePlan
from missionplanner.replay import replay
from missionplanner.vehicle import Autopilot
from tests.plans import FRAME, fleet_plan, small_fleet, vehicle_plan

EPOCH_S = 1_700_000_000.0
BOOT_S = 321.0
STAND_S = 6.0  # on the ground before its mission
AUTO = {"ardupilot": 3, "px4": 4 << 16 | 4 << 24}
FIRMWARE = {"ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, "px4": mavlink.MAV_AUTOPILOT_PX4}

Record = tuple[float, bytes]  # time since the epoch of all, frame


@dataclass(frozen=True)
class Story:
    """How a vehicle flew its plan, and what of it was logged."""

    late_s: float = 0.0  # its start
    pace: float = 1.0  # times the planned duration
    delay: Callable[[], float] = lambda: 0.0  # of the link
    heartbeats: bool = True
    commands: bool = False
    reached: bool = True
    aside_m: float = 0.0
    until_s: float = 1e9


def records(vehicle: VehiclePlan, story: Story = Story(), v1: bool = False) -> list[Record]:
    """Return what a ground station logs of a vehicle that flies its plan, from before the start to after its end."""
    codec = mavlink.MAVLink(None, srcSystem=vehicle.sysid, srcComponent=1)
    ground = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    found: list[Record] = []

    def say(t_s: float, message: Any, sender: Any = codec) -> None:
        frame = bytes(message.pack(sender, force_mavlink1=v1))
        sender.seq = (sender.seq + 1) % 256
        found.append((t_s + story.delay(), frame))

    def place_of(t_s: float) -> Any:
        planned_s = (t_s - story.late_s) / story.pace
        return vehicle.trajectory.at(planned_s) + np.array([0.0, story.aside_m, 0.0])

    end_s = min(story.late_s + story.pace * float(vehicle.trajectory.t_s[-1]) + 3.0, story.until_s)
    own_start_s = story.late_s + story.pace * vehicle.start_delay_s
    last_seq = len(vehicle.waypoints_m) + (1 if vehicle.autopilot == "ardupilot" else 0)
    arrival_s = story.late_s + story.pace * vehicle.arrival_s
    for step in range(round(-5 * STAND_S), round(5 * end_s) + 1):
        t_s = step / 5
        if story.heartbeats and step % 5 == 3:
            flying = own_start_s <= t_s < end_s - 1.0
            armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if flying else 0
            mode = AUTO[vehicle.autopilot] if flying else 0
            say(t_s, mavlink.MAVLink_heartbeat_message(2, FIRMWARE[vehicle.autopilot], armed | 1, mode, 4, 3))
        point = FRAME.geo_point(place_of(t_s))
        at = round(point.lat_deg * 1e7), round(point.lon_deg * 1e7), round(point.alt_amsl_m * 1e3)
        boot_ms = round((BOOT_S + vehicle.sysid + t_s) * 1e3)
        say(t_s, mavlink.MAVLink_global_position_int_message(boot_ms, *at, 0, 0, 0, 0, 0))
        if story.commands and t_s <= own_start_s < t_s + 0.2:
            start = mavlink.MAV_CMD_MISSION_START
            say(
                own_start_s,
                mavlink.MAVLink_command_long_message(vehicle.sysid, 1, start, 0, 0, 0, 0, 0, 0, 0, 0),
                ground,
            )
            say(own_start_s + 0.01, mavlink.MAVLink_command_ack_message(start, 0))
        if story.reached and t_s <= arrival_s < t_s + 0.2:
            say(arrival_s, mavlink.MAVLink_mission_item_reached_message(last_seq))
        if step % 7 == 0:
            say(t_s, mavlink.MAVLink_attitude_message(boot_ms, 0, 0, 0, 0, 0, 0))
    return found


def logged(frames: Sequence[Record]) -> bytes:
    """Return the bytes of a log with these records."""
    return b"".join(struct.pack(">Q", round((EPOCH_S + t_s) * 1e6)) + frame for t_s, frame in sorted(frames))


def read(tmp_path: Path, plan: FleetPlan, *logs: bytes) -> FlownLogs:
    paths = [tmp_path / f"log{k}.tlog" for k in range(len(logs))]
    for path, data in zip(paths, logs, strict=True):
        path.write_bytes(data)
    return read_flown(paths, plan)


@pytest.fixture(params=["ardupilot", "px4"])
def plan(request: pytest.FixtureRequest) -> FleetPlan:
    autopilot: Autopilot = request.param
    return small_fleet(autopilot, 2)


# --- time ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("commands", [False, True])
def test_a_late_vehicle_of_a_fleet_is_late(tmp_path: Path, plan: FleetPlan, commands: bool) -> None:
    one, two = plan.vehicles
    stories = Story(commands=commands), Story(late_s=7.0, commands=commands)
    found = read(tmp_path, plan, logged(records(one, stories[0]) + records(two, stories[1])))
    assert found.start_by == ("commanded" if commands else "moved")
    accuracy_s = 1e-3 if commands else 0.2
    assert found.start_s == pytest.approx(EPOCH_S, abs=accuracy_s)
    assert found.started_s == {"uav1": pytest.approx(0.0, abs=1e-3), "uav2": pytest.approx(7.0, abs=0.25)}
    fleet = replay(plan, found.flown, found.reached_s)
    assert [v.arrival_error_s for v in fleet.vehicles] == [
        pytest.approx(0.0, abs=0.25),
        pytest.approx(7.0, abs=0.25),
    ]
    assert fleet.arrival_spread_s == pytest.approx(7.0, abs=0.1)
    assert not found.problems
    assert not found.notes


def test_one_file_for_each_vehicle_and_all_in_one_are_the_same(tmp_path: Path, plan: FleetPlan) -> None:
    each = [records(v, Story(late_s=2.0 * k)) for k, v in enumerate(plan.vehicles)]
    apart = read(tmp_path, plan, *map(logged, each))
    for logs in ([logged(each[0] + each[1])], [*map(logged, each), logged(each[0] + each[1])]):
        together = read(tmp_path, plan, *logs)
        assert together.start_s == apart.start_s
        for name, flown in apart.flown.items():
            np.testing.assert_array_equal(flown.trajectory.t_s, together.flown[name].trajectory.t_s)
            assert flown.arrival_s == together.flown[name].arrival_s


def test_planned_delays_are_not_lateness(tmp_path: Path) -> None:
    one, two = small_fleet("ardupilot", 2).vehicles
    delayed = vehicle_plan("uav2", 2, home_m=tuple(two.home_m), waypoints_m=two.waypoints_m, start_delay_s=9.0)
    plan = fleet_plan(one, delayed)
    for commands in (False, True):
        data = [logged(records(v, Story(commands=commands))) for v in plan.vehicles]
        found = read(tmp_path, plan, *data)
        assert found.start_s == pytest.approx(EPOCH_S, abs=0.25)
        assert found.started_s["uav2"] == pytest.approx(0.0, abs=0.25)


def test_jitter_of_the_link_is_not_the_vehicles(tmp_path: Path) -> None:
    plan = fleet_plan()
    rng = random.Random(1)
    frames = records(plan.vehicles[0], Story(commands=True, delay=lambda: rng.expovariate(1 / 0.15)))
    found = read(tmp_path, plan, logged(frames))
    row = replay(plan, found.flown, found.reached_s).vehicles[0]
    on_legs = (row.planned_s > plan.vehicles[0].reached_s[0]) & row.en_route
    assert np.ptp(row.time_error_s[on_legs]) <= 0.05  # though the link's delays differ by a second


def test_without_heartbeats_the_first_motion_tells(tmp_path: Path) -> None:
    plan = fleet_plan()
    found = read(tmp_path, plan, logged(records(plan.vehicles[0], Story(heartbeats=False))))
    assert found.start_by == "moved"
    assert found.start_s == pytest.approx(EPOCH_S, abs=0.25)


def test_a_log_that_begins_in_flight_begins_on_time(tmp_path: Path) -> None:
    plan = fleet_plan()
    frames = [r for r in records(plan.vehicles[0], Story(pace=1.1)) if r[0] > 20.0]
    found = read(tmp_path, plan, logged(frames))
    assert found.start_by == "placed"
    row = replay(plan, found.flown, found.reached_s).vehicles[0]
    assert row.time_error_s[0] == pytest.approx(0.0, abs=0.05)
    remaining_s = plan.vehicles[0].arrival_s - 20.0 / 1.1
    assert row.arrival_error_s == pytest.approx(0.1 * remaining_s, abs=0.2)


def test_a_slow_flight_is_late_more_and_more(tmp_path: Path, plan: FleetPlan) -> None:
    vehicle = plan.vehicles[0]
    found = read(tmp_path, plan, logged(records(vehicle, Story(pace=1.2, commands=True))))
    row = replay(plan, found.flown, found.reached_s).vehicles[0]
    expected = [0.2 * at_s for at_s in vehicle.reached_s.tolist()]
    assert [w.error_s for w in row.waypoints] == pytest.approx(expected, abs=0.25)
    assert row.waypoints[-1].how == "reported"
    assert np.abs(row.cross_track_m[row.en_route]).max() < 0.3  # this plan's corners are sharp


def test_of_two_flights_the_first_is_replayed_and_the_second_told(tmp_path: Path) -> None:
    plan = fleet_plan()
    first = records(plan.vehicles[0], Story(commands=True))
    later_s = 150.0
    second = records(plan.vehicles[0], Story(late_s=later_s, commands=True))
    data = logged([*first, *(r for r in second if r[0] > later_s - STAND_S)])
    found = read(tmp_path, plan, data)
    assert found.flown["uav1"].arrival_s == pytest.approx(plan.vehicles[0].arrival_s, abs=0.25)
    [note] = found.notes
    assert re.search(r"began its mission again 1[45]\d s later: only its first flight is replayed", note)


# --- damage ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def short() -> tuple[FleetPlan, bytes]:
    plan = fleet_plan(vehicle_plan())
    return plan, logged(records(plan.vehicles[0], Story(until_s=3.0)))


def test_a_log_cut_anywhere_is_read_up_to_the_cut(short: tuple[FleetPlan, bytes]) -> None:
    _, data = short
    whole = parse_log(data)
    assert whole.lost_bytes == whole.cut_bytes == 0
    before = 0
    for cut in range(len(data)):
        log = parse_log(data[:cut])
        assert len(log.records) in (before, before + 1)
        before = len(log.records)
        read_bytes = sum(8 + len(m.get_msgbuf()) for _, m in log.records)
        assert read_bytes + log.lost_bytes == cut
        assert log.cut_bytes == log.lost_bytes
    assert before == len(whole.records) - 1


def test_a_flight_cut_anywhere_is_replayed_or_refused(tmp_path: Path, short: tuple[FleetPlan, bytes]) -> None:
    plan, data = short
    for cut in range(0, len(data), 7):
        try:
            found = read(tmp_path, plan, data[:cut])
        except MissionError as error:
            assert "\n" not in str(error)
            continue
        assert np.isfinite(found.flown["uav1"].trajectory.position_m).all()
        assert ("cut short" in found.notes[0]) == (parse_log(data[:cut]).cut_bytes > 0)
        replay(plan, found.flown, found.reached_s)


@settings(deadline=None, max_examples=150)
@given(data=st.data(), seed=st.integers(0, 2**32))
def test_garbage_costs_only_what_it_hits(data: st.DataObject, seed: int, short: tuple[FleetPlan, bytes]) -> None:
    _, clean = short
    rng = random.Random(seed)
    pieces = bytearray(clean)
    at = data.draw(st.integers(0, len(pieces)))
    junk = data.draw(st.binary(min_size=1, max_size=400))
    pieces[at:at] = junk
    flips = [rng.randrange(len(pieces)) for _ in range(data.draw(st.integers(0, 4)))]
    for k in flips:
        pieces[k] ^= 1 << rng.randrange(8)
    log, whole = parse_log(bytes(pieces)), parse_log(clean)
    read_bytes = sum(8 + len(m.get_msgbuf()) for _, m in log.records)
    assert read_bytes + log.lost_bytes == len(pieces)
    known = {bytes(m.get_msgbuf()) for _, m in whole.records}
    sound = [m for _, m in log.records if bytes(m.get_msgbuf()) in known]
    # a junk byte may stand for the length of a frame that swallows what follows, up to 280 bytes: some 8 records
    assert len(sound) >= len(whole.records) - 9 * (1 + len(flips))


def test_what_is_lost_is_said(tmp_path: Path) -> None:
    plan = fleet_plan()
    frames = sorted(records(plan.vehicles[0]))
    kept = [r for r in frames if not 15.0 < r[0] < 19.5]
    data = logged(kept)
    spoiled = bytearray(data)
    where = data.index(kept[200][1])
    spoiled[where + 12] ^= 0xFF  # its payload
    unknown = struct.pack(">Q", round((EPOCH_S + 10.0) * 1e6)) + bytes(
        [0xFD, 2, 0, 0, 0, 1, 1, 0xF0, 0xFF, 0xFE, 1, 2, 3, 4]
    )
    odd = struct.pack(">Q", round((EPOCH_S + 1e6) * 1e6)) + kept[300][1]
    middle = data.index(kept[400][1]) - 8
    broken = bytes(spoiled[:middle]) + unknown + odd + b"junk" * 5 + bytes(spoiled[middle:]) + data[:30]
    found = read(tmp_path, plan, broken)
    lost, gap = found.notes
    assert "log0.tlog: cut short: 30 bytes of an unfinished record at its end" in lost
    assert "1 frame with a wrong checksum" in lost
    size = 8 + len(kept[200][1])
    assert f"{size + 22 + 20} bytes skipped" in lost
    assert "1 frame of kinds that are not known here" in lost
    assert "1 frame at impossible times" in lost
    assert "uav1 (sysid 1): 1 gap of more than 2 s in its positions, the longest 4." in gap
    assert found.flown["uav1"].arrival_s == pytest.approx(plan.vehicles[0].arrival_s, abs=0.25)


def test_a_flight_whose_log_ends_early_never_arrives(tmp_path: Path) -> None:
    plan = fleet_plan()
    found = read(tmp_path, plan, logged(records(plan.vehicles[0], Story(until_s=25.0))))
    assert found.flown["uav1"].arrival_s is None
    assert any(re.search(r"never reached its goal; its log ends 2[45]\.\d s after", note) for note in found.notes)
    assert replay(plan, found.flown, found.reached_s).arrival_spread_s is None


@pytest.mark.parametrize("v1", [False, True])
def test_logs_written_by_pymavlink_are_read(tmp_path: Path, v1: bool) -> None:
    """As MAVProxy writes them; in either version of MAVLink."""
    plan = fleet_plan()
    path = tmp_path / "mav.tlog"
    with path.open("wb") as file:
        parser = mavlink.MAVLink(None)
        for t_s, frame in sorted(records(plan.vehicles[0], v1=v1)):
            message = parser.decode(bytearray(frame))
            stamp = int((EPOCH_S + t_s) * 1.0e6)
            file.write(struct.pack(">Q", stamp) + message.get_msgbuf())
    log = mavutil.mavlink_connection(str(path))
    count = 0
    while log.recv_match() is not None:
        count += 1
    log.close()
    assert count == len(parse_log(path.read_bytes()).records)
    found = read_flown([path], plan)
    assert found.flown["uav1"].arrival_s == pytest.approx(plan.vehicles[0].arrival_s, abs=0.25)


# --- wrong input -----------------------------------------------------------------------------------------------------


def refused(tmp_path: Path, plan: FleetPlan, *logs: bytes) -> str:
    with pytest.raises(MissionError) as refusal:
        read(tmp_path, plan, *logs)
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


def test_what_is_no_flight_of_the_plan_is_refused(tmp_path: Path) -> None:
    plan = fleet_plan()
    vehicle = plan.vehicles[0]
    stranger = vehicle_plan("x", 9)
    assert "log0.tlog: expected a telemetry log, got an empty file" in refused(tmp_path, plan, b"")
    assert "got 1200 bytes without any MAVLink frame" in refused(tmp_path, plan, b"QGC WPL 110\n" * 100)
    other = refused(tmp_path, plan, logged(records(stranger)))
    assert other == "sysid 9: expected one of the plan's vehicles (sysid 1)"
    px4 = vehicle_plan(autopilot="px4")
    assert "uav1 (sysid 1): expected ardupilot copter, got px4 copter" in refused(tmp_path, plan, logged(records(px4)))
    away = refused(tmp_path, plan, logged(records(vehicle, Story(aside_m=5000.0, heartbeats=False, commands=True))))
    assert "more than" in away
    assert "is it another mission's log?" in away
    no_positions = [r for r in records(vehicle) if r[1][7] != mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT]
    assert "expected its positions (GLOBAL_POSITION_INT), got 0" in refused(tmp_path, plan, logged(no_positions))
    still = [r for r in records(vehicle) if r[0] < 0.0]
    assert "a vehicle that stays within 2 m of its place" in refused(tmp_path, plan, logged(still))


def test_two_vehicles_with_one_sysid_are_told_apart_from_one(tmp_path: Path) -> None:
    plan = fleet_plan()
    far = vehicle_plan(home_m=(3000.0, 0.0, 1200.0), waypoints_m=[(3000.0, 0.0, 1230.0), (3300.0, 0.0, 1230.0)])
    both = logged(records(plan.vehicles[0]) + records(far))
    assert "are there two vehicles with one sysid?" in refused(tmp_path, plan, both)


def test_one_bad_log_does_not_spoil_the_others(tmp_path: Path, plan: FleetPlan) -> None:
    good = logged(records(plan.vehicles[0]) + records(replace(plan.vehicles[1], sysid=77)))
    found = read(tmp_path, plan, good, b"", b"x" * 100)
    assert list(found.flown) == ["uav1"]
    assert sorted(problem.split(":")[0].split("/")[-1] for problem in found.problems) == [
        "log1.tlog",
        "log2.tlog",
        "sysid 77",
    ]
    assert found.notes == ("uav2 (sysid 2): not in the logs",)


# --- tracks and photos, whatever the plan -----------------------------------------------------------------------------


def photo(
    sysid: int, component: int, t_s: float, index: int, place: FloatArray, *, ardupilot: bool, ok: bool = True
) -> Record:
    """Return what a vehicle, or its camera, tells of a photo, or of one that failed."""
    codec = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=component)
    point = FRAME.geo_point(place)
    lat, lon, alt_m = round(point.lat_deg * 1e7), round(point.lon_deg * 1e7), point.alt_amsl_m
    flags = mavlink.CAMERA_FEEDBACK_PHOTO if ok else mavlink.CAMERA_FEEDBACK_BADEXPOSURE
    if ardupilot:
        message: Any = mavlink.MAVLink_camera_feedback_message(
            0, sysid, 0, index, lat, lon, alt_m, 30.0, 0.0, 0.0, 0.0, 0.0, flags, index
        )
    else:
        message = mavlink.MAVLink_camera_image_captured_message(
            0, 0, 1, lat, lon, round(alt_m * 1e3), 30_000, (1.0, 0.0, 0.0, 0.0), index, int(ok), b""
        )
    return t_s, bytes(message.pack(codec))


def test_tracks_and_photos_of_any_flight(tmp_path: Path, plan: FleetPlan) -> None:
    """Photos count once though a log repeats them; a vehicle that tells of none has none that are known."""
    one, two = plan.vehicles
    flown = {v.sysid: records(v) for v in plan.vehicles}
    ardupilot = one.autopilot == "ardupilot"
    taken = [photo(1, 1 if ardupilot else 100, t_s, k, one.trajectory.at(t_s), ardupilot=ardupilot)
             for k, t_s in enumerate((20.0, 30.0))]  # fmt: skip
    repeated = (taken[1][0] + 0.3, taken[1][1])
    (tmp_path / "all.tlog").write_bytes(logged([*flown[1], *flown[2], *taken, repeated]))
    tracks, notes = read_tracks([tmp_path / "all.tlog"], FRAME)
    assert not notes
    assert [track.sysid for track in tracks] == [1, 2]
    first, second = tracks
    assert second.photos is None
    assert first.photos is not None
    assert first.photos.position_m == pytest.approx(one.trajectory.at(np.array([20.0, 30.0])), abs=0.02)
    assert first.photos.t_s == pytest.approx([20.0 + STAND_S, 30.0 + STAND_S], abs=0.01)
    # positions are those flown, as fine as a log tells them
    for track, vehicle in zip(tracks, (one, two), strict=True):
        planned_m = vehicle.trajectory.at(track.trajectory.t_s - STAND_S)
        assert track.trajectory.position_m == pytest.approx(planned_m, abs=0.02)


@pytest.mark.parametrize("ardupilot", [False, True])
def test_who_tells_of_failed_photos_only_has_taken_none(tmp_path: Path, plan: FleetPlan, ardupilot: bool) -> None:
    one, two = plan.vehicles
    failed = photo(1, 1 if ardupilot else 100, 20.0, 0, one.trajectory.at(20.0), ardupilot=ardupilot, ok=False)
    (tmp_path / "all.tlog").write_bytes(logged([*records(one), *records(two), failed]))
    (first, second), _ = read_tracks([tmp_path / "all.tlog"], FRAME)
    assert first.photos is not None
    assert len(first.photos.t_s) == 0
    assert second.photos is None


def test_logs_without_positions_hold_no_tracks(tmp_path: Path) -> None:
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    beat = bytes(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(codec))
    (tmp_path / "beats.tlog").write_bytes(logged([(0.0, beat)]))
    with pytest.raises(MissionError, match="expected vehicles' positions"):
        read_tracks([tmp_path / "beats.tlog"], FRAME)
    with pytest.raises(MissionError, match=r"gone\.tlog"):
        read_tracks([tmp_path / "gone.tlog"], FRAME)
