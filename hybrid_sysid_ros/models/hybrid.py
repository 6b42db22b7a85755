"""Physics plus a small learned residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Equation, Law, Motion, Operations, Parameter
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
        return replace(self, physics=_motion(self.physics.with_values(values)))

    @property
    def design(self) -> dict[str, Any]:
        return asdict(self.network)

    @property
    def weights(self) -> NDArray[np.float64]:
        return self.network_weights

    def with_weights(self, weights: NDArray[np.float64]) -> Hybrid:
        return replace(self, network_weights=weights)

    def trained_on(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Hybrid:
        return replace(self, physics=_motion(self.physics.trained_on(low, high)))

    def law(self, operations: Operations) -> Law:
        physics = operations.function(self.physics.law(operations))
        network = self.network.function(operations)
        index = len(self.states) - 1 if self.friction_state is None else self.friction_state
        after = index + 1

        def law(x: Any, u: Any, p: Any, w: Any) -> tuple[Any, Any]:
            rates, friction = physics(x, u, p, w)
            return (*rates[:index], rates[index] + network(x, u, w), *rates[after:]), friction

        return law


def averaged(members: Sequence[Hybrid]) -> Hybrid:
    """The mean of hybrids of one form: of their parameters, and one network that is the mean of their networks."""
    network = members[0].network
    weights = np.concatenate([member.network_weights.reshape(network.units, -1) for member in members])
    weights[:, -1] /= len(members)
    return replace(
        members[0],
        physics=_motion(members[0].physics.with_values(np.mean([member.values for member in members], axis=0))),
        network=replace(network, units=network.units * len(members)),
        network_weights=weights.ravel(),
    )


def _motion(equation: Equation) -> Motion:
    """What changing values leaves a motion, for the type checker."""
    assert isinstance(equation, Motion)
    return equation
