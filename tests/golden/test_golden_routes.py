"""Files for DJI's and Litchi's apps, byte for byte: a change of format is a decision, not an accident.

``python -m tests.golden.test_golden_routes`` writes them anew; look at the difference before committing it.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from adapters.export import export_fleet, export_options
from tests.routes import looking, looking_fleet

FOLDER = Path(__file__).parent / "routes"


def _write(folder: Path) -> None:
    plan = looking_fleet(looking(), looking("bravo", 2, home_m=(0.0, 40.0, 1195.0), end="rtl"))
    for path in export_fleet(plan, folder, export_options("dji,litchi", "m3e")):
        if path.suffix == ".kmz":  # its documents, so that a difference can be read
            with zipfile.ZipFile(path) as archive:
                for name in archive.namelist():
                    (folder / f"{path.stem}-{Path(name).name}").write_bytes(archive.read(name))
            path.unlink()


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("routes")
    _write(folder)
    return folder


@pytest.mark.parametrize("name", sorted(path.name for path in FOLDER.glob("*")))
def test_routes_are_the_golden_ones(written: Path, name: str) -> None:
    assert (written / name).read_text() == (FOLDER / name).read_text()


def test_no_golden_route_is_missing(written: Path) -> None:
    names = {path.name for path in FOLDER.glob("*")}
    assert names == {path.name for path in written.iterdir()}
    assert len(names) == 6


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    _write(FOLDER)
