"""Times and energies between views: beside predicted flights, over lines, around what has no top, near and far."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from missionplanner import energy, timing, travel, wind
from missionplanner.energy import GRAVITY_M_S2
from missionplanner.plan import Action
from missionplanner.scene import Scene
from missionplanner.travel import TravelCosts, travel_costs
from missionplanner.views import Viewpoint, Visit
from tests.lines import open_question, open_scene
from tests.scenes import at

FAR_LINE = ((4000.0, -4000.0), (4000.0, -4200.0))
HEIGHT_M = 60.0


def scene(*, vehicles: Sequence[dict[str, Any]] | None = None, **changes: Any) -> Scene:
    """Return level ground at sea level with a line that is in nobody's way."""
    vehicles = vehicles or [{"name": "alpha", "home": at(0.0, 0.0), "endurance_s": 1500.0}]
    area = {"south_west": at(-6000.0, -6000.0), "north_east": at(6000.0, 6000.0)}
    ground = {"kind": "flat", "alt_amsl_m": 0.0}
    data = open_question(FAR_LINE) | {"vehicles": list(vehicles), "area": area, "terrain": ground}
    return open_scene(data | changes)


def visit(name: str, *points: tuple[float, float], hold_s: float = 3.0, z: float = HEIGHT_M, photos: int = 0) -> Visit:
    """Return a visit of a target of the same name."""
    viewpoints = tuple(Viewpoint(np.array([x, y, z]), Action(name, name, hold_s, photos=photos)) for x, y in points)
    return Visit(name, name, viewpoints, reversible=len(points) > 1)


def flown(scene: Scene, visits: Sequence[Visit], costs: TravelCosts) -> tuple[float, float, float, float]:
    """Return time and energy of one tour through visits: as reckoned, and as predicted for straight legs."""
    home = costs.home(0)
    places = [home, *range(len(visits)), home]
    time_s, share = (
        float(sum(of[0, a, b] for a, b in itertools.pairwise(places))) for of in (costs.time_s, costs.energy_share)
    )
    task = scene.tasks[0]
    top = task.home_m + np.array([0.0, 0.0, costs.top_height_m[0]])
    stops = [viewpoint for v in visits for viewpoint in v.viewpoints]
    points = np.array([top, *(viewpoint.position_m for viewpoint in stops), top])
    hold_s = [*(viewpoint.action.stand_s for viewpoint in stops), 0.0]
    flight, _ = timing.predict_flight(
        task.motion, task.home_m, points, task.limits.speed_max_m_s, hold_s=hold_s, end="land", ground_amsl_m=0.0
    )
    model = energy.energy_model(scene.mission.vehicles[0], scene.mission.air_m_s)
    assert model is not None
    used = energy.used_share(model, flight, scene.mission.wind_max_m_s or 0.0)
    return time_s, share, float(flight.t_s[-1]), float(used[-1])


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
@pytest.mark.parametrize("wind", [{}, {"wind_max_m_s": 5.0}])
def test_a_tour_takes_what_its_predicted_flight_takes(autopilot: str, wind: dict[str, Any]) -> None:
    """From hold to hold, near and far, level and up and down: time and energy within 3 %."""
    vehicle = {"name": "alpha", "home": at(0.0, 0.0), "endurance_s": 1500.0, "autopilot": autopilot}
    place = scene(vehicles=[vehicle], **wind)
    visits = [
        visit("a", (300.0, 40.0)),
        visit("b", (310.0, 90.0)),
        visit("c", (340.0, 110.0), (380.0, 140.0), (390.0, 170.0), z=75.0),
        visit("d", (900.0, 200.0), z=50.0),
    ]
    time_s, share, flown_s, used = flown(place, visits, travel_costs(place, visits))
    assert time_s == pytest.approx(flown_s, rel=0.03)
    assert share == pytest.approx(used, rel=0.03)


def test_a_vehicle_stands_still_for_its_photos_too() -> None:
    """Ten photos at each of two places: the time and the energy that these take."""
    place = scene()
    visits = [visit("a", (300.0, 40.0), photos=10), visit("b", (600.0, 0.0), (640.0, 0.0), photos=10)]
    costs = travel_costs(place, visits)
    time_s, share, flown_s, used = flown(place, visits, costs)
    assert time_s == pytest.approx(flown_s, rel=0.03)
    assert share == pytest.approx(used, rel=0.03)
    none = travel_costs(place, [visit("a", (300.0, 40.0)), visit("b", (600.0, 0.0), (640.0, 0.0))])
    assert costs.inspection_s[0, :2] - none.inspection_s[0, :2] == pytest.approx([10.0, 20.0])


