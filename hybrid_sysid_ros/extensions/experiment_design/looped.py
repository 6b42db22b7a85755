"""A system in the loops by which a rig is driven in experiments: its inputs are the loops' references."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.core.steppers import Rates
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Looped(Wrapper):
    """x' = f(x, clip(g (r - y) + i)),  i' = g w (r - y): the inputs of a system by its rig's loops, at every moment.

    Low-passes of the loops are left out, and an integral part does not stop at the limits.
    """

    loops: tuple[tuple[int, int, float, float], ...]
    """Input, state that is its output, gain g [unit of the input per SI] and rate w of the integral [1/s]."""
    limits: tuple[tuple[float, float], ...]
    """Lowest and highest value of each input."""

    @property
    def added_states(self) -> tuple[Variable, ...]:
        return tuple(Variable(name=f"integral_{index}", unit="") for index, *_ in self.loops)

    def acting(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        found = list(u)
        for number, (index, state, gain, _) in enumerate(self.loops):
            found[index] = gain * (u[index] - x[state]) + x[self._physical + number]
        return [clip(value, low, high) for value, (low, high) in zip(found, self.limits, strict=True)]

    def rates(self, physics: Rates, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        more = [gain * rate * (u[index] - x[state]) for index, state, gain, rate in self.loops]
        return [*physics(x[: self._physical], self.acting(x, u)), *more]

    def inputs_of(self, states: Array, driving: Array) -> Array:
        """The inputs (steps, inputs) that acted in a run with such states and references at each step."""
        found, ends = driving.copy(), np.array(self.limits).T
        for number, (index, state, gain, _) in enumerate(self.loops):
            found[:, index] = gain * (driving[:, index] - states[:, state]) + states[:, self._physical + number]
        return np.clip(found, *ends)


def looped(system: System, rig: Rig) -> Looped:
    """A system in the loops of its rig. Raises UserError for a loop of an output that is no state."""
    if rig.experiments.loops and not system.plain_outputs:
        raise UserError(f"{rig.file}: experiments.loops feed back an output that is no state of the model")
    rows = [
        (index, system.measured[loop.output], loop.gain / rig.sensors[loop.output].scale, loop.integral)
        for index, loop in rig.experiments.loops.items()
    ]
    return Looped(physics=system, loops=tuple(rows), limits=tuple((item.low, item.high) for item in rig.actuators))
