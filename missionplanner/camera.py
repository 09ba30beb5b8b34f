"""The camera as a pinhole: what a pixel covers, what a photo shows, how far apart and how fast photos may be taken.

Photos are taken with the long side of the picture level, along the flight, and the camera square to what it looks at.
"""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass, fields, replace

from missionplanner import mission
from missionplanner.errors import MissionError


@dataclass(frozen=True, slots=True)
class CameraModel:
    """A camera with one focal length; of a zoom lens, the one that is flown with."""

    name: str
    focal_length_mm: float
    sensor_width_mm: float
    sensor_height_mm: float
    image_width_px: int
    image_height_px: int
    interval_min_s: float = 0.0  # between two photos; 0: not stated
    overlap_share: float = 0.7  # of neighbouring photos
    gsd_max_mm: float = math.inf

    def gsd_mm(self, distance_m: float) -> float:
        """Return what a pixel covers of a surface so far off: of width and height, the coarser."""
        pixel_mm = max(self.sensor_width_mm / self.image_width_px, self.sensor_height_mm / self.image_height_px)
        return 1000.0 * distance_m * pixel_mm / self.focal_length_mm

    def distance_m(self, gsd_mm: float) -> float:
        """Return from how far a pixel covers so much."""
        return gsd_mm / self.gsd_mm(1.0)

    @property
    def field_of_view_deg(self) -> tuple[float, float]:
        """The angles that a photo shows across and upright."""
        width, height = (
            math.degrees(2.0 * math.atan(0.5 * side_mm / self.focal_length_mm))
            for side_mm in (self.sensor_width_mm, self.sensor_height_mm)
        )
        return width, height

    def footprint_m(self, distance_m: float) -> tuple[float, float]:
        """Return width and height of what a photo shows so far off."""
        scale = distance_m / self.focal_length_mm
        return scale * self.sensor_width_mm, scale * self.sensor_height_mm

    def spacing_m(self, distance_m: float) -> float:
        """Return how far apart photos are taken of what passes so far off, to overlap as they shall."""
        return (1.0 - self.overlap_share) * self.footprint_m(distance_m)[0]

    def speed_max_m_s(self, distance_m: float) -> float:
        """Return how fast one may pass so far off, since photos take their time."""
        return self.spacing_m(distance_m) / self.interval_min_s if self.interval_min_s > 0.0 else math.inf


PRESETS: dict[str, CameraModel] = {
    key: CameraModel(*row)
    for key, row in {
        # focal length, the part of the sensor that photos use, pixels, least time between photos: from the data sheets
        # of DJI, Sony and Phase One; the times of Sony cameras depend on how they are triggered
        "dji_p1_24mm": ("DJI Zenmuse P1, 24 mm", 24.0, 35.9, 24.0, 8192, 5460, 0.7),
        "dji_p1_35mm": ("DJI Zenmuse P1, 35 mm", 35.0, 35.9, 24.0, 8192, 5460, 0.7),
        "dji_p1_50mm": ("DJI Zenmuse P1, 50 mm", 50.0, 35.9, 24.0, 8192, 5460, 0.7),
        "dji_h20_wide": ("DJI Zenmuse H20, wide", 4.5, 6.29, 4.71, 4056, 3040, 2.0),
        "dji_mavic3e_wide": ("DJI Mavic 3 Enterprise, wide", 12.29, 17.3, 13.0, 5280, 3956, 0.7),
        "dji_mavic3e_tele": ("DJI Mavic 3 Enterprise, tele", 29.9, 6.4, 4.8, 4000, 3000, 0.7),
        "dji_phantom4_rtk": ("DJI Phantom 4 RTK", 8.8, 13.2, 8.8, 5472, 3648, 2.5),
        "sony_rx0m2": ("Sony RX0 II", 7.7, 11.55, 7.7, 4800, 3200, 0.5),
        "sony_rx1rm2": ("Sony RX1R II", 35.0, 35.9, 24.0, 7952, 5304, 1.0),
        "sony_a6000_35mm": ("Sony a6000, 35 mm", 35.0, 23.5, 15.6, 6000, 4000, 1.0),
        "sony_a7rm4_35mm": ("Sony a7R IV, 35 mm", 35.0, 35.7, 23.8, 9504, 6336, 1.0),
        "sony_a7rm4_55mm": ("Sony a7R IV, 55 mm", 55.0, 35.7, 23.8, 9504, 6336, 1.0),
        "phaseone_ixm100_35mm": ("Phase One iXM-100, RSM 35 mm", 35.0, 43.9, 32.9, 11664, 8750, 0.34),
        "phaseone_ixm100_80mm": ("Phase One iXM-100, RSM 80 mm", 80.0, 43.9, 32.9, 11664, 8750, 0.34),
    }.items()
}
"""Cameras that are flown along power lines, by what ``inspection.camera.preset`` calls them."""

_NUMBERS = ("focal_length_mm", "sensor_width_mm", "sensor_height_mm", "image_width_px", "image_height_px")


def of(camera: mission.Camera | None) -> CameraModel | None:
    """Return the camera that a mission file gives; None: it gives none.

    Raises
    ------
    MissionError
        An unknown preset; neither a preset nor all of its numbers.
    """
    if camera is None:
        return None
    said = {f.name: value for f in fields(CameraModel) if (value := getattr(camera, f.name, None)) is not None}
    if camera.preset is not None:
        if camera.preset not in PRESETS:
            near = difflib.get_close_matches(camera.preset, PRESETS, n=1, cutoff=0.4)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(PRESETS)}"
            raise MissionError(
                f"inspection.camera.preset: expected a camera that is known, got {camera.preset!r}: {hint}, or give "
                f"its {', '.join(_NUMBERS)}"
            )
        return replace(PRESETS[camera.preset], **said)
    missing = [name for name in _NUMBERS if name not in said]
    if missing:
        raise MissionError(
            f"inspection.camera: expected a preset, or the camera's numbers, got no {', '.join(missing)}: add them"
        )
    return CameraModel(name="camera", **said)
