"""What all commands share at the terminal: results on stdout, progress on stderr."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

try:
    import termios
    import tty
except ImportError:  # Windows: no single keys
    termios = None  # type: ignore[assignment]

stdout = Console(width=None if sys.stdout.isatty() else 120)
stderr = Console(stderr=True)


class Told(SystemExit):
    """An end whose reason has been told, and printed as JSON where that was asked for."""


def progress_bars() -> Progress:
    """Return bars for long work; nothing where stderr is not a terminal."""
    columns = (
        TextColumn("{task.description:<22}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=stderr, disable=not stderr.is_terminal)


@contextlib.contextmanager
def planning_bars() -> Iterator[Callable[[str, float], None]]:
    """Show a bar for everything that is planned: to be told its name and the share that is done."""
    with progress_bars() as progress:
        bars: dict[str, TaskID] = {}

        def watch(name: str, done: float) -> None:
            if name not in bars:
                bars[name] = progress.add_task(f"planning {name}", total=1.0)
            progress.update(bars[name], completed=done)

        yield watch


def print_json(value: Any) -> None:
    """Print a document for machines."""
    print(json.dumps(value, indent=2, allow_nan=False))


class Keys:
    """Single keys of the terminal, read without waiting and without echo; none where stdin is no terminal of ours.

    Ctrl-C still interrupts; Ctrl-Z does not stop the program, which may be flying vehicles.
    """

    def __init__(self) -> None:
        self._fd = -1
        self._before: list[Any] | None = None

    @property
    def present(self) -> bool:
        """Whether keys can be read now: a program sent to the background has none, and would be stopped for asking."""
        if self._before is None:
            return False
        try:
            return os.tcgetpgrp(self._fd) == os.getpgrp()
        except OSError:  # the terminal is gone
            return False

    def read(self) -> str:
        """Return what was typed since the last call."""
        if not self.present:
            return ""
        try:
            return os.read(self._fd, 64).decode("utf-8", "ignore")
        except OSError:
            return ""

    def __enter__(self) -> Keys:
        if termios is None or not sys.stdin.isatty():
            return self
        self._fd = sys.stdin.fileno()
        self._before = termios.tcgetattr(self._fd)
        if not self.present:
            self._before = None
            return self
        tty.setcbreak(self._fd)
        mode = termios.tcgetattr(self._fd)
        mode[6][termios.VMIN] = mode[6][termios.VTIME] = 0
        mode[6][termios.VSUSP] = b"\0"
        termios.tcsetattr(self._fd, termios.TCSANOW, mode)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._before is not None:
            waits = signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # in the background, it would stop us
            with contextlib.suppress(termios.error):  # the terminal is gone
                termios.tcsetattr(self._fd, termios.TCSANOW, self._before)
            signal.signal(signal.SIGTTOU, waits)
