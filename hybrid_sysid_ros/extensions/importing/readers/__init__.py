"""Readers of log files, one for each kind of file, found by the file's name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from hybrid_sysid_ros.extensions.importing.log_file import LogFile
from hybrid_sysid_ros.support.errors import Interrupted, UserError
from hybrid_sysid_ros.support.extras import extra

READERS = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".asc"), "text:TextFile"),
}
"""Module and class by the end of a file's name."""
EXTRA = "import"
"""Extra of the package that has the readers' libraries."""


def open_log(path: Path) -> LogFile:
    """A file by its name's end. Raises UserError where it is missing, empty, damaged or of no known kind."""
    if not path.exists():
        raise UserError(f"{path}: no such file")
    if path.is_file() and path.stat().st_size == 0:
        raise UserError(f"{path}: is an empty file: nothing was recorded, or the copy failed")
    target = READERS.get(path.suffix.lower(), "")
    if not target or path.is_dir():
        raise UserError(f"{path}: is of no known kind: {', '.join(READERS)} are read")
    module, _, name = target.partition(":")
    with extra(EXTRA), readable(path):
        found: LogFile = getattr(import_module(f"{__name__}.{module}"), name)(path)
    return found


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Around a library that reads a file: turn what it raises into a UserError of one line."""
    try:
        yield
    except (UserError, Interrupted, ModuleNotFoundError):
        raise
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror or error})") from error
    except Exception as error:  # the libraries may raise anything for a damaged file
        words = " ".join(str(error).split())[:150] or type(error).__name__
        raise UserError(f"{path}: is damaged, or of another kind than its name says ({words})") from error
