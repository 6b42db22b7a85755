"""The loop in Python that a unit must answer as."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid_sysid_ros.control import Controller, ExactMpc
from hybrid_sysid_ros.control.cascade import Cascade
from hybrid_sysid_ros.control.mpc.mpc import STATUSES
from hybrid_sysid_ros.control.policy.policy import Policy
from hybrid_sysid_ros.control.safety.supervisor import Supervisor
from hybrid_sysid_ros.estimation import METHODS, ExtendedKalmanFilter
from hybrid_sysid_ros.extensions.export.unit.built import PeriodAnswer
from hybrid_sysid_ros.extensions.export.unit.printed_loop import WAITING
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import defaults, estimator_model, estimator_tuning
from hybrid_sysid_ros.runtime.controllers import controller_of
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

CODES = {status: code for code, status in STATUSES.items()}
"""In C, by their names in Python."""


@dataclass(kw_only=True, eq=False)
class PythonLoop:
    """The loop in Python: its estimator and controller. mpc: the one in the controller, without a time limit."""

    estimator: ExtendedKalmanFilter
    controller: Controller
    mpc: ExactMpc
    supervisor: Supervisor | None
    limits: tuple[Array, Array]
    """Lowest and highest command (m,)."""
    command: Array

    def reset(self) -> None:
        """Forget the past; the last command holds."""
        self.estimator.reset()
        self.controller.reset()
        state, offset = np.zeros(len(self.mpc.system.states)), np.zeros(len(self.command))
        self._answer = PeriodAnswer(WAITING, self.command, state, state, offset)

    def step(self, time: float, outputs: Array, applied: Array, preview: Array) -> PeriodAnswer:
        """A period: outputs (p,), applied inputs (m,), preview (N, p)."""
        try:
            estimate = self.estimator.update(time, outputs, applied)
        except UserError:
            if self.estimator._started:
                estimate = self.estimator._look()
            else:
                self._answer = self._answer._replace(status=WAITING)
                return self._answer
        plan = self.controller.control(estimate.ahead, estimate.disturbance, self.command, preview)
        self.command = plan.input
        status = CODES[plan.status]
        self._answer = PeriodAnswer(status, plan.input, estimate.state, estimate.ahead, estimate.disturbance)
        return self._answer

    def prepare(self, elapsed: float) -> None:
        """Prepare for the next period."""
        if self._answer.status != WAITING:
            self.controller.prepare(elapsed)


def loop_in_python(
    rig: Rig,
    model: Model,
    settings: Mapping[str, Any],
    network: Policy | None = None,
    estimation: Mapping[str, Any] | None = None,
) -> PythonLoop:
    """Estimator and controller of a rig from the parameters of the nodes. settings, estimation: some of the
    controller's and of the estimator's. network: the policy that drives, if it is not read from the folder that they
    name.

    Raises UserError for a method, a solver or a model that can't be printed.
    """
    values = defaults(rig, "estimator") | dict(estimation or {})
    given = defaults(rig, "controller") | {"policy": "exact"} | dict(settings) | {"lockstep": True}
    if METHODS[values["method"]] is not ExtendedKalmanFilter:
        raise UserError(f"export: the estimator's method {values['method']} can't be printed as C; set method to ekf")
    if given["solver"] != "sqp" or given["policy"] == "network":
        raise UserError(
            f"export: solver {given['solver']} with policy {given['policy']} can't be printed as C: give solver sqp "
            "and policy exact or supervised"
        )
    model = estimator_model(rig, model)
    tuning = estimator_tuning(values, rig, model.system)
    made = controller_of(rig, model, given, network=network)
    inner = made.controller.controller if isinstance(made.controller, Cascade) else made.controller
    mpc = made.supervisor.mpc if made.supervisor else inner
    if not isinstance(mpc, ExactMpc):
        raise UserError(f"export: a {type(inner).__name__} can't be printed as C; give the exact MPC or a supervisor")
    return PythonLoop(
        estimator=ExtendedKalmanFilter(model.system, tuning, period=1.0 / values["rate"], latency=given["latency"]),
        controller=made.controller,
        mpc=mpc,
        supervisor=made.supervisor,
        limits=rig.limits
        if isinstance(made.controller, Cascade)
        else (np.array(mpc.problem.input_low), np.array(mpc.problem.input_high)),
        command=np.array([actuator.rest for actuator in rig.actuators]),
    )
