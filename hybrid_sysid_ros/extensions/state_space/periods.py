"""Periodic excitation: its period, and the spectrum of the steady periods of a record."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from hybrid_sysid_ros.extensions.state_space.subspace import Spectrum, Stretch
from hybrid_sysid_ros.support.arrays import Array

ALIKE = 0.99
"""Least correlation of the inputs with themselves a period later."""
DIFFERENT = 0.5
"""Correlation below which it must fall before, since a slow signal resembles itself at once."""
EXCITED = 1e-3
"""Least size of a line that counts as excited, relative to the largest one."""


def period_of(inputs: Array) -> int:
    """Samples of the inputs' (samples, inputs) period, which they repeat at least twice; 0: there is none."""
    samples = len(inputs)
    centred = inputs - inputs.mean(axis=0)
    size = next_fast_len(2 * samples)
    power = np.sum(np.abs(rfft(centred, size, axis=0)) ** 2, axis=1)
    products = irfft(power, size)[: samples // 2 + 1]
    sums = np.concatenate([[0.0], np.cumsum(np.sum(centred**2, axis=1))])
    lags = np.arange(len(products))
    heads, tails = sums[samples - lags], sums[-1] - sums[lags]
    alike = products / np.maximum(np.sqrt(heads * tails), 1e-300)
    below = np.flatnonzero(alike < DIFFERENT)
    if not len(below):
        return 0
    found = np.flatnonzero(alike[below[0] :] >= ALIKE)
    if not len(found):
        return 0
    first = int(below[0] + found[0])
    top = alike[first : first + max(first // 10, 2)]
    return first + int(np.argmax(top))


def spectrum_of(stretch: Stretch) -> Spectrum | None:
    """The excited lines of a record's mean period, without the first period, in which the motion settles; None for a
    record that is not periodic.
    """
    inputs, outputs = stretch
    period = period_of(inputs)
    if period == 0:
        return None
    count = len(inputs) // period
    steady = slice((count - 1) * period if count == 2 else period, count * period)
    lines = [
        np.fft.rfft(values[steady].reshape(-1, period, values.shape[1]).mean(axis=0), axis=0)[1:]
        for values in (inputs, outputs)
    ]
    strength = np.linalg.norm(lines[0], axis=1)
    excited = strength > EXCITED * strength.max()
    z = np.exp(2j * np.pi * np.arange(1, len(strength) + 1) / period)
    return Spectrum(z=z[excited], inputs=lines[0][excited] / period, outputs=lines[1][excited] / period)
