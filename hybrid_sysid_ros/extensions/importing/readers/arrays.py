"""Arrays of numpy (NPZ, NPY) and tables of Parquet files."""

from __future__ import annotations

import zipfile
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from hybrid_sysid_ros.extensions.importing.log_file import MOST_COLUMNS, LogColumn, LogFile, check_size
from hybrid_sysid_ros.extensions.importing.time_columns import period_words
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

WIDEST = 200
"""Most columns of a two-dimensional array."""


class NumpyFile(LogFile):
    """Arrays of one dimension, and columns of arrays of two, called NAME[0]. Python objects are never read."""

    def __init__(self, path: Path) -> None:
        self._shapes = dict(_shapes(path))
        super().__init__(path, columns_of(self._shapes))

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        loaded: Any = np.load(self.path, allow_pickle=False)
        arrays = loaded if self.path.suffix.lower() == ".npz" else {self.path.stem: loaded}
        return chosen_columns(
            {name: arrays[name] for name in {array_name(name, self._shapes) for name in names}}, names
        )


def columns_of(shapes: Mapping[str, tuple[int, ...]], units: Mapping[str, str] | None = None) -> Iterator[LogColumn]:
    """The columns of arrays by their shapes; the longer side of an array is that of the samples. Of single numbers,
    sampling times and rates are columns.
    """
    for name, shape in shapes.items():
        sides = [side for side in shape if side != 1] or [1]
        samples, width = max(sides), min(sides) if len(sides) > 1 else 1
        unit = (units or {}).get(name, "")
        if width > WIDEST or (samples < 2 and not period_words(name)):
            continue
        for k in range(width):
            yield LogColumn(name=name if width == 1 else f"{name}[{k}]", samples=samples, unit=unit)


def chosen_columns(arrays: Mapping[str, Array], names: Sequence[str]) -> dict[str, Array]:
    """Columns by name out of arrays."""
    found = {}
    for name in names:
        values = np.atleast_1d(np.asarray(arrays[array_name(name, arrays)]).squeeze())
        if values.dtype.kind not in "fiub":
            raise UserError(f"{name} holds no numbers")
        if values.ndim == 2:
            values = values.T if values.shape[0] > values.shape[1] else values
            values = values[int(name[name.rindex("[") + 1 : -1])]
        found[name] = values
    return found


def array_name(column: str, arrays: Container[str]) -> str:
    """The array of a column: x of x[0], where no array has that very name."""
    return column if column in arrays else column[: column.rindex("[")]


def _shapes(path: Path) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Names and shapes of numeric arrays, out of their headers alone."""
    if path.suffix.lower() == ".npy":
        with path.open("rb") as file:
            yield from _header(path.stem, file)
        return
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist()[:MOST_COLUMNS]:
            check_size(path, entry.file_size // 8)
            with archive.open(entry) as member:
                yield from _header(entry.filename.removesuffix(".npy"), member)


def _header(name: str, file: Any) -> Iterator[tuple[str, tuple[int, ...]]]:
    version = npy.read_magic(file)
    shape, _, dtype = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(file)
    if dtype.kind in "fiub" and len(shape) < 3:
        yield name, shape


class ParquetFile(LogFile):
    """A table whose columns are read singly."""

    def __init__(self, path: Path) -> None:
        import polars

        self._lazy = polars.scan_parquet(path, glob=False)
        schema = self._lazy.collect_schema()
        samples = int(self._lazy.select(polars.len()).collect().item())
        kinds = [
            name for name, kind in schema.items() if kind.is_numeric() or kind.is_temporal() or kind == polars.Boolean
        ]
        super().__init__(path, [LogColumn(name=name, samples=samples, unit=_unit(schema[name])) for name in kinds])

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        import polars

        table = self._lazy.select(names).collect()
        found = {}
        for name in names:
            column = table[name]
            if column.dtype.is_temporal():
                stamps = column.dt.cast_time_unit("ns").to_physical()
                column = (stamps - stamps.min()) * 1e-9
            found[name] = column.cast(polars.Float64).to_numpy()
        return found


def _unit(kind: Any) -> str:
    return "s" if kind.is_temporal() else ""
