"""How pages are made: pictures and templates in one HTML file that needs no other; pictures beside it as PNG too."""

from __future__ import annotations

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from missionplanner.files import write_atomic
from missionplanner.report import style

PICTURES_NAME = "pictures"


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawn picture: file name, section it opens (or continues, if empty), caption, words for who cannot see it."""

    name: str
    title: str
    caption: str
    alt: str
    png: bytes

    @property
    def uri(self) -> str:
        """The picture as it stands in a page."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")


@dataclass(frozen=True, slots=True)
class Tile:
    """A key figure."""

    label: str
    value: str
    note: str
    bad: bool = False


def picture(name: str, title: str, figure: Figure, caption: str, alt: str) -> Picture:
    """Return a figure as a picture of a page."""
    return Picture(name, title, caption, alt, style.to_png(figure))


def write_page(path: Path, template: str, pictures: Iterable[Picture], **said: object) -> Path:
    """Fill a template, write the page and its pictures, and return its path.

    Raises
    ------
    MissionError
        The folder cannot be written to.
    """
    drawn = []
    for one in pictures:
        write_atomic(path.parent / PICTURES_NAME / f"{one.name}.png", one.png)
        drawn.append(one)
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, loader=FunctionLoader(_part)
    )
    css = Markup(_part("report.css"))
    write_atomic(path, environment.get_template(template).render(css=css, pictures=drawn, **said))
    return path


def _part(name: str) -> str:
    """Return a template or style sheet of this package."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
