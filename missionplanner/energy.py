"""What flying takes of a battery: along a predicted flight, and home from everywhere on it.

Power, as a share of the battery per second, is the sum of

- *staying up*: the power of level flight (copters: hovering) in calm air, as the mission file has it at sea level;
  thinner air takes more, as 1 / sqrt(density) (momentum theory: Leishman, Principles of Helicopter Aerodynamics, 2.2),
  in the standard atmosphere (ISO 2533). What a copter saves while it moves slowly (translational lift) does not count.
- *climbing*: m g w / efficiency. Sinking costs as much as level flight: nothing is given back.
- *the air*: a copter's drag, 1/2 density (c_d A) v^3 / efficiency, on top; a plane's level power grows with the cube of
  its airspeed over the cruise speed, and is never less than at that.

Where the strongest wind is stated (``wind_max_m_s``), airspeed is the ground speed plus all of that: it blows from
ahead on every leg, and while standing still as well. Where only a steady wind is, airspeed is that of the predicted
flight through it.
Motions are taken as they are sampled, even between two samples: to be given tick by tick.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from missionplanner.certificate import Finding
from missionplanner.geodesy import FloatArray
from missionplanner.mission import VehicleSettings
from missionplanner.motion import landing_s, return_points
from missionplanner.plan import Trajectory
from missionplanner.sortie import Sortie
from missionplanner.vehicle import MotionModel, motion_model, vehicle_limits
from missionplanner.wind import airspeed_limit_m_s, along_m_s, braking_m_s2, calm, told

GRAVITY_M_S2 = 9.80665
SEA_LEVEL_DENSITY_KG_M3 = 1.225  # ISO 2533

COPTER_EFFICIENCY = 0.7
"""Of motors and rotors, for power on top of hovering. With 150 W/kg, climbing at 1 m/s takes 9 % more than hovering: a
3DR Solo takes a fifth more at 2.5 m/s (https://discuss.ardupilot.org/t/32200)."""
COPTER_DRAG_AREA_M2_KG = 0.01
"""c_d A over mass: one over the ballistic coefficient of 100 kg/m^2 that PX4 assumes of multicopters (EKF2_BCOEF_X)."""
COPTER_HOVER_W_KG = 150.0
"""Where only the endurance is known. Small multicopters hover at 150 to 180 W/kg; the less hovering takes, the more a
climb or the wind adds as a share of it, so the least is assumed."""

PLANE_EFFICIENCY = 0.5
"""Of propeller (0.65) and motor with its controller (0.8)."""
PLANE_GLIDE_RATIO = 12.0
"""Where only the endurance is known. Small planes glide 8 to 12 to one; the better they do, the more a climb adds."""

_SAME_SHARE = 1e-9


@dataclass(frozen=True, slots=True)
class EnergyModel:
    """What one vehicle takes of its battery, in shares of its capacity."""

    motion: MotionModel
    level_share_s: float  # per second of level flight, calm, at sea level
    climb_share_m: float  # per metre climbed
    drag_share_s: float  # per second at an airspeed of 1 m/s at sea level; copters
    reserve_share: float
    airspeed_max_m_s: float  # against wind from anywhere: stated, or the speeds it flies at in calm air
    airspeed_held_m_s: float  # in the wind that flights are predicted in: a copter's lean limit, a plane's cruise speed

    def power_share(
        self, ground_m_s: npt.ArrayLike, climb_m_s: npt.ArrayLike, wind_m_s: float, alt_amsl_m: npt.ArrayLike = 0.0
    ) -> FloatArray:
        """Return the share of the battery that each second takes, at horizontal and vertical speeds (...), (...)."""
        rise = np.asarray(climb_m_s, dtype=float)
        airspeed = np.hypot(np.asarray(ground_m_s, dtype=float) + wind_m_s, rise)
        density = relative_density(alt_amsl_m)
        if self.motion.vehicle_class == "copter":
            level = self.level_share_s / np.sqrt(density) + self.drag_share_s * density * airspeed**3
        else:
            faster = density * (airspeed / self.motion.cruise_speed_m_s) ** 3
            level = self.level_share_s * np.maximum(faster, 1.0 / np.sqrt(density))
        power: FloatArray = level + self.climb_share_m * np.maximum(rise, 0.0)
        return power


def relative_density(alt_amsl_m: npt.ArrayLike) -> FloatArray:
    """Return the density of the standard atmosphere (ISO 2533) over that at sea level."""
    density: FloatArray = np.maximum(1.0 - 2.25577e-5 * np.asarray(alt_amsl_m, dtype=float), 0.1) ** 4.256
    return density


def energy_model(settings: VehicleSettings, air_m_s: tuple[float, float] = (0.0, 0.0)) -> EnergyModel | None:
    """Return what flying takes of a vehicle's battery; None where the mission file states neither energy nor endurance.

    Where only the endurance is known, climbs and drag are shares of it, typical of small vehicles. ``air_m_s``: the
    velocity of the air that flights are predicted in.
    """
    motion = motion_model(settings, air_m_s)
    copter = motion.vehicle_class == "copter"
    efficiency = COPTER_EFFICIENCY if copter else PLANE_EFFICIENCY
    if settings.energy is not None:
        level_w_kg = settings.energy.level_power_w / settings.energy.mass_kg
        level_share_s = settings.energy.level_power_w / (3600.0 * settings.energy.capacity_wh)
    elif settings.endurance_s is not None:
        # a plane at its cruise speed sinks by speed over glide ratio without power: that, times weight, is level power
        gliding_w_kg = GRAVITY_M_S2 * motion.cruise_speed_m_s / PLANE_GLIDE_RATIO / PLANE_EFFICIENCY
        level_w_kg = COPTER_HOVER_W_KG if copter else gliding_w_kg
        level_share_s = 1.0 / settings.endurance_s
    else:
        return None
    per_w_kg = level_share_s / level_w_kg
    drag_w_kg = 0.5 * SEA_LEVEL_DENSITY_KG_M3 * COPTER_DRAG_AREA_M2_KG / efficiency
    homing_m_s = float(return_points(motion, np.zeros(3), np.zeros(3)).speed_m_s[0])
    proven_m_s = max(vehicle_limits(settings, 0.0).speed_max_m_s, homing_m_s)  # in calm air, it flies as fast as that
    return EnergyModel(
        motion=motion,
        level_share_s=level_share_s,
        climb_share_m=per_w_kg * GRAVITY_M_S2 / efficiency,
        drag_share_s=per_w_kg * drag_w_kg if copter else 0.0,
        reserve_share=settings.reserve_share,
        airspeed_max_m_s=proven_m_s if settings.airspeed_max_m_s is None else settings.airspeed_max_m_s,
        airspeed_held_m_s=min(airspeed_limit_m_s(motion), settings.airspeed_max_m_s or math.inf)
        if copter
        else motion.cruise_speed_m_s,
    )


def used_share(model: EnergyModel, trajectory: Trajectory, wind_m_s: float, takeoff_s: float = -math.inf) -> FloatArray:
    """Return the share of the battery (S,) used up to each sample; nothing is used before ``takeoff_s``.

    ``wind_m_s`` is the strongest wind, from ahead everywhere; 0: it is the model's.
    """
    t, position = trajectory.t_s, trajectory.position_m
    step, flown_s = np.diff(position, axis=0), np.diff(np.maximum(t, takeoff_s))
    ground, climb = np.hypot(step[:, 0], step[:, 1]) / np.diff(t), step[:, 2] / np.diff(t)
    if wind_m_s == 0.0 and not calm(model.motion):
        ground = np.hypot(*(step[:, :2] / np.diff(t)[:, np.newaxis] - model.motion.wind_m_s).T)
    alt_amsl_m = position[:, 2]
    power = np.maximum(  # over density it is convex: between two altitudes it is at most what it is at one of them
        model.power_share(ground, climb, wind_m_s, alt_amsl_m[:-1]),
        model.power_share(ground, climb, wind_m_s, alt_amsl_m[1:]),
    )
    used: FloatArray = np.concatenate([[0.0], np.cumsum(power * flown_s)])
    return used


def can_fly(model: EnergyModel, ground_m_s: npt.ArrayLike, wind_m_s: float) -> npt.NDArray[np.bool_]:
    """Return whether ground speeds (...) can be held against the wind; in calm air, the speed range alone decides."""
    held: npt.NDArray[np.bool_] = np.asarray(ground_m_s, dtype=float) + wind_m_s <= model.airspeed_max_m_s + 1e-3
    return held | (wind_m_s == 0.0)


def return_share(
    model: EnergyModel, trajectory: Trajectory, home_m: npt.ArrayLike, return_height_m: float, wind_m_s: float
) -> FloatArray:
    """Return the share of the battery (S,) that the direct way home takes from each sample; infinite: never home.

    A copter brakes, climbs to its return height, flies home against the wind as fast as its autopilot does and its
    greatest airspeed allows, waits and lands. A plane flies at its cruise speed through the air, and circles twice.
    On the way between two samples it is at most what it is at one of them: everything is convex in the position.
    ``wind_m_s`` is the strongest wind, from ahead; 0: it is the model's.
    """
    motion, position = replace(model.motion, return_height_m=return_height_m), trajectory.position_m
    home = np.asarray(home_m, dtype=float)
    above = home + np.array([0.0, 0.0, return_height_m])
    way = return_points(motion, above, home)
    asked_m_s = float(way.speed_m_s[0])
    copter = motion.vehicle_class == "copter"
    known = wind_m_s == 0.0 and not calm(motion)
    if known:
        wind_m_s = math.hypot(*motion.wind_m_s)
        ground_m_s = model.airspeed_held_m_s - wind_m_s  # whatever the course
        ground_m_s = min(asked_m_s, ground_m_s) if copter else ground_m_s
    else:
        ground_m_s = min(asked_m_s, model.airspeed_max_m_s - wind_m_s) if copter else asked_m_s - wind_m_s
    if ground_m_s <= 0.0:
        return np.full(len(position), math.inf)
    velocity = np.diff(position, axis=0) / np.diff(trajectory.t_s)[:, None]
    speed_m_s = float(np.hypot(velocity[:, 0], velocity[:, 1]).max(initial=0.0))
    rise_m_s = float(velocity[:, 2].max(initial=0.0))
    loop_s = motion.settling_s  # by so much a change of speed takes longer than at full acceleration
    settling_s = max(loop_s, 0.5 * motion.acceleration_m_s2 / motion.jerk_m_s3)
    brakes_m_s2 = braking_m_s2(motion, wind_m_s)
    braking_s = speed_m_s / brakes_m_s2 + 2.0 * settling_s
    braking_m = speed_m_s * (0.5 * speed_m_s / brakes_m_s2 + settling_s)
    going_s = asked_m_s / brakes_m_s2 + 4.0 * settling_s  # what speeding up and slowing down lose
    away_m = np.hypot(position[:, 0] - home[0], position[:, 1] - home[1])
    if known:  # where it comes to rest, its way home has another course: the time to anywhere in a wind is a norm
        made = along_m_s(motion, model.airspeed_held_m_s, home[:2] - position[:, :2])
        way_s = away_m / (np.minimum(made, asked_m_s) if copter else made) + braking_m / ground_m_s
    else:
        way_s = (away_m + braking_m) / ground_m_s
    high_m = np.maximum(
        position[:, 2] + rise_m_s * (0.5 * rise_m_s / motion.vertical_acceleration_m_s2 + loop_s), above[2]
    )
    if copter:
        down_s = landing_s(motion, return_height_m)
        down_s += float(way.hold_s.sum()) + 2.0 * loop_s * len(way.points_m)
        ending_s = down_s + (high_m - above[2]) / motion.descent_rate_m_s
    else:
        circle_m = motion.circle_m(asked_m_s, above[2], math.hypot(*motion.wind_m_s) if known else wind_m_s)
        ending_s = np.full(len(position), 2.0 * 2.0 * math.pi * circle_m / ground_m_s)
    altitudes_m = np.array([min(float(home[2]), float(position[:, 2].min())), float(high_m.max())])

    def power(speed_m_s: float, climb_m_s: float) -> float:
        return float(model.power_share(speed_m_s, climb_m_s, wind_m_s, altitudes_m).max())

    brake, climb = power(max(speed_m_s, asked_m_s), 0.0), power(0.0, motion.climb_rate_m_s)
    cruise = power(ground_m_s, 0.0)
    if known:
        through_m_s = min(model.airspeed_held_m_s, asked_m_s + wind_m_s) if copter else model.airspeed_held_m_s
        cruise = power(through_m_s - wind_m_s, 0.0)
    climb_s = (high_m - position[:, 2]) / motion.climb_rate_m_s
    share: FloatArray = brake * braking_s + climb * climb_s + cruise * (going_s + way_s + ending_s)
    return share


def findings(
    model: EnergyModel,
    sortie: Sortie,
    trajectory: Trajectory,
    reached_s: FloatArray,
    wind_m_s: float,
    *,
    return_waived: bool = False,
) -> list[Finding]:
    """Return whether the battery lasts, with its reserve: to the mission's end, and home from everywhere before.

    Parameters
    ----------
    trajectory : the predicted flight
    reached_s : when it reaches the ends of the sortie's legs (L,)
    return_waived : whether nothing is asked of the way home
    """
    used = used_share(model, trajectory, wind_m_s, sortie.start_delay_s)
    allowed = 1.0 - model.reserve_share
    windy = f" in {_wind_told(model, wind_m_s)}" if wind_m_s > 0.0 or not calm(model.motion) else ""
    total = float(used[-1])
    enough = total <= allowed + _SAME_SHARE
    found = [
        Finding(
            "energy",
            sortie.name,
            enough,
            f"takes {total:.1%} of its battery{windy}, allowed {allowed:.0%}",
            "" if enough else "shorten its way, or take a larger battery (energy, endurance_s)",
            total,
            allowed,
            "",
        )
    ]
    if wind_m_s > 0.0:
        found.append(_against_the_wind(model, sortie, wind_m_s))
    found.append(_home(model, sortie, trajectory, reached_s, used, wind_m_s, return_waived))
    return found


def _wind_told(model: EnergyModel, wind_m_s: float) -> str:
    return f"{wind_m_s:g} m/s of wind" if wind_m_s > 0.0 else told(model.motion)


def _against_the_wind(model: EnergyModel, sortie: Sortie, wind_m_s: float) -> Finding:
    leg = max(sortie.legs[1:] or sortie.legs, key=lambda leg: leg.speed_m_s)
    held = bool(can_fly(model, leg.speed_m_s, wind_m_s))
    need_m_s = leg.speed_m_s + wind_m_s
    return Finding(
        "energy",
        sortie.name,
        held,
        f"needs an airspeed of {need_m_s:g} m/s to fly {leg.speed_m_s:g} m/s against {wind_m_s:g} m/s of wind, "
        f"allowed {model.airspeed_max_m_s:g} m/s",
        "" if held else "fly slower, or state airspeed_max_m_s in the mission file",
        need_m_s,
        model.airspeed_max_m_s,
        "m/s",
        seq=leg.seq,
    )


def _home(
    model: EnergyModel,
    sortie: Sortie,
    trajectory: Trajectory,
    reached_s: FloatArray,
    used: FloatArray,
    wind_m_s: float,
    waived: bool,
) -> Finding:
    t_s = trajectory.t_s
    until_s = float(t_s[-1] if sortie.ending == "loiter" else reached_s[-1])
    home = return_share(model, trajectory, sortie.home_m, sortie.return_height_m, wind_m_s)
    need = used[1:] + np.maximum(home[1:], home[:-1])  # of all that lies between two samples
    asked = (t_s[1:] > sortie.start_delay_s) & (t_s[:-1] <= until_s)
    worst = int(np.argmax(np.where(asked, need, -math.inf)))
    share, allowed = float(need[worst]), 1.0 - model.reserve_share
    enough = share <= allowed + _SAME_SHARE
    where_m = trajectory.position_m[worst]
    leg = sortie.legs[min(int(np.searchsorted(reached_s, t_s[worst])), len(sortie.legs) - 1)]
    return Finding(
        "energy",
        sortie.name,
        enough,
        f"returning at {t_s[worst]:.0f} s takes {share:.1%} of its battery in all, allowed {allowed:.0%}"
        if math.isfinite(share)
        else f"gets nowhere against {_wind_told(model, wind_m_s)} when it is to return",
        "" if enough else "stay nearer to its home, or set fleet.direct_return: waived",
        share if math.isfinite(share) else None,
        allowed,
        "",
        seq=leg.seq,
        position_m=(float(where_m[0]), float(where_m[1]), float(where_m[2])),
        t_s=float(t_s[worst]),
        waived=waived,
    )
