"""Angles read out of pictures against the truth: error, losses and speed in sound and spoilt footage."""

from __future__ import annotations

from time import process_time
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.camera.footage import CASES, Case, motion_of, shots, steady
from benchmarks.result import spread
from hybrid_sysid_ros.extensions.vision.reading.angle_reader import AngleReader
from hybrid_sysid_ros.extensions.vision.reading.footage import LEARNED_FROM
from hybrid_sysid_ros.extensions.vision.reading.learning import learn
from hybrid_sysid_ros.rigs.rig import Rig

SEEDS = (1, 2, 3)
ASKED = {"nominal": 0.006, "H.264 crf 32": 0.05}  # degrees RMSE; every other case .02
ASKED_OTHERS = 0.02


def of_case(rig: Rig, case: Case, seed: int) -> dict[str, float]:
    """Error [degrees], its deviation as the reader has it, share lost, time of the layers [s] and pictures a second,
    both in CPU time. The zero is a gauge: the mean error is taken out.
    """
    seen = shots(rig, motion_of(rig, seed=seed), case, seed=seed)
    film = steady(seen.film, LEARNED_FROM)
    began = process_time()
    layers, _ = learn(film, rig, readout=case.camera.readout)
    learned = process_time() - began
    reader = AngleReader(layers)
    reader.read(seen.film[0])
    began = process_time()
    readings = [reader.read(picture) for picture in seen.film]
    rate = len(readings) / (process_time() - began)
    found = np.array([reading.found for reading in readings])
    rows = np.array([reading.row if reading.found else 0.0 for reading in readings])
    error = np.array([reading.angle for reading in readings]) - seen.truth(rows)
    error = np.degrees(error[found] - np.mean(error[found]))
    reported = np.degrees([reading.deviation for reading in readings if reading.found])
    return {
        "rmse": float(np.sqrt(np.mean(error**2))),
        "worst": float(np.abs(error).max()),
        "told": float(np.sqrt(np.mean(reported**2))),
        "lost": float(1.0 - found.mean()),
        "layers_seconds": learned,
        "pictures_per_second": rate,
    }


def measured(rig: Rig, cases: tuple[Case, ...] = CASES, seeds: tuple[int, ...] = SEEDS) -> dict[str, Any]:
    """Every case, mean and range over seeds."""
    of_case(rig, cases[0], 0)  # compiles
    found: dict[str, Any] = {}
    for case in cases:
        rows = [of_case(rig, case, seed) for seed in (seeds if case.camera.width < 1000 else seeds[:1])]
        found[case.name] = {key: spread([row[key] for row in rows]) for key in rows[0]}
        print(f"  {case.name}: {found[case.name]['rmse']['mean']:.4f} degrees", flush=True)
    return found


def table(found: dict[str, Any]) -> Table:
    """Of all cases."""
    shown = Table("case", "RMSE [degrees]", "asked", "told", "lost", "layers [s]", "pictures/s", title="angles")
    for name, row in found.items():
        error = row["rmse"]
        shown.add_row(
            name,
            f"{error['mean']:.4f} ({error['min']:.4f} to {error['max']:.4f})",
            f"{ASKED.get(name, ASKED_OTHERS):g}",
            f"{row['told']['mean']:.4f}",
            f"{row['lost']['max']:.1%}",
            f"{row['layers_seconds']['mean']:.1f}",
            f"{row['pictures_per_second']['mean']:.0f}",
        )
    return shown
