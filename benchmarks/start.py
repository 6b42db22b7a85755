"""How soon the loop runs: python -m benchmarks.start.

Two times, each of several repetitions, with compiled code on disk (a first round is not counted):

* run: from the start of the command ``hybrid-sysid run`` to the first command at the plant;
* each node of a running loop, killed by kill -9 and started again at once with the same command: from the kill to the
  new one's next answer in time. An answer is an estimate or a command less than a period after the stamp of its
  measurement, a measurement less than a period old, or a reference. Beside it: until the first of SETTLED commands in a
  row that are in time.

Asked: less than 5 s and less than 3 s in the slowest repetition.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from threading import Thread
from types import TracebackType
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.table import Table

from benchmarks import result
from hybrid_sysid_ros.commands.terminal import print_table, status
from hybrid_sysid_ros.nodes import middleware, topics
from hybrid_sysid_ros.nodes.messages import nanoseconds
from hybrid_sysid_ros.rigs import rig as rigs
from hybrid_sysid_ros.runtime.processes import permitted_priority
from hybrid_sysid_ros.runtime.session import Session
from hybrid_sysid_ros.support.errors import UserError

NAME, RIG, DOMAIN = "start", "cam_beam", 93
RATE = 200.0  # Hz, the rig's
PERIOD = 1.0 / RATE
ANSWERS = {
    "estimator": "state_estimate",
    "controller": "joint_command",
    "plant": "joint_states",
    "reference": "reference",
}
"""What each node answers with."""
SETTLED = 20
"""Commands in a row that came in time: the loop is back."""
LONGEST = 30.0  # s, that anything is waited for
RUN_LIMIT, NODE_LIMIT = 5.0, 3.0  # s, asked


class Listener:
    """Hears what a rig's nodes say, as a context: for each topic when it was published [s], the stamp [s], and who."""

    def __init__(self, namespace: str, heard: tuple[str, ...]) -> None:
        self.heard: dict[str, list[tuple[float, float, str]]] = {topic: [] for topic in heard}
        self._namespace = namespace
        self._context = Context()

    def __enter__(self) -> Listener:
        middleware.prepare_middleware()  # as any node of the rig
        rclpy.init(context=self._context, domain_id=DOMAIN)
        node = Node("listener", context=self._context, namespace=self._namespace)
        for topic in self.heard:
            node.create_subscription(topics.TYPES[topic], topic, self._note(topic), topics.profile(topic))
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(node)
        self._thread = Thread(target=self._spin, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        self._context.try_shutdown()
        self._thread.join()

    def _note(self, topic: str) -> Callable[[Any, Mapping[str, int]], None]:
        entries = self.heard[topic]

        def note(message: Any, information: Mapping[str, int]) -> None:
            header = message.header
            entries.append((1e-9 * information["source_timestamp"], 1e-9 * nanoseconds(header.stamp), header.frame_id))

        return note

    def _spin(self) -> None:
        if priority := permitted_priority():
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        while self._context.ok():
            try:
                self._executor.spin_once(timeout_sec=0.1)
            except Exception:  # the context ends while it spins
                return

    def wait(self, found: Callable[[], float], what: str) -> float:
        """What is found, as soon as it is no NaN. Raises UserError after LONGEST."""
        end = time.monotonic() + LONGEST
        while math.isnan(moment := found()):
            if time.monotonic() > end:
                raise UserError(f"{what} did not come within {LONGEST:g} s")
            time.sleep(0.02)
        return moment

    def in_time(self, topic: str, since: float, process: int | None = None, row: int = 1) -> float:
        """Moment of the first of ``row`` messages in a row that came within a period of their stamps, after ``since``,
        from a process if one is given; NaN so far. References have no measurement to be late for.
        """
        run = 0
        entries = [entry for entry in list(self.heard[topic]) if entry[0] >= since]
        for k, (moment, stamp, who) in enumerate(entries):
            fits = process is None or who.endswith(f" {process}")
            run = run + 1 if fits and stamp and (topic == "reference" or moment - stamp < PERIOD) else 0
            if run == row:
                return entries[k - row + 1][0]
        return math.nan


def run_once() -> float:
    """Seconds from the start of ``hybrid-sysid run`` to its first command."""
    command = [sys.executable, "-m", "hybrid_sysid_ros", "run", "--rig", RIG, "--reference", "constant"]
    with Listener(rigs.load(RIG).namespace, ("joint_command",)) as listener:
        started = time.time()
        environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN)}
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            heard = listener.heard["joint_command"]
            return listener.wait(lambda: heard[0][0] if heard else math.nan, "the first command") - started
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate()