def test_who_passes_without_a_hold_hardly_slows_down() -> None:
    """A flight along a span that goes straight on from the last one takes no start and stop between them."""
    place = scene()
    visits = [visit("a", (200.0, 0.0), (400.0, 0.0), hold_s=0.0), visit("b", (420.0, 0.0), (700.0, 0.0), hold_s=0.0)]
    time_s, _, flown_s, _ = flown(place, visits, travel_costs(place, visits))
    assert time_s == pytest.approx(flown_s, rel=0.03)


def test_against_the_wind_it_takes_longer() -> None:
    """What it makes over the ground at its lean limit, on each course; and what that takes of its battery."""
    place = scene(wind={"speed_m_s": 5.0, "from_deg": 270.0})
    visits = [visit("west", (-800.0, 0.0)), visit("east", (800.0, 0.0))]
    costs = travel_costs(place, visits)
    time_s, share, flown_s, used = flown(place, visits, costs)
    assert time_s == pytest.approx(flown_s, rel=0.03)
    assert share == pytest.approx(used, rel=0.03)
    made_m_s = wind.airspeed_limit_m_s(place.tasks[0].motion) - 5.0
    assert costs.time_s[0, 1, 0] - costs.time_s[0, 0, 1] == pytest.approx(1600.0 / made_m_s - 160.0, abs=5.0)


def test_a_line_is_crossed_above_it() -> None:
    """The string over a line: up to its top with the margin and down again, no more and no less."""
    line = {"kind": "line", "name": "lift", "supports": [at(100.0, -900.0) | {"height_agl_m": 100.0}]}
    line["supports"].append(at(100.0, 900.0) | {"height_agl_m": 100.0})
    line["cable_radius_m"] = 3.0
    line["catenary_m"] = 1e6  # taut
    visits = [visit("a", (0.0, 0.0)), visit("b", (200.0, 0.0))]
    free, over = (travel_costs(scene(obstacles=o), visits) for o in ([], [line]))
    model = energy.energy_model(scene().mission.vehicles[0])
    assert model is not None
    rise_m = 100.0 + 3.0 + 15.0 - HEIGHT_M
    more_s = over.time_s[0, 0, 1] - free.time_s[0, 0, 1]
    climbs_s, sinks_s = rise_m / 2.5, rise_m / 1.5
    assert climbs_s + sinks_s - 200.0 / 10.0 - 5.0 <= more_s <= climbs_s + sinks_s
    more = over.energy_share[0, 0, 1] - free.energy_share[0, 0, 1]
    lifted = rise_m * GRAVITY_M_S2 / energy.COPTER_EFFICIENCY / energy.COPTER_HOVER_W_KG / 1500.0
    assert more == pytest.approx(lifted + more_s / 1500.0, rel=0.1)


def test_a_mast_is_passed_beside() -> None:
    """However high it is, a mast costs a few metres."""
    mast = {"kind": "cylinder", "name": "mast", "center": at(100.0, 0.0), "radius_m": 3.0, "top_height_agl_m": 400.0}
    visits = [visit("a", (0.0, 0.0)), visit("b", (200.0, 0.0))]
    free, past = (travel_costs(scene(obstacles=o), visits).time_s[0, 0, 1] for o in ([], [mast]))
    assert free < past < free + 2.0


def no_fly(*corners: tuple[float, float]) -> dict[str, Any]:
    return {"kind": "no_fly", "name": "wall", "polygon": [at(x, y) for x, y in corners]}


def test_what_has_no_top_is_flown_around() -> None:
    """The way around a wall is as long as its corners say; who is walled in cannot be reached."""
    wall = no_fly((90.0, -400.0), (110.0, -400.0), (110.0, 400.0), (90.0, 400.0))
    visits = [visit("a", (0.0, 0.0)), visit("b", (200.0, 0.0))]
    free, around = (travel_costs(scene(obstacles=o), visits).time_s[0, 0, 1] for o in ([], [wall]))
    longer_m = 2.0 * math.hypot(100.0, 415.0) - 200.0
    assert free + 0.9 * longer_m / 10.0 <= around <= free + 1.15 * longer_m / 10.0 + 5.0
    walls = [
        no_fly((600.0, -300.0), (1200.0, -300.0), (1200.0, -250.0), (600.0, -250.0)) | {"name": "south"},
        no_fly((600.0, 250.0), (1200.0, 250.0), (1200.0, 300.0), (600.0, 300.0)) | {"name": "north"},
        no_fly((600.0, -260.0), (650.0, -260.0), (650.0, 260.0), (600.0, 260.0)) | {"name": "west"},
        no_fly((1150.0, -260.0), (1200.0, -260.0), (1200.0, 260.0), (1150.0, 260.0)) | {"name": "east"},
    ]
    shut = travel_costs(scene(obstacles=walls), [visit("a", (0.0, 0.0)), visit("in", (900.0, 0.0))])
    assert math.isinf(shut.time_s[0, 0, 1])
    assert math.isinf(shut.energy_share[0, shut.home(0), 1])
    assert np.isfinite(shut.time_s[0, shut.home(0), 0])


