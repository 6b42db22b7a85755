"""Source: a folder that a node has read."""

from __future__ import annotations

import os
from pathlib import Path


class Source:
    """The node goes on with what it read, whatever becomes of the folder."""

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self._read = self._marks()

    def changed(self) -> str:
        """In words whether it is not the same any more; empty if it is. Asks the disk, which may take its time."""
        now = self._marks()
        if now == self._read:
            return ""
        kept = "the one that was read stays in use until the node starts again"
        return f"{self.folder} {'has changed' if now else 'is gone'}: {kept}"

    def _marks(self) -> dict[str, tuple[int, int, int]]:
        """By which the file system tells a file from another one in its place."""
        try:
            with os.scandir(self.folder) as entries:
                found = {entry.name: entry.stat() for entry in entries if entry.is_file()}
        except OSError:
            return {}
        return {name: (each.st_ino, each.st_mtime_ns, each.st_size) for name, each in found.items()}
