"""The faults: each begins when it is called and is over when it returns."""

from __future__ import annotations

import math
import random
import signal
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from benchmarks.faults.stage import NODES, Stage, freeze
from hybrid_sysid_ros.nodes.messages import SECOND, nanoseconds, set_nanoseconds

LASTING = 2.0
"""Of a fault that goes on [s]."""
Fault = Callable[[Stage], None]
Change = Callable[[JointState], Sequence[JointState]]


@contextmanager
def changed(stage: Stage, change: Change) -> Any:
    """Measurements pass through ``change`` for a while."""
    plain, stage.relay.change = stage.relay.change, change
    try:
        yield
    finally:
        stage.relay.change = plain


def measurements(change: Callable[[], Change]) -> Fault:
    """A fault of the measurements on their way."""

    def fault(stage: Stage) -> None:
        with changed(stage, change()):
            time.sleep(LASTING)

    return fault


def killed(name: str) -> Fault:
    """Kill -9, and a new one at once."""

    def fault(stage: Stage) -> None:
        stage.kill(name)
        stage.restart(name)

    return fault


def stopped(name: str) -> Fault:
    """SIGSTOP for 2 s."""
    return lambda stage: freeze(stage, name, LASTING)


def spoken(topic: str, make: Callable[[Stage, int], Any], *, rate: float = 100.0) -> Fault:
    """Messages of somebody else on a topic."""

    def fault(stage: Stage) -> None:
        publisher = stage.publisher(topic)
        stage.begun = time.monotonic()
        end, k = stage.begun + LASTING, 0
        while time.monotonic() < end:
            publisher.publish(make(stage, k))
            k += 1
            time.sleep(1.0 / rate)
        stage.node.destroy_publisher(publisher)

    return fault


# ---------------------------------------------------------------------- on their way


def lost(share: float) -> Callable[[], Change]:
    """A share of them does not arrive."""
    draw = random.Random(0)
    return lambda: lambda message: [] if draw.random() < share else [message]


def late(periods: int) -> Callable[[], Change]:
    """Each comes so many periods late."""

    def make() -> Change:
        kept: list[JointState] = []

        def change(message: JointState) -> list[JointState]:
            kept.append(message)
            return [kept.pop(0)] if len(kept) > periods else []

        return change

    return make


def reordered() -> Change:
    """Two by two in the wrong order."""
    kept: list[JointState] = []

    def change(message: JointState) -> list[JointState]:
        kept.append(message)
        if len(kept) < 2:
            return []
        found = kept[::-1]
        kept.clear()
        return found

    return change


def stamped(offset: float, *, every: int) -> Callable[[], Change]:
    """One in so many has a stamp that is off by ``offset`` [s]."""

    def make() -> Change:
        count = 0

        def change(message: JointState) -> list[JointState]:
            nonlocal count
            count += 1
            if count % every == 0:
                set_nanoseconds(message.header.stamp, nanoseconds(message.header.stamp) + round(offset * SECOND))
            return [message]

        return change

    return make


def reading(value: Callable[[float, int], float], field: str = "position") -> Callable[[], Change]:
    """Readings, or the inputs beside them, that are made of the true ones and their number."""

    def make() -> Change:
        count = 0

        def change(message: JointState) -> list[JointState]:
            nonlocal count
            count += 1
            setattr(message, field, array("d", [value(each, count) for each in getattr(message, field)]))
            return [message]

        return change

    return make


def frozen() -> Change:
    """The same reading for ever."""
    kept: list[Any] = []

    def change(message: JointState) -> list[JointState]:
        kept.append(message.position)
        message.position = kept[0]
        return [message]

    return change


def shaped(change: Callable[[JointState], None]) -> Callable[[], Change]:
    """The message itself is another one."""

    def make() -> Change:
        def changed(message: JointState) -> list[JointState]:
            change(message)
            return [message]

        return changed

    return make


def cut(message: JointState) -> None:
    """Without its inputs."""
    message.effort = array("d", [])


def longer(message: JointState) -> None:
    """With more positions than names."""
    message.position = array("d", [*message.position, 1.0, 2.0])


def renamed(message: JointState) -> None:
    """With the names of another rig."""
    message.name = ["arm" for _ in message.name]


# ---------------------------------------------------------------------- somebody else


def joint(stage: Stage, stamp: int, **fields: float) -> JointState:
    """A message of somebody else about the rig's joint."""
    message = JointState(name=[stage.joint])
    for name, value in fields.items():
        setattr(message, name, [value])
    set_nanoseconds(message.header.stamp, stamp)
    message.header.frame_id = "somebody else"
    return message


def now(stage: Stage) -> int:
    """Time of the ROS clock [ns]."""
    return int(stage.node.get_clock().now().nanoseconds)


def newest(stage: Stage) -> int:
    """Stamp of the newest measurement [ns]."""
    return stage.measured[-1][1]


def command(effort: float, stamp: Callable[[Stage], int]) -> Fault:
    """Commands with a stamp, at the rate of the loop."""
    return spoken("joint_command", lambda stage, k: joint(stage, stamp(stage), effort=effort), rate=200.0)


def crowd(stage: Stage) -> None:
    """A message with a million names, on each topic of the loop, five times."""
    message = JointState(name=[f"n{k}" for k in range(1_000_000)])
    for topic in ("joint_states", "state_estimate", "joint_command"):
        publisher = stage.publisher(topic)
        for _ in range(5):
            publisher.publish(message)
            time.sleep(0.1)
        stage.node.destroy_publisher(publisher)


