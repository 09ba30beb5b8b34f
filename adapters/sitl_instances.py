"""How real autopilot code is started in its makers' simulators (SITL): one instance per vehicle of a plan.

What the programs want to be told is theirs to say: ArduPilot's libraries/AP_HAL_SITL/SITL_cmdline.cpp; PX4's
platforms/posix/src/px4/common/main.cpp and ROMFS/px4fmu_common/init.d-posix (rcS, px4-rc.simulator, px4-rc.mavlink).
What of it matters here:

- ArduPilot, instance i: MAVLink on TCP 5760 + 10 i, and it stands still until somebody connects there; it exits where
  that port, the next two or UDP 5501 + 10 i are taken. Files named by ``--defaults`` replace the defaults that newer
  builds know by themselves, so what the simulated airframe needs to be armed at all is written as well.
- PX4, instance i: its sysid is i + 1, whatever is set, so the instance follows from the sysid. It sends from UDP
  14580 + i to 14540 + i, from the tenth on to 14549. ``PX4_PARAM_NAME`` sets a parameter before anything starts. Its
  simulator (SIH) begins where SIH_LOC_LAT0 says: in whole 1e-7 degrees up to 1.15, in degrees since; the type tells.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import socket
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np

from adapters.return_settings import return_settings
from missionplanner.autopilot_parameters import Kind, parameters, shown, value_of
from missionplanner.errors import LinkError, MissionError
from missionplanner.geodesy import FloatArray, GeoPoint
from missionplanner.plan import FleetPlan, VehiclePlan

Ground = Callable[[FloatArray, FloatArray], FloatArray]
"""Altitudes AMSL (...) of the ground at places x_m, y_m (...) of the plan's frame; NaN where it is not known."""
Programs = Mapping[Kind, Path]
Port = tuple[Literal["tcp", "udp"], int]

_KINDS: dict[str, tuple[Kind, ...]] = {
    "ardupilot": (("ardupilot", "copter"),),  # or a plane, by the program's name
    "arducopter": (("ardupilot", "copter"),),
    "ardupilot-copter": (("ardupilot", "copter"),),
    "arduplane": (("ardupilot", "plane"),),
    "ardupilot-plane": (("ardupilot", "plane"),),
    "px4": (("px4", "copter"), ("px4", "plane")),
    "px4-copter": (("px4", "copter"),),
    "px4-plane": (("px4", "plane"),),
}
_LOG = "sitl.log"
DEFAULTS = "defaults.parm"


# Without these a simulated airframe is not set up, or fails its pre-arm checks as never calibrated. They are what the
# autopilot's own tools give it (Tools/autotest), from where they are taken when the program lies in its source tree.
_CALIBRATED = {
    **{f"COMPASS_OFS{n}_{axis}": value for n in ("", "2", "3") for axis, value in (("X", 5), ("Y", 13), ("Z", -18))},
    **{f"INS_ACC{n}OFFS_{axis}": 0.001 for n in ("", "2") for axis in "XYZ"},
    **{f"INS_ACC{n}SCAL_{axis}": 1.001 for n in ("", "2") for axis in "XYZ"},
    **{f"RC{n}_{what}": value for n in range(1, 9) for what, value in (("MIN", 1000), ("MAX", 2000), ("TRIM", 1500))},
    "BATT_MONITOR": 4,
}
_AIRFRAMES: dict[Kind, dict[str, float]] = {
    ("ardupilot", "copter"): {**_CALIBRATED, "FRAME_CLASS": 1, "FRAME_TYPE": 0, "MOT_THST_HOVER": 0.39},
    ("ardupilot", "plane"): {
        **_CALIBRATED,
        **{"RC3_TRIM": 1000, "SERVO3_MIN": 1000, "SERVO3_MAX": 2000, "FLTMODE_CH": 8, "ARSPD_USE": 1},
        **{"TRIM_THROTTLE": 50, "KFF_RDDRMIX": 0.5, "INS_GYR_CAL": 0},
        **{"LIM_PITCH_MIN": -2000, "LIM_PITCH_MAX": 2500, "PTCH_LIM_MIN_DEG": -20, "PTCH_LIM_MAX_DEG": 25},
        **{"RLL_RATE_D": 0.01743, "RLL_RATE_FF": 0.237212, "RLL_RATE_I": 0.25, "RLL_RATE_P": 0.3},
        **{"PTCH_RATE_D": 0.007265, "PTCH_RATE_FF": 0.595723, "PTCH_RATE_I": 0.11, "PTCH_RATE_P": 0.15},
        **{"RLL2SRV_RMAX": 90, "RLL2SRV_TCONST": 0.25, "PTCH2SRV_RMAX_DN": 90, "PTCH2SRV_RMAX_UP": 90},
        **{"PTCH2SRV_TCONST": 0.25},
    },
}
_BUILT = ("build/sitl/bin/arducopter", "build/px4_sitl_default/bin/px4", "bin/px4")  # in source and build trees
_TREE_DEFAULTS = {
    "copter": ("Tools/autotest/default_params/copter.parm",),
    "plane": ("Tools/autotest/models/plane.parm", "Tools/autotest/default_params/plane.parm"),
}
_TERRAIN_SPACING_M, _TERRAIN_BLOCKS = 30, 128
_NUMBERS = 1000  # of ArduPilot instances that are tried
_LEVEL_M = 1.0  # ground this even is flown over as level
_MODELS = {"copter": ("sihsim_quadx", "10040"), "plane": ("sihsim_airplane", "10041")}


