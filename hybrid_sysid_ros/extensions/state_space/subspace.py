"""Subspace identification: matrices A and C of every order from one factorisation, B and D by least squares."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq, qr, svd
from scipy.signal import lfilter

from hybrid_sysid_ros.identification.starts import RELATIVE_ERROR, WIDE
from hybrid_sysid_ros.support.arrays import Array

Stretch = tuple[Array, Array]
"""Inputs (samples, inputs) and outputs (samples, outputs) of one stretch of a record, scaled."""
COLUMNS = 4096
"""Columns of data that are factorised at once."""
STEADY = 1e-9
"""Least distance of a pole from the unit circle, within which poles are brought."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Matrices:
    """x+ = A x + B u, y = C x + D u + d."""

    a: Array
    b: Array
    c: Array
    d: Array
    level: Array
    """d, (outputs,)."""


@dataclass(frozen=True, kw_only=True)
class Spectrum:
    """Steady periods of a record: z = exp(i w) of each line, and the lines of inputs and outputs."""

    z: NDArray[np.complex128]
    inputs: NDArray[np.complex128]
    """(lines, inputs)."""
    outputs: NDArray[np.complex128]
    """(lines, outputs)."""


def triangular_factor(blocks: Iterable[Array], width: int) -> Array:
    """The triangular factor R (width, width) of rows (rows, width) that come in blocks, so that R' R is their sum of
    squares.
    """
    found = np.zeros((0, width))
    for block in blocks:
        (found,) = qr(np.concatenate([found, block]), mode="r", overwrite_a=True, check_finite=False)
        found = found[:width]
    return np.concatenate([found, np.zeros((width - len(found), width))])


def in_time(stretches: Sequence[Stretch], rows: int) -> Array:
    """Triangular factor of future inputs, past inputs, past outputs and future outputs, ``rows`` samples of each.

    Stretches that are shorter than twice ``rows`` don't count.
    """
    m, p = stretches[0][0].shape[1], stretches[0][1].shape[1]

    def blocks() -> Iterable[Array]:
        for inputs, outputs in stretches:
            for first in range(rows, len(inputs) - rows + 1, COLUMNS):
                at = np.arange(first, min(first + COLUMNS, len(inputs) - rows + 1))[:, None]
                past, future = at - np.arange(rows, 0, -1), at + np.arange(rows)
                parts = inputs[future], inputs[past], outputs[past], outputs[future]
                yield np.concatenate([part.reshape(len(at), -1) for part in parts], axis=1)

    return triangular_factor(blocks(), 2 * rows * (m + p))


def in_frequency(spectra: Sequence[Spectrum], rows: int) -> Array:
    """Triangular factor of ``rows`` powers z^i times the lines of inputs, then of outputs, real and imaginary parts.

    McKelvey, Akcay and Ljung (1996), Subspace-based multivariable system identification from frequency response data,
    IEEE Transactions on Automatic Control 41(7), with the spectra in place of a frequency response.
    """

    def blocks() -> Iterable[Array]:
        for spectrum in spectra:
            powers = spectrum.z[:, None] ** np.arange(rows)
            parts = [
                (powers[:, :, None] * lines[:, None, :]).reshape(len(powers), -1)
                for lines in (spectrum.inputs, spectrum.outputs)
            ]
            joined = np.concatenate(parts, axis=1)
            yield np.concatenate([joined.real, joined.imag])

    return triangular_factor(blocks(), rows * (spectra[0].inputs.shape[1] + spectra[0].outputs.shape[1]))


def observability(factor: Array, rows: int, inputs: int, outputs: int) -> tuple[Array, Array]:
    """Directions (rows * outputs, directions) of the extended observability matrix and their singular values.

    The future inputs are projected out, and in time the past ones and the past outputs are the instruments (MOESP).
    Verhaegen (1994), Identification of the deterministic part of MIMO state space models, Automatica 30(1).
    """
    lower, first, last = factor.T, rows * inputs, rows * outputs
    seen = lower[-last:, first:-last] if factor.shape[1] > first + last else lower[-last:, first:]
    left, singular, _ = svd(seen, full_matrices=False)
    return left * np.sqrt(singular), singular


def poles_and_readout(directions: Array, order: int, outputs: int) -> tuple[Array, Array]:
    """A (order, order) and C (outputs, order) from the first directions; poles outside the unit circle go inside."""
    seen = directions[:, :order]
    a = lstsq(seen[:-outputs], seen[outputs:])[0]
    poles, vectors = np.linalg.eig(a)
    size = np.abs(poles)
    if np.any(size >= 1.0 - STEADY):
        inside = np.where(size > 1.0, poles / np.maximum(size, 1e-300) ** 2, poles)
        inside *= np.minimum(1.0, (1.0 - STEADY) / np.maximum(np.abs(inside), 1e-300))
        a = np.real(vectors @ np.diag(inside) @ np.linalg.inv(vectors))
    return a, seen[:outputs]


