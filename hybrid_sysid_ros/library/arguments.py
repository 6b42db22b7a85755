"""Arguments of the public functions, checked by name, type and shape. Each error says what to do."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeAlias, get_args

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import InputHandling, Model, Sampling
from hybrid_sysid_ros.models.plausibility import check_limits, check_travel
from hybrid_sysid_ros.models.structure import Options
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import Interrupted, UserError, known, shown
from hybrid_sysid_ros.support.structured import section

RigLike: TypeAlias = Rig | str | Path
"""A rig, its name, or the path of its folder."""
PartLike: TypeAlias = Part | str | Sequence[float] | Array
"""A part, "0:0.5", or (0, 0.5)."""
SamplingLike: TypeAlias = Sampling | Mapping[str, Any]
"""A sampling, or some of its numbers by name."""

LONGEST_SAMPLE = 100.0
"""Sampling time of a record, in the rig's step, up to which fits follow it."""
LARGEST_SEED = 2**63 - 1
MOST_SAMPLES = 10**9
"""Of a record."""


@contextmanager
def within(argument: str) -> Iterator[None]:
    """Add the name of an argument to errors of the library below."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{argument}: {error}") from error


def guarded(function: Callable[..., Any], argument: str, gives: str) -> Callable[..., Any]:
    """A function of the user whose errors name the argument."""

    def called(*given: Any) -> Any:
        try:
            return function(*given)
        except (UserError, Interrupted):
            raise
        except Exception as error:  # their code can raise anything
            raise UserError(f"{argument} fails: {type(error).__name__}: {error}; give a function of {gives}") from error

    return called


def rig_of(value: RigLike, load: Callable[[str | Path], Rig] = rigs.load) -> Rig:
    """A rig from a rig, its name, or the path of its folder."""
    if isinstance(value, Rig):
        return value
    if not isinstance(value, str | Path) or not str(value):
        raise UserError(f"rig is {shown(value)}; give a rig's name, the path of its folder, or what load_rig returns")
    with within("rig"):
        return load(value)


def source_of(rig: RigLike) -> str:
    """Name or folder of a rig, which is then known by its name; "" where none is given."""
    return "" if isinstance(rig, str) and not rig else rig_of(rig).source


def given_records(value: object, rig: Rig) -> list[Record]:
    """One record or several, of a rig."""
    found = [value] if isinstance(value, Record | str | Path) else value
    if isinstance(found, np.ndarray) or not isinstance(found, Sequence):
        raise UserError(
            f"records is {shown(value)}; give a record or a list of them: read_bag makes one of a bag, record of arrays"
        )
    if not found:
        raise UserError("records is empty; give at least one record")
    return [record_of(item, rig, f"records[{index}]") for index, item in enumerate(found)]


def record_of(value: object, rig: Rig, argument: str = "record") -> Record:
    """One record of a rig. A record that was made without a rig is compared with the rig here."""
    if isinstance(value, str | Path):
        raise UserError(f"{argument} is {shown(value)}; read it first: read_bag({str(value)!r}, rig)")
    if not isinstance(value, Record):
        raise UserError(f"{argument} is {shown(value)}; give a record: read_bag makes one of a bag, record of arrays")
    if value.rig and value.rig != rig.name:
        raise UserError(
            f"{argument} is of the rig {value.rig}, not of {rig.name}; give one that was read for {rig.name}"
        )
    for kind, columns, items in (
        ("input", value.input.shape[1], rig.system.inputs),
        ("output", value.output.shape[1], rig.system.outputs),
    ):
        if columns != len(items):
            names = ", ".join(map(str, items))
            raise UserError(f"{argument} has {columns} {kind}s, {rig.name} has {len(items)}: {names}")
    if not value.rig:
        check_limits(value, rig)
        check_travel(value, rig)
    return value


def given_model(value: object, rig: Rig | None = None, argument: str = "model") -> Model:
    """A model, of a rig where one is given."""
    if isinstance(value, str | Path):
        raise UserError(f"{argument} is {shown(value)}; load it first: load_model({str(value)!r})")
    if not isinstance(value, Model):
        raise UserError(f"{argument} is {shown(value)}; give a model: identify makes one, load_model reads one")
    if rig is not None and value.rig != rig.name:
        raise UserError(f"{argument} is of the rig {value.rig}, not of {rig.name}; give one that was identified on it")
    return value


def number_of(
    value: object, argument: str, *, low: float = -math.inf, high: float = math.inf, unit: str = "", above: bool = False
) -> float:
    """A finite number within low and high; above: low itself is excluded."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise UserError(f"{argument} is {shown(value)}; give a number{f' [{unit}]' if unit else ''}")
    try:
        number = float(value)
    except OverflowError:  # of a whole number
        number = math.inf
    if not (math.isfinite(number) and low <= number <= high and (number > low or not above)):
        least = [f"above {low:g}" if above else f"of at least {low:g}"] if math.isfinite(low) else []
        ends = " and ".join(least + ([f"at most {high:g}"] if math.isfinite(high) else [])) or "that is finite"
        raise UserError(f"{argument} is {number:g}; give a number {ends}{f' [{unit}]' if unit else ''}")
    return number


