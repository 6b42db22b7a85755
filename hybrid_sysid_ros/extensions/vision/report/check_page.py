"""The page of a film's check: what the film lacks, and its picture, on which pivot, tip and marks are clicked."""

from __future__ import annotations

from pathlib import Path

from hybrid_sysid_ros.extensions.shared.report.rendering import check_available, write_page
from hybrid_sysid_ros.extensions.shared.report.sections import Provenance
from hybrid_sysid_ros.extensions.vision.reading.film_check import FilmCheck
from hybrid_sysid_ros.extensions.vision.scene import has_scene, scene_of, turning
from hybrid_sysid_ros.rigs.rig import Rig


def write_check(path: Path, check: FilmCheck, video: Path, rig: Rig, provenance: Provenance) -> Path:
    """Write the page. Raises UserError where plotly or jinja2 is not installed, or the place can't be written."""
    check_available()
    from hybrid_sysid_ros.extensions.vision.report import video_figures as figures

    (rows, columns), scene = check.picture.shape, scene_of(rig) if has_scene(rig) else None
    pivot = scene.pivot if scene is not None else (0.5, 0.5 * rows / columns)
    if check.pivot is not None:
        pivot = tuple(check.pivot.tolist())
    content = {
        "title": f"{rig.name}: {video.name}",
        "findings": check.findings,
        "picture": figures.checked(check),
        "rows": rows,
        "columns": columns,
        "joint": scene.joint if scene is not None else turning(rig)[0],
        "pivot": [place * columns for place in pivot],
        "video": str(video),
        "rig": rig.source,
        "provenance": provenance,
        "hashes": provenance.hashes,
    }
    return write_page(path, Path(__file__).parent / "check.html", content)