def sitl_programs(texts: Sequence[str]) -> Programs:
    """Read what ``--sitl`` says: ``AUTOPILOT=PROGRAM``, several separated by commas, or programs that their names tell.

    Raises
    ------
    MissionError
        An unknown autopilot, one given twice, or a program that cannot be run.
    """
    if os.name != "posix":
        raise MissionError("--sitl: expected Linux or macOS, where the autopilots' simulators run as they are")
    programs: dict[Kind, Path] = {}
    for text in (part.strip() for given in texts for part in given.split(",")):
        key, equals, name = text.partition("=")
        if not equals:
            key, name = "", text
        key, path = key.strip().lower(), _program(name.strip())
        called = path.name.lower()
        if key == "ardupilot" and "plane" in called:
            key = "arduplane"
        if not key:
            key = next((k for k in ("arducopter", "arduplane", "px4") if k in called), "")
        if key not in _KINDS:
            raise MissionError(
                f"--sitl: expected AUTOPILOT=PROGRAM with one of {', '.join(_KINDS)}, e.g. "
                f"ardupilot=/path/to/arducopter, got {text!r}"
            )
        for kind in _KINDS[key]:
            if programs.setdefault(kind, path) != path:
                raise MissionError(
                    f"--sitl: expected one program for {' '.join(kind)}, got {programs[kind]} and {path}"
                )
    return programs


def _program(name: str) -> Path:
    """Return the absolute path of a program, given by a path or by a name that the shell would find."""
    if not name:
        raise MissionError("--sitl: expected the path of a program, e.g. ardupilot=/path/to/arducopter, got none")
    path = Path(name).expanduser()
    if path.parent == Path() and not path.exists() and "/" not in name:
        found = shutil.which(name)
        path = path if found is None else Path(found)
    path = path.absolute()  # symbolic links stay: some programs go by the name that they are called by
    if not path.exists():
        raise MissionError(f"--sitl: expected a program that can be run, got {path}: there is no such file")
    if not path.is_file():
        inside = [path / name for name in _BUILT if (path / name).is_file()]
        remedy = f": take {inside[0]}" if inside else ""
        raise MissionError(f"--sitl: expected a program that can be run, got {path}: it is a folder{remedy}")
    if not os.access(path, os.X_OK):
        raise MissionError(f"--sitl: expected a program that can be run, got {path}: make it executable (chmod +x)")
    return path


@dataclass(frozen=True, slots=True)
class Instance:
    """How one vehicle's simulator is started, and where it then speaks.

    ``environment`` is added to ours. ``defaults`` is written to the file that its command names, where there is any.
    """

    vehicle: VehiclePlan
    folder: Path  # its working folder
    command: tuple[str, ...]
    environment: Mapping[str, str]
    url: str  # of our end of the link
    ports: tuple[Port, ...]  # that it takes
    defaults: Mapping[str, float] = field(default_factory=dict)

    @property
    def log(self) -> Path:
        """Where all goes that it prints."""
        return self.folder / _LOG


