"""The autopilots' parameters that decide how a vehicle moves: their names, units and ranges, and what each sets.

One table per autopilot and class. It is the only home of the motion model's defaults too: a vehicle of which nothing
else is known flies as these say. Ranges are the documented ones, lower ends of speeds relaxed to what vehicles obey.
Sources: https://ardupilot.org/copter/docs/parameters.html and https://ardupilot.org/plane/docs/parameters.html (4.5;
older and newer names and units beside them, 4.7's from AP_Param's conversion tables);
https://docs.px4.io/main/en/advanced_config/parameter_reference.html (1.15, with what rc.mc_defaults changes). Planes'
are those of the airframes that the autopilots simulate.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np

Kind = tuple[Literal["ardupilot", "px4"], Literal["copter", "plane"]]

_Model = TypeVar("_Model")

_ROUNDING = 1e-6  # of a value that was single precision once


@dataclass(frozen=True, slots=True)
class Spelling:
    """A name that some firmware gives a parameter; so many of its counts (``per_unit``) make one of the model's."""

    name: str
    per_unit: float = 1.0
    whole: bool = False  # counts in whole steps


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter, and the field of the motion model that it sets; values are in the field's unit.

    ``field`` leads into parts of the model by dots, and into tuples by numbers: ``px4.velocity_gains.0``. The first
    spelling is the one of the firmware that we simulate. ``sent`` means that a plan sets it on the vehicle: it is never
    compared. ``limits_speed`` says which commanded speeds, above or below its value, the autopilot does not fly.
    """

    field: str
    unit: str
    default: float
    low: float
    high: float
    spellings: tuple[Spelling, ...]
    sent: bool = False
    limits_speed: Literal["above", "below"] | None = None

    @property
    def name(self) -> str:
        """Its name in the firmware that we simulate."""
        return self.spellings[0].name

    @property
    def names(self) -> tuple[str, ...]:
        """All its names: a vehicle has one of them."""
        return tuple(spelling.name for spelling in self.spellings)

    def allows(self, value: float) -> bool:
        """Return whether a value of the field is in range, as single precision keeps it."""
        return same(value, self.low) or same(value, self.high) or self.low < value < self.high


class ParameterError(ValueError):
    """A parameter's value is none, or contradicts another; ``name`` is the parameter's."""

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(problem)
        self.name = name


@dataclass(frozen=True, slots=True)
class Difference:
    """A parameter that a vehicle holds otherwise than planned; both in the unit that the vehicle counts in."""

    name: str
    planned: float
    held: float
    plannable: bool  # whether the motion model could take up what is held

    def __str__(self) -> str:
        return f"{self.name} is {shown(self.held)}, planned with {shown(self.planned)}"


def parameters(kind: Kind) -> tuple[Parameter, ...]:
    """Return the parameters that the motion model knows of an autopilot and class."""
    return _TABLES[kind]


def defaults(kind: Kind) -> dict[str, float]:
    """Return what the motion model's fields are by default."""
    return {parameter.field: parameter.default for parameter in _TABLES[kind]}


def find(kind: Kind, name: str) -> tuple[Parameter, Spelling] | None:
    """Return the parameter of that name and how it is spelt; None: the motion model does not know it."""
    return _BY_NAME.get(kind, {}).get(name)


def suggestion(kind: Kind, name: str) -> str:
    """Return what to say of a name that is not known."""
    others = [" ".join(other) for other, names in _BY_NAME.items() if name in names]
    if others:
        return f"it is one of {' and '.join(others)}"
    near = difflib.get_close_matches(name.upper(), _BY_NAME[kind], n=1, cutoff=0.6)
    return f"did you mean {near[0]}?" if near else f"known are {', '.join(p.name for p in _TABLES[kind])}"


