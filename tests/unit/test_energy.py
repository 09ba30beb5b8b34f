"""Energy by hand where it can be told by hand; its laws; the way home against the navigator that flies it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from missionplanner.energy import (
    EnergyModel,
    can_fly,
    energy_model,
    findings,
    relative_density,
    return_share,
    used_share,
)
from missionplanner.errors import MissionError
from missionplanner.mission import VehicleSettings, parse_mission
from missionplanner.motion import Navigator, return_points
from missionplanner.plan import Trajectory
from missionplanner.sortie import Leg, Sortie
from missionplanner.timing import predict_flight
from missionplanner.vehicle import true_airspeed

BATTERY = {"capacity_wh": 200.0, "level_power_w": 600.0, "mass_kg": 4.0}
HOME = np.array([0.0, 0.0, 100.0])


def model(**fields: Any) -> EnergyModel:
    found = energy_model(VehicleSettings.model_validate(fields))
    assert found is not None
    return found


MODELS = [
    model(endurance_s=1200.0),
    model(energy=BATTERY),
    model(**{"class": "plane"}, endurance_s=3600.0),
    model(**{"class": "plane"}, autopilot="px4", energy=BATTERY),
]
models = st.sampled_from(MODELS)
speeds = st.floats(0.0, 30.0)
winds = st.floats(0.0, 20.0)


def over_home(x_m: float, y_m: float, height_m: float) -> np.ndarray:
    return HOME + np.array([x_m, y_m, height_m], dtype=float)


def motion(*points: tuple[float, float, float], seconds: float = 10.0) -> Trajectory:
    return Trajectory(seconds * np.arange(len(points)), np.array(points, dtype=float))


def test_hovering_for_its_endurance_takes_the_whole_battery() -> None:
    hover = motion((0, 0, 0), (0, 0, 0), (0, 0, 0), seconds=600.0)
    assert used_share(model(endurance_s=1200.0), hover, 0.0) == pytest.approx([0.0, 0.5, 1.0], rel=1e-12)
    assert used_share(model(energy=BATTERY), hover, 0.0)[-1] == pytest.approx(1.0)  # 200 Wh / 600 W = 1200 s
    cruise = motion((0, 0, 0), (22 * 1800, 0, 0), (0, 0, 0), seconds=1800.0)
    assert used_share(model(**{"class": "plane"}, endurance_s=3600.0), cruise, 0.0)[-1] == pytest.approx(1.0)


def test_nothing_stated_is_nothing_to_prove() -> None:
    assert energy_model(VehicleSettings()) is None


def test_a_stated_battery_comes_before_the_endurance() -> None:
    assert model(energy=BATTERY, endurance_s=5.0) == model(energy=BATTERY)


def test_climbing_lifts_the_weight() -> None:
    up = motion((0, 0, -10), (0, 0, 0))
    drag_w = 0.5 * 1.225 * 0.01 * 4.0 * 1.0**3 / 0.7
    expected_wh = (600.0 + 4.0 * 9.80665 * 1.0 / 0.7 + drag_w) * 10.0 / 3600.0
    assert used_share(model(energy=BATTERY), up, 0.0)[-1] * 200.0 == pytest.approx(expected_wh, rel=1e-3)
    # of a typical copter: a good tenth more than hovering for each m/s, less than a fifth
    endurance = model(endurance_s=1000.0)
    assert 1.08 < used_share(endurance, up, 0.0)[-1] * 100.0 < 1.1


def test_sinking_gives_nothing_back() -> None:
    down, level = motion((0, 0, 0), (0, 0, -15)), motion((0, 0, 0), (0, 0, 0))
    for known in MODELS:
        assert used_share(known, down, 0.0)[-1] >= used_share(known, level, 0.0)[-1]


def test_wind_counts_as_speed_and_standing_still_too() -> None:
    for known in MODELS:
        assert known.power_share(0.0, 0.0, 12.0) == pytest.approx(known.power_share(12.0, 0.0, 0.0))
    copter = MODELS[1]
    extra_w = 0.5 * 1.225 * 0.04 * 20.0**3 / 0.7  # c_d A = 0.01 m^2/kg * 4 kg
    more = copter.power_share(15.0, 0.0, 5.0) - copter.power_share(0.0, 0.0, 0.0)
    assert float(more) * 200.0 * 3600.0 == pytest.approx(extra_w)
    plane = MODELS[2]
    assert float(plane.power_share(20.0, 0.0, 24.0) / plane.power_share(22.0, 0.0, 0.0)) == pytest.approx(8.0)


def test_thin_air_takes_more() -> None:
    for alt_amsl_m in (0.0, 500.0, 3000.0):
        assert 1 / math.sqrt(relative_density(alt_amsl_m)) == pytest.approx(true_airspeed(alt_amsl_m), rel=1e-6)
    assert float(MODELS[0].power_share(0.0, 0.0, 0.0, 3000.0)) * 1200.0 == pytest.approx(1.161, abs=0.002)
    slow, fast = (float(MODELS[2].power_share(v, 0.0, 0.0, 3000.0)) for v in (10.0, 22.0 * true_airspeed(3000.0)))
    assert slow == pytest.approx(fast, rel=1e-6)  # the same dynamic pressure as at sea level


def test_a_plane_climbs_at_the_price_of_its_glide() -> None:
    # gliding 12 to one at 22 m/s, it sinks 22 / 12 m/s; climbing as fast takes twice the power
    plane = MODELS[2]
    twice = plane.climb_share_m * 22.0 / 12.0 + plane.level_share_s
    assert twice == pytest.approx(2.0 * plane.level_share_s)


def test_nothing_is_used_before_take_off() -> None:
    wait = motion((0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0), seconds=100.0)
    assert used_share(MODELS[0], wait, 5.0, takeoff_s=150.0)[:2] == pytest.approx([0.0, 0.0])
    late, early = used_share(MODELS[0], wait, 5.0, takeoff_s=150.0)[-1], used_share(MODELS[0], wait, 5.0)[-1]
    assert late == pytest.approx(early / 2)


@given(known=models, ground=speeds, climb=st.floats(-5.0, 5.0), wind=winds, more=st.floats(0.0, 10.0))
def test_power_only_grows_with_wind_speed_and_climb(
    known: EnergyModel, ground: float, climb: float, wind: float, more: float
) -> None:
    power = known.power_share(ground, climb, wind) * (1 - 1e-12)
    assert power >= known.level_share_s * (1 - 1e-9)
    assert known.power_share(ground, climb, wind + more) >= power
    assert known.power_share(ground + more, climb, wind) >= power
    if climb >= 0.0:
        assert known.power_share(ground, climb + more, wind) >= power


flights = st.lists(st.tuples(*(st.floats(-200.0, 200.0) for _ in range(3))), min_size=3, max_size=10)


@given(known=models, points=flights, wind=winds, cut=st.integers(1, 8))
def test_the_battery_is_used_piece_by_piece(
    known: EnergyModel, points: list[tuple[float, float, float]], wind: float, cut: int
) -> None:
    flight = motion(*points)
    used = used_share(known, flight, wind)
    assert used[0] == 0.0
    assert np.all(np.diff(used) > 0.0)
    k = min(cut, len(points) - 2)
    first = Trajectory(flight.t_s[: k + 1], flight.position_m[: k + 1])
    rest = Trajectory(flight.t_s[k:], flight.position_m[k:])
    assert used[k] == pytest.approx(used_share(known, first, wind)[-1])
    assert used[-1] == pytest.approx(used_share(known, first, wind)[-1] + used_share(known, rest, wind)[-1])
    # and finer steps of the same motion take no more than coarse ones, but nearly as much
    t = np.linspace(0.0, flight.t_s[-1], 40 * (len(points) - 1) + 1)
    finer = used_share(known, Trajectory(t, flight.at(t)), wind)[::40]
    assert np.all(finer <= used + 1e-9)
    assert finer == pytest.approx(used, rel=0.03, abs=1e-12)


def test_a_speed_is_held_up_to_the_greatest_airspeed() -> None:
    fast = model(endurance_s=600.0, airspeed_max_m_s=16.0)
    assert can_fly(fast, [5.0, 8.0, 8.1], 8.0).tolist() == [True, True, False]
    stated_by_its_range = model(endurance_s=600.0, speed_m_s={"min": 2.0, "max": 12.0})
    assert can_fly(stated_by_its_range, [8.0, 9.0], 4.0).tolist() == [True, False]
    assert can_fly(stated_by_its_range, 12.0, 0.0)
    slow = model(endurance_s=600.0, speed_m_s={"min": 2.0, "max": 6.0})
    assert can_fly(slow, [6.0, 6.1], 4.0).tolist() == [True, False]  # it flies home at 10 m/s


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("vehicle_class", ["copter", "plane"])
def test_the_way_home_takes_no_more_than_told_and_not_much_less(autopilot: str, vehicle_class: str) -> None:
    known = model(**{"class": vehicle_class}, autopilot=autopilot, endurance_s=1000.0)
    for away_m, height_m, return_height_m in (
        (5, 10, 15),
        (50, 3, 30),
        (300, 40, 60),
        (1000, 100, 30),
        (3000, 40, 120),
    ):
        start = over_home(0, away_m, height_m)
        homing = replace(known.motion, return_height_m=float(return_height_m))
        flown, _ = Navigator([homing], start[None]).fly(return_points(homing, start, HOME))
        used = used_share(known, flown, 0.0)[-1]
        there = Trajectory(np.array([0.0, 1.0]), np.array([start, start]))
        told = return_share(known, there, HOME, return_height_m, 0.0)
        assert used <= told[0]
        circling_s = (
            0.0 if vehicle_class == "copter" else 4 * math.pi * homing.loiter_radius_m / homing.cruise_speed_m_s
        )
        assert told[0] <= used + (30.0 + circling_s) / 1000.0 + 0.05 * (vehicle_class == "plane")
        flying = Trajectory(np.array([0.0, 1.0]), np.array([start, over_home(0, away_m + 12, height_m + 2)]))
        moving = return_share(known, flying, HOME, return_height_m, 0.0)[0]
        stops_m = 0.5 * 12.0**2 / homing.acceleration_m_s2 + 12.0
        assert moving > told[0] + (12.0 / homing.acceleration_m_s2 + stops_m / homing.cruise_speed_m_s) / 1000.0
        assert return_share(known, there, HOME, return_height_m, 3.0)[0] > told[0]


def test_nobody_comes_home_against_more_wind_than_it_flies() -> None:
    there = motion((0, 500, 150), (0, 500, 150))
    assert np.all(np.isinf(return_share(model(endurance_s=900.0, airspeed_max_m_s=12.0), there, HOME, 30.0, 12.0)))
    assert np.all(np.isfinite(return_share(model(endurance_s=900.0, airspeed_max_m_s=12.0), there, HOME, 30.0, 11.0)))
    slow, fast = (
        return_share(model(endurance_s=900.0, airspeed_max_m_s=v), there, HOME, 30.0, 0.0) for v in (5.0, 30.0)
    )
    assert np.all(slow > fast + 40.0 / 900.0)
    assert np.all(np.isinf(return_share(MODELS[2], there, HOME, 30.0, 22.0)))


def sortie(speed_m_s: float = 8.0, far_m: float = 800.0) -> tuple[Sortie, Trajectory, np.ndarray]:
    ends = [over_home(*end) for end in ((0, 0, 40), (far_m, 0, 60), (far_m, 200, 60), (100, 200, 60))]
    kinds = ["takeoff", "straight", "straight", "straight"]
    legs = tuple(Leg(k + 1, kind, end, speed_m_s) for k, (kind, end) in enumerate(zip(kinds, ends, strict=True)))  # type: ignore[arg-type]
    flight, reached_s = predict_flight(
        model(endurance_s=1.0).motion,
        HOME,
        np.array(ends),
        speed_m_s,
        end="land",
        ground_amsl_m=100.0,
        start_delay_s=30.0,
    )
    return Sortie("alpha", 1, "ardupilot", "copter", HOME, legs, "land", 5, 30.0, 70.0), flight, reached_s


def test_what_the_battery_is_needed_for_is_told() -> None:
    asked, flight, reached_s = sortie()
    airborne_s = flight.t_s[-1] - 30.0
    plenty = findings(model(endurance_s=2.0 * airborne_s), asked, flight, reached_s, 0.0)
    assert [f.proven for f in plenty] == [True, True]
    assert all(f.check == "energy" and f.vehicle == "alpha" and f.required == 0.8 for f in plenty)
    short = findings(model(endurance_s=1.2 * airborne_s), asked, flight, reached_s, 0.0)
    assert not short[0].proven
    assert short[0].value is not None
    assert short[0].value > 1 / 1.2  # thin air and climbs come on top
    assert "allowed 80%" in str(short[0])
    assert "larger battery" in short[0].remedy


def test_the_farthest_point_decides_whether_it_comes_home() -> None:
    asked, flight, reached_s = sortie(far_m=3000.0)
    goes = flight.t_s[-1] - 30.0
    known = model(endurance_s=1.4 * goes, reserve_share=0.0)
    mission, home = findings(known, asked, flight, reached_s, 0.0)
    assert mission.proven
    assert home.proven
    one_way = (flight.t_s <= reached_s[2]).sum()
    shortened = Trajectory(flight.t_s[:one_way], flight.position_m[:one_way])
    there = replace(asked, legs=asked.legs[:3], ending_seq=4)
    mission, home = findings(model(endurance_s=0.7 * goes, reserve_share=0.0), there, shortened, reached_s[:3], 0.0)
    assert mission.proven
    assert not home.proven
    assert not home.holds
    assert home.seq == 3
    assert home.position_m is not None
    assert home.position_m[:2] == pytest.approx([3000.0, 200.0], abs=30.0)
    down_s = reached_s[2] + np.array([0.05, 900.0])
    landing = Trajectory(
        np.append(shortened.t_s, down_s), np.concatenate([shortened.position_m, shortened.position_m[-1:].repeat(2, 0)])
    )
    assert findings(known, there, landing, reached_s[:3], 0.0)[1].proven  # nobody returns while it lands
    waived = findings(
        model(endurance_s=0.7 * goes, reserve_share=0.0), there, shortened, reached_s[:3], 0.0, return_waived=True
    )
    assert waived[1].holds
    assert not waived[1].proven


def test_wind_that_a_leg_cannot_be_held_against_names_it() -> None:
    asked, flight, reached_s = sortie(speed_m_s=8.0)
    fast = replace(asked, legs=(*asked.legs[:2], replace(asked.legs[2], speed_m_s=9.0), asked.legs[3]))
    found = findings(model(endurance_s=9000.0, airspeed_max_m_s=16.5), fast, flight, reached_s, 8.0)
    assert [f.proven for f in found] == [True, False, True]
    assert (found[1].seq, found[1].value, found[1].required) == (3, 17.0, 16.5)
    assert "17 m/s to fly 9 m/s against 8 m/s of wind" in str(found[1])
    stronger = findings(model(endurance_s=9000.0, airspeed_max_m_s=16.5), fast, flight, reached_s, 17.0)
    assert not stronger[-1].proven
    assert stronger[-1].value is None
    assert "gets nowhere" in stronger[-1].detail


@settings(deadline=None, max_examples=20)
@given(wind=winds, more=st.floats(0.0, 5.0), far_m=st.floats(100.0, 2000.0))
def test_more_wind_proves_no_more(wind: float, more: float, far_m: float) -> None:
    asked, flight, reached_s = sortie(far_m=far_m)
    known = model(endurance_s=900.0, airspeed_max_m_s=20.0)
    calmer = [f for f in findings(known, asked, flight, reached_s, wind) if f.unit == ""]
    stormier = [f for f in findings(known, asked, flight, reached_s, wind + more) if f.unit == ""]
    for before, after in zip(calmer, stormier, strict=True):
        assert before.proven or not after.proven
        assert (before.value or math.inf) <= (after.value or math.inf) * (1 + 1e-12)


MISSION = """
name: m
origin: {lat_deg: 47, lon_deg: 8}
terrain: {kind: flat, alt_amsl_m: 0}
wind_max_m_s: 6
defaults: {energy: {capacity_wh: 100, level_power_w: 300, mass_kg: 2}, reserve_share: 0.3}
vehicles:
  - {name: a, home: {x_m: 0, y_m: 0}, goal: {x_m: 9, y_m: 9, height_agl_m: 40}, energy: {mass_kg: 2.5}}
  - {name: b, home: {x_m: 50, y_m: 0}, goal: {x_m: 99, y_m: 9, height_agl_m: 40}, energy: null, endurance_s: 900}
