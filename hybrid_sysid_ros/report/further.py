"""Further sections of a report, which extensions provide."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from hybrid_sysid_ros.report.loop_section import ClosedLoopSection
from hybrid_sysid_ros.report.sections import IdentificationSection
from hybrid_sysid_ros.support import extensions


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


def further_sections(
    identification: IdentificationSection, closed_loop: ClosedLoopSection | None
) -> Iterator[tuple[str, FurtherSection]]:
    """Name and section of each extension that has one for this model and loop. A section that fails is replaced by the
    reason, so that the rest of a report does not depend on it.
    """
    for name, make in extensions.provided("report").items():
        try:
            made = make(identification, closed_loop)
        except Exception as error:  # another package's code can raise anything
            made = FurtherSection(title=name, text=f"This section could not be made: {type(error).__name__}: {error}")
        if made is not None:
            yield name, made
