"""Orders from another terminal to the program that flies a fleet: files in a folder, each taken once and answered.

Only that program holds the links, knows whom it has told what, and keeps the fleet's pace; a second ground station on
the same port is often impossible, and always knows less. An order is a file ``*.order`` that is taken by renaming it,
so that one that was withdrawn in time was surely not given; its answer is a file beside it.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import get_args

from adapters.fleet_flight import Request
from adapters.fleet_vehicle import Order
from missionplanner.errors import LinkError, MissionError
from missionplanner.files import write_atomic
from missionplanner.plan import Ordered

_ORDER, _TAKEN, _ANSWER = ".order", ".taken", ".answer"
_TAKEN_S = 5.0  # it is looked for several times a second
_ANSWERED_S = 60.0
_LOOK_S = 0.1


class OrderBox:
    """The end of the program that flies; the folder exists while it does."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._taken: Path | None = None
        shutil.rmtree(folder, ignore_errors=True)  # of a flight that was killed: nobody shall obey its orders
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise MissionError(f"{folder}: expected a folder that can be written to, got: {error.strerror}") from error

    def take(self) -> Request | None:
        """Return the next order; one that cannot be read is thrown away, its giver told by the answer that lacks."""
        for path in sorted(self._folder.glob(f"*{_ORDER}")):
            taken = path.with_suffix(_TAKEN)
            try:
                path.replace(taken)
                written = json.loads(taken.read_text(encoding="utf-8"))
                named, unproven = frozenset(map(str, written["vehicles"])), written["unproven"] is True
                request = Request(written["order"], named, unproven)
            except (OSError, ValueError, KeyError, TypeError):  # withdrawn just now, or none of ours
                continue
            if request.order in get_args(Order):
                self._taken = taken
                return request
        return None

    def answer(self, outcomes: Sequence[Ordered]) -> None:
        """Tell the giver of the order taken last what came of it."""
        if self._taken is not None:
            write_atomic(self._taken.with_suffix(_ANSWER), json.dumps([asdict(outcome) for outcome in outcomes]))
            self._taken = None

    def close(self) -> None:
        """Take no more orders."""
        shutil.rmtree(self._folder, ignore_errors=True)


def give_order(folder: Path, request: Request, wait: Callable[[float], None]) -> tuple[Ordered, ...]:
    """Give an order to the program whose box that folder is, and return what came of it.

    Raises
    ------
    LinkError
        Nobody takes it, and it is withdrawn; or it was taken, and no answer comes; or nobody is left to say which.
    """
    nobody = f"{folder.parent}: expected a running fly that watches this fleet, found none: nothing was sent; "
    remedy = "give the order to the vehicles themselves with --connect URL"
    if not folder.is_dir():
        raise LinkError(nobody + remedy)
    try:
        with tempfile.NamedTemporaryFile(dir=folder, delete=False) as draft:  # its name is nobody else's
            draft.write(json.dumps(asdict(request) | {"vehicles": sorted(request.vehicles)}).encode())
        path = Path(draft.name).replace(Path(draft.name).with_suffix(_ORDER))
    except OSError as error:
        raise LinkError(f"{folder}: could not be written to: {error.strerror}: nothing was sent; {remedy}") from error
    for _ in range(round(_TAKEN_S / _LOOK_S)):
        if not path.exists():
            break
        wait(_LOOK_S)
    else:
        try:
            path.unlink()
        except FileNotFoundError:
            pass  # taken at the last moment
        else:
            raise LinkError(nobody + remedy)
    answer, taken = path.with_suffix(_ANSWER), path.with_suffix(_TAKEN)
    if not (answer.exists() or taken.exists()):
        raise LinkError(
            f"{folder.parent}: the fly that watched this fleet has just ended, and whether it still took the order is "
            f"not known: {remedy}"
        )
    for _ in range(round(_ANSWERED_S / _LOOK_S)):
        if answer.exists():
            found = json.loads(answer.read_text(encoding="utf-8"))
            answer.unlink(missing_ok=True)
            return tuple(Ordered(**outcome) for outcome in found)
        if not folder.is_dir():
            break
        wait(_LOOK_S)
    raise LinkError(
        f"{folder.parent}: the order was taken, and what came of it was not told: look at the fly that runs"
    )
