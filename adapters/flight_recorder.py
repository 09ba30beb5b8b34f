"""What a vehicle's telemetry says of its flight: a track in time, the arrival, the landing. Messages in; no sockets.

Which clock? Positions carry the vehicle's own time since boot. It is free of the link's delay and jitter, and it runs
at the vehicle's rate: in lock-step and accelerated simulation too, where the ground's clock says little. So every
vehicle's flight is told in its own clock, and the clocks are tied together once, at the common start: the instant at
which the ground sent the start is found in the vehicle's clock from the few positions received just before and after
it, by the one that came with the least delay. What remains is the least delay of the link (milliseconds on a cable or
in lock-step, some 50 ms on a radio, alike for all vehicles of a link) and the drift between crystals (some 20 ms in ten
minutes). Messages without a time of their own, such as "item reached", are dated by the position received before them.

Which instant is the arrival? The goal is an item of its own, and the first of these to be known says when it was
reached: MISSION_ITEM_REACHED or ArduPilot's "Reached command #N" for it; else MISSION_CURRENT has moved past it, and
within the time between the last report before and the first after, it is the closest approach of the track. If all of
that was lost, it is the closest approach of the whole track, provided that it came within the goal's reach.

Which is the landing? That it is on the ground, by its own word; or that it is disarmed where the ground is known, or
where it stands still: who is disarmed in the air falls.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left, bisect_right
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import degrees_to_wire, wire_to_degrees
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.plan import Trajectory, VehiclePlan

_ANCHORS = 3  # positions on either side of the start that tie the clocks
_KEPT = 20  # positions before the start
_LAT_MAX, _LON_MAX = degrees_to_wire(90.0), degrees_to_wire(180.0)
_AIRBORNE_M = 1.5
_NEAR_M, _NEAR_ACROSS_M = 3.0, 50.0  # above known ground, and beside where it is known
_STANDS_M, _STANDS_S = 1.0, 3.0
_FELL_S = 8.0  # from being disarmed to being seen on the ground
_REBOOT_S = 10.0  # a clock that falls back by this much has been restarted; less is a message out of order
_REACHED_TEXT = re.compile(r"Reached command #(\d+)")
_IN_AIR = (mavlink.MAV_LANDED_STATE_IN_AIR, mavlink.MAV_LANDED_STATE_TAKEOFF, mavlink.MAV_LANDED_STATE_LANDING)


class FlightRecorder:
    """One vehicle's flight. ``goal_seq`` is the mission item whose reaching is the arrival.

    ``landing_amsl_m`` is the ground where it is to land; nan: not known.
    """

    def __init__(
        self,
        goal_seq: int,
        goal_m: FloatArray,
        reach_m: float,
        frame: LocalFrame,
        landing_amsl_m: float = math.nan,
    ) -> None:
        self._goal_seq = goal_seq
        self._goal_m = goal_m
        self._reach_m = reach_m
        self._frame = frame
        self._heard_s: list[float] = []  # link clock, of each position
        self._boot_s: list[float] = []  # vehicle clock
        self._geo: list[tuple[float, float, float]] = []
        self._start_geo: tuple[float, float, float] | None = None
        self._landing_m = landing_amsl_m
        self._begin(None)

    def _begin(self, start_s: float | None) -> None:
        self.reached_goal = False
        self.landed = False
        self.rebooted = False
        self.item: int | None = None  # MISSION_CURRENT
        self._start_s = start_s  # link clock
        self._reached_s: float | None = None
        self._done_s: dict[int, float] = {}  # link clock, when items were first said to be reached or left, by seq
        self._before_s: float | None = None  # last seen at or before the goal's item
        self._after_s: float | None = None  # first seen past it
        self._airborne = False
        self._landed_s: float | None = None
        self._disarmed_s: float | None = None  # since when, while it was not seen on the ground
        self._disarmed_k = 0  # positions before
        del self._heard_s[:-_KEPT], self._boot_s[:-_KEPT], self._geo[:-_KEPT]

    @property
    def position_m(self) -> FloatArray | None:
        """The last position (3,) in the local frame."""
        return self._frame.to_local(*self._geo[-1]) if self._geo else None

    def start(self, now_s: float) -> None:
        """Begin the record of a flight at the fleet's common start, in the link's clock."""
        self._begin(now_s)
        if self._geo:
            self._start_geo = self._geo[-1]

    def receive(self, message: Any, now_s: float) -> None:
        """Take one of the vehicle's messages."""
        if self._start_s is not None and hasattr(message, "time_boot_ms"):
            self._look_at_clock(message.time_boot_ms / 1e3, now_s)
        match message.get_type():
            case "GLOBAL_POSITION_INT":
                self._positioned(message, now_s)
            case "MISSION_CURRENT" if self._start_s is not None:
                self._at_item(message.seq, now_s)
            case "MISSION_ITEM_REACHED" if self._start_s is not None:
                self._done_s.setdefault(message.seq, now_s)
                if message.seq == self._goal_seq:
                    self._reached(now_s)
            case "STATUSTEXT" if self._start_s is not None:
                match_ = _REACHED_TEXT.search(status_text(message))
                if match_:
                    self._done_s.setdefault(int(match_[1]), now_s)
                    if int(match_[1]) == self._goal_seq:
                        self._reached(now_s)
            case "EXTENDED_SYS_STATE" if self._start_s is not None:
                if message.landed_state in _IN_AIR:
                    self._lifted_off()
                elif message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND:
                    self._touched_down(now_s)
            case "HEARTBEAT" if self._start_s is not None:
                if message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED:
                    self._disarmed_s = None
                else:
                    self._disarmed(now_s)

    def trajectory(self) -> Trajectory:
        """Return the track since the common start, until touch-down if there was one; S is 0 before any position."""
        if self._start_s is None or not self._boot_s:
            return Trajectory(np.empty(0), np.empty((0, 3)))
        boot_s = np.array(self._boot_s)
        t_s, first = np.unique(boot_s - self._start_boot_s(), return_index=True)
        lat_deg, lon_deg, alt_m = np.array(self._geo).T
        position_m = self._frame.to_local(lat_deg, lon_deg, alt_m)[first]
        track = Trajectory(t_s, position_m)
        end_s = min(t_s[-1], self.landed_s if self.landed_s is not None else math.inf)
        begin_s = max(t_s[0], 0.0)
        inside = (t_s > begin_s) & (t_s < end_s)
        edges_s = np.unique([begin_s, max(begin_s, end_s)])
        kept_s = np.concatenate([edges_s[:1], t_s[inside], edges_s[1:]])
        return Trajectory(kept_s, track.at(kept_s))

    @property
    def t_s(self) -> float | None:
        """Time since the common start of the last position."""
        if self._start_s is None or not self._boot_s:
            return None
        return self._boot_s[-1] - self._start_boot_s()

    @property
    def arrival_s(self) -> float | None:
        """When the goal was reached, since the common start; None if it was not."""
        if self._start_s is None or not self._boot_s:
            return None
        if self._reached_s is not None and (self._after_s is None or self._reached_s <= self._after_s):
            return self.flight_time_s(self._reached_s)
        track = self.trajectory()
        if self._after_s is not None:
            after_s = self.flight_time_s(self._after_s)
            before_s = 0.0 if self._before_s is None else self.flight_time_s(self._before_s)
            return _closest(track, self._goal_m, before_s, after_s)[0]
        if self.landed:
            at_s, distance_m = _closest(track, self._goal_m, 0.0, math.inf)
            return at_s if distance_m <= self._reach_m else None
        return None

    def reached_s(self, seq: int, place_m: FloatArray, reach_m: float) -> float | None:
        """Return when an item's place was first within reach while it was flown to, since the common start.

        None: it was not reached. Autopilots say so only after the hold there; without a track, that is what is known.
        """
        if self._start_s is None or not self._boot_s or seq not in self._done_s:
            return None
        end_s = self.flight_time_s(self._done_s[seq])
        before = [done_s for item, done_s in self._done_s.items() if item < seq]
        begin_s = self.flight_time_s(max(before)) if before else 0.0
        track = self.trajectory()
        near = np.linalg.norm(track.position_m - place_m, axis=1) <= reach_m
        inside = track.t_s[near & (track.t_s >= begin_s) & (track.t_s <= end_s)]
        return float(inside[0]) if inside.size else end_s

    @property
    def landed_s(self) -> float | None:
        """When it touched down after flying, since the common start; None if it did not."""
        if self._landed_s is None or not self._boot_s:
            return None
        return self.flight_time_s(self._landed_s)

    @property
    def disarmed_up_m(self) -> float | None:
        """How high above its start it is disarmed without being seen on the ground; None: it is not."""
        if self._disarmed_s is None or self.landed:
            return None
        return math.nan if self._start_geo is None else self._geo[-1][2] - self._start_geo[2]

    def fell(self, now_s: float) -> bool:
        """Return whether it was disarmed in the air: for long enough to be seen on the ground otherwise."""
        return self.disarmed_up_m is not None and self._disarmed_s is not None and now_s - self._disarmed_s > _FELL_S

    def flight_time_s(self, now_s: float) -> float:
        """Return an instant of the link's clock as time since the common start in the vehicle's clock."""
        k = max(bisect_left(self._heard_s, now_s + 1e-9) - 1, 0)
        boot_s = self._boot_s[k] + (now_s - self._heard_s[k])
        if k + 1 < len(self._boot_s):
            boot_s = min(boot_s, self._boot_s[k + 1])
        return max(boot_s - self._start_boot_s(), 0.0)

    def _positioned(self, message: Any, now_s: float) -> None:
        if abs(message.lat) > _LAT_MAX or abs(message.lon) > _LON_MAX:
            return  # no place on earth
        boot_s = message.time_boot_ms / 1e3
        if self._boot_s and boot_s < self._boot_s[-1]:
            if self._start_s is None:  # not flying yet: forget the time before
                self._heard_s.clear()
                self._boot_s.clear()
                self._geo.clear()
            else:
                return  # late on the link, or of another life
        alt_m = message.alt / 1e3
        if self._start_s is not None and self._start_geo is not None:
            self._airborne |= alt_m > self._start_geo[2] + _AIRBORNE_M
        self._heard_s.append(now_s)
        self._boot_s.append(boot_s)
        self._geo.append((wire_to_degrees(message.lat), wire_to_degrees(message.lon), alt_m))
        if self._start_s is None and len(self._boot_s) > 10 * _KEPT:
            self._begin(None)

    def _at_item(self, seq: int, now_s: float) -> None:
        for left in range(seq if self.item is None else self.item, seq):
            self._done_s.setdefault(left, now_s)
        self.item = seq
        if seq <= self._goal_seq and self._after_s is None:
            self._before_s = now_s
        elif seq > self._goal_seq and self._after_s is None and self._before_s is not None:
            self._after_s = now_s
            self.reached_goal = True

    def _reached(self, now_s: float) -> None:
        if self._reached_s is None:
            self._reached_s = now_s
        self.reached_goal = True

    def _look_at_clock(self, boot_s: float, now_s: float) -> None:
        """Notice a restart in flight, also when what is said after it would pass for a landing."""
        if not self._boot_s or boot_s >= self._boot_s[-1] - _REBOOT_S:
            return
        if self._landed_s is None or now_s - boot_s < self._landed_s:
            self.rebooted, self.landed, self._landed_s = True, False, None

    def _disarmed(self, now_s: float) -> None:
        if not self._airborne or self.landed or self.rebooted:
            return
        if self._disarmed_s is None:
            self._disarmed_s, self._disarmed_k = now_s, len(self._boot_s)
        if self._is_near_ground() or self._stands():
            self._touched_down(self._disarmed_s)

    def _is_near_ground(self) -> bool:
        position_m = self.position_m
        if position_m is None:
            return False
        grounds_m = [np.array([*self._goal_m[:2], self._landing_m])]
        if self._start_geo is not None:
            grounds_m.append(self._frame.to_local(*self._start_geo))
        return any(
            abs(position_m[2] - ground_m[2]) <= _NEAR_M and np.hypot(*(position_m - ground_m)[:2]) <= _NEAR_ACROSS_M
            for ground_m in grounds_m
        )

    def _stands(self) -> bool:
        """Return whether it has not moved for some seconds since it was disarmed."""
        if self._disarmed_k >= len(self._boot_s) or self._boot_s[-1] - self._boot_s[self._disarmed_k] < _STANDS_S:
            return False
        since = max(self._disarmed_k, bisect_left(self._boot_s, self._boot_s[-1] - _STANDS_S))
        lat_deg, lon_deg, alt_m = np.array(self._geo[since:]).T
        position_m = self._frame.to_local(lat_deg, lon_deg, alt_m)
        return bool(np.max(np.linalg.norm(position_m - position_m[-1], axis=1)) <= _STANDS_M)

    def _lifted_off(self) -> None:
        self._airborne = True
        self.landed = False
        self._landed_s = None

    def _touched_down(self, now_s: float) -> None:
        if self._airborne and not self.landed and not self.rebooted:
            self.landed = True
            self._landed_s = now_s

    def _start_boot_s(self) -> float:
        """Return the vehicle's clock at the common start."""
        assert self._start_s is not None
        k = bisect_right(self._heard_s, self._start_s)
        near = slice(max(k - _ANCHORS, 0), k + _ANCHORS)
        pairs = zip(self._heard_s[near], self._boot_s[near], strict=True)
        return max(boot_s - (heard_s - self._start_s) for heard_s, boot_s in pairs)


