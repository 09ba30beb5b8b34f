"""From the command line, over real sockets and a signed link: what vehicles held is saved, replaced and given back."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from adapters.endpoint import open_endpoint
from adapters.signing import Signing
from missionplanner.mission import load_mission
from missionplanner.scene import build_scene
from sim.fleet import SimFleet, SimVehicle, serve
from tests.command_line import Cli, expect_refusal

pytestmark = pytest.mark.slow

QUICKSTART = Path(__file__).parents[2] / "missions" / "quickstart.yaml"
KEY = bytes(range(32))


@pytest.fixture
def vehicles() -> Iterator[tuple[SimFleet, str]]:
    """Let the quickstart's vehicles stand at home behind one signed TCP port; return them and its URL."""
    scene = build_scene(load_mission(QUICKSTART), QUICKSTART.parent)
    fleet = SimFleet(
        [
            SimVehicle(task.sysid, "ardupilot", "copter", scene.frame.geo_point(task.home_m), task.motion)
            for task in scene.tasks
        ],
        frame=scene.frame,
    )
    server = open_endpoint("tcpin:127.0.0.1:0")
    fleet.attach(Signing(KEY, time.time).sealed(server))
    stop = threading.Event()
    thread = threading.Thread(target=serve, args=(fleet, 5.0, stop.is_set), daemon=True)
    thread.start()
    yield fleet, server.url.replace("tcpin", "tcp")
    stop.set()
    thread.join(10.0)
    fleet.close()


def test_saved_replaced_and_given_back(vehicles: tuple[SimFleet, str], cli: Cli, tmp_path: Path) -> None:
    fleet, url = vehicles
    (tmp_path / "key").write_bytes(KEY)
    (tmp_path / "key").chmod(0o600)
    options = ("--connect", url, "--signing-key", "key")
    uploaded = cli("upload", QUICKSTART, "-o", "out", "--backup", "saved", *options)
    assert uploaded.code == 0, uploaded.err
    assert "what the vehicles held is in saved" in uploaded.err
    assert "bravo is not sent no-fly area school" in uploaded.err
    assert [len(link.missions.items(1)) for link in fleet.links] == [4, 0]
    assert all(link.missions.items() for link in fleet.links)
    expect_refusal(cli("upload", "out", "--backup", "saved", *options), 2, "saved: expected a folder without a backup")
    restored = cli("restore", "saved", *options, "--json")
    assert [row["sent"] for row in restored.json["vehicles"]] == [["mission", "fence"], ["mission"]]
    assert not any(link.missions.items(1) for link in fleet.links)


def test_vehicles_that_sign_do_not_obey_who_does_not(vehicles: tuple[SimFleet, str], cli: Cli) -> None:
    _, url = vehicles
    expect_refusal(cli("parameters", "--connect", url), 4, "signs its messages: expected --signing-key with its key")


def test_a_wrong_key_is_one_line(vehicles: tuple[SimFleet, str], cli: Cli, tmp_path: Path) -> None:
    _, url = vehicles
    (tmp_path / "key").write_bytes(bytes(32))
    (tmp_path / "key").chmod(0o600)
    outcome = cli("parameters", "--connect", url, "--signing-key", "key")
    expect_refusal(outcome, 4, "sysid 1: ", "signed with another key; sysid 2: ", "wrong key?")
