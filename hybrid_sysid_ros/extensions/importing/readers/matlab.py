"""MATLAB files: version 5 by scipy, version 7.3 and other HDF5 files by h5py, structures flattened to a.b.c."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from hybrid_sysid_ros.extensions.importing.log_file import LARGEST, LogColumn, LogFile
from hybrid_sysid_ros.extensions.importing.readers.arrays import array_name, chosen_columns, columns_of
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

DEEPEST = 6
"""Levels of structures."""
COMPRESSED = 15
"""Type of a compressed element of a version 5 file."""
_ENTRY = re.compile(r"\[\d+\]$")
HDF5 = b"\x89HDF\r\n\x1a\n"


def matlab_file(path: Path) -> LogFile:
    """A .mat file of either version."""
    with path.open("rb") as file:
        head = file.read(520)
    return HdfFile(path) if head.startswith(HDF5) or head[512:520] == HDF5 else MatlabFile(path)


class MatlabFile(LogFile):
    """A .mat file of version 5 or older."""

    def __init__(self, path: Path) -> None:
        _check_unpacked(path)
        self._arrays: dict[str, Any] = {}
        units = dict[str, str]()
        for name, value in loadmat(path, simplify_cells=True).items():
            if not name.startswith("__"):
                _flatten(name, value, self._arrays, units, 0)
        shapes = {name: value.shape for name, value in self._arrays.items()}
        super().__init__(path, _with_times(list(columns_of(shapes, units))))

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        return chosen_columns(self._arrays, names)


class HdfFile(LogFile):
    """A .mat file of version 7.3, or any HDF5 file: each dataset of numbers is a column, or several."""

    def __init__(self, path: Path) -> None:
        import h5py

        self._places = dict[str, str]()
        shapes, units = dict[str, tuple[int, ...]](), dict[str, str]()
        with h5py.File(path, "r") as file:

            def visit(name: str, item: Any) -> None:
                if (
                    isinstance(item, h5py.Dataset)
                    and item.dtype.kind in "fiub"
                    and 0 < item.ndim < 3
                    and name[0] != "#"
                ):
                    key = name.replace("/", ".")
                    shapes[key], self._places[key] = item.shape, name
                    unit = item.attrs.get("unit", item.attrs.get("units", ""))
                    units[key] = unit.decode() if isinstance(unit, bytes) else str(unit)

            file.visititems(visit)
        super().__init__(path, _with_times(list(columns_of(shapes, units))))

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        import h5py

        with h5py.File(self.path, "r") as file:
            wanted = {array_name(name, self._places) for name in names}
            arrays = {name: file[self._places[name]][()] for name in wanted}
        return chosen_columns(arrays, names)


def _flatten(name: str, value: Any, arrays: dict[str, Any], units: dict[str, str], level: int) -> None:
    """Arrays of numbers in structures; one with Name and Data, as dSPACE writes them, is called by that name."""
    if level > DEEPEST:
        return
    if isinstance(value, dict):
        data = value.get("Data", value.get("data"))
        title = value.get("Name", value.get("name"))
        if isinstance(title, str) and title and isinstance(data, np.ndarray):
            arrays[title] = data
            units[title] = str(value.get("Unit", value.get("unit")) or "")
            return
        for key, item in value.items():
            _flatten(f"{name}.{key}", item, arrays, units, level + 1)
    elif isinstance(value, list):
        for k, item in enumerate(value):
            _flatten(f"{name}{k + 1}", item, arrays, units, level + 1)
    elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
        for k, item in enumerate(value.ravel()):
            _flatten(f"{name}{k + 1}", item, arrays, units, level + 1)
    elif isinstance(value, (np.ndarray, int, float)):
        array = np.asarray(value)
        if array.dtype.kind in "fiub" and array.ndim < 3:
            arrays[name] = array


def _with_times(columns: list[LogColumn]) -> Iterator[LogColumn]:
    """Columns of a structure with a time, as Simulink writes them, get it: out.y.Data has out.y.Time."""
    known = {column.name.lower(): column.name for column in columns}
    for column in columns:
        parent = _ENTRY.sub("", column.name).rpartition(".")[0]
        near = [f"{parent}.time".lower(), f"{parent.rpartition('.')[0]}.time".lower()] if parent else []
        own = next((known[name] for name in near if name in known), "")
        yield LogColumn(
            name=column.name, samples=column.samples, unit=column.unit, time="" if own == column.name else own
        )


def _check_unpacked(path: Path) -> None:
    """Raise UserError for a file whose compressed elements unpack to more than LARGEST numbers, before they do."""
    total = 0
    with path.open("rb") as file:
        order = "<" if file.read(128)[126:128] == b"IM" else ">"
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if kind != COMPRESSED:
                total += size
                file.seek(size, 1)
                continue
            unpack, left = zlib.decompressobj(), size
            while left > 0 and (block := file.read(min(left, 1 << 16))):
                left -= len(block)
                while block:
                    total += len(unpack.decompress(block, 1 << 20))
                    block = unpack.unconsumed_tail
                    if total > 8 * LARGEST:
                        raise UserError(
                            f"{path}: unpacks to more than {8 * LARGEST >> 30} GiB; cut it, for no more is read"
                        )
