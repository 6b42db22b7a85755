"""Coding: what a codec's quantiser leaves out of a joint's angle, by films of H.264 whose angles are known."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.camera.footage import Case, Shots, motion_of, shots, steady
from benchmarks.result import spread
from hybrid_sysid_ros.extensions.vision.camera.film import pictures, write_film
from hybrid_sysid_ros.extensions.vision.camera.imager import Camera
from hybrid_sysid_ros.extensions.vision.camera.quantisation import quantiser_steps
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.learning import learn
from hybrid_sysid_ros.rigs.rig import Rig

CASE = Case(name="480x270", camera=Camera(width=480, height=270))
SECONDS, SEEDS, CRFS = 8.0, (1, 2, 3), (20, 26, 32, 38, 44, 50)


def left_out(seen: Shots, reader: AngleReader, crf: int) -> dict[str, float]:
    """Error of angles and their own deviation, medians of the pictures [degrees], step of the quantiser [counts], and
    share of the step by which edges are off: what the error has beyond the own deviation.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        write_film(path, zip(seen.times - seen.times[0], seen.film, strict=True), rate=CASE.camera.rate, crf=crf)
        steps = quantiser_steps(path)
        readings = [reader.read(picture) for _, picture in pictures(path)]
    error = np.array([reading.angle for reading in readings]) - seen.truth(np.array([row.row for row in readings]))
    rmse = float(np.sqrt(np.mean((error - error.mean()) ** 2)))
    own = float(np.sqrt(np.median([reading.deviation**2 for reading in readings])))
    per_step = float(np.median(steps * [reading.per_count for reading in readings]))
    return {
        "rmse": float(np.degrees(rmse)),
        "own": float(np.degrees(own)),
        "step": float(np.median(steps)),
        "share": float(np.sqrt(max(rmse**2 - own**2, 0.0)) / per_step),
    }


def measured(rig: Rig) -> dict[str, Any]:
    """Each quality of H.264, mean and range over seeds; layers are those of a film without a codec."""
    films = [shots(rig, motion_of(rig, seed=seed, seconds=SECONDS), CASE, seed=seed) for seed in SEEDS]
    reader = AngleReader(learn(steady(films[0].film, 120), rig, readout=CASE.camera.readout)[0])
    found: dict[str, Any] = {}
    for crf in CRFS:
        rows = [left_out(seen, reader, crf) for seen in films]
        found[f"crf {crf}"] = {key: spread([row[key] for row in rows]) for key in rows[0]}
        print(f"  crf {crf}: {found[f'crf {crf}']['share']}", flush=True)
    return found


def table(found: dict[str, Any]) -> Table:
    """Of all qualities."""
    shown = Table("H.264", "RMSE [degrees]", "own deviation", "step [counts]", "left out, of a step", title="coding")
    for name, row in found.items():
        cells = (f"{row[key]['mean']:.4f} ({row[key]['min']:.4f} to {row[key]['max']:.4f})" for key in ("rmse", "own"))
        share = f"{row['share']['mean']:.3f} ({row['share']['min']:.3f} to {row['share']['max']:.3f})"
        shown.add_row(name, *cells, f"{row['step']['mean']:.0f}", share)
    return shown
