"""How functions are compiled, and where compiled code is cached.

The cache folder is named after the sources of the compiled code. So a change of a function never leaves old code of its
callers behind, and keeps the compiled code of everything else.
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
"""Options of ``numba.njit`` for a function that Python calls. No C code calls one: without the entry points for C,
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
"""Decorator of a function that only compiled code calls. A call from Python runs it uncompiled."""

UNUSED_DAYS = 30.0
"""Cached code that no process has used for so many days is removed."""

_DAY = 86400.0
_PACKAGE = __name__.partition(".")[0]
_IMPORT = re.compile(r"^(?:from +([\w.]+) +import +(\([^)]*\)|[^\n]*)|import +([\w.]+))", re.MULTILINE)
"""Imports at the top of a module, not those inside functions: compiled code depends only on the former."""


def kernel(function: Callable[..., Any], signature: str | None = None) -> Any:
    """Decorate a loop that Python calls: it is compiled at its first call, or loaded from the cache on disk. With a
    signature it is compiled at once, and only for the arguments of that signature.
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
    """Keep the compiled code of functions that are decorated within this context in a folder, with checksums."""
    before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, str(place)
    plain, caching.IndexDataCacheFile = caching.IndexDataCacheFile, CheckedCacheFile
    try:
        yield
    finally:
        numba.config.CACHE_DIR, caching.IndexDataCacheFile = before, plain


def digest(*modules: str) -> str:
    """Digest of the sources of modules, of what they import from this package and their own, and of the compiler.

    The modules must be loaded, or past their first imports.
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
    """The source of a loaded module, and the names of the loaded modules that it imports."""
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
    """The cache folder of a name and version; it exists and can be written to."""
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
    """The folder of all compiled code: HYBRID_SYSID_CACHE, or else the user's cache folder.

    Where neither can be written to, it is a folder for temporary files, at worst of this process only.
    """
    named = os.environ.get("HYBRID_SYSID_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    for place in (Path(named) / _PACKAGE, Path(tempfile.gettempdir()) / f"{_PACKAGE}_{os.getuid()}"):
        if _usable(place):
            return place
    own = tempfile.mkdtemp(prefix=_PACKAGE)
    atexit.register(shutil.rmtree, own, ignore_errors=True)
    return Path(own)


def _usable(place: Path) -> bool:
    """Whether a folder belongs to this user and can be written to: compiled code of others is never run."""
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
    """Remove cached code that no process has used for long; once in a process, when new code is cached."""
    oldest = time.time() - UNUSED_DAYS * _DAY
    for other in _root().iterdir():
        try:
            if other.is_dir() and other.stat().st_mtime < oldest:
                shutil.rmtree(other, ignore_errors=True)
        except FileNotFoundError:
            continue  # another process was faster
