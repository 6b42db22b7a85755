"""Pilot: a controller with what it reads out of estimates and the messages that its plans become."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from time import perf_counter
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.nodes.cdr import JointWriter, TrajectoryWriter
from hybrid_sysid_ros.nodes.layout import AHEAD, Layout, Place, Slots
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.model import model_of
from hybrid_sysid_ros.nodes.source import Source
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.controllers import controller_of, policy_folder
from hybrid_sysid_ros.support.arrays import Array

WARM_UPS = 6  # answers before it drives
COMPILING = 1.0  # s, from which on an answer has compiled something


class Pilot:
    """All that depends on model, policy and problem, made beside a loop that goes on with another one.

    given: state and input disturbance when the command acts (n + m,), written by the caller; state, disturbance: the
    parts of it.
    """

    def __init__(self, rig: Rig, settings: Mapping[str, Any], signature: str, warn: Callable[[str], object]) -> None:
        """Loads, checks and compiles. warn: gets what a user should know. Raises UserError where parameters, model and
        policy don't go together.
        """
        self.rig, self.settings = rig, settings
        model, source = model_of(rig, settings)
        self.sources = {"model": source}
        if (folder := policy_folder(rig, settings)) is not None:
            self.sources["policy"] = Source(folder)
        made = controller_of(rig, model, settings, warn)
        self.controller, self.problem = made.controller, made.problem
        self.network, self.supervisor = made.network, made.supervisor
        self.ahead = round((model.system.delay + settings["latency"]) * SECOND)
        period, horizon = self.controller.period, self.controller.horizon
        self.grid = np.round(period * np.arange(1, horizon + 1) * SECOND).astype(np.int64)
        layout = Layout(rig, model.system)
        states, inputs = len(layout.states), len(layout.inputs)
        self.estimated = Slots([place.ending(AHEAD) for place in (*layout.states, *layout.inputs)])
        self.given = np.zeros(states + inputs)
        self.state, self.disturbance = np.split(self.given, [states])
        self.outputs = Slots(layout.outputs)
        self.tracked = np.array(self.problem.output_weights) > 0.0
        correction = self.network.correction if self.network is not None else None
        names: tuple[str, ...] = correction.names if correction is not None else ()
        self.followed = Slots([Place(name, "position") for name in names])
        self.plans = TrajectoryWriter(Slots([*layout.states, *layout.inputs]), self.grid.tolist(), signature)
        self.writer = JointWriter(Slots(layout.inputs), signature)
        self.rest = np.array([actuator.rest for actuator in rig.actuators])
        self._warm_up(self.rest)

    def _warm_up(self, rest: Array) -> None:
        """Answer what nobody gave: this compiles, and loads what is loaded at first use.

        The first answers are late, for they compile; those after them go on as in the loop.
        """
        for _ in range(WARM_UPS):
            began = perf_counter()
            plan = self.controller.control(
                self.state, self.disturbance, rest, np.zeros((len(self.grid), len(self.outputs)))
            )
            self.writer.pack(0, plan.input.tolist())
            self.controller.prepare(self.controller.period)
            if perf_counter() - began > COMPILING:
                gc.collect()  # what the compiler has left, before it needs as much again
        self.begin()

    def begin(self) -> None:
        """Begin a new experiment."""
        self.controller.reset()
        if self.supervisor is not None:
            self.supervisor.reasons.clear()

    def at_rest(self) -> Array:
        """Inputs at rest (m,), or what a stabiliser answers the newest state with: an unstable rig is lost without."""
        if isinstance(self.controller, Cascade) and np.isfinite(self.state).all():
            return self.controller.held(self.state)
        return self.rest

    def adapt(self, parameters: list[float]) -> None:
        """Tell a network with a correction the parameters that the estimator follows; NaN leaves one as it was."""
        if self.network is not None:
            self.network.adapt(dict(zip(self.followed.names, parameters, strict=True)))
