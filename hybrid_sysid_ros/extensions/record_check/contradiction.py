"""Contradiction: outputs that the rig's physics miss by far though no signal looks wrong, and what would cure it: one
factor of an input or output, or one offset of an output, since a law that is no line makes another shape of a factor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from hybrid_sysid_ros.bags.record import Record
from hybrid_sysid_ros.extensions.record_check.changes import LEFT
from hybrid_sysid_ros.extensions.record_check.expectation import expected_outputs
from hybrid_sysid_ros.extensions.record_check.finding import RecordFinding
from hybrid_sysid_ros.extensions.record_check.samples import CheckedSignal, noise_rms
from hybrid_sysid_ros.rigs.rig import Rig

FAR, NOISES = 0.5, 10.0
"""Root mean square error of the physics, in the output's deviation and in its noise, from which it is far."""
FACTORS = np.geomspace(0.1, 10.0, 9)
"""Among which the best one is looked for."""
ROUNDS = 4
"""In which the mean error is taken off an output, since the physics begin elsewhere then."""


@dataclass(frozen=True, kw_only=True)
class SignalCorrection:
    """What would reconcile an output with the physics."""

    error: float
    """Mean square that is left."""
    kind: str
    words: str
    cure: str


def contradiction_findings(record: Record, rig: Rig, signals: Sequence[CheckedSignal]) -> Iterator[RecordFinding]:
    """Outputs that the physics of a rig miss by far, each with the correction that leaves little of it, if one does.
    signals: inputs and outputs, as a record has them.
    """
    outputs = [signal for signal in signals if not signal.is_input]
    for k, signal in enumerate(outputs):
        error = _error(record, rig, k)
        least = max(FAR * float(np.std(signal.values)), NOISES * noise_rms(signal.values)) ** 2
        if not least < error < np.inf:
            continue
        best = min(_corrections(record, rig, k, signals), key=lambda item: item.error)
        cured = best.error < LEFT * error
        missed = f"the rig's physics miss {signal.name} by {signal.shown(float(np.sqrt(error)))} (rms)"
        yield RecordFinding(
            kind=best.kind if cured else "another law", cost=0.72 if cured else 0.6,
            words=f"{missed}, and by {signal.shown(float(np.sqrt(best.error)))} {best.words}" if cured else missed,
            cure=best.cure if cured else "correct the law or its numbers; or is a column another one?",
        )  # fmt: skip


def _corrections(record: Record, rig: Rig, k: int, signals: Sequence[CheckedSignal]) -> Iterator[SignalCorrection]:
    """The best factor of each input and of an output, and the best offset of this."""
    inputs = [signal for signal in signals if signal.is_input]
    output = [signal for signal in signals if not signal.is_input][k]
    for column, signal in [*enumerate(inputs), (k, output)]:

        def left(exponent: float, column: int = column, *, driving: bool = signal.is_input) -> float:
            factor, changed = np.exp(exponent), (record.input if driving else record.output).copy()
            changed[:, column] *= factor
            if driving:
                return _error(replace(record, input=changed), rig, k)
            return _error(replace(record, output=changed), rig, k) / factor**2

        grid = np.log(FACTORS)
        near = int(np.argmin([left(value) for value in grid.tolist()]))
        ends = grid[max(near - 1, 0)], grid[min(near + 1, len(grid) - 1)]
        found = minimize_scalar(left, bounds=ends, method="bounded", options={"maxiter": 12})
        factor = f"{float(np.exp(found.x)):.3g}"
        yield SignalCorrection(
            error=float(found.fun), kind="scale", words=f"if {signal.name} is taken {factor} times",
            cure=f"has {signal.name} another unit or range? scale: {factor} of its column in import.yaml, or correct "
            "the rig's parameters",
        )  # fmt: skip
    offset = _offset(record, rig, k)
    yield SignalCorrection(
        error=_error(_shifted(record, k, offset), rig, k), kind="zero",
        words=f"if {output.name} is taken {output.shown(abs(offset))} {'lower' if offset > 0.0 else 'higher'}",
        cure=f"was the zero of {output.name} set elsewhere? offset of its column in import.yaml, or correct the law",
    )  # fmt: skip


def _error(record: Record, rig: Rig, k: int) -> float:
    """Mean square of output k less the physics; infinite where these have no run."""
    expected = expected_outputs(record, rig)
    return np.inf if expected is None else float(np.mean((record.output[:, k] - expected[:, k]) ** 2))


def _shifted(record: Record, k: int, offset: float) -> Record:
    output = record.output.copy()
    output[:, k] -= offset
    return replace(record, output=output)


def _offset(record: Record, rig: Rig, k: int) -> float:
    """The offset of output k whose mean error vanishes once it is taken off."""
    offset = 0.0
    for _ in range(ROUNDS):
        trial = _shifted(record, k, offset)
        expected = expected_outputs(trial, rig)
        offset += 0.0 if expected is None else float(np.mean(trial.output[:, k] - expected[:, k]))
    return offset
