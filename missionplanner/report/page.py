"""The fleet's page: pictures and tables of its plan and flight; of missions that were checked; of replays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from missionplanner.certificate import Certificate
from missionplanner.mission import Mission
from missionplanner.plan import Clearance, FleetFlight, FleetPlan, VehiclePlan
from missionplanner.replay import FleetReplay, VehicleReplay
from missionplanner.report import charts, crew, replays, style
from missionplanner.report.facts import Course, Facts, Sketch, VehicleFacts, collect, sketch_of
from missionplanner.report.maps import detail_maps, fleet_map
from missionplanner.report.rendering import Picture, Tile, picture, write_page
from missionplanner.report.shapes import Shape, shapes
from missionplanner.report.verdicts import floored, lateness_words, place_words, section
from missionplanner.report.view import space_view
from missionplanner.scene import Scene
from missionplanner.sortie import Sortie

REPORT_NAME = "report.html"
CHECK_NAME = "check.html"
REPLAY_NAME = "replay.html"
_PROFILES_DRAWN = 12
_REASONS_SHOWN = 20


@dataclass(frozen=True, slots=True)
class _VehicleRow:
    name: str
    page: str  # of its own; empty: none is written
    colour: str
    kind: str
    length: str
    waypoints: int
    speed: str
    delay: str
    window: str
    arrival: str
    flown_arrival: str
    deviation: str


@dataclass(frozen=True, slots=True)
class _ClearanceRow:
    vehicle: str
    colour: str
    first: bool  # of its vehicle
    to: str
    required: str
    planned: str
    planned_ok: bool
    planned_where: str
    flown: str
    flown_ok: bool
    flown_where: str


@dataclass(frozen=True, slots=True)
class _ReplayRow:
    name: str
    colour: str
    cells: tuple[str, ...]


def write_report(
    folder: Path, scene: Scene, plan: FleetPlan, flight: FleetFlight | None = None, *, vehicle_pages: bool = False
) -> Path:
    """Write ``report.html`` and ``pictures/*.png`` into ``folder`` and return the page's path.

    The page is self-contained. The same plan and flight give the same bytes. With ``vehicle_pages``, every vehicle gets
    a page of its own beside it (see :mod:`.crew`), and the page links to them.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    facts = collect(scene, plan, flight)
    if vehicle_pages:
        crew.write_vehicle_pages(folder, facts)
    return write_page(
        folder / REPORT_NAME,
        REPORT_NAME,
        _pictures(facts),
        mission=plan.mission,
        eyebrow="Mission report",
        subject="plan and flight" if facts.flown else "plan",
        flown=facts.flown,
        headline=_headline(facts),
        clear=not facts.troubles,
        troubles=facts.troubles[:_REASONS_SHOWN],
        troubles_left=max(0, len(facts.troubles) - _REASONS_SHOWN),
        remarks=facts.remarks,
        tiles=tuple(_tiles(facts)),
        proof=section(plan.certificate, facts.findings, scene.frame),
        vehicles=tuple(_vehicle_row(v, vehicle_pages) for v in facts.vehicles),
        clearances=tuple(_clearance_rows(facts)),
        fleet=tuple(_fleet_rows(facts)),
        provenance=tuple(_provenance(facts)),
    )


def write_check_report(folder: Path, scene: Scene, certificate: Certificate, sorties: Sequence[Sortie]) -> Path:
    """Write ``check.html`` and ``pictures/*.png`` of missions that were checked, and return the page's path.

    Nobody needs to have planned them here: what is drawn is what the ``sorties`` fly.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    sketch = sketch_of(scene, certificate, sorties)
    return write_page(
        folder / CHECK_NAME,
        CHECK_NAME,
        _check_pictures(sketch),
        mission=scene.mission,
        eyebrow="Mission check",
        subject="missions as they are held",
        tiles=tuple(_least_tiles(sketch)),
        proof=section(certificate, sketch.findings, scene.frame),
    )


def write_replay(
    folder: Path, mission: Mission, fleet: FleetReplay, *, start: str, troubles: Sequence[str], remarks: Sequence[str]
) -> Path:
    """Write ``replay.html`` and ``pictures/*.png`` of recorded flights beside their plan, and return the page's path.

    Parameters
    ----------
    start : what the times are counted from
    troubles : what could not be replayed
    remarks : what a reader should know besides

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    near = fleet.separation
    if near is not None and not near.ok:
        troubles = (*troubles, f"{near.what} came within {near.distance_m:.1f} m; {near.required_m:g} m are required")
    return write_page(
        folder / REPLAY_NAME,
        REPLAY_NAME,
        _replay_pictures(fleet),
        mission=mission,
        eyebrow="Replay",
        subject="flown against planned",
        headline=_replay_headline(fleet, troubles),
        troubles=troubles,
        remarks=remarks,
        start=start,
        tiles=tuple(_replay_tiles(fleet)),
        vehicles=tuple(_replay_row(i, v) for i, v in enumerate(fleet.vehicles)),
    )


def _replay_pictures(fleet: FleetReplay) -> Iterator[Picture]:
    with style.look():
        yield picture(
            "errors", "Off the plan, over time", replays.errors(fleet), "Late: flown less planned time at the same "
            "place. Ahead: along the path, of where the plan has it at that time. Right, above: of the planned flight.",
            "Time, along-track, cross-track and height errors of each vehicle over time.",
        )  # fmt: skip
        yield picture("arrivals", "Arrival", replays.arrivals(fleet), "", "Planned and flown arrival of each vehicle.")
        if fleet.separation is not None:
            yield picture(
                "apart", "Distance between the vehicles", replays.apart(fleet), "",
                "Distances between the flown vehicles over time.",
            )  # fmt: skip
        yield picture(
            "ways", "From above", replays.ways(fleet), "Broad: planned flight. Thin: flown. Circles: waypoints.",
            "Map of the planned and the flown paths.",
        )  # fmt: skip


def _replay_headline(fleet: FleetReplay, troubles: Sequence[str]) -> str:
    known = [v for v in fleet.vehicles if v.arrival_error_s is not None]
    if fleet.separation is not None and not fleet.separation.ok:
        return "Vehicles came too close to one another."
    if troubles:
        return "Not everything could be replayed."
    if len(known) < len(fleet.vehicles):
        return f"{len(fleet.vehicles) - len(known)} of {len(fleet.vehicles)} vehicles never reached their goals."
    worst = max(known, key=lambda v: abs(v.arrival_error_s or 0.0))
    late_s = worst.arrival_error_s or 0.0
    return f"All arrived; {worst.plan.name} was furthest off its time, {abs(late_s):.2f} s {_late_or_early(late_s)}."


def _late_or_early(late_s: float) -> str:
    return "late" if late_s >= 0.0 else "early"


def _replay_tiles(fleet: FleetReplay) -> Iterator[Tile]:
    if len(fleet.vehicles) > 1:
        spread_s = fleet.arrival_spread_s
        yield Tile(
            "arrivals flown", "incomplete" if spread_s is None else f"{spread_s:.2f} s",
            f"from first to last; planned {fleet.planned_spread_s:.2f} s", bad=spread_s is None,
        )  # fmt: skip
    late = max(fleet.vehicles, key=lambda v: abs(v.arrival_error_s or 0.0))
    if late.arrival_error_s is not None:
        yield Tile("furthest off its arrival", f"{late.arrival_error_s:+.2f} s", f"{late.plan.name}; above 0: late")
    off = max(fleet.vehicles, key=lambda v: float(v.off_path_m[v.en_route].max()))
    yield Tile("most off the path", f"{off.off_path_m[off.en_route].max():.1f} m", f"{off.plan.name}; before arrival")
    near = fleet.separation
    if near is not None:
        note = f"flown; {near.required_m:g} m required; {near.what}"
        yield Tile("least between vehicles", f"{floored(near.distance_m, 1)} m", note, bad=not near.ok)


def _replay_row(index: int, v: VehicleReplay) -> _ReplayRow:
    on = v.en_route
    late, side, along = np.abs(v.time_error_s[on & v.timed]), np.abs(v.cross_track_m[on]), np.abs(v.along_error_m[on])
    arrival_s, error_s = v.flown.arrival_s, v.arrival_error_s
    return _ReplayRow(
        v.plan.name,
        style.vehicle_colour(index),
        (
            f"{v.plan.arrival_s:.1f}",
            "never" if arrival_s is None else f"{arrival_s:.1f}",
            "" if error_s is None else f"{error_s:+.2f}",
            f"{np.percentile(late, 95):.2f}" if late.size else "",
            f"{np.percentile(side, 95):.2f}",
            f"{side.max():.2f}",
            f"{np.abs(v.above_m[on]).max():.2f}",
            f"{np.percentile(along, 95):.2f}",
            f"{along.max():.2f}",
        ),
    )


def _pictures(facts: Facts) -> Iterator[Picture]:
    outlines = shapes(facts.scene)
    count = len(facts.vehicles)
    fleet = f"{count} vehicles" if count > 1 else facts.vehicles[0].name
    with style.look():
        yield _map(facts, outlines, fleet)
        detail = detail_maps(facts, outlines)
        if detail is not None:
            yield picture(
                "sites", "Where they start and end", detail, "", "Maps of the take-off site and of the goals."
            )
        yield picture(
            "view", "In space", space_view(facts, outlines), "Coloured curtains hang from the paths down to the "
            "ground; dotted: behind a ridge. Solids are cut off above the paths.",
            f"View of the terrain with the obstacles and the paths of {fleet}.",
        )  # fmt: skip
        yield from _profiles(facts, outlines)
        if count > 1:
            yield picture(
                "separation", "Distance between the vehicles", charts.separation(facts), _separation_caption(facts),
                "Distances between the vehicles over time beside the required separation.",
            )  # fmt: skip
        yield picture(
            "arrival", "Arrival", charts.arrival_windows(facts), _arrival_caption(facts),
            "When each vehicle can arrive, is planned to arrive and arrived.",
        )  # fmt: skip
        if any(v.plan.history.size for v in facts.vehicles):
            yield picture(
                "cost", "Cost of the search", charts.cost_history(facts),
                "The lowest price of a path found so far, per vehicle: the lower, the better.",
                "Best cost over the iterations of the search, per vehicle.",
            )  # fmt: skip


def _check_pictures(sketch: Sketch) -> Iterator[Picture]:
    outlines = shapes(sketch.scene)
    count = len(sketch.vehicles)
    with style.look():
        yield _map(sketch, outlines, f"{count} vehicles" if count > 1 else sketch.vehicles[0].name)
        yield from _profiles(sketch, outlines)


def _map(sketch: Sketch, outlines: tuple[Shape, ...], fleet: str) -> Picture:
    caption = (
        "Beside each path, leg by leg: how much more its tube keeps from ground, obstacles and fence than it must."
    )
    return picture("map", "Map", fleet_map(sketch, outlines), caption, f"Map of the mission with the paths of {fleet}.")


def _profiles(facts: Sketch, outlines: tuple[Shape, ...]) -> Iterator[Picture]:
    """Draw every vehicle's profile; of a large fleet, those with the least to spare."""
    drawn = tuple(facts.vehicles)
    caption = ""
    if len(drawn) > _PROFILES_DRAWN:
        tightest = sorted(drawn, key=_spare_m)[:_PROFILES_DRAWN]
        drawn = tuple(sorted(tightest, key=lambda v: v.index))
        caption = f"Of {len(facts.vehicles)} vehicles, the {_PROFILES_DRAWN} with the least to spare are drawn."
    for i, v in enumerate(drawn):
        yield picture(
            f"profile-{v.name}", "" if i else "Height along the path", charts.height_profile(facts, outlines, v),
            caption if i == len(drawn) - 1 else "", f"Height of {v.name} over the terrain along its path.",
        )  # fmt: skip


def _spare_m(v: Course) -> float:
    if not all(leg.proven for leg in v.legs):
        return -math.inf
    return min((c.distance_m - c.required_m for c in v.clearances), default=math.inf)


def _headline(facts: Facts) -> str:
    what = "plan and flight" if facts.flown else "plan"
    if not facts.troubles:
        return f"All clear: {what} keep{'' if facts.flown else 's'} every required distance."
    count = len(facts.troubles)
    return f"Not clear: {count} check{'s' if count > 1 else ''} of the {what} failed."


def _tiles(facts: Facts) -> Iterator[Tile]:
    plan, flight = facts.plan, facts.flight
    if plan.arrival_s is not None:
        yield Tile("common arrival", _clock(plan.arrival_s), f"{plan.arrival_s:.1f} s after mission start")
    else:
        last = max(v.plan.arrival_s for v in facts.vehicles)
        yield Tile("last arrival", _clock(last), f"{last:.1f} s after mission start")
    if flight is not None and len(facts.vehicles) > 1:
        spread_s = flight.arrival_spread_s
        yield Tile(
            "arrivals flown", "incomplete" if spread_s is None else f"{spread_s:.2f} s", "from first to last",
            bad=spread_s is None,
        )  # fmt: skip
    yield from _least_tiles(facts)
    separation = facts.flown_separation if facts.flown else plan.separation
    if separation is not None:
        note = f"{'flown' if facts.flown else 'predicted'}; {separation.required_m:g} m required; {separation.what}"
        yield Tile("least between vehicles", f"{separation.distance_m:.1f} m", note, bad=not separation.ok)
    total = sum(v.plan.length_m for v in facts.vehicles)
    yield Tile("paths", _length(total), f"{len(facts.vehicles)} vehicle{'s' if len(facts.vehicles) > 1 else ''}")


def _least_tiles(sketch: Sketch) -> Iterator[Tile]:
    for what, label in (("terrain", "least above ground"), ("obstacle", "least to obstacles")):
        found = [
            (c, v.name)
            for v in sketch.vehicles
            for c in (v.flown.clearances if v.flown else v.clearances)
            if _kind(c) == what
        ]
        if not found:
            continue
        least, name = min(found, key=lambda entry: entry[0].distance_m - entry[0].required_m)
        thing = f"{least.what}, {name}" if what == "obstacle" else name
        note = f"{_how(sketch)}; {least.required_m:g} m required; {thing}"
        yield Tile(label, _metres(least.distance_m), note, bad=not least.ok)


def _speeds(plan: VehiclePlan) -> str:
    low, high = float(plan.speeds_m_s.min()), float(plan.speeds_m_s.max())
    return f"{high:.2f}" if low == high else f"{low:.2f} \N{EN DASH} {high:.2f}"


def _vehicle_row(v: VehicleFacts, has_page: bool) -> _VehicleRow:
    plan, flown = v.plan, v.flown
    flown_arrival = ""
    if flown is not None:
        at = flown.record.arrival_s
        flown_arrival = "never" if at is None else f"{at:.1f} ({at - plan.arrival_s:+.2f})"
    return _VehicleRow(
        name=v.name,
        page=crew.page_name(v.name) if has_page else "",
        colour=style.vehicle_colour(v.index),
        kind=f"{'ArduPilot' if plan.autopilot == 'ardupilot' else 'PX4'} {plan.vehicle_class}, {plan.sysid}",
        length=f"{plan.length_m:,.0f}",
        waypoints=len(plan.waypoints_m),
        speed=_speeds(plan),
        delay=f"{plan.start_delay_s:.1f}",
        window=f"{plan.window_s[0]:.0f} – {plan.window_s[1]:.0f}",  # noqa: RUF001 (a range)
        arrival=f"{plan.arrival_s:.1f}",
        flown_arrival=flown_arrival,
        deviation=f"{flown.deviation_m:.2f}" if flown else "",
    )


def _clearance_rows(facts: Facts) -> Iterator[_ClearanceRow]:
    fenced = facts.scene.mission.fence is not None
    for v in facts.vehicles:
        flown = {_kind(c): c for c in v.flown.clearances} if v.flown else {}
        told = [c for c in v.plan.clearances if fenced or c.what != "fence" or not c.ok]
        for i, planned in enumerate(told):
            other = flown.get(_kind(planned))
            yield _ClearanceRow(
                vehicle=v.name,
                colour=style.vehicle_colour(v.index),
                first=i == 0,
                to=_thing(facts, planned),
                required=f"{planned.required_m:g}",
                planned=_metres(planned.distance_m, unit=""),
                planned_ok=planned.ok,
                planned_where=place_words(facts.plan.frame, planned.position_m),
                flown="" if other is None else _metres(other.distance_m, unit="") + _named_otherwise(planned, other),
                flown_ok=other is None or other.ok,
                flown_where="" if other is None else place_words(facts.plan.frame, other.position_m),
            )


def _fleet_rows(facts: Facts) -> Iterator[tuple[str, str]]:
    plan, flight = facts.plan, facts.flight
    if plan.arrival_s is not None:
        order = plan.mission.fleet.arrival_order
        told = f", then one every {plan.mission.fleet.arrival_spacing_s:g} s: {', '.join(order)}" if order else ""
        yield "common arrival", f"{plan.arrival_s:.2f} s after mission start{told}"
    for finding in facts.findings:
        if finding.check == "rendezvous":
            yield "rendezvous", finding.detail
    for resolution in plan.resolutions:
        met = f", who would have met {resolution.other} at {resolution.t_s:.0f} s," if resolution.other else ""
        yield "kept apart" if resolution.other else "kept back", f"{resolution.vehicle}{met} {resolution.detail}"
    if flight is not None and len(facts.vehicles) > 1:
        spread_s = flight.arrival_spread_s
        yield "spread of flown arrivals", "not all arrived" if spread_s is None else f"{spread_s:.3f} s"
    for how, c in (("predicted", plan.separation), ("flown", facts.flown_separation)):
        if c is not None:
            when = f", at {c.t_s:.1f} s" if c.t_s is not None else ""
            yield f"least separation, {how}", f"{c.distance_m:.2f} m ({c.required_m:g} m required), {c.what}{when}"
    late = next((f for f in facts.findings if f.check == "lateness" and f.value is not None), None)
    if late is not None and late.value is not None:
        yield "all keep apart, early or late by", f"{floored(late.value, 1)} s"
    yield "length of all paths", _length(sum(v.plan.length_m for v in facts.vehicles))
    yield "last predicted touch-down or end", f"{max(float(v.plan.trajectory.t_s[-1]) for v in facts.vehicles):.0f} s"


def _provenance(facts: Facts) -> Iterator[tuple[str, str]]:
    plan, mission = facts.plan, facts.plan.mission
    yield "mission", mission.name
    yield "origin", f"{mission.origin.lat_deg:.6f}, {mission.origin.lon_deg:.6f}"
    yield "terrain", facts.scene.terrain.description
    settings, evaluations = mission.planner, sum(v.plan.evaluations for v in facts.vehicles)
    search = f"{settings.algorithm}, population {settings.population}, {settings.iterations} iterations"
    yield "search", f"{search}, {evaluations:,} evaluations"
    yield "seed", str(plan.seed)
    yield "software", f"missionplanner {plan.software_version}"
    yield "inputs, SHA-256", plan.input_sha256


def _separation_caption(facts: Facts) -> str:
    c, asked_m = facts.plan.separation, facts.scene.mission.fleet.separation_m
    said = [lateness_words(facts.findings)]
    if c is not None and c.required_m != asked_m:
        said.append(
            f"The fleet must keep {asked_m:g} m; predicted flights keep {c.required_m:g} m, which leaves room for the "
            "errors of both."
        )
    return " ".join(filter(None, said))


def _arrival_caption(facts: Facts) -> str:
    if facts.plan.arrival_s is None:
        return "The mission does not ask for a common arrival: every vehicle arrives in its own time."
    return "A common arrival is possible at any time that lies in every vehicle's window."


def _kind(c: Clearance) -> str:
    return c.what if c.what in ("terrain", "ceiling", "fence") else "obstacle"


def _thing(facts: Facts, c: Clearance) -> str:
    edge = "fence" if facts.scene.mission.fence is not None else "edge of the area"
    return {"terrain": "ground below", "ceiling": "ceiling above", "fence": edge}.get(c.what, c.what)


def _named_otherwise(planned: Clearance, flown: Clearance) -> str:
    return f" to {flown.what}" if flown.what != planned.what else ""


def _how(sketch: Sketch) -> str:
    return "flown" if sketch.flown else "by proof"


def _metres(value: float, unit: str = " m") -> str:
    return f"{floored(value, 1)}{unit}" if math.isfinite(value) else "no terrain data"


def _length(metres: float) -> str:
    return f"{metres / 1000:.1f} km" if metres >= 10_000 else f"{metres:,.0f} m"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d} min"
