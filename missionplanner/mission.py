"""The mission file: what a user asks for. YAML, validated here, published as JSON Schema.

Models mirror the file one to one; nothing is resolved yet (heights above ground need terrain): see :mod:`.scene`.
Every place is given either as ``lat_deg, lon_deg`` or as ``x_m, y_m`` east and north of the mission's origin. Every
height is given either above mean sea level (``alt_amsl_m``) or above the ground below it (``height_agl_m``).
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Sequence
from datetime import UTC, date, datetime
from functools import cache, reduce
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    Strict,
    ValidationError,
    field_validator,
    model_validator,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from missionplanner.autopilot_parameters import ParameterError, defaults, fields, find, parameters, same, shown
from missionplanner.document import Document, Location, parse_document
from missionplanner.errors import MissionError
from missionplanner.parameter_files import read_parameters

# Strict: a truth value or a text is not a number
Number = Annotated[float, Strict()]
Positive = Annotated[float, Strict(), Field(gt=0)]
_WORLD_M = 1e7  # nothing is larger or further off: beyond, arithmetic suffers
Coordinate = Annotated[float, Strict(), Field(ge=-_WORLD_M, le=_WORLD_M)]
Size = Annotated[float, Strict(), Field(gt=0, le=_WORLD_M)]
NonNegative = Annotated[float, Strict(), Field(ge=0)]
_DAY_S = 86_400.0
UpToADay = Annotated[float, Strict(), Field(ge=0, le=_DAY_S)]
Latitude = Annotated[float, Strict(), Field(ge=-84, le=84)]
Longitude = Annotated[float, Strict(), Field(ge=-180, le=180)]
Angle = Annotated[float, Strict(), Field(gt=0, lt=90)]
Share = Annotated[float, Strict(), Field(ge=0, le=1)]
Flag = Annotated[bool, Strict()]
Name = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^\w[\w.-]*$")]
Label = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^\w[\w. -]*$")]
"""What reports call something that has no name of its own: a view of a tower, a span."""


class Model(BaseModel):
    """A part of the mission file: unknown fields, NaN and infinity are errors; values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Origin(Model):
    """Where the local frame is centred."""

    lat_deg: Latitude
    lon_deg: Longitude


_ONE_WAY_TO_SAY_WHERE: list[JsonValue] = [{"required": ["lat_deg", "lon_deg"]}, {"required": ["x_m", "y_m"]}]


class Place(Model):
    """A place on the map."""

    model_config = ConfigDict(json_schema_extra={"oneOf": _ONE_WAY_TO_SAY_WHERE})

    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    x_m: Coordinate | None = None
    y_m: Coordinate | None = None

    @model_validator(mode="after")
    def _one_way_to_say_where(self) -> Place:
        geo = (self.lat_deg is not None, self.lon_deg is not None)
        local = (self.x_m is not None, self.y_m is not None)
        if (all(geo), any(geo), all(local), any(local)) not in {(True, True, False, False), (False, False, True, True)}:
            raise ValueError("expected either lat_deg and lon_deg, or x_m and y_m (east and north of the origin)")
        return self


class Point(Place):
    """A place with a height: exactly one of ``alt_amsl_m`` and ``height_agl_m``."""

    model_config = ConfigDict(
        json_schema_extra={
            "allOf": [
                {"oneOf": _ONE_WAY_TO_SAY_WHERE},
                {"oneOf": [{"required": ["alt_amsl_m"]}, {"required": ["height_agl_m"]}]},
            ]
        }
    )

    alt_amsl_m: Coordinate | None = None
    height_agl_m: Coordinate | None = None

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
    geoid_undulation_m: Number | None = Field(
        None, description="only for heights above the ellipsoid: subtracted to get altitudes AMSL"
    )


class Peak(Place):
    """One Gaussian peak: ``height_m * exp(-(distance / spread_m)^2)``."""

    height_m: Positive
    spread_m: Positive


class PeaksTerrain(Model):
    """Gaussian peaks summed over a base plane, gridded, then interpolated like any elevation model."""

    kind: Literal["peaks"]
    base_alt_amsl_m: Number = 0.0
    peaks: tuple[Peak, ...] = Field(min_length=1)
    cell_m: Positive = 10.0


class FlatTerrain(Model):
    """Level ground (or sea)."""

    kind: Literal["flat"]
    alt_amsl_m: Number


Terrain = Annotated[RasterTerrain | PeaksTerrain | FlatTerrain, Field(discriminator="kind")]


class Area(Model):
    """The rectangle in which paths may run; by default, all places of the mission with room around them."""

    south_west: Place
    north_east: Place


class _Top(Model):
    """How high an obstacle reaches: AMSL, above ground, or (neither) without limit."""

    top_alt_amsl_m: Coordinate | None = None
    top_height_agl_m: Size | None = None

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
    radius_m: Size


class Cone(Model):
    """A cone-shaped peak (PAPER.md eq. 16); its base stands on the ground unless ``base_alt_amsl_m`` is given."""

    kind: Literal["cone"]
    name: Name
    center: Place
    base_radius_m: Size
    height_m: Size
    base_alt_amsl_m: Coordinate | None = None


class Radar(Model):
    """A radar zone: a sphere (PAPER.md eq. 17). Kept out of, unless ``hard`` is false: then only priced."""

    kind: Literal["radar"]
    name: Name
    center: Point
    radius_m: Size
    hard: Flag = True


class Marine(Model):
    """A marine hazard: a sphere never to be entered (PAPER.md eq. 19)."""

    kind: Literal["marine"]
    name: Name
    center: Point
    radius_m: Size


class NoFly(_Top):
    """A no-fly polygon, from ``floor`` (default: the ground) to its top (default: no limit)."""

    kind: Literal["no_fly"]
    name: Name
    polygon: tuple[Place, ...] = Field(min_length=3)
    floor_alt_amsl_m: Coordinate | None = None


class Cable(Model):
    """A straight cable between two points."""

    kind: Literal["cable"]
    name: Name
    start: Point
    end: Point
    radius_m: Size = 0.5


class OverheadLine(Model):
    """Another line: power, a ski lift, an aerial ropeway. Supports, and between neighbours the room below its cables.

    Nobody flies below a cable; ``height_agl_m`` (or ``alt_amsl_m``) of a support is its top.
    """

    kind: Literal["line"]
    name: Name
    supports: tuple[Point, ...] = Field(min_length=2)
    support_radius_m: Size = 3.0
    cable_radius_m: Size = Field(3.0, description="half the width of the bundle of cables of a span")
    catenary_m: Size | None = Field(
        None,
        description="horizontal tension over weight per metre: the larger, the less sag; default: 2000, and more where "
        "a span would sag by more than 15 m",
    )
    assumed: tuple[str, ...] = Field((), description="what nobody measured, e.g. height_agl_m")


