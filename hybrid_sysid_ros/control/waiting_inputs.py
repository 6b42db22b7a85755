"""Waiting inputs: where inputs have different delays, commands of the faster ones wait, so that all act at one time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hybrid_sysid_ros.control.controller import Controller, MpcSolution, OuterController
from hybrid_sysid_ros.control.mpc.batch import MpcAnswers
from hybrid_sysid_ros.control.mpc.horizon import Instance
from hybrid_sysid_ros.control.mpc.linearisation import assign
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.call import call_jacobian
from hybrid_sysid_ros.core.compilation import inner, kernel
from hybrid_sysid_ros.core.compiled import compiled
from hybrid_sysid_ros.support.arrays import Array

WAIT_ROUNDING = 1e-9  # s
UNUSED = -1.0
"""Age of a place that holds no inputs."""


class InputsOnTheirWay(NamedTuple):
    """Inputs that were planned and still wait, the newest first, and the model that says what they change."""

    waits: Array
    """(m,): for how long each input waits [s]."""
    ages: Array
    """(length,): time since they were planned [s]."""
    planned: Array
    """(length, m)."""
    step: float
    """By which they are followed [s]."""
    jacobian: int
    """Address of the model's step with derivatives."""
    parameters: Array
    weights: Array


@inner
def forget_inputs(on_way: InputsOnTheirWay) -> None:
    """Forget what is on its way."""
    for k in range(on_way.ages.shape[0]):
        on_way.ages[k] = UNUSED


@inner
def let_inputs_age(on_way: InputsOnTheirWay, elapsed: float) -> None:
    """Let time [s] pass."""
    for k in range(on_way.ages.shape[0]):
        if on_way.ages[k] >= 0.0:
            on_way.ages[k] += elapsed


@inner
def add_inputs(on_way: InputsOnTheirWay, planned: Array) -> None:
    """Let planned inputs (m,) wait."""
    for k in range(on_way.ages.shape[0] - 1, 0, -1):
        on_way.ages[k] = on_way.ages[k - 1]
        assign(on_way.planned[k], on_way.planned[k - 1])
    on_way.ages[0] = 0.0
    assign(on_way.planned[0], planned)


@inner
def planned_last(on_way: InputsOnTheirWay, previous: Array) -> None:
    """Put the inputs that were planned last in the place of those sent last (m,), where they wait."""
    for j in range(previous.shape[0]):
        if on_way.ages[0] >= 0.0 and on_way.waits[j] > 0.0:
            previous[j] = on_way.planned[0, j]


@inner
def due_input(on_way: InputsOnTheirWay, j: int, since: float, held: float) -> float:
    """Input j that is due a time ``since`` from now [s]: the last that was planned its wait ago, or else ``held``."""
    for k in range(on_way.ages.shape[0]):
        if on_way.ages[k] >= 0.0 and on_way.ages[k] + since >= on_way.waits[j] - WAIT_ROUNDING:
            return on_way.planned[k, j]  # type: ignore[no-any-return]
    return held


@inner
def due_inputs(on_way: InputsOnTheirWay, held: Array, due: Array) -> None:
    """The inputs (m,) that are due now."""
    for j in range(due.shape[0]):
        due[j] = due_input(on_way, j, 0.0, held[j])


@inner
def add_effect(on_way: InputsOnTheirWay, disturbance: Array, held: Array, state: Array) -> None:
    """Add the effect of what is on its way to a state (n,), which was predicted as if inputs ``held`` (m,) stayed: by
    the model's derivatives there, along the longest wait.
    """
    n, m, longest = state.shape[0], held.shape[0], 0.0
    moved, before, drive, following = np.zeros(n), np.zeros(n), np.zeros(m), np.zeros(n)
    jacobian = np.zeros((n, n + m))
    for a in range(n):
        if not math.isfinite(state[a]):
            return
    for j in range(m):
        drive[j] = held[j] + disturbance[j]
        longest = max(longest, on_way.waits[j])
    parameters, weights, h = on_way.parameters, on_way.weights, on_way.step
    call_jacobian(on_way.jacobian, state, drive, parameters, weights, h, 0.0, following, jacobian)
    for k in range(math.ceil(longest / h - WAIT_ROUNDING)):
        assign(before, moved)
        for a in range(n):
            moved[a] = 0.0
            for b in range(n):
                moved[a] += jacobian[a, b] * before[b]
        for j in range(m):
            since = k * h - (longest - on_way.waits[j])  # from now on, until what is sent then acts
            if on_way.waits[j] > 0.0 and since > -WAIT_ROUNDING:
                change = due_input(on_way, j, since, held[j]) - held[j]
                for a in range(n):
                    moved[a] += jacobian[a, n + j] * change
    for a in range(n):
        state[a] += moved[a]


@kernel
def _add_effect(on_way: InputsOnTheirWay, disturbance: Array, held: Array, state: Array) -> None:
    add_effect(on_way, disturbance, held, state)


class WaitingInputs(OuterController):
    """A controller whose plans hold for the time after the longest delay; it gives each input when that one is due.

    The state that it is given was predicted as if the last inputs held until then. What is on its way has another
    effect, which is added to the state by the model's derivatives along that time.
    """

    def __init__(self, controller: Controller, system: System, *, step: float) -> None:
        """system: what the controller predicts; step: by which inputs on their way are followed [s]."""
        super().__init__(controller)
        n, m, p = len(system.states), len(system.inputs), len(system.outputs)
        self._asked = Instance(np.zeros(n), np.zeros(m), np.zeros(m), np.zeros((self.horizon, p)))
        waits = system.delay - system.input_delays
        length = math.ceil(float(waits.max()) / step) + 2  # as many as if each step had a call
        self.on_way = InputsOnTheirWay(
            waits=waits,
            ages=np.zeros(length),
            planned=np.zeros((length, len(waits))),
            step=step,
            jacobian=compiled(system).jacobian(output=False, smooth=False, learn=False)[0],
            parameters=system.values,
            weights=system.weights,
        )
        self.reset()

    def reset(self) -> None:
        """Forget what is on its way."""
        self.controller.reset()
        forget_inputs(self.on_way)

    def solve_many(self, instances: Array, starts: Array | None = None, *, threads: int = 0) -> MpcAnswers:
        """See :meth:`~hybrid_sysid_ros.control.mpc.mpc.ExactMpc.solve_many`: of states after the longest delay."""
        return self._within("solve_many")(instances, starts, threads=threads)  # type: ignore[no-any-return]

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`; the plan's input is that which is due now."""
        asked = self._asked
        asked.assign(state, disturbance, previous_input, preview)  # compiled code relies on their shapes
        held, due = asked.previous.copy(), np.empty(len(asked.previous))
        _add_effect(self.on_way, asked.disturbance, held, asked.state)
        planned_last(self.on_way, asked.previous)
        plan = self.controller.control(*asked)
        add_inputs(self.on_way, plan.input)
        due_inputs(self.on_way, held, due)
        return plan._replace(input=due)

    def prepare(self, elapsed: float) -> None:
        """Let time pass, and the controller prepare its next answer."""
        let_inputs_age(self.on_way, elapsed)
        self.controller.prepare(elapsed)
