"""Further sections of a report, which extensions provide."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
