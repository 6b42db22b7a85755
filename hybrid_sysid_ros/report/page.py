"""The report's page: a model, its free runs, and the loop that it runs in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hybrid_sysid_ros.report.rendering import TEMPLATES, check_available, drawn, identification_content, write_page
from hybrid_sysid_ros.report.sections import ClosedLoopSection, IdentificationSection, Provenance


def write(
    path: Path | str,
    identification: IdentificationSection,
    closed_loop: ClosedLoopSection | None,
    provenance: Provenance,
) -> Path:
    """Write the report; an older one is replaced once the new one is whole.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    content = {
        "title": f"{identification.model.rig}: {identification.model.structure} model",
        "part": identification_content(identification),
        "closed": None if closed_loop is None else _closed(closed_loop),
        "provenance": provenance,
        "hashes": _hashes(identification, closed_loop, provenance),
    }
    return write_page(path, TEMPLATES / "page.html", content)


def _closed(section: ClosedLoopSection) -> dict[str, Any]:
    from hybrid_sysid_ros.report import loop_figures

    loop = section.loop
    return {
        "section": section,
        "rmse": section.rmse,
        "units": section.units,
        "tracking": drawn(loop_figures.tracking(section), "tracking"),
        "zooms": {
            name: drawn(loop_figures.zoom(section, name), f"zoom-{number}") for number, name in enumerate(section.zooms)
        },
        "delays": drawn(loop_figures.delays(section), "delays"),
        "timing": loop.delays() if loop.is_real_time else loop.turnarounds(),
    }


def _hashes(
    identification: IdentificationSection, closed_loop: ClosedLoopSection | None, provenance: Provenance
) -> dict[str, str]:
    """SHA-256 of everything that the report rests on, by name."""
    found = dict(provenance.hashes)
    found.update({f"record, {run.record}": run.digest for run in identification.runs})
    if closed_loop is not None:
        found[f"loop, {closed_loop.loop.name}"] = closed_loop.loop.digest
    return {name: digest for name, digest in found.items() if digest}
