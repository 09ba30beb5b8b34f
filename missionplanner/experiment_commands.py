"""``missionplanner experiment NAME``: one command per experiment, each with the options that it has.

Results, tables and figures go to a folder (default: out/experiment_NAME); ``results.md`` there is what is printed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import TaskID

from missionplanner.errors import MissionError
from missionplanner.experiments.campaign import claim, mark
from missionplanner.terminal import Told, print_json, progress_bars, stdout

app = typer.Typer(
    help="Measure this software: results, tables and figures go to a folder (default: out/experiment_NAME).",
    no_args_is_help=True,
    rich_markup_mode=None,
)

Output = Annotated[Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="default: out/experiment_NAME")]
AsJson = Annotated[bool, typer.Option("--json", help="print JSON on stdout instead of tables")]
Seed = Annotated[int, typer.Option(min=0, help="repeats the experiment")]
Quick = Annotated[bool, typer.Option("--quick", help="a small part of it")]
Runs = Annotated[int, typer.Option(min=1, help="of every algorithm")]
MissionFile = Annotated[Path, typer.Option("--mission", help="mission file")]
Workers = Annotated[int | None, typer.Option(min=1, help="processes; default: one per core")]
Cluster = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Dask scheduler (tcp://HOST:PORT) whose workers run it instead")
]
RIDGE_LINE = Path("missions/ridge_line.yaml")


def run(name: str, output: Path | None, as_json: bool, measure: Callable[..., dict[str, Any]]) -> dict[str, Any]:
    """Measure into the experiment's folder, with progress bars; print its figures, and return them.

    ``measure`` gets the folder, and as ``progress`` whom to tell what is being done, and the share that is done.
    """
    folder = output or Path("out") / f"experiment_{name}"
    with progress_bars() as progress:
        bars: dict[str, TaskID] = {}

        def show(what: str, done: float) -> None:
            if what not in bars:
                bars[what] = progress.add_task(what, total=1.0)
            progress.update(bars[what], completed=done)

        claim(folder, name)
        figures = measure(folder, progress=show)
        mark(folder, name)
    if as_json:
        print_json(figures)
    else:
        text = (folder / "results.md").read_text(encoding="utf-8")
        stdout.print(text, markup=False, highlight=False, soft_wrap=True)
    return figures


def whole_numbers(evaluations: str) -> list[int]:
    """Read ``--evaluations N,N,...``."""
    try:
        return [int(number) for number in evaluations.split(",")]
    except ValueError:
        raise MissionError(f"--evaluations: expected whole numbers, as 2500,10000, got '{evaluations}'") from None


@app.command()
def proof(
    output: Output = None,
    seed: Seed = 1,
    quick: Quick = False,
    mission: MissionFile = RIDGE_LINE,
    samples: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="also check the .plan and .waypoints files there")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure soundness, tightness and speed of proofs."""
    from missionplanner.experiments import proof as experiment

    run("proof", output, as_json, partial(experiment.main, mission=mission, seed=seed, quick=quick, samples=samples))


@app.command()
def fidelity(
    flights: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="recorded flights (docs/FIDELITY.md); needed")
    ] = None,
    output: Output = None,
    update: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Markdown file whose table is brought up to date")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Hold predicted against recorded flights."""
    from missionplanner.experiments import fidelity as experiment

    if flights is None:
        raise MissionError("--flights: expected a folder of recorded flights (docs/FIDELITY.md)")
    figures = run(
        "fidelity",
        output,
        as_json,
        partial(experiment.main, flights=flights, update=update),
    )
    for flight in figures["unreadable"]:
        typer.echo(f"missionplanner: {flight['error']}", err=True)
    if figures["unreadable"]:
        raise Told(MissionError.exit_code)


@app.command()
def inspection(
    data: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Bayreuth's elevations, towers and lines (docs/EXPERIMENTS.md)")
    ] = Path("../shared/data"),
    output: Output = None,
    seed: Seed = 1,
    quick: Quick = False,
    workers: Workers = None,
    as_json: AsJson = False,
) -> None:
    """Share out, plan and fly the inspection of two real lines; compare with simple ways, priorities and sizes."""
    from missionplanner.experiments import inspection as experiment

    run(
        "inspection",
        output,
        as_json,
        partial(experiment.main, data=data, seed=seed, quick=quick, workers=workers),
    )


