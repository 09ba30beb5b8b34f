"""A vehicle's limits and its navigator's parameters; their defaults are :mod:`.autopilot_parameters`'."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

from missionplanner.autopilot_parameters import defaults, fields, parameters, with_values
from missionplanner.errors import MissionError
from missionplanner.mission import VehicleSettings

Autopilot = Literal["ardupilot", "px4"]
VehicleClass = Literal["copter", "plane"]
Ending = Literal["land", "rtl", "loiter"]


# a plane's take-off: how far it rolls, in a tailwind longer (as simulated, and recorded without wind), ...
_TAKEOFF_ROLL_M, _TAKEOFF_ROLL_S = 37.0, 0.6
_TAKEOFF_ANGLE_DEG = 5.0  # how much steeper than its nose points a strong one climbs then
_TAKEOFF_CLIMB_M_S = 7.0  # the wind carries it so long
# how wide planes circle and turn, in radii of their tightest turn, as simulated over speeds, radii, tunings and winds
_CIRCLE_SLIP_TURNS, _CIRCLE_LEAST_TURNS, _ASIDE_TURNS = 1.0, 2.6, 3.0
_BANK_ALWAYS_RAD = 0.4363  # however slow it flies
_AIRSPEED_MIN_M_S = 10.0  # where no parameter tells
_GRAVITY_M_S2 = 9.80665


def true_airspeed(alt_amsl_m: float) -> float:
    """Return true over indicated airspeed (the one that is commanded) in the standard atmosphere; 1 at sea level."""
    return float(max(1.0 - 2.25577e-5 * alt_amsl_m, 0.1) ** -2.128)


@dataclass(frozen=True, slots=True)
class Px4Tuning:
    """Parameters of PX4 multicopters that no mission sets; defaults of PX4 1.15 and of the vehicle it simulates."""

    corner_gain: float = 0.5  # MPC_XY_TRAJ_P: share of the acceleration that corners are planned with
    lag_max_m: float = 2.0  # MPC_XY_ERR_MAX
    altitude_radius_m: float = 0.8  # NAV_MC_ALT_RAD
    speed_max_m_s: float = 12.0  # MPC_XY_VEL_MAX
    return_speed_m_s: float = 5.0  # MPC_XY_CRUISE: RTL forgets the mission's speed
    return_descend_m: float = 10.0  # RTL_DESCEND_ALT: as a waypoint down to this height, then LAND
    return_wait_s: float = 0.0  # RTL_LAND_DELAY, at that height
    climb_acceleration_m_s2: float = 4.0  # MPC_ACC_UP_MAX
    descent_acceleration_m_s2: float = 3.0  # MPC_ACC_DOWN_MAX
    takeoff_least_m: float = 2.5  # MIS_TAKEOFF_ALT: it climbs no less
    takeoff_speed_m_s: float = 1.5  # MPC_TKO_SPEED, below slow_below_m
    takeoff_ramp_s: float = 3.0  # MPC_TKO_RAMP_T
    land_speed_m_s: float = 0.7  # MPC_LAND_SPEED, below land_below_m
    land_crawl_m_s: float = 0.3  # MPC_LAND_CRWL, below crawl_below_m, where the height above the ground is measured
    slow_below_m: float = 10.0  # MPC_LAND_ALT1
    land_below_m: float = 5.0  # MPC_LAND_ALT2
    crawl_below_m: float = 1.0  # MPC_LAND_ALT3
    position_gain: float = 0.95  # MPC_XY_P
    velocity_gains: tuple[float, float, float] = (1.8, 0.4, 0.2)  # MPC_XY_VEL_P_ACC, _I_ACC, _D_ACC
    vertical_position_gain: float = 1.0  # MPC_Z_P
    vertical_velocity_gains: tuple[float, float] = (4.0, 2.0)  # MPC_Z_VEL_P_ACC, _I_ACC
    tilt_max_deg: float = 45.0  # MPC_TILTMAX_AIR
    thrust_max: float = 2.0  # MPC_THR_MAX / MPC_THR_HOVER: greatest thrust as a multiple of the weight
    drag_s: float = 1.0  # SIH_KDV / SIH_MASS: deceleration by drag per speed through the air, 1/s


@dataclass(frozen=True, slots=True)
class ArducopterTuning:
    """Parameters of ArduCopter that no mission sets; defaults of 4.5."""

    cruise_speed_m_s: float = 10.0  # WPNAV_SPEED: until a mission sets a speed
    return_speed_m_s: float = 0.0  # RTL_SPEED; 0: its cruise speed, whatever the mission has set
    return_wait_s: float = 5.0  # RTL_LOIT_TIME, above home
    return_final_height_m: float = 0.0  # RTL_ALT_FINAL; above 0 it would stay there, which nothing here plans for
    vertical_acceleration_m_s2: float = 1.0  # WPNAV_ACCEL_Z
    corner_acceleration_m_s2: float = 0.0  # WPNAV_ACCEL_C; 0: twice WPNAV_ACCEL
    land_speed_m_s: float = 0.5  # LAND_SPEED, below land_slow_below_m
    land_slow_below_m: float = 10.0  # LAND_ALT_LOW
    land_high_speed_m_s: float = 0.0  # LAND_SPEED_HIGH, above that; 0: its rate of descent
    lean_max_deg: float = 30.0  # ANGLE_MAX
    lean_auto_max_deg: float = 0.0  # PSC_ANGLE_MAX; 0: lean_max_deg
    input_time_s: float = 0.15  # ATC_INPUT_TC: how fast it leans
    position_gain: float = 1.0  # PSC_POSXY_P
    velocity_gains: tuple[float, float, float] = (2.0, 1.0, 0.5)  # PSC_VELXY_P, _I, _D
    vertical_gains: tuple[float, float] = (1.0, 5.0)  # PSC_POSZ_P, PSC_VELZ_P
    vertical_jerk_m_s3: float = 5.0  # PSC_JERK_Z

    @property
    def homing_m_s(self) -> float:
        """Its speed on the way home."""
        return self.return_speed_m_s or self.cruise_speed_m_s

    @property
    def lean_deg(self) -> float:
        """How far it leans on a mission."""
        return min(self.lean_auto_max_deg or self.lean_max_deg, self.lean_max_deg)


@dataclass(frozen=True, slots=True)
class PlaneTuning:
    """Parameters of planes that no mission sets; defaults of ArduPlane 4.5's simulated plane (SITL's plane.parm)."""

    l1_period_s: float = 15.0  # NAVL1_PERIOD
    l1_damping: float = 0.75  # NAVL1_DAMPING
    l1_integral: float = 0.02  # NAVL1_XTRACK_I
    roll_max_deg: float = 65.0  # ROLL_LIMIT_DEG, LIM_ROLL_CD / 100
    roll_time_s: float = 0.25  # RLL2SRV_TCONST
    pitch_max_deg: float = 15.0  # TECS_PITCH_MAX; 0: the limit
    pitch_min_deg: float = 0.0  # TECS_PITCH_MIN; 0: the limit
    pitch_limits_deg: tuple[float, float] = (-20.0, 25.0)  # PTCH_LIM_MIN_DEG, PTCH_LIM_MAX_DEG; LIM_PITCH_* / 100
    pitch_time_s: float = 0.25  # PTCH2SRV_TCONST
    cruise_throttle: float = 0.5  # TRIM_THROTTLE / 100
    throttle_slew: float = 1.0  # THR_SLEWRATE / 100: share of the range per second
    sink_min_m_s: float = 2.0  # TECS_SINK_MIN
    energy_time_s: float = 5.0  # TECS_TIME_CONST
    takeoff_pitch_deg: float = 15.0  # the take-off item's first parameter
    level_off_s: float = 2.0  # TKOFF_PLIM_SEC
    slope_min_m: float = 15.0  # ALT_SLOPE_MIN, GLIDE_SLOPE_MIN: a smaller change of height is made at once
    thrust_to_weight: float = 1.34  # the greatest, measured on take-offs; drag is that of the simulated airframe
    airspeed_reads_low: float = 0.018  # share of the airspeed (measured: 23.1 m/s true for 22 set at 644 m AMSL)

    @property
    def pitch_range_deg(self) -> tuple[float, float]:
        """How far its nose points down and up at most."""
        low, high = self.pitch_limits_deg
        return max(self.pitch_min_deg or low, low), min(self.pitch_max_deg or high, high)


@dataclass(frozen=True, slots=True)
class MotionModel:
    """What the navigator of one vehicle does with a path; the planner's clock and the simulator share it."""

    autopilot: Autopilot
    vehicle_class: VehicleClass
    acceleration_m_s2: float
    jerk_m_s3: float
    climb_rate_m_s: float
    descent_rate_m_s: float
    waypoint_radius_m: float
    turn_radius_m: float
    return_height_m: float = 15.0  # above home, RTL; a copter that is higher stays so high
    wind_m_s: tuple[float, float] = (0.0, 0.0)  # steady velocity of the air: east, north
    px4: Px4Tuning = Px4Tuning()  # PX4 multicopters only
    arducopter: ArducopterTuning = ArducopterTuning()  # ArduCopter only
    plane: PlaneTuning = PlaneTuning()  # planes only
    # planes only
    cruise_speed_m_s: float = 22.0  # while no mission says otherwise: on take-off and on the way home
    loiter_radius_m: float = 60.0
    airspeed_limits_m_s: tuple[float, float] = (0.0, math.inf)  # what may be commanded; ArduPlane ignores the rest

    @property
    def settling_s(self) -> float:
        """How long its position controllers take at least, as ways home are proven with."""
        if self.vehicle_class == "plane":
            return 1.0
        if self.autopilot == "ardupilot":
            loop_s = max(1.0, 1.0 / self.arducopter.position_gain, 1.0 / self.arducopter.vertical_gains[0])
        else:
            loop_s = max(1.0, 0.95 / self.px4.position_gain, 1.0 / self.px4.vertical_position_gain)
        return loop_s + self.sluggish_s  # at the defaults: 1

    @property
    def sluggish_s(self) -> float:
        """How much later than with the default parameters a copter accelerates as it should."""
        if self.autopilot == "px4":
            (gain, _, damping), (usual_gain, _, usual_damping) = self.px4.velocity_gains, Px4Tuning().velocity_gains
            return max(0.0, (1.0 + damping) / gain - (1.0 + usual_damping) / usual_gain)
        own, usual = self.arducopter, ArducopterTuning()
        leaning_s = max(0.0, own.input_time_s - usual.input_time_s)
        return leaning_s + max(0.0, 1.0 / own.velocity_gains[0] - 1.0 / usual.velocity_gains[0])

    @property
    def vertical_acceleration_m_s2(self) -> float:
        """How fast it changes its rate of climb at least, as ways home are proven with."""
        return min(1.0, self.arducopter.vertical_acceleration_m_s2) if self.autopilot == "ardupilot" else 1.0

    def return_alt_amsl_m(self, alt_amsl_m: float, home_amsl_m: float) -> float:
        """Return how high RTL brings a vehicle above its home: a copter no lower than it is, a plane just so high."""
        lowest = home_amsl_m + self.return_height_m
        return max(alt_amsl_m, lowest) if self.vehicle_class == "copter" else lowest

    def takeoff_distance_m(self, height_m: float, home_amsl_m: float, tailwind_m_s: float = 0.0) -> float:
        """Return how far from its home a plane that climbs as stated, no better, has gained a height; 0: lifts off.

        That is at its greatest rate and its cruise speed, or with its nose as high as it takes off, if that is less.
        """
        roll_m = _TAKEOFF_ROLL_M * math.sqrt(true_airspeed(home_amsl_m)) + _TAKEOFF_ROLL_S * tailwind_m_s
        angle_rad = math.radians(self.plane.takeoff_pitch_deg + _TAKEOFF_ANGLE_DEG)
        speed_m_s = self.true_speed_m_s(self.cruise_speed_m_s, home_amsl_m + height_m)
        stated_rad = math.asin(min(self.climb_rate_m_s / speed_m_s, 1.0))
        climb_m_s = min(_TAKEOFF_CLIMB_M_S, self.climb_rate_m_s)
        return roll_m + height_m * (1.0 / math.tan(min(angle_rad, stated_rad)) + tailwind_m_s / climb_m_s)

    def true_speed_m_s(self, airspeed_m_s: float, alt_amsl_m: float) -> float:
        """Return how fast a plane flies through the air when its autopilot holds an airspeed."""
        return airspeed_m_s * (1.0 + self.plane.airspeed_reads_low) * true_airspeed(alt_amsl_m)

    def circle_m(self, airspeed_m_s: float, alt_amsl_m: float, wind_m_s: float = 0.0) -> float:
        """Return how far from its middle a plane circles at most once it has settled there, in such a wind.

        Thin air makes ArduPlane widen the circle; it slips outwards, and further where its bank is too little.
        """
        turn_m = self._tightest_m(airspeed_m_s, alt_amsl_m, wind_m_s)
        return max(self._circle_wanted_m(alt_amsl_m) + _CIRCLE_SLIP_TURNS * turn_m, _CIRCLE_LEAST_TURNS * turn_m)

    def aside_m(self, airspeed_m_s: float, alt_amsl_m: float, wind_m_s: float = 0.0) -> float:
        """Return how far off the straight way home a plane is at most that turns there, in such a wind, and circles."""
        turn_m = self._tightest_m(airspeed_m_s, alt_amsl_m, wind_m_s)
        return self._circle_wanted_m(alt_amsl_m) + _ASIDE_TURNS * turn_m

    def _circle_wanted_m(self, alt_amsl_m: float) -> float:
        return self.loiter_radius_m * self.true_speed_m_s(1.0, alt_amsl_m) ** 2

    def _tightest_m(self, airspeed_m_s: float, alt_amsl_m: float, wind_m_s: float) -> float:
        """Return the radius over the ground, with the wind behind, of a plane's tightest turn: guided, and banked."""
        load = max(airspeed_m_s / (self.airspeed_limits_m_s[0] or _AIRSPEED_MIN_M_S), 1.0)
        bank_rad = min(math.radians(self.plane.roll_max_deg), max(math.acos(1.0 / load**2), _BANK_ALWAYS_RAD))
        ground_m_s = self.true_speed_m_s(airspeed_m_s, alt_amsl_m) + wind_m_s
        guided_m = ground_m_s * self.plane.l1_period_s / (4.0 * math.pi * self.plane.l1_damping)
        return max(ground_m_s**2 / (_GRAVITY_M_S2 * math.tan(bank_rad)), guided_m)


