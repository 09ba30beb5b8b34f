"""Who looks at which tower and span, in which sortie and when, and what was seen of it: one row for every visit."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from missionplanner.geodesy import FloatArray
from missionplanner.inspection import InspectionPlan, Round
from missionplanner.mission import Inspection
from missionplanner.plan import VehiclePlan
from missionplanner.scene import Scene
from missionplanner.views import Visit
from missionplanner.waypoints import passes

if TYPE_CHECKING:
    from missionplanner.coverage import Coverage

Status = Literal["planned", "left out", "done before"]


@dataclass(frozen=True, slots=True)
class Sortied:
    """When a vehicle pays a visit. Times count from its round's start; rounds and places in a sortie from 1."""

    vehicle: str
    sysid: int
    round: int
    order: int
    begins_s: float  # at its first viewpoint
    ends_s: float  # when it leaves the last one
    round_begins_s: float  # after the first round's start, batteries changed between
    photos: int
    viewpoints: int


@dataclass(frozen=True, slots=True)
class Seen:
    """What of a visit was seen by flights. Figures are of its best sightings, the least favourable of all its sides."""

    seen: bool
    share: float  # of its sides; of spans, of the length
    distance_m: float | None
    angle_deg: float | None
    gsd_mm: float | None
    photos: int | None  # None: no log tells
    vehicles: tuple[str, ...]
    why: str  # it was not seen


@dataclass(frozen=True, slots=True)
class TowerRow:
    """One visit to a tower or span, or one that is not visited."""

    target: str
    kind: Literal["tower", "span"]
    lines: tuple[str, ...]
    place_deg: tuple[tuple[float, float], ...]  # latitude and longitude: of a tower, or of a span's two
    top_alt_amsl_m: float  # of the (higher) tower
    height_m: float
    weight: float | None  # of towers
    last_inspected: str | None
    visit: str  # empty where none is possible
    status: Status
    note: str  # why it is left out, or what of it is not as asked for
    sortie: Sortied | None
    seen: Seen | None  # None: nothing was flown


def tower_rows(planned: InspectionPlan, coverage: Coverage | None = None) -> tuple[TowerRow, ...]:
    """Return a row for every visit that is asked for, in the mission's order, and for every target that has none.

    ``coverage``: what flights have seen, if there were any.
    """
    places = _Places(planned.scene)
    sorties = dict(_sorties(planned))
    why = {left.target: left.why for left in planned.left_out}
    asked: dict[str, dict[str, str]] = {target: {"": ""} for target in why}
    for target, of_target in itertools.groupby(planned.visits, key=lambda visit: visit.target):
        asked[target] = {visit.name: visit.note for visit in of_target}
    rows = []
    for target in sorted(asked, key=places.order):
        for name, moved in asked[target].items():
            sortie = sorties.get(name)
            status: Status = "planned" if sortie else "done before" if target in planned.done else "left out"
            note = why.get(target, "") if status == "left out" else moved
            seen = None if coverage is None else _seen(coverage, target, name)
            rows.append(places.row(target, name, status, note, sortie, seen))
    return tuple(rows)


class _Places:
    """What a mission says of its towers and spans."""

    def __init__(self, scene: Scene) -> None:
        inspection, towers = scene.mission.inspection, scene.towers
        assert inspection is not None
        assert towers is not None
        self._inspection, self._towers = inspection, towers
        self._index = {name: k for k, name in enumerate(towers.names)}
        lat_deg, lon_deg, _ = scene.frame.to_geo(towers.top_m)
        self._place_deg = list(zip(lat_deg.tolist(), lon_deg.tolist(), strict=True))
        self._lines = _lines(inspection)
        self._spans = {span.name: (*span.towers, span.lines) for span in scene.spans}

    def order(self, target: str) -> tuple[int, int]:
        """Return where a target stands: towers in the mission's order, each before the spans that begin there."""
        if target in self._index:
            return self._index[target], -1
        begin, end, _ = self._spans[target]
        return begin, end

    def row(
        self, target: str, visit: str, status: Status, note: str, sortie: Sortied | None, seen: Seen | None
    ) -> TowerRow:
        """Return a row of a target."""
        kind: Literal["tower", "span"] = "tower" if target in self._index else "span"
        if kind == "tower":
            of, lines = [self._index[target]], self._lines.get(target, ())
        else:
            begin, end, lines = self._spans[target]
            of = [begin, end]
        highest = max(of, key=lambda k: float(self._towers.top_m[k, 2]))
        return TowerRow(
            target=target,
            kind=kind,
            lines=lines,
            place_deg=tuple(self._place_deg[k] for k in of),
            top_alt_amsl_m=float(self._towers.top_m[highest, 2]),
            height_m=self._inspection.towers[highest].height_m,
            weight=float(self._towers.weight[of[0]]) if kind == "tower" else None,
            last_inspected=self._inspection.towers[of[0]].last_inspected if kind == "tower" else None,
            visit=visit,
            status=status,
            note=note,
            sortie=sortie,
            seen=seen,
        )