def regressors(a: Array, c: Array, inputs: Array, k: int, through: bool) -> Array:
    """Derivatives (samples, columns) of output k by B along its rows, its row of D where ``through``, its constant, and
    the first state.

    Each mode of A filters each input by itself.
    """
    n, m, samples = len(a), inputs.shape[1], len(inputs)
    poles, vectors = np.linalg.eig(a)
    back = np.linalg.inv(vectors)
    shown = c[k] @ vectors
    found = np.empty((samples, n * m + (m if through else 0) + 1 + n))
    filtered = np.empty((samples, n, m), dtype=complex)
    for mode, pole in enumerate(poles):
        filtered[:, mode] = lfilter([0.0, 1.0], [1.0, -pole], inputs, axis=0)
    for j in range(m):
        found[:, j : n * m : m] = np.real(filtered[:, :, j] @ (shown[:, None] * back))
    if through:
        found[:, n * m : n * m + m] = inputs
    found[:, -n - 1] = 1.0
    with np.errstate(under="ignore"):
        powers = np.exp(np.arange(samples)[:, None] * np.log(np.where(poles == 0.0, 1e-300, poles + 0j)))
    found[:, -n:] = np.real(powers @ (shown[:, None] * back))
    return found


def completed(a: Array, c: Array, stretches: Sequence[Stretch], through: bool) -> Matrices:
    """B, D and d by least squares over stretches, each of which has a first state of its own."""
    n, m, p = len(a), stretches[0][0].shape[1], len(c)
    shared = n * m + (p * m if through else 0) + p
    normal, right = np.zeros((shared, shared)), np.zeros(shared)
    for inputs, outputs in stretches:
        squares, mixed, own = np.zeros((shared, shared)), np.zeros((shared, n)), np.zeros((n, n))
        by_shared, by_own = np.zeros(shared), np.zeros(n)
        for k in range(p):
            columns = regressors(a, c, inputs, k, through)
            through_at = n * m + k * m + np.arange(m if through else 0)
            at = np.concatenate([np.arange(n * m), through_at, [shared - p + k]]).astype(int)
            head, tail = columns[:, :-n], columns[:, -n:]
            squares[np.ix_(at, at)] += head.T @ head
            mixed[at] += head.T @ tail
            own += tail.T @ tail
            by_shared[at] += head.T @ outputs[:, k]
            by_own += tail.T @ outputs[:, k]
        inverse = np.linalg.pinv(own, rcond=1e-12, hermitian=True)
        normal += squares - mixed @ inverse @ mixed.T
        right += by_shared - mixed @ inverse @ by_own
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    found = lstsq(normal / scale / scale[:, None], right / scale, cond=1e-13)[0] / scale
    d = found[n * m : -p].reshape(p, m) if through else np.zeros((p, m))
    return Matrices(a=a, b=found[: n * m].reshape(n, m), c=c, d=d, level=found[-p:])


def residuals(model: Matrices, inputs: Array, outputs: Array, *, known: int | None = None) -> Array:
    """Errors (samples, outputs) of the simulation over a stretch, from the first state that fits it best, or its first
    ``known`` samples: then with the prior deviation of states in the simulation, as records are scored.
    """
    n, p, m = len(model.a), len(model.c), inputs.shape[1]
    by_inputs = model.b.ravel()
    errors, starts = np.empty(outputs.shape), np.empty((*outputs.shape, n))
    for k in range(p):
        columns = regressors(model.a, model.c, inputs, k, False)
        simulated = columns[:, : n * m] @ by_inputs + inputs @ model.d[k] + model.level[k]
        errors[:, k] = outputs[:, k] - simulated
        starts[:, k] = columns[:, -n:]
    if known is None:
        first = lstsq(starts.reshape(-1, n), errors.ravel(), cond=1e-10)[0]
    else:
        prior = RELATIVE_ERROR / WIDE / np.maximum(sizes_of_states(model, inputs), 1e-12)
        seen = np.concatenate([starts[:known].reshape(-1, n), np.diag(prior)])
        first = lstsq(seen, np.concatenate([errors[:known].ravel(), np.zeros(n)]))[0]
    return np.asarray(errors - starts @ first)


def sizes_of_states(model: Matrices, inputs: Array) -> Array:
    """Root mean squares (order,) of the states in a simulation from zero."""
    poles, vectors = np.linalg.eig(model.a)
    driven = inputs @ np.linalg.solve(vectors, model.b.astype(complex)).T
    modes = [lfilter([0.0, 1.0], [1.0, -pole], drive) for pole, drive in zip(poles, driven.T, strict=True)]
    return np.asarray(np.sqrt(np.mean(np.real(vectors @ np.array(modes)) ** 2, axis=1)))
