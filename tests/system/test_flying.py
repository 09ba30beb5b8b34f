"""Flights from the operator's chair: resuming a mission, saving what vehicles hold, ordering, and a real terminal."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from adapters.mission_items import CHANGE_SPEED, TAKEOFF, WAYPOINT
from adapters.order_box import OrderBox
from adapters.waypoints_file import read_waypoints
from missionplanner.errors import LinkError, MissionError
from missionplanner.files import alone
from missionplanner.flight_check import check_flight
from missionplanner.flight_console import ORDERS_FOLDER
from missionplanner.plan_folder import load_plan
from missionplanner.planner import plan_fleet
from missionplanner.proof import planned_sortie, predict
from missionplanner.resuming import resume
from sim.fleet import SimFleet, planned_vehicles
from tests.command_line import Cli, expect_refusal
from tests.main_job import fly, load_scene, mission_path, plan_into
from tests.scenes import scene_of
from tests.system.test_check import flown_by
from tests.system.test_planes import _mission as plane_mission


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("quickstart") / "plan"
    plan_into(folder, load_scene(mission_path("quickstart")))
    return folder


def test_a_mission_goes_on_from_a_waypoint_as_it_was_planned(cli: Cli, planned: Path, tmp_path: Path) -> None:
    outcome = cli("resume", planned, "--vehicle", "bravo", "--from", "6", "-o", tmp_path / "rest", "--json")
    assert outcome.code == 0, outcome.err
    assert "bravo goes on from item 6" in outcome.err
    assert "nothing is proven of alpha: they must not fly meanwhile" in outcome.err
    _, before = load_plan(planned)
    scene, after = load_plan(tmp_path / "rest")
    (rest,), bravo = after.vehicles, before.vehicles[1]
    assert (rest.name, rest.sysid) == ("bravo", 2)
    np.testing.assert_allclose(rest.home_m, bravo.home_m, atol=1e-6)
    kept = len(bravo.waypoints_m) - 4  # item 6 is its waypoint 4: the take-off, item 1, is 0, and item 2 a speed
    np.testing.assert_allclose(rest.waypoints_m[-kept:], bravo.waypoints_m[-kept:], atol=0.01)
    np.testing.assert_allclose(rest.speeds_m_s[1 - kept :], bravo.speeds_m_s[1 - kept :], atol=1e-3)
    assert after.certificate is not None
    assert after.certificate.proven
    (flight,) = predict(scene, [planned_sortie(scene, rest)])  # an independent look: the model flies it
    flown_m = flight.trajectory.position_m
    for waypoint_m in bravo.waypoints_m[-kept:]:
        assert np.min(np.linalg.norm(flown_m - waypoint_m, axis=1)) < 6.0


def test_what_is_resumed_is_flown_like_any_plan(cli: Cli, planned: Path, tmp_path: Path) -> None:
    assert cli("resume", planned, "--vehicle", "alpha", "--from", "3", "-o", tmp_path / "rest").code == 0
    outcome = cli("fly", tmp_path / "rest", "--json")
    assert outcome.code == 0, outcome.err


def test_the_same_seed_resumes_the_same_way(cli: Cli, planned: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        assert cli("resume", planned, "--vehicle", "bravo", "--from", "5", "-o", tmp_path / name).code == 0
    assert (tmp_path / "one" / "plan.json").read_bytes() == (tmp_path / "two" / "plan.json").read_bytes()


@pytest.mark.parametrize(
    ("options", "code", "told"),
    [
        (["--vehicle", "bravo"], 2, "exactly one of --from and --log"),
        (["--vehicle", "bob", "--from", "5"], 2, "--vehicle: expected one of alpha, bravo, got 'bob'"),
        (["--vehicle", "bravo", "--from", "1"], 2, "fly its own plan again"),
        (["--vehicle", "bravo", "--from", "99"], 2, "nothing is left but its end"),
        (["--vehicle", "bravo", "--log", "no.tlog"], 2, "no.tlog: expected a telemetry log"),
        (["--vehicle", "bravo", "--log", "x", "--mission", "m.yaml"], 2, "expected --from with --mission"),
        (["--vehicle", "bravo", "--log", "x", "--mission", "m.yaml", "--from", "3"], 2, "and no --log"),
    ],
)
def test_wrong_questions_to_resume(cli: Cli, planned: Path, options: list[str], code: int, told: str) -> None:
    expect_refusal(cli("resume", planned, *options, "--json"), code, told)


def test_a_resumed_plan_replaces_no_other(cli: Cli, planned: Path) -> None:
    expect_refusal(cli("resume", planned, "--vehicle", "alpha", "--from", "3", "-o", planned), 2, "without a plan")


def test_a_file_of_any_origin_goes_on_with_what_was_in_force(cli: Cli, planned: Path, tmp_path: Path) -> None:
    header, *rows = (planned / "files" / "bravo.waypoints").read_text().splitlines()
    extra = ["0 0 3 195 0 0 0 0 47.4 8.546 0 1", "0 0 3 206 25 0 0 0 0 0 0 1", "0 0 2 178 1 6 -1 0 0 0 0 1"]
    fields = [line.split() for line in (*rows[:4], *extra, *rows[4:])]
    text = "\n".join([header, *("\t".join([str(k), *row[1:]]) for k, row in enumerate(fields))])
    (tmp_path / "theirs.waypoints").write_text(text + "\n")
    question = ["--mission", mission_path("quickstart"), "--vehicle", "bravo", "-o", tmp_path / "rest"]
    outcome = cli("resume", tmp_path / "theirs.waypoints", *question, "--from", "9")
    assert outcome.code == 0, outcome.err
    items = read_waypoints(tmp_path / "rest" / "bravo.waypoints", "ardupilot")
    theirs = read_waypoints(tmp_path / "theirs.waypoints", "ardupilot")
    at = next(k for k, item in enumerate(items) if (item.x, item.y, item.z) == (theirs[9].x, theirs[9].y, theirs[9].z))
    assert [(i.command, i.param1, i.param2) for i in items[at - 3 : at]] == [(195, 0, 0), (206, 25, 0), (178, 1, 6)]
    assert [i.command for i in items[at:]] == [i.command for i in theirs[9:]]
    assert {i.command for i in items[1 : at - 3]} == {TAKEOFF, CHANGE_SPEED, WAYPOINT}
    checked = cli(
        "check", "--mission", mission_path("quickstart"), tmp_path / "rest" / "bravo.plan", "-o", tmp_path / "c"
    )
    assert checked.code == 0, checked.err
    expect_refusal(cli("resume", tmp_path / "theirs.waypoints", *question, "--from", "9"), 2, "is not replaced")
    question[-1] = tmp_path / "other"
    refused = cli("resume", tmp_path / "theirs.waypoints", *question, "--from", "5")
    expect_refusal(refused, 2, "expected a waypoint after the take-off at item 5")


@pytest.mark.slow
def test_what_vehicles_hold_is_saved_proven_and_given_back(cli: Cli, planned: Path, tmp_path: Path) -> None:
    scene, plan = load_plan(planned)
    fleet = SimFleet(planned_vehicles(plan), frame=scene.frame)
    with flown_by(fleet) as url:
        assert cli("upload", planned, "--connect", url).code == 0
        saved = ["--connect", url, "-o", tmp_path / "held", "--mission", mission_path("quickstart")]
        outcome = cli("download", *saved, "--json")
        assert outcome.code == 0, outcome.err
        assert [v["name"] for v in outcome.json["vehicles"]] == ["alpha", "bravo"]
        expect_refusal(cli("download", *saved), 2, "not replaced")
        back = cli("restore", tmp_path / "held", "--connect", url)
        assert back.code == 0, back.err
        ordered = cli("command", "rtl", planned, "--connect", url, "--json")
        assert ordered.code == 0, ordered.err
        assert [o["result"] for o in ordered.json["orders"]] == ["grounded", "grounded"]
        unknown = cli("command", "rtl", planned, "--connect", url, "--vehicle", "bob")
        expect_refusal(unknown, 2, "expected vehicles of the plan, got bob")
    files = [tmp_path / "held" / f"{name}.plan" for name in ("alpha", "bravo")]
    checked = cli("check", "--mission", mission_path("quickstart"), *files, "-o", tmp_path / "checked", "--json")
    assert checked.code == 0, checked.err


def test_a_name_that_is_none_of_the_plan_orders_nobody_anything(cli: Cli, planned: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(planned, tmp_path / "plan"))
    box = OrderBox(copy / ORDERS_FOLDER)
    named = ["--vehicle", "alpha", "--vehicle", "typo", "--json"]
    expect_refusal(cli("command", "pause", copy, *named), 2, "expected vehicles of the plan, got typo")
    assert box.take() is None
    assert list((copy / ORDERS_FOLDER).iterdir()) == []


def test_an_order_for_a_fleet_that_nobody_watches(cli: Cli, planned: Path) -> None:
    expect_refusal(cli("command", "land", planned, "--json"), 4, "expected a running fly", "nothing was sent")


@pytest.mark.skipif(os.name != "posix", reason="folders are locked by fcntl")
@pytest.mark.parametrize("words", [["fly"], ["upload", "--connect", "udpin:127.0.0.1:0"]])
def test_who_works_in_a_plan_folder_is_alone_in_it(
    cli: Cli, planned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    """Else a rehearsal would take the orders for the real fleet, and its logs."""
    copy = Path(shutil.copytree(planned, tmp_path / "plan"))
    before = sorted(copy.rglob("*"))
    with alone(copy, "busy"):
        expect_refusal(cli(words[0], copy, *words[1:], "--json"), 2, f"{copy}: expected a plan folder that nobody else")
    assert sorted(copy.rglob("*")) == before
    asked: list[str] = []

    @contextmanager
    def station(*_arguments: object, **_options: object) -> Iterator[None]:
        with pytest.raises(MissionError, match="busy"), alone(copy, "busy"):
            pass
        asked.append("while it flies")
        raise LinkError("nobody is there")
        yield

    monkeypatch.setattr("missionplanner.cli._ground_station", station)
    expect_refusal(cli(words[0], copy, *words[1:], "--json"), 4, "nobody is there")
    assert asked
    with alone(copy, "free again"):
        pass


@pytest.mark.slow
def test_keys_at_a_real_terminal(planned: Path, tmp_path: Path) -> None:
    pty = pytest.importorskip("pty", reason="single keys need a POSIX terminal")
    copy = Path(shutil.copytree(planned, tmp_path / "plan"))
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ.update(TERM="xterm", COLUMNS="110", LINES="40")
        program = [
            sys.executable,
            "-c",
            "from missionplanner.cli import main; main()",
            "fly",
            str(copy),
            "--speedup",
            "15",
        ]
        os.execv(sys.executable, program)
    shown = b""
    typed = [(b"flying  alpha", b"p"), (b"stands on its way", b"c"), (b"goes on", b"R")]
    deadline_s = time.monotonic() + 120.0
    while time.monotonic() < deadline_s:
        try:
            piece = os.read(terminal, 65_536)
        except OSError:  # it has ended
            break
        shown += piece
        if typed and typed[0][0] in shown:
            os.write(terminal, typed.pop(0)[1])
    _, status = os.waitpid(pid, 0)
    assert typed == [], shown.decode("utf-8", "replace")
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode("utf-8", "replace"))
    assert "p pause  c continue  R return  L land where they are  Ctrl-C leave" in text
    assert os.waitstatus_to_exitcode(status) == 3  # it never reached its goal, by order
    orders = json.loads((copy / "flight.json").read_text())["orders"]
    assert [order["order"] for order in orders] == ["pause"] * 2 + ["resume"] * 2 + ["rtl"] * 2
    assert {order["result"] for order in orders} == {"obeyed"}


def test_a_plane_goes_on_where_it_cannot_circle(tmp_path: Path) -> None:
    scene = scene_of(plane_mission())
    plan = plan_fleet(scene, seed=1)
    whole, rest = resume(scene, plan, tmp_path, "p2", 5)
    kept = len(plan.vehicles[1].waypoints_m) - 5
    np.testing.assert_allclose(rest.vehicles[0].waypoints_m[-kept:], plan.vehicles[1].waypoints_m[-kept:], atol=0.01)
    flight = fly(whole, rest)
    assert check_flight(whole, rest, flight).ok
    assert flight.vehicles[0].arrival_s == pytest.approx(rest.vehicles[0].arrival_s, abs=0.1)
