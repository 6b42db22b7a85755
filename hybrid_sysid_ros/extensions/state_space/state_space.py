"""A state-space model in discrete time whose states have no meaning of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Parameter, Recurrence, Variable
from hybrid_sysid_ros.core.mathematics import Scalar
from hybrid_sysid_ros.core.parameters import of_data
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.extensions.state_space.affine_map import AffineMap
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RIDGE = 1e-8
"""Usual weight of the squared weights of units."""


@dataclass(frozen=True, kw_only=True)
class StateSpace(Recurrence):
    """x+ = A x + B u + b + V f(P (x, u) + q),  y = C x + D u + d, in scaled inputs and outputs.

    Inputs and outputs are counted from their means in the training data and in their deviations, which are fixed
    parameters. Each unit of the hidden layer has a row of P and a column of V; f is tanh, or a power for which
    :class:`~.affine_map.AffineMap` limits the argument. Without units the model is linear.

    Raises UserError where the weights don't fit the order.
    """

    outputs: tuple[Variable, ...]  # type: ignore[misc]
    inputs: tuple[Variable, ...]  # type: ignore[misc]
    order: int
    """Number of states."""
    units: int = 0
    power: int = 0
    """Of the hidden layer; 0: it is of tanh."""
    dead: tuple[int, ...] = ()
    """Samples by which each input acts later, (inputs,); none by default."""
    scales: tuple[float, ...] = ()
    """Means of outputs and inputs, then their deviations; zeros and ones by default."""
    trials: tuple[tuple[float, ...], ...] = ()
    """Orders that were compared: order, error in held-out blocks, and its standard error."""
    map_weights: Array | None = None
    """Weights of both maps, (size,); None: zeros."""

    def __post_init__(self) -> None:
        count = len(self.outputs) + len(self.inputs)
        size = self.transition.size + self.readout.size
        weights = np.zeros(size) if self.map_weights is None else self.map_weights
        scales = self.scales or (0.0,) * count + (1.0,) * count
        if self.order < 1 or len(weights) != size or len(scales) != 2 * count:
            raise UserError(
                f"state space: {len(weights)} weights for {size} of order {self.order}, or {len(scales)} scales for "
                f"{count} signals; fit again"
            )
        taken = {item.name for item in (*self.outputs, *self.inputs)}
        prefix = "state" if not any(name.startswith("state_") for name in taken) else "hidden_state"
        states = tuple(Variable(name=f"{prefix}_{i + 1}", unit="") for i in range(self.order))
        late = zip(self.inputs, self.dead, strict=False)
        delays = {item.name: self.period * samples for item, samples in late if samples}
        made = {"map_weights": weights, "scales": tuple(scales), "states": states, "delays": delays}
        for name, value in made.items():
            object.__setattr__(self, name, value)

    @property
    def transition(self) -> AffineMap:
        """The map from states and inputs to the next states."""
        wide = self.order + len(self.inputs)
        return AffineMap(features=wide, outputs=self.order, units=self.units, power=self.power)

    @property
    def readout(self) -> AffineMap:
        """The map from states and inputs to outputs."""
        wide = self.order + len(self.inputs)
        return AffineMap(features=wide, outputs=len(self.outputs), at=self.transition.size)

    @classmethod
    def of(cls, design: Mapping[str, Any], weights: Array) -> StateSpace:
        """The system of a :attr:`design` with its weights (size,). Raises UserError where they don't fit."""
        variables = {name: tuple(Variable(**item) for item in design[name]) for name in ("outputs", "inputs")}
        plain = {name: tuple(design.get(name, ())) for name in ("scales", "dead")}  # older ones had no dead time
        plain |= {"trials": tuple(map(tuple, design["trials"]))}
        return cls(**{**design, **variables, **plain}, map_weights=weights)

    @property
    def design(self) -> dict[str, Any]:
        """Everything but the weights as plain data, from which :meth:`of` builds the system again."""
        variables = {name: [asdict(item) for item in getattr(self, name)] for name in ("outputs", "inputs")}
        plain = {name: getattr(self, name) for name in ("period", "order", "units", "power")}
        rows = {"dead": list(self.dead), "trials": [list(row) for row in self.trials]}
        return {**plain, "scales": list(self.scales), **rows, **variables}

    @property
    def form(self) -> tuple[Any, ...]:
        return (type(self), self.order, self.units, self.power, len(self.inputs), len(self.outputs))

    @property
    def kinematics(self) -> Mapping[int, int]:
        return {}

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        signals = (*self.outputs, *self.inputs)
        means = (of_data(f"mean_{item.name}", item.unit, low=-1e12) for item in signals)
        return (*means, *(of_data(f"scale_{item.name}", item.unit) for item in signals))

    @property
    def values(self) -> Array:
        return np.array(self.scales)

    def bound(self, values: Sequence[Scalar]) -> StateSpace:
        return replace(self, scales=tuple(values))

    @property
    def weights(self) -> Array:
        assert self.map_weights is not None
        return self.map_weights

    def with_weights(self, weights: Array) -> StateSpace:
        return replace(self, map_weights=weights)

    def _scaled(self, u: Sequence[Scalar]) -> list[Scalar]:
        count, p = len(self.outputs) + len(self.inputs), len(self.outputs)
        pairs = zip(u, self.scales[p:count], self.scales[count + p :], strict=True)
        return [(value - mean) / scale for value, mean, scale in pairs]

    def law(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        return self.transition([*x, *self._scaled(u)])

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        count, p = len(self.outputs) + len(self.inputs), len(self.outputs)
        found = self.readout([*x, *self._scaled(u)])
        pairs = zip(found, self.scales[:p], self.scales[count : count + p], strict=True)
        return [mean + scale * value for value, mean, scale in pairs]

    def fitted_again(self, records: Sequence[tuple[Array, Array]], iterations: int) -> StateSpace:
        """This model after some more iterations, of a fit to other stretches of its inputs and outputs, which make it
        no slower than it is: few samples take a drift for a pole.
        """
        # Here, since a model that is only loaded needs nothing that fits.
        from hybrid_sysid_ros.extensions.state_space.refinement import acting, calm, refine, unit_states
        from hybrid_sysid_ros.extensions.state_space.tangents import Sizes

        p, m = len(self.outputs), len(self.inputs)
        sizes = Sizes(states=self.order, inputs=m, outputs=p, units=self.units, power=self.power)
        means, scales = np.split(np.array(self.scales), 2)
        scaled = [((u - means[p:]) / scales[p:], (y - means[:p]) / scales[:p]) for u, y in records]
        stretches = [acting(item, self.dead) for item in scaled]
        weights, firsts = unit_states(self.weights, sizes, stretches, None)
        level = weights[sizes.readout_at :].reshape(p, sizes.wide)[:, -1]
        given: dict[str, Any] = {"through": bool(np.any(self.matrices()[3])), "ridge": RIDGE}
        met = refine(weights, sizes, stretches, **given, iterations=1, firsts=firsts).mean_square
        rest = calm(level, met, m)
        given |= {"iterations": iterations, "widest": self.radius}
        return self.with_weights(refine(weights, sizes, [*stretches, rest], **given).weights)

    def record_map(self) -> RecordMap:
        """No state is measured: all initial values are estimated from a record's first samples."""

        def states_from_record(outputs: Array, rates: Array, inputs: Array) -> Array:
            return np.zeros((len(outputs), self.order))

        found = super().record_map()
        return replace(
            found,
            reconstructible={},
            delay_line=range(0),
            unobserved=range(self.order),
            states_from_record=states_from_record,
        )

    def matrices(self) -> tuple[Array, Array, Array, Array]:
        """A (order, order), B (order, inputs), C (outputs, order) and D (outputs, inputs), without the units."""
        wide, n = self.order + len(self.inputs) + 1, self.order
        state = self.weights[: n * wide].reshape(n, wide)
        output = self.weights[self.transition.size :].reshape(len(self.outputs), wide)
        return state[:, :n], state[:, n:-1], output[:, :n], output[:, n:-1]

    @property
    def radius(self) -> float:
        """Magnitude of the largest pole of the linear part."""
        return float(np.abs(np.linalg.eigvals(self.matrices()[0])).max())
