"""A system in the loops by which a rig is driven in experiments: its inputs are the loops' references."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from hybrid_sysid_ros.core import ImplicitFriction, System, Variable
from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.core.steppers import Rates
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.rigs.sensor import LowPass, LowPassFilter
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

LAGS = 2
"""That stand for a delay: their phase is right within a hundredth where it is a fifth of a radian."""


@dataclass(frozen=True, kw_only=True)
class Looped(Wrapper):
    """x' = f(x, clip(g (r - z) + i)),  i' = g w (r - z): the inputs of a system by its rig's loops, at every moment.

    z is the output behind its sensor's low-pass and, by a chain of lags, as late as the input acts; the states of both
    go from step to step as if the output held over each. An integral part does not stop at the limits.
    """

    loops: tuple[tuple[int, int, float, float], ...]
    """Input, state that is its output, gain g [unit of the input per SI] and rate w of the integral [1/s]."""
    limits: tuple[tuple[float, float], ...]
    """Lowest and highest value of each input."""
    filters: tuple[tuple[tuple[float, ...], ...], ...]
    """Rates of each loop's low-pass and lags: a row for each state, by these and by the output; none without both."""
    late: tuple[int, ...]
    """Steps after which the input of each loop acts."""

    @property
    def added_states(self) -> tuple[Variable, ...]:
        integrals = [f"integral_{index}" for index, *_ in self.loops]
        filtered = [f"low_pass_{k}_{row}" for k, rows in enumerate(self.filters) for row in range(len(rows))]
        return tuple(Variable(name=name, unit="") for name in (*integrals, *filtered))

    @property
    def _fed_back(self) -> list[int]:
        """The state that each loop feeds back."""
        ends = self._physical + len(self.loops) + np.cumsum([len(rows) for rows in self.filters])
        pairs = zip(self.loops, self.filters, ends.tolist(), strict=True)
        return [end - 1 if rows else state for (_, state, *_), rows, end in pairs]

    def acting(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        found = list(u)
        for number, ((index, _, gain, _), back) in enumerate(zip(self.loops, self._fed_back, strict=True)):
            found[index] = gain * (u[index] - x[back]) + x[self._physical + number]
        return [clip(value, low, high) for value, (low, high) in zip(found, self.limits, strict=True)]

    def rates(self, physics: Rates, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        loops = list(zip(self.loops, self._fed_back, self.filters, strict=True))
        more = [gain * rate * (u[index] - x[back]) for (index, _, gain, rate), back, _ in loops]
        for (_, state, *_), back, rows in loops:
            given = [*x[back + 1 - len(rows) : back + 1], x[state]]
            more += [sum(a * value for a, value in zip(row, given, strict=True)) for row in rows]
        return [*physics(x[: self._physical], self.acting(x, u)), *more]

    def inputs_of(self, states: Array, driving: Array) -> Array:
        """The inputs (steps, inputs) in a run with such states and references at each step, before they act."""
        found, ends = driving.copy(), np.array(self.limits).T
        rows = zip(self.loops, self._fed_back, self.late, strict=True)
        for number, ((index, _, gain, _), back, late) in enumerate(rows):
            then = np.concatenate([states[late:], np.repeat(states[-1:], late, axis=0)])
            found[:, index] = gain * (driving[:, index] - then[:, back]) + then[:, self._physical + number]
        return np.clip(found, *ends)


def looped(system: System, rig: Rig, step: float) -> Looped:
    """A system in the loops of its rig, for runs of a step [s]. Raises UserError for a loop of an output that is no
    state.
    """
    if rig.experiments.loops and not system.plain_outputs:
        raise UserError(f"{rig.file}: experiments.loops feed back an output that is no state of the model")
    rows = [
        (index, system.measured[loop.output], loop.gain / rig.sensors[loop.output].scale, loop.integral)
        for index, loop in rig.experiments.loops.items()
    ]
    euler, delays = isinstance(system.stepper, ImplicitFriction), system.input_delays.tolist()
    filters = [
        _rates_of(rig.sensors[loop.output].low_pass, delays[index], step, euler=euler)
        for index, loop in rig.experiments.loops.items()
    ]
    limits = tuple((item.low, item.high) for item in rig.actuators)
    late = tuple(round(delays[index] / step) for index in rig.experiments.loops)
    return Looped(physics=system, loops=tuple(rows), limits=limits, filters=tuple(filters), late=late)


def _rates_of(part: LowPass | None, delay: float, step: float, *, euler: bool) -> tuple[tuple[float, ...], ...]:
    """Rates A, b of a low-pass and of LAGS lags that take a delay [s] together. Where their states step by Euler's
    method they are (exp(A h) - 1) / h, which takes them to where they go if the output holds, since a model's step is
    often too long for a low-pass of high order.
    """
    order, lags = 0 if part is None else part.order, LAGS if delay > 0.0 else 0
    if not order + lags:
        return ()
    rates = np.zeros((order + lags + 1, order + lags + 1))
    if part is not None:
        plain = LowPassFilter(part, step)
        rates[:order, :order], rates[:order, -1] = plain.transition - np.eye(order), plain.gain
    for row in range(order, order + lags):
        rates[row, row], rates[row, row - 1] = -LAGS * step / delay, LAGS * step / delay
    found = (expm(rates) - np.eye(len(rates)) if euler else rates)[:-1] / step
    return tuple(tuple(row) for row in found.tolist())
