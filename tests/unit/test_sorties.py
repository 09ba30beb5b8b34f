"""Missions read as sorties: every rule of the autopilots, every sample file, what is not known named."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.mission_items import MissionItem, degrees_to_wire, items_sha256, plan_items
from adapters.sorties import command_name, mission_file_notes, plan_sortie, read_mission_file, read_sortie
from adapters.waypoints_file import waypoints_text
from missionplanner.errors import MissionError
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.mission import Point, Vehicle
from missionplanner.sortie import Sortie
from missionplanner.vehicle import Autopilot, VehicleClass, motion_model
from tests.oracles import flights
from tests.plans import FRAME, vehicle_plan

SAMPLES = Path(__file__).parents[3] / "shared" / "samples"
HOME = np.array([0.0, 0.0, 1200.0])
_GOAL = Point(x_m=0.0, y_m=0.0, alt_amsl_m=1244.5)


def _item(command: int, x_m: float = 0.0, y_m: float = 0.0, z: float = 0.0, frame: int = 0, **more: Any) -> MissionItem:
    """Return an item at a local place; ``at=False``: at 0, 0."""
    if not more.pop("at", True):
        return MissionItem(0, frame, command, z=z, **more)
    point = FRAME.geo_point([x_m, y_m, 0.0])
    x, y = degrees_to_wire(point.lat_deg), degrees_to_wire(point.lon_deg)
    return MissionItem(0, frame, command, x=x, y=y, z=z, **more)


HOME_ROW = _item(16, z=1200.0)
UP = _item(22, z=30.0, frame=3)
PX4_UP = _item(22, z=1230.0)
A = _item(16, 100.0, 0.0, 1240.0)
B = _item(16, 100.0, 80.0, 1250.0)
RTL = MissionItem(0, 2, 20)
PLANE_UP = _item(22, 300.0, 0.0, 60.0, frame=3)


def _speed(value: float, kind: float = 1.0, **more: Any) -> MissionItem:
    return MissionItem(0, 2, 178, kind, value, -1.0, **more)


def _read(
    *items: MissionItem,
    autopilot: Autopilot = "ardupilot",
    vehicle_class: VehicleClass = "copter",
    home_m: FloatArray | None = HOME,
    **more: Any,
) -> Sortie:
    settings = Vehicle(name="uav1", autopilot=autopilot, vehicle_class=vehicle_class, goal=_GOAL, home=_GOAL)
    return read_sortie(
        [replace(item, seq=seq) for seq, item in enumerate(items)],
        name="uav1",
        sysid=1,
        autopilot=autopilot,
        vehicle_class=vehicle_class,
        frame=FRAME,
        home_m=home_m,
        motion=motion_model(settings),
        **more,
    )


def _copter(*items: MissionItem, **more: Any) -> Sortie:
    return _read(HOME_ROW, UP, *items, **more)


def _px4(*items: MissionItem, **more: Any) -> Sortie:
    return _read(PX4_UP, *items, autopilot="px4", **more)


def _plane(*items: MissionItem, **more: Any) -> Sortie:
    return _read(HOME_ROW, PLANE_UP, *items, vehicle_class="plane", **more)


def _near(place: FloatArray, expected: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(place, expected, atol=0.02)


def _gaps(sortie: Sortie) -> list[str]:
    return [f"{gap.seq} {gap.what}" for gap in sortie.gaps]


# home and take-off


def test_ardupilots_home_is_its_item_0() -> None:
    sortie = _read(_item(16, 50.0, 0.0, 1190.0), UP, A, RTL, home_m=None)
    _near(sortie.home_m, (50.0, 0.0, 1190.0))
    _near(sortie.legs[0].end_m, (50.0, 0.0, 1220.0))  # straight up from there, the item's place ignored
    assert [leg.kind for leg in sortie.legs] == ["takeoff", "straight"]
    assert [leg.seq for leg in sortie.legs] == [1, 2]
    assert (sortie.ending, sortie.ending_seq) == ("rtl", 3)
    assert sortie.gaps == ()


@pytest.mark.parametrize("row", [MissionItem(0, 0, 16), MissionItem(0, 0, 16, z=1180.0), _item(16, frame=3)])
def test_a_home_row_that_says_nothing_takes_what_is_told(row: MissionItem) -> None:
    sortie = _read(row, UP, A, RTL)
    np.testing.assert_array_equal(sortie.home_m, HOME)
    assert sortie.gaps == ()
    with pytest.raises(
        MissionError, match="uav1: missing home: item 0 gives no position AMSL: give the vehicle's home"
    ):
        _read(row, UP, A, RTL, home_m=None)


def test_px4_has_no_home_item() -> None:
    assert len(_px4(A, RTL).legs) == 2
    with pytest.raises(MissionError, match="uav1: missing home: PX4's missions have none: give the vehicle's home"):
        _px4(A, RTL, home_m=None)


def test_two_homes_that_differ_are_a_gap() -> None:
    assert _gaps(_copter(A, RTL, home_m=np.array([0.0, 0.0, 1150.0]))) == [
        "0 home: the mission's lies 50 m from the vehicle's own: heights are not known"
    ]
    few = _copter(A, RTL, home_m=np.array([3.0, 0.0, 1200.0]))
    assert few.gaps == ()
    assert few.notes == ("home in the mission lies 3.0 m from the vehicle's own",)


@pytest.mark.parametrize(("ground_m", "gap"), [(1195.0, None), (1100.0, "100 m above"), (math.nan, "no terrain")])
def test_home_is_held_to_the_ground(ground_m: float, gap: str | None) -> None:
    sortie = _copter(A, RTL, ground=lambda _x, _y: ground_m)
    assert (sortie.gaps == ()) == (gap is None)
    assert gap is None or gap in sortie.gaps[0].what


def test_a_take_off_sent_as_item_0_is_lost() -> None:
    sortie = _read(UP, A, RTL)
    assert _gaps(sortie) == [
        "0 TAKEOFF: item 0 is overwritten by home and never flown",
        "1 WAYPOINT: no take-off comes before it: ArduCopter does not start (Missing Takeoff Cmd)",
    ]
    _near(sortie.legs[0].end_m, (0.0, 0.0, 1240.0))


def test_px4_climbs_at_home_then_flies_to_the_take_offs_place() -> None:
    aside = _read(_item(22, 40.0, 0.0, 30.0, frame=3), A, RTL, autopilot="px4")
    assert [leg.kind for leg in aside.legs] == ["takeoff", "straight", "straight"]
    _near(aside.legs[0].end_m, (0.0, 0.0, 1230.0))
    _near(aside.legs[1].end_m, (40.0, 0.0, 1230.0))
    within = _read(_item(22, 1.5, 0.0, 30.0, frame=3), A, RTL, autopilot="px4")
    assert [leg.kind for leg in within.legs] == ["takeoff", "straight"]


def test_px4_climbs_no_less_than_its_least() -> None:
    low = _read(_item(22, z=2.0, frame=3), A, RTL, autopilot="px4")
    assert _gaps(low) == ["0 TAKEOFF: take-off to 2.0 m above home: PX4 climbs to 2.5 m (MIS_TAKEOFF_ALT)"]
    assert not _read(_item(22, z=2.5, frame=3), A, RTL, autopilot="px4").gaps
    assert not _read(HOME_ROW, _item(22, z=2.0, frame=3), A, RTL).gaps


def test_px4_takes_off_without_an_item() -> None:
    sortie = _read(A, RTL, autopilot="px4")
    assert sortie.gaps == ()
    _near(sortie.legs[0].end_m, (0.0, 0.0, 1240.0))
    _near(sortie.legs[1].end_m, (100.0, 0.0, 1240.0))


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_take_off_that_does_not_rise_is_a_gap(autopilot: Autopilot) -> None:
    low = _item(22, z=100.0)  # AMSL, below home: somebody meant above home
    sortie = _read(*([HOME_ROW] if autopilot == "ardupilot" else []), low, A, RTL, autopilot=autopilot)
    assert "take-off to 100.0 m AMSL is not above home at 1200.0 m" in sortie.gaps[0].what


def test_a_plane_takes_off_towards_its_item() -> None:
    sortie = _plane(A, RTL)
    _near(sortie.legs[0].end_m, (300.0, 0.0, 1260.0))
    assert sortie.gaps == ()
    assert "facing" in sortie.notes[0]
    for nowhere in (_item(22, z=60.0, frame=3), _item(22, z=60.0, frame=3, at=False)):
        sortie = _read(HOME_ROW, nowhere, A, RTL, vehicle_class="plane")
        assert "no direction is given" in sortie.gaps[0].what


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_plane_without_take_off_is_a_gap(autopilot: Autopilot) -> None:
    items = [A, B, RTL] if autopilot == "px4" else [HOME_ROW, A, B, RTL]
    sortie = _read(*items, autopilot=autopilot, vehicle_class="plane")
    assert "no take-off comes before it" in sortie.gaps[0].what
    assert [leg.kind for leg in sortie.legs] == ["takeoff", "straight"]


def test_a_take_off_in_flight_is_a_gap() -> None:
    assert _gaps(_copter(A, UP, B, RTL)) == ["3 TAKEOFF: take-off in flight"]


# frames and altitudes


@pytest.mark.parametrize(
    ("frame", "z", "alt"), [(0, 1240.0, 1240.0), (5, 1240.0, 1240.0), (3, 35.0, 1235.0), (6, 35.0, 1235.0)]
)
def test_frames(frame: int, z: float, alt: float) -> None:
    sortie = _copter(_item(16, 100.0, 0.0, z, frame), RTL)
    _near(sortie.legs[1].end_m, (100.0, 0.0, alt))
    assert sortie.gaps == ()
    assert sortie.notes == ()


def test_mixed_altitudes_are_told() -> None:
    sortie = _copter(A, _item(16, 100.0, 80.0, 45.0, frame=3), RTL)
    assert sortie.gaps == ()
    assert sortie.notes == ("altitudes are mixed: AMSL (first in item 2) and above home (first in item 3)",)


def test_altitudes_are_single_precision() -> None:
    sortie = _px4(_item(16, 100.0, 0.0, 1240.123456789), RTL)
    assert sortie.legs[1].end_m[2] == np.float32(1240.123456789)


@pytest.mark.parametrize("frame", [10, 11])
def test_heights_above_terrain_are_a_gap(frame: int) -> None:
    sortie = _copter(_item(16, 100.0, 0.0, 25.0, frame), RTL, ground=lambda _x, _y: 1195.0)
    assert _gaps(sortie) == ["2 WAYPOINT: height above the terrain that the vehicle knows, which is not known here"]
    _near(sortie.legs[1].end_m, (100.0, 0.0, 1220.0))


@pytest.mark.parametrize("frame", [1, 2, 4, 7, 21])
def test_other_frames_are_a_gap(frame: int) -> None:
    assert _gaps(_copter(_item(16, 100.0, 0.0, 25.0, frame), RTL)) == [
        f"2 WAYPOINT: altitude in frame {frame}, which is none of 0, 3, 5, 6"
    ]


def test_arducopters_zeros_mean_as_now() -> None:
    sortie = _copter(A, _item(16, z=1260.0, at=False), _item(16, 50.0, 0.0, 0.0, frame=3), RTL)
    _near(sortie.legs[2].end_m, (100.0, 0.0, 1260.0))  # straight up at A
    _near(sortie.legs[3].end_m, (50.0, 0.0, 1260.0))  # not home's altitude
    assert sortie.gaps == ()


def test_a_plane_at_0_0_is_a_gap() -> None:
    assert _gaps(_plane(A, _item(17, z=1260.0, at=False))) == ["3 LOITER_UNLIM: 0, 0 is wherever the plane then is"]


# waypoints


def test_holds() -> None:
    assert [leg.hold_s for leg in _copter(replace(A, param1=2.9), B, RTL).legs] == [0.0, 2.0, 0.0]  # whole seconds
    assert [leg.hold_s for leg in _px4(replace(A, param1=2.5), replace(B, param1=math.nan), RTL).legs] == [0, 2.5, 0]
    assert _gaps(_copter(replace(A, param1=-1.0), RTL)) == ["2 WAYPOINT: ArduPilot cannot hold it for -1 s"]
    assert _gaps(_copter(replace(A, param1=math.nan), RTL)) == ["2 WAYPOINT: ArduPilot cannot hold it for nan s"]
    plane = _plane(replace(A, param1=5.0), RTL)
    assert (plane.legs[1].hold_s, plane.gaps) == (0.0, ())
    up = _item(22, 300.0, 0.0, 1260.0)
    assert "circle" in _read(up, replace(A, param1=5.0), autopilot="px4", vehicle_class="plane").gaps[0].what


def test_a_radius_wider_than_the_tube_knows_is_a_gap() -> None:
    assert _px4(replace(A, param2=2.0), RTL).gaps == ()
    assert "its radius of 30 m" in _px4(replace(A, param2=30.0), RTL).gaps[0].what
    assert _copter(replace(A, param2=30.0), RTL).gaps == ()  # dropped
    assert "its radius of 90 m" in _plane(replace(A, param2=90.0), RTL).gaps[0].what
    assert "param 3" in _plane(replace(A, param3=20.0), RTL).gaps[0].what


def test_splines() -> None:
    sortie = _copter(A, replace(B, command=82, param1=1.0), RTL)
    assert [leg.kind for leg in sortie.legs] == ["takeoff", "straight", "spline"]
    assert sortie.legs[2].hold_s == 1.0
    assert sortie.gaps == ()
    for other in (_px4(replace(A, command=82), RTL), _plane(replace(A, command=82), RTL)):
        assert other.gaps[0].what == "SPLINE_WAYPOINT: only ArduCopter flies splines"
    circled = _copter(_item(18, 100.0, 0.0, 1240.0, param1=1.0, param3=20.0), replace(B, command=82), RTL)
    assert "after a circle" in circled.gaps[0].what
    spline = replace(B, command=82)
    assert _copter(spline, _item(21, 100.0, 80.0, 0.0, frame=3)).gaps == ()
    assert "bends towards its altitude" in _copter(spline, _item(21, 100.0, 80.0, 1200.0)).gaps[0].what
    assert "how the spline before it ends" in _copter(spline, MissionItem(0, 2, 93, 3.0), RTL).gaps[0].what


# loitering


def test_copters_hold_in_place() -> None:
    sortie = _copter(A, _item(19, 100.0, 80.0, 1250.0, param1=12.7, param3=40.0), _item(17, 100.0, 80.0, 1250.0), B)
    assert [leg.kind for leg in sortie.legs] == ["takeoff", "straight", "straight"]
    assert sortie.legs[2].hold_s == 12.0
    assert (sortie.ending, sortie.ending_seq) == ("loiter", 4)
    assert "item 5 after LOITER_UNLIM are not flown" in sortie.notes
    moved = _copter(A, _item(17, 100.0, 80.0, 1250.0))
    assert [leg.seq for leg in moved.legs] == [1, 2, 3]
    # a stop of no time is still a stop
    assert 0.0 < _copter(A, _item(19, 100.0, 80.0, 1250.0), B, RTL).legs[2].hold_s < 0.1


def test_arducopter_circles() -> None:
    sortie = _copter(_item(18, 100.0, 0.0, 1240.0, param1=3.0, param3=-20.4), A, RTL)
    circle = sortie.legs[1]
    assert (circle.kind, circle.radius_m, circle.turns) == ("circle", 20.0, 3.0)
    assert circle.speed_m_s == pytest.approx(5.0)  # sqrt(2.5 / 2 * 20), less than the mission's 10
    assert sortie.gaps == ()
    for radius, turns, why in [(0.0, 2.0, "vehicle's own"), (300.0, 2.0, "vehicle's own"), (20.0, 0.0, "0 turns")]:
        assert why in _copter(_item(18, 100.0, 0.0, 1240.0, param1=turns, param3=radius), RTL).gaps[0].what
    assert "PX4 refuses it" in _px4(_item(18, 9.0, 0.0, 1240.0, param1=1.0, param3=9.0), RTL).gaps[0].what


def test_from_its_circle_arducopter_flies_to_the_middle() -> None:
    circle = _item(18, 100.0, 0.0, 1240.0, param1=1.0, param3=50.0)
    for ending in (_item(21, 100.0, 0.0, 0.0), _item(17, 100.0, 0.0, 1240.0)):
        assert [leg.kind for leg in _copter(A, circle, ending).legs] == ["takeoff", "straight", "circle", "straight"]
    below = _copter(A, circle, _item(21, at=False))
    assert [leg.kind for leg in below.legs] == ["takeoff", "straight", "circle"]  # lands wherever on it
    assert "wherever on its circle" in _copter(A, circle, _item(16, at=False), RTL).gaps[0].what


@pytest.mark.parametrize("seconds", [86_401.0, 1e9, 1e38])
def test_who_waits_for_more_than_a_day_is_not_followed(seconds: float) -> None:
    waits = {
        "PX4 waypoint": _px4(replace(A, param1=seconds), B, RTL),
        "PX4 loiter": _px4(_item(19, 100.0, 0.0, 1240.0, param1=seconds), B, RTL),
        "PX4 delay": _px4(A, MissionItem(0, 2, 93, seconds), B, RTL),
        "delay in flight": _copter(A, MissionItem(0, 2, 93, seconds), B, RTL),
        "delay before": _read(HOME_ROW, MissionItem(0, 2, 93, seconds), UP, A, RTL),
        "PX4 plane": _read(
            _item(22, 300.0, 0.0, 1260.0),
            _item(19, 100.0, 0.0, 1240.0, param1=seconds, param3=80.0),
            RTL,
            autopilot="px4",
            vehicle_class="plane",
        ),
    }
    for where, sortie in waits.items():
        assert any("must take less than a day" in gap.what for gap in sortie.gaps), where
        assert sum(leg.hold_s for leg in sortie.legs) + sortie.start_delay_s < 1.0, where


@pytest.mark.parametrize("speed_m_s", [5e-4, 1e-6, 1e-38])
def test_who_flies_for_more_than_a_day_is_refused(speed_m_s: float) -> None:
    with pytest.raises(MissionError, match=r"uav1: item 3: expected to be flown within a day, got .* hours"):
        _px4(A, _speed(speed_m_s), B, RTL)
    assert _px4(A, _speed(0.01), B, RTL).gaps == ()  # 80 m


def test_waits_of_a_day_in_all_are_followed() -> None:
    most = _px4(replace(A, param1=86_000.0), replace(B, param1=400.0), RTL)
    assert most.gaps == ()
    assert [leg.hold_s for leg in most.legs][1:] == [86_000.0, 400.0]
    more = _px4(replace(A, param1=86_000.0), replace(B, param1=401.0), RTL)
    assert [gap.seq for gap in more.gaps] == [2]


def test_planes_circle() -> None:
    own = _plane(A, _item(17, 100.0, 0.0, 1240.0, param3=60.0))
    assert [leg.kind for leg in own.legs] == ["takeoff", "straight"]  # what every loiter at the end is
    assert own.ending == "loiter"
    wide = _plane(A, _item(17, 100.0, 0.0, 1240.0, param3=-90.0))
    assert (wide.legs[2].kind, wide.legs[2].radius_m, wide.legs[2].turns) == ("circle", 90.0, math.inf)
    turns = _plane(A, _item(18, 100.0, 0.0, 1240.0, param1=2.0, param3=80.0), RTL)
    assert (turns.legs[2].radius_m, turns.legs[2].turns) == (80.0, 3.0)
    # ArduPlane: the vehicle's own radius whatever param 3; PX4: param 3
    timed = _item(19, 100.0, 0.0, 1240.0, param1=100.0, param3=80.0)
    assert _plane(A, timed, RTL).legs[2].radius_m == 60.0
    px4 = _read(_item(22, 300.0, 0.0, 1260.0), A, timed, RTL, autopilot="px4", vehicle_class="plane")
    assert px4.legs[2].radius_m == 80.0
    assert px4.legs[2].turns == pytest.approx(100.0 * 15.0 / (2.0 * math.pi * 80.0) + 1.0)


# endings


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_copter_lands_at_the_items_place_but_flies_there_level(autopilot: Autopilot) -> None:
    items = [A, _item(21, 100.0, 80.0, 1190.0)]
    sortie = _copter(*items) if autopilot == "ardupilot" else _px4(*items)
    _near(sortie.legs[-1].end_m, (100.0, 80.0, 1240.0))
    assert (sortie.ending, sortie.ending_seq, sortie.gaps) == ("land", sortie.legs[-1].seq, ())


def test_ardupilot_lands_where_it_is_at_0_0() -> None:
    sortie = _copter(A, _item(21, at=False, frame=3))
    assert len(sortie.legs) == 2
    assert (sortie.ending, sortie.ending_seq) == ("land", 3)


def test_px4_takes_0_0_for_a_place() -> None:
    with pytest.raises(MissionError, match=r"uav1: item 2 \(LAND\): expected a place within 200 km .* got 0.0, 0.0"):
        _px4(A, _item(21, at=False, frame=3))


def test_a_planes_landing_is_a_gap() -> None:
    sortie = _plane(A, _item(21, 400.0, 0.0, 0.0, frame=3))
    assert "approach, flare and go-around" in sortie.gaps[0].what
    assert sortie.ending == "land"


def test_what_comes_after_the_end() -> None:
    sortie = _copter(A, RTL, B, _item(177))
    assert sortie.gaps == ()
    assert "items 4 to 5 after RETURN_TO_LAUNCH are not flown" in sortie.notes
    assert len(sortie.legs) == 2
    again = _copter(A, _item(21, at=False), UP, B, RTL)
    assert _gaps(again) == ["4 TAKEOFF: may take off again after LAND"]


def test_missions_without_an_end() -> None:
    assert (_copter(A).ending, _copter(A).ending_seq) == ("loiter", 2)
    assert _px4(A).ending == "loiter"
    assert _plane(A).ending == "rtl"
    assert "no item ends the mission: ArduPlane returns home" in _plane(A).notes


# speeds


def test_speeds_apply_to_the_legs_after_them() -> None:
    sortie = _copter(_speed(4.0), A, _speed(6.0, 0.0), B, RTL)
    assert [leg.speed_m_s for leg in sortie.legs] == [10.0, 4.0, 6.0]
    assert [leg.speed_m_s for leg in _copter(A, RTL, speed_default_m_s=7.0).legs] == [7.0, 7.0]
    assert _px4(A, RTL).legs[1].speed_m_s == 5.0
    assert _plane(A, RTL).legs[1].speed_m_s == 22.0


@pytest.mark.parametrize("value", [0.0, -2.0, 0.1])
def test_arducopter_ignores_no_speed(value: float) -> None:
    sortie = _copter(_speed(4.0), A, _speed(value), B, RTL)
    assert [leg.speed_m_s for leg in sortie.legs[1:]] == [4.0, 4.0]
    assert sortie.gaps == ()
    assert any("ignores a speed" in note for note in sortie.notes)


def test_arducopters_rates_of_climb_and_descent() -> None:
    higher = replace(B, z=B.z + 30.0)
    sortie = _copter(A, _speed(1.0, 2.0), _speed(0.7, 3.0), higher, A, RTL)
    assert sortie.gaps == ()
    assert [leg.vertical_m_s for leg in sortie.legs[-2:]] == pytest.approx([1.0, 0.7])


def test_speeds_whose_effect_is_not_known() -> None:
    assert "before its first waypoint" in _copter(_speed(0.1), A, RTL).gaps[0].what
    assert "not known" in _copter(A, _speed(1.0, 4.0), B, RTL).gaps[0].what
    assert "climb or descent" in _copter(A, _speed(1e-9, 2.0), B, RTL).gaps[0].what
    assert "refuses" in _copter(A, _speed(math.nan), B, RTL).gaps[0].what
    assert "after a condition" in _copter(A, MissionItem(0, 2, 112, 5.0), _speed(3.0), B, RTL).gaps[0].what
    assert _copter(A, MissionItem(0, 2, 112, 5.0), B, _speed(3.0), RTL).gaps == ()
    assert "inf m/s" in _px4(A, _speed(math.inf), B, RTL).gaps[0].what


def test_px4_takes_its_default_for_no_speed_and_any_type() -> None:
    sortie = _px4(_speed(8.0, 3.0), A, _speed(0.0), B, RTL)
    assert [leg.speed_m_s for leg in sortie.legs] == [5.0, 8.0, 5.0]
    assert sortie.gaps == ()


def test_arduplane_flies_by_airspeed() -> None:
    def second(item: MissionItem) -> Sortie:
        return _plane(_speed(18.0, 0.0), A, item, B, RTL, airspeed_limits_m_s=(10.0, 30.0))

    assert [leg.speed_m_s for leg in second(_speed(25.0, 0.0)).legs[1:]] == [18.0, 25.0]
    assert second(_speed(-2.0, 0.0)).legs[2].speed_m_s == 22.0
    for ignored in (_speed(35.0, 0.0), _speed(15.0, 1.0), _speed(0.0, 0.0)):
        assert second(ignored).legs[2].speed_m_s == 18.0
        assert second(ignored).gaps == ()
        assert any(note.startswith("item 4: ArduPlane") for note in second(ignored).notes)
    assert "least ground speed" in second(_speed(25.0, 1.0)).gaps[0].what
    assert "throttle" in second(replace(_speed(35.0, 0.0), param3=80.0)).gaps[0].what
    assert _plane(A, _speed(35.0, 0.0), B, RTL).legs[2].speed_m_s == 22.0  # above AIRSPEED_MAX


def test_delays() -> None:
    ground = _read(HOME_ROW, MissionItem(0, 0, 93, 60.0), UP, A, RTL, start_delay_s=5.0)
    assert (ground.start_delay_s, ground.gaps) == (65.0, ())
    air = _copter(A, MissionItem(0, 2, 93, 2.5), B, RTL)
    assert [leg.hold_s for leg in air.legs] == [0.0, 2.5, 0.0]
    top = _copter(MissionItem(0, 2, 93, 4.0), A, RTL)
    assert [(leg.kind, leg.hold_s) for leg in top.legs] == [("takeoff", 0.0), ("straight", 4.0), ("straight", 0.0)]
    np.testing.assert_array_equal(top.legs[1].end_m, top.legs[0].end_m)
    assert "hour of the day" in _copter(A, MissionItem(0, 2, 93, 0.0, 12.0), B, RTL).gaps[0].what
    assert _plane(A, MissionItem(0, 2, 93, 9.0), B, RTL).legs[1].hold_s == 0.0  # ignored while armed
    assert _px4(A, MissionItem(0, 2, 93, 0.0, 12.0), B, RTL).gaps == ()


# everything else


@pytest.mark.parametrize("command", [80, 115, 181, 183, 195, 197, 201, 203, 205, 206, 530, 1000, 2000, 2500])
def test_harmless_commands(command: int) -> None:
    sortie = _copter(A, MissionItem(0, 2, command, 1.0, 2.0), B, RTL)
    assert sortie.gaps == ()
    assert len(sortie.legs) == 3


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (177, "DO_JUMP"),
        (179, "DO_SET_HOME"),
        (84, "VTOL_TAKEOFF"),
        (85, "VTOL_LAND"),
        (94, "PAYLOAD_PLACE"),
        (92, "GUIDED_ENABLE"),
        (189, "DO_LAND_START"),
        (30, "CONTINUE_AND_CHANGE_ALT"),
        (31, "LOITER_TO_ALT"),
        (32, "DO_FOLLOW"),
        (208, "DO_PARACHUTE"),
        (223, "DO_ENGINE_CONTROL"),
        (31_010, "command 31010"),
        (0, "command 0"),
    ],
)
def test_what_is_not_followed_is_named(command: int, name: str) -> None:
    for sortie in (_copter(A, MissionItem(0, 3, command), B, RTL), _px4(A, MissionItem(0, 3, command), B, RTL)):
        (gap,) = sortie.gaps
        assert gap.what.startswith(f"{name}: ")
        assert command_name(command) == name
        assert len(sortie.legs) == 3  # read on, for the map


def test_px4_starts_at_its_current_item_and_stops_without_autocontinue() -> None:
    assert _px4(replace(A, current=1), B, RTL).gaps[0].what.startswith("is the current item")
    assert "autocontinue" in _px4(replace(A, autocontinue=0), B, RTL).gaps[0].what
    assert _copter(replace(A, current=1, autocontinue=0), B, RTL).gaps == ()


@pytest.mark.parametrize(
    ("items", "says"),
    [
        ([], "uav1: expected a mission, got no items"),
        ([HOME_ROW], "uav1: expected at least one waypoint, got none in 1 items"),
        ([HOME_ROW, RTL], "uav1: expected at least one waypoint"),
        ([HOME_ROW, UP, replace(A, z=math.nan)], r"uav1: item 2 \(WAYPOINT\): expected a latitude, .* and nan"),
        ([HOME_ROW, UP, replace(A, z=math.inf)], r"item 2 \(WAYPOINT\): expected a latitude"),
        ([HOME_ROW, UP, replace(A, x=900_000_001)], r"item 2 \(WAYPOINT\): expected a latitude.* got 90.0000001"),
        ([HOME_ROW, UP, replace(A, y=-1_800_000_001)], r"item 2 \(WAYPOINT\)"),
        ([HOME_ROW, replace(UP, z=math.nan)], r"item 1 \(TAKEOFF\)"),
        ([HOME_ROW, UP, A, _item(21, at=False, z=math.nan)], r"item 3 \(LAND\)"),
        ([HOME_ROW, UP, replace(A, x=-353_000_000)], r"item 2 \(WAYPOINT\): expected a place within 200 km"),
        ([replace(HOME_ROW, x=910_000_000), UP, A], r"item 0 \(WAYPOINT\): expected a latitude"),
    ],
)
def test_what_is_no_mission_is_refused(items: list[MissionItem], says: str) -> None:
    with pytest.raises(MissionError, match=says):
        _read(*items)


def test_items_must_be_numbered() -> None:
    with pytest.raises(MissionError, match="uav1: expected item 1, got 0"):
        read_sortie(
            [HOME_ROW, UP],
            name="uav1",
            sysid=1,
            autopilot="ardupilot",
            vehicle_class="copter",
            frame=FRAME,
            home_m=HOME,
            motion=vehicle_plan().motion,
        )


def test_a_plan_is_read_with_its_own_motion() -> None:
    plan = replace(vehicle_plan(end="rtl"), motion=replace(vehicle_plan().motion, return_height_m=42.0))
    sortie = plan_sortie(plan, FRAME)
    assert sortie.return_height_m == 42.0
    np.testing.assert_allclose(sortie.legs[-1].end_m, plan.waypoints_m[-1], atol=0.01)


# the hash


def test_the_hash_tells_every_field() -> None:
    items = plan_items(vehicle_plan(autopilot="px4"), FRAME)
    whole = items_sha256(items)
    assert whole == items_sha256(list(items))
    assert len(whole) == 64
    changes: dict[str, Any] = {"seq": 9, "frame": 3, "command": 17, "current": 1, "autocontinue": 0, "x": 1, "y": 2}
    changes |= {"z": 1244.0, "param1": 1.0, "param2": 3.0, "param3": 1.0, "param4": 0.0}
    others = {
        items_sha256([*items[:3], replace(items[3], **{name: value}), *items[4:]]) for name, value in changes.items()
    }
    assert len(others | {whole, items_sha256(items[:-1]), items_sha256(items[::-1])}) == len(changes) + 3


def test_the_hash_knows_one_nan_and_single_precision() -> None:
    nan = float(np.frombuffer(np.uint32(0xFFC0_1234).tobytes(), dtype=np.float32)[0])
    assert items_sha256([MissionItem(0, 0, 16, param4=nan)]) == items_sha256([MissionItem(0, 0, 16, param4=math.nan)])
    assert items_sha256([MissionItem(0, 0, 16, z=0.1)]) == items_sha256(
        [MissionItem(0, 0, 16, z=float(np.float32(0.1)))]
    )
    # the layout is what certificates on disk rest on: seq, frame, command, current, autocontinue, x, y, z, params
    wire = "0100 03 1600 01 01 80eb7a14 c0298fb9 0000f041 00007041 00000000 00000000 0000c07f"
    item = MissionItem(1, 3, 22, 15.0, 0.0, 0.0, math.nan, 343_600_000, -1_181_800_000, 30.0, current=1)
    assert items_sha256([item]) == hashlib.sha256(bytes.fromhex(wire)).hexdigest()


def test_the_hash_refuses_what_no_wire_carries() -> None:
    with pytest.raises(MissionError, match="mission item 0: expected numbers that fit"):
        items_sha256([MissionItem(0, 0, 16, x=2**31)])


# files


def _sample(name: str, autopilot: Autopilot) -> Sortie:
    path = next(SAMPLES.glob(f"*/{name}*"), None)
    if path is None:
        pytest.skip("real sample files are not at hand")
    items, home = read_mission_file(path, autopilot)
    if home is None:
        return _read(*items, autopilot=autopilot)
    frame = LocalFrame(home.lat_deg, home.lon_deg)
    return read_sortie(
        items,
        name=path.name,
        sysid=1,
        autopilot=autopilot,
        vehicle_class="copter",
        frame=frame,
        home_m=frame.to_local(home.lat_deg, home.lon_deg, home.alt_amsl_m),
        motion=vehicle_plan(autopilot=autopilot).motion,
    )


@pytest.mark.parametrize(
    ("name", "autopilot", "legs", "ending", "gap"),
    [
        ("mavsdk_qgroundcontrol_sample.plan", "px4", 4, "rtl", None),
        ("mavsdk_qgroundcontrol_sample_with_survey.plan", "px4", 9, "loiter", None),
        ("ardupilot_DO_CHANGE_SPEED_mission.txt", "ardupilot", 5, "rtl", None),
        ("ardupilot_NavDelayTakeoffAbsTime.txt", "ardupilot", 1, "rtl", None),
        ("dronekit_mpmission.txt", "ardupilot", 6, "loiter", "not above home at 584.0 m"),
        ("qgc_MissionPlanner.waypoints", "ardupilot", 6, "loiter", "Missing Takeoff Cmd"),
        ("qgc_MissionPlanner.waypoints", "px4", 6, "loiter", None),
    ],
)
def test_real_files_are_read(name: str, autopilot: Autopilot, legs: int, ending: str, gap: str | None) -> None:
    sortie = _sample(name, autopilot)
    assert (len(sortie.legs), sortie.ending) == (legs, ending)
    assert (sortie.gaps == ()) == (gap is None)
    assert gap is None or gap in sortie.gaps[0].what


@pytest.mark.parametrize(
    ("name", "autopilot", "says"),
    [
        ("mavsdk_qgroundcontrol_sample.plan", "ardupilot", "expected a plan for ardupilot, got one for px4"),
        ("mavsdk_qgroundcontrol_sample_with_digicam_control.plan", "ardupilot", "expected at least one waypoint"),
        ("mavsdk_qgroundcontrol_sample_with_structured_scan.plan", "px4", "StructureScan"),
        ("mavsdk_qgroundcontrol_sample_with_survey_missing_items.plan", "px4", "Items: expected a list"),
        ("mavsdk_qgroundcontrol_sample_without_mission.plan", "px4", "mission: expected an object"),
        ("mavsdk_qgroundcontrol_sample_wrong_mission_version.plan", "px4", "mission.version: expected 2, got 7"),
        ("mavsdk_qgroundcontrol_sample_wrong_overall_version.plan", "px4", "version: expected 1, got 42"),
        ("qgc_TerrainTest-ArduCopter.plan", "ardupilot", r"items\[5\].params: .*open the plan there and save it"),
        ("mavsdk_mission_planner_sample.txt", "px4", r"expected home in row 0 \(command 16\), got command 22"),
        ("mavsdk_mission_planner_sample.txt", "ardupilot", "expected a place within 200 km"),
        ("ardupilot_copter_terrain_mission.txt", "ardupilot", r"item 2 \(WAYPOINT\): expected a place within 200 km"),
    ],
)
def test_real_files_are_refused(name: str, autopilot: Autopilot, says: str) -> None:
    with pytest.raises(MissionError, match=says) as error:
        _sample(name, autopilot)
    assert "\n" not in str(error.value)


def test_every_sample_is_named_here() -> None:
    if not SAMPLES.exists():
        pytest.skip("real sample files are not at hand")
    tested = {
        case.values[0] if hasattr(case, "values") else case[0]
        for test in (test_real_files_are_read, test_real_files_are_refused)
        for mark in test.pytestmark  # type: ignore[attr-defined]
        for case in mark.args[1]
    }
    assert {path.name for path in SAMPLES.glob("*/*")} == tested


def test_a_file_is_what_is_in_it(tmp_path: Path) -> None:
    vehicle = vehicle_plan(autopilot="px4")
    items = plan_items(vehicle, FRAME)
    path = tmp_path / "mission.plan"  # a lie
    path.write_bytes(b"\xef\xbb\xbf" + waypoints_text(items, "px4", FRAME.geo_point(vehicle.home_m)).encode())
    back, home = read_mission_file(path, "px4")
    assert back == items
    assert home is not None
    assert (home.lat_deg, home.lon_deg, home.alt_amsl_m) == (34.36, -118.18, 1200.0)
    assert mission_file_notes(path) == ()
    path.write_text("<kml/>")
    with pytest.raises(
        MissionError, match=r"expected a QGroundControl plan \(JSON\) or a QGC WPL 110 file, got neither"
    ):
        read_mission_file(path, "px4")
    with pytest.raises(MissionError, match="expected a readable mission file"):
        read_mission_file(tmp_path / "nowhere.plan", "px4")


def test_heights_above_terrain_in_a_plan(tmp_path: Path) -> None:
    def plan(mode: int, frame: int, z: float | None) -> Path:
        items = [
            {"type": "SimpleItem", "command": 22, "frame": 3, "params": [0, 0, 0, None, 34.36, -118.18, 30]},
            {
                "type": "SimpleItem",
                "command": 16,
                "frame": frame,
                "params": [0, 0, 0, None, 34.361, -118.18, z],
                "AltitudeMode": mode,
                "Altitude": 50,
                "AMSLAltAboveTerrain": z,
            },
        ]
        mission = {"version": 2, "firmwareType": 3, "plannedHomePosition": [34.36, -118.18, 1200], "items": items}
        path = tmp_path / "terrain.plan"
        fence = {"version": 2, "circles": [{}], "polygons": [{}]}
        rally = {"version": 2, "points": [[34.36, -118.18, 30]]}
        whole = {"fileType": "Plan", "version": 1, "mission": mission, "geoFence": fence, "rallyPoints": rally}
        path.write_text(json.dumps(whole))
        return path

    calculated, _ = read_mission_file(plan(3, 0, 1262.5), "ardupilot")
    assert _read(*calculated).legs[1].end_m[2] == 1262.5
    assert mission_file_notes(plan(3, 0, 1262.5)) == (
        "terrain.plan: 2 geofence items not checked: the vehicle may obey what is not proven",
        "terrain.plan: 1 rally point not checked: the vehicle may obey what is not proven",
    )
    followed, _ = read_mission_file(plan(4, 10, 50.0), "ardupilot")
    assert "height above the terrain" in _read(*followed).gaps[0].what
    with pytest.raises(MissionError, match="open the plan there and save it again"):
        read_mission_file(plan(3, 0, None), "ardupilot")


# recorded flights: speeds as the autopilot took them


@pytest.mark.parametrize("name", flights.names() or ["none"])
def test_recorded_missions_read_as_they_were_flown(name: str) -> None:
    if name == "none":
        pytest.skip("recorded flights are not at hand")
    flight = flights.read(name)
    autopilot: Autopilot = "px4" if flight.kind == "px4" else "ardupilot"
    vehicle_class: VehicleClass = "plane" if flight.kind == "plane" else "copter"
    items, home = read_mission_file(flights.FOLDER / f"{name}.waypoints", autopilot)
    assert home is not None
    frame = LocalFrame(home.lat_deg, home.lon_deg)
    sortie = read_sortie(
        items,
        name=name,
        sysid=1,
        autopilot=autopilot,
        vehicle_class=vehicle_class,
        frame=frame,
        home_m=frame.to_local(home.lat_deg, home.lon_deg, home.alt_amsl_m),
        motion=vehicle_plan(autopilot=autopilot, vehicle_class=vehicle_class).motion,
        airspeed_limits_m_s=(10.0, 30.0),
    )
    legs = sortie.legs[1 : 1 + len(flight.waypoints_m)]
    ends = np.stack([leg.end_m for leg in legs])
    np.testing.assert_allclose(ends[:, 2], flight.waypoints_m[:, 2], atol=1e-3)
    np.testing.assert_allclose(ends[:, :2], flight.waypoints_m[:, :2], rtol=5e-3, atol=0.5)
    np.testing.assert_allclose([leg.speed_m_s for leg in legs], flight.speed_m_s, rtol=1e-6)
    np.testing.assert_array_equal([leg.hold_s for leg in legs], flight.hold_s)
    assert {leg.kind for leg in legs} == {"spline" if flight.splines else "straight"}
