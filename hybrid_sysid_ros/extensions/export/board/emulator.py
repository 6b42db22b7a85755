"""The emulator of a board, with its serial line on a pseudo terminal."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from pathlib import Path
from types import TracebackType

from hybrid_sysid_ros.extensions.export.board.folder import make
from hybrid_sysid_ros.support.errors import UserError

PORT = re.compile(r"char device redirected to (\S+)")


class BoardEmulator:
    """A board's folder in QEMU, as a context that leaves no process behind. port: its serial port."""

    def __init__(self, folder: Path | str) -> None:
        """Raises UserError where the folder can't be built."""
        self.folder = Path(folder)
        make(self.folder, "build/loop.elf")
        self.port = ""
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> BoardEmulator:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def start(self) -> None:
        """Start the board. Raises UserError where the emulator can't be started."""
        try:
            self._process = subprocess.Popen(
                ["make", "--silent", "serve"], cwd=self.folder, text=True, start_new_session=True,
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            )  # fmt: skip
        except OSError as error:
            raise UserError(f"{self.folder}: make can't be run: {error}") from error
        assert self._process.stdout is not None
        said = ""
        while (line := self._process.stdout.readline()) and not (found := PORT.search(line)):
            said = line.strip() or said
        if not line or found is None:
            self.stop()
            raise UserError(f"{self.folder}: the emulator does not start: {said or 'it says nothing'}")
        self.port = found[1]

    def stop(self) -> None:
        """Let the board die at once, as one without power."""
        if self._process is not None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.communicate()  # which closes what it said, too
            self._process = None
