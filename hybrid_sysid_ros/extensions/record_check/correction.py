"""Correction: an output turned round or scaled back, beside what the rig's physics make of the record then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.alignment import BEYOND, CLEAR, best_alignment, time_of_change
from hybrid_sysid_ros.extensions.record_check.changes import LEFT
from hybrid_sysid_ros.extensions.record_check.expectation import expected_outputs
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal, noise_rms
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array

ALIKE = 2.0
"""Ratio within which the scales of a signal's noise and of its motion are the same."""
OFFSET = 0.01
"""Of inputs, in how far they move."""
PERIODS = 8
"""Longest delay, in times of a change."""


def is_turned(record: Record, rig: Rig, k: int, expected: Array) -> bool:
    """Whether output k turned round follows the physics far better: where these integrate, a first rate of the wrong
    sign alone makes another motion of it.
    """
    output = record.output.copy()
    output[:, k] *= -1.0
    turned = expected_outputs(replace(record, output=output), rig)
    before, after = record.output[:, k] - expected, None if turned is None else output[:, k] - turned[:, k]
    return after is not None and float(np.var(after)) < LEFT * float(np.var(before))


def scale_finding(signal: CheckedSignal, scale: float) -> RecordFinding:
    """What another scale of an output is, and how it is cured."""
    return RecordFinding(
        kind="scale", cost=min(0.79, 0.72 + 0.02 * abs(np.log2(max(scale, 1e-6)))),
        words=f"{signal.name} moves {scale:.3g} times as far as the rig's physics say",
        cure="correct the scale or unit of the sensor or the input; or the rig's parameters, if they are guesses",
    )  # fmt: skip


def scaled_outputs(record: Record, rig: Rig, outputs: Sequence[CheckedSignal]) -> Iterator[RecordFinding]:
    """Outputs that are too large, noise and motion alike, beside the rig's sensors and physics."""
    larger = np.ones(len(outputs))
    for k, signal in enumerate(outputs):
        if signal.rough and signal.usual_noise:
            larger[k] = noise_rms(signal.values) / signal.usual_noise
    larger[larger < BEYOND] = 1.0
    expected = expected_outputs(replace(record, output=record.output / larger), rig) if larger.max() > 1.0 else None
    for k, signal in enumerate(outputs):
        if expected is not None and larger[k] > 1.0 and np.ptp(expected[:, k]):
            apart = time_of_change(expected[:, k])
            found = best_alignment(signal.values, expected[:, k], ~signal.spoilt, apart, PERIODS * apart)
            if larger[k] / ALIKE < found.scale < larger[k] * ALIKE and found.correlation > CLEAR:
                yield scale_finding(signal, found.scale)


def straightness_of_offsets(record: Record, rig: Rig, output: str) -> float:
    """Share of what an offset of the inputs does to an output, by the rig's physics, that lies along a line: 1 where
    these integrate, so that an error of a guessed law looks like a sensor's drift.
    """
    k = [item.name for item in rig.system.outputs].index(output)
    moved = expected_outputs(replace(record, input=record.input + OFFSET * np.ptp(record.input, axis=0)), rig)
    expected = expected_outputs(record, rig)
    if moved is None or expected is None:
        return 1.0
    away, at = (moved - expected)[:, k], np.arange(record.samples)
    left = away - np.polyval(np.polyfit(at, away, 1), at)
    return 1.0 - float(np.var(left)) / max(float(np.var(away)), 1e-300)
