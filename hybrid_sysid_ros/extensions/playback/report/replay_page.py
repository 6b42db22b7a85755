"""The page of a replay: what was recorded, and what the same nodes answer to it today."""

from __future__ import annotations

from pathlib import Path

from hybrid_sysid_ros.extensions.playback.comparison import AHEAD, SETTLED, ReplayComparison
from hybrid_sysid_ros.extensions.shared.report.rendering import check_available, drawn, write_page
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance


def write_replay(
    path: Path | str, comparison: ReplayComparison, title: str, summary: str, provenance: Provenance
) -> Path:
    """Write the page. summary: what was replayed, in a sentence.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    from hybrid_sysid_ros.extensions.playback.report import replay_figures

    shown = [number for number in comparison.numbers if f"{AHEAD}]" not in number.field]
    content = {
        "title": title,
        "summary": summary,
        "settled": f"{SETTLED:g}",
        "comparison": comparison,
        "figures": [
            (number, drawn(replay_figures.both(number), f"number-{index}")) for index, number in enumerate(shown)
        ],
        "provenance": provenance,
        "hashes": provenance.hashes,
    }
    return write_page(path, Path(__file__).parent / "replay.html", content)
