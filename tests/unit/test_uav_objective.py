"""The UAV path objective: against its definition in plain Python, against another implementation, and by laws."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from missionplanner.errors import MissionError
from missionplanner.experiments import uav_objective
from missionplanner.experiments.uav_objective import Instance
from missionplanner.experiments.uav_scene import load_scene
from missionplanner.geodesy import FloatArray

BENCH = Path(__file__).parents[3] / "shared" / "bench"
RELATIVE = 1e-9


def made(seed: int, *, size: int = 220, threats: int = 6, relief_m: float = 150.0) -> Instance:
    """Return a small instance: hills, cylinders and ends at whole metres, as those of the benchmark."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[1 : size + 1, 1 : size + 1]
    heights = sum(
        relief_m * rng.uniform(-1, 1) * np.exp(-((x - rng.uniform(0, size)) ** 2 + (y - rng.uniform(0, size)) ** 2) / s)
        for s in rng.uniform(400, 3000, 8)
    )
    cylinders = np.column_stack(
        [rng.integers(50, size - 50, (threats, 2)), rng.integers(0, 99, threats), rng.integers(5, 25, threats)]
    ).astype(float)
    start, end = np.array([12.0, 15.0, 150.0]), np.array([size - 14.0, size - 25.0, 150.0])
    return uav_objective.make("made", np.asarray(heights), cylinders, start, end)


def definition(instance: Instance, point: FloatArray) -> list[float]:
    """Return the five terms of a point, by the definition, one number after the other."""
    m = instance.arrays
    rows, columns = m.height_m.shape
    path = [m.start.tolist()]
    for r, psi, phi in point.reshape(-1, 3).tolist():
        x, y, z = path[-1]
        x += r * math.cos(psi) * math.sin(phi)
        y += r * math.cos(psi) * math.cos(phi)
        path.append([min(max(x, 1.0), columns), min(max(y, 1.0), rows), min(max(z + r * math.sin(psi), 100.0), 200.0)])
    path.append(m.end.tolist())
    alt = [z + float(m.height_m[round(y) - 1, round(x) - 1]) for x, y, z in path]
    legs = [(b[0] - a[0], b[1] - a[1], c1 - c0) for a, b, c0, c1 in zip(path, path[1:], alt, alt[1:], strict=False)]
    length = sum(math.hypot(*leg) for leg in legs)
    threats = 0.0
    for (cx, cy, _, radius), (a, b) in ((t, pair) for t in m.threat.tolist() for pair in pairwise(path)):
        ex, ey, wx, wy = b[0] - a[0], b[1] - a[1], cx - a[0], cy - a[1]
        ee, along = ex * ex + ey * ey, wx * ex + wy * ey
        if ee > 0.0 and 0.0 <= along <= ee:
            d = abs(ex * wy - ey * wx) / math.sqrt(ee)
        else:
            d = min(math.hypot(wx, wy), math.hypot(cx - b[0], cy - b[1]))
        if d <= radius + 11.0:
            threats += 1e4 if d < radius + 1.0 else radius + 11.0 - d
    heights = sum(abs(z - 150.0) for _, _, z in path[1:-1])
    angles = 0.0
    for i in range(len(legs) - 1):
        before = next((leg for leg in legs[i::-1] if leg[:2] != (0.0, 0.0)), (0.0, 0.0, 0.0))
        after = next((leg for leg in legs[i + 1 :] if leg[:2] != (0.0, 0.0)), (0.0, 0.0, 0.0))
        (ax, ay, _), (bx, by, _) = before, after
        turn = math.degrees(math.atan2(abs(ax * by - ay * bx), ax * bx + ay * by))
        climbs = [
            math.degrees(math.atan2(leg[2], math.hypot(*d[:2])))
            for leg, d in zip(legs[i : i + 2], (before, after), strict=True)
        ]
        angles += sum(v for v in (turn, abs(climbs[1] - climbs[0])) if v > 45.0)
    under = any(
        _below(m.height_m, a[0] + s / 11 * leg[0], a[1] + s / 11 * leg[1], c + s / 11 * leg[2])
        for a, c, leg in zip(path, alt, legs, strict=False)
        for s in range(12)
    )
    return [length, threats, heights, angles, 1e4 if under else 0.0]


