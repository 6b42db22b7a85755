"""A system whose inputs are off by a constant of each record's own, while it is fitted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hybrid_sysid_ros.core import Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Biased(Wrapper):
    """x' = f(x, u + S b),  b' = 0: a state b for each input, which no record shows and each begins with one of its own.

    As a fit's initial states are nuisances with priors, so is b, which counts in its prior deviation S.
    """

    spreads: tuple[float, ...]
    """S, prior deviations of the biases in the inputs' units, (inputs,)."""

    @property
    def added_states(self) -> tuple[Variable, ...]:
        return tuple(Variable(name=f"bias_{item.name}", unit="") for item in self.inputs)

    def acting(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        biases = x[self._physical :]
        return [value + spread * b for value, spread, b in zip(u, self.spreads, biases, strict=False)]

    def biases(self, nuisances: Mapping[str, Array]) -> dict[str, Array]:
        """Of each input in each record, (records,) in its unit, from what a fit added to the initial states."""
        return {
            item.name: spread * nuisances[f"bias_{item.name}"]
            for item, spread in zip(self.inputs, self.spreads, strict=True)
        }

    def record_map(self) -> RecordMap:
        """That of the physics, with the biases among what no record tells."""
        at = range(self._physical, self._physical + len(self.inputs))
        return replace(super().record_map(), unobserved=[*self.physics.record_map().unobserved, *at])
