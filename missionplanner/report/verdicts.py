"""What is proven, as the report tells it: each leg's room to spare, the findings in a reader's order, one verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from missionplanner.certificate import Certificate, Check, Finding, LegVerdict, Position
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.motion.spline import spline_chords
from missionplanner.plan import Trajectory
from missionplanner.scene import VehicleTask
from missionplanner.sortie import Leg, Sortie

State = Literal["unproven", "waived", "proven"]
STATE_WORDS: Mapping[State, str] = {
    "unproven": "NOT PROVEN",
    "waived": "waived by the mission",
    "proven": "proven",
}
ENDINGS = frozenset({"land", "return", "rtl", "loiter"})
"""Kinds of legs that come after the mission's last waypoint."""

_CHECK_WORDS: dict[Check, str] = {
    "understood": "every item's path is known",
    "files": "mission files",
    "terrain": "ground below",
    "obstacle": "obstacles",
    "fence": "fence",
    "ceiling": "ceiling",
    "angle": "climb and descent",
    "turn": "turns",
    "speed": "speed",
    "takeoff": "take-off",
    "landing": "landing place",
    "energy": "energy",
    "return": "way home from everywhere",
    "separation": "separation",
    "lateness": "early or late",
    "arrival": "arrival",
    "rendezvous": "rendezvous",
    "inspection": "inspection",
}
_CHORD_M = 0.5
_ROUND = np.linspace(0.0, 2.0 * math.pi, 49)
_HASH_SHOWN = 12
_NAMED = 4
_PAIRS_LISTED = 24
_FLEET = "fleet"
_DASH = "\N{EN DASH}"


@dataclass(frozen=True, slots=True, eq=False)
class LegFacts:
    """One leg as it is drawn."""

    seq: int
    kind: str
    line_m: FloatArray  # (N, 3), along which it is flown
    wider_m: float  # by how much its tube is wider than the vehicle's: where on a circle it is, is not asked
    room_m: float  # least of what it keeps from ground, obstacles and fence beyond what it must
    over_terrain: bool  # whether a height above the ground is asked for
    proven: bool

    @property
    def ends(self) -> bool:
        """Whether it comes after the last waypoint."""
        return self.kind in ENDINGS


@dataclass(frozen=True, slots=True)
class FindingRow:
    """One finding in words."""

    state: State
    verdict: str
    who: str
    check: str
    detail: str
    remedy: str
    figure: str
    required: str
    where: str


@dataclass(frozen=True, slots=True)
class MissionRow:
    """Which mission of a vehicle is meant."""

    vehicle: str
    sha256: str
    return_height: str


@dataclass(frozen=True, slots=True)
class ProofSection:
    """The verdict and all that it rests on."""

    state: State
    headline: str
    open_rows: tuple[FindingRow, ...]  # not proven, then waived
    proven_rows: tuple[FindingRow, ...]
    proven_pairs_left: int  # proven, too, with more to spare than those that are listed
    assumptions: tuple[str, ...]
    missions: tuple[MissionRow, ...]
    software: str
    inputs: str


def judged(certificate: Certificate | None, names: Sequence[str], input_sha256: str) -> tuple[Finding, ...]:
    """Return the findings on a fleet; what the certificate leaves out, or says of other inputs, is not proven."""
    if certificate is None:
        return tuple(Finding("understood", name, False, "nothing is proven of it", "check it") for name in names)
    findings = list(certificate.findings)
    if certificate.input_sha256 != input_sha256:
        told = "the certificate is of another mission file or terrain"
        findings.append(Finding("files", "", False, told, "check it again"))
    known = {finding.vehicle for finding in findings}
    findings += [
        Finding("understood", name, False, "the certificate says nothing of it", "check it again")
        for name in names
        if name not in known
    ]
    return tuple(findings)


def section(certificate: Certificate | None, findings: Sequence[Finding], frame: LocalFrame) -> ProofSection:
    """Return what the page tells of findings (see :func:`judged`) and the certificate that they come from."""
    states = [_state(finding) for finding in findings]
    proven = [finding for finding in findings if finding.proven]
    kept = [*(f for f in proven if not _pair(f)), *sorted(filter(_pair, proven), key=_spare)[:_PAIRS_LISTED]]
    unproven = [_row(f, f.vehicle, frame) for f, state in zip(findings, states, strict=True) if state == "unproven"]
    return ProofSection(
        state=next((state for state in STATE_WORDS if state in states), "unproven"),
        headline=_headline(states),
        open_rows=(*unproven, *(_row(one, who, frame) for one, who in waived_together(findings))),
        proven_rows=tuple(_row(finding, finding.vehicle, frame) for finding in kept),
        proven_pairs_left=len(proven) - len(kept),
        assumptions=certificate.assumptions if certificate else (),
        missions=tuple(_missions(certificate)) if certificate else (),
        software=f"missionplanner {certificate.software_version}" if certificate else "",
        inputs=certificate.input_sha256[:_HASH_SHOWN] if certificate else "",
    )


