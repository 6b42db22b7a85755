"""The lecture's black box: a state-space network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Law, Motion, Operations, Variable, parameter
from hybrid_sysid_ros.models.network import Network


@dataclass(frozen=True, kw_only=True)
class BlackBox(Motion):
    """v' = gain u - damping v + n(q, v, u): a network for the acceleration, with its straight part written out so that
    a fit starts from a stable simulation.
    """

    states = (Variable(name="position", unit="rad"), Variable(name="velocity", unit="rad/s"))
    inputs = (Variable(name="drive", unit="V"),)
    kinematics: ClassVar[Mapping[int, int]] = {0: 1}
    friction_state = 1

    network: Network
    network_weights: NDArray[np.float64]
    gain: float = parameter(4.0, 0.0, 400.0, unit="rad/(s^2 V)", description="straight part, input")
    damping: float = parameter(20.0, 0.0, 150.0, unit="1/s", description="straight part, velocity")
    input_delay: float = parameter(0.004, 0.0, 0.03, unit="s", description="delay of the drive")

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

    def law(self, operations: Operations) -> Law:
        network = self.network.function(operations)

        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            return (x[1], p.gain * u[0] + network(x, u, w)), (0.0, 0.0, p.damping)

        return law
