"""The ground: elevation grids from files or made here, interpolated by bicubic convolution (Keys 1981, a = -1/2).

A file's grid is used as it is, in its own coordinate system: what is fitted is the way from the local frame to rows and
columns, never the heights. Where there is no height (outside, or a void in the file) the ground is NaN, never zero.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import rasterio
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.transform import Affine
from rasterio.windows import Window

from missionplanner import kernels
from missionplanner.errors import MissionError
from missionplanner.files import replacing
from missionplanner.geodesy import FloatArray, LocalFrame
from missionplanner.kernels import TerrainArrays
from missionplanner.terrain_bounds import Pyramid, pyramid

Rectangle = tuple[float, float, float, float]
"""West, south, east, north in the local frame, metres."""

_LOWEST_M, _HIGHEST_M = -500.0, 9000.0  # of all land; what lies beyond is a void that nobody declared (-9999, -32768)
_MARGIN_CELLS = 3
_STENCIL = 4
_MAX_CELLS = 150_000_000
_STRIP_CELLS = 4_000_000
_CACHE_BYTES = 64_000_000
"""What GDAL keeps of a file that is read once; left to itself it takes a twentieth of the machine's memory."""
_FIT_TOLERANCE_CELLS = 0.02
_FIT_REACH_M = 2000.0
_FEET_M = {"ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "us survey foot": 1200 / 3937, "ftus": 1200 / 3937}
_METRES = {"", "m", "metre", "meter", "metres", "meters"}


@dataclass(frozen=True, slots=True)
class GridReference:
    """Where a grid of heights lies on earth, in the terms of raster files."""

    crs_wkt: str
    transform: tuple[float, float, float, float, float, float]  # a, b, c, d, e, f of x = a col + b row + c, y = ...
    tags: tuple[tuple[str, str], ...] = ()  # e.g. the data's licence notice


@dataclass(frozen=True, slots=True, eq=False)
class Terrain:
    """An elevation grid over the mission's area."""

    arrays: TerrainArrays
    bounds: Pyramid
    spacing_m: float  # the lesser distance between neighbouring samples
    description: str
    reference: GridReference

    def height_amsl_m(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> FloatArray:
        """Return the ground's altitudes (...) at places (...); NaN outside the grid and at voids."""
        x, y = np.broadcast_arrays(np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64))
        xy = np.stack([x.ravel(), y.ravel()], axis=1)
        heights: FloatArray = kernels.terrain_heights(self.arrays, xy)
        return heights.reshape(x.shape)

    def ground_amsl_m(self, x_m: float, y_m: float, what: str) -> float:
        """Return the ground's altitude at one place; ``what`` names the place in errors.

        Raises
        ------
        MissionError
            The place is outside the grid, or at a void.
        """
        height = float(kernels.terrain_height(self.arrays, x_m, y_m))
        if not math.isnan(height):
            return height
        where = f"x {x_m:.0f} m, y {y_m:.0f} m from the origin"
        if self.reaches(x_m, y_m):
            remedy = "fill the voids (e.g. gdal_fillnodata) or move it"
            raise MissionError(
                f"{what}: expected a height below it, got a void of {self.description} at {where}: {remedy}"
            )
        raise MissionError(
            f"{what}: expected a place within the terrain, got {where}, outside {self.description}: "
            "move it or give a terrain that covers it"
        )

    def reaches(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Return whether places (...) lie within the grid, be it at a void."""
        x, y = np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64)
        row, col = np.moveaxis(_monomials(x, y) @ self.arrays.to_cell.T, -1, 0)
        rows, cols = self.arrays.height_amsl_m.shape
        inside: npt.NDArray[np.bool_] = (row >= 1) & (row < rows - 2) & (col >= 1) & (col < cols - 2)
        return inside


def read_raster(path: Path, frame: LocalFrame, area: Rectangle, geoid_undulation_m: float | None = None) -> Terrain:
    """Read the part of an elevation file (GeoTIFF, HGT, any that GDAL reads; any CRS) that covers an area.

    Heights are taken as AMSL unless ``geoid_undulation_m`` is given, which is subtracted. Voids become NaN: the file's
    no-data value, and anything below -500 m or above 9000 m. Only the window of the area is read.

    Raises
    ------
    MissionError
        No such file; not a raster of heights; no place on earth; heights above the ellipsoid without
        ``geoid_undulation_m``; nothing of the area covered; an area too large.
    """
    if not path.is_file():
        what = "a folder" if path.is_dir() else "no such file"
        raise MissionError(f"terrain.file: expected an elevation file (GeoTIFF, HGT), got {what}: {path}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)  # ours says what to do
            with rasterio.Env(GDAL_CACHEMAX=_CACHE_BYTES), rasterio.open(path) as dataset:
                return _read(dataset, path.name, frame, area, geoid_undulation_m)
    except (RasterioError, OSError) as error:
        reason = " ".join(str(error).split())
        raise MissionError(f"terrain.file: expected an elevation file (GeoTIFF, HGT), got: {reason}") from error


def _read(
    dataset: rasterio.DatasetReader, name: str, frame: LocalFrame, area: Rectangle, geoid_undulation_m: float | None
) -> Terrain:
    if dataset.count != 1 or np.dtype(dataset.dtypes[0]).kind not in "iuf":
        got = f"{dataset.count} bands of {dataset.dtypes[0]}"
        raise MissionError(
            f"terrain.file {name}: expected one band of heights, got {got}: extract it (gdal_translate -b)"
        )
    if dataset.crs is None or dataset.transform.is_identity:
        raise MissionError(
            f"terrain.file {name}: expected a raster that knows its place on earth, got one without coordinate "
            "reference system: set it (gdal_edit.py -a_srs -a_ullr)"
        )
    crs = CRS.from_user_input(dataset.crs.to_wkt())
    metres_per_unit = _metres_per_unit(dataset.units[0] or "", crs, name)
    _check_datum(crs, name, geoid_undulation_m)
    horizontal = crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()

    corners = _corners(dataset)
    to_crs = _Way(frame, horizontal, float(corners[0].mean()), name)
    window = _window(dataset, to_crs(*_lattice(area, 65)))
    if window is None:
        raise MissionError(
            f"terrain.file {name}: expected terrain below the mission, which lies at {_span(*_geo(frame, area))}, "
            f"got a file of {_span(*to_crs.geo(*corners))}"
        )
    if window.height * window.width > _MAX_CELLS:
        raise MissionError(
            f"terrain.file {name}: expected at most {_MAX_CELLS} cells below the area, got "
            f"{window.height * window.width}: give a smaller area, or a coarser terrain"
        )

    a, b, c, d, e, f = dataset.transform[:6]
    left, top = window.col_off, window.row_off
    transform = Affine(a, b, c + a * left + b * top, d, e, f + d * left + e * top)
    to_cell = _cells(_fit(to_crs, area, transform, name), transform)
    heights = _heights_m(dataset, window, metres_per_unit, geoid_undulation_m or 0.0)
    spacing_m = _spacing_m(to_cell, area)
    arrays = TerrainArrays(heights, to_cell)
    return Terrain(
        arrays=arrays,
        bounds=pyramid(arrays, _reach_m(area)),
        spacing_m=spacing_m,
        description=f"{name} ({window.height} x {window.width} samples {spacing_m:.3g} m apart)",
        reference=GridReference(
            crs_wkt=horizontal.to_wkt(),
            transform=tuple(transform)[:6],
            tags=tuple(sorted((k, v) for k, v in dataset.tags().items() if k != "AREA_OR_POINT")),
        ),
    )


def _window(dataset: rasterio.DatasetReader, coordinates: tuple[FloatArray, FloatArray]) -> Window | None:
    """Return the part of a file that holds these coordinates with their neighbours; None if there is none."""
    a, b, c, d, e, f = (~dataset.transform)[:6]
    col, row = a * coordinates[0] + b * coordinates[1] + c - 0.5, d * coordinates[0] + e * coordinates[1] + f - 0.5
    if not (np.isfinite(row).all() and np.isfinite(col).all()):
        return None
    top, left = (max(0, math.floor(v.min()) - _MARGIN_CELLS) for v in (row, col))
    bottom = min(dataset.height, math.ceil(row.max()) + _MARGIN_CELLS + 1)
    right = min(dataset.width, math.ceil(col.max()) + _MARGIN_CELLS + 1)
    if bottom - top < _STENCIL or right - left < _STENCIL:
        return None
    return Window(left, top, right - left, bottom - top)


def _heights_m(
    dataset: rasterio.DatasetReader, window: Window, metres_per_unit: float, undulation_m: float
) -> npt.NDArray[np.float32]:
    """Return heights AMSL (R, C) of a window, NaN at voids; reads in strips, to hold little more than these."""
    heights = np.empty((window.height, window.width), dtype=np.float32)
    rows = max(1, _STRIP_CELLS // window.width)
    for start in range(0, window.height, rows):
        strip = Window(window.col_off, window.row_off + start, window.width, min(rows, window.height - start))
        h = dataset.read(1, window=strip) * (dataset.scales[0] * metres_per_unit)
        h += dataset.offsets[0] * metres_per_unit - undulation_m
        h[(dataset.read_masks(1, window=strip) == 0) | ~((h > _LOWEST_M) & (h < _HIGHEST_M))] = np.nan
        heights[start : start + rows] = h
    return heights


def write_raster(path: Path, terrain: Terrain) -> None:
    """Write a terrain as GeoTIFF, metres AMSL, without loss: reading it for the same area gives the same heights.

    Raises
    ------
    MissionError
        The file cannot be written.
    """
    heights = terrain.arrays.height_amsl_m
    profile = {
        "driver": "GTiff",
        "height": heights.shape[0],
        "width": heights.shape[1],
        "count": 1,
        "dtype": "float32",
        "nodata": math.nan,
        "crs": terrain.reference.crs_wkt,
        "transform": Affine(*terrain.reference.transform),
        "compress": "deflate",
        "predictor": 3,
        "bigtiff": "if_safer",
    }
    with replacing(path) as draft, rasterio.open(draft, "w", **profile) as dataset:
        dataset.update_tags(**dict(terrain.reference.tags))
        dataset.units = ("m",)
        dataset.write(heights, 1)


def peaks_terrain(
    peaks: Sequence[tuple[float, float, float, float]],
    base_amsl_m: float,
    cell_m: float,
    frame: LocalFrame,
    area: Rectangle,
) -> Terrain:
    """Return Gaussian peaks (x, y, height, spread in metres) summed over a plane: ``height exp(-(d / spread)^2)``.

    Raises
    ------
    MissionError
        So small a cell that the grid would not fit into memory.
    """
    x, y = _local_axes(cell_m, area)
    heights = np.full((len(y), len(x)), base_amsl_m)
    for peak_x, peak_y, height_m, spread_m in peaks:
        along_y, along_x = np.exp(-(((y - peak_y) / spread_m) ** 2)), np.exp(-(((x - peak_x) / spread_m) ** 2))
        heights += height_m * along_y[:, None] * along_x
    return _local_terrain(heights, x, y, frame, f"terrain of {len(peaks)} Gaussian peaks")


def flat_terrain(alt_amsl_m: float, frame: LocalFrame, area: Rectangle) -> Terrain:
    """Return level ground."""
    x, y = _local_axes(max(30.0, (area[2] - area[0]) / 500, (area[3] - area[1]) / 500), area)
    return _local_terrain(np.full((len(y), len(x)), alt_amsl_m), x, y, frame, "flat terrain")


def _local_axes(cell_m: float, area: Rectangle) -> tuple[FloatArray, FloatArray]:
    """Return x eastward and y southward, as rasters run, reaching beyond the area."""
    west, south, east, north = area
    cells = [math.ceil((high - low) / cell_m) + 2 * _MARGIN_CELLS + 1 for low, high in ((west, east), (south, north))]
    if cells[0] * cells[1] > _MAX_CELLS:
        raise MissionError(
            f"terrain.cell_m: expected at most {_MAX_CELLS} cells in the area, got {cells[0] * cells[1]}: "
            "make the cells larger or the area smaller"
        )
    x = west + cell_m * (np.arange(cells[0], dtype=np.float64) - _MARGIN_CELLS)
    y = north - cell_m * (np.arange(cells[1], dtype=np.float64) - _MARGIN_CELLS)
    return x, y


def _local_terrain(heights: FloatArray, x: FloatArray, y: FloatArray, frame: LocalFrame, description: str) -> Terrain:
    cell_m = float(x[1] - x[0])
    to_cell = np.zeros((2, 10))
    to_cell[0, 0], to_cell[0, 2] = y[0] / cell_m, -1e4 / cell_m
    to_cell[1, 0], to_cell[1, 1] = -x[0] / cell_m, 1e4 / cell_m
    transform = (cell_m, 0.0, float(x[0]) - cell_m / 2, 0.0, -cell_m, float(y[0]) + cell_m / 2)
    arrays = TerrainArrays(np.ascontiguousarray(heights, dtype=np.float32), to_cell)
    return Terrain(
        arrays=arrays,
        bounds=pyramid(arrays, float(max(np.abs(x).max(), np.abs(y).max()))),
        spacing_m=cell_m,
        description=description,
        reference=GridReference(frame.crs.to_wkt(), transform),
    )


# --- from the local frame to a file's rows and columns -------------------------------------------------------------


class _Way:
    """Local places to coordinates of a file, through WGS84 so that a change of datum is made and not forgotten."""

    def __init__(self, frame: LocalFrame, crs: CRS, middle: float, name: str) -> None:
        self._frame = frame
        wgs84 = CRS.from_epsg(4326)
        # On these ellipsoids a datum that PROJ cannot tie to WGS84 is within metres of it; on others, hundreds off
        harmless = crs.ellipsoid is not None and crs.ellipsoid.name.replace(" ", "") in {"WGS84", "GRS1980"}
        try:
            self._transformer = Transformer.from_crs(wgs84, crs, always_xy=True, allow_ballpark=harmless)
        except ProjError as error:
            raise MissionError(
                f"terrain.file {name}: expected a coordinate reference system that PROJ ties to WGS84, got "
                f"{crs.name!r}: reproject the file (gdalwarp -t_srs EPSG:4326)"
            ) from error
        self._turn = 2 * math.pi / crs.axis_info[0].unit_conversion_factor if crs.is_geographic else None
        self._middle = middle

    def __call__(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        lat_deg, lon_deg, _ = self._frame.to_geo(np.stack([x_m, y_m, np.zeros_like(x_m)], axis=-1))
        across, along = self._transformer.transform(lon_deg, lat_deg)
        if self._turn is not None:  # no jump at the antimeridian, and counted as the file counts
            across = across[0] + (across - across[0] + self._turn / 2) % self._turn - self._turn / 2
            across += self._turn * round((self._middle - across[0]) / self._turn)
        return across, along

    def geo(self, across: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return latitudes and longitudes of a file's coordinates."""
        lon_deg, lat_deg = self._transformer.transform(across, along, direction="INVERSE")
        return lat_deg, lon_deg


def _fit(to_crs: _Way, area: Rectangle, transform: Affine, name: str) -> FloatArray:
    """Return a file's two coordinates as polynomials (2, 10) of the local ones, by least squares around the area.

    They do not depend on where the file's grid begins, so that a crop is read exactly as the whole was.
    """
    middle = (0.5 * (area[0] + area[2]), 0.5 * (area[1] + area[3]))
    reach = [max(_FIT_REACH_M, 0.5 * (area[k + 2] - area[k])) for k in (0, 1)]
    x, y = _lattice((middle[0] - reach[0], middle[1] - reach[1], middle[0] + reach[0], middle[1] + reach[1]), 33)
    exact = np.stack(to_crs(x, y), axis=-1)
    terms = _monomials(x, y)
    scale = np.abs(terms).max(axis=0)
    coordinates: FloatArray = np.linalg.lstsq(terms / scale, exact, rcond=None)[0].T / scale
    pixel = np.array([[transform.a, transform.b], [transform.d, transform.e]])
    worst = float(np.abs(np.linalg.solve(pixel, (terms @ coordinates.T - exact).T)).max())
    if not worst < _FIT_TOLERANCE_CELLS:
        size = " x ".join(f"{(area[k + 2] - area[k]) / 1000:.0f}" for k in (0, 1))
        raise MissionError(
            f"terrain.file {name}: expected an area that maps smoothly onto the file's coordinates, got {size} km with "
            f"an error of {worst:.2g} cells: make the area smaller"
        )
    return coordinates


def _cells(coordinates: FloatArray, transform: Affine) -> FloatArray:
    """Return ``to_cell`` (2, 10): rows and columns of sample centres instead of a file's coordinates."""
    a, b, c, d, e, f = (~transform)[:6]
    to_cell: FloatArray = np.array([[d, e], [a, b]]) @ coordinates
    to_cell[:, 0] += np.array([f, c]) - 0.5  # files count from the corner of a pixel
    return to_cell


def _monomials(x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Return the terms (..., 10) of :class:`.kernels.TerrainArrays`."""
    u, v = np.asarray(x_m) * 1e-4, np.asarray(y_m) * 1e-4
    one = np.ones_like(u)
    terms: FloatArray = np.stack([one, u, v, u * u, u * v, v * v, u * u * u, u * u * v, u * v * v, v * v * v], axis=-1)
    return terms


def _lattice(box: tuple[float, float, float, float], count: int) -> tuple[FloatArray, FloatArray]:
    x, y = np.meshgrid(np.linspace(box[0], box[2], count), np.linspace(box[1], box[3], count))
    return x.ravel(), y.ravel()


def _corners(dataset: rasterio.DatasetReader) -> tuple[FloatArray, FloatArray]:
    a, b, c, d, e, f = dataset.transform[:6]
    col, row = np.array([0.0, 0.0, 1.0, 1.0]) * dataset.width, np.array([0.0, 1.0, 0.0, 1.0]) * dataset.height
    return a * col + b * row + c, d * col + e * row + f


def _reach_m(area: Rectangle) -> float:
    """Return how far from the origin anything is asked about, with room for what strays beyond the area."""
    return max(map(abs, area)) + _FIT_REACH_M


def _spacing_m(to_cell: FloatArray, area: Rectangle) -> float:
    x, y, h = 0.5 * (area[0] + area[2]), 0.5 * (area[1] + area[3]), 1.0
    ahead = _monomials(np.array([x + h, x]), np.array([y, y + h]))
    behind = _monomials(np.array([x - h, x]), np.array([y, y - h]))
    cells_per_m = to_cell @ (ahead - behind).T / (2 * h)  # d(row, col) / d(x, y)
    m_per_cell = np.linalg.inv(cells_per_m)
    return float(np.linalg.norm(m_per_cell, axis=0).min())


# --- what the file says of its heights -----------------------------------------------------------------------------


def _metres_per_unit(unit: str, crs: CRS, name: str) -> float:
    unit = unit.strip().lower()
    upward = [axis.unit_conversion_factor for axis in crs.axis_info if axis.direction == "up"]
    if unit in _FEET_M:
        return _FEET_M[unit]
    if unit not in _METRES:
        raise MissionError(f"terrain.file {name}: expected heights in m or ft, got the unit {unit!r}: convert the file")
    return upward[0] if upward and not unit else 1.0


def _check_datum(crs: CRS, name: str, geoid_undulation_m: float | None) -> None:
    above_ellipsoid = not crs.is_compound and len(crs.axis_info) == 3
    if above_ellipsoid and geoid_undulation_m is None:
        raise MissionError(
            f"terrain.file {name}: expected heights above mean sea level, got heights above the ellipsoid: give "
            "terrain.geoid_undulation_m, the height of the geoid above the ellipsoid there"
        )
    if crs.is_compound and geoid_undulation_m is not None:
        raise MissionError(
            f"terrain.geoid_undulation_m: expected none for {name}, whose heights are {crs.sub_crs_list[1].name!r}, "
            f"got {geoid_undulation_m}: remove it"
        )


def _geo(frame: LocalFrame, area: Rectangle) -> tuple[FloatArray, FloatArray]:
    x, y = _lattice(area, 3)
    lat_deg, lon_deg, _ = frame.to_geo(np.stack([x, y, np.zeros_like(x)], axis=-1))
    return lat_deg, lon_deg


def _span(lat_deg: FloatArray, lon_deg: FloatArray) -> str:
    return f"{lat_deg.min():.4f} to {lat_deg.max():.4f} N, {lon_deg.min():.4f} to {lon_deg.max():.4f} E"