def sitl_instances(
    plan: FleetPlan,
    programs: Programs,
    folder: Path,
    *,
    speedup: float = 1.0,
    ground: Ground | None = None,
    wind_m_s: tuple[float, float] | None = None,
    whole_degrees: bool = False,
    numbers: Sequence[int] | None = None,
) -> tuple[Instance, ...]:
    """Return how the simulators of a plan's vehicles are started, each at its home, with what it was planned with.

    Parameters
    ----------
    folder : each vehicle gets a folder of its name in it
    speedup : times real time
    ground : what the vehicles fly over; None: level ground
    wind_m_s : (east, north) that blows instead of the wind planned for
    whole_degrees : PX4's homes in whole 1e-7 degrees, as up to 1.15
    numbers : of ArduPilot's instances, which decide on their ports; by default from 0 on

    Raises
    ------
    MissionError
        No program for a vehicle; ground that its simulator does not know.
    """
    if not (math.isfinite(speedup) and speedup > 0.0):
        raise MissionError(f"--speedup: expected a number above 0, got {speedup}")
    instances: list[Instance] = []
    free = iter(range(len(plan.vehicles)) if numbers is None else numbers)
    for vehicle in plan.vehicles:
        kind: Kind = (vehicle.autopilot, vehicle.vehicle_class)
        program = programs.get(kind)
        if program is None:
            raise MissionError(
                f"--sitl: {vehicle.name} ({' '.join(kind)}): expected its program as well, e.g. "
                f"{'-'.join(kind)}=/path/to/{_usual_name(kind)}"
            )
        home = plan.frame.geo_point(vehicle.home_m)
        wind = vehicle.motion.wind_m_s if wind_m_s is None else wind_m_s
        own = (folder / vehicle.name).absolute()
        level = _level(vehicle, ground)
        if kind[0] == "ardupilot":
            instances.append(_ardupilot(vehicle, next(free), program, own, home, wind, speedup, level=level))
        elif level:
            instances.append(_px4(vehicle, program, own, home, wind, speedup, whole_degrees=whole_degrees))
        else:
            raise MissionError(
                f"--sitl: {vehicle.name} flies over uneven ground, and PX4 simulates level ground only, as high as its "
                "home: fly it without --sitl"
            )
    return tuple(instances)


def _usual_name(kind: Kind) -> str:
    return "px4" if kind[0] == "px4" else f"ardu{kind[1]}"


def _level(vehicle: VehiclePlan, ground: Ground | None) -> bool:
    """Return whether the ground beneath a flight is as high as its home, as far as it matters to the flight."""
    if ground is None:
        return True
    path_m = vehicle.trajectory.position_m
    beneath_m = ground(path_m[:, 0], path_m[:, 1])
    beneath_m = np.where(np.isnan(beneath_m), vehicle.home_m[2], beneath_m)
    lands_m = beneath_m[-1] if vehicle.end == "land" else vehicle.home_m[2]
    airborne_m = path_m[:-1, 2].min()
    return bool(abs(lands_m - vehicle.home_m[2]) <= _LEVEL_M and airborne_m >= vehicle.home_m[2] - _LEVEL_M)


def _ardupilot(
    vehicle: VehiclePlan,
    number: int,
    program: Path,
    folder: Path,
    home: GeoPoint,
    wind_m_s: tuple[float, float],
    speedup: float,
    *,
    level: bool,
) -> Instance:
    if "," in str(folder):
        raise MissionError(f"{folder}: expected a folder without commas: ArduPilot's simulator takes them for lists")
    kind: Kind = (vehicle.autopilot, vehicle.vehicle_class)
    towards_m = vehicle.waypoints_m[:, :2] - vehicle.home_m[:2]
    away = np.flatnonzero(np.hypot(*towards_m.T) > 1.0)  # a plane takes off the way it faces
    east_m, north_m = towards_m[away[0]] if len(away) else (0.0, 1.0)
    heading_deg = math.degrees(math.atan2(east_m, north_m)) % 360.0
    speed_m_s = math.hypot(*wind_m_s)
    defaults = {
        **_AIRFRAMES[kind],
        **_tree_defaults(program, kind),
        **planned_parameters(vehicle),
        **{"SYSID_THISMAV": vehicle.sysid, "MAV_SYSID": vehicle.sysid, "SIM_SPEEDUP": speedup},
        **{"SIM_WIND_SPD": speed_m_s, "SIM_WIND_T": 1},  # the same at all heights
        "SIM_WIND_DIR": math.degrees(math.atan2(-wind_m_s[0], -wind_m_s[1])) % 360.0,  # where it comes from
        **{"SIM_TERRAIN": int(not level), "TERRAIN_ENABLE": int(not level), "TERRAIN_SPACING": _TERRAIN_SPACING_M},
        "TERRAIN_CACHE_SZ": _TERRAIN_BLOCKS,  # where it forgets a block, the ground leaps to the height of its home
    }
    return Instance(
        vehicle,
        folder,
        (
            *(str(program), "--model", "quad" if vehicle.vehicle_class == "copter" else "plane"),
            *("--home", f"{home.lat_deg:.8f},{home.lon_deg:.8f},{home.alt_amsl_m:.2f},{heading_deg:.1f}"),
            *("--speedup", f"{speedup:g}", "--defaults", str(folder / DEFAULTS)),
            *("-I", str(number), "--sysid", str(vehicle.sysid)),
        ),
        {"SITL_PANIC_EXIT": "1"},  # else it lingers after what it cannot go on from
        f"tcp:127.0.0.1:{5760 + 10 * number}",
        _ardupilot_ports(number),
        defaults,
    )


