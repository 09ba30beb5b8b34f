"""What one vehicle will fly, as its autopilot holds it: home, legs in order, an ending. The object of the proof.

A sortie is read back from what is exported or uploaded (mission items; see ``adapters.mission_items``), never taken
from the planner's memory. What of a mission has no path that is known is named in ``gaps``: nothing there is proven.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from missionplanner.geodesy import FloatArray
from missionplanner.vehicle import Autopilot, Ending, VehicleClass

LegKind = Literal["takeoff", "straight", "spline", "circle"]


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """One piece of a sortie, flown from where the one before it ended (the first from home).

    A take-off is vertical for copters. A circle is flown around ``end_m``; where on it the leg after it begins is not
    known. A hold above 0 is a stop.
    """

    seq: int  # of the mission item that asks for it
    kind: LegKind
    end_m: FloatArray  # (3,) local frame, z AMSL
    speed_m_s: float  # horizontal, commanded
    hold_s: float = 0.0
    radius_m: float = 0.0  # of a circle
    turns: float = math.inf  # of a circle, at most
    vertical_m_s: float = math.inf  # bound on its climb or descent rate that the mission sets


@dataclass(frozen=True, slots=True)
class Gap:
    """A mission item whose path, or whose effect on the path, is not known."""

    seq: int
    what: str  # e.g. "DO_JUMP: repeats items, its path is not followed"


@dataclass(frozen=True, slots=True, eq=False)
class Sortie:
    """One vehicle's flight. ``legs[0]`` is the take-off; after the last leg comes the ending."""

    name: str
    sysid: int
    autopilot: Autopilot
    vehicle_class: VehicleClass
    home_m: FloatArray  # (3,), where it stands
    legs: tuple[Leg, ...]
    ending: Ending
    ending_seq: int  # of the item that asks for it; of the last leg where none does
    start_delay_s: float
    return_height_m: float  # above home: the altitude its autopilot is set to return at (RTL_ALT, RTL_RETURN_ALT)
    gaps: tuple[Gap, ...] = ()
    notes: tuple[str, ...] = ()  # what a reader of the certificate should know; nothing here stands against a proof
