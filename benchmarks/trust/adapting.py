"""``evaluate --adapt`` on the real records of the beam: what a bias of the first seconds is worth over the rest.

Needs HYBRID_SYSID_DATA, as the protocols do.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.input_bias.input_bias import adapt_model
from hybrid_sysid_ros.identification import Part, identify
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.validation.scores import free_run, scores_of_run
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.rigs.rig import load
from studies.beam_lecture import lecture

STRUCTURE = "gray"
"""That which training data choose in both protocols."""
SECONDS = (5.0, 20.0)
MOST_LOST, NEAR = 0.01, 0.02
"""What is asked: R2 that a record may lose, and distance from that of the best constant offset where a bias is held."""
FARTHEST = 0.1
"""Offsets among which the best one is looked for [V]."""


def measured() -> dict[str, Any]:
    """By protocol, seconds and record, R2 of the rest without and with the bias, and with the best constant one; empty
    without the records.
    """
    folder = os.environ.get(lecture.DATA)
    if not folder:
        return {}
    records, rig = lecture.read_folder(Path(folder), slow=False), load(lecture.RIG)
    spans = rig.limits[1] - rig.limits[0]
    rows = []
    for number in (1, 2):
        protocol = lecture.arrange(records, number)
        model = identify(protocol.training, rig, STRUCTURE, sampling=Sampling(), part=protocol.parts, refine=True)
        for record, part in protocol.tests:
            used = part.of(record, model.sampling)
            for seconds in SECONDS:
                found = adapt_model(model, used, seconds=seconds, spans=spans)
                rows.append(
                    {
                        "protocol": number, "record": record.name, "seconds": seconds, "reason": found.reason,
                        "estimated": float(found.estimated[0]), "deviation": float(found.deviation[0]),
                        "without": found.without.r2, "with": found.adapted.r2, "best": best_r2(model, used, seconds),
                    }
                )  # fmt: skip
    return summed(rows)


def summed(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The rows with how many hold a bias, the most that one loses, the largest distance of these from the best constant
    bias, and how many records are near that after the longest beginning.
    """
    held = [row for row in rows if not row["reason"]]
    return {
        "rows": rows,
        "held": len(held),
        "lost": max(row["without"] - row["with"] for row in rows),
        "missed": max((row["best"] - row["with"] for row in held), default=0.0),
        "near": sum(row["seconds"] == max(SECONDS) and row["best"] - row["with"] <= NEAR for row in rows),
    }


def best_r2(model: Model, record: Record, seconds: float) -> float:
    """R2 over the rest of a record under the constant offset that is best for it, which nobody knows beforehand."""
    part = Part(start=seconds / record.duration)

    def lost(offset: float) -> float:
        moved = replace(record, input=record.input + offset)
        experiment = experiment_of(model, moved, part=part)
        return 1.0 - scores_of_run(model.system, experiment, free_run(model.system, experiment)).r2

    grid = np.linspace(-FARTHEST, FARTHEST, 21)
    least = float(grid[int(np.argmin([lost(offset) for offset in grid.tolist()]))])
    found = minimize_scalar(lost, bounds=(least - 0.01, least + 0.01), method="bounded", options={"maxiter": 12})
    return 1.0 - float(found.fun)
