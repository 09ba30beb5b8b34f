"""A fleet on its links: find it, upload, verify, start together, watch. Non-blocking beneath, timed by a clock.

The order is a rule: nothing is armed before every vehicle holds its mission as sent; nothing takes off before every
vehicle that starts at once is armed. What goes wrong is a :class:`LinkError` that says how it leaves the fleet.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.command_protocol import command_name
from adapters.endpoint import Endpoint
from adapters.flight_recorder import FlightRecorder, status_text
from adapters.ground_station import (
    ANSWER_S,
    WAIT_S,
    Clock,
    Peer,
    Station,
    Steps,
    TransferProgress,
    Waiting,
    WallClock,
    joined,
)
from adapters.mission_items import TAKEOFF, WAYPOINT, MissionItem, goal_seq, plan_items, wire_to_degrees
from adapters.mission_protocol import MissionUpload, Party, mismatches
from adapters.pace_keeper import PaceKeeper, Told
from adapters.parameter_protocol import ParameterValue, mismatch
from adapters.return_settings import Setting, return_settings
from adapters.telemetry_log import FleetLog
from adapters.vehicle_parameters import Comparison, compared, reading_motion
from missionplanner.errors import LinkError
from missionplanner.geodesy import FloatArray, GeoPoint
from missionplanner.pacing import Pace, Pacer, Sighting
from missionplanner.plan import FleetFlight, FleetPlan, FlownMeeting, FlownVehicle, VehiclePlan
from missionplanner.vehicle import Autopilot, VehicleClass

__all__ = [
    "Clock",
    "Downloaded",
    "FleetLink",
    "Order",
    "ParameterChange",
    "ReadyProgress",
    "TransferProgress",
    "VehicleStatus",
    "WallClock",
    "WatchProgress",
    "download_missions",
]

Message = Any  # a pymavlink message: its classes are generated, and carry no types
Order = Literal["auto", "hold", "land", "rtl"]
ReadyProgress = Callable[[str, str], None]
"""Called with a vehicle's name and what it still lacks to be armed, "ready" in the end; whenever that changes."""


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """One vehicle while the fleet is being watched."""

    name: str
    sysid: int
    t_s: float | None  # since the common start, of the last position
    item: int | None  # flown to at present
    items: int
    position_m: FloatArray | None  # (3,)
    armed: bool
    arrived: bool
    landed: bool
    silent_s: float  # since anything was heard
    text: str  # what the vehicle said last
    pace: Pace | None = None  # how it is doing against the plan, where that is watched


WatchProgress = Callable[[Sequence[VehicleStatus]], None]


@dataclass(frozen=True, slots=True)
class ParameterChange:
    """A parameter that was set on a vehicle, which keeps it after the flight."""

    vehicle: str
    name: str
    before: float
    after: float


_READY_S = 180.0  # a cold GPS and a cold estimator take a minute
_TEXT_FOR_S = 30.0  # a vehicle repeats what keeps it from arming
_FLYING_S = 5.0  # from MISSION_START to being seen in its mission
_START_RETRY_S = 0.25
_ARM_S = 8.0  # an armed copter left idle disarms after 10 s
_LOOK_AGAIN_S = 20.0  # before a start by the clock
_LATE_MAX_S = 1.0  # after it
_ARM_EARLY_S = 4.0  # before a delayed start
_LOST_S = 60.0
_RETURNED_M = 90.0  # beyond its circle, within which a plane has come home
_PROGRESS_S = 0.5
_HEARTBEAT_S = 1.5

_CUSTOM_MODE = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
_PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK
_POSITION_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
)
# HEARTBEAT.custom_mode by what we want; "hold" is also the mode to be armed in, in which a copter stays on the ground.
# ArduPlane has no mode that lands where it is: it returns. PX4 packs main and sub mode.
_MODES: dict[tuple[Autopilot, VehicleClass], dict[Order, int]] = {
    ("ardupilot", "copter"): {"hold": 4, "auto": 3, "land": 9, "rtl": 6},
    ("ardupilot", "plane"): {"hold": 12, "auto": 10, "land": 11, "rtl": 11},
    **{
        ("px4", kind): {
            "hold": 4 << 16 | 3 << 24,
            "auto": 4 << 16 | 4 << 24,
            "land": 4 << 16 | 6 << 24,
            "rtl": 4 << 16 | 5 << 24,
        }
        for kind in ("copter", "plane")
    },
}
# ArduPlane is armed in FBWA, which waits for the sticks: good on the ground, never to be ordered in the air
_ARMING_MODES: dict[tuple[Autopilot, VehicleClass], int] = {("ardupilot", "plane"): 5}
_MESSAGE_INTERVALS_S = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.2,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 0.5,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.5,
}


