"""Compiled code is forgotten when what it calls changes: numba alone would keep it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from missionplanner import compiled

_INNER = "from package.compiled import njit\n\n\n@njit(cache=True)\ndef inner(x):\n    return x + {}\n"
_OUTER = """from package.compiled import njit
from package.inner import inner


@njit(cache=True)
def outer(x):
    return 10 * inner(x)


if __name__ == "__main__":
    print(outer(1), sum(outer.stats.cache_hits.values()))
"""


def _run(folder: Path) -> list[int]:
    done = subprocess.run(
        [sys.executable, "-m", "package.outer"],
        cwd=folder,
        env=dict(os.environ, PYTHONPATH=str(folder)),
        capture_output=True,
        text=True,
        check=True,
    )
    return [int(part) for part in done.stdout.split()]


def test_a_cached_function_follows_a_change_of_what_it_calls(tmp_path: Path) -> None:
    package = tmp_path / "package"
    package.mkdir()
    (package / "__init__.py").touch()
    shutil.copy(str(compiled.__file__), package / "compiled.py")
    (package / "inner.py").write_text(_INNER.format(1), encoding="utf-8")
    (package / "outer.py").write_text(_OUTER, encoding="utf-8")
    assert _run(tmp_path) == [20, 0]
    assert _run(tmp_path) == [20, 1]
    (package / "inner.py").write_text(_INNER.format(2), encoding="utf-8")
    assert _run(tmp_path) == [30, 0]
    for constant in range(3, 9):
        (package / "inner.py").write_text(_INNER.format(constant), encoding="utf-8")
        _run(tmp_path)
    assert 2 <= len(list((package / "__pycache__").glob("compiled-*"))) <= 5
