"""Flights of ArduCopter from the command to start until touch-down: what `test_flights` begins after the take-off."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from missionplanner.motion import Navigator, Route, landing_points, return_points, takeoff_points
from missionplanner.plan import Trajectory
from tests.oracles import flights
from tests.oracles.test_flights import MODELS

NAMES = [name for name in flights.names() if not name.startswith(("px4", "P_"))]
# ArduCopter flies the few decimetres back to home as legs of their own; how long they are chance decides
AT_HOME = {"square5", "spline5"}

pytestmark = pytest.mark.skipif(not flights.FOLDER.is_dir(), reason="no recorded flights in ../shared/data/flights")


@pytest.mark.parametrize("name", NAMES)
def test_a_recorded_flight_is_predicted_from_its_start_to_its_landing(name: str) -> None:
    recording = flights.read(name)
    model = MODELS[recording.kind]
    navigator = Navigator([model], [recording.home_m])
    up, _ = navigator.fly(takeoff_points(model, recording.home_m, recording.top_m))
    flight, reached_s = navigator.fly(
        Route.through(
            recording.waypoints_m,
            recording.speed_m_s,
            recording.hold_s,
            recording.vertical_m_s,
            spline=recording.spline,
        )
    )
    begin_s = float(up.t_s[-1])
    assert begin_s == pytest.approx(recording.begin_s, abs=0.15)
    arrival_s = begin_s + reached_s[-1]
    assert arrival_s == pytest.approx(recording.reached_s[-1], abs=0.45)
    whole = Trajectory(
        np.concatenate([up.t_s, begin_s + flight.t_s[1:]]), np.concatenate([up.position_m, flight.position_m[1:]])
    )
    during = (recording.t_s >= 0.0) & (recording.t_s <= recording.reached_s[-1])
    flown_m = recording.position_m[during]
    assert np.percentile(np.linalg.norm(whole.at(recording.t_s[during]) - flown_m, axis=1), 95) <= 2.5
    path_m = whole.at(np.linspace(0.0, whole.t_s[-1], 20 * len(whole.t_s)))
    assert cKDTree(path_m).query(flown_m)[0].max() <= 1.5
    # the ending
    here = navigator.position_m[0].copy()
    if recording.lands:
        settled, _ = navigator.fly(Route.through(recording.waypoints_m[-1:], 5.0))
        _, touched_s = navigator.fly(landing_points(model, here, recording.home_m[2]))
        down_s = settled.t_s[-1] + touched_s[0]
    else:
        _, touched_s = navigator.fly(return_points(model, here, recording.home_m))
        down_s = touched_s[-1]
    after = recording.t_s > recording.reached_s[-1]
    low = recording.position_m[after, 2] < recording.home_m[2] + 0.12
    measured_s = recording.t_s[after][np.argmax(low)] - recording.reached_s[-1]
    assert down_s == pytest.approx(measured_s, abs=3.0 if name in AT_HOME else 2.5)