Obstacle = Annotated[Cylinder | Cone | Radar | Marine | NoFly | Cable | OverheadLine, Field(discriminator="kind")]


class Fence(_Top):
    """All flights stay inside this polygon and below its top."""

    polygon: tuple[Place, ...] = Field(min_length=3)


def _iso_date(text: str | None) -> str | None:
    try:
        known = text is None or bool(date.fromisoformat(text))
    except ValueError:
        known = False
    if not known:
        raise ValueError(f"expected a date, e.g. 2026-05-04, got {text!r}")
    return text


Date = Annotated[str, AfterValidator(_iso_date)]
"""A day, as ISO 8601 writes it."""


class TowerViews(Model):
    """From where a tower is looked at, and for how long."""

    kind: Literal["overfly", "two_sides", "four_sides", "orbit"] = Field(
        "two_sides",
        description="from above; from both sides of the line; from both sides before and behind the tower; from "
        "points evenly around it",
    )
    distance_m: Size = Field(25.0, description="from the tower's axis; overfly: above its top")
    below_top_m: tuple[NonNegative, ...] = Field(
        (5.0,), min_length=1, description="how far below the tower's top it is looked at from, once for each"
    )
    points: Annotated[int, Strict(), Field(ge=3, le=72)] = Field(8, description="of an orbit, at each height")
    hold_s: UpToADay = Field(3.0, description="standing still at each point before a photo is taken")
    photos: Annotated[int, Strict(), Field(ge=0, le=100)] = Field(1, description="at each point")


class SpanViews(Model):
    """A flight along the conductors, from tower to tower, taking photos on the way."""

    sides: Literal["left", "right", "both"] = Field("both", description="of the line, in the order of its towers")
    lateral_m: Size = Field(25.0, description="beside the line from tower to tower, horizontally")
    vertical_m: Coordinate = Field(0.0, description="above the straight line from top to top (below 0: below it)")


class Camera(Model):
    """The camera that photos are taken with: a preset, or its numbers, or a preset with other numbers."""

    preset: str | None = Field(None, description="e.g. sony_rx0m2; the command cameras lists them")
    focal_length_mm: Positive | None = None
    sensor_width_mm: Positive | None = None
    sensor_height_mm: Positive | None = None
    image_width_px: Annotated[int, Strict(), Field(ge=1)] | None = None
    image_height_px: Annotated[int, Strict(), Field(ge=1)] | None = None
    interval_min_s: Positive | None = Field(None, description="least time between two photos")
    overlap_share: Annotated[float, Strict(), Field(ge=0, lt=1)] = Field(
        0.7, description="of neighbouring photos on the way along a span"
    )
    gsd_max_mm: Positive | None = Field(
        None, description="coarsest ground sampling distance on what is looked at; views further off are refused"
    )


class Assignment(Model):
    """Who inspects what is to be found: towers (and spans) are shared out among the vehicles and their sorties."""

    objective: Literal["makespan", "priority", "balanced"] = Field(
        "makespan",
        description="all towers in least time; most weight within one sortie of each vehicle; all towers, all "
        "vehicles flying about as long",
    )
    sorties_max: Annotated[int, Strict(), Field(ge=1, le=50)] = Field(
        10, description="of each vehicle, one after the other; all start their next ones together"
    )
    swap_s: UpToADay = Field(300.0, description="on the ground between two sorties: batteries are changed")
    iterations: Annotated[int, Strict(), Field(ge=1, le=10_000_000)] = Field(
        2000, description="of the solver, in each of its runs"
    )


class Tower(Place):
    """A tower of a line to inspect."""

    name: Name
    height_m: Size = 35.0
    weight: NonNegative | None = Field(
        None,
        description="priority (PAPER.md eq. 15); default: days since last_inspected; without that as much as the "
        "longest known, or 1 where none is",
    )
    last_inspected: Date | None = Field(None, description="needs inspection.as_of")
    views: TowerViews | Literal["none"] | None = Field(
        None, description="instead of inspection.views; none: an obstacle only"
    )
    assumed: tuple[str, ...] = Field((), description="what nobody measured, e.g. height_m")


class InspectedLine(Model):
    """One line: towers in order, with conductors between neighbours. Lines may share towers (circuits, branches)."""

    name: Name
    towers: tuple[Name, ...] = Field(min_length=2)
    voltage_kv: Positive | None = None
    conductor_radius_m: Size | None = Field(None, description="default: inspection.conductor_radius_m")
    catenary_m: Size | None = Field(
        None,
        description="horizontal tension over weight per metre: the larger, the less sag; default: 2000, and more where "
        "a span would sag by more than 15 m",
    )
    spans: SpanViews | Literal["none"] | None = Field(None, description="instead of inspection.spans")


