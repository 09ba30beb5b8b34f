"""A fleet's flight: start together, watch, give orders. Non-blocking beneath, timed by a clock.

The order is a rule: nothing takes off before every vehicle that starts at once is armed. What goes wrong is a
:class:`LinkError` that says how it leaves the fleet.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint
from adapters.fleet_vehicle import (
    ARMING_MODES,
    LOST_S,
    NOT_KNOWN,
    STANDS_M_S,
    UNHEARD_S,
    FleetVehicle,
    Mode,
    Order,
    VehicleStatus,
)
from adapters.ground_station import ANSWER_S, WAIT_S, Clock, Station, Steps, Waiting, joined
from adapters.pace_keeper import PaceKeeper, Told
from adapters.telemetry_log import FleetLog
from missionplanner.errors import LinkError
from missionplanner.pacing import Pacer, Sighting
from missionplanner.plan import FleetFlight, FleetPlan, FlownMeeting, Ordered, OrderResult

ReadyProgress = Callable[[str, str], None]
"""Called with a vehicle's name and what it still lacks to be armed, "ready" in the end; whenever that changes."""
WatchProgress = Callable[[Sequence[VehicleStatus]], None]


@dataclass(frozen=True, slots=True)
class Request:
    """An order for the named vehicles; for all where none is named.

    ``unproven``: let them resume also where their way back to their missions is not proven.
    """

    order: Order
    vehicles: frozenset[str] = frozenset()
    unproven: bool = False


class Helm(Protocol):
    """Whoever gives orders while a fleet is watched."""

    def request(self) -> Request | None:
        """Return what is wanted now; called again and again. May raise ``KeyboardInterrupt`` to end the watch."""
        ...

    def answer(self, outcomes: Sequence[Ordered]) -> None:
        """Hear what came of the last request, vehicle by vehicle."""
        ...


_READY_S = 180.0  # a cold GPS and a cold estimator take a minute
_FLYING_S = 5.0  # from MISSION_START to being seen in its mission
_START_RETRY_S = 0.25
_ARM_S = 8.0  # an armed copter left idle disarms after 10 s
_DISARM_S = 4.0  # of a stand-down: for an answer, and a heartbeat that shows it
_LOOK_AGAIN_S = 20.0  # before a start by the clock
_LATE_MAX_S = 1.0  # after it
_ARM_EARLY_S = 4.0  # before a delayed start
_PROGRESS_S = 0.5
_HEARTBEAT_S = 1.5
_SEEN_S = 3.0  # from an answer to a heartbeat that shows what was answered
_STANDS_S = 10.0  # from an answer to standing still
_ORDER_S = 5.0  # for an answer to an order
_FIND_S = 5.0  # for a heartbeat of those who are to be given one
_WARNED_M = 25.0  # flown on since, a warning of the way back is another's

