"""A folder with a designed experiment: signals.csv, which plays it, and design.yaml, which says what it is for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hybrid_sysid_ros.extensions.experiment_design.design import Design
from hybrid_sysid_ros.rigs.signal_file import driving_columns, output_columns, write_signals
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.files import written_folder

SHEET, SIGNALS = "design.yaml", "signals.csv"


def save_plan(folder: Path, design: Design) -> None:
    """Write the folder beside its place, then rename. Raises UserError where it can't be written."""
    with written_folder(folder, marker=SHEET) as partial:
        write_signals(partial / SIGNALS, *_columns(design))
        (partial / SHEET).write_text(yaml.safe_dump(content(design), sort_keys=False), encoding="utf-8")


def content(design: Design) -> dict[str, Any]:
    """What an experiment is, and what it will tell, as plain data."""
    bench = design.bench
    cells = {} if design.visits is None else dict(zip(("visited", "new", "all"), design.visits, strict=True))
    middle, half = bench.spans
    return {
        "rig": bench.rig.name,
        "seconds": bench.seconds,
        "rate": round(1.0 / bench.period, 6),
        **({"cells": cells} if cells else {}),
        "deviations": {
            name: {"now": float(now), "expected": float(then)}
            for name, now, then in zip(design.names, design.before.tolist(), design.after.tolist(), strict=True)
            if not name.startswith("weight_")
        },
        "drives": {
            name: {
                "middle": float(middle[k]), "half": float(half[k]),
                "segments": [
                    {"start": round(number * bench.length, 6), **item.content} for number, item in enumerate(row)
                ],
            }
            for k, ((name, _), row) in enumerate(zip(driving_columns(bench.rig), design.plan, strict=True))
        },
    }  # fmt: skip


def _columns(design: Design) -> tuple[Array, dict[tuple[str, str], Array]]:
    """Times, and what drives, the inputs and the outputs by the model, in the units in which they are shown."""
    bench, rig = design.bench, design.bench.rig
    times = np.arange(round(bench.seconds / bench.period) + 1, dtype=np.float64) * bench.period
    steps = np.minimum(np.round(times / bench.sampling.step).astype(int), len(design.driving))
    held = np.minimum(steps, len(design.driving) - 1)
    found: dict[tuple[str, str], Array] = {}
    for k, column in enumerate(driving_columns(rig)):
        loop = rig.experiments.loops.get(k)
        found[column] = design.driving[held, k] / (rig.sensors[loop.output].scale if loop else 1.0)
        if loop:
            found[rig.system.inputs[k].name, rig.system.inputs[k].unit] = design.inputs[held, k]
    for k, column in enumerate(output_columns(rig)):
        found[column] = rig.display[k].shown(design.outputs[steps, k])
    return times, found
