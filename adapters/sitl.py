"""Real autopilot code in its makers' simulators (SITL), as a fleet's vehicles: started, tuned, watched and stopped.

Every instance runs at its own pace, near ``speedup`` times real time or, on a busy computer, below it. So the ground's
clock here runs as the slowest of them does, by what they say of their time since boot.

An instance never outlives this process: it is stopped on every way out, and killed by the system where there is none.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, ClassVar

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Endpoint, Peer, WrappedEndpoint, open_endpoint
from adapters.fleet_vehicle import FleetVehicle
from adapters.ground_station import Station, Steps
from adapters.mission_protocol import OWN_COMPONENT, OWN_SYSID
from adapters.parameter_protocol import is_integer
from adapters.return_settings import Setting
from adapters.sitl_instances import (
    DEFAULTS,
    Ground,
    Instance,
    Programs,
    free_numbers,
    is_free,
    planned_parameters,
    sitl_instances,
)
from missionplanner.autopilot_parameters import same, shown
from missionplanner.errors import LinkError, MissionPlannerError
from missionplanner.files import ensure_writable, write_atomic
from missionplanner.geodesy import LocalFrame
from missionplanner.plan import FleetPlan

ReadyProgress = Callable[[str, str], None]
"""Called with a vehicle's name and what it still lacks, "ready" in the end; whenever that changes."""


class SitlError(MissionPlannerError):
    """A simulator that does not start or has ended. No real vehicle is concerned: there is nothing to call off."""

    exit_code: ClassVar[int] = LinkError.exit_code


_BEGIN_S, _BEGIN_EACH_S = 30.0, 2.0  # real time, from the start of the programs to their first heartbeats
_READY_S = 180.0  # of the vehicles' time
_STOP_S = 3.0  # real time, to end by itself when told to
_PATIENCE_S = 30.0  # of the vehicles' time; one that still boots is slow to answer
_LAST_WORDS = 160
_LAST_BYTES = 4_096
_STATE = ("eeprom.bin", "flash.dat", "parameters*.bson", "dataman", "eeprom/parameters*", "terrain/*.DAT")
_INTERVALS_S = {
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 0.25,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 0.2,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
}
_ARDUPILOT_INTERVALS_S = {
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1.0,
    mavlink.MAVLINK_MSG_ID_TERRAIN_REQUEST: 0.5,  # it asks only where it is told to
}
_CHECK_S = 0.5  # real time between looks at the simulators
_RATE_OVER_S = 0.5  # real time
_RATE_FOR_S = 3.0  # real time
_RATE_LEAST = 0.1
_PACES_DIFFER = 1.1
_REBOOT_S = 1.0  # a time that falls back by less was sent before

_HEADER = re.compile(rb"\xfd(.)(.).{2}(.)\x01([\x02\x21\x85])\x00\x00", re.DOTALL)  # from an autopilot, MAVLink 2
_CHECKSUM_BYTES = 2

# Runs before the autopilot's program, in its process: has the system kill it when we die, then becomes it.
_GUARD = """\
import ctypes, os, signal, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, int(signal.SIGKILL))  # PR_SET_PDEATHSIG
if os.getppid() != int(sys.argv[1]):
    sys.exit(1)
try:
    os.execv(sys.argv[2], sys.argv[2:])
except OSError as error:
    sys.exit(f"{sys.argv[2]}: cannot be run: {error.strerror}")
"""


