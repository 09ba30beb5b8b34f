"""Uploads over bad links, loads, and frames that nobody should believe; ``missionplanner experiment links``.

Three parts: uploads over links that lose, double, overtake and delay frames, ours in simulated time (hundreds) and,
beside MAVSDK's, in real time over UDP (few); what many items, vehicles and much telemetry cost; mutated frames to
vehicles and ground station. Whatever an uploader calls a success is compared with what the vehicle really holds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from itertools import zip_longest
from pathlib import Path
from statistics import median
from typing import Any, get_args

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from missionplanner.experiments import link_fuzz, link_loads
from missionplanner.experiments import link_trials as trials
from missionplanner.experiments.campaign import Job, run, version_of
from missionplanner.experiments.document import joined, machine
from missionplanner.files import ensure_writable, replacing, write_atomic, write_csv
from missionplanner.vehicle import Autopilot

Progress = Callable[[str, float], None]

AUTOPILOTS: tuple[Autopilot, ...] = ("ardupilot", "px4")
ITEMS = 100
_BATCH = 20
_EPISODE = 50_000
_CLIENTS_AT_ONCE = 10
_SPOOFED = 40
_SPOOFED_FRAMES = 5
_SOURCES = ("missionplanner.experiments.link_trials", "missionplanner.experiments.link_fuzz", "adapters", "sim")
_COLOURS = {"missionplanner": "#0072b2", "simulated": "#56b4e9", "mavsdk": "#d55e00"}
_LOSSES = {"0% loss": 0, "5% loss": 5, "20% loss": 20, "40% loss": 40}


def main(
    folder: Path,
    *,
    runs: int = 200,
    frames: int = 1_000_000,
    seed: int = 1,
    quick: bool = False,
    workers: int | None = None,
    cluster: str | None = None,
    progress: Progress = lambda _what, _share: None,
) -> dict[str, Any]:
    """Measure; write results.md, uploads.csv and links.png into ``folder``; return the figures.

    Parameters
    ----------
    runs : uploads per autopilot and link, in simulated time
    frames : mutated, to the vehicles and as many to the ground station

    Raises
    ------
    MissionError
        The folder cannot be written to; a campaign of another version is in it.
    """
    ensure_writable(folder)
    items, at_once = (20, 2) if quick else (ITEMS, _CLIENTS_AT_ONCE)
    runs, frames = (min(runs, 4), min(frames, 10_000)) if quick else (runs, frames)
    compared = list(_LOSSES)[:1] if quick else list(_LOSSES)
    names: list[trials.Client] = [c for c in get_args(trials.Client) if c != "mavsdk" or trials.mavsdk_version()]
    waiting = [
        Job(
            f"{client} {autopilot} {link}",
            trials.clients,
            {"client": client, "autopilot": autopilot, "link": link}
            | {"items": items, "vehicles": at_once, "seed": seed},
        )
        for link in compared
        for autopilot in AUTOPILOTS
        for client in names
    ]
    computing = [
        *_upload_jobs(runs, items, seed),
        *(
            Job(f"frames to {work.__name__} {k}", work, {"frames": min(_EPISODE, frames - first), "seed": seed + k})
            for k, first in enumerate(range(0, frames, _EPISODE))
            for work in (link_fuzz.vehicles, link_fuzz.ground_station)
        ),
        Job(
            "second station",
            link_fuzz.spoofed_uploads,
            {"uploads": 8 if quick else _SPOOFED, "frames_each": _SPOOFED_FRAMES, "seed": seed},
        ),
    ]
    # what only waits, in real time, beside what computes
    jobs = [job for pair in zip_longest(waiting, computing) for job in pair if job is not None]
    settings = {"runs": runs, "frames": frames, "seed": seed, "items": items, "mavsdk": trials.mavsdk_version()}
    found = run(
        jobs,
        folder,
        experiment="links",
        version=version_of(settings, _SOURCES),
        workers=workers,
        cluster=cluster,
        progress=progress,
    )
    figures = {
        "uploads": _uploads(found, "simulated", list(trials.links())),
        "clients": [row for client in names for row in _uploads(found, client, compared)],
        "loads": [asdict(load) for load in _loads(names, seed, quick=quick, progress=progress)],
        "telemetry": [asdict(served) for served in _telemetry(quick=quick, progress=progress)],
        "frames": [_fuzzed(found, work.__name__) for work in (link_fuzz.vehicles, link_fuzz.ground_station)],
        "second_station": found["second station"],
        "mavsdk": trials.mavsdk_version(),
        "items": items,
    }
    _write(folder, figures)
    return figures


def _upload_jobs(runs: int, items: int, seed: int) -> list[Job]:
    return [
        Job(
            f"simulated {autopilot} {link} {first}",
            trials.uploads,
            {
                "autopilot": autopilot,
                "link": link,
                "items": items,
                "seeds": list(range(seed + first, seed + min(first + _BATCH, runs))),
            },
        )
        for link in trials.links()
        for autopilot in AUTOPILOTS
        for first in range(0, runs, _BATCH)
    ]


def _uploads(found: Mapping[str, dict[str, Any]], what: str, links: Sequence[str]) -> list[dict[str, Any]]:
    """Return a row for every link and autopilot: how uploads ended, and how long those took that went well."""
    rows = []
    for link in links:
        for autopilot in AUTOPILOTS:
            name = f"{what} {autopilot} {link}"
            ended = [t for key, result in found.items() if key.startswith(name) for t in result["trials"]]
            verdicts = Counter(t["verdict"] for t in ended)
            took = [t["verified_s"] for t in ended if t["verdict"] == "verified"]
            accepted = [t["upload_s"] for t in ended if t["upload_s"] is not None]
            said = Counter(t["said"] for t in ended if t["said"])
            rows.append(
                {
                    "client": what,
                    "autopilot": autopilot,
                    "link": link,
                    "runs": len(ended),
                    "accepted": len(accepted),
                    **{verdict: verdicts[verdict] for verdict in get_args(trials.Verdict)},
                    "upload_s": median(accepted) if accepted else None,
                    "verified_s": median(took) if took else None,
                    "verified_90_s": float(np.quantile(took, 0.9)) if took else None,
                    "said": said.most_common(1)[0][0] if said else "",
                }
            )
    return rows


def _loads(names: Sequence[trials.Client], seed: int, *, quick: bool, progress: Progress) -> list[link_loads.Load]:
    sizes = ((1, 100, 1), (3, 20, 1)) if quick else ((1, 1_000, 5), (50, 100, 3))
    found = []
    for vehicles, items, times in sizes:
        for client in names:
            found.append(link_loads.uploads(client, "px4", vehicles, items, times, seed))
            progress("loads", len(found) / (2 * len(names) + 1))
    vehicles, items, times = sizes[1]
    found.append(link_loads.uploads("missionplanner", "ardupilot", vehicles, items, times, seed))
    progress("loads", 1.0)
    return found


def _telemetry(*, quick: bool, progress: Progress) -> list[link_loads.Telemetry]:
    vehicles, duration_s = (5, 1.0) if quick else (100, 30.0)
    found = []
    for k, autopilot in enumerate(AUTOPILOTS, start=1):
        found.append(link_loads.telemetry(vehicles, 4.0, duration_s, autopilot))
        progress("telemetry", k / len(AUTOPILOTS))
    return found


def _fuzzed(found: Mapping[str, dict[str, Any]], work: str) -> dict[str, Any]:
    results = [result for key, result in found.items() if key.startswith(f"frames to {work} ")]
    added = {name: sum(r[name] for r in results) for name in ("frames", "heard", "batches", "corpus", "refusals")}
    most = {name: max(r[name] for r in results) for name in ("lines", "memory_mb")}
    return {"to": work, **added, **most, "faults": [fault for r in results for fault in r["faults"]]}


# --- what is written -------------------------------------------------------------------------------------------------

_CALLED = {
    "simulated": "missionplanner",
    "missionplanner": "missionplanner",
    "mavsdk": "MAVSDK",
    "vehicles": "the simulated vehicles",
    "ground_station": "the ground station",
}


def _write(folder: Path, figures: Mapping[str, Any]) -> None:
    rows = [*figures["uploads"], *figures["clients"]]
    write_csv(folder / "uploads.csv", list(rows[0]), [list(row.values()) for row in rows])
    write_atomic(folder / "results.md", report(figures))
    with replacing(folder / "links.png") as draft:
        _drawn(figures).savefig(draft, format="png", metadata={"Software": None})


def report(figures: Mapping[str, Any]) -> str:
    """Return the figures as Markdown."""
    items, frames = figures["items"], figures["frames"]
    peer = f"MAVSDK {figures['mavsdk']}" if figures["mavsdk"] else "MAVSDK is not installed: left out."
    second = figures["second_station"]
    return joined(
        "# Links",
        machine(),
        "## Uploads over bad links",
        f"Missions of {items} items to a simulated vehicle that holds another of as many. Every frame, the final "
        "acknowledgement too, is lost with the share that is named, each way; 5 % of frames come twice, 5 % are "
        "overtaken (by up to 0.3 s), all take 50 ms. The radio has 57,600 baud, 40 % loss, 2 % damaged frames, 0.1 "
        "s delay and up to 0.2 s jitter. Verified: read back and as sent; refused: an error that names the "
        "vehicle; wrong: said to be verified, and the vehicle holds something else, by a comparison of its own. "
        "Times are simulated, from the first message until all is read back.",
        _ended(figures["uploads"], peer=False),
        _said(figures["uploads"]),
        "## Beside MAVSDK",
        f"{peer}, both over UDP in real time, on the same links, {figures['clients'][0]['runs']} vehicles at once, "
        "each with a client of its own. MAVSDK does not compare what it reads back: verified means here that it "
        "reported no error and that the vehicle holds what was sent; refused, that it reported one.",
        _ended(figures["clients"], peer=True),
        _said(figures["clients"]),
        "![Uploads over bad links](links.png)",
        "## Loads",
        "On loopback, without faults; the simulator is a process of its own. Times by the clock, median.",
        _loads_table(figures["loads"]),
        "Telemetry in real time, read by a ground station in another process; share of one core by processor time:",
        _telemetry_table(figures["telemetry"]),
        "## Frames that nobody should believe",
        "Recorded traffic, mutated by what fields mean (ids, sequence numbers, enumerations, numbers that are "
        "none) and by bits, any other message of the dialect, cut and foreign bytes. The first 2 % of each run go "
        "under a tracer; what reaches new lines is mutated further. In every batch, the whole state of all "
        "whom no frame was for is compared before and after. Memory is what a process grew by after a fifth of its "
        "frames, at most.",
        _frames_table(frames),
        *([f"- {fault[:300]}" for fault in found["faults"]] for found in frames),
        f"A second ground station, with another sysid or with ours from another link, sent {second['frames']:,} "
        f"messages of the mission protocol into {second['uploads']} uploads, to the vehicle and to us: "
        f"{len(second['faults'])} of them ended otherwise than in the mission that was sent.",
        [f"- {fault[:300]}" for fault in second["faults"]],
    )


def _ended(rows: Sequence[Mapping[str, Any]], *, peer: bool) -> list[str]:
    head = "| link | vehicle |" + " client |" * peer
    head += " runs | verified | refused | wrong | no clear error | upload, s | until verified, s | 90 % within, s |"
    table = [head, "|---" * (head.count("|") - 1) + "|"]
    for row in (
        sorted(rows, key=lambda r: 0) if not peer else sorted(rows, key=lambda r: list(_LOSSES).index(r["link"]))
    ):
        client = f" {_CALLED[row['client']]} |" * peer
        times = " | ".join(
            "" if row[k] is None else f"{row[k]:.1f}" for k in ("upload_s", "verified_s", "verified_90_s")
        )
        table.append(
            f"| {row['link']} | {row['autopilot']} |{client} {row['runs']} | {row['verified'] / row['runs']:.1%} "
            f"| {row['refused']} | {row['wrong']} | {row['unclear']} | {times} |"
        )
    return table


def _said(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return what was said most often where uploads were refused."""
    return [
        f"- {_CALLED[row['client']]}, {row['autopilot']}, {row['link']}: {row['said']}" for row in rows if row["said"]
    ]


