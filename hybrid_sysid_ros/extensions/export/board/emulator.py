"""The emulator of a board, with its serial line on a pseudo terminal."""

from __future__ import annotations

import re
import subprocess
from contextlib import ExitStack
from pathlib import Path

from hybrid_sysid_ros.extensions.export.board.folder import make, tethered_make
from hybrid_sysid_ros.support.errors import UserError

PORT = re.compile(r"char device redirected to (\S+)")


class BoardEmulator:
    """A board's folder in QEMU, as a context that leaves no process behind, even where this one is killed. port: its
    serial port.
    """

    def __init__(self, folder: Path | str) -> None:
        """Raises UserError where the folder can't be built."""
        self.folder = Path(folder)
        make(self.folder, "build/loop.elf")
        self.port = ""
        self._running = ExitStack()

    def __enter__(self) -> BoardEmulator:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start the board. Raises UserError where the emulator can't be started."""
        process = self._running.enter_context(tethered_make(self.folder, "serve", stderr=subprocess.STDOUT))
        assert process.stdout is not None
        said = ""
        while (line := process.stdout.readline()) and not (found := PORT.search(line)):
            said = line.strip() or said
        if not line or found is None:
            self.stop()
            raise UserError(f"{self.folder}: the emulator does not start: {said or 'it says nothing'}")
        self.port = found[1]

    def stop(self) -> None:
        """Let the board die at once, as one without power."""
        self._running.close()
