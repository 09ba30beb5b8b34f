"""A fleet's flight: start together, watch, give orders. Non-blocking beneath, timed by a clock.

The order is a rule: nothing takes off before every vehicle that starts at once is armed. What goes wrong is a
:class:`LinkError` that says how it leaves the fleet.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint
from adapters.fleet_vehicle import ARMING_MODES, FleetVehicle, Order, VehicleStatus
from adapters.ground_station import ANSWER_S, WAIT_S, Clock, Station, Steps, Waiting, joined
from adapters.pace_keeper import PaceKeeper, Told
from adapters.telemetry_log import FleetLog
from missionplanner.errors import LinkError
from missionplanner.pacing import Pacer, Sighting
from missionplanner.plan import FleetFlight, FleetPlan, FlownMeeting

ReadyProgress = Callable[[str, str], None]
"""Called with a vehicle's name and what it still lacks to be armed, "ready" in the end; whenever that changes."""
WatchProgress = Callable[[Sequence[VehicleStatus]], None]

_READY_S = 180.0  # a cold GPS and a cold estimator take a minute
_FLYING_S = 5.0  # from MISSION_START to being seen in its mission
_START_RETRY_S = 0.25
_ARM_S = 8.0  # an armed copter left idle disarms after 10 s
_LOOK_AGAIN_S = 20.0  # before a start by the clock
_LATE_MAX_S = 1.0  # after it
_ARM_EARLY_S = 4.0  # before a delayed start
_LOST_S = 60.0
_PROGRESS_S = 0.5
_HEARTBEAT_S = 1.5

_CUSTOM_MODE = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
_MESSAGE_INTERVALS_S = {
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.2,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 0.5,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.5,
}


class FlightControl:
    """A fleet plan's vehicles on their links, each with its mission: started, watched and ordered about.

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
        self._vehicles = {vehicle.sysid: FleetVehicle(vehicle, plan) for vehicle in plan.vehicles}
        self._station = Station(self._vehicles, endpoints, clock, log)
        self._home_tolerance_m = home_tolerance_m
        self._altitude_tolerance_m = altitude_tolerance_m
        self._log = log
        self._start_s: float | None = None
        self._later: dict[int, Steps] = {}  # starts still to come
        self._grounded: dict[int, LinkError] = {}  # who did not start when it should
        self._keeper: PaceKeeper | None = None

    def close(self) -> None:
        """Close all links."""
        self._station.link.close()

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

        def calling_off(sysid: int, vehicle: FleetVehicle) -> Steps:
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

    def _going_on(self, keeper: PaceKeeper, i: int, vehicle: FleetVehicle) -> Steps:
        try:
            result = yield from self._station.commanding(vehicle, mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
        except LinkError as failure:
            vehicle.command = None
            raise LinkError(f"{failure}: it may stand by our command") from failure
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise vehicle.error(f"stands, and refused to go on{vehicle.said(self._clock.now_s())}")
        keeper.went_on(i)

    # what goes on with one vehicle, each a generator that yields whenever it waits

    def _preparing(self, vehicle: FleetVehicle, timeout_s: float, progress: ReadyProgress | None) -> Steps:
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
        yield from self._into_mode(vehicle, ARMING_MODES.get(kind, vehicle.modes["hold"]), "its arming mode")
        if progress is not None:
            progress(vehicle.plan.name, "ready")

    def _rewinding(self, vehicle: FleetVehicle) -> Steps:
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

    def _switching(self, vehicle: FleetVehicle, order: Order) -> Steps:
        yield from self._into_mode(vehicle, vehicle.modes[order], order)

    def _into_mode(self, vehicle: FleetVehicle, mode: int, name: str) -> Steps:
        main, sub = (mode, 0) if vehicle.plan.autopilot == "ardupilot" else (mode >> 16 & 0xFF, mode >> 24)
        result = yield from self._station.commanding(vehicle, mavlink.MAV_CMD_DO_SET_MODE, _CUSTOM_MODE, main, sub)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise vehicle.error(f"refused to switch to {name} (mode {mode}){vehicle.said(self._clock.now_s())}")

    def _arming(self, vehicle: FleetVehicle) -> Steps:
        vehicle.asked_to_arm = True
        command = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        result = yield from self._station.commanding(vehicle, command, 1.0, patience_s=_ARM_S)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            raise vehicle.error(f"refused to arm{vehicle.said(self._clock.now_s())}")

    def _starting(self, vehicle: FleetVehicle) -> Steps:
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

    def _starting_later(self, vehicle: FleetVehicle) -> Steps:
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

    def _disarming(self, vehicle: FleetVehicle) -> Waiting[bool]:
        """Disarm a vehicle that is on the ground; return whether it was: nobody disarms in the air."""
        disarm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        result = yield from self._station.commanding(vehicle, disarm, 0.0, patience_s=2.0)
        return bool(result == mavlink.MAV_RESULT_ACCEPTED)

    def _check_home(self, vehicle: FleetVehicle) -> None:
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

        def ending(vehicle: FleetVehicle) -> Steps:
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
