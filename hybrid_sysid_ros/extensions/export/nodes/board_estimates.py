"""Board estimates: measurements go to a board, and its estimates to the controller and to whoever watches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter

import numpy as np

from hybrid_sysid_ros.estimation.reversed_input import NONE
from hybrid_sysid_ros.extensions.export.board.driving import BoardController
from hybrid_sysid_ros.models import Model
from hybrid_sysid_ros.nodes.cdr import JointWriter
from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.diagnostics import ERROR, Task
from hybrid_sysid_ros.nodes.messages import SECOND, JointStates
from hybrid_sysid_ros.nodes.signal_layout import SignalLayout, Slots
from hybrid_sysid_ros.nodes.subscriptions import Listener
from hybrid_sysid_ros.nodes.timing import Timing
from hybrid_sysid_ros.nodes.validation import StampOrder
from hybrid_sysid_ros.rigs.rig import Rig

UNDOUBTED = (0.0, 0.0, float(NONE))
"""What estimates say of their validity: a board does not tell what it doubts."""


class BoardEstimates:
    """joint_states to the board; state_estimate from it, with the stamp of the measurement, for the controller that
    runs here, too.
    """

    def __init__(self, board: BoardController, rig: Rig, model: Model) -> None:
        self.board, self._system = board, model.system
        layout = SignalLayout(rig, model.system)
        self._measured = Slots([*layout.outputs, *layout.inputs])
        self._further, self._m = layout.further, len(layout.inputs)
        self._slots = Slots(layout.estimate(()))
        self.answers = Timing()

    def listen(self, node: ControllerNode) -> Listener:
        """Answer measurements as long as a controller is active."""
        self._node, self._zero, self._answered = node, 0, 0
        self._entry = node.validator("joint_states")
        self._writer = JointWriter(self._slots, f"{node.signature} board" if node.signature else "")
        self._estimates = node.open("state_estimate")
        return node.listen(self._entry, "joint_states", self.on_measurement)

    def on_measurement(self, joints: JointStates) -> None:
        """Let the board answer a measurement. One that comes again is asked again if it was not answered, as a plant in
        lockstep waits for.
        """
        began = perf_counter()
        given = self._entry.read(joints, self._measured, optional=self._m)
        if given is None or (order := self._entry.admit(joints)) is None:
            return
        if order is StampOrder.DUPLICATE and joints.stamp == self._answered:
            self._node.output.repeat()
            return
        if order is StampOrder.RESTART:
            self._zero = 0
        self._zero = self._zero or joints.stamp
        outputs, applied = np.split(np.array(given), [len(given) - self._m])
        found = self.board.observe((joints.stamp - self._zero) / SECOND, outputs, applied)
        if found is None:
            self._node.hold()
            return
        further: list[float] = []
        if self._further:
            further = np.asarray(self._system.output(list(found.state), list(applied)))[self._further].tolist()
        now, ahead, offsets = found.state.tolist(), found.ahead.tolist(), found.disturbance.tolist()
        estimate = [*now, *further, *offsets, *ahead, *offsets, *applied.tolist(), *UNDOUBTED]
        message, self._answered = self._writer.pack(joints.stamp, estimate), joints.stamp
        self._estimates.publish(message)
        unpacked = self._node.entry.unpack(message)
        if unpacked is not None:
            self._node.on_estimate(unpacked)
        self.answers.add(perf_counter() - began)

    def tasks(self) -> Sequence[Task]:
        """The task of the board: silence, checksums, questions without an answer."""
        link = self.board.link
        troubles = {
            "calls without an answer": self.board.unanswered,
            "frames that came damaged": link.frames.wrong,
            "frames that the board found damaged": link.board_wrong,
        }
        values = {
            "port": link.port,
            "board_model": link.identity.seal if link.identity is not None else "",
            "board_alive": link.alive / 1e3 if link.alive else math.nan,
            "board_ticks": self.board.ticks,
            "board_restarts": self.board.restarts,
            "unanswered": self.board.unanswered,
            "damaged_here": link.frames.wrong,
            "damaged_there": link.board_wrong,
            **self.answers.report("answer"),
        }
        task = self._node.judged("board", troubles, link.asked, **values)
        trouble = self.board.trouble or self.board.silence
        return [replace(task, level=ERROR, message=trouble) if trouble else task]
