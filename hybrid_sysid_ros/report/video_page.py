"""The page of a film: positions that it shows, how it was put in a bag's time, and how its layers explain it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.report.rendering import TEMPLATES, check_available, drawn, write_page
from hybrid_sysid_ros.report.sections import Provenance
from hybrid_sysid_ros.runtime.video_record import VideoRecord, contradictions
from hybrid_sysid_ros.vision.layers import Layers


def write_video(path: Path | str, record: VideoRecord, layers: Layers, title: str, provenance: Provenance) -> Path:
    """Write the page.

    Raises:
        UserError: plotly or jinja2 is not installed, or the place cannot be written.
    """
    check_available()
    from hybrid_sysid_ros.report import video_figures as figures

    footage, found = record.footage, record.synchronisation
    finite = footage.deviations[np.isfinite(footage.deviations)]
    rows = [("pictures", float(len(footage.times)), math.nan, ""), ("rate", footage.rate, math.nan, "1/s")]
    if len(finite):
        rows.append(("standard deviation of an angle", math.degrees(float(np.median(finite))), math.nan, "°"))
    if record.onset is not None:
        rows.append(("lamp on, in the film's time", record.onset.time, record.onset.deviation, "s"))
    if found is not None:
        shift, rate, scale, offset = found.deviations.tolist()
        rows += [
            ("shift", found.shift, shift, "s"),
            ("rate", 1e6 * found.rate, 1e6 * rate, "ppm"),
            ("scale", found.scale, scale, ""),
            ("offset", math.degrees(found.offset), math.degrees(offset), "°"),
            ("camera less encoder, rms", math.degrees(found.residual), math.nan, "°"),
        ]
    content = {
        "title": title,
        "rows": rows,
        "remarks": [*footage.remarks(), *contradictions(record, None)],
        "positions": drawn(figures.positions(record), "positions"),
        "lamp": drawn(figures.lamp(record), "lamp") if np.isfinite(footage.lamp).all() else "",
        "pictures": [
            (time, reading, figures.overlaid(picture, reading, layers), figures.left(picture, reading, layers))
            for time, picture, reading in footage.shown
        ],
        "stretched": figures.STRETCHED,
        "degrees": math.degrees,
        "provenance": provenance,
        "hashes": provenance.hashes,
    }
    return write_page(path, TEMPLATES / "video.html", content)
