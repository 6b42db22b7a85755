"""The page that a command writes of a model and its free runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import typed
from hybrid_sysid_ros.extensions.shared import report
from hybrid_sysid_ros.identification import Part
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.report import Inspection
from hybrid_sysid_ros.support.files import check_file


class ModelPage:
    """A page at a path. Raises UserError at once where plotly or jinja2 is not installed, or the place is no page's."""

    def __init__(self, path: Path) -> None:
        report.check_available()
        check_file(path, suffix=".html")
        self.path = path

    def write(
        self, model: Model, records: Sequence[tuple[Record, Part]], inspections: Sequence[Inspection] = ()
    ) -> None:
        """Write free runs of a model over parts of records, and what extensions found of it."""
        section = report.identification_section(model, records)
        report.write_report(self.path, section, None, report.provenance(model, typed()), inspections=inspections)
