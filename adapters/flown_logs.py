"""Telemetry logs read as flights of a plan: which vehicle, since when, along which track; and what of it is lost.

**When did the mission start?** The first of these that a log tells of any vehicle, in this order:

1. *commanded*: MISSION_START went to the vehicle before it moved (logs of this ground station hold both directions);
2. *moved*: armed and in its mission's mode by its heartbeats, it left its place: that instant, less the time which the
   plan takes from the start to the same distance; a log without heartbeats counts as in its mission all the time;
3. *placed*: the log begins in flight: the vehicle is taken to be on time at the first place recorded.

A vehicle's start less its planned delay is the fleet's; of several, the earliest counts, so that one that started late
*is* late. All logs are taken to share one clock, that of their records' times; within a vehicle, its own clock
(time_boot_ms) is used, free of the link's jitter (see :mod:`.flight_recorder`).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.flight_recorder import FlightRecorder, landing_amsl_m
from adapters.ground_station import Peer
from adapters.mission_items import TAKEOFF, WAYPOINT, goal_seq, plan_items, wire_to_degrees
from adapters.mission_protocol import AUTOPILOT_COMPONENT, Party
from adapters.sorties import SPLINE_WAYPOINT
from adapters.telemetry_log import TelemetryLog, read_log
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.plan import FleetPlan, FlownVehicle, Trajectory, VehiclePlan
from missionplanner.replay import match, path_distance_m
from missionplanner.vehicle import Autopilot, VehicleClass

How = Literal["commanded", "moved", "placed"]
_HOWS: tuple[How, ...] = ("commanded", "moved", "placed")

_TOLD: dict[How, str] = {
    "commanded": "when MISSION_START was sent",
    "moved": "found from when the first vehicle moved",
    "placed": "set so that the first vehicle is on time where its log begins",
}

GAP_S = 2.0
"""A longer silence of a vehicle's position is told."""

_MODES: dict[tuple[Autopilot, VehicleClass], int] = {  # HEARTBEAT.custom_mode of a vehicle in its mission
    ("ardupilot", "copter"): 3,
    ("ardupilot", "plane"): 10,
    ("px4", "copter"): 4 << 16 | 4 << 24,
    ("px4", "plane"): 4 << 16 | 4 << 24,
}
_WANTED = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
        mavlink.MAVLINK_MSG_ID_MISSION_ITEM_REACHED,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        mavlink.MAVLINK_MSG_ID_STATUSTEXT,
        mavlink.MAVLINK_MSG_ID_COMMAND_LONG,
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
        mavlink.MAVLINK_MSG_ID_CAMERA_FEEDBACK,
        mavlink.MAVLINK_MSG_ID_CAMERA_IMAGE_CAPTURED,
    }
)
_NO_PHOTO = (mavlink.CAMERA_FEEDBACK_VIDEO, mavlink.CAMERA_FEEDBACK_BADEXPOSURE)
_OF_CAMERAS = ("CAMERA_FEEDBACK", "CAMERA_IMAGE_CAPTURED")
_MOVED_M = 2.0
_PLAN_STEP_S = 0.02
_AT_HOME_M = 30.0
_ELSEWHERE_M = 100.0  # half of the flight further than this from the plan's path: it is another mission's
_SAMPLES = 1000
_WRONG_TIME_S = 60.0  # off its neighbours: the time of a record has no checksum
_COMMAND_EARLY_S = 5.0  # before the heartbeat that shows the vehicle not yet in its mission
_JUMP_M, _JUMP_M_S, _JUMP_SHARE = 100.0, 150.0, 0.05

Records = list[tuple[float, Any]]


@dataclass(frozen=True, slots=True, eq=False)
class FlownLogs:
    """Flights found in logs."""

    flown: dict[str, FlownVehicle]  # by vehicle's name
    reached_s: dict[str, dict[int, float]]  # when waypoints were reported as reached, by index
    started_s: dict[str, float]  # each vehicle's own start, its planned delay taken off
    start_s: float  # since 1970
    start_by: How
    problems: tuple[str, ...]  # files and vehicles that cannot be replayed
    notes: tuple[str, ...]  # what is lost, and what else a reader should know

    @property
    def start_words(self) -> str:
        """Return what times are counted from."""
        at = datetime.fromtimestamp(self.start_s, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        return f"Times count from the mission's start at {at}, {_TOLD[self.start_by]}."

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "start": {"unix_s": round(self.start_s, 3), "by": self.start_by, "told": self.start_words},
            "started_s": {name: round(at_s, 3) for name, at_s in self.started_s.items()},
            "notes": list(self.notes),
            "problems": list(self.problems),
        }


