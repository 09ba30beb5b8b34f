"""One vehicle's flight logic: modes, arming, mission execution. No MAVLink frames, no sockets, no wall clock.

The vehicle's motion is :class:`missionplanner.motion.Navigator`'s; here is only what it is told to do. Whatever the
autopilot flies is a queue of stages (climb, legs, wait, descend); AUTO fills it from the mission, other modes at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, MutableMapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, IntEnum, auto
from itertools import pairwise

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem, wire_to_degrees
from missionplanner.autopilot_parameters import changed, with_values
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.motion import Navigator, Route, landing_points, return_points, takeoff_points
from missionplanner.vehicle import MotionModel
from sim.personality import NAV_COMMANDS, Behaviour, Mode, Personality

Ground = Callable[[float, float], float]
"""Ground altitude AMSL in metres at (x_m, y_m)."""

_RETURN_LEGS = 2  # points of a return before its descent: up, and home
_JUMP_MAX = 100  # a mission of nothing but jumps must not hang the vehicle
_AUTO_OPTION_TAKEOFF_WITHOUT_THROTTLE = 1 << 1
_AUTO_OPTION_ARMING = 1 << 0


class MissionState(IntEnum):
    """MISSION_STATE of MISSION_CURRENT."""

    NO_MISSION = mavlink.MISSION_STATE_NO_MISSION
    NOT_STARTED = mavlink.MISSION_STATE_NOT_STARTED
    ACTIVE = mavlink.MISSION_STATE_ACTIVE
    PAUSED = mavlink.MISSION_STATE_PAUSED
    COMPLETE = mavlink.MISSION_STATE_COMPLETE


class LandedState(IntEnum):
    """MAV_LANDED_STATE of EXTENDED_SYS_STATE."""

    ON_GROUND = mavlink.MAV_LANDED_STATE_ON_GROUND
    IN_AIR = mavlink.MAV_LANDED_STATE_IN_AIR
    TAKEOFF = mavlink.MAV_LANDED_STATE_TAKEOFF
    LANDING = mavlink.MAV_LANDED_STATE_LANDING


class _Doing(Enum):
    CLIMB = auto()
    LEGS = auto()
    WAIT = auto()


@dataclass(frozen=True, slots=True, eq=False)
class _Stage:
    """Something flown without a decision: a route (None: stay), then ``wait_s`` (infinite: for ever).

    ``seqs`` names the mission item completed at each point of the route (-1: none), ``done_seq`` the one after the
    wait. ``lands_from`` is the first point of a descent to the ground, at whose end the vehicle has landed.
    """

    doing: _Doing
    route: Route | None = None
    seqs: tuple[int, ...] = ()
    wait_s: float = 0.0
    done_seq: int = -1
    lands_from: int | None = None


@dataclass(frozen=True, slots=True)
class Said:
    """A STATUSTEXT."""

    severity: int
    text: str


@dataclass(frozen=True, slots=True)
class Completed:
    """A MISSION_ITEM_REACHED."""

    seq: int


@dataclass(frozen=True, slots=True)
class Photographed:
    """A photo that was taken, the how manieth since power-up."""

    number: int  # from 1


class _Camera:
    """What a mission makes of the camera: it has no effect on the flight.

    Photos every so many metres over ground since the last one (:meth:`trigger`), so many at an interval, or one.
    """

    def __init__(self) -> None:
        self.taken = 0
        self.off = False  # while PX4 is not in its mission
        self._every_m = 0.0
        self._last_m: FloatArray | None = None
        self._at_once = 0
        self._left = 0.0
        self._interval_s = 0.0
        self._next_s = math.inf

    def trigger(self, every_m: float) -> None:
        """Take a photo every so many metres; 0: no more."""
        self._every_m = _not_negative(every_m)

    def start(self, count: float, interval_s: float, now_s: float) -> None:
        """Take so many photos (0: until stopped), the first at once; of one alone, what goes on is not disturbed."""
        if count == 1.0 or (count < 1.0 and not interval_s > 0.0):
            self._at_once += 1
            return
        self._interval_s = _not_negative(interval_s)
        self._left = count if count >= 1.0 else math.inf
        self._next_s = now_s

    def stop(self) -> None:
        """Take no more photos at an interval."""
        self._next_s = math.inf

    @property
    def wake_s(self) -> float:
        """When :meth:`due` is to be asked."""
        if self.off:
            return math.inf
        return -math.inf if self._every_m > 0.0 or self._at_once > 0 else self._next_s

    def due(self, position_m: FloatArray, now_s: float) -> bool:
        """Whether a photo is taken now; then it counts as taken."""
        far = self._last_m is None or math.dist(position_m[:2], self._last_m[:2]) >= self._every_m
        timed = now_s >= self._next_s
        if self._at_once > 0:
            self._at_once -= 1
        elif not timed and not (self._every_m > 0.0 and far):
            return False
        elif timed:
            self._left -= 1.0
            self._next_s = self._next_s + self._interval_s if self._left >= 1.0 else math.inf
        self.taken += 1
        self._last_m = position_m
        return True


class Autopilot:
    """The flight logic of vehicle ``index`` of ``navigator``.

    Commands return a MAV_RESULT. What is to be told to ground stations collects in ``events``.
    """

    def __init__(
        self,
        personality: Personality,
        *,
        motion: MotionModel,
        navigator: Navigator,
        index: int,
        frame: LocalFrame,
        ground: Ground,
        parameters: MutableMapping[str, int | float],
        cold_start: bool = False,
        late_s: float = 0.0,
    ) -> None:
        self.personality = personality
        self.parameters = parameters
        self.mode: Mode = personality.mode(personality.boot_mode)
        self.armed = False
        self.landed = True
        self.paused = False
        self.home_m: FloatArray = np.array(navigator.position_m[index])
        self.mission: Sequence[MissionItem] = ()
        self.current = 0
        self.mission_state = MissionState.NO_MISSION
        self._airborne_s = 0.0
        self.events: list[Said | Completed | Photographed] = []
        self._camera = _Camera()
        self.ready_s = personality.cold_start_s if cold_start else 0.0
        self._motion = motion
        self._taken_up = dict(parameters)
        self._navigator = navigator
        self._index = index
        self._frame = frame
        self._ground = ground
        self._auto_armed = False  # ArduCopter: whether a take-off in AUTO may begin
        self._speed_m_s = self.default_speed_m_s
        self._climb_m_s = math.inf
        self._descent_m_s = math.inf
        self._jumps: dict[int, int] = {}
        self._queue: deque[_Stage] = deque()
        self._stage: _Stage | None = None
        self._passed = 0
        self._wait_until_s = math.inf
        self._idle_since_s = 0.0
        self._flown_before_s = 0.0  # it was armed
        self._airborne_since_s = math.inf
        self._late_s = late_s  # on the ground before its first take-off of a mission, for whatever reason

    # -- state ------------------------------------------------------------------------------------------------------

    @property
    def position_m(self) -> FloatArray:
        """Position (3,) in the local frame."""
        return np.array(self._navigator.position_m[self._index])

    @property
    def default_speed_m_s(self) -> float:
        """Horizontal speed that missions begin with: the autopilot's parameter."""
        name, unit = self.personality.speed_parameter
        return float(self.parameters[name]) * unit

    @property
    def speed_m_s(self) -> float:
        """Commanded horizontal speed."""
        return self._speed_m_s

    @property
    def landed_state(self) -> LandedState:
        """On the ground, taking off, in the air or landing."""
        if self.landed:
            return LandedState.ON_GROUND
        stage = self._stage
        if stage is not None and stage.doing is _Doing.CLIMB:
            return LandedState.TAKEOFF
        if stage is not None and stage.lands_from is not None and self._passed >= stage.lands_from:
            return LandedState.LANDING
        return LandedState.IN_AIR

    @property
    def flying_mission(self) -> bool:
        """Whether the mode is the one that executes the mission."""
        return self.mode.behaviour is Behaviour.AUTO

    def flown_s(self, now_s: float) -> float:
        """Return the time spent in the air so far."""
        return self._airborne_s + (now_s - self._airborne_since_s if math.isfinite(self._airborne_since_s) else 0.0)

    @property
    def wake_s(self) -> float:
        """When :meth:`update` is due even if the vehicle has reached nothing."""
        camera_s = self._camera.wake_s if self.armed and not self.landed else math.inf
        return min(self._wait_until_s, self._disarm_at_s, camera_s)

    @property
    def target_m(self) -> FloatArray | None:
        """The point flown to, if any."""
        if self._stage is None or self._stage.route is None:
            return None
        points = self._stage.route.points_m
        return np.array(points[min(self._passed, len(points) - 1)])

    @property
    def _disarm_at_s(self) -> float:
        if not self.armed or not self.landed or self._stage is not None:
            return math.inf
        has_flown = self._airborne_s > self._flown_before_s and self.mission_state is not MissionState.ACTIVE
        return self._idle_since_s + (self.personality.landed_disarm_s if has_flown else self._idle_disarm_s)

    @property
    def _idle_disarm_s(self) -> float:
        name = self.personality.idle_disarm_parameter
        return float(self.parameters[name]) if name is not None else math.inf

    # -- commands ---------------------------------------------------------------------------------------------------

    def arm(self, now_s: float, *, force: bool = False) -> int:
        """Arm where the autopilot allows it: ready, and in a mode that one may arm in."""
        if self.armed:
            return int(mavlink.MAV_RESULT_ACCEPTED)
        if now_s < self.ready_s and not force:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, self.personality.not_ready_text)
            return self.personality.refusal
        may_arm_in_auto = int(self.parameters.get("AUTO_OPTIONS", 0)) & _AUTO_OPTION_ARMING and self.flying_mission
        if not self.mode.armable and not may_arm_in_auto:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, f"Arm: {self.mode.name} mode not armable")
            return self.personality.refusal
        self.armed = True
        self._idle_since_s = now_s
        self._flown_before_s = self._airborne_s
        self._say(mavlink.MAV_SEVERITY_INFO, self.personality.armed_text)
        if self.mode.behaviour is not Behaviour.HOLD:
            self._enter(self.mode, now_s)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def disarm(self, now_s: float, *, force: bool = False) -> int:
        """Disarm on the ground, or anywhere by force (and fall)."""
        if not self.landed and not force:
            return self.personality.refusal
        if self.armed:
            if not self.landed:
                self._fall(now_s)
            self.armed = False
            self._auto_armed = False
            self._drop_stages()
            self._say(mavlink.MAV_SEVERITY_INFO, self.personality.disarmed_text)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def set_mode(self, mode: Mode, now_s: float) -> int:
        """Change the flight mode; AUTO needs a mission that may be begun."""
        if mode.behaviour is Behaviour.AUTO and not self._mission_may_start():
            return self.personality.refusal
        self.mode = mode
        self._enter(mode, now_s)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def start_mission(self, now_s: float, first: int | None = None) -> int:
        """Obey MISSION_START from item ``first`` (None: the current one).

        ArduPilot accepts it while disarmed, and then nothing happens; PX4 arms.
        """
        if not self._mission_may_start():
            return self.personality.refusal
        if self.personality.start_arms and not self.armed:
            result = self.arm(now_s)
            if result != mavlink.MAV_RESULT_ACCEPTED:
                return result
        if first is not None and first != self.current:
            self.set_current(first, now_s)
        self._auto_armed = self.armed
        if not (self.flying_mission and self._stage is not None):
            self.mode = self.personality.mode_for(Behaviour.AUTO)
            self._enter(self.mode, now_s)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def takeoff(self, alt_amsl_m: float | None, now_s: float) -> int:
        """Take off to an altitude (None: the autopilot's own height) and hold there."""
        if not self.armed and self.personality.takeoff_needs_flight_mode:
            return self.personality.refusal
        if self.personality.takeoff_needs_flight_mode and self.mode.behaviour is not Behaviour.GUIDED:
            return self.personality.refusal
        if not self.landed:
            return self.personality.refusal
        if not self.personality.takeoff_needs_flight_mode:
            self.mode = self.personality.mode_for(Behaviour.TAKEOFF)
            if not self.armed:  # begins when armed
                return int(mavlink.MAV_RESULT_ACCEPTED)
        self._drop_stages()
        self._climb_to(alt_amsl_m, now_s)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def go_to(self, position_m: FloatArray, now_s: float, speed_m_s: float | None = None) -> int:
        """Fly straight to a point and stay there (GUIDED, DO_REPOSITION)."""
        if not self.armed or self.landed:
            return self.personality.refusal
        if self.mode.behaviour is not Behaviour.GUIDED:
            guided = Behaviour.GUIDED if self.personality.takeoff_needs_flight_mode else Behaviour.HOLD
            self.mode = self.personality.mode_for(guided)
        if speed_m_s is not None and speed_m_s > 0.0:
            self._speed_m_s = speed_m_s
        self._leave_mission()
        self._fly([_Stage(_Doing.LEGS, self._leg(position_m), (-1,))], now_s)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def pause(self, now_s: float) -> int:
        """Stop where it is and remember what was being flown."""
        del now_s
        self.paused = True
        self._navigator.halt(self._index)
        if self.mission_state is MissionState.ACTIVE:
            self.mission_state = MissionState.PAUSED
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def unpause(self, now_s: float) -> int:
        """Go on after a pause."""
        del now_s
        if self.paused:
            self.paused = False
            self._navigator.resume(self._index)
            if self.mission_state is MissionState.PAUSED:
                self.mission_state = MissionState.ACTIVE
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def change_speed(self, kind: float, speed_m_s: float) -> int:
        """Obey DO_CHANGE_SPEED at once, for the leg being flown too, until an item of the mission changes it again.

        ArduPilot does so in the modes that fly somewhere only, and tells of a speed that it does not take.
        """
        if self.personality.autopilot == "ardupilot":
            takes = self.mode.behaviour in (Behaviour.AUTO, Behaviour.GUIDED)
            horizontal = kind in (mavlink.SPEED_TYPE_AIRSPEED, mavlink.SPEED_TYPE_GROUNDSPEED)
            if not takes or speed_m_s <= 0.0 or (horizontal and not self._may_fly_at(speed_m_s)):
                return int(mavlink.MAV_RESULT_FAILED)
        before = self._speed_m_s
        self._note_speed(kind, speed_m_s)
        if self._speed_m_s != before and self._stage is not None and self._stage.doing is _Doing.LEGS:
            self._navigator.set_speed(self._index, self._speed_m_s, self._legs_to_next_speed(self._stage))
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _legs_to_next_speed(self, stage: _Stage) -> int:
        """Return how many legs of a stage, the present one first, are flown before its mission sets a speed."""
        seqs = stage.seqs[self._passed :]
        for legs, (seq, after) in enumerate(pairwise(seqs), start=1):
            if any(item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED for item in self.mission[seq + 1 : after]):
                return legs
        return len(seqs)

    def set_home(self, position_m: FloatArray) -> int:
        """Move home."""
        self.home_m = np.array(position_m, dtype=float)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def reboot(self, now_s: float) -> None:
        """Begin anew from where it is: disarmed (in the air it falls), in its first mode, not ready for a while."""
        self.disarm(now_s, force=True)
        self._drop_stages()
        self.events.clear()
        self.mode = self.personality.mode(self.personality.boot_mode)
        self.ready_s = now_s + self.personality.cold_start_s
        self.home_m = self.position_m
        self.current = 0
        self._jumps.clear()
        self._camera = _Camera()
        has_mission = len(self.mission) > self._first
        self.mission_state = MissionState.NOT_STARTED if has_mission else MissionState.NO_MISSION
        self._speed_m_s, self._climb_m_s, self._descent_m_s = self.default_speed_m_s, math.inf, math.inf

    def set_mission(self, items: Sequence[MissionItem], current: int | None, now_s: float) -> None:
        """Take note of a new or changed mission; one that is being flown goes on at the same item."""
        ahead_changed = list(items[self.current :]) != list(self.mission[self.current :])
        self.mission = items
        self._jumps.clear()
        if len(items) <= self._first:
            self.mission_state = MissionState.NO_MISSION
            self.current = 0
            if self.flying_mission:
                self._hold()
            return
        if current is not None:
            self.current = current
        if self.mission_state in (MissionState.NO_MISSION, MissionState.COMPLETE):
            self.mission_state = MissionState.NOT_STARTED
            self.current = current or 0
        self.current = min(self.current, len(items) - 1)
        if self.mission_state is MissionState.ACTIVE and self._stage is not None and ahead_changed:
            self._begin_mission(now_s)

    def set_current(self, seq: int, now_s: float) -> bool:
        """Make ``seq`` the next item; False where there is none."""
        if not 0 <= seq < len(self.mission):
            return False
        self.current = seq
        if self.mission_state is MissionState.COMPLETE:
            self.mission_state = MissionState.NOT_STARTED
        if self.flying_mission and self.armed and self._stage is not None:
            self._begin_mission(now_s)
        return True

    # -- time -------------------------------------------------------------------------------------------------------

    def update(self, now_s: float) -> None:
        """Take note of what the vehicle has reached by ``now_s`` and of what is due."""
        stage = self._stage
        if stage is not None and not self.paused:
            self._note_progress(stage, now_s)
        flies = self.armed and not self.landed
        while flies and now_s >= self._camera.wake_s and self._camera.due(self.position_m, now_s):
            self.events.append(Photographed(self._camera.taken))
        if now_s >= self._disarm_at_s:
            self.disarm(now_s)

    def _note_progress(self, stage: _Stage, now_s: float) -> None:
        if stage.route is not None:
            waypoint = int(self._navigator.waypoint[self._index])
            while self._passed < min(waypoint, len(stage.seqs)) and self._stage is stage:
                seq = stage.seqs[self._passed]
                self._passed += 1
                if seq >= 0:
                    self._complete(seq, now_s)
            if self._stage is not stage or not self._navigator.finished[self._index]:
                return
        if math.isinf(self._wait_until_s) and not math.isinf(stage.wait_s):
            self._wait_until_s = now_s + stage.wait_s
            if stage.lands_from is not None:
                self._touch_down(now_s)
        if now_s >= self._wait_until_s:
            self._wait_until_s = math.inf
            self._stage = None
            self._idle_since_s = now_s
            if stage.done_seq >= 0:
                self._complete(stage.done_seq, now_s)
            if self._stage is None:
                self._next_stage(now_s)

    def _touch_down(self, now_s: float) -> None:
        self.landed = True
        if self.personality.vehicle_class == "plane":
            self._navigator.rest(self._index)
        self._airborne_s += now_s - self._airborne_since_s
        self._airborne_since_s = math.inf
        self._idle_since_s = now_s

    def _fall(self, now_s: float) -> None:
        x, y, _ = self.position_m
        ground_amsl_m = self._ground(float(x), float(y))
        if self.personality.vehicle_class == "plane":  # which nobody sees falling
            self._navigator.position_m[self._index, 2] = ground_amsl_m
        else:
            self._navigator.follow(self._index, *Route.through([[x, y, ground_amsl_m]], 1.0, vertical_m_s=20.0))
        self._touch_down(now_s)
        self._say(mavlink.MAV_SEVERITY_EMERGENCY, "Disarmed in the air")

    # -- stages -----------------------------------------------------------------------------------------------------

    def _drop_stages(self) -> None:
        self._queue.clear()
        self._stage = None
        self._wait_until_s = math.inf
        self.paused = False

    def _fly(self, stages: Sequence[_Stage], now_s: float) -> None:
        self._drop_stages()
        self._queue.extend(stages)
        self._next_stage(now_s)

    def _next_stage(self, now_s: float) -> None:
        if not self._queue and self.flying_mission and self.mission_state is MissionState.ACTIVE:
            self._queue.extend(self._stages_of(self.current))
        if not self._queue:
            return
        self._stage = self._queue.popleft()
        self._passed = 0
        self._wait_until_s = math.inf
        if self._stage.route is not None:
            self._by_parameters()
            self._navigator.follow(self._index, *self._stage.route)
            if self.landed:
                self.landed = False
                self._airborne_since_s = now_s
        elif not math.isinf(self._stage.wait_s):
            self._wait_until_s = now_s + self._stage.wait_s

    def _by_parameters(self) -> MotionModel:
        """Take up the parameters as they are now, which a vehicle does with its next route; return how it moves."""
        if self.parameters != self._taken_up:
            kind = (self.personality.autopilot, self.personality.vehicle_class)
            changes = changed(kind, self._taken_up, self.parameters)
            self._taken_up = dict(self.parameters)
            if changes:
                self._motion = with_values(self._motion, changes)
                self._navigator.retune(self._index, self._motion)
        return self._motion

    def _leg(self, position_m: FloatArray) -> Route:
        return Route.through([position_m], self._speed_m_s)

    def _hold(self) -> None:
        self._leave_mission()
        self._drop_stages()
        if not self.landed:
            self._navigator.halt(self._index)

    def _leave_mission(self) -> None:
        if self.mission_state is MissionState.ACTIVE:
            self.mission_state = MissionState.PAUSED
        if self.personality.speed_resets:  # PX4 forgets the mission's speed when it leaves it, and pauses its camera
            self._speed_m_s = self.default_speed_m_s
            self._camera.off = True

    def _enter(self, mode: Mode, now_s: float) -> None:
        """Do what the mode asks for, now that it is the mode (and again once armed)."""
        if not self.armed:
            return
        match mode.behaviour:
            case Behaviour.AUTO:
                self._enter_auto(now_s)
            case Behaviour.TAKEOFF if self.landed:
                self._climb_to(None, now_s)
            case Behaviour.RTL if not self.landed:
                self._leave_mission()
                self._fly([self._return(-1)], now_s)
            case Behaviour.LAND if not self.landed:
                self._leave_mission()
                self._fly([self._descent(self.position_m, -1)], now_s)
            case Behaviour.RTL | Behaviour.LAND:
                self.disarm(now_s)  # it is where it was to go
            case _:
                self._hold()

    def _enter_auto(self, now_s: float) -> None:
        options = int(self.parameters.get("AUTO_OPTIONS", _AUTO_OPTION_TAKEOFF_WITHOUT_THROTTLE))
        if self.landed and not (self._auto_armed or options & _AUTO_OPTION_TAKEOFF_WITHOUT_THROTTLE):
            return
        if self.personality.autopilot == "ardupilot" or self.mission_state is not MissionState.PAUSED:
            self._speed_m_s = self.default_speed_m_s
        if self.mission_state is MissionState.COMPLETE:
            self.current = 0
        self._begin_mission(now_s)

    def _climb_to(self, alt_amsl_m: float | None, now_s: float) -> None:
        height_m = float(self.parameters.get("MIS_TAKEOFF_ALT", 10.0))
        top = self.position_m
        top[2] = self.home_m[2] + height_m if alt_amsl_m is None else alt_amsl_m
        self._fly([self._climb(top, -1)], now_s)

    def _climb(self, top_m: FloatArray, seq: int) -> _Stage:
        here = self.position_m
        route = takeoff_points(self._by_parameters(), here, top_m)
        if not self.landed:
            route = Route.through([top_m], self._speed_m_s)
        return _Stage(_Doing.CLIMB, route, (-1,) * (len(route.points_m) - 1) + (seq,))

    def _descent(self, from_m: FloatArray, seq: int) -> _Stage:
        ground_amsl_m = self._ground(float(from_m[0]), float(from_m[1]))
        route = landing_points(self._by_parameters(), from_m, ground_amsl_m, self._speed_m_s)
        return _Stage(_Doing.LEGS, route, (-1,) * len(route.points_m), done_seq=seq, lands_from=0)

    def _return(self, seq: int) -> _Stage:
        here = self.position_m
        x_m, y_m, height_m = map(float, here - self.home_m)
        return_height_m = self.personality.return_height_m(self.parameters, height_m, math.hypot(x_m, y_m))
        route = return_points(replace(self._by_parameters(), return_height_m=return_height_m), here, self.home_m)
        nowhere = (-1,) * len(route.points_m)
        if self.personality.vehicle_class == "plane":  # planes circle above home
            return _Stage(_Doing.LEGS, route, nowhere, math.inf)
        return _Stage(_Doing.LEGS, route, nowhere, done_seq=seq, lands_from=_RETURN_LEGS)

    # -- mission ----------------------------------------------------------------------------------------------------

    @property
    def _first(self) -> int:
        return 1 if self.personality.transfer.home_is_item_0 else 0

    def _mission_may_start(self) -> bool:
        if len(self.mission) <= self._first:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, self.personality.no_mission_text)
            return False
        first_nav = next((item.command for item in self.mission[self._first :] if item.command in NAV_COMMANDS), None)
        takeoffs = (mavlink.MAV_CMD_NAV_TAKEOFF, mavlink.MAV_CMD_NAV_VTOL_TAKEOFF)
        needs_takeoff = self.personality.autopilot == "ardupilot" and self.personality.vehicle_class == "copter"
        if needs_takeoff and self.armed and self.landed and first_nav not in takeoffs:
            self._say(mavlink.MAV_SEVERITY_CRITICAL, "Auto: Missing Takeoff Cmd")
            return False
        return True

    def _begin_mission(self, now_s: float) -> None:
        self._drop_stages()
        self.mission_state = MissionState.ACTIVE
        self._camera.off = False
        self._begin_item(max(self.current, self._first), now_s)
        self._next_stage(now_s)

    def _begin_item(self, seq: int, now_s: float) -> None:
        """Do what acts at once from item ``seq`` on, up to the next item to fly; none left: the mission is complete."""
        for _ in range(_JUMP_MAX + len(self.mission)):
            if seq >= len(self.mission):
                break
            item = self.mission[seq]
            if self._flies_to(item):
                self.current = seq
                self._announce(seq, item)
                return
            self._announce(seq, item)
            if item.command == mavlink.MAV_CMD_DO_JUMP:
                target, done = int(item.param1), self._jumps.get(seq, 0)
                if done != int(item.param2) and self._first <= target < len(self.mission):
                    self._jumps[seq] = done + 1
                    seq = target
                    continue
            self._act(item, now_s)
            self.events.append(Completed(seq))
            seq += 1
        self.mission_state = MissionState.COMPLETE
        self._jumps.clear()

    def _act(self, item: MissionItem, now_s: float) -> None:
        match item.command:
            case mavlink.MAV_CMD_DO_CHANGE_SPEED:
                self._note_speed(item.param1, item.param2)
            case mavlink.MAV_CMD_DO_SET_HOME:
                self.set_home(self.position_m if item.param1 == 1 else self._place(item))
            case mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST:
                self._camera.trigger(item.param1)
                if item.param3 == 1.0:
                    self._camera.start(1.0, 0.0, now_s)
            case mavlink.MAV_CMD_IMAGE_START_CAPTURE:
                self._camera.start(item.param3, item.param2, now_s)
            case mavlink.MAV_CMD_DO_DIGICAM_CONTROL if item.x == 1:
                self._camera.start(1.0, 0.0, now_s)
            case mavlink.MAV_CMD_IMAGE_STOP_CAPTURE:
                self._camera.stop()

    def _complete(self, seq: int, now_s: float) -> None:
        self.events.append(Completed(seq))
        if self.personality.announces_items and self.mission[seq].command in (
            mavlink.MAV_CMD_NAV_WAYPOINT,
            mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT,
        ):
            self._say(mavlink.MAV_SEVERITY_INFO, f"Reached command #{seq}")
        self._begin_item(seq + 1, now_s)

    def _note_speed(self, kind: float, speed_m_s: float) -> None:
        if not math.isfinite(speed_m_s) or speed_m_s < self.personality.speed_min_m_s or speed_m_s <= 0.0:
            if self.personality.speed_resets and speed_m_s <= 0.0:
                self._speed_m_s = self.default_speed_m_s
            return
        vertical = 0.0 if self.personality.speed_resets else kind  # PX4 does not look at the type
        if vertical == mavlink.SPEED_TYPE_CLIMB_SPEED:
            self._climb_m_s = speed_m_s
        elif vertical == mavlink.SPEED_TYPE_DESCENT_SPEED:
            self._descent_m_s = speed_m_s
        elif self._may_fly_at(speed_m_s):
            self._speed_m_s = speed_m_s

    def _may_fly_at(self, speed_m_s: float) -> bool:
        names = self.personality.speed_limit_parameters
        return names is None or float(self.parameters[names[0]]) <= speed_m_s <= float(self.parameters[names[1]])

    def _place(self, item: MissionItem, from_m: FloatArray | None = None) -> FloatArray:
        """Return the position (3,) of an item in the local frame; 0/0 is the place it is reached from."""
        here = self.position_m if from_m is None else from_m
        if item.x == 0 and item.y == 0:
            x, y = float(here[0]), float(here[1])
        else:
            x, y, _ = map(float, self._frame.to_local(wire_to_degrees(item.x), wire_to_degrees(item.y), 0.0))
        if not (math.isfinite(x) and math.isfinite(y)):  # the other side of the earth has no place in the frame
            x, y = float(here[0]), float(here[1])
        match item.frame:
            case mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT | mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT:
                datum_m = float(self.home_m[2])
            case mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT | mavlink.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT:
                datum_m = self._ground(x, y)
            case _:
                datum_m = 0.0
        return np.array([x, y, datum_m + item.z])

    def _stages_of(self, seq: int) -> list[_Stage]:
        """Return the stages from the item to be flown next up to where a decision is due."""
        points: list[FloatArray] = []
        speeds: list[float] = []
        holds: list[float] = []
        verticals: list[float] = []
        splines: list[bool] = []
        seqs: list[int] = []
        here = self.position_m
        speed_m_s, climb_m_s, descent_m_s = self._speed_m_s, self._climb_m_s, self._descent_m_s
        for i in range(seq, len(self.mission)):
            item = self.mission[i]
            if item.command == mavlink.MAV_CMD_DO_CHANGE_SPEED:
                before = self._speed_m_s, self._climb_m_s, self._descent_m_s
                self._speed_m_s, self._climb_m_s, self._descent_m_s = speed_m_s, climb_m_s, descent_m_s
                self._note_speed(item.param1, item.param2)
                speed_m_s, climb_m_s, descent_m_s = self._speed_m_s, self._climb_m_s, self._descent_m_s
                self._speed_m_s, self._climb_m_s, self._descent_m_s = before
                continue
            if item.command in (mavlink.MAV_CMD_DO_JUMP, mavlink.MAV_CMD_DO_SET_HOME):
                break
            if not self._flies_to(item):
                continue
            hold_s = self._hold_s(item)
            if hold_s is None:
                break
            place = self._place(item, here)
            points.append(place)
            speeds.append(speed_m_s)
            holds.append(hold_s)
            verticals.append(climb_m_s if place[2] > here[2] else descent_m_s)
            splines.append(item.command == mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT)
            seqs.append(i)
            here = place
        if points:
            route = Route.through(points, speeds, holds, verticals, spline=splines)
            return [_Stage(_Doing.LEGS, route, tuple(seqs))]
        return self._special_stages(seq, self.mission[seq])

    def _flies_to(self, item: MissionItem) -> bool:
        """Whether an item is flown; ArduPlane skips spline waypoints, which it accepts all the same."""
        spline = item.command == mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT
        return item.command in NAV_COMMANDS and not (spline and self.personality.vehicle_class == "plane")

    def _hold_s(self, item: MissionItem) -> float | None:
        """Return how long a waypoint is held, or None where the item is more than a waypoint."""
        match item.command:
            case mavlink.MAV_CMD_NAV_WAYPOINT | mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT | mavlink.MAV_CMD_NAV_LOITER_TIME:
                return _not_negative(item.param1)
            case mavlink.MAV_CMD_NAV_LOITER_TO_ALT:
                return 0.0
            case _:
                return None

    def _special_stages(self, seq: int, item: MissionItem) -> list[_Stage]:
        """Return the stages of an item that is more than a waypoint."""
        match item.command:
            case mavlink.MAV_CMD_NAV_TAKEOFF | mavlink.MAV_CMD_NAV_VTOL_TAKEOFF:
                return self._takeoff_stages(seq, item)
            case mavlink.MAV_CMD_NAV_LAND | mavlink.MAV_CMD_NAV_VTOL_LAND:
                return self._land_stages(seq, item)
            case mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH:
                return [self._return(seq)]
            case mavlink.MAV_CMD_NAV_DELAY:
                return [_Stage(_Doing.WAIT, wait_s=_not_negative(item.param1), done_seq=seq)]
            case mavlink.MAV_CMD_NAV_LOITER_TURNS:
                circle_m = 2.0 * math.pi * abs(item.param3)
                turns_s = _not_negative(item.param1) * circle_m / max(self._speed_m_s, 0.1)
                return [_Stage(_Doing.LEGS, self._leg(self._place(item)), (-1,), turns_s, seq)]
            case _:  # LOITER_UNLIM: never done
                return [_Stage(_Doing.LEGS, self._leg(self._place(item)), (-1,), math.inf)]

    def _takeoff_stages(self, seq: int, item: MissionItem) -> list[_Stage]:
        here, place = self.position_m, self._place(item)
        plane = self.personality.vehicle_class == "plane"
        if self.landed:  # PX4 climbs no less
            place[2] = max(place[2], self.home_m[2] + float(self.parameters.get("MIS_TAKEOFF_ALT", 0.0)))
        # ArduCopter ignores the item's place and goes straight up; a plane climbs towards it
        top = np.array([*(place if plane else here)[:2], max(place[2], here[2])])
        if not self.landed and top[2] - here[2] < 0.1:
            return [_Stage(_Doing.WAIT, done_seq=seq)]
        late = [_Stage(_Doing.WAIT, wait_s=self._late_s)] if self.landed and self._late_s > 0.0 else []
        self._late_s = 0.0
        away_m = math.dist(place[:2], here[:2])
        if self.personality.autopilot == "px4" and not plane and away_m > self._by_parameters().waypoint_radius_m:
            climb = self._climb(top, -1)
            return [*late, climb, _Stage(_Doing.LEGS, self._leg(np.array([place[0], place[1], top[2]])), (seq,))]
        return [*late, self._climb(top, seq)]

    def _land_stages(self, seq: int, item: MissionItem) -> list[_Stage]:
        here, place = self.position_m, self._place(item)
        if self.personality.vehicle_class == "plane":
            return [self._descent(place, seq)]
        above = np.array([place[0], place[1], here[2]])
        stages = [self._descent(above, seq)]
        away = math.dist(above[:2], here[:2]) > self._by_parameters().waypoint_radius_m
        # ArduCopter flies to a place that is named even if it is there
        if away or (self.personality.autopilot == "ardupilot" and (item.x != 0 or item.y != 0)):
            stages.insert(0, _Stage(_Doing.LEGS, self._leg(above), (-1,)))
        return stages

    # -- words ------------------------------------------------------------------------------------------------------

    def _announce(self, seq: int, item: MissionItem) -> None:
        if self.personality.announces_items:
            name = _ITEM_NAMES.get(item.command, str(item.command))
            self._say(mavlink.MAV_SEVERITY_INFO, f"Mission: {seq} {name}")

    def _say(self, severity: int, text: str) -> None:
        if text:
            self.events.append(Said(int(severity), text))


def _not_negative(value: float) -> float:
    """Return a parameter that may be unset (NaN) as a number."""
    return value if math.isfinite(value) and value > 0.0 else 0.0


_ITEM_NAMES = {
    mavlink.MAV_CMD_NAV_WAYPOINT: "WP",
    mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT: "SplineWP",
    mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: "RTL",
    mavlink.MAV_CMD_NAV_LOITER_UNLIM: "LoitUnltd",
    mavlink.MAV_CMD_NAV_LOITER_TIME: "LoitTime",
    mavlink.MAV_CMD_NAV_LOITER_TURNS: "LoitTurns",
    mavlink.MAV_CMD_NAV_TAKEOFF: "Takeoff",
    mavlink.MAV_CMD_NAV_LAND: "Land",
    mavlink.MAV_CMD_NAV_DELAY: "Delay",
    mavlink.MAV_CMD_DO_CHANGE_SPEED: "ChangeSpeed",
    mavlink.MAV_CMD_DO_JUMP: "Jump",
    mavlink.MAV_CMD_DO_SET_HOME: "SetHome",
    mavlink.MAV_CMD_DO_SET_ROI: "SetROI",
    mavlink.MAV_CMD_DO_SET_ROI_LOCATION: "SetROI",
}
