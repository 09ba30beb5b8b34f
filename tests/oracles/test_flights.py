"""The motion model against flights of real autopilot code."""

from __future__ import annotations

import numpy as np
import pytest

from missionplanner.motion import Navigator, Route, takeoff_points
from missionplanner.vehicle import MotionModel
from tests.oracles import flights

MODELS = {
    "ardupilot": MotionModel("ardupilot", "copter", 2.5, 1.0, 2.5, 1.5, 2.0, 0.0),
    "px4": MotionModel("px4", "copter", 3.0, 4.0, 3.0, 1.5, 2.0, 0.0),
    "plane": MotionModel("ardupilot", "plane", 1.5, 1.0, 5.0, 5.0, 50.0, 60.0),
}
# mean leg error, arrival as a share, arrival in seconds (the looser of the two counts), position error (95 %)
LIMITS = {"ardupilot": (0.025, 0.003, 0.45, 2.8), "plane": (0.01, 0.004, 0.5, 10.5), "px4": (0.04, 0.013, 1.0, 17.0)}
# Up to the waypoint where chance decided: PX4, by what its position estimate drifted, was 2.4 m past its leg there. A
# stray of more than 2 m stops and returns to the leg; predicted are 1.6 m.
STRAYED = {"px4_B_corner90_10": 1}

pytestmark = pytest.mark.skipif(not flights.FOLDER.is_dir(), reason="no recorded flights in ../shared/data/flights")


@pytest.mark.parametrize("name", flights.names())
def test_a_recorded_flight_is_predicted(name: str) -> None:
    recording = flights.read(name)
    model = MODELS[recording.kind]
    start = recording.top_m if recording.kind == "plane" else recording.home_m
    navigator = Navigator([model], [start])
    if recording.kind == "plane":
        navigator.velocity_m_s[0] = recording.velocity_m_s
    else:
        navigator.fly(takeoff_points(model, start, recording.top_m))
    waypoints_m, speed_m_s, hold_s = recording.waypoints_m, recording.speed_m_s, recording.hold_s
    route = Route.through(waypoints_m, speed_m_s, hold_s, recording.vertical_m_s, spline=recording.spline)
    flight, reached_s = navigator.fly(route)
    count = STRAYED.get(name, len(reached_s))
    measured = np.diff(np.concatenate([[recording.begin_s], recording.reached_s[:count]]))
    predicted = np.diff(np.concatenate([[0.0], reached_s[:count]]))
    known = (measured > 0.5) & (predicted > 0.5)  # not the lost ones, nor a first waypoint where the take-off ended
    leg = np.mean(np.abs(predicted[known] / measured[known] - 1.0))
    flown_s = recording.reached_s[count - 1] - recording.begin_s
    late_s = abs(reached_s[count - 1] - flown_s)
    during = (recording.t_s >= recording.begin_s) & (recording.t_s <= recording.reached_s[count - 1])
    off_m = np.linalg.norm(flight.at(recording.t_s[during] - recording.begin_s) - recording.position_m[during], axis=1)
    leg_max, share_max, late_max_s, off_max_m = LIMITS[recording.kind]
    assert leg <= leg_max
    assert late_s <= max(late_max_s, share_max * flown_s)
    assert np.percentile(off_m, 95) <= off_max_m
