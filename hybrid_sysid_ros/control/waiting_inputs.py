"""Waiting inputs: where inputs have different delays, commands of the faster ones wait, so that all act at one time."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.controller import Controller, MpcSolution, assign_stages
from hybrid_sysid_ros.core import System
from hybrid_sysid_ros.core.rollout import step_with_jacobian
from hybrid_sysid_ros.support.arrays import Array

ROUNDING = 1e-9  # s


class WaitingInputs:
    """A controller whose plans hold for the time after the longest delay; it gives each input when that one is due.

    The state that it is given was predicted as if the last inputs held until then. What is on its way has another
    effect, which is added to the state by the model's derivatives along that time.
    """

    def __init__(self, controller: Controller, system: System, *, step: float) -> None:
        """system: what the controller predicts; step: by which inputs on their way are followed [s]."""
        self.controller, self.system = controller, system
        self.horizon, self.period = controller.horizon, controller.period
        self._waits = system.delay - system.input_delays
        self._longest = float(self._waits.max())
        self._step = step
        self.reset()

    def reset(self) -> None:
        """Forget what is on its way."""
        self.controller.reset()
        self._given: deque[tuple[float, Array]] = deque()
        self._time = 0.0

    def assign(self, **values: Any) -> None:
        """See :meth:`~hybrid_sysid_ros.control.mpc.mpc.ExactMpc.assign`."""
        assign_stages(self.controller, values)

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`; the plan's input is that which is due now."""
        now, before = self._time, previous_input
        if self._given:
            before = np.where(self._waits > 0.0, self._given[-1][1], previous_input)
        reached = self._reached(now, state, disturbance, previous_input)
        plan = self.controller.control(reached, disturbance, before, preview)
        self._given.append((now, plan.input))
        while len(self._given) > 1 and self._given[1][0] <= now - self._longest:
            self._given.popleft()
        return plan._replace(input=self._due(np.full(len(before), now), previous_input))

    def prepare(self, elapsed: float) -> None:
        """Let time pass, and the controller prepare its next answer."""
        self._time += elapsed
        self.controller.prepare(elapsed)

    def _due(self, times: Array, held: Array) -> Array:
        """Inputs that are due at times (m,) [s]: each the last that was given its wait ago, or ``held`` before."""
        found = np.array(held, dtype=float)
        for j, latest in enumerate(times - self._waits + ROUNDING):
            found[j] = next((inputs[j] for given, inputs in reversed(self._given) if given <= latest), found[j])
        return found

    def _reached(self, now: float, state: Array, disturbance: Array, held: Array) -> Array:
        """The state (n,) with the effect of what is on its way; ``held`` (m,): what it was predicted with."""
        changes = []
        for k in range(math.ceil(self._longest / self._step - ROUNDING)):
            since = k * self._step - (self._longest - self._waits)  # from now on, until what is sent then acts
            under_way = (since > -ROUNDING) & (self._waits > 0.0)
            changes.append(np.where(under_way, self._due(now + since, held) - held, 0.0))
        if not np.isfinite(state).all() or not np.any(changes):
            return state
        _, jacobian = step_with_jacobian(self.system, state, held + disturbance, step=self._step)
        n, moved = len(state), np.zeros(len(state))
        for change in changes:
            moved = jacobian[:, :n] @ moved + jacobian[:, n : n + len(held)] @ change
        return state + moved
