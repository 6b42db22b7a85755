"""Link to a board: the calls of its loop over a serial line."""

from __future__ import annotations

import math
import os
import select
import struct
import termios
import tty
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import NamedTuple

import numpy as np

from hybrid_sysid_ros.extensions.export.board.folder import PROTOCOL
from hybrid_sysid_ros.extensions.export.board.frames import FrameReceiver, encode
from hybrid_sysid_ros.support.arrays import Array
from hybrid_sysid_ros.support.errors import UserError

SILENT_AFTER = 0.35
"""Time without a byte after which a board counts as silent [s]; its heart beats every .1 s."""
PIECE = 4096
TRIES = 4
"""How often a question is sent at most, each time at once after a frame that was damaged, here or there."""
TICK = 40
"""Instructions of a tick in the emulator."""


class BoardSilent(Exception):
    """A board does not answer in time."""


class BoardIdentity(NamedTuple):
    """What a board says of itself."""

    real: int
    """Bytes of its numbers: 4 or 8."""
    states: int
    inputs: int
    outputs: int
    horizon: int
    protocol: int
    seal: str
    """Of its model."""


class BoardEstimate(NamedTuple):
    """An estimate of a board."""

    known: bool
    """Whether there is one."""
    state: Array
    """(n,)."""
    ahead: Array
    """(n,)."""
    disturbance: Array
    """(m,)."""


class BoardCommand(NamedTuple):
    """A command of a board."""

    status: int
    """As of :mod:`~hybrid_sysid_ros.extensions.export.unit.printed_loop`."""
    ticks: int
    """Of the board's clock that the period took."""
    inputs: Array
    """(m,)."""


