"""What a plan and a flight come to, once: as a dictionary for ``--json``, and as tables of the same figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import groupby
from typing import TYPE_CHECKING, Any

from rich import box
from rich.table import Table
from rich.text import Text

from missionplanner.autopilot_parameters import shown
from missionplanner.certificate import Certificate, Check, Finding
from missionplanner.flight_check import FlightCheck
from missionplanner.plan import Clearance, FleetFlight, FleetPlan, FlownMeeting

if TYPE_CHECKING:  # the solver takes a while to import, and plans of one round do without it
    from missionplanner.coverage import Coverage
    from missionplanner.inspection import InspectionPlan, Round


def summarise(plan: FleetPlan, flight: FleetFlight | None = None, check: FlightCheck | None = None) -> dict[str, Any]:
    """Return the figures of a plan and, where it was flown, of its flight; all of them plain JSON values."""
    vehicles = []
    for index, vehicle in enumerate(plan.vehicles):
        row: dict[str, Any] = {
            "name": vehicle.name,
            "sysid": vehicle.sysid,
            "length_m": round(vehicle.length_m, 2),
            "waypoints": len(vehicle.waypoints_m),
            "speeds_m_s": _runs(vehicle.speeds_m_s.tolist()),
            "hold_s": float(vehicle.hold_s.sum()),
            "start_delay_s": vehicle.start_delay_s,
            "window_s": [round(t, 2) for t in vehicle.window_s],
            "arrival_s": round(vehicle.arrival_s, 2),
            "cost": vehicle.cost,
            "clearances": [_clearance(c) for c in vehicle.clearances],
        }
        if flight is not None and check is not None:
            arrival_s = flight.vehicles[index].arrival_s
            row["flown_arrival_s"] = None if arrival_s is None else round(arrival_s, 2)
            row["flown_clearances"] = [_clearance(c) for c in check.clearances[index]]
        vehicles.append(row)
    wind = plan.mission.wind
    fleet: dict[str, Any] = {
        "wind": None if wind is None else wind.model_dump(),
        "arrival_s": None if plan.arrival_s is None else round(plan.arrival_s, 2),
        "rendezvous": [str(f.detail) for f in _findings(plan.certificate, "rendezvous")],
        "resolutions": [asdict(resolution) for resolution in plan.resolutions],
        "separation": plan.separation and _clearance(plan.separation),
        "clear": all(c.ok for v in plan.vehicles for c in v.clearances) and (not plan.separation or plan.separation.ok),
    }
    if flight is not None and check is not None:
        spread_s = flight.arrival_spread_s
        fleet["flown_arrival_spread_s"] = None if spread_s is None else round(spread_s, 3)
        fleet["flown_rendezvous"] = [_meeting(meeting) for meeting in flight.meetings]
        fleet["flown_separation"] = check.separation and _clearance(check.separation)
        fleet["flown_clear"] = check.ok
    return {
        "mission": plan.mission.name,
        "seed": plan.seed,
        "software_version": plan.software_version,
        "input_sha256": plan.input_sha256,
        "vehicles": vehicles,
        "fleet": fleet,
        "proof": _proof(plan.certificate),
    }


def vehicle_table(summary: dict[str, Any]) -> Table:
    """Return one row per vehicle: length, speed, predicted and flown arrival, least clearances."""
    flown = "flown_clear" in summary["fleet"]
    table = Table(
        title=f"{summary['mission']}, {'flown' if flown else 'kept by proof'} (in brackets: the least allowed)",
        box=box.SIMPLE,
        title_justify="left",
        padding=(0, 1),
    )
    table.add_column("vehicle", no_wrap=True, min_width=max(len(row["name"]) for row in summary["vehicles"]))
    for heading in ("length\nm", "speed\nm/s", "window\ns", "arrival\ns", *(["flown\ns"] if flown else [])):
        table.add_column(heading, justify="right", no_wrap=True)
    for heading in ("to ground\nm", "to obstacle\nm"):
        table.add_column(heading, no_wrap=True)
    for row in summary["vehicles"]:
        clearances = row["flown_clearances" if flown else "clearances"]
        cells = [
            row["name"],
            f"{row['length_m']:.0f}",
            _range(row["speeds_m_s"]),
            f"{row['window_s'][0]:.0f}-{row['window_s'][1]:.0f}",
            f"{row['arrival_s']:.1f}",
        ]
        if flown:
            arrival_s = row["flown_arrival_s"]
            cells.append("never" if arrival_s is None else f"{arrival_s:.1f}")
        cells.append(_least(clearances, "terrain"))
        cells.append(_least(clearances, "obstacle"))
        table.add_row(*cells)
    return table


def fleet_lines(summary: dict[str, Any]) -> list[str]:
    """Return the fleet's figures, a line each."""
    fleet = summary["fleet"]
    lines = _proof_lines(summary["proof"])
    if fleet["wind"] is not None:
        told = "{speed_m_s:g} m/s from {from_deg:g} degrees".format(**fleet["wind"])
        lines.append(f"predicted in a steady wind of {told}")
    if fleet["arrival_s"] is not None:
        lines.append(f"common arrival: {fleet['arrival_s']:.1f} s after mission start")
    lines += [f"rendezvous {told}" for told in fleet["rendezvous"]]
    lines += [_resolution_line(resolution) for resolution in fleet["resolutions"]]
    if fleet["separation"]:
        lines.append(f"least separation predicted: {_apart(fleet['separation'])}")
    if "flown_clear" not in fleet:
        return lines
    if fleet["arrival_s"] is not None:
        spread_s = fleet["flown_arrival_spread_s"]
        lines.append(f"spread of arrivals flown: {'not all arrived' if spread_s is None else f'{spread_s:.2f} s'}")
    lines += [_meeting_line(meeting) for meeting in fleet["flown_rendezvous"]]
    if fleet["flown_separation"]:
        lines.append(f"least separation flown: {_apart(fleet['flown_separation'])}")
    lines.append("flown clear of terrain, obstacles and each other: " + ("yes" if fleet["flown_clear"] else "NO"))
    return lines


