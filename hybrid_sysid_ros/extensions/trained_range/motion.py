"""Motion: what a system does at each sample, as features of its outputs and inputs alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from hybrid_sysid_ros.support.arrays import Array

SMOOTHED = 5
"""Samples of a mean, by which noise is kept out of slow motion."""
RESOLUTION, NOISE = 0.02, 2.0
"""Displacements that count as none: in the output's deviation in training, and in its noise."""
PER_OUTPUT = 5
"""Features of an output: value, displacement over three times, range over the longest."""


@dataclass(frozen=True, kw_only=True)
class MotionScales:
    """Scales of features in training.

    An output y has its value, its displacements d over some samples, a short and two longer times, and its range r over
    the longest, which tells rest and slow motion from a moment between two moves; an input has its mean u:

        y / s,  asinh(d / e) / 2,  log(r + e),  u / s

    Times are in scored samples.
    """

    outputs: Array
    """Deviations s of outputs, (p,)."""
    inputs: Array
    """Deviations s of inputs, (m,)."""
    none: Array
    """Displacements e that count as none, (p,)."""
    places: Array
    """1 for an output on whose value something depends, 0 for one such as a place in an endless plane, (p,)."""
    samples: tuple[int, int, int]
    """Times of the displacements, the longest last."""

    @classmethod
    def of(cls, outputs: Array, inputs: Array, noise: Array, places: Array, longest: int) -> MotionScales:
        """Those of training data: outputs (samples, p), inputs (samples, m), noise of the outputs (p,)."""
        spread, drive = (np.maximum(np.std(values, axis=0), 1e-300) for values in (outputs, inputs))
        none = np.maximum(RESOLUTION * spread, NOISE * noise)
        times = (2, max(longest // 5, 3), longest)
        return cls(outputs=spread, inputs=drive, none=none, places=places, samples=times)

    def features(self, outputs: Array, inputs: Array) -> Array:
        """Features (samples - longest, 5 p + m): those of an output are together, inputs last.

        outputs (samples, p), inputs (samples, m): means from each sample to the next. The first samples have no past.
        """
        smooth = _mean(outputs, SMOOTHED)
        moved = displacements(outputs, smooth, self.samples)
        spans = ranges(smooth, self.samples[-1])
        past = self.samples[-1]
        columns = [
            self.places * outputs[past:] / self.outputs,
            *(np.arcsinh(item[past:] / self.none) / 2.0 for item in moved),
            np.log(spans[past:] + self.none),
        ]
        by_output = np.stack(columns, axis=2).reshape(len(outputs) - past, -1)
        return np.concatenate([by_output, inputs[past:] / self.inputs], axis=1)

    def moved(self, features: Array, output: int) -> tuple[Array, Array]:
        """Displacement over the longest time, and range of an output, each (samples,), of features."""
        own = features[:, PER_OUTPUT * output : PER_OUTPUT * (output + 1)]
        return np.sinh(2.0 * own[:, 3]) * self.none[output], np.exp(own[:, 4]) - self.none[output]


def displacements(outputs: Array, smooth: Array, samples: Sequence[int]) -> list[Array]:
    """By how much outputs (samples, p) are away from where they were: the first of unsmoothed ones."""
    return [values - _earlier(values, count) for values, count in zip((outputs, smooth, smooth), samples, strict=True)]


def ranges(values: Array, count: int) -> Array:
    """Highest less lowest of each value (samples, p) and the ``count`` before it, which is even."""
    given = {"size": count + 1, "axis": 0, "mode": "nearest", "origin": count // 2}
    return np.asarray(maximum_filter1d(values, **given) - minimum_filter1d(values, **given))


def _mean(values: Array, count: int) -> Array:
    """Means of each value (samples, p) and those before it, at most ``count``."""
    padded = np.concatenate([np.repeat(values[:1], count, axis=0), values])
    sums = np.cumsum(padded, axis=0)
    return np.asarray((sums[count:] - sums[:-count]) / count)


def _earlier(values: Array, count: int) -> Array:
    """Values (samples, p) by so many samples late; the first ones repeat."""
    return np.concatenate([np.repeat(values[:1], min(count, len(values)), axis=0), values[:-count]])