@dataclass(slots=True)
class _Found:
    """What is found on the way."""

    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def read_flown(paths: Sequence[Path], plan: FleetPlan) -> FlownLogs:
    """Read logs, of one or several vehicles each, as flights of a plan.

    Raises
    ------
    MissionError
        No vehicle of the plan can be replayed: says why.
    """
    found = _Found()
    by_sysid, commands = _sorted(_read(paths, found))
    names = {vehicle.sysid: vehicle.name for vehicle in plan.vehicles}
    _strangers(by_sysid, names, plan, found)
    usable: dict[str, tuple[VehiclePlan, Records]] = {}
    starts: dict[str, tuple[How, float]] = {}
    for vehicle in plan.vehicles:
        records = by_sysid.get(vehicle.sysid, [])
        if not records:
            found.notes.append(f"{vehicle.name} (sysid {vehicle.sysid}): not in the logs")
            continue
        problem = _unfit(vehicle, records, plan.frame)
        start = None if problem else _start(vehicle, records, commands.get(vehicle.sysid, []), plan.frame)
        if problem is None and start is None:
            problem = f"expected a flight, got a vehicle that stays within {_MOVED_M:g} m of its place"
        if problem is not None or start is None:
            found.problems.append(f"{vehicle.name} (sysid {vehicle.sysid}): {problem}")
            continue
        usable[vehicle.name] = vehicle, records
        starts[vehicle.name] = start
        again = [begin_s for begin_s, _ in _in_mission(vehicle, records) if begin_s > start[1] + vehicle.arrival_s]
        if again:
            found.notes.append(
                f"{vehicle.name} (sysid {vehicle.sysid}): began its mission again {again[0] - start[1]:.0f} s later: "
                "only its first flight is replayed"
            )
    if not usable:
        raise MissionError("; ".join(found.problems) or "expected logs of the plan's vehicles, got none")
    start_by = min((how for how, _ in starts.values()), key=_HOWS.index)
    start_s = min(at_s for how, at_s in starts.values() if how == start_by)
    flown: dict[str, FlownVehicle] = {}
    reached_s: dict[str, dict[int, float]] = {}
    for name, (vehicle, records) in usable.items():
        track, reached = _flown(vehicle, records, start_s, plan.frame, found)
        if track is not None:
            flown[name], reached_s[name] = track, reached
    if not flown:
        raise MissionError("; ".join(found.problems))
    return FlownLogs(
        flown=flown,
        reached_s=reached_s,
        started_s={name: starts[name][1] - start_s for name in flown},
        start_s=start_s,
        start_by=start_by,
        problems=tuple(found.problems),
        notes=tuple(found.notes),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where a vehicle was by its logs, whatever its mission, and where it took photos."""

    sysid: int
    trajectory: Trajectory  # since the first position of all logs
    photos: Trajectory | None  # None: no log tells of any, not even of failed ones


def read_tracks(paths: Sequence[Path], frame: LocalFrame) -> tuple[tuple[Track, ...], tuple[str, ...]]:
    """Read logs as what they show of vehicles, one track for each; and what of the logs is lost, a line each.

    Raises
    ------
    MissionError
        A log cannot be read, or none holds a position.
    """
    found = _Found()
    by_sysid, _ = _sorted(_read(paths, found))
    if found.problems:
        raise MissionError("; ".join(found.problems))
    places = {sysid: _positions(records, frame) for sysid, records in sorted(by_sysid.items())}
    places = {sysid: track for sysid, track in places.items() if len(track[0])}
    if not places:
        raise MissionError(f"{paths[0]}: expected vehicles' positions (GLOBAL_POSITION_INT), got none")
    begin_s = min(float(at_s[0]) for at_s, _ in places.values())
    tracks = [
        Track(sysid, Trajectory(at_s - begin_s, position_m), _photos(by_sysid[sysid], frame, begin_s))
        for sysid, (at_s, position_m) in places.items()
    ]
    return tuple(tracks), tuple(found.notes)


def _photos(records: Records, frame: LocalFrame, begin_s: float) -> Trajectory | None:
    """Return when and where photos were taken: once each, though some are told of repeatedly; None: nobody tells.

    Who tells of failed ones only has taken none.
    """
    taken: dict[tuple[str, int, int, int], tuple[float, FloatArray]] = {}
    for at_s, m in records:
        match m.get_type():
            case "CAMERA_FEEDBACK" if m.flags not in _NO_PHOTO:  # ArduPilot
                key, where = ("feedback", m.img_idx, m.lat, m.lng), (m.lat, m.lng, m.alt_msl)
            case "CAMERA_IMAGE_CAPTURED" if m.capture_result == 1:  # PX4, and cameras
                key, where = ("captured", m.image_index, m.lat, m.lon), (m.lat, m.lon, m.alt / 1e3)
            case _:
                continue
        lat, lon, alt_m = where
        taken.setdefault(key, (at_s, frame.to_local(wire_to_degrees(lat), wire_to_degrees(lon), alt_m)))
    if not taken:
        tells = any(m.get_type() in _OF_CAMERAS for _, m in records)
        return Trajectory(np.zeros(0), np.zeros((0, 3))) if tells else None
    times_s, places_m = zip(*taken.values(), strict=True)
    return Trajectory(np.array(times_s) - begin_s, np.array(places_m))


# --- reading ---------------------------------------------------------------------------------------------------------


def _read(paths: Sequence[Path], found: _Found) -> Records:
    """Return the records of all logs in the order of their times, each once, and tell what is lost."""
    records: Records = []
    known: set[tuple[float, bytes]] = set()
    for path in paths:
        try:
            log = read_log(path, _WANTED)
        except MissionError as error:
            found.problems.append(str(error))
            continue
        if not log.sound_frames:
            found.problems.append(f"{path}: expected a telemetry log, got an empty file")
            continue
        kept = _timely(log)
        lost = _lost(log, len(log.records) - len(kept))
        if lost:
            found.notes.append(f"{path}: {lost}")
        for at_s, message in kept:
            key = at_s, bytes(message.get_msgbuf())
            if key not in known:  # a vehicle's own log repeats the fleet's
                known.add(key)
                records.append((at_s, message))
    if not records and found.problems:
        raise MissionError("; ".join(found.problems))
    records.sort(key=lambda record: record[0])
    return records


def _timely(log: TelemetryLog) -> Records:
    """Return the records whose times fit in with those around them."""
    at_s = np.array([at_s for at_s, _ in log.records])
    around = np.stack([np.roll(at_s, shift) for shift in (-2, -1, 0, 1, 2)])
    if len(at_s) > 4:
        around[:, :2], around[:, -2:] = around[:, 2:3], around[:, -3:-2]
    off_s = np.abs(at_s - np.median(around, axis=0))
    return [record for record, off in zip(log.records, off_s.tolist(), strict=True) if off <= _WRONG_TIME_S]


def _lost(log: TelemetryLog, untimely: int) -> str:
    """Return in words what of a log could not be used."""
    said = []
    if log.cut_bytes:
        said.append(f"cut short: {log.cut_bytes} bytes of an unfinished record at its end")
    if log.damaged_frames:
        said.append(f"{log.damaged_frames} {_frames(log.damaged_frames)} with a wrong checksum")
    if log.lost_bytes - log.cut_bytes:
        said.append(f"{log.lost_bytes - log.cut_bytes} bytes skipped")
    if log.unknown_frames:
        said.append(f"of these, {log.unknown_frames} {_frames(log.unknown_frames)} of kinds that are not known here")
    if untimely:
        said.append(f"{untimely} {_frames(untimely)} at impossible times")
    return ", ".join(said)


def _frames(count: int) -> str:
    return "frame" if count == 1 else "frames"


def _sorted(records: Records) -> tuple[dict[int, Records], dict[int, list[float]]]:
    """Return the autopilots' messages, and what cameras tell of photos, by sysid; when MISSION_START went to each."""
    by_sysid: dict[int, Records] = defaultdict(list)
    commands: dict[int, list[float]] = defaultdict(list)
    for at_s, message in records:
        if message.get_type() == "COMMAND_LONG":
            if message.command == mavlink.MAV_CMD_MISSION_START:
                commands[message.target_system].append(at_s)
        elif message.get_srcComponent() == AUTOPILOT_COMPONENT or message.get_type() in _OF_CAMERAS:
            by_sysid[message.get_srcSystem()].append((at_s, message))
    return by_sysid, commands


def _strangers(by_sysid: dict[int, Records], names: dict[int, str], plan: FleetPlan, found: _Found) -> None:
    """Tell of vehicles that are not in the plan."""
    strange = sorted(
        sysid
        for sysid, records in by_sysid.items()
        if sysid not in names and any(m.get_type() == "GLOBAL_POSITION_INT" for _, m in records)
    )
    known = ", ".join(str(vehicle.sysid) for vehicle in plan.vehicles)
    found.problems += [f"sysid {sysid}: expected one of the plan's vehicles (sysid {known})" for sysid in strange]


def _unfit(vehicle: VehiclePlan, records: Records, frame: LocalFrame) -> str | None:
    """Return why a vehicle's records cannot be its planned flight; None if they can."""
    heartbeat = next((m for _, m in records if m.get_type() == "HEARTBEAT"), None)
    if heartbeat is not None:
        peer = Peer(Party(vehicle.name, vehicle.sysid))
        peer.heartbeat = heartbeat
        if (peer.autopilot, peer.vehicle_class) != (vehicle.autopilot, vehicle.vehicle_class):
            return (
                f"expected {vehicle.autopilot} {vehicle.vehicle_class}, got {peer.autopilot} {peer.vehicle_class}: "
                "is it another fleet's log?"
            )
    at_s, position_m = _positions(records, frame)
    if len(at_s) < 2:
        return f"expected its positions (GLOBAL_POSITION_INT), got {len(at_s)} of them: log them too"
    steps_m, steps_s = np.linalg.norm(np.diff(position_m, axis=0), axis=1), np.diff(at_s)
    jumps = (steps_m > _JUMP_M) & (steps_m > _JUMP_M_S * steps_s)
    if np.count_nonzero(jumps) > max(2.0, _JUMP_SHARE * len(jumps)):
        return "its positions jump to and fro: are there two vehicles with one sysid?"
    return None


def _positions(records: Records, frame: LocalFrame) -> tuple[FloatArray, FloatArray]:
    """Return the times (S,) and places (S, 3) of positions on earth."""
    rows = [
        (at_s, wire_to_degrees(m.lat), wire_to_degrees(m.lon), m.alt / 1e3)
        for at_s, m in records
        if m.get_type() == "GLOBAL_POSITION_INT" and abs(m.lat) <= 9e8 and abs(m.lon) <= 18e8 and (m.lat or m.lon)
    ]
    if not rows:
        return np.empty(0), np.empty((0, 3))
    at_s, lat_deg, lon_deg, alt_m = np.array(rows).T
    position_m = frame.to_local(lat_deg, lon_deg, alt_m)
    there = np.isfinite(position_m).all(axis=1)  # the other side of the earth has no place in the frame
    return at_s[there], position_m[there]


# --- the start -------------------------------------------------------------------------------------------------------


def _start(
    vehicle: VehiclePlan, records: Records, commands: Sequence[float], frame: LocalFrame
) -> tuple[How, float] | None:
    """Return how and when the fleet's mission began as far as this vehicle tells; None if it never moved."""
    at_s, position_m = _positions(records, frame)
    delay_s = vehicle.start_delay_s
    for before_s, until_s in _in_mission(vehicle, records):
        k = max(int(np.searchsorted(at_s, before_s, side="right")) - 1, 0)
        if math.isinf(before_s) and np.linalg.norm(position_m[k] - vehicle.home_m) > _AT_HOME_M:
            planned_s = match(vehicle.trajectory, Trajectory(at_s - at_s[0], position_m))
            return "placed", float(at_s[0] - planned_s[0])
        away_m = np.linalg.norm(position_m - position_m[k], axis=1)
        gone = np.flatnonzero((away_m > _MOVED_M) & (at_s > max(before_s, at_s[k])) & (at_s < until_s))
        if not gone.size:
            continue
        g = int(gone[0])
        share = (_MOVED_M - away_m[g - 1]) / max(away_m[g] - away_m[g - 1], 1e-9)
        moved_s = float(at_s[g - 1] + np.clip(share, 0.0, 1.0) * (at_s[g] - at_s[g - 1]))
        told = [c for c in commands if before_s - _COMMAND_EARLY_S <= c <= moved_s]
        if told:
            accepted = [a for a in _acks(records) if a >= told[0]]
            sent = [c for c in told if not accepted or c <= accepted[0]]
            return "commanded", (sent or told)[-1] - delay_s
        return "moved", max(moved_s - _planned_move_s(vehicle), before_s - delay_s)
    return None


def _in_mission(vehicle: VehiclePlan, records: Records) -> list[tuple[float, float]]:
    """Return the spans in which it may have begun its mission: from the last heartbeat before, until it is disarmed."""
    mode = _MODES[vehicle.autopilot, vehicle.vehicle_class]
    beats = [(at_s, m) for at_s, m in records if m.get_type() == "HEARTBEAT"]
    if not beats:
        return [(-math.inf, math.inf)]
    spans: list[tuple[float, float]] = []
    before_s, flying = -math.inf, False
    for at_s, beat in beats:
        armed = bool(beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if armed and beat.custom_mode == mode and not flying:
            spans.append((before_s, math.inf))
            flying = True
        elif flying and not armed:
            spans[-1] = (spans[-1][0], at_s)
            flying = False
        before_s = at_s
    return spans


def _acks(records: Records) -> list[float]:
    return [
        at_s
        for at_s, m in records
        if m.get_type() == "COMMAND_ACK"
        and m.command == mavlink.MAV_CMD_MISSION_START
        and m.result == mavlink.MAV_RESULT_ACCEPTED
    ]


def _planned_move_s(vehicle: VehiclePlan) -> float:
    """Return when the plan has it so far from home that it counts as moved."""
    track = vehicle.trajectory
    t_s = np.arange(float(track.t_s[0]), float(track.t_s[-1]), _PLAN_STEP_S)
    gone = np.flatnonzero(np.linalg.norm(track.at(t_s) - track.position_m[0], axis=1) > _MOVED_M)
    return float(t_s[gone[0]]) if gone.size else vehicle.start_delay_s


# --- the flight ------------------------------------------------------------------------------------------------------


def _thinned(position_m: FloatArray) -> FloatArray:
    """Return some of the positions, enough to tell one site's mission from another's."""
    return position_m[np.linspace(0, len(position_m) - 1, min(len(position_m), _SAMPLES)).round().astype(np.intp)]


def _flown(
    vehicle: VehiclePlan, records: Records, start_s: float, frame: LocalFrame, found: _Found
) -> tuple[FlownVehicle | None, dict[int, float]]:
    """Return a vehicle's flight since the fleet's start, and when it reported its waypoints as reached."""
    items = plan_items(vehicle, frame)
    reach_m = vehicle.motion.waypoint_radius_m + 1.0
    recorder = FlightRecorder(goal_seq(items), vehicle.waypoints_m[-1], reach_m, frame, landing_amsl_m(vehicle))
    begun = False
    reported: dict[int, float] = {}
    for at_s, message in records:
        if not begun and at_s >= start_s:
            recorder.start(start_s)
            begun = True
        recorder.receive(message, at_s)
        if begun and message.get_type() == "MISSION_ITEM_REACHED":
            reported.setdefault(message.seq, at_s)
    who = f"{vehicle.name} (sysid {vehicle.sysid})"
    track = recorder.trajectory()
    if len(track.t_s) < 2:
        found.problems.append(f"{who}: expected positions after the mission's start, got none")
        return None, {}
    off_m = float(np.median(path_distance_m(_thinned(track.position_m), _thinned(vehicle.trajectory.position_m))))
    if off_m > _ELSEWHERE_M:
        found.problems.append(
            f"{who}: expected positions along its planned path, got half of them more than {off_m:.0f} m off it: "
            "is it another mission's log?"
        )
        return None, {}
    if recorder.rebooted:
        found.notes.append(f"{who}: its clock started anew in flight: what came after is not used")
    gaps_s = np.diff(track.t_s)
    long = gaps_s[gaps_s > GAP_S]
    if long.size:
        first_s = float(track.t_s[int(np.argmax(gaps_s))])
        found.notes.append(
            f"{who}: {long.size} {'gap' if long.size == 1 else 'gaps'} of more than {GAP_S:g} s in its positions, "
            f"the longest {gaps_s.max():.1f} s from {first_s:.1f} s on"
        )
    if recorder.arrival_s is None:
        found.notes.append(f"{who}: never reached its goal; its log ends {float(track.t_s[-1]):.1f} s after the start")
    seqs = [
        item.seq
        for item in (items[1:] if vehicle.autopilot == "ardupilot" else items)
        if item.command in (WAYPOINT, TAKEOFF, SPLINE_WAYPOINT)
    ]
    reached_s: dict[int, float] = {}
    if len(seqs) == len(vehicle.waypoints_m):
        # only when its hold is over is a waypoint reported
        hold_s = [items[seq].param1 if items[seq].command == WAYPOINT else 0.0 for seq in seqs]
        reached_s = {
            k: recorder.flight_time_s(reported[seq]) - hold_s[k] for k, seq in enumerate(seqs) if seq in reported
        }
    if recorder.arrival_s is not None:
        reached_s[len(vehicle.waypoints_m) - 1] = recorder.arrival_s
    return FlownVehicle(vehicle.name, vehicle.sysid, track, recorder.arrival_s, recorder.landed_s), reached_s
