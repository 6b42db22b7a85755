"""The page of a film: positions that it shows, how it was put in a bag's time, and how its layers explain it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.extensions.shared.report.rendering import check_available, closed_content, drawn, write_page
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance
from hybrid_sysid_ros.extensions.vision.prediction.image_prediction import AHEAD, Judged, Summary
from hybrid_sysid_ros.extensions.vision.reading.film_quantity import film_quantities
from hybrid_sysid_ros.extensions.vision.reading.layers import PictureLayers
from hybrid_sysid_ros.extensions.vision.reading.video_record import VideoRecord, calibrated, contradictions
from hybrid_sysid_ros.report.loop_section import ClosedLoopSection

SHOWN = 4  # predicted pictures


def write_video(
    path: Path | str, record: VideoRecord, layers: PictureLayers, title: str, provenance: Provenance, *,
    ahead: Sequence[Judged] = (), loop: ClosedLoopSection | None = None,
) -> Path:  # fmt: skip
    """Write the page. ahead: pictures of the film that a model predicted. loop: one that a camera closed.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    from hybrid_sysid_ros.extensions.vision.report import video_figures as figures

    footage, known = record.footage, calibrated(layers, record)
    content = {
        "title": title,
        "rows": film_quantities(record),
        "remarks": [*footage.remarks(), *contradictions(record)],
        "positions": drawn(figures.positions(record), "positions"),
        "lamp": drawn(figures.lamp(record), "lamp") if np.isfinite(footage.lamp).any() else "",
        "pictures": [
            (time, reading, figures.overlaid(picture, reading, layers), figures.left(picture, reading, layers))
            for time, picture, reading in footage.shown
        ],
        "stretched": figures.STRETCHED,
        "ahead": [Summary.of(ahead, seconds) for seconds in AHEAD] if ahead else [],
        "foreseen": [
            (row, figures.expected(row.came, row, known), figures.banded(row.look.picture, row, known))
            for row in _shown(ahead)
        ],
        "closed": None if loop is None else closed_content(loop),
        "degrees": math.degrees,
        "provenance": provenance,
        "hashes": {**provenance.hashes, **({f"loop, {loop.loop.name}": loop.loop.digest} if loop else {})},
    }
    return write_page(path, Path(__file__).parent / "video.html", content)


def _shown(rows: Sequence[Judged]) -> list[Judged]:
    """A few of the predicted pictures: the farthest ones, from the best to the worst."""
    farthest = sorted((row for row in rows if row.look.ahead == max(AHEAD)), key=lambda row: -row.likeness)
    count = len(farthest)
    return [farthest[round(k * (count - 1) / max(SHOWN - 1, 1))] for k in range(min(SHOWN, count))]
