"""What extensions find of a model, as a section with a table and as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class FurtherSection:
    """A section that an extension adds: a heading, a paragraph, a table and figures, each if there is one."""

    title: str
    text: str = ""
    headings: Sequence[str] = ()
    rows: Sequence[Sequence[object]] = ()
    """Rows of the table."""
    figures: Sequence[Any] = ()
    """Plotly figures."""


@dataclass(frozen=True, kw_only=True)
class Inspection:
    """What an extension finds of a model over records, for which it adds an option to a command."""

    name: str
    """The key of its content."""
    section: FurtherSection
    """Its section of a report, whose table the command prints, too."""
    content: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Plain data by record."""
