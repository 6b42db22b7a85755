"""Physics plus a small learned residual."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.equations import Law, Motion, Operations, Parameter
from hybrid_sysid_ros.models.network import Network


@dataclass(frozen=True, kw_only=True)
class Hybrid(Motion):
    """x' = f(x, u) + e_v n(x, u): the physics' equation with a bounded network added to one of its rates.

    The network acts on the state that carries the friction, or the last one where none does.
    """

    physics: Motion
    network: Network
    network_weights: NDArray[np.float64]

    def __post_init__(self) -> None:
        # A wrapper has the states and inputs of what it wraps.
        for name in ("states", "inputs", "outputs", "kinematics", "friction_state", "bristle_state"):
            object.__setattr__(self, name, getattr(self.physics, name))

    @property
    def form(self) -> tuple[Any, ...]:
        return (type(self), self.physics.form, self.network)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.physics.parameters

    @property
    def values(self) -> NDArray[np.float64]:
        return self.physics.values

    def with_values(self, values: NDArray[np.float64]) -> Hybrid:
        return dataclasses.replace(self, physics=self.physics.with_values(values))

    @property
    def weights(self) -> NDArray[np.float64]:
        return self.network_weights

    def with_weights(self, weights: NDArray[np.float64]) -> Hybrid:
        return dataclasses.replace(self, network_weights=weights)

    def trained_on(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Hybrid:
        return dataclasses.replace(self, physics=self.physics.trained_on(low, high))

    def law(self, operations: Operations) -> Law:
        physics = operations.function(self.physics.law(operations))
        network = self.network.function(operations)
        index = len(self.states) - 1 if self.friction_state is None else self.friction_state
        after = index + 1

        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            rates, friction = physics(x, u, p, w)
            return (*rates[:index], rates[index] + network(x, u, w), *rates[after:]), friction

        return law