def certificate_table(certificate: Certificate) -> Table:
    """Return one row per finding: what is not proven first, then what the mission waives."""
    title = "proven" if certificate.proven and certificate.findings else "NOT PROVEN"
    table = Table(title=title, box=box.SIMPLE, title_justify="left", padding=(0, 1))
    table.add_column("verdict", no_wrap=True)
    table.add_column("vehicle", no_wrap=True)
    for heading in ("check", "item"):
        table.add_column(heading, no_wrap=True, justify="right" if heading == "item" else "left")
    table.add_column("what is found")
    for finding in sorted(certificate.findings, key=lambda f: (f.holds, f.proven)):
        verdict, look = _verdict(finding)
        told = f"{finding.detail}: {finding.remedy}" if finding.remedy and not finding.proven else finding.detail
        seq = "" if finding.seq is None else str(finding.seq)
        # Text, not markup: names and details come from the user's files
        row = (Text(verdict, look), Text(finding.vehicle or "fleet"), Text(finding.check), Text(seq), Text(told))
        table.add_row(*row)
    return table


def moves_table(moves: Sequence[Mapping[str, Any]]) -> Table:
    """Return one row per waypoint that was moved: how far, where to, and its new place."""
    table = Table(title=f"waypoints moved: {len(moves)}", box=box.SIMPLE, title_justify="left", padding=(0, 1))
    table.add_column("vehicle", no_wrap=True)
    for heading in ("item", "shifted m", "course deg", "raised m", "new place", "m AMSL"):
        table.add_column(heading, justify="right", no_wrap=True)
    for move in moves:
        course, after = move["course_deg"], move["after"]
        table.add_row(
            Text(move["vehicle"]),
            str(move["seq"]),
            f"{move['shifted_m']:.2f}",
            "-" if course is None else f"{course:.0f}",
            f"{move['raised_m']:+.2f}",
            f"{after['lat_deg']:.7f}, {after['lon_deg']:.7f}",
            f"{after['alt_amsl_m']:.2f}",
        )
    return table