class Inspection(Model):
    """The lines to inspect: their towers, each an obstacle, with conductors between neighbours; nobody flies below."""

    towers: tuple[Tower, ...] = Field(min_length=1)
    lines: tuple[InspectedLine, ...] = Field((), description="default: one, through all towers in their order")
    as_of: Date | None = Field(None, description="the day from which the time since last_inspected counts")
    safety_distance_m: Positive | None = Field(
        None, description="least distance to conductors; no vehicle's safety.obstacle_m may be less"
    )
    standoff_m: Positive = Field(25.0, description="height above a tower's top at which it is overflown")
    range_m: Positive = Field(60.0, description="a tower counts as inspected when a path passes its top this close")
    share_min: Share = Field(1.0, description="least share of towers (eq. 6)")
    tower_radius_m: Size = 6.0
    conductor_radius_m: Size = Field(8.0, description="half the width of the bundle of conductors of a span")
    views: TowerViews = Field(TowerViews(), description="of every tower, where assignment says who inspects what")
    spans: SpanViews | Literal["none"] = Field("none", description="of every span, likewise")
    camera: Camera | None = None
    assignment: Assignment | None = Field(
        None, description="vehicles name no towers, stops or goals then: what each inspects is found"
    )

    @property
    def weights(self) -> tuple[float, ...]:
        """Every tower's priority (PAPER.md eq. 15)."""
        days = [self._days_since_inspected(tower) for tower in self.towers]
        longest = max((known for known in days if known is not None), default=0.0) or 1.0
        return tuple(
            tower.weight if tower.weight is not None else longest if known is None else known
            for tower, known in zip(self.towers, days, strict=True)
        )

    def _days_since_inspected(self, tower: Tower) -> float | None:
        if tower.last_inspected is None or self.as_of is None:
            return None
        return float((date.fromisoformat(self.as_of) - date.fromisoformat(tower.last_inspected)).days)

    @property
    def lines_or_one(self) -> tuple[InspectedLine, ...]:
        """The lines; where none are given, the one through all towers."""
        if self.lines or len(self.towers) < 2:
            return self.lines
        return (InspectedLine(name="line", towers=tuple(tower.name for tower in self.towers)),)

    @model_validator(mode="after")
    def _dates_are_past(self) -> Inspection:
        for i, tower in enumerate(self.towers):
            if tower.last_inspected is None:
                continue
            if self.as_of is None:
                raise _error_at(("inspection", "as_of"), "expected a date to count from, since last_inspected is given")
            if date.fromisoformat(tower.last_inspected) > date.fromisoformat(self.as_of):
                problem = f"expected a day not after as_of ({self.as_of}), got {tower.last_inspected}"
                raise _error_at(("inspection", "towers", i, "last_inspected"), problem)
        return self

    @model_validator(mode="after")
    def _lines_are_of_the_towers(self) -> Inspection:
        names = [tower.name for tower in self.towers]
        known = set(names)
        _expect_unique("name", {("inspection", "lines", i): line.name for i, line in enumerate(self.lines)})
        for i, line in enumerate(self.lines):
            for k, name in enumerate(line.towers):
                location = ("inspection", "lines", i, "towers", k)
                if name not in known:
                    raise _error_at(location, f"expected the name of a tower, got {name!r}: {_suggestion(name, names)}")
                if k > 0 and line.towers[k - 1] == name:
                    raise _error_at(location, f"expected another tower than the one before it, got {name!r}")
        return self


class TowerRange(Model):
    """Towers visited in order, from the first to the last named (backwards where ``to`` stands before)."""

    first: Name
    last: Name


class Direction(Model):
    """Where a camera looks, whatever the vehicle does."""

    heading_deg: Annotated[float, Strict(), Field(ge=0, le=360)] = Field(description="clockwise from true north")
    pitch_deg: Annotated[float, Strict(), Field(ge=-90, le=90)] = Field(description="above the horizon; -90: down")


class Stop(Point):
    """A place to fly through, and what is done on the way to it and there."""

    name: Label | None = Field(None, description="what reports call it, e.g. T01.left")
    inspects: Label | None = Field(None, description="the tower, or span (span A-B), that is looked at")
    hold_s: UpToADay = Field(0.0, description="stand still there, before photos are taken (copters); whole seconds")
    look_at: Point | None = Field(None, description="the camera points there, on the way to it and there")
    look: Direction | None = Field(None, description="or: the camera points that way")
    photos: Annotated[int, Strict(), Field(ge=0, le=100)] = Field(0, description="taken there, after the hold")
    photo_every_m: Positive | None = Field(None, description="on the way to it: a photo every so many metres")

    @field_validator("hold_s")
    @classmethod
    def _whole_seconds(cls, hold_s: float) -> float:
        if hold_s != round(hold_s):
            raise ValueError(f"expected whole seconds, as autopilots count them, got {hold_s:g}")
        return hold_s

    @model_validator(mode="after")
    def _one_aim(self) -> Stop:
        if self.look_at is not None and self.look is not None:
            raise ValueError("expected at most one of look_at and look")
        return self


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
    landing_slope_max_deg: Angle = Field(15.0, description="steepest ground on which home and landing place may lie")


class Motion(Model):
    """How this autopilot's navigator moves; by default, the autopilot's own default parameters."""

    acceleration_m_s2: Positive | None = Field(None, description="WPNAV_ACCEL / 100, MPC_ACC_HOR")
    jerk_m_s3: Positive | None = Field(None, description="WPNAV_JERK, MPC_JERK_AUTO")
    waypoint_radius_m: Positive | None = Field(None, description="WPNAV_RADIUS / 100, NAV_ACC_RAD, WP_RADIUS")
    cruise_speed_m_s: Positive | None = Field(
        None, description="planes, on take-off and on the way home: AIRSPEED_CRUISE, FW_AIRSPD_TRIM"
    )
    loiter_radius_m: Positive | None = Field(None, description="planes: WP_LOITER_RAD, NAV_LOITER_RAD")


class Energy(Model):
    """The battery and what flying takes of it: more than ``endurance_s`` says, which it replaces."""

    capacity_wh: Positive = Field(description="usable, of the battery as it is")
    level_power_w: Positive = Field(
        description="electric power, in calm air at sea level: copters hovering, planes level at their cruise speed"
    )
    mass_kg: Positive = Field(description="as it takes off")


class RallyPoint(Place):
    """A place to return to instead of home, where that is nearer."""

    height_above_home_m: Positive = Field(description="at which the vehicle arrives there, above its home")


