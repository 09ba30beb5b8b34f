"""A stand-in for the programs of ArduPilot's and PX4's simulators, for tests: ``sitl_stand_in.py PROGRAM ARGUMENT...``.

It takes the same arguments and environment, refuses what the real ones refuse, blocks where they block, speaks on the
same ports and leaves the same files; what flies is the built-in simulator. Beyond that it obeys STAND_IN_CRASH
(``SYSID:SECONDS``: dies by itself, so long after it has begun), STAND_IN_PACE (``SYSID:FACTOR``: does not keep up with
the speed-up, as on a busy computer) and, for PX4, files in etc: ``whole_degrees`` (homes are in 1e-7 degrees) and
``no_environment`` (parameters are not taken from there).
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import socket
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.endpoint import Address, Endpoint, Peer, UdpEndpoint, WrappedEndpoint, open_endpoint
from missionplanner.autopilot_parameters import Kind, fields, find, with_values
from missionplanner.geodesy import GeoPoint, LocalFrame
from missionplanner.mission import VehicleSettings
from missionplanner.vehicle import motion_model
from sim.fleet import SimFleet, SimVehicle, serve

# libraries/AP_HAL_SITL/SITL_cmdline.cpp of ArduCopter 4.5: whether an option has a value
_ARDUPILOT_OPTIONS = {
    **dict.fromkeys(("help", "wipe", "unhide-groups", "console", "synthetic-clock", "gimbal", "enable-fgview"), False),
    **dict.fromkeys(("speedup", "rate", "instance", "home", "model", "config", "fg", "autotest-dir", "defaults"), True),
    **dict.fromkeys(("base-port", "rc-in-port", "sim-address", "sim-port-in", "sim-port-out", "irlock-port"), True),
    **dict.fromkeys(("start-time", "sysid", "slave", *(f"serial{n}" for n in range(10))), True),
}
_SHORT = {"h": "help", "w": "wipe", "s": "speedup", "I": "instance", "O": "home", "M": "model"}
# that a simulated airframe is not armed without
_NEEDED = {"arducopter": {"FRAME_CLASS": 1.0}, "arduplane": {"ARSPD_USE": 1.0}}


def main(program: str, arguments: Sequence[str]) -> None:
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # a text file here
    if program == "px4":
        _px4(arguments)
    else:
        _ardupilot(program, arguments)


def _ardupilot(program: str, arguments: Sequence[str]) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # as some releases have it
    options = _ardupilot_options(arguments)
    if "help" in options:
        _fail("Options:", 0)
    if "model" not in options:
        _fail("You must specify a vehicle model.  Options are:\n  quadplane\n  quad\n  plane", 1)
    model, kind = options["model"], ("copter" if program == "arducopter" else "plane")
    if model not in ("quad", "plane"):
        _fail(f"Vehicle model ({model}) not found", 1)
    lat, lon, alt, _ = (float(part) for part in options["home"].split(","))
    number = int(options.get("instance", "0"))
    speedup = float(options.get("speedup", "1"))
    print(f"Setting SIM_SPEEDUP={speedup:f}\nStarting sketch '{'ArduCopter' if kind == 'copter' else 'ArduPlane'}'")
    print("Starting SITL input")
    listener = open_endpoint(f"tcpin:0.0.0.0:{_bound(5760 + 10 * number)}")
    rc_in = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    rc_in.bind(("0.0.0.0", 5501 + 10 * number))
    print(f"bind port {5760 + 10 * number} for SERIAL0\nSERIAL0 on TCP port {5760 + 10 * number}")
    print("Waiting for connection ....")
    while not len(listener.filenos()) > 1:
        listener.receive()
        time.sleep(0.01)
    print(f"Connection on serial port {5760 + 10 * number}")
    defaults = _defaults(options.get("defaults", ""))
    for name, value in _NEEDED[program].items():
        if defaults.get(name) != value:
            _fail(f"PreArm: {name} is {defaults.get(name)}", 1)
    stored = Path("eeprom.bin")  # goes before defaults
    held = defaults | (json.loads(stored.read_text()) if stored.exists() else {})
    stored.write_text(json.dumps(held))
    sysid = int(options.get("sysid", held.get("SYSID_THISMAV", 1)))
    _fly(
        ("ardupilot", "copter" if kind == "copter" else "plane"),
        sysid,
        GeoPoint(lat, lon, alt),
        held,
        listener,
        speedup,
    )


def _ardupilot_options(arguments: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    left = list(arguments)
    while left:
        word = left.pop(0)
        name = word[2:] if word.startswith("--") else _SHORT.get(word.removeprefix("-"), "")
        if name not in _ARDUPILOT_OPTIONS:
            _fail(
                f"unrecognised option '{word}'\nOptions:\n\t--help|-h                display this help information", 1
            )
        found[name] = left.pop(0) if _ARDUPILOT_OPTIONS[name] else ""
    return found


def _bound(port: int) -> int:
    """Return a port that is free; the real ones end where it is not."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("0.0.0.0", port))
        except OSError as error:
            _fail(f"bind failed on port {port} - {error.strerror}", 1)
    return port


