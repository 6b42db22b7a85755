"""Tables of plain text, as ``print`` shows them."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(title: str, heading: Sequence[str], rows: Sequence[Sequence[str]], *, most: int, rest: str) -> str:
    """A title, a heading and ``most`` rows in columns as wide as they need. rest: what holds the others."""
    shown = [list(heading), *map(list, rows[:most])]
    widths = [max(map(len, column)) for column in zip(*shown, strict=True)]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in shown]
    hidden = len(rows) - most
    return "\n".join([title, *lines, *([f"and {hidden} more: {rest}"] if hidden > 0 else [])])
