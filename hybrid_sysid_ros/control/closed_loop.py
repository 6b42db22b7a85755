"""A closed loop in one process: plant, estimator, controller and reference, without waiting for time to pass."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from hybrid_sysid_ros.control.controller import Controller, Status
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.control.stage_cost import stage_costs
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import output_of
from hybrid_sysid_ros.estimation import StateEstimate
from hybrid_sysid_ros.support.arrays import Array

OutputReference = Callable[[Array], Array]
"""q(t): times (samples,) [s] in, outputs (samples, p) [SI] out."""


class ControlledPlant(Protocol):
    """The plant in a closed loop."""

    step: float
    """Length of one :meth:`advance` [s]."""
    state: Array
    """The current state of the plant."""

    @property
    def time(self) -> float:
        """The current time [s]."""
        ...

    def outputs(self) -> Array:
        """Outputs without noise, (p,)."""
        ...

    def sensed(self) -> Array:
        """Readings of the sensors, (p,)."""
        ...

    def advance(self, inputs: Array) -> None:
        """Advance one step under inputs (m,)."""
        ...


class StateObserver(Protocol):
    """An estimator of the state."""

    def update(self, time: float, outputs: Array, applied: Array) -> StateEstimate:
        """See :meth:`~hybrid_sysid_ros.estimation.Estimator.update`."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class ClosedLoop:
    """The course of a loop, a row for each sample, in SI units: n states of the model, m inputs, p outputs."""

    time: Array
    """(samples,) [s]."""
    outputs: Array
    """Outputs without noise, (samples, p)."""
    estimates: Array
    """(samples, n), estimated states."""
    references: Array
    """(samples, p)."""
    inputs: Array
    """(samples, m), from each sample on."""
    statuses: Counter[Status] = field(default_factory=Counter)
    """How often an input had each status."""
    states: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(samples, states of the plant), without noise."""

    def tracking_rmse(self, start: float, stop: float) -> Array:
        """Root mean square (p,) of outputs - references within start <= t < stop [s]."""
        inside = (self.time >= start) & (self.time < stop)
        found: Array = np.sqrt(np.mean((self.outputs - self.references)[inside] ** 2, axis=0))
        return found

    def cost_by(self, problem: ControlProblem, system: System | None = None) -> float:
        """Sum of the stage costs by a problem that is sized, with the previous inputs 0 at the start.

        system: the one of the problem, whose states are estimated, for its terms, which are those of the first stage;
        without it the cost is without terms.
        """
        outputs = self.outputs
        if system is not None and problem.terms:
            staged, p = problem.outputs_of(system), outputs.shape[1]
            rest = np.concatenate([problem.stage_values[0], np.zeros(self.inputs.shape[1])])
            pairs = zip(self.estimates, self.inputs, strict=True)
            terms = [output_of(staged, x, np.concatenate([u, rest]))[p:] for x, u in pairs]
            outputs = np.hstack([outputs, np.array(terms)])
        costs = stage_costs(
            problem.stage_weights,
            outputs=outputs,
            references=self.references,
            inputs=self.inputs,
            previous=np.zeros(self.inputs.shape[1]),
            states=self.estimates,
        )
        return float(np.sum(costs))


def simulate_loop(
    plant: ControlledPlant,
    estimator: StateObserver,
    controller: Controller,
    reference: OutputReference,
    *,
    inputs: int,
    duration: float,
    period: float,
    lead: float,
) -> ClosedLoop:
    """Run a loop from rest.

    inputs: number of inputs. duration [s]. period: that of the measurements [s], a multiple of the plant's step. lead:
    time from a measurement to the estimate's state ``ahead`` [s]; the preview begins there.
    """
    steps, samples = round(period / plant.step), round(duration / period)
    ahead: Array = lead + controller.period * np.arange(1, controller.horizon + 1, dtype=np.float64)
    u = np.zeros(inputs)
    statuses: Counter[Status] = Counter()
    rows: list[tuple[float, Array, Array, Array, Array, Array]] = []
    for _ in range(samples):
        time = plant.time
        estimate = estimator.update(time, plant.sensed(), u)
        plan = controller.control(estimate.ahead, estimate.disturbance, u, reference(time + ahead))
        u = plan.input
        statuses[plan.status] += 1
        rows.append((time, plant.outputs(), estimate.state, reference(np.array([time]))[0], u, plant.state.copy()))
        controller.prepare(period)
        for _ in range(steps):
            plant.advance(u)
    times, outputs, estimates, references, applied, states = (
        np.array(part, dtype=float) for part in zip(*rows, strict=True)
    )
    return ClosedLoop(
        time=times,
        outputs=outputs,
        estimates=estimates,
        references=references,
        inputs=applied,
        statuses=statuses,
        states=states,
    )
