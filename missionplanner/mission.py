"""The mission file: what a user asks for. YAML, validated here, published as JSON Schema.

Models mirror the file one to one; nothing is resolved yet (heights above ground need terrain): see :mod:`.scene`.
Every place is given either as ``lat_deg, lon_deg`` or as ``x_m, y_m`` east and north of the mission's origin. Every
height is given either above mean sea level (``alt_amsl_m``) or above the ground below it (``height_agl_m``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Latitude = Annotated[float, Field(ge=-84, le=84)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
Angle = Annotated[float, Field(gt=0, lt=90)]
Name = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[\w.-]+$")]


class Model(BaseModel):
    """A part of the mission file: unknown fields, NaN and infinity are errors; values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Origin(Model):
    """Where the local frame is centred."""

    lat_deg: Latitude
    lon_deg: Longitude


class Place(Model):
    """A place on the map."""

    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    x_m: float | None = None
    y_m: float | None = None

    @model_validator(mode="after")
    def _one_way_to_say_where(self) -> Place:
        geo = (self.lat_deg is not None, self.lon_deg is not None)
        local = (self.x_m is not None, self.y_m is not None)
        if (all(geo), any(geo), all(local), any(local)) not in {(True, True, False, False), (False, False, True, True)}:
            raise ValueError("expected either lat_deg and lon_deg, or x_m and y_m (east and north of the origin)")
        return self


class Point(Place):
    """A place with a height: exactly one of ``alt_amsl_m`` and ``height_agl_m``."""

    alt_amsl_m: float | None = None
    height_agl_m: float | None = None

    @model_validator(mode="after")
    def _one_datum(self) -> Point:
        if (self.alt_amsl_m is None) == (self.height_agl_m is None):
            raise ValueError(
                "expected exactly one of alt_amsl_m (above mean sea level) and height_agl_m (above the ground below)"
            )
        return self


class RasterTerrain(Model):
    """An elevation model read from a file; any CRS that PROJ knows."""

    kind: Literal["raster"]
    file: Path = Field(description="GeoTIFF or HGT; relative to the mission file")
    vertical_error_m: NonNegative = Field(0.0, description="added to the terrain margin of every vehicle")
    geoid_undulation_m: float | None = Field(
        None, description="only for heights above the ellipsoid: subtracted to get altitudes AMSL"
    )


class Peak(Place):
    """One Gaussian peak: ``height_m * exp(-(distance / spread_m)^2)``."""

    height_m: Positive
    spread_m: Positive


class PeaksTerrain(Model):
    """Gaussian peaks summed over a base plane, gridded, then interpolated like any elevation model."""

    kind: Literal["peaks"]
    base_alt_amsl_m: float = 0.0
    peaks: tuple[Peak, ...] = Field(min_length=1)
    cell_m: Positive = 10.0


class FlatTerrain(Model):
    """Level ground (or sea)."""

    kind: Literal["flat"]
    alt_amsl_m: float


Terrain = Annotated[RasterTerrain | PeaksTerrain | FlatTerrain, Field(discriminator="kind")]


class Area(Model):
    """The rectangle in which paths may run; by default, all places of the mission with room around them."""

    south_west: Place
    north_east: Place


class _Top(Model):
    """How high an obstacle reaches: AMSL, above ground, or (neither) without limit."""

    top_alt_amsl_m: float | None = None
    top_height_agl_m: Positive | None = None

    @model_validator(mode="after")
    def _one_top(self) -> _Top:
        if self.top_alt_amsl_m is not None and self.top_height_agl_m is not None:
            raise ValueError("expected at most one of top_alt_amsl_m and top_height_agl_m (neither: no upper limit)")
        return self


class Cylinder(_Top):
    """A vertical cylinder from the ground up: a mast, a chimney, a building."""

    kind: Literal["cylinder"]
    name: Name
    center: Place
    radius_m: Positive


