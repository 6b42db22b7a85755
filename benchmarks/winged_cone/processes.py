"""Models in the exact MPC, flown by the nodes: physics alone, and with a network, fuzzy or fuzzy-neural rules."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.timed import Timed
from benchmarks.winged_cone.autopilot import STEPS
from benchmarks.winged_cone.control import fastest, mpc_of, problem_of
from benchmarks.winged_cone.hybrids import LINKED, NETWORK, RULES
from benchmarks.winged_cone.identification import SAMPLING
from hybrid_sysid_ros import bags
from hybrid_sysid_ros.identification import Part, identify
from hybrid_sysid_ros.models import Model, Options
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import controller_model
from hybrid_sysid_ros.runtime.recorded_loop import LoopRecord
from hybrid_sysid_ros.runtime.run import Run

BAG, PART = Path("bags/winged_cone_flight"), Part(start=1.0 / 6.0)
"""The shipped flight, without its first minute."""
CLOCKS = ("delay_ms", "feedback_ms", "converged_ms")
MODELS: Mapping[str, tuple[str, Options]] = {
    "physics": ("known_air_quasi_steady", {}),
    "physics + network": ("hybrid_known_air_quasi_steady", NETWORK),
    "physics + fuzzy rules": ("hybrid_known_air_quasi_steady", RULES),
    "physics + fuzzy-neural rules": ("hybrid_known_air_quasi_steady", LINKED),
    "physics with engine + fuzzy rules": ("hybrid_known_air", RULES),
}


def measured(rig: Rig) -> dict[str, Any]:
    """Each model identified from the flight, and flown once."""
    record = bags.read(BAG, rig.signals)
    return {
        name: flown(rig, identify([record], rig, structure, sampling=SAMPLING, part=PART, options=options))
        for name, (structure, options) in MODELS.items()
    }


def flown(rig: Rig, model: Model) -> dict[str, Any]:
    """Tracking errors and delays of a flight by processes, and how long one problem takes in flights without them."""
    with tempfile.TemporaryDirectory() as folder:
        model.save(Path(folder) / "model")
        outcome = Run(
            rig=rig.source,
            policy="exact",
            model=Path(folder) / "model",
            reference="manoeuvres",
            bag=Path(folder) / "bag",
            tell=lambda line: None,
        ).go()
        if outcome.interrupted or outcome.bag is None:
            raise KeyboardInterrupt
        loop = LoopRecord.from_bag(outcome.bag, rig)
    tracked = [k for k, item in enumerate(rig.system.outputs) if item.name in STEPS]
    errors = np.sqrt(np.nanmean((loop.outputs - loop.reference)[:, tracked] ** 2, axis=0))
    plant, controller = outcome.diagnostics["plant"], outcome.diagnostics["controller"]
    feedback, converged = (Timed(mpc_of(rig, model, real_time=real_time)) for real_time in (True, False))
    return {
        "substeps": problem_of(rig, controller_model(rig, model.system)).substeps,
        "tracking": {rig.system.outputs[k].name: float(error) for k, error in zip(tracked, errors, strict=True)},
        "measurements": plant["measurements"],
        "missed_commands": plant["missed_commands"],
        "by_exact": controller["layer_exact"],
        "times_resting": controller["times_resting"],
        "delay_ms": {key: plant[f"delay_ms_{key}"] for key in ("p50", "p99", "max")},
        "feedback_ms": fastest(rig, model, feedback, feedback.seconds)[0],
        "converged_ms": fastest(rig, model, converged, converged.seconds)[0],
    }


def table(found: Mapping[str, Any]) -> Table:
    """How they flew."""
    shown = Table("", "speed [m/s]", "height [m]", "missed", "rested", "delay [ms]", "feedback [ms]", "converged [ms]")
    for name, row in found.items():
        times = (" / ".join(f"{row[key][part]:.2f}" for part in ("p50", "p99")) for key in CLOCKS)
        tracked = (f"{row['tracking'][output]:.2f}" for output in ("speed", "height"))
        missed = f"{row['missed_commands']} of {row['measurements']}"
        shown.add_row(name, *tracked, missed, str(row["times_resting"]), *times)
    return shown
