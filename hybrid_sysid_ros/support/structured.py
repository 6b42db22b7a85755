"""Plain data from YAML files as dataclasses; errors name file and key."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from hybrid_sysid_ros.support import errors, yaml_text
from hybrid_sysid_ros.support.errors import UserError, UserErrors, collected

T = TypeVar("T")
_hints: Callable[[type], dict[str, Any]] = functools.cache(get_type_hints)  # two thirds of the time of a dataclass
KINDS = {float: "a number", int: "a whole number", str: "text", bool: "true or false"}


def read_mapping(path: Path | str) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Raises UserError for a file that is missing, not readable, no YAML or no mapping.
    """
    try:
        content = yaml_text.read(Path(path))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from error
    except yaml_text.TextError as error:
        raise UserError(f"{path}: {error}") from error
    if not isinstance(content, dict):
        raise UserError(f"{path}: holds no keys: it needs sections with a name each")
    return content


def refuse_endless(value: Any, where: str) -> None:
    """Raise UserError for numbers in nested mappings and lists that are not finite."""
    if isinstance(value, float) and not math.isfinite(value):
        raise UserError(f"{where} is {value}: it needs a number")
    if isinstance(value, dict):
        for key, item in value.items():
            refuse_endless(item, f"{where}{' ' if where.endswith(':') else '.'}{key}")
    for item in value if isinstance(value, list) else ():
        refuse_endless(item, where)


def section(content: Mapping[str, Any], key: str, where: str, *, needed: bool = False) -> dict[str, Any]:
    """A mapping within a mapping, empty where it is missing; its keys are text.

    Raises UserError for another value, and where the section is ``needed`` and missing.
    """
    value = content.get(key)
    if value is None and not needed:
        return {}
    if not isinstance(value, dict):
        raise UserError(f"{where}: {key} " + ("is missing" if value is None else f"needs keys, not {value!r}"))
    return {str(name): item for name, item in value.items()}


def built(kind: type[T], value: Any, where: str) -> T:
    """A dataclass from a mapping of its fields: numbers, text, truth values, dataclasses again, and lists of these.

    Raises UserError where a key is unknown, missing or of the wrong kind, or the dataclass itself refuses.
    """
    fields = {item.name: item for item in dataclasses.fields(kind) if item.init}  # type: ignore[arg-type]
    if not isinstance(value, Mapping):
        raise UserError(f"{where}: needs {', '.join(fields)}, not {value!r}")
    hints, given, problems = _hints(kind), {}, list[str]()
    with collected(problems):
        refuse_unknown(value, tuple(fields), where)
    for name, item in fields.items():
        if name in value:
            with collected(problems):
                given[name] = _checked(hints[name], value[name], f"{where}.{name}")
        elif item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING:
            problems.append(f"{where}: {name} is missing")
    if problems:
        raise UserErrors(problems)
    try:
        return kind(**given)
    except UserError as error:
        raise UserError(f"{where}: {error}") from error


def refuse_unknown(content: Mapping[Any, Any], known: tuple[str, ...], where: str) -> None:
    """Raise UserError for a key that is none of the known ones."""
    unknown = [str(key) for key in content if key not in known]
    if unknown:
        raise UserErrors(f"{where}: unknown key {key!r}: {errors.known(key, known)}" for key in unknown)


def numbers(value: Any, where: str, *, count: int) -> tuple[float, ...]:
    """``count`` numbers; one alone stands for all. Raises UserError for anything else."""
    items = value if isinstance(value, list | tuple) else [value]
    if any(isinstance(item, bool) or not isinstance(item, int | float) for item in items):
        raise UserError(f"{where} is {value!r}: it needs {'a number' if count == 1 else f'{count} numbers'}")
    if len(items) not in (1, count):
        raise UserError(f"{where} has {len(items)} numbers: it needs {count}, or one for all")
    return tuple(float(item) for item in items) * (count if len(items) == 1 else 1)


def named_numbers(content: Mapping[str, Any], key: str, where: str) -> dict[str, float]:
    """A section of numbers by name, empty where it is missing. Raises UserError where one is no number."""
    return {
        name: numbers(value, f"{where}.{key}.{name}", count=1)[0]
        for name, value in section(content, key, where).items()
    }


def _checked(hint: Any, value: Any, where: str) -> Any:
    choices = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    if value is None and NoneType in choices:
        return None
    wanted = next(choice for choice in choices if choice is not NoneType)
    if dataclasses.is_dataclass(wanted) and isinstance(wanted, type):
        return built(wanted, value, where)
    if get_origin(wanted) is tuple:
        if not isinstance(value, list | tuple):
            raise UserError(f"{where} is {value!r}: it needs a list")
        return tuple(_checked(get_args(wanted)[0], item, f"{where}[{k}]") for k, item in enumerate(value))
    if wanted is float and type(value) is int:
        return float(value)
    if wanted in KINDS and type(value) is not wanted:
        raise UserError(f"{where} is {value!r}: it needs {KINDS[wanted]}")
    return value