@app.command()
def arrival(
    output: Output = None,
    seed: Annotated[int, typer.Option(min=0, help="the first of them")] = 1,
    seeds: Annotated[int, typer.Option(min=1, help="plans, each with a seed of its own")] = 20,
    quick: Quick = False,
    mission: MissionFile = RIDGE_LINE,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Fly for common arrival in simulation, disturbed in several ways."""
    from missionplanner.experiments import arrival as experiment

    run(
        "arrival",
        output,
        as_json,
        partial(
            experiment.main, mission=mission, seed=seed, seeds=seeds, quick=quick, workers=workers, cluster=cluster
        ),
    )


@app.command()
def scale(output: Output = None, seed: Seed = 1, quick: Quick = False, as_json: AsJson = False) -> None:
    """Measure what the number of vehicles costs."""
    from missionplanner.experiments import scale as experiment

    run("scale", output, as_json, partial(experiment.main, seed=seed, quick=quick))


@app.command()
def links(
    output: Output = None,
    runs: Annotated[int, typer.Option(min=1, help="uploads per autopilot and link")] = 200,
    frames: Annotated[int, typer.Option(min=1, help="mutated ones, to vehicles and to the ground station")] = 1_000_000,
    seed: Seed = 1,
    quick: Quick = False,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Measure uploads over bad links (beside MAVSDK's where that is installed), loads, and mutated frames."""
    from missionplanner.experiments import links as experiment

    run(
        "links",
        output,
        as_json,
        partial(experiment.main, runs=runs, frames=frames, seed=seed, quick=quick, workers=workers, cluster=cluster),
    )


@app.command()
def table2(
    output: Output = None,
    runs: Annotated[int, typer.Option(min=1, help="of every algorithm on every function")] = 51,
    evaluations: Annotated[int, typer.Option(min=1, help="of every run")] = 10_000,
    peers: Annotated[bool, typer.Option("--peers", help="minionpy's ARRDE, jSO and LSHADE too")] = False,
    quick: Quick = False,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Run every algorithm on the paper's test functions (its Table II), with ranks and tests."""
    from missionplanner.experiments import table2 as experiment

    run(
        "table2",
        output,
        as_json,
        partial(
            experiment.main,
            runs=runs,
            evaluations=evaluations,
            peers=peers,
            quick=quick,
            workers=workers,
            cluster=cluster,
        ),
    )


@app.command()
def ablation(
    output: Output = None,
    runs: Annotated[int, typer.Option(min=1, help="of every variant on every problem")] = 21,
    evaluations: Annotated[int, typer.Option(min=1, help="of every run")] = 10_000,
    instances: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="instances of the UAV objective (*.npz), searched as well")
    ] = None,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Measure what each part of PSO-ABC-SA's best form is worth: one after the other is left out."""
    from missionplanner.experiments import ablation as experiment

    run(
        "ablation",
        output,
        as_json,
        partial(
            experiment.main, runs=runs, evaluations=evaluations, instances=instances, workers=workers, cluster=cluster
        ),
    )


@app.command("scenes-2d")
def scenes_2d(
    output: Output = None,
    runs: Runs = 51,
    quick: Quick = False,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Search paths on the paper's kind of 2D grids, sparse and dense (its figures 2-4)."""
    from missionplanner.experiments import scenes_2d as experiment

    run(
        "scenes-2d", output, as_json, partial(experiment.main, runs=runs, quick=quick, workers=workers, cluster=cluster)
    )


@app.command()
def mountain(
    output: Output = None,
    runs: Runs = 51,
    quick: Quick = False,
    mission: MissionFile = Path("missions/mountain.yaml"),
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Search and plan the paper's mountain scene with five vehicles (its Table IV, figures 7, 12-14)."""
    from missionplanner.experiments import mountain as experiment

    run(
        "mountain",
        output,
        as_json,
        partial(experiment.main, mission=mission, runs=runs, quick=quick, workers=workers, cluster=cluster),
    )


@app.command("multi-domain")
def multi_domain(
    output: Output = None,
    runs: Runs = 51,
    quick: Quick = False,
    mission: MissionFile = Path("missions/multi_domain.yaml"),
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Search and plan the paper's scene of land, sea and air (its figures 8-11)."""
    from missionplanner.experiments import multi_domain as experiment

    run(
        "multi-domain",
        output,
        as_json,
        partial(experiment.main, mission=mission, runs=runs, quick=quick, workers=workers, cluster=cluster),
    )


@app.command()
def collect(
    update: Annotated[
        Path, typer.Option(metavar="FILE", help="Markdown file whose sections are brought up to date")
    ] = Path("docs/EXPERIMENTS.md"),
    results: Annotated[
        Path, typer.Option(metavar="FOLDER", help="where the experiments' folders are (experiment_NAME)")
    ] = Path("out"),
) -> None:
    """Put the results of experiments that have been run into one document."""
    from missionplanner.experiments.document import collect as put_together

    typer.echo(f"{update}: {', '.join(put_together(update, results))}")


@app.command()
def peers(
    output: Output = None,
    instances: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="instances (.npz) of the UAV objective; a cluster's workers read the same path"
        ),
    ] = None,
    scene: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="mission whose first vehicle is searched; default: missions/mountain.yaml"),
    ] = None,
    evaluations: Annotated[str, typer.Option(metavar="N,N,...", help="on the UAV objective")] = "10000,100000",
    seeds: Annotated[int, typer.Option(min=1, help="of every search")] = 15,
    seconds: Annotated[float | None, typer.Option(min=0.01, help="the same processor time for all instead")] = None,
    slow_peers: Annotated[
        bool, typer.Option("--slow-peers", help="mealpy and cma beyond 10,000 evaluations too")
    ] = False,
    quick: Quick = False,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Search beside mealpy, pygmo, cma, minionpy, scipy and pyswarms; those not installed are left out."""
    from missionplanner.experiments import peers as experiment

    run(
        "peers",
        output,
        as_json,
        partial(
            experiment.main,
            instances=instances,
            scenes=[Path("missions/mountain.yaml")] if scene is None else scene,
            budgets=whole_numbers(evaluations),
            seeds=seeds,
            seconds=seconds,
            slow_peers=slow_peers,
            quick=quick,
            workers=workers,
            cluster=cluster,
        ),
    )


@app.command()
def table3(output: Output = None, seed: Seed = 1, quick: Quick = False, as_json: AsJson = False) -> None:
    """Measure what the algorithms themselves cost (the paper's Table III, the method of CEC 2005)."""
    from missionplanner.experiments import table3 as experiment

    run("table3", output, as_json, partial(experiment.main, seed=seed, quick=quick))


@app.command()
def lengths(
    instances: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="also .npz files with H, threats, start and end")
    ] = None,
    mission: MissionFile = Path("missions/mountain.yaml"),
    output: Output = None,
    seeds: Annotated[int, typer.Option(min=1, help="runs of each of OMPL's planners")] = 3,
    quick: Quick = False,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Hold the shortest path where all constraints are hard beside OMPL's planners."""
    from missionplanner.experiments import lengths as experiment

    run(
        "lengths",
        output,
        as_json,
        partial(
            experiment.main,
            mission=mission,
            instances=instances,
            seeds=seeds,
            quick=quick,
            workers=workers,
            cluster=cluster,
        ),
    )


@app.command()
def uav(
    instances: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help=".npz files with H, threats, start and end; needed")
    ] = None,
    output: Output = None,
    seeds: Annotated[int, typer.Option(min=1, help="runs of every method on every instance")] = 15,
    evaluations: Annotated[str, typer.Option(metavar="N,N,...", help="of every run")] = "2500,10000,100000",
    best: Annotated[
        Path | None, typer.Option(metavar="FILE", help='best known values, as JSON: {"NAME": value, ...}')
    ] = None,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Search the UAV path objective as a black box, and from a graph search of the objective itself."""
    from missionplanner.experiments import uav_search as experiment

    if instances is None:
        raise MissionError("--instances: expected a folder of instances (.npz files with H, threats, start and end)")
    searched = instances
    budgets = whole_numbers(evaluations)

    run(
        "uav",
        output,
        as_json,
        partial(
            experiment.main,
            instances=searched,
            seeds=seeds,
            evaluations=budgets,
            best=best,
            workers=workers,
            cluster=cluster,
        ),
    )


@app.command()
def kernel(
    output: Output = None,
    seed: Seed = 1,
    quick: Quick = False,
    instances: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="instances of the UAV objective (*.npz); default: made here")
    ] = None,
    yardstick: Annotated[
        Path | None, typer.Option(metavar="FILE", help="another implementation of it, a Python file as uavbench.py")
    ] = None,
    mission: Annotated[
        list[Path] | None, typer.Option(help="mission files whose paths are priced; default: two of the examples")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure how fast costs are computed, and how far that is from the machine's pace."""
    from missionplanner.experiments import kernel as experiment

    run(
        "kernel",
        output,
        as_json,
        partial(
            experiment.main,
            instances=instances,
            yardstick=yardstick,
            missions=mission or [RIDGE_LINE.with_name("mountain.yaml"), RIDGE_LINE],
            seed=seed,
            quick=quick,
        ),
    )


@app.command()
def growth(output: Output = None, seed: Seed = 1, quick: Quick = False, as_json: AsJson = False) -> None:
    """Measure how planning grows with vehicles, obstacles and terrain."""
    from missionplanner.experiments import growth as experiment

    run("growth", output, as_json, partial(experiment.main, seed=seed, quick=quick))


@app.command()
def weights(
    missions: Annotated[
        list[Path] | None, typer.Option("--mission", help="mission files; default: all examples")
    ] = None,
    output: Output = None,
    seed: Annotated[int, typer.Option(min=0, help="the first of them")] = 1,
    seeds: Annotated[int, typer.Option(min=1, help="plans of every mission with every kind of weights")] = 5,
    quick: Quick = False,
    workers: Workers = None,
    cluster: Cluster = None,
    as_json: AsJson = False,
) -> None:
    """Hold adaptive against fixed weights of what is forbidden."""
    from missionplanner.experiments import weights as experiment

    chosen = missions or [Path("missions") / f"{name}.yaml" for name in experiment.EXAMPLES]

    run(
        "weights",
        output,
        as_json,
        partial(
            experiment.main, missions=chosen, seed=seed, seeds=seeds, quick=quick, workers=workers, cluster=cluster
        ),
    )
