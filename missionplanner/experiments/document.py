"""Results of experiments collected in one document: sections between marks are replaced, pictures copied beside it."""

from __future__ import annotations

import os
import platform
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path

from missionplanner.errors import MissionError
from missionplanner.files import write_atomic

FIGURES = "figures"
"""The folder of pictures, beside the document."""

_MARK = re.compile(r"<!-- (?P<name>[a-z0-9-]+): begin -->\n.*?<!-- (?P=name): end -->\n?", re.DOTALL)
_PICTURE = re.compile(r"!\[(?P<text>[^\]]*)\]\((?P<file>[^)/]+\.png)\)")
_HEADING = re.compile(r"^(#+ )", re.MULTILINE)
_LIBRARIES = ("numpy", "numba", "scipy")


def provenance() -> dict[str, str]:
    """Return where and when a run is made, to be kept with its result: others may be of other days or machines."""
    return {"machine": processor(), "date": time.strftime("%Y-%m-%d")}


def gathered(runs: Iterable[Mapping[str, str]]) -> tuple[str, bool]:
    """Return on what and when runs were made by their :func:`provenance`, and whether their times compare."""
    kept = list(runs)
    machines, dates = sorted({run["machine"] for run in kept}), sorted({run["date"] for run in kept})
    libraries = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    when = f"of {dates[0]}" if len(dates) == 1 else f"from {dates[0]} to {dates[-1]}"
    on = f"on {machines[0]}" if len(machines) == 1 else f"of {len(machines)} machines ({'; '.join(machines)})"
    return f"Runs {when} {on}, a thread each; {libraries}.", len(machines) == 1


def machine() -> str:
    """Return on what and when something is measured, as one sentence."""
    libraries = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    return (
        f"Measured on {time.strftime('%d %B %Y').lstrip('0')}: {processor()}, {os.cpu_count()} cores, "
        f"{platform.system()}, Python {platform.python_version()}, {libraries}."
    )


def processor() -> str:
    """Return the name of this machine's processor."""
    names = Path("/proc/cpuinfo")
    found = re.search(r"^model name\s*:\s*(.+)$", names.read_text(), re.MULTILINE) if names.exists() else None
    return found[1].strip() if found else platform.processor() or platform.machine()


def collect(document: Path, results: Path) -> list[str]:
    """Replace every marked section of a Markdown document whose experiment has results; return their names.

    A section NAME stands between ``<!-- NAME: begin -->`` and ``<!-- NAME: end -->``. It becomes the ``results.md`` of
    the folder ``experiment_NAME`` (dashes may be underscores there) without its title, headings one level deeper.
    Pictures that it shows are copied to the folder ``figures`` beside the document.

    Raises
    ------
    MissionError
        The document cannot be read, has no such marks, or no results are there.
    """
    text = _text(document)
    names = [match["name"] for match in _MARK.finditer(text)]
    if not names:
        raise MissionError(
            f"{document}: expected sections between <!-- NAME: begin --> and <!-- NAME: end -->, got none"
        )
    found = {name: folder for name in names if (folder := _folder(results, name)) is not None}
    if not found:
        raise MissionError(
            f"{results}: expected a folder experiment_NAME with results.md for one of {', '.join(names)}, got none: "
            "run `missionplanner experiment NAME` first"
        )

    def replaced(match: re.Match[str]) -> str:
        name = match["name"]
        if name not in found:
            return match[0]
        return f"<!-- {name}: begin -->\n{_section(found[name], name, document.parent / FIGURES)}<!-- {name}: end -->\n"

    write_atomic(document, _MARK.sub(replaced, text))
    return list(found)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise MissionError(f"{path}: expected a Markdown file, got: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise MissionError(f"{path}: expected Markdown in UTF-8, got byte {error.start} of another encoding") from error


def _folder(results: Path, name: str) -> Path | None:
    for folder in (results / f"experiment_{name}", results / f"experiment_{name.replace('-', '_')}"):
        if (folder / "results.md").is_file():
            return folder
    return None


def _section(folder: Path, name: str, figures: Path) -> str:
    """Return an experiment's results as a section; copy its pictures."""
    lines = _text(folder / "results.md").strip().split("\n")
    if lines[0].startswith("# "):
        lines = lines[1:]
    text = _HEADING.sub(r"#\1", "\n".join(lines).strip("\n"))

    def copied(match: re.Match[str]) -> str:
        picture = folder / match["file"]
        if not picture.is_file():
            raise MissionError(f"{folder / 'results.md'}: expected the picture {match['file']} beside it: run it again")
        new = match["file"] if match["file"].startswith(name) else f"{name}-{match['file']}"
        write_atomic(figures / new, picture.read_bytes())
        return f"![{match['text']}]({FIGURES}/{new})"

    return _PICTURE.sub(copied, text) + "\n"


def joined(*parts: str | Sequence[str]) -> str:
    """Return paragraphs, tables (as lines) and headings as Markdown, an empty line between them."""
    return "\n\n".join(part if isinstance(part, str) else "\n".join(part) for part in parts if part) + "\n"
