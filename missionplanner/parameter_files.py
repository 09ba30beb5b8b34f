"""Parameter files of ground stations, read and written: Mission Planner's, MAVProxy's and QGroundControl's.

- ``.param`` (Mission Planner): ``NAME,VALUE``
- ``.parm`` (MAVProxy): ``NAME VALUE``
- ``.params`` (QGroundControl): vehicle, component, name, value and MAV_PARAM_TYPE, between tabs

What a file is, is seen line by line, not by its name; ``#`` begins a comment.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from missionplanner.autopilot_parameters import shown
from missionplanner.errors import MissionError
from missionplanner.files import write_atomic

SUFFIXES = (".param", ".parm", ".params")
AUTOPILOT_COMPONENT = 1
REAL32 = 9
"""MAV_PARAM_TYPE_REAL32."""

_MAX_BYTES = 4 * 1024 * 1024
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,15}")


@dataclass(frozen=True, slots=True)
class FileValue:
    """A parameter's value, and the line of the file where it stands."""

    value: float
    line: int


def read_parameters(path: Path) -> dict[str, FileValue]:
    """Read a parameter file of any of the three kinds, by name; of QGroundControl's, the autopilot's parameters.

    Raises
    ------
    MissionError
        The file cannot be read, has a line that is none of a parameter, a parameter twice with different values,
        parameters of several vehicles, or none.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        reason = "a folder" if path.is_dir() else error.strerror
        raise MissionError(f"{path}: expected a parameter file that can be read, got: {reason}") from error
    if len(content) > _MAX_BYTES:
        raise MissionError(f"{path}: expected a parameter file of at most {_MAX_BYTES} bytes, got more")
    return parse_parameters(content.decode("utf-8-sig", "replace"), str(path))


def parse_parameters(text: str, source: str) -> dict[str, FileValue]:
    """Read parameters from text; ``source`` names it in errors.

    Raises
    ------
    MissionError
        As :func:`read_parameters`.
    """
    found: dict[str, FileValue] = {}
    vehicle: str | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        parts = line.partition("#")[0].replace(",", " ").split()
        if not parts:
            continue
        if len(parts) == 5 and parts[0].isdigit() and parts[1].isdigit():
            sysid, component, name, written, _ = parts
            if vehicle is not None and sysid != vehicle:
                raise MissionError(
                    f"{source}:{number}: expected the parameters of one vehicle, got those of {vehicle} and {sysid}: "
                    "save one file for each"
                )
            vehicle = sysid
            if int(component) != AUTOPILOT_COMPONENT:
                continue
        elif len(parts) == 2:
            name, written = parts
        else:
            raise MissionError(f"{source}:{number}: {_EXPECTED}, got {line.strip()[:60]!r}")
        value = _number(written)
        if value is None or _NAME.fullmatch(name) is None:
            raise MissionError(f"{source}:{number}: {_EXPECTED}, got {line.strip()[:60]!r}")
        first = found.setdefault(name, FileValue(value, number))
        if first.value != value and value == value:  # noqa: PLR0124  # NaN
            raise MissionError(
                f"{source}:{number}: {name} is {shown(value)} here and {shown(first.value)} in line {first.line}: "
                "keep one"
            )
    if not found:
        raise MissionError(f"{source}: {_EXPECTED}, got none")
    return found


def expect_suffix(path: Path) -> None:
    """Check that a file's name tells what kind it is to be.

    Raises
    ------
    MissionError
        It does not.
    """
    if path.suffix not in SUFFIXES:
        raise MissionError(f"{path}: expected a name that ends in {', '.join(SUFFIXES)}, got {path.suffix!r}")


def write_parameters(
    path: Path, values: Mapping[str, float], sysid: int, types: Mapping[str, int], remark: str
) -> None:
    """Write a parameter file of the kind that its suffix tells; ``types`` are MAV_PARAM_TYPEs, ``remark`` its head.

    Raises
    ------
    MissionError
        Another suffix, or a place that cannot be written to.
    """
    expect_suffix(path)
    ordered = sorted(values.items())
    match path.suffix:
        case ".param":
            lines = [f"{name},{shown(value)}" for name, value in ordered]
        case ".parm":
            lines = [f"{name:<16} {shown(value)}" for name, value in ordered]
        case _:
            lines = [
                f"{sysid}\t{AUTOPILOT_COMPONENT}\t{name}\t{shown(value)}\t{types.get(name, REAL32)}"
                for name, value in ordered
            ]
    write_atomic(path, "\n".join([f"# {remark}", *lines]) + "\n")


_EXPECTED = "expected NAME,VALUE (Mission Planner), NAME VALUE (MAVProxy) or QGroundControl's five columns"


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
