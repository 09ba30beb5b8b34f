"""A page for each vehicle, for the crew that flies it: its own way, what it does where and when, battery, heights."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from missionplanner import energy
from missionplanner.energy import EnergyModel
from missionplanner.geodesy import FloatArray
from missionplanner.mission import Vehicle
from missionplanner.plan import Action
from missionplanner.report import charts, style
from missionplanner.report.facts import Facts, VehicleFacts
from missionplanner.report.maps import vehicle_map
from missionplanner.report.rendering import Picture, Tile, picture, write_page
from missionplanner.report.shapes import Shape, shapes
from missionplanner.report.verdicts import section
from missionplanner.scene import Scene
from missionplanner.waypoints import passes

_TEMPLATE = "vehicle.html"
_HASH_SHOWN = 16
_ENDS = {"land": "lands there", "rtl": "returns home and lands", "loiter": "stays there"}


@dataclass(frozen=True, slots=True)
class _PlaceRow:
    """A place on a vehicle's way, in words."""

    number: str
    name: str
    item: str  # of its mission
    clock: str  # minutes and seconds after mission start
    does: str
    amsl: str
    above_home: str
    above_ground: str


def page_name(vehicle: str) -> str:
    """Return the file name of a vehicle's page."""
    return f"report-{vehicle}.html"


def write_vehicle_pages(folder: Path, facts: Facts) -> list[Path]:
    """Write ``report-NAME.html`` of every vehicle into ``folder`` and return the pages' paths.

    Each prints on A4 by itself. The same plan and flight give the same bytes.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    outlines = shapes(facts.scene)
    return [_write(folder, facts, outlines, v) for v in facts.vehicles]


def _write(folder: Path, facts: Facts, outlines: Sequence[Shape], v: VehicleFacts) -> Path:
    settings = next(vehicle for vehicle in facts.scene.mission.vehicles if vehicle.name == v.name)
    model = energy.energy_model(settings, facts.scene.mission.air_m_s)
    stops = _stops(v, "above home" if settings.goal is None else "goal")
    findings = tuple(f for f in facts.findings if v.name in (f.vehicle, *f.vehicle.split(" - ")) or not f.vehicle)
    proof = section(facts.plan.certificate, findings, facts.scene.frame)
    return write_page(
        folder / page_name(v.name),
        _TEMPLATE,
        _pictures(facts, outlines, v, stops, model),
        mission=facts.plan.mission,
        eyebrow=facts.plan.mission.name,
        subject="crew's page",
        vehicle=v.name,
        colour=style.vehicle_colour(v.index),
        proof=proof,
        tiles=tuple(_tiles(facts, v, stops, model)),
        places=tuple(_places(facts, v, stops)),
        others=len(v.waypoints_m) - len(stops),
        facts=tuple(_facts(facts, v, settings)),
        checklist=tuple(_checklist(facts, v)),
    )


# --- its places


def _stops(v: VehicleFacts, goal: str) -> dict[int, tuple[str, Action]]:
    """Return what the mission calls the vehicle's waypoints, and what is done there, in order."""
    called = {index: name for name, index in v.task.places.items() if isinstance(name, str)}
    last = len(v.task.route_m) - 1
    stops: dict[int, tuple[str, Action]] = {}
    for index, waypoint in enumerate(passes(v.task.route_m, v.waypoints_m)):
        action = v.plan.actions.get(waypoint, Action())
        plain = "take-off" if index == 0 else goal if index == last else f"stop {index}"
        stops[waypoint] = (action.name or called.get(index, plain), action)
    for waypoint, action in v.plan.actions.items():
        stops.setdefault(waypoint, (action.name or f"waypoint {waypoint}", action))
    return dict(sorted(stops.items()))


def _places(facts: Facts, v: VehicleFacts, stops: dict[int, tuple[str, Action]]) -> Iterator[_PlaceRow]:
    plan = v.plan
    for number, (waypoint, (name, action)) in enumerate(stops.items()):
        place_m = v.waypoints_m[waypoint]
        hold_s = float(plan.hold_s[waypoint - 1]) if waypoint else 0.0
        yield _PlaceRow(
            number=str(number) if waypoint else "",
            name=name,
            item=str(v.legs[waypoint].seq) if waypoint < len(v.legs) else "",
            clock=clock(float(plan.reached_s[waypoint])),
            does=_does(action, hold_s) if waypoint else "climbs straight up to here",
            **_heights(facts.scene, v, place_m),
        )
    end_m = plan.trajectory.position_m[-1]
    yield _PlaceRow(
        number="",
        name={"land": "touch-down", "rtl": "touch-down at home", "loiter": "end"}[plan.end],
        item="",
        clock=clock(float(plan.trajectory.t_s[-1])),
        does=_ENDS[plan.end],
        **_heights(facts.scene, v, end_m),
    )


