"""The pinhole: by hand, against rays through a lens, and against what makers say of their cameras."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from missionplanner import camera, mission
from missionplanner.camera import PRESETS, CameraModel
from missionplanner.errors import MissionError

lenses = st.builds(
    CameraModel,
    name=st.just("any"),
    focal_length_mm=st.floats(2.0, 200.0),
    sensor_width_mm=st.floats(4.0, 50.0),
    sensor_height_mm=st.floats(3.0, 40.0),
    image_width_px=st.integers(640, 12_000),
    image_height_px=st.integers(480, 9_000),
    interval_min_s=st.floats(0.1, 5.0),
    overlap_share=st.floats(0.0, 0.95),
)
distances = st.floats(1.0, 500.0)


def test_a_full_frame_camera_with_35_mm_by_hand() -> None:
    lens = PRESETS["dji_p1_35mm"]
    assert lens.gsd_mm(100.0) == pytest.approx(12.56, abs=0.02)  # 4.4 micrometres times 100 m over 35 mm
    assert lens.footprint_m(35.0) == pytest.approx((35.9, 24.0))
    assert replace(lens, overlap_share=0.8).spacing_m(35.0) == pytest.approx(7.18)
    assert replace(lens, overlap_share=0.8, interval_min_s=2.0).speed_max_m_s(35.0) == pytest.approx(3.59)


@pytest.mark.parametrize(
    ("preset", "diagonal_deg"),  # as their makers state it
    [
        ("dji_p1_24mm", 84.0),
        ("dji_p1_35mm", 63.5),
        ("dji_p1_50mm", 46.8),
        ("dji_h20_wide", 82.9),
        ("dji_mavic3e_wide", 84.0),
        ("dji_mavic3e_tele", 15.0),
        ("dji_phantom4_rtk", 84.0),
        ("sony_rx0m2", 84.0),
        ("sony_rx1rm2", 63.0),
    ],
)
def test_presets_see_as_much_as_their_makers_say(preset: str, diagonal_deg: float) -> None:
    lens = PRESETS[preset]
    half_mm = 0.5 * math.hypot(lens.sensor_width_mm, lens.sensor_height_mm)
    assert 2.0 * math.degrees(math.atan(half_mm / lens.focal_length_mm)) == pytest.approx(diagonal_deg, abs=2.0)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_presets_have_square_pixels(preset: str) -> None:
    lens = PRESETS[preset]
    ratio = lens.sensor_width_mm / lens.image_width_px / (lens.sensor_height_mm / lens.image_height_px)
    assert ratio == pytest.approx(1.0, abs=0.02)


@given(lenses, distances)
def test_what_a_photo_shows_is_what_rays_through_the_lens_hit(lens: CameraModel, distance_m: float) -> None:
    corners_mm = np.array([lens.sensor_width_mm, lens.sensor_height_mm]) / 2.0
    hit_m = corners_mm * distance_m / lens.focal_length_mm  # similar triangles
    assert lens.footprint_m(distance_m) == pytest.approx(tuple(2.0 * hit_m))
    seen_deg = np.degrees(2.0 * np.arctan2(hit_m, distance_m))
    assert lens.field_of_view_deg == pytest.approx(tuple(seen_deg))


@given(lenses, distances, st.floats(1.1, 10.0))
def test_a_pixel_covers_in_proportion_to_the_distance(lens: CameraModel, distance_m: float, times: float) -> None:
    assert lens.gsd_mm(times * distance_m) == pytest.approx(times * lens.gsd_mm(distance_m))
    assert lens.distance_m(lens.gsd_mm(distance_m)) == pytest.approx(distance_m)
    pixels = max(
        1000.0 * lens.footprint_m(distance_m)[0] / lens.image_width_px,
        1000.0 * lens.footprint_m(distance_m)[1] / lens.image_height_px,
    )
    assert lens.gsd_mm(distance_m) == pytest.approx(pixels)


@given(lenses, distances)
def test_photos_so_far_apart_overlap_as_they_shall(lens: CameraModel, distance_m: float) -> None:
    width_m, _ = lens.footprint_m(distance_m)
    common_m = width_m - lens.spacing_m(distance_m)
    assert common_m / width_m == pytest.approx(lens.overlap_share, abs=1e-9)
    assert lens.speed_max_m_s(distance_m) * lens.interval_min_s == pytest.approx(lens.spacing_m(distance_m))


def test_a_camera_whose_interval_is_not_stated_is_always_fast_enough() -> None:
    assert replace(PRESETS["dji_p1_35mm"], interval_min_s=0.0).speed_max_m_s(1.0) == math.inf


def test_no_camera_is_none() -> None:
    assert camera.of(None) is None


def test_a_preset_gives_way_to_what_is_said_besides() -> None:
    found = camera.of(mission.Camera(preset="sony_rx0m2", interval_min_s=2.5, gsd_max_mm=3.0, overlap_share=0.5))
    assert found == replace(PRESETS["sony_rx0m2"], interval_min_s=2.5, gsd_max_mm=3.0, overlap_share=0.5)


def test_a_camera_may_be_given_by_its_numbers() -> None:
    numbers = {
        "focal_length_mm": 35.0,
        "sensor_width_mm": 35.9,
        "sensor_height_mm": 24.0,
        "image_width_px": 8192,
        "image_height_px": 5460,
    }
    found = camera.of(mission.Camera.model_validate(numbers))
    assert found is not None
    assert found.gsd_mm(20.0) == pytest.approx(PRESETS["dji_p1_35mm"].gsd_mm(20.0))
    del numbers["image_width_px"], numbers["focal_length_mm"]
    with pytest.raises(MissionError, match="got no focal_length_mm, image_width_px: add them"):
        camera.of(mission.Camera.model_validate(numbers))


@pytest.mark.parametrize(
    ("preset", "hint"), [("sony_rx0", "did you mean sony_rx0m2"), ("xyzzy", "known are dji_p1_24mm")]
)
def test_an_unknown_preset_is_told_what_is_known(preset: str, hint: str) -> None:
    with pytest.raises(MissionError, match=f"inspection.camera.preset: .*got '{preset}': {hint}"):
        camera.of(mission.Camera(preset=preset))
