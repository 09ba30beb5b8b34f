"""ArduCopter's spline curves: its polynomial, its tangents, chords that hold them, and flights on record."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missionplanner.geodesy import FloatArray
from missionplanner.motion.spline import chords, hermite_bezier, spline_bezier, spline_chords
from missionplanner.sortie import Leg, LegKind, Sortie
from tests.oracles import flights

vectors = st.tuples(*[st.floats(-500, 500)] * 3).map(np.array)
beziers = st.tuples(*[vectors] * 4).map(np.stack)


def _on_curve(bezier: FloatArray, t: FloatArray) -> FloatArray:
    """De Casteljau: nothing but means of means."""
    level = np.broadcast_to(bezier, (len(t), 4, 3))
    share = t[:, np.newaxis, np.newaxis]
    while level.shape[1] > 1:
        level = (1.0 - share) * level[:, :-1] + share * level[:, 1:]
    return level[:, 0]


def _distance(points: FloatArray, line: FloatArray) -> FloatArray:
    start, along = line[:-1], np.diff(line, axis=0)
    squared = np.maximum((along**2).sum(axis=1), 1e-30)
    share = np.clip(((points[:, np.newaxis] - start) * along).sum(axis=-1) / squared, 0.0, 1.0)
    off = points[:, np.newaxis] - (start + share[..., np.newaxis] * along)
    return np.linalg.norm(off, axis=-1).min(axis=1)


@given(beziers, st.floats(0.02, 50.0))
def test_chords_hold_the_curve(bezier: FloatArray, tolerance_m: float) -> None:
    line = chords(bezier, tolerance_m)
    np.testing.assert_array_equal(line[[0, -1]], bezier[[0, 3]])
    t = np.linspace(0.0, 1.0, 401)
    assert _distance(_on_curve(bezier, t), line).max() <= tolerance_m + 1e-9
    spread_m = np.abs(np.diff(bezier, n=2, axis=0)).max()
    assert len(line) <= 3 + 2.0 * np.sqrt(spread_m / tolerance_m)  # no more of them than that takes


@given(vectors, vectors, vectors, vectors)
def test_the_curve_is_the_autopilots_polynomial(a: FloatArray, b: FloatArray, va: FloatArray, vb: FloatArray) -> None:
    length, speeds = np.linalg.norm(b - a), np.linalg.norm(va) + np.linalg.norm(vb)
    if speeds > 4.0 * length:
        va, vb = va * 4.0 * length / speeds, vb * 4.0 * length / speeds
    t = np.linspace(0.0, 1.0, 11)[:, np.newaxis]
    hermite = a + va * t + (3 * (b - a) - 2 * va - vb) * t**2 + (2 * (a - b) + va + vb) * t**3
    ours = _on_curve(hermite_bezier(a, b, va, vb), t[:, 0])
    np.testing.assert_allclose(ours, hermite, atol=1e-6)


def _sortie(*legs: tuple[LegKind, tuple[float, float, float], float]) -> Sortie:
    made = [Leg(k + 1, kind, np.array(end), 5.0, hold) for k, (kind, end, hold) in enumerate(legs)]
    return Sortie("uav1", 1, "ardupilot", "copter", np.zeros(3), tuple(made), "rtl", 9, 0.0, 15.0)


UP = ("takeoff", (0.0, 0.0, 20.0), 0.0)
A, B, C = (60.0, 0.0, 20.0), (60.0, 80.0, 20.0), (0.0, 90.0, 30.0)


@pytest.mark.parametrize(
    ("legs", "index", "departure", "arrival"),
    [
        # from rest; towards the spline after next
        ([UP, ("spline", A, 0), ("spline", B, 0)], 1, (0, 0, 0), (60, 80, 0)),
        # as the spline before arrived; nothing comes after
        ([UP, ("spline", A, 0), ("spline", B, 0)], 2, (60, 80, 0), (0, 0, 0)),
        # the straight leg before and the one after
        ([UP, ("straight", A, 0), ("spline", B, 0), ("straight", C, 0)], 2, (60, 0, 0), (-60, 10, 10)),
        # stops on either side
        ([UP, ("straight", A, 2), ("spline", B, 3), ("spline", C, 0)], 2, (0, 0, 0), (0, 0, 0)),
        ([UP, ("spline", A, 2), ("spline", B, 0), ("spline", C, 0)], 2, (0, 0, 0), (-60, 90, 10)),
        # after a circle
        ([UP, ("circle", A, 0), ("spline", B, 0)], 2, (0, 0, 0), (0, 0, 0)),
        # a spline to where it already is forgets its way
        ([UP, ("spline", UP[1], 0), ("spline", B, 0)], 2, (0, 0, 0), (0, 0, 0)),
    ],
)
def test_tangents(
    legs: list[tuple[LegKind, tuple[float, float, float], float]],
    index: int,
    departure: tuple[float, float, float],
    arrival: tuple[float, float, float],
) -> None:
    start, end = np.array(legs[index - 1][1]), np.array(legs[index][1])
    expected = hermite_bezier(start, end, np.array(departure, dtype=float), np.array(arrival, dtype=float))
    np.testing.assert_allclose(spline_bezier(_sortie(*legs), index), expected, atol=1e-9)


def test_a_short_way_scales_its_tangents_but_hands_on_the_whole_one() -> None:
    sortie = _sortie(UP, ("straight", (100.0, 0.0, 20.0), 0), ("spline", (101.0, 0.0, 20.0), 0), ("spline", B, 0))
    short, after = spline_bezier(sortie, 2), spline_bezier(sortie, 3)
    tangents = 3.0 * np.linalg.norm(short[1] - short[0]) + 3.0 * np.linalg.norm(short[3] - short[2])
    assert tangents == pytest.approx(4.0)
    np.testing.assert_allclose(3.0 * (after[1] - after[0]), np.array(B) - (100.0, 0.0, 20.0))


@pytest.mark.parametrize("name", ["spline00", "spline01", "spline02", "spline5", "F_splinecircle_5"])
def test_recorded_flights_keep_to_the_curve(name: str) -> None:
    """Greatest distances found: 1.00, 0.94, 1.76, 0.37 and 1.09 m; from straight legs 18.9, 30.8, 15.5, 25.2, 4.3."""
    if not (flights.FOLDER / f"{name}.waypoints").exists():
        pytest.skip("recorded flights are not at hand")
    flight = flights.read(name)
    ends = [UP, *(("spline", tuple(end), hold) for end, hold in zip(flight.waypoints_m, flight.hold_s, strict=True))]
    ends[0] = ("takeoff", tuple(flight.top_m), 0.0)
    sortie = _sortie(*ends)
    curve = np.concatenate([spline_chords(sortie, k, 0.01) for k in range(1, len(sortie.legs))])
    flown = (flight.t_s >= flight.begin_s) & (flight.t_s <= np.nanmax(flight.reached_s))
    track = flight.position_m[flown]
    assert len(track) > 300
    assert _distance(track, curve).max() < 1.9
    assert _distance(track, np.stack([leg.end_m for leg in sortie.legs])).max() > 4.0
    assert _distance(curve[::5], track).max() < 2.5  # and all of the curve is flown
