"""The search algorithms, as the command line tells of them."""

from pathlib import Path

from missionplanner.search import algorithms
from tests.command_line import Cli, expect_refusal
from tests.scenes import mission_file, question


def test_algorithms_are_listed_with_their_sources(cli: Cli) -> None:
    listed = cli("algorithms", "--json").json["algorithms"]
    assert [(row["name"], row["source"]) for row in listed] == [(a.name, a.source) for a in algorithms()]
    told = cli("algorithms").out
    assert all(f" {algorithm.name} " in told for algorithm in algorithms())


def test_an_unknown_algorithm_is_one_line_with_the_nearest_names(cli: Cli, tmp_path: Path) -> None:
    mission = mission_file(tmp_path, question())
    expect_refusal(cli("plan", mission, "--algorithm", "pso_abc"), 2, "there is no 'pso_abc'; did you mean pso-abc-sa")