@dataclass(frozen=True, slots=True)
class VehicleLimits:
    """What the path of one vehicle must respect (PAPER.md eqs 2-8). Angles in radians, heights in metres."""

    speed_min_m_s: float
    speed_max_m_s: float
    climb_angle_rad: float
    descent_angle_rad: float
    turn_radius_m: float
    turn_angle_rad: float
    terrain_margin_m: float
    obstacle_margin_m: float
    tracking_error_m: float
    position_error_m: float
    deviation_m: float  # of the autopilot's own path from its legs (planes: from the predicted flight)
    landing_slope_rad: float
    height_agl_max_m: float
    alt_amsl_max_m: float
    endurance_s: float
    airspeed_max_m_s: float = math.inf  # where the mission file states it
    wind_max_m_s: float = 0.0  # the strongest wind that is allowed for, from any direction
    flown_radius_min_m: float = 0.0  # planes: turn_radius_m where it is stated; 0: however tightly they bank

    @property
    def stray_m(self) -> float:
        """How far a vehicle may be from its predicted flight, and so may be taken to be."""
        return self.tracking_error_m + self.position_error_m

    @property
    def tube_m(self) -> float:
        """Radius of the tube around its legs (planes: its predicted flight) that a vehicle never leaves."""
        return self.stray_m + self.deviation_m