class BoardLink:
    """A serial line with a board at its other end; one call at a time.

    The line may be noisy: an answer counts only if it is whole and has the number of its question.
    """

    def __init__(self, port: str | Path, *, baud: int = 115200) -> None:
        """Raises UserError where the port can't be opened."""
        speed = getattr(termios, f"B{baud}", None)
        if speed is None:
            raise UserError(f"baud {baud}: is no rate of a serial line; 115200, 460800 or 921600 are")
        self._speed = speed
        self._line = _opened(port, speed)
        self.port = str(port)
        self.identity: BoardIdentity | None = None
        self.frames = FrameReceiver()
        self.heard = -math.inf
        """When a whole frame came last, in steady time [s]."""
        self.alive, self.board_wrong, self.asked = 0, 0, 0
        """Time since the board's start [ms], frames that it found damaged, and questions so far."""
        self.restarted = False
        """Whether the board has started anew since it was asked who it is."""
        self._number = 0
        self._reading = Lock()  # diagnostics look whether the board is silent in a thread of their own

    def open(self) -> None:
        """Open the port again, which may have been gone. Raises UserError as the constructor."""
        with self._reading:
            self._close()
            self._line = _opened(self.port, self._speed)

    def _close(self) -> None:
        if (line := getattr(self, "_line", -1)) >= 0:
            self._line = -1
            os.close(line)

    __del__ = _close

    @property
    def silent(self) -> bool:
        """Whether the board has been silent for too long; what waits on the line is read first, unless somebody waits
        for it.
        """
        if self._reading.acquire(blocking=False):
            self._read(0.0)
            self._reading.release()
        return monotonic() - self.heard > SILENT_AFTER

    def hello(self, *, patience: float = 2.0) -> BoardIdentity:
        """Ask who is there. Raises UserError where nobody answers, or who speaks otherwise."""
        return self._introduced(b"H", patience)

    def reset(self, *, patience: float = 2.0) -> BoardIdentity:
        """Let the board forget the past. Raises UserError as :meth:`hello`."""
        return self._introduced(b"R", patience)

    def observe(self, time: float, outputs: Array, applied: Array, *, patience: float) -> BoardEstimate:
        """The estimate for a measurement: time [s], outputs (p,), applied inputs (m,), NaN where one is missing.

        Raises BoardSilent without an answer within ``patience`` [s].
        """
        content = self._ask(b"O", struct.pack("<d", time) + self._packed(outputs, applied), b"E", patience)
        assert self.identity is not None
        n = self.identity.states
        numbers = self._numbers(content[1:])
        return BoardEstimate(bool(content[0]), numbers[:n], numbers[n : 2 * n], numbers[2 * n :])

    def decide(self, sent: Array, preview: Array, *, patience: float) -> BoardCommand:
        """The command for the last estimate: inputs that act so far (m,), preview (N, p). Raises BoardSilent."""
        content = self._ask(b"D", self._packed(sent, preview), b"C", patience)
        status, ticks = struct.unpack_from("<BI", content)
        return BoardCommand(status, ticks, self._numbers(content[5:]))

    def prepare(self, elapsed: float) -> None:
        """Let the board prepare its next command, ``elapsed`` [s] after this one; nothing is answered."""
        self._send(b"P", self._packed(np.array([elapsed])))

    def forget_plan(self) -> None:
        """Let the board forget its last plan."""
        self._send(b"F", b"")

    def _introduced(self, kind: bytes, patience: float) -> BoardIdentity:
        end = monotonic() + patience
        while True:
            try:
                content = self._ask(kind, b"", b"I", min(0.25, patience))
                break
            except BoardSilent:
                if monotonic() > end:
                    raise UserError(
                        f"port {self.port}: no board answers: is it powered, does it run the loop, is its rate right?"
                    ) from None
        self.restarted = False
        real, states, inputs, outputs, horizon, protocol = content[:6]
        seal = content[6:].decode(errors="replace")
        self.identity = BoardIdentity(real, states, inputs, outputs, horizon, protocol, seal)
        if self.identity.protocol != PROTOCOL or self.identity.real not in (4, 8):
            raise UserError(
                f"port {self.port}: the board speaks protocol {self.identity.protocol}, not {PROTOCOL}: export and "
                "flash its loop anew"
            )
        return self.identity

    @property
    def _real(self) -> str:
        return "<f4" if self.identity is not None and self.identity.real == 4 else "<f8"

    def _packed(self, *parts: Array) -> bytes:
        with np.errstate(over="ignore"):  # no float is 1e300
            return b"".join(np.ravel(part).astype(self._real).tobytes() for part in parts)

    def _numbers(self, content: bytes) -> Array:
        return np.frombuffer(content, dtype=self._real).astype(float)

    def _send(self, kind: bytes, content: bytes) -> None:
        self._number = (self._number + 1) % (1 << 16)
        self._write(encode(kind + struct.pack("<H", self._number) + content))

    def _write(self, frame: bytes) -> None:
        waiting, end = memoryview(frame), monotonic() + SILENT_AFTER
        while waiting:
            try:
                waiting = waiting[os.write(self._line, waiting) :]
            except BlockingIOError:
                if monotonic() > end:  # nobody takes them
                    raise BoardSilent from None
                select.select([], [self._line], [], 0.01)
            except OSError as error:
                raise BoardSilent from error

    def _ask(self, kind: bytes, content: bytes, wanted: bytes, patience: float) -> bytes:
        """The answer to a question, without its head. Raises BoardSilent."""
        self.asked += 1
        with self._reading:
            self._send(kind, content)
            number = struct.pack("<H", self._number)
            head, end, tries, damaged = wanted + number, monotonic() + patience, 1, self._damaged
            while True:
                for answer in self._read(max(end - monotonic(), 0.0)):
                    if answer.startswith(head):
                        return answer[len(head) :]
                if monotonic() > end:
                    raise BoardSilent
                if self._damaged > damaged and tries < TRIES:
                    tries, damaged = tries + 1, self._damaged
                    self._write(encode(kind + number + content))

    @property
    def _damaged(self) -> int:
        """Frames that came damaged here and there."""
        return self.frames.wrong + self.board_wrong

    def _read(self, patience: float) -> list[bytes]:
        """Answers that came; heartbeats are noted."""
        if self._line < 0:  # the port has gone
            return []
        try:
            if not select.select([self._line], [], [], patience)[0]:
                return []
            piece = os.read(self._line, PIECE)
        except OSError:  # the other end is gone
            return []
        found = list(self.frames.receive(piece))
        if found:
            self.heard = monotonic()
        for content in found:
            if content[:1] == b"B" and len(content) == 15:
                alive, _, self.board_wrong = struct.unpack_from("<III", content, 3)
                self.restarted |= alive < self.alive
                self.alive = alive
        return found


def _opened(port: str | Path, speed: int) -> int:
    """A raw serial line. Raises UserError where there is none."""
    try:
        line = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError as error:
        raise UserError(f"port {port}: can't be opened ({error.strerror}): give the board's serial port") from error
    try:
        tty.setraw(line)
        settings = termios.tcgetattr(line)
        settings[4] = settings[5] = speed
        termios.tcsetattr(line, termios.TCSANOW, settings)
    except termios.error as error:
        os.close(line)
        raise UserError(f"port {port}: is no serial port ({error.args[-1]})") from error
    return line
