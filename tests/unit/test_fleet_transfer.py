"""Who a vehicle is, what it guards by itself, what it held before: all before anything is armed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from adapters.backup import Saved, read_backup, restore, write_backup
from adapters.endpoint import Peer, in_process_pair
from adapters.fleet_link import FleetLink, download_missions
from adapters.guards import Area, area_items
from adapters.mission_items import MissionItem
from adapters.mission_protocol import OWN_COMPONENT
from adapters.plan_file import read_plan
from adapters.waypoints_file import read_waypoints
from missionplanner.errors import LinkError, MissionError
from missionplanner.mission import Fence, Fleet, NoFly, Place, RallyPoint
from missionplanner.plan import FleetPlan
from missionplanner.vehicle import Autopilot
from sim.faults import Faults, FaultyEndpoint
from sim.fleet import LockstepClock, SimFleet, planned_vehicles
from tests.plans import FRAME, small_fleet
from tests.rig import MeddledEndpoint, Merged, Rig, together

FENCE, RALLY = mavlink.MAV_MISSION_TYPE_FENCE, mavlink.MAV_MISSION_TYPE_RALLY


def box(west: float, south: float, east: float, north: float) -> tuple[Place, ...]:
    return tuple(Place(x_m=x, y_m=y) for x, y in ((west, south), (east, south), (east, north), (west, north)))


def with_mission(plan: FleetPlan, **changes: Any) -> FleetPlan:
    return replace(plan, mission=plan.mission.model_copy(update=changes))


def bound(plan: FleetPlan, **changes: Any) -> FleetPlan:
    """Return a plan whose first vehicle's part of the mission file says more."""
    first, *others = plan.mission.vehicles
    return with_mission(plan, vehicles=(first.model_copy(update=changes), *others))


def polygon(*corners_m: tuple[float, float], inclusion: bool) -> tuple[MissionItem, ...]:
    places = [FRAME.geo_point([x, y, 0.0]) for x, y in corners_m]
    return area_items([Area(inclusion, tuple((round(p.lat_deg * 1e7), round(p.lon_deg * 1e7)) for p in places))])


def hold(rig: Rig, vehicle: int, items: tuple[MissionItem, ...], kind: int) -> None:
    """Let a simulated vehicle hold a fence or rally points, as if another ground station had sent them."""
    rig.sim.links[vehicle].missions._stores[kind] = list(items)  # type: ignore[index]


@pytest.mark.parametrize("uid", ["0000000000000001", None])
def test_the_bound_autopilot_gets_its_mission(uid: str | None) -> None:
    rig = Rig(bound(small_fleet("ardupilot", 2), uid=uid))
    rig.upload()
    assert set(rig.link.held) == {1, 2}


def test_any_other_autopilot_is_refused_before_anything_is_sent() -> None:
    rig = Rig(bound(small_fleet("px4", 2), uid="0000000000000007"))
    with pytest.raises(LinkError, match=r"uav1 \(sysid 1\): expected the autopilot with uid 0+7, got 0+1: the wrong"):
        rig.link.connect()
    assert all(not link.missions.items() for link in rig.sim.links)


def test_an_autopilot_that_does_not_tell_who_it_is_is_not_the_bound_one() -> None:
    rig = Rig(bound(small_fleet("ardupilot", 1), uid="0000000000000001"))
    rig.pipes[0].down = lambda m: None if m.get_type() == "AUTOPILOT_VERSION" else m
    with pytest.raises(LinkError, match=r"expected the autopilot with uid 0+1, got none"):
        rig.link.connect()


def twins(edit: Callable[[Any], Any]) -> FleetLink:
    """Return a station that hears two vehicles of one sysid from one address; ``edit`` changes what the second says."""
    plan = small_fleet("ardupilot", 1)
    sims = [SimFleet(planned_vehicles(plan), frame=plan.frame) for _ in range(2)]
    (ground1, air1), (ground2, air2) = in_process_pair(), in_process_pair()
    sims[0].attach(air1)
    sims[1].attach(air2)
    clock = LockstepClock(sims[0])
    together(clock, *sims)
    return FleetLink(plan, [Merged(ground1, MeddledEndpoint(ground2, edit))], clock)


def test_two_autopilots_behind_one_address_are_known_by_their_ids() -> None:
    def another(message: Any) -> Any:
        if message.get_type() == "AUTOPILOT_VERSION":
            message.uid = 0xABC
        return message

    with pytest.raises(LinkError, match=r"uav1 .*: expected one autopilot, got answers of two \(0+1 and 0+abc\): give"):
        twins(another).connect()