def _heights(scene: Scene, v: VehicleFacts, place_m: FloatArray) -> dict[str, str]:
    ground_m = float(scene.terrain.height_amsl_m(place_m[0], place_m[1]))
    return {
        "amsl": f"{place_m[2]:.0f}",
        "above_home": f"{place_m[2] - v.home_m[2]:.0f}",
        "above_ground": f"{place_m[2] - ground_m:.0f}" if math.isfinite(ground_m) else "not known",
    }


def _does(action: Action, hold_s: float) -> str:
    said = []
    if action.photo_every_m > 0.0:
        said.append(f"on the way a photo every {action.photo_every_m:g} m")
    if action.look_at_m is not None or action.look_deg is not None:
        heading = "" if action.look_deg is None else f", {action.look_deg[0]:.0f}° and {action.look_deg[1]:+.0f}°"
        said.append(f"looks at {action.inspects or 'its target'}{heading}")
    if hold_s > 0.0:
        said.append(f"stands {hold_s:g} s")
    if action.photos:
        said.append(f"{action.photos} photo{'s' if action.photos > 1 else ''}")
    return ", ".join(said) or "flies through"


# --- its figures


def _tiles(
    facts: Facts, v: VehicleFacts, stops: dict[int, tuple[str, Action]], model: EnergyModel | None
) -> Iterator[Tile]:
    plan = v.plan
    end_s = float(plan.trajectory.t_s[-1])
    yield Tile("takes off", clock(plan.start_delay_s), "after mission start")
    yield Tile("down again" if plan.end != "loiter" else "at its goal", clock(end_s), "after mission start")
    if model is not None:
        used = _used(facts, v, model)
        left = 1.0 - float(used[-1])
        enough = left >= model.reserve_share - 1e-9
        yield Tile("battery left", f"{left:.0%}", f"of it {model.reserve_share:.0%} in reserve", bad=not enough)
    yield Tile("returns at", f"{plan.motion.return_height_m:.0f} m", "above home")
    photos = sum(action.photos for _, action in stops.values())
    looked_at = {action.inspects for _, action in stops.values() if action.inspects}
    if looked_at:
        every = any(action.photo_every_m > 0.0 for _, action in stops.values())
        yield Tile("inspects", str(len(looked_at)), f"{photos} photos{', more on the way' if every else ''}")
    heights = plan.waypoints_m[:, 2] - v.home_m[2]
    yield Tile("heights", f"{heights.min():.0f}\N{EN DASH}{heights.max():.0f} m", "of waypoints, above home")
    yield Tile("way", f"{plan.length_m / 1000:.1f} km", f"{len(plan.waypoints_m)} waypoints")


def _used(facts: Facts, v: VehicleFacts, model: EnergyModel) -> FloatArray:
    wind_m_s = facts.scene.mission.wind_max_m_s or 0.0
    return energy.used_share(model, v.plan.trajectory, wind_m_s, v.plan.start_delay_s)


def _facts(facts: Facts, v: VehicleFacts, settings: Vehicle) -> Iterator[tuple[str, str]]:
    plan, frame = v.plan, facts.scene.frame
    home, goal = frame.geo_point(v.home_m), frame.geo_point(plan.waypoints_m[-1])
    autopilot = {"ardupilot": "ArduPilot", "px4": "PX4"}[plan.autopilot]
    yield "vehicle", f"{autopilot} {plan.vehicle_class}, sysid {plan.sysid}"
    if settings.uid is not None:
        yield "unique id of its autopilot", settings.uid
    yield "home", f"{home.lat_deg:.6f}, {home.lon_deg:.6f}, {home.alt_amsl_m:.1f} m AMSL"
    yield "last waypoint", f"{goal.lat_deg:.6f}, {goal.lon_deg:.6f}, {goal.alt_amsl_m:.1f} m AMSL; {_ENDS[plan.end]}"
    low, high = float(plan.speeds_m_s.min()), float(plan.speeds_m_s.max())
    yield "speed", f"{high:.1f} m/s" if low == high else f"{low:.1f} to {high:.1f} m/s"
    yield "way home", f"straight, at {plan.motion.return_height_m:g} m above home, or higher if it is higher"
    yield "files", f"files/{v.name}.plan, files/{v.name}.waypoints"
    certificate = facts.plan.certificate
    if certificate is not None and v.name in certificate.mission_sha256:
        yield "mission, SHA-256", f"{certificate.mission_sha256[v.name][:_HASH_SHOWN]}..."
    yield "plan", f"{facts.plan.mission.name}, seed {facts.plan.seed}, missionplanner {facts.plan.software_version}"