"""


def test_the_mission_file_states_energy_and_wind() -> None:
    mission = parse_mission(MISSION, "m.yaml")
    assert mission.wind_max_m_s == 6.0
    heavy, simple = (energy_model(vehicle) for vehicle in mission.vehicles)
    assert heavy is not None
    assert simple is not None
    assert heavy.reserve_share == simple.reserve_share == 0.3
    assert heavy.climb_share_m == pytest.approx(2.5 * 9.80665 / 0.7 / 360_000)
    assert simple.level_share_s == pytest.approx(1 / 900)


@pytest.mark.parametrize(
    ("good", "wrong", "problem"),
    [
        (
            "capacity_wh: 100, ",
            "",
            r"vehicles\[0\].energy.capacity_wh: expected this field, got none|energy.capacity_wh",
        ),
        ("mass_kg: 2}", "mass_kg: 0}", "mass_kg: expected a number above 0, got 0"),
        ("reserve_share: 0.3", "reserve_share: 1.3", "reserve_share: expected a number of at most 1, got 1.3"),
        ("wind_max_m_s: 6", "wind_max_m_s: -6", "wind_max_m_s: expected a number of at least 0, got -6"),
    ],
)
def test_wrong_energy_is_told(good: str, wrong: str, problem: str) -> None:
    with pytest.raises(MissionError, match=problem):
        parse_mission(MISSION.replace(good, wrong), "m.yaml")