def waived_together(findings: Sequence[Finding]) -> list[tuple[Finding, str]]:
    """Return what the mission waives, each thing once, and whom it is about."""
    told: dict[tuple[Check, str], list[Finding]] = {}
    for finding in findings:
        if _state(finding) == "waived":
            told.setdefault((finding.check, finding.detail), []).append(finding)
    return [(same[0], _names([f.vehicle or _FLEET for f in same])) for same in told.values()]


def lateness_words(findings: Sequence[Finding]) -> str:
    """Return how early or late vehicles may be while all keep apart; nothing where that is not asked."""
    late = next((finding for finding in findings if finding.check == "lateness"), None)
    if late is None or late.value is None:
        return ""
    asked = f", asked for is {late.required:g} s" if late.required is not None else ""
    return (
        f"All keep apart while none is more than {floored(late.value, 1)} s early or late"
        f"{asked}{'' if late.holds else ': NOT PROVEN'}."
    )


def leg_facts(
    task: VehicleTask,
    verdicts: Sequence[LegVerdict],
    findings: Sequence[Finding],
    sortie: Sortie,
    trajectory: Trajectory,
    reached_s: FloatArray,
) -> tuple[LegFacts, ...]:
    """Return one vehicle's legs as they are drawn: copters along the legs, planes along the predicted flight.

    A leg counts as not proven, too, where a finding that does not hold names its item, and from the first item on
    whose path is not known.
    """
    open_ = [f for f in findings if f.vehicle == task.name and not f.holds and f.seq is not None]
    named = {f.seq for f in open_}
    lost = min((f.seq for f in open_ if f.check == "understood" and f.seq is not None), default=math.inf)
    return tuple(
        LegFacts(
            seq=verdict.seq,
            kind=verdict.kind,
            line_m=_line(verdict, sortie, trajectory, reached_s),
            wider_m=_wider_m(verdict, sortie),
            room_m=_room_m(task, verdict),
            over_terrain=verdict.terrain_m is not None,
            proven=verdict.proven and verdict.seq not in named and verdict.seq < lost,
        )
        for verdict in verdicts
        if verdict.vehicle == task.name
    )


def floored(value: float, digits: int) -> str:
    """Return a proven least figure rounded down, so that the page never promises more than is proven."""
    return f"{math.floor(round(value * 10**digits, 6)) / 10**digits:.{digits}f}"


def _place(verdict: LegVerdict, sortie: Sortie) -> int:
    """Return which of a sortie's legs a verdict is about; their number for what comes after them, -1 for none."""
    if verdict.kind in ENDINGS:
        return len(sortie.legs)
    return next((k for k, leg in enumerate(sortie.legs) if leg.seq == verdict.seq), -1)


def _wider_m(verdict: LegVerdict, sortie: Sortie) -> float:
    index = _place(verdict, sortie)
    if sortie.vehicle_class == "plane" or index < 0 or (verdict.kind == "land" and sortie.ending != "land"):
        return 0.0
    circles = [leg for leg in sortie.legs[max(index - 1, 0) : index + 1] if leg.kind == "circle"]
    return max((leg.radius_m for leg in circles), default=0.0)


def _line(verdict: LegVerdict, sortie: Sortie, trajectory: Trajectory, reached_s: FloatArray) -> FloatArray:
    straight = np.array([verdict.start_m, verdict.end_m])
    index = _place(verdict, sortie)
    if index < 0:
        return straight
    if sortie.vehicle_class == "plane":
        begin_s = float(reached_s[index - 1]) if index else float(trajectory.t_s[0])
        end_s = float(reached_s[index]) if index < len(reached_s) else float(trajectory.t_s[-1])
        inside = (trajectory.t_s > begin_s) & (trajectory.t_s < end_s)
        return trajectory.at(np.concatenate([[begin_s], trajectory.t_s[inside], [end_s]]))
    if verdict.kind == "spline":
        return spline_chords(sortie, index, _CHORD_M)
    if verdict.kind == "circle":
        return np.concatenate([straight[:1], _circle(sortie.legs[index], straight)])
    if verdict.kind == "return":
        corner = np.array([*verdict.start_m[:2], verdict.end_m[2]])
        return np.stack([straight[0], corner, straight[1]])
    return straight


