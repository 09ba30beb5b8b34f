"""Ctrl-C ends any command in one line and exit code 130, and says what it leaves."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from adapters.backup import Saved, write_backup
from adapters.ground_station import WallClock
from adapters.mission_items import plan_items
from tests.command_line import Cli, expect_line
from tests.plans import FRAME, vehicle_plan


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.fixture
def backup(tmp_path: Path) -> Path:
    """Return a backup of one vehicle."""
    items = plan_items(vehicle_plan(), FRAME)
    write_backup(tmp_path / "saved", [Saved("uav1", 1, "ardupilot", "copter", (), items, (), ())], "2027-05-04")
    return tmp_path / "saved"


@pytest.mark.parametrize("command", ["download", "parameters"])
def test_a_command_that_waits_for_vehicles_is_interrupted(
    command: str, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(WallClock, "wait", interrupt)
    outcome = cli(command, "--connect", "udpin:127.0.0.1:0")
    expect_line(outcome, 130, "missionplanner: interrupted")


def test_a_restore_that_had_not_begun_says_so(cli: Cli, monkeypatch: pytest.MonkeyPatch, backup: Path) -> None:
    monkeypatch.setattr(WallClock, "wait", interrupt)
    outcome = cli("restore", backup, "--connect", "udpin:127.0.0.1:0")
    assert outcome.code == 130
    assert outcome.err.splitlines() == ["missionplanner: nothing was restored", "missionplanner: interrupted"]


def test_a_restore_that_had_begun_says_what_it_leaves(cli: Cli, monkeypatch: pytest.MonkeyPatch, backup: Path) -> None:
    def half(*_: object, **__: object) -> None:
        raise KeyboardInterrupt("uav1: it may hold a mixture; restore again")

    monkeypatch.setattr("adapters.backup.restore", half)
    outcome = cli("restore", backup, "--connect", "udpin:127.0.0.1:0", "--json")
    assert outcome.code == 130
    assert "missionplanner: uav1: it may hold a mixture; restore again" in outcome.err
    assert not outcome.out or json.loads(outcome.out)
