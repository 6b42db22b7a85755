"""The page of frequency responses: gain, phase and coherence of each output by each input."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hybrid_sysid_ros.extensions.frequency_response.comparison import ResponseComparison, response_sentence
from hybrid_sysid_ros.extensions.shared.report.rendering import drawn, write_page
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance
from hybrid_sysid_ros.models import Model


def write_page_of(path: Path, model: Model, found: Sequence[ResponseComparison], provenance: Provenance) -> Path:
    """Write the page. Raises UserError where plotly or jinja2 is not installed, or the place can't be written."""
    from hybrid_sysid_ros.extensions.frequency_response.report.figures import bode

    system, shown = model.system, []
    channels = [(k, j) for k in range(len(system.outputs)) for j in range(len(system.inputs))]
    for number, item in enumerate(found):
        figures = [
            (response_sentence(item, system, k, j), drawn(bode(item, system, k, j), f"figure-{number}-{k}-{j}"))
            for k, j in channels
        ]
        shown.append({"anchor": f"record-{number}", "name": item.name, "figures": figures})
    content = {
        "title": f"{model.rig}: frequency responses", "records": shown, "provenance": provenance,
        "hashes": provenance.hashes,
    }  # fmt: skip
    return write_page(path, Path(__file__).parent / "page.html", content)
