"""The check of a record: every fault that it shows, the costliest first.

Thresholds here and beside are set by hand: python -m benchmarks.trust check measures, with seeds of its own, how many
of thirty kinds of faults are named first at them, and how many good records are accused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.applied_input import levels_cut_off, of_held_input
from hybrid_sysid_ros.extensions.record_check.contradiction import contradiction_findings
from hybrid_sysid_ros.extensions.record_check.correction import scaled_outputs
from hybrid_sysid_ros.extensions.record_check.expectation import expected_outputs, is_guessed
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.record_check.plateau import plateau_findings
from hybrid_sysid_ros.extensions.record_check.relation import wanders
from hybrid_sysid_ros.extensions.record_check.repetition import repetition_findings
from hybrid_sysid_ros.extensions.record_check.response import response_findings
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal, sample_findings
from hybrid_sysid_ros.extensions.shared.granger_causality import feedbacks_of
from hybrid_sysid_ros.identification.shooting import fastest_growth
from hybrid_sysid_ros.rigs.rig import Rig

QUIET = 0.02
"""Share of an actuator's span below which an input hardly moves."""
FEWEST = 200
"""Samples below which a record is short."""
MISSING = 0.005
"""Share of missing samples that is worth a word."""
SILENT = 0.9
"""Cost of a finding beside which the rig's physics say nothing: where nothing moves, friction makes any answer."""
INVERSE = ("swapped channels", "another law")
"""What the inverse of a feedback looks like, where a guess of the law was fitted to that."""
STILL = 0.5
"""Cost of an input that does not move while another one does: the record tells nothing of that one alone."""


def findings_of(record: Record, rig: Rig) -> list[RecordFinding]:
    """All findings, the costliest first. Raises UserError for a record that does not fit the rig."""
    signals, found = signals_of(record, rig), list[RecordFinding]()
    for signal in signals:
        found += sample_findings(signal, list(record.input.T))
        if signal.is_input or signal.rough or not signal.explained:
            found += plateau_findings(signal, signals)
    if any(signal.is_input and signal.span > 0.0 for signal in signals):
        found = [replace(item, cost=STILL) if item.kind == "no excitation" else item for item in found]
    found += _whole(record, signals)
    found += repetition_findings(record)
    found += _unrelated(record, signals)
    found += (scaled := list(scaled_outputs(record, rig, [item for item in signals if not item.is_input])))
    if not (scaled or any(item.cost >= SILENT for item in found)):
        noisy = any(signal.rough for signal in signals if not signal.is_input)
        expected, responses = expected_outputs(record, rig, noisy=noisy), list[RecordFinding]()
        if expected is not None:
            responses += levels_cut_off(record, rig, signals, expected)
            responses += () if responses else response_findings(record, rig, signals, expected)
        elif (growth := fastest_growth(rig.system)) > 0.0 and rig.experiments.stabiliser is None:
            found.append(_of_unstable_law(growth))
        if is_guessed(rig):
            responses = [_of_guess(item) for item in responses]
            if any(item.kind in INVERSE for item in responses) and (loops := feedbacks_of(record, rig)):
                responses = [_of_loop(loops), *(item for item in responses if item.kind not in INVERSE)]
        found += responses
        found = [item for item in (of_held_input(item, record, rig, expected) for item in found) if item]
        if expected is not None and not is_guessed(rig) and all(item.kind == "another law" for item in found):
            found = list(contradiction_findings(record, rig, signals)) or found
    return sorted(found, key=lambda item: -item.cost)


def _unrelated(record: Record, signals: list[CheckedSignal]) -> Iterator[RecordFinding]:
    """Outputs that walk at random, whatever the inputs do."""
    if not any(item.is_input and item.span > 0.0 for item in signals):
        return
    for signal in signals:
        quiet = signal.is_input or signal.explained or signal.span == 0.0
        if not quiet and wanders(record.input, signal.values):
            signal.explained = True
            yield RecordFinding(
                kind="no relation", cost=0.79,
                words=f"{signal.name} walks at random at every time scale, and the inputs explain nothing of it",
                cure="is it the right column, of the same experiment? what wanders by itself, a model can't simulate",
            )  # fmt: skip