class VehicleSettings(Model):
    """What ``defaults`` and every vehicle may set."""

    autopilot: Literal["ardupilot", "px4"] = "ardupilot"
    vehicle_class: Literal["copter", "plane"] = Field("copter", alias="class")
    speed_m_s: SpeedRange | None = Field(None, description="default: copter 3 to 10, plane 14 to 22 (PX4: to 20)")
    climb: VerticalLimit = VerticalLimit()
    descent: VerticalLimit = VerticalLimit()
    turn_radius_m: NonNegative | None = Field(
        None, description="PAPER.md eq. 5; default: copter 0, plane 60; planes: no turn is flown tighter, if stated"
    )
    turn_angle_max_deg: Annotated[float, Strict(), Field(gt=0, le=180)] = Field(180.0, description="PAPER.md eq. 8")
    height_agl_max_m: Positive | None = Field(None, description="PAPER.md eq. 4's upper limit")
    alt_amsl_max_m: Number | None = None
    safety: Safety = Safety()
    tracking_error_m: NonNegative = Field(2.0, description="how far control and gusts let it stray from its flight")
    position_error_m: NonNegative = Field(1.0, description="how far off its own estimate of its position may be")
    endurance_s: Positive | None = Field(
        None, description="in calm air at sea level: copters hovering, planes level at their cruise speed"
    )
    energy: Energy | None = Field(None, description="better than endurance_s where it is known; default: endurance_s")
    reserve_share: Share = Field(0.2, description="of the battery, left when it is back on the ground")
    airspeed_max_m_s: Positive | None = Field(
        None, description="what it makes against the wind; default: the greatest of speed_m_s and its speed home"
    )
    takeoff_height_m: Positive | None = Field(None, description="climb straight up to this height above home first")
    return_height_m: Positive | None = Field(
        None,
        description="height above home at which it returns when told to or when its link is lost (RTL_ALT, "
        "RTL_RETURN_ALT, RTL_ALTITUDE); default: the lowest that is proven clear",
    )
    end: Literal["land", "rtl", "loiter"] | None = Field(
        None, description="at the goal: land there (copters), return home, or stay; default: copter land, plane loiter"
    )
    rally: tuple[RallyPoint, ...] = Field(
        (),
        description="places to return to instead of home; the ways there are not proven: they need "
        "fleet.direct_return: waived",
    )
    motion: Motion = Motion()
    parameters: dict[str, Number] = Field(
        {},
        description="the autopilot's own, in its own units, where the vehicle does not hold the defaults: e.g. "
        "WPNAV_SPEED: 800 (cm/s), NAV_ACC_RAD: 5 (m); what motion, climb, descent and return_height_m say must not "
        "contradict them",
    )
    parameter_file: Path | None = Field(
        None,
        description="the vehicle's parameters as saved by Mission Planner (.param), MAVProxy (.parm), QGroundControl "
        "(.params) or the command parameters; relative to the mission file; those in parameters go before it",
    )

    model_config = ConfigDict(populate_by_name=True)

    def asked_motion(self) -> dict[str, float]:
        """Return what the mission file says of the motion model, by the model's fields: as such, or as parameters.

        Raises
        ------
        ParameterError
            An unknown parameter, one out of range, or one that contradicts something else.
        """
        said = {
            "acceleration_m_s2": ("motion.acceleration_m_s2", self.motion.acceleration_m_s2),
            "jerk_m_s3": ("motion.jerk_m_s3", self.motion.jerk_m_s3),
            "climb_rate_m_s": ("climb.rate_m_s", self.climb.rate_m_s),
            "descent_rate_m_s": ("descent.rate_m_s", self.descent.rate_m_s),
            "waypoint_radius_m": ("motion.waypoint_radius_m", self.motion.waypoint_radius_m),
            "cruise_speed_m_s": ("motion.cruise_speed_m_s", self.motion.cruise_speed_m_s),
            "loiter_radius_m": ("motion.loiter_radius_m", self.motion.loiter_radius_m),
            "return_height_m": ("return_height_m", self.return_height_m),
        }
        asked = {field: value for field, (_, value) in said.items() if value is not None}
        for field, (name, value) in fields((self.autopilot, self.vehicle_class), self.parameters).items():
            if not same(asked.setdefault(field, value), value):
                raise ParameterError(
                    name,
                    f"{name} {shown(self.parameters[name])} contradicts {said[field][0]} {asked[field]:g}: "
                    "leave one of them out",
                )
        return asked

    def ignored_speed(self) -> str | None:
        """Return why the autopilot would not fly some of ``speed_m_s``, by its parameters; None: it would fly all."""
        if self.speed_m_s is None:
            return None
        kind = (self.autopilot, self.vehicle_class)
        values = defaults(kind) | self.asked_motion()
        for parameter in parameters(kind):
            limit_m_s = values[parameter.field]
            if parameter.limits_speed == "above" and self.speed_m_s.max > limit_m_s:
                return f"expected max of at most {limit_m_s:g} ({parameter.name}), got {self.speed_m_s.max:g}"
            if parameter.limits_speed == "below" and self.speed_m_s.min < limit_m_s:
                return f"expected min of at least {limit_m_s:g} ({parameter.name}), got {self.speed_m_s.min:g}"
        return None


_UID = r"([0-9a-fA-F]{16}|[0-9a-fA-F]{36})"


class Vehicle(VehicleSettings):
    """One vehicle: from home straight up, through ``start``, ``stops`` and towers, to ``goal``."""

    name: Name
    sysid: Annotated[int, Strict(), Field(ge=1, le=250)] | None = Field(
        None, description="default: its place in the list"
    )
    uid: str | None = Field(
        None,
        description="unique id of its autopilot, in hexadecimal digits (AUTOPILOT_VERSION: 36 of uid2, or 16 of uid): "
        "no other gets its mission; the command parameters tells it",
        json_schema_extra={"pattern": f"^{_UID}$"},
    )
    home: Place | None = Field(None, description="default: on the ground below start")
    start: Point | None = None
    stops: tuple[Stop, ...] = ()
    inspects: TowerRange | None = None
    goal: Point | None = Field(None, description="default, of copters with stops or towers: above home")

    @field_validator("uid")
    @classmethod
    def _a_unique_id(cls, uid: str | None) -> str | None:
        if uid is not None and not re.fullmatch(_UID, uid):
            raise ValueError(f"expected 16 or 36 hexadecimal digits, got {_shown(uid)}")
        return None if uid is None else uid.lower()

    @model_validator(mode="after")
    def _has_a_beginning(self) -> Vehicle:
        if self.home is None and self.start is None:
            raise ValueError("expected home, start or both")
        return self


class Rendezvous(Model):
    """Places of several vehicles' routes that they reach at the same time."""

    name: Name
    at: dict[Name, int | str] = Field(
        min_length=2,
        description="per vehicle: a tower it inspects, or a number: 0 its start (the top of its take-off where it has "
        "none), 1, 2, ... its stops and towers in order",
    )

    @field_validator("at", mode="before")
    @classmethod
    def _numbers_or_names(cls, at: Any) -> Any:
        for name, place in at.items() if isinstance(at, dict) else ():
            number = isinstance(place, int) and not isinstance(place, bool) and place >= 0
            if not number and not isinstance(place, str):
                raise ValueError(f"{name}: expected a number (0, 1, ...) or the name of a tower, got {_shown(place)}")
        return at