def fields(kind: Kind, values: Mapping[str, float]) -> dict[str, tuple[str, float]]:
    """Return what parameters set: by field, the parameter's name and the value in the field's unit.

    Raises
    ------
    ParameterError
        An unknown name, a value out of range or no whole number where that is asked for, or two spellings of one
        parameter that contradict each other.
    """
    known: dict[str, tuple[str, float]] = {}
    for name, value in values.items():
        found = find(kind, name)
        if found is None:
            autopilot, vehicle_class = kind
            raise ParameterError(
                name,
                f"expected a parameter that the motion model knows ({autopilot} {vehicle_class}), got {name!r}: "
                f"{suggestion(kind, name)}",
            )
        parameter, spelling = found
        meant = _meant(parameter, spelling, value)
        other = known.setdefault(parameter.field, (name, meant))
        if not same(other[1], meant):
            raise ParameterError(
                name, f"{name} {shown(value)} contradicts {other[0]} {shown(values[other[0]])}: leave one of them out"
            )
    return known


def value_of(model: object, field: str) -> float:
    """Return a field of the motion model."""
    part: Any = model
    for step in field.split("."):
        part = part[int(step)] if step.isdigit() else getattr(part, step)
    return float(part)


def with_values(model: _Model, values: Mapping[str, float]) -> _Model:
    """Return a motion model with other values of some fields."""
    changes: dict[str, Any] = {}
    for field, value in values.items():
        first, _, rest = field.partition(".")
        before = changes.get(first, getattr(model, first))
        if rest.isdigit():
            changes[first] = (*before[: int(rest)], value, *before[int(rest) + 1 :])
        else:
            changes[first] = with_values(before, {rest: value}) if rest else value
    return replace(model, **changes)  # type: ignore[type-var]


def held(kind: Kind, model: object) -> dict[str, int | float]:
    """Return the parameters of a motion model, by name and in the autopilot's units, as a vehicle would hold them.

    Those that a plan sets on the vehicle are no part of them.
    """
    values: dict[str, int | float] = {}
    for parameter in (p for p in _TABLES[kind] if not p.sent):
        spelling = parameter.spellings[0]
        value = float(np.float32(value_of(model, parameter.field) * spelling.per_unit))
        values[spelling.name] = round(value) if spelling.whole else value
    return values


def changed(kind: Kind, before: Mapping[str, float], after: Mapping[str, float]) -> dict[str, float]:
    """Return the fields that a vehicle's parameters have changed since ``before``; values out of range change none."""
    changes: dict[str, float] = {}
    for name, value in after.items():
        found = find(kind, name)
        if found is not None and before.get(name) != value:
            parameter, spelling = found
            if parameter.allows(value / spelling.per_unit):
                changes[parameter.field] = value / spelling.per_unit
    return changes


def differences(kind: Kind, model: object, values: Mapping[str, float]) -> tuple[Difference, ...]:
    """Return where what a vehicle holds makes it move otherwise than a motion model, beyond single precision."""
    found: list[Difference] = []
    for parameter in _TABLES[kind]:
        planned = value_of(model, parameter.field)
        for spelling in parameter.spellings:
            value = values.get(spelling.name)
            if value is not None and not parameter.sent and not same(value / spelling.per_unit, planned):
                plannable = parameter.allows(value / spelling.per_unit)
                found.append(Difference(spelling.name, planned * spelling.per_unit, value, plannable))
    return tuple(found)


def usual(kind: Kind, model: object) -> bool:
    """Return whether a motion model is that of a vehicle with the default parameters, whatever height it returns at."""
    return all(p.sent or same(value_of(model, p.field), p.default) for p in _TABLES[kind])


def missing(kind: Kind, names: Iterable[str]) -> tuple[Parameter, ...]:
    """Return the parameters that a vehicle holds under none of their names; those that a plan sets do not count."""
    there = set(names)
    return tuple(p for p in _TABLES[kind] if not p.sent and not there.intersection(p.names))


def same(one: float, other: float) -> bool:
    """Return whether two values are one, kept in single precision."""
    return math.isclose(one, other, rel_tol=_ROUNDING, abs_tol=1e-9)


def shown(value: float) -> str:
    """Return a value as a vehicle's single precision has it, in as few digits as tell it."""
    single = float(np.float32(value))
    return str(round(single)) if abs(single) < 1e7 and single == round(single) else str(np.float32(single))


