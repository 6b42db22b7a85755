"""Shots: points of impact, or any errors that are repeated, read from CSV, NPZ or JSON."""

from __future__ import annotations

import csv
import json
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LARGEST = 1 << 25
"""Bytes of a file, and of what is in an archive: a million shots of two coordinates, and some hundred MB to read."""
LONGEST = 1e60
"""Largest number; the product of two variances is one too."""
TEXT = "a column of numbers for each coordinate, as text in UTF-8"
FORMS = {
    ".csv": TEXT,
    ".txt": TEXT,
    ".npz": "an array of numbers for each coordinate by its name",
    ".json": "a list of numbers for each coordinate by its name, or a list of shots of as many numbers each",
}
"""What a file needs, by its suffix."""
HEADING = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(\[(?P<unit>[^\[\]]*)\])?\s*")
DEPENDENT = 1e-10
"""Least eigenvalue of a correlation matrix whose coordinates are several things."""


@dataclass(frozen=True, kw_only=True)
class Shots:
    """Shots (n, d) with the names and units of their coordinates; a unit that is not stated is empty."""

    name: str
    """Where they come from."""
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array

    def as_those_of(self, other: Shots) -> Shots:
        """With the coordinates in the order of others. Raises UserError where coordinates or units differ."""
        if sorted(self.names) != sorted(other.names):
            raise UserError(
                f"{self.name} has the coordinates {', '.join(self.names)}, but {other.name} {', '.join(other.names)}: "
                "give them the same names"
            )
        order = [self.names.index(name) for name in other.names]
        for name, unit, wanted in zip(other.names, (self.units[k] for k in order), other.units, strict=True):
            if unit != wanted:
                raise UserError(
                    f"{name} is in {unit or 'no stated unit'} in {self.name}, but in {wanted or 'no stated unit'} in "
                    f"{other.name}: convert one, and state the unit in both headings ({name} [m])"
                )
        return replace(self, names=other.names, units=other.units, values=self.values[:, order])

    def check_spread(self) -> None:
        """Raise UserError where a coordinate is no number, does not vary, or follows from others."""
        missing = np.argwhere(~np.isfinite(self.values))
        if len(missing):
            shot, coordinate = missing[0]
            raise UserError(
                f"{self.name}: {self.names[coordinate]} of shot {shot + 1} is {self.values[shot, coordinate]}: "
                "leave that shot out"
            )
        for name, column in zip(self.names, self.values.T, strict=True):
            if np.ptp(column) <= max(1e-12 * np.max(np.abs(column)), 1.0 / LONGEST):
                raise UserError(f"{self.name}: {name} is the same in all shots: leave it out of both files")
        if np.linalg.eigvalsh(np.atleast_2d(np.corrcoef(self.values.T)))[0] < DEPENDENT:
            raise UserError(
                f"{self.name}: one of {', '.join(self.names)} follows from the others: leave it out of both files"
            )


def read_shots(path: Path | str, *, unit: str = "", row: str = "shot") -> Shots:
    """Shots of a file: a column (CSV), an array (NPZ) or a list (JSON) for each coordinate, named ``name [unit]``.

    Rows of numbers alone are coordinates 1, 2, ... unit: of coordinates whose heading states none. row: what a row is
    called. Raises UserError for what can't be read, for other than numbers, and for coordinates of different lengths.
    """
    path = Path(path)
    readers = {".npz": _npz, ".json": _json}
    text = partial(_csv, row=row)
    if path.suffix not in FORMS:
        kinds = list(FORMS)
        raise UserError(
            f"{path}: is no {', '.join(kinds[:-1])} or {kinds[-1]} file: write its numbers as one, a row for each {row}"
        )
    try:
        if path.stat().st_size > LARGEST:
            raise UserError(f"{path}: is larger than {LARGEST >> 20} MiB: write fewer {row}s, or fewer digits")
        return _shots(path, readers.get(path.suffix, text)(path), unit, row)
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}): give a file with a row for each {row}") from error
    except Exception as error:  # of zip, numpy, json and unicode, each with its own
        message = str(error).split(". ")[0]
        raise UserError(f"{path}: cannot be read ({message}): it needs {FORMS[path.suffix]}") from error


