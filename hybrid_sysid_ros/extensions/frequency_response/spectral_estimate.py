"""Spectral estimate: the frequency response from inputs to outputs that a record, or a run of a model, shows.

A signal is cut into half-overlapping segments; each loses its straight line and gets a Hann window. In a band of
neighbouring frequencies the spectra of all segments obey

    Y = U G^T + E,

of which G is the least squares solution. It has the covariance

    cov G_i = S_i (U^H U)^-1,   S_i = |E_i|^2 / (n - m)

of a circular complex number, for m inputs and n independent rows (Pintelon & Schoukens 2012, System Identification: A
Frequency Domain Approach, 2nd ed., sections 2.6 and 7.2). Of a nonlinear system G is the best linear approximation for
inputs such as these, section 3.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.signal import detrend
from scipy.signal.windows import hann

from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SEGMENTS = 8
"""Half-overlapping ones in a record."""
FIRST = 2
"""Lowest frequency that is used, in cycles in a segment: the straight line takes what is below."""
DECADE = 10
"""Bands in a decade of frequency, where there are as many frequencies."""
SHORTEST = 64
"""Samples of a segment, at least."""
EXCITED = 1e-3
"""Power of an input in a band, in that of its strongest band, below which it is not excited there: what is so weak is
in part what a window lets through of the strong ones."""
ALIKE = 1e-8
"""Ratio of the least to the largest eigenvalue of the inputs' powers below which they can't be told apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrequencyResponse:
    """A frequency response in bands that are excited."""

    frequencies: Array
    """Middle of each band [Hz], (bands,)."""
    values: Array
    """Complex, in SI units of output and input, (bands, outputs, inputs)."""
    deviations: Array
    """Standard deviations of the real part, which are those of the imaginary one, (bands, outputs, inputs)."""
    coherence: Array
    """Share of each output's power that the inputs explain, (bands, outputs)."""


def frequency_response(inputs: Array, outputs: Array, period: float) -> FrequencyResponse:
    """The response of outputs (samples, p) to inputs (samples, m), each the mean from a sample to the next.

    Raises UserError for a record that is too short, and for inputs that are not excited or can't be told apart in any
    band.
    """
    length = 2 * len(outputs) // (SEGMENTS + 1)
    if length < SHORTEST:
        need = SHORTEST * (SEGMENTS + 1) // 2 + SEGMENTS
        raise UserError(f"{len(outputs)} samples are too few for a frequency response: {need} are needed")
    u, y = _spectra(inputs, length), _spectra(outputs, length)
    bands = _bands(length // 2)
    strongest = np.max([np.mean(np.abs(u[:, band]) ** 2, axis=(0, 1)) for band in bands], axis=0)
    frequencies, values, deviations, coherence = [], [], [], []
    for band in bands:
        rows, answers = u[:, band].reshape(-1, u.shape[2]), y[:, band].reshape(-1, y.shape[2])
        power = np.mean(np.abs(rows) ** 2, axis=0)
        if np.any(power <= EXCITED * strongest):
            continue
        scale = np.sqrt(power)
        gram = (rows / scale).conj().T @ (rows / scale)
        weights, vectors = np.linalg.eigh(gram)
        independent = independent_rows(band.stop - band.start)
        if weights[0] <= ALIKE * weights[-1] or independent <= len(weights):
            continue
        inverse = (vectors / weights) @ vectors.conj().T
        found = inverse @ (rows / scale).conj().T @ answers  # (inputs, outputs)
        left = np.sum(np.abs(answers - rows / scale @ found) ** 2, axis=0)
        noise = left / len(rows) * independent / (independent - len(weights))
        variance = np.real(np.diag(inverse))[:, None] * len(rows) / independent * noise
        middle = np.sum(np.arange(band.start, band.stop) * np.mean(np.abs(u[:, band]) ** 2, axis=(0, 2)))
        frequencies.append(middle / np.sum(np.mean(np.abs(u[:, band]) ** 2, axis=(0, 2))) / (length * period))
        values.append((found / scale[:, None]).T)
        deviations.append((np.sqrt(0.5 * variance) / scale[:, None]).T)
        coherence.append(1.0 - left / np.maximum(np.sum(np.abs(answers) ** 2, axis=0), 1e-300))
    if not values:
        raise UserError("no frequency at which the inputs are excited and can be told apart")
    return FrequencyResponse(
        frequencies=np.array(frequencies),
        values=np.array(values),
        deviations=np.array(deviations),
        coherence=np.array(coherence),
    )


@cache
def independent_rows(lines: int) -> float:
    """How many independent rows the spectra of all segments at neighbouring frequencies are worth.

        n = K L / sum_{s, l} r(s, l) (1 - |s| / K) (1 - |l| / L),   r = |sum_t w(t) w(t + s N / 2) e^(2 pi i l t / N)|^2

    for K segments, L frequencies, and the squared correlation r of white noise through Hann windows w, of sum w^2 = 1,
    that are s segments and l frequencies apart (Welch 1967, IEEE Trans. Audio Electroacoust. 15(2), for l = 0).
    """
    window = hann(SHORTEST, sym=False)
    window /= np.linalg.norm(window)
    half, total = SHORTEST // 2, 0.0
    for products, segments in ((window**2, SEGMENTS), (window[half:] * window[:half], 2 * (SEGMENTS - 1))):
        alike = np.abs(np.fft.fft(products, SHORTEST)) ** 2
        apart = np.arange(min(lines, half))
        by_line = (1.0 - apart / lines) * alike[: len(apart)]
        total += segments / SEGMENTS * (2.0 * np.sum(by_line) - by_line[0])
    return float(SEGMENTS * lines / total)


def _spectra(signals: Array, length: int) -> Array:
    """Of half-overlapping segments of signals (samples, k): (segments, frequencies, k)."""
    begins = np.linspace(0, len(signals) - length, SEGMENTS).round().astype(int)
    segments = np.stack([signals[begin : begin + length] for begin in begins])
    windowed = detrend(segments, axis=1) * hann(length, sym=False)[:, None]
    return np.asarray(np.fft.rfft(windowed, axis=1))


def _bands(lines: int) -> list[slice]:
    """Bands of neighbouring frequencies, each one frequency wide where a part of a decade has no more."""
    count = max(round(DECADE * np.log10(lines / FIRST)), 1)
    edges = np.unique(np.geomspace(FIRST, lines, count + 1).round().astype(int))
    return [slice(int(low), int(high)) for low, high in pairwise(edges)]