def whole_of(value: object, argument: str, *, low: int, high: int) -> int:
    """A whole number within low and high."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not low <= value <= high:
        raise UserError(f"{argument} is {shown(value)}; give a whole number from {low} to {high}")
    return int(value)


def flag_of(value: object, argument: str) -> bool:
    """True or False."""
    if not isinstance(value, bool | np.bool_):
        raise UserError(f"{argument} is {shown(value)}; give True or False")
    return bool(value)


def name_of(value: object, argument: str) -> str:
    """A name for tables and files: a line of text, and no path."""
    if not isinstance(value, str) or not value.isprintable() or Path(value).name != value or value in ("", ".."):
        raise UserError(f"{argument} is {shown(value)}; give a name in a line of text, without a slash")
    return value


def text_of(value: object, argument: str) -> str:
    """A text, which may be empty."""
    if not isinstance(value, str):
        raise UserError(f"{argument} is {shown(value)}; give a text")
    return value


def seed_of(value: object) -> int:
    """A seed of random numbers."""
    return whole_of(value, "seed", low=0, high=LARGEST_SEED)


def choice_of(value: object, argument: str, names: Collection[str]) -> str:
    """One of some names."""
    if not isinstance(value, str) or value not in names:
        text = value if isinstance(value, str) else ""
        raise UserError(f"{argument} is {shown(value)}; {known(text, names)}")
    return value


def plain(value: Any) -> Any:
    """Lists and Python's numbers for arrays, ranges, tuples and NumPy's numbers, in mappings and lists, too."""
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list | tuple | range) else value


def mapping_of(value: object, argument: str, example: str) -> dict[str, Any]:
    """A mapping by name, as :func:`plain`; empty for None."""
    if value is not None and not isinstance(value, Mapping):
        raise UserError(f"{argument} is {shown(value)}; give a mapping by name, such as {example}")
    return dict(plain(value or {}))


def part_of(value: PartLike, argument: str = "part") -> Part:
    """A part of a record, as fractions of it."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Part):
        start, stop = value.start, value.stop
    elif isinstance(value, str):
        with within(argument):
            return Part.parse(value)
    elif isinstance(value, Sequence) and len(value) == 2:
        start, stop = (number_of(end, f"{argument}[{index}]", low=0.0, high=1.0) for index, end in enumerate(value))
    else:
        raise UserError(f"{argument} is {shown(value)}; give two fractions, such as (0, 0.5)")
    if not 0.0 <= start < stop <= 1.0:
        raise UserError(f"{argument} is ({start:g}, {stop:g}); give two fractions with 0 <= start < stop <= 1")
    return Part(start=start, stop=stop)


def given_parts(value: PartLike | Sequence[PartLike], count: int) -> Part | list[Part]:
    """One part of all records, or one of each."""
    if isinstance(value, Part | str) or not isinstance(value, Sequence):
        return part_of(value)  # type: ignore[arg-type]
    if not any(isinstance(item, Part | str | Sequence | np.ndarray) for item in value):
        return part_of(value)  # type: ignore[arg-type]
    if len(value) != count:
        raise UserError(f"part has {len(value)} parts for {count} records; give one for all, or one of each")
    return [part_of(item, f"part[{index}]") for index, item in enumerate(value)]  # type: ignore[arg-type]


