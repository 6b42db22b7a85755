"""Protocol 2 on the real records: free-run R2 of each structure on unseen parts, and the time of its fit.

Train on the first halves of multisine and random steps, test on their second halves and the swept sine. Networks: mean
and range over three seeds. Needs HYBRID_SYSID_DATA; see docs/bags.md.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.demo import DATA, FIRST_HALF, RIG, find_records, table_name
from hybrid_sysid_ros.identification import evaluate, identify
from hybrid_sysid_ros.models import STRUCTURES, InputHandling, Sampling
from hybrid_sysid_ros.rigs.rig import load

NAME = "identification"
SEEDS = (0, 1, 2)
LEARNED = ("black_box", "hybrid")
PUBLISHED = {
    "linear": (0.4025, 0.6423, 0.7822, 0.7475, 0.5875, 0.5626, 0.8679),
    "stribeck": (0.5382, 0.4376, 0.4586, 0.4344, 0.2880, 0.2520, 0.6116),
    "black_box": (-3.9730, -1.9576, 0.5234, 0.5843, 0.4914, 0.6467, 0.8299),
    "hybrid": (0.9122, 0.8645, 0.9318, 0.7863, 0.6329, 0.8895, 0.9532),
}
"""R2 of the lecture's table, order ms_05 ms_06 rs_01 rs_02 rs_03 rs_04 swept; hybrid is its hybrid-joint."""


def main() -> int:
    """Run, print a table, write the results."""
    if not os.environ.get(DATA):
        print(f"skipped: {DATA} is not set, and the benchmark is about the real records", file=sys.stderr)
        return 0
    machine = result.machine()
    console = Console()
    with tempfile.TemporaryDirectory() as folder:
        records = find_records(Path(folder), console)
    rig = load(RIG)
    names = [table_name(record.name) for record, _ in records.unseen]
    shown = Table("structure", "input", *names, "fit", title="free-run R2, protocol 2", title_justify="left")
    results: dict[str, Any] = {}
    handlings: tuple[InputHandling, ...] = ("averaged", "sampled")
    for structure in STRUCTURES:
        if structure in PUBLISHED:
            shown.add_row(structure, "published", *(f"{value:.3f}" for value in PUBLISHED[structure]), "")
        for handling in handlings:
            runs, seconds = [], []
            for seed in SEEDS if structure in LEARNED else SEEDS[:1]:
                model = identify(
                    records.training, rig, structure, sampling=Sampling(input=handling), part=FIRST_HALF, seed=seed
                )
                runs.append([evaluate(model, record, part=part).r2 for record, part in records.unseen])
                seconds.append(model.fit["seconds"])
            table = np.array(runs)
            results[f"{structure}.{handling}"] = {
                "seconds": seconds,
                "r2": {
                    name: {"mean": float(column.mean()), "min": float(column.min()), "max": float(column.max())}
                    for name, column in zip(names, table.T, strict=True)
                },
            }
            cells = (
                f"{c.mean():.3f}" if len(c) == 1 else f"{c.mean():.3f} ({c.min():.3f}-{c.max():.3f})" for c in table.T
            )
            shown.add_row(structure, handling, *cells, f"{max(seconds):.1f} s")
    Console(width=200).print(shown)
    print(result.write(NAME, results, on=machine))
    return 0


if __name__ == "__main__":
    result.run(main)
