"""Predicted against recorded flights: legs, arrival, position; ``missionplanner experiment fidelity``.

A recording's mission goes the way of everybody's: read from its file as items, read as a sortie (what its autopilot
makes of them), predicted as the proof and the planner's clock predict. What is compared, and against what, is told in
docs/FIDELITY.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from adapters.mission_items import TAKEOFF, MissionItem, degrees_to_wire
from adapters.sorties import SPLINE_WAYPOINT, read_sortie
from missionplanner import proof
from missionplanner.errors import MissionError, MissionPlannerError
from missionplanner.experiments.recordings import Kind, Recording, find_recordings, read_recording
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv
from missionplanner.geodesy import FloatArray
from missionplanner.mission import parse_mission
from missionplanner.plan import Trajectory
from missionplanner.proof import Flight
from missionplanner.replay import path_distance_m
from missionplanner.scene import Scene, build_scene
from missionplanner.vehicle import MotionModel

Progress = Callable[[str, float], None]

LEG_LEAST_S = 0.5
"""A leg that took less is none: two waypoints at one place, or a waypoint where the take-off ended."""

MARKS = ("<!-- fidelity: begin -->", "<!-- fidelity: end -->")
"""Between these lines of a Markdown file the table is kept up to date."""

_SETTLE_S = 2.0
_ROLLED_M = 20.0  # from there on a plane's course is the one it stood in
_NAMES: dict[Kind, str] = {"arducopter": "ArduCopter", "arduplane": "ArduPlane", "px4": "PX4 multicopter"}
_SPLINES = ", splines"
_COLOURS = {
    "ArduCopter": "#0072b2",
    "ArduCopter, splines": "#56b4e9",
    "ArduPlane": "#009e73",
    "PX4 multicopter": "#d55e00",
}
_DRAWN, _DRAWN_OF_A_KIND = 8, 3  # flights whose speed is drawn
_TICKS = (-100, -30, -10, -3, -1, 0, 1, 3, 10, 30, 100)
_ERROR_COLUMNS = "legs", "leg, mean", "leg, worst"
_PLACE_COLUMNS = "position 95 %", "path, most"
_KIND_COLUMNS = "kind", "flights", *_ERROR_COLUMNS, "arrival, worst", "", *_PLACE_COLUMNS, "wanted", ""
_FLIGHT_COLUMNS = "flight", "kind", *_ERROR_COLUMNS, "arrival", "", "after take-off", *_PLACE_COLUMNS
_INK, _MUTED = "#1d2730", "#66727d"


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a kind of flight is to keep; None: not asked."""

    leg_mean: float | None = None
    arrival: float = 0.03
    arrival_s: float = 0.0  # enough, even if that is more of a short flight
    position_p95_m: float | None = None
    path_max_m: float | None = None


WANTED = {
    "ArduCopter": Wanted(leg_mean=0.03, arrival=0.015, arrival_s=2.0, position_p95_m=3.0),
    "ArduCopter, splines": Wanted(path_max_m=3.0),
    "ArduPlane": Wanted(path_max_m=15.0),
    "PX4 multicopter": Wanted(leg_mean=0.04),
}