_PLANE_DEVIATION_M = 10.0
_CORNER_SHARE: dict[Autopilot, float] = {"ardupilot": 1.0, "px4": 1.25}


def deviation_m(model: MotionModel) -> float:
    """Return how far the autopilot itself leaves a mission's legs: corners cut, one-leg look-ahead, overshoot.

    A copter's, as a share of its waypoint radius: ArduCopter 4.5 stays inside it (recorded: 1.7 of 2 m), PX4 1.15
    overshoots it (recorded: 2.4 of 2 m; predicted over random routes: 2.2 m). PX4's holds for NAV_ACC_RAD from 2 m on,
    10 m/s at most and its default jerk; a smaller radius holds it no closer, for who is further off its leg than that
    stops there, and takes the waypoint's height before it returns. A plane leaves its legs by far more, so it is held
    to its predicted flight (recorded: within 8.9 m).
    """
    if model.vehicle_class == "plane":
        return _PLANE_DEVIATION_M
    return _CORNER_SHARE[model.autopilot] * model.waypoint_radius_m


# what no parameter says of a plane: how it changes its speed
_PLANE_ASSUMED = {"acceleration_m_s2": 1.5, "jerk_m_s3": 1.0}
# PX4's guidance integrates nothing and has one pair of pitch limits; its airspeed is taken to be read as it is
_PX4_PLANE_ASSUMED = _PLANE_ASSUMED | {
    "plane.l1_integral": 0.0,
    "plane.pitch_max_deg": 0.0,
    "plane.pitch_min_deg": 0.0,
    "plane.airspeed_reads_low": 0.0,
}
_SPEED_DEFAULTS: dict[tuple[Autopilot, VehicleClass], tuple[float, float]] = {
    ("ardupilot", "copter"): (3.0, 10.0),
    ("px4", "copter"): (3.0, 10.0),
    ("ardupilot", "plane"): (14.0, 22.0),
    ("px4", "plane"): (14.0, 20.0),  # FW_AIRSPD_MAX
}
_PATH_ANGLE_DEG: dict[VehicleClass, float] = {"copter": 60.0, "plane": 12.0}
_TURN_RADIUS_M: dict[VehicleClass, float] = {"copter": 0.0, "plane": 60.0}


