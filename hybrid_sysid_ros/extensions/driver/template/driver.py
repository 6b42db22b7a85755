"""Driver of a real rig: the board behind a serial line, in the place of the simulated plant.

    python driver.py --port /dev/ttyACM0        # with the board of this folder: the port that board.py prints

A thread of its own talks with the board: each line of readings is published at once on joint_states and answered with
the newest command. Without a command for WATCHDOG it sends the inputs at rest, and the board must do the same where no
line comes any more. Change `parsed` and `written` for the lines that your board talks.
"""

from __future__ import annotations

import argparse
import math
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from threading import Event, Thread

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import JointState

from hybrid_sysid_ros.nodes import topics
from hybrid_sysid_ros.nodes.signal_layout import FIELDS, SignalLayout, Slots
from hybrid_sysid_ros.rigs.rig import load

WATCHDOG = 0.1  # s without a command, after which the inputs rest
SILENCE = 0.02  # s without a reading, after which the board gets a line all the same: its heartbeat
BAUD = termios.B115200


def parsed(line: str) -> list[float]:
    """The readings in a line of the board, in SI units: M 0.0123 -0.4. Raises ValueError where it is none."""
    kind, *numbers = line.split()
    if kind != "M":
        raise ValueError(line)
    return [float(number) for number in numbers]


def written(inputs: Sequence[float]) -> str:
    """The line that commands inputs: U 1.5."""
    return "U " + " ".join(f"{value:.6g}" for value in inputs) + "\n"


class SerialLine:
    """A serial port, or a pseudo terminal, read line by line. read and write raise OSError where the board is gone."""

    def __init__(self, port: str) -> None:
        self._rest = b""
        """Of a line that the port has taken a part of."""
        self._file = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._file)
        settings = termios.tcgetattr(self._file)
        settings[4] = settings[5] = BAUD
        termios.tcsetattr(self._file, termios.TCSANOW, settings)
        self._text = b""

    def read(self, timeout: float) -> str | None:
        """The next line; None where none comes within timeout [s]."""
        end = time.monotonic() + timeout
        while b"\n" not in self._text:
            ready, _, _ = select.select([self._file], [], [], max(end - time.monotonic(), 0.0))
            if not ready:
                return None
            if not (text := os.read(self._file, 4096)):
                raise OSError("the board has hung up")
            self._text = (self._text + text)[-65536:]
        line, _, self._text = self._text.partition(b"\n")
        return line.decode(errors="replace").strip()

    def write(self, text: str) -> None:
        """Send a line. One for which the port has no room is left out whole, since it would come too late."""
        for data in (self._rest, text.encode()):
            try:
                self._rest = data[os.write(self._file, data) :] if data else b""
            except BlockingIOError:
                return
            if self._rest:
                return

    def close(self) -> None:
        """Close the port."""
        os.close(self._file)


class Driver(Node):
    """joint_command in, joint_states out, as the simulated plant has them."""

    def __init__(self, rig: str, port: str) -> None:
        self.rig = load(rig)
        super().__init__("plant", namespace=self.rig.namespace)
        layout = SignalLayout(self.rig, self.rig.system)
        self._command, self._places = Slots(layout.inputs), Slots([*layout.outputs, *layout.inputs])
        self._rest = [actuator.rest for actuator in self.rig.actuators]
        self._newest, self._commanded = self._rest, -math.inf
        self.refused = 0
        """Lines of the board that could not be read."""
        self.line = SerialLine(port)
        self._ended = Event()
        self.lost = ""
        """Why the board can't be reached any more."""
        self._states = self.create_publisher(JointState, "joint_states", topics.profile("joint_states"))
        self.create_subscription(JointState, "joint_command", self.on_command, topics.profile("joint_command"))
        self._thread = Thread(target=self.talk, name="board", daemon=True)
        self._thread.start()

    def on_command(self, message: JointState) -> None:
        """Keep a command: within the limits of the actuators, and at rest where it is no number."""
        values = self._command.read(message.name, [message.position, message.velocity, message.effort])
        if self._command.named:
            bounded = [item.bounded(float(value)) for item, value in zip(self.rig.actuators, values, strict=True)]
            self._newest, self._commanded = bounded, time.monotonic()

    def inputs(self) -> list[float]:
        """The newest command, or rest where that is older than WATCHDOG."""
        return self._newest if time.monotonic() - self._commanded < WATCHDOG else self._rest

    def talk(self) -> None:
        """Talk with the board until the node ends, or the board is gone."""
        try:
            self._talk()
        except OSError as error:
            self.lost = f"the board is gone ({error}): plug it in and start this driver again"
            self.get_logger().fatal(self.lost)

    def _talk(self) -> None:
        sent, count = self._rest, len(self.rig.system.outputs)
        while not self._ended.is_set():
            line, stamp = self.line.read(SILENCE), self.get_clock().now()
            try:
                readings = parsed(line) if line else []
            except ValueError:
                readings = []
            self.refused += line is not None and len(readings) != count
            if len(readings) == count:
                lists = [[math.nan] * len(self._places.names) if name in self._places.fields else [] for name in FIELDS]
                self._places.write(lists, [*readings, *sent])
                message = JointState(name=self._places.names)
                message.header.stamp, message.header.frame_id = stamp.to_msg(), "driver"
                message.position, message.velocity, message.effort = lists
                self._states.publish(message)
            sent = self.inputs()
            self.line.write(written(sent))

    def close(self) -> None:
        """Leave the board at rest."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._thread.join()
        with suppress(OSError):  # the board is gone, and rests by its own watchdog
            self.line.write(written(self._rest))
        self.line.close()


def main() -> int:
    """Run until it is interrupted, or the board is gone, which is status 2."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--port", required=True)
    rclpy.init()
    driver = Driver(str(Path(__file__).parent), options.parse_args().port)
    try:
        while not driver.lost:
            rclpy.spin_once(driver, timeout_sec=0.1)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        driver.close()
    return 2 if driver.lost else 0


if __name__ == "__main__":
    sys.exit(main())
