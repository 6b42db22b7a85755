"""Use of a guessed law: over a record in which inputs answer outputs it may be the inverse of that feedback."""

from __future__ import annotations

from typing import Any

from hybrid_sysid_ros.extensions.shared.granger_causality import leads
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array


def checked(model: Model, experiment: PreparedRecord, run: Array) -> dict[str, Any] | None:
    """Which inputs answer which outputs, a sentence, and why a run that fits is not yet good; None for a law that is no
    guess of rig from, and without feedback.
    """
    if not getattr(model.system, "provisional", False):
        return None
    means = experiment.inputs.reshape(experiment.samples - 1, -1, experiment.inputs.shape[1]).mean(axis=1)
    loops = [
        f"{item.name} answers {output.name}"
        for item, u in zip(model.system.inputs, means.T, strict=True)
        for output, y in zip(model.system.outputs, experiment.outputs[:-1].T, strict=True)
        if leads(y, u)
    ]
    if not loops:
        return None
    words = "the law is a guess of rig from, which may be the feedback's inverse, with the wrong sign"
    return {
        "feedback": loops,
        "sentence": f"doubt: {experiment.name}: {', '.join(loops)}, and {words}: write the physics in system.py, or "
        "record without the loop",
        "limits": words,
    }