@dataclass(frozen=True, slots=True)
class LegTime:
    """The time between two waypoints that were reported, recorded and predicted."""

    from_seq: int  # of the take-off for the first leg
    to_seq: int
    recorded_s: float
    predicted_s: float

    @property
    def error(self) -> float:
        """Predicted over recorded, less 1: above 0 where the prediction is slow."""
        return self.predicted_s / self.recorded_s - 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One flight, recorded and predicted; errors are predicted less recorded."""

    recording: Recording
    splines: bool
    trajectory: Trajectory  # predicted
    due_s: dict[int, float]  # predicted times of items, by seq
    legs: tuple[LegTime, ...]
    arrival_s: float  # recorded
    arrival_error_s: float
    climb_error_s: float | None  # of the end of the take-off; None where the recording does not tell
    position_p95_m: float
    position_after_climb_p95_m: float | None  # both clocks set to 0 at the end of the take-off
    position_whole_p95_m: float  # also of what comes after the last waypoint: landing, return
    path_max_m: float
    notes: tuple[str, ...]

    @property
    def group(self) -> str:
        """Its kind in words, splines apart."""
        return _NAMES[self.recording.kind] + _SPLINES * self.splines

    @property
    def arrival_fraction(self) -> float:
        """The arrival's error over its time."""
        return self.arrival_error_s / self.arrival_s

    @property
    def leg_mean(self) -> float | None:
        """Mean of the absolute errors of the legs."""
        return float(np.mean([abs(leg.error) for leg in self.legs])) if self.legs else None

    @property
    def leg_worst(self) -> float | None:
        """The greatest absolute error of a leg."""
        return max((abs(leg.error) for leg in self.legs), default=None)

    @property
    def flight_error_s(self) -> float | None:
        """The arrival's error, counted from the end of the take-off."""
        return None if self.climb_error_s is None else self.arrival_error_s - self.climb_error_s

    @property
    def flight_fraction(self) -> float | None:
        """``flight_error_s`` over the recorded time from there."""
        climbed_s = self.recording.climbed_s
        if self.flight_error_s is None or climbed_s is None:
            return None
        return self.flight_error_s / (self.arrival_s - climbed_s)

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "name": self.recording.name,
            "kind": self.recording.kind,
            "splines": self.splines,
            "legs": len(self.legs),
            "leg_time_error_mean": _rounded(self.leg_mean, 5),
            "leg_time_error_worst": _rounded(self.leg_worst, 5),
            "arrival_s": round(self.arrival_s, 3),
            "arrival_error_s": round(self.arrival_error_s, 3),
            "arrival_error_fraction": round(self.arrival_fraction, 5),
            "position_error_p95_m": round(self.position_p95_m, 3),
            "position_error_whole_flight_p95_m": round(self.position_whole_p95_m, 3),
            "path_error_max_m": round(self.path_max_m, 3),
            "takeoff_error_s": _rounded(self.climb_error_s, 3),
            "arrival_error_after_takeoff_s": _rounded(self.flight_error_s, 3),
            "arrival_error_after_takeoff_fraction": _rounded(self.flight_fraction, 5),
            "position_error_after_takeoff_p95_m": _rounded(self.position_after_climb_p95_m, 3),
            "notes": list(self.notes),
        }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All flights that could be read, and why the others could not."""

    flights: tuple[Comparison, ...]
    unreadable: tuple[tuple[str, str], ...]  # name, reason

    def as_json(self) -> dict[str, Any]:
        """Return plain JSON values."""
        return {
            "flights": [flight.as_json() for flight in self.flights],
            "summary": {group: _summary(group, flights) for group, flights in self.groups().items()},
            "unreadable": [{"name": name, "error": reason} for name, reason in self.unreadable],
        }

    def groups(self) -> dict[str, list[Comparison]]:
        """Return the flights by kind, in the order of :data:`WANTED`."""
        found = {group: [f for f in self.flights if f.group == group] for group in WANTED}
        return {group: flights for group, flights in found.items() if flights}


def _summary(group: str, flights: Sequence[Comparison]) -> dict[str, Any]:
    wanted = WANTED[group]
    legs = [abs(leg.error) for flight in flights for leg in flight.legs]
    late = max(flights, key=lambda f: abs(f.arrival_fraction))
    p95_m, path_m = max(f.position_p95_m for f in flights), max(f.path_max_m for f in flights)
    mean = float(np.mean(legs)) if legs else None
    kept = all(_arrival_kept(f, wanted) for f in flights)
    kept &= wanted.leg_mean is None or mean is None or mean <= wanted.leg_mean
    kept &= wanted.position_p95_m is None or p95_m <= wanted.position_p95_m
    kept &= wanted.path_max_m is None or path_m <= wanted.path_max_m
    return {
        "flights": len(flights),
        "legs": len(legs),
        "leg_time_error_mean": _rounded(mean, 5),
        "leg_time_error_worst": _rounded(max(legs, default=None), 5),
        "arrival_error_worst_s": round(max(flights, key=lambda f: abs(f.arrival_error_s)).arrival_error_s, 3),
        "arrival_error_worst_fraction": round(late.arrival_fraction, 5),
        "arrival_error_mean_fraction": round(float(np.mean([abs(f.arrival_fraction) for f in flights])), 5),
        "position_error_p95_worst_m": round(p95_m, 3),
        "path_error_max_m": round(path_m, 3),
        "wanted_kept": kept,
    }


def _arrival_kept(flight: Comparison, wanted: Wanted) -> bool:
    late_s = abs(flight.arrival_error_s)
    return late_s <= max(wanted.arrival_s, wanted.arrival * flight.arrival_s)


# --- the comparison --------------------------------------------------------------------------------------------------


def main(output: Path, *, flights: Path, update: Path | None, progress: Progress) -> dict[str, Any]:
    """Run the experiment and write its tables and figures to a folder; return its figures as JSON values.

    Raises
    ------
    MissionError
        There is no flight, or none that can be read.
    """
    return run(output, flights, update=update, progress=progress).as_json()


def run(
    folder: Path, flights: Path, *, update: Path | None = None, progress: Progress = lambda _what, _share: None
) -> Results:
    """Compare all recorded flights of a folder; write tables and figures to another.

    Parameters
    ----------
    update : a Markdown file whose table, between :data:`MARKS`, is replaced
    """
    names = find_recordings(flights)
    ensure_writable(folder)
    document = None if update is None else _document(update)
    found: list[Comparison] = []
    unreadable: list[tuple[str, str]] = []
    for done, name in enumerate(names, start=1):
        try:
            found.append(compare(read_recording(flights, name)))
        except MissionPlannerError as error:
            unreadable.append((name, str(error)))
        progress("flights", done / len(names))
    if not found:
        raise MissionError(f"{flights}: none of {len(names)} flights can be read: {unreadable[0][1]}")
    results = Results(tuple(found), tuple(unreadable))
    _write(folder, results)
    if update is not None and document is not None:
        write_atomic(update, document[0] + table(results) + document[1])
    return results


def _document(path: Path) -> tuple[str, str]:
    """Return what of a Markdown file comes before and after the table."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise MissionError(f"--update: {path}: expected a readable text file, got: {error}") from error
    begin, end = (text.find(mark) for mark in MARKS)
    if not 0 <= begin < end:
        raise MissionError(f"--update: {path}: expected the lines {MARKS[0]} and {MARKS[1]} around the table")
    return text[: begin + len(MARKS[0])] + "\n", text[end:]


