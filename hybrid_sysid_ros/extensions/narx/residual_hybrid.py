"""Physics plus a learned model of what its outputs miss, which runs freely beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from hybrid_sysid_ros.core import Parameter, Softsign, System, Variable
from hybrid_sysid_ros.core.mathematics import Scalar, clip
from hybrid_sysid_ros.core.parameters import of_data
from hybrid_sysid_ros.core.record_map import RecordMap
from hybrid_sysid_ros.core.steppers import Rates
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.extensions.narx.narx import Term
from hybrid_sysid_ros.extensions.narx.polynomial import Polynomial
from hybrid_sysid_ros.models.hybrid_system import CLIP, CORNER, features_of
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

RADIUS = 0.9995
"""Of the circle that holds the poles of every residual: what is left after 1000 steps is .6 of it at most."""


@dataclass(frozen=True, kw_only=True)
class ResidualHybrid(Wrapper):
    """y(k) = h(x(k), u(k)) + e(k): a gray box, and a model of its residual that runs freely beside it.

        e_i(k + 1) = sum_j a_ij e_i(k - j + 1) + S_i (sum_t theta_it prod r^E_it + n_i(r))
        r = features of the physics at k, u(k - 1), ..., u(k - nu + 1), and of each residual e, de, dde, ...

    each in its scale, d a backward difference; n: one layer of :class:`~.core.Softsign`. A term that is linear takes r
    as it is (none is linear in e: that is a); products take it within +-CLIP. The physics has no part in this: its
    states are those of the gray box alone.

    Stable by construction: a_i follow from reflection coefficients within [-1, 1] by the step-up recursion, and are
    damped by RADIUS^j, so that their poles lie within RADIUS (Schur and Cohn; Markel and Gray (1976), Linear prediction
    of speech, section 5.2). All else that sees e is bounded. So e is bounded wherever u and the physics are.

    States are those of the physics, the last ``output_lags`` residuals and the past inputs. They follow
    (M(s) - s) / period, which under a step of the ``period`` is the map s(k + 1) = M(s(k)), and a straight line between
    samples under a shorter one.

    Raises UserError where lags, weights or scales don't fit each other.
    """

    period: float
    """Of the residual's samples [s]: the step of the fit."""
    output_lags: int
    input_lags: int
    units: int
    """Of the network; 0: there is none."""
    exponents: tuple[tuple[Term, ...], ...]
    """E, for each output its terms, in the order of r."""
    learned: Array
    """theta of all outputs, then the network's weights."""
    reflections: tuple[float, ...] = ()
    """Of each output's residual, (outputs * output_lags,); zeros by default."""
    scales: tuple[float, ...] = ()
    """Of r, and S: fixed parameters; ones by default."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.output_lags, self.input_lags) < 1:
            raise UserError(f"residual: {self.output_lags} output and {self.input_lags} input lags; give 1 or more")
        width, outputs = len(self.regressors), len(self.outputs)
        for name, of, ones in (("reflections", outputs * self.output_lags, 0.0), ("scales", width + outputs, 1.0)):
            object.__setattr__(self, name, tuple(getattr(self, name)) or (ones,) * of)
            if len(getattr(self, name)) != of:
                raise UserError(f"residual: {len(getattr(self, name))} {name} for {of} of its design; fit again")
        terms = [term for of in self.exponents for term in of]
        size = len(terms) + self.network.size
        if len(self.learned) != size or len(self.exponents) != outputs or any(len(term) != width for term in terms):
            raise UserError(
                f"residual: {len(self.learned)} weights don't fit {len(terms)} terms of {width} regressors and "
                f"{self.units} units; fit again"
            )

    # ------------------------------------------------------------------ what it is made of

    @property
    def added_states(self) -> tuple[Variable, ...]:
        """The memory: residuals of each output, then past inputs, latest first."""
        residuals = [_lagged(f"residual_{y.name}", y.unit, j) for y in self.outputs for j in range(self.output_lags)]
        past = [_lagged(u.name, u.unit, j) for u in self.inputs for j in range(1, self.input_lags)]
        return (*residuals, *past)

    @property
    def regressors(self) -> tuple[Variable, ...]:
        """What r is of."""
        past = [_lagged(u.name, u.unit, j) for u in self.inputs for j in range(1, self.input_lags)]
        return (*features_of(self.physics), *past, *self.changes)

    @property
    def changes(self) -> tuple[Variable, ...]:
        """Those of the residuals themselves."""
        return tuple(
            Variable(name=f"{'d' * j}{'_' if j else ''}residual_{y.name}", unit=y.unit)
            for y, first in zip(self.outputs, self._firsts, strict=True)
            for j in range(first, self.output_lags)
        )

    @property
    def _firsts(self) -> tuple[int, ...]:
        """Of each output the first difference that counts: where the physics says that nothing depends on it, since it
        is none of its features, not the residual itself, which may drift.
        """
        physics = self.physics
        states, seen = ({item.name for item in items} for items in (physics.states, physics.features))
        return tuple(int(bool(seen) and y.name in states - seen) for y in self.outputs)

    @property
    def network(self) -> Softsign:
        """N."""
        count = len(self.regressors)
        return Softsign(features=count, units=self.units, outputs=len(self.outputs), at=sum(map(len, self.exponents)))

    @property
    def form(self) -> tuple[Any, ...]:
        shape = self.period, self.output_lags, self.input_lags, self.units, self.exponents
        return (type(self), self.physics.form, *shape)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        description = "Of the residual's own memory; within [-1, 1] it dies away."
        reflection = Parameter(name="", unit="", low=-1.0, high=1.0, start=0.0, learned=True, description=description)
        reflections = (
            replace(reflection, name=f"reflection_{j + 1}_{y.name}")
            for y in self.outputs
            for j in range(self.output_lags)
        )
        named = [(f"scale_{item.name}", item.unit) for item in self.regressors]
        named += [(f"scale_change_{item.name}", item.unit) for item in self.outputs]
        return (*self.physics.parameters, *reflections, *(of_data(name, unit) for name, unit in named))

    @property
    def values(self) -> Array:
        return np.concatenate([self.physics.values, self.reflections, self.scales])

    def bound(self, values: Sequence[Scalar]) -> ResidualHybrid:
        first = len(self.physics.parameters)
        then = first + len(self.reflections)
        physics, reflections = self.physics.bound(values[:first]), tuple(values[first:then])
        return replace(self, physics=physics, reflections=reflections, scales=tuple(values[then:]))

    @property
    def design(self) -> dict[str, Any]:
        """Everything but values and weights as plain data, from which :meth:`of` builds the system again."""
        names = "period", "output_lags", "input_lags", "units", "exponents"
        return {"physics": self.physics.design, **{name: getattr(self, name) for name in names}}

    @classmethod
    def of(cls, physics: System, design: Mapping[str, Any], weights: Array) -> ResidualHybrid:
        """The system of a :attr:`design` on its gray box. Raises UserError where the weights don't fit it."""
        return cls(
            physics=physics,
            period=float(design["period"]),
            output_lags=int(design["output_lags"]),
            input_lags=int(design["input_lags"]),
            units=int(design["units"]),
            exponents=tuple(tuple(tuple(term) for term in terms) for terms in design["exponents"]),
            learned=weights,
        )

    @property
    def weights(self) -> Array:
        return self.learned

    def with_weights(self, weights: Array) -> ResidualHybrid:
        return replace(self, learned=weights)

    def with_network(self, units: int, *, seed: int) -> ResidualHybrid:
        """The same with a network of its own, random and small, in the place of any other."""
        block = replace(self.network, units=units)
        learned = np.concatenate([self.learned[: block.at], block.initial(seed, output=0.05)])
        return replace(self, units=units, learned=learned)

    @property
    def sampling_time(self) -> float:
        return self.period

    def check(self) -> None:
        """Raise UserError as every system does, and for a residual that would not die away."""
        for item, value in zip(self.parameters, self.values, strict=True):
            if item.name.startswith("reflection_") and not -1.0 <= value <= 1.0:
                raise UserError(
                    f"residual: {item.name} = {value:g}: a reflection coefficient outside of [-1, 1] puts a pole "
                    "outside of the unit circle, so its free run is unstable; fit again"
                )
        super().check()

    # ------------------------------------------------------------------ the equation

    def rates(self, physics: Rates, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        """Those of the physics, and of the memory."""
        found, at = physics(x[: self._physical], u), self._physical
        moved = zip(self._following(x, u), x[at:], strict=False)
        return [*found, *((after - before) / self.period for after, before in moved)]

    def regressed(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> list[Scalar]:
        """R in its units, of states x (states,) and inputs u (inputs,)."""
        n = len(self.physics.declared_states)
        residuals, past = self._lags(x)
        changes: list[Scalar] = []
        for lags, first in zip(residuals, self._firsts, strict=True):
            changes += [*_differences(lags)][first:]
        return [*self.physics.feature(x[:n], u), *(value for lags in past for value in lags), *changes]

    def _following(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Iterator[Scalar]:
        """M: the memory a sample later."""
        residuals, past = self._lags(x)
        r = [value / scale for value, scale in zip(self.regressed(x, u), self.scales, strict=False)]
        held = [clip(value, -CLIP, CLIP, over=CORNER) for value in r]
        network = self.network(r) if self.units else [0.0] * len(residuals)
        sizes, none, at = self.scales[len(r) :], (0,) * len(r), 0
        for i, lags in enumerate(residuals):
            # A linear term reads the first half of what the polynomial is given, a product the second one.
            terms = tuple((*term, *none) if sum(term) < 2 else (*none, *term) for term in self.exponents[i])
            polynomial = Polynomial(exponents=terms, features=2 * len(r), at=at)
            driven = polynomial([*r, *held])[0] if terms else 0.0
            at += len(terms)
            own = coefficients(self.reflections[i * len(lags) : (i + 1) * len(lags)])
            yield sum((a * e for a, e in zip(own, lags, strict=True)), sizes[i] * (driven + network[i]))
            yield from lags[:-1]
        for value, lags in zip(u, past, strict=True):
            yield from [value, *lags][: len(lags)]

    def _lags(self, x: Sequence[Scalar]) -> tuple[list[list[Scalar]], list[list[Scalar]]]:
        """Residuals of each output, and past values of each input, latest first."""
        residuals, past, begin = self.output_lags, self.input_lags - 1, self._physical
        split = begin + len(self.reflections)
        return (
            [list(x[at : at + residuals]) for at in range(begin, split, residuals)],
            [list(x[split + j * past : split + (j + 1) * past]) for j in range(len(self.inputs))],
        )

    @property
    def plain_outputs(self) -> bool:
        return False

    def output(self, x: Sequence[Scalar], u: Sequence[Scalar]) -> Sequence[Scalar]:
        residuals, _ = self._lags(x)
        return [y + lags[0] for y, lags in zip(self.physics.output(self.physical_states(x), u), residuals, strict=True)]

    # ------------------------------------------------------------------ how it meets records

    def record_map(self) -> RecordMap:
        """The memory is a delay line: past inputs are those before each sample, and the physics leaves no residual."""
        own, at = super().record_map(), self._physical
        inputs_at = at + len(self.outputs) * self.output_lags

        def states_from_record(outputs: Array, rates: Array, inputs: Array) -> Array:
            states = own.states_from_record(outputs, rates, inputs)
            before = np.concatenate([inputs[:1], inputs[:-1]])
            past = np.repeat(before, self.input_lags - 1, axis=1)
            states[:, inputs_at : inputs_at + past.shape[1]] = past
            return states

        memory = range(at, at + len(self.added_states))
        rest = [index for index in own.unobserved if index not in memory]
        return replace(own, delay_line=memory, unobserved=rest, states_from_record=states_from_record)


def averaged_residual(members: Sequence[ResidualHybrid]) -> ResidualHybrid:
    """The mean of models beside one gray box: of their reflection coefficients, which is stable as they are, and of
    what drives their residuals: one polynomial, and one network that holds all of theirs.
    """
    first, outputs, at = members[0], len(members[0].outputs), members[0].network.at
    if len(members) == 1:
        return first
    weights = np.concatenate([member.learned[at:].reshape(first.units, -1) for member in members])
    weights[:, -outputs:] /= len(members)
    polynomial = np.mean([member.learned[:at] for member in members], axis=0)
    return replace(
        first,
        reflections=tuple(np.mean([member.reflections for member in members], axis=0).tolist()),
        units=first.units * len(members),
        learned=np.concatenate([polynomial, weights.ravel()]),
    )


def coefficients(reflections: Sequence[Scalar]) -> list[Scalar]:
    """a_1, a_2, ... of e(k) = sum_j a_j e(k - j), all of whose poles lie within RADIUS."""
    found: list[Scalar] = []
    for reflection in reflections:
        found = step_up(found, reflection)
    return [RADIUS ** (j + 1) * a for j, a in enumerate(found)]


def step_up(found: Sequence[Scalar], reflection: Scalar) -> list[Scalar]:
    """The coefficients of one lag more."""
    return [*(a - reflection * b for a, b in zip(found, reversed(found), strict=True)), reflection]


def _differences(lags: Sequence[Scalar]) -> Iterator[Scalar]:
    """e, de, dde, ...: backward differences at the latest value, as many as there are values."""
    left = list(lags)
    while left:
        yield left[0]
        left = [a - b for a, b in pairwise(left)]


def _lagged(name: str, unit: str, lag: int) -> Variable:
    return Variable(name=f"{name}_{lag}" if lag else name, unit=unit)
