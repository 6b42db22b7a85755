"""Pilot: a controller with what it reads out of estimates and the messages that its plans become."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import Controller, ExactMpc, Problem
from hybrid_sysid_ros.control.policy import policy
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.nodes.cdr import JointWriter, TrajectoryWriter
from hybrid_sysid_ros.nodes.layout import AHEAD, Layout, Place, Slots
from hybrid_sysid_ros.nodes.messages import SECOND
from hybrid_sysid_ros.nodes.model import model_of
from hybrid_sysid_ros.nodes.source import Source
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.checking import check_tolerances
from hybrid_sysid_ros.runtime.configuration import mpc_problem, shipped
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

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
        self.rig, self.settings, self._warn = rig, settings, warn
        self.lockstep: bool = settings["lockstep"]
        model, source = model_of(rig, settings)
        self.sources = {"model": source}
        self.network: Policy | None = None
        self.controller = self._controller(model)
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
        self._warm_up(np.array([actuator.rest for actuator in rig.actuators]))

    def _controller(self, model: Model) -> Controller:
        """The controller that the parameters name."""
        settings = self.settings
        self.problem = asked = mpc_problem(settings, self.rig, model.system)
        interior = settings["solver"] == "ipopt"
        if settings["policy"] == "exact":
            if settings["policy_path"]:  # whoever turns to it later should not find then that it does not fit
                policy.load(Path(settings["policy_path"]), model=model)
            return self._reference_solver(model, asked) if interior else self._exact(model, asked)
        if interior:
            raise UserError(f"parameter solver is ipopt, policy {settings['policy']}: ipopt works alone, policy:=exact")
        path = Path(settings["policy_path"] or shipped(self.rig.name, "policy"))
        self.sources["policy"] = Source(path)
        self.network = network = policy.load(path, model=model)
        self._look_at(network, path, asked)
        self.problem = network.problem
        if settings["policy"] == "network":
            return network
        tolerances = check_tolerances(settings, self.rig, network.problem)
        return Supervisor(network, self._exact(model, network.problem), tolerances)

    def _reference_solver(self, model: Model, problem: Problem) -> Controller:
        """IPOPT on the exact MPC's problem: slow, so it is for lockstep, and loaded only where it is asked for."""
        from hybrid_sysid_ros.control.mpc.interior_point import InteriorPointMpc

        if not self.lockstep:
            self._warn("solver ipopt takes longer than a measurement's period: it is for lockstep")
        return InteriorPointMpc(model.system, problem)

    def _exact(self, model: Model, problem: Problem) -> ExactMpc:
        """The exact MPC. In lockstep it takes its time, so that a run repeats."""
        limit = math.inf if self.lockstep else self.settings["time_limit"] or math.inf
        clock = None if math.isinf(limit) else perf_counter
        real_time = self.settings["real_time"]
        return ExactMpc(model.system, problem, real_time=real_time, time_limit=limit, clock=clock)

    def _look_at(self, network: Policy, path: Path, asked: Problem) -> None:
        """Say what a user should know about a network; refuse one that is not certified where that is required."""
        doubt = ""
        if network.certificate is None:
            doubt = f"{path}: has no certificate: hybrid-sysid policy certify {path} makes one"
        else:
            driver, least = self.settings["policy"], self.settings["certificate_rate"]
            mu = network.certificate.mu(driver)
            if mu < least:
                doubt = f"{path}: its certificate says mu {mu:.4f} of {driver}, less than certificate_rate {least:g}"
        if doubt and self.settings["certificate"] == "require":
            raise UserError(doubt)
        if doubt:
            self._warn(doubt)
        made = network.problem
        names = [item.name for item in fields(Problem) if getattr(asked, item.name) != getattr(made, item.name)]
        if names:
            self._warn(
                f"{path}: was trained with other values of {', '.join(names)} than the parameters say, and keeps them"
            )

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
        if isinstance(self.controller, Supervisor):
            self.controller.reasons.clear()

    def adapt(self, parameters: list[float]) -> None:
        """Tell a network with a correction the parameters that the estimator follows; NaN leaves one as it was."""
        if self.network is not None:
            self.network.adapt(dict(zip(self.followed.names, parameters, strict=True)))