class Cone(Model):
    """A cone-shaped peak (PAPER.md eq. 16); its base stands on the ground unless ``base_alt_amsl_m`` is given."""

    kind: Literal["cone"]
    name: Name
    center: Place
    base_radius_m: Positive
    height_m: Positive
    base_alt_amsl_m: float | None = None


class Radar(Model):
    """A radar zone: a sphere (PAPER.md eq. 17). Kept out of, unless ``hard`` is false: then only priced."""

    kind: Literal["radar"]
    name: Name
    center: Point
    radius_m: Positive
    hard: bool = True


class Marine(Model):
    """A marine hazard: a sphere never to be entered (PAPER.md eq. 19)."""

    kind: Literal["marine"]
    name: Name
    center: Point
    radius_m: Positive


class NoFly(_Top):
    """A no-fly polygon, from ``floor`` (default: the ground) to its top (default: no limit)."""

    kind: Literal["no_fly"]
    name: Name
    polygon: tuple[Place, ...] = Field(min_length=3)
    floor_alt_amsl_m: float | None = None


class Cable(Model):
    """A straight cable between two points."""

    kind: Literal["cable"]
    name: Name
    start: Point
    end: Point
    radius_m: Positive = 0.5


Obstacle = Annotated[Cylinder | Cone | Radar | Marine | NoFly | Cable, Field(discriminator="kind")]


class Fence(_Top):
    """All flights stay inside this polygon and below its top."""

    polygon: tuple[Place, ...] = Field(min_length=3)


class Tower(Place):
    """A tower of the line to inspect."""

    name: Name
    height_m: Positive = 35.0
    weight: NonNegative = Field(1.0, description="priority, e.g. days since the last inspection (PAPER.md eq. 15)")


class Inspection(Model):
    """The line to inspect: its towers in order, each an obstacle, with conductors between neighbours."""

    towers: tuple[Tower, ...] = Field(min_length=1)
    standoff_m: Positive = Field(25.0, description="height above a tower's top at which it is overflown")
    range_m: Positive = Field(60.0, description="a tower counts as inspected when a path passes its top this close")
    share_min: Annotated[float, Field(ge=0, le=1)] = Field(1.0, description="least share of towers (eq. 6)")
    tower_radius_m: Positive = 6.0
    conductor_radius_m: Positive = Field(8.0, description="half the width of the bundle of conductors of a span")


class TowerRange(Model):
    """Towers visited in order, from the first to the last named (backwards where ``to`` stands before)."""

    first: Name
    last: Name


class SpeedRange(Model):
    """Ground speed along the path."""

    min: Positive
    max: Positive

    @model_validator(mode="after")
    def _ordered(self) -> SpeedRange:
        if self.min > self.max:
            raise ValueError(f"expected 0 < min <= max, got min {self.min} and max {self.max}")
        return self


class VerticalLimit(Model):
    """Climb or descent: the autopilot's rate, and the steepest path."""

    rate_m_s: Positive | None = None
    angle_max_deg: Angle | None = None


class Safety(Model):
    """Distances kept by the flown path, beyond the tracking error."""

    terrain_m: NonNegative = Field(20.0, description="height above the ground (PAPER.md eq. 4's lower limit)")
    obstacle_m: NonNegative = Field(10.0, description="distance to every obstacle and to the fence (eq. 3)")


class Motion(Model):
    """How this autopilot's navigator moves; by default, the autopilot's own default parameters."""

    acceleration_m_s2: Positive | None = Field(None, description="WPNAV_ACCEL / 100, MPC_ACC_HOR")
    jerk_m_s3: Positive | None = Field(None, description="WPNAV_JERK, MPC_JERK_AUTO")
    waypoint_radius_m: Positive | None = Field(None, description="WPNAV_RADIUS / 100, NAV_ACC_RAD, WP_RADIUS")


