"""A recurrent network: the black box with memory of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Parameter, Recurrence, Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.parameters import of_data
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.extensions.recurrent.gated_units import GatedUnits
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

PERIOD = 0.025
"""Longest sampling time [s] where the input is averaged."""

SHORTEST, LONGEST = 0.1, 2.0
"""Memories [s] of the hidden units before training."""


def step_within(period: float) -> float:
    """The longest whole part of a period [s] that is no longer than PERIOD."""
    return period / max(math.ceil(period / PERIOD - 1e-9), 1)


@dataclass(frozen=True, kw_only=True)
class Recurrent(Recurrence):
    """A gated recurrent unit (GRU): hidden states h, each in [-1, 1], driven by the mean inputs u of each period.

        r  = s(A_r u / U + b_r + W_r h)                reset      s(a) = (1 + tanh(a / 2)) / 2
        k  = s(A_k u / U + b_k + W_k h)                keep
        n  = tanh(A_n u / U + b_n + r (W_n h + c))     new
        h+ = k h + (1 - k) n
        y+ = Y (D h+ + e),    v+ = (y+ - y) / period

    Cho et al. (2014), Learning phrase representations using RNN encoder-decoder, section 2.3, with the reset gate after
    the matrix, as cuDNN and PyTorch have it. A mean of values in [-1, 1] stays there, so |y| <= Y (sum |D| + |e|) under
    any input. States are the outputs, their rates v and h. A simulation begins from one measured sample and its rates,
    h = tanh(E (y / Y, v / V) + f): training learns E and f beside the rest, and no warm-up is needed.

    Raises UserError where the weights don't fit the units.
    """

    outputs: tuple[Variable, ...]  # type: ignore[misc]
    inputs: tuple[Variable, ...]  # type: ignore[misc]
    rates: tuple[Variable, ...] = ()
    """Names of the outputs' rates; by default those of the outputs and "_rate"."""
    units: int = 24
    scales: tuple[float, ...] = ()
    """Y, V, U, fixed parameters; ones by default."""
    network_weights: Array | None = None
    """All :meth:`parts`, flat, (size,). None: zeros, a network that knows nothing yet."""

    def __post_init__(self) -> None:
        size = sum(int(np.prod(shape)) for shape in self.shapes.values())
        weights = np.zeros(size) if self.network_weights is None else self.network_weights
        channels = 2 * len(self.outputs) + len(self.inputs)
        scales = self.scales or (1.0,) * channels
        if self.units < 1 or len(weights) != size or len(scales) != channels:
            raise UserError(
                f"recurrent network: {len(weights)} weights, but {self.units} units have {size}, or {len(scales)} "
                f"scales for {channels} signals"
            )
        rates = self.rates or tuple(Variable(name=f"{y.name}_rate", unit=f"{y.unit}/s") for y in self.outputs)
        hidden = (Variable(name=f"hidden_{i + 1}", unit="") for i in range(self.units))
        for name, value in (
            ("network_weights", weights),
            ("scales", tuple(scales)),
            ("rates", rates),
            ("states", (*self.outputs, *rates, *hidden)),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, design: Mapping[str, Any], weights: Array) -> Recurrent:
        """The system of a :attr:`design` with its weights (size,). Raises UserError where they don't fit."""
        variables = {name: tuple(Variable(**item) for item in design[name]) for name in ("outputs", "inputs", "rates")}
        return cls(**{**design, **variables, "scales": tuple(design["scales"])}, network_weights=weights)

    @property
    def design(self) -> dict[str, Any]:
        """Everything but the weights as plain data, from which :meth:`of` builds the system again."""
        variables = {name: [asdict(item) for item in getattr(self, name)] for name in ("outputs", "inputs", "rates")}
        return {"period": self.period, "units": self.units, "scales": list(self.scales), **variables}

    @property
    def kinematics(self) -> Mapping[int, int]:
        return {i: len(self.outputs) + i for i in range(len(self.outputs))}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(of_data(f"scale_{item.name}", item.unit) for item in (*self.outputs, *self.rates, *self.inputs))

    @property
    def values(self) -> Array:
        return np.array(self.scales)

    def bound(self, values: Sequence[Scalar]) -> Recurrent:
        return replace(self, scales=tuple(values))

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parts of the weights, in their order; rows of three times the units are r, k, n."""
        units, inputs, outputs = self.units, len(self.inputs), len(self.outputs)
        return {
            "drive": (3 * units, inputs),
            "bias": (3 * units,),
            "recurrent": (3 * units, units),
            "reset_bias": (units,),
            "readout": (outputs, units),
            "readout_bias": (outputs,),
            "encoder": (units, 2 * outputs),
            "encoder_bias": (units,),
        }

    def parts(self, weights: Any) -> dict[str, Any]:
        """Weights (size,), an array or a tensor, cut into the arrays of :attr:`shapes`."""
        found, begin = {}, 0
        for name, shape in self.shapes.items():
            end = begin + int(np.prod(shape))
            found[name] = weights[begin:end].reshape(shape)
            begin = end
        return found

    @property
    def weights(self) -> Array:
        assert self.network_weights is not None
        return self.network_weights

    def with_weights(self, weights: Array) -> Recurrent:
        return replace(self, network_weights=weights)

    def initial(self, seed: int) -> Recurrent:
        """The same system with random weights, and memories spread from SHORTEST to LONGEST evenly in the logarithm.

        Tallec and Ollivier (2018), Can recurrent neural networks warp time?, eq. (16): k = 1 - 1 / (memory in steps).
        """
        random = np.random.default_rng(seed)
        weights = np.zeros(len(self.weights))
        parts = self.parts(weights)
        for name in ("drive", "recurrent", "readout", "encoder"):
            parts[name][:] = random.uniform(-1.0, 1.0, size=parts[name].shape) / np.sqrt(self.units)
        memories = np.exp(random.uniform(np.log(SHORTEST), np.log(LONGEST), size=self.units)) / self.period
        parts["bias"][self.units : 2 * self.units] = np.log(np.maximum(memories - 1.0, 1.0))
        return self.with_weights(weights)

    @property
    def form(self) -> tuple[Any, ...]:
        return (type(self), self.units, len(self.inputs), len(self.outputs), self.period)

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        p = len(self.outputs)
        layer = GatedUnits(units=self.units, size=len(self.weights), inputs=len(self.inputs), readouts=p)
        drive = [value / scale for value, scale in zip(u, self.scales[2 * p :], strict=True)]
        found = layer([*drive, *x[2 * p :]])
        outputs = [scale * value for scale, value in zip(self.scales, found[:p], strict=False)]
        rates = [(after - before) / self.period for after, before in zip(outputs, x[:p], strict=True)]
        return [*outputs, *rates, *found[p:]]

    def record_map(self) -> RecordMap:
        return replace(super().record_map(), states_from_record=self._encoded)

    def _encoded(self, outputs: Array, rates: Array, inputs: Array) -> Array:
        """States (samples, states): the measured outputs and rates, and the hidden states that the encoder gives."""
        parts = self.parts(self.weights)
        measured = np.concatenate([outputs, rates], axis=1)
        scaled = measured / np.array(self.scales[: measured.shape[1]])
        return np.concatenate([measured, np.tanh(scaled @ parts["encoder"].T + parts["encoder_bias"])], axis=1)