def predict(recording: Recording) -> Flight:
    """Return the flight that this software predicts of the recorded mission."""
    home_m = np.array([0.0, 0.0, recording.home.alt_amsl_m])
    scene = _scene(recording)
    motion = scene.tasks[0].motion
    plane = recording.kind == "arduplane"
    sortie = read_sortie(
        _facing(recording, motion) if plane else recording.items,
        name=recording.name,
        sysid=1,
        autopilot=recording.autopilot,
        vehicle_class=recording.vehicle_class,
        frame=recording.frame,
        home_m=home_m,
        motion=motion,
        airspeed_limits_m_s=motion.airspeed_limits_m_s if plane else None,
    )
    return proof.predict(scene, [sortie])[0]


def _facing(recording: Recording, motion: MotionModel) -> list[MissionItem]:
    """Return a plane's mission with its take-off ahead of it: it climbs out the way it stands, which this tells."""
    items = list(recording.items)
    rolled_m = recording.position_m - recording.position_m[0]
    moved = np.flatnonzero(np.hypot(*rolled_m[:, :2].T) > _ROLLED_M)
    for k, item in enumerate(items):
        if item.command == TAKEOFF and moved.size:
            away_m = rolled_m[moved[0]]
            ahead_m = away_m / np.hypot(*away_m[:2]) * motion.takeoff_distance_m(item.z, recording.home.alt_amsl_m)
            lat_deg, lon_deg, _ = recording.frame.to_geo(ahead_m)
            items[k] = replace(item, x=degrees_to_wire(float(lat_deg)), y=degrees_to_wire(float(lon_deg)))
    return items