class Fleet(Model):
    """Rules between vehicles."""

    separation_m: NonNegative = Field(20.0, description="least distance between any two, at every instant (eq. 9)")
    arrive_together: Flag = True
    arrival: Literal["earliest", "least_energy"] = Field(
        "earliest", description="as soon as the slowest can, or everybody at the speed that takes least of its battery"
    )
    arrival_time_s: Annotated[float, Strict(), Field(gt=0, le=_DAY_S)] | None = Field(
        None, description="common arrival, after mission start"
    )
    arrival_utc: str | None = Field(
        None,
        description="common arrival by the clock, e.g. 2026-12-24T10:30:00Z; the mission starts that much before",
        json_schema_extra={"format": "date-time"},
    )
    arrival_order: tuple[Name, ...] = Field((), description="all vehicles, in the order in which they arrive")
    arrival_spacing_s: UpToADay = Field(0.0, description="how long after the one before it each arrives, in order")
    rendezvous: tuple[Rendezvous, ...] = Field((), description="in the order in which they are flown")
    lose_time_by: Literal["start_later", "detour"] = Field(
        "start_later", description="how those get later who would be too early even at their least speed"
    )
    launch_interval_s: UpToADay = Field(0.0, description="vehicle i starts at least i times this later")
    home_within_m: Positive | None = Field(
        None,
        description="how far from its planned home a vehicle may stand to be started; default, and at most: the radius "
        "of its tube",
    )
    send_fence: Flag = Field(
        True, description="whether vehicles are sent the fence, and the no-fly areas that they never cross"
    )
    lateness_s: UpToADay = Field(
        0.0, description="all keep apart also when any one of them is up to this much early or late"
    )
    correction: Literal["off", "speed", "speed_and_hold"] = Field(
        "off",
        description="speed: while flying, change speeds by command, within speed_m_s, so that all still arrive as "
        "planned, or as soon as all can; speed_and_hold: also stop copters for a while that are too early even at "
        "their least speed (they wait for a command to go on); off: only tell who is late",
    )
    direct_return: Literal["required", "waived"] = Field(
        "required",
        description="whether the straight way home must be clear from every point of the mission; where it cannot be, "
        "waive it only if nobody is returned by hand and lost links do not return",
    )

    @property
    def arrival_clock(self) -> datetime | None:
        """The common arrival by the clock, in UTC."""
        return None if self.arrival_utc is None else datetime.fromisoformat(self.arrival_utc).astimezone(UTC)

    def arrives_after_s(self, vehicle: str) -> float:
        """Return how long after the fleet's common arrival a vehicle is due."""
        return self.arrival_spacing_s * self.arrival_order.index(vehicle) if self.arrival_order else 0.0

    @field_validator("arrival_utc")
    @classmethod
    def _a_time_with_its_zone(cls, text: str | None) -> str | None:
        try:
            time = None if text is None else datetime.fromisoformat(text)
            known = time is None or (time.tzinfo is not None and 2000 <= time.year <= 2200)
        except ValueError:
            known = False
        if not known:
            raise ValueError(f"expected date, time and zone, e.g. 2026-12-24T10:30:00Z, got {text!r}")
        return text

    @model_validator(mode="after")
    def _an_order_with_spacing(self) -> Fleet:
        asked = {
            "arrival_time_s": self.arrival_time_s is not None,
            "arrival_utc": self.arrival_utc is not None,
            "arrival_order": bool(self.arrival_order),
        }
        if not self.arrive_together and any(asked.values()):
            field = next(name for name, given in asked.items() if given)
            raise _error_at(("fleet", field), "expected only with arrive_together: true, got false")
        if self.arrival_spacing_s > 0.0 and not self.arrival_order:
            raise _error_at(("fleet", "arrival_spacing_s"), "expected arrival_order with it, got none")
        if self.arrival_order and self.arrival_spacing_s == 0.0:
            raise _error_at(("fleet", "arrival_order"), "expected an arrival_spacing_s above 0 with it, got none")
        if self.arrival_spacing_s * max(len(self.arrival_order) - 1, 0) > _DAY_S:
            problem = f"expected all to arrive within a day, got {self.arrival_spacing_s:g} s between each two"
            raise _error_at(("fleet", "arrival_spacing_s"), problem)
        return self


class Wind(Model):
    """The steady wind that is planned with: as measured or forecast at the height flown."""

    speed_m_s: NonNegative
    from_deg: Annotated[float, Strict(), Field(ge=0, le=360)] = Field(
        description="where it blows from, clockwise from north, as pilots and weather services say: 270 is a west wind"
    )

    @property
    def velocity_m_s(self) -> tuple[float, float]:
        """The velocity of the air: east, north."""
        direction = math.radians(self.from_deg)
        east, north = -self.speed_m_s * math.sin(direction), -self.speed_m_s * math.cos(direction)
        return round(east, 12) + 0.0, round(north, 12) + 0.0  # no minus zero


class Weights(Model):
    """Weights of the price's terms (PAPER.md eqs 13 and 20); every term is normalised to order one."""

    voyage: NonNegative = 1.0
    smooth: NonNegative = Field(1.0, description="bending energy: as much as the way that sharp turns cost in time")
    inspection: NonNegative = 1.0
    radar: NonNegative = Field(1.0, description="zones that are not hard (eq. 17)")
    atmosphere: NonNegative = Field(0.0, description="altitude squared (eq. 18)")
    climb: NonNegative = Field(0.1, description="height gained, as a stand-in for energy")
    constraint: Positive = Field(
        100.0, description="every hard limit: terrain, obstacles, fence, flight limits, fellows"
    )