def _of_unstable_law(growth: float) -> RecordFinding:
    """No free run can be compared with a record of a rig that a loop holds."""
    return RecordFinding(
        kind="unstable law", cost=0.75,
        words=f"by the rig's law an error grows by e in {1.0 / growth:.2g} s, so that no free run follows the record",
        cure="fits take short windows by themselves; name the gains of the loop that holds the rig "
        "(experiments.stabiliser in rig.yaml), so that models are judged in closed loop, too",
    )  # fmt: skip


def _of_guess(item: RecordFinding) -> RecordFinding:
    """What contradicts a guessed law blocks no fit, which finds another one."""
    if not item.blocks:
        return item
    return replace(item, cost=0.79, cure=f"{item.cure}; or the law, a guess of rig from, is wrong: correct system.py")


def _of_loop(loops: Sequence[str]) -> RecordFinding:
    """A guess that was fitted to a loop's record may be the inverse of the feedback."""
    return RecordFinding(
        kind="closed loop", cost=0.75,
        words=f"{', '.join(loops)}, and the law is a guess of rig from: it may be the feedback's inverse, with the "
        "wrong sign",
        cure="write the physics and the sign of each gain in system.py, or record without the loop",
    )  # fmt: skip


def signals_of(record: Record, rig: Rig) -> list[CheckedSignal]:
    """Inputs and outputs with what the rig says of them."""
    period, found = record.sampling_time, []
    for item, actuator, values in zip(rig.system.inputs, rig.actuators, record.input.T, strict=True):
        found.append(
            CheckedSignal(
                name=item.name, unit=item.unit, values=values, period=period, is_input=True,
                limits=(actuator.low, actuator.high),
            )
        )  # fmt: skip
    for item, sensor, values in zip(rig.system.outputs, rig.sensors, record.output.T, strict=True):
        scale = abs(sensor.scale)
        found.append(
            CheckedSignal(
                name=item.name, unit=item.unit, values=values, period=period, is_input=False,
                noise=scale * sensor.white_noise, count=scale * sensor.quantiser.count if sensor.quantiser else 0.0,
                hum=scale * sensor.hum.rms if sensor.hum else 0.0,
            )
        )  # fmt: skip
    return found


def _whole(record: Record, signals: list[CheckedSignal]) -> list[RecordFinding]:
    """Findings on the record as a whole: its length, missing samples, and how far the inputs move."""
    found = []
    if record.samples < FEWEST:
        found.append(
            RecordFinding(
                kind="short",
                cost=0.79,
                words=f"{record.samples} samples, {record.duration:.4g} s",
                cure="record longer; what so few samples show of scale or relation is chance",
            )
        )
    lost = 0.0 if record.measured is None else float(1.0 - record.measured.mean())
    if lost > MISSING:
        found.append(
            RecordFinding(
                kind="missing samples", cost=min(0.7, 0.4 + 2.0 * lost), words=f"{lost:.1%} of the samples are missing",
                cure="use a faster disk or a slower rate; fits leave them out",
            )
        )  # fmt: skip
    inputs = [signal for signal in signals if signal.is_input]
    spans = [float(np.ptp(np.percentile(item.values, [1, 99]))) / (item.limits[1] - item.limits[0]) for item in inputs]
    most = int(np.argmax(spans))
    if 0.0 < spans[most] < QUIET:
        found.append(
            RecordFinding(
                kind="no excitation", cost=0.96,
                words=f"{inputs[most].name} moves over {spans[most]:.1%} of what its actuator can",
                cure="drive it over the range that the model is for; or is it in another unit?",
            )
        )  # fmt: skip
    return found
