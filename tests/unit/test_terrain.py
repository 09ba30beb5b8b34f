from __future__ import annotations

import math
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import rasterio
from pyproj import Transformer
from rasterio.transform import Affine
from rasterio.warp import Resampling, calculate_default_transform, reproject

from missionplanner.errors import MissionError
from missionplanner.geodesy import LocalFrame
from missionplanner.terrain import Rectangle, flat_terrain, peaks_terrain, read_raster, write_raster
from tests.oracles.surface import surface_amsl_m
from tests.rasters import AREA, FRAME, hill, hill_in, pixels, write_tif

SAN_GABRIEL = Path(__file__).parents[3] / "shared/data/san_gabriel_glo30.tif"
needs_san_gabriel = pytest.mark.skipif(not SAN_GABRIEL.exists(), reason="../shared/data is not here")


def places(count: int, area: Rectangle = AREA, seed: int = 1) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    rng = np.random.default_rng(seed)
    return rng.uniform(area[0], area[2], count), rng.uniform(area[1], area[3], count)


# --- files in any coordinate system


@pytest.mark.parametrize(
    ("crs", "cell"),
    [
        ("EPSG:4326", 1 / 3600 / 3),
        ("EPSG:32611", 10.0),
        ("EPSG:32612", 10.0),  # the neighbouring zone: turned by two degrees
        ("EPSG:3857", 12.0),
        ("EPSG:4269", 1 / 3600 / 3),  # NAD83
        ("EPSG:26945", 10.0),  # NAD83 / California zone 5
        ("EPSG:2229", 33.0),  # the same in US survey feet
        ("EPSG:4267", 1 / 3600 / 3),  # NAD27: 90 m off, had the datum been ignored
        ("+proj=utm +zone=11 +ellps=WGS84 +units=m", 10.0),
        ("EPSG:4326+5773", 1 / 3600 / 3),
    ],
)
def test_a_terrain_is_the_same_in_every_coordinate_system(tmp_path: Path, crs: str, cell: float) -> None:
    terrain = read_raster(hill_in(tmp_path / "hill.tif", crs, cell), FRAME, AREA)
    x, y = places(300)
    assert np.abs(terrain.height_amsl_m(x, y) - hill(x, y)).max() < 0.01
    assert terrain.spacing_m == pytest.approx(9, rel=0.2)


def test_a_rotated_grid_is_read_too(tmp_path: Path) -> None:
    terrain = read_raster(hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0, rotation_deg=30), FRAME, AREA)
    x, y = places(300)
    assert np.abs(terrain.height_amsl_m(x, y) - hill(x, y)).max() < 0.01
    assert terrain.spacing_m == pytest.approx(10, rel=0.01)


@needs_san_gabriel
def test_real_terrain_agrees_with_the_book() -> None:
    area = (-9000.0, -8000.0, 9000.0, 9000.0)
    terrain = read_raster(SAN_GABRIEL, FRAME, area)
    x, y = places(150, area)
    expected = [surface_amsl_m(SAN_GABRIEL, FRAME, a, b) for a, b in zip(x, y, strict=True)]
    assert np.abs(terrain.height_amsl_m(x, y) - expected).max() < 2e-3
    assert terrain.height_amsl_m(0.0, 0.0) == pytest.approx(1519, abs=0.01)


@needs_san_gabriel
@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")  # rasterio's own
def test_real_terrain_reprojected_keeps_its_heights(tmp_path: Path) -> None:
    path = tmp_path / "utm.tif"
    with rasterio.open(SAN_GABRIEL) as source:
        transform, width, height = calculate_default_transform(
            source.crs, "EPSG:32611", source.width, source.height, *source.bounds, resolution=10
        )
        out = np.full((height, width), -9999, dtype=np.float32)
        reproject(
            rasterio.band(source, 1), out, src_transform=source.transform, src_crs=source.crs, dst_transform=transform,
            dst_crs="EPSG:32611", dst_nodata=-9999, resampling=Resampling.cubic,
        )  # fmt: skip
    write_tif(path, out, transform, "EPSG:32611", nodata=-9999)
    area = (-5000.0, -5000.0, 5000.0, 5000.0)
    a, b = read_raster(SAN_GABRIEL, FRAME, area), read_raster(path, FRAME, area)
    x, y = places(2000, area)
    difference = a.height_amsl_m(x, y) - b.height_amsl_m(x, y)
    assert np.median(np.abs(difference)) < 0.25  # the copy was resampled; half a cell of shift would make it 6 m
    assert np.abs(difference).max() < 3.0
    assert abs(difference.mean()) < 0.05


