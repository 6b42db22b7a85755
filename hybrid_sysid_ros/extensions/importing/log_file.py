"""A log file: columns of numbers, some of which are times, as another program recorded them."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.rigs.units import LETTERS, PREFIXES, SYMBOLS, named
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import Interrupted, UserError, known

LARGEST = 1 << 28
"""Most numbers that are read of one file, 2 GiB of them. A file with more is refused before memory is taken."""
MOST_COLUMNS = 20_000
"""Most columns of a file."""
_WORD = re.compile(r"[A-Z]+(?![a-z])|[^\W\d_][^\W\dA-Z_]*|\d+")
_SI = {prefix + symbol for prefix in ("", *PREFIXES) for symbol in {*SYMBOLS} - {"1"} if len(prefix + symbol) > 1}
UNITS = frozenset(
    _SI - {"nm"}
    | {
        "deg",
        "rpm",
        "RPM",
        "Nm",
        "Nmm",
        "sec",
        "bar",
        "mbar",
        "kmh",
        "kph",
        "mph",
        "ml",
        "%",
        "percent",
        "°",
        "degC",
        "degF",
    }
)
"""Units that may end a name; nm may be the torque's."""
_END = re.compile(r"(?P<front>.*?[^\s_/])(?:_|\s*/\s*|\s+)(?P<unit>[^\s_/]+(?:/(?:s|s\^2|s²|min|h))?)$")
_RATE = re.compile(r"(?P<front>.*?[^\s_/])_(?P<unit>[^\W_]+)_(?P<time>s|min|h)$")
ALONE, PHASES = frozenset(("V", "W")), frozenset(("phase", "line", "leg"))
"""Units of one letter that end any name but those of phases U, V and W; other letters name places, such as sensor_A."""
RATED = frozenset(("l", "L", "m", "rad"))
"""Units that end a name only as rates, such as flow_l_min."""
UNITED = re.compile(r"(?P<name>.+?)\s*/?\s*[\[(](?P<unit>[^\])]*)[\])]$")
"""A name with its unit in brackets, "n/(1/min)", too."""


@dataclass(frozen=True, kw_only=True)
class LogColumn:
    """One column of a file, before it is read."""

    name: str
    samples: int
    """Number of values; 0 where the file does not say before it is read."""
    unit: str = ""
    """As the file states it."""
    time: str = ""
    """Name of the column with its times; "" where the file does not say."""


class LogFile(ABC):
    """A file whose columns are listed at once, and read when they are asked for."""

    def __init__(self, path: Path, columns: Iterable[LogColumn]) -> None:
        """Raises UserError for a file without columns, or with more than anybody needs."""
        self.path = path
        self.columns: Mapping[str, LogColumn] = {
            item.name: item if item.unit else replace(item, unit=unit_at_end(item.name)) for item in columns
        }
        if not self.columns:
            raise UserError(f"{path}: holds no column of numbers: is it a record?")
        if len(self.columns) > MOST_COLUMNS:
            raise UserError(f"{path}: has {len(self.columns)} columns, more than {MOST_COLUMNS}; cut the file")

    def column_of(self, text: str) -> str:
        """The column that a user means, who may write its unit behind it in brackets; the text itself for none."""
        if text in self.columns or not (match := UNITED.match(text)):
            return text
        name, unit = match["name"], match["unit"].strip()
        alike = [
            item.name for item in self.columns.values() if re.sub(r"_\d+$", "", item.name) == name and item.unit == unit
        ]
        return name if name in alike else alike[0] if len(alike) == 1 else text

    def read(self, names: Sequence[str]) -> dict[str, Array]:
        """Columns by name, (samples,) each; NaN where a value is missing.

        Raises UserError for an unknown column, for more numbers than :data:`LARGEST`, and for a damaged file.
        """
        wanted = list(dict.fromkeys(names))
        for name in wanted:
            if name not in self.columns:
                raise UserError(f"{self.path}: no column {name!r}: {known(name, self.columns)}")
        self.check_size(sum(self.columns[name].samples for name in wanted))
        with readable(self.path):
            return {
                name: np.ascontiguousarray(values, dtype=np.float64).ravel()
                for name, values in self._values(wanted).items()
            }

    def check_size(self, count: int) -> None:
        """Raise UserError for more numbers than :data:`LARGEST`."""
        check_size(self.path, count)

    @abstractmethod
    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        """Columns by name; what the library raises for a damaged file becomes a UserError."""


class JoinedFile(LogFile):
    """Several files of one record, such as of two devices; columns are named FILE.COLUMN, without the file's suffix."""

    def __init__(self, files: Sequence[LogFile], times: Sequence[str]) -> None:
        """times: by file, the column with the times of its other columns; "" for none. Raises UserError for two files
        of one name.
        """
        stems = [file.path.stem for file in files]
        if twins := {stem for stem in stems if stems.count(stem) > 1}:
            raise UserError(f"{files[0].path}: two files are called {min(twins)}; rename one")
        own = dict(zip(files, times, strict=True))
        self._places = {f"{file.path.stem}.{name}": (file, name) for file in files for name in file.columns}
        super().__init__(
            files[0].path,
            [
                replace(file.columns[name], name=joined, time=time and f"{file.path.stem}.{time}")
                for joined, (file, name) in self._places.items()
                for time in [file.columns[name].time or own[file]]
            ],
        )

    def _values(self, names: Sequence[str]) -> Mapping[str, Array]:
        return {name: file.read([own])[own] for name in names for file, own in [self._places[name]]}


def unit_at_end(name: str) -> str:
    """The unit that ends a name, mm of travel_mm and V of "U/V", or ""."""
    return _parted(name)[1]


def without_unit(name: str) -> str:
    """A name without the unit that ends it."""
    return _parted(name)[0]


def _parted(name: str) -> tuple[str, str]:
    """A name and the unit that ends it, in brackets or behind a sign or blank; other words in brackets are none."""
    if (united := UNITED.match(name)) and not name.startswith("/"):
        unit = united["unit"].strip()
        known = not unit.isdigit() and (unit in UNITS or unit.startswith("°") or named(unit) is not None)
        return (united["name"], unit) if known else (name, "")
    if (rate := _RATE.match(name)) and rate["unit"] in (*UNITS, *RATED):
        return rate["front"], f"{rate['unit']}/{rate['time']}"
    match = _END.match(name)
    if match is None or name.startswith("/"):
        return name, ""
    front, unit = match["front"], match["unit"]
    words = {word.lower() for word in _WORD.findall(front)}
    anywhere = unit in ALONE and not words & PHASES
    known = unit.partition("/")[0] in UNITS or anywhere or bool(words & LETTERS.get(unit, frozenset()))
    return (front, unit) if known or unit in ("m/s", "m/s^2", "m/s²") else (name, "")


def words_of(name: str) -> list[str]:
    """The words of a name in small letters, without units at its end."""
    plain = without_unit(re.sub(r"\s*/?\s*[\[(].*", "", name))
    return [word.lower() for word in _WORD.findall(plain.rsplit("/", 1)[-1].rsplit(".", 1)[-1])]


def check_size(path: Path, count: int) -> None:
    """Raise UserError where a file holds more numbers than :data:`LARGEST`."""
    if count > LARGEST:
        raise UserError(
            f"{path}: holds {count:.3g} numbers, {count * 8 / 2**30:.1f} GiB in memory, and at most "
            f"{LARGEST * 8 >> 30} GiB are read at once; cut the file, or take every n-th sample"
        )


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
