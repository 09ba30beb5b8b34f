"""A flight told by telemetry: the vehicle's own clock, its arrival and its landing."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.flight_recorder import FlightRecorder
from tests.plans import FRAME

GOAL_M = np.array([100.0, 0.0, 1230.0])
BOOT_S = 500.0  # the vehicle's clock when the link's shows 0


def position(boot_s: float, x_m: float, z_m: float = 1230.0) -> object:
    point = FRAME.geo_point(np.array([x_m, 0.0, z_m]))
    return mavlink.MAVLink_global_position_int_message(
        round(boot_s * 1e3), round(point.lat_deg * 1e7), round(point.lon_deg * 1e7), round(z_m * 1e3), 0, 0, 0, 0, 0
    )


def recorder() -> FlightRecorder:
    return FlightRecorder(goal_seq=4, goal_m=GOAL_M, reach_m=3.0, frame=FRAME, landing_amsl_m=1190.0)


def fly(
    flight: FlightRecorder,
    delay_s: object = lambda t: 0.0,
    rate: float = 1.0,
    start_s: float = 10.0,
    end_s: float = 60.0,
) -> None:
    """Stand still until ``start_s``, then fly at 2 m/s past the goal; the link's clock runs ``rate`` times slower."""
    begun = False
    for t in np.arange(start_s - 3.0, start_s + end_s, 0.2):
        flown_s = max(t - start_s, 0.0)
        if not begun and t >= start_s:
            flight.start(start_s / rate)
            begun = True
        x_m = min(2.0 * flown_s, 110.0)
        flight.receive(position(BOOT_S + t, x_m, 1200.0 if flown_s == 0.0 else 1230.0), t / rate + delay_s(t))  # type: ignore[operator]


def test_time_is_the_vehicles_own_since_the_common_start() -> None:
    flight = recorder()
    fly(flight)
    track = flight.trajectory()
    assert track.t_s[0] == pytest.approx(0.0, abs=1e-9)
    assert flight.t_s == pytest.approx(59.8, abs=1e-6)
    np.testing.assert_allclose(track.at(20.0), [40.0, 0.0, 1230.0], atol=0.02)


def test_a_jittery_link_does_not_move_the_track() -> None:
    rng = np.random.default_rng(1)
    delays_s = rng.exponential(0.15, 10_000)
    flight = recorder()
    fly(flight, delay_s=lambda t: 0.02 + delays_s[round(t / 0.2)])
    assert flight.trajectory().at(20.0)[0] == pytest.approx(40.0, abs=0.3)  # 0.15 s at 2 m/s


def test_an_accelerated_vehicle_is_told_in_its_own_seconds() -> None:
    flight = recorder()
    fly(flight, rate=10.0)
    assert flight.t_s == pytest.approx(59.8, abs=0.7)
    track = flight.trajectory()
    assert np.diff(track.t_s[1:-1]) == pytest.approx(0.2, abs=1e-6)


def test_messages_out_of_order_are_left_out() -> None:
    flight = recorder()
    fly(flight)
    flight.receive(position(BOOT_S + 65.0, 1.0), 70.0)
    assert not flight.rebooted
    assert np.all(np.diff(flight.trajectory().t_s) > 0)
    flight.receive(position(1.0, 1.0), 71.0)
    assert flight.rebooted


def test_arrival_by_the_reached_message() -> None:
    flight = recorder()
    fly(flight, end_s=49.0)
    assert flight.arrival_s is None
    flight.receive(mavlink.MAVLink_mission_item_reached_message(3), 58.0)
    assert flight.arrival_s is None
    flight.receive(mavlink.MAVLink_mission_item_reached_message(4), 59.1)
    assert flight.arrival_s == pytest.approx(49.1, abs=1e-6)
    assert flight.reached_goal


def test_arrival_by_the_status_text() -> None:
    flight = recorder()
    fly(flight, end_s=49.0)
    flight.receive(mavlink.MAVLink_statustext_message(6, b"Reached command #14"), 59.0)
    assert flight.arrival_s is None
    flight.receive(mavlink.MAVLink_statustext_message(6, b"Reached command #4"), 59.1)
    assert flight.arrival_s == pytest.approx(49.1, abs=1e-6)


def test_arrival_by_the_item_moving_on_is_the_closest_approach_between() -> None:
    flight = recorder()
    fly(flight, end_s=58.0)
    flight.receive(mavlink.MAVLink_mission_current_message(4), 58.5)
    assert flight.arrival_s is None
    flight.receive(mavlink.MAVLink_mission_current_message(5), 62.0)
    assert flight.arrival_s == pytest.approx(50.0, abs=0.02)
    flight.receive(mavlink.MAVLink_mission_item_reached_message(4), 66.0)  # an echo
    assert flight.arrival_s == pytest.approx(50.0, abs=0.02)


def test_an_item_beyond_the_goal_before_the_flight_is_no_arrival() -> None:
    flight = recorder()
    flight.receive(mavlink.MAVLink_mission_current_message(5), 5.0)
    fly(flight, end_s=30.0)
    flight.receive(mavlink.MAVLink_mission_current_message(5), 39.0)
    assert flight.arrival_s is None