def test_below_a_ceiling_lines_are_flown_around() -> None:
    """A line that is higher than one may fly is a wall: the way goes around its end."""
    supports = [at(100.0, y) | {"height_agl_m": 100.0} for y in (-900.0, -300.0, 300.0)]
    line = {"kind": "line", "name": "lift", "supports": supports}
    visits = [visit("a", (0.0, 0.0)), visit("b", (200.0, 0.0))]
    low = [{"name": "alpha", "home": at(0.0, -100.0), "endurance_s": 1500.0, "height_agl_max_m": 90.0}]
    free, around = (travel_costs(scene(vehicles=low, obstacles=o), visits).time_s[0, 0, 1] for o in ([], [line]))
    longer_m = 2.0 * math.hypot(100.0, 318.0) - 200.0
    assert free + 0.9 * longer_m / 10.0 <= around <= free + 1.15 * longer_m / 10.0 + 5.0


def test_turned_visits_are_the_same_visits() -> None:
    """Each visit that may be turned has one more form, which begins where the other ends."""
    place = scene()
    visits = [visit("a", (100.0, 0.0), (200.0, 0.0)), visit("b", (300.0, 0.0)), visit("c", (900.0, 0.0), (700.0, 0.0))]
    costs = travel_costs(place, visits)
    assert costs.visit.tolist() == [0, 1, 2, 0, 2]
    assert costs.turned.tolist() == [3, 1, 4, 0, 2]
    assert costs.time_s[0, 0, 4] < costs.time_s[0, 0, 2]  # from a's end to c's nearer one
    assert costs.inspection_s[0, 0] == pytest.approx(costs.inspection_s[0, 3])


def test_vehicles_of_one_kind_share_a_model() -> None:
    """Another speed makes another model; homes do not."""
    kinds = [{"endurance_s": 1500.0}, {"endurance_s": 1500.0}, {"speed_m_s": {"min": 2.0, "max": 6.0}}]
    vehicles = [{"name": f"v{k}", "home": at(50.0 * k, 0.0)} | kind for k, kind in enumerate(kinds)]
    costs = travel_costs(scene(vehicles=vehicles), [visit("a", (500.0, 0.0)), visit("b", (900.0, 0.0))])
    assert costs.model.tolist() == [0, 0, 1]
    assert costs.time_s[1, 0, 1] > costs.time_s[0, 0, 1]
    assert not costs.energy_share[1, :2, :2][np.isfinite(costs.energy_share[1, :2, :2])].any()  # nothing is known of it
    assert costs.reserve_share.tolist() == [0.2, 0.2, 0.0]


def test_of_many_places_the_near_ones_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over others it is never shorter than straight across, and on level ground hardly longer."""
    place = scene()
    rng = np.random.default_rng(1)
    visits = [visit(f"v{k}", (x, y)) for k, (x, y) in enumerate(rng.uniform(-1500.0, 1500.0, (60, 2)).tolist())]
    straight = travel_costs(place, visits)
    monkeypatch.setattr(travel, "_DIRECT_PAIRS", 200)
    over = travel_costs(place, visits)
    off = ~np.eye(61, dtype=bool)
    ratio = over.time_s[0][off] / straight.time_s[0][off]
    assert ratio.min() > 1.0 - 1e-6
    assert ratio.max() < 1.25
    assert np.median(ratio) < 1.03


def test_returning_counts_from_where_it_takes_most() -> None:
    """As the proof reckons it: from the end of a visit far off, more than the way home along the mission."""
    place = scene()
    costs = travel_costs(place, [visit("a", (500.0, 0.0)), visit("b", (1500.0, 0.0))])
    assert costs.returns
    home = costs.home(0)
    for k in range(2):
        assert costs.home_share[0, k] > costs.energy_share[0, k, home] - 0.01
    assert costs.home_share[0, 1] > costs.home_share[0, 0]
    assert not travel_costs(scene(fleet={"direct_return": "waived"}), [visit("a", (500.0, 0.0))]).returns
