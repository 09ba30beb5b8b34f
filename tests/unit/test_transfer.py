"""What vehicles are found to hold is proven before anything else is done with them; an override is told in red."""

from __future__ import annotations

from typing import Any, cast

import pytest

from adapters.fleet_link import FleetLink
from adapters.mission_items import MissionItem, fleet_items
from missionplanner import cli
from missionplanner.errors import InfeasibleError
from missionplanner.plan import FleetPlan
from tests.scenes import at
from tests.unit.test_proof import by_hand, scene


class _Vehicles:
    """A link to vehicles that take everything."""

    def __init__(self, plan: FleetPlan) -> None:
        self.held: dict[int, tuple[MissionItem, ...]] = {}
        self.did: list[str] = []
        self._plan = plan

    def compare_parameters(self, *_: Any) -> tuple[()]:
        self.did.append("compare")
        return ()

    def upload(self, progress: Any, *, via: str) -> None:
        self.did.append("upload")

    def verify(self, progress: Any) -> None:
        self.held = fleet_items(self._plan)
        self.did.append("verify")

    def send_guards(self, progress: Any) -> tuple[str]:
        self.did.append("send_guards")
        return ("alpha is not sent no-fly area school",)

    def set_returns(self, progress: Any) -> tuple[()]:
        self.did.append("set_returns")
        return ()


def test_what_is_held_and_not_proven_is_refused_or_told(capsys: pytest.CaptureFixture[str]) -> None:
    there = scene(obstacles=[{"kind": "cylinder", "name": "mast", "center": at(150, 0), "radius_m": 5}])
    plan = by_hand(there)
    vehicles = _Vehicles(plan)
    with pytest.raises(InfeasibleError, match=r"what the vehicles hold is not proven: .*mast.*nothing was armed"):
        cli._transfer(cast("FleetLink", vehicles), there, plan, unproven=False)
    assert vehicles.did == ["compare", "upload", "verify"]
    cli._transfer(cast("FleetLink", vehicles), there, plan, unproven=True)
    assert vehicles.did[3:] == ["compare", "upload", "verify", "send_guards", "set_returns"]
    told = capsys.readouterr().err
    assert "UNPROVEN: what the vehicles hold is not proven: alpha: item 3: mast" in told
    assert "missionplanner: alpha is not sent no-fly area school\n" in told