def test_without_any_news_only_a_track_that_passed_the_goal_arrived() -> None:
    for end_s, arrives in ((58.0, True), (40.0, False)):
        flight = recorder()
        fly(flight, end_s=end_s)
        flight.receive(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND), 75.0)
        assert flight.landed
        assert (flight.arrival_s is not None) == arrives


@pytest.mark.parametrize("way", ["landed state", "disarmed"])
def test_landing(way: str) -> None:
    on_ground = (
        mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND)
        if way == "landed state"
        else mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)
    )
    flight = recorder()
    flight.start(1.0)
    flight.receive(on_ground, 1.1)  # it has not flown yet
    assert not flight.landed
    flight = recorder()
    fly(flight)
    flight.receive(position(BOOT_S + 69.85, 110.0, 1191.0), 69.85)
    flight.receive(on_ground, 69.9)
    assert flight.landed
    assert flight.landed_s == pytest.approx(59.9, abs=1e-6)
    flight.receive(on_ground, 80.0)
    assert flight.landed_s == pytest.approx(59.9, abs=1e-6)


DISARMED = mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3)


def fall(flight: FlightRecorder, x_m: float, from_m: float, rate_m_s: float, end_s: float) -> None:
    """Go on at ``x_m`` from 70 s on, sinking, disarmed."""
    for t in np.arange(70.0, end_s, 0.2):
        flight.receive(position(BOOT_S + t, x_m, from_m - rate_m_s * (t - 70.0)), t)
        if t % 1.0 < 0.1:
            flight.receive(DISARMED, t)


@pytest.mark.parametrize("rate_m_s", [1.0, 4.0])  # under a parachute, or faster
def test_who_is_disarmed_in_the_air_has_not_landed(rate_m_s: float) -> None:
    flight = recorder()
    fly(flight)
    fall(flight, 110.0, 1230.0, rate_m_s, 72.0)
    assert not flight.landed
    assert flight.disarmed_up_m == pytest.approx(30.0 - 2.0 * rate_m_s, abs=rate_m_s)
    assert not flight.fell(72.0)
    fall(flight, 110.0, 1230.0, rate_m_s, 78.5)
    assert not flight.landed
    assert flight.fell(78.5)


def test_who_is_disarmed_and_stands_still_has_landed_wherever_that_is() -> None:
    flight = recorder()
    fly(flight)
    fall(flight, 110.0, 1215.0, 0.0, 75.0)  # nobody knew of ground there
    assert flight.landed
    assert flight.landed_s == pytest.approx(60.0, abs=0.3)  # when it was disarmed
    assert flight.disarmed_up_m is None
    assert not flight.fell(80.0)


@pytest.mark.parametrize("x_m", [0.0, 110.0])
def test_the_height_of_known_ground_counts_only_near_it(x_m: float) -> None:
    """A valley's floor is as high as some landing place; who is disarmed above it falls."""
    flight = FlightRecorder(4, np.array([900.0, 0.0, 1240.0]), 3.0, FRAME, landing_amsl_m=1229.0)
    fly(flight)
    fall(flight, x_m, 1230.0 if x_m else 1201.0, 1.0, 71.0)
    assert flight.landed == (x_m == 0.0)


def test_a_restart_in_flight_is_no_landing() -> None:
    """A booting autopilot says that it is on the ground, before or after its clock is heard."""
    on_ground = mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_ON_GROUND)
    clock = mavlink.MAVLink_system_time_message(0, 2_000)
    for said in ([on_ground, clock], [clock, DISARMED, on_ground]):
        flight = recorder()
        fly(flight)
        for message in said:
            flight.receive(message, 74.0)
        assert flight.rebooted
        assert not flight.landed
        assert flight.landed_s is None
    flight = recorder()  # but who is switched off and on again after it has landed has landed
    fly(flight)
    flight.receive(on_ground, 70.0)
    flight.receive(clock, 100.0)
    assert flight.landed
    assert not flight.rebooted


def test_a_bounce_is_no_landing() -> None:
    flight = recorder()
    fly(flight)
    for state, now_s in ((1, 69.9), (2, 70.1), (1, 70.5)):
        flight.receive(mavlink.MAVLink_extended_sys_state_message(0, state), now_s)
    assert flight.landed_s == pytest.approx(60.5, abs=1e-6)


def test_the_track_ends_at_touch_down() -> None:
    flight = recorder()
    fly(flight, end_s=50.0)
    flight.receive(mavlink.MAVLink_extended_sys_state_message(0, 1), 55.1)
    assert flight.landed_s == pytest.approx(45.1, abs=0.11)
    assert flight.trajectory().t_s[-1] == flight.landed_s


def test_nothing_heard_is_an_empty_track() -> None:
    flight = recorder()
    flight.start(1.0)
    assert flight.trajectory().position_m.shape == (0, 3)
    assert (flight.arrival_s, flight.landed_s, flight.t_s, flight.position_m) == (None, None, None, None)