def _scene(recording: Recording) -> Scene:
    """Return level ground with one vehicle on it, its parameters the autopilot's own defaults."""
    vehicle = {
        "name": recording.name,
        "autopilot": recording.autopilot,
        "class": recording.vehicle_class,
        "home": {"x_m": 0.0, "y_m": 0.0},
        "goal": {"x_m": 0.0, "y_m": 50.0, "height_agl_m": 100.0},  # a mission file must have one; nobody flies there
    }
    mission = {
        "name": "recorded",
        "origin": {"lat_deg": recording.home.lat_deg, "lon_deg": recording.home.lon_deg},
        "terrain": {"kind": "flat", "alt_amsl_m": recording.home.alt_amsl_m},
        "vehicles": [vehicle],
    }
    return build_scene(parse_mission(json.dumps(mission), recording.name), Path())


def compare(recording: Recording) -> Comparison:
    """Predict a recorded flight and hold the two against each other."""
    flight = predict(recording)
    due_s = _due_s(recording, flight)
    last = max((item.seq for item in recording.waypoints if item.seq in due_s), default=None)
    arrival_s = None if last is None else recording.passed_s(last)
    if last is None or arrival_s is None:
        raise MissionError(f"{recording.name}: expected a waypoint that is reached before the mission's end, got none")
    climbed_s, climb_due_s = recording.climbed_s, due_s.get(flight.sortie.legs[0].seq)
    started_s = max(0.0, climbed_s or 0.0)
    t_s, position_m = recording.t_s, recording.position_m
    until = (t_s >= 0.0) & (t_s <= arrival_s)
    if arrival_s <= started_s or not until.any():
        raise MissionError(
            f"{recording.name}: expected positions after 0 s and a last waypoint (item {last}) that is reached after "
            f"the take-off's end at {started_s:g} s, got one reached at {arrival_s:g} s and {until.sum()} positions "
            "until then"
        )
    climb_error_s = after_p95_m = None
    if climbed_s is not None and climb_due_s is not None:
        climb_error_s = climb_due_s - climbed_s
        away = until & (t_s >= climbed_s)
        if away.any():
            after_p95_m = _p95_m(flight.trajectory, position_m[away], t_s[away] + climb_error_s)
    end_s = min(float(t_s[-1]), float(flight.trajectory.t_s[-1]))
    whole = (t_s >= 0.0) & (t_s <= max(end_s, arrival_s))
    return Comparison(
        recording=recording,
        splines=any(item.command == SPLINE_WAYPOINT for item in recording.items),
        trajectory=flight.trajectory,
        due_s=due_s,
        legs=_legs(recording, due_s),
        arrival_s=arrival_s,
        arrival_error_s=due_s[last] - arrival_s,
        climb_error_s=climb_error_s,
        position_p95_m=_p95_m(flight.trajectory, position_m[until], t_s[until]),
        position_after_climb_p95_m=after_p95_m,
        position_whole_p95_m=_p95_m(flight.trajectory, position_m[whole], t_s[whole]),
        path_max_m=float(path_distance_m(position_m[until], _path_until(flight.trajectory, due_s[last])).max()),
        notes=tuple(f"item {gap.seq}: {gap.what}" for gap in flight.sortie.gaps),
    )


def _p95_m(predicted: Trajectory, position_m: FloatArray, t_s: FloatArray) -> float:
    off_m = np.linalg.norm(predicted.at(t_s) - position_m, axis=1)
    return float(np.percentile(off_m, 95))


def _path_until(predicted: Trajectory, arrival_s: float) -> FloatArray:
    """Return the predicted path up to the last waypoint, and a little of what follows: the flown one goes on too."""
    kept = predicted.t_s <= arrival_s + _SETTLE_S
    return predicted.position_m[kept][::2]