def test_heights_are_exact_at_the_samples(tmp_path: Path) -> None:
    heights = np.random.default_rng(3).uniform(100, 3000, (40, 50)).astype(np.float32)
    transform = Affine(30, 0, 380_000, 0, -30, 3_802_000)
    path = write_tif(tmp_path / "t.tif", heights, transform, "EPSG:32611")
    lon, lat = Transformer.from_crs(32611, 4326, always_xy=True).transform(380_000 + 30 * 25.5, 3_802_000 - 30 * 20.5)
    frame = LocalFrame(lat, lon)
    terrain = read_raster(path, frame, (-100.0, -100.0, 100.0, 100.0))
    assert terrain.height_amsl_m(0.0, 0.0) == pytest.approx(heights[20, 25], abs=1e-3)


@pytest.mark.parametrize(("samples", "name"), [(3601, "N34W119.hgt"), (1201, "N34W119.hgt")])
def test_hgt_files_are_read(tmp_path: Path, samples: int, name: str) -> None:
    lon, lat = np.linspace(-119, -118, samples), np.linspace(35, 34, samples)
    heights = np.round(2000 * (lat[:, None] - 34) + 1500 * (lon + 119))
    heights[:5] = -32768
    path = tmp_path / name
    heights.astype(">i2").tofile(path)
    terrain = read_raster(path, FRAME, AREA)
    x, y = places(200)
    lat, lon, _ = FRAME.to_geo(np.stack([x, y, np.zeros_like(x)], axis=-1))
    assert (
        np.abs(terrain.height_amsl_m(x, y) - (2000 * (lat - 34) + 1500 * (lon + 119))).max() < 0.7
    )  # half a cell: 0.9
    north = LocalFrame(34.999, -118.5)
    assert np.isnan(read_raster(path, north, (-500, -500, 500, 90)).height_amsl_m(0.0, 80.0))


@pytest.mark.parametrize("shift", [0.0, 360.0, -360.0])
def test_the_antimeridian_is_a_meridian_like_others(tmp_path: Path, shift: float) -> None:
    frame = LocalFrame(-17.0, 179.999)
    size, cell = 200, 1 / 3600
    transform = Affine(cell, 0, 180 - size / 2 * cell + shift, 0, -cell, -17 + size / 2 * cell)
    lon, lat = pixels(transform, size)
    local = frame.to_local(lat, (lon + 180) % 360 - 180, 0.0)
    path = write_tif(
        tmp_path / "fiji.tif", hill(local[..., 0], local[..., 1]).astype(np.float32), transform, "EPSG:4326"
    )
    terrain = read_raster(path, frame, (-1000.0, -1000.0, 1000.0, 1000.0))
    x, y = places(200, (-1000.0, -1000.0, 1000.0, 1000.0))
    assert np.abs(terrain.height_amsl_m(x, y) - hill(x, y)).max() < 0.05


# --- what a file may say of its heights


def test_feet_become_metres(tmp_path: Path) -> None:
    for unit, metres in (("ft", 0.3048), ("US survey foot", 1200 / 3937), ("metre", 1.0)):
        path = hill_in(
            tmp_path / "ft.tif", "EPSG:32611", 10.0, change=lambda h, m=metres: (h / m).astype("f4"), units=unit
        )
        assert np.abs(read_raster(path, FRAME, AREA).height_amsl_m(*places(50)) - hill(*places(50))).max() < 0.01


def test_the_vertical_unit_of_the_coordinate_system_counts(tmp_path: Path) -> None:
    path = hill_in(
        tmp_path / "ft.tif",
        "EPSG:2229",
        33.0,
        change=lambda h: (h * 3937 / 1200).astype("f4"),
        write_crs="EPSG:2229+6360",
    )
    assert np.abs(read_raster(path, FRAME, AREA).height_amsl_m(*places(50)) - hill(*places(50))).max() < 0.01


