"""How functions are compiled, and where the compiled ones are kept.

Compiled code is kept in a folder that is named after the sources it is made of, so that a change of a function never
leaves old code of its callers, and leaves the compiled code of everything else.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import caching
from numba.extending import register_jitable

from hybrid_sysid_ros.core.code_cache import CheckedCacheFile, missing_names
from hybrid_sysid_ros.support.versions import NUMBA_CACHE, NUMBA_COMPILER

OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True, "no_cfunc_wrapper": True}
"""For ``numba.njit`` of a function that Python calls; no C code calls one. Without the entries that nobody uses,
compiling takes a quarter less memory and a tenth less time in a node.
"""


def _part_options() -> dict[str, Any]:
    if NUMBA_COMPILER.usable():
        try:
            from hybrid_sysid_ros.core.parts import PartCompiler

            return {"pipeline_class": PartCompiler}
        except (ImportError, AttributeError) as error:
            NUMBA_COMPILER.usable([f"name that its parts need ({error})"])
    return {}


_PART_OPTIONS = _part_options()

inner = register_jitable(**OPTIONS, no_cpython_wrapper=True, **_PART_OPTIONS)
"""Decorator of a function that only compiled code calls. Called from Python it runs as it is written there."""

UNUSED_DAYS = 30.0
"""After which compiled code that no process asked for is cleared away."""

_DAY = 86400.0
_PACKAGE = __name__.partition(".")[0]
_IMPORT = re.compile(r"^(?:from +([\w.]+) +import +(\([^)]*\)|[^\n]*)|import +([\w.]+))", re.MULTILINE)
"""Those of a module, not those in its functions: compiled code is made of what its module names."""


def kernel(function: Callable[..., Any], signature: str | None = None) -> Any:
    """Decorator of a loop that Python calls: compiled at its first call, or loaded from the cache on disk. With a
    signature at once, and for its arguments alone.
    """
    with kept_in(folder(function.__module__, digest(function.__module__))):
        made = numba.njit(cache=is_kept(), fastmath={"contract"}, **OPTIONS)(function)
        if signature is not None:
            made.compile(signature)
            made.disable_compile()
    return made


def is_kept() -> bool:
    """Whether compiled code is kept on disk: where its files can have checksums."""
    return NUMBA_CACHE.usable(missing_names())


@contextmanager
def kept_in(place: Path) -> Iterator[None]:
    """Functions that are decorated meanwhile have their compiled code kept there, with checksums."""
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(place)
    plain, caching.IndexDataCacheFile = caching.IndexDataCacheFile, CheckedCacheFile
    try:
        yield
    finally:
        numba.config.CACHE_DIR, caching.IndexDataCacheFile = before, plain


def digest(*modules: str) -> str:
    """Of the sources of modules and of all that they import, of this package and of their own, and of the compiler.

    The modules are loaded, or being loaded behind their first imports.
    """
    found = hashlib.sha256(f"{numba.__version__} {len(_PART_OPTIONS)}".encode())
    packages = {_PACKAGE, *(name.partition(".")[0] for name in modules)}
    seen: set[str] = set()
    ahead = list(modules)
    while ahead:
        name = ahead.pop()
        if name not in seen and name.partition(".")[0] in packages:
            seen.add(name)
            ahead += _source(name)[1]
    for name in sorted(seen):
        found.update(_source(name)[0])
    return found.hexdigest()[:16]


@cache
def _source(name: str) -> tuple[bytes, tuple[str, ...]]:
    """The source of a loaded module, and the loaded modules that it names in imports."""
    path = getattr(sys.modules.get(name), "__file__", None)
    if path is None or not path.endswith(".py"):
        return b"", ()
    content = Path(path).read_bytes()
    named: set[str] = set()
    for parent, members, whole in _IMPORT.findall(content.decode()):
        inside = {f"{parent}.{member}" for member in re.findall(r"\w+", members)} & sys.modules.keys()
        named |= inside or {parent or whole}
    return content, tuple(sorted(named & sys.modules.keys()))


def folder(name: str, version: str) -> Path:
    """A folder for compiled code of that name and version, which is there and may be written to."""
    found = _root() / f"{name}-{version}"
    try:
        age = time.time() - found.stat().st_mtime
    except FileNotFoundError:
        _clear()
        found.mkdir(mode=0o700, exist_ok=True)
    else:
        if age > _DAY:
            os.utime(found)  # in use
    return found


@cache
def _root() -> Path:
    """Where all compiled code is kept: HYBRID_SYSID_CACHE names the place, which is the user's cache otherwise.

    Where nothing can be written there it is kept with temporary files, and at worst for this process only.
    """
    named = os.environ.get("HYBRID_SYSID_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    for place in (Path(named) / _PACKAGE, Path(tempfile.gettempdir()) / f"{_PACKAGE}_{os.getuid()}"):
        if _usable(place):
            return place
    own = tempfile.mkdtemp(prefix=_PACKAGE)
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    return Path(own)


def _usable(place: Path) -> bool:
    """Whether it is a folder of this user's own where files can be made: compiled code of others is never run."""
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = place.lstat()
        tempfile.TemporaryFile(dir=place).close()
        if found.st_uid == os.getuid() and found.st_mode & 0o022 and not place.is_symlink():
            place.chmod(0o700)
    except OSError:
        return False
    return found.st_uid == os.getuid()


@cache
def _clear() -> None:
    """Remove what no process has asked for in a long time; once in a process, and when something new is kept."""
    oldest = time.time() - UNUSED_DAYS * _DAY
    for other in _root().iterdir():
        try:
            if other.is_dir() and other.stat().st_mtime < oldest:
                shutil.rmtree(other, ignore_errors=True)
        except FileNotFoundError:
            continue  # another process was faster
