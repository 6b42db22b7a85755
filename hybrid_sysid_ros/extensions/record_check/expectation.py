"""Expectation: what the rig's own physics make of a record's inputs."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import rollouts
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.shooting import fastest_growth
from hybrid_sysid_ros.identification.starts import initial_state
from hybrid_sysid_ros.models import Sampling
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

MOST_STEPS = 1_000_000
"""Most steps in which the rig is simulated over a record; longer records take longer steps than the rig's own."""
PUSH, UNSTABLE = 1e-6, 1e3
"""Share of a first state by which a second run begins elsewhere, and growth of the runs' distance that only an unstable
rig shows: a free run of such a rig says nothing of its record."""
FELL = 5.0
"""Motion in that of the record, from which a rig that is unstable at rest fell, and no loop held it."""


def expected_outputs(record: Record, rig: Rig, *, noisy: bool = False) -> Array | None:
    """What the rig's own physics make of the record's inputs, (samples, outputs); None where they grow beyond all
    numbers, forget where they began as an unstable rig does, or the record is too short. A rig with a stabiliser is
    unstable, even if a fall ends its growth. noisy: whether outputs are too noisy to show a rate at the beginning.
    """
    if rig.experiments.stabiliser is not None:
        return None
    period = record.sampling_time
    step = period / max(1, round(period / max(rig.step, record.duration / MOST_STEPS)))
    try:
        experiment = prepare(record, rig.system, Sampling(step=step, period=period))
    except UserError:
        return None
    starts = np.array([[0, 0, experiment.samples, 0]], dtype=np.int64)
    every = experiment.sampling.every

    def run(state: Array) -> Array:
        with np.errstate(all="ignore"):
            _, outputs = rollouts(rig.system, starts, state[None], experiment.inputs, step=step, every=every)
        return np.asarray(outputs).reshape(-1, record.output.shape[1])[: record.samples]

    searched = noisy or rig.system.record_map().unobserved
    first = initial_state(rig.system, experiment) if searched else experiment.states[0].copy()
    push = PUSH * np.maximum(np.abs(experiment.states).max(axis=0), PUSH)
    found, pushed = run(first), run(first + push)
    if not (np.isfinite(found).all() and np.isfinite(pushed).all() and len(found) == record.samples):
        return None
    fell = np.ptp(found, axis=0) > FELL * np.ptp(record.output, axis=0)
    if fell.any() and fastest_growth(rig.system) > 0.0:
        return None
    distance = np.abs(pushed - found).max(axis=1)
    return found if distance[-1] < UNSTABLE * max(distance[: max(len(distance) // 50, 2)].max(), 1e-300) else None


def is_guessed(rig: Rig) -> bool:
    """Whether the law is the one that rig from wrote, which nobody has replaced by the physics."""
    return bool(getattr(rig.system, "provisional", False))