NOT_PROVEN = (
    "that the fleet keeps apart, also when it returns, and arrives together was proven for the planned times only: it "
    "is watched from now on, not proven"
)
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
        self._orders: dict[int, Steps] = {}  # being given
        self._giving: Order | None = None  # what they are
        self._outcomes: dict[int, Ordered] = {}  # of those given last
        self._ordered: list[Ordered] = []  # all of them, in order
        self._paused_s: dict[int, float] = {}  # since when vehicles stand by order
        self._put_off_s: dict[int, float] = {}  # for how long they have stood before
        self._unheard: set[int] = set()

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
            A vehicle is not ready, stands elsewhere than planned, is armed already, holds another
            mission than was sent, or does not start; the message says who flies.
        """
        look_again_s = _LOOK_AGAIN_S + self._prepare(ready_timeout_s, progress)
        if at_s is not None and self._clock.now_s() > at_s:
            raise LinkError(
                f"all are ready {self._clock.now_s() - at_s:.0f} s after the start for fleet.arrival_utc: nothing was "
                "armed; ask for a later arrival"
            )
        first = {k: v for k, v in self._vehicles.items() if v.plan.start_delay_s <= 0.0}
        if at_s is not None:  # what was checked then may not hold any more
            self._wait_until(at_s - look_again_s)
            self._prepare(max(at_s - self._clock.now_s(), 0.0), progress)
            self._wait_until(at_s - _ARM_EARLY_S)
        try:
            self._station.together({sysid: self._arming(vehicle) for sysid, vehicle in first.items()})
            self._wait_until(at_s)
            if at_s is not None and (late_s := self._clock.now_s() - at_s) > _LATE_MAX_S:
                raise LinkError(f"all were armed {late_s:.1f} s after the start for fleet.arrival_utc")
        except LinkError as error:
            raise LinkError(f"{error}; {self._stand_down()}") from error
        self._start_s = self._clock.now_s()
        self._station.begin_flight()
        for vehicle in self._vehicles.values():
            vehicle.recorder.start(self._start_s)
            vehicle.take_news()
        try:
            self._station.together({sysid: self._starting(vehicle) for sysid, vehicle in first.items()})
        except LinkError as error:
            raise LinkError(f"{error}; {self._stand_down()}") from error
        self._later = {k: self._starting_later(v) for k, v in self._vehicles.items() if k not in first}

    def _prepare(self, timeout_s: float, progress: ReadyProgress | None) -> float:
        """Wait until all can be armed, then see that all hold their missions still; return how long the latter took.

        Others may have given them new ones since they were read back: it may be minutes.
        """
        going = {k: self._preparing(vehicle, timeout_s, progress) for k, vehicle in self._vehicles.items()}
        self._station.together(going, after_failure="nothing was armed")
        begun_s = self._clock.now_s()
        going = {k: self._confirming(vehicle) for k, vehicle in self._vehicles.items()}
        self._station.together(going, after_failure="nothing was armed")
        return self._clock.now_s() - begun_s

    def watch(
        self,
        progress: WatchProgress | None = None,
        *,
        pacer: Pacer | None = None,
        tell: Told | None = None,
        helm: Helm | None = None,
    ) -> FleetFlight:
        """Record until every vehicle has ended its mission: landed, or arrived where it is to stay.

        However it ends, vehicles that were stopped to lose time are let go on. With a ``pacer`` (of the plan's
        vehicles, in order) it is watched how late they are; and speeds are commanded, if the pacer may correct.
        ``tell`` hears of each, of vehicles that are not heard for a while, and of what came of the orders that the
        ``helm`` gives.

        Raises
        ------
        LinkError
            A vehicle did not start when its delay was over, was not heard for a minute, restarted in flight, or takes
            far longer than planned, once the others have ended theirs. :meth:`flight` has what was recorded.
        """
        try:
            self._watch(progress, pacer, tell, helm)
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

    def _watch(self, progress: WatchProgress | None, pacer: Pacer | None, tell: Told | None, helm: Helm | None) -> None:
        assert self._start_s is not None, "start first"
        longest_s = max(float(vehicle.plan.trajectory.t_s[-1]) for vehicle in self._vehicles.values())
        give_up_s = self._start_s + 2.0 * longest_s + 2.0 * LOST_S
        release_s = give_up_s - longest_s  # enough to fly all of it
        shown_s = -math.inf
        log_trouble: str | None = None
        vehicles = list(self._vehicles.values())

        def sighting(i: int, now_s: float) -> Sighting | None:
            return None if vehicles[i].plan.sysid in self._grounded else vehicles[i].sighting(now_s)

        if pacer is not None:
            self._keeper = PaceKeeper(pacer, self._station, vehicles, sighting, self._log, tell)
        while True:
            self._station.exchange()
            now_s = self._clock.now_s()
            self._start_those_due(tell)
            self._look_for_gaps(now_s, tell)
            self._look_for_strays(now_s, tell)
            if self._log is not None and self._log.trouble != log_trouble and tell is not None:
                log_trouble = self._log.trouble
                tell(str(log_trouble))
            if helm is not None:
                self._steer(helm, tell)
            put_off_s = max((self._stood_s(k) for k in self._vehicles), default=0.0)
            if self._keeper is not None:
                self._keeper.muted = bool(self._orders or self._paused_s)
                if now_s > release_s + put_off_s and math.isfinite(release_s):
                    release_s = math.inf
                    self._keeper.stop_no_more()
                    standing = self._let_go(tell)
                    if standing and tell is not None:
                        tell(standing)
                self._keeper.step(now_s)
            ended = not (self._later or self._orders) and all(
                k in self._grounded or vehicle.ended or vehicle.lost(now_s) for k, vehicle in self._vehicles.items()
            )
            if progress is not None and (ended or now_s >= shown_s + _PROGRESS_S):
                shown_s = now_s
                advice = None if self._keeper is None else self._keeper.advice
                paces = [None] * len(vehicles) if advice is None else advice.paces
                progress([v.status(now_s, pace) for v, pace in zip(vehicles, paces, strict=True)])
            if ended or now_s > give_up_s + put_off_s:
                break
            self._clock.wait(WAIT_S)
        failures = [
            self._grounded.get(k) or v.failure(self._clock.now_s()) for k, v in self._vehicles.items() if not v.ended
        ]
        if failures:
            raise joined(failures)

    def _look_for_gaps(self, now_s: float, tell: Told | None) -> None:
        """Tell of flying vehicles that are not heard any more, and that are heard again."""
        for sysid, vehicle in self._vehicles.items():
            silent_s = vehicle.silent_s(now_s)
            if sysid in self._unheard:
                if silent_s <= UNHEARD_S:
                    self._unheard.remove(sysid)
                    self._say(f"{vehicle.plan.name}: heard again, {vehicle.where}", tell)
            elif silent_s > UNHEARD_S and vehicle.started and not vehicle.ended:
                self._unheard.add(sysid)
                self._say(f"{vehicle.plan.name}: not heard for {silent_s:.0f} s, {vehicle.where}; {NOT_KNOWN}", tell)

    def _look_for_strays(self, now_s: float, tell: Told | None) -> None:
        """Tell what vehicles warn of, and who does something else than its mission or our order."""
        for sysid, vehicle in self._vehicles.items():
            for text in vehicle.take_news():
                if tell is not None:  # in the log it is already
                    tell(f"{vehicle.plan.name}: {text}")
            if not vehicle.started or sysid in self._orders or vehicle.silent_s(now_s) > UNHEARD_S:
                continue
            follows = vehicle.in_mode("auto") if vehicle.order is None else vehicle.follows(vehicle.order)
            done = vehicle.recorder.landed or (vehicle.order is None and vehicle.recorder.reached_goal)
            strays = vehicle.recorder.fell(now_s) or (vehicle.armed and not follows and not done)
            if strays and not vehicle.strayed:
                self._say(f"{vehicle.plan.name} {vehicle.state}: not by an order given here", tell)
            vehicle.strayed = strays

    def _say(self, text: str, tell: Told | None) -> None:
        if self._log is not None:
            self._log.note(self._clock.now_s(), text)
        if tell is not None:
            tell(text)

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
            self._keeper.ground(self._rank(sysid))

    def _rank(self, sysid: int) -> int:
        """Return which of the plan's vehicles that is, as the pacer counts them."""
        return list(self._vehicles).index(sysid)

    def flight(self) -> FleetFlight:
        """Return what has been recorded so far."""
        flown = [vehicle.flown() for vehicle in self._vehicles.values()]
        keeper = self._keeper
        if keeper is None:
            return FleetFlight(tuple(flown), orders=tuple(self._ordered))
        watched = (replace(vehicle, lateness=keeper.lateness(i)) for i, vehicle in enumerate(flown))
        vehicles = list(self._vehicles.values())
        meetings = [
            FlownMeeting(m.name, {vehicles[i].plan.name: vehicles[i].reached_s(at) for i, at in m.waypoints.items()})
            for m in keeper.meetings
        ]
        return FleetFlight(tuple(watched), tuple(keeper.corrections), tuple(meetings), tuple(self._ordered))

    @property
    def now_s(self) -> float:
        """The link's clock."""
        return self._clock.now_s()

    @property
    def armed(self) -> list[str]:
        """The names of the vehicles that are armed, or were asked to be and have not been disarmed since."""
        return [vehicle.plan.name for vehicle in self._vehicles.values() if vehicle.armed or vehicle.asked_to_arm]

    @property
    def started(self) -> bool:
        """Whether the fleet's start has been commanded."""
        return self._start_s is not None

    @property
    def flying(self) -> list[str]:
        """The names of the vehicles that are armed, or were when they were last heard, and have not ended."""
        return [vehicle.plan.name for vehicle in self._vehicles.values() if vehicle.armed and not vehicle.ended]

    def standing(self) -> list[str]:
        """Return a sentence for every vehicle: what it does as far as is known, or that it does not answer."""
        now_s = self._clock.now_s()
        last = {ordered.vehicle: ordered for ordered in self._ordered}
        told: list[str] = []
        for sysid, vehicle in self._vehicles.items():
            name, ordered = vehicle.plan.name, last.get(vehicle.plan.name)
            words = f"{name} {vehicle.state}"
            if sysid in self._orders:
                words += f"; it was told to {self._giving}, and has not answered yet"
            elif ordered is not None and vehicle.armed and not vehicle.recorder.rebooted:
                follows = vehicle.follows(ordered.order)
                if ordered.result == "obeyed" and follows and ordered.order != "resume":
                    words = ordered.words
                elif ordered.result in ("refused", "silent") and not follows:
                    words += f" (it {ordered.words.removeprefix(name).strip()})"
            silent_s = vehicle.silent_s(now_s)
            late = f" when it was last heard, {silent_s:.0f} s ago: {NOT_KNOWN}"
            told.append(words if silent_s <= UNHEARD_S else words + late)
        return told

    def pump(self) -> None:
        """Listen for a moment, and be heard: a vehicle that misses its ground station may return."""
        self._station.step()

    def order(self, order: Order, names: Collection[str] = (), *, unproven: bool = False) -> tuple[Ordered, ...]:
        """Give an order to the named vehicles, to all where none is named, and return what came of it for each.

        Nobody's failure keeps the others from obeying. Who is still to start does not, once told to return or land.
        """
        self._give(Request(order, frozenset(names), unproven))
        self._station.together(self._orders)
        self._orders.clear()
        return self._given()

    def command(self, request: Request, *, within_s: float = _FIND_S) -> tuple[Ordered, ...]:
        """Give an order to a fleet that nobody watches: to all who are heard within some seconds, each by itself.

        Who is not heard is answered for as silent. Nobody is told anything who is not what the plan takes it for, nor
        to resume a mission that is not the plan's.

        Raises
        ------
        LinkError
            Nobody is heard at all.
        """
        wanted = {k: v for k, v in self._vehicles.items() if not request.vehicles or v.plan.name in request.vehicles}
        names = {sysid: f"{vehicle.plan.name} (sysid {sysid})" for sysid, vehicle in wanted.items()}
        try:
            self._station.wait_for(list(wanted), names, within_s)
        except LinkError:
            if all(vehicle.heartbeat is None for vehicle in wanted.values()):
                raise
        self._give(request, strangers=True)
        self._station.together(self._orders)
        self._orders.clear()
        return self._given()

    def _steer(self, helm: Helm, tell: Told | None) -> None:
        """Go on with the orders being given, and ask for others; what comes of them is told."""
        if self._orders:
            for sysid in list(self._orders):
                try:
                    next(self._orders[sysid])
                except StopIteration:
                    del self._orders[sysid]
            if not self._orders:
                outcomes = self._given()
                for outcome in outcomes:
                    self._say(outcome.words, tell)
                if any(outcome.order == "pause" and outcome.result == "obeyed" for outcome in outcomes):
                    self._say(NOT_PROVEN, tell)
                helm.answer(outcomes)
        elif (request := helm.request()) is not None:
            self._give(request)
            if not self._orders:
                helm.answer(())

    def _give(self, request: Request, *, strangers: bool = False) -> None:
        known = {vehicle.plan.name for vehicle in self._vehicles.values()}
        names = request.vehicles or known
        # a name that is nobody's is a slip: who else was meant is not known either
        wanted = {k: v for k, v in self._vehicles.items() if names <= known and v.plan.name in names}
        self._outcomes, self._giving = {}, request.order
        for sysid, vehicle in wanted.items():
            if self._keeper is not None:
                self._keeper.give_up(self._rank(sysid))
            if request.order != "resume":
                vehicle.warned_m = None
            self._orders[sysid] = self._obeying(vehicle, request, strangers)

    def _given(self) -> tuple[Ordered, ...]:
        outcomes = tuple(self._outcomes[k] for k in self._vehicles if k in self._outcomes)
        self._ordered += outcomes
        return outcomes

    def _obeying(self, vehicle: FleetVehicle, request: Request, stranger: bool) -> Steps:
        plan, order = vehicle.plan, request.order
        result: OrderResult
        try:
            met = (yield from self._meeting(vehicle, order)) if stranger else None
            result, words = met or (yield from self._telling(vehicle, request))
        except LinkError:
            vehicle.command = None
            result = "silent"
            words = f"was told to {order}, and does not answer: whether it obeys is not known; take over by hand"
        if result == "obeyed":
            vehicle.order = None if order == "resume" else order
        at_s = self._clock.now_s()
        if result in ("obeyed", "grounded"):
            if order == "pause":
                self._paused_s.setdefault(plan.sysid, at_s)
            else:
                self._put_off_s[plan.sysid] = self._stood_s(plan.sysid)
                self._paused_s.pop(plan.sysid, None)
        t_s = vehicle.recorder.t_s
        self._outcomes[plan.sysid] = Ordered(plan.name, order, t_s, result, f"{plan.name} {words}")

    def _stood_s(self, sysid: int) -> float:
        """Return for how long a vehicle has stood by order."""
        since_s = self._paused_s.get(sysid)
        return self._put_off_s.get(sysid, 0.0) + (0.0 if since_s is None else self._clock.now_s() - since_s)

    def _meeting(self, vehicle: FleetVehicle, order: Order) -> Waiting[tuple[OrderResult, str] | None]:
        """Find out whether a vehicle may be given an order; return why not, as the end of a sentence."""
        if vehicle.heartbeat is None:
            return "silent", f"is not heard, and was not told to {order}: take over by hand"
        try:
            yield from self._station.identifying(vehicle)
        except LinkError:  # it is heard: it may hear us, too
            vehicle.command = None
        try:
            vehicle.check_identity()
        except LinkError as error:
            reason = str(error).removeprefix(f"{vehicle.error('')}")
            return "refused", f"was not told to {order}: {reason}"
        if order == "resume":
            differs = yield from self._differing(vehicle)
            if differs:
                return "refused", f"is not resumed: {differs}"
        return None

    def _differing(self, vehicle: FleetVehicle) -> Waiting[str]:
        """Read the mission that a vehicle holds; return how it differs from its plan's, nothing if it does not."""
        held = yield from self._station.downloading(vehicle)
        wrong = vehicle.differing(vehicle.items, held)
        if wrong and not held:
            return "it holds no mission"
        more = f" (and {len(wrong) - 1} more)" if wrong[1:] else ""
        return f"it holds another mission than its plan's: {wrong[0]}{more}" if wrong else ""

    def _telling(self, vehicle: FleetVehicle, request: Request) -> Waiting[tuple[OrderResult, str]]:
        """Give one vehicle an order; return what came of it, as the end of a sentence that begins with its name."""
        order = request.order
        if not vehicle.armed and (vehicle.recorder.landed or vehicle.recorder.disarmed_up_m is not None):
            return "grounded" if vehicle.recorder.landed else "refused", vehicle.state
        waiting = yield from self._keeping_down(vehicle, order)
        if waiting is not None:
            return "grounded", waiting
        match order:
            case "pause":
                return (yield from self._pausing(vehicle))
            case "resume":
                return (yield from self._resuming(vehicle, request))
        if vehicle.in_mode("auto"):
            vehicle.left_item = vehicle.current_item
        refusal = yield from self._changing_mode(vehicle, order)
        if refusal:
            return "refused", f"was told to {order}, and {refusal}"
        if order == "rtl" or vehicle.modes["land"] == vehicle.modes["rtl"]:
            return "obeyed", "returns home" + (" (planes do not land where they are)" if order == "land" else "")
        return "obeyed", "lands where it is"

    def _keeping_down(self, vehicle: FleetVehicle, order: Order) -> Waiting[str | None]:
        """Keep a vehicle on the ground that has not flown yet; return how it stays there, None if it flies."""
        sysid = vehicle.plan.sysid
        later = self._later.pop(sysid, None)
        if vehicle.armed or (later is not None and vehicle.asked_to_arm):
            if later is None or order == "resume":
                if later is not None:
                    self._later[sysid] = later
                return None
            if not (yield from self._disarming(vehicle)):
                return None  # it has just left the ground
        if later is None:
            return "stays on the ground, disarmed"
        if order in ("pause", "resume"):
            later.close()
            vehicle.asked_to_arm = False
            self._later[sysid] = self._starting_later(vehicle)
            return "waits on the ground" + (": its start is put off" if order == "pause" else " for its start")
        self._ground(sysid, vehicle.error(f"was told to {order} before its start: it stays on the ground, disarmed"))
        return "stays on the ground, disarmed: its start is called off"

    def _pausing(self, vehicle: FleetVehicle) -> Waiting[tuple[OrderResult, str]]:
        """Stop a vehicle: an ArduCopter on its leg, in its mission; others where they come to stand or circle.

        The former is ArduCopter's ModeAuto::pause, since 4.2: along its leg; refused while it takes off or lands, and
        by some versions when it stands already.
        """
        if self._stops_in_mission(vehicle):
            if vehicle.paused:
                return "obeyed", f"stands on its way, {vehicle.where}"
            telling = self._commanding(vehicle, mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 0.0)
            result = yield from self._answered(vehicle, telling, lambda: vehicle.paused)
            if result == mavlink.MAV_RESULT_ACCEPTED:
                end_s = self._clock.now_s() + _STANDS_S
                while not vehicle.paused and vehicle.speed_m_s > STANDS_M_S:
                    if self._clock.now_s() >= end_s:
                        return "refused", "accepted to pause, and is not seen to stand"
                    yield
                return "obeyed", f"stands on its way, {vehicle.where}"
        if vehicle.in_mode("auto"):
            vehicle.left_item = yield from self._item_of(vehicle)
        refusal = yield from self._changing_mode(vehicle, "hold")
        if refusal:
            return "refused", f"was told to pause, and {refusal}"
        if vehicle.plan.vehicle_class == "plane":
            return "obeyed", f"circles, {vehicle.where}: its circle is not proven to be clear"
        end_s = self._clock.now_s() + _STANDS_S
        while vehicle.speed_m_s > STANDS_M_S and self._clock.now_s() < end_s:
            yield
        off_m = vehicle.off_way_m()
        if off_m > self._home_tolerance_m:
            return "obeyed", f"holds, {vehicle.where}, {off_m:.0f} m off its leg: not proven to be clear there"
        return "obeyed", f"holds on its way, {vehicle.where}"

    def _resuming(self, vehicle: FleetVehicle, request: Request) -> Waiting[tuple[OrderResult, str]]:
        """Let a vehicle go on to the item that it was flying to, at the speed that its mission has set for it.

        ArduPilot begins anew where MIS_RESTART says so, unless the item is set before; PX4 and ArduPilot both forget
        the speed when they leave the mission.
        """
        if vehicle.in_mode("auto"):
            if not self._stops_in_mission(vehicle):
                return "obeyed", f"flies its mission, {vehicle.where}"
            telling = self._commanding(vehicle, mavlink.MAV_CMD_DO_PAUSE_CONTINUE, 1.0)
            result = yield from self._answered(vehicle, telling, lambda: not vehicle.paused)
            end_s = self._clock.now_s() + _SEEN_S
            while vehicle.paused and self._clock.now_s() < end_s:
                yield
            if vehicle.paused:
                did = "accepted" if result == mavlink.MAV_RESULT_ACCEPTED else "refused"
                return "refused", f"was told to resume, {did}, and still stands{vehicle.said(self._clock.now_s())}"
            self._flies_on(vehicle)
            return "obeyed", f"goes on, {vehicle.where}"
        if vehicle.plan.name not in request.vehicles and not (vehicle.order == "pause" and vehicle.follows("pause")):
            return "refused", (
                f"is not resumed: it {vehicle.state}, and was not paused from here: that may be its failsafe's or its "
                f"pilot's doing; name it (--vehicle {vehicle.plan.name}) to resume it all the same"
            )
        item = vehicle.left_item
        if item is None:
            item = yield from self._item_of(vehicle)
        off_m = vehicle.off_way_m()
        if item is None:
            return "refused", "is not resumed: which item it was flying to is not known"
        position_m, warned_m = vehicle.recorder.position_m, vehicle.warned_m
        warned = position_m is not None and warned_m is not None and np.linalg.norm(position_m - warned_m) <= _WARNED_M
        if off_m > self._home_tolerance_m and not (warned or request.unproven):
            vehicle.warned_m = position_m
            return "refused", (
                f"is not resumed: it is {off_m:.0f} m off its leg to item {item}, the way there is not proven; "
                "resume again (command resume --unproven) to fly it all the same"
            )
        if not (yield from self._making_current(vehicle, item)):
            return "refused", f"is not resumed: it does not make item {item} its current one"
        refusal = yield from self._changing_mode(vehicle, "auto")
        if refusal:
            return "refused", f"was told to resume, and {refusal}"
        speed = vehicle.speed_item
        vehicle.current_item = None
        end_s = self._clock.now_s() + _SEEN_S
        while vehicle.current_item is None and self._clock.now_s() < end_s:
            yield
        begins_anew = vehicle.current_item is None or vehicle.current_item < item
        if begins_anew and not (yield from self._making_current(vehicle, item)):
            return "refused", f"flies its mission, {vehicle.where} instead of to item {item}: take over by hand"
        vehicle.left_item = vehicle.warned_m = None
        self._flies_on(vehicle)
        off = f", from {off_m:.0f} m off its leg: not proven" if off_m > self._home_tolerance_m else ""
        if speed is None:
            return "obeyed", f"goes on to item {item}{off}"
        params = (speed.param1, speed.param2, speed.param3)
        result = yield from self._commanding(vehicle, mavlink.MAV_CMD_DO_CHANGE_SPEED, *params)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            return "obeyed", f"goes on to item {item}{off}, but refused {speed.param2:.2f} m/s: its speed is another"
        if self._keeper is not None:
            self._keeper.as_planned(self._rank(vehicle.plan.sysid))
        return "obeyed", f"goes on to item {item} at {speed.param2:.2f} m/s{off}"

    def _item_of(self, vehicle: FleetVehicle) -> Waiting[int | None]:
        """Return the item that a vehicle flies to; one that has not said so is asked for it, and for its position."""
        if vehicle.current_item is None or vehicle.recorder.position_m is None:
            yield from self._asking_for_telemetry(vehicle)
            end_s = self._clock.now_s() + _SEEN_S
            while (vehicle.current_item is None or vehicle.recorder.position_m is None) and self._clock.now_s() < end_s:
                yield
        return vehicle.current_item

    def _asking_for_telemetry(self, vehicle: FleetVehicle) -> Steps:
        for number, interval_s in _MESSAGE_INTERVALS_S.items():
            # one that will not be set comes at the vehicle's own rate
            yield from self._station.commanding(vehicle, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, interval_s * 1e6)

    def _flies_on(self, vehicle: FleetVehicle) -> None:
        if self._keeper is not None:
            self._keeper.went_on(self._rank(vehicle.plan.sysid))

    @staticmethod
    def _stops_in_mission(vehicle: FleetVehicle) -> bool:
        return (vehicle.plan.autopilot, vehicle.plan.vehicle_class) == ("ardupilot", "copter") and vehicle.in_mode(
            "auto"
        )

    def _commanding(self, vehicle: FleetVehicle, number: int, *params: float) -> Waiting[int]:
        return (yield from self._station.commanding(vehicle, number, *params, patience_s=_ORDER_S))

    def _answered(
        self, vehicle: FleetVehicle, telling: Waiting[int | None], seen: Callable[[], bool]
    ) -> Waiting[int | None]:
        """Return what a vehicle answers to a command; if only the answer was lost, as is seen, that it accepts."""
        try:
            return (yield from telling)
        except LinkError:
            if vehicle.silent_s(self._clock.now_s()) > _SEEN_S or not seen():
                raise
            vehicle.command = None
            return int(mavlink.MAV_RESULT_ACCEPTED)

    def _changing_mode(self, vehicle: FleetVehicle, mode: Mode) -> Waiting[str]:
        """Switch a vehicle to a mode and see it there; return what it did instead, nothing if it did."""
        telling = self._mode_result(vehicle, vehicle.modes[mode], _ORDER_S)
        result = yield from self._answered(vehicle, telling, lambda: vehicle.in_mode(mode))
        if result is None:
            return f"accepted, but is in mode {vehicle.custom_mode}{vehicle.said(self._clock.now_s())}"
        return "" if result == mavlink.MAV_RESULT_ACCEPTED else f"refused{vehicle.said(self._clock.now_s())}"

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
        yield from self._asking_for_telemetry(vehicle)
        end_s = self._clock.now_s() + timeout_s
        told = ""
        while missing := "; ".join(vehicle.lacks(self._clock.now_s())):
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

    def _confirming(self, vehicle: FleetVehicle) -> Steps:
        """See that a vehicle is not armed, and holds its mission still."""
        differs = yield from self._differing(vehicle)
        if differs:
            raise vehicle.error(f"{differs}; somebody has changed it since it was sent: upload again")
        if vehicle.armed:
            raise vehicle.error("is armed already, not from here: find out by whom, and disarm it")

    def _rewinding(self, vehicle: FleetVehicle) -> Steps:
        """Set the first item as the current one: the vehicle may have flown this mission before."""
        first = 1 if vehicle.plan.autopilot == "ardupilot" else 0
        if not (yield from self._making_current(vehicle, first, or_before=True)):
            raise vehicle.error(f"expected to begin its mission at item {first}, it stands at {vehicle.current_item}")

    def _making_current(self, vehicle: FleetVehicle, item: int, *, or_before: bool = False) -> Waiting[bool]:
        """Set a mission's current item; return whether the vehicle then says that it is (or a still earlier one)."""
        message = mavlink.MAVLink_mission_set_current_message(vehicle.plan.sysid, 1, item)
        vehicle.current_item = None
        end_s = self._clock.now_s() + ANSWER_S
        due_s = -math.inf
        while vehicle.current_item != item and not (
            or_before and vehicle.current_item is not None and vehicle.current_item < item
        ):
            now_s = self._clock.now_s()
            if now_s >= end_s:
                return False
            if now_s >= due_s:
                due_s = now_s + 1.0
                self._station.send(vehicle, [message])
            yield
        return True

    def _into_mode(self, vehicle: FleetVehicle, mode: int, name: str) -> Steps:
        result = yield from self._mode_result(vehicle, mode, ANSWER_S)
        if result != mavlink.MAV_RESULT_ACCEPTED:
            did = "accepted, and did not" if result is None else "refused to"
            raise vehicle.error(f"{did} switch to {name} (mode {mode}){vehicle.said(self._clock.now_s())}")

    def _mode_result(self, vehicle: FleetVehicle, mode: int, patience_s: float) -> Waiting[int | None]:
        main, sub = (mode, 0) if vehicle.plan.autopilot == "ardupilot" else (mode >> 16 & 0xFF, mode >> 24)
        params = (mavlink.MAV_CMD_DO_SET_MODE, _CUSTOM_MODE, main, sub)

        def shown() -> bool:
            return vehicle.custom_mode == mode

        return (yield from self._station.commanding_until(vehicle, shown, *params, patience_s=patience_s))

    def _arming(self, vehicle: FleetVehicle) -> Steps:
        vehicle.asked_to_arm = True
        command = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        result = yield from self._station.commanding_until(
            vehicle, lambda: vehicle.armed, command, 1.0, patience_s=_ARM_S
        )
        if result != mavlink.MAV_RESULT_ACCEPTED:
            did = "accepted, and did not" if result is None else "refused to"
            raise vehicle.error(f"{did} arm{vehicle.said(self._clock.now_s())}")

    def _starting(self, vehicle: FleetVehicle) -> Steps:
        try:
            yield from self._seeing_start(vehicle)
        finally:  # it may fly: where it comes back from another place, it must be heard, and obey
            self._station.link.unpin(vehicle.plan.sysid)

    def _seeing_start(self, vehicle: FleetVehicle) -> Steps:
        result = yield from self._station.commanding(
            vehicle,
            mavlink.MAV_CMD_MISSION_START,
            retry_s=_START_RETRY_S,  # a range of items is refused by ArduPilot
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
        vehicle.started, vehicle.asked_to_arm = True, False

    def _wait_until(self, at_s: float | None) -> None:
        """Hear all vehicles until it is time."""
        while at_s is not None and (left_s := at_s - self._clock.now_s()) > 0.0:
            self._station.exchange()
            self._clock.wait(min(WAIT_S, left_s))

    def _starting_later(self, vehicle: FleetVehicle) -> Steps:
        assert self._start_s is not None
        due_s = self._start_s + vehicle.plan.start_delay_s

        def waits(before_s: float) -> bool:
            sysid = vehicle.plan.sysid
            return sysid in self._paused_s or self._clock.now_s() < due_s + self._stood_s(sysid) - before_s

        while waits(_LOOK_AGAIN_S):
            yield
        try:
            yield from self._confirming(vehicle)
        except LinkError as failure:
            self._ground(vehicle.plan.sysid, failure)
            raise LinkError(f"{failure}; it was not started") from failure
        while waits(_ARM_EARLY_S):
            yield
        at_s = due_s + self._stood_s(vehicle.plan.sysid)
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
                vehicle.started, vehicle.asked_to_arm = True, False
                raise LinkError(f"{failure}; it has left the ground and is watched") from failure
            self._ground(vehicle.plan.sysid, failure)
            raise LinkError(f"{failure}; it is disarmed on the ground") from failure

    def _disarming(self, vehicle: FleetVehicle) -> Waiting[bool]:
        """Disarm a vehicle that is on the ground; return whether it was: nobody disarms in the air."""
        disarm = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
        result = yield from self._station.commanding_until(
            vehicle, lambda: not vehicle.armed, disarm, 0.0, patience_s=_DISARM_S
        )
        vehicle.asked_to_arm &= result != mavlink.MAV_RESULT_ACCEPTED
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
        self._station.settle(_HEARTBEAT_S)  # who has just been armed or started says so; what is under way has arrived
        asked = {k: v for k, v in self._vehicles.items() if v.armed or v.asked_to_arm}
        now_s = self._clock.now_s()
        ends: dict[int, str] = {}  # how each one ends that is not on the ground

        def ending(sysid: int, vehicle: FleetVehicle) -> Steps:
            ends[sysid] = "silent"
            try:
                if (yield from self._disarming(vehicle)):
                    del ends[sysid]
                    self._ground(sysid, vehicle.error("its start was called off"))
                    return
                vehicle.started, vehicle.asked_to_arm = True, False  # it has left the ground
                refusal = yield from self._changing_mode(vehicle, "land")
            except LinkError:
                vehicle.command = None
                return
            vehicle.order = None if refusal else "land"
            ends[sysid] = refusal or ("rtl" if vehicle.modes["land"] == vehicle.modes["rtl"] else "land")

        self._station.together({sysid: ending(sysid, vehicle) for sysid, vehicle in asked.items()})
        ends |= {k: "silent" for k, v in self._vehicles.items() if k not in asked and v.silent_s(now_s) > UNHEARD_S}
        names: dict[str, list[str]] = {}
        for sysid, vehicle in self._vehicles.items():
            if sysid in ends:
                names.setdefault(ends[sysid], []).append(vehicle.plan.name)
        says = {
            "silent": "did not answer and may be flying: take over by hand",
            "land": "told to land",
            "rtl": "told to return (planes do not land where they are), and circles above home",
        }
        told = [
            f"{', '.join(who)} {says.get(end, f'told to land, and {end}: take over by hand')}"
            for end, who in names.items()
        ]
        if len(ends) < len(self._vehicles):
            told.append(f"{'the others' if told else 'all vehicles'} are disarmed on the ground")
        return f"the start was called off: {'; '.join(told)}"
