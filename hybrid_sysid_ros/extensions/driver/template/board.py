"""A board that is simulated behind a pseudo terminal: what the driver talks to before it talks to yours.

python board.py             # prints the port for driver.py --port
"""

from __future__ import annotations

import os
import pty
import select
import time
import tty
from pathlib import Path
from threading import Event

from hybrid_sysid_ros.rigs.plant import Plant
from hybrid_sysid_ros.rigs.rig import load

RATE = 200.0  # Hz, of its readings
WATCHDOG = 0.1  # s without a line, after which it rests its drive


def commanded(line: bytes) -> list[float]:
    """The inputs in a line of the driver; none where it is noise or a part of one."""
    kind, *numbers = line.decode(errors="replace").split() or [""]
    try:
        return [float(number) for number in numbers] if kind == "U" else []
    except ValueError:
        return []


class Board:
    """The rig's simulated plant, its readings out and its inputs in as lines."""

    def __init__(self, rig: str) -> None:
        self.plant = Plant(load(rig), seed=0)
        self._file, other = pty.openpty()
        tty.setraw(other)
        self.port = os.ttyname(other)
        self.rest = [actuator.rest for actuator in self.plant.rig.actuators]
        self.inputs = self.rest
        """That act now."""
        self.ended = Event()
        self._heard, self._text = 0.0, b""

    def hear(self) -> None:
        """Take the newest line, if one has come."""
        while select.select([self._file], [], [], 0.0)[0]:
            self._text += os.read(self._file, 4096)
        *lines, self._text = self._text.split(b"\n")
        for line in lines:
            inputs = commanded(line)
            if len(inputs) == len(self.rest):
                self.inputs, self._heard = inputs, time.monotonic()
        if time.monotonic() - self._heard > WATCHDOG:
            self.inputs = self.rest

    def run(self) -> None:
        """Go on in real time until it is ended."""
        steps, due = self.plant.rig.steps(1.0 / RATE, "the board's period"), time.monotonic()
        while not self.ended.is_set():
            self.hear()
            for _ in range(steps):
                self.plant.advance(self.inputs)
            readings = " ".join(f"{value:.9g}" for value in self.plant.sensed())
            if select.select([], [self._file], [], 0.0)[1]:
                os.write(self._file, f"M {readings}\n".encode())
            due = max(due + 1.0 / RATE, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))
        os.close(self._file)  # as a plug that is drawn


if __name__ == "__main__":
    board = Board(str(Path(__file__).parent))
    print(board.port, flush=True)
    board.run()