def motion_model(settings: VehicleSettings, air_m_s: tuple[float, float] = (0.0, 0.0)) -> MotionModel:
    """Return the navigator's parameters: the mission file's, else the autopilot's defaults.

    ``air_m_s`` is the velocity of the air, east and north: :attr:`.Mission.air_m_s`.

    Raises
    ------
    MissionError
        A plane that circles, by its parameters, more tightly than it turns, or whose airspeeds are out of order.
    """
    assert settings.parameter_file is None, "with_parameter_files first"
    values: dict[str, float] = {}
    if settings.vehicle_class == "plane":
        values = _PLANE_ASSUMED if settings.autopilot == "ardupilot" else _PX4_PLANE_ASSUMED
    values = values | defaults((settings.autopilot, settings.vehicle_class)) | settings.asked_motion()
    own: dict[str, Any] = {field: value for field, value in values.items() if "." not in field}
    turn_radius_m = _or(settings.turn_radius_m, _TURN_RADIUS_M[settings.vehicle_class])
    model = MotionModel(
        autopilot=settings.autopilot,
        vehicle_class=settings.vehicle_class,
        turn_radius_m=turn_radius_m,
        wind_m_s=air_m_s,
        **own,
    )
    model = with_values(model, values)
    if settings.vehicle_class == "plane":
        _check_airspeeds(settings, model)
    told = fields((settings.autopilot, settings.vehicle_class), settings.parameters).get("loiter_radius_m")
    if told is not None and told[1] < turn_radius_m:
        raise MissionError(
            f"turn_radius_m: expected at most the {told[1]:g} m of {told[0]}, got {turn_radius_m:g} m: state how "
            "tightly it turns, or set a wider circle on the vehicle"
        )
    return replace(model, loiter_radius_m=max(model.loiter_radius_m, turn_radius_m))


