"""The page of a tuning: its trials, the front, and what the best one is on unseen loops."""

from __future__ import annotations

from pathlib import Path

from hybrid_sysid_ros.extensions.shared.report.rendering import check_available, drawn, write_page
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance
from hybrid_sysid_ros.extensions.tuning import tuning
from hybrid_sysid_ros.extensions.tuning.front import front_of
from hybrid_sysid_ros.extensions.tuning.loops import Loops
from hybrid_sysid_ros.extensions.tuning.tuning import Tuned


def write_front(path: Path, loops: Loops, tuned: Tuned, provenance: Provenance) -> Path:
    """Write the page. Raises UserError where plotly or jinja2 is not installed, or the place cannot be written."""
    check_available()
    from hybrid_sysid_ros.extensions.tuning.report import front_figures

    front = front_of(tuned.trials)
    return write_page(
        path,
        Path(__file__).parent / "front.html",
        {
            "title": f"Tuning of {loops.rig.name}",
            "summary": f"{tuned.sentence[0].upper()}{tuned.sentence[1:]}.",
            "found": tuning.content(loops, tuned),
            "provenance": provenance,
            "hashes": provenance.hashes,
            "names": list(tuned.best.options),
            "front": front,
            "best": tuned.best,
            "figure": drawn(front_figures.front(tuned.trials, front, tuned.best), "front"),
            "varied": drawn(front_figures.varied(tuned.trials, front), "varied"),
        },
    )
