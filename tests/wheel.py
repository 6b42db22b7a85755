"""At the wheel: a controller node whose estimates and references the test makes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from hybrid_sysid_ros.nodes.controller import ControllerNode
from hybrid_sysid_ros.nodes.messages import SECOND, set_nanoseconds
from tests.node_bench import Bench, joint, stamp_of


class Wheel:
    """A controller whose estimates the test makes."""

    def __init__(self, bench: Bench, model: Path, network: Path, /, **parameters: Any) -> None:
        self.bench = bench
        self.estimates = bench.speak("state_estimate")
        self.references = bench.speak("reference", JointTrajectory)
        self.commands = bench.listen("joint_command")
        self.controller: ControllerNode = bench.start(
            ControllerNode,
            **{
                "model": str(model),
                "policy_path": str(network),
                "policy": "network",
                "certificate": "ignore",
                **parameters,
            },
        )
        bench.until(
            lambda: (
                self.controller.output.commands
                and self.controller.output.commands.get_subscription_count()
                and self.estimates.get_subscription_count()
                and self.references.get_subscription_count()
            )
        )
        self.stamp = SECOND

    def estimate(self, position: float, **followed: float) -> None:
        names, rest = ["beam", "beam_ahead", *followed], [0.0] * (2 + len(followed))
        positions = [position, position, *followed.values()]
        message = joint(self.stamp, name=names, position=positions, velocity=rest, effort=rest)
        self.estimates.publish(message)

    def command(self, position: float, *, step: int = SECOND // 200, **followed: float) -> float:
        count = len(self.commands)
        self.stamp += step
        self.estimate(position, **followed)
        answer = self.bench.until(lambda: self.commands[count:])[0]
        assert stamp_of(answer) == self.stamp
        assert list(answer.name) == ["beam"]
        return float(answer.effort[0])

    def refer(self, positions: Sequence[float], *, spacing: float = 0.5, name: str = "beam") -> None:
        message = JointTrajectory(joint_names=[name])
        set_nanoseconds(message.header.stamp, self.stamp)
        for number, position in enumerate(positions):
            point = JointTrajectoryPoint(positions=[position])
            set_nanoseconds(point.time_from_start, round(number * spacing * SECOND))
            message.points.append(point)
        self.references.publish(message)