def parameter_table(vehicle: Mapping[str, Any]) -> Table:
    """Return one row per parameter of a vehicle: what it holds, what that means, and what it should hold."""
    who = f", uid {vehicle['uid']}" if vehicle["uid"] else ""
    title = f"{vehicle['name']} (sysid {vehicle['sysid']}{who}), {vehicle['autopilot']} {vehicle['class']}"
    table = Table(title=title, box=box.SIMPLE, title_justify="left", padding=(0, 1))
    table.add_column("parameter", no_wrap=True)
    table.add_column("holds", justify="right", no_wrap=True)
    table.add_column("sets", no_wrap=True)
    table.add_column("planned with", justify="right", no_wrap=True)
    planned = {difference["name"]: difference["planned"] for difference in vehicle["differences"]}
    for name, value in vehicle["parameters"].items():
        wanted = Text(shown(planned[name]), "bold red") if name in planned else ""
        table.add_row(Text(name), "-" if value is None else shown(value), Text(vehicle["sets"].get(name, "")), wanted)
    return table


def _verdict(finding: Finding) -> tuple[str, str]:
    if finding.proven:
        return "proven", "green"
    return ("waived", "yellow") if finding.waived else ("NOT PROVEN", "bold red")


def _proof(certificate: Certificate | None) -> dict[str, Any]:
    """Return the proof in figures; where nothing was checked, nothing is proven."""
    if certificate is None or not certificate.findings:
        return {"proven": False, "problems": ["nothing is proven of it: check it"], "waived": [], "lateness_s": None}
    late = [f.value for f in certificate.findings if f.check == "lateness" and f.value is not None]
    return {
        "proven": certificate.proven,
        "problems": [str(finding) for finding in certificate.problems],
        "waived": [str(finding) for finding in certificate.findings if finding.waived and not finding.proven],
        # rounded down: no more is proven
        "lateness_s": math.floor(round(min(late) * 100.0, 6)) / 100.0 if late and math.isfinite(min(late)) else None,
    }


def _proof_lines(proof: dict[str, Any]) -> list[str]:
    late_s, waived, problems = proof["lateness_s"], proof["waived"], proof["problems"]
    late = "" if late_s is None else f"; all keep apart while none is more than {late_s:g} s early or late"
    but = f", but for what the mission waives ({len(waived)})" if waived else ""
    verdict = f"yes{but}" if proof["proven"] else f"NO, {len(problems)} check{'s' if len(problems) > 1 else ''} failed"
    told = [f"  not proven: {problem}" for problem in problems] + [f"  waived: {line}" for line in waived]
    return [f"proven: {verdict}{late}", *told]


def _findings(certificate: Certificate | None, check: Check) -> list[Finding]:
    return [] if certificate is None else [f for f in certificate.findings if f.check == check]


def _runs(speeds_m_s: Sequence[float]) -> list[float]:
    """Return the speeds that are commanded one after the other."""
    return [speed_m_s for speed_m_s, _ in groupby(speeds_m_s)]


def _range(speeds_m_s: Sequence[float]) -> str:
    low, high = min(speeds_m_s), max(speeds_m_s)
    return f"{low:.2f}" if low == high else f"{low:.1f}-{high:.1f}"


def _resolution_line(resolution: Mapping[str, Any]) -> str:
    why = f"to keep apart from {resolution['other']} at {resolution['t_s']:.0f} s" if resolution["other"] else ""
    return f"{resolution['vehicle']} {resolution['detail']} {why}".rstrip()


def _meeting(meeting: FlownMeeting) -> dict[str, Any]:
    return {
        "name": meeting.name,
        "times_s": {name: None if t_s is None else round(t_s, 2) for name, t_s in meeting.times_s.items()},
        "spread_s": None if meeting.spread_s is None else round(meeting.spread_s, 2),
    }