def test_two_autopilots_behind_one_address_are_known_by_their_clocks() -> None:
    def older(message: Any) -> Any:
        if hasattr(message, "time_boot_ms"):
            message.time_boot_ms += 3_600_000
        return message

    with pytest.raises(LinkError, match="expected one autopilot, heard two by turns"):
        twins(older).connect()


def test_one_restart_is_no_second_autopilot() -> None:
    rig = Rig(small_fleet("ardupilot", 1))

    def restarted(message: Any) -> Any:
        if hasattr(message, "time_boot_ms") and rig.sim.now_s < 1.0:
            message.time_boot_ms += 3_600_000
        return message

    rig.pipes[0].down = restarted
    rig.link.connect()


def guarded(autopilot: Autopilot) -> FleetPlan:
    plan = small_fleet(autopilot, 2)
    areas = tuple(
        NoFly(kind="no_fly", name=name, polygon=area)
        for name, area in (("far", box(300, 0, 350, 60)), ("under", box(60, 30, 100, 50)))
    )
    plan = with_mission(plan, fence=Fence(polygon=box(-50, -50, 400, 200)), obstacles=areas)
    return bound(plan, rally=(RallyPoint(x_m=-20.0, y_m=40.0, height_above_home_m=31.0),))


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_fences_and_rally_points_are_sent_and_read_back(autopilot: Autopilot, loss: float) -> None:
    rig = Rig(guarded(autopilot))
    rig.lose(loss, seed=3)
    rig.upload()
    told = rig.link.send_guards()
    assert told == ("uav1 is not sent no-fly area under: its mission crosses it, and its fence knows no heights",)
    assert [len(link.missions.items(FENCE)) for link in rig.sim.links] == [8, 12]
    assert [len(link.missions.items(RALLY)) for link in rig.sim.links] == [1, 0]
    rig.link.set_returns()  # accepts the mission's own rally points
    assert rig.link.send_guards() == told  # again: nothing is replaced


def test_a_fence_that_is_replaced_is_told() -> None:
    rig = Rig(guarded("ardupilot"))
    hold(rig, 1, polygon((0, 0), (10, 0), (0, 10), inclusion=False), FENCE)
    rig.upload()
    assert "uav2: its fence of 3 items was replaced" in rig.link.send_guards()


def test_own_fences_that_do_not_matter_may_stay_and_others_are_refused() -> None:
    rig = Rig(small_fleet("px4", 2))
    hold(rig, 0, polygon((500, 0), (510, 0), (500, 10), inclusion=False), FENCE)
    rig.upload()
    assert rig.link.send_guards() == ()
    hold(rig, 1, polygon((70, 70), (90, 70), (80, 90), inclusion=False), FENCE)
    with pytest.raises(
        LinkError, match=r"uav2 .*holds a fence that would end its mission: exclusion polygon of 3 corners "
    ):
        rig.link.send_guards()


def test_rally_points_of_others_are_refused() -> None:
    rig = Rig(small_fleet("ardupilot", 1))
    hold(rig, 0, (MissionItem(0, 3, mavlink.MAV_CMD_NAV_RALLY_POINT, x=1, y=2, z=30.0),), RALLY)
    rig.upload()
    with pytest.raises(LinkError, match="holds 1 rally points, to which it would return instead of its home"):
        rig.link.set_returns()