class Planner(Model):
    """Settings of the search."""

    algorithm: str = "pso-abc-sa"
    population: Annotated[int, Strict(), Field(ge=6, le=10_000)] = 50
    iterations: Annotated[int, Strict(), Field(ge=1, le=1_000_000)] = 200
    seed: Annotated[int, Strict(), Field(ge=0)] = 1
    seconds: Positive | None = Field(
        None,
        description="for how long paths are improved, beyond the search that every plan takes; plans then differ "
        "from run to run",
    )
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
    defaults: VehicleSettings = Field(
        VehicleSettings(), description="what vehicles share, field by field; each may say its own instead"
    )
    vehicles: tuple[Vehicle, ...] = Field(min_length=1, max_length=250)
    fleet: Fleet = Fleet()
    wind: Wind | None = Field(None, description="steady wind: flights are predicted in it; default: calm")
    wind_max_m_s: NonNegative | None = Field(
        None,
        description="strongest wind to be expected, from any direction: energy and ways home are judged by it; default "
        "the wind alone",
    )
    planner: Planner = Planner()

    @property
    def is_open(self) -> bool:
        """Whether who inspects what is still to be found (:mod:`.inspection`)."""
        return self.inspection is not None and self.inspection.assignment is not None

    @property
    def air_m_s(self) -> tuple[float, float]:
        """The velocity of the air that flights are predicted in: east, north."""
        return (0.0, 0.0) if self.wind is None else self.wind.velocity_m_s

    @property
    def wind_strongest_m_s(self) -> float:
        """The strongest wind that is allowed for, whatever its direction."""
        known_m_s = 0.0 if self.wind is None else self.wind.speed_m_s
        return known_m_s if self.wind_max_m_s is None else self.wind_max_m_s

    @model_validator(mode="before")
    @classmethod
    def _share_defaults(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        defaults, vehicles = _plain(data.get("defaults", {})), data.get("vehicles")
        if not isinstance(defaults, dict) or not isinstance(vehicles, list | tuple):
            return data
        merged = [_over(defaults, own) if isinstance(own := _plain(v), dict) else own for v in vehicles]
        return {**data, "vehicles": _with_own_parameters(merged, vehicles)}

    @model_validator(mode="after")
    def _names_are_unique(self) -> Mission:
        towers = self.inspection.towers if self.inspection else ()
        _expect_unique("name", {("vehicles", i): v.name for i, v in enumerate(self.vehicles)})
        solids: dict[Location, str] = {("obstacles", i): o.name for i, o in enumerate(self.obstacles)}
        _expect_unique("name", solids | {("inspection", "towers", i): t.name for i, t in enumerate(towers)})
        _expect_unique("sysid", {("vehicles", i): v.sysid or i + 1 for i, v in enumerate(self.vehicles)})
        _expect_unique("uid", {("vehicles", i): v.uid for i, v in enumerate(self.vehicles) if v.uid is not None})
        return self

    @model_validator(mode="after")
    def _no_wind_is_stronger_than_the_strongest(self) -> Mission:
        if self.wind is not None and self.wind.speed_m_s > self.wind_strongest_m_s:
            problem = (
                f"expected at least wind.speed_m_s ({self.wind.speed_m_s:g} m/s), got {self.wind_strongest_m_s:g}: "
                "raise it, or leave it out"
            )
            raise _error_at(("wind_max_m_s",), problem)
        return self

    @model_validator(mode="after")
    def _rally_points_are_known_to_be_unproven(self) -> Mission:
        for i, vehicle in enumerate(self.vehicles):
            if not vehicle.rally:
                continue
            if self.fleet.direct_return != "waived":
                problem = (
                    "expected fleet.direct_return: waived with it, since ways to rally points are not proven, "
                    "got 'required'"
                )
                raise _error_at(("vehicles", i, "rally"), problem)
            if vehicle.end == "rtl":
                problem = "expected land or loiter with rally points, got 'rtl': it may end at one of them instead"
                raise _error_at(("vehicles", i, "end"), problem)
        return self

    @model_validator(mode="after")
    def _planes_stay_in_the_air(self) -> Mission:
        for i, vehicle in enumerate(self.vehicles):
            if vehicle.vehicle_class == "plane" and vehicle.end == "land":
                problem = "expected loiter or rtl for a plane, got 'land': no approach is planned; land it by hand"
                raise _error_at(("vehicles", i, "end"), problem)
        return self

    @model_validator(mode="after")
    def _everybody_has_something_to_do(self) -> Mission:
        for i, vehicle in enumerate(self.vehicles):
            if self.is_open:
                for field in ("start", "stops", "inspects", "goal"):
                    if getattr(vehicle, field):
                        problem = "expected none where inspection.assignment shares out the towers: leave it out"
                        raise _error_at(("vehicles", i, field), problem)
                if vehicle.vehicle_class == "plane":
                    problem = "expected copters where inspection.assignment shares out the towers, got a plane"
                    raise _error_at(("vehicles", i, "class"), problem)
                if vehicle.end == "loiter":
                    problem = "expected land or rtl where inspection.assignment shares out the towers, got 'loiter'"
                    raise _error_at(("vehicles", i, "end"), f"{problem}: it comes down for a change of batteries")
            elif vehicle.goal is None:
                returns = vehicle.home is not None and vehicle.vehicle_class == "copter"
                if not (returns and (vehicle.stops or vehicle.inspects)):
                    problem = (
                        "expected this field, got none: only copters with a home, and stops or towers, return there"
                    )
                    raise _error_at(("vehicles", i, "goal"), problem)
            for k, stop in enumerate(vehicle.stops):
                if stop.hold_s > 0.0 and vehicle.vehicle_class == "plane":
                    problem = f"expected 0 for a plane, which cannot stand still, got {stop.hold_s:g}"
                    raise _error_at(("vehicles", i, "stops", k, "hold_s"), problem)
        return self

    @model_validator(mode="after")
    def _rounds_have_no_times_of_their_own(self) -> Mission:
        if not self.is_open:
            return self
        for field in ("rendezvous", "arrival_time_s", "arrival_utc"):
            if getattr(self.fleet, field):
                problem = (
                    "expected none where inspection.assignment shares out the towers, in as many sorties as needed"
                )
                raise _error_at(("fleet", field), f"{problem}: leave it out")
        return self

    @model_validator(mode="after")
    def _conductors_are_kept_clear_of(self) -> Mission:
        need_m = None if self.inspection is None else self.inspection.safety_distance_m
        for i, vehicle in enumerate(self.vehicles):
            if need_m is not None and vehicle.safety.obstacle_m < need_m:
                problem = (
                    f"expected at least inspection.safety_distance_m ({need_m:g} m), got "
                    f"{vehicle.safety.obstacle_m:g} m: raise it"
                )
                raise _error_at(("vehicles", i, "safety", "obstacle_m"), problem)
        return self

    @model_validator(mode="after")
    def _meetings_are_of_the_fleet(self) -> Mission:
        names = [vehicle.name for vehicle in self.vehicles]
        order = self.fleet.arrival_order
        if order and sorted(order) != sorted(names):
            wrong = [name for name in order if name not in names]
            twice = [name for name in order if order.count(name) > 1]
            problem = f"got {len(set(order))} of {len(names)}"
            if wrong:
                problem = f"got {wrong[0]!r}: {_suggestion(wrong[0], names)}"
            elif twice:
                problem = f"got {twice[0]!r} twice"
            raise _error_at(
                ("fleet", "arrival_order"), f"expected the name of every vehicle once, in their order, {problem}"
            )
        _expect_unique("name", {("fleet", "rendezvous", i): r.name for i, r in enumerate(self.fleet.rendezvous)})
        for i, meeting in enumerate(self.fleet.rendezvous):
            for name in meeting.at:
                if name not in names:
                    problem = f"expected the name of a vehicle, got {name!r}: {_suggestion(name, names)}"
                    raise _error_at(("fleet", "rendezvous", i, "at"), problem)
        return self

    @model_validator(mode="after")
    def _parameters_are_known(self) -> Mission:
        for i, vehicle in enumerate(self.vehicles):
            try:
                vehicle.asked_motion()
            except ParameterError as error:
                raise _error_at(("vehicles", i, "parameters", error.name), str(error)) from error
            ignored = None if vehicle.parameter_file else vehicle.ignored_speed()
            if ignored is not None:
                raise _error_at(("vehicles", i, "speed_m_s"), f"{ignored}: {_SET_OTHERWISE}")
        return self

    @model_validator(mode="after")
    def _inspected_towers_exist(self) -> Mission:
        names = [t.name for t in self.inspection.towers] if self.inspection else []
        for i, vehicle in enumerate(self.vehicles):
            if vehicle.inspects is None:
                continue
            if not names:
                raise _error_at(("vehicles", i, "inspects"), "expected inspection.towers to choose from, got none")
            for end in ("first", "last"):
                name = getattr(vehicle.inspects, end)
                if name not in names:
                    problem = f"expected the name of a tower, got {name!r}: {_suggestion(name, names)}"
                    raise _error_at(("vehicles", i, "inspects", end), problem)
        return self


def load_mission(path: Path) -> Mission:
    """Read a mission file.

    Raises
    ------
    MissionError
        The file cannot be read, or is wrong: the message names file, line, field, what was expected and what came.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_FILE_BYTES + 1)
    except OSError as error:
        reason = "a folder" if path.is_dir() else error.strerror
        raise MissionError(f"{path}: expected a mission file that can be read, got: {reason}") from error
    if len(content) > _MAX_FILE_BYTES:
        raise MissionError(f"{path}: expected a mission file of at most {_MAX_FILE_BYTES} bytes, got more")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise MissionError(
            f"{path}: expected UTF-8 text, got byte 0x{content[error.start]:02x} at offset {error.start}: "
            "is this a mission file, saved as UTF-8?"
        ) from error
    return parse_mission(text, str(path))


def parse_mission(text: str, source: str) -> Mission:
    """Read a mission from YAML (or JSON) text; ``source`` names it in errors.

    Raises
    ------
    MissionError
        As :func:`load_mission`; the first mistake in the text is told, the others are listed after it.
    """
    document = parse_document(text, source)
    if not isinstance(document.data, dict):
        raise MissionError(f"{source}:1: expected a mapping of fields (name: ...), got {_shown(document.data)}")
    try:
        return Mission.model_validate(document.data)
    except ValidationError as error:
        mistakes = _mistakes(error, document)
    line, first = mistakes[0]
    rest = [f"line {n}: {text}" for n, text in mistakes[1:]]
    more = f" (and {len(rest)} more: {'; '.join(rest[:3])}{'; ...' if len(rest) > 3 else ''})" if rest else ""
    raise MissionError(f"{source}:{line}: {first}{more}")


def with_parameter_files(mission: Mission, folder: Path) -> Mission:
    """Return a mission that needs no parameter files: what the motion model knows of them is in ``parameters``.

    Names of files are relative to ``folder``. A return height is not taken from a file: a plan sets it on the vehicle.

    Raises
    ------
    MissionError
        A file that cannot be read, is another autopilot's, holds a value out of range or contradicts the mission.
    """
    vehicles = [v if v.parameter_file is None else _with_parameter_file(v, folder) for v in mission.vehicles]
    if all(new is old for new, old in zip(vehicles, mission.vehicles, strict=True)):
        return mission
    return mission.model_copy(update={"vehicles": tuple(vehicles)})


def _with_parameter_file(vehicle: Vehicle, folder: Path) -> Vehicle:
    assert vehicle.parameter_file is not None
    path = folder / vehicle.parameter_file
    kind = (vehicle.autopilot, vehicle.vehicle_class)
    read = read_parameters(path)
    typed = fields(kind, vehicle.parameters)
    taken: dict[str, float] = {}
    for name, entry in read.items():
        found = find(kind, name)
        if found is not None and not found[0].sent and found[0].field not in typed:
            taken[name] = entry.value
    if not taken and not typed:
        raise MissionError(
            f"{path}: expected parameters of {vehicle.name} ({' '.join(kind)}), got none that the motion model knows: "
            "is it another autopilot's file?"
        )
    resolved = vehicle.model_copy(update={"parameters": taken | vehicle.parameters, "parameter_file": None})
    try:
        resolved.asked_motion()
    except ParameterError as error:
        line = f":{read[error.name].line}" if error.name in read else ""
        raise MissionError(f"{path}{line}: {vehicle.name}: {error}") from error
    ignored = resolved.ignored_speed()
    if ignored is not None:
        raise MissionError(f"{vehicle.name}.speed_m_s: {ignored}: the autopilot flies no other")
    return resolved


def mission_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of the mission file."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Mission.model_json_schema()}


_MAX_FILE_BYTES = 16 * 1024 * 1024
_SET_OTHERWISE = "the autopilot flies no other; if the vehicle's is set otherwise, say so in parameters"


def _plain(part: Any) -> Any:
    return part.model_dump(by_alias=True, exclude_unset=True) if isinstance(part, Model) else part


def _over(defaults: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Return ``own`` with what it lacks taken from ``defaults``, also within common parts."""
    merged = {**defaults, **own}
    for key in defaults.keys() & own.keys():
        if isinstance(defaults[key], dict) and isinstance(own[key], dict):
            merged[key] = _over(defaults[key], own[key])
    return merged


def _with_own_parameters(vehicles: list[Any], written: Sequence[Any]) -> list[Any]:
    """Return vehicles without those shared parameters that only their fellows' autopilots know."""
    kinds = [_kind(vehicle) for vehicle in vehicles if isinstance(vehicle, dict)]
    kept: list[Any] = []
    for vehicle, own in zip(vehicles, written, strict=True):
        parameters = vehicle.get("parameters") if isinstance(vehicle, dict) else None
        if isinstance(parameters, dict):
            typed = _plain(own).get("parameters") or ()
            fellows = {
                name
                for name in parameters
                if name not in typed and not find(_kind(vehicle), name) and any(find(kind, name) for kind in kinds)
            }
            kept.append({**vehicle, "parameters": {k: v for k, v in parameters.items() if k not in fellows}})
        else:
            kept.append(vehicle)
    return kept


def _kind(vehicle: dict[str, Any]) -> Any:
    return vehicle.get("autopilot", "ardupilot"), vehicle.get("class", vehicle.get("vehicle_class", "copter"))


# --- mistakes: from what pydantic found to one line with its place in the file -------------------------------------


def _error_at(location: Location, problem: str) -> PydanticCustomError:
    """Return an error of a validator that sees more than the field it blames."""
    return PydanticCustomError("mission", "{problem}", {"problem": problem, "location": tuple(location)})


def _expect_unique(field: str, values: dict[Location, Any]) -> None:
    first: dict[Any, Location] = {}
    for location, value in values.items():
        if value in first:
            problem = f"expected a {field} of its own, got {value!r} like {_path(first[value])}"
            raise _error_at((*location, field), problem)
        first[value] = location


def _mistakes(error: ValidationError, document: Document) -> list[tuple[int, str]]:
    """Return line and text of every mistake, in the order of the lines, each once."""
    found: dict[str, int] = {}
    details = error.errors(include_url=False)
    misspelt = {
        (*d["loc"][:-1], right)
        for d in details
        if d["type"] == "extra_forbidden"
        for right in _nearest(d["loc"][-1], _fields(d["loc"][:-1]))
    }
    for detail in details:
        if detail["type"] == "missing" and detail["loc"] in misspelt:
            continue  # the misspelt field is told; that the right one is missing follows from it
        if detail["type"] == "too_short" and any(_within(d["loc"], detail["loc"]) for d in details):
            continue  # pydantic counts wrong items as missing ones
        given = detail.get("ctx", {}).get("location") or detail["loc"]
        location = _as_written(given, document.data)
        found.setdefault(f"{_path(location) or 'mission'}: {_problem(detail)}", document.line(location))
    return sorted((line, text) for text, line in found.items())


def _within(inner: Location, outer: Location) -> bool:
    return len(inner) > len(outer) and tuple(inner[: len(outer)]) == tuple(outer)


def _as_written(location: Location, data: Any) -> Location:
    """Return where the blamed value stands in the file: without the kinds that pydantic adds, in ``defaults`` if so."""
    written: list[str | int] = []
    value = data
    for step in location:
        if isinstance(value, dict) and step not in value and value.get("kind") == step:
            continue
        written.append(step)
        value = _child(value, step)
    if written[:1] == ["vehicles"] and len(written) > 2 and value is _ABSENT:
        shared = ["defaults", *written[2:]]
        if reduce(_child, shared, data) is not _ABSENT:
            return shared
    return written


_ABSENT = object()


def _child(value: Any, step: str | int) -> Any:
    if isinstance(value, dict):
        return value.get(step, _ABSENT)
    inside = isinstance(value, list) and isinstance(step, int) and step < len(value)
    return value[step] if inside else _ABSENT


def _path(location: Location) -> str:
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in location).lstrip(".")


