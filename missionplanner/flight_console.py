"""The operator's side of a flight: what each vehicle lacks before it, how all do in it, orders, and a last word.

Orders come by single keys where there is a terminal, and from other terminals (``missionplanner command``). Ctrl-C asks
what the flying vehicles shall do, while they are watched on. Without a terminal, at a second Ctrl-C and at SIGTERM they
fly on with their missions. The last line says what each vehicle was told and whether it obeys.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing, nullcontext
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

from rich.console import Group
from rich.live import Live
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from adapters.fleet_flight import Request
from adapters.order_box import OrderBox
from missionplanner.errors import LinkError, MissionError
from missionplanner.terminal import Keys, stderr

if TYPE_CHECKING:
    from adapters.fleet_flight import FlightControl
    from adapters.fleet_vehicle import Order, VehicleStatus
    from missionplanner.pacing import Pacer
    from missionplanner.plan import FleetFlight, FleetPlan, Ordered

ORDERS_FOLDER = "orders"
_LOOK_S = 0.2  # for orders from other terminals
_KEYS: dict[str, Order] = {"p": "pause", "c": "resume", "R": "rtl", "L": "land"}
_LEAVING: dict[str, Order | None] = {"f": None, "p": "pause", "r": "rtl", "l": "land"}
_HELP = "p pause  c continue  R return  L land where they are  Ctrl-C leave"
_QUESTION = "leave them: f fly on unattended  p pause  r return  l land where they are  w watch on  (Ctrl-C: fly on)"


def fly_and_watch(
    link: FlightControl,
    fleet_plan: FleetPlan,
    pacer: Pacer,
    folder: Path,
    *,
    simulated: bool,
    start_s: Callable[[Callable[[str], None]], float | None],
) -> FleetFlight:
    """Start all together and watch until all have ended, taking orders; an interrupt asks what shall become of them.

    ``start_s`` returns when to start on the link's clock (None: at once), and may tell of it.
    """
    failure: LinkError | None = None
    box = OrderBox(folder / ORDERS_FOLDER)  # before anybody flies: it may not be possible
    with closing(box), _Interrupts() as interrupts, Keys() as keys:
        try:
            with _Readiness([vehicle.name for vehicle in fleet_plan.vehicles]) as readiness:
                link.start(readiness.lacks, at_s=start_s(readiness.remark))
        except KeyboardInterrupt:
            interrupts.raises = False
            if not simulated:
                leave(link, keys, interrupts)
            raise
        except LinkError as error:
            interrupts.raises = False
            if not (link.started and link.armed):
                if link.armed and not simulated:
                    _last_word(link)
                raise
            failure = error  # somebody has left the ground, or did not answer when the start was called off
            _print(f"{error}; watching")
        except BaseException:
            interrupts.raises = False
            if link.armed and not simulated:
                _end(link)
            raise
        interrupts.raises = False
        try:
            flight = _watch(link, fleet_plan, pacer, _Bridge(keys, interrupts, box, asks=not simulated))
        except BaseException as error:  # whatever it is: nobody watches them now
            if not simulated and (link.flying or isinstance(error, KeyboardInterrupt)):
                _end(link)
            raise
    if failure is not None:
        raise failure
    return flight


def _watch(link: FlightControl, fleet_plan: FleetPlan, pacer: Pacer, bridge: _Bridge) -> FleetFlight:
    columns = (TextColumn("{task.description:<30}"), BarColumn(), TextColumn("{task.percentage:>3.0f} %"))
    progress = Progress(*columns, TimeElapsedColumn(), console=stderr)
    ends_s = {vehicle.sysid: float(vehicle.trajectory.t_s[-1]) for vehicle in fleet_plan.vehicles}
    bars = {v.sysid: progress.add_task(f"flying  {v.name}", total=ends_s[v.sysid]) for v in fleet_plan.vehicles}

    def show(fleet: Sequence[VehicleStatus]) -> None:
        for vehicle in fleet:
            done_s = ends_s[vehicle.sysid] if vehicle.landed else (vehicle.t_s or 0.0)
            late_s = None if vehicle.pace is None else vehicle.pace.lateness_s
            item = "" if vehicle.item is None or vehicle.landed else f" {vehicle.item}/{vehicle.items - 1}"
            late = "" if late_s is None or vehicle.landed else f" {late_s:+.1f} s"
            progress.update(
                bars[vehicle.sysid],
                completed=done_s,
                description=f"{vehicle.doing:<7} {vehicle.name}{item}{late}",
                refresh=False,
            )

    screen: AbstractContextManager[object] = nullcontext()
    if stderr.is_terminal:
        screen = Live(Group(progress, bridge), console=stderr, refresh_per_second=4)
    with screen:
        return link.watch(show, pacer=pacer, tell=tell, helm=bridge)


def tell(text: str) -> None:
    """Print a line for the operator, above whatever is being shown."""
    stderr.print(text, soft_wrap=True, highlight=False, markup=False)


def leave(link: FlightControl, keys: Keys, interrupts: _Interrupts) -> None:
    """Ask what flying vehicles shall do before nobody watches them, order it, and say how they are left."""
    _call_off(link)
    if link.flying and keys.present:
        bridge = _Bridge(keys, interrupts, None, asks=True)
        tell(f"flying: {', '.join(link.flying)}; {_QUESTION.replace('  w watch on', '')}")
        try:
            while (request := bridge.request()) is None:
                link.pump()
            for outcome in link.order(request.order, request.vehicles):
                tell(outcome.words)
        except KeyboardInterrupt:
            pass  # fly on
    _last_word(link)


def _end(link: FlightControl) -> None:
    _call_off(link)
    _last_word(link)


def _call_off(link: FlightControl) -> None:
    try:
        if grounded := link.call_off():
            _print(f"not started, and left disarmed on the ground: {', '.join(grounded)}")
    except LinkError as error:
        _print(str(error))
    except Exception as error:  # of the links themselves: how all are left is to be said all the same
        _print(f"who has not started could not be told to stay on the ground ({error}): take over by hand")


def _last_word(link: FlightControl) -> None:
    standing = "; ".join(link.standing())
    if link.flying:
        _print(f"nobody watches them now: {standing}; who misses a ground station may return by its own failsafe")
    else:
        _print(f"nobody flies: {standing}")


def _print(text: str) -> None:
    print(f"missionplanner: {text}", file=sys.stderr)


class _Interrupts:
    """Ctrl-C while a fleet flies: raised before the watch, counted in it; SIGTERM and a lost terminal count as two."""

    def __init__(self) -> None:
        self.raises = True
        self.count = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Interrupts:
        if threading.current_thread() is threading.main_thread():
            ending = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
            for number in (signal.SIGINT, *ending):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def _note(self, number: int, frame: FrameType | None) -> None:
        del frame
        if self.raises:
            self.raises = False
            self.count = 0 if number == signal.SIGINT else 2
            raise KeyboardInterrupt
        self.count += 1 if number == signal.SIGINT else 2


class _Bridge:
    """The helm: keys, orders from other terminals, and what a Ctrl-C asks; also the line that tells of the keys."""

    def __init__(self, keys: Keys, interrupts: _Interrupts, box: OrderBox | None, *, asks: bool) -> None:
        self._keys = keys
        self._interrupts = interrupts
        self._box = box
        self._asks = asks
        self._asking = box is None
        self._leaves = False
        self._look_s = 0.0

    def request(self) -> Request | None:
        """Return what the operator wants now; raise ``KeyboardInterrupt`` where that is to leave."""
        if self._leaves or self._interrupts.count > 1:
            raise KeyboardInterrupt
        if self._interrupts.count and not self._asking:
            if not (self._asks and self._keys.present):
                raise KeyboardInterrupt
            self._asking = True
            tell(_QUESTION)
        elif self._interrupts.count and self._box is None:
            raise KeyboardInterrupt
        for key in self._keys.read():
            if self._asking and key == "w" and self._box is not None:
                self._asking, self._interrupts.count = False, 0
            elif self._asking and key in _LEAVING:
                self._leaves = True
                order = _LEAVING[key]
                if order is None:
                    raise KeyboardInterrupt
                return Request(order)
            elif self._asking:
                continue
            elif key in _KEYS:
                tell(f"all vehicles are told: {_KEYS[key]}")
                return Request(_KEYS[key])
            elif key.isprintable():
                tell(_HELP if key not in "rl" else f"{key.upper()} with shift: {_HELP}")
        now_s = time.monotonic()
        if self._box is not None and now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            return self._box.take()
        return None

    def answer(self, outcomes: Sequence[Ordered]) -> None:
        """Pass on what came of an order."""
        if self._box is not None:
            try:
                self._box.answer(outcomes)
            except MissionError as error:  # a full disk: they fly on
                tell(f"{error}: the other terminal does not hear what came of its order")

    def __rich__(self) -> Text:
        if self._asking:
            return Text(_QUESTION, style="bold")
        orders = "orders: missionplanner command pause|resume|rtl|land FOLDER  Ctrl-C leaves them flying"
        return Text(_HELP if self._keys.present else orders, style="dim")


class _Readiness:
    """Shows, vehicle by vehicle, what each still lacks to be armed; lines where there is no terminal."""

    def __init__(self, names: Sequence[str]) -> None:
        self._missing = dict.fromkeys(names, "asked")
        self._remark = "waiting until all can be armed"
        self._live = Live(get_renderable=self._table, console=stderr, refresh_per_second=4, transient=True)

    def lacks(self, name: str, missing: str) -> None:
        """Take note of what a vehicle lacks, "ready" in the end."""
        waited = self._missing[name] not in ("asked", "ready")
        self._missing[name] = missing
        if not stderr.is_terminal and (missing != "ready" or waited):
            tell(f"{name}: {missing}")

    def remark(self, text: str) -> None:
        """Show what else there is to know."""
        self._remark = text
        if not stderr.is_terminal:
            tell(text)

    def _table(self) -> Table:
        table = Table(box=None, show_header=False, title=self._remark, title_justify="left", title_style="")
        for name, missing in self._missing.items():
            ready = missing == "ready"
            table.add_row(Text(name), Text(missing, style="green" if ready else "dim" if missing == "asked" else "red"))
        return table

    def __enter__(self) -> _Readiness:
        if stderr.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if stderr.is_terminal:
            self._live.stop()
