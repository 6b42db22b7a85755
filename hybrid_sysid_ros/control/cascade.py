"""A slow controller above a fast stabiliser."""

from __future__ import annotations

import numpy as np

from hybrid_sysid_ros.control.controller import Controller, MpcSolution, OuterController
from hybrid_sysid_ros.core.wrappers import Stabilised
from hybrid_sysid_ros.support.arrays import Array

ROUNDING = 1e-6
"""Rounding of times, in periods."""


class Cascade(OuterController):
    """u = v - K x: a controller of the stabilised system gives v once in each of its periods, and the stabiliser
    answers every state.

    So a horizon of long intervals is predicted as the rig is driven, with v held over each interval. An unstable rig
    is stabilised between two plans, and a prediction over many time constants is meaningful (Rossiter, Kouvaritakis,
    Rice 1998, Automatica 34(1)).
    """

    def __init__(self, controller: Controller, system: Stabilised, limits: tuple[Array, Array]) -> None:
        """controller: that of the stabilised system. limits: lowest and highest value of each input of the rig (m,)."""
        super().__init__(controller)
        self._gains = np.array(system.gains)
        self._low, self._high = limits
        self.reset()

    def reset(self) -> None:
        """Forget all past states and plans."""
        self.controller.reset()
        self._plan: MpcSolution | None = None
        self._age, self._fresh = 0.0, False

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """See :class:`~hybrid_sysid_ros.control.controller.Controller`. The plan contains the stabiliser's part along
        the predicted states.
        """
        if self._plan is None or self._age > (1.0 - ROUNDING) * self.period:
            before = previous_input + self._gains @ state if self._plan is None else self._plan.input
            self._plan = self.controller.control(state, disturbance, before, preview)
            self._age, self._fresh = 0.0, True
        plan, inputs = self._plan, self._plan.inputs
        if len(plan.states) == len(inputs):
            inputs = inputs - np.vstack([state, plan.states[:-1]]) @ self._gains.T
        return plan._replace(input=self.held(state, plan.input), inputs=np.clip(inputs, self._low, self._high))

    def held(self, state: Array, added: Array | float = 0.0) -> Array:
        """Inputs (m,) of the stabiliser for a state, plus added inputs, within the limits."""
        inputs = added - self._gains @ state
        return np.clip(inputs if np.isfinite(inputs).all() else np.nan_to_num(inputs), self._low, self._high)

    def prepare(self, elapsed: float) -> None:
        """Let time pass; after a new plan, let the controller prepare its next one."""
        self._age += elapsed
        if self._fresh:
            self._fresh = False
            self.controller.prepare(self.period)
