"""State space of any order, which needs nothing but the names of inputs and outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.extensions.state_space.state_space import RIDGE, StateSpace
from hybrid_sysid_ros.models.fit import Fit
from hybrid_sysid_ros.models.sampling import Sampling
from hybrid_sysid_ros.models.structure import FitContext, Option, Structure
from hybrid_sysid_ros.support.arrays import Array

SHOWN = 6
"""Most modes in words."""
INTEGRATES = 1e-9
"""Distance from 1 of a pole that a fit held there."""


class StateSpaceStructure(Structure):
    """It holds at the period of the samples alone."""

    summary = "a state space of any order, from inputs and outputs alone"
    seeded = True

    OPTIONS: ClassVar[Mapping[str, Option]] = {
        "order": Option(default=0, low=0, high=60, kind="int", description="States; 0: by held-out blocks."),
        "highest": Option(default=10, low=1, high=60, kind="int", description="Highest order to compare."),
        "feedthrough": Option(
            default=2,
            low=0,
            high=2,
            kind="int",
            description="Inputs act on outputs at once: 0 no, 1 yes, 2 by held-out blocks.",
        ),
        "units": Option(default=0, low=0, high=64, kind="int", description="Units of a network in the feedback."),
        "power": Option(default=0, low=0, high=7, kind="int", description="Of the units; 0: they are tanh."),
        "ridge": Option(default=RIDGE, low=1e-12, high=1.0, kind="log", description="Keeps the units small."),
        "starts": Option(default=3, low=1, high=20, kind="int", description="Beginnings of the units."),
    }

    @property
    def options(self) -> Mapping[str, Option]:
        return self.OPTIONS

    def sampling(self, asked: Sampling) -> Sampling:
        """A step for each sample. Inputs that lines would join are read at the outputs' own moments, since their mean
        over a step of that length says less.
        """
        return replace(asked, step=asked.period, input="sampled" if asked.input == "interpolated" else asked.input)

    def fit(self, context: FitContext) -> Fit:
        from hybrid_sysid_ros.extensions.state_space.identification import identify_state_space, options_of

        return identify_state_space(
            context.experiments(self.physics),
            self.physics.outputs,
            self.physics.inputs,
            replace(options_of(context.options), dead=self._dead(context.sampling.period)),
            seed=context.seed,
            progress=context.progress,
        )

    def _dead(self, period: float) -> tuple[int, ...]:
        """Samples by which inputs act later for sure: of a delay that the rig's physics declares all whole samples but
        one, since the states may be late by further ones and not early.
        """
        return tuple(np.maximum(np.floor(self.physics.input_delays / period + 1e-9) - 1, 0).astype(int).tolist())

    def assemble(self, design: Mapping[str, Any], weights: Array) -> StateSpace:
        return StateSpace.of(design, weights)

    def lines(self, system: System) -> Sequence[str]:
        assert isinstance(system, StateSpace)
        through = "at once" if np.any(system.matrices()[3]) else "one sample later"
        kind = f"power {system.power}" if system.power else "tanh"
        beside = f"{system.units} {'unit' if system.units == 1 else 'units'} of {kind}"
        first = f"order {system.order}, {beside if system.units else 'linear'}; inputs act on outputs {through}"
        return [first, *_modes(system)]

    def figures(self, system: System) -> Mapping[str, Any]:
        assert isinstance(system, StateSpace)
        if len(system.trials) < 2:
            return {}
        from hybrid_sysid_ros.extensions.state_space.report.figures import order_figure

        return {"orders": order_figure(system)}


def _modes(system: StateSpace) -> list[str]:
    """The slowest modes of the linear part in words."""
    poles = np.linalg.eigvals(system.matrices()[0])
    found = []
    for pole in sorted(poles[poles.imag >= 0.0], key=lambda pole: -abs(pole))[:SHOWN]:
        rate = np.log(pole + 0j) / system.period if pole != 0.0 else -np.inf
        if abs(pole - 1.0) < INTEGRATES:
            found.append("mode: integrates")
        elif abs(pole) > 1.0:
            found.append(f"mode: pole {pole.real:.4g}{f' +- {pole.imag:.4g}i' if pole.imag else ''}, unstable")
        elif rate.imag == 0.0:
            found.append(f"mode: time constant {-1.0 / rate.real:.4g} s")
        else:
            size = abs(rate)
            found.append(f"mode: {size / (2.0 * np.pi):.4g} Hz, damping {-rate.real / size:.3g}")
    return found