_EXPECTED = {
    "greater_than": "a number above {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number below {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "finite_number": "a finite number",
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "text",
    "path_type": "a file name",
    "tuple_type": "a list",
    "model_type": "a mapping of fields",
    "model_attributes_type": "a mapping of fields",
    "dict_type": "a mapping of fields",
    "literal_error": "{expected}",
    "string_pattern_mismatch": "a name of letters, digits, '_', '-' and '.', beginning with neither '-' nor '.'",
    "string_too_short": "at least {min_length} character",
    "string_too_long": "at most {max_length} characters",
}


def _problem(detail: ErrorDetails) -> str:
    """Return what was expected and what came, in our words."""
    kind, location, context = detail["type"], detail["loc"], detail.get("ctx", {})
    match kind:
        case "missing":
            text = "expected this field, got none"
        case "extra_forbidden":
            text = f"expected a known field, got {location[-1]!r}: {_suggestion(location[-1], _fields(location[:-1]))}"
        case "value_error":
            text = str(context["error"])
        case "mission":
            text = str(context["problem"])
        case "too_short":
            text = f"expected at least {context['min_length']} of them, got {context['actual_length']}"
        case "too_long":
            text = f"expected at most {context['max_length']} of them, got {context['actual_length']}"
        case "union_tag_not_found":
            text = f"expected a field kind, one of {', '.join(_kinds(location))}, got none"
        case "union_tag_invalid":
            suggestion = _suggestion(context["tag"], _kinds(location))
            text = f"expected kind to be one of {context['expected_tags']}, got {context['tag']!r}: {suggestion}"
        case _:
            expected = _EXPECTED[kind].format(**context) if kind in _EXPECTED else detail["msg"]
            text = f"expected {expected}, got {_shown(detail['input'])}{_hint(detail)}"
    return text


