"""Readers of log files, one for each kind of file, found by the file's name."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from hybrid_sysid_ros.extensions.importing.log_file import JoinedFile, LogFile, readable
from hybrid_sysid_ros.extensions.importing.time_columns import own_times
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extras import extra

READERS = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".asc"), "text:TextFile"),
    ".mat": "matlab:matlab_file",
    **dict.fromkeys((".h5", ".hdf5"), "matlab:HdfFile"),
    **dict.fromkeys((".npz", ".npy"), "arrays:NumpyFile"),
    ".parquet": "arrays:ParquetFile",
    **dict.fromkeys((".mf4", ".mdf"), "measurement:Mf4File"),
    ".tdms": "measurement:TdmsFile",
    ".ulg": "measurement:UlogFile",
    **dict.fromkeys((".bag", ".mcap", ".db3"), "ros_bag:bag_file"),
}
"""Module and class by the end of a file's name."""
EXTRA = "import"
"""Extra of the package that has the readers' libraries."""


def open_joined(path: Path, others: Sequence[Path]) -> LogFile:
    """A file, or it and the others that are of the same record, each with times of its own if it has some.

    Raises UserError as :func:`open_log` does.
    """
    files = [open_log(item) for item in (path, *others)]
    return JoinedFile(files, [own_times(file) for file in files]) if others else files[0]


def open_log(path: Path) -> LogFile:
    """A file by its name's end. Raises UserError where it is missing, empty, damaged or of no known kind."""
    if not path.exists():
        raise UserError(f"{path}: no such file")
    if path.is_file() and path.stat().st_size == 0:
        raise UserError(f"{path}: is an empty file: nothing was recorded, or the copy failed")
    target = READERS[".mcap"] if path.is_dir() else READERS.get(path.suffix.lower(), "")
    if not target:
        raise UserError(f"{path}: is of no known kind: {', '.join(READERS)} are read")
    module, _, name = target.partition(":")
    with extra(EXTRA), readable(path):
        found: LogFile = getattr(import_module(f"{__name__}.{module}"), name)(path)
    return found