def _loads_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    table = [
        "| vehicles | items each | vehicle | client | runs | upload, s | until read back, s | client's processor, s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return table + [
        f"| {r['vehicles']} | {r['items']:,} | {r['autopilot']} | {_CALLED[r['client']]} | {r['runs']} "
        f"| {r['upload_s']:.2f} | {r['verified_s']:.2f} | {r['client_cpu_s']:.2f} |"
        for r in rows
    ]


def _telemetry_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    table = [
        "| vehicles | positions, Hz | for, s | share of one core | memory, MB | of it for the vehicles, MB | "
        "messages/s | kB/s | behind the clock, s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    return table + [
        f"| {r['vehicles']} {autopilot} | {r['position_hz']:g} | {r['duration_s']:.0f} | {r['core_share']:.1%} "
        f"| {r['memory_mb']:.0f} | {r['vehicles_mb']:.1f} | {r['messages_per_s']:,.0f} | {r['kilobytes_per_s']:.0f} "
        f"| {max(r['behind_s'], 0.0):.2f} |"
        for r, autopilot in zip(rows, AUTOPILOTS, strict=True)
    ]


def _frames_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    table = [
        "| frames to | frames | valid messages | batches with bystanders | kept for new lines | lines | memory, MB "
        "| finds |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return table + [
        f"| {_CALLED[r['to']]} | {r['frames']:,} | {r['heard']:,} | {r['batches']:,} | {r['corpus']:,} | "
        f"{r['lines']:,} | {r['memory_mb']:.1f} | {len(r['faults'])} |"
        for r in rows
    ]