def _meant(parameter: Parameter, spelling: Spelling, value: float) -> float:
    """Return a parameter's value in its field's unit."""
    meant = value / spelling.per_unit
    if not parameter.allows(meant):
        low, high = (shown(limit * spelling.per_unit) for limit in (parameter.low, parameter.high))
        raise ParameterError(spelling.name, f"expected {spelling.name} between {low} and {high}, got {shown(value)}")
    if spelling.whole and value != round(value):
        raise ParameterError(spelling.name, f"expected a whole number for {spelling.name}, got {shown(value)}")
    return meant


def _cm(name: str, new: str, *, whole: bool = True) -> tuple[Spelling, ...]:
    """Return the spellings of an ArduCopter parameter that counts in centimetres, and since 4.7 in metres."""
    return Spelling(name, 100.0, whole), Spelling(new)


def _as(*names: str, whole: bool = False) -> tuple[Spelling, ...]:
    return tuple(Spelling(name, whole=whole) for name in names)


_ARDUCOPTER = (
    Parameter("acceleration_m_s2", "m/s^2", 2.5, 0.5, 10.0, _cm("WPNAV_ACCEL", "WP_ACC", whole=False)),
    Parameter("jerk_m_s3", "m/s^3", 1.0, 1.0, 20.0, _as("WPNAV_JERK", "WP_JERK")),
    Parameter("climb_rate_m_s", "m/s", 2.5, 0.1, 10.0, _cm("WPNAV_SPEED_UP", "WP_SPD_UP", whole=False)),
    Parameter("descent_rate_m_s", "m/s", 1.5, 0.1, 5.0, _cm("WPNAV_SPEED_DN", "WP_SPD_DN", whole=False)),
    Parameter("waypoint_radius_m", "m", 2.0, 0.05, 10.0, _cm("WPNAV_RADIUS", "WP_RADIUS_M", whole=False)),
    Parameter("arducopter.cruise_speed_m_s", "m/s", 10.0, 0.2, 20.0, _cm("WPNAV_SPEED", "WP_SPD", whole=False)),
    Parameter("arducopter.return_speed_m_s", "m/s", 0.0, 0.0, 20.0, _cm("RTL_SPEED", "RTL_SPEED_MS")),
    Parameter("arducopter.return_wait_s", "s", 5.0, 0.0, 60.0, (Spelling("RTL_LOIT_TIME", 1000.0, whole=True),)),
    Parameter("arducopter.return_final_height_m", "m", 0.0, 0.0, 0.0, _cm("RTL_ALT_FINAL", "RTL_ALT_FINAL_M")),
    Parameter("return_height_m", "m", 15.0, 0.3, 3000.0, _cm("RTL_ALT", "RTL_ALT_M"), sent=True),
    Parameter(
        "arducopter.vertical_acceleration_m_s2", "m/s^2", 1.0, 0.5, 5.0, _cm("WPNAV_ACCEL_Z", "WP_ACC_Z", whole=False)
    ),
    Parameter(
        "arducopter.corner_acceleration_m_s2", "m/s^2", 0.0, 0.0, 5.0, _cm("WPNAV_ACCEL_C", "WP_ACC_CNR", whole=False)
    ),
    Parameter("arducopter.land_speed_m_s", "m/s", 0.5, 0.3, 2.0, _cm("LAND_SPEED", "LAND_SPD_MS")),
    Parameter("arducopter.land_slow_below_m", "m", 10.0, 1.0, 100.0, _cm("LAND_ALT_LOW", "LAND_ALT_LOW_M")),
    Parameter("arducopter.land_high_speed_m_s", "m/s", 0.0, 0.0, 5.0, _cm("LAND_SPEED_HIGH", "LAND_SPD_HIGH_MS")),
    Parameter("arducopter.lean_max_deg", "deg", 30.0, 10.0, 80.0, _cm("ANGLE_MAX", "ATC_ANGLE_MAX")),
    Parameter("arducopter.lean_auto_max_deg", "deg", 0.0, 0.0, 45.0, _as("PSC_ANGLE_MAX")),
    Parameter("arducopter.input_time_s", "s", 0.15, 0.0, 1.0, _as("ATC_INPUT_TC")),
    Parameter("arducopter.position_gain", "1/s", 1.0, 0.5, 2.0, _as("PSC_POSXY_P", "PSC_NE_POS_P")),
    Parameter("arducopter.velocity_gains.0", "1/s", 2.0, 0.1, 6.0, _as("PSC_VELXY_P", "PSC_NE_VEL_P")),
    Parameter("arducopter.velocity_gains.1", "1/s^2", 1.0, 0.02, 1.0, _as("PSC_VELXY_I", "PSC_NE_VEL_I")),
    Parameter("arducopter.vertical_gains.0", "1/s", 1.0, 0.5, 4.0, _as("PSC_POSZ_P", "PSC_D_POS_P")),
    Parameter("arducopter.vertical_gains.1", "1/s", 5.0, 1.0, 10.0, _as("PSC_VELZ_P", "PSC_D_VEL_P")),
    Parameter("arducopter.vertical_jerk_m_s3", "m/s^3", 5.0, 1.0, 50.0, _as("PSC_JERK_Z", "PSC_JERK_D")),
    Parameter("arducopter.velocity_gains.2", "", 0.5, 0.0, 1.0, _as("PSC_VELXY_D", "PSC_NE_VEL_D")),
)
_PX4_COPTER = (
    Parameter("acceleration_m_s2", "m/s^2", 3.0, 0.5, 15.0, _as("MPC_ACC_HOR")),
    Parameter("jerk_m_s3", "m/s^3", 4.0, 1.0, 80.0, _as("MPC_JERK_AUTO")),
    Parameter("climb_rate_m_s", "m/s", 3.0, 0.3, 8.0, _as("MPC_Z_V_AUTO_UP")),
    Parameter("descent_rate_m_s", "m/s", 1.5, 0.3, 4.0, _as("MPC_Z_V_AUTO_DN")),
    Parameter("waypoint_radius_m", "m", 2.0, 0.05, 200.0, _as("NAV_ACC_RAD")),
    Parameter("return_height_m", "m", 30.0, 0.1, 10_000.0, _as("RTL_RETURN_ALT"), sent=True),
    Parameter("px4.corner_gain", "1/s", 0.5, 0.1, 1.0, _as("MPC_XY_TRAJ_P")),
    Parameter("px4.lag_max_m", "m", 2.0, 0.1, 10.0, _as("MPC_XY_ERR_MAX")),
    Parameter("px4.altitude_radius_m", "m", 0.8, 0.05, 200.0, _as("NAV_MC_ALT_RAD")),
    Parameter("px4.speed_max_m_s", "m/s", 12.0, 0.5, 20.0, _as("MPC_XY_VEL_MAX"), limits_speed="above"),
    Parameter("px4.return_speed_m_s", "m/s", 5.0, 0.5, 20.0, _as("MPC_XY_CRUISE")),
    Parameter("px4.return_descend_m", "m", 10.0, 0.0, 1000.0, _as("RTL_DESCEND_ALT")),
    Parameter("px4.return_wait_s", "s", 0.0, 0.0, 3600.0, _as("RTL_LAND_DELAY")),
    Parameter("px4.climb_acceleration_m_s2", "m/s^2", 4.0, 2.0, 15.0, _as("MPC_ACC_UP_MAX")),
    Parameter("px4.descent_acceleration_m_s2", "m/s^2", 3.0, 2.0, 15.0, _as("MPC_ACC_DOWN_MAX")),
    Parameter("px4.takeoff_least_m", "m", 2.5, 0.0, 80.0, _as("MIS_TAKEOFF_ALT")),
    Parameter("px4.takeoff_speed_m_s", "m/s", 1.5, 1.0, 5.0, _as("MPC_TKO_SPEED")),
    Parameter("px4.takeoff_ramp_s", "s", 3.0, 0.0, 5.0, _as("MPC_TKO_RAMP_T")),
    Parameter("px4.land_speed_m_s", "m/s", 0.7, 0.5, 4.0, _as("MPC_LAND_SPEED")),
    Parameter("px4.land_crawl_m_s", "m/s", 0.3, 0.1, 4.0, _as("MPC_LAND_CRWL")),
    Parameter("px4.slow_below_m", "m", 10.0, 0.0, 122.0, _as("MPC_LAND_ALT1")),
    Parameter("px4.land_below_m", "m", 5.0, 0.0, 122.0, _as("MPC_LAND_ALT2")),
    Parameter("px4.crawl_below_m", "m", 1.0, 0.0, 122.0, _as("MPC_LAND_ALT3")),
    Parameter("px4.position_gain", "1/s", 0.95, 0.2, 2.0, _as("MPC_XY_P")),
    Parameter("px4.velocity_gains.0", "1/s", 1.8, 1.2, 5.0, _as("MPC_XY_VEL_P_ACC")),
    Parameter("px4.velocity_gains.1", "1/s^2", 0.4, 0.0, 60.0, _as("MPC_XY_VEL_I_ACC")),
    Parameter("px4.velocity_gains.2", "", 0.2, 0.1, 2.0, _as("MPC_XY_VEL_D_ACC")),
    Parameter("px4.vertical_position_gain", "1/s", 1.0, 0.2, 1.5, _as("MPC_Z_P")),
    Parameter("px4.vertical_velocity_gains.0", "1/s", 4.0, 2.0, 15.0, _as("MPC_Z_VEL_P_ACC")),
    Parameter("px4.vertical_velocity_gains.1", "1/s^2", 2.0, 0.2, 3.0, _as("MPC_Z_VEL_I_ACC")),
    Parameter("px4.tilt_max_deg", "deg", 45.0, 20.0, 89.0, _as("MPC_TILTMAX_AIR")),
)
_ARDUPLANE = (
    Parameter(
        "cruise_speed_m_s", "m/s", 22.0, 3.0, 100.0, (Spelling("AIRSPEED_CRUISE"), Spelling("TRIM_ARSPD_CM", 100.0))
    ),
    Parameter(
        "airspeed_limits_m_s.0",
        "m/s",
        9.0,
        3.0,
        100.0,
        _as("AIRSPEED_MIN", "ARSPD_FBW_MIN"),
        limits_speed="below",
    ),
    Parameter(
        "airspeed_limits_m_s.1",
        "m/s",
        30.0,
        3.0,
        100.0,
        _as("AIRSPEED_MAX", "ARSPD_FBW_MAX"),
        limits_speed="above",
    ),
    Parameter("climb_rate_m_s", "m/s", 5.0, 0.1, 20.0, _as("TECS_CLMB_MAX")),
    Parameter("descent_rate_m_s", "m/s", 5.0, 0.1, 20.0, _as("TECS_SINK_MAX")),
    Parameter("plane.l1_period_s", "s", 15.0, 1.0, 60.0, _as("NAVL1_PERIOD")),
    Parameter("plane.l1_damping", "", 0.75, 0.5, 1.0, _as("NAVL1_DAMPING")),
    Parameter("plane.l1_integral", "", 0.02, 0.0, 0.1, _as("NAVL1_XTRACK_I")),
    Parameter(
        "plane.roll_max_deg",
        "deg",
        65.0,
        10.0,
        90.0,
        (Spelling("ROLL_LIMIT_DEG"), Spelling("LIM_ROLL_CD", 100.0, True)),
    ),
    Parameter("plane.roll_time_s", "s", 0.25, 0.1, 2.0, _as("RLL2SRV_TCONST")),
    Parameter("plane.pitch_max_deg", "deg", 15.0, 0.0, 45.0, _as("TECS_PITCH_MAX")),
    Parameter("plane.pitch_min_deg", "deg", 0.0, -45.0, 0.0, _as("TECS_PITCH_MIN")),
    Parameter(
        "plane.pitch_limits_deg.0",
        "deg",
        -20.0,
        -90.0,
        -5.0,
        (Spelling("PTCH_LIM_MIN_DEG"), Spelling("LIM_PITCH_MIN", 100.0, True)),
    ),
    Parameter(
        "plane.pitch_limits_deg.1",
        "deg",
        25.0,
        5.0,
        90.0,
        (Spelling("PTCH_LIM_MAX_DEG"), Spelling("LIM_PITCH_MAX", 100.0, True)),
    ),
    Parameter("plane.pitch_time_s", "s", 0.25, 0.1, 2.0, _as("PTCH2SRV_TCONST")),
    Parameter("plane.cruise_throttle", "", 0.5, 0.0, 1.0, (Spelling("TRIM_THROTTLE", 100.0, True),)),
    Parameter("plane.throttle_slew", "1/s", 1.0, 0.1, 1.27, (Spelling("THR_SLEWRATE", 100.0, True),)),
    Parameter("plane.sink_min_m_s", "m/s", 2.0, 0.1, 10.0, _as("TECS_SINK_MIN")),
    Parameter("plane.energy_time_s", "s", 5.0, 2.0, 20.0, _as("TECS_TIME_CONST")),
    Parameter("plane.level_off_s", "s", 2.0, 0.0, 10.0, _as("TKOFF_PLIM_SEC")),
    Parameter("plane.slope_min_m", "m", 15.0, 0.0, 1000.0, _as("GLIDE_SLOPE_MIN", "ALT_SLOPE_MIN")),
    Parameter("waypoint_radius_m", "m", 50.0, 1.0, 32_767.0, _as("WP_RADIUS")),
    Parameter("loiter_radius_m", "m", 60.0, 1.0, 32_767.0, _as("WP_LOITER_RAD")),
    Parameter(
        "return_height_m",
        "m",
        100.0,
        0.01,
        32_767.0,
        (Spelling("RTL_ALTITUDE"), Spelling("ALT_HOLD_RTL", 100.0, whole=True)),
        sent=True,
    ),
)
_PX4_PLANE = (
    Parameter("cruise_speed_m_s", "m/s", 15.0, 0.5, 100.0, _as("FW_AIRSPD_TRIM")),
    Parameter("airspeed_limits_m_s.0", "m/s", 10.0, 0.5, 100.0, _as("FW_AIRSPD_MIN"), limits_speed="below"),
    Parameter("airspeed_limits_m_s.1", "m/s", 20.0, 0.5, 100.0, _as("FW_AIRSPD_MAX"), limits_speed="above"),
    Parameter("climb_rate_m_s", "m/s", 5.0, 1.0, 15.0, _as("FW_T_CLMB_MAX")),
    Parameter("descent_rate_m_s", "m/s", 5.0, 1.0, 15.0, _as("FW_T_SINK_MAX")),
    Parameter("plane.l1_period_s", "s", 10.0, 1.0, 100.0, _as("NPFG_PERIOD")),
    Parameter("plane.l1_damping", "", 0.7, 0.1, 1.0, _as("NPFG_DAMPING")),
    Parameter("plane.roll_max_deg", "deg", 50.0, 35.0, 65.0, _as("FW_R_LIM")),
    Parameter("plane.roll_time_s", "s", 0.4, 0.2, 1.0, _as("FW_R_TC")),
    Parameter("plane.pitch_limits_deg.0", "deg", -30.0, -60.0, -5.0, _as("FW_P_LIM_MIN")),
    Parameter("plane.pitch_limits_deg.1", "deg", 30.0, 5.0, 60.0, _as("FW_P_LIM_MAX")),
    Parameter("plane.pitch_time_s", "s", 0.4, 0.2, 1.0, _as("FW_P_TC")),
    Parameter("plane.sink_min_m_s", "m/s", 2.0, 1.0, 5.0, _as("FW_T_SINK_MIN")),
    Parameter("plane.energy_time_s", "s", 5.0, 2.0, 60.0, _as("FW_T_ALT_TC")),
    Parameter("waypoint_radius_m", "m", 50.0, 0.05, 200.0, _as("NAV_ACC_RAD")),
    Parameter("loiter_radius_m", "m", 80.0, 1.0, 1000.0, _as("NAV_LOITER_RAD")),
    Parameter("return_height_m", "m", 100.0, 0.1, 10_000.0, _as("RTL_RETURN_ALT"), sent=True),
)
_TABLES: dict[Kind, tuple[Parameter, ...]] = {
    ("ardupilot", "copter"): _ARDUCOPTER,
    ("px4", "copter"): _PX4_COPTER,
    ("ardupilot", "plane"): _ARDUPLANE,
    ("px4", "plane"): _PX4_PLANE,
}
_BY_NAME: dict[Kind, dict[str, tuple[Parameter, Spelling]]] = {
    kind: {s.name: (p, s) for p in table for s in p.spellings} for kind, table in _TABLES.items()
}
