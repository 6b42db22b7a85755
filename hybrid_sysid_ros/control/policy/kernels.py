"""A policy in compiled code: its training range, its packed numbers, and its bounded inputs in about a microsecond.

The sizes of a network are arguments, so these functions are compiled once for all policies, and the next process loads
them from the cache on disk.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.networks import NetworkLayers
from hybrid_sysid_ros.core.networks.tanh_layers import WIDEST, forward, packed_columns, widths_of
from hybrid_sysid_ros.core.registers import scratch
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RIDGE = 1e-3
"""Variance added to every standardised feature, so that directions in which the data hardly vary don't become sharp
limits: the previews of a smooth reference lie almost in a plane."""

UNBOUNDED = 1e12
"""Bound of a feature that the box does not limit."""

ROUNDING = 1e-9
"""Relative rounding, far above that of the numbers themselves."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TrainingRange:
    """Features within low and high (features,), and |whitening (z - centre) / scale| within ``reach``.

    The first is the box of the training data, the second their ellipsoid (Mahalanobis distance), which excludes unseen
    combinations of a state and a reference that were each seen alone. whitening (features, features): inverse of the
    Cholesky factor of the covariance of the standardised features, lower triangular.
    """

    low: Array
    high: Array
    whitening: Array
    reach: float

    def __post_init__(self) -> None:
        count = len(self.low)
        if self.high.shape != (count,) or self.whitening.shape != (count, count) or not np.all(self.low <= self.high):
            raise UserError(f"policy: the training range does not fit its {count} features")
        if not self.reach >= 0:
            raise UserError(f"policy: the reach of the training range is {self.reach}; it must not be negative")

    @classmethod
    def of(cls, features: Array, centre: Array, scale: Array) -> TrainingRange:
        """The range that contains all training data (samples, features)."""
        standardised = (features - centre) / scale
        covariance = standardised.T @ standardised / len(features) + RIDGE * np.eye(features.shape[1])
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        squares = np.sum((standardised @ whitening.T) ** 2, axis=1)
        low, high = features.min(axis=0), features.max(axis=0)
        # A little more, since compiled code sums in another order.
        hair = ROUNDING * np.maximum(np.abs(low), np.abs(high))
        reach = float(np.sqrt(squares.max()) * (1 + ROUNDING))
        return cls(low=low - hair, high=high + hair, whitening=whitening, reach=reach)

    def onto(self, raw: Array) -> TrainingRange:
        """The range of standardised raw features, from which the lower triangular map ``raw`` (features, features)
        makes these features. The box limits only features that depend on one raw feature alone.
        """
        free = np.any(raw != np.eye(len(raw)), axis=0) | np.any(raw != np.eye(len(raw)), axis=1)
        low, high = np.where(free, -UNBOUNDED, self.low), np.where(free, UNBOUNDED, self.high)
        return replace(self, low=low, high=high, whitening=self.whitening @ raw)

    @property
    def packed(self) -> Array:
        """low, high, reach and the rows of the whitening matrix, one after another."""
        return np.concatenate([self.low, self.high, [self.reach], self.whitening.ravel()])


# Sizes of a policy by index: states, inputs, outputs, tracked outputs (whose indices come behind), intervals of the
# preview, stages of an answer, features, followed parameters.
STATES, INPUTS, OUTPUTS, HORIZON, STAGES, FEATURES, FOLLOWED, TRACKED, COUNTS = range(9)
# Where numbers begin, by index: lower and upper bounds and rate limits (inputs,); output map (tracked, states); centre
# and 1 / scale (features,); range: low, high (features,), reach, whitening (features, features); network, correction;
# deviation (followed,) of the parameters.
LOW, HIGH, RATE, MAP, CENTRE, SCALE, RANGE, NETWORK, CORRECTION, DEVIATION, PLACES = range(COUNTS, COUNTS + 11)
# Behind them: the numbers of the tracked outputs, depth and widths of the network and of the correction, if any.