@pytest.mark.parametrize(
    ("autopilot", "parameters", "told"),
    [
        ("ardupilot", {"FENCE_ENABLE": 0, "FENCE_TYPE": 7, "FENCE_ALT_MAX": 5.0, "FENCE_RADIUS": 5.0}, None),
        ("ardupilot", {"FENCE_ENABLE": 1, "FENCE_TYPE": 4, "FENCE_ALT_MAX": 5.0, "FENCE_RADIUS": 5.0}, None),
        ("ardupilot", {"FENCE_ENABLE": 1, "FENCE_TYPE": 7, "FENCE_ALT_MAX": 100.0, "FENCE_RADIUS": 300.0}, None),
        (
            "ardupilot",
            {"FENCE_ENABLE": 1, "FENCE_TYPE": 7, "FENCE_ALT_MAX": 30.0, "FENCE_RADIUS": 300.0},
            r"it flies 35 m above home, at most 30 m are allowed \(FENCE_ALT_MAX\): change it on the vehicle, or plan",
        ),
        (
            "ardupilot",
            {"FENCE_ENABLE": 0, "FENCE_AUTOENABLE": 1, "FENCE_TYPE": 2, "FENCE_ALT_MAX": 9.0, "FENCE_RADIUS": 150.0},
            r"it flies 165 m from home, at most 150 m are allowed \(FENCE_RADIUS\)",
        ),
        ("px4", {"GF_ACTION": 0, "GF_MAX_HOR_DIST": 10.0, "GF_MAX_VER_DIST": 10.0}, None),
        ("px4", {"GF_ACTION": 2, "GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 0.0}, None),
        (
            "px4",
            {"GF_ACTION": 2, "GF_MAX_HOR_DIST": 100.0, "GF_MAX_VER_DIST": 0.0},
            r"it flies 166 m from home, at most 100 m are allowed \(GF_MAX_HOR_DIST\)",
        ),
    ],
)
def test_limits_of_the_vehicle_are_limits_of_its_mission(
    autopilot: Autopilot, parameters: dict[str, float], told: str | None
) -> None:
    rig = Rig(small_fleet(autopilot, 1))
    rig.sim.links[0].autopilot.parameters.update(parameters)
    rig.upload()
    if told is None:
        assert rig.link.send_guards() == ()
    else:
        with pytest.raises(LinkError, match=f"uav1 .*its own fence would end its mission: {told}"):
            rig.link.send_guards()


def test_nothing_is_changed_on_an_armed_vehicle() -> None:
    rig = Rig(guarded("ardupilot"))
    rig.upload()
    rig.pipes[1].down = lambda m: setattr(m, "base_mode", m.base_mode | 128) or m if m.get_type() == "HEARTBEAT" else m
    rig.sim.advance(1.5)
    with pytest.raises(LinkError, match=r"uav2 .*is armed: land and disarm it before giving it a fence"):
        rig.link.send_guards()


# --- backups


def saved_fleet(autopilot: Autopilot, folder: Path) -> tuple[Rig, tuple[Saved, ...]]:
    """Return a fleet with missions, fences and rally points, saved."""
    rig = Rig(guarded(autopilot))
    rig.upload()
    rig.link.send_guards()
    vehicles = rig.link.holdings()
    write_backup(folder, vehicles, "2027-05-04T10:30:00+00:00")
    return rig, vehicles


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_what_was_saved_is_given_back(autopilot: Autopilot, tmp_path: Path) -> None:
    rig, vehicles = saved_fleet(autopilot, tmp_path)
    assert read_backup(tmp_path) == vehicles
    before = [[link.missions.items(kind) for kind in range(3)] for link in rig.sim.links]
    other = small_fleet(autopilot, 2)
    rig = Rig(with_mission(other, fence=Fence(polygon=box(-60, -60, 410, 210)), fleet=Fleet()))
    rig.upload()
    rig.link.send_guards()
    rig.lose(0.2, seed=4)
    sent = restore(vehicles, list(rig.pipes), rig.clock)
    assert sent[1] == ("fence", "set of rally points")
    after = [[link.missions.items(kind) for kind in range(3)] for link in rig.sim.links]
    for old, new in zip(before, after, strict=True):
        assert [[replace(i, current=0) for i in items] for items in old] == [
            [replace(i, current=0) for i in items] for items in new
        ]
    assert restore(vehicles, list(rig.pipes), rig.clock) == {1: (), 2: ()}


def test_an_empty_vehicle_is_empty_again(tmp_path: Path) -> None:
    empty = Rig(small_fleet("px4", 1))
    empty.link.connect()
    write_backup(tmp_path, empty.link.holdings(), "now")
    rig, _ = saved_fleet("px4", tmp_path / "other")
    sent = restore(read_backup(tmp_path), [rig.pipes[0]], rig.clock)
    assert sent == {1: ("mission", "fence", "set of rally points")}
    assert all(rig.sim.links[0].missions.items(kind) == () for kind in range(3))


def test_other_ground_stations_load_a_backup(tmp_path: Path) -> None:
    _, vehicles = saved_fleet("ardupilot", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "backup.json",
        *(f"uav{k}.{kind}" for k in (1, 2) for kind in ("plan", "waypoints")),
    ]
    plan = read_plan(tmp_path / "uav1.plan")
    assert [i.command for i in plan.items] == [i.command for i in vehicles[0].mission]
    assert (plan.fence_items, plan.rally_points) == (2, 1)
    rows = read_waypoints(tmp_path / "uav1.waypoints", "ardupilot")
    assert [(i.x, i.y, i.z) for i in rows] == [(i.x, i.y, i.z) for i in vehicles[0].mission]


def test_numbers_survive_that_json_does_not_know(tmp_path: Path) -> None:
    odd = MissionItem(0, 0, 16, math.nan, math.inf, -math.inf, 1e-40, x=-1, y=2, z=math.nan)
    vehicle = Saved("v", 3, "px4", "copter", (), (odd,), (), ())
    write_backup(tmp_path, [vehicle], "now")
    assert read_backup(tmp_path) == (vehicle,)


def test_a_backup_is_never_replaced(tmp_path: Path) -> None:
    _, vehicles = saved_fleet("px4", tmp_path)
    with pytest.raises(MissionError, match="expected a folder without a backup, got one: choose another"):
        write_backup(tmp_path, vehicles, "later")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d["vehicles"][0]["mission"][1].__setitem__(9, 99.0), "uav1: expected what was saved .*was changed"),
        (lambda d: d["vehicles"][0]["mission"].pop(), "uav1: expected what was saved"),
        (lambda d: d["vehicles"][1].update(sysid=1), r"expected vehicles with different sysids, got \[1, 1\]"),
        (lambda d: d.update(vehicles=[]), "expected vehicles with different sysids"),
        (lambda d: d.update(version=2), "version: expected a backup as it was written"),
        (lambda d: d["vehicles"][0].pop("fence"), "vehicles.0.fence: expected a backup as it was written"),
        (lambda d: d["vehicles"][0]["mission"][1].__setitem__(2, 70_000), "expected a frame up to 255"),
        (lambda d: d["vehicles"][0]["mission"][1].__setitem__(7, 2**40), "expected numbers that fit"),
    ],
)
def test_a_backup_that_was_changed_is_refused(change: Callable[[Any], Any], told: str, tmp_path: Path) -> None:
    saved_fleet("px4", tmp_path)
    path = tmp_path / "backup.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(MissionError, match=told):
        read_backup(tmp_path)