class SitlClock:
    """The vehicles' time, as the slowest of them has it; waiting watches over the simulators."""

    def __init__(self, speedup: float, check: Callable[[], None]) -> None:
        self._speedup = speedup
        self._check = check
        self._endpoints: Sequence[Endpoint] = ()
        self._wall_s = time.monotonic()
        self._now_s = 0.0
        self._marks: dict[int, tuple[float, float]] = {}  # real time and time since boot, by sysid
        self._rates: dict[int, tuple[float, float]] = {}  # of time, and when that was seen
        self._first: dict[int, tuple[float, float]] = {}  # marks: the first since boot, and the last
        self._last: dict[int, tuple[float, float]] = {}

    def wait_on(self, endpoints: Sequence[Endpoint]) -> None:
        """Let waiting end early when one of these has something to read."""
        self._endpoints = endpoints

    def now_s(self) -> float:
        """Return seconds of the vehicles' time since the clock was made."""
        wall_s = time.monotonic()
        self._now_s += (wall_s - self._wall_s) * self._rate(wall_s)
        self._wall_s = wall_s
        return self._now_s

    def wait(self, seconds: float) -> None:
        """Let at most that time pass.

        Raises
        ------
        SitlError
            A simulator has ended.
        """
        self.now_s()
        left_s = min(max(seconds, 0.0) / self._rate(self._wall_s), _CHECK_S)
        descriptors = [fd for endpoint in self._endpoints for fd in endpoint.filenos()]
        if descriptors:
            select.select(descriptors, [], [], left_s)
        else:
            time.sleep(left_s)
        self._check()

    def heard(self, sysid: int, boot_s: float) -> None:
        """Take note of what a vehicle says of its time since boot."""
        wall_s = time.monotonic()
        mark = self._marks.get(sysid)
        self._last[sysid] = wall_s, boot_s
        if mark is None or boot_s < mark[1] - _REBOOT_S:
            self._marks[sysid] = self._first[sysid] = wall_s, boot_s
        elif wall_s - mark[0] >= _RATE_OVER_S:
            self.now_s()  # at the rate so far
            self._rates[sysid] = (boot_s - mark[1]) / (wall_s - mark[0]), wall_s
            self._marks[sysid] = wall_s, boot_s

    def paces(self) -> dict[int, float]:
        """Return how many times real time each vehicle has lived through since it was first heard, by sysid."""
        spans = {sysid: (np.subtract(last, self._first[sysid])) for sysid, last in self._last.items()}
        return {sysid: float(boot_s / wall_s) for sysid, (wall_s, boot_s) in spans.items() if wall_s > _RATE_OVER_S}

    def _rate(self, wall_s: float) -> float:
        fresh = [rate for rate, seen_s in self._rates.values() if wall_s - seen_s <= _RATE_FOR_S]
        # before they tell, and where none is heard any more: real time is patient, and still runs into every timeout
        usual = min(self._speedup, 1.0)
        return min(max(min(fresh, default=usual), _RATE_LEAST * usual), 2.0 * self._speedup)


