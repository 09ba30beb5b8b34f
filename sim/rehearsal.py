"""A plan flown by simulated vehicles in lock-step, disturbed in ways that the plan does not know of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from adapters.endpoint import Endpoint, in_process_pair
from adapters.fleet_link import FleetLink
from adapters.pace_keeper import Told
from adapters.telemetry_log import FleetLog
from missionplanner.flight_check import FlightCheck, check_flight
from missionplanner.pacing import Rules, pacer
from missionplanner.plan import FleetFlight, FleetPlan
from missionplanner.scene import Scene
from sim.fleet import LockstepClock, SimFleet, planned_vehicles


@dataclass(frozen=True, slots=True)
class Pause:
    """An operator who stops one vehicle in mid-mission, and lets it go on."""

    vehicle: str
    at_s: float  # since the fleet's common start
    for_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsal:
    """What came of it."""

    flight: FleetFlight
    check: FlightCheck


def rehearse(
    scene: Scene,
    plan: FleetPlan,
    *,
    correct: bool,
    hold: bool = False,
    wind_m_s: tuple[float, float] | None = None,
    late_s: Mapping[str, float] | None = None,
    pauses: Sequence[Pause] = (),
    seed: int | None = None,
    rules: Rules | None = None,
    log: FleetLog | None = None,
    tell: Told | None = None,
) -> Rehearsal:
    """Fly a plan with its simulated vehicles and return the flight and what it kept clear of.

    Parameters
    ----------
    correct : whether speeds may be commanded on the way
    hold : whether copters may be stopped as well
    wind_m_s : (east, north) that blows instead of the wind planned for
    late_s : how much later than told vehicles take off, by name
    pauses : on the way
    seed : of the simulated vehicles; default: the plan's

    Raises
    ------
    LinkError
        A vehicle did not end its mission.
    """

    def ground(x_m: float, y_m: float) -> float:
        return scene.terrain.ground_amsl_m(x_m, y_m, "a simulated vehicle's landing place")

    fleet = SimFleet(
        planned_vehicles(plan, wind_m_s=wind_m_s, late_s=late_s),
        frame=scene.frame,
        ground=ground,
        seed=plan.seed if seed is None else seed,
    )
    endpoints: list[Endpoint] = []
    with ExitStack() as stack:
        for k, vehicle in enumerate(plan.vehicles):
            there, air = in_process_pair(vehicle.name)
            stack.callback(there.close)
            fleet.attach(air, [k])
            endpoints.append(there)
        clock = _PausingClock(fleet, [vehicle.name for vehicle in plan.vehicles], pauses)
        link = FleetLink(plan, endpoints, clock, log=log)
        link.connect()
        link.upload()
        link.verify()
        link.set_returns()
        link.start()
        clock.begin()
        flight = link.watch(pacer=pacer(scene, plan, correct=correct, hold=hold, rules=rules), tell=tell)
    return Rehearsal(flight, check_flight(scene, plan, flight))


class _PausingClock(LockstepClock):
    """Stops vehicles, and lets them go on, as its time passes."""

    def __init__(self, fleet: SimFleet, names: Sequence[str], pauses: Sequence[Pause]) -> None:
        super().__init__(fleet)
        self._links = dict(zip(names, fleet.links, strict=True))
        steps = [(p.at_s, p.vehicle, True) for p in pauses] + [(p.at_s + p.for_s, p.vehicle, False) for p in pauses]
        self._steps = sorted(steps)
        self._start_s: float | None = None

    def begin(self) -> None:
        """Count the times of pauses from now."""
        self._start_s = self.now_s()

    def wait(self, seconds: float) -> None:
        """Let at most ``seconds`` of simulated time pass."""
        super().wait(seconds)
        now_s = self.now_s()
        while self._start_s is not None and self._steps and now_s >= self._start_s + self._steps[0][0]:
            _, name, stops = self._steps.pop(0)
            autopilot = self._links[name].autopilot
            autopilot.pause(now_s) if stops else autopilot.unpause(now_s)
