"""Watch: what the processes of a loop take, seen from outside, over time."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Mapping
from pathlib import Path

NODE = re.compile(r"hybrid_sysid_ros\.nodes\.(\w+)")
SHARED_MEMORY = re.compile(r" (/dev/shm/\S+)")


def nodes() -> dict[str, int]:
    """Process numbers of the nodes that this process has started, by node."""
    found = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int(_status(path)[1])
            name = NODE.search((path / "cmdline").read_text(encoding="utf-8", errors="replace"))
        except OSError:  # it has ended
            continue
        if parent == os.getpid() and name:
            found[name[1]] = int(path.name)
    return found


def taken(process: int) -> dict[str, float]:
    """What a process takes now, by quantity: resident memory, open files, threads, segments of shared memory, and page
    faults since its start.

    Raises OSError where it has ended.
    """
    path = Path(f"/proc/{process}")
    fields = _status(path)
    return {
        "memory_mb": int(fields[21]) * os.sysconf("SC_PAGE_SIZE") * 1e-6,
        "files": len(os.listdir(path / "fd")),
        "threads": int(fields[17]),
        "segments": _segments(path / "maps"),
        "page_faults": int(fields[7]) + int(fields[9]),
    }


def _segments(maps: Path) -> int:
    return len({*SHARED_MEMORY.findall(maps.read_text(encoding="utf-8", errors="replace"))})


class Watch:
    """Samples every ``period`` [s] of monotonic time, whenever it is called."""

    def __init__(self, *, period: float) -> None:
        self.times: list[float] = []
        self.samples: list[Mapping[str, Mapping[str, float]]] = []
        """At each of the times: by node, what it takes by quantity."""
        self.latest = 0.0
        """When it looked last, sample or not."""
        self._period = period

    def look(self) -> None:
        """Take a sample if it is time for one, and none where a node is ending."""
        self.latest = now = time.monotonic()
        if self.times and now - self.times[-1] < self._period:
            return
        try:
            sample = {name: taken(process) for name, process in nodes().items()}
        except OSError:
            return
        if self.samples and sample.keys() != self.samples[-1].keys():
            return
        self.times.append(now)
        self.samples.append(sample)


def _status(path: Path) -> list[str]:
    """Fields of /proc/N/stat behind the command, from the state (third in `man proc`, here 0) on."""
    return (path / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