def test_scale_and_offset_are_applied(tmp_path: Path) -> None:
    path = hill_in(
        tmp_path / "s.tif",
        "EPSG:32611",
        10.0,
        change=lambda h: np.round((h - 500) / 0.01).astype("i4"),
        scale=(0.01, 500),
    )
    assert np.abs(read_raster(path, FRAME, AREA).height_amsl_m(*places(50)) - hill(*places(50))).max() < 0.02


def test_heights_above_the_ellipsoid_need_the_undulation(tmp_path: Path) -> None:
    path = hill_in(tmp_path / "h.tif", "EPSG:4979", 1 / 3600 / 3)
    with pytest.raises(MissionError, match=r"h\.tif: expected heights above mean sea level.*geoid_undulation_m"):
        read_raster(path, FRAME, AREA)
    terrain = read_raster(path, FRAME, AREA, geoid_undulation_m=-33.0)
    assert np.abs(terrain.height_amsl_m(*places(50)) - hill(*places(50)) - 33).max() < 0.01


def test_heights_known_to_be_amsl_refuse_an_undulation(tmp_path: Path) -> None:
    path = hill_in(tmp_path / "h.tif", "EPSG:4326+5773", 1 / 3600 / 3)
    with pytest.raises(MissionError, match=r"geoid_undulation_m: expected none for h\.tif, whose heights are 'EGM96"):
        read_raster(path, FRAME, AREA, geoid_undulation_m=-33.0)


# --- voids and coverage


@pytest.mark.parametrize(
    ("value", "dtype", "nodata"),
    [
        (-9999, np.float32, -9999),
        (-32768, np.int16, -32768),
        (-32768, np.int16, None),
        (-9999, np.float32, None),
        (math.nan, np.float32, None),
        (math.nan, np.float32, math.nan),
        (math.inf, np.float32, None),
        (3.4e38, np.float32, None),
        (0, np.uint16, 0),
    ],
)
def test_voids_are_unknown_and_never_zero(tmp_path: Path, value: float, dtype: Any, nodata: float | None) -> None:
    def punch(heights: npt.NDArray[Any]) -> npt.NDArray[Any]:
        middle = heights.shape[0] // 2
        heights[middle - 3 : middle + 3, middle - 3 : middle + 3] = value
        return heights

    path = hill_in(tmp_path / "v.tif", "EPSG:32611", 10.0, dtype=dtype, change=punch, nodata=nodata)
    terrain = read_raster(path, FRAME, AREA)
    x, y = (0.5 * (AREA[k] + AREA[k + 2]) for k in (0, 1))
    assert np.isnan(terrain.height_amsl_m(x, y))
    assert terrain.reaches(x, y)
    with pytest.raises(MissionError, match=r"vehicles\[1\]\.goal: expected a height below it, got a void of v\.tif"):
        terrain.ground_amsl_m(x, y, "vehicles[1].goal")
    assert terrain.ground_amsl_m(x + 60, y, "start") == pytest.approx(hill(x + 60, y), abs=1.0)
    assert np.isfinite(terrain.height_amsl_m(*places(500))).mean() > 0.97


def test_outside_the_file_is_an_error_and_never_zero(tmp_path: Path) -> None:
    terrain = read_raster(hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0), FRAME, AREA)
    assert np.isnan(terrain.height_amsl_m([5000.0, 0.0], [0.0, -5000.0])).all()
    assert not terrain.reaches(5000.0, 0.0)
    with pytest.raises(
        MissionError, match=r"goal: expected a place within the terrain, got x 5000 m, y 0 m .* hill\.tif"
    ):
        terrain.ground_amsl_m(5000.0, 0.0, "goal")


def test_reaches_is_where_heights_are(tmp_path: Path) -> None:
    area = (-3000.0, -3000.0, 3000.0, 3000.0)
    terrain = read_raster(hill_in(tmp_path / "hill.tif", "EPSG:32612", 10.0), FRAME, area)
    x, y = places(2000, area)
    reached = terrain.reaches(x, y)
    assert 0.1 < reached.mean() < 0.9
    assert np.array_equal(reached, np.isfinite(terrain.height_amsl_m(x, y)))