def _hint(detail: ErrorDetails) -> str:
    kind, value = detail["type"], detail["input"]
    if detail["loc"][-1] == "lat_deg" and isinstance(value, float | int) and 84 < abs(value) <= 180:
        return ": are latitude and longitude swapped?"
    if kind in {"float_type", "int_type"} and isinstance(value, str) and value.replace(".", "", 1).isdigit():
        return ": remove the quotes"
    if kind == "string_type" and isinstance(value, bool | int | float):
        return ": put it in quotes"
    return ""


def _shown(value: Any) -> str:
    match value:
        case None:
            return "nothing"
        case bool():
            return str(value).lower()
        case dict():
            return "a mapping"
        case list() | tuple():
            return "a list"
        case str():
            return repr(value if len(value) <= 60 else value[:57] + "...")
        case _:
            return str(value)


def _suggestion(wrong: Any, known: Sequence[str]) -> str:
    near = _nearest(wrong, known)
    return (
        f"did you mean {near[0]}?" if near else f"known are {', '.join(known[:20])}{', ...' if len(known) > 20 else ''}"
    )


def _nearest(wrong: Any, known: Sequence[str]) -> list[str]:
    return difflib.get_close_matches(str(wrong), known, n=1, cutoff=0.5)


def _fields(location: Location) -> list[str]:
    """Return the names of the fields that the mission file knows at ``location``."""
    return list(_schema_at(location).get("properties", {}))


def _kinds(location: Location) -> list[str]:
    return list(_schema_at(location).get("discriminator", {}).get("mapping", {}))


_cached_schema = cache(mission_schema)


def _schema_at(location: Location) -> dict[str, Any]:
    schema = _cached_schema()

    def resolved(part: dict[str, Any]) -> dict[str, Any]:
        choices = [c for c in part.get("anyOf", []) if c.get("type") != "null"]
        if len(choices) == 1:
            part = choices[0]
        return schema["$defs"][part["$ref"].rpartition("/")[2]] if "$ref" in part else part

    part = resolved(schema)
    for step in location:
        kinds = part.get("discriminator", {}).get("mapping", {})
        if isinstance(step, int):
            part = resolved(part.get("items", {}))
        elif step in kinds:
            part = resolved({"$ref": kinds[step]})
        else:
            part = resolved(part.get("properties", {}).get(step, {}))
    return part
