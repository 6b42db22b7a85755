"""Text files of columns: CSV with any delimiter and either decimal sign, with or without names and units."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.extensions.importing.log_file import UNITED, LogColumn, LogFile
from hybrid_sysid_ros.extensions.importing.readers.moments import IS_MOMENT, seconds_of_moments
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

HEAD = 1 << 18
"""Bytes at the beginning by which the form of a file is found."""
WIDE = (b"\xff\xfe", b"\xfe\xff")
"""How text in UTF-16 begins, such as that of spreadsheets and of LabVIEW."""
MOST_LINES = 200
"""Lines that may stand before the numbers."""
DELIMITERS = (";", "\t", ",", "|")
MISSING = ["", "nan", "NaN", "NAN", "NA", "N/A", "null", "NULL", "None", "-", "inf", "-inf", "#N/A"]
SWITCHES = {
    **dict.fromkeys(("on", "true", "yes", "ein", "an", "ja", "ligado", "sim"), 1.0),
    **dict.fromkeys(("off", "false", "no", "aus", "nein", "desligado", "não"), 0.0),
}
"""Words of switches and of programs, in small letters, as numbers."""
_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][-+]?\d+)?$")
_APART = re.compile(r"\d\s+[-+]?\d")
"""Two numbers with blanks between them."""
_THOUSANDS = re.compile(r"[-+]?\d{1,3}((,\d{3})+\.|(\.\d{3})+,)\d+$")
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([.,])\d{3}(\1\d{3})*$")
"""Either thousands or three decimals, as in 2,153."""
FEWEST_GROUPED = 3
"""Different numbers of that kind from which a column of them tells: a switch may have just 0 and 1.125."""


@dataclass(frozen=True, kw_only=True)
class TextForm:
    """How a text file is written."""

    delimiter: str
    """ "" for any run of blanks."""
    comma: bool
    """Whether the decimal sign is a comma."""
    skipped: int
    """Lines before the first row of numbers."""
    names: tuple[str, ...]
    units: tuple[str, ...]
    moments: frozenset[str]
    """Columns with dates and times of day."""
    switches: frozenset[str]
    """Columns of on and off."""
    trailing: bool
    """Whether each line ends in a delimiter."""


class TextFile(LogFile):
    """A text file; only the columns that are asked for are kept."""

    def __init__(self, path: Path) -> None:
        with path.open("rb") as file:
            head = file.read(HEAD)
        self._wide = head[:2] in WIDE
        if self._wide:
            head = head[: len(head) // 2 * 2]
        elif b"\0" in head:
            raise UserError(f"{path}: is no text file, although its name says so; save it as UTF-8 if it is one")
        whole = path.stat().st_size
        lines = (head.decode("utf-16", "replace") if self._wide else _decoded(head)).splitlines()
        if len(head) < whole:
            lines = lines[:-1]  # which may be cut
        self.form = form_of(lines, path)
        rows = len(lines) - self.form.skipped
        bytes_of_rows = (1 + self._wide) * sum(len(line) + 1 for line in lines[self.form.skipped :])
        samples = rows if len(head) == whole else round(rows * whole / max(bytes_of_rows, 1))
        columns = zip(self.form.names, self.form.units, strict=True)
        super().__init__(path, [LogColumn(name=name, unit=unit, samples=samples) for name, unit in columns])

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        if not self.form.delimiter:
            chosen = [self.form.names.index(name) for name in names]
            table = np.loadtxt(
                self.path, skiprows=self.form.skipped, usecols=chosen, ndmin=2,
                encoding="utf-16" if self._wide else "latin-1", converters=_number,
            )  # fmt: skip
            return dict(zip(names, table.T, strict=True))
        import polars

        trailing = {"": polars.String} if self.form.trailing else {}
        texts = self.form.moments | self.form.switches
        kinds = {name: polars.String if name in texts else polars.Float64 for name in self.form.names}
        rows = polars.scan_csv(
            self._bytes() if self._wide else self.path, separator=self.form.delimiter,
            decimal_comma=self.form.comma, has_header=False,
            skip_rows=self.form.skipped, schema=kinds | trailing, null_values=MISSING, ignore_errors=True,
            encoding="utf8-lossy", truncate_ragged_lines=True, glob=False,
        )  # fmt: skip
        table = rows.select(names).collect()

        def numbers(name: str) -> Array:
            if name in self.form.moments:
                return seconds_of_moments(table[name])
            if name in self.form.switches:
                return np.array([_number(text or "") for text in table[name]])
            return np.asarray(table[name].to_numpy())

        return {name: numbers(name) for name in names}

    def _bytes(self) -> bytes:
        """The file in UTF-8, which is all that the library reads."""
        return self.path.read_bytes().decode("utf-16", "replace").encode()


def form_of(lines: Sequence[str], path: Path) -> TextForm:
    """How the lines at the beginning of a file are written. Raises UserError where no row of numbers is found."""
    for delimiter in (*DELIMITERS, ""):
        head = lines[: MOST_LINES + 20]
        trailing = bool(delimiter) and all(line.rstrip().endswith(delimiter) for line in head[-5:])
        rows = [_cells(line, delimiter, trailing) for line in head]
        first = next((k for k in range(len(rows)) if _begins(rows, k)), None)
        if first is None or (delimiter and len(rows[first]) < 2):
            continue
        if delimiter == "," and (_is_decimal(rows, first) or _are_apart(rows[first])):
            continue  # columns apart by blanks, or a single one, with commas for decimal signs
        _check_signs(rows, first, path)
        _check_thousands([_cells(line, delimiter, trailing) for line in lines[first:]], path)
        return _form(rows, first, delimiter, trailing)
    raise UserError(
        f"{path}: no row of numbers is found in its first {min(len(lines), MOST_LINES)} lines: is it a table?"
    )


def _form(rows: list[list[str]], first: int, delimiter: str, trailing: bool) -> TextForm:
    count, data = len(rows[first]), rows[first:]
    comma = any("," in cell and not IS_MOMENT.match(cell) for row in data for cell in row)
    above = [row for row in rows[:first] if len(row) == count and sum(map(bool, row)) > 0.5 * count]
    units = [""] * count
    if len(above) > 1 and all(len(cell.strip("[]() ")) <= 12 for cell in above[-1]):
        units = [cell.strip("[]() ") for cell in above.pop()]
    names = above[-1] if above else [f"column_{k + 1}" for k in range(count)]
    taken = dict[str, int]()
    for k, name in enumerate(names):
        if (match := UNITED.match(name)) and not units[k]:
            names[k], units[k] = match["name"], match["unit"].strip()
        names[k] = names[k] or f"column_{k + 1}"
        taken[names[k]] = taken.get(names[k], 0) + 1
        if taken[names[k]] > 1:
            names[k] = f"{names[k]}_{taken[names[k]]}"
    moments = frozenset(name for k, name in enumerate(names) if IS_MOMENT.match(data[0][k]))
    switches = frozenset(name for k, name in enumerate(names) if data[0][k].lower() in SWITCHES)
    units = ["s" if name in moments else unit for name, unit in zip(names, units, strict=True)]
    return TextForm(
        delimiter=delimiter, comma=comma, skipped=first, names=tuple(names), units=tuple(units), moments=moments,
        switches=switches, trailing=trailing,
    )  # fmt: skip


def _begins(rows: list[list[str]], k: int) -> bool:
    """Whether the numbers begin in a row: it and the next ones are numbers or empty, and as many."""
    following = [row for row in rows[k : k + 4] if any(row)]
    return bool(following) and all(_numeric(row) and len(row) == len(following[0]) for row in following)


def _numeric(row: list[str]) -> bool:
    numbers = sum(bool(_NUMBER.match(cell) or IS_MOMENT.match(cell) or _THOUSANDS.match(cell)) for cell in row)
    return numbers > 0 and numbers + sum(cell in MISSING for cell in row) >= 0.5 * len(row) and not _words(row)


def _words(row: list[str]) -> bool:
    """Whether most cells of a row are words: the row of names."""
    return sum(bool(re.match(r"[A-Za-z_#\"]", cell)) and cell not in MISSING for cell in row) > 0.5 * len(row)


def _is_decimal(rows: list[list[str]], first: int) -> bool:
    """Whether commas of two cells a row, 3 and 14, are decimal signs: no name stands above, and the second never has
    a sign or point.
    """
    data = rows[first : first + 50]
    return (
        len(rows[first]) == 2
        and not any(len(row) == 2 for row in rows[:first])
        and all(row[-1].isdigit() and "." not in row[0] for row in data if any(row))
    )


def _are_apart(row: list[str]) -> bool:
    """Whether a row that is cut at its commas has two numbers in one cell."""
    return any(_APART.search(cell) and not IS_MOMENT.match(cell) for cell in row)


def _check_signs(rows: list[list[str]], first: int, path: Path) -> None:
    """Raise UserError for signs between thousands, and for commas that are delimiters and decimal signs at once."""
    if strange := next((cell for row in rows[first:] for cell in row if _THOUSANDS.match(cell)), ""):
        raise UserError(f"{path}: {strange} has a sign between its thousands; export numbers without it")
    names = next((row for row in reversed(rows[:first]) if len(row) > 1), [])
    if 2 * len(names) == len(rows[first]):
        raise UserError(
            f"{path}: rows have {len(rows[first])} values under {len(names)} names: is the decimal sign the delimiter, "
            "too? export it with semicolons between the columns"
        )


def _check_thousands(rows: Sequence[Sequence[str]], path: Path) -> None:
    """Raise UserError for signs that stand between thousands: all numbers of a column have three digits behind it, and
    the file's decimal sign is another one, or, where none shows, plain integers stand in that column.
    """
    columns = [[cell for cell in column if _NUMBER.match(cell)] for column in zip(*rows, strict=False)]
    decimal = {
        sign for column in columns for cell in column if not _GROUPED.match(cell) for sign in ".," if sign in cell
    }
    for column in columns:
        signed = [cell for cell in column if "." in cell or "," in cell]
        grouped = [match for cell in signed if (match := _GROUPED.match(cell))]
        beside = f"decimals with {''.join(decimal)}" if decimal else "plain integers"
        if (
            len({*signed}) < FEWEST_GROUPED
            or len(grouped) < len(signed)
            or grouped[0][1] in decimal
            or not (decimal or len(signed) < len(column))
        ):
            continue
        raise UserError(
            f"{path}: {signed[0]} seems to have a sign between its thousands, since {beside} stand beside it; export "
            "numbers without it"
        )


def _number(cell: str) -> float:
    """The number in a cell; NaN where there is none."""
    if (switch := SWITCHES.get(cell.strip(' "').lower())) is not None:
        return switch
    try:
        return float(cell.replace(",", ".").lower().replace("d", "e"))
    except ValueError:
        return float("nan")


def _cells(line: str, delimiter: str, trailing: bool) -> list[str]:
    """The cells of a line, without quotes. trailing: each line ends in a delimiter."""
    text = line.strip(" \r\n\ufeff") if delimiter else line.strip().lstrip("#%").strip()
    cells = next(csv.reader([text], delimiter=delimiter), [""]) if delimiter else text.split()
    if trailing and len(cells) > 1 and not cells[-1].strip():
        cells.pop()
    return [cell.strip().strip('"').strip() for cell in cells]


def _decoded(head: bytes) -> str:
    try:
        return head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        cut = error.start > len(head) - 4  # the last character is
        return head[: error.start].decode("utf-8-sig") if cut else head.decode("latin-1")
