"""What all commands share at the terminal: results on stdout, progress on stderr."""

from __future__ import annotations

import json
import sys
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

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


def print_json(value: Any) -> None:
    """Print a document for machines."""
    print(json.dumps(value, indent=2, allow_nan=False))