def _shots(path: Path, columns: Mapping[str, Any], unit: str, row: str) -> Shots:
    parts = [HEADING.fullmatch(heading) for heading in columns]
    names = tuple(part["name"] if part else heading for part, heading in zip(parts, columns, strict=True))
    if not names or len({*names}) < len(names) or not all(names):
        raise UserError(f"{path}: coordinates are called {', '.join(names) or 'nothing'}: give each a name of its own")
    values = []
    for name, column in zip(names, columns.values(), strict=True):
        array = np.asarray(column)
        if array.dtype.kind not in "iuf" or array.ndim != 1:
            raise UserError(f"{path}: {name} is no list of numbers: it needs {FORMS[path.suffix]}")
        missing = np.flatnonzero(~np.isfinite(array))
        if len(missing):
            raise UserError(f"{path}: {name} of {row} {missing[0] + 1} is {array[missing[0]]}: leave that {row} out")
        if np.max(np.abs(array), initial=0.0) > LONGEST:
            raise UserError(f"{path}: {name} goes beyond {LONGEST:g}: give it in another unit")
        values.append(array.astype(np.float64))
    if len({len(column) for column in values}) > 1:
        counts = ", ".join(f"{len(column)} of {name}" for name, column in zip(names, values, strict=True))
        raise UserError(f"{path}: has {counts}: each {row} needs all of them")
    units = tuple(((part and part["unit"]) or unit).strip() for part in parts)
    return Shots(name=path.name, names=names, units=units, values=np.stack(values, axis=1))


def _csv(path: Path, *, row: str) -> dict[str, Any]:
    text = path.read_text(encoding="utf-8-sig")
    delimiter = next((mark for mark in ";\t," if mark in text), ",")
    rows = [line for line in csv.reader(text.splitlines(), delimiter=delimiter) if any(cell.strip() for cell in line)]
    if not rows:
        raise UserError(f"{path}: is empty: write a line of headings and a line for each {row}")
    headed = not all(_is_number(cell) for cell in rows[0])
    headings = [cell.strip() for cell in rows[0]] if headed else _numbered(len(rows[0]))
    if len({*headings}) < len(headings):
        raise UserError(f"{path}: has two columns of one name: {', '.join(headings)}: rename or remove one")
    if not all(headings):
        raise UserError(f"{path}: column {headings.index('') + 1} has no heading: name or remove it")
    numbers = []
    for number, cells in enumerate(rows[headed:], 1):
        if len(cells) != len(headings):
            raise UserError(
                f"{path}: {row} {number} has {len(cells)} numbers, but there are {len(headings)} columns: complete it, "
                "or leave it out"
            )
        for heading, cell in zip(headings, cells, strict=True):
            if not _is_number(cell):
                decimals = ", with a point before its decimals" if _is_number(cell.replace(",", ".")) else ""
                raise UserError(
                    f"{path}: {heading} of {row} {number} is {cell!r}: it needs a number{decimals}, or leave that "
                    f"{row} out"
                )
        numbers.append([float(cell) for cell in cells])
    return dict(zip(headings, np.reshape(numbers, (-1, len(headings))).T, strict=True))


def _npz(path: Path) -> dict[str, Any]:
    with path.open("rb") as file:
        if zipfile.is_zipfile(file):
            unpacked = sum(item.file_size for item in zipfile.ZipFile(file).infolist())
            if unpacked > LARGEST:
                raise UserError(
                    f"{path}: its arrays take {unpacked >> 20} MiB, more than {LARGEST >> 20}: write fewer shots"
                )
        file.seek(0)
        content = np.load(file, allow_pickle=False)
        arrays = dict(content) if isinstance(content, Mapping) else {"": content}
    table = next(iter(arrays.values()), np.empty(0))
    return _columns(table) if len(arrays) == 1 and table.ndim == 2 else arrays


def _json(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text(encoding="utf-8"))
    if isinstance(content, list):
        return _columns(np.asarray(content, dtype=np.float64))
    if not isinstance(content, dict):
        raise UserError(f"{path}: needs {FORMS['.json']}")
    return content


def _columns(table: Array) -> dict[str, Any]:
    if table.ndim != 2:
        raise ValueError(f"its numbers are no table, but of shape {table.shape}")
    return dict(zip(_numbered(table.shape[1]), table.T, strict=True))


def _numbered(count: int) -> Sequence[str]:
    return [str(k + 1) for k in range(count)]


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
