"""numba's ``njit``, with a cache that forgets when any compiled code changes.

numba looks at a function's own file only, though what it calls is compiled into it: after an update in place, a cached
function could go on using what its callees were before. So compiled code is kept in a folder named after all of its
sources. Every module that compiles anything takes ``njit`` from here, or its decorators from :mod:`.kernels`.
"""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path
from typing import Any

import numba
from numba import njit

__all__ = ["njit"]

_config: Any = numba.config  # its settings are made as it is read
_MARKS = (b"njit", b"@kernel", b"@leaf")
_PREFIX = "compiled-"
_KEPT = 3  # folders of other versions: who goes to and fro between two does not compile anew each time


def _folder() -> Path:
    """Return where the code compiled of today's sources is kept."""
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        content = path.read_bytes()
        if any(mark in content for mark in _MARKS):
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + content)
    base = Path(_config.CACHE_DIR) if _config.CACHE_DIR else package / "__pycache__"
    return base / f"{_PREFIX}{digest.hexdigest()[:16]}"


def _keep(folder: Path) -> None:
    """Make the folder, if it can be; then those of all but a few other versions go."""
    if folder.exists():
        return
    try:
        folder.mkdir(parents=True)
        others = sorted(folder.parent.glob(f"{_PREFIX}*"), key=lambda other: other.stat().st_mtime)
    except OSError:  # installed by somebody else: numba finds a place of the user's own
        return
    for other in others[: -1 - _KEPT]:
        shutil.rmtree(other, ignore_errors=True)


_cache = _folder()
_keep(_cache)
_config.CACHE_DIR = str(_cache)
