"""The page of a whole inspection: its rounds, who inspects what and when, what is left out, and what was seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from missionplanner.coverage import Coverage
from missionplanner.inspection import InspectionPlan
from missionplanner.plan import Trajectory, VehiclePlan
from missionplanner.report import style
from missionplanner.report.coverage import coverage_map
from missionplanner.report.crew import clock, page_name
from missionplanner.report.facts import Course, Facts, Sketch, collect
from missionplanner.report.maps import TowerMark, inspection_map
from missionplanner.report.page import REPORT_NAME
from missionplanner.report.rendering import Picture, Tile, picture, write_page
from missionplanner.report.shapes import shapes
from missionplanner.tower_rows import TowerRow, tower_rows

_TEMPLATE = "inspection.html"
_REASONS_SHOWN = 40
_ROW_IN = 0.3


@dataclass(frozen=True, slots=True)
class _SortieRow:
    """One sortie, in words."""

    round: int
    first: bool  # of its round
    round_page: str
    vehicle: str
    vehicle_page: str
    colour: str
    targets: int
    photos: int
    length: str
    takes_off: str
    lands: str
    battery: str
    proven: bool


@dataclass(frozen=True, slots=True)
class _TargetRow:
    """One visit, in words."""

    target: str
    first: bool  # of its target
    visit: str
    status: str
    vehicle: str
    colour: str
    when: str
    photos: str
    note: str
    seen: str
    ok: bool


def write_inspection_report(
    folder: Path,
    planned: InspectionPlan,
    seen: Coverage | None = None,
    tracks: Sequence[Trajectory] = (),
    simulated: Sequence[str] = (),
) -> Path:
    """Write ``report.html`` and its pictures of a whole inspection into ``folder``, and return the page's path.

    It links to the rounds' own reports and to their vehicles' pages, in ``round-K``, as far as they are there.

    Parameters
    ----------
    seen : what its flights have shown, if there were any
    tracks : where they went
    simulated : rounds whose flights were rehearsals: no vehicle was in the air

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    rows = tower_rows(planned, seen)
    rounds = [collect(r.scene, r.plan, None) for r in planned.rounds]
    troubles = [f"round {number}: {line}" for number, facts in enumerate(rounds, start=1) for line in facts.troubles]
    missed = _missed(planned, rows, seen)
    reasons = [
        *troubles,
        *(f"simulated: {place}: no vehicle was in the air, nothing is inspected by it" for place in simulated),
        *(f"left out: {left.target}: {left.why}" for left in planned.left_out),
        *(f"not seen: {line}" for line in missed),
    ]
    return write_page(
        folder / REPORT_NAME,
        _TEMPLATE,
        _pictures(planned, rounds, rows, seen, tracks),
        mission=planned.scene.mission,
        eyebrow="Inspection",
        subject="plan" if seen is None else "plan and simulated flight" if simulated else "plan and flight",
        state="unclear" if troubles else "waived" if reasons else "clear",
        headline=_headline(planned, troubles, seen, simulated),
        reasons=reasons[:_REASONS_SHOWN],
        reasons_left=max(0, len(reasons) - _REASONS_SHOWN),
        tiles=tuple(_tiles(planned, rows, seen, missed, simulated)),
        sorties=tuple(_sorties(folder, planned, rounds, rows)),
        targets=tuple(_targets(planned, rows)),
        seen=seen is not None,
        provenance=tuple(_provenance(planned)),
    )


def _missed(planned: InspectionPlan, rows: Sequence[TowerRow], seen: Coverage | None) -> list[str]:
    """Return what was planned to be seen, and was not, in words."""
    if seen is None:
        return []
    missed = [row for row in rows if row.status == "planned" and row.seen is not None and not row.seen.seen]
    unseen = set(planned.inspected) - seen.done - {row.target for row in missed}
    return [
        *(f"{row.visit}: {row.seen.why or 'not from all sides'}" for row in missed if row.seen is not None),
        *(f"{target}: not from all sides" for target in sorted(unseen)),
    ]


def _headline(planned: InspectionPlan, troubles: Sequence[str], seen: Coverage | None, simulated: Sequence[str]) -> str:
    count = len(planned.rounds)
    rounds = f"{count} round{'s' if count != 1 else ''}"
    if troubles:
        return f"Not clear: {len(troubles)} check{'s' if len(troubles) > 1 else ''} of {rounds} failed."
    asked = len({*(visit.target for visit in planned.visits), *(left.target for left in planned.left_out)})
    told = f"{len(planned.inspected)} of {asked} targets are inspected in {rounds}, all proven"
    if planned.done:
        told += f"; {len(planned.done)} were before"
    if seen is not None:
        done = len(set(planned.inspected) & seen.done)
        told += f"; {done} of them were seen from all sides" if done < len(planned.inspected) else "; all were seen"
        told += "".join(f"; {note}" for note in seen.notes)
    if simulated:
        told += f"; SIMULATED: no vehicle was in the air in {', '.join(simulated)}"
    return f"{told}."