class Packed(NamedTuple):
    """A policy for compiled functions: sizes and indices, see above, and all numbers in a row.

    There are only two arrays, since each costs a call from Python some 60 ns. The deviation of the followed parameters,
    in their spreads, is at the end of the numbers and may be written while the policy is used.
    """

    sizes: NDArray[np.int64]
    numbers: Array


def packed(
    *,
    bounds: Sequence[Array],
    outputs: int,
    tracked: Sequence[int],
    output_map: Array,
    horizon: int,
    standard: tuple[Array, Array],
    training_range: Array,
    layers: NetworkLayers,
    correction: NetworkLayers = (),
    followed: int = 0,
) -> Packed:
    """Pack a policy.

    bounds: low, high and rate limits (inputs,). output_map (tracked, states): that of the tracked outputs. standard:
    centre and scale (features,). training_range: :attr:`~.kernels.TrainingRange.packed`. Raises UserError for layers
    that don't fit each other, or are too wide.
    """
    inputs, states = len(bounds[0]), output_map.shape[1]
    parts = [*bounds, output_map.ravel(), standard[0], 1.0 / standard[1], training_range]
    parts += [packed_columns(layers), packed_columns(correction), np.zeros(followed)]
    places = np.cumsum([0, *map(len, parts[:-1])])
    widths = widths_of(layers)
    if states + 2 * inputs + horizon * outputs > WIDEST:
        raise UserError(f"policy: a preview of {horizon} intervals of {outputs} outputs is too long for a network")
    counts = [states, inputs, outputs, horizon, widths[-1] // inputs, len(standard[0]), followed, len(tracked)]
    sizes = [*counts, *places, *tracked]
    for network in (layers, correction):
        if network:
            sizes += [len(network), *widths_of(network)]
    return Packed(np.array(sizes, dtype=np.int64), np.concatenate(parts).astype(float))


@inner
def _features(sizes: Any, numbers: Any, flat: Any, out: Any) -> None:
    """Features of a flat instance [x, d, u_previous, q_1 (outputs,), ..]: of q, tracked outputs less the output map."""
    states, tracked = sizes[STATES], sizes[TRACKED]
    first = states + 2 * sizes[INPUTS]
    for j in range(first):
        out[j] = flat[j]
    for k in range(tracked):
        y, column = 0.0, sizes[PLACES + k]
        for a in range(states):
            y += numbers[sizes[MAP] + k * states + a] * flat[a]
        for i in range(sizes[HORIZON]):
            out[first + i * tracked + k] = flat[first + i * sizes[OUTPUTS] + column] - y


@inner
def _standardise(sizes: Any, numbers: Any, features: Any, z: Any) -> bool:
    """(features - centre) / scale; False where one is not a finite number."""
    centre, scale = sizes[CENTRE], sizes[SCALE]
    for j in range(sizes[FEATURES]):
        z[j] = (features[j] - numbers[centre + j]) * numbers[scale + j]
        if not math.isfinite(z[j]):
            return False
    return True


@inner
def _evaluate(sizes: Any, numbers: Any, z: Any, answers: Any) -> None:
    """Unbounded inputs (stages, inputs), row by row; answers have room for the widest layer."""
    inputs = sizes[INPUTS]
    count = sizes[STAGES] * inputs
    shape = PLACES + sizes[TRACKED]
    forward(sizes, shape, numbers, sizes[NETWORK], z, answers)
    if sizes[FOLLOWED] > 0:
        changes = scratch(WIDEST)
        forward(sizes, shape + sizes[shape] + 2, numbers, sizes[CORRECTION], z, changes)
        for i in range(sizes[FOLLOWED]):
            for k in range(count):
                answers[k] += changes[i * count + k] * numbers[sizes[DEVIATION] + i]
    for k in range(count):
        low, high = numbers[sizes[LOW] + k % inputs], numbers[sizes[HIGH] + k % inputs]
        answers[k] = 0.5 * (low + high) + 0.5 * (high - low) * answers[k]


@inner
def network_answer(sizes: Any, numbers: Any, flat: Any, plan: Any) -> bool:
    """Write the bounded plan (stages, inputs) for a flat instance; False where something is not finite, and the plan is
    then meaningless.
    """
    features, z, answers = scratch(WIDEST), scratch(WIDEST), scratch(WIDEST)
    _features(sizes, numbers, flat, features)
    if not _standardise(sizes, numbers, features, z):
        return False
    _evaluate(sizes, numbers, z, answers)
    inputs, states = sizes[INPUTS], sizes[STATES]
    for j in range(inputs):
        low, high, rate = numbers[sizes[LOW] + j], numbers[sizes[HIGH] + j], numbers[sizes[RATE] + j]
        last = min(max(flat[states + inputs + j], low), high)
        for k in range(sizes[STAGES]):
            u = answers[k * inputs + j]
            if not math.isfinite(u):
                return False
            u = min(max(u, last - rate), last + rate)
            last = min(max(u, low), high)
            plan[k, j] = last
    return True


@inner
def inside(sizes: Any, numbers: Any, flat: Any) -> bool:
    """Whether a flat instance is within the box and the ellipsoid of the training."""
    features, z = scratch(WIDEST), scratch(WIDEST)
    _features(sizes, numbers, flat, features)
    if not _standardise(sizes, numbers, features, z):
        return False
    count, low = sizes[FEATURES], sizes[RANGE]
    reach, row = numbers[low + 2 * count], low + 2 * count + 1
    total = 0.0
    for i in range(count):
        if features[i] < numbers[low + i] or features[i] > numbers[low + count + i]:
            return False
        distance = 0.0
        for j in range(i + 1):
            distance += numbers[row + j] * z[j]
        total += distance * distance
        row += count
    return bool(total <= reach * reach)


@kernel
def contains(sizes: NDArray[np.int64], numbers: Array, flat: Array) -> bool:
    """:func:`inside` for Python."""
    return inside(sizes, numbers, flat)  # type: ignore[no-any-return]


@kernel
def rows(sizes: NDArray[np.int64], numbers: Array, features: Array, out: Array) -> None:
    """Unbounded inputs (samples, stages inputs) for raw features (samples, features); NaN where one is not finite."""
    z, answers = scratch(WIDEST), scratch(WIDEST)
    for i in range(features.shape[0]):
        known = _standardise(sizes, numbers, features[i], z)
        if known:
            _evaluate(sizes, numbers, z, answers)
        for k in range(out.shape[1]):
            out[i, k] = answers[k] if known else np.nan


def _answer_in_parts(
    state: Array, disturbance: Array, previous: Array, preview: Array, sizes: Any, numbers: Array, plan: Array
) -> bool:
    states, inputs, outputs, horizon = sizes[STATES], sizes[INPUTS], sizes[OUTPUTS], sizes[HORIZON]
    if (
        len(state) != states
        or len(disturbance) != inputs
        or len(previous) != inputs
        or preview.shape != (horizon, outputs)
    ):
        raise ValueError("a policy's instance has other sizes than its network")
    flat = scratch(WIDEST)
    for a in range(states):
        flat[a] = state[a]
    for j in range(inputs):
        flat[states + j], flat[states + inputs + j] = disturbance[j], previous[j]
    at = states + 2 * inputs
    for i in range(horizon):
        for k in range(outputs):
            flat[at] = preview[i, k]
            at += 1
    return network_answer(sizes, numbers, flat, plan)  # type: ignore[no-any-return]


@cache
def answer_in_parts() -> Callable[..., bool]:
    """:func:`network_answer` for Python and an instance in parts: one call takes less time than four copies.

    Takes state (states,), disturbance and previous input (inputs,), preview (horizon, outputs) in any layout, sizes,
    numbers and the plan. Raises ValueError for parts of other sizes and TypeError for other arrays.
    """
    signature = "b1(f8[:], f8[:], f8[:], f8[:, :], i8[::1], f8[::1], f8[:, ::1])"
    made: Callable[..., bool] = kernel(_answer_in_parts, signature)
    return made
