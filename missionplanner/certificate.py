"""What is proven of a fleet's missions, item by item, under which stated assumptions; and which missions those are.

A certificate holds for exactly the missions whose hashes it names, over the terrain and obstacles whose hash it names.
What could not be decided is not proven; what the mission file waives is told as waived, never as proven.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Position = tuple[float, float, float]

_TOLD = 3  # problems that a refusal names

Check = Literal[
    "understood",  # every item's path is known
    "files",  # mission files hold what the plan holds
    "terrain",
    "obstacle",
    "fence",
    "ceiling",
    "angle",  # climb and descent (PAPER.md eq. 7)
    "turn",  # turn radius and turn angle (eqs 5 and 8)
    "speed",
    "takeoff",
    "landing",
    "energy",
    "return",  # the direct way home from every point
    "separation",  # eq. 9
    "lateness",
    "arrival",  # eq. 10
    "rendezvous",  # who is to meet on the way does
    "inspection",  # eq. 6
]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was to be proven, of one vehicle, a pair ("a - b") or the fleet ("")."""

    check: Check
    vehicle: str
    proven: bool
    detail: str  # one line: what holds, or what does not and where
    remedy: str = ""  # what to do about it
    value: float | None = None  # a proven bound: least distance, greatest angle, ...
    required: float | None = None
    unit: str = "m"
    to: str = ""  # the obstacle it is about
    seq: int | None = None  # the mission item whose leg it is about
    position_m: Position | None = None  # local frame, z AMSL
    t_s: float | None = None
    waived: bool = False  # the mission file does not ask for it

    @property
    def holds(self) -> bool:
        """Whether nothing stands against flying: proven, or not asked for."""
        return self.proven or self.waived

    def __str__(self) -> str:
        who = f"{self.vehicle}: " if self.vehicle else ""
        item = f"item {self.seq}: " if self.seq is not None else ""
        return f"{who}{item}{self.detail}{f': {self.remedy}' if self.remedy else ''}"


@dataclass(frozen=True, slots=True)
class LegVerdict:
    """What is proven of one leg: what its whole tube keeps from the ground, obstacles and fence at least."""

    vehicle: str
    seq: int
    kind: str
    start_m: Position
    end_m: Position
    terrain_m: float | None  # None: not asked for here (take-off, landing)
    obstacle_m: float | None  # None: there is none
    obstacle: str
    fence_m: float
    proven: bool


@dataclass(frozen=True, slots=True)
class Certificate:
    """The proof of a fleet."""

    findings: tuple[Finding, ...]
    legs: tuple[LegVerdict, ...]
    assumptions: tuple[str, ...]  # all figures that the proof rests on, a line each
    mission_sha256: Mapping[str, str]  # by vehicle's name, of its mission items as sent
    return_height_m: Mapping[str, float]  # by vehicle's name, above home
    input_sha256: str  # of mission file and terrain
    software_version: str

    @property
    def proven(self) -> bool:
        """Whether everything asked for is proven."""
        return all(finding.holds for finding in self.findings)

    @property
    def problems(self) -> tuple[Finding, ...]:
        """What is not proven."""
        return tuple(finding for finding in self.findings if not finding.holds)

    @property
    def refusal(self) -> str:
        """What is not proven in one line: the first few problems, and how many more there are."""
        told, left = [str(finding) for finding in self.problems[:_TOLD]], len(self.problems) - _TOLD
        return "; ".join([*told, f"and {left} more" if left > 0 else ""]).removesuffix("; ")

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "proven": self.proven,
            "findings": [_finding(finding) for finding in self.findings],
            "legs": [_leg(leg) for leg in self.legs],
            "assumptions": list(self.assumptions),
            "mission_sha256": dict(self.mission_sha256),
            "return_height_m": dict(self.return_height_m),
            "input_sha256": self.input_sha256,
            "software_version": self.software_version,
        }


def _finding(f: Finding) -> dict[str, Any]:
    return {
        "check": f.check,
        "vehicle": f.vehicle,
        "proven": f.proven,
        "waived": f.waived,
        "detail": f.detail,
        "remedy": f.remedy,
        "value": _rounded(f.value),
        "required": _rounded(f.required),
        "unit": f.unit,
        "to": f.to,
        "seq": f.seq,
        "position_m": None if f.position_m is None else [_rounded(v) for v in f.position_m],
        "t_s": _rounded(f.t_s),
    }


def _leg(leg: LegVerdict) -> dict[str, Any]:
    return {
        "vehicle": leg.vehicle,
        "seq": leg.seq,
        "kind": leg.kind,
        "start_m": [_rounded(v) for v in leg.start_m],
        "end_m": [_rounded(v) for v in leg.end_m],
        "terrain_m": _rounded(leg.terrain_m),
        "obstacle_m": _rounded(leg.obstacle_m),
        "obstacle": leg.obstacle,
        "fence_m": _rounded(leg.fence_m),
        "proven": leg.proven,
    }


def _rounded(value: float | None) -> float | None:
    """Return a figure to the millimetre; what is not finite is null in JSON."""
    return None if value is None or not math.isfinite(value) else round(value, 3)