def _tiles(
    planned: InspectionPlan,
    rows: Sequence[TowerRow],
    seen: Coverage | None,
    missed: Sequence[str],
    simulated: Sequence[str],
) -> Iterator[Tile]:
    short = planned.share < planned.share_min - 1e-9
    yield Tile(
        "inspected", f"{planned.share:.0%}", f"of the towers' weight; at least {planned.share_min:.0%}", bad=short
    )
    if seen is not None:
        by = "simulated flights" if simulated else "flights"
        yield Tile("seen", f"{seen.share:.0%}", f"of the towers' weight, by {by}", bad=bool(missed or simulated))
    if planned.left_out:
        yield Tile("left out", str(len(planned.left_out)), "targets, named below", bad=True)
    yield Tile("rounds", str(len(planned.rounds)), _sorties_words(planned))
    yield Tile("makespan", f"{planned.makespan_s / 60.0:.0f} min", "from the first start to the last landing")
    flying_s = sum(_flies_s(vehicle) for r in planned.rounds for vehicle in r.plan.vehicles)
    bound = f"no less than {planned.assignment.bound_s / 60.0:.0f} min" if planned.assignment.bound_s > 0.0 else ""
    yield Tile("flight time", f"{flying_s / 60.0:.0f} min", f"of all; {bound} is possible" if bound else "of all")
    yield Tile("photos", str(sum(row.sortie.photos for row in rows if row.sortie is not None)), "planned")


def _sorties_words(planned: InspectionPlan) -> str:
    count, between = len(planned.tours), f"; {planned.swap_s:g} s between them" if len(planned.rounds) > 1 else ""
    return f"{count} {'sortie' if count == 1 else 'sorties'}{between}"


def _flies_s(vehicle: VehiclePlan) -> float:
    return float(vehicle.trajectory.t_s[-1]) - vehicle.start_delay_s


def _sorties(
    folder: Path, planned: InspectionPlan, rounds: Sequence[Facts], rows: Sequence[TowerRow]
) -> Iterator[_SortieRow]:
    for number, facts in enumerate(rounds, start=1):
        for k, v in enumerate(facts.vehicles):
            own = [r for r in rows if r.sortie is not None and (r.sortie.round, r.sortie.vehicle) == (number, v.name)]
            used = [f.value for f in facts.findings if (f.check, f.vehicle, f.unit) == ("energy", v.name, "")]
            most = max((value for value in used if value is not None), default=None)
            yield _SortieRow(
                round=number,
                first=k == 0,
                round_page=_there(folder, f"round-{number}/{REPORT_NAME}"),
                vehicle=v.name,
                vehicle_page=_there(folder, f"round-{number}/{page_name(v.name)}"),
                colour=_colour(planned, v.name),
                targets=len({row.target for row in own}),
                photos=sum(row.sortie.photos for row in own if row.sortie is not None),
                length=f"{v.plan.length_m / 1000.0:.1f}",
                takes_off=clock(v.plan.start_delay_s),
                lands=clock(float(v.plan.trajectory.t_s[-1])),
                battery="" if most is None else f"{most:.0%}",
                proven=all(f.holds for f in facts.findings if v.name in (f.vehicle, *f.vehicle.split(" - "))),
            )


def _there(folder: Path, page: str) -> str:
    return page if (folder / page).exists() else ""


def _targets(planned: InspectionPlan, rows: Sequence[TowerRow]) -> Iterator[_TargetRow]:
    before = ""
    for row in rows:
        sortie, seen = row.sortie, row.seen
        told = ""
        if seen is not None and (seen.seen or row.status == "planned"):
            far = "" if seen.distance_m is None else f", {seen.distance_m:.0f} m"
            angle = "" if seen.angle_deg is None else f", {seen.angle_deg:.0f}° off"
            gsd = "" if seen.gsd_mm is None else f", {seen.gsd_mm:.1f} mm a pixel"
            told = f"seen{far}{angle}{gsd}" if seen.seen else f"not seen: {seen.why}"
        yield _TargetRow(
            target=row.target,
            first=row.target != before,
            visit=row.visit.removeprefix(row.target).lstrip(".") or row.visit,
            status=row.status,
            vehicle="" if sortie is None else f"{sortie.vehicle}, round {sortie.round}",
            colour="" if sortie is None else _colour(planned, sortie.vehicle),
            when="" if sortie is None else f"{clock(sortie.begins_s)} – {clock(sortie.ends_s)}",  # noqa: RUF001 (a range)
            photos="" if sortie is None else str(sortie.photos),
            note=row.note,
            seen=told,
            ok=row.status != "planned" or seen is None or seen.seen,
        )
        before = row.target


def _provenance(planned: InspectionPlan) -> Iterator[tuple[str, str]]:
    mission = planned.scene.mission
    yield "mission", mission.name
    yield "terrain", planned.scene.terrain.description
    yield "seed", str(planned.seed)
    yield (
        "software",
        f"missionplanner {planned.rounds[0].plan.software_version}" if planned.rounds else "missionplanner",
    )
    yield "inputs, SHA-256", planned.scene.input_sha256
    yield "tables", "towers.csv, towers.geojson"


