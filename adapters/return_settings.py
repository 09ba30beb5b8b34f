"""The parameters that make a vehicle return (RTL, lost link) as it was proven: straight home at its own height.

Names, units and meanings: https://ardupilot.org/copter/docs/rtl-mode.html and ArduCopter/mode_rtl.cpp (metres and new
names since 4.7), https://ardupilot.org/plane/docs/rtl-mode.html, https://docs.px4.io/main/en/flight_modes/return.html
and PX4's navigator/rtl.cpp. What acts beside the height:

- ArduCopter: RTL_CONE_SLOPE climbs less near home, RTL_CLIMB_MIN climbs even where it is high enough, RTL_ALT_TYPE
  (since 4.0) may measure from the terrain. With 0 in all of them it returns at max(present height, RTL_ALT).
- ArduPlane: RTL_CLIMB_MIN (since 4.0.6) climbs straight on before it turns.
- PX4: RTL_TYPE 0 goes to home or a nearer rally point; 1 to the mission's landing, 2 and 4 along the mission, 3 to the
  nearest of all these, 5 to rally points only. RTL_CONE_ANG lets copters climb less near home. A plane sinks to
  RTL_DESCEND_ALT above home and circles there for good: that is its return height too.

Rally points replace home on both autopilots, whatever the parameters say: a vehicle must hold none.
"""

from __future__ import annotations

from dataclasses import dataclass

from adapters.parameter_protocol import ParameterValue, from_wire, is_integer, to_wire
from missionplanner.vehicle import Autopilot, VehicleClass

_ROUNDING_M = 0.01  # a height is kept to the centimetre, or not at all


@dataclass(frozen=True, slots=True)
class Setting:
    """What one parameter must hold: ``value``, in metres where it is a height.

    ``units`` has each name that firmware gives it, with the unit it counts in; ``optional`` means that older firmware
    lacks it, and then behaves as if it held ``value``.
    """

    value: float
    units: tuple[tuple[str, float], ...]
    optional: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        """All names, to be asked for at once: a vehicle has one of them."""
        return tuple(name for name, _ in self.units)

    def meant(self, held: ParameterValue) -> float:
        """Return what the vehicle holds, in the unit of ``value``."""
        return held.value * dict(self.units)[held.name]

    def wanted(self, held: ParameterValue, autopilot: Autopilot) -> float:
        """Return what the vehicle is to hold, in its own unit and as its type keeps it.

        Raises
        ------
        ValueError
            The type cannot keep it.
        """
        unit = dict(self.units)[held.name]
        wanted = self.value / unit
        if is_integer(held.kind):
            if abs(round(wanted) - wanted) * unit > _ROUNDING_M:
                raise ValueError(f"it counts whole steps of {unit:g} m")
            wanted = float(round(wanted))
        return from_wire(to_wire(wanted, held.kind, autopilot), held.kind, autopilot)


def return_settings(autopilot: Autopilot, vehicle_class: VehicleClass, height_m: float) -> tuple[Setting, ...]:
    """Return what a vehicle must be set to so that it returns at a height above home; that itself comes first."""
    match autopilot, vehicle_class:
        case "ardupilot", "copter":
            return (
                Setting(height_m, (("RTL_ALT", 0.01), ("RTL_ALT_M", 1.0))),
                Setting(0.0, (("RTL_CLIMB_MIN", 0.01), ("RTL_CLIMB_MIN_M", 1.0))),
                Setting(0.0, (("RTL_CONE_SLOPE", 1.0),)),
                Setting(0.0, (("RTL_ALT_TYPE", 1.0),), optional=True),
            )
        case "ardupilot", _:
            return (
                Setting(height_m, (("RTL_ALTITUDE", 1.0), ("ALT_HOLD_RTL", 0.01))),
                Setting(0.0, (("RTL_CLIMB_MIN", 1.0),), optional=True),
            )
        case _, "copter":
            return (
                Setting(height_m, (("RTL_RETURN_ALT", 1.0),)),
                Setting(0.0, (("RTL_TYPE", 1.0),)),
                Setting(0.0, (("RTL_CONE_ANG", 1.0),)),
            )
        case _:
            return (
                Setting(height_m, (("RTL_RETURN_ALT", 1.0),)),
                Setting(height_m, (("RTL_DESCEND_ALT", 1.0),)),
                Setting(0.0, (("RTL_TYPE", 1.0),)),
            )