def estimate(value: float) -> Fault:
    """Estimates all of whose numbers are the same."""

    def make(stage: Stage, k: int) -> JointState:
        message = JointState(name=[stage.joint, f"{stage.joint}_ahead"])
        for field in ("position", "velocity", "effort"):
            setattr(message, field, [value] * 2)
        set_nanoseconds(message.header.stamp, now(stage))
        message.header.frame_id = "somebody else"
        return message

    return spoken("state_estimate", make)


def reference(value: float, *, points: int = 2, offset: float = 0.0) -> Fault:
    """References of somebody else, while the rig's own is away."""

    def make(stage: Stage, k: int) -> JointTrajectory:
        message = JointTrajectory(joint_names=[stage.joint])
        set_nanoseconds(message.header.stamp, now(stage) + round(offset * SECOND))
        for k in range(points):
            point = JointTrajectoryPoint(positions=[value])
            set_nanoseconds(point.time_from_start, k * SECOND // 1000)
            message.points.append(point)
        return message

    def fault(stage: Stage) -> None:
        stage.kill("reference", signal.SIGTERM)
        stage.session.children["reference"].process.wait()
        spoken("reference", make, rate=20.0 if points < 100 else 2.0)(stage)
        stage.start("reference")
        stage.session.wait_for("ready", ["reference"], 30.0)

    return fault


def no_reference(stage: Stage) -> None:
    """None for a while."""
    stage.kill("reference")
    time.sleep(LASTING)
    stage.restart("reference")


def second(name: str) -> Fault:
    """Another one of the same kind, from the same command."""

    def fault(stage: Stage) -> None:
        first = stage.session.children[name]
        stage.start(name)
        stage.session.wait_for("ready", [name], 30.0)
        stage.begun = time.monotonic()
        time.sleep(3.0)
        again = stage.session.children[name]
        again.process.send_signal(signal.SIGTERM)
        again.process.wait()
        stage.session.children[name] = first

    return fault


def storm(stage: Stage) -> None:
    """Parameters of all nodes are asked for as often as they are answered."""
    asking = []
    for name in NODES:
        client = stage.node.create_client(GetParameters, f"{name}/get_parameters")
        client.wait_for_service(timeout_sec=5.0)
        asking.append(client)
    end = time.monotonic() + LASTING
    while time.monotonic() < end:
        for client in asking:
            client.call_async(GetParameters.Request(names=["rig"] * 20))
        time.sleep(1e-3)
    for client in asking:
        stage.node.destroy_client(client)


def crowded(stage: Stage) -> None:
    """Ten processes that do nothing but count."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(10)]
    time.sleep(5.0)
    for other in others:
        other.kill()
        other.wait()


def empty_diagnostics(stage: Stage) -> None:
    """Diagnostics of nothing."""
    publisher = stage.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    for _ in range(100):
        publisher.publish(DiagnosticArray())
        time.sleep(0.01)
    stage.node.destroy_publisher(publisher)


HUGE = {"nan": math.nan, "inf": math.inf, "1e300": 1e300, "1e6": 1e6}
FAULTS: dict[str, Fault] = {
    **{f"kill {name}": killed(name) for name in ("estimator", "controller", "reference", "plant")},
    **{f"stop {name} 2 s": stopped(name) for name in ("estimator", "controller", "reference", "plant")},
    "30 % lost": measurements(lost(0.3)),
    "all lost": measurements(lost(1.0)),
    "late by 1": measurements(late(1)),
    "late by 2": measurements(late(2)),
    "twice": measurements(lambda: lambda message: [message, message]),
    "reordered": measurements(reordered),
    ".9 s ahead at 2 Hz": measurements(stamped(0.9, every=100)),
    "all .9 s ahead": measurements(stamped(0.9, every=1)),
    "5 s old at 2 Hz": measurements(stamped(-5.0, every=100)),
    "all 5 s old": measurements(stamped(-5.0, every=1)),
    "a year ahead": measurements(stamped(3e7, every=100)),
    **{f"reading {name}": measurements(reading(lambda value, k, v=v: v)) for name, v in HUGE.items()},  # type: ignore[misc]
    **{f"input {name}": measurements(reading(lambda value, k, v=v: v, "effort")) for name, v in HUGE.items()},  # type: ignore[misc]
    "frozen": measurements(frozen),
    "biased": measurements(reading(lambda value, k: value + 0.05)),
    "spiking": measurements(reading(lambda value, k: value + (0.2 if k % 20 == 0 else 0.0))),
    "clipped": measurements(reading(lambda value, k: min(value, 0.02))),
    "a list too short": measurements(shaped(cut)),
    "a list too long": measurements(shaped(longer)),
    "other names": measurements(shaped(renamed)),
    "a million names": crowd,
    "race of commands": command(10.0, newest),
    "driver, stamp now": command(10.0, now),
    "person, no stamp": command(10.0, lambda stage: 0),
    "commands nan": command(math.nan, newest),
    **{f"estimates {name}": estimate(value) for name, value in HUGE.items()},
    "reference 44 V": reference(1.0),
    "reference 1e9": reference(1e9),
    "reference 1e100": reference(1e100),
    "reference nan": reference(math.nan),
    "reference old": reference(0.02, offset=-60.0),
    "reference ahead": reference(0.02, offset=60.0),
    "reference of 100 000 points": reference(0.02, points=100_000),
    "no reference": no_reference,
    **{f"second {name}": second(name) for name in ("estimator", "controller", "reference", "plant")},
    "parameter storm": storm,
    "ten busy processes": crowded,
    "empty diagnostics": empty_diagnostics,
}
"""By name."""
QUIET = {"twice", "late by 1", "reordered", "empty diagnostics", "parameter storm"}
"""Those that a loop may bear without a word: nothing is lost by them."""
