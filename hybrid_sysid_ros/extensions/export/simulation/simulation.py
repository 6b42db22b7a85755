"""A simulation: a rig's plant without noise, or a model in its place, and the same in C."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hybrid_sysid_ros.core.symbolic import equations_in_c
from hybrid_sysid_ros.core.system import System
from hybrid_sysid_ros.extensions.export.c_source import WIDTH, Text, number
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.actuator import Actuator
from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

TEMPLATES = Path(__file__).parent / "c"
LONGEST = 100_000
"""Of a delay, in steps."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulation:
    """A rig's simulated plant without noise and disturbances: its actuators, stops, and the age of its readings."""

    name: str
    """What every name in C begins with."""
    rig: Rig
    bias: tuple[float, ...]
    """What is added to each input (m,)."""

    @classmethod
    def of_model(cls, name: str, rig: Rig, model: Model, *, stops: bool = False) -> Simulation:
        """A model at its own step. Its inputs keep the rig's bounds, and its outputs are those of their moment.

        stops: its states keep the rig's travel.
        """
        names, travel = [item.name for item in rig.system.states], np.full((2, len(model.system.states)), np.inf)
        travel[0] = -np.inf
        for index, item in enumerate(model.system.states):
            if stops and item.name in names:
                travel[:, index] = rig.travel[:, names.index(item.name)]
        plain = replace(
            rig,
            system=model.system,
            step=model.sampling.step,
            actuators=tuple(Actuator(low=item.low, high=item.high) for item in rig.actuators),
            sensors=tuple(replace(sensor, delay=0.0, window=0.0) for sensor in rig.sensors),
            travel=travel,
        )
        return cls(name=name, rig=plain, bias=(0.0,) * len(plain.actuators))

    @property
    def system(self) -> System:
        """The system that is stepped."""
        return self.rig.system

    @property
    def constant_parameters(self) -> frozenset[str]:
        """Names of the parameters that are delays, on which the size of the memory depends."""
        delays = (self.system.delays.get(item.name) for item in self.system.inputs)
        sensing = () if self.system.sensing is None else self.system.sensing.names
        return frozenset((*(value for value in delays if isinstance(value, str)), *sensing))

    def run(self, inputs: Array) -> tuple[Array, Array]:
        """States (steps + 1, n) and outputs (steps + 1, p) in Python, from zero. Each row of the inputs (steps, m) is
        held over a step, and the first one acted before.
        """
        plant = Plant(self.rig, seed=0, bias=self.bias, noisy=False, disturbed=False)
        stood = [item.bounded(float(value)) for item, value in zip(self.rig.actuators, inputs[0], strict=True)]
        plant.reset(np.zeros(len(self.system.states)), inputs=stood)
        states, outputs = [plant.state.copy()], [plant.sensed()]
        for row in inputs:
            plant.advance(row)
            states.append(plant.state.copy())
            outputs.append(plant.sensed())
        return np.array(states), np.array(outputs)

    def texts(self, *, about: str) -> dict[str, str]:
        """The texts of NAME.h, NAME.c and NAME_equations.c by their file names.

        Raises UserError for a delay of more than :data:`LONGEST` steps.
        """
        system, rig = self.system, self.rig
        acting, reading = (
            self._delays(delays, what)
            for delays, what in (
                (system.input_delays, "an input's delay"),
                ([sensor.delay for sensor in rig.sensors], "a reading's delay"),
            )
        )
        counts = [actuator.quantiser for actuator in rig.actuators]
        velocities = [system.kinematics.get(index, -1) for index in range(len(system.states))]
        values = {
            "name": self.name,
            "NAME": self.name.upper(),
            "about": about,
            "states": len(system.states),
            "inputs": len(system.inputs),
            "outputs": len(system.outputs),
            "parameters": max(len(system.parameters), 1),
            "step": number(rig.step),
            "past_inputs": acting[0][-1],
            "past_outputs": reading[0][-1],
            "tables": "\n".join(
                [
                    _table("int", "input_first", acting[0]),
                    _table("double", "input_part", acting[1]),
                    _table("int", "output_first", reading[0]),
                    _table("double", "output_part", reading[1]),
                    _table("double", "low", (item.low for item in rig.actuators)),
                    _table("double", "high", (item.high for item in rig.actuators)),
                    _table("double", "rest", (item.rest for item in rig.actuators)),
                    _table("double", "most", (item.rate * rig.step for item in rig.actuators)),
                    _table("double", "count", (item.count if item else 0.0 for item in counts)),
                    _table("double", "range", (item.range if item else math.inf for item in counts)),
                    _table("double", "bias_at_first", self.bias),
                    _table("double", "travel_low", rig.travel[0]),
                    _table("double", "travel_high", rig.travel[1]),
                    _table("int", "velocity", velocities),
                    _table("double", "at_first", system.values if len(system.values) else [0.0]),
                ]
            ),
        }
        found = {
            f"{self.name}{ending}": Text((TEMPLATES / f"simulation{ending}").read_text(encoding="utf-8")).substitute(
                values
            )
            for ending in (".h", ".c")
        }
        return found | {f"{self.name}_equations.c": equations_in_c(self.system, self.name, step=rig.step)}

    def _delays(self, delays: Iterable[float], what: str) -> tuple[list[int], list[float]]:
        """Where what is kept of each delayed signal begins, with the end, and the remaining part of a step of each."""
        first, parts = [0], list[float]()
        for delay in delays:
            steps = float(delay) / self.rig.step
            if not 0.0 <= steps <= LONGEST:
                raise UserError(
                    f"export: {what} is {delay:g} s: it takes from 0 to {LONGEST} steps of {self.rig.step:g} s"
                )
            first.append(first[-1] + int(steps) + 2)
            parts.append(steps - int(steps))
        return first, parts


def _table(kind: str, name: str, values: Iterable[float]) -> str:
    """An array of constants."""
    texts = [str(int(value)) if kind == "int" else number(float(value)) for value in values]
    body = textwrap.fill(", ".join(texts), WIDTH, initial_indent="    ", subsequent_indent="    ")
    return f"static const {kind} {name}[{len(texts)}] = {{\n{body}\n}};\n"