def _ardupilot_ports(number: int) -> tuple[Port, ...]:
    first = 5760 + 10 * number
    return ("tcp", first), ("tcp", first + 2), ("tcp", first + 3), ("udp", 5501 + 10 * number)


def free_numbers(count: int) -> list[int]:
    """Return numbers of ArduPilot instances whose ports nobody uses: simulators of others are left alone.

    Raises
    ------
    LinkError
        There are too few.
    """
    free = (number for number in range(_NUMBERS) if all(map(is_free, _ardupilot_ports(number))))
    found = list(islice(free, count))
    if len(found) < count:
        raise LinkError(
            f"--sitl: expected free ports for {count} simulators, found them for {len(found)}; nothing started"
        )
    return found


def is_free(port: Port) -> bool:
    """Return whether a port can be listened on."""
    kind, number = port
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM) as probe:
        if kind == "tcp":  # a connection that was closed just now is no obstacle
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("0.0.0.0", number))
        except OSError:
            return False
    return True


def _tree_defaults(program: Path, kind: Kind) -> dict[str, float]:
    """Return what the autopilot's own tools give its airframe, where the program lies in its source tree."""
    for parent in program.resolve().parents:
        for name in _TREE_DEFAULTS[kind[1]]:
            if (parent / name).is_file():
                found: dict[str, float] = {}
                for line in (parent / name).read_text(errors="replace").splitlines():
                    words = re.split(r"[\s,=]+", line.partition("#")[0].strip())
                    with contextlib.suppress(ValueError):
                        found |= {words[0]: float(words[1])} if len(words) > 1 else {}
                return found
    return {}


def planned_parameters(vehicle: VehiclePlan) -> dict[str, float]:
    """Return what decides how it moves and returns, under every name that firmware may know it by."""
    kind: Kind = (vehicle.autopilot, vehicle.vehicle_class)
    moving = {
        spelling.name: _kept(value_of(vehicle.motion, parameter.field) * spelling.per_unit, whole=spelling.whole)
        for parameter in parameters(kind)
        if not parameter.sent
        for spelling in parameter.spellings
    }
    returning = {
        name: setting.value / unit
        for setting in return_settings(*kind, vehicle.motion.return_height_m)
        for name, unit in setting.units
    }
    return moving | returning


def _kept(value: float, *, whole: bool) -> float:
    return float(round(value)) if whole else float(np.float32(value))


def _px4(
    vehicle: VehiclePlan,
    program: Path,
    folder: Path,
    home: GeoPoint,
    wind_m_s: tuple[float, float],
    speedup: float,
    *,
    whole_degrees: bool,
) -> Instance:
    number = vehicle.sysid - 1
    etc = _px4_files(program)
    if not (program.parent / "px4-alias.sh").exists():  # it looks for its commands where it is called
        program = program.resolve()
    model, airframe = _MODELS[vehicle.vehicle_class]
    known = etc is not None and any((etc / "init.d-posix" / "airframes").glob(f"*_{model}"))
    environment = {
        **{f"PX4_PARAM_{name}": shown(value) for name, value in planned_parameters(vehicle).items()},
        # the simulator adds them to the velocity: they say where the wind comes from
        **{"PX4_PARAM_SIH_WIND_E": shown(-wind_m_s[0]), "PX4_PARAM_SIH_WIND_N": shown(-wind_m_s[1])},
        **{"PX4_SIM_MODEL": model, "PX4_SIMULATOR": "sihsim"},
        **({} if speedup == 1.0 else {"PX4_SIM_SPEED_FACTOR": f"{speedup:g}"}),  # where set, it needs more programs
        **({} if known else {"PX4_SYS_AUTOSTART": airframe}),
        "PX4_HOME_LAT": str(round(home.lat_deg * 1e7)) if whole_degrees else f"{home.lat_deg:.7f}",
        "PX4_HOME_LON": str(round(home.lon_deg * 1e7)) if whole_degrees else f"{home.lon_deg:.7f}",
        "PX4_HOME_ALT": f"{home.alt_amsl_m:.2f}",
        "XDG_DATA_HOME": str(folder),  # where an installed program, which knows its files itself, works
    }
    return Instance(
        vehicle,
        folder,
        (str(program), "-d", "-i", str(number), *((str(etc),) if etc is not None else ())),
        environment,
        f"udpin:127.0.0.1:{min(14540 + number, 14549)}",
        (("udp", 14580 + number), ("udp", 18570 + number)),
    )


def _px4_files(program: Path) -> Path | None:
    """Return the folder with the program's start-up files, as in a build tree or an installation beside it."""
    for parent in list(program.resolve().parents)[:3]:
        for etc in (parent / "etc", parent / "share" / "px4" / "etc"):
            if (etc / "init.d-posix" / "rcS").is_file():
                return etc
    return None