def _drawn(figures: Mapping[str, Any]) -> Figure:
    figure = Figure(figsize=(9.0, 5.0), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(AUTOPILOTS), sharex=True, sharey="row")
    series = {
        "missionplanner, simulated time": ("simulated", figures["uploads"], "s-"),
        "missionplanner, real time": ("missionplanner", figures["clients"], "o--"),
        "MAVSDK, real time": ("mavsdk", figures["clients"], "^:"),
    }
    for column, autopilot in enumerate(AUTOPILOTS):
        share, times = axes[0, column], axes[1, column]
        for label, (client, rows, style) in series.items():
            found = [r for r in rows if (r["client"], r["autopilot"]) == (client, autopilot) and r["link"] in _LOSSES]
            loss = [_LOSSES[r["link"]] for r in found]
            colour = _COLOURS[client]
            share.plot(loss, [100.0 * r["verified"] / r["runs"] for r in found], style, color=colour, label=label)
            well = [r for r in found if r["verified_s"] is not None]
            times.plot([_LOSSES[r["link"]] for r in well], [r["verified_s"] for r in well], style, color=colour)
        share.set(title=autopilot, ylim=(-5.0, 105.0))
        times.set(xlabel="frames lost each way, %")
        for ax in (share, times):
            ax.grid(True, alpha=0.4)
    axes[1, 0].set_ylim(bottom=0.0)  # of both: they share it
    axes[0, 0].set_ylabel("verified, %")
    axes[1, 0].set_ylabel("until verified, median, s")
    axes[0, 0].legend(fontsize=7.5, loc="center left")
    return figure