def _below(heights: np.ndarray, x: float, y: float, z: float) -> bool:
    rows, columns = heights.shape
    if x > columns - 1 or y > rows - 1:
        return True
    c, r = min(int(x), columns - 2), min(int(y), rows - 2)
    (a, b), (d, e) = heights[r : r + 2, c : c + 2].astype(float).tolist()
    fx, fy = x - c, y - r
    return not z > (a * (1 - fx) + b * fx) * (1 - fy) + (d * (1 - fx) + e * fx) * fy


def mixed(instance: Instance, count: int, seed: int) -> FloatArray:
    """Return random points, of which a third have some of their coordinates on the box's edges."""
    rng = np.random.default_rng(seed)
    shape = (count, instance.dimensions)
    x = rng.uniform(instance.lower, instance.upper, shape)
    on_edge = (rng.random(shape) < 0.4) & (np.arange(count) % 3 == 0)[:, None]
    x[on_edge] = np.where(rng.random(shape) < 0.5, instance.lower, instance.upper)[on_edge]
    return x


@pytest.mark.parametrize("seed", range(3))
def test_terms_are_those_of_the_definition(seed: int) -> None:
    instance = made(seed)
    x = mixed(instance, 301, seed)
    expected = np.array([definition(instance, point) for point in x])
    np.testing.assert_allclose(instance.terms(x), expected, rtol=RELATIVE, atol=1e-9)
    np.testing.assert_allclose(instance.price(x), expected @ uav_objective.WEIGHTS, rtol=RELATIVE)
    assert (expected[:, 1:] > 0.0).any(axis=0).all(), "every term must have been met"
    assert (expected[:, 4] == 0.0).any()


corner = st.sampled_from([0.0, 0.5, 1.0])


@settings(max_examples=60, deadline=None)
@given(arrays(np.float64, 30, elements=corner | st.floats(0.0, 1.0)))
def test_corners_legs_without_length_and_sharp_turns_price_as_defined(share: FloatArray) -> None:
    instance = made(7, relief_m=0.0)  # level ground: climbs of exactly 45 degrees
    point = instance.lower + share * (instance.upper - instance.lower)
    found, expected = instance.terms(point[None])[0], definition(instance, point)
    # an angle of 45 degrees to the last bit is free or not by how its own sines are rounded
    angle = uav_objective.TERMS.index("angles")
    expected[angle] += 45.0 * np.rint((found[angle] - expected[angle]) / 45.0)
    np.testing.assert_allclose(found, expected, rtol=RELATIVE, atol=1e-9)


def test_no_result_depends_on_threads_nor_on_the_company() -> None:
    instance = made(3)
    x = mixed(instance, 500, 1)
    whole = instance.price(x, threads=1)
    assert (whole == instance.price(x, threads=3)).all()
    assert (whole[17:53] == instance.price(x[17:53], threads=1)).all()
    assert (whole[[8]] == instance.price(x[[8]])).all()


def test_the_decoded_path_is_the_priced_one() -> None:
    instance = made(4)
    x = mixed(instance, 40, 2)
    path = instance.waypoints_m(x)
    assert path.shape == (40, 12, 3)
    length = np.linalg.norm(np.diff(path, axis=1), axis=2).sum(axis=1)
    np.testing.assert_allclose(length, instance.terms(x)[:, 0], rtol=1e-12)
    np.testing.assert_array_equal(path[:, 0, :2], np.broadcast_to(instance.arrays.start[:2], (40, 2)))


def test_angles_outside_the_box_are_taken_as_they_are() -> None:
    instance = made(5)
    x = mixed(instance, 30, 3)
    x[:, 2::3] += 3.0
    np.testing.assert_allclose(instance.terms(x), [definition(instance, p) for p in x], rtol=RELATIVE, atol=1e-9)


