"""The page: pictures and tables in one self-contained HTML file, the pictures beside it as PNG files too."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from missionplanner.files import write_atomic
from missionplanner.geodesy import LocalFrame
from missionplanner.plan import Clearance, FleetFlight, FleetPlan
from missionplanner.report import charts, style
from missionplanner.report.facts import Facts, VehicleFacts, collect
from missionplanner.report.maps import detail_maps, fleet_map
from missionplanner.report.shapes import Shape, shapes
from missionplanner.report.view import space_view
from missionplanner.scene import Scene

REPORT_NAME = "report.html"
PICTURES_NAME = "pictures"
_PROFILES_DRAWN = 12
_REASONS_SHOWN = 20


@dataclass(frozen=True, slots=True)
class _Picture:
    """A drawn picture: file name, section it opens (or continues, if empty), caption, words for who cannot see it."""

    name: str
    title: str
    caption: str
    alt: str
    png: bytes

    @property
    def uri(self) -> str:
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")


@dataclass(frozen=True, slots=True)
class _Tile:
    """A key figure."""

    label: str
    value: str
    note: str
    bad: bool = False


@dataclass(frozen=True, slots=True)
class _VehicleRow:
    name: str
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


def write_report(folder: Path, scene: Scene, plan: FleetPlan, flight: FleetFlight | None = None) -> Path:
    """Write ``report.html`` and ``pictures/*.png`` into ``folder`` and return the page's path.

    The page is self-contained. The same plan and flight give the same bytes.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    facts = collect(scene, plan, flight)
    pictures = []
    for picture in _pictures(facts):
        write_atomic(folder / PICTURES_NAME / f"{picture.name}.png", picture.png)
        pictures.append(picture)
    path = folder / REPORT_NAME
    write_atomic(path, _html(facts, pictures))
    return path


def _html(facts: Facts, pictures: Sequence[_Picture]) -> str:
    here = resources.files(__package__)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    template = environment.from_string(here.joinpath("report.html").read_text(encoding="utf-8"))
    return template.render(
        css=Markup(here.joinpath("report.css").read_text(encoding="utf-8")),
        mission=facts.plan.mission,
        flown=facts.flown,
        headline=_headline(facts),
        clear=not facts.troubles,
        troubles=facts.troubles[:_REASONS_SHOWN],
        troubles_left=max(0, len(facts.troubles) - _REASONS_SHOWN),
        remarks=facts.remarks,
        tiles=tuple(_tiles(facts)),
        vehicles=tuple(_vehicle_row(v) for v in facts.vehicles),
        clearances=tuple(_clearance_rows(facts)),
        fleet=tuple(_fleet_rows(facts)),
        provenance=tuple(_provenance(facts)),
        pictures=pictures,
    )


def _pictures(facts: Facts) -> Iterator[_Picture]:
    outlines = shapes(facts.scene)
    count = len(facts.vehicles)
    fleet = f"{count} vehicles" if count > 1 else facts.vehicles[0].name
    with style.look():
        yield _picture("map", "Map", fleet_map(facts, outlines), "", f"Map of the mission with the paths of {fleet}.")
        detail = detail_maps(facts, outlines)
        if detail is not None:
            yield _picture(
                "sites", "Where they start and end", detail, "", "Maps of the take-off site and of the goals."
            )
        yield _picture(
            "view", "In space", space_view(facts, outlines), "Coloured curtains hang from the paths down to the "
            "ground; dotted: behind a ridge. Solids are cut off above the paths.",
            f"View of the terrain with the obstacles and the paths of {fleet}.",
        )  # fmt: skip
        yield from _profiles(facts, outlines)
        if count > 1:
            yield _picture(
                "separation", "Distance between the vehicles", charts.separation(facts), _separation_caption(facts),
                "Distances between the vehicles over time beside the required separation.",
            )  # fmt: skip
        yield _picture(
            "arrival", "Arrival", charts.arrival_windows(facts), _arrival_caption(facts),
            "When each vehicle can arrive, is planned to arrive and arrived.",
        )  # fmt: skip
        if any(v.plan.history.size for v in facts.vehicles):
            yield _picture(
                "cost", "Cost of the search", charts.cost_history(facts),
                "The lowest price of a path found so far, per vehicle: the lower, the better.",
                "Best cost over the iterations of the search, per vehicle.",
            )  # fmt: skip


def _profiles(facts: Facts, outlines: tuple[Shape, ...]) -> Iterator[_Picture]:
    """Draw every vehicle's profile; of a large fleet, those with the least to spare."""
    drawn = facts.vehicles
    caption = ""
    if len(drawn) > _PROFILES_DRAWN:
        tightest = sorted(drawn, key=_spare_m)[:_PROFILES_DRAWN]
        drawn = tuple(sorted(tightest, key=lambda v: v.index))
        caption = f"Of {len(facts.vehicles)} vehicles, the {_PROFILES_DRAWN} with the least to spare are drawn."
    for i, v in enumerate(drawn):
        yield _picture(
            f"profile-{v.name}", "" if i else "Height along the path", charts.height_profile(facts, outlines, v),
            caption if i == len(drawn) - 1 else "", f"Height of {v.name} over the terrain along its path.",
        )  # fmt: skip


def _picture(name: str, title: str, figure: Figure, caption: str, alt: str) -> _Picture:
    return _Picture(name, title, caption, alt, style.to_png(figure))


def _spare_m(v: VehicleFacts) -> float:
    return min((c.distance_m - c.required_m for c in v.plan.clearances), default=math.inf)


def _headline(facts: Facts) -> str:
    what = "plan and flight" if facts.flown else "plan"
    if not facts.troubles:
        return f"All clear: {what} keep{'' if facts.flown else 's'} every required distance."
    count = len(facts.troubles)
    return f"Not clear: {count} check{'s' if count > 1 else ''} of the {what} failed."


def _tiles(facts: Facts) -> Iterator[_Tile]:
    plan, flight = facts.plan, facts.flight
    if plan.arrival_s is not None:
        yield _Tile("common arrival", _clock(plan.arrival_s), f"{plan.arrival_s:.1f} s after mission start")
    else:
        last = max(v.plan.arrival_s for v in facts.vehicles)
        yield _Tile("last arrival", _clock(last), f"{last:.1f} s after mission start")
    if flight is not None and len(facts.vehicles) > 1:
        spread_s = flight.arrival_spread_s
        yield _Tile(
            "arrivals flown", "incomplete" if spread_s is None else f"{spread_s:.2f} s", "from first to last",
            bad=spread_s is None,
        )  # fmt: skip
    for what, label in (("terrain", "least above ground"), ("obstacle", "least to obstacles")):
        tile = _least_tile(facts, what, label)
        if tile is not None:
            yield tile
    separation = facts.flown_separation if facts.flown else plan.separation
    if separation is not None:
        yield _Tile(
            "least between vehicles", f"{separation.distance_m:.1f} m",
            f"{_how(facts)}; {separation.required_m:g} m required; {separation.what}", bad=not separation.ok,
        )  # fmt: skip
    total = sum(v.plan.length_m for v in facts.vehicles)
    yield _Tile("paths", _length(total), f"{len(facts.vehicles)} vehicle{'s' if len(facts.vehicles) > 1 else ''}")


def _least_tile(facts: Facts, what: str, label: str) -> _Tile | None:
    found = [
        (c, v.name)
        for v in facts.vehicles
        for c in (v.flown.clearances if v.flown else v.plan.clearances)
        if _kind(c) == what
    ]
    if not found:
        return None
    least, name = min(found, key=lambda entry: entry[0].distance_m - entry[0].required_m)
    thing = f"{least.what}, {name}" if what == "obstacle" else name
    note = f"{_how(facts)}; {least.required_m:g} m required; {thing}"
    return _Tile(label, _metres(least.distance_m), note, bad=not least.ok)


def _vehicle_row(v: VehicleFacts) -> _VehicleRow:
    plan, flown = v.plan, v.flown
    flown_arrival = ""
    if flown is not None:
        at = flown.record.arrival_s
        flown_arrival = "never" if at is None else f"{at:.1f} ({at - plan.arrival_s:+.2f})"
    return _VehicleRow(
        name=v.name,
        colour=style.vehicle_colour(v.index),
        kind=f"{'ArduPilot' if plan.autopilot == 'ardupilot' else 'PX4'} {plan.vehicle_class}, {plan.sysid}",
        length=f"{plan.length_m:,.0f}",
        waypoints=len(plan.waypoints_m),
        speed=f"{plan.speed_m_s:.2f}",
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
                required=f"{planned.required_m:g}" + (f" / {other.required_m:g}" if other else ""),
                planned=_metres(planned.distance_m, unit=""),
                planned_ok=planned.ok,
                planned_where=_where(facts.plan.frame, planned),
                flown="" if other is None else _metres(other.distance_m, unit="") + _named_otherwise(planned, other),
                flown_ok=other is None or other.ok,
                flown_where="" if other is None else _where(facts.plan.frame, other),
            )


def _fleet_rows(facts: Facts) -> Iterator[tuple[str, str]]:
    plan, flight = facts.plan, facts.flight
    if plan.arrival_s is not None:
        yield "common arrival", f"{plan.arrival_s:.2f} s after mission start"
    if flight is not None and len(facts.vehicles) > 1:
        spread_s = flight.arrival_spread_s
        yield "spread of flown arrivals", "not all arrived" if spread_s is None else f"{spread_s:.3f} s"
    for how, c in (("predicted", plan.separation), ("flown", facts.flown_separation)):
        if c is not None:
            when = f", at {c.t_s:.1f} s" if c.t_s is not None else ""
            yield f"least separation, {how}", f"{c.distance_m:.2f} m ({c.required_m:g} m required), {c.what}{when}"
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
    c = facts.plan.separation
    if c is None or c.required_m == facts.scene.mission.fleet.separation_m:
        return ""
    return (
        f"The fleet must keep {facts.scene.mission.fleet.separation_m:g} m; the plan keeps {c.required_m:g} m, "
        "which leaves room for the tracking errors of both."
    )


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


def _how(facts: Facts) -> str:
    return "flown" if facts.flown else "planned"


def _where(frame: LocalFrame, c: Clearance) -> str:
    point = frame.geo_point(c.position_m)
    return f"{point.lat_deg:.5f}, {point.lon_deg:.5f}, {point.alt_amsl_m:.0f} m"


def _metres(value: float, unit: str = " m") -> str:
    return f"{value:.1f}{unit}" if math.isfinite(value) else "no terrain data"


def _length(metres: float) -> str:
    return f"{metres / 1000:.1f} km" if metres >= 10_000 else f"{metres:,.0f} m"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d} min"
