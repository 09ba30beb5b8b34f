"""Proven returns against returns flown by hand: told to at random, stopping anywhere, straying anyhow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from missionplanner.errors import InfeasibleError
from missionplanner.obstacles import CableSolid, CurtainSolid, CylinderSolid, PrismSolid, Solid, SphereSolid
from missionplanner.returns import Returning, choose_return_heights, prove_returns
from tests.returning import REACH_M, flight, ground, space_of

SEPARATION_M = 20.0
STRAY_M = 2.0
NEED_M = SEPARATION_M + 2 * STRAY_M
SEEDS = st.integers(0, 10**6)


def apart_m(i: int, j: int) -> float:
    return NEED_M


def solids(rng: np.random.Generator) -> list[Solid]:
    def place() -> np.ndarray:
        return rng.uniform(-250.0, 250.0, 2)

    x, y = place()
    corner, start, end = place(), place(), place()
    return [
        CylinderSolid("mast", x, y, rng.uniform(1.0, 15.0), rng.uniform(110.0, 190.0)),
        SphereSolid("radar", *place(), rng.uniform(90.0, 120.0), rng.uniform(10.0, 60.0), "radar"),
        PrismSolid("camp", corner + np.array([[0, 0], [60, 5], [30, 30], [5, 70]]), -np.inf, rng.uniform(110.0, 190.0)),
        CableSolid("cable", np.array([*start, 120.0]), np.array([*end, 135.0]), 1.0),
        CurtainSolid(
            "span", np.array([*place(), rng.uniform(90, 150)]), np.array([*place(), rng.uniform(90, 150)]), 3.0
        ),
    ]


def wander(name: str, rng: np.random.Generator, home: tuple[float, float], wait_s: float = 0.0) -> Returning:
    places = [(*home, rng.uniform(140.0, 190.0)) for _ in range(1)]
    places += [(*rng.uniform(-250.0, 250.0, 2), rng.uniform(140.0, 190.0)) for _ in range(int(rng.integers(1, 4)))]
    return flight(name, home, places, speed_m_s=rng.uniform(2.0, 10.0), wait_s=wait_s)


def returned(v: Returning, t_s: float, rng: np.random.Generator, count: int) -> np.ndarray:
    """Return points (count, 3) of returns that begin at one instant: brake, climb, way home, descent."""
    h = 0.05
    before, here, after = v.trajectory.at(np.array([t_s - h, t_s, t_s + h]))
    velocity = (after - before) / (2 * h)
    speed = float(np.hypot(*velocity[:2]))
    # ArduCopter's stopping point, and a little overshoot
    ahead = min(speed, speed**2 / 5.0 + 1.25) + 0.2 * speed
    share = rng.uniform(0.0, 1.0, count)
    stop = here + share[:, None] * (velocity / max(speed, 1e-9) * ahead) * [1.0, 1.0, 0.0]
    sunk = rng.uniform(0.0, 1.0, count) * min(0.0, velocity[2]) ** 2 / 2.0
    climbed = 0.8 * max(0.0, velocity[2]) / max(speed, 1e-9) * share * ahead
    home_top = float(v.home_m[2]) + v.motion.return_height_m
    low = here[2] - sunk + np.where(here[2] + climbed <= home_top, climbed, 0.0)
    top = np.maximum(here[2], home_top)
    part = rng.integers(0, 3, count)
    part[: count // 2] = 1
    s = rng.uniform(0.0, 1.0, count)
    points = np.empty((count, 3))
    points[:, :2] = np.where((part == 0)[:, None], stop[:, :2], v.home_m[:2])
    way = part == 1
    points[way, :2] = stop[way, :2] + s[way, None] * (v.home_m[:2] - stop[way, :2])
    points[:, 2] = np.where(way, top, np.where(part == 0, low + s * (top - low), v.home_m[2] + s * (top - v.home_m[2])))
    return points


def strayed(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    ball = rng.normal(size=points.shape)
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    ball[: len(ball) // 3] = [0.0, 0.0, -1.0]
    return points + STRAY_M * ball


def distance_m(solid: Solid, p: np.ndarray) -> np.ndarray:
    """Return distances (N,) from outside; 0 or less inside."""
    match solid:
        case CylinderSolid():
            across = np.hypot(p[:, 0] - solid.x, p[:, 1] - solid.y) - solid.radius_m
            return np.hypot(np.maximum(across, 0.0), np.maximum(p[:, 2] - solid.top_amsl_m, 0.0))
        case SphereSolid():
            return np.linalg.norm(p - [solid.x, solid.y, solid.z], axis=1) - solid.radius_m
        case CableSolid():
            along = solid.end - solid.start
            s = np.clip((p - solid.start) @ along / (along @ along), 0.0, 1.0)
            return np.linalg.norm(p - solid.start - s[:, None] * along, axis=1) - solid.radius_m
        case CurtainSolid():  # what hangs from one place of the cable is as far as that, or level with p; convex in s
            low, high = np.zeros(len(p)), np.ones(len(p))
            for _ in range(20):
                s = np.stack([low + (high - low) / 3.0, high - (high - low) / 3.0])
                off = p - solid.start - s[..., None] * (solid.end - solid.start)
                off[..., 2] = np.maximum(off[..., 2], 0.0)
                far = np.linalg.norm(off, axis=2)
                low, high = np.where(far[0] > far[1], s[0], low), np.where(far[0] > far[1], high, s[1])
            return far.min(axis=0) - solid.radius_m
        case PrismSolid():
            edges = list(zip(solid.xy, np.roll(solid.xy, -1, axis=0), strict=True))
            legs = np.min(
                [
                    np.linalg.norm(
                        p[:, :2] - a - np.clip((p[:, :2] - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)[:, None] * (b - a),
                        axis=1,
                    )
                    for a, b in edges
                ],
                axis=0,
            )
            inside = np.zeros(len(p), dtype=bool)
            for a, b in edges:
                crosses = (a[1] > p[:, 1]) != (b[1] > p[:, 1])
                with np.errstate(divide="ignore", invalid="ignore"):
                    inside ^= crosses & (p[:, 0] < (b[0] - a[0]) * (p[:, 1] - a[1]) / (b[1] - a[1]) + a[0])
            return np.hypot(np.where(inside, 0.0, legs), np.maximum(p[:, 2] - solid.top_amsl_m, 0.0))
    raise TypeError(solid)


def with_heights(vehicles: list[Returning], heights_m: list[float]) -> list[Returning]:
    return [
        replace(v, motion=replace(v.motion, return_height_m=height_m))
        for v, height_m in zip(vehicles, heights_m, strict=True)
    ]


@settings(max_examples=60)
@given(SEEDS)
def test_no_return_of_one_that_is_proven_comes_too_close_to_anything(seed):
    rng = np.random.default_rng(seed)
    things = solids(rng)
    ridge_m, ridge_x = rng.uniform(0.0, 90.0), rng.uniform(-200.0, 200.0)
    world = space_of(things, ridge_m, ridge_x)
    v = wander("alpha", rng, tuple(rng.uniform(-250.0, 250.0, 2)))
    assume(ground(v.home_m[0], v.home_m[1], ridge_m, ridge_x) < 101.0)
    # as low as anything is proven at, be it by chance
    heights_m = [height for height in np.arange(15.0, 130.0, 5.0) if _holds(world, v, height)][:1]
    assume(heights_m)
    (v,) = with_heights([v], heights_m)
    for t_s in rng.uniform(0.0, v.descends_s, 150):
        points = returned(v, t_s, rng, 150)
        if v.airborne_s <= t_s <= v.descends_s:
            high = points[:, 2] >= min(v.trajectory.at(t_s)[2], v.home_m[2] + v.motion.return_height_m) - 1.0
            some = strayed(points[high], rng)
            above = some[:, 2] - ground(some[:, 0], some[:, 1], ridge_m, ridge_x)
            assert above.min(initial=np.inf) >= v.limits.terrain_margin_m - 0.5  # cells do not quite follow the ridge
        some = strayed(points, rng)
        for thing in things:
            assert distance_m(thing, some).min() >= v.limits.obstacle_margin_m
        assert np.abs(some[:, :2]).max() <= REACH_M - v.limits.obstacle_margin_m


def _holds(world, v: Returning, height_m: float) -> bool:
    return prove_returns(*world, with_heights([v], [height_m]), apart_m)[0].proven


@settings(max_examples=40)
@given(SEEDS)
def test_no_two_that_are_proven_come_too_close_when_told_to_at_the_same_instant(seed):
    rng = np.random.default_rng(seed)
    homes = [(-40.0, 0.0), (40.0, 0.0), (0.0, 80.0)]
    vehicles = [wander(f"v{k}", rng, home, rng.uniform(0.0, 60.0)) for k, home in enumerate(homes)]
    heights = [rng.integers(15, 130, 3).astype(float).tolist() for _ in range(6)]
    try:
        heights.append(choose_return_heights(*space_of(), vehicles, apart_m, [None] * 3))
    except InfeasibleError:
        heights.append([15.0, 45.0, 75.0])
    for heights_m in heights:
        fleet = with_heights(vehicles, heights_m)
        proven = [f.vehicle for f in prove_returns(*space_of(), fleet, apart_m) if f.proven]
        for i, j in ((0, 1), (0, 2), (1, 2)):
            if f"v{i} - v{j}" not in proven:
                continue
            for t_s in rng.uniform(0.0, min(fleet[i].descends_s, fleet[j].descends_s), 60):
                a, b = (returned(fleet[k], t_s, rng, 200) for k in (i, j))
                near = np.linalg.norm(a[:, None] - b[None, :], axis=2)
                assert near.min() >= NEED_M - 1e-6


@settings(max_examples=25)
@given(SEEDS)
def test_chosen_heights_are_proven_and_the_least_for_each_alone(seed):
    rng = np.random.default_rng(seed)
    world = space_of(solids(rng), rng.uniform(0.0, 90.0), rng.uniform(-200.0, 200.0))
    v = wander("alpha", rng, tuple(rng.uniform(-250.0, 250.0, 2)))
    try:
        (height_m,) = choose_return_heights(*world, [v], apart_m, [None])
    except InfeasibleError:
        assert not any(_holds(world, v, height) for height in (15.0, 40.0, 80.0, 120.0, 200.0))
        return
    assert _holds(world, v, height_m)
    assert not any(_holds(world, v, height_m - less) for less in (2.0, 7.0, 20.0) if height_m - less >= 15.0)
