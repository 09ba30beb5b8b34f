"""Ways home that the model itself flies, told to at any instant: they stay in what is proven of them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.autopilot_parameters import Kind, defaults, fields, with_values
from missionplanner.geodesy import FloatArray
from missionplanner.motion import TICK_S as STEP_S
from missionplanner.motion import Navigator, Route, return_points
from missionplanner.returns import Returning, stopping_region
from missionplanner.vehicle import MotionModel, deviation_m
from missionplanner.wind import off_legs_m
from tests.limits import limits

STRAY_M = 3.0  # what a vehicle may be off by default: tracking and position; wind and position need the most of it
TICK_S = 0.1
PARAMETERS: list[tuple[Kind, dict[str, float], float]] = [
    (("ardupilot", "copter"), {}, 2.0),
    (("ardupilot", "copter"), {"ATC_INPUT_TC": 1.0}, 2.0),
    (("ardupilot", "copter"), {"ATC_INPUT_TC": 0.5}, 2.0),
    (("ardupilot", "copter"), {"PSC_VELXY_P": 0.5}, 2.0),
    (("ardupilot", "copter"), {"PSC_POSXY_P": 0.5}, 2.0),
    (("ardupilot", "copter"), {"WPNAV_ACCEL": 500.0, "WPNAV_JERK": 5.0}, 2.0),
    (("px4", "copter"), {}, 2.0),
    (("px4", "copter"), {"MPC_XY_VEL_P_ACC": 1.2}, STRAY_M),
    (("px4", "copter"), {"MPC_XY_VEL_D_ACC": 2.0}, STRAY_M),
    (("px4", "copter"), {"MPC_XY_P": 2.0}, STRAY_M),
    (("px4", "copter"), {"MPC_JERK_AUTO": 1.0}, STRAY_M),
    (("px4", "copter"), {"MPC_TILTMAX_AIR": 20.0}, STRAY_M),
]


def model(kind: Kind, changed: dict[str, float]) -> MotionModel:
    values = defaults(kind) | {field: value for field, (_, value) in fields(kind, changed).items()}
    own: dict[str, Any] = {field: value for field, value in values.items() if "." not in field}
    return with_values(MotionModel(autopilot=kind[0], vehicle_class="copter", turn_radius_m=0.0, **own), values)


def beyond_m(q: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return how far places (N, 2) are outside a triangle."""
    edges = [(a, b), (b, c), (c, a)]
    turns = np.array([(v[0] - u[0]) * (q[:, 1] - u[1]) - (v[1] - u[1]) * (q[:, 0] - u[0]) for u, v in edges])
    inside = (turns >= 0.0).all(axis=0) | (turns <= 0.0).all(axis=0)
    away = []
    for u, v in edges:
        along = v - u
        share = np.clip((q - u) @ along / max(float(along @ along), 1e-12), 0.0, 1.0)
        away.append(np.linalg.norm(q - u - share[:, np.newaxis] * along, axis=1))
    return np.where(inside, 0.0, np.min(away, axis=0))


@pytest.mark.parametrize(("kind", "changed", "room_m"), PARAMETERS)
@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_the_model_returns_within_what_is_proven(
    kind: Kind, changed: dict[str, float], room_m: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    motion = replace(model(kind, changed), return_height_m=15.0)
    speed_m_s = float(rng.choice([5.0, 10.0]))
    way = np.column_stack([rng.uniform(0, 150, 5), rng.uniform(-100, 100, 5), rng.uniform(130, 150, 5)])
    route = Route.through(way[1:], speed_m_s)
    flown, _ = Navigator([motion], way[:1]).fly(route)
    if off_legs_m(flown, np.stack([way[:-1], way[1:]], axis=1)) > deviation_m(motion):
        return  # refused
    times_s = np.arange(0.0, float(flown.t_s[-1]) - 2.0 * TICK_S, TICK_S)
    ground = way[0] * (1.0, 1.0, 0.0) + (0.0, 0.0, 100.0)
    vehicle = Returning("v", ground, limits(), motion, flown, 0.0, float(flown.t_s[-1]), speed_m_s)
    stop, swing, drop, rise, _ = stopping_region(vehicle, flown.at(times_s))
    for k in rng.integers(0, len(times_s), 4).tolist():
        navigator = Navigator([motion], way[:1])
        navigator.follow(0, *route)
        for _ in range(k * round(TICK_S / STEP_S)):
            navigator.step()
        told = navigator.position_m[0].copy()
        home = np.array([*(told[:2] + rng.uniform(-200.0, 200.0, 2)), 100.0])
        home_top = float(home[2]) + motion.return_height_m
        navigator.follow(0, *return_points(motion, told, home))
        q = []
        for _ in range(1200):
            navigator.step()
            q.append(navigator.position_m[0].copy())
        places = np.array(q)
        off = beyond_m(places[:, :2], told[:2], stop[k], home[:2]) - swing[k]
        assert off.max() <= room_m, (times_s[k], float(off.max()))
        assert places[:, 2].max() <= max(home_top, told[2] + rise[k]) + room_m
        away = np.hypot(*(places[:, :2] - home[:2]).T) > 10.0
        assert (places[away, 2] >= told[2] - drop[k] - room_m).all()
