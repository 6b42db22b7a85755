"""Command output: the topics that a controller's commands and plans leave by."""

from __future__ import annotations

import numpy as np
from rclpy.publisher import Publisher
from std_msgs.msg import Float64MultiArray

from hybrid_sysid_ros.control import MpcSolution
from hybrid_sysid_ros.nodes.cdr import TrajectoryWriter
from hybrid_sysid_ros.support.arrays import Array


class CommandOutput:
    """Publishes commands as joint_command, as bare numbers where somebody wants these, and predicted trajectories.

    commands: the publisher of joint_command, None until there is one. command: the newest message, None before the
    first.
    """

    def __init__(self, efforts: Publisher, predictions: Publisher) -> None:
        self.commands: Publisher | None = None
        self.command: bytes | None = None
        self.efforts, self.predictions = efforts, predictions
        self.numbers, self.wanted = Float64MultiArray(), False

    def look(self) -> None:
        """See whether somebody reads the bare numbers."""
        self.wanted = self.efforts.get_subscription_count() > 0

    def publish(self, command: bytes, inputs: Array) -> None:
        """Publish a command, a message and its inputs (m,)."""
        self.command = command
        self.numbers.data = inputs.tolist()
        self.repeat()

    def repeat(self) -> None:
        """Publish the newest command again; nothing where there is none, as while an estimate waits in lockstep."""
        if self.command is None:
            return
        if self.commands is not None:
            self.commands.publish(self.command)
        if self.wanted:
            self.efforts.publish(self.numbers)

    def show(self, writer: TrajectoryWriter, plan: MpcSolution, start: int) -> None:
        """Publish the predicted trajectory from a time on [ns], if someone looks."""
        if len(plan.states) and self.predictions.get_subscription_count():
            self.predictions.publish(writer.pack(start, np.hstack([plan.states, plan.inputs]).tolist()))
