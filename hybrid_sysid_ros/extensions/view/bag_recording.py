"""Bag recording: a recorder's process that a page starts and ends."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from hybrid_sysid_ros.runtime import node_commands
from hybrid_sysid_ros.support.errors import UserError
from hybrid_sysid_ros.support.interruption import TETHER

NODE = "view_recorder"
"""Name of its node: a run may have a recorder of its own."""
START_TIMEOUT, END_TIMEOUT = 60.0, 15.0
LOOK = 0.05  # s, between two looks at the process


class BagRecording:
    """One recording at a time, each into a new folder that is named after the rig and the time: a page names none."""

    def __init__(self, folder: Path, *, rig: str, name: str, namespace: str, priority: int) -> None:
        """folder: of the bags. rig: name or path; name: the rig's. priority: real-time priority of the process."""
        self._folder, self._rig, self._name, self._namespace = folder.absolute(), rig, name, namespace
        self._priority = priority
        self._process: subprocess.Popen[bytes] | None = None
        self._said: IO[bytes] | None = None
        self._bag, self._began = Path(), 0.0
        """Folder of the bag, and since when it takes messages; 0: not yet."""

    def facts(self) -> dict[str, Any]:
        """For a page: whether it is on, since how long [s], the bag's name, what went wrong, and the node's name."""
        process = self._process
        code = process.poll() if process is not None else 0
        on = process is not None and code is None
        if on and not self._began and self._has_said("ready"):
            self._began = time.monotonic()
        seconds = int(time.monotonic() - self._began) if on and self._began else 0
        trouble = self._trouble() if code else ""
        return {"on": on, "seconds": seconds, "bag": self._bag.name, "trouble": trouble, "node": NODE}

    async def start(self) -> str:
        """Begin to record; a line about it. Raises UserError where it records already, or can't."""
        if self._process is not None and self._process.poll() is None:
            raise UserError(f"{self._bag.name} is being recorded already")
        self._forget()
        self._bag = self._folder / f"{self._name}_{time.strftime('%Y%m%d_%H%M%S')}"
        values = {"path": str(self._bag), "priority": self._priority}
        command = node_commands.command("recorder", values, rig=self._rig, namespace=self._namespace)
        self._said = said = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = process = subprocess.Popen(
            [*command, "-r", f"__node:={NODE}"],
            stdin=subprocess.PIPE,  # which ends with this process, however that does
            stdout=said,
            stderr=said,
            env={**os.environ, TETHER: "1"},
            start_new_session=True,
        )
        end = time.monotonic() + START_TIMEOUT
        while not self._has_said("ready"):
            if process.poll() is not None or time.monotonic() > end:
                raise UserError(f"nothing is recorded: {self._trouble()}")
            await asyncio.sleep(LOOK)
        return f"recording into {self._bag}"

    async def stop(self) -> str:
        """End the bag; a line about it. Raises UserError where nothing is recorded, or the bag did not end well."""
        process = self._process
        if process is None or process.poll() is not None:
            raise UserError("nothing is being recorded")
        process.send_signal(signal.SIGINT)
        end = time.monotonic() + END_TIMEOUT
        while process.poll() is None and time.monotonic() < end:
            await asyncio.sleep(LOOK)
        return self._ended()

    def close(self) -> None:
        """End what is being recorded."""
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(END_TIMEOUT)
        self._forget()

    def _ended(self) -> str:
        process = self._process
        code, trouble = None if process is None else process.poll(), self._trouble()
        self._forget()
        if code:
            raise UserError(f"{self._bag.name} did not end well: {trouble}")
        if code is None:
            raise UserError(f"{self._bag.name} did not end within {END_TIMEOUT:g} s")
        return f"recorded {self._bag}"

    def _forget(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
        if self._said is not None:
            self._said.close()
        self._process, self._said, self._began = None, None, 0.0

    def _lines(self) -> list[str]:
        if self._said is None:
            return []
        size = os.fstat(self._said.fileno()).st_size
        return os.pread(self._said.fileno(), size, 0).decode(errors="replace").split("\n")

    def _has_said(self, word: str) -> bool:
        """Whether the process has said a word."""
        return word in self._lines()

    def _trouble(self) -> str:
        """The last line that the process has said, but for its diagnostics."""
        lines = [line.strip() for line in self._lines() if line.strip() and not line.startswith("{")]
        return lines[-1] if lines else "the recorder said nothing"