def _check_airspeeds(settings: VehicleSettings, model: MotionModel) -> None:
    """Refuse a plane that is set to cruise at what it would not fly."""
    slowest, fastest = model.airspeed_limits_m_s
    if not slowest <= model.cruise_speed_m_s <= fastest:
        low, high = _airspeed_names(settings)
        cruise = _name_of(settings, "cruise_speed_m_s")
        raise MissionError(
            f"parameters: expected {low} <= {cruise} <= {high}, got {slowest:g}, {model.cruise_speed_m_s:g} and "
            f"{fastest:g} m/s: set the vehicle so, and say so in the mission file"
        )


def _airspeed_names(settings: VehicleSettings) -> tuple[str, str]:
    return _name_of(settings, "airspeed_limits_m_s.0"), _name_of(settings, "airspeed_limits_m_s.1")


def _name_of(settings: VehicleSettings, field: str) -> str:
    """Return the name of the parameter that sets a field, as the mission file spells it where it does."""
    kind = (settings.autopilot, settings.vehicle_class)
    told = fields(kind, settings.parameters).get(field)
    return told[0] if told is not None else next(p.name for p in parameters(kind) if p.field == field)


def ending(settings: VehicleSettings) -> Ending:
    """Return what the vehicle does at its goal."""
    return settings.end or ("land" if settings.vehicle_class == "copter" else "loiter")


