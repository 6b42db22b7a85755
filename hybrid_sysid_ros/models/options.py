"""Options of structures: what a user may set and a search may vary."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hybrid_sysid_ros.support.errors import UserError

Options = Mapping[str, float | int]


@dataclass(frozen=True, kw_only=True)
class Option:
    """default, within low and high; kind "log" is a positive number whose magnitude matters."""

    default: float | int
    low: float | int
    high: float | int
    kind: Literal["int", "float", "log"]
    description: str


def complete(given: Options, known: Mapping[str, Option], structure: str) -> dict[str, float | int]:
    """All options, the given ones over the defaults.

    Raises UserError for an option that the structure does not have, or a value outside its range.
    """
    for name, value in given.items():
        if name not in known:
            raise UserError(f"structure {structure} has no option {name}; it has {', '.join(known) or 'none'}")
        option = known[name]
        if not option.low <= value <= option.high:
            raise UserError(f"option {name} = {value:g} is outside {option.low:g} to {option.high:g}")
        if option.kind == "int" and value != int(value):
            raise UserError(f"option {name} = {value:g} must be a whole number")
    chosen = {name: given.get(name, option.default) for name, option in known.items()}
    return {name: int(value) if known[name].kind == "int" else float(value) for name, value in chosen.items()}


def parse(texts: list[str]) -> dict[str, float]:
    """Options from NAME=VALUE. Raises UserError for anything else."""
    options = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            options[name.strip()] = float(value)
        except ValueError:
            raise UserError(f"option {text!r}: write NAME=NUMBER, such as units=8") from None
    return options
