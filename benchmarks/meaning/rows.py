"""Rows: what was asked, and what was measured."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """One thing that was asked: a number that is to be reached, or not to be exceeded."""

    name: str
    asked: float
    measured: float
    at_most: bool = False

    @property
    def short(self) -> bool:
        """Whether it falls short; so does what is no number."""
        return not (self.measured <= self.asked if self.at_most else self.measured >= self.asked)
