"""Gray boxes: the rig's system, further ones that the rig provides, or a linear system with a friction law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.parameters import scale_of
from hybrid_sysid_ros.core.symbolic import linearised
from hybrid_sysid_ros.core.wrappers import Wrapper
from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.models.linear import REACH, Friction, Linear
from hybrid_sysid_ros.models.structure import FitContext, Magnitudes, Option, Options, Structure
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.extensions import provided

FIT_OPTIONS = {
    "starts": Option(
        default=1,
        low=1,
        high=32,
        kind="int",
        description="Initial points of the fit; the best one is used.",
        searched=False,
    ),
    "input_bias": Option(
        default=0.0,
        low=0.0,
        high=0.05,
        kind="float",
        description="Prior deviation of a constant input bias of each record, relative to the span; 0: no bias.",
    ),
}
"""Options of every fit of physics."""
STICKING_STARTS = 3
"""Initial points of a system that sticks, whose cost has corners in which a search ends early."""
STRAIGHT = "straight"
"""The linear system in which no state is in another one's rate, on which a black box builds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedLaw:
    """The rig's law at its initial values, linearised around the mean of training data."""

    states: Array
    """Derivatives of the rates of the declared states by these, (states, states)."""
    inputs: Array
    """Derivatives by the inputs, (states, inputs)."""
    efforts: tuple[float, ...]
    """Effect of the inputs on each rate, at the magnitudes of the data, (states,)."""

    @classmethod
    def of(cls, physics: System, sizes: Magnitudes) -> LinearisedLaw:
        """The linearised law of a rig's system."""
        own = physics.with_values([item.start for item in physics.parameters])
        n, at = len(own.declared_states), sizes.centre
        a, b = linearised(own, np.append(at[:n], np.zeros(len(own.states) - n)), at[n:])
        # Where inputs have no effect on a rate, or one outside an entry's bounds relative to the states' effect, the
        # states' effect counts. On velocities it says little, since springs between positions cancel.
        effects, through = np.abs(b) @ sizes.scales[n:], np.abs(a) @ sizes.scales[:n]
        moves = np.isin(np.arange(n), [*own.kinematics.values()])
        effects = np.where(effects > np.where(moves, 0.0, through / REACH), effects, through)
        return cls(states=a, inputs=b, efforts=tuple(scale_of(value) if value > 0.0 else 1.0 for value in effects))

    def entries(self, system: Linear) -> dict[str, float]:
        """Initial values of the entries of a linear system."""
        rows = [item.name for item in system.origin.declared_states]
        columns = [*rows, *(item.name for item in system.origin.inputs)]
        known, found = {item.name for item in system.parameters}, {}
        for row, values in zip(rows, np.concatenate([self.states, self.inputs], axis=1), strict=True):
            for column, value in zip(columns, values, strict=True):
                name, sign = (f"{row}_per_{column}", 1.0)
                if name not in known and row == column:
                    name, sign = f"{row}_damping", -1.0
                if name in known and value:
                    found[name] = sign * float(value)
        return found


class GrayBox(Structure):
    """Physics alone: least squares on free runs, a linear system from two starts."""

    summary = "physics with parameters"
    is_gray_box = True

    @property
    def own(self) -> System | None:
        """The system that the rig provides for it; None for the linear system."""
        return self.boxes.get(self.name, self.physics if self.name == "gray" else None)

    @property
    def options(self) -> Mapping[str, Option]:
        own, found = self.own, dict(FIT_OPTIONS)
        if own is not None and own.contacts:
            found["starts"] = replace(found["starts"], default=STICKING_STARTS)
        if own is not None:
            found |= {
                term: Option(default=int(term not in own.doubtful_terms), low=0, high=1, kind="int", description="term")
                for term in own.terms
            }
        for wrapper in _wrappers():
            found |= wrapper.options(self.physics)
        return found

    def assemble(self, design: Mapping[str, Any], weights: Array) -> System:
        system = self._linear(design) if self.own is None else self.own
        wrappers = _wrappers()
        if "sensors" in design and not wrappers:
            raise UserError("its sensors were fitted by the extension calibration, which is missing; install it")
        for wrapper in wrappers:
            system = wrapper.stored(system, design)
        return system

    def _linear(self, design: Mapping[str, Any]) -> Linear:
        frictions: tuple[Friction, ...] = get_args(Friction)
        return Linear(
            origin=self.physics,
            friction=next((friction for friction in frictions if friction == self.name), "viscous"),
            straight=self.name == STRAIGHT,
            scales=tuple(design.get("scales", ())),
            begin=design.get("begin"),
            unshown=tuple(design.get("unshown", ())),
        )

    def build(self, sizes: Magnitudes, options: Options, seed: int) -> tuple[System, tuple[str, ...]]:
        system = self.own
        if system is None:
            law = LinearisedLaw.of(self.physics, sizes)
            linear = self._linear({"scales": [*map(scale_of, sizes.scales), *law.efforts], "unshown": sizes.unshown})
            system = linear.initialised(law.entries(linear))
        system = system.with_values([item.start for item in system.parameters])
        system, held = system.without([term for term in system.terms if not options.get(term, 1)])
        for wrapper in _wrappers():
            system = wrapper.wrapped(system, options, sizes)
        return system, held

    def initial_guess(self, system: System, context: FitContext) -> System:
        """A linear system with initial entries from a regression over one sample, by the trapezoidal rule.

            (x(k + 1) - x(k)) / T = A (x(k) + x(k + 1)) / 2 + B u(k) + c - F sgn v

        for each rate of a measured state on which no unmeasured state acts in the rig's law at its initial values.
        """
        if isinstance(system, Wrapper):
            return replace(system, physics=self.initial_guess(system.physics, context))
        if not isinstance(system, Linear):
            return system
        from hybrid_sysid_ros.identification.initial_values import regression

        system = system.initialised(regression(system, context.experiments(self.physics)))
        return system.with_values([item.start for item in system.parameters])

    def fit(self, context: FitContext) -> Fit:
        system, held = self.build(context.magnitudes, context.options, context.seed)
        guess = self.initial_guess(system, context)
        alike = np.array_equal(guess.values, system.values)
        return context.fit_physics([guess] if alike else [guess, system], hold=held)


def _wrappers() -> list[Any]:
    """What options wrap a gray box in, as extensions provide it."""
    return [kind() for kind in provided("wrappers").values()]
