"""What must be set again to go on from an item, and where a flight was broken off."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adapters.mission_items import MissionItem, plan_items
from adapters.resuming import flown_items, in_force, item_left
from adapters.telemetry_log import FleetLog
from missionplanner.errors import MissionError
from missionplanner.plan import FleetPlan
from missionplanner.vehicle import Autopilot
from tests.plans import fleet_plan, small_fleet, vehicle_plan
from tests.rig import Rig
from tests.unit.test_fleet_flight import Script


def mission(*rows: tuple[Any, ...]) -> list[MissionItem]:
    return [MissionItem(seq, 0 if row[0] == 16 else 2, *row) for seq, row in enumerate(rows)]


@pytest.mark.parametrize(
    ("rows", "kept"),
    [
        ([(178, 1.0, 8.0), (178, 1.0, 5.0)], [1]),  # the last speed
        (
            [(178, 1.0, 8.0), (178, 0.0, 5.0), (178, 2.0, 1.0)],
            [1, 2],
        ),  # air and ground speed are one, the climb another
        ([(195,), (16,), (197,)], []),  # looks at nothing any more
        ([(195,), (197,), (201,)], [2]),
        ([(206, 25.0), (206, 0.0)], []),
        ([(206, 25.0), (178, 1.0, 5.0), (206, 10.0)], [1, 2]),  # in the order in which they were set last
        ([(2000, 0.0, 2.0), (2001,)], []),
        ([(2001,), (2000, 0.0, 2.0)], [1]),
        ([(2000, 0.0, 0.0, 1.0), (2000, 0.0, 1.0, 3.0)], []),  # so many were taken
        ([(2000, 0.0, 2.0), (2000, 0.0, 0.0, 1.0)], [0]),  # and at the interval more are taken
        ([(195,), (2000, 0.0, 0.0, 1.0), (93, 1.0), (206, 12.5, 0.0, 1.0)], [0, 3]),
        ([(2500, 1.0), (2500, 2.0), (2501, 1.0)], [1]),  # streams by their numbers
        ([(205, -90.0), (205, -45.0), (1000, -30.0)], [1, 2]),
        ([(183, 9.0, 1100.0), (183, 10.0, 1500.0), (183, 9.0, 1900.0)], [1, 2]),
        ([(530, 0.0, 1.0), (203,)], [0]),  # a single picture was taken
        ([(16,), (19, 5.0), (93, 3.0)], []),
    ],
)
def test_what_is_in_force(rows: list[tuple[Any, ...]], kept: list[int]) -> None:
    items = mission(*rows, (16,), (178, 1.0, 3.0))
    assert [item.seq for item in in_force(items, len(rows))] == kept


def test_jumps_leave_it_unknown() -> None:
    with pytest.raises(MissionError, match="item 1: jumps, so what comes before item 2 is not known"):
        in_force(mission((16,), (177, 1.0, 3.0), (16,)), 2)


@given(
    st.lists(
        st.tuples(
            st.sampled_from([178, 195, 197, 206, 214, 2000, 2001, 2500, 2501, 183, 16]),
            st.sampled_from([0.0, 1.0, 2.0]),
        ),
        max_size=12,
    ),
    st.integers(0, 12),
)
def test_what_is_in_force_twice_is_in_force_once(rows: list[tuple[int, float]], at: int) -> None:
    """Setting again what was in force, and then going on, leaves the same in force as never having stopped."""
    items = mission(*rows)
    at = min(at, len(items))
    again = [replace(item, seq=seq) for seq, item in enumerate([*in_force(items, at), *items[at:]])]

    def meant(whole: list[MissionItem]) -> set[tuple[int, float, float]]:
        return {(item.command, item.param1, item.param2) for item in in_force(whole, len(whole))}

    assert meant(again) == meant(items)


def broken_off(autopilot: Autopilot, folder: Path) -> FleetPlan:
    plan = fleet_plan(
        vehicle_plan(
            "uav1", 1, autopilot=autopilot, waypoints_m=((0, 0, 1225), (80, 0, 1225), (160, 0, 1225), (240, 0, 1225))
        ),
        vehicle_plan("uav2", 2, autopilot=autopilot, home_m=(0, 60, 1200), waypoints_m=((0, 60, 1225), (90, 60, 1225))),
    )
    with FleetLog(folder, {1: "uav1", 2: "uav2"}, 1.7e9) as log:
        rig = Rig(plan, log=log)
        rig.upload()
        rig.link.start()
        rig.link.watch(helm=Script(rig, (36.0, "rtl", ("uav1",))))
    return plan


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_log_says_where_a_flight_was_broken_off(autopilot: Autopilot, tmp_path: Path) -> None:
    """Also where the vehicle has counted from the beginning again since it landed, as PX4 does."""
    plan = broken_off(autopilot, tmp_path)
    items = plan_items(plan.vehicles[0], plan.frame)
    flown = flown_items(items, autopilot)
    for name in ("uav1", "fleet"):
        left = item_left(tmp_path / f"{name}.tlog", plan.vehicles[0])
        assert left == flown[2]  # the second leg after the take-off
    assert (
        item_left(tmp_path / "fleet.tlog", plan.vehicles[1])
        >= flown_items(plan_items(plan.vehicles[1], plan.frame), autopilot)[-1]
    )
    with pytest.raises(MissionError, match=r"expected uav1 \(sysid 1\) in its mission, it never is: give --from"):
        item_left(tmp_path / "uav2.tlog", plan.vehicles[0])


def test_home_is_nothing_to_fly_to() -> None:
    for autopilot, first in (("ardupilot", 1), ("px4", 0)):
        plan = small_fleet(autopilot, 1)  # type: ignore[arg-type]
        seqs = flown_items(plan_items(plan.vehicles[0], plan.frame), autopilot)  # type: ignore[arg-type]
        assert seqs == [first, *np.array([2, 3]) + first]