class FleetLink:
    """A ground station for one fleet plan.

    ``home_tolerance_m`` (horizontally) and ``altitude_tolerance_m`` say how far from its planned home a vehicle may
    stand to be started: further, and it is the wrong vehicle, place or altitude datum.
    """

    def __init__(
        self,
        plan: FleetPlan,
        endpoints: Sequence[Endpoint],
        clock: Clock,
        *,
        log: FleetLog | None = None,
        home_tolerance_m: float = 10.0,
        altitude_tolerance_m: float = 5.0,
    ) -> None:
        self._plan = plan
        self._clock = clock
        self._vehicles = {vehicle.sysid: _Vehicle(vehicle, plan) for vehicle in plan.vehicles}
        self._station = Station(self._vehicles, endpoints, clock, log)
        self._home_tolerance_m = home_tolerance_m
        self._altitude_tolerance_m = altitude_tolerance_m
        self._log = log
        self._start_s: float | None = None
        self._later: dict[int, Steps] = {}  # starts still to come
        self._grounded: dict[int, LinkError] = {}  # who did not start when it should
        self._keeper: PaceKeeper | None = None

    @property
    def items(self) -> Mapping[int, tuple[MissionItem, ...]]:
        """The missions that are uploaded, by sysid."""
        return {sysid: vehicle.items for sysid, vehicle in self._vehicles.items()}

    @property
    def held(self) -> Mapping[int, tuple[MissionItem, ...]]:
        """The missions as the vehicles hold them, by sysid: what :meth:`verify` has read of those that passed it."""
        return {sysid: vehicle.held for sysid, vehicle in self._vehicles.items() if vehicle.held is not None}

    def close(self) -> None:
        """Close all links."""
        self._station.link.close()

    def connect(self, timeout_s: float = 30.0) -> None:
        """Wait until every vehicle of the plan is heard, and is what the plan takes it for.

        Raises
        ------
        LinkError
            Nobody, or not everybody answers; another autopilot or class of vehicle; two vehicles with one sysid.
        """
        names = {sysid: f"{vehicle.plan.name} (sysid {sysid})" for sysid, vehicle in self._vehicles.items()}
        self._station.wait_for(list(self._vehicles), names, timeout_s)
        for vehicle in self._vehicles.values():
            vehicle.check_identity()

    def compare_parameters(self) -> tuple[Comparison, ...]:
        """Read the parameters that decide how each vehicle moves, and compare them with what it was planned with.

        Raises
        ------
        LinkError
            A vehicle does not answer; nothing was changed.
        """
        found: dict[int, Comparison] = {}
        goings = {sysid: self._comparing(vehicle, found) for sysid, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was uploaded")
        return tuple(found[sysid] for sysid in self._vehicles)

    def upload(self, progress: TransferProgress | None = None) -> None:
        """Give every vehicle its mission, all at the same time.

        Raises
        ------
        LinkError
            A vehicle is armed, refuses, or falls silent; nothing was armed.
        """
        for vehicle in self._vehicles.values():
            if vehicle.armed:
                raise vehicle.error("is armed: land and disarm it before giving it a mission; nothing was uploaded")
            vehicle.held = None
            vehicle.upload = MissionUpload(vehicle.party, vehicle.plan.autopilot, vehicle.items)
        goings = {sysid: self._uploading(vehicle, progress) for sysid, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was armed")

    def verify(self, progress: TransferProgress | None = None) -> None:
        """Read every mission back and compare it with the plan's.

        Raises
        ------
        LinkError
            A vehicle holds another mission than the one sent, named by item and field; nothing was armed.
        """
        goings = {sysid: self._verifying(vehicle, progress) for sysid, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was armed")

    def set_returns(self, progress: TransferProgress | None = None) -> tuple[ParameterChange, ...]:
        """Set every vehicle to return straight home at its planned height, and read that back.

        Vehicles keep these parameters; what was changed is returned, so that it can be told.

        Raises
        ------
        LinkError
            A vehicle is armed, lacks a parameter, does not take its value, or holds rally points, to which it would
            return instead; nothing was armed.
        """
        for vehicle in self._vehicles.values():
            if vehicle.armed:
                raise vehicle.error("is armed: land and disarm it before setting its return height; nothing was set")
        changes: list[ParameterChange] = []
        goings = {k: self._setting_returns(vehicle, progress, changes) for k, vehicle in self._vehicles.items()}
        self._station.together(goings, after_failure="nothing was armed")
        return tuple(changes)

    def start(
        self,
        progress: ReadyProgress | None = None,
        *,
        ready_timeout_s: float = _READY_S,
        at_s: float | None = None,
    ) -> None:
        """Wait until all can be armed, arm all, then start all in one burst: all or none.

        Vehicles with a start delay are armed and started that much later, by :meth:`watch`; this returns when the first
        are in their missions. With ``at_s``, on the link's clock, nothing is armed before it is nearly time, and the
        start is just then.

        Raises
        ------
        LinkError
            A vehicle is not ready, stands elsewhere than planned, or does not start; the message says who flies.
        """
        self._station.together(
            {sysid: self._preparing(vehicle, ready_timeout_s, progress) for sysid, vehicle in self._vehicles.items()},
            after_failure="nothing was armed",
        )
        if at_s is not None and self._clock.now_s() > at_s:
            raise LinkError(
                f"all are ready {self._clock.now_s() - at_s:.0f} s after the start for fleet.arrival_utc: nothing was "
                "armed; ask for a later arrival"
            )
        first = {k: v for k, v in self._vehicles.items() if v.plan.start_delay_s <= 0.0}
        if at_s is not None:  # what was checked then may not hold any more
            self._wait_until(at_s - _LOOK_AGAIN_S)
            left_s = max(at_s - self._clock.now_s(), 0.0)
            self._station.together(
                {sysid: self._preparing(vehicle, left_s, progress) for sysid, vehicle in self._vehicles.items()},
                after_failure="nothing was armed",
            )
            self._wait_until(at_s - _ARM_EARLY_S)
        try:
            self._station.together({sysid: self._arming(vehicle) for sysid, vehicle in first.items()})
            self._wait_until(at_s)
            if at_s is not None and (late_s := self._clock.now_s() - at_s) > _LATE_MAX_S:
                raise LinkError(f"all were armed {late_s:.1f} s after the start for fleet.arrival_utc")
        except LinkError as error:
            raise LinkError(f"{error}; {self._stand_down()}") from error
        self._start_s = self._clock.now_s()
        for vehicle in self._vehicles.values():
            vehicle.recorder.start(self._start_s)
        try:
            self._station.together({sysid: self._starting(vehicle) for sysid, vehicle in first.items()})
        except LinkError as error:
            raise LinkError(f"{error}; {self._stand_down()}") from error
        self._later = {k: self._starting_later(v) for k, v in self._vehicles.items() if k not in first}

    def watch(
        self, progress: WatchProgress | None = None, *, pacer: Pacer | None = None, tell: Told | None = None
    ) -> FleetFlight:
        """Record until every vehicle has ended its mission: landed, or arrived where it is to stay.

        However it ends, vehicles that were stopped to lose time are let go on. With a ``pacer`` (of the plan's
        vehicles, in order) it is watched how late they are; and speeds are commanded, if the pacer may correct.
        ``tell`` hears of each.

        Raises
        ------
        LinkError
            A vehicle did not start when its delay was over, was not heard for a minute, restarted in flight, or takes
            far longer than planned, once the others have ended theirs. :meth:`flight` has what was recorded.
        """
        try:
            self._watch(progress, pacer, tell)
        except BaseException as error:  # of whatever kind: nobody watches the stopped ones now
            standing = self._let_go(tell)
            if standing and isinstance(error, LinkError):
                raise LinkError(f"{error}; {standing}") from error
            if standing and tell is not None:
                tell(standing)
            raise
        standing = self._let_go(tell)
        if standing:
            raise LinkError(standing)
        return self.flight()

    def _watch(self, progress: WatchProgress | None, pacer: Pacer | None, tell: Told | None) -> None:
        assert self._start_s is not None, "start first"
        longest_s = max(float(vehicle.plan.trajectory.t_s[-1]) for vehicle in self._vehicles.values())
        give_up_s = self._start_s + 2.0 * longest_s + 2.0 * _LOST_S
        release_s = give_up_s - longest_s  # enough to fly all of it
        shown_s = -math.inf
        vehicles = list(self._vehicles.values())

        def sighting(i: int, now_s: float) -> Sighting | None:
            return None if vehicles[i].plan.sysid in self._grounded else vehicles[i].sighting(now_s)

        if pacer is not None:
            self._keeper = PaceKeeper(pacer, self._station, vehicles, sighting, self._log, tell)
        while True:
            self._station.exchange()
            now_s = self._clock.now_s()
            self._start_those_due(tell)
            if self._keeper is not None:
                if now_s > release_s and math.isfinite(release_s):
                    release_s = math.inf
                    self._keeper.stop_no_more()
                    standing = self._let_go(tell)
                    if standing and tell is not None:
                        tell(standing)
                self._keeper.step(now_s)
            ended = not self._later and all(
                k in self._grounded or vehicle.ended or vehicle.lost(now_s) for k, vehicle in self._vehicles.items()
            )
            if progress is not None and (ended or now_s >= shown_s + _PROGRESS_S):
                shown_s = now_s
                advice = None if self._keeper is None else self._keeper.advice
                paces = [None] * len(vehicles) if advice is None else advice.paces
                progress([v.status(now_s, pace) for v, pace in zip(vehicles, paces, strict=True)])
            if ended or now_s > give_up_s:
                break
            self._clock.wait(WAIT_S)
        failures = [
            self._grounded.get(k) or v.failure(self._clock.now_s()) for k, v in self._vehicles.items() if not v.ended
        ]
        if failures:
            raise joined(failures)

    def _let_go(self, tell: Told | None) -> str:
        """Let vehicles go on that stand by our command; return what is to be said of those that did not confirm."""
        if self._keeper is None or not self._keeper.stopped:
            return ""
        names = [vehicle.plan.name for k, vehicle in enumerate(self._vehicles.values()) if k in self._keeper.stopped]
        try:
            names = self.release()
        except LinkError as failure:
            return str(failure)
        except Exception as failure:  # of the links themselves: the error that ended the watch is told as well
            return f"{', '.join(names)} may stand by our command ({failure}): take over by hand"
        if tell is not None:
            tell(f"{', '.join(names)}: stood to lose time, and told to go on")
        return ""

    def _start_those_due(self, tell: Told | None) -> None:
        """Go on with the starts that are still to come; who does not start stays where it is, the others fly on."""
        for sysid in list(self._later):
            try:
                next(self._later[sysid])
            except StopIteration:
                del self._later[sysid]
            except LinkError as failure:
                del self._later[sysid]
                if tell is not None:
                    tell(f"{failure}; the others fly their missions")

    def _ground(self, sysid: int, failure: LinkError) -> None:
        self._grounded[sysid] = failure
        if self._keeper is not None:
            self._keeper.ground(list(self._vehicles).index(sysid))

    def flight(self) -> FleetFlight:
        """Return what has been recorded so far."""
        flown = [vehicle.flown() for vehicle in self._vehicles.values()]
        keeper = self._keeper
        if keeper is None:
            return FleetFlight(tuple(flown))
        watched = (replace(vehicle, lateness=keeper.lateness(i)) for i, vehicle in enumerate(flown))
        vehicles = list(self._vehicles.values())
        meetings = [
            FlownMeeting(m.name, {vehicles[i].plan.name: vehicles[i].reached_s(at) for i, at in m.waypoints.items()})
            for m in keeper.meetings
        ]
        return FleetFlight(tuple(watched), tuple(keeper.corrections), tuple(meetings))

    @property
    def now_s(self) -> float:
        """The link's clock."""
        return self._clock.now_s()

    @property
    def armed(self) -> list[str]:
        """The names of the vehicles that are armed."""
        return [vehicle.plan.name for vehicle in self._vehicles.values() if vehicle.armed]

    @property
    def started(self) -> bool:
        """Whether the fleet's start has been commanded."""
        return self._start_s is not None

    def order(self, order: Order) -> None:
        """Send every armed vehicle home, down, into a hover, or (``auto``) on with its mission.

        Raises
        ------
        LinkError
            A vehicle does not confirm; the others have obeyed.
        """
        armed = {sysid: vehicle for sysid, vehicle in self._vehicles.items() if vehicle.armed}
        self._station.together(
            {k: self._switching(v, order) for k, v in armed.items()}, after_failure="the others have obeyed"
        )

    def call_off(self) -> list[str]:
        """Disarm those who have not started yet, before nobody watches them: they stay on the ground; return who.

        Raises
        ------
        LinkError
            A vehicle that may be armed does not answer.
        """
        self._later.clear()
        waiting = {k: v for k, v in self._vehicles.items() if not v.started and k not in self._grounded}
        grounded = {k: not (v.armed or v.asked_to_arm) for k, v in waiting.items()}

        def calling_off(sysid: int, vehicle: _Vehicle) -> Steps:
            try:
                grounded[sysid] = yield from self._disarming(vehicle)
            except LinkError:
                vehicle.command = None
                raise vehicle.error(
                    "has not been seen to start, and does not answer: it may be armed, or fly: take over by hand"
                ) from None

        unsure = {k: calling_off(k, v) for k, v in waiting.items() if not grounded[k]}
        if unsure:
            try:
                self._station.together(unsure)
            finally:
                self._station.settle(_HEARTBEAT_S)  # they say so
        return [vehicle.plan.name for k, vehicle in waiting.items() if grounded[k]]

    def release(self) -> list[str]:
        """Let vehicles go on that were stopped to lose time, before nobody watches them; return their names.

        Raises
        ------
        LinkError
            A vehicle does not confirm: it stands until somebody takes over.
        """
        keeper = self._keeper
        if keeper is None:
            return []
        vehicles = list(self._vehicles.values())
        stopped = {i: vehicles[i] for i in sorted(keeper.stopped)}
        self._station.together(
            {vehicle.plan.sysid: self._going_on(keeper, i, vehicle) for i, vehicle in stopped.items()},
            after_failure="take over by hand",
        )
        return [vehicle.plan.name for vehicle in stopped.values()]

    def _going_on(self, keeper: PaceKeeper, i: int, vehicle: _Vehicle) -> Steps:
        try:
            result = yield from self._station.commanding(vehicle, mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
        except LinkError as failure:
            vehicle.command = None
            raise LinkError(f"{failure}: it may stand by our command") from failure
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise vehicle.error(f"stands, and refused to go on{vehicle.said(self._clock.now_s())}")
        keeper.went_on(i)

    # what goes on with one vehicle, each a generator that yields whenever it waits

    def _comparing(self, vehicle: _Vehicle, found: dict[int, Comparison]) -> Steps:
        plan = vehicle.plan
        held = yield from reading_motion(self._station, vehicle, plan.autopilot, plan.vehicle_class)
        found[plan.sysid] = compared(plan.name, plan.motion, held)

    def _uploading(self, vehicle: _Vehicle, progress: TransferProgress | None) -> Steps:
        upload = vehicle.upload
        assert upload is not None
        shown = -1
        while not upload.done or upload.sent != shown:
            if upload.sent != shown:
                shown = upload.sent
                _tell(progress, vehicle, shown, upload.total)
            self._station.send(vehicle, upload.poll(self._clock.now_s()))
            yield
            vehicle.check_transfer()

    def _verifying(self, vehicle: _Vehicle, progress: TransferProgress | None) -> Steps:
        def tell(done: int, _total: int | None) -> None:
            _tell(progress, vehicle, done, len(vehicle.items))

        held = yield from self._station.downloading(vehicle, tell)
        wrong = mismatches(vehicle.items, held, vehicle.plan.autopilot)
        if wrong:
            more = f" (and {len(wrong) - 1} more)" if len(wrong) > 1 else ""
            command = _command_at(vehicle.items, wrong[0].seq)
            raise vehicle.error(f"holds another mission than was sent: {wrong[0]}{command}{more}; upload it again")
        vehicle.held = held

    def _setting_returns(
        self, vehicle: _Vehicle, progress: TransferProgress | None, changes: list[ParameterChange]
    ) -> Steps:
        rally = yield from self._station.downloading(vehicle, mission_type=mavlink.MAV_MISSION_TYPE_RALLY)
        if rally:
            raise vehicle.error(
                f"holds {len(rally)} rally points, to which it would return instead of its home: clear them"
            )
        motion = vehicle.plan.motion
        settings = return_settings(motion.autopilot, motion.vehicle_class, motion.return_height_m)
        values: list[tuple[Setting, float]] = []
        witness: str | None = None
        for done, setting in enumerate(settings):
            _tell(progress, vehicle, done, len(settings))
            held = yield from self._station.reading(vehicle, vehicle.plan.autopilot, setting, witness)
            if held is None:
                continue
            witness = held.name
            try:
                wanted = setting.wanted(held, vehicle.plan.autopilot)
            except ValueError as error:
                raise vehicle.error(
                    f"parameter {held.name}: cannot hold {setting.value:g} m ({error}): "
                    "change the vehicle's return_height_m and plan again"
                ) from error
            if held.value != wanted:
                yield from self._station.setting(vehicle, vehicle.plan.autopilot, held, wanted)
                changes.append(ParameterChange(vehicle.plan.name, held.name, held.value, wanted))
            values.append((setting, wanted))
        for setting, wanted in values:  # all of them once more: one may act upon another
            held = yield from self._station.reading(vehicle, vehicle.plan.autopilot, setting, None)
            assert held is not None
            if held.value != wanted:
                raise mismatch(vehicle.party, held.name, wanted, held.value)
        _tell(progress, vehicle, len(settings), len(settings))

    def _preparing(self, vehicle: _Vehicle, timeout_s: float, progress: ReadyProgress | None) -> Steps:
        for number, interval_s in _MESSAGE_INTERVALS_S.items():
            # one that will not be set comes at the vehicle's own rate
            yield from self._station.commanding(vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, interval_s * 1e6)
        end_s = self._clock.now_s() + timeout_s
        told = ""
        while (missing := vehicle.not_ready(self._clock.now_s())) is not None:
            if self._clock.now_s() >= end_s:
                raise vehicle.error(f"not ready to arm within {timeout_s:.0f} s: {missing}")
            if progress is not None and missing != told:
                progress(vehicle.plan.name, told := missing)
            yield
        self._check_home(vehicle)
        yield from self._rewinding(vehicle)
        kind = (vehicle.plan.autopilot, vehicle.plan.vehicle_class)
        yield from self._into_mode(vehicle, _ARMING_MODES.get(kind, vehicle.modes["hold"]), "its arming mode")
        if progress is not None:
            progress(vehicle.plan.name, "ready")

    def _rewinding(self, vehicle: _Vehicle) -> Steps:
        """Set the first item as the current one: the vehicle may have flown this mission before."""
        first = 1 if vehicle.plan.autopilot == "ardupilot" else 0
        message = mavlink.MAVLink_mission_set_current_message(vehicle.plan.sysid, 1, first)
        vehicle.current_item = None
        end_s = self._clock.now_s() + ANSWER_S
        due_s = -math.inf
        while vehicle.current_item is None or vehicle.current_item > first:
            now_s = self._clock.now_s()
            if now_s >= end_s:
                raise vehicle.error(
                    f"expected to begin its mission at item {first}, it stands at {vehicle.current_item}"
                )
            if now_s >= due_s:
                due_s = now_s + 1.0
                self._station.send(vehicle, [message])
            yield

    def _switching(self, vehicle: _Vehicle, order: Order) -> Steps:
        yield from self._into_mode(vehicle, vehicle.modes[order], order)

    def _into_mode(self, vehicle: _Vehicle, mode: int, name: str) -> Steps:
        main, sub = (mode, 0) if vehicle.plan.autopilot == "ardupilot" else (mode >> 16 & 0xFF, mode >> 24)
        result = yield from self._station.commanding(vehicle, mavlink.MAV_CMD_DO_SET_MODE, _CUSTOM_MODE, main, sub)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise vehicle.error(f"refused to switch to {name} (mode {mode}){vehicle.said(self._clock.now_s())}")

    def _arming(self, vehicle: _Vehicle) -> Steps:
        vehicle.asked_to_arm = True
        command = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        result = yield from self._station.commanding(vehicle, command, 1.0, patience_s=_ARM_S)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise vehicle.error(f"refused to arm{vehicle.said(self._clock.now_s())}")

    def _starting(self, vehicle: _Vehicle) -> Steps:
        result = yield from self._station.commanding(
            vehicle, mavlink.MAV_CMD_MISSION_START, 0.0, len(vehicle.items) - 1.0, retry_s=_START_RETRY_S
        )
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise vehicle.error(f"refused to start its mission{vehicle.said(self._clock.now_s())}")
        end_s = self._clock.now_s() + _FLYING_S
        # an ACK is not enough: ArduCopter accepts the start of a disarmed vehicle and stays where it is
        while not (vehicle.armed and vehicle.in_mode("auto")):
            if self._clock.now_s() >= end_s:
                state = "armed" if vehicle.armed else "disarmed"
                raise vehicle.error(
                    f"accepted the start but does not fly its mission (mode {vehicle.custom_mode}, {state})"
                    f"{vehicle.said(self._clock.now_s())}"
                )
            yield
        vehicle.started = True

    def _wait_until(self, at_s: float | None) -> None:
        """Hear all vehicles until it is time."""
        while at_s is not None and (left_s := at_s - self._clock.now_s()) > 0.0:
            self._station.exchange()
            self._clock.wait(min(WAIT_S, left_s))

    def _starting_later(self, vehicle: _Vehicle) -> Steps:
        assert self._start_s is not None
        at_s = self._start_s + vehicle.plan.start_delay_s
        while self._clock.now_s() < at_s - _ARM_EARLY_S:
            yield
        try:
            yield from self._arming(vehicle)
            while self._clock.now_s() < at_s:
                yield
            yield from self._starting(vehicle)
        except LinkError as failure:
            vehicle.command = None
            try:
                grounded = yield from self._disarming(vehicle)
            except LinkError:
                vehicle.command = None
                raise LinkError(f"{failure}; it does not answer and may be flying: take over by hand") from failure
            if not grounded:  # only what it said of its start was lost
                vehicle.started = True
                raise LinkError(f"{failure}; it has left the ground and is watched") from failure
            self._ground(vehicle.plan.sysid, failure)
            raise LinkError(f"{failure}; it is disarmed on the ground") from failure

    def _disarming(self, vehicle: _Vehicle) -> Waiting[bool]:
        """Disarm a vehicle that is on the ground; return whether it was: nobody disarms in the air."""
        disarm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        result = yield from self._station.commanding(vehicle, disarm, 0.0, patience_s=2.0)
        return bool(result == mavlink.MAV_RESULT_ACCEPTED)

    def _check_home(self, vehicle: _Vehicle) -> None:
        position_m = vehicle.recorder.position_m
        assert position_m is not None
        offset_m = position_m - vehicle.plan.home_m
        away_m = float(np.hypot(offset_m[0], offset_m[1]))
        if away_m > self._home_tolerance_m:
            raise vehicle.error(
                f"stands {away_m:.1f} m from its planned home (at most {self._home_tolerance_m:g} m): "
                "the wrong vehicle or place; move it or plan again"
            )
        if abs(offset_m[2]) > self._altitude_tolerance_m:
            raise vehicle.error(
                f"reports {position_m[2]:.1f} m AMSL where its home is planned at {vehicle.plan.home_m[2]:.1f} m "
                f"(at most {self._altitude_tolerance_m:g} m apart): check the terrain's datum and the barometer"
            )

    def _stand_down(self) -> str:
        """Bring a half-started fleet back to the ground, and say what came of it."""
        armed = {sysid: vehicle for sysid, vehicle in self._vehicles.items() if vehicle.armed or vehicle.command}
        self._station.settle(0.5)  # whoever has just been started says so
        told: list[str] = []
        silent: list[str] = []

        def ending(vehicle: _Vehicle) -> Steps:
            try:
                if not (yield from self._disarming(vehicle)):
                    yield from self._switching(vehicle, "land")
                    told.append(vehicle.plan.name)
            except LinkError:
                silent.append(vehicle.plan.name)

        self._station.together({sysid: ending(vehicle) for sysid, vehicle in armed.items()})
        if silent:
            return (
                f"the start was called off, but {', '.join(silent)} did not answer and may be flying: take over by hand"
            )
        if told:
            return f"the start was called off: {', '.join(told)} told to land, the others disarmed"
        return "the start was called off: all vehicles are disarmed on the ground"


class _Vehicle(Peer):
    """What is known of one vehicle, and what goes on with it."""

    def __init__(self, plan: VehiclePlan, fleet: FleetPlan) -> None:
        super().__init__(Party(plan.name, plan.sysid))
        self.plan = plan
        self.items = plan_items(plan, fleet.frame)
        self.modes = _MODES[plan.autopilot, plan.vehicle_class]
        self.recorder = FlightRecorder(
            goal_seq(self.items), plan.waypoints_m[-1], plan.motion.waypoint_radius_m + 1.0, fleet.frame
        )
        self._due_after_s = fleet.mission.fleet.arrives_after_s(plan.name)
        self.asked_to_arm = False
        self.started = False  # seen to fly its mission
        self.held: tuple[MissionItem, ...] | None = None
        self.current_item: int | None = None
        self._status: Message | None = None
        self._ekf_flags: int | None = None
        self._text = ""
        self._text_s = -math.inf
        self._heard_s = -math.inf
        self._item_s = self._position_s = -math.inf
        self._velocity_m_s = np.zeros(3)
        self._paused = False
        self._flown_to = [item.seq for item in self.items if item.command in (TAKEOFF, WAYPOINT)]
        if plan.autopilot == "ardupilot":
            del self._flown_to[0]  # home

    @property
    def custom_mode(self) -> int | None:
        return None if self.heartbeat is None else int(self.heartbeat.custom_mode)

    @property
    def ended(self) -> bool:
        """Whether it has done all that its plan asks."""
        if self.recorder.landed or not self.recorder.reached_goal:
            return self.recorder.landed
        if self.plan.end == "loiter":
            return True
        # a plane that has returned circles above home until somebody lands it
        position_m = self.recorder.position_m
        return (
            self.plan.vehicle_class == "plane"
            and self.plan.end == "rtl"
            and position_m is not None
            and float(np.hypot(*(position_m - self.plan.home_m)[:2])) <= self.plan.motion.loiter_radius_m + _RETURNED_M
        )

    def in_mode(self, order: Order) -> bool:
        return self.custom_mode == self.modes[order]

    def receive(self, message: Message, now_s: float) -> list[Message]:
        """Take one message of this vehicle and return what to answer."""
        self._heard_s = now_s
        match message.get_type():
            case "SYS_STATUS":
                self._status = message
            case "EKF_STATUS_REPORT":
                self._ekf_flags = message.flags
            case "MISSION_CURRENT":
                self.current_item = message.seq
                self._item_s = now_s
                self._paused = message.mission_state == mavlink.MISSION_STATE_PAUSED
            case "GLOBAL_POSITION_INT":
                self._position_s = now_s
                self._velocity_m_s = np.array([message.vy, message.vx, -message.vz]) / 100.0  # north, east, down
            case "STATUSTEXT":
                self._text, self._text_s = status_text(message), now_s
        self.recorder.receive(message, now_s)
        return super().receive(message, now_s)

    def check_identity(self) -> None:
        autopilot, vehicle_class = self.autopilot, self.vehicle_class
        if (autopilot, vehicle_class) != (self.plan.autopilot, self.plan.vehicle_class):
            raise self.error(
                f"expected {self.plan.autopilot} {self.plan.vehicle_class}, got {autopilot} {vehicle_class}: "
                "the wrong vehicle, or correct the mission file and plan again; nothing was uploaded"
            )

    def not_ready(self, now_s: float) -> str | None:
        """Return what is missing until it can be armed, None if nothing."""
        status = self._status
        if status is None:
            return "no SYS_STATUS"
        present, health = status.onboard_control_sensors_present, status.onboard_control_sensors_health
        if self.recorder.position_m is None or not np.isfinite(self.recorder.position_m).all():
            return "no position"
        if present & _POSITION_SENSORS & ~health:
            return f"gyroscope, accelerometer, compass or GPS not healthy{self.said(now_s)}"
        wanted = mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_VELOCITY_HORIZ | mavlink.ESTIMATOR_POS_HORIZ_ABS
        if self._ekf_flags is not None and ~self._ekf_flags & wanted:
            return f"its estimate of position is not healthy{self.said(now_s)}"
        if present & _PREARM and not health & _PREARM:
            return f"pre-arm checks fail{self.said(now_s)}"
        return None

    def said(self, now_s: float) -> str:
        """Return the vehicle's own last words in brackets, if they are fresh."""
        return f' ("{self._text}")' if self._text and now_s - self._text_s <= _TEXT_FOR_S else ""

    def lost(self, now_s: float) -> bool:
        return now_s - self._heard_s > _LOST_S or self.recorder.rebooted

    def failure(self, now_s: float) -> LinkError:
        where = f"at item {self.recorder.item}" if self.recorder.item is not None else "before its first item"
        if self.recorder.rebooted:
            return self.error(f"its autopilot restarted in flight, {where}")
        if self.lost(now_s):
            return self.error(
                f"not heard for {now_s - self._heard_s:.0f} s, {where}; it flies on by itself: "
                "watch for it at its goal or home"
            )
        return self.error(f"still flying long after its planned end, {where}: take over, or watch again")

    def sighting(self, now_s: float) -> Sighting | None:
        """Return where it is on its mission; None before that is known."""
        t_s, position_m, item = self.recorder.t_s, self.recorder.position_m, self.recorder.item
        if t_s is None or position_m is None or item is None:
            return None
        waypoint = len(self._flown_to) if self.recorder.reached_goal else bisect_left(self._flown_to, item)
        return Sighting(
            t_s=t_s,
            position_m=position_m,
            velocity_m_s=self._velocity_m_s,
            waypoint=waypoint,
            in_mission=self.armed and self.in_mode("auto"),
            paused=self._paused,
            age_s=now_s - min(self._item_s, self._position_s),
            arrival_s=self.recorder.arrival_s if self.recorder.reached_goal else None,
        )

    def status(self, now_s: float, pace: Pace | None = None) -> VehicleStatus:
        return VehicleStatus(
            name=self.plan.name,
            sysid=self.plan.sysid,
            t_s=self.recorder.t_s,
            item=self.recorder.item,
            items=len(self.items),
            position_m=self.recorder.position_m,
            armed=self.armed,
            arrived=self.recorder.reached_goal,
            landed=self.recorder.landed,
            silent_s=now_s - self._heard_s,
            text=self._text,
            pace=pace,
        )

    def reached_s(self, waypoint: int) -> float | None:
        """Return when a waypoint of its plan was reached, since the common start."""
        place_m, reach_m = self.plan.waypoints_m[waypoint], self.plan.motion.waypoint_radius_m + 1.0
        return self.recorder.reached_s(self._flown_to[waypoint], place_m, reach_m)

    def flown(self) -> FlownVehicle:
        recorder = self.recorder
        return FlownVehicle(
            self.plan.name,
            self.plan.sysid,
            recorder.trajectory(),
            recorder.arrival_s,
            recorder.landed_s,
            self._due_after_s,
        )


@dataclass(frozen=True, slots=True)
class Downloaded:
    """What a vehicle was found to hold.

    ``remarks`` say what would make it return otherwise than straight to ``home`` at ``return_height_m`` above it.
    """

    sysid: int
    autopilot: Autopilot
    vehicle_class: VehicleClass
    items: tuple[MissionItem, ...]
    home: GeoPoint | None  # None: it has none yet
    return_height_m: float
    remarks: tuple[str, ...]
    parameters: Mapping[str, ParameterValue]  # those that decide how it moves


def download_missions(
    endpoints: Sequence[Endpoint],
    clock: Clock,
    *,
    expected: Sequence[int] | None = None,
    timeout_s: float = 30.0,
    progress: TransferProgress | None = None,
    log: FleetLog | None = None,
) -> dict[int, Downloaded]:
    """Read what vehicles hold, by sysid, and change nothing: of those expected, or of all that are heard.

    Raises
    ------
    LinkError
        Nobody, or not everybody answers; a vehicle of a kind that we do not know; two vehicles with one sysid.
    """
    station = _Listener(endpoints, clock, log)
    wanted = None if expected is None else sorted(set(expected))
    station.wait_for(wanted, {sysid: f"sysid {sysid}" for sysid in wanted or ()}, timeout_s)
    found: dict[int, Downloaded] = {}
    peers = {k: peer for k, peer in station.peers.items() if wanted is None or k in wanted}
    station.together({k: _finding(station, peer, progress, found) for k, peer in peers.items()})
    return dict(sorted(found.items()))


class _Listener(Station["_Stranger"]):
    """A ground station that takes in whoever it hears."""

    def __init__(self, endpoints: Sequence[Endpoint], clock: Clock, log: FleetLog | None) -> None:
        super().__init__({}, endpoints, clock, log)

    def met(self, sysid: int) -> None:
        self.peers[sysid] = _Stranger(Party(f"vehicle {sysid}", sysid))


class _Stranger(Peer):
    """A vehicle that no plan describes."""

    home: GeoPoint | None = None

    def receive(self, message: Message, now_s: float) -> list[Message]:
        if message.get_type() == "HOME_POSITION":
            self.home = GeoPoint(
                wire_to_degrees(message.latitude), wire_to_degrees(message.longitude), message.altitude / 1e3
            )
        return super().receive(message, now_s)


def _finding(
    station: _Listener, peer: _Stranger, progress: TransferProgress | None, found: dict[int, Downloaded]
) -> Steps:
    autopilot, vehicle_class = peer.known_kind()
    parameters = yield from reading_motion(station, peer, autopilot, vehicle_class)

    def tell(done: int, total: int | None) -> None:
        if progress is not None and total is not None:
            progress(peer.party.vehicle, done, total)

    items = yield from station.downloading(peer, tell)
    rally = yield from station.downloading(peer, mission_type=mavlink.MAV_MISSION_TYPE_RALLY)
    remarks = [f"it holds {len(rally)} rally points, to which it may return instead of its home"] if rally else []
    height, *_ = return_settings(autopilot, vehicle_class, 0.0)
    held_height = yield from station.reading(peer, autopilot, height, None)
    assert held_height is not None
    height_m = height.meant(held_height)
    if not math.isfinite(height_m):
        raise peer.error(f"holds {held_height.name} {held_height.value:g}: expected a height to return at: set it")
    for setting in return_settings(autopilot, vehicle_class, height_m)[1:]:
        held = yield from station.reading(peer, autopilot, setting, held_height.name)
        if held is not None and setting.meant(held) != setting.value:
            remarks.append(f"{held.name} is {held.value:g}: its return is known only for {setting.value:g}")
    if height_m < 0.0:
        remarks.append(f"{held_height.name} is {held_height.value:g}: it returns at its present height")
    # one without a home yet refuses
    home = mavlink.MAVLINK_MSG_ID_HOME_POSITION
    result = yield from station.commanding(peer, mavlink.MAV_CMD_REQUEST_MESSAGE, home)
    end_s = station.clock.now_s() + ANSWER_S
    while result == mavlink.MAV_RESULT_ACCEPTED and peer.home is None and station.clock.now_s() < end_s:
        yield
    found[peer.party.sysid] = Downloaded(
        peer.party.sysid, autopilot, vehicle_class, items, peer.home, height_m, tuple(remarks), parameters
    )


def _tell(progress: TransferProgress | None, vehicle: _Vehicle, done: int, total: int) -> None:
    if progress is not None:
        progress(vehicle.plan.name, done, total)


def _command_at(items: Sequence[MissionItem], seq: int) -> str:
    return f" ({command_name(items[seq].command)})" if seq < len(items) else ""