def _meeting_line(meeting: Mapping[str, Any]) -> str:
    there = [f"{name} {'never' if t_s is None else f'at {t_s:.1f} s'}" for name, t_s in meeting["times_s"].items()]
    spread = "" if meeting["spread_s"] is None else f" (within {meeting['spread_s']:.1f} s)"
    return f"rendezvous {meeting['name']} flown: {', '.join(there)}{spread}"


def _clearance(clearance: Clearance) -> dict[str, Any]:
    return {
        "to": clearance.what,
        "distance_m": round(clearance.distance_m, 2),
        "required_m": round(clearance.required_m, 2),
        "ok": clearance.ok,
        "t_s": None if clearance.t_s is None else round(clearance.t_s, 1),
    }


def _least(clearances: list[dict[str, Any]], kind: str) -> str:
    for c in clearances:
        if (c["to"] == kind) or (kind == "obstacle" and c["to"] not in {"terrain", "ceiling", "fence"}):
            where = "" if kind == "terrain" else f" {c['to']}"
            return f"{c['distance_m']:.1f} ({c['required_m']:g}){where}"
    return "-"


def _apart(c: dict[str, Any]) -> str:
    return f"{c['distance_m']:.1f} m (>= {c['required_m']:g} m), {c['to']}, at {c['t_s']:.0f} s"


