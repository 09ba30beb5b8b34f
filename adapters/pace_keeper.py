"""A pacer's eyes and hands: sightings from telemetry, speeds by command, a word in the log for each of them.

What autopilots do with a DO_CHANGE_SPEED by command, in their sources: ArduCopter 4.5 flies the present leg at the new
speed at once, until an item of its mission changes it (AC_WPNav::set_speed_xy); PX4 1.15 as well
(FlightModeManager::handleCommand, for ground speeds only), and keeps it for the legs to come; ArduPlane takes airspeeds
within its limits (Plane::do_change_speed), and refuses others. All of them forget it when they enter the mission anew:
ArduPilot flies at its parameters' speed then, PX4 at that of the mission's last item.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.ground_station import Peer, Station, Steps
from adapters.telemetry_log import FleetLog
from missionplanner.errors import LinkError
from missionplanner.pacing import Advice, Meeting, Pacer, Sighting, Trim
from missionplanner.plan import Correction, Lateness

Told = Callable[[str], None]
"""Called with a line for the operator: a speed that was commanded, or what stands against one."""

_SIGHT_S = 0.4
_PATIENCE_S = 4.0  # for an answer: then the flight has gone on, and another speed would be right
_THROTTLE_UNCHANGED = -1.0
_RECORD_S = 10.0
_THINK_AGAIN_S = 1.0


class PaceKeeper:
    """Keeps a fleet's pace while it is watched: :meth:`step` is called whenever the link was listened to.

    ``sight(i, now_s)`` returns what is known of vehicle i, in the order of the pacer's courses.
    """

    def __init__(
        self,
        pacer: Pacer,
        station: Station[Any],
        peers: Sequence[Peer],
        sight: Callable[[int, float], Sighting | None],
        log: FleetLog | None = None,
        tell: Told | None = None,
    ) -> None:
        self.advice: Advice | None = None
        self.corrections: list[Correction] = []
        self.muted = False  # while an operator has a say, nothing is commanded
        self._pacer = pacer
        self._station = station
        self._peers = peers
        self._sight = sight
        self._log = log
        self._tell = tell
        self._thinking: Generator[None, None, Advice] | None = None
        self._commands: dict[int, Steps] = {}
        self._sight_due_s = self._think_due_s = self._thought_s = -math.inf
        self._remarks: tuple[str, ...] = ()
        self._history: list[list[tuple[float, float, float]]] = [[] for _ in peers]

    @property
    def stopped(self) -> frozenset[int]:
        """The vehicles that wait for a command to go on, or may: they did not answer."""
        return self._pacer.stopped

    @property
    def meetings(self) -> tuple[Meeting, ...]:
        """Who is to meet where."""
        return self._pacer.meetings

    def went_on(self, i: int) -> None:
        """Take note that vehicle i was let go on by somebody else."""
        self._pacer.went_on(i)

    def as_planned(self, i: int) -> None:
        """Take note that vehicle i was told its planned speed by somebody else."""
        self._pacer.as_planned(i)

    def give_up(self, i: int) -> None:
        """Leave vehicle i to somebody else's orders: command it nothing more now, nor that it goes on later."""
        if self._commands.pop(i, None) is not None:
            self._peers[i].command = None
        self._pacer.went_on(i)

    def stop_no_more(self) -> None:
        """Command no stops from now on."""
        self._pacer.hold = False

    def ground(self, i: int) -> None:
        """Take note that vehicle i will not start any more."""
        self._pacer.ground(i)

    def step(self, now_s: float) -> None:
        """Take in what is known, think when it is time, and go on with what is being commanded."""
        if now_s >= self._sight_due_s:
            self._sight_due_s = now_s + _SIGHT_S
            for i in range(len(self._peers)):
                sighting = self._sight(i, now_s)
                if sighting is not None:
                    self._pacer.saw(i, sighting)
        for i in list(self._commands):
            try:
                next(self._commands[i])
            except StopIteration:
                del self._commands[i]
        due = now_s >= self._think_due_s or (self._pacer.has_stood and now_s >= self._thought_s + _THINK_AGAIN_S)
        if self._thinking is None and not self._commands and due:
            self._thought_s = now_s
            self._think_due_s = now_s + self._pacer.rules.period_s
            self._thinking = self._pacer.deliberate()
        if self._thinking is not None:
            try:
                next(self._thinking)
            except StopIteration as done:
                self._thinking = None
                self._follow(done.value, now_s)

    def lateness(self, i: int) -> Lateness | None:
        """Return what was found of vehicle i while it flew; None: nothing."""
        if not self._history[i]:
            return None
        t_s, late_s, arrival_s = np.array(self._history[i]).T
        return Lateness(t_s, late_s, arrival_s)

    def _follow(self, advice: Advice, now_s: float) -> None:
        self.advice = advice
        for pace, history in zip(advice.paces, self._history, strict=True):
            if pace.at_s is None or pace.lateness_s is None or pace.arrival_s is None:
                continue
            if pace.state == "arrived" or (history and pace.at_s < history[-1][0] + _RECORD_S):
                continue
            history.append((pace.at_s, pace.lateness_s, pace.arrival_s))
        for remark in advice.remarks:
            if remark not in self._remarks:
                self._say(remark, now_s)
        self._remarks = advice.remarks
        for trim in () if self.muted else advice.trims:
            self._commands[trim.vehicle] = self._commanding(trim)

    def _commanding(self, trim: Trim) -> Steps:
        peer = self._peers[trim.vehicle]
        plane = peer.vehicle_class == "plane"
        command: tuple[float, ...] = (
            mavlink.MAV_CMD_DO_CHANGE_SPEED,
            mavlink.SPEED_TYPE_AIRSPEED if plane else mavlink.SPEED_TYPE_GROUNDSPEED,
            trim.to_m_s,
            _THROTTLE_UNCHANGED,
        )
        goes_on = trim.from_m_s == 0.0
        if goes_on or trim.to_m_s == 0.0:
            command = (mavlink.MAV_CMD_DO_PAUSE_CONTINUE, float(goes_on))
        number, *params = command
        try:
            result = yield from self._station.commanding(peer, int(number), *map(float, params), patience_s=_PATIENCE_S)
        except LinkError:
            peer.command = None
            result = None
        now_s = self._station.clock.now_s()
        sighting = self._sight(trim.vehicle, now_s)
        t_s = now_s if sighting is None else sighting.t_s
        obeyed = result == mavlink.MAV_RESULT_ACCEPTED
        self.corrections.append(Correction(trim.name, t_s, trim.from_m_s, trim.to_m_s, trim.why, obeyed))
        what = f"{trim.from_m_s:.2f} to {trim.to_m_s:.2f} m/s"
        if trim.to_m_s == 0.0:
            what = f"stops for about {trim.stop_s:.0f} s"
        elif goes_on:
            what = f"goes on at {trim.to_m_s:.2f} m/s"
        order = f"{trim.name}: {what} at {t_s:.0f} s, {trim.why}"
        if obeyed:
            self._pacer.obeyed(trim, t_s)
            self._say(order, now_s)
            return
        answer = "it did not answer" if result is None else f"it refused (MAV_RESULT {result})"
        left = self._pacer.refused(trim, t_s, answered=result is not None)
        alone = "; it is left at its speed from now on" if left else ""
        if result is None and trim.to_m_s == 0.0:
            alone = "; it may stand, and is told to go on in time"
        if goes_on:
            alone = "; it stands, and is asked again: be ready to take over"
        self._say(f"{order}: {answer}{alone}", now_s)

    def _say(self, text: str, now_s: float) -> None:
        if self._log is not None:
            self._log.note(now_s, text)
        if self._tell is not None:
            self._tell(text)
