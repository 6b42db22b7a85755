"""How functions are compiled, and where the compiled ones are kept.

What compiled code is made of decides its place on disk, so that no change of a function leaves old code of its callers.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.extending import register_jitable

OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
"""For ``numba.njit`` of a function that Python calls; no C code calls one. Without the entries that nobody uses,
compiling takes a quarter less memory and a tenth less time in a node.
"""

inner = register_jitable(**OPTIONS)
"""Decorator of a function that only compiled code calls. Called from Python it runs as it is written there."""

UNUSED_DAYS = 30.0
"""After which the compiled code of other versions of the package is cleared away."""


def kernel(function: Callable[..., Any]) -> Any:
    """Decorator of a loop that Python calls: compiled at its first call, or loaded from the cache on disk."""
    return numba.njit(cache=True, fastmath={"contract"}, **OPTIONS)(function)


def cache_folder() -> Path:
    """Where compiled code of this version of the package is kept; HYBRID_SYSID_CACHE names another place."""
    root = os.environ.get("HYBRID_SYSID_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "hybrid_sysid_ros" / _version()


def _version() -> str:
    """Digest of the package's source."""
    digest = hashlib.sha256(numba.__version__.encode())
    package = Path(__file__).parents[1]
    for path in sorted(package.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _clear(folder: Path) -> None:
    """Remove what other versions left long ago."""
    import shutil

    oldest = time.time() - 86400.0 * UNUSED_DAYS
    for other in folder.parent.iterdir():
        if other != folder and other.is_dir() and other.stat().st_mtime < oldest:
            shutil.rmtree(other, ignore_errors=True)


CACHE = cache_folder()
"""Of this process."""

if "NUMBA_CACHE_DIR" not in os.environ:
    try:
        if not CACHE.is_dir():
            CACHE.mkdir(parents=True)
            _clear(CACHE)
        numba.config.CACHE_DIR = str(CACHE / "kernels")
    except OSError:
        pass  # numba then finds a place by itself, or keeps nothing
