"""Spline waypoints in the simulator: ArduCopter flies them as predicted, ArduPlane skips them, PX4 refuses them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.mission_items import MissionItem
from missionplanner.timing import predict_flight
from missionplanner.vehicle import Autopilot
from tests.simulated import LAT, LON, Ground, mission, of_type, renumbered, texts

SPLINE = mavlink.MAV_CMD_NAV_SPLINE_WAYPOINT


def curved(autopilot: Autopilot = "ardupilot", hold_s: float = 0.0) -> list[MissionItem]:
    """Return a mission whose first waypoint is flown to in a straight line, the others along splines."""
    items = mission(autopilot)
    spline = replace(items[-2], command=SPLINE, param1=hold_s)
    return renumbered([*items[:-1], spline, replace(spline, x=LAT, y=LON + 9_000), items[-1]])


@pytest.mark.parametrize("hold_s", [0.0, 3.0])
def test_a_simulated_arducopter_flies_splines_as_predicted(hold_s: float) -> None:
    ground = Ground("ardupilot")
    items = curved(hold_s=hold_s)
    assert ground.upload(items) == mavlink.MAV_MISSION_ACCEPTED
    assert ground.mode("GUIDED") == mavlink.MAV_RESULT_ACCEPTED
    assert ground.arm() == mavlink.MAV_RESULT_ACCEPTED
    assert ground.start() == mavlink.MAV_RESULT_ACCEPTED
    flown = []
    while ground.autopilot.current < len(items) - 1:
        ground.run(0.1)
        flown.append(ground.autopilot.position_m)
    last = len(items) - 2
    assert [t for t in texts(ground.heard) if t.startswith("Reached")] == [
        f"Reached command #{k}" for k in range(3, last + 1)
    ]
    assert f"Mission: {last} SplineWP" in texts(ground.heard)
    frame = ground.fleet.frame
    waypoints = np.array([frame.to_local(i.x * 1e-7, i.y * 1e-7, 604.0) for i in items[3:-1]])
    home = ground.autopilot.home_m
    top = home + np.array([0.0, 0.0, 20.0])
    flight, _ = predict_flight(
        ground.fleet.links[0].autopilot._motion,
        home,
        np.vstack([top, waypoints]),
        8.0,
        hold_s=[0.0, 0.0, *[hold_s] * (len(waypoints) - 2)],
        spline=[False, False, *[True] * (len(waypoints) - 2)],
    )
    t = 0.1 * np.arange(len(flown))
    shifts = np.arange(-0.5, 0.5, 0.05)
    off_m = min(np.linalg.norm(flight.at(np.clip(t + s, 0.0, None)) - flown, axis=1).max() for s in shifts)
    assert off_m < 0.6  # told once every 0.1 s


def test_px4_refuses_splines() -> None:
    ground = Ground("px4")
    assert ground.upload(curved("px4")) == mavlink.MAV_MISSION_UNSUPPORTED


def test_arduplane_skips_splines() -> None:
    ground = Ground("ardupilot", "plane")
    amsl = mavlink.MAV_FRAME_GLOBAL
    items = renumbered(
        [
            MissionItem(0, amsl, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT, y=LON, z=584.0),
            MissionItem(0, amsl, mavlink.MAV_CMD_NAV_TAKEOFF, 10.0, x=LAT + 30_000, y=LON, z=640.0),
            MissionItem(0, amsl, SPLINE, x=LAT - 60_000, y=LON, z=660.0),
            MissionItem(0, amsl, mavlink.MAV_CMD_NAV_WAYPOINT, x=LAT + 60_000, y=LON, z=660.0),
            MissionItem(0, amsl, mavlink.MAV_CMD_NAV_LOITER_UNLIM, x=LAT + 30_000, y=LON, z=680.0),
        ]
    )
    assert ground.upload(items) == mavlink.MAV_MISSION_ACCEPTED
    assert ground.arm() == mavlink.MAV_RESULT_ACCEPTED
    assert ground.start() == mavlink.MAV_RESULT_ACCEPTED
    ground.run(90.0)
    assert ground.autopilot.current == 4
    flown = {m.seq for m in of_type(ground.heard, "MISSION_CURRENT")}
    assert 3 in flown
    assert 2 not in flown