def vehicle_limits(settings: VehicleSettings, vertical_error_m: float) -> VehicleLimits:
    """Return the limits of a path; ``vertical_error_m`` is the terrain model's and widens the terrain margin."""
    model = motion_model(settings)
    low, high = _speeds_m_s(settings, model)
    angle_deg = _PATH_ANGLE_DEG[settings.vehicle_class]
    return VehicleLimits(
        speed_min_m_s=low,
        speed_max_m_s=high,
        climb_angle_rad=math.radians(_or(settings.climb.angle_max_deg, angle_deg)),
        descent_angle_rad=math.radians(_or(settings.descent.angle_max_deg, angle_deg)),
        turn_radius_m=_or(settings.turn_radius_m, _TURN_RADIUS_M[settings.vehicle_class]),
        turn_angle_rad=math.radians(settings.turn_angle_max_deg),
        terrain_margin_m=settings.safety.terrain_m + vertical_error_m,
        obstacle_margin_m=settings.safety.obstacle_m,
        tracking_error_m=settings.tracking_error_m,
        position_error_m=settings.position_error_m,
        deviation_m=deviation_m(model),
        landing_slope_rad=math.radians(settings.safety.landing_slope_max_deg),
        height_agl_max_m=_or(settings.height_agl_max_m, math.inf),
        alt_amsl_max_m=_or(settings.alt_amsl_max_m, math.inf),
        endurance_s=_or(settings.endurance_s, math.inf),
        airspeed_max_m_s=_or(settings.airspeed_max_m_s, math.inf),
        flown_radius_min_m=_or(settings.turn_radius_m, 0.0) if settings.vehicle_class == "plane" else 0.0,
    )


def _speeds_m_s(settings: VehicleSettings, model: MotionModel) -> tuple[float, float]:
    """Return the least and the greatest speed along the path: the mission file's, else what its autopilot allows.

    Raises
    ------
    MissionError
        None is given, and a plane's parameters allow none of the usual ones.
    """
    if settings.speed_m_s is not None:
        return settings.speed_m_s.min, settings.speed_m_s.max
    low, high = _SPEED_DEFAULTS[settings.autopilot, settings.vehicle_class]
    if settings.vehicle_class == "plane":
        slowest, fastest = model.airspeed_limits_m_s
        if slowest > high or fastest < low:
            least, most = _airspeed_names(settings)
            raise MissionError(
                f"speed_m_s: missing: its default, {low:g} to {high:g} m/s, lies outside {least} {slowest:g} to "
                f"{most} {fastest:g} m/s: state min and max within these"
            )
        low, high = max(low, slowest), min(high, fastest)
    elif settings.autopilot == "ardupilot":
        high = model.arducopter.cruise_speed_m_s
    else:
        high = min(high, model.px4.speed_max_m_s)
    return min(low, high), high


def _or(value: float | None, default: float) -> float:
    return default if value is None else value
