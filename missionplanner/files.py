"""Files are written whole or not at all."""

from __future__ import annotations

import csv
import io
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from missionplanner.errors import MissionError

_fcntl: Any = import_module("fcntl") if os.name == "posix" else None


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path`` that takes its place when the block succeeds, and vanishes when not.

    Raises
    ------
    MissionError
        The folder cannot be made or written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
        os.close(handle)
    except OSError as error:
        raise MissionError(f"{path}: expected a folder that can be written to, got: {error.strerror}") from error
    draft = Path(name)
    try:
        yield draft
        # mkstemp makes private files; a plan is as readable as any other file of its owner
        umask = os.umask(0)
        os.umask(umask)
        draft.chmod(0o666 & ~umask)
        draft.replace(path)
    except OSError as error:
        raise MissionError(f"{path}: could not be written: {error.strerror or error}") from error
    finally:
        draft.unlink(missing_ok=True)


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write text (UTF-8) or bytes to ``path``, whole or not at all.

    Raises
    ------
    MissionError
        The file cannot be written.
    """
    with replacing(path) as draft:
        draft.write_bytes(content.encode() if isinstance(content, str) else content)


def write_csv(path: Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table as CSV, whole or not at all.

    Raises
    ------
    MissionError
        The file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_atomic(path, text.getvalue())


def ensure_writable(folder: Path) -> None:
    """Make ``folder`` if need be and check that files can be written to it: before long work, not after.

    Raises
    ------
    MissionError
        They cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise MissionError(f"{folder}: expected a folder that can be written to, got: {error.strerror}") from error


@contextmanager
def alone(folder: Path, expected: str) -> Iterator[None]:
    """Keep other programs that ask for the same out of a folder meanwhile; ``expected`` says what of, and what to do.

    Raises
    ------
    MissionError
        Another one is in it; or it cannot be read.
    """
    if _fcntl is None:
        yield
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise MissionError(f"{folder}: expected a folder that can be read, got: {error.strerror}") from error
    try:
        _fcntl.flock(handle, _fcntl.LOCK_EX | _fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise MissionError(f"{folder}: {expected}") from None
    except OSError:  # a file system without locks, as some networks'
        pass
    try:
        yield
    finally:
        os.close(handle)