class VehicleSettings(Model):
    """What ``defaults`` and every vehicle may set."""

    autopilot: Literal["ardupilot", "px4"] = "ardupilot"
    vehicle_class: Literal["copter", "plane"] = Field("copter", alias="class")
    speed_m_s: SpeedRange | None = Field(None, description="default: copter 3 to 10, plane 14 to 22")
    climb: VerticalLimit = VerticalLimit()
    descent: VerticalLimit = VerticalLimit()
    turn_radius_m: NonNegative | None = Field(None, description="PAPER.md eq. 5; default: copter 0, plane 60")
    turn_angle_max_deg: Annotated[float, Field(gt=0, le=180)] = Field(180.0, description="PAPER.md eq. 8")
    height_agl_max_m: Positive | None = Field(None, description="PAPER.md eq. 4's upper limit")
    alt_amsl_max_m: float | None = None
    safety: Safety = Safety()
    tracking_error_m: NonNegative = 2.0
    endurance_s: Positive | None = None
    takeoff_height_m: Positive | None = Field(None, description="climb straight up to this height above home first")
    end: Literal["land", "rtl", "loiter"] | None = Field(
        None, description="at the goal: land there, return home, or stay; default: copter land, plane loiter"
    )
    motion: Motion = Motion()

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)


class Vehicle(VehicleSettings):
    """One vehicle: from home straight up, through ``start``, ``stops`` and towers, to ``goal``."""

    name: Name
    sysid: Annotated[int, Field(ge=1, le=250)] | None = Field(None, description="default: its place in the list")
    home: Place | None = Field(None, description="default: on the ground below start")
    start: Point | None = None
    stops: tuple[Point, ...] = ()
    inspects: TowerRange | None = None
    goal: Point

    @model_validator(mode="after")
    def _has_a_beginning(self) -> Vehicle:
        if self.home is None and self.start is None:
            raise ValueError("expected home, start or both")
        return self


class Fleet(Model):
    """Rules between vehicles."""

    separation_m: NonNegative = Field(20.0, description="least distance between any two, at every instant (eq. 9)")
    arrive_together: bool = True
    arrival_time_s: Positive | None = Field(None, description="common arrival, after mission start; default: earliest")
    launch_interval_s: NonNegative = Field(0.0, description="vehicle i starts i times this later")


class Weights(Model):
    """Weights of the price's terms (PAPER.md eqs 13 and 20); every term is normalised to order one."""

    voyage: NonNegative = 1.0
    smooth: NonNegative = 0.05
    inspection: NonNegative = 1.0
    radar: NonNegative = Field(1.0, description="zones that are not hard (eq. 17)")
    atmosphere: NonNegative = Field(0.0, description="altitude squared (eq. 18)")
    climb: NonNegative = Field(0.1, description="height gained, as a stand-in for energy")
    constraint: Positive = Field(100.0, description="every hard limit: terrain, obstacles, fence, flight limits, fellows")


class Planner(Model):
    """Settings of the search."""

    algorithm: str = "pso-abc-sa"
    population: Annotated[int, Field(ge=6, le=10_000)] = 50
    iterations: Annotated[int, Field(ge=1, le=1_000_000)] = 200
    seed: Annotated[int, Field(ge=0)] = 1
    weights: Weights = Weights()
    waypoint_tolerance_m: Positive = Field(2.0, description="uploaded legs stay this close to the planned curve")


class Mission(Model):
    """A whole mission file."""

    name: Name
    description: str = ""
    origin: Origin
    area: Area | None = None
    terrain: Terrain
    obstacles: tuple[Obstacle, ...] = ()
    fence: Fence | None = None
    inspection: Inspection | None = None
    defaults: dict[str, Any] = Field({}, description="fields of a vehicle, used where a vehicle does not say its own")
    vehicles: tuple[Vehicle, ...] = Field(min_length=1, max_length=250)
    fleet: Fleet = Fleet()
    planner: Planner = Planner()