def test_free_means_clear_of_cylinders_and_ground() -> None:
    instance = made(6)
    x = mixed(instance, 400, 4)
    terms = instance.terms(x)
    free = instance.free(x)
    assert free.any() and not free.all()
    assert (free == ((terms[:, 1] < 1e4) & (terms[:, 4] == 0.0))).all()


@pytest.fixture
def yardstick(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    if not (BENCH / "uavbench.py").is_file():
        pytest.skip("the benchmark's yardstick and instances are not at hand")
    spec = importlib.util.spec_from_file_location("uavbench", BENCH / "uavbench.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "uavbench", module)  # numba loads what it has cached by the module's name
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("number", [1, 4, 8, 12, 28, 40])
def test_it_equals_an_independent_implementation(number: int, yardstick: ModuleType) -> None:
    other = yardstick.gen(number)
    instance = uav_objective.load(BENCH / "instances" / f"inst{number:02d}.npz")
    np.testing.assert_array_equal(instance.lower, other.lb)
    np.testing.assert_array_equal(instance.upper, other.ub)
    x = mixed(instance, 6000, number)
    np.testing.assert_allclose(instance.price(x), other.fb(x), rtol=RELATIVE)


@pytest.mark.parametrize("load", [uav_objective.load, load_scene])
def test_damaged_files_are_told_alike_by_all_who_read_them(load: Callable[[Path], object], tmp_path: Path) -> None:
    good = made(0).arrays
    whole: dict[str, Any] = {"H": good.height_m, "threats": good.threat, "start": good.start, "end": good.end}
    path = tmp_path / "i.npz"
    np.savez_compressed(path, **whole)
    data = path.read_bytes()
    middle = len(data) // 3
    damaged = data[:middle] + bytes(255 - b for b in data[middle : middle + 200]) + data[middle + 200 :]
    for content in (data[: len(data) // 2], damaged, b"PK", b"nothing of the kind", b""):
        path.write_bytes(content)
        with pytest.raises(MissionError, match=r"i\.npz: expected an \.npz file") as error:
            load(path)
        assert "\n" not in str(error.value)
    for change, told in (
        ({"start": good.start[:2]}, r"i: expected start of shape \(3,\)"),
        ({"end": good.start}, "i: expected start and end in two places"),
        ({"threats": good.threat * np.nan}, "i: expected threats"),
    ):
        np.savez(path, **(whole | change))
        with pytest.raises(MissionError, match=told):
            load(path)


def test_errors_name_the_file_and_what_it_lacks(tmp_path: Path) -> None:
    heights, threats, ends = np.zeros((50, 60)), np.zeros((1, 4)), np.array([[5.0, 6.0, 150.0], [40.0, 41.0, 150.0]])
    path = tmp_path / "i.npz"

    def refused(pattern: str, **changed: object) -> None:
        content = {"H": heights, "threats": threats, "start": ends[0], "end": ends[1]} | changed
        np.savez(path, **{k: v for k, v in content.items() if v is not None})  # type: ignore[arg-type]
        with pytest.raises(MissionError, match=pattern):
            uav_objective.load(path)

    refused("threats is not a file", threats=None)
    refused("end within x 1 to 60 and y 1 to 50, got 61, 2", end=np.array([61.0, 2.0, 150.0]))
    refused("threats of shape", threats=np.zeros((2, 3)))
    refused("H of shape .* got NaN", H=np.full((50, 60), math.nan))
    path.write_text("nothing")
    with pytest.raises(MissionError, match=r"i\.npz: expected an \.npz file"):
        uav_objective.load(path)
    with pytest.raises(MissionError, match="No such file"):
        uav_objective.load(tmp_path / "none.npz")
    instance = made(1)
    with pytest.raises(MissionError, match=r"expected points \(P, 30\), got shape \(4, 29\)"):
        instance.price(np.zeros((4, 29)))
    with pytest.raises(MissionError, match="NaN"):
        instance.price(np.full((1, 30), math.nan))