def test_the_whole_area_is_covered_up_to_its_edge(tmp_path: Path) -> None:
    terrain = read_raster(hill_in(tmp_path / "hill.tif", "EPSG:32612", 10.0), FRAME, AREA)
    x, y = np.meshgrid(np.linspace(AREA[0], AREA[2], 50), np.linspace(AREA[1], AREA[3], 50))
    assert np.isfinite(terrain.height_amsl_m(x, y)).all()


def test_an_area_beside_the_file_is_told_with_both_places(tmp_path: Path) -> None:
    path = hill_in(tmp_path / "hill.tif", "EPSG:32611", 10.0)
    with pytest.raises(
        MissionError, match=r"hill\.tif: .* lies at 35\.\d+ to .* got a file of 34\.3\d+ to 34\.3"
    ) as raised:
        read_raster(path, LocalFrame(35.35, -118.2), AREA)
    assert "\n" not in str(raised.value)


def test_only_the_window_of_the_area_is_read(tmp_path: Path) -> None:
    path = tmp_path / "huge.tif"
    with rasterio.open(
        path, "w", driver="GTiff", count=1, height=10_000, width=10_000, dtype="int16", crs="EPSG:32611", tiled=True,
        transform=Affine(10, 0, 340_000, 0, -10, 3_850_000), sparse_ok=True, compress="deflate",
    ):  # fmt: skip
        pass
    tracemalloc.start()
    terrain = read_raster(path, FRAME, AREA)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert terrain.arrays.height_amsl_m.size < 60_000
    assert peak < 5_000_000
    assert terrain.ground_amsl_m(0, 0, "start") == 0.0  # a sparse file holds real zeros
    problem = r"expected at most \d+ cells below the area, got \d+: give a smaller area"
    with pytest.MonkeyPatch.context() as patch, pytest.raises(MissionError, match=problem):
        patch.setattr("missionplanner.terrain._MAX_CELLS", 1000)
        read_raster(path, FRAME, AREA)


def test_an_area_that_does_not_map_smoothly_is_refused(tmp_path: Path) -> None:
    path = hill_in(tmp_path / "hill.tif", "EPSG:4326", 1e-5, room=-780.0)
    with pytest.raises(MissionError, match=r"got 1200 x 1200 km with an error of .* cells: make the area smaller"):
        read_raster(path, FRAME, (-6e5, -6e5, 6e5, 6e5))


# --- files that are no terrain


def test_files_that_are_no_elevation_model_are_refused_in_one_line(tmp_path: Path) -> None:
    here = Affine(10, 0, 389_000, 0, -10, 3_803_000)
    square = np.full((500, 500), 700, dtype=np.int16)
    text = tmp_path / "notes.tif"
    text.write_text("not a raster")
    empty = tmp_path / "empty.tif"
    empty.touch()
    whole = write_tif(tmp_path / "whole.tif", np.random.default_rng(0).random((500, 500)), here, "EPSG:32611")
    cut = tmp_path / "cut.tif"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 3])
    local = 'LOCAL_CS["site",UNIT["metre",1],AXIS["x",EAST],AXIS["y",NORTH]]'
    cases = {
        tmp_path / "none.tif": "expected an elevation file (GeoTIFF, HGT), got no such file: ",
        tmp_path: "expected an elevation file (GeoTIFF, HGT), got a folder: ",
        text: "expected an elevation file (GeoTIFF, HGT), got: ",
        empty: "expected an elevation file (GeoTIFF, HGT), got: ",
        cut: "expected an elevation file (GeoTIFF, HGT), got: ",
        write_tif(
            tmp_path / "rgb.tif", np.zeros((3, 9, 9), np.uint8), here, "EPSG:32611"
        ): "got 3 bands of uint8: extract",
        write_tif(tmp_path / "c.tif", np.zeros((9, 9), np.complex64), here, "EPSG:32611"): "got 1 bands of complex64",
        write_tif(tmp_path / "nocrs.tif", square, here, None): "got one without coordinate reference system: set it",
        write_tif(tmp_path / "fathom.tif", square, here, "EPSG:32611", units="fathom"): "got the unit 'fathom'",
        write_tif(
            tmp_path / "local.tif", square, here, local
        ): "expected a coordinate reference system that PROJ ties to",
    }
    for path, problem in cases.items():
        with pytest.raises(MissionError) as raised:
            read_raster(path, FRAME, (-100.0, -100.0, 100.0, 100.0))
        message = str(raised.value)
        assert problem in message, path
        assert message.startswith("terrain.file")
        assert "\n" not in message


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_raster_without_a_place_on_earth_is_refused(tmp_path: Path) -> None:
    path = write_tif(tmp_path / "nowhere.tif", np.zeros((9, 9), np.int16), Affine.identity(), "EPSG:4326")
    with pytest.raises(MissionError, match=r"nowhere\.tif: expected a raster that knows its place on earth"):
        read_raster(path, FRAME, AREA)