def _due_s(recording: Recording, flight: Flight) -> dict[int, float]:
    """Return when items are predicted to be reported as reached: autopilots do so once they have been held."""
    due_s: dict[int, float] = {}
    for leg, reached_s in zip(flight.sortie.legs, flight.reached_s.tolist(), strict=True):
        due_s[leg.seq] = reached_s + min(leg.hold_s, _own_hold_s(recording.items[leg.seq]))
    return due_s


def _own_hold_s(item: MissionItem) -> float:
    """Return how long an item asks to be held; what its leg is held for beyond that, a NAV_DELAY after it asks for."""
    return item.param1 if math.isfinite(item.param1) and item.param1 > 0.0 else 0.0


def _legs(recording: Recording, due_s: dict[int, float]) -> tuple[LegTime, ...]:
    """Return the legs between waypoints whose times were reported; the first begins where the take-off ended."""
    takeoff = min(due_s, default=0)
    climbed_s = recording.climbed_s
    at = None if climbed_s is None else (takeoff, climbed_s)
    legs = []
    for item in recording.waypoints:
        reached_s = recording.reached_s(item.seq)
        if reached_s is None or item.seq not in due_s:
            continue
        if at is not None and at[0] != item.seq and reached_s - at[1] >= LEG_LEAST_S:
            legs.append(LegTime(at[0], item.seq, reached_s - at[1], due_s[item.seq] - due_s[at[0]]))
        at = item.seq, reached_s
    return tuple(legs)


# --- what is written -------------------------------------------------------------------------------------------------


def _write(folder: Path, results: Results) -> None:
    rows = [flight.as_json() for flight in results.flights]
    columns = list(rows[0])
    write_csv(
        folder / "flights.csv",
        columns,
        [["; ".join(row[c]) if c == "notes" else row[c] for c in columns] for row in rows],
    )
    write_csv(
        folder / "legs.csv",
        ("flight", "kind", "from_item", "to_item", "recorded_s", "predicted_s", "error"),
        [
            (f.recording.name, f.group, leg.from_seq, leg.to_seq, round(leg.recorded_s, 3),
             round(leg.predicted_s, 3), round(leg.error, 5))
            for f in results.flights for leg in f.legs
        ],
    )  # fmt: skip
    write_atomic(folder / "results.json", json.dumps(results.as_json(), indent=1, allow_nan=False) + "\n")
    write_atomic(folder / "results.md", "# Predicted against recorded flights\n\n" + table(results))
    _draw(folder / "errors.png", partial(_draw_errors, results), (9.6, 1.4 + 0.17 * len(results.flights)))
    shown = _telling(results)
    _draw(folder / "speed.png", partial(_draw_speeds, shown), (9.6, 1.95 * math.ceil(len(shown) / 2)))


def table(results: Results) -> str:
    """Return the figures as Markdown: kinds of flight, then every flight."""
    kinds = [_KIND_COLUMNS, *(_kind_row(group, flights) for group, flights in results.groups().items())]
    rows = [_FLIGHT_COLUMNS, *(_flight_row(flight) for flight in results.flights)]
    lines = [*_aligned(kinds), "", *_aligned(rows)]
    if results.unreadable:
        lines += ["", "Not read:", ""] + [f"- {name}: {reason}" for name, reason in results.unreadable]
    return "\n".join(lines) + "\n"


def _kind_row(group: str, flights: Sequence[Comparison]) -> tuple[str, ...]:
    s = _summary(group, flights)
    return (
        group,
        str(s["flights"]),
        str(s["legs"]),
        _percent(s["leg_time_error_mean"]),
        _percent(s["leg_time_error_worst"]),
        f"{s['arrival_error_worst_fraction']:+.2%}",
        f"{s['arrival_error_worst_s']:+.2f} s",
        f"{s['position_error_p95_worst_m']:.2f} m",
        f"{s['path_error_max_m']:.2f} m",
        _wanted_words(WANTED[group]),
        "kept" if s["wanted_kept"] else "not kept",
    )


