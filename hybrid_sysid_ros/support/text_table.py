"""Tables of plain text for ``print``."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(title: str, heading: Sequence[str], rows: Sequence[Sequence[str]], *, most: int, rest: str) -> str:
    """A title, a heading and at most ``most`` rows in fitting columns. rest: name of the object with the other rows."""
    shown = [list(heading), *map(list, rows[:most])]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in shown]
    hidden = len(rows) - most
    return "\n".join([title, *lines, *([f"and {hidden} more: {rest}"] if hidden > 0 else [])])
