"""Arrays of numpy (NPZ, NPY) and tables of Parquet files."""

from __future__ import annotations

import zipfile
from collections.abc import Container, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from hybrid_sysid_ros.extensions.importing.log_file import MOST_COLUMNS, LogColumn, LogFile, check_size
from hybrid_sysid_ros.extensions.importing.readers.moments import IS_MOMENT, seconds_of_moments
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
        texts = self._lazy.select(name for name, kind in schema.items() if kind == polars.String).head(1).collect()
        self._times = {name for name, kind in schema.items() if kind.is_temporal()}
        self._times |= {column.name for column in texts if IS_MOMENT.match(next(iter(column), None) or "")}
        samples = int(self._lazy.select(polars.len()).collect().item())
        kinds = [
            name for name, kind in schema.items() if name in self._times or kind.is_numeric() or kind == polars.Boolean
        ]
        super().__init__(
            path,
            [LogColumn(name=name, samples=samples, unit="s" if name in self._times else "") for name in kinds],
        )

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        import polars

        table = self._lazy.select(names).collect()
        return {
            name: seconds_of_times(table[name]) if name in self._times else table[name].cast(polars.Float64).to_numpy()
            for name in names
        }


def seconds_of_times(times: Any) -> Array:
    """Seconds since the first of times, dates, times of day or texts of these (a column of polars), (rows,)."""
    import polars

    if times.dtype == polars.String or times.dtype == polars.Time:  # which go on over midnight
        return seconds_of_moments(times if times.dtype == polars.String else times.dt.to_string("%H:%M:%S%.f"))
    whole = times.cast(polars.Datetime) if times.dtype == polars.Date else times
    stamps = whole.dt.cast_time_unit("ns").to_physical()
    return np.asarray(((stamps - stamps.min()) * 1e-9).cast(polars.Float64).to_numpy())