def _flight_row(f: Comparison) -> tuple[str, ...]:
    return (
        f.recording.name,
        f.group,
        str(len(f.legs)),
        _percent(f.leg_mean),
        _percent(f.leg_worst),
        f"{f.arrival_fraction:+.2%}",
        f"{f.arrival_error_s:+.2f} s",
        "" if f.flight_error_s is None else f"{f.flight_error_s:+.2f} s",
        f"{f.position_p95_m:.2f} m",
        f"{f.path_max_m:.2f} m",
    )


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a Markdown table that is as readable unrendered: words to the left, numbers to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    words = [not any(cell[:1] in "+-0123456789" for cell in column if cell) for column in zip(*rows[1:], strict=True)]
    for number, row in enumerate(rows):
        cells = [cell.ljust(w) if left else cell.rjust(w) for cell, w, left in zip(row, widths, words, strict=True)]
        yield f"| {' | '.join(cells)} |"
        if number == 0:
            rules = ["-" * (w + 2) if left else "-" * (w + 1) + ":" for w, left in zip(widths, words, strict=True)]
            yield f"|{'|'.join(rules)}|"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.2%}"


def _wanted_words(wanted: Wanted) -> str:
    words = [f"legs {wanted.leg_mean:.0%}"] if wanted.leg_mean is not None else []
    words.append(f"arrival {wanted.arrival:.1%}" + (f" or {wanted.arrival_s:g} s" if wanted.arrival_s else ""))
    words += [f"position {wanted.position_p95_m:g} m"] if wanted.position_p95_m is not None else []
    words += [f"path {wanted.path_max_m:g} m"] if wanted.path_max_m is not None else []
    return ", ".join(words)


