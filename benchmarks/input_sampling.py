"""What reading the input once a sample costs: the same model on the same records, its input averaged and sampled.

The gray box is fitted to each record alone with averaged input, then simulated over that record with averaged and with
sampled input, which isolates the input; and fitted once more with sampled input. Needs HYBRID_SYSID_DATA; see
docs/guides/bags.md.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.commands.terminal import print_table
from hybrid_sysid_ros.identification import free_run, identify, prepare, score
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import load
from studies.beam_lecture import lecture
from studies.beam_lecture.lecture import DATA

NAME = "input_sampling"
AVERAGED, SAMPLED = Sampling(), Sampling(input="sampled")


def main() -> int:
    """Run, print a table, write the results."""
    if not os.environ.get(DATA):
        print(f"skipped: {DATA} is not set, and the benchmark is about the real records", file=sys.stderr)
        return 0
    machine = result.machine()
    rig = load(lecture.RIG)
    columns = ("lost input, rms [V]", "R2 averaged", "same model, sampled", "fitted to sampled")
    shown = Table("record", *columns, title="free run over each record, gray box fitted to it")
    results: dict[str, Any] = {}
    for record in lecture.read_folder(Path(os.environ[DATA])):
        averaged, sampled = (identify([record], rig, "gray", sampling=handling) for handling in (AVERAGED, SAMPLED))
        row = (
            lost_input(record),
            r2(averaged, record, AVERAGED),
            r2(averaged, record, SAMPLED),
            r2(sampled, record, SAMPLED),
        )
        results[lecture.table_name(record.name)] = dict(zip(columns, row, strict=True))
        shown.add_row(lecture.table_name(record.name), f"{row[0]:.2f}", *(f"{value:.3f}" for value in row[1:]))
    print_table(shown)
    print(result.write(NAME, results, on=machine))
    return 0


def lost_input(record: Record) -> float:
    """Root mean square of the input's mean over each 50 ms less its value at their beginning [V]."""
    every = round(AVERAGED.period / record.sampling_time)
    blocks = record.input[: len(record.input) // every * every, 0].reshape(-1, every)
    return float(np.sqrt(np.mean((blocks.mean(axis=1) - blocks[:, 0]) ** 2)))


def r2(model: Model, record: Record, sampling: Sampling) -> float:
    """Of the free run under one handling of the input."""
    experiment = prepare(record, model.system, sampling)
    return score(experiment.outputs[:, 0], free_run(model.system, experiment)[:, 0]).r2


if __name__ == "__main__":
    result.run(main)
