"""Physics plus a small learned residual."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.core import Parameter, Softsign, System, Variable
from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.core.parameters import of_data
from hybrid_sysid_ros.core.steppers import Motion
from hybrid_sysid_ros.support.errors import UserError

Array = NDArray[np.float64]

CLIP = 1.5
"""Features are held within +-CLIP of their scale: beyond it a network knows nothing."""

CORNER = 0.05
"""Width over which that is rounded where a solver needs derivatives, in their scale."""


@dataclass(frozen=True, kw_only=True)
class Hybrid(System):
    """x' = f(x, u) + E S n(clip(z / s)): the physics with a bounded network added to some of its rates.

    z: the features of the physics, or the declared states, then the inputs (hidden deflections are none); s, S: scales,
    which are fixed parameters, so that networks of one shape share their compiled code; n: one layer of
    :class:`~.core.Softsign` with an output for each state in ``on``. |S n| <= S sum |a|, whatever the motion.
    Raises UserError where weights or scales don't fit the shape.
    """

    physics: System
    on: tuple[str, ...]
    """States to whose rates the network adds."""
    units: int
    """Of its hidden layer."""
    scales: tuple[float, ...]
    """Of the features, and of the network's outputs."""
    network_weights: Array

    def __post_init__(self) -> None:
        # A wrapper has the states and inputs of what it wraps.
        for name in ("states", "inputs", "outputs", "contacts", "stepper", "delays", "doubtful_terms"):
            object.__setattr__(self, name, getattr(self.physics, name))
        unknown = set(self.on) - {item.name for item in self.declared_states}
        if unknown or not self.on:
            raise UserError(f"hybrid: its network is on {', '.join(sorted(unknown)) or 'nothing'}, which is no state")
        if len(self.scales) != self.block.features + len(self.on) or len(self.network_weights) != self.block.size:
            raise UserError(
                f"hybrid: {len(self.network_weights)} weights don't fit the network of {self.units} units, or "
                f"{len(self.scales)} scales its features; fit again"
            )

    @property
    def block(self) -> Softsign:
        """The network."""
        return Softsign(features=len(features_of(self.physics)), units=self.units, outputs=len(self.on))

    @property
    def form(self) -> tuple[Any, ...]:
        return (type(self), self.physics.form, self.on, self.units)

    @property
    def plain_outputs(self) -> bool:
        return self.physics.plain_outputs

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        units = {item.name: item.unit for item in self.declared_states}
        named = [(f"scale_{item.name}", item.unit) for item in features_of(self.physics)]
        named += [(f"scale_{name}_rate", f"{units[name]}/s") for name in self.on]
        return (*self.physics.parameters, *(of_data(name, unit) for name, unit in named))

    @property
    def values(self) -> Array:
        return np.concatenate([self.physics.values, self.scales])

    def bound(self, values: Sequence[Scalar]) -> Hybrid:
        physical = len(self.physics.parameters)
        return replace(self, physics=self.physics.bound(values[:physical]), scales=tuple(values[physical:]))

    @property
    def design(self) -> dict[str, Any]:
        return {"units": self.units, "on": list(self.on), "physics": self.physics.design}

    @property
    def weights(self) -> Array:
        return self.network_weights

    def with_weights(self, weights: Array) -> Hybrid:
        return replace(self, network_weights=weights)

    def trained_on(self, low: Array, high: Array) -> Hybrid:
        return replace(self, physics=self.physics.trained_on(low, high))

    def motion(self) -> Motion:
        """That of the physics, with the network among its rates."""
        motion, block = self.physics.motion(), self.block
        places = [list(motion.names).index(name) for name in self.on]

        def rates(x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
            found = list(motion.rates(x, u))
            features, outputs = self.scales[: block.features], self.scales[block.features :]
            scaled = [
                clip(value / scale, -CLIP, CLIP, over=CORNER)
                for value, scale in zip(self.physics.feature(x, u), features, strict=True)
            ]
            for index, value, scale in zip(places, block(scaled), outputs, strict=True):
                found[index] = found[index] + scale * value
            return found

        return replace(motion, rates=rates)

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self.physics.output(x, u)

    @property
    def shown(self) -> Mapping[int, tuple[int, bool]]:
        return self.physics.shown

    def observed(self, outputs: Array, rates: Array, inputs: Array) -> Array:
        return self.physics.observed(outputs, rates, inputs)


def features_of(system: System) -> tuple[Variable, ...]:
    """What a network beside a system sees."""
    return tuple(system.features) or (*system.declared_states, *system.inputs)


def averaged(members: Sequence[Hybrid]) -> Hybrid:
    """The mean of hybrids of one shape: of their parameters, and one network that is the mean of their networks."""
    first, outputs = members[0], len(members[0].on)
    weights = np.concatenate([member.network_weights.reshape(first.units, -1) for member in members])
    weights[:, -outputs:] /= len(members)
    return replace(
        first,
        physics=first.physics.with_values(np.mean([member.physics.values for member in members], axis=0)),
        units=first.units * len(members),
        network_weights=weights.ravel(),
    )
