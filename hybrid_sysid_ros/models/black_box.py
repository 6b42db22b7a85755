"""The black box: a state-space network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import System, Viscous, bounded
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.models.network import Network


@dataclass(frozen=True, kw_only=True)
class BlackBox(System):
    """v' = gain u - damping v + n(q, v, u): a network for the acceleration, with its straight part written out so that
    a fit starts from a stable simulation.
    """

    states = ("position [rad]", "velocity [rad/s]")
    inputs = ("drive [V]",)
    contacts = (Viscous(on="velocity", viscous="damping"),)
    delays = {"drive": "input_delay"}

    network: Network
    network_weights: NDArray[np.float64]
    gain: float = bounded(4.0, 0.0, 400.0, unit="rad/(s^2 V)")
    """Straight part, input."""
    damping: float = bounded(20.0, 0.0, 150.0, unit="1/s")
    """Straight part, velocity."""
    input_delay: float = bounded(0.004, 0.0, 0.03, unit="s")
    """Delay of the drive."""

    @property
    def form(self) -> tuple[Any, ...]:
        return (type(self), self.network)

    @property
    def design(self) -> dict[str, Any]:
        return asdict(self.network)

    @property
    def weights(self) -> NDArray[np.float64]:
        return self.network_weights

    def with_weights(self, weights: NDArray[np.float64]) -> BlackBox:
        return replace(self, network_weights=weights)

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return x[1], self.gain * u[0] + self.network(x, u)