class _TappedEndpoint(WrappedEndpoint):
    """A link to simulators, overheard: their time goes to the clock, and they are told of the ground they ask for."""

    def __init__(
        self, inner: Endpoint, clock: SitlClock, homes_m: Mapping[int, float], ground: Ground | None, frame: LocalFrame
    ) -> None:
        super().__init__(inner)
        self._clock = clock
        self._homes_amsl_m = homes_m  # by sysid
        self._ground = ground
        self._frame = frame
        self._codec = mavlink.MAVLink(None, srcSystem=OWN_SYSID, srcComponent=OWN_COMPONENT)

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return what has arrived, and answer what concerns the simulation."""
        arrived = self._inner.receive()
        for data, peer in arrived:
            for found in _HEADER.finditer(data):
                frame = data[found.start() : found.end() + found[1][0] + _CHECKSUM_BYTES]
                with contextlib.suppress(mavlink.MAVError):  # cut, or no frame at all
                    self._overhear(self._codec.decode(bytearray(frame)), peer)
        return arrived

    def _overhear(self, message: Any, peer: Peer) -> None:
        home_amsl_m = self._homes_amsl_m.get(message.get_srcSystem())
        if home_amsl_m is None:
            return
        if message.get_type() != "TERRAIN_REQUEST":
            self._clock.heard(message.get_srcSystem(), message.time_boot_ms / 1000.0)
        elif self._ground is not None:
            for answer in terrain_data(message, self._ground, self._frame, home_amsl_m):
                self._inner.send(bytes(answer.pack(self._codec)), peer)
                self._codec.seq = (self._codec.seq + 1) % 256


def terrain_data(request: Any, ground: Ground, frame: LocalFrame, elsewhere_amsl_m: float) -> list[Any]:
    """Answer a TERRAIN_REQUEST: of 8 x 7 squares of 4 x 4 places, counted eastwards, then northwards, those it wants.

    Where the ground is not known, it is ``elsewhere_amsl_m`` high (https://mavlink.io/en/services/terrain.html).
    """
    corner_m = frame.to_local(request.lat * 1e-7, request.lon * 1e-7, 0.0)
    steps_m = request.grid_spacing * np.arange(4.0)
    answers = []
    for bit in range(56):
        if request.mask >> bit & 1:
            x_m = corner_m[0] + 4.0 * request.grid_spacing * (bit % 8) + steps_m[np.newaxis, :]
            y_m = corner_m[1] + 4.0 * request.grid_spacing * (bit // 8) + steps_m[:, np.newaxis]
            heights_m = ground(*np.broadcast_arrays(x_m, y_m))
            heights = np.rint(np.where(np.isnan(heights_m), elsewhere_amsl_m, heights_m)).astype(int).ravel().tolist()
            answers.append(
                mavlink.MAVLink_terrain_data_message(request.lat, request.lon, request.grid_spacing, bit, heights)
            )
    return answers


class SitlFleet:
    """The simulators of a plan's vehicles: started by :meth:`start`, stopped when the ``with`` block is left.

    ``plan``, ``endpoints`` and ``clock`` are for the fleet's link. ``tell`` hears what is to be said to the user.
    """

    def __init__(
        self,
        plan: FleetPlan,
        programs: Programs,
        folder: Path,
        *,
        speedup: float = 1.0,
        ground: Ground | None = None,
        wind_m_s: tuple[float, float] | None = None,
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        # no simulator is the autopilot that a mission is bound to
        unbound = tuple(vehicle.model_copy(update={"uid": None}) for vehicle in plan.mission.vehicles)
        self.plan = replace(plan, mission=plan.mission.model_copy(update={"vehicles": unbound}))
        self._folder = folder
        self._tell = tell
        self._ground = ground
        self._how = partial(sitl_instances, plan, programs, folder, speedup=speedup, ground=ground, wind_m_s=wind_m_s)
        self._instances = self._by_sysid(self._how())
        self._running: dict[int, subprocess.Popen[bytes]] = {}
        self._links: dict[str, Endpoint] = {}
        self._patience_s = _BEGIN_S + _BEGIN_EACH_S * len(self._instances)
        self._told = False  # of one that ended
        self._handlers: dict[int, Any] = {}
        self.clock = SitlClock(speedup, self.check)

    @staticmethod
    def _by_sysid(instances: Iterable[Instance]) -> dict[int, Instance]:
        return {instance.vehicle.sysid: instance for instance in instances}

    @property
    def endpoints(self) -> list[Endpoint]:
        """The links to the vehicles."""
        return list(self._links.values())

    def start(self, progress: ReadyProgress | None = None) -> None:
        """Start one simulator per vehicle, tune them, and wait until each can be armed.

        Raises
        ------
        SitlError
            A port in use; a program that ends, says nothing, or does not get ready.
        LinkError
            A vehicle is none of the plan's, or does not do as told.
        """
        self._instances = self._by_sysid(self._how(numbers=free_numbers(len(self._instances))))
        self._expect_free_ports()
        for instance in self._instances.values():
            if instance.url.startswith("udpin"):
                self._open(instance)
        for instance in self._instances.values():
            self._begin(instance)
        for instance in self._instances.values():
            self._connect(instance)
        self.clock.wait_on(self.endpoints)
        station = self._heard()
        if self._begin_again_elsewhere(station):
            station = self._heard()
        for vehicle in station.peers.values():
            vehicle.check_identity()
        station.together({k: self._preparing(station, vehicle, progress) for k, vehicle in station.peers.items()})

    def check(self) -> None:
        """Make sure that every simulator runs; of the first that does not, it is told once.

        Raises
        ------
        SitlError
            One has ended.
        """
        for sysid, process in self._running.items():
            if process.poll() is not None and not self._told:
                self._told = True
                raise self._ended(self._instances[sysid], process.returncode)

    def stop(self) -> None:
        """Stop all simulators: they are asked to end, then killed with all that they started."""
        try:
            _signal_all(self._running.values(), signal.SIGTERM)
            end_s = time.monotonic() + _STOP_S
            for process in self._running.values():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(max(end_s - time.monotonic(), 0.0))
        finally:
            _signal_all(self._running.values(), signal.SIGKILL)
            for process in self._running.values():
                process.wait()
            self._running.clear()

    def __enter__(self) -> SitlFleet:
        if threading.current_thread() is threading.main_thread():  # elsewhere signals are somebody else's
            for number in (signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)):
                if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup has it
                    self._handlers.setdefault(number, signal.signal(number, _leave))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._handlers:  # a second Ctrl-C shall not leave half of them running
            self._handlers[signal.SIGINT] = signal.getsignal(signal.SIGINT)
            for number in self._handlers:
                signal.signal(number, signal.SIG_IGN)
        try:
            count = len(self._running)
            self.stop()
            for endpoint in self._links.values():
                endpoint.close()
            if count and isinstance(error, KeyboardInterrupt | SystemExit):
                stopped = "1 simulator was" if count == 1 else f"all {count} simulators were"
                self._tell(f"{stopped} stopped; logs are in {self._folder}")
            elif count and error is None:
                self._tell_paces()
        finally:
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def _tell_paces(self) -> None:
        """Say so where the simulators have not kept pace: what one waits for by the ground's clock is late or early."""
        paces = self.clock.paces().values()
        least, most = min(paces, default=1.0), max(paces, default=1.0)
        if most > _PACES_DIFFER * least:
            self._tell(
                f"the simulators ran at {least:.1f} to {most:.1f} times real time: each is timed by its own clock, but "
                "those who start later, or were hurried, were so by the slowest one's; ask for a lesser --speedup"
            )

    def _expect_free_ports(self) -> None:
        for instance in self._instances.values():
            for port in instance.ports:
                if not is_free(port):
                    raise SitlError(
                        f"{instance.vehicle.name}: its simulator needs {port[0].upper()} port {port[1]}, which another "
                        "program uses: stop that (another simulator?); nothing was started"
                    )

    def _begin(self, instance: Instance) -> None:
        ensure_writable(instance.folder)
        for pattern in _STATE:  # what an earlier flight has left would win over what is planned now
            for stale in instance.folder.glob(pattern):
                stale.unlink()
        if instance.defaults:
            lines = [f"{name} {shown(value)}" for name, value in sorted(instance.defaults.items())]
            write_atomic(instance.folder / DEFAULTS, "\n".join(lines) + "\n")
        command = [sys.executable, "-I", "-S", "-c", _GUARD, str(os.getpid()), *instance.command]
        with instance.log.open("wb") as log:
            self._running[instance.vehicle.sysid] = subprocess.Popen(
                command,
                cwd=instance.folder,
                # what a shell was set up with for some other simulation is none of ours
                env={k: v for k, v in os.environ.items() if not k.startswith("PX4_")} | dict(instance.environment),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C at our terminal is for us alone
            )

    def _connect(self, instance: Instance) -> None:
        """Open the link to a program that listens, as soon as it does."""
        end_s = time.monotonic() + self._patience_s
        while instance.url not in self._links:
            try:
                self._open(instance)
            except LinkError as error:
                self.check()
                if time.monotonic() > end_s:
                    raise SitlError(
                        f"{instance.vehicle.name}: expected its simulator to listen on {instance.url} within "
                        f"{self._patience_s:g} s: is {instance.command[0]} an autopilot's? {_last_words(instance)}"
                    ) from error
                time.sleep(0.05)

    def _open(self, instance: Instance) -> None:
        if instance.url not in self._links:  # several PX4 instances may send to one port
            homes_amsl_m = {vehicle.sysid: float(vehicle.home_m[2]) for vehicle in self.plan.vehicles}
            inner = open_endpoint(instance.url)
            self._links[instance.url] = _TappedEndpoint(inner, self.clock, homes_amsl_m, self._ground, self.plan.frame)

    def _heard(self) -> Station[FleetVehicle]:
        """Return a ground station that has heard each of the vehicles."""
        vehicles = {vehicle.sysid: FleetVehicle(vehicle, self.plan) for vehicle in self.plan.vehicles}
        station = Station(vehicles, self.endpoints, self.clock, None)
        end_s = time.monotonic() + self._patience_s
        while silent := [vehicle for vehicle in vehicles.values() if vehicle.heartbeat is None]:
            station.step()
            if time.monotonic() > end_s:
                instance = self._instances[silent[0].plan.sysid]
                others = sorted(station.heard - set(vehicles))
                heard = f"heard sysid {', '.join(map(str, others))} instead" if others else "heard nothing"
                raise SitlError(
                    f"{silent[0].plan.name}: expected its simulator to speak MAVLink on {instance.url}, with sysid "
                    f"{silent[0].plan.sysid}, within {self._patience_s:g} s, {heard}: is "
                    f"{instance.command[0]} an autopilot's? {_last_words(instance)}"
                )
        return station

    def _begin_again_elsewhere(self, station: Station[FleetVehicle]) -> bool:
        """Start those again that have not understood where their homes are; return whether there were any."""
        px4 = {sysid: vehicle for sysid, vehicle in station.peers.items() if vehicle.plan.autopilot == "px4"}
        whole: set[int] = set()

        def asking(vehicle: FleetVehicle) -> Steps:
            setting = Setting(0.0, (("SIH_LOC_LAT0", 1.0),))
            held = yield from station.reading(vehicle, "px4", setting, None)
            if held is not None and is_integer(held.kind):
                whole.add(vehicle.plan.sysid)

        station.together({sysid: asking(vehicle) for sysid, vehicle in px4.items()})
        again = [self._running[sysid] for sysid in whole]
        _signal_all(again, signal.SIGKILL)
        for process in again:
            process.wait()
        otherwise = self._by_sysid(self._how(whole_degrees=True))
        for sysid in sorted(whole):
            self._instances[sysid] = otherwise[sysid]
            self._begin(self._instances[sysid])
        return bool(whole)

    def _preparing(
        self, station: Station[FleetVehicle], vehicle: FleetVehicle, progress: ReadyProgress | None
    ) -> Steps:
        extra = _ARDUPILOT_INTERVALS_S if vehicle.plan.autopilot == "ardupilot" else {}
        for number, interval_s in {**_INTERVALS_S, **extra}.items():
            set_interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            yield from station.commanding(vehicle, set_interval, number, interval_s * 1e6, patience_s=_PATIENCE_S)
        if vehicle.plan.autopilot == "px4":
            yield from self._tuning(station, vehicle)
        end_s = self.clock.now_s() + _READY_S
        told = ""
        while missing := ", ".join(vehicle.lacks(self.clock.now_s())):
            if self.clock.now_s() >= end_s:
                raise vehicle.error(f"its simulator is not ready to arm within {_READY_S:.0f} s: {missing}")
            if progress is not None and missing != told:
                progress(vehicle.plan.name, told := missing)
            yield
        if progress is not None:
            progress(vehicle.plan.name, "ready")

    def _tuning(self, station: Station[FleetVehicle], vehicle: FleetVehicle) -> Steps:
        """Set what older start-up scripts have not taken from the environment."""
        wanted = planned_parameters(vehicle.plan)
        held = yield from station.reading_many(vehicle, "px4", [(name,) for name in wanted])
        for parameter in held:
            if parameter is not None and not same(parameter.value, wanted[parameter.name]):
                yield from station.setting(vehicle, "px4", parameter, wanted[parameter.name])

    def _ended(self, instance: Instance, code: int) -> SitlError:
        if code < 0:
            how = f"was killed by signal {-code} ({signal.strsignal(-code) or 'unknown'})"
        else:
            how = f"ended with exit code {code}"
        others = "; all others were stopped" if len(self._instances) > 1 else ""
        return SitlError(f"{instance.vehicle.name}: its simulator {how}: {_last_words(instance)}{others}")


def _last_words(instance: Instance) -> str:
    """Return what a program printed last, and where the rest of it is."""
    text = b""
    if instance.log.exists():
        with instance.log.open("rb") as log:
            log.seek(max(instance.log.stat().st_size - _LAST_BYTES, 0))
            text = log.read()
    plain = re.sub(r"\x1b\[[0-9;]*[A-Za-z]", "", text.decode(errors="replace"))
    lines = [" ".join(line.split()) for line in plain.splitlines() if line.strip()]
    said = " / ".join(lines[-3:])
    said = said if len(said) <= _LAST_WORDS else f"...{said[-_LAST_WORDS:]}"
    return f"it said last {said!r} (log: {instance.log})" if said else f"it said nothing (log: {instance.log})"


def _signal_all(processes: Iterable[subprocess.Popen[bytes]], number: int) -> None:
    for process in processes:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)


def _leave(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)