# --- writing


@pytest.mark.parametrize(
    ("crs", "cell", "area"),
    [
        ("EPSG:4326", 1 / 3600, AREA),
        ("EPSG:32612", 10.0, AREA),
        ("EPSG:32612", 10.0, (-1400.0, -2500.0, 1300.0, 900.0)),
        ("EPSG:2229+6360", 33.0, AREA),
    ],
)
def test_a_crop_is_read_bit_for_bit_as_the_whole(tmp_path: Path, crs: str, cell: float, area: Rectangle) -> None:
    def punch(heights: npt.NDArray[Any]) -> npt.NDArray[Any]:
        heights[100:104, 100:110] = np.nan
        return heights

    notice = {"ATTRIBUTION": "(c) somebody"}
    path = hill_in(tmp_path / "hill.tif", crs.partition("+")[0], cell, write_crs=crs, change=punch, tags=notice)
    whole = read_raster(path, FRAME, area)
    write_raster(tmp_path / "crop.tif", whole)
    crop = read_raster(tmp_path / "crop.tif", FRAME, area)
    assert np.array_equal(crop.arrays.height_amsl_m, whole.arrays.height_amsl_m, equal_nan=True)
    assert np.array_equal(crop.arrays.to_cell, whole.arrays.to_cell)
    assert crop.reference == whole.reference
    assert ("ATTRIBUTION", "(c) somebody") in crop.reference.tags
    write_raster(tmp_path / "again.tif", crop)
    assert (tmp_path / "again.tif").read_bytes() == (tmp_path / "crop.tif").read_bytes()


def test_terrain_made_here_can_be_written_and_read(tmp_path: Path) -> None:
    terrain = peaks_terrain([(100.0, 50.0, 300.0, 400.0)], 100.0, 10.0, FRAME, AREA)
    write_raster(tmp_path / "peaks.tif", terrain)
    again = read_raster(tmp_path / "peaks.tif", FRAME, AREA)
    x, y = places(200)
    assert np.abs(again.height_amsl_m(x, y) - terrain.height_amsl_m(x, y)).max() < 1e-6


def test_a_terrain_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MissionError, match="expected a folder that can be written to"):
        write_raster(tmp_path / "file" / "t.tif", flat_terrain(1.0, FRAME, AREA))


# --- terrain made here


def test_peaks_are_the_sum_that_they_say() -> None:
    peaks = [(0.0, 0.0, 200.0, 300.0), (500.0, -200.0, 150.0, 250.0)]
    terrain = peaks_terrain(peaks, 400.0, 5.0, FRAME, AREA)
    x, y = places(500)
    expected = 400 + sum(h * np.exp(-((x - a) ** 2 + (y - b) ** 2) / s**2) for a, b, h, s in peaks)
    assert np.abs(terrain.height_amsl_m(x, y) - expected).max() < 0.01
    assert terrain.spacing_m == 5.0


@pytest.mark.parametrize("area", [AREA, (0.0, 0.0, 0.5, 0.5), (-5e4, -5e4, 5e4, 5e4), (10.0, 10.0, 10.0, 10.0)])
def test_level_ground_is_level_all_over_the_area(area: Rectangle) -> None:
    terrain = flat_terrain(488.0, FRAME, area)
    x, y = np.meshgrid(np.linspace(area[0], area[2], 20), np.linspace(area[1], area[3], 20))
    assert np.abs(terrain.height_amsl_m(x, y) - 488.0).max() < 1e-9
    assert terrain.arrays.height_amsl_m.size < 400_000


def test_a_grid_that_would_fill_the_memory_is_refused() -> None:
    with pytest.raises(MissionError, match=r"terrain\.cell_m: expected at most .* cells in the area"):
        peaks_terrain([(0.0, 0.0, 1.0, 1.0)], 0.0, 0.01, FRAME, AREA)
