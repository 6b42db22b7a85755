"""The page of checked records: faults, signals over time, spectra and coherence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding, sentence
from hybrid_sysid_ros.extensions.shared.report.rendering import check_available, drawn, write_page
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance
from hybrid_sysid_ros.rigs.rig import Rig


def write_record_page(
    path: Path, rig: Rig, records: Sequence[Record], found: Mapping[str, list[RecordFinding]], provenance: Provenance
) -> Path:
    """Write the page. found: findings by the names of the records.

    Raises UserError where plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    from hybrid_sysid_ros.extensions.record_check.report import record_figures

    shown = []
    for number, record in enumerate(records):
        figures = [
            ("signals, and what the rig's physics make of the inputs", record_figures.signals_over_time(record, rig)),
            ("spectra, each over its largest value, and coherence", record_figures.spectra(record, rig)),
        ]
        shown.append(
            {
                "anchor": f"record-{number}",
                "name": record.name,
                "sentence": sentence(found[record.name]),
                "findings": found[record.name],
                "figures": [(title, drawn(one, f"figure-{number}-{k}")) for k, (title, one) in enumerate(figures)],
            }
        )
    content = {
        "title": f"{rig.name}: {', '.join(record.name for record in records)}",
        "records": shown, "provenance": provenance, "hashes": provenance.hashes,
    }  # fmt: skip
    return write_page(path, Path(__file__).parent / "record.html", content)
