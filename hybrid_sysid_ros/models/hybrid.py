"""Physics plus a small learned residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Parameter, System
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.steppers import Motion
from hybrid_sysid_ros.models.network import Network


@dataclass(frozen=True, kw_only=True)
class Hybrid(System):
    """x' = f(x, u) + e_v n(x, u): the physics with a bounded network added to one of its rates.

    The network acts on the state that carries the first contact, or the last one where none does.
    """

    physics: System
    network: Network
    network_weights: NDArray[np.float64]

    def __post_init__(self) -> None:
        # A wrapper has the states and inputs of what it wraps.
        for name in ("states", "inputs", "outputs", "contacts", "stepper", "delays"):
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

    def bound(self, values: Sequence[Scalar]) -> Hybrid:
        return replace(self, physics=self.physics.bound(values))

    @property
    def design(self) -> dict[str, Any]:
        return asdict(self.network)

    @property
    def weights(self) -> NDArray[np.float64]:
        return self.network_weights

    def with_weights(self, weights: NDArray[np.float64]) -> Hybrid:
        return replace(self, network_weights=weights)

    def trained_on(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Hybrid:
        return replace(self, physics=self.physics.trained_on(low, high))

    def motion(self) -> Motion:
        """That of the physics, with the network among its rates."""
        motion = self.physics.motion()
        names = list(motion.names)
        index = names.index(self.contacts[0].on) if self.contacts else len(self.declared_states) - 1

        def rates(x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
            found = list(motion.rates(x, u))
            found[index] = found[index] + self.network(x, u)
            return found

        return replace(motion, rates=rates)

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self.physics.output(x, u)


def averaged(members: Sequence[Hybrid]) -> Hybrid:
    """The mean of hybrids of one form: of their parameters, and one network that is the mean of their networks."""
    network = members[0].network
    weights = np.concatenate([member.network_weights.reshape(network.units, -1) for member in members])
    weights[:, -1] /= len(members)
    return replace(
        members[0],
        physics=members[0].physics.with_values(np.mean([member.values for member in members], axis=0)),
        network=replace(network, units=network.units * len(members)),
        network_weights=weights.ravel(),
    )