def _checklist(facts: Facts, v: VehicleFacts) -> Iterator[str]:
    """Yield what the crew looks at before the start."""
    within_m = min(facts.scene.mission.fleet.home_within_m or math.inf, v.task.limits.tube_m)
    yield f"stands at its home, within {within_m:g} m, and its altitude reads {v.home_m[2]:.0f} m AMSL"
    yield f"holds this mission: {len(v.waypoints_m)} waypoints, {_ENDS[v.plan.end]}"
    yield f"is set to return at {v.plan.motion.return_height_m:g} m above home"
    yield "fresh battery, propellers, memory card, camera and gimbal"
    yield "others and the site are told; the pilot can take over"


# --- its pictures


def _pictures(
    facts: Facts,
    outlines: Sequence[Shape],
    v: VehicleFacts,
    stops: dict[int, tuple[str, Action]],
    model: EnergyModel | None,
) -> Iterator[Picture]:
    numbered = {str(k): v.waypoints_m[waypoint] for k, waypoint in enumerate(stops) if waypoint}
    with style.look():
        yield picture(
            f"crew-{v.name}-map", "Its way", vehicle_map(facts, outlines, v, numbered),
            "Numbers as in the table. Beside the path, leg by leg: how much more its tube keeps from ground, obstacles "
            "and fence than it must.",
            f"Map of the way of {v.name} with its places numbered.",
        )  # fmt: skip
        yield picture(
            f"crew-{v.name}-height", "Heights", charts.height_profile(facts, outlines, v), "",
            f"Height of {v.name} over the terrain along its path.",
        )  # fmt: skip
        if model is not None:
            yield picture(
                f"crew-{v.name}-battery", "Battery", _battery(facts, v, model),
                f"Predicted{_windy(facts)}. Dashed: if it were told to return then.",
                f"How much of its battery {v.name} has used over time.",
            )  # fmt: skip


def _windy(facts: Facts) -> str:
    strongest_m_s = facts.scene.mission.wind_strongest_m_s
    return f", in wind of up to {strongest_m_s:g} m/s" if strongest_m_s > 0.0 else ", in calm air"


def _battery(facts: Facts, v: VehicleFacts, model: EnergyModel) -> Figure:
    """Draw how much of the battery is used over time, and would be if the vehicle returned at once."""
    track, wind_m_s = v.plan.trajectory, facts.scene.mission.wind_max_m_s or 0.0
    used = _used(facts, v, model)
    home = energy.return_share(model, track, v.home_m, v.plan.motion.return_height_m, wind_m_s)
    colour = style.vehicle_colour(v.index)
    figure = style.new_figure(2.0)
    axes = figure.add_axes((0.07, 0.22, 0.915, 0.66))
    flying = (track.t_s >= v.plan.start_delay_s) & (track.t_s <= v.plan.arrival_s)
    minutes = track.t_s / 60.0
    both = used + home
    shown = flying & np.isfinite(both)
    if shown.any():
        axes.plot(minutes[shown], 100.0 * both[shown], color=colour, linewidth=1.2, linestyle=(0, (4, 2)))
    axes.plot(minutes, 100.0 * used, color=colour, linewidth=2.0)
    allowed = 100.0 * (1.0 - model.reserve_share)
    top = max(100.0, 105.0 * float(used[-1]))
    axes.axhspan(allowed, top, color=style.BAD, alpha=0.09, linewidth=0, zorder=0)
    axes.axhline(allowed, color=style.BAD, linewidth=0.9)
    axes.annotate(
        f"reserve, {model.reserve_share:.0%}", xy=(0, allowed), xycoords=("axes fraction", "data"), xytext=(4, 3),
        textcoords="offset points", fontsize=7.5, color=style.BAD,
    )  # fmt: skip
    axes.set_xlim(0.0, float(minutes[-1]))
    axes.set_ylim(0.0, top)
    axes.set_xlabel("minutes after mission start")
    axes.set_ylabel("battery used (%)")
    style.quiet(axes)
    return figure


def clock(seconds: float) -> str:
    """Return a time as minutes and seconds."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
