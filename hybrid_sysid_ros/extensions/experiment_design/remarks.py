"""What records can show before any fit: parameters by their sensitivities, motions that occur, and feedback."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.core import Sensitivities
from hybrid_sysid_ros.extensions.experiment_design.information import LEAST_KNOWN, Fisher
from hybrid_sysid_ros.extensions.shared.granger_causality import feedbacks_of
from hybrid_sysid_ros.identification.experiment import prepare
from hybrid_sysid_ros.identification.validation.identifiability import correlated
from hybrid_sysid_ros.library.arguments import given_sampling
from hybrid_sysid_ros.models.fit import PreparedRecord
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.errors import UserError

POOR = 0.3
"""Deviation of a parameter in its size, or share of its prior's, from which records hardly show it."""
QUIET = 1e-3
"""Noise in an output's deviation where no sensor declares more."""
FASTEST, RESTING, RARE = 99.0, 0.02, 0.05
"""Percentile of a rate's size that is its largest value, share of that below which a state rests, and share of the time
below which a motion is rare: a short burst makes no rest of all the other motions."""


def remarks_of(records: Sequence[Record], rig: Rig) -> list[str]:
    """Lines for the user; none where the rig's own law can't be simulated over the records."""
    try:
        sampling = given_sampling(None, rig, records)
        experiments = [prepare(record, rig.system, sampling) for record in records]
    except UserError:
        return []
    unstable = rig.experiments.stabiliser is not None
    return [*([] if unstable else _parameters(experiments, rig)), *_motions(experiments, rig), *_feedback(records, rig)]


def _parameters(experiments: Sequence[PreparedRecord], rig: Rig) -> Iterator[str]:
    """Which parameters the records show, by the rig's own law and the noise of its sensors."""
    free = [(k, item) for k, item in enumerate(rig.system.parameters) if not item.fixed]
    if not free:
        return
    names, values = [item.name for _, item in free], rig.system.named
    sizes = np.array([max(abs(values[item.name]), item.scale) for _, item in free])
    spread = np.std(np.concatenate([item.outputs for item in experiments]), axis=0)
    floor = np.array([abs(sensor.scale) * sensor.floor for sensor in rig.sensors])
    fisher = Fisher(
        sensitivities=Sensitivities(rig.system, parameters=[k for k, _ in free], states=[]),
        sampling=experiments[0].sampling, sizes=sizes,
        weight=1.0 / np.maximum(np.maximum(floor, QUIET * spread), 1e-300) ** 2,
    )  # fmt: skip
    total = sum(fisher.information(rig.system, item.inputs, item.states[0]) for item in experiments)
    covariance = np.asarray(np.linalg.inv(np.asarray(total) + np.eye(len(free)) / LEAST_KNOWN**2), dtype=np.float64)
    deviations = np.sqrt(np.diag(covariance))
    limits = [
        min(POOR, POOR * item.spread / size) if item.spread else POOR
        for (_, item), size in zip(free, sizes.tolist(), strict=True)
    ]
    poor = [name for name, value, most in zip(names, deviations, limits, strict=True) if value > most]
    shown = ", ".join(f"{name} {value:.2g}" for name, value in zip(names, deviations, strict=True) if name not in poor)
    together = "together " if len(experiments) > 1 else ""
    if poor:
        yield f"these records {together}hardly show {', '.join(poor)}: other experiments would (hybrid-sysid design)"
    if shown:
        yield f"relative deviations of parameters by sensor noise alone: {shown}; errors of the law add to them"
    for one, other, value in correlated(names, covariance):
        if one in poor or other in poor:
            yield f"{one} and {other} can hardly be told apart (correlation {value:+.2f})"


def _motions(experiments: Sequence[PreparedRecord], rig: Rig) -> Iterator[str]:
    """Directions and rests of each rate that hardly occur."""
    for position, rate in rig.system.kinematics.items():
        values = np.concatenate([item.states[:, rate] for item in experiments])
        most = float(np.percentile(np.abs(values), FASTEST))
        shares = {
            "upwards": float(np.mean(values > RESTING * most)),
            "downwards": float(np.mean(values < -RESTING * most)),
        }
        name = rig.system.states[position].name
        missing = [f"{word} ({share:.0%})" for word, share in shares.items() if share < RARE]
        if most > 0.0 and missing:
            yield f"{name} hardly moves {' or '.join(missing)}: a model of this is not trained there"


def _feedback(records: Sequence[Record], rig: Rig) -> Iterator[str]:
    """Inputs that answer outputs."""
    found = {words for record in records for words in feedbacks_of(record, rig)}
    if found:
        yield (
            f"closed loop: {', '.join(sorted(found))}; the noise of the outputs is in the inputs, too (or an input's "
            "sensor is noisier than an output, which then shows it better)"
        )
