"""A hand-made plan that looks at things on its way, for tests of what is exported of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from missionplanner.plan import Action, FleetPlan, VehiclePlan
from tests.plans import fleet_plan, vehicle_plan

TOWER_M = (150.0, 60.0, 1238.0)

WAYPOINTS_M = (
    (0.0, 0.0, 1230.0),
    (120.0, 40.0, 1251.25),  # looks at the tower, stands, takes two photos
    (180.0, 90.0, 1240.0),
    (240.0, -35.0, 1244.5),  # where a span begins
    (420.0, -35.0, 1244.5),  # where it ends: photos on the way
    (0.0, 0.0, 1230.0),
)
ACTIONS = {
    1: Action("T01.left", "T01", hold_s=3.0, look_at_m=TOWER_M, photos=2),
    3: Action("span T01-T02.left", "span T01-T02", look_deg=(10.0, -20.0)),
    4: Action("span T01-T02.left.end", "span T01-T02", look_deg=(10.0, -20.0), photo_every_m=12.5),
}


def looking(name: str = "alpha", sysid: int = 1, **changes: Any) -> VehiclePlan:
    """Return a copter that inspects a tower and a span, and lands where it started."""
    plan = vehicle_plan(name, sysid, waypoints_m=changes.pop("waypoints_m", WAYPOINTS_M), **changes)
    actions = {k: action for k, action in ACTIONS.items() if k < len(plan.waypoints_m)}
    holds_s = np.zeros(len(plan.waypoints_m) - 1)
    for k, action in actions.items():
        holds_s[k - 1] = action.stand_s
    return replace(plan, actions=actions, hold_s=holds_s)


def looking_fleet(*vehicles: VehiclePlan) -> FleetPlan:
    """Return a fleet of such copters."""
    return fleet_plan(*(vehicles or (looking(),)))
