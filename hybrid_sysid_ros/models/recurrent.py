"""A recurrent network: the black box with memory of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Recurrence, Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.networks import GatedUnits
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

PERIOD = 0.025
"""Sampling time [s] where the input is averaged."""

SHORTEST, LONGEST = 0.1, 2.0
"""Memories [s] of the hidden units before training."""

READ = 2
"""States before the hidden ones."""


@dataclass(frozen=True, kw_only=True)
class Recurrent(Recurrence):
    """A gated recurrent unit (GRU): hidden states h, each in [-1, 1], driven by the mean input u of each period.

        r  = s(A_r u / U + b_r + W_r h)                reset      s(a) = (1 + tanh(a / 2)) / 2
        k  = s(A_k u / U + b_k + W_k h)                keep
        n  = tanh(A_n u / U + b_n + r (W_n h + c))     new
        h+ = k h + (1 - k) n
        q+ = Q (d . h+ + e),    v+ = (q+ - q) / period

    Cho et al. (2014), Learning phrase representations using RNN encoder-decoder, section 2.3, with the reset gate after
    the matrix, as cuDNN and PyTorch have it. A mean of values in [-1, 1] stays there, so |q| <= Q (sum |d| + |e|) under
    any input. A simulation begins from one measured position and rate, h = tanh(E (q / Q, v / V) + f): training learns
    E and f beside the rest, and no warm-up is needed.

    Q, V, U: scales of position [rad], rate [rad/s] and drive [V]. network_weights (size,): all :meth:`parts`, flat.
    Raises UserError where they don't fit the units.
    """

    inputs = ("drive [V]",)

    units: int = 24
    position_scale: float = 1.0
    rate_scale: float = 1.0
    drive_scale: float = 1.0
    network_weights: Array | None = None
    """None: zeros, a network that knows nothing yet."""

    def __post_init__(self) -> None:
        size = sum(int(np.prod(shape)) for shape in self.shapes.values())
        weights = np.zeros(size) if self.network_weights is None else self.network_weights
        if self.units < 1 or len(weights) != size:
            raise UserError(f"recurrent network: {len(weights)} weights, but {self.units} units have {size}")
        object.__setattr__(self, "network_weights", weights)
        hidden = (Variable(name=f"hidden_{i + 1}", unit="") for i in range(self.units))
        position, rate = Variable(name="position", unit="rad"), Variable(name="velocity", unit="rad/s")
        object.__setattr__(self, "states", (position, rate, *hidden))
        object.__setattr__(self, "outputs", (position,))

    @classmethod
    def of(cls, design: Mapping[str, Any], weights: Array) -> Recurrent:
        """The equation of a :attr:`design` with its weights (size,). Raises UserError where they don't fit."""
        return cls(**design, network_weights=weights)

    @property
    def design(self) -> dict[str, Any]:
        """Everything but the weights as plain data, from which :meth:`of` builds the equation again."""
        names = ("period", "units", "position_scale", "rate_scale", "drive_scale")
        return {name: getattr(self, name) for name in names}

    @property
    def kinematics(self) -> Mapping[int, int]:
        return {0: 1}

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parts of the weights, in their order; rows of three times the units are r, k, n."""
        units = self.units
        return {
            "drive": (3 * units, 1),
            "bias": (3 * units,),
            "recurrent": (3 * units, units),
            "reset_bias": (units,),
            "readout": (units,),
            "readout_bias": (1,),
            "encoder": (units, 2),
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
        """The same equation with random weights, and memories spread from SHORTEST to LONGEST evenly in the logarithm.

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
        return (type(self), self.units, self.position_scale, self.drive_scale, self.period)

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        layer = GatedUnits(units=self.units, size=len(self.weights))
        readout, *hidden = layer([u[0] / self.drive_scale, *x[READ:]])
        position = self.position_scale * readout
        return [position, (position - x[0]) / self.period, *hidden]

    def observed(self, outputs: Array, rates: Array, inputs: Array) -> Array:
        """States (samples, states): the measured position and rate, and the hidden states that the encoder gives."""
        parts = self.parts(self.weights)
        measured = np.column_stack([outputs[:, 0] / self.position_scale, rates[:, 0] / self.rate_scale])
        hidden = np.tanh(measured @ parts["encoder"].T + parts["encoder_bias"])
        return np.column_stack([outputs[:, 0], rates[:, 0], hidden])
