"""Exported files, byte for byte: a change of format is a decision, not an accident.

``python -m tests.golden.test_golden_files`` writes them anew; look at the difference before committing it.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from adapters.export import export_fleet
from missionplanner.plan import FleetPlan
from tests.plans import fleet_plan, vehicle_plan

FOLDER = Path(__file__).parent / "files"


def _plan() -> FleetPlan:
    return fleet_plan(
        vehicle_plan("ardupilot-land", 1),
        vehicle_plan("ardupilot-plane", 2, vehicle_class="plane", end="loiter", speed_m_s=18.0),
        vehicle_plan("px4-rtl", 3, autopilot="px4", end="rtl"),
    )


@pytest.mark.parametrize("name", sorted(path.name for path in FOLDER.glob("*")))
def test_exported_files_are_the_golden_ones(tmp_path: Path, name: str) -> None:
    export_fleet(_plan(), tmp_path)
    assert (tmp_path / name).read_text() == (FOLDER / name).read_text()


def test_no_golden_file_is_missing(tmp_path: Path) -> None:
    assert {path.name for path in export_fleet(_plan(), tmp_path)} == {path.name for path in FOLDER.glob("*")}


if __name__ == "__main__":
    export_fleet(_plan(), FOLDER)