def _lines(inspection: Inspection) -> Mapping[str, tuple[str, ...]]:
    found: dict[str, dict[str, None]] = {}
    for line in inspection.lines_or_one:
        for tower in line.towers:
            found.setdefault(tower, {})[line.name] = None
    return {tower: tuple(names) for tower, names in found.items()}


def _sorties(planned: InspectionPlan) -> Iterator[tuple[str, Sortied]]:
    """Yield when each visit is paid, by its name."""
    begins_s = 0.0
    for number, round_ in enumerate(planned.rounds, start=1):
        yield from _sorties_of(round_, [task.name for task in planned.scene.tasks], number, begins_s)
        begins_s += round_.lasts_s + planned.swap_s


def _sorties_of(round_: Round, names: list[str], number: int, round_begins_s: float) -> Iterator[tuple[str, Sortied]]:
    vehicles = {vehicle.name: vehicle for vehicle in round_.plan.vehicles}
    for tour in round_.tours:
        vehicle = vehicles[names[tour.vehicle]]
        places_m = np.array([v.position_m for visit in tour.visits for v in visit.viewpoints])
        at = passes(places_m, vehicle.waypoints_m)
        assert len(at) == len(places_m), "a plan passes all stops of its mission"
        first = 0
        for order, visit in enumerate(tour.visits, start=1):
            here = at[first : first + len(visit.viewpoints)]
            yield (
                visit.name,
                Sortied(
                    vehicle=vehicle.name,
                    sysid=vehicle.sysid,
                    round=number,
                    order=order,
                    begins_s=float(vehicle.reached_s[here[0]]),
                    ends_s=float(vehicle.reached_s[here[-1]]) + _hold_s(vehicle, here[-1]),
                    round_begins_s=round_begins_s,
                    photos=_photos(vehicle, visit, here),
                    viewpoints=len(visit.viewpoints),
                ),
            )
            first += len(visit.viewpoints)


def _hold_s(vehicle: VehiclePlan, waypoint: int) -> float:
    return float(vehicle.hold_s[waypoint - 1]) if waypoint > 0 else 0.0


def _photos(vehicle: VehiclePlan, visit: Visit, waypoints: list[int]) -> int:
    """Return how many photos are taken at a visit's viewpoints and on the ways between them."""
    count = sum(viewpoint.action.photos for viewpoint in visit.viewpoints)
    for (begin, end), viewpoint in zip(itertools.pairwise(waypoints), visit.viewpoints[1:], strict=True):
        if viewpoint.action.photo_every_m > 0.0:
            count += int(_way_m(vehicle.waypoints_m[begin : end + 1]) / viewpoint.action.photo_every_m)
    return count


def _way_m(points_m: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(points_m, axis=0), axis=1).sum())


def _seen(coverage: Coverage, target: str, visit: str) -> Seen | None:
    """Return what was seen of a visit; of a target without one, of all of it; None: it is not asked for."""
    sides = [row for row in coverage.towers if row.target == target and visit in ("", row.visit)]
    spans = [row for row in coverage.spans if row.target == target and visit in ("", row.name)]
    if sides:
        told = [row.photos for row in sides if row.photos is not None]
        return Seen(
            seen=all(row.seen for row in sides),
            share=sum(row.seen for row in sides) / len(sides),
            distance_m=_most(row.distance_m for row in sides),
            angle_deg=_most(row.angle_deg for row in sides),
            gsd_mm=_most(row.gsd_mm for row in sides),
            photos=sum(told) if told else None,
            vehicles=tuple(dict.fromkeys(row.vehicle for row in sides if row.seen and row.vehicle)),
            why="; ".join(dict.fromkeys(row.why for row in sides if row.why)),
        )
    if spans:
        told = [row.photos for row in spans if row.photos is not None]
        share = sum(row.share * row.length_m for row in spans) / sum(row.length_m for row in spans)
        seen = all(row.seen for row in spans)
        return Seen(
            seen=seen,
            share=share,
            distance_m=_most(row.distance_max_m for row in spans),
            angle_deg=None,
            gsd_mm=_most(row.gsd_mm for row in spans),
            photos=sum(told) if told else None,
            vehicles=tuple(dict.fromkeys(name for row in spans for name in row.vehicles)),
            why="" if seen else f"{share:.0%} of its length was seen",
        )
    return None


def _most(values: Iterable[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)
