"""Bands of free runs over the real records of the beam: what they hold of what no fit saw, and how wide they are.

Needs HYBRID_SYSID_DATA, as the protocols do.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.horizon_bands.horizon_bands import horizon_bands
from hybrid_sysid_ros.extensions.loop_bands.loop_bands import loop_bands
from hybrid_sysid_ros.identification import Part, free_run, identify
from hybrid_sysid_ros.identification.identify import experiment_of
from hybrid_sysid_ros.identification.validation.bands import bands_of
from hybrid_sysid_ros.models import Model, Sampling
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.rigs.rig import Rig, load
from studies.beam_lecture import lecture

STRUCTURE = "gray"
"""That which training data choose in both protocols."""
WITHIN, LEAST, WIDEST, SLOWEST = (0.85, 0.95), 0.7, 1.3, 5.0
"""Share of all samples that bands of 90 % are to hold, of those of a record, most width in that of the narrowest band
of constant width which holds as much, and most time in free runs.
"""
REPEATED = 20


def measured() -> dict[str, Any]:
    """By protocol and record, the shares that bands hold, half of their mean width beside that of the narrowest of
    constant width, and the run's mean error [m]; empty without the records.
    """
    folder = os.environ.get(lecture.DATA)
    if not folder:
        return {}
    records, rig = lecture.read_folder(Path(folder), slow=False), load(lecture.RIG)
    found: dict[str, dict[str, dict[str, float]]] = {}
    ratios = []
    for number in (1, 2):
        protocol = lecture.arrange(records, number)
        model = identify(protocol.training, rig, STRUCTURE, sampling=Sampling(), part=protocol.parts, refine=True)
        found[f"protocol {number}"] = {}
        for record, part in protocol.tests:
            experiment = experiment_of(model, record, part=part)
            half, wide = bands_of(model, experiment)
            errors = (experiment.outputs - wide.run)[experiment.scored]
            held = float(wide.held(experiment.outputs, experiment.scored)[0])
            found[f"protocol {number}"][record.name] = {
                "held_50": float(half.held(experiment.outputs, experiment.scored)[0]),
                "held_90": held,
                "half_width": float(wide.half[experiment.scored].mean()),
                "narrowest": float(np.quantile(np.abs(errors), 0.9)),
                "mean_error": float(errors.mean()),
                **_ahead(model, experiment),
                **_loop(model, record, rig, part),
            }
            begun = time.perf_counter()
            for _ in range(REPEATED):
                bands_of(model, experiment)
            middle = time.perf_counter()
            for _ in range(REPEATED):
                free_run(model.system, experiment)
            ratios.append((middle - begun) / (time.perf_counter() - middle))
    rows = [row for part in found.values() for row in part.values()]
    return {
        "records": found,
        "held_90": float(np.mean([row["held_90"] for row in rows])),
        "held_50": float(np.mean([row["held_50"] for row in rows])),
        "least": min(row["held_90"] for row in rows),
        "width": float(np.mean([row["half_width"] for row in rows]) / np.mean([row["narrowest"] for row in rows])),
        "free_runs": float(np.median(ratios)),
        "ahead_90": float(np.mean([row["ahead_90"] for row in rows])),
        "ahead_50": float(np.mean([row["ahead_50"] for row in rows])),
        "ahead_least": min(row["ahead_90"] for row in rows),
        "ahead_width": float(np.mean([row["ahead_width"] for row in rows])),
        "loop_90": float(np.mean([row["loop_90"] for row in rows])),
        "loop_50": float(np.mean([row["loop_50"] for row in rows])),
        "loop_least": min(row["loop_90"] for row in rows),
        "loop_width": sum(row["loop_half"] for row in rows) / sum(row["loop_narrowest"] for row in rows),
    }


def _loop(model: Model, record: Record, rig: Rig, part: Part) -> dict[str, float]:
    """Of the loop that is done again, the shares that bands hold, half of their mean width, and the narrowest."""
    found = loop_bands(model, record, rig, part=part)
    assert found is not None
    return {
        "loop_50": found.held[0.5],
        "loop_90": found.held[0.9],
        "loop_half": float(found.halves[0.9].mean()),
        "loop_narrowest": float(np.quantile(np.abs(found.measured - found.forecast), 0.9)),
    }


def _ahead(model: Model, experiment: PreparedRecord) -> dict[str, float]:
    """Shares of the predictions over all horizons that bands hold, and the mean width in that of the narrowest."""
    found = horizon_bands(model, experiment)
    assert found is not None
    narrowest = np.quantile(np.abs(found.errors), 0.9, axis=0)
    return {
        "ahead_50": float(found.held[0.5].mean()),
        "ahead_90": float(found.held[0.9].mean()),
        "ahead_width": float(np.mean(found.halves[0.9] / narrowest)),
    }