def given_sampling(value: SamplingLike | None, rig: Rig, records: Sequence[Record] = ()) -> Sampling:
    """The sampling of records, by default that of the rig's file, or else the nearest to the usual one that the records
    have, unless their steps are so long beside the rig's that their times are hardly in seconds.
    """
    given = section(rig.content, "demo", str(rig.file))
    own: dict[str, Any] = {"input": "auto", **{name: given[name] for name in ("step", "period") if name in given}}
    if isinstance(value, Sampling):
        return value
    value = {} if value is None else value
    for name, item in mapping_of(value, "sampling", '{"step": 0.005, "period": 0.05}').items():
        choice_of(name, "a name in sampling", [item.name for item in fields(Sampling)])
        if name == "input":
            choice_of(item, "sampling.input", get_args(InputHandling))
        elif name == "initial":
            text_of(item, "sampling.initial")
        elif name in ("initial_samples", "warm_up"):
            whole_of(item, f"sampling.{name}", low=0, high=MOST_SAMPLES)
        else:
            number_of(item, f"sampling.{name}", low=0.0, above=True, unit="s")
    stated = own | dict(value)
    found, period = Sampling(**stated), max((record.sampling_time for record in records), default=0.0)
    if {"step", "period"} & stated.keys() or not 0.0 < period <= LONGEST_SAMPLE * rig.step:
        return found
    return found.following(period)


def given_options(value: Mapping[str, Any] | None, argument: str = "options") -> Options:
    """Numbers by name."""
    given = mapping_of(value, argument, '{"units": 8}')
    for name, item in given.items():
        number_of(item, f"{argument}[{name!r}]")
    return given


def callable_of(value: object, argument: str, arguments: str) -> Any:
    """A function that receives progress, or None."""
    if value is not None and not callable(value):
        raise UserError(f"{argument} is {shown(value)}; give a function of {arguments}, or None")
    return None if value is None else guarded(value, argument, arguments)


def array_of(value: object, argument: str, remedy: str = "give finite numbers") -> Array:
    """An array of finite numbers, of any shape. remedy: advice where they are not finite."""
    try:
        found = np.asarray(value)
    except ValueError as error:
        raise UserError(f"{argument} is {shown(value)}, whose rows differ in length; give an array") from error
    if found.dtype.kind == "M":
        raise UserError(f"{argument} is dates; give seconds: (t - t[0]) / numpy.timedelta64(1, 's')")
    if found.dtype.kind not in "iuf":
        kind = "text" if found.dtype.kind in "US" else f"dtype {found.dtype.name}"
        raise UserError(f"{argument} is {shown(value)} of {kind}; give real numbers, float or int")
    if np.ma.is_masked(value):
        raise UserError(f"{argument} has masked values; {remedy}")
    found = found.astype(float)
    if not np.isfinite(found).all():
        wrong = ~np.isfinite(found)
        first = tuple(np.argwhere(wrong)[0].tolist())
        place = f" at {list(first)}" if first else ""
        raise UserError(
            f"{argument} is {found[first]}{place}, one of {np.count_nonzero(wrong)} values that are not "
            f"finite; {remedy}"
        )
    return found


def given_columns(value: Any, argument: str, names: Sequence[str], rows: int) -> Array:
    """An array (rows, columns) from an array, a single column, or columns by their names.

    names: names of the columns; without names any number of columns is accepted.
    """
    if isinstance(value, Mapping) or hasattr(value, "columns"):
        given = list(getattr(value, "columns", value))
        if sorted(map(str, given)) != sorted(names):
            expected = f"; give {', '.join(names)}" if names else "; columns have names where a rig is given"
            raise UserError(f"{argument} has the names {', '.join(map(str, given))}{expected}")
        return np.hstack([given_columns(value[name], f"{argument}[{name!r}]", (name,), rows) for name in names])
    found = array_of(value, argument, "cut them off, or repair the measurement")
    if found.ndim == 1:
        found = found[:, None]
    wanted = f"({rows}, {len(names) or 'columns'})"
    turned = " (it seems to be transposed)" if found.ndim == 2 and found.shape[1] == rows != found.shape[0] else ""
    if found.ndim != 2 or len(found) != rows or (names and found.shape[1] != len(names)):
        of = f" for {', '.join(names)}" if names else ""
        raise UserError(f"{argument} has shape {np.shape(value)}; it needs {wanted}{of}{turned}")
    return found