def landing_amsl_m(plan: VehiclePlan) -> float:
    """Return the altitude of the ground where a vehicle is to land at its goal; nan where it is not to."""
    return float(plan.trajectory.position_m[-1, 2]) if plan.end == "land" else math.nan


def status_text(message: Any) -> str:
    """Return the text of a STATUSTEXT."""
    text = message.text
    return (text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)).rstrip("\0")


def _closest(track: Trajectory, goal_m: FloatArray, begin_s: float, end_s: float) -> tuple[float, float]:
    """Return when, within a span of time, a track is closest to a point, and how close."""
    inside = track.t_s[(track.t_s > begin_s) & (track.t_s < end_s)]
    last_s = min(end_s, float(track.t_s[-1]))
    t_s = np.concatenate([[min(begin_s, last_s)], inside, [last_s]])
    position_m = track.at(t_s)
    leg_m = np.diff(position_m, axis=0)
    squared = np.maximum(np.einsum("ij,ij->i", leg_m, leg_m), 1e-12)
    share = np.clip(np.einsum("ij,ij->i", goal_m - position_m[:-1], leg_m) / squared, 0.0, 1.0)
    distance_m = np.linalg.norm(position_m[:-1] + share[:, None] * leg_m - goal_m, axis=1)
    k = int(np.argmin(distance_m))
    return float(t_s[k] + share[k] * (t_s[k + 1] - t_s[k])), float(distance_m[k])