def replay_table(found: dict[str, Any]) -> Table:
    """Return one row per replayed vehicle; errors along the way are those before its arrival."""
    table = Table(
        title=f"{found['mission']}, flown against planned (above 0: late, ahead)",
        box=box.SIMPLE,
        title_justify="left",
        padding=(0, 1),
    )
    table.add_column("vehicle", no_wrap=True)
    headings = ("arrival\ns", "late\ns", "off its time\n95 % s", "cross-track\n95 % m", "\nmost m")
    for heading in (*headings, "height\nmost m", "along-track\n95 % m", "\nmost m"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in found["vehicles"]:
        arrival_s = row["arrival_s"]
        table.add_row(
            row["name"],
            "never" if arrival_s is None else f"{arrival_s:.1f}",
            "" if row["arrival_error_s"] is None else f"{row['arrival_error_s']:+.2f}",
            f"{row['time_error_s']['p95']:.2f}",
            f"{row['cross_track_m']['p95']:.2f}",
            f"{row['cross_track_m']['worst']:.2f}",
            f"{row['above_m']['worst']:.2f}",
            f"{row['along_track_m']['p95']:.2f}",
            f"{max(row['along_track_m']['least'], row['along_track_m']['most'], key=abs):+.2f}",
        )
    return table


def replay_lines(found: dict[str, Any]) -> list[str]:
    """Return what is to be said of a replayed fleet."""
    fleet, lines = found["fleet"], []
    if len(found["vehicles"]) > 1:
        spread_s = fleet["arrival_spread_s"]
        flown = "not all arrived" if spread_s is None else f"{spread_s:.2f} s"
        lines.append(f"arrivals from first to last: {flown} (planned {fleet['planned_arrival_spread_s']:.2f} s)")
    near = fleet["separation"]
    if near is not None:
        verdict = "" if near["ok"] else ": TOO CLOSE"
        lines.append(
            f"least separation flown: {near['distance_m']:.1f} m, {near['between']}, at {near['t_s']:.1f} s "
            f"({near['required_m']:g} m required){verdict}"
        )
    return [*lines, found["start"]["told"], *found["notes"]]


def summarise_inspection(
    planned: InspectionPlan,
    flown: Sequence[tuple[FleetFlight, FlightCheck]] = (),
    seen: Coverage | None = None,
) -> dict[str, Any]:
    """Return the figures of an inspection and, of the rounds that were flown, of their flights; plain JSON values.

    ``seen``: what those have seen.
    """
    asked = list(dict.fromkeys(visit.target for visit in planned.visits))
    vehicles_s = [float(v.trajectory.t_s[-1]) - v.start_delay_s for r in planned.rounds for v in r.plan.vehicles]
    return {
        "mission": planned.scene.mission.name,
        "seed": planned.seed,
        "targets": len({*asked, *(left.target for left in planned.left_out)}),
        "inspected": len(planned.inspected),
        "done_before": sorted(planned.done),
        "left_out": [{"target": left.target, "why": left.why} for left in planned.left_out],
        "notes": [f"{visit.name}: {visit.note}" for visit in planned.visits if visit.note],
        "share": round(planned.share, 4),
        "share_min": planned.share_min,
        "makespan_s": round(planned.makespan_s, 1),
        "flight_time_s": round(sum(vehicles_s), 1),
        "flight_time_bound_s": round(planned.assignment.bound_s, 1),
        "swap_s": planned.swap_s,
        "rounds": [
            {
                **summarise(r.plan, *(flown[k] if k < len(flown) else (None, None))),
                "lasts_s": round(r.lasts_s, 1),
                "sorties": _sorties(r),
            }
            for k, r in enumerate(planned.rounds)
        ],
        "flown_rounds": len(flown),
        "seen": None if seen is None else _seen(planned, seen),
    }


def _seen(planned: InspectionPlan, seen: Coverage) -> dict[str, Any]:
    return {
        "share": round(planned.share_of(seen.done | planned.done), 4),
        "targets": sorted(seen.done),
        "missing": list(seen.missing),
        "notes": list(seen.notes),
        "spans_share": None if seen.spans_share is None else round(seen.spans_share, 4),
        "photos": _taken(seen),
    }


def _taken(seen: Coverage) -> int | None:
    """Return how many photos show something that was asked for; None: no log tells."""
    photos = [*(row.photos for row in seen.towers), *(row.photos for row in seen.spans)]
    told = [count for count in photos if count is not None]
    return sum(told) if told else None


def _sorties(round_: Round) -> list[dict[str, Any]]:
    rows = []
    tours = {round_.plan.vehicles[k].name: tour for k, tour in enumerate(round_.tours)}
    for vehicle in round_.plan.vehicles:
        used = [
            f.value for f in _findings(round_.plan.certificate, "energy") if f.vehicle == vehicle.name and not f.unit
        ]
        rows.append(
            {
                "vehicle": vehicle.name,
                "targets": list(dict.fromkeys(visit.target for visit in tours[vehicle.name].visits)),
                "visits": [visit.name for visit in tours[vehicle.name].visits],
                "photos": sum(action.photos for action in vehicle.actions.values()),
                "lands_s": round(float(vehicle.trajectory.t_s[-1]), 1),
                "battery_share": round(used[0], 4) if used and used[0] is not None else None,
            }
        )
    return rows


def inspection_table(summary: dict[str, Any]) -> Table:
    """Return one row per sortie: who, how far and long, what it looks at, how much of the battery, least clearances."""
    flown = summary["flown_rounds"] > 0
    table = Table(
        title=f"{summary['mission']}, {'flown' if flown else 'kept by proof'} (in brackets: the least allowed)",
        box=box.SIMPLE,
        title_justify="left",
        padding=(0, 1),
    )
    table.add_column("round", justify="right")
    table.add_column("vehicle", no_wrap=True)
    for heading in ("targets", "photos", "length\nm", "lands\ns", *(["flown\ns"] if flown else []), "battery\n%"):
        table.add_column(heading, justify="right", no_wrap=True)
    for heading in ("to ground\nm", "to obstacle\nm"):
        table.add_column(heading, no_wrap=True)
    for number, round_ in enumerate(summary["rounds"], start=1):
        for vehicle, sortie in zip(round_["vehicles"], round_["sorties"], strict=True):
            was_flown = "flown_clearances" in vehicle
            cells = [
                str(number),
                vehicle["name"],
                str(len(sortie["targets"])),
                str(sortie["photos"]),
                f"{vehicle['length_m']:.0f}",
                f"{sortie['lands_s']:.0f}",
            ]
            if flown:
                landed_s = vehicle.get("flown_arrival_s")
                cells.append("-" if not was_flown else "never" if landed_s is None else f"{landed_s:.0f}")
            share = sortie["battery_share"]
            cells.append("-" if share is None else f"{100.0 * share:.0f}")
            clearances = vehicle["flown_clearances" if was_flown else "clearances"]
            table.add_row(*cells, _least(clearances, "terrain"), _least(clearances, "obstacle"))
    return table


def inspection_lines(summary: dict[str, Any]) -> list[str]:
    """Return the whole inspection's figures, a line each: what is left out and what is not proven above all."""
    lines = []
    proofs = [round_["proof"] for round_ in summary["rounds"]]
    for number, proof in enumerate(proofs, start=1):
        first, *rest = _proof_lines(proof)
        lines += [f"round {number}: {first}", *rest]
    rounds = len(summary["rounds"])
    lines.append(
        f"inspected: {summary['inspected']} of {summary['targets']} targets"
        + (f", {len(summary['done_before'])} were before" if summary["done_before"] else "")
        + f"; {summary['share']:.1%} of the towers' weight (at least {summary['share_min']:.0%})"
    )
    lines += [f"left out: {left['target']}: {left['why']}" for left in summary["left_out"]]
    lines.append(
        f"{rounds} {'round' if rounds == 1 else 'rounds'} in {_clock(summary['makespan_s'])}"
        + (f" with {summary['swap_s']:g} s between them" if rounds > 1 else "")
        + f"; flying {_clock(summary['flight_time_s'])} in all, no less than {_clock(summary['flight_time_bound_s'])} "
        "by reckoning"
    )
    for number, round_ in enumerate(summary["rounds"], start=1):
        lines += [f"round {number}: {_resolution_line(r)}" for r in round_["fleet"]["resolutions"]]
        flown = round_["fleet"]
        if "flown_clear" in flown:
            near = flown["flown_separation"]
            apart = f", least separation {_apart(near)}" if near else ""
            lines.append(f"round {number} flown clear: {'yes' if flown['flown_clear'] else 'NO'}{apart}")
    seen = summary["seen"]
    if seen is not None:
        photos = "" if seen["photos"] is None else f", on {seen['photos']} photos"
        spans = "" if seen["spans_share"] is None else f"; {seen['spans_share']:.1%} of the spans' length"
        lines.append(f"seen by what was flown: {seen['share']:.1%} of the towers' weight{spans}{photos}")
        lines += [f"  {told}" for told in seen["notes"]]
        lines += [f"  not seen: {told}" for told in seen["missing"]]
    return lines


def coverage_table(found: Mapping[str, Any]) -> Table:
    """Return one row per side of a tower, and of a span, that was to be seen: those that were not, first."""
    table = Table(title=f"{found['mission']}, seen", box=box.SIMPLE, title_justify="left", padding=(0, 1))
    table.add_column("seen", no_wrap=True)
    table.add_column("what", no_wrap=True)
    for heading in ("from\nm", "off its side\ndegrees", "mm a\npixel", "photos"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("by")
    table.add_column("why not")
    rows = sorted([*found["towers"], *found["spans"]], key=lambda row: row["seen"])
    for row in rows:
        span = "share" in row
        who = ", ".join(row["vehicles"]) if span else row["vehicle"] if row["seen"] else ""
        why = "" if row["seen"] else f"{row['share']:.0%} of its length" if span else row["why"]
        table.add_row(
            Text("yes", "green") if row["seen"] else Text("NO", "bold red"),
            Text(row["name"]),
            _figure(row["distance_max_m" if span else "distance_m"], 1),
            "" if span else _figure(row["angle_deg"], 0),
            _figure(row["gsd_mm"], 1),
            "?" if row["photos"] is None else str(row["photos"]),
            Text(who),
            Text(why),
        )
    return table


def coverage_lines(found: Mapping[str, Any]) -> list[str]:
    """Return what was seen in all, a line each, and what must be known of it."""
    lines = [f"seen: {found['share']:.1%} of the towers' weight (at least {found['share_min']:.0%})"]
    if found["spans_share"] is not None:
        lines.append(f"seen of the spans: {found['spans_share']:.1%} of their length from the sides asked for")
    return [*lines, *found["notes"]]


def _figure(value: float | None, places: int) -> str:
    return "-" if value is None else f"{value:.{places}f}"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"
