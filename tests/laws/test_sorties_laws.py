"""Laws of reading missions back: what is exported is what is read; no mission at all is a crash."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from adapters.mission_items import MissionItem, items_sha256, plan_items
from adapters.plan_file import PlanFile, plan_text
from adapters.sorties import plan_sortie, read_mission_file, read_sortie
from adapters.waypoints_file import waypoints_text
from missionplanner.errors import MissionError
from missionplanner.motion.spline import spline_chords
from missionplanner.plan import VehiclePlan
from missionplanner.sortie import Sortie
from missionplanner.vehicle import Autopilot, Ending, VehicleClass
from tests.plans import FRAME, vehicle_plan

autopilots: st.SearchStrategy[Autopilot] = st.sampled_from(["ardupilot", "px4"])
classes: st.SearchStrategy[VehicleClass] = st.sampled_from(["copter", "plane"])
places = st.tuples(st.floats(-20e3, 20e3), st.floats(-20e3, 20e3))
# not at sea level, which ArduCopter takes for "as high as now": what lies within 2 cm of it is written as 2 cm
heights = st.one_of(st.floats(-400, -0.021), st.floats(0.02, 8000))
points = st.tuples(st.floats(-20e3, 20e3), st.floats(-20e3, 20e3), heights)


@st.composite
def plans(draw: st.DrawFn) -> VehiclePlan:
    """Draw a plan that the exporter can write: up from home, anywhere, an end."""
    vehicle_class = draw(classes)
    ends: list[Ending] = ["land", "rtl", "loiter"] if vehicle_class == "copter" else ["rtl", "loiter"]
    home = (*draw(places), draw(st.floats(-400, 4000)))
    climb_m = draw(st.floats(2.6, 500))  # MIS_TAKEOFF_ALT
    aside_m = 0.0 if vehicle_class == "copter" else draw(st.floats(2.0, 900))
    top = (home[0] + aside_m, home[1], home[2] + climb_m)
    waypoints_m = [top, *draw(st.lists(points, min_size=1, max_size=7))]
    slowest_m_s = 0.3 if vehicle_class == "copter" else 9.0  # AIRSPEED_MIN
    within_a_day_m_s = float(np.linalg.norm(np.diff(waypoints_m, axis=0), axis=1).sum()) / 86_000.0
    return vehicle_plan(
        autopilot=draw(autopilots),
        vehicle_class=vehicle_class,
        end=draw(st.sampled_from(ends)),
        home_m=home,
        waypoints_m=waypoints_m,
        speed_m_s=draw(st.floats(max(slowest_m_s, within_a_day_m_s), 30)),
        start_delay_s=draw(st.floats(0, 100)),
    )


def _same(sortie: Sortie, plan: VehiclePlan) -> None:
    assert (sortie.autopilot, sortie.vehicle_class, sortie.ending) == (plan.autopilot, plan.vehicle_class, plan.end)
    assert sortie.gaps == ()
    assert sortie.start_delay_s == plan.start_delay_s
    assert [leg.kind for leg in sortie.legs] == ["takeoff"] + ["straight"] * (len(plan.waypoints_m) - 1)
    back = FRAME.to_geo(np.stack([sortie.home_m, *(leg.end_m for leg in sortie.legs)]))
    there = FRAME.to_geo(np.stack([plan.home_m, *plan.waypoints_m]))
    for k, tolerance in enumerate([1e-7, 1e-7, 1e-3]):
        np.testing.assert_allclose(back[k], there[k], atol=tolerance, rtol=0)
    for leg in sortie.legs[1:]:
        assert leg.speed_m_s == np.float32(plan.speed_m_s)
        assert leg.hold_s == 0.0


@given(plans())
def test_a_plan_reads_back_through_the_wire(plan: VehiclePlan) -> None:
    sortie = plan_sortie(plan, FRAME)
    _same(sortie, plan)
    assert (sortie.name, sortie.sysid) == (plan.name, plan.sysid)
    seqs = [leg.seq for leg in sortie.legs]
    assert seqs == sorted(set(seqs))
    assert sortie.ending_seq == len(plan_items(plan, FRAME)) - 1


@given(plans(), st.sampled_from(["plan", "txt"]))
def test_a_plan_reads_back_through_its_files(plan: VehiclePlan, suffix: str) -> None:
    items = plan_items(plan, FRAME)
    home = FRAME.geo_point(plan.home_m)
    # either content under either suffix
    content = plan_text(PlanFile(plan.autopilot, home, items), plan.vehicle_class)
    for text in (content, waypoints_text(items, plan.autopilot, home)):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"uav.{suffix}")
            path.write_text(text)
            back, back_home = read_mission_file(path, plan.autopilot)
        assert back == items
        assert items_sha256(back) == items_sha256(items)
        assert back_home is not None
        sortie = read_sortie(
            back,
            name=plan.name,
            sysid=plan.sysid,
            autopilot=plan.autopilot,
            vehicle_class=plan.vehicle_class,
            frame=FRAME,
            home_m=FRAME.to_local(back_home.lat_deg, back_home.lon_deg, back_home.alt_amsl_m),
            motion=plan.motion,
            start_delay_s=plan.start_delay_s,
        )
        _same(sortie, plan)


commands = st.one_of(st.sampled_from([16, 17, 18, 19, 20, 21, 22, 82, 93, 178, 112, 177, 206]), st.integers(0, 65_535))
parameters = st.one_of(
    st.sampled_from([0.0, 1.0, -1.0, 2.5, 300.0, math.nan, math.inf, -math.inf]), st.floats(width=32)
)
near_lat = st.integers(343_500_000, 343_700_000)
near_lon = st.integers(-1_181_900_000, -1_181_700_000)
lats = st.one_of(near_lat, st.just(0), st.integers(-(2**31), 2**31 - 1))
lons = st.one_of(near_lon, st.just(0), st.integers(-(2**31), 2**31 - 1))
altitudes = st.one_of(st.floats(-100, 3000), st.just(0.0), st.floats(width=32))
frames = st.one_of(st.sampled_from([0, 2, 3, 5, 6, 10]), st.integers(0, 255))


@st.composite
def any_items(draw: st.DrawFn, *, likely: bool) -> list[MissionItem]:
    """Draw a list of items; likely: numbered and near by, so that more than the first is read."""
    return [
        MissionItem(
            seq if likely else draw(st.integers(0, 3)),
            draw(st.sampled_from([0, 3, 10]) if likely else frames),
            16 if likely and seq == 0 else draw(commands),
            *(draw(parameters) for _ in range(4)),
            draw(near_lat if likely else lats),
            draw(near_lon if likely else lons),
            draw(st.floats(-100, 3000) if likely else altitudes),
            draw(st.integers(0, 1)),
            draw(st.integers(0, 1)),
        )
        for seq in range(draw(st.integers(0, 8)))
    ]


@given(
    st.one_of(any_items(likely=True), any_items(likely=False)),
    autopilots,
    classes,
    st.sampled_from([None, (0.0, 0.0, 1200.0), (10.0, math.nan, 0.0)]),
    st.sampled_from([None, 1200.0, math.nan]),
)
@example([MissionItem(0, 0, 16, x=2**31 - 1, z=math.nan)], "ardupilot", "copter", None, None)
def test_any_items_are_a_sortie_or_a_mission_error(
    items: list[MissionItem],
    autopilot: Autopilot,
    vehicle_class: VehicleClass,
    home_m: tuple[float, float, float] | None,
    ground_m: float | None,
) -> None:
    motion = vehicle_plan(autopilot=autopilot, vehicle_class=vehicle_class).motion
    try:
        sortie = read_sortie(
            items,
            name="uav1",
            sysid=1,
            autopilot=autopilot,
            vehicle_class=vehicle_class,
            frame=FRAME,
            home_m=None if home_m is None else np.array(home_m),
            motion=motion,
            ground=None if ground_m is None else lambda _x, _y: ground_m,
        )
    except MissionError as error:
        assert str(error).startswith("uav1: ")
        assert "\n" not in str(error)
        return
    assert sortie.legs[0].kind == "takeoff"
    seqs = [leg.seq for leg in sortie.legs]
    assert seqs == sorted(seqs)
    assert sortie.ending_seq >= seqs[-1]
    assert 0.0 <= sortie.start_delay_s < math.inf
    for index, leg in enumerate(sortie.legs):
        assert np.isfinite(leg.end_m).all()
        assert 0.0 < leg.speed_m_s < math.inf
        assert 0.0 <= leg.hold_s < math.inf
        assert (leg.radius_m > 0.0) == (leg.kind == "circle")
        if leg.kind == "spline":
            assert np.isfinite(spline_chords(sortie, index, 1.0)).all()
    # a command that nobody knows, flown before the end, is never passed over
    flown = [i for i in items[autopilot == "ardupilot" :] if i.seq < sortie.ending_seq]
    assert {i.seq for i in flown if i.command > 50_000} <= {gap.seq for gap in sortie.gaps}


texts = st.one_of(
    st.binary(max_size=200),
    st.binary(max_size=200).map(lambda tail: b"QGC WPL 110\n" + tail),
    st.binary(max_size=200).map(lambda tail: b"{" + tail),
)


@given(texts, autopilots)
@example(b'{"a":' + b"[" * 100_000, "px4")
@example(b"\xef\xbb\xbfQGC WPL 110\n0\t1\t0\t16\t0\t0\t0\t0\t34\t-118\t1\t1\n", "ardupilot")
def test_any_file_is_a_mission_or_a_mission_error(content: bytes, autopilot: Autopilot) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "mission.txt")
        path.write_bytes(content)
        try:
            items, _ = read_mission_file(path, autopilot)
        except MissionError as error:
            assert str(path) in str(error)
            return
    assert all(isinstance(item, MissionItem) for item in items)