def test_no_backup_is_told(tmp_path: Path) -> None:
    with pytest.raises(MissionError, match=r"backup.json: expected a backup, as upload --backup writes"):
        read_backup(tmp_path)
    (tmp_path / "backup.json").write_text("{")
    with pytest.raises(MissionError, match=r"backup.json: file: expected a backup as it was written"):
        read_backup(tmp_path)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"autopilot": "px4"}, "expected px4 copter, got ardupilot copter: it is not the vehicle that was saved"),
        ({"vehicle_class": "plane"}, "expected ardupilot plane, got ardupilot copter"),
        ({"unique_ids": ("00000000000000aa",)}, "expected the autopilot with uid 0+aa, got 0+1: it is not the vehicle"),
    ],
)
def test_nobody_else_gets_it(change: dict[str, Any], told: str, tmp_path: Path) -> None:
    rig, vehicles = saved_fleet("ardupilot", tmp_path)
    before = [link.missions.items() for link in rig.sim.links]
    wrong = [replace(vehicles[0], mission=(), **change), replace(vehicles[1], mission=())]
    with pytest.raises(LinkError, match=rf"uav1 \(sysid 1\): {told}.*; nothing was restored"):
        restore(wrong, list(rig.pipes), rig.clock)
    assert [link.missions.items() for link in rig.sim.links] == before


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_last_answer_that_never_comes_is_left_to_the_read_back(autopilot: Autopilot) -> None:
    rig = Rig(small_fleet(autopilot, 2))
    rig.pipes[0].down = lambda m: None if m.get_type() == "MISSION_ACK" else m
    rig.upload()
    assert set(rig.link.held) == {1, 2}


def test_a_mission_that_is_never_confirmed_and_reads_back_otherwise_is_refused() -> None:
    rig = Rig(small_fleet("px4", 1))

    def changed(message: Any) -> Any:
        if message.get_type() == "MISSION_ACK":
            return None
        if message.get_type() == "MISSION_ITEM_INT" and message.seq == 3:
            message.x += 1
        return message

    rig.pipes[0].down = changed
    with pytest.raises(
        LinkError,
        match=r"uav1 .*holds another mission than was sent: item 3: x: sent 343603606, the vehicle holds 343603607 ",
    ):
        rig.upload()


