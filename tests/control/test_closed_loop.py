"""Closed loops in one process, and the cost of a stage."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from hybrid_sysid_ros.control import ExactMpc, Status
from hybrid_sysid_ros.control.closed_loop import ClosedLoop, simulate_loop
from hybrid_sysid_ros.control.stage_cost import stage_costs
from hybrid_sysid_ros.core import simulate
from hybrid_sysid_ros.estimation import StateEstimate
from tests.control import two_inputs

PROBLEM = dataclasses.replace(
    two_inputs.PROBLEM,
    output_weights=(2.0, 3.0),
    output_scales=(0.5, 2.0),
    rate_weights=(1.0, 0.1),
    input_weights=(0.01, 0.0),
    state_high=(1.0, np.inf, np.inf, np.inf),
    soft_linear=(4.0,),
    soft_quadratic=(10.0,),
).sized(two_inputs.Arms())


def loop_of(**changes):
    """Two samples by hand."""
    given = {
        "time": np.array([0.0, 0.1]),
        "outputs": np.array([[0.1, 0.0], [0.0, 2.0]]),
        "estimates": np.array([[0.0, 0.0, 0.0, 0.0], [1.5, 9.0, 0.0, 0.0]]),
        "references": np.array([[0.0, 0.0], [0.1, 1.0]]),
        "inputs": np.array([[2.0, 0.0], [-1.0, 5.0]]),
        "statuses": Counter({Status.SOLVED: 2}),
    }
    return ClosedLoop(**{**given, **changes})


def test_a_cost_by_hand():
    """Errors, changes from inputs of zero, inputs, and the first state .5 above its bound."""
    errors = 2.0 * 2 * (0.1 / 0.5) ** 2 + 3.0 * (1.0 / 2.0) ** 2
    changes, inputs = 1.0 * (2.0**2 + 3.0**2) + 0.1 * 5.0**2, 0.01 * (2.0**2 + 1.0**2)
    assert loop_of().cost_by(PROBLEM) == pytest.approx(errors + changes + inputs + 4.0 * 0.5 + 10.0 * 0.5**2)


def test_each_stage_costs_by_itself():
    loop = loop_of()
    costs = stage_costs(
        PROBLEM.stage_weights,
        outputs=loop.outputs,
        references=loop.references,
        inputs=loop.inputs,
        previous=np.array([2.0, 0.0]),
        states=loop.estimates,
    )
    assert costs[0] == pytest.approx(2.0 * (0.1 / 0.5) ** 2 + 0.01 * 4.0)  # nothing changed


def test_tracking_is_scored_within_a_window():
    np.testing.assert_allclose(loop_of().tracking_rmse(0.0, 0.05), [0.1, 0.0])
    np.testing.assert_allclose(loop_of().tracking_rmse(0.0, 1.0), [0.1, np.sqrt(0.5)])


class Exact:
    """A plant that is its model, and an estimator that is told its state."""

    def __init__(self):
        self.system, self.step, self.state, self.ticks = two_inputs.Arms(), 0.01, np.zeros(4), 0
        self.u = np.zeros(2)

    @property
    def time(self):
        return self.ticks * self.step

    def outputs(self):
        return np.array(np.ravel(self.system.output(self.state.tolist(), self.u.tolist())), dtype=float)

    def sensed(self):
        return self.outputs()

    def advance(self, inputs):
        self.u = inputs
        self.state = simulate(self.system, self.state, inputs[None], step=self.step)[-1]
        self.ticks += 1

    def update(self, time, outputs, applied):
        x = self.state.copy()
        nothing = np.zeros(0)
        return StateEstimate(
            time=time, state=x, ahead=x, disturbance=np.zeros(2), parameters=nothing, covariance=np.zeros((4, 4)),
            innovation=nothing, normalised_innovation=0.0, normalised=nothing,
        )  # fmt: skip


def test_two_outputs_follow_their_references():
    bench = Exact()
    problem = dataclasses.replace(two_inputs.PROBLEM, input_weights=(0.0,))
    loop = simulate_loop(
        bench,
        bench,
        ExactMpc(bench.system, problem),
        lambda t: np.column_stack([0.2 * np.sin(t), 0.1 * np.ones_like(t)]),
        inputs=2,
        duration=4.0,
        period=0.05,
        lead=0.0,
    )
    assert loop.outputs.shape == loop.references.shape == loop.inputs.shape == (80, 2)
    assert loop.estimates.shape == (80, 4)
    assert sum(loop.statuses.values()) == 80
    assert np.all(loop.tracking_rmse(2.0, 4.0) < [0.02, 0.1])
    np.testing.assert_allclose(loop.references[:, 0], 0.2 * np.sin(loop.time))
