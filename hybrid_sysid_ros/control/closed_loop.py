"""A closed loop in one process: plant, estimator, controller and reference, as fast as they compute."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid_sysid_ros.control.controller import Controller, Status
from hybrid_sysid_ros.control.problem import Problem
from hybrid_sysid_ros.estimation import Estimator
from hybrid_sysid_ros.rigs.excitation import Reference
from hybrid_sysid_ros.rigs.plant import Plant

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """time (samples,) [s]; position, estimate and reference (samples,) [rad]; input (samples,) [drive unit] from each
    sample on; statuses: how often each stood behind an input.
    """

    time: Array
    position: Array
    estimate: Array
    reference: Array
    input: Array
    statuses: Counter[Status]

    def tracking_rmse(self, start: float, stop: float) -> float:
        """Root mean square of position - reference within start <= t < stop [s], in rad."""
        inside = (self.time >= start) & (self.time < stop)
        return float(np.sqrt(np.mean((self.position - self.reference)[inside] ** 2)))

    def cost(self, problem: Problem) -> float:
        """The loop as it went, by the weights of the MPC: sum of the weighted squared errors and input changes."""
        errors = (self.position - self.reference) / problem.output_scale
        changes = np.diff(self.input, prepend=0.0)
        return float(problem.output_weight * np.sum(errors**2) + problem.rate_weight * np.sum(changes**2))


def run_loop(
    plant: Plant,
    estimator: Estimator,
    controller: Controller,
    reference: Reference,
    *,
    duration: float,
    period: float,
    lead: float,
) -> Loop:
    """Run a loop from rest.

    reference: as the output is shown. period: of the measurements [s], a multiple of the plant's step. lead: how far
    the estimate's ``ahead`` lies after its measurement [s]; the preview begins there.
    """
    scale = plant.rig.display[0].scale
    steps = round(period / plant.rig.step)
    ahead = lead + controller.period * np.arange(1, controller.horizon + 1)
    u = 0.0
    output = plant.rig.system.measured[0]
    statuses: Counter[Status] = Counter()
    rows = []
    for _ in range(round(duration / period)):
        time = plant.time
        estimate = estimator.update(time, plant.measure().outputs, np.array([u]))
        plan = controller.control(estimate.ahead, estimate.disturbance, np.array([u]), scale * reference(time + ahead))
        u = float(plan.input[0])
        statuses[plan.status] += 1
        rows.append((time, plant.state[output], estimate.state[output], scale * float(reference(time)), u))
        controller.prepare(period)
        for _ in range(steps):
            plant.advance(u)
    time, position, estimated, wanted, inputs = np.array(rows).T
    return Loop(time=time, position=position, estimate=estimated, reference=wanted, input=inputs, statuses=statuses)