def test_a_held_fence_is_told_where_no_plan_is() -> None:
    rig = Rig(small_fleet("ardupilot", 1))
    hold(rig, 0, polygon((0, 0), (10, 0), (0, 10), inclusion=False), FENCE)
    rig.upload()
    [found] = download_missions(list(rig.pipes), rig.clock).values()
    assert found.notes == ("it holds a fence of 3 items, not checked: it may end the mission",)


def test_two_autopilots_behind_one_address_are_known_by_the_numbers_of_their_frames() -> None:
    """Twins in all else: the same id, started at the same time."""

    def elsewhere(message: Any) -> Any:
        message._header.seq = (message.get_seq() + 100) % 256
        return message

    with pytest.raises(
        LinkError, match=r"expected one autopilot, heard two by turns \(frames bear the numbers of two\)"
    ):
        twins(elsewhere).connect()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    "faults",
    [
        Faults(loss=0.4, duplicate=0.2, reorder=0.2, delay_s=0.05),
        Faults(loss=0.2, duplicate=0.5, reorder=0.5, jitter_s=1.0),
        Faults(down_s=((1.0, 9.0),)),
    ],
)
def test_one_autopilot_on_a_bad_link_is_no_two(faults: Faults, seed: int) -> None:
    plan = small_fleet("px4", 1)
    sim = SimFleet(planned_vehicles(plan), frame=plan.frame, seed=seed)
    ground, air = in_process_pair()
    sim.attach(FaultyEndpoint(air, faults, lambda: sim.now_s, np.random.default_rng(seed)))
    FleetLink(plan, [ground], LockstepClock(sim)).connect()


def test_a_frame_that_comes_on_two_ways_is_of_one_autopilot() -> None:
    plan = small_fleet("ardupilot", 1)
    sim = SimFleet(planned_vehicles(plan), frame=plan.frame)
    ground, air = in_process_pair()
    sim.attach(air)

    class Doubled(Merged):
        def receive(self) -> list[tuple[bytes, Peer]]:
            return [piece for piece in super().receive() for _ in range(2)]

    FleetLink(plan, [Doubled(ground)], LockstepClock(sim)).connect()


def test_in_flight_no_mission_is_mixed_into_another_station_s() -> None:
    """Most ground stations have our ids: requests for their items are heard by us, too."""
    rig = Rig(small_fleet("px4", 1))
    rig.upload()
    rig.link.send_guards()
    rig.link.start()
    sent: list[str] = []

    def spy(message: Any) -> Any:
        sent.append(message.get_type())
        return message

    rig.pipes[0].up = spy
    other = mavlink.MAVLink(None, srcSystem=255, srcComponent=OWN_COMPONENT)
    rig.pipes[0]._inner.send(mavlink.MAVLink_mission_count_message(1, 1, 5).pack(other))
    rig.sim.advance(0.5)
    rig.link._station.settle(1.0)
    assert "MISSION_ITEM_INT" not in sent


def test_an_armed_vehicle_is_not_restored(tmp_path: Path) -> None:
    rig, vehicles = saved_fleet("ardupilot", tmp_path)
    rig.link.start()
    with pytest.raises(LinkError, match=r"uav1 .*is armed: land and disarm it first; nothing was restored"):
        restore(vehicles, list(rig.pipes), rig.clock)


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_bad_radio_delays_and_no_more(autopilot: Autopilot) -> None:
    """40 % of loss each way at 57,600 baud, late, doubled and out of order: every seed ends with what was sent."""
    radio = Faults(0.4, duplicate=0.05, reorder=0.05, corrupt=0.02, delay_s=0.1, jitter_s=0.2, baud=57_600)
    for seed in range(4):
        plan = small_fleet(autopilot, 1)
        sim = SimFleet(planned_vehicles(plan), frame=plan.frame, seed=seed)
        ground, air = in_process_pair()
        sim.attach(FaultyEndpoint(air, radio, lambda sim=sim: sim.now_s, np.random.default_rng(seed)))  # type: ignore[misc]
        link = FleetLink(plan, [ground], LockstepClock(sim))
        link.connect()
        link.upload()
        link.verify()
        assert [i.command for i in sim.links[0].missions.items()] == [i.command for i in link.items[1]]
