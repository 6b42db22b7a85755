"""Networks of tanh layers with a linear output, computed in vector registers; their sizes are arguments."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from hybrid_sysid_ros.core.compilation import inner
from hybrid_sysid_ros.core.registers import added, load_numbers, plus_scaled, scratch, store, tanh, zero
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

NetworkLayers = Sequence[tuple[Array, Array]]
"""(W (out, in), b (out,)) of each layer."""

WIDEST = 4096
"""Most features, and units of a layer: far more than a real-time network has, and they fit on a stack."""

WIDE, HALF = 32, 16
"""Units side by side, where a layer has whole multiples of them: some registers of this machine."""

CHAINS = 2
"""Independent sums of each unit, 1 or 2, so that an addition need not wait for the one before."""


def widths_of(layers: NetworkLayers) -> tuple[int, ...]:
    """Numbers of features, of units of each layer, and of outputs. Raises UserError where layers don't fit."""
    for (first, _), (second, _) in pairwise(layers):
        if second.shape[1] != len(first):
            raise UserError(f"network: a layer of {len(first)} units is followed by one for {second.shape[1]}")
    for matrix, bias in layers:
        if bias.shape != matrix.shape[:1]:
            raise UserError(f"network: a layer has {len(matrix)} rows and biases of shape {bias.shape}")
    widths = (layers[0][0].shape[1], *(len(bias) for _, bias in layers))
    if len(widths) < 3 or min(widths) < 1:
        raise UserError(f"network: widths {widths} need features, a hidden layer and outputs, each above 0")
    if max(widths) > WIDEST:
        raise UserError(f"network: widths {widths} must be within {WIDEST}")
    return widths


def packed_columns(layers: NetworkLayers) -> Array:
    """The columns of each layer, then its biases, padded with idle units to multiples of eight."""
    parts: list[Array] = [np.zeros(0)]
    before = layers[0][0].shape[1] if layers else 0
    for matrix, bias in layers:
        width = _padded(len(bias))
        whole = np.zeros((width, before))
        whole[: matrix.shape[0], : matrix.shape[1]] = matrix
        parts += [whole.T.ravel(), np.pad(bias, (0, width - len(bias)))]
        before = width
    return np.concatenate(parts)


@inner
def _padded(width: int) -> int:
    return (width + 7) // 8 * 8


@inner
def _layer(w: Any, at: int, width: int, values: Any, count: int, straight: bool, out: Any, lanes: int) -> None:
    for block in range(0, width, lanes):
        biases = load_numbers(w, at + count * width + block, lanes)
        z = column_sum(w, at + block, width, values, count, biases, lanes)
        store(out, block, z if straight else tanh(z))


@inner
def forward(sizes: Any, shape: int, w: Any, at: int, features: Any, answers: Any) -> None:
    """Outputs, into ``answers``, of the network whose depth and widths begin at index ``shape`` of ``sizes`` and whose
    weights begin at index ``at``. ``answers`` has room for the widest layer; ``features`` is not changed.
    """
    depth, count = sizes[shape], sizes[shape + 1]
    other = scratch(WIDEST)
    values, into = features, answers if depth % 2 else other
    for layer in range(depth):
        width, straight = _padded(sizes[shape + 2 + layer]), layer == depth - 1
        if width % WIDE == 0:
            _layer(w, at, width, values, count, straight, into, WIDE)
        elif width % HALF == 0:
            _layer(w, at, width, values, count, straight, into, HALF)
        else:
            _layer(w, at, width, values, count, straight, into, 8)
        at += (count + 1) * width
        count = width
        values, into = into, answers if (depth - layer) % 2 == 0 else other


@inner
def column_sum(w: Any, at: int, width: int, factors: Any, count: int, start: Any, lanes: int) -> Any:
    """Return start + sum_j column_j factor_j for ``lanes`` units, in CHAINS independent sums.

    Columns are ``width`` numbers apart, the first at w[at:].
    """
    if CHAINS == 1:
        total = start
        for j in range(count):
            total = plus_scaled(total, load_numbers(w, at + j * width, lanes), factors[j])
        return total
    even, odd = start, zero(lanes)
    for j in range(0, count - 1, 2):
        even = plus_scaled(even, load_numbers(w, at + j * width, lanes), factors[j])
        odd = plus_scaled(odd, load_numbers(w, at + (j + 1) * width, lanes), factors[j + 1])
    if count % 2:
        even = plus_scaled(even, load_numbers(w, at + (count - 1) * width, lanes), factors[count - 1])
    return added(even, odd)