def _circle(leg: Leg, way: FloatArray) -> FloatArray:
    """Return a leg's circle (N, 3), from where its way (2, 3) to the middle meets it."""
    turn = math.atan2(way[0, 1] - way[1, 1], way[0, 0] - way[1, 0]) + _ROUND
    ring = leg.radius_m * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    return np.asarray(leg.end_m + ring)


def _room_m(task: VehicleTask, verdict: LegVerdict) -> float:
    limits = task.limits
    kept = [verdict.fence_m - limits.obstacle_margin_m]
    if verdict.terrain_m is not None:
        kept.append(verdict.terrain_m - limits.terrain_margin_m)
    if verdict.obstacle_m is not None:
        kept.append(verdict.obstacle_m - limits.obstacle_margin_m)
    return min(kept) if not any(map(math.isnan, kept)) else -math.inf


def _headline(states: Sequence[State]) -> str:
    open_, waived = states.count("unproven"), states.count("waived")
    if not states:
        return "NOT PROVEN: nothing was checked."
    if open_:
        also = f"; {waived} waived by the mission" if waived else ""
        return f"NOT PROVEN: {open_} of {_checks(len(states))}{also}."
    if waived:
        return f"Proven but for what the mission waives: {waived} of {_checks(len(states))}."
    return f"Proven: {'all ' if len(states) > 1 else ''}{_checks(len(states))}."


def _checks(count: int) -> str:
    return f"{count} check{'s' if count != 1 else ''}"


def _names(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_NAMED])
    return shown if len(names) <= _NAMED else f"{shown} and {len(names) - _NAMED} more"


def _state(finding: Finding) -> State:
    return "proven" if finding.proven else "waived" if finding.waived else "unproven"


def _pair(finding: Finding) -> bool:
    return " - " in finding.vehicle


def _spare(finding: Finding) -> float:
    """Return how much more a distance or time between two is than it must be; those without figures come last."""
    if finding.value is None or finding.required is None:
        return math.inf
    return finding.value - finding.required


def _row(finding: Finding, who: str, frame: LocalFrame) -> FindingRow:
    state = _state(finding)
    return FindingRow(
        state=state,
        verdict=STATE_WORDS[state],
        who=who or _FLEET,
        check=_CHECK_WORDS[finding.check],
        detail=finding.detail,
        remedy="" if finding.proven else finding.remedy,
        figure=_figure(finding, finding.value),
        required=_figure(finding, finding.required),
        where="; ".join(_where(finding, frame)),
    )


def _figure(finding: Finding, value: float | None) -> str:
    """Return a figure with its unit, rounded so that what is proven is told no better, what is not no nearer."""
    if value is None:
        return _DASH
    if not math.isfinite(value):
        return "not known"
    percent = finding.check == "inspection"
    scaled, unit = (100.0 * value, "%") if percent else (value, finding.unit)
    if value == finding.required:
        return f"{scaled:g} {unit}".rstrip()
    enough = finding.required is None or value > finding.required
    digits = 0 if percent else 2
    # towards what is required where it is proven, away from it where it is not
    told = (
        floored(scaled, digits) if enough == finding.proven else f"{0.0 - float(floored(-scaled, digits)):.{digits}f}"
    )
    return f"{told} {unit}".rstrip()


def _where(finding: Finding, frame: LocalFrame) -> Iterator[str]:
    if finding.seq is not None:
        yield f"item {finding.seq}"
    if finding.position_m is not None and all(map(math.isfinite, finding.position_m)):
        yield place_words(frame, finding.position_m)
    if finding.t_s is not None and math.isfinite(finding.t_s):
        yield f"at {finding.t_s:.0f} s"


def place_words(frame: LocalFrame, position_m: Position) -> str:
    """Return latitude, longitude and altitude AMSL of a place."""
    point = frame.geo_point(position_m)
    return f"{point.lat_deg:.5f}, {point.lon_deg:.5f}, {point.alt_amsl_m:.0f} m"


def _missions(certificate: Certificate) -> Iterator[MissionRow]:
    for name in {**certificate.return_height_m, **certificate.mission_sha256}:
        sha256, height_m = certificate.mission_sha256.get(name), certificate.return_height_m.get(name)
        yield MissionRow(
            vehicle=name,
            sha256=_DASH if sha256 is None else sha256[:_HASH_SHOWN],
            return_height=_DASH if height_m is None else f"{height_m:g} m above home",
        )
