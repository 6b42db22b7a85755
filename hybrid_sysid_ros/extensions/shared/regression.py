"""One-step regression: rows of records for a recurrence in lagged values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.core.parameters import scale_of
from hybrid_sysid_ros.identification.experiment import PreparedRecord
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True, eq=False)
class Regression:
    """Lagged values of all signals, and the next outputs, each in its scale. No lag reaches from one record to another.

    The order is that of :class:`~hybrid_sysid_ros.extensions.shared.lagged.Lagged`.
    """

    lagged: Array
    """Regressors, (rows, regressors)."""
    targets: Array
    """The next outputs, (rows, outputs)."""
    scales: Array
    """Root mean squares of outputs and inputs, (outputs + inputs,)."""
    low: Array
    """Lowest values of outputs and inputs; high: highest values."""
    high: Array
    period: float
    """[s]."""
    output_lags: int
    input_lags: int

    @classmethod
    def of(cls, experiments: Sequence[PreparedRecord], *, output_lags: int, input_lags: int, kind: str) -> Regression:
        """The rows of several experiments. Raises UserError, naming the structure by ``kind``, for a record that is too
        short for the lags, and for a step that is not the period.
        """
        _check(experiments, max(output_lags, input_lags), kind)
        signals = (
            np.concatenate([item.outputs for item in experiments]),
            np.concatenate([i.inputs for i in experiments]),
        )
        squares = np.concatenate([np.mean(values**2, axis=0) for values in signals])
        scales = np.array([scale_of(value) for value in np.sqrt(squares)])
        own = np.split(scales, [signals[0].shape[1]])
        parts = [_rows(i.outputs / own[0], i.inputs / own[1], output_lags, input_lags) for i in experiments]
        lagged, targets = (np.concatenate(blocks) for blocks in zip(*parts, strict=True))
        return cls(
            lagged=lagged,
            targets=targets,
            scales=scales,
            low=np.concatenate([values.min(axis=0) for values in signals]),
            high=np.concatenate([values.max(axis=0) for values in signals]),
            period=experiments[0].sampling.period,
            output_lags=output_lags,
            input_lags=input_lags,
        )

    def shape(self, outputs: Sequence[Variable], inputs: Sequence[Variable]) -> dict[str, Any]:
        """The fields of a :class:`~hybrid_sysid_ros.extensions.shared.lagged.Lagged` of these rows."""
        return {
            "outputs": tuple(outputs),
            "inputs": tuple(inputs),
            "output_lags": self.output_lags,
            "input_lags": self.input_lags,
            "scales": tuple(self.scales.tolist()),
            "low": tuple(self.low.tolist()),
            "high": tuple(self.high.tolist()),
            "period": self.period,
        }


def least_squares(design: Array, targets: Array, *, ridge: float) -> Array:
    """Coefficients (columns, outputs) for a design (rows, columns); ridge: penalty, times the number of rows."""
    rows, columns = design.shape
    known = np.concatenate([design, np.sqrt(ridge * rows) * np.eye(columns)])
    wanted = np.concatenate([targets, np.zeros((columns, targets.shape[1]))])
    return np.asarray(np.linalg.lstsq(known, wanted, rcond=None)[0])


def _check(experiments: Sequence[PreparedRecord], lags: int, kind: str) -> None:
    for item in experiments:
        if item.sampling.every != 1:
            raise UserError(
                f"{item.name}: a {kind} steps once a sample; the step of {item.sampling.step:g} s must be the "
                f"period of {item.sampling.period:g} s"
            )
        if item.samples <= lags:
            raise UserError(f"{item.name}: {item.samples} samples are too short for {lags} lags; {lags + 1} are needed")


def _rows(outputs: Array, inputs: Array, output_lags: int, input_lags: int) -> tuple[Array, Array]:
    """Lagged values (rows, lags), the latest of each signal first, and the next outputs (rows, outputs)."""
    first = max(output_lags, input_lags) - 1
    past = [sliding_window_view(y[:-1], output_lags)[first + 1 - output_lags :, ::-1] for y in outputs.T if output_lags]
    past += [sliding_window_view(u, input_lags)[first + 1 - input_lags :, ::-1] for u in inputs.T]
    return np.concatenate(past, axis=1), outputs[first + 1 :]
