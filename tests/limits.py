"""A vehicle's limits for tests: a tube of 2 m."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from missionplanner.vehicle import VehicleLimits

_BASE = VehicleLimits(
    speed_min_m_s=3.0,
    speed_max_m_s=10.0,
    climb_angle_rad=math.radians(45.0),
    descent_angle_rad=math.radians(45.0),
    turn_radius_m=0.0,
    turn_angle_rad=math.pi,
    terrain_margin_m=20.0,
    obstacle_margin_m=10.0,
    tracking_error_m=2.0,
    position_error_m=0.0,
    deviation_m=0.0,
    landing_slope_rad=math.radians(15.0),
    height_agl_max_m=math.inf,
    alt_amsl_max_m=math.inf,
    endurance_s=math.inf,
)


def limits(**changes: Any) -> VehicleLimits:
    """Return limits without ceilings that climb and descend at 45 degrees, but for ``changes``."""
    return replace(_BASE, **changes)
