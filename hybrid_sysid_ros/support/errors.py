"""Errors that a user can cause, and interruptions."""

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path

LONGEST = 2000
"""Characters of an error."""
WIDE = 100
"""Characters of an argument."""
FEW = 12
"""Names that a line tells one by one."""


class UserError(Exception):
    """What is wrong, where (file, topic, parameter, sample) and what to do, in one line.

    The command line prints it and exits with status 2. Text out of a file can't break the line, drive the terminal or
    fill it: what is not printable becomes a space, and what is longer than LONGEST is cut.
    """

    def __init__(self, text: str) -> None:
        line = "".join(one if one.isprintable() else " " for one in text[:LONGEST])
        super().__init__(line if len(text) <= LONGEST else f"{line} ...")


def warn(words: str) -> None:
    """Warn in one line, as if by the package: no line of a source is shown with it."""
    warnings.warn_explicit(words, RuntimeWarning, __name__.partition(".")[0], 1)


class UserErrors(UserError):
    """Several at once, such as all that is wrong with a file.

    lines: one for each, of which the command line makes a line of its own.
    """

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = tuple(str(UserError(line)) for line in dict.fromkeys(lines))
        super().__init__("; ".join(self.lines))


def lines_of(error: UserError) -> tuple[str, ...]:
    """What an error says, a line for each thing that is wrong."""
    return error.lines if isinstance(error, UserErrors) else (str(error),)


@contextmanager
def collected(problems: list[str], where: str = "") -> Iterator[None]:
    """Add the lines of an error to the problems, each with its place before it, and go on."""
    try:
        yield
    except UserError as error:
        problems += (f"{where}{line}" for line in lines_of(error))


def counted(count: int, noun: str) -> str:
    """A number with its noun: 1 record, 2 records."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def known(name: str, names: Iterable[str]) -> str:
    """End of a line that refuses a name: the known names, or of many the nearest ones."""
    found = list(names)
    near = get_close_matches(name, found) if len(found) > FEW else []
    return f"the nearest of {len(found)} are {', '.join(near)}" if near else f"known are {', '.join(found)}"


def shown(value: object) -> str:
    """An argument in a few words for an error, never a whole array."""
    if isinstance(value, int) and value.bit_length() > 64:
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, str | Path):
        return repr(str(value) if len(str(value)) <= WIDE else f"{str(value)[:WIDE]}...")
    if isinstance(value, int | float | None):
        return repr(value)
    if shape := getattr(value, "shape", ()):
        return f"an array of shape {shape}"
    return f"a {type(value).__name__}" + (f" of {len(value)}" if isinstance(value, list | tuple | dict) else "")


class Interrupted(Exception):
    """The user ended a command early (Ctrl-C). The text, in one line or "", says what is kept and how to go on.

    The command line prints it and exits with status 130, as shells do for SIGINT (128 + 2).
    """