def killed_once(session: Session, listener: Listener, name: str, command: list[str]) -> tuple[float, float]:
    """Seconds from kill -9 of a node to its next answer in time, and to the first of SETTLED commands in time."""
    started = time.time()
    session.children[name].process.kill()
    session.children[name].process.wait()
    session.start(name, command)
    process = session.children[name].process.pid
    answered = listener.wait(lambda: listener.in_time(ANSWERS[name], started, process), f"an answer of the new {name}")
    back = listener.wait(lambda: listener.in_time("joint_command", answered - PERIOD, row=SETTLED), "the loop")
    return answered - started, back - started


def killed(repetitions: int) -> dict[str, list[tuple[float, float]]]:
    """For each node the times of a kill, for so many kills."""
    rig, priority = rigs.load(RIG), permitted_priority()
    lines: list[str] = []
    values: dict[str, dict[str, Any]] = {
        "reference": {"kind": "constant"},
        "estimator": {"priority": priority},
        "controller": {"policy": "supervised", "priority": priority},
        "plant": {"priority": priority, "wait_for_readers": 3},  # estimator, reference and listener
    }
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in ANSWERS}
    heard = tuple(ANSWERS.values())
    with Session(rig.source, domain=DOMAIN, tell=lines.append) as session, Listener(rig.namespace, heard) as listener:
        commands = {name: session.command(name, given) for name, given in values.items()}
        for name, command in commands.items():
            session.start(name, command)
        started = time.time()
        listener.wait(lambda: listener.in_time("joint_command", started, row=SETTLED), "the loop")
        for k in range(repetitions):
            for name in ANSWERS:
                status.print(f"kill {name}, {k + 1} of {repetitions}")
                time.sleep(1.0)
                for entries in listener.heard.values():
                    entries.clear()
                found[name].append(killed_once(session, listener, name, commands[name]))
    return found


def summary(values: list[float], limit: float) -> dict[str, Any]:
    """Median and range of times [s], each of them, and whether the slowest is below what is asked."""
    return {
        "median_s": float(np.median(values)),
        "min_s": min(values),
        "max_s": max(values),
        "all_s": values,
        "asked_s": limit,
        "short": max(values) >= limit,
    }


def main() -> int:
    """Measure, print the table and write the results."""
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks.{NAME}", description=__doc__)
    parser.add_argument("--repetitions", type=int, default=5)
    repetitions = parser.parse_args().repetitions
    machine = result.machine()
    status.print("warming up")
    run_once()
    runs = []
    for k in range(repetitions):
        status.print(f"run, {k + 1} of {repetitions}")
        runs.append(run_once())
    kills = killed(repetitions)
    found = {"run": summary(runs, RUN_LIMIT)}
    for name, times in kills.items():
        backs = [back for _, back in times]
        found[f"kill {name}"] = {
            **summary([answered for answered, _ in times], NODE_LIMIT),
            "loop_median_s": float(np.median(backs)),
            "loop_max_s": max(backs),
        }
    table = Table("what", "median [s]", "range [s]", "asked [s]", "loop back [s]", title="to the next answer")
    for what, row in found.items():
        loop = f"{row['loop_median_s']:.2f}, at most {row['loop_max_s']:.2f}" if "loop_max_s" in row else ""
        limit = f"{row['asked_s']:g}{'  <- short' if row['short'] else ''}"
        table.add_row(what, f"{row['median_s']:.2f}", f"{row['min_s']:.2f} to {row['max_s']:.2f}", limit, loop)
    print_table(table)
    short = sum(row["short"] for row in found.values())
    print(f"written to {result.write(NAME, {**found, 'short': short}, on=machine)}")
    return 0


if __name__ == "__main__":
    result.run(main)