def _defaults(paths: str) -> dict[str, float]:
    values: dict[str, float] = {}
    for path in filter(None, paths.split(",")):
        if not Path(path).is_file():
            _panic(f"Failed to load defaults from {path}")
        for line in Path(path).read_text().splitlines():
            name, value = line.partition("#")[0].replace(",", " ").replace("\t", " ").split()
            values[name] = float(value)
    return values


def _panic(text: str) -> None:
    print(f"PANIC: {text}")
    if "SITL_PANIC_EXIT" in os.environ:
        sys.exit(1)
    while True:  # the real one does not let go of its processor either
        time.sleep(1.0)


def _px4(arguments: Sequence[str]) -> None:
    number, etc = 0, None
    left = list(arguments)
    while left:
        match left.pop(0):
            case "-d":
                pass
            case "-i":
                number = int(left.pop(0))
            case "-w":
                os.chdir(left.pop(0))
            case word if word.startswith("-"):
                _fail(f"ERROR [px4] unrecognized flag\nUsage for Server/daemon process: {word}", 255)
            case word:
                etc = Path(word)
    print(f"INFO  [px4] instance: {number}")
    lock = Path(f"/tmp/px4_lock-{number}").open("a")  # noqa: SIM115  # held until the end
    try:
        fcntl.lockf(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        _fail(f"INFO  [px4] PX4 server already running for instance {number}", 1)
    if etc is None or not (etc / "init.d-posix" / "rcS").is_file():
        _fail("ERROR [px4] Error opening startup file, does not exist: etc/init.d-posix/rcS", 255)
    here = Path("etc")
    if here.is_symlink():
        here.unlink()
    here.symlink_to(etc)
    for name in ("log", "eeprom"):
        Path(name).mkdir(exist_ok=True)
    model = os.environ.get("PX4_SIM_MODEL", "")
    airframes = {path.name.partition("_")[2] for path in (etc / "init.d-posix" / "airframes").iterdir()}
    if "PX4_SYS_AUTOSTART" not in os.environ and model not in airframes:
        _fail(f"ERROR [init] Unknown model {model} (not found by name on etc/init.d-posix/airframes)", 1)
    whole = (etc / "whole_degrees").exists()
    convert, unit = (_whole, 1e-7) if whole else (float, 1.0)
    values: dict[str, Any] = {"SIH_LOC_LAT0": 473977420 if whole else 47.397742, "SIH_LOC_LON0": 85455940 * unit}
    values["SIH_LOC_H0"] = 489.4
    stored = Path("parameters.bson")
    if stored.exists():
        values |= json.loads(stored.read_text())
    values |= {"SIH_LOC_LAT0": convert(os.environ["PX4_HOME_LAT"]), "SIH_LOC_LON0": convert(os.environ["PX4_HOME_LON"])}
    values["SIH_LOC_H0"] = float(os.environ["PX4_HOME_ALT"])
    stored.write_text(json.dumps(values))
    if not (etc / "no_environment").exists():
        prefix = "PX4_PARAM_"
        values |= {k.removeprefix(prefix): float(v) for k, v in os.environ.items() if k.startswith(prefix)}
    home = GeoPoint(values["SIH_LOC_LAT0"] * unit, values["SIH_LOC_LON0"] * unit, values["SIH_LOC_H0"])
    kind: Kind = ("px4", "plane" if model == "sihsim_airplane" else "copter")
    speedup = float(os.environ.get("PX4_SIM_SPEED_FACTOR", "1"))
    link = _Towards(14580 + number, 14540 + number if number <= 9 else 14549)
    print("INFO  [px4] Startup script returned successfully")
    _fly(kind, number + 1, home, values, link, speedup)


def _whole(text: str) -> int:
    """Return what strtol makes of a number."""
    return int(text.partition(".")[0])


class _Towards(UdpEndpoint):
    """A socket bound to one port that speaks to another first, as PX4's are."""

    def __init__(self, port: int, remote: int) -> None:
        super().__init__(Address("udpin", "127.0.0.1", port))
        self._peers[("127.0.0.1", remote)] = None


def _fly(kind: Kind, sysid: int, home: GeoPoint, parameters: Mapping[str, Any], link: Endpoint, speedup: float) -> None:
    """Be a vehicle with these parameters, cold, until somebody ends it."""
    autopilot, vehicle_class = kind
    known = {name: value for name, value in parameters.items() if find(kind, name) is not None}
    values = {name: value for name, (_, value) in fields(kind, known).items()}
    motion = with_values(motion_model(VehicleSettings(autopilot=autopilot, vehicle_class=vehicle_class)), values)
    asking = _Asking(link, sysid, home)
    ground = asking.ground_amsl_m if parameters.get("SIM_TERRAIN") else None
    fleet = SimFleet([SimVehicle(sysid, autopilot, vehicle_class, home, motion)], ground=ground, cold_start=True)
    own = fleet.links[0].autopilot.parameters
    for name, value in parameters.items():
        if name in own:
            own[name] = round(value) if isinstance(own[name], int) else float(value)
        elif name.startswith("SIH_"):
            own[name] = value
        elif autopilot == "ardupilot":
            print(f"Ignored unknown param {name} in defaults file")
    fleet.attach(asking)
    crash_sysid, _, crash_s = os.environ.get("STAND_IN_CRASH", "").partition(":")
    pace_sysid, _, factor = os.environ.get("STAND_IN_PACE", "").partition(":")
    speedup *= float(factor) if pace_sysid == str(sysid) else 1.0

    def crashes() -> bool:
        if crash_sysid != str(sysid) or fleet.now_s < float(crash_s):
            return False
        print("ERROR: Floating point exception - aborting")
        if autopilot == "px4":
            os.kill(os.getpid(), signal.SIGABRT)
        _panic("floating point exception")
        return True

    serve(fleet, speedup, crashes)


class _Asking(WrappedEndpoint):
    """A link on which the ground station is asked for the ground; what else arrives meanwhile is kept."""

    def __init__(self, inner: Endpoint, sysid: int, home: GeoPoint) -> None:
        super().__init__(inner)
        self._codec = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=1)
        self._home = home
        self._frame = LocalFrame(home.lat_deg, home.lon_deg)
        self._arrived: list[tuple[bytes, Peer]] = []

    def receive(self) -> list[tuple[bytes, Peer]]:
        arrived, self._arrived = self._arrived, []
        return arrived + self._inner.receive()

    def ground_amsl_m(self, x_m: float, y_m: float) -> float:
        """Return how high the ground is: as far above or below home as the terrain says."""
        return self._home.alt_amsl_m + self._told(x_m, y_m) - self._told(0.0, 0.0)

    def _told(self, x_m: float, y_m: float) -> float:
        place = self._frame.geo_point((x_m, y_m, 0.0))
        lat, lon = round(place.lat_deg * 1e7), round(place.lon_deg * 1e7)
        request = mavlink.MAVLink_terrain_request_message(lat, lon, 30, 1)
        self._inner.send(bytes(request.pack(self._codec)))
        while True:
            pieces = self._inner.receive()
            self._arrived += pieces
            for data, _ in pieces:
                for message in self._codec.parse_buffer(data) or ():
                    if message.get_type() == "TERRAIN_DATA" and (message.lat, message.lon) == (lat, lon):
                        return float(message.data[0])
            time.sleep(0.001)


def _fail(text: str, code: int) -> Any:
    print(text)
    sys.exit(code)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
