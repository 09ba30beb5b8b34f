"""What vehicles do besides flying: from stops to plans, missions, files, simulated flights, and back."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.certificates import certify_plan
from adapters.mission_items import MissionItem, goal_seq, item_waypoints, items_sha256, plan_items
from adapters.mission_protocol import mismatches
from adapters.plan_file import PlanFile, plan_text, read_plan
from adapters.resuming import flown_items
from adapters.sorties import plan_sortie
from adapters.waypoints_file import read_waypoints, waypoints_text
from missionplanner import proof
from missionplanner.errors import MissionError
from missionplanner.plan import PHOTO_S, Action, FleetPlan, VehiclePlan
from missionplanner.plan_folder import PLAN_NAME, load_plan, save_plan
from missionplanner.planner import plan_fleet
from missionplanner.resuming import resume
from missionplanner.scene import Scene
from missionplanner.vehicle import Autopilot
from sim.personality import personality
from tests.plans import FRAME, vehicle_plan
from tests.scenes import at, copter, question, scene_of
from tests.simulated import LAT, LON, Ground, mission, of_type, renumbered

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
WAYPOINT, DELAY, ROI, ROI_NONE, DISTANCE, PHOTO = 16, 93, 195, 197, 206, 2000
TOWER = at(150, 30, agl=30)
VIEW = {"name": "T1.left", "inspects": "T1", "hold_s": 3, "photos": 2, "look_at": TOWER}
STOPS = [
    at(100, 0, agl=40) | VIEW,
    at(200, 0, agl=40) | {"name": "T1.by", "photos": 1, "look_at": TOWER},
    at(260, 60, agl=40) | {"photo_every_m": 15, "look": {"heading_deg": 45, "pitch_deg": -20}},
    at(260, 120, agl=40),
]


def planned(*vehicles: dict[str, Any], **changes: Any) -> tuple[Scene, FleetPlan]:
    scene = scene_of(question(*vehicles, **changes))
    return scene, plan_fleet(scene)


@pytest.fixture(scope="module")
def small() -> tuple[Scene, FleetPlan]:
    """A copter that looks, stands and takes photos; and one that has nothing to do."""
    alpha = copter("alpha", (0, 0), (200, 200), stops=STOPS)
    return planned(alpha, copter("bravo", (0, -90), (300, -90), autopilot="px4"))


# --- missions: an interpreter of its own does what autopilots do, one item after the other


def done_by(items: list[MissionItem]) -> list[tuple[Any, float, float, float]]:
    """Return at each waypoint flown to: what was aimed at and triggered on the way, the stand, the photos there."""
    done: list[tuple[Any, float, float, float]] = []
    aim: Any = None
    every_m = stand_s = photos = 0.0
    on_the_way: tuple[Any, float] | None = None
    for item in items:
        if item.command == WAYPOINT:
            if on_the_way is not None:
                done.append((*on_the_way, stand_s, photos))
            on_the_way, stand_s, photos = (aim, every_m), item.param1, 0.0
        elif item.command == ROI:
            assert (item.x, item.y, item.z) != aim, "aimed twice"
            aim = (item.x, item.y, item.z)
        elif item.command == ROI_NONE:
            assert aim is not None, "released twice"
            aim = None
        elif item.command == DISTANCE:
            assert item.param1 != every_m, "triggered twice"
            every_m = item.param1
        elif item.command == PHOTO:
            photos += item.param3
        elif item.command == DELAY:
            stand_s += item.param1
    assert on_the_way is not None
    return [*done, (*on_the_way, stand_s, photos)]


aims = st.one_of(st.none(), st.sampled_from([(0.0, 50.0, 1240.0), (10.0, 50.0, 1240.0)]), st.just("look"))
actions = st.builds(
    lambda hold_s, photos, every_m, aim: Action(
        hold_s=hold_s,
        photos=photos,
        photo_every_m=every_m,
        look_at_m=aim if isinstance(aim, tuple) else None,
        look_deg=(300.0, -15.0) if aim == "look" else None,
    ),
    st.sampled_from([0.0, 3.0]),
    st.integers(0, 3),
    st.sampled_from([0.0, 8.0, 12.0]),
    aims,
)


@st.composite
def acting(draw: st.DrawFn) -> VehiclePlan:
    """Return a vehicle with waypoints of which some are stops, which all have actions, as the last has."""
    count = draw(st.integers(2, 6))
    points = [(0.0, 0.0, 1230.0), *((60.0 * k, 30.0 * (-1) ** k, 1240.0 + k) for k in range(1, count + 1))]
    stops = sorted({*draw(st.sets(st.integers(1, count))), count})
    plan = vehicle_plan(autopilot=draw(st.sampled_from(["ardupilot", "px4"])), waypoints_m=points)
    done = {k: draw(actions) for k in stops}
    hold_s = np.array([done[k].stand_s if k in done else 0.0 for k in range(1, count + 1)])
    speeds = np.array([draw(st.sampled_from([7.3, 5.0])) for _ in range(count)])
    return replace(
        plan, actions=done, hold_s=hold_s + draw(st.sampled_from([0.0, 4.0])) * (hold_s > 0), speeds_m_s=speeds
    )


@given(acting())
@settings(max_examples=150, deadline=None)
def test_missions_say_what_the_plan_says(vehicle: VehiclePlan) -> None:
    items = list(plan_items(vehicle, FRAME))
    done = done_by(items[1:] if vehicle.autopilot == "ardupilot" else items)
    for k, (aim, every_m, stand_s, photos) in enumerate(done, start=1):
        governing = vehicle.actions[min(end for end in vehicle.actions if end >= k)]
        assert (aim is not None) == (governing.look_at_m is not None or governing.look_deg is not None)
        assert every_m == governing.photo_every_m
        assert stand_s == vehicle.hold_s[k - 1]
        assert photos == (vehicle.actions[k].photos if k in vehicle.actions else 0)
        if governing.look_at_m is not None:
            place_m = FRAME.to_local(aim[0] / 1e7, aim[1] / 1e7, aim[2])
            np.testing.assert_allclose(place_m, governing.look_at_m, atol=0.02)
    for photo, after in pairwise(items):
        standing = any(v > 0.0 for v in vehicle.hold_s) and photo.command == PHOTO and photo.param3 == 1.0
        if standing and after.command == DELAY:
            assert after.param1 == PHOTO_S


@given(acting())
@settings(max_examples=60, deadline=None)
def test_missions_read_back_are_proven_as_the_same(vehicle: VehiclePlan) -> None:
    read, told = plan_sortie(vehicle, FRAME), proof.planned_sortie(Framed(), vehicle)  # type: ignore[arg-type]
    assert read.gaps == ()
    assert [(leg.seq, leg.hold_s, leg.speed_m_s) for leg in read.legs[1:]] == [
        (leg.seq, leg.hold_s, leg.speed_m_s) for leg in told.legs[1:]
    ]
    assert read.ending_seq == told.ending_seq
    items = plan_items(vehicle, FRAME)
    assert goal_seq(items) == read.legs[-1].seq
    assert flown_items(items, vehicle.autopilot) == [leg.seq for leg in read.legs]
    assert len(item_waypoints(items, vehicle.autopilot, FRAME)) == len(vehicle.waypoints_m)


class Framed:
    """All of a scene that a sortie needs."""

    frame = FRAME


@given(acting())
@settings(max_examples=30, deadline=None)
def test_files_and_vehicles_hold_them_unchanged(tmp_path_factory: pytest.TempPathFactory, vehicle: VehiclePlan) -> None:
    folder, items, home = tmp_path_factory.mktemp("m"), plan_items(vehicle, FRAME), FRAME.geo_point(vehicle.home_m)
    (folder / "m.plan").write_text(plan_text(PlanFile(vehicle.autopilot, home, items), "copter"))
    (folder / "m.waypoints").write_text(waypoints_text(items, vehicle.autopilot, home))
    sent = items_sha256(items)
    assert items_sha256(read_plan(folder / "m.plan").items) == sent
    assert items_sha256(read_waypoints(folder / "m.waypoints", vehicle.autopilot)) == sent
    one = personality(vehicle.autopilot, "copter")
    held = [replace(one.stored(item), seq=item.seq, frame=one.frame_read(one.stored(item).frame)) for item in items]
    assert all(one.check(item) == mavlink.MAV_MISSION_ACCEPTED for item in items)
    assert mismatches(items, held, vehicle.autopilot) == []


@pytest.mark.parametrize("heading_deg", [0.0, 135.0, 290.0])
@pytest.mark.parametrize("pitch_deg", [-90.0, -30.0, 10.0])
def test_a_direction_is_kept_within_a_degree_on_the_way(heading_deg: float, pitch_deg: float) -> None:
    along = Action(look_deg=(heading_deg, pitch_deg), photo_every_m=20.0)
    vehicle = replace(vehicle_plan(), actions={2: along}, waypoints_m=vehicle_plan().waypoints_m * 1.2)
    (aim,) = [step.at_m for before, _ in vehicle.steps() for step in before if step.what == "aim"]
    assert aim is not None
    begin_m, end_m = vehicle.waypoints_m[[0, 2]]
    assert 280.0 < np.linalg.norm(end_m - begin_m) < 320.0
    heading, pitch = np.radians([heading_deg, pitch_deg])
    asked = np.array([np.cos(pitch) * np.sin(heading), np.cos(pitch) * np.cos(heading), np.sin(pitch)])
    for share in np.linspace(0.0, 1.0, 5):
        toward = np.array(aim) - (begin_m + share * (end_m - begin_m))
        assert np.degrees(np.arccos(np.clip(toward @ asked / np.linalg.norm(toward), -1.0, 1.0))) < 1.0


@pytest.mark.parametrize(
    ("item", "changed"),
    [
        (MissionItem(0, 2, DISTANCE, 25.0, 0.0, 1.0), {"param3": 0.0}),
        (MissionItem(0, 2, PHOTO, 0.0, 0.0, 2.0), {"param3": 1.0}),
        (MissionItem(0, 0, ROI, x=LAT, y=LON, z=600.0), {"z": 601.0}),
        (MissionItem(0, 2, 1000, -30.0, 90.0, x=16), {"x": 0}),
        (MissionItem(0, 2, 203, x=1), {"x": 0}),
        (MissionItem(0, 2, DELAY, 2.0), {"param1": 1.0}),
    ],
)
@BOTH
def test_a_camera_that_would_do_something_else_is_noticed(
    autopilot: Autopilot, item: MissionItem, changed: dict[str, Any]
) -> None:
    stored = personality(autopilot, "copter").stored
    first = MissionItem(0, 0, WAYPOINT, x=LAT, y=LON, z=600.0)
    sent = [first, replace(item, seq=1)]
    assert mismatches(sent, [first, stored(sent[1])], autopilot) == []
    (found,) = mismatches(sent, [first, replace(stored(sent[1]), **changed)], autopilot)
    assert found.field == next(iter(changed))


# --- plans


def test_stops_stand_and_the_rest_is_flown_through(small: tuple[Scene, FleetPlan]) -> None:
    scene, plan = small
    alpha = plan.vehicles[0]
    stops = [k for k, action in alpha.actions.items() if action != Action()]
    assert [alpha.actions[k].name for k in stops] == ["T1.left", "T1.by", ""]
    assert alpha.hold_s[stops[0] - 1] == 3.0 + 2 * PHOTO_S
    assert alpha.hold_s.sum() == alpha.hold_s[stops[0] - 1]
    reached_s = alpha.reached_s[stops[0]]
    still = alpha.trajectory.at(np.array([reached_s + 3.0, reached_s + 5.0]))
    assert np.linalg.norm(still[1] - still[0]) < 0.3
    assert plan.vehicles[1].actions == {}
    assert plan.arrival_s is not None
    assert [v.arrival_s for v in plan.vehicles] == pytest.approx([plan.arrival_s] * 2, abs=0.1)
    assert certify_plan(scene, plan).proven


def test_a_loaded_plan_does_the_same(small: tuple[Scene, FleetPlan], tmp_path: Path) -> None:
    save_plan(tmp_path, *small)
    _, loaded = load_plan(tmp_path)
    for before, after in zip(small[1].vehicles, loaded.vehicles, strict=True):
        assert before.actions == after.actions
        np.testing.assert_array_equal(before.trajectory.position_m, after.trajectory.position_m)
        assert plan_items(before, small[1].frame) == plan_items(after, loaded.frame)
    document = json.loads((tmp_path / PLAN_NAME).read_text())
    told = [w for w in document["vehicles"][0]["waypoints"] if w.get("name") == "T1.left"]
    assert [(w["inspects"], w["photos"], sorted(w["look_at"])) for w in told] == [
        ("T1", 2, ["alt_amsl_m", "lat_deg", "lon_deg"])
    ]


@pytest.mark.parametrize(("hold_s", "says"), [(4.0, "to be held for at least 5 s, got 4"), (6.0, "")])
def test_holds_may_not_be_cut_short(small: tuple[Scene, FleetPlan], tmp_path: Path, hold_s: float, says: str) -> None:
    save_plan(tmp_path, *small)
    document = json.loads((tmp_path / PLAN_NAME).read_text())
    held = next(w for w in document["vehicles"][0]["waypoints"] if w.get("hold_s", 0.0) > 0.0)
    held["hold_s"] = hold_s
    (tmp_path / PLAN_NAME).write_text(json.dumps(document))
    if says:
        with pytest.raises(MissionError, match=says):
            load_plan(tmp_path)
    else:
        assert load_plan(tmp_path)[1].vehicles[0].hold_s.max() == hold_s


def test_waiting_for_a_meeting_comes_on_top() -> None:
    alpha = copter("alpha", (0, 0), (300, 0), stops=[at(60, 0, agl=40) | {"hold_s": 3}, at(120, 0, agl=40)])
    bravo = copter("bravo", (0, 200), (300, 200), stops=[at(0, 900, agl=40), at(120, 200, agl=40)])
    meeting = {
        "rendezvous": [
            {"name": "first", "at": {"alpha": 1, "bravo": 0}},
            {"name": "there", "at": {"alpha": 2, "bravo": 2}},
        ]
    }
    _, plan = planned(alpha, bravo, fleet=meeting)
    held_s = plan.vehicles[0].hold_s.max()
    assert held_s > 30.0
    items = plan_items(plan.vehicles[0], plan.frame)
    assert held_s in [item.param1 for item in items if item.command == WAYPOINT]


def test_of_two_who_stand_too_close_one_comes_later() -> None:
    stands = [
        [at(-sign * 150, 200, agl=50), at(-sign * 8, 200, agl=50) | {"hold_s": 20}, at(-sign * 150, 300, agl=50)]
        for sign in (1, -1)
    ]
    alpha = copter("alpha", (-200, 0), (-200, 400), stops=stands[0])
    bravo = copter("bravo", (200, 0), (200, 400), stops=stands[1])
    for together in (True, False):
        _, plan = planned(alpha, bravo, fleet={"arrive_together": together, "direct_return": "waived"})
        t_s = np.arange(0.0, max(v.trajectory.t_s[-1] for v in plan.vehicles), 0.1)
        one, other = (vehicle.trajectory.at(t_s) for vehicle in plan.vehicles)
        assert np.linalg.norm(one - other, axis=1).min() > 26.0
        assert [r.how for r in plan.resolutions] == ["speed"]


@pytest.mark.parametrize("waypoint", [1, 2, 3])
def test_who_resumes_looks_and_shoots_again(small: tuple[Scene, FleetPlan], waypoint: int) -> None:
    scene, plan = small
    alpha = plan.vehicles[0]
    _, rest = resume(scene, plan, Path(), "alpha", waypoint)
    again = rest.vehicles[0]
    first = len(again.waypoints_m) - len(alpha.waypoints_m) + waypoint  # of the rest among its waypoints
    before, after = (done_by([item for item in plan_items(v, plan.frame) if item.seq > 0]) for v in (alpha, again))
    same = [(aim is not None, stand_s, photos) for aim, _, stand_s, photos in before[waypoint - 1 :]]
    assert [(aim is not None, stand_s, photos) for aim, _, stand_s, photos in after[first - 1 :]] == same
    assert [every for _, every, _, _ in after[first:]] == [every for _, every, _, _ in before[waypoint:]]
    assert all(every == 0.0 for _, every, _, _ in after[:first])  # not on the way back


# --- simulated vehicles


def photographing(autopilot: Autopilot, *after_first: tuple[Any, ...]) -> list[MissionItem]:
    """Return a mission with camera items behind its first waypoint."""
    *begin, last, end = mission(autopilot)
    return renumbered([*begin, *(MissionItem(0, 2, *row) for row in after_first), last, end])


@BOTH
@pytest.mark.parametrize(
    ("rows", "count"),
    [
        ([(PHOTO, 0.0, 0.0, 1.0), (DELAY, 1.0), (PHOTO, 0.0, 0.0, 1.0)], 2),
        ([(PHOTO, 0.0, 1.0, 3.0), (DELAY, 5.0)], 3),
        ([(DISTANCE, 11.0, 0.0, 1.0)], 6),  # at once, and after 11, ..., 55 of 60 m
        ([(DISTANCE, 10.0, 0.0, 1.0), (DISTANCE, 0.0)], 1),
        ([(PHOTO, 0.0, 1.0, 0.0), (DELAY, 3.5), (2001,)], 4),
        ([(ROI_NONE,)], 0),
    ],
)
def test_vehicles_take_the_photos_of_their_missions(
    autopilot: Autopilot, rows: list[tuple[Any, ...]], count: int
) -> None:
    plain, ground = Ground(autopilot), Ground(autopilot)
    for vehicle, items in ((plain, mission(autopilot)), (ground, photographing(autopilot, *rows))):
        assert vehicle.upload(items) == mavlink.MAV_MISSION_ACCEPTED
        if autopilot == "ardupilot":
            vehicle.mode("GUIDED")
            vehicle.arm()
        vehicle.start()
        vehicle.fly_mission()
    kind = "CAMERA_FEEDBACK" if autopilot == "ardupilot" else "CAMERA_IMAGE_CAPTURED"
    taken = of_type(ground.heard, kind)
    assert len(taken) == count
    assert of_type(plain.heard, kind) == []
    numbers = [m.img_idx - 1 if autopilot == "ardupilot" else m.image_index for m in taken]
    assert numbers == list(range(count))
    for photo in taken:
        north_m, east_m = (
            (photo.lat - LAT) * 0.0111,
            ((photo.lng if autopilot == "ardupilot" else photo.lon) - LON) * 0.0092,
        )
        assert 55.0 < north_m < 65.0
        assert -1.0 < east_m < 61.0