def _colour(planned: InspectionPlan, vehicle: str) -> str:
    names = [task.name for task in planned.scene.tasks]
    return style.vehicle_colour(names.index(vehicle))


# --- pictures


def _pictures(
    planned: InspectionPlan,
    rounds: Sequence[Facts],
    rows: Sequence[TowerRow],
    seen: Coverage | None,
    tracks: Sequence[Trajectory],
) -> Iterator[Picture]:
    with style.look():
        courses = tuple(_courses(planned, rounds))
        if courses:
            sketch = Sketch(planned.scene, courses, ())
            yield picture(
                "inspection", "Who inspects what", inspection_map(sketch, shapes(planned.scene), _marks(planned, rows)),
                "Towers have the colours of the vehicles that inspect them. All rounds are drawn.",
                "Map of the ways of all vehicles in all rounds, with the towers in the colours of who inspects them.",
            )  # fmt: skip
            yield picture(
                "timetable", "Timetable", _timetable(planned, rows),
                "From take-off to landing, darker where a target is looked at. Between rounds all have landed and "
                "batteries are changed.",
                "When each vehicle flies and inspects.",
            )  # fmt: skip
        if seen is not None:
            yield picture(
                "coverage", "What was seen", coverage_map(planned.scene, seen, tracks), "As recorded flights show it.",
                "Map of the towers and spans by what flights have seen of them.",
            )  # fmt: skip


def _courses(planned: InspectionPlan, rounds: Sequence[Facts]) -> Iterator[Course]:
    """Yield every vehicle's ways of all rounds, one after the other: each begins and ends above its home."""
    for index, task in enumerate(planned.scene.tasks):
        own = [v for facts in rounds for v in facts.vehicles if v.name == task.name]
        if own:
            yield Course(
                index=index,
                name=task.name,
                task=own[0].task,
                home_m=own[0].home_m,
                path_m=np.concatenate([v.path_m for v in own]),
                waypoints_m=np.concatenate([v.waypoints_m for v in own]),
                legs=tuple(leg for v in own for leg in v.legs),
                clearances=tuple(clearance for v in own for clearance in v.clearances),
                flown=None,
            )


def _marks(planned: InspectionPlan, rows: Sequence[TowerRow]) -> list[TowerMark]:
    towers = planned.scene.towers
    assert towers is not None
    of_tower: dict[str, list[TowerRow]] = {}
    for row in rows:
        if row.kind == "tower":
            of_tower.setdefault(row.target, []).append(row)
    marks = []
    for name, top_m in zip(towers.names, towers.top_m, strict=True):
        own = of_tower.get(name, [])
        by = dict.fromkeys(_colour(planned, row.sortie.vehicle) for row in own if row.sortie is not None)
        statuses = {row.status for row in own}
        if own:
            state = next(s for s in ("left out", "planned", "done before") if s in statuses)
            marks.append(TowerMark(top_m, tuple(by), state))
    return marks


def _timetable(planned: InspectionPlan, rows: Sequence[TowerRow]) -> Figure:
    """Draw when each vehicle flies, and when it inspects."""
    names = [task.name for task in planned.scene.tasks]
    height_in = 0.75 + _ROW_IN * len(names)
    figure = style.new_figure(height_in)
    axes = figure.add_axes((0.1, 0.42 / height_in, 0.885, 1.0 - 0.62 / height_in))
    begins_s = 0.0
    for number, round_ in enumerate(planned.rounds, start=1):
        for vehicle in round_.plan.vehicles:
            row, colour = names.index(vehicle.name), _colour(planned, vehicle.name)
            first_min = (begins_s + vehicle.start_delay_s) / 60.0
            axes.barh(row, _flies_s(vehicle) / 60.0, left=first_min, height=0.56, color=colour, alpha=0.28, linewidth=0)
        for entry in rows:
            sortie = entry.sortie
            if sortie is not None and sortie.round == number:
                width_min = max(sortie.ends_s - sortie.begins_s, 1.0) / 60.0
                axes.barh(
                    names.index(sortie.vehicle), width_min, left=(begins_s + sortie.begins_s) / 60.0, height=0.56,
                    color=_colour(planned, sortie.vehicle), linewidth=0,
                )  # fmt: skip
        axes.annotate(
            f"round {number}", xy=(begins_s / 60.0, 1.0), xycoords=("data", "axes fraction"), xytext=(2, 3),
            textcoords="offset points", fontsize=7.5, color=style.MUTED,
        )  # fmt: skip
        for edge_s in (begins_s, begins_s + round_.lasts_s):
            axes.axvline(edge_s / 60.0, color=style.RULE, linewidth=0.8, zorder=0)
        begins_s += round_.lasts_s + planned.swap_s
    axes.set_xlim(0.0, planned.makespan_s / 60.0)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(axis="y", length=0, labelcolor=style.INK)
    axes.set_xlabel("minutes after the first start")
    axes.spines["left"].set_visible(False)
    return figure
