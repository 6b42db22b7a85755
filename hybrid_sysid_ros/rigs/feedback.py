"""Feedback: a control law with several outputs and inputs, by which a rig follows commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hybrid_sysid_ros.core import System, Variable
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.structured import numbers, refuse_unknown, section

SECTIONS = ("period", "follow", "wanted", "forward", "gains", "integral")
TERMS = 3
"""Number of terms of a command behind its reference model: value, rate, acceleration."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Feedback:
    """u = v + F c - K (y - W c) - I,  I' = G (y_f - r), every ``period`` and within the actuators' limits; SI units.

    An experiment adds v to the inputs. Each command passes a reference model 1 / (s / w + 1)^2, and c holds value r,
    rate and acceleration behind it: W c are the corresponding outputs, F c the inputs. The integral of an input stops
    while that input is at a limit.
    """

    period: float
    """[s]"""
    followed: tuple[int, ...]
    """Indices of the outputs that have commands."""
    bandwidths: Array
    """w, (followed,) [rad/s]."""
    wanted: Array
    """W (outputs, 3 followed)."""
    forward: Array
    """F (inputs, 3 followed)."""
    gains: Array
    """K (inputs, outputs)."""
    integral: Array
    """G (inputs, followed)."""

    @classmethod
    def of(cls, content: Mapping[str, Any], system: System, where: str) -> Feedback:
        """A feedback from a section of rig.yaml. Raises UserError for unknown names and other wrong values."""
        refuse_unknown(content, SECTIONS, where)
        outputs = [item.name for item in system.outputs]
        given = section(content, "follow", where, needed=True)
        for name in given:
            if name not in outputs:
                raise UserError(f"{where}.follow: {name} is no output; known are {', '.join(outputs)}")
        (period,) = numbers(content.get("period"), f"{where}.period", count=1)
        bandwidths = [numbers(value, f"{where}.follow.{name}", count=1)[0] for name, value in given.items()]
        if not (period > 0.0 and all(value > 0.0 for value in bandwidths)):
            raise UserError(f"{where}: period and the rates of follow must be above 0")
        followed = tuple(system.outputs[outputs.index(name)] for name in given)
        wanted = table(content, "wanted", (system.outputs, followed), where, terms=TERMS)
        for column, item in enumerate(followed):
            wanted[outputs.index(item.name), TERMS * column] = 1.0
        return cls(
            period=period,
            followed=tuple(outputs.index(item.name) for item in followed),
            bandwidths=np.array(bandwidths),
            wanted=wanted,
            forward=table(content, "forward", (system.inputs, followed), where, terms=TERMS),
            gains=table(content, "gains", (system.inputs, system.outputs), where),
            integral=table(content, "integral", (system.inputs, followed), where),
        )


Variables = tuple[Variable, ...]


def table(content: Mapping[str, Any], key: str, of: tuple[Variables, Variables], where: str, terms: int = 1) -> Array:
    """A matrix (rows, terms columns) from numbers by the names of rows and columns, 0 elsewhere; ``terms`` for each.

    Raises UserError for an unknown name.
    """
    rows, columns = ([item.name for item in variables] for variables in of)
    found = np.zeros((len(rows), terms * len(columns)))
    given = section(content, key, where)
    refuse_unknown(given, tuple(rows), f"{where}.{key}")
    for row in given:
        values = section(given, row, f"{where}.{key}")
        refuse_unknown(values, tuple(columns), f"{where}.{key}.{row}")
        for column, value in values.items():
            at = terms * columns.index(column)
            found[rows.index(row), at : at + terms] = numbers(value, f"{where}.{key}.{row}.{column}", count=terms)
    return found


Law = tuple[Array, Array, Array, Array, Array, Array, float]
"""A feedback for compiled loops: followed (as numbers), bandwidths, W, F, K, G, period."""
Limits = tuple[Array, Array]
"""Lowest and highest value of each input (inputs,)."""


def law_of(feedback: Feedback) -> Law:
    """A feedback for compiled loops."""
    return (
        np.array(feedback.followed, dtype=float),
        feedback.bandwidths,
        feedback.wanted,
        feedback.forward,
        feedback.gains,
        feedback.integral,
        feedback.period,
    )


@inner
def feedback_inputs(
    law: Any, limits: Any, y: Any, commands: Any, added: Any, model: Any, integrals: Any, u: Any
) -> None:
    """Write the inputs u (inputs,) for outputs y (outputs,), commands (followed,) and added inputs (inputs,).

    model (followed, 2), value and rate of each reference model, and integrals (inputs,) advance by a period.
    """
    followed, bandwidths, wanted, forward, gains, integral, period = law
    low, high = limits
    c = np.empty(wanted.shape[1])
    for f in range(model.shape[0]):
        w = bandwidths[f]
        c[3 * f] = model[f, 0]
        c[3 * f + 1] = model[f, 1]
        c[3 * f + 2] = w * w * (commands[f] - model[f, 0]) - 2.0 * w * model[f, 1]
    for j in range(u.shape[0]):
        value = added[j] - integrals[j]
        for k in range(c.shape[0]):
            value += forward[j, k] * c[k]
        for i in range(y.shape[0]):
            error = y[i]
            for k in range(c.shape[0]):
                error -= wanted[i, k] * c[k]
            value -= gains[j, i] * error
        u[j] = min(max(value, low[j]), high[j])
        if low[j] <= value <= high[j]:  # else it would wind up
            for f in range(model.shape[0]):
                integrals[j] += period * integral[j, f] * (y[int(followed[f])] - model[f, 0])
    for f in range(model.shape[0]):  # exactly, for a command that holds
        w = bandwidths[f]
        away, rate = model[f, 0] - commands[f], model[f, 1]
        faded, slope = np.exp(-w * period), rate + w * away
        model[f, 0] = commands[f] + (away + slope * period) * faded
        model[f, 1] = (rate - w * slope * period) * faded


@kernel
def _answer(
    law: Law, limits: Limits, y: Array, commands: Array, added: Array, model: Array, integrals: Array, u: Array
) -> None:
    feedback_inputs(law, limits, y, commands, added, model, integrals, u)


class Follower:
    """A running feedback, with its reference models and integrals."""

    def __init__(self, feedback: Feedback, limits: Limits) -> None:
        self._law, self._limits = law_of(feedback), limits
        self.model = np.zeros((len(feedback.followed), 2))
        """Value and rate of each command behind its reference model, (followed, 2)."""
        self.integrals = np.zeros(len(feedback.gains))
        """(inputs,)."""

    def answer(self, outputs: ArrayLike, commands: ArrayLike, added: ArrayLike) -> Array:
        """The inputs (inputs,) of the next period, for outputs (outputs,), commands (followed,) and added inputs
        (inputs,).
        """
        given = [np.ascontiguousarray(values, dtype=float) for values in (outputs, commands, added)]
        inputs = np.empty(len(self.integrals))
        _answer(self._law, self._limits, *given, self.model, self.integrals, inputs)
        return inputs
