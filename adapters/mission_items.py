"""A fleet plan as MAVLink mission items; the only place that scales degrees to 1e-7."""

from __future__ import annotations

from dataclasses import dataclass

DEGREE_SCALE = 10_000_000


@dataclass(frozen=True, slots=True)
class MissionItem:
    """One MISSION_ITEM_INT in wire names and wire units (https://mavlink.io/en/messages/common.html#MISSION_ITEM_INT).

    ``x`` and ``y`` are latitude and longitude in 1e-7 degrees; ``z`` is metres in the datum of ``frame``:
    0 (MAV_FRAME_GLOBAL) AMSL, 3 above home, 10 above ground; frame 2 (MAV_FRAME_MISSION) has no position.
    """

    seq: int
    frame: int
    command: int
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0
    x: int = 0
    y: int = 0
    z: float = 0.0
    current: int = 0
    autocontinue: int = 1


def degrees_to_wire(degrees: float) -> int:
    """Return degrees in units of 1e-7, rounded to the nearest (truncation is off by one for 6 % of values)."""
    return round(degrees * DEGREE_SCALE)
