"""How an autopilot's navigator flies a route: one piece of code for the planner's clock and for the simulator.

Three navigators, each after the code that flies the real vehicle (:mod:`.arducopter`, :mod:`.px4`, :mod:`.plane`). A
copter's navigator moves a *target* along the route; the vehicle itself follows it as its position controller and the
air allow (:mod:`.airframe`, :mod:`.px4_airframe`), and where it lags the navigator waits for it. That lag is what makes
a real vehicle late.

Routes are points of the local frame (x east, y north, z altitude AMSL). A leg's speed is horizontal, as autopilots
understand it; vertical rates have their own limits, and the slower of the two decides.
"""

from missionplanner.motion.navigator import TICK_S, Navigator, predict
from missionplanner.motion.plane import climbing_as_stated
from missionplanner.motion.routes import Route, landing_points, landing_s, return_points, takeoff_points

__all__ = [
    "TICK_S",
    "Navigator",
    "Route",
    "climbing_as_stated",
    "landing_points",
    "landing_s",
    "predict",
    "return_points",
    "takeoff_points",
]
