"""A board that drives: the node controller asks it for estimates and commands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from time import monotonic
from typing import Any

import numpy as np

from hybrid_sysid_ros.control.controller import MpcSolution, Status, held
from hybrid_sysid_ros.control.mpc.mpc import STATUSES
from hybrid_sysid_ros.control.problem import ControlProblem
from hybrid_sysid_ros.extensions.export.board.link import BoardEstimate, BoardLink, BoardSilent
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.rigs.rig import Rig
from hybrid_sysid_ros.runtime.configuration import controller_model, mpc_problem
from hybrid_sysid_ros.runtime.controllers import ConfiguredController
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

ESTIMATES = "hybrid_sysid_ros.extensions.export.nodes.board_estimates:BoardEstimates"
ASK_AGAIN = 0.5
"""Time between two tries to reach a silent board [s]."""


class BoardController:
    """The controller on a board, as the node controller calls it; see
    :class:`~hybrid_sysid_ros.control.controller.Controller`.

    What a board that is silent was to answer is the last command; the node then rests the rig by its own times.
    """

    def __init__(self, link: BoardLink, problem: ControlProblem, *, seal: str, patience: float) -> None:
        """seal: of the model. patience: for an answer [s].

        Raises UserError where no board answers, or one with the loop of another model or problem.
        """
        self.link, self.problem, self.patience = link, problem, patience
        self.horizon, self.period = problem.horizon, problem.period
        self._seal = seal
        self._asked = -math.inf
        self.unanswered, self.restarts, self.ticks = 0, 0, 0
        """Calls without an answer; times that the board began anew; ticks of its clock in the last period."""
        self.trouble = ""
        """Why the board does not drive, "" where it does."""
        self.check()

    def check(self, *, patience: float = 2.0) -> None:
        """Begin anew on the board, which answers within ``patience`` [s]. Raises UserError as the constructor."""
        found = self.link.reset(patience=patience)
        if found.seal != self._seal:
            raise UserError(
                f"port {self.link.port}: the board has the loop of another model ({found.seal[:12]}, not "
                f"{self._seal[:12]}): export this one for it and flash it"
            )
        if (found.horizon, found.inputs) != (self.horizon, len(self.problem.input_low)):
            raise UserError(
                f"port {self.link.port}: the board's horizon is {found.horizon} and its inputs are {found.inputs}, not "
                f"{self.horizon} and {len(self.problem.input_low)}: export this loop for it and flash it"
            )

    def control(self, state: Array, disturbance: Array, previous_input: Array, preview: Array) -> MpcSolution:
        """The board's command for its last estimate."""
        try:
            answer = self.link.decide(previous_input, preview, patience=self.patience)
        except BoardSilent:
            self.unanswered += 1
            return held(previous_input, self.problem, Status.HELD)
        self.ticks = answer.ticks
        inputs = np.clip(answer.inputs, self.problem.input_low, self.problem.input_high)
        if not np.isfinite(inputs).all():
            return held(previous_input, self.problem, Status.FAILED)
        return MpcSolution(inputs, inputs[None], np.zeros((0, len(state))), STATUSES.get(answer.status, Status.HELD))

    def prepare(self, elapsed: float) -> None:
        """Let the board prepare the next command."""
        try:
            self.link.prepare(elapsed)
        except BoardSilent:
            self.unanswered += 1

    def reset(self) -> None:
        """Let the board forget its last plan."""
        try:
            self.link.forget_plan()
        except BoardSilent:
            self.unanswered += 1

    def observe(self, time: float, outputs: Array, applied: Array) -> BoardEstimate | None:
        """The board's estimate for a measurement; None where there is none, or the board is silent."""
        if not self._is_there():
            self.unanswered += 1
            return None
        try:
            found = self.link.observe(time, outputs, applied, patience=self.patience)
        except BoardSilent:
            self.unanswered += 1
            self.trouble = self.silence  # one that is only slow, as a computer that is busy, goes on
            return None
        return found if found.known else None

    @property
    def silence(self) -> str:
        """That nothing comes from the board, "" where something does."""
        return (
            f"nothing from the board on {self.link.port}: look at its power and its cable" if self.link.silent else ""
        )

    def _is_there(self) -> bool:
        """Whether the board may be asked; one that was silent or has started anew begins from the beginning."""
        silent = self.link.silent
        if not self.trouble and not self.link.restarted:
            return True
        if monotonic() - self._asked < ASK_AGAIN:
            return False
        self._asked = monotonic()
        try:
            if silent:
                self.link.open()
            self.check(patience=self.patience)
        except UserError as error:
            self.trouble = str(error)
            return False
        self.trouble, self.restarts = "", self.restarts + 1
        return True


def controller(rig: Rig, model: Model, settings: Mapping[str, Any]) -> ConfiguredController:
    """The controller on the board whose port the settings name. Raises UserError as :class:`BoardController`."""
    system = controller_model(rig, model.system)
    problem = mpc_problem(settings, rig, system)
    link = BoardLink(settings["board"], baud=settings["board_baud"])
    made = BoardController(link, problem, seal=model.seal, patience=settings["board_patience"])
    return ConfiguredController(controller=made, problem=problem, estimates=ESTIMATES)