def _draw(path: Path, paint: Callable[[Figure], None], size_in: tuple[float, float]) -> None:
    figure = Figure(figsize=size_in, dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    paint(figure)
    with replacing(path) as draft:
        figure.savefig(draft, format="png", metadata={"Software": None})


def _draw_errors(results: Results, figure: Figure) -> None:
    """Draw every flight's errors, kind by kind: its legs with mean and worst, its arrival, its position."""
    flights = [f for group in results.groups().values() for f in group]
    rows = np.arange(len(flights))
    colours = [_COLOURS[f.group] for f in flights]
    legs, arrival, place = figure.subplots(1, 3, sharey=True)
    for row, f in zip(rows, flights, strict=True):
        errors = [100.0 * leg.error for leg in f.legs]
        if errors:
            legs.plot([min(errors), max(errors)], [row, row], color=colours[row], linewidth=1.2, alpha=0.6)
            legs.plot(errors, [row] * len(errors), "|", color=colours[row], markersize=5)
    arrival.barh(rows, [100.0 * f.arrival_fraction for f in flights], color=colours, height=0.7)
    place.barh(rows, [f.position_p95_m for f in flights], color=colours, height=0.7)
    place.plot([f.path_max_m for f in flights], rows, "d", color=_INK, markersize=3)
    titles = ("time of each leg, %", "time of arrival, %", "position 95 %, m  (◆ path, most)")
    for axes, title in zip((legs, arrival, place), titles, strict=True):
        axes.set_title(title, fontsize=8, loc="left", color=_INK)
        axes.axvline(0.0, color=_MUTED, linewidth=0.8)
        axes.grid(axis="x", color="#d9dfe4", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.tick_params(labelsize=7, length=2)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    legs.set_yticks(rows, [f.recording.name for f in flights])
    legs.set_ylim(len(flights) - 0.5, -0.5)
    for axes in (legs, arrival):  # an outlier shall not hide the others
        axes.set_xscale("symlog", linthresh=5.0, linscale=2.0)
        _plain_ticks(axes)
        axes.set_xlabel("predicted slower (right) or faster (left) than recorded", fontsize=7, color=_MUTED)
    place.set_xscale("symlog", linthresh=3.0, linscale=2.0)
    _plain_ticks(place)
    for group, colour in _COLOURS.items():
        if any(f.group == group for f in flights):
            arrival.plot([], [], "s", color=colour, label=group)
    figure.legend(loc="outside lower center", ncols=4, fontsize=7.5, frameon=False)


def _plain_ticks(axes: Axes) -> None:
    low, high = axes.get_xlim()
    axes.set_xticks([tick for tick in _TICKS if low <= tick <= high])
    axes.set_xlim(low, high)
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


def _telling(results: Results) -> list[Comparison]:
    """Return of each kind the flight with the worst leg, then those whose arrival is furthest off."""
    shown = [max(flights, key=lambda f: f.leg_worst or 0.0) for flights in results.groups().values()]
    for f in sorted(results.flights, key=lambda f: -abs(f.arrival_fraction)):
        of_its_kind = sum(other.group == f.group for other in shown)
        if len(shown) < _DRAWN and f not in shown and of_its_kind < _DRAWN_OF_A_KIND:
            shown.append(f)
    return shown


def _draw_speeds(flights: Sequence[Comparison], figure: Figure) -> None:
    """Draw ground speeds over time, recorded and predicted, with the times at the waypoints."""
    panels = np.ravel(figure.subplots(math.ceil(len(flights) / 2), 2, squeeze=False))
    for axes, f in zip(panels, flights, strict=False):
        recording, predicted = f.recording, f.trajectory
        step_s = np.diff(predicted.t_s)
        predicted_m_s = np.linalg.norm(np.diff(predicted.position_m[:, :2], axis=0), axis=1) / np.maximum(step_s, 1e-9)
        shown = recording.t_s <= f.arrival_s + 10.0
        axes.plot(recording.t_s[shown], recording.speed_m_s[shown], color=_INK, linewidth=1.3, label="recorded")
        until = predicted.t_s[1:] <= max(f.arrival_s, f.arrival_s + f.arrival_error_s) + 10.0
        axes.plot(
            predicted.t_s[1:][until], predicted_m_s[until], color=_COLOURS[f.group], linewidth=1.3, label="predicted"
        )
        _mark_times(axes, f)
        axes.set_title(
            f"{recording.name} ({f.group}): arrival {f.arrival_fraction:+.1%}", fontsize=8, loc="left", color=_INK
        )
        axes.set_ylim(bottom=0.0)
        axes.set_xlim(0.0, float(max(recording.t_s[shown][-1], predicted.t_s[1:][until][-1])))
        axes.tick_params(labelsize=7, length=2)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    for axes in panels[len(flights) :]:
        axes.set_visible(False)
    for axes in panels[::2]:
        axes.set_ylabel("ground speed, m/s", fontsize=7.5, color=_MUTED)
    for axes in panels[max(len(flights) - 2, 0) : len(flights)]:
        axes.set_xlabel("s since mission start; ticks: waypoints reached", fontsize=7.5, color=_MUTED)
    key = [Line2D([], [], color=_INK), Line2D([], [], color=_COLOURS["ArduCopter"])]
    figure.legend(
        key, ["recorded", "predicted (coloured)"], loc="outside upper right", ncols=2, fontsize=7.5, frameon=False
    )


def _mark_times(axes: Axes, f: Comparison) -> None:
    """Mark when waypoints were reached: recorded above, predicted below the upper edge."""
    known = [item.seq for item in f.recording.waypoints if f.recording.reached_s(item.seq) is not None]
    recorded = [at_s for item in f.recording.waypoints if (at_s := f.recording.reached_s(item.seq)) is not None]
    across = axes.get_xaxis_transform()
    axes.vlines(recorded, 0.955, 1.0, transform=across, color=_INK, linewidth=0.8)
    axes.vlines([f.due_s[seq] for seq in known if seq in f.due_s], 0.9, 0.945, transform=across,
                color=_COLOURS[f.group], linewidth=0.8)  # fmt: skip
